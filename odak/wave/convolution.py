"""Filtering of fields by a transfer function: the linear operator behind every propagation."""

import functools
import importlib
from collections.abc import Callable

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
    return _torch_operator()(field, kernel) if _array.is_torch(field) else convolve_plainly(field, kernel)


@functools.cache
def _torch_operator() -> Callable:
    """Return the operator for tensors, which has an adjoint of its own; it is loaded with the first tensor."""
    return importlib.import_module("odak.learn.wave.convolution").convolve


def convolve_plainly(field, kernel):
    """Return :func:`convolve` by the array library's own transforms."""
    spectrum = spectrum_of(field, kernel.shape[-2:]) * kernel
    return window_of(spectrum, field.shape[-2:], field.dtype)


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
