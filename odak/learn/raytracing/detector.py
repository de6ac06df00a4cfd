"""A flat array of pixels that counts rays, with the differentiable distances of rays to pixels."""

from collections.abc import Sequence
from typing import Any

import torch

from odak import _validate
from odak.learn._tensors import checked_device, reals_of
from odak.learn.raytracing.boundary import intersect_w_surface
from odak.learn.raytracing.primitives import define_plane
from odak.raytracing import arguments
from odak.tools.transformation import apply_matrix, rotation_matrix

__all__ = ["detector"]


class detector:
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
        By default that of `center`, else the CPU.

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
        self.device = torch.device("cpu") if device is None else device
        self.colors = _validate.integer("colors", colors, minimum=1)
        shape = _validate.size("resolution", resolution)
        self.resolution = torch.tensor(shape, device=self.device)
        none = [0.0, 0.0, 0.0]
        given = {"size": size, "center": none if center is None else center, "tilt": none if tilt is None else tilt}
        given = {name: v.to(self.device) if torch.is_tensor(v) else v for name, v in given.items()}
        values = [value.reshape(-1).to(self.device) for value in reals_of(**given)]
        for name, value, count in zip(given, values, (2, 3, 3), strict=True):
            if len(value) != count:
                raise ValueError(f"{name} must be {count} numbers, got {len(value)}")
        self.size, self.surface_center, self.surface_tilt = values
        _validate.real("size", self.size, positive=True)
        self.pixel_size = self.size / self.resolution
        self.pixel_diagonal_size = (self.pixel_size**2).sum().sqrt()
        self.pixel_diagonal_half_size = self.pixel_diagonal_size / 2
        self.plane = define_plane(self.surface_center, self.surface_tilt)
        x, y = torch.meshgrid(*self._axes(self.size), indexing="ij")
        flat = torch.stack((x, y, torch.zeros_like(x)), dim=-1).reshape(-1, 3)
        self.pixel_locations = apply_matrix(rotation_matrix(self.surface_tilt), flat) + self.surface_center
        self.image = torch.zeros(self.colors, *shape, dtype=self.size.dtype, device=self.device)

    def intersect(self, rays: torch.Tensor, color: int = 0, distances: bool = True) -> Any:
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
        color, distances = _validate.integer("color", color), _validate.flag("distances", distances)
        if color >= self.colors:
            raise ValueError(f"color must be below {self.colors}, got {color}")
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
        across, along = ((local[:, i, None] - axis) ** 2 for i, axis in enumerate(self._axes(size)))
        distance_image = (across[:, :, None] + along[:, None]).flatten(1)
        return points, image, distance_image.masked_fill(~met[:, None], torch.nan)

    def get_image(self) -> torch.Tensor:
        """Return the image scaled to 0 … 1 over all colours; zeros where nothing differs."""
        low, high = self.image.min(), self.image.max()
        return (self.image - low) / torch.where(high > low, high - low, 1.0)

    def clear(self) -> None:
        """Set all counts to zero."""
        self.image = torch.zeros_like(self.image)

    def _axes(self, size: torch.Tensor) -> list[torch.Tensor]:
        """Return the places of the pixels along both axes of the rectangle."""
        shape = self.resolution.tolist()
        return [
            half * torch.linspace(-1, 1, n, dtype=size.dtype, device=size.device)
            for half, n in zip(size / 2, shape, strict=True)
        ]

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
