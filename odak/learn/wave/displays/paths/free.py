"""Light from a panel to planes in free space or a medium. Touches transfer functions and the light it is given."""

import itertools
import math
from dataclasses import dataclass, field

import torch

from odak import _array
from odak._warnings import AccuracyWarning, warn
from odak.learn.wave.displays.panels import Iris
from odak.learn.wave.displays.paths.base import Path, keep, listed
from odak.wave.linear_kernels import linear_kernel
from odak.wave.torch_convolution import convolve
from odak.wave.transfer_functions import Request, angular_spectrum, divided_pitch, plane_wave_transfer

# Where an iris passes fewer periods across the panel, its spot is wider than all that is computed.
_FEWEST_PERIODS = 0.5


@dataclass(frozen=True)
class FreePath(Path):
    """Light that travels freely from a panel, or from its image by a relay, to planes.

    Attributes
    ----------
    window : tuple of int
        Rows and columns in which light is followed.
    """

    window: tuple[int, int] = field(init=False)

    starts = ("quadratic", "flat", "random", "double phase", "gs", "network")

    def __post_init__(self):
        keep(self, distances=self.ends, window=self.sizes)
        if isinstance(self.iris, Iris):
            across = min(n * p for n, p in zip(self.sizes, self.pitches, strict=True))
            periods = across * min(self.iris.cutoff(wavelength) for wavelength in self.wavelengths)
            if periods < _FEWEST_PERIODS:
                warn(
                    f"iris passes {periods:.2g} periods across the modulator, whose light it spreads far beyond "
                    f"the images: is its radius of {self.iris.radius:g} m right?",
                    AccuracyWarning,
                )
        keep(self, samples=2 * self.passing(self.iris))

    @classmethod
    def leads(cls, modulator, ends):
        """Say whether the light of a modulator takes this kind of path to the images."""
        return isinstance(ends, tuple)

    def points(self, kept, lights, colour, planes):
        """Return the fields of some images at the points of pixels."""
        (light,) = lights
        # One kernel for each plane and point of a pixel takes one transform back, but a single forward one.
        return convolve(light.unsqueeze(-3), self.kernels(kept, colour, light.dtype, planes))

    def middles(self, kept, lights, colour):
        """Return the fields of all images at the middles of pixels."""
        (light,) = lights
        planes = range(len(self.distances))
        return convolve(light.unsqueeze(-3), self.kernels(kept, colour, light.dtype, planes)[:: self.samples**2])

    def in_words(self):
        """Return where the images are, in words."""
        return f"plane{'s' * (len(self.distances) > 1)} at {listed(self.distances, 1e3)} mm"

    def kernels(self, kept, colour: int, dtype: torch.dtype, planes) -> torch.Tensor:
        """Return the transfer functions to all points of a pixel on some planes, ``[planes·samples², 2m, 2n]``."""
        return kept(type(self)._of_planes, self, colour, dtype, tuple(planes))

    def _of_planes(self, device, colour, dtype, planes):
        rows, columns = self.window
        # Column by column, which is the order that the propagation reads them in on a CPU.
        shape = len(planes) * self.samples**2, 2 * columns, 2 * rows
        kept = torch.empty(shape, dtype=dtype, device=device).mT
        kept = kept if kept.is_cpu else kept.contiguous()
        each = (kernel for plane in planes for kernel in self._of_plane(device, colour, plane, dtype))
        for place, kernel in zip(kept, each, strict=True):
            place.copy_(kernel)
        return kept

    def _of_plane(self, device, colour, plane, dtype):
        wavelength, orders, cutoff = self.wavelengths[colour] / self.medium, self.samples // 2, self.cutoff(colour)
        # Light that has passed two panels has the spectrum of their pixels already.
        fill, xp = self.fill if self.first is None else None, _array.namespace(torch.empty(0))

        def grid(samples):
            shape = tuple(2 * n * samples for n in self.window)
            pitch = divided_pitch(self.pitches, samples)
            return Request(pitch, wavelength, self.distances[plane]).grid(shape, xp, device, dtype)

        if orders == 1:
            quarters = itertools.product((False, True), repeat=2)
            yield from (linear_kernel(angular_spectrum, cutoff, fill, halves=h)(grid(1)) for h in quarters)
        else:
            # The response at all points of the pixels of the image. Each point takes its own lags, every so many of
            # them, and with them the repetitions of the spectrum.
            count = self.samples
            transfer = PixelTransfer.of(self.pitches, self.fill, orders)
            kernel = linear_kernel(transfer, math.inf if cutoff is None else cutoff)(grid(count))
            response = torch.fft.ifft2(kernel) * count**2
            points = itertools.product(range(count), repeat=2)
            yield from (torch.fft.fft2(response[down::count, across::count]) for down, across in points)


@dataclass(frozen=True)
class PixelTransfer:
    """Transfer function of free space for square pixels of some width, in a band that a square stop passes."""

    width: tuple[float, float]
    band: tuple[float, float]

    @classmethod
    def of(cls, pitches: tuple[float, float], fill: float, orders: int) -> "PixelTransfer":
        """Return the one of pixels that emit in a share of their area, with some orders along each axis."""
        width = math.sqrt(fill)
        return cls((width * pitches[0], width * pitches[1]), (orders / (2 * pitches[0]), orders / (2 * pitches[1])))

    def __call__(self, grid):
        """Return the transfer function on a grid of frequencies."""

        def kernel(fy, fx):
            spectrum = plane_wave_transfer(grid, fy, fx)
            for frequency, width, limit in zip((fy, fx), self.width, self.band, strict=True):
                passed = torch.sinc(width * frequency) * (0.5 * (frequency < limit) + 0.5 * (frequency <= limit))
                spectrum = spectrum * passed.to(spectrum.dtype)
            return spectrum

        return grid.evaluate(kernel)
