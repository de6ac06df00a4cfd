"""Discrete Fourier sums between uniform grids of any pitch (chirp-z), and at frequencies of any place.

The chirp-z transform goes between any two uniform grids exactly; runs of the frequencies of a discrete Fourier
transform (:class:`Line`) use fast transforms where they can; the non-uniform transform gives the spectrum anywhere.
"""

import importlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
import scipy.sparse

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
    return target * convolve_with_chirp(field * source, sign * step, count, axis)


def chirp(like, step, count: int, axis: int):
    """Return exp(iπ·step·n²) for `count` samples n about zero along an axis, in the dtype of the field `like`."""
    return phasor_of_cycles(step * _line(like, -(count // 2), count, axis) ** 2 / 2, like.dtype)


def convolve_with_chirp(field, step, count: int, axis: int):
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
    kept = slice(n_in - 1, n_in - 1 + count)
    return xp.astype(summed[..., kept] if axis == -1 else summed[..., kept, :], field.dtype, copy=False)


def _line(like, start: int, count: int, axis: int):
    xp = _array.namespace(like)
    line = xp.arange(start, start + count, dtype=xp.float64, device=_array.device_of(like))
    return xp.reshape(line, (-1, 1) if axis == -2 else (1, -1))


@dataclass(frozen=True)
class Line:
    """A run of `count` frequencies along an axis (-2 or -1), those of a discrete Fourier transform of `period`.

    The indices are `first`, `first` + 1, …; an index over the period is a frequency in cycles per sample of the field.
    """

    axis: int
    first: int
    count: int
    period: int

    def cycles(self, like):
        """Return the frequencies in cycles per sample, along the line's axis and in the library of `like`."""
        return (_indices(like, self.count, self.axis) + self.first) / self.period

    def held(self) -> "Line":
        """Return the part of the line that a sampled field holds, −½ to ½ cycles per sample."""
        first = max(self.first, -(self.period // 2))
        last = min(self.first + self.count, (self.period + 1) // 2)
        return Line(self.axis, first, max(1, last - first), self.period)


def centred(like, count: int, axis: int):
    """Return the indices −(count // 2), … along `axis` (-2 or -1), float64 in the library of `like`."""
    return _indices(like, count, axis) - count // 2


def _indices(like, count: int, axis: int):
    xp = _array.namespace(like)
    line = xp.arange(count, dtype=xp.float64, device=_array.device_of(like))
    return xp.reshape(line, (-1, 1) if axis == -2 else (1, -1))


def to_line(field, line: Line):
    """Return Σ u·exp(−i2πf·x) at the frequencies of `line`, for samples along its axis."""
    xp = _array.namespace(field)
    n = field.shape[line.axis]
    shifted = field * phasor_of_cycles(-line.first / line.period * centred(field, n, line.axis), field.dtype)
    spectrum = xp.fft.fft(shifted, n=line.period, axis=line.axis)
    if line.count > line.period:
        # A line longer than the period goes round once more.
        spectrum = xp.concat([spectrum] * -(-line.count // line.period), axis=line.axis)
    spectrum = spectrum[..., : line.count] if line.axis == -1 else spectrum[..., : line.count, :]
    # The transform counts samples from the first, we from the one in the middle.
    return spectrum * phasor_of_cycles(n // 2 / line.period * _indices(field, line.count, line.axis), field.dtype)


def from_line(spectrum, line: Line, pitch, count: int):
    """Return Σ U·exp(i2πf·x)/period at `count` samples along the axis of `line`.

    `pitch` is in units of the field's; None means the same, which a fast transform serves.
    """
    xp = _array.namespace(spectrum)
    positions = centred(spectrum, count, line.axis)
    if pitch is None:
        # At whole samples frequencies a period apart are the same.
        if line.count > line.period:
            spectrum, line = _folded(spectrum, line)
        back = phasor_of_cycles(-(count // 2) / line.period * _indices(spectrum, line.count, line.axis), spectrum.dtype)
        result = xp.fft.ifft(spectrum * back, n=line.period, axis=line.axis)
        result = result[..., :count] if line.axis == -1 else result[..., :count, :]
        return result * phasor_of_cycles(line.first / line.period * positions, result.dtype)
    pitch = xp.ones((1, 1), dtype=xp.float64, device=_array.device_of(spectrum)) if pitch is None else pitch
    result = fourier_sum(spectrum, pitch / line.period, count, +1, line.axis) / line.period
    # The sum counts frequencies from the one in the middle.
    middle = (line.first + line.count // 2) / line.period
    return result * phasor_of_cycles(middle * pitch * positions, result.dtype)


def _folded(spectrum, line: Line) -> tuple:
    """Return a spectrum and its line, with all that is beyond a period added to the first one."""
    xp = _array.namespace(spectrum)
    parts = []
    for start in range(0, line.count, line.period):
        part = slice(start, min(start + line.period, line.count))
        parts.append(spectrum[..., part] if line.axis == -1 else spectrum[..., part, :])
    short = parts[-1].shape[line.axis]
    rest = slice(short, None)
    last = (
        [parts[0][..., :short], parts[0][..., rest]]
        if line.axis == -1
        else [
            parts[0][..., :short, :],
            parts[0][..., rest, :],
        ]
    )
    folded = xp.concat([last[0] + parts[-1], last[1]], axis=line.axis)
    for part in parts[1:-1]:
        folded = folded + part
    return folded, Line(line.axis, line.first, line.period, line.period)


# Taps along an axis: the spreading error is about 10^(1 − taps) for twofold oversampling.
_TAPS = {"complex64": 8, "complex128": 14}


def spectrum_at(field, cycles_y, cycles_x):
    """Return Σ u[n, m]·exp(−i2π(cycles_y·(n − N//2) + cycles_x·(m − M//2))) at frequencies of any place.

    Parameters
    ----------
    field : array
        Complex ``[..., N, M]``.
    cycles_y, cycles_x : array
        Frequencies in cycles per sample, float64 ``[..., P, Q]``; leading axes broadcast against the field's.
        Differentiable.

    Returns
    -------
    array
        Complex ``[..., P, Q]`` in the field's dtype, to about 1e-7 (complex64) or 1e-12 (complex128) of its maximum.

    Notes
    -----
    The spectrum is computed on a grid twice as fine and interpolated by a window of finite width, whose transform the
    field is divided by first: exact but for the window's tails. Dutt and Rokhlin, SIAM J. Sci. Comput. 14, 1368
    (1993); window of Barnett, Magland and af Klinteberg, SIAM J. Sci. Comput. 41, C479 (2019), eq. 1.8.
    """
    xp = _array.namespace(field)
    taps = _TAPS["complex128" if field.dtype == xp.complex128 else "complex64"]
    sizes = [max(scipy.fft.next_fast_len(2 * n), 2 * taps) for n in field.shape[-2:]]
    for axis, size in zip((-2, -1), sizes, strict=True):
        field = _wrap(field / _window_transform(field, axis, size, taps), axis, size)
    fine = xp.fft.fftn(field, axes=(-2, -1))
    rows = _nearby(cycles_y, sizes[0], taps, field)
    columns = _nearby(cycles_x, sizes[1], taps, field)
    return _gather(fine, rows, columns)


def spectrum_along(field, cycles, axis: int):
    """Return Σ u[…, m]·exp(−i2π·cycles·(m − M//2)) along one axis, at frequencies that differ from line to line.

    Parameters
    ----------
    field : array
        Complex ``[..., N, M]``, its other axis already a frequency.
    cycles : array
        Frequencies in cycles per sample, float64 ``[..., N, Q]`` for axis -1, ``[..., Q, M]`` for axis -2.
    axis : int
        -1 or -2.

    Returns
    -------
    array
        Complex ``[..., N, Q]`` or ``[..., Q, M]``; method and precision are those of :func:`spectrum_at`.
    """
    xp = _array.namespace(field)
    if axis == -2:
        field, cycles = xp.matrix_transpose(field), xp.matrix_transpose(cycles)
        return xp.matrix_transpose(spectrum_along(field, cycles, -1))
    fine, size, taps = _fine_spectrum(field)
    # Continued by its beginning, so that no index has to go round.
    fine = xp.concat([fine, fine[..., :taps]], axis=-1)
    batch, width = np.broadcast_shapes(tuple(fine.shape[:-1]), tuple(cycles.shape[:-1])), size + taps
    flat = xp.reshape(xp.broadcast_to(fine, (*batch, width)), (-1,))
    first = xp.reshape(xp.arange(math.prod(batch), device=_array.device_of(fine)) * width, (*batch, 1))
    place = cycles * size
    nearest = xp.ceil(place - taps / 2)
    aside = xp.astype((nearest - place) * (2 / taps), _array.real_dtype(field))
    start = first + xp.astype(nearest, xp.int64) % size
    shape, start = start.shape, xp.reshape(start, (-1,))
    result = 0.0
    for tap in range(taps):
        weight = _window(xp.clip(aside + 2 * tap / taps, -1.0, 1.0), taps)
        result = result + xp.reshape(xp.take(flat, start + tap, axis=0), shape) * weight
    return result


def _fine_spectrum(field):
    """Return the spectrum along the last axis on a grid twice as fine, its length, and the taps to interpolate it."""
    xp = _array.namespace(field)
    taps = _TAPS["complex128" if field.dtype == xp.complex128 else "complex64"]
    size = max(scipy.fft.next_fast_len(2 * field.shape[-1]), 2 * taps)
    return xp.fft.fft(_wrap(field / _window_transform(field, -1, size, taps), -1, size), axis=-1), size, taps


class InterpolatedSpectrum:
    """The linear map of :func:`spectrum_along` or :func:`spectrum_at` at frequencies that stay, by a sparse matrix.

    Parameters
    ----------
    cycles_y, cycles_x : numpy.ndarray or None
        Frequencies in cycles per sample ``[P, Q]``, one set for all fields; None for the axis that is a frequency
        already, whose index is that of the result.
    shape : tuple of int
        Rows and columns of the field.
    double : bool
        True for complex128.
    needed : numpy.ndarray
        Boolean ``[P, Q]``: the result is zero elsewhere.
    """

    def __init__(self, cycles_y, cycles_x, shape: tuple[int, int], double: bool, needed: np.ndarray):
        self.transposed = cycles_x is None
        if self.transposed:
            cycles_x, shape, needed = cycles_y.T, shape[::-1], needed.T
        self.both = not self.transposed and cycles_y is not None
        taps = _TAPS["complex128" if double else "complex64"]
        sizes = [max(scipy.fft.next_fast_len(2 * n), 2 * taps) for n in shape]
        real = np.float64 if double else np.float32
        places, weights = _taps_of(cycles_x[needed] * sizes[1], taps, real)
        rows = np.nonzero(needed)[0]
        self.tap_weights: np.ndarray | None = None
        if self.both:
            first, down = _taps_of(cycles_y[needed] * sizes[0], taps, real)
            rows = first[:, 0] % sizes[0]
            self.tap_weights = np.zeros((taps, needed.size), dtype=real)
            self.tap_weights[:, needed.reshape(-1)] = down.T
        columns = (rows[:, None] * sizes[1] + places % sizes[1]).astype(np.int32).reshape(-1)
        starts = np.concatenate([[0], np.cumsum(needed.reshape(-1)) * taps]).astype(np.int32)
        lines = sizes[0] if self.both else len(needed)
        self.matrix = scipy.sparse.csr_matrix(
            (weights.reshape(-1), columns, starts), shape=(needed.size, lines * sizes[1])
        )
        self.shape, self.sizes = needed.shape, sizes
        self.held_bytes = columns.size * (4 + weights.itemsize)
        if self.tap_weights is not None:
            self.held_bytes += self.tap_weights.nbytes
        self._operator: Any = None

    def __call__(self, field):
        """Return the spectrum ``[..., P, Q]`` of a field."""
        xp = _array.namespace(field)
        if self.transposed:
            field = xp.matrix_transpose(field)
        if not self.both:
            fine = _fine_spectrum(field)[0]
            flat = xp.reshape(fine, (-1, math.prod(fine.shape[-2:])))
            result = xp.reshape(self._product(flat), (*fine.shape[:-2], *self.shape))
            return xp.matrix_transpose(result) if self.transposed else result
        taps, size = len(self.tap_weights), math.prod(self.sizes)
        for axis, n in zip((-2, -1), self.sizes, strict=True):
            field = _wrap(field / _window_transform(field, axis, n, taps), axis, n)
        fine = xp.reshape(xp.fft.fftn(field, axes=(-2, -1)), (-1, size))
        # The same matrix serves each tap along rows, on the spectrum moved by a row.
        fine = xp.concat([fine, fine[:, : (taps - 1) * self.sizes[1]]], axis=-1)
        return xp.reshape(self._product(fine), (*field.shape[:-2], *self.shape))

    def _product(self, flat):
        if _array.is_torch(flat):
            if self._operator is None:
                module = importlib.import_module("odak.learn.wave.convolution")
                self._operator = module.sparse_operator(self.matrix, self.tap_weights, self.sizes[1])
            return self._operator(flat)
        return np.stack([self._product_of_one(np.ascontiguousarray(one)) for one in flat])

    def _product_of_one(self, flat):
        columns, inside, result = flat.view(flat.real.dtype).reshape(-1, 2), self.matrix.shape[1], 0.0
        for term in range(len(self.tap_weights) if self.both else 1):
            start = term * self.sizes[1]
            part = self.matrix @ columns[start : start + inside]
            result = result + (part * self.tap_weights[term][:, None] if self.both else part)
        return np.ascontiguousarray(result).view(flat.dtype)[..., 0]


def _taps_of(place, taps: int, dtype):
    """Return the indices of the fine frequencies near those asked for, ``[points, taps]``, and the window's values."""
    nearest = np.ceil(place - taps / 2)
    indices = nearest[:, None] + np.arange(taps)
    values = _window(np.clip((indices - place[:, None]) * (2 / taps), -1.0, 1.0), taps)
    return indices.astype(np.int64), values.astype(dtype)


def _gather(fine, rows, columns):
    """Return the sum over all pairs of taps, each an index and a weight along its axis."""
    xp = _array.namespace(fine)
    size_y, size_x = fine.shape[-2:]
    points = rows[0][0].shape
    batch = np.broadcast_shapes(tuple(points[:-2]), tuple(fine.shape[:-2]))
    flat = xp.reshape(xp.broadcast_to(fine, (*batch, size_y, size_x)), (-1,))
    first = xp.arange(math.prod(batch), device=_array.device_of(fine)) * (size_y * size_x)
    first = xp.reshape(first, (*batch, 1, 1))
    result = 0.0
    for index_y, weight_y in rows:
        line = 0.0
        for index_x, weight_x in columns:
            index = first + index_y * size_x + index_x
            line = line + xp.reshape(xp.take(flat, xp.reshape(index, (-1,)), axis=0), index.shape) * weight_x
        result = result + line * weight_y
    return result


def _nearby(cycles, size: int, taps: int, field) -> list[tuple]:
    """Return, for each tap, the index of a fine frequency near those asked for and the window's value there."""
    xp = _array.namespace(field)
    place = cycles * size
    nearest = xp.ceil(place - taps / 2)
    result = []
    for tap in range(taps):
        index = nearest + tap
        value = _window(xp.clip((index - place) * (2 / taps), -1.0, 1.0), taps)
        result.append((xp.astype(index % size, xp.int64), xp.astype(value, _array.real_dtype(field))))
    return result


def _window(t, taps: int):
    """Return exp(2.3·taps·(sqrt(1 − t²) − 1)) for |t| ≤ 1."""
    xp = _array.namespace(t)
    # At the very edge the root has no gradient, and the window is negligible.
    return xp.exp(2.3 * taps * (xp.sqrt(xp.maximum(1 - t**2, 1e-12 + 0 * t)) - 1))


def _window_transform(field, axis: int, size: int, taps: int):
    """Return the window's Fourier transform at the field's samples, by Gauss–Legendre quadrature."""
    xp = _array.namespace(field)
    count = field.shape[axis]
    nodes, weights = np.polynomial.legendre.leggauss(64)
    samples = np.arange(count) - count // 2
    cosines = np.cos(np.pi * taps / size * nodes[:, None] * samples)
    values = taps / 2 * (weights * _window(nodes, taps)) @ cosines
    values = xp.astype(xp.asarray(values, device=_array.device_of(field)), field.dtype)
    return xp.reshape(values, (-1, 1) if axis == -2 else (1, -1))


def _wrap(field, axis: int, size: int):
    """Return a field continued by zeros to `size` along an axis, its sample n // 2 at index 0."""
    xp = _array.namespace(field)
    count = field.shape[axis]
    middle = count // 2
    shape = list(field.shape)
    shape[axis] = size - count
    zeros = xp.zeros(tuple(shape), dtype=field.dtype, device=_array.device_of(field))
    if axis == -1:
        return xp.concat([field[..., middle:], zeros, field[..., :middle]], axis=-1)
    return xp.concat([field[..., middle:, :], zeros, field[..., :middle, :]], axis=-2)
