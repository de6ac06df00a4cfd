"""Jones vectors and matrices as tensors; the formulas live in :mod:`odak.jones.elements`."""

import torch

from odak.jones import elements as core
from odak.jones.elements import apply_matrix, cascade, linearpolarizer, reverse

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


def electricfield(px, py, *, device: torch.device | None = None, dtype: torch.dtype | None = None) -> torch.Tensor:
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
    return core.electricfield(*_tensors(device, dtype, px, py))


def polarizer(angle=0.0, *, device: torch.device | None = None, dtype: torch.dtype | None = None) -> torch.Tensor:
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
    return core.polarizer(*_tensors(device, dtype, angle))


def diattenuator(
    first=1.0, second=0.0, angle=0.0, *, device: torch.device | None = None, dtype: torch.dtype | None = None
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
    return core.diattenuator(*_tensors(device, dtype, first, second, angle))


def retarder(
    retardance, angle=0.0, *, device: torch.device | None = None, dtype: torch.dtype | None = None
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
    return core.retarder(*_tensors(device, dtype, retardance, angle))


def quarter_wave_plate(
    angle=0.0, *, device: torch.device | None = None, dtype: torch.dtype | None = None
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
    return core.quarter_wave_plate(*_tensors(device, dtype, angle))


def half_wave_plate(angle=0.0, *, device: torch.device | None = None, dtype: torch.dtype | None = None) -> torch.Tensor:
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
    return core.half_wave_plate(*_tensors(device, dtype, angle))


def rotator(angle, *, device: torch.device | None = None, dtype: torch.dtype | None = None) -> torch.Tensor:
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
    return core.rotator(*_tensors(device, dtype, angle))


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
    return matrix.to(device=device or torch.get_default_device(), dtype=dtype or torch.get_default_dtype().to_complex())


def mirror(rx=1.0, ry=1.0, *, device: torch.device | None = None, dtype: torch.dtype | None = None) -> torch.Tensor:
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
    return core.mirror(*_tensors(device, dtype, rx, ry))


def _tensors(device, dtype, *values):
    """Return the values as tensors on one device, in the precision that gives the complex dtype asked for."""
    given = [value for value in values if isinstance(value, torch.Tensor)]
    device = device or (given[0].device if given else torch.get_default_device())
    if dtype is None:
        # Numbers follow the tensors: float32 given stays float32.
        wide = any(value.dtype in (torch.float64, torch.complex128) for value in given)
        narrow = torch.float32 if given else torch.get_default_dtype()
        real = torch.float64 if wide else narrow
    elif dtype in (torch.complex64, torch.complex128):
        real = dtype.to_real()
    else:
        raise TypeError(f"dtype must be torch.complex64 or torch.complex128, got {dtype}")
    tensors = [value if isinstance(value, torch.Tensor) else torch.as_tensor(value) for value in values]
    return [value.to(device=device, dtype=real.to_complex() if value.is_complex() else real) for value in tensors]
