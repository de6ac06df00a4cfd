"""Points on grids, discs, spheres and in boxes as differentiable tensors."""

from collections.abc import Sequence

import numpy as np
import torch

from odak.learn._tensors import tensor
from odak.learn.tools.transformation import rotmatx, rotmaty, rotmatz
from odak.tools import sample
from odak.tools.sample import batch_of_rays, random_sample_point_cloud

__all__ = [
    "batch_of_rays",
    "box_volume_sample",
    "circular_sample",
    "circular_uniform_random_sample",
    "circular_uniform_sample",
    "grid_sample",
    "random_sample_point_cloud",
    "sphere_sample",
    "sphere_sample_uniform",
]

_ORIGIN = (0.0, 0.0, 0.0)


def grid_sample(
    no: Sequence[int] = (10, 10),
    size: Sequence[float] = (100.0, 100.0),
    center: Sequence[float] = _ORIGIN,
    angles: Sequence[float] = _ORIGIN,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return points of a rectangle on a regular grid, its edges included, and the rotations that turn it.

    Parameters
    ----------
    no : sequence of int or torch.Tensor
        Number of points along x and y; a single one sits in the middle.
    size : sequence of float or torch.Tensor
        Size along x and y.
    center : sequence of float or torch.Tensor
        Centre of the rectangle.
    angles : sequence of float or torch.Tensor
        Degrees by which it is turned out of the plane z = 0 about x, y and z, in this order.

    Returns
    -------
    tuple of torch.Tensor
        Points ``[no[0]·no[1], 3]``, x outer, and the matrices about X, Y and Z, ``[1, 3, 3]`` each. float32, or the
        widest precision among the tensors given; differentiable in `size`, `center` and `angles`.

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
    size, center, angles = _tensors(size=size, center=center, angles=angles)
    points = sample.grid_sample(no, size, center, angles)
    turns = (turn(angle)[None] for turn, angle in zip((rotmatx, rotmaty, rotmatz), angles.reshape(3), strict=True))
    return (points, *turns)


def box_volume_sample(
    no: Sequence[int] = (10, 10, 10),
    size: Sequence[float] = (100.0, 100.0, 100.0),
    center: Sequence[float] = _ORIGIN,
    angles: Sequence[float] = _ORIGIN,
) -> torch.Tensor:
    """Return the centres of the cells of a box as a tensor; see :func:`odak.tools.box_volume_sample`."""
    return sample.box_volume_sample(no, *_tensors(size=size, center=center, angles=angles))


def circular_sample(
    no: Sequence[int] = (10, 10),
    radius: float = 10.0,
    center: Sequence[float] = _ORIGIN,
    angles: Sequence[float] = _ORIGIN,
) -> torch.Tensor:
    """Return points of a disc on a polar grid as a tensor; see :func:`odak.tools.circular_sample`."""
    return sample.circular_sample(no, *_tensors(radius=radius, center=center, angles=angles))


def circular_uniform_sample(
    no: Sequence[int] = (10, 50),
    radius: float = 10.0,
    center: Sequence[float] = _ORIGIN,
    angles: Sequence[float] = _ORIGIN,
) -> torch.Tensor:
    """Return points of a disc on rings as a tensor; see :func:`odak.tools.circular_uniform_sample`."""
    return sample.circular_uniform_sample(no, *_tensors(radius=radius, center=center, angles=angles))


def circular_uniform_random_sample(
    no: Sequence[int] = (10, 50),
    radius: float = 10.0,
    center: Sequence[float] = _ORIGIN,
    angles: Sequence[float] = _ORIGIN,
    *,
    seed: int | np.random.Generator | None = None,
) -> torch.Tensor:
    """Return random points of a disc as a tensor; see :func:`odak.tools.circular_uniform_random_sample`."""
    placing = _tensors(radius=radius, center=center, angles=angles)
    return sample.circular_uniform_random_sample(no, *placing, seed=seed)


def sphere_sample(
    no: Sequence[int] = (10, 10),
    radius: float = 1.0,
    center: Sequence[float] = _ORIGIN,
    k: Sequence[float] = (1, 2),
) -> torch.Tensor:
    """Return points of a sphere as a tensor; see :func:`odak.tools.sphere_sample`."""
    radius, center = _tensors(radius=radius, center=center)
    return sample.sphere_sample(no, radius, center, k)


def sphere_sample_uniform(
    no: Sequence[int] = (10, 10),
    radius: float = 1.0,
    center: Sequence[float] = _ORIGIN,
    k: Sequence[float] = (1, 2),
) -> torch.Tensor:
    """Return points of a sphere in a sheared order as a tensor; see :func:`odak.tools.sphere_sample_uniform`."""
    radius, center = _tensors(radius=radius, center=center)
    return sample.sphere_sample_uniform(no, radius, center, k)


def _tensors(**values) -> list[torch.Tensor]:
    """Return tensors of one device and one precision: the widest of the floating tensors given, float32 by default."""
    given = [value for value in values.values() if isinstance(value, torch.Tensor)]
    floating = [value.dtype for value in given if value.is_floating_point()]
    dtype = torch.float64 if torch.float64 in floating else torch.float32
    device = given[0].device if given else None
    return [tensor(name, value, dtype, device) for name, value in values.items()]
