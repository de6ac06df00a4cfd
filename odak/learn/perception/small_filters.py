"""Correlation of planes with a few small filters on a processor: sixteen neighbouring results at a time."""

import torch
from torch.nn import functional

from odak.learn._precision import in_own_precision
from odak.learn.perception.pixel_blocks import is_plain

# A vector register's worth of results is computed as so many output channels.
LANES = 16


@in_own_precision
def correlate(image: torch.Tensor, taps: torch.Tensor, stride: int = 1) -> torch.Tensor:
    """Return the correlations of every plane, mirrored at its borders, with every filter.

    Parameters
    ----------
    image : torch.Tensor
        Real floats ``[B, C, H, W]``, sides longer than half a filter.
    taps : torch.Tensor
        Filters ``[K, k, k]`` of odd k, the same for all channels, in the image's precision.
    stride : int
        Every so many rows and columns, from the first on.

    Returns
    -------
    torch.Tensor
        ``[B, C, K, H / stride, W / stride]``, rounded up; differentiable any number of times in the image. On a CPU its
        memory is laid out as ``[H, B, C, K, W]``, which is what samplers of :mod:`odak.learn.perception.mip_sampling`
        read fastest.

    Notes
    -----
    Convolutions compute output channels side by side, and a plane has one. Sixteen copies of the filter, each shifted
    by one column more, are sixteen channels of a convolution that takes sixteen columns at a step: more products, and
    several times less time.
    """
    if _is_laned(image, taps):
        return _Correlation.apply(image, taps, stride)
    padded = functional.pad(image, (taps.shape[-1] // 2,) * 4, mode="reflect")
    planes = functional.conv2d(padded.flatten(0, 1)[:, None], taps[:, None], stride=stride)
    return planes.unflatten(0, image.shape[:2])


def _is_laned(image, taps):
    return is_plain(image) and image.dtype in (torch.float32, torch.float64) and not taps.requires_grad


class _Correlation(torch.autograd.Function):
    """The linear map; its gradient is the adjoint's value and the other way round."""

    @staticmethod
    def forward(image, taps, stride):
        reach = taps.shape[-1] // 2
        rows, columns = (-(-length // stride) for length in image.shape[-2:])
        planes = functional.pad(image, (reach,) * 4, mode="reflect").flatten(0, 1)
        # Whole steps of the lanes; what they compute of zeros is dropped.
        beyond = (-(-columns // LANES) * LANES - 1) * stride + taps.shape[-1] - planes.shape[-1]
        planes = _as_channels_last(functional.pad(planes, (0, beyond)) if beyond > 0 else planes)
        result = image.new_empty(rows, len(planes), len(taps), columns)
        for index, filt in enumerate(taps):
            lanes = functional.conv2d(planes, _shifted(filt[None], LANES, stride), stride=(stride, stride * LANES))
            result[:, :, index] = lanes.permute(2, 0, 3, 1).flatten(2)[..., :columns]
        return result.permute(1, 2, 0, 3).unflatten(0, image.shape[:2])

    @staticmethod
    def setup_context(context, inputs, output):
        image, context.taps, context.stride = inputs
        context.size = image.shape[-2:]

    @staticmethod
    def backward(context, gradient):
        return _Adjoint.apply(gradient, context.taps, context.stride, context.size), None, None


class _Adjoint(torch.autograd.Function):
    """The adjoint: each pixel gets what every correlation took of it."""

    @staticmethod
    def forward(gradient, taps, stride, size):
        # Pixels fall into stride² phases, each a correlation of its own.
        lanes, side = LANES // stride**2, taps.shape[-1]
        padded = [length + side - 1 for length in size]
        cells = -(-padded[0] // stride), -(-padded[1] // (stride * lanes)) * lanes
        before = -(-side // stride) - 1
        after = [cell - length for cell, length in zip(cells, gradient.shape[-2:], strict=True)]
        total = None
        for filt, part in zip(taps, gradient.flatten(0, 1).unbind(1), strict=True):
            planes = _as_channels_last(functional.pad(part, (before, after[1], before, after[0])))
            spread = functional.conv2d(planes, _shifted(_phases(filt, stride), lanes, 1), stride=(1, lanes))
            total = spread if total is None else total.add_(spread)
        phases = total.permute(0, 2, 3, 1).unflatten(-1, (stride, stride, lanes))
        # [N, cell, cells of lanes, row in the cell, column in the cell, lane] to rows and columns.
        pixels = phases.permute(0, 1, 3, 2, 5, 4).flatten(3).flatten(1, 2)[..., : padded[0], : padded[1]]
        folded = _folded(_folded(pixels, 1, side // 2), 2, side // 2)
        return folded.unflatten(0, gradient.shape[:2])

    @staticmethod
    def setup_context(context, inputs, output):
        _, context.taps, context.stride, _ = inputs

    @staticmethod
    def backward(context, gradient):
        return _Correlation.apply(gradient, context.taps, context.stride), None, None, None


def _as_channels_last(planes):
    """Return planes ``[N, H, W]`` as ``[N, 1, H, W]`` in the layout whose convolution vectorises output channels."""
    return planes.contiguous()[..., None].permute(0, 3, 1, 2)


def _shifted(filters, lanes, step):
    """Return filters ``[F, h, w]`` at `lanes` places along the row, `step` columns apart, ``[F·lanes, 1, h, …]``."""
    room = (lanes - 1) * step
    wide = functional.pad(filters, (room, room))
    places = wide.unfold(-1, filters.shape[-1] + room, step).flip(-2)
    return places.transpose(1, 2).flatten(0, 1)[:, None].contiguous(memory_format=torch.channels_last)


def _phases(filt, stride):
    """Return the parts of a filter that meet each phase of the pixels, turned round."""
    room = -filt.shape[-1] % stride
    parts = functional.pad(filt, (0, room, 0, room)).unflatten(1, (-1, stride)).unflatten(0, (-1, stride))
    return parts.permute(1, 3, 0, 2).flatten(0, 1).flip(-2, -1)


def _folded(planes, axis, reach):
    """Return the adjoint of mirroring an axis at both ends: what was mirrored goes back to where it came from."""
    length = planes.shape[axis] - 2 * reach
    middle = planes.narrow(axis, reach, length)
    if reach:
        middle.narrow(axis, 1, reach).add_(planes.narrow(axis, 0, reach).flip(axis))
        middle.narrow(axis, length - 1 - reach, reach).add_(planes.narrow(axis, reach + length, reach).flip(axis))
    return middle
