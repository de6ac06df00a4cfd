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
    source = chirp(field, sign * step, field.shape[axis], axis)
    target = chirp(field, sign * step, count, axis)
    return target * spread_by_chirp(field * source, sign * step, count, axis)


def chirp(like, step, count: int, axis: int):
    """Return exp(iπ·step·n²) for `count` samples n about zero along an axis, in the dtype of the field `like`."""
    return phasor_of_cycles(step * _line(like, -(count // 2), count, axis) ** 2 / 2, like.dtype)


def spread_by_chirp(field, step, count: int, axis: int):
    """Return Σ_n u_n·exp(−iπ·step·(k − n)²), the convolution that a chirp-z transform has between its two chirps.

    Parameters and result are those of :func:`fourier_sum`, the sign being that of the step.
    """
    xp = _array.namespace(field)
    n_in = field.shape[axis]
    total = n_in + count - 1
    length = scipy.fft.next_fast_len(total)
    lags = _line(field, 1 - count // 2 - n_in + n_in // 2, total, axis)
    response = xp.fft.fft(phasor_of_cycles(-step * lags**2 / 2, field.dtype), n=length, axis=axis)
    summed = xp.fft.ifft(xp.fft.fft(field, n=length, axis=axis) * response, axis=axis)
    return xp.astype(_slice(summed, n_in - 1, count, axis), field.dtype, copy=False)


def _line(like, start: int, count: int, axis: int):
    xp = _array.namespace(like)
    line = xp.arange(start, start + count, dtype=xp.float64, device=_array.device_of(like))
    return xp.reshape(line, (-1, 1) if axis == -2 else (1, -1))


def _slice(array, start: int, count: int, axis: int):
    return array[..., start : start + count] if axis == -1 else array[..., start : start + count, :]
