"""Products, sides and distances of points and lines in space."""

import math
from typing import Any

from odak import _array, _validate
from odak._array import Array, namespace


def dot(a, b):
    """Return the scalar product over the last axis, ``[...]``, for any array library."""
    xp = namespace(a, b)
    (ax, ay, az), (bx, by, bz) = xp.unstack(a, axis=-1), xp.unstack(b, axis=-1)
    return ax * bx + ay * by + az * bz


def cross(a, b):
    """Return the vector product over the last axis, ``[..., 3]``, for any array library."""
    xp = namespace(a, b)
    (ax, ay, az), (bx, by, bz) = xp.unstack(a, axis=-1), xp.unstack(b, axis=-1)
    return xp.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), axis=-1)


def on_same_side(p1, p2, a, b):
    """Return whether p1 and p2 lie on the same side of the line ab, for any library; the line is on both sides."""
    return dot(cross(b - a, p1 - a), cross(b - a, p2 - a)) >= 0


def cross_product(vector1: Array, vector2: Array) -> Array:
    """Return the vector product of two rays' directions as a ray that starts where the first does.

    Parameters
    ----------
    vector1 : array
        First ray, start and direction: ``[2, 3]`` or ``[m, 2, 3]``.
    vector2 : array
        Second ray, ``[2, 3]`` or ``[m, 2, 3]``.

    Returns
    -------
    array
        ``[2, 3]`` or ``[m, 2, 3]``: the first start and ``vector1[1] × vector2[1]``. From NumPy in float32.

    Examples
    --------
    >>> from odak.tools import cross_product
    >>> cross_product([[1, 2, 3], [1, 0, 0]], [[0, 0, 0], [0, 1, 0]]).tolist()
    [[1.0, 2.0, 3.0], [0.0, 0.0, 1.0]]
    """
    xp, rays = _points(vector1=vector1, vector2=vector2)
    for name, ray in rays.items():
        _validate.shaped(name, ray, ..., 2, 3)
    first, second = xp.broadcast_arrays(*rays.values())
    product = xp.stack((first[..., 0, :], cross(first[..., 1, :], second[..., 1, :])), axis=-2)
    return xp.astype(product, xp.float32) if xp is _array.numpy_namespace else product


def same_side(p1: Array, p2: Array, a: Array, b: Array) -> Any:
    """Return whether p1 and p2 lie on the same side of the line through a and b.

    Parameters
    ----------
    p1 : array
        Points ``[3]`` or ``[n, 3]``.
    p2 : array
        Point to compare with, ``[3]``.
    a : array
        Point of the line, ``[3]``.
    b : array
        Another point of the line, ``[3]``.

    Returns
    -------
    bool or array
        One bool, or ``[n]`` of them. A point on the line is on both sides.

    Notes
    -----
    ((b − a) × (p1 − a)) · ((b − a) × (p2 − a)) ≥ 0.

    Examples
    --------
    >>> from odak.tools import same_side
    >>> same_side([0, 1, 0], [5, 2, 0], [0, 0, 0], [1, 0, 0])
    True
    """
    _, points = _points(p1=p1, p2=p2, a=a, b=b)
    result = on_same_side(**points)
    return bool(result) if result.ndim == 0 else result


def distance_between_point_clouds(points0: Array, points1: Array) -> Array:
    """Return the distance of every point of one cloud to every point of another.

    Parameters
    ----------
    points0 : array
        First cloud, ``[m, 3]``.
    points1 : array
        Second cloud, ``[n, 3]``.

    Returns
    -------
    array
        ``[m, n]``.

    Examples
    --------
    >>> from odak.tools import distance_between_point_clouds
    >>> distance_between_point_clouds([[0, 0, 0]], [[3, 4, 0], [0, 0, 2]])
    array([[5., 2.]])
    """
    xp, first = _points(points0=points0)
    _, second = _points(points1=points1)
    first, second = (xp.reshape(points, (-1, 3)) for points in (first["points0"], second["points1"]))
    # One coordinate after the other, so that no [m, n, 3] array of differences is stored.
    return xp.sqrt(sum((first[:, None, i] - second[None, :, i]) ** 2 for i in range(3)))


def distance_between_two_points(point1: Array, point2: Array) -> Array:
    """Return the distance between points.

    Parameters
    ----------
    point1 : array
        First points, ``[3]`` or ``[n, 3]``.
    point2 : array
        Second points, ``[3]`` or ``[n, 3]``.

    Returns
    -------
    array
        A scalar for two points ``[3]``, else ``[n]``. Where two points coincide its gradient is 0.

    Examples
    --------
    >>> from odak.tools import distance_between_two_points
    >>> float(distance_between_two_points([0, 0, 0], [3, 4, 12]))
    13.0
    """
    xp, points = _points(point1=point1, point2=point2)
    return xp.linalg.vector_norm(points["point1"] - points["point2"], axis=-1)


def closest_point_to_a_ray(point: Array, ray: Array) -> Array:
    """Return the point of a line that is nearest to a given point.

    Parameters
    ----------
    point : array
        ``[3]`` or ``[n, 3]``.
    ray : array
        ``[2, 3]`` or ``[1, 2, 3]``: start and direction, which need not be a unit vector.

    Returns
    -------
    array
        ``[3]`` or ``[n, 3]``: start + d·((point − start)·d)/|d|².

    Examples
    --------
    >>> from odak.tools import closest_point_to_a_ray
    >>> closest_point_to_a_ray([1, 2, 3], [[0, 0, 0], [0, 0, 2]])
    array([0., 0., 3.])
    """
    xp, given = _points(point=point, ray=ray)
    if math.prod(given["ray"].shape) != 6:
        raise ValueError(f"ray must be one ray [2, 3], got {tuple(given['ray'].shape)}")
    start, direction = xp.unstack(xp.reshape(given["ray"], (2, 3)), axis=0)
    along = xp.vecdot(given["point"] - start, direction) / xp.vecdot(direction, direction)
    return start + along[..., None] * direction


def point_to_ray_distance(point: Array, ray_point_0: Array, ray_point_1: Array) -> Array:
    """Return the distance of a point to the line through two points.

    Parameters
    ----------
    point : array
        ``[3]`` or ``[n, 3]``.
    ray_point_0 : array
        Point of the line, ``[3]`` or ``[n, 3]``.
    ray_point_1 : array
        Another point of the line, ``[3]`` or ``[n, 3]``.

    Returns
    -------
    array
        |(p − p0) × (p − p1)|/|p1 − p0|, a scalar or ``[n]``.

    Examples
    --------
    >>> from odak.tools import point_to_ray_distance
    >>> float(point_to_ray_distance([0, 2, 5], [0, 0, 0], [0, 0, 1]))
    2.0
    """
    xp, points = _points(point=point, ray_point_0=ray_point_0, ray_point_1=ray_point_1)
    point, p0, p1 = points.values()
    area = cross(point - p0, point - p1)
    return xp.sqrt(dot(area, area) / dot(p1 - p0, p1 - p0))


def _points(**values):
    """Return the namespace of points and the points ``[..., 3]``, which fit each other, in one precision."""
    points = dict(zip(values, _validate.reals(**values), strict=True))
    for name, point in points.items():
        _validate.shaped(name, point, ..., 3)
    if "ray" not in points:
        _validate.fitting(**points)
    return namespace(*points.values()), points
