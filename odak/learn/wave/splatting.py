"""Sums of Gaussians on the pixels of pictures, with gradients, in memory that grows with neither their product.

Values are computed anew in the backward pass, part by part; kept are the Gaussians and the lists of each tile's.
"""

import itertools

import torch
from torch.autograd.function import once_differentiable

from odak.learn.wave.gaussian_tiles import BLOCK, TiledGaussians, Tiling, part_size, with_none

# Light that less than this share of gets through to counts as blocked.
FAINTEST = 1e-4


def sum_of_gaussians(
    means: torch.Tensor, conics: torch.Tensor, weights: torch.Tensor, height: int, width: int
) -> torch.Tensor:
    """Return Σ weight·exp(−½ dᵀAd) on pixels at whole coordinates.

    Parameters
    ----------
    means : torch.Tensor
        Centres [x, y] in pixels ``[n, 2]``.
    conics : torch.Tensor
        Inverse covariances ``[A₀₀, A₀₁, A₁₁]``, ``[n, 3]``.
    weights : torch.Tensor
        Real or complex ``[n, channels]``.
    height, width : int
        Size of the picture in pixels.

    Returns
    -------
    torch.Tensor
        ``[channels, height, width]``, real or complex like `weights`; differentiable once in all three. A Gaussian
        counts as zero where it is below the dtype's rounding error, as a share of its peak.
    """
    rows, channels = _as_rows(weights)
    with torch.autocast(means.device.type, enabled=False):
        return _as_channels(_Sum.apply(means, conics, rows, height, width), channels)


def composite_gaussians(
    means: torch.Tensor,
    conics: torch.Tensor,
    opacities: torch.Tensor,
    weights: torch.Tensor,
    layers: torch.Tensor,
    tiling: Tiling,
) -> torch.Tensor:
    """Return Σ weight·α·T on pixels at whole coordinates, α = opacity·exp(−½ dᵀAd), T what those before let through.

    Parameters
    ----------
    means, conics : torch.Tensor
        As in :func:`sum_of_gaussians`, the Gaussians from front to back.
    opacities : torch.Tensor
        From 0 to 1 ``[n]``.
    weights : torch.Tensor
        Real or complex ``[n, channels]``.
    layers : torch.Tensor
        The picture that each Gaussian is in, and in which it hides others ``[n]``.
    tiling : Tiling
        Size and number of the pictures, and the tiles to compute them by.

    Returns
    -------
    torch.Tensor
        ``[layers, channels, height, width]``; differentiable once. T is zero where it is below :data:`FAINTEST`.
    """
    rows, channels = _as_rows(weights)
    with torch.autocast(means.device.type, enabled=False):
        return _as_channels(_Composite.apply(means, conics, opacities, rows, layers, tiling), channels)


def _as_rows(weights):
    """Return complex weights as real ones ``[n, 2·channels]``, and the number of channels, 0 for real weights."""
    if not weights.is_complex():
        return weights, 0
    return torch.cat([weights.real, weights.imag], dim=-1), weights.shape[-1]


def _as_channels(picture, channels):
    if not channels:
        return picture
    return torch.complex(picture[..., :channels, :, :], picture[..., channels:, :, :])


class _Sum(torch.autograd.Function):
    """The sum without occlusion."""

    @staticmethod
    def forward(ctx, means, conics, weights, height, width):
        tiled = TiledGaussians(means, conics, height, width)
        ctx.tiled = tiled
        ctx.save_for_backward(conics, weights)
        filled = with_none(weights)
        tiles = weights.new_zeros(tiled.tiling.count, weights.shape[-1], tiled.tiling.pixels)
        for blocks, (values,) in _parts(tiled, weights, 1):
            drawn = torch.bmm(filled[tiled.lists.slots[blocks]].mT, tiled.values(blocks, values).mT)
            tiles.index_add_(0, tiled.lists.tiles[blocks], drawn)
        return tiled.tiling.join(tiles)[0]

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):
        tiled = ctx.tiled
        conics, weights = ctx.saved_tensors
        filled, slopes = with_none(weights), tiled.tiling.split(gradient[None])
        of_shape = ctx.needs_input_grad[0] or ctx.needs_input_grad[1]
        weight_sums = torch.zeros_like(filled)
        sums = weights.new_zeros(len(filled), 6)
        for blocks, (values, density) in _parts(tiled, weights, 2):
            tiled.values(blocks, values)
            slope = slopes[tiled.lists.tiles[blocks]]
            tiled.gather(weight_sums, blocks, torch.bmm(slope, values))
            if of_shape:
                torch.bmm(slope.mT, filled[tiled.lists.slots[blocks]].mT, out=density)
                tiled.gather(sums, blocks, tiled.moments(blocks, density.mul_(values)))
        return *tiled.slopes(sums[:-1], conics), weight_sums[:-1], None, None


def _parts(tiled, like, count):
    """Yield some blocks at a time, and that many arrays for what is computed on their pixels."""
    total, step = len(tiled.lists.tiles), part_size(like.device, tiled.tiling.pixels * BLOCK)
    memory = like.new_empty(count, min(step, total), tiled.tiling.pixels, BLOCK)
    numbers = torch.arange(total, device=like.device)
    for start in range(0, total, step):
        blocks = numbers[start : start + step]
        yield blocks, memory[:, : len(blocks)].unbind(0)


class _Composite(torch.autograd.Function):
    """The sum with occlusion, front to back; slopes are summed from back to front."""

    @staticmethod
    def forward(ctx, means, conics, opacities, weights, layers, tiling):
        tiled = TiledGaussians(means, conics, tiling.height, tiling.width, tiling, layers)
        ctx.tiled = tiled
        ctx.save_for_backward(conics, opacities, weights)
        opaque, filled = with_none(opacities), with_none(weights)
        tiles = weights.new_zeros(tiling.count, weights.shape[-1], tiling.pixels)
        for group in _groups(tiled):
            light = weights.new_ones(len(group), tiling.pixels)
            for blocks in _rounds(tiled, group):
                _, alpha = _alphas(tiled, blocks, opaque)
                passed = _transmit(light[: len(blocks)], alpha)
                light[: len(blocks)] = passed[..., -1]
                seen = alpha.mul_(_visible(passed))
                drawn = torch.bmm(filled[tiled.lists.slots[blocks]].mT, seen.mT)
                tiles.index_add_(0, group[: len(blocks)], drawn)
        return tiling.join(tiles)

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):
        tiled = ctx.tiled
        conics, opacities, weights = ctx.saved_tensors
        opaque, filled, slopes = with_none(opacities), with_none(weights), tiled.tiling.split(gradient)
        weight_sums, sums = torch.zeros_like(filled), weights.new_zeros(len(filled), 6)
        for group in _groups(tiled):
            rounds = list(_rounds(tiled, group))
            behind = weights.new_zeros(len(group), tiled.tiling.pixels)
            for blocks, light in zip(reversed(rounds), reversed(_lights(tiled, rounds, opaque)), strict=True):
                values, alpha = _alphas(tiled, blocks, opaque)
                visible = _visible(_transmit(light, alpha))
                slope = slopes[group[: len(blocks)]]
                by_weight = torch.bmm(slope.mT, filled[tiled.lists.slots[blocks]].mT)
                tiled.gather(weight_sums, blocks, torch.bmm(slope, alpha * visible))
                covered = _sum_behind(behind[: len(blocks)], by_weight * alpha * visible)
                behind[: len(blocks)] = covered[..., -1]
                # Where 1 − α is below the bound nothing behind is visible, and the quotient is zero.
                hidden = covered[..., :-1].flip(-1) / (1 - alpha).clamp_min(FAINTEST)
                density = by_weight.mul_(visible).sub_(hidden).mul_(values)
                tiled.gather(sums, blocks, tiled.moments(blocks, density))
        shape = tiled.slopes(sums[:-1] * opacities[:, None], conics)
        return *shape, sums[:-1, 0], weight_sums[:-1], None, None


def _groups(tiled):
    """Yield tiles to compute at once, those with most blocks first."""
    counts, order = tiled.lists.counts.sort(descending=True)
    order = order[: int((counts > 0).sum())]
    return order.split(part_size(order.device, 2 * tiled.tiling.pixels * BLOCK)) if len(order) else ()


def _rounds(tiled, group):
    """Yield the first blocks of all tiles of a group, the second blocks of those that have so many, and so on."""
    counts = tiled.lists.counts[group]
    deepest = int(counts[0])
    still = (counts[:, None] > torch.arange(deepest, device=counts.device)).sum(0).tolist()
    for index, tiles in enumerate(still):
        yield tiled.lists.first[group[:tiles]] + index


def _alphas(tiled, blocks, opaque):
    """Return the Gaussians of blocks ``[blocks, pixels, BLOCK]`` and their opacities there."""
    values = tiled.values(blocks, opaque.new_empty(len(blocks), tiled.tiling.pixels, BLOCK))
    return values, values * opaque[tiled.lists.slots[blocks]][:, None]


def _transmit(light, alpha):
    """Return the light before each Gaussian of a block, and after the last ``[blocks, pixels, BLOCK + 1]``."""
    return torch.cat([light[..., None], 1 - alpha], dim=-1).cumprod(-1)


def _visible(passed):
    before = passed[..., :-1]
    return before.where(before >= FAINTEST, 0.0)


def _lights(tiled, rounds, opaque):
    """Return the light that gets to each round."""
    lights = [opaque.new_ones(len(rounds[0]), tiled.tiling.pixels)]
    for blocks, following in itertools.pairwise(rounds):
        _, alpha = _alphas(tiled, blocks, opaque)
        lights.append(_transmit(lights[-1][: len(blocks)], alpha)[: len(following), :, -1])
    return lights


def _sum_behind(behind, seen):
    """Return what is seen behind each Gaussian of a block, the last first, and in the end behind the block before."""
    return torch.cat([behind[..., None], seen.flip(-1)], dim=-1).cumsum(-1)
