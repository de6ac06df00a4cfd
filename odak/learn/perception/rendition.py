"""Rendition of colours by light: the colour rendering index, and the fidelity and gamut of TM-30, of spectra."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from odak import _show
from odak.learn._tensors import floating_tensor, in_float64
from odak.learn.perception.appearance import _SECOND_CONSTANT, correlated_color_temperature, uniform_colours
from odak.learn.perception.color import CONES, constant, root, rows
from odak.learn.perception.display_color import _checked_axis, _from_table, color_matching_functions, spectrum_to_xyz

_HUES = 16
# Temperatures between which TM-30 mixes black body and daylight; the colour rendering index changes at the second.
_MIXED_FROM, _DAYLIGHT_FROM = 4000.0, 5000.0
# Luminance in cd/m² that the eye of TM-30 is adapted to.
_ADAPTING = 100.0
# Rounding makes no sample black whose cube root has no slope.
_DARKEST = 1e-9


@_show.shown
class ColorRendering(NamedTuple):
    """How light renders colours, by the colour rendering index.

    Attributes
    ----------
    general : torch.Tensor
        Rₐ, the mean of the first eight indices, ``[...]``.
    special : torch.Tensor
        Indices R₁ … R₁₄ of the test colours ``[..., 14]``; R₉ is a saturated red.
    temperature : torch.Tensor
        Correlated colour temperature in kelvins ``[...]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import color_rendering_index
    >>> axis = torch.arange(380.0, 781.0, 5.0, dtype=torch.float64)
    >>> body = axis**-5 / torch.expm1(1.4388e-2 / (axis * 1e-9 * 3000))
    >>> found = color_rendering_index(body, axis)
    >>> round(found.general.item()), round(found.temperature.item(), -1)
    (100, 3000.0)
    """

    general: torch.Tensor
    special: torch.Tensor
    temperature: torch.Tensor


@_show.shown
class ColorFidelity(NamedTuple):
    """How light renders colours, by TM-30.

    Attributes
    ----------
    fidelity : torch.Tensor
        R_f, 0 … 100, ``[...]``.
    gamut : torch.Tensor
        R_g, 100 where colours are as saturated as under the reference, ``[...]``.
    samples : torch.Tensor
        Fidelity of each of the 99 samples ``[..., 99]``.
    temperature : torch.Tensor
        Correlated colour temperature in kelvins ``[...]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import color_fidelity
    >>> axis = torch.arange(380.0, 781.0, 5.0, dtype=torch.float64)
    >>> body = axis**-5 / torch.expm1(1.4388e-2 / (axis * 1e-9 * 3000))
    >>> found = color_fidelity(body, axis)
    >>> round(found.fidelity.item()), tuple(found.samples.shape)
    (100, (99,))
    """

    fidelity: torch.Tensor
    gamut: torch.Tensor
    samples: torch.Tensor
    temperature: torch.Tensor


def color_rendering_index(spectrum: torch.Tensor, wavelengths: torch.Tensor | Sequence[float]) -> ColorRendering:
    """Return the colour rendering index of light (CIE 13.3-1995).

    Parameters
    ----------
    spectrum : torch.Tensor
        Power per nanometre ``[..., S]``, of any unit.
    wavelengths : torch.Tensor or sequence of float
        In nanometres, rising, S of them; steps of 5 nm or less from 380 to 780 nm.

    Returns
    -------
    ColorRendering
        Float64, differentiable in the spectrum; not a number where there is no colour temperature.

    Raises
    ------
    ValueError, TypeError
        If the spectrum is no tensor of real floats, the numbers of samples differ, or the wavelengths do not rise.

    Notes
    -----
    The reference is the black body of the same temperature below 5000 K, and daylight from there on.

    Examples
    --------
    Daylight renders colours as itself; the spectra of three narrow lines do not:

    >>> import torch
    >>> from odak.learn.perception import color_rendering_index, illuminant_d65
    >>> axis = torch.arange(380.0, 781.0, 5.0, dtype=torch.float64)
    >>> lines = torch.exp(-(((axis[:, None] - torch.tensor([450.0, 540.0, 610.0])) / 10) ** 2)).sum(1)
    >>> [round(color_rendering_index(light, axis).general.item()) for light in (illuminant_d65(axis), lines)]
    [100, 69]
    """
    light, axis = _checked(spectrum, wavelengths)
    temperature, likened = _temperature(light, axis)
    body, daylight = _references(likened, axis)
    reference = torch.where((likened < _DAYLIGHT_FROM)[..., None], body, daylight)
    observer = color_matching_functions(axis)
    (white, seen), (white_0, seen_0) = (_seen(one, axis, observer, "CIE 1995") for one in (light, reference))
    (u, v), (u_0, v_0), (u_k, v_k), (u_r, v_r) = map(_uv, (seen, seen_0, white, white_0))
    # The colours that look under the reference as the samples do under the light, by von Kries.
    c = _c(u, v) * _c(u_r, v_r) / _c(u_k, v_k)
    d = _d(u, v) * _d(u_r, v_r) / _d(u_k, v_k)
    divisor = 16.518 + 1.481 * c - d
    places = ((10.872 + 0.404 * c - 4 * d) / divisor, 5.520 / divisor), (u_0, v_0)
    colours = []
    for one, (a, b) in zip((seen, seen_0), places, strict=True):
        lightness = 25 * (100 * one[..., 1, :]).clamp_min(_DARKEST) ** (1 / 3) - 17
        colours.append(torch.stack([lightness, 13 * lightness * (a - u_r), 13 * lightness * (b - v_r)]))
    special = 100 - 4.6 * root((colours[0] - colours[1]).square().sum(0))
    special = special.where(temperature.isfinite()[..., None], math.nan)
    return ColorRendering(special[..., :8].mean(-1), special, temperature)


def color_fidelity(spectrum: torch.Tensor, wavelengths: torch.Tensor | Sequence[float]) -> ColorFidelity:
    """Return the fidelity and the gamut of colours under light (ANSI/IES TM-30-20; CIE 224:2017).

    Parameters
    ----------
    spectrum : torch.Tensor
        Power per nanometre ``[..., S]``, of any unit.
    wavelengths : torch.Tensor or sequence of float
        In nanometres, rising, S of them; steps of 5 nm or less from 380 to 780 nm.

    Returns
    -------
    ColorFidelity
        Float64, differentiable in the spectrum; not a number where there is no colour temperature.

    Raises
    ------
    ValueError, TypeError
        If the spectrum is no tensor of real floats, the numbers of samples differ, or the wavelengths do not rise.

    Notes
    -----
    Colours are those of CAM02-UCS for the observer of 10°, adapted to the light. The reference is a black body below
    4000 K, daylight above 5000 K, and a mixture of equal luminances between.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import color_fidelity
    >>> axis = torch.arange(380.0, 781.0, 5.0, dtype=torch.float64)
    >>> lines = torch.exp(-(((axis[:, None] - torch.tensor([450.0, 540.0, 610.0])) / 10) ** 2)).sum(1)
    >>> found = color_fidelity(lines, axis)
    >>> round(found.fidelity.item()), round(found.gamut.item())
    (64, 116)
    """
    light, axis = _checked(spectrum, wavelengths)
    temperature, likened = _temperature(light, axis)
    observer = color_matching_functions(axis, "CIE 1964")
    body, daylight = (one / torch.trapezoid(one * observer[1], axis)[..., None] for one in _references(likened, axis))
    share = ((likened - _MIXED_FROM) / (_DAYLIGHT_FROM - _MIXED_FROM)).clamp(0, 1)[..., None]
    found = [_uniform(*_seen(one, axis, observer, "CIE 2017")) for one in (light, body.lerp(daylight, share))]
    apart = root((found[0] - found[1]).square().sum(-2))
    hue = torch.atan2(found[1][..., 2, :], found[1][..., 1, :]) % (2 * math.pi)
    bins = (hue * (_HUES / (2 * math.pi))).long() % _HUES
    bins = (bins[..., None] == torch.arange(_HUES, device=light.device)).to(light)
    areas = []
    for one in found:
        a, b = (one[..., 1:, :] @ bins / bins.sum(-2, keepdim=True)).unbind(-2)
        areas.append((a * b.roll(-1, -1) - b * a.roll(-1, -1)).sum(-1))
    apart = apart.where(temperature.isfinite()[..., None], math.nan)
    gamut = (100 * areas[0] / areas[1]).where(temperature.isfinite(), math.nan)
    return ColorFidelity(_fidelity(apart.mean(-1)), gamut, _fidelity(apart), temperature)


def _checked(spectrum, wavelengths):
    light = in_float64(floating_tensor("spectrum", spectrum))
    return light, _checked_axis("wavelengths", wavelengths).double().to(light.device)


def _temperature(light, axis):
    """Return the colour temperature, and that of the reference: light without a temperature gets no index by any."""
    found = correlated_color_temperature(spectrum_to_xyz(light, axis)[..., None, None])
    temperature = found[..., 0, 0, 0].reshape(light.shape[:-1])
    return temperature, temperature.where(temperature.isfinite(), _DAYLIGHT_FROM)


def _references(temperature, axis):
    """Return the spectra of black bodies and of daylight of given temperatures, ``[..., S]``."""
    t = temperature[..., None]
    body = axis**-5 / torch.expm1(_SECOND_CONSTANT / (axis * 1e-9 * t))
    cold = -4.6070e9 / t**3 + 2.9678e6 / t**2 + 99.11 / t + 0.244063
    hot = -2.0064e9 / t**3 + 1.9018e6 / t**2 + 247.48 / t + 0.237040
    x = torch.where(t <= 7000, cold, hot)
    y = -3 * x**2 + 2.870 * x - 0.275
    m = 0.0241 + 0.2562 * x - 0.7341 * y
    mean, first, second = _from_table("daylight", axis)
    one, two = (-1.3515 - 1.7703 * x + 5.9114 * y) / m, (0.0300 - 31.4424 * x + 30.0717 * y) / m
    return body, mean + one * first + two * second


def _seen(light, axis, observer, samples):
    """Return XYZ of light ``[..., 3, 1]`` and of samples in it ``[..., 3, N]``, the light having Y = 1."""
    weights = observer * light[..., None, :]
    white = torch.trapezoid(weights, axis)[..., None]
    luminance = white[..., 1:2, :]
    return white / luminance, torch.trapezoid(weights[..., None, :] * _from_table(samples, axis), axis) / luminance


def _uniform(white, colours):
    """Return CAM02-UCS ``[..., 3, N]`` of colours to an eye that is adapted to the white altogether."""
    cones = constant(rows(np.array(CONES["CAT02"])), white.dtype, white.device)
    # Under a white of equal energy no adaptation is left to be done.
    adapted = torch.linalg.inv(cones) @ (cones @ colours / (cones @ white))
    found = uniform_colours(adapted[..., None], (1.0, 1.0, 1.0), _ADAPTING, model="CAM02")
    return found[..., 0].reshape(colours.shape)


def _fidelity(apart):
    return 10 * torch.nn.functional.softplus((100 - 6.73 * apart) / 10)


def _uv(xyz):
    x, y, z = xyz.unbind(-2)
    total = x + 15 * y + 3 * z
    return 4 * x / total, 6 * y / total


def _c(u, v):
    return (4 - u - 10 * v) / v


def _d(u, v):
    return (1.708 * v + 0.404 - 1.481 * u) / v
