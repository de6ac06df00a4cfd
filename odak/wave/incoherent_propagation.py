"""What an eye or a camera sees of a scene made of planes, under light that does not interfere."""

from collections.abc import Callable, Iterable, Sequence
from numbers import Number
from typing import Any

from odak import _array, _validate
from odak._array import Array
from odak.wave.propagation import padding_flags, propagate

_METHOD = "Incoherent Angular Spectrum"


def incoherent_focal_stack_rgbd(
    targets: Array,
    masks: Array,
    distances: Array,
    dx: float,
    wavelengths: Any,
    zero_padding: Sequence[bool] = (True, False, True),
    apertures: float | Array = 1.0,
    alpha: float | Array = 0.5,
) -> Array:
    """Return the images of a scene of planes with the focus on each plane in turn.

    Each plane spreads by the incoherent transfer function of its distance to the plane in focus, and what lies in
    front covers it, spread likewise.

    Parameters
    ----------
    targets : array
        Intensities of the planes ``[P, C, m, n]``, the plane nearest to the viewer first.
    masks : array
        What each plane covers, not negative, ``[P, m, n]`` or ``[P, C, m, n]``; a scale of its own does not matter.
    distances : sequence of float or array
        Places of the planes along the axis ``[P]``, metres.
    dx : float
        Pixel pitch in metres.
    wavelengths : float, sequence of float or array
        Wavelength of each colour ``[C]``, metres.
    zero_padding : sequence of bool
        Pad planes to twice their size; pad spectra to twice their size; crop the centre half at the end.
    apertures : float, array or sequence of them
        Aperture of each colour, a number or centred on the propagated grid; one stands for all.
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
    With I_k and M_k the propagated intensity and mask of plane k, the image is Σ_k I_k·Π_{j<k} (1 − α·M_j/max M_j),
    the "over" of Porter and Duff (SIGGRAPH 1984) for opacities α·M_j/max M_j. The transfer function is Goodman's
    (Introduction to Fourier Optics, 2005, eq. 6-28).

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
    distances = _lengths("distances", distances, count)
    _validate.real("wavelengths", wavelengths, positive=True)
    wavelengths = wavelengths if isinstance(wavelengths, Number) else _lengths("wavelengths", wavelengths, colours)
    if _array.is_readable(_validate.real("alpha", alpha)) and not all(0 <= v <= 1 for v in _validate.numbers(alpha)):
        raise ValueError(f"alpha must be between 0 and 1, got {alpha!r}")
    alpha = _array.cast(alpha, planes)
    _validate.fitting(alpha=alpha, targets=planes[0, 0, ...])
    aperture = _per_colour(apertures, colours, planes, 2 if padding_flags(zero_padding)[0] else 1)

    def spread(plane, distance):
        return propagate(plane, None, distance, dx, wavelengths, _METHOD, zero_padding=zero_padding, aperture=aperture)

    stack = xp.stack([_composed(planes, distances[n] - distances, spread, alpha) for n in range(count)])
    brightest = xp.max(stack)
    return stack / xp.where(brightest > 0, brightest, xp.ones_like(brightest))


def _composed(planes, distances, spread: Callable, alpha):
    """Return the image of planes that are so far from the one in focus, front to back."""
    xp = _array.namespace(planes)
    image, clear = 0, 1
    for k in range(planes.shape[0]):
        pair = spread(planes[k, ...], distances[k])
        light, cover = pair[0, ...], pair[1, ...]
        image = image + light * clear
        most = xp.max(cover, axis=(-2, -1), keepdims=True)
        clear = clear * (1 - alpha * cover / xp.where(most > 0, most, xp.ones_like(most)))
    return image


def _stacked(targets, masks):
    """Return intensities and masks together, ``[P, 2, C, m, n]``."""
    xp = _array.namespace(_validate.image("targets", targets), _validate.image("masks", masks))
    for name, value in (("targets", targets), ("masks", masks)):
        if "complex" in str(value.dtype):
            raise TypeError(f"{name} must be real, got {value.dtype}")
    if targets.ndim != 4:
        raise ValueError(f"targets must be [P, C, m, n], got {tuple(targets.shape)}")
    if not xp.isdtype(targets.dtype, "real floating"):
        targets = xp.astype(targets, _array.real_dtype(targets))
    shape = tuple(targets.shape)
    if tuple(masks.shape) == (shape[0], *shape[2:]):
        masks = masks[:, None, ...]
    elif tuple(masks.shape) != shape:
        raise ValueError(f"masks must be [P, m, n] or [P, C, m, n] like targets {shape}, got {tuple(masks.shape)}")
    return xp.stack([targets, xp.broadcast_to(xp.astype(masks, targets.dtype), shape)], axis=1)


def _lengths(name, values, count):
    values = values if _array.is_array(values) else _array.numpy_namespace.asarray(values, dtype="float64")
    if tuple(values.shape) != (count,):
        raise ValueError(f"{name} must hold {count} numbers, got the shape {tuple(values.shape)}")
    return values


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
    if isinstance(apertures, str) or not isinstance(apertures, Iterable):
        raise TypeError(f"apertures must be a number, an array or a sequence of them, got {type(apertures).__name__}")
    values = [_validate.given("apertures", value) for value in apertures]
    if len(values) != colours:
        raise ValueError(f"apertures must be one or {colours}, one for each colour; got {len(values)}")
    if all(isinstance(value, Number) and value == values[0] for value in values):
        return values[0]
    xp = _array.namespace(planes)
    values = [_array.cast(value, planes, _array.complex_dtype(planes)) for value in values]
    return xp.stack(xp.broadcast_arrays(*(value if value.ndim else xp.reshape(value, (1, 1)) for value in values)))
