"""The propagation operator in PyTorch: two transforms and a product, with a hand-written adjoint.

A = C·F⁻¹·H·F·P with P the continuation by zeros and C the cut, so A^H = C·F⁻¹·conj(H)·F·P: the adjoint is the same
operator with the conjugate kernel. Nothing but the kernel is saved for the backward pass.
"""

import math
import threading

import torch

from odak.wave.spectral import convolve_plainly, register_convolver

# Below this many padded samples the whole spectrum sits in the cache anyway and one call per axis is quicker.
_BLOCKED_FROM = 1 << 20
# Small parts stay in the cache; but each is a meeting of all threads, which costs milliseconds on a busy machine.
# 4 MB is as quick as 1 MB on an idle one and several times quicker when something else runs.
_BLOCK_BYTES = 1 << 22

_scratch = threading.local()


def convolve(field: torch.Tensor, kernel: torch.Tensor) -> torch.Tensor:
    """Return the field filtered by `kernel` on its own window; see :func:`odak.wave.spectral.convolve`.

    Differentiable any number of times in `field` and, when it requires grad, in `kernel`.
    """
    if kernel.requires_grad or torch._C._functorch.is_functorch_wrapped_tensor(kernel):
        return convolve_plainly(field, kernel)
    return _Convolution.apply(field, kernel, False)


class _Convolution(torch.autograd.Function):
    """The linear operator; `adjoint` conjugates the kernel."""

    @staticmethod
    def forward(field, kernel, adjoint):
        if field.device.type != "cpu" or kernel.shape[-2] * kernel.shape[-1] < _BLOCKED_FROM:
            return convolve_plainly(field, kernel.conj() if adjoint else kernel)
        return _convolve_in_blocks(field, kernel, adjoint)

    @staticmethod
    def setup_context(ctx, inputs, output):
        field, kernel, ctx.adjoint = inputs
        ctx.batch = field.shape[:-2]
        # Kernels are shared between calls and never written to, so keeping a reference is safe.
        ctx.save_for_backward(kernel)
        ctx.save_for_forward(kernel)

    @staticmethod
    def backward(ctx, gradient):
        (kernel,) = ctx.saved_tensors
        back = _Convolution.apply(gradient, kernel, not ctx.adjoint)
        return back.sum_to_size(*ctx.batch, *back.shape[-2:]), None, None

    @staticmethod
    def jvp(ctx, tangent, *_):
        (kernel,) = ctx.saved_tensors
        return _Convolution.apply(tangent, kernel, ctx.adjoint)

    @staticmethod
    def vmap(info, in_dims, field, kernel, adjoint):
        rank = max(array.ndim - (dim is not None) for array, dim in ((field, in_dims[0]), (kernel, in_dims[1])))
        return _Convolution.apply(
            _batch_first(field, in_dims[0], rank), _batch_first(kernel, in_dims[1], rank), adjoint
        ), 0


def _batch_first(array, dim, rank: int):
    """Return an array with its vmapped axis first and its own axes aligned to `rank`, so that the others broadcast."""
    if dim is None:
        return array
    array = array.movedim(dim, 0)
    return array.reshape(array.shape[0], *(1,) * (rank + 1 - array.ndim), *array.shape[1:])


def _convolve_in_blocks(field, kernel, adjoint):
    """Return the filtered field, columns taken a block at a time so that the padded spectrum never exists.

    A padded spectrum of 2160 × 3840 would be written and read four times and its fresh pages cleared by the kernel
    each time, which costs more than the arithmetic.
    """
    rows, columns = field.shape[-2:]
    batch = torch.broadcast_shapes(field.shape[:-2], kernel.shape[:-2])
    fields = field.expand(*batch, rows, columns).reshape(-1, rows, columns)
    kernel_batch = kernel.expand(*batch, *kernel.shape[-2:])
    result = field.new_empty((fields.shape[0], rows, columns))
    for index in range(fields.shape[0]):
        place = torch.unravel_index(torch.tensor(index), batch) if batch else ()
        _filter_one(fields[index], kernel_batch[tuple(int(i) for i in place)], adjoint, result[index])
    return result.reshape(*batch, rows, columns)


def _filter_one(field, kernel, adjoint, result):
    """Write the filtered field into `result`, every transform on a part that fits a core's cache.

    A transform's result is fresh memory even when `out` is given, so the parts are small and copied where they go.
    """
    rows, columns = field.shape
    height, width = kernel.shape
    spectrum = _buffer("spectrum", (rows, width), field.dtype)
    for part in _parts(rows, width, field):
        spectrum[part] = torch.fft.fft(field[part], n=width)
    for part in _parts(width, height, field):
        column = torch.fft.fft(_padded_columns(spectrum[:, part], height))
        factor = kernel[:, part].mT
        column.mul_(factor.conj() if adjoint else factor)
        spectrum[:, part] = torch.fft.ifft(column)[:, :rows].mT
    for part in _parts(rows, width, field):
        result[part] = torch.fft.ifft(spectrum[part])[:, :columns]


def _parts(count: int, length: int, field):
    """Yield slices of `count` lines of `length` numbers, about `_BLOCK_BYTES` each."""
    step = max(1, _BLOCK_BYTES // (length * field.element_size()))
    return (slice(start, min(start + step, count)) for start in range(0, count, step))


def _padded_columns(columns, height: int) -> torch.Tensor:
    """Return columns as contiguous rows, continued by zeros to `height`."""
    rows, count = columns.shape
    block = _buffer("block", (count, height), columns.dtype)
    block[:, :rows] = columns.mT
    block[:, rows:] = 0
    return block


def _buffer(name: str, shape, dtype) -> torch.Tensor:
    """Return scratch memory of this thread, kept between calls because fresh pages are slow."""
    held = getattr(_scratch, name, None)
    count = math.prod(shape)
    if held is None or held.dtype != dtype or held.numel() < count:
        with torch.inference_mode(False):
            held = torch.empty(count, dtype=dtype)
        setattr(_scratch, name, held)
    return held[:count].view(shape)


register_convolver("torch", convolve)
