"""Training and evaluation of Rosenblatt's perceptron."""

import numpy as np
from tqdm import tqdm

from odak import _validate
from odak._array import Array

_CHUNK = 256


def perceptron(
    x: Array, y: Array, learning_rate: float = 0.1, iteration_number: int = 100, *, progress: bool = False
) -> np.ndarray:
    """Return the weights by which a perceptron separates two classes.

    Parameters
    ----------
    x : array
        Points, ``[m x d]``.
    y : array
        Labels 0 or 1, ``[m x 1]`` or ``[m]``.
    learning_rate : float
        Weight of a correction.
    iteration_number : int
        Passes over the points. It stops early when a pass finds no error, which leaves the weights as they are.
    progress : bool
        Show a progress bar.

    Returns
    -------
    numpy.ndarray
        ``[(d + 1) x 1]``, the bias first.

    Raises
    ------
    ValueError
        If the shapes do not belong together, or a label is neither 0 nor 1.

    Notes
    -----
    F. Rosenblatt, Psychological Review 65, 386 (1958). Points are taken in the order given, starting from zero
    weights: w ← w + rate·(y − ŷ)·x at each error. Points up to the next error are scored in one product.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.fit import perceptron, threshold_linear_model
    >>> x = np.asarray([[-2.0], [-1.0], [1.0], [2.0]])
    >>> weights = perceptron(x, np.asarray([0, 0, 1, 1]))
    >>> threshold_linear_model(np.asarray([[1.0, 1.0], [-3.0, 3.0]]), weights).tolist()
    [0, 1]
    """
    points, labels = (np.asarray(_validate.array(n, v), dtype=np.float64) for n, v in (("x", x), ("y", y)))
    _validate.real("x", points)
    _validate.real("learning_rate", learning_rate)
    labels = labels.reshape(-1)
    if points.ndim != 2 or len(points) != len(labels):
        raise ValueError(f"x must be [m x d] with one label each in y, got {points.shape} and {labels.shape[0]} labels")
    if not np.all((labels == 0) | (labels == 1)):
        raise ValueError("y must hold the labels 0 and 1 only")
    passes = _validate.integer("iteration_number", iteration_number)
    points = np.column_stack((np.ones(len(points)), points))
    weights = np.zeros(points.shape[1])
    for _ in tqdm(range(passes), disable=not _validate.flag("progress", progress)):
        if not _one_pass(points, labels, weights, learning_rate):
            break
    return weights[:, None]


def threshold_linear_model(x: Array, w: Array, threshold: float = 0) -> int | np.ndarray:
    """Return 1 where xᵀw ≥ threshold, 0 elsewhere.

    Parameters
    ----------
    x : array
        A point with a leading 1, ``[d + 1]`` or ``[(d + 1) x 1]``; several in columns, ``[(d + 1) x m]``.
    w : array
        Weights, ``[d + 1]`` or ``[(d + 1) x 1]``.
    threshold : float
        Limit.

    Returns
    -------
    int or numpy.ndarray
        One int for one point, ``[m]`` integers for several.

    Examples
    --------
    >>> from odak.fit import threshold_linear_model
    >>> threshold_linear_model([1.0, 2.0], [-1.0, 1.0])
    1
    """
    x, w = (np.asarray(_validate.real(n, _validate.array(n, v))) for n, v in (("x", x), ("w", w)))
    _validate.real("threshold", threshold)
    w = w.reshape(-1)
    if not x.shape or len(x) != len(w):
        raise ValueError(f"w must have as many entries as a point of x, got {len(w)} for x of shape {x.shape}")
    above = (x.reshape(len(w), -1).T @ w >= threshold).astype(int)
    return int(above[0]) if above.size == 1 else above


def _one_pass(points, labels, weights, rate) -> int:
    """Correct `weights` in place along the points; return the number of errors met."""
    errors = start = 0
    while start < len(points):
        chunk = slice(start, start + _CHUNK)
        wrong = np.flatnonzero((points[chunk] @ weights >= 0) != labels[chunk])
        if not wrong.size:
            start += _CHUNK
            continue
        place = start + wrong[0]
        weights += rate * (2 * labels[place] - 1) * points[place]
        errors, start = errors + 1, place + 1
    return errors
