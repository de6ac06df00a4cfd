"""Rays through a system, to the image plane or to any surface."""

import math
from typing import Any, NamedTuple

import torch

from odak import _array, _validate
from odak.learn.raytracing.system import tilted
from odak.learn.raytracing.system.fused import Trace, plain_trace
from odak.learn.raytracing.system.lens import checked_system
from odak.learn.raytracing.system.prescription import Prescription, checked_prescription, layout_of
from odak.learn.raytracing.system.tilted import TiltedTrace
from odak.raytracing.status import RayStatus


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
        """Whether the ray got through, bool."""
        return self.status == RayStatus.HIT.value

    def to_tensor(self) -> torch.Tensor:
        """Return the rays as ``[..., 2, 3]``."""
        return torch.stack([torch.stack(self[:3], -1), torch.stack(self[3:6], -1)], -2)


def trace(
    system: Any,
    rays: Any,
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
        Let semi-diameters block rays.

    Returns
    -------
    Traced
        ``[..., W, F, P]``, in the precision of the rays. Differentiable in rays and numbers, twice; rays that are lost
        are NaN, with a status and without gradient.

    Raises
    ------
    ValueError, TypeError
        If the rays are of a form or dtype that is not understood, or do not match the batch of systems.

    Notes
    -----
    Rays are traced in blocks that fit into the cache; for gradients only the rays that enter and their statuses are
    kept, 25 bytes each in float32. Systems with tilted or shifted surfaces go by plain torch operations, block by
    block, and keep no more than that. Under torch.func, autograd keeps what it needs.
    """
    # What is read of the system, and the threads, have no place in a graph of torch.compile.
    return _array.outside_graphs(_trace, system, rays, prescription, until, vignetting)


def _trace(system, rays, prescription, until, vignetting):
    from odak.learn.raytracing.system.launching import Rays

    checked_system(system), checked_prescription(prescription)
    vignetting = _validate.flag("vignetting", vignetting)
    if isinstance(rays, torch.Tensor):
        rays = Rays.from_tensor(rays)
    if not isinstance(rays, Rays):
        raise TypeError(f"rays must be Rays or a tensor [..., 2, 3], got {type(rays).__name__}")
    if len({value.dtype for value in rays}) > 1 or rays.x.dtype not in (torch.float32, torch.float64):
        raise TypeError(f"rays must all be float32 or all float64, got {[str(value.dtype) for value in rays]}")
    numbers = system.prescription() if prescription is None else prescription
    if len({value.device for value in (*rays, numbers.curvature)}) > 1:
        raise ValueError("rays and system must be on one device")
    last = len(system.surfaces)
    last = last if until is None else _validate.place_in("until", until, last) + 1
    layout = layout_of(system.surfaces, numbers, system.image, vignetting)
    held = numbers.numbers(system.image)
    if until is not None:
        layout, held = _shortened(layout, held, last)
    shape = _shape(rays, numbers)
    flat = [value.expand(shape).reshape(math.prod(shape[:-2]), math.prod(shape[-2:])) for value in rays]
    slanted = until is None and system.image is not None and system.image.is_off_axis
    if slanted or numbers.shift is not None or numbers.tilt is not None:
        held = (*held, *tilted.rows(numbers, shape, system.image))
        traced = tilted.plain_trace if _plain((*flat, *held)) else TiltedTrace.apply
        found = traced(layout, *flat, *held)
    elif _plain((*flat, *held)):
        state = plain_trace(layout, held, tuple(flat))
        lost = state.status != RayStatus.HIT
        found = (*(torch.where(lost, torch.nan, value) for value in state[:7]), state.status)
    else:
        found = Trace.apply(layout, *flat, *held)
    return Traced(*(value.reshape(shape) for value in found))


def trace_fields(system: Any, pupil: Any = "rings", count: int = 6, **options: Any) -> Traced:
    """Launch rays from all field points and trace them to the image plane.

    Parameters
    ----------
    system, pupil, count
        As in :func:`launch`.
    **options
        Of :func:`launch` (`fields`, `prescription`, `aim`, `dtype`) and :func:`trace` (`prescription`, `until`,
        `vignetting`).

    Returns
    -------
    Traced
        ``[..., W, F, P]``.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, trace_fields
    >>> tuple(trace_fields(load_system("cooke_triplet"), "rings", 6).x.shape)
    (3, 3, 127)
    """
    from odak.learn.raytracing.system.launching import launch

    own = {name: options[name] for name in ("fields", "prescription", "aim", "dtype") if name in options}
    rest = {name: value for name, value in options.items() if name not in ("fields", "aim", "dtype")}
    return trace(system, launch(system, pupil, count, **own), **rest)


def _shape(rays, numbers: Prescription) -> tuple[int, ...]:
    """Return the shape of the result, ``[..., W, F, P]``."""
    if rays.x.ndim < 3:
        raise ValueError(f"rays must have axes [..., wavelengths, fields, pupil points], got {tuple(rays.x.shape)}")
    systems = (*numbers.batch, numbers.index.shape[-2], 1, 1)
    try:
        shape = torch.broadcast_shapes(*(value.shape for value in rays))
        full = torch.broadcast_shapes(shape, systems)
    except RuntimeError as error:
        raise ValueError(f"rays must match the systems and wavelengths {systems[:-2]}: {error}") from None
    if full[:-2] != systems[:-2]:
        raise ValueError(f"rays {tuple(shape)} must match the systems and wavelengths {systems[:-2]}")
    return tuple(full)


def _shortened(layout, numbers, last: int):
    """Return layout and numbers of the first surfaces, that at the end passed without being bent."""
    layout = type(layout)(*(value[:last] for value in layout))
    layout = layout._replace(actions=(*layout.actions[:-1], "pass"))
    index = numbers.index[:, : last + 1]
    return layout, type(numbers)(*(value[:, :last] for value in numbers[:4]), index)


def _plain(tensors) -> bool:
    """Say whether the tensors take part in a transform that only plain operations know."""
    return torch.autograd.forward_ad._current_level >= 0 or any(
        torch._C._functorch.is_functorch_wrapped_tensor(value) for value in tensors
    )
