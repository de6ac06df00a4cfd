"""Rays at surfaces: differentiable intersections, normals, reflection, refraction and detectors that count rays."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch

from odak import _show, _validate
from odak._array import is_readable
from odak._attributes import Prepared
from odak.learn._face import face_of, torch_face
from odak.learn._tensors import checked_device, reals_of
from odak.learn.raytracing.primitives import batched, define_plane, placed_sheet, sheet_axes, sheet_points
from odak.raytracing import arguments, intersections
from odak.raytracing import boundary as core
from odak.tools.transformation import apply_matrix, rotation_matrix

if TYPE_CHECKING:
    from odak.learn._faces.raytracing_boundary import *  # noqa: F403


def _triangle_hits(ray, triangle) -> tuple[Any, ...]:
    """Return normals ``[k, m, 2, 3]``, signed distances and membership ``[k, m]`` of m rays and k triangles."""
    triangle = _in_front(triangle, ray)
    return core.plane_hits(ray, triangle, intersections.on_triangle, (triangle,), (2,))


def _in_front(triangle: torch.Tensor, ray: torch.Tensor) -> torch.Tensor:
    """Return triangles ``[k, 3, 3]`` with their axis in front of all axes of the rays' batch."""
    return triangle.reshape(-1, *(1,) * (ray.ndim - 2), 3, 3)


def _picked(rays, normals, distance, hit) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the rays that hit with their normals, and the distances of all."""
    # If all rays hit, none are selected; on a GPU the test would require a synchronisation.
    if not (is_readable(hit) and bool(hit.all())):
        rays, normals = rays[hit], normals[hit]
    return rays, normals, distance, hit


if not TYPE_CHECKING:
    fresnel_coefficients = torch_face(core.fresnel_coefficients, tensors=("ray", "normal"))

    @face_of(core.get_cylinder_normal, tensors=("point", "cylinder"))
    def get_cylinder_normal(function, **given):
        """Return the outward normals of a cylinder at points of it, as rays from its axis.

        Returns
        -------
        torch.Tensor
            ``[m, 2, 3]``. Each starts at its point's foot on the axis.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import define_cylinder, get_cylinder_normal
        >>> get_cylinder_normal(torch.tensor([0.0, 2, 3]), define_cylinder(torch.zeros(3), 2.0)).tolist()
        [[[0.0, 0.0, 3.0], [0.0, 1.0, 0.0]]]
        """
        return batched(function(**given), 2)

    @face_of(core.get_sphere_normal, tensors=("point", "sphere"))
    def get_sphere_normal_torch(function, **given):
        """Return the rays from points of a sphere towards its centre.

        Returns
        -------
        torch.Tensor
            ``[m, 2, 3]``.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import get_sphere_normal_torch
        >>> get_sphere_normal_torch(torch.tensor([0.0, 0, 3]), torch.tensor([0.0, 0, 1, 2]))[0, 1].tolist()
        [0.0, 0.0, -1.0]
        """
        return batched(function(**given), 2)

    get_triangle_normal = torch_face(core.get_triangle_normal, tensors=("triangle", "triangle_center"))

    @face_of(core.reflect, tensors=("input_ray", "normal"))
    def reflect(_, input_ray, normal):
        """Reflect rays at surfaces: d' = d − 2(d·n)/(n·n)·n.

        Returns
        -------
        torch.Tensor
            ``[m, 2, 3]``: rays that start at the normals' points; NaN where a normal is zero.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import reflect
        >>> normal = torch.tensor([[1.0, 1.0, 1.0], [0.0, 0.0, 2.0]])
        >>> reflect(torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.6, 0.8]]), normal)[0, 1]
        tensor([ 0.0000,  0.6000, -0.8000])
        """
        return core.reflected_rays(input_ray, normal)

    @face_of(core.refract, tensors=("vector", "normvector", "n1", "n2"))
    def refract(_, vector, normvector, n1, n2, error=0.01):
        """Refract rays at surfaces by Snell's law.

        Returns
        -------
        torch.Tensor
            ``[m, 2, 3]``: rays that start at the normals' points. A totally reflected ray has a NaN direction and no
            gradient. Differentiable in rays, normals and indices.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import refract
        >>> normal = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        >>> refract(torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.6, 0.8]]), normal, 1.0, 1.5)[0, 1]
        tensor([0.0000, 0.4000, 0.9165])
        """
        return core.refracted_rays(vector, normvector, n1.reshape(-1), n2.reshape(-1))

    @face_of(core.intersect_w_surface, tensors=("ray", "points"))
    def intersect_w_surface(_, ray, points):
        """Intersect rays with the plane through three points.

        Parameters
        ----------
        points : torch.Tensor
            Three points, ``[3, 3]`` or ``[1, 3, 3]``; ``[m, 3, 3]`` gives each ray its own plane.

        Returns
        -------
        tuple of torch.Tensor
            Normals ``[m, 2, 3]`` (where the plane is met, unit normal) and distances ``[m, 1]``, negative behind the
            start. Point and distance are NaN for rays along the plane.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import define_plane, intersect_w_surface
        >>> ray = torch.tensor([[0.0, 0.0, 20.0], [0.0, 0.6, 0.8]])
        >>> intersect_w_surface(ray, define_plane(torch.tensor([0.0, 0.0, 10.0])))[1]
        tensor([[-12.5000]])
        """
        normal, distance = core.plane_hits(*arguments.rays_and_triangles(ray=ray, points=points))
        return normal, distance[..., None]

    @face_of(core.intersect_w_circle, tensors=("ray",))
    def intersect_w_circle(_, ray, circle):
        """Intersect rays with the plane of a circle; the distance is 0 where the intersection lies outside the circle.

        Returns
        -------
        tuple of torch.Tensor
            Normals as in :func:`intersect_w_surface` (``[2, 3]`` for a ray ``[2, 3]``) and distances ``[m, 1]``.

        Examples
        --------
        The first ray meets the disc of radius 2 at z = 5, the second one passes by:

        >>> import torch
        >>> from odak.learn.raytracing import define_circle, intersect_w_circle
        >>> circle = define_circle(torch.tensor([0.0, 0.0, 5.0]), torch.tensor([2.0]), torch.zeros(3))
        >>> rays = torch.tensor([[[1.0, 0, 0], [0, 0, 1]], [[3, 0, 0], [0, 0, 1]]])
        >>> intersect_w_circle(rays, circle)[1].flatten().tolist()
        [5.0, 0.0]
        """
        normal, distance = core.circle_hits(ray, circle)
        return normal, distance[..., None]

    @face_of(core.intersect_w_triangle, tensors=("ray", "triangle"))
    def intersect_w_triangle(_, ray, triangle):
        """Intersect rays with one triangle, ahead of the starts or behind them.

        Parameters
        ----------
        triangle : torch.Tensor
            ``[3, 3]`` or ``[1, 3, 3]``.

        Returns
        -------
        tuple
            - normals ``[m, 2, 3]``: where each ray meets the triangle's plane, and the unit normal;
            - distances ``[m, 1]`` to the plane, negative behind the start, NaN for rays along it;
            - the k rays that hit the triangle, ``[k, 2, 3]``;
            - their normals ``[k, 2, 3]``;
            - bool ``[1, m]``: which rays hit, by the rule of :func:`odak.learn.raytracing.is_it_on_triangle`.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import intersect_w_triangle
        >>> triangle = torch.tensor([[0.0, 0, 5], [4, 0, 5], [0, 4, 5]])
        >>> rays = torch.tensor([[[1.0, 1, 0], [0, 0, 1]], [[4, 4, 0], [0, 0, 1]]])
        >>> _, distances, _, _, hits = intersect_w_triangle(rays, triangle)
        >>> distances.flatten().tolist(), hits.tolist()
        ([5.0, 5.0], [[True, False]])
        """
        ray, triangle = arguments.rays("ray", ray), arguments.triangles("triangle", triangle)
        if len(triangle) != 1:
            raise ValueError(f"triangle must be one triangle [3, 3] or [1, 3, 3], got {tuple(triangle.shape)}")
        normal, distance, check = _triangle_hits(ray, triangle)
        return normal[0], distance[0][..., None], ray[check[0]], normal[0][check[0]], check

    @face_of(core.intersect_w_cylinder, tensors=("ray", "cylinder"))
    def intersect_w_cylinder(_, ray, cylinder):
        """Intersect rays with an infinite cylinder, at the nearest point ahead, or the exit when the ray starts inside.

        Returns
        -------
        tuple of torch.Tensor
            As :func:`odak.learn.raytracing.intersect_w_sphere`: rays ``[k, 2, 3]`` from the points hit, normals
            ``[k, 2, 3]`` from the axis outwards, distances ``[m]`` (NaN, without gradient, for misses and for rays
            along the axis), and which rays hit, ``[m]``.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import define_cylinder, intersect_w_cylinder
        >>> ray = torch.tensor([[-20.0, 0.0, 4.0], [1.0, 0.0, 0.0]])
        >>> intersect_w_cylinder(ray, define_cylinder(torch.zeros(3), 2.0))[2]
        tensor([18.])
        """
        return _picked(*core.cylinder_hits(ray, cylinder))


def intersect_w_sphere(
    ray: torch.Tensor,
    sphere: torch.Tensor,
    learning_rate: float = 2e-1,
    number_of_steps: int = 5000,
    error_threshold: float = 1e-2,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Intersect rays with a sphere in closed form, at the nearest point ahead, or the exit when the ray starts inside.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[m, 2, 3]``.
    sphere : torch.Tensor
        ``[4]`` or ``[1, 4]``, or ``[m, 4]``: one for each ray.
    learning_rate : float, default: 0.2
        Not used; kept for older calls, which iterated.
    number_of_steps : int, default: 5000
        Not used; kept for older calls.
    error_threshold : float, default: 0.01
        Not used; kept for older calls.

    Returns
    -------
    tuple of torch.Tensor
        - rays ``[k, 2, 3]`` from the points hit, in the rays' directions, for the k rays that hit;
        - normals ``[k, 2, 3]``: the sphere's centre and the outward unit normal;
        - distances ``[m]`` of all rays, NaN for those that miss, which have no gradient;
        - bool ``[m]``: which rays hit.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import define_sphere, intersect_w_sphere
    >>> ray = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> intersect_w_sphere(ray, define_sphere(torch.tensor([0.0, 0.0, 5.0]), torch.tensor([3.0])))[2]
    tensor([2.])
    """
    learning_rate, error_threshold = _validate.constants(learning_rate=learning_rate, error_threshold=error_threshold)
    ray, sphere = reals_of(ray=ray, sphere=sphere)
    return _picked(*core.sphere_hits(ray, sphere))


def intersect_w_triangle_batch(ray: torch.Tensor, triangle: torch.Tensor) -> tuple[Any, ...]:
    """Intersect many rays with many triangles.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[n, 2, 3]``.
    triangle : torch.Tensor
        ``[3, 3]`` or ``[m, 3, 3]``.

    Returns
    -------
    tuple
        - normals ``[m, n, 2, 3]``: the intersection of each ray with each plane, and the unit normals;
        - lists with one entry for each triangle that is hit, in order: distances ``[k]``, rays ``[k, 2, 3]`` and
          normals ``[k, 2, 3]`` of the rays that hit it;
        - bool ``[m, n]``: which ray hits which triangle.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import intersect_w_triangle_batch
    >>> triangle = torch.tensor([[0.0, 0, 5], [4, 0, 5], [0, 4, 5]])
    >>> triangles = torch.stack([triangle, triangle + 10])
    >>> hits = intersect_w_triangle_batch(torch.tensor([[1.0, 1, 0], [0, 0, 1]]), triangles)[-1]
    >>> hits.tolist()
    [[True], [False]]
    """
    ray, triangle = reals_of(ray=ray, triangle=triangle)
    ray, triangle = arguments.rays("ray", ray), arguments.triangles("triangle", triangle)
    normal, distance, check = _triangle_hits(ray, triangle)
    struck = check.flatten(1).any(dim=1).nonzero().flatten().tolist()
    distances = [distance[i][check[i]] for i in struck]
    return normal, distances, [ray[check[i]] for i in struck], [normal[i][check[i]] for i in struck], check


def intersect_w_surface_batch(ray: torch.Tensor, triangle: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Intersect n rays with the planes of m triangles.

    Parameters
    ----------
    ray : torch.Tensor
        Rays, ``[2, 3]`` or ``[n, 2, 3]``.
    triangle : torch.Tensor
        Triangles, ``[3, 3]`` or ``[m, 3, 3]``.

    Returns
    -------
    tuple of torch.Tensor
        Normals ``[m, n, 2, 3]`` and signed distances ``[m, n]``, each as of :func:`intersect_w_surface`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import intersect_w_surface_batch
    >>> plane = torch.tensor([[0.0, 0, 5], [4, 0, 5], [0, 4, 5]])
    >>> shifted = plane + torch.tensor([0.0, 0.0, 2.0])
    >>> ray = torch.tensor([[0.0, 0, 0], [0, 0, 1]])
    >>> intersect_w_surface_batch(ray, torch.stack([plane, shifted]))[1].flatten().tolist()
    [5.0, 7.0]
    """
    ray, triangle = reals_of(ray=ray, triangle=triangle)
    ray, triangle = arguments.rays("ray", ray), arguments.triangles("triangle", triangle)
    normals, distances = core.plane_hits(ray, _in_front(triangle, ray))
    return normals, distances


class detector(_show.Shown, Prepared):
    """A rectangle of pixels in space.

    Parameters
    ----------
    colors : int
        Number of images.
    center : torch.Tensor
        Centre of the rectangle, ``[3]``; the origin by default.
    tilt : torch.Tensor
        Degrees about X, Y and Z, applied in this order, ``[3]``.
    size : sequence of float
        Extent along the rectangle's x and y axes.
    resolution : sequence of int
        Number of pixels n0, n1 along them.
    device : torch.device, optional
        By default the device of `center`, else the CPU.

    Attributes
    ----------
    pixel_locations : torch.Tensor
        Places of the pixels in space, ``[n0·n1, 3]``, second index fast. The outer ones lie on the rim: their pitch is
        size/(n − 1).
    pixel_size : torch.Tensor
        size/resolution, ``[2]``.
    pixel_diagonal_size : torch.Tensor
        Diagonal of a pixel.
    pixel_diagonal_half_size : torch.Tensor
        Half of that diagonal.
    plane : torch.Tensor
        Three points of the plane, ``[3, 3]``.
    image : torch.Tensor
        Number of rays since the start or :meth:`clear`, ``[colors, n0, n1]``.

    Raises
    ------
    ValueError
        If a shape or number is wrong.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import create_ray_from_two_points, detector
    >>> plate = detector(colors=1, size=[2.0, 2.0], resolution=[3, 3])
    >>> rays = create_ray_from_two_points(torch.tensor([0.0, 0.0, -5.0]), torch.tensor([[1.0, 0.1, 0.0]]))
    >>> points, image, distances = plate.intersect(rays)
    >>> image.nonzero().flatten(), distances.argmin(dim=1)
    (tensor([7]), tensor([7]))
    """

    size: torch.Tensor
    surface_center: torch.Tensor
    surface_tilt: torch.Tensor

    _fixed = ("colors", "resolution", "size", "pixel_size", "plane", "device")

    def __init__(
        self,
        colors: int = 3,
        center: torch.Tensor | None = None,
        tilt: torch.Tensor | None = None,
        size: Sequence[float] = (10.0, 10.0),
        resolution: Sequence[int] = (100, 100),
        device: torch.device | str | None = None,
    ) -> None:
        device = center.device if device is None and torch.is_tensor(center) else checked_device("device", device)
        self.device: torch.device = torch.device("cpu") if device is None else device
        self.colors: int = _validate.integer("colors", colors, minimum=1)
        shape = _validate.size("resolution", resolution)
        self.resolution: torch.Tensor = torch.tensor(shape, device=self.device)
        values = placed_sheet(self.device, size, center=center, tilt=tilt)
        self.size, self.surface_center, self.surface_tilt = values
        _validate.real("size", self.size, positive=True)
        self.pixel_size: torch.Tensor = self.size / self.resolution
        self.pixel_diagonal_size: torch.Tensor = (self.pixel_size**2).sum().sqrt()
        self.pixel_diagonal_half_size: torch.Tensor = self.pixel_diagonal_size / 2
        self.plane: torch.Tensor = define_plane(self.surface_center, self.surface_tilt)
        matrix = rotation_matrix(self.surface_tilt)
        self.pixel_locations: torch.Tensor = sheet_points(self.size, shape, matrix, self.surface_center)
        self.image: torch.Tensor = torch.zeros(self.colors, *shape, dtype=self.size.dtype, device=self.device)

    def intersect(
        self, rays: torch.Tensor, color: int = 0, distances: bool = True
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Count rays on the pixels and return their intersections with the plane of the detector.

        Parameters
        ----------
        rays : torch.Tensor
            ``[2, 3]`` or ``[m, 2, 3]``.
        color : int
            Image that the rays are counted in.
        distances : bool
            Compute the distance image, whose memory grows with rays times pixels.

        Returns
        -------
        tuple of torch.Tensor
            Points of the plane ``[m, 3]``, outside the rectangle and behind the start too, NaN for rays along it; rays
            per pixel of this call, ``[n0·n1]``; squared distance of each point to each pixel, ``[m, n0·n1]``, or None.
            Points and distances are differentiable in rays, center and tilt; counts have no gradient.

        Notes
        -----
        A ray counts once, on the nearest pixel, if it intersects the rectangle ahead of its start; half a pitch beyond
        the outer pixels belongs to it. Distances are formed in the detector's frame, (u − x)² + (v − y)², which holds
        no array but the result.
        """
        color = _validate.integer("color", color, below=self.colors)
        distances = _validate.flag("distances", distances)
        rays = rays.to(self.device) if torch.is_tensor(rays) else rays
        rays, size, center, tilt = reals_of(
            rays=rays, size=self.size, center=self.surface_center, tilt=self.surface_tilt
        )
        rays = arguments.rays("rays", rays).reshape(-1, 2, 3)
        # Not self.plane: a stored graph has one backward pass only.
        normal, distance = intersect_w_surface(rays, define_plane(center, tilt))
        points, met = normal[:, 0], distance[:, 0].isfinite()
        safe = torch.where(met[:, None], points, center)
        local = apply_matrix(rotation_matrix(tilt).mT, safe - center)[:, :2]
        image = self._count(local.detach(), met & (distance[:, 0] >= 0), size)
        self.image[color] += image.reshape(self.image.shape[1:]).to(self.image.dtype)
        if not distances:
            return points, image, None
        axes = sheet_axes(size, self.image.shape[1:])
        across, along = ((local[:, i, None] - axis) ** 2 for i, axis in enumerate(axes))
        distance_image = (across[:, :, None] + along[:, None]).flatten(1)
        return points, image, distance_image.masked_fill(~met[:, None], torch.nan)

    def get_image(self) -> torch.Tensor:
        """Return the image scaled to 0 … 1 over all colours; zeros where nothing differs."""
        low, high = self.image.min(), self.image.max()
        return (self.image - low) / torch.where(high > low, high - low, 1.0)

    def clear(self) -> None:
        """Set all counts to zero."""
        self.image = torch.zeros_like(self.image)

    def _count(self, local: torch.Tensor, counted: torch.Tensor, size: torch.Tensor) -> torch.Tensor:
        shape = self.resolution.to(size.dtype)
        pitch = size / (shape - 1).clamp(min=1)
        place = torch.floor((local + size.detach() / 2) / pitch.detach() + 0.5)
        counted = counted & ((place >= 0) & (place < shape)).all(dim=1)
        row, column = torch.where(counted[:, None], place, 0).long().unbind(1)
        pixel = row * self.resolution[1] + column
        image = torch.zeros(len(self.pixel_locations), dtype=size.dtype, device=size.device)
        return image.index_add(0, pixel, counted.to(size.dtype))


# The class replaces the module of its name in the package; `detector.detector` stays valid.
detector.detector = detector  # type: ignore[attr-defined]
