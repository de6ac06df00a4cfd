"""Zernike polynomials on the unit disc, their norms, and their single indices: Noll, OSA, fringe."""

import math

from odak import _array, _validate
from odak._array import Array, ArrayT


def zernike_polynomial(n: int, m: int, rho: ArrayT, theta: Array) -> ArrayT:
    """Return the Zernike polynomial R(ρ)·cos(mθ) for m ≥ 0, R(ρ)·sin(|m|θ) for m < 0, without a norm factor.

    Parameters
    ----------
    n : int
        Radial order, n ≥ 0.
    m : int
        Azimuthal frequency, |m| ≤ n with n − |m| even.
    rho : array
        Distance from the centre as a share of the disc's radius. Beyond 1 the polynomial is taken as 0.
    theta : array
        Angle in radians; broadcasts against `rho`.

    Returns
    -------
    array
        In `rho`'s precision and library, computed in float64. Differentiable in `rho` and `theta`.

    Raises
    ------
    ValueError
        If there is no such polynomial.
    TypeError
        If `n` or `m` is not an integer.

    Notes
    -----
    Born and Wolf, Principles of Optics (1999), section 9.2.1; R(1) = 1. The radial part is ρ^|m|·P(2ρ² − 1) with the
    Jacobi polynomial P of degree (n − |m|)/2 and weights (0, |m|), whose recurrence keeps its digits where the sum of
    powers cancels: 1e-13 at n = 40.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.tools import zernike_polynomial
    >>> zernike_polynomial(2, 0, np.asarray([0.0, 0.5, 1.0, 1.5]), 0.0)
    array([-1. , -0.5,  1. ,  0. ])
    """
    n, m = check_mode(n, m)
    for name, value in (("rho", rho), ("theta", theta)):
        _validate.array(name, value)
    xp = _array.namespace(rho, theta)
    rho = rho if _array.is_array(rho) else xp.asarray(rho, dtype=xp.float64)
    wide = xp.astype(rho, xp.float64)
    # Held at the rim, so that no power of a large radius overflows and spoils the gradient.
    radius = xp.where(wide > 1, xp.ones_like(wide), wide)
    theta = _array.cast(theta, wide)
    _validate.fitting(rho=rho, theta=theta)
    angle = abs(m) * theta
    wave = xp.cos(angle) if m >= 0 else xp.sin(angle)
    value = radius ** abs(m) * jacobi((n - abs(m)) // 2, abs(m), 2 * radius**2 - 1) * wave
    value = xp.where(wide > 1, xp.zeros_like(value), value)
    return xp.astype(value, rho.dtype if xp.isdtype(rho.dtype, "real floating") else xp.float64, copy=False)


def check_mode(n: int, m: int) -> tuple[int, int]:
    """Return n and m after checking that there is a Zernike polynomial of these indices."""
    n = _validate.integer("n", n)
    m = _validate.integer("m", m, minimum=-n)
    if m > n or (n - m) % 2:
        raise ValueError(f"m must have |m| ≤ n and n − |m| even, got m = {m} with n = {n}")
    return n, m


def jacobi(degree: int, beta: int, x: Array | float) -> Array | float:
    """Return the Jacobi polynomial of weights (0, β) by its three-term recurrence (Abramowitz and Stegun, 22.7.1).

    Parameters
    ----------
    degree : int
        Degree, at least 0.
    beta : int
        Second weight, at least 0.
    x : array
        float64, −1 … 1.

    Returns
    -------
    array
        Of x's shape; 1 at x = 1.
    """
    xp = _array.namespace(x)
    before, value = xp.ones_like(x), 1 + (beta + 2) * (x - 1) / 2
    if degree == 0:
        return before
    for k in range(2, degree + 1):
        s = 2 * k + beta
        scale = 2 * k * (k + beta) * (s - 2)
        linear, constant, back = (s - 1) * s * (s - 2), -(s - 1) * beta**2, 2 * (k - 1) * (k + beta - 1) * s
        before, value = value, (linear / scale * x + constant / scale) * value - back / scale * before
    return value


def zernike_norm(n: int, m: int) -> float:
    """Return the factor that gives a Zernike polynomial a root mean square of 1 over the disc.

    Parameters
    ----------
    n : int
        Radial order, n ≥ 0.
    m : int
        Azimuthal frequency, |m| ≤ n with n − |m| even.

    Returns
    -------
    float
        sqrt(n + 1) for m = 0, sqrt(2(n + 1)) otherwise (Noll, J. Opt. Soc. Am. 66, 207 (1976), eq. 1).

    Examples
    --------
    >>> from odak.tools import zernike_norm
    >>> zernike_norm(1, 1), round(zernike_norm(2, 0) ** 2, 9)
    (2.0, 3.0)
    """
    n, m = check_mode(n, m)
    return math.sqrt((1 if m == 0 else 2) * (n + 1))


def noll_to_nm(j: int) -> tuple[int, int]:
    """Return (n, m) of Noll's index j = 1, 2, … (1 piston, 2 and 3 tilts, 4 defocus, 5 and 6 astigmatism).

    Parameters
    ----------
    j : int
        Index, at least 1. Even ones are cosines.

    Returns
    -------
    tuple of int
        Radial order n and azimuthal frequency m (Noll 1976, table 1).

    Examples
    --------
    >>> from odak.tools import noll_to_nm
    >>> [noll_to_nm(j) for j in (1, 2, 3, 4, 5, 11)]
    [(0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (4, 0)]
    """
    j = _validate.integer("j", j, minimum=1)
    n = (math.isqrt(8 * j - 7) - 1) // 2
    place = j - n * (n + 1) // 2  # 1 … n + 1 within the order
    m = (place - 1) // 2 * 2 + 1 if n % 2 else place // 2 * 2
    return n, m if j % 2 == 0 else -m


def osa_to_nm(j: int) -> tuple[int, int]:
    """Return (n, m) of the OSA/ANSI index j = 0, 1, … (0 piston, 1 and 2 tilts, 3 and 5 astigmatism, 4 defocus).

    Parameters
    ----------
    j : int
        Index (n(n + 2) + m)/2, at least 0.

    Returns
    -------
    tuple of int
        Radial order n and azimuthal frequency m (Thibos et al., J. Refract. Surg. 18, S652 (2002)).

    Examples
    --------
    >>> from odak.tools import osa_to_nm
    >>> [osa_to_nm(j) for j in (0, 1, 2, 4, 12)]
    [(0, 0), (1, -1), (1, 1), (2, 0), (4, 0)]
    """
    j = _validate.integer("j", j)
    n = (math.isqrt(8 * j + 1) - 1) // 2
    return n, 2 * j - n * (n + 2)


def fringe_to_nm(j: int) -> tuple[int, int]:
    """Return (n, m) of the fringe index j = 1, 2, … 37 (1 piston, 2 and 3 tilts, 4 defocus, 5 and 6 astigmatism).

    Parameters
    ----------
    j : int
        Index of the University of Arizona, 1 to 37: by n + |m|, then by falling |m|, cosines first. The 37th is the
        spherical term n = 12, out of order.

    Returns
    -------
    tuple of int
        Radial order n and azimuthal frequency m (Wyant and Creath, Applied Optics and Optical Engineering XI (1992),
        table 3). The polynomials of this set have no norm factor: they are 1 at the rim.

    Examples
    --------
    >>> from odak.tools import fringe_to_nm
    >>> [fringe_to_nm(j) for j in (1, 2, 4, 7, 9, 16, 37)]
    [(0, 0), (1, 1), (2, 0), (3, 1), (4, 0), (6, 0), (12, 0)]
    """
    j = _validate.integer("j", j, minimum=1, most=37)
    if j == 37:
        return 12, 0
    half = math.isqrt(j - 1)
    place = j - half * half - 1
    m = half - place // 2
    return 2 * half - m, -m if place % 2 else m
