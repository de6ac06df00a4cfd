"""Point sources and point detectors: fields summed over the paths between them."""

import math
from typing import Any

from odak import _array, _validate
from odak._array import Array

_CHUNK_BYTES = 1 << 26


def electric_field_per_plane_wave(
    amplitude: float | Array, opd: float | Array, k: float, phase: float | Array = 0, w: float = 0, t: float = 0
) -> Any:
    """Return A·exp(i(−ω·t + k·opd + phase))/opd².

    Parameters
    ----------
    amplitude : float or array
        Amplitude A.
    opd : float or array
        Optical path difference in metres, not zero.
    k : float
        Wave number in rad/m.
    phase : float or array, default: 0
        Initial phase in radians.
    w : float, default: 0
        Angular frequency ω in rad/s.
    t : float, default: 0
        Time in seconds.

    Returns
    -------
    complex or array
        The field.

    Raises
    ------
    ValueError
        If an optical path difference is zero.

    Examples
    --------
    After a whole wavelength the phase is what it was, and the amplitude is A/opd²:

    >>> from odak.wave import electric_field_per_plane_wave, wavenumber
    >>> field = electric_field_per_plane_wave(8.0, 2.0, wavenumber(2.0))
    >>> round(float(field.real), 9), round(abs(float(field.imag)), 9)
    (2.0, 0.0)
    """
    for name, value in (("k", k), ("w", w), ("t", t)):
        _validate.real(name, value)
    _validate.real("opd", opd, nonzero=True)
    given = {"amplitude": amplitude, "opd": opd, "phase": phase}
    arrays = {name: _validate.array(name, _validate.given(name, value)) for name, value in given.items()}
    if not any(array.ndim or _array.is_array(given[name]) for name, array in arrays.items()):
        angle = math.remainder(-w * t + k * opd + _validate.real("phase", phase), 2 * math.pi)
        return amplitude * complex(math.cos(angle), math.sin(angle)) / opd**2
    _validate.fitting(**arrays)
    kinds = [value for value in given.values() if _array.is_array(value)] or list(arrays.values())
    xp = _array.namespace(*kinds)
    dtype = xp.complex128 if any(_array.is_double(value) for value in kinds) else xp.complex64
    amplitude = _array.cast(arrays["amplitude"], kinds[0], xp.complex128)
    # The phase spans many cycles of 2π, which 32 bits do not resolve.
    opd, phase = (_array.cast(arrays[name], kinds[0], xp.float64) for name in ("opd", "phase"))
    return xp.astype(amplitude * _array.phasor(k * opd + (phase - w * t)) / opd**2, dtype, copy=False)


def propagate_plane_waves(field: Array, opd: float | Array, k: float, w: float = 0, t: float = 0) -> Array:
    """Return a field carried over an optical path difference: u·exp(i(−ω·t + k·opd))/opd².

    Parameters
    ----------
    field : array
        Complex field.
    opd : float or array
        Optical path difference in metres, not zero.
    k : float
        Wave number in rad/m.
    w : float, default: 0
        Angular frequency ω in rad/s.
    t : float, default: 0
        Time in seconds.

    Returns
    -------
    array
        The field, of the same shape.

    Raises
    ------
    ValueError
        If an optical path difference is zero.

    Examples
    --------
    Half a wavelength reverses the sign:

    >>> import numpy as np
    >>> from odak.wave import propagate_plane_waves, wavenumber
    >>> propagate_plane_waves(np.asarray([4 + 0j]), 2.0, wavenumber(4.0)).real.round(6).tolist()
    [-1.0]
    """
    field = _validate.given("field", field)
    _validate.fitting(field=field, opd=_validate.array("opd", opd))
    return field * electric_field_per_plane_wave(1.0, opd, k, 0, w, t)


def propagate_field(points0: Array, points1: Array, field0: Array, wave_number: float, direction: int = 1) -> Array:
    """Return the field that point sources cause at other points: Σ_p |u_p|·exp(i(k·direction·d_pq + arg u_p))/d_pq².

    Parameters
    ----------
    points0 : array
        Sources ``[p, 3]``, in one unit of length.
    points1 : array
        Targets ``[q, 3]`` in the same unit.
    field0 : array
        Complex field ``[p]`` at the sources.
    wave_number : float
        2π/λ in radians per that unit.
    direction : int, default: 1
        +1 forward, −1 backward in time.

    Returns
    -------
    array
        Complex field ``[q]``.

    Raises
    ------
    ValueError
        If the shapes do not match, or a target lies on a source.

    Examples
    --------
    Two sources whose distances to the target differ by half a wavelength cancel each other, but for their distances:

    >>> import numpy as np
    >>> from odak.wave import propagate_field, wavenumber
    >>> sources = np.asarray([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    >>> target = np.asarray([[0.0, 0.0, 100.0]])
    >>> field = propagate_field(sources, target, np.asarray([1 + 0j, 1 + 0j]), wavenumber(1.0))
    >>> round(float(abs(field[0])) * 100**2, 2)
    0.01
    """
    for name, points in (("points0", points0), ("points1", points1)):
        if not _array.is_array(points) or points.ndim != 2 or points.shape[-1] != 3:
            raise ValueError(f"{name} must be an array of shape [n, 3], got {getattr(points, 'shape', type(points))}")
        _validate.array(name, points)
    _validate.real("wave_number", wave_number)
    if _validate.integer("direction", direction, minimum=-1) == 0 or direction > 1:
        raise ValueError(f"direction must be 1 or -1, got {direction}")
    if tuple(_validate.array("field0", field0, like=points0).shape) != (points0.shape[0],):
        raise ValueError(
            f"field0 must have one value for each of the {len(points0)} points0, got {tuple(field0.shape)}"
        )
    xp = _array.namespace(points0, points1, field0)
    field0 = _array.to_complex(_validate.array("field0", field0, like=points0))
    rows = max(1, _CHUNK_BYTES // (16 * max(1, points0.shape[0])))
    parts = []
    for start in range(0, points1.shape[0], rows):
        targets = xp.astype(points1[start : start + rows, :], xp.float64)
        squared = xp.sum((targets[:, None, :] - xp.astype(points0, xp.float64)) ** 2, axis=-1)
        if xp.any(squared == 0):
            raise ValueError("points1 must not coincide with a point of points0: the distance is zero there")
        wave = _array.phasor(direction * wave_number * xp.sqrt(squared), field0.dtype)
        parts.append(xp.sum(wave / xp.astype(squared, field0.dtype) * field0, axis=-1))
    return xp.concat(parts) if parts else xp.zeros(0, dtype=field0.dtype)
