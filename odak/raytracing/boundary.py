"""Rays at surfaces: intersections, normals, reflection, refraction and Fresnel coefficients."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Amount, Array, ArrayT, namespace, placement
from odak._warnings import ConvergenceWarning, warn
from odak.raytracing import arguments, geometry, interfaces, intersections
from odak.raytracing import components as vec
from odak.raytracing.batches import in_pieces
from odak.raytracing.interfaces import Fresnel
from odak.raytracing.primitives import split_cylinder


def reflect(input_ray: Array, normal: Array) -> Array:
    """Reflect rays at surfaces: d' = d − 2(d·n)/(n·n)·n.

    Parameters
    ----------
    input_ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    normal : array
        Normals as rays, ``[2, 3]`` or ``[m, 2, 3]``, of any length and sign. A single normal or ray
        is broadcast.

    Returns
    -------
    array
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
    return arguments.single(reflected_rays(input_ray, normal))


def reflected_rays(input_ray: Array | Sequence[Sequence[Any]], normal: Array | Sequence[Sequence[Any]]) -> Array:
    """Return the rays of :func:`reflect`, ``[m, 2, 3]``."""

    def reflected(ray, normal):
        return vec.join(vec.split(normal[..., 0, :]), interfaces.reflected(ray[..., 1, :], normal[..., 1, :]))

    return in_pieces(reflected, (2, 2), *_batches(input_ray=input_ray, normal=normal))


def refract(vector: Array, normvector: Array, n1: float | Array, n2: float | Array, error: float = 0.01) -> Array:
    """Refract rays at surfaces by Snell's law.

    Parameters
    ----------
    vector : array
        Rays, ``[2, 3]`` or ``[m, 2, 3]``.
    normvector : array
        Normals as rays, of any length and sign; a single normal or ray is broadcast.
    n1 : float or array
        Refractive index before the surface, a number or ``[m]``.
    n2 : float or array
        Refractive index behind the surface, a number or ``[m]``.
    error : float
        Not used: the result is exact. Kept for the signature of :func:`odak.learn.raytracing.refract`.

    Returns
    -------
    array
        Rays that start at the normals' points, ``[2, 3]`` for one, else ``[m, 2, 3]``; NaN directions where the ray is
        totally reflected. See :func:`odak.raytracing.interfaces.refract_directions` for statuses.

    Examples
    --------
    >>> from odak.raytracing import refract
    >>> refract([[0, 0, 0], [0, 0.6, 0.8]], [[0, 0, 0], [0, 0, 1]], 1.0, 1.5).round(6)
    array([[0.      , 0.      , 0.      ],
           [0.      , 0.4     , 0.916515]])
    """
    return arguments.single(refracted_rays(vector, normvector, n1, n2))


def refracted_rays(vector: Array, normvector: Array, n1: Amount, n2: Amount) -> Array:
    """Return the rays of :func:`refract`, ``[m, 2, 3]``."""
    ray, normal = _batches(vector=vector, normvector=normvector)
    n1, n2 = arguments.index("n1", n1, ray), arguments.index("n2", n2, ray)
    _validate.fitting(vector=ray.shape[:-2], normvector=normal.shape[:-2], n1=n1, n2=n2)

    def refracted(ray, normal, n1, n2):
        direction, _, _ = interfaces.refracted(ray[..., 1, :], normal[..., 1, :], n1, n2)
        return vec.join(vec.split(normal[..., 0, :]), direction)

    return in_pieces(refracted, (2, 2, 0, 0), ray, normal, n1, n2)


def fresnel_coefficients(ray: Array, normal: Array, n1: float | Array, n2: complex | Array) -> Fresnel:
    """Return the Fresnel coefficients of rays at surfaces, for the amplitude and for the power.

    Parameters
    ----------
    ray : array
        Rays, ``[2, 3]`` or ``[m, 2, 3]``; directions of any length.
    normal : array
        Normals as rays, ``[2, 3]`` or ``[m, 2, 3]``, of any length and sign.
    n1 : float or array
        Real refractive index before the surface.
    n2 : float, complex or array
        Index behind it; a positive imaginary part describes absorption.

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
    >>> [round(value, 6) for value in fresnel_coefficients(ray, ray, 1.0, 1.5).reflectance_s.reshape(-1).tolist()]
    [0.04]
    """
    batches = _batches(ray=ray, normal=normal)
    ray, normal = namespace(*batches).broadcast_arrays(*batches)
    n1, n2 = arguments.index("n1", n1, ray), _validate.given("n2", n2)
    # A number keeps its precision, and may be complex.
    n2 = _array.converted(n2, *placement(ray)[:2]) if _array.is_array(n2) else n2
    _validate.fitting(ray=ray.shape[:-2], n1=n1, n2=n2)
    return interfaces.fresnel(ray[..., 1, :], normal[..., 1, :], n1, n2)


def intersect_w_surface(ray: Array, points: Array) -> tuple[Array, Array]:
    """Intersect rays with the plane through three points.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    points : array
        Three points of the plane, ``[3, 3]``; ``[m, 3, 3]`` gives each ray its own plane.

    Returns
    -------
    tuple of array
        Normals as rays (where the plane is hit, unit normal), ``[2, 3]`` or ``[m, 2, 3]``, and absolute distances
        ``[m]``. NaN for rays along the plane.

    Examples
    --------
    >>> from odak.raytracing import define_plane, intersect_w_surface
    >>> intersect_w_surface([[0, 0, 0], [0, 0.6, 0.8]], define_plane([0, 0, 10]))
    (array([[ 0. ,  7.5, 10. ],
           [ 0. ,  0. ,  1. ]]), array([12.5]))
    """
    ray, points = arguments.rays_and_triangles(ray=ray, points=points)
    normal, distance = plane_hits(ray, points)
    return arguments.single(normal), abs(distance)


def get_triangle_normal(triangle: Array, triangle_center: Array | None = None) -> Array:
    """Return the unit normals of triangles by the right-hand rule, as rays from their centres.

    Parameters
    ----------
    triangle : array
        ``[3, 3]`` or ``[m, 3, 3]``.
    triangle_center : array, optional
        Where the normals start; by default the mean of the corners.

    Returns
    -------
    array
        ``[2, 3]`` for one, else ``[m, 2, 3]``; NaN normal where the corners are in line.

    Examples
    --------
    >>> from odak.raytracing import get_triangle_normal
    >>> get_triangle_normal([[0, 0, 0], [3, 0, 0], [0, 3, 0]]).tolist()
    [[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    given = {} if triangle_center is None else {"triangle_center": triangle_center}
    triangle, *center = _validate.reals(triangle=triangle, **given)
    triangle = arguments.triangles("triangle", triangle)
    xp = namespace(triangle)
    start = arguments.points("triangle_center", center[0]) if center else xp.mean(triangle, axis=-2)
    _validate.fitting(triangle=triangle.shape[:-1], triangle_center=start)
    return arguments.single(arguments.as_rays(start, geometry.triangle_normal(triangle)))


def intersect_w_circle(ray: Array, circle: Sequence[Any]) -> tuple[Array, Array]:
    """Intersect rays with the plane of a circle; the distance is 0 where the intersection lies outside the circle.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    circle : list
        [plane, centre, radius] of :func:`odak.raytracing.define_circle`.

    Returns
    -------
    tuple of array
        Normals as rays, ``[2, 3]`` or ``[m, 2, 3]``, and distances ``[m]``, as of :func:`intersect_w_surface`.

    Examples
    --------
    The first ray intersects the disc of radius 2 at z = 5, the second one misses it:

    >>> from odak.raytracing import define_circle, intersect_w_circle
    >>> circle = define_circle([0, 0, 5], 2.0, [0, 0, 0])
    >>> rays = [[[1, 0, 0], [0, 0, 1]], [[3, 0, 0], [0, 0, 1]]]
    >>> intersect_w_circle(rays, circle)[1].ravel().tolist()
    [5.0, 0.0]
    """
    normal, distance = circle_hits(ray, circle)
    return normal, abs(distance)


def intersect_w_triangle(ray: Array, triangle: Array) -> tuple[Any, ...]:
    """Intersect rays with triangles, ahead of the start or behind it; edges are part of a triangle.

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
    ray, triangle = arguments.rays_and_triangles(ray=ray, triangle=triangle)
    normal, distance = plane_hits(ray, triangle)
    xp = namespace(distance)
    hit = xp.isfinite(distance)
    place = xp.where(hit[..., None], normal[..., 0, :], 0.0)
    inside = hit & geometry.is_on_triangle(place, *(triangle[..., i, :] for i in range(3)))
    if inside.shape == (1,) and not inside[0]:
        return 0, 0
    normal = xp.where(inside[..., None, None], normal, math.nan)
    return arguments.single(normal), xp.where(inside, abs(distance), 0.0)


def get_sphere_normal(point: Array, sphere: Array) -> Array:
    """Return the rays from points of a sphere towards its centre.

    Parameters
    ----------
    point : array
        ``[3]`` or ``[m, 3]``.
    sphere : array
        ``[c_x, c_y, c_z, r]``.

    Returns
    -------
    array
        ``[2, 3]`` for one, else ``[m, 2, 3]``.

    Examples
    --------
    >>> from odak.raytracing import get_sphere_normal
    >>> get_sphere_normal([0, 0, 3], [0, 0, 1, 2])
    array([[ 0.,  0.,  3.],
           [ 0.,  0., -1.]])
    """
    point, sphere = _validate.reals(point=point, sphere=sphere)
    point = arguments.points("point", point)
    center = arguments.shaped("sphere", sphere, (4,), "[4] or [m, 4]")[..., :3]
    _validate.fitting(point=point, sphere=center)
    return arguments.single(arguments.as_rays(point, geometry.unit(center - point)))


def get_cylinder_normal(point: Array, cylinder: Array) -> Array:
    """Return the outward normals of a cylinder at points of it, as rays from its axis.

    Parameters
    ----------
    point : array
        ``[3]`` or ``[m, 3]``.
    cylinder : array
        ``[7]`` of :func:`odak.raytracing.define_cylinder`.

    Returns
    -------
    array
        ``[2, 3]`` for one, else ``[m, 2, 3]``. Each starts at the projection of its point onto the axis.

    Examples
    --------
    >>> from odak.raytracing import define_cylinder, get_cylinder_normal
    >>> get_cylinder_normal([0, 2, 3], define_cylinder([0, 0, 0], 2))
    array([[0., 0., 3.],
           [0., 1., 0.]])
    """
    point, cylinder = _validate.reals(point=point, cylinder=cylinder)
    point, (center, _, axis) = arguments.points("point", point), split_cylinder(cylinder)
    _validate.fitting(point=point, cylinder=center)
    axis = geometry.unit(axis)
    foot = center + geometry.dot(*namespace(axis).broadcast_arrays(point - center, axis))[..., None] * axis
    return arguments.single(arguments.as_rays(foot, geometry.unit(point - foot)))


def intersect_w_sphere(ray: Array, sphere: Array) -> tuple[Any, ...]:
    """Intersect rays with a sphere, at the nearest point ahead, or the exit when the ray starts inside.

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
    rays, normals, distance, hit = sphere_hits(ray, sphere)
    if hit.shape == (1,) and not hit[0]:
        return False, False
    return arguments.single(arguments.as_rays(rays[..., 0, :], 0.0 - normals[..., 1, :])), distance


def intersect_w_cylinder(ray: Array, cylinder: Array) -> tuple[Any, ...]:
    """Intersect rays with an infinite cylinder, at the nearest point ahead, or the exit when the ray starts inside.

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
    _, normals, distance, hit = cylinder_hits(ray, cylinder)
    return (False, False) if hit.shape == (1,) and not hit[0] else (arguments.single(normals), distance)


def plane_hits(
    ray: ArrayT,
    triangle: ArrayT,
    limit: Callable[..., Array] | None = None,
    limits: Sequence[Array] = (),
    ranks: Sequence[int] = (),
) -> tuple[ArrayT, ...]:
    """Return the intersections of rays with the planes of triangles.

    Parameters
    ----------
    ray, triangle : array
        ``[..., 2, 3]`` and ``[..., 3, 3]``. The planes are taken through the centres of the triangles, where rounding
        errors of the normal count least.
    limit : callable, optional
        Called as ``limit(intersection, *limits)`` for each piece of a large batch.
    limits, ranks : sequence
        Arrays for `limit`, and how many axes of each do not belong to its batch.

    Returns
    -------
    tuple of array
        Normals as rays ``[..., 2, 3]``, signed distances ``[...]``, both NaN for rays along a plane, and what `limit`
        returns.
    """

    def hits(ray, centre, normal, *limits):
        found = intersections.plane(ray[..., 0, :], ray[..., 1, :], centre, normal)
        given = (vec.join(found.point, found.normal), found.distance)
        return given if limit is None else (*given, limit(found, *limits))

    centre = namespace(triangle).mean(triangle, axis=-2)
    return in_pieces(hits, (2, 1, 1, *ranks), ray, centre, geometry.triangle_normal(triangle), *limits)


def circle_hits(ray: Array, circle: Sequence[Array]) -> tuple[Array, Array]:
    """Return the intersections with the plane of a circle: normals as rays, signed distances, 0 outside the circle."""
    if not isinstance(circle, Sequence) or len(circle) != 3 or isinstance(circle, str):
        raise TypeError(f"circle must be a list [plane, centre, radius] of define_circle, got {circle!r:.80}")
    given, plane, center, radius = _validate.reals(ray=ray, plane=circle[0], center=circle[1], radius=circle[2])
    rays, plane = arguments.rays("ray", given), arguments.triangles("circle[0]", plane)
    arguments.one_or_each("circle[0]", plane.shape[:-2], rays)
    center, radius = arguments.points("circle[1]", center), namespace(radius).reshape(radius, (-1,))
    arguments.one_or_each("circle[1]", center.shape[:-1], rays)
    arguments.one_or_each("circle[2]", radius.shape, rays)

    def is_outside(found, center, radius):
        arm = vec.minus(found.point, vec.split(center))
        return vec.dot(arm, arm) > radius * radius

    normal, distance, outside = plane_hits(rays, plane, is_outside, (center, radius), (1, 0))
    distance = namespace(distance).where(outside, 0.0, distance)
    return normal if given.ndim > 2 else normal[0, ...], distance


def sphere_hits(ray: Any, sphere: Any) -> Any:
    """Return the intersections of rays with spheres.

    Returns
    -------
    tuple of array
        Rays ``[m, 2, 3]`` from the points hit, normals ``[m, 2, 3]`` (the sphere's centre and the outward unit normal),
        distances ``[m]``, NaN for rays that miss, and which rays hit.
    """
    ray, sphere = _validate.reals(ray=ray, sphere=sphere)
    ray, sphere = arguments.rays("ray", ray), arguments.shaped("sphere", sphere, (4,), "[4] or [m, 4]")
    arguments.one_or_each("sphere", sphere.shape[:-1], ray)

    def hits(ray, sphere):
        found = intersections.sphere(ray[..., 0, :], ray[..., 1, :], sphere[..., :3], sphere[..., 3])
        rays = vec.join(found.point, vec.split(ray[..., 1, :]))
        return rays, vec.join(vec.split(sphere[..., :3]), found.normal), found.distance, found.hit

    return in_pieces(hits, (2, 1), ray, sphere)


def cylinder_hits(ray: Any, cylinder: Any) -> Any:
    """Return the same as :func:`sphere_hits` for cylinders; normals start at projections of points onto the axis."""
    ray, cylinder = _validate.reals(ray=ray, cylinder=cylinder)
    ray, (center, radius, axis) = arguments.rays("ray", ray), split_cylinder(cylinder)
    arguments.one_or_each("cylinder", radius.shape, ray)

    def hits(ray, center, radius, axis):
        found = intersections.cylinder(ray[..., 0, :], ray[..., 1, :], center, radius, axis)
        # NaN of rays that miss must not reach the gradient of the radius.
        outward = tuple(namespace(ray).where(found.hit, value, 0.0) for value in found.normal)
        foot = vec.along(found.point, -radius, outward)
        rays = vec.join(found.point, vec.split(ray[..., 1, :]))
        return rays, vec.join(foot, found.normal), found.distance, found.hit

    return in_pieces(hits, (2, 1, 0, 1), ray, center, radius, axis)


def _batches(**given):
    """Return sets of rays ``[m, 2, 3]`` whose lengths broadcast."""
    batches = {name: arguments.rays(name, v) for name, v in zip(given, _validate.reals(**given), strict=True)}
    _validate.fitting(**batches)
    return tuple(batches.values())


# Distances at which the sign of the error is tested: from 1e-6 to 1e7, each 10 % larger than the previous one.
_FIRST, _LAST, _GROWTH = 1e-6, 1e7, 1.1
_GOLDEN = (np.sqrt(5) - 1) / 2


def intersection_kernel_for_parametric_surfaces(
    distance: Array, ray: Array, parametric_surface: object, surface_function: Callable[..., Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Return a surface's function at given distances along rays, and the points there.

    Parameters
    ----------
    distance : array
        ``[m]`` or a number.
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    parametric_surface : object
        Passed to `surface_function`.
    surface_function : callable
        ``surface_function(points [m, 3], parametric_surface)`` returns ``[m]``, zero on the surface.

    Returns
    -------
    tuple of numpy.ndarray
        Errors ``[m]`` and points ``[m, 3]``.

    Examples
    --------
    >>> from odak.raytracing import intersection_kernel_for_parametric_surfaces, sphere_function
    >>> ray = [[0, 0, 0], [0, 0, 1]]
    >>> intersection_kernel_for_parametric_surfaces(2.0, ray, [0, 0, 0, 1], sphere_function)[0]
    array([3.])
    """
    _validate.function("surface_function", surface_function)
    ray = arguments.flat_rays("ray", ray)
    distance = np.atleast_1d(*_validate.reals(distance=distance))
    _validate.shaped("distance", distance, "a number or [m]")
    _validate.fitting(distance=distance, ray=ray[:, 0, 0])
    return _errors_and_points(distance, ray, parametric_surface, surface_function)


def _errors_and_points(distance, ray, parametric_surface, surface_function):
    point = ray[:, 0] + distance[:, None] * ray[:, 1]
    return np.asarray(surface_function(point, parametric_surface)).reshape(len(point)), point


def propagate_parametric_intersection_error(
    distance: Sequence[Any], error: Sequence[Any]
) -> tuple[list[Any], list[Any]]:
    """Take one secant step from two distances and their errors.

    Parameters
    ----------
    distance : sequence
        Two distances x0 and x1, numbers or arrays: the older and the newer.
    error : sequence
        The errors e0 and e1 at these distances.

    Returns
    -------
    tuple of list
        [x1, |x2|] with x2 = x1 − e1·(x1 − x0)/(e1 − e0), and [e1, e1]. The arguments are not changed.

    Examples
    --------
    >>> from odak.raytracing import propagate_parametric_intersection_error
    >>> propagate_parametric_intersection_error([0, 1], [5, 3])
    ([1, 2.5], [3, 3])
    """
    (x0, x1), (e0, e1) = _two("distance", distance), _two("error", error)
    _validate.fitting(distance=x0, newer_distance=x1, error=e0, newer_error=e1)
    return [x1, abs(x1 - e1 * (x1 - x0) / (e1 - e0))], [e1, e1]


def _two(name: str, values) -> tuple[Any, ...]:
    """Return two values: finite numbers, or arrays, in which NaN marks a lost ray."""
    values = tuple(values) if isinstance(values, Iterable) and not isinstance(values, str) else (values,)
    if len(values) != 2:
        raise ValueError(f"{name} must be two numbers or arrays, the older and the newer; got {len(values)}")
    return tuple(_validate.array(name, v) if np.ndim(v) else _validate.real(name, v) for v in values)


def intersect_parametric(
    ray: Array,
    parametric_surface: object,
    surface_function: Callable[..., Any],
    surface_normal_function: Callable[..., Any],
    target_error: float = 0.00000001,
    iter_no_limit: int = 100000,
) -> tuple[Any, ...]:
    """Intersect rays with a surface given as a function, at the nearest point ahead.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    parametric_surface : object
        Passed to both functions.
    surface_function : callable
        ``surface_function(points [m, 3], parametric_surface)`` returns ``[m]``: zero on the surface, with opposite
        signs on its sides.
    surface_normal_function : callable
        Takes the same and returns normals as rays.
    target_error : float
        Largest |surface_function| of a point that is accepted as on the surface.
    iter_no_limit : int
        Largest number of refinements.

    Returns
    -------
    tuple
        Distances ``[m]`` and normals, in this order; NaN for rays without a hit, ``(False, False)`` when there is only
        one ray and it has none.

    Warns
    -----
    ConvergenceWarning
        If rays do not come closer to the surface than `target_error`; they are NaN.

    Notes
    -----
    Distances from 1e-6 to 1e7, each 10 % larger than the previous one, are searched for a change of sign, or for a
    minimum of the magnitude between two changes of sign. A bracketed secant method with bisection then refines the
    root of each ray.

    Examples
    --------
    >>> from odak.raytracing import get_sphere_normal, intersect_parametric, sphere_function
    >>> intersect_parametric([[0, 0, -5], [0, 0, 1]], [0, 0, 0, 1], sphere_function, get_sphere_normal)[0].round(9)
    array([4.])
    """
    target_error = _validate.constant("target_error", target_error, positive=True)
    limit = _validate.integer("iter_no_limit", iter_no_limit, minimum=1)
    rays = arguments.flat_rays("ray", ray)
    _validate.function("surface_function", surface_function)
    _validate.function("surface_normal_function", surface_normal_function)

    def error_at(distance, rows):
        return _errors_and_points(distance, rays[rows], parametric_surface, surface_function)[0]

    bracket = _first_bracket(error_at, len(rays), target_error)
    distance = _refine_roots(error_at, bracket, target_error, limit)
    hit = np.isfinite(distance)
    if not hit.any():
        missed = np.full((len(rays), 2, 3), np.nan)
        return (False, False) if len(rays) == 1 else (distance, missed)
    normal = np.full((len(rays), 2, 3), np.nan)
    point = rays[hit, 0] + distance[hit, None] * rays[hit, 1]
    normal[hit] = np.reshape(surface_normal_function(point, parametric_surface), (-1, 2, 3))
    return distance, arguments.single(normal)


def _first_bracket(error_at: Callable[..., Any], count: int, target: float) -> np.ndarray:
    """Return distances between which the error first changes its sign, ``[2, m]``; NaN if it never does."""
    found = np.full((2, count), np.nan)
    rows = np.arange(count)
    before = now = np.zeros(count)
    error_before = error_now = error_at(now, rows) if count else now
    distance = _FIRST
    while distance < _LAST and len(rows):
        after = np.full(len(rows), distance)
        error_after = error_at(after, rows)
        # A start on the surface is not an intersection: its sign is replaced by the sign after the first step.
        leaving = (np.abs(error_now) <= target) & (now == 0)
        change = (np.sign(error_after) != np.sign(error_now)) & ~leaving & np.isfinite(error_after)
        found[:, rows[change]] = now[change], after[change]
        dip = (np.abs(error_now) <= np.abs(error_before)) & (np.abs(error_now) < np.abs(error_after)) & ~change
        dip &= ~leaving & (now > 0)
        if dip.any():
            found[:, rows[dip]] = _root_near_minimum(error_at, before[dip], after[dip], now[dip], rows[dip])
        keep = np.isnan(found[0, rows])
        before, error_before = now[keep], error_now[keep]
        rows, now, error_now = rows[keep], after[keep], error_after[keep]
        distance *= _GROWTH
    return found


def _root_near_minimum(error_at: Callable[..., Any], low, high, inside, rows) -> np.ndarray:
    """Find a change of sign near the smallest error between `low` and `high`; NaN where there is none."""
    low, high, start = low.copy(), high.copy(), low
    sign = np.sign(error_at(inside, rows))
    crossed = np.full(len(rows), np.nan)
    for _ in range(80):
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        error_left, error_right = sign * error_at(left, rows), sign * error_at(right, rows)
        for place, error in ((right, error_right), (left, error_left)):
            crossed = np.where(error <= 0, place, crossed)
        if not np.isnan(crossed).any():
            break
        nearer = error_left < error_right
        low, high = np.where(nearer, low, left), np.where(nearer, right, high)
    return np.where(np.isnan(crossed), np.nan, np.stack((start, crossed)))


def _refine_roots(error_at: Callable[..., Any], bracket: np.ndarray, target: float, limit: int) -> np.ndarray:
    """Return the roots within brackets ``[2, m]`` to `target`, NaN where there is no bracket or no convergence."""
    result = np.full(bracket.shape[1], np.nan)
    rows = np.flatnonzero(np.isfinite(bracket[0]))
    low, high = bracket[:, rows]
    if not len(rows):
        return result
    error_low, error_high = error_at(low, rows), error_at(high, rows)
    for step in range(min(limit, 200)):
        flat = error_high == error_low
        secant = high - error_high * (high - low) / np.where(flat, 1.0, error_high - error_low)
        middle = (low + high) / 2
        # Every third step halves the bracket, which guarantees convergence where the secant method stagnates.
        usable = ~flat & (secant > low) & (secant < high) & (step % 3 != 2)
        place = np.where(usable, secant, middle)
        error = error_at(place, rows)
        done = (np.abs(error) <= target) | ((place <= low) | (place >= high)) & (np.abs(error) <= 1e3 * target)
        result[rows[done]] = place[done]
        below = np.sign(error) == np.sign(error_low)
        low, error_low = np.where(below, place, low), np.where(below, error, error_low)
        high, error_high = np.where(below, high, place), np.where(below, error_high, error)
        rows, low, high, error_low, error_high = (v[~done] for v in (rows, low, high, error_low, error_high))
        if not len(rows):
            break
    if len(rows):
        warn(f"intersect_parametric: {len(rows)} rays did not reach an error of {target:g}", ConvergenceWarning)
    return result
