"""The spectrum of a field at frequencies of any place: a non-uniform fast Fourier transform."""

import math

import numpy as np
import scipy.fft

from odak import _array

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
        result.append((xp.astype(index % size, xp.int64), xp.astype(value, field.dtype)))
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
