"""Rays as ``[2, 3]`` arrays (start, direction cosines) and batches of them, ``[m, 2, 3]``."""

from collections.abc import Sequence

import numpy as np

from odak import _validate
from odak._array import Array
from odak.raytracing import arguments, geometry
from odak.tools.transformation import rotation_matrix


def create_ray(x0y0z0: Array, abg: Array) -> np.ndarray:
    """Return the ray from a point with given angles to the three axes.

    Parameters
    ----------
    x0y0z0 : array
        Start, ``[3]`` or ``[m, 3]``.
    abg : array
        Angles to the x, y and z axes in degrees, ``[3]`` or ``[m, 3]``. Their cosines are taken as they are: the sum
        of their squares should be 1.

    Returns
    -------
    numpy.ndarray
        ``[2, 3]``, or ``[m, 2, 3]``.

    Raises
    ------
    ValueError
        If an argument does not hold three numbers per row.

    Examples
    --------
    >>> from odak.raytracing import create_ray
    >>> create_ray([1, 2, 3], [90, 60, 30]).round(4)
    array([[1.   , 2.   , 3.   ],
           [0.   , 0.5  , 0.866]])
    """
    cosines = np.cos(np.deg2rad(arguments.points("abg", abg)))
    start = arguments.points("x0y0z0", x0y0z0)
    _validate.fitting(x0y0z0=start, abg=cosines)
    return arguments.as_rays(start, cosines)


def create_ray_from_two_points(x0y0z0: Array, x1y1z1: Array) -> np.ndarray:
    """Return rays that start at the first points and head to the second ones.

    Parameters
    ----------
    x0y0z0, x1y1z1 : array
        Starts and ends, ``[3]`` or ``[m, 3]``; one of either serves many of the other.

    Returns
    -------
    numpy.ndarray
        ``[2, 3]`` for one ray, else ``[m, 2, 3]``. Unit direction cosines, NaN where start and end coincide.

    Examples
    --------
    >>> from odak.raytracing import create_ray_from_two_points
    >>> create_ray_from_two_points([0, 0, 0], [0, 3, 4])
    array([[0. , 0. , 0. ],
           [0. , 0.6, 0.8]])
    """
    start = arguments.batch(arguments.points("x0y0z0", x0y0z0), 1)
    end = arguments.batch(arguments.points("x1y1z1", x1y1z1), 1)
    _validate.fitting(x0y0z0=start, x1y1z1=end)
    return arguments.single(arguments.as_rays(start, geometry.unit(end - start)))


def create_ray_from_angles(point: Array, angles: Sequence[float], mode: str = "XYZ") -> np.ndarray:
    """Return the ray from a point along the rotated z axis.

    Parameters
    ----------
    point : array
        Start, ``[3]`` or ``[m, 3]``.
    angles : sequence of float
        Degrees about X, Y and Z; zero angles point along +z.
    mode : str
        Order of the rotations, as in :func:`odak.tools.rotate_point`.

    Returns
    -------
    numpy.ndarray
        ``[2, 3]`` or ``[m, 2, 3]``.

    Examples
    --------
    >>> from odak.raytracing import create_ray_from_angles
    >>> create_ray_from_angles([1, 2, 3], [0, 90, 0]).round(12)
    array([[1., 2., 3.],
           [1., 0., 0.]])
    """
    point = arguments.batch(arguments.points("point", point), 1)
    direction = rotation_matrix(arguments.finite_points("angles", angles), mode)[..., 2]
    return arguments.single(arguments.as_rays(point, direction.astype(point.dtype)))


def create_ray_from_all_pairs(x0y0z0: Array, x1y1z1: Array) -> np.ndarray:
    """Return a ray from each of the first points to each of the second ones.

    Parameters
    ----------
    x0y0z0, x1y1z1 : array
        Starts ``[m, 3]`` and ends ``[n, 3]``.

    Returns
    -------
    numpy.ndarray
        ``[m·n, 2, 3]``; ray i·n + j goes from start i to end j. NaN cosines where the two coincide.

    Examples
    --------
    >>> from odak.raytracing import create_ray_from_all_pairs
    >>> create_ray_from_all_pairs([[0, 0, 0], [1, 0, 0]], [[0, 0, 1], [0, 0, 2], [0, 0, 3]]).shape
    (6, 2, 3)
    """
    start = arguments.batch(arguments.points("x0y0z0", x0y0z0), 1)
    end = arguments.batch(arguments.points("x1y1z1", x1y1z1), 1)
    for name, points in (("x0y0z0", start), ("x1y1z1", end)):
        if points.ndim > 2:
            raise ValueError(f"{name} must be [3] or [m, 3], got {points.shape}")
    rays = arguments.as_rays(start[:, None], geometry.unit(end - start[:, None]))
    return rays.reshape(-1, 2, 3)


def propagate_a_ray(ray: Array, distance: float | Array) -> np.ndarray:
    """Return rays whose starts have moved along their directions; the directions stay.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    distance : float or array
        A number or ``[m]``; negative goes backwards.

    Returns
    -------
    numpy.ndarray
        A new array, ``[2, 3]`` for one ray, else ``[m, 2, 3]``.

    Examples
    --------
    >>> from odak.raytracing import propagate_a_ray
    >>> propagate_a_ray([[0, 0, 0], [0, 0.6, 0.8]], 10.0)
    array([[0. , 6. , 8. ],
           [0. , 0.6, 0.8]])
    """
    ray = arguments.batch(arguments.rays("ray", ray), 2)
    distance = np.atleast_1d(arguments.floats("distance", distance)).astype(ray.dtype)
    _validate.fitting(ray=ray.shape[:-2], distance=distance)
    moved = ray[..., 0, :] + distance[..., None] * ray[..., 1, :]
    return arguments.single(arguments.as_rays(moved, ray[..., 1, :]))


def get_points_along_a_ray_segment(ray: Array, distances: Array) -> np.ndarray:
    """Return the points of rays at given distances from their starts.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    distances : array
        ``[k]``.

    Returns
    -------
    numpy.ndarray
        ``[k, 3]`` for one ray, else ``[m, k, 3]``.

    Examples
    --------
    >>> from odak.raytracing import get_points_along_a_ray_segment
    >>> get_points_along_a_ray_segment([[0, 0, 0], [0, 0, 1]], [1.0, 2.0])
    array([[0., 0., 1.],
           [0., 0., 2.]])
    """
    ray = arguments.batch(arguments.rays("ray", ray), 2)
    distances = arguments.floats("distances", distances).reshape(-1, 1).astype(ray.dtype)
    return arguments.single(ray[..., None, 0, :] + distances * ray[..., None, 1, :])


def calculate_intersection_of_two_rays(ray0: Array, ray1: Array) -> tuple[np.ndarray, np.ndarray]:
    """Return the common point of two lines and how far along each of the rays it lies.

    Parameters
    ----------
    ray0, ray1 : array
        ``[2, 3]`` each, or batches ``[m, 2, 3]``.

    Returns
    -------
    tuple of numpy.ndarray
        Point ``[3]`` and distances ``[2]``, signed, of ray0 and ray1; ``[m, 3]`` and ``[m, 2]`` for batches. Where the
        lines are skew or parallel: ray0's start and two zeros. NaN where a ray is not finite.

    Notes
    -----
    Lines count as skew where they pass each other by more than 1e-5 of the distance between their starts, plus 1e-8.

    Examples
    --------
    >>> from odak.raytracing import calculate_intersection_of_two_rays
    >>> calculate_intersection_of_two_rays([[0, 0, 0], [1, 0, 0]], [[3, -7, 0], [0, 1, 0]])
    (array([3., 0., 0.]), array([3., 7.]))
    """
    start0, direction0, start1, direction1, one = _pair(ray0, ray1)
    t0, t1, meet = geometry.crossing_of_lines(start0, direction0, start1, direction1)
    distances = np.where(meet[..., None], np.stack((t0, t1), axis=-1), 0.0)
    # A ray that is lost meets no other: not to be taken for one that passes it by.
    distances += 0.0 * (start0 + direction0 + start1 + direction1).sum(axis=-1, keepdims=True)
    point = start0 + distances[..., :1] * direction0
    return (point[0], distances[0]) if one else (point, distances)


def find_nearest_points(ray0: Array, ray1: Array) -> tuple[np.ndarray, np.ndarray]:
    """Return, on each of two lines, the point nearest to the other line.

    Parameters
    ----------
    ray0, ray1 : array
        ``[2, 3]`` each, or batches ``[m, 2, 3]``.

    Returns
    -------
    tuple of numpy.ndarray
        Points ``[3]`` on ray0 and ray1, or ``[m, 3]``; both are the crossing where the lines meet. For parallel lines:
        ray0's start and its foot on ray1.

    Examples
    --------
    >>> from odak.raytracing import find_nearest_points
    >>> find_nearest_points([[1, 0, 0], [1, 0, 0]], [[0, 0, 5], [0, 1, 0]])
    (array([0., 0., 0.]), array([0., 0., 5.]))
    """
    start0, direction0, start1, direction1, one = _pair(ray0, ray1)
    t0, t1 = geometry.nearest_on_lines(start0, direction0, start1, direction1)
    nearest0, nearest1 = start0 + t0[..., None] * direction0, start1 + t1[..., None] * direction1
    return (nearest0[0], nearest1[0]) if one else (nearest0, nearest1)


def _pair(ray0, ray1):
    """Return starts and directions ``[m, 3]`` of two sets of rays, and whether there is one of each."""
    ray0, ray1 = (arguments.batch(arguments.rays(n, ray), 2) for n, ray in (("ray0", ray0), ("ray1", ray1)))
    _validate.fitting(ray0=ray0, ray1=ray1)
    ray0, ray1 = np.broadcast_arrays(ray0, ray1)
    return ray0[..., 0, :], ray0[..., 1, :], ray1[..., 0, :], ray1[..., 1, :], ray0.shape[:-2] == (1,)
