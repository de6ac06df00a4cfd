"""Propagation of scalar fields over any distance, by any method, for any array library.

All functions take a complex field ``[..., rows, columns]`` sampled with pitch `dx`, the optical axis at index
``n // 2``, and return the field after `distance`. They follow the input: NumPy arrays in, NumPy arrays out; torch
tensors in, differentiable torch tensors out; complex64 in, complex64 out.
"""

import functools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from numbers import Number
from types import ModuleType
from typing import Any

from odak import _array, _validate
from odak._array import Array, Device, DType
from odak._warnings import ArgumentWarning, SamplingWarning, warn
from odak.tools.matrix import crop_center, zero_pad
from odak.wave.fields import budgets, note_loss, power_of
from odak.wave.linear_kernels import TOLERANCE
from odak.wave.methods import (
    METHODS,
    WITH_TRANSFER_FUNCTION,
    Method,
    above_tolerance,
    choose_method,
    find_method,
    kernel_of,
    linear_kernel_of,
    linear_method,
    method_named,
    warnings_outside_range,
)
from odak.wave.sampling import sampling_report
from odak.wave.transfer_functions import (
    Request,
    check_geometry,
    convolve,
    make_grid,
    pitches,
    rayleigh_sommerfeld_response,
    sample_counts,
    upsample,
)

# Default of arguments that stand behind `k`, which may be left out; of any type, so that no checker takes None for one.
REQUIRED: Any = None


@_validate.takes_units("distance", "dx", "wavelength")
def propagate_beam(
    field: Array,
    k: float | Array | None = None,
    distance: float | Array = REQUIRED,
    dx: float | Sequence[float] | Array = REQUIRED,
    wavelength: float | Array = REQUIRED,
    propagation_type: str = "auto",
    kernel: Array | None = None,
    zero_padding: bool | Sequence[bool] = (False, False, False),
    aperture: float | Array = 1.0,
    scale: int = 1,
    samples: Sequence[int] = (1, 1, 1, 1),
    tolerance: float = TOLERANCE,
    axes: int | Sequence[int] = (-2, -1),
) -> Array:
    """Propagate a field, by the method named or by the one whose error is at most 1e-4.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]`` (a real one is taken as a field of phase zero). A Dask array may be
        larger than memory: it is propagated in chunks, by the methods that have a transfer function.
    k : float, optional
        Wave number 2π/wavelength; kept for older callers. It must agree with `wavelength` to 1e-3, as with 2·3.14 in
        place of 2π, and the exact one is used. Calls that name `distance`, `dx` and `wavelength` leave it out.
    distance : float or array
        Propagation distance in metres, negative to propagate back. An array broadcasts against the field's leading
        axes; a torch tensor that requires grad makes the result differentiable in it, like `dx` and `wavelength`.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, a tuple or list (rows, columns), or an array with one pitch for each field of
        the leading axes.
    wavelength : float or array
        Wavelength in metres; an array holds one per channel (leading axes of the field).
    propagation_type : str
        A name or alias of the table of methods ("Bandlimited Angular Spectrum", "IR Fresnel", …), in any case, or
        "auto": the method and the padding whose relative error is below `tolerance` for the whole band that the pitch
        holds (see :func:`odak.wave.sampling_report`), linear convolution wherever that is possible. Tensors on a
        GPU or transformed by torch.func as lengths take "Linear Angular Spectrum" without a prediction of its error.
    kernel : array, optional
        Transfer function for "custom", centred (zero frequency at index n // 2); ones by default, at any distance.
        Of "custom" the lengths may be None.
    zero_padding : sequence of bool
        Pad the field to twice its size; pad the spectrum to twice its size (half the output pitch; no effect with
        Fraunhofer); crop the centre half at the end.
    aperture : float or array
        Centred mask that multiplies the spectrum, of the propagated (padded) size. With "Incoherent Angular Spectrum"
        it is the pupil of the coherent light: the optical transfer function is the autocorrelation of transfer function
        times pupil, 1 at zero frequency, so that a number has no effect.
    scale : int
        Samples per pixel and axis, for the impulse-response methods: the result is `scale` times as large.
    samples : sequence of int
        Points across the source pixel (rows, columns) and the target sample (rows, columns) over which the
        impulse-response methods average.
    tolerance : float
        Relative error of "auto" and "Linear Angular Spectrum", of the norm of the propagated field. Where no method
        stays below it, the spectrum of the field decides, and a SamplingWarning gives the error predicted for it.
    axes : int or sequence of int
        Axes along which the light varies. A field of one column with ``axes=-2``, or of one row with ``axes=-1``, is
        one-dimensional light: cylindrical waves, the same everywhere along the other axis. It is propagated without
        wrap-around, by the kernel of any method that has one. By default a single column is a line of points, whose
        light spreads in both directions.

    Returns
    -------
    array
        Propagated field, complex64 from 32-bit input and complex128 from 64-bit input; real for
        "Incoherent Angular Spectrum".

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it; an unknown `propagation_type` lists the known ones.

    Examples
    --------
    >>> import numpy as np
    >>> import odak
    >>> field = np.ones((8, 8), dtype=np.complex128)
    >>> result = odak.wave.propagate_beam(field, None, 1e-3, 8e-6, 532e-9, "Angular Spectrum")
    >>> bool(np.allclose(result, np.exp(2j * np.pi * 1e-3 / 532e-9)))
    True
    """
    if distance is REQUIRED or dx is REQUIRED or wavelength is REQUIRED:
        k, distance, dx, wavelength = _lengths_of_custom(propagation_type, k, distance, dx, wavelength)
    # Kernels are looked up and warnings issued: no graph of torch.compile can hold that.
    if _array.is_compiling() and kernel is None and axes in ((-2, -1), [-2, -1]):
        geometry = (k, distance, _plain_pair(dx), wavelength, propagation_type, aperture, scale, tolerance)
        options = (*geometry, _plain_pair(zero_padding), _plain_pair(samples))
        if all(type(value) in _PLAIN for value in options):
            field = _array.to_complex(_validate.planes("field", field))
            transfer = _kernel_in_graphs(tuple(field.shape), field.dtype, str(field.device), *options)
            if transfer:
                return _array.convolve_plainly(field, transfer[0])
    if _array.is_array(axes):
        axes = tuple(int(axis) for axis in _validate.numbers(axes))
    if axes != (-2, -1) and axes != [-2, -1]:
        others = (kernel is None, type(aperture) in (int, float) and aperture == 1, scale == 1)
        if not all(others):
            raise ValueError("axes of one-dimensional light go without kernel, aperture and scale")
        return _array.outside_graphs(
            _propagate_line, field, k, distance, dx, wavelength, propagation_type, tolerance, axes
        )
    return _array.outside_graphs(
        _propagate,
        field,
        *(k, distance, dx, wavelength, propagation_type, kernel, zero_padding, aperture, scale, samples, tolerance),
    )


def _lengths_of_custom(propagation_type, k, distance, dx, wavelength):
    """Return lengths where a kernel holds all of them; raise TypeError for other methods, naming what is missing."""
    lengths = {"distance": distance, "dx": dx, "wavelength": wavelength}
    method = find_method(propagation_type)
    if method is None or not method.takes_kernel:
        missing = [name for name, value in lengths.items() if value is REQUIRED]
        raise TypeError(f"propagate_beam needs distance, dx and wavelength; missing: {', '.join(missing)}")
    usual = (0.0, 1.0, 1.0)
    given = [own if value is REQUIRED else value for own, value in zip(usual, lengths.values(), strict=True)]
    return (None if wavelength is REQUIRED else k, *given)


@_array.constant_in_graphs
def _kernel_in_graphs(shape, dtype, device, *options):
    """Return the kernel that is all a propagation of tensors does, for a graph of torch.compile to hold; else nothing.

    It is in a tuple, of which one graph can hold several.
    """
    try:
        method, request, (pad, fine, crop), warnings, error = _cached_plan(shape, *options)
    except (ValueError, TypeError):
        return ()  # an error in a graph would be one of the compiler
    if fine or error > request.tolerance or budgets() or ((pad or crop) and not request.window):
        return ()
    import torch

    from odak import _torch_private

    for message in warnings:
        warn(message, SamplingWarning)
    with _torch_private.outside_functional_transforms():
        kernel = kernel_of(method, torch.empty(shape, dtype=dtype, device=device), request)
    return () if kernel is None else (kernel,)


def _propagate(
    field, k, distance, dx, wavelength, propagation_type, kernel, zero_padding, aperture, scale, samples, tolerance
):
    field = _array.to_complex(_validate.planes("field", field))
    if 0 in field.shape:
        raise ValueError(f"field must contain at least one field, got the shape {tuple(field.shape)}")
    geometry = (k, distance, _plain_pair(dx), wavelength, propagation_type, aperture, scale, tolerance)
    arguments = (tuple(field.shape), *geometry, _plain_pair(zero_padding), _plain_pair(samples))
    plain = kernel is None and _PLAIN.issuperset(map(type, arguments))
    method, request, (pad, fine, crop), warnings, error = (
        _cached_plan(*arguments) if plain else _plan(*arguments, kernel)
    )
    if _array.is_chunked(field) and not method.chunked:
        names = ", ".join(repr(one.name) for one in METHODS if one.chunked)
        raise ValueError(f"propagation_type must be one of {names} for a Dask array, got {method.name!r}")
    for message in warnings:
        warn(message, SamplingWarning)
    if error > tolerance:
        method = _method_for_field(field, method, request, error)
    if budgets():
        _note(field, method, request, (pad, crop))
    if pad and not request.window:
        field = zero_pad(field)
    result = method.apply(field, request)
    if fine and not method.sets_own_pitch:
        result = upsample(_array.to_complex(result))
    result = crop_center(result) if crop and not request.window else result
    if 1 in result.shape[-2:] != (1, 1) and not (fine or method.sets_own_pitch):
        _warn_of_line(field, result)
    return result


def _warn_of_line(field, result) -> None:
    """Warn where the light of a line of points leaves it."""
    if _array.is_traced(field) or _array.is_traced(result) or _array.is_chunked(field):
        return
    kept, axis = float(power_of(result)) / max(float(power_of(field)), 1e-300), -1 if result.shape[-2] == 1 else -2
    if kept < 0.99:
        warn(
            f"a field of one {'row' if axis == -1 else 'column'} is a line of points, whose light spreads aside: "
            f"{kept:.2g} of its power is left on the line; axes={axis} propagates light that is the same everywhere "
            "along the other axis",
            SamplingWarning,
        )


def _note(field, method: Method, request: Request, padding) -> None:
    """Add the losses of a propagation to the open budgets, by its method on a grid that nothing leaves."""
    if method.of_intensities or method.takes_kernel or request.scale != 1:
        return
    (pad, crop), shares = padding, {}
    if method.name in _UNITARY:
        wide = zero_pad(field) if pad else field
        open_request = replace(request, window=False, aperture=1.0)
        whole = method.apply(wide, open_request)
        shares["band"] = 1 - power_of(whole) / power_of(field)
        if _array.is_array(request.aperture) or request.aperture != 1:
            through = method.apply(wide, replace(request, window=False))
            shares["aperture"] = 1 - shares["band"] - power_of(through) / power_of(field)
            whole = through
        result = crop_center(whole) if pad and crop else whole
        note_loss(method.name, field, result, **shares)
    elif not method.sets_own_pitch:
        result = method.apply(zero_pad(field) if pad and not request.window else field, request)
        note_loss(method.name, field, crop_center(result) if pad and crop and not request.window else result)


# Methods whose kernel on the grid of the field only turns phases, or takes frequencies away.
_UNITARY = ("Angular Spectrum", "Bandlimited Angular Spectrum", "Transfer Function Fresnel")


def _propagate_line(field, k, distance, dx, wavelength, propagation_type, tolerance, axes):
    """Propagate light that varies along one axis, by linear convolution."""
    field = _array.to_complex(_validate.image("field", field))
    axes = tuple(axes) if isinstance(axes, (tuple, list)) else (axes,)
    if axes not in ((-2,), (-1,)):
        raise ValueError(f"axes must be -2 (one column), -1 (one row) or (-2, -1), got {axes!r}")
    if field.shape[-3 - axes[0]] != 1:
        lines = "column" if axes == (-2,) else "row"
        raise ValueError(f"field must have one {lines} for axes={axes[0]}, got the shape {tuple(field.shape)}")
    check_geometry(k, distance, dx, wavelength, tuple(field.shape[:-2]))
    method = find_method(propagation_type)
    name = "Angular Spectrum" if method is None or method.name == "Linear Angular Spectrum" else method.name
    if name not in WITH_TRANSFER_FUNCTION:
        raise ValueError(f"propagation_type must have a transfer function for one-dimensional light, got {name!r}")
    tolerance = _validate.constant("tolerance", tolerance, positive=True)
    build = replace(linear_kernel_of(name), axes=axes, tolerance=tolerance)
    rows, columns = field.shape[-2:]
    result = convolve(field, Request(dx, wavelength, distance).kernel_for(field, build, (2 * rows, 2 * columns)))
    note_loss(f"{name} of a line", field, result)
    return result


def _method_for_field(field, method: Method, request: Request, error: float) -> Method:
    """Return the method for a field where none serves the whole band, with a warning if none serves this field."""
    lengths = (*pitches(request.dx), request.wavelength, request.distance)
    if _array.is_readable(field) and all(len(_validate.numbers(value)) == 1 for value in lengths):
        dy, dx, wavelength, distance = (_validate.numbers(value)[0] for value in lengths)
        report = sampling_report(
            field.shape[-2:], (dy, dx), wavelength, distance, tolerance=request.tolerance, field=field, progress=False
        )
        method, error = method_named(report.recommended), report.predicted_error
    if error > request.tolerance:
        warn(above_tolerance(method.name, error, request.tolerance), SamplingWarning)
    return method


def _plan(
    shape, k, distance, dx, wavelength, propagation_type, aperture, scale, tolerance, zero_padding, samples, kernel=None
):
    """Check the arguments of a propagation; return its method, request, padding, warnings and predicted error."""
    check_geometry(k, distance, dx, wavelength, shape[:-2])
    aperture = _checked_aperture(aperture)
    pad, fine, crop = padding_flags(zero_padding)
    request = Request(
        dx,
        wavelength,
        distance,
        aperture,
        kernel,
        _validate.integer("scale", scale, minimum=1),
        sample_counts(samples),
        pad and crop and not fine,
        _validate.constant("tolerance", tolerance, positive=True),
    )
    method, error, warnings = find_method(propagation_type), 0.0, ()
    if method is None:
        request = replace(request, judged=True)
        method, error = choose_method(shape[-2:], request)
        if math.isnan(error):
            # Lengths that cannot be read without waiting are not read for a rule of their own either.
            request = replace(request, tolerance=math.inf)
    else:
        # What "auto" took is judged by the error predicted for the field.
        warnings = tuple(warnings_outside_range(method, shape[-2:], request, pad))
    _check_method(method, request)
    window = method.windowed and request.window
    return method, replace(request, window=window), (pad, fine, crop), warnings, error


# Checks, criteria and the choice of a method take longer than the transforms of a small field: they are done once for
# each set of plain arguments. Errors are not kept.
_cached_plan = functools.lru_cache(maxsize=256, typed=True)(_plan)
_cached_request = functools.lru_cache(maxsize=256, typed=True)(Request)
_PLAIN = frozenset((int, float, complex, bool, str, tuple, type(None)))
_NUMBERS = frozenset((int, float, bool))


def _plain_pair(value):
    """Return a short list or tuple of plain numbers as a tuple, which can be looked up; anything else as it is."""
    if type(value) in (list, tuple) and len(value) <= 4 and _NUMBERS.issuperset(map(type, value)):
        return tuple(value)
    return list(value) if type(value) is tuple else value


def propagate_within_window(
    field: Array,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
    propagation_type: str,
    cutoff: float | None = None,
    pixel_fill: float | None = None,
) -> Array:
    """Return a field propagated to its own window, without wrap-around where the method has a transfer function.

    Parameters
    ----------
    field : array
        Complex ``[..., rows, columns]``.
    distance : float or array
        Distance in metres.
    dx : float, pair of float or array
        Pitch of the field in metres.
    wavelength : float or array
        Wavelength in metres.
    propagation_type : str
        Propagation type, see :func:`propagate_beam`, or "auto".
    cutoff : float, optional
        Radius of a round stop in the Fourier plane in cycles per metre; open by default.
    pixel_fill : float, optional
        Share of a square pixel's area that emits; point samples by default.

    Returns
    -------
    array
        Complex ``[..., rows, columns]``.
    """
    shape = tuple(field.shape[-2:])
    name = linear_method(propagation_type, shape, dx, wavelength, distance)
    if name not in WITH_TRANSFER_FUNCTION:
        if cutoff is not None or pixel_fill is not None:
            raise ValueError(f"propagation_type must have a transfer function for an iris or pixels, got {name!r}")
        padded = (True, False, True)
        return propagate_beam(field, None, distance, dx, wavelength, name, zero_padding=padded)
    build = linear_kernel_of(name, cutoff, pixel_fill)
    size = (2 * shape[0], 2 * shape[1])
    lengths: tuple[Any, ...] = (_plain_pair(dx), wavelength, distance)
    request = (_cached_request if _PLAIN.issuperset(map(type, lengths)) else Request)(*lengths)
    # A kernel that is kept is computed from numbers, which a graph of torch.compile does not know.
    result = convolve(field, _array.outside_graphs(Request.kernel_for, request, field, build, size))
    note_loss(name, field, result)
    return result


@_validate.takes_units("distance", "dx", "wavelength")
def angular_spectrum(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
    zero_padding: bool = False,
    aperture: float | Array = 1.0,
) -> Array:
    """Propagate by the angular spectrum of plane waves, exact for scalar fields (Goodman 2005, section 3.10).

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; a real one is taken as a field of phase zero.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.
    zero_padding : bool, default: False
        Pad the spectrum to twice its size, which halves the pitch of the result.
    aperture : float or array, default: 1.0
        Centred mask that multiplies the spectrum, of the propagated size.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]`` after `distance`, complex64 from 32-bit input and complex128 from 64-bit.

    Examples
    --------
    A Gaussian beam follows its closed form:

    >>> from odak.wave import angular_spectrum, gaussian_beam
    >>> beam = gaussian_beam((64, 64), 2e-6, 532e-9, 20e-6)
    >>> further = angular_spectrum(beam, None, 1e-3, 2e-6, 532e-9)
    >>> expected = gaussian_beam((64, 64), 2e-6, 532e-9, 20e-6, distance=1e-3)
    >>> bool(abs(further - expected).max() < 1e-3 * abs(expected).max())
    True
    """
    return propagate_beam(
        field, k, distance, dx, wavelength, "Angular Spectrum", zero_padding=zero_padding, aperture=aperture
    )


@_validate.takes_units("distance", "dx", "wavelength")
def band_limited_angular_spectrum(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
    zero_padding: bool = False,
    aperture: float | Array = 1.0,
) -> Array:
    """Propagate by the angular spectrum inside its alias-free band (Matsushima and Shimobaba 2009).

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; a real one is taken as a field of phase zero.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.
    zero_padding : bool, default: False
        Pad the spectrum to twice its size, which halves the pitch of the result.
    aperture : float or array, default: 1.0
        Centred mask that multiplies the spectrum, of the propagated size.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]`` after `distance`, complex64 from 32-bit input and complex128 from 64-bit.

    Examples
    --------
    A Gaussian beam follows its closed form:

    >>> from odak.wave import band_limited_angular_spectrum, gaussian_beam
    >>> beam = gaussian_beam((64, 64), 2e-6, 532e-9, 20e-6)
    >>> further = band_limited_angular_spectrum(beam, None, 1e-3, 2e-6, 532e-9)
    >>> expected = gaussian_beam((64, 64), 2e-6, 532e-9, 20e-6, distance=1e-3)
    >>> bool(abs(further - expected).max() < 1e-3 * abs(expected).max())
    True
    """
    return propagate_beam(
        field, k, distance, dx, wavelength, "Bandlimited Angular Spectrum", zero_padding=zero_padding, aperture=aperture
    )


@_validate.takes_units("distance", "dx", "wavelength")
def incoherent_angular_spectrum(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
    zero_padding: bool = False,
    aperture: float | Array = 1.0,
) -> Array:
    """Propagate an intensity by the incoherent transfer function, the autocorrelation of the coherent one.

    Parameters
    ----------
    field : array
        Real intensity ``[..., rows, columns]``.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.
    zero_padding : bool, default: False
        Pad the spectrum to twice its size, which halves the pitch of the result.
    aperture : float or array, default: 1.0
        Pupil of the coherent field, centred, of the propagated size. A number has no effect.

    Returns
    -------
    array
        Real intensity ``[..., rows, columns]`` after `distance`, of the same sum.

    Examples
    --------
    The total intensity is conserved:

    >>> import numpy as np
    >>> from odak.wave import incoherent_angular_spectrum
    >>> image = np.zeros((16, 16), dtype=np.float64)
    >>> image[8, 8] = 3
    >>> round(float(incoherent_angular_spectrum(image, None, 1e-3, 8e-6, 532e-9).sum()), 9)
    3.0
    """
    return propagate_beam(
        field, k, distance, dx, wavelength, "Incoherent Angular Spectrum", zero_padding=zero_padding, aperture=aperture
    )


@_validate.takes_units("distance", "dx", "wavelength")
def transfer_function_fresnel(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
    zero_padding: bool = False,
    aperture: float | Array = 1.0,
) -> Array:
    """Propagate by the Fresnel transfer function exp(ikz)·exp(−iπλz·f²) (Voelz 2011, eq. 4.20).

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; a real one is taken as a field of phase zero.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.
    zero_padding : bool, default: False
        Pad the spectrum to twice its size, which halves the pitch of the result.
    aperture : float or array, default: 1.0
        Centred mask that multiplies the spectrum, of the propagated size.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]`` after `distance`, complex64 from 32-bit input and complex128 from 64-bit.

    Examples
    --------
    A Gaussian beam follows its closed form:

    >>> from odak.wave import transfer_function_fresnel, gaussian_beam
    >>> beam = gaussian_beam((64, 64), 2e-6, 532e-9, 20e-6)
    >>> further = transfer_function_fresnel(beam, None, 1e-3, 2e-6, 532e-9)
    >>> expected = gaussian_beam((64, 64), 2e-6, 532e-9, 20e-6, distance=1e-3)
    >>> bool(abs(further - expected).max() < 1e-3 * abs(expected).max())
    True
    """
    return propagate_beam(
        field, k, distance, dx, wavelength, "Transfer Function Fresnel", zero_padding=zero_padding, aperture=aperture
    )


@_validate.takes_units("distance", "dx", "wavelength")
def impulse_response_fresnel(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
    zero_padding: bool = False,
    aperture: float | Array = 1.0,
    scale: int = 1,
    samples: Sequence[int] = (1, 1, 1, 1),
) -> Array:
    """Propagate by the sampled Fresnel impulse response (Voelz 2011, eq. 4.21).

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; a real one is taken as a field of phase zero.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.
    zero_padding : bool, default: False
        Pad the spectrum to twice its size, which halves the pitch of the result.
    aperture : float or array, default: 1.0
        Centred mask that multiplies the spectrum, of the propagated size.
    scale : int, default: 1
        Samples per pixel and axis: the result is `scale` times as large.
    samples : sequence of int, default: (1, 1, 1, 1)
        Points across the source pixel (rows, columns) and the target sample (rows, columns) over which the response is
        averaged.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]`` after `distance`, complex64 from 32-bit input and complex128 from 64-bit.

    Examples
    --------
    A Gaussian beam follows its closed form:

    >>> from odak.wave import gaussian_beam, impulse_response_fresnel
    >>> beam = gaussian_beam((64, 64), 8e-6, 532e-9, 60e-6)
    >>> further = impulse_response_fresnel(beam, None, 0.01, 8e-6, 532e-9, samples=(1, 1, 1, 1))
    >>> expected = gaussian_beam((64, 64), 8e-6, 532e-9, 60e-6, distance=0.01)
    >>> bool(abs(further - expected).max() < 0.05 * abs(expected).max())
    True
    """
    return propagate_beam(
        field,
        k,
        distance,
        dx,
        wavelength,
        "Impulse Response Fresnel",
        zero_padding=zero_padding,
        aperture=aperture,
        scale=scale,
        samples=samples,
    )


# The impulse response of free space separates into x and y, and is always computed that way.
seperable_impulse_response_fresnel = impulse_response_fresnel


def custom(field: Array, kernel: Array | None, zero_padding: bool = False, aperture: float | Array = 1.0) -> Array:
    """Filter a field by a centred transfer function of its own size.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``.
    kernel : array or None
        Transfer function ``[..., rows, columns]``, zero frequency at index n // 2; None means ones.
    zero_padding : bool
        Pad the spectrum, for half the output pitch.
    aperture : float or array
        Centred mask that multiplies the spectrum (once).

    Returns
    -------
    array
        Filtered field.

    Examples
    --------
    The transfer function 1 leaves a field as it is:

    >>> import numpy as np
    >>> from odak.wave import custom
    >>> field = np.exp(1j * np.linspace(0, 1, 64)).reshape((8, 8))
    >>> bool(abs(custom(field, np.ones((8, 8), dtype=np.complex128)) - field).max() < 1e-12)
    True
    """
    return propagate_beam(field, propagation_type="custom", kernel=kernel, zero_padding=zero_padding, aperture=aperture)


@_validate.takes_units("distance", "dx", "wavelength")
def band_extended_angular_spectrum(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
) -> Array:
    """Propagate by the angular spectrum on frequencies spread over the alias-free band alone.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; a real one is taken as a field of phase zero.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]`` after `distance`, complex64 from 32-bit input and complex128 from 64-bit.

    Notes
    -----
    Frequencies are sampled uniformly over the band in which the transfer function is free of aliasing, by chirp-z
    transforms (Zhang, Zhang and Jin, Opt. Lett. 45, 1543 (2020)).

    Examples
    --------
    A Gaussian beam follows its closed form at four times the critical distance:

    >>> from odak.wave import band_extended_angular_spectrum, gaussian_beam
    >>> beam = gaussian_beam((64, 64), 2e-6, 532e-9, 20e-6)
    >>> further = band_extended_angular_spectrum(beam, None, 2e-3, 2e-6, 532e-9)
    >>> expected = gaussian_beam((64, 64), 2e-6, 532e-9, 20e-6, distance=2e-3)
    >>> bool(abs(further - expected).max() < 1e-3 * abs(expected).max())
    True
    """
    return propagate_beam(field, k, distance, dx, wavelength, "Bandextended Angular Spectrum")


@_validate.takes_units("distance", "dx", "wavelength")
def adaptive_sampling_angular_spectrum(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
) -> Array:
    """Propagate by the angular spectrum with twice as many frequencies, confined to the alias-free band far away.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; a real one is taken as a field of phase zero.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]`` after `distance`, complex64 from 32-bit input and complex128 from 64-bit.

    Notes
    -----
    From twice the critical distance N·dx²/λ on, the frequencies are spread over the alias-free band alone (Zhang, Zhang
    and Jin, Opt. Lett. 45, 4416 (2020)).

    Examples
    --------
    A Gaussian beam follows its closed form:

    >>> from odak.wave import adaptive_sampling_angular_spectrum, gaussian_beam
    >>> beam = gaussian_beam((64, 64), 2e-6, 532e-9, 20e-6)
    >>> further = adaptive_sampling_angular_spectrum(beam, None, 1e-3, 2e-6, 532e-9)
    >>> expected = gaussian_beam((64, 64), 2e-6, 532e-9, 20e-6, distance=1e-3)
    >>> bool(abs(further - expected).max() < 1e-3 * abs(expected).max())
    True
    """
    return propagate_beam(field, k, distance, dx, wavelength, "Adaptive Sampling Angular Spectrum")


@_validate.takes_units("distance", "dx", "wavelength")
def rayleigh_sommerfeld(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
) -> Array:
    """Propagate by the first Rayleigh–Sommerfeld integral, as a linear convolution with its sampled kernel.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; a real one is taken as a field of phase zero.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]`` after `distance`, complex64 from 32-bit input and complex128 from 64-bit.

    Notes
    -----
    The kernel is z/(2πr²)·(1/r − ik)·exp(ikr) (Goodman 2005, eq. 3-40), on twice the grid (Shen and Wang 2006), so that
    nothing wraps around.

    Examples
    --------
    A point source becomes the kernel, of modulus z/(λr²)·dx² at a distance r of many wavelengths:

    >>> import numpy as np
    >>> from odak.wave import rayleigh_sommerfeld
    >>> point = np.zeros((32, 32), dtype=np.complex128)
    >>> point[16, 16] = 1
    >>> axis = rayleigh_sommerfeld(point, None, 1e-3, 1e-6, 500e-9)[16, 16]
    >>> round(float(abs(axis)) * 500e-9 * 1e-3 / 1e-6**2, 6)
    1.0
    """
    return propagate_beam(field, k, distance, dx, wavelength, "Rayleigh-Sommerfeld")


@_validate.takes_units("distance", "dx", "wavelength")
def rayleigh_sommerfeld_sum(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
) -> Array:
    """Propagate by the first Rayleigh–Sommerfeld integral as a direct double sum, formed in double precision.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; a real one is taken as a field of phase zero.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]`` after `distance`, complex64 from 32-bit input and complex128 from 64-bit.

    Notes
    -----
    A reference for small fields: memory grows with the square of the number of pixels, 64 × 64 takes 270 MB.

    Examples
    --------
    It agrees with the convolution of :func:`rayleigh_sommerfeld`:

    >>> import numpy as np
    >>> from odak.wave import rayleigh_sommerfeld, rayleigh_sommerfeld_sum
    >>> field = np.ones((8, 8), dtype=np.complex128)
    >>> exact = rayleigh_sommerfeld_sum(field, None, 1e-4, 1e-6, 532e-9)
    >>> bool(abs(exact - rayleigh_sommerfeld(field, None, 1e-4, 1e-6, 532e-9)).max() < 1e-12)
    True
    """
    field = _validate.image("field", field)
    check_geometry(k, distance, dx, wavelength)
    xp = _array.namespace(field)
    rows, columns = field.shape[-2:]
    y, x = (xp.arange(n, dtype=xp.float64, device=_array.device_of(field)) for n in (rows, columns))

    def of_each_field(value):
        return _array.cast(value, y)[..., None, None, None, None]

    # Axes of the kernels: rows and columns of the target, then of the source.
    dy, dx = map(of_each_field, pitches(dx))
    down, across = y[:, None, None, None] - y[:, None], x[:, None, None] - x
    response = rayleigh_sommerfeld_response(
        of_each_field(distance), (down * dy) ** 2 + (across * dx) ** 2, of_each_field(wavelength)
    )
    kernel = xp.reshape(response * (dy * dx), (*response.shape[:-4], rows * columns, rows * columns))
    source = xp.reshape(xp.astype(field, xp.complex128), (*field.shape[:-2], rows * columns, 1))
    result = xp.matmul(kernel, source)
    return xp.astype(xp.reshape(result, (*result.shape[:-2], rows, columns)), _array.complex_dtype(field))


@_validate.takes_units("distance", "dx", "wavelength")
def fraunhofer(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
) -> Array:
    """Propagate to the far field: exp(ikz)/(iλz)·exp(ikr²/(2z))·F{u}·dx² (Goodman 2005, eq. 4-25).

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; a real one is taken as a field of phase zero.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back.
    dx : float, pair of float or array
        Pixel pitch in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]``; its pitch is λ·|z|/(N·dx) along an axis of N samples.

    Examples
    --------
    On the axis the modulus is the area of the aperture over λz:

    >>> import numpy as np
    >>> from odak.wave import fraunhofer
    >>> square = np.ones((16, 16), dtype=np.complex128)
    >>> axis = fraunhofer(square, None, 2.0, 8e-6, 500e-9)[8, 8]
    >>> round(float(abs(axis)) * 500e-9 * 2.0 / (16 * 8e-6) ** 2, 9)
    1.0
    """
    return propagate_beam(field, k, distance, dx, wavelength, "Fraunhofer")


@_validate.takes_units("distance", "dx", "wavelength")
def fraunhofer_inverse(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    wavelength: float | Array,
) -> Array:
    """Return the field of which a :func:`fraunhofer` pattern is given.

    Parameters
    ----------
    field : array
        Fraunhofer pattern, complex ``[..., rows, columns]``; a real one is taken as a field of phase zero.
    k : float or None
        Wave number 2π/wavelength in rad/m, or None; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Distance in metres over which the pattern was propagated.
    dx : float, pair of float or array
        Pixel pitch of the field returned in metres: one number, or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array holds one for each field of the leading axes.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]`` with the pitch `dx`.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import fraunhofer, fraunhofer_inverse
    >>> field = np.exp(1j * np.linspace(0, 1, 64)).reshape((8, 8))
    >>> pattern = fraunhofer(field, None, 2.0, 8e-6, 500e-9)
    >>> bool(abs(fraunhofer_inverse(pattern, None, 2.0, 8e-6, 500e-9) - field).max() < 1e-12)
    True
    """
    return propagate_beam(field, k, distance, dx, wavelength, "Fraunhofer Inverse")


@_validate.takes_units("distance", "dx", "wavelength")
def fraunhofer_equal_size_adjust(
    field: Array, distance: float, dx: float | Sequence[float], wavelength: float
) -> Array:
    """Return the centre of a Fraunhofer pattern that spans the same width as the field it came from.

    Parameters
    ----------
    field : array
        Fraunhofer pattern ``[..., rows, columns]``.
    distance : float
        Distance in metres that was given to :func:`fraunhofer`.
    dx : float or sequence of float
        Pixel pitch in metres of the field that was given to :func:`fraunhofer`, one number or a pair (rows, columns).
    wavelength : float
        Wavelength in metres.

    Returns
    -------
    array
        The centre int(m·N) samples of each axis, m = N·dx²/(λ·z) being the ratio of the two widths.

    Raises
    ------
    ValueError
        If the pattern spans less than the field (m > 1), so that there is nothing to cut.

    Examples
    --------
    At N·dx²·2/λ the pattern is twice as wide as the field, so that the centre half of it is returned:

    >>> import numpy as np
    >>> from odak.wave import fraunhofer_equal_size_adjust
    >>> tuple(fraunhofer_equal_size_adjust(np.ones((64, 64)), 16.384e-3, 8e-6, 500e-9).shape)
    (32, 32)
    """
    field = _validate.image("field", field)
    check_geometry(None, distance, dx, wavelength)
    _validate.number("distance", _validate.real("distance", distance, nonzero=True))
    for name, value in (("wavelength", wavelength), *(("dx", pitch) for pitch in pitches(dx))):
        _validate.number(name, value)
    sizes = [
        int(n * pitch**2 / (wavelength * abs(distance)) * n)
        for n, pitch in zip(field.shape[-2:], pitches(dx), strict=True)
    ]
    for n, size in zip(field.shape[-2:], sizes, strict=True):
        if not 1 <= size <= n:
            raise ValueError(
                f"distance must let the field's width span 1 to {n} samples of the pattern, {distance!r} gives {size}"
            )
    return crop_center(field, sizes)


def _checked_aperture(aperture):
    """Return a checked aperture; an array of one number without derivatives is that number."""
    if _array.is_array(aperture):
        _validate.array("aperture", aperture)
        if aperture.ndim or not _array.is_readable(aperture) or getattr(aperture, "requires_grad", False):
            return aperture
        aperture = complex(aperture)
    if not isinstance(aperture, Number):
        raise TypeError(f"aperture must be a number or an array, got {type(aperture).__name__}")
    if not abs(aperture) < math.inf:
        raise ValueError(f"aperture must be finite, got {aperture!r}")
    return aperture


def _check_method(method, request: Request) -> None:
    if isinstance(request.kernel, (list, tuple)):
        raise TypeError(
            f"kernel must be an array, for propagation_type 'custom'; zero_padding={request.kernel!r} pads and crops"
        )
    if request.kernel is not None and not method.takes_kernel:
        raise ValueError(f"kernel is for propagation_type 'custom' only, got it with {method.name!r}")
    kernelless = request.kernel is None and method.takes_kernel
    if kernelless and _array.is_readable(request.distance) and any(_validate.numbers(request.distance)):
        warn(f"{method.name!r} without a kernel ignores the distance: light stays where it is", ArgumentWarning)
    if request.scale != 1 and not method.scalable:
        raise ValueError(f"scale is for the impulse-response methods only, got {request.scale} with {method.name!r}")
    if not method.windowed and (_array.is_array(request.aperture) or request.aperture != 1):
        raise ValueError(
            f"aperture needs a method with a transfer function on the field's grid, got it with {method.name!r}"
        )
    if method.needs_distance and _array.is_readable(request.distance) and 0 in _validate.numbers(request.distance):
        raise ValueError(f"distance must not be zero for {method.name!r}")


def padding_flags(zero_padding: Any) -> tuple[bool, bool, bool]:
    """Return the three padding flags (input, spectrum, crop); one bool stands for the spectrum's alone."""
    listed = isinstance(zero_padding, Iterable) and not isinstance(zero_padding, str)
    flags = tuple(zero_padding) if listed else (False, zero_padding, False)
    if len(flags) != 3:
        raise ValueError(f"zero_padding must be three booleans [pad, pad spectrum, crop], got {zero_padding!r}")
    pad, fine, crop = (_validate.flag("zero_padding", flag) for flag in flags)
    return pad, fine, crop


@_validate.takes_units("dx", "wavelength", "distance")
def get_propagation_kernel(
    nu: int,
    nv: int,
    dx: float | Sequence[float] = 8e-6,
    wavelength: float = 515e-9,
    distance: float = 0.0,
    propagation_type: str = "Bandlimited Angular Spectrum",
    scale: int = 1,
    samples: Sequence[int] = (1, 1, 1, 1),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return the centred transfer function of a method.

    Parameters
    ----------
    nu : int
        Rows of the field.
    nv : int
        Columns of the field.
    dx : float or pair of float, default: 8e-6
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float or array, default: 515e-9
        Wavelength in metres; an array gives a kernel for each of its values, as leading axes.
    distance : float or array, default: 0.0
        Propagation distance in metres; an array gives a kernel for each of its values, as leading axes.
    propagation_type : str, default: "Bandlimited Angular Spectrum"
        A method that has a transfer function.
    scale : int, default: 1
        Samples per pixel, for the impulse-response methods; 1 for the others.
    samples : sequence of int, default: (1, 1, 1, 1)
        Aperture samples of the impulse-response methods, see :func:`odak.wave.propagate_beam`.
    xp : module, optional
        Array namespace of the result; by default the library of the lengths, else NumPy.
    device : optional
        Device of the result.
    dtype : optional
        Complex dtype of the result, complex64 by default.

    Returns
    -------
    array
        ``[..., nu·scale, nv·scale]``, zero frequency at index n // 2; differentiable in the lengths.

    Raises
    ------
    ValueError
        If the method has no transfer function, or an argument is outside its range.

    Examples
    --------
    Free space delays a plane wave along the axis by 2πz/λ, here by a quarter of a cycle:

    >>> import numpy as np
    >>> from odak.wave import get_propagation_kernel
    >>> kernel = get_propagation_kernel(8, 8, 8e-6, 500e-9, 1.25e-7, "Angular Spectrum", dtype=np.complex128)
    >>> complex(np.round(kernel[4, 4], 6))
    1j
    """
    method = find_method(propagation_type)
    if method is None or method.kernel is None:
        names = ", ".join(repr(m.name) for m in METHODS if m.kernel)
        raise ValueError(
            f"propagation_type must be a method with a transfer function ({names}), got {propagation_type!r}"
        )
    _validate.real("distance", distance)
    if method.needs_distance and 0 in _validate.numbers(distance):
        raise ValueError(f"distance must not be zero for {method.name!r}")
    scale = _validate.integer("scale", scale, minimum=1)
    scale = scale if method.scalable else 1
    grid = make_grid(nu, nv, dx, wavelength, distance, scale, samples, xp=xp, device=device, dtype=dtype)
    return grid.xp.fft.fftshift(method.kernel(grid), axes=(-2, -1))
