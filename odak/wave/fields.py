"""Amplitude, phase and intensity of fields, fields of point sources, and patterns for phase-only modulators."""

import contextvars
import math
from typing import Any, NamedTuple

import numpy as np

from odak import _array, _validate
from odak._array import Array, ArrayT, Seed
from odak._warnings import ArgumentWarning, warn

# Where the default unit is the millimetre: wavelengths below 10 nm, and apertures of fewer wavelengths, are likely in
# metres.
_FEWEST_MILLIMETRES, _FEWEST_WAVES = 1e-5, 100


@_validate.takes_units("wavelength")
def wavenumber(wavelength: float | Array) -> float | Array:
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

    Examples
    --------
    >>> from odak.wave import wavenumber
    >>> round(float(wavenumber(500e-9)) * 500e-9, 4)
    6.2832
    """
    return 2 * math.pi / _positive("wavelength", wavelength)


def _positive(name, value):
    """Return positive numbers, lists as arrays, and those in half precision in single."""
    value = _validate.real(name, value, positive=True)
    value = np.asarray(value) if isinstance(value, (list, tuple)) else value
    half = "float16" in str(getattr(value, "dtype", ""))
    return _array.namespace(value).astype(value, _array.real_dtype(value)) if half else value


@_validate.takes_units("wavelength")
def rotationspeed(wavelength: Array, c: float | Array = 3 * 10**11) -> Array:
    """Return the angular frequency ω = 2πc/λ.

    Parameters
    ----------
    wavelength : float or array
        Wavelength; in mm with the default of `c`.
    c : float or array, default: 3e11
        Speed of light; the default is 3·10¹¹ mm/s.

    Returns
    -------
    array
        Angular frequency in rad/s, of the shape to which the arguments broadcast.

    Warns
    -----
    ArgumentWarning
        If `wavelength` is likely in metres, and `c` is the default.

    Examples
    --------
    >>> from odak.wave import rotationspeed
    >>> round(float(rotationspeed(500e-9, 299792458.0)) / 1e15, 3)
    3.767
    """
    numbers = isinstance(wavelength, float) and isinstance(c, (int, float))
    if numbers and c == 3 * 10**11 and 0 < wavelength < _FEWEST_MILLIMETRES:
        warn(f"wavelength is in mm with the default c, got {wavelength:g}: give c=299792458.0 for m", ArgumentWarning)
    k, c = wavenumber(wavelength), _positive("c", c)
    _validate.fitting(wavelength=k, c=c)
    return k * c


@_validate.takes_units("wavelength")
def rayleigh_resolution(diameter: float, focal: float | None = None, wavelength: float = 0.0005) -> float:
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

    Warns
    -----
    ArgumentWarning
        If `diameter` is likely in metres, and `wavelength` is the default.

    Examples
    --------
    A lens of 25 mm aperture and 100 mm focal length, in mm:

    >>> from odak.wave import rayleigh_resolution
    >>> round(rayleigh_resolution(25.0, 100.0, 500e-6), 6)
    0.00244
    """
    lengths = isinstance(diameter, float) and isinstance(wavelength, float)
    if lengths and wavelength == 0.0005 and 0 < diameter < _FEWEST_WAVES * wavelength:
        warn(
            f"wavelength is 0.0005 by default, in mm, got a diameter of {diameter:g}: give both in one unit",
            ArgumentWarning,
        )
    wavelength, diameter = _positive("wavelength", wavelength), _positive("diameter", diameter)
    focal = 1.0 if focal is None else _validate.real("focal", focal)
    focal = np.asarray(focal) if isinstance(focal, (list, tuple)) else focal
    _validate.fitting(wavelength=wavelength, diameter=diameter, focal=focal)
    return 1.22 * wavelength / diameter * focal


def calculate_phase(field: ArrayT, deg: bool = False) -> ArrayT:
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

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import calculate_phase
    >>> calculate_phase(np.asarray([1j, -1 + 0j]), deg=True).tolist()
    [90.0, 180.0]
    """
    field = _array.to_complex(_validate.array("field", field))
    xp = _array.namespace(field)
    phase = xp.atan2(xp.imag(field), xp.real(field))
    return phase * (180 / math.pi) if _validate.flag("deg", deg) else phase


def calculate_amplitude(field: ArrayT) -> ArrayT:
    """Return the amplitude |u| of a field.

    Parameters
    ----------
    field : array
        Complex field of any shape.

    Returns
    -------
    array
        Real, not negative, of the field's shape and precision; floating from integers.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import calculate_amplitude
    >>> calculate_amplitude(np.asarray([3 + 4j, -2 + 0j])).tolist()
    [5.0, 2.0]
    """
    field = _validate.array("field", field)
    xp = _array.namespace(field)
    # The modulus of the least integer of a type is no integer of that type.
    known = xp.isdtype(field.dtype, ("real floating", "complex floating"))
    return xp.abs(field if known else xp.astype(field, _array.real_dtype(field)))


def calculate_intensity(field: ArrayT) -> ArrayT:
    """Return the intensity |u|² of a field.

    Parameters
    ----------
    field : array
        Complex field of any shape.

    Returns
    -------
    array
        Real, not negative, of the field's shape and precision; floating from integers.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import calculate_intensity
    >>> calculate_intensity(np.asarray([3 + 4j, -2 + 0j])).tolist()
    [25.0, 4.0]
    """
    field = _array.to_complex(_validate.array("field", field))
    xp = _array.namespace(field)
    return xp.real(field) ** 2 + xp.imag(field) ** 2


def generate_complex_field(amplitude: float | Array, phase: float | Array) -> Array:
    """Return amplitude·exp(i·phase).

    Parameters
    ----------
    amplitude : float or array
        Real amplitude; it broadcasts against the phase.
    phase : float or array
        Real phase in radians.

    Returns
    -------
    array
        Complex field; complex128 if either array is 64-bit, complex64 otherwise.

    Examples
    --------
    >>> from odak.wave import generate_complex_field
    >>> field = generate_complex_field(2.0, 3.14159265 / 2)
    >>> round(abs(float(field.real)), 6), round(float(field.imag), 6)
    (0.0, 2.0)
    """
    like = phase if _array.is_array(phase) else amplitude
    amplitude, phase = _as_floats("amplitude", amplitude, like), _phase("phase", phase, like)
    _validate.fitting(amplitude=amplitude, phase=phase)
    xp = _array.namespace(phase)
    dtype = xp.complex128 if _array.is_double(amplitude) or _array.is_double(phase) else xp.complex64
    return _array.phasor(phase, dtype) * xp.astype(amplitude, dtype)


def _as_floats(name, value, like):
    """Return an array in floats of its own precision, a number or a list in the precision of the array `like`."""
    array = _validate.given(name, value)
    if type(array) in (int, float, complex):
        if _array.is_array(like):
            dtype = _array.complex_dtype if isinstance(value, complex) else _array.real_dtype
            return _array.cast(value, like, dtype(like))
        array = _validate.array(name, array)
    dtype = _array.complex_dtype if "complex" in str(array.dtype) else _array.real_dtype
    if _array.is_array(value) or not _array.is_array(like):
        return _array.namespace(array).astype(array, dtype(array), copy=False)
    return _array.cast(array, like, dtype(like))


def _phase(name, value, like):
    """Return phases as floats, see `_as_floats`; a complex one has no meaning."""
    phase = _as_floats(name, value, like)
    if "complex" in str(phase.dtype):
        raise TypeError(f"{name} must be real, got {phase.dtype}")
    return phase


def set_amplitude(field: Array, amplitude: float | Array) -> Array:
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

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import set_amplitude
    >>> set_amplitude(np.asarray([3j, -4 + 0j]), 2.0).imag.round(6).tolist()
    [2.0, 0.0]
    """
    field = _validate.array("field", field)
    amplitude = abs(_as_floats("amplitude", amplitude, field))
    _validate.fitting(field=field, amplitude=amplitude)
    return generate_complex_field(amplitude, calculate_phase(field))


def add_phase(field: Array, new_phase: Array) -> Array:
    """Return a field with a phase added, field·exp(i·new_phase).

    Parameters
    ----------
    field : array
        Complex field of any shape.
    new_phase : array
        Phase in radians; it broadcasts against the field.

    Returns
    -------
    array
        Complex field of the shape to which the two broadcast.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import add_phase
    >>> add_phase(np.asarray([2 + 0j]), np.asarray([np.pi / 2])).round(6).tolist()
    [2j]
    """
    field = _array.to_complex(_validate.array("field", field))
    new_phase = _phase("new_phase", new_phase, field)
    _validate.fitting(field=field, new_phase=new_phase)
    return field * _array.phasor(new_phase, field.dtype)


def add_random_phase(field: Array, seed: Seed = None) -> Array:
    """Return `field` with a phase added that is uniform between 0 and π.

    Parameters
    ----------
    field : array
        Complex field.
    seed : int or generator, optional
        Makes the result reproducible; a generator is NumPy's, or torch's for a tensor.

    Returns
    -------
    array
        Complex field.

    Examples
    --------
    The amplitude is kept:

    >>> import numpy as np
    >>> from odak.wave import add_random_phase
    >>> field = add_random_phase(np.full((2, 2), 3 + 0j), seed=0)
    >>> abs(field).round(6).tolist()
    [[3.0, 3.0], [3.0, 3.0]]
    """
    field = _array.to_complex(_validate.array("field", field))
    return add_phase(field, uniform(tuple(field.shape), seed, field) * math.pi)


def adjust_phase_only_slm_range(native_range: float, working_wavelength: float, native_wavelength: float) -> float:
    """Return a modulator's phase range at another wavelength than the one it was specified for.

    Parameters
    ----------
    native_range : float
        Phase range in radians at `native_wavelength`.
    working_wavelength : float
        Wavelength at which the modulator is used.
    native_wavelength : float
        Wavelength at which the range was specified, in the unit of `working_wavelength`.

    Returns
    -------
    float
        native_range·native_wavelength/working_wavelength in radians, at an unchanged path difference.

    Examples
    --------
    A modulator of range 2π at 633 nm has a larger one in the green:

    >>> from odak.wave import adjust_phase_only_slm_range
    >>> round(adjust_phase_only_slm_range(6.2832, 532e-9, 633e-9) / 6.2832, 4)
    1.1898
    """
    native_range = _positive("native_range", native_range)
    working_wavelength = _positive("working_wavelength", working_wavelength)
    native_wavelength = _positive("native_wavelength", native_wavelength)
    _validate.fitting(
        native_range=native_range, working_wavelength=working_wavelength, native_wavelength=native_wavelength
    )
    return native_range / working_wavelength * native_wavelength


def normalize_phase(
    phase: Array,
    range_min: float = 0.0,
    range_max: float = 2 * math.pi,
    *,
    period: float | None = None,
    multiplier: float | None = None,
) -> Array:
    """Return `phase` mapped linearly so that its extremes are `range_min` and `range_max`.

    Parameters
    ----------
    phase : array
        Real, of any shape.
    range_min : float, default: 0.0
        Lower end of the range, which the smallest phase becomes.
    range_max : float, default: 2π
        Upper end of the range, above `range_min`, which the largest phase becomes.
    period : float, optional
        With this or `multiplier`, the form of Odak 0.2.7, the result is the share of a period, (phase mod
        period)/period, times `multiplier`, and the range has no part in it. 2π by default.
    multiplier : float, optional
        Value of a whole period, 1 by default.

    Returns
    -------
    array
        Of the same shape; a constant phase becomes the middle of the range.

    Raises
    ------
    ValueError, TypeError
        If the range is empty, or the phase is empty or not real.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import normalize_phase
    >>> normalize_phase(np.asarray([-1.0, 0.0, 3.0]), 0.0, 1.0).tolist()
    [0.0, 0.25, 1.0]
    """
    phase = _phase("phase", phase, None)
    if 0 in phase.shape:
        raise ValueError(f"phase must not be empty, got {list(phase.shape)}")
    if period is not None or multiplier is not None:
        if (range_min, range_max) != (0.0, 2 * math.pi):
            raise ValueError("range_min and range_max exclude period and multiplier, got both")
        period = _validate.real("period", 2 * math.pi if period is None else period, positive=True)
        multiplier = _validate.real("multiplier", 1.0 if multiplier is None else multiplier)
        return phase % period / period * multiplier
    _validate.number("range_min", range_min)
    _validate.number("range_max", range_max)
    if not range_max > range_min:
        raise ValueError(f"range_max must be larger than range_min = {range_min!r}, got {range_max!r}")
    xp = _array.namespace(phase)
    low, high = xp.min(phase), xp.max(phase)
    flat = high == low
    unit = (phase - low) / xp.where(flat, xp.ones_like(high), high - low)
    return range_min + (range_max - range_min) * xp.where(flat, xp.full_like(unit, 0.5), unit)


def within_range(phase: ArrayT, phase_range: float) -> ArrayT:
    """Return a phase limited to a modulator's range 0 … range, beyond which it takes the nearer end.

    Light knows a phase up to multiples of 2π, whatever the range: that is what the phase is wrapped by.

    Parameters
    ----------
    phase : array
        Phase in radians, of any shape.
    phase_range : float
        Largest phase that the modulator shows, in radians. Beyond 2π, a phase inside the range is kept.

    Returns
    -------
    array
        Of the same shape.
    """
    xp = _array.namespace(phase)
    turn = 2 * math.pi
    wrapped = xp.remainder(phase, turn * max(1, math.ceil(phase_range / turn)))
    if phase_range == turn:
        return wrapped
    if phase_range > turn:
        return xp.where(wrapped > phase_range, wrapped - turn, wrapped)
    nearest = xp.where(wrapped < (phase_range + turn) / 2, xp.full_like(wrapped, phase_range), xp.zeros_like(wrapped))
    return xp.where(wrapped > phase_range, nearest, wrapped)


def produce_phase_only_slm_pattern(
    hologram: Array,
    slm_range: float,
    filename: str | None = None,
    bits: int = 8,
    default_range: float | None = None,
    illumination: Array | None = None,
) -> tuple[Any, ...]:
    """Return the field of a hologram quantised for a phase-only modulator, and its integer levels.

    Parameters
    ----------
    hologram : array
        Complex hologram ``[..., rows, columns]``; its phase is what counts.
    slm_range : float
        Phase range of the modulator in radians: level ℓ shows ℓ/2^bits·slm_range. The phase is wrapped by 2π; below
        2π, a phase beyond the range takes its nearer end.
    filename : str, optional
        Where to save the pattern, black level 0 and white level 2^bits − 1 (with 8 bits the file holds the levels).
    bits : int
        Bits per pixel, 1 to 16.
    default_range : float, optional
        Phase range, in radians, over which the levels are spread when the field is rebuilt from them: by default
        `slm_range`, or 6.28, as in earlier versions, where `slm_range` is 2π to three digits.
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

    Examples
    --------
    With 2 bits the phases 0 and π are the levels 0 and 2:

    >>> import numpy as np
    >>> from odak.wave import produce_phase_only_slm_pattern
    >>> hologram = np.asarray([[1 + 0j, -1 + 0j]])
    >>> field, levels = produce_phase_only_slm_pattern(hologram, 2 * np.pi, bits=2, default_range=2 * np.pi)
    >>> levels.tolist(), field.real.round(6).tolist()
    ([[0, 2]], [[1.0, -1.0]])
    """
    hologram = _validate.image("hologram", hologram)
    slm_range = _validate.constant("slm_range", slm_range, positive=True)
    levels = 2 ** _validate.integer("bits", bits, minimum=1)
    xp = _array.namespace(hologram)
    if default_range is None:
        default_range = 6.28 if round(slm_range, 2) == 6.28 else slm_range
    _validate.real("default_range", default_range)
    amplitude = 1.0 if illumination is None else _as_floats("illumination", illumination, hologram)
    if illumination is not None:
        _validate.fitting(illumination=amplitude, hologram=hologram)
    if filename is not None and hologram.ndim != 2:
        raise ValueError(f"hologram must be [rows, columns] to be saved, got {tuple(hologram.shape)}")
    phase = within_range(calculate_phase(hologram), min(slm_range, 2 * math.pi))
    pattern = xp.clip(xp.floor(phase / slm_range * levels), 0, levels - 1)
    if filename is not None:
        from odak.tools.file import save_image

        array = pattern.detach().cpu().numpy() if _array.is_torch(pattern) else pattern
        save_image(filename, array, cmin=0, cmax=levels - 1, color_depth=8 if bits <= 8 else 16)
    field = generate_complex_field(amplitude, pattern * (default_range / levels))
    return field, xp.astype(pattern, xp.int32)


class PowerLoss(NamedTuple):
    """Shares of the power that a step of a propagation lost, of what it was given.

    Attributes
    ----------
    step : str
        What the light passed.
    band : float or array
        Beyond the frequencies that the method or the distance lets through.
    aperture : float or array
        Blocked by an aperture or absorbed by a mask.
    window : float or array
        Beside the window that the step returns.

    Examples
    --------
    >>> from odak.wave import PowerLoss
    >>> PowerLoss("lens", aperture=0.25, window=0.05).kept
    0.7
    """

    step: str
    band: Any = 0.0
    aperture: Any = 0.0
    window: Any = 0.0

    @property
    def kept(self) -> float:
        """Return the share that is left."""
        return 1 - float(self.band) - float(self.aperture) - float(self.window)


class power_budget:
    """Context that notes which share of its power light loses at each step: by band, by aperture and by window.

    All propagations, windows, first-order systems and elements of benches that are called within the context take
    part, one behind the other as in :class:`optical_bench`. Sums over all fields of a batch are compared. Tensors on a
    GPU are read when a share is asked for, not before.

    Attributes
    ----------
    steps : list of PowerLoss
        The steps in their order.

    Examples
    --------
    A slit that a plane wave fills half, and its light 5 cm behind on the grid of the slit:

    >>> import numpy as np
    >>> from odak.wave import FreeSpace, RectangularAperture, optical_bench, power_budget
    >>> bench = optical_bench([RectangularAperture(8e-4, 2e-4), FreeSpace(5e-3)], 532e-9)
    >>> with power_budget() as budget:
    ...     field, pitch = bench.propagate(np.ones((100, 50), complex), 8e-6)
    >>> round(budget.aperture, 2), round(budget.kept + budget.aperture + budget.band + budget.window, 9)
    (0.5, 1.0)
    """

    def __init__(self):
        self.steps: list[PowerLoss] = []
        self._token: Any = None

    def __enter__(self) -> Any:
        self._token = _BUDGETS.set((*_BUDGETS.get(), self))
        return self

    def __exit__(self, *error: Any) -> None:
        _BUDGETS.reset(self._token)

    def __str__(self) -> str:
        rows = [(one.step, one.band, one.aperture, one.window, one.kept) for one in self.steps]
        rows.append(("all", self.band, self.aperture, self.window, self.kept))
        lines = [f"{'':29}{'band':>9}{'aperture':>9}{'window':>9}{'kept':>9}"]
        lines += [
            f"{name:29}" + "".join(f"{round(float(share), 6) + 0.0:9.2%}" for share in shares) for name, *shares in rows
        ]
        return "\n".join(lines)

    @property
    def kept(self) -> float:
        """Return the share of the power of the first step that is left behind the last."""
        return math.prod(one.kept for one in self.steps)

    @property
    def band(self) -> float:
        """Return the share lost beyond the frequencies that propagations let through."""
        return self._lost("band")

    @property
    def aperture(self) -> float:
        """Return the share lost at apertures and masks."""
        return self._lost("aperture")

    @property
    def window(self) -> float:
        """Return the share lost beside windows."""
        return self._lost("window")

    def _lost(self, kind: str) -> float:
        left, lost = 1.0, 0.0
        for one in self.steps:
            lost, left = lost + left * float(getattr(one, kind)), left * one.kept
        return lost


_BUDGETS: contextvars.ContextVar = contextvars.ContextVar("budgets", default=())


def budgets() -> tuple[Any, ...]:
    """Return the budgets that are open."""
    return _BUDGETS.get()


def note_loss(step: str, before: Array, after: Array, kind: str = "window", ratio: Any = 1.0, **more: Any) -> None:
    """Add a step to the open budgets: fields before and after it, and how much larger a sample's area is behind.

    `more` are shares of other kinds, which do not count for `kind`.
    """
    if _BUDGETS.get():
        given = power_of(before)
        lost = 1 - power_of(after) / given * ratio - sum(more.values())
        for budget in _BUDGETS.get():
            budget.steps.append(PowerLoss(step, **{kind: lost}, **more))


def power_of(field: Array) -> Any:
    """Return Σ|u|² of a field, without its derivatives, on its device."""
    if _array.is_torch(field):
        field = field.detach()
        return (field.real**2 + field.imag**2).sum() if field.is_complex() else (field**2).sum()
    return _array.namespace(field).sum(abs(field) ** 2)


def decompose_double_phase(tensor: Array) -> tuple[Any, ...]:
    """Return the two checkerboard parts of an image, each packed into half the columns.

    Parameters
    ----------
    tensor : array
        ``[..., h, w]``; odd sizes lose their last row or column.

    Returns
    -------
    tuple
        High and low part, each ``[..., h, w/2]``: high holds the samples (even, even) and (odd, odd), low the others.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import decompose_double_phase
    >>> high, low = decompose_double_phase(np.asarray([[1.0, 2.0], [3.0, 4.0]]))
    >>> high.tolist(), low.tolist()
    ([[1.0], [4.0]], [[2.0], [3.0]])
    """
    tensor = _validate.image("tensor", tensor)
    rows, columns = (n - n % 2 for n in tensor.shape[-2:])
    if not rows or not columns:
        raise ValueError(f"tensor must have at least 2 rows and 2 columns, got {tuple(tensor.shape)}")
    even_rows, odd_rows = tensor[..., 0:rows:2, :columns], tensor[..., 1:rows:2, :columns]
    high = _interleave_rows(even_rows[..., 0::2], odd_rows[..., 1::2])
    low = _interleave_rows(even_rows[..., 1::2], odd_rows[..., 0::2])
    return high, low


def compose_double_phase(component_high: Array, component_low: Array) -> Array:
    """Return the image whose checkerboard parts are given: the exact inverse of :func:`decompose_double_phase`.

    Parameters
    ----------
    component_high : array
        Samples (even, even) and (odd, odd) of the image, ``[..., h, w/2]``.
    component_low : array
        The other samples of the image, ``[..., h, w/2]``.

    Returns
    -------
    array
        ``[..., h, w]``.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import compose_double_phase
    >>> compose_double_phase(np.asarray([[1.0], [4.0]]), np.asarray([[2.0], [3.0]])).tolist()
    [[1.0, 2.0], [3.0, 4.0]]
    """
    component_high = _validate.image("component_high", component_high)
    component_low = _validate.image("component_low", component_low)
    _validate.shaped("component_low", component_low, f"{list(component_high.shape)} as component_high")
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


def uniform(shape: tuple[int, ...], seed: Seed, like: Any) -> Any:
    """Return numbers between 0 and 1, float64, in the library and on the device of an array.

    Parameters
    ----------
    shape : tuple of int
        Shape of the result.
    seed : int or generator, optional
        An integer gives NumPy arrays and tensors the same numbers. A generator is NumPy's or torch's own. None draws
        tensors from torch's generator, which `torch.manual_seed` seeds, and arrays anew each time.
    like : array
        What the result is like.

    Returns
    -------
    array
        float64.
    """
    seed = _validate.seed("seed", seed)
    own = isinstance(seed, np.random.Generator)
    if _array.is_torch(like) and not own and not isinstance(seed, int):
        import torch

        device = "cpu" if seed is None else seed.device
        drawn = torch.rand(shape, generator=seed, dtype=torch.float64, device=device)
    elif seed is None or own or isinstance(seed, int):
        drawn = np.random.default_rng(seed).random(shape)
    else:
        raise TypeError(f"seed must be an integer or a numpy.random.Generator for arrays, got {type(seed).__name__}")
    return _array.cast(drawn, like, _array.namespace(like).float64)


# Taken at once, 16 bytes for each pair of points: their distances and phases then stay in the cache.
_CHUNK_BYTES = 1 << 22


def electric_field_per_plane_wave(
    amplitude: float | Array, opd: float | Array, k: float, phase: float | Array = 0, w: float = 0, t: float = 0
) -> complex | Array:
    """Return A·exp(i(−ω·t + k·opd + phase))/opd².

    Parameters
    ----------
    amplitude : float or array
        Amplitude A.
    opd : float or array
        Optical path difference in metres, not zero.
    k : float
        Wave number in rad/m.
    phase : float or array, default: 0
        Initial phase in radians.
    w : float, default: 0
        Angular frequency ω in rad/s.
    t : float, default: 0
        Time in seconds.

    Returns
    -------
    complex or array
        The field.

    Raises
    ------
    ValueError
        If an optical path difference is zero.

    Examples
    --------
    After a whole wavelength the phase is what it was, and the amplitude is A/opd²:

    >>> from odak.wave import electric_field_per_plane_wave, wavenumber
    >>> field = electric_field_per_plane_wave(8.0, 2.0, wavenumber(2.0))
    >>> round(float(field.real), 9), round(abs(float(field.imag)), 9)
    (2.0, 0.0)
    """
    for name, value in (("k", k), ("w", w), ("t", t)):
        _validate.real(name, value)
    _validate.real("opd", opd, nonzero=True)
    given = {"amplitude": amplitude, "opd": opd, "phase": phase}
    arrays = {name: _validate.array(name, _validate.given(name, value)) for name, value in given.items()}
    if not any(array.ndim or _array.is_array(given[name]) for name, array in arrays.items()):
        for name, value in (("k", k), ("w", w), ("t", t)):
            _validate.number(name, value)
        angle = math.remainder(-w * t + k * opd + _validate.real("phase", phase), 2 * math.pi)
        return amplitude * complex(math.cos(angle), math.sin(angle)) / opd**2
    _validate.fitting(**arrays, k=k, w=w, t=t)
    kinds = [value for value in given.values() if _array.is_array(value)] or list(arrays.values())
    xp = _array.namespace(*kinds)
    dtype = xp.complex128 if any(_array.is_double(value) for value in kinds) else xp.complex64
    amplitude = _array.cast(arrays["amplitude"], kinds[0], xp.complex128)
    # The phase spans many cycles of 2π, which 32 bits do not resolve.
    opd, phase = (_array.cast(arrays[name], kinds[0], xp.float64) for name in ("opd", "phase"))
    return xp.astype(amplitude * _array.phasor(k * opd + (phase - w * t)) / opd**2, dtype, copy=False)


def propagate_plane_waves(field: Array, opd: float | Array, k: float, w: float = 0, t: float = 0) -> Array:
    """Return a field carried over an optical path difference: u·exp(i(−ω·t + k·opd))/opd².

    Parameters
    ----------
    field : array
        Complex field.
    opd : float or array
        Optical path difference in metres, not zero.
    k : float
        Wave number in rad/m.
    w : float, default: 0
        Angular frequency ω in rad/s.
    t : float, default: 0
        Time in seconds.

    Returns
    -------
    array
        The field, of the same shape.

    Raises
    ------
    ValueError
        If an optical path difference is zero.

    Examples
    --------
    Half a wavelength reverses the sign:

    >>> import numpy as np
    >>> from odak.wave import propagate_plane_waves, wavenumber
    >>> propagate_plane_waves(np.asarray([4 + 0j]), 2.0, wavenumber(4.0)).real.round(6).tolist()
    [-1.0]
    """
    field = _validate.given("field", field)
    _validate.fitting(field=field, opd=_validate.array("opd", opd), k=k, w=w, t=t)
    return field * electric_field_per_plane_wave(1.0, opd, k, 0, w, t)


def propagate_field(points0: Array, points1: Array, field0: Array, wave_number: float, direction: int = 1) -> Array:
    """Return the field that point sources cause at other points: Σ_p |u_p|·exp(i(k·direction·d_pq + arg u_p))/d_pq².

    Parameters
    ----------
    points0 : array
        Sources ``[p, 3]``, in one unit of length.
    points1 : array
        Targets ``[q, 3]`` in the same unit.
    field0 : array
        Complex field ``[p]`` at the sources.
    wave_number : float
        2π/λ in radians per that unit.
    direction : int, default: 1
        +1 forward, −1 backward in time.

    Returns
    -------
    array
        Complex field ``[q]``.

    Raises
    ------
    ValueError
        If the shapes do not match, or a target lies on a source.

    Examples
    --------
    Two sources whose distances to the target differ by half a wavelength cancel each other, but for their distances:

    >>> import numpy as np
    >>> from odak.wave import propagate_field, wavenumber
    >>> sources = np.asarray([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    >>> target = np.asarray([[0.0, 0.0, 100.0]])
    >>> field = propagate_field(sources, target, np.asarray([1 + 0j, 1 + 0j]), wavenumber(1.0))
    >>> round(float(abs(field[0])) * 100**2, 2)
    0.01
    """
    for name, points in (("points0", points0), ("points1", points1)):
        if not _array.is_array(points) or points.ndim != 2 or points.shape[-1] != 3:
            raise ValueError(f"{name} must be an array of shape [n, 3], got {getattr(points, 'shape', type(points))}")
        _validate.array(name, points)
    _validate.number("wave_number", wave_number)
    if _validate.integer("direction", direction, minimum=-1) == 0 or direction > 1:
        raise ValueError(f"direction must be 1 or -1, got {direction}")
    _validate.shaped(
        "field0", _validate.array("field0", field0, like=points0), f"[{points0.shape[0]}], a value for each of points0"
    )
    xp = _array.namespace(points0, points1, field0)
    field0 = _array.to_complex(_validate.array("field0", field0, like=points0))
    real = xp.float64 if field0.dtype == xp.complex128 else xp.float32
    sources = xp.astype(points0, xp.float64).T
    rows = max(1, _CHUNK_BYTES // (16 * max(1, points0.shape[0])))
    count, parts = points1.shape[0], []
    for start in range(0, count, rows):
        targets = xp.astype(points1[start : min(start + rows, count), :], xp.float64)
        x, y, z = (targets[:, axis : axis + 1] - sources[axis, :] for axis in range(3))
        squared = x * x + y * y + z * z
        if xp.any(squared == 0):
            raise ValueError("points1 must not coincide with a point of points0: the distance is zero there")
        wave = _array.phasor(direction * wave_number * xp.sqrt(squared), field0.dtype)
        parts.append((wave / xp.astype(squared, real)) @ field0)
    return xp.concat(parts) if parts else xp.zeros(0, dtype=field0.dtype)
