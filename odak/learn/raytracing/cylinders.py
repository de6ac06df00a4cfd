"""Cylinders as tensors, and rays that meet them."""

from collections.abc import Sequence
from typing import Any

import torch

from odak._array import is_readable
from odak.learn.raytracing import arguments
from odak.learn.raytracing.recompute import in_pieces
from odak.raytracing import closed_forms
from odak.raytracing import components as vec
from odak.raytracing.geometry import cross, dot, unit
from odak.tools.transformation import rotation_matrix

__all__ = ["cylinder_function", "define_cylinder", "get_cylinder_normal", "intersect_w_cylinder"]


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
    """Return the squared distance to the axis minus r² of points ``[3]`` or ``[m, 3]``: zero on the cylinder."""
    point, cylinder = arguments.tensors(point=point, cylinder=cylinder)
    center, radius, axis = _split(cylinder)
    arm = arguments.points("point", point) - center
    across = cross(*torch.broadcast_tensors(arm, unit(axis)))
    return dot(across, across) - radius**2


def get_cylinder_normal(point: torch.Tensor, cylinder: torch.Tensor) -> torch.Tensor:
    """Return the rays from the axis of a cylinder outwards through points of it.

    Parameters
    ----------
    point : torch.Tensor
        ``[3]`` or ``[m, 3]``.
    cylinder : torch.Tensor
        ``[7]``, or ``[m, 7]``: one for each point.

    Returns
    -------
    torch.Tensor
        ``[m, 2, 3]``. Each starts at its point's foot on the axis.
    """
    point, cylinder = arguments.tensors(point=point, cylinder=cylinder)
    point = arguments.points("point", point)
    center, _, axis = _split(cylinder)
    axis = unit(axis)
    foot = center + dot(*torch.broadcast_tensors(point - center, axis))[..., None] * axis
    return arguments.as_rays(foot, unit(point - foot))


def intersect_w_cylinder(
    ray: torch.Tensor, cylinder: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Meet an infinite cylinder in closed form: the nearest point ahead, or the exit when the ray starts inside.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[m, 2, 3]``.
    cylinder : torch.Tensor
        ``[7]`` of :func:`define_cylinder`, or ``[m, 7]``: one for each ray.

    Returns
    -------
    tuple of torch.Tensor
        As :func:`odak.learn.raytracing.intersect_w_sphere`: rays ``[k, 2, 3]`` from the points hit, normals
        ``[k, 2, 3]`` from the axis outwards, distances ``[m]`` (NaN, without gradient, for misses and for rays along
        the axis), and which rays hit, ``[m]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import define_cylinder, intersect_w_cylinder
    >>> ray = torch.tensor([[-20.0, 0.0, 4.0], [1.0, 0.0, 0.0]])
    >>> intersect_w_cylinder(ray, define_cylinder(torch.zeros(3), 2.0))[2]
    tensor([18.])
    """
    ray, cylinder = arguments.tensors(ray=ray, cylinder=cylinder)
    ray = arguments.rays("ray", ray)
    center, radius, axis = _split(cylinder)
    if ray.ndim == 3 and len(center) not in (1, len(ray)) and len(ray) != 1:
        raise ValueError(f"cylinder must hold one cylinder or one for each of {len(ray)} rays, got {len(center)}")
    rays, normals, distance, check = in_pieces(_hits, (2, 1, 0, 1), ray, center, radius, axis)
    # Rays that all hit need not be picked; a GPU would have to be asked first.
    if not (is_readable(check) and bool(check.all())):
        rays, normals = rays[check], normals[check]
    return rays, normals, distance, check


def _hits(ray, center, radius, axis):
    hit = closed_forms.cylinder(ray[..., 0, :], ray[..., 1, :], center, radius, axis)
    # Of rays that miss, no NaN must meet the radius.
    outward = tuple(torch.where(hit.hit, value, 0.0) for value in hit.normal)
    foot = vec.along(hit.point, -radius, outward)
    return vec.join(hit.point, vec.split(ray[..., 1, :])), vec.join(foot, hit.normal), hit.distance, hit.hit


def _split(cylinder) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return centre ``[m, 3]``, radius ``[m]`` and axis ``[m, 3]``."""
    cylinder = arguments.shaped("cylinder", cylinder, (7,), "[7] or [m, 7]")
    return cylinder[..., :3], cylinder[..., 3], cylinder[..., 4:] - cylinder[..., :3]
