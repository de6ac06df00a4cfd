"""Local means and standard deviations over regions of varying size, and distances between them, on CPU and GPU.

On a CPU, planes are laid out as ``[H, P, W]``: resampling along the rows is then the product of a small matrix with a
wide one, and resampling along the columns that of a tall one with a small one. Strips of rows are summed over the
levels of a MIP chain while they are in the cache.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse
import torch
from torch.nn import functional

from odak import _array
from odak.learn.perception.color_matrices import is_plain

VARIANCE_FLOOR = 1e-7
# Columns of a block, values of one plane in a strip and of all planes for one thread: small enough for a cache, large
# enough that calls cost little.
COLUMNS, STRIP, CHUNK = 16, 1 << 12, 1 << 18


class Block(NamedTuple):
    """The rows `rows` of a matrix, whose entries all lie in the columns `columns`."""

    rows: slice
    columns: slice
    entries: torch.Tensor


class Banded:
    """A matrix cut into blocks of rows, each dense where it has entries.

    A processor multiplies dense blocks many times faster than it follows the indices of a sparse matrix.

    Parameters
    ----------
    matrix : scipy.sparse.csr_matrix
        The matrix.
    step : int
        Rows of a block.
    dtype : torch.dtype
        Precision of the products.
    """

    def __init__(self, matrix: scipy.sparse.csr_matrix, step: int, dtype: torch.dtype) -> None:
        self.shape, self.blocks = matrix.shape, []
        for start in range(0, matrix.shape[0], step):
            rows = slice(start, min(start + step, matrix.shape[0]))
            part = matrix[rows].tocoo()
            columns = slice(int(part.col.min()), int(part.col.max()) + 1)
            entries = torch.from_numpy(matrix[rows, columns].toarray()).to(dtype)
            self.blocks.append(Block(rows, columns, entries))

    def on_rows(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the matrix times planes ``[n, …]``, ``[m, …]``."""
        flat = planes.flatten(1)
        result = flat.new_empty(self.shape[0], flat.shape[1])
        for rows, columns, entries in self.blocks:
            torch.mm(entries, flat[columns], out=result[rows])
        return result.unflatten(1, planes.shape[1:])

    def on_rows_adjoint(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the transpose times planes ``[m, …]``, ``[n, …]``."""
        flat = planes.flatten(1)
        result = flat.new_zeros(self.shape[1], flat.shape[1])
        for rows, columns, entries in self.blocks:
            result[columns].addmm_(entries.T, flat[rows])
        return result.unflatten(1, planes.shape[1:])

    def on_columns(self, planes: torch.Tensor) -> torch.Tensor:
        """Return planes ``[…, n]`` with the matrix applied to each row, ``[…, m]``."""
        flat = planes.flatten(0, -2)
        result = flat.new_empty(flat.shape[0], self.shape[0])
        for rows, columns, entries in self.blocks:
            torch.mm(flat[:, columns], entries.T, out=result[:, rows])
        return result.reshape(*planes.shape[:-1], -1)

    def on_columns_adjoint(self, planes: torch.Tensor) -> torch.Tensor:
        """Return planes ``[…, m]`` with the transpose applied to each row, ``[…, n]``."""
        flat = planes.flatten(0, -2)
        result = flat.new_zeros(flat.shape[0], self.shape[1])
        for rows, columns, entries in self.blocks:
            result[:, columns].addmm_(flat[:, rows], entries)
        return result.reshape(*planes.shape[:-1], -1)


def is_blocked(picture: torch.Tensor) -> bool:
    """Return whether statistics may be computed in strips: float32 or float64 on a CPU, without a transform."""
    return is_plain(picture) and picture.dtype in (torch.float32, torch.float64)


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
        """Return the same by operations of torch that are differentiable."""
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
        return sampled_planes(planes, sampler, adjoint)

    @staticmethod
    def setup_context(context, inputs, output):
        _, context.sampler, context.adjoint = inputs

    @staticmethod
    def backward(context, gradient):
        return _Sampled.apply(gradient, context.sampler, not context.adjoint), None, None


def sampled_planes(planes: torch.Tensor, sampler: Sampler, adjoint: bool = False) -> torch.Tensor:
    """Return planes ``[H, P, W]`` sampled in strips, or the adjoint of that, without a graph.

    Parameters
    ----------
    planes : torch.Tensor
        ``[H, P, W]`` on a CPU.
    sampler : Sampler
        Of pictures of this size, with levels.
    adjoint : bool
        Apply the adjoint of the linear map.

    Returns
    -------
    torch.Tensor
        In the shape of the planes.
    """
    result = torch.empty_like(planes)
    for chunk in plane_chunks(sampler, planes):
        part, target = planes[:, chunk], result[:, chunk]
        memory = strip_memory(sampler, part, part.shape[1])
        if adjoint:
            totals = [part.new_zeros(level.enlarged.shape[1], *part.shape[1:]) for level in sampler.levels]
            for strip in sampler.strips:
                rows = part[strip.rows]
                torch.mul(rows, strip.fine, out=target[strip.rows])
                strip.add_adjoint(rows[:, None], totals, memory[: len(rows), None])
            sampler.levels[0].halve_adjoint(sampler.coarse_adjoint(totals), target)
        else:
            coarse = sampler.coarse(sampler.levels[0].halve(part))
            for strip in sampler.strips:
                total = torch.mul(part[strip.rows], strip.fine, out=target[strip.rows])
                strip.add(total[:, None], coarse, memory[: len(total), None])
    return result


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


def local_statistics(bands: torch.Tensor, sampler: Sampler) -> torch.Tensor:
    """Return means and standard deviations over each pixel's pooling region, without a graph.

    Parameters
    ----------
    bands : torch.Tensor
        ``[B, C, K, H, W]`` on a CPU.
    sampler : Sampler
        Makes the local means of pictures of this size.

    Returns
    -------
    torch.Tensor
        ``[H, 2, B·C·K, W]``; deviations are at least √1e-7.
    """
    planes = _planes(bands.detach())
    result = planes.new_empty(planes.shape[0], 2, *planes.shape[1:])
    for chunk in plane_chunks(sampler, planes):
        part = planes[:, chunk]
        coarse, memory = _coarse(part, sampler), _memory(sampler, part)
        for strip in sampler.strips:
            found = result[strip.rows, :, chunk]
            _moments(strip, part, coarse, found, memory[: len(found)])
            found[:, 1].clamp_min_(VARIANCE_FLOOR).sqrt_()
    return result


def as_maps(statistics: torch.Tensor, shape: torch.Size) -> list[torch.Tensor]:
    """Return mean, deviation of each band ``[B, C, H, W]`` in turn, as views of statistics ``[H, 2, B·C·K, W]``."""
    maps = statistics.unflatten(2, shape[:3]).permute(2, 3, 4, 1, 0, 5)
    return [maps[:, :, band, kind] for band in range(shape[2]) for kind in range(2)]


def squared_distance(
    bands: torch.Tensor, sampler: Sampler, mask: torch.Tensor | None, target: torch.Tensor
) -> torch.Tensor:
    """Return Σ(mask·statistic − target)² over all statistics and pixels of bands.

    Parameters
    ----------
    bands : torch.Tensor
        ``[B, C, K, H, W]`` on a CPU.
    sampler : Sampler
        Makes the local means of pictures of this size.
    mask : torch.Tensor or None
        How much each pixel counts ``[H, W]``.
    target : torch.Tensor
        Statistics of the target as :func:`local_statistics` returns them, times the mask.

    Returns
    -------
    torch.Tensor
        Without axes; differentiable any number of times in the bands. The first gradient is computed on the way.
    """
    return _Distance.apply(bands, sampler, mask, target)


class _Distance(torch.autograd.Function):
    @staticmethod
    def forward(context, bands, sampler, mask, target):
        context.rest = (sampler, mask, target)
        wanted = context.needs_input_grad[0]
        value, gradient = _evaluate(bands, sampler, mask, target, wanted)
        if wanted:
            context.save_for_backward(bands, gradient)
        return value

    @staticmethod
    def backward(context, outer):
        bands, gradient = context.saved_tensors
        if torch.is_grad_enabled():
            # Derivatives of the gradient are wanted: computed again by differentiable operations.
            (gradient,) = torch.autograd.grad(_plain_distance(bands, *context.rest), bands, create_graph=True)
        return outer * gradient, None, None, None


def _planes(bands):
    """Return bands ``[B, C, K, H, W]`` as planes ``[H, P, W]``, without a copy where their memory is laid out so."""
    return bands.permute(3, 0, 1, 2, 4).flatten(1, 3).contiguous()


def _memory(sampler, planes):
    return strip_memory(sampler, planes, 2 * planes.shape[1]).unflatten(1, (2, -1))


def _coarse(planes, sampler):
    """Return the coarse levels of planes and of their squares, ``[H / 2ˡ, 2, P, W]``."""
    if not sampler.levels:
        return []
    first = sampler.levels[0]
    if first.rows is not None:
        return sampler.coarse(first.halve(torch.stack([planes, planes * planes], 1)))
    even, odd = planes[::2], planes[1::2]
    halved = planes.new_empty(even.shape[0], 2, *planes.shape[1:])
    torch.add(even, odd, out=halved[:, 0])
    torch.mul(even, even, out=halved[:, 1]).addcmul_(odd, odd)
    return sampler.coarse(halved.mul_(0.5))


def _moments(strip, planes, coarse, result, memory):
    """Write local means and variances of a strip to `result` ``[rows, 2, P, W]``."""
    part = planes[strip.rows]
    mean, variance = result.unbind(1)
    torch.mul(part, strip.fine, out=mean)
    torch.mul(mean, part, out=variance)
    strip.add(result, coarse, memory)
    variance.addcmul_(mean, mean, value=-1)


def _evaluate(bands, sampler, mask, target, wanted):
    """Return the distance and, if wanted, its gradient."""
    planes = _planes(bands)
    gradient = torch.empty_like(planes) if wanted else None
    weights = None if mask is None else mask[:, None, None]
    values = []
    for chunk in plane_chunks(sampler, planes):
        part = gradient[:, chunk] if wanted else None
        values += _compare(planes[:, chunk], sampler, weights, target[:, :, chunk], part)
    if wanted:
        gradient = gradient.unflatten(1, bands.shape[:3]).permute(1, 2, 3, 0, 4)
    return torch.stack(values).sum(), gradient


def _compare(planes, sampler, weights, target, gradient):
    """Return the distances of each strip of some planes; write the gradient if there is room for one."""
    moments, errors, memory = (_memory(sampler, planes) for _ in range(3))
    coarse, values = _coarse(planes, sampler), []
    totals = [] if gradient is None else [torch.zeros_like(level) for level in coarse]
    for strip in sampler.strips:
        length = strip.rows.stop - strip.rows.start
        found, error, rest = moments[:length], errors[:length], memory[:length]
        _moments(strip, planes, coarse, found, rest)
        varies = None if gradient is None else found[:, 1] > VARIANCE_FLOOR
        found[:, 1].clamp_min_(VARIANCE_FLOOR).sqrt_()
        weight = None if weights is None else weights[strip.rows]
        counted = found if weight is None else torch.mul(found, weight, out=error)
        torch.sub(counted, target[strip.rows], out=error)
        values.append(torch.dot(error.flatten(), error.flatten()))
        if gradient is not None:
            _to_moments(error, found, weight, varies)
            torch.addcmul(error[:, 0], planes[strip.rows], error[:, 1], value=2, out=gradient[strip.rows])
            gradient[strip.rows].mul_(strip.fine)
            strip.add_adjoint(error, totals, rest)
    if totals:
        _add_coarse(gradient, planes, sampler, totals)
    return values


def _to_moments(error, found, weight, varies):
    """Turn errors into gradients by local means of planes and of their squares, in place."""
    if weight is not None:
        error.mul_(weight)
    by_mean, by_power = error.unbind(1)
    mean, deviation = found.unbind(1)
    # d(e²) = 2e·dσ and dσ = d(power)/2σ − mean·d(mean)/σ; 0 where the variance is clipped.
    by_power.div_(deviation).mul_(varies)
    by_mean.addcmul_(mean, by_power, value=-1).mul_(2)


def _add_coarse(gradient, planes, sampler, totals):
    """Add the contributions of the coarse levels to the gradient."""
    halved, first = sampler.coarse_adjoint(totals), sampler.levels[0]
    if first.rows is not None:
        by_mean, by_power = first.rows.on_rows_adjoint(halved).unbind(1)
        gradient.add_(by_mean).addcmul_(planes, by_power, value=2)
        return
    by_mean, by_power = halved.unbind(1)
    pairs = gradient.unflatten(0, (-1, 2))
    pairs.add_(by_mean[:, None], alpha=0.5).addcmul_(planes.unflatten(0, (-1, 2)), by_power[:, None])


def _plain_distance(bands, sampler, mask, target):
    with torch.enable_grad():
        mean, deviation = pooled(bands, sampler)
        found = torch.stack([_planes(mean), _planes(deviation)], 1)
        found = found if mask is None else found * mask[:, None, None]
        return ((found - target) ** 2).sum()


def pooled(bands: torch.Tensor, sampler: Sampler) -> tuple[torch.Tensor, torch.Tensor]:
    """Return means and standard deviations over each pixel's pooling region; differentiable any number of times.

    Parameters
    ----------
    bands : torch.Tensor
        ``[B, C, K, H, W]``.
    sampler : Sampler
        Makes the local means of pictures of this size.

    Returns
    -------
    tuple of torch.Tensor
        Both in the shape of the bands; deviations are at least √1e-7.
    """
    flat = bands.flatten(1, 2)
    mean, power = sampler(torch.cat([flat, flat**2], 1)).chunk(2, 1)
    deviation = (power - mean**2).clamp_min(VARIANCE_FLOOR).sqrt()
    return mean.reshape(bands.shape), deviation.reshape(bands.shape)
