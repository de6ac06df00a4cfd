"""Sampling criteria of a propagation, and the method that they recommend."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache

from odak import _validate

# A Fresnel phase that is off by more than a fifth of a wave is no longer the field that was asked for.
PARAXIAL_TOLERANCE = 0.2


@dataclass(frozen=True)
class SamplingReport:
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
        Share of the grid's band that lies below `band_limit`, 0 to 1.
    fresnel_number : tuple of float
        (N·dx/2)²/(λ·|z|), infinite at z = 0.
    fraunhofer_distance : float
        2·W²/λ with W the longer side of the grid: beyond it the far-field pattern is reached.
    paraxial_error : float
        Largest phase error of the Fresnel approximation over the frequencies that can reach the grid, in waves.
    recommended : str
        Propagation type whose criteria hold.
    reason : str
        Why, in one line.

    Examples
    --------
    The critical distance is N·dx²/λ:

    >>> from odak.wave import sampling_report
    >>> report = sampling_report([100, 100], 1e-5, 5e-7, 0.1)
    >>> [round(value, 9) for value in report.critical_distance]
    [0.02, 0.02]
    """

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
    recommended: str
    reason: str

    def to_dict(self) -> dict:
        """Return the report as a plain dictionary (JSON-ready but for an infinite Fresnel number)."""
        return asdict(self)


def sampling_report(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float,
    distance: float,
    zero_padding: bool = False,
) -> SamplingReport:
    """Return the sampling criteria of a propagation and the method they recommend.

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
        True when the propagation pads the field to twice its size.

    Returns
    -------
    SamplingReport
        The criteria; `recommended` names a propagation type, `reason` says why.

    Raises
    ------
    ValueError, TypeError
        If an argument is not of the kind above, naming it.

    Examples
    --------
    >>> import odak
    >>> report = odak.wave.sampling_report([1080, 1920], 8e-6, 532e-9, 0.15, zero_padding=True)
    >>> report.recommended
    'Angular Spectrum'
    >>> round(report.critical_distance[0], 3)
    0.26
    """
    shape = _validate.size("shape", shape)
    if not isinstance(dx, (tuple, list)):
        dx = (_validate.real("dx", dx, positive=True),) * 2
    rows, columns = (float(value) for value in _validate.several("dx", dx, 2, positive=True))
    wavelength = float(_validate.real("wavelength", wavelength, positive=True))
    distance = float(_validate.real("distance", distance))
    return _report(shape, (rows, columns), wavelength, distance, _validate.flag("zero_padding", zero_padding))


@lru_cache(maxsize=1024)
def _report(shape, pitch, wavelength, distance, zero_padding) -> SamplingReport:
    z = abs(distance)
    grid = tuple(2 * n if zero_padding else n for n in shape)
    nyquist = tuple(1 / (2 * d) for d in pitch)
    critical = tuple(n * d**2 / wavelength for n, d in zip(grid, pitch, strict=True))
    limit = tuple(1 / (wavelength * math.hypot(2 * z / (n * d), 1)) for n, d in zip(grid, pitch, strict=True))
    response = 2 * max(n * d**2 for n, d in zip(shape, pitch, strict=True)) / wavelength
    square = pitch[0] == pitch[1]
    recommended, reason = _recommend(z, min(critical), response)
    return SamplingReport(
        shape=grid,
        dx=pitch[0] if square else pitch,
        wavelength=wavelength,
        distance=distance,
        nyquist=nyquist[0] if square else nyquist,
        critical_distance=critical,
        response_distance=response,
        band_limit=limit,
        kept_band=tuple(min(1.0, value / most) for value, most in zip(limit, nyquist, strict=True)),
        fresnel_number=tuple(
            (n * d / 2) ** 2 / wavelength / z if z else math.inf for n, d in zip(shape, pitch, strict=True)
        ),
        fraunhofer_distance=2 * max(n * d for n, d in zip(shape, pitch, strict=True)) ** 2 / wavelength,
        paraxial_error=_paraxial_error(z, wavelength, map(min, nyquist, limit)),
        recommended=recommended,
        reason=reason,
    )


def _paraxial_error(z: float, wavelength: float, frequencies) -> float:
    sine_squared = min(1.0, wavelength**2 * sum(f**2 for f in frequencies))
    return z / wavelength * abs(math.sqrt(1 - sine_squared) - (1 - sine_squared / 2))


def _recommend(z: float, near: float, far: float) -> tuple[str, str]:
    if z <= near:
        return "Angular Spectrum", f"|z| = {z:.4g} m is within the critical distance {near:.4g} m"
    if z >= far:
        return (
            "Rayleigh-Sommerfeld",
            f"|z| = {z:.4g} m is beyond {far:.4g} m, where the impulse response is well sampled",
        )
    return (
        "Bandlimited Angular Spectrum",
        f"|z| = {z:.4g} m is between {near:.4g} m (transfer function) and {far:.4g} m (impulse response)",
    )
