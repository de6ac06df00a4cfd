"""Geometric and wavefront analysis: spots, ray fans, distortion, field curvature, optical path differences."""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch

from odak import _show, _validate
from odak._array import is_readable
from odak._torch_private import differentiates
from odak.learn.raytracing.system.paraxial import (
    check_media,
    entrance_pupil,
    first_order,
    image_distances,
    matrix,
    signed_indices,
)
from odak.learn.raytracing.system.prescriptions import Prescription, checked_prescription
from odak.learn.raytracing.system.pupils import (
    AIMS,
    FieldOptions,
    Pupil,
    RayOptions,
    TraceOptions,
    WaveOptions,
    at_stop,
    field_points,
    launch,
    places_of,
    pupil_of,
    real_places,
    through_places,
    trace_fields,
    weights_of,
)
from odak.learn.raytracing.system.sequence import Passage, flat_arguments, plain_trace
from odak.learn.raytracing.system.specification import FieldPoints, Values, checked_weights, largest_of, plain
from odak.learn.raytracing.system.surfaces import (
    checked_system,
    is_break,
    layout_of,
    numbers_of,
    optical_system,
    reference_of,
    wavelength_shares,
    wavelengths_of,
)
from odak.learn.raytracing.system.tracing import Rays, Traced, in_surface_frame, spread_rays, trace
from odak.raytracing.geometry import safe_sqrt
from odak.tools.zernike import fringe_to_nm, noll_to_nm, osa_to_nm, zernike_norm, zernike_polynomial

if TYPE_CHECKING:
    from typing_extensions import Unpack

REFERENCES = ("centroid", "chief")
CENTRE = torch.zeros(1, 2, dtype=torch.float64)
FAR = 1e8
# Single indices of Zernike polynomials, and their first one.
ORDERS: dict[str, tuple[Callable[[int], tuple[int, int]], int]] = {
    "noll": (noll_to_nm, 1),
    "osa": (osa_to_nm, 0),
    "fringe": (fringe_to_nm, 1),
}


@_show.shown
class Spots(NamedTuple):
    """A spot diagram.

    Attributes
    ----------
    x, y : torch.Tensor
        Points in the image plane, from the reference point, ``[..., W, F, P]``; NaN where a ray is lost.
    center : torch.Tensor
        Reference points, ``[..., F, 2]``.
    rms, largest : torch.Tensor
        Root mean square and largest distance from the reference point, all wavelengths together, ``[..., F]``; the
        mean is taken over the rays, with the weights of a :class:`PupilQuadrature` over the area of the pupil.
    status : torch.Tensor
        int8, numbers of :class:`odak.raytracing.RayStatus`: what befell the ray first.
    weights : torch.Tensor or None
        Fractions of the area of the pupil that the rays stand for, ``[P]`` or ``[F, P]``; None where all are alike.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Spots, load_system, spot_diagram
    >>> lens = load_system("cooke_triplet")
    >>> spots = spot_diagram(lens)
    >>> bool((spots.rms < spots.largest).all())
    True
    """

    x: torch.Tensor
    y: torch.Tensor
    center: torch.Tensor
    rms: torch.Tensor
    largest: torch.Tensor
    status: torch.Tensor
    weights: torch.Tensor | None = None

    def _repr_html_(self) -> str:
        return _show.page(self, "odak.learn.raytracing.system.drawing:spots_view")


def spot_diagram(
    system: optical_system,
    pupil: Pupil = "rings",
    count: int = 6,
    *,
    reference: str = "centroid",
    prescription: Prescription | None = None,
    **options: "Unpack[RayOptions]",
) -> Spots:
    """Return the intersections of the rays of each field point with the image plane.

    Parameters
    ----------
    system : optical_system
        The system.
    pupil : str or torch.Tensor
        Pattern of :func:`pupil_samples`, or points ``[P, 2]`` in units of the pupil's radius.
    count : int
        Count of :func:`pupil_samples`.
    reference : str
        "centroid": of the spot, all wavelengths together. "chief": the chief ray at the reference wavelength.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps.
    **options
        Of :func:`trace_fields`.

    Returns
    -------
    Spots
        Differentiable. Where no ray of a field arrives, its size is NaN. Distances are across the axis: on a tilted or
        strongly curved image surface they are projected along the axis.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, spot_diagram
    >>> tuple(spot_diagram(load_system("cooke_triplet")).rms.shape)
    (3,)
    """
    reference = _validate.one_of("reference", reference, REFERENCES)
    traced = trace_fields(system, pupil, count, prescription=prescription, **options)
    kept = traced.arrived
    x, y = torch.where(kept, traced.x, 0.0), torch.where(kept, traced.y, 0.0)
    share = wavelength_shares(system, prescription, x)[:, None, None]
    weights = weights_of(pupil, count, x)
    share = share if weights is None else share * weights
    number = (kept * share).sum((-3, -1))
    if reference == "chief":
        unblocked: dict[str, Any] = {**options, "vignetting": False}
        chief = trace_fields(system, CENTRE, prescription=prescription, **unblocked)
        cx, cy = (value[..., reference_of(system, prescription), :, 0].to(x.dtype) for value in (chief.x, chief.y))
    else:
        cx, cy = ((share * value).sum((-3, -1)) / number for value in (x, y))
    around = [torch.where(kept, value - c[..., None, :, None], 0.0) for value, c in ((x, cx), (y, cy))]
    squared = around[0].square() + around[1].square()
    mean = (share * squared).sum((-3, -1)) / number
    # NaN where no ray arrived: 0/0 above, which the safe root would hide.
    rms = torch.where(number > 0, safe_sqrt(mean), torch.nan)
    largest = torch.where(number > 0, safe_sqrt(squared.amax((-3, -1))), torch.nan)
    x, y = (torch.where(kept, value, torch.nan) for value in around)
    return Spots(x, y, torch.stack([cx, cy], -1), rms, largest, traced.status, weights)


class SizeOptions(TraceOptions, total=False):
    """Of :func:`rms_spot`."""

    reference: str


def rms_spot(
    system: optical_system, pupil: Pupil = "rings", count: int = 6, **options: "Unpack[SizeOptions]"
) -> torch.Tensor:
    """Return the root mean square distance of the rays from their centroid, ``[..., F]``, all wavelengths together.

    Parameters
    ----------
    system : optical_system
        The system.
    pupil : str or torch.Tensor
        Pattern of :func:`pupil_samples`, or points ``[P, 2]`` in units of the pupil's radius.
    count : int
        Count of :func:`pupil_samples`.
    **options
        Of :func:`spot_diagram`.

    Returns
    -------
    torch.Tensor
        ``[..., F]``, in the unit of the system; all wavelengths together.

    Examples
    --------
    A parabolic mirror images a distant point on its axis without aberration:

    >>> from odak.learn.raytracing.system import optical_system, rms_spot, surface
    >>> parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0, material="mirror")
    >>> mirror = optical_system([parabola], aperture=20.0)
    >>> float(rms_spot(mirror).max()) < 1e-9
    True
    """
    return spot_diagram(system, pupil, count, **options).rms


def ray_fan(
    system: optical_system, axis: str = "y", count: int = 21, **options: "Unpack[TraceOptions]"
) -> tuple[torch.Tensor, torch.Tensor]:
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

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, ray_fan
    >>> lens = load_system("cooke_triplet")
    >>> pupil, error = ray_fan(lens, count=5)
    >>> pupil.tolist()
    [-1.0, -0.5, 0.0, 0.5, 1.0]
    """
    axis = _checked_fan(axis, count)
    traced = trace_fields(system, axis, count, **options)
    value = getattr(traced, axis)
    place = reference_of(system, options.get("prescription"))
    chief = value[..., place : place + 1, :, count // 2 : count // 2 + 1]
    return torch.linspace(-1, 1, count, dtype=torch.float64, device=value.device), value - chief


def path_fan(
    system: optical_system, axis: str = "y", count: int = 21, **options: "Unpack[WaveOptions]"
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the optical path difference along a diameter of the pupil.

    Parameters
    ----------
    system : optical_system
        The system.
    axis : str
        "y" (the tangential fan of a field along y) or "x".
    count : int
        Number of rays; odd, so that the chief ray is one of them.
    **options : Any
        Of :func:`wavefront` (`prescription`, `fields`, `aim`, `vignetting`).

    Returns
    -------
    tuple of torch.Tensor
        Pupil coordinates ``[count]``, −1 … 1, and paths to the reference sphere less the chief ray's in
        wavelengths, ``[..., W, F, count]``; NaN where a ray is lost.

    Examples
    --------
    A parabolic mirror images a distant point on its axis without aberration:

    >>> from odak.learn.raytracing.system import optical_system, path_fan, surface
    >>> parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0, material="mirror")
    >>> mirror = optical_system([parabola], aperture=20.0)
    >>> pupil, path = path_fan(mirror, count=5)
    >>> float(path.abs().max()) < 1e-6
    True
    """
    axis = _checked_fan(axis, count)
    found = wavefront(system, axis, count, **options)
    return torch.linspace(-1, 1, count, dtype=torch.float64, device=found.path.device), found.path


def lateral_color(system: optical_system, **options: "Unpack[TraceOptions]") -> torch.Tensor:
    """Return the distances in the image of the chief rays of all wavelengths from the one of the reference wavelength.

    Parameters
    ----------
    system : optical_system
        The system.
    **options : Any
        Of :func:`trace_fields` (`fields`, `prescription`, `aim`).

    Returns
    -------
    torch.Tensor
        ``[..., W, F]``: along the direction from the axis to the reference chief ray's point, along y on the axis;
        positive outwards.

    Examples
    --------
    There is none on the axis:

    >>> from odak.learn.raytracing.system import lateral_color, load_system
    >>> lens = load_system("cooke_triplet")
    >>> bool(lateral_color(lens)[:, 0].abs().max() < 1e-9)
    True
    """
    options.setdefault("vignetting", False)
    return outward_distances(trace_fields(system, CENTRE, **options), system, options.get("prescription"))


def outward_distances(traced: Traced, system: optical_system, prescription: Prescription | None) -> torch.Tensor:
    """Return what :func:`lateral_color` does, of rays whose first ones are the chief rays."""
    place = torch.stack([traced.x[..., 0], traced.y[..., 0]], -1)
    number = reference_of(system, prescription)
    middle = place[..., number : number + 1, :, :]
    size = middle.square().sum(-1, keepdim=True)
    off = size > 0
    upwards = torch.tensor([0.0, 1.0], dtype=place.dtype, device=place.device)
    outward = torch.where(off, middle / torch.where(off, size, 1.0).sqrt(), upwards)
    return ((place - middle) * outward).sum(-1)


@_validate.takes_units()
def axial_color(
    system: optical_system, wavelengths: Values | None = None, prescription: Prescription | None = None
) -> torch.Tensor:
    """Return the paraxial focal shift: image distances at wavelengths less that at the reference wavelength.

    Parameters
    ----------
    system : optical_system
        The system.
    wavelengths : sequence of float or torch.Tensor, optional
        Wavelengths in the system's unit, within the ranges of its glasses; its own by default. Differentiable.
    prescription : Prescription, optional
        Numbers in place of the system's own, whose wavelengths are taken then.

    Returns
    -------
    torch.Tensor
        ``[..., W]`` along z, negative where light focuses in front. Differentiable.

    Examples
    --------
    Blue light has the shortest focus of a singlet:

    >>> from odak.learn.raytracing.system import axial_color, load_system
    >>> shift = axial_color(load_system("singlet"), [450e-6, 587.5618e-6, 650e-6])
    >>> bool((shift.diff() > 0).all()), round(float(shift[1]), 9)
    (True, 0.0)
    """
    if prescription is None:
        numbers = checked_system(system).prescription(wavelengths)
        origin = first_order(system).image_distance
    elif wavelengths is not None:
        raise ValueError("wavelengths must be left out where prescription holds them")
    else:
        checked_system(system), checked_prescription(prescription)
        numbers, origin = prescription, None
    each = image_distances(system, numbers)
    return each - (each[..., reference_of(system, numbers)] if origin is None else origin)[..., None]


def distortion_grid(
    system: optical_system, points: int = 11, prescription: Prescription | None = None, **options: "Unpack[RayOptions]"
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the image points of the chief rays of a square grid of field points, with and without distortion.

    Parameters
    ----------
    system : optical_system
        The system, with a field off the axis.
    points : int
        Points along each side of the grid, whose corners lie at the largest field.
    prescription : Prescription, optional
        Numbers in place of the system's own.
    **options
        Of :func:`trace_fields`.

    Returns
    -------
    tuple of torch.Tensor
        Ideal and real points ``[..., points, points, 2]`` (x, y) in the image plane at the reference wavelength.

    Examples
    --------
    >>> from odak.learn.raytracing.system import distortion_grid, load_system
    >>> ideal, real = distortion_grid(load_system("cooke_triplet"), 5)
    >>> tuple(real.shape), bool((real - ideal)[2, 2].abs().max() < 1e-9)
    ((5, 5, 2), True)
    """
    points = _validate.integer("points", points, minimum=2)
    largest = plain(largest_of(checked_system(system).fields))
    if not largest:
        raise ValueError("system must have a field off the axis")
    if system.at_infinity and largest >= 90:
        raise ValueError(f"system must have fields below 90 degrees for a grid of tangents, got {largest:g}")
    half = (math.tan(math.radians(largest)) if system.at_infinity else largest) / math.sqrt(2)
    line = torch.linspace(-half, half, points, dtype=torch.float64)
    y, x = torch.meshgrid(line, line, indexing="ij")
    fields = torch.stack([x, y], -1).reshape(-1, 2)
    fields = torch.rad2deg(torch.atan(fields)) if system.at_infinity else fields
    given: dict[str, Any] = {"vignetting": False, **options, "fields": fields, "prescription": prescription}
    chief = trace_fields(system, CENTRE, **given)
    place = reference_of(system, prescription)
    real = torch.stack([value[..., place, :, 0] for value in (chief.x, chief.y)], -1)
    ideal = paraxial_points(system, prescription, fields)
    return tuple(value.reshape(*value.shape[:-2], points, points, 2) for value in (ideal, real))  # type: ignore[return-value]


@_show.shown
class Footprint(NamedTuple):
    """Intersections of rays with a surface.

    Attributes
    ----------
    x, y : torch.Tensor
        In the surface's own frame, from its vertex, ``[..., W, F, P]``; NaN for rays lost in front of it or on it.
    status : torch.Tensor
        int8, numbers of :class:`odak.raytracing.RayStatus`, of the rays up to the surface.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Footprint, footprint, load_system
    >>> isinstance(footprint(load_system("singlet"), 0), Footprint)
    True
    """

    x: torch.Tensor
    y: torch.Tensor
    status: torch.Tensor


def footprint(
    system: optical_system,
    place: int,
    pupil: Pupil = "rings",
    count: int = 6,
    *,
    prescription: Prescription | None = None,
    **options: "Unpack[RayOptions]",
) -> Footprint:
    """Return the intersections of the rays of each field point with a surface.

    Parameters
    ----------
    system : optical_system
        The system.
    place : int
        Number of the surface.
    pupil : str or torch.Tensor
        Pattern of :func:`pupil_samples`, or points ``[P, 2]`` in units of the pupil's radius.
    count : int
        Count of :func:`pupil_samples`.
    prescription : Prescription, optional
        Numbers in place of the system's own.
    **options
        Of :func:`trace_fields`.

    Returns
    -------
    Footprint
        Differentiable.

    Examples
    --------
    At its stop the rays of all fields fill the same disc, if they are aimed at it:

    >>> from odak.learn.raytracing.system import first_order, footprint, load_system
    >>> lens = load_system("cooke_triplet")
    >>> found = footprint(lens, lens.stop, aim="real", vignetting=False)
    >>> radius = (found.x**2 + found.y**2).sqrt()[lens.reference].amax(-1)
    >>> bool((2 * radius - first_order(lens).stop_diameter).abs().max() < 1e-6)
    True
    """
    place = _validate.place_in("place", place, len(checked_system(system).surfaces))
    if is_break(system.surfaces[place]):
        raise ValueError(f"place must be a surface, got the coordinate break {place}")
    given: Any = options
    found = trace_fields(system, pupil, count, prescription=prescription, until=place, **given)
    x, y, _ = in_surface_frame(system, numbers_of(system, prescription), place, found)
    return Footprint(x, y, found.status)


def pupil_aberration(
    system: optical_system,
    axis: str = "y",
    count: int = 21,
    *,
    prescription: Prescription | None = None,
    fields: FieldPoints | None = None,
    aim: str = "paraxial",
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return how far from their paraxial places rays meet the stop, or the entrance pupil.

    Parameters
    ----------
    system : optical_system
        The system.
    axis : str
        "y" or "x", the diameter of the pupil.
    count : int
        Number of rays; odd.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps.
    fields : sequence or torch.Tensor, optional
        Field points in place of the system's.
    aim : str
        "paraxial": rays through points of the paraxial entrance pupil, by how far they miss the same points of the
        stop. "real": rays through points of the stop, by how far they miss the same points of the paraxial entrance
        pupil; if a field is beyond 80 degrees, in the plane through its centre across each field's direction.

    Returns
    -------
    tuple of torch.Tensor
        Pupil coordinates ``[count]``, −1 … 1, and distances along the axis in radii of the stop or of the entrance
        pupil at the reference wavelength, ``[..., F, count]``; NaN for rays that do not reach it. Where they are large,
        aim "real" changes the results.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, pupil_aberration
    >>> pupil, error = pupil_aberration(load_system("cooke_triplet"), count=5)
    >>> float(error[0, 2].abs()) < 1e-12
    True
    """
    axis, aim = _checked_fan(axis, count), _validate.one_of("aim", aim, AIMS)
    numbers = numbers_of(system, prescription).at(system.reference)
    pupil, points = entrance_pupil(system, prescription=numbers), pupil_of(axis, count, system)
    chosen, which = field_points(system, fields).to(points.device)[:, None], ("x", "y").index(axis)
    line = points[:, which]
    if aim == "real":
        places = real_places(system, numbers, pupil, points, chosen)[which]
        place = ((places - pupil.middle[which][..., None, None, None]) / pupil.reach[..., None, None, None])[
            ..., 0, :, :
        ]
        kept = torch.isfinite(place)
    else:
        rays = through_places(system, chosen, pupil, *places_of(pupil, points))
        *found, arrived = at_stop(system, numbers, rays)
        place, kept = found[which][..., 0, :, :] / pupil.stop_radius[..., None, None], arrived[..., 0, :, :]
    # Behind an intermediate image the stop is upside down.
    turned = torch.sign((torch.where(kept, place, 0.0) * line).sum(-1, keepdim=True)).detach()
    return line, torch.where(kept, turned * place - line, torch.nan)


@_show.shown
class Incidence(NamedTuple):
    """Angles between rays and the normals of the surfaces, the image included.

    Attributes
    ----------
    x, y : torch.Tensor
        Where the rays meet each surface, in its own frame, ``[..., S, W, F, P]``; NaN for lost rays.
    angle : torch.Tensor
        Angle of incidence in degrees, ``[..., S, W, F, P]``.
    places : tuple of int
        Numbers of the surfaces: coordinate breaks are left out.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Incidence, incidence_angles, load_system
    >>> isinstance(incidence_angles(load_system("singlet"), count=3), Incidence)
    True
    """

    x: torch.Tensor
    y: torch.Tensor
    angle: torch.Tensor
    places: tuple[int, ...]


def incidence_angles(
    system: optical_system,
    pupil: Pupil = "y",
    count: int = 21,
    *,
    prescription: Prescription | None = None,
    **options: "Unpack[FieldOptions]",
) -> Incidence:
    """Return where rays meet each surface and at what angle of incidence.

    Parameters
    ----------
    system : optical_system
        The system.
    pupil : str or torch.Tensor
        Pattern of :func:`pupil_samples`, or points ``[P, 2]`` in units of the pupil's radius.
    count : int
        Count of :func:`pupil_samples`.
    prescription : Prescription, optional
        Numbers in place of the system's own.
    **options
        Of :func:`launch` (`fields`, `aim`) and :func:`trace` (`vignetting`).

    Returns
    -------
    Incidence
        Differentiable; at a mirror and in a graded medium too.

    Examples
    --------
    The last surface of a hemisphere is met along its normals by rays through its centre:

    >>> from odak.learn.raytracing.system import Conjugates, SystemAperture, incidence_angles, optical_system, surface
    >>> rows = [surface(thickness=10.0, material=1.5), surface(-10.0, thickness=20.0)]
    >>> lens = optical_system(rows, SystemAperture(0.2, "NA"), conjugates=Conjugates(1e-9))
    >>> bool(incidence_angles(lens, count=5).angle[1].max() < 1e-6)
    True
    """
    numbers = numbers_of(system, prescription)
    given: Any = options
    vignetting = _validate.flag("vignetting", given.pop("vignetting", True))
    rays = launch(system, pupil, count, prescription=prescription, **given)
    layout = layout_of(system.surfaces, numbers, system.image, vignetting)
    flat, shape = spread_rays(rays, numbers)
    passages: list[Passage] = []
    plain_trace(layout, *flat, *flat_arguments(layout, numbers.numbers(system.image))[0], record=passages.append)
    passages = [item for item in passages if item.action not in ("break", "bend")]
    held: list[list[torch.Tensor]] = [[], [], []]
    for item in passages:
        way, normal = (torch.stack(torch.broadcast_tensors(*v), -1) for v in (item.incoming, item.normal))
        across = torch.linalg.cross(way, normal.expand_as(way)).square().sum(-1)
        angle = torch.rad2deg(torch.atan2(safe_sqrt(across), (way * normal).sum(-1).abs()))
        for values, value in zip(held, (*item.point[:2], angle), strict=True):
            values.append(torch.where(item.status == 0, value, torch.nan).reshape(shape))
    x, y, angle = (torch.stack(values, -4) for values in held)
    return Incidence(x, y, angle, tuple(item.place for item in passages))


def through_focus(
    system: optical_system, shifts: Values, pupil: Pupil = "rings", count: int = 6, **options: "Unpack[TraceOptions]"
) -> torch.Tensor:
    """Return the root mean square size of the spots in planes before and behind the image plane.

    Parameters
    ----------
    system : optical_system
        The system.
    shifts : sequence of float or torch.Tensor
        Distances of the planes from the image plane along z, ``[n]``.
    pupil : str or torch.Tensor
        Pattern of :func:`pupil_samples`, or points ``[P, 2]`` in units of the pupil's radius.
    count : int
        Count of :func:`pupil_samples`.
    **options : Any
        Of :func:`trace_fields`.

    Returns
    -------
    torch.Tensor
        ``[..., F, n]``, all wavelengths together; means over the rays as of :func:`spot_diagram`.

    Examples
    --------
    The spot of a parabolic mirror is smallest in its focal plane:

    >>> from odak.learn.raytracing.system import optical_system, surface, through_focus
    >>> parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0, material="mirror")
    >>> mirror = optical_system([parabola], aperture=20.0)
    >>> sizes = through_focus(mirror, [-0.1, 0.0, 0.1])
    >>> int(sizes[0].argmin())
    1
    """
    shifts = torch.as_tensor(_validate.real("shifts", shifts), dtype=torch.float64)
    traced = trace_fields(system, pupil, count, **options)
    kept = traced.arrived
    parts = []
    for value, cosine in ((traced.x, traced.u), (traced.y, traced.v)):
        value, slope = (torch.where(kept, v, 0.0) for v in (value, cosine / traced.w))
        gap = shifts.to(value) - torch.where(kept, traced.z, 0.0)[..., None]
        parts.append(value[..., None] + gap * slope[..., None])
    share = wavelength_shares(system, options.get("prescription"), parts[0])[:, None, None, None]
    weights = weights_of(pupil, count, parts[0])
    share = share if weights is None else share * weights[..., None]
    number = (kept[..., None] * share).sum((-4, -2))
    total = 0.0
    for place in parts:
        held = torch.where(kept[..., None], place, 0.0)
        mean = (share * held).sum((-4, -2)) / number
        around = torch.where(kept[..., None], held - mean[..., None, :, None, :], 0.0)
        total = total + (share * around.square()).sum((-4, -2))
    return torch.where(number > 0, safe_sqrt(total / number), torch.nan)


def best_focus(
    system: optical_system, pupil: Pupil = "rings", count: int = 6, **options: "Unpack[TraceOptions]"
) -> torch.Tensor:
    """Return where the plane of the smallest spots lies, from the image surface along z.

    Move the image there to judge a lens rather than its focus; :func:`through_focus` gives what lies between.

    Parameters
    ----------
    system : optical_system
        The system.
    pupil : str or torch.Tensor
        Pattern of :func:`pupil_samples`, or points ``[P, 2]`` in units of the pupil's radius.
    count : int
        Count of :func:`pupil_samples`.
    **options : Any
        Of :func:`trace_fields`.

    Returns
    -------
    torch.Tensor
        Distance of the plane in which the mean over the fields of the mean square radii is least, ``[...]``; NaN where
        no field arrives. Differentiable.

    Examples
    --------
    The parabolic mirror of :func:`through_focus` with its image plane 0.2 too far from it:

    >>> from odak.learn.raytracing.system import best_focus, optical_system, surface
    >>> parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.2, material="mirror")
    >>> round(float(best_focus(optical_system([parabola], aperture=20.0))), 9)
    0.2
    """
    # The mean square radius is a parabola in the distance, which three planes determine.
    sizes = through_focus(system, [-1.0, 0.0, 1.0], pupil, count, **options)
    before, here, behind = sizes.square().nanmean(-2).unbind(-1)
    return (before - behind) / (2 * (before - 2 * here + behind))


@_show.shown
class Spread(NamedTuple):
    """A diffraction image of a point.

    Attributes
    ----------
    intensity : torch.Tensor
        ``[..., W, F, rows, columns]``, 1 at the peak of the same pupil without aberrations; sample n // 2 of each axis
        is the chief ray's point. Rows are y, columns x.
    pitch : torch.Tensor
        Pixel pitches (y, x) in the system's unit, ``[..., W, F, 2]``.
    strehl : torch.Tensor
        Largest of the samples, ``[..., W, F]``; :func:`strehl_ratio` is the peak itself.
    energy : torch.Tensor or None
        Sum of the samples of an image of any width, ``[..., W, F]``; None where it is not known. The samples here add
        up to less, by what falls beside them and by what the samples on the edge of the pupil leave out.

    Examples
    --------
    The image of a point on the axis is centred:

    >>> from odak.learn.raytracing.system import Spread, optical_system, point_spread_function, surface
    >>> parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0, material="mirror")
    >>> mirror = optical_system([parabola], aperture=20.0)
    >>> spread = point_spread_function(mirror, 32, 128)
    >>> divmod(int(spread.intensity[0, 0].argmax()), 128)
    (64, 64)
    """

    intensity: torch.Tensor
    pitch: torch.Tensor
    strehl: torch.Tensor
    energy: torch.Tensor | None = None


def encircled_energy(
    found: Spread | Spots, radii: Values | None = None, wavelength_weights: Sequence[float] | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the fraction of the energy within circles about the centroid of an image of a point.

    A Spread with an `energy` gives the energy of an image of any width, some of which falls beside its samples.

    Parameters
    ----------
    found : Spread or Spots
        Diffraction image of :func:`point_spread_function`, or the geometric one of :func:`spot_diagram`.
    radii : sequence of float or torch.Tensor, optional
        Radii of the circles; by default 100 of them, for a Spread up to a quarter of its width.
    wavelength_weights : sequence of float, optional
        Weights of the wavelengths of Spots, such as the system's; by default they are equal.

    Returns
    -------
    tuple of torch.Tensor
        Radii and energies, ``[..., W, F, n]`` for a Spread, ``[..., F, n]`` for Spots (all wavelengths together).

    Examples
    --------
    The energy rises to 1:

    >>> from odak.learn.raytracing.system import encircled_energy, load_system, spot_diagram
    >>> lens = load_system("cooke_triplet")
    >>> radii, energy = encircled_energy(spot_diagram(lens))
    >>> bool((energy.diff(dim=-1) >= 0).all()), round(float(energy[..., -1].max()), 6)
    (True, 1.0)
    """
    if radii is not None:
        radii = torch.as_tensor(_validate.real("radii", radii), dtype=torch.float64)
    if isinstance(found, Spots):
        x, y = (value.transpose(-3, -2).flatten(-2) for value in (found.x, found.y))
        kept = torch.isfinite(x)
        distance = torch.where(kept, (x.square() + y.square()).sqrt(), torch.inf)
        count, rays = found.x.shape[-3], found.x.shape[-1]
        share = x.new_tensor(checked_weights("wavelength_weights", wavelength_weights, count) or (1.0,) * count)
        weight = kept * share.repeat_interleave(rays)
        if found.weights is not None:
            weight = weight * found.weights[..., None, :].expand(*found.weights.shape[:-1], count, rays).flatten(-2)
        if radii is None:
            radii = torch.linspace(0, 1, 100, dtype=torch.float64, device=x.device) * found.largest[..., None]
    else:
        intensity, pitch = getattr(found, "intensity", None), getattr(found, "pitch", None)
        if intensity is None or pitch is None:
            raise TypeError(f"found must be a Spread or Spots, got {type(found).__name__}")
        rows, columns = intensity.shape[-2:]
        line_y, line_x = (
            torch.arange(n, dtype=torch.float64, device=intensity.device) - n // 2 for n in (rows, columns)
        )
        y, x = line_y * pitch[..., :1], line_x * pitch[..., 1:]
        total = intensity.sum((-2, -1))
        y = y - ((intensity.sum(-1) * y).sum(-1) / total)[..., None]
        x = x - ((intensity.sum(-2) * x).sum(-1) / total)[..., None]
        distance = (y[..., :, None].square() + x[..., None, :].square()).sqrt().flatten(-2)
        weight = intensity.flatten(-2)
        if radii is None:
            width = rows * pitch.amax(-1) / 4
            radii = torch.linspace(0, 1, 100, dtype=torch.float64, device=intensity.device) * width[..., None]
    radii = radii.to(weight.device).expand(*weight.shape[:-1], radii.shape[-1])
    order = distance.argsort(-1)
    grown = weight.gather(-1, order).cumsum(-1)
    number = torch.searchsorted(distance.gather(-1, order).contiguous(), radii.contiguous(), right=True)
    inside = torch.nn.functional.pad(grown, (1, 0)).gather(-1, number)
    whole = getattr(found, "energy", None)
    return radii, inside / (grown[..., -1:] if whole is None else whole[..., None])


def distortion(
    system: optical_system,
    prescription: Prescription | None = None,
    projection: str = "tangent",
    **options: "Unpack[RayOptions]",
) -> torch.Tensor:
    """Return the deviation of the chief ray from the paraxial one in the image, over the paraxial image height.

    Parameters
    ----------
    system : optical_system
        The system.
    prescription : Prescription, optional
        Numbers in place of the system's own.
    projection : str
        To what paraxial heights are proportional: "tangent" of the field's angle, or its "angle", f·θ, for fisheye
        lenses, fields at 90 degrees and beyond, and a distant object.
    **options
        Of :func:`trace_fields`.

    Returns
    -------
    torch.Tensor
        ``[..., W, F]``, along the paraxial image point's direction; 0 for a field on the axis. The paraxial height
        is computed at the reference wavelength, in the image plane.

    Raises
    ------
    ValueError
        If a field has no tangent, or a near object no angles.

    Notes
    -----
    Welford, Aberrations of Optical Systems (1986), section 7.7: the object's tangent, not its angle, is imaged.

    Examples
    --------
    The triplet has less than 2 % of distortion:

    >>> from odak.learn.raytracing.system import distortion, load_system
    >>> lens = load_system("cooke_triplet")
    >>> bool(distortion(lens)[:, 1:].abs().max() < 0.02)
    True
    """
    options.setdefault("vignetting", False)
    chief = trace_fields(system, CENTRE, prescription=prescription, **options)
    ideal = paraxial_points(system, prescription, options.get("fields"), projection)
    return relative_deviation(torch.stack([chief.x[..., 0], chief.y[..., 0]], -1), ideal[..., None, :, :])


def relative_deviation(points: torch.Tensor, ideal: torch.Tensor) -> torch.Tensor:
    """Return the deviations of points ``[..., 2]`` from ideal ones along these, over their distances from the axis.

    0 for ideal points on the axis.
    """
    size = ideal.square().sum(-1)
    off = size > 0
    return torch.where(off, (points * ideal).sum(-1) / torch.where(off, size, 1.0) - 1, 0.0)


def paraxial_points(
    system: optical_system,
    prescription: Prescription | None = None,
    fields: FieldPoints | None = None,
    projection: str = "tangent",
) -> torch.Tensor:
    """Return the points of the paraxial chief rays in the image plane, ``[..., F, 2]``, at the reference wavelength."""
    projection = _validate.one_of("projection", projection, ("tangent", "angle"))
    numbers = numbers_of(system, prescription).at(system.reference)
    check_media(system, numbers)
    index = signed_indices(system, numbers)
    whole = [matrix(numbers, index, 0, len(system.surfaces), gap=True)] * 2
    if numbers.shapes is not None or numbers.phases is not None:
        whole[0] = matrix(numbers, index, 0, len(system.surfaces), gap=True, axis=0)
    pupil = entrance_pupil(system, prescription=numbers)
    points = field_points(system, fields).to(index.device)
    if projection == "angle" and not system.at_infinity:
        raise ValueError(f'projection must be "tangent" for an object at {system.object_distance:g}, got "angle"')
    if system.at_infinity:
        angle, beyond = torch.deg2rad(points), (points.abs() >= 90).any(-1, keepdim=True)
        if projection == "tangent" and is_readable(points) and bool(beyond.any()):
            raise ValueError(
                'fields must be below 90 degrees for the projection "tangent", got '
                f'{float(points.abs().max()):g} degrees; "angle" takes them'
            )
        slope = torch.tan(torch.where(beyond, 0.0, angle))
        if projection == "angle":
            size = slope.square().sum(-1, keepdim=True).sqrt()
            share = torch.where(size > 0, torch.atan(size) / torch.where(size > 0, size, 1.0), 1.0)
            slope = torch.where(beyond, angle, slope * share)
        height = -pupil.distance[..., None, None] * slope
    else:
        slope = -points * pupil.bend[..., None, None]
        height = points + system.object_distance * slope
    a, b = (
        torch.stack(torch.broadcast_tensors(*pair), -1)[..., None, :] for pair in list(zip(*whole, strict=True))[:2]
    )
    return a * height + b * index[..., 0, None, None] * slope


@differentiates
def field_curvature(
    system: optical_system, prescription: Prescription | None = None, **options: "Unpack[FieldOptions]"
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
        Tangential (rays in the y–z plane) and sagittal (x–z), ``[..., W, F]``, for fields along y; infinite where rays
        stay parallel.

    Notes
    -----
    Foci of rays infinitely close to the chief ray: Coddington's equations, by automatic differentiation.

    Examples
    --------
    On the axis both foci are the same:

    >>> from odak.learn.raytracing.system import field_curvature, load_system
    >>> lens = load_system("cooke_triplet")
    >>> tangential, sagittal = field_curvature(lens)
    >>> bool((tangential - sagittal)[:, 0].abs().max() < 1e-6)
    True
    """
    own: dict[str, Any] = {name: options[name] for name in ("fields", "aim") if name in options}
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
    required = any(value.requires_grad for value in system.parameters())
    required = required or (prescription is not None and prescription.requires_grad())
    if not (torch.is_grad_enabled() and required):
        foci = [value.detach() for value in foci]
    return foci[0], foci[1]


def _along(value: torch.Tensor, place: torch.Tensor, axis: int) -> torch.Tensor:
    """Return the derivative of each entry ``[..., W, F, 1]`` by the pupil coordinate, ``[..., W, F]``."""
    # The vector-Jacobian product is linear in the vector; its derivative by the vector is a column of the Jacobian.
    vector = torch.ones_like(value).requires_grad_()
    options: dict[str, Any] = {"create_graph": True, "allow_unused": True, "materialize_grads": True}
    # Slopes of parallel rays that meet planes alone do not depend on the pupil.
    if value.requires_grad:
        product = torch.autograd.grad(value, place, vector, **options)[0][0, axis]
        if product.requires_grad:
            return torch.autograd.grad(product, vector, **options)[0][..., 0]
    return torch.zeros_like(value[..., 0])


@_show.shown
class Wavefront(NamedTuple):
    """Path differences of a bundle of rays.

    Attributes
    ----------
    path : torch.Tensor
        Optical path to the reference sphere less the path of the chief ray, in wavelengths, ``[..., W, F, P]``; NaN
        where a ray is lost. Positive where the wave lags: where the path from the object to the reference sphere is
        longer for the ray than for the chief ray. Signs differ from programs that subtract the path of the ray from
        the path of the chief ray.
    rms : torch.Tensor
        Its standard deviation over the area of the pupil where the rays have weights, over the rays where they have
        none, ``[..., W, F]``.
    pupil : torch.Tensor
        Pupil coordinates, ``[P, 2]``, or ``[F, P, 2]`` where each field has its own.
    cosines : torch.Tensor
        Direction cosines u, v of the rays in image space less the chief ray's, ``[..., W, F, P, 2]``.
    status : torch.Tensor
        int8, numbers of :class:`odak.raytracing.RayStatus`: what befell the ray first.
    weights : torch.Tensor or None
        Fractions of the area of the pupil that the rays stand for, ``[P]`` or ``[F, P]``; None where all are alike.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Wavefront, load_system, wavefront
    >>> lens = load_system("cooke_triplet")
    >>> found = wavefront(lens, "rings", 2)
    >>> tuple(found.path.shape[-2:]) == (len(lens.fields), 19)
    True
    """

    path: torch.Tensor
    rms: torch.Tensor
    pupil: torch.Tensor
    cosines: torch.Tensor
    status: torch.Tensor
    weights: torch.Tensor | None = None


def wavefront(
    system: optical_system,
    pupil: Pupil = "gauss",
    count: int = 12,
    *,
    prescription: Prescription | None = None,
    fields: FieldPoints | None = None,
    aim: str = "paraxial",
    vignetting: bool = True,
) -> Wavefront:
    """Return the wavefront in the exit pupil, against the sphere about the chief ray's image point.

    Parameters
    ----------
    system : optical_system
        The system.
    pupil : str or torch.Tensor
        Pattern of :func:`pupil_samples`, points of :func:`pupil_quadrature`, or points ``[P, 2]`` in units of the
        pupil's radius; ``[F, P, 2]`` for points of each field's own.
    count : int
        Count of :func:`pupil_samples`.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps.
    fields : sequence of pairs or torch.Tensor, optional
        Field points in place of the system's.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    vignetting : bool
        Let apertures block rays.

    Returns
    -------
    Wavefront
        float64, differentiable.

    Notes
    -----
    The sphere of each wavelength and field is centred where the chief ray of that wavelength intersects the image
    surface, and passes through the paraxial exit pupil's centre, which may be at infinity. Welford, Aberrations of
    Optical Systems (1986), section 7.2. Rays of "gauss" have the weights of a Gaussian quadrature, so that means over
    the pupil do not depend on their number; where an aperture cuts the pupil, the nodes of :func:`pupil_quadrature`
    follow its rim.

    Examples
    --------
    A parabolic mirror images a distant point on its axis without aberration:

    >>> from odak.learn.raytracing.system import optical_system, surface, wavefront
    >>> parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0, material="mirror")
    >>> mirror = optical_system([parabola], aperture=20.0)
    >>> float(wavefront(mirror).rms.max()) < 1e-6
    True
    """
    options: dict[str, Any] = {"prescription": prescription, "fields": fields, "aim": aim}
    return wavefront_with_rays(system, pupil, count, vignetting=vignetting, **options)[0]


def wavefront_with_rays(
    system: optical_system, pupil: Pupil, count: int, *, vignetting: bool = True, **options: Any
) -> tuple[Wavefront, Traced]:
    """Return a :func:`wavefront` and its rays in the image; the chief ray comes first and stands for those lost."""
    vignetting, prescription = _validate.flag("vignetting", vignetting), options.get("prescription")
    points = pupil_of(pupil, count, system)
    rays = launch(system, torch.cat([torch.zeros_like(points[..., :1, :]), points], -2), **options)
    traced = trace(system, rays, prescription=prescription, vignetting=vignetting)
    if vignetting:
        # The chief ray is the reference even where the centre of the pupil is blocked.
        chief = Rays(*(value[..., :1] for value in rays))
        alone = trace(system, chief, prescription=prescription, vignetting=False)
        traced = type(traced)(*(torch.cat([a, b[..., 1:]], -1) for a, b in zip(alone, traced, strict=True)))
    status = traced.status[..., 1:]
    kept = status == 0
    # Lost rays are replaced by the chief ray, so that no NaN enters a gradient.
    lost = torch.cat([torch.zeros_like(kept[..., :1]), ~kept], -1)
    held = [torch.where(lost, value[..., :1].detach(), value) for value in traced[:-1]]
    traced = type(traced)._make([*held, traced.status])
    numbers = numbers_of(system, prescription)
    index = numbers.index[..., -1][..., None, None]
    path = path_at_start(system, rays, numbers) + traced.path + index * _to_sphere(system, traced, prescription)
    lag = path[..., 1:] - path[..., :1]
    lag = torch.where(kept, lag, 0.0) / wavelengths_of(system, numbers)[:, None, None]
    weights = weights_of(pupil, count, lag)
    share = kept.to(lag) if weights is None else kept * weights
    number = share.sum(-1)
    total = torch.where(number > 0, number, 1.0)
    mean = (share * lag).sum(-1) / total
    spread = (share * torch.where(kept, lag - mean[..., None], 0.0).square()).sum(-1) / total
    rms = torch.where(spread > 0, torch.where(spread > 0, spread, 1.0).sqrt(), 0 * spread)
    rms = torch.where(number > 0, rms, torch.nan)
    cosines = torch.stack([value[..., 1:] - value[..., :1] for value in (traced.u, traced.v)], -1)
    cosines = torch.where(kept[..., None], cosines, torch.nan)
    return Wavefront(torch.where(kept, lag, torch.nan), rms, points, cosines, status, weights), traced


def path_at_start(system: optical_system, rays: Rays, numbers: Prescription) -> float | torch.Tensor:
    """Return the optical path of rays up to their starts, from a plane wavefront or from one point."""
    if not system.at_infinity:
        return 0.0
    return numbers.index[..., :1][..., None] * (rays.x * rays.u + rays.y * rays.v + rays.z * rays.w)


def _to_sphere(system, traced, prescription):
    """Return the distance from the image surface back along each ray to the sphere, less the sphere's radius."""
    properties = first_order(system, prescription=prescription)
    last = (system.surfaces[-1].thickness if prescription is None else prescription.thickness[..., -1]).double()
    center = [value[..., :1] for value in traced[:3]]
    gap = (last - properties.exit_pupil_distance)[..., None, None, None]
    gap = gap.clamp(-FAR, FAR) + center[2]
    side = torch.sign(gap * traced.w[..., :1]).detach()
    radius = (center[0].square() + center[1].square() + gap * gap).sqrt()
    away = [value - middle for value, middle in zip(traced[:3], center, strict=True)]
    along = sum(cosine * value for cosine, value in zip(traced[3:6], away, strict=True))
    rest = along * along - sum(value * value for value in away)
    # s + R with s = −b ∓ √(b² − q + R²), written without the cancellation of large numbers.
    return -along - side * rest / ((rest + radius * radius).sqrt() + radius)


def zernike_fit(found: Wavefront, terms: int = 15, order: str = "noll") -> tuple[torch.Tensor, torch.Tensor]:
    """Return the Zernike polynomials of a wavefront, by least squares over its rays.

    Parameters
    ----------
    found : Wavefront
        From :func:`wavefront`.
    terms : int
        Number of polynomials from the first (piston).
    order : str
        Which: "noll", the standard polynomials of OpticStudio, and "osa", of the ANSI Z80.28 standard, each with a root
        mean square of 1 over the disc; "fringe", at most 37, each 1 at the rim.

    Returns
    -------
    tuple of torch.Tensor
        Coefficients ``[..., W, F, terms]`` in wavelengths, and the root mean square of what the polynomials leave,
        ``[..., W, F]``. Angles count from the x axis of the pupil towards y.

    Raises
    ------
    ValueError
        If there are fewer rays than polynomials.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, wavefront, zernike_fit
    >>> lens = load_system("cooke_triplet")
    >>> coefficients, residual = zernike_fit(wavefront(lens), terms=15)
    >>> coefficients.shape[-1]
    15
    """
    _validate.instance("found", found, Wavefront, "a Wavefront")
    terms = _validate.integer("terms", terms, minimum=1)
    radius, angle = _polar(found.pupil)
    if radius.shape[-1] < terms:
        raise ValueError(f"terms must be at most the number of rays, {radius.shape[-1]}, got {terms}")
    order = _validate.one_of("order", order, tuple(ORDERS))
    index, first = ORDERS[order]
    modes = [index(j) for j in range(first, first + terms)]
    norms = [1.0 if order == "fringe" else zernike_norm(*mode) for mode in modes]
    values = [norm * zernike_polynomial(*mode, radius, angle) for mode, norm in zip(modes, norms, strict=True)]
    return _fitted(found, torch.stack(values, -1))


@_show.shown
class QFit(NamedTuple):
    """Coefficients of a wavefront in Forbes' gradient-orthogonal polynomials.

    Attributes
    ----------
    base : torch.Tensor
        Coefficients of 1 and of the square of the pupil's radius, in wavelengths, ``[..., W, F, 2]``.
    cosine : torch.Tensor
        Coefficients aₙᵐ, ``[..., W, F, azimuthal + 1, radial]`` with the orders m from 0 and the degrees n from 0.
    sine : torch.Tensor
        Coefficients bₙᵐ, of the same shape; zero for m = 0.
    residual : torch.Tensor
        Root mean square of what the polynomials leave, ``[..., W, F]``.

    Examples
    --------
    >>> from odak.learn.raytracing.system import QFit, load_system, q_fit, wavefront
    >>> isinstance(q_fit(wavefront(load_system("cooke_triplet")), radial=3), QFit)
    True
    """

    base: torch.Tensor
    cosine: torch.Tensor
    sine: torch.Tensor
    residual: torch.Tensor


def q_fit(found: Wavefront, radial: int = 4, azimuthal: int = 4) -> QFit:
    """Return Forbes' polynomials of a wavefront, by least squares over its rays.

    Parameters
    ----------
    found : Wavefront
        From :func:`wavefront`.
    radial : int
        Number of polynomials for each azimuthal order.
    azimuthal : int
        Largest azimuthal order m.

    Returns
    -------
    QFit
        Coefficients in wavelengths. The sum of the squares of `cosine` and `sine` is the mean square gradient of their
        part of the wavefront, per radius of the pupil, with the weight 1/(u √(1 − u²)) over its area.

    Raises
    ------
    ValueError
        If there are fewer rays than polynomials.

    Notes
    -----
    W = c₀ + c₁u² + u²(1 − u²) Σ aₙ⁰ Qₙ⁰(u²) + Σ uᵐ Σ (aₙᵐ cos mθ + bₙᵐ sin mθ) Qₙᵐ(u²) with the radius u in the pupil
    and the angle θ from its x axis; c is `base`. The polynomials Qₙᵐ have degree n, are positive at u = 0, and make the
    terms orthonormal in the weighted mean of the product of gradients. G. W. Forbes, "Characterizing the shape of
    freeform optics", Opt. Express 20, 2483 (2012), doi:10.1364/OE.20.002483.

    Examples
    --------
    At a field point on the y axis, coma is in the sine terms of the first order:

    >>> from odak.learn.raytracing.system import load_system, q_fit, wavefront
    >>> found = q_fit(wavefront(load_system("cooke_triplet"), fields=[(0.0, 14.0)]))
    >>> bool(found.sine[1, 0, 1].abs().max() > 1e6 * found.cosine[1, 0, 1].abs().max())
    True
    """
    _validate.instance("found", found, Wavefront, "a Wavefront")
    radial, azimuthal = _validate.integer("radial", radial, minimum=1), _validate.integer("azimuthal", azimuthal)
    radius, angle = _polar(found.pupil)
    number = 2 + radial * (2 * azimuthal + 1)
    if radius.shape[-1] < number:
        raise ValueError(
            f"radial and azimuthal must give at most as many polynomials as rays, {radius.shape[-1]}; got {number}"
        )
    square = radius.square()
    terms = [torch.ones_like(square)[..., None], square[..., None]]
    values = [_q_terms(m, radial, square) for m in range(azimuthal + 1)]
    window = [square * (1 - square), *(radius**m for m in range(1, azimuthal + 1))]
    terms += [(window[m] * torch.cos(m * angle))[..., None] * values[m] for m in range(azimuthal + 1)]
    terms += [(window[m] * torch.sin(m * angle))[..., None] * values[m] for m in range(1, azimuthal + 1)]
    coefficients, residual = _fitted(found, torch.cat(terms, -1))
    shape = (azimuthal + 1, radial)
    cosine = coefficients[..., 2 : 2 + shape[0] * radial].unflatten(-1, shape)
    sine = coefficients[..., 2 + shape[0] * radial :].reshape(*residual.shape, azimuthal, radial)
    sine = torch.cat([torch.zeros_like(cosine[..., :1, :]), sine], -2)
    return QFit(coefficients[..., :2], cosine, sine, residual)


def _q_terms(m: int, count: int, square: torch.Tensor) -> torch.Tensor:
    """Return Forbes' Q_n^m for n below `count` at squares of the radius, ``[..., count]``.

    They are Legendre polynomials made orthonormal by the Cholesky factor of the matrix of their weighted mean products
    of gradients, an integral that the Gauss–Chebyshev rule gives exactly.
    """
    nodes = 2 * (count + max(m, 2))
    u = np.cos((np.arange(nodes) + 0.5) * np.pi / (2 * nodes))
    derivatives, values = np.zeros((2, count, nodes))
    window, slope = (u**2 - u**4, 2 * u - 4 * u**3) if m == 0 else (u**m, m * u ** (m - 1))
    for n in range(count):
        legendre = np.polynomial.Legendre.basis(n, domain=[0, 1])
        values[n] = window * legendre(u**2) / u
        derivatives[n] = slope * legendre(u**2) + window * legendre.deriv()(u**2) * 2 * u
    matrix = (derivatives @ derivatives.T + m**2 * values @ values.T) / (nodes * (2 if m else 1))
    factor = np.linalg.inv(np.linalg.cholesky(matrix))
    # At u = 0 Legendre's polynomials are (−1)ⁿ.
    factor *= np.sign(factor @ (-1.0) ** np.arange(count))[:, None]
    x = 2 * square - 1
    legendre = [torch.ones_like(x), x]
    for n in range(1, count - 1):
        legendre.append(((2 * n + 1) * x * legendre[-1] - n * legendre[-2]) / (n + 1))
    return torch.stack(legendre[:count], -1) @ torch.as_tensor(factor.T).to(square)


def _polar(pupil: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the radius, at most 1, and the angle of points of the pupil."""
    return pupil.square().sum(-1).sqrt().clamp(max=1.0), torch.atan2(pupil[..., 1], pupil[..., 0])


def _fitted(found: Wavefront, basis: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the coefficients of a basis ``[..., P, terms]`` by least squares, and the root mean square of the rest."""
    kept = (found.status == 0)[..., None]
    share = torch.ones_like(basis[..., :1]) if found.weights is None else found.weights[..., None].sqrt()
    weighted = torch.where(kept, share * basis, 0.0)
    values = torch.where(kept, share * found.path[..., None], 0.0)
    coefficients = torch.linalg.lstsq(weighted, values).solution
    left = (weighted @ coefficients - values).square().sum((-2, -1)) / (kept * share.square()).sum((-2, -1))
    return coefficients[..., 0], torch.where(left > 0, torch.where(left > 0, left, 1.0).sqrt(), 0.0)


def _checked_fan(axis: str, count: int) -> str:
    """Return the axis of a fan, and check that the middle one of its rays is the chief ray."""
    axis = _validate.one_of("axis", axis, ("x", "y"))
    if _validate.integer("count", count, minimum=3) % 2 == 0:
        raise ValueError(f"count must be odd, got {count}")
    return axis
