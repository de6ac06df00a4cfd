"""The one way in to every propagation method: checks, padding, the method, cropping."""

import math
from collections.abc import Iterable, Sequence
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
    zero_padding: bool | Sequence[bool] = (False, False, False),
    aperture=1.0,
    scale: int = 1,
    samples: Sequence[int] = (1, 1, 1, 1),
):
    """Propagate a field; see :func:`odak.wave.propagate_beam` for the arguments."""
    # Kernels, and warnings already given, are looked up: no graph of torch.compile can hold that.
    return _array.outside_graphs(
        _propagate, field, k, distance, dx, wavelength, propagation_type, kernel, zero_padding, aperture, scale, samples
    )


def _propagate(field, k, distance, dx, wavelength, propagation_type, kernel, zero_padding, aperture, scale, samples):
    field = _array.to_complex(_validate.image("field", field))
    if 0 in field.shape:
        raise ValueError(f"field must hold at least one field, got the shape {tuple(field.shape)}")
    check_geometry(k, distance, dx, wavelength, tuple(field.shape[:-2]))
    _check_aperture(aperture)
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


def check_geometry(k, distance, dx, wavelength, batch: tuple[int, ...] = ()) -> None:
    """Raise ValueError or TypeError unless the geometry is physical, fits a batch of fields, and k the wavelength."""
    _validate.real("distance", distance)
    _validate.real("dx", dx, positive=True)
    _validate.real("wavelength", wavelength, positive=True)
    shapes = {name: _shape(value) for name, value in (("distance", distance), ("dx", dx), ("wavelength", wavelength))}
    for name, shape in shapes.items():
        if 0 in shape:
            raise ValueError(f"{name} must hold at least one number, got the shape {shape}")
    if any(shapes.values()):
        _validate.fitting(field=batch, **shapes)
    if k is None:
        return
    _validate.real("k", k)
    if not (_array.is_readable(k) and _array.is_readable(wavelength)):
        return
    numbers, lengths = _validate.numbers(k), _validate.numbers(wavelength)
    if len(numbers) != len(lengths) and 1 not in (len(numbers), len(lengths)):
        raise ValueError(f"k must be one number or one for each of {len(lengths)} wavelengths, got {len(numbers)}")
    count = max(len(numbers), len(lengths))
    for number, length in zip(*(v * count if len(v) == 1 else v for v in (numbers, lengths)), strict=True):
        expected = 2 * math.pi / length
        if not abs(number - expected) <= 1e-6 * expected:
            raise ValueError(
                f"k must be 2π/wavelength = {expected:.9g} for wavelength {length!r}, or None; got {number!r}"
            )


def _shape(value) -> tuple[int, ...]:
    return (len(value),) if isinstance(value, (list, tuple)) else tuple(getattr(value, "shape", ()))


def _check_aperture(aperture) -> None:
    plain = isinstance(aperture, Number)
    if _array.is_array(aperture):
        _validate.array("aperture", aperture)
    elif not plain:
        raise TypeError(f"aperture must be a number or an array, got {type(aperture).__name__}")
    elif not abs(aperture) < math.inf:
        raise ValueError(f"aperture must be finite, got {aperture!r}")


def _check_method(method, request: Request) -> None:
    if request.kernel is not None and method.name != "custom":
        raise ValueError(f"kernel is for propagation_type 'custom' only, got it with {method.name!r}")
    if request.scale != 1 and "Impulse Response" not in method.name:
        raise ValueError(f"scale is for the impulse-response methods only, got {request.scale} with {method.name!r}")
    if not method.windowed and (_array.is_array(request.aperture) or request.aperture != 1):
        raise ValueError(
            f"aperture needs a method with a transfer function on the field's grid, got it with {method.name!r}"
        )
    if (
        method.name in DISTANCE_NEEDED
        and _array.is_readable(request.distance)
        and 0 in _validate.numbers(request.distance)
    ):
        raise ValueError(f"distance must not be zero for {method.name!r}")


def padding_flags(zero_padding) -> tuple[bool, bool, bool]:
    """Return the three padding flags (input, spectrum, crop); one bool stands for the spectrum's alone."""
    listed = isinstance(zero_padding, Iterable) and not isinstance(zero_padding, str)
    flags = tuple(zero_padding) if listed else (False, zero_padding, False)
    if len(flags) != 3:
        raise ValueError(f"zero_padding must be three booleans [pad, pad spectrum, crop], got {zero_padding!r}")
    pad, fine, crop = (_validate.flag("zero_padding", flag) for flag in flags)
    return pad, fine, crop


def sample_counts(samples, name: str = "samples") -> tuple[int, int, int, int]:
    """Return the four sample counts of an impulse response as integers."""
    listed = isinstance(samples, Iterable) and not isinstance(samples, str)
    counts = tuple(samples) if listed else (samples,)
    if len(counts) != 4:
        raise ValueError(f"{name} must be four counts [source rows, columns, target rows, columns], got {samples!r}")
    a, b, c, d = (_validate.whole(name, count, minimum=1) for count in counts)
    return a, b, c, d
