"""What a field looks like: amplitude, phase, intensity and angular spectrum as images, reduced for display."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from odak import _validate

MAXIMUM_SIDE = 1024
SPECTRUM_FLOOR = -60.0  # dB
CYCLIC_SCALE = "Twilight"
_UNITS = (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9))


class Panel(NamedTuple):
    """One image, ready to draw.

    Attributes
    ----------
    values : numpy.ndarray
        ``[rows, columns]``.
    axes : dict
        Places of columns and rows, under the names that a heat map gives them.
    labels : tuple of str
        Names of the axes with their unit, empty where they count samples.
    factor : int
        How many samples of the field, along each axis, make one of the image.
    """

    values: np.ndarray
    axes: dict
    labels: tuple[str, str]
    factor: int


class Quantity(NamedTuple):
    """Something of a field that can be drawn.

    Attributes
    ----------
    panel : callable
        Makes a :class:`Panel` of a field, its pitch, the wavelength, and the longest side to draw.
    bar : str
        Name and unit, beside the colours.
    cyclic : bool
        Whether its two ends are the same.
    limits : tuple
        Values at the ends of the colours, None where they follow from the image.
    reduced : str
        What becomes of samples that are drawn as one.
    """

    panel: Callable[..., Panel]
    bar: str
    cyclic: bool = False
    limits: tuple = (None, None)
    reduced: str = "averaged"


def reduction(shape: tuple[int, ...], limit: int) -> int:
    """Return how many samples must become one for no side to be longer than `limit`."""
    return max(1, math.ceil(max(shape) / limit))


def averaged(values: np.ndarray, factor: int) -> np.ndarray:
    """Return the means of blocks of `factor` × `factor` samples, those at the far edges of what there is."""
    if factor == 1:
        return values
    values = values.astype(np.result_type(values, np.float32), copy=False)
    for axis in range(2):
        starts = np.arange(0, values.shape[axis], factor)
        counts = np.minimum(factor, values.shape[axis] - starts).astype(values.dtype)
        values = np.add.reduceat(values, starts, axis=axis) / (counts[:, None] if axis == 0 else counts)
    return values


def picked(values: np.ndarray, factor: int) -> np.ndarray:
    """Return the middle sample of each block of `factor` × `factor`."""
    rows, columns = (np.minimum(np.arange(0, n, factor) + factor // 2, n - 1) for n in values.shape)
    return values[np.ix_(rows, columns)]


def value_panel(values: np.ndarray, dx=None, wavelength=None, limit: int = MAXIMUM_SIDE) -> Panel:
    """Return a real image as it is."""
    return _in_space(averaged, values, dx, limit)


def amplitude(field, dx=None, wavelength=None, limit=MAXIMUM_SIDE) -> Panel:
    """Return the amplitude; of several samples the root of their mean intensity."""
    return _in_space(lambda u, f: np.abs(u) if f == 1 else np.sqrt(averaged(_power(u), f)), field, dx, limit)


def phase(field, dx=None, wavelength=None, limit=MAXIMUM_SIDE) -> Panel:
    """Return the phase in degrees."""
    return _in_space(lambda u, f: np.rad2deg(np.angle(picked(u, f))), field, dx, limit)


def intensity(field, dx=None, wavelength=None, limit=MAXIMUM_SIDE) -> Panel:
    """Return the squared amplitude."""
    return _in_space(lambda u, f: averaged(_power(u), f), field, dx, limit)


def spectrum(field, dx=None, wavelength=None, limit=MAXIMUM_SIDE) -> Panel:
    """Return the power of the plane waves that make up the field in dB below the strongest, over their angles.

    Angles are those whose sines are the direction cosines λ·f along x and y; what is evanescent is left out.
    """
    if dx is None or wavelength is None:
        raise ValueError("the angular spectrum needs dx and wavelength, in metres")
    dx, wavelength = _number("dx", dx), _number("wavelength", wavelength)
    power = _power(np.fft.fftshift(np.fft.fft2(field)))
    sines = [np.fft.fftshift(np.fft.fftfreq(n, dx)) * wavelength for n in field.shape]
    inside = [np.flatnonzero(np.abs(sine) < 1) for sine in sines]
    power = power[np.ix_(*inside)]
    factor = reduction(power.shape, limit)
    starts = [np.arange(0, len(index), factor) for index in inside]
    y, x = (
        np.add.reduceat(sine[index], start) / np.minimum(factor, len(index) - start)
        for sine, index, start in zip(sines, inside, starts, strict=True)
    )
    power = averaged(power, factor)
    strongest = power.max()
    floor = 10 ** (SPECTRUM_FLOOR / 10)
    decibels = 10 * np.log10(np.maximum(power / strongest if strongest > 0 else power, floor))
    axes = {"x": np.rad2deg(np.arcsin(x)), "y": np.rad2deg(np.arcsin(y))}
    return Panel(decibels, axes, ("angle along x (°)", "angle along y (°)"), factor)


QUANTITIES = {
    "amplitude": Quantity(amplitude, "amplitude (a.u.)", limits=(0, None), reduced="root mean square"),
    "phase": Quantity(phase, "phase (°)", True, (-180, 180), "every k-th sample"),
    "intensity": Quantity(intensity, "intensity (a.u.)", limits=(0, None)),
    "spectrum": Quantity(spectrum, "power (dB)", limits=(SPECTRUM_FLOOR, 0)),
}


def unit_of(extent: float) -> tuple[str, float]:
    """Return the name and the size in metres of the unit that a length is best told in."""
    return next(((name, size) for name, size in _UNITS if extent >= size), _UNITS[-1])


def length(value: float) -> str:
    """Return a length in metres as a text, such as ``"532 nm"``."""
    name, size = unit_of(value)
    return f"{value / size:.6g} {name}"


def _in_space(compute, field, dx, limit) -> Panel:
    factor = reduction(field.shape, limit)
    unit, size = None, 1.0
    if dx is not None:
        dx = _number("dx", dx)
        unit, size = unit_of(dx * max(field.shape))
    step = (dx or 1.0) / size
    # The sample at n // 2 is the axis; without a pitch samples are counted from 0.
    start = [((factor - 1) / 2 - (n // 2 if dx else 0)) * step for n in field.shape]
    axes = {"y0": start[0], "dy": factor * step, "x0": start[1], "dx": factor * step}
    return Panel(compute(field, factor), axes, (f"x ({unit})", f"y ({unit})") if unit else ("", ""), factor)


def _power(field) -> np.ndarray:
    return field.real**2 + field.imag**2


def _number(name, value) -> float:
    (number,) = _validate.numbers(_validate.real(name, value, positive=True))
    return number
