"""Closed-form intersections of rays with planes, triangles, discs, spheres, cylinders and conics, in components.

Each function takes the arguments of its namesake in :mod:`odak.raytracing.intersections` and returns an
:class:`Intersection`.
"""

from typing import Any, NamedTuple

from odak.raytracing import components as vec
from odak.raytracing.geometry import barycentric, epsilon, triangle_normal


class Intersection(NamedTuple):
    """Distance, components of point and normal, and which rays hit; NaN elsewhere."""

    distance: Any
    point: tuple
    normal: tuple
    hit: Any


def plane(start, direction, point, normal) -> Intersection:
    """Intersect rays with planes; the normal is returned as given."""
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


def vertex_plane(start, direction) -> Intersection:
    """Intersect rays with the plane z = 0, ahead or behind."""
    xp, start, direction, kept, differentiable = vec.lines(start, direction)
    hit = kept & (direction[2] != 0)
    distance = vec.quotient(-start[2], direction[2], hit, differentiable)
    x, y, z = vec.along(start, distance, direction)
    zero = 0 * z
    return _result(distance, (x, y, zero), (zero, zero, zero + 1), hit & (abs(distance) < xp.inf), differentiable)


def triangle(start, direction, corners) -> Intersection:
    """Intersect rays with triangles ``[..., 3, 3]``."""
    flat = plane(start, direction, corners[..., 0, :], triangle_normal(corners))
    return _limited(flat, on_triangle(flat, corners))


def on_triangle(flat: Intersection, corners):
    """Return which of the rays that intersect the planes of triangles intersect the triangles."""
    return flat.hit & encloses(*barycentric(flat.point, corners))


def encloses(u, v):
    """Return whether barycentric coordinates lie within their triangle: u ≥ 0, v ≥ 0, u + v < 1."""
    return (u >= 0) & (v >= 0) & (u + v < 1)


def disc(start, direction, point, normal, centre, radius) -> Intersection:
    """Intersect rays with planes within `radius` of `centre`."""
    flat = plane(start, direction, point, normal)
    arm = vec.minus(flat.point, vec.split(centre))
    return _limited(flat, flat.hit & (vec.dot(arm, arm) <= radius * radius))


def _result(distance, place, normal, hit, differentiable) -> Intersection:
    distance, place, normal = (vec.nan_outside(value, hit, differentiable) for value in (distance, place, normal))
    return Intersection(distance, place, normal, hit)


def _limited(flat: Intersection, inside) -> Intersection:
    return Intersection(
        vec.nan_outside(flat.distance, inside, True), vec.nan_outside(flat.point, inside, True), flat.normal, inside
    )


def sphere(start, direction, centre, radius) -> Intersection:
    """Intersect rays with spheres."""
    xp, start, direction, kept, differentiable = vec.lines(start, direction, centre, radius)
    centre = vec.split(centre)
    arm, squared = vec.minus(start, centre), vec.dot(direction, direction)
    noise = epsilon(squared) * vec.dot(centre, centre) ** 0.5
    distance, hit = nearest_ahead(xp, squared, arm, direction, radius, kept & (squared > 0), noise, differentiable)
    place = vec.along(start, distance, direction)
    normal = vec.unit(vec.minus(place, centre), differentiable)
    return _result(distance, place, normal, hit, differentiable)


def cylinder(start, direction, centre, radius, axis) -> Intersection:
    """Intersect rays with infinite cylinders."""
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


def nearest_ahead(xp, squared, arm, direction, radius, moving, noise, differentiable: bool):
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


def conic(start, direction, curvature, constant, aperture=None, select: str = "ahead") -> tuple[Intersection, Any]:
    """Intersect rays with the sheet of a conic of revolution that passes through the origin.

    Parameters
    ----------
    start, direction : array or tuple
        ``[..., 3]``, or tuples of three components.
    curvature, constant : array
        Vertex curvature and conic constant.
    aperture : array, optional
        Distance from the axis beyond which the surface ends.
    select : str
        Which of two intersections: "ahead", the nearest in front of the start; "vertex", ahead or behind, the nearest
        to the vertex plane; "through", ahead or behind, the one at which the ray passes from the side of −z to that of
        +z if its direction has a positive z component, and back otherwise.

    Returns
    -------
    tuple
        The :class:`Intersection`, and which rays intersect the sheet, within the aperture or not.
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
    candidates = []
    moving = moving & (discriminant >= 0)
    for upper, lower in ((q, a), (c, q)):
        exists = moving & (lower != 0)
        t = vec.quotient(upper, lower, exists, differentiable)
        height = z + t * dz
        on_sheet = exists & (1 - (k * curvature) * height > 0) & (abs(t) < xp.inf)
        across = None if aperture is None else (x + t * dx) ** 2 + (y + t * dy) ** 2
        candidates.append((t + offset, on_sheet, height, across))
    (t1, on1, z1, r1), (t2, on2, z2, r2) = candidates
    if select == "through":
        # The derivative of z − sag along the ray has the sign of b at the first root, the opposite one at the second.
        first = (b >= 0) == (dz > 0)
        on1, on2 = on1 & first, on2 & ~first
    if select == "ahead":
        leaving = _starts_on(start, curvature, k, aperture)
        nearer = on1 & (abs(t1) <= abs(t2))
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
    """Return which starts lie on a conic's sheet within rounding."""
    x, y, z = start
    terms = (curvature * (x * x + y * y), (curvature * k) * (z * z), -2 * z)
    # Near the vertex the rounding error of the start is relative to the size of the aperture, not to its own
    # coordinates.
    size = sum(abs(term) for term in terms) + (0.0 if aperture is None else 2 * aperture)
    return abs(sum(terms)) <= 16 * epsilon(terms[2]) * size
