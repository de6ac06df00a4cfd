"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch

import odak.raytracing.intersections
import odak.raytracing.surfaces

def intersect_parametric(
    ray: torch.Tensor,
    parametric_surface: object,
    surface_function: collections.abc.Callable[..., typing.Any],
    surface_normal_function: collections.abc.Callable[..., typing.Any] = ...,
    target_error: float = 1e-08,
    iter_no_limit: int = 100000,
) -> tuple[torch.Tensor, ...]:
    """Intersect rays with a surface given as a function, at the nearest point ahead."""
    ...

def intersect_w_sag(
    ray: torch.Tensor,
    surface: odak.raytracing.surfaces.Shape,
    center: collections.abc.Sequence[float] | None = None,
    angles: collections.abc.Sequence[float] | None = None,
    aperture: float | None = None,
    ahead: bool = True,
) -> odak.raytracing.intersections.Hit:
    """Intersect rays with a surface z = sag(x, y), differentiable in rays, placement and parameters of the surface."""
    ...
