"""Amplitude, phase and patterns of fields as tensors."""

import math
from collections.abc import Sequence
from typing import Any

import torch

from odak import _array, _validate
from odak.learn._tensors import floating, tensor
from odak.wave import utils
from odak.wave.double_phase import compose_double_phase, decompose_double_phase
from odak.wave.utils import (
    add_phase,
    add_random_phase,
    adjust_phase_only_slm_range,
    calculate_amplitude,
    calculate_intensity,
    calculate_phase,
    rayleigh_resolution,
)

__all__ = [
    "add_phase",
    "add_random_phase",
    "adjust_phase_only_slm_range",
    "calculate_amplitude",
    "calculate_intensity",
    "calculate_phase",
    "compose_double_phase",
    "decompose_double_phase",
    "generate_complex_field",
    "normalize_phase",
    "produce_phase_only_slm_pattern",
    "rayleigh_resolution",
    "rotationspeed",
    "set_amplitude",
    "wavenumber",
]


def wavenumber(wavelength: float | Sequence[float] | torch.Tensor) -> float | torch.Tensor:
    """Return the wave number 2π/λ of a number, or a tensor of a tensor or a list; see :func:`odak.wave.wavenumber`."""
    return utils.wavenumber(_tensor_of("wavelength", wavelength))


def rotationspeed(
    wavelength: float | Sequence[float] | torch.Tensor, c: float | torch.Tensor = 3 * 10**11
) -> float | torch.Tensor:
    """Return the angular frequency ω = 2πc/λ; see :func:`odak.wave.rotationspeed`."""
    return utils.rotationspeed(_tensor_of("wavelength", wavelength), c)


def _tensor_of(name, value):
    """Return a list of numbers as a tensor, anything else as it is."""
    _validate.given(name, value)
    return tensor(name, value, torch.float64) if isinstance(value, (list, tuple)) else value


def normalize_phase(phase: torch.Tensor, range_min: float = 0.0, range_max: float = 2 * math.pi) -> torch.Tensor:
    """Return `phase` stretched to a range; see :func:`odak.wave.normalize_phase`. Numbers become a tensor."""
    return utils.normalize_phase(floating("phase", phase), range_min, range_max)


def generate_complex_field(amplitude: float | torch.Tensor, phase: float | torch.Tensor) -> torch.Tensor:
    """Return amplitude·exp(i·phase).

    Parameters
    ----------
    amplitude, phase : float or torch.Tensor
        Real; they broadcast. The phase is in radians.

    Returns
    -------
    torch.Tensor
        Complex field, complex128 if either tensor is float64.
    """
    if not isinstance(amplitude, torch.Tensor) and not isinstance(phase, torch.Tensor):
        phase = torch.tensor(float(phase))
    return utils.generate_complex_field(amplitude, phase)


def set_amplitude(field: torch.Tensor, amplitude: float | torch.Tensor) -> torch.Tensor:
    """Return amplitude·exp(i·arg field), the amplitude taken as it is (a negative one turns the phase by π).

    Parameters
    ----------
    field : torch.Tensor
        Complex field.
    amplitude : float or torch.Tensor
        New amplitude.

    Returns
    -------
    torch.Tensor
        Complex field.
    """
    field = _validate.array("field", field)
    if _array.is_array(amplitude):
        _validate.fitting(field=field, amplitude=amplitude)
    return generate_complex_field(amplitude, calculate_phase(field))


def produce_phase_only_slm_pattern(
    hologram: torch.Tensor, slm_range: float, bits: int = 8, default_range: float = 6.28, illumination: Any = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a hologram as a modulator shows it and its levels: :func:`odak.wave.produce_phase_only_slm_pattern`."""
    return utils.produce_phase_only_slm_pattern(hologram, slm_range, None, bits, default_range, illumination)
