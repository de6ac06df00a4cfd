"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch


def bring_plane_to_origin(
    point: torch.Tensor,
    plane: torch.Tensor | None = None,
    shape: collections.abc.Sequence[float] = (10.0, 10.0),
    center: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
    mode: str = 'XYZ',
) -> torch.Tensor:
    """Return points in the frame of a plane that was rotated by `angles` and moved to `center`."""
    ...

def center_of_triangle(
    triangle: torch.Tensor,
) -> torch.Tensor:
    """Return the mean of the corners of triangles."""
    ...

def cylinder_function(
    point: torch.Tensor,
    cylinder: torch.Tensor,
) -> torch.Tensor:
    """Return the squared distance to the axis of a cylinder minus the squared radius."""
    ...

def define_circle(
    center: torch.Tensor,
    radius: float,
    angles: collections.abc.Sequence[float] | torch.Tensor,
) -> list[torch.Tensor]:
    """Return a circle as [plane ``[3, 3]``, centre ``[3]``, radius ``[1]``]."""
    ...

def define_cylinder(
    center: collections.abc.Sequence[float] | torch.Tensor,
    radius: float | torch.Tensor,
    rotation: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
) -> torch.Tensor:
    """Return infinite cylinders as ``[c, r, q]``, q a point of the axis one unit from c."""
    ...

def define_plane(
    point: collections.abc.Sequence[float] | torch.Tensor,
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0, 0.0),
) -> torch.Tensor:
    """Return three points of a plane through `point`, tilted."""
    ...

def define_sphere(
    center: collections.abc.Sequence[float] | torch.Tensor = ...,
    radius: float | torch.Tensor = ...,
) -> torch.Tensor:
    """Return spheres as ``[c_x, c_y, c_z, r]``."""
    ...

def sphere_function(
    point: torch.Tensor,
    sphere: torch.Tensor,
) -> torch.Tensor:
    """Return |p − c|² − r², which is zero on a sphere and negative inside."""
    ...
