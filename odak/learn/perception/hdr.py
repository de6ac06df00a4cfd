"""Absolute luminance as signals and back: PQ, HLG and PU21, differentiable.

Luminance is in candelas per square metre. Every function works element by element on tensors of any shape unless it
needs the three channels. Values follow the standards; gradients are finite everywhere. Where the true
derivative at black is infinite (PQ, the square root of HLG) the gradient at a small luminance, which the docstrings
name, is used instead.
"""

import math
from typing import overload

import torch

from odak import _validate
from odak.learn._tensors import (
    above_zero,
    as_pictures,
    floating_tensor,
    in_float32,
    in_float64,
    tell_scale,
    weighted_channels,
)

PQ_PEAK = 10000.0
_M1, _M2 = 2610 / 16384, 2523 / 4096 * 128
_C1, _C2, _C3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
# Below this luminance over the peak, the gradient is that at this luminance.
_PQ_FLOOR = 1e-9
_PQ_POWER = _PQ_FLOOR**_M1
_PQ_RATIO = (_C1 + _C2 * _PQ_POWER) / (1 + _C3 * _PQ_POWER)
_PQ_DERIVATIVE = _M2 * _PQ_RATIO ** (_M2 - 1) * (_C2 - _C1 * _C3) / (1 + _C3 * _PQ_POWER) ** 2
_PQ_DERIVATIVE *= _M1 * _PQ_POWER / _PQ_FLOOR

_HLG_A = 0.17883277
_HLG_B, _HLG_C = 1 - 4 * _HLG_A, 0.5 - _HLG_A * math.log(4 * _HLG_A)
_HLG_FLOOR = 1e-6
_HLG_DERIVATIVE = 0.5 * math.sqrt(3 / _HLG_FLOOR)
_BT2020_LUMA = (0.2627, 0.6780, 0.0593)
_DARKEST = 1e-9

PU21_LIMITS = (0.005, 10000.0)
PU21_PARAMETERS = {
    "banding": (1.070275272, 0.4088273932, 0.153224308, 0.2520326168, 1.063512885, 1.14115047, 521.4527484),
    "banding_glare": (
        0.353487901, 0.3734658629, 8.277049286e-05, 0.9062562627, 0.09150303166, 0.9099517204, 596.3148142,
    ),
    "peaks": (1.043882782, 0.6459495343, 0.3194584211, 0.374025247, 1.114783422, 1.095360363, 384.9217577),
    "peaks_glare": (
        816.885024, 1479.463946, 0.001253215609, 0.9329636822, 0.06746643971, 1.573435413, 419.6006374,
    ),
}  # fmt: skip


def pq_encode(luminance: torch.Tensor) -> torch.Tensor:
    """Return the PQ signal of luminance (inverse EOTF of SMPTE ST 2084:2014 and ITU-R BT.2100-2, table 4).

    Parameters
    ----------
    luminance : torch.Tensor
        In cd/m², clipped to 0 … 10 000.

    Returns
    -------
    torch.Tensor
        0 … 1 in the input's shape and precision. The gradient below 1e-5 cd/m² is that at 1e-5, as the true one
        grows without bound; outside 0 … 10 000 it is 0.

    Raises
    ------
    TypeError
        If the luminance is not a tensor of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import pq_encode
    >>> [round(value, 4) for value in pq_encode(torch.tensor([100.0, 10000.0])).tolist()]
    [0.5081, 1.0]
    """
    relative = in_float32(floating_tensor("luminance", luminance)).clamp(0, PQ_PEAK) / PQ_PEAK
    return _with_bounded_gradient(_pq_signal, relative, _PQ_FLOOR, _PQ_DERIVATIVE).to(luminance)


def pq_decode(signal: torch.Tensor) -> torch.Tensor:
    """Return the luminance of a PQ signal (EOTF of SMPTE ST 2084:2014): the inverse of :func:`pq_encode`.

    Parameters
    ----------
    signal : torch.Tensor
        0 … 1; values outside are clipped.

    Returns
    -------
    torch.Tensor
        0 … 10 000 cd/m² in the input's shape and precision. The gradient below 1e-5 cd/m² is that at 1e-5, so that it
        is not 0 at black; outside 0 … 1 it is 0.

    Raises
    ------
    TypeError
        If the signal is not a tensor of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import pq_decode
    >>> [round(value) for value in pq_decode(torch.tensor([0.0, 0.508078, 1.0])).tolist()]
    [0, 100, 10000]
    """
    clipped = in_float32(_signal(signal)).clamp(0, 1)
    return _with_bounded_gradient(_pq_luminance, clipped, _PQ_RATIO**_M2, PQ_PEAK / _PQ_DERIVATIVE).to(signal)


def hlg_encode(light: torch.Tensor) -> torch.Tensor:
    """Return the HLG signal of scene light (OETF, ITU-R BT.2100-2, table 5).

    Parameters
    ----------
    light : torch.Tensor
        Linear scene light, 1 at the peak; negative values are set to 0, above 1 the logarithm goes on.

    Returns
    -------
    torch.Tensor
        0 … 1 in the input's shape and precision. The gradient below 1e-6 is that at 1e-6; below 0 it is 0.

    Raises
    ------
    TypeError
        If the light is not a tensor of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import hlg_encode
    >>> [round(value, 4) for value in hlg_encode(torch.tensor([0.0, 1 / 12, 1.0])).tolist()]
    [0.0, 0.5, 1.0]
    """
    light = floating_tensor("light", light).clamp_min(0)
    return _with_bounded_gradient(_hlg_signal, light, _HLG_FLOOR, _HLG_DERIVATIVE)


def hlg_decode(signal: torch.Tensor) -> torch.Tensor:
    """Return the scene light of an HLG signal: the inverse of :func:`hlg_encode`, with finite gradients.

    Parameters
    ----------
    signal : torch.Tensor
        0 … 1; negative values are set to 0, above 1 the exponential goes on.

    Returns
    -------
    torch.Tensor
        Linear scene light in the input's shape and precision. The gradient for light below 1e-6 is that at 1e-6, so
        that it is not 0 at black; below 0 it is 0.

    Raises
    ------
    TypeError
        If the signal is not a tensor of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import hlg_decode
    >>> [round(value, 4) for value in hlg_decode(torch.tensor([0.0, 0.5, 1.0])).tolist()]
    [0.0, 0.0833, 1.0]
    """
    signal = _signal(signal).clamp_min(0)
    return _with_bounded_gradient(_hlg_light, signal, math.sqrt(3 * _HLG_FLOOR), 1 / _HLG_DERIVATIVE)


@overload
def hlg_system_gamma(peak_luminance: float) -> float: ...


@overload
def hlg_system_gamma(peak_luminance: torch.Tensor) -> torch.Tensor: ...


def hlg_system_gamma(peak_luminance: float | torch.Tensor) -> float | torch.Tensor:
    """Return the system gamma of an HLG display (ITU-R BT.2100-2, notes to table 5).

    Parameters
    ----------
    peak_luminance : float or torch.Tensor
        Luminance of white in cd/m².

    Returns
    -------
    float or torch.Tensor
        1.2 + 0.42·log₁₀(L/1000) for 400 … 2000 cd/m², 1.2·1.111^log₂(L/1000) elsewhere; of a tensor a tensor, which
        keeps its gradient.

    Raises
    ------
    ValueError, TypeError
        If the luminance is not positive.

    Examples
    --------
    >>> from odak.learn.perception import hlg_system_gamma
    >>> hlg_system_gamma(1000.0)
    1.2
    """
    peak = _single("peak_luminance", peak_luminance, positive=True)
    decades = (torch.log10 if isinstance(peak, torch.Tensor) else math.log10)(peak / 1000)
    if 400 <= peak <= 2000:
        return 1.2 + 0.42 * decades
    return 1.2 * 1.111 ** (decades / math.log10(2))


def hlg_to_luminance(
    signal: torch.Tensor, peak_luminance: float = 1000.0, black_luminance: float = 0.0
) -> torch.Tensor:
    """Return the luminance that an HLG display emits (EOTF, ITU-R BT.2100-2, table 5).

    Parameters
    ----------
    signal : torch.Tensor
        HLG R′G′B′ ``[..., 3, H, W]`` with the primaries of BT.2020, 0 … 1.
    peak_luminance : float or torch.Tensor
        Luminance of white on the display, in cd/m².
    black_luminance : float
        Luminance of black on the display, in cd/m².

    Returns
    -------
    torch.Tensor
        Luminance of each channel in cd/m², ``[..., 3, H, W]`` in the input's precision, with finite gradients.

    Raises
    ------
    ValueError, TypeError
        If the signal does not have three channels of real floats, or the luminances are not rising.

    Examples
    --------
    White has the peak luminance:

    >>> import torch
    >>> from odak.learn.perception import hlg_to_luminance
    >>> round(hlg_to_luminance(torch.ones(1, 3, 1, 1)).max().item())
    1000
    """
    peak, gamma, lift = _hlg_display(peak_luminance, black_luminance)
    light = hlg_decode((1 - lift) * _rgb("signal", signal) + lift)
    return peak * weighted_channels(light, _BT2020_LUMA).clamp_min(_DARKEST) ** (gamma - 1) * light


def luminance_to_hlg(
    luminance: torch.Tensor, peak_luminance: float = 1000.0, black_luminance: float = 0.0
) -> torch.Tensor:
    """Return the HLG signal of the luminance that a display is to emit: the inverse of :func:`hlg_to_luminance`.

    Parameters
    ----------
    luminance : torch.Tensor
        Of each channel in cd/m², ``[..., 3, H, W]`` with the primaries of BT.2020; negative values are set to 0.
    peak_luminance : float or torch.Tensor
        Luminance of white on the display, in cd/m².
    black_luminance : float
        Luminance of black on the display, in cd/m².

    Returns
    -------
    torch.Tensor
        Signal ``[..., 3, H, W]`` in the input's precision; below 0 where the display is never so dark.

    Raises
    ------
    ValueError, TypeError
        If the picture does not have three channels of real floats, or the luminances are not rising.

    Examples
    --------
    The peak luminance is the signal 1:

    >>> import torch
    >>> from odak.learn.perception import luminance_to_hlg
    >>> round(luminance_to_hlg(torch.full((1, 3, 1, 1), 1000.0)).max().item(), 4)
    1.0
    """
    peak, gamma, lift = _hlg_display(peak_luminance, black_luminance)
    emitted = _rgb("luminance", luminance).clamp_min(0) / peak
    light = weighted_channels(emitted, _BT2020_LUMA).clamp_min(_DARKEST**gamma) ** (1 / gamma - 1) * emitted
    return (hlg_encode(light) - lift) / (1 - lift)


def pu21_encode(luminance: torch.Tensor, variant: str = "banding_glare") -> torch.Tensor:
    """Return perceptually uniform values of luminance, on which metrics for ordinary pictures may be used.

    Parameters
    ----------
    luminance : torch.Tensor
        In cd/m², clipped to 0.005 … 10 000.
    variant : {"banding_glare", "banding", "peaks", "peaks_glare"}
        Threshold data behind the curve.

    Returns
    -------
    torch.Tensor
        From 0 at 0.005 cd/m² through about 256 at 100 to 595.4 ("banding_glare") at 10 000, in the input's shape and
        precision. The gradient below the range is that at its end, so that it is not 0 at black; above it is 0.

    Raises
    ------
    ValueError, TypeError
        If the luminance is not a tensor of real floats or the variant is not known.

    Notes
    -----
    Mantiuk and Azimi, Picture Coding Symposium (2021), and the parameters published with it. Give metrics a data range
    of 256 where white of 100 cd/m² is the peak.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import pu21_encode
    >>> round(pu21_encode(torch.tensor(100.0)).item()), round(pu21_encode(torch.tensor(1e4)).item(), 1)
    (256, 595.4)
    """
    p = PU21_PARAMETERS[_validate.one_of("variant", variant, PU21_PARAMETERS)]
    clipped = in_float64(floating_tensor("luminance", luminance)).clamp_max(PU21_LIMITS[1])
    power = (PU21_LIMITS[0] + above_zero(clipped - PU21_LIMITS[0])) ** p[3]
    values = p[6] * (((p[0] + p[1] * power) / (1 + p[2] * power)) ** p[4] - p[5])
    return above_zero(values).to(luminance)


def pu21_decode(values: torch.Tensor, variant: str = "banding_glare") -> torch.Tensor:
    """Return the luminance of perceptually uniform values: the inverse of :func:`pu21_encode`.

    Parameters
    ----------
    values : torch.Tensor
        As :func:`pu21_encode` gives them; values outside its range are clipped to it.
    variant : {"banding_glare", "banding", "peaks", "peaks_glare"}
        Threshold data behind the curve.

    Returns
    -------
    torch.Tensor
        0.005 … 10 000 cd/m² in the input's shape and precision, with finite gradients.

    Raises
    ------
    ValueError, TypeError
        If the values are not a tensor of real floats or the variant is not known.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import pu21_decode
    >>> from odak.learn.perception import pu21_encode
    >>> round(pu21_decode(pu21_encode(torch.tensor(50.0))).item(), 2)
    50.0
    """
    p = PU21_PARAMETERS[_validate.one_of("variant", variant, PU21_PARAMETERS)]
    # Roots of the eleventh order lose two digits in float32.
    power_limits = [limit ** p[3] for limit in PU21_LIMITS]
    low, high = (p[6] * (((p[0] + p[1] * power) / (1 + p[2] * power)) ** p[4] - p[5]) for power in power_limits)
    root = (in_float64(floating_tensor("values", values)).clamp(low, high) / p[6] + p[5]) ** (1 / p[4])
    power = (root - p[0]) / (p[1] - p[2] * root)
    # Rounding must not leave the range, below which the power has no gradient.
    return (power.clamp(*power_limits) ** (1 / p[3])).to(values)


def _pq_luminance(signal):
    # With e = signal^(1/m₂) − 1 and c₂ − c₃ = 1 − c₁ neither difference loses digits at bright signals.
    e = torch.expm1(signal.clamp_min(_C1**_M2).log() / _M2)
    ratio = ((1 - _C1) + e).clamp_min(0) / ((1 - _C1) - _C3 * e)
    return PQ_PEAK * ratio ** (1 / _M1)


def _pq_signal(y):
    power = y**_M1
    # As c₂ − c₃ = 1 − c₁, the ratio is 1 − (1 − c₁)·(1 − t)/(1 + c₃·t), which keeps its digits near the peak.
    return torch.exp(_M2 * torch.log1p(-(1 - _C1) * (1 - power) / (1 + _C3 * power)))


def _hlg_light(signal):
    bright = (torch.exp((signal.clamp_min(0.5) - _HLG_C) / _HLG_A) + _HLG_B) / 12
    return torch.where(signal > 0.5, bright, signal**2 / 3)


def _hlg_signal(light):
    bright = _HLG_A * torch.log(12 * light.clamp_min(1 / 12) - _HLG_B) + _HLG_C
    return torch.where(light > 1 / 12, bright, (3 * light).sqrt())


def _with_bounded_gradient(function, value, floor, derivative):
    """Return function(value) with the gradient `derivative` for values below `floor`."""
    with torch.no_grad():
        exact = function(value.detach())
    dark = exact + derivative * (value - value.detach())
    return torch.where(value < floor, dark, function(value.clamp_min(floor)))


def _hlg_display(peak, black):
    gamma, peak = hlg_system_gamma(peak), _single("peak_luminance", peak, positive=True)
    black = _single("black_luminance", black)
    if not 0 <= black < peak:
        raise ValueError(f"black_luminance must be at least 0 and less than the peak {peak}, got {black}")
    # The power of zero would have no finite gradient.
    return peak, gamma, (3 * (black / peak) ** (1 / gamma)) ** 0.5 if black > 0 else 0.0


def _single(name, value, *, positive=False):
    """Return a checked number as a float; a tensor stays a tensor without axes, which keeps its gradient."""
    value = _validate.number(name, value, positive=positive)
    return value.double().reshape(()) if isinstance(value, torch.Tensor) else float(value)


def _rgb(name, picture):
    as_pictures(name, picture)
    return picture


def _signal(value):
    value = floating_tensor("signal", value)
    tell_scale("signal", value, "divide code values by the largest one, such as 1023")
    return value
