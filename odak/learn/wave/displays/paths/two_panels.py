"""Light through two panels in series to planes. Touches transfer functions and the lights it is given."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from scipy.fft import next_fast_len

from odak import _array
from odak.learn.wave.displays.observers import REACH
from odak.learn.wave.displays.panels import Iris, Modulator
from odak.learn.wave.displays.paths.base import Kept, Lights, keep
from odak.learn.wave.displays.paths.free import FreePath, PixelTransfer
from odak.wave.linear_kernels import linear_kernel
from odak.wave.torch_convolution import convolve
from odak.wave.transfer_functions import Request, divided_pitch

# Pixels around a modulator, at least, in which the light of its edges is followed behind another panel, and in which
# that of a small one is, whose edges are a larger part of it.
_MARGIN, _SMALLEST = 32, 256


@dataclass(frozen=True)
class TwoPanelsPath(FreePath):
    """Light through an amplitude panel, on to the modulator, and from there to planes."""

    free_space = "a modulator without lit_through"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.samples > 2:
            raise ValueError(not_behind(f"iris={self.iris!r}"))
        rows, columns = (next_fast_len(max(n + 2 * _MARGIN, _SMALLEST)) for n in self.sizes)
        keep(self, window=(rows, columns))

    @classmethod
    def leads(cls, modulator: Modulator, ends: Any) -> bool:
        """Say whether the light of a modulator takes this kind of path to the images."""
        return super().leads(modulator, ends) and modulator.lit_through is not None

    def points(self, kept: Kept, lights: Lights, colour: int, planes: Sequence[int]) -> torch.Tensor:
        """Return the fields of some images at the points of pixels."""
        return self._through_both(kept, lights, colour, self.kernels(kept, colour, lights[1].dtype, planes), REACH)

    def middles(self, kept: Kept, lights: Lights, colour: int) -> torch.Tensor:
        """Return the fields of all images at the middles of pixels."""
        kernels = self.kernels(kept, colour, lights[1].dtype, range(len(self.distances)))
        return self._through_both(kept, lights, colour, kernels[:: self.samples**2])

    def _through_both(self, kept, lights, colour, kernels, beyond=0):
        """Return the fields ``[..., F, kernel, rows, columns]`` of the light of two panels, filtered by kernels.

        They reach some pixels beyond each rim.

        The modulator multiplies the light of the first panel, which holds the diffraction orders that pass its stop.
        Frequencies of the modulator up to one order beyond these reach the images, and with one sample more in each
        pixel than orders pass, no other frequencies are aliased onto them.
        """
        first: Any = self.first
        amplitudes, light = lights
        finer, window = 1 + self.passing(first.iris), self.window
        between = kept(type(self)._between, self, colour, finer, light.dtype)
        there = convolve(_comb(amplitudes, window, finer), between)
        width = math.sqrt(self.fill)
        down, across = (
            torch.sinc(width * p * torch.fft.fftfreq(n * finer, p / finer, dtype=light.real.dtype, device=light.device))
            for n, p in zip(window, self.pitches, strict=True)
        )
        spectrum = torch.fft.fft2(_comb(light, window, finer)) * (down[:, None] * across * finer**2)
        product = there * torch.fft.ifft2(spectrum)
        for axis, n in zip((-1, -2), window[::-1], strict=True):
            whole = torch.fft.fft(product, 2 * n * finer, axis) / finer
            product = torch.cat([whole.narrow(axis, 0, n), whole.narrow(axis, 2 * n * finer - n, n)], axis)
        shown = torch.fft.ifft2(product[..., None, :, :] * kernels)
        for axis, n, m in zip((-2, -1), window, self.sizes, strict=True):
            shown = shown.narrow(axis, (n - m) // 2 - beyond, m + 2 * beyond)
        return shown

    def _between(self, device, colour, finer, dtype) -> torch.Tensor:
        """Return the transfer function from the pixels of the first panel to points at the modulator."""
        first: Any = self.first
        cutoff = first.iris.cutoff(self.wavelengths[colour]) if isinstance(first.iris, Iris) else math.inf
        transfer = PixelTransfer.of(self.pitches, first.fill, self.passing(first.iris))
        request = Request(divided_pitch(self.pitches, finer), self.wavelengths[colour], first.distance)
        shape = tuple(2 * n * finer for n in self.window)
        xp = _array.namespace(torch.empty(0))
        return linear_kernel(transfer, cutoff)(request.grid(shape, xp, device, dtype)) * finer**2


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
