"""The line nearest to points."""

from odak import _array, _validate
from odak._array import Array


def least_square_1d(x: Array, y: Array) -> Array:
    """Return slope m and offset n of the line y = m·x + n that lies nearest to points in the sense of least squares.

    Parameters
    ----------
    x, y : array
        Coordinates, real, of one shape with at least two different x.

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
    xp = _array.namespace(x, y)
    x, y = (_real_line(xp, name, value) for name, value in (("x", x), ("y", y)))
    if x.shape != y.shape:
        raise ValueError(f"y must have as many points as x, got {y.shape[0]} and {x.shape[0]}")
    middle, height = xp.mean(x), xp.mean(y)
    across = x - middle
    spread = xp.sum(across**2)
    if _array.is_readable(spread) and not _validate.numbers(spread)[0] > 0:
        raise ValueError(f"x must hold at least two different finite numbers, got {x.shape[0]} without any spread")
    slope = xp.sum(across * (y - height)) / spread
    return xp.stack((slope, height - slope * middle))


def _real_line(xp, name, value):
    value = value if _array.is_array(_validate.array(name, value)) and _array.is_array(value) else xp.asarray(value)
    if "complex" in str(value.dtype):
        raise TypeError(f"{name} must be real, got an array of {value.dtype}")
    return xp.astype(xp.reshape(value, (-1,)), _array.real_dtype(value))
