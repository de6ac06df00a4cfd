"""Light from a panel to a plane behind a lens, by one Fourier transform. Touches the light it is given."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch

from odak import _array
from odak.instruments import Lens
from odak.learn.wave.displays.observers import REACH
from odak.learn.wave.displays.panels import Iris, Modulator
from odak.learn.wave.displays.paths.base import Kept, Lights, Path, keep
from odak.learn.wave.displays.paths.two_panels import not_behind
from odak.learn.wave.fields import unit_phasor


@dataclass(frozen=True)
class LensPath(Path):
    """Light that a lens takes to a plane at its focus or beside it, of one diffraction order: others lie elsewhere."""

    starts: ClassVar[tuple[str, ...]] = ("gs", "quadratic", "random", "flat")
    begins: ClassVar[str | None] = "quadratic"
    where = "behind a lens"
    free_space = "a display without a lens or eyes"

    def __post_init__(self) -> None:
        if self.first is not None:
            raise ValueError(not_behind("a display behind a lens"))
        keep(self, distances=(float(self.ends.after),), samples=2)

    @classmethod
    def leads(cls, modulator: Modulator, ends: Any) -> bool:
        """Say whether the light of a modulator takes this kind of path to the images."""
        return isinstance(ends, Lens)

    def points(self, kept: Kept, lights: Lights, colour: int, planes: Sequence[int]) -> torch.Tensor:
        """Return the fields of some images at the points of pixels."""
        light, quarters = lights[0].unsqueeze(-3), itertools.product((0.0, 0.5), repeat=2)
        return torch.cat([self._focused(kept, light, colour, half, REACH) for half in quarters], -3)

    def middles(self, kept: Kept, lights: Lights, colour: int) -> torch.Tensor:
        """Return the fields of all images at the middles of pixels."""
        return self._focused(kept, lights[0].unsqueeze(-3), colour)

    def replaced(self, kept: Kept, amplitudes: torch.Tensor, light: torch.Tensor, colour: int) -> torch.Tensor:
        """Return the light on the panel of images whose amplitudes are replaced."""
        field = amplitudes[0] * unit_phasor(self._focused(kept, light, colour).angle())
        # As if all frequencies passed.
        lit = torch.fft.ifft2(torch.fft.ifftshift(field, dim=(-2, -1)), norm="ortho")
        return torch.fft.fftshift(lit, dim=(-2, -1)) * self._before(kept, colour, field.dtype).conj()

    def image_pitches(self, colour: int) -> tuple[float, float]:
        """Return how far apart points of the image of a colour are along rows and columns, in metres."""
        length = self.wavelengths[colour] / self.medium * abs(self.ends.ray_matrix[1])
        down, across = (length / (n * p) for n, p in zip(self.sizes, self.pitches, strict=True))
        return down, across

    def nearness(self, depths: torch.Tensor | None) -> torch.Tensor:
        """Refuse pictures with depth, of which a single plane in the far field shows nothing."""
        raise ValueError("target must be images [rows, columns] for a display behind a lens, got one with depth")

    def in_words(self) -> str:
        """Return where the images are, in words."""
        return f"lens of {1e3 * self.ends.focal_length:.4g} mm"

    def _focused(self, kept, light, colour, beside=(0.0, 0.0), beyond=0):
        """Return the field behind the lens, at the middles of the points of an image or a part of one beside them.

        It reaches some points beyond each rim, where the next orders begin.
        """
        lit = torch.fft.ifftshift(light * self._before(kept, colour, light.dtype, beside), dim=(-2, -1))
        behind = kept(LensPath._behind_lens, self, colour, light.dtype, beside, beyond)
        field = torch.fft.fftshift(torch.fft.fft2(lit, norm="ortho"), dim=(-2, -1))
        if beyond:
            rows, columns = (torch.arange(-beyond, n + beyond, device=field.device) % n for n in self.sizes)
            field = field.index_select(-2, rows).index_select(-1, columns)
        return field * behind

    def _before(self, kept, colour, dtype, beside=(0.0, 0.0)):
        return kept(LensPath._before_lens, self, colour, dtype, beside)

    def _before_lens(self, device, colour, dtype, beside):
        """Return the factor of the light on the panel that the lens leaves, and that moves to beside the points."""
        cycles = self._curvature(colour)
        for axis, (n, part) in enumerate(zip(self.sizes, beside, strict=True)):
            turn = -part / n * (torch.arange(n, dtype=torch.float64) - n // 2)
            cycles = cycles + (turn[:, None] if axis == 0 else turn)
        return _array.phasor_of_cycles(cycles).to(device, dtype)

    def _behind_lens(self, device, colour, dtype, beside, beyond):
        """Return the factor of the field behind the lens, which its pixels envelop."""
        frequencies = [
            (torch.arange(-beyond, n + beyond, dtype=torch.float64) - n // 2 + part) / n
            for n, part in zip(self.sizes, beside, strict=True)
        ]
        return self._envelope(frequencies, colour).to(device, dtype.to_real())

    def _curvature(self, colour) -> torch.Tensor:
        """Return the phase of the light on the panel that the lens leaves at a plane beside its focus, in cycles."""
        a, b = self.ends.ray_matrix
        y, x = (
            (torch.arange(n, dtype=torch.float64) - n // 2) * p for n, p in zip(self.sizes, self.pitches, strict=True)
        )
        return a * self.medium / (2 * self.wavelengths[colour] * b) * (y[:, None] ** 2 + x**2)

    def _envelope(self, frequencies: Sequence[torch.Tensor], colour: int) -> torch.Tensor:
        """Return what square pixels, the block and the iris pass of frequencies along rows and columns, per pixel."""
        lens: Any = self.ends
        down, across = (torch.sinc(math.sqrt(self.fill) * f) for f in frequencies)
        pair, wavelength = self.pitches, self.wavelengths[colour]
        radius = torch.hypot(frequencies[0][:, None] / pair[0], frequencies[1] / pair[1])
        passed = torch.outer(down, across)
        passed = passed * (wavelength / self.medium * abs(lens.ray_matrix[1]) * radius >= lens.block)
        return passed * (radius <= self.iris.cutoff(wavelength)) if isinstance(self.iris, Iris) else passed
