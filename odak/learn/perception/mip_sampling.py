"""Local means over regions of every size: linear maps such as the sampling of a MIP chain, applied to many planes.

On a CPU, planes are laid out as ``[H, P, W]``. What happens to rows is then the product of a small matrix with a wide
one, and what happens to columns that of a tall one with a small one. Strips of rows are summed over the levels of the
chain while they are in the cache.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse
import torch
from torch.nn import functional

from odak import _array
from odak.learn.perception.banded import Banded
from odak.learn.perception.pixel_blocks import is_plain

# Columns of a block, values of one plane in a strip and of all planes for one thread: small enough for a cache, large
# enough that calls cost little.
COLUMNS, STRIP, CHUNK = 32, 1 << 14, 1 << 16


class Sampler:
    """A linear map of planes: a share of the plane itself and of coarser levels, enlarged.

    Parameters
    ----------
    device : torch.device
        Where the planes are.
    dtype : torch.dtype
        Their precision.

    Attributes
    ----------
    is_blocked : bool
        Whether the map is held as levels and strips, which is what a processor does best.
    levels : tuple of Level
        The levels from 1 on.
    strips : list of Strip
        How rows are made of the levels.
    """

    levels: tuple["Level", ...] = ()
    strips: Sequence["Strip"] = ()

    def __init__(self, device: torch.device, dtype: torch.dtype) -> None:
        self.device, self.dtype = device, dtype
        self.is_blocked = device.type == "cpu" and dtype in (torch.float32, torch.float64)

    def __call__(self, image: torch.Tensor) -> torch.Tensor:
        """Return the sampled pictures ``[B, C, H, W]``; differentiable any number of times."""
        if not self.levels or not is_plain(image):
            return self.plainly(image)
        return _Sampled.apply(image.flatten(0, 1).movedim(0, 1), self, False).movedim(1, 0).reshape(image.shape)

    def plainly(self, image: torch.Tensor) -> torch.Tensor:
        """Return the same from torch's own operations."""
        raise NotImplementedError

    def coarse(self, first: torch.Tensor) -> list[torch.Tensor]:
        """Return every level from 1, enlarged along its rows ``[H / 2ˡ, P, W]``, of level 1's rows `first`."""
        levels = []
        for index, level in enumerate(self.levels):
            first = level.halve(first) if index else first
            levels.append(level.columns.on_columns(first))
        return levels

    def coarse_adjoint(self, gradients: list[torch.Tensor]) -> torch.Tensor:
        """Return the adjoint of :meth:`coarse`."""
        pairs = list(zip(self.levels, gradients, strict=True))
        total = pairs[-1][0].columns.on_columns_adjoint(pairs[-1][1])
        for (level, gradient), (coarser, _) in zip(pairs[-2::-1], pairs[:0:-1], strict=True):
            here = level.columns.on_columns_adjoint(gradient)
            coarser.halve_adjoint(total, here)
            total = here
        return total


class MipSampler(Sampler):
    """Sampling of pictures of one size at one level of their MIP chain per pixel.

    Level l + 1 holds the 2 × 2 means of level l, down to one pixel; levels are enlarged bilinearly. Only the shares of
    the levels depend on the map.

    Parameters
    ----------
    lod : torch.Tensor
        Levels ``[H, W]`` in float64, 0 or more; beyond the last level counts as the last.
    dtype : torch.dtype
        Precision of the pictures.
    """

    def __init__(self, lod: torch.Tensor, dtype: torch.dtype) -> None:
        super().__init__(lod.device, dtype)
        weights = level_weights(lod)
        self.weights = weights.to(dtype)
        if self.is_blocked:
            size = tuple(lod.shape)
            self.levels = _array.outside_graphs(_mip_levels, size, len(weights) - 1, dtype)
            self.strips = _strips(self.weights, self.levels, _strip_rows(size[1]))

    def plainly(self, image: torch.Tensor) -> torch.Tensor:
        """Return the sampled pictures from whole levels, enlarged one by one."""
        size = image.shape[-2:]
        result = image * self.weights[0]
        for weight in self.weights[1:]:
            image = functional.adaptive_avg_pool2d(image, _halved(image.shape[-2:]))
            enlarged = functional.interpolate(image, size, mode="bilinear", align_corners=False)
            result = torch.addcmul(result, enlarged, weight)
        return result


class UniformSampler(Sampler):
    """Means over squares of one size, enlarged bilinearly: :func:`odak.learn.perception.uniform_blur`.

    Parameters
    ----------
    size, squares : tuple of int
        Rows and columns of the pictures, and of the squares.
    device : torch.device
        Where the pictures are.
    dtype : torch.dtype
        Their precision.
    """

    def __init__(
        self, size: tuple[int, int], squares: tuple[int, int], device: torch.device, dtype: torch.dtype
    ) -> None:
        super().__init__(device, dtype)
        self.squares = squares
        if self.is_blocked:
            self.levels = _array.outside_graphs(_uniform_levels, size, squares, dtype)
            shares = torch.zeros(2, *size, dtype=dtype)
            shares[1] = 1
            self.strips = _strips(shares, self.levels, _strip_rows(size[1]))

    def plainly(self, image: torch.Tensor) -> torch.Tensor:
        """Return the means from torch's pooling and enlargement."""
        means = functional.adaptive_avg_pool2d(image, self.squares)
        return functional.interpolate(means, image.shape[-2:], mode="bilinear", align_corners=False)


class Level(NamedTuple):
    """How a level of the chain is made of the one before, and enlarged.

    Attributes
    ----------
    rows : Banded or None
        Means of the last level's rows; None where these are pairs.
    columns : Banded
        From a full row to what a row of this level is enlarged to.
    enlarged : Banded
        From this level's rows to all rows, a block for each strip.
    """

    rows: Banded | None
    columns: Banded
    enlarged: Banded

    def halve(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the means of rows."""
        if self.rows is not None:
            return self.rows.on_rows(planes)
        return torch.add(planes[::2], planes[1::2]).mul_(0.5)

    def halve_adjoint(self, gradient: torch.Tensor, total: torch.Tensor) -> None:
        """Add the adjoint of :meth:`halve` to `total`, in place."""
        if self.rows is not None:
            total.add_(self.rows.on_rows_adjoint(gradient))
        else:
            total.unflatten(0, (-1, 2)).add_(gradient[:, None], alpha=0.5)


class Strip(NamedTuple):
    """Some rows of a picture and what their levels are made of.

    Attributes
    ----------
    rows : slice
        The rows.
    fine : torch.Tensor
        Share of level 0 ``[rows, 1, W]``.
    parts : tuple
        For each further level that counts here: its index among the coarse ones, its rows, the matrix that enlarges
        them, and its share ``[rows, 1, 1, W]``.
    """

    rows: slice
    fine: torch.Tensor
    parts: tuple[tuple[int, slice, torch.Tensor, torch.Tensor], ...]

    def add(self, total: torch.Tensor, coarse: Sequence[torch.Tensor], memory: torch.Tensor) -> None:
        """Add the coarse levels' parts to `total` ``[rows, n, P, W]``, in place, using memory of the same size."""
        for index, window, matrix, share in self.parts:
            torch.mm(matrix, coarse[index][window].flatten(1), out=memory.flatten(1))
            total.addcmul_(memory, share)

    def add_adjoint(self, gradient: torch.Tensor, totals: Sequence[torch.Tensor], memory: torch.Tensor) -> None:
        """Add the adjoint of :meth:`add` to the coarse levels' `totals`, in place."""
        for index, window, matrix, share in self.parts:
            torch.mul(gradient, share, out=memory)
            totals[index][window].flatten(1).addmm_(matrix.T, memory.flatten(1))


def level_weights(lod: torch.Tensor) -> torch.Tensor:
    """Return the share of each level in each pixel ``[levels, H, W]``, no more levels than are needed."""
    lod = lod.clamp(max=max(lod.shape).bit_length() - 1)
    levels = torch.arange(int(torch.ceil(lod.max())) + 1, dtype=lod.dtype, device=lod.device)
    return (1 - (lod - levels[:, None, None]).abs()).clamp_min(0)


def strip_memory(sampler: Sampler, planes: torch.Tensor, count: int) -> torch.Tensor:
    """Return memory for one strip of `count` planes as wide as `planes` ``[H, P, W]``."""
    return planes.new_empty(sampler.strips[0].fine.shape[0], count, planes.shape[-1])


def plane_chunks(sampler: Sampler, planes: torch.Tensor) -> list[slice]:
    """Return which planes ``[H, P, W]`` to take at a time, so that a strip of them stays in each thread's cache."""
    count = max(1, torch.get_num_threads() * CHUNK // sampler.strips[0].fine.numel())
    return [slice(start, min(start + count, planes.shape[1])) for start in range(0, planes.shape[1], count)]


class _Sampled(torch.autograd.Function):
    """The linear map on planes ``[H, P, W]``, or its adjoint; each is the other's gradient."""

    @staticmethod
    def forward(planes, sampler, adjoint):
        result = torch.empty_like(planes)
        for chunk in plane_chunks(sampler, planes):
            (_sample_adjoint if adjoint else _sample)(planes[:, chunk], sampler, result[:, chunk])
        return result

    @staticmethod
    def setup_context(context, inputs, output):
        _, context.sampler, context.adjoint = inputs

    @staticmethod
    def backward(context, gradient):
        return _Sampled.apply(gradient, context.sampler, not context.adjoint), None, None


def _sample(planes, sampler, result):
    memory = strip_memory(sampler, planes, planes.shape[1])
    coarse = sampler.coarse(sampler.levels[0].halve(planes))
    for strip in sampler.strips:
        total = torch.mul(planes[strip.rows], strip.fine, out=result[strip.rows])
        strip.add(total[:, None], coarse, memory[: len(total), None])


def _sample_adjoint(planes, sampler, result):
    memory = strip_memory(sampler, planes, planes.shape[1])
    totals = [planes.new_zeros(level.enlarged.shape[1], *planes.shape[1:]) for level in sampler.levels]
    for strip in sampler.strips:
        part = planes[strip.rows]
        torch.mul(part, strip.fine, out=result[strip.rows])
        strip.add_adjoint(part[:, None], totals, memory[: len(part), None])
    sampler.levels[0].halve_adjoint(sampler.coarse_adjoint(totals), result)


def _halved(size):
    return tuple(max(1, side // 2) for side in size)


def _strip_rows(columns):
    return max(16, STRIP // columns)


@functools.lru_cache(maxsize=64)
def _mip_levels(size, count, dtype):
    levels, here, across = [], size, scipy.sparse.identity(size[1], format="csr")
    for _ in range(count):
        coarse = _halved(here)
        across = _means(here[1], coarse[1]) @ across
        levels.append(_level(size, here[0], coarse, across, dtype))
        here = coarse
    return tuple(levels)


@functools.lru_cache(maxsize=64)
def _uniform_levels(size, squares, dtype):
    return (_level(size, size[0], squares, _means(size[1], squares[1]), dtype),)


def _level(size, rows, coarse, across, dtype):
    """Return a level of `coarse` rows and columns, its rows made of `rows` rows, its columns of all by `across`."""
    with torch.inference_mode(False):
        pairs = rows == 2 * coarse[0]
        return Level(
            None if pairs else Banded(_means(rows, coarse[0]), COLUMNS, dtype),
            Banded((_line(size[1], coarse[1]) @ across).tocsr(), COLUMNS, dtype),
            Banded(_line(size[0], coarse[0]), _strip_rows(size[1]), dtype),
        )


def _strips(weights, levels, step):
    counts = [[bool(part.any()) for part in level.split(step)] for level in weights]
    shares = weights[:, :, None]
    strips = []
    for index in range(len(counts[0])):
        rows = slice(index * step, min((index + 1) * step, weights.shape[1]))
        parts = []
        for number, level in enumerate(levels):
            if counts[number + 1][index]:
                block = level.enlarged.blocks[index]
                parts.append((number, block.columns, block.entries, shares[number + 1, rows, None]))
        strips.append(Strip(rows, shares[0, rows], tuple(parts)))
    return strips


def _means(fine, coarse):
    """Return the matrix of the means over the windows of adaptive pooling: pairs, overlapping where a side is odd."""
    index = np.arange(coarse)
    starts, ends = index * fine // coarse, -(-(index + 1) * fine // coarse)
    widths = ends - starts
    columns = np.concatenate([np.arange(*window) for window in zip(starts, ends, strict=True)])
    entries = np.repeat(1 / widths, widths), (np.repeat(index, widths), columns)
    return scipy.sparse.csr_matrix(entries, shape=(coarse, fine))


def _line(fine, coarse):
    """Return the matrix that enlarges a line bilinearly."""
    place = np.clip((np.arange(fine) + 0.5) * (coarse / fine) - 0.5, 0, coarse - 1)
    lower = np.floor(place).astype(int)
    share, index = place - lower, np.arange(fine)
    columns = np.concatenate([lower, np.minimum(lower + 1, coarse - 1)])
    entries = np.concatenate([1 - share, share]), (np.concatenate([index, index]), columns)
    return scipy.sparse.csr_matrix(entries, shape=(fine, coarse))
