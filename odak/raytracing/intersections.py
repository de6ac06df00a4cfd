"""Intersections of rays with planes, triangles, discs, spheres, cylinders and conics, on plain arrays of any rank.

Starts and directions are ``[..., 3]`` and broadcast against the surfaces' arrays, so that rays ``[m, 1, 3]`` and
surfaces ``[n, 3]`` give ``[m, n]``. Directions need not be unit vectors: a distance counts lengths of the direction.
Every result is a :class:`Hit`. A ray without an intersection has NaN distance, point and normal, and zero gradients.

The formulas are implemented in :mod:`odak.raytracing.closed_forms`. Large batches are evaluated piece by piece, unless
derivatives are recorded.
"""

from enum import IntEnum
from typing import Any, NamedTuple

from odak._array import namespace
from odak.raytracing import closed_forms
from odak.raytracing.batches import in_pieces
from odak.raytracing.components import join
from odak.raytracing.geometry import barycentric


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
    def hit(self):
        """Rays that intersect the surface, bool ``[...]``."""
        return self.status == int(RayStatus.HIT)


def status_array(hit, otherwise: RayStatus = RayStatus.MISS):
    """Return int8 statuses: HIT where `hit` holds, `otherwise` elsewhere."""
    missed = namespace(hit).astype(~hit, namespace(hit).int8)
    return missed if int(otherwise) == 1 else missed * int(otherwise)


def plane(start, direction, point, normal) -> Hit:
    """Intersect rays with planes through `point` with `normal`; the distance is signed, negative behind the start.

    A ray parallel to the plane within two units of rounding is a miss. The normal is returned as given.
    """
    return in_pieces(lambda *a: as_hit(closed_forms.plane(*a)), (1, 1, 1, 1), start, direction, point, normal)


def triangle(start, direction, corners) -> Hit:
    """Intersect rays with triangles ``[..., 3, 3]`` on either side.

    The edges p0p1 and p0p2 belong to a triangle, p1p2 does not. Hits behind the start count: the distance is signed. A
    ray that misses the triangle has the normal of its plane.
    """
    return in_pieces(lambda *a: as_hit(closed_forms.triangle(*a)), (1, 1, 2), start, direction, corners)


def within(point, known, corners):
    """Return whether the points that are `known` lie on triangles: u ≥ 0, v ≥ 0, u + v < 1."""

    def inside(point, known, corners):
        place = namespace(point).where(known[..., None], point, 0.0)
        return known & closed_forms.encloses(*barycentric(place, corners))

    return in_pieces(inside, (1, 0, 2), point, known, corners)


def disc(start, direction, point, normal, centre, radius) -> Hit:
    """Intersect rays with a plane within `radius` of `centre`; other rays miss. The distance is signed."""
    ranks, arrays = (1, 1, 1, 1, 1, 0), (start, direction, point, normal, centre, radius)
    return in_pieces(lambda *a: as_hit(closed_forms.disc(*a)), ranks, *arrays)


def sphere(start, direction, centre, radius) -> Hit:
    """Intersect rays with spheres at the nearest point ahead, the exit for a start inside; outward normals.

    Notes
    -----
    The discriminant is r² − |f − (f·d)d|², f = start − centre, which is accurate for distant starts (Haines, Günther
    and Akenine-Möller, Ray Tracing Gems (2019), chapter 7). A start that lies on the sphere within rounding is not a
    hit.
    """
    return in_pieces(lambda *a: as_hit(closed_forms.sphere(*a)), (1, 1, 1, 0), start, direction, centre, radius)


def cylinder(start, direction, centre, radius, axis) -> Hit:
    """Intersect rays with infinite cylinders about lines through `centre` along `axis`; outward normals.

    The nearest point ahead counts.

    A ray along the axis misses.
    """
    ranks, arrays = (1, 1, 1, 0, 1), (start, direction, centre, radius, axis)
    return in_pieces(lambda *a: as_hit(closed_forms.cylinder(*a)), ranks, *arrays)


def conic(start, direction, curvature, constant, aperture=None, ahead=True) -> Hit:
    """Intersect rays with the sheet of a conic of revolution that passes through the origin with its axis along z.

    Parameters
    ----------
    start, direction : array
        ``[..., 3]``.
    curvature, constant : array
        Curvature at the vertex and conic constant: c(x² + y² + (1 + k)z²) = 2z.
    aperture : array, optional
        Distance from the axis beyond which the surface ends.
    ahead : bool
        Take the nearest point ahead of the start; otherwise, ahead or behind, the one nearest to the vertex plane.

    Returns
    -------
    Hit
        Normals point to +z. A ray that intersects the sheet only beyond the aperture is VIGNETTED. A start within
        rounding of the sheet, measured by its coordinates and the aperture, is not a hit.
    """

    def closed_form(start, direction, curvature, constant, aperture):
        select = "ahead" if ahead else "vertex"
        found, sheet = closed_forms.conic(start, direction, curvature, constant, aperture, select)
        return as_hit(found, conic_status(found, sheet))

    return in_pieces(closed_form, (1, 1, 0, 0, 0), start, direction, curvature, constant, aperture)


def conic_status(found: closed_forms.Intersection, sheet):
    """Return statuses of :func:`odak.raytracing.closed_forms.conic`: VIGNETTED on the sheet beyond the aperture."""
    status = status_array(found.hit)
    beyond = int(RayStatus.VIGNETTED) - int(RayStatus.MISS)
    return status + namespace(sheet).astype(sheet & ~found.hit, status.dtype) * beyond


def as_hit(found: closed_forms.Intersection, status=None) -> Hit:
    """Return a :class:`Hit` with the components of its vectors joined."""
    distance, point, normal, hit = found
    point, normal = join(point), join(normal)
    if normal.shape != point.shape:
        normal = namespace(point).broadcast_to(normal, point.shape)
    return Hit(distance, point, normal, status_array(hit) if status is None else status)
