"""Pooled statistics of a pyramid's bands and the distance between them, computed in strips on a CPU."""

from collections.abc import Sequence
from typing import Any

import torch
from torch.nn import functional

from odak.learn.perception.foveation import Sampler, is_blocked, plane_chunks, strip_memory

VARIANCE_FLOOR = 1e-7


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
        coarse, memory = _coarse(part, sampler), _memory(sampler, part)
        for strip in sampler.strips:
            found = result[strip.rows, :, chunk]
            _moments(strip, part, coarse, found, memory[: len(found)])
            found[:, 1].clamp_min_(VARIANCE_FLOOR).sqrt_()
    return result


def as_maps(statistics: torch.Tensor, shape: torch.Size) -> list[torch.Tensor]:
    """Return mean and deviation of each band ``[B, C, H, W]`` alternately: views of statistics ``[H, 2, B·C·K, W]``."""
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
        planes, weights = _planes(bands), None if mask is None else mask[:, None, None]
        gradient = torch.empty_like(planes) if context.needs_input_grad[0] else None
        values = []
        for chunk in plane_chunks(sampler, planes):
            part = None if gradient is None else gradient[:, chunk]
            values += _compare(planes[:, chunk], sampler, weights, target[:, :, chunk], part)
        if gradient is not None:
            context.save_for_backward(bands, gradient.unflatten(1, bands.shape[:3]).permute(1, 2, 3, 0, 4))
        return torch.stack(values).sum()

    @staticmethod
    def backward(context, outer):
        bands, gradient = context.saved_tensors
        if torch.is_grad_enabled():
            # The gradient is differentiated: it is computed again by differentiable operations.
            sampler, mask, target = context.rest
            found = torch.stack([_planes(statistic) for statistic in pooled(bands, sampler)], 1)
            found = found if mask is None else found * mask[:, None, None]
            (gradient,) = torch.autograd.grad(((found - target) ** 2).sum(), bands, create_graph=True)
        return outer * gradient, None, None, None


def _planes(bands):
    """Return bands ``[B, C, K, H, W]`` as planes ``[H, P, W]``, without a copy where the memory layout permits."""
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


def _compare(planes, sampler, weights, target, gradient):
    """Return the distances of each strip of some planes; write the gradient where memory for it is given."""
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
            # Errors become gradients by the means of planes and of their squares: d(e²) = 2e·dσ and
            # dσ = d(power)/2σ − mean·d(mean)/σ; 0 where the variance is clipped.
            if weight is not None:
                error.mul_(weight)
            by_mean, by_power = error.unbind(1)
            mean, deviation = found.unbind(1)
            by_power.div_(deviation).mul_(varies)
            by_mean.addcmul_(mean, by_power, value=-1).mul_(2)
            torch.addcmul(by_mean, planes[strip.rows], by_power, value=2, out=gradient[strip.rows])
            gradient[strip.rows].mul_(strip.fine)
            strip.add_adjoint(error, totals, rest)
    if totals:
        _add_coarse(gradient, planes, sampler, totals)
    return values


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
    groups: list[torch.Tensor],
    samplers: Sequence[Sampler],
    masks: Sequence[torch.Tensor | None],
    others: Sequence[torch.Tensor],
) -> list[torch.Tensor]:
    """Return mean and standard deviation of a pyramid's bands, each over a pixel's pooling region.

    Parameters
    ----------
    groups : list of torch.Tensor
        Bands ``[B, C, K, H, W]`` as :meth:`SpatialSteerablePyramid.stacked_bands` returns them.
    samplers : sequence of Sampler
        Those that compute the local means of each group.
    masks : sequence of torch.Tensor or None
        How much each pixel counts ``[H, W]``, for each group.
    others : sequence of torch.Tensor
        Maps that are compared without pooling, times their own masks, first of all the last low-pass.

    Returns
    -------
    list of torch.Tensor
        Mean and deviation of the high-pass residual and of each band of each level, 2(1 + (n − 1)K) tensors
        ``[B, C, H, W]``, and `others`.
    """
    maps: list[torch.Tensor] = []
    for bands, sampler, mask in zip(groups, samplers, masks, strict=True):
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
