"""Masks of the Fourier plane."""

from collections.abc import Sequence

import torch


def disc(shape: Sequence[int], radius: float, offset: Sequence[float] = (0.0, 0.0)) -> torch.Tensor:
    """Return ones closer than `radius` to a point, zeros elsewhere, float32 ``[rows, columns]``.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    radius : float
        In samples.
    offset : tuple of float
        Distance of the point from sample n // 2 of each axis.
    """
    rows, columns = (
        torch.arange(n, dtype=torch.float64) - n // 2 - shift for n, shift in zip(shape, offset, strict=True)
    )
    return (rows[:, None] ** 2 + columns**2 < radius**2).float()
