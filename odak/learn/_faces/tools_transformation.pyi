"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch


def cross_product(
    vector1: torch.Tensor,
    vector2: torch.Tensor,
) -> torch.Tensor:
    """Return the vector product of two rays' directions as a ray that starts where the first does."""
    ...

def distance_between_two_points(
    point1: torch.Tensor,
    point2: torch.Tensor,
) -> torch.Tensor:
    """Return the distance between points."""
    ...

def rotmatx(
    angle: float | torch.Tensor,
) -> torch.Tensor:
    """Return the rotation about the x axis."""
    ...

def rotmaty(
    angle: float | torch.Tensor,
) -> torch.Tensor:
    """Return the rotation about the y axis."""
    ...

def rotmatz(
    angle: float | torch.Tensor,
) -> torch.Tensor:
    """Return the rotation about the z axis."""
    ...

def same_side(
    p1: torch.Tensor,
    p2: torch.Tensor,
    a: torch.Tensor,
    b: torch.Tensor,
) -> bool | torch.Tensor:
    """Return whether p1 and p2 lie on the same side of the line through a and b."""
    ...
