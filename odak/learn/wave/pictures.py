"""Light of a display for a stored picture, and the picture of a display's light: one function for each way."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from odak import _show, _validate
from odak.learn._tensors import as_pictures, floating, floating_tensor, in_float32
from odak.learn.perception.color import (
    IEC_WHITE,
    adapt_chromatically,
    change_primaries,
    linear_rgb_to_xyz,
    rgb_to_xyz_matrix,
    srgb_decoded,
    srgb_encoded,
    xyz_to_linear_rgb,
)
from odak.learn.perception.display_color import color_matching_functions
from odak.learn.wave.displays.display import Display
from odak.tools.file import embedded_profile, holds_light, read_levels, white_level
from odak.tools.icc import profile_of

# Lumens per watt at the maximum of the luminous efficiency, 555 nm (CIE 018:2019).
_EFFICACY = 683.002
# White of the space that ICC profiles connect to, D50 (ICC.1:2022, 7.2.16).
_D50 = (0.9642, 1.0, 0.8249)
# Rounding makes no colour one that cannot be shown.
_ROUNDING = 1e-6
# Any one source is shown grey.
_GREEN = 555e-9
GAMUTS = ("desaturate", "clip")


@dataclass(frozen=True)
class PictureLight:
    """Light that a display shall show for a picture.

    Attributes
    ----------
    targets : torch.Tensor
        Intensities ``[C, rows, columns]`` in linear light, 1 for each source in white, for
        :func:`odak.learn.wave.optimise`. A colour more saturated than white may need more than 1 of a source.
    wavelengths : tuple of float
        Of the C sources, in metres.
    watts : torch.Tensor
        Radiant power of each source in one lumen of white ``[C]``, float64: their mixture is the white D65. A single
        source has no white, and its power is that of one lumen.
    lumens : torch.Tensor
        Luminous flux of each source in one lumen of white ``[C]``.
    outside : float
        Share of the picture's pixels whose colours no mixture of the sources shows.
    gamut : str
        What was done with them, "desaturate" or "clip".
    source : str
        How the values of the picture were decoded.

    Examples
    --------
    The sRGB value 0.5 is 0.214 of the light of white:

    >>> import torch
    >>> from odak.learn.wave import light_of
    >>> light = light_of(torch.full((3, 2, 2), 0.5), [638e-9, 520e-9, 450e-9])
    >>> [round(value, 3) for value in light.targets[:, 0, 0].tolist()]
    [0.214, 0.214, 0.214]
    >>> [round(1e3 * value, 2) for value in light.watts.tolist()]
    [2.1, 1.45, 0.84]
    """

    targets: torch.Tensor
    wavelengths: tuple[float, ...]
    watts: torch.Tensor
    lumens: torch.Tensor
    outside: float
    gamut: str
    source: str

    def table(self) -> list[dict[str, float]]:
        """Return one row for each source: wavelength in metres, watts and lumens in one lumen of white, mean target."""
        means = self.targets.detach().double().mean((-2, -1))
        return [
            {"wavelength": w, "watts": float(p), "lumens": float(f), "mean": float(m)}
            for w, p, f, m in zip(self.wavelengths, self.watts, self.lumens, means, strict=True)
        ]

    def __repr__(self) -> str:
        sources = ", ".join(
            f"{1e9 * row['wavelength']:.4g} nm {1e3 * row['watts']:.3g} mW {row['lumens']:.3g} lm"
            for row in self.table()
        )
        return (
            f"PictureLight {list(self.targets.shape)} of {self.source}: one lumen of white is {sources}; "
            f"{self.outside:.1%} of the pixels outside the gamut ({self.gamut})"
        )

    def _repr_html_(self) -> str:
        return _show.page(self, PictureLight._view)

    def _view(self) -> _show.View:
        """Return what notebooks show of it: the picture of the light, and the powers of the sources."""
        shown = picture_of(self.targets.detach().cpu(), self.wavelengths)
        head = "wavelength", "power per lumen of white", "luminous flux", "mean target"
        rows = [
            (
                f"{1e9 * row['wavelength']:.4g} nm",
                f"{1e3 * row['watts']:.3g} mW",
                f"{row['lumens']:.3g} lm",
                f"{row['mean']:.3g}",
            )
            for row in self.table()
        ]
        return _show.View(repr(self), [("on a screen", _show.png(shown.movedim(0, -1)))], [head, *rows])


@_validate.takes_units()
def light_of(
    picture: str | os.PathLike[str] | torch.Tensor | np.ndarray,
    display: Display | Sequence[float] | float,
    *,
    linear: bool | None = None,
    grey: bool = False,
    gamut: str = "desaturate",
) -> PictureLight:
    """Return the light that a display shall show for a picture.

    Stored values of pictures are not proportional to light. They are decoded, and their colours, for the CIE 1931
    observer of 2° and the white D65, are given as amounts of the display's sources.

    Parameters
    ----------
    picture : str, os.PathLike, torch.Tensor or numpy.ndarray
        A file that :func:`odak.tools.load_image` reads, or sRGB values of 0 … 1 ``[3, rows, columns]``, or grey
        ``[rows, columns]`` or ``[1, rows, columns]``. The profile in a file counts, whatever its bits per channel: a
        profile of primaries and curves, such as Display P3 or Adobe RGB, keeps its colours beyond sRGB; any other is
        converted to sRGB by Pillow. Files without a profile are sRGB. What is transparent gives no light.
    display : Display or sequence of float or float
        The display, or the wavelengths of its sources in metres: three, or one.
    linear : bool, optional
        True for values that are linear light already, with the primaries of sRGB. By default the files that are by
        definition, OpenEXR and Radiance; values given as an array are encoded.
    grey : bool, default: False
        True gives the luminance of the picture to each source, as a display of one source always does.
    gamut : {"desaturate", "clip"}
        What becomes of colours that no mixture of the sources shows. "desaturate" mixes them with the grey of their own
        luminance until the first source is at zero, so that luminance and hue stay, hue as the straight line from white
        in the diagram of chromaticities. "clip" sets negative amounts to zero, which makes them brighter.

    Returns
    -------
    PictureLight
        Targets in the precision and on the device of a tensor given, float32 for a file, and the powers of the sources.
        Targets are differentiable in the picture.

    Raises
    ------
    ValueError, TypeError
        If the picture is none of the above, or the sources are not one visible one or three whose mixture can be white.

    Notes
    -----
    IEC 61966-2-1:1999 (sRGB and D65), SMPTE RP 177:1993 (primaries to XYZ), CIE 018:2019 (observer), ICC.1:2022.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import light_of, picture_of
    >>> picture = torch.rand(3, 8, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) / 2 + 0.4
    >>> sources = [638e-9, 520e-9, 450e-9]
    >>> light = light_of(picture, sources)
    >>> light.outside, bool(torch.allclose(picture_of(light.targets, sources), picture))
    (0.0, True)
    """
    gamut = _validate.one_of("gamut", gamut, GAMUTS)
    wavelengths, to_xyz = _sources(display)
    light, source = _decoded(picture, linear)
    outside = 0.0
    if len(wavelengths) == 1 or _validate.flag("grey", grey):
        targets = linear_rgb_to_xyz(light, white=IEC_WHITE)[..., 1:2, :, :].expand(-1, len(wavelengths), -1, -1)
        targets = targets.clamp_min(0)
    else:
        targets = change_primaries(light, "BT.709", _primaries(to_xyz))
        outside = float((targets.detach().amin(-3) < -_ROUNDING).double().mean())
        targets = _inside(targets, to_xyz[1], gamut)
    lumens = to_xyz[1]
    watts = lumens / (_EFFICACY * _observed(wavelengths)[1].to(lumens))
    return PictureLight(targets[0], wavelengths, watts, lumens, outside, gamut, source)


@_validate.takes_units()
def picture_of(images: torch.Tensor, display: Display | Sequence[float] | float) -> torch.Tensor:
    """Return the sRGB picture that looks on a screen as the light of a display does.

    Parameters
    ----------
    images : torch.Tensor
        Intensities ``[..., C, rows, columns]`` in linear light, 1 for each source in white, as targets and
        :attr:`DisplayedHologram.images` are.
    display : Display or sequence of float or float
        The display, or the wavelengths of its sources in metres: three, or one, whose light is shown grey.

    Returns
    -------
    torch.Tensor
        sRGB values of 0 … 1 ``[..., 3, rows, columns]``, differentiable. Colours outside sRGB are mixed with the grey
        of their own luminance; what is brighter than white is clipped.

    Raises
    ------
    ValueError, TypeError
        If the images do not have an axis of the display's sources, or the sources are not one or three visible ones.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import picture_of
    >>> screen = picture_of(torch.full((1, 2, 2), 0.214041), 532e-9)
    >>> tuple(screen.shape), round(screen.max().item(), 3)
    ((3, 2, 2), 0.5)
    """
    wavelengths, to_xyz = _sources(display)
    light = as_pictures("images", images, len(wavelengths))
    if light.numel() == 0:
        raise ValueError(f"images must have rows and columns, got {tuple(images.shape)}")
    _validate.check_values("images", light)
    if len(wavelengths) == 1:
        light = light.expand(*light.shape[:-3], 3, *light.shape[-2:])
    else:
        light = change_primaries(light, _primaries(to_xyz), "BT.709")
    luminances = rgb_to_xyz_matrix()[1]
    encoded = srgb_encoded(_inside(light, luminances, "desaturate").clamp(0, 1))
    return encoded.reshape(*images.shape[:-3], 3, *images.shape[-2:])


@_validate.takes_units()
def fitted(picture: torch.Tensor, display: Display, how: str = "pad") -> torch.Tensor:
    """Return a picture at the size of a display's images.

    Parameters
    ----------
    picture : torch.Tensor
        Light ``[..., rows, columns]`` with square samples, such as :attr:`PictureLight.targets`, or a depth map.
    display : Display
        The display. Behind a lens, samples of the image of the first wavelength count.
    how : {"pad", "crop", "scale"}
        Whether all of the picture is shown, in the middle of black; or the frame is filled, and what does not fit is
        cut off on both sides; or the frame is filled by all of the picture, which distorts it.

    Returns
    -------
    torch.Tensor
        ``[..., rows, columns]`` of the display, by bicubic interpolation, averaged where the picture has more samples
        than the display; not negative. Differentiable.

    Raises
    ------
    ValueError, TypeError
        If the picture is no tensor of real floats with rows and columns, or the way is not known.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Modulator, fitted
    >>> display = Display(Modulator((48, 64), 8e-6), 532e-9, 2e-3)
    >>> square = torch.ones(100, 100)
    >>> [round(fitted(square, display, how).mean().item(), 2) for how in ("pad", "crop", "scale")]
    [0.75, 1.0, 1.0]
    """
    picture = _validate.image("picture", floating_tensor("picture", picture))
    _validate.instance("display", display, Display, "a Display")
    how = _validate.one_of("how", how, ("pad", "crop", "scale"))
    resolution = display.shape[2:]
    pitches = display.path.image_pitches(0)
    size = resolution if how == "scale" else fitting_size(picture.shape[-2:], resolution, pitches, how == "crop")
    leading = picture.shape[:-2]
    frame, _ = on_frame(in_float32(picture).reshape(-1, *picture.shape[-2:]), resolution, size)
    return frame.reshape(*leading, *resolution).to(picture)


def on_frame(
    picture: torch.Tensor, resolution: tuple[int, int], size: tuple[int, int], mode: str = "bicubic"
) -> tuple[torch.Tensor, tuple[slice, slice]]:
    """Resize a picture, and place it in the middle of a black frame, or cut the frame out of its middle.

    Parameters
    ----------
    picture : torch.Tensor
        ``[channels, rows, columns]``, 0 … 1.
    resolution : tuple of int
        Rows and columns of the frame.
    size : tuple of int
        Rows and columns to resize to, from :func:`fitting_size`.
    mode : str
        "bicubic", or "nearest-exact" for values that must not be mixed.

    Returns
    -------
    tuple
        Frame ``[channels, *resolution]``, and the rows and columns (slices) of the picture in it.
    """
    if size != tuple(picture.shape[-2:]) and mode == "bicubic":
        picture = torch.nn.functional.interpolate(picture[None], size, mode=mode, antialias=True)[0].clamp_min(0)
    elif size != tuple(picture.shape[-2:]):
        picture = torch.nn.functional.interpolate(picture[None], size, mode=mode)[0]
    kept = [min(f, s) for f, s in zip(resolution, size, strict=True)]
    top, left = ((s - k) // 2 for s, k in zip(size, kept, strict=True))
    rows, columns = (slice((f - k) // 2, (f - k) // 2 + k) for f, k in zip(resolution, kept, strict=True))
    frame = picture.new_zeros(len(picture), *resolution)
    frame[:, rows, columns] = picture[:, top : top + kept[0], left : left + kept[1]]
    return frame, (rows, columns)


def fitting_size(
    shape: Sequence[int], resolution: tuple[int, int], pitches: tuple[float, float], covering: bool = False
) -> tuple[int, int]:
    """Return the largest rows and columns within a frame that show a picture of square samples undistorted.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns of the picture.
    resolution : tuple of int
        Rows and columns of the frame.
    pitches : tuple of float
        Pixel pitch of the frame along rows and columns.
    covering : bool
        The smallest that cover the frame instead.
    """
    dy, dx = pitches
    # In pixels of the frame, whose rows are farther apart than its columns where dy is above dx.
    sides = (shape[0] * (dx / dy), shape[1])
    ratios = [frame / side for frame, side in zip(resolution, sides, strict=True)]
    ratio, bound = (max(ratios), max) if covering else (min(ratios), min)
    rows, columns = (bound(frame, max(1, round(n * ratio))) for frame, n in zip(resolution, sides, strict=True))
    return rows, columns


def shown_on_a_screen(images: torch.Tensor, display: Display) -> torch.Tensor:
    """Return what :func:`picture_of` does, and the mean of the colours where these cannot be mixed to white.

    Parameters
    ----------
    images : torch.Tensor
        Intensities ``[..., C, rows, columns]``.
    display : Display
        The display, of any number of sources.
    """
    try:
        _sources(display)
    except ValueError:
        return picture_of(images.mean(-3, keepdim=True), _GREEN)
    return picture_of(images, display)


def _sources(display) -> tuple[tuple[float, ...], torch.Tensor]:
    """Return the wavelengths and, as columns, XYZ of each source in white, whose luminances add up to 1."""
    (given,) = _validate.constants(display=display.wavelengths if isinstance(display, Display) else display)
    wavelengths = tuple(_validate.numbers(_validate.real("display", given, positive=True)))
    if len(wavelengths) not in (1, 3):
        raise ValueError(f"display must have one source or three, whose colours can be mixed, got {len(wavelengths)}")
    seen = _observed(wavelengths)
    in_words = ", ".join(f"{1e9 * w:.4g} nm" for w in wavelengths)
    if not bool((seen[1] > 0).all()):
        raise ValueError(f"display must have visible sources, got {in_words}")
    if len(wavelengths) == 1:
        return wavelengths, seen / seen[1]
    to_xyz = rgb_to_xyz_matrix(_primaries(seen), IEC_WHITE)
    if not bool((to_xyz[1] > 0).all()):
        raise ValueError(f"display must have sources whose mixture can be white, got {in_words}")
    return wavelengths, to_xyz


def _observed(wavelengths) -> torch.Tensor:
    return color_matching_functions([1e9 * wavelength for wavelength in wavelengths])


def _primaries(to_xyz) -> list[tuple[float, float]]:
    return [(float(x / (x + y + z)), float(y / (x + y + z))) for x, y, z in to_xyz.T.tolist()]


def _inside(light, luminances, gamut):
    """Return amounts of the sources that are not negative."""
    if gamut == "desaturate":
        weights = luminances.to(light)[:, None, None]
        luminance = (weights * light).sum(-3, keepdim=True).clamp_min(0)
        lowest = light.amin(-3, keepdim=True)
        below = lowest < 0
        share = luminance / torch.where(below, luminance - lowest, 1.0)
        light = torch.where(below, luminance + share * (light - luminance), light)
    return light.clamp_min(0)


def _decoded(picture: Any, linear: bool | None) -> tuple[torch.Tensor, str]:
    """Return linear light ``[1, 3, rows, columns]`` with the primaries of sRGB, any values, and where it came from."""
    stated = None if linear is None else _validate.flag("linear", linear)
    if not isinstance(picture, (str, os.PathLike)):
        values = floating("picture", picture)
        values = values[None] if values.ndim == 2 else values
        if values.ndim != 3 or values.shape[0] not in (1, 3) or values.numel() == 0:
            got = _validate.in_order("picture", values.shape)
            raise ValueError(f"picture must be [3, rows, columns] or [rows, columns], {got}")
        _validate.check_values("picture", values, None if stated else "divide values of 0 … 255 by 255")
        values = values.expand(3, -1, -1)[None]
        return (values, "linear light") if stated else (srgb_decoded(values), "sRGB")
    name = os.path.basename(os.fspath(picture))
    levels = read_levels(picture, torch_style=True)
    profile = None if stated or holds_light(picture) else embedded_profile(picture)
    matrix = None if profile is None else profile_of(profile)
    if profile is not None and matrix is None:
        levels = read_levels(picture, torch_style=True, color_managed=True)
    values = levels[None] if levels.ndim == 2 else levels
    values, alpha = values[:3] / white_level(levels), values[3:] / white_level(levels)
    if matrix is not None:
        kind = matrix.description
        repeated = values if len(values) >= len(matrix.curves) else np.repeat(values, len(matrix.curves), 0)
        xyz = torch.from_numpy(matrix.light(repeated))[None]
        light = xyz_to_linear_rgb(adapt_chromatically(xyz, _D50, IEC_WHITE), white=IEC_WHITE)
    else:
        light = torch.from_numpy(np.ascontiguousarray(values, dtype=np.float64)).expand(3, -1, -1)[None]
        kind = "linear light" if stated or (stated is None and holds_light(picture)) else "sRGB"
        light = light if kind == "linear light" else srgb_decoded(light)
    if len(alpha):
        light = light * torch.from_numpy(alpha[0].astype(np.float64))
    return light.to(torch.get_default_dtype()), f"{name} ({kind})"
