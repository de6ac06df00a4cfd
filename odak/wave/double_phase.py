"""The two checkerboard parts of a double-phase hologram, taken apart and put together."""

from odak import _array, _validate
from odak._array import Array


def decompose_double_phase(tensor: Array) -> tuple:
    """Return the two checkerboard parts of an image, each packed into half the columns.

    Parameters
    ----------
    tensor : array
        ``[..., h, w]``; odd sizes lose their last row or column.

    Returns
    -------
    tuple
        High and low part, each ``[..., h, w/2]``: high holds the samples (even, even) and (odd, odd), low the others.
    """
    tensor = _validate.image("tensor", tensor)
    rows, columns = (n - n % 2 for n in tensor.shape[-2:])
    if not rows or not columns:
        raise ValueError(f"tensor must have at least 2 rows and 2 columns, got {tuple(tensor.shape)}")
    even_rows, odd_rows = tensor[..., 0:rows:2, :columns], tensor[..., 1:rows:2, :columns]
    high = _interleave_rows(even_rows[..., 0::2], odd_rows[..., 1::2])
    low = _interleave_rows(even_rows[..., 1::2], odd_rows[..., 0::2])
    return high, low


def compose_double_phase(component_high: Array, component_low: Array) -> Array:
    """Return the image whose checkerboard parts are given: the exact inverse of :func:`decompose_double_phase`.

    Parameters
    ----------
    component_high, component_low : array
        ``[..., h, w/2]`` each.

    Returns
    -------
    array
        ``[..., h, w]``.
    """
    component_high = _validate.image("component_high", component_high)
    component_low = _validate.image("component_low", component_low)
    if tuple(component_high.shape) != tuple(component_low.shape):
        raise ValueError(
            f"component_low must have component_high's shape {tuple(component_high.shape)}, "
            f"got {tuple(component_low.shape)}"
        )
    high_even, high_odd = component_high[..., 0::2, :], component_high[..., 1::2, :]
    low_even, low_odd = component_low[..., 0::2, :], component_low[..., 1::2, :]
    return _interleave_rows(_interleave_columns(high_even, low_even), _interleave_columns(low_odd, high_odd))


def _interleave_rows(first, second):
    xp = _array.namespace(first)
    *batch, rows, columns = first.shape
    return xp.reshape(xp.stack([first, second], axis=-2), (*batch, 2 * rows, columns))


def _interleave_columns(first, second):
    xp = _array.namespace(first)
    *batch, rows, columns = first.shape
    return xp.reshape(xp.stack([first, second], axis=-1), (*batch, rows, 2 * columns))
