"""Measures of image quality: PSNR, SSIM, MS-SSIM, FLIP and PU21 metrics, reports by eccentricity, and contrast.

CVVDP, FVVDP and LPIPS are computed by the packages of their authors. The first two have been compared with cvvdp 0.5.7
and pyfvvdp 1.2.2 on a pair of pictures; LPIPS with a stand-in for its network, whose weights it downloads.
ImageQuality takes any measure of pyiqa.
"""

import contextlib
import importlib
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import nn

from odak import _validate, _warnings
from odak._torch_private import in_own_precision
from odak.learn._tensors import as_pictures, checked_device, checked_pair, real_tensor
from odak.learn.perception.color import (
    BT709_PRIMARIES,
    IEC_WHITE,
    TO_LAB,
    _rgb_to_xyz_rows,
    constant,
    cube_root,
    mix,
    root,
    rows,
    srgb_decoded,
)
from odak.learn.perception.foveation import make_eccentricity_distance_maps
from odak.learn.perception.hdr import PU21_LIMITS, PU21_PARAMETERS, pu21_encode
from odak.learn.perception.sight import Gaze, Kept, Viewing, checked_viewing, each_of, gaze_at, gaze_of, geometry
from odak.learn.tools import loss
from odak.learn.tools.loss import psnr

WINDOW, SIGMA = 11, 1.5
# What pictures for models of vision hold.
ENCODINGS = ("sRGB", "luminance")
_DENSEST = 1000
K1, K2 = 0.01, 0.03
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
# Perceptually uniform value that stands for white of 100 cd/m².
PU21_WHITE = 256.0
# From linear intensities to XYZ relative to white, and to the linear opponent space whose white is (100, 0, 0).
_FLIP_RELATIVE = _rgb_to_xyz_rows(BT709_PRIMARIES, IEC_WHITE)
_FLIP_RELATIVE = _FLIP_RELATIVE / _FLIP_RELATIVE.sum(1, keepdims=True)
_FLIP_OPPONENT = np.array(TO_LAB) @ _FLIP_RELATIVE
# Amplitudes and squared widths of the contrast sensitivities of luminance, red–green and blue–yellow.
_FLIP_CSF = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))


class PSNR(nn.Module):
    """Peak signal-to-noise ratio in decibels: the larger, the closer.

    Examples
    --------
    An error of 0.1 everywhere is 20 dB below the peak:

    >>> import torch
    >>> from odak.learn.perception import PSNR
    >>> target = torch.zeros(1, 1, 8, 8)
    >>> round(PSNR()(target + 0.1, target).item(), 3)
    20.0
    """

    def forward(
        self, predictions: torch.Tensor, targets: torch.Tensor, peak_value: float = 1.0, reduction: str = "pooled"
    ) -> torch.Tensor:
        """Return 10·log₁₀(peak²/MSE); see :func:`odak.learn.tools.psnr`.

        Parameters
        ----------
        predictions, targets : torch.Tensor
            Pictures of one shape.
        peak_value : float
            Largest value that a picture could have.
        reduction : {"pooled", "mean", "none"}
            The ratio of the mean squared error of a whole batch; the mean of the ratios of its pictures; or one for
            each.

        Returns
        -------
        torch.Tensor
            Decibels, without axes but with "none"; infinite for equal pictures.

        Raises
        ------
        ValueError
            If the shapes differ, the peak is not positive, or values are NaN or far outside 0 … peak.
        """
        _validate.number("peak_value", peak_value, positive=True)
        return psnr(*checked_pair(predictions, targets, peak_value), peak_value, reduction)


class SSIM(nn.Module):
    """Structural similarity: 1 for equal pictures.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import SSIM
    >>> picture = torch.linspace(0, 1, 400).reshape(1, 1, 20, 20)
    >>> SSIM()(picture, picture).item()
    1.0
    """

    def forward(self, predictions: torch.Tensor, targets: torch.Tensor, data_range: float = 1.0) -> torch.Tensor:
        """Return the structural similarity; see :func:`structural_similarity`.

        Parameters
        ----------
        predictions : torch.Tensor
            Images ``[B, C, H, W]`` under test.
        targets : torch.Tensor
            Reference images of the same shape.
        data_range : float
            Difference between the largest and the smallest possible value, default 1.0.
        """
        return structural_similarity(predictions, targets, data_range)


class MSSSIM(nn.Module):
    """Structural similarity at five scales: 1 for equal pictures.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import MSSSIM
    >>> picture = torch.linspace(0, 1, 176**2).reshape(1, 1, 176, 176)
    >>> MSSSIM()(picture, picture).item()
    1.0
    """

    def forward(self, predictions: torch.Tensor, targets: torch.Tensor, data_range: float = 1.0) -> torch.Tensor:
        """Return the multi-scale structural similarity; see :func:`multi_scale_structural_similarity`.

        Parameters
        ----------
        predictions : torch.Tensor
            Images ``[B, C, H, W]`` under test.
        targets : torch.Tensor
            Reference images of the same shape.
        data_range : float
            Difference between the largest and the smallest possible value, default 1.0.
        """
        return multi_scale_structural_similarity(predictions, targets, data_range)


def structural_similarity(predictions: torch.Tensor, targets: torch.Tensor, data_range: float = 1.0) -> torch.Tensor:
    """Return the mean structural similarity of pictures.

    Parameters
    ----------
    predictions : torch.Tensor
        Pictures ``[..., H, W]``, each side at least 11.
    targets : torch.Tensor
        Pictures of the same shape that they are compared with.
    data_range : float
        Largest value that a picture could have, less the smallest.

    Returns
    -------
    torch.Tensor
        Mean over every place where the window fits and over the leading axes, without axes, in the input's precision,
        float32 of half precision; exactly 1 for equal pictures. Differentiable.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ, a picture is smaller than the window, or it does not hold real floats of about
        0 … `data_range`.

    Notes
    -----
    Wang, Bovik, Sheikh and Simoncelli, IEEE Trans. Image Process. 13, 600 (2004): Gaussian window of 11 × 11 with
    σ = 1.5, K₁ = 0.01, K₂ = 0.03.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import structural_similarity
    >>> picture = torch.linspace(0, 1, 400).reshape(1, 20, 20)
    >>> structural_similarity(picture, picture).item()
    1.0
    """
    predictions, targets = _checked(predictions, targets, WINDOW, data_range)
    luminance, structure = similarity_terms(_planes(predictions), _planes(targets), data_range)
    return (luminance * structure).mean()


def multi_scale_structural_similarity(
    predictions: torch.Tensor, targets: torch.Tensor, data_range: float = 1.0
) -> torch.Tensor:
    """Return the mean multi-scale structural similarity of pictures.

    Parameters
    ----------
    predictions : torch.Tensor
        Pictures ``[..., H, W]``, each side at least 176.
    targets : torch.Tensor
        Pictures of the same shape that they are compared with.
    data_range : float
        Largest value that a picture could have, less the smallest.

    Returns
    -------
    torch.Tensor
        Mean over the leading axes, without axes, in the input's precision, float32 of half precision. A channel of
        which a scale's structure is negative on average scores 0, with a gradient of zero. Differentiable.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ, a picture is smaller than 176, or it does not hold real floats of about
        0 … `data_range`.

    Notes
    -----
    Wang, Simoncelli and Bovik, Asilomar Conf. Signals Syst. Comput. 37, 1398 (2003), eq. 7 with the weights of its
    section 3.2; halved between scales by 2 × 2 means. Of each channel, then the mean: equal to piq
    0.8 to rounding where the sides stay even down to the last scale. torchmetrics 1.9 averages over channels before the
    product and treats borders otherwise, with differences of some 1e-5.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import multi_scale_structural_similarity
    >>> picture = torch.linspace(0, 1, 176**2).reshape(1, 176, 176)
    >>> multi_scale_structural_similarity(picture, picture).item()
    1.0
    """
    predictions, targets = _checked(predictions, targets, WINDOW << (len(SCALE_WEIGHTS) - 1), data_range)
    one, two = _planes(predictions), _planes(targets)
    result = torch.ones(len(one), dtype=one.dtype, device=one.device)
    for scale, weight in enumerate(SCALE_WEIGHTS):
        luminance, structure = similarity_terms(one, two, data_range)
        last = scale == len(SCALE_WEIGHTS) - 1
        mean = (luminance * structure if last else structure).mean((-3, -2, -1))
        result = result * _positive_power(mean, weight)
        if not last:
            one, two = (nn.functional.avg_pool2d(planes, 2) for planes in (one, two))
    return result.mean()


def flip(
    predictions: torch.Tensor,
    targets: torch.Tensor,
    pixels_per_degree: float = 67.02,
    *,
    viewing: Viewing | None = None,
) -> torch.Tensor:
    """Return the map of visible differences when two pictures alternate at one place (FLIP).

    Parameters
    ----------
    predictions : torch.Tensor
        sRGB pictures ``[..., 3, H, W]``, 0 … 1.
    targets : torch.Tensor
        Pictures of the same shape that they are compared with.
    pixels_per_degree : float
        Pixels in one degree of visual angle; by default for a display 0.7 m wide with 3840 pixels, seen from
        0.7 m.
    viewing : Viewing, optional
        Geometry, in which pictures fill the display, instead of that number.

    Returns
    -------
    torch.Tensor
        ``[..., 1, H, W]``, four axes for three, float32 of half precision: 0 where nothing differs, at most about 1.
        Differentiable; the gradient between equal pictures is 0.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ, the pictures do not have three channels of real floats of about 0 … 1, or the number of
        pixels per degree is not positive.

    Notes
    -----
    Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, Proc. ACM Comput. Graph. Interact. Tech. 3, 15
    (2020): opponent channels filtered by contrast sensitivity, their distance in L*a*b* with Hunt's effect, raised by
    differences of edges and points.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import flip
    >>> picture = torch.full((1, 3, 16, 16), 0.5)
    >>> flip(picture, picture).max().item()
    0.0
    """
    predictions, targets = checked_pair(predictions, targets)
    as_pictures("predictions", predictions)
    seen = None if viewing is None else checked_viewing(viewing).density(predictions.shape[-1])
    density = _density(pixels_per_degree if seen is None else seen)
    pair = torch.stack([as_pictures(*named) for named in (("predictions", predictions), ("targets", targets))])
    light = srgb_decoded(pair.flatten(0, -4).clamp(0, 1))
    opponent = mix(rows(_FLIP_OPPONENT), light, offset=(-16.0, 0.0, 0.0))
    filtered = _filtered_by_sensitivity(opponent, density)
    seen = _hunt_lab(mix(rows(np.linalg.inv(_FLIP_OPPONENT)), filtered, offset=(16 / 116,) * 3).clamp(0, 1))
    color = _redistributed(_hyab(*seen.chunk(2)))
    levels = ((opponent[:, :1] + 16) / 116).chunk(2)
    feature = _feature_difference(levels[0], levels[1], density)
    return _positive_power(color, 1 - feature).reshape(*pair.shape[1:-3], 1, *pair.shape[-2:])


class FLIP(nn.Module):
    """Mean visible difference when two pictures alternate at one place: 0 for equal pictures, at most about 1.

    Parameters
    ----------
    pixels_per_degree : float
        Pixels in one degree of visual angle.
    viewing : Viewing, optional
        Geometry, in which pictures fill the display, instead of that number.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import FLIP
    >>> white, black = torch.ones(1, 3, 16, 16), torch.zeros(1, 3, 16, 16)
    >>> FLIP()(white, white).item(), FLIP()(white, black).item() > 0.9
    (0.0, True)
    """

    def __init__(self, pixels_per_degree: float = 67.02, *, viewing: Viewing | None = None) -> None:
        super().__init__()
        self.pixels_per_degree: float = _density(pixels_per_degree)
        self.viewing: Viewing | None = None if viewing is None else checked_viewing(viewing)

    def forward(self, predictions: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Return the mean of :func:`flip` over all pixels.

        Parameters
        ----------
        predictions : torch.Tensor
            Images ``[B, C, H, W]`` under test.
        targets : torch.Tensor
            Reference images of the same shape.
        """
        return flip(predictions, targets, self.pixels_per_degree, viewing=self.viewing).mean()


class _OnUniformValues(nn.Module):
    """Common base of the measures of high-dynamic-range pictures: the curve that encodes them."""

    def __init__(self, variant: str = "banding_glare") -> None:
        super().__init__()
        self.variant: str = _validate.one_of("variant", variant, PU21_PARAMETERS)

    def _encoded(self, predictions, targets) -> tuple[torch.Tensor, torch.Tensor]:
        one, two = checked_pair(predictions, targets, PU21_LIMITS[1])
        return pu21_encode(one, self.variant), pu21_encode(two, self.variant)


class PU21PSNR(_OnUniformValues):
    """Peak signal-to-noise ratio of high-dynamic-range pictures in decibels, on perceptually uniform values.

    Parameters
    ----------
    variant : {"banding_glare", "banding", "peaks", "peaks_glare"}
        Curve of :func:`pu21_encode`.

    Notes
    -----
    Mantiuk and Azimi, Picture Coding Symposium (2021). The peak is 256, the value of white of 100 cd/m², so that the
    result is comparable with the PSNR of ordinary pictures.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import PU21PSNR
    >>> picture = torch.full((1, 3, 8, 8), 100.0)
    >>> PU21PSNR()(picture, picture).item()
    inf
    """

    def forward(self, predictions: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Return the peak signal-to-noise ratio of PU21-encoded images in decibels, a scalar tensor.

        Parameters
        ----------
        predictions : torch.Tensor
            Images under test, absolute luminance in cd/m².
        targets : torch.Tensor
            Reference images of the same shape, absolute luminance in cd/m².
        """
        return psnr(*self._encoded(predictions, targets), PU21_WHITE)


class PU21SSIM(_OnUniformValues):
    """Structural similarity of high-dynamic-range pictures, on perceptually uniform values; 1 for equal pictures.

    Parameters
    ----------
    variant : {"banding_glare", "banding", "peaks", "peaks_glare"}
        Curve of :func:`pu21_encode`.

    Notes
    -----
    Mantiuk and Azimi, Picture Coding Symposium (2021), with a data range of 256.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import PU21SSIM
    >>> picture = torch.linspace(1, 1000, 400).reshape(1, 1, 20, 20)
    >>> round(PU21SSIM()(picture, picture).item(), 6)
    1.0
    """

    def forward(self, predictions: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Return the structural similarity of PU21-encoded images, a scalar tensor.

        Parameters
        ----------
        predictions : torch.Tensor
            Images under test, absolute luminance in cd/m².
        targets : torch.Tensor
            Reference images of the same shape, absolute luminance in cd/m².
        """
        return structural_similarity(*self._encoded(predictions, targets), PU21_WHITE)


def _density(pixels_per_degree) -> float:
    """Return pixels per degree, within what displays have and filters of a bearable size."""
    density = _validate.constant("pixels_per_degree", pixels_per_degree, positive=True)
    if not 1 <= density <= _DENSEST:
        remedy = f": pixels per radian are divided by {180 / math.pi:.3f}" if density > _DENSEST else ""
        raise ValueError(f"pixels_per_degree must be 1 to {_DENSEST}, got {density:g}{remedy}")
    return density


def _filtered_by_sensitivity(opponent, density):
    """Return opponent channels filtered by the contrast sensitivity of each: sums of two Gaussians."""
    reach = math.ceil(3 * math.sqrt(max(b for *_, b in _FLIP_CSF[2]) / (2 * math.pi**2)) * density)
    offsets = torch.arange(-reach, reach + 1, dtype=torch.float64)
    square = (offsets / density) ** 2
    square = square + square[:, None]
    kernels = torch.stack(
        [
            sum(a * math.sqrt(math.pi / b) * torch.exp(-(math.pi**2) * square / b) for a, b in pairs)
            for pairs in _FLIP_CSF
        ]
    )
    return _filtered(opponent, kernels / kernels.sum((1, 2), keepdim=True))


@in_own_precision
def _filtered(pictures, kernels):
    """Return channels each correlated with a kernel of its own, borders repeated."""
    padded = nn.functional.pad(pictures, (kernels.shape[-1] // 2,) * 4, mode="replicate")
    return nn.functional.conv2d(padded, kernels[:, None].to(pictures), groups=len(kernels))


def _hunt_lab(rgb):
    """Return L*a*b* of linear RGB, a* and b* times L*/100 (Hunt's effect)."""
    x, y, z = cube_root(mix(rows(_FLIP_RELATIVE), rgb)).unbind(-3)
    lightness = 116 * y - 16
    return torch.stack([lightness, 5 * lightness * (x - y), 2 * lightness * (y - z)], -3)


def _hyab(one, two):
    """Return the difference of lightness plus the distance in a* and b* ``[N, 1, H, W]``."""
    difference = one - two
    return difference[:, :1].abs() + root(difference[:, 1:].square().sum(1, keepdim=True))


def _redistributed(distance):
    """Return differences of colour mapped to 0 … 1, most of which is used for those that are not extreme."""
    corners = constant(((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), distance.dtype, distance.device)[:, :, None, None]
    largest = _hyab(*_hunt_lab(corners).chunk(2)).reshape(()) ** 0.7
    power = _positive_power(distance, 0.7)
    knee = 0.4 * largest
    return torch.where(power < knee, 0.95 / knee * power, 0.95 + 0.05 * (power - knee) / (largest - knee))


def _feature_difference(one, two, density):
    """Return the larger of the differences of edges and of points, to the power of ½ ``[N, 1, H, W]``."""
    deviation = 0.5 * 0.082 * density
    offsets = torch.arange(-math.ceil(3 * deviation), math.ceil(3 * deviation) + 1, dtype=torch.float64)
    gauss = torch.exp(-(offsets**2 + offsets[:, None] ** 2) / (2 * deviation**2))
    # Two pictures along two directions are channels of one correlation, which a GPU computes in single precision,
    # forward and back; of a channel alone it rounds the factors to 10 bits.
    stacked, differences = torch.cat([one, two, one, two], 1), []
    for profile in (-offsets, offsets**2 / deviation**2 - 1):
        kernel = profile * gauss
        # Positive and negative taps have sums of 1 and −1.
        kernel = kernel / torch.where(kernel > 0, kernel.clamp_min(0).sum(), -kernel.clamp_max(0).sum())
        across, down = _filtered(stacked, torch.stack([kernel, kernel, kernel.T, kernel.T])).chunk(2, 1)
        pair = root(across**2 + down**2)
        differences.append((pair[:, :1] - pair[:, 1:]).abs())
    return root(torch.maximum(*differences) / math.sqrt(2))


def _checked(predictions, targets, smallest, data_range):
    _validate.number("data_range", data_range, positive=True)
    pair = checked_pair(predictions, targets, data_range)
    if predictions.ndim < 2 or min(predictions.shape[-2:]) < smallest:
        raise ValueError(
            f"predictions and targets must be pictures [..., H, W] of at least {smallest} x {smallest}, "
            f"{_validate.in_order('predictions', predictions.shape)}"
        )
    return pair


def _planes(pictures):
    return pictures.reshape(-1, 1, *pictures.shape[-2:])


def similarity_terms(
    one: torch.Tensor, two: torch.Tensor, data_range: float | torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the luminance term and the contrast–structure term of SSIM, where the window fits.

    2ab/(a² + b²) = 1 − (a − b)²/(a² + b²), likewise with variances: four windowed means instead of five, and no
    digits lost where pictures are close.
    """
    # Products, which overflow to infinity where a power would raise an error.
    c1, c2 = (k * data_range * k * data_range for k in (K1, K2))
    difference = one - two
    maps = torch.cat([one, difference, one**2 + two**2, difference**2])
    mean_one, mean_difference, power, power_difference = _windowed(maps).chunk(4)
    mean_two = mean_one - mean_difference
    level = mean_one**2 + mean_two**2
    luminance = 1 - mean_difference**2 / (level + c1)
    # Rounding must not make a variance negative.
    variances = (power - level).clamp_min(0)
    variance_of_difference = (power_difference - mean_difference**2).clamp_min(0)
    return luminance, 1 - variance_of_difference / (variances + c2)


@in_own_precision
def _windowed(planes):
    """Return Gaussian-weighted means of planes ``[N, 1, H, W]``, where the window fits."""
    axis = torch.arange(WINDOW, dtype=torch.float64, device=planes.device) - WINDOW // 2
    line = torch.exp(-(axis**2) / (2 * SIGMA**2))
    line = (line / line.sum()).to(planes.dtype)
    # As channels of one picture, over which libraries vectorise: side by side in memory, which halves the time. In
    # single precision one window is then as fast as two lines; in double precision, for which libraries have no such
    # kernels, it takes many times as long.
    count, double = len(planes), planes.dtype == torch.float64
    channels = planes.transpose(0, 1)
    if planes.device.type == "cpu" and not double:
        channels = channels.permute(0, 2, 3, 1).contiguous().permute(0, 3, 1, 2)
    for taps in (line[:, None], line[None]) if double else (line[:, None] * line,):
        channels = nn.functional.conv2d(channels, taps.expand(count, 1, *taps.shape), groups=count)
    return channels.transpose(0, 1)


def _positive_power(value, exponent):
    """Return value^exponent, 0 with a gradient of 0 where the value is not positive."""
    # NaN stays NaN.
    none = value <= 0
    return torch.where(none, 0.0, torch.where(none, 1.0, value) ** exponent)


DEFAULT_EDGES = (0.0, 2.5, 5.0, 10.0, 20.0, 40.0)


@dataclass(frozen=True)
class Ring:
    """Quality between two eccentricities.

    Attributes
    ----------
    inner : float
        Lower limit of the eccentricity in degrees, which belongs to the ring.
    outer : float
        Upper limit in degrees.
    pixels : int
        Pixels of a picture in the ring.
    psnr : torch.Tensor
        Peak signal-to-noise ratio in decibels, without axes, over all pictures and channels; not a number where the
        ring holds no pixel.
    ssim : torch.Tensor
        Structural similarity, without axes; not a number where no window fits. The window reaches 5 pixels beyond the
        ring.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import eccentricity_report
    >>> target = torch.zeros(1, 64, 64)
    >>> report = eccentricity_report(target + 0.1, target, edges=(0, 2, 12))
    >>> ring = report.rings[0]
    >>> ring.inner, ring.outer, round(ring.psnr.item(), 3)
    (0.0, 2.0, 20.0)
    """

    inner: float
    outer: float
    pixels: int
    psnr: torch.Tensor
    ssim: torch.Tensor


@dataclass(frozen=True)
class EccentricityReport:
    """Image quality by eccentricity, from the inner ring to the outer one; ``str`` gives a table.

    Attributes
    ----------
    rings : tuple of Ring
        The rings.
    conditions : str
        Size, gaze and geometry of viewing in words.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import eccentricity_report
    >>> target = torch.zeros(1, 64, 64)
    >>> report = eccentricity_report(target + 0.1, target, edges=(0, 2, 12))
    >>> len(report.rings)
    2
    """

    rings: tuple[Ring, ...]
    conditions: str

    def __str__(self) -> str:
        lines = [self.conditions, "degrees        pixels  PSNR [dB]    SSIM"]
        lines += [
            f"{ring.inner:5.1f} … {ring.outer:5.1f} {ring.pixels:8d} {float(ring.psnr.detach()):10.2f} "
            f"{float(ring.ssim.detach()):7.4f}"
            for ring in self.rings
        ]
        return "\n".join(lines)


def eccentricity_report(
    predictions: torch.Tensor,
    targets: torch.Tensor,
    gaze: Gaze | None = None,
    edges: Sequence[float] = DEFAULT_EDGES,
    real_image_width: float = 0.2,
    real_viewing_distance: float = 0.7,
    data_range: float = 1.0,
    *,
    viewing: Viewing | None = None,
) -> EccentricityReport:
    """Return PSNR and SSIM of pictures by rings around the gaze.

    Parameters
    ----------
    predictions : torch.Tensor
        Pictures ``[..., H, W]``, each side at least 11.
    targets : torch.Tensor
        Pictures of the same shape that they are compared with.
    gaze : sequence of float, optional
        Where the viewer looks, (x, y) from the top left corner (0, 0) to the bottom right one (1, 1); may lie off the
        picture. Or ``[B, 2]``, one for each picture of a batch. By default the middle, or that of the viewing.
    edges : sequence of float
        Rising eccentricities in degrees; ring i lies between edge i and the next.
    real_image_width : float
        Width of the flat picture.
    real_viewing_distance : float
        Distance of the eye in front of the picture's middle, in the same unit.
    data_range : float
        Largest value that a picture could have, less the smallest.
    viewing : Viewing, optional
        Geometry and, without `gaze`, gaze, instead of the two lengths.

    Returns
    -------
    EccentricityReport
        One ring for each pair of edges. PSNR and SSIM are differentiable in the pictures.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ, a picture is smaller than SSIM's window, or an argument is outside its range.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import eccentricity_report
    >>> target = torch.zeros(1, 64, 64)
    >>> worse_outside = target + 0.1 * (torch.linspace(-1, 1, 64).abs() > 0.5)
    >>> report = eccentricity_report(worse_outside, target, edges=(0, 2, 12))
    >>> [round(ring.psnr.item(), 1) for ring in report.rings]
    [inf, 22.8]
    """
    predictions, targets = _checked(predictions, targets, WINDOW, data_range)
    size, gaze = tuple(predictions.shape[-2:]), _gaze_of(viewing, gaze, predictions)
    lengths = _validate.constants(real_image_width=real_image_width, real_viewing_distance=real_viewing_distance)
    view = geometry(viewing, *lengths)
    masks, several = ring_masks(size, gaze, edges, *view, device=predictions.device), len(each_of(gaze)) > 1
    luminance, structure = similarity_terms(_planes(predictions), _planes(targets), data_range)
    similarity = luminance * structure
    border = WINDOW // 2
    rings = []
    for mask, inner, outer in zip(masks, edges[:-1], edges[1:], strict=True):
        # The pixels of a ring in each picture, and with channels.
        shape = (len(mask), *[1] * (predictions.ndim - 3), *size) if several else size
        inside = mask.reshape(shape).expand(predictions.shape)
        values = psnr(predictions[inside], targets[inside], data_range)
        seen = _planes(inside)[..., border:-border, border:-border]
        pixels = round(int(mask.sum()) / (len(mask) if several else 1))
        rings.append(Ring(float(inner), float(outer), pixels, values, similarity[seen].mean()))
    places = " and ".join(f"({x:g}, {y:g})" for x, y in each_of(gaze)[:: max(1, len(each_of(gaze)) - 1)])
    conditions = f"{size[0]} x {size[1]} pixels, gaze {places}, width {view[0]:g} at {view[1]:g}"
    return EccentricityReport(tuple(rings), conditions)


def _gaze_of(viewing, gaze, pictures=None):
    """Return the gaze that is given, that of a viewing, or the middle."""
    found = gaze_at(viewing, gaze)
    return gaze_of("gaze", (0.5, 0.5) if found is None else found, None if pictures is None else len(pictures))


def ring_masks(
    size: Sequence[int],
    gaze: Gaze | None = None,
    edges: Sequence[float] = DEFAULT_EDGES,
    real_image_width: float = 0.2,
    real_viewing_distance: float = 0.7,
    *,
    viewing: Viewing | None = None,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return which pixels lie between eccentricities.

    Parameters
    ----------
    size : sequence of int
        Rows and columns.
    gaze : sequence of float, optional
        (x, y) from the top-left corner (0, 0) to the bottom-right one (1, 1); may lie off the picture. Or ``[B, 2]``.
        By default the middle, or that of the viewing.
    edges : sequence of float
        Rising eccentricities in degrees; ring i lies between edge i and the next.
    real_image_width : float
        Width of the flat picture.
    real_viewing_distance : float
        Distance of the eye in front of the picture's middle, in the same unit.
    viewing : Viewing, optional
        Geometry and, without `gaze`, gaze, instead of the two lengths.
    device : torch.device or str, optional
        Device of the result; the CPU by default.

    Returns
    -------
    torch.Tensor
        Booleans ``[len(edges) − 1, H, W]``, of gazes ``[len(edges) − 1, B, H, W]``; no pixel is in two rings.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> from odak.learn.perception import ring_masks
    >>> masks = ring_masks([32, 32], edges=(0, 2, 5))
    >>> tuple(masks.shape), bool((masks[0] & masks[1]).any())
    ((2, 32, 32), False)
    """
    width, distance = _validate.constants(
        real_image_width=real_image_width, real_viewing_distance=real_viewing_distance
    )
    gaze, view = _gaze_of(viewing, gaze), geometry(viewing, width, distance)
    size = _validate.size("size", size)
    limits = _validate.inside("edges", _validate.few("edges", edges, rising=True), least=0)
    eccentricity, _ = make_eccentricity_distance_maps(gaze, size, *view, dtype=torch.float64, device=device)
    device = eccentricity.device
    bounds = torch.tensor([math.radians(limit) for limit in limits], dtype=torch.float64, device=device)
    places = torch.bucketize(eccentricity, bounds, right=True) - 1
    return torch.stack([places == index for index in range(len(limits) - 1)])


_ALMOST_BLACK = 1e-12
_PIXELS_AT_ONCE = 1 << 22


def weber_contrast(image: torch.Tensor, roi_high: Sequence[int], roi_low: Sequence[int]) -> torch.Tensor:
    """Return Weber's contrast (H − L)/L of the mean values H and L in two regions.

    Parameters
    ----------
    image : torch.Tensor
        ``[H, W]``, ``[C, H, W]`` or ``[B, C, H, W]``.
    roi_high : sequence of int
        Region of H, ``[first row, last row + 1, first column, last column + 1]``.
    roi_low : sequence of int
        Region of L, in the same form.

    Returns
    -------
    torch.Tensor
        ``[C]``, or ``[B, C]`` when there are several images; negative where the regions are swapped.

    Raises
    ------
    ValueError, TypeError
        If a region is empty or leaves the image, the image has other axes, or L is not positive.

    See Also
    --------
    odak.learn.tools.weber_contrast : The same without the check of L, for losses.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import weber_contrast
    >>> image = torch.tensor([[3.0, 1.0]])
    >>> weber_contrast(image, [0, 1, 0, 1], [0, 1, 1, 2]).item()
    2.0
    """
    _require_positive("roi_low", loss.region_means(image, roi_high, roi_low)[1])
    return loss.weber_contrast(image, roi_high, roi_low)


def michelson_contrast(image: torch.Tensor, roi_high: Sequence[int], roi_low: Sequence[int]) -> torch.Tensor:
    """Return Michelson's contrast (H − L)/(H + L) of the mean values H and L in two regions.

    Parameters
    ----------
    image : torch.Tensor
        ``[H, W]``, ``[C, H, W]`` or ``[B, C, H, W]``.
    roi_high : sequence of int
        Region of H, ``[first row, last row + 1, first column, last column + 1]``.
    roi_low : sequence of int
        Region of L, in the same form.

    Returns
    -------
    torch.Tensor
        ``[C]``, or ``[B, C]`` when there are several images; negative where the regions are swapped.

    Raises
    ------
    ValueError, TypeError
        If a region is empty or leaves the image, the image has other axes, or H + L is not positive.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import michelson_contrast
    >>> image = torch.tensor([[3.0, 1.0]])
    >>> michelson_contrast(image, [0, 1, 0, 1], [0, 1, 1, 2]).item()
    0.5
    """
    _require_positive("roi_high and roi_low", sum(loss.region_means(image, roi_high, roi_low)))
    return loss.michelson_contrast(image, roi_high, roi_low)


def content_aware_contrast_ratio(
    image: torch.Tensor,
    window_size: int = 15,
    step: int = 3,
    pooling_percentile: float = 75.0,
    eps: float = 1e-6,
    max_iter: int = 100,
    lightness_channel: int = 0,
) -> dict[Any, Any] | list[dict[Any, Any]]:
    """Return the contrast of dark and bright pixels in each window of a picture, and its pooled value.

    Parameters
    ----------
    image : torch.Tensor
        ``[H, W]``, ``[B, H, W]`` or ``[B, C, H, W]``; held to 0 … 1. Three axes whose first is above 100 are refused.
    window_size : int
        Side of a window, odd, at least 3.
    step : int
        Distance between windows.
    pooling_percentile : float
        The windows whose contrast is at least this percentile are pooled.
    eps : float
        A window's threshold is found when it changes by no more than this.
    max_iter : int
        Largest number of iterations of the threshold.
    lightness_channel : int
        Which channel of ``[B, C, H, W]`` is the lightness.

    Returns
    -------
    dict or list of dict
        One per picture (the dictionary itself for a single one): ``contrast_map``, ``threshold_map``,
        ``foreground_mean_map`` and ``background_mean_map`` ``[H, W]``, zero except at the windows' centres;
        ``pooled_harmonic_mean`` and ``max_contrast_ratio``; ``window_size``, ``step`` and ``n_patches``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Each window is split at the threshold that is the mean of the means on its two sides (ISODATA; Ridler and Calvard,
    IEEE Trans. Syst. Man Cybern. 8, 630 (1978)); its contrast is 1 − dark/bright. They are pooled by the
    harmonic mean.

    Examples
    --------
    The contrast of 0.25 and 0.5 is 1 − 0.25/0.5:

    >>> import torch
    >>> from odak.learn.perception import content_aware_contrast_ratio
    >>> picture = torch.full((31, 31), 0.25)
    >>> picture[:, 16:] = 0.5
    >>> round(content_aware_contrast_ratio(picture)["max_contrast_ratio"], 4)
    0.5
    """
    pooling_percentile, eps = _validate.constants(pooling_percentile=pooling_percentile, eps=eps)
    pictures = _lightness(image, lightness_channel)
    _validate.number("eps", eps, least=0)
    side = _validate.integer("window_size", window_size, minimum=3)
    step = _validate.integer("step", step, minimum=1)
    max_iter = _validate.integer("max_iter", max_iter, minimum=1)
    if side % 2 == 0 or side > min(pictures.shape[-2:]):
        raise ValueError(f"window_size must be odd and fit the picture {tuple(pictures.shape[-2:])}, got {side}")
    _validate.number("pooling_percentile", pooling_percentile, positive=True, most=100)
    results = []
    for picture in pictures:
        windows = picture.unfold(0, side, step).unfold(1, side, step)
        # As many rows of windows at once as fit in memory.
        strips = windows.split(max(1, _PIXELS_AT_ONCE // windows[0].numel()))
        parts = [_split(strip.flatten(-2), eps, max_iter) for strip in strips]
        maps = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
        results.append(
            {name: _at_centres(values, picture, side, step) for name, values in maps.items()}
            | _pooled(maps["contrast_map"].flatten(), pooling_percentile)
            | {"window_size": side, "step": step, "n_patches": maps["contrast_map"].numel()}
        )
    return results[0] if len(results) == 1 else results


def _require_positive(names, value):
    if bool((value <= 0).any()):
        raise ValueError(f"{names} must have a positive mean, got {value.min().item():.6g}")


def _lightness(image, channel) -> torch.Tensor:
    """Return pictures ``[B, H, W]`` of 0 … 1."""
    channel = _validate.integer("lightness_channel", channel)
    real_tensor("image", image)
    if image.ndim == 3 and len(image) > 100:
        raise ValueError(
            f"image must be [H, W], [B, H, W] with B of at most 100, or [B, C, H, W]; got {list(image.shape)}"
        )
    _validate.shaped("image", image, "[H, W], [B, H, W] or [B, C, H, W], none empty")
    if image.ndim == 4:
        if not 0 <= channel < image.shape[1]:
            raise ValueError(f"lightness_channel must be from 0 to {image.shape[1] - 1}, got {channel}")
        image = image[:, channel]
    # Half precision would lose the sums of windows.
    image = image if image.dtype in (torch.float32, torch.float64) else image.float()
    _validate.real("image", image)
    return image.reshape(-1, *image.shape[-2:]).clamp(0, 1)


def _split(windows, eps, max_iter) -> dict[str, torch.Tensor]:
    """Return contrast, threshold and the means on its two sides of windows ``[rows, columns, pixels]``."""
    ordered, threshold = windows.sort(-1).values, windows.mean(-1)
    sums = torch.nn.functional.pad(ordered.cumsum(-1, dtype=torch.float64), (1, 0))
    for _ in range(max_iter):
        dark, bright = _means_beside_threshold(ordered, sums, threshold)
        moved, threshold = threshold, (dark + bright) / 2
        if bool(((threshold - moved).abs() <= eps).all()):
            break
    dark, bright = _means_beside_threshold(ordered, sums, threshold)
    contrast = torch.where(bright > _ALMOST_BLACK, 1 - dark / bright.clamp_min(_ALMOST_BLACK), 0).clamp_min(0)
    return {
        "contrast_map": contrast,
        "threshold_map": threshold,
        "foreground_mean_map": dark,
        "background_mean_map": bright,
    }


def _means_beside_threshold(ordered, sums, threshold):
    """Return the means of the pixels below a threshold and of those from it on; the threshold where there are none.

    The pixels of a window come in ascending order, with the sums of the first 0, 1, … of them.
    """
    below = torch.searchsorted(ordered, threshold[..., None].detach())
    dark = sums.gather(-1, below)[..., 0]
    means = []
    for count, light in ((below[..., 0], dark), (ordered.shape[-1] - below[..., 0], sums[..., -1] - dark)):
        mean = (light / count.clamp_min(1)).to(ordered.dtype)
        means.append(torch.where(count > 0, mean, threshold))
    return means


def _at_centres(values, picture, side, step):
    result = torch.zeros_like(picture)
    rows, columns = ((count - 1) * step + 1 for count in values.shape)
    first = side // 2
    result[first : first + rows : step, first : first + columns : step] = values
    return result


def _pooled(contrast, percentile) -> dict[str, float]:
    # Of the sorted values, because torch.quantile refuses more than 16 million.
    ordered = contrast.sort().values
    place = percentile / 100 * (len(ordered) - 1)
    low = ordered[int(place)]
    bound = low + (ordered[min(int(place) + 1, len(ordered) - 1)] - low) * (place - int(place))
    kept = contrast[contrast >= bound]
    pooled = 0.0 if bool((kept <= 0).any()) else (len(kept) / (1 / kept).sum()).item()
    return {"pooled_harmonic_mean": pooled, "max_contrast_ratio": contrast.max().item()}


class _Wrapper(nn.Module):
    """A metric of another package; `available` says whether that is installed."""

    _module = _package = ""

    def __init__(self, required: bool):
        super().__init__()
        required = _validate.flag("required", required)
        try:
            self._import()
            self.available = True
        except ImportError as error:
            message = f"{type(self).__name__} needs the package {self._package} ({error}): pip install {self._package}"
            if required:
                raise ImportError(message) from error
            _warnings.warn(f"{message}. Until then it cannot be called.", _warnings.MissingPackageWarning)
            self.available = False
            self._message = message

    def _require(self):
        """Raise ImportError where the package is missing."""
        if not self.available:
            raise ImportError(self._message)

    def _import(self):
        with _quietly():
            return importlib.import_module(self._module)


class _DifferencePredictor(_Wrapper):
    """Quality on a display, one picture or video after the other so that they cannot influence others."""

    _photometry = _geometry = ""

    def __init__(
        self,
        device: torch.device = torch.device("cpu"),  # noqa: B008
        *,
        viewing: Viewing | None = None,
        encoding: str = "sRGB",
        required: bool = False,
    ):
        super().__init__(required)
        self.device = checked_device("device", device)
        self.viewing = None if viewing is None else checked_viewing(viewing)
        self.encoding = _validate.one_of("encoding", encoding, ENCODINGS)
        if viewing is None and self.encoding != ENCODINGS[0]:
            raise ValueError(f"viewing must be given for pictures in {self.encoding}, got None")
        self._predictors = Kept()
        setattr(self, self._name, self._predictor((2160, 3840)) if self.available else None)

    @property
    def _name(self):
        return type(self).__name__.lower()

    def _predictor(self, size):
        """Return the measure of the package for pictures of some rows and columns."""
        if self.viewing is None:
            # Of the package, whatever the size of the pictures.
            return self._predictors.get(None, partial(self._made, display_name="standard_4k"))
        return self._predictors.get((self.viewing, size), partial(self._made_for, size))

    def _made(self, **display):
        with _quietly():
            measure = getattr(self._import(), self._name)
            return measure(quiet=True, device=self.device, **display)

    def _made_for(self, size):
        view, package = self.viewing, self._import()
        photometry, geometry = getattr(package, self._photometry), getattr(package, self._geometry)
        contrast = view.peak_luminance / view.black_luminance
        return self._made(
            display_photometry=photometry(
                view.peak_luminance,
                contrast,
                EOTF="sRGB" if self.encoding == ENCODINGS[0] else "linear",
                E_ambient=view.ambient_light,
                k_refl=view.reflectivity,
            ),
            display_geometry=geometry(
                size[::-1], distance_m=view.real_viewing_distance, fov_horizontal=view.field_of_view
            ),
        )

    def _gazes(self, predictions, gaze):
        """Return the arguments of the measure about the gaze, for each picture or video of a batch."""
        if gaze is not None:
            raise ValueError(f"{type(self).__name__} has no fovea, so that gaze must be None, got {gaze!r:.80}")
        return [{}] * len(predictions)

    def forward(
        self,
        predictions: torch.Tensor,
        targets: torch.Tensor,
        dim_order: str = "BCHW",
        frames_per_second: float | None = None,
        gaze: Gaze | None = None,
    ) -> torch.Tensor:
        """Return the mean quality of pictures or videos.

        Parameters
        ----------
        predictions, targets : torch.Tensor
            Pictures ``[B, C, H, W]`` or ``[C, H, W]``, or videos of F frames ``[B, C, F, H, W]``, of one or three
            channels: sRGB values of 0 … 1, or cd/m² with the encoding "luminance".
        dim_order : str
            Order of the axes of pictures that have four, and of videos; of the latter "BCFHW" by default.
        frames_per_second : float, optional
            Rate of the frames of videos, which determines how visible flicker and motion are; required for videos.
        gaze : sequence of float, optional
            Where a foveated measure takes the eye to look: (x, y), 0 to 1 from the top-left corner, or ``[B, 2]`` for
            pictures and ``[F, 2]`` for the frames of videos. By default that of the viewing.

        Returns
        -------
        torch.Tensor
            Just-objectionable differences (JOD) without axes, float32: 10 for equal pictures, less for worse ones.
            Differentiable.

        Raises
        ------
        ValueError, TypeError
            If the shapes differ, there are not three to five axes and one or three channels, or the rate is missing
            for a video, not positive, or given for pictures.
        ImportError
            If the package is missing.
        """
        white = 1.0 if self.encoding == ENCODINGS[0] else PU21_LIMITS[1]
        predictions, targets = checked_pair(predictions, targets, white)
        _validate.instance("dim_order", dim_order, str, "a string")
        if predictions.ndim == 5:
            if frames_per_second is None:
                raise ValueError("frames_per_second must be given for videos, which have five axes")
            rate = _validate.number("frames_per_second", frames_per_second, positive=True)
            axes, options = "BCFHW", {"frames_per_second": rate}
            dim_order = axes if dim_order == "BCHW" else dim_order
        elif frames_per_second is not None:
            raise ValueError(f"frames_per_second is for videos of five axes, got {tuple(predictions.shape)}")
        else:
            axes, options = "BCHW", {}
        predictions, targets = (_as_batch(value, dim_order, axes).float() for value in (predictions, targets))
        self._require()
        gazes, predictor = self._gazes(predictions, gaze), self._predictor(tuple(predictions.shape[-2:]))
        with _quietly():
            scores = [
                predictor.predict(one[None], two[None], dim_order=axes, **options, **fixed)[0].reshape(())
                for one, two, fixed in zip(predictions, targets, gazes, strict=True)
            ]
        return torch.stack(scores).mean()


class CVVDP(_DifferencePredictor):
    """ColorVideoVDP: visual difference of pictures or videos in colour, in JOD; a quality, larger is better.

    Mantiuk, Hanji, Ashraf, Asano and Chapiro, ACM Trans. Graph. 43, 129 (2024).

    Parameters
    ----------
    device : torch.device
        Where the comparison runs.
    viewing : Viewing, optional
        Geometry and luminances of the display, which pictures fill. By default the package's "standard_4k", of 75
        pixels per degree and 200 cd/m² in a room of 250 lux.
    encoding : {"sRGB", "luminance"}
        What pictures hold: sRGB values, or light in cd/m² with the primaries of sRGB, such as pictures of high dynamic
        range; the latter with a viewing, whose peak is the brightest.
    required : bool
        Raise when the package is missing. Otherwise a :class:`~odak.MissingPackageWarning` says so, and calls raise.

    Attributes
    ----------
    available : bool
        Whether the package is there.
    cvvdp : pycvvdp.cvvdp or None
        The metric.

    Raises
    ------
    ImportError
        If the package is missing and required, or called for; the message states what to install.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import CVVDP
    >>> measure, picture = CVVDP(), torch.rand(1, 3, 64, 64)  # doctest: +SKIP
    >>> measure(picture, picture).item()  # doctest: +SKIP
    10.0

    Of a video that flickers, at 30 frames per second:

    >>> video = torch.full((1, 3, 12, 64, 64), 0.5)  # doctest: +SKIP
    >>> flickering = video.clone()  # doctest: +SKIP
    >>> flickering[:, :, ::2] += 0.02  # doctest: +SKIP
    >>> measure(flickering, video, frames_per_second=30.0).item() < 10  # doctest: +SKIP
    True
    """

    _module, _package = "pycvvdp", "cvvdp"
    _photometry, _geometry = "vvdp_display_photo_eotf", "vvdp_display_geometry"


class FVVDP(_DifferencePredictor):
    """FovVideoVDP: visual difference of pictures or videos in luminance, in JOD; a quality, larger is better.

    With a viewing it is foveated: differences count the less the farther they are from the gaze. Without one the eye
    looks everywhere.

    Mantiuk et al., ACM Trans. Graph. 40, 49 (2021).

    Parameters
    ----------
    device : torch.device
        Where the comparison runs.
    viewing : Viewing, optional
        Geometry and luminances of the display, which pictures fill, and gaze. By default the package's "standard_4k",
        of 75 pixels per degree and 200 cd/m² in a room of 250 lux.
    encoding : {"sRGB", "luminance"}
        What pictures hold: sRGB values, or light in cd/m² with the primaries of sRGB, such as pictures of high dynamic
        range; the latter with a viewing, whose peak is the brightest.
    required : bool
        Raise when the package is missing. Otherwise a :class:`~odak.MissingPackageWarning` says so, and calls raise.

    Attributes
    ----------
    available : bool
        Whether the package is there.
    fvvdp : pyfvvdp.fvvdp or None
        The metric.

    Raises
    ------
    ImportError
        If the package is missing and required, or called for; the message states what to install.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import FVVDP
    >>> measure, picture = FVVDP(), torch.rand(1, 3, 64, 64)  # doctest: +SKIP
    >>> measure(picture, picture).item()  # doctest: +SKIP
    10.0
    """

    _module, _package = "pyfvvdp", "pyfvvdp"
    _photometry, _geometry = "fvvdp_display_photo_eotf", "fvvdp_display_geometry"

    def _made(self, **display):
        foveated = {} if self.viewing is None else {"foveated": True}
        return super()._made(heatmap="none", **foveated, **display)

    def _gazes(self, predictions, gaze):
        if self.viewing is None:
            return super()._gazes(predictions, gaze)
        rows, columns = predictions.shape[-2:]
        video = predictions.ndim == 5
        found = self.viewing.gaze if gaze is None else gaze
        track = each_of(gaze_of("gaze", found, predictions.shape[2] if video else len(predictions)))
        # In pixels, the middle of the first of which is 0.
        places = torch.tensor(track, dtype=torch.float32) * torch.tensor([columns, rows]) - 0.5
        if video or len(places) == 1:
            return [{"fixation_point": places if len(places) > 1 else places[0]}] * len(predictions)
        return [{"fixation_point": place} for place in places]


class LPIPS(_Wrapper):
    """Learned perceptual image patch similarity with SqueezeNet: a distance, 0 for equal pictures.

    Zhang, Isola, Efros, Shechtman and Wang, CVPR (2018). torchvision fetches SqueezeNet's weights when the first
    pictures are compared; neither the import nor the constructor uses the network.

    Parameters
    ----------
    required : bool
        Raise when the package is missing. Otherwise a :class:`~odak.MissingPackageWarning` says so, and calls raise.

    Attributes
    ----------
    available : bool
        Whether the package is there.
    lpips : lpips.LPIPS or None
        The network, once it has been used; its weights are frozen.

    Raises
    ------
    ImportError
        If the package is missing and required, or called for; the message states what to install.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import LPIPS
    >>> measure, picture = LPIPS(), torch.rand(1, 3, 64, 64)  # doctest: +SKIP
    >>> measure(picture, picture).item()  # doctest: +SKIP
    0.0
    """

    _module = _package = "lpips"

    def __init__(self, *, required: bool = False):
        super().__init__(required)
        self.lpips: nn.Module | None = None

    def forward(self, predictions: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Return the mean distance of pictures.

        Parameters
        ----------
        predictions, targets : torch.Tensor
            Pictures ``[B, C, H, W]`` or ``[C, H, W]`` of one or three channels, 0 … 1; values outside are clipped.

        Returns
        -------
        torch.Tensor
            Distance without axes, float32. Differentiable.

        Raises
        ------
        ValueError, TypeError
            If the shapes differ, or there are not three or four axes and one or three channels.
        ImportError
            If the package is missing.
        """
        pictures = [_as_batch(value).float() for value in checked_pair(predictions, targets)]
        self._require()
        # The network was trained on −1 … 1.
        pictures = [(2 * picture - 1).clamp(-1, 1).expand(-1, 3, -1, -1) for picture in pictures]
        return self._network(pictures[0].device)(*pictures).mean()

    def _network(self, device):
        if self.lpips is None:
            with _quietly():
                self.lpips = self._import().LPIPS(net="squeeze", verbose=False).requires_grad_(False)
        return self.lpips.to(device)


class ImageQuality(_Wrapper):
    """Any measure of quality of the package pyiqa by its name, such as "dists", "vif", "topiq_fr" or "niqe".

    Parameters
    ----------
    name : str
        Name of the measure: one of ``pyiqa.list_models()`` that judges single pictures, hence not "fid".
    required : bool
        Raise when the package is missing. Otherwise a :class:`~odak.MissingPackageWarning` says so, and calls raise.

    Attributes
    ----------
    available : bool
        Whether the package is there.
    measure : torch.nn.Module or None
        The measure of pyiqa, with frozen weights, which pyiqa fetches when this object is made.
    lower_is_better : bool or None
        Whether less is better; None without the package.
    takes_reference : bool or None
        Whether pictures are compared with others; None without the package.

    Raises
    ------
    ValueError, TypeError
        If the name is not one of pyiqa's.
    ImportError
        If the package is missing and required, or called for; the message states what to install.

    Notes
    -----
    Chen and Mo, https://github.com/chaofengc/IQA-PyTorch, with a licence for other than commercial use. Run with pyiqa
    0.1.16: of 8-bit pictures, "psnr" agrees with :class:`PSNR` to 2e-5 dB and "ssimc" with :class:`SSIM` to 1e-5;
    "ssim" and "ms_ssim" are of the luminance alone. "gmsd", "vsi", "fsim" and "vif" gave values and gradients. Measures
    that fetch weights, such as "dists", were not run.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import ImageQuality
    >>> measure, picture = ImageQuality("dists"), torch.rand(1, 3, 64, 64)  # doctest: +SKIP
    >>> measure.lower_is_better, measure(picture, picture).item() < 1e-5  # doctest: +SKIP
    (True, True)
    """

    _module = _package = "pyiqa"

    def __init__(self, name: str, *, required: bool = False):
        super().__init__(required)
        self.name = name
        _validate.instance("name", name, str, "a string")
        self.measure: Any = None
        self.lower_is_better: bool | None = None
        self.takes_reference: bool | None = None
        if self.available:
            pyiqa = self._import()
            names = [one for one in pyiqa.list_models() if "fid" not in one and one != "inception_score"]
            name = _validate.one_of("name", name, names)
            with _quietly():
                # As a loss, so that it is differentiable.
                self.measure = pyiqa.create_metric(name, as_loss=True, loss_reduction="none", device="cpu")
            self.measure.requires_grad_(False)
            self.lower_is_better, self.takes_reference = self.measure.lower_better, self.measure.metric_mode == "FR"

    def extra_repr(self) -> str:
        """Return the name of the measure."""
        return repr(self.name)

    def forward(
        self, predictions: torch.Tensor, targets: torch.Tensor | None = None, reduction: str = "mean"
    ) -> torch.Tensor:
        """Return the quality of pictures.

        Parameters
        ----------
        predictions : torch.Tensor
            Pictures ``[B, C, H, W]`` or ``[C, H, W]`` of one or three channels, 0 … 1.
        targets : torch.Tensor, optional
            Pictures of the same shape that they are compared with; required where `takes_reference` is true.
        reduction : {"mean", "none"}
            The mean over the batch, or one value for each picture.

        Returns
        -------
        torch.Tensor
            float32 without axes, or ``[B]``; differentiable where the measure of pyiqa is.

        Raises
        ------
        ValueError, TypeError
            If the shapes differ, there are not three or four axes and one or three channels, values are far outside
            0 … 1, or the pictures to compare with are missing or not wanted.
        ImportError
            If the package is missing.
        """
        reduction = _validate.one_of("reduction", reduction, ("mean", "none"))
        pair = checked_pair(predictions, predictions if targets is None else targets)
        batch = [_as_batch(value).float().clamp(0, 1) for value in pair]
        self._require()
        if (targets is not None) != self.takes_reference:
            wanted = "must be given for" if targets is None else "are not taken by"
            raise ValueError(f"targets {wanted} the measure {self.name!r}")
        with _quietly():
            scores = self.measure.to(batch[0].device)(*batch[: 1 + bool(self.takes_reference)])
        scores = scores.reshape(len(batch[0])).float()
        return scores.mean() if reduction == "mean" else scores


@contextlib.contextmanager
def _quietly():
    """Suppress the deprecation warnings of other packages."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _as_batch(pictures, dim_order="BCHW", axes="BCHW"):
    """Return pictures or videos with their axes in the order `axes`, C being 1 or 3."""
    if pictures.ndim not in (3, len(axes)):
        raise ValueError(f"predictions and targets must have three or four axes, got {tuple(pictures.shape)}")
    if pictures.ndim == 3:
        batch = pictures[None]
    elif sorted(dim_order) != sorted(axes):
        raise ValueError(f"dim_order must name the axes {', '.join(axes)} once each, got {dim_order!r}")
    else:
        batch = pictures.permute(*(dim_order.index(axis) for axis in axes))
    if batch.shape[1] not in (1, 3):
        got = _validate.in_order("predictions", batch.shape)
        raise ValueError(f"predictions and targets must have one or three channels, {got}")
    return batch
