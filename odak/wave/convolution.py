"""Filtering of fields by a transfer function: the linear operator behind every propagation."""

import functools
import importlib
from collections.abc import Callable

import numpy as np

from odak import _array
from odak.tools.matrix import zero_pad

# From this many samples on, a spectrum is computed in blocks that leave out the lines that are zero or cut off, and its
# kernel is laid out column by column. Smaller ones stay in the cache, where one call for both axes is quicker.
BLOCKED_FROM = 1 << 18


def convolve(field, kernel):
    """Return the field filtered by `kernel`, on the field's own window.

    The field ``[..., m, n]`` is continued by zeros to the kernel's size ``[..., M, N]`` (M ≥ m, N ≥ n), transformed,
    multiplied by the kernel (FFT order), transformed back and cut to ``[..., m, n]`` again. Cyclic convolution is
    independent of the position of the window, which starts at index 0, so that nothing is shifted; rows that are zero
    are not transformed going in, rows that are cut are not transformed coming out.

    Parameters
    ----------
    field : array
        Complex ``[..., m, n]``.
    kernel : array
        Complex ``[..., M, N]``; leading axes broadcast.

    Returns
    -------
    array
        Complex ``[..., m, n]``, in the field's dtype.
    """
    if _array.is_torch(field):
        return _torch_operator()(field, kernel)
    return (convolve_in_chunks if _array.is_chunked(field) else convolve_plainly)(field, kernel)


@functools.cache
def _torch_operator() -> Callable:
    """Return the operator for tensors, which has an adjoint of its own; it is loaded with the first tensor."""
    return importlib.import_module("odak.learn.wave.convolution").convolve


def convolve_plainly(field, kernel):
    """Return :func:`convolve` by the array library's own transforms."""
    spectrum = spectrum_of(field, kernel.shape[-2:]) * kernel
    return window_of(spectrum, field.shape[-2:], field.dtype)


def convolve_in_chunks(field, kernel):
    """Return :func:`convolve` of Dask arrays in chunks of any shape, in chunks of whole rows; nothing is computed yet.

    The transform along an axis needs whole lines of that axis: the field is laid out in chunks of whole rows, then of
    whole columns, where it meets the kernel, and of whole rows again.
    """
    from dask.array import fft

    size, (rows, columns) = kernel.shape[-2:], field.shape[-2:]
    spectrum = fft.fft(whole_lines(field, -1, size[1]), n=size[1], axis=-1)
    spectrum = fft.fft(whole_lines(spectrum, -2, size[0]), n=size[0], axis=-2)
    spectrum = spectrum * kernel.rechunk({-1: spectrum.chunks[-1], -2: -1})
    window = fft.ifft(spectrum, axis=-2)[..., :rows, :]
    window = fft.ifft(whole_lines(window, -1, size[1]), axis=-1)
    return window[..., :columns].astype(field.dtype)


def whole_lines(field, axis: int, length: int, dtype=None):
    """Return a Dask array in chunks of whole lines along `axis`: as many as fill a chunk at this length and dtype."""
    other = -3 - axis
    lines = lines_per_chunk(length, field.dtype if dtype is None else dtype)
    # Fields of a batch are in chunks of their own.
    layout = dict.fromkeys(range(field.ndim - 2), 1)
    return field.rechunk({**layout, axis: -1, other: min(lines, field.shape[other])})


def lines_per_chunk(length: int, dtype) -> int:
    """Return how many lines of `length` samples fill a chunk of Dask's setting "array.chunk-size"."""
    from dask import config
    from dask.utils import parse_bytes

    return max(1, parse_bytes(config.get("array.chunk-size")) // (length * np.dtype(dtype).itemsize))


def spectrum_of(field, size: tuple[int, int]):
    """Return the transform of a field continued by zeros to `size`, in FFT order."""
    xp = _array.namespace(field)
    return xp.fft.fft(xp.fft.fft(field, n=size[1], axis=-1), n=size[0], axis=-2)


def window_of(spectrum, shape: tuple[int, int], dtype):
    """Return the first rows and columns of the field that has this spectrum."""
    xp = _array.namespace(spectrum)
    field = xp.fft.ifft(xp.fft.ifft(spectrum, axis=-2)[..., : shape[0], :], axis=-1)
    return xp.astype(field[..., : shape[1]], dtype, copy=False)


def upsample(field):
    """Return the band-limited interpolation of a field on twice as many samples (half the pitch), same centre."""
    xp = _array.namespace(field)
    axes = (-2, -1)
    rows, columns = field.shape[-2:]
    spectrum = xp.fft.fftshift(xp.fft.fftn(xp.fft.ifftshift(field, axes=axes), axes=axes), axes=axes)
    spectrum = xp.fft.ifftshift(zero_pad(spectrum, [2 * rows, 2 * columns]), axes=axes)
    return xp.astype(4 * xp.fft.fftshift(xp.fft.ifftn(spectrum, axes=axes), axes=axes), field.dtype, copy=False)
