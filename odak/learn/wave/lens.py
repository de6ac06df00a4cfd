"""Thin phase elements as tensors: lenses, prisms and gratings."""

from collections.abc import Sequence
from typing import Any

import torch
from array_api_compat import torch as torch_namespace

from odak import _validate
from odak._array import phasor
from odak.learn._tensors import checked_device
from odak.wave import lens

_CPU = torch.device("cpu")


def lens_phase(
    shape: Any, focal: Any, dx: Any, wavelength: Any, offset: Any = (0.0, 0.0), device: torch.device = _CPU
) -> torch.Tensor:
    """Return the phase of a thin lens on the field's own grid; see :func:`odak.wave.lens_phase`."""
    return lens.lens_phase(
        shape, focal, dx, wavelength, offset, xp=torch_namespace, device=checked_device("device", device)
    )


def quadratic_phase_function(
    nx: int, ny: int, k: float, focal: float = 0.4, dx: float = 0.001, offset: Sequence[float] = (0, 0)
) -> torch.Tensor:
    """Return the transmission of a thin lens, exp(−ik·r²/(2f)), converging for a positive focal length.

    Parameters
    ----------
    nx, ny : int
        Rows and columns.
    k : float
        Wave number in rad/m.
    focal : float
        Focal length in metres.
    dx : float
        Pixel pitch in metres. The grid is the older linspace(−n·dx/2, n·dx/2, n); :func:`lens_phase` has the exact one.
    offset : sequence of float
        Shift of the lens in pixels: `offset[1]` along the first axis, `offset[0]` along the second.

    Returns
    -------
    torch.Tensor
        complex64 ``[nx, ny]``.
    """
    nx, ny = _validate.size("nx, ny", (nx, ny))
    _validate.real("k", k)
    _validate.real("focal", focal, nonzero=True)
    squared = lens.squared_radius(nx, ny, dx, offset, torch_namespace)
    return phasor(-k * squared / (2 * focal), torch.complex64)


def double_convergence(nx: int, ny: int, k: float, r: float, dx: float) -> torch.Tensor:
    """Return the phase factor of a doubly converging beam, complex64; see :func:`odak.wave.double_convergence`."""
    return lens.double_convergence(nx, ny, k, r, dx, xp=torch_namespace).to(torch.complex64)


def prism_phase_function(nx: int, ny: int, k: float, angle: float, dx: float = 0.001, axis: str = "x") -> torch.Tensor:
    """Return the transmission of a thin prism, complex64; see :func:`odak.wave.prism_phase_function`."""
    return lens.prism_phase_function(nx, ny, k, angle, dx, axis, xp=torch_namespace).to(torch.complex64)


def prism_grating(
    nx: int, ny: int, k: float, angle: float, dx: float = 0.001, axis: str = "x", phase_offset: float = 0.0
) -> torch.Tensor:
    """Return a blazed prism, complex64 ``[nx, ny]``; see :func:`odak.wave.prism_grating`."""
    return lens.prism_grating(nx, ny, k, angle, dx, axis, phase_offset, xp=torch_namespace).to(torch.complex64)


def blazed_grating(nx: int, ny: int, levels: int = 2, axis: str = "x") -> torch.Tensor:
    """Return a blazed grating, complex64 ``[nx, ny]``; see :func:`odak.wave.blazed_grating`."""
    return lens.blazed_grating(nx, ny, levels, axis, xp=torch_namespace).to(torch.complex64)


def linear_grating(nx: int, ny: int, every: int = 2, add: float | None = None, axis: str = "x") -> torch.Tensor:
    """Return a binary grating, complex64 ``[nx, ny]``; see :func:`odak.wave.linear_grating`. `add` is π by default."""
    return lens.linear_grating(nx, ny, every, add, axis, xp=torch_namespace)
