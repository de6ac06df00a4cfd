"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch


def circular_polarizer(
    handedness: str = 'right',
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of an ideal (homogeneous) circular polariser."""
    ...

def depolarizer(
    kept: complex | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Mueller matrix of an ideal depolariser, which no Jones matrix describes."""
    ...

def diattenuator(
    first: complex | torch.Tensor = 1.0,
    second: complex | torch.Tensor = 0.0,
    angle: complex | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a partial polariser."""
    ...

def electricfield(
    px: complex | torch.Tensor,
    py: complex | torch.Tensor,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones vector of the amplitudes `px` and `py`."""
    ...

def half_wave_plate(
    angle: float | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a half-wave plate: :func:`retarder` of 180°."""
    ...

def mirror(
    rx: complex | torch.Tensor = 1.0,
    ry: complex | torch.Tensor = 1.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a mirror: diag(rx, −ry), which swaps right and left."""
    ...

def polarizer(
    angle: complex | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of an ideal linear polariser."""
    ...

def quarter_wave_plate(
    angle: float | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a quarter-wave plate: :func:`retarder` of 90°."""
    ...

def retarder(
    retardance: complex | torch.Tensor,
    angle: complex | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a wave plate of any retardance."""
    ...

def rotator(
    angle: complex | torch.Tensor,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones matrix of a rotation of the polarisation, as an optically active crystal or a Faraday cell does."""
    ...
