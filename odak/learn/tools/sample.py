"""Points on grids, discs, spheres and in boxes as tensors, by the formulas of :mod:`odak.tools.sample`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from odak.learn._face import torch_face
from odak.learn._tensors import checked_device, tensors_of
from odak.tools import sample
from odak.tools.sample import batch_of_rays as batch_of_rays
from odak.tools.sample import random_sample_point_cloud as random_sample_point_cloud
from odak.tools.transformation import axis_rotation

if TYPE_CHECKING:
    from odak.learn._faces.tools_sample import *  # noqa: F403

_ORIGIN = (0.0, 0.0, 0.0)


if not TYPE_CHECKING:
    box_volume_sample = torch_face(sample.box_volume_sample)
    circular_sample = torch_face(sample.circular_sample)
    circular_uniform_random_sample = torch_face(sample.circular_uniform_random_sample)
    circular_uniform_sample = torch_face(sample.circular_uniform_sample)
    sphere_sample = torch_face(sample.sphere_sample)
    sphere_sample_uniform = torch_face(sample.sphere_sample_uniform)


def grid_sample(
    no: Sequence[int] = (10, 10),
    size: Sequence[float] = (100.0, 100.0),
    center: Sequence[float] = _ORIGIN,
    angles: Sequence[float] = _ORIGIN,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return points of a rectangle on a regular grid, its edges included, and the matrices of its rotation.

    Parameters
    ----------
    no : sequence of int or torch.Tensor
        Number of points along x and y; a single one sits in the middle.
    size : sequence of float or torch.Tensor
        Size along x and y.
    center : sequence of float or torch.Tensor
        Centre of the rectangle.
    angles : sequence of float or torch.Tensor
        Degrees of its rotation out of the plane z = 0 about x, y and z, in this order.
    device : torch.device or str, optional
        Device of the result; by default the device of the tensors given, else torch's default.
    dtype : torch.dtype, optional
        Real dtype of the result; by default the widest of the floating tensors given, else torch's default.

    Returns
    -------
    tuple of torch.Tensor
        Points ``[no[0]·no[1], 3]``, x outer, and the matrices about X, Y and Z, ``[1, 3, 3]`` each.
        Differentiable in `size`, `center` and `angles`.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Examples
    --------
    >>> from odak.learn.tools import grid_sample
    >>> grid_sample([2, 1], [2.0, 4.0])[0]
    tensor([[-1.,  0.,  0.],
            [ 1.,  0.,  0.]])
    """
    size, center, angles = tensors_of(size=size, center=center, angles=angles)
    device, dtype = checked_device("device", device) or size.device, dtype or size.dtype
    points = sample.grid_sample(no, size, center, angles, xp=torch, device=device, dtype=dtype)
    angles = angles.to(device=device, dtype=dtype).reshape(3)
    return (points, *(axis_rotation(axis, angle)[None] for axis, angle in zip("XYZ", angles, strict=True)))
