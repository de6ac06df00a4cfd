"""Table of the propagation methods: names, aliases, ranges of validity, capabilities and implementations."""

import difflib
import functools
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from odak import _array, _validate
from odak._array import Array, phasor_of_cycles
from odak._warnings import AccuracyWarning, SamplingWarning, warn
from odak.wave import transfer_functions as tf
from odak.wave.fourier import chirp, convolve_with_chirp
from odak.wave.linear_kernels import axes_of, linear_kernel
from odak.wave.sampling import PARAXIAL_TOLERANCE, Criteria, criteria, linear_error, recommend
from odak.wave.transfer_functions import Grid, Request, convolve, pitches

_log = logging.getLogger("odak")
_AXES = (-2, -1)
_LENGTHS = ("field", "distance", "wavelength", "dx")
_ROUNDING = 1 + 1e-12


@dataclass(frozen=True)
class Method:
    """A propagation method and what it can do.

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
        True if `apply` understands ``request.window`` and ``request.aperture``, so that the field need not be padded.
    scalable : bool
        True if `scale` and `samples` have a meaning: several samples per pixel, averages over pixels.
    needs_distance : bool
        True if a distance of zero is an error.
    sets_own_pitch : bool
        True if the pitch of the result follows from the geometry.
    of_intensities : bool
        True if the method takes and returns intensities.
    takes_kernel : bool
        True if the transfer function is the caller's.
    chunked : bool
        True if `apply` takes a field in chunks, a Dask array, and computes its transfer function a chunk at a time.
    differentiable : tuple of str
        Arguments in which the result is differentiable.
    """

    name: str
    aliases: tuple[str, ...]
    apply: Callable[..., Any]
    failure: Callable[[Criteria], str | None]
    kernel: Callable[..., Any] | None = None
    windowed: bool = True
    scalable: bool = False
    needs_distance: bool = False
    sets_own_pitch: bool = False
    of_intensities: bool = False
    takes_kernel: bool = False
    chunked: bool = False
    differentiable: tuple[str, ...] = _LENGTHS


# How each method is carried out.


class _Filter:
    """An `apply` that filters by the transfer function ``build_for(request)``.

    It does so on twice the field's grid, for a linear convolution, or where the request is for a window of it.
    """

    def __init__(self, build_for: Callable[..., Any], linear: bool = False):
        self._build_for, self._linear = build_for, linear

    def kernel(self, field, request: Request):
        """Return the transfer function times the aperture, for a field of the grid's samples."""
        size = request.size(field, self._linear)
        return _times_aperture(request.kernel_for(field, self._build_for(request), size), request.aperture, field)

    def __call__(self, field, request: Request):
        """Return the filtered field."""
        field = field if self._linear else spread(field, request.scale)
        return convolve(field, self.kernel(field, request))


def _filter(build: Callable[..., Any]) -> _Filter:
    """Return an `apply` that filters by the transfer function `build`."""
    return _Filter(lambda request: build)


def spread(field: Array, scale: int) -> Any:
    """Return the field on a grid `scale` times finer, zeros between its samples."""
    if scale == 1:
        return field
    xp = _array.namespace(field)
    *batch, rows, columns = field.shape
    fine = xp.reshape(field, (*batch, rows, 1, columns, 1))
    mask = xp.zeros((scale, 1, scale), dtype=field.dtype, device=_array.device_of(field))
    mask[0, 0, 0] = 1
    return xp.reshape(fine * mask, (*batch, rows * scale, columns * scale))


def _times_aperture(kernel, aperture, field):
    """Return kernel × centred aperture."""
    if not _array.is_array(aperture):
        return kernel if aperture == 1 else kernel * complex(aperture)
    xp = _array.namespace(field)
    aperture = _array.cast(aperture, field)
    # One axis is that of the columns.
    axes = _AXES[-aperture.ndim :] if aperture.ndim else ()
    for axis in axes:
        if aperture.shape[axis] not in (1, kernel.shape[axis]):
            raise ValueError(
                f"aperture must be a number or shaped like the grid of field, {tuple(kernel.shape[-2:])}, "
                f"got {tuple(aperture.shape)}"
            )
    if axes:
        aperture = xp.fft.ifftshift(aperture, axes=axes)
    return kernel * aperture


def _filter_by_given_kernel(field, request: Request):
    xp, size, kernel = _array.namespace(field), request.size(field), request.kernel
    if kernel is None:
        kernel = xp.ones(size, dtype=field.dtype, device=_array.device_of(field))
    accepted = f"[..., {size[0]}, {size[1]}], of the shape of the propagated field"
    _validate.shaped("kernel", _validate.image("kernel", kernel), accepted)
    kernel = xp.fft.ifftshift(_array.cast(kernel, field), axes=_AXES)
    return convolve(field, _times_aperture(kernel, request.aperture, field))


def _filter_intensity(field, request: Request):
    """Return an intensity filtered by the autocorrelation of transfer function × pupil; the aperture is the pupil."""
    xp, size = _array.namespace(field), request.size(field)
    if _array.is_array(request.aperture):
        pupil = _times_aperture(request.kernel_for(field, tf.angular_spectrum, size), request.aperture, field)
        kernel = tf.autocorrelation(pupil)
    else:
        kernel = request.kernel_for(field, tf.incoherent_angular_spectrum, size)
    return xp.real(convolve(field, kernel))


@functools.lru_cache(maxsize=16)
def _linear_angular_spectrum(tolerance: float, judged: bool) -> linear_kernel:
    return linear_kernel(tf.angular_spectrum, tolerance=tolerance, judged=judged)


def _fraunhofer(field, request: Request):
    """Return the Fraunhofer pattern of a centred field (Goodman 2005, eq. 4-25)."""
    xp = _array.namespace(field)
    field = _conjugate_behind(field, request)
    spectrum = xp.fft.fftn(xp.fft.ifftshift(field, axes=_AXES), axes=_AXES)
    spectrum = _conjugate_behind(spectrum, request) * request.kernel_for(field, _fraunhofer_factor, field.shape[-2:])
    return xp.astype(xp.fft.fftshift(spectrum, axes=_AXES), field.dtype, copy=False)


def _fraunhofer_inverse(field, request: Request):
    """Return the field whose Fraunhofer pattern is given: the exact inverse, with the pitch of the source plane."""
    xp = _array.namespace(field)
    factor = request.kernel_for(field, _fraunhofer_factor, field.shape[-2:])
    spectrum = _conjugate_behind(xp.fft.ifftshift(field, axes=_AXES) / factor, request)
    source = _conjugate_behind(xp.fft.ifftn(spectrum, axes=_AXES), request)
    return xp.astype(xp.fft.fftshift(source, axes=_AXES), field.dtype, copy=False)


def _conjugate_behind(values, request: Request):
    """Return the conjugate of fields whose distance is negative.

    There the point x receives the frequency −x/(λ|z|). Conjugation before and after a transform changes its sign.
    """
    if not _array.is_array(request.distance) and min(_validate.numbers(request.distance)) > 0:
        return values
    xp = _array.namespace(values)
    distance = request.grid((1, 1), xp, _array.device_of(values), values.dtype).distance
    return xp.where(distance < 0, xp.conj(values), values)


def _fraunhofer_factor(grid: Grid):
    """Return exp(ikz)/(iλz)·exp(ik(x² + y²)/(2z))·dx² on the output grid, whose pitch is λ|z|/(N·dx), in FFT order."""
    xp = grid.xp
    fy, fx = grid.frequencies()
    # With x = λz·f the quadratic phase is πλz·f².
    cycles = tf.axial_cycles(grid) - 0.25 + grid.wavelength * grid.distance * (fx**2 + fy**2) / 2
    amplitude = xp.astype(grid.pixel_area / (grid.wavelength * grid.distance), grid.dtype)
    return grid.unfold(phasor_of_cycles(cycles, grid.dtype) * amplitude)


def _extend_band(oversampling: int) -> Callable[..., Any]:
    """Return an `apply` by the angular spectrum on `oversampling` times as many frequencies as samples.

    Beyond the critical distance N·dx²/λ the phase of the transfer function changes by more than π between two
    frequencies of the DFT's grid. A grid of the same number of points over the band |f| ≤ f_c = ½·sqrt(K/(λ|z|))
    samples it without aliasing (Zhang, Zhang and Jin, Opt. Lett. 45, 1543 and 4416 (2020)). Both grids are uniform, so
    that a chirp-z transform goes from one to the other exactly, without interpolation. With twice as many frequencies
    nothing wraps around.
    """

    def apply(field, request: Request):
        xp = _array.namespace(field)
        rows, columns = field.shape[-2:]
        counts = (oversampling * rows, oversampling * columns)
        grid = request.grid(counts, xp, _array.device_of(field), field.dtype)
        steps = [step * pitch for step, pitch in zip(_frequency_steps(grid), grid.pitch, strict=True)]
        into = chirp(field, -steps[0], rows, -2) * chirp(field, -steps[1], columns, -1)
        spectrum = convolve_with_chirp(field * into, -steps[1], counts[1], axis=-1)
        spectrum = convolve_with_chirp(spectrum, -steps[0], counts[0], axis=-2)
        # The chirps behind the transform to frequencies and before the one back are each other's inverse.
        spectrum = spectrum * request.kernel_for(field, _band_extended_transfer, counts)
        result = convolve_with_chirp(spectrum, steps[0], rows, axis=-2)
        result = convolve_with_chirp(result, steps[1], columns, axis=-1)
        out = xp.conj(into) * xp.astype(steps[0] * steps[1], field.dtype)
        return xp.astype(result * out, field.dtype, copy=False)

    return apply


def _frequency_steps(grid: Grid):
    """Return 2·f_c/K along rows and columns, f_c no higher than the Nyquist frequency 1/(2·dx)."""
    xp, steps = grid.xp, []
    for count, pitch in zip(grid.shape, grid.pitch, strict=True):
        ratio = xp.abs(grid.distance) * grid.wavelength / (count * pitch**2)
        steps.append(1 / (count * pitch * xp.sqrt(xp.where(ratio > 1, ratio, xp.ones_like(ratio)))))
    return steps


def _band_extended_transfer(grid: Grid):
    """Return the angular-spectrum kernel, centred, at the frequencies of the extended band."""
    frequencies = []
    for axis, (count, step) in enumerate(zip(grid.shape, _frequency_steps(grid), strict=True)):
        indices = grid.xp.arange(count, dtype=grid.xp.float64, device=grid.device) - count // 2
        frequencies.append(grid.xp.reshape(indices, (-1, 1) if axis == 0 else (1, -1)) * step)
    return tf.plane_wave_transfer(grid, *frequencies)


# Where each method is valid. At the limit itself the rounding of N·dx²/λ does not decide.


def _kernel_aliases(report: Criteria) -> str | None:
    z, limit = abs(report.distance), min(report.critical_distance)
    beyond = z > limit * _ROUNDING
    return f"|z| = {z:.4g} m is beyond {limit:.4g} m, from where its transfer function aliases" if beyond else None


def _band_is_lost(report: Criteria) -> str | None:
    kept = min(report.kept_band)
    return f"it keeps only {kept:.0%} of the band at |z| = {abs(report.distance):.4g} m" if kept < 0.5 else None


def _response_aliases(report: Criteria) -> str | None:
    return _too_near(report, max(report.critical_distance), "its impulse response aliases")


def _sum_aliases(report: Criteria) -> str | None:
    return _too_near(report, report.response_distance, "its impulse response aliases")


def _not_far(report: Criteria) -> str | None:
    why = "the far field is not reached (lens_fourier_transform is for the focal plane of a lens)"
    return _too_near(report, report.fraunhofer_distance, why)


def _too_near(report: Criteria, limit: float, why: str) -> str | None:
    z = abs(report.distance)
    return f"|z| = {z:.4g} m is short of {limit:.4g} m, where {why}" if 0 < z * _ROUNDING < limit else None


def _not_paraxial(report: Criteria) -> str | None:
    error = report.paraxial_error
    return f"the Fresnel approximation is off by up to {error:.2g} waves" if error > PARAXIAL_TOLERANCE else None


def _first(*criteria: Callable[..., Any]) -> Callable[..., Any]:
    """Return a criterion that fails with the first of several that fails."""
    return lambda report: next(filter(None, (criterion(report) for criterion in criteria)), None)


def _never(report: Criteria) -> None:
    """Hold everywhere."""


_IMPULSE_RESPONSE = Method(
    "Impulse Response Fresnel",
    ("IR Fresnel",),
    _filter(tf.impulse_response_fresnel),
    _first(_response_aliases, _not_paraxial),
    kernel=tf.impulse_response_fresnel,
    scalable=True,
    needs_distance=True,
    chunked=True,
)
METHODS = (
    Method(
        "Bandlimited Angular Spectrum",
        ("Band-limited Angular Spectrum", "BLAS"),
        _filter(tf.band_limited_angular_spectrum),
        _band_is_lost,
        kernel=tf.band_limited_angular_spectrum,
        chunked=True,
    ),
    Method(
        "Angular Spectrum",
        ("AS",),
        _filter(tf.angular_spectrum),
        _kernel_aliases,
        kernel=tf.angular_spectrum,
        chunked=True,
    ),
    Method(
        "Transfer Function Fresnel",
        ("TR Fresnel", "TF Fresnel"),
        _filter(tf.transfer_function_fresnel),
        _first(_kernel_aliases, _not_paraxial),
        kernel=tf.transfer_function_fresnel,
        chunked=True,
    ),
    _IMPULSE_RESPONSE,
    replace(
        _IMPULSE_RESPONSE,
        name="Seperable Impulse Response Fresnel",
        aliases=("Separable Impulse Response Fresnel", "Seperable IR Fresnel", "Separable IR Fresnel"),
    ),
    Method(
        "Incoherent Angular Spectrum",
        (),
        _filter_intensity,
        _kernel_aliases,
        kernel=tf.incoherent_angular_spectrum,
        of_intensities=True,
    ),
    Method(
        "Fraunhofer",
        (),
        _fraunhofer,
        _not_far,
        windowed=False,
        needs_distance=True,
        sets_own_pitch=True,
    ),
    Method(
        "Fraunhofer Inverse",
        (),
        _fraunhofer_inverse,
        _not_far,
        windowed=False,
        needs_distance=True,
        sets_own_pitch=True,
    ),
    Method(
        "Linear Angular Spectrum",
        ("LAS",),
        _Filter(lambda request: _linear_angular_spectrum(request.tolerance, request.judged), linear=True),
        _never,
    ),
    Method(
        "Rayleigh-Sommerfeld",
        ("Rayleigh Sommerfeld", "RS"),
        _Filter(lambda request: tf.rayleigh_sommerfeld, linear=True),
        _sum_aliases,
        chunked=True,
    ),
    Method(
        "Bandextended Angular Spectrum",
        ("Band-extended Angular Spectrum", "Band Extended Angular Spectrum", "BEAS"),
        _extend_band(oversampling=1),
        _never,
        windowed=False,
    ),
    Method(
        "Adaptive Sampling Angular Spectrum",
        ("ASAS",),
        _extend_band(oversampling=2),
        _never,
        windowed=False,
    ),
    Method(
        "custom",
        (),
        _filter_by_given_kernel,
        _never,
        takes_kernel=True,
        chunked=True,
        differentiable=("field", "kernel"),
    ),
)
_BY_NAME = {spelling.casefold(): method for method in METHODS for spelling in (method.name, *method.aliases)}
PROPAGATION_TYPES = (*(method.name for method in METHODS), "auto")


def kernel_of(method: Method, field: Array, request: Request) -> Any:
    """Return the kernel by which a method filters a field, None where it does more than that."""
    return method.apply.kernel(field, request) if isinstance(method.apply, _Filter) and request.scale == 1 else None


def find_method(propagation_type: str) -> Method | None:
    """Return the method of that name or alias, None for "auto".

    Raises
    ------
    ValueError
        If there is none, listing the names and the nearest match.
    """
    _validate.instance("propagation_type", propagation_type, str, "a string")
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


def method_named(name: str) -> Method:
    """Return the method of that name or alias; "auto" is not a method and raises an error."""
    method = find_method(name)
    if method is None:
        raise ValueError("propagation_type must name a method here, got 'auto'")
    return method


def check_has_kernel(propagation_type: str) -> None:
    """Raise ValueError for "custom", where the caller takes no kernel: it would leave every field as it is."""
    method = find_method(propagation_type)
    if method is not None and method.takes_kernel:
        raise ValueError("propagation_type 'custom' needs a kernel, which only propagate_beam takes; got none")


def choose_method(shape: tuple[int, int], request: Request) -> tuple[Method, float]:
    """Return the method whose error is within tolerance at every requested distance and wavelength, and its error.

    The error refers to a field of flat spectrum. An array as an aperture requires the grid that the caller has padded:
    the method is then the angular spectrum on this grid, and the error is unknown, NaN. The error is also NaN for
    lengths that cannot be read.
    """
    geometries = _geometries(request)
    if not geometries:
        return method_named("Linear Angular Spectrum"), math.nan
    if _array.is_array(request.aperture) and request.aperture.ndim and not request.window:
        return method_named("Bandlimited Angular Spectrum"), math.nan
    axes = tuple(axes_of(shape, pitch, wavelength, z) for z, wavelength, pitch in geometries)
    name, error = recommend(axes, request.tolerance)
    _log.debug("propagation_type 'auto' chose %s: its error is at most %.1e of a field's norm", name, error)
    return method_named(name), error


def warnings_outside_range(method: Method, shape: Sequence[int], request: Request, padded: bool) -> Iterator[str]:
    """Yield a text for each of the criteria of a method that is not met; none while lengths are traced."""
    fine = tuple(request.scale * n for n in shape)
    for z, wavelength, step in _geometries(request):
        report = criteria(fine, tuple(value / request.scale for value in step), wavelength, z, padded)
        failure = method.failure(report)
        if failure is not None:
            rows, columns = report.shape
            pitch = " x ".join(f"{value:.3g}" for value in dict.fromkeys(pitches(report.dx)))
            axes = axes_of(shape, pitches(report.dx), report.wavelength, report.distance)
            remedy = f"Use {recommend((axes,), request.tolerance)[0]}, or 'auto'."
            if method.of_intensities:
                remedy = "Surround the intensity by more zeros; the other methods propagate fields."
            yield (
                f"{method.name} is outside its range on a {rows} x {columns} grid (dx = {pitch} m, "
                f"wavelength = {report.wavelength:.4g} m): {failure}. {remedy}"
            )


def _geometries(request: Request) -> list[tuple[Any, ...]]:
    """Return distance, wavelength and pitches where light spreads least and most; nothing while they are traced."""
    given = (*pitches(request.dx), request.wavelength, request.distance)
    if not all(_array.is_readable(value) for value in given):
        return []
    rows, columns, wavelengths, distances = map(_validate.numbers, given)
    per_axis = isinstance(request.dx, (tuple, list))
    pairs = [(a, b) for a in rows for b in columns] if per_axis else [(a, a) for a in rows]
    geometries = sorted(
        {(abs(z), wavelength, pair) for z in distances for wavelength in wavelengths for pair in pairs},
        key=lambda geometry: geometry[0] * geometry[1],
    )
    return sorted({geometries[0], geometries[-1]})


# Without wrap-around the angular spectrum is exact at any distance, and these methods are other ways to compute it.
_EXACT = (
    "Linear Angular Spectrum",
    "Rayleigh-Sommerfeld",
    "Bandextended Angular Spectrum",
    "Adaptive Sampling Angular Spectrum",
)
_LINEAR = {
    "Bandlimited Angular Spectrum": "Angular Spectrum",
    "Impulse Response Fresnel": "Transfer Function Fresnel",
    "Seperable Impulse Response Fresnel": "Transfer Function Fresnel",
}
WITH_TRANSFER_FUNCTION = tuple(m.name for m in METHODS if m.kernel and m.windowed and not m.of_intensities)


def linear_kernel_of(name: str, cutoff: float | None = None, pixel_fill: float | None = None) -> linear_kernel:
    """Return the function of a grid that gives a method's transfer function of linear convolution."""
    transfer: Any = method_named(_LINEAR.get(name, name)).kernel
    return linear_kernel(transfer, cutoff, pixel_fill)


def linear_method(propagation_type: str, shape: Any, dx: Any, wavelength: Any, distance: Any) -> str:
    """Return the full name of what displays and optimizers compute for a propagation type, with warnings of its error.

    They propagate without wrap-around. There the angular spectrum is exact at any distance: it is what "auto" and the
    other exact methods stand for. Of the Fresnel methods, impulse responses included, the paraxial approximation is all
    that is left of their error. Point sources whose light has no limit of the band, which a sampled impulse response
    describes, differ from the band-limited field by ripples of its kernel: a picture of 36 dB is claimed 1 dB too good
    at four times the distance from which the response is sampled finely enough, and more nearer by.

    Parameters
    ----------
    propagation_type : str
        Name, alias or "auto"; not "custom".
    shape : tuple of int
        Rows and columns of the field.
    dx : float or tuple of float
        Its pitch in metres, one number or (rows, columns).
    wavelength : float or list of float
        Wavelengths in metres.
    distance : float or list of float
        Distances in metres.

    Raises
    ------
    ValueError
        If the name is not known, or is "custom".

    Warns
    -----
    SamplingWarning
        If the error of the paraxial phase is above its tolerance, if "auto" misses its own, or if the method has no
        transfer function and is outside its range.
    AccuracyWarning
        If the method propagates intensities, which a phase-only hologram does not shape.
    """
    check_has_kernel(propagation_type)
    chosen = find_method(propagation_type)
    method = method_named("Angular Spectrum") if chosen is None or chosen.name in _EXACT else chosen
    request = Request(dx, wavelength, distance)
    if method.of_intensities:
        warn(
            f"{method.name} propagates intensities, and a phase-only hologram has the same intensity everywhere: a "
            "display of coherent light shows another image. Use 'auto'",
            AccuracyWarning,
        )
    if _LINEAR.get(method.name, method.name) == "Transfer Function Fresnel":
        if all(_array.is_readable(value) for value in (dx, wavelength, distance)):
            pitch, longest, furthest = (max(map(abs, _validate.numbers(value))) for value in (dx, wavelength, distance))
            error = criteria(tuple(shape), (pitch, pitch), longest, furthest, True).paraxial_error
            if error > PARAXIAL_TOLERANCE:
                warn(f"{method.name}: the paraxial phase is off by up to {error:.2g} wavelengths", SamplingWarning)
    elif method.name not in WITH_TRANSFER_FUNCTION:
        for message in warnings_outside_range(method, shape, request, padded=True):
            warn(message, SamplingWarning)
    elif chosen is None:
        warn_above_tolerance(shape, request)
    return method.name


def warn_above_tolerance(shape: Any, request: Request) -> None:
    """Issue a SamplingWarning where the linear angular spectrum misses its tolerance for a field of flat spectrum."""
    geometries = tuple(axes_of(shape, pitch, wavelength, z) for z, wavelength, pitch in _geometries(request))
    error = linear_error(geometries, request.tolerance)
    if error > request.tolerance:
        warn(above_tolerance("Linear Angular Spectrum", error, request.tolerance), SamplingWarning)


def above_tolerance(method: str, error: float, tolerance: float) -> str:
    """Return the text of the warning that the predicted error of the method taken is above the tolerance."""
    return (
        f"{method} was taken, the most accurate method here; its predicted error is {error:.1e} of the field's norm, "
        f"above the tolerance of {tolerance:.1e}: part of the band spreads over more frequencies than can be summed; "
        "take a larger pitch, a shorter distance or a smoother field"
    )
