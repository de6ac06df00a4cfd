"""Which plane waves matter between a field and a window: those whose rays lead from one to the other.

Diffraction asks for some room around the rays, the guard, within which the plane waves fade out.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft

from odak import _array, _validate
from odak.wave.frequency_box import MAXIMUM_FREQUENCIES, Line, Window, column
from odak.wave.grid import Grid

# Where the band of a field is looked at, in units of its highest frequency.
_BAND = np.linspace(-1, 1, 33)
_FRACTIONS = np.linspace(-0.5, 0.5, 7)


@dataclass(frozen=True)
class Rays:
    """The rays from a field to a window, float64 ``[..., 1, 1]``.

    Attributes
    ----------
    dx, wavelength, distance : array
        Those of the field, in metres.
    source, width, offset : tuple of array
        Extents of the field and of the window and the window's place, along rows and columns.
    guard : array
        Room around the rays in metres, the window's guard times a Fresnel length.
    axes : tuple
        Unit vectors (x, y, z) along the window's columns, its rows and its normal.
    """

    dx: Any
    wavelength: Any
    distance: Any
    source: tuple
    width: tuple
    offset: tuple
    guard: Any
    axes: tuple

    @classmethod
    def between(cls, grid: Grid, window: Window) -> "Rays":
        """Return the rays from the grid's field to the window."""
        xp, dx, wavelength, distance = grid.xp, grid.dx, grid.wavelength, grid.distance
        offset = tuple(column(value, grid) for value in window.offset)
        pitch = dx if window.dx is None else column(window.dx, grid)
        axes = tuple(tuple(_array.cast(value, grid.dx) for value in unit) for unit in window.axes)
        # Symmetric extents: an even number of samples has one more before sample n // 2 than after it.
        source = tuple((2 * (n // 2) + 1) * dx for n in grid.shape)
        width = tuple((2 * (n // 2) + 1) * pitch for n in window.shape)
        x, y, z = (offset[1] * axes[0][k] + offset[0] * axes[1][k] + distance * float(k == 2) for k in range(3))
        path = xp.sqrt(x**2 + y**2 + z**2 + wavelength**2)
        # On a plane that the rays meet at a slant, diffraction spreads further: four times at most.
        across = xp.abs(x * axes[2][0] + y * axes[2][1] + z * axes[2][2])
        guard = window.guard * xp.sqrt(wavelength * path) * path / xp.maximum(across, path / 4)
        return cls(dx, wavelength, distance, source, width, offset, guard, axes)

    def numbers(self) -> "Rays":
        """Return the rays as NumPy constants, which decide how many frequencies there are."""
        return Rays(*(_constant(value) for value in vars(self).values()))

    def directions(self):
        """Return the frequencies (x, y, z) of the rays, in 1/m ``[..., 1, rays]``, as far as the field holds them.

        NumPy constants are needed, those of :meth:`numbers`.
        """
        fractions = np.stack(np.meshgrid(*[_FRACTIONS] * 4), 0).reshape(4, 1, -1)
        down, across = (
            o + f * (w + 2 * self.guard) for o, f, w in zip(self.offset, fractions, self.width, strict=False)
        )
        start = (self.source[1] * fractions[3], self.source[0] * fractions[2], -self.distance)
        ray = [across * self.axes[0][k] + down * self.axes[1][k] - start[k] for k in range(3)]
        # A wave reaches points behind the field's plane against its direction.
        length = np.where(ray[2] < 0, -1.0, 1.0) * self.wavelength * np.sqrt(sum(v**2 for v in ray) + 1e-30)
        nyquist = 1 / (2 * self.dx)
        fx, fy = (np.clip(v / length, -nyquist, nyquist) for v in ray[:2])
        return fx, fy, np.sqrt(np.maximum(1 / self.wavelength**2 - fx**2 - fy**2, 0))

    def trace(self, slope, unit):
        """Return the width on the window's plane, along `unit`, of the light that leaves the field at a slope."""
        normal = self.axes[2]
        return abs(unit[0] - normal[0] * slope) * self.source[1] + abs(unit[1] - normal[1] * slope) * self.source[0]

    def lines(self) -> tuple[Line, Line]:
        """Return the frequencies in the window's plane, along rows and columns, that serve the whole batch.

        A sum over frequencies repeats the light along the window. The period holds the window, the trace of the
        field and the guard, so that no copy falls on the window.
        """
        rays = self.numbers()
        waves = rays.directions()
        along = sum(f * n for f, n in zip(waves, rays.axes[2], strict=True))
        lines = []
        for axis, unit in ((-2, rays.axes[1]), (-1, rays.axes[0])):
            frequency = sum(f * u for f, u in zip(waves, unit, strict=True))
            # Waves that graze the window's plane trace without end; ten times is as far as we follow.
            trace = rays.trace(frequency / np.maximum(along, 0.1 / rays.wavelength), unit)
            period = ((trace.max(-1, keepdims=True) + rays.width[axis] + rays.guard) / rays.dx).max()
            lines.append(rays._line(axis, frequency, unit, scipy.fft.next_fast_len(math.ceil(period))))
        counts = [line.count for line in lines]
        if math.prod(counts) > MAXIMUM_FREQUENCIES:
            raise ValueError(
                f"window_shape, window_dx and guard ask for {counts[0]} x {counts[1]} frequencies, more than "
                f"{MAXIMUM_FREQUENCIES}; take a smaller window, a smaller guard or a field of larger pitch"
            )
        return lines[0], lines[1]

    def _line(self, axis: int, frequency, unit, period: int) -> Line:
        """Return the line from the lowest to the highest frequency of the whole batch."""
        cycles = frequency * self.dx
        # Close to the field every wave counts that it holds, whatever its direction.
        near = np.abs(self.distance) < 10 * self.wavelength
        low, high = (np.where(near, side, cycles) for side in self._band(unit))
        # Rounding must not add an index at either end.
        first, last = math.floor(low.min() * period + 1e-9), math.ceil(high.max() * period - 1e-9)
        return Line(axis, first, last + 1 - first, period)

    def _band(self, unit):
        """Return the lowest and the highest frequency along `unit`, in cycles per sample, of all waves in the field."""
        nyquist = 1 / (2 * self.dx)
        fx, fy = (nyquist * v.reshape(1, -1) for v in np.meshgrid(_BAND, _BAND))
        fz = np.sqrt(np.maximum(1 / self.wavelength**2 - fx**2 - fy**2, 0))
        cycles = (unit[0] * fx + unit[1] * fy + unit[2] * fz) * self.dx
        return cycles.min(-1, keepdims=True), cycles.max(-1, keepdims=True)

    def weight(self, guard: float, slopes):
        """Return how much of each plane wave is kept: 1 if its rays lead to the window, 0 if not even nearly.

        `slopes` are its frequencies along the window's rows and columns over that along the window's normal; `guard`
        is the window's.
        """
        kept = 1.0
        normal = self.axes[2]
        for axis, unit, slope in zip((-2, -1), (self.axes[1], self.axes[0]), slopes, strict=True):
            end = self.distance * (normal[2] * slope - unit[2]) - self.offset[axis]
            excess = abs(end) - (self.trace(slope, unit) + self.width[axis]) / 2
            kept = kept * roll_off(excess, self.guard, guard)
        return kept


def _constant(value):
    """Return an array as NumPy's float64 without its gradient; a tuple as a tuple of them."""
    if isinstance(value, tuple):
        return tuple(_constant(v) for v in value)
    try:
        return np.asarray(_validate.numbers(value)).reshape(value.shape)
    except RuntimeError as error:
        raise ValueError("the lengths decide what is computed: they must not be vmapped over") from error


def roll_off(excess, width, guard: float):
    """Return 1 for rays that end inside (excess < 0), 0 from `width` on, and a normal distribution's tail between.

    Its deviation, width/(guard·√(2π)), balances the tail that is cut against the light that the slope scatters back.
    Page's logistic form (Appl. Stat. 26, 75, 1977) needs no error function.
    """
    xp = _array.namespace(excess)
    if guard == 0:
        return xp.astype(excess < 0, xp.float64)
    deviations = guard * math.sqrt(math.pi / 2) * (2 * excess / width - 1)
    # Beyond ten deviations it is 0 or 1 to any precision.
    deviations = xp.clip(deviations, -10.0, 10.0)
    return 1 / (1 + xp.exp(1.5976 * deviations * (1 + 0.04417 * deviations**2)))
