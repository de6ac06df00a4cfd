"""Regression: lines, functions of one variable, and a linear boundary between two classes."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array
from odak._bars import tqdm


def gradient_descent_1d(
    input_data: Sequence[float],
    ground_truth_data: Sequence[float],
    parameters: Sequence[float],
    function: Callable[..., Any],
    gradient_function: Callable[..., Any],
    loss_function: Callable[..., Any],
    learning_rate: float = 1e-1,
    iteration_number: int = 10,
    *,
    vectorized: bool = False,
    progress: bool = False,
) -> np.ndarray:
    """Return the parameters of a function of one variable after steps of gradient descent.

    Parameters
    ----------
    input_data : array
        The N points x.
    ground_truth_data : array
        The values y at these points.
    parameters : array
        Initial parameters, ``[p]``; not changed.
    function : callable
        ``function(x, parameters)``: the model.
    gradient_function : callable
        ``gradient_function(x, y, function, parameters)``: derivative of the loss in the parameters at one point,
        ``[p]``.
    loss_function : callable
        ``loss_function(truth, estimate)``; shown in the progress bar and not used otherwise.
    learning_rate : float
        Step per gradient.
    iteration_number : int
        Number of steps.
    vectorized : bool
        Call `gradient_function` once per step with all points, for ``[p, N]``, rather than point by point.
    progress : bool
        Show a progress bar with the loss.

    Returns
    -------
    numpy.ndarray
        ``[p]``, float64 (complex128 for complex parameters).

    Raises
    ------
    ValueError
        If there are no points, or not as many values as points, or vectorized gradients of another shape.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.fit import gradient_descent_1d
    >>> x = np.linspace(0, 1, 5)
    >>> gradient_descent_1d(
    ...     x, 2 * x + 1, [0, 0],
    ...     function=lambda x, p: p[0] * x + p[1],
    ...     gradient_function=lambda x, y, f, p: np.asarray([2 * x * (f(x, p) - y), 2 * (f(x, p) - y)]),
    ...     loss_function=lambda y, estimate: ((y - estimate) ** 2).sum(),
    ... ).round(5)
    array([1.04557, 1.41857])
    """
    input_data, ground_truth_data, parameters = _validate.constants(
        input_data=input_data, ground_truth_data=ground_truth_data, parameters=parameters
    )
    x = np.asarray(_validate.array("input_data", input_data))
    y = np.asarray(_validate.array("ground_truth_data", ground_truth_data))
    if not x.shape or not len(x) or x.shape[:1] != y.shape[:1]:
        raise ValueError(f"ground_truth_data must have one value per point of input_data, got {y.shape} for {x.shape}")
    steps = _validate.integer("iteration_number", iteration_number)
    _validate.real("learning_rate", learning_rate)
    vectorized, progress = _validate.flag("vectorized", vectorized), _validate.flag("progress", progress)
    for name, value in (
        ("function", function),
        ("gradient_function", gradient_function),
        ("loss_function", loss_function),
    ):
        _validate.function(name, value)
    parameters = np.asarray(_validate.array("parameters", parameters))
    if not parameters.size:
        raise ValueError(f"parameters must contain at least one number, got {parameters.shape}")
    parameters = parameters.astype(np.result_type(parameters.dtype, np.float64))
    bar = tqdm(range(steps), disable=not progress)
    for _ in bar:
        if vectorized:
            gradients, wanted = np.asarray(gradient_function(x, y, function, parameters)), (len(parameters), len(x))
            if gradients.shape != wanted:
                raise ValueError(f"gradient_function must return {list(wanted)} when vectorized, got {gradients.shape}")
            gradient = gradients.sum(axis=-1)
        else:
            gradient = sum(gradient_function(a, b, function, parameters) for a, b in zip(x, y, strict=True))
        parameters = parameters - learning_rate / len(x) * np.asarray(gradient)
        if progress:
            bar.set_description(f"Loss: {loss_function(y, function(x, parameters)):.4g}")
    return parameters


def least_square_1d(x: Array, y: Array) -> Array:
    """Return gradient m and offset n of the line y = m·x + n that lies nearest to points in the sense of least squares.

    Parameters
    ----------
    x : array
        Abscissae, at least two of them different.
    y : array
        Ordinates, as many.

    Returns
    -------
    array
        ``[m, n]``, float64 (or float32 where both are); differentiable in torch.

    Raises
    ------
    ValueError
        If the shapes differ, or all x are the same.

    Notes
    -----
    Both are centred on their means first, which avoids the loss of precision of the normal equations for x far from
    zero.

    Examples
    --------
    >>> from odak.fit import least_square_1d
    >>> least_square_1d([0, 1, 2], [1, 3, 5])
    array([2., 1.])
    """
    x, y = _validate.reals(x=x, y=y)
    xp = _array.namespace(x)
    x, y = xp.reshape(x, (-1,)), xp.reshape(y, (-1,))
    if x.shape != y.shape:
        raise ValueError(f"y must have as many points as x, got {y.shape[0]} and {x.shape[0]}")
    # From the first point, so that points far from zero keep their digits in single precision.
    across, up = x - x[:1], y - y[:1]
    middle, height = xp.mean(across), xp.mean(up)
    across = across - middle
    spread = xp.sum(across**2)
    if _array.is_readable(spread) and not _validate.numbers(spread)[0] > 0:
        raise ValueError(f"x must contain at least two different finite numbers, got {x.shape[0]} without any spread")
    gradient = xp.sum(across * (up - height)) / spread
    return xp.stack((gradient, y[0] + (height - gradient * (middle + x[0]))))


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
    x, y = _validate.constants(x=x, y=y)
    points, labels = (np.asarray(_validate.array(n, v), dtype=np.float64) for n, v in (("x", x), ("y", y)))
    _validate.real("x", points)
    _validate.real("learning_rate", learning_rate)
    labels = labels.reshape(-1)
    if points.ndim != 2 or len(points) != len(labels):
        raise ValueError(f"x must be [m x d] with one label each in y, got {points.shape} and {labels.shape[0]} labels")
    if not np.all((labels == 0) | (labels == 1)):
        raise ValueError("y must contain the labels 0 and 1 only")
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
    x, w = _validate.constants(x=x, w=w)
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
