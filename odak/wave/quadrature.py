"""Impulse responses of free space for band-limited fields: quadrature rules along one axis, and their errors.

The field between its samples is their band-limited interpolation. Its impulse response at a lag x is an integral of the
transfer function over |f| ≤ B = 1/(2·pitch), which a discrete Fourier transform of `count` frequencies sums. Two errors
follow: frequencies whose phase changes by more than π between neighbours fold back, and the sum ends at ±B, where the
integrand does not vanish. Weights at the last frequencies correct the end to high order; the number of frequencies
follows from the distance and the tolerance.

Errors refer to a field of flat spectrum: for a fixed frequency of the other axis, the response is computed again by a
reference (a far finer rule, or its closed form) and the squares of the differences are summed over the lags.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import astuple, dataclass, field, replace
from typing import Any

import numpy as np
import scipy.fft
import scipy.special

# Weights that are changed at each end.
_TAPS = 10
_SHORTEST = 64
# Largest phase between neighbouring frequencies at the end of the band that the end correction serves.
_LARGEST_TURN = 5.5
# Frequencies per sample and lag that are tried, from cheap to accurate.
_DENSITIES = (1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
# Of the reference: its weights fit 1/(iω) to 1.2e-8.
_REFERENCE_TURN, _REFERENCE_TAPS = 1.0, 32
_LONGEST_REFERENCE = 1 << 18
_MOST_NODES = 600
# With fewer frequencies of the reference between the end of the band and waves along the plane, no rule serves: the
# phase is not straight over its weights.
_GRAZING = 200
# Nodes of integrals beyond the band, and the largest curvature of the phase along them, relative to its decay: they are
# exact to 1e-9 then.
_TURNED_NODES, _STRAIGHT = 8, 3e-3
# One path serves all lags where the band ends at least so many windows aside, by so many nodes: to 1e-8.
PATH_NODES, _BENT, _WINDOWS_ASIDE = 24, 0.03, 1.25
# Least axial cycles of a wave at the end of the band for the expansion of a Hankel function.
_CYCLES = 4
_SLAB = 1 << 22
# A slab that stays in the processor's cache.
_BLOCK = 1 << 16
# Frequencies per lag above which a direct sum over them takes less time than a transform.
_FEW_LAGS, _FREQUENCIES_PER_LAG = 32, 256
# More frequencies along an axis are not summed (at five times the samples there may be more): seconds, and 1 GB.
_MOST_FREQUENCIES = 12288
# Estimates are means over few transverse frequencies: twice their value bounds the error.
SAFETY = 2.0
_MOST_LIGHT = 2048


@dataclass(frozen=True)
class Axis:
    """One axis of a propagation; lengths in metres.

    Attributes
    ----------
    samples : int
        Samples of the field, so that lags go up to samples − 1.
    pitch : float
        Pixel pitch.
    wavelength : float
        Wavelength.
    distance : float
        Absolute value of the distance.
    transverse : float
        Highest frequency of the other axis, in 1/m.
    """

    samples: int
    pitch: float
    wavelength: float
    distance: float
    transverse: float

    @property
    def band(self) -> float:
        """Return the highest frequency of the axis."""
        return 0.5 / self.pitch

    def displacement(self, transverse: Any = 0.0) -> Any:
        """Return how many samples aside the highest frequency lands; infinite for waves that decay."""
        axial = (1 / self.wavelength) ** 2 - np.asarray(transverse, dtype=float) ** 2 - self.band**2
        if self.distance == 0:
            return 0 * axial
        with np.errstate(divide="ignore"):
            return np.where(axial > 0, self.distance * self.band / np.sqrt(np.maximum(axial, 0)) / self.pitch, np.inf)

    def transverse_samples(self) -> np.ndarray:
        """Return the midpoints of six equal parts of the other axis' travelling waves."""
        return (np.arange(6) + 0.5) / 6 * min(self.transverse, 0.98 / self.wavelength)


@dataclass(frozen=True)
class Rule:
    """How the integral over the frequencies of an axis is summed.

    Attributes
    ----------
    count : int
        Frequencies of the discrete Fourier transform, an even number.
    corrections : tuple of complex
        What is added to the weight one of the last frequencies, from the end of the band inwards, for a positive
        distance; none for the plain sum.
    tapered : bool
        True if frequencies that would fold back are faded out.
    error : float
        Relative error on fields of flat spectrum, where it was asked for.
    """

    count: int
    corrections: tuple[complex, ...] = ()
    tapered: bool = False
    error: float = field(default=0.0, compare=False)

    def weights(self) -> np.ndarray:
        """Return the weights of the non-negative frequencies, complex128 ``[count // 2 + 1]``, for z > 0."""
        weights = np.ones(self.count // 2 + 1, dtype=np.complex128)
        if self.corrections:
            weights[::-1][: len(self.corrections)] += self.corrections
            # One sample of the transform stands for both ends of the band.
            weights[-1] *= 2
        return weights


# No sum: the integral in closed form, but for the frequencies beyond the band.
CLOSED = Rule(0, error=1e-8)


def rules_for(axes: tuple[Axis, Axis], tolerance: float) -> tuple[Rule, Rule]:
    """Return the rules along both axes of free space: the closed form where it holds for both, else sums."""
    if all(_is_far(axis) for axis in axes):
        return CLOSED, CLOSED
    return rule_for(axes[0], tolerance), rule_for(axes[1], tolerance)


def _is_far(axis: Axis) -> bool:
    reach = float(axis.displacement())
    if not (_curvature_beyond(axis, reach) < _BENT and reach >= _WINDOWS_ASIDE * axis.samples):
        return False
    axial = math.sqrt(1 / axis.wavelength**2 - axis.band**2)
    # The wave of the last node must still decay along the path as the first ones do.
    last = np.polynomial.laguerre.laggauss(PATH_NODES)[0][-1] / (2 * math.pi * reach * axis.pitch)
    decay = np.sqrt(1 / axis.wavelength**2 - (axis.band - 1j * last) ** 2).imag * axis.distance / last
    outside = (reach - axis.samples) * axis.pitch
    return axis.distance * axial > _CYCLES and decay - axis.samples * axis.pitch > 0.8 * outside


def plain_rule(samples: int) -> Rule:
    """Return the rule for geometries that are not known as numbers, and for bands that end within a grid."""
    refinement = next(times for most, times in ((256, 8), (1024, 4), (math.inf, 2)) if samples < most)
    return Rule(refinement * 2 * samples, (), True)


def rule_for(axis: Axis, tolerance: float) -> Rule:
    """Return the shortest rule whose error, of a flat spectrum, is below a quarter of `tolerance`, or the best one.

    Lengths are rounded to three digits, so that a distance that is learned finds its rule again.
    """
    if axis.distance == 0:
        return Rule(2 * axis.samples)
    return _rule_for(Axis(axis.samples, *(float(f"{value:.3g}") for value in astuple(axis)[1:])), tolerance)


@functools.lru_cache(maxsize=256)
def _rule_for(axis: Axis, tolerance: float) -> Rule:
    reach, most = float(axis.displacement(axis.transverse)), _MOST_FREQUENCIES
    if not math.isfinite(reach):
        # Waves along the plane leave any grid: the error falls with the number of frequencies only.
        reach, most = float(axis.displacement()), _MOST_FREQUENCIES // 4
        reach = reach if math.isfinite(reach) else 0.0
    tried = {}
    for density in _DENSITIES:
        count = _even_fast(max(density * (reach + axis.samples), 2.5 * axis.samples, _SHORTEST))
        if count > max(most, 5 * axis.samples):
            break
        turn = 2 * math.pi / count
        # Rounding moves the ends of the range by a percent at most.
        low = max(-1.01 * float(axis.displacement(axis.transverse) + axis.samples) * turn, -_LARGEST_TURN)
        high = float(axis.samples - 0.99 * min(axis.displacement(), axis.samples + reach)) * turn
        rule = Rule(count, end_corrections(round(low, 3), round(min(max(high, low + 1.0), -low), 3)))
        tried[rule] = white_error(axis, rule)
        if tried[rule] < tolerance / 4:
            return replace(rule, error=tried[rule])
    # Where the whole band takes too many frequencies, those that leave the grid are left out.
    faded = Rule(_even_fast(max(4 * axis.samples, _SHORTEST)), (), True)
    tried[faded] = white_error(axis, faded)
    best = min(tried, key=tried.__getitem__)
    return replace(best, error=tried[best])


def _even_fast(least: float) -> int:
    return 2 * int(scipy.fft.next_fast_len(math.ceil(least / 2)))


@functools.lru_cache(maxsize=256)
def end_corrections(low: float, high: float, taps: int = _TAPS) -> tuple[complex, ...]:
    """Return what to add to the weights at the end of Σ exp(−iωk), k = 0, 1, …, so that it is 1/(iω).

    The fit is by least squares over `low` ≤ ω ≤ `high`, ω being the phase from one term to the next.
    """
    turns = np.linspace(low, high, 801)
    turns = turns[np.abs(turns) > 1e-6]
    wanted = 1 / (1j * turns) - 1 / (1 - np.exp(-1j * turns))
    terms = np.exp(-1j * turns[:, None] * np.arange(taps))
    # A quarter of the rows at a time is reduced to a triangle: for all at once, LAPACK takes threads that cost more
    # than the fit.
    parts = np.array_split(np.column_stack([terms, wanted]), 4)
    reduced = np.concatenate([np.linalg.qr(part, mode="r") for part in parts])
    found = np.linalg.lstsq(reduced[:, :-1], reduced[:, -1], rcond=1e-10)[0]
    return tuple(complex(value) for value in found)


def white_error(axis: Axis, rule: Rule | None) -> float:
    """Return the relative error that a rule makes on fields of flat spectrum; None means the sampled kernel."""
    transverse, reference = _reference(axis)
    weights = axis.samples - np.arange(axis.samples)
    weights[1:] *= 2
    difference = _deviation(axis, transverse, rule, reference)
    return math.sqrt(np.sum(weights * np.abs(difference) ** 2) / np.sum(weights * np.abs(reference) ** 2))


def _deviation(axis: Axis, transverse, rule: Rule | None, reference) -> np.ndarray:
    if rule == CLOSED:
        return CLOSED.error * reference
    return response(axis, transverse, rule) - reference


@functools.lru_cache(maxsize=32)
def _reference(axis: Axis):
    transverse = axis.transverse_samples()
    return transverse, reference_response(axis, transverse)


def response(axis: Axis, transverse: np.ndarray, rule: Rule | None) -> np.ndarray:
    """Return the response ``[transverse, lags]`` at the lags 0 … samples − 1, times the pitch.

    `rule` None means samples of the response of the unlimited band, the Rayleigh–Sommerfeld kernel's.
    """
    if rule is None:
        return _unlimited_response(axis, transverse)
    frequency = np.arange(rule.count // 2 + 1) / (rule.count * axis.pitch)
    weights = rule.weights()
    if rule.tapered:
        squared = (1 / axis.wavelength) ** 2 - frequency**2
        tangent = frequency / np.sqrt(np.maximum(squared, (1e-3 / axis.wavelength) ** 2))
        half = rule.count * axis.pitch / 2
        deviation = min(math.sqrt(axis.wavelength * axis.distance / (2 * math.pi)), half / 6)
        weights = weights * scipy.special.ndtr((half - axis.distance * tangent) / deviation)
    found = np.empty((len(transverse), axis.samples), dtype=np.complex128)
    few = axis.samples <= min(_FEW_LAGS, rule.count // _FREQUENCIES_PER_LAG)
    if few:
        # The first lags alone, by real weights: the spectrum is even.
        turns = np.arange(len(frequency))[:, None] * np.arange(axis.samples) % rule.count / rule.count
        cosines = np.cos(2 * np.pi * turns) * (2 / rule.count)
        cosines[[0, -1]] /= 2
    else:
        mirror = np.minimum(np.arange(rule.count), rule.count - np.arange(rule.count))
    step = max(1, _BLOCK // len(frequency) if few else _SLAB // rule.count)
    for start in range(0, len(transverse), step):
        part = slice(start, start + step)
        squared = (1 / axis.wavelength) ** 2 - transverse[part, None] ** 2 - frequency**2
        half_spectrum = _propagator(axis.distance, squared) * weights
        if few:
            found[part] = (half_spectrum.real @ cosines) + 1j * (half_spectrum.imag @ cosines)
        else:
            found[part] = np.fft.ifft(half_spectrum[:, mirror], axis=-1)[:, : axis.samples]
    return found


def _propagator(distance: float, squared: np.ndarray) -> np.ndarray:
    """Return exp(i2πz·sqrt(q²)) for squares of axial frequencies; waves with negative ones decay."""
    if squared.min() <= 0:
        return np.exp(2j * np.pi * distance * np.sqrt(squared.astype(np.complex128)))
    # Sine and cosine of real arguments take a quarter of the time.
    phase = 2 * np.pi * (distance * np.sqrt(squared) % 1.0)
    found = np.empty(squared.shape, dtype=np.complex128)
    np.cos(phase, out=found.real)
    np.sin(phase, out=found.imag)
    return found


def reference_response(axis: Axis, transverse: np.ndarray) -> np.ndarray:
    """Return the response to 1e-9: in closed form but for the end of the band, or by a fine rule."""
    found = np.zeros((len(transverse), axis.samples), dtype=np.complex128)
    reach = axis.displacement(transverse)
    straight = _curvature_beyond(axis, reach) < _STRAIGHT
    if straight.any():
        found[straight] = _unlimited_response(axis, transverse[straight]) - _beyond_the_band(axis, transverse[straight])
    nodes, beyond = _nodes_beyond(axis, transverse)
    # Where no wave beyond the band travels there is nothing between its end and waves along the plane.
    places = (np.minimum(reach, _LONGEST_REFERENCE) + axis.samples) * axis.pitch
    few = beyond * places * (2 * math.pi / _REFERENCE_TURN) < _GRAZING
    summed = ~straight & few & (nodes <= _MOST_NODES)
    if summed.any():
        beyond = _waves_beyond_the_band(axis, transverse[summed], int(nodes[summed].max()))
        found[summed] = _unlimited_response(axis, transverse[summed]) - beyond
    limited = ~(straight | summed) & ((reach + axis.samples) * 2 * math.pi / _REFERENCE_TURN < _LONGEST_REFERENCE)
    # One rule for each octave of its length.
    lengths = np.where(limited, np.ceil(np.log2(np.where(limited, reach, 0) + axis.samples)), -1)
    for exponent in np.unique(lengths[limited]):
        chosen = lengths == exponent
        count = _even_fast(max(2**exponent * 2 * math.pi / _REFERENCE_TURN, 8 * _SHORTEST))
        rule = Rule(count, end_corrections(-_REFERENCE_TURN, _REFERENCE_TURN, _REFERENCE_TAPS))
        found[chosen] = response(axis, transverse[chosen], rule)
    left = ~(straight | summed | limited)
    if left.any():
        # So close to the field that hardly any wave leaves the grid.
        found[left] = response(axis, transverse[left], Rule(_LONGEST_REFERENCE // 4))
    return found


def _curvature_beyond(axis: Axis, reach) -> np.ndarray:
    """Return how curved the phase beyond the band is, relative to its decay at the last lag; infinite near the band.

    The second derivative of the phase is z·(q² + B²)/q³ at the axial frequency q = z·B/reach, and λz for small angles.
    """
    reach = np.where(np.isfinite(reach), reach, 0) * axis.pitch
    outside, length = reach - axis.samples * axis.pitch, np.hypot(reach, axis.distance)
    curved = reach * (length / axis.distance) ** 2 / axis.band if axis.distance else 0.0
    with np.errstate(divide="ignore"):
        return np.where(outside > 0, curved / (4 * math.pi * np.square(outside)), np.inf)


def _unlimited_response(axis: Axis, transverse) -> np.ndarray:
    """Return the first Rayleigh–Sommerfeld kernel along a line, iπq·z/ρ·H₁(2πqρ)·pitch.

    ρ² = x² + z², q² = 1/λ² − f² and H₁ is the Hankel function of the first kind.
    """
    axial = np.sqrt(((1 / axis.wavelength) ** 2 - np.asarray(transverse) ** 2).astype(np.complex128))[:, None]
    rho = np.hypot(np.arange(axis.samples) * axis.pitch, axis.distance)
    return 1j * np.pi * axial * axis.distance / rho * scipy.special.hankel1(1, 2 * np.pi * axial * rho) * axis.pitch


def _beyond_the_band(axis: Axis, transverse) -> np.ndarray:
    """Return the integral over the frequencies beyond the band, of waves that land outside all lags.

    From both ends of the band the path is turned straight down in the complex plane, where the integrand decays without
    an oscillation: f = B − iτ, and Gauss and Laguerre's nodes for τ.
    """
    nodes, weights = np.polynomial.laguerre.laggauss(_TURNED_NODES)
    squared = (1 / axis.wavelength) ** 2 - np.asarray(transverse)[:, None, None] ** 2
    landing = axis.distance * axis.band / np.sqrt(squared - axis.band**2)
    found = np.empty((len(transverse), axis.samples), dtype=np.complex128)
    step = max(1, _BLOCK // axis.samples)
    for start in range(0, len(transverse), step):
        part = slice(start, start + step)
        sums = 0j
        for place in (np.arange(axis.samples)[:, None] * axis.pitch, -np.arange(axis.samples)[:, None] * axis.pitch):
            rate = 2 * np.pi * (landing[part] - place)
            frequency = axis.band - 1j * nodes / rate
            cycles = axis.distance * np.sqrt(squared[part] - frequency**2) + place * frequency
            waves = np.exp(2j * np.pi * (cycles.real % 1.0) - 2 * np.pi * cycles.imag + nodes)
            sums = sums - 1j * (waves * weights / rate).sum(-1)
        found[part] = sums
    return axis.pitch * found


def _nodes_beyond(axis: Axis, transverse) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes that :func:`_waves_beyond_the_band` takes, and the range of travelling waves beyond the band.

    There are six nodes for each cycle at the last lag.
    """
    squared = np.maximum((1 / axis.wavelength) ** 2 - np.asarray(transverse) ** 2, axis.band**2)
    beyond, width = np.sqrt(squared) - axis.band, axis.samples * axis.pitch
    travelling = axis.distance * np.sqrt(squared - axis.band**2) + width * beyond
    return 64 + 6 * np.maximum(40 / (2 * np.pi * axis.distance) * width, travelling), beyond


def _waves_beyond_the_band(axis: Axis, transverse, count: int) -> np.ndarray:
    """Return the integral over the frequencies beyond the band: waves that still travel, and those that decay.

    The axial frequency q, real and then imaginary, is the variable, in which nothing is singular where waves turn from
    one to the other: f² = s² − q² and df = −q/f dq.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    found = np.zeros((len(transverse), axis.samples), dtype=np.complex128)
    places = np.arange(axis.samples) * axis.pitch
    # Beyond 40 nepers nothing is left.
    longest = 40 / (2 * np.pi * axis.distance)
    for k, squared in enumerate((1 / axis.wavelength) ** 2 - np.asarray(transverse) ** 2):
        # The axial frequency at the end of the band.
        end = np.emath.sqrt(squared - axis.band**2)
        for axial, step in (
            (np.real(end) * (1 - nodes) / 2, np.real(end) / 2),
            (1j * (np.imag(end) + longest * (nodes + 1) / 2), -1j * longest / 2),
        ):
            if step:
                frequency = np.sqrt(squared - np.real(axial**2))
                waves = np.exp(2j * np.pi * axis.distance * axial) * axial / frequency * weights * step
                cosines = np.cos(2 * np.pi * places[:, None] * frequency)
                found[k] += cosines @ waves.real + 1j * (cosines @ waves.imag)
    return 2 * axis.pitch * found


def field_error(
    field: np.ndarray,
    axes: tuple[Axis, Axis],
    rules: tuple[Rule | None, Rule | None],
    step: Callable[[], object] = lambda: None,
) -> float:
    """Return the norm of the error that two rules make on a field, within its own window.

    The difference to the reference is applied along one axis at a time, for each frequency of the other; `step` is
    called after each of the two.
    """
    rows, columns = field.shape[-2:]
    total = 0.0
    for which in (0, 1):
        axis, other = axes[which], axes[1 - which]
        count = _frequencies_without_wrap(other)
        spectrum = np.fft.fft2(field.astype(np.complex128), s=(count, 2 * columns) if which else (2 * rows, count))
        difference = _difference(axis, count, other.pitch, rules[which])
        lags = np.concatenate([difference, np.zeros_like(difference[:, :1]), difference[:, :0:-1]], axis=1)
        mirror = np.minimum(np.arange(count), count - np.arange(count))
        transfer = np.fft.fft(lags, axis=1)[mirror]
        spectrum *= transfer.T if which == 0 else transfer
        # Along the longer axis first, and the other one within the window alone.
        error = (
            np.fft.ifft(np.fft.ifft(spectrum, axis=-2)[..., :rows, :], axis=-1)[..., :columns]
            if which
            else np.fft.ifft(np.fft.ifft(spectrum, axis=-1)[..., :columns], axis=-2)[..., :rows, :]
        )
        total += float(np.sum(error.real**2 + error.imag**2))
        step()
    return math.sqrt(total)


@functools.lru_cache(maxsize=2)
def _difference(axis: Axis, count: int, pitch: float, rule: Rule | None) -> np.ndarray:
    """Return the error of a rule's response ``[transverse, lags]`` at the frequencies of `count` samples across.

    The axes of a square field have it in common.
    """
    transverse = np.arange(count // 2 + 1) / (count * pitch)
    travels = transverse < 0.999 / axis.wavelength
    difference = np.zeros((len(transverse), axis.samples), dtype=np.complex128)
    reference = reference_response(axis, transverse[travels])
    difference[travels] = _deviation(axis, transverse[travels], rule, reference)
    return difference


def _frequencies_without_wrap(axis: Axis) -> int:
    """Return the number of frequencies with which no light comes back into the window, at most 2048 beyond twice it."""
    reach = float(axis.displacement(axis.transverse))
    reach = reach if math.isfinite(reach) else 8.0 * float(min(axis.displacement(), _MOST_LIGHT))
    return _even_fast(max(2 * axis.samples, min(2 * (axis.samples + reach), _MOST_LIGHT)))


def predicted_white_error(axes: tuple[Axis, Axis], rules: tuple[Rule | None, Rule | None]) -> float:
    """Return a bound on the relative error that two rules make on fields of flat spectrum."""
    return SAFETY * math.hypot(*(white_error(axis, rule) for axis, rule in zip(axes, rules, strict=True)))
