"""Proven lower bounds of the error of an image that a display shows, from its light and from its band."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from odak._warnings import AccuracyWarning, warn

# A bound is told of where it keeps the peak signal-to-noise ratio below this many decibels.
_TOLD_BELOW = 30.0
# Share of the light that passes which lands in an image, at least, where the brightness of the image is free.
LEAST_SHARE = 0.01
# Lengths of the rims of windows, as shares of an image.
_RIMS = (0.1, 0.2, 0.45)


def least_error_of_light(target: torch.Tensor, least: float, most: float) -> float:
    """Return the least mean squared error of an image whose mean lies between two values.

    The mean of the squared difference is at least the square of the mean difference.

    Parameters
    ----------
    target : torch.Tensor
        Intensities wanted, ``[rows, columns]``.
    least, most : float
        Least and most mean of the image: of the light that must land in it, and that can.

    Returns
    -------
    float
        The bound; 0 where the target's mean lies between the two.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave.holograms.bounds import least_error_of_light
    >>> round(least_error_of_light(torch.full((8, 8), 0.35), 0.97, 1.0), 4)
    0.3844
    """
    mean = float(target.mean())
    return max(0.0, least - mean, mean - most) ** 2


def least_error_of_band(target: torch.Tensor, band: Sequence[float], light: float) -> float:
    """Return the least mean squared error of an image that has no frequencies outside a band, and no negative values.

    The image J continues beyond the target T, in the same band, with a sum of at most `light` over the whole plane. For
    each g that is zero beyond T, ⟨g, T − J⟩ = ⟨g, T⟩ − ⟨g', J⟩ with g' the part of g in the band, and since J ≥ 0 this
    is at least ⟨g, T⟩ − light · max g'. By Cauchy and Schwarz its square over ⟨g, g⟩ bounds the squared error. Here g
    is the part of the target that lies outside the band, under a window that falls smoothly to zero at the rim.

    Parameters
    ----------
    target : torch.Tensor
        Intensities wanted, ``[rows, columns]``.
    band : sequence of float
        Highest frequencies of the image along rows and columns in cycles per pixel: twice those of the field. The band
        is the ellipse with these half axes.
    light : float
        Sum of the image over the whole plane at most.

    Returns
    -------
    float
        The bound; 0 where no frequency lies outside the band.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave.holograms.bounds import least_error_of_band
    >>> stripes = (torch.arange(64) % 2).float().expand(64, 64)
    >>> bound = least_error_of_band(stripes, (0.3, 0.3), float(stripes.sum()))
    >>> 0.1 < bound < 0.25
    True
    """
    wanted = target.detach().double().cpu().numpy()
    shape = wanted.shape
    # g' is computed on a wider grid, on which its maximum is found between the pixels of its own grid too.
    wide = [4 * n for n in shape]
    # Half of the frequencies along rows: what is filtered is real.
    radius = np.hypot(np.fft.fftfreq(wide[0])[:, None] / band[0], np.fft.rfftfreq(wide[1]) / band[1])
    if radius.max() <= 1:
        return 0.0
    found = 0.0
    # Each window gives a bound; a wide rim keeps the band clean, a narrow one keeps more of the target.
    for share in _RIMS:
        window = np.outer(*(_falling(n, share) for n in shape))
        # It widens the spectrum of what it multiplies by some periods over its rim.
        margin = 1 + max(2 / (share * n * b) for n, b in zip(shape, band, strict=True))

        def filtered(values, passed, rows):
            spectrum = np.fft.fft(np.fft.rfft(values, wide[1]), wide[0], axis=0) * passed
            return np.fft.irfft(np.fft.ifft(spectrum, axis=0)[:rows], wide[1])

        outside = filtered(window * (wanted - wanted.mean()), radius > margin, shape[0])[:, : shape[1]]
        given = window * outside
        norm = float((given**2).sum())
        if norm > 0:
            # Between the points of a grid that describes a band four times over, a maximum is little higher.
            peak = abs(filtered(given, radius <= 1, wide[0])).max() / np.cos(np.pi / 8) ** 2
            gap = float((given * wanted).sum()) - light * float(peak)
            found = max(found, max(0.0, gap) ** 2 / norm / wanted.size)
    return found


def tell_bounds(display: Any, target: torch.Tensor) -> None:
    """Warn where no pattern can show a target ``[D, C, rows, columns]`` well on a display, whose brightness is free.

    Warns
    -----
    AccuracyWarning
        If what passes the stop leaves out so much of the target that its peak signal-to-noise ratio stays below 30 dB.
    """
    worst, known = 0.0, target.detach()
    for d, c in itertools.product(*map(range, display.shape[:2])):
        if (band := display.path.band(c, d)) is None:
            continue
        # At the best brightness an image has no more energy than its target, and so no larger mean than this.
        mean = float(known[:, c].double().square().mean().sqrt())
        wanted = known[d, c, 1:-1, 1:-1]
        bound = least_error_of_band(wanted, band, len(known) * mean * known[d, c].numel() / LEAST_SHARE)
        worst = max(worst, bound)
    if worst > 10 ** (-_TOLD_BELOW / 10):
        warn(
            f"the target has finer detail than passes the stop: no pattern that sends {LEAST_SHARE:.0%} of its light "
            f"or more into the image has a peak signal-to-noise ratio above {-10 * math.log10(worst):.1f} dB",
            AccuracyWarning,
        )


def _falling(count: int, share: float) -> np.ndarray:
    """Return a window of ones that falls smoothly to zero over a share of its length at each end."""
    rise = np.cumsum(np.kaiser(max(2, round(share * count)), 9.0))
    rise = rise / rise[-1]
    return np.concatenate([rise, np.ones(count - 2 * len(rise)), rise[::-1]])
