"""Wavefront aberrations as tensors, differentiable in their coefficients."""

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from array_api_compat import torch as torch_namespace

from odak.learn._tensors import checked_device
from odak.wave import aberrations


def zernike_phase(
    nx: int,
    ny: int,
    coefficients: Mapping,
    radius: float | None = None,
    dx: float | torch.Tensor = 1.0,
    offset: Any = (0.0, 0.0),
    device: torch.device | None = None,
) -> torch.Tensor:
    """Return the aberration Σ c·Z as a phase, float64 ``[..., nx, ny]``; see :func:`odak.wave.zernike_phase`.

    Parameters
    ----------
    nx, ny, coefficients, radius, dx, offset
        As in :func:`odak.wave.zernike_phase`; the phase is differentiable in coefficients that are tensors.
    device : torch.device, optional
        By default that of the first coefficient that is a tensor, else the CPU.

    Returns
    -------
    torch.Tensor
        Phase in radians, not wrapped.
    """
    device = checked_device("device", device)
    return aberrations.zernike_phase(nx, ny, coefficients, radius, dx, offset, xp=torch_namespace, device=device)


def zernike_basis(
    nx: int,
    ny: int,
    modes: Iterable,
    radius: float | None = None,
    dx: float | torch.Tensor = 1.0,
    offset: Any = (0.0, 0.0),
    device: torch.device | None = None,
) -> torch.Tensor:
    """Return Zernike polynomials of unit RMS, float64 ``[modes, nx, ny]``; see :func:`odak.wave.zernike_basis`."""
    device = checked_device("device", device)
    return aberrations.zernike_basis(nx, ny, modes, radius, dx, offset, xp=torch_namespace, device=device)
