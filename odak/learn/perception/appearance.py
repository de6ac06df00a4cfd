"""Colours as they appear: models of appearance and their uniform spaces, opponent colours, colour temperature."""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from odak import _validate
from odak.learn._tensors import above_zero, as_pictures, in_float32, in_float64
from odak.learn.perception.color import (
    CONES,
    DARKEST,
    IEC_WHITE,
    _hue,
    _white,
    decoded_in_float32,
    mix,
    root,
    rows,
    signed_power,
    tristimulus,
)
from odak.learn.perception.display_color import color_matching_functions

# Cones of XYZ whose gains adapt, and responses of these that are compressed.
_MODELS = {
    "CAM16": (np.array(CONES["CAT16"]), np.eye(3)),
    "CAM02": (np.array(CONES["CAT02"]), np.array(CONES["Hunt-Pointer-Estevez"]) @ np.linalg.inv(CONES["CAT02"])),
}
# Achromatic response and the two opponents of the compressed responses.
_TO_OPPONENT = np.array([(2.0, 1.0, 1 / 20), (1.0, -12 / 11, 1 / 11), (1 / 9, 1 / 9, -2 / 9)])
_FROM_OPPONENT = np.linalg.inv(_TO_OPPONENT)
_SATURATION = np.array([1.0, 1.0, 21 / 20])
# Factor of adaptation, impact of the surround, chromatic induction.
_SURROUNDS = {"average": (1.0, 0.69, 1.0), "dim": (0.9, 0.59, 0.9), "dark": (0.8, 0.525, 0.8)}
# Unique red, yellow, green, blue and red again: angles and factors of eccentricity.
_UNIQUE_HUES = (20.14, 90.0, 164.25, 237.53, 380.14), (0.8, 0.7, 1.0, 1.2, 0.8)
_COMPRESSION, _HALF = 0.42, 27.13
# Responses of the cones of CIE 170-1 by XYZ of CIE 1931; the first two add up to about the luminance.
_LMS_2006 = np.array(
    [
        (0.187596268556126, 0.585168649077728, -0.026384263306304),
        (-0.133397430663221, 0.405505777260049, 0.034502127690364),
        (0.000244379021663, -0.000542995890619, 0.019406849066323),
    ]
)
# Second constant of radiation in m·K, and the range of temperatures in mireds, 10⁶/K, with their step.
_SECOND_CONSTANT = 1.4388e-2
_COLDEST, _HOTTEST, _STEP = 1001.0, 9.0, 1.0


class Appearance(NamedTuple):
    """Correlates of how colours appear, each ``[..., H, W]``, as :func:`color_appearance` finds them.

    Attributes
    ----------
    lightness : torch.Tensor
        J, 100 for the white.
    chroma : torch.Tensor
        C, colourfulness relative to the white.
    hue : torch.Tensor
        h, the angle in degrees, 0 … 360.
    brightness : torch.Tensor
        Q.
    colorfulness : torch.Tensor
        M.
    saturation : torch.Tensor
        s, colourfulness relative to the brightness of the colour itself.
    hue_quadrature : torch.Tensor
        H, 0 … 400: 0 unique red, 100 yellow, 200 green, 300 blue.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import color_appearance
    >>> green = color_appearance(torch.tensor([0.0777, 0.1554, 0.0259]).reshape(3, 1, 1))
    >>> 100 < green.hue_quadrature.item() < 200
    True
    """

    lightness: torch.Tensor
    chroma: torch.Tensor
    hue: torch.Tensor
    brightness: torch.Tensor
    colorfulness: torch.Tensor
    saturation: torch.Tensor
    hue_quadrature: torch.Tensor


@functools.lru_cache(maxsize=32)
def _viewing(white, luminance, background, model, surround):
    """Return what depends on the conditions of viewing: the matrix from XYZ to responses, and numbers by name."""
    cones, compressed = _MODELS[model]
    adapting, impact, chromatic = _SURROUNDS[surround]
    k = 1 / (5 * luminance + 1)
    level = 0.2 * k**4 * 5 * luminance + 0.1 * (1 - k**4) ** 2 * (5 * luminance) ** (1 / 3)
    degree = adapting * (1 - math.exp((-luminance - 42) / 92) / 3.6)
    degree = min(max(degree, 0.0), 1.0)
    gains = degree * white[1] / (cones @ np.array(white)) + 1 - degree
    matrix = compressed @ (gains[:, None] * cones)
    share = background / (100 * white[1])
    found = {
        "level": level,
        "impact": impact,
        "induction": (induction := 0.725 * share**-0.2),
        "chromatic": 50000 / 13 * chromatic * induction,
        "exponent": impact * (1.48 + math.sqrt(share)),
        "chroma": (1.64 - 0.29**share) ** 0.73,
    }
    # Achromatic responses to the white and to the darkest grey.
    powers = (level * np.array((1, DARKEST))[:, None] * (matrix @ np.array(white))) ** _COMPRESSION
    bright, dark = map(float, 400 * powers / (powers + _HALF) @ _TO_OPPONENT[0])
    return matrix, found | {"white": bright, "dark": dark / bright}


def _numbers_of(white):
    """Return the XYZ of a white as three floats after checking it."""
    white = _white(white)
    if isinstance(white, torch.Tensor):
        white = _validate.numbers(_validate.constants(white=white)[0])
    return tuple(map(float, white))


def _checked_viewing(white, luminance, background, model, surround="average"):
    return _viewing(
        _numbers_of(white),
        _validate.constant("adapting_luminance", luminance, positive=True),
        _validate.constant("background", background, positive=True),
        model,
        surround,
    )


@decoded_in_float32
def xyz_to_cam16_ucs(
    image: torch.Tensor,
    white: Sequence[float] = IEC_WHITE,
    adapting_luminance: float = 64 / math.pi * 0.2,
    background: float = 20.0,
) -> torch.Tensor:
    """Return the uniform colour space CAM16-UCS of CIE XYZ, in an average surround.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``, Y being 1 for white.
    white : sequence of float
        XYZ of the white; D65 with Y = 1 by default.
    adapting_luminance : float
        Luminance in cd/m² that the eye is adapted to, usually a fifth of the luminance of the white; by default for a
        white paper in 64 lx.
    background : float
        Luminance of the background in per cent of the white with Y = 1.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three: J′ (0 … 100), a′ and b′. Distances are colour differences. Below the
        grey of 1/255 in sRGB gradients are those there, finite and not 0 at black; greys have a gradient of 0 in a′
        and b′.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or a number is not positive.

    Notes
    -----
    Li et al., Color Res. Appl. 42, 703 (2017), with the coordinates of Luo, Cui and Li, Color Res. Appl. 31, 320
    (2006): c₁ = 0.007, c₂ = 0.0228.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import xyz_to_cam16_ucs
    >>> result = xyz_to_cam16_ucs(torch.tensor([0.2065, 0.1220, 0.0514]).reshape(1, 3, 1, 1))
    >>> [round(value) for value in result.flatten().tolist()]
    [46, 31, 11]
    """
    return uniform_colours(image, white, adapting_luminance, background)


def uniform_colours(
    image: torch.Tensor,
    white: Sequence[float] = IEC_WHITE,
    adapting_luminance: float = 64 / math.pi * 0.2,
    background: float = 20.0,
    model: str = "CAM16",
) -> torch.Tensor:
    """Return the uniform colour space of a model of appearance, see :func:`xyz_to_cam16_ucs`.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``.
    white, adapting_luminance, background
        As of :func:`xyz_to_cam16_ucs`.
    model : {"CAM16", "CAM02"}
        Model. CAM02 (CIE 159:2004) differs by the cones that adapt and by those that are compressed.

    Returns
    -------
    torch.Tensor
        J′, a′ and b′ ``[..., 3, H, W]``.
    """
    view = _checked_viewing(white, adapting_luminance, background, model)
    lightness, chroma, hue = _lightness_chroma_hue(tristimulus(image, white)[0], view)
    colourfulness = torch.log1p(0.0228 * chroma * view[1]["level"] ** 0.25) / 0.0228
    return torch.stack(
        [1.7 * lightness / (1 + 0.007 * lightness), colourfulness * torch.cos(hue), colourfulness * torch.sin(hue)], -3
    )


def _lightness_chroma_hue(xyz, viewing):
    """Return lightness, chroma and the angle of the hue in radians of XYZ, by what :func:`_viewing` returns."""
    matrix, view = viewing
    responses = mix(rows(matrix), xyz)
    power = signed_power(view["level"] * responses, _COMPRESSION, view["level"] * DARKEST)
    compressed = 400 * power / (power.abs() + _HALF)
    achromatic, a, b = mix(rows(_TO_OPPONENT), compressed).unbind(-3)
    total = mix(rows(_SATURATION[None]), compressed)[..., 0, :, :] + 0.305
    relative = above_zero(achromatic / view["white"])
    lightness = 100 * signed_power(relative, view["exponent"], view["dark"])
    hue = _hue(a, b)
    eccentricity = (torch.cos(hue + 2) + 3.8) / 4
    t = view["chromatic"] * eccentricity * root(a**2 + b**2) / total
    chroma = signed_power(t, 0.9, 1e-6) * signed_power(relative, view["exponent"] / 2, view["dark"]) * view["chroma"]
    return lightness, chroma, hue


@decoded_in_float32
def color_appearance(
    image: torch.Tensor,
    white: Sequence[float] = IEC_WHITE,
    adapting_luminance: float = 64 / math.pi * 0.2,
    background: float = 20.0,
    surround: str = "average",
    model: str = "CAM16",
) -> Appearance:
    """Return the correlates of a model of colour appearance: lightness, chroma, hue, brightness and others.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``, Y being 1 for white.
    white : sequence of float
        XYZ of the white; D65 with Y = 1 by default.
    adapting_luminance : float
        Luminance in cd/m² that the eye is adapted to, usually a fifth of the luminance of the white.
    background : float
        Luminance of the background in per cent of the white with Y = 1.
    surround : {"average", "dim", "dark"}
        Light of the room: as bright as the picture, dimmer, or none as in a headset.
    model : {"CAM16", "CAM02"}
        CAM16, or CIECAM02 (CIE 159:2004).

    Returns
    -------
    Appearance
        The correlates. They are differentiable; at greys the gradients of chroma are 0.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, a number is not positive, or a name is not known.

    Notes
    -----
    Moroney et al., Proc. IS&T/SID 10th Color Imaging Conference, 23 (2002); Li et al., Color Res. Appl. 42, 703 (2017).
    Hue quadrature is that of the table of unique hues in both, also between blue and red.

    Examples
    --------
    In a dark room the same light looks lighter and less colourful:

    >>> import torch
    >>> from odak.learn.perception import color_appearance
    >>> red = torch.tensor([0.2065, 0.1220, 0.0514]).reshape(3, 1, 1)
    >>> for surround in ("average", "dark"):
    ...     found = color_appearance(red, surround=surround)
    ...     print(round(found.lightness.item()), round(found.colorfulness.item()), round(found.hue.item()))
    33 49 19
    43 45 19
    """
    surround = _validate.one_of("surround", surround, _SURROUNDS)
    model = _validate.one_of("model", model, _MODELS)
    viewing = _checked_viewing(white, adapting_luminance, background, model, surround)
    view = viewing[1]
    lightness, chroma, angle = _lightness_chroma_hue(tristimulus(image, white)[0], viewing)
    hue = torch.rad2deg(angle) % 360
    # The achromatic response to the white, with the induction of the background and the offset of the model.
    white_response = view["induction"] * view["white"] + 4
    brightness = 4 / view["impact"] * root(lightness / 100) * white_response * view["level"] ** 0.25
    colorfulness = chroma * view["level"] ** 0.25
    saturation = 100 * root(colorfulness / brightness.clamp_min(1e-12))
    return Appearance(lightness, chroma, hue, brightness, colorfulness, saturation, _quadrature(hue))


def _quadrature(hue):
    """Return the hue as parts of the unique hues on its two sides, 0 … 400."""
    angles, factors = (hue.new_tensor(values) for values in _UNIQUE_HUES)
    turned = torch.where(hue < angles[0], hue + 360, hue)
    below = (torch.bucketize(turned.detach(), angles, right=True) - 1).clamp(0, 3)
    before = (turned - angles[below]) / factors[below]
    after = (angles[below + 1] - turned) / factors[below + 1]
    return 100 * (below + before / (before + after))


@decoded_in_float32
def cam16_ucs_to_xyz(
    image: torch.Tensor,
    white: Sequence[float] = IEC_WHITE,
    adapting_luminance: float = 64 / math.pi * 0.2,
    background: float = 20.0,
) -> torch.Tensor:
    """Return CIE XYZ of CAM16-UCS: the inverse of :func:`xyz_to_cam16_ucs`.

    Parameters
    ----------
    image : torch.Tensor
        J′, a′ and b′ ``[..., 3, H, W]``, J′ from 0 to 100.
    white : sequence of float
        XYZ of the white; D65 with Y = 1 by default.
    adapting_luminance : float
        Luminance in cd/m² that the eye is adapted to.
    background : float
        Luminance of the background in per cent of the white with Y = 1.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three; 0 where J′ is 0.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or a number is not positive.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import cam16_ucs_to_xyz
    >>> result = cam16_ucs_to_xyz(torch.tensor([46.0659, 31.0216, 10.9585]).reshape(1, 3, 1, 1))
    >>> [round(value, 3) for value in result.flatten().tolist()]
    [0.207, 0.122, 0.051]
    """
    return of_uniform_colours(image, white, adapting_luminance, background)


def of_uniform_colours(
    image: torch.Tensor,
    white: Sequence[float] = IEC_WHITE,
    adapting_luminance: float = 64 / math.pi * 0.2,
    background: float = 20.0,
    model: str = "CAM16",
) -> torch.Tensor:
    """Return CIE XYZ of the uniform colour space of a model: the inverse of :func:`uniform_colours`.

    Parameters
    ----------
    image : torch.Tensor
        J′, a′ and b′ ``[..., 3, H, W]``.
    white, adapting_luminance, background, model
        As of :func:`uniform_colours`.

    Returns
    -------
    torch.Tensor
        XYZ ``[..., 3, H, W]``.
    """
    matrix, view = _checked_viewing(white, adapting_luminance, background, model)
    level, a, b = as_pictures("image", image).unbind(-3)
    share = above_zero(level / (170 - 0.7 * level))
    none = share == 0
    hue = _hue(a, b)
    chroma = torch.expm1(0.0228 * root(a**2 + b**2)) / 0.0228 / view["level"] ** 0.25
    chroma = torch.where(none, 0.0, chroma / torch.where(none, 1.0, share).sqrt())
    t = signed_power(chroma / view["chroma"], 1 / 0.9, 1e-12)
    achromatic = view["white"] * signed_power(share, 1 / view["exponent"], view["dark"] ** view["exponent"])
    cosine, sine = torch.cos(hue), torch.sin(hue)
    scale = view["chromatic"] * (torch.cos(hue + 2) + 3.8) / 4
    # t·(R + G + 21 B/20 + 0.305) = scale·r, with R, G, B linear in the achromatic response and in r·cos h, r·sin h.
    from_achromatic, from_a, from_b = map(float, _SATURATION @ _FROM_OPPONENT)
    radius = t * (from_achromatic * achromatic + 0.305) / (scale - t * (from_a * cosine + from_b * sine))
    compressed = mix(rows(_FROM_OPPONENT), torch.stack([achromatic, radius * cosine, radius * sine], -3))
    power = _HALF * compressed / (400 - compressed.abs())
    responses = signed_power(power, 1 / _COMPRESSION, (view["level"] * DARKEST) ** _COMPRESSION) / view["level"]
    return mix(rows(np.linalg.inv(matrix)), responses)


@functools.lru_cache(maxsize=32)
def _opponents(white):
    long, middle, short = _LMS_2006 @ np.array(white)
    mechanisms = np.array([(1, 1, 0), (1, -long / middle, 0), (-1, -1, (long + middle) / short)])
    return mechanisms @ _LMS_2006


def _dkl_matrix(white):
    return _opponents(_numbers_of(white))


@decoded_in_float32
def xyz_to_dkl(image: torch.Tensor, white: Sequence[float] = IEC_WHITE) -> torch.Tensor:
    """Return the opponent colours of Derrington, Krauskopf and Lennie of CIE XYZ.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``, relative or in cd/m².
    white : sequence of float
        XYZ of the white at which both chromatic mechanisms are silent, as are its greys; D65 by default.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three, in the unit of Y: the luminance L + M, red–green L − (L_w/M_w)·M, and
        violet–yellow ((L_w + M_w)/S_w)·S − (L + M). Over the luminance of the background they are contrasts.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the white is not three positive numbers.

    Notes
    -----
    Derrington, Krauskopf and Lennie, J. Physiol. 357, 241 (1984), with the cones of CIE 170-1:2006, which follow from
    XYZ by the matrix of ColorVideoVDP: Mantiuk, Hanji, Ashraf, Asano and Chapiro, ACM Trans. Graph. 43, 129 (2024).

    Examples
    --------
    The white is achromatic:

    >>> import torch
    >>> from odak.learn.perception import xyz_to_dkl
    >>> from odak.learn.perception.color import IEC_WHITE
    >>> result = xyz_to_dkl(torch.tensor(IEC_WHITE).reshape(1, 3, 1, 1))
    >>> [abs(round(value, 3)) for value in result.flatten().tolist()]
    [1.051, 0.0, 0.0]
    """
    return mix(rows(_dkl_matrix(white)), as_pictures("image", image))


@decoded_in_float32
def dkl_to_xyz(image: torch.Tensor, white: Sequence[float] = IEC_WHITE) -> torch.Tensor:
    """Return CIE XYZ of opponent colours: the inverse of :func:`xyz_to_dkl`.

    Parameters
    ----------
    image : torch.Tensor
        Luminance, red–green and violet–yellow ``[..., 3, H, W]``.
    white : sequence of float
        XYZ of the white at which both chromatic mechanisms are silent; D65 by default.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the white is not three positive numbers.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import dkl_to_xyz
    >>> result = dkl_to_xyz(torch.tensor([1.0508, 0.0, 0.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 2) for value in result.flatten().tolist()]
    [0.95, 1.0, 1.09]
    """
    return mix(rows(np.linalg.inv(_dkl_matrix(white))), as_pictures("image", image))


@functools.cache
def _planckian_locus():
    """Return mireds, and u, v of CIE 1960 of black bodies with their derivatives by the mired, float64 ``[5, N]``."""
    nanometres = np.arange(360.0, 831.0)
    matching = color_matching_functions(nanometres).cpu().numpy()
    mired = np.arange(_HOTTEST, _COLDEST + _STEP, _STEP)
    per_mired = _SECOND_CONSTANT / (nanometres * 1e-9) / 1e6
    cycles = mired[:, None] * per_mired
    power = nanometres**-5.0 / np.expm1(cycles)
    slope = -power * per_mired / -np.expm1(-cycles)
    # Both are scaled alike, so that the powers of cold bodies stay within the range of numbers.
    scale = power.max(1, keepdims=True)
    (x, y, z), (dx, dy, dz) = ((part / scale @ matching.T).T for part in (power, slope))
    total, change = x + 15 * y + 3 * z, dx + 15 * dy + 3 * dz
    u, v = 4 * x / total, 6 * y / total
    return torch.from_numpy(np.stack([mired, u, v, (4 * dx - u * change) / total, (6 * dy - v * change) / total]))


def correlated_color_temperature(image: torch.Tensor) -> torch.Tensor:
    """Return the correlated colour temperature of CIE XYZ and the distance from the Planckian locus.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``.

    Returns
    -------
    torch.Tensor
        ``[..., 2, H, W]``, four axes for three: the temperature in kelvins of the nearest black body in the
        chromaticities u, v of CIE 1960, and the distance D_uv there, positive above the locus. Not a number for black
        and where the temperature is not between 1000 K and 100 000 K. Differentiable; float32 of half precision.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Notes
    -----
    CIE 015:2018, section 9.5, by the definition: the foot of the perpendicular on the locus, which is tabulated with
    its derivatives at each mired, c₂ = 1.4388e-2 m·K (ITS-90). Beyond |D_uv| = 0.05 a temperature has no meaning.

    Examples
    --------
    The standard illuminant D65:

    >>> import torch
    >>> from odak.learn.perception import correlated_color_temperature
    >>> found = correlated_color_temperature(torch.tensor([0.95046, 1.0, 1.08906]).reshape(1, 3, 1, 1))
    >>> round(found[0, 0].item(), -1), round(found[0, 1].item(), 4)
    (6500.0, 0.0032)
    """
    picture = as_pictures("image", image)
    x, y, z = in_float64(picture).unbind(-3)
    locus = _planckian_locus().to(picture.device)
    total = x + 15 * y + 3 * z
    known = total != 0
    u, v = (value / torch.where(known, total, 1.0) for value in (4 * x, 6 * y))
    with torch.no_grad():
        # The isotherms of the table, the lines across the locus, divide chromaticities into cells.
        low, high = torch.zeros_like(u, dtype=torch.long), torch.full_like(u, locus.shape[1] - 1, dtype=torch.long)
        for _ in range(math.ceil(math.log2(locus.shape[1]))):
            middle = (low + high) // 2
            before = _along(u, v, *locus[1:, middle]) > 0
            low, high = torch.where(before, middle, low), torch.where(before, high, middle)
        inside = (_along(u, v, *locus[1:, torch.zeros_like(low)]) >= 0) & (
            _along(u, v, *locus[1:, torch.full_like(low, locus.shape[1] - 1)]) <= 0
        )
        share = torch.full_like(u, 0.5)
        for _ in range(2):
            share = share - _newton(u, v, locus, low, share)
    share = share - _newton(u, v, locus, low, share)
    place_u, place_v, slope_u, slope_v, *_ = _hermite(locus, low, share)
    mired = locus[0, low] + _STEP * share
    # Towards cold bodies the locus runs to larger u; v above it is on the left.
    distance = ((v - place_v) * slope_u - (u - place_u) * slope_v) / torch.hypot(slope_u, slope_v)
    found = torch.stack([1e6 / mired, distance], -3)
    return torch.where((known & inside).unsqueeze(-3), found, torch.nan).to(in_float32(picture).dtype)


def _along(u, v, place_u, place_v, slope_u, slope_v):
    """Return how far chromaticities lie beyond an isotherm, towards cold bodies."""
    return (u - place_u) * slope_u + (v - place_v) * slope_v


def _hermite(locus, low, share):
    """Return u, v of places on the locus, and their first and second derivatives by the share of a cell."""
    (start, end), t = (locus[1:, low], locus[1:, low + 1]), share
    found = []
    for k in (0, 1):
        first, last = start[k], end[k]
        first_slope, last_slope = _STEP * start[k + 2], _STEP * end[k + 2]
        square = 3 * (last - first) - 2 * first_slope - last_slope
        cube = first_slope + last_slope - 2 * (last - first)
        found.append(
            (
                first + t * (first_slope + t * (square + t * cube)),
                first_slope + t * (2 * square + 3 * t * cube),
                2 * square + 6 * t * cube,
            )
        )
    return [column for pair in zip(*found, strict=True) for column in pair]


def _newton(u, v, locus, low, share):
    """Return the step of Newton's method towards the foot of the perpendicular."""
    place_u, place_v, slope_u, slope_v, bend_u, bend_v = _hermite(locus, low, share)
    slope = _along(u, v, place_u, place_v, bend_u, bend_v) - slope_u**2 - slope_v**2
    return _along(u, v, place_u, place_v, slope_u, slope_v) / slope
