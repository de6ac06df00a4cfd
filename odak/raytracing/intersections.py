"""Closed-form intersections of rays with planes, spheres, cylinders and conics, their records and their statuses.

Starts and directions are ``[..., 3]``, or tuples of three components, and broadcast against the surfaces' arrays, so
that rays ``[m, 1, 3]`` and surfaces ``[n, 3]`` give ``[m, n]``. Directions need not be unit vectors: a distance is in
units of the length of its direction. Without an intersection, distance, point and normal are NaN, and gradients are 0.
"""

from enum import IntEnum
from types import ModuleType
from typing import Any, NamedTuple

from odak._array import Amount, Array, namespace
from odak.raytracing import components as vec
from odak.raytracing.batches import in_pieces
from odak.raytracing.components import join
from odak.raytracing.geometry import barycentric, epsilon


class Intersection(NamedTuple):
    """Distance, components of point and normal, and which rays hit; NaN elsewhere."""

    distance: Any
    point: tuple[Any, ...]
    normal: tuple[Any, ...]
    hit: Any


def plane(start: Any, direction: Any, point: Any, normal: Any) -> Intersection:
    """Intersect rays with planes through `point` with `normal`; the distance is signed, negative behind the start.

    A ray parallel to the plane within two units of rounding is a miss. The normal is returned as given.
    """
    xp, start, direction, kept, differentiable = vec.lines(start, direction, point, normal)
    given = vec.split(normal)
    # The normal of a degenerate triangle is NaN; a null vector is parallel to every ray.
    real = vec.split(xp.where(xp.isfinite(normal), normal, 0.0)) if differentiable else given
    slope = vec.dot(real, direction)
    limit = ((2 * epsilon(slope)) ** 2 * vec.dot(real, real)) * vec.dot(direction, direction)
    hit = kept & (slope * slope > limit)
    distance = vec.quotient(vec.dot(real, vec.minus(vec.split(point), start)), slope, hit, differentiable)
    hit = hit & (abs(distance) < xp.inf)
    distance = vec.placeholder(distance, hit, differentiable)
    place = vec.along(start, distance, direction)
    return Intersection(
        vec.nan_outside(distance, hit, differentiable), vec.nan_outside(place, hit, differentiable), given, hit
    )


def vertex_plane(start: Any, direction: Any) -> Intersection:
    """Intersect rays with the plane z = 0, ahead or behind."""
    xp, start, direction, kept, differentiable = vec.lines(start, direction)
    hit = kept & (direction[2] != 0)
    distance = vec.quotient(-start[2], direction[2], hit, differentiable)
    x, y, z = vec.along(start, distance, direction)
    zero = 0 * z
    return _result(distance, (x, y, zero), (zero, zero, zero + 1), hit & (abs(distance) < xp.inf), differentiable)


def on_triangle(flat: Intersection, corners: Array) -> Array:
    """Return which of the rays that intersect the planes of triangles intersect the triangles."""
    return flat.hit & encloses(*barycentric(flat.point, corners))


def encloses(u: Array, v: Array) -> Array:
    """Return whether barycentric coordinates lie within their triangle: u ≥ 0, v ≥ 0, u + v < 1."""
    return (u >= 0) & (v >= 0) & (u + v < 1)


def _result(distance, place, normal, hit, differentiable) -> Intersection:
    distance, place, normal = (vec.nan_outside(value, hit, differentiable) for value in (distance, place, normal))
    return Intersection(distance, place, normal, hit)


def sphere(start: Array, direction: Array, centre: Array, radius: Array | float) -> Intersection:
    """Intersect rays with spheres at the nearest point ahead, the exit for a start inside; outward normals.

    Notes
    -----
    The discriminant is r² − |f − (f·d)d|², f = start − centre, which is accurate for distant starts (Haines, Günther
    and Akenine-Möller, Ray Tracing Gems (2019), chapter 7). A start that lies on the sphere within rounding is not a
    hit.
    """
    xp, start, direction, kept, differentiable = vec.lines(start, direction, centre, radius)
    centre = vec.split(centre)
    arm, squared = vec.minus(start, centre), vec.dot(direction, direction)
    noise = epsilon(squared) * vec.dot(centre, centre) ** 0.5
    distance, hit = nearest_ahead(xp, squared, arm, direction, radius, kept & (squared > 0), noise, differentiable)
    place = vec.along(start, distance, direction)
    normal = vec.unit(vec.minus(place, centre), differentiable)
    return _result(distance, place, normal, hit, differentiable)


def cylinder(start: Array, direction: Array, centre: Array, radius: Array, axis: Array) -> Intersection:
    """Intersect rays with infinite cylinders about lines through `centre` along `axis`; outward normals.

    The intersection is the nearest point ahead. A ray along the axis misses.
    """
    xp, start, direction, kept, differentiable = vec.lines(start, direction, centre, radius, axis)
    centre, axis = vec.split(centre), vec.unit(vec.split(axis), False)
    arm, across = vec.without(vec.minus(start, centre), axis), vec.without(direction, axis)
    squared = vec.dot(across, across)
    moving = kept & (squared > (4 * epsilon(squared)) ** 2 * vec.dot(direction, direction))
    noise = epsilon(squared) * vec.dot(centre, centre) ** 0.5
    distance, hit = nearest_ahead(xp, squared, arm, across, radius, moving, noise, differentiable)
    place = vec.along(start, distance, direction)
    normal = vec.unit(vec.without(vec.minus(place, centre), axis), differentiable)
    return _result(distance, place, normal, hit, differentiable)


def nearest_ahead(
    xp: ModuleType,
    squared: Array,
    arm: vec.Vector,
    direction: vec.Vector,
    radius: Amount,
    moving: Array,
    noise: Array,
    differentiable: bool,
) -> tuple[Array, Array]:
    """Return the nearest positive t with |arm + t·direction| = radius, and whether there is one.

    Parameters
    ----------
    xp : module
        Array namespace.
    squared : array
        direction·direction.
    arm, direction : tuple of array
        Components.
    radius : array
        Radius.
    moving : array
        Rays to consider; the others miss.
    noise : array
        Rounding error of the arm that comes from coordinates far from the origin.
    differentiable : bool
        Whether derivatives are taken.

    Notes
    -----
    A start within a few rounding errors of the surface counts as a point of the surface: its root is exactly 0 and
    thus not ahead, so that a reflected or refracted ray does not intersect the surface that it leaves.
    """
    half = vec.dot(arm, direction)
    foot = vec.along(arm, -vec.quotient(half, squared, moving, differentiable), direction)
    discriminant = squared * (radius * radius - vec.dot(foot, foot))
    inward = vec.dot(arm, arm)
    reach = inward**0.5 + abs(radius)
    height = inward - radius * radius
    height = xp.where(abs(height) <= 8 * reach * (epsilon(squared) * reach + noise), 0.0, height)
    # The root of larger magnitude has no cancellation; the other one follows from their product.
    q = -(half + xp.copysign(vec.square_root(discriminant, differentiable), half))
    first = vec.quotient(q, squared, moving, differentiable)
    second = vec.quotient(height, q, q != 0, differentiable)
    near, far = xp.minimum(first, second), xp.maximum(first, second)
    distance = xp.where(near > 0, near, far)
    hit = moving & (discriminant >= 0) & (distance > 0) & (distance < xp.inf)
    return vec.placeholder(distance, hit, differentiable), hit


def conic(
    start: Array | vec.Vector,
    direction: Array | vec.Vector,
    curvature: Amount,
    constant: Amount,
    aperture: Amount | None = None,
    select: str = "ahead",
) -> tuple[Intersection, Array]:
    """Intersect rays with the sheet of a conic of revolution that passes through the origin with its axis along z.

    Parameters
    ----------
    start, direction : array or tuple
        ``[..., 3]``, or tuples of three components.
    curvature, constant : array
        Curvature at the vertex and conic constant: c(x² + y² + (1 + k)z²) = 2z.
    aperture : array, optional
        Distance from the axis beyond which the surface ends.
    select : str
        Which of two intersections: "ahead", the nearest in front of the start; "vertex", ahead or behind, the nearest
        to the vertex plane; "through", ahead or behind, the one at which the ray passes from the side of −z to the side
        of +z if its direction has a positive z component, and back otherwise; "forward", the one at which it passes
        from the side of −z to the side of +z, whatever its direction.

    Returns
    -------
    tuple
        The :class:`Intersection` with normals that point to +z, and which rays intersect the sheet, within the aperture
        or not. A start within rounding of the sheet, measured by its coordinates and the aperture, is not a hit.
    """
    line = vec.lines(start, direction, curvature, constant, aperture)
    xp, start, direction, kept, differentiable = line
    (x, y, z), (dx, dy, dz), k = start, direction, 1 + constant
    squared = vec.dot(direction, direction)
    moving = kept & (squared > 0)
    # From the point nearest to the vertex, so that a distant start causes no loss of precision.
    offset = vec.quotient(-vec.dot(start, direction), squared, moving, differentiable)
    x, y, z = vec.along(start, offset, direction)
    a = curvature * (dx * dx + dy * dy + k * (dz * dz))
    b = curvature * (x * dx + y * dy + k * (z * dz)) - dz
    c = curvature * (x * x + y * y + k * (z * z)) - 2 * z
    discriminant = b * b - a * c
    q = -(b + xp.copysign(vec.square_root(discriminant, differentiable), b))
    candidates: list[Any] = []
    moving = moving & (discriminant >= 0)
    for upper, lower in ((q, a), (c, q)):
        exists = moving & (lower != 0)
        t = vec.quotient(upper, lower, exists, differentiable)
        height = z + t * dz
        on_sheet = exists & (1 - (k * curvature) * height > 0) & (abs(t) < xp.inf)
        across = None if aperture is None else (x + t * dx) ** 2 + (y + t * dy) ** 2
        candidates.append((t + offset, on_sheet, height, across, exists))
    (t1, on1, z1, r1, exists1), (t2, on2, z2, r2, exists2) = candidates
    if select in ("through", "forward"):
        # The derivative of z − sag along the ray has the sign of b at the first root, the opposite one at the second.
        first = (b >= 0) == (dz > 0) if select == "through" else b >= 0
        on1, on2 = on1 & first, on2 & ~first
    if select == "ahead":
        # The start may lie on the other sheet, or on the other half of a sphere.
        leaving = _starts_on(start, curvature, k, aperture)
        nearer = exists1 & (~exists2 | (abs(t1) <= abs(t2)))
        on1, on2 = on1 & (t1 > 0) & ~(leaving & nearer), on2 & (t2 > 0) & ~(leaving & ~nearer)
    order = t1 <= t2 if select == "ahead" else abs(z1) <= abs(z2)
    sheet = on1 | on2
    if aperture is not None:
        on1, on2 = on1 & (r1 <= aperture * aperture), on2 & (r2 <= aperture * aperture)
    hit = on1 | on2
    distance = vec.placeholder(xp.where(on1 & (order | ~on2), t1, t2), hit, differentiable)
    place = vec.along(start, distance, direction)
    x, y, z = place
    normal = vec.unit((-curvature * x, -curvature * y, 1 - (k * curvature) * z), differentiable)
    return _result(distance, place, normal, hit, differentiable), sheet


def _starts_on(start, curvature, k, aperture):
    """Return which starts lie on a conic of revolution within rounding, on either of its sheets."""
    x, y, z = start
    terms = (curvature * (x * x + y * y), (curvature * k) * (z * z), -2 * z)
    # Near the vertex the rounding error of the start is relative to the size of the aperture, not to its own
    # coordinates.
    size = sum(abs(term) for term in terms) + (0.0 if aperture is None else 2 * aperture)
    return abs(sum(terms)) <= 16 * epsilon(terms[2]) * size


class RayStatus(IntEnum):
    """Result of the intersection of a ray with a surface; arrays of statuses hold these numbers as int8.

    HIT: the ray is propagated further. MISS: there is no intersection. TOTAL_INTERNAL_REFLECTION: there is no refracted
    or diffracted ray. VIGNETTED: the intersection lies outside the aperture. NOT_CONVERGED: an iteration did not find
    the intersection. NOT_AIMED: no ray from the field point through the requested point of the stop was found.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.raytracing import RayStatus
    >>> status = np.array([0, 0, 3, 1], dtype=np.int8)
    >>> int((status == RayStatus.HIT).sum())
    2
    >>> [RayStatus(value).name for value in status.tolist()]
    ['HIT', 'HIT', 'VIGNETTED', 'MISS']
    """

    HIT = 0
    MISS = 1
    TOTAL_INTERNAL_REFLECTION = 2
    VIGNETTED = 3
    NOT_CONVERGED = 4
    NOT_AIMED = 5


class Hit(NamedTuple):
    """Intersections of rays with a surface.

    Attributes
    ----------
    distance : array
        ``[...]``, in lengths of the direction; NaN unless hit.
    point : array
        ``[..., 3]``; NaN unless hit.
    normal : array
        Unit normal ``[..., 3]``; NaN unless hit (except for planes).
    status : array
        :class:`odak.raytracing.RayStatus` as int8, ``[...]``.
    """

    distance: Any
    point: Any
    normal: Any
    status: Any

    @property
    def hit(self) -> Any:
        """Rays that intersect the surface, bool ``[...]``."""
        return self.status == int(RayStatus.HIT)


def status_array(hit: Array, otherwise: RayStatus = RayStatus.MISS) -> Array:
    """Return int8 statuses: HIT where `hit` holds, `otherwise` elsewhere."""
    missed = namespace(hit).astype(~hit, namespace(hit).int8)
    return missed if int(otherwise) == 1 else missed * int(otherwise)


def within(point: Any, known: Any, corners: Any) -> Any:
    """Return whether the points that are `known` lie on triangles: u ≥ 0, v ≥ 0, u + v < 1."""

    def inside(point, known, corners):
        place = namespace(point).where(known[..., None], point, 0.0)
        return known & encloses(*barycentric(place, corners))

    return in_pieces(inside, (1, 0, 2), point, known, corners)


def conic_status(found: Intersection, sheet: Array) -> Array:
    """Return statuses of :func:`odak.raytracing.intersections.conic`: VIGNETTED on the sheet beyond the aperture."""
    status = status_array(found.hit)
    beyond = int(RayStatus.VIGNETTED) - int(RayStatus.MISS)
    return status + namespace(sheet).astype(sheet & ~found.hit, status.dtype) * beyond


def as_hit(found: Intersection, status: Array | None = None) -> Hit:
    """Return a :class:`Hit` with the components of its vectors joined."""
    distance, point, normal, hit = found
    point, normal = join(point), join(normal)
    if normal.shape != point.shape:
        normal = namespace(point).broadcast_to(normal, point.shape)
    return Hit(distance, point, normal, status_array(hit) if status is None else status)
