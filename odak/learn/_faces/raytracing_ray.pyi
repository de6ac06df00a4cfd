"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch


def calculate_intersection_of_two_rays(
    ray0: torch.Tensor,
    ray1: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the intersection of two lines, and its distance along each of the rays."""
    ...

def create_ray_from_all_pairs(
    x0y0z0: torch.Tensor,
    x1y1z1: torch.Tensor,
) -> torch.Tensor:
    """Return a ray from each of the first points to each of the second ones."""
    ...

def create_ray_from_angles(
    point: torch.Tensor,
    angles: collections.abc.Sequence[float] | torch.Tensor,
    mode: str = 'XYZ',
) -> torch.Tensor:
    """Return the ray from a point along the rotated z axis."""
    ...

def create_ray_from_two_points(
    x0y0z0: torch.Tensor,
    x1y1z1: torch.Tensor,
) -> torch.Tensor:
    """Return rays from the first points towards the second ones."""
    ...

def find_nearest_points(
    ray0: torch.Tensor,
    ray1: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return, on each of two lines, the point nearest to the other line."""
    ...

def get_points_along_a_ray_segment(
    ray: torch.Tensor,
    distances: torch.Tensor,
) -> torch.Tensor:
    """Return the points of rays at given distances from their starts."""
    ...

def propagate_a_ray(
    ray: torch.Tensor,
    distance: float | torch.Tensor,
) -> torch.Tensor:
    """Return rays whose starts are moved along their directions; the directions are unchanged."""
    ...

def propagate_ray(
    ray: torch.Tensor,
    distance: float | torch.Tensor,
) -> torch.Tensor:
    """Return rays whose starts are moved along their directions; the directions are unchanged."""
    ...
