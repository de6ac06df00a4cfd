"""Visible differences by eccentricity, colour and masking, and how many samples each ring around the gaze needs."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import nn

from odak import _array, _validate
from odak.learn._tensors import as_pictures, check_loss_inputs, check_values, in_float32
from odak.learn.perception.color import srgb_decoded, srgb_to_lab
from odak.learn.perception.csf import sensitivity
from odak.learn.perception.foveation import make_eccentricity_distance_maps
from odak.learn.perception.pyramids import FrequencySteerablePyramid

# Contrast threshold over frequency and eccentricity, T = T₀·exp(α·f·(e + e₂)/e₂): Geisler and Perry, Proc. SPIE 3299,
# 294 (1998).
LEAST_CONTRAST, DECAY, HALVING = 1 / 64, 0.106, 2.3
# Kernels of S-CIELAB, weights and spreads in degrees: Zhang and Wandell, J. Soc. Inf. Disp. 5, 61 (1997).
RED_GREEN, BLUE_YELLOW = ((0.531, 0.0392), (0.330, 0.494)), ((0.488, 0.0536), (0.371, 0.386))
# Just noticeable difference in CIELAB: Mahy, Van Eycken and Oosterlinck, Color Res. Appl. 19, 105 (1994).
JUST_NOTICEABLE = 2.3
# Slope of threshold elevation over the contrast of the mask: Legge and Foley, J. Opt. Soc. Am. 70, 1458 (1980).
MASKING = 0.6
_LUMINANCE = (0.2126, 0.7152, 0.0722)
# Middle of an octave band, as a share of its upper end; and of the high-pass residual.
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
    _validate.real("eccentricity", eccentricity)
    if not isinstance(eccentricity, torch.Tensor):
        eccentricity = torch.tensor(eccentricity, dtype=torch.float64)
    if _array.is_readable(eccentricity) and (eccentricity.detach() < 0).any():
        raise ValueError(f"eccentricity must not be negative, got {float(eccentricity.detach().min())}")
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
    gaze: Sequence[float] = (0.5, 0.5),
    real_image_width: float = 0.2,
    real_viewing_distance: float = 0.7,
    edges: Sequence[float] = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 90.0),
) -> list[BudgetRing]:
    """Return how many samples a renderer has to make in each ring around the gaze.

    Parameters
    ----------
    image_pixel_size : sequence of int
        Rows and columns of the display, whose pixels are square.
    gaze : sequence of float
        (x, y), 0 to 1 from the top-left corner.
    real_image_width : float
        Width of the display.
    real_viewing_distance : float
        Distance of the eye from its centre, in the same unit.
    edges : sequence of float
        Eccentricities between the rings, rising, in degrees.

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
    rows, columns = _validate.size("image_pixel_size", image_pixel_size)
    if not isinstance(edges, (list, tuple)):
        raise TypeError(f"edges must be a sequence of numbers, got {type(edges).__name__}")
    edges = [_validate.constant("edges", edge) for edge in edges]
    if len(edges) < 2 or any(b <= a for a, b in pairwise(edges)):
        raise ValueError(f"edges must be two or more rising eccentricities, got {edges}")
    _validate.number("real_viewing_distance", real_viewing_distance, positive=True)
    view = (_validate.number("real_image_width", real_image_width, positive=True), real_viewing_distance)
    angle, distance = make_eccentricity_distance_maps(gaze, (rows, columns), *view, dtype=torch.float64)
    degrees = torch.rad2deg(angle)
    # Solid angle of a pixel, pitch²·cos/d², in square degrees.
    pitch = real_image_width / columns
    solid = math.degrees(1) ** 2 * pitch**2 * real_viewing_distance / distance**3
    samples = ((2 * highest_frequency(degrees)) ** 2 * solid).clamp(max=1)
    rings = []
    for inner, outer in pairwise(edges):
        inside = (degrees >= inner) & (degrees < outer)
        if inside.any():
            rings.append(BudgetRing(inner, outer, int(inside.sum()), float(samples[inside].sum())))
    return rings


class VisibilityLoss(nn.Module):
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

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Brightness: Barten's contrast sensitivity, its frequencies scaled by (e + e₂)/e₂ with e₂ = 2.3°, the law of Geisler
    and Perry (1998) and :func:`highest_frequency`, and never more than at the gaze. Colour: differences of a* and b*
    filtered by the kernels of S-CIELAB (Zhang and Wandell 1997), scaled alike, over a just noticeable difference of
    2.3. Masking: a difference of c thresholds on a mask of m thresholds counts as c/(1 + m²)^(s/2), the slope s = 0.6
    that of Legge and Foley (1980).
    Octaves are those of :class:`FrequencySteerablePyramid`, whose energies add up; pictures count as periodic.
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

    def __init__(
        self,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        peak_luminance: float = 100.0,
        black_luminance: float = 0.1,
        n_levels: int = 5,
        colour: float = 1.0,
        masking: float = MASKING,
    ) -> None:
        super().__init__()
        self.real_image_width = _validate.constant("real_image_width", real_image_width, positive=True)
        self.real_viewing_distance = float(
            _validate.number("real_viewing_distance", real_viewing_distance, positive=True)
        )
        self.peak_luminance = _validate.constant("peak_luminance", peak_luminance, positive=True)
        self.black_luminance = _validate.constant("black_luminance", black_luminance, positive=True)
        if self.black_luminance >= self.peak_luminance:
            raise ValueError(f"black_luminance must be less than the peak {peak_luminance}, got {black_luminance}")
        self.colour, self.masking = (
            _validate.constant("colour", colour),
            _validate.constant("masking", masking),
        )
        if self.colour < 0 or not 0 <= self.masking <= 1:
            raise ValueError(f"colour must not be negative and masking be 0 to 1, got {colour} and {masking}")
        self.pyramid = FrequencySteerablePyramid(_validate.integer("n_levels", n_levels, minimum=2), 1)
        self._kept: Any = None

    def forward(self, image: torch.Tensor, target: torch.Tensor, gaze: Sequence[float] = (0.5, 0.5)) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            sRGB or grey pictures ``[B, C, H, W]`` of one shape, about 0 … 1. The target sets adaptation and masking,
            through which it gets no gradient.
        gaze : sequence of float
            (x, y), 0 to 1 from the top-left corner; it may lie outside the picture.

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
        shown, wanted = self._luminance(image), self._luminance(target)
        mean = wanted.detach().mean((-2, -1), keepdim=True)
        scales = self._sensitivities(image, gaze, mean)
        total = self._visible((shown - wanted) / mean, wanted.detach() / mean, [brightness for brightness, _ in scales])
        if image.shape[1] == 3 and self.colour:
            # Colours of the cube alone have a Lab value.
            one, two = (srgb_to_lab(picture.clamp(0, 1))[:, 1:] for picture in (image, target))
            total = total + self.colour * self._visible(one - two, two.detach(), [colours for _, colours in scales])
        return 2 * total / (image.shape[0] * image.shape[-2:].numel())

    def _luminance(self, picture):
        light = srgb_decoded(picture.clamp(0, 1))
        if picture.shape[1] == 3:
            light = sum(weight * channel for weight, channel in zip(_LUMINANCE, light.split(1, 1), strict=True))
        return self.black_luminance + (self.peak_luminance - self.black_luminance) * light

    def _visible(self, difference, mask, scales):
        """Return the sum of squared differences, each in multiples of its threshold."""
        bands = zip(self._bands(difference), self._bands(mask), scales, strict=True)
        total = 0.0
        for level, (band, masking, scale) in enumerate(bands):
            seen = scale * band
            # Each level's numbers are twice as large for one contrast as those of the level before.
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
        gaze = tuple(float(value) for value in _validate.several("gaze", gaze, 2))
        key = (tuple(picture.shape[-2:]), picture.dtype, picture.device, gaze, tuple(mean.flatten().tolist()))
        if self._kept is None or self._kept[0] != key:
            with torch.inference_mode(False), torch.no_grad():
                self._kept = (key, self._new_sensitivities(picture, gaze, mean.clone()))
        return self._kept[1]

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
            # What is left below the octaves counts as the lowest frequency of the picture, and as a uniform colour.
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
