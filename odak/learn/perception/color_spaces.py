"""Conversion between any two colour spaces, and colour differences, each by one table of names."""

import functools
import math
from collections.abc import Callable, Sequence

import numpy as np
import torch

from odak import _validate
from odak.learn.perception import appearance, color
from odak.learn.perception.color import IEC_WHITE, decoded_in_float32, mix, root, rows
from odak.learn.perception.hdr import pq_decode, pq_encode

# Jzazbz: mixtures of X, Y, Z before the cones, the cones, opponents of their signals, and lightness.
_MIXED = np.array([(1.15, 0, -0.15), (0.34, 0.66, 0), (0, 0, 1)])
_CONES = np.array(
    [(0.41478972, 0.579999, 0.0146480), (-0.2015100, 1.120649, 0.0531008), (-0.0166008, 0.264800, 0.6684799)]
)
_OPPONENTS = np.array([(0.5, 0.5, 0), (3.524000, -4.066708, 0.542708), (0.199076, 1.096799, -1.295875)])
_STEEPER, _BEND, _BLACK = 1.7, -0.56, 1.6295499532821566e-11


def _jzazbz(image, white, luminance):
    signals = pq_encode(luminance * mix(rows(_CONES @ _MIXED), image)) ** _STEEPER
    intensity, a, b = mix(rows(_OPPONENTS), signals).unbind(-3)
    return torch.stack([(1 + _BEND) * intensity / (1 + _BEND * intensity) - _BLACK, a, b], -3)


def _of_jzazbz(image, white, luminance):
    lightness, a, b = image.unbind(-3)
    lightness = lightness + _BLACK
    intensity = lightness / (1 + _BEND - _BEND * lightness)
    signals = mix(rows(np.linalg.inv(_OPPONENTS)), torch.stack([intensity, a, b], -3))
    return (
        mix(rows(np.linalg.inv(_CONES @ _MIXED)), pq_decode(color.signed_power(signals, 1 / _STEEPER, _BLACK)))
        / luminance
    )


def _linear(image, white):
    return color.xyz_to_linear_rgb(image, white=white)


def _of_linear(image, white):
    return color.linear_rgb_to_xyz(image, white=white)


def _plain(function: Callable) -> Callable:
    """Return a conversion that depends on neither the white nor its luminance in the form that the table holds."""
    return lambda image, white, luminance: function(image)


def _relative(function: Callable) -> Callable:
    """Return a conversion that depends on the white alone in the form that the table holds."""
    return lambda image, white, luminance: function(image, white)


_CAM02 = functools.partial(appearance.uniform_colours, model="CAM02")
_OF_CAM02 = functools.partial(appearance.of_uniform_colours, model="CAM02")
# Of each space the conversions from XYZ and to it, as functions of the picture, the white and its luminance.
SPACES: dict[str, tuple[Callable, Callable]] = {
    "XYZ": (_plain(lambda image: image), _plain(lambda image: image)),
    "xyY": (_relative(color.xyz_to_xyy), _plain(color.xyy_to_xyz)),
    "RGB": (_relative(_linear), _relative(_of_linear)),
    "sRGB": (
        _relative(lambda image, white: color.linear_rgb_to_rgb(_linear(image, white))),
        _relative(lambda image, white: _of_linear(color.rgb_to_linear_rgb(image), white)),
    ),
    "Lab": (_relative(color.xyz_to_lab), _relative(color.lab_to_xyz)),
    "Luv": (_relative(color.xyz_to_luv), _relative(color.luv_to_xyz)),
    "LMS": (_plain(color.xyz_to_lms), _plain(color.lms_to_xyz)),
    "DKL": (_relative(appearance.xyz_to_dkl), _relative(appearance.dkl_to_xyz)),
    "Oklab": (_plain(color.xyz_to_oklab), _plain(color.oklab_to_xyz)),
    "OkLCh": (
        _plain(lambda image: color.oklab_to_oklch(color.xyz_to_oklab(image))),
        _plain(lambda image: color.oklab_to_xyz(color.oklch_to_oklab(image))),
    ),
    "Jzazbz": (_jzazbz, _of_jzazbz),
    "CAM02-UCS": (_relative(_CAM02), _relative(_OF_CAM02)),
    "CAM16-UCS": (_relative(appearance.xyz_to_cam16_ucs), _relative(appearance.cam16_ucs_to_xyz)),
}


@decoded_in_float32
def convert_color(
    image: torch.Tensor,
    source: str,
    target: str,
    *,
    white: Sequence[float] = IEC_WHITE,
    luminance: float = 100.0,
) -> torch.Tensor:
    """Return a picture of one colour space in another; differentiable.

    Parameters
    ----------
    image : torch.Tensor
        Colours of the space `source`, ``[..., 3, H, W]``.
    source : str
        "XYZ" (Y = 1 for white), "xyY", "RGB" (linear, primaries of sRGB), "sRGB", "Lab" (CIE 1976), "Luv", "LMS",
        "DKL", "Oklab", "OkLCh", "Jzazbz", "CAM02-UCS" or "CAM16-UCS".
    target : str
        The space of the result, one of the same names.
    white : sequence of float
        XYZ of the white; D65 with Y = 1 by default. "LMS", "Oklab" and "Jzazbz" do not depend on it.
    luminance : float
        Luminance of Y = 1 in cd/m², on which "Jzazbz" depends.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three.

    Raises
    ------
    ValueError, TypeError
        If a space is unknown, the image does not hold three channels of real floats or a number is not positive.

    Notes
    -----
    Jzazbz: Safdar, Cui, Kim and Luo, Opt. Express 25, 15131 (2017). CAM02-UCS: CIE 159:2004, an average surround, with
    the coordinates of Luo, Cui and Li, Color Res. Appl. 31, 320 (2006), for a white paper in 64 lx; other conditions of
    viewing are those of :func:`odak.learn.perception.xyz_to_cam16_ucs`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import convert_color
    >>> red = torch.tensor([1.0, 0.0, 0.0]).reshape(3, 1, 1)
    >>> [round(value) for value in convert_color(red, "sRGB", "Lab").flatten().tolist()]
    [53, 80, 67]
    """
    _, to_xyz = SPACES[_validate.one_of("source", source, SPACES)]
    from_xyz, _ = SPACES[_validate.one_of("target", target, SPACES)]
    luminance = _validate.constant("luminance", luminance, positive=True)
    pictures = color.as_pictures("image", image)
    return from_xyz(to_xyz(pictures, white, luminance), white, luminance)


def _cie_1994(first, second, lightness, by_chroma, by_hue):
    (l1, a1, b1), (l2, a2, b2) = first.unbind(-3), second.unbind(-3)
    c1, c2 = color._norm(a1, b1), color._norm(a2, b2)
    hue = (a1 - a2) ** 2 + (b1 - b2) ** 2 - (c1 - c2) ** 2
    steps = ((l1 - l2) / lightness) ** 2 + ((c1 - c2) / (1 + by_chroma * c1)) ** 2 + hue / (1 + by_hue * c1) ** 2
    return root(steps.clamp_min(0)).unsqueeze(-3)


def _cmc(first, second, lightness):
    (l1, a1, b1), (l2, a2, b2) = first.unbind(-3), second.unbind(-3)
    c1, c2 = color._norm(a1, b1), color._norm(a2, b2)
    degrees = color._hue(a1, b1) * (180 / math.pi)
    turned = torch.where((degrees >= 164) & (degrees <= 345), 168.0, 35.0).to(degrees)
    wave = torch.cos((degrees + turned) * (math.pi / 180))
    weight = torch.where(turned == 168, 0.56 + (0.2 * wave).abs(), 0.36 + (0.4 * wave).abs())
    share = c1**2 / root(c1**4 + 1900)
    of_lightness = torch.where(l1 < 16, 0.511, 0.040975 * l1 / (1 + 0.01765 * l1.clamp_min(0)))
    of_chroma = 0.0638 * c1 / (1 + 0.0131 * c1) + 0.638
    of_hue = of_chroma * (share * weight + 1 - share)
    hue = (a1 - a2) ** 2 + (b1 - b2) ** 2 - (c1 - c2) ** 2
    steps = ((l1 - l2) / (lightness * of_lightness)) ** 2 + ((c1 - c2) / of_chroma) ** 2 + hue / of_hue**2
    return root(steps.clamp_min(0)).unsqueeze(-3)


FORMULAS: dict[str, Callable] = {
    "CIE 1976": color.delta_e,
    "CIE 1994": functools.partial(_cie_1994, lightness=1.0, by_chroma=0.045, by_hue=0.015),
    "CIE 1994 textiles": functools.partial(_cie_1994, lightness=2.0, by_chroma=0.048, by_hue=0.014),
    "CMC 2:1": functools.partial(_cmc, lightness=2.0),
    "CMC 1:1": functools.partial(_cmc, lightness=1.0),
    "CIEDE2000": color.ciede2000,
}


def color_difference(first: torch.Tensor, second: torch.Tensor, formula: str = "CIEDE2000") -> torch.Tensor:
    """Return the difference of colours in L*a*b* by a formula of the CIE or of the CMC.

    Parameters
    ----------
    first : torch.Tensor
        L*a*b* of the standard ``[..., 3, H, W]``. The formulas of 1994 and of the CMC are not symmetric.
    second : torch.Tensor
        L*a*b* of the sample; its leading axes broadcast against `first`.
    formula : str
        "CIE 1976", "CIE 1994" (graphic arts), "CIE 1994 textiles", "CMC 2:1" (acceptability), "CMC 1:1"
        (perceptibility) or "CIEDE2000".

    Returns
    -------
    torch.Tensor
        ``[..., 1, H, W]``, four axes for three. Gradients are finite, 0 between equal colours.

    Raises
    ------
    ValueError, TypeError
        If the formula is unknown, a picture does not hold three channels of real floats, or the shapes do not fit.

    Notes
    -----
    CIE 116:1995; Clarke, McDonald and Rigg, J. Soc. Dyers Colour. 100, 128 (1984).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import color_difference
    >>> first, second = torch.tensor([[50.0, 20.0, -30.0], [55.0, 25.0, -20.0]]).reshape(2, 1, 3, 1, 1)
    >>> round(color_difference(first, second, "CIE 1994").item(), 4)
    8.5527
    """
    formula = _validate.one_of("formula", formula, FORMULAS)
    return FORMULAS[formula](*color._lab_pair(first, second))
