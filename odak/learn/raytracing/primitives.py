"""Planes, triangles, circles and spheres as tensors, and the test whether points lie on triangles."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch

from odak import _validate
from odak.learn._face import face_of, torch_face
from odak.learn._tensors import reals_of
from odak.raytracing import arguments
from odak.raytracing import primitives as core
from odak.raytracing.intersections import within
from odak.tools.transformation import apply_matrix, rotation_matrix

if TYPE_CHECKING:
    from odak.learn._faces.raytracing_primitives import *  # noqa: F403

_ORIGIN = (0.0, 0.0, 0.0)


def batched(result: Any, axes: int) -> Any:
    """Return what a function of the core returns, arrays or a tuple of them, with a batch axis in front of `axes`."""
    if isinstance(result, tuple):
        return tuple(arguments.batch(value, axes) for value in result)
    return arguments.batch(result, axes)


def placed_sheet(
    device: torch.device, size: Sequence[float] | torch.Tensor, **vectors: torch.Tensor | None
) -> list[torch.Tensor]:
    """Return the two sides of a sheet and vectors of three numbers, zeros where they are None, on a device."""
    given = {"size": size} | {name: list(_ORIGIN) if value is None else value for name, value in vectors.items()}
    given = {name: value.to(device) if torch.is_tensor(value) else value for name, value in given.items()}
    values = reals_of(**given)
    for name, value in zip(given, values, strict=True):
        count = 2 if name == "size" else 3
        if value.numel() != count:
            raise ValueError(f"{name} must be {count} numbers, got {tuple(value.shape)}")
    return [value.reshape(-1).to(device) for value in values]


def sheet_axes(size: torch.Tensor, counts: Sequence[int]) -> list[torch.Tensor]:
    """Return coordinates of a grid on a sheet about its middle, from edge to edge along both sides."""
    return [
        half * torch.linspace(-1, 1, count, dtype=half.dtype, device=half.device)
        for half, count in zip(size / 2, counts, strict=True)
    ]


def sheet_points(size: torch.Tensor, counts: Sequence[int], matrix: torch.Tensor, center: torch.Tensor) -> torch.Tensor:
    """Return the points ``[m, 3]`` of a grid on a sheet, rotated and moved to its centre."""
    x, y = torch.meshgrid(*sheet_axes(size, counts), indexing="ij")
    return apply_matrix(matrix, torch.stack((x, y, torch.zeros_like(x)), dim=-1).reshape(-1, 3)) + center


if not TYPE_CHECKING:

    @face_of(core.bring_plane_to_origin, tensors=("point", "center", "angles"), defaults={"plane": None})
    def bring_plane_to_origin(function, **given):
        """Return points in the frame of a plane that was rotated by `angles` and moved to `center`.

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
        return batched(function(**given), 1)

    center_of_triangle = torch_face(core.center_of_triangle, tensors=("triangle",))

    cylinder_function = torch_face(core.cylinder_function, tensors=("point", "cylinder"))

    @face_of(core.define_circle, tensors=("center", "radius", "angles"))
    def define_circle(core, center, radius, angles):
        """Return a circle as [plane ``[3, 3]``, centre ``[3]``, radius ``[1]``].

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import define_circle
        >>> plane, center, radius = define_circle(torch.tensor([0.0, 0.0, 5.0]), torch.tensor([2.0]), torch.zeros(3))
        >>> plane[:, 2].tolist(), radius.tolist()
        ([5.0, 5.0, 5.0], [2.0])
        """
        return core(center, arguments.vector("radius", radius, 1), angles)

    @face_of(core.define_cylinder, tensors=("center", "radius", "rotation"))
    def define_cylinder(function, **given):
        """Return infinite cylinders as ``[c, r, q]``, q a point of the axis one unit from c.

        Returns
        -------
        torch.Tensor
            ``[m, 7]``; single arguments are broadcast.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import define_cylinder
        >>> define_cylinder(torch.tensor([0.0, 0.0, 4.0]), 2.0)
        tensor([[0., 0., 4., 2., 0., 0., 5.]])
        """
        return batched(function(**given), 1)

    define_plane = torch_face(core.define_plane, tensors=("point", "angles"))

    @face_of(core.define_sphere, tensors=("center", "radius"), defaults={"center": None, "radius": None})
    def define_sphere(function, center=None, radius=None):
        """Return spheres as ``[c_x, c_y, c_z, r]``.

        Parameters
        ----------
        center : torch.Tensor, optional
            ``[3]`` or ``[m, 3]``; the origin by default.
        radius : torch.Tensor or float, optional
            A number, ``[1]``, ``[m]`` or ``[m, 1]``; 1 by default.

        Returns
        -------
        torch.Tensor
            ``[m, 4]``; a single centre or a single radius is broadcast.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import define_sphere
        >>> define_sphere(torch.tensor([0.0, 0.0, 5.0]), torch.tensor([3.0]))
        tensor([[0., 0., 5., 3.]])
        """
        return arguments.batch(function(_ORIGIN if center is None else center, 1.0 if radius is None else radius), 1)

    sphere_function = torch_face(core.sphere_function, tensors=("point", "sphere"))


def define_plane_mesh(
    number_of_meshes: Sequence[int] = (10, 10),
    size: Sequence[float] = (1.0, 1.0),
    angles: torch.Tensor | Sequence[float] = _ORIGIN,
    offset: torch.Tensor | Sequence[float] = _ORIGIN,
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
    size, angles, offset = reals_of(size=size, angles=angles, offset=offset)
    offset = arguments.listed("offset", offset, (3,), "[3] or [m, 3]")
    if len(offset) not in (1, 2 * n0 * n1):
        raise ValueError(f"offset must be [3], [1, 3] or [{2 * n0 * n1}, 3], got {tuple(offset.shape)}")
    axes = (
        (torch.arange(n + 1, dtype=size.dtype, device=size.device) / n - 0.5) * extent
        for n, extent in zip((n0, n1), arguments.vector("size", size, 2), strict=True)
    )
    x, y = torch.meshgrid(*axes, indexing="ij")
    grid = torch.stack((x, y, torch.zeros_like(x)), dim=-1)
    near, right, up, far = grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]
    corners = [torch.stack(c, dim=-2).reshape(-1, 3, 3) for c in ((near, right, up), (far, right, up))]
    matrix = rotation_matrix(arguments.vector("angles", angles))
    return apply_matrix(matrix, torch.cat(corners)) + offset[:, None]


def is_it_on_triangle(point_to_check: torch.Tensor, triangle: torch.Tensor) -> torch.Tensor:
    """Return which points lie on which triangles, judged along the triangles' normals.

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
    point, triangle = reals_of(point_to_check=point_to_check, triangle=triangle)
    point, triangle = arguments.points("point_to_check", point), arguments.triangles("triangle", triangle)
    return within(point, point.isfinite().all(dim=-1), triangle[:, None])


def is_it_on_triangle_batch(point_to_check: torch.Tensor, triangle: torch.Tensor) -> torch.Tensor:
    """Return which points lie on the triangle of their row, judged along its normal.

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
    point, triangle = reals_of(point_to_check=point_to_check, triangle=triangle)
    triangle = arguments.listed("triangle", triangle, (3, 3), "[3, 3] or [k, 3, 3]")
    point = arguments.shaped("point_to_check", point, (3,), "[k, m, 3]")
    _validate.fitting(point_to_check=point[..., 0], triangle=triangle[..., 0, :1])
    return within(point, point.isfinite().all(dim=-1), triangle[:, None])
