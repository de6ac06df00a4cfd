"""Partially coherent light: intensities summed over the wavelengths of a spectrum and the points of a source."""

import math
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array, Device, Numbers, phasor_of_cycles
from odak.wave.fourier import centred
from odak.wave.transfer_functions import check_geometry, pitches
from odak.wave.windows import GUARD, propagate_to_window

MEMORY = 1 << 26
# Arrays of the size of field and window together that a propagation holds at once.
_COPIES = 8


@_validate.takes_units("distance", "dx", "window_dx", "offset")
def propagate_partially_coherent(
    field: Array | Callable[..., Any],
    spectrum: float | Array | tuple[Numbers, Numbers],
    source: tuple[Array, Array] | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    window_shape: Sequence[int] | None = None,
    window_dx: float | Sequence[float] | None = None,
    offset: Sequence[float] = (0.0, 0.0),
    guard: float = GUARD,
    memory: int = MEMORY,
) -> Array:
    """Return the intensity on a window under partially coherent light: several wavelengths and directions.

    Parameters
    ----------
    field : array or callable
        Complex ``[..., rows, columns]``: the field in the first plane under a plane wave along the axis, such as the
        transmittance of an object. A callable is given the wavelength (a float64 scalar) and returns that field.
    spectrum : float or tuple
        One wavelength in metres, or the wavelengths ``[L]`` and their weights ``[L]``; see :func:`gaussian_spectrum`.
    source : tuple or None
        Directions ``[S, 2]`` of the incident plane waves, as sines of their angles to the axis along rows and columns
        (y, x), and their weights ``[S]``; see :func:`disk_source`. None is a point on the axis.
    distance : float or array
        Distance in metres, negative to propagate back; an array broadcasts against the field's leading axes.
    dx : float, pair of float or array
        Pixel pitch of the field in metres, one number or a pair (rows, columns).
    window_shape : sequence of int, optional
        Rows and columns of the window; by default the shape of the field.
    window_dx : float, pair of float or array, optional
        Pixel pitch of the window in metres; by default the pitch of the field.
    offset : sequence of two floats or arrays, default: (0.0, 0.0)
        Position (y, x) of the window's sample ``n // 2`` in metres from the optical axis.
    guard : float
        Margin for diffraction around the rays, in units of sqrt(λ·path), see :func:`odak.wave.propagate_to_window`.
    memory : int
        Bytes, roughly, that directions propagated at once may take; one at a time where this is not enough.

    Returns
    -------
    array
        Real intensity Σ w_λ·Σ w_s·|u|², ``[..., window rows, window columns]``, in the field's library and precision.
        Differentiable in field, weights, wavelengths, directions and lengths.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Different wavelengths do not interfere on a detector, nor do different points of a thermal source (Born and Wolf,
    Principles of Optics, 1999, sections 10.2 and 10.4). A source at a finite distance R whose points lie at (Y, X) has
    directions (−Y, −X)/R as far as it is far away.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import disk_source, gaussian_spectrum, propagate_partially_coherent
    >>> slit = np.zeros((16, 64), dtype=np.complex128)
    >>> slit[:, 28:36] = 1
    >>> lamp = gaussian_spectrum(550e-9, 20e-9, 3), disk_source(1e-3, 2, 6)
    >>> tuple(propagate_partially_coherent(slit, *lamp, 0.01, 8e-6).shape)
    (16, 64)
    """
    return sum_intensities(
        lambda step, *values: step(*values),
        field,
        spectrum,
        source,
        memory,
        distance=distance,
        dx=dx,
        window_shape=window_shape,
        window_dx=window_dx,
        offset=offset,
        guard=guard,
    )


def sum_intensities(
    run: Callable, field: Array | Callable[..., Any], spectrum: Any, source: Any, memory: int, **geometry: Any
) -> Any:
    """Return :func:`propagate_partially_coherent`, each share of the sum by ``run(step, field, wavelength, …)``."""
    wavelengths, weights = _spectrum(spectrum)
    _validate.integer("memory", memory, minimum=1)
    if geometry["window_shape"] is not None:
        geometry["window_shape"] = _validate.size("window_shape", geometry["window_shape"])
    check_geometry(None, geometry["distance"], geometry["dx"], 1.0)
    total = 0.0
    for index in range(len(_validate.numbers(wavelengths))):
        wavelength = wavelengths[index]
        incident = _array.to_complex(_validate.image("field", field(wavelength) if callable(field) else field))
        directions, shares = _source(source, incident)
        step = _step(geometry)
        for start, stop in _chunks(incident, directions.shape[0], memory, geometry):
            part = run(step, incident, wavelength, directions[start:stop, :], shares[start:stop])
            total = total + part * _array.cast(weights[index], part)
    return total


def _step(geometry: dict[Any, Any]) -> Callable[..., Any]:
    """Return the function that propagates a field lit from some directions and sums the intensities."""
    geometry = dict(geometry)
    distance, dx = geometry.pop("distance"), geometry.pop("dx")
    ranks = [len(getattr(value, "shape", ())) for value in (distance, *pitches(dx))]

    def step(field, wavelength, directions, shares):
        rank = max(field.ndim - 2, *ranks)
        lit = _illuminated(field, wavelength, directions, dx, rank)
        result = propagate_to_window(lit, wavelength, distance, dx, **geometry)
        xp = _array.namespace(result)
        intensity = xp.real(result) ** 2 + xp.imag(result) ** 2
        return xp.sum(intensity * xp.reshape(_array.cast(shares, intensity), (-1,) + (1,) * (rank + 2)), axis=0)

    return step


def _illuminated(field, wavelength, directions, dx, rank: int):
    """Return the field times plane waves from each direction, ``[directions, …, rows, columns]``."""
    xp = _array.namespace(field)
    tilts = [xp.reshape(directions[:, axis], (-1,) + (1,) * (rank + 2)) for axis in (0, 1)]
    lit = xp.reshape(field, (1,) * (rank + 3 - field.ndim) + tuple(field.shape))
    wavelength, *steps = (_array.cast(value, directions) for value in (wavelength, *pitches(dx)))
    steps = [xp.reshape(step / wavelength, (*step.shape, 1, 1)) for step in steps]
    for axis, tilt, pitch in zip((-2, -1), tilts, steps, strict=True):
        lit = lit * phasor_of_cycles(tilt * pitch * centred(directions, field.shape[axis], axis), field.dtype)
    return lit


def _chunks(field, count: int, memory: int, geometry: dict[Any, Any]) -> list[tuple[int, int]]:
    """Return (start, stop) of the directions that go together."""
    shape = geometry["window_shape"] or field.shape[-2:]
    box = math.prod(n + m for n, m in zip(field.shape[-2:], shape, strict=True))
    batch = math.prod(field.shape[:-2]) * max(1, math.prod(getattr(geometry["distance"], "shape", ())))
    size = max(1, memory // (_COPIES * box * max(1, batch) * (16 if _array.is_double(field) else 8)))
    return [(start, min(start + size, count)) for start in range(0, count, size)]


def _spectrum(spectrum):
    if not isinstance(spectrum, (tuple, list)):
        wavelength = _validate.real("spectrum", spectrum, positive=True)
        return [wavelength], [1.0]
    if len(spectrum) != 2:
        raise ValueError(f"spectrum must be a wavelength or (wavelengths, weights), got {len(spectrum)} values")
    wavelengths, weights = spectrum
    _validate.real("spectrum[0]", wavelengths, positive=True)
    _validate.real("spectrum[1]", weights)
    counts = [len(_validate.numbers(value)) for value in spectrum]
    if counts[0] != counts[1] or counts[0] == 0:
        raise ValueError(f"spectrum must have a weight for each wavelength, got {counts[0]} and {counts[1]}")
    return wavelengths, weights


def _source(source, field):
    """Return the directions and their weights, float64 in the field's library."""
    xp = _array.namespace(field)
    if source is None:
        source = np.zeros((1, 2)), np.ones(1)
    if not isinstance(source, (tuple, list)) or len(source) != 2:
        raise ValueError("source must be None or (directions, weights)")
    like = xp.zeros(1, dtype=xp.float64, device=_array.device_of(field))
    for value in source:
        _validate.real("source", value)
    directions, weights = (_array.cast(value, like) for value in source)
    if directions.ndim != 2 or directions.shape[-1] != 2 or tuple(weights.shape) != tuple(directions.shape[:1]):
        raise ValueError(
            f"source must be directions [S, 2] and weights [S], got {tuple(directions.shape)}, {tuple(weights.shape)}"
        )
    return directions, weights


@_validate.takes_units("wavelength", "width")
def gaussian_spectrum(
    wavelength: float, width: float, count: int = 9, *, xp: ModuleType | None = None, device: Device = None
) -> tuple[Array, Array]:
    """Return wavelengths and weights of a quadrature over a Gaussian spectral line.

    Parameters
    ----------
    wavelength : float
        Its centre in metres; a tensor may require a gradient.
    width : float
        Its full width at half maximum in metres of wavelength; a tensor may require a gradient.
    count : int
        Number of wavelengths. Fringes are right up to a path difference of about sqrt(count)/2 coherence lengths.
    xp : module, optional
        Array library of the result, NumPy by default.
    device : optional
        Device of the result.

    Returns
    -------
    tuple of array
        Wavelengths ``[count]`` in metres and weights ``[count]`` of sum 1, float64.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, or the line reaches down to frequency zero.

    Notes
    -----
    The line is Gaussian in wave number σ = 1/λ with a full width Δσ = width/λ², and the nodes belong to
    Gauss–Hermite quadrature. The visibility at a path difference l is then exp(−(π·Δσ·l)²/(4·ln 2)) (Goodman,
    Statistical Optics, 1985, eq. 5.1-27): one coherence length, sqrt(2·ln 2/π)/Δσ, leaves 0.21.

    Examples
    --------
    >>> from odak.wave import gaussian_spectrum
    >>> wavelengths, weights = gaussian_spectrum(550e-9, 10e-9, 3)
    >>> [round(float(value) * 1e9, 1) for value in wavelengths]
    [557.5, 550.0, 542.7]
    """
    wavelength = _validate.number("wavelength", wavelength, positive=True)
    width = _validate.number("width", width, positive=True)
    nodes, weights = np.polynomial.hermite.hermgauss(_validate.integer("count", count, minimum=1))
    nodes = nodes / (2 * math.sqrt(math.log(2)))
    ends = zip(_validate.numbers(width), _validate.numbers(wavelength), strict=True)
    if any(1 + nodes.min() * change / length <= 0 for change, length in ends):
        raise ValueError(f"width must be small against the wavelength {wavelength!r}, got {width!r}")
    length, width, nodes, weights = _converted(xp, device, wavelength, width, nodes, weights / weights.sum())
    return length / (1 + nodes * width / length), weights


@_validate.takes_units()
def disk_source(
    radius: float,
    rings: int = 4,
    spokes: int = 12,
    center: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> tuple[Array, Array]:
    """Return directions and weights of a quadrature over a uniformly bright disk.

    Parameters
    ----------
    radius : float
        Sine of the angle under which the disk's radius is seen; a tensor may require a gradient, and so may `center`.
    rings : int, default: 4
        Directions along the radius; they should exceed a quarter of the phase 2π·radius·r/λ at the largest separation r
        of interest on the illuminated plane.
    spokes : int, default: 12
        Directions around the circle; they should exceed that phase by some.
    center : sequence of float
        Direction (y, x) of the disk's centre, as sines.
    xp : module, optional
        Array library of the result, NumPy by default.
    device : optional
        Device of the result.

    Returns
    -------
    tuple of array
        Directions ``[rings·spokes, 2]`` (sines along y and x) and weights ``[rings·spokes]`` of sum 1, float64.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, or a direction's sine reaches 1.

    Notes
    -----
    Gauss–Legendre nodes in the squared radius, equal steps around. The light is coherent between two points at a
    distance r to the degree 2·J1(ρ)/ρ, ρ = 2π·radius·r/λ (van Cittert and Zernike; Born and Wolf 1999, section 10.4.2).

    Examples
    --------
    >>> from odak.wave import disk_source
    >>> directions, weights = disk_source(1e-3)
    >>> tuple(directions.shape), round(float(weights.sum()), 12)
    ((48, 2), 1.0)
    """
    radius = _validate.number("radius", radius, positive=True)
    nodes, shares = np.polynomial.legendre.leggauss(_validate.integer("rings", rings, minimum=1))
    spokes = _validate.integer("spokes", spokes, minimum=1)
    # Every other ring is turned by half a step, which spreads the directions more evenly.
    angles = 2 * np.pi * (np.arange(spokes) + 0.5 * (np.arange(rings)[:, None] % 2)) / spokes
    radii = np.sqrt((1 + nodes[:, None]) / 2)
    unit = np.stack([radii * np.sin(angles), radii * np.cos(angles)], -1).reshape(-1, 2)
    center = _validate.several("center", center, 2)
    numbers = np.asarray(_validate.numbers(radius)) * unit + np.asarray([_validate.numbers(v)[0] for v in center])
    if np.hypot(*numbers.T).max() >= 1:
        raise ValueError(f"radius and center must give sines below 1, got radius {radius!r} about {tuple(center)!r}")
    xp = _validate.library("xp", xp)
    radius, unit, weights, *middle = _converted(
        xp, device, radius, unit, np.repeat(shares / (2 * spokes), spokes), *center
    )
    return radius * unit + xp.stack([xp.reshape(value, ()) for value in middle]), weights


def _converted(xp, device, *values) -> tuple[Any, ...]:
    xp = _validate.library("xp", xp)
    return tuple(_array.converted(value, xp, device, xp.float64) for value in values)
