"""Waves to rays: where the light of a field goes, by the local gradient of its phase."""

import math
from typing import Any, NamedTuple

from odak import _array, _validate
from odak._array import Array
from odak.raytracing.geometry import safe_sqrt

__all__ = ["FieldRays", "rays_from_field"]

# Darker samples have no phase to speak of.
THRESHOLD = 1e-6


class FieldRays(NamedTuple):
    """Rays of a field, one of each sample.

    Attributes
    ----------
    ray : array
        ``[..., rows, columns, 2, 3]``: the sample's place, x along columns and y along rows, and the direction
        cosines. Directions of dark samples, of those with no neighbour that is lit along one of the axes, and of waves
        that decay are NaN.
    power : array
        Squared amplitude, ``[..., rows, columns]``.
    path : array
        Optical path that the phase of the sample stands for, within half a wavelength of 0, ``[..., rows, columns]``.
    """

    ray: Any
    power: Any
    path: Any


def rays_from_field(
    field: Array, dx: float, wavelength: float, z: float = 0.0, threshold: float = THRESHOLD
) -> FieldRays:
    """Return the rays of a field: direction cosines (u, v) = λ/2π·∇φ.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; sample ``n // 2`` of each axis is at x = y = 0.
    dx, wavelength : float
        Pixel pitch and the wavelength in the medium, in one unit, which is that of the rays too.
    z : float
        Where the field's plane stands.
    threshold : float
        Samples with less power than this share of the largest one's are dark.

    Returns
    -------
    FieldRays
        In the precision of the field; differentiable in it where it is a tensor.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    The gradient is that of geometric optics (Born and Wolf, Principles of Optics, 1999, section 3.1.1: the eikonal); it
    says where light goes as long as it does not interfere: one wave at each place, and a phase that changes by less
    than π from one sample to the next. Differences of neighbours carry the gradient, to second order in `dx`, at the
    rim of the light as well.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.raytracing import rays_from_field
    >>> x = (np.arange(8) - 4) * 1e-6
    >>> wave = np.ones((8, 1)) * np.exp(2j * np.pi / 500e-9 * np.sin(np.radians(6)) * x)
    >>> rays = rays_from_field(wave, 1e-6, 500e-9).ray
    >>> rays.shape, np.degrees(np.arcsin(rays[0, 0, 1, 0])).round(6).item()
    ((8, 8, 2, 3), 6.0)
    """
    field = _array.to_complex(_validate.image("field", field))
    for name, value in (("dx", dx), ("wavelength", wavelength)):
        _validate.real(name, value, positive=True)
    _validate.real("z", z)
    _validate.real("threshold", threshold)
    xp = _array.namespace(field)
    real, imag = xp.real(field), xp.imag(field)
    power = real * real + imag * imag
    lit = power > threshold * xp.max(power, axis=(-2, -1), keepdims=True)
    scale = wavelength / (2 * math.pi * dx)
    (v, known_v), (u, known_u) = (_slope(real, imag, lit, axis) for axis in (-2, -1))
    u, v = scale * u, scale * v
    rest = 1 - u * u - v * v
    exists = known_u & known_v & (rest > 0)
    direction = [xp.where(exists, value, math.nan) for value in (u, v, safe_sqrt(rest))]
    lines = [(xp.arange(n, dtype=real.dtype, device=_array.device_of(field)) - n // 2) * dx for n in field.shape[-2:]]
    zero = xp.zeros_like(real)
    point = [zero + lines[1][None, :], zero + lines[0][:, None], zero + z]
    ray = xp.stack([xp.stack(point, axis=-1), xp.stack(direction, axis=-1)], axis=-2)
    path = wavelength / (2 * math.pi) * _angle(real, imag, lit)
    return FieldRays(ray, power, path)


def _angle(real, imag, where):
    """Return the argument of complex numbers, 0 without a gradient elsewhere."""
    xp = _array.namespace(real)
    return xp.atan2(xp.where(where, imag, 0.0), xp.where(where, real, 1.0))


def _slope(real, imag, lit, axis: int):
    """Return the increase of the phase from one sample to the next along an axis, and where it is known."""
    xp = _array.namespace(real)
    count = real.shape[axis]

    def part(value, start, stop):
        return value[(..., slice(start, stop), slice(None))] if axis == -2 else value[..., start:stop]

    def joined(*values):
        return xp.concat(values, axis=axis)

    a, b, c, d = (part(value, start, start + count - 1) for start in (0, 1) for value in (real, imag))
    both = part(lit, 0, count - 1) & part(lit, 1, count)
    step = _angle(a * c + b * d, a * d - b * c, both)
    still, none = xp.zeros_like(part(real, 0, 1)), xp.zeros_like(part(lit, 0, 1))
    # The steps from each sample to the next and from the one before, and those beyond them on either side.
    ahead, has_ahead = joined(step, still), joined(both, none)
    past, has_past = joined(still, step), joined(none, both)
    if count < 2:
        return ahead, has_ahead
    ahead2, has_ahead2 = joined(part(step, 1, None), still, still), joined(part(both, 1, None), none, none)
    past2, has_past2 = joined(still, still, part(step, 0, -1)), joined(none, none, part(both, 0, -1))
    onward = xp.where(has_ahead2, (3 * ahead - ahead2) / 2, ahead)
    backward = xp.where(has_past2, (3 * past - past2) / 2, past)
    slope = xp.where(has_past & has_ahead, (past + ahead) / 2, xp.where(has_ahead, onward, backward))
    return slope, has_past | has_ahead
