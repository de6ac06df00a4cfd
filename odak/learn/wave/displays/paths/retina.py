"""Light from a panel through the pupils of eyes to their retinas. Touches the light it is given."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch

from odak._warnings import SamplingWarning, warn
from odak.instruments import Lens
from odak.learn.wave.displays.observers import REACH
from odak.learn.wave.displays.panels import AmplitudePanel, Iris, Modulator
from odak.learn.wave.displays.paths.base import Kept, Lights, Path, keep, listed
from odak.learn.wave.eyes import Eyepiece, Eyes, Sight
from odak.learn.wave.fields import unit_phasor
from odak.wave.viewing import check_blur


@dataclass(frozen=True)
class RetinaPath(Path):
    """Light that eyes see, one image for each: by direct sums over the pixels and the points of a pupil."""

    starts: ClassVar[tuple[str, ...]] = ("gs", "random", "flat")
    begins: ClassVar[str | None] = "random"
    where = "where eyes look on"
    free_space = "a display without a lens or eyes"
    on_retinas = True

    def __post_init__(self) -> None:
        for name, given, other in (
            ("iris", self.iris, "'order' or None"),
            ("medium", self.medium, "1"),
            ("lit_through", self.first, "None"),
        ):
            if isinstance(given, (Iris, AmplitudePanel)) or (name == "medium" and given != 1):
                raise ValueError(f"{name} must be {other} for a display that eyes look at, got {given!r:.80}")
        if self.expander is not None and self.iris is not None:
            raise ValueError(f"iris must be None for a modulator with an expander, got {self.iris!r:.80}")
        lens = self.ends.distance
        distance: Any = lens.after if isinstance(lens, Lens) else lens
        if isinstance(lens, Eyepiece):
            distance = lens.path_length
        keep(self, distances=(float(distance),) * len(self.ends))
        keep(self, samples=self._checked())

    @classmethod
    def leads(cls, modulator: Modulator, ends: Any) -> bool:
        """Say whether the light of a modulator takes this kind of path to the images."""
        return isinstance(ends, Eyes)

    def points(self, kept: Kept, lights: Lights, colour: int, planes: Sequence[int]) -> torch.Tensor:
        """Return the fields of some images at the points of pixels."""
        light = self._behind(lights[0]).unsqueeze(-3)
        return torch.cat([self._seen(kept, light, colour, eye).flatten(-4, -3) for eye in planes], -3)

    def middles(self, kept: Kept, lights: Lights, colour: int) -> torch.Tensor:
        """Return the fields of all images at the middles of pixels."""
        light = self._behind(lights[0]).unsqueeze(-3)
        return torch.cat([self._in_middles(kept, light, colour, eye) for eye in range(len(self.ends))], -3)

    def replaced(self, kept: Kept, amplitudes: torch.Tensor, light: torch.Tensor, colour: int) -> torch.Tensor:
        """Return the light on the panel of images whose amplitudes are replaced."""
        light = self._behind(light)
        back: Any = sum(self._back(kept, a, light, colour, eye) for eye, a in enumerate(amplitudes))
        return back if self.expander is None else self.expander.before(back, self.cells)

    def in_words(self) -> str:
        """Return where the images are, in words."""
        lens, count = self.ends.distance, len(self.ends)
        length, place = (lens.focal_length, "behind a lens of") if isinstance(lens, Lens) else (lens, "at")
        if isinstance(lens, Eyepiece):
            length, place = self.distances[0], "behind traced surfaces on"
        pupils = listed(sorted(set(self.ends.diameter)), 1e3)
        return f"{count} eye{'s' * (count > 1)} {place} {1e3 * length:.4g} mm, pupils of {pupils} mm"

    def place(self, image: int) -> dict[str, Any]:
        """Return where an image is, lengths in metres."""
        return super().place(image) | {"pupil": self.ends.positions[image]}

    def place_in_words(self, image: int) -> tuple[str, str]:
        """Return of which kind the place of an image is, and the place in words."""
        return "pupil", ", ".join(f"{1e3 * p:.4g}" for p in self.ends.positions[image]) + " mm"

    def sight(self, colour: int, eye: int) -> Sight:
        """Return the way of the light of a colour to the retina of an eye."""
        width = math.sqrt(self.fill)
        axes, one_order = (self.sizes, self.pitches), self.iris == "order"
        return Sight(self.ends, eye, *axes, self.wavelengths[colour], width, one_order, self.cells)

    def extents(self, colour: int) -> dict[str, Any]:
        """Return the étendue, the height and width of the eyebox, and the field of view in degrees."""
        sight = self.sight(colour, 0)
        away = 2 * abs(sight.ray_matrix()[1])
        sides = (n * p for n, p in zip(self.sizes, self.pitches, strict=True))
        view = tuple(2 * math.degrees(math.atan(side / away)) for side in sides)
        eyebox = tuple(self.cells * sight.box(axis) for axis in (0, 1))
        return {**super().extents(colour), "eyebox": eyebox, "field_of_view": view}

    def band(self, colour: int, image: int) -> tuple[float, float] | None:
        """Return the half axes of the ellipse that holds the frequencies of an image, in cycles per pixel of it."""
        sight = self.sight(colour, image)
        down, across = (2 * half / sight.box(axis) for axis, half in enumerate(sight.pupil()[1]))
        return down, across

    def aperture(self, colour: int, image: int) -> tuple[torch.Tensor, torch.Tensor, bool]:
        """Return the middle and half widths of a pupil in metres, which is round."""
        middle, halves = (torch.tensor(part, dtype=torch.float64) for part in self.sight(colour, image).pupil())
        return middle, halves, True

    def nearness(self, depths: torch.Tensor | None) -> torch.Tensor:
        """Return the reciprocal of distances from the plane of the pupils, infinity included, in 1/m."""
        if depths is None:
            _, b, d = self.sight(0, 0).ray_matrix()
            return torch.tensor(d / b, dtype=torch.float64)
        if not bool((depths > 0).all()):
            raise ValueError(f"depth must be positive distances from the pupils, got {float(depths.min()):.4g} m")
        return 1 / depths

    def displaced(self, colour: int, image: int, nearness: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
        """Return by how many pixels points appear beside where a pupil on the axis sees them, ``[N, L, 2]``.

        The panel's pixel D·q + B·t is seen through q with the slope t, a point X of nearness s with t = (X − q)·s. The
        eye brings together what is at its focus: beside the middle p of its pupil it bends a ray by (q − p)/focus.
        """
        sight = self.sight(colour, image)
        (_, b, d), (middle, _, _) = sight.ray_matrix(), self.aperture(colour, image)
        beside = (rays - middle)[:, None] * (d - sight.defocus() * b)
        moved = d * middle + beside - b * nearness[:, None] * rays[:, None]
        return moved / torch.tensor(self.pitches, dtype=torch.float64)

    def _checked(self) -> int:
        """Return how many points of a pixel describe what eyes see; warn where they see no image of the panel."""
        sights = [self.sight(c, e) for c in range(len(self.wavelengths)) for e in range(len(self.ends))]
        worst = min(sights, key=Sight.seen)
        if self.iris == "order" and worst.seen() < 1:
            place = ", ".join(f"{1e3 * p:.3g}" for p in worst.eyes.positions[worst.eye])
            wide = 1e3 * min(map(worst.box, (0, 1)))
            warn(
                f"the light of {1 - worst.seen():.0%} of the rows or columns of the panel passes by the pupil at "
                f"({place}) mm at {1e9 * worst.wavelength:.4g} nm: one order is {wide:.3g} mm wide there",
                SamplingWarning,
            )
        check_blur(max(map(Sight.blur, sights)), worst.sizes, worst.pitches)
        return max(map(Sight.samples, sights))

    def _behind(self, light):
        """Return the light that leaves the panel, of each cell of its mask if it has one."""
        return light if self.expander is None else self.expander.behind(light, self.cells)

    def _seen(self, kept, light, colour, eye):
        """Return the field on a retina at the points of a pixel, ``[..., samples, samples, rows, columns]``."""
        down, across = self._parts(kept, light, colour, eye, (3, 4))
        seen = (down @ self._in_pupil(kept, light, colour, eye) @ across.mT)[..., 0, :, :]
        points = seen.unflatten(-2, (-1, self.samples)).unflatten(-1, (-1, self.samples))
        return points.movedim((-3, -1), (-4, -3))

    def _back(self, kept, amplitudes, light, colour, eye):
        """Return the light on the panel, by the adjoint, of the image of an eye with its amplitudes replaced."""
        down, across = self._to_middles(kept, light, colour, eye)
        shown = amplitudes * unit_phasor(self._in_middles(kept, light, colour, eye).angle())
        return self._from_pupil(kept, down.mH @ shown @ across.conj(), light, colour, eye)

    def _in_middles(self, kept, light, colour, eye):
        """Return the field on a retina at the middles of pixels."""
        down, across = self._to_middles(kept, light, colour, eye)
        return down @ self._in_pupil(kept, light, colour, eye) @ across.mT

    def _to_middles(self, kept, light, colour, eye):
        """Return the matrices that lead from the pupil to the middles of pixels, of rows and of columns."""
        down, across = self._parts(kept, light, colour, eye, (3, 4))
        rows, columns = (slice(REACH * self.samples, (REACH + n) * self.samples, self.samples) for n in self.sizes)
        return down[rows], across[columns]

    def _in_pupil(self, kept, light, colour, eye):
        """Return the field that a pupil passes, at its points."""
        down, across, pupil = self._parts(kept, light, colour, eye, (0, 1, 2))
        return (down @ light @ across.mT) * pupil

    def _from_pupil(self, kept, there, light, colour, eye):
        """Return the light on the panel, by the adjoint, of a field behind a pupil; `light` tells its dtype."""
        down, across, pupil = self._parts(kept, light, colour, eye, (0, 1, 2))
        return down.mH @ (there * pupil.conj()) @ across.conj()

    def _parts(self, kept, light, colour, eye, which):
        """Return some :meth:`odak.learn.wave.eyes.Sight.part` as tensors."""
        return [kept(RetinaPath._of_eye, self, colour, eye, part, light.dtype) for part in which]

    def _of_eye(self, device, colour, eye, part, dtype):
        return torch.from_numpy(self.sight(colour, eye).part(part, self.samples, REACH)).to(device, dtype)
