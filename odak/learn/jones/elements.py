"""Jones vectors and matrices as tensors; the formulas live in :mod:`odak.jones.elements`."""

import numpy as np
import torch

from odak import _validate
from odak.jones import elements as core
from odak.jones.elements import apply_matrix, cascade, linearpolarizer, reverse
from odak.learn._tensors import checked_device

__all__ = [
    "apply_matrix",
    "cascade",
    "circular_polarizer",
    "diattenuator",
    "electricfield",
    "half_wave_plate",
    "linearpolarizer",
    "mirror",
    "polarizer",
    "quarter_wave_plate",
    "retarder",
    "reverse",
    "rotator",
]


def electricfield(
    px: complex | torch.Tensor,
    py: complex | torch.Tensor,
    *,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the Jones vector of two amplitudes, ``[..., 2, k]``; see :func:`odak.jones.electricfield`.

    Parameters
    ----------
    px, py : number or torch.Tensor
        Amplitudes along x and y, real or complex.
    device, dtype : optional
        Device and complex dtype of the result; by default those of the tensors given, else torch's defaults.

    Returns
    -------
    torch.Tensor
        Complex; differentiable in every tensor given.
    """
    return core.electricfield(*_tensors(device, dtype, px=px, py=py))


def polarizer(
    angle: complex | torch.Tensor = 0.0, *, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> torch.Tensor:
    """Return the matrix of an ideal linear polariser; see :func:`odak.jones.polarizer`.

    Parameters
    ----------
    angle : number or torch.Tensor
        Angle of the transmission axis in degrees.
    device, dtype : optional
        Device and complex dtype of the result; by default those of the tensors given, else torch's defaults.

    Returns
    -------
    torch.Tensor
        Complex; differentiable in every tensor given.
    """
    return core.polarizer(*_tensors(device, dtype, angle=angle))


def diattenuator(
    first: complex | torch.Tensor = 1.0,
    second: complex | torch.Tensor = 0.0,
    angle: complex | torch.Tensor = 0.0,
    *,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the matrix of a partial polariser; see :func:`odak.jones.diattenuator`.

    Parameters
    ----------
    first, second, angle : number or torch.Tensor
        Amplitude transmission along and across the axis, and its angle in degrees.
    device, dtype : optional
        Device and complex dtype of the result; by default those of the tensors given, else torch's defaults.

    Returns
    -------
    torch.Tensor
        Complex; differentiable in every tensor given.
    """
    return core.diattenuator(*_tensors(device, dtype, first=first, second=second, angle=angle))


def retarder(
    retardance: complex | torch.Tensor,
    angle: complex | torch.Tensor = 0.0,
    *,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the matrix of a wave plate; see :func:`odak.jones.retarder`.

    Parameters
    ----------
    retardance, angle : number or torch.Tensor
        Retardance and angle of the fast axis, in degrees.
    device, dtype : optional
        Device and complex dtype of the result; by default those of the tensors given, else torch's defaults.

    Returns
    -------
    torch.Tensor
        Complex; differentiable in every tensor given.
    """
    return core.retarder(*_tensors(device, dtype, retardance=retardance, angle=angle))


def quarter_wave_plate(
    angle: complex | torch.Tensor = 0.0, *, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> torch.Tensor:
    """Return the matrix of a quarter-wave plate; see :func:`odak.jones.quarter_wave_plate`.

    Parameters
    ----------
    angle : number or torch.Tensor
        Angle of the fast axis in degrees.
    device, dtype : optional
        Device and complex dtype of the result; by default those of the tensors given, else torch's defaults.

    Returns
    -------
    torch.Tensor
        Complex; differentiable in every tensor given.
    """
    return core.quarter_wave_plate(*_tensors(device, dtype, angle=angle))


def half_wave_plate(
    angle: complex | torch.Tensor = 0.0, *, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> torch.Tensor:
    """Return the matrix of a half-wave plate; see :func:`odak.jones.half_wave_plate`.

    Parameters
    ----------
    angle : number or torch.Tensor
        Angle of the fast axis in degrees.
    device, dtype : optional
        Device and complex dtype of the result; by default those of the tensors given, else torch's defaults.

    Returns
    -------
    torch.Tensor
        Complex; differentiable in every tensor given.
    """
    return core.half_wave_plate(*_tensors(device, dtype, angle=angle))


def rotator(
    angle: complex | torch.Tensor, *, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> torch.Tensor:
    """Return the matrix that turns the polarisation; see :func:`odak.jones.rotator`.

    Parameters
    ----------
    angle : number or torch.Tensor
        Degrees, from x towards y.
    device, dtype : optional
        Device and complex dtype of the result; by default those of the tensors given, else torch's defaults.

    Returns
    -------
    torch.Tensor
        Complex; differentiable in every tensor given.
    """
    return core.rotator(*_tensors(device, dtype, angle=angle))


def circular_polarizer(
    handedness: str = "right", *, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> torch.Tensor:
    """Return the matrix of an ideal circular polariser; see :func:`odak.jones.circular_polarizer`.

    Parameters
    ----------
    handedness : str
        "right" or "left": what passes.
    device, dtype : optional
        Device and complex dtype of the result; torch's defaults when not given.

    Returns
    -------
    torch.Tensor
        Complex ``2 x 2``.
    """
    matrix = torch.from_numpy(core.circular_polarizer(handedness))
    dtype = torch.get_default_dtype().to_complex() if dtype is None else dtype
    if dtype not in (torch.complex64, torch.complex128):
        raise TypeError(f"dtype must be torch.complex64 or torch.complex128, got {dtype}")
    return matrix.to(device=checked_device("device", device) or torch.get_default_device(), dtype=dtype)


def mirror(
    rx: complex | torch.Tensor = 1.0,
    ry: complex | torch.Tensor = 1.0,
    *,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the matrix of a mirror, diag(rx, −ry); see :func:`odak.jones.mirror`.

    Parameters
    ----------
    rx, ry : number or torch.Tensor
        Amplitude reflection coefficients along x and y.
    device, dtype : optional
        Device and complex dtype of the result; by default those of the tensors given, else torch's defaults.

    Returns
    -------
    torch.Tensor
        Complex; differentiable in every tensor given.
    """
    return core.mirror(*_tensors(device, dtype, rx=rx, ry=ry))


def _tensors(device, dtype, **values):
    """Return the values as tensors on one device, in the precision that gives the complex dtype asked for."""
    given = [value for value in values.values() if isinstance(value, torch.Tensor)]
    device = checked_device("device", device) or (given[0].device if given else torch.get_default_device())
    if dtype is None:
        # Numbers follow the tensors: float32 given stays float32.
        wide = any(value.dtype in (torch.float64, torch.complex128) for value in given)
        narrow = torch.float32 if given else torch.get_default_dtype()
        real = torch.float64 if wide else narrow
    elif dtype in (torch.complex64, torch.complex128):
        real = dtype.to_real()
    else:
        raise TypeError(f"dtype must be torch.complex64 or torch.complex128, got {dtype}")
    tensors = [_tensor(name, value) for name, value in values.items()]
    return [value.to(device=device, dtype=real.to_complex() if value.is_complex() else real) for value in tensors]


def _tensor(name, value):
    value = _validate.given(name, value)
    if isinstance(value, np.ndarray):
        return torch.from_numpy(np.array(value, order="C"))
    if isinstance(value, torch.Tensor):
        return value
    return torch.as_tensor(value, dtype=torch.complex128 if isinstance(value, complex) else torch.float64)
