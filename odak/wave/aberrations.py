"""Wavefront aberrations as sums of Zernike polynomials."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array
from odak.tools.zernike import check_mode, jacobi, zernike_norm


def zernike_phase(
    nx: int,
    ny: int,
    coefficients: Mapping,
    radius: float | None = None,
    dx: float | Sequence[float] | Array = 1.0,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: Any = None,
    device: Any = None,
) -> Array:
    """Return the aberration Σ c·Z as a phase, each Z a Zernike polynomial of root mean square 1 over the disc.

    Parameters
    ----------
    nx, ny : int
        Rows and columns.
    coefficients : mapping
        ``{(n, m): c}``, c in radians RMS over the disc (a wave is 2π). A number, or an array ``[...]`` for a batch;
        the phase is differentiable in arrays. Modes by another index: ``{noll_to_nm(4): 0.5}``.
    radius : float, optional
        Radius of the disc in the unit of `dx`; by default half the diagonal, so that the whole window lies inside.
        Beyond it the phase is 0.
    dx : float or sequence of float
        Pixel pitch, or two of them (rows, columns). The default 1 gives `radius` in pixels.
    offset : sequence of float
        Position of the disc's centre (rows, columns) from sample n // 2, in the unit of `dx`.
    xp, device : optional
        Array namespace (that of the coefficients, else NumPy) and device.

    Returns
    -------
    array
        float64 phase in radians, ``[..., nx, ny]``, not wrapped.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Noll, J. Opt. Soc. Am. 66, 207 (1976). As the polynomials are orthonormal, the variance over the disc is the sum of
    the squares of the coefficients other than piston's. x runs along columns, y along rows: θ = atan2(y, x).

    Examples
    --------
    >>> from odak.wave import zernike_phase
    >>> zernike_phase(3, 3, {(1, 1): 0.5}, radius=1.0)
    array([[ 0.,  0.,  0.],
           [-1.,  0.,  1.],
           [ 0.,  0.,  0.]])
    """
    if not isinstance(coefficients, Mapping):
        raise TypeError(f"coefficients must map (n, m) to radians, got {type(coefficients).__name__}")
    coefficients = {mode: float(v) if isinstance(v, np.number) else v for mode, v in coefficients.items()}
    arrays = [value for value in coefficients.values() if _array.is_array(value)]
    xp = _array.namespace(*arrays) if xp is None else _validate.library("xp", xp)
    device = _array.device_of(arrays[0]) if device is None and arrays else device
    for mode, value in coefficients.items():
        _validate.real(f"coefficients[{mode}]", value)
    phase = xp.zeros(_validate.size("nx, ny", (nx, ny)), dtype=xp.float64, device=device)
    modes = _modes(nx, ny, _pairs("coefficients", coefficients), radius, dx, offset, xp, device)
    for value, polynomial in zip(coefficients.values(), modes, strict=True):
        phase = phase + (value[..., None, None] if _array.is_array(value) else float(value)) * polynomial
    return phase


def zernike_basis(
    nx: int,
    ny: int,
    modes: Iterable,
    radius: float | None = None,
    dx: float | Array = 1.0,
    offset: Any = (0.0, 0.0),
    *,
    xp: Any = None,
    device: Any = None,
) -> Array:
    """Return Zernike polynomials of root mean square 1, for sums that are taken again and again.

    Parameters
    ----------
    modes : sequence
        Pairs (n, m).
    nx, ny, radius, dx, offset, xp, device
        As in :func:`zernike_phase`.

    Returns
    -------
    array
        float64 ``[modes, nx, ny]``; 0 outside the disc.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.
    """
    xp = _validate.library("xp", xp)
    modes = _pairs("modes", modes)
    if not modes:
        raise ValueError("modes must hold at least one pair (n, m), got none")
    return xp.stack(list(_modes(nx, ny, modes, radius, dx, offset, xp, device)))


def _modes(nx, ny, modes, radius, dx, offset, xp, device) -> Iterator:
    """Yield the polynomials, formed from ρ²ᵏ and (x + iy)^m: no angle, no square root, smooth at the centre."""
    shape = _validate.size("nx, ny", (nx, ny))
    is_pair = isinstance(dx, Iterable) and getattr(dx, "ndim", 1) != 0
    pitches = _validate.several("dx", dx if is_pair else (dx, dx), 2, positive=True)
    offset = _validate.several("offset", offset, 2)
    if radius is None:
        radius = math.hypot(*(n * pitch for n, pitch in zip(shape, pitches, strict=True))) / 2
    radius = float(_validate.real("radius", radius, positive=True))
    y, x = (
        ((xp.arange(n, dtype=xp.float64, device=device) - n // 2) * pitch - shift) / radius
        for n, pitch, shift in zip(shape, pitches, offset, strict=True)
    )
    y, x = y[:, None], x[None, :]
    squared = x**2 + y**2
    # The first corner of an even window is on the rim of its disc, but for rounding.
    inside = xp.astype(squared <= 1 + 1e-12, xp.float64)
    argument = 2 * squared - 1
    for n, m in modes:
        n, m = check_mode(n, m)
        radial = zernike_norm(n, m) * jacobi((n - abs(m)) // 2, abs(m), argument) * inside
        yield radial * _angular(x, y, m)


def _pairs(name, modes) -> list[tuple]:
    listed = isinstance(modes, Iterable) and not isinstance(modes, str)
    pairs = [tuple(mode) if isinstance(mode, Iterable) else (mode,) for mode in modes] if listed else [()]
    if any(len(pair) != 2 for pair in pairs):
        raise ValueError(f"{name} must be pairs of integers (n, m), got {modes!r:.100}")
    for n, m in pairs:
        _validate.integer(f"n in {name}", n)
        _validate.integer(f"m in {name}", m, minimum=-n)
    return pairs


def _angular(x, y, m: int):
    """Return ρ^|m|·cos(mθ) for m ≥ 0, ρ^|m|·sin(|m|θ) for m < 0: the real or imaginary part of (x + iy)^|m|."""
    real, imaginary = 1.0, 0.0
    for _ in range(abs(m)):
        real, imaginary = x * real - y * imaginary, x * imaginary + y * real
    return real if m >= 0 else imaginary
