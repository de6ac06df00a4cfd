"""Heights of surfaces above their vertex plane, with slopes: conics, aspheres, toroids and freeforms, for any array.

Each function takes positions x, y (arrays of one shape) and parameters that broadcast against them, and returns a
:class:`Sag`. A surface is z = height(x, y), with its vertex at the origin.
"""

from typing import Any, NamedTuple

from odak._array import is_array, namespace
from odak.tools.zernike import jacobi, noll_to_nm, zernike_norm


class Sag(NamedTuple):
    """Height of a surface.

    Attributes
    ----------
    height : array
        z, ``[...]``; 0 where not defined.
    slope_x, slope_y : array
        ∂z/∂x and ∂z/∂y.
    defined : array
        Where the surface exists, bool.
    """

    height: Any
    slope_x: Any
    slope_y: Any
    defined: Any


def conic_sag(x, y, curvature=0.0, conic=0.0) -> Sag:
    """Return z = cr²/(1 + √(1 − (1 + k)c²r²)): a plane for c = 0, a sphere for k = 0, a paraboloid for k = −1."""
    xp = namespace(x, y)
    squared = x * x + y * y
    inside = 1 - (1 + conic) * (curvature * curvature) * squared
    defined = inside > 0
    root = xp.where(defined, inside, 1.0) ** 0.5
    height = xp.where(defined, curvature * squared / (1 + root), 0.0)
    slope = xp.where(defined, curvature / root, 0.0)
    return Sag(height, slope * x, slope * y, defined)


def even_asphere_sag(x, y, curvature=0.0, conic=0.0, coefficients=()) -> Sag:
    """Return the conic's height plus a1·r² + a2·r⁴ + a3·r⁶ + …, ``coefficients[..., i]`` belonging to r^(2i + 2)."""
    base = conic_sag(x, y, curvature, conic)
    value, slope = _polynomial(x * x + y * y, terms(coefficients))
    return Sag(base.height + value, base.slope_x + 2 * x * slope, base.slope_y + 2 * y * slope, base.defined)


def toroid_sag(x, y, curvature_x=0.0, curvature_y=0.0, conic=0.0, coefficients=()) -> Sag:
    """Return the height of a profile in y turned about an axis parallel to y at z = 1/c_x.

    The profile is a conic of curvature c_y and constant `conic` plus a1·y² + a2·y⁴ + …; c_x = 0 gives a cylinder.
    """
    xp = namespace(x, y)
    profile = even_asphere_sag(0 * x, y, curvature_y, conic, coefficients)
    arm = 1 - curvature_x * profile.height
    inside = arm * arm - (curvature_x * x) ** 2
    defined = profile.defined & (inside > 0) & (arm > 0)
    root = xp.where(defined, inside, 1.0) ** 0.5
    # (1 − root)/c_x, written so that c_x may be zero.
    rise = 2 * profile.height - curvature_x * (profile.height * profile.height - x * x)
    height = xp.where(defined, rise / (1 + root), 0.0)
    slope_y = arm * profile.slope_y / root
    return Sag(height, xp.where(defined, curvature_x * x / root, 0.0), xp.where(defined, slope_y, 0.0), defined)


def zernike_sag(x, y, curvature=0.0, conic=0.0, coefficients=(), radius=1.0) -> Sag:
    """Return the conic's height plus Σ a_j·Z_j(x/R, y/R), Noll's order from j = 1, each of RMS 1 over the disc.

    The polynomials go on beyond the disc of radius R. Noll, J. Opt. Soc. Am. 66, 207 (1976).
    """
    base = conic_sag(x, y, curvature, conic)
    height, slope_x, slope_y = base.height, base.slope_x, base.slope_y
    u, v = x / radius, y / radius
    for j, coefficient in enumerate(terms(coefficients), start=1):
        value, along_u, along_v = _zernike(j, u, v)
        height = height + coefficient * value
        slope_x = slope_x + coefficient * along_u / radius
        slope_y = slope_y + coefficient * along_v / radius
    return Sag(height, slope_x, slope_y, base.defined)


def spline_sag(x, y, heights, size, curvature=0.0, conic=0.0) -> Sag:
    """Return the conic's height plus a uniform cubic B-spline.

    `heights` ``[n0, n1]`` are its control points, at x and y from −size/2 to size/2 (first axis x), the rim's repeated
    beyond it; ``size`` holds the two extents. de Boor, A Practical Guide to Splines (1978), chapter IX.
    """
    xp = namespace(x, y)
    base = conic_sag(x, y, curvature, conic)
    n0, n1 = heights.shape
    (i, weight_x, slope_x), (j, weight_y, slope_y) = (
        _spline_weights(value, extent, n) for value, extent, n in zip((x, y), terms(size), (n0, n1), strict=True)
    )
    flat = xp.reshape(heights, (-1,))
    value = along_x = along_y = 0.0 * x
    for a in range(4):
        for b in range(4):
            index = xp.clip(i + (a - 1), 0, n0 - 1) * n1 + xp.clip(j + (b - 1), 0, n1 - 1)
            control = xp.reshape(xp.take(flat, xp.reshape(index, (-1,)), axis=0), index.shape)
            value = value + control * weight_x[a] * weight_y[b]
            along_x = along_x + control * slope_x[a] * weight_y[b]
            along_y = along_y + control * weight_x[a] * slope_y[b]
    return Sag(base.height + value, base.slope_x + along_x, base.slope_y + along_y, base.defined)


def terms(coefficients) -> tuple:
    """Return the numbers or arrays along the last axis of coefficients, or of a sequence of them."""
    if is_array(coefficients):
        return tuple(namespace(coefficients).unstack(coefficients, axis=-1))
    return tuple(coefficients)


def _polynomial(s, coefficients):
    """Return Σ a_i·s^(i + 1) and its derivative, by Horner's rule."""
    value = slope = 0 * s
    for coefficient in reversed(coefficients):
        slope = slope * s + value + coefficient
        value = (value + coefficient) * s
    return value, slope


def _zernike(j: int, u, v):
    """Return the normalised Zernike polynomial of Noll's index j in Cartesian form, and its two derivatives.

    Re or Im of (u + iv)^m times Jacobi's P_k^(0, m)(2ρ² − 1), whose derivative is ½·Σ_l (2l + m + 2)·P_l^(0, m + 1),
    l < k (Christoffel and Darboux): no angle, hence no trouble at the centre.
    """
    n, signed = noll_to_nm(j)
    m = abs(signed)
    degree, s = (n - m) // 2, 2 * (u * u + v * v) - 1
    radial = jacobi(degree, m, s)
    slope = sum(((k + m / 2 + 1) * jacobi(k, m + 1, s) for k in range(degree)), start=0 * s)
    real, imaginary = u * 0 + 1, v * 0
    lower = (real, imaginary)
    for _ in range(m):
        lower = (real, imaginary)
        real, imaginary = real * u - imaginary * v, real * v + imaginary * u
    wave, along_u, along_v = (
        (real, m * lower[0], -m * lower[1]) if signed >= 0 else (imaginary, m * lower[1], m * lower[0])
    )
    norm = zernike_norm(n, signed)
    return (
        norm * wave * radial,
        norm * (along_u * radial + 4 * u * wave * slope),
        norm * (along_v * radial + 4 * v * wave * slope),
    )


def _spline_weights(value, extent, count: int):
    """Return the cell of each position and the four cubic weights with their derivatives along the position."""
    xp = namespace(value)
    place = (value / extent + 0.5) * (count - 1)
    cell = xp.clip(xp.floor(place), 0, count - 2)
    u = place - cell
    w = 1 - u
    weights = (w**3 / 6, (3 * u**3 - 6 * u * u + 4) / 6, (3 * w**3 - 6 * w * w + 4) / 6, u**3 / 6)
    scale = (count - 1) / extent
    slopes = (-w * w / 2, (3 * u * u - 4 * u) / 2, (4 * w - 3 * w * w) / 2, u * u / 2)
    return xp.astype(cell, xp.int64), weights, tuple(scale * slope for slope in slopes)
