"""Surfaces given by their height, as parameters with a name, and where rays meet them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from odak import _validate
from odak._array import Array, cast, is_torch, namespace
from odak.raytracing import arguments, intersections, sag
from odak.raytracing.batches import in_pieces
from odak.raytracing.geometry import dot, epsilon, finite_rays, masked, unit
from odak.raytracing.intersections import Hit
from odak.raytracing.status import RayStatus
from odak.tools.transformation import apply_matrix, rotation_matrix


@dataclass(frozen=True)
class Conic:
    """A conic of revolution.

    Parameters
    ----------
    curvature : float or array
        1/radius at the vertex; positive when the centre lies at +z, 0 for a plane.
    conic : float or array
        Conic constant: 0 sphere, −1 paraboloid, below −1 hyperboloid.
    """

    curvature: Any = 0.0
    conic: Any = 0.0
    closed_form: ClassVar[bool] = True

    def sag(self, x: Array, y: Array) -> sag.Sag:
        """Return height and slopes at x, y; see :mod:`odak.raytracing.sag`."""
        return sag.conic_sag(x, y, *self.parameters())

    def base(self: Any) -> tuple:
        """Return curvature and conic constant of the conic nearest to the surface."""
        return self.curvature, self.conic

    def parameters(self: Any) -> tuple:
        """Return the parameters in the order of the constructor."""
        return tuple(getattr(self, field.name) for field in fields(self))


@dataclass(frozen=True)
class EvenAsphere(Conic):
    """A conic plus even powers of the distance r from the axis, a1·r² + a2·r⁴ and so on.

    Parameters
    ----------
    curvature, conic : float or array
        As in :class:`Conic`.
    coefficients : sequence or array
        a1, a2, … along the last axis.
    """

    coefficients: Any = ()
    closed_form: ClassVar[bool] = False

    def sag(self, x: Array, y: Array) -> sag.Sag:
        """Return height and slopes at x, y."""
        return sag.even_asphere_sag(x, y, *self.parameters())


@dataclass(frozen=True)
class ZernikeFreeform(EvenAsphere):
    """A conic plus Zernike polynomials.

    Parameters
    ----------
    curvature, conic : float or array
        As in :class:`Conic`.
    coefficients : sequence or array
        Amplitudes in Noll's order from j = 1, each the polynomial's RMS over the disc.
    radius : float or array
        Radius of the disc.
    """

    radius: Any = 1.0

    def sag(self, x: Array, y: Array) -> sag.Sag:
        """Return height and slopes at x, y."""
        return sag.zernike_sag(x, y, *self.parameters())


@dataclass(frozen=True)
class Toroid:
    """A profile in y turned about an axis parallel to y.

    Parameters
    ----------
    curvature_x, curvature_y : float or array
        Curvatures at the vertex along x (that of the turning) and y (that of the profile).
    conic : float or array
        Conic constant of the profile.
    coefficients : sequence or array
        a1, a2, … of a1·y² + a2·y⁴ + …, added to the profile.
    """

    curvature_x: Any = 0.0
    curvature_y: Any = 0.0
    conic: Any = 0.0
    coefficients: Any = ()
    closed_form: ClassVar[bool] = False

    parameters = Conic.parameters

    def sag(self, x: Array, y: Array) -> sag.Sag:
        """Return height and slopes at x, y."""
        return sag.toroid_sag(x, y, *self.parameters())

    def base(self) -> tuple:
        """Return the mean curvature and the constant of a sphere."""
        return (self.curvature_x + self.curvature_y) / 2, 0.0


@dataclass(frozen=True)
class SplineFreeform:
    """A conic plus a uniform cubic B-spline.

    Parameters
    ----------
    heights : array
        Control points ``[n0, n1]``, at least 2 along each axis; the first axis is x.
    size : sequence or array
        Extents along x and y. The surface ends there.
    curvature, conic : float or array
        As in :class:`Conic`.
    """

    heights: Any
    size: Any
    curvature: Any = 0.0
    conic: Any = 0.0
    closed_form: ClassVar[bool] = False

    base = Conic.base
    parameters = Conic.parameters

    def sag(self, x: Array, y: Array) -> sag.Sag:
        """Return height and slopes at x, y."""
        return sag.spline_sag(x, y, *self.parameters())

    def covers(self, x: Array, y: Array) -> Array:
        """Say where the surface reaches, bool."""
        width, height = sag.terms(self.size)
        return (abs(x) <= width / 2) & (abs(y) <= height / 2)


Surface = Conic | Toroid | SplineFreeform


def intersect_w_sag(
    ray: Array,
    surface: Surface,
    center: Sequence[float] | None = None,
    angles: Sequence[float] | None = None,
    aperture: float | None = None,
    ahead: bool = True,
) -> Hit:
    """Meet a surface given by its height.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[..., 2, 3]``. Directions need not be unit vectors.
    surface : Conic, EvenAsphere, Toroid, ZernikeFreeform or SplineFreeform
        The surface, its vertex at the origin and its axis along z.
    center : sequence of float, optional
        Where its vertex is.
    angles : sequence of float, optional
        Its rotation in degrees about X, Y and Z, applied in this order.
    aperture : float, optional
        Distance from the axis at which it ends.
    ahead : bool
        Take only points ahead of the start; else also those behind it, at negative distances.

    Returns
    -------
    Hit
        Named tuple: distance ``[...]`` in lengths of the direction, point and unit normal ``[..., 3]`` (towards the
        surface's +z), status ``[...]``. NaN where the status is not HIT.

    Notes
    -----
    Conics are met in closed form: the nearest point ahead. The others by Newton's method, bracketed, from the conic
    nearest to them, so that of several points the one next to that conic's is found.

    A start that lies on the surface within rounding is not a hit. Near the vertex its own coordinates do not tell how
    large that is: give `aperture` where rays leave a surface that they may meet again.

    Examples
    --------
    >>> from odak.raytracing import Conic, intersect_w_sag
    >>> intersect_w_sag([[0, 3, -10], [0, 0, 1]], Conic(curvature=1 / 5)).distance
    array(11.)
    """
    ray = arguments.rays("ray", ray)
    start, direction = ray[..., 0, :], ray[..., 1, :]
    if not isinstance(surface, Surface):
        raise TypeError(f"surface must be a Conic, Toroid, SplineFreeform or one of their kinds, got {surface!r:.80}")
    kinds = {field.name: getattr(surface, field.name) for field in fields(surface)}
    kinds = {name: arguments.floats(f"surface.{name}", value) for name, value in kinds.items()}
    surface = type(surface)(**{name: value.astype(ray.dtype) for name, value in kinds.items()})
    center = None if center is None else arguments.finite_points("center", center)
    aperture = None if aperture is None else _validate.real("aperture", aperture)
    ahead = _validate.flag("ahead", ahead)
    matrix = None if angles is None else rotation_matrix(arguments.finite_points("angles", angles)).astype(ray.dtype)
    start, direction = to_local(start, direction, center, matrix)
    return to_global(meet_sag(start, direction, surface, aperture, ahead), center, matrix)


def to_local(start, direction, center, matrix):
    """Return rays in the frame of a surface that was rotated by `matrix` and moved to `center`."""
    start = start if center is None else start - cast(center, start)
    if matrix is None:
        return start, direction
    inverse = namespace(matrix).matrix_transpose(matrix)
    return apply_matrix(inverse, start), apply_matrix(inverse, direction)


def to_global(hit: Hit, center, matrix) -> Hit:
    """Return a hit in the frame that :func:`to_local` came from."""
    point, normal = hit.point, hit.normal
    if matrix is not None:
        point, normal = apply_matrix(matrix, point), apply_matrix(matrix, normal)
    point = point if center is None else point + cast(center, point)
    return Hit(hit.distance, point, normal, hit.status)


def hit_on_sag(start, direction, distance, status, surface: Surface) -> Hit:
    """Return the hit that belongs to known distances ``[...]``; differentiable in the arguments."""
    xp = namespace(start, direction)
    start, direction, _ = finite_rays(start, direction)
    hit = status == int(RayStatus.HIT)
    place = start + xp.where(hit, distance, 0.0)[..., None] * direction
    held = xp.where(hit[..., None], place, 0.0)
    slopes = surface.sag(held[..., 0], held[..., 1])
    normal = unit(xp.stack((-slopes.slope_x, -slopes.slope_y, xp.ones_like(slopes.slope_x)), axis=-1))
    return Hit(masked(distance, hit), masked(place, hit), masked(normal, hit), status)


def ranks(surface: Surface | type[Surface]) -> tuple[int, ...]:
    """Return how many axes of each parameter of a surface do not belong to a batch."""
    return tuple(_RANKS.get(field.name, 0) for field in fields(surface))


_RANKS = {"coefficients": 1, "heights": 2, "size": 1}


def meet_sag(start, direction, surface: Surface, aperture=None, ahead: bool = True) -> Hit:
    """Return where rays meet a surface in its own frame, without gradients; large batches piece by piece."""
    kind = type(surface)

    def meet(start, direction, aperture, *parameters):
        held = kind(*parameters)
        if kind.closed_form:
            curvature, constant = held.base()
            return intersections.conic(start, direction, curvature, constant, aperture, ahead)
        return hit_on_sag(start, direction, *_solve(start, direction, held, aperture, ahead), held)

    return in_pieces(meet, (1, 1, 0, *ranks(kind)), start, direction, aperture, *surface.parameters())


def solve_sag(start, direction, surface: Surface, aperture=None, ahead: bool = True):
    """Return distances ``[...]``, NaN unless hit, and int8 statuses, in the surface's own frame, without gradients."""
    kind = type(surface)

    def solve(start, direction, aperture, *parameters):
        return _solve(start, direction, kind(*parameters), aperture, ahead)

    return in_pieces(solve, (1, 1, 0, *ranks(kind)), start, direction, aperture, *surface.parameters())


def _solve(start, direction, surface: Surface, aperture, ahead: bool):
    xp = namespace(start, direction)
    curvature, constant = surface.base()
    if surface.closed_form:
        hit = intersections.conic(start, direction, curvature, constant, aperture, ahead)
        return hit.distance, hit.status
    start, direction, kept = finite_rays(start, direction)
    kept = kept & (dot(direction, direction) > 0)
    seed = intersections.conic(start, direction, curvature, constant, None, ahead)
    flat = intersections.conic(start, direction, 0 * start[..., 0], 0.0, None, False)
    guess = xp.where(seed.hit, seed.distance, xp.where(flat.hit, flat.distance, 0.0))
    distance, found, crossed = newton(start, direction, surface, guess)
    place = start + distance[..., None] * direction
    scale = abs(distance) * dot(direction, direction) ** 0.5 + dot(start, start) ** 0.5
    if ahead:
        # A start on the surface itself is not a hit.
        scale = scale if aperture is None else scale + aperture
        crossed = crossed & (distance * dot(direction, direction) ** 0.5 > 64 * epsilon(start) * scale)
    inside = surface.covers(place[..., 0], place[..., 1]) if hasattr(surface, "covers") else crossed
    if aperture is not None:
        inside = inside & (place[..., 0] ** 2 + place[..., 1] ** 2 <= aperture * aperture)
    status = xp.astype(~found, xp.int8) * int(RayStatus.NOT_CONVERGED)
    status = xp.where(found & ~inside, status + int(RayStatus.VIGNETTED), status)
    status = xp.where(crossed & kept, status, xp.ones_like(status) * int(RayStatus.MISS))
    return masked(distance, status == int(RayStatus.HIT)), status


def newton(start, direction, surface: Surface, guess, limit: int = 64):
    """Solve z = height(x, y) along rays by Newton's method, kept within a bracket as soon as there is one.

    Parameters
    ----------
    start, direction : array
        ``[..., 3]``.
    surface : Surface
        The surface.
    guess : array
        First distances, ``[...]``.
    limit : int
        Largest number of steps.

    Returns
    -------
    tuple of array
        Distances, which of them converged, and which rays cross the surface at all, ``[...]``.

    Notes
    -----
    A step that leaves the bracket, or does not lower the error, is replaced by halving the bracket; before there is
    one, by halving the way back to the best place so far, the first of which is the ray's point nearest to the axis,
    where a surface exists if anywhere.
    """
    xp = namespace(start, direction)
    dx, dy, dz = xp.unstack(direction, axis=-1)
    across = dx * dx + dy * dy
    aside = start[..., 0] * dx + start[..., 1] * dy
    best = xp.where(across > 0, -aside / xp.where(across > 0, across, 1.0), guess)
    t, smallest = guess, xp.full_like(guess, xp.inf)
    low, high = xp.full_like(guess, xp.nan), xp.full_like(guess, xp.nan)
    done = crossed = xp.isnan(guess)
    for step in range(limit):
        x, y, z = xp.unstack(start + t[..., None] * direction, axis=-1)
        here = surface.sag(x, y)
        error, slope = z - here.height, dz - here.slope_x * dx - here.slope_y * dy
        known = here.defined & xp.isfinite(error)
        low, high = xp.where(known & (error <= 0), t, low), xp.where(known & (error >= 0), t, high)
        better = known & (abs(error) < smallest)
        best, smallest = xp.where(better, t, best), xp.where(better, abs(error), smallest)
        noise = 16 * epsilon(start) * (abs(x) + abs(y) + abs(z) + abs(start[..., 2]) + abs(here.height))
        settled = done | (known & (abs(error) <= noise))
        crossed = crossed | (xp.isfinite(low) & xp.isfinite(high)) | settled
        following = _next(xp, t, error, slope, best, better, low, high)
        # One step further from within the noise: it brings the error down to rounding.
        polished = t - xp.where(slope == 0, 0.0, error) / xp.where(slope == 0, 1.0, slope)
        t, done = xp.where(done, t, xp.where(settled, polished, following)), settled
        # A ray without a bracket after 24 steps passes the surface by. On a GPU every look at the result waits for it,
        # so that it is taken every fourth time.
        over = done if step < 24 else done | ~crossed
        if (step % 4 == 3 or not (is_torch(t) and t.is_cuda)) and bool(xp.all(over)):
            break
    return t, done, crossed


def _next(xp, t, error, slope, best, better, low, high):
    """Return the next distances to try."""
    step = t - error / xp.where(slope == 0, 1.0, slope)
    bracketed = xp.isfinite(low) & xp.isfinite(high)
    usable = better & (slope != 0) & xp.isfinite(step)
    between = (step - low) * (step - high) < 0
    halved = xp.where(bracketed, (low + high) / 2, (t + best) / 2)
    return xp.where(usable & (between | ~bracketed), step, halved)
