"""A box of uniform frequencies between a field and a window: how to get there and how to leave.

The frequencies are those of a discrete Fourier transform, a run of them along each axis. A fast Fourier transform takes
the field there; a chirp-z transform takes the result to the window, whose pitch is free.
"""

from dataclasses import dataclass
from typing import Any

from odak import _array, _validate
from odak._array import phasor_of_cycles
from odak.wave.chirp_z import fourier_sum
from odak.wave.grid import Grid

GUARD = 4.0
MAXIMUM_FREQUENCIES = 1 << 28
UNTILTED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Window:
    """Where a result is wanted.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns.
    dx : float, array or None
        Pitch in metres; None for the field's.
    offset : tuple
        Place (y, x) of sample n // 2 in the window's own plane, in metres.
    guard : float
        Room for diffraction around the rays, in Fresnel lengths.
    axes : tuple
        Unit vectors (x, y, z) along the window's columns, its rows and its normal; floats or arrays ``[..., 1, 1]``.
    """

    shape: tuple[int, int]
    dx: Any
    offset: tuple[Any, Any]
    guard: float
    axes: tuple = UNTILTED

    def is_plain(self) -> bool:
        """Say whether the window is known as numbers, so that it can name a stored kernel."""
        return all(isinstance(value, (int, float, type(None))) for value in (self.dx, *self.offset))


@dataclass(frozen=True)
class Line:
    """A run of `count` frequencies along an axis (-2 or -1), those of a discrete Fourier transform of `period`.

    The indices are `first`, `first` + 1, …; an index over the period is a frequency in cycles per sample of the field.
    """

    axis: int
    first: int
    count: int
    period: int

    def cycles(self, like):
        """Return the frequencies in cycles per sample, along the line's axis and in the library of `like`."""
        return (_indices(like, self.count, self.axis) + self.first) / self.period

    def held(self) -> "Line":
        """Return the part of the line that a sampled field holds, −½ to ½ cycles per sample."""
        first = max(self.first, -(self.period // 2))
        last = min(self.first + self.count, (self.period + 1) // 2)
        return Line(self.axis, first, max(1, last - first), self.period)


def make_window(field, window_shape, window_dx, dx, offset, guard: float, axes=UNTILTED) -> Window:
    """Return the window after checking it; its shape and pitch are the field's unless given."""
    shape = tuple(field.shape[-2:]) if window_shape is None else _validate.size("window_shape", window_shape)
    if window_dx is not None:
        _validate.real("window_dx", window_dx, positive=True)
    plain = isinstance(window_dx, (int, float)) and isinstance(dx, (int, float))
    window_dx = None if plain and window_dx == dx else window_dx
    offset = _validate.several("offset", offset, 2)
    _validate.real("guard", guard)
    if not isinstance(guard, (int, float)) or guard < 0:
        raise ValueError(f"guard must be a number of at least 0, got {guard!r}")
    return Window(shape, window_dx, offset, float(guard), axes)


def centred(like, count: int, axis: int):
    """Return the indices −(count // 2), … along `axis` (-2 or -1), float64 in the library of `like`."""
    return _indices(like, count, axis) - count // 2


def _indices(like, count: int, axis: int):
    xp = _array.namespace(like)
    line = xp.arange(count, dtype=xp.float64, device=_array.device_of(like))
    return xp.reshape(line, (-1, 1) if axis == -2 else (1, -1))


def column(value, grid: Grid):
    """Return a length as float64 shaped ``[..., 1, 1]``, in the grid's library."""
    value = _array.cast(value, grid.dx)
    return grid.xp.reshape(value, (*value.shape, 1, 1))


def to_line(field, line: Line):
    """Return Σ u·exp(−i2πf·x) at the frequencies of `line`, for samples along its axis."""
    xp = _array.namespace(field)
    n = field.shape[line.axis]
    shifted = field * phasor_of_cycles(-line.first / line.period * centred(field, n, line.axis), field.dtype)
    spectrum = xp.fft.fft(shifted, n=line.period, axis=line.axis)
    spectrum = spectrum[..., : line.count] if line.axis == -1 else spectrum[..., : line.count, :]
    # The transform counts samples from the first, we from the one in the middle.
    return spectrum * phasor_of_cycles(n // 2 / line.period * _indices(field, line.count, line.axis), field.dtype)


def from_line(spectrum, line: Line, pitch, count: int):
    """Return Σ U·exp(i2πf·x)/period at `count` samples along the axis of `line`.

    `pitch` is in units of the field's; None stands for the same, which a fast transform serves.
    """
    xp = _array.namespace(spectrum)
    positions = centred(spectrum, count, line.axis)
    if pitch is None and line.count <= line.period:
        back = phasor_of_cycles(-(count // 2) / line.period * _indices(spectrum, line.count, line.axis), spectrum.dtype)
        result = xp.fft.ifft(spectrum * back, n=line.period, axis=line.axis)
        result = result[..., :count] if line.axis == -1 else result[..., :count, :]
        return result * phasor_of_cycles(line.first / line.period * positions, result.dtype)
    pitch = xp.ones((1, 1), dtype=xp.float64, device=_array.device_of(spectrum)) if pitch is None else pitch
    result = fourier_sum(spectrum, pitch / line.period, count, +1, line.axis) / line.period
    # The sum counts frequencies from the one in the middle.
    middle = (line.first + line.count // 2) / line.period
    return result * phasor_of_cycles(middle * pitch * positions, result.dtype)


def to_window(spectrum, lines: tuple[Line, Line], window: Window, grid: Grid):
    """Return the field on the window whose spectrum fills the box."""
    pitch = None if window.dx is None else column(window.dx, grid) / grid.dx
    rows, columns = lines
    return from_line(from_line(spectrum, rows, pitch, window.shape[0]), columns, pitch, window.shape[1])


def carry_to_offset(kernel, window: Window, grid: Grid, fy, fx):
    """Return a transfer function times the phase that places the window's centre at its offset."""
    for frequency, offset in zip((fy, fx), window.offset, strict=True):
        if _array.is_array(offset) or offset != 0:
            kernel = kernel * phasor_of_cycles(frequency * column(offset, grid), grid.dtype)
    return kernel
