"""Ray fans, distortion, field curvature."""

from typing import Any

import torch

from odak import _validate
from odak.learn.raytracing.system.launching import field_points, launch
from odak.learn.raytracing.system.paraxial import entrance_pupil, matrix, signed_indices
from odak.learn.raytracing.system.prescription import Prescription
from odak.learn.raytracing.system.tracing import trace, trace_fields

CENTRE = torch.zeros(1, 2, dtype=torch.float64)


def ray_fan(system: Any, axis: str = "y", count: int = 21, **options: Any) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the transverse ray aberration along a diameter of the pupil.

    Parameters
    ----------
    system : optical_system
        The system.
    axis : str
        "y" (the tangential fan of a field along y) or "x".
    count : int
        Number of rays; odd, so that the chief ray is one of them.
    **options
        Of :func:`trace_fields`.

    Returns
    -------
    tuple of torch.Tensor
        Pupil coordinates ``[count]``, −1 … 1, and distances along the axis in the image plane from the chief ray of the
        reference wavelength, ``[..., W, F, count]``; NaN where a ray is lost.
    """
    axis = _validate.one_of("axis", axis, ("x", "y"))
    if _validate.integer("count", count, minimum=3) % 2 == 0:
        raise ValueError(f"count must be odd, got {count}")
    traced = trace_fields(system, axis, count, **options)
    value = getattr(traced, axis)
    chief = value[..., system.reference : system.reference + 1, :, count // 2 : count // 2 + 1]
    return torch.linspace(-1, 1, count, dtype=torch.float64, device=value.device), value - chief


def distortion(system: Any, prescription: Prescription | None = None, **options: Any) -> torch.Tensor:
    """Return how far the chief ray lands from where the paraxial one does, over the paraxial image height.

    Parameters
    ----------
    system : optical_system
        The system.
    prescription : Prescription, optional
        Numbers in place of the system's own.
    **options
        Of :func:`trace_fields`.

    Returns
    -------
    torch.Tensor
        ``[..., W, F]``, along the paraxial image point's direction; 0 for a field on the axis. The paraxial height is
        that of the reference wavelength, in the image plane.

    Notes
    -----
    Welford, Aberrations of Optical Systems (1986), section 7.7: the object's tangent, not its angle, is imaged.
    """
    options.setdefault("vignetting", False)
    chief = trace_fields(system, CENTRE, prescription=prescription, **options)
    ideal = paraxial_points(system, prescription, options.get("fields"))
    size = ideal.square().sum(-1)
    off = size > 0
    found = torch.stack([chief.x[..., 0], chief.y[..., 0]], -1)
    along = (found * ideal[..., None, :, :]).sum(-1) / torch.where(off, size, 1.0)[..., None, :]
    return torch.where(off[..., None, :], along - 1, 0.0)


def paraxial_points(system, prescription: Prescription | None = None, fields=None) -> torch.Tensor:
    """Return where the paraxial chief rays meet the image plane, ``[..., F, 2]``, at the reference wavelength."""
    numbers = system.prescription() if prescription is None else prescription
    if numbers.index.shape[-2] > 1:
        numbers = numbers._replace(index=numbers.index[..., system.reference : system.reference + 1, :])
    index = signed_indices(system, numbers)
    whole = matrix(numbers, index, 0, len(system.surfaces), gap=True)
    pupil = entrance_pupil(system, prescription=numbers)
    points = field_points(system, fields).to(index.device)
    if system.at_infinity:
        slope = torch.tan(torch.deg2rad(points))
        height = -pupil.distance[..., None, None] * slope
    else:
        slope = -points * pupil.bend[..., None, None]
        height = points + system.object_distance * slope
    a, b, n = (value[..., None, None] for value in (whole.a, whole.b, index[..., 0]))
    return a * height + b * n * slope


def field_curvature(
    system: Any, prescription: Prescription | None = None, **options: Any
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the distances from the image surface to the tangential and the sagittal focus along z.

    Parameters
    ----------
    system : optical_system
        The system.
    prescription : Prescription, optional
        Numbers in place of the system's own.
    **options
        Of :func:`launch` and :func:`trace`.

    Returns
    -------
    tuple of torch.Tensor
        Tangential (rays in the y–z plane) and sagittal (x–z), ``[..., W, F]``, for fields along y.

    Notes
    -----
    Foci of rays infinitely close to the chief ray: Coddington's equations, by automatic differentiation.
    """
    own = {name: options[name] for name in ("fields", "aim") if name in options}
    place = CENTRE.clone().requires_grad_()
    with torch.enable_grad():
        rays = launch(system, place, prescription=prescription, **own)
        traced = trace(system, rays, prescription=prescription, vignetting=False)
        foci = []
        for axis, (point, cosine) in ((1, (traced.y, traced.v)), (0, (traced.x, traced.u))):
            slope = cosine / traced.w
            # In the plane through the chief ray's point, whatever the shape of the image surface.
            moved = _along(point, place, axis) - slope[..., 0] * _along(traced.z, place, axis)
            foci.append(-moved / _along(slope, place, axis))
    numbers = (*system.parameters(), *(value for value in prescription or () if value is not None))
    if not (torch.is_grad_enabled() and any(value.requires_grad for value in numbers)):
        foci = [value.detach() for value in foci]
    return foci[0], foci[1]


def _along(value: torch.Tensor, place: torch.Tensor, axis: int) -> torch.Tensor:
    """Return the derivative of each entry ``[..., W, F, 1]`` by the pupil coordinate, ``[..., W, F]``."""
    flat = value.reshape(-1)
    found = [torch.autograd.grad(entry, place, create_graph=True)[0][0, axis] for entry in flat]
    return torch.stack(found).reshape(value.shape[:-1])
