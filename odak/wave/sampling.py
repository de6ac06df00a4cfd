"""What the sampling of a field allows: the criteria that decide between propagation methods, as data."""

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
    dx, wavelength, distance : float
        The geometry asked about.
    nyquist : float
        Highest frequency of the grid, 1/(2·dx).
    critical_distance : tuple of float
        N·dx²/λ. Up to here a transfer function is sampled finely enough; from here on an impulse response is
        (Voelz, Computational Fourier Optics, 2011, section 5.3).
    response_distance : float
        2·N·dx²/λ of the field's longer side: from here on the Rayleigh–Sommerfeld kernel is sampled finely enough.
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
    """

    shape: tuple[int, int]
    dx: float
    wavelength: float
    distance: float
    nyquist: float
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
    shape: Sequence[int], dx: float, wavelength: float, distance: float, zero_padding: bool = False
) -> SamplingReport:
    """Return the sampling criteria of a propagation and the method they recommend.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns of the field.
    dx : float
        Pixel pitch in metres.
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
    dx = float(_validate.real("dx", dx, positive=True))
    wavelength = float(_validate.real("wavelength", wavelength, positive=True))
    distance = float(_validate.real("distance", distance))
    return _report(shape, dx, wavelength, distance, _validate.flag("zero_padding", zero_padding))


@lru_cache(maxsize=1024)
def _report(shape, dx, wavelength, distance, zero_padding) -> SamplingReport:
    z = abs(distance)
    grid = tuple(2 * n if zero_padding else n for n in shape)
    nyquist = 1 / (2 * dx)
    critical = tuple(n * dx**2 / wavelength for n in grid)
    limit = tuple(1 / (wavelength * math.hypot(2 * z / (n * dx), 1)) for n in grid)
    response = 2 * max(shape) * dx**2 / wavelength
    recommended, reason = _recommend(z, min(critical), response)
    return SamplingReport(
        shape=grid,
        dx=dx,
        wavelength=wavelength,
        distance=distance,
        nyquist=nyquist,
        critical_distance=critical,
        response_distance=response,
        band_limit=limit,
        kept_band=tuple(min(1.0, value / nyquist) for value in limit),
        fresnel_number=tuple((n * dx / 2) ** 2 / wavelength / z if z else math.inf for n in shape),
        fraunhofer_distance=2 * (max(shape) * dx) ** 2 / wavelength,
        paraxial_error=_paraxial_error(z, wavelength, [min(nyquist, value) for value in limit]),
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
