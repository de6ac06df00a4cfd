"""Products, sides and distances of points and lines in space."""

import numpy as np

from odak import _validate
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
    """Say whether p1 and p2 lie on the same side of the line ab, for any array library; the line is on both sides."""
    return dot(cross(b - a, p1 - a), cross(b - a, p2 - a)) >= 0


def cross_product(vector1: Array, vector2: Array) -> np.ndarray:
    """Return the vector product of two rays' directions as a ray that starts where the first does.

    Parameters
    ----------
    vector1, vector2 : array
        Rays ``[2, 3]``: start and direction.

    Returns
    -------
    numpy.ndarray
        float32 ``[2, 3]``: ``vector1[0]`` and ``vector1[1] × vector2[1]``.

    Examples
    --------
    >>> from odak.tools import cross_product
    >>> cross_product([[1, 2, 3], [1, 0, 0]], [[0, 0, 0], [0, 1, 0]])
    array([[1., 2., 3.],
           [0., 0., 1.]], dtype=float32)
    """
    first, second = _ray("vector1", vector1), _ray("vector2", vector2)
    return np.stack((first[0], cross(first[1], second[1]))).astype(np.float32)


def same_side(p1: Array, p2: Array, a: Array, b: Array) -> bool | np.ndarray:
    """Say whether p1 and p2 lie on the same side of the line through a and b.

    Parameters
    ----------
    p1, p2, a, b : array
        Points ``[3]``; `p1` may be ``[n, 3]``.

    Returns
    -------
    bool or numpy.ndarray
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
    result = on_same_side(*_fitting_points(p1=p1, p2=p2, a=a, b=b))
    return bool(result) if result.ndim == 0 else result


def distance_between_point_clouds(points0: Array, points1: Array) -> np.ndarray:
    """Return the distance of every point of one cloud to every point of another.

    Parameters
    ----------
    points0, points1 : array
        ``[m, 3]`` and ``[n, 3]``.

    Returns
    -------
    numpy.ndarray
        ``[m, n]``.

    Examples
    --------
    >>> from odak.tools import distance_between_point_clouds
    >>> distance_between_point_clouds([[0, 0, 0]], [[3, 4, 0], [0, 0, 2]])
    array([[5., 2.]])
    """
    points0, points1 = _points("points0", points0).reshape(-1, 3), _points("points1", points1).reshape(-1, 3)
    # One coordinate after the other: an [m, n, 3] array of differences is never held.
    return np.sqrt(sum((points0[:, None, i] - points1[None, :, i]) ** 2 for i in range(3)))


def distance_between_two_points(point1: Array, point2: Array) -> np.floating | np.ndarray:
    """Return the distance between points.

    Parameters
    ----------
    point1, point2 : array
        ``[3]`` or ``[n, 3]`` each.

    Returns
    -------
    numpy.float64 or numpy.ndarray
        A scalar for two points ``[3]``, else ``[n]``.

    Examples
    --------
    >>> from odak.tools import distance_between_two_points
    >>> float(distance_between_two_points([0, 0, 0], [3, 4, 12]))
    13.0
    """
    point1, point2 = _fitting_points(point1=point1, point2=point2)
    difference = point1 - point2
    return np.sqrt(dot(difference, difference))


def closest_point_to_a_ray(point: Array, ray: Array) -> np.ndarray:
    """Return the point of a line that is nearest to a given point.

    Parameters
    ----------
    point : array
        ``[3]`` or ``[n, 3]``.
    ray : array
        ``[2, 3]`` or ``[1, 2, 3]``: start and direction, which need not be a unit vector.

    Returns
    -------
    numpy.ndarray
        ``[3]`` or ``[n, 3]``: start + d·((point − start)·d)/|d|².

    Examples
    --------
    >>> from odak.tools import closest_point_to_a_ray
    >>> closest_point_to_a_ray([1, 2, 3], [[0, 0, 0], [0, 0, 2]])
    array([0., 0., 3.])
    """
    start, direction = _ray("ray", ray)
    along = dot(_points("point", point) - start, direction) / dot(direction, direction)
    return start + along[..., None] * direction


def point_to_ray_distance(point: Array, ray_point_0: Array, ray_point_1: Array) -> np.floating | np.ndarray:
    """Return the distance of a point to the line through two points.

    Parameters
    ----------
    point, ray_point_0, ray_point_1 : array
        ``[3]`` or ``[n, 3]`` each.

    Returns
    -------
    numpy.float64 or numpy.ndarray
        |(p − p0) × (p − p1)|/|p1 − p0|, a scalar or ``[n]``.

    Examples
    --------
    >>> from odak.tools import point_to_ray_distance
    >>> float(point_to_ray_distance([0, 2, 5], [0, 0, 0], [0, 0, 1]))
    2.0
    """
    point, p0, p1 = _fitting_points(point=point, ray_point_0=ray_point_0, ray_point_1=ray_point_1)
    area = cross(point - p0, point - p1)
    return np.sqrt(dot(area, area) / dot(p1 - p0, p1 - p0))


def _points(name: str, value) -> np.ndarray:
    value = np.asarray(value)
    if value.dtype.kind not in "iuf":
        raise TypeError(f"{name} must be real numbers, got {value.dtype}")
    if value.ndim == 0 or value.shape[-1] != 3:
        raise ValueError(f"{name} must be [3] or [n, 3], got {value.shape}")
    return value if value.dtype == np.float32 else value.astype(np.float64)


def _fitting_points(**values) -> list[np.ndarray]:
    points = {name: _points(name, value) for name, value in values.items()}
    _validate.fitting(**points)
    return list(points.values())


def _ray(name: str, value) -> np.ndarray:
    value = _points(name, value)
    if value.size != 6:
        raise ValueError(f"{name} must be one ray [2, 3], got {value.shape}")
    return value.reshape(2, 3)
