"""Measured spectra as smooth curves: sums of three Gaussians."""

import numpy as np
import torch
from scipy.optimize import least_squares

FIRST, LAST, LINES = 400, 700, 3
_SMALLEST_WIDTH, _BETWEEN, _CLOSE = 0.5, 0.01, 1e-3


def fitted_spectrum(dataset) -> torch.Tensor:
    """Return the sum of three Gaussians nearest to a measured spectrum.

    Parameters
    ----------
    dataset : torch.Tensor or numpy.ndarray
        Wavelengths in nanometres and values, ``[N, 2]`` or ``[2, N]``.

    Returns
    -------
    torch.Tensor
        ``[301]``, float32, at 400, 401 … 700 nm, in units of the largest value measured there.

    Raises
    ------
    ValueError, TypeError
        If the data are not two columns of finite numbers, or nothing was measured between 400 and 700 nm.

    Notes
    -----
    Least squares at the wavelengths measured, one line after the other: each starts at the peak of what those before
    left over, with the width of that peak, and all lines are fitted together again. A line that meets every measured
    value to a thousandth is the last.
    """
    axis = np.linspace(FIRST, LAST, LAST - FIRST + 1)
    table = _checked(dataset)
    values = np.interp(axis, table[:, 0], table[:, 1], left=0.0, right=0.0)
    if values.max() <= 0:
        raise ValueError(f"dataset must have positive values between {FIRST} and {LAST} nm")
    largest = values.max()
    values = values / largest
    inside = (table[:, 0] >= FIRST) & (table[:, 0] <= LAST)
    places, measured = table[inside, 0], table[inside, 1] / largest
    share = np.sqrt(len(axis) / max(1, len(places)))
    # Between what was measured the broken line counts little: it cuts the peaks of narrow lines.
    weight = np.where((axis >= table[0, 0]) & (axis <= table[-1, 0]), _BETWEEN, 1.0)

    def apart(parameters):
        lines = weight * (_curve(parameters, axis) - values)
        return np.concatenate([share * (_curve(parameters, places) - measured), lines])

    parameters = np.empty(0)
    while len(parameters) < 3 * LINES and np.abs(apart(parameters)).max() > _CLOSE * share:
        left = values - _curve(parameters, axis)
        parameters = np.append(parameters, _start(left, axis))
        parameters = least_squares(apart, parameters, max_nfev=200).x
    return torch.from_numpy(_curve(parameters, axis)).float()


def _curve(parameters, axis):
    heights, centres, widths = parameters.reshape(-1, 3).T[..., None]
    widths = np.maximum(np.abs(widths), _SMALLEST_WIDTH)
    return (heights * np.exp(-(((axis - centres) / widths) ** 2) / 2)).sum(0)


def _start(left, axis):
    """Return height, centre and width of the largest peak: its area is height·width·√2π."""
    peak = int(np.argmax(np.abs(left)))
    same = np.sign(left) == np.sign(left[peak])
    # Up to where the curve changes its sign on either side.
    low = peak - int(np.argmin(np.append(same[: peak + 1][::-1], False)))
    high = peak + int(np.argmin(np.append(same[peak:], False)))
    area = np.abs(left[low + 1 : high]).sum()
    width = area / (abs(left[peak]) * np.sqrt(2 * np.pi)) if left[peak] else 10.0
    return left[peak], axis[peak], max(width, 1.0)


def _checked(dataset):
    if not isinstance(dataset, (torch.Tensor, np.ndarray)):
        raise TypeError(f"dataset must be a tensor or an array, got {type(dataset).__name__}")
    if "complex" in str(dataset.dtype):
        raise TypeError(f"dataset must be real, got {dataset.dtype}")
    table = dataset.detach().cpu().double().numpy() if isinstance(dataset, torch.Tensor) else dataset
    if table.ndim != 2 or 2 not in table.shape or table.size < 4:
        raise ValueError(f"dataset must be [N, 2] or [2, N], got {tuple(table.shape)}")
    table = (table if table.shape[1] == 2 else table.T).astype(float)
    if not np.isfinite(table).all():
        raise ValueError("dataset must hold finite numbers")
    return table[np.argsort(table[:, 0])]
