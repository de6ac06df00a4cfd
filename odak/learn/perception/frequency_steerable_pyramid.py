"""A steerable pyramid by Fourier masks: exact reconstruction, of pictures of any size."""

import math

import numpy as np
import torch
from torch import nn

from odak import _validate
from odak.learn.perception.pyramid_filter_design import band_amplitude, ideal_gains, orientations
from odak.learn.perception.spatial_steerable_pyramid import Pyramid, checked_pyramid


class FrequencySteerablePyramid(nn.Module):
    """Steerable pyramid whose masks add up to one: its adjoint is its inverse, to rounding.

    Parameters
    ----------
    n_levels : int
        At least 2: the last level holds only what is left.
    n_orientations : int
        Number K ≥ 1 of orientations.

    Notes
    -----
    Portilla and Simoncelli, Int. J. Comput. Vis. 40, 49 (2000), eqs. 1 to 4, with the masks as formulas of the
    frequency rather than tables. Transforms are orthonormal, so that the energies of high-pass residual, bands and
    last low-pass add up to the picture's, and each level's mean is about twice the last one's. Pictures count as
    periodic. Masks are kept for the last picture size, precision and device.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import FrequencySteerablePyramid
    >>> maker = FrequencySteerablePyramid(n_levels=4, n_orientations=6)
    >>> picture = torch.rand(1, 3, 45, 70, dtype=torch.float64)
    >>> pyramid = maker.construct_pyramid(picture)
    >>> bool((maker.reconstruct_from_pyramid(pyramid) - picture).abs().max() < 1e-12)
    True
    """

    def __init__(self, n_levels: int = 5, n_orientations: int = 6) -> None:
        super().__init__()
        self.n_levels = _validate.integer("n_levels", n_levels, minimum=2)
        self.n_orientations = _validate.integer("n_orientations", n_orientations, minimum=1)
        self._masks: tuple | None = None

    def forward(self, image: torch.Tensor) -> Pyramid:
        """Return :meth:`construct_pyramid`."""
        return self.construct_pyramid(image)

    def construct_pyramid(self, image: torch.Tensor) -> Pyramid:
        """Return the pyramid of a picture, fine to coarse; differentiable.

        Parameters
        ----------
        image : torch.Tensor
            Real floats ``[..., H, W]``, each side at least 2ⁿ for n + 1 levels.

        Returns
        -------
        list of dict
            Level 0: "h" high-pass residual and "b", list of K bands; then "b" at half the size each, rounded up; last
            "l", the low-pass that is left. Band k is tuned to a frequency at 180°·k/K, counter-clockwise with y
            upwards; of an even K it is odd, and band 0 falls where brightness rises to the right.

        Raises
        ------
        ValueError, TypeError
            If the picture is not of real floats or too small for the levels.
        """
        size = self._size(image)
        high, levels = self._prepare(size, image.dtype, image.device)
        spectrum = torch.fft.rfft2(image, norm="ortho")
        pyramid = [{"h": _picture(spectrum * high, size)}]
        for level, (size_here, bands, low) in enumerate(levels):
            if level:
                spectrum = _cropped(spectrum, size_here)
                pyramid.append({})
            masked = _picture(spectrum[..., None, :, :] * bands, size_here)
            pyramid[-1]["b"] = list(masked.unbind(-3))
            spectrum = spectrum * low
        smallest = _halved(levels[-1][0])
        pyramid.append({"l": _picture(_cropped(spectrum, smallest), smallest)})
        return pyramid

    def reconstruct_from_pyramid(self, pyramid: Pyramid) -> torch.Tensor:
        """Return the picture of a pyramid, which stays as it is; differentiable.

        Parameters
        ----------
        pyramid : list of dict
            As :meth:`construct_pyramid` makes it.

        Returns
        -------
        torch.Tensor
            ``[..., H, W]``.

        Raises
        ------
        ValueError, TypeError
            If the pyramid has not `n_levels` levels of `n_orientations` bands.
        """
        checked_pyramid(pyramid, self.n_orientations)
        if len(pyramid) != self.n_levels:
            raise ValueError(f"pyramid must have n_levels = {self.n_levels} levels, got {len(pyramid)}")
        residual = pyramid[0]["h"]
        size = self._size(residual)
        high, levels = self._prepare(size, residual.dtype, residual.device)
        spectrum = torch.fft.rfft2(pyramid[-1]["l"], norm="ortho")
        for (size_here, bands, low), level in zip(reversed(levels), reversed(pyramid[:-1]), strict=True):
            spectrum = _spread(spectrum, size_here) * low
            transformed = torch.fft.rfft2(torch.stack(tuple(level["b"]), -3), norm="ortho")
            spectrum = spectrum + (transformed * bands.conj()).sum(-3)
        return _picture(spectrum + torch.fft.rfft2(residual, norm="ortho") * high, size)

    def _size(self, image) -> tuple[int, int]:
        if not isinstance(image, torch.Tensor) or image.dtype not in (torch.float32, torch.float64):
            kind = getattr(image, "dtype", type(image).__name__)
            raise TypeError(f"image must be a tensor of real floats [..., H, W], float32 or float64, got {kind}")
        smallest = 1 << (self.n_levels - 1)
        if image.ndim < 2 or 0 in image.shape or min(image.shape[-2:]) < smallest:
            raise ValueError(
                f"image must have sides of at least {smallest} for {self.n_levels} levels, got {tuple(image.shape)}"
            )
        rows, columns = image.shape[-2:]
        return rows, columns

    def _prepare(self, size, dtype, device):
        """Return the high-pass mask and, of each level with bands, its size, band masks ``[K, H, W]`` and low-pass."""
        key = (size, dtype, device)
        if self._masks is None or self._masks[0] != key:
            with torch.inference_mode(False):
                self._masks = (key, *_masks(size, self.n_levels, self.n_orientations, dtype, device))
        return self._masks[1:]


def _masks(size, n_levels, count, dtype, device):
    def real(mask):
        return torch.from_numpy(mask).to(device, dtype)

    high = ideal_gains(_polar(size, size)[0])[0]
    levels, here = [], size
    for level in range(n_levels - 1):
        radius, angle = _polar(here, size)
        _, _, band, low = ideal_gains(radius * 2**level)
        # What came before has cut the low-pass of the finer level already; the first one is cut here.
        before = ideal_gains(radius)[1] if level == 0 else 1.0
        toward = np.cos(angle - orientations(count)[:, None, None]) ** (count - 1)
        bands = real(before * band * band_amplitude(count) * toward)
        levels.append(
            (here, bands if count % 2 else torch.complex(torch.zeros_like(bands), -bands), real(before * low / 2))
        )
        here = _halved(here)
    return real(high), levels


def _polar(here, size):
    """Return length and angle (y upwards) of the frequencies of a level's half spectrum, in radians per fine pixel."""
    rows = np.fft.fftfreq(here[0], 1 / here[0]) / size[0]
    columns = np.arange(here[1] // 2 + 1) / size[1]
    y, x = -2 * math.pi * rows[:, None], 2 * math.pi * columns[None, :]
    return np.hypot(x, y), np.arctan2(y, x)


def _halved(size):
    return tuple(-(-side // 2) for side in size)


def _picture(spectrum, size):
    return torch.fft.irfft2(spectrum, size, norm="ortho")


def _rows_kept(rows):
    """Return how many rows of least frequency a spectrum has from zero upwards, and below zero."""
    return (rows + 1) // 2, rows // 2


def _cropped(spectrum, size):
    """Return the part of a half spectrum that a smaller picture has."""
    up, down = _rows_kept(size[0])
    columns = spectrum[..., : size[1] // 2 + 1]
    return torch.cat([columns[..., :up, :], columns[..., columns.shape[-2] - down :, :]], -2)


def _spread(spectrum, size):
    """Return a half spectrum among zeros as that of a larger picture."""
    up, down = _rows_kept(spectrum.shape[-2])
    middle = spectrum.new_zeros(*spectrum.shape[:-2], size[0] - up - down, spectrum.shape[-1])
    rows = torch.cat([spectrum[..., :up, :], middle, spectrum[..., up:, :]], -2)
    return nn.functional.pad(rows, (0, size[1] // 2 + 1 - spectrum.shape[-1]))
