"""Pinhole camera: projection of points by its position, direction and intrinsic parameters."""

from collections.abc import Sequence

import torch

from odak.learn._tensors import checked_device, floating, tensor


class PerspectiveCamera:
    """A pinhole camera whose axes and place are given as x' = x·R + T for points as rows.

    Parameters
    ----------
    R : torch.Tensor
        Rotation ``[3, 3]`` or ``[1, 3, 3]``, for row vectors.
    T : torch.Tensor
        Shift ``[3]`` or ``[1, 3]``, after the rotation.
    focal_length : torch.Tensor
        Focal length along x and y, in pixels.
    principal_point : torch.Tensor
        Intersection of the optical axis with the picture, in pixels.
    device : torch.device or str
        Device of the tensors. Numbers and sequences become float32 tensors.

    Raises
    ------
    ValueError
        If the shape of `R` or `T` is wrong.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import PerspectiveCamera
    >>> camera = PerspectiveCamera(torch.eye(3), torch.tensor([0.0, 0.0, 5.0]), [100.0, 100.0], [32.0, 32.0])
    >>> camera.transform_world_to_camera_space(torch.zeros(1, 3))
    tensor([[0., 0., 5.]])
    """

    def __init__(
        self,
        R: torch.Tensor,
        T: torch.Tensor,
        focal_length: Sequence[float] | torch.Tensor,
        principal_point: Sequence[float] | torch.Tensor,
        device: torch.device | str = "cpu",
    ):
        self.device = torch.device("cpu") if device is None else checked_device("device", device)
        self.R, self.T = self._tensor("R", R), self._tensor("T", T)
        self.focal_length = self._tensor("focal_length", focal_length)
        self.principal_point = self._tensor("principal_point", principal_point)
        for name, value, shape in (("R", self.R, (3, 3)), ("T", self.T, (3,))):
            if tuple(value.shape) not in (shape, (1, *shape)):
                raise ValueError(f"{name} must be {list(shape)} or {[1, *shape]}, got {list(value.shape)}")

    def transform_world_to_camera_space(self, points: torch.Tensor) -> torch.Tensor:
        """Return points in the axes of the camera.

        Parameters
        ----------
        points : torch.Tensor
            ``[n, 3]``.

        Returns
        -------
        torch.Tensor
            points·R + T, ``[n, 3]``, in the widest precision of the three. Differentiable.
        """
        points = floating("points", points).to(self.device)
        if points.ndim == 0 or points.shape[-1] != 3:
            raise ValueError(f"points must be [n, 3], got {list(points.shape)}")
        dtype = torch.promote_types(torch.promote_types(points.dtype, self.R.dtype), self.T.dtype)
        return points.to(dtype) @ self.R.to(dtype).reshape(3, 3) + self.T.reshape(1, 3)

    def get_camera_center(self) -> torch.Tensor:
        """Return the camera's place in the world, −T·Rᵀ, ``[1, 3]``."""
        return -self.T.reshape(1, 3) @ self.R.reshape(3, 3).T

    def _tensor(self, name: str, value) -> torch.Tensor:
        return tensor(name, value, None if isinstance(value, torch.Tensor) else torch.float32, self.device)
