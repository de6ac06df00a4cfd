"""Point sources and point detectors: fields summed over the paths between them."""

import math

from odak import _array, _validate

_CHUNK_BYTES = 1 << 26


def electric_field_per_plane_wave(amplitude, opd, k, phase=0, w=0, t=0):
    """Return A·exp(i(−ω·t + k·opd + phase))/opd².

    Parameters
    ----------
    amplitude : float or array
        Amplitude A.
    opd : float or array
        Optical path difference, not zero.
    k : float
        Wave number.
    phase : float or array
        Initial phase in radians.
    w, t : float
        Angular frequency and time.

    Returns
    -------
    complex or array
        The field.

    Raises
    ------
    ValueError
        If an optical path difference is zero.
    """
    _validate.real("opd", opd, nonzero=True)
    if not any(_array.is_array(value) for value in (amplitude, opd, phase)):
        angle = math.remainder(-w * t + k * opd + phase, 2 * math.pi)
        return amplitude * complex(math.cos(angle), math.sin(angle)) / opd**2
    xp = _array.namespace(amplitude, opd, phase)
    angle = -w * t + k * opd + phase
    if not _array.is_array(angle):
        angle = xp.asarray(angle, dtype=xp.float64)
    return amplitude * _array.phasor(angle) / opd**2


def propagate_plane_waves(field, opd, k, w=0, t=0):
    """Return a field carried over an optical path difference: u·exp(i(−ω·t + k·opd))/opd².

    Parameters
    ----------
    field : array
        Complex field.
    opd : float or array
        Optical path difference, not zero.
    k : float
        Wave number.
    w, t : float
        Angular frequency and time.

    Returns
    -------
    array
        The field, of the same shape.

    Raises
    ------
    ValueError
        If an optical path difference is zero.
    """
    return field * electric_field_per_plane_wave(1.0, opd, k, 0, w, t)


def propagate_field(points0, points1, field0, wave_number, direction=1):
    """Return the field that point sources cause at other points: Σ_p |u_p|·exp(i(k·direction·d_pq + arg u_p))/d_pq².

    Parameters
    ----------
    points0, points1 : array
        Sources ``[p, 3]`` and targets ``[q, 3]``, in one unit.
    field0 : array
        Complex field ``[p]`` at the sources.
    wave_number : float
        2π/λ in the same unit.
    direction : int
        +1 forward, −1 backward in time.

    Returns
    -------
    array
        Complex field ``[q]``.

    Raises
    ------
    ValueError
        If the shapes do not match, or a target lies on a source.
    """
    for name, points in (("points0", points0), ("points1", points1)):
        if not _array.is_array(points) or points.ndim != 2 or points.shape[-1] != 3:
            raise ValueError(f"{name} must be an array of shape [n, 3], got {getattr(points, 'shape', type(points))}")
    if tuple(field0.shape) != (points0.shape[0],):
        raise ValueError(f"field0 must have one value for each of {points0.shape[0]} points, got {tuple(field0.shape)}")
    xp = _array.namespace(points0, points1, field0)
    field0 = _array.to_complex(field0)
    rows = max(1, _CHUNK_BYTES // (16 * max(1, points0.shape[0])))
    parts = []
    for start in range(0, points1.shape[0], rows):
        separation = points1[start : start + rows, None, :] - points0[None, :, :]
        squared = xp.sum(xp.astype(separation, xp.float64) ** 2, axis=-1)
        if xp.any(squared == 0):
            raise ValueError("points1 must not coincide with a point of points0: the distance is zero there")
        wave = _array.phasor(direction * wave_number * xp.sqrt(squared), field0.dtype)
        parts.append(xp.sum(wave / xp.astype(squared, field0.dtype) * field0, axis=-1))
    return xp.concat(parts) if parts else xp.zeros(0, dtype=field0.dtype)
