"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch


def box_volume_sample(
    no: collections.abc.Sequence[int] = (10, 10, 10),
    size: collections.abc.Sequence[float] | torch.Tensor = (100.0, 100.0, 100.0),
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the centres of the cells that a box is cut into."""
    ...

def circular_sample(
    no: collections.abc.Sequence[int] = (10, 10),
    radius: float | torch.Tensor = 10.0,
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return points of a disc on a polar grid, equally spaced in radius and angle, without the centre."""
    ...

def circular_uniform_random_sample(
    no: collections.abc.Sequence[int] = (10, 50),
    radius: float | torch.Tensor = 10.0,
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    *,
    seed: int | numpy.random.Generator | None = None,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return independent random points of uniform density on a disc."""
    ...

def circular_uniform_sample(
    no: collections.abc.Sequence[int] = (10, 50),
    radius: float | torch.Tensor = 10.0,
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return points of a disc on rings whose number of points grows with their radius."""
    ...

def sphere_sample(
    no: collections.abc.Sequence[int] = (10, 10),
    radius: float | torch.Tensor = 1.0,
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    k: collections.abc.Sequence[float] | torch.Tensor = (1, 2),
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return points of a sphere on a grid of polar and azimuthal angles."""
    ...

def sphere_sample_uniform(
    no: collections.abc.Sequence[int] = (10, 10),
    radius: float | torch.Tensor = 1.0,
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    k: collections.abc.Sequence[float] | torch.Tensor = (1, 2),
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the points of :func:`sphere_sample` in a sheared order of the two angles; they are not uniform in area."""
    ...
