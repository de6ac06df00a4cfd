"""Conversions between colour spaces and differences between colours, differentiable and batched.

Pictures are ``[..., 3, H, W]``; three axes come back as four unless said otherwise. Nothing is clipped: each function
states what it does with colours outside the gamut. Precision and device are those of the input.
"""

import functools
import math
from collections.abc import Sequence

import numpy as np
import torch
from torch.nn import functional

from odak import _validate
from odak.learn.perception.color_matrices import (
    BT709_PRIMARIES,
    LAB_WHITE,
    XYZ_WHITE,
    _checked_space,
    _rgb_to_xyz_rows,
    as_pictures,
    by_pixels,
    by_values,
    constant,
    in_float64,
    mix,
    rows,
)
from odak.learn.perception.display_color import display_color_hvs as display_color_hvs  # also found here

LUMA = (0.299, 0.587, 0.114)
_RGB_TO_YCRCB = rows(np.array([LUMA, (0.713, 0, 0), (0, 0, 0.564)]) - np.outer((0, 0.713, 0.564), LUMA))
_YCRCB_TO_RGB = ((1.0, 1.403, 0.0), (1.0, -0.714, -0.344), (1.0, 0.0, 1.773))
_25_TO_7 = 25.0**7
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

    Examples
    --------
    Greys have the chroma 0.5:

    >>> import torch
    >>> from odak.learn.perception import rgb_2_ycrcb
    >>> result = rgb_2_ycrcb(torch.tensor([0.5, 0.5, 0.5]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.5, 0.5, 0.5]
    """
    return mix(_RGB_TO_YCRCB, as_pictures("image", image), offset=_CHROMA_OFFSET)


def ycrcb_2_rgb(image: torch.Tensor) -> torch.Tensor:
    """Return R′G′B′ of Y, Cr, Cb: the inverse of :func:`rgb_2_ycrcb` to 3e-4.

    Parameters
    ----------
    image : torch.Tensor
        Y, Cr, Cb ``[..., 3, H, W]``, the chroma of greys being 0.5.

    Returns
    -------
    torch.Tensor
        Display-encoded RGB ``[..., 3, H, W]``, four axes for three.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import ycrcb_2_rgb
    >>> result = ycrcb_2_rgb(torch.tensor([0.5, 0.5, 0.5]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.5, 0.5, 0.5]
    """
    return mix(_YCRCB_TO_RGB, as_pictures("image", image), offset=_RGB_OFFSET)


def rgb_to_linear_rgb(image: torch.Tensor, threshold: float = 0.0031308) -> torch.Tensor:
    """Return the linear intensities of sRGB values.

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
    return srgb_decoded(as_pictures("image", image))


def linear_rgb_to_rgb(image: torch.Tensor, threshold: float = 0.0031308) -> torch.Tensor:
    """Return the sRGB values of linear intensities: the inverse of :func:`rgb_to_linear_rgb`.

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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import linear_rgb_to_rgb
    >>> result = linear_rgb_to_rgb(torch.tensor([0.0, 0.214041, 1.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.0, 0.5, 1.0]
    """
    _validate.number("threshold", threshold, positive=True)
    return srgb_encoded(as_pictures("image", image), float(threshold))


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

    Examples
    --------
    White has the luminance Y = 1:

    >>> import torch
    >>> from odak.learn.perception import linear_rgb_to_xyz
    >>> result = linear_rgb_to_xyz(torch.tensor([1.0, 1.0, 1.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.9505, 1.0, 1.0888]
    """
    return mix(_xyz_matrices(white)[0], as_pictures("image", image))


def xyz_to_linear_rgb(image: torch.Tensor, *, white: Sequence[float] = XYZ_WHITE) -> torch.Tensor:
    """Return linear RGB with the primaries of sRGB of CIE 1931 XYZ: the inverse of :func:`linear_rgb_to_xyz`.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``, Y being 1 for white.
    white : sequence of float
        XYZ of R = G = B = 1, as in :func:`linear_rgb_to_xyz`.

    Returns
    -------
    torch.Tensor
        Linear RGB ``[..., 3, H, W]``, four axes for three; colours outside the gamut have values below 0 or above 1.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the white is not three positive numbers.

    Examples
    --------
    The white D65 is R = G = B:

    >>> import torch
    >>> from odak.learn.perception import xyz_to_linear_rgb
    >>> result = xyz_to_linear_rgb(torch.tensor([0.9505, 1.0, 1.089]).reshape(1, 3, 1, 1))
    >>> [round(value, 2) for value in result.flatten().tolist()]
    [1.0, 1.0, 1.0]
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

    Examples
    --------
    Green has the hue 2π/3:

    >>> import torch
    >>> from odak.learn.perception import rgb_to_hsv
    >>> result = rgb_to_hsv(torch.tensor([0.0, 1.0, 0.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [2.0944, 1.0, 1.0]
    """
    eps = float(_validate.number("eps", eps, least=0))
    red, green, blue = as_pictures("image", image).unbind(-3)
    value = torch.maximum(torch.maximum(red, green), blue)
    span = value - torch.minimum(torch.minimum(red, green), blue)
    chroma = _nonzero(span)
    below_red, below_green, below_blue = value - red, value - green, value - blue
    # Signs, 0 or 1 here, select several times faster than comparisons. The first of equal channels is the largest.
    others = torch.lerp(below_red - below_blue + 2 * chroma, below_green - below_red + 4 * chroma, below_green.sign())
    sixths = torch.lerp(below_blue - below_green, others, below_red.sign()) / chroma
    # A tiny negative angle rounds to 2π first.
    hue = _modulo_six(_modulo_six(sixths)) * (math.pi / 3)
    return torch.stack([hue, span / _nonzero(value + eps), value], -3)


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

    Examples
    --------
    The hue 2π/3 is green:

    >>> import torch
    >>> from odak.learn.perception import hsv_to_rgb
    >>> result = hsv_to_rgb(torch.tensor([2.0944, 1.0, 1.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.0, 1.0, 0.0]
    """
    hue, saturation, value = as_pictures("image", image).unbind(-3)
    sixths, lost = _modulo_six(hue * (3 / math.pi)), saturation * value
    # 1 where a channel is full, 0 where it is empty, linear between.
    ramps = (sixths - 3).abs() - 1, 2 - (sixths - 2).abs(), 2 - (sixths - 4).abs()
    return torch.stack([value - lost * (1 - ramp.clamp(0, 1)) for ramp in ramps], -3)


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

    Examples
    --------
    White has the lightness 100:

    >>> import torch
    >>> from odak.learn.perception import srgb_to_lab
    >>> result = srgb_to_lab(torch.tensor([1.0, 1.0, 1.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 2) for value in result.flatten().tolist()]
    [100.0, 0.0, 0.0]
    """
    return by_pixels(_to_lab, _single("image", image), _to_lab_gradient)


def lab_to_srgb(image: torch.Tensor) -> torch.Tensor:
    """Return sRGB of CIE 1976 L*a*b*: the inverse of :func:`srgb_to_lab`.

    Parameters
    ----------
    image : torch.Tensor
        L*a*b* ``[..., 3, H, W]``, or one picture ``[H, W, 3]`` whose first axis is not 3.

    Returns
    -------
    torch.Tensor
        sRGB with the axes of the input; colours outside the gamut have values below 0 or above 1.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import lab_to_srgb
    >>> result = lab_to_srgb(torch.tensor([100.0, 0.0, 0.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [1.0, 1.0, 1.0]
    """
    return by_pixels(_from_lab, _single("image", image), _from_lab_gradient)


def color_map(input_image: torch.Tensor, target_image: torch.Tensor, model: str = "Lab Stats") -> torch.Tensor:
    """Return a picture with the colours of another: equal means and standard deviations in L*a*b*.

    Parameters
    ----------
    input_image : torch.Tensor
        Picture whose colours are changed, sRGB ``[3, H, W]`` or a batch.
    target_image : torch.Tensor
        Picture whose colours are taken, sRGB ``[3, H, W]`` or a batch; its size may differ.
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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import color_map, srgb_to_lab
    >>> generator = torch.Generator().manual_seed(0)
    >>> first, second = (torch.rand(3, 8, 8, generator=generator) * scale for scale in (0.5, 1.0))
    >>> result = color_map(first, second)
    >>> lightness = [srgb_to_lab(picture)[..., 0, :, :].mean().item() for picture in (result, second)]
    >>> abs(lightness[0] - lightness[1]) < 1e-2
    True
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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import rgb_to_gray
    >>> result = rgb_to_gray(torch.tensor([1.0, 0.0, 0.0]).reshape(3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.299]
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


_25_TO_7 = 25.0**7

_RELATIVE = _rgb_to_xyz_rows(BT709_PRIMARIES, LAB_WHITE) / np.array(LAB_WHITE)[:, None]
_RGB_TO_RELATIVE, _RELATIVE_TO_RGB = rows(_RELATIVE), rows(np.linalg.inv(_RELATIVE))
_TO_LAB = ((0.0, 116.0, 0.0), (500.0, -500.0, 0.0), (0.0, 200.0, -200.0))
_FROM_LAB = ((1 / 116, 1 / 500, 0.0), (1 / 116, 0.0, 0.0), (1 / 116, 0.0, -1 / 200))
_BLACK = ((16.0,), (0.0,), (0.0,))
_LAB_JOINT = 6 / 29
_LAB_FACTOR, _LAB_OFFSET = 1 / (3 * _LAB_JOINT**2), 4 / 29
_DECODED_FROM, _ENCODED_FROM = 0.04045, 0.0031308


def srgb_decoded(values: torch.Tensor) -> torch.Tensor:
    """Return the linear intensities of sRGB values of any shape (IEC 61966-2-1:1999, section 5.2)."""
    return by_values(_decoded, values, _decoded_gradient)


def srgb_encoded(intensities: torch.Tensor, threshold: float = _ENCODED_FROM) -> torch.Tensor:
    """Return the sRGB values of linear intensities of any shape (IEC 61966-2-1:1999, section 5.3)."""
    formulas = (functools.partial(formula, threshold=threshold) for formula in (_encoded, _encoded_gradient))
    function, gradient = formulas
    return by_values(function, intensities, gradient)


def _decoded(values):
    return _piecewise(values, _DECODED_FROM, lambda v: _power(v.add_(0.055).mul_(1 / 1.055), 2.4), 0.002, 1 / 12.92)


def _encoded(intensities, threshold=_ENCODED_FROM):
    middle = 1.055 * (threshold / 2) ** (1 / 2.4) - 0.055
    return _piecewise(intensities, threshold, lambda v: (1.055 * _power(v, 1 / 2.4)).sub_(0.055), middle, 12.92)


def _decoded_gradient(values, intensities, gradient):
    # Without another power: the derivative is 2.4·intensity/(value + 0.055).
    derivative = (intensities / values.clamp_min(0).add_(0.055)).mul_(2.4)
    return _above(values, _DECODED_FROM, derivative, 1 / 12.92).mul_(gradient)


def _encoded_gradient(intensities, values, gradient, threshold=_ENCODED_FROM):
    # Without another power: the derivative is (value + 0.055)/(2.4·intensity).
    derivative = (values + 0.055).div_(intensities.clamp_min(threshold)).mul_(1 / 2.4)
    return _above(intensities, threshold, derivative, 12.92).mul_(gradient)


def _above(values, edge, above, below):
    """Return `above` where values are above an edge, and the number `below` elsewhere."""
    high = functional.threshold(values, edge, 0.0).sign_()
    return torch.lerp(torch.full_like(above, below), above, high)


def _piecewise(values, edge, curve, middle, factor, offset=0.0):
    """Return a rising curve of values above an edge, and ``factor·value + offset`` of the others.

    `middle` lies between the curve at an eighth of the edge and at the edge. The curve is not evaluated anywhere else
    below the edge, so that its gradients are finite. Choosing by comparisons takes several times longer than the
    thresholds of neural networks.
    """
    curved = functional.threshold(curve(functional.threshold(values, edge, edge / 8)), middle, offset)
    return curved.sub_(functional.threshold(values, edge, 0.0).sub_(values), alpha=factor)


def _power(base, exponent):
    # Twice as fast as a general power, which treats signs.
    return torch.exp2(base.log2().mul_(exponent))


def _to_lab(rgb):
    rgb, dtype = in_float64(rgb), rgb.dtype
    relative = _matrix(_RGB_TO_RELATIVE, rgb) @ _decoded(rgb)
    roots = _piecewise(relative, _LAB_JOINT**3, lambda v: _power(v, 1 / 3), 0.7 * _LAB_JOINT, _LAB_FACTOR, _LAB_OFFSET)
    return (_matrix(_TO_LAB, rgb) @ roots).sub_(_matrix(_BLACK, rgb)).to(dtype)


def _to_lab_gradient(rgb, lab, gradient):
    roots = _matrix(_FROM_LAB, lab) @ (lab + _matrix(_BLACK, lab))
    derivative = roots.clamp_min(_LAB_JOINT).square_().mul_(3).reciprocal_()
    gradient = (_matrix(_TO_LAB, lab).T @ gradient).mul_(_above(roots, _LAB_JOINT, derivative, _LAB_FACTOR))
    return _decoded_gradient(rgb, _decoded(rgb), _matrix(_RGB_TO_RELATIVE, rgb).T @ gradient)


def _from_lab(lab):
    lab, dtype = in_float64(lab), lab.dtype
    roots = _matrix(_FROM_LAB, lab) @ (lab + _matrix(_BLACK, lab))
    factor = 1 / _LAB_FACTOR
    relative = _piecewise(roots, _LAB_JOINT, lambda v: v**3, (_LAB_JOINT / 2) ** 3, factor, -_LAB_OFFSET * factor)
    return _encoded(_matrix(_RELATIVE_TO_RGB, lab) @ relative).to(dtype)


def _from_lab_gradient(lab, rgb, gradient):
    gradient = _matrix(_RELATIVE_TO_RGB, lab).T @ _encoded_gradient(_decoded(rgb), rgb, gradient)
    roots = _matrix(_FROM_LAB, lab) @ (lab + _matrix(_BLACK, lab))
    derivative = roots.square().mul_(3)
    return _matrix(_FROM_LAB, lab).T @ gradient.mul_(_above(roots, _LAB_JOINT, derivative, 1 / _LAB_FACTOR))


def _matrix(entries, like):
    return constant(entries, like.dtype, like.device)


def _modulo_six(angle):
    return angle - 6 * (angle / 6).floor()


def _nonzero(values):
    """Return values, 1 in place of 0."""
    return values + (1 - values.sign().abs())


def delta_e(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return the CIE 1976 colour difference, the distance in L*a*b*.

    Parameters
    ----------
    first : torch.Tensor
        L*a*b* ``[..., 3, H, W]``.
    second : torch.Tensor
        L*a*b* ``[..., 3, H, W]``; its leading axes broadcast against those of `first`.

    Returns
    -------
    torch.Tensor
        ``[..., 1, H, W]``, four axes for three; about 1 can just be seen. The gradient between equal colours is 0.

    Raises
    ------
    ValueError, TypeError
        If a picture does not hold three channels of real floats, or the shapes do not fit together.

    Notes
    -----
    CIE 015:2018, section 8.2.1.3.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import delta_e
    >>> first, second = torch.tensor([[50.0, 0.0, 0.0], [53.0, 4.0, 0.0]]).reshape(2, 1, 3, 1, 1)
    >>> delta_e(first, second).item()
    5.0
    """
    first, second = _pair(first, second)
    return _root((first - second).square().sum(-3, keepdim=True))


def ciede2000(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return the CIEDE2000 colour difference with k_L = k_C = k_H = 1.

    Parameters
    ----------
    first : torch.Tensor
        L*a*b* ``[..., 3, H, W]``.
    second : torch.Tensor
        L*a*b* ``[..., 3, H, W]``; its leading axes broadcast against those of `first`.

    Returns
    -------
    torch.Tensor
        ``[..., 1, H, W]``, four axes for three. Gradients are finite, 0 between equal colours; the formula itself jumps
        where hues are opposite.

    Raises
    ------
    ValueError, TypeError
        If a picture does not hold three channels of real floats, or the shapes do not fit together.

    Notes
    -----
    Sharma, Wu and Dalal, Color Res. Appl. 30, 21 (2005), equations 2 to 22.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import ciede2000
    >>> pair = torch.tensor([[50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485]]).reshape(2, 3, 1, 1)
    >>> round(ciede2000(pair[:1], pair[1:]).item(), 4)
    2.0425
    """
    first, second = _pair(first, second)
    (l1, a1, b1), (l2, a2, b2) = first.unbind(-3), second.unbind(-3)
    mean_chroma = (_norm(a1, b1) + _norm(a2, b2)) / 2
    stretch = 1.5 - _saturating(mean_chroma) / 2
    c1, c2 = _norm(stretch * a1, b1), _norm(stretch * a2, b2)
    h1, h2 = _hue(stretch * a1, b1), _hue(stretch * a2, b2)
    coloured = c1 * c2 != 0
    apart = torch.where(coloured, h2 - h1, 0.0)
    # A small tolerance, so that exactly opposite hues are treated alike on every machine.
    wide = apart.abs() > math.pi * (1 + 4 * torch.finfo(apart.dtype).eps)
    turn = torch.where(wide, 2 * math.pi * torch.sign(apart), 0.0)
    hue_step = 2 * _root(c1 * c2) * torch.sin((apart - turn) / 2)
    total = h1 + h2
    shift = 2 * math.pi * torch.where(wide, torch.where(total < 2 * math.pi, 1.0, -1.0), 0.0).to(total.dtype)
    mean_hue = torch.where(coloured, (total + shift) / 2, total)
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    terms = ((l2 - l1) / _lightness_scale(lightness), (c2 - c1) / (1 + 0.045 * chroma),
             hue_step / (1 + 0.015 * chroma * _hue_weight(mean_hue)))  # fmt: skip
    squares = sum(term**2 for term in terms) + _rotation(mean_hue, chroma) * terms[1] * terms[2]
    return _root(squares.clamp_min(0)).unsqueeze(-3)


def _pair(first, second):
    first, second = as_pictures("first", first), as_pictures("second", second)
    _validate.fitting(first=first, second=second)
    return first, second


def _lightness_scale(lightness):
    square = (lightness - 50) ** 2
    return 1 + 0.015 * square / (20 + square).sqrt()


def _hue_weight(hue):
    degree = math.pi / 180
    return (
        1
        - 0.17 * torch.cos(hue - 30 * degree)
        + 0.24 * torch.cos(2 * hue)
        + 0.32 * torch.cos(3 * hue + 6 * degree)
        - 0.20 * torch.cos(4 * hue - 63 * degree)
    )


def _rotation(hue, chroma):
    degrees = hue * (180 / math.pi)
    turn = math.pi / 3 * torch.exp(-(((degrees - 275) / 25) ** 2))
    return -2 * _saturating(chroma) * torch.sin(turn)


def _saturating(chroma):
    """Return √(C⁷/(C⁷ + 25⁷))."""
    return _root(1 / (1 + _25_TO_7 / chroma.clamp_min(1e-3) ** 7))


def _hue(a, b):
    """Return the angle in [0, 2π), 0 with a gradient of 0 for grey."""
    grey = (a == 0) & (b == 0)
    angle = torch.atan2(torch.where(grey, 0.0, b), torch.where(grey, 1.0, a))
    return torch.remainder(angle, 2 * math.pi)


def _norm(a, b):
    return _root(a**2 + b**2)


def _root(value):
    """Return √value with a gradient of 0 at 0."""
    # NaN stays NaN.
    none = value <= 0
    return torch.where(none, 0.0, torch.where(none, 1.0, value).sqrt())
