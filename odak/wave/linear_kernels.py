"""Propagation of fields to their own window without wrap-around: transfer functions of linear convolution.

A transfer function sampled on the grid of a field that is padded to twice its size makes a circular convolution: its
impulse response is longer than the grid, and what leaves the grid on one side comes in on the other. At the critical
distance N·dx²/λ this is 2 % of a field of random phase. Here the impulse response is computed at the lags that connect
two points of the window, by the rules of :mod:`odak.wave.quadrature`, and transformed back to the doubled grid. The
propagation itself costs what it did.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Amount, Array, ArrayT
from odak._warnings import SamplingWarning, warn
from odak.wave.quadrature import CLOSED, PATH_NODES, SAFETY, Axis, Rule, plain_rule, rule_for, rules_for
from odak.wave.transfer_functions import (
    Grid,
    alias_free_weight,
    angular_spectrum,
    by_columns,
    in_slabs,
    make_complex,
    rayleigh_sommerfeld_response,
)

TOLERANCE = 1e-4
# Relative error of a field above which a warning is issued.
_DOUBTFUL = 0.05
# Samples computed at a time, of 2 MB in double precision. What larger parts take is given back to the system after each
# part, in a process that has not yet used much memory, and cleared for the next.
_SLAB = 1 << 17
# Widths of diffraction beside the geometric shadow at which a taper ends.
_TAPER = 2.0
# Samples on either side of the rim of a round stop over which it falls from 1 to 0, and the odd part of this fall.
_RIM, _FALL = 2.5, (4725, -14700, 23814, -17820, 5005)


@dataclass(frozen=True)
class LinearGrid(Grid):
    """Grid of twice a window's size, on which a transfer function performs a linear convolution.

    It holds one geometry, where lengths are known as numbers.

    Attributes
    ----------
    cutoff : float, optional
        Radius of a round stop in the Fourier plane in cycles per metre; None for an open one.
    pixel_fill : float, optional
        Share of a square pixel's area that emits; None for fields that are point samples.
    tolerance : float
        Relative error of a propagated field of flat spectrum. A stop is sampled on a fixed grid, without this bound;
        so is everything where it is infinite, and no length is read.
    stored : dtype, optional
        Complex dtype of the result of :meth:`evaluate`; by default the dtype of the grid, in which it is computed.
    halves : tuple of bool
        Along rows and columns: the result is the field half a sample beyond each sample of the window.
    axes : tuple of int
        Axes along which light spreads; along another one, of one sample, it is the same everywhere.
    judged : bool, optional
        True if the caller predicts the error for its own field: no warning is issued here.
    named : tuple of int, optional
        Rows and columns of the field that a warning names, where the window is wider.
    """

    cutoff: Any = None
    pixel_fill: Any = None
    tolerance: float = TOLERANCE
    stored: Any = None
    halves: tuple[bool, bool] = (False, False)
    axes: tuple[Any, ...] = (-2, -1)
    judged: bool = False
    named: tuple[int, int] | None = None

    def evaluate(self, kernel: Any) -> Any:
        """Return the transfer function whose circular convolution on this grid is the linear one on the window."""
        xp, rules = self.xp, self._rules()
        frequencies = tuple(self._indices(rule.count, k) / (rule.count * self.pitch[k]) for k, rule in enumerate(rules))
        fading = any(rule.tapered for rule in rules)
        # The last lines to be made lie in memory as they are used.
        first, last = (1, 0) if by_columns(self.distance) else (0, 1)
        lines = xp.matrix_transpose(frequencies[last]) if last == 1 else frequencies[last]
        along = xp.matrix_transpose(frequencies[first]) if first == 0 else frequencies[first]
        weights = [self._weights(rule) for rule in rules]

        def spectrum(part):
            pair = (along, lines[..., part, :]) if first == 0 else (lines[..., part, :], along)
            values = kernel(*pair)
            if fading:
                # An axis whose rule serves the whole band fades nothing: a grid that long holds all its waves.
                held = tuple(rule.count if rule.tapered else 1 << 40 for rule in rules)
                values = values * xp.astype(alias_free_weight(self, held, *pair), values.dtype)
            if self.cutoff is not None:
                values = values * xp.astype(self._within_the_stop(pair, rules), values.dtype)
            if self.pixel_fill is not None:
                for frequency, pitch in zip(pair, self.pitch, strict=True):
                    values = values * xp.astype(_pixel_spectrum(frequency * pitch, self.pixel_fill), values.dtype)
            return self._linear(values * weights[first], first, rules)

        def transfer(columns):
            return self._linear(columns * weights[last], last, rules)

        steps = [max(1, _SLAB // rule.count) for rule in rules]
        return self._in_two_passes(spectrum, lines.shape[-2], transfer, steps, first)

    def _within_the_stop(self, pair, rules):
        """Return what a round stop passes of frequencies, by a smooth rim.

        The sum over the frequencies is that of the disc: the fall is the integral of (1 − t²)² times a polynomial, with
        second and fourth moments of zero. A rim of zeros and ones is as wrong as a larger or smaller stop, and its
        light comes back from beyond the grid: 1 % of an image, where this is 1e-4.
        """
        xp, tiny = self.xp, 1e-9 / self.pitch[0]
        radius = xp.sqrt(pair[0] ** 2 + pair[1] ** 2 + tiny**2)
        # The distance of the samples in the direction of the radius, and a rim that leaves the middle as it is.
        steps = [f / (rule.count * p) for f, rule, p in zip(pair, rules, self.pitch, strict=True)]
        width = _RIM * xp.sqrt(steps[0] ** 2 + steps[1] ** 2) / radius + tiny
        t = xp.clip((self.cutoff - radius) / xp.clip(width, 0.0, self.cutoff), -1.0, 1.0)
        return 0.5 + t / 2048 * functools.reduce(lambda total, part: total * t**2 + part, _FALL[::-1])

    def _in_two_passes(self, spectra, count: int, transform, steps, first: int):
        """Return the transfer function: ``spectra(slice)`` along one axis, and their ``transform(columns)``."""
        xp, last = self.xp, 1 - first

        def transfer(part):
            found = transform(xp.matrix_transpose(half[..., part]))
            found = xp.astype(found, self.dtype if self.stored is None else self.stored, copy=False)
            return found if self.halves[last] else xp.take(found, self._mirror(self.shape[last]), axis=-1)

        half = in_slabs(spectra, count, steps[first])
        found = in_slabs(transfer, half.shape[-1], steps[last], self.shape[first])
        return xp.matrix_transpose(found) if first == 1 else found

    def _linear(self, half, axis: int, rules):
        """Return lines of spectra on the samples of the grid, of the lags within the window, from halves of spectra."""
        lags = _response(half, rules[axis].count, self.shape[axis] // 2, self.halves[axis])
        return self._spectrum(lags, axis)

    def _spectrum(self, lags, axis: int):
        return _spectrum(lags, self.shape[axis] // 2, self.halves[axis])

    def is_far(self) -> bool:
        """Return whether :meth:`evaluate_far` holds."""
        if self.cutoff is not None or self.pixel_fill is not None or math.isinf(self.tolerance) or len(self.axes) < 2:
            return False
        numbers = self._numbers()
        if numbers is None:
            return False
        return rules_for(axes_of([n // 2 for n in self.shape], *numbers), self.tolerance)[0] == CLOSED

    def evaluate_far(self) -> Array:
        """Return what :meth:`evaluate` does of free space, where waves at the end of the band land outside the window.

        The response of the band is the Rayleigh–Sommerfeld kernel, of all waves, less the waves beyond the band along
        either axis, plus those beyond both, which have been subtracted twice. From the end of the band the path of an
        integral is turned straight down in the complex plane, where the integrand decays without an oscillation: f − iτ
        at a few of Gauss and Laguerre's nodes. Along the other axis, over all waves, it is a Hankel function.
        """
        xp, first = self.xp, 1 if by_columns(self.distance) else 0
        down, across = (
            (self._indices(n - 2, axis) + self.halves[axis] / 2) * self.pitch[axis] for axis, n in enumerate(self.shape)
        )
        (fy, ends_down), (fx, ends_across) = self._beyond_the_band(0, down), self._beyond_the_band(1, across)
        both = _phasor(xp.abs(self.distance) * xp.sqrt(1 / self.wavelength**2 - fy**2 - fx**2))
        left = xp.concat([ends_down, -self._all_waves(fx, down) * self.pitch[0]], axis=-1)
        right = [both @ ends_across - self._all_waves(fy, across) * self.pitch[1], ends_across]
        right = xp.concat(right, axis=-2)
        weights = [xp.where(lags == 0, xp.ones_like(lags) / 2, xp.ones_like(lags)) for lags in (down, across)]

        def spectra(part):
            rows, columns = (part, slice(None)) if first == 1 else (slice(None), part)
            squared = down[..., rows, :] ** 2 + across[..., columns] ** 2
            lags = rayleigh_sommerfeld_response(self.distance, squared, self.wavelength) * self.pixel_area
            beyond = left[..., rows, :] @ right[..., columns]
            lags = (lags + xp.where(self.distance < 0, xp.conj(beyond), beyond)) * weights[first]
            return self._spectrum(lags if first == 1 else xp.matrix_transpose(lags), first)

        def transfer(columns):
            return self._spectrum(columns * xp.reshape(weights[1 - first], (1, -1)), 1 - first)

        sizes = [max(1, _SLAB // n) for n in self.shape]
        return self._in_two_passes(spectra, self.shape[1 - first] // 2, transfer, sizes, first)

    def _beyond_the_band(self, axis: int, lags):
        """Return frequencies on the turned path, and the waves beyond both ends of the band at the lags."""
        xp, pitch, band = self.xp, self.pitch[axis], 0.5 / self.pitch[axis]
        nodes, weights = np.polynomial.laguerre.laggauss(PATH_NODES)
        nodes, weights = (
            xp.reshape(xp.asarray(values, dtype=xp.float64, device=self.device), (1, -1) if axis == 0 else (-1, 1))
            for values in (nodes, weights * np.exp(nodes))
        )
        # At the lag 0 the wave decays at this rate along the path.
        rate = 2 * xp.pi * xp.abs(self.distance) * band / xp.sqrt(1 / self.wavelength**2 - band**2)
        path = make_complex(band + 0 * nodes, -nodes / rate)
        return xp.matrix_transpose(path), -2j * xp.cos(2 * xp.pi * path * lags) * (weights / rate * pitch)

    def _all_waves(self, frequency, lags):
        """Return the response along a line, iπq·z/ρ·H₁(2πqρ), for a frequency across, by the expansion for large qρ.

        q² = 1/λ² − f² and ρ² = x² + z²; H₁ is the Hankel function of the first kind (Abramowitz and Stegun, 9.2.7).
        """
        xp, z = self.xp, self.xp.abs(self.distance)
        axial, rho = xp.sqrt(1 / self.wavelength**2 - frequency**2), xp.sqrt(lags**2 + z**2)
        argument = 2 * xp.pi * axial * rho
        term = 1j / argument
        series = 1 + term * (3 / 8 + term * (-15 / 128 + term * (315 / 3072 - term * (14175 / 98304))))
        hankel = xp.sqrt(2 / (xp.pi * argument)) * _phasor(axial * rho - 0.375) * series
        return 1j * xp.pi * axial * z / rho * hankel

    def _rules(self) -> tuple[Rule, Rule]:
        """Return the rules along rows and columns."""
        sizes = [n // 2 for n in self.shape]
        if math.isinf(self.tolerance):
            return plain_rule(sizes[0]), plain_rule(sizes[1])
        numbers = None if self.cutoff is not None else self._numbers()
        if numbers is None:
            rows, columns = (
                plain_rule(n) if axis in self.axes else Rule(1) for n, axis in zip(sizes, (-2, -1), strict=True)
            )
            return rows, columns
        pitches, wavelength, distance = numbers
        if distance == 0 and (self.pixel_fill is not None or True in self.halves):
            # What lies between samples, or of pixels of some width, is no plain sum even there.
            distance = wavelength / 1000
        axes = axes_of(sizes, pitches, wavelength, distance)
        if len(self.axes) == 1:
            # Of the other axis there is the frequency zero alone.
            rule = rule_for(replace(axes[self.axes[0]], transverse=0.0), self.tolerance)
            return (rule, Rule(1)) if self.axes == (-2,) else (Rule(1), rule)
        found = rule_for(axes[0], self.tolerance), rule_for(axes[1], self.tolerance)
        error = SAFETY * math.hypot(*(rule.error for rule in found))
        if error > _DOUBTFUL and not self.judged:
            rows, columns = self.named or sizes
            warn(
                f"the light of {rows} × {columns} samples, {max(pitches):.3g} m apart, at a distance of "
                f"{abs(distance):.3g} m is known to about {100 * min(error, 1):.0f} % only: give a shorter distance, "
                "the focal plane of a lens, or the propagation type 'auto' or 'Rayleigh-Sommerfeld' where there is one",
                SamplingWarning,
            )
        return found

    def _numbers(self):
        """Return the pair of pitches, the wavelength and the distance as numbers, None where they are not known."""
        lengths = (*self.pitch, self.wavelength, self.distance)
        known = [_array.numbers_behind(value) for value in lengths]
        if None in known:
            return None
        dy, dx, wavelength, distance = (values[0] for values in known)
        return (dy, dx), wavelength, distance

    def _weights(self, rule: Rule):
        """Return a rule's weights as a line, the first and the last one half, for :func:`_response`.

        For negative distances, at which all phases change sign, they are conjugate.
        """
        xp, weights = self.xp, rule.weights()
        weights[0] /= 2
        if rule.count > 1:
            weights[-1] /= 2
        weights = xp.asarray(weights[None, :], dtype=xp.complex128, device=self.device)
        return xp.where(self.distance < 0, xp.conj(weights), weights) if rule.corrections else weights


def _phasor(cycles):
    """Return exp(i2π·cycles) of complex numbers of cycles."""
    xp = _array.namespace(cycles)
    return _array.phasor_of_cycles(xp.real(cycles)) * xp.exp(-2 * xp.pi * xp.imag(cycles))


def axes_of(sizes: Sequence[int], pitches: tuple[float, ...], wavelength: float, distance: float) -> tuple[Axis, Axis]:
    """Return the axes along rows and columns of a propagation."""
    (rows, columns), (dy, dx) = sizes, pitches
    z = abs(distance)
    return Axis(rows, dy, wavelength, z, 0.5 / dx), Axis(columns, dx, wavelength, z, 0.5 / dy)


def _pixel_spectrum(cycles, pixel_fill: float):
    """Return sin(πx)/(πx), x = √fill·cycles per pixel: the spectrum along one axis of a square pixel, 1 at zero."""
    xp, cycles = _array.namespace(cycles), cycles * math.sqrt(pixel_fill)
    angle = xp.pi * xp.where(cycles == 0, xp.ones_like(cycles), cycles)
    return xp.where(cycles == 0, xp.ones_like(cycles), xp.sin(angle) / angle)


def pixel_aperture(field: Array, pixel_fill: float) -> Any:
    """Return the spectrum of a field's square pixels, centred, on the grid of twice the field's size.

    Parameters
    ----------
    field : array
        Field ``[..., rows, columns]``, whose size, precision and device the result takes.
    pixel_fill : float
        Share of a pixel's area that emits.

    Returns
    -------
    array
        Real ``[2·rows, 2·columns]``, between 0.4 and 1.
    """
    xp, dtype = _array.namespace(field), _array.real_dtype(field)
    down, across = (
        _pixel_spectrum((xp.arange(2 * n, dtype=dtype, device=_array.device_of(field)) - n) / (2 * n), pixel_fill)
        for n in field.shape[-2:]
    )
    return down[:, None] * across[None, :]


def orders_reaching(
    farthest: float, distance: float, pitch: float, wavelength: float, most: float
) -> tuple[float, float]:
    """Return how many diffraction orders along an axis send light up to some length aside, and where a taper ends.

    Light of frequency f, in cycles per metre, is deflected by the sine λ·f, and an order is as wide as 1/pitch.
    Diffraction blurs this by some widths √(λ·distance), over which a spectrum may fall to 0: its light lies elsewhere.

    Parameters
    ----------
    farthest : float
        Largest distance aside between a pixel and a place that is looked at, in metres.
    distance : float
        Distance of the plane in metres.
    pitch : float
        Distance of the pixels in metres.
    wavelength : float
        Wavelength in metres.
    most : float
        The largest number that is returned.
    """
    blur = math.sqrt(wavelength * abs(distance))
    start, end = (
        2 * pitch / wavelength * aside / math.hypot(aside, distance)
        for aside in (farthest + blur, farthest + _TAPER * blur)
    )
    return min(start, most), min(end, most)


def taper(orders: Any, band: tuple[float, float]) -> Any:
    """Return 1 below the first of two numbers of orders and 0 above the second, with half a cosine between them."""
    xp, (start, end) = _array.namespace(orders), band
    if end <= start:
        return xp.astype(orders <= end, orders.dtype)
    return 0.5 + 0.5 * xp.cos(xp.pi * xp.clip((orders - start) / (end - start), 0, 1))


def pixels_spectrum(
    field: ArrayT,
    sizes: Sequence[int],
    orders: int = 1,
    fill: Amount = 1.0,
    cells: int = 1,
    counts: Sequence[int] | None = None,
) -> ArrayT:
    """Return the spectrum of a field of square pixels with its diffraction orders, the first pixel at the origin.

    By the convolution theorem it is the spectrum of the samples, which repeats in each order, times the spectrum of a
    square. This is exact for any number of orders and takes no more samples of the field (Goodman, Introduction to
    Fourier Optics, section 4.4).

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]`` of the inner squares that emit, or ``[..., cells·rows, cells·columns]``
        of cells × cells equal parts of each.
    sizes : sequence of int
        Rows and columns of the grid in pixels, to which the field is continued by zeros.
    orders : int
        Number of orders along each axis.
    fill : float or array
        Share of the area of a pixel that emits; the field is 0 beside it.
    cells : int
        Number of parts along each side of a pixel.
    counts : sequence of int, optional
        Rows and columns of the spectrum, the lowest frequencies, instead of whole orders.

    Returns
    -------
    array
        ``[..., orders·sizes[0], orders·sizes[1]]`` or ``[..., *counts]`` in the order of the transform, in the unit of
        the samples' spectrum.
    """
    xp, dtype, device = _array.namespace(field), _array.real_dtype(field), _array.device_of(field)
    width = fill**0.5
    for axis in (-1, -2):
        size, count = sizes[axis], orders * sizes[axis] if counts is None else counts[axis]
        cycles = width / cells * xp.fft.fftfreq(count, d=size / count, dtype=dtype, device=device)
        envelope, parts = _pixel_spectrum(cycles, 1.0) * (width / cells), []
        for k in range(cells):
            part = xp.fft.fft(field[..., k::cells] if axis == -1 else field[..., k::cells, :], n=sizes[axis], axis=axis)
            # The middle of part k lies k - (cells - 1)/2 parts beside the middle of the pixel.
            wave = envelope * _array.phasor_of_cycles(cycles * ((cells - 1) / 2 - k))
            part = _repeated(part, count, axis)
            parts.append(part * (wave if axis == -1 else wave[:, None]))
        field = sum(parts[1:], start=parts[0])
    return field


def _repeated(spectrum, count: int, axis: int):
    """Return `count` frequencies along an axis, the last or the last but one, of a spectrum that repeats."""
    size = spectrum.shape[axis]
    if count == size:
        return spectrum
    xp = _array.namespace(spectrum)
    (full, rising), (whole, falling) = divmod(count - count // 2, size), divmod(count // 2, size)
    first, last = slice(None, rising), slice(size - falling, None)
    first, last = (spectrum[..., part] if axis == -1 else spectrum[..., part, :] for part in (first, last))
    return xp.concat([spectrum] * full + [first, last] + [spectrum] * whole, axis=axis)


def checked_pixel_fill(pixel_fill: float, name: str = "pixel_fill") -> float:
    """Return the share of a pixel's area that emits, above 0 and at most 1."""
    fill = _validate.constant(name, pixel_fill, positive=True, most=1)
    return fill


def _response(half, count: int, lags: int, between: bool):
    """Return the first lags of the inverse transform of an even spectrum of `count` samples, given by its half.

    The first and the last sample of the half count half, since each stands for itself alone, and so does the result
    at lag 0. With `between` the lags are ½, 1½, … instead of 0, 1, …, and none counts half.
    """
    xp = _array.namespace(half)
    if between:
        indices = xp.arange(half.shape[-1], dtype=xp.float64, device=_array.device_of(half))
        half = half * _array.phasor_of_cycles(indices / (2 * count))
    sums = xp.fft.ifft(half, n=count)
    # What negative frequencies add is the same sum at the negative lags.
    if between:
        return sums[..., :lags] + xp.flip(sums[..., count - lags :], axis=-1)
    after = xp.flip(sums[..., count - lags + 1 :], axis=-1)
    return sums[..., :lags] + xp.concat([xp.zeros_like(sums[..., :1]), after], axis=-1)


def _spectrum(lags, count: int, between: bool):
    """Return the non-negative half of the transform of an even response of lags below `count`, on 2·count samples.

    The first lag counts half. With `between`, of lags ½, 1½, …, the transform is not even, and is returned as a whole.
    """
    xp = _array.namespace(lags)
    if between:
        after = xp.flip(lags[..., : count - 1], axis=-1)
        return xp.fft.fft(xp.concat([lags, xp.zeros_like(lags[..., :1]), after], axis=-1))
    sums = xp.fft.fft(lags, n=2 * count)
    return sums[..., : count + 1] + xp.concat([sums[..., :1], xp.flip(sums[..., count:], axis=-1)], axis=-1)


@dataclass(frozen=True)
class linear_kernel:
    """Function of a grid that gives a transfer function of linear convolution.

    Methods that sample their impulse response are linear convolutions already; to them neither stop nor pixel applies.
    Functions of equal attributes are equal, so that stored kernels are found by them.

    Attributes
    ----------
    transfer : callable
        ``transfer(grid)`` returns the transfer function.
    cutoff : float, optional
        Radius of a round stop in the Fourier plane in cycles per metre; open by default.
    pixel_fill : float, optional
        Share of a square pixel's area that emits: the spectrum is multiplied by the pixel's spectrum, which is 1 at
        zero frequency. Fields are point samples by default.
    tolerance : float
        Relative error of a propagated field of flat spectrum.
    halves : tuple of bool
        Along rows and columns: the field half a sample beyond each sample of the window.
    axes : tuple of int
        Axes along which light spreads: both, or one of fields of a single row or column.
    judged : bool, optional
        True if the caller predicts the error for its own field, so that none is predicted here.
    named : tuple of int, optional
        Rows and columns of the field that a warning names, where the window is wider.
    """

    transfer: Callable[..., Any]
    cutoff: float | None = None
    pixel_fill: float | None = None
    tolerance: float = TOLERANCE
    halves: tuple[bool, bool] = (False, False)
    axes: tuple[Any, ...] = (-2, -1)
    judged: bool = field(default=False, compare=False)
    named: tuple[int, int] | None = field(default=None, compare=False)

    def __call__(self, grid: Grid) -> Any:
        """Return the transfer function on a padded grid; each geometry of a batch has a rule of its own."""
        xp = grid.xp
        # Sums over thousands of frequencies, with weights that cancel: in double precision.
        double = replace(grid, dtype=xp.complex128)
        lengths = (*grid.pitch, grid.wavelength, grid.distance)
        batch = np.broadcast_shapes(*(tuple(value.shape[:-2]) for value in lengths))
        if (
            math.prod(batch) == 1
            or math.isinf(self.tolerance)
            or None in [_array.numbers_behind(value) for value in lengths]
        ):
            return xp.astype(self._build(double, grid.dtype), grid.dtype, copy=False)
        flat = [xp.reshape(xp.broadcast_to(value, (*batch, 1, 1)), (-1, 1, 1)) for value in lengths]
        kernels = []
        for k in range(math.prod(batch)):
            dy, dx, wavelength, distance = (value[k, ...] for value in flat)
            one = replace(double, pitch=(dy, dx), wavelength=wavelength, distance=distance)
            kernels.append(xp.astype(self._build(one, grid.dtype), grid.dtype, copy=False))
        return xp.reshape(xp.stack(kernels), (*batch, *grid.shape))

    def _build(self, grid: Grid, stored):
        own: dict[str, Any] = {field.name: getattr(grid, field.name) for field in fields(Grid)}
        own |= {"cutoff": self.cutoff, "pixel_fill": self.pixel_fill, "tolerance": self.tolerance, "stored": stored}
        own |= {"halves": self.halves, "axes": self.axes, "judged": self.judged, "named": self.named}
        linear = LinearGrid(**own)
        if self.transfer is angular_spectrum and linear.is_far():
            return linear.evaluate_far()
        return self.transfer(linear)
