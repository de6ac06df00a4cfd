"""Statistics of pairs of steerable bands, across channels, orientations, scales and places; textures made from them."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch.nn import functional

from odak import _validate
from odak.learn.perception.color_matrices import as_pictures
from odak.learn.perception.pyramids import SpatialSteerablePyramid, pad_image_for_pyramid
from odak.learn.perception.util import check_values

# Below this squared amplitude neither a deviation nor a phase is resolved.
POWER_FLOOR = 1e-7
# Shifts (rows, columns) to the four neighbours on one side.
NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
# Half of the shifts within 7 x 7 pixels: the other half gives the same numbers.
TEXTURE_SHIFTS = tuple((i, j) for i in range(4) for j in range(-3, 4) if i > 0 or j > 0)
TEXTURE_ITERATIONS = 300
# Weights in the distance of textures: moments of pixels, few numbers, against bands, many.
PIXEL_WEIGHT = 10.0

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
    gives it the unit of a band, as means and deviations have. Scales and phases are those of one orientation.
    """
    complex_bands = [
        torch.complex(bands[:, 0].contiguous(), maker.quadrature(level[:, :1])[:, 0].contiguous())
        for bands, level in zip(groups, low, strict=False)
    ]
    return [
        _level_maps(groups, low, complex_bands, level, pool, shifts)
        for level, pool in zip(range(len(groups)), pools, strict=False)
    ]


def _level_maps(groups, low, complex_bands, level, pool, shifts):
    bands, here = groups[level], complex_bands[level]
    channels, count = bands.shape[1:3]
    modulus = _modulus(here)
    # Channel c of orientation k is value c·K + k, the moduli follow.
    values, start = [bands.flatten(1, 2), modulus], channels * count
    kinds = [
        [
            (one * count + k, two * count + k)
            for one in range(channels)
            for two in range(one + 1, channels)
            for k in range(count)
        ],
        [(start + one, start + two) for one in range(count) for two in range(one + 1, count)],
    ]
    if level + 1 < len(groups):
        coarse = complex_bands[level + 1]
        doubled = coarse * coarse / _modulus(coarse)
        parts = torch.cat([_modulus(coarse), doubled.real, doubled.imag], 1)
        values.append(functional.interpolate(parts, bands.shape[-2:], mode="bilinear", align_corners=False))
        first = start + count
        kinds.append([(start + k, first + k) for k in range(count)])
        kinds.append([(k, first + part * count + k) for part in (1, 2) for k in range(count)])
    # The low-pass varies about its mean, so that its size does not enter.
    compared = torch.cat([modulus, low[level][:, :1]], 1)
    differences = [(compared - _shifted(compared, shift)) ** 2 for shift in shifts]
    pairs = [pair for kind in kinds for pair in kind]
    pooled = _correlated(torch.cat(values, 1), pairs, differences, pool)
    found = pooled.split([len(kind) for kind in kinds] + [compared.shape[1] * len(shifts)], 1)
    return [one for one in found if one.shape[1]]


def _correlated(values, pairs, differences, pool):
    """Return the pooled covariances of pairs over their deviations' geometric mean, and roots of pooled differences."""
    one, two = (torch.tensor([pair[side] for pair in pairs], device=values.device) for side in (0, 1))
    count = values.shape[1]
    pooled = pool(torch.cat([values, values**2, values[:, one] * values[:, two], *differences], 1))
    mean, power, product, squared = pooled.split([count, count, len(pairs), sum(d.shape[1] for d in differences)], 1)
    deviation = (power - mean**2).clamp_min(POWER_FLOOR).sqrt()
    covariance = product - mean[:, one] * mean[:, two]
    scale = (deviation[:, one] * deviation[:, two]).sqrt()
    return torch.cat([covariance / scale, squared.clamp_min(POWER_FLOOR).sqrt()], 1)


def _modulus(values):
    return (values.real**2 + values.imag**2 + POWER_FLOOR).sqrt()


def _shifted(picture, shift):
    """Return a picture shifted by rows and columns, its last pixels repeated at the borders."""
    down, right = shift
    pads = (max(right, 0), max(-right, 0), max(down, 0), max(-down, 0))
    padded = functional.pad(picture, pads, mode="replicate")
    rows, columns = picture.shape[-2:]
    return padded[..., max(-down, 0) : max(-down, 0) + rows, max(-right, 0) : max(-right, 0) + columns]


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
    Those of Portilla and Simoncelli, Int. J. Comput. Vis. 40, 49 (2000), and covariances across channels. They compare
    pictures of any sizes.

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
    if as_pictures(name, picture, None).ndim != 4 or picture.shape[1] not in (1, 3) or not picture.numel():
        raise ValueError(f"{name} must be [B, C, H, W] of one or three channels, got {tuple(picture.shape)}")
    pictures: dict[str, Any] = {name: picture}
    check_values(**pictures)
    return picture


def _mean(values):
    return values.mean((-2, -1), keepdim=True)


def _deviation(values):
    return ((values - _mean(values)) ** 2).mean((-2, -1)).clamp_min(POWER_FLOOR).sqrt()


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
    # Scaled so that a change of shape counts about as much as one of the deviation.
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
    """Return a picture of any size whose texture is that of a sample.

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

    Notes
    -----
    Statistics: :func:`texture_statistics`. Portilla and Simoncelli (2000) project onto each in turn; here all descend
    together.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import synthesize_texture
    >>> stripes = torch.linspace(0, 50, 64).sin().expand(1, 1, 64, 64) / 2 + 0.5
    >>> synthesize_texture(stripes, (32, 96), n_pyramid_levels=3, iterations=5).shape
    torch.Size([1, 1, 32, 96])
    """
    sample = _checked("sample", sample).detach()
    rows, columns = _validate.size("size", size)
    levels = _validate.integer("n_pyramid_levels", n_pyramid_levels, minimum=2)
    count = _validate.integer("n_orientations", n_orientations, minimum=1)
    iterations = _validate.integer("iterations", iterations)
    if rows % (1 << levels) or columns % (1 << levels):
        raise ValueError(f"size must be multiples of {1 << levels} for {levels} levels, got {(rows, columns)}")
    if progress is not None and not callable(progress):
        raise TypeError(f"progress must be callable, got {type(progress).__name__}")
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    with torch.inference_mode(False), torch.no_grad():
        sample = sample.clone()
        maker = SpatialSteerablePyramid(False, sample.shape[1], 9, count, "full", sample.device)
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

        return descended(start, lambda picture: picture.maximum(low).minimum(high), distance, iterations, progress)


def _coloured(noise, sample):
    """Return noise with the sample's mean and covariance of channels."""
    values, vectors = torch.linalg.eigh(_covariance(sample.double()))
    root = (vectors * values.clamp_min(0).sqrt()[:, None]) @ vectors.mT
    return (root.to(noise) @ noise.flatten(2)).unflatten(2, noise.shape[-2:]) + _mean(sample)


def descended(
    picture: torch.Tensor,
    held: Callable[[torch.Tensor], torch.Tensor],
    distance: Callable[[torch.Tensor], Any],
    iterations: int,
    progress: Callable[[], object] | None,
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

    Returns
    -------
    torch.Tensor
        In the shape of the start.
    """
    if not iterations:
        return held(picture)
    with torch.enable_grad():
        free = held(picture).detach().requires_grad_()
        unit = distance(free.detach()).detach().clamp_min(torch.finfo(free.dtype).tiny)
        optimizer = torch.optim.LBFGS(
            [free], max_iter=iterations, max_eval=iterations, tolerance_grad=0, tolerance_change=0,
            history_size=10, line_search_fn="strong_wolfe",
        )  # fmt: skip

        def evaluate():
            inside = held(free)
            # A penalty outside the bounds keeps the gradient from vanishing there.
            value = (distance(inside) + (free - inside).square().mean()) / unit
            # L-BFGS takes contiguous gradients only.
            free.grad = torch.autograd.grad(value, free)[0].contiguous()
            if progress is not None:
                progress()
            return value

        optimizer.step(evaluate)
    return held(free.detach())
