"""Rays from field points towards the entrance pupil."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import torch

from odak import _validate
from odak._array import is_readable
from odak.learn._tensors import checked_dtype
from odak.learn.raytracing.system.lens import checked_system
from odak.learn.raytracing.system.paraxial import entrance_pupil
from odak.learn.raytracing.system.prescription import Prescription, checked_prescription
from odak.learn.raytracing.system.pupils import PATTERNS, pupil_samples

AIMS = ("paraxial", "real")


class Rays(NamedTuple):
    """Rays in front of a system, each component ``[..., wavelengths or 1, fields, pupil points]``.

    Attributes
    ----------
    x, y, z : torch.Tensor
        Points, from the first vertex.
    u, v, w : torch.Tensor
        Direction cosines along x, y, z.
    """

    x: torch.Tensor
    y: torch.Tensor
    z: torch.Tensor
    u: torch.Tensor
    v: torch.Tensor
    w: torch.Tensor

    @classmethod
    def from_tensor(cls, ray: torch.Tensor) -> "Rays":
        """Return rays ``[..., 2, 3]`` (points and directions of any length) as components ``[1, 1, rays]``."""
        if ray.shape[-2:] != (2, 3):
            raise ValueError(f"ray must be [..., 2, 3], got {tuple(ray.shape)}")
        ray = ray.reshape(1, 1, -1, 2, 3)
        length = ray[..., 1, :].square().sum(-1, keepdim=True)
        exists = length > 0
        # A direction of length zero is no ray: NaN, which the tracer reports as a miss.
        unit = torch.where(exists, ray[..., 1, :] / torch.where(exists, length, 1.0).sqrt(), torch.nan)
        return cls(*ray[..., 0, :].unbind(-1), *unit.unbind(-1))

    def to_tensor(self) -> torch.Tensor:
        """Return the rays as ``[..., 2, 3]``, for the functions of :mod:`odak.learn.raytracing`."""
        parts = torch.broadcast_tensors(*self)
        return torch.stack([torch.stack(parts[:3], -1), torch.stack(parts[3:], -1)], -2)


def launch(
    system: Any,
    pupil: str | torch.Tensor = "rings",
    count: int = 6,
    *,
    fields: Any = None,
    prescription: Prescription | None = None,
    aim: str = "paraxial",
    dtype: torch.dtype = torch.float64,
) -> Rays:
    """Return rays from each field point through points of the entrance pupil.

    Parameters
    ----------
    system : optical_system
        The system.
    pupil : str or torch.Tensor
        Pattern as in :func:`pupil_samples`, or points ``[P, 2]`` in units of the pupil's radius.
    count : int
        As in :func:`pupil_samples`.
    fields : sequence of pairs or torch.Tensor, optional
        Field points (x, y), or ``[F, 2]``, in place of the system's.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps.
    aim : str
        "paraxial": at the paraxial entrance pupil. "real": so that the rays meet the stop at the points asked for,
        at the reference wavelength; solved by a few Newton steps, differentiable.
    dtype : torch.dtype
        Precision of the rays; they are computed in float64.

    Returns
    -------
    Rays
        ``[..., 1, F, P]``, the first axes those of the batch of systems. For an object at infinity they start in the
        plane of the first vertex. Pupil points are heights in the entrance pupil, for a near object slopes of rays: the
        same up to a factor, but defined for a pupil at infinity too.
    """
    aim, dtype = _validate.one_of("aim", aim, AIMS), checked_dtype("dtype", dtype)
    checked_prescription(prescription)
    points = pupil_of(pupil, count, system)
    chosen = field_points(system, fields).to(points.device)[:, None]
    rays = through_pupil(system, points, chosen, prescription, aim)
    return rays if dtype == torch.float64 else Rays(*(value.to(dtype) for value in rays))


def field_points(system, fields=None) -> torch.Tensor:
    """Return field points ``[F, 2]`` in float64, the system's own by default."""
    if isinstance(fields, torch.Tensor):
        if fields.ndim != 2 or fields.shape[-1] != 2 or len(fields) == 0:
            raise ValueError(f"fields must be [F, 2], got {tuple(fields.shape)}")
        return _validate.real("fields", fields).double()
    if fields is not None and (isinstance(fields, str) or not isinstance(fields, Iterable)):
        raise TypeError(f"fields must be a sequence of pairs (x, y), got {type(fields).__name__}")
    pairs = [_validate.several("fields", point, 2) for point in (system.fields if fields is None else fields)]
    if not pairs:
        raise ValueError("fields must hold at least one pair (x, y)")
    return torch.tensor(pairs, dtype=torch.float64)


def through_pupil(system, points: torch.Tensor, fields: torch.Tensor, prescription, aim: str) -> Rays:
    """Return rays through points of the pupil, ``[P, 2]`` or ``[..., F, P, 2]``, from field points ``[F, 1, 2]``."""
    pupil = entrance_pupil(system, prescription=prescription)
    through = starter(system, fields, pupil)
    reach = pupil.reach[..., None, None, None]
    place = reach * points[..., 0], reach * points[..., 1]
    if aim == "real":
        from odak.learn.raytracing.system.aiming import aimed

        place = aimed(system, prescription, pupil, points, place, through)
    return through(*place)


def starter(system, fields: torch.Tensor, pupil):
    """Return the function that makes rays of places in the entrance pupil, as its `reach` has them."""
    distance, bend = (value[..., None, None, None] for value in (pupil.distance, pupil.bend))
    if system.at_infinity:
        return lambda px, py: _far(fields, distance, px, py)
    return lambda sx, sy: _near(system, fields, bend, sx, sy)


def pupil_of(pupil, count: int, system) -> torch.Tensor:
    """Return the points of a pupil, from the name of a pattern or as given."""
    checked_system(system)
    device = system.surfaces[0].thickness.device
    if isinstance(pupil, str):
        return pupil_samples(_validate.one_of("pupil", pupil, PATTERNS), count, device=device)
    if not isinstance(pupil, torch.Tensor) or pupil.ndim != 2 or pupil.shape[-1] != 2:
        raise ValueError("pupil must be the name of a pattern or a tensor [P, 2]")
    return pupil.to(device=device, dtype=torch.float64)


def _far(fields, distance, px, py) -> Rays:
    """Return rays of distant points through points of the plane of the entrance pupil."""
    if is_readable(fields) and bool((fields.abs() >= 90).any()):
        raise ValueError(f"fields must be below 90 degrees from the axis, got {fields.abs().max().item():g}")
    tangent = torch.tan(torch.deg2rad(fields))
    tx, ty = tangent[..., 0], tangent[..., 1]
    w = 1 / (1 + tx * tx + ty * ty).sqrt()
    x, y = px - distance * tx, py - distance * ty
    u, v, w = (value.expand(x.shape) for value in (tx * w, ty * w, w))
    return Rays(x, y, torch.zeros_like(x), u, v, w)


def _near(system, fields, bend, sx, sy) -> Rays:
    """Return rays of near points whose slopes are those given less the field's own towards the pupil's centre."""
    sx, sy = sx - bend * fields[..., 0], sy - bend * fields[..., 1]
    w = 1 / (1 + sx * sx + sy * sy).sqrt()
    x, y = (fields[..., i].expand(sx.shape) for i in range(2))
    return Rays(x, y, torch.full_like(sx, -system.object_distance), sx * w, sy * w, w)
