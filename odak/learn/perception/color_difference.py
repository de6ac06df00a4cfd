"""Differences between colours in L*a*b*: CIE 1976 and CIEDE2000."""

import math

import torch

from odak import _validate
from odak.learn.perception.color_matrices import as_pictures

_25_TO_7 = 25.0**7


def delta_e(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return the CIE 1976 colour difference, the distance in L*a*b*.

    Parameters
    ----------
    first, second : torch.Tensor
        L*a*b* ``[..., 3, H, W]``; leading axes broadcast.

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
    """
    first, second = _pair(first, second)
    return _root((first - second).square().sum(-3, keepdim=True))


def ciede2000(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return the CIEDE2000 colour difference with k_L = k_C = k_H = 1.

    Parameters
    ----------
    first, second : torch.Tensor
        L*a*b* ``[..., 3, H, W]``; leading axes broadcast.

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
    # A hair of tolerance: exactly opposite hues are to be read alike on every machine.
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
    # What is not a number stays so.
    none = value <= 0
    return torch.where(none, 0.0, torch.where(none, 1.0, value).sqrt())
