"""Steps by which metamers are made: displaced or matched pictures, rescaled bands, and bounds of local colours."""

import math
from collections.abc import Sequence

import torch
from torch.nn import functional

from odak import _validate
from odak.learn.perception.color import rgb_2_ycrcb, ycrcb_2_rgb
from odak.learn.perception.foveation import level_weights
from odak.learn.perception.pyramids import SpatialSteerablePyramid, nearest_picture

RMS_FLOOR = 1e-6
# Evaluations of the distance by which a metamer is made.
METAMER_ITERATIONS = 40
# Numbers of evaluations relative to those above if statistics of pairs are matched: first without, then with them.
WITHOUT_PAIRS, WITH_PAIRS = 2, 0.25
# Least number of orientations by which a metamer is made: two cannot tell 45° from 135°.
METAMER_ORIENTATIONS = 4
# Pooling size in pixels below which a metamer is hardly more than the picture itself.
FEW_PIXELS = 3.0
# Displacements by which a metamer starts: their strength as a fraction of the pooling size, and at most as a fraction
# of the distance over which they vary; this distance in pixels of the last low-pass. Displacements that vary slowly
# keep lines and grain. The loss that compares pixels with a metamer keeps the displacements of earlier versions.
WARP, EARLIER_WARP = (0.6, 0.2, 1.5), (0.2, 0.5, 0.25)
# Side in pixels of the squares in which a displaced picture must vary to be changed further, and the deviation at which
# half of a change is made: flat regions stay flat.
DETAIL_SIDE, DETAIL_FLOOR = 9, 0.005
# Variance of flat regions that rounding in float32 can cause.
ROUNDING = 1e-6
# Number of times that the local statistics of the bands are matched to the picture's before the descent, and the
# largest factor by which a deviation is increased at a time.
RESCALINGS, LARGEST_GAIN = 4, 4.0
# Accuracy to which a picture is made of such bands, as a share of its largest value.
TOLERANCE = 1e-2
# Weight of the squared distance from the bounds. Nearly all pixels at sharp edges are at their bounds.
OUTSIDE_WEIGHT = 1e-4
# Bounds of a local gamut: channels of Y′CrCb and their factors, each alone and two at a time. Differences of colour
# vary several times less than brightness.
CHROMA = 4.0
SLABS = tuple(((channel, 1.0 if channel == 0 else CHROMA),) for channel in range(3)) + tuple(
    ((one, 1.0 if one == 0 else CHROMA), (two, sign * CHROMA))
    for one, two in ((0, 1), (0, 2), (1, 2))
    for sign in (1, -1)
)
# Number of final clippings to all bounds in turn: clipping to one bound can violate another; less than 0.001 remains.
CLIPPINGS = 5


def metamer_stages(iterations: int, joint: bool) -> list[tuple[bool, int]]:
    """Return the descents by which a metamer is made: with statistics of pairs or not, and how many evaluations.

    Parameters
    ----------
    iterations : int
        Evaluations of the distance asked for.
    joint : bool
        Whether statistics of pairs are to be matched.

    Returns
    -------
    list of tuple
        One descent of `iterations` without pairs. With `joint` one of twice as many without, and then one of a quarter
        as many with pairs, rounded up.

    Notes
    -----
    An evaluation with pairs takes about six times as long. Where single bands match already, few are needed: less time
    than for `iterations` of them, and a smaller distance.
    """
    if not joint:
        return [(False, iterations)]
    return [(False, WITHOUT_PAIRS * iterations), (True, math.ceil(WITH_PAIRS * iterations))]


def matched_noise(
    image: torch.Tensor, statistics: list[torch.Tensor], maker: SpatialSteerablePyramid, n_levels: int, seed: int = 0
) -> torch.Tensor:
    """Return noise whose pyramid has the pooled statistics of a picture, and the picture's low-pass.

    Parameters
    ----------
    image : torch.Tensor
        ``[B, C, H, W]``, as padded for the pyramid.
    statistics : list of torch.Tensor
        As :func:`statistics_maps` returns them for the picture.
    maker : SpatialSteerablePyramid
        The pyramid that they come from.
    n_levels : int
        Its levels.
    seed : int
        Of the noise, which is one and the same for every picture of a batch.

    Returns
    -------
    torch.Tensor
        ``[B, C, H, W]``.

    Notes
    -----
    Walton et al., ACM Trans. Graph. 40, 48 (2021), section 4.
    """
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    noise = torch.rand(1, *image.shape[1:], dtype=torch.float64, generator=generator).to(image)
    groups, _ = maker._levels(noise, n_levels)
    found = []
    for band in (band for bands in groups for band in bands.unbind(2)):
        mean = band.mean((2, 3), keepdim=True)
        found += [mean, ((band - mean) ** 2).mean((2, 3), keepdim=True).sqrt().clamp_min(RMS_FLOOR)]
    return rescaled(groups, found, statistics, maker)


def displaced(
    image: torch.Tensor, levels: torch.Tensor, cell: int, seed: int = 0, warp: tuple[float, float, float] = WARP
) -> torch.Tensor:
    """Return a picture whose pixels come from random positions nearby, at distances that grow with the pooling regions.

    Parameters
    ----------
    image : torch.Tensor
        ``[B, C, H, W]``, sides multiples of `cell`.
    levels : torch.Tensor
        MIP level of the pooling region of each pixel ``[H, W]``: its size is 2ˡ. At level 0 pixels stay.
    cell : int
        Pixels of the picture in one of the last low-pass, which is compared value by value: the means of the
        displacements over this length are subtracted, interpolated between them.
    seed : int
        Of the displacements, which are one and the same for every picture of a batch.
    warp : tuple of float
        Strength of the displacements as a fraction of the pooling size, its largest value as a fraction of the length
        over which they vary, and this length as a fraction of `cell`.

    Returns
    -------
    torch.Tensor
        ``[B, C, H, W]``.

    Notes
    -----
    The displacements are normally distributed, with independent components along rows and columns. Their deviation is
    0.16 times the pooling size less one pixel, and at most 0.05 times the length over which they vary, so that they
    hardly turn lines and never fold the picture. Displaced edges stay edges: compare Koenderink et al., J. Vis. 17(2):7
    (2017), https://doi.org/10.1167/17.2.7.
    """
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    rows, columns = image.shape[-2:]
    fraction, largest, length = warp
    grain = max(1, round(length * cell))
    # Two more samples on each side than the picture needs: bicubic enlargement reads that far.
    coarse = (1, 2, -(-rows // grain) + 4, -(-columns // grain) + 4)
    noise = torch.randn(coarse, dtype=torch.float64, generator=generator).to(image)
    smooth = functional.interpolate(noise, scale_factor=grain, mode="bicubic", align_corners=False)
    smooth = smooth[..., 2 * grain : 2 * grain + rows, 2 * grain : 2 * grain + columns]
    means = functional.avg_pool2d(smooth, cell)
    smooth = smooth - functional.interpolate(means, (rows, columns), mode="bilinear", align_corners=False)
    strength = (fraction * (2**levels - 1)).clamp(max=largest * grain).to(image)
    across, down = (strength * smooth)[0].unbind(0)
    places = [
        2 * (torch.arange(side, dtype=image.dtype, device=image.device) + 0.5) / side - 1 for side in (columns, rows)
    ]
    grid = torch.stack([places[0] + 2 * across / columns, places[1][:, None] + 2 * down / rows], -1)
    return functional.grid_sample(
        image, grid.expand(len(image), -1, -1, -1), mode="bicubic", padding_mode="reflection", align_corners=False
    )


def detail_share(picture: torch.Tensor) -> torch.Tensor:
    """Return how much of a change is made to each pixel: none where a picture is flat, all where it has detail.

    Parameters
    ----------
    picture : torch.Tensor
        ``[B, C, H, W]``.

    Returns
    -------
    torch.Tensor
        ``[B, 1, H, W]``, v/(v + 0.005²) of the variance v, less 10⁻⁶, within 9 x 9 pixels, summed over the channels.
    """
    values = torch.cat([picture, picture**2], 1)
    means = functional.avg_pool2d(values, DETAIL_SIDE, 1, DETAIL_SIDE // 2, count_include_pad=False)
    mean, power = means.chunk(2, 1)
    variance = (power - mean**2 - ROUNDING).clamp_min(0).sum(1, keepdim=True)
    return variance / (variance + DETAIL_FLOOR**2)


def rescaled(
    groups: list[torch.Tensor],
    found: Sequence[torch.Tensor],
    wanted: Sequence[torch.Tensor],
    maker: SpatialSteerablePyramid,
    largest_gain: float = math.inf,
) -> torch.Tensor:
    """Return the picture of a pyramid after setting the mean and the deviation of its bands to given values.

    Parameters
    ----------
    groups : list of torch.Tensor
        Bands ``[B, C, K, H, W]`` of each level, the high-pass residual in front of the first ones.
    found : sequence of torch.Tensor
        Mean and deviation of each band in turn, for each pixel or for the whole band; further maps are ignored.
    wanted : sequence of torch.Tensor
        As :func:`statistics_maps` returns them: mean and deviation of each band, and the last low-pass.
    maker : SpatialSteerablePyramid
        The pyramid that the bands come from.
    largest_gain : float
        Largest factor by which a deviation is increased.

    Returns
    -------
    torch.Tensor
        ``[B, C, H, W]``. Bands overlap, so that its own statistics are nearer to those wanted, but not equal to them.
    """
    levels: list[torch.Tensor] = []
    place = 0
    for bands in groups:
        scaled = []
        for band in bands.unbind(2):
            gain = (wanted[place + 1] / found[place + 1]).clamp_max(largest_gain)
            scaled.append((band - found[place]) * gain + wanted[place])
            place += 2
        levels.append(torch.stack(scaled, 2))
    return nearest_picture(maker, levels, wanted[place], TOLERANCE)


def local_range(picture: torch.Tensor, levels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the least and the largest value of each channel within a square region around each pixel.

    Parameters
    ----------
    picture : torch.Tensor
        ``[B, C, H, W]``.
    levels : torch.Tensor
        Of a MIP chain ``[H, W]``, in float64: the square reaches half of 2ˡ pixels to each side, and is the pixel
        itself at level 0. Between levels the bounds are interpolated.

    Returns
    -------
    tuple of torch.Tensor
        Lower and upper bounds ``[B, C, H, W]``.
    """
    weights = level_weights(levels).to(picture.dtype)
    bounds = []
    for sign in (-1, 1):
        extreme, reach, total = sign * picture, 0, sign * picture * weights[0]
        for level, weight in enumerate(weights[1:]):
            step = (1 << level) - reach
            reach += step
            # The largest of three shifted copies: the region doubles from level to level.
            for axis in (-1, -2):
                pad = (step, step, 0, 0) if axis == -1 else (0, 0, step, step)
                padded, length = functional.pad(extreme, pad, value=-torch.inf), extreme.shape[axis]
                extreme = extreme.maximum(padded.narrow(axis, 0, length)).maximum(padded.narrow(axis, 2 * step, length))
            total = total + extreme * weight
        bounds.append(sign * total)
    return bounds[0], bounds[1]


class LocalGamut:
    """Convex bounds of the colours that a picture has around each pixel.

    The bounds are on each of Y′, Cr and Cb, and on the sum and the difference of each two of them, colour differences
    counting `CHROMA` times, over the region of :func:`local_range`; and on R, G and B, the same for all pixels. Bounds
    on single channels would admit colours that the picture has nowhere, such as a highlight in the hue of its
    surroundings' most saturated pixel.

    Parameters
    ----------
    picture : torch.Tensor
        Grey or Y′CrCb ``[B, C, H, W]``.
    levels : torch.Tensor
        Of a MIP chain ``[H, W]``, in float64, as for :func:`local_range`.
    least, most : float
        Bounds of R, G and B; not used for a grey picture, whose local bounds are narrower.
    """

    def __init__(self, picture: torch.Tensor, levels: torch.Tensor, least: float, most: float) -> None:
        self.least: float = least
        self.most: float = most
        self._coloured = picture.shape[1] == 3
        self._low, self._high = local_range(self._along(picture), levels)

    def clipped(self, colours: torch.Tensor) -> torch.Tensor:
        """Return colours clipped to each bound in turn, after which they can be slightly outside of others."""
        if not self._coloured:
            return colours.maximum(self._low).minimum(self._high)
        planes, bounds = list(colours.unbind(1)), zip(self._low.unbind(1), self._high.unbind(1), strict=True)
        for terms, (low, high) in zip(SLABS, bounds, strict=True):
            along = _combined(planes, terms)
            change = (along.maximum(low).minimum(high) - along) / sum(factor**2 for _, factor in terms)
            for channel, factor in terms:
                planes[channel] = planes[channel] + factor * change
        return rgb_2_ycrcb(ycrcb_2_rgb(torch.stack(planes, 1)).clamp(self.least, self.most))

    def _along(self, colours):
        if not self._coloured:
            return colours
        return torch.stack([_combined(colours.unbind(1), terms) for terms in SLABS], 1)


def _combined(planes, terms):
    return torch.stack([factor * planes[channel] for channel, factor in terms]).sum(0)
