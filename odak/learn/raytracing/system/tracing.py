"""Traces rays through an optical system, to the image surface or to any surface."""

import math
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch

from odak import _array, _show, _torch_private, _validate
from odak._array import is_readable
from odak.learn.raytracing.system.fused import Trace
from odak.learn.raytracing.system.prescriptions import Prescription
from odak.learn.raytracing.system.sequence import (
    HIT,
    Layout,
    State,
    flat_arguments,
    placement,
    plain_trace,
    points_within,
)
from odak.learn.raytracing.system.surfaces import (
    checked_system,
    coordinate_break,
    layout_of,
    numbers_of,
    optical_system,
)
from odak.raytracing.batches import in_pieces, needs_gradient

# Rays of a block of plain operations: its graph, a few kilobytes per ray, takes some tens of megabytes.
BLOCK = 1 << 14
# Up to this number of rays, what an operation costs is to begin it.
FEW = 1 << 12


@_show.shown
class Rays(NamedTuple):
    """Rays in front of a system, each component ``[..., wavelengths or 1, fields, pupil points]``.

    Attributes
    ----------
    x, y, z : torch.Tensor
        Points, from the first vertex.
    u, v, w : torch.Tensor
        Direction cosines along x, y, z; infinite for rays that could not be aimed.

    Examples
    --------
    Direction cosines are the components of unit vectors:

    >>> from odak.learn.raytracing.system import Rays, launch, load_system
    >>> lens = load_system("cooke_triplet")
    >>> rays = launch(lens, "y", 3)
    >>> bool(abs(rays.u**2 + rays.v**2 + rays.w**2 - 1).max() < 1e-12)
    True
    """

    x: torch.Tensor
    y: torch.Tensor
    z: torch.Tensor
    u: torch.Tensor
    v: torch.Tensor
    w: torch.Tensor

    @classmethod
    def from_tensor(cls, ray: torch.Tensor) -> "Rays":
        """Return rays ``[..., 2, 3]`` (points and directions of any length) as components ``[1, 1, rays]``.

        Parameters
        ----------
        ray : torch.Tensor
            Points and directions ``[..., 2, 3]``; a direction of length 0 marks a missing ray.
        """
        _validate.shaped("ray", ray, "[..., 2, 3]")
        ray = ray.reshape(1, 1, -1, 2, 3)
        length = ray[..., 1, :].square().sum(-1, keepdim=True)
        exists = length > 0
        # A direction of length zero is no ray: NaN, which the trace reports as a miss.
        unit = torch.where(exists, ray[..., 1, :] / torch.where(exists, length, 1.0).sqrt(), torch.nan)
        return cls(*ray[..., 0, :].unbind(-1), *unit.unbind(-1))

    def to_tensor(self) -> torch.Tensor:
        """Return the rays as ``[..., 2, 3]``, for the functions of :mod:`odak.learn.raytracing`."""
        parts = torch.broadcast_tensors(*self)
        return torch.stack([torch.stack(parts[:3], -1), torch.stack(parts[3:], -1)], -2)


@_show.shown
class Traced(NamedTuple):
    """Rays at the end of a trace, each component ``[..., wavelengths, fields, pupil points]``; NaN where lost.

    Attributes
    ----------
    x, y, z : torch.Tensor
        Points, from the vertex of the last plane or surface.
    u, v, w : torch.Tensor
        Direction cosines.
    path : torch.Tensor
        Optical path from the rays' start.
    status : torch.Tensor
        int8, numbers of :class:`odak.raytracing.RayStatus`: what befell the ray first.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Traced, launch, load_system, trace
    >>> lens = load_system("cooke_triplet")
    >>> traced = trace(lens, launch(lens, "y", 3))
    >>> bool(abs(traced.u**2 + traced.v**2 + traced.w**2 - 1).max() < 1e-12)
    True
    """

    x: torch.Tensor
    y: torch.Tensor
    z: torch.Tensor
    u: torch.Tensor
    v: torch.Tensor
    w: torch.Tensor
    path: torch.Tensor
    status: torch.Tensor

    @property
    def arrived(self) -> torch.Tensor:
        """Whether the ray reached the last surface, bool."""
        return self.status == HIT

    def to_tensor(self) -> torch.Tensor:
        """Return the rays as ``[..., 2, 3]``."""
        return torch.stack([torch.stack(self[:3], -1), torch.stack(self[3:6], -1)], -2)


# In signatures: rays as :func:`launch` returns them, or points and directions ``[..., 2, 3]``.
RaysLike: TypeAlias = Rays | torch.Tensor


@_validate.takes_units()
def trace(
    system: optical_system,
    rays: RaysLike,
    *,
    prescription: Prescription | None = None,
    until: int | None = None,
    vignetting: bool = True,
) -> Traced:
    """Trace rays through a system.

    Parameters
    ----------
    system : optical_system
        The system.
    rays : Rays or torch.Tensor
        From :func:`launch`, or ``[..., 2, 3]``, points from the first vertex; float32 or float64.
    prescription : Prescription, optional
        Numbers in place of the system's own; a batch of systems ``[...]`` is traced in one call.
    until : int, optional
        Surface to stop behind; the image plane by default.
    vignetting : bool
        Let apertures block rays.

    Returns
    -------
    Traced
        ``[..., W, F, P]``, in the precision of the rays, in the frame of the last surface's axis. Differentiable in
        rays and numbers, twice; rays that are lost are NaN, with a status and without gradient.

    Raises
    ------
    ValueError, TypeError
        If the rays are of a form or dtype that is not understood, or do not match the batch of systems.

    Notes
    -----
    Sequences of planes, conics and even aspheres without tilts go through a fused kernel, in blocks that fit into the
    cache; all others through the intersections and interfaces of :mod:`odak.raytracing`, block by block, a few thousand
    rays without derivatives in NumPy. For gradients only the rays that enter are kept (and their statuses). Under
    torch.func, autograd keeps what it needs.

    Examples
    --------
    >>> from odak.learn.raytracing.system import launch, load_system, trace
    >>> lens = load_system("cooke_triplet")
    >>> traced = trace(lens, launch(lens, "y", 3))
    >>> bool((traced.status == 0).all())
    True
    """
    # Reading the system and the threads cannot be part of a graph of torch.compile.
    return _array.outside_graphs(_trace, system, rays, prescription, until, vignetting)


def _trace(system, rays, prescription, until, vignetting):
    numbers = numbers_of(system, prescription)
    vignetting = _validate.flag("vignetting", vignetting)
    rays = checked_rays(rays)
    _validate.one_device(**rays._asdict(), system=numbers.curvature)
    layout = layout_of(system.surfaces, numbers, system.image, vignetting)
    held = numbers.numbers(system.image)
    if until is not None:
        last = _validate.place_in("until", until, len(system.surfaces)) + 1
        held, layout = held.first(last, layout), layout.first(last)
    flat, shape = spread_rays(rays, numbers)
    if layout.standard and _torch_private.takes_operators(*flat, *held[:5]):
        found = Trace.apply(layout, *flat, *held[:5])
    else:
        given, ranks = flat_arguments(layout, held)
        if flat[0].numel() <= FEW and not (layout.placed or layout.media or _followed(*flat, *given)):
            return finished(_by_numpy(layout, *flat, *given), shape)
        state = in_pieces(partial(plain_trace, layout), (0,) * 6 + tuple(ranks), *flat, *given, size=BLOCK)
        return finished(state, shape)
    return Traced(*(value.reshape(shape) for value in found))


def _followed(*values: torch.Tensor) -> bool:
    """Return whether tensors are not on the processor, or derivatives of them are recorded."""
    return needs_gradient(*values) or any(value.device.type != "cpu" or not is_readable(value) for value in values)


@np.errstate(all="ignore")
def _by_numpy(layout: Layout, *tensors: torch.Tensor) -> State:
    """Return what :func:`plain_trace` does, computed by NumPy, which begins an operation in a fraction of the time."""
    state = plain_trace(layout, *(value.detach().resolve_neg().numpy() for value in tensors))
    return State(*(torch.from_numpy(np.ascontiguousarray(value)) for value in state))


def checked_rays(rays: RaysLike) -> Rays:
    """Return rays as components, given as Rays or as a tensor ``[..., 2, 3]``; TypeError for anything else."""
    if isinstance(rays, torch.Tensor):
        rays = Rays.from_tensor(rays)
    _validate.instance("rays", rays, Rays, "Rays or a tensor [..., 2, 3]")
    if len({value.dtype for value in rays}) > 1 or rays.x.dtype not in (torch.float32, torch.float64):
        raise TypeError(f"rays must all be float32 or all float64, got {[str(value.dtype) for value in rays]}")
    return rays


def spread_rays(rays: Rays, numbers: Prescription) -> tuple[list[torch.Tensor], tuple[int, ...]]:
    """Return the components of rays as ``[B, R]`` for :func:`plain_trace`, and the shape ``[..., W, F, P]``."""
    shape = _shape(rays, numbers)
    return [value.expand(shape).reshape(math.prod(shape[:-2]), math.prod(shape[-2:])) for value in rays], shape


def finished(state: Any, shape: tuple[int, ...]) -> Traced:
    """Return the rays of :func:`plain_trace` in their own shape, NaN where lost."""
    found = (*(torch.where(state.status == HIT, value, torch.nan) for value in state[:7]), state.status)
    return Traced(*(value.reshape(shape) for value in found))


def ray_paths(system: optical_system, rays: Rays, *, prescription: Prescription | None = None) -> torch.Tensor:
    """Return the points of rays at all surfaces in global coordinates, whose origin is the first vertex.

    Parameters
    ----------
    system : optical_system
        The system.
    rays : Rays
        From :func:`launch`.
    prescription : Prescription, optional
        Numbers in place of the system's own, of one system.

    Returns
    -------
    torch.Tensor
        ``[W, F, P, S + 2, 3]``: the start, each surface (coordinate breaks left as the surface before), the image; NaN
        from where a ray is lost.

    Examples
    --------
    >>> from odak.learn.raytracing.system import launch, load_system, ray_paths
    >>> lens = load_system("cooke_triplet")
    >>> points = ray_paths(lens, launch(lens, "y", 3))
    >>> points.shape[-2] == len(lens.surfaces) + 2
    True
    """
    _validate.instance("rays", rays, Rays, "Rays")
    shape = _shape(rays, numbers_of(system, prescription))
    matrices, origins = system.frames(prescription, own=False)
    stations = [torch.stack([value.expand(shape) for value in rays[:3]], -1)]
    for i in [*range(len(system.surfaces)), None]:
        if i is not None and isinstance(system.surfaces[i], coordinate_break):
            stations.append(stations[-1])
            continue
        found = trace(system, rays, prescription=prescription, until=i)
        place = -1 if i is None else i
        local = torch.stack(found[:3], -1)
        stations.append(local @ matrices[place].to(local).mT + origins[place].to(local))
    return torch.stack(stations, -2)


def curved_paths(system: optical_system, rays: Rays, place: int, ends: torch.Tensor, count: int = 32) -> torch.Tensor:
    """Return points of rays within the graded-index medium behind a surface, in global coordinates.

    Parameters
    ----------
    system : optical_system
        The system.
    rays : Rays
        From :func:`launch`.
    place : int
        Number of the surface.
    ends : torch.Tensor
        Global points ``[W, F, P, 3]`` where the rays leave the medium, from :func:`ray_paths`.
    count : int
        Number of pieces.

    Returns
    -------
    torch.Tensor
        ``[W, F, P, count + 1, 3]``, NaN for rays that are lost.

    Raises
    ------
    ValueError, TypeError
        If there is no such medium, or an argument is of another form, naming it.

    Examples
    --------
    >>> from odak.learn.raytracing.system import curved_paths, launch, optical_system, ray_paths, surface
    >>> from odak.raytracing.gradients import RadialGradient
    >>> rod = surface(thickness=5.0, material=1.6, gradient=RadialGradient([-0.09]))
    >>> system = optical_system([rod, surface()], aperture=1.0)
    >>> rays = launch(system, "y", 3)
    >>> tuple(curved_paths(system, rays, 0, ray_paths(system, rays)[..., 2, :], 8).shape)
    (1, 1, 3, 9, 3)
    """
    checked_system(system)
    place = _validate.place_in("place", place, len(system.surfaces))
    count = _validate.integer("count", count, minimum=1)
    _validate.instance("rays", rays, Rays, "Rays")
    if system.surfaces[place].gradient is None:
        raise ValueError(f"place must be a surface with a graded index behind it, got {place}")
    if not isinstance(ends, torch.Tensor) or not ends.is_floating_point() or ends.shape[-1:] != (3,):
        given = (tuple(ends.shape), ends.dtype) if isinstance(ends, torch.Tensor) else type(ends).__name__
        raise TypeError(f"ends must be a tensor [W, F, P, 3] of real numbers, got {given}")
    numbers = system.prescription()
    layout = layout_of(system.surfaces, numbers, system.image)
    sequence = layout.first(place + 1)._replace(actions=layout.actions[: place + 1])
    flat, shape = spread_rays(rays, numbers)
    if tuple(ends.shape) != (*shape, 3):
        raise ValueError(f"ends must be {[*shape, 3]}, got {list(ends.shape)}")
    flat, ends = [value.double() for value in flat], ends.double()
    given, _ = flat_arguments(sequence, numbers.numbers(system.image).first(place + 1, layout))
    state = plain_trace(sequence, *flat, *given)
    matrices, origins = system.frames(own=False)
    local = ((ends - origins[place]) @ matrices[place]).reshape(*state.x.shape, 3)
    lost = ~torch.isfinite(local).all(-1) | (state.status != HIT)
    gradient, base = system.surfaces[place].gradient, numbers.index[..., place + 1].reshape(-1, 1)
    points = points_within(gradient, base, state[:6], torch.where(lost, 0.0, local[..., 2]), count)
    points = torch.where(lost, torch.nan, points).movedim((0, 1), (-2, -1))
    return (points @ matrices[place].mT + origins[place]).reshape(*shape, count + 1, 3)


def in_surface_frame(system: optical_system, prescription: Prescription, place: int, traced: Traced) -> tuple[Any, ...]:
    """Return points ``(x, y, z)`` of a trace that ended behind a surface in that surface's own, tilted frame."""
    if prescription.shift is None and prescription.tilt is None:
        return traced[:3]
    numbers = prescription.numbers()
    shift: Any = numbers.shift
    tilt: Any = numbers.tilt
    shape = (*traced.x.shape[:-2], 1, 1)
    rows = [value[:, place].expand(math.prod(shape), value.shape[-1]) for value in (shift, tilt)]
    shift, tilt = (value.reshape(*shape, value.shape[-1]) for value in rows)
    frame = placement(shift, tilt, system.surfaces[place].order)
    return frame.enter(traced[:3], traced[3:6])[0]


def _shape(rays, numbers: Prescription) -> tuple[int, ...]:
    """Return the shape of the result, ``[..., W, F, P]``."""
    if rays.x.ndim < 3:
        raise ValueError(f"rays must have axes [..., wavelengths, fields, pupil points], got {tuple(rays.x.shape)}")
    systems = (*numbers.batch, numbers.index.shape[-2], 1, 1)
    try:
        shape = np.broadcast_shapes(*(value.shape for value in rays))
        full = np.broadcast_shapes(shape, systems)
    except ValueError as error:
        raise ValueError(f"rays must match the systems and wavelengths {systems[:-2]}: {error}") from None
    if full[:-2] != systems[:-2]:
        raise ValueError(f"rays {tuple(shape)} must match the systems and wavelengths {systems[:-2]}")
    return tuple(full)
