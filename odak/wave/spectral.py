"""Filtering by a transfer function: the linear operator behind every propagation."""

from collections.abc import Callable

from odak import _array

_convolvers: dict[str, Callable] = {}


def register_convolver(library: str, convolver: Callable) -> None:
    """Let `convolver` filter the arrays of `library` ("torch"); it must compute what :func:`convolve` does."""
    _convolvers[library] = convolver


def convolve(field, kernel):
    """Return the field filtered by `kernel`, on the field's own window.

    The field ``[..., m, n]`` is continued by zeros to the kernel's size ``[..., M, N]`` (M ≥ m, N ≥ n), transformed,
    multiplied by the kernel (FFT order), transformed back and cut to ``[..., m, n]`` again. Cyclic convolution does
    not care where the window sits, so it starts at index 0 and nothing is shifted; rows that are zero are not
    transformed going in, rows that are cut are not transformed coming out.

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
    if _array.is_torch(field) and "torch" in _convolvers:
        return _convolvers["torch"](field, kernel)
    return convolve_plainly(field, kernel)


def convolve_plainly(field, kernel):
    """Return :func:`convolve` by the array library's own transforms."""
    xp = _array.namespace(field, kernel)
    rows, columns = field.shape[-2:]
    spectrum = xp.fft.fft(field, n=kernel.shape[-1], axis=-1)
    spectrum = xp.fft.fft(spectrum, n=kernel.shape[-2], axis=-2) * kernel
    filtered = xp.fft.ifft(spectrum, axis=-2)[..., :rows, :]
    return xp.astype(xp.fft.ifft(filtered, axis=-1)[..., :columns], field.dtype, copy=False)


def upsample(field):
    """Return the band-limited interpolation of a field on twice as many samples (half the pitch), same centre."""
    xp = _array.namespace(field)
    axes = (-2, -1)
    rows, columns = field.shape[-2:]
    from odak.tools.matrix import zero_pad

    spectrum = xp.fft.fftshift(xp.fft.fftn(xp.fft.ifftshift(field, axes=axes), axes=axes), axes=axes)
    spectrum = xp.fft.ifftshift(zero_pad(spectrum, [2 * rows, 2 * columns]), axes=axes)
    return xp.astype(4 * xp.fft.fftshift(xp.fft.ifftn(spectrum, axes=axes), axes=axes), field.dtype, copy=False)
