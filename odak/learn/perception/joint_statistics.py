"""Statistics of pairs of steerable bands, across channels, orientations, scales and places; texture synthesis."""

import contextlib
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch.nn import functional

from odak import _torch_private, _validate
from odak._torch_private import in_own_precision
from odak._warnings import ConvergenceWarning, warn
from odak.learn._tensors import check_values, floating_tensor
from odak.learn.perception.pyramids import SpatialSteerablePyramid, pad_image_for_pyramid

# Below this squared amplitude neither a deviation nor a phase is resolved.
POWER_FLOOR = 1e-7
# Shifts (rows, columns) to the four neighbours on one side.
NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
# Half of the shifts within 7 x 7 pixels: the other half gives the same values.
TEXTURE_SHIFTS = tuple((i, j) for i in range(4) for j in range(-3, 4) if i > 0 or j > 0)
TEXTURE_ITERATIONS = 300
# Weights in the distance of textures: moments of pixels, few numbers, against bands, many.
PIXEL_WEIGHT = 10.0

# Power of the frequency by which the descent weights changes of a picture, and the frequency in cycles per pixel below
# which it weights them alike.
STEEPNESS, SLOWEST = 0.4, 0.02
# Share of the start's distance, as a root mean square, within which a picture counts as one of the target's statistics.
CONVERGED = 0.1
# Weight of the squared distance from the bounds, relative to the statistics.
OUTSIDE_WEIGHT = 0.1

Pool = Callable[[torch.Tensor], torch.Tensor]


def joint_maps(
    groups: list[torch.Tensor],
    low: list[torch.Tensor],
    pools: Sequence[Pool],
    maker: SpatialSteerablePyramid,
    shifts: Sequence[tuple[int, int]] = NEIGHBOURS,
) -> list[list[torch.Tensor]]:
    """Return the pooled statistics of pairs of bands, for each level that has bands.

    Parameters
    ----------
    groups : list of torch.Tensor
        Bands ``[B, C, K, H, W]`` of each level, fine to coarse.
    low : list of torch.Tensor
        Low-pass ``[B, C, H, W]`` of each level.
    pools : sequence of callable
        Each returns local means of pictures ``[B, N, H, W]`` of its level.
    maker : SpatialSteerablePyramid
        The pyramid of the bands, which makes their quadrature.
    shifts : sequence of tuple of int
        Rows and columns between the neighbours that are compared.

    Returns
    -------
    list of list of torch.Tensor
        For each level tensors ``[B, N, H, W]`` in the unit of the bands, of whichever of these pairs there are:

        - channels: bands of one orientation in two channels;
        - orientations: moduli of the first channel's complex bands at two orientations;
        - neighbours: root of the mean squared difference between a modulus, or the first channel's low-pass, and the
          same at each shift;
        - scales: modulus of a band and of the band at the next coarser level;
        - phases: band, and real and imaginary part of the next coarser complex band with its phase doubled.

    Notes
    -----
    Portilla and Simoncelli, Int. J. Comput. Vis. 40, 49 (2000), section 2; in local regions: Freeman and Simoncelli,
    Nat. Neurosci. 14, 1195 (2011). A pair's covariance is divided by the geometric mean of its two deviations, which
    gives it the unit of a band, as means and deviations have. Pairs of scales and pairs of phases are of one
    orientation.
    """
    kept = list(zip(groups, low, pools, strict=False))
    # Parts of the first channel's complex bands, and their moduli.
    real = [bands[:, 0] for bands, _, _ in kept]
    imaginary = [maker.quadrature(passed[:, :1])[:, 0] for _, passed, _ in kept]
    moduli = [(one**2 + other**2 + POWER_FLOOR).sqrt() for one, other in zip(real, imaginary, strict=True)]
    maps = []
    for level, (bands, passed, pool) in enumerate(kept):
        values, pairs = [bands.flatten(1, 2), moduli[level]], _pairs_within(*bands.shape[1:3])
        if level + 1 < len(kept):
            one, other, modulus = real[level + 1], imaginary[level + 1], moduli[level + 1]
            # The square of a complex number over its modulus has twice its phase.
            coarse = torch.cat([modulus, (one**2 - other**2) / modulus, 2 * one * other / modulus], 1)
            values.append(functional.interpolate(coarse, bands.shape[-2:], mode="bilinear", align_corners=False))
            pairs += _pairs_across(*bands.shape[1:3])
        covariances = _covariances(torch.cat(values, 1), [pair for kind in pairs for pair in kind], pool)
        # The low-pass varies about its mean, so that its size does not enter.
        compared = torch.cat([moduli[level], passed[:, :1]], 1)
        squared = pool(torch.cat([(compared - shifted) ** 2 for shifted in _neighbours(compared, shifts)], 1))
        found = [*covariances.split([len(kind) for kind in pairs], 1), squared.clamp_min(POWER_FLOOR).sqrt()]
        maps.append([one for one in found if one.shape[1]])
    return maps


def _pairs_within(channels, count):
    """Return the pairs of values of a level, as indices of both: across channels, and across orientations.

    Orientation k of channel c is value c·K + k; the moduli follow.
    """
    channel_pairs = [
        (one * count + k, two * count + k)
        for one, two in itertools.combinations(range(channels), 2)
        for k in range(count)
    ]
    moduli = channels * count
    steps = [(moduli + k, moduli + k + step) for step in range(1, count) for k in range(count - step)]
    return [channel_pairs, steps]


def _pairs_across(channels, count):
    """Return the pairs of values of a level and the next coarser one: moduli, and bands with doubled phases."""
    moduli, last = channels * count, (channels + 1) * count
    scales = [(moduli + k, last + k) for k in range(count)]
    phases = [(k, last + part * count + k) for part in (1, 2) for k in range(count)]
    return [scales, phases]


def _covariances(values, pairs, pool):
    """Return the pooled covariances of pairs over their deviations' geometric mean."""
    if not pairs:
        # The last level of a grey picture with one orientation.
        return values[:, :0]
    mean, power = pool(values), pool(values**2)
    # One over the root of each deviation.
    scale = (power - mean**2).clamp_min(POWER_FLOOR).rsqrt().sqrt()
    return (pool(_products(values, pairs)) - _products(mean, pairs)) * _products(scale, pairs)


def _products(values, pairs):
    # Unbound once: the gradient of each slice would be a tensor of zeros as large as all values.
    planes = values.unbind(1)
    return torch.stack([planes[one] * planes[two] for one, two in pairs], 1)


def _neighbours(picture, shifts):
    """Return, for each shift, a picture shifted by rows and columns, its last pixels repeated at the borders."""
    rows, columns = picture.shape[-2:]
    down, along = zip(*shifts, strict=True)
    left, right, top, bottom = max(0, *along), max(0, *(-n for n in along)), max(0, *down), max(0, *(-n for n in down))
    padded = functional.pad(picture, (left, right, top, bottom), mode="replicate")
    return [
        padded[..., top - down : top - down + rows, left - along : left - along + columns] for down, along in shifts
    ]


def texture_statistics(
    picture: torch.Tensor, n_pyramid_levels: int = 5, n_orientations: int = 4
) -> dict[str, torch.Tensor]:
    """Return the statistics by which a texture is described, over the whole of a picture.

    Parameters
    ----------
    picture : torch.Tensor
        Grey or RGB ``[B, C, H, W]``, about 0 … 1. Sides that are no multiples of 2ⁿ, for n levels, are padded by
        reflection.
    n_pyramid_levels : int
        Levels of the pyramid, at least 2; the last holds the low-pass.
    n_orientations : int
        Orientations of the bands.

    Returns
    -------
    dict
        Tensors ``[B, N]``, differentiable: "pixels" (mean, covariance between channels, skewness and kurtosis of each
        channel), "low-pass" (the same of each low-pass, without the mean), "bands" (mean and deviation of the
        high-pass residual and each band), and "pairs", the statistics of pairs of bands, within 7 × 7 pixels.

    Raises
    ------
    ValueError, TypeError
        If the picture is no picture or too small for the levels.

    Notes
    -----
    The statistics of Portilla and Simoncelli, Int. J. Comput. Vis. 40, 49 (2000), and covariances across channels. They
    compare pictures of any sizes.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import texture_statistics
    >>> found = texture_statistics(torch.rand(1, 1, 64, 64), n_pyramid_levels=3, n_orientations=2)
    >>> {name: tuple(values.shape) for name, values in found.items()}
    {'pixels': (1, 4), 'low-pass': (1, 9), 'bands': (1, 10), 'pairs': (1, 152)}
    """
    picture = _checked("picture", picture)
    count = _validate.integer("n_orientations", n_orientations, minimum=1)
    levels = _validate.integer("n_pyramid_levels", n_pyramid_levels, minimum=2)
    maker = SpatialSteerablePyramid(False, picture.shape[1], 9, count, "full", picture.device)
    _check_sides(maker, levels, picture=picture.shape[-2:])
    return _texture_statistics(picture, maker, levels)


def _texture_statistics(picture, maker, levels):
    padded = pad_image_for_pyramid(picture, levels)
    groups, low = maker.stacked_bands(padded, levels)
    pixels = [_mean(picture).flatten(1), *_moments(picture)]
    passed = [one for level in low for one in _moments(level)]
    bands = [value.flatten(1) for group in groups for value in (_mean(group), _deviation(group))]
    pairs = joint_maps(groups[1:], low, [_mean] * (levels - 1), maker, TEXTURE_SHIFTS)
    return {
        "pixels": torch.cat(pixels, 1),
        "low-pass": torch.cat(passed, 1),
        "bands": torch.cat(bands, 1),
        "pairs": torch.cat([one.flatten(1) for level in pairs for one in level], 1),
    }


def _checked(name, picture):
    _validate.shaped(name, floating_tensor(name, picture), "[B, 1 or 3, H, W], none empty")
    pictures: dict[str, Any] = {name: picture}
    check_values(**pictures)
    return picture


def _check_sides(maker, levels, **sizes):
    """Raise ValueError unless pictures of these sizes, padded to multiples of 2ⁿ, are large enough for the levels."""
    largest_refused = (maker._smallest_side(levels) - 1) >> levels << levels
    for name, size in sizes.items():
        if min(size) <= largest_refused:
            raise ValueError(f"{name} must have sides above {largest_refused} for {levels} levels, got {tuple(size)}")


def _mean(values):
    return values.mean((-2, -1), keepdim=True)


def _deviation(values):
    return ((values - _mean(values)) ** 2).mean((-2, -1)).clamp_min(POWER_FLOOR).sqrt()


@in_own_precision
def _covariance(values):
    """Return the covariances of the channels ``[B, C, C]``."""
    flat = (values - _mean(values)).flatten(2)
    return flat @ flat.mT / flat.shape[-1]


def _moments(values):
    """Return covariances between channels, skewness and excess kurtosis of each, all in the unit of the values."""
    covariance, deviation = _covariance(values), _deviation(values)
    upper = torch.triu_indices(values.shape[1], values.shape[1], device=values.device)
    scale = deviation.sqrt()
    between = (covariance / (scale[:, :, None] * scale[:, None]))[:, upper[0], upper[1]]
    relative = (values - _mean(values)) / deviation[..., None, None]
    third, fourth = ((relative**order).mean((-2, -1)) for order in (3, 4))
    # Scaled so that a change of shape has about the weight of a change of the deviation.
    return between, third * deviation / 3, (fourth - 3) * deviation / 12


def synthesize_texture(
    sample: torch.Tensor,
    size: Sequence[int],
    seed: int = 0,
    n_pyramid_levels: int = 5,
    n_orientations: int = 4,
    iterations: int = TEXTURE_ITERATIONS,
    progress: Callable[[], object] | None = None,
) -> torch.Tensor:
    """Return a picture of any size with the texture of a sample.

    Parameters
    ----------
    sample : torch.Tensor
        Grey or RGB ``[B, C, H, W]``, about 0 … 1, the same texture all over.
    size : sequence of int
        Rows and columns of the result, each a multiple of 2ⁿ for n levels.
    seed : int
        Seed of the Gaussian noise that it starts from, which has the sample's mean and covariance of channels.
    n_pyramid_levels : int
        Levels of the pyramid, at least 2: the coarsest bands describe structures of about 2ⁿ pixels.
    n_orientations : int
        Orientations of the bands.
    iterations : int
        Evaluations of the distance between the statistics, which L-BFGS makes smaller.
    progress : callable, optional
        Called without arguments at each evaluation.

    Returns
    -------
    torch.Tensor
        ``[B, C, *size]``, within the range of the sample's values.

    Raises
    ------
    ValueError, TypeError
        If the sample or the size does not fit the pyramid.

    Warns
    -----
    ConvergenceWarning
        If the statistics differ by more than a tenth of what those of the noise differ by.

    Notes
    -----
    Statistics: :func:`texture_statistics`. Portilla and Simoncelli (2000) project onto each in turn; here all descend
    together.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import synthesize_texture
    >>> sand = torch.rand(1, 1, 64, 64, generator=torch.Generator().manual_seed(1))
    >>> synthesize_texture(sand, (32, 96), n_pyramid_levels=3, iterations=40).shape
    torch.Size([1, 1, 32, 96])
    """
    sample = _checked("sample", sample).detach()
    rows, columns = _validate.size("size", size)
    levels = _validate.integer("n_pyramid_levels", n_pyramid_levels, minimum=2)
    count = _validate.integer("n_orientations", n_orientations, minimum=1)
    iterations = _validate.integer("iterations", iterations)
    if rows % (1 << levels) or columns % (1 << levels):
        raise ValueError(f"size must be multiples of {1 << levels} for {levels} levels, got {(rows, columns)}")
    _validate.function_or_none("progress", progress)
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    with _torch_private.keeping(), torch.no_grad():
        sample = sample.clone()
        maker = SpatialSteerablePyramid(False, sample.shape[1], 9, count, "full", sample.device)
        _check_sides(maker, levels, sample=sample.shape[-2:], size=(rows, columns))
        target = _texture_statistics(sample, maker, levels)
        shape = (len(sample), sample.shape[1], rows, columns)
        start = _coloured(torch.randn(shape, dtype=torch.float64, generator=generator).to(sample), sample)
        low, high = sample.amin((-2, -1), keepdim=True), sample.amax((-2, -1), keepdim=True)

        def distance(picture):
            found = _texture_statistics(picture, maker, levels)
            parts = [
                (PIXEL_WEIGHT if name == "pixels" else 1.0) * (found[name] - target[name]).square().mean()
                for name in target
            ]
            return torch.stack(parts).sum()

        def held(picture):
            return picture.maximum(low).minimum(high)

        return descended(start, held, distance, iterations, progress, told=CONVERGED)


@in_own_precision
def _coloured(noise, sample):
    """Return noise with the sample's mean and covariance of channels."""
    values, vectors = torch.linalg.eigh(_covariance(sample.double()))
    root = (vectors * values.clamp_min(0).sqrt()[:, None]) @ vectors.mT
    return (root.to(noise) @ noise.flatten(2)).unflatten(2, noise.shape[-2:]) + _mean(sample)


class _Spent(Exception):
    """All evaluations have been made."""


def descended(
    picture: torch.Tensor,
    held: Callable[[torch.Tensor], torch.Tensor],
    distance: Callable[[torch.Tensor], Any],
    iterations: int,
    progress: Callable[[], object] | None,
    steepness: float = STEEPNESS,
    outside_weight: float = OUTSIDE_WEIGHT,
    told: float = math.inf,
) -> torch.Tensor:
    """Return a picture of the form `held(free)` that lowers a distance, by L-BFGS.

    Parameters
    ----------
    picture : torch.Tensor
        Where the descent starts.
    held : callable
        Brings a picture into its bounds.
    distance : callable
        Returns how far a picture is from the target, differentiable.
    iterations : int
        Evaluations of the distance; 0 returns the start, within its bounds.
    progress : callable or None
        Called without arguments at each evaluation.
    steepness : float
        Power of the frequency by which changes of the picture are weighted; 0 for none.
    outside_weight : float
        Weight of the squared distance from the bounds, relative to the statistics.
    told : float
        Share of the root mean square distance of the start above which the result is told not to have converged.

    Returns
    -------
    torch.Tensor
        In the shape of the start.

    Warns
    -----
    ConvergenceWarning
        If the result is farther from the target than told.

    Notes
    -----
    The variables are the change of the picture with its spectrum divided by a power of the frequency. Bands of low
    frequencies have few samples, each of which counts the more in the mean over a level: without the division a descent
    from noise is steep along them and flat along the others, and takes more than twice as many evaluations.
    """
    if not iterations:
        return held(picture)
    rows, columns = picture.shape[-2:]
    along = (torch.fft.fftfreq(rows)[:, None], torch.fft.rfftfreq(columns))
    weights = (along[0] ** 2 + along[1] ** 2 + SLOWEST**2) ** (steepness / 2)
    weights = weights.to(picture.device, picture.dtype)

    def weighted(values):
        if not steepness:
            return values
        return torch.fft.irfft2(torch.fft.rfft2(values) * weights, (rows, columns))

    with torch.enable_grad():
        start = held(picture).detach()
        change = torch.zeros_like(start, memory_format=torch.contiguous_format).requires_grad_()
        unit = distance(start).detach().clamp_min(torch.finfo(start.dtype).tiny)
        best, least, left = change.detach().clone(), math.inf, iterations
        optimizer = torch.optim.LBFGS(
            [change], max_iter=iterations, max_eval=iterations, tolerance_grad=0, tolerance_change=0,
            history_size=10, line_search_fn="strong_wolfe",
        )  # fmt: skip

        def evaluate():
            nonlocal best, least, left
            if not left:
                raise _Spent
            left -= 1
            free = (start + weighted(change.detach())).requires_grad_()
            inside = held(free)
            # A penalty outside the bounds keeps the gradient from vanishing there.
            value = (distance(inside) + outside_weight * (free - inside).square().mean()) / unit
            # The weighting is symmetric, so that it is its own adjoint; L-BFGS takes contiguous gradients only.
            change.grad = weighted(torch.autograd.grad(value, free)[0]).contiguous()
            value = value.detach()
            if float(value) < least:
                best, least = change.detach().clone(), float(value)
            if progress is not None:
                progress()
            return value

        # The line search does not count evaluations.
        with contextlib.suppress(_Spent):
            optimizer.step(evaluate)
    made = held(start + weighted(best))
    if told < 1 and (apart := math.sqrt(float(distance(made) / unit))) > told:
        warn(
            f"not converged after {iterations} evaluations: the statistics differ by {100 * apart:.2g} % of what the "
            "start's differ by; give more iterations, or a start that is nearer",
            ConvergenceWarning,
        )
    return made
