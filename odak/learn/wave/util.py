"""Amplitude, phase and patterns of fields as tensors."""

import math
from typing import Any

import torch

from odak import _array, _validate
from odak.learn._tensors import floating
from odak.wave import utils
from odak.wave.double_phase import compose_double_phase, decompose_double_phase
from odak.wave.utils import (
    add_phase,
    adjust_phase_only_slm_range,
    calculate_amplitude,
    calculate_intensity,
    calculate_phase,
    wavenumber,
)

__all__ = [
    "add_phase",
    "adjust_phase_only_slm_range",
    "calculate_amplitude",
    "calculate_intensity",
    "calculate_phase",
    "compose_double_phase",
    "decompose_double_phase",
    "generate_complex_field",
    "normalize_phase",
    "produce_phase_only_slm_pattern",
    "set_amplitude",
    "wavenumber",
]


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


def normalize_phase(phase: torch.Tensor, range_min: float = 0.0, range_max: float = 2 * math.pi) -> torch.Tensor:
    """Return `phase` stretched linearly so that its extremes are `range_min` and `range_max`.

    Parameters
    ----------
    phase : torch.Tensor
        Real, of any shape.
    range_min, range_max : float
        Ends of the range, `range_max` the larger.

    Returns
    -------
    torch.Tensor
        Of the same shape; a constant phase becomes the middle of the range.

    Raises
    ------
    ValueError
        If the range is empty.
    """
    phase = floating("phase", phase)
    if not phase.numel():
        raise ValueError(f"phase must not be empty, got {list(phase.shape)}")
    _validate.real("range_min", range_min)
    _validate.real("range_max", range_max)
    if not range_max > range_min:
        raise ValueError(f"range_max must be larger than range_min = {range_min!r}, got {range_max!r}")
    low, high = phase.min(), phase.max()
    flat = high == low
    unit = (phase - low) / torch.where(flat, torch.ones_like(high), high - low)
    return range_min + (range_max - range_min) * torch.where(flat, torch.full_like(unit, 0.5), unit)


def produce_phase_only_slm_pattern(
    hologram: torch.Tensor, slm_range: float, bits: int = 8, default_range: float = 6.28, illumination: Any = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a hologram as a modulator shows it and its levels: :func:`odak.wave.produce_phase_only_slm_pattern`."""
    return utils.produce_phase_only_slm_pattern(hologram, slm_range, None, bits, default_range, illumination)
