"""What a phase-only spatial light modulator shows: its phase range and its levels."""

from odak import _array, _validate
from odak.wave.utils import calculate_phase, generate_complex_field


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


def decompose_double_phase(tensor):
    """Return the two checkerboard parts of an image, each packed into half the columns.

    Parameters
    ----------
    tensor : array
        ``[..., h, w]``; odd sizes lose their last row or column.

    Returns
    -------
    tuple
        High and low part, each ``[..., h, w/2]``: high holds the samples (even, even) and (odd, odd), low the others.
    """
    tensor = _validate.image("tensor", tensor)
    rows, columns = (n - n % 2 for n in tensor.shape[-2:])
    if not rows or not columns:
        raise ValueError(f"tensor must have at least 2 rows and 2 columns, got {tuple(tensor.shape)}")
    even_rows, odd_rows = tensor[..., 0:rows:2, :columns], tensor[..., 1:rows:2, :columns]
    high = _interleave_rows(even_rows[..., 0::2], odd_rows[..., 1::2])
    low = _interleave_rows(even_rows[..., 1::2], odd_rows[..., 0::2])
    return high, low


def compose_double_phase(component_high, component_low):
    """Return the image whose checkerboard parts are given: the exact inverse of :func:`decompose_double_phase`.

    Parameters
    ----------
    component_high, component_low : array
        ``[..., h, w/2]`` each.

    Returns
    -------
    array
        ``[..., h, w]``.
    """
    if tuple(component_high.shape) != tuple(component_low.shape):
        raise ValueError(
            f"component_low must have component_high's shape {tuple(component_high.shape)}, "
            f"got {tuple(component_low.shape)}"
        )
    high_even, high_odd = component_high[..., 0::2, :], component_high[..., 1::2, :]
    low_even, low_odd = component_low[..., 0::2, :], component_low[..., 1::2, :]
    return _interleave_rows(_interleave_columns(high_even, low_even), _interleave_columns(low_odd, high_odd))


def _interleave_rows(first, second):
    xp = _array.namespace(first)
    *batch, rows, columns = first.shape
    return xp.reshape(xp.stack([first, second], axis=-2), (*batch, 2 * rows, columns))


def _interleave_columns(first, second):
    xp = _array.namespace(first)
    *batch, rows, columns = first.shape
    return xp.reshape(xp.stack([first, second], axis=-1), (*batch, rows, 2 * columns))
