"""The propagation methods: one table of names, aliases, range of validity and how each is carried out."""

import difflib
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from odak import _array, _validate
from odak.wave import far_field, stretched
from odak.wave import transfer_functions as tf
from odak.wave.request import Request
from odak.wave.sampling import PARAXIAL_TOLERANCE, SamplingReport, sampling_report
from odak.wave.spectral import convolve

_log = logging.getLogger("odak")
_warned: set = set()


@dataclass(frozen=True)
class Method:
    """A way to propagate.

    Attributes
    ----------
    name : str
        Long name.
    aliases : tuple of str
        Other accepted spellings; case never matters.
    apply : callable
        ``apply(field, request)`` returns the propagated field.
    failure : callable
        ``failure(report)`` says which sampling criterion is not met, or None.
    kernel : callable, optional
        Transfer function ``kernel(grid)`` of the methods that have one.
    windowed : bool
        Whether `apply` understands ``request.window`` and need not be given a padded field.
    """

    name: str
    aliases: tuple[str, ...]
    apply: Callable
    failure: Callable[[SamplingReport], str | None]
    kernel: Callable | None = None
    windowed: bool = True


def _filter(build: Callable) -> Callable:
    """Return an `apply` that filters by the transfer function `build`."""

    def apply(field, request: Request):
        field = spread(field, request.scale)
        size = tuple((2 if request.window else 1) * n for n in field.shape[-2:])
        return convolve(field, _masked(request.kernel_for(field, build, size), request.aperture, field))

    return apply


def spread(field, scale: int):
    """Return the field on a grid `scale` times finer, zeros between its samples."""
    if scale == 1:
        return field
    xp = _array.namespace(field)
    *batch, rows, columns = field.shape
    fine = xp.reshape(field, (*batch, rows, 1, columns, 1))
    mask = xp.zeros((scale, 1, scale), dtype=field.dtype, device=_array.device_of(field))
    mask[0, 0, 0] = 1
    return xp.reshape(fine * mask, (*batch, rows * scale, columns * scale))


def _masked(kernel, aperture, field):
    """Return kernel × centred aperture."""
    if not _array.is_array(aperture):
        return kernel if aperture == 1 else kernel * complex(aperture)
    xp = _array.namespace(field)
    aperture = _array.cast(aperture, field)
    if aperture.ndim >= 2:
        for have, want in zip(aperture.shape[-2:], kernel.shape[-2:], strict=True):
            if have not in (1, want):
                raise ValueError(
                    f"aperture must be a number or shaped like the grid of field, {tuple(kernel.shape[-2:])}, "
                    f"got {tuple(aperture.shape)}"
                )
        aperture = xp.fft.ifftshift(aperture, axes=(-2, -1))
    return kernel * aperture


def _filter_by_given_kernel(field, request: Request):
    xp = _array.namespace(field)
    size = tuple((2 if request.window else 1) * n for n in field.shape[-2:])
    kernel = request.kernel
    if kernel is None:
        kernel = xp.ones(size, dtype=field.dtype, device=_array.device_of(field))
    if tuple(_validate.image("kernel", kernel).shape[-2:]) != size:
        raise ValueError(
            f"kernel must have the shape [..., {size[0]}, {size[1]}] of the propagated field, got {tuple(kernel.shape)}"
        )
    kernel = xp.fft.ifftshift(_array.cast(kernel, field), axes=(-2, -1))
    return convolve(field, _masked(kernel, request.aperture, field))


def _filter_intensity(field, request: Request):
    xp = _array.namespace(field)
    return xp.abs(_filter(tf.incoherent_angular_spectrum)(field, request))


def _sum_rayleigh_sommerfeld(field, request: Request):
    """Return the linear convolution with the sampled kernel, on twice the field's grid."""
    size = tuple(2 * n for n in field.shape[-2:])
    kernel = request.kernel_for(field, tf.rayleigh_sommerfeld, size)
    return convolve(field, _masked(kernel, request.aperture, field))


def _kernel_aliases(report: SamplingReport) -> str | None:
    z, limit = abs(report.distance), min(report.critical_distance)
    return f"|z| = {z:.4g} m is beyond {limit:.4g} m, from where its transfer function aliases" if z > limit else None


def _band_is_lost(report: SamplingReport) -> str | None:
    kept = min(report.kept_band)
    return f"it keeps only {kept:.0%} of the band at |z| = {abs(report.distance):.4g} m" if kept < 0.5 else None


def _response_aliases(report: SamplingReport) -> str | None:
    return _too_near(report, max(report.critical_distance), "its impulse response aliases")


def _sum_aliases(report: SamplingReport) -> str | None:
    return _too_near(report, report.response_distance, "its impulse response aliases")


def _not_far(report: SamplingReport) -> str | None:
    return _too_near(report, report.fraunhofer_distance, "the far field is not reached")


def _too_near(report: SamplingReport, limit: float, why: str) -> str | None:
    z = abs(report.distance)
    return f"|z| = {z:.4g} m is short of {limit:.4g} m, where {why}" if 0 < z < limit else None


def _not_paraxial(report: SamplingReport) -> str | None:
    error = report.paraxial_error
    return f"the Fresnel approximation is off by up to {error:.2g} waves" if error > PARAXIAL_TOLERANCE else None


def _first(*criteria: Callable) -> Callable:
    """Return a criterion that fails with the first of several that fails."""
    return lambda report: next(filter(None, (criterion(report) for criterion in criteria)), None)


def _never(report: SamplingReport) -> None:
    """Hold everywhere."""


METHODS = (
    Method(
        "Bandlimited Angular Spectrum",
        ("Band-limited Angular Spectrum", "BLAS"),
        _filter(tf.band_limited_angular_spectrum),
        _band_is_lost,
        tf.band_limited_angular_spectrum,
    ),
    Method("Angular Spectrum", ("AS",), _filter(tf.angular_spectrum), _kernel_aliases, tf.angular_spectrum),
    Method(
        "Transfer Function Fresnel",
        ("TR Fresnel", "TF Fresnel"),
        _filter(tf.transfer_function_fresnel),
        _first(_kernel_aliases, _not_paraxial),
        tf.transfer_function_fresnel,
    ),
    Method(
        "Impulse Response Fresnel",
        ("IR Fresnel",),
        _filter(tf.impulse_response_fresnel),
        _first(_response_aliases, _not_paraxial),
        tf.impulse_response_fresnel,
    ),
    Method(
        "Seperable Impulse Response Fresnel",
        ("Separable Impulse Response Fresnel", "Seperable IR Fresnel", "Separable IR Fresnel"),
        _filter(tf.impulse_response_fresnel),
        _first(_response_aliases, _not_paraxial),
        tf.impulse_response_fresnel,
    ),
    Method(
        "Incoherent Angular Spectrum",
        (),
        _filter_intensity,
        _kernel_aliases,
        tf.incoherent_angular_spectrum,
    ),
    Method(
        "Fraunhofer",
        (),
        far_field.fraunhofer_field,
        _not_far,
        windowed=False,
    ),
    Method(
        "Fraunhofer Inverse",
        (),
        far_field.fraunhofer_source,
        _not_far,
        windowed=False,
    ),
    Method(
        "Rayleigh-Sommerfeld",
        ("Rayleigh Sommerfeld", "RS"),
        _sum_rayleigh_sommerfeld,
        _sum_aliases,
    ),
    Method(
        "Bandextended Angular Spectrum",
        ("Band-extended Angular Spectrum", "Band Extended Angular Spectrum", "BEAS"),
        stretched.band_extended,
        _never,
        windowed=False,
    ),
    Method(
        "Adaptive Sampling Angular Spectrum",
        ("ASAS",),
        stretched.adaptive_sampling,
        _never,
        windowed=False,
    ),
    Method("custom", (), _filter_by_given_kernel, _never),
)
_BY_NAME = {spelling.casefold(): method for method in METHODS for spelling in (method.name, *method.aliases)}
PROPAGATION_TYPES = (*(method.name for method in METHODS), "auto")
DISTANCE_NEEDED = ("Fraunhofer", "Fraunhofer Inverse", "Impulse Response Fresnel", "Seperable Impulse Response Fresnel")


def find_method(propagation_type: str) -> Method | None:
    """Return the method of that name or alias, None for "auto".

    Raises
    ------
    ValueError
        If there is none, listing the names and the nearest match.
    """
    if not isinstance(propagation_type, str):
        raise TypeError(f"propagation_type must be a string, got {type(propagation_type).__name__}")
    name = propagation_type.strip().casefold()
    if name == "auto":
        return None
    if name in _BY_NAME:
        return _BY_NAME[name]
    near = difflib.get_close_matches(name, _BY_NAME, n=1, cutoff=0.4)
    hint = f" Did you mean {_BY_NAME[near[0]].name!r}?" if near else ""
    raise ValueError(
        f"propagation_type must be one of {', '.join(map(repr, PROPAGATION_TYPES))} or an alias; "
        f"got {propagation_type!r}.{hint}"
    )


def choose_method(shape: tuple[int, int], request: Request, padded: bool) -> Method:
    """Return the method whose sampling criteria hold at every distance and wavelength asked for."""
    reports = _reports(shape, request, padded)
    if not reports:
        raise ValueError("propagation_type 'auto' needs a distance, dx and wavelength that are plain numbers")
    plain = not _array.is_array(request.aperture) and request.aperture == 1
    names = [*(report.recommended for report in reports), "Bandlimited Angular Spectrum"]
    # The last one has no limit, and takes longer.
    known: list[Any] = [find_method(name) for name in (*names, "Adaptive Sampling Angular Spectrum")]
    held = [m for m in known if (plain or m.windowed) and all(m.failure(report) is None for report in reports)]
    method: Any = held[0] if held else find_method("Bandlimited Angular Spectrum")
    _log.debug("propagation_type 'auto' chose %s: %s", method.name, reports[0].reason)
    return method


def warn_outside_range(method: Method, shape: tuple[int, int], request: Request, padded: bool) -> None:
    """Log, once per method and grid, that a method is used where its criteria fail."""
    for report in _reports(shape, request, padded):
        failure = method.failure(report)
        if failure is None or (method.name, report.shape) in _warned:
            continue
        _warned.add((method.name, report.shape))
        _log.warning(
            "%s is outside its range on a %d x %d grid (dx = %.3g m, wavelength = %.4g m): %s. Use %s, or 'auto'.",
            method.name,
            *report.shape,
            report.dx,
            report.wavelength,
            failure,
            report.recommended,
        )


def _reports(shape, request: Request, padded: bool) -> list[SamplingReport]:
    """Return the criteria at the extremes of the distances and wavelengths asked for; none while they are traced."""
    if not all(_array.is_readable(value) for value in (request.dx, request.wavelength, request.distance)):
        return []
    pairs = sorted(
        {
            (abs(z), wavelength, dx)
            for z in _validate.numbers(request.distance)
            for wavelength in _validate.numbers(request.wavelength)
            for dx in _validate.numbers(request.dx)
        },
        key=lambda pair: pair[0] * pair[1],
    )
    fine = tuple(request.scale * n for n in shape)
    extremes = {pairs[0], pairs[-1]}
    return [sampling_report(fine, dx / request.scale, wavelength, z, padded) for z, wavelength, dx in sorted(extremes)]
