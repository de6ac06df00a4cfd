"""Propagation to a window with arbitrary pitch, size and position.

The required plane waves follow from rays: those that lead from the field to the window. Diffraction requires a
margin around the rays, the guard, within which the plane waves fade out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft

from odak import _array, _validate
from odak._array import Amount, Array, Numbers, phasor_of_cycles
from odak._warnings import SamplingWarning, warn
from odak.wave.fields import budgets, note_loss
from odak.wave.fourier import Line, from_line, to_line
from odak.wave.transfer_functions import Grid, Request, check_geometry, normal_tail, pitches, plane_wave_transfer

GUARD = 4.0
MAXIMUM_FREQUENCIES = 1 << 28
UNTILTED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Window:
    """Samples at which a result is computed.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns.
    dx : float, pair, array or None
        Pitch in metres, in the forms of a field's pitch; None for the field's own pitch.
    offset : tuple
        Place (y, x) of sample n // 2 in the window's own plane, in metres.
    guard : float
        Margin for diffraction around the rays, in Fresnel lengths.
    axes : tuple
        Unit vectors (x, y, z) along the window's columns, its rows and its normal; floats or arrays ``[..., 1, 1]``.
    """

    shape: tuple[int, int]
    dx: Any
    offset: tuple[Any, Any]
    guard: float
    axes: tuple[Any, ...] = UNTILTED

    def is_plain(self) -> bool:
        """Return whether the window is known as numbers, so that it can name a stored kernel."""
        return all(isinstance(value, (int, float, type(None))) for value in (*pitches(self.dx), *self.offset))

    def pitch(self, grid: Grid) -> tuple[Any, ...]:
        """Return the pitch along rows and columns, by default the pitch of the grid's field."""
        return grid.pitch if self.dx is None else tuple(column(value, grid) for value in pitches(self.dx))


def make_window(field: Array, window_shape: Any, window_dx: Any, dx: Any, offset: Any, guard: float) -> Window:
    """Return the window after checking it; its shape and pitch are the field's unless given."""
    shape = tuple(field.shape[-2:]) if window_shape is None else _validate.size("window_shape", window_shape)
    if window_dx is not None:
        both = pitches(window_dx, "window_dx")
        for value in both:
            _validate.real("window_dx", value, positive=True)
        plain = all(isinstance(value, (int, float)) for value in (*both, *pitches(dx)))
        window_dx = None if plain and both == pitches(dx) else tuple(both) if isinstance(window_dx, list) else window_dx
    offset = _validate.several("offset", offset, 2)
    _validate.real("guard", guard)
    if not isinstance(guard, (int, float)) or guard < 0:
        raise ValueError(f"guard must be a number of at least 0, got {guard!r}")
    return Window(shape, window_dx, offset, float(guard))


def column(value: float | np.ndarray, grid: Grid) -> Array:
    """Return a length as float64 shaped ``[..., 1, 1]``, in the grid's library."""
    value = _array.cast(value, grid.wavelength)
    return grid.xp.reshape(value, (*value.shape, 1, 1))


def to_window(spectrum: Array, lines: tuple[Line, Line], window: Window, grid: Grid) -> Array:
    """Return the field on the window that has this spectrum."""
    ratios = [None if window.dx is None else a / b for a, b in zip(window.pitch(grid), grid.pitch, strict=True)]
    # The axis that becomes shortest first.
    axes = sorted(zip(lines, ratios, window.shape, strict=True), key=lambda axis: axis[2] / axis[0].count)
    for line, ratio, count in axes:
        spectrum = from_line(spectrum, line, ratio, count)
    return spectrum


def carry_to_offset(kernel: Array, window: Window, grid: Grid, fy: Array, fx: Array) -> Array:
    """Return a transfer function times the phase that places the window's centre at its offset."""
    for frequency, offset in zip((fy, fx), window.offset, strict=True):
        if _array.is_array(offset) or offset != 0:
            kernel = kernel * phasor_of_cycles(frequency * column(offset, grid), grid.dtype)
    return kernel


# Where the band of a field is looked at, in units of its highest frequency.
_BAND = np.linspace(-1, 1, 33)
_FRACTIONS = np.linspace(-0.5, 0.5, 7)


@dataclass(frozen=True)
class Rays:
    """The rays from a field to a window, float64 ``[..., 1, 1]``.

    Attributes
    ----------
    pitch : tuple of array
        Pixel pitch of the field along rows and columns, in metres.
    wavelength : array
        Wavelength in metres.
    distance : array
        Distance in metres.
    source : tuple of array
        Extent of the field along rows and columns.
    width : tuple of array
        Extent of the window along its rows and columns.
    offset : tuple of array
        Place of the window's centre along its rows and columns.
    guard : array
        Margin around the rays in metres, the window's guard times a Fresnel length.
    axes : tuple
        Unit vectors (x, y, z) along the window's columns, its rows and its normal.
    """

    pitch: tuple[Any, ...]
    wavelength: Amount
    distance: Amount
    source: tuple[Any, ...]
    width: tuple[Any, ...]
    offset: tuple[Any, ...]
    guard: Any
    axes: tuple[Any, ...]

    @classmethod
    def between(cls, grid: Grid, window: Window) -> "Rays":
        """Return the rays from the grid's field to the window."""
        xp, wavelength, distance = grid.xp, grid.wavelength, grid.distance
        offset = tuple(column(value, grid) for value in window.offset)
        axes = tuple(tuple(_array.cast(value, wavelength) for value in unit) for unit in window.axes)
        # Symmetric extents: an even number of samples has one more before sample n // 2 than after it.
        source = tuple((2 * (n // 2) + 1) * pitch for n, pitch in zip(grid.shape, grid.pitch, strict=True))
        width = tuple((2 * (n // 2) + 1) * pitch for n, pitch in zip(window.shape, window.pitch(grid), strict=True))
        x, y, z = (offset[1] * axes[0][k] + offset[0] * axes[1][k] + distance * float(k == 2) for k in range(3))
        path = xp.sqrt(x**2 + y**2 + z**2 + wavelength**2)
        # On a plane at oblique incidence diffraction spreads further: four times at most.
        across = xp.abs(x * axes[2][0] + y * axes[2][1] + z * axes[2][2])
        guard = window.guard * xp.sqrt(wavelength * path) * path / xp.maximum(across, path / 4)
        return cls(grid.pitch, wavelength, distance, source, width, offset, guard, axes)

    def numbers(self) -> "Rays":
        """Return the rays as NumPy constants, which decide how many frequencies there are."""
        return Rays(*(_constant(value) for value in vars(self).values()))

    def directions(self) -> tuple[np.ndarray, ...]:
        """Return the frequencies (x, y, z) of the rays, in 1/m ``[..., 1, rays]``, as far as the field holds them.

        The lengths must be NumPy constants, as :meth:`numbers` returns them.
        """
        fractions = np.stack(np.meshgrid(*[_FRACTIONS] * 4), 0).reshape(4, 1, -1)
        down, across = (
            o + f * (w + 2 * self.guard) for o, f, w in zip(self.offset, fractions, self.width, strict=False)
        )
        start = (self.source[1] * fractions[3], self.source[0] * fractions[2], -self.distance)
        ray = [across * self.axes[0][k] + down * self.axes[1][k] - start[k] for k in range(3)]
        # A wave reaches points behind the field's plane against its direction.
        length = np.where(ray[2] < 0, -1.0, 1.0) * self.wavelength * np.sqrt(sum(v**2 for v in ray) + 1e-30)
        fx, fy = (
            np.clip(v / length, -1 / (2 * pitch), 1 / (2 * pitch))
            for v, pitch in zip(ray[:2], reversed(self.pitch), strict=True)
        )
        return fx, fy, np.sqrt(np.maximum(1 / self.wavelength**2 - fx**2 - fy**2, 0))

    def waves(self) -> Any:
        """Return the frequencies of :meth:`directions`, and close to the field of waves of all directions."""
        waves = self.directions()
        if not self._is_near().any():
            return waves
        lead = waves[2].shape[:-1]
        return tuple(
            np.concatenate([np.broadcast_to(f, (*lead, f.shape[-1])) for f in both], -1)
            for both in zip(waves, self._band_waves(), strict=True)
        )

    def source_line(self, period: float) -> Line:
        """Return the line of the field's own frequencies along its rows, of at least a period."""
        rays = self.numbers()
        count = scipy.fft.next_fast_len(math.ceil(period))
        return rays._line(-2, rays.directions()[1], (0.0, 1.0, 0.0), count).held()

    def trace(self, slope: Any, unit: Any) -> Any:
        """Return the extent on the window's plane, along `unit`, of a plane wave that leaves the field at a slope."""
        normal = self.axes[2]
        return abs(unit[0] - normal[0] * slope) * self.source[1] + abs(unit[1] - normal[1] * slope) * self.source[0]

    def lines(self) -> tuple[Line, Line]:
        """Return the frequencies in the window's plane, along rows and columns, that serve the whole batch.

        A sum over frequencies is periodic along the window. The period holds the window, the trace of the field and
        the guard, so that no copy falls on the window.
        """
        rays = self.numbers()
        waves = rays.directions()
        along = sum(f * n for f, n in zip(waves, rays.axes[2], strict=True))
        lines = []
        for axis, unit in ((-2, rays.axes[1]), (-1, rays.axes[0])):
            frequency = sum(f * u for f, u in zip(waves, unit, strict=True))
            # The trace of waves along the window's plane has no bound; ten times the field's extent is the limit here.
            trace = rays.trace(frequency / np.maximum(along, 0.1 / rays.wavelength), unit)
            extent = trace.max(-1, keepdims=True) + rays.width[axis] + rays.guard
            period = (extent / rays.pitch[axis]).max()
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
        cycles = frequency * self.pitch[axis]
        # Close to the field waves of all directions contribute.
        low, high = (np.where(self._is_near(), side * self.pitch[axis], cycles) for side in self._band(unit))
        # Rounding must not add an index at either end.
        first, last = math.floor(low.min() * period + 1e-9), math.ceil(high.max() * period - 1e-9)
        return Line(axis, first, last + 1 - first, period)

    def _is_near(self):
        return np.abs(self.distance) < 10 * self.wavelength

    def _band_waves(self):
        """Return frequencies (x, y, z) all over the band of the field, in 1/m."""
        fx, fy = (
            v.reshape(1, -1) / (2 * pitch)
            for v, pitch in zip(np.meshgrid(_BAND, _BAND), reversed(self.pitch), strict=True)
        )
        return fx, fy, np.sqrt(np.maximum(1 / self.wavelength**2 - fx**2 - fy**2, 0))

    def _band(self, unit):
        """Return the lowest and the highest frequency along `unit`, in 1/m, of all waves in the field."""
        frequency = sum(f * u for f, u in zip(self._band_waves(), unit, strict=True))
        return frequency.min(-1, keepdims=True), frequency.max(-1, keepdims=True)

    def weight(self, guard: float, slopes: Any) -> Any:
        """Return the factor of each plane wave: 1 if its rays lead to the window, 0 beyond the guard, smooth between.

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
    told = "the lengths determine the computation: they must not be vmapped over"
    with _validate.refusing(lambda _: told, RuntimeError):
        return np.asarray(_validate.numbers(value)).reshape(value.shape)


def roll_off(excess: Array, width: Array, guard: float) -> Array:
    """Return 1 for rays that end inside (excess < 0), 0 from `width` on, and a normal distribution's tail between.

    Its deviation, width/(guard·√(2π)), balances the tail that is cut against the diffraction at the roll-off itself.
    """
    xp = _array.namespace(excess)
    if guard == 0:
        return xp.astype(excess < 0, xp.float64)
    deviations = guard * math.sqrt(math.pi / 2) * (2 * excess / width - 1)
    return normal_tail(deviations)


@_validate.takes_units("wavelength", "distance", "dx", "window_dx", "offset")
def propagate_to_window(
    field: Array,
    wavelength: float | Array,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    window_shape: Sequence[int] | None = None,
    window_dx: float | Sequence[float] | Array | None = None,
    offset: Numbers = (0.0, 0.0),
    guard: float = GUARD,
) -> Array:
    """Propagate a field to a window with its own pitch, number of samples and place.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]`` (a real one is taken as a field of phase zero).
    wavelength : float or array
        Wavelength in metres; an array broadcasts against the field's leading axes.
    distance : float or array
        Distance in metres, negative to propagate back; an array broadcasts against the field's leading axes.
    dx : float, pair of float or array
        Pixel pitch of the field in metres: one number, a tuple or list (rows, columns), or an array with one pitch for
        each field of the leading axes.
    window_shape : sequence of int, optional
        Rows and columns of the window; by default the shape of the field.
    window_dx : float, pair of float or array, optional
        Pixel pitch of the window in metres, in the same forms; by default the pitch of the field.
    offset : sequence of two floats or arrays
        Place (y, x) of the window's sample ``n // 2`` in metres from the optical axis: y along rows, x along columns.
    guard : float
        Margin for diffraction around the rays, in units of sqrt(λ·path). 0 cuts the band where the rays end, as
        Matsushima does, at an error of some percent. Relative to the largest amplitude, 2 leaves an error of about
        1e-4, 4 one of 1e-7, 6 one of 1e-10 for paraxial fields thousands of wavelengths away. Waves that travel almost
        along the plane spread without bound: for an oblique beam at a distance of 200 wavelengths, 4 leaves errors of
        4e-6, 2e-5, 2e-4 and 3e-4 at numerical apertures of 0.5, 0.7, 0.87 and 0.96; at 40 wavelengths they are 1e-4,
        2e-4, 1e-3 and 5e-3, and a larger guard gains little. All this holds for fields whose spectrum falls off
        towards the edge of the band; see the notes.

    Returns
    -------
    array
        Field ``[..., window rows, window columns]`` in the field's library and precision, differentiable in the field
        and in every length that is a tensor.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it, or if the window takes more than 2**28 frequencies.

    Notes
    -----
    Distances and wavelengths of one batch share the frequencies at which the spectrum is taken. That has no effect on
    a field whose spectrum falls off towards the edge of the band, 1/(2·dx); noise up to the edge is defined no better
    than its wrapped tails, depends on the batch it is in, and differs by 1 % to 10 % from its propagation on a wide
    grid.

    Only frequencies up to 1/(2·dx) are there, which the field's pitch can represent. A window beyond their
    reach is dark, and a SamplingWarning is issued.

    The angular spectrum is taken at the frequencies of rays from the field (width S) to the window (width W), at a
    pitch of 1/(S + W + guard), and summed at the window's samples: no interpolation. Their number along an axis is at
    most (S + W + guard)/dx. Matsushima, Opt. Express 18, 18453 (2010), the shifted band; Muffoletto, Tyler and
    Tohline, Opt. Express 15, 5631 (2007), chirp-z transforms between two pitches.

    Examples
    --------
    >>> import numpy as np
    >>> import odak
    >>> field = np.ones((64, 64), dtype=np.complex128)
    >>> detail = odak.wave.propagate_to_window(field, 532e-9, 0.05, 8e-6, (100, 200), 1e-6, offset=(0.0, 3e-4))
    >>> detail.shape
    (100, 200)
    """
    field = _array.to_complex(_validate.image("field", field))
    check_geometry(None, distance, dx, wavelength, tuple(field.shape[:-2]))
    window = make_window(field, window_shape, window_dx, dx, offset, guard)
    request = Request(dx, wavelength, distance)
    shape, xp, device = tuple(field.shape[-2:]), _array.namespace(field), _array.device_of(field)
    grid = request.grid(shape, xp, device, field.dtype)
    down, across = Rays.between(grid, window).lines()
    lines = (down.held(), across.held())
    if 1 in (line.count for line in lines):
        warn(f"the window is out of reach of a field of pitch {dx} m, which is dark there", SamplingWarning)
    spectrum = to_line(to_line(field, lines[1]), lines[0])
    build = _Transfer(window)
    kept = window.is_plain()
    kernel = request.transfer_function(build, shape, xp, device, field.dtype) if kept else build(grid)
    result = to_window(spectrum * kernel, lines, window, grid)
    if budgets():
        note_loss("propagate_to_window", field, result, ratio=_areas(window.pitch(grid)) / _areas(grid.pitch))
    return result


def _areas(pitch):
    """Return the area of a sample; the mean where fields have their own."""
    area = pitch[0] * pitch[1]
    return area.mean() if _array.is_array(area) and area.ndim else area


@dataclass(frozen=True)
class _Transfer:
    """The band-limited transfer function of free space to a window; equal windows make equal keys of the store."""

    window: Window

    def __call__(self, grid: Grid):
        """Return the transfer function at the frequencies of the lines."""
        xp = grid.xp
        rays = Rays.between(grid, self.window)
        fy, fx = (line.held().cycles(pitch) / pitch for line, pitch in zip(rays.lines(), grid.pitch, strict=True))
        squared = 1 / grid.wavelength**2 - fy**2 - fx**2
        # An evanescent wave does not propagate sideways.
        axial = xp.sqrt(xp.where(squared > 0, squared, xp.ones_like(squared) * 1e300))
        weight = rays.weight(self.window.guard, (fy / axial, fx / axial))
        kernel = plane_wave_transfer(grid, fy, fx) * xp.astype(weight, grid.dtype)
        return carry_to_offset(kernel, self.window, grid, fy, fx)
