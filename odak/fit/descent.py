"""Gradient descent on the parameters of a function of one variable."""

from collections.abc import Callable, Sequence

import numpy as np
from tqdm import tqdm

from odak import _validate


def gradient_descent_1d(
    input_data: Sequence[float],
    ground_truth_data: Sequence[float],
    parameters: Sequence[float],
    function: Callable,
    gradient_function: Callable,
    loss_function: Callable,
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
    parameters = np.array(_validate.array("parameters", parameters))
    if not parameters.size:
        raise ValueError(f"parameters must hold at least one number, got {parameters.shape}")
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
