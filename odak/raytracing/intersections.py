"""Where rays meet planes, triangles, discs, spheres and cylinders: closed forms on plain arrays of any rank.

Starts and directions are ``[..., 3]`` and broadcast against the surfaces' arrays, so that rays ``[m, 1, 3]`` and
surfaces ``[n, 3]`` give ``[m, n]``. Directions need not be unit vectors: a distance counts lengths of the direction.
Every result is a :class:`Hit`. A ray that meets nothing has NaN distance, point and normal, and zero gradients.
"""

from typing import Any, NamedTuple

from odak._array import namespace
from odak.raytracing.geometry import (
    barycentric,
    dot,
    epsilon,
    finite_rays,
    masked,
    safe_divide,
    safe_sqrt,
    triangle_normal,
    unit,
)
from odak.raytracing.status import RayStatus


class Hit(NamedTuple):
    """Where rays meet a surface.

    Attributes
    ----------
    distance : array
        ``[...]``, in lengths of the direction; NaN unless hit.
    point : array
        ``[..., 3]``; NaN unless hit.
    normal : array
        Unit normal ``[..., 3]``; NaN unless hit (planes keep theirs).
    status : array
        :class:`odak.raytracing.RayStatus` as int8, ``[...]``.
    """

    distance: Any
    point: Any
    normal: Any
    status: Any

    @property
    def hit(self):
        """Which rays hit, bool ``[...]``."""
        return self.status == int(RayStatus.HIT)


def status_array(hit, otherwise: RayStatus = RayStatus.MISS):
    """Return int8 statuses: HIT where `hit` holds, `otherwise` elsewhere."""
    xp = namespace(hit)
    return xp.astype(~hit, xp.int8) * int(otherwise)


def plane(start, direction, point, normal) -> Hit:
    """Meet planes through `point` with `normal`; the distance is signed, negative behind the start.

    A ray parallel to the plane within two units of rounding is a miss. The normal is returned as given.
    """
    xp = namespace(start, direction)
    start, direction, kept = finite_rays(start, direction)
    # A degenerate triangle's normal is NaN: a null vector makes it parallel to everything.
    real_normal = xp.where(xp.isfinite(normal), normal, 0.0)
    slope = dot(real_normal, direction)
    limit = (2 * epsilon(start)) ** 2 * dot(real_normal, real_normal) * dot(direction, direction)
    hit = kept & (slope * slope > limit)
    distance = safe_divide(dot(real_normal, point - start), slope, hit)
    place = start + distance[..., None] * direction
    return Hit(masked(distance, hit), masked(place, hit), xp.broadcast_to(normal, place.shape), status_array(hit))


def triangle(start, direction, corners) -> Hit:
    """Meet triangles ``[..., 3, 3]`` on either side; rims p0p1 and p0p2 belong to them, p1p2 does not.

    Hits behind the start count: the distance is signed.
    """
    flat = plane(start, direction, corners[..., 0, :], triangle_normal(corners))
    inside = flat.hit & within(flat.point, flat.hit, corners)
    return Hit(masked(flat.distance, inside), masked(flat.point, inside), flat.normal, status_array(inside))


def within(point, known, corners):
    """Say whether the points that are `known` lie on triangles: u ≥ 0, v ≥ 0, u + v < 1."""
    xp = namespace(point)
    u, v = barycentric(xp.where(known[..., None], point, 0.0), corners)
    return known & (u >= 0) & (v >= 0) & (u + v < 1)


def disc(start, direction, point, normal, centre, radius) -> Hit:
    """Meet a plane within `radius` of `centre`; the rest misses. The distance is signed."""
    xp = namespace(start, direction)
    flat = plane(start, direction, point, normal)
    arm = xp.where(flat.hit[..., None], flat.point, 0.0) - centre
    inside = flat.hit & (dot(arm, arm) <= radius * radius)
    return Hit(masked(flat.distance, inside), masked(flat.point, inside), flat.normal, status_array(inside))


def sphere(start, direction, centre, radius) -> Hit:
    """Meet spheres: the nearest point ahead of the start, the exit when it starts inside; outward normals.

    Notes
    -----
    The discriminant is r² − |f − (f·d)d|², f = start − centre, which keeps its digits far away (Haines, Günther and
    Akenine-Möller, Ray Tracing Gems (2019), chapter 7). A start that lies on the sphere within rounding is not a hit.
    """
    start, direction, kept = finite_rays(start, direction)
    arm = start - centre
    squared = dot(direction, direction)
    along = dot(arm, direction)
    moving = kept & (squared > 0)
    distance, hit = nearest_ahead(
        squared, along, arm, direction, radius, moving, epsilon(start) * dot(centre, centre) ** 0.5
    )
    place = start + distance[..., None] * direction
    normal = unit(namespace(place).where(hit[..., None], place - centre, 1.0))
    return Hit(masked(distance, hit), masked(place, hit), masked(normal, hit), status_array(hit))


def cylinder(start, direction, centre, radius, axis) -> Hit:
    """Meet infinite cylinders about the line through `centre` along `axis`: nearest point ahead; outward normals.

    A ray along the axis misses.
    """
    start, direction, kept = finite_rays(start, direction)
    axis = unit(axis)
    arm, across = _reject(start - centre, axis), _reject(direction, axis)
    squared = dot(across, across)
    moving = kept & (squared > (4 * epsilon(start)) ** 2 * dot(direction, direction))
    distance, hit = nearest_ahead(
        squared, dot(arm, across), arm, across, radius, moving, epsilon(start) * dot(centre, centre) ** 0.5
    )
    place = start + distance[..., None] * direction
    normal = unit(namespace(place).where(hit[..., None], _reject(place - centre, axis), 1.0))
    return Hit(masked(distance, hit), masked(place, hit), masked(normal, hit), status_array(hit))


def conic(start, direction, curvature, constant, aperture=None, ahead=True) -> Hit:
    """Meet the sheet of a conic of revolution that passes through the origin with its axis along z.

    Parameters
    ----------
    start, direction : array
        ``[..., 3]``.
    curvature, constant : array
        Curvature at the vertex and conic constant: c(x² + y² + (1 + k)z²) = 2z.
    aperture : array, optional
        Distance from the axis beyond which the surface ends.
    ahead : bool
        Take the nearest point ahead of the start; else, ahead or behind, the one nearest the vertex plane.

    Returns
    -------
    Hit
        Normals point to +z. A ray that meets the sheet only beyond the aperture is VIGNETTED. A start within rounding
        of the sheet, measured by its coordinates and the aperture, is not a hit.
    """
    xp = namespace(start, direction)
    start, direction, kept = finite_rays(start, direction)
    moving = kept & (dot(direction, direction) > 0)
    k = 1 + constant
    # From the point nearest the vertex, so that a far start costs no digits.
    offset = safe_divide(-dot(start, direction), dot(direction, direction), moving)
    x, y, z = xp.unstack(start + offset[..., None] * direction, axis=-1)
    dx, dy, dz = xp.unstack(direction, axis=-1)
    a = curvature * (dx * dx + dy * dy + k * dz * dz)
    b = curvature * (x * dx + y * dy + k * z * dz) - dz
    c = curvature * (x * x + y * y + k * z * z) - 2 * z
    discriminant = b * b - a * c
    root = safe_sqrt(discriminant)
    q = -(b + xp.where(b < 0, -root, root))
    candidates = []
    for t, exists in ((safe_divide(q, a, a != 0), a != 0), (safe_divide(c, q, q != 0), q != 0)):
        height = z + t * dz
        on_sheet = moving & exists & (discriminant >= 0) & (1 - k * curvature * height > 0)
        candidates.append((t + offset, on_sheet, height, (x + t * dx) ** 2 + (y + t * dy) ** 2))
    return _choose(start, direction, candidates, curvature, k, aperture, ahead)


def _choose(start, direction, candidates, curvature, k, aperture, ahead) -> Hit:
    """Return the better of two points of a conic."""
    xp = namespace(start)
    (t1, on1, z1, r1), (t2, on2, z2, r2) = candidates
    if ahead:
        x, y, z = xp.unstack(start, axis=-1)
        terms = (curvature * (x * x + y * y), curvature * k * z * z, -2 * z)
        # The aperture stands for the length that the start's rounding comes from, which near the vertex is not its own.
        size = sum(abs(term) for term in terms) + (0.0 if aperture is None else 2 * aperture)
        leaving = abs(sum(terms)) <= 16 * epsilon(start) * size
        nearer = abs(t1) <= abs(t2)
        on1, on2 = on1 & (t1 > 0) & ~(leaving & nearer), on2 & (t2 > 0) & ~(leaving & ~nearer)
    order = t1 <= t2 if ahead else abs(z1) <= abs(z2)
    sheet = on1 | on2
    if aperture is not None:
        on1, on2 = on1 & (r1 <= aperture * aperture), on2 & (r2 <= aperture * aperture)
    hit = on1 | on2
    distance = xp.where(hit, xp.where(on1 & (order | ~on2), t1, t2), 0.0)
    place = start + distance[..., None] * direction
    x, y, z = xp.unstack(place, axis=-1)
    normal = xp.stack(xp.broadcast_arrays(-curvature * x, -curvature * y, 1 - curvature * k * z), axis=-1)
    normal = unit(xp.where(hit[..., None], normal, 1.0))
    status = xp.where(sheet, status_array(hit, RayStatus.VIGNETTED), status_array(hit))
    return Hit(masked(distance, hit), masked(place, hit), masked(normal, hit), status)


def _reject(vector, axis):
    """Return the part of a vector that is perpendicular to a unit axis."""
    return vector - dot(vector, axis)[..., None] * axis


def nearest_ahead(squared, along, arm, direction, radius, moving, offset_error):
    """Return the nearest positive t with |arm + t·direction| = radius, and whether there is one.

    Parameters
    ----------
    squared, along : array
        direction·direction and arm·direction.
    arm, direction : array
        ``[..., 3]``.
    radius : array
        Radius.
    moving : array
        Rays to consider; the others miss.
    offset_error : array
        Rounding error of the arm that comes from coordinates far from the origin.

    Notes
    -----
    A start within a few roundings of the surface is taken as on it: its root there is exactly 0 and not ahead, so
    that a reflected or refracted ray does not meet again the surface it leaves.
    """
    xp = namespace(arm, direction)
    foot = arm - safe_divide(along, squared, moving)[..., None] * direction
    discriminant = squared * (radius * radius - dot(foot, foot))
    inward = dot(arm, arm)
    reach = inward**0.5 + abs(radius)
    height = inward - radius * radius
    height = xp.where(abs(height) <= 8 * reach * (epsilon(arm) * reach + offset_error), 0.0, height)
    root = safe_sqrt(discriminant)
    # The root of larger magnitude has no cancellation; the other one follows from their product.
    q = -(along + xp.where(along < 0, -root, root))
    first = safe_divide(q, squared, moving)
    second = safe_divide(height, q, q != 0)
    near, far = xp.minimum(first, second), xp.maximum(first, second)
    distance = xp.where(near > 0, near, far)
    hit = moving & (discriminant >= 0) & (distance > 0)
    return xp.where(hit, distance, 0.0), hit
