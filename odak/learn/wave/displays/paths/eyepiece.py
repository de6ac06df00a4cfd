"""Light from a panel through an eyepiece of traced rays to the retinas of eyes. Touches the light it is given."""

import copy
import dataclasses
import math
import warnings
from typing import Any, ClassVar

import numpy as np
import torch

from odak._array import phasor_of_cycles
from odak._warnings import AccuracyWarning
from odak.learn.wave.displays.observers import REACH
from odak.learn.wave.displays.panels import Modulator
from odak.learn.wave.displays.paths.retina import RetinaPath
from odak.learn.wave.eyes import Eyepiece, Eyes, Sight

# Pixels beyond each rim of the panel in which the light that a stop spreads is followed, less and less of it.
_RIM = 32
# Times the width of what is lit of a pupil in first order, up to which light is followed.
_BEYOND = 1.1
# Wavelengths to which paths are to be known, and points of the panel along an axis that are traced for it at most.
_SURE, _MOST = 3e-3, 15


@dataclasses.dataclass(frozen=True)
class EyepiecePath(RetinaPath):
    """Light of one order that eyes see through a traced lens system: paths by rays, diffraction by waves.

    Where a number of the system requires a gradient, its rays are traced anew for each call, and images have its
    gradient; otherwise they are traced once. What rays tell is no tensor that a graph of `torch.compile` could hold.
    """

    where: ClassVar[str] = "where eyes look on through an eyepiece"

    def __post_init__(self) -> None:
        if self.iris != "order":
            raise ValueError(f"iris must be 'order' for eyes behind a traced eyepiece, got {self.iris!r:.80}")
        super().__post_init__()

    @classmethod
    def leads(cls, modulator: Modulator, ends: Any) -> bool:
        """Say whether the light of a modulator takes this kind of path to the images."""
        return isinstance(ends, Eyes) and isinstance(ends.distance, Eyepiece)

    def _in_pupil(self, kept, light, colour, eye):
        system = self.ends.distance.system
        element, sides, passage = kept(EyepiecePath._traced, self, colour, eye)
        if any(number.requires_grad for number in system.parameters()):
            passage = self._passage(element, colour, eye)
        (pupil,) = self._parts(kept, light, colour, eye, (2,))
        return torch.nn.functional.pad(passage(self._stopped(kept, light, colour, eye)), sides) * pupil

    def _from_pupil(self, kept, there, light, colour, eye):
        with torch.enable_grad():
            probe = torch.zeros_like(light).requires_grad_()
            (back,) = torch.autograd.grad(self._in_pupil(kept, probe, colour, eye), probe, there)
        return back

    def _parts(self, kept, light, colour, eye, which):
        """Return some of three parts as tensors: what the pupil passes, 2, and the matrices to the retina, 3 and 4."""
        return [kept(EyepiecePath._of_eye, self, colour, eye, part, light.dtype) for part in which]

    def _of_eye(self, device, colour, eye, part, dtype):
        found, sight = self.sight(colour, eye).part(part, self.samples, REACH), self.sight(colour, eye)
        return torch.from_numpy(found * _without_curvature(sight) if part == 2 else found).to(device, dtype)

    def _traced(self, device, colour, eye):
        """Return the eyepiece with as many rays as its paths need, dark points around its window, and its passage.

        The window is what may be lit of a pupil.
        """
        sight, element = self.sight(colour, eye), self.ends.distance
        if element.system.surfaces[0].thickness.device != device:
            element = dataclasses.replace(element, system=copy.deepcopy(element.system).to(device))
        window, sides = {"output_dx": (), "output_shape": (), "output_center": ()}, []
        for axis in (0, 1):
            (points, step), middle = sight.points(axis), sight.pupil()[0][axis]
            lit = np.flatnonzero(abs(points + middle) <= self._reach(colour, eye, axis))
            first, count = (int(lit[0]), len(lit)) if len(lit) else (0, 1)
            sides = [first, len(points) - first - count, *sides]
            for name, value in zip(window, (step, count, middle + float(points[first + count // 2])), strict=True):
                window[name] += (value,)
        element = dataclasses.replace(element, **window)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AccuracyWarning)
            while self._passage(element, colour, eye).error > _SURE and max(element.grid) < _MOST:
                more = {"grid": tuple(n + 2 for n in element.grid), "points": element.points + 2}
                element = dataclasses.replace(element, **more)
        return element, sides, self._passage(element, colour, eye)

    def _passage(self, element, colour, eye):
        """Return what a traced system does to light behind the stop."""
        counts, steps = zip(*(self._samples(colour, eye, axis) for axis in (0, 1)), strict=True)
        return element.passage(counts, steps, self.wavelengths[colour])

    def _reach(self, colour, eye, axis):
        """Return how far from the axis light of the panel reaches in the plane of the pupil, in metres.

        Beyond what the order of the outermost pixels reaches, the light of which the lens may turn a little more, the
        pupil is dark.
        """
        sight, n, pitch = self.sight(colour, eye), self.sizes[axis], self.pitches[axis]
        return _BEYOND * (sight.box(axis) / 2 + abs(sight.ray_matrix()[0]) * (n / 2 + _RIM) * pitch)

    def _samples(self, colour, eye, axis):
        """Return how many samples along an axis the light behind the stop gets, and how far apart they are in metres.

        One for each pixel holds it. Where the pupil reaches beyond the order of a pixel, more of them keep the next
        order of the samples, which the stop does not pass, away from the pupil.
        """
        sight, n, pitch = self.sight(colour, eye), self.sizes[axis] + 2 * _RIM, self.pitches[axis]
        points, middle = sight.points(axis)[0], sight.pupil()[0][axis]
        far = min(abs(middle) + points[-1], self._reach(colour, eye, axis))
        furthest = _BEYOND * (far + abs(sight.ray_matrix()[0]) * n / 2 * pitch) / sight.box(axis)
        finer = max(1.0, 2 * furthest)
        return math.ceil(n * finer), pitch / finer

    def _stopped(self, kept, light, colour, eye):
        """Return the light of square pixels behind the stop."""
        down, across = (kept(EyepiecePath._stop, self, colour, eye, axis, light.dtype) for axis in (0, 1))
        return down @ light @ across.mT

    def _stop(self, device, colour, eye, axis, dtype):
        """Return the matrix from pixels to samples behind the stop along an axis.

        The stop turns a pixel, of even light, into sinc functions about each of its points. A sharp stop spreads light
        far. What is cut off of it blurs the ends of its frequencies; fading blurs evenly.
        """
        n, pitch = self.sizes[axis], self.pitches[axis]
        count, step = self._samples(colour, eye, axis)
        places = (np.arange(count) - count // 2)[:, None] * (step / pitch)
        nodes, weights = np.polynomial.legendre.leggauss(8)
        pixel = sum(
            weight / 2 * np.sinc(places - (np.arange(n) - n // 2) - math.sqrt(self.fill) / 2 * node)
            for node, weight in zip(nodes, weights, strict=True)
        )
        fade = 0.5 + 0.5 * np.cos(np.pi * np.clip((abs(places) - n / 2) / _RIM, 0, 1))
        return torch.from_numpy(pixel * fade).to(device, dtype)


def _without_curvature(sight: Sight) -> np.ndarray:
    """Return the factor that takes from light in a pupil the curvature that a pixel on the axis has in first order.

    It has the scale of the fields of a :class:`Sight` in the pupil, without the 1/(λB) of Fresnel's integral.
    """
    _, b, d = sight.ray_matrix()
    down, across = (sight.points(axis)[0] + middle for axis, middle in enumerate(sight.pupil()[0]))
    turn = -d / (2 * sight.wavelength * b) * (down[:, None] ** 2 + across**2)
    return phasor_of_cycles(turn) * (sight.wavelength * abs(b) / math.prod(sight.pitches))
