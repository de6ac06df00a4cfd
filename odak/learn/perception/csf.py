"""Contrast sensitivity of the eye (Barten 1999, castleCSF), visible differences, and losses weighted by both.

The visibility of a difference depends on eccentricity, colour and masking. The sampling that each ring around the gaze
needs follows from the same sensitivity.
"""

import functools
import importlib.util
import json
import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import torch

from odak import _torch_private, _validate
from odak.learn._tensors import (
    as_pictures,
    check_loss_inputs,
    check_values,
    floating,
    in_float32,
    places_between,
    tensor,
    weighted_channels,
)
from odak.learn.perception.color import srgb_decoded, srgb_to_lab
from odak.learn.perception.foveation import make_eccentricity_distance_maps
from odak.learn.perception.pyramids import FrequencySteerablePyramid
from odak.learn.perception.sight import (
    Gaze,
    Kept,
    Seen,
    Viewing,
    angle_of,
    each_of,
    gaze_at,
    gaze_of,
    geometry,
    parts_of,
    viewing_of,
)

SIGNAL_TO_NOISE = 3.0
INTEGRATION_TIME = 0.1
QUANTUM_EFFICIENCY = 0.03
PHOTONS_PER_TROLAND = 1.2274e6
NEURAL_NOISE = 3e-8
INHIBITION_END = 7.0
LARGEST_SIZE = 12.0
MOST_CYCLES = 15.0
YOUNGEST, OLDEST = 20, 83
BLUR, BLUR_PER_PUPIL = 0.5 / 60, 0.08 / 60
_BT709_LUMINANCE = (0.2126, 0.7152, 0.0722)


def pupil_diameter(luminance: torch.Tensor | float, size: torch.Tensor | float = 60.0) -> torch.Tensor:
    """Return the diameter of the pupil in millimetres.

    Parameters
    ----------
    luminance : torch.Tensor or float
        Of the field, in cd/m².
    size : torch.Tensor or float
        Side of the square field, in degrees.

    Returns
    -------
    torch.Tensor
        5 − 3·tanh(0.4·log₁₀(L·X²/40²)), float64 of plain numbers.

    Raises
    ------
    ValueError, TypeError
        If an argument is not positive.

    Notes
    -----
    Barten, *Contrast Sensitivity of the Human Eye* (SPIE, 1999), chapter 3.

    Examples
    --------
    The pupil narrows from about 8 to 2 mm:

    >>> from odak.learn.perception import pupil_diameter
    >>> [round(pupil_diameter(luminance).item(), 1) for luminance in (1e-4, 10.0, 1e4)]
    [7.7, 3.5, 2.2]
    """
    return _pupil(*positive_numbers(luminance=luminance, size=size))


def _pupil(luminance, size):
    return 5 - 3 * torch.tanh(0.4 * torch.log10(luminance * size**2 / 40**2))


def unified_pupil_diameter(
    luminance: torch.Tensor | float,
    area: torch.Tensor | float = 3600.0,
    age: torch.Tensor | float = 28.58,
    eyes: int = 2,
) -> torch.Tensor:
    """Return the diameter of the pupil of an eye adapted to light, in millimetres.

    Parameters
    ----------
    luminance : torch.Tensor or float
        Of the field, in cd/m².
    area : torch.Tensor or float
        Of the field, in square degrees.
    age : torch.Tensor or float
        In years, 20 to 83; 28.58 is the mean of the observers behind the formula.
    eyes : int
        Eyes that see the field, 1 or 2.

    Returns
    -------
    torch.Tensor
        Of the broadcast shape, float64 of plain numbers; differentiable.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Watson and Yellott, J. Vis. 12(10), 12 (2012), doi 10.1167/12.10.12, equation 21: the formula of Stanley and Davies
    for the flux density at the cornea, a tenth of it for one eye, with the effect of age after Winn and others.
    :func:`odak.learn.perception.pupil_diameter` is Barten's.

    Examples
    --------
    >>> from odak.learn.perception import unified_pupil_diameter
    >>> [round(unified_pupil_diameter(light).item(), 1) for light in (0.01, 100.0, 10000.0)]
    [7.1, 2.8, 2.1]
    """
    if eyes not in (1, 2) or isinstance(eyes, bool):
        raise ValueError(f"eyes must be 1 or 2, got {eyes!r}")
    luminance, area, age = positive_numbers(luminance=luminance, area=area, age=age)
    _validate.inside("age", age, "years", least=YOUNGEST, most=OLDEST)
    flux = (luminance * area * (1.0 if eyes == 2 else 0.1) / 846) ** 0.41
    young = 7.75 - 5.75 * flux / (flux + 2)
    return young + (age - 28.58) * (0.02132 - 0.009562 * young)


def contrast_sensitivity(
    frequency: torch.Tensor | float, luminance: torch.Tensor | float = 100.0, size: torch.Tensor | float = 60.0
) -> torch.Tensor:
    """Return the contrast sensitivity of the eye: 1 over the modulation of a grating detected half of the time.

    Parameters
    ----------
    frequency : torch.Tensor or float
        In cycles per degree, positive.
    luminance : torch.Tensor or float
        Mean of the grating, in cd/m².
    size : torch.Tensor or float
        Side of the square field, in degrees.

    Returns
    -------
    torch.Tensor
        Sensitivity of the broadcast shape, float64 of plain numbers. Differentiable in all three.

    Raises
    ------
    ValueError, TypeError
        If an argument is not positive.

    Notes
    -----
    Barten, *Contrast Sensitivity of the Human Eye* (SPIE, 1999), chapter 3, and Proc. SPIE 5294, 231 (2004): young
    observers, both eyes, photopic light, k = 3, T = 0.1 s, η = 0.03, σ₀ = 0.5′, C = 0.08′/mm, Φ₀ = 3e-8 s·deg²,
    u₀ = 7 cycles per degree, p = 1.2274e6 photons per s, deg² and troland (a white CRT). Retinal illuminance counts the
    Stiles–Crawford effect.

    Examples
    --------
    >>> from odak.learn.perception import contrast_sensitivity
    >>> [round(contrast_sensitivity(u).item()) for u in (0.5, 4.0, 30.0)]
    [335, 657, 30]
    """
    frequency, luminance, size = positive_numbers(frequency=frequency, luminance=luminance, size=size)
    return sensitivity(frequency, luminance, size)


class CSFLoss(Seen):
    """Differences of luminance weighted by the contrast sensitivity of the eye, in squared multiples of the threshold.

    The difference of two pictures over the target's mean luminance is a sum of gratings, each of which weighs as many
    times as it exceeds the threshold: loss = 2·mean(filtered²). A grating at its threshold costs 1, ten times
    that 100. Luminance alone counts; add another loss for colour.

    The eye faces the middle of a flat picture, perpendicular, with the same sensitivity everywhere (no fall-off towards
    the periphery). Pictures are taken as periodic. A uniform difference is taken as the lowest frequency of the
    picture.

    Parameters
    ----------
    real_image_width : float
        Width of the picture as shown.
    real_viewing_distance : float
        Distance to the eye, in the same unit.
    peak_luminance : float
        Of white, in cd/m².
    black_luminance : float
        Of black, in cd/m².
    encoding : {"sRGB", "linear"}
        Encoding of the pictures.
    viewing : Viewing, optional
        Geometry and luminances, with the light that the display reflects, instead of the numbers.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import CSFLoss
    >>> target = torch.full((1, 3, 32, 32), 0.5)
    >>> loss = CSFLoss(real_image_width=0.3, real_viewing_distance=0.6)
    >>> loss(target, target).item(), bool(loss(target + 0.1, target) > 1)
    (0.0, True)
    """

    def __init__(
        self,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        peak_luminance: float = 100.0,
        black_luminance: float = 0.1,
        encoding: str = "sRGB",
        *,
        viewing: Viewing | None = None,
    ):
        super().__init__()
        view = real_image_width, real_viewing_distance, peak_luminance, black_luminance
        self.viewing: Viewing = viewing_of(viewing, *view)
        self.encoding: str = _validate.one_of("encoding", encoding, ("sRGB", "linear"))
        self.register_buffer("frequencies", None, persistent=False)
        self._kept = None

    def forward(self, image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            Pictures ``[B, C, H, W]`` of one shape, one or three channels, nominally 0 … 1. The target sets the eye's
            adaptation and gets no gradient through it.

        Returns
        -------
        torch.Tensor
            The mean over the pictures, without axes, in their precision, float32 of half precision; 0 for equal
            luminance.

        Raises
        ------
        ValueError, TypeError
            If the pictures are not as said, hold values below −1 or above 2, or are a single pixel.
        """
        for name, picture in (("image", image), ("target", target)):
            _check_range(name, as_pictures(name, picture, None))
        check_loss_inputs("CSFLoss", image, target)
        dtype = torch.promote_types(image.dtype, target.dtype)
        image, target = in_float32(image.to(dtype)), in_float32(target.to(dtype))
        if image.shape[-2:].numel() < 2:
            raise ValueError(f"image and target must have two pixels or more, got {tuple(image.shape)}")
        shown, wanted = self._luminance(image), self._luminance(target)
        mean = wanted.detach().mean((-2, -1), keepdim=True).clamp_min(self.viewing.darkest)
        spectrum = torch.fft.rfft2((shown - wanted) / mean, norm="forward")
        gain = sensitivity(self._frequencies(image), mean, self._size(image))
        power = spectrum.real**2 + spectrum.imag**2
        return (half_spectrum_weights(image) * gain**2 * power).sum((-2, -1)).mean()

    def _luminance(self, picture):
        return _luminance(srgb_decoded(picture) if self.encoding == "sRGB" else picture, self.viewing)

    def _size(self, picture):
        """Return the side in degrees of a square of the picture's area."""
        height = self.real_image_width * picture.shape[-2] / picture.shape[-1]
        return math.sqrt(self.viewing.field_of_view * angle_of(height, self.real_viewing_distance))

    def _frequencies(self, picture):
        """Return frequencies in cycles per degree at the middle of the picture, kept by size and place."""
        key = (tuple(picture.shape[-2:]), picture.dtype, picture.device, self.viewing)
        if self._kept != key:
            rows, columns = picture.shape[-2:]
            pitch = math.degrees(self.real_image_width / columns / self.real_viewing_distance)
            down = torch.fft.fftfreq(rows, pitch, dtype=torch.float64)
            across = torch.fft.rfftfreq(columns, pitch, dtype=torch.float64)
            frequencies = torch.hypot(down[:, None], across)
            lowest = 1 / (max(rows, columns) * pitch)
            with _torch_private.keeping():
                self.frequencies: torch.Tensor = frequencies.clamp_min(lowest).to(picture.device, picture.dtype)
            self._kept = key
        return self.frequencies


def sensitivity(frequency: torch.Tensor, luminance: torch.Tensor, size: torch.Tensor | float) -> torch.Tensor:
    """Return Barten's contrast sensitivity, its arguments unchecked: see :func:`contrast_sensitivity`."""
    pupil = _pupil(luminance, size)
    illuminance = math.pi * pupil**2 / 4 * luminance * (1 - (pupil / 9.7) ** 2 + (pupil / 12.4) ** 4)
    blur = BLUR**2 + (BLUR_PER_PUPIL * pupil) ** 2
    transfer = torch.exp(-2 * math.pi**2 * blur * frequency**2)
    area = 1 / size**2 + 1 / LARGEST_SIZE**2 + (frequency / MOST_CYCLES) ** 2
    photon_noise = 1 / (QUANTUM_EFFICIENCY * PHOTONS_PER_TROLAND * illuminance)
    neural_noise = NEURAL_NOISE / -torch.expm1(-((frequency / INHIBITION_END) ** 2))
    return transfer / SIGNAL_TO_NOISE / (2 / INTEGRATION_TIME * area * (photon_noise + neural_noise)).sqrt()


def positive_numbers(**values: torch.Tensor | float) -> list[torch.Tensor]:
    """Return positive numbers and tensors as tensors of floats that broadcast."""
    for name, value in values.items():
        _validate.real(name, value, positive=True)
    values = {name: floating(name, v) if isinstance(v, torch.Tensor) else v for name, v in values.items()}
    tensors = [v for v in values.values() if isinstance(v, torch.Tensor)]
    kind = {"dtype": torch.float64} if not tensors else {"dtype": tensors[0].dtype, "device": tensors[0].device}
    made = {name: v if isinstance(v, torch.Tensor) else tensor(name, v, **kind) for name, v in values.items()}
    _validate.fitting(**made)
    return list(made.values())


def not_negative(name: str, value: torch.Tensor | float) -> torch.Tensor:
    """Return numbers of 0 or more as a tensor, float64 of a plain one."""
    _validate.real(name, value)
    value = floating(name, value, None if isinstance(value, torch.Tensor) else torch.float64)
    return _validate.inside(name, value, least=0)


def half_spectrum_weights(picture: torch.Tensor) -> torch.Tensor:
    """Return by which the columns of half a spectrum count in 2·mean(picture²): all but the first and middle twice."""
    columns = picture.shape[-1]
    weights = picture.new_full((columns // 2 + 1,), 4.0)
    weights[0] = 2.0
    if columns % 2 == 0:
        weights[-1] = 2.0
    return weights


def _luminance(light, viewing):
    """Return the luminance in cd/m² of pictures ``[..., C, H, W]`` of one or three primaries, ``[..., 1, H, W]``."""
    if light.shape[-3] == 3:
        light = weighted_channels(light, _BT709_LUMINANCE)
    return viewing.luminance(light)


def _check_range(name, picture):
    _validate.inside(name, _validate.real(name, picture), "(white is 1)", least=-1, most=2)


PACKAGE, MODULE = "cvvdp", "pycvvdp"
TABLES = ("vvdp_data", "csf_lut_weber_fixed_size.json")
CHANNELS = ("achromatic", "red-green", "violet-yellow")
FLICKERS = (0, 5)


def castle_contrast_sensitivity(
    frequency: torch.Tensor | float,
    luminance: torch.Tensor | float = 100.0,
    channel: str = "achromatic",
    temporal_frequency: int = 0,
) -> torch.Tensor:
    """Return the contrast sensitivity of the eye to gratings of luminance or colour, by castleCSF.

    Parameters
    ----------
    frequency : torch.Tensor or float
        In cycles per degree, positive; taken as 0.1 below that and as 64 above.
    luminance : torch.Tensor or float
        Mean of the grating, in cd/m²; taken as 0.005 below that and as 10 000 above.
    channel : {"achromatic", "red-green", "violet-yellow"}
        Direction in which the grating varies; flicker is known for the first alone.
    temporal_frequency : {0, 5}
        In hertz.

    Returns
    -------
    torch.Tensor
        Sensitivity of the broadcast shape, float64 of plain numbers: one over the contrast, as ColorVideoVDP defines
        it, at threshold in a patch of 1.5° radius. Differentiable in frequency and luminance.

    Raises
    ------
    ImportError
        If the package with the tables is missing; the message states what to install.
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Ashraf, Mantiuk, Chapiro and Wuerger, J. Vis. 24, 5 (2024). Logarithms are interpolated linearly between 32
    frequencies and 32 luminances. :func:`odak.learn.perception.contrast_sensitivity` needs no table.

    Examples
    --------
    >>> from odak.learn.perception import castle_contrast_sensitivity
    >>> peak, high = (castle_contrast_sensitivity(f).item() for f in (3.0, 30.0))  # doctest: +SKIP
    >>> peak > 10 * high  # doctest: +SKIP
    True
    """
    channel = _validate.one_of("channel", channel, CHANNELS)
    if temporal_frequency not in FLICKERS or (temporal_frequency and channel != CHANNELS[0]):
        raise ValueError(
            f"temporal_frequency must be 0, or 5 for the achromatic channel, got {temporal_frequency!r} for {channel!r}"
        )
    frequency, luminance = positive_numbers(frequency=frequency, luminance=luminance)
    frequency, luminance = torch.broadcast_tensors(frequency, luminance)
    tables = _tables()
    values = tables[f"o{temporal_frequency}_c{CHANNELS.index(channel) + 1}"].to(frequency)
    rows, down = places_between(tables["L_bkg"].log10().to(frequency), luminance.log10())
    columns, across = places_between(tables["rho"].log10().to(frequency), frequency.log10())
    near, far = (torch.lerp(values[rows + step, columns], values[rows + step, columns + 1], across) for step in (0, 1))
    return 10 ** torch.lerp(near, far, down)


def _tables():
    # Found without importing the package, which takes seconds.
    spec = importlib.util.find_spec(MODULE)
    if spec is None or not spec.submodule_search_locations:
        raise ImportError(
            f"castle_contrast_sensitivity needs the tables of the package {PACKAGE}: pip install {PACKAGE}"
        )
    return _read(Path(next(iter(spec.submodule_search_locations))).joinpath(*TABLES))


@functools.lru_cache(maxsize=2)
def _read(path):
    tables = json.loads(path.read_text(encoding="utf-8"))
    with _torch_private.keeping():
        return {
            name: torch.tensor(value, dtype=torch.float64) for name, value in tables.items() if isinstance(value, list)
        }


# Contrast threshold over frequency and eccentricity, T = T₀·exp(α·f·(e + e₂)/e₂): Geisler and Perry, Proc. SPIE 3299,
# 294 (1998).
LEAST_CONTRAST, DECAY, HALVING = 1 / 64, 0.106, 2.3
# Kernels of S-CIELAB, weights and spreads in degrees: Zhang and Wandell, J. Soc. Inf. Disp. 5, 61 (1997).
RED_GREEN, BLUE_YELLOW = ((0.531, 0.0392), (0.330, 0.494)), ((0.488, 0.0536), (0.371, 0.386))
# Just noticeable difference in CIELAB: Mahy, Van Eycken and Oosterlinck, Color Res. Appl. 19, 105 (1994).
JUST_NOTICEABLE = 2.3
# Slope of threshold elevation over the contrast of the mask: Legge and Foley, J. Opt. Soc. Am. 70, 1458 (1980).
MASKING = 0.6
# Middle of an octave band, as a fraction of its upper end; and of the high-pass residual.
BAND, RESIDUAL = 0.5, 0.85


def highest_frequency(eccentricity: torch.Tensor | float) -> torch.Tensor:
    """Return the highest spatial frequency above threshold at an eccentricity, at full contrast.

    Parameters
    ----------
    eccentricity : torch.Tensor or float
        In degrees, 0 or more.

    Returns
    -------
    torch.Tensor
        In cycles per degree; float64 of a plain number.

    Raises
    ------
    ValueError, TypeError
        If an eccentricity is negative or no number.

    Notes
    -----
    Where T₀·exp(α·f·(e + e₂)/e₂) is one, with T₀ = 1/64, α = 0.106 and e₂ = 2.3°: Geisler and Perry, Proc. SPIE 3299,
    294 (1998).

    Examples
    --------
    >>> from odak.learn.perception import highest_frequency
    >>> [round(highest_frequency(e).item(), 1) for e in (0.0, 2.3, 20.0)]
    [39.2, 19.6, 4.0]
    """
    eccentricity = not_negative("eccentricity", eccentricity)
    return HALVING * math.log(1 / LEAST_CONTRAST) / (DECAY * (eccentricity + HALVING))


class BudgetRing(NamedTuple):
    """Samples of a ring around the gaze.

    Attributes
    ----------
    inner, outer : float
        Eccentricities in degrees.
    pixels : int
        Pixels of the display in it.
    samples : float
        Samples that can be resolved there: never more than pixels.

    Examples
    --------
    >>> from odak.learn.perception import foveated_budget
    >>> ring = foveated_budget((540, 960), real_image_width=1.0, real_viewing_distance=0.6)[0]
    >>> ring.inner, ring.samples <= ring.pixels
    (0.0, True)
    """

    inner: float
    outer: float
    pixels: int
    samples: float


def foveated_budget(
    image_pixel_size: Sequence[int],
    gaze: Gaze | None = None,
    real_image_width: float = 0.2,
    real_viewing_distance: float = 0.7,
    edges: Sequence[float] = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 90.0),
    *,
    viewing: Viewing | None = None,
) -> list[BudgetRing]:
    """Return how many samples a renderer has to make in each ring around the gaze.

    Parameters
    ----------
    image_pixel_size : sequence of int
        Rows and columns of the display, whose pixels are square.
    gaze : sequence of float, optional
        (x, y), 0 to 1 from the top-left corner; or ``[B, 2]``, of which the mean number of samples is returned. By
        default the middle, or that of the viewing.
    real_image_width : float
        Width of the display.
    real_viewing_distance : float
        Distance of the eye from its centre, in the same unit.
    edges : sequence of float
        Eccentricities between the rings, rising, in degrees.
    viewing : Viewing, optional
        Geometry and, without `gaze`, gaze, instead of the two lengths.

    Returns
    -------
    list of BudgetRing
        For each ring that holds pixels.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range or the edges do not rise.

    Notes
    -----
    Two samples along each axis for a period of :func:`highest_frequency`. Pixels are counted with the angle that each
    has where it is on the flat display.

    Examples
    --------
    >>> from odak.learn.perception import foveated_budget
    >>> rings = foveated_budget((540, 960), real_image_width=1.0, real_viewing_distance=0.6)
    >>> bool(sum(ring.samples for ring in rings) < 0.5 * 540 * 960)
    True
    """
    width, distance = _validate.constants(
        real_image_width=real_image_width, real_viewing_distance=real_viewing_distance
    )
    gaze, (width, distance) = gaze_at(viewing, gaze), geometry(viewing, width, distance)
    rows, columns = _validate.size("image_pixel_size", image_pixel_size)
    edges = _validate.few("edges", edges, rising=True)
    # Gradients of a gaze are lost in counts, and reported.
    gaze = gaze_of("gaze", (0.5, 0.5) if gaze is None else gaze)
    angle, far = make_eccentricity_distance_maps(gaze, (rows, columns), width, distance, dtype=torch.float64)
    degrees = torch.rad2deg(angle)
    # Solid angle of a pixel, pitch²·cos/d², in square degrees.
    pitch = width / columns
    solid = math.degrees(1) ** 2 * pitch**2 * distance / far**3
    samples = ((2 * highest_frequency(degrees)) ** 2 * solid).clamp(max=1)
    rings, gazes = [], len(each_of(gaze))
    for inner, outer in pairwise(edges):
        inside = (degrees >= inner) & (degrees < outer)
        if inside.any():
            pixels, found = inside.sum() / gazes, (samples * inside).sum() / gazes
            rings.append(BudgetRing(inner, outer, round(float(pixels)), float(found)))
    return rings


class VisibilityLoss(Seen):
    """Visible differences of brightness and colour for one gaze, in squared multiples of the threshold.

    Differences are split into octaves. Each is weighted by the contrast sensitivity at its frequency and eccentricity,
    and divided by how much the target's own contrast in the same octave masks it.

    Parameters
    ----------
    real_image_width : float
        Width of the picture as shown.
    real_viewing_distance : float
        Distance of the eye from the picture's centre, in the same unit.
    peak_luminance : float
        Of white, in cd/m².
    black_luminance : float
        Of black, in cd/m².
    n_levels : int
        Octaves, at least 2.
    colour : float
        Weight of the two channels of colour; 0 leaves them out.
    masking : float
        Slope of the elevation of thresholds over the mask's contrast, 0 to 1; 0 for none.
    viewing : Viewing, optional
        Geometry, gaze and luminances, with the light that the display reflects, instead of the numbers.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Brightness: Barten's contrast sensitivity, its frequencies scaled by (e + e₂)/e₂ with e₂ = 2.3°, the law of Geisler
    and Perry (1998) and :func:`highest_frequency`, and never more than at the gaze. Colour: differences of a* and b*
    filtered by the kernels of S-CIELAB (Zhang and Wandell 1997), scaled alike, over a just noticeable difference of
    2.3. Masking: a difference of c thresholds on a mask of m thresholds becomes c/(1 + m²)^(s/2), with the slope
    s = 0.6 of Legge and Foley (1980).
    Octaves are computed by :class:`FrequencySteerablePyramid`, whose energies add up; pictures are taken as periodic.
    For luminance alone, without gaze and exact in frequency: :class:`CSFLoss`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import VisibilityLoss
    >>> loss = VisibilityLoss(real_image_width=0.3, real_viewing_distance=0.5)
    >>> target, error = torch.full((1, 3, 64, 64), 0.5), torch.zeros(1, 3, 64, 64)
    >>> error[..., 24:40:2, 24:40] = 0.1
    >>> bool(loss(target + error, target) > 2 * loss(target + error, target, gaze=(0.0, 0.0)))
    True
    """

    pyramid: FrequencySteerablePyramid

    def __init__(
        self,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        peak_luminance: float = 100.0,
        black_luminance: float = 0.1,
        n_levels: int = 5,
        colour: float = 1.0,
        masking: float = MASKING,
        *,
        viewing: Viewing | None = None,
    ) -> None:
        super().__init__()
        view = real_image_width, real_viewing_distance, peak_luminance, black_luminance
        self.viewing: Viewing = viewing_of(viewing, *view)
        self.colour: float = _validate.constant("colour", colour, least=0)
        self.masking: float = _validate.constant("masking", masking, least=0, most=1)
        self.pyramid = FrequencySteerablePyramid(_validate.integer("n_levels", n_levels, minimum=2), 1)
        self._kept = Kept()

    def forward(self, image: torch.Tensor, target: torch.Tensor, gaze: Gaze | None = None) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            sRGB or grey pictures ``[B, C, H, W]`` of one shape, about 0 … 1. The target sets adaptation and masking,
            through which it gets no gradient.
        gaze : sequence of float, optional
            (x, y), 0 to 1 from the top-left corner; it may lie outside the picture. Or ``[B, 2]``, one for each
            picture. By default that of the viewing.

        Returns
        -------
        torch.Tensor
            Without axes, in their precision, float32 of half precision; 0 for equal pictures.

        Raises
        ------
        ValueError, TypeError
            If the pictures cannot be compared or are too small for the octaves.
        """
        check_loss_inputs("VisibilityLoss", image, target)
        as_pictures("image", image, None), as_pictures("target", target, None)
        pictures: dict[str, Any] = {"VisibilityLoss ERROR: image": image, "VisibilityLoss ERROR: target": target}
        check_values(**pictures)
        dtype = torch.promote_types(image.dtype, target.dtype)
        image, target = in_float32(image.to(dtype)), in_float32(target.to(dtype))
        gazes = each_of(self._gaze(gaze, len(image)))
        self._kept.room = len(gazes)
        pairs = zip(parts_of(image, gazes), parts_of(target, gazes), strict=True)
        total = sum(self._compared(one, two, place) for (one, place), (two, _) in pairs)
        return 2 * total / (image.shape[0] * image.shape[-2:].numel())

    def _compared(self, image, target, gaze):
        """Return the sum over the pixels of pictures with one gaze."""
        shown, wanted = (_luminance(srgb_decoded(one.clamp(0, 1)), self.viewing) for one in (image, target))
        mean = wanted.detach().mean((-2, -1), keepdim=True)
        scales = self._sensitivities(image, gaze, mean)
        total = self._visible((shown - wanted) / mean, wanted.detach() / mean, [brightness for brightness, _ in scales])
        if image.shape[1] == 3 and self.colour:
            # Only colours of the cube have a value in Lab.
            one, two = (srgb_to_lab(picture.clamp(0, 1))[:, 1:] for picture in (image, target))
            total = total + self.colour * self._visible(one - two, two.detach(), [colours for _, colours in scales])
        return total

    def _visible(self, difference, mask, scales):
        """Return the sum of squared differences, each in multiples of its threshold."""
        bands = zip(self._bands(difference), self._bands(mask), scales, strict=True)
        total = 0.0
        for level, (band, masking, scale) in enumerate(bands):
            seen = scale * band
            # For the same contrast, the values of a level are twice as large as in the previous level.
            if self.masking and level < len(scales) - 1:
                contrast = scale * masking / 2 ** max(0, level - 1)
                seen = seen / (1 + contrast**2) ** (self.masking / 2)
            total = total + seen.square().sum()
        return total

    def _bands(self, picture):
        pyramid = self.pyramid.construct_pyramid(picture)
        return [pyramid[0]["h"], *(level["b"][0] for level in pyramid[:-1]), pyramid[-1]["l"]]

    def _sensitivities(self, picture, gaze, mean):
        """Return for each band the sensitivity to brightness and to the two colours, over its pixels."""
        levels = tuple(mean.flatten().tolist())
        key = (tuple(picture.shape[-2:]), picture.dtype, picture.device, gaze, self.viewing, levels)

        def made():
            with _torch_private.keeping(), torch.no_grad():
                return self._new_sensitivities(picture, gaze, mean.clone())

        return self._kept.get(key, made)

    def _new_sensitivities(self, picture, gaze, mean):
        rows, columns = picture.shape[-2:]
        pitch = math.degrees(self.real_image_width / columns / self.real_viewing_distance)
        width, height = (2 * math.degrees(math.atan(n * pitch * math.pi / 360)) for n in (columns, rows))
        sizes = [(rows, columns)]
        while len(sizes) < self.pyramid.n_levels:
            sizes.append(tuple(-(-side // 2) for side in sizes[-1]))
        # The residual and the first octave have the full size.
        levels = [(0, RESIDUAL), *((level, BAND) for level in range(self.pyramid.n_levels - 1))]
        levels.append((self.pyramid.n_levels - 1, None))
        found = []
        for level, share in levels:
            view = (gaze, sizes[level], self.real_image_width, self.real_viewing_distance)
            angle, _ = make_eccentricity_distance_maps(*view, dtype=torch.float64, device=picture.device)
            # The residual below the octaves is treated as the lowest frequency of the picture, and as a uniform colour.
            frequency = 1 / (max(rows, columns) * pitch) if share is None else share / 2**level / (2 * pitch)
            scaled = frequency * (1 + torch.rad2deg(angle) / HALVING)
            size = math.sqrt(width * height)
            # Below the peak the scaled curve would rise: sensitivity is nowhere higher than at the gaze.
            at_gaze = sensitivity(torch.full_like(scaled, frequency), mean.double(), size)
            brightness = sensitivity(scaled, mean.double(), size).minimum(at_gaze)
            scaled = 0 * scaled if share is None else scaled
            colours = torch.stack([_kernel(scaled, terms) / JUST_NOTICEABLE for terms in (RED_GREEN, BLUE_YELLOW)])
            found.append((brightness.to(picture), colours.to(picture)))
        return found


def _kernel(frequency, terms):
    """Return the gain of a sum of Gaussians w·exp(−(r/s)²), 1 at zero."""
    total = sum(weight for weight, _ in terms)
    return sum(weight / total * torch.exp(-((math.pi * spread * frequency) ** 2)) for weight, spread in terms)
