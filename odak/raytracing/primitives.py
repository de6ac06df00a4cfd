"""Planes, triangles, circles, spheres and cylinders: how they are written down, and where points lie on them."""

from collections.abc import Sequence

import numpy as np

from odak import _validate
from odak._array import Array
from odak.raytracing import arguments, geometry
from odak.tools.transformation import apply_matrix, rotation_matrix

# Corners of a plane before it is tilted; the last one stays at the plane's point.
PLANE_CORNERS = ((10.0, 10.0, 0.0), (0.0, 10.0, 0.0), (0.0, 0.0, 0.0))
_NONE = (0.0, 0.0, 0.0)


def define_plane(point: Sequence[float] | Array, angles: Sequence[float] = _NONE) -> np.ndarray:
    """Return three points of a plane through `point`, tilted.

    Parameters
    ----------
    point : sequence of float
        ``[3]``; the last of the three points.
    angles : sequence of float
        Degrees about X, Y and Z, applied in this order. Without tilt the plane is z = point[2].

    Returns
    -------
    numpy.ndarray
        ``[3, 3]``, a point per row; the right-hand normal is the rotated z axis.

    Examples
    --------
    >>> from odak.raytracing import define_plane
    >>> define_plane([0, 0, 5])
    array([[10., 10.,  5.],
           [ 0., 10.,  5.],
           [ 0.,  0.,  5.]])
    """
    point = arguments.points("point", point).reshape(3)
    matrix = rotation_matrix(arguments.finite_points("angles", angles).reshape(3)).astype(point.dtype)
    return point + apply_matrix(matrix, np.asarray(PLANE_CORNERS, dtype=point.dtype))


def bring_plane_to_origin(
    point: Array,
    plane: Array | None,
    shape: Sequence[float] = (10.0, 10.0),
    center: Sequence[float] = _NONE,
    angles: Sequence[float] = _NONE,
    mode: str = "XYZ",
) -> np.ndarray:
    """Return points in the frame of a plane that was rotated by `angles` and moved to `center`.

    Parameters
    ----------
    point : array
        ``[3]`` or ``[m, 3]``.
    plane : array or None
        Not used; kept for older calls.
    shape : sequence of float, default: (10.0, 10.0)
        Not used; kept for older calls.
    center : sequence of float
        Where the plane's centre is.
    angles : sequence of float
        The plane's rotation in degrees about X, Y and Z.
    mode : str
        Order of the rotations, as in :func:`odak.tools.rotate_point`.

    Returns
    -------
    numpy.ndarray
        R⁻¹·(point − center), ``[3]`` or ``[m, 3]``.

    Examples
    --------
    >>> from odak.raytracing import bring_plane_to_origin
    >>> bring_plane_to_origin([2, 1, 1], None, center=[1, 1, 1], angles=[0, 0, 90]).round(12) + 0
    array([ 0., -1.,  0.])
    """
    point = arguments.batch(arguments.points("point", point), 1)
    center = arguments.finite_points("center", center).astype(point.dtype)
    _validate.fitting(point=point, center=center)
    matrix = rotation_matrix(arguments.finite_points("angles", angles).reshape(3), mode).astype(point.dtype)
    moved = point - center
    return arguments.single(apply_matrix(matrix.T, moved))


def center_of_triangle(triangle: Array) -> np.ndarray:
    """Return the mean of the corners of triangles.

    Parameters
    ----------
    triangle : array
        One triangle ``[3, 3]``, or several ``[m, 3, 3]``.

    Returns
    -------
    numpy.ndarray
        ``[m, 3]``, and ``[1, 3]`` for one triangle.

    Examples
    --------
    >>> from odak.raytracing import center_of_triangle
    >>> center_of_triangle([[0, 0, 0], [3, 0, 0], [0, 6, 0]]).tolist()
    [[1.0, 2.0, 0.0]]
    """
    return arguments.batch(arguments.triangles("triangle", triangle), 2).mean(axis=-2)


def is_it_on_triangle(pointtocheck: Array, point0: Array, point1: Array, point2: Array) -> bool | np.ndarray:
    """Say whether a point lies within a triangle, judged along the triangle's normal; its rim belongs to it.

    Parameters
    ----------
    pointtocheck : array
        ``[3]`` or ``[m, 3]``.
    point0 : array
        First corner, ``[3]``.
    point1 : array
        Second corner, ``[3]``.
    point2 : array
        Third corner, ``[3]``.

    Returns
    -------
    bool or numpy.ndarray
        One bool, or ``[m]`` of them.

    Notes
    -----
    The same-side test of blackpawn.com/texts/pointinpoly.

    Examples
    --------
    >>> from odak.raytracing import is_it_on_triangle
    >>> is_it_on_triangle([1, 1, 0], [0, 0, 0], [4, 0, 0], [0, 4, 0])
    True
    """
    names = ("pointtocheck", "point0", "point1", "point2")
    values = (pointtocheck, point0, point1, point2)
    result = geometry.is_on_triangle(*(arguments.points(n, v) for n, v in zip(names, values, strict=True)))
    return bool(result) if result.ndim == 0 else result


def define_circle(center: Array, radius: float, angles: Sequence[float]) -> list:
    """Return a circle as [plane ``[3, 3]``, centre, radius].

    Parameters
    ----------
    center : array
        Centre of the circle, ``[3]``.
    radius : float
        Radius, in the unit of the centre.
    angles : sequence of float
        Degrees about X, Y and Z, applied in this order. Without tilt the circle lies in z = center[2].

    Returns
    -------
    list
        Three points of the plane ``[3, 3]``, the centre and the radius, as :func:`intersect_w_circle` takes them.

    Examples
    --------
    >>> from odak.raytracing import define_circle
    >>> plane, center, radius = define_circle([0.0, 0.0, 5.0], 2.0, [0.0, 0.0, 0.0])
    >>> plane[:, 2].tolist(), float(radius)
    ([5.0, 5.0, 5.0], 2.0)
    """
    arguments.finite_points("center", center)
    _radius(radius)
    return [define_plane(center, angles), center, radius]


def define_sphere(center: Sequence[float] | Array, radius: float) -> np.ndarray:
    """Return a sphere as ``[c_x, c_y, c_z, r]``.

    Parameters
    ----------
    center : sequence of float
        ``[3]``.
    radius : float
        Radius, in the unit of the centre.

    Returns
    -------
    numpy.ndarray
        float64 ``[4]``.

    Examples
    --------
    >>> from odak.raytracing import define_sphere
    >>> define_sphere([0, 0, 5], 3).tolist()
    [0.0, 0.0, 5.0, 3.0]
    """
    return np.concatenate((arguments.finite_points("center", center).reshape(3), _radius(radius))).astype(np.float64)


def sphere_function(point: Array, sphere: Array) -> np.ndarray:
    """Return |p − c|² − r², which is zero on a sphere and negative inside.

    Parameters
    ----------
    point : array
        Points p, ``[3]`` or ``[m, 3]``.
    sphere : array
        Centre c and radius r, ``[4]``.

    Returns
    -------
    numpy.ndarray
        ``[m]``.

    Examples
    --------
    >>> from odak.raytracing import sphere_function
    >>> sphere_function([[0, 0, 0], [3, 0, 0]], [0, 0, 0, 2]).tolist()
    [-4.0, 5.0]
    """
    point = arguments.batch(arguments.points("point", point), 1)
    sphere = arguments.numbers("sphere", sphere, 4)
    _validate.fitting(point=point, sphere=sphere[..., :3])
    arm = point - sphere[..., :3]
    return geometry.dot(arm, arm) - sphere[..., 3] ** 2


def define_cylinder(center: Sequence[float], radius: float, rotation: Sequence[float] = _NONE) -> np.ndarray:
    """Return an infinite cylinder as ``[c, r, q]``, q a point of its axis one unit from c.

    Parameters
    ----------
    center : sequence of float
        A point of the axis, ``[3]``.
    radius : float
        Radius.
    rotation : sequence of float
        Degrees about X, Y and Z that turn the axis away from +z.

    Returns
    -------
    numpy.ndarray
        float64 ``[7]``.

    Examples
    --------
    >>> from odak.raytracing import define_cylinder
    >>> define_cylinder([0, 0, 4], 2.0)
    array([0., 0., 4., 2., 0., 0., 5.])
    """
    center = arguments.finite_points("center", center).reshape(3).astype(np.float64)
    axis = rotation_matrix(arguments.finite_points("rotation", rotation).reshape(3).astype(np.float64))[:, 2]
    return np.concatenate((center, _radius(radius), center + axis))


def cylinder_function(point: Array, cylinder: Array) -> np.ndarray:
    """Return the squared distance to the axis of a cylinder minus the squared radius.

    Parameters
    ----------
    point : array
        Points p, ``[3]`` or ``[m, 3]``.
    cylinder : array
        ``[7]`` of :func:`define_cylinder`.

    Returns
    -------
    numpy.ndarray
        ``[m]``: zero on the cylinder, negative inside.

    Notes
    -----
    |(p − c) × a|² − r² with the unit axis a.

    Examples
    --------
    >>> from odak.raytracing import cylinder_function, define_cylinder
    >>> cylinder_function([[0, 0, 9], [3, 0, 9]], define_cylinder([0, 0, 0], 2)).tolist()
    [-4.0, 5.0]
    """
    point = arguments.batch(arguments.points("point", point), 1)
    center, radius, axis = split_cylinder(cylinder)
    _validate.fitting(point=point, cylinder=center)
    arm = geometry.cross(*np.broadcast_arrays(point - center, geometry.unit(axis)))
    return geometry.dot(arm, arm) - radius**2


def split_cylinder(cylinder) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return centre ``[..., 3]``, radius ``[...]`` and axis ``[..., 3]`` of cylinders ``[..., 7]``."""
    cylinder = arguments.numbers("cylinder", cylinder, 7)
    return cylinder[..., :3], cylinder[..., 3], cylinder[..., 4:] - cylinder[..., :3]


def _radius(radius) -> np.ndarray:
    value = arguments.floats("radius", radius).reshape(-1)
    if value.size != 1 or not (np.isfinite(value[0]) and value[0] >= 0):
        raise ValueError(f"radius must be one finite number, at least 0, got {radius!r}")
    return value
