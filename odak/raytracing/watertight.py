"""Rays against triangles without gaps at shared edges and corners, on plain arrays of any rank.

Woop, Benthin and Wald, J. Comput. Graph. Tech. 2(1), 65 (2013). Rays are sheared onto the axis along which they run
most, which leaves plane triangles and the origin. What is computed of a corner depends on the ray and the corner alone,
and the area spanned by an edge changes nothing but its sign with the edge's direction: two triangles that share an edge
judge it by the same number. A product of floats never has the wrong order, so a sign is right or the area is exactly
zero; zero counts as inside. So no ray slips through a closed surface.
"""

from odak._array import namespace
from odak.tools.vector import dot


def frame_order(axis):
    """Return which components stand first, second and third when `axis`, ``[...]``, is to be the last: ``[..., 3]``.

    The order is cyclic, so that handedness stays.
    """
    xp = namespace(axis)
    first, second = axis + 1, axis + 2
    return xp.stack((xp.where(first > 2, first - 3, first), xp.where(second > 2, second - 3, second), axis), axis=-1)


def shear_of(direction):
    """Return dx/dz and dy/dz of directions (x, y, z) that run most along z."""
    return direction[0] / direction[2], direction[1] / direction[2]


def sheared(corner, start, shear):
    """Return corners as seen along rays: x, y across the ray and z along it.

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


def edge_areas(a, b, c):
    """Return twice the signed areas that the ray spans with the edges opposite to corners a, b and c.

    Corners are (x, y, …) of :func:`sheared`. Divided by their sum they are the barycentric coordinates.
    """
    return c[0] * b[1] - c[1] * b[0], a[0] * c[1] - a[1] * c[0], b[0] * a[1] - b[1] * a[0]


def encloses(u, v, w):
    """Say whether the ray lies within the triangle or on its rim; a triangle seen edge-on encloses nothing."""
    xp = namespace(u, v, w)
    least, most = xp.minimum(xp.minimum(u, v), w), xp.maximum(xp.maximum(u, v), w)
    # Both hold when all three are zero.
    return (least >= 0) ^ (most <= 0)


def corner_weights(edge1, edge2):
    """Return the weight with which a face counts for the normal of the corner between two of its edges.

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
    return xp.where(exists, 1.0, 0.0) / xp.where(exists, product, 1.0)
