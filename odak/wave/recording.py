"""Digital holography: interference with a reference wave as a camera records it, and the field found from it."""

import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array, Device, DType
from odak._warnings import SamplingWarning, warn
from odak.wave.sampling import warn_of_tilt
from odak.wave.transfer_functions import pitches

_AXES = (-2, -1)
# Light between the radius of the filter and 1.1 times that, relative to the light inside, that shows a wider band.
_RIM, _LEAKED = 1.1, 5e-4


@_validate.takes_units("dx", "wavelength", degrees=("angles",))
def reference_wave(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float | Array,
    angles: Sequence[float] | Array = (0.0, 0.0),
    amplitude: float | Array = 1.0,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return a plane wave on a camera, the reference of a recorded hologram.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pixel pitch of the camera in metres, one number or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres.
    angles : sequence of float or array
        Angles to the axis in degrees (rows, columns): the frequencies of the wave are sin(angle)/wavelength.
    amplitude : float or array
        Amplitude of the wave.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        Real dtype that gives the precision; by default the widest of the arrays given, else the library's default.

    Returns
    -------
    array
        Complex ``[rows, columns]``: amplitude·exp(2πi·(f_y·y + f_x·x)), of phase zero at index n // 2.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    SamplingWarning
        If the wave has frequencies above 1/(2·dx), so that its fringes are undersampled.

    Examples
    --------
    A wave at asin(λ/(4·dx)) to the axis advances by a quarter of a cycle from one sample to the next:

    >>> import math
    >>> from odak.wave import reference_wave
    >>> wave = reference_wave((8, 8), 1e-6, 500e-9, (0.0, math.degrees(math.asin(0.125))))
    >>> [round(abs(complex(wave[4, 4 + i]) - 1j**i), 6) for i in range(3)]
    [0.0, 0.0, 0.0]
    """
    shape = _validate.size("shape", shape)
    steps = [_validate.number("dx", pitch, positive=True) for pitch in pitches(dx)]
    _validate.number("wavelength", wavelength, positive=True)
    _validate.number("amplitude", amplitude)
    given: Any = (angles,) if _array.is_array(angles) else _validate.several("angles", angles, 2)
    tilts: Any = angles if _array.is_array(angles) else given
    if _array.is_array(angles) and tuple(tilts.shape) != (2,):
        raise ValueError(f"angles must be two, those along rows and columns; got {tuple(tilts.shape)}")
    for tilt in given:
        _validate.real("angles", tilt)
    xp, device, dtype = _array.placement(wavelength, *given, amplitude, *steps, xp=xp, device=device, dtype=dtype)
    wavelength, amplitude = (_array.converted(value, xp, device, xp.float64) for value in (wavelength, amplitude))
    cycles = 0.0
    for axis, (n, step) in enumerate(zip(shape, steps, strict=True)):
        tilt, step = (_array.converted(value, xp, device, xp.float64) for value in (tilts[axis], step))
        along = xp.sin(tilt * (math.pi / 180)) * step / wavelength
        warn_of_tilt("reference_wave", steps[axis], 2 * math.pi / wavelength, tilts[axis])
        place = (xp.arange(n, dtype=xp.float64, device=device) - n // 2) * along
        cycles = cycles + (place[:, None] if axis == 0 else place[None, :])
    wave = _array.phasor_of_cycles(cycles, xp.complex128 if dtype == xp.float64 else xp.complex64)
    return wave * xp.astype(amplitude, dtype)


def recorded_intensity(field: Array, reference: Array, phase_steps: Sequence[float] | Array | None = None) -> Array:
    """Return the intensity of the interference of a field with a reference wave.

    Parameters
    ----------
    field : array
        Complex field on the camera ``[..., rows, columns]``.
    reference : array
        Complex reference wave ``[..., rows, columns]``, such as :func:`reference_wave` gives.
    phase_steps : sequence of float or array, optional
        Phases in radians by which the reference is retarded in turn, for :func:`phase_shifting_field`. By default there
        is one recording, for :func:`off_axis_field`.

    Returns
    -------
    array
        Real |field + reference|² ``[..., rows, columns]``, or |field + reference·exp(iδ)|² of each step δ,
        ``[..., steps, rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import recorded_intensity
    >>> one = np.ones((2, 2), dtype=complex)
    >>> recorded_intensity(one, one, (0.0, np.pi)).round(6)[:, 0, 0].tolist()
    [4.0, 0.0]
    """
    field, reference = _pair("field", field, reference)
    xp = _array.namespace(field)
    if phase_steps is not None:
        steps = _steps(phase_steps, field)
        retarded = _array.phasor(steps, reference.dtype)[:, None, None]
        field, reference = field[..., None, :, :], reference[..., None, :, :] * retarded
    total = field + reference
    return xp.real(total) ** 2 + xp.imag(total) ** 2


@_validate.takes_units("dx")
def off_axis_field(
    hologram: Array, reference: Array, dx: float | Sequence[float], bandwidth: float | None = None
) -> Array:
    """Return the field that was recorded with a tilted reference wave, from one hologram.

    The hologram |u + r|² times r/|r|² holds the field u at low frequencies and the other terms about the frequencies
    of r and twice as far, from where a round low-pass filter keeps them. A field of band B is found without an error
    where the frequency of the reference is at least 3·B and the sum of both at most 1/(2·dx).

    Parameters
    ----------
    hologram : array
        Real intensity ``[..., rows, columns]``.
    reference : array
        Complex reference wave ``[..., rows, columns]``, nowhere zero.
    dx : float or sequence of float
        Pixel pitch of the camera in metres, one number or a pair (rows, columns).
    bandwidth : float, optional
        Radius of the filter in cycles per metre; by default a third of the frequency of the reference at the middle.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it, or the reference has no tilt and no bandwidth is given.

    Warns
    -----
    SamplingWarning
        If light just outside the filter is more than 0.05 % of that inside: the field's band is wider than the filter,
        or overlaps the light of the object with itself. On a GPU the spectrum is not read.

    Notes
    -----
    Leith and Upatnieks, J. Opt. Soc. Am. 52, 1123 (1962); Cuche, Marquet and Depeursinge, Appl. Opt. 39, 4070 (2000).

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import off_axis_field, recorded_intensity, reference_wave
    >>> y, x = np.mgrid[-32:32, -32:32] * 2e-6
    >>> field = np.exp(-(x**2 + y**2) / 3e-5**2) * np.exp(1j)
    >>> reference = reference_wave(field.shape, 2e-6, 532e-9, (3.8, 3.8), 2.0)
    >>> found = off_axis_field(recorded_intensity(field, reference), reference, 2e-6)
    >>> bool(abs(found - field).max() < 1e-2)
    True
    """
    hologram, reference = _pair("hologram", _real("hologram", hologram), reference)
    xp, (rows, columns) = _array.namespace(hologram), tuple(hologram.shape[-2:])
    steps = [_validate.constant("dx", pitch, positive=True) for pitch in pitches(dx)]
    if bandwidth is None:
        carrier = math.hypot(*(_slope(reference, axis) / step for axis, step in zip(_AXES, steps, strict=True)))
        if carrier * min(rows * steps[0], columns * steps[1]) < 3:
            raise ValueError("bandwidth must be given where the reference has no tilt")
        bandwidth = carrier / 3
    bandwidth = _validate.constant("bandwidth", bandwidth, positive=True)
    fy, fx = (
        xp.asarray(np.fft.fftfreq(n, step), dtype=_array.real_dtype(hologram), device=_array.device_of(hologram))
        for n, step in zip((rows, columns), steps, strict=True)
    )
    relative = (fy[:, None] ** 2 + fx**2) / bandwidth**2
    passed = xp.astype(relative <= 1, _array.real_dtype(hologram))
    spectrum = xp.fft.fftn(hologram * _inverse_conjugate(reference), axes=_AXES)
    if _array.is_readable(spectrum):
        beyond = xp.astype((relative > 1) & (relative < _RIM**2), passed.dtype)
        power = xp.real(spectrum) ** 2 + xp.imag(spectrum) ** 2
        (outside,), (inside,) = (_validate.numbers(xp.sum(power * part)) for part in (beyond, passed))
        if outside > _LEAKED * inside:
            warn(
                f"light just outside the filter of {bandwidth:.4g} cycles/m is {100 * outside / inside:.2g} % of that "
                "inside: the field's band is wider, or overlaps the light of the object with itself, or there is "
                "noise; tilt the reference to three times the band, or give the bandwidth",
                SamplingWarning,
            )
    return xp.fft.ifftn(spectrum * passed, axes=_AXES)


def phase_shifting_field(holograms: Array, reference: Array, phase_steps: Sequence[float] | Array) -> Array:
    """Return the field that was recorded with several phases of a reference wave.

    For each pixel the recorded intensities are a + b·cos δ + c·sin δ of the step δ; the least-squares solution gives
    the field (b + ic)/(2·conj(reference)). The steps may be any three or more that determine it. For N equal steps of
    2π/N this is the formula Σ I·exp(iδ)/(N·conj(reference)).

    Parameters
    ----------
    holograms : array
        Real intensities ``[..., steps, rows, columns]``.
    reference : array
        Complex reference wave ``[..., rows, columns]`` at the step 0, nowhere zero.
    phase_steps : sequence of float or array
        Phases of the reference in radians, three or more.

    Returns
    -------
    array
        Complex field ``[..., rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it, or the steps do not determine the field.

    Notes
    -----
    Yamaguchi and Zhang, Opt. Lett. 22, 1268 (1997); any steps: Greivenkamp, Opt. Eng. 23, 350 (1984).

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import phase_shifting_field, recorded_intensity
    >>> field, reference = np.full((4, 4), 0.3 + 0.4j), np.ones((4, 4), dtype=complex)
    >>> steps = (0.0, 1.5, 3.1)
    >>> found = phase_shifting_field(recorded_intensity(field, reference, steps), reference, steps)
    >>> bool(np.allclose(found, field))
    True
    """
    holograms = _real("holograms", holograms)
    steps = _steps(phase_steps, holograms)
    _validate.shaped("holograms", holograms, f"[..., {steps.shape[0]}, rows, columns], one for each of phase_steps")
    holograms, reference = _pair("holograms", holograms, reference, stacked=True)
    xp = _array.namespace(holograms)
    steps = xp.astype(steps, xp.float64)
    system = xp.stack([xp.ones_like(steps), xp.cos(steps), xp.sin(steps)], axis=-1)
    normal = xp.matmul(xp.matrix_transpose(system), system)
    if steps.shape[0] < 3 or (_array.is_readable(normal) and _validate.numbers(xp.linalg.det(normal))[0] < 1e-9):
        raise ValueError("phase_steps must be three or more different phases between 0 and 2π")
    weights = xp.matmul(xp.linalg.inv(normal), xp.matrix_transpose(system))
    weights = _array.make_complex(weights[1, :], weights[2, :]) / 2
    weights = xp.astype(weights, _array.complex_dtype(holograms))[:, None, None]
    return xp.sum(weights * holograms, axis=-3) * _inverse_conjugate(reference)


def unwrap_phase(phase: Array, mask: Array | None = None, seed: int | None = 0) -> Array:
    """Return a phase without its jumps of 2π, by sorting pixels by their reliability.

    Parameters
    ----------
    phase : array
        Phase in radians ``[rows, columns]``.
    mask : array, optional
        Boolean ``[rows, columns]``, true where the phase is known. Elsewhere the phase stays as it is.
    seed : int, optional
        Makes the order of pixels that are equally reliable reproducible.

    Returns
    -------
    array
        The phase plus multiples of 2π, ``[rows, columns]``; up to a common multiple of 2π, chosen so that the mean is
        near zero. Differentiable: the added multiples are constants.

    Raises
    ------
    ImportError
        If scikit-image is not installed.
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Herráez, Burton, Lalor and Gdeisat, Appl. Opt. 41, 7437 (2002), as implemented by scikit-image.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import unwrap_phase
    >>> slope = np.tile(np.linspace(-9, 9, 40), (40, 1))
    >>> found = unwrap_phase(np.angle(np.exp(1j * slope)))
    >>> bool(np.allclose(found - found[0, 0], slope - slope[0, 0]))
    True
    """
    phase = _validate.image("phase", _real("phase", phase))
    _validate.real("phase", phase)
    if not _array.namespace(phase).isdtype(phase.dtype, "real floating"):
        phase = _array.namespace(phase).astype(phase, _array.real_dtype(phase))
    _validate.shaped("phase", phase, "[rows, columns]")
    told = "unwrap_phase needs scikit-image, which is not installed: pip install scikit-image"
    unwrapped = _validate.optional("skimage.restoration", told).unwrap_phase
    if seed is not None:
        _validate.integer("seed", seed)
    wrapped, known = _plain(phase).astype(np.float64), None
    if mask is not None:
        known = _plain(_validate.array("mask", mask)).astype(bool)
        if known.shape != wrapped.shape or not known.any():
            raise ValueError(
                f"mask must have the phase's shape {wrapped.shape} and be true somewhere, got {known.shape}"
            )
    within = np.remainder(wrapped + math.pi, 2 * math.pi) - math.pi
    values: Any = within if known is None else np.ma.masked_array(within, ~known)
    turns = np.rint((np.ma.getdata(unwrapped(values, rng=seed)) - wrapped) / (2 * math.pi))
    inside = slice(None) if known is None else known
    turns = turns - np.rint((wrapped + 2 * math.pi * turns)[inside].mean() / (2 * math.pi))
    if known is not None:
        turns = np.where(known, turns, 0.0)
    return phase + _array.cast(2 * math.pi * turns, phase)


def _plain(values) -> np.ndarray:
    return values.detach().cpu().numpy() if _array.is_torch(values) else np.asarray(values)


def _real(name, values):
    values = _validate.array(name, values)
    if "complex" in str(values.dtype):
        raise TypeError(f"{name} must be real, got {values.dtype}")
    return values


def _pair(name, image, reference, stacked: bool = False):
    """Return an image and its reference after checking that their rows and columns are the same."""
    image = _validate.image(name, image)
    reference = _array.to_complex(_validate.image("reference", reference))
    rows, columns = image.shape[-2:]
    _validate.shaped("reference", reference, f"[..., {rows}, {columns}], with the rows and columns of {name}")
    if not stacked:
        _validate.fitting(**{name: image, "reference": reference})
    return image, reference


def _steps(phase_steps, like):
    """Return phases in radians as an array ``[steps]`` of the library and precision of another array."""
    if not _array.is_array(phase_steps):
        steps = list(_validate.several("phase_steps", phase_steps))
        xp, device = _array.namespace(like), _array.device_of(like)
        phase_steps = _array.stacked(steps, xp, device, _array.real_dtype(like))
    _validate.real("phase_steps", phase_steps)
    if phase_steps.ndim != 1:
        raise ValueError(f"phase_steps must have one axis, got {tuple(phase_steps.shape)}")
    return _array.cast(phase_steps, like, _array.real_dtype(like))


def _inverse_conjugate(reference):
    """Return r/|r|² of a reference wave r, which is not a number where it is infinite."""
    xp = _array.namespace(reference)
    return reference / (xp.real(reference) ** 2 + xp.imag(reference) ** 2)


def _slope(reference, axis: int) -> float:
    """Return the periods per pixel of a reference wave along an axis, as a mean weighted by its intensity."""
    values = _plain(reference)
    ahead = np.roll(values, -1, axis) * values.conj()
    ahead = np.delete(ahead, -1, axis)
    return float(np.angle(ahead.sum()) / (2 * math.pi))
