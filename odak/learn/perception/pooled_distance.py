"""Distance between the pooled statistics of bands and those of a target, and its gradient, in one pass over strips.

Maps of means and deviations are never held whole: a strip of them is made, compared and differentiated while it is in
the cache. Planes are laid out as ``[H, P, W]``; statistics as ``[H, 2, P, W]``, means first.
"""

import torch

from odak.learn.perception.mip_sampling import Sampler, plane_chunks, strip_memory

VARIANCE_FLOOR = 1e-7


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
            # Somebody wants derivatives of the gradient: made anew, from parts that have them.
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
        slope = gradient[:, chunk] if wanted else None
        values += _compare(planes[:, chunk], sampler, weights, target[:, :, chunk], slope)
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
    slope, steepness = error.unbind(1)
    mean, deviation = found.unbind(1)
    # d(e²) = 2e·dσ and dσ = d(power)/2σ − mean·d(mean)/σ; where the variance is cut off, nothing.
    steepness.div_(deviation).mul_(varies)
    slope.addcmul_(mean, steepness, value=-1).mul_(2)


def _add_coarse(gradient, planes, sampler, totals):
    """Add to the gradient what comes back from the coarse levels."""
    halved, first = sampler.coarse_adjoint(totals), sampler.levels[0]
    if first.rows is not None:
        slope, steepness = first.rows.on_rows_adjoint(halved).unbind(1)
        gradient.add_(slope).addcmul_(planes, steepness, value=2)
        return
    slope, steepness = halved.unbind(1)
    pairs = gradient.unflatten(0, (-1, 2))
    pairs.add_(slope[:, None], alpha=0.5).addcmul_(planes.unflatten(0, (-1, 2)), steepness[:, None])


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
