"""Reflection, refraction, diffraction and Fresnel coefficients at surfaces, on plain arrays of any rank."""

from typing import Any, NamedTuple

from odak._array import complex_dtype, namespace
from odak.raytracing import components as vec
from odak.raytracing.batches import in_pieces
from odak.raytracing.geometry import dot, finite_rays, safe_divide, safe_sqrt
from odak.raytracing.intersections import RayStatus, status_array


class Fresnel(NamedTuple):
    """Fresnel coefficients of an interface for both polarisations.

    Attributes
    ----------
    reflected_s, reflected_p, transmitted_s, transmitted_p : array
        Amplitude coefficients, complex ``[...]``.
    reflectance_s, reflectance_p, transmittance_s, transmittance_p : array
        Fractions of the power, real ``[...]``. Each pair adds up to 1.
    """

    reflected_s: Any
    reflected_p: Any
    transmitted_s: Any
    transmitted_p: Any
    reflectance_s: Any
    reflectance_p: Any
    transmittance_s: Any
    transmittance_p: Any


def reflect_directions(direction, normal):
    """Return d − 2(d·n)/(n·n)·n; NaN where the normal is zero or not finite. Neither need be a unit vector."""
    return in_pieces(lambda *a: vec.join(reflected(*a)), (1, 1), direction, normal)


def reflected(direction, normal) -> vec.Vector:
    """Return the components of :func:`reflect_directions`."""
    xp, direction, normal, kept, differentiable = vec.lines(direction, normal)
    squared = vec.dot(normal, normal)
    exists = kept & (squared > 0) & (squared < xp.inf)
    factor = vec.quotient(2 * vec.dot(direction, normal), squared, exists, differentiable)
    factor = vec.placeholder(factor, exists & (abs(factor) < xp.inf), differentiable)
    return vec.nan_outside(vec.along(direction, -factor, normal), exists, differentiable)


def refract_directions(direction, normal, n1, n2):
    """Return the refracted directions and their statuses, by Snell's law in vector form.

    Parameters
    ----------
    direction, normal : array
        ``[..., 3]``. The normal may have any length and either sign; the direction's length is kept.
    n1, n2 : array or float
        Indices before and behind the surface, ``[...]``.

    Returns
    -------
    tuple
        Directions ``[..., 3]``, NaN for total internal reflection and for rays that do not exist, and int8 statuses.

    Notes
    -----
    d' = μd + τn with μ = n1/n2 and the root τ of τ² + 2aτ + b = 0 of the transmitted ray: Spencer and
    Murty, J. Opt. Soc. Am. 52, 672 (1962), eqs. 18–21. A ray at grazing incidence is refracted to the critical
    angle for n1 < n2 and totally reflected otherwise.
    """

    def refract_with_status(*arrays):
        out, through, exists = refracted(*arrays)
        status = status_array(through, RayStatus.TOTAL_INTERNAL_REFLECTION)
        return vec.join(out), status - namespace(exists).astype(~exists, status.dtype)

    return in_pieces(refract_with_status, (1, 1, 0, 0), direction, normal, n1, n2)


def refracted(direction, normal, n1, n2) -> tuple:
    """Return the components of :func:`refract_directions`, which rays are transmitted, and which exist."""
    # NaN must be avoided if the indices require gradients, as if the rays do.
    xp, direction, normal, kept, differentiable = vec.lines(direction, normal, n1, n2)
    squared, length = vec.dot(normal, normal), vec.dot(direction, direction)
    exists = kept & (squared > 0) & (length > 0) & (squared + length < xp.inf)
    normal = vec.unit(normal, differentiable)
    ratio = n1 / n2
    cosine = vec.dot(direction, normal)
    tangential = vec.along(direction, -cosine, normal)
    # |d|² − μ²|d_t|², from the tangential part itself, because 1 − cos² would lose precision by cancellation.
    inside = length - (ratio * ratio) * vec.dot(tangential, tangential)
    through = exists & (inside >= 0) & ((cosine != 0) | (ratio < 1))
    root = vec.square_root(xp.where(exists, inside, 1.0) if differentiable else inside, differentiable)
    root = xp.copysign(vec.placeholder(root, through, differentiable), cosine + 0.0)
    out = vec.along(vec.scaled(tangential, ratio), root, normal)
    return vec.nan_outside(out, through, differentiable), through, exists


def diffracted(direction, normal, n1, n2, gradient, reflects: bool = False) -> tuple:
    """Return the components of diffracted directions, and which rays exist.

    Parameters
    ----------
    direction, normal : array or tuple
        Unit directions and normals, ``[..., 3]`` or tuples of components.
    n1, n2 : array or float
        Indices before and behind the surface.
    gradient : tuple of array
        Components of λ·∇φ/2π, the vacuum wavelength times the gradient of the phase in cycles.
    reflects : bool
        Take the reflected ray.

    Notes
    -----
    The tangential part of the wave vector changes by that of the phase's gradient: n₂d'_t = n₁d_t + λ(∇φ)_t/2π. Without
    a phase this is Snell's law (Spencer and Murty, J. Opt. Soc. Am. 52, 672 (1962), section on gratings).
    """
    xp, direction, normal, kept, differentiable = vec.lines(direction, normal, n1, n2, *gradient)
    cosine = vec.dot(direction, normal)
    tangential = vec.along(vec.scaled(vec.without(direction, normal), n1), 1.0, vec.without(gradient, normal))
    inside = n2 * n2 - vec.dot(tangential, tangential)
    through = kept & (inside > 0)
    root = vec.square_root(xp.where(through, inside, 1.0), differentiable)
    root = xp.copysign(root, -cosine if reflects else cosine)
    out = vec.along(tangential, root, normal)
    return vec.nan_outside(vec.scaled(out, 1 / n2), through, True), through


def fresnel(direction, normal, n1, n2) -> Fresnel:
    """Return the Fresnel coefficients of an interface between indices n1 (real) and n2 (real or complex).

    Parameters
    ----------
    direction, normal : array
        ``[..., 3]``; lengths and signs do not matter.
    n1, n2 : array or number
        Indices before and behind. Absorption is a positive imaginary part of `n2`: exp(+ikz) is a wave going forward.

    Notes
    -----
    Born and Wolf, Principles of Optics (1999), section 1.5.2, eqs. 20 and 21; r_p follows their sign, so that
    r_p = −r_s at normal incidence. Where the ray does not exist, all are NaN.
    """
    xp = namespace(direction, normal)
    direction, normal, kept = finite_rays(direction, normal)
    scale = dot(direction, direction) * dot(normal, normal)
    exists = kept & (scale > 0)
    cosine = abs(safe_divide(dot(direction, normal), safe_sqrt(xp.where(exists, scale, 1.0)), exists))
    dtype = complex_dtype(cosine)
    cos1, n1, n2 = (xp.astype(v + 0 * cosine, dtype) for v in (cosine, n1, n2))
    tangential = n1 / n2
    cos2 = xp.sqrt(1 - tangential * tangential * (1 - cos1 * cos1))
    a, b, c, d = n1 * cos1, n2 * cos2, n2 * cos1, n1 * cos2
    s, p = a + b, c + d
    amplitudes = ((a - b) / s, (c - d) / p, 2 * a / s, 2 * a / p)
    # Powers are compared, since cross-section and index change too. There is no 0/0 at grazing incidence.
    through_s = 4 * xp.real(a) * xp.real(b) / _square(s)
    through_p = 4 * xp.real(a) * xp.real(n2 * xp.conj(cos2)) / _square(p)
    powers = (_square(amplitudes[0]), _square(amplitudes[1]), through_s, through_p)
    return Fresnel(*(xp.where(exists, value, float("nan")) for value in (*amplitudes, *powers)))


def _square(value):
    xp = namespace(value)
    return xp.real(value) ** 2 + xp.imag(value) ** 2
