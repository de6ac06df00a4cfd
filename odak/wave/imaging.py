"""Incoherent imaging: pupils, optical transfer functions, point spread functions, and scenes made of planes."""

import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Number
from types import ModuleType
from typing import Any

from odak import _array, _validate
from odak._array import Array, Device, DType, Numbers
from odak._warnings import SamplingWarning, warn
from odak.wave.elements import grid_positions, zernike_modes
from odak.wave.propagation import padding_flags, propagate_beam
from odak.wave.transfer_functions import autocorrelation, pitches

_AXES = (-2, -1)


@_validate.takes_units("dx", "wavelength")
def pupil_function(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float,
    numerical_aperture: float | Array,
    aberrations: Mapping[Any, Any] | None = None,
    obscuration: float | Array = 0.0,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return the pupil of a lens, on the frequencies of the image that it forms.

    :func:`point_spread_function` and :func:`optical_transfer_function` say what it does to an incoherent image, and
    :func:`propagate_beam` takes it as the aperture of "Incoherent Angular Spectrum".

    Parameters
    ----------
    shape : sequence of int
        Rows and columns of the image; with padding, of the padded image.
    dx : float or sequence of float
        Pixel pitch of the image in metres, one number or a pair (rows, columns).
    wavelength : float
        Wavelength in metres.
    numerical_aperture : float or array
        Sine of the largest angle between a ray to the image and the axis; the pupil's radius is NA/λ in cycles/m. An
        array is a batch.
    aberrations : mapping, optional
        Zernike coefficients ``{(n, m): c}`` of the wavefront, c in radians RMS over the pupil, numbers or arrays.
    obscuration : float or array
        Radius of a central obscuration relative to the pupil.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        Real dtype that gives the precision; by default the widest of the arrays given, else the library's default.

    Returns
    -------
    array
        Complex ``[..., rows, columns]``, zero frequency at index n // 2. Edge samples hold the part of the frequency
        that lies inside, so that the pupil is differentiable in its radius.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    SamplingWarning
        If the pupil reaches beyond the frequencies of the image, 1/(2·dx), which leave it incomplete.

    Examples
    --------
    >>> from odak.wave import point_spread_function, pupil_function
    >>> pupil = pupil_function((64, 64), 1e-6, 550e-9, 0.1, {(2, 0): 0.5})
    >>> strehl = point_spread_function(pupil).max() / point_spread_function(abs(pupil)).max()
    >>> round(float(strehl), 2)
    0.77
    """
    rows, columns = _validate.size("shape", shape)
    steps = [
        1 / (n * _validate.constant("dx", pitch, positive=True))
        for n, pitch in zip((rows, columns), pitches(dx), strict=True)
    ]
    wavelength = _validate.constant("wavelength", wavelength, positive=True)
    _validate.real("numerical_aperture", numerical_aperture, positive=True)
    _validate.real("obscuration", obscuration)
    if not _array.is_traced(obscuration) and not all(0 <= one <= 1 for one in _validate.numbers(obscuration)):
        raise ValueError(f"obscuration must be within 0 … 1, got {obscuration}")
    if not _array.is_traced(numerical_aperture):
        widest = max(_validate.numbers(numerical_aperture))
        whole = wavelength / 2 * min(n * step for n, step in zip((rows, columns), steps, strict=True))
        if widest > whole * (1 + 1e-9):
            warn(
                f"numerical_aperture of {widest:g} reaches beyond the frequencies of the image, which end at "
                f"{whole:.3g}: give a dx of at most {wavelength / (2 * widest):.3g} m",
                SamplingWarning,
            )
    aberrations = {} if aberrations is None else aberrations
    _validate.instance("aberrations", aberrations, Mapping, "a mapping of (n, m) to radians")
    values = (numerical_aperture, obscuration, *aberrations.values())
    xp, device, dtype = _array.placement(*values, xp=xp, device=device, dtype=dtype)
    aperture, inner = (
        _array.converted(value, xp, device, xp.float64)[..., None, None] for value in (numerical_aperture, obscuration)
    )
    _, (y, x) = grid_positions((rows, columns), steps, (0.0, 0.0), xp, device)
    radius = xp.sqrt(x**2 + y**2)
    centre = radius == 0
    # Distance between samples along the radius.
    spacing = xp.sqrt((y * steps[0]) ** 2 + (x * steps[1]) ** 2) / xp.where(centre, xp.ones_like(radius), radius)
    spacing = xp.where(centre, min(steps) * xp.ones_like(radius), spacing)
    outer = aperture / wavelength
    inside = xp.clip((outer - radius) / spacing + 0.5, 0.0, 1.0)
    inside = inside - xp.where(inner > 0, xp.clip((inner * outer - radius) / spacing + 0.5, 0.0, 1.0), 0 * inside)
    cycles = xp.zeros((rows, columns), dtype=xp.float64, device=device)
    modes = zernike_modes(y / outer, x / outer, aberrations)
    for value, polynomial in zip(aberrations.values(), modes, strict=True):
        value = _array.converted(value, xp, device, xp.float64)[..., None, None]
        cycles = cycles + value * polynomial / (2 * math.pi)
    wave = _array.phasor_of_cycles(cycles, xp.complex128 if dtype == xp.float64 else xp.complex64)
    return wave * xp.astype(inside, wave.dtype)


def optical_transfer_function(pupil: Array) -> Array:
    """Return the optical transfer function of a pupil: its autocorrelation, 1 at zero frequency.

    Parameters
    ----------
    pupil : array
        Pupil ``[..., rows, columns]`` on the frequencies of an image, such as :func:`pupil_function` gives; times a
        transfer function for an image out of focus. Zero frequency at index n // 2.

    Returns
    -------
    array
        Complex ``[..., rows, columns]``, zero frequency at index n // 2. Its modulus is the modulation transfer
        function.

    Raises
    ------
    ValueError, TypeError
        If the pupil is not an array of at least two axes.

    Notes
    -----
    Goodman, Introduction to Fourier Optics (2005), eq. 6-28. The transfer function reaches twice as far as the pupil;
    where that is beyond the highest frequency 1/(2·dx) of the image it folds back, as it does for every sampled image.
    Edge samples of :func:`pupil_function` hold parts of an amplitude, whose squares count here: with a pupil of a
    radius of r samples the transfer function deviates from the closed form of a clear disk by at most about 0.3/r.

    Examples
    --------
    >>> from odak.wave import optical_transfer_function, pupil_function
    >>> mtf = abs(optical_transfer_function(pupil_function((64, 64), 1e-6, 550e-9, 0.1)))
    >>> round(float(mtf[32, 32]), 12), bool(mtf.max() < 1 + 1e-12)
    (1.0, True)
    """
    pupil = _array.to_complex(_validate.image("pupil", pupil))
    xp = _array.namespace(pupil)
    return xp.fft.fftshift(autocorrelation(xp.fft.ifftshift(pupil, axes=_AXES)), axes=_AXES)


def modulation_transfer_function(pupil: Array) -> Array:
    """Return the modulation transfer function of a pupil, the modulus of its optical transfer function.

    Parameters
    ----------
    pupil : array
        Pupil ``[..., rows, columns]``, see :func:`optical_transfer_function`.

    Returns
    -------
    array
        Real ``[..., rows, columns]``, 1 at zero frequency, which is at index n // 2.

    Examples
    --------
    It vanishes beyond 2·NA/λ, the cut-off frequency:

    >>> from odak.wave import modulation_transfer_function, pupil_function
    >>> row = modulation_transfer_function(pupil_function((64, 64), 1e-6, 500e-9, 0.1))[32, 32:]
    >>> cut_off = 2 * 0.1 / 500e-9 * 64e-6
    >>> round(float(row[0]), 6), round(cut_off, 1), bool(row[27] < 1e-9)
    (1.0, 25.6, True)
    """
    transfer = optical_transfer_function(pupil)
    return _array.namespace(transfer).abs(transfer)


def point_spread_function(pupil: Array) -> Array:
    """Return the intensity in the image of a point: |F⁻¹{pupil}|², of sum 1.

    Parameters
    ----------
    pupil : array
        Pupil ``[..., rows, columns]``, see :func:`optical_transfer_function`.

    Returns
    -------
    array
        Real, not negative, ``[..., rows, columns]``, on the pixels of the image, the point at index n // 2.

    Examples
    --------
    The first dark ring of a circular pupil has the radius 0.61·λ/NA, here 6.1 pixels:

    >>> from odak.wave import point_spread_function, pupil_function
    >>> row = point_spread_function(pupil_function((128, 128), 1e-6, 500e-9, 0.05))[64, 64:74]
    >>> int(row.argmin())
    6
    """
    pupil = _array.to_complex(_validate.image("pupil", pupil))
    xp = _array.namespace(pupil)
    response = xp.fft.ifftn(xp.fft.ifftshift(pupil, axes=_AXES), axes=_AXES)
    intensity = xp.real(response) ** 2 + xp.imag(response) ** 2
    return xp.fft.fftshift(intensity / xp.sum(intensity, axis=_AXES, keepdims=True), axes=_AXES)


_METHOD = "Incoherent Angular Spectrum"


@_validate.takes_units("distances", "dx", "wavelengths")
def incoherent_focal_stack_rgbd(
    targets: Array,
    masks: Array,
    distances: Array,
    dx: float | Sequence[float],
    wavelengths: float | Numbers,
    zero_padding: Sequence[bool] = (True, False, True),
    apertures: float | Array = 1.0,
    alpha: float | Array = 0.5,
) -> Array:
    """Return the images of a scene of planes with the focus on each plane in turn.

    Each plane is blurred by the incoherent transfer function of its distance to the plane in focus, and covered by the
    planes in front of it, whose masks are blurred likewise.

    Parameters
    ----------
    targets : array
        Intensities of the planes ``[P, C, m, n]``, the plane furthest from the viewer first.
    masks : array
        What each plane covers, not negative, ``[P, m, n]`` or ``[P, C, m, n]``; each is divided by its maximum, which
        stands for an opaque pixel.
    distances : sequence of float or array
        Positions of the planes along the axis ``[P]`` in metres; or the P + 1 edges of slices, as
        :func:`odak.learn.perception.slice_rgbd_targets` takes them, where each plane stands at the first edge of its
        slice. Only their differences matter.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelengths : float, sequence of float or array
        Wavelength of each colour ``[C]``, metres.
    zero_padding : sequence of bool
        Pad planes to twice their size; pad spectra to twice their size; crop the centre half at the end.
    apertures : float, array or sequence of them
        Pupil of each colour, centred on the frequencies of the propagated grid, see :func:`pupil_function`; one stands
        for all. A number has no effect: transfer functions are 1 at zero frequency.
    alpha : float or array
        How much of the light from behind a fully covered pixel is held back: 0 (planes add up) … 1 (planes are opaque).

    Returns
    -------
    array
        Images ``[P, C, m, n]``, 0 … 1, the brightest sample of all being 1; in the library and precision of `targets`.
        Differentiable in targets, masks, alpha and the lengths.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    With I_k the blurred intensity of plane k and M_k its blurred mask (divided by its maximum before it is blurred),
    the image is Σ_k I_k·Π_{j>k} (1 − α·M_j), the "over" of Porter and Duff (SIGGRAPH 1984) for opacities α·M_j. The
    transfer function is Goodman's (Introduction to Fourier Optics, 2005, eq. 6-28).

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import incoherent_focal_stack_rgbd
    >>> masks = np.zeros((2, 16, 16))
    >>> masks[0, :, :8], masks[1, :, 8:] = 1, 1
    >>> targets = masks[:, None] * np.ones((2, 3, 1, 1))
    >>> stack = incoherent_focal_stack_rgbd(targets, masks, [0.0, 1e-3], 8e-6, [639e-9, 515e-9, 473e-9])
    >>> stack.shape, float(stack.max())
    ((2, 3, 16, 16), 1.0)
    """
    planes = _stacked(targets, masks)
    xp = _array.namespace(planes)
    count, _, colours = planes.shape[:3]
    _validate.real("distances", distances)
    distances = _lengths("distances", distances, count, count + 1)
    _validate.real("wavelengths", wavelengths, positive=True)
    wavelengths = wavelengths if isinstance(wavelengths, Number) else _lengths("wavelengths", wavelengths, colours)
    if _array.is_readable(_validate.real("alpha", alpha)) and not all(0 <= v <= 1 for v in _validate.numbers(alpha)):
        raise ValueError(f"alpha must be between 0 and 1, got {alpha!r}")
    alpha = _array.cast(alpha, planes)
    _validate.fitting(alpha=alpha, targets=planes[0, 0, ...])
    aperture = _per_colour(apertures, colours, planes, 2 if padding_flags(zero_padding)[0] else 1)

    def spread(plane, distance):
        return propagate_beam(
            plane, None, distance, dx, wavelengths, _METHOD, zero_padding=zero_padding, aperture=aperture
        )

    stack = xp.stack([_composed(planes, distances[n] - distances, spread, alpha) for n in range(count)])
    brightest = xp.max(stack)
    return stack / xp.where(brightest > 0, brightest, xp.ones_like(brightest))


def _composed(planes, distances, spread: Callable[..., Any], alpha):
    """Return the image of planes at these distances from the one in focus, composited front to back."""
    image, transmittance = 0, 1
    for k in reversed(range(planes.shape[0])):
        pair = spread(planes[k, ...], distances[k])
        image = image + pair[0, ...] * transmittance
        transmittance = transmittance * (1 - alpha * pair[1, ...])
    return image


def _stacked(targets, masks):
    """Return intensities and masks, each mask divided by its maximum, together: ``[P, 2, C, m, n]``."""
    xp = _array.namespace(_validate.image("targets", targets), _validate.image("masks", masks))
    for name, value in (("targets", targets), ("masks", masks)):
        if "complex" in str(value.dtype):
            raise TypeError(f"{name} must be real, got {value.dtype}")
    _validate.shaped("targets", targets, "[P, C, m, n]")
    if not xp.isdtype(targets.dtype, "real floating"):
        targets = xp.astype(targets, _array.real_dtype(targets))
    shape = tuple(targets.shape)
    if tuple(masks.shape) == (shape[0], *shape[2:]):
        masks = masks[:, None, ...]
    elif tuple(masks.shape) != shape:
        raise ValueError(f"masks must be [P, m, n] or [P, C, m, n] like targets {shape}, got {tuple(masks.shape)}")
    masks = _validate.real("masks", xp.astype(masks, targets.dtype))
    opaque = xp.max(masks, axis=(-2, -1), keepdims=True)
    masks = masks / xp.where(opaque > 0, opaque, xp.ones_like(opaque))
    return xp.stack([targets, xp.broadcast_to(masks, shape)], axis=1)


def _lengths(name, values, *counts):
    values = values if _array.is_array(values) else _array.numpy_namespace.asarray(values, dtype="float64")
    if values.ndim != 1 or values.shape[0] not in counts:
        accepted = " or ".join(map(str, counts))
        raise ValueError(f"{name} must contain {accepted} numbers, got the shape {tuple(values.shape)}")
    return values[: counts[0]]


def _per_colour(apertures, colours, planes, scale):
    """Return one number, or an array that broadcasts against ``[C, rows, columns]``."""
    if isinstance(apertures, Number):
        return apertures
    if _array.is_array(apertures) and apertures.ndim >= 2:
        grid = (colours, *(scale * n for n in planes.shape[-2:]))
        fits = (n in (1, m) for n, m in zip(reversed(apertures.shape), reversed(grid), strict=False))
        if apertures.ndim > 3 or not all(fits):
            raise ValueError(
                f"apertures must be numbers or shaped like the propagated planes {grid}, got {tuple(apertures.shape)}"
            )
        return _validate.array("apertures", apertures)
    _validate.listed("apertures", apertures, "a number, an array or a sequence of them")
    values = [_validate.given("apertures", value) for value in apertures]
    if len(values) != colours:
        raise ValueError(f"apertures must be one or {colours}, one for each colour; got {len(values)}")
    if all(isinstance(value, Number) and value == values[0] for value in values):
        return values[0]
    xp = _array.namespace(planes)
    values = [_array.cast(value, planes, _array.complex_dtype(planes)) for value in values]
    return xp.stack(xp.broadcast_arrays(*(value if value.ndim else xp.reshape(value, (1, 1)) for value in values)))
