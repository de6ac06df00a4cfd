"""Planes, triangles, circles and spheres as tensors, and the test whether points lie on triangles."""

from collections.abc import Sequence
from typing import Any

import torch

from odak import _validate
from odak.learn.raytracing import arguments
from odak.raytracing.geometry import cross, dot, unit
from odak.raytracing.intersections import within
from odak.raytracing.primitives import PLANE_CORNERS
from odak.tools.transformation import apply_matrix, rotation_matrix

_NONE = torch.tensor([0.0, 0.0, 0.0])


def define_plane(point: torch.Tensor, angles: torch.Tensor = _NONE) -> torch.Tensor:
    """Return three points of a plane through `point`, tilted.

    Parameters
    ----------
    point : torch.Tensor
        ``[3]``; the last of the three points.
    angles : torch.Tensor
        Degrees about X, Y and Z, applied in this order. Without tilt the plane is z = point[2].

    Returns
    -------
    torch.Tensor
        ``[3, 3]``, a point per row; the right-hand normal is the rotated z axis.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import define_plane
    >>> define_plane(torch.tensor([0.0, 0.0, 5.0]))[:, 2].tolist()
    [5.0, 5.0, 5.0]
    """
    point, angles = _beside(point, angles)
    if point.numel() != 3 or angles.numel() != 3:
        raise ValueError(f"point and angles must be [3], got {tuple(point.shape)} and {tuple(angles.shape)}")
    corners = torch.tensor(PLANE_CORNERS, dtype=point.dtype, device=point.device)
    return point.reshape(3) + apply_matrix(rotation_matrix(angles.reshape(3)), corners)


def define_plane_mesh(
    number_of_meshes: Sequence[int] = (10, 10),
    size: Sequence[float] = (1.0, 1.0),
    angles: torch.Tensor = _NONE,
    offset: torch.Tensor = _NONE,
) -> torch.Tensor:
    """Return a flat rectangle cut into triangles.

    Parameters
    ----------
    number_of_meshes : sequence of int
        Number of squares n0, n1 along x and y.
    size : sequence of float
        Extent along x and y, about the origin.
    angles : torch.Tensor
        Degrees about X, Y and Z, applied in this order about the rectangle's centre.
    offset : torch.Tensor
        Shift after the rotation: ``[3]``, ``[1, 3]``, or ``[2·n0·n1, 3]`` for one per triangle.

    Returns
    -------
    torch.Tensor
        ``[2·n0·n1, 3, 3]``: the triangles (i, j), (i+1, j), (i, j+1) of all squares, the second index fast, then the
        triangles (i+1, j+1), (i+1, j), (i, j+1).

    Examples
    --------
    >>> from odak.learn.raytracing import define_plane_mesh
    >>> define_plane_mesh([1, 1], [2.0, 2.0])[0]
    tensor([[-1., -1.,  0.],
            [ 1., -1.,  0.],
            [-1.,  1.,  0.]])
    """
    n0, n1 = _validate.size("number_of_meshes", number_of_meshes)
    # The defaults are taken as plain numbers: they must not decide the device.
    angles, offset = ([0.0, 0.0, 0.0] if v is _NONE else v for v in (angles, offset))
    size, angles, offset = arguments.tensors(size=size, angles=angles, offset=offset)
    if size.numel() != 2 or angles.numel() != 3:
        raise ValueError(f"size must be [2] and angles [3], got {tuple(size.shape)} and {tuple(angles.shape)}")
    offset = arguments.listed("offset", offset, (3,), "[3] or [m, 3]")
    if len(offset) not in (1, 2 * n0 * n1):
        raise ValueError(f"offset must be [3], [1, 3] or [{2 * n0 * n1}, 3], got {tuple(offset.shape)}")
    axes = (
        (torch.arange(n + 1, dtype=size.dtype, device=size.device) / n - 0.5) * extent
        for n, extent in zip((n0, n1), size.reshape(2), strict=True)
    )
    x, y = torch.meshgrid(*axes, indexing="ij")
    grid = torch.stack((x, y, torch.zeros_like(x)), dim=-1)
    near, right, up, far = grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]
    corners = [torch.stack(c, dim=-2).reshape(-1, 3, 3) for c in ((near, right, up), (far, right, up))]
    return apply_matrix(rotation_matrix(angles.reshape(3)), torch.cat(corners)) + offset[:, None]


def bring_plane_to_origin(
    point: torch.Tensor,
    plane: Any = None,
    shape: Any = (10.0, 10.0),
    center: torch.Tensor = _NONE,
    angles: torch.Tensor = _NONE,
    mode: str = "XYZ",
) -> torch.Tensor:
    """Return points in the frame of a plane that was rotated by `angles` and moved to `center`.

    Parameters
    ----------
    point : torch.Tensor
        ``[3]`` or ``[m, 3]``.
    plane : object, optional
        Not used; kept so that the call equals that of :func:`odak.raytracing.bring_plane_to_origin`.
    shape : sequence of float, default: (10.0, 10.0)
        Not used; kept for the same reason.
    center : torch.Tensor
        Centre of the plane, ``[3]``; the origin by default.
    angles : torch.Tensor
        Rotation of the plane in degrees about X, Y and Z, ``[3]``; none by default.
    mode : str
        Order of the rotations, as in :func:`odak.learn.tools.rotate_points`.

    Returns
    -------
    torch.Tensor
        R⁻¹·(point − center), ``[m, 3]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import bring_plane_to_origin
    >>> bring_plane_to_origin(torch.tensor([2.0, 1.0, 1.0]), center=torch.tensor([1.0, 1.0, 1.0])).tolist()
    [[1.0, 0.0, 0.0]]
    """
    center, angles = ([0.0, 0.0, 0.0] if v is _NONE else v for v in (center, angles))
    point, center, angles = arguments.tensors(point=point, center=center, angles=angles)
    if center.numel() != 3 or angles.numel() != 3:
        raise ValueError(f"center and angles must be [3], got {tuple(center.shape)} and {tuple(angles.shape)}")
    return apply_matrix(
        rotation_matrix(angles.reshape(3), mode).mT, arguments.points("point", point) - center.reshape(3)
    )


def center_of_triangle(triangle: Any) -> torch.Tensor:
    """Return the mean of the corners of triangles.

    Parameters
    ----------
    triangle : torch.Tensor
        One triangle ``[3, 3]``, or several ``[m, 3, 3]``.

    Returns
    -------
    torch.Tensor
        ``[m, 3]``, and ``[1, 3]`` for one triangle.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import center_of_triangle
    >>> center_of_triangle(torch.tensor([[0.0, 0, 0], [3, 0, 0], [0, 6, 0]])).tolist()
    [[1.0, 2.0, 0.0]]
    """
    (triangle,) = arguments.tensors(triangle=triangle)
    return arguments.triangles("triangle", triangle).mean(dim=-2)


def is_it_on_triangle(point_to_check: torch.Tensor, triangle: torch.Tensor) -> torch.Tensor:
    """Say which points lie on which triangles, judged along the triangles' normals.

    Parameters
    ----------
    point_to_check : torch.Tensor
        Points, ``[3]`` or ``[m, 3]``.
    triangle : torch.Tensor
        Triangles, ``[3, 3]`` or ``[k, 3, 3]``.

    Returns
    -------
    torch.Tensor
        bool ``[k, m]``. The first corner and the two edges at it belong to a triangle, its last edge does not. False
        for points and triangles that are not finite, and for triangles without area.

    Notes
    -----
    Barycentric: u ≥ 0, v ≥ 0 and u + v < 1 (blackpawn.com/texts/pointinpoly).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import is_it_on_triangle
    >>> is_it_on_triangle(torch.tensor([[1.0, 1, 0], [4, 4, 0]]), torch.tensor([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]))
    tensor([[ True, False]])
    """
    point, triangle = arguments.tensors(point_to_check=point_to_check, triangle=triangle)
    point, triangle = arguments.points("point_to_check", point), arguments.triangles("triangle", triangle)
    return within(point, point.isfinite().all(dim=-1), triangle[:, None])


def is_it_on_triangle_batch(point_to_check: Any, triangle: Any) -> torch.Tensor:
    """Say which points lie on the triangle of their row, judged along its normal.

    Parameters
    ----------
    point_to_check : torch.Tensor
        Points ``[k, m, 3]``: m of them for each triangle.
    triangle : torch.Tensor
        Triangles ``[k, 3, 3]``.

    Returns
    -------
    torch.Tensor
        bool ``[k, m]``, by the rule of :func:`is_it_on_triangle`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import is_it_on_triangle_batch
    >>> triangle = torch.tensor([[[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]])
    >>> is_it_on_triangle_batch(torch.tensor([[[1.0, 1, 0], [4, 4, 0]]]), triangle).tolist()
    [[True, False]]
    """
    point, triangle = arguments.tensors(point_to_check=point_to_check, triangle=triangle)
    triangle = arguments.listed("triangle", triangle, (3, 3), "[k, 3, 3]")
    point = arguments.shaped("point_to_check", point, (3,), "[k, m, 3]")
    _validate.fitting(point_to_check=point[..., 0], triangle=triangle[..., 0, :1])
    return within(point, point.isfinite().all(dim=-1), triangle[:, None])


def define_sphere(center: torch.Tensor | None = None, radius: torch.Tensor | None = None) -> torch.Tensor:
    """Return spheres as ``[m, 4]``: centre and radius.

    Parameters
    ----------
    center : torch.Tensor
        ``[3]``, ``[1, 3]`` or ``[m, 3]``; the origin by default.
    radius : torch.Tensor
        A number, ``[1]``, ``[m]`` or ``[m, 1]``; 1 by default.

    Returns
    -------
    torch.Tensor
        ``[m, 4]``; one centre serves many radii, and the reverse.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import define_sphere
    >>> define_sphere(torch.tensor([0.0, 0.0, 5.0]), torch.tensor([3.0]))
    tensor([[0., 0., 5., 3.]])
    """
    center = [[0.0, 0.0, 0.0]] if center is None else center
    center, radius = arguments.tensors(center=center, radius=[1.0] if radius is None else radius)
    center, radius = arguments.listed("center", center, (3,), "[3] or [m, 3]"), radius.reshape(-1, 1)
    if len(center) != len(radius) and 1 not in (len(center), len(radius)):
        raise ValueError(f"center and radius must be as many, or one; got {len(center)} and {len(radius)}")
    count = max(len(center), len(radius))
    return torch.cat((center.expand(count, 3), radius.expand(count, 1)), dim=-1)


def sphere_function(point: Any, sphere: Any) -> torch.Tensor:
    """Return |p − c|² − r², which is zero on a sphere and negative inside.

    Parameters
    ----------
    point : torch.Tensor
        Points p, ``[3]`` or ``[m, 3]``.
    sphere : torch.Tensor
        Centres c and radii r, ``[4]`` or ``[m, 4]``.

    Returns
    -------
    torch.Tensor
        ``[m]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import sphere_function
    >>> sphere_function(torch.tensor([[0.0, 0, 0], [3, 0, 0]]), torch.tensor([0.0, 0, 0, 2])).tolist()
    [-4.0, 5.0]
    """
    point, sphere = arguments.tensors(point=point, sphere=sphere)
    sphere = arguments.shaped("sphere", sphere, (4,), "[4] or [m, 4]")
    arm = arguments.points("point", point) - sphere[..., :3]
    return dot(arm, arm) - sphere[..., 3] ** 2


def define_circle(center: Any, radius: Any, angles: Any) -> list:
    """Return a circle as [plane ``[3, 3]``, centre, radius ``[1]``].

    Parameters
    ----------
    center : torch.Tensor
        Centre of the circle, ``[3]``.
    radius : float or torch.Tensor
        Radius, in the unit of the centre.
    angles : torch.Tensor
        Degrees about X, Y and Z, applied in this order. Without tilt the circle lies in z = center[2].

    Returns
    -------
    list
        Three points of the plane ``[3, 3]``, the centre and the radius, as :func:`intersect_w_circle` takes them.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import define_circle
    >>> plane, center, radius = define_circle(torch.tensor([0.0, 0.0, 5.0]), torch.tensor([2.0]), torch.zeros(3))
    >>> plane[:, 2].tolist(), radius.tolist()
    ([5.0, 5.0, 5.0], [2.0])
    """
    place, radius = arguments.tensors(center=center, radius=radius)
    plane = define_plane(arguments.vector("center", place), angles)
    return [plane, center, arguments.vector("radius", radius, 1).to(plane)]


def _beside(point, angles) -> list[torch.Tensor]:
    """Return both as tensors; the default angles do not widen or move anything."""
    return arguments.tensors(point=point, angles=[0.0, 0.0, 0.0] if angles is _NONE else angles)


def define_cylinder(
    center: torch.Tensor, radius: torch.Tensor, rotation: torch.Tensor | Sequence[float] = (0.0, 0.0, 0.0)
) -> torch.Tensor:
    """Return infinite cylinders as ``[m, 7]``: c, r and q, a point of the axis one unit from c.

    Parameters
    ----------
    center : torch.Tensor
        A point of the axis, ``[3]`` or ``[m, 3]``.
    radius : torch.Tensor
        A number, ``[1]``, ``[m]`` or ``[m, 1]``.
    rotation : torch.Tensor
        Degrees about X, Y and Z that turn the axis away from +z, ``[3]`` or ``[m, 3]``.

    Returns
    -------
    torch.Tensor
        ``[m, 7]``; one of each serves many of the others.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import define_cylinder
    >>> define_cylinder(torch.tensor([0.0, 0.0, 4.0]), 2.0)
    tensor([[0., 0., 4., 2., 0., 0., 5.]])
    """
    center, radius, rotation = arguments.tensors(center=center, radius=radius, rotation=rotation)
    center = arguments.listed("center", center, (3,), "[3] or [m, 3]")
    rotation = arguments.listed("rotation", rotation, (3,), "[3] or [m, 3]")
    axis, radius = rotation_matrix(rotation)[..., 2], radius.reshape(-1, 1)
    try:
        count = torch.broadcast_shapes(center.shape[:1], radius.shape[:1], axis.shape[:1])[0]
    except RuntimeError:
        sizes = f"{len(center)}, {len(radius)} and {len(axis)}"
        raise ValueError(f"center, radius and rotation must be as many, or one; got {sizes}") from None
    center, axis = center.expand(count, 3), axis.expand(count, 3)
    return torch.cat((center, radius.expand(count, 1), center + axis), dim=-1)


def cylinder_function(point: Any, cylinder: Any) -> torch.Tensor:
    """Return the squared distance to the axis of a cylinder minus the squared radius.

    Parameters
    ----------
    point : torch.Tensor
        Points p, ``[3]`` or ``[m, 3]``.
    cylinder : torch.Tensor
        ``[7]`` or ``[m, 7]`` of :func:`define_cylinder`.

    Returns
    -------
    torch.Tensor
        ``[m]``: zero on the cylinder, negative inside.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import cylinder_function, define_cylinder
    >>> cylinder_function(torch.tensor([[0.0, 0, 9], [3, 0, 9]]), define_cylinder(torch.zeros(3), 2.0)).tolist()
    [-4.0, 5.0]
    """
    point, cylinder = arguments.tensors(point=point, cylinder=cylinder)
    center, radius, axis = split_cylinder(cylinder)
    arm = arguments.points("point", point) - center
    across = cross(*torch.broadcast_tensors(arm, unit(axis)))
    return dot(across, across) - radius**2


def split_cylinder(cylinder) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return centre ``[m, 3]``, radius ``[m]`` and axis ``[m, 3]``."""
    cylinder = arguments.shaped("cylinder", cylinder, (7,), "[7] or [m, 7]")
    return cylinder[..., :3], cylinder[..., 3], cylinder[..., 4:] - cylinder[..., :3]
