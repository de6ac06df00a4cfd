"""Retinal image of a field, for a given pupil, position, focus, rotation and aberrations of the eye."""

import math
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

from odak import _array, _validate
from odak._array import Amount, Array
from odak._warnings import SamplingWarning, warn
from odak.wave.elements import zernike_modes
from odak.wave.fourier import with_last
from odak.wave.transfer_functions import pitches

_AXES = (-2, -1)
# From the centre of rotation to the entrance pupil, which is 3 mm behind the cornea: 13.5 mm to the cornea lies between
# the 14.7 mm of horizontal and the 12.0 mm of vertical rotations of emmetropes in Fry and Hill, Am. J. Optom. 39, 581
# (1962) and 40, 707 (1963).
ROTATION_RADIUS = 10.5e-3


@_validate.takes_units(
    "dx", "wavelength", "distance", "pupil_position", "pupil_diameter", "focus", degrees=("rotation",)
)
def eye_image(
    field: Array,
    dx: float | Sequence[float],
    wavelength: float | Array,
    distance: float | Array,
    pupil_position: Sequence[float] | Array = (0.0, 0.0),
    pupil_diameter: float | Array = 4e-3,
    focus: float | Array | None = None,
    rotation: Sequence[float | Array] | Array = (0.0, 0.0),
    aberrations: Mapping[Any, Any] | None = None,
) -> Array:
    """Return the retinal field of an eye that looks at a field, on the samples of the latter.

    Light propagates to the plane of the pupil, passes the pupil and a thin lens, and forms an image on the retina. The
    image is given where it seems to be: a sample is the direction from the middle of the pupil's plane to that sample
    of the field, so that magnification and inversion are left out. With an open pupil, focused on the field, the image
    is the field itself. Paraxial (Fresnel).

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]`` of the modulator, or of its image by an eyepiece.
    dx : float or sequence of float
        Its pitch in metres, one number or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres.
    distance : float or array
        Distance from the field to the pupil in metres. The light of pixels reaches a box of wavelength·distance/dx
        there.
    pupil_position : sequence of float or array
        Middle of the pupil (y, x) in metres; ``[K, 2]`` for K eyes.
    pupil_diameter : float or array
        Diameter of the pupil in metres; ``[K]`` for K eyes.
    focus : float or array, optional
        Distance in metres on which the eye is focused, infinity included; by default the distance of the field. ``[K]``
        for K eyes.
    rotation : sequence of float or array
        Angles in degrees (rows, columns) by which the eye is rotated about its centre of rotation, 10.5 mm behind the
        pupil. The pupil moves to the side and back, and appears narrower.
    aberrations : mapping, optional
        Zernike coefficients ``{(n, m): c}`` of the eye's wavefront, c in radians RMS over the pupil.

    Returns
    -------
    array
        Complex ``[..., rows, columns]``; ``[..., K, rows, columns]`` with K eyes. The intensity keeps the power that
        passes the pupil. Differentiable in the field and in every number given as a tensor, `dx` excepted.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    SamplingWarning
        If the pupil receives light beyond the box that the pixels of the field determine, or lies partly outside this
        box, or the blur of the focus is wider than the field.

    Notes
    -----
    Goodman, Introduction to Fourier Optics (2005), sections 4.2 and 5.3. With K eyes the transform to the pupil is
    shared.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import eye_image
    >>> field = np.exp(1j * np.random.default_rng(0).uniform(0, 6, (32, 32)))
    >>> seen = eye_image(field, 8e-6, 532e-9, 0.1, [[0.0, 0.0], [0.0, 2e-3]], 1e-3)
    >>> seen.shape
    (2, 32, 32)
    >>> bool(np.allclose(eye_image(field, 8e-6, 532e-9, 0.1, pupil_diameter=1.0), field))
    True
    """
    field = _array.to_complex(_validate.image("field", field))
    transfer, lens = eye_transfer(
        field, dx, wavelength, distance, pupil_position, pupil_diameter, focus, rotation, aberrations
    )
    return retinal_field(field, transfer, lens)


def eye_transfer(
    like: Array,
    dx: Any,
    wavelength: Amount,
    distance: Amount,
    pupil_position: Any,
    pupil_diameter: Any,
    focus: Any,
    rotation: Any = (0.0, 0.0),
    aberrations: Any = None,
) -> tuple[Array, Array]:
    """Return the transfer function and the lens for :func:`retinal_field`, the same for all fields of a shape.

    Parameters
    ----------
    like : array
        Complex field ``[..., rows, columns]``, whose shape, library, device and precision matter.
    dx, wavelength, distance, pupil_position, pupil_diameter, focus, rotation, aberrations
        As in :func:`eye_image`.

    Returns
    -------
    tuple of array
        Transfer function of linear convolution, ``[..., 2·rows, 2·columns]`` in the order of the transform, and the
        lens that makes the spectrum of a field its Fresnel transform, ``[rows, columns]``.
    """
    xp, device, shape = _array.namespace(like), _array.device_of(like), tuple(like.shape[-2:])
    steps = [_validate.constant("dx", pitch, positive=True) for pitch in pitches(dx)]
    for name, value in (("wavelength", wavelength), ("distance", distance)):
        _validate.number(name, value, positive=True)
    _validate.real("pupil_diameter", pupil_diameter, positive=True)
    wavelength, distance, diameter = (
        _array.converted(value, xp, device, xp.float64) for value in (wavelength, distance, pupil_diameter)
    )
    if isinstance(pupil_position, (list, tuple)) and any(map(_array.is_array, pupil_position)):
        pupil_position = _array.stacked(pupil_position, xp, device, xp.float64)
    place = _validate.real("pupil_position", _validate.array("pupil_position", pupil_position))
    _validate.shaped("pupil_position", place, "[2] or [K, 2], not empty")
    place, focus = _array.converted(place, xp, device, xp.float64), _checked_focus(focus)
    eyes = tuple(place.shape[:-1])
    for name, value in (("pupil_diameter", diameter), ("focus", focus)):
        if getattr(value, "ndim", 0) and tuple(value.shape) != eyes:
            raise ValueError(f"{name} must be one number or one for each of the eyes {eyes}, got {tuple(value.shape)}")
    angles = [_validate.number("rotation", angle) for angle in _validate.several("rotation", rotation, 2)]
    known = [_validate.numbers(angle)[0] for angle in angles if not _array.is_array(angle) or _array.is_readable(angle)]
    if any(abs(angle) >= 90 for angle in known):
        raise ValueError(f"rotation must be within ±90 degrees, got {tuple(rotation)}")
    turns = [xp.reshape(_array.converted(angle, xp, device, xp.float64), ()) * (math.pi / 180) for angle in angles]
    squeeze = [xp.cos(turn) for turn in turns]
    away = distance + ROTATION_RADIUS * (1 - squeeze[0] * squeeze[1])
    _check_box(shape, steps, wavelength, away)
    # The response to a pupil with a rim is long: sampled finely, it does not wrap around.
    fine = [2 * n * (4 if n < 512 else 2) for n in shape]
    pitch = [wavelength * away / (n * step) for n, step in zip(fine, steps, strict=True)]
    radius = diameter[..., None, None] / 2
    from_middle = []
    _check_reach(place, turns, radius, squeeze, [p * n / 2 for p, n in zip(pitch, fine, strict=True)])
    for axis, n in enumerate(fine):
        along = xp.fft.fftfreq(n, d=1 / n, dtype=xp.float64, device=device) * pitch[axis]
        along = along - place[..., axis, None] - ROTATION_RADIUS * xp.sin(turns[axis])
        from_middle.append(along[..., :, None] if axis == 0 else along[..., None, :])
    down, across = (values / (narrow * radius) for values, narrow in zip(from_middle, squeeze, strict=True))
    pupil = covered(xp, down, across, [p / (s * radius) for p, s in zip(pitch, squeeze, strict=True)])
    cycles = 0 * pupil
    if focus is not None:
        # The curvature in 1/m that an eye focused at a distance lacks for a field at another.
        vergence = 1 / away - 1 / _array.converted(focus, xp, device, xp.float64)
        _check_blur(shape, steps, vergence, away, diameter)
        # About the middle of the pupil, so that directions from there are what stays in place.
        squared = from_middle[0] ** 2 + from_middle[1] ** 2
        cycles = cycles + vergence[..., None, None] / (2 * wavelength) * squared
    if aberrations is not None:
        _validate.instance("aberrations", aberrations, Mapping, "a mapping of (n, m) to radians")
        modes = zernike_modes(down + 0 * across, across + 0 * down, aberrations)
        for value, mode in zip(aberrations.values(), modes, strict=True):
            cycles = cycles + _array.converted(value, xp, device, xp.float64) * mode / (2 * math.pi)
    wave = _array.phasor_of_cycles(cycles, like.dtype) * xp.astype(pupil, like.dtype)
    response = xp.fft.ifftn(wave, axes=_AXES)
    lens = [_chirp(xp, n, step**2 / (2 * wavelength * away), like) for n, step in zip(shape, steps, strict=True)]
    return xp.fft.fftn(_short(xp, response, shape), axes=_AXES), lens[0][:, None] * lens[1]


def retinal_field(field: Array, transfer: Array, lens: Array) -> Array:
    """Return the field on the retina, ``[..., rows, columns]``, computed by the result of :func:`eye_transfer`.

    Parameters
    ----------
    field : array
        Complex ``[..., rows, columns]``.
    transfer : array
        ``[2·rows, 2·columns]``, or ``[K, 2·rows, 2·columns]`` for K eyes, an axis that the result has then too.
    lens : array
        ``[rows, columns]``, or ``[K, rows, columns]`` for K eyes that are turned by different angles.
    """
    xp = _array.namespace(field)
    rows, columns = field.shape[-2:]
    field = field[..., None, :, :] if lens.ndim > 2 else field
    spectrum = xp.fft.fftn(field * lens, s=(2 * rows, 2 * columns), axes=_AXES)
    spectrum = spectrum[..., None, :, :] if transfer.ndim > lens.ndim else spectrum
    return xp.fft.ifftn(spectrum * transfer, axes=_AXES)[..., :rows, :columns] * xp.conj(lens)


def _short(xp, response, shape):
    """Return a response without the lags that connect no two samples of a shape, on twice that shape."""
    for axis, n in zip(_AXES, shape, strict=True):
        along = with_last(response, axis)
        parts = [along[..., :n], 0 * along[..., :1], along[..., along.shape[-1] - n + 1 :]]
        response = with_last(xp.concat(parts, axis=-1), axis)
    return response


def _chirp(xp, n: int, bend, like):
    place = xp.arange(n, dtype=xp.float64, device=_array.device_of(like)) - n // 2
    return _array.phasor_of_cycles(bend * place**2, like.dtype)


def covered(xp: ModuleType, down: Any, across: Any, spacing: Any) -> Any:
    """Return the share of each sample, `spacing` (rows, columns) wide, that lies within the unit disc."""
    radius = xp.sqrt(down**2 + across**2 + 1e-30)
    along = xp.sqrt((down * spacing[0]) ** 2 + (across * spacing[1]) ** 2 + 1e-60) / radius
    return xp.clip((1 - radius) / along + 0.5, 0.0, 1.0)


def _checked_focus(focus):
    """Return distances of sharp vision after checking that they are positive; infinity is one of them."""
    if focus is None:
        return None
    focus = _validate.array("focus", focus)
    if "complex" in str(focus.dtype) or 0 in focus.shape:
        raise ValueError(f"focus must be real distances, got {tuple(focus.shape)} of {focus.dtype}")
    if _array.is_readable(focus) and not all(value > 0 for value in _validate.numbers(focus)):
        raise ValueError("focus must be positive distances, infinity included; got others")
    return focus


def _check_box(shape, steps, wavelength, distance) -> None:
    if not (_array.is_readable(wavelength) and _array.is_readable(distance)):
        return
    reach = _validate.numbers(wavelength)[0] * _validate.numbers(distance)[0]
    for n, step in zip(shape, steps, strict=True):
        if reach < n * step**2:
            warn(
                f"at {_validate.numbers(distance)[0]:.3g} m light from the rim of a field of {n * step:.3g} m leaves "
                f"the angles that its pixels determine: the pupil should be at least {n * step**2 / reach:.3g} times "
                "as far away",
                SamplingWarning,
            )


def _check_reach(place, turns, radius, squeeze, half) -> None:
    """Warn of pupils that light passes which the pixels of the field do not determine."""
    if not all(_array.is_readable(value) for value in (place, radius, *turns, *half)):
        return
    xp = _array.namespace(place)
    for axis in (0, 1):
        middle = place[..., axis] + ROTATION_RADIUS * xp.sin(turns[axis])
        farthest = max(_validate.numbers(abs(middle) + squeeze[axis] * radius[..., 0, 0]))
        ends = min(_validate.numbers(half[axis]))
        if min(_validate.numbers(squeeze[axis] * radius)) < ends < farthest:
            warn(
                f"a pupil reaches {farthest:.3g} m from the axis, where the light of the pixels ends at {ends:.3g} m; "
                "more distance or a smaller pitch widens it",
                SamplingWarning,
            )


def _check_blur(shape, steps, vergence, distance, diameter) -> None:
    if all(_array.is_readable(value) for value in (vergence, distance, diameter)):
        parts = [_validate.numbers(value) for value in (vergence, distance, diameter)]
        check_blur(max(map(abs, parts[0])) * max(parts[1]) * max(parts[2]), shape, steps)


def check_blur(blur: float, shape: Sequence[int], steps: Sequence[float]) -> None:
    """Warn where the blur of an eye that is focused elsewhere is wider than the field or the panel it looks at."""
    width = min(n * step for n, step in zip(shape, steps, strict=True))
    if blur > width:
        warn(f"the blur of the focus is {blur:.3g} m wide, more than the field of {width:.3g} m", SamplingWarning)
