"""The map from the pupil of a system to a plane behind it: where rays meet the plane, by which path, how spread."""

from typing import Any, NamedTuple

import torch

from odak.learn.raytracing.system.aiming import aimed, at_stop, solve_pairs
from odak.learn.raytracing.system.launching import starter
from odak.learn.raytracing.system.paraxial import entrance_pupil
from odak.learn.raytracing.system.pupils import pupil_samples
from odak.learn.raytracing.system.tracing import trace
from odak.learn.raytracing.system.wavefronts import path_at_start
from odak.raytracing.status import RayStatus

# Rays that the map is first guessed from, and the degree of the polynomials that guess it.
RINGS, DEGREE = 10, 7
# Along which differences are taken, in radii of the pupil: their error is its square, rounding's its inverse.
STEP = 3e-4


class Met(NamedTuple):
    """Rays where they meet the plane, each ``[..., P]``.

    Attributes
    ----------
    x, y : torch.Tensor
        Along the plane's axes, from the chief ray.
    u, v, cosine : torch.Tensor
        Direction cosines along the plane's axes and its normal.
    path : torch.Tensor
        Optical path less that of the chief ray.
    status : torch.Tensor
        As in Traced.
    """

    x: torch.Tensor
    y: torch.Tensor
    u: torch.Tensor
    v: torch.Tensor
    cosine: torch.Tensor
    path: torch.Tensor
    status: torch.Tensor


class RayMap:
    """Rays of one field point at one wavelength, from pupil coordinates to a plane behind the system.

    Parameters
    ----------
    system : optical_system
        The system.
    prescription : Prescription or None
        Its numbers, of all wavelengths; None for its own.
    place : int
        Which of the wavelengths.
    field : torch.Tensor
        Field point ``[2]``.
    distance : float or torch.Tensor
        From the last vertex to where the plane crosses the chief ray, along z.
    across : bool
        Turn the plane's normal to the chief ray rather than to the axis.
    """

    def __init__(self, system, prescription, place: int, field: torch.Tensor, distance, across: bool):
        numbers = system.prescription() if prescription is None else prescription
        self.system, self.prescription = system, prescription
        place = place if numbers.index.shape[-2] > 1 else 0
        self.numbers = numbers._replace(index=numbers.index[..., place : place + 1, :])
        self.pupil = entrance_pupil(system, prescription=prescription)
        self.through = starter(system, field.reshape(1, 1, 2), self.pupil)
        self.origin: Any = None
        self.axes: Any = None
        self.chief: Any = 0.0
        chief = self._traced(torch.zeros(1, 2, dtype=torch.float64, device=field.device), False)
        height = distance - numbers.thickness[..., -1]
        self._place(chief, height, across)

    def _place(self, chief, height, across: bool) -> None:
        """Lay the plane: its origin on the chief ray, its axes next to x and y."""
        point, direction = torch.stack(chief[:3], -1), torch.stack(chief[3:6], -1)
        along = (height[..., None] - point[..., 2]) / direction[..., 2]
        self.origin = point + along[..., None] * direction
        ways = torch.eye(3, dtype=point.dtype, device=point.device).expand(*direction.shape[:-1], 3, 3)
        normal = direction if across else ways[..., 2] * torch.sign(direction[..., 2:]).detach()
        x = _unit(ways[..., 0] - ways[..., 0].mul(normal).sum(-1, keepdim=True) * normal)
        y = ways[..., 1] - ways[..., 1].mul(normal).sum(-1, keepdim=True) * normal
        y = _unit(y - y.mul(x).sum(-1, keepdim=True) * x)
        self.axes = x, y, normal
        self.to_image = ((point - self.origin) * normal).sum(-1)[..., 0]
        # Zero where the map's path is measured from.
        self.chief = self(torch.zeros(1, 2, dtype=point.dtype, device=point.device)).path

    def _traced(self, places: torch.Tensor, vignetting: bool):
        reach = self.pupil.reach[..., None, None, None]
        places = places[..., None, None, :, :]
        rays = self.through(reach * places[..., 0], reach * places[..., 1])
        found = trace(self.system, rays, prescription=self.numbers, vignetting=vignetting)
        total = found.path + path_at_start(self.system, rays, self.numbers)
        return type(found)(*(value[..., 0, 0, :] for value in found._replace(path=total)))

    def __call__(self, places: torch.Tensor, vignetting: bool = False) -> Met:
        """Return where rays meet the plane.

        Parameters
        ----------
        places : torch.Tensor
            Pupil coordinates ``[..., P, 2]``: 1 at the rim of the paraxial entrance pupil.
        vignetting : bool
            Let semi-diameters block rays.
        """
        found = self._traced(places, vignetting)
        # Lost rays are computed with as if they were on the axis, so that nothing that is no number enters a gradient.
        lost = found.status != RayStatus.HIT
        alike = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
        held = [torch.where(lost, dummy, value) for dummy, value in zip(alike, found, strict=False)]
        found = type(found)._make([*held, found.status])
        point, direction = torch.stack(found[:3], -1) - self.origin, torch.stack(found[3:6], -1)
        u, v, cosine = ((direction * axis).sum(-1) for axis in self.axes)
        distance = -(point * self.axes[2]).sum(-1) / cosine
        x, y = ((point * axis).sum(-1) + distance * slope for axis, slope in zip(self.axes, (u, v), strict=False))
        path = found.path + self.numbers.index[..., 0, -1:] * distance - self.chief
        met = [torch.where(lost, torch.nan, value) for value in (x, y, u, v, cosine, path)]
        return Met._make([*met, found.status])

    def samples(self, aim: str) -> torch.Tensor:
        """Return places ``[..., P, 2]`` all over the pupil, its rim included."""
        points = pupil_samples("rings", RINGS, device=self.pupil.reach.device)
        return points if aim == "paraxial" else self._aimed(points)

    def _aimed(self, points: torch.Tensor) -> torch.Tensor:
        reach = self.pupil.reach[..., None, None, None]
        start = reach * points[..., 0], reach * points[..., 1]
        place = aimed(self.system, self.prescription, self.pupil, points, start, self.through)
        return torch.stack([value[..., 0, 0, :] / reach[..., 0, 0, :] for value in place], -1)

    def in_stop(self, places: torch.Tensor, aim: str) -> torch.Tensor:
        """Return the coordinates by which the pupil ends at 1: of the paraxial pupil, or of the stop itself."""
        if aim == "paraxial":
            return places
        reach, radius = (value[..., None, None, None] for value in (self.pupil.reach, self.pupil.stop_radius))
        places = places[..., None, None, :, :]
        x, y, _ = at_stop(self.system, self.prescription, self.through(reach * places[..., 0], reach * places[..., 1]))
        return (torch.stack([x, y], -1) / radius[..., None])[..., 0, 0, :, :]

    def slopes(self, places: torch.Tensor):
        """Return the derivatives of (x, y) by the two pupil coordinates, and the mean place they were taken about."""
        met = self(_around(places))
        x, y = (value.reshape(*value.shape[:-1], 4, -1) for value in met[:2])
        by = [[(value[..., i, :] - value[..., i + 1, :]) / (2 * STEP) for value in (x, y)] for i in (0, 2)]
        return *by, [(value[..., 0, :] + value[..., 1, :]) / 2 for value in (x, y)]

    def radius(self, places: torch.Tensor, aim: str):
        """Return the radius that ends at 1 at the pupil's rim, and its derivatives by the two pupil coordinates."""
        radius = self._length(places, aim)
        if aim == "paraxial":
            return radius, *(value / radius for value in places.unbind(-1))
        there = self._length(_around(places), aim)
        there = there.reshape(*there.shape[:-1], 4, -1)
        return radius, *((there[..., i, :] - there[..., i + 1, :]) / (2 * STEP) for i in (0, 2))

    def _length(self, places: torch.Tensor, aim: str) -> torch.Tensor:
        # At the centre the root has no gradient; nothing depends on it there.
        return self.in_stop(places, aim).square().sum(-1).clamp(min=1e-12).sqrt()

    def solve(self, target: torch.Tensor, guess: torch.Tensor) -> torch.Tensor:
        """Return the places whose rays meet the points `target`, ``[P, 2]`` of the plane."""

        def missed(x, y):
            met = self(torch.stack([x, y], -1))
            kept = met.status == RayStatus.HIT
            return [torch.where(kept, a - b, 0.0) for a, b in zip(met[:2], target.unbind(-1), strict=True)]

        return torch.stack(solve_pairs(missed, guess[..., 0], guess[..., 1], torch.full_like(guess[..., 0], STEP)), -1)

    def guess(self, places: torch.Tensor, met: Met, target: torch.Tensor) -> torch.Tensor:
        """Return about where the rays through `target` start, by polynomials through the samples."""
        size = torch.maximum(met.x.abs(), met.y.abs()).nan_to_num().amax(-1, keepdim=True)
        kept = (met.status == RayStatus.HIT)[..., None]
        basis = torch.where(kept, _powers(met.x / size, met.y / size), 0.0)
        found = torch.linalg.lstsq(basis, torch.where(kept, places, 0.0).expand(*basis.shape[:-1], 2)).solution
        here = target / size[..., None]
        return _powers(here[..., 0].clamp(-1.3, 1.3), here[..., 1].clamp(-1.3, 1.3)) @ found


def _around(places: torch.Tensor) -> torch.Tensor:
    """Return the neighbours of places ``[..., P, 2]`` on both sides along both axes, ``[..., 4P, 2]``."""
    steps = STEP * torch.tensor([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]], dtype=places.dtype).to(places)
    return (places[..., None, :, :] + steps[:, None, :]).reshape(*places.shape[:-2], -1, 2)


def _unit(vector: torch.Tensor) -> torch.Tensor:
    return vector / vector.square().sum(-1, keepdim=True).sqrt()


def _powers(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Return all products xⁱyʲ up to the degree."""
    terms = [x.nan_to_num() ** i * y.nan_to_num() ** j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    return torch.stack(terms, -1)
