"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch


def generate_complex_field(
    amplitude: float | torch.Tensor,
    phase: float | torch.Tensor,
) -> torch.Tensor:
    """Return amplitude·exp(i·phase)."""
    ...

def normalize_phase(
    phase: torch.Tensor,
    range_min: float = 0.0,
    range_max: float = 6.283185307179586,
    *,
    period: float | None = None,
    multiplier: float | None = None,
) -> torch.Tensor:
    """Return `phase` mapped linearly so that its extremes are `range_min` and `range_max`."""
    ...

def rotationspeed(
    wavelength: torch.Tensor,
    c: float | torch.Tensor = 300000000000,
) -> torch.Tensor:
    """Return the angular frequency ω = 2πc/λ."""
    ...

def wavenumber(
    wavelength: float | torch.Tensor,
) -> float | torch.Tensor:
    """Return the wave number 2π/λ."""
    ...
