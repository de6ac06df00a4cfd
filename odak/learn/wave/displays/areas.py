"""Means over the areas of pixels of intensities at points of each pixel. Touches no display."""

import numpy as np
import torch

from odak import _array
from odak._torch_private import in_own_precision

# Pixels on either side that a mean over the area of a pixel is computed from; see _taps.
_REACH = 4


@_array.constant_in_graphs
def _taps(samples: int) -> tuple[torch.Tensor]:
    """Return the weights of the mean over a pixel of an intensity that is known at some points of each pixel.

    The intensity has frequencies up to samples/2 cycles per pixel, at which its spectrum, an autocorrelation, falls to
    zero. The spectrum of the weights is the nearest one to sin(πf)/(πf), by least squares with the square of that fall.
    """
    reach = _REACH * samples
    cycles = np.linspace(0, samples / 2, 64 * samples)
    lags = np.arange(reach + 1)
    columns = np.cos(2 * np.pi * cycles[:, None] * lags / samples) * np.where(lags == 0, 1, 2)
    weight = (1 - cycles / (samples / 2))[:, None] ** 2 + 1e-4
    half = np.linalg.lstsq(columns * weight, np.sinc(cycles)[:, None] * weight, rcond=None)[0][:, 0]
    whole = np.concatenate([half[:0:-1], half])
    return (torch.from_numpy(whole / whole.sum()),)


@in_own_precision
def over_areas(points: torch.Tensor) -> torch.Tensor:
    """Return the means over pixels of intensities at their points ``[planes, samples, samples, rows, columns]``."""
    planes, samples, _, rows, columns = points.shape
    finer = points.permute(0, 3, 1, 4, 2).reshape(planes, 1, rows * samples, columns * samples)
    taps, reach = _taps(samples)[0].to(points), _REACH * samples
    padded = torch.nn.functional.pad(finer, (reach, reach, reach, reach), mode="replicate")
    across = torch.nn.functional.conv2d(padded, taps[None, None, None], stride=(1, samples))
    return torch.nn.functional.conv2d(across, taps[None, None, :, None], stride=(samples, 1))[:, 0]
