"""Convolution whose kernel is another one at every pixel: a fixed kernel times a map of factors.

Windows of the picture times the map is a matrix of k² times the picture's size, which one product with the weights
turns into the result. Here it exists only for some rows at a time, few enough to stay in the cache, and the backward
pass forms it again; nothing but the inputs is kept.
"""

import itertools
import math
from collections.abc import Iterator

import torch

from odak.raytracing.batches import is_transformed

# An eighth of this is quicker on an idle machine, but each operation on a part is a meeting of all threads, which costs
# milliseconds on a busy one. A GPU has no use for the cache, only for less memory.
_CPU_BYTES = 1 << 25
_GPU_BYTES = 1 << 28


def modulated_convolution(
    x: torch.Tensor, factors: torch.Tensor, weight: torch.Tensor, stride: int = 1, padding: int = 0
) -> torch.Tensor:
    r"""Return the convolution of pictures with a kernel that is multiplied by other factors at every pixel.

    .. math:: y_{o}(p) = \sum_{c,t} w_{oct}\, f_{ct}(p)\, x_c(s\,p + t)

    Differentiable any number of times in all three.

    Parameters
    ----------
    x : torch.Tensor
        Pictures ``[B, C, H, W]``.
    factors : torch.Tensor
        ``[B, C·k², H', W']``, the channel first, then the row and the column inside the kernel.
    weight : torch.Tensor
        ``[out, C, k, k]``.
    stride : int
        Step of the kernel in pixels.
    padding : int
        Zeros around the picture.

    Returns
    -------
    torch.Tensor
        ``[B, out, H', W']``, H' = (H + 2·padding − k) // stride + 1.
    """
    device, tensors = x.device.type, (x, factors, weight)
    if torch.amp.is_autocast_available(device) and torch.is_autocast_enabled(device) and x.dtype != torch.float64:
        x, factors, weight = tensors = [tensor.to(torch.get_autocast_dtype(device)) for tensor in tensors]
    if is_transformed(*tensors):
        return _plainly(x, factors, weight, stride, padding)
    return _ModulatedConvolution.apply(x, factors, weight, stride, padding)


def _plainly(x, factors, weight, stride, padding):
    """Return the same in one piece, by operations that differentiate themselves."""
    windows = _windows(torch.nn.functional.pad(x, [padding] * 4), weight.shape[-1], stride)
    modulated = _columns(windows * factors.view(windows.shape))
    return (weight.flatten(1) @ modulated).unflatten(2, windows.shape[-2:])


def _windows(padded, size, stride):
    """Return ``[B, C, k, k, H', W']``, a view: for each place inside the kernel the picture that it meets."""
    return padded.unfold(2, size, stride).unfold(3, size, stride).permute(0, 1, 4, 5, 2, 3)


def _parts(windows) -> Iterator[tuple[slice, slice, slice]]:
    """Yield ranges of the batch, of the rows of windows, and of the pixels in them; each part is of bounded size."""
    batch, rows, width = (windows.shape[axis] for axis in (0, 4, 5))
    limit = _CPU_BYTES if windows.device.type == "cpu" else _GPU_BYTES
    count = max(1, limit // (math.prod(windows.shape[1:4]) * width * windows.element_size()))
    pictures = max(1, count // rows)
    count = math.ceil(rows / math.ceil(rows / count))
    for b in range(0, batch, pictures):
        for r in range(0, rows, count):
            end = min(r + count, rows)
            yield slice(b, b + pictures), slice(r, end), slice(r * width, end * width)


class _ModulatedConvolution(torch.autograd.Function):
    """The product, part by part; trilinear, so that each gradient is a product of the other two and what comes back."""

    @staticmethod
    def forward(x, factors, weight, stride, padding):
        windows = _windows(torch.nn.functional.pad(x, [padding] * 4), weight.shape[-1], stride)
        maps, matrix = factors.view(windows.shape), weight.flatten(1)
        result = x.new_empty(len(x), len(weight), *windows.shape[-2:])
        columns = result.flatten(2)
        scratch = _Scratch(x)
        for b, r, pixels in _parts(windows):
            window = windows[b, ..., r, :]
            modulated = torch.mul(window, maps[b, ..., r, :], out=scratch.like(window))
            torch.bmm(matrix.expand(len(window), -1, -1), _columns(modulated), out=columns[b, :, pixels])
        return result

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.save_for_backward(*inputs[:3])
        ctx.options = inputs[3:]

    @staticmethod
    def backward(ctx, gradient):
        tensors, wanted = ctx.saved_tensors, ctx.needs_input_grad[:3]
        if not torch.is_grad_enabled():
            return *_gradients(*tensors, *ctx.options, gradient, wanted), None, None
        # Views of their own: an argument made from another must not pass its gradient on to it here.
        tensors = [tensor.view_as(tensor) for tensor in tensors]
        chosen = [tensor for tensor, needed in zip(tensors, wanted, strict=True) if needed]
        found = iter(torch.autograd.grad(_plainly(*tensors, *ctx.options), chosen, gradient, create_graph=True))
        return *(next(found) if needed else None for needed in wanted), None, None


class _Scratch:
    """Memory of one part, used again for the next: clearing fresh memory takes longer than the product."""

    def __init__(self, example: torch.Tensor):
        self._memory = example.new_empty(0)

    def like(self, window: torch.Tensor) -> torch.Tensor:
        if self._memory.numel() < window.numel():
            self._memory = self._memory.new_empty(window.numel())
        return self._memory[: window.numel()].view(window.shape)


def _columns(windows):
    """Return windows as ``[B, C·k², pixels]``."""
    return windows.flatten(1, 3).flatten(2)


def _gradients(x, factors, weight, stride, padding, gradient, wanted):
    """Return the gradients of picture, factors and weight, None where not wanted."""
    size = weight.shape[-1]
    padded = torch.nn.functional.pad(x, [padding] * 4)
    windows, matrix = _windows(padded, size, stride), weight.flatten(1)
    maps, incoming = factors.view(windows.shape), gradient.flatten(2)
    to_x = torch.zeros_like(padded)
    to_windows = _windows(to_x, size, stride)
    to_maps = windows.new_empty(windows.shape) if wanted[1] else None
    to_matrix = torch.zeros_like(matrix)
    scratch = _Scratch(x)
    for b, r, pixels in _parts(windows):
        window, factor, arrived = windows[b, ..., r, :], maps[b, ..., r, :], incoming[b, :, pixels]
        room = scratch.like(window)
        if wanted[2]:
            torch.mul(window, factor, out=room)
            to_matrix += torch.bmm(arrived, _columns(room).mT).sum(0)
        if wanted[0] or wanted[1]:
            torch.bmm(matrix.T.expand(len(window), -1, -1), arrived, out=_columns(room))
        if wanted[1]:
            torch.mul(window, room, out=to_maps[b, ..., r, :])
        if wanted[0]:
            # One place of the kernel after the other: neighbouring windows add to the same pixels.
            for i, j in itertools.product(range(size), repeat=2):
                to_windows[b, :, i, j, r].addcmul_(room[:, :, i, j], factor[:, :, i, j])
    rows, columns = (slice(padding, padding + n) for n in x.shape[-2:])
    return (
        to_x[..., rows, columns] if wanted[0] else None,
        to_maps.view(factors.shape) if wanted[1] else None,
        to_matrix.view(weight.shape) if wanted[2] else None,
    )
