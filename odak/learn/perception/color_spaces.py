"""Colour spaces derived from CIE XYZ, chromatic adaptation, and the mapping of colours into a gamut or a dynamic range.

Pictures are ``[..., 3, H, W]``; three axes come back as four. Everything is differentiable, with finite gradients.
"""

import functools
from collections.abc import Sequence

import numpy as np
import torch

from odak import _validate
from odak.learn.perception.color_matrices import (
    BT709_PRIMARIES,
    IEC_WHITE,
    _rgb_to_xyz_rows,
    as_pictures,
    constant,
    mix,
    rows,
)
from odak.learn.perception.hdr import pq_decode, pq_encode

CONES = {
    "Bradford": ((0.8951, 0.2664, -0.1614), (-0.7502, 1.7135, 0.0367), (0.0389, -0.0685, 1.0296)),
    "CAT16": ((0.401288, 0.650173, -0.051461), (-0.250268, 1.204414, 0.045854), (-0.002079, 0.048952, 0.953127)),
    "Hunt-Pointer-Estevez": ((0.38971, 0.68898, -0.07868), (-0.22981, 1.1834, 0.04641), (0.0, 0.0, 1.0)),
}
_JOINT = 6 / 29
_FACTOR, _OFFSET = 1 / (3 * _JOINT**2), 4 / 29
_OKLAB_CONES = np.array(
    [
        (0.8189330101, 0.3618667424, -0.1288597137),
        (0.0329845436, 0.9293118715, 0.0361456387),
        (0.0482003018, 0.2643662691, 0.6338517070),
    ]
)
_OKLAB = np.array(
    [
        (0.2104542553, 0.7936177850, -0.0040720468),
        (1.9779984951, -2.4285922050, 0.4505937099),
        (0.0259040371, 0.7827717662, -0.8086757660),
    ]
)
_ICTCP_CONES = np.array([(1688, 2146, 262), (683, 2951, 462), (99, 309, 3688)]) / 4096
_ICTCP = np.array([(2048, 2048, 0), (6610, -13613, 7003), (17933, -17390, -543)]) / 4096
_SRGB = _rgb_to_xyz_rows(BT709_PRIMARIES, IEC_WHITE)
# Roots of darker values have the gradient of this one.
_DARKEST = 1e-12
_BISECTIONS = 40


def xyz_to_lab(image: torch.Tensor, white: Sequence[float] = IEC_WHITE) -> torch.Tensor:
    """Return CIE 1976 L*a*b* of CIE XYZ.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``.
    white : sequence of float
        XYZ of the white; D65 with Y = 1 by default.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``: L* is 100 for the white.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the white is not three positive numbers.

    Notes
    -----
    CIE 015:2018, section 8.2.1.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import xyz_to_lab
    >>> grey = torch.tensor([0.9505, 1.0, 1.089]).reshape(3, 1, 1) * 0.18
    >>> round(xyz_to_lab(grey)[0, 0].item(), 2)
    49.5
    """
    image = as_pictures("image", image)
    x, y, z = _cube_root(image / _column(_white(white), image)).unbind(-3)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -3)


def lab_to_xyz(image: torch.Tensor, white: Sequence[float] = IEC_WHITE) -> torch.Tensor:
    """Return CIE XYZ of CIE 1976 L*a*b*: the inverse of :func:`xyz_to_lab`.

    Parameters
    ----------
    image : torch.Tensor
        L*a*b* ``[..., 3, H, W]``.
    white : sequence of float
        XYZ of the white; D65 with Y = 1 by default.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the white is not three positive numbers.

    Examples
    --------
    The lightness 100 without chroma is the white:

    >>> import torch
    >>> from odak.learn.perception import lab_to_xyz
    >>> result = lab_to_xyz(torch.tensor([100.0, 0.0, 0.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.9505, 1.0, 1.0891]
    """
    level, red, blue = as_pictures("image", image).unbind(-3)
    y = (level + 16) / 116
    roots = torch.stack([y + red / 500, y, y - blue / 200], -3)
    relative = torch.where(roots > _JOINT, roots**3, (roots - _OFFSET) / _FACTOR)
    return relative * _column(_white(white), relative)


def xyz_to_luv(image: torch.Tensor, white: Sequence[float] = IEC_WHITE) -> torch.Tensor:
    """Return CIE 1976 L*u*v* of CIE XYZ.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``.
    white : sequence of float
        XYZ of the white; D65 with Y = 1 by default.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``; black is (0, 0, 0).

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the white is not three positive numbers.

    Notes
    -----
    CIE 015:2018, section 8.2.2.

    Examples
    --------
    A grey of the luminance 0.2:

    >>> import torch
    >>> from odak.learn.perception import xyz_to_luv
    >>> result = xyz_to_luv(torch.tensor([0.1901, 0.2, 0.21781]).reshape(1, 3, 1, 1))
    >>> [abs(round(value, 1)) for value in result.flatten().tolist()]
    [51.8, 0.0, 0.0]
    """
    white = _white(white)
    x, y, z = as_pictures("image", image).unbind(-3)
    level = 116 * _cube_root(y / white[1]) - 16
    sum_white = white[0] + 15 * white[1] + 3 * white[2]
    total = x + 15 * y + 3 * z
    none = total == 0
    total = torch.where(none, 1.0, total)
    u, v = 4 * x / total - 4 * white[0] / sum_white, 9 * y / total - 9 * white[1] / sum_white
    return torch.stack([level, *(torch.where(none, 0.0, 13 * level * part) for part in (u, v))], -3)


def luv_to_xyz(image: torch.Tensor, white: Sequence[float] = IEC_WHITE) -> torch.Tensor:
    """Return CIE XYZ of CIE 1976 L*u*v*: the inverse of :func:`xyz_to_luv`.

    Parameters
    ----------
    image : torch.Tensor
        L*u*v* ``[..., 3, H, W]``.
    white : sequence of float
        XYZ of the white; D65 with Y = 1 by default.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``; 0 where L* is 0.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the white is not three positive numbers.

    Examples
    --------
    The lightness 100 without chroma is the white:

    >>> import torch
    >>> from odak.learn.perception import luv_to_xyz
    >>> result = luv_to_xyz(torch.tensor([100.0, 0.0, 0.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.9505, 1.0, 1.0891]
    """
    white = _white(white)
    level, u, v = as_pictures("image", image).unbind(-3)
    roots = (level + 16) / 116
    y = torch.where(roots > _JOINT, roots**3, (roots - _OFFSET) / _FACTOR) * white[1]
    none, sum_white = level == 0, white[0] + 15 * white[1] + 3 * white[2]
    scale = 13 * torch.where(none, 1.0, level)
    u, v = u / scale + 4 * white[0] / sum_white, v / scale + 9 * white[1] / sum_white
    x, z = y * 9 * u / (4 * v), y * (12 - 3 * u - 20 * v) / (4 * v)
    return torch.stack([torch.where(none, 0.0, value) for value in (x, y, z)], -3)


def xyz_to_lms(image: torch.Tensor, cones: str = "Hunt-Pointer-Estevez") -> torch.Tensor:
    """Return responses of cones to CIE XYZ.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``.
    cones : {"Hunt-Pointer-Estevez", "Bradford", "CAT16"}
        Matrix of the responses; the latter two are sharpened, for chromatic adaptation.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the cones are not known.

    Examples
    --------
    A spectrum of equal energy, X = Y = Z, excites all cones alike:

    >>> import torch
    >>> from odak.learn.perception import xyz_to_lms
    >>> result = xyz_to_lms(torch.tensor([1.0, 1.0, 1.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 2) for value in result.flatten().tolist()]
    [1.0, 1.0, 1.0]
    """
    return mix(CONES[_validate.one_of("cones", cones, CONES)], as_pictures("image", image))


def lms_to_xyz(image: torch.Tensor, cones: str = "Hunt-Pointer-Estevez") -> torch.Tensor:
    """Return CIE XYZ of responses of cones: the inverse of :func:`xyz_to_lms`.

    Parameters
    ----------
    image : torch.Tensor
        Responses ``[..., 3, H, W]``.
    cones : {"Hunt-Pointer-Estevez", "Bradford", "CAT16"}
        Matrix of the responses.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the cones are not known.

    Examples
    --------
    Equal responses of all cones are a spectrum of equal energy, X = Y = Z:

    >>> import torch
    >>> from odak.learn.perception import lms_to_xyz
    >>> result = lms_to_xyz(torch.tensor([1.0, 1.0, 1.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 2) for value in result.flatten().tolist()]
    [1.0, 1.0, 1.0]
    """
    return mix(_inverse(CONES[_validate.one_of("cones", cones, CONES)]), as_pictures("image", image))


def adapt_chromatically(
    image: torch.Tensor, source_white: Sequence[float], target_white: Sequence[float], cones: str = "Bradford"
) -> torch.Tensor:
    """Return the colours that look under one white as the given ones do under another (von Kries).

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``.
    source_white : sequence of float
        XYZ of the white of the picture.
    target_white : sequence of float
        XYZ of the white of the result.
    cones : {"Bradford", "CAT16", "Hunt-Pointer-Estevez"}
        Responses that are scaled. Adaptation is complete.

    Returns
    -------
    torch.Tensor
        XYZ ``[..., 3, H, W]``; the source's white becomes the target's.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, a white is not three positive numbers, or the cones
        are not known.

    Notes
    -----
    Bradford: ICC.1:2022, annex E. CAT16: Li et al., Color Res. Appl. 42, 703 (2017).

    Examples
    --------
    The white of the source becomes that of the target:

    >>> import torch
    >>> from odak.learn.perception import adapt_chromatically
    >>> d65, d50 = (0.9505, 1.0, 1.089), (0.9642, 1.0, 0.8251)
    >>> white = torch.tensor(d65).reshape(1, 3, 1, 1)
    >>> [round(value, 4) for value in adapt_chromatically(white, d65, d50).flatten().tolist()]
    [0.9642, 1.0, 0.8251]
    """
    matrix = np.array(CONES[_validate.one_of("cones", cones, CONES)])
    source, target = _white(source_white, "source_white"), _white(target_white, "target_white")
    gains = (matrix @ target) / (matrix @ source)
    return mix(rows(np.linalg.solve(matrix, gains[:, None] * matrix)), as_pictures("image", image))


def xyz_to_oklab(image: torch.Tensor) -> torch.Tensor:
    """Return Oklab of CIE XYZ with the white D65.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``, Y being 1 for white.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``: lightness 0 … 1, green–red and blue–yellow.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Notes
    -----
    Ottosson, *A perceptual color space for image processing* (2020).

    Examples
    --------
    The white D65 has the lightness 1 and no chroma:

    >>> import torch
    >>> from odak.learn.perception import xyz_to_oklab
    >>> result = xyz_to_oklab(torch.tensor([0.9505, 1.0, 1.089]).reshape(1, 3, 1, 1))
    >>> [abs(round(value, 2)) for value in result.flatten().tolist()]
    [1.0, 0.0, 0.0]
    """
    return mix(rows(_OKLAB), _signed_cube_root(mix(rows(_OKLAB_CONES), as_pictures("image", image))))


def oklab_to_xyz(image: torch.Tensor) -> torch.Tensor:
    """Return CIE XYZ with the white D65 of Oklab: the inverse of :func:`xyz_to_oklab`.

    Parameters
    ----------
    image : torch.Tensor
        Oklab ``[..., 3, H, W]``.

    Returns
    -------
    torch.Tensor
        XYZ ``[..., 3, H, W]``.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import oklab_to_xyz
    >>> result = oklab_to_xyz(torch.tensor([1.0, 0.0, 0.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 2) for value in result.flatten().tolist()]
    [0.95, 1.0, 1.09]
    """
    return mix(_inverse(rows(_OKLAB_CONES)), mix(_inverse(rows(_OKLAB)), as_pictures("image", image)) ** 3)


def oklab_to_oklch(image: torch.Tensor) -> torch.Tensor:
    """Return lightness, chroma and hue in radians of Oklab (or of any space of a lightness and two opponents).

    Parameters
    ----------
    image : torch.Tensor
        Oklab ``[..., 3, H, W]``.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, the hue in [0, 2π), 0 for greys.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import oklab_to_oklch
    >>> result = oklab_to_oklch(torch.tensor([0.5, 0.0, 0.1]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.5, 0.1, 1.5708]
    """
    level, red, blue = as_pictures("image", image).unbind(-3)
    grey = (red == 0) & (blue == 0)
    red = torch.where(grey, 1.0, red)
    chroma = torch.where(grey, 0.0, torch.hypot(red, blue))
    return torch.stack([level, chroma, torch.remainder(torch.atan2(blue, red), 2 * torch.pi)], -3)


def oklch_to_oklab(image: torch.Tensor) -> torch.Tensor:
    """Return Oklab of lightness, chroma and hue: the inverse of :func:`oklab_to_oklch`.

    Parameters
    ----------
    image : torch.Tensor
        Lightness, chroma and hue in radians ``[..., 3, H, W]``.

    Returns
    -------
    torch.Tensor
        Oklab ``[..., 3, H, W]``.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import oklch_to_oklab
    >>> result = oklch_to_oklab(torch.tensor([0.5, 0.1, 1.5707964]).reshape(1, 3, 1, 1))
    >>> [round(abs(value), 4) for value in result.flatten().tolist()]
    [0.5, 0.0, 0.1]
    """
    level, chroma, hue = as_pictures("image", image).unbind(-3)
    return torch.stack([level, chroma * torch.cos(hue), chroma * torch.sin(hue)], -3)


def rgb_to_ictcp(luminance: torch.Tensor) -> torch.Tensor:
    """Return ICtCp of linear BT.2020 RGB, with the PQ curve.

    Parameters
    ----------
    luminance : torch.Tensor
        Linear RGB with the primaries of BT.2020 in cd/m² ``[..., 3, H, W]``; cone responses beyond 0 … 10 000 count as
        0 and 10 000.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``: intensity 0 … 1, tritan and protan, −0.5 … 0.5.

    Raises
    ------
    ValueError, TypeError
        If the picture does not hold three channels of real floats.

    Notes
    -----
    ITU-R BT.2100-2, table 7.

    Examples
    --------
    White at the peak of PQ has the intensity 1:

    >>> import torch
    >>> from odak.learn.perception import rgb_to_ictcp
    >>> result = rgb_to_ictcp(torch.tensor([10000.0, 10000.0, 10000.0]).reshape(1, 3, 1, 1))
    >>> [abs(round(value, 3)) for value in result.flatten().tolist()]
    [1.0, 0.0, 0.0]
    """
    return mix(rows(_ICTCP), pq_encode(mix(rows(_ICTCP_CONES), as_pictures("luminance", luminance))))


def ictcp_to_rgb(image: torch.Tensor) -> torch.Tensor:
    """Return linear BT.2020 RGB in cd/m² of ICtCp: the inverse of :func:`rgb_to_ictcp`.

    Parameters
    ----------
    image : torch.Tensor
        ICtCp ``[..., 3, H, W]``.

    Returns
    -------
    torch.Tensor
        Linear RGB ``[..., 3, H, W]``.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import ictcp_to_rgb
    >>> result = ictcp_to_rgb(torch.tensor([1.0, 0.0, 0.0]).reshape(1, 3, 1, 1))
    >>> [round(value, -1) for value in result.flatten().tolist()]
    [10000.0, 10000.0, 10000.0]
    """
    return mix(_inverse(rows(_ICTCP_CONES)), pq_decode(mix(_inverse(rows(_ICTCP)), as_pictures("image", image))))


def map_to_gamut(image: torch.Tensor) -> torch.Tensor:
    """Return colours inside the gamut of sRGB: those outside lose chroma at constant lightness and hue in Oklab.

    Parameters
    ----------
    image : torch.Tensor
        Linear RGB with the primaries of sRGB ``[..., 3, H, W]``, any values.

    Returns
    -------
    torch.Tensor
        Linear RGB ``[..., 3, H, W]`` of 0 … 1; colours inside stay as they are. In the gradient the share of chroma
        that is kept counts as a constant.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import map_to_gamut
    >>> green = torch.tensor([-0.3, 1.0, -0.1]).reshape(1, 3, 1, 1)
    >>> mapped = map_to_gamut(green)
    >>> bool((mapped >= 0).all() and (mapped <= 1).all())
    True
    """
    image = as_pictures("image", image)
    oklab = xyz_to_oklab(mix(rows(_SRGB), image))
    level, opponents = oklab[..., :1, :, :].clamp(0, 1), oklab[..., 1:, :, :]

    def shown(share):
        return mix(_inverse(rows(_SRGB)), oklab_to_xyz(torch.cat([level, share * opponents], -3)))

    with torch.no_grad():
        low, high = torch.zeros_like(level), torch.ones_like(level)
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            rgb = shown(middle)
            inside = ((rgb >= 0) & (rgb <= 1)).all(-3, keepdim=True)
            low, high = torch.where(inside, middle, low), torch.where(inside, high, middle)
        outside = ((image < 0) | (image > 1)).any(-3, keepdim=True)
    return torch.where(outside, shown(low).clamp(0, 1), image)


def tone_map(image: torch.Tensor, method: str = "Reinhard", white: float = 4.0) -> torch.Tensor:
    """Return a picture of high dynamic range compressed to 0 … 1.

    Parameters
    ----------
    image : torch.Tensor
        Linear RGB with the primaries of sRGB ``[..., 3, H, W]``, 1 being the white of the display; at least 0.
    method : {"Reinhard", "Hable"}
        Reinhard et al. (2002), eq. 4, on luminance, which keeps hues; Hable's curve for each channel, which keeps
        highlights white.
    white : float
        Luminance, or value, that becomes 1.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``; saturated highlights may exceed 1 with Reinhard's operator, see :func:`map_to_gamut`.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, the method is not known or the white not positive.

    Notes
    -----
    Reinhard, Stark, Shirley and Ferwerda, ACM Trans. Graph. 21, 267 (2002). Hable, *Uncharted 2: HDR lighting*, Game
    Developers Conference (2010).

    Examples
    --------
    The luminance `white` becomes 1:

    >>> import torch
    >>> from odak.learn.perception import tone_map
    >>> grey = torch.full((1, 3, 1, 1), 4.0)
    >>> round(tone_map(grey, white=4.0).max().item(), 6)
    1.0
    """
    image = as_pictures("image", image)
    method = _validate.one_of("method", method, ("Reinhard", "Hable"))
    white = float(_validate.number("white", white, positive=True))
    if method == "Hable":
        return _filmic(image) / _filmic(torch.tensor(white, dtype=torch.float64)).item()
    luminance = mix(rows(_SRGB[1:2]), image)
    return image * ((1 + luminance / white**2) / (1 + luminance))


def _filmic(value):
    # Shoulder 0.15, linear strength 0.5, linear angle 0.1, toe strength 0.2, toe numerator 0.02 and denominator 0.3.
    numerator = value * (0.15 * value + 0.1 * 0.5) + 0.2 * 0.02
    return numerator / (value * (0.15 * value + 0.5) + 0.2 * 0.3) - 0.02 / 0.3


def _white(white, name="white"):
    levels = _validate.numbers(_validate.real(name, white, positive=True))
    if len(levels) != 3:
        raise ValueError(f"{name} must be three numbers X, Y, Z, got {white!r}")
    return np.array(levels, dtype=float)


def _column(white, like):
    return constant(tuple(white.tolist()), like.dtype, like.device)[:, None, None]


def _cube_root(relative):
    """Return the cube root above (6/29)³ and the straight line of L* below."""
    high = relative > _JOINT**3
    return torch.where(high, torch.where(high, relative, 1.0) ** (1 / 3), _FACTOR * relative + _OFFSET)


def _signed_cube_root(value):
    """Return the cube root of values of either sign; near 0 with a bounded gradient."""
    some = value.abs() > _DARKEST
    root = value.sign() * torch.where(some, value.abs(), 1.0) ** (1 / 3)
    return torch.where(some, root, value * _DARKEST ** (-2 / 3))


@functools.lru_cache(maxsize=32)
def _inverse(matrix):
    return rows(np.linalg.inv(np.array(matrix)))
