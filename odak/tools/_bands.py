"""Octave rings of frequencies, and nested lists of zeros."""

from collections.abc import Iterable, Sequence

import numpy as np

from odak import _validate


def create_empty_list(dimensions: Sequence[int] = (1, 1)) -> list | int:
    """Return nested lists of zeros, each list an object of its own.

    Parameters
    ----------
    dimensions : sequence of int
        Lengths from the outermost list to the innermost; none gives the number 0.

    Returns
    -------
    list
        Nested lists.

    Examples
    --------
    >>> from odak.tools import create_empty_list
    >>> create_empty_list([2, 3])
    [[0, 0, 0], [0, 0, 0]]
    """
    if isinstance(dimensions, str) or not isinstance(dimensions, Iterable):
        raise TypeError(f"dimensions must be a sequence of integers, got {dimensions!r:.80}")
    lengths = [_validate.integer("dimensions", length) for length in dimensions]
    return _nested(lengths)


def generate_bandlimits(size: Sequence[int] = (512, 512), levels: int = 9) -> np.ndarray:
    """Return masks of octave rings of frequencies, the zero frequency at sample ``n // 2``.

    Parameters
    ----------
    size : sequence of int
        Rows and columns.
    levels : int
        Number of rings; the first one reaches the highest frequency.

    Returns
    -------
    numpy.ndarray
        float64 ``[levels, size[0], size[1]]``. Ring i is 1 in the box of the half-width n // 2^(i+1) about the centre,
        without the box of half that width.

    Raises
    ------
    ValueError, TypeError
        If `size` is not two positive integers or `levels` not a positive one.
    """
    rows, columns = _validate.size("size", size)
    masks = np.zeros((_validate.integer("levels", levels, minimum=1), rows, columns))
    for i, mask in enumerate(masks):
        (top, bottom, inner_top, inner_bottom), (left, right, inner_left, inner_right) = (
            _edges(n, i) for n in (rows, columns)
        )
        mask[top:bottom, left:right] = 1
        mask[inner_top:inner_bottom, inner_left:inner_right] = 0
    return masks


def _nested(lengths):
    return [_nested(lengths[1:]) for _ in range(lengths[0])] if lengths else 0


def _edges(n: int, level: int) -> tuple[int, int, int, int]:
    centre, reach = n // 2, n // 2 ** (level + 1)
    return centre - reach, centre + reach, int(centre - reach / 2), int(centre + reach / 2)
