"""Conversions between colour spaces, differentiable and batched, and colour transfer between pictures.

Pictures are ``[..., 3, H, W]``; three axes come back as four unless said otherwise. Nothing is clipped: each function
says what it does with colours outside the gamut. Precision and device are those of the input.
"""

import functools
from collections.abc import Sequence

import numpy as np
import torch

from odak import _validate
from odak.learn.perception import pixel_formulas
from odak.learn.perception.color_matrices import (
    BT709_PRIMARIES,
    XYZ_WHITE,
    _checked_space,
    _rgb_to_xyz_rows,
    as_pictures,
    mix,
    rows,
)
from odak.learn.perception.display_color import display_color_hvs
from odak.learn.perception.pixel_blocks import by_pixels, by_values

__all__ = [
    "color_map",
    "display_color_hvs",
    "hsv_to_rgb",
    "lab_to_srgb",
    "linear_rgb_to_rgb",
    "linear_rgb_to_xyz",
    "rgb_2_ycrcb",
    "rgb_to_gray",
    "rgb_to_hsv",
    "rgb_to_linear_rgb",
    "srgb_to_lab",
    "xyz_to_linear_rgb",
    "ycrcb_2_rgb",
]

LUMA = (0.299, 0.587, 0.114)
_RGB_TO_YCRCB = rows(np.array([LUMA, (0.713, 0, 0), (0, 0, 0.564)]) - np.outer((0, 0.713, 0.564), LUMA))
_YCRCB_TO_RGB = ((1.0, 1.403, 0.0), (1.0, -0.714, -0.344), (1.0, 0.0, 1.773))
_CHROMA_OFFSET = (0.0, 0.5, 0.5)
_RGB_OFFSET = (-0.5 * 1.403, 0.5 * (0.714 + 0.344), -0.5 * 1.773)
_KEPT = _rgb_to_xyz_rows(BT709_PRIMARIES, XYZ_WHITE)
_XYZ_MATRICES = rows(_KEPT), rows(np.linalg.inv(_KEPT))


def rgb_2_ycrcb(image: torch.Tensor) -> torch.Tensor:
    """Return Y, Cr, Cb of R′G′B′: ITU-R BT.601 luma, full range, with coefficients of three digits.

    Parameters
    ----------
    image : torch.Tensor
        Display-encoded RGB ``[..., 3, H, W]``.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three, channels in the order Y, Cr, Cb; the chroma of greys is 0.5. Linear,
        so defined for every value.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Notes
    -----
    Cr = 0.5 + 0.713·(R − Y), Cb = 0.5 + 0.564·(B − Y), as in OpenCV; BT.601 itself gives 0.7133 and 0.5643. The inverse
    has three digits as well, so that a round trip is off by up to 3e-4.
    """
    return mix(_RGB_TO_YCRCB, as_pictures("image", image), offset=_CHROMA_OFFSET)


def ycrcb_2_rgb(image: torch.Tensor) -> torch.Tensor:
    """Return R′G′B′ of Y, Cr, Cb: the inverse of :func:`rgb_2_ycrcb` to 3e-4.

    Parameters, result and errors are those of :func:`rgb_2_ycrcb`; channels come in the order Y, Cr, Cb.
    """
    return mix(_YCRCB_TO_RGB, as_pictures("image", image), offset=_RGB_OFFSET)


def rgb_to_linear_rgb(image: torch.Tensor, threshold: float = 0.0031308) -> torch.Tensor:
    """Return the linear light of sRGB values.

    Parameters
    ----------
    image : torch.Tensor
        sRGB ``[..., 3, H, W]``. Values below 0 follow the straight part, values above 1 the power.
    threshold : float
        Kept for its callers; the standard's 0.04045 counts whatever is given.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three. Differentiable, with finite gradients everywhere.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Notes
    -----
    IEC 61966-2-1:1999, section 5.2.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import rgb_to_linear_rgb
    >>> round(rgb_to_linear_rgb(torch.full((3, 1, 1), 0.5)).max().item(), 4)
    0.214
    """
    return by_values(pixel_formulas.decoded, as_pictures("image", image), pixel_formulas.decoded_slopes)


def linear_rgb_to_rgb(image: torch.Tensor, threshold: float = 0.0031308) -> torch.Tensor:
    """Return the sRGB values of linear light: the inverse of :func:`rgb_to_linear_rgb`.

    Parameters
    ----------
    image : torch.Tensor
        Linear RGB ``[..., 3, H, W]``. Values below 0 follow the straight part, values above 1 the power.
    threshold : float
        Where the straight part ends; the standard's by default.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three. Differentiable, with finite gradients everywhere.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the threshold is not positive.

    Notes
    -----
    IEC 61966-2-1:1999, section 5.3.
    """
    _validate.number("threshold", threshold, positive=True)
    threshold = float(threshold)
    formulas = (pixel_formulas.encoded, pixel_formulas.encoded_slopes)
    function, slopes = (functools.partial(formula, threshold=threshold) for formula in formulas)
    return by_values(function, as_pictures("image", image), slopes)


def linear_rgb_to_xyz(image: torch.Tensor, *, white: Sequence[float] = XYZ_WHITE) -> torch.Tensor:
    """Return CIE 1931 XYZ of linear RGB with the primaries of sRGB.

    Parameters
    ----------
    image : torch.Tensor
        Linear RGB ``[..., 3, H, W]``.
    white : sequence of float
        XYZ of R = G = B = 1. ``color_matrices.IEC_WHITE`` gives the matrix of IEC 61966-2-1 in full precision; the
        default is another rounding of D65, kept because earlier releases used it, at most 3.1e-4 away.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three; Y is 1 for white. Linear, so defined for every value.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the white is not three positive numbers.
    """
    return mix(_xyz_matrices(white)[0], as_pictures("image", image))


def xyz_to_linear_rgb(image: torch.Tensor, *, white: Sequence[float] = XYZ_WHITE) -> torch.Tensor:
    """Return linear RGB of CIE 1931 XYZ: the inverse of :func:`linear_rgb_to_xyz`, with its parameters and errors.

    Colours outside the gamut have values below 0 or above 1.
    """
    return mix(_xyz_matrices(white)[1], as_pictures("image", image))


def rgb_to_hsv(image: torch.Tensor, eps: float = 1e-8) -> torch.Tensor:
    """Return hue in radians, saturation and value of RGB.

    Parameters
    ----------
    image : torch.Tensor
        RGB ``[..., 3, H, W]``.
    eps : float
        Added to the value where the saturation is divided by it.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three: hue in [0, 2π), 0 for greys; saturation (max − min)/(max + eps), above
        1 when a channel is negative; value, the largest channel. Gradients are finite, at greys as well.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or `eps` is negative.

    Notes
    -----
    Smith, SIGGRAPH Comput. Graph. 12, 12 (1978).
    """
    eps = float(_validate.number("eps", eps, least=0))
    return by_pixels(functools.partial(pixel_formulas.to_hsv, eps=eps), as_pictures("image", image))


def hsv_to_rgb(image: torch.Tensor) -> torch.Tensor:
    """Return RGB of hue in radians, saturation and value: the inverse of :func:`rgb_to_hsv`.

    Parameters
    ----------
    image : torch.Tensor
        HSV ``[..., 3, H, W]``; the hue counts modulo 2π.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.
    """
    return by_pixels(pixel_formulas.from_hsv, as_pictures("image", image), pixel_formulas.from_hsv_slopes)


def srgb_to_lab(image: torch.Tensor) -> torch.Tensor:
    """Return CIE 1976 L*a*b* of sRGB.

    Parameters
    ----------
    image : torch.Tensor
        sRGB ``[..., 3, H, W]``, or one picture ``[H, W, 3]`` whose first axis is not 3. Values outside 0 … 1 follow the
        straight and the power part of sRGB, negative light the straight part of L*a*b*.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]`` with the axes of the input: L* 0 … 100, a* and b* about ±128; white is (100, 0, 0). Gradients
        are finite everywhere.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Notes
    -----
    CIE 015:2018, section 8.2.1; the white is D65 = (0.31271, 0.32902). Computed in float64 whatever the input: in
    float32 alone, dark channels of saturated colours would come back 8e-6 off; stored in float32, they are 8e-7 off.
    """
    return by_pixels(pixel_formulas.to_lab, _single("image", image), pixel_formulas.to_lab_slopes)


def lab_to_srgb(image: torch.Tensor) -> torch.Tensor:
    """Return sRGB of CIE 1976 L*a*b*: the inverse of :func:`srgb_to_lab`, with its axes and errors.

    Colours outside the gamut have values below 0 or above 1.
    """
    return by_pixels(pixel_formulas.from_lab, _single("image", image), pixel_formulas.from_lab_slopes)


def color_map(input_image: torch.Tensor, target_image: torch.Tensor, model: str = "Lab Stats") -> torch.Tensor:
    """Return a picture with the colours of another: equal means and standard deviations in L*a*b*.

    Parameters
    ----------
    input_image, target_image : torch.Tensor
        sRGB ``[3, H, W]`` or batches; sizes may differ.
    model : {"Lab Stats"}
        How colours are carried over.

    Returns
    -------
    torch.Tensor
        sRGB with the axes of `input_image`, not clipped. A channel without contrast keeps it at zero.

    Raises
    ------
    ValueError, TypeError
        If a picture does not hold three channels of real floats, is one pixel, or the model is not known.

    Notes
    -----
    Reinhard, Ashikhmin, Gooch and Shirley, IEEE Comput. Graph. Appl. 21, 34 (2001), in L*a*b* for lαβ.
    """
    _validate.one_of("model", model, ("Lab Stats",))
    source, target = (_single(*named) for named in (("input_image", input_image), ("target_image", target_image)))
    _validate.one_device(input_image=source, target_image=target)
    source, target = srgb_to_lab(source), srgb_to_lab(target)
    for name, picture in (("input_image", source), ("target_image", target)):
        if picture.shape[-2:].numel() < 2:
            raise ValueError(f"{name} must have two pixels or more, got {tuple(picture.shape)}")
    variances = [picture.var((-2, -1), keepdim=True) for picture in (source, target)]
    # Rounding alone gives a constant picture a variance.
    some = variances[0] > (1e3 * torch.finfo(source.dtype).eps) ** 2
    smallest = torch.finfo(source.dtype).tiny
    ratio = torch.where(some, (variances[1].clamp_min(smallest) / torch.where(some, variances[0], 1.0)).sqrt(), 1.0)
    centred = source - source.mean((-2, -1), keepdim=True)
    return lab_to_srgb(centred * ratio + target.mean((-2, -1), keepdim=True))


def rgb_to_gray(image: torch.Tensor) -> torch.Tensor:
    """Return BT.601 luma 0.299·R + 0.587·G + 0.114·B of one picture.

    Parameters
    ----------
    image : torch.Tensor
        ``[3, H, W]``, or ``[H, W, 3]`` whose first axis is not 3.

    Returns
    -------
    torch.Tensor
        ``[1, H, W]``, or ``[H, W]`` when the channels come last.

    Raises
    ------
    ValueError, TypeError
        If the image is not one picture of three channels of real floats.
    """
    if not isinstance(image, torch.Tensor) or not image.is_floating_point():
        raise TypeError(f"image must be a tensor of real floats, got {getattr(image, 'dtype', type(image).__name__)}")
    if image.ndim != 3 or 3 not in (image.shape[0], image.shape[-1]):
        raise ValueError(f"image must be [3, H, W] or [H, W, 3], got {tuple(image.shape)}")
    return _luma(image)[None] if image.shape[0] == 3 else _luma(image.permute(2, 0, 1))


def _xyz_matrices(white):
    """Return the matrices to XYZ and back."""
    if isinstance(white, tuple) and white == XYZ_WHITE:
        return _XYZ_MATRICES
    matrix = _rgb_to_xyz_rows(*_checked_space(BT709_PRIMARIES, white))
    return rows(matrix), rows(np.linalg.inv(matrix))


def _luma(image):
    red, green, blue = image.unbind(-3)
    return LUMA[0] * red + LUMA[1] * green + LUMA[2] * blue


def _single(name, image):
    """Return pictures ``[..., 3, H, W]``, one of them also without a leading axis or with its channels last."""
    channels_last = isinstance(image, torch.Tensor) and image.ndim == 3 and image.shape[0] != 3 and image.shape[-1] == 3
    image = image.permute(2, 0, 1) if channels_last else image
    as_pictures(name, image)
    return image
