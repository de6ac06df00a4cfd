"""Amplitude, phase and intensity of fields, wave numbers, and patterns for phase-only modulators."""

import math

import numpy as np

from odak import _array, _validate


def wavenumber(wavelength):
    """Return the wave number 2π/λ.

    Parameters
    ----------
    wavelength : float or array
        Wavelength; the result is in radians per its unit.

    Returns
    -------
    float or array
        2π/wavelength.

    Raises
    ------
    TypeError, ValueError
        If `wavelength` is not a positive number.
    """
    return 2 * math.pi / _validate.real("wavelength", wavelength, positive=True)


def rotationspeed(wavelength, c=3 * 10**11):
    """Return the angular frequency ω = 2πc/λ, in rad/s for `wavelength` in mm and the default `c` in mm/s."""
    return wavenumber(wavelength) * _validate.real("c", c, positive=True)


def rayleigh_resolution(diameter, focal=None, wavelength=0.0005):
    """Return the Rayleigh criterion of a circular aperture: 1.22·λ/D radians, or times `focal` as a length.

    Parameters
    ----------
    diameter : float
        Aperture diameter D.
    focal : float, optional
        Focal length; with it the result is a distance in the focal plane.
    wavelength : float
        Wavelength, in the unit of `diameter` (the default is 500 nm in mm).

    Returns
    -------
    float
        Resolution (Born and Wolf 1999, section 8.6.2).
    """
    angle = 1.22 * _validate.real("wavelength", wavelength, positive=True)
    angle = angle / _validate.real("diameter", diameter, positive=True)
    return angle if focal is None else angle * _validate.real("focal", focal)


def calculate_phase(field, deg: bool = False):
    """Return the phase of a field in radians (degrees if `deg`), −π to π.

    Parameters
    ----------
    field : array
        Complex field of any shape; a real one has phase 0 or π.
    deg : bool
        Return degrees.

    Returns
    -------
    array
        Real, of the field's shape and precision.
    """
    xp = _array.namespace(field)
    field = _array.to_complex(_as_array(field))
    phase = xp.atan2(xp.imag(field), xp.real(field))
    return phase * (180 / math.pi) if deg else phase


def calculate_amplitude(field):
    """Return the amplitude |u| of a field: real, of the field's shape and precision."""
    return _array.namespace(field).abs(_as_array(field))


def calculate_intensity(field):
    """Return the intensity |u|² of a field: real, of the field's shape and precision."""
    xp = _array.namespace(field)
    field = _array.to_complex(_as_array(field))
    return xp.real(field) ** 2 + xp.imag(field) ** 2


def generate_complex_field(amplitude, phase):
    """Return amplitude·exp(i·phase).

    Parameters
    ----------
    amplitude, phase : float or array
        Real; they broadcast. The phase is in radians.

    Returns
    -------
    array
        Complex field; complex128 if either array is 64-bit, complex64 otherwise.
    """
    like = phase if _array.is_array(phase) else amplitude
    amplitude, phase = _as_real(amplitude, like), _as_real(phase, like)
    xp = _array.namespace(phase)
    dtype = xp.complex128 if _array.is_double(amplitude) or _array.is_double(phase) else xp.complex64
    return _array.phasor(phase, dtype) * xp.astype(amplitude, dtype)


def _as_real(value, like):
    """Return a number or an array as a floating-point array of `like`'s library, device and precision."""
    xp = _array.namespace(like)
    if not _array.is_array(value):
        dtype = _array.real_dtype(like) if _array.is_array(like) else xp.float64
        return xp.asarray(float(value), dtype=dtype, device=_array.device_of(like))
    if xp.isdtype(value.dtype, ("real floating", "complex floating")):
        return value
    return xp.astype(value, _array.real_dtype(value))


def set_amplitude(field, amplitude):
    """Return `field` with its phase kept and its amplitude replaced by |amplitude|.

    Parameters
    ----------
    field : array
        Complex field.
    amplitude : float or array
        New amplitude; of a complex one the modulus is taken.

    Returns
    -------
    array
        Complex field.
    """
    xp = _array.namespace(field, amplitude)
    amplitude = xp.abs(amplitude) if _array.is_array(amplitude) else abs(amplitude)
    return generate_complex_field(amplitude, calculate_phase(field))


def add_phase(field, new_phase):
    """Return field·exp(i·new_phase), the phase in radians."""
    field = _array.to_complex(_as_array(field))
    return field * _array.phasor(_as_real(new_phase, field), field.dtype)


def add_random_phase(field, seed=None):
    """Return `field` with a phase added that is uniform between 0 and π.

    Parameters
    ----------
    field : array
        Complex field.
    seed : int or numpy.random.Generator, optional
        Makes the result reproducible.

    Returns
    -------
    array
        Complex field.
    """
    field = _array.to_complex(_as_array(field))
    phase = np.random.default_rng(seed).random(tuple(field.shape)) * math.pi
    return add_phase(field, _array.cast(phase, field, _array.real_dtype(field)))


def adjust_phase_only_slm_range(native_range, working_wavelength, native_wavelength):
    """Return a modulator's phase range at another wavelength than the one it was specified for.

    Parameters
    ----------
    native_range : float
        Phase range in radians at `native_wavelength`.
    working_wavelength, native_wavelength : float
        Wavelengths, in one unit.

    Returns
    -------
    float
        native_range·native_wavelength/working_wavelength (the path difference is what stays).
    """
    _validate.real("native_range", native_range, positive=True)
    _validate.real("working_wavelength", working_wavelength, positive=True)
    return native_range / working_wavelength * _validate.real("native_wavelength", native_wavelength, positive=True)


def produce_phase_only_slm_pattern(
    hologram, slm_range, filename=None, bits: int = 8, default_range: float = 6.28, illumination=None
):
    """Return a hologram as a modulator shows it, and the integer pattern to send to it.

    Parameters
    ----------
    hologram : array
        Complex hologram ``[..., rows, columns]``; its phase is what counts.
    slm_range : float
        Phase range of the modulator in radians.
    filename : str, optional
        Where to save the pattern, black level 0 and white level 2^bits − 1 (with 8 bits the file holds the levels).
    bits : int
        Bits per pixel, 1 to 16.
    default_range : float
        Phase range, in radians, over which the levels are spread when the field is rebuilt from them.
    illumination : array, optional
        Amplitude of the light on the modulator; ones by default.

    Returns
    -------
    tuple
        Complex field illumination·exp(i·level/2^bits·default_range) and the levels, int32, 0 … 2^bits − 1.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.
    """
    hologram = _validate.image("hologram", hologram)
    _validate.real("slm_range", slm_range, positive=True)
    levels = 2 ** _validate.integer("bits", bits, minimum=1)
    xp = _array.namespace(hologram)
    phase = calculate_phase(hologram)
    turn = phase - xp.floor(phase / slm_range) * slm_range
    pattern = xp.clip(xp.floor(turn / slm_range * levels), 0, levels - 1)
    if filename is not None:
        from odak.tools.file import save_image

        array = pattern.detach().cpu().numpy() if _array.is_torch(pattern) else pattern
        save_image(filename, array, cmin=0, cmax=levels - 1, color_depth=8 if bits <= 8 else 16)
    amplitude = 1.0 if illumination is None else illumination
    field = generate_complex_field(amplitude, pattern * (default_range / levels))
    return field, xp.astype(pattern, xp.int32)


def _as_array(field):
    return field if _array.is_array(field) else np.asarray(field)
