"""Discrete Fourier sums between any two uniform grids, by the chirp-z transform."""

import scipy.fft

from odak import _array
from odak._array import phasor_of_cycles


def fourier_sum(field, step, count: int, sign: int, axis: int):
    """Return Σ_n u_n·exp(sign·i2π·step·(n − N//2)·(k − K//2)) for k = 0 … K − 1, along one axis.

    With step = Δf·dx this takes samples of pitch dx to frequencies of pitch Δf (sign −1), or back (sign +1); with
    step = 1/N and K = N it is the centred discrete Fourier transform.

    Parameters
    ----------
    field : array
        Complex ``[..., rows, columns]``.
    step : array
        Product of the two pitches, float64, shaped ``[..., 1, 1]``. Differentiable.
    count : int
        Number of output samples K.
    sign : int
        +1 or -1.
    axis : int
        -1 or -2.

    Returns
    -------
    array
        `field` with `axis` of length `count`, in the field's dtype.

    Notes
    -----
    Rabiner, Schafer and Rader, Bell Syst. Tech. J. 48, 1249 (1969): with nk = (n² + k² − (k − n)²)/2 the sum becomes
    a convolution with a chirp, three fast transforms of at least N + K − 1 points.
    """
    xp = _array.namespace(field)
    n_in = field.shape[axis]
    total = n_in + count - 1
    length = scipy.fft.next_fast_len(total)
    first_in, first_out = -(n_in // 2), -(count // 2)
    lags = _line(field, first_out - (first_in + n_in - 1), total, axis)
    source = _chirp(_line(field, first_in, n_in, axis), sign * step, field.dtype)
    target = _chirp(_line(field, first_out, count, axis), sign * step, field.dtype)
    spread = xp.fft.fft(_chirp(lags, -sign * step, field.dtype), n=length, axis=axis)
    summed = xp.fft.ifft(xp.fft.fft(field * source, n=length, axis=axis) * spread, axis=axis)
    return xp.astype(target * _slice(summed, n_in - 1, count, axis), field.dtype, copy=False)


def _line(like, start: int, count: int, axis: int):
    xp = _array.namespace(like)
    line = xp.arange(start, start + count, dtype=xp.float64, device=_array.device_of(like))
    return xp.reshape(line, (-1, 1) if axis == -2 else (1, -1))


def _chirp(line, step, dtype):
    return phasor_of_cycles(step * line**2 / 2, dtype)


def _slice(array, start: int, count: int, axis: int):
    return array[..., start : start + count] if axis == -1 else array[..., start : start + count, :]
