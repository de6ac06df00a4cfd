"""Propagation of fields to their own window without wrap-around: transfer functions of linear convolution.

A transfer function sampled on the grid of a field that is padded to twice its size makes a circular convolution: its
impulse response is longer than the grid, and what leaves the grid on one side comes in on the other. At the critical
distance N·dx²/λ this is 2 % of a field of random phase. Here the impulse response is computed at the lags that connect
two points of the window, by the rules of :mod:`odak.wave.quadrature`, and transformed back to the doubled grid. The
propagation itself costs what it did.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._warnings import SamplingWarning, warn
from odak.wave.quadrature import SAFETY, Axis, Rule, plain_rule, rule_for
from odak.wave.transfer_functions import Grid, alias_free_weight

TOLERANCE = 1e-4
# Relative error of a field above which a warning is issued.
_DOUBTFUL = 0.05
# Samples computed at a time, of 4 MB in double precision: larger parts take more memory and no less time.
_SLAB = 1 << 18
# Widths of diffraction beside the geometric shadow at which a taper ends.
_TAPER = 2.0


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
    """

    cutoff: Any = None
    pixel_fill: Any = None
    tolerance: float = TOLERANCE
    stored: Any = None
    halves: tuple[bool, bool] = (False, False)
    axes: tuple = (-2, -1)

    def evaluate(self, kernel):
        """Return the transfer function whose circular convolution on this grid is the linear one on the window."""
        xp = self.xp
        rows, columns = (n // 2 for n in self.shape)
        rules = self._rules()
        counts = (rules[0].count, rules[1].count)
        fy, fx = (self._indices(n, axis) / (n * self.pitch[axis]) for axis, n in enumerate(counts))
        weight_y, weight_x = (self._weights(rule, axis) for axis, rule in enumerate(rules))
        fading = any(rule.tapered for rule in rules)
        step = max(1, _SLAB // fx.shape[-1])

        def first_sum(start):
            stop = min(start + step, fy.shape[-2])
            part = fy[..., start:stop, :]
            spectrum = kernel(part, fx)
            if fading:
                # An axis whose rule serves the whole band fades nothing: a grid that long holds all its waves.
                held = tuple(rule.count if rule.tapered else 1 << 40 for rule in rules)
                spectrum = spectrum * xp.astype(alias_free_weight(self, held, part, fx), spectrum.dtype)
            if self.cutoff is not None:
                kept = part**2 + fx**2 <= self.cutoff**2
                spectrum = xp.where(kept, spectrum, xp.zeros_like(spectrum))
            if self.pixel_fill is not None:
                for frequency, pitch in ((part, self.pitch[0]), (fx, self.pitch[1])):
                    spectrum = spectrum * xp.astype(_pixel_spectrum(frequency * pitch, self.pixel_fill), spectrum.dtype)
            lags = _response(spectrum * weight_x, counts[1], -1, columns, self.halves[1])
            # The weights of the sum to follow are applied here: their product is of these lags alone.
            return lags * weight_y[..., start:stop, :]

        lines = _joined([first_sum(start) for start in range(0, fy.shape[-2], step)], -2)
        lines = _in_slabs(lambda part: _response(part, counts[0], -2, rows, self.halves[0]), lines, -1)
        lines = _in_slabs(lambda part: _spectrum(part, columns, -1, self.halves[1]), lines, -2)
        stored = self.dtype if self.stored is None else self.stored
        return self.unfold(
            _in_slabs(lambda part: xp.astype(_spectrum(part, rows, -2, self.halves[0]), stored, copy=False), lines, -1)
        )

    def _indices_of(self, axis: int):
        n = self.shape[axis]
        return self.xp.arange(n, device=self.device) if self.halves[axis] else self._mirror(n)

    def _rules(self) -> tuple[Rule, Rule]:
        """Return the rules along rows and columns."""
        sizes = [n // 2 for n in self.shape]
        if math.isinf(self.tolerance):
            return plain_rule(sizes[0]), plain_rule(sizes[1])
        lengths = (*self.pitch, self.wavelength, self.distance)
        known = [_array.numbers_behind(value) for value in lengths]
        numbers = [values[0] for values in known if values is not None]
        if self.cutoff is not None or len(numbers) < len(known):
            rows, columns = (
                plain_rule(n) if axis in self.axes else Rule(1) for n, axis in zip(sizes, (-2, -1), strict=True)
            )
            return rows, columns
        dy, dx, wavelength, distance = numbers
        axes = axes_of(sizes, (dy, dx), wavelength, distance)
        if len(self.axes) == 1:
            # Of the other axis there is the frequency zero alone.
            rule = rule_for(replace(axes[self.axes[0]], transverse=0.0), self.tolerance)
            return (rule, Rule(1)) if self.axes == (-2,) else (Rule(1), rule)
        found = rule_for(axes[0], self.tolerance), rule_for(axes[1], self.tolerance)
        error = SAFETY * math.hypot(*(rule.error for rule in found))
        if error > _DOUBTFUL:
            warn(
                f"the light of {sizes[0]} × {sizes[1]} samples, {max(dy, dx):.3g} m apart, at a distance of "
                f"{abs(distance):.3g} m is known to about {100 * min(error, 1):.0f} % only: give a shorter distance, "
                "the focal plane of a lens, or the propagation type 'auto' or 'Rayleigh-Sommerfeld' where there is one",
                SamplingWarning,
            )
        return found

    def _weights(self, rule: Rule, axis: int):
        """Return a rule's weights along an axis; for negative distances, at which all phases change sign, conjugate."""
        xp = self.xp
        weights = xp.asarray(rule.weights(), dtype=xp.complex128, device=self.device)
        weights = xp.reshape(weights, (-1, 1) if axis == 0 else (1, -1))
        if rule.corrections:
            weights = xp.where(self.distance < 0, xp.conj(weights), weights)
        return xp.astype(weights, self.dtype)


def axes_of(sizes, pitches, wavelength: float, distance: float) -> tuple[Axis, Axis]:
    """Return the axes along rows and columns of a propagation."""
    (rows, columns), (dy, dx) = sizes, pitches
    z = abs(distance)
    return Axis(rows, dy, wavelength, z, 0.5 / dx), Axis(columns, dx, wavelength, z, 0.5 / dy)


def _pixel_spectrum(cycles, pixel_fill: float):
    """Return sin(πx)/(πx), x = √fill·cycles per pixel: the spectrum along one axis of a square pixel, 1 at zero."""
    xp, cycles = _array.namespace(cycles), cycles * math.sqrt(pixel_fill)
    angle = xp.pi * xp.where(cycles == 0, xp.ones_like(cycles), cycles)
    return xp.where(cycles == 0, xp.ones_like(cycles), xp.sin(angle) / angle)


def pixel_aperture(field, pixel_fill: float):
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


def taper(orders, band: tuple[float, float]):
    """Return 1 below the first of two numbers of orders and 0 above the second, with half a cosine between them."""
    xp, (start, end) = _array.namespace(orders), band
    if end <= start:
        return xp.astype(orders <= end, orders.dtype)
    return 0.5 + 0.5 * xp.cos(xp.pi * xp.clip((orders - start) / (end - start), 0, 1))


def pixels_spectrum(field, sizes, orders: int = 1, fill=1.0, cells: int = 1, counts=None):
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


def checked_pixel_fill(pixel_fill: float) -> float:
    """Return the share of a pixel's area that emits, above 0 and at most 1."""
    fill = _validate.constant("pixel_fill", pixel_fill, positive=True)
    if fill > 1:
        raise ValueError(f"pixel_fill must be above 0 and at most 1, got {pixel_fill!r}")
    return fill


def _response(half, count: int, axis: int, lags: int, between: bool = False):
    """Return the first lags of the inverse transform of an even spectrum of `count` samples, given by its half.

    The lags are 0, 1, …, or ½, 1½, … with `between`.
    """
    xp = _array.namespace(half)
    indices = xp.arange(count, device=_array.device_of(half))
    whole = xp.take(half, xp.minimum(indices, count - indices), axis=axis)
    if between:
        angles = xp.astype(xp.where(2 * indices > count, indices - count, indices), xp.float64) * (math.pi / count)
        # The highest frequency is one with its negative: their sum is zero half-way between the samples.
        turned = xp.where(2 * indices == count, xp.zeros_like(angles), xp.cos(angles)) + 1j * xp.where(
            2 * indices == count, xp.zeros_like(angles), xp.sin(angles)
        )
        whole = whole * xp.astype(xp.reshape(turned, (-1, 1) if axis == -2 else (1, -1)), whole.dtype)
    return _first(xp.fft.ifft(whole, axis=axis), lags, axis)


def _spectrum(lags, count: int, axis: int, between: bool = False):
    """Return the non-negative half of the transform of an even response of lags below `count`, on 2·count samples.

    With `between`, of lags ½, 1½, …, the transform is not even, and is returned as a whole.
    """
    xp = _array.namespace(lags)
    if between:
        after = xp.flip(_first(lags, count - 1, axis), axis=axis)
        return xp.fft.fft(xp.concat([lags, xp.zeros_like(_first(lags, 1, axis)), after], axis=axis), axis=axis)
    after = _first(xp.flip(lags, axis=axis), count - 1, axis)
    whole = xp.concat([lags, xp.zeros_like(_first(lags, 1, axis)), after], axis=axis)
    return _first(xp.fft.fft(whole, axis=axis), count + 1, axis)


def _in_slabs(function: Callable, array, axis: int):
    """Return ``function(array)``, computed for some lines along the other axis at a time: in less memory."""
    count, length = array.shape[axis], array.shape[-3 - axis]
    step = max(1, _SLAB // length)
    spans = (slice(start, min(start + step, count)) for start in range(0, count, step))
    slabs = (array[..., span] if axis == -1 else array[..., span, :] for span in spans)
    return _joined([function(slab) for slab in slabs], axis)


def _joined(parts: list, axis: int):
    return parts[0] if len(parts) == 1 else _array.namespace(parts[0]).concat(parts, axis=axis)


def _first(array, count: int, axis: int):
    return array[..., :count] if axis == -1 else array[..., :count, :]


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
    """

    transfer: Callable
    cutoff: float | None = None
    pixel_fill: float | None = None
    tolerance: float = TOLERANCE
    halves: tuple[bool, bool] = (False, False)
    axes: tuple = (-2, -1)

    def __call__(self, grid: Grid):
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
        own["halves"] = self.halves
        own["axes"] = self.axes
        return self.transfer(LinearGrid(**own))
