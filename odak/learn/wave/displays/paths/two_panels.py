"""Light through two panels in series to planes. Touches transfer functions and the lights it is given."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from scipy.fft import next_fast_len

from odak import _array
from odak.learn.wave.displays.observers import REACH
from odak.learn.wave.displays.panels import Iris, Modulator
from odak.learn.wave.displays.paths.base import Kept, Lights, keep
from odak.learn.wave.displays.paths.free import FreePath, PixelTransfer
from odak.wave.linear_kernels import linear_kernel
from odak.wave.methods import linear_kernel_of
from odak.wave.torch_convolution import convolve
from odak.wave.transfer_functions import Request, divided_pitch

# Pixels around a modulator in which the light of its edges is followed behind another panel.
_MARGIN = 8


@dataclass(frozen=True)
class TwoPanelsPath(FreePath):
    """Light through an amplitude panel, on to the modulator, and from there to planes."""

    free_space = "a modulator without lit_through"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.samples > 2:
            raise ValueError(not_behind(f"iris={self.iris!r}"))
        first: Any = self.first
        # Even, so that half a pixel is a whole number of samples.
        finer = 2 * math.ceil((1 + self.passing(first.iris)) / 2)
        keep(self, window=tuple(next_fast_len(n + 2 * _MARGIN) for n in self.sizes), finer=finer)

    @classmethod
    def leads(cls, modulator: Modulator, ends: Any) -> bool:
        """Say whether the light of a modulator takes this kind of path to the images."""
        return super().leads(modulator, ends) and modulator.lit_through is not None

    def points(self, kept: Kept, lights: Lights, colour: int, planes: Sequence[int]) -> torch.Tensor:
        """Return the fields of some images at the points of pixels."""
        shown, half = self._through_both(kept, lights, colour, planes), self.finer // 2
        places = itertools.product((0, half), repeat=2)
        points = [self._pixels(shown, down, across, REACH) for down, across in places]
        return torch.stack(points, -3).flatten(-4, -3)

    def middles(self, kept: Kept, lights: Lights, colour: int) -> torch.Tensor:
        """Return the fields of all images at the middles of pixels."""
        return self._pixels(self._through_both(kept, lights, colour, range(len(self.distances))))

    def _pixels(self, shown, down=0, across=0, beyond=0):
        """Return the samples some samples beside the middles of pixels, of which some are beyond each rim."""
        for axis, n, m, more in zip((-2, -1), self.window, self.sizes, (down, across), strict=True):
            first = ((n - m) // 2 - beyond) * self.finer + more
            chosen = slice(first, first + (m + 2 * beyond) * self.finer, self.finer)
            shown = shown[..., chosen] if axis == -1 else shown[..., chosen, :]
        return shown

    def _through_both(self, kept, lights, colour, planes):
        """Return the fields of the light of two panels on some planes, ``[..., F, planes, rows, columns]``.

        They are on the window, with `finer` samples in each pixel.

        The modulator multiplies the light of the first panel, which holds the diffraction orders that pass its stop.
        Frequencies of the modulator up to one order beyond these reach the images, and with one sample more in each
        pixel than orders pass, no other frequencies are aliased onto them.
        """
        amplitudes, light = lights
        finer, window = self.finer, self.window
        there = convolve(_comb(amplitudes, window, finer), kept(type(self)._between, self, colour, light.dtype))
        width = math.sqrt(self.fill)
        down, across = (
            torch.sinc(width * p * torch.fft.fftfreq(n * finer, p / finer, dtype=light.real.dtype, device=light.device))
            for n, p in zip(window, self.pitches, strict=True)
        )
        spectrum = torch.fft.fft2(_comb(light, window, finer)) * (down[:, None] * across * finer**2)
        product = there * torch.fft.ifft2(spectrum)
        return convolve(product[..., None, :, :], self.kernels(kept, colour, light.dtype, planes))

    def _of_plane(self, device, colour, plane, dtype, error=0.0):
        """Yield the transfer function of one order from samples at the modulator to those at a plane."""
        cutoff, way = self.cutoff(colour), linear_kernel_of(self.method).transfer
        # Light that has passed two panels has the spectrum of their pixels already.
        transfer = replace(PixelTransfer.of(self.pitches, 0.0, 1), transfer=way)
        linear = linear_kernel(transfer, math.inf if cutoff is None else cutoff)
        yield linear(self._grid(device, colour, plane, dtype, error, self.finer))

    def _between(self, device, colour, dtype) -> torch.Tensor:
        """Return the transfer function from the pixels of the first panel to points at the modulator."""
        first: Any = self.first
        cutoff = first.iris.cutoff(self.wavelengths[colour]) if isinstance(first.iris, Iris) else math.inf
        transfer = PixelTransfer.of(self.pitches, first.fill, self.passing(first.iris))
        request = Request(divided_pitch(self.pitches, self.finer), self.wavelengths[colour], first.distance)
        shape = 2 * self.window[0] * self.finer, 2 * self.window[1] * self.finer
        xp = _array.namespace(torch.empty(0))
        return linear_kernel(transfer, cutoff)(request.grid(shape, xp, device, dtype)) * self.finer**2


def not_behind(got: str) -> str:
    """Return why a display of two panels is refused."""
    return (
        "modulator must be without lit_through behind a lens, and where more than one order passes the iris of "
        f"the display, got {got}"
    )


def _comb(light: torch.Tensor, window: Sequence[int], samples: int) -> torch.Tensor:
    """Return values of pixels ``[..., rows, columns]`` in the middle of a window, each followed by zeros."""
    rows, columns = light.shape[-2:]
    comb = light.new_zeros(*light.shape[:-2], *(n * samples for n in window))
    top, left = ((n - m) // 2 * samples for n, m in zip(window, (rows, columns), strict=True))
    comb[..., top : top + rows * samples : samples, left : left + columns * samples : samples] = light
    return comb
