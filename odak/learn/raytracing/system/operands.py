"""Operands of a merit function: quantities of a design with their targets, bounds and weights."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from scipy.spatial import ConvexHull

from odak import _validate
from odak.catalog import glass_makers, material, material_names
from odak.catalog.materials import OpticalMaterial
from odak.learn.raytracing.system.analysis import (
    Wavefront,
    axial_color,
    outward_distances,
    paraxial_points,
    relative_deviation,
    wavefront,
)
from odak.learn.raytracing.system.paraxial import FirstOrder, first_order
from odak.learn.raytracing.system.prescriptions import Prescription
from odak.learn.raytracing.system.pupils import Pupil, launch, pupil_of, weights_of
from odak.learn.raytracing.system.surfaces import (
    field_shares,
    is_break,
    layout_of,
    optical_system,
    reference_of,
    wavelength_shares,
)
from odak.learn.raytracing.system.tracing import Rays, Traced, in_surface_frame, trace
from odak.learn.raytracing.system.waves import RAYS, chosen_samples, modulation_in_planes
from odak.raytracing.surfaces import EvenAsphere, Sag

# Distance in 0.01 of n_d and 1 of V_d below which two glasses count as the same one of two makers.
SAME_GLASS = 0.3


class Operand(NamedTuple):
    """Number, or several numbers, that enter the merit of a system.

    Attributes
    ----------
    kind : str or callable
        A name of :data:`OPERANDS`, an attribute of :class:`FirstOrder` ("focal_length", "f_number",
        "back_focal_distance", …), or a function ``(system, prescription)`` that returns a tensor ``[...]`` or
        ``[..., n]``, whose first axes are the batch of systems.
    target : float, optional
        What it should be. 0 if there are no bounds either.
    weight : float
        The merit is half the sum of (weight·(value − target))².
    lower, upper : float, optional
        Bounds; the residual is 0 within them, and the distance from the nearer bound outside.
    options : mapping
        Keyword arguments of the kind, as `surfaces` of a thickness or `frequency` of the modulation transfer, whose
        `samples` across the pupil are as many as resolve the wavefront by default.

    Examples
    --------
    A focal length of 100, and a back focal distance of at least 80:

    >>> from odak.learn.raytracing.system import Operand
    >>> operands = [Operand("focal_length", 100.0), Operand("back_focal_distance", lower=80.0)]
    >>> [operand.kind for operand in operands]
    ['focal_length', 'back_focal_distance']
    """

    kind: str | Callable[..., Any]
    target: float | None = None
    weight: float = 1.0
    lower: float | None = None
    upper: float | None = None
    options: Mapping[Any, Any] = {}

    def residuals(self, values: torch.Tensor) -> torch.Tensor:
        """Return the residuals of the values ``[..., n]``: the merit is half the sum of their squares."""
        free, limits = self._deviations(values)
        return torch.cat([free, limits.clamp_min(0.0)], -1)

    def _deviations(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the residuals from the target and those from bounds, negative within them."""
        sides = [self.lower is not None, self.upper is not None]
        free = values - (self.target or 0.0) if self.target is not None or not any(sides) else values[..., :0]
        limits = [values[..., :0]]
        if self.lower is not None:
            limits.append(self.lower - values)
        if self.upper is not None:
            limits.append(values - self.upper)
        return self.weight * free, abs(self.weight) * torch.cat(limits, -1)


Operands: TypeAlias = str | Operand | Iterable[str | Operand]


class View:
    """A system at given numbers, whose rays are traced once for all operands.

    Parameters
    ----------
    system : optical_system
        The system.
    prescription : Prescription
        Its numbers, perhaps of a batch of systems.
    pupil : str, PupilQuadrature or torch.Tensor
        Pattern of :func:`pupil_samples`, or points ``[P, 2]``, or ``[F, P, 2]`` for points of each field's own.
    count : int
        Count of :func:`pupil_samples`.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    heights : torch.Tensor, optional
        Clear semi-diameters of the surfaces, ``[S]`` or ``[..., S]``, for the thickness at the edge; by default the
        largest distances of rays from the axis, functions of the prescription.
    glass : torch.Tensor, optional
        n_d and V_d behind each surface, ``[..., S, 2]``, where glasses vary.
    """

    def __init__(
        self,
        system: optical_system,
        prescription: Prescription,
        pupil: Pupil = "rings",
        count: int = 4,
        aim: str = "paraxial",
        heights: torch.Tensor | None = None,
        glass: torch.Tensor | None = None,
    ):
        self.system: optical_system = system
        self.prescription: Prescription = prescription
        self.given_heights: torch.Tensor | None = heights
        self.glass: torch.Tensor | None = glass
        self.options: dict[str, Any] = {"prescription": prescription, "aim": aim}
        self.points: torch.Tensor = pupil_of(pupil, count, system)
        weights = weights_of(pupil, count, self.points)
        self.weights: Any = 1.0 if weights is None else weights / weights.mean(-1, keepdim=True)

    @cached_property
    def first_order(self) -> FirstOrder:
        """First-order properties at the reference wavelength."""
        return first_order(self.system, prescription=self.prescription)

    @cached_property
    def heights(self) -> torch.Tensor:
        """Clear semi-diameters of the surfaces, ``[..., S]``."""
        if self.given_heights is not None:
            return self.given_heights
        return clear_heights(self.system, self.prescription, aim=self.options["aim"])

    @cached_property
    def _all(self) -> Traced:
        points = torch.cat([torch.zeros_like(self.points[..., :1, :]), self.points], -2)
        rays = launch(self.system, points, **self.options)
        return trace(self.system, rays, prescription=self.prescription, vignetting=False)

    @property
    def traced(self) -> Traced:
        """Rays of all fields and wavelengths through the pupil, ``[..., W, F, P]``, not vignetted."""
        return Traced(*(value[..., 1:] for value in self._all))

    @property
    def chief(self) -> Traced:
        """Chief rays ``[..., F]`` of the reference wavelength."""
        return Traced(*(value[..., reference_of(self.system, self.prescription), :, 0] for value in self._all))

    @cached_property
    def wavefront(self) -> Wavefront:
        """Wavefronts of all fields and wavelengths."""
        return wavefront(self.system, self.points, vignetting=False, **self.options)


def edge_thicknesses(
    view: View,
    surfaces: Any = None,
    heights: Any = None,
    shares: Any = (1.0,),
    flanges: bool = False,
    per_diameter: float = 0.0,
) -> torch.Tensor:
    """Return thicknesses along z between neighbouring surfaces at a distance from the axis, ``[..., n]``.

    Parameters
    ----------
    view : View
        The system.
    surfaces : sequence of int, optional
        Surfaces in front of the thicknesses; all but the last by default.
    heights : float or sequence of float, optional
        Distance from the axis for each; by default the larger of the clear semi-diameters of both neighbours.
    shares : sequence of float
        Shares of these distances at which the thickness is taken.
    flanges : bool
        Whether each surface is a plane beyond its own clear semi-diameter times the largest share, as in moulded
        lenses, rather than of the same shape up to its neighbour's semi-diameter.
    per_diameter : float
        Share of the diameter, twice the distance, that is subtracted: what remains is a room above a limit by diameter.
    """
    p = view.prescription
    count = p.thickness.shape[-1]
    places = _places(surfaces, count, range(count - 1))
    # Behind the last surface is the plane of the image.
    behind = [min(i + 1, count - 1) for i in places]
    curved = torch.tensor([float(i + 1 < count) for i in places], dtype=torch.float64, device=p.thickness.device)
    each = None
    if heights is None:
        clear = view.heights
        each = torch.maximum(clear[..., places], clear[..., behind] * curved)
    y = _at_shares(p, len(places), heights, each, shares)
    least = 2 * per_diameter * _at_shares(p, len(places), heights, each, (1.0,)) if per_diameter else 0.0
    ends = [y, y]
    if flanges:
        ends = [torch.minimum(y, max(shares) * view.heights[..., own]) for own in (places, behind)]
    gaps = p.thickness[..., places] - _sags(p, places, ends[0]).height + _sags(p, behind, ends[1]).height * curved
    return (gaps - least).movedim(0, -1).flatten(-2)


def slopes(view: View, surfaces: Any = None, heights: Any = None, shares: Any = (1.0,)) -> torch.Tensor:
    """Return slopes dz/dr of surfaces at a distance from the axis, ``[..., n]``.

    Parameters
    ----------
    view : View
        The system.
    surfaces : sequence of int, optional
        Which surfaces; all by default.
    heights : float or sequence of float, optional
        Distance from the axis for each; by default its clear semi-diameter.
    shares : sequence of float
        Shares of these distances at which the slope is taken.
    """
    p = view.prescription
    places = _places(surfaces, p.thickness.shape[-1], range(p.thickness.shape[-1]))
    each = None if heights is not None else view.heights[..., places]
    y = _at_shares(p, len(places), heights, each, shares)
    return _sags(p, places, y).slope_y.movedim(0, -1).flatten(-2)


def _sags(p: Prescription, places: list[int], y: torch.Tensor) -> Sag:
    """Return the sags of surfaces at distances ``[shares, ..., n]`` from the axis; standard surfaces in one call."""
    if p.shapes is None or all(p.shapes[i] is None for i in places):
        return EvenAsphere(p.curvature[..., places], p.conic[..., places], p.coefficients[..., places, :]).sag(0 * y, y)
    found = [p.shape(i).sag(0 * y[..., k], y[..., k]) for k, i in enumerate(places)]
    return Sag(*(torch.stack(torch.broadcast_tensors(*parts), -1) for parts in zip(*found, strict=True)))


def _at_shares(p: Prescription, count: int, heights: Any, each: Any, shares: Any) -> torch.Tensor:
    """Return distances from the axis ``[shares, ..., n]`` of n places."""
    device = p.thickness.device
    if each is None:
        each = torch.stack(
            [torch.as_tensor(h, dtype=torch.float64, device=device) for h in _spread(heights, count)], -1
        )
    parts = torch.tensor([*shares], dtype=torch.float64, device=device)
    return parts.reshape(-1, *(1,) * max(each.ndim - 1, len(p.batch)), 1) * each


def _places(surfaces, count: int, default: Iterable[int]) -> list[int]:
    if surfaces is None:
        return list(default)
    listed = list(surfaces) if isinstance(surfaces, Iterable) else [surfaces]
    return [_validate.place_in("surfaces", place, count) for place in listed]


def _spread(values, count: int) -> list[Any]:
    values = list(values) if isinstance(values, Iterable) else [values] * count
    if len(values) != count:
        raise ValueError(f"heights must be one or one for each of {count} surfaces, got {len(values)}")
    return values


def _thickness(view: View, surfaces: Any = None) -> torch.Tensor:
    thickness = view.prescription.thickness
    places = _places(surfaces, thickness.shape[-1], range(thickness.shape[-1]))
    return thickness[..., places]


def _total_track(view: View, first: int = 0) -> torch.Tensor:
    """From a vertex, the first one's by default, to the image plane along the axis."""
    return view.prescription.thickness[..., first:].sum(-1, keepdim=True)


def _weighted(values: torch.Tensor, fields: Any, axis: int) -> torch.Tensor:
    """Multiply values by one weight for each field along an axis."""
    if fields is None:
        return values
    weights = torch.as_tensor(fields, dtype=values.dtype, device=values.device)
    return values * weights.reshape(-1, *(1,) * (-axis - 1))


def _shares(view: View, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the weights of wavelengths and of fields relative to their means, for values ``[..., W, F, P]``."""
    system = view.system
    wavelengths = wavelength_shares(system, view.prescription, values)
    return wavelengths[:, None, None], field_shares(system, values)[:, None]


def _spot(view: View, fields: Any = None, lost: float | None = None) -> torch.Tensor:
    """Distances from the centroid of each field, all wavelengths; their squares sum to Σ rms², by field weights.

    The system's own weights of fields and wavelengths, relative to their means, multiply the squares; `fields` the
    distances. With `lost`, rays that are lost are put at this distance, which no step changes.
    """
    traced, found = view.traced, []
    number = traced.x.shape[-3] * traced.x.shape[-1]
    good = traced.arrived | (lost is None)
    share, own = _shares(view, traced.x)
    share = share * view.weights
    count = (share * good).sum((-3, -1), keepdim=True).clamp_min(1e-300)
    for value in (traced.x, traced.y):
        value = torch.where(good, value, 0.0)
        centre = (share * value).sum((-3, -1), keepdim=True) / count
        around = torch.where(good, value - centre, 0.0) * (share * own).sqrt() / number**0.5
        found.append(_weighted(around, fields, -2).flatten(-3))
    if lost is not None:
        gone = (share * own * ~good).sum((-3, -1)) / number
        found.append(_weighted(lost * gone.sqrt(), fields, -1))
    return torch.cat(found, -1)


def _wavefront(view: View, fields: Any = None) -> torch.Tensor:
    """Path differences from their mean in wavelengths; their squares sum to Σ rms² of all fields and wavelengths."""
    path = view.wavefront.path
    share, own = _shares(view, path)
    around = path - (view.weights * path).mean(-1, keepdim=True)
    around = around * (share * own * view.weights).sqrt() / path.shape[-1] ** 0.5
    return _weighted(around, fields, -2).flatten(-3)


def _modulation(view: View, frequency: float, axis: str = "y", samples: int | None = None) -> torch.Tensor:
    """Modulation transfer at a frequency in cycles per unit of length, at all wavelengths and fields."""
    axis = _validate.one_of("axis", axis, ("x", "y"))
    counts = chosen_samples(samples, (24, 32, 48, *RAYS))
    here = torch.zeros(1, dtype=torch.float64)
    options = {"vignetting": False, **view.options}
    return modulation_in_planes(view.system, here, frequency, counts, (axis,), **options)[0, ..., 0].flatten(-2)


def _distortion(view: View) -> torch.Tensor:
    """Relative distortion of all fields at the reference wavelength."""
    points = torch.stack([view.chief.x, view.chief.y], -1)
    return relative_deviation(points, paraxial_points(view.system, view.prescription))


def _lateral_color(view: View) -> torch.Tensor:
    """Distances of the chief rays from the chief ray at the reference wavelength, at all wavelengths and fields."""
    return outward_distances(view._all, view.system, view.prescription).flatten(-2)


def _axial_color(view: View) -> torch.Tensor:
    """Largest distance between the paraxial images of two wavelengths."""
    shift = axial_color(view.system, prescription=view.prescription)
    return (shift.amax(-1) - shift.amin(-1))[..., None]


def _chief_ray_angle(view: View) -> torch.Tensor:
    """Angle of the chief rays against the axis behind the last surface in degrees, of all fields."""
    chief = view.chief
    across = (chief.u.square() + chief.v.square()).clamp_min(1e-30).sqrt()
    return torch.rad2deg(torch.atan2(across, chief.w.abs()))


def _incidence(view: View, surfaces: Any = None, count: int = 4) -> torch.Tensor:
    """Sines of the angles between rays and normals at refracting surfaces, on the side where they are larger.

    Rays of all fields at the reference wavelength through the centre of the pupil and `count` points of its rim. The
    sine of a ray that is reflected totally would be larger than 1; for rays that are lost it is set to 1.
    """
    system = view.system
    p = view.prescription.at(reference_of(system, view.prescription))
    layout = layout_of(system.surfaces, p, None, vignetting=False)
    if not layout.standard or "reflect" in layout.actions:
        raise ValueError("an operand of incidence needs refracting planes, conics and aspheres without tilts")
    places = [i for i, action in enumerate(layout.actions[:-1]) if action == "refract"]
    wanted = places if surfaces is None else _places(surfaces, len(layout.actions) - 1, ())
    if not set(wanted) <= set(places):
        raise ValueError(f"surfaces of an operand of incidence must refract, got {wanted}")
    turn = torch.arange(count, dtype=torch.float64) * (2 * math.pi / count)
    points = torch.cat([torch.zeros(1, 2, dtype=torch.float64), torch.stack([turn.sin(), turn.cos()], -1)])
    rays = launch(system, points, **(view.options | {"prescription": p}))
    # A batch of systems that end behind one surface after the other: directions behind all surfaces in one trace.
    here = torch.tensor(places, device=p.thickness.device)[:, None]
    order = torch.arange(p.thickness.shape[-1] + 1, device=here.device)
    kept = (order[:-1] <= here).double()
    ends = p._replace(
        curvature=p.curvature[..., None, :] * kept,
        conic=p.conic[..., None, :] * kept,
        thickness=p.thickness[..., None, :] * kept,
        coefficients=p.coefficients[..., None, :, :] * kept[..., None],
        index=p.index[..., torch.minimum(order, here + 1)].movedim(-2, -3),
    )
    rays = Rays(
        *(value[..., None, :, :, :].expand(*value.shape[:-3], len(places), *value.shape[-3:]) for value in rays)
    )
    behind = trace(system, rays, prescription=ends, vignetting=False)
    along: Any = 0.0
    for old, new in zip(rays[3:], behind[3:6], strict=True):
        first = old.expand(new.shape)[..., :1, :, :, :]
        along = along + torch.cat([first, new[..., :-1, :, :, :]], -4) * new
    n1, n2 = (p.index[..., [i + side for i in places]].movedim(-1, -2)[..., None, None] for side in (0, 1))
    # The change n₂d₂ − n₁d₁ is along the normal.
    change = (n1 * n1 + n2 * n2 - 2 * n1 * n2 * along).clamp_min(1e-30).sqrt()
    sine = torch.maximum(n1, n2) * (1 - along * along).clamp_min(1e-30).sqrt() / change
    sine = torch.where(behind.arrived, sine, 1.0)
    return sine[..., [places.index(i) for i in wanted], 0, :, :].flatten(-3)


def _telecentricity(view: View) -> torch.Tensor:
    """Slopes of the chief rays against the axis behind the last surface along x and y, of all fields."""
    chief = view.chief
    return torch.cat([chief.u / chief.w, chief.v / chief.w], -1)


def _glass(view: View, surfaces: Any, makers: Any = ("schott",), hull: bool = False) -> torch.Tensor:
    """Differences from the nearest glass of the makers' catalogues, in 0.01 of n_d and 1 of V_d.

    With `hull`, how far outside of each edge of :func:`glass_hull` the glasses are, negative inside.
    """
    places = _places(surfaces, view.prescription.thickness.shape[-1], ())
    if view.glass is None:
        raise ValueError("an operand of glass needs a variable of glass")
    makers = tuple(_validate.texts("makers", makers))
    own = view.glass[..., places, :]
    if hull:
        normals, offsets = glass_hull(makers)
        n, v = own.unbind(-1)
        return (100 * n[..., None] * normals[:, 0] + 1000 / v[..., None] * normals[:, 1] - offsets).flatten(-2)
    known, own = glass_pool(makers)[1], own * torch.tensor([100.0, 1.0], dtype=torch.float64)
    nearest = known[(own.detach()[..., None, :] - known).square().sum(-1).argmin(-1)]
    return (own - nearest).flatten(-2)


@cache
def glass_pool(makers: tuple[str, ...]) -> tuple[list[OpticalMaterial], torch.Tensor]:
    """Return all glasses of some makers, and their n_d/0.01 and V_d, ``[n, 2]``."""
    named = [_validate.one_of("makers", maker, glass_makers()) for maker in makers]
    items: list[Any] = [material(name) for maker in named for name in material_names(maker)]
    pool = [item for item in items if item.nd and item.vd]
    return pool, torch.tensor([[100 * item.nd, item.vd] for item in pool], dtype=torch.float64)


@cache
def glass_hull(makers: tuple[str, ...]) -> tuple[torch.Tensor, torch.Tensor]:
    """Return normals ``[edges, 2]`` and offsets ``[edges]`` of the convex hull of some makers' glasses.

    A glass of n_d/0.01 and 1000/V_d is within the hull where its products with all normals are at most the offsets. In
    1/V_d the borders of the catalogues are nearly straight, so that hardly any of the hull is empty.
    """
    n, v = glass_pool(makers)[1].unbind(-1)
    edges = torch.from_numpy(ConvexHull(torch.stack([n, 1000 / v], -1).numpy()).equations)
    return edges[:, :2], -edges[:, 2]


def nearest_glasses(wanted: Sequence[float], count: int, makers: tuple[str, ...]) -> list[str]:
    """Return names of the nearest glasses of some makers to n_d and V_d, of such as hardly differ only the nearest."""
    pool, known = glass_pool(makers)
    found: list[int] = []
    apart = known - torch.tensor([100 * wanted[0], wanted[1]], dtype=torch.float64)
    for i in apart.square().sum(-1).argsort(stable=True).tolist():
        if len(found) < count and all((known[i] - known[j]).norm() > SAME_GLASS for j in found):
            found.append(i)
    return [pool[i].name for i in found]


OPERANDS: dict[str, Callable[..., torch.Tensor]] = {
    "axial_color": _axial_color,
    "chief_ray_angle": _chief_ray_angle,
    "distortion": _distortion,
    "edge_thickness": edge_thicknesses,
    "glass": _glass,
    "incidence": _incidence,
    "lateral_color": _lateral_color,
    "modulation": _modulation,
    "slope": slopes,
    "spot": _spot,
    "telecentricity": _telecentricity,
    "thickness": _thickness,
    "total_track": _total_track,
    "wavefront": _wavefront,
}


def checked_operands(operands: Operands) -> list[Operand]:
    """Return operands after checking them; a name alone becomes an operand of that kind."""
    listed = [operands] if isinstance(operands, (str, Operand)) else operands
    if not isinstance(listed, Iterable):
        raise TypeError(f"operands must be a sequence of Operand, got {type(operands).__name__}")
    found = []
    for item in listed:
        item = Operand(item) if isinstance(item, str) else item
        _validate.instance("operands", item, Operand, "Operand or their names")
        if not callable(item.kind):
            kind = _validate.one_of("kind of operands", item.kind, (*OPERANDS, *FirstOrder._fields))
            item = item._replace(kind=kind)
        _validate.number("weight of an operand", item.weight, least=0)
        for name in ("target", "lower", "upper"):
            if getattr(item, name) is not None:
                _validate.number(f"{name} of an operand", getattr(item, name))
        if item.lower is not None and item.upper is not None and item.lower > item.upper:
            raise ValueError(f"lower must be at most upper, got {item.lower} and {item.upper} of {item.kind!r}")
        found.append(item)
    if not found:
        raise ValueError("operands must contain at least one")
    return found


def values_of(operand: Operand, view: View) -> torch.Tensor:
    """Return the values of an operand, ``[..., n]``."""
    if callable(operand.kind):
        value = torch.as_tensor(operand.kind(view.system, view.prescription, **operand.options), dtype=torch.float64)
        return value[..., None] if value.ndim <= len(view.prescription.batch) else value
    if operand.kind in OPERANDS:
        return OPERANDS[operand.kind](view, **operand.options)
    return getattr(view.first_order, operand.kind)[..., None]


def merit_residuals(operands: list[Operand], view: View) -> torch.Tensor:
    """Return the residuals of all operands, ``[..., R]``."""
    parts = [item.residuals(values_of(item, view)) for item in operands]
    lead = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
    return torch.cat([part.expand(*lead, part.shape[-1]) for part in parts], -1)


def merit_deviations(operands: list[Operand], view: View) -> tuple[torch.Tensor, list[bool]]:
    """Return residuals of all operands ``[..., R]``, negative for a bound that is kept, and which belong to bounds."""
    parts = [part for item in operands for part in item._deviations(values_of(item, view))]
    lead = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
    bounds = [bool(k % 2) for k, part in enumerate(parts) for _ in range(part.shape[-1])]
    return torch.cat([part.expand(*lead, part.shape[-1]) for part in parts], -1), bounds


def given_heights(system: optical_system) -> torch.Tensor | None:
    """Return the semi-diameters of the surfaces ``[S]``, None if one of them has none."""
    given = [item.semi_diameter for item in system.surfaces]
    return torch.tensor(given, dtype=torch.float64) if all(value is not None for value in given) else None


def clear_heights(
    system: optical_system, prescription: Prescription, count: int = 12, aim: str = "paraxial"
) -> torch.Tensor:
    """Return the largest distance from the axis of each surface at which rays intersect it, ``[..., S]``.

    Parameters
    ----------
    system : optical_system
        The system.
    prescription : Prescription
        Its numbers.
    count : int
        Rays on the rim of the pupil.
    aim : str
        How :func:`launch` aims.
    """
    turn = torch.arange(count, dtype=torch.float64) * (2 * math.pi / count)
    rays = launch(system, torch.stack([turn.sin(), turn.cos()], -1), prescription=prescription, aim=aim)
    found: list[torch.Tensor] = []
    for i in range(len(system.surfaces)):
        if is_break(system.surfaces[i]):
            found.append(0 * found[-1] if found else torch.zeros(prescription.batch, dtype=torch.float64))
            continue
        hit = trace(system, rays, prescription=prescription, until=i, vignetting=False)
        x, y, _ = in_surface_frame(system, prescription, i, hit)
        found.append(torch.nan_to_num((x * x + y * y).sqrt(), nan=0.0).amax((-3, -2, -1)))
    return torch.stack(found, -1)
