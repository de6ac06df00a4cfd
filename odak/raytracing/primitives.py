"""Definitions of planes, triangles, circles, spheres and cylinders, and tests of points on them."""

from collections.abc import Sequence
from typing import Any

from odak import _array, _validate
from odak._array import Array, namespace
from odak.raytracing import arguments, geometry
from odak.tools.transformation import apply_matrix, rotation_matrix

# Corners of a plane without tilt; the last one coincides with the point of the plane.
PLANE_CORNERS = ((10.0, 10.0, 0.0), (0.0, 10.0, 0.0), (0.0, 0.0, 0.0))
_NONE = (0.0, 0.0, 0.0)


def define_plane(point: Sequence[float] | Array, angles: Sequence[float] | Array = _NONE) -> Array:
    """Return three points of a plane through `point`, tilted.

    Parameters
    ----------
    point : sequence of float or array
        ``[3]``; the last of the three points.
    angles : sequence of float or array
        Degrees about X, Y and Z, applied in this order. Without tilt the plane is z = point[2].

    Returns
    -------
    array
        ``[3, 3]``, a point per row; the right-hand normal is the rotated z axis.

    Examples
    --------
    >>> from odak.raytracing import define_plane
    >>> define_plane([0, 0, 5]).tolist()
    [[10.0, 10.0, 5.0], [0.0, 10.0, 5.0], [0.0, 0.0, 5.0]]
    """
    point, angles = _validate.reals(point=point, angles=angles)
    matrix = rotation_matrix(arguments.vector("angles", angles))
    return arguments.vector("point", point) + apply_matrix(matrix, _array.cast(PLANE_CORNERS, point))


def bring_plane_to_origin(
    point: Array,
    plane: Array | None,
    shape: Sequence[float] = (10.0, 10.0),
    center: Sequence[float] | Array = _NONE,
    angles: Sequence[float] | Array = _NONE,
    mode: str = "XYZ",
) -> Array:
    """Return points in the frame of a plane that was rotated by `angles` and moved to `center`.

    Parameters
    ----------
    point : array
        ``[3]`` or ``[m, 3]``.
    plane : array or None
        Ignored; accepted for compatibility with earlier versions.
    shape : sequence of float, default: (10.0, 10.0)
        Ignored; accepted for compatibility with earlier versions.
    center : sequence of float or array
        Centre of the plane.
    angles : sequence of float or array
        Rotation of the plane in degrees about X, Y and Z.
    mode : str
        Order of the rotations, as in :func:`odak.tools.rotate_point`.

    Returns
    -------
    array
        R⁻¹·(point − center), ``[3]`` or ``[m, 3]``.

    Examples
    --------
    >>> from odak.raytracing import bring_plane_to_origin
    >>> bring_plane_to_origin([2, 1, 1], None, center=[1, 1, 1], angles=[0, 0, 90]).round(12) + 0
    array([ 0., -1.,  0.])
    """
    point, center, angles = _validate.reals(point=point, center=center, angles=angles)
    point, center = arguments.points("point", point), arguments.points("center", center)
    _validate.fitting(point=point, center=center)
    matrix = rotation_matrix(arguments.vector("angles", angles), mode)
    return arguments.single(apply_matrix(namespace(matrix).matrix_transpose(matrix), point - center))


def center_of_triangle(triangle: Array) -> Array:
    """Return the mean of the corners of triangles.

    Parameters
    ----------
    triangle : array
        One triangle ``[3, 3]``, or several ``[m, 3, 3]``.

    Returns
    -------
    array
        ``[m, 3]``, and ``[1, 3]`` for one triangle.

    Examples
    --------
    >>> from odak.raytracing import center_of_triangle
    >>> center_of_triangle([[0, 0, 0], [3, 0, 0], [0, 6, 0]]).tolist()
    [[1.0, 2.0, 0.0]]
    """
    (triangle,) = _validate.reals(triangle=triangle)
    return namespace(triangle).mean(arguments.triangles("triangle", triangle), axis=-2)


def is_it_on_triangle(pointtocheck: Array, point0: Array, point1: Array, point2: Array) -> bool | Array:
    """Return whether a point, projected along the normal of a triangle, lies within it or on one of its edges.

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
    bool or array
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
    given = {"pointtocheck": pointtocheck, "point0": point0, "point1": point1, "point2": point2}
    made = zip(given, _validate.reals(**given), strict=True)
    result = geometry.is_on_triangle(*(_validate.shaped(name, value, "[..., 3]") for name, value in made))
    return bool(result) if result.ndim == 0 else result


def define_circle(center: Array, radius: float, angles: Sequence[float] | Array) -> list[Any]:
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
    plane = define_plane(arguments.vector("center", *_validate.reals(center=center)), angles)
    arguments.vector("radius", arguments.radius(radius, plane), 1)
    return [plane, center, radius]


def define_sphere(center: Sequence[float] | Array, radius: float | Array) -> Array:
    """Return spheres as ``[c_x, c_y, c_z, r]``.

    Parameters
    ----------
    center : sequence of float or array
        ``[3]`` or ``[m, 3]``.
    radius : float or array
        Radius, in the unit of the centre: a number, ``[1]``, ``[m]`` or ``[m, 1]``.

    Returns
    -------
    array
        ``[4]`` for one sphere, else ``[m, 4]``; a single centre or a single radius is broadcast.

    Examples
    --------
    >>> from odak.raytracing import define_sphere
    >>> define_sphere([0, 0, 5], 3.0)
    array([0., 0., 5., 3.])
    """
    (center,) = _validate.reals(center=center)
    return arguments.single(_rows(center=center, radius=arguments.radius(radius, center)))


def sphere_function(point: Array, sphere: Array) -> Array:
    """Return |p − c|² − r², which is zero on a sphere and negative inside.

    Parameters
    ----------
    point : array
        Points p, ``[3]`` or ``[m, 3]``.
    sphere : array
        Centre c and radius r, ``[4]``.

    Returns
    -------
    array
        ``[m]``.

    Examples
    --------
    >>> from odak.raytracing import sphere_function
    >>> sphere_function([[0, 0, 0], [3, 0, 0]], [0, 0, 0, 2]).tolist()
    [-4.0, 5.0]
    """
    point, sphere = _validate.reals(point=point, sphere=sphere)
    point, sphere = arguments.points("point", point), arguments.shaped("sphere", sphere, (4,), "[4] or [m, 4]")
    _validate.fitting(point=point, sphere=sphere[..., :3])
    arm = point - sphere[..., :3]
    return geometry.dot(arm, arm) - sphere[..., 3] ** 2


def define_cylinder(
    center: Sequence[float] | Array, radius: float | Array, rotation: Sequence[float] | Array = _NONE
) -> Array:
    """Return infinite cylinders as ``[c, r, q]``, q a point of the axis one unit from c.

    Parameters
    ----------
    center : sequence of float or array
        A point of the axis, ``[3]`` or ``[m, 3]``.
    radius : float or array
        Radius: a number, ``[1]``, ``[m]`` or ``[m, 1]``.
    rotation : sequence of float or array
        Degrees about X, Y and Z by which the axis is rotated from +z, ``[3]`` or ``[m, 3]``.

    Returns
    -------
    array
        ``[7]`` for one cylinder, else ``[m, 7]``; single arguments are broadcast.

    Examples
    --------
    >>> from odak.raytracing import define_cylinder
    >>> define_cylinder([0, 0, 4], 2.0)
    array([0., 0., 4., 2., 0., 0., 5.])
    """
    center, rotation = _validate.reals(center=center, rotation=rotation)
    axis = rotation_matrix(arguments.listed("rotation", rotation, (3,), "[3] or [m, 3]"))[..., 2]
    rows = _rows(center=center, radius=arguments.radius(radius, center), rotation=axis)
    xp = namespace(rows)
    return arguments.single(xp.concat((rows[:, :4], rows[:, :3] + rows[:, 4:]), axis=-1))


def cylinder_function(point: Array, cylinder: Array) -> Array:
    """Return the squared distance to the axis of a cylinder minus the squared radius.

    Parameters
    ----------
    point : array
        Points p, ``[3]`` or ``[m, 3]``.
    cylinder : array
        ``[7]`` of :func:`define_cylinder`.

    Returns
    -------
    array
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
    point, cylinder = _validate.reals(point=point, cylinder=cylinder)
    center, radius, axis = split_cylinder(cylinder)
    point = arguments.points("point", point)
    _validate.fitting(point=point, cylinder=center)
    arm = geometry.cross(*namespace(point).broadcast_arrays(point - center, geometry.unit(axis)))
    return geometry.dot(arm, arm) - radius**2


def split_cylinder(cylinder: Any) -> tuple[Any, Any, Any]:
    """Return centre ``[m, 3]``, radius ``[m]`` and axis ``[m, 3]`` of cylinders ``[..., 7]``."""
    cylinder = arguments.shaped("cylinder", cylinder, (7,), "[7] or [m, 7]")
    return cylinder[..., :3], cylinder[..., 3], cylinder[..., 4:] - cylinder[..., :3]


def _rows(center, radius, **more):
    """Return centres, radii and what follows as rows ``[m, ...]``; single ones are broadcast."""
    xp = namespace(center)
    center = arguments.listed("center", center, (3,), "[3] or [m, 3]")
    columns = {"center": center, "radius": xp.reshape(radius, (-1, 1)), **more}
    (count,) = _validate.fitting(**{name: value[:, 0] for name, value in columns.items()})
    return xp.concat([xp.broadcast_to(v, (count, v.shape[-1])) for v in columns.values()], axis=-1)
