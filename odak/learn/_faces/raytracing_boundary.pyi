"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch

import odak.raytracing.interfaces

def fresnel_coefficients(
    ray: torch.Tensor,
    normal: torch.Tensor,
    n1: float | torch.Tensor,
    n2: complex | torch.Tensor,
) -> odak.raytracing.interfaces.Fresnel:
    """Return the Fresnel coefficients of rays at surfaces, for the amplitude and for the power."""
    ...

def get_cylinder_normal(
    point: torch.Tensor,
    cylinder: torch.Tensor,
) -> torch.Tensor:
    """Return the outward normals of a cylinder at points of it, as rays from its axis."""
    ...

def get_sphere_normal_torch(
    point: torch.Tensor,
    sphere: torch.Tensor,
) -> torch.Tensor:
    """Return the rays from points of a sphere towards its centre."""
    ...

def get_triangle_normal(
    triangle: torch.Tensor,
    triangle_center: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return the unit normals of triangles by the right-hand rule, as rays from their centres."""
    ...

def intersect_w_circle(
    ray: torch.Tensor,
    circle: collections.abc.Sequence[typing.Any],
) -> tuple[torch.Tensor, torch.Tensor]:
    """Intersect rays with the plane of a circle; the distance is 0 where the intersection lies outside the circle."""
    ...

def intersect_w_cylinder(
    ray: torch.Tensor,
    cylinder: torch.Tensor,
) -> tuple[torch.Tensor, ...]:
    """Intersect rays with an infinite cylinder, at the nearest point ahead, or the exit when the ray starts inside."""
    ...

def intersect_w_surface(
    ray: torch.Tensor,
    points: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Intersect rays with the plane through three points."""
    ...

def intersect_w_triangle(
    ray: torch.Tensor,
    triangle: torch.Tensor,
) -> tuple[torch.Tensor, ...]:
    """Intersect rays with one triangle, ahead of the starts or behind them."""
    ...

def reflect(
    input_ray: torch.Tensor,
    normal: torch.Tensor,
) -> torch.Tensor:
    """Reflect rays at surfaces: d' = d − 2(d·n)/(n·n)·n."""
    ...

def refract(
    vector: torch.Tensor,
    normvector: torch.Tensor,
    n1: float | torch.Tensor,
    n2: float | torch.Tensor,
    error: float = 0.01,
) -> torch.Tensor:
    """Refract rays at surfaces by Snell's law."""
    ...
