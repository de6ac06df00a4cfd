"""The one way in to every propagation method: checks, padding, the method, cropping."""

from collections.abc import Sequence
from dataclasses import replace
from numbers import Number

from odak import _array, _validate
from odak.tools.matrix import crop_center, zero_pad
from odak.wave.methods import DISTANCE_NEEDED, choose_method, find_method, warn_outside_range
from odak.wave.request import Request
from odak.wave.spectral import upsample


def propagate(
    field,
    k,
    distance,
    dx,
    wavelength,
    propagation_type: str,
    *,
    kernel=None,
    zero_padding: Sequence[bool] = (False, False, False),
    aperture=1.0,
    scale: int = 1,
    samples: Sequence[int] = (1, 1, 1, 1),
):
    """Propagate a field; see :func:`odak.wave.propagate_beam` for the arguments."""
    field = _array.to_complex(_validate.image("field", field))
    check_geometry(k, distance, dx, wavelength)
    if not isinstance(aperture, Number) and not _array.is_array(aperture):
        raise TypeError(f"aperture must be a number or an array, got {type(aperture).__name__}")
    pad, fine, crop = padding_flags(zero_padding)
    request = Request(
        dx, wavelength, distance, aperture, kernel, _validate.integer("scale", scale, minimum=1), sample_counts(samples)
    )
    shape = tuple(field.shape[-2:])
    method = find_method(propagation_type) or choose_method(shape, request, pad)
    _check_method(method, request)
    warn_outside_range(method, shape, request, pad)
    window = method.windowed and pad and crop and not fine
    if pad and not window:
        field = zero_pad(field)
    result = method.apply(field, replace(request, window=window))
    if fine and method.name not in ("Fraunhofer", "Fraunhofer Inverse"):
        result = upsample(_array.to_complex(result))
    return crop_center(result) if crop and not window else result


def check_geometry(k, distance, dx, wavelength) -> None:
    """Raise ValueError or TypeError unless the geometry is physical and k agrees with the wavelength."""
    _validate.real("distance", distance)
    _validate.real("dx", dx, positive=True)
    _validate.real("wavelength", wavelength, positive=True)
    if k is None or not (_array.is_readable(k) and _array.is_readable(wavelength)):
        return
    for number, length in zip(_validate.numbers(k), _validate.numbers(wavelength), strict=False):
        expected = 2 * _array.numpy_namespace.pi / length
        if not abs(number - expected) <= 1e-6 * expected:
            raise ValueError(
                f"k must be 2π/wavelength = {expected:.9g} for wavelength {length!r}, or None; got {number!r}"
            )


def _check_method(method, request: Request) -> None:
    if request.kernel is not None and method.name != "custom":
        raise ValueError(f"kernel is for propagation_type 'custom' only, got it with {method.name!r}")
    if request.scale != 1 and "Impulse Response" not in method.name:
        raise ValueError(f"scale is for the impulse-response methods only, got {request.scale} with {method.name!r}")
    if not method.windowed and (_array.is_array(request.aperture) or request.aperture != 1):
        raise ValueError(
            f"aperture needs a method with a transfer function on the field's grid, got it with {method.name!r}"
        )
    several = not isinstance(request.distance, (int, float))
    needed = method.name in DISTANCE_NEEDED or (method.name == "Rayleigh-Sommerfeld" and several)
    if needed and _array.is_readable(request.distance) and 0 in _validate.numbers(request.distance):
        raise ValueError(f"distance must not be zero for {method.name!r}")


def padding_flags(zero_padding) -> tuple[bool, bool, bool]:
    """Return the three padding flags (input, spectrum, crop); one bool stands for the spectrum's alone."""
    flags = (False, zero_padding, False) if isinstance(zero_padding, bool) else tuple(zero_padding)
    if len(flags) != 3:
        raise ValueError(f"zero_padding must be three booleans [pad, pad spectrum, crop], got {zero_padding!r}")
    return tuple(bool(flag) for flag in flags)


def sample_counts(samples) -> tuple[int, int, int, int]:
    """Return the four sample counts of an impulse response as integers."""
    counts = tuple(_validate.integer("samples", int(count), minimum=1) for count in samples)
    if len(counts) != 4:
        raise ValueError(f"samples must be four counts [source rows, columns, target rows, columns], got {samples!r}")
    return counts
