"""Where rays meet planes, triangles, discs, spheres, cylinders and conics: the formulas, component by component.

Each function takes what its namesake in :mod:`odak.raytracing.intersections` takes and returns a :class:`Meeting`.
"""

from typing import Any, NamedTuple

from odak.raytracing import components as vec
from odak.raytracing.geometry import barycentric, epsilon, triangle_normal


class Meeting(NamedTuple):
    """Distance, components of point and normal, and which rays hit; NaN elsewhere."""

    distance: Any
    point: tuple
    normal: tuple
    hit: Any


def plane(start, direction, point, normal) -> Meeting:
    """Meet planes; the normal is returned as given."""
    xp, start, direction, kept, followed = vec.lines(start, direction, point, normal)
    given = vec.split(normal)
    # A degenerate triangle's normal is NaN: a null vector makes it parallel to everything.
    real = vec.split(xp.where(xp.isfinite(normal), normal, 0.0)) if followed else given
    slope = vec.dot(real, direction)
    limit = ((2 * epsilon(slope)) ** 2 * vec.dot(real, real)) * vec.dot(direction, direction)
    hit = kept & (slope * slope > limit)
    distance = vec.divided(vec.dot(real, vec.minus(vec.split(point), start)), slope, hit, followed)
    hit = hit & (abs(distance) < xp.inf)
    distance = vec.shown(distance, hit, followed)
    place = vec.along(start, distance, direction)
    return Meeting(vec.hidden(distance, hit, followed), vec.hidden(place, hit, followed), given, hit)


def triangle(start, direction, corners) -> Meeting:
    """Meet triangles ``[..., 3, 3]``."""
    flat = plane(start, direction, corners[..., 0, :], triangle_normal(corners))
    return _limited(flat, on_triangle(flat, corners))


def on_triangle(flat: Meeting, corners):
    """Say which rays that meet the planes of triangles meet these."""
    return flat.hit & encloses(*barycentric(flat.point, corners))


def encloses(u, v):
    """Say whether barycentric coordinates lie within their triangle: u ≥ 0, v ≥ 0, u + v < 1."""
    return (u >= 0) & (v >= 0) & (u + v < 1)


def disc(start, direction, point, normal, centre, radius) -> Meeting:
    """Meet planes within `radius` of `centre`."""
    flat = plane(start, direction, point, normal)
    arm = vec.minus(flat.point, vec.split(centre))
    return _limited(flat, flat.hit & (vec.dot(arm, arm) <= radius * radius))


def _met(distance, place, normal, hit, followed) -> Meeting:
    distance, place, normal = (vec.hidden(value, hit, followed) for value in (distance, place, normal))
    return Meeting(distance, place, normal, hit)


def _limited(flat: Meeting, inside) -> Meeting:
    return Meeting(vec.hidden(flat.distance, inside, True), vec.hidden(flat.point, inside, True), flat.normal, inside)


def sphere(start, direction, centre, radius) -> Meeting:
    """Meet spheres."""
    xp, start, direction, kept, followed = vec.lines(start, direction, centre, radius)
    centre = vec.split(centre)
    arm, squared = vec.minus(start, centre), vec.dot(direction, direction)
    noise = epsilon(squared) * vec.dot(centre, centre) ** 0.5
    distance, hit = nearest_ahead(xp, squared, arm, direction, radius, kept & (squared > 0), noise, followed)
    place = vec.along(start, distance, direction)
    normal = vec.unit(vec.minus(place, centre), followed)
    return _met(distance, place, normal, hit, followed)


def cylinder(start, direction, centre, radius, axis) -> Meeting:
    """Meet infinite cylinders."""
    xp, start, direction, kept, followed = vec.lines(start, direction, centre, radius, axis)
    centre, axis = vec.split(centre), vec.unit(vec.split(axis), False)
    arm, across = vec.without(vec.minus(start, centre), axis), vec.without(direction, axis)
    squared = vec.dot(across, across)
    moving = kept & (squared > (4 * epsilon(squared)) ** 2 * vec.dot(direction, direction))
    noise = epsilon(squared) * vec.dot(centre, centre) ** 0.5
    distance, hit = nearest_ahead(xp, squared, arm, across, radius, moving, noise, followed)
    place = vec.along(start, distance, direction)
    normal = vec.unit(vec.without(vec.minus(place, centre), axis), followed)
    return _met(distance, place, normal, hit, followed)


def nearest_ahead(xp, squared, arm, direction, radius, moving, noise, followed: bool):
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
    followed : bool
        Whether a graph follows.

    Notes
    -----
    A start within a few roundings of the surface is taken as on it: its root there is exactly 0 and not ahead, so
    that a reflected or refracted ray does not meet again the surface it leaves.
    """
    half = vec.dot(arm, direction)
    foot = vec.along(arm, -vec.divided(half, squared, moving, followed), direction)
    discriminant = squared * (radius * radius - vec.dot(foot, foot))
    inward = vec.dot(arm, arm)
    reach = inward**0.5 + abs(radius)
    height = inward - radius * radius
    height = xp.where(abs(height) <= 8 * reach * (epsilon(squared) * reach + noise), 0.0, height)
    # The root of larger magnitude has no cancellation; the other one follows from their product.
    q = -(half + xp.copysign(vec.rooted(discriminant, followed), half))
    first = vec.divided(q, squared, moving, followed)
    second = vec.divided(height, q, q != 0, followed)
    near, far = xp.minimum(first, second), xp.maximum(first, second)
    distance = xp.where(near > 0, near, far)
    hit = moving & (discriminant >= 0) & (distance > 0) & (distance < xp.inf)
    return vec.shown(distance, hit, followed), hit


def conic(start, direction, curvature, constant, aperture=None, ahead: bool = True) -> tuple[Meeting, Any]:
    """Meet the sheet of a conic of revolution; also say which rays meet the sheet, within the aperture or not."""
    line = vec.lines(start, direction, curvature, constant, aperture)
    xp, start, direction, kept, followed = line
    (x, y, z), (dx, dy, dz), k = start, direction, 1 + constant
    squared = vec.dot(direction, direction)
    moving = kept & (squared > 0)
    # From the point nearest the vertex, so that a far start costs no digits.
    offset = vec.divided(-vec.dot(start, direction), squared, moving, followed)
    x, y, z = vec.along(start, offset, direction)
    a = curvature * (dx * dx + dy * dy + k * (dz * dz))
    b = curvature * (x * dx + y * dy + k * (z * dz)) - dz
    c = curvature * (x * x + y * y + k * (z * z)) - 2 * z
    discriminant = b * b - a * c
    q = -(b + xp.copysign(vec.rooted(discriminant, followed), b))
    candidates = []
    moving = moving & (discriminant >= 0)
    for upper, lower in ((q, a), (c, q)):
        exists = moving & (lower != 0)
        t = vec.divided(upper, lower, exists, followed)
        height = z + t * dz
        on_sheet = exists & (1 - (k * curvature) * height > 0) & (abs(t) < xp.inf)
        across = None if aperture is None else (x + t * dx) ** 2 + (y + t * dy) ** 2
        candidates.append((t + offset, on_sheet, height, across))
    return _choose(line, candidates, curvature, k, aperture, ahead)


def _choose(line, candidates, curvature, k, aperture, ahead) -> tuple[Meeting, Any]:
    """Return the better of two points of a conic, and which rays meet its sheet."""
    xp, start, direction, _, followed = line
    (t1, on1, z1, r1), (t2, on2, z2, r2) = candidates
    if ahead:
        leaving = _leaves(start, curvature, k, aperture)
        nearer = on1 & (abs(t1) <= abs(t2))
        on1, on2 = on1 & (t1 > 0) & ~(leaving & nearer), on2 & (t2 > 0) & ~(leaving & ~nearer)
    order = t1 <= t2 if ahead else abs(z1) <= abs(z2)
    sheet = on1 | on2
    if aperture is not None:
        on1, on2 = on1 & (r1 <= aperture * aperture), on2 & (r2 <= aperture * aperture)
    hit = on1 | on2
    distance = vec.shown(xp.where(on1 & (order | ~on2), t1, t2), hit, followed)
    place = vec.along(start, distance, direction)
    x, y, z = place
    normal = vec.unit((-curvature * x, -curvature * y, 1 - (k * curvature) * z), followed)
    return _met(distance, place, normal, hit, followed), sheet


def _leaves(start, curvature, k, aperture):
    """Say which starts lie on a conic's sheet within rounding."""
    x, y, z = start
    terms = (curvature * (x * x + y * y), (curvature * k) * (z * z), -2 * z)
    # The aperture stands for the length that the start's rounding comes from, which near the vertex is not its own.
    size = sum(abs(term) for term in terms) + (0.0 if aperture is None else 2 * aperture)
    return abs(sum(terms)) <= 16 * epsilon(terms[2]) * size
