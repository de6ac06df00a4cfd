"""Sampling criteria of a propagation, and the method that they recommend."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache

import numpy as np
from tqdm import tqdm

from odak import _array, _validate
from odak._array import Array
from odak.wave import transfer_functions as tf
from odak.wave.linear_kernels import TOLERANCE, axes_of, linear_kernel
from odak.wave.quadrature import SAFETY, Axis, field_error, predicted_white_error, rule_for

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

    def to_dict(self) -> dict:
        """Return the report as a plain dictionary (JSON-ready but for an infinite Fresnel number)."""
        return asdict(self)


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
        True when the propagation pads the field to twice its size; the criteria are then those of the padded grid.
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
    The error is that of the norm over the field's window, ‖u − u₀‖/‖u₀‖. The exact field u₀ is that of the band-limited
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
    if not isinstance(dx, (tuple, list)):
        dx = (_validate.real("dx", dx, positive=True),) * 2
    rows, columns = (float(value) for value in _validate.several("dx", dx, 2, positive=True))
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
    if tuple(field.shape[-2:]) != tuple(shape):
        raise ValueError(f"field must be [..., {shape[0]}, {shape[1]}] as given by shape, got {tuple(field.shape)}")
    if not _array.is_readable(field):
        raise ValueError("field must be readable here: its spectrum decides")
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


def linear_error(geometries, tolerance: float) -> float:
    """Return a bound on the error that the linear angular spectrum makes on fields of flat spectrum."""
    return _largest(predicted_white_error(axes, _rules(axes, tolerance)) for axes in geometries if axes[0].distance)


def _largest(errors) -> float:
    return max(errors, default=0.0) + ROUNDING["complex128"]


def recommend_for_field(
    field: np.ndarray, axes: tuple[Axis, Axis], tolerance: float, distance: float, step: Callable[[], object]
):
    """Return the method with the smallest error on a field, or the first within tolerance; `step` counts parts."""
    rounding = ROUNDING[str(field.dtype)]
    if distance == 0:
        return LINEAR, rounding
    found = {}
    for name, rules in ((LINEAR, _rules(axes, tolerance)), (SAMPLED, (None, None))):
        size = float(np.linalg.norm(_propagated(field, axes, distance, name, tolerance)))
        step()
        error = field_error(field, axes, rules, step)
        found[name] = (SAFETY * error / size if size else 0.0) + rounding
        if found[name] <= tolerance:
            return name, found[name]
    name = min(found, key=found.__getitem__)
    return name, found[name]


def _rules(axes, tolerance):
    return tuple(rule_for(axis, tolerance) for axis in axes)


def _propagated(field, axes, distance, name, tolerance):
    """Return the field propagated by linear convolution with one of the two kernels, in double precision."""
    import array_api_compat.numpy as xp

    transfer = tf.rayleigh_sommerfeld if name == SAMPLED else linear_kernel(tf.angular_spectrum, tolerance=tolerance)
    request = tf.Request((axes[0].pitch, axes[1].pitch), axes[0].wavelength, distance)
    size = tuple(2 * n for n in field.shape[-2:])
    kernel = request.transfer_function(transfer, size, xp, "cpu", xp.complex128)
    return tf.convolve_plainly(field.astype(np.complex128), kernel)
