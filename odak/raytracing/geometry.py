"""Vectors and triangles on plain arrays, for every array library.

A missing value is NaN in the result; it is computed from a placeholder, so that no gradient becomes NaN.
"""

import math
from typing import Any

from odak._array import Array, namespace
from odak.tools.transformation import cross, dot, on_same_side


def safe_sqrt(value: Any) -> Any:
    """Return the square root of positive values, 0 with a zero gradient elsewhere."""
    xp = namespace(value)
    positive = value > 0
    return xp.where(positive, xp.sqrt(xp.where(positive, value, 1.0)), 0.0)


def safe_divide(numerator: Array, denominator: Array, where: Array) -> Array:
    """Return numerator/denominator where `where` holds, 0 with zero gradients elsewhere."""
    xp = namespace(numerator, denominator)
    return xp.where(where, numerator, 0.0) / xp.where(where, denominator, 1.0)


def masked(value: Array, where: Array) -> Array:
    """Return `value`, ``[...]`` or ``[..., 3]``, with NaN where `where`, ``[...]``, does not hold."""
    xp = namespace(value)
    return xp.where(where if value.ndim == where.ndim else where[..., None], value, math.nan)


def epsilon(value: Any) -> float:
    """Return the spacing of floats at 1 in the precision of `value`."""
    return float(namespace(value).finfo(value.dtype).eps)


def unit(vector: Any) -> Any:
    """Return vector/|vector|, ``[..., 3]``; NaN for a vector of length zero."""
    xp = namespace(vector)
    squared = dot(vector, vector)
    exists = squared > 0
    return masked(vector / xp.sqrt(xp.where(exists, squared, 1.0))[..., None], exists)


def finite_rays(start: Any, direction: Any) -> Any:
    """Return rays with the ones that hold NaN or infinity replaced by zeros, and which were kept.

    A ray that was lost at an earlier surface must not make the gradients of later surfaces NaN.
    """
    xp = namespace(start, direction)
    kept = xp.isfinite(dot(start, xp.ones_like(start)) + dot(direction, xp.ones_like(direction)))
    return xp.where(kept[..., None], start, 0.0), xp.where(kept[..., None], direction, 0.0), kept


def triangle_normal(triangle: Any) -> Any:
    """Return the unit normal (p1 − p0) × (p2 − p0)/|…| of triangles ``[..., 3, 3]``; NaN for collinear corners."""
    p0, p1, p2 = triangle[..., 0, :], triangle[..., 1, :], triangle[..., 2, :]
    edge1, edge2 = p1 - p0, p2 - p0
    area = cross(edge1, edge2)
    squared = dot(area, area)
    exists = squared > (4 * epsilon(triangle)) ** 2 * dot(edge1, edge1) * dot(edge2, edge2)
    xp = namespace(triangle)
    return masked(area / xp.sqrt(xp.where(exists, squared, 1.0))[..., None], exists)


def barycentric(point: tuple[Array, ...], triangle: Array) -> tuple[Array, ...]:
    """Return (u, v) with point ≈ p0 + u·(p2 − p0) + v·(p1 − p0), by projection; NaN for collinear corners.

    `point` is ``[..., 3]`` or a tuple of its components, `triangle` ``[..., 3, 3]``. Source:
    blackpawn.com/texts/pointinpoly.
    """
    xp = namespace(triangle)
    p0 = triangle[..., 0, :]
    edge2, edge1 = triangle[..., 2, :] - p0, triangle[..., 1, :] - p0
    parts = point if isinstance(point, tuple) else xp.unstack(point, axis=-1)
    x, y, z = (a - b for a, b in zip(parts, xp.unstack(p0, axis=-1), strict=True))
    d02, d12 = (ex * x + ey * y + ez * z for ex, ey, ez in (xp.unstack(e, axis=-1) for e in (edge2, edge1)))
    d00, d01, d11 = dot(edge2, edge2), dot(edge2, edge1), dot(edge1, edge1)
    area = cross(edge1, edge2)
    squared = dot(area, area)
    exists = squared > (4 * epsilon(triangle)) ** 2 * d00 * d11
    # NaN of a triangle propagates to its points: there are fewer triangles than points.
    area2 = xp.where(exists, squared, math.nan)
    return (d11 * d02 - d01 * d12) / area2, (d00 * d12 - d01 * d02) / area2


def is_on_triangle(point: Array, p0: Array, p1: Array, p2: Array) -> Array:
    """Return whether points, projected onto a triangle, lie within it or on its edges: same-side test of all edges."""
    return on_same_side(point, p0, p1, p2) & on_same_side(point, p1, p0, p2) & on_same_side(point, p2, p0, p1)


def nearest_on_lines(start0: Array, direction0: Array, start1: Array, direction1: Array) -> tuple[Array, ...]:
    """Return the parameters of the nearest points of two lines, in units of the lengths of the directions, ``[...]``.

    For parallel lines the first is 0 and the second belongs to the foot of the perpendicular from `start0`.
    """
    n = cross(direction0, direction1)
    squared = dot(n, n)
    length0, length1 = dot(direction0, direction0), dot(direction1, direction1)
    # NaN in the lines gives NaN in the result.
    crossing = ~(squared <= (4 * epsilon(start0)) ** 2 * length0 * length1)
    gap = start1 - start0
    t0 = safe_divide(dot(cross(gap, direction1), n), squared, crossing)
    t1 = safe_divide(dot(cross(gap, direction0), n), squared, crossing)
    foot = safe_divide(-dot(gap, direction1), length1, length1 > 0)
    return t0, namespace(t1).where(crossing, t1, foot)


def crossing_of_lines(start0: Array, direction0: Array, start1: Array, direction1: Array) -> tuple[Array, ...]:
    """Return the parameters of the intersection of two lines ``[..., 3]``, and whether they intersect, all ``[...]``.

    Lines cross unless they are parallel, or pass each other by more than 1e-5 of the distance between their starts plus
    1e-8 plus the rounding error: directions are often given to seven digits.
    """
    xp = namespace(start0, start1)
    t0, t1 = nearest_on_lines(start0, direction0, start1, direction1)
    gap = start0 + t0[..., None] * direction0 - start1 - t1[..., None] * direction1
    apart = xp.max(xp.abs(start0 - start1), axis=-1)
    allowed = 1e-8 + 1e-5 * apart + 4 * epsilon(start0) * (1 + xp.abs(t0) + xp.abs(t1) + apart)
    n = cross(direction0, direction1)
    parallel = dot(n, n) <= (4 * epsilon(start0)) ** 2 * dot(direction0, direction0) * dot(direction1, direction1)
    return t0, t1, ~(parallel | (xp.max(xp.abs(gap), axis=-1) > allowed))


# Rays against triangles without gaps at shared edges and corners: Woop, Benthin and Wald, J. Comput. Graph. Tech. 2(1),
# 65 (2013). Rays are sheared onto the axis of their largest component, which keeps triangles plane and the origin in
# place. The values of a corner depend on the ray and the corner alone, and the area spanned by an edge only changes its
# sign with the edge's direction: two triangles that share an edge test it by the same number. A sign is correct or the
# area is exactly zero, which counts as inside, so that no ray passes through a closed surface.


def shear_of(direction: Any) -> Any:
    """Return dx/dz and dy/dz of directions (x, y, z) whose largest component is z."""
    return direction[0] / direction[2], direction[1] / direction[2]


def sheared(corner: Any, start: Any, shear: Any) -> Any:
    """Return corners in the sheared frame of rays: x, y across the ray and z along it.

    Parameters
    ----------
    corner, start : tuple of arrays
        Components (x, y, z), z along the dominant axis, each ``[...]`` and broadcastable.
    shear : tuple of arrays
        From :func:`shear_of`.

    Returns
    -------
    tuple of arrays
        x, y and z; the ray is the line x = y = 0.
    """
    x, y, z = (c - s for c, s in zip(corner, start, strict=True))
    return x - shear[0] * z, y - shear[1] * z, z


def edge_areas(a: Any, b: Any, c: Any) -> Any:
    """Return twice the signed areas that the ray spans with the edges opposite to corners a, b and c.

    Corners are (x, y, …) of :func:`sheared`. Divided by their sum they are the barycentric coordinates.
    """
    return c[0] * b[1] - c[1] * b[0], a[0] * c[1] - a[1] * c[0], b[0] * a[1] - b[1] * a[0]


def encloses(u: Any, v: Any, w: Any) -> Any:
    """Return whether the ray lies within the triangle or on its edges; false for a triangle parallel to the ray."""
    xp = namespace(u, v, w)
    least, most = xp.minimum(xp.minimum(u, v), w), xp.maximum(xp.maximum(u, v), w)
    # Both hold when all three are zero.
    return (least >= 0) ^ (most <= 0)


def corner_weights(edge1: Any, edge2: Any) -> Any:
    """Return the weight of a face in the normal of the corner between two of its edges.

    Parameters
    ----------
    edge1, edge2 : array
        Edges from the corner, ``[..., 3]``.

    Returns
    -------
    array
        1/(|edge1|²·|edge2|²), ``[...]``, for normals edge1 × edge2 of full length; 0 where an edge has no length.

    Notes
    -----
    Max, J. Graphics Tools 4(2), 1 (1999): exact for corners that lie on a sphere with all their neighbours.
    """
    xp = namespace(edge1, edge2)
    product = dot(edge1, edge1) * dot(edge2, edge2)
    exists = product > 0
    return xp.where(exists, 1 / xp.where(exists, product, 1.0), 0.0)
