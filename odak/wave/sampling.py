"""Sampling criteria of propagations, elements and beams, and the method of propagation that they recommend."""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from odak import _array, _show, _validate
from odak._array import Amount, Array
from odak._bars import tqdm
from odak._warnings import SamplingWarning, warn
from odak.wave import transfer_functions as tf
from odak.wave.linear_kernels import TOLERANCE, axes_of, linear_kernel
from odak.wave.quadrature import SAFETY, Axis, field_error, predicted_white_error, rules_for

# Largest error of the Fresnel phase, a fifth of a wave, at which the field is considered accurate.
PARAXIAL_TOLERANCE = 0.2
# Relative error of the arithmetic: transforms and phases.
ROUNDING = {"complex64": 5e-7, "complex128": 1e-12}


@dataclass(frozen=True)
class Criteria:
    """Sampling criteria of a propagation: the attributes of :class:`SamplingReport` up to `paraxial_error`."""

    shape: tuple[int, int]
    dx: float | tuple[float, float]
    wavelength: float
    distance: float
    nyquist: float | tuple[float, float]
    critical_distance: tuple[float, float]
    response_distance: float
    band_limit: tuple[float, float]
    kept_band: tuple[float, float]
    fresnel_number: tuple[float, ...]
    fraunhofer_distance: float
    paraxial_error: float


@dataclass(frozen=True)
class SamplingReport(Criteria):
    """Sampling criteria of a propagation. Lengths in metres, frequencies in 1/m, pairs as (rows, columns).

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of the grid on which a transfer function is sampled: the field's, or twice it if padded.
    dx : float or tuple of float
        Pixel pitch, a pair (rows, columns) where the two differ.
    wavelength : float
        Wavelength.
    distance : float
        Propagation distance.
    nyquist : float or tuple of float
        Highest frequency of the grid, 1/(2·dx); a pair where the pitches differ.
    critical_distance : tuple of float
        N·dx²/λ. Up to here a transfer function is sampled finely enough; from here on an impulse response is
        (Voelz, Computational Fourier Optics, 2011, section 5.3).
    response_distance : float
        2·N·dx²/λ, the larger of the two axes of the field: from here on the Rayleigh–Sommerfeld kernel is sampled
        finely enough.
    band_limit : tuple of float
        Highest alias-free frequency of the angular-spectrum kernel (Matsushima and Shimobaba 2009, eq. 13).
    kept_band : tuple of float
        Share of the propagating waves of the grid whose frequency lies below `band_limit`, 0 to 1.
    fresnel_number : tuple of float
        (N·dx/2)²/(λ·|z|), infinite at z = 0.
    fraunhofer_distance : float
        2·W²/λ with W the longer side of the grid: beyond it the far-field pattern is reached.
    paraxial_error : float
        Largest phase error of the Fresnel approximation over the frequencies that can reach the grid, in waves.
    recommended : str
        Propagation type whose error is within the tolerance, or that comes nearest; what "auto" takes.
    reason : str
        Why, in one line.
    tolerance : float
        Requested relative error.
    predicted_error : float
        Bound on the relative error of the recommended method: of the field given, or of a field of flat spectrum.

    Examples
    --------
    The critical distance is N·dx²/λ:

    >>> from odak.wave import sampling_report
    >>> report = sampling_report([100, 100], 1e-5, 5e-7, 0.1)
    >>> [round(value, 9) for value in report.critical_distance]
    [0.02, 0.02]
    """

    recommended: str
    reason: str
    tolerance: float
    predicted_error: float

    def to_dict(self) -> dict[Any, Any]:
        """Return the report as a plain dictionary (JSON-ready but for an infinite Fresnel number)."""
        return asdict(self)

    def _repr_html_(self) -> str:
        error, most = f"a relative error of {self.predicted_error:.1e}", f"the tolerance of {self.tolerance:.1e}"
        doubts = [f"{error} is more than {most}"] if self.predicted_error > self.tolerance else []
        return _show.fields_html(self, f"{self.recommended}: {error} at most. Lengths in metres", doubts)


@_validate.takes_units("dx", "wavelength", "distance")
def sampling_report(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float,
    distance: float,
    zero_padding: bool = False,
    tolerance: float = TOLERANCE,
    field: Array | None = None,
    progress: bool = True,
) -> SamplingReport:
    """Return the sampling criteria of a propagation, the method they recommend and a bound on its error.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns of the field.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float
        Wavelength in metres.
    distance : float
        Propagation distance in metres; negative values propagate back.
    zero_padding : bool
        True when the propagation pads the field to twice its size; the criteria then apply to the padded grid.
    tolerance : float
        Requested relative error of the propagated field.
    field : array, optional
        Field ``[..., *shape]`` whose spectrum decides. By default the whole band is filled evenly, as by a field of
        random phase.
    progress : bool, default: True
        Show a progress bar if it takes longer than a second, which large fields do.

    Returns
    -------
    SamplingReport
        The criteria; `recommended` names a propagation type, `reason` says why, `predicted_error` bounds its error.

    Raises
    ------
    ValueError, TypeError
        If an argument is not of the kind above, naming it.

    Notes
    -----
    The error is ‖u − u₀‖/‖u₀‖, with norms over the field's window. The exact field u₀ comes from the band-limited
    interpolation of the samples, dark outside the window, which propagates without wrap-around.

    Examples
    --------
    >>> import odak
    >>> report = odak.wave.sampling_report([1080, 1920], 8e-6, 532e-9, 0.15, zero_padding=True)
    >>> report.recommended
    'Linear Angular Spectrum'
    >>> report.predicted_error < 1e-4
    True
    >>> round(report.critical_distance[0], 3)
    0.26
    """
    shape = _validate.size("shape", shape)
    (dx,) = _validate.constants(dx=dx)
    rows, columns = (float(value) for value in _validate.pair("dx", dx, positive=True))
    wavelength = _validate.constant("wavelength", wavelength, positive=True)
    distance = _validate.constant("distance", distance)
    tolerance = _validate.constant("tolerance", tolerance, positive=True)
    found = criteria(shape, (rows, columns), wavelength, distance, _validate.flag("zero_padding", zero_padding))
    axes, shown = axes_of(shape, (rows, columns), wavelength, distance), _validate.flag("progress", progress)
    if field is None:
        name, error = recommend((axes,), tolerance)
    else:
        # Propagation and two axes of each of two methods.
        with tqdm(total=6, desc="sampling", unit="step", delay=1, leave=False, disable=not shown) as bar:
            name, error = recommend_for_field(_checked_field(field, shape), axes, tolerance, distance, bar.update)
    met = "within" if error <= tolerance else "above"
    bound = f"at |z| = {abs(distance):.4g} m its relative error is at most {error:.1e}, {met} the tolerance"
    return SamplingReport(**asdict(found), recommended=name, reason=bound, tolerance=tolerance, predicted_error=error)


def _checked_field(field, shape) -> np.ndarray:
    field = _array.to_complex(_validate.image("field", field))
    _validate.shaped("field", field, f"[..., {shape[0]}, {shape[1]}] as given by shape")
    if not _array.is_readable(field):
        raise ValueError("field must be readable here: its spectrum decides")
    _validate.check_values("field", field)
    return np.asarray(field.detach().cpu().numpy() if _array.is_torch(field) else field)


@lru_cache(maxsize=1024)
def criteria(shape, pitch, wavelength, distance, zero_padding) -> Criteria:
    """Return the sampling criteria of checked arguments."""
    z = abs(distance)
    grid = tuple(2 * n if zero_padding else n for n in shape)
    nyquist = tuple(1 / (2 * d) for d in pitch)
    critical = tuple(n * d**2 / wavelength for n, d in zip(grid, pitch, strict=True))
    limit = tuple(1 / (wavelength * math.hypot(2 * z / (n * d), 1)) for n, d in zip(grid, pitch, strict=True))
    square = pitch[0] == pitch[1]
    return Criteria(
        shape=grid,
        dx=pitch[0] if square else pitch,
        wavelength=wavelength,
        distance=distance,
        nyquist=nyquist[0] if square else nyquist,
        critical_distance=critical,
        response_distance=2 * max(n * d**2 for n, d in zip(shape, pitch, strict=True)) / wavelength,
        band_limit=limit,
        kept_band=tuple(
            min(1.0, value / min(most, 1 / wavelength)) for value, most in zip(limit, nyquist, strict=True)
        ),
        fresnel_number=tuple(
            (n * d / 2) ** 2 / wavelength / z if z else math.inf for n, d in zip(shape, pitch, strict=True)
        ),
        fraunhofer_distance=2 * max(n * d for n, d in zip(shape, pitch, strict=True)) ** 2 / wavelength,
        paraxial_error=_paraxial_error(z, wavelength, map(min, nyquist, limit)),
    )


def _paraxial_error(z: float, wavelength: float, frequencies) -> float:
    sine_squared = min(1.0, wavelength**2 * sum(f**2 for f in frequencies))
    return z / wavelength * abs(math.sqrt(1 - sine_squared) - (1 - sine_squared / 2))


# Methods "auto" chooses from: linear convolution with the band-limited kernel, and with the sampled one, which is exact
# where no wave beyond the band propagates.
LINEAR, SAMPLED = "Linear Angular Spectrum", "Rayleigh-Sommerfeld"


@lru_cache(maxsize=256)
def recommend(geometries: tuple[tuple[Axis, Axis], ...], tolerance: float) -> tuple[str, float]:
    """Return the method that serves fields of flat spectrum best at all geometries, and a bound on its error."""
    linear = linear_error(geometries, tolerance)
    if linear > tolerance:
        sampled = _largest(predicted_white_error(axes, (None, None)) for axes in geometries if axes[0].distance)
        if sampled < linear:
            return SAMPLED, sampled
    return LINEAR, linear


@lru_cache(maxsize=256)
def linear_error(geometries: tuple[tuple[Axis, Axis], ...], tolerance: float) -> float:
    """Return a bound on the error that the linear angular spectrum makes on fields of flat spectrum."""
    return _largest(predicted_white_error(axes, rules_for(axes, tolerance)) for axes in geometries if axes[0].distance)


def _largest(errors) -> float:
    return max(errors, default=0.0) + ROUNDING["complex128"]


def recommend_for_field(
    field: np.ndarray, axes: tuple[Axis, Axis], tolerance: float, distance: float, step: Callable[[], object]
) -> Any:
    """Return the method with the smallest error on a field, or the first within tolerance; `step` counts parts."""
    rounding = ROUNDING[str(field.dtype)]
    if distance == 0:
        return LINEAR, rounding
    found = {}
    for name, rules in ((LINEAR, rules_for(axes, tolerance)), (SAMPLED, (None, None))):
        size = float(np.linalg.norm(_propagated(field, axes, distance, name, tolerance)))
        step()
        error = field_error(field, axes, rules, step)
        found[name] = (SAFETY * error / size if size else 0.0) + rounding
        if found[name] <= tolerance:
            return name, found[name]
    name = min(found, key=found.__getitem__)
    return name, found[name]


def _propagated(field, axes, distance, name, tolerance):
    """Return the field propagated by linear convolution with one of the two kernels, in double precision."""
    import array_api_compat.numpy as xp

    transfer = tf.rayleigh_sommerfeld if name == SAMPLED else linear_kernel(tf.angular_spectrum, tolerance=tolerance)
    request = tf.Request((axes[0].pitch, axes[1].pitch), axes[0].wavelength, distance)
    size = tuple(2 * n for n in field.shape[-2:])
    with warnings.catch_warnings():
        # A method that turns out to be wrong here is not the one that is taken.
        warnings.simplefilter("ignore", SamplingWarning)
        kernel = request.transfer_function(transfer, size, xp, "cpu", xp.complex128)
    return tf.convolve(field.astype(np.complex128), kernel)


# What elements and beams ask of a grid. Each knows, from its numbers alone, its highest local frequency and the share
# of its power that the grid holds.

# Places along each axis, and on circles, at which neighbouring samples of an element's phase are compared.
_PLACES, _ANGLES = 9, 24


@dataclass(frozen=True)
class Weaker:
    """The number of an element that makes its phase less steep.

    Attributes
    ----------
    index : int
        Its place among the numbers of the element.
    power : int
        1 if it has to grow, −1 if it has to shrink.
    text : str
        What would do, with a place for the number.
    """

    index: int
    power: int
    text: str


FOCAL = "a focal length of at least {:.3g} m"


def sampled_axes(shape: Sequence[int], pitch: Any, offset: Any = (0.0, 0.0)) -> tuple[Any, ...]:
    """Return the first and the last middle between two samples, from a point, and the pitch; along rows and columns."""
    return tuple(
        (min(0.5 - n // 2, 0.0) * step - shift, max((n - 1) // 2 - 0.5, 0.0) * step - shift, step if n > 1 else 0.0)
        for n, step, shift in zip(shape, pitch, offset, strict=True)
    )


def plain_numbers(*values: Any) -> tuple[float, ...] | None:
    """Return single numbers as floats, or None where one is a tensor on a GPU, traced or requires a gradient."""
    if all(type(value) in (int, float) for value in values):
        return values
    if any(_array.is_traced(value) for value in values):
        return None
    found = [_validate.numbers(value) for value in values]
    return tuple(one for (one,) in found) if all(len(one) == 1 for one in found) else None


def warn_beyond_nyquist(
    name: str,
    formula: Callable[..., Any],
    axes: Sequence[tuple[float, float, float]],
    numbers: Sequence[float] | None,
    weaker: Weaker | None = None,
    disc: float | None = None,
) -> None:
    """Issue a SamplingWarning where neighbouring samples of an element's phase differ by more than half a cycle.

    Parameters
    ----------
    name : str
        The element's name.
    formula : callable
        ``formula(y, x, *numbers)`` returns the phase in radians at places of NumPy.
    axes : tuple
        What :func:`sampled_axes` returns.
    numbers : tuple of float or None
        The numbers of the element; None where they cannot be read, and nothing is checked.
    weaker : Weaker, optional
        The number that makes the phase less steep.
    disc : float, optional
        Radius of the disc on which the phase is defined; everywhere by default.
    """
    if numbers is not None:
        message = _array.outside_graphs(_beyond_nyquist, name, formula, axes, numbers, weaker, disc)
        if message:
            warn(message, SamplingWarning)


def warn_of_tilt(name: str, step: Callable[[], object], k: Amount, angle: Amount) -> None:
    """Warn where a plane wave at an angle in degrees has more than half a cycle from one sample to the next."""
    numbers = plain_numbers(step, k, angle)
    if numbers is not None:
        axes = ((0.0, 0.0, 0.0), (0.0, 0.0, numbers[0]))
        warn_beyond_nyquist(name, _tilt, axes, numbers[1:], Weaker(1, -1, "an angle of at most {:.3g} degrees"))


def _tilt(y, x, k, angle):
    return k * np.sin(np.deg2rad(angle)) * x


def undersampling(formula: Callable[..., Any], axes: Any, numbers: Any, disc: Any = None, part: float = 1.0) -> float:
    """Return the largest difference of neighbouring samples, in units of half a cycle; at most 1 can be represented.

    Only the share `part` of the window about its middle is examined.
    """
    lines = []
    for low, high, _ in axes:
        middle, half = (low + high) / 2, (high - low) / 2 * part
        nearest = min(max(0.0, middle - half), middle + half)
        lines.append(np.append(np.linspace(middle - half, middle + half, _PLACES), nearest))
    y, x = (np.ravel(line) for line in np.meshgrid(*lines, indexing="ij"))
    if disc is not None:
        rim = disc - max(step for *_, step in axes) / 2
        angle = np.arange(_ANGLES) * (2 * np.pi / _ANGLES)
        y, x = np.append(y, rim * np.sin(angle)), np.append(x, rim * np.cos(angle))
        kept = (y**2 + x**2 <= rim**2 * (1 + 1e-9)) & (y >= lines[0][0]) & (y <= lines[0][-2])
        kept &= (x >= lines[1][0]) & (x <= lines[1][-2])
        y, x = y[kept], x[kept]
    largest, numbers = 0.0, [np.float64(value) for value in numbers]
    for down, across in ((axes[0][2] / 2, 0.0), (0.0, axes[1][2] / 2)):
        change = np.abs(formula(y + down, x + across, *numbers) - formula(y - down, x - across, *numbers))
        largest = max(largest, float(np.max(change, initial=0.0, where=np.isfinite(change))))
    return largest / math.pi


@lru_cache(maxsize=256)
def _beyond_nyquist(name, formula, axes, numbers, weaker, disc) -> str | None:
    """Return the text of a warning, or None where the phase is sampled finely enough."""
    factor = undersampling(formula, axes, numbers, disc)
    if factor <= 1 + 1e-9:
        return None
    steps = [step for *_, step in axes if step]
    unit = " m" if disc is None else ""
    remedies = [f"a pitch of at most {0.995 * min(steps) / factor:.3g}{unit}"]

    def held(part):
        return undersampling(formula, axes, numbers, disc, part) <= 1

    def held_when_weaker(times):
        changed = list(numbers)
        changed[weaker.index] *= times**weaker.power
        return undersampling(formula, axes, tuple(changed), disc) <= 1

    if disc is None and held(1e-3):
        part = 1 - _first_true(lambda removed: held(1 - removed), 0.0, 1 - 1e-3)
        sides = [part * (high - low) + step for low, high, step in axes if step]
        window = " x ".join(f"{0.995 * side:.3g} m" for side in (sides if len(set(sides)) > 1 else sides[:1]))
        remedies.append(f"a window or an aperture of at most {window}")
    if weaker is not None and held_when_weaker(10 * factor):
        times = _first_true(held_when_weaker, 1.0, 10 * factor)
        remedies.append(weaker.text.format(abs(numbers[weaker.index]) * (1.005 * times) ** weaker.power))
    return beyond_nyquist(name, factor, remedies)


def warn_of_factor(name: str, factor: float, remedies: Sequence[str]) -> None:
    """Issue the same warning for a factor that is known otherwise, if it is above 1."""
    if factor > 1 + 1e-9:
        warn(beyond_nyquist(name, factor, remedies), SamplingWarning)


def beyond_nyquist(name: str, factor: float, remedies: Sequence[str]) -> str:
    """Return the text of the warning that an element or a beam is beyond the highest frequency of the grid."""
    others = ", ".join(remedies[:-1])
    listed = f"{others} or {remedies[-1]}" if others else remedies[-1]
    return (
        f"{name} is {factor:.3g} times beyond Nyquist, with up to {factor / 2:.3g} cycles from one sample to the next, "
        f"of which samples can represent half a one; {listed} would do"
    )


# Along each of two axes, for a per cent in all.
_KEPT = 0.995


def held_share(orders: Sequence[float], low: float, high: float) -> float:
    """Return the share of a sum of squared Hermite functions ψₙ², with weights, that lies between two places.

    The recurrence ∫ψₙ² = ∫ψₙ₋₁² − ψₙψₙ₋₁/√(2n) replaces a quadrature.
    """
    share = (math.erf(high) - math.erf(low)) / 2
    total, ends = orders[0] * share, []
    for place in (low, high):
        ends.append((0.0, math.pi**-0.25 * math.exp(-min(place**2, 1400.0) / 2)))
    for n, weight in enumerate(orders[1:], 1):
        rest = []
        for place, (before, now) in zip((low, high), ends, strict=True):
            rest.append((now, math.sqrt(2 / n) * place * now - math.sqrt((n - 1) / n) * before))
        ends = rest
        share -= (math.prod(ends[1]) - math.prod(ends[0])) / math.sqrt(2 * n)
        total += weight * share
    return total


@lru_cache(maxsize=256)
def _half_width(orders: tuple[float, ...]) -> float:
    """Return the place within which a sum of squared Hermite functions holds all but half a per cent."""
    return _first_true(lambda place: held_share(orders, -place, place) >= _KEPT, 0.0, 4 + math.sqrt(2 * len(orders)))


def warn_of_beam(
    name: str,
    orders: Sequence[tuple[float, ...]],
    axes: Sequence[tuple[float, float]],
    pitch: Sequence[float],
    wavelength: float,
    waists: Sequence[float],
    distance: float,
    kept: float | None = None,
) -> None:
    """Issue a SamplingWarning where a grid is too coarse or too small for a beam.

    Parameters
    ----------
    name : str
        The beam's name.
    orders : pair of tuple of float
        Weights of the squared Hermite functions that make its intensity, along rows and columns.
    axes : tuple
        First and last sample of both axes from the axis of the beam.
    pitch : tuple of float
        Pitch (rows, columns).
    wavelength : float
        Wavelength.
    waists : pair of float
        Radius of the waist along rows and columns.
    distance : float
        Distance from the waist.
    kept : float, optional
        Share of the power on the grid; by default the product of both axes' shares.
    """
    product, factor, sides, remedies = 1.0, 0.0, [], []
    for weights, (low, high), step, waist in zip(orders, axes, pitch, waists, strict=True):
        if low == high:
            continue
        rayleigh = math.pi * waist**2 / wavelength
        width, slope = waist * math.hypot(1, distance / rayleigh), distance / (distance**2 + rayleigh**2) / wavelength
        scale, reach = math.sqrt(2) / width, _half_width(weights)
        product *= held_share(weights, (low - step / 2) * scale, (high + step / 2) * scale)
        sides.append(2 * (reach / scale + abs(low + high) / 2) * 1.01 + step)
        # Of the band of the beam, what its wavefront has within the window.
        band = reach / (math.sqrt(2) * math.pi * waist)
        local = abs(slope) * max(abs(low), abs(high)) + reach / (math.sqrt(2) * math.pi * width)
        beyond = 2 * step * min(band, local)
        if beyond > factor:
            factor, remedies = beyond, [f"a pitch of at most {0.995 * step / beyond:.3g} m"]
            if band <= local:
                remedies.append(f"a waist of at least {1.005 * waist * beyond:.3g} m")
    warn_of_factor(name, factor, remedies)
    warn_of_power(name, product if kept is None else kept, sides)


def warn_of_power(name: str, kept: float, sides: Any) -> None:
    """Issue a SamplingWarning where a grid holds less than 99 % of the power of a beam; `sides` would do."""
    if kept < 0.99:
        needed = " x ".join(f"{side:.3g} m" for side in (sides if len(set(sides)) > 1 else sides[:1]))
        warn(
            f"{name}: the grid holds {kept:.2g} of the power of the beam; a window of at least {needed} would do",
            SamplingWarning,
        )


def _first_true(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Return by bisection the smallest number between `low` and `high` for which a monotonic condition holds."""
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
