"""Discrete Fourier sums between uniform grids of any pitch (chirp-z), and at frequencies of any place.

The chirp-z transform goes between any two uniform grids exactly; runs of the frequencies of a discrete Fourier
transform (:class:`Line`) use fast transforms where they can; the non-uniform transform gives the spectrum anywhere.
"""

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
import scipy.sparse

from odak import _array
from odak._array import Array, DType, phasor_of_cycles


def fourier_sum(field: Array, step: Array, count: int, sign: int, axis: int) -> Array:
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


def chirp(like: Array, step: Array, count: int, axis: int) -> Array:
    """Return exp(iπ·step·n²) for `count` samples n about zero along an axis, in the dtype of the field `like`."""
    return phasor_of_cycles(step * _line(like, -(count // 2), count, axis) ** 2 / 2, like.dtype)


def convolve_with_chirp(field: Array, step: Array, count: int, axis: int) -> Array:
    """Return Σ_n u_n·exp(−iπ·step·(k − n)²), the convolution that a chirp-z transform has between its two chirps.

    Parameters and result are as in :func:`fourier_sum`; the sign is included in the step.
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
    """A run of `count` frequencies along an axis (-2 or -1) of a discrete Fourier transform of `period` samples.

    The indices are `first`, `first` + 1, …; an index over the period is a frequency in cycles per sample of the field.
    """

    axis: int
    first: int
    count: int
    period: int

    def cycles(self, like: Array) -> Array:
        """Return the frequencies in cycles per sample, along the line's axis and in the library of `like`."""
        return (_indices(like, self.count, self.axis) + self.first) / self.period

    def held(self) -> "Line":
        """Return the part of the line that a sampled field holds, −½ to ½ cycles per sample."""
        first = max(self.first, -(self.period // 2))
        last = min(self.first + self.count, (self.period + 1) // 2)
        return Line(self.axis, first, max(1, last - first), self.period)


def centred(like: Array, count: int, axis: int) -> Array:
    """Return the indices −(count // 2), … along `axis` (-2 or -1), float64 in the library of `like`."""
    return _indices(like, count, axis) - count // 2


def _indices(like, count: int, axis: int):
    xp = _array.namespace(like)
    line = xp.arange(count, dtype=xp.float64, device=_array.device_of(like))
    return xp.reshape(line, (-1, 1) if axis == -2 else (1, -1))


def with_last(field: Array, axis: int) -> Array:
    """Return an array with one of its last two axes, −1 or −2, as the last; applied twice, it is as before.

    Batches of :func:`torch.func.vmap` have no rule for moving an axis in general.
    """
    return _array.namespace(field).matrix_transpose(field) if axis == -2 else field


def to_line(field: Array, line: Line) -> Array:
    """Return Σ u·exp(−i2πf·x) at the frequencies of `line`, for samples along its axis."""
    return to_line_from_first(field, line) * phase_of_first(field, line, field.shape[line.axis])


def to_line_from_first(field: Array, line: Line) -> Array:
    """Return the sums of :func:`to_line` without the phase that counts samples from the one in the middle."""
    xp = _array.namespace(field)
    n = field.shape[line.axis]
    shifted = field * phasor_of_cycles(-line.first / line.period * centred(field, n, line.axis), field.dtype)
    # Zeros are appended, and samples transformed, fastest along the last axis.
    spectrum = xp.fft.fft(with_last(shifted, line.axis), n=line.period, axis=-1)
    if line.count > line.period:
        # A line longer than the period goes round once more.
        spectrum = xp.concat([spectrum] * -(-line.count // line.period), axis=-1)
    return with_last(spectrum[..., : line.count], line.axis)


def phase_of_first(like: Array, line: Line, count: int) -> Array:
    """Return the phase that :func:`to_line_from_first` leaves out for `count` samples, in the dtype of `like`."""
    return phasor_of_cycles(count // 2 / line.period * _indices(like, line.count, line.axis), like.dtype)


def from_line(spectrum: Array, line: Line, pitch: Any, count: int) -> Array:
    """Return Σ U·exp(i2πf·x)/period at `count` samples along the axis of `line`.

    `pitch` is in units of the field's; None means the same, which a fast transform serves if `count` is not more than
    the period.
    """
    xp = _array.namespace(spectrum)
    positions = centred(spectrum, count, line.axis)
    if pitch is None:
        # At whole samples frequencies a period apart are the same.
        if line.count > line.period:
            spectrum, line = _folded(spectrum, line)
        result = _middle(xp.fft.ifft(spectrum, n=line.period, axis=line.axis), count, line.axis)
        if line.first == 0:
            return result
        return result * phasor_of_cycles(line.first / line.period * positions, result.dtype)
    result = fourier_sum(spectrum, pitch / line.period, count, +1, line.axis) / line.period
    # The sum counts frequencies from the one in the middle.
    middle = (line.first + line.count // 2) / line.period
    return result * phasor_of_cycles(middle * pitch * positions, result.dtype)


def _middle(periodic, count: int, axis: int):
    """Return `count` samples about sample 0 of a periodic array."""
    xp = _array.namespace(periodic)
    along = with_last(periodic, axis)
    parts = [along[..., along.shape[-1] - count // 2 :], along[..., : count - count // 2]]
    return with_last(xp.concat(parts, axis=-1), axis)


def _folded(spectrum, line: Line) -> tuple[Any, ...]:
    """Return the spectrum with samples a period apart added, which is what its inverse transform sees of them."""
    xp = _array.namespace(spectrum)
    along = with_last(spectrum, line.axis)
    shape = (*along.shape[:-1], -line.count % line.period)
    rest = xp.zeros(shape, dtype=along.dtype, device=_array.device_of(along))
    periods = xp.reshape(xp.concat([along, rest], axis=-1), (*shape[:-1], -1, line.period))
    return with_last(xp.sum(periods, axis=-2), line.axis), Line(line.axis, line.first, line.period, line.period)


# Taps along an axis: the spreading error is about 10^(1 − taps) for twofold oversampling.
_TAPS = {"complex64": 8, "complex128": 14}
_TAPS_OF_STEPS = {"complex64": 7, "complex128": 12}


def spectrum_at(field: Array, cycles_y: Any, cycles_x: Any) -> Any:
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
    sizes = [_fine_size(n, taps) for n in field.shape[-2:]]
    for axis, size in zip((-2, -1), sizes, strict=True):
        field = _wrap(field * _window_compensation(field, axis, size, taps), axis, size)
    fine = xp.fft.fftn(field, axes=(-2, -1))
    rows = _nearby(cycles_y, sizes[0], taps, field)
    columns = _nearby(cycles_x, sizes[1], taps, field)
    return _gather(fine, rows, columns)


def compensated(field: Array) -> Any:
    """Return a field divided along its last axis by the transform of the window that interpolates its spectrum."""
    taps = _taps_of_steps(field.dtype)
    return field * _window_compensation(field, -1, _fine_size(field.shape[-1], taps), taps)


def spectrum_along(field: Array, cycles: Any) -> Any:
    """Return Σ u[…, m]·exp(−i2π·cycles·(m − M//2)) along the last axis, at frequencies that differ from row to row.

    Parameters
    ----------
    field : array
        Complex ``[..., N, M]``, the result of :func:`compensated`; its rows may be frequencies already.
    cycles : array
        Frequencies in cycles per sample, float64 ``[..., N, Q]``. Differentiable.

    Returns
    -------
    array
        Complex ``[..., N, Q]``, to about 1e-6 (complex64) or 2e-11 (complex128) of its norm, by the method of
        :func:`spectrum_at`.
    """
    xp, taps = _array.namespace(field), _taps_of_steps(field.dtype)
    fine = _fine_spectrum(field)
    size = fine.shape[-1]
    # Continued by its beginning, so that no index has to go round.
    fine = xp.concat([fine, fine[..., :taps]], axis=-1)
    batch, width = np.broadcast_shapes(tuple(fine.shape[:-1]), tuple(cycles.shape[:-1])), size + taps
    flat = xp.reshape(xp.broadcast_to(fine, (*batch, width)), (-1,))
    first = xp.reshape(xp.arange(math.prod(batch), device=_array.device_of(fine)) * width, (*batch, 1))
    nearest, weights = _taps_around(cycles * size, taps, field)
    start = first + nearest % size
    shape, start = start.shape, xp.reshape(start, (-1,))
    result = 0.0
    for tap, weight in enumerate(weights):
        result = result + xp.reshape(xp.take(flat, start + tap, axis=0), shape) * weight
    return result


def spread_along(spectrum: Any, cycles: Any, line: Line, width: int) -> Any:
    """Return values on `line` whose sum over its frequencies equals the sum of `spectrum` over its own, along axis -2.

    Columns `width` apart are added.

    After :func:`from_line`, the result is to be multiplied by :func:`compensation`. This is the transpose of
    :func:`spectrum_along`, a non-uniform Fourier transform of type 1 in the terms of its references.

    Parameters
    ----------
    spectrum : array
        Complex ``[..., P, Q]`` of NumPy or PyTorch.
    cycles : array
        Its frequencies in cycles per sample, float64 ``[..., P, Q]``, within the range given to :func:`spreading_line`.
        Differentiable.
    line : Line
        Frequencies of the result, of :func:`spreading_line`.
    width : int
        Columns of the result.

    Returns
    -------
    array
        Complex ``[..., frequencies of the line, width]``.
    """
    xp, taps = _array.namespace(spectrum), _taps_of_steps(spectrum.dtype)
    batch = np.broadcast_shapes(tuple(spectrum.shape[:-2]), tuple(cycles.shape[:-2]))
    height, columns = spectrum.shape[-2:]
    nearest, weights = _taps_around(cycles * line.period, taps, spectrum)
    device = _array.device_of(spectrum)
    plane = xp.reshape(xp.arange(math.prod(batch), device=device) * (line.count * width), (*batch, 1, 1))
    place = plane + xp.arange(columns, device=device) % width
    result = xp.zeros(math.prod(batch) * line.count * width, dtype=spectrum.dtype, device=device)
    for tap, weight in enumerate(weights):
        index = place + (nearest + tap - line.first) % line.count * width
        values = xp.broadcast_to(spectrum * weight, (*batch, height, columns))
        index = xp.reshape(xp.broadcast_to(index, values.shape), (-1,))
        result = _array.added_at(result, index, xp.reshape(values, (-1,)))
    return xp.reshape(result, (*batch, line.count, width))


def spreading_line(ends: tuple[float, float], extent: float, whole: bool, dtype: DType) -> Line:
    """Return the line for sums over frequencies between two, in cycles per sample, at places over `extent` samples.

    If the places are `whole` samples, a period of frequencies is enough, in the order of a discrete transform.
    """
    taps = _taps_of_steps(dtype)
    period = scipy.fft.next_fast_len(max(math.ceil(2 * extent), 2 * taps))
    if whole:
        return Line(-2, 0, period, period)
    first, last = math.floor(ends[0] * period - taps / 2), math.ceil(ends[1] * period + taps / 2)
    return Line(-2, first, last + 1 - first, period)


def compensation(like: Any, line: Line, ratio: Any, count: int) -> Any:
    """Return the factor, along rows, that a sum over values of :func:`spread_along` needs at `count` places.

    `ratio` is their distance in samples, a number or an array ``[..., 1, 1]``. The division by the line's period in
    :func:`from_line` is undone.
    """
    xp, taps = _array.namespace(like), _taps_of_steps(like.dtype)
    nodes, weights = (xp.asarray(v, device=_array.device_of(like)) for v in _quadrature())
    places = centred(like, count, -2) * ratio
    cosines = xp.cos((math.pi * taps / line.period) * nodes * places)
    transform = xp.sum(cosines * (weights * _window(nodes, taps)), axis=-1, keepdims=True) * (taps / 2)
    return xp.astype(line.period / transform, _array.real_dtype(like))


def _taps_of_steps(dtype) -> int:
    return _TAPS_OF_STEPS["complex128" if "complex128" in str(dtype) else "complex64"]


def _fine_size(count: int, taps: int) -> int:
    """Return the frequencies of a spectrum that is interpolated."""
    return max(scipy.fft.next_fast_len(2 * count), 2 * taps)


def _fine_spectrum(field):
    """Return the spectrum of a compensated field along the last axis on a grid twice as fine."""
    size = _fine_size(field.shape[-1], _taps_of_steps(field.dtype))
    return _array.namespace(field).fft.fft(_wrap(field, -1, size), axis=-1)


class InterpolatedSpectrum:
    """The linear map of :func:`spectrum_along` at frequencies that stay, by a sparse matrix.

    Parameters
    ----------
    cycles : numpy.ndarray
        Frequencies in cycles per sample ``[N, Q]``, one set for all fields.
    count : int
        Samples of the field along its last axis.
    dtype : numpy.dtype or torch.dtype
        That of the field, complex64 or complex128.
    needed : numpy.ndarray, optional
        Boolean ``[N, Q]``; if given, the result holds the values that are needed, one after the other.
    """

    def __init__(self, cycles: Any, count: int, dtype: DType, needed: np.ndarray | None = None) -> None:
        size, rows = _fine_size(count, _taps_of_steps(dtype)), len(cycles)
        self.shape: Any = cycles.shape if needed is None else (int(needed.sum()),)
        needed = np.ones(cycles.shape, dtype=bool) if needed is None else needed
        starts = np.nonzero(needed)[0] * size
        self.map: _SparseMap = _SparseMap(_matrix_of_taps(cycles[needed] * size, size, starts, 1, rows * size, dtype))

    @property
    def held_bytes(self) -> int:
        """Return the bytes of the matrix."""
        return self.map.held_bytes

    def __call__(self, field: Array) -> Any:
        """Return the spectrum ``[..., N, Q]`` or ``[..., values]`` of compensated fields ``[..., N, samples]``."""
        fine = _fine_spectrum(field)
        flat = _array.namespace(field).reshape(fine, (-1, math.prod(fine.shape[-2:])))
        return _array.namespace(field).reshape(self.map(flat), (*fine.shape[:-2], *self.shape))


class SpreadSpectrum:
    """The linear map of :func:`spread_along` at frequencies that stay, by a sparse matrix.

    Parameters
    ----------
    cycles : numpy.ndarray
        Frequencies in cycles per sample ``[P, Q]``, one set for all spectra.
    line : Line
        Frequencies along axis -2 on which they are spread.
    width : int
        Columns of the result; columns that are this far apart are added.
    dtype : numpy.dtype or torch.dtype
        That of the spectrum, complex64 or complex128.
    needed : numpy.ndarray
        Boolean ``[P, Q]``: the frequencies of the values that will be given, one after the other.
    """

    def __init__(self, cycles: Any, line: Line, width: int, dtype: DType, needed: np.ndarray) -> None:
        self.shape: tuple[int, int] = (line.count, width)
        places, starts = cycles[needed] * line.period - line.first, np.nonzero(needed)[1] % width
        matrix = _matrix_of_taps(places, line.count, starts, width, line.count * width, dtype)
        self.map: _SparseMap = _SparseMap(matrix.T.tocsr())

    @property
    def held_bytes(self) -> int:
        """Return the bytes of the matrix."""
        return self.map.held_bytes

    def __call__(self, values: Any) -> Any:
        """Return the spectrum ``[..., frequencies of the line, width]`` of ``[..., values]``."""
        xp = _array.namespace(values)
        flat = xp.reshape(values, (-1, values.shape[-1]))
        return xp.reshape(self.map(flat), (*values.shape[:-1], *self.shape))


def _matrix_of_taps(places, period: int, starts, step: int, width: int, dtype) -> scipy.sparse.csr_matrix:
    """Return the matrix whose rows hold the taps around `places`, indices of a period that are `step` columns apart.

    Index 0 is in column `starts`.
    """
    taps, block = _taps_of_steps(dtype), 1 << 14
    shape = (len(places), taps)
    weights = np.empty(shape, dtype=np.float64 if "complex128" in str(dtype) else np.float32)
    columns = np.empty(shape, dtype=np.int32)
    # Blocks stay in the processor's cache.
    for part in (slice(first, first + block) for first in range(0, len(places), block)):
        nearest, values = _taps_around(places[part], taps, weights)
        for tap, value in enumerate(values):
            weights[part, tap] = value
        columns[part] = (nearest[:, None] + np.arange(taps)) % period * step + starts[part, None]
    bounds = np.arange(0, weights.size + 1, taps, dtype=np.int32)
    return scipy.sparse.csr_matrix((weights.reshape(-1), columns.reshape(-1), bounds), shape=(len(places), width))


class _SparseMap:
    """The product of a real sparse matrix with complex arrays ``[batch, columns of the matrix]``."""

    def __init__(self, matrix: scipy.sparse.csr_matrix) -> None:
        self.matrix = matrix
        self.held_bytes = matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes
        self._operator: Any = None

    def __call__(self, flat: Any) -> Any:
        if _array.is_torch(flat):
            if self._operator is None:
                from odak.wave.torch_convolution import SparseMap

                self._operator = SparseMap(self.matrix)
            return self._operator(flat)
        return np.stack([self._product_of_one(np.ascontiguousarray(one)) for one in flat])

    def _product_of_one(self, flat):
        result = self.matrix @ flat.view(flat.real.dtype).reshape(-1, 2)
        return np.ascontiguousarray(result).view(flat.dtype)[..., 0]


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


def _nearby(cycles, size: int, taps: int, field) -> list[tuple[Any, ...]]:
    """Return, for each tap, the index of a fine frequency near those asked for and the window's value there."""
    nearest, weights = _taps_around(cycles * size, taps, field)
    return [((nearest + tap) % size, weight) for tap, weight in enumerate(weights)]


def _taps_around(place, taps: int, like):
    """Return the index of the first of the fine frequencies near `place`, and an iterator of the window's values."""
    xp = _array.namespace(place)
    nearest = xp.ceil(place - taps / 2)
    aside = xp.astype((nearest - place) * (2 / taps), _array.real_dtype(like))
    weights = (_window(xp.clip(aside + 2 * tap / taps, -1.0, 1.0), taps) for tap in range(taps))
    return xp.astype(nearest, xp.int64), weights


@functools.cache
def _quadrature():
    """Return the nodes and weights of Gauss and Legendre by which the window is transformed."""
    return np.polynomial.legendre.leggauss(64)


def _window(t, taps: int):
    """Return exp(2.3·taps·(sqrt(1 − t²) − 1)) for |t| ≤ 1."""
    xp = _array.namespace(t)
    # At the very edge the root has no gradient, and the window is negligible.
    return xp.exp(2.3 * taps * (xp.sqrt(xp.maximum(1 - t**2, 1e-12 + 0 * t)) - 1))


def _window_compensation(field, axis: int, size: int, taps: int):
    """Return one over the window's Fourier transform at the field's samples along an axis."""
    values = _array.namespace(field).asarray(
        _compensation_of_samples(field.shape[axis], size, taps), device=_array.device_of(field)
    )
    values = _array.namespace(field).astype(values, _array.real_dtype(field))
    return _array.namespace(field).reshape(values, (-1, 1) if axis == -2 else (1, -1))


@functools.lru_cache(maxsize=64)
def _compensation_of_samples(count: int, size: int, taps: int) -> np.ndarray:
    """Return one over the window's Fourier transform at samples, by Gauss–Legendre quadrature."""
    nodes, weights = _quadrature()
    samples = np.arange(count) - count // 2
    cosines = np.cos(np.pi * taps / size * nodes[:, None] * samples)
    return 2 / (taps * ((weights * _window(nodes, taps)) @ cosines))


def _wrap(field, axis: int, size: int):
    """Return a field continued by zeros to `size` along an axis, its sample n // 2 at index 0."""
    xp = _array.namespace(field)
    along = with_last(field, axis)
    *batch, count = along.shape
    zeros = xp.zeros((*batch, size - count), dtype=field.dtype, device=_array.device_of(field))
    parts = [along[..., count // 2 :], zeros, along[..., : count // 2]]
    return with_last(xp.concat(parts, axis=-1), axis)
