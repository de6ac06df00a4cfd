"""Rays at surfaces: intersections, normals, reflection, refraction and Fresnel coefficients, in NumPy."""

from collections.abc import Sequence

import numpy as np

from odak import _validate
from odak._array import Array
from odak.raytracing import arguments, geometry, interfaces, intersections
from odak.raytracing.interfaces import Fresnel
from odak.raytracing.parametric import (
    intersect_parametric,
    intersection_kernel_for_parametric_surfaces,
    propagate_parametric_intersection_error,
)
from odak.raytracing.primitives import split_cylinder

__all__ = [
    "fresnel_coefficients",
    "get_cylinder_normal",
    "get_sphere_normal",
    "get_triangle_normal",
    "intersect_parametric",
    "intersect_w_circle",
    "intersect_w_cylinder",
    "intersect_w_sphere",
    "intersect_w_surface",
    "intersect_w_triangle",
    "intersection_kernel_for_parametric_surfaces",
    "propagate_parametric_intersection_error",
    "reflect",
    "refract",
]


def reflect(input_ray: Array, normal: Array) -> np.ndarray:
    """Reflect rays at surfaces: d' = d − 2(d·n)/(n·n)·n.

    Parameters
    ----------
    input_ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    normal : array
        Normals as rays, ``[2, 3]`` or ``[m, 2, 3]``, of any length and sign. One serves many rays, and the reverse.

    Returns
    -------
    numpy.ndarray
        Rays that start at the normals' points, ``[2, 3]`` for one, else ``[m, 2, 3]``.

    Notes
    -----
    Spencer and Murty, J. Opt. Soc. Am. 52, 672 (1962).

    Examples
    --------
    >>> from odak.raytracing import reflect
    >>> reflect([[0, 0, 0], [0, 0.6, 0.8]], [[1, 1, 1], [0, 0, 2]])
    array([[ 1. ,  1. ,  1. ],
           [ 0. ,  0.6, -0.8]])
    """
    ray, normal = _batches(("input_ray", input_ray), ("normal", normal))
    direction = interfaces.reflect_directions(ray[..., 1, :], normal[..., 1, :])
    return arguments.single(arguments.as_rays(normal[..., 0, :], direction))


def refract(vector: Array, normvector: Array, n1: float | Array, n2: float | Array, error: float = 0.01) -> np.ndarray:
    """Refract rays at surfaces by Snell's law.

    Parameters
    ----------
    vector : array
        Rays, ``[2, 3]`` or ``[m, 2, 3]``.
    normvector : array
        Normals as rays, of any length and sign; one serves many rays, and the reverse.
    n1, n2 : float or array
        Refractive indices before and behind the surface, numbers or ``[m]``.
    error : float
        Not used: the result is exact. Kept so that the call equals that of :func:`odak.learn.raytracing.refract`.

    Returns
    -------
    numpy.ndarray
        Rays that start at the normals' points, ``[2, 3]`` for one, else ``[m, 2, 3]``; NaN directions where the ray is
        totally reflected. See :func:`odak.raytracing.interfaces.refract_directions` for statuses.

    Examples
    --------
    >>> from odak.raytracing import refract
    >>> refract([[0, 0, 0], [0, 0.6, 0.8]], [[0, 0, 0], [0, 0, 1]], 1.0, 1.5).round(6)
    array([[0.      , 0.      , 0.      ],
           [0.      , 0.4     , 0.916515]])
    """
    ray, normal = _batches(("vector", vector), ("normvector", normvector))
    n1, n2 = arguments.index("n1", n1), arguments.index("n2", n2)
    _validate.fitting(vector=ray.shape[:-2], n1=n1, n2=n2)
    direction, _ = interfaces.refract_directions(ray[..., 1, :], normal[..., 1, :], n1, n2)
    dtype = np.result_type(ray, normal)
    return arguments.single(arguments.as_rays(normal[..., 0, :], direction).astype(dtype))


def fresnel_coefficients(ray: Array, normal: Array, n1: float | Array, n2: complex | Array) -> Fresnel:
    """Return the Fresnel coefficients of rays at surfaces, as amplitudes and as shares of the power.

    Parameters
    ----------
    ray, normal : array
        ``[2, 3]`` or ``[m, 2, 3]``, lengths and signs free.
    n1 : float or array
        Real refractive index before the surface.
    n2 : float, complex or array
        Index behind it; a positive imaginary part absorbs.

    Returns
    -------
    Fresnel
        Named tuple of arrays ``[m]`` for s and p: `reflected_*` and `transmitted_*` (complex amplitudes),
        `reflectance_*` and `transmittance_*` (power, each pair adds up to 1).

    Notes
    -----
    Born and Wolf, Principles of Optics (1999), section 1.5.2.

    Examples
    --------
    >>> from odak.raytracing import fresnel_coefficients
    >>> ray = [[0, 0, 0], [0, 0, 1]]
    >>> fresnel_coefficients(ray, ray, 1.0, 1.5).reflectance_s.round(6)
    array([0.04])
    """
    ray, normal = _batches(("ray", ray), ("normal", normal))
    n1, n2 = arguments.index("n1", n1), np.asarray(_validate.array("n2", n2))
    if not n2.ndim and not np.isfinite(n2):
        raise ValueError(f"n2 must be finite, got {n2}")
    _validate.fitting(ray=ray.shape[:-2], n1=n1, n2=n2)
    return interfaces.fresnel(ray[..., 1, :], normal[..., 1, :], n1, n2)


def intersect_w_surface(ray: Array, points: Array) -> tuple[np.ndarray, np.ndarray]:
    """Meet the plane through three points.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    points : array
        Three points of the plane, ``[3, 3]``; ``[m, 3, 3]`` gives each ray its own plane.

    Returns
    -------
    tuple of numpy.ndarray
        Normals as rays (where the plane is hit, unit normal), ``[2, 3]`` or ``[m, 2, 3]``, and distances ``[m]``,
        without sign. NaN for rays along the plane.

    Examples
    --------
    >>> from odak.raytracing import define_plane, intersect_w_surface
    >>> intersect_w_surface([[0, 0, 0], [0, 0.6, 0.8]], define_plane([0, 0, 10]))
    (array([[ 0. ,  7.5, 10. ],
           [ 0. ,  0. ,  1. ]]), array([12.5]))
    """
    ray = arguments.batch(arguments.rays("ray", ray), 2)
    points = arguments.triangles("points", points)
    _validate.fitting(ray=ray.shape[:-2], points=points.shape[:-2])
    hit = _meet_plane(ray, points)
    return arguments.single(arguments.as_rays(hit.point, hit.normal)), np.abs(hit.distance)


def get_triangle_normal(triangle: Array, triangle_center: Array = None) -> np.ndarray:
    """Return the unit normals of triangles by the right-hand rule, as rays from their centres.

    Parameters
    ----------
    triangle : array
        ``[3, 3]`` or ``[m, 3, 3]``.
    triangle_center : array, optional
        Where the normals start; by default the mean of the corners.

    Returns
    -------
    numpy.ndarray
        ``[2, 3]`` for one, else ``[m, 2, 3]``; NaN normal where the corners are in line.

    Examples
    --------
    >>> from odak.raytracing import get_triangle_normal
    >>> get_triangle_normal([[0, 0, 0], [3, 0, 0], [0, 3, 0]])
    array([[1., 1., 0.],
           [0., 0., 1.]])
    """
    triangle = arguments.batch(arguments.triangles("triangle", triangle), 2)
    given = triangle_center is not None
    center = arguments.points("triangle_center", triangle_center) if given else triangle.mean(axis=-2)
    return arguments.single(arguments.as_rays(center, geometry.triangle_normal(triangle)))


def intersect_w_circle(ray: Array, circle: Sequence) -> tuple[np.ndarray, np.ndarray]:
    """Meet the plane of a circle; the distance is 0 where the point lies outside the circle.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    circle : list
        [plane, centre, radius] of :func:`odak.raytracing.define_circle`.

    Returns
    -------
    tuple of numpy.ndarray
        As :func:`intersect_w_surface`; a batch of one ray keeps its axis.
    """
    if not isinstance(circle, Sequence) or len(circle) != 3 or isinstance(circle, str):
        raise TypeError(f"circle must be a list [plane, centre, radius], got {circle!r:.80}")
    given = arguments.rays("ray", ray)
    rays = arguments.batch(given, 2)
    normal, distance = intersect_w_surface(rays, circle[0])
    normal = arguments.batch(normal, 2)
    arm = normal[..., 0, :] - arguments.points("circle[1]", circle[1])
    outside = geometry.dot(arm, arm) > arguments.floats("circle[2]", circle[2]) ** 2
    return normal if given.ndim > 2 else normal[0], np.where(outside, 0.0, distance)


def intersect_w_triangle(ray: Array, triangle: Array) -> tuple:
    """Meet triangles, ahead of the start or behind it; their rims belong to them.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    triangle : array
        ``[3, 3]``, or ``[m, 3, 3]``: one for each ray.

    Returns
    -------
    tuple
        Normal and distance as in :func:`intersect_w_surface`. A ray that misses: ``(0, 0)`` when it is the only one,
        else distance 0 and a NaN normal in its place.

    Examples
    --------
    >>> from odak.raytracing import intersect_w_triangle
    >>> intersect_w_triangle([[9, 9, 0], [0, 0, 1]], [[0, 0, 5], [1, 0, 5], [0, 1, 5]])
    (0, 0)
    """
    rays = arguments.batch(arguments.rays("ray", ray), 2)
    triangle = arguments.triangles("triangle", triangle)
    _validate.fitting(ray=rays.shape[:-2], triangle=triangle.shape[:-2])
    hit = _meet_plane(rays, triangle)
    place = np.where(hit.hit[..., None], hit.point, 0.0)
    inside = hit.hit & geometry.is_on_triangle(place, *(triangle[..., i, :] for i in range(3)))
    if inside.shape == (1,) and not inside[0]:
        return 0, 0
    normal = np.where(inside[..., None, None], arguments.as_rays(hit.point, hit.normal), np.nan)
    return arguments.single(normal), np.where(inside, np.abs(hit.distance), 0.0)


def get_sphere_normal(point: Array, sphere: Array) -> np.ndarray:
    """Return the rays from points of a sphere towards its centre.

    Parameters
    ----------
    point : array
        ``[3]`` or ``[m, 3]``.
    sphere : array
        ``[c_x, c_y, c_z, r]``.

    Returns
    -------
    numpy.ndarray
        ``[2, 3]`` for one, else ``[m, 2, 3]``.

    Examples
    --------
    >>> from odak.raytracing import get_sphere_normal
    >>> get_sphere_normal([0, 0, 3], [0, 0, 1, 2])
    array([[ 0.,  0.,  3.],
           [ 0.,  0., -1.]])
    """
    point = arguments.batch(arguments.points("point", point), 1)
    center = arguments.numbers("sphere", sphere, 4)[..., :3]
    _validate.fitting(point=point, sphere=center)
    return arguments.single(arguments.as_rays(point, geometry.unit(center - point)))


def get_cylinder_normal(point: Array, cylinder: Array) -> np.ndarray:
    """Return the rays from the axis of a cylinder outwards through points of it.

    Parameters
    ----------
    point : array
        ``[3]`` or ``[m, 3]``.
    cylinder : array
        ``[7]`` of :func:`odak.raytracing.define_cylinder`.

    Returns
    -------
    numpy.ndarray
        ``[2, 3]`` for one, else ``[m, 2, 3]``. Each starts at its point's foot on the axis.

    Examples
    --------
    >>> from odak.raytracing import define_cylinder, get_cylinder_normal
    >>> get_cylinder_normal([0, 2, 3], define_cylinder([0, 0, 0], 2))
    array([[0., 0., 3.],
           [0., 1., 0.]])
    """
    point = arguments.batch(arguments.points("point", point), 1)
    center, _, axis = split_cylinder(cylinder)
    _validate.fitting(point=point, cylinder=center)
    axis = geometry.unit(axis)
    foot = center + geometry.dot(*np.broadcast_arrays(point - center, axis))[..., None] * axis
    return arguments.single(arguments.as_rays(foot, geometry.unit(point - foot)))


def intersect_w_sphere(ray: Array, sphere: Array) -> tuple:
    """Meet a sphere: the nearest point ahead, or the exit when the ray starts inside.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    sphere : array
        ``[4]``: centre and radius; ``[m, 4]`` gives each ray its own sphere.

    Returns
    -------
    tuple
        Normals as rays from the points hit towards the centre, ``[2, 3]`` or ``[m, 2, 3]``, and distances ``[m]``. A
        ray that misses: ``(False, False)`` when it is the only one, else NaN in its place.

    Examples
    --------
    >>> from odak.raytracing import intersect_w_sphere
    >>> intersect_w_sphere([[-2, 0, 0], [1, 0, 0]], [0, 0, 0, 10])
    (array([[10.,  0.,  0.],
           [-1.,  0.,  0.]]), array([12.]))
    """
    rays = arguments.batch(arguments.rays("ray", ray), 2)
    sphere = arguments.numbers("sphere", sphere, 4)
    _validate.fitting(ray=rays.shape[:-2], sphere=sphere.shape[:-1])
    hit = intersections.sphere(rays[..., 0, :], rays[..., 1, :], sphere[..., :3], sphere[..., 3])
    return _curved(hit.point, 0.0 - hit.normal, hit)


def intersect_w_cylinder(ray: Array, cylinder: Array) -> tuple:
    """Meet an infinite cylinder: the nearest point ahead, or the exit when the ray starts inside.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    cylinder : array
        ``[7]`` of :func:`odak.raytracing.define_cylinder`; ``[m, 7]`` gives each ray its own.

    Returns
    -------
    tuple
        Normals as rays from the axis through the points hit (see :func:`get_cylinder_normal`) and distances ``[m]``;
        misses as in :func:`intersect_w_sphere`.

    Examples
    --------
    >>> from odak.raytracing import define_cylinder, intersect_w_cylinder
    >>> intersect_w_cylinder([[-20, 0, 4], [1, 0, 0]], define_cylinder([0, 0, 0], 2))[1]
    array([18.])
    """
    rays = arguments.batch(arguments.rays("ray", ray), 2)
    center, radius, axis = split_cylinder(cylinder)
    _validate.fitting(ray=rays.shape[:-2], cylinder=radius)
    hit = intersections.cylinder(rays[..., 0, :], rays[..., 1, :], center, radius, axis)
    return _curved(hit.point - radius[..., None] * hit.normal, hit.normal, hit)


def _curved(start, direction, hit) -> tuple:
    if hit.distance.shape == (1,) and not hit.hit[0]:
        return False, False
    return arguments.single(arguments.as_rays(start, direction)), hit.distance


def _meet_plane(rays, triangle):
    """Meet the planes of triangles through their centres, which rounding harms least."""
    centre = triangle.mean(axis=-2)
    return intersections.plane(rays[..., 0, :], rays[..., 1, :], centre, geometry.triangle_normal(triangle))


def _batches(*named):
    """Return sets of rays with a batch axis each, broadcast against each other."""
    batches = {name: arguments.batch(arguments.rays(name, value), 2) for name, value in named}
    _validate.fitting(**batches)
    return np.broadcast_arrays(*batches.values())
