"""Pooled statistics of a pyramid's bands and the distance between them, computed in strips on a CPU."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch.nn import functional

from odak.learn.perception.foveation import Sampler, is_blocked, plane_chunks

VARIANCE_FLOOR = 1e-7


class Pooling(NamedTuple):
    """What the statistics of pictures of one size and one gaze are pooled by, made once.

    Attributes
    ----------
    samplers : list of Sampler
        Those that compute the local means of each level that has bands.
    masks : list of torch.Tensor or None
        How much each pixel ``[H, W]`` of each of these levels counts; None where all count alike.
    last : torch.Tensor or None
        The same of the last low-pass.
    fovea, periphery : torch.Tensor or None
        Weights of the pixels near the gaze and of the others, in the shape of the pictures.
    """

    samplers: list[Sampler]
    masks: list[torch.Tensor | None]
    last: torch.Tensor | None = None
    fovea: torch.Tensor | None = None
    periphery: torch.Tensor | None = None


def checked_statistics(**lists: Sequence[torch.Tensor]) -> list[list[torch.Tensor]]:
    """Return two lists of statistics after checking that they come from pictures of one size."""
    checked: list[list[Any]] = []
    for name, value in lists.items():
        checked.append(list(value) if isinstance(value, (list, tuple)) else [])
        if not checked[-1] or any(not isinstance(one, torch.Tensor) or one.ndim != 4 for one in checked[-1]):
            raise TypeError(f"{name} must be a list of tensors [B, C, H, W] as calc_statsmaps returns it")
    if [one.shape[-2:] for one in checked[0]] != [two.shape[-2:] for two in checked[1]]:
        raise ValueError(f"{' and '.join(lists)} must be statistics of pictures of one size and as many levels")
    return checked


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
        coarse, memory = _coarse(part, sampler), _memory(sampler, part)[0]
        for strip in sampler.strips:
            found = result[strip.rows, :, chunk]
            _moments(strip, part, coarse, found, memory[: len(found)])
            found[:, 1].clamp_min_(VARIANCE_FLOOR).sqrt_()
    return result


def as_maps(statistics: torch.Tensor, shape: torch.Size) -> list[torch.Tensor]:
    """Return mean and deviation of each band ``[B, C, H, W]`` alternately: views of statistics ``[H, 2, B·C·K, W]``."""
    maps = statistics.unflatten(2, shape[:3]).permute(2, 3, 4, 1, 0, 5)
    return [maps[:, :, band, kind] for band in range(shape[2]) for kind in range(2)]


def squared_distance(groups: Sequence[torch.Tensor], pooling: Pooling, targets: Sequence[torch.Tensor]) -> torch.Tensor:
    """Return Σ(mask·statistic − target)² over all statistics and pixels of bands, over the pixels of a band.

    Parameters
    ----------
    groups : sequence of torch.Tensor
        Bands ``[B, C, K, H, W]`` of each level, on a CPU.
    pooling : Pooling
        That of pictures of this size.
    targets : sequence of torch.Tensor
        Statistics of the target as :func:`local_statistics` returns them for each level, times the mask.

    Returns
    -------
    torch.Tensor
        Without axes; differentiable any number of times in the bands. The first gradient is computed on the way.
    """
    return _Distance.apply(pooling, targets, *groups)


class _Distance(torch.autograd.Function):
    @staticmethod
    def forward(context, pooling, targets, *groups):
        context.rest, total, gradients = (pooling, targets), 0.0, []
        for level, bands in enumerate(groups):
            planes, sampler, target, mask = (
                _planes(bands),
                pooling.samplers[level],
                targets[level],
                pooling.masks[level],
            )
            weights = None if mask is None else mask[:, None, None]
            gradient = torch.empty_like(planes) if context.needs_input_grad[2] else None
            for chunk in plane_chunks(sampler, planes):
                part = None if gradient is None else gradient[:, chunk]
                value = _compare(planes[:, chunk], sampler, weights, target[:, :, chunk], part)
                total = total + value / (bands.shape[0] * bands.shape[1] * bands.shape[3] * bands.shape[4])
            gradients += [] if gradient is None else [_as_bands(gradient, bands.shape)]
        if gradients:
            context.save_for_backward(*groups, *gradients)
        return total

    @staticmethod
    def backward(context, outer):
        pooling, targets = context.rest
        groups, gradients = context.saved_tensors[: len(targets)], context.saved_tensors[len(targets) :]
        scales = [outer / bands[:, :, 0].numel() for bands in groups]
        if torch.is_grad_enabled():
            # The gradient is differentiated: it is computed again by differentiable operations.
            total = groups[0].new_zeros(())
            for bands, sampler, mask, target in zip(groups, pooling.samplers, pooling.masks, targets, strict=True):
                found = torch.stack([_planes(statistic) for statistic in pooled(bands, sampler)], 1)
                found = found if mask is None else found * mask[:, None, None]
                total = total + ((found - target) ** 2).sum()
            gradients = torch.autograd.grad(total, groups, create_graph=True)
        return None, None, *(scale * one for scale, one in zip(scales, gradients, strict=True))


def _as_bands(planes, shape):
    return planes.view(shape[3], *shape[:3], shape[4]).permute(1, 2, 3, 0, 4)


def _planes(bands):
    """Return bands ``[B, C, K, H, W]`` as planes ``[H, P, W]``, without a copy where the memory layout permits."""
    return bands.permute(3, 0, 1, 2, 4).reshape(bands.shape[3], -1, bands.shape[4])


def _memory(sampler, planes, count=1):
    """Return memory for so many times the means and powers of a strip."""
    rows, (_, number, columns) = sampler.strips[0].fine.shape[0], planes.shape
    return planes.new_empty(count, rows, 2, number, columns)


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
    halved *= 0.5
    return sampler.coarse(halved)


def _moments(strip, planes, coarse, result, memory):
    """Write local means and variances of a strip to `result` ``[rows, 2, P, W]``."""
    part, mean, variance = planes[strip.rows], result[:, 0], result[:, 1]
    torch.mul(part, strip.fine, out=mean)
    torch.mul(mean, part, out=variance)
    strip.add(result, coarse, memory)
    variance.addcmul_(mean, mean, value=-1)


def _compare(planes, sampler, weights, target, gradient):
    """Return the distance of some planes; write the gradient where memory for it is given."""
    memory = _memory(sampler, planes, 3)
    coarse, total = _coarse(planes, sampler), 0.0
    totals = [] if gradient is None else [torch.zeros_like(level) for level in coarse]
    for strip in sampler.strips:
        rows = strip.rows
        length = rows.stop - rows.start
        found, error, rest = memory[0, :length], memory[1, :length], memory[2, :length]
        _moments(strip, planes, coarse, found, rest)
        mean, deviation = found[:, 0], found[:, 1]
        varies = None if gradient is None else deviation > VARIANCE_FLOOR
        deviation.clamp_min_(VARIANCE_FLOOR).sqrt_()
        weight = None if weights is None else weights[rows]
        counted = found if weight is None else torch.mul(found, weight, out=error)
        torch.sub(counted, target[rows], out=error)
        flat = error.flatten()
        total = total + torch.dot(flat, flat)
        if gradient is not None:
            # Errors become gradients by the means of planes and of their squares: d(e²) = 2e·dσ and
            # dσ = d(power)/2σ − mean·d(mean)/σ; 0 where the variance is clipped.
            if weight is not None:
                error *= weight
            by_mean, by_power = error[:, 0], error[:, 1]
            by_power /= deviation
            by_power *= varies
            by_mean.addcmul_(mean, by_power, value=-1)
            by_mean *= 2
            part = torch.addcmul(by_mean, planes[rows], by_power, value=2, out=gradient[rows])
            part *= strip.fine
            strip.add_adjoint(error, totals, rest)
    if totals:
        _add_coarse(gradient, planes, sampler, totals)
    return total


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


def statistics_maps(
    groups: Sequence[torch.Tensor], pooling: Pooling, others: Sequence[torch.Tensor]
) -> list[torch.Tensor]:
    """Return mean and standard deviation of a pyramid's bands, each over a pixel's pooling region.

    Parameters
    ----------
    groups : sequence of torch.Tensor
        Bands ``[B, C, K, H, W]`` of each level as :meth:`SpatialSteerablePyramid.levels` returns them.
    pooling : Pooling
        That of pictures of this size.
    others : sequence of torch.Tensor
        Maps that are compared without pooling, times their own masks, first of all the last low-pass.

    Returns
    -------
    list of torch.Tensor
        Mean and deviation of the high-pass residual and of each band of each level, 2(1 + (n − 1)K) tensors
        ``[B, C, H, W]``, and `others`.
    """
    maps: list[torch.Tensor] = []
    for bands, sampler, mask in zip(groups, pooling.samplers, pooling.masks, strict=True):
        if is_blocked(bands) and not (bands.requires_grad and torch.is_grad_enabled()):
            found = as_maps(local_statistics(bands, sampler), bands.shape)
        else:
            pairs = zip(*(value.unbind(2) for value in pooled(bands, sampler)), strict=True)
            found = [one for pair in pairs for one in pair]
        maps += found if mask is None else [mask * one for one in found]
    return [*maps, *others]


def mean_distance(one: list[torch.Tensor], two: list[torch.Tensor]) -> torch.Tensor:
    """Return the mean over pairs of maps of their mean squared differences."""
    return torch.stack([functional.mse_loss(a, b) for a, b in zip(one, two, strict=True)]).mean()


def mean_square(values: torch.Tensor) -> torch.Tensor:
    """Return the mean of the squares of values."""
    return (values * values).mean()
