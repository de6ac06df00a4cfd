"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch


def crop_center(
    field: torch.Tensor,
    size: collections.abc.Sequence[int] | None = None,
) -> torch.Tensor:
    """Crop the centre of a field; sample ``n // 2`` of each axis stays the centre."""
    ...

def smooth_pad(
    field: torch.Tensor,
    size: collections.abc.Sequence[int] | None = None,
    method: str = 'center',
    smooth_factor: collections.abc.Sequence[float] | None = None,
) -> torch.Tensor:
    """Pad a field with its border samples, tapered to zero at the edge."""
    ...

def zero_pad(
    field: torch.Tensor,
    size: collections.abc.Sequence[int] | None = None,
    method: str = 'center',
) -> torch.Tensor:
    """Pad a field with zeros."""
    ...
