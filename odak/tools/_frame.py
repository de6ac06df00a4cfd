"""Where a field sits in a larger one: sample ``n // 2`` of each axis is its centre, before and after."""

from collections.abc import Iterable, Sequence

from odak import _validate

METHODS = ("center", "left", "left aligned")


def frame(field, size: Sequence[int] | None, method: str) -> tuple[int, int, int, int]:
    """Return height and width of the larger field, and the row and column where the smaller one begins in it."""
    rows, columns = _validate.image("field", field).shape[-2:]
    height, width = (2 * rows, 2 * columns) if size is None else last_two(size)
    if height < rows or width < columns:
        raise ValueError(f"size must be at least that of the field, {[rows, columns]}; got {[height, width]}")
    if _validate.one_of("method", method, METHODS) != "center":
        return height, width, 0, 0
    return height, width, height // 2 - rows // 2, width // 2 - columns // 2


def last_two(size) -> tuple[int, int]:
    """Return the last two entries of a size as rows and columns."""
    return _validate.size("size", tuple(size)[-2:] if isinstance(size, Iterable) else size)
