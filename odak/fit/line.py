"""Fit of a line by least squares."""

from odak import _array, _validate
from odak._array import Array


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
    Both are centred on their means first, which keeps the digits that the normal equations lose for a far-away x.

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
    middle, height = xp.mean(x), xp.mean(y)
    across = x - middle
    spread = xp.sum(across**2)
    if _array.is_readable(spread) and not _validate.numbers(spread)[0] > 0:
        raise ValueError(f"x must hold at least two different finite numbers, got {x.shape[0]} without any spread")
    gradient = xp.sum(across * (y - height)) / spread
    return xp.stack((gradient, height - gradient * middle))
