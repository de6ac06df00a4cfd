"""A height map as a mesh of triangles, differentiable in its heights."""

from collections.abc import Sequence
from typing import Any

import torch

from odak import _validate
from odak.learn._tensors import checked_device, reals_of, trainable
from odak.learn.raytracing.boundary import reflect
from odak.learn.raytracing.triangles import triangle_mesh
from odak.learn.tools.file import save_torch_tensor
from odak.raytracing import arguments
from odak.tools.asset import write_PLY
from odak.tools.transformation import apply_matrix, rotation_matrix

__all__ = ["planar_mesh"]


class planar_mesh:
    """A rectangle of triangles whose vertices can be lifted, to be learned.

    Parameters
    ----------
    size : sequence of float
        Extent along x and y, about the origin.
    number_of_meshes : sequence of int
        Number of vertices n0, n1 along x and y; there are (n0 − 1)·(n1 − 1) squares of two triangles each.
    angles : torch.Tensor
        Degrees about X, Y and Z, applied in this order about the origin.
    offset : torch.Tensor
        Shift after the rotation, ``[3]``.
    device : torch.device, optional
        By default that of `heights`, else the CPU.
    heights : torch.Tensor, optional
        Heights along the rotated z axis, ``[n0, n1, 1]``; zeros by default.

    Attributes
    ----------
    heights : torch.Tensor
        Leaf ``[n0, n1, 1]`` that requires a gradient; the tensor given, when it was one.
    X : torch.Tensor
        Positions of the vertices along x, ``[n0, n1, 1]``.
    Y : torch.Tensor
        Positions of the vertices along y, ``[n0, n1, 1]``.
    ray_indices : torch.Tensor or None
        After :meth:`mirror`: which ray each of the reflected ones was, ``[k]``.

    Raises
    ------
    ValueError
        If a shape is wrong.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import planar_mesh
    >>> mesh = planar_mesh(size=[2.0, 2.0], number_of_meshes=[3, 3])
    >>> rays, normals = mesh.mirror(torch.tensor([[[0.2, -3.0, 5.0], [0.0, 0.6, -0.8]]]))
    >>> rays.detach()
    tensor([[[0.2000, 0.7500, 0.0000],
             [0.0000, 0.6000, 0.8000]]])
    """

    def __init__(
        self,
        size: Sequence[float] = (1.0, 1.0),
        number_of_meshes: Sequence[int] = (10, 10),
        angles: torch.Tensor | None = None,
        offset: torch.Tensor | None = None,
        device: torch.device | str | None = None,
        heights: torch.Tensor | None = None,
    ) -> None:
        device = heights.device if device is None and torch.is_tensor(heights) else checked_device("device", device)
        self.device = torch.device("cpu") if device is None else device
        self.number_of_meshes = torch.tensor(_validate.size("number_of_meshes", number_of_meshes), device=self.device)
        none = [0.0, 0.0, 0.0]
        given = [size, none if angles is None else angles, none if offset is None else offset]
        given = [v.to(self.device) if torch.is_tensor(v) else v for v in given]
        size, angles, offset = reals_of(size=given[0], angles=given[1], offset=given[2])
        for name, value, count in (("size", size, 2), ("angles", angles, 3), ("offset", offset, 3)):
            if value.numel() != count:
                raise ValueError(f"{name} must be {count} numbers, got {tuple(value.shape)}")
        self.size, self.angles, self.offset = (v.reshape(-1).to(self.device) for v in (size, angles, offset))
        self.ray_indices: torch.Tensor | None = None
        self._mesh: triangle_mesh | None = None
        self.init_heights(heights)

    def init_heights(self, heights: Any = None) -> None:
        """Set the heights, ``[n0, n1, 1]``, and the places of the vertices.

        A tensor is taken as it is and made to require a gradient; None gives zeros.
        """
        n0, n1 = self.number_of_meshes.tolist()
        if heights is None:
            heights = torch.zeros(n0, n1, 1, dtype=self.size.dtype, device=self.device)
        if not torch.is_tensor(heights) or not heights.dtype.is_floating_point:
            raise TypeError("heights must be a tensor of real numbers")
        if tuple(heights.shape) != (n0, n1, 1):
            raise ValueError(f"heights must be [{n0}, {n1}, 1], got {tuple(heights.shape)}")
        heights = trainable(heights.to(self.device))
        self.heights = heights if heights.requires_grad else heights.requires_grad_()
        dtype = torch.promote_types(heights.dtype, self.size.dtype)
        axes = (
            half * torch.linspace(-1, 1, n, dtype=dtype, device=self.device)
            for half, n in zip(self.size.to(dtype) / 2, (n0, n1), strict=True)
        )
        self.X, self.Y = (axis[..., None] for axis in torch.meshgrid(*axes, indexing="ij"))

    def get_squares(self) -> torch.Tensor:
        """Return the vertices before rotation and shift, ``[n0, n1, 3]``: x, y, height."""
        return torch.cat((self.X, self.Y, self.heights.to(self.X.dtype)), dim=-1)

    def get_triangles(self) -> torch.Tensor:
        """Return the triangles in space, ``[2·(n0 − 1)·(n1 − 1), 3, 3]``.

        First (i+1, j), (i+1, j+1), (i, j+1) of all squares, j fast, then (i+1, j), (i, j+1), (i, j). Flat, their
        normals point along the rotated z axis.
        """
        return self._vertices()[self._faces()]

    def get_mesh(self) -> triangle_mesh:
        """Return the mesh for :meth:`triangle_mesh.intersect`, with its graph."""
        vertices = self._vertices()
        if self._mesh is None:
            self._mesh = triangle_mesh(vertices.detach(), self._faces(), backend="torch")
        return self._mesh.moved(vertices)

    def mirror(self, rays: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Reflect rays at their first intersection with the mesh ahead of them, on either side of it.

        Parameters
        ----------
        rays : torch.Tensor
            ``[2, 3]`` or ``[m, 2, 3]``.

        Returns
        -------
        tuple of torch.Tensor
            Reflected rays and normals, ``[k, 2, 3]`` each, which start at the points hit. Rays that miss are left out;
            the others are sorted by triangle, and within a triangle as given: :attr:`ray_indices` says which they were.
        """
        rays = rays.to(self.device) if torch.is_tensor(rays) else rays
        rays, _ = reals_of(rays=rays, heights=self.heights)
        rays = arguments.rays("rays", rays).reshape(-1, 2, 3)
        hit = self.get_mesh().intersect(rays)
        struck = hit.hit.nonzero().flatten()
        self.ray_indices = struck[hit.face[struck].argsort(stable=True)]
        normals = hit.normals[self.ray_indices]
        return reflect(rays[self.ray_indices], normals), normals

    def save_heights(self, filename: str = "heights.pt") -> None:
        """Write the heights to a ``.pt`` or ``.pth`` file, without their autograd graph, atomically.

        Parameters
        ----------
        filename : str
            Path of the file, default "heights.pt".
        """
        save_torch_tensor(filename, self.heights.detach().clone())

    def save_heights_as_PLY(self, filename: str = "mesh.ply") -> None:
        """Write the triangles in space as a PLY text file, with three vertices each.

        Parameters
        ----------
        filename : str
            Path of the file, default "mesh.ply".
        """
        write_PLY(self.get_triangles().detach().cpu().numpy(), filename)

    def _vertices(self) -> torch.Tensor:
        points = self.get_squares().reshape(-1, 3)
        angles, offset = self.angles.to(points.dtype), self.offset.to(points.dtype)
        return apply_matrix(rotation_matrix(angles), points) + offset

    def _faces(self) -> torch.Tensor:
        n0, n1 = self.number_of_meshes.tolist()
        index = torch.arange(n0 * n1, device=self.device).reshape(n0, n1)
        near, right, up, far = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
        halves = ((right, far, up), (right, up, near))
        return torch.cat([torch.stack(corners, dim=-1).reshape(-1, 3) for corners in halves])
