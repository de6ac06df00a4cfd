"""Colour spaces and the differences between colours: matrices from primaries and a white, conversions, gamuts, tones.

Pictures are ``[..., 3, H, W]``; three axes come back as four unless said otherwise. Nothing is clipped unless said:
each function states what it does with colours outside the gamut. Everything is differentiable, with finite gradients,
in the precision and on the device of the input.
"""

import functools
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeVar

import numpy as np
import torch
from torch.nn import functional

from odak import _array, _torch_private, _validate
from odak._torch_private import in_own_precision, is_plain_on_cpu
from odak._warnings import ArgumentWarning, warn
from odak.learn._tensors import as_pictures, floating_tensor, in_float32, in_float64, tell_scale, weighted_channels
from odak.learn.perception.hdr import pq_decode, pq_encode
from odak.tools.paths import regular_file

BT709_PRIMARIES = ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060))
BT2020_PRIMARIES = ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046))
P3_PRIMARIES = ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))

# The coordinates of D65 are published with several roundings. The first two were used by earlier releases.
XYZ_WHITE = (0.950456, 1.0, 1.088754)
LAB_WHITE = (0.31271 / 0.32902, 1.0, (1 - 0.31271 - 0.32902) / 0.32902)
IEC_WHITE = (0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290)
PRIMARIES = {
    "BT.709": BT709_PRIMARIES,
    "BT.2020": BT2020_PRIMARIES,
    "Display P3": P3_PRIMARIES,
    "DCI-P3": P3_PRIMARIES,
    "Adobe RGB": ((0.640, 0.330), (0.210, 0.710), (0.150, 0.060)),
    "ACEScg": ((0.713, 0.293), (0.165, 0.830), (0.128, 0.044)),
}
# Chromaticities of whites; D65 for the other primaries.
_D65, _WHITES = (0.3127, 0.3290), {"DCI-P3": (0.314, 0.351), "ACEScg": (0.32168, 0.33767)}


@functools.lru_cache(maxsize=64)
def _rgb_to_xyz_rows(primaries, white):
    columns = np.array([(x / y, 1.0, (1 - x - y) / y) for x, y in primaries]).T
    return columns * np.linalg.solve(columns, np.array(white))


def rgb_to_xyz_matrix(
    primaries: Sequence[Sequence[float]] = BT709_PRIMARIES, white: Sequence[float] = IEC_WHITE
) -> torch.Tensor:
    """Return the matrix from linear RGB to CIE XYZ of a display.

    Parameters
    ----------
    primaries : sequence
        Chromaticities (x, y) of red, green and blue.
    white : sequence of float
        XYZ of R = G = B = 1.

    Returns
    -------
    torch.Tensor
        ``[3, 3]``, float64.

    Raises
    ------
    ValueError, TypeError
        If the primaries are not three pairs or the white not three numbers.

    Notes
    -----
    SMPTE RP 177:1993. The defaults are IEC 61966-2-1's primaries and D65 = (0.3127, 0.3290).

    Examples
    --------
    >>> from odak.learn.perception import rgb_to_xyz_matrix
    >>> [round(value, 4) for value in rgb_to_xyz_matrix()[1].tolist()]
    [0.2126, 0.7152, 0.0722]
    """
    return torch.from_numpy(_rgb_to_xyz_rows(*_checked_space(primaries, white)).copy())


P = ParamSpec("P")
R = TypeVar("R")


def decoded_in_float32(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function, which computes pictures of half precision in float32 and returns them in their own."""

    @functools.wraps(function)
    def careful(*args: Any, **options: Any) -> Any:
        pictures = [value for value in (*args, *options.values()) if isinstance(value, torch.Tensor)]
        if not pictures or pictures[0].dtype not in (torch.float16, torch.bfloat16):
            return function(*args, **options)
        args = tuple(in_float32(value) if isinstance(value, torch.Tensor) else value for value in args)
        options = {k: in_float32(v) if isinstance(v, torch.Tensor) else v for k, v in options.items()}
        found: Any = function(*args, **options)
        if isinstance(found, tuple):
            return type(found)(*(part.to(pictures[0].dtype) for part in found))
        return found.to(pictures[0].dtype)

    return careful


@decoded_in_float32
def change_primaries(
    image: torch.Tensor,
    source: str | Sequence[Any] = "BT.709",
    target: str | Sequence[Any] = "BT.2020",
    cones: str = "Bradford",
) -> torch.Tensor:
    """Return linear RGB of one set of primaries as linear RGB of another; white is mapped to white.

    Parameters
    ----------
    image : torch.Tensor
        Linear RGB ``[..., 3, H, W]``.
    source : {"BT.709", "BT.2020", "Display P3", "DCI-P3", "Adobe RGB", "ACEScg"} or sequence
        Primaries of the picture: a name, or the chromaticities (x, y) of red, green and blue, and of the white if that
        is not D65.
    target : {"BT.709", "BT.2020", "Display P3", "DCI-P3", "Adobe RGB", "ACEScg"} or sequence
        Primaries of the result.
    cones : {"Bradford", "CAT02", "CAT16", "Hunt-Pointer-Estevez"}
        Responses that adapt where the whites differ, see :func:`adapt_chromatically`.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three; colours that the target cannot show have values below 0 or above 1.
        Differentiable.

    Raises
    ------
    ValueError, TypeError
        If the picture has other axes, or the primaries or the cones are not known.

    Notes
    -----
    ITU-R BT.2087-0 gives the matrix from BT.709 to BT.2020. DCI-P3: SMPTE RP 431-2:2011; Adobe RGB (1998), version
    2005-05; ACEScg: SMPTE ST 2065-1:2021 and S-2014-004.

    Examples
    --------
    Both have the white D65, so that greys stay:

    >>> import torch
    >>> from odak.learn.perception import change_primaries
    >>> result = change_primaries(torch.tensor([1.0, 1.0, 1.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [1.0, 1.0, 1.0]
    """
    matrix = np.array(CONES[_validate.one_of("cones", cones, CONES)])
    (to_xyz, white), (to_target, target_white) = (
        _space(name, value) for name, value in (("source", source), ("target", target))
    )
    if white != target_white:
        gains = (matrix @ np.array(target_white)) / (matrix @ np.array(white))
        to_xyz = np.linalg.solve(matrix, gains[:, None] * matrix) @ to_xyz
    return mix(rows(np.linalg.solve(to_target, to_xyz)), as_pictures("image", image))


# The largest tables of Adobe's format: entries along one axis of a table of three axes, and of one.
_LARGEST_TABLE = {"LUT_3D_SIZE": 256, "LUT_1D_SIZE": 65536}
# A table of 129 entries along each axis, with eight digits: larger ones are refused before they are read.
_CUBE_BYTES = 80 << 20


@dataclass(frozen=True, eq=False)
class ColorTable:
    """A table that changes colours: a measured correction of a display, a film's look, a conversion between cameras.

    Read one from a ``.cube`` file with :meth:`read`, or give its values; a call applies it to pictures. Use a matrix
    (:func:`change_primaries`) where the change is linear, which is exact and faster.

    Parameters
    ----------
    values : torch.Tensor
        ``[blue, green, red, 3]`` for a table of all colours, ``[N, 3]`` for one curve per channel; N at least 2.
    lowest : sequence of float
        Red, green and blue of the first entry.
    highest : sequence of float
        Red, green and blue of the last entry.

    Examples
    --------
    A table that exchanges red and blue:

    >>> import torch
    >>> from odak.learn.perception import ColorTable
    >>> blue, green, red = torch.meshgrid(*[torch.linspace(0, 1, 2)] * 3, indexing="ij")
    >>> exchange = ColorTable(torch.stack([blue, green, red], -1))
    >>> [round(value, 4) for value in exchange(torch.tensor([0.1, 0.5, 0.8]).reshape(1, 3, 1, 1)).flatten().tolist()]
    [0.8, 0.5, 0.1]
    """

    values: torch.Tensor
    lowest: Sequence[float] = (0.0, 0.0, 0.0)
    highest: Sequence[float] = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        values = _validate.real("values", self.values)
        floating_tensor("values", values, "a tensor of floats")
        _validate.shaped("values", values, "[2 or more, 2 or more, 2 or more, 3] or [2 or more, 3]")
        ends = [_validate.numbers(_validate.several(name, getattr(self, name), 3)) for name in ("lowest", "highest")]
        if not all(low < high for low, high in zip(*ends, strict=True)):
            raise ValueError(f"highest must be above lowest in each channel, got {self.highest} and {self.lowest}")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> "ColorTable":
        """Read a ``.cube`` file.

        Parameters
        ----------
        path : str or os.PathLike
            Text file with a table of one axis or of three.

        Returns
        -------
        ColorTable
            Its table, float64.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not such a file, its table is incomplete or larger than the format allows.

        Notes
        -----
        Adobe, Cube LUT Specification 1.0 (2013): red changes first, then green, then blue.
        """
        name = os.fspath(path)
        if os.path.getsize(name) > _CUBE_BYTES:
            raise ValueError(f"{name!r} is larger than a .cube file can be ({_CUBE_BYTES >> 20} MB)")
        try:
            with open(regular_file(name), encoding="utf-8-sig") as stream:
                words = [line.split() for line in stream if line.strip() and not line.lstrip().startswith("#")]
            said = {line[0]: line[1:] for line in words if line[0][0].isalpha()}
            numbers = np.array([line for line in words if not line[0][0].isalpha()], dtype=np.float64)
            kind = next(kind for kind in _LARGEST_TABLE if kind in said)
            size = int(said[kind][0])
            low, high = ([float(v) for v in said.get(f"DOMAIN_{end}", [d] * 3)] for end, d in (("MIN", 0), ("MAX", 1)))
        except (ValueError, IndexError, StopIteration) as error:
            raise ValueError(f"{name!r} is not a .cube file: {str(error) or 'it states no size of a table'}") from error
        if not 2 <= size <= _LARGEST_TABLE[kind]:
            raise ValueError(f"{name!r}: {kind} must be 2 to {_LARGEST_TABLE[kind]}, got {size}")
        shape = (size, 3) if kind == "LUT_1D_SIZE" else (size, size, size, 3)
        if numbers.shape != (math.prod(shape) // 3, 3):
            raise ValueError(f"{name!r} must have {math.prod(shape) // 3} lines of three numbers, got {numbers.shape}")
        try:
            return cls(torch.from_numpy(numbers.reshape(shape)), low, high)
        except ValueError as error:
            raise ValueError(f"{name!r}: {error}") from error

    def __call__(self, image: torch.Tensor) -> torch.Tensor:
        """Return pictures with the colours of the table, linear between its entries and constant beyond them.

        Parameters
        ----------
        image : torch.Tensor
            RGB ``[..., 3, H, W]``, encoded as the table asks for.

        Returns
        -------
        torch.Tensor
            ``[..., 3, H, W]``, four axes for three; differentiable in the picture and in the values of the table.
        """
        given = as_pictures("image", image)
        image = in_float32(given)
        low, high = (torch.tensor(end, dtype=image.dtype, device=image.device) for end in (self.lowest, self.highest))
        place = (image - low[:, None, None]) / (high - low)[:, None, None]
        values = self.values.to(image)
        if values.ndim == 2:
            count = len(values)
            place = place.clamp(0, 1) * (count - 1)
            below = place.detach().long().clamp(max=count - 2)
            channel = torch.arange(3, device=image.device)[:, None, None].expand(below.shape[-3:])
            found = torch.lerp(values[below, channel], values[below + 1, channel], place - below)
        else:
            grid = (2 * place - 1).movedim(-3, -1).reshape(1, 1, 1, -1, 3)
            cells = functional.grid_sample(values.movedim(-1, 0)[None], grid, "bilinear", "border", align_corners=True)
            found = cells.reshape(3, *given.shape[:-3], *given.shape[-2:]).movedim(0, -3)
        return found.to(given.dtype)


def _space(name, space):
    """Return the matrix from linear RGB to XYZ of a space, and the XYZ of its white."""
    if isinstance(space, str):
        space = _validate.one_of(name, space, PRIMARIES)
        pairs = (*PRIMARIES[space], _WHITES.get(space, _D65))
    else:
        (space,) = _validate.constants(**{name: space})
        pairs = tuple(tuple(_validate.numbers(_validate.real(name, pair))) for pair in _validate.several(name, space))
        pairs = pairs if len(pairs) == 4 else (*pairs, _D65)
        if len(pairs) != 4 or any(len(pair) != 2 or pair[1] <= 0 for pair in pairs):
            raise ValueError(f"{name} must be a name, or three or four pairs (x, y) with y > 0, got {space!r}")
    *primaries, (x, y) = pairs
    white = (x / y, 1.0, (1 - x - y) / y)
    return _rgb_to_xyz_rows(tuple(primaries), white), white


@decoded_in_float32
def xyz_to_xyy(image: torch.Tensor, white: Sequence[float] = IEC_WHITE) -> torch.Tensor:
    """Return chromaticity and luminance x, y, Y of CIE XYZ.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``.
    white : sequence of float
        XYZ whose chromaticity black takes, for it has none; D65 by default.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three: X/(X + Y + Z), Y/(X + Y + Z) and Y.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, or the white is not three positive numbers.

    Notes
    -----
    CIE 015:2018, section 7.3.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import xyz_to_xyy
    >>> result = xyz_to_xyy(torch.tensor([0.9505, 1.0, 1.089]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.3127, 0.329, 1.0]
    """
    white = _white(white)
    x, y, z = as_pictures("image", image).unbind(-3)
    total = x + y + z
    none = total == 0
    divisor, sum_white = torch.where(none, 1.0, total), white.sum()
    shares = (
        torch.where(none, torch.as_tensor(level / sum_white).to(value), value / divisor)
        for level, value in zip(white, (x, y), strict=False)
    )
    return torch.stack([*shares, y], -3)


@decoded_in_float32
def xyy_to_xyz(image: torch.Tensor) -> torch.Tensor:
    """Return CIE XYZ of x, y, Y: the inverse of :func:`xyz_to_xyy`.

    Parameters
    ----------
    image : torch.Tensor
        x, y and Y ``[..., 3, H, W]``.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three; 0 where y is 0.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import xyy_to_xyz
    >>> result = xyy_to_xyz(torch.tensor([0.3127, 0.329, 1.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.9505, 1.0, 1.0891]
    """
    x, y, level = as_pictures("image", image).unbind(-3)
    none = y == 0
    scale = torch.where(none, 0.0, level / torch.where(none, 1.0, y))
    return torch.stack([x * scale, torch.where(none, 0.0, level), (1 - x - y) * scale], -3)


def rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    """Return a matrix as nested tuples, which can be looked up."""
    return tuple(map(tuple, matrix.tolist()))


@in_own_precision
def mix(
    matrix: torch.Tensor | tuple[tuple[float, ...], ...],
    image: torch.Tensor,
    *,
    offset: tuple[float, ...] | None = None,
) -> torch.Tensor:
    """Return the matrix (a tensor, or :func:`rows` of an array) times the channels of pictures, in their precision.

    An offset is added to each channel. Half precision is mixed in float32 and rounded once.
    """
    flat = in_float32(image.flatten(-2))
    if isinstance(matrix, torch.Tensor):
        mixed = matrix.to(flat) @ flat
    else:
        mixed = constant(matrix, flat.dtype, flat.device) @ flat
    if offset is not None:
        mixed = mixed.add_(constant(offset, flat.dtype, flat.device)[:, None])
    return mixed.to(image.dtype).unflatten(-1, image.shape[-2:])


def constant(entries: tuple[Any, ...], dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Return nested tuples as a tensor, made once for each precision and device."""
    build = _constant.__wrapped__ if torch.compiler.is_compiling() else _constant
    return build(entries, dtype, device)


@functools.lru_cache(maxsize=256)
def _constant(matrix, dtype, device):
    # A tensor created in inference mode could not be used for gradients later.
    with _torch_private.keeping():
        return torch.tensor(matrix, dtype=dtype, device=device)


def _checked_space(primaries, white):
    _validate.listed("primaries", primaries, "three pairs (x, y)")
    primaries, white = _validate.constants(primaries=primaries, white=white)
    pairs = tuple(tuple(_validate.numbers(_validate.real("primaries", pair))) for pair in primaries)
    if len(pairs) != 3 or any(len(pair) != 2 or pair[1] <= 0 for pair in pairs):
        raise ValueError(f"primaries must be three pairs (x, y) with y > 0, got {primaries!r}")
    return pairs, tuple(_validate.numbers(_white(white)))


LUMA = (0.299, 0.587, 0.114)
DIVIDED = "divide values of 0 … 255 by 255"
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
    return ycrcb_of(_of_one("image", image))


def ycrcb_of(image: torch.Tensor) -> torch.Tensor:
    """Return :func:`rgb_2_ycrcb` of pictures ``[..., 3, H, W]`` that have been checked."""
    return mix(_RGB_TO_YCRCB, image, offset=_CHROMA_OFFSET)


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
    (threshold,) = _validate.constants(threshold=threshold)
    return srgb_decoded(_of_one("image", image))


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
    (threshold,) = _validate.constants(threshold=threshold)
    _validate.number("threshold", threshold, positive=True)
    return srgb_encoded(_of_one("image", image), float(threshold))


def linear_rgb_to_xyz(image: torch.Tensor, *, white: Sequence[float] = XYZ_WHITE) -> torch.Tensor:
    """Return CIE 1931 XYZ of linear RGB with the primaries of sRGB.

    Parameters
    ----------
    image : torch.Tensor
        Linear RGB ``[..., 3, H, W]``.
    white : sequence of float
        XYZ of R = G = B = 1. ``color.IEC_WHITE`` gives the matrix of IEC 61966-2-1 in full precision; the
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
    (white,) = _validate.constants(white=white)
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
    (white,) = _validate.constants(white=white)
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
    eps = _validate.constant("eps", eps, least=0)
    red, green, blue = _of_one("image", image).unbind(-3)
    value = torch.maximum(torch.maximum(red, green), blue)
    span = value - torch.minimum(torch.minimum(red, green), blue)
    chroma = _nonzero(span)
    below_red, below_green, below_blue = value - red, value - green, value - blue
    # Signs, 0 or 1 here, select several times faster than comparisons. The first of equal channels is the largest.
    others = torch.lerp(below_red - below_blue + 2 * chroma, below_green - below_red + 4 * chroma, below_green.sign())
    sixths = torch.lerp(below_blue - below_green, others, below_red.sign()) / chroma
    # A tiny negative angle rounds to 2π first.
    hue = _modulo_six(_modulo_six(sixths)) * (math.pi / 3)
    # A grey has no saturation, and no gradient of it beside which that of a dark value would be lost.
    return torch.stack([hue, span / torch.where(span == 0, 1.0, _nonzero(value + eps)), value], -3)


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


@decoded_in_float32
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
    CIE 015:2018, section 8.2.1; the white is D65 = (0.31271, 0.32902). Channels are mixed in float64 whatever the
    input: in float32 alone, dark channels of saturated colours would come back 8e-6 off instead of 8e-7.

    Examples
    --------
    The red primary has the lightness 53.24:

    >>> import torch
    >>> from odak.learn.perception import srgb_to_lab
    >>> result = srgb_to_lab(torch.tensor([1.0, 0.0, 0.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 2) for value in result.flatten().tolist()]
    [53.24, 80.09, 67.2]
    """
    image = _single("image", image)
    tell_scale("image", image, DIVIDED)
    return by_pixels(_to_lab, image, _to_lab_gradient)


@decoded_in_float32
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
        if not picture.numel() or picture.shape[-2:].numel() < 2:
            raise ValueError(f"{name} must have two pixels or more, got {tuple(picture.shape)}")
    variances = [picture.var((-2, -1), keepdim=True) for picture in (source, target)]
    # Rounding alone gives a constant picture a variance.
    some = variances[0] > (1e3 * torch.finfo(source.dtype).eps) ** 2
    smallest = torch.finfo(source.dtype).tiny
    ratio = torch.where(some, (variances[1].clamp_min(smallest) / torch.where(some, variances[0], 1.0)).sqrt(), 1.0)
    centred = source - source.mean((-2, -1), keepdim=True)
    return lab_to_srgb(centred * ratio + target.mean((-2, -1), keepdim=True))


def rgb_to_gray(image: torch.Tensor) -> torch.Tensor:
    """Return BT.601 luma 0.299·R + 0.587·G + 0.114·B of pictures.

    Parameters
    ----------
    image : torch.Tensor
        ``[..., 3, H, W]``, or one picture ``[H, W, 3]`` whose first axis is not 3.

    Returns
    -------
    torch.Tensor
        ``[..., 1, H, W]``, or ``[H, W]`` when the channels come last.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold pictures of three channels of real floats.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import rgb_to_gray
    >>> result = rgb_to_gray(torch.tensor([1.0, 0.0, 0.0]).reshape(3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.299]
    """
    floating_tensor("image", image)
    if image.ndim > 2 and image.shape[-3] == 3:
        return weighted_channels(image, LUMA)
    if image.ndim == 3 and image.shape[-1] == 3:
        return weighted_channels(image.permute(2, 0, 1), LUMA)[0]
    raise ValueError(f"image must be [..., 3, H, W] or [H, W, 3], got {tuple(image.shape)}")


def _of_one(name, image):
    """Return pictures ``[..., 3, H, W]`` whose white is 1."""
    pictures = as_pictures(name, image)
    tell_scale(name, pictures, DIVIDED)
    return pictures


def tristimulus(image: torch.Tensor, white: Any = IEC_WHITE) -> tuple[torch.Tensor, torch.Tensor | np.ndarray]:
    """Return pictures of XYZ and the levels of their white, after comparing the two."""
    pictures, levels = as_pictures("image", image), _white(white)
    if not isinstance(levels, torch.Tensor):
        tell_scale("image", pictures, "divide XYZ of 0 … 100 by 100", float(levels[1]))
    return pictures, levels


def _xyz_matrices(white):
    """Return the matrices to XYZ and back."""
    if isinstance(white, tuple) and white == XYZ_WHITE:
        return _XYZ_MATRICES
    matrix = _rgb_to_xyz_rows(*_checked_space(BT709_PRIMARIES, white))
    return rows(matrix), rows(np.linalg.inv(matrix))


def _single(name, image):
    """Return pictures ``[..., 3, H, W]``, one of them also without a leading axis or with its channels last."""
    channels_last = isinstance(image, torch.Tensor) and image.ndim == 3 and image.shape[0] != 3 and image.shape[-1] == 3
    image = image.permute(2, 0, 1) if channels_last else image
    as_pictures(name, image)
    return image


_RELATIVE = _rgb_to_xyz_rows(BT709_PRIMARIES, LAB_WHITE) / np.array(LAB_WHITE)[:, None]
_RGB_TO_RELATIVE, _RELATIVE_TO_RGB = rows(_RELATIVE), rows(np.linalg.inv(_RELATIVE))
TO_LAB = ((0.0, 116.0, 0.0), (500.0, -500.0, 0.0), (0.0, 200.0, -200.0))
_FROM_LAB = ((1 / 116, 1 / 500, 0.0), (1 / 116, 0.0, 0.0), (1 / 116, 0.0, -1 / 200))
_BLACK = ((16.0,), (0.0,), (0.0,))
# L* is a straight line below the cube of this root.
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


@in_own_precision
def _to_lab(rgb):
    # Mixing the channels in float32 would lose the dark ones; decoding does not mix them, and is twice as fast there.
    intensities = in_float64(_decoded(in_float32(rgb)))
    relative = _matrix(_RGB_TO_RELATIVE, intensities) @ intensities
    roots = _piecewise(relative, _LAB_JOINT**3, lambda v: _power(v, 1 / 3), 0.7 * _LAB_JOINT, _LAB_FACTOR, _LAB_OFFSET)
    return (_matrix(TO_LAB, roots) @ roots).sub_(_matrix(_BLACK, roots)).to(rgb.dtype)


@in_own_precision
def _to_lab_gradient(rgb, lab, gradient):
    roots = _matrix(_FROM_LAB, lab) @ (lab + _matrix(_BLACK, lab))
    derivative = roots.clamp_min(_LAB_JOINT).square_().mul_(3).reciprocal_()
    gradient = (_matrix(TO_LAB, lab).T @ gradient).mul_(_above(roots, _LAB_JOINT, derivative, _LAB_FACTOR))
    return _decoded_gradient(rgb, _decoded(rgb), _matrix(_RGB_TO_RELATIVE, rgb).T @ gradient)


@in_own_precision
def _from_lab(lab):
    lab, dtype = in_float64(lab), lab.dtype
    roots = _matrix(_FROM_LAB, lab) @ (lab + _matrix(_BLACK, lab))
    factor = 1 / _LAB_FACTOR
    relative = _piecewise(roots, _LAB_JOINT, lambda v: v**3, (_LAB_JOINT / 2) ** 3, factor, -_LAB_OFFSET * factor)
    linear = (_matrix(_RELATIVE_TO_RGB, lab) @ relative).to(torch.promote_types(dtype, torch.float32))
    return _encoded(linear).to(dtype)


@in_own_precision
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
        L*a*b* ``[..., 3, H, W]``; its leading axes broadcast against `first`.

    Returns
    -------
    torch.Tensor
        ``[..., 1, H, W]``, four axes for three; 1 is about just noticeable. The gradient between equal colours is 0.

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
    first, second = _lab_pair(first, second)
    return root((first - second).square().sum(-3, keepdim=True))


def delta_e_itp(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return the colour difference ΔE_ITP of pictures of high dynamic range and wide gamut.

    Parameters
    ----------
    first : torch.Tensor
        ICtCp ``[..., 3, H, W]``, as :func:`rgb_to_ictcp` gives it.
    second : torch.Tensor
        ICtCp ``[..., 3, H, W]``; its leading axes broadcast against `first`.

    Returns
    -------
    torch.Tensor
        ``[..., 1, H, W]``, four axes for three; 1 is just noticeable where the eye is most sensitive. The gradient
        between equal colours is 0.

    Raises
    ------
    ValueError, TypeError
        If a picture does not hold three channels of real floats, or the shapes do not fit together.

    Notes
    -----
    ITU-R BT.2124-0: 720·√(ΔI² + (ΔC_T/2)² + ΔC_P²).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import delta_e_itp
    >>> first, second = torch.tensor([[0.5, 0.0, 0.0], [0.5, 0.02, 0.0]]).reshape(2, 1, 3, 1, 1)
    >>> round(delta_e_itp(first, second).item(), 4)
    7.2
    """
    first, second = (in_float32(value) for value in _pair(first, second))
    weights = constant(((1.0,), (0.5,), (1.0,)), first.dtype, first.device)[..., None]
    return 720 * root(((first - second) * weights).square().sum(-3, keepdim=True))


def ciede2000(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return the CIEDE2000 colour difference with k_L = k_C = k_H = 1.

    Parameters
    ----------
    first : torch.Tensor
        L*a*b* ``[..., 3, H, W]``.
    second : torch.Tensor
        L*a*b* ``[..., 3, H, W]``; its leading axes broadcast against `first`.

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
    first, second = _lab_pair(first, second)
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
    hue_step = 2 * root(c1 * c2) * torch.sin((apart - turn) / 2)
    total = h1 + h2
    shift = 2 * math.pi * torch.where(wide, torch.where(total < 2 * math.pi, 1.0, -1.0), 0.0).to(total.dtype)
    mean_hue = torch.where(coloured, (total + shift) / 2, total)
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    square = (lightness - 50) ** 2
    lightness_scale = 1 + 0.015 * square / (20 + square).sqrt()
    terms = ((l2 - l1) / lightness_scale, (c2 - c1) / (1 + 0.045 * chroma),
             hue_step / (1 + 0.015 * chroma * _hue_weight(mean_hue)))  # fmt: skip
    squares = sum(term**2 for term in terms) + _rotation(mean_hue, chroma) * terms[1] * terms[2]
    return root(squares.clamp_min(0)).unsqueeze(-3)


def _lab_pair(first, second):
    first, second = _pair(first, second)
    if first.numel() and second.numel() and _array.is_readable(first) and _array.is_readable(second):
        (low, high), (low_too, high_too) = (torch.aminmax(picture.detach()) for picture in (first, second))
        if min(low, low_too) >= 0 and 0 < max(high, high_too) <= 1:
            warn("first and second lie in 0 … 1 in all three channels: L* is 0 … 100, was RGB meant?", ArgumentWarning)
    return first, second


def _pair(first, second):
    first, second = as_pictures("first", first), as_pictures("second", second)
    _validate.fitting(first=first, second=second)
    return first, second


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
    return root(1 / (1 + _25_TO_7 / chroma.clamp_min(1e-3) ** 7))


def _hue(a, b):
    """Return the angle in [0, 2π), 0 with a gradient of 0 for grey."""
    grey = (a == 0) & (b == 0)
    angle = torch.atan2(torch.where(grey, 0.0, b), torch.where(grey, 1.0, a))
    return torch.remainder(angle, 2 * math.pi)


def _norm(a, b):
    return root(a**2 + b**2)


def root(value: torch.Tensor) -> torch.Tensor:
    """Return √value with a gradient of 0 at 0."""
    # NaN stays NaN.
    none = value <= 0
    return torch.where(none, 0.0, torch.where(none, 1.0, value).sqrt())


CONES = {
    "Bradford": ((0.8951, 0.2664, -0.1614), (-0.7502, 1.7135, 0.0367), (0.0389, -0.0685, 1.0296)),
    "CAT02": ((0.7328, 0.4296, -0.1624), (-0.7036, 1.6975, 0.0061), (0.003, 0.0136, 0.9834)),
    "CAT16": ((0.401288, 0.650173, -0.051461), (-0.250268, 1.204414, 0.045854), (-0.002079, 0.048952, 0.953127)),
    "Hunt-Pointer-Estevez": ((0.38971, 0.68898, -0.07868), (-0.22981, 1.1834, 0.04641), (0.0, 0.0, 1.0)),
}
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
# Cone response of a grey of 1/255 in sRGB: roots of darker ones have the slope at this one.
DARKEST = 1 / (255 * 12.92)
_BISECTIONS = 40


@decoded_in_float32
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
    image, white = tristimulus(image, white)
    x, y, z = cube_root(image / _column(white, image)).unbind(-3)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -3)


@decoded_in_float32
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
    relative = torch.where(roots > _LAB_JOINT, roots**3, (roots - _LAB_OFFSET) / _LAB_FACTOR)
    return relative * _column(_white(white), relative)


@decoded_in_float32
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
    image, white = tristimulus(image, white)
    x, y, z = image.unbind(-3)
    level = 116 * cube_root(y / white[1]) - 16
    sum_white = white[0] + 15 * white[1] + 3 * white[2]
    total = x + 15 * y + 3 * z
    none = total == 0
    total = torch.where(none, 1.0, total)
    u, v = 4 * x / total - 4 * white[0] / sum_white, 9 * y / total - 9 * white[1] / sum_white
    return torch.stack([level, *(torch.where(none, 0.0, 13 * level * part) for part in (u, v))], -3)


@decoded_in_float32
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
    # Of L* rather than of the roots, so that y is 0 at black.
    y = torch.where(roots > _LAB_JOINT, roots**3, level / (116 * _LAB_FACTOR)) * white[1]
    none, sum_white = level == 0, white[0] + 15 * white[1] + 3 * white[2]
    scale = 13 * torch.where(none, 1.0, level)
    u, v = (torch.where(none, 0.0, value) / scale for value in (u, v))
    u, v = u + 4 * white[0] / sum_white, v + 9 * white[1] / sum_white
    return torch.stack([y * 9 * u / (4 * v), y, y * (12 - 3 * u - 20 * v) / (4 * v)], -3)


def xyz_to_lms(image: torch.Tensor, cones: str = "Hunt-Pointer-Estevez") -> torch.Tensor:
    """Return responses of cones to CIE XYZ.

    Parameters
    ----------
    image : torch.Tensor
        XYZ ``[..., 3, H, W]``.
    cones : {"Hunt-Pointer-Estevez", "Bradford", "CAT02", "CAT16"}
        Matrix of the responses; the others are sharpened, for chromatic adaptation.

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
    cones : {"Hunt-Pointer-Estevez", "Bradford", "CAT02", "CAT16"}
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
    cones : {"Bradford", "CAT02", "CAT16", "Hunt-Pointer-Estevez"}
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
    The white of the source becomes the white of the target:

    >>> import torch
    >>> from odak.learn.perception import adapt_chromatically
    >>> d65, d50 = (0.9505, 1.0, 1.089), (0.9642, 1.0, 0.8251)
    >>> white = torch.tensor(d65).reshape(1, 3, 1, 1)
    >>> [round(value, 4) for value in adapt_chromatically(white, d65, d50).flatten().tolist()]
    [0.9642, 1.0, 0.8251]
    """
    matrix = np.array(CONES[_validate.one_of("cones", cones, CONES)])
    source, target = _white(source_white, "source_white"), _white(target_white, "target_white")
    image = as_pictures("image", image)
    if isinstance(source, torch.Tensor) or isinstance(target, torch.Tensor):
        cones_of = torch.as_tensor(matrix, device=image.device)
        source, target = (torch.as_tensor(white, device=image.device) for white in (source, target))
        gains = (cones_of @ target) / (cones_of @ source)
        return mix(torch.linalg.solve(cones_of, gains[:, None] * cones_of), image)
    gains = (matrix @ target) / (matrix @ source)
    return mix(rows(np.linalg.solve(matrix, gains[:, None] * matrix)), image)


@decoded_in_float32
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
    Ottosson, *A perceptual color space for image processing* (2020). The slope of a cube root is infinite at black;
    the gradient, not the value, takes cone responses below the response to the grey 1/255 of sRGB, 3.0e-4, as this one,
    with a slope of 74 (L*a*b*, of lightness 1, has 9 at most).

    Examples
    --------
    The white D65 has the lightness 1 and no chroma:

    >>> import torch
    >>> from odak.learn.perception import xyz_to_oklab
    >>> result = xyz_to_oklab(torch.tensor([0.9505, 1.0, 1.089]).reshape(1, 3, 1, 1))
    >>> [abs(round(value, 2)) for value in result.flatten().tolist()]
    [1.0, 0.0, 0.0]
    """
    return mix(rows(_OKLAB), signed_power(mix(rows(_OKLAB_CONES), tristimulus(image)[0]), 1 / 3, DARKEST))


@decoded_in_float32
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
    signals = mix(_inverse(rows(_OKLAB)), as_pictures("image", image))
    return mix(_inverse(rows(_OKLAB_CONES)), signed_power(signals, 3.0, DARKEST ** (1 / 3)))


@decoded_in_float32
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


@decoded_in_float32
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


@decoded_in_float32
def rgb_to_ictcp(luminance: torch.Tensor) -> torch.Tensor:
    """Return ICtCp of linear BT.2020 RGB, with the PQ curve.

    Parameters
    ----------
    luminance : torch.Tensor
        Linear RGB with the primaries of BT.2020 in cd/m² ``[..., 3, H, W]``; cone responses are clipped to
        0 … 10 000.

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


@decoded_in_float32
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
        that is kept is a constant.

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
    white = _validate.constant("white", white, positive=True)
    if method == "Hable":
        return _filmic(image) / _filmic(torch.tensor(white, dtype=torch.float64)).item()
    luminance = mix(rows(_SRGB[1:2]), image)
    return image * ((1 + luminance / white**2) / (1 + luminance))


def _filmic(value):
    # Shoulder 0.15, linear strength 0.5, linear angle 0.1, toe strength 0.2, toe numerator 0.02 and denominator 0.3.
    numerator = value * (0.15 * value + 0.1 * 0.5) + 0.2 * 0.02
    return numerator / (value * (0.15 * value + 0.5) + 0.2 * 0.3) - 0.02 / 0.3


def _white(white, name="white"):
    """Return the levels of a white in float64; a tensor stays a tensor, which keeps its gradient."""
    white = _validate.real(name, white, positive=True)
    if isinstance(white, torch.Tensor) and white.numel() == 3:
        return white.reshape(3).double()
    return np.array(_validate.few(name, white, 3))


def _column(white, like):
    levels = (
        white.to(like) if isinstance(white, torch.Tensor) else constant(tuple(white.tolist()), like.dtype, like.device)
    )
    return levels[:, None, None]


def cube_root(relative: torch.Tensor) -> torch.Tensor:
    """Return the cube root above (6/29)³ and the straight line of L* below."""
    high = relative > _LAB_JOINT**3
    return torch.where(high, torch.where(high, relative, 1.0) ** (1 / 3), _LAB_FACTOR * relative + _LAB_OFFSET)


def signed_power(value: torch.Tensor, exponent: float, darkest: float) -> torch.Tensor:
    """Return the power of values of either sign; the slope below the darkest level is that at this level."""
    some, still = value.abs() > darkest, value.detach()
    power = value.sign() * torch.where(some, value.abs(), 1.0) ** exponent
    dark = still.sign() * still.abs() ** exponent
    return torch.where(some, power, dark + (value - still) * (exponent * darkest ** (exponent - 1)))


@functools.lru_cache(maxsize=32)
def _inverse(matrix):
    return rows(np.linalg.inv(np.array(matrix)))


# Values that one thread takes at a time: a few such blocks fit a core's cache, and a call costs little beside them.
BLOCK = 1 << 17

Gradient = Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]


def by_pixels(
    function: Callable[[torch.Tensor], torch.Tensor], image: torch.Tensor, gradient: Gradient
) -> torch.Tensor:
    """Apply a function of single pixels to pictures, in blocks whose intermediate results stay in the cache of a CPU.

    Parameters
    ----------
    function : callable
        Maps pixels ``[..., C, n]`` to ``[..., C', n]``. It must not depend on other tensors that require a gradient.
    image : torch.Tensor
        ``[..., C, H, W]``.
    gradient : callable
        Maps pixels, the values of the function and the gradient with respect to these to the gradient with respect to
        the pixels.

    Returns
    -------
    torch.Tensor
        ``[..., C', H, W]``; differentiable as often as the function is.
    """
    size = image.shape[-2:]
    if not image.numel() or not is_plain_on_cpu(image):
        return function(image.flatten(-2)).unflatten(-1, size)
    result = _Blocks.apply(image.reshape(-1, image.shape[-3], size.numel()), function, gradient)
    return result.reshape(*image.shape[:-3], -1, *size)


def by_values(
    function: Callable[[torch.Tensor], torch.Tensor], values: torch.Tensor, gradient: Gradient
) -> torch.Tensor:
    """Apply a function of single numbers to a tensor of any shape; otherwise as :func:`by_pixels`."""
    if not values.numel() or not is_plain_on_cpu(values):
        return function(values)
    return by_pixels(function, values.reshape(1, 1, -1), gradient).reshape(values.shape)


class _Blocks(torch.autograd.Function):
    @staticmethod
    def forward(context, flat, function, gradient):
        context.function, context.gradient = function, gradient
        saved, flat, result = flat, flat.detach(), None
        for index, place in _places(flat):
            block = function(flat[index, :, place])
            if result is None:
                result = block.new_empty(len(flat), len(block), flat.shape[-1])
            result[index, :, place] = block
        context.save_for_backward(saved, result)
        return result

    @staticmethod
    def backward(context, outer):
        flat, value = context.saved_tensors
        if torch.is_grad_enabled():
            # The gradient is differentiated.
            return torch.autograd.grad(context.function(flat), flat, outer, create_graph=True)[0], None, None
        result = torch.empty_like(flat)
        for index, place in _places(flat):
            block = context.gradient(flat[index, :, place], value[index, :, place], outer[index, :, place])
            result[index, :, place] = block
        return result, None, None


def _places(flat):
    """Return the index and the slice of pixels of each block."""
    count, step = flat.shape[-1], max(1, BLOCK * torch.get_num_threads() // flat.shape[1])
    return [(index, slice(start, start + step)) for index in range(len(flat)) for start in range(0, count, step)]
