"""Formulas of single pixels ``[..., 3, n]``, or of single values, behind the conversions of colour.

They make few passes, keep gradients finite, and leave cutting pictures into blocks to
:mod:`odak.learn.perception.pixel_blocks`.
"""

import math
from collections.abc import Callable

import numpy as np
import torch
from torch.nn import functional

from odak.learn.perception.color_matrices import (
    BT709_PRIMARIES,
    LAB_WHITE,
    _rgb_to_xyz_rows,
    constant,
    in_float64,
    rows,
)

_RELATIVE = _rgb_to_xyz_rows(BT709_PRIMARIES, LAB_WHITE) / np.array(LAB_WHITE)[:, None]
_RGB_TO_RELATIVE, _RELATIVE_TO_RGB = rows(_RELATIVE), rows(np.linalg.inv(_RELATIVE))
_TO_LAB = ((0.0, 116.0, 0.0), (500.0, -500.0, 0.0), (0.0, 200.0, -200.0))
_FROM_LAB = ((1 / 116, 1 / 500, 0.0), (1 / 116, 0.0, 0.0), (1 / 116, 0.0, -1 / 200))
_BLACK = ((16.0,), (0.0,), (0.0,))
_LAB_JOINT = 6 / 29
_LAB_SLOPE, _LAB_STEP = 1 / (3 * _LAB_JOINT**2), 4 / 29
_DECODED_FROM, _ENCODED_FROM = 0.04045, 0.0031308


def decoded(values: torch.Tensor) -> torch.Tensor:
    """Return the linear light of sRGB values (IEC 61966-2-1:1999, section 5.2)."""
    return _piecewise(values, _DECODED_FROM, lambda v: _power(v.add_(0.055).mul_(1 / 1.055), 2.4), 0.002, 1 / 12.92)


def encoded(values: torch.Tensor, threshold: float = _ENCODED_FROM) -> torch.Tensor:
    """Return the sRGB values of linear light (IEC 61966-2-1:1999, section 5.3)."""
    middle = 1.055 * (threshold / 2) ** (1 / 2.4) - 0.055
    return _piecewise(values, threshold, lambda v: (1.055 * _power(v, 1 / 2.4)).sub_(0.055), middle, 12.92)


def decoded_slopes(values: torch.Tensor, light: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """Return the gradient of :func:`decoded`, without a power: d(light) = 2.4·light/(value + 0.055)."""
    steep = (light / values.clamp_min(0).add_(0.055)).mul_(2.4)
    return _chosen(values, _DECODED_FROM, steep, 1 / 12.92).mul_(gradient)


def encoded_slopes(
    light: torch.Tensor, values: torch.Tensor, gradient: torch.Tensor, threshold: float = _ENCODED_FROM
) -> torch.Tensor:
    """Return the gradient of :func:`encoded`, without a power: d(value) = (value + 0.055)/(2.4·light)."""
    steep = (values + 0.055).div_(light.clamp_min(threshold)).mul_(1 / 2.4)
    return _chosen(light, threshold, steep, 12.92).mul_(gradient)


def _chosen(values, edge, above, below):
    """Return one or the other by whether values are above an edge."""
    high = functional.threshold(values, edge, 0.0).sign_()
    return torch.lerp(torch.full_like(above, below), above, high)


def _piecewise(
    values: torch.Tensor,
    edge: float,
    curve: Callable[[torch.Tensor], torch.Tensor],
    middle: float,
    slope: float,
    step: float = 0.0,
) -> torch.Tensor:
    """Return a rising curve of values above an edge, and ``slope·value + step`` of the others.

    `middle` lies between the curve at an eighth of the edge and at the edge. The curve is not evaluated anywhere else
    below the edge, so that its gradients are finite. Choosing by comparisons takes several times longer than the
    thresholds of neural networks.
    """
    curved = functional.threshold(curve(functional.threshold(values, edge, edge / 8)), middle, step)
    return curved.sub_(functional.threshold(values, edge, 0.0).sub_(values), alpha=slope)


def _power(base, exponent):
    # Twice as fast as a general power, which must heed signs.
    return torch.exp2(base.log2().mul_(exponent))


def to_hsv(rgb: torch.Tensor, eps: float) -> tuple[torch.Tensor, ...]:
    """Return hue in radians, saturation and value."""
    red, green, blue = rgb.unbind(-2)
    value = torch.maximum(torch.maximum(red, green), blue)
    span = value - torch.minimum(torch.minimum(red, green), blue)
    chroma = _or_one(span)
    red, green, blue = value - red, value - green, value - blue
    # Signs, 0 or 1 here, choose several times faster than comparisons. The first of equal channels counts as largest.
    others = torch.lerp(red - blue + 2 * chroma, green - red + 4 * chroma, green.sign())
    sixths = torch.lerp(blue - green, others, red.sign()) / chroma
    # What is a tiny negative angle rounds to a whole turn first.
    hue = _modulo_six(_modulo_six(sixths)) * (math.pi / 3)
    return hue, span / _or_one(value + eps), value


def _or_one(values):
    """Return values, 1 in place of 0."""
    return values + (1 - values.sign().abs())


def from_hsv(hsv: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Return red, green and blue."""
    hue, saturation, value = hsv.unbind(-2)
    lost = saturation * value
    return tuple(value - lost * (1 - place.clamp(0, 1)) for place, _ in _ramps(hue))


def from_hsv_slopes(hsv: torch.Tensor, rgb: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """Return the gradient of :func:`from_hsv`."""
    hue, saturation, value = hsv.unbind(-2)
    lost, turn = torch.zeros_like(hue), torch.zeros_like(hue)
    for (place, direction), outer in zip(_ramps(hue), gradient.unbind(-2), strict=True):
        lost.addcmul_(outer, 1 - place.clamp(0, 1))
        # Zero where the ramp is cut off.
        turn.addcmul_(outer, direction * (1 - (place - place.clamp(0, 1)).abs().sign()))
    by_hue = turn.mul_(3 / math.pi).mul_(saturation).mul_(value)
    return torch.stack([by_hue, -value * lost, gradient.sum(-2).addcmul_(saturation, lost, value=-1)], -2)


def _ramps(hue):
    """Return, for each channel, the ramp that is 1 where the channel is full and 0 where it is not, and its slope."""
    sixths = _modulo_six(hue * (3 / math.pi))
    from_cyan, from_green, from_blue = sixths - 3, sixths - 2, sixths - 4
    return (
        (from_cyan.abs() - 1, from_cyan.sign()),
        (2 - from_green.abs(), -from_green.sign()),
        (2 - from_blue.abs(), -from_blue.sign()),
    )


def _modulo_six(angle):
    return angle - 6 * (angle / 6).floor()


def to_lab(rgb: torch.Tensor) -> torch.Tensor:
    """Return CIE 1976 L*a*b* of sRGB, computed in float64."""
    rgb, dtype = in_float64(rgb), rgb.dtype
    light = _matrix(_RGB_TO_RELATIVE, rgb) @ decoded(rgb)
    roots = _piecewise(light, _LAB_JOINT**3, lambda v: _power(v, 1 / 3), 0.7 * _LAB_JOINT, _LAB_SLOPE, _LAB_STEP)
    return (_matrix(_TO_LAB, rgb) @ roots).sub_(_matrix(_BLACK, rgb)).to(dtype)


def to_lab_slopes(rgb: torch.Tensor, lab: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """Return the gradient of :func:`to_lab`."""
    roots = _matrix(_FROM_LAB, lab) @ (lab + _matrix(_BLACK, lab))
    steep = roots.clamp_min(_LAB_JOINT).square_().mul_(3).reciprocal_()
    gradient = (_matrix(_TO_LAB, lab).T @ gradient).mul_(_chosen(roots, _LAB_JOINT, steep, _LAB_SLOPE))
    return decoded_slopes(rgb, decoded(rgb), _matrix(_RGB_TO_RELATIVE, rgb).T @ gradient)


def from_lab(lab: torch.Tensor) -> torch.Tensor:
    """Return sRGB of CIE 1976 L*a*b*, computed in float64."""
    lab, dtype = in_float64(lab), lab.dtype
    roots = _matrix(_FROM_LAB, lab) @ (lab + _matrix(_BLACK, lab))
    slope = 1 / _LAB_SLOPE
    light = _piecewise(roots, _LAB_JOINT, lambda v: v**3, (_LAB_JOINT / 2) ** 3, slope, -_LAB_STEP * slope)
    return encoded(_matrix(_RELATIVE_TO_RGB, lab) @ light).to(dtype)


def from_lab_slopes(lab: torch.Tensor, rgb: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """Return the gradient of :func:`from_lab`."""
    gradient = _matrix(_RELATIVE_TO_RGB, lab).T @ encoded_slopes(decoded(rgb), rgb, gradient)
    roots = _matrix(_FROM_LAB, lab) @ (lab + _matrix(_BLACK, lab))
    steep = roots.square().mul_(3)
    return _matrix(_FROM_LAB, lab).T @ gradient.mul_(_chosen(roots, _LAB_JOINT, steep, 1 / _LAB_SLOPE))


def _matrix(entries, like):
    return constant(entries, like.dtype, like.device)
