"""Sums and composites of elliptical Gaussians on a pixel grid, tile by tile, with their gradients."""

import functools
import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import torch

from odak._torch_private import in_own_precision

BLOCK = 32
# Larger parts leave the cache of a CPU core; on a GPU they keep it busy.
_PART = {"cpu": 1 << 19, "cuda": 1 << 25}
_SIDES = (8, 16, 32, 64, 128)
# Largest number of pairs of a tile and a Gaussian before tiles are enlarged, and the cost of a pair in pixels.
_MANY_PAIRS, _PAIR = 1 << 21, 100
_COLUMNS, _ROWS = (0, 2), (1, 3)


def smallest_kept(dtype: torch.dtype) -> float:
    """Return the value, as a share of the peak, below which a Gaussian counts as zero: the dtype's rounding error."""
    return torch.finfo(dtype).eps


def part_size(device: torch.device, numbers: int) -> int:
    """Return how many blocks of that many numbers to compute at once."""
    return max(1, _PART.get(device.type, _PART["cuda"]) // numbers)


@dataclass(frozen=True)
class Tiling:
    """Some pictures of one size, cut into tiles of one size.

    Attributes
    ----------
    height, width : int
        Size of a picture in pixels.
    tile_height, tile_width : int
        Size of a tile; those at the right and lower rims may reach beyond the picture.
    layers : int
        Number of pictures.
    """

    height: int
    width: int
    tile_height: int
    tile_width: int
    layers: int = 1

    @property
    def rows(self) -> int:
        """Rows of tiles in a picture."""
        return -(-self.height // self.tile_height)

    @property
    def columns(self) -> int:
        """Columns of tiles in a picture."""
        return -(-self.width // self.tile_width)

    @property
    def count(self) -> int:
        """Tiles in all pictures."""
        return self.layers * self.rows * self.columns

    @property
    def pixels(self) -> int:
        """Pixels of a tile."""
        return self.tile_height * self.tile_width

    def split(self, pictures: torch.Tensor) -> torch.Tensor:
        """Return pictures ``[layers, channels, height, width]`` as tiles ``[count, channels, pixels]``."""
        right = self.columns * self.tile_width - self.width
        lower = self.rows * self.tile_height - self.height
        padded = torch.nn.functional.pad(pictures, (0, right, 0, lower))
        parts = padded.unflatten(-1, (self.columns, self.tile_width)).unflatten(-3, (self.rows, self.tile_height))
        return parts.permute(0, 2, 4, 1, 3, 5).reshape(self.count, -1, self.pixels)

    def join(self, tiles: torch.Tensor) -> torch.Tensor:
        """Return tiles ``[count, channels, pixels]`` as pictures ``[layers, channels, height, width]``."""
        parts = tiles.reshape(self.layers, self.rows, self.columns, -1, self.tile_height, self.tile_width)
        whole = parts.permute(0, 3, 1, 4, 2, 5).flatten(-2).flatten(-3, -2)
        return whole[..., : self.height, : self.width].contiguous()

    def corners(self, tiles: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the column and the row of the first pixel of some tiles."""
        within = tiles % (self.rows * self.columns)
        return within % self.columns * self.tile_width, within // self.columns * self.tile_height


def whiten(conics: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return s, a and b with ½ dᵀAd = (a·(x + s·y))² + (b·y)², float64, for matrices ``[A₀₀, A₀₁, A₁₁]`` as rows.

    A sum of squares keeps its precision where the terms of the quadratic form of a long, thin Gaussian cancel.
    """
    first, cross, last = conics.double().unbind(-1)
    tiny = torch.finfo(torch.float64).tiny
    first = first.clamp_min(tiny)
    shear = cross / first
    return shear, (first / 2).sqrt(), ((last - cross * shear).clamp_min(tiny) / 2).sqrt()


def half_boxes(shear: torch.Tensor, a: torch.Tensor, b: torch.Tensor, lowest: float) -> torch.Tensor:
    """Return half the width and height ``[n, 2]`` of the boxes outside which Gaussians are below `lowest`."""
    reach = math.sqrt(-math.log(lowest))
    return torch.stack([reach * ((1 / a) ** 2 + (shear / b) ** 2).sqrt(), reach / b], dim=-1)


def tile_spans(means: torch.Tensor, half: torch.Tensor, tiling: Tiling) -> torch.Tensor:
    """Return the first and last columns and rows of tiles that boxes overlap: ``[n, 4]``, columns at 0 and 2.

    A box without a pixel of the picture ends before it begins. NaN overlaps every tile, so that it shows in the
    picture.
    """
    size = means.new_tensor([tiling.width, tiling.height])
    tile = torch.tensor([tiling.tile_width, tiling.tile_height], device=means.device)
    low = (means - half).ceil().clamp_min(0).nan_to_num(0.0).minimum(size)
    high = (means + half).floor().clamp_min(-1).nan_to_num(math.inf).minimum(size - 1)
    inside = (low <= high).all(-1, keepdim=True)
    first = torch.where(inside, low.long() // tile, 0)
    return torch.cat([first, torch.where(inside, high.long() // tile, -1)], dim=-1)


def choose_tiling(means: torch.Tensor, half: torch.Tensor, height: int, width: int) -> Tiling:
    """Return the tiling with the least computing time.

    Small tiles fit the Gaussians more closely; large ones need fewer pairs, and fill their blocks.
    """
    costs = {}
    for side in _SIDES:
        tiling = Tiling(height, width, side, side)
        pairs = int(_counts(tile_spans(means, half, tiling)).sum())
        costs[tiling] = tiling.pixels * max(pairs, tiling.count * BLOCK // 2) + _PAIR * pairs
        if pairs > _MANY_PAIRS:
            costs = {tiling: costs[tiling]}
        if side >= max(height, width):
            break
    return min(costs, key=costs.__getitem__)


def finer_tiling(tiling: Tiling, means: torch.Tensor, conics: torch.Tensor) -> Tiling:
    """Return the tiling, with smaller tiles where its own are larger than suits the Gaussians."""
    with torch.no_grad():
        half = half_boxes(*whiten(conics), smallest_kept(means.dtype))
        side = choose_tiling(means.double(), half, tiling.height, tiling.width).tile_width
    return replace(tiling, tile_height=min(side, tiling.tile_height), tile_width=min(side, tiling.tile_width))


def _counts(spans):
    columns, rows = (spans[:, last] - spans[:, first] + 1 for first, last in (_COLUMNS, _ROWS))
    return columns * rows


@dataclass(frozen=True)
class TileLists:
    """The Gaussians of each tile, in their order, in blocks.

    Attributes
    ----------
    slots : torch.Tensor
        Gaussians of each block ``[blocks, BLOCK]``; the index after the last Gaussian means none.
    tiles : torch.Tensor
        Tile of each block, ascending ``[blocks]``.
    first, counts : torch.Tensor
        First block of each tile and the number of its blocks ``[tiles]``.
    """

    slots: torch.Tensor
    tiles: torch.Tensor
    first: torch.Tensor
    counts: torch.Tensor


def list_tiles(means: torch.Tensor, half: torch.Tensor, tiling: Tiling, layers: torch.Tensor | None = None) -> Any:
    """Return the lists of Gaussians with these boxes, each in one of the tiling's pictures (the first by default)."""
    device, number = means.device, len(means)
    spans = tile_spans(means, half, tiling)
    counts = _counts(spans)
    owners = torch.repeat_interleave(torch.arange(number, device=device), counts)
    place = torch.arange(len(owners), device=device) - (counts.cumsum(0) - counts)[owners]
    across = (spans[:, 2] - spans[:, 0] + 1)[owners]
    row, column = spans[owners, 1] + place // across, spans[owners, 0] + place % across
    layer = 0 if layers is None else layers[owners]
    tile, order = torch.sort((layer * tiling.rows + row) * tiling.columns + column, stable=True)
    members = torch.bincount(tile, minlength=tiling.count)
    blocks = (members + BLOCK - 1) // BLOCK
    first = blocks.cumsum(0) - blocks
    rank = torch.arange(len(tile), device=device) - (members.cumsum(0) - members)[tile]
    of_blocks = torch.repeat_interleave(torch.arange(tiling.count, device=device), blocks)
    slots = torch.full((len(of_blocks) * BLOCK,), number, device=device)
    slots[first[tile] * BLOCK + rank] = owners[order]
    return TileLists(slots.view(-1, BLOCK), of_blocks, first, blocks)


def with_none(rows: torch.Tensor) -> torch.Tensor:
    """Return rows followed by one of zeros, for the slots without a Gaussian."""
    return torch.cat([rows, rows.new_zeros(1, *rows.shape[1:])])


class TiledGaussians:
    """Gaussians on the pixels of tiles.

    Parameters
    ----------
    means : torch.Tensor
        Centres [x, y] in pixels ``[n, 2]``.
    conics : torch.Tensor
        Inverse covariances ``[A₀₀, A₀₁, A₁₁]``, ``[n, 3]``.
    height, width : int
        Size of the pictures in pixels.
    tiling : Tiling, optional
        Their tiles; by default those that suit the Gaussians.
    layers : torch.Tensor, optional
        The picture that each Gaussian is in ``[n]``.
    """

    def __init__(
        self,
        means: torch.Tensor,
        conics: torch.Tensor,
        height: int,
        width: int,
        tiling: Any = None,
        layers: torch.Tensor | None = None,
    ):
        shear, a, b = whiten(conics)
        self.lowest: float = smallest_kept(means.dtype)
        half = half_boxes(shear, a, b, self.lowest)
        centres = means.double()
        self.tiling: Any = tiling or choose_tiling(centres, half, height, width)
        self.lists: TileLists = list_tiles(centres, half, self.tiling, layers)
        self.number: int = len(means)
        self._table = with_none(torch.stack([*centres.unbind(-1), a, a * shear, b], dim=-1).to(means.dtype))
        steps = (torch.arange(n, device=means.device) for n in (self.tiling.tile_width, self.tiling.tile_height))
        self._across, self._down = (step.to(means.dtype)[:, None] for step in steps)

    def values(self, blocks: torch.Tensor, out: torch.Tensor) -> torch.Tensor:
        """Write the Gaussians of some blocks to ``out [blocks, pixels, BLOCK]`` and return it."""
        x, y, a, sheared, b = self._table[self.lists.slots[blocks]].unsqueeze(1).unbind(-1)
        left, top = (corner[:, None, None] for corner in self.tiling.corners(self.lists.tiles[blocks]))
        down = self._down + top - y
        across = (a * (self._across + left - x))[:, None]
        result = out.view(len(blocks), len(self._down), len(self._across), BLOCK)
        torch.add(across, (sheared * down)[:, :, None], out=result)
        torch.addcmul(-((b * down) ** 2)[:, :, None], result, result, value=-1, out=result)
        # Exponentials that underflow take ten times as long as others.
        result.clamp_(min=2 * math.log(self.lowest)).exp_()
        torch.nn.functional.threshold(result, self.lowest, 0.0, inplace=True)
        return out

    @in_own_precision
    def moments(self, blocks: torch.Tensor, density: torch.Tensor) -> torch.Tensor:
        """Return Σ density·(1, x, y, x², xy, y²) about the Gaussians' centres ``[blocks, 6, BLOCK]``.

        `density` is ``[blocks, pixels, BLOCK]``. Sums are taken about the middle of the tile and moved to the centre.
        """
        middle = [(len(steps) - 1) / 2 for steps in (self._across, self._down)]
        x, y = torch.meshgrid(self._across[:, 0] - middle[0], self._down[:, 0] - middle[1], indexing="xy")
        powers = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y]).flatten(1)
        total, mx, my, mxx, mxy, myy = torch.matmul(powers, density).unbind(1)
        centre = self._table[self.lists.slots[blocks]][..., :2].unbind(-1)
        corners = self.tiling.corners(self.lists.tiles[blocks])
        dx, dy = (at - corner[:, None] - mid for at, corner, mid in zip(centre, corners, middle, strict=True))
        sums = (
            *(total, mx - dx * total, my - dy * total),
            *(mxx - 2 * dx * mx + dx * dx * total, mxy - dx * my - dy * mx + dx * dy * total),
            myy - 2 * dy * my + dy * dy * total,
        )
        return torch.stack(sums, dim=1)

    def slopes(self, sums: torch.Tensor, conics: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the gradients of centres and conics from the moments ``[n, 6]`` of (slope of value)·value."""
        _, sx, sy, sxx, sxy, syy = sums.unbind(-1)
        first, cross, last = conics.unbind(-1)
        means = torch.stack([first * sx + cross * sy, cross * sx + last * sy], dim=-1)
        return means, torch.stack([-sxx / 2, -sxy, -syy / 2], dim=-1)

    def gather(self, sums: torch.Tensor, blocks: torch.Tensor, values: torch.Tensor) -> None:
        """Add values of blocks ``[blocks, m, BLOCK]`` to the sums of their Gaussians ``[n + 1, m]``."""
        sums.index_add_(0, self.lists.slots[blocks].flatten(), values.mT.flatten(0, 1))


# A transmittance below this counts as zero.
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
    """Return Σ weight·α·T on pixels at whole coordinates, α = opacity·exp(−½ dᵀAd), T the transmittance in front.

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


class _Final(torch.autograd.Function):
    """Gradients that refuse to be differentiated."""

    @staticmethod
    def forward(ctx, anchor, *gradients):
        return gradients

    @staticmethod
    def backward(ctx, *_):
        raise RuntimeError("pictures of Gaussians have first derivatives only; their gradients have none")


def _once_differentiable(backward):
    """Return a backward pass whose gradients refuse to be differentiated.

    torch's own decorator returns constants instead where the gradient that arrives is constant, so that a penalty on
    gradients would be lost without a message.
    """

    @functools.wraps(backward)
    def once(ctx, gradient):
        with torch.no_grad():
            found = backward(ctx, gradient)
        if not torch.is_grad_enabled():
            return found
        anchor = torch.zeros((), requires_grad=True)
        final = iter(_Final.apply(anchor, *(one for one in found if one is not None)))
        return tuple(None if one is None else next(final) for one in found)

    return once


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
    @_once_differentiable
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
    """Yield some blocks at a time, and as many arrays for results on their pixels."""
    total, step = len(tiled.lists.tiles), part_size(like.device, tiled.tiling.pixels * BLOCK)
    memory = like.new_empty(count, min(step, total), tiled.tiling.pixels, BLOCK)
    numbers = torch.arange(total, device=like.device)
    for start in range(0, total, step):
        blocks = numbers[start : start + step]
        yield blocks, memory[:, : len(blocks)].unbind(0)


class _Composite(torch.autograd.Function):
    """The sum with occlusion, front to back; gradients are summed from back to front."""

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
    @_once_differentiable
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
                # Sums over what lies behind each Gaussian of a block, the last first, and behind the block before.
                seen = (by_weight * alpha * visible).flip(-1)
                covered = torch.cat([behind[: len(blocks), ..., None], seen], dim=-1).cumsum(-1)
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
    """Return the transmittance before each Gaussian of a block, and after the last, ``[blocks, pixels, BLOCK + 1]``."""
    return torch.cat([light[..., None], 1 - alpha], dim=-1).cumprod(-1)


def _visible(passed):
    before = passed[..., :-1]
    return before.where(before >= FAINTEST, 0.0)


def _lights(tiled, rounds, opaque):
    """Return the transmittance in front of each round."""
    lights = [opaque.new_ones(len(rounds[0]), tiled.tiling.pixels)]
    for blocks, following in itertools.pairwise(rounds):
        _, alpha = _alphas(tiled, blocks, opaque)
        lights.append(_transmit(lights[-1][: len(blocks)], alpha)[: len(following), :, -1])
    return lights
