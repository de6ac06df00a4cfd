"""Complex amplitudes of beams (Gaussian and its modes, Bessel, Airy, flat-top), and their widths, quality and overlap.

Each beam travels along +z and is sampled on the grid of a field, its axis at index n // 2 unless `offset` moves it.
Widths are radii at which the *amplitude* of the fundamental Gaussian factor falls to 1/e (the intensity to 1/e²).
A beam of `power` P has Σ|u|²·dx² = P on a window that holds all of it.
"""

import functools
import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
import scipy.special

from odak import _array, _validate
from odak._array import Array, Device, namespace
from odak.wave.elements import distance_from_axis, grid_positions, share_in_disc, single_numbers, spiral_parts
from odak.wave.sampling import plain_numbers, warn_of_beam, warn_of_factor, warn_of_power, warn_of_tilt
from odak.wave.transfer_functions import pitches


@_validate.takes_units("dx", "wavelength", "waist", "distance", "offset")
def gaussian_beam(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float | Array,
    waist: float | Array | Sequence[float],
    distance: float | Array = 0.0,
    power: float | Array = 1.0,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return a Gaussian beam at a distance from its waist.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Wavelength in the medium, in metres.
    waist : float, array or sequence of float
        Radius of the waist in metres; two numbers (y, x) for an elliptic beam.
    distance : float or array
        Distance behind the waist in metres; negative in front of it.
    power : float or array
        Power P of the beam.
    offset : sequence of float
        Position of the axis (rows, columns) in metres.
    xp : optional
        Array namespace; by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        Complex128 ``[rows, columns]``, with the phase exp(ikz) of the carrier; the paraxial solution
        √(2P/π)/w·exp(−r²/w²)·exp(i(kz + kr²/(2R) − ψ)) (B. E. A. Saleh and M. C. Teich, Fundamentals of Photonics
        (2007), section 3.1). Differentiable in every number given as a tensor.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    SamplingWarning
        If the pitch is too large or the window too small for the beam.

    Examples
    --------
    >>> from odak.wave import gaussian_beam
    >>> beam = gaussian_beam((64, 64), 8e-6, 532e-9, 60e-6, power=2.0)
    >>> round(float((abs(beam) ** 2).sum() * 8e-6**2), 9)
    2.0
    """
    waist = waist if isinstance(waist, (list, tuple)) else (waist, waist)
    return _hermite_beam(
        "gaussian_beam", shape, dx, wavelength, waist, (0, 0), distance, power, offset, xp=xp, device=device
    )


@_validate.takes_units("dx", "wavelength", "waist", "distance", "offset")
def hermite_gaussian_beam(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float | Array,
    waist: float | Array | Sequence[float],
    order: Sequence[int] = (0, 0),
    distance: float | Array = 0.0,
    power: float | Array = 1.0,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return a Hermite–Gauss mode at a distance from its waist.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Wavelength in the medium, in metres.
    waist : float, array or sequence of float
        Radius of the waist of the fundamental mode in metres; two numbers (y, x) for an elliptic one.
    order : sequence of int
        Numbers of zeros along the rows' axis (y) and the columns' axis (x).
    distance : float or array
        Distance behind the waist in metres.
    power : float or array
        Power of the mode.
    offset : sequence of float
        Position of the axis (rows, columns) in metres.
    xp : optional
        Array namespace; by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        Complex128 ``[rows, columns]``: the product of one-dimensional modes H_m(√2·x/w)·exp(−x²/w²)·exp(ikx²/(2R) −
        i(m + 1/2)ψ), of unit power each (Saleh and Teich (2007), section 3.3).

    Warns
    -----
    SamplingWarning
        If the pitch is too large or the window too small for the beam.

    Examples
    --------
    Modes are orthonormal:

    >>> from odak.wave import hermite_gaussian_beam
    >>> first = hermite_gaussian_beam((64, 64), 8e-6, 532e-9, 60e-6, (0, 1))
    >>> second = hermite_gaussian_beam((64, 64), 8e-6, 532e-9, 60e-6, (0, 3))
    >>> round(float((abs(first) ** 2).sum()) * 8e-6**2, 6), abs(complex((first * second).sum())) * 8e-6**2 < 1e-6
    (1.0, True)
    """
    order = [_validate.integer("order", n) for n in _pair("order", order)]
    waist = waist if isinstance(waist, (list, tuple)) else (waist, waist)
    return _hermite_beam(
        "hermite_gaussian_beam", shape, dx, wavelength, waist, order, distance, power, offset, xp=xp, device=device
    )


def _warn_of_flat_top(shape, dx, offset, given):
    """Warn where a grid is too coarse for a Gaussian beam of the radius, or too small for the power."""
    lines, numbers = _lines(shape, dx, offset, given)
    if lines is None:
        return
    (ends, pitch), (waist, order) = lines, numbers
    factor = 2 * max(pitch) * 1.985 / (math.sqrt(2) * math.pi * waist)
    remedies = (
        f"a pitch of at most {0.995 * max(pitch) / factor:.3g} m",
        f"a waist of at least {1.005 * waist * factor:.3g} m",
    )
    warn_of_factor("flat_top_beam", factor, remedies)
    kept = _held_share(ends, pitch, lambda r: scipy.special.gammainc(1 / order, 2 * (r / waist) ** (2 * order)))
    radius = waist * (scipy.special.gammaincinv(1 / order, 0.992) / 2) ** (0.5 / order)
    middle = max(abs(low + high) for low, high in ends) / 2
    warn_of_power("flat_top_beam", kept, [2 * (radius + middle) + max(pitch)])


def _held_share(ends, pitch, within) -> float:
    """Return the share of a round beam in a window: a sum of sectors of circles, of radii that `within` knows."""
    (top, bottom), (left, right) = (
        (low - step / 2, high + step / 2) for (low, high), step in zip(ends, pitch, strict=True)
    )
    if min(-top, bottom, -left, right) <= 0:
        return 0.0
    angles = (np.arange(64) + 0.5) * (2 * np.pi / 64)
    across, down = np.cos(angles), np.sin(angles)
    edge = np.minimum(np.where(across > 0, right, left) / across, np.where(down > 0, bottom, top) / down)
    return float(within(edge).mean())


def _hermite_beam(name, shape, dx, wavelength, waist, counts, distance, power, offset, *, xp, device):
    """Return a Hermite–Gauss mode after its check; two waists."""
    waists = _pair("waist", waist)
    for value in waists:
        _validate.number("waist", value, positive=True)
    modes = tuple((0.0,) * n + (1.0,) for n in counts)
    numbers = (wavelength, distance, *waists)
    xp, (y, x), (wavelength, distance, power, *waists) = _prepare(
        shape, dx, offset, xp, device, wavelength=wavelength, distance=distance, power=power, waist=waists
    )
    _array.outside_graphs(_warn_of_beam, name, shape, dx, offset, modes, numbers)
    along_y, along_x = (
        _hermite_mode(xp, position, wavelength, waist, n, distance)
        for position, waist, n in zip((y, x), waists, counts, strict=True)
    )
    carrier = _array.phasor_of_cycles(distance / wavelength, xp.complex128) * xp.astype(xp.sqrt(power), xp.complex128)
    return carrier * along_y[:, None] * along_x[None, :]


@_validate.takes_units("dx", "wavelength", "waist", "distance", "offset")
def laguerre_gaussian_beam(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float | Array,
    waist: float | Array,
    radial: int = 0,
    azimuthal: int = 0,
    distance: float | Array = 0.0,
    power: float | Array = 1.0,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return a Laguerre–Gauss mode, which carries an optical vortex, at a distance from its waist.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Wavelength in the medium, in metres.
    waist : float or array
        Radius of the waist of the fundamental mode in metres.
    radial : int
        Number p of zeros along the radius.
    azimuthal : int
        Charge l of the vortex: the phase is l times the azimuth, from x (columns) towards y (rows).
    distance : float or array
        Distance behind the waist in metres.
    power : float or array
        Power of the mode.
    offset : sequence of float
        Position of the axis (rows, columns) in metres.
    xp : optional
        Array namespace; by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        Complex128 ``[rows, columns]``: √(2p!/(π(p + |l|)!))/w·(√2·r/w)^|l|·L_p^|l|(2r²/w²)·exp(−r²/w²)·exp(ilφ) with
        the Gouy phase (2p + |l| + 1)ψ (Saleh and Teich (2007), section 3.4).

    Warns
    -----
    SamplingWarning
        If the pitch is too large or the window too small for the beam.

    Examples
    --------
    A vortex is dark on its axis, and brightest at the radius waist·√(l/2), here 50 µm:

    >>> from odak.wave import laguerre_gaussian_beam
    >>> beam = laguerre_gaussian_beam((101, 101), 5e-6, 532e-9, 50e-6, azimuthal=2)
    >>> row = abs(beam[50, 50:])
    >>> float(row[0]), int(row.argmax()) * 5
    (0.0, 50)
    """
    p, charge = _validate.integer("radial", radial), _validate.integer("azimuthal", azimuthal, minimum=-math.inf)
    _validate.number("waist", waist, positive=True)
    modes, numbers = (_hermite_weights(p, abs(charge)),) * 2, (wavelength, distance, waist, waist)
    xp, (y, x), (wavelength, distance, power, waist) = _prepare(
        shape, dx, offset, xp, device, wavelength=wavelength, distance=distance, power=power, waist=(waist,)
    )
    _array.outside_graphs(_warn_of_beam, "laguerre_gaussian_beam", shape, dx, offset, modes, numbers, (p, abs(charge)))
    y, x = y[:, None], x[None, :]
    width, curvature, gouy = _gaussian(xp, wavelength, waist, distance)
    squared = (x**2 + y**2) / width**2
    size = abs(charge)
    norm = math.sqrt(2 / math.pi * math.exp(math.lgamma(p + 1) - math.lgamma(p + size + 1)))
    envelope = norm / width * _laguerre(p, size, 2 * squared) * xp.exp(-squared)
    phase = math.pi / wavelength * curvature * (x**2 + y**2) - (2 * p + size + 1) * gouy
    spiral = _array.make_complex(*spiral_parts(x * 2**0.5 / width, y * 2**0.5 / width, charge))
    carrier = _array.phasor_of_cycles(distance / wavelength, xp.complex128) * xp.astype(xp.sqrt(power), xp.complex128)
    return carrier * xp.astype(envelope, xp.complex128) * _array.phasor(phase, xp.complex128) * spiral


@_validate.takes_units("dx", "wavelength", "waist", "offset", degrees=("angle",))
def bessel_beam(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float | Array,
    angle: float | Array,
    order: int = 0,
    waist: float | Array | None = None,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return a Bessel beam: plane waves on a cone, which keep their transverse profile.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Wavelength in the medium, in metres.
    angle : float or array
        Half angle of the cone in degrees.
    order : int
        Charge l of the vortex on the axis.
    waist : float or array, optional
        Radius of a Gaussian envelope in metres (a Bessel–Gauss beam); none by default.
    offset : sequence of float
        Position of the axis (rows, columns) in metres.
    xp : optional
        Array namespace; by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        Complex128 ``[rows, columns]``: J_l(k·sin(angle)·r)·exp(ilφ), times exp(−r²/waist²). Its peak amplitude is that
        of J_l, for an ideal Bessel beam has no finite power (J. Durnin, J. Opt. Soc. Am. A 4, 651 (1987)). Without an
        envelope it propagates by the phase k·cos(angle)·z alone. Differentiable in every number given as a tensor.

    Warns
    -----
    SamplingWarning
        If the pitch is too large or the window too small for the beam.

    Examples
    --------
    The first dark ring has the radius 2.405/(k·sin(angle)), here 11 µm:

    >>> from odak.wave import bessel_beam
    >>> beam = bessel_beam((101, 101), 1e-6, 500e-9, 1.0)
    >>> int(abs(beam[50, 50:70]).argmin())
    11
    """
    order = _validate.integer("order", order, minimum=-math.inf)
    _validate.number("angle", angle, positive=True, below=90, unit="degrees")
    if waist is not None:
        _validate.number("waist", waist, positive=True)
    given = (wavelength, angle)
    xp, (y, x), (wavelength, angle, *waists) = _prepare(
        shape, dx, offset, xp, device, wavelength=wavelength, angle=angle, waist=() if waist is None else (waist,)
    )
    for step in dx if isinstance(dx, (tuple, list)) else (dx,):
        warn_of_tilt("bessel_beam", step, 2 * math.pi / given[0], given[1])
    y, x = y[:, None], x[None, :]
    radius, axis = distance_from_axis(y, x)
    safe = xp.where(axis, xp.ones_like(radius), radius)
    field = _bessel(order, 2 * math.pi / wavelength * xp.sin(angle * (math.pi / 180)) * radius)
    for width in waists:
        field = field * xp.exp(-(y**2 + x**2) / width**2)
    cosine, sine = xp.where(axis, xp.ones_like(radius), x / safe), y / safe
    return xp.astype(field, xp.complex128) * _array.make_complex(*spiral_parts(cosine, sine, order))


@_validate.takes_units("dx", "scale", "offset")
def airy_beam(
    shape: Sequence[int],
    dx: float | Sequence[float],
    scale: float | Array | Sequence[float | Array],
    decay: float | Array = 0.05,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return a finite-energy Airy beam, whose peak follows a parabola.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    scale : float, array or sequence of these
        Transverse scale in metres, one number or (y, x); negative mirrors the beam. After a distance z the pattern has
        moved by z²/(4k²·scale³) along each axis.
    decay : float or array
        Exponential truncation a ≥ 0 of the tail.
    offset : sequence of float
        Position (rows, columns) of the origin in metres.
    xp : optional
        Array namespace; by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        Complex128 ``[rows, columns]``: Ai(y/y₀)·exp(a·y/y₀)·Ai(x/x₀)·exp(a·x/x₀) (G. A. Siviloglou and
        D. N. Christodoulides, Opt. Lett. 32, 979 (2007)), not normalised. Differentiable in every number given as a
        tensor.

    Warns
    -----
    SamplingWarning
        If the pitch is too large or the window too small for the beam.

    Examples
    --------
    Without truncation the main lobe lies at −1.02 scales, the largest value of the Airy function:

    >>> from odak.wave import airy_beam
    >>> beam = airy_beam((1, 201), 1e-6, 20e-6, decay=0.0)
    >>> (int(abs(beam[0]).argmax()) - 100) / 20
    -1.0
    """
    scales = _validate.several(
        "scale", _pair("scale", scale) if isinstance(scale, (list, tuple)) else (scale, scale), 2
    )
    for value in scales:
        _validate.real("scale", value, nonzero=True)
    _validate.number("decay", decay, least=0)
    given = (decay, *scales)
    xp, (y, x), (decay, *scales) = _prepare(shape, dx, offset, xp, device, decay=decay, waist=scales)
    _array.outside_graphs(_warn_of_airy, shape, dx, offset, given)
    along_y, along_x = (
        _airy(position / size) * xp.exp(decay * position / size)
        for position, size in zip((y[:, None], x[None, :]), scales, strict=True)
    )
    return xp.astype(along_y * along_x, xp.complex128)


def _warn_of_airy(shape, dx, offset, given):
    """Warn where the tail of an Airy beam, whose frequency grows towards its end, is undersampled."""
    lines, numbers = _lines(shape, dx, offset, given)
    if lines is None:
        return
    decay, *scales = numbers
    factors = []
    for (low, high), step, scale in zip(*lines, scales, strict=True):
        # The spectrum is exp(−a·(2πfx₀)²) in amplitude; on the grid the tail reaches √(−x/x₀).
        tail = max(1.0, -low / scale if scale > 0 else -high / scale) ** 0.5
        band = min(tail, math.inf if decay == 0 else max(1.0, 1.985 / math.sqrt(2 * decay)))
        factors.append(band * step / (math.pi * abs(scale)) if high > low else 0.0)
    factor, step = max(zip(factors, lines[1], strict=True))
    if factor:
        pitch = f"a pitch of at most {0.995 * step / factor:.3g} m"
        warn_of_factor("airy_beam", factor, (pitch, f"a scale of at least {1.005 * factor:.3g} times this"))


@_validate.takes_units("dx", "waist", "offset")
def flat_top_beam(
    shape: Sequence[int],
    dx: float | Sequence[float],
    waist: float | Array,
    order: float | Array = 10.0,
    power: float | Array = 1.0,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the amplitude of a flat-top beam, a super-Gaussian.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    waist : float or array
        Radius in metres at which the amplitude falls to 1/e.
    order : float or array
        Steepness n ≥ 1 of the edge: 1 is a Gaussian, a large number a disc.
    power : float or array
        Power of the beam.
    offset : sequence of float
        Position of the axis (rows, columns) in metres.
    xp : optional
        Array namespace; by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        Complex128 ``[rows, columns]``: exp(−(r/w)^(2n)) times the amplitude that gives the power. Differentiable in
        every number given as a tensor.

    Warns
    -----
    SamplingWarning
        If the pitch is too large or the window too small for the beam.

    Examples
    --------
    At the radius of the beam the intensity falls to 1/e² of the intensity on the axis:

    >>> from odak.wave import flat_top_beam
    >>> row = abs(flat_top_beam((65, 65), 8e-6, 160e-6)[32, 32:]) ** 2
    >>> round(float(row[20] / row[0]), 6)
    0.135335
    """
    _validate.number("order", order, least=1)
    _validate.number("waist", waist, positive=True)
    given = (waist, order)
    xp, (y, x), (power, order, waist) = _prepare(
        shape, dx, offset, xp, device, power=power, order=order, waist=(waist,)
    )
    _array.outside_graphs(_warn_of_flat_top, shape, dx, offset, given)
    area = math.pi * _gamma(1 / order) / (order * 2 ** (1 / order)) * waist**2
    squared = (y[:, None] ** 2 + x[None, :] ** 2) / waist**2
    return xp.astype(xp.sqrt(power / area) * xp.exp(-(squared**order)), xp.complex128)


def _warn_of_beam(name, shape, dx, offset, modes, numbers, ring=None):
    """Warn where a grid is too coarse or too small for a beam of Hermite functions of some weights.

    `ring` are the radial number and the size of the charge of a Laguerre–Gauss mode.
    """
    lines, numbers = _lines(shape, dx, offset, numbers)
    if lines is not None and all(value > 0 for value in (numbers[0], *numbers[2:])):
        (ends, pitch), (wavelength, distance, *waists) = lines, numbers
        kept = None
        if ring is not None:
            width = waists[0] * math.hypot(1, distance * wavelength / (math.pi * waists[0] ** 2))
            kept = _held_share(ends, pitch, lambda r: np.interp(2 * (r / width) ** 2, *_power_within(*ring)))
        warn_of_beam(name, modes, ends, pitch, wavelength, waists, distance, kept)


@functools.lru_cache(maxsize=64)
def _power_within(p: int, size: int):
    """Return places 2r²/w² and the share of a Laguerre–Gauss mode within them."""
    places = np.linspace(0.0, 4 * (2 * p + size + 1) + 40.0, 2000)
    density = places**size * np.exp(-places) * _laguerre(p, size, places) ** 2
    share = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    return places, share / share[-1]


def _lines(shape, dx, offset, numbers):
    """Return the first and last sample from the axis of a beam with the pitch, and the numbers, where known."""
    shape, steps = _validate.size("shape", shape), pitches(dx)
    plain = plain_numbers(*steps, *_validate.several("offset", offset, 2), *numbers)
    if plain is None:
        return None, ()
    ends = [
        (-(n // 2) * step - shift, ((n - 1) // 2) * step - shift)
        for n, step, shift in zip(shape, plain[:2], plain[2:4], strict=True)
    ]
    return (ends, plain[:2]), plain[4:]


@_validate.takes_units("dx")
def beam_width(field: Array, dx: float | Sequence[float], method: str = "D4sigma") -> Array:
    """Return the widths of a beam along rows and columns.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    method : str
        "D4sigma", four times the standard deviation of the intensity, or "knife-edge", twice the distance between the
        places of a knife that lets through 16 % and 84 % of the power. Both are 2w of a Gaussian beam of the radius w;
        the knife is less sensitive to light far away.

    Returns
    -------
    array
        float64 ``[..., 2]`` in metres: widths along rows (y) and columns (x), about the centroid. Differentiable in the
        field.

    Notes
    -----
    ISO 11146-1 and 11146-3 (2021, 2004). Background far from the beam widens second moments: take it away first.

    Examples
    --------
    >>> from odak.wave import beam_width, gaussian_beam
    >>> beam = gaussian_beam((128, 128), 8e-6, 532e-9, (100e-6, 60e-6))
    >>> [round(1e6 * float(width), 3) for width in beam_width(beam, 8e-6)]
    [200.0, 120.0]
    """
    knife = _validate.one_of("method", method, ("D4sigma", "knife-edge")) == "knife-edge"
    xp, profiles = _profiles(field, dx)
    widths = []
    for place, step, share in profiles:
        if knife:
            low, high = (_quantile(xp, share, step, level) for level in (0.158655254, 0.841344746))
            widths.append(2 * (high - low))
        else:
            mean = xp.sum(place * share, axis=-1, keepdims=True)
            widths.append(4 * xp.sqrt(xp.sum((place - mean) ** 2 * share, axis=-1)))
    return xp.stack(widths, axis=-1)


@_validate.takes_units("dx")
def beam_quality(field: Array, dx: float | Sequence[float]) -> Array:
    """Return the beam quality factor M² along rows and columns.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``, at any distance from the waist.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).

    Returns
    -------
    array
        float64 ``[..., 2]``: 1 of a Gaussian beam, 2n + 1 of a Hermite–Gauss mode of n zeros along the axis.

    Notes
    -----
    M² = 4π·√(σ_x²σ_f² − σ_xf²), with the second moments of places, of frequencies and of both: the curvature of the
    wavefront drops out (A. E. Siegman, Proc. SPIE 1224, 2 (1990)). Spectrum and field have to be held by the grid.

    Examples
    --------
    >>> from odak.wave import beam_quality, hermite_gaussian_beam
    >>> beam = hermite_gaussian_beam((128, 128), 8e-6, 532e-9, 100e-6, (0, 2), distance=0.05)
    >>> [round(float(value), 3) for value in beam_quality(beam, 8e-6)]
    [1.0, 5.0]
    """
    xp, profiles = _profiles(field, dx)
    field = xp.astype(_array.to_complex(field), xp.complex128)
    power = xp.sum(xp.real(field) ** 2 + xp.imag(field) ** 2, axis=(-2, -1))
    found = []
    for axis, (place, step, share) in zip((-2, -1), profiles, strict=True):
        n = field.shape[axis]
        frequency = xp.fft.ifftshift(xp.arange(n, dtype=xp.float64, device=_array.device_of(field)) - n // 2)
        frequency = frequency / (n * step)
        line = frequency[:, None] if axis == -2 else frequency
        spectrum = xp.fft.fft(field, axis=axis)
        density = xp.sum(xp.real(spectrum) ** 2 + xp.imag(spectrum) ** 2, axis=-3 - axis)
        density = density / xp.sum(density, axis=-1, keepdims=True)
        slope = xp.fft.ifft(spectrum * xp.astype(line, xp.complex128), axis=axis)
        along = place[:, None] if axis == -2 else place
        both = xp.sum(along * xp.real(xp.conj(field) * slope), axis=(-2, -1)) / power
        mean = xp.sum(place * share, axis=-1, keepdims=True)
        tilt = xp.sum(frequency * density, axis=-1, keepdims=True)
        wide = xp.sum((place - mean) ** 2 * share, axis=-1)
        band = xp.sum((frequency - tilt) ** 2 * density, axis=-1)
        together = both - (mean * tilt)[..., 0]
        found.append(4 * math.pi * xp.sqrt(wide * band - together**2))
    return xp.stack(found, axis=-1)


@_validate.takes_units("dx", "radius", "offset")
def power_in_bucket(
    field: Array, dx: float | Sequence[float], radius: float | Array, offset: Sequence[float] = (0.0, 0.0)
) -> Array:
    """Return the share of the power of a field that lies within a circle.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    radius : float or array
        Radius of the circle in metres; one number.
    offset : sequence of float
        Position of its centre (rows, columns) in metres.

    Returns
    -------
    array
        float64 ``[...]``, with the pixels of the rim by the area inside; differentiable in field and radius.

    Examples
    --------
    A Gaussian beam has 86.5 % of its power within its radius:

    >>> from odak.wave import gaussian_beam, power_in_bucket
    >>> beam = gaussian_beam((128, 128), 8e-6, 532e-9, 100e-6)
    >>> round(float(power_in_bucket(beam, 8e-6, 100e-6)), 2)
    0.86
    """
    xp, intensity, radius, steps, (y, x) = _about(field, dx, radius, offset)
    share = share_in_disc(y, x, steps, radius)
    return xp.sum(intensity * share, axis=(-2, -1)) / xp.sum(intensity, axis=(-2, -1))


def mode_overlap(field: Array, mode: Array) -> Array:
    """Return the share of the power of a field that is in a mode, |∑ mode*·field|²/(∑|mode|²·∑|field|²).

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``.
    mode : array
        Complex field of the mode on the same grid, such as :func:`laguerre_gaussian_beam` gives.

    Returns
    -------
    array
        float64 ``[...]``, 0 to 1.

    Examples
    --------
    Of two Gaussian beams it is (2·w₁w₂/(w₁² + w₂²))²:

    >>> from odak.wave import gaussian_beam, mode_overlap
    >>> beam = gaussian_beam((16, 16), 8e-6, 532e-9, 20e-6)
    >>> wider = gaussian_beam((16, 16), 8e-6, 532e-9, 30e-6)
    >>> round(float(mode_overlap(beam, wider)), 3)
    0.852
    """
    xp, intensity = _intensity(field)
    field = xp.astype(_array.to_complex(field), xp.complex128)
    mode = _array.cast(_validate.image("mode", mode), field)
    _validate.fitting(field=field, mode=mode)
    product = xp.sum(xp.conj(mode) * field, axis=(-2, -1))
    norm = xp.sum(xp.real(mode) ** 2 + xp.imag(mode) ** 2, axis=(-2, -1)) * xp.sum(intensity, axis=(-2, -1))
    return (xp.real(product) ** 2 + xp.imag(product) ** 2) / norm


@_validate.takes_units("dx", "radius", "offset")
def fibre_coupling(
    field: Array, dx: float | Sequence[float], radius: float | Array, offset: Sequence[float] = (0.0, 0.0)
) -> Array:
    """Return the share of the power of a field that couples into a single-mode fibre.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]`` on the end of the fibre.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    radius : float or array
        Mode field radius in metres, at which the amplitude of the Gaussian mode falls to 1/e; half the mode field
        diameter of a data sheet.
    offset : sequence of float
        Position of the fibre's axis (rows, columns) in metres.

    Returns
    -------
    array
        float64 ``[...]``: the overlap with the mode on the whole plane, without reflections at the end; differentiable
        in field, radius and position.

    Warns
    -----
    SamplingWarning
        If the pitch is too large or the window too small for the mode.

    Examples
    --------
    A fibre beside the axis, by half the radius of its mode, gets exp(−1/4):

    >>> from odak.wave import fibre_coupling, gaussian_beam
    >>> beam = gaussian_beam((128, 128), 8e-6, 532e-9, 100e-6)
    >>> round(float(fibre_coupling(beam, 8e-6, 100e-6, (50e-6, 0.0))), 4)
    0.7788
    """
    numbers = 1.0, 0.0, radius, radius
    xp, intensity, radius, steps, (y, x) = _about(field, dx, radius, offset)
    shape = tuple(intensity.shape[-2:])
    _array.outside_graphs(_warn_of_beam, "the mode of the fibre", shape, dx, offset, ((1.0,),) * 2, numbers)
    area = math.pi / 2 * radius**2 / (steps[0] * steps[1])
    mode = xp.astype(xp.exp(-(y**2 + x**2) / radius**2), xp.complex128)
    product = xp.sum(mode * xp.astype(_array.to_complex(field), xp.complex128), axis=(-2, -1))
    return (xp.real(product) ** 2 + xp.imag(product) ** 2) / (area * xp.sum(intensity, axis=(-2, -1)))


def _intensity(field):
    """Return the namespace and the intensity of a field, float64."""
    field = _array.to_complex(_validate.image("field", field))
    xp = namespace(field)
    field = xp.astype(field, xp.complex128)
    return xp, xp.real(field) ** 2 + xp.imag(field) ** 2


def _about(field, dx, radius, offset):
    """Return the namespace and the intensity of a field, a radius as an array, and pitches and places of samples."""
    _validate.number("radius", radius, positive=True)
    xp, intensity = _intensity(field)
    steps, places = grid_positions(intensity.shape[-2:], dx, offset, xp, _array.device_of(intensity))
    return xp, intensity, xp.reshape(_array.cast(radius, intensity, xp.float64), ()), steps, places


def _profiles(field, dx):
    """Return the namespace; for rows and columns the places, the pitch and the share of the power at each place."""
    xp, intensity = _intensity(field)
    steps, (y, x) = grid_positions(intensity.shape[-2:], dx, (0.0, 0.0), xp, _array.device_of(intensity))
    total = xp.sum(intensity, axis=(-2, -1))[..., None]
    shares = [xp.sum(intensity, axis=axis) / total for axis in (-1, -2)]
    return xp, list(zip((y[:, 0], x[0, :]), steps, shares, strict=True))


def _quantile(xp, share, step, level: float):
    """Return where a share of the power is on one side, from the first sample's edge, linear within pixels."""
    before = xp.cumulative_sum(share, axis=-1) - share
    safe = xp.where(share > 0, share, xp.ones_like(share))
    part = xp.where(share > 0, xp.clip((level - before) / safe, 0.0, 1.0), xp.astype(before < level, xp.float64))
    return step * xp.sum(part, axis=-1)


def _hermite_mode(xp, position, wavelength, waist, order: int, distance):
    """Return a one-dimensional mode of unit power, without its carrier."""
    width, curvature, gouy = _gaussian(xp, wavelength, waist, distance)
    scaled = position * 2**0.5 / width
    # Recurrence of the normalised Hermite functions, which stay of order 1 where H_n itself overflows.
    before, now = 0 * scaled, (2 / math.pi) ** 0.25 / xp.sqrt(width) * xp.exp(-(scaled**2) / 2)
    for n in range(order):
        before, now = now, (2 / (n + 1)) ** 0.5 * scaled * now - (n / (n + 1)) ** 0.5 * before
    phase = math.pi / wavelength * curvature * position**2 - (order + 0.5) * gouy
    return xp.astype(now, xp.complex128) * _array.phasor(phase, xp.complex128)


def _gaussian(xp, wavelength, waist, distance):
    """Return the radius, the curvature of the wavefront and the Gouy phase of a Gaussian beam."""
    rayleigh = math.pi * waist**2 / wavelength
    width = waist * xp.sqrt(1 + (distance / rayleigh) ** 2)
    return width, distance / (distance**2 + rayleigh**2), xp.atan(distance / rayleigh)


@functools.lru_cache(maxsize=64)
def _hermite_weights(p: int, size: int) -> tuple[float, ...]:
    """Return the shares of the Hermite–Gauss modes in a Laguerre–Gauss mode, by their number of zeros along one axis.

    M. W. Beijersbergen et al., Opt. Commun. 96, 123 (1993), eq. 9.
    """
    n, m = p + size, p
    polynomial = np.polynomial.Polynomial([1.0])
    for factor, times in (([1.0, -1.0], n), ([1.0, 1.0], m)):
        polynomial = polynomial * np.polynomial.Polynomial(factor) ** times
    logs = [math.lgamma(k + 1) + math.lgamma(n + m - k + 1) for k in range(n + m + 1)]
    norm = math.lgamma(n + 1) + math.lgamma(m + 1) + (n + m) * math.log(2)
    return tuple(float(t**2 * math.exp(log - norm)) for t, log in zip(polynomial.coef, logs, strict=True))


def _laguerre(p: int, size: int, x):
    """Return the generalised Laguerre polynomial L_p^size(x) by its recurrence."""
    before, now = 0 * x, 1 + 0 * x
    for n in range(p):
        before, now = now, ((2 * n + 1 + size - x) * now - (n + size) * before) / (n + 1)
    return now


def _pair(name: str, value) -> tuple[Any, ...]:
    if isinstance(value, (str, bytes)) or not hasattr(value, "__len__") or len(value) != 2:
        raise ValueError(f"{name} must be two numbers (rows, columns), got {value!r:.100}")
    return tuple(value)


def _prepare(shape, dx, offset, xp, device, **numbers):
    """Return the namespace, the positions (y, x) and the checked numbers in double precision, the waists last."""
    waists = {f"waist {i}": value for i, value in enumerate(numbers.pop("waist"))}
    for name in {"wavelength", "power"} & set(numbers):
        _validate.number(name, numbers[name], positive=True)
    xp, device, values = single_numbers(xp, device, **numbers, **waists)
    _, (y, x) = grid_positions(shape, dx, offset, xp, device)
    return xp, (y[:, 0], x[0, :]), values


def _bessel(order: int, x):
    """Return the Bessel function of the first kind of an array."""

    def derivative(x):
        return (_bessel(order - 1, x) - _bessel(order + 1, x)) / 2

    return _of_scipy(lambda x: scipy.special.jv(order, x), derivative, x)


def _airy(x):
    """Return the Airy function of an array."""

    def derivative(x):
        return _of_scipy(lambda x: scipy.special.airy(x)[1], lambda x: x * _airy(x), x)

    return _of_scipy(lambda x: scipy.special.airy(x)[0], derivative, x)


def _gamma(x):
    """Return the gamma function of an array of positive numbers."""
    return _of_scipy(scipy.special.gamma, lambda x: _gamma(x) * x.digamma(), x)


def _of_scipy(function, derivative, x):
    """Return a function of SciPy of an array; `derivative` takes a tensor to the derivative there."""
    if _array.is_torch(x):
        return _operator().apply(x, function, derivative)
    return namespace(x).asarray(function(np.asarray(x)), device=_array.device_of(x))


@functools.cache
def _operator():
    """Return the operator of PyTorch that applies a function of SciPy, differentiable as often as its derivative."""
    import torch

    class Elementwise(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x, function, derivative):
            ctx.derivative = derivative
            ctx.save_for_backward(x)
            return torch.as_tensor(function(x.detach().cpu().numpy()), dtype=x.dtype, device=x.device)

        @staticmethod
        def backward(ctx, gradient):
            return gradient * ctx.derivative(*ctx.saved_tensors), None, None

    return Elementwise
