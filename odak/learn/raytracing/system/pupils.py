"""Rays from field points through points of a pupil: pupil patterns, paraxial and real aiming."""

import hashlib
import math
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypedDict

import numpy as np
import torch

from odak import _show, _torch_private, _validate
from odak._array import is_compiling, is_readable
from odak.learn._tensors import checked_device, checked_dtype
from odak.learn.raytracing.system.paraxial import EntrancePupil, entrance_pupil
from odak.learn.raytracing.system.prescriptions import Prescription, checked_prescription
from odak.learn.raytracing.system.specification import FieldPoints, is_number, plain, stacked
from odak.learn.raytracing.system.surfaces import checked_system, is_break, numbers_of, optical_system
from odak.learn.raytracing.system.tracing import Rays, Traced, in_surface_frame, trace
from odak.raytracing.batches import needs_gradient
from odak.raytracing.surfaces import Parametric

if TYPE_CHECKING:
    from typing_extensions import Unpack

PATTERNS = ("rings", "grid", "x", "y", "random", "gauss")
AIMS = ("paraxial", "real")
# Steps of a search, and along a continuation.
ROUNDS, MARCHES = 8, 60
# Angle beyond which real rays are looked for across the field's direction, since the plane of the pupil is seen edge
# on, and distances of the pupil in front of it at which they start.
WIDE, BEFORE = 80.0, 20.0
# Searches end with steps this small relative to the step of differences. Misses, relative to the radius of the stop,
# with which a ray is found, and with which it is near enough on the way of a continuation; steps tried at once there.
CLOSE, FOUND, NEAR, SHARES = 1e-6, 1e-7, 1e-6, 16
# Chief rays that were found last, and what was found from them, by all that they depend on: an analysis aims the same
# fields many times. At most so many ends of spokes are kept of each.
KEPT, ENDS = 8, 4096
# From this number of rays on a chart is worth its own rays, a Gaussian quadrature of some rings; the degree of
# its polynomials.
CHARTED, CHART_RINGS, DEGREE = 200, 6, 8
POWERS = [(i, n - i) for n in range(DEGREE + 1) for i in range(n + 1)]
# Smallest step of a continuation, as a part of its way, and along a spoke. Points this close to a spoke lie on it, and
# beyond its end.
LEAST, SHARP, ALONG, BEYOND = 2e-4, 4e-7, 2e-9, 1e-6
# Spokes of the Gaussian quadrature for each of its rings. Steps along a spoke in which its clear parts are looked for,
# and halvings by which their ends are found.
SPOKES, STEPS, HALVINGS = 4, 48, 13
# Up to this number of such ends few rays cost what the calls of a trace do.
FEW = 256


def pupil_samples(
    pattern: str = "rings",
    count: int = 6,
    *,
    seed: int = 0,
    device: torch.device | str | None = None,
    dtype: torch.dtype = torch.float64,
) -> torch.Tensor:
    """Return points of the unit disc, for rays through a pupil.

    Parameters
    ----------
    pattern : str
        "rings": the centre and `count` rings of 6, 12, 18 … points. "grid": the points of a square grid of `count` ×
        `count` that lie in the disc. "x", "y": `count` points along a diameter. "random": `count` random points.
        "gauss": the points of :func:`pupil_quadrature` for a clear pupil.
    count : int
        As above.
    seed : int
        Of the random points.
    device : torch.device or str, optional
        Device of the result.
    dtype : torch.dtype, default: torch.float64
        Real dtype of the result.

    Returns
    -------
    torch.Tensor
        ``[P, 2]``.

    Examples
    --------
    >>> from odak.learn.raytracing.system import pupil_samples
    >>> tuple(pupil_samples("rings", 6).shape), pupil_samples("y", 3).tolist()
    ((127, 2), [[0.0, -1.0], [0.0, 0.0], [0.0, 1.0]])
    """
    pattern = _validate.one_of("pattern", pattern, PATTERNS)
    count, seed = _validate.integer("count", count, minimum=1), _validate.integer("seed", seed)
    dtype, device = checked_dtype("dtype", dtype), checked_device("device", device)
    wide = torch.float64
    if pattern == "rings":
        points = [torch.zeros(1, 2, dtype=wide)]
        for ring in range(1, count + 1):
            angle = torch.arange(6 * ring, dtype=wide) * (2 * math.pi / (6 * ring))
            points.append(torch.stack([angle.cos(), angle.sin()], -1) * (ring / count))
        found = torch.cat(points)
    elif pattern == "grid":
        line = _line(count)
        found = torch.stack(torch.meshgrid(line, line, indexing="xy"), -1).reshape(-1, 2)
        found = found[found.square().sum(-1) <= 1 + 1e-12]
    elif pattern == "gauss":
        found = _polar_nodes(count)[0].reshape(-1, 2)
    elif pattern == "random":
        generator = torch.Generator().manual_seed(seed)
        radius, angle = torch.rand(2, count, generator=generator, dtype=wide).unbind()
        found = radius.sqrt()[:, None] * torch.stack([(2 * math.pi * angle).cos(), (2 * math.pi * angle).sin()], -1)
    else:
        line, still = _line(count), torch.zeros(count, dtype=wide)
        found = torch.stack([line, still] if pattern == "x" else [still, line], -1)
    return found.to(device=device, dtype=dtype)


class ChiefRays(NamedTuple):
    """Chief rays of field points, and what was found from them.

    Attributes
    ----------
    x, y, reached : torch.Tensor
        Their coordinates in the entrance pupil ``[..., F, 1]``, and which were found.
    chart : torch.Tensor or None
        Polynomials of :func:`_chart` about them.
    ends : torch.Tensor or None
        ``[N, 4]``: where the stop cannot be reached any more from the chief ray outwards: number of the field,
        direction (x, y) and distance from the centre of the stop.
    """

    x: torch.Tensor
    y: torch.Tensor
    reached: torch.Tensor
    chart: torch.Tensor | None = None
    ends: torch.Tensor | None = None


_CHIEF_RAYS: dict[tuple[Any, ...], ChiefRays] = {}


@_show.shown
class PupilQuadrature(NamedTuple):
    """Points of a pupil with weights, in place of the name of a pattern.

    Attributes
    ----------
    points : torch.Tensor
        In units of the pupil's radius, ``[P, 2]``, or ``[F, P, 2]`` where each field has its own.
    weights : torch.Tensor
        Fractions of the area of the pupil for which they stand, ``[P]`` or ``[F, P]``. Their sum is the fraction that
        no aperture blocks.

    Examples
    --------
    >>> from odak.learn.raytracing.system import PupilQuadrature, load_system, pupil_quadrature
    >>> isinstance(pupil_quadrature(load_system("singlet"), 4), PupilQuadrature)
    True
    """

    points: torch.Tensor
    weights: torch.Tensor


# In signatures: a pattern of :func:`pupil_samples`, points, or points with weights.
Pupil: TypeAlias = str | torch.Tensor | PupilQuadrature


class FieldOptions(TypedDict, total=False):
    """Of functions that aim rays from field points."""

    fields: FieldPoints | None
    aim: str
    vignetting: bool


class WaveOptions(FieldOptions, total=False):
    """Of functions of wavefronts."""

    prescription: Prescription | None


class RayOptions(FieldOptions, total=False):
    """Of functions that trace rays from field points."""

    dtype: torch.dtype
    until: int | None


class TraceOptions(RayOptions, WaveOptions, total=False):
    """Of :func:`trace_fields`."""


@torch.no_grad()
def pupil_quadrature(
    system: optical_system,
    count: int = 12,
    *,
    fields: FieldPoints | None = None,
    prescription: Prescription | None = None,
    aim: str = "paraxial",
    vignetting: bool = True,
) -> PupilQuadrature:
    """Return points and weights by which means over the area of the pupil converge fastest.

    Parameters
    ----------
    system : optical_system
        The system.
    count : int
        Points along each of 4 × `count` spokes.
    fields : sequence of pairs or torch.Tensor, optional
        Field points in place of the system's.
    prescription : Prescription, optional
        Numbers in place of the system's own, of one system.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    vignetting : bool
        Leave out what apertures block at the reference wavelength; where some of the pupil is blocked, each field has
        points of its own.

    Returns
    -------
    PupilQuadrature
        Without a graph: points and weights are numbers, also where an aperture cuts the pupil.

    Notes
    -----
    Gauss–Legendre nodes in the square of the radius and equal angles are exact for polynomials up to the degree
    4·`count` − 2 of the pupil coordinates: G. W. Forbes, "Optical system assessment for design: numerical ray tracing
    in the Gaussian pupil", J. Opt. Soc. Am. A 5, 1943 (1988), doi:10.1364/JOSAA.5.001943. Apertures are followed by
    rays along each spoke, whose clear parts have nodes of their own. The rim of a vignetted pupil has corners, at
    which the error falls with the square of `count`; :func:`field_quality` states it.

    Examples
    --------
    The mean square of the radius over a disc is 1/2, and a clear pupil loses nothing:

    >>> from odak.learn.raytracing.system import load_system, pupil_quadrature
    >>> points, weights = pupil_quadrature(load_system("singlet"), 3)
    >>> round(float((weights * points.square().sum(-1)).sum()), 12), round(float(weights.sum()), 12)
    (0.5, 1.0)
    """
    count, vignetting = _validate.integer("count", count, minimum=1), _validate.flag("vignetting", vignetting)
    numbers = numbers_of(system, prescription).at(system.reference)
    if len(numbers.batch):
        raise ValueError(f"prescription must be of one system, got a batch of {tuple(numbers.batch)}")
    device = numbers.thickness.device
    whole = PupilQuadrature(*(value.flatten(0, 1).to(device) for value in _polar_nodes(count)))
    if not vignetting:
        return whole
    spoke = _spokes(count).to(device)
    options: dict[str, Any] = {"fields": fields, "prescription": numbers, "aim": aim}

    def clear(radius: torch.Tensor) -> torch.Tensor:
        """Return which of the rays at radii ``[..., spokes, R]`` of the spokes arrive, ``[F, spokes, R]``."""
        rays = launch(system, (radius[..., None] * spoke[:, None]).flatten(-3, -2), **options)
        return trace(system, rays, prescription=numbers).arrived[0].unflatten(-1, radius.shape[-2:])

    line = torch.linspace(0, 1, STEPS + 1, dtype=torch.float64, device=device)
    flags = clear(line.expand(len(spoke), -1))
    if bool(flags.all()):
        return whole
    ends = _clear_parts(clear, line, flags, HALVINGS)
    start, stop = ends.square().unflatten(-1, (-1, 2))[..., None].unbind(-2)
    nodes, parts = _legendre(count, device)
    square = start + (stop - start) * nodes
    weights = ((stop - start) * parts / len(spoke)).flatten(1)
    points = (square.sqrt()[..., None] * spoke[:, None, None]).flatten(1, -2)
    used = (weights > 0).any(0)
    return PupilQuadrature(points[:, used], weights[:, used])


def _clear_parts(clear: Callable, line: torch.Tensor, flags: torch.Tensor, halvings: int) -> torch.Tensor:
    """Return where the clear parts of lines begin and end in turn, ``[..., 2K]``; empty parts are at the line's end.

    Parameters
    ----------
    clear : callable
        Takes places ``[..., R]`` along the lines, returns which are clear.
    line, flags : torch.Tensor
        Places along each line, and which are clear, ``[..., len(line)]``: at most one end lies between two of them.
    halvings : int
        Of the intervals between two places.
    """
    count = len(line) - 1
    changes = flags[..., 1:] != flags[..., :-1]
    # The places of the changes come first, in order; the rest of the slots are empty intervals at the end.
    slots = int(changes.sum(-1).max())
    order = torch.where(changes, torch.arange(count, device=line.device), count).sort(-1).values[..., :slots]
    low, high = line[order], line[(order + 1).clamp(max=count)]
    inside = flags.gather(-1, order)[..., None]
    # A trace does several halvings at once where it is of few rays.
    most = 4 if low.numel() <= FEW else 2
    # Without a change each line is clear or blocked as a whole.
    for left in range(halvings if slots else 0, 0, -most):
        parts = 2 ** min(most, left)
        tries = low[..., None] + (high - low)[..., None] * (torch.arange(1, parts).to(low) / parts)
        same = clear(tries.flatten(-2)).unflatten(-1, tries.shape[-2:]) == inside
        size = (high - low) / parts
        low = low + size * same.long().cumprod(-1).sum(-1)
        high = low + size
    first = torch.where(flags[..., :1], line[0], line[-1])
    last = line[-1].expand(*first.shape[:-1], 1 + slots % 2)
    return torch.cat([first, (low + high) / 2, last], -1).sort(-1).values


def _legendre(count: int, device=None) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the nodes and weights of the Gauss–Legendre rule on 0 … 1."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return torch.as_tensor((nodes + 1) / 2, device=device), torch.as_tensor(weights / 2, device=device)


def _spokes(count: int) -> torch.Tensor:
    """Return the directions of the spokes, ``[4 count, 2]``, none of them along an axis."""
    angle = (torch.arange(SPOKES * count, dtype=torch.float64) + 0.5) * (2 * math.pi / (SPOKES * count))
    return torch.stack([angle.cos(), angle.sin()], -1)


def _polar_nodes(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the points ``[spokes, count, 2]`` and weights of the quadrature of a clear pupil."""
    spoke, (square, weights) = _spokes(count), _legendre(count)
    return square.sqrt()[:, None] * spoke[:, None], (weights / len(spoke)).expand(len(spoke), -1)


def weights_of(pupil: Pupil, count: int, like: torch.Tensor) -> torch.Tensor | None:
    """Return the weights ``[P]`` or ``[F, P]`` of a pupil's points, None where all are alike."""
    if isinstance(pupil, PupilQuadrature):
        return pupil.weights.to(like)
    return _polar_nodes(count)[1].flatten().to(like) if isinstance(pupil, str) and pupil == "gauss" else None


def _line(count: int) -> torch.Tensor:
    return torch.linspace(-1, 1, count, dtype=torch.float64) if count > 1 else torch.zeros(1, dtype=torch.float64)


def launch(
    system: optical_system,
    pupil: Pupil = "rings",
    count: int = 6,
    *,
    fields: FieldPoints | None = None,
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
        Pattern of :func:`pupil_samples`, or points ``[P, 2]`` in units of the pupil's radius; ``[F, P, 2]`` for points
        of each field's own.
    count : int
        Count of :func:`pupil_samples`.
    fields : sequence of pairs or torch.Tensor, optional
        Field points (x, y), or ``[F, 2]``, in place of the system's. Vignetting factors apply to the system's own
        field points only.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps.
    aim : str
        "paraxial": at the paraxial entrance pupil. "real": so that the rays pass the stop at the requested points,
        at the reference wavelength; solved by Newton's method, for wide fields by continuation, differentiable.
    dtype : torch.dtype
        Precision of the rays; they are computed in float64.

    Returns
    -------
    Rays
        ``[..., 1, F, P]``, whose first axes are the batch of systems. For an object at infinity they start in the
        plane of the first vertex. Pupil points are heights in the entrance pupil, for a near object slopes of rays: the
        same up to a factor, but defined for a pupil at infinity too. Rays for which `aim` "real" finds no way to their
        point of the stop have infinite direction cosines; their status behind the system is NOT_AIMED.

    Examples
    --------
    Two rings have 1 + 6 + 12 points:

    >>> from odak.learn.raytracing.system import launch, load_system
    >>> lens = load_system("cooke_triplet")
    >>> rays = launch(lens, "rings", 2)
    >>> rays.x.shape[-1]
    19
    """
    aim, dtype = _validate.one_of("aim", aim, AIMS), checked_dtype("dtype", dtype)
    checked_prescription(prescription)
    points = pupil_of(pupil, count, system)
    chosen = field_points(system, fields).to(points.device)[:, None]
    if points.ndim == 3 and len(points) != len(chosen):
        raise ValueError(f"pupil has points for {len(points)} fields, got {len(chosen)} fields")
    factors = pupil_factors(system, chosen[:, 0])
    if factors is not None:
        points = factors[:, None, :2] + (1 - factors[:, None, 2:]) * points
    rays = through_pupil(system, points, chosen, prescription, aim)
    return rays if dtype == torch.float64 else Rays(*(value.to(dtype) for value in rays))


@torch.no_grad()
def vignetting_factors(
    system: optical_system, fields: FieldPoints | None = None, *, aim: str = "paraxial"
) -> torch.Tensor:
    """Return the vignetting factors of field points, as the apertures of a system have them.

    Parameters
    ----------
    system : optical_system
        The system, whose own factors have no effect.
    fields : sequence or torch.Tensor, optional
        Field points in place of the system's.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    torch.Tensor
        (VDX, VDY, VCX, VCY) of each field, ``[F, 4]``: the pupil of radius 1 is (VDX, VDY) off the axis and as much
        smaller as (1 − VCX, 1 − VCY), as :class:`optical_system` takes them. NaN where no ray passes along the y axis
        of the pupil.

    Notes
    -----
    The clear part of the y axis of the pupil at the reference wavelength gives VDY and VCY; the clear part of the line
    through its middle along x gives the other two.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, vignetting_factors
    >>> vignetting_factors(load_system("cooke_triplet"))[0].abs().max() < 1e-3
    tensor(True)
    """
    numbers = checked_system(system).prescription().at(system.reference)
    aim, device = _validate.one_of("aim", aim, AIMS), numbers.thickness.device
    chosen = field_points(system, fields).to(device)[:, None]

    def clear(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        rays = through_pupil(system, torch.stack(torch.broadcast_tensors(x, y), -1), chosen, numbers, aim)
        return trace(system, rays, prescription=numbers).arrived[0]

    def ends(clear_at: Callable[..., Any]) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the outermost clear places of a line, ``[F, 1]`` each."""
        line = torch.linspace(-1, 1, 2 * STEPS + 1, dtype=torch.float64, device=device)
        flags = clear_at(line.expand(len(chosen), -1))
        start, stop = _clear_parts(clear_at, line, flags, HALVINGS + 5).unflatten(-1, (-1, 2)).unbind(-1)
        found = start.amin(-1, keepdim=True), torch.where(stop > start, stop, -1.0).amax(-1, keepdim=True)
        return tuple(torch.where(flags.any(-1, keepdim=True), value, torch.nan) for value in found)  # type: ignore[return-value]

    bottom, top = ends(lambda y: clear(torch.zeros_like(y), y))
    middle = (top + bottom) / 2
    left, right = ends(lambda x: clear(x, middle.nan_to_num()))
    return torch.cat([(right + left) / 2, middle, 1 - (right - left) / 2, 1 - (top - bottom) / 2], -1)


def pupil_factors(system: optical_system, fields: torch.Tensor) -> torch.Tensor | None:
    """Return the vignetting factors ``[F, 4]`` of field points ``[F, 2]``, zeros of others than the system's own.

    None for a system without factors.
    """
    if system.vignetting_factors is None:
        return None
    if len(system.vignetting_factors) != len(system.fields):
        raise ValueError(
            f"vignetting_factors of the system must be given for each of its {len(system.fields)} fields, got "
            f"{len(system.vignetting_factors)}"
        )
    own, factors = (
        torch.tensor(value, dtype=fields.dtype, device=fields.device)
        for value in (plain(system.fields), system.vignetting_factors)
    )
    same = (fields[:, None] == own).all(-1)
    # The first of equal field points.
    return torch.where(same.any(1)[:, None], factors[same.to(torch.uint8).argmax(1)], 0.0)


def field_points(system: Any, fields: FieldPoints | None = None) -> torch.Tensor:
    """Return field points ``[F, 2]`` of numbers y or pairs (x, y) in float64, the system's own by default."""
    if isinstance(fields, torch.Tensor):
        fields = torch.stack([0 * fields, fields], -1) if fields.ndim == 1 else fields
        _validate.shaped("fields", fields, "[F, 2], not empty")
        return _validate.real("fields", fields).double()
    if fields is not None and (isinstance(fields, str) or not isinstance(fields, Iterable)):
        raise TypeError(f"fields must be a sequence of numbers y or pairs (x, y), got {type(fields).__name__}")
    points = [(0.0, point) if is_number(point) else point for point in (system.fields if fields is None else fields)]
    pairs = [_validate.several("fields", point, 2) for point in points]
    if not pairs:
        raise ValueError("fields must contain at least one number y or pair (x, y), got an empty sequence")
    return stacked(pairs)


def through_pupil(
    system: optical_system, points: torch.Tensor, fields: torch.Tensor, prescription: Prescription | None, aim: str
) -> Rays:
    """Return rays through points of the pupil, ``[P, 2]`` or ``[..., F, P, 2]``, from field points ``[F, 1, 2]``."""
    numbers = numbers_of(system, prescription).at(system.reference)
    pupil = entrance_pupil(system, prescription=numbers)
    if aim == "real" and not system.telecentric:
        return through_places(system, fields, pupil, *real_places(system, numbers, pupil, points, fields))
    return through_places(system, fields, pupil, *places_of(pupil, points))


def real_places(
    system: optical_system, numbers: Prescription, pupil: EntrancePupil, points: torch.Tensor, fields: torch.Tensor
) -> tuple[Any, ...]:
    """Return coordinates (x, y) of rays that pass the stop at given points, and whether they are across the fields."""
    # Of a device that is not read, the system's own fields decide.
    given = fields.flatten().tolist() if is_readable(fields) else [v for point in plain(system.fields) for v in point]
    wide = system.at_infinity and max(map(abs, given)) > WIDE
    return *aimed(system, numbers, pupil, points, fields, wide), wide


def places_of(pupil: Any, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return coordinates in the entrance pupil, as its `reach` has them, of points in units of its radius."""
    reach = pupil.reach[..., None, None, None]
    middle = (value[..., None, None, None] for value in pupil.middle)
    return tuple(reach * points[..., i] + center for i, center in enumerate(middle))  # type: ignore[return-value]


def through_places(
    system: optical_system,
    fields: torch.Tensor,
    pupil: EntrancePupil,
    px: torch.Tensor,
    py: torch.Tensor,
    wide: bool = False,
) -> Rays:
    """Return rays from field points ``[F, 1, 2]`` through coordinates of the entrance pupil.

    With `wide`, the coordinates are across the direction of the field instead, so that it may come from behind.
    """
    distance, bend = (value[..., None, None, None] for value in (pupil.distance, pupil.bend))
    # Rays without coordinates in the pupil are computed as if they passed its centre.
    lost = torch.isinf(px)
    px, py = (torch.where(lost, 0.0, value) for value in (px, py))
    if not system.at_infinity:
        rays = _near(system, fields, bend, px, py)
    elif wide:
        rays = _beyond(system, fields, distance, px, py)
    else:
        rays = _far(fields, distance, px, py)
    return Rays(*rays[:3], *(torch.where(lost, torch.inf, value) for value in rays[3:]))


def pupil_of(pupil: Pupil, count: int, system: optical_system) -> torch.Tensor:
    """Return the points of a pupil, from the name of a pattern or as given."""
    checked_system(system)
    device = system.surfaces[0].thickness.device
    pupil = pupil.points if isinstance(pupil, PupilQuadrature) else pupil
    if isinstance(pupil, str):
        return pupil_samples(_validate.one_of("pupil", pupil, PATTERNS), count, device=device)
    if not isinstance(pupil, torch.Tensor) or pupil.ndim not in (2, 3) or pupil.shape[-1] != 2:
        given = tuple(pupil.shape) if isinstance(pupil, torch.Tensor) else type(pupil).__name__
        known = ", ".join(map(repr, PATTERNS))
        raise ValueError(
            f"pupil must be one of {known}, a PupilQuadrature or a tensor [P, 2] or [F, P, 2], got {given}"
        )
    return pupil.to(device=device, dtype=torch.float64)


def _far(fields, distance, px, py) -> Rays:
    """Return rays of distant points through points of the plane of the entrance pupil."""
    if is_readable(fields) and bool((fields.abs() >= 90).any()):
        largest = fields.abs().max().item()
        raise ValueError(f'fields must be below 90 degrees from the axis, or aim "real", got {largest:g} degrees')
    # Where nothing is read, rays that this plane does not see are lost.
    tangent = torch.where(fields.abs() < 90, torch.tan(torch.deg2rad(fields)), torch.nan)
    tx, ty = tangent[..., 0], tangent[..., 1]
    w = 1 / (1 + tx * tx + ty * ty).sqrt()
    x, y = px - distance * tx, py - distance * ty
    u, v, w = (value.expand(x.shape) for value in (tx * w, ty * w, w))
    return Rays(x, y, torch.zeros_like(x), u, v, w)


def _beyond(system, fields, distance, px, py) -> Rays:
    """Return rays of distant points, at 90 degrees from the axis or more too, from far in front of the first vertex.

    Coordinates are those about the middle of the entrance pupil in the plane across the direction.
    """
    angle = torch.deg2rad(fields)
    # Points beyond 90 degrees lie on the x or the y axis of the field.
    beyond = (fields.abs() >= 90).any(-1)
    tangent = torch.tan(torch.where(beyond[..., None], 0.0, angle))
    size = (1 + tangent.square().sum(-1)).sqrt()
    cosine = torch.cos(angle).prod(-1)
    u, v = (torch.where(beyond, torch.sin(angle[..., i]), tangent[..., i] / size) for i in range(2))
    w = torch.where(beyond, cosine, 1 / size)
    # Of two directions across, the first is the x axis turned with the field, the second the y axis.
    share = 1 / (1 + w)
    across = (1 - u * u * share, -u * v * share, -u)
    along = (-u * v * share, 1 - v * v * share, -v)
    back = BEFORE * (distance.abs() + px.abs() + py.abs())
    x, y, z = (px * a + py * b - back * d for a, b, d in zip(across, along, (u, v, w), strict=True))
    u, v, w = (value.expand(x.shape) for value in (u, v, w))
    return Rays(x, y, z + distance, u, v, w)


def _near(system, fields, bend, sx, sy) -> Rays:
    """Return rays of near points; given slopes are relative to the field's slopes towards the pupil's centre."""
    sx, sy = sx - bend * fields[..., 0], sy - bend * fields[..., 1]
    w = 1 / (1 + sx * sx + sy * sy).sqrt()
    x, y = (fields[..., i].expand(sx.shape) for i in range(2))
    return Rays(x, y, -system.object_distance + 0 * sx, sx * w, sy * w, w)


def aimed(
    system: optical_system,
    numbers: Prescription,
    pupil: EntrancePupil,
    points: torch.Tensor,
    fields: torch.Tensor,
    wide: bool = False,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return coordinates in the entrance pupil of rays that pass the stop at given points.

    Parameters
    ----------
    system : optical_system
        The system.
    numbers : Prescription
        Its numbers at one wavelength.
    pupil : EntrancePupil
        Its paraxial entrance pupil.
    points : torch.Tensor
        ``[P, 2]`` or ``[..., F, P, 2]`` in units of the stop's radius.
    fields : torch.Tensor
        Field points ``[F, 1, 2]``.
    wide : bool
        Of coordinates across the directions of the fields.

    Returns
    -------
    tuple of torch.Tensor
        Coordinates for :func:`through_places`; infinite for rays that were not found.

    Notes
    -----
    The chief ray of each field first, by Newton's method from the paraxial pupil. Where that fails, as for the outer
    fields of wide lenses, whose pupils lie far from the paraxial one, it is followed from the axis to the field. The
    other rays start as the chief ray and its derivatives say; those that fail are followed from it outwards. Many rays
    start from a chart, polynomials that a few such rays determine: its derivatives serve all steps of theirs.
    """
    given: Any = (numbers, pupil, points, fields)
    constants = _constant(given)
    graph = needs_gradient(*_values(numbers), *pupil[:5], system.object_distance, points, fields)
    # The search has no derivatives: it is done apart from transforms of torch.func where these wrap no number of it.
    apart = _is_plain(system, *constants)
    with _torch_private.without_derivatives() if apart else torch.no_grad():
        known = _key(system, constants[0], constants[1], constants[3], wide) if apart else None
        x, y, found, slopes = _search(system, constants if apart else given, wide, known, graph)
    if slopes is not None:
        # One more step with a graph carries the gradient; its slopes have none.
        errors = _misses(system, numbers, pupil, fields, wide)
        # Another one carries the second derivatives, which gradients of forward derivatives need.
        for _ in range(2 if _torch_private.in_functional_transform() else 1):
            ex, ey, kept = errors(x, y, points)
            dx, dy = _step(slopes, [torch.where(kept & found, value, 0.0) for value in (ex, ey)])
            x, y = x - dx, y - dy
    return torch.where(found, x, torch.inf), torch.where(found, y, torch.inf)


def _constant(value):
    """Return tensors, also those in tuples and shapes, without what a transform of torch.func (grad, jvp, …) wraps."""
    if isinstance(value, Parametric):
        return type(value)(*map(_constant, value.parameters()))
    if isinstance(value, tuple):
        parts = map(_constant, value)
        return value._make(parts) if hasattr(value, "_make") else tuple(parts)
    return _torch_private.as_constant(value) if isinstance(value, torch.Tensor) else value


def _is_plain(system, numbers: Prescription, pupil, points, fields) -> bool:
    """Return whether a search has nothing but tensors on the processor that no transform wraps."""
    image = [] if system.image is None else [*system.image.parameters(), *system.image.buffers()]
    # A transform wraps also what is made of plain numbers while it runs.
    values = [points, fields, *image, *map(_constant, _values(numbers))]
    if isinstance(system.object_distance, torch.Tensor):
        values.append(system.object_distance)
    if not all(value.device.type == "cpu" for value in values):
        return False
    return not is_compiling() and not _torch_private.is_wrapped(*values, *pupil[:5], *pupil.middle)


def _values(numbers: Prescription) -> list[torch.Tensor]:
    """Return all tensors of a prescription, the parameters of its shapes, phases and graded indices included."""
    return [*(v for v in numbers if isinstance(v, torch.Tensor)), *(v for v, _ in numbers.others())]


def _misses(system, numbers: Prescription, pupil, fields: torch.Tensor, wide: bool) -> Callable[..., Any]:
    """Return the function by which rays through places of the entrance pupil are judged."""

    def errors(px, py, goals, where=fields):
        """Return by how much rays of fields miss points of the stop, and whether they exist."""
        x, y, kept = at_stop(system, numbers, through_places(system, where, pupil, px, py, wide))
        radius = pupil.stop_radius[..., None, None, None]
        return x - radius * goals[..., 0], y - radius * goals[..., 1], kept

    return errors


def _search(system, given: tuple[Any, ...], wide: bool, known: tuple[Any, ...] | None, graph: bool) -> tuple[Any, ...]:
    """Return coordinates of rays, which of them were found, and the inverse Jacobian of the misses if asked for.

    Those that were not found have coordinates 0. `given` is prescription, entrance pupil, points and fields; `known`
    the key of the chief rays, None if it has none.
    """
    numbers, pupil, points, fields = given
    errors, radius = _misses(system, numbers, pupil, fields, wide), pupil.stop_radius[..., None, None, None]
    step = 1e-4 * pupil.reach[..., None, None, None]
    centre = torch.zeros_like(points[..., :1, :])
    batch = (*pupil.reach.shape, 1, len(fields), 1)
    shape = np.broadcast_shapes(batch, (*numbers.batch, 1, 1, 1), points.shape[:-1])
    goals = points.expand(*shape, 2)
    held = None if known is None else _CHIEF_RAYS.pop(known, None)
    if held is None:
        found = _chief_rays(errors, places_of(pupil, centre), centre.expand(*shape[:-1], 1, 2), fields, step, radius)
        held = ChiefRays(*found)
    charted = known is not None and points.shape[-2] >= CHARTED and bool(held.reached.all())
    if charted and held.chart is None:
        nodes = pupil_samples("gauss", CHART_RINGS).to(points)
        ends = nodes.expand(*shape[:-1], *nodes.shape)
        held = held._replace(
            chart=_chart(nodes, *_beside(errors, held, places_of(pupil, nodes), step, radius, ends, fields))
        )
    if charted:
        x, y, found = _by_chart(errors, held.chart, points, step, radius, goals, fields)
    else:
        x, y, found = _beside(errors, held, places_of(pupil, points), step, radius, goals, fields)
    lost = held.reached & ~found
    single = known is not None and math.prod(shape[:-2]) == 1
    if single and bool(lost.any()):
        if held.ends is not None:
            lost = lost & ~_past_ends(held.ends, goals.reshape(*shape[-2:], 2), lost.reshape(shape[-2:])).reshape(shape)
        spokes = _Spokes(goals.reshape(*shape[-2:], 2))
    for part in ("first", "rest") if single else ("all",):
        if not bool(lost.any()):
            break
        # Those lost in any system of a batch, as fields of one ray each.
        some = lost.flatten(0, -3).any(0)
        share, least = torch.zeros((), dtype=x.dtype, device=x.device), LEAST
        fx, fy = (value.expand(shape) for value in held[:2])
        if single:
            # Of one system the innermost ray of each spoke comes first: where it is not found, neither are those
            # behind. It starts from the one before it.
            inner, share, source = spokes.starts(found.reshape(shape[-2:]), some)
            some = inner if part == "first" else some
            near = source >= 0
            fx, fy = (torch.where(near, a.flatten()[source], b) for a, b in ((x, fx), (y, fy)))
            share, least = share[some][:, None], SHARP / (spokes.size * (1 - share))[some][:, None]
        fx, fy = (value[..., some, None] for value in (fx, fy))
        ends, which = goals[..., some, :][..., None, :], fields.expand(*shape[-2:], 2)[some][:, None]

        def towards(s, e=ends, w=which, b=share):
            return (b + s * (1 - b))[..., None] * e, w

        px, py, met, way = _continuation(errors, fx, fy, step, radius, towards, least)
        px, py, met, way = (value[..., 0] for value in (px, py, met, share + way * (1 - share)))
        better = met & lost[..., some]
        x[..., some], y[..., some] = (
            torch.where(better, px, x[..., some]),
            torch.where(better, py, y[..., some]),
        )
        found[..., some] = found[..., some] | better
        if single:
            held = held._replace(ends=_ends(held.ends, some.nonzero()[:, 0], ends.reshape(-1, 2), way, ~met))
        if part == "first":
            lost = lost & ~found & spokes.of(some, met.flatten()).reshape(shape)
    if known is not None:
        _CHIEF_RAYS[known] = held
        if len(_CHIEF_RAYS) > KEPT:
            # Another thread may have taken the oldest at the same time.
            _CHIEF_RAYS.pop(next(iter(tuple(_CHIEF_RAYS)), ()), None)
    x, y = (torch.where(found, value, 0.0) for value in (x, y))
    if charted and not graph:
        return x, y, found, None
    jacobian, exist = _central(errors, x, y, step, goals)
    return x, y, found, torch.where(found & exist, _inverse(jacobian), 0.0)


def _ends(before: torch.Tensor | None, field, goals, way, stopped) -> torch.Tensor:
    """Return the ends of spokes, with those of rays that stopped at a part of the way to their goals ``[N, 2]``."""
    size = goals.square().sum(-1, keepdim=True).sqrt()
    found = torch.cat([field[:, None].to(goals), goals / size, way.reshape(-1, 1) * size], -1)[stopped.flatten()]
    # Several rays of one spoke stop at the same place.
    found = torch.cat([found[:, :3].round(decimals=9), found[:, 3:].round(decimals=7)], -1)
    return torch.unique(found if before is None else torch.cat([before, found]), dim=0)[-ENDS:]


class _Spokes:
    """Points ``[F, P, 2]`` of the stop as points of spokes of their fields."""

    def __init__(self, goals: torch.Tensor):
        self.size = goals.square().sum(-1).sqrt()
        angle = torch.atan2(goals[..., 1], goals[..., 0]) + 7 * torch.arange(len(goals), device=goals.device)[:, None]
        kinds, self.spoke = torch.unique(angle.round(decimals=8), return_inverse=True)
        self.number = len(kinds)

    def starts(self, found: torch.Tensor, lost: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the innermost lost points, and for all points where a continuation starts.

        That is the last point found before the first lost one: at which share of the way from the centre of the stop
        it lies, and its place among all points; 0 and -1 where there is none.
        """
        size, spoke = self.size, self.spoke
        first = size.new_full((self.number,), torch.inf).scatter_reduce(0, spoke[lost], size[lost], "amin")[spoke]
        before = found & (size < first)
        last = size.new_zeros(self.number).scatter_reduce(0, spoke[before], size[before], "amax")[spoke]
        source = torch.full((self.number,), -1, device=size.device)
        chosen = before & (size == last)
        source[spoke[chosen]] = chosen.flatten().nonzero()[:, 0]
        source = source[spoke]
        return lost & (size == first), torch.where(source >= 0, last / size, 0.0).nan_to_num(), source

    def of(self, some: torch.Tensor, met: torch.Tensor) -> torch.Tensor:
        """Return all points of the spokes of some points that were met."""
        held = torch.zeros(self.number, dtype=torch.bool, device=met.device)
        held[self.spoke[some][met]] = True
        return held[self.spoke]


def _past_ends(ends: torch.Tensor, goals: torch.Tensor, lost: torch.Tensor) -> torch.Tensor:
    """Return which of the lost points ``[F, P, 2]`` of the stop lie behind an end of a spoke."""
    past = torch.zeros_like(lost)
    for field in lost.any(-1).nonzero()[:, 0].tolist():
        # One row for each direction: rays farther out on it are not there either.
        x, y, end = ends[ends[:, 0] == field, 1:].mT[..., None]
        gx, gy = goals[field, lost[field]].unbind(-1)
        along, across = gx * x + gy * y, gx * y - gy * x
        past[field, lost[field]] = ((across.abs() <= ALONG) & (along > end + BEYOND)).any(0)
    return past


def _key(system, numbers: Prescription, pupil, fields: torch.Tensor, wide: bool) -> tuple[Any, ...] | None:
    """Return all that chief rays depend on, None where it cannot be read."""
    values = [*_values(numbers), pupil.reach, pupil.stop_radius, fields]
    if not all(map(is_readable, values)):
        return None
    kinds = tuple((item.reflects, is_break(item), item.order) for item in system.surfaces)
    groups = (numbers.shapes, numbers.phases, numbers.gradients)
    # A shape is its class and its parameters, which are read: they may have been changed in place.
    classes = tuple(tuple(None if item is None else type(item) for item in group or ()) for group in groups)
    digest = hashlib.sha256()
    for value in values:
        digest.update(value.detach().contiguous().numpy())
    shapes = tuple(tuple(value.shape) for value in values)
    return system.stop, plain(system.object_distance), system.telecentric, wide, kinds, classes, shapes, digest.digest()


def _chief_rays(errors, middle, centre, fields, step, radius):
    """Return coordinates of the rays through the centre of the stop, ``[..., F, 1]``, and which were found."""
    middle = [value.expand(centre.shape[:-1]) for value in middle]
    x, y, found, _ = _solve(errors, *middle, step, radius, centre, fields)
    if not bool(found.all()):
        # From the axis to the field.
        px, py, met, _ = _continuation(errors, *middle, step, radius, lambda s: (centre, s[..., None] * fields))
        done = met & ~found
        x, y, found = torch.where(done, px, x), torch.where(done, py, y), found | done
    return x, y, found


def _beside(errors, held, places, step, radius, goals, fields):
    """Return coordinates of rays that start as the chief rays and their derivatives say, and which were found."""
    cx, cy, reached = held[:3]
    (ex, ey, _), jacobian = _differences(errors, cx, cy, step, torch.zeros_like(goals[..., :1, :]), fields)
    slopes = _inverse(jacobian)
    dx, dy = _step(slopes, (ex - radius * goals[..., 0], ey - radius * goals[..., 1]))
    near = reached & torch.isfinite(dx + dy)
    x, y = (torch.where(near, c - d, own) for c, d, own in zip((cx, cy), (dx, dy), places, strict=True))
    return _solve(errors, x, y, step, radius, goals, fields, slopes)[:3]


def _powers(points: torch.Tensor) -> torch.Tensor:
    """Return the products of powers of the coordinates up to a degree, ``[..., P, K]``."""
    rows = [[torch.ones_like(value)] for value in points.unbind(-1)]
    for row, value in zip(rows, points.unbind(-1), strict=True):
        for _ in range(DEGREE):
            row.append(row[-1] * value)
    return torch.stack([rows[0][i] * rows[1][j] for i, j in POWERS], -1)


def _chart(nodes, x, y, found) -> torch.Tensor:
    """Return polynomials of points of the stop, ``[..., F, K, 6]``: a ray's coordinates and their derivatives."""
    kept = found[..., None]
    places = torch.where(kept, torch.stack([x, y], -1), 0.0)
    whole = torch.linalg.lstsq(kept * _powers(nodes), places).solution
    slopes = torch.zeros(2, len(POWERS), len(POWERS)).to(whole)
    for column, (i, j) in enumerate(POWERS):
        for axis, (count, lower) in enumerate(((i, (i - 1, j)), (j, (i, j - 1)))):
            if count:
                slopes[axis, POWERS.index(lower), column] = count
    return torch.cat([whole, slopes[0] @ whole, slopes[1] @ whole], -1)


def _by_chart(errors, chart, points, step, radius, goals, fields):
    """Return coordinates of rays that start as the chart and its derivatives say, and which reach their points."""
    x, y, xx, yx, xy, yy = (_powers(points) @ chart).movedim(-1, 0)
    return _solve(errors, x, y, step, radius, goals, fields, torch.stack([xx, xy, yx, yy]) / radius)[:3]


def _solve(errors, x, y, step, radius, goals, where, slopes=None, fresh=ROUNDS, close: float = 0.0, some=None):
    """Return coordinates at which rays meet their points, which of them do, and the inverse of the Jacobian there.

    Parameters
    ----------
    errors : callable
        Takes coordinates ``[..., F, P]``, goals and what else belongs to each ray, ``[..., F, P, 2]`` each; returns by
        how much rays miss, and whether they exist. It is called with some of the rays, as ``[..., N, 1]``.
    x, y : torch.Tensor
        First guess, ``[..., F, P]``.
    step, radius : torch.Tensor
        Length of differences, and the unit of misses.
    goals, where : torch.Tensor
        Of each ray, as `errors` takes them; they broadcast.
    slopes : torch.Tensor, optional
        Inverse of the Jacobian near there, ``[4, ..., F, P]``, by rows.
    fresh : int
        Steps whose Jacobian is by differences where there are no `slopes`.
    close : float
        Misses with which a search ends, if that is before its steps are small.
    some : torch.Tensor, optional
        Which rays are looked for, ``[F, P]``.

    Notes
    -----
    Newton's method by differences, and then Broyden's, which traces each ray once for a step: C. G. Broyden, "A class
    of methods for solving nonlinear simultaneous equations", Math. Comp. 19, 577 (1965),
    doi:10.1090/S0025-5718-1965-0198670-6, its good formula for the inverse. A ray is traced until its search has ended
    in all systems of a batch; one that is lost stays where it is.
    """
    shape = np.broadcast_shapes(x.shape, goals.shape[:-1])
    state = torch.stack([value.expand(shape) for value in (x, y, *([x] * 4 if slopes is None else slopes))])
    goals, where = goals.expand(*shape, 2), where.expand(*(shape[-2:] if where.ndim < 4 else shape), 2)
    found = torch.zeros(shape, dtype=torch.bool, device=x.device)
    some = torch.ones_like(found[(0,) * (found.ndim - 2)]) if some is None else some.clone()
    change, before, fresh = state[:2], state[:2], fresh if slopes is None else 0
    for i in range(ROUNDS):
        here, ends, which = state[..., some, None], goals[..., some, None, :], where[..., some, None, :]
        if i >= fresh:
            *missed, kept = errors(*here[:2], ends, which)
            inverse = here[2:] if i == 0 else _improved(here[2:], change, torch.stack(missed) - before)
        else:
            (*missed, kept), jacobian = _differences(errors, here[0], here[1], step, ends, which)
            inverse = _inverse(jacobian)
        missed = torch.stack(missed)
        change = torch.stack(_step(inverse, missed))
        usable = kept & torch.isfinite(change).all(0)
        change, error = torch.where(usable, -change, 0.0), missed.abs().amax(0)
        state[..., some] = torch.cat([here[:2] + change, inverse])[..., 0]
        found[..., some] = (usable & (error <= max(close, FOUND) * radius))[..., 0]
        # Ended are steps that are small, and after some those that come no nearer: at rounding, or astray.
        ended = ~usable | (change.abs().amax(0) <= CLOSE * step.abs()) | (error <= close * radius)
        if i > 2:
            ended = ended | (error > before.abs().amax(0) / 2)
        moves = (~ended).reshape(-1, ended.shape[-2]).any(0)
        if not bool(moves.any()):
            break
        some[some.clone()] = moves
        change, before = change[..., moves, :], missed[..., moves, :]
    return *state[:2], found, state[2:]


def _improved(slopes: torch.Tensor, change: torch.Tensor, gone: torch.Tensor) -> torch.Tensor:
    """Return an inverse Jacobian after a step and the change of the misses by it, by Broyden's good formula."""
    by = torch.stack(_step(slopes, gone))
    along = change[0] * slopes[:2] + change[1] * slopes[2:]
    size = (change * by).sum(0)
    share = torch.where(size != 0, (change - by) / torch.where(size != 0, size, 1.0), 0.0)
    better = slopes + torch.cat([share[0] * along, share[1] * along])
    return torch.where(torch.isfinite(better).all(0), better, slopes)


def _differences(errors, x, y, step, goals, where):
    """Return the errors, and their derivatives by x and by y, from differences on either side where a ray exists."""
    here, *ahead = _side_by_side(errors, [(x, y), (x + step, y), (x, y + step)], goals, where)
    if all(bool((kept | ~here[2]).all()) for _, _, kept in ahead):
        return here, [[(a - c) / step for a, c in zip(there[:2], here[:2], strict=True)] for there in ahead]
    behind = _side_by_side(errors, [(x - step, y), (x, y - step)], goals, where)
    return here, [
        [torch.where(there[2], a - c, c - b) / step for a, b, c in zip(there[:2], back[:2], here[:2], strict=True)]
        for there, back in zip(ahead, behind, strict=True)
    ]


def _side_by_side(errors, places: list[Any], *parts) -> list[tuple[Any, ...]]:
    """Return the errors of several places of each ray from one trace: few rays cost what its calls do."""
    shape, count = places[0][0].shape, len(places)
    parts = tuple(value.expand(*np.broadcast_shapes(value.shape[:-1], shape[-2:]), 2) for value in parts)
    px, py = (torch.cat([place[i] for place in places], -1) for i in range(2))
    found = errors(px, py, *(torch.cat([value] * count, -2) for value in parts))
    return list(zip(*(part.chunk(count, -1) for part in found), strict=True))


def _central(errors, x, y, step, *parts) -> tuple[list[list[torch.Tensor]], torch.Tensor]:
    """Return the derivatives of the errors by x and by y, by central differences, and where they exist."""
    sides = _side_by_side(errors, [(x + step, y), (x - step, y), (x, y + step), (x, y - step)], *parts)
    jacobian = [[(sides[i][j] - sides[i + 1][j]) / (2 * step) for j in range(2)] for i in (0, 2)]
    return jacobian, torch.stack([side[2] for side in sides]).all(0)


def _inverse(jacobian) -> torch.Tensor:
    """Return the inverse of a Jacobian, ``[4, ...]`` by rows, 0 where it is singular."""
    (ax, ay), (bx, by) = jacobian
    determinant = ax * by - bx * ay
    regular = (determinant != 0) & torch.isfinite(determinant)
    return torch.where(regular, torch.stack([by, -bx, -ay, ax]) / torch.where(regular, determinant, 1.0), 0.0)


def _step(slopes, missed) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the product of an inverse Jacobian and misses, a step of Newton's method."""
    (ex, ey), (xx, xy, yx, yy) = missed, slopes
    return xx * ex + xy * ey, yx * ex + yy * ey


def _continuation(errors, x, y, step, radius, way, least=LEAST):
    """Return coordinates ``[..., N, 1]`` followed from s = 0 to s = 1, which rays were found, and how far they came.

    Each march tries several steps along the secant of the last two places at once and takes those up to the first that
    fails.
    """
    s, length = torch.zeros_like(x), torch.full_like(x, 0.25)
    x, y, good, slopes = _solve(errors, x, y, step, radius, *way(s))
    idle = ~good
    shares = torch.arange(1, SHARES + 1).to(x) / SHARES
    # The first march has the tangent.
    here, further = (errors(x, y, *way(place)) for place in (s, s + 1e-4))
    ahead = torch.stack(_step(slopes, [(a - b) * 1e4 for a, b in zip(here[:2], further[:2], strict=True)]))
    ahead = torch.where(torch.isfinite(ahead), ahead, 0.0)
    for _ in range(MARCHES):
        active = ~idle & (s < 1)
        if not bool(active.any()):
            break
        target = torch.where(active, (s + length * shares).clamp(max=1.0), s)
        tries = torch.stack([x, y]) + ahead * (target - s)
        some = active.reshape(-1, active.shape[-2], 1).any(0).expand(target.shape[-2:])
        # Rays on the way need not be exact; those at its end are solved once more.
        *tries, met, _ = _solve(errors, *tries, step, radius, *way(target), fresh=1, close=NEAR, some=some)
        count = torch.where(active, met.long().cumprod(-1).sum(-1, keepdim=True), 0)
        ways = torch.cat([torch.stack([x, y, s]), torch.stack([*tries, target])], -1)
        place = count.expand(3, *count.shape)
        before, (x, y, s) = ways.gather(-1, (place - 1).clamp(min=0)), ways.gather(-1, place)
        gone = s - before[2]
        ahead = torch.where(gone > 0, (torch.stack([x, y]) - before[:2]) / gone, ahead)
        rate = torch.where(count == SHARES, 4.0, torch.where(count > 0, 2 / SHARES, 1 / SHARES))
        length = torch.where(active, rate * length, length)
        idle = idle | (length < least)
    done = s >= 1
    if bool(done.any()):
        x, y, met, _ = _solve(errors, x, y, step, radius, *way(s))
        done = done & met
    return x, y, done, s


def at_stop(system: optical_system, numbers: Prescription, rays: Any) -> Any:
    """Return the intersections of rays with the stop in its own frame, and whether they exist, at one wavelength."""
    hit = trace(system, rays, prescription=numbers, until=system.stop, vignetting=False)
    x, y, _ = in_surface_frame(system, numbers, system.stop, hit)
    return x[..., 0:1, :, :], y[..., 0:1, :, :], hit.arrived


def solve_pairs(
    errors: Any, x: torch.Tensor, y: torch.Tensor, step: torch.Tensor, goals: torch.Tensor, where: torch.Tensor
) -> Any:
    """Return the pairs (x, y) at which rays meet their points.

    Parameters
    ----------
    errors : callable
        Takes x, y, `goals` and `where` of some of the rays, returns by how much they miss in x and in y, and whether
        they exist.
    x, y : torch.Tensor
        First guess, ``[..., F, P]``.
    step : torch.Tensor
        Length along which differences are taken.
    goals, where : torch.Tensor
        The points of the rays, and another pair that belongs to each, ``[..., F, P, 2]``.

    Notes
    -----
    Newton's method for each pair, with a 2 × 2 Jacobian by differences. Solved without a graph; one more step with one,
    whose Jacobian is by central differences, carries the gradient of the implicit function theorem.
    """
    with torch.no_grad():
        x, y, *_ = _solve(errors, x, y, step, step, goals, where)
        slopes = _inverse(_central(errors, x, y, step, goals, where)[0])
    dx, dy = _step(slopes, errors(x, y, goals, where)[:2])
    return x - dx, y - dy


def trace_fields(
    system: optical_system, pupil: Pupil = "rings", count: int = 6, **options: "Unpack[TraceOptions]"
) -> Traced:
    """Launch rays from all field points and trace them to the image plane.

    Parameters
    ----------
    system : optical_system
        The system.
    pupil : str or torch.Tensor
        Pattern of :func:`pupil_samples`, or points ``[P, 2]`` in units of the pupil's radius.
    count : int
        Count of :func:`pupil_samples`.
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
    own: Any = {name: options[name] for name in ("fields", "prescription", "aim", "dtype") if name in options}
    rest: dict[str, Any] = {name: value for name, value in options.items() if name not in ("fields", "aim", "dtype")}
    return trace(system, launch(system, pupil, count, **own), **rest)
