"""First-order optical systems: Collins' integral with the pitch that each plane needs, and benches of elements."""

import inspect
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from odak import _array, _show, _validate
from odak._array import Array, Numbers, phasor_of_cycles
from odak._warnings import SamplingWarning, warn
from odak.jones.calculus import polarizer, retarder
from odak.wave.elements import share_in_disc, share_in_strip, thin_lens
from odak.wave.fields import budgets, note_loss, power_of
from odak.wave.fourier import centred, fourier_sum
from odak.wave.methods import check_has_kernel, find_method
from odak.wave.polarized import apply_jones, phase_modulator
from odak.wave.propagation import propagate_beam
from odak.wave.sampling import (
    FOCAL,
    Weaker,
    plain_numbers,
    sampled_axes,
    undersampling,
    warn_beyond_nyquist,
    warn_of_factor,
)
from odak.wave.transfer_functions import check_geometry, fraction_of_cycles, pitches
from odak.wave.windows import propagate_to_window

if TYPE_CHECKING:
    import PIL.Image

# In signatures: a pixel pitch, of rows and columns alike or each; and a ray matrix, for both axes or each.
Pitch: TypeAlias = float | Sequence[float] | Array
RayMatrix: TypeAlias = Sequence[Sequence[float | Array]] | Array
RayMatrices: TypeAlias = RayMatrix | tuple[RayMatrix, RayMatrix]
_PADDED = (True, False, True)


@_validate.takes_units("dx", "wavelength", "path_length")
def propagate_abcd(
    field: Array,
    matrix: RayMatrices,
    dx: Pitch,
    wavelength: float | Array,
    output_dx: Pitch | None = None,
    output_shape: Sequence[int] | None = None,
    path_length: float | Array = 0.0,
    offset: Numbers = (0.0, 0.0),
) -> tuple[Array, Any]:
    """Propagate a field through a first-order system of lenses, mirrors and spaces, given by its ray matrix.

    The pitch of the result is free, so that one step goes from a display of 300 mm to an image of 30 mm, through a
    telescope or to a focus.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``.
    matrix : array or sequence
        Ray matrix ``[[A, B], [C, D]]`` of determinant 1, acting on (height, angle), an array or nested sequences whose
        entries may be tensors; or a tuple of two such matrices (rows, columns) for a system with cylindrical lenses.
    dx : float or sequence of float
        Pixel pitch of the field in metres, one number or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array broadcasts against the field's leading axes.
    output_dx : float or sequence of float, optional
        Pixel pitch of the result. By default |A|·dx where the field is imaged or nearly so, |B/A| < N·dx²/λ, and
        λ·|B|/(N·dx) elsewhere, which spans all that the pitch of the field can send; several wavelengths then need it.
    output_shape : sequence of int, optional
        Rows and columns of the result; by default the shape of the field.
    path_length : float
        Optical path along the axis in metres, whose phase exp(ikL) is applied.
    offset : sequence of float
        Place (y, x) of the middle of the result in metres.

    Returns
    -------
    tuple
        Field ``[..., rows, columns]`` in the library and precision of `field`, and its pixel pitch: a number, or a pair
        (rows, columns) where the two differ. Differentiable in the field and in every number that is a tensor.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it, or the determinant is not 1.

    Notes
    -----
    Collins, J. Opt. Soc. Am. 60, 1168 (1970): u₂(x₂) = exp(ikL)/(iλB)·∬u₁·exp(iπ(A·x₁² − 2x₁·x₂ + D·x₂²)/(λB)). It
    separates into rows and columns. Where B/A is large it is one chirp-z transform; elsewhere the matrix is taken apart
    into Fresnel propagation over B/A, magnification by A, and a lens, all within chirp-z transforms, on twice the grid.
    Paraxial, as ray matrices are.

    The field is the band-limited interpolation of its samples, without the orders of a grid of points: beyond
    λ|B|/(2·dx) + |A|·N·dx/2 from the axis, where none of its light arrives, the result is dark.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import propagate_abcd
    >>> telescope = np.array([[-0.1, 0.0], [0.0, -10.0]])
    >>> field, pitch = propagate_abcd(np.ones((64, 64), complex), telescope, 40e-6, 532e-9)
    >>> field.shape, round(pitch * 1e6, 6)
    ((64, 64), 4.0)
    """
    field = given_field = _array.to_complex(_validate.image("field", field))
    _validate.real("path_length", path_length)
    check_geometry(None, path_length, dx, wavelength, tuple(field.shape[:-2]))
    for name, given in (("dx", dx), ("output_dx", output_dx)):
        for pitch in () if given is None else pitches(given, name):
            _validate.number(name, pitch, positive=True)
    xp = _array.namespace(field)
    matrices: Any = matrix if _is_pair(matrix) else (matrix, matrix)
    counts = tuple(field.shape[-2:]) if output_shape is None else _validate.size("output_shape", output_shape)
    given = (None, None) if output_dx is None else pitches(output_dx, "output_dx")
    like = xp.zeros((1, 1), dtype=xp.float64, device=_array.device_of(field))
    wave = _per_field(wavelength, like)
    found = []
    places = _validate.several("offset", offset, 2)
    for axis, entries, pitch, wanted, count, place in zip(
        (-2, -1), matrices, pitches(dx), given, counts, places, strict=True
    ):
        system = _entries(entries, like)
        field, out = _along_axis(field, system, _array.cast(pitch, like), wanted, count, wave, axis, place)
        found.append(out)
    if _array.is_array(path_length) or path_length != 0:
        cycles = fraction_of_cycles(_array.cast(path_length, like), wave)
        field = field * phasor_of_cycles(cycles, field.dtype)
    if budgets():
        (dy, dx), (down, across) = (_array.cast(p, like) for p in pitches(dx)), found
        note_loss("propagate_abcd", given_field, field, ratio=down * across / (dy * dx))
    plain = [float(p) if not _array.is_traced(p) else p for p in found]
    same = not any(_array.is_traced(p) for p in plain) and plain[0] == plain[1]
    return field, plain[0] if same else tuple(plain)


@_validate.takes_units("focal_length", "dx", "wavelength", "distance")
def lens_fourier_transform(
    field: Array,
    focal_length: float,
    dx: float | Sequence[float],
    wavelength: float | Array,
    distance: float | None = None,
    output_dx: float | Sequence[float] | None = None,
    output_shape: Sequence[int] | None = None,
) -> tuple[Any, ...]:
    """Return the field in the back focal plane of a thin lens: the Fourier transform of the field in front of it.

    Use it for a modulator with a lens behind it, for the filter plane of a 4f system, or for the focus of a pupil.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``.
    focal_length : float
        Focal length in metres.
    dx : float or sequence of float
        Pixel pitch of the field in metres, one number or a pair (rows, columns).
    wavelength : float or array
        Wavelength in metres; an array broadcasts against the field's leading axes, and needs `output_dx`.
    distance : float, optional
        Distance in metres from the field to the lens; by default the focal length. At another distance, 0 for a field
        at the lens, the result has the curvature exp(iπ(1 − distance/focal_length)·(x² + y²)/(λ·focal_length)).
    output_dx : float or sequence of float, optional
        Pixel pitch of the result in metres; by default λ·focal_length/(N·dx) along an axis of N samples.
    output_shape : sequence of int, optional
        Rows and columns of the result; by default the shape of the field.

    Returns
    -------
    tuple
        Field ``[..., rows, columns]`` and its pixel pitch, as :func:`propagate_abcd` returns them.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    See Also
    --------
    propagate_abcd : Any first-order system.
    fraunhofer : The far field without a lens.

    Notes
    -----
    exp(ik(distance + focal_length))/(iλ·focal_length)·F{u}·dx² for a field in the front focal plane, and power is kept
    (Goodman, Introduction to Fourier Optics (2005), section 5.2). The lens is larger than the light that meets it.

    Examples
    --------
    A slit of 0.4 mm behind a lens of 200 mm is dark first at λf/D:

    >>> import numpy as np
    >>> from odak.wave import lens_fourier_transform
    >>> slit = np.zeros((64, 64), complex)
    >>> slit[:, 7:57] = 1
    >>> focus, pitch = lens_fourier_transform(slit, 0.2, 8e-6, 532e-9, None, 532e-9 * 0.2 / 0.4e-3, (3, 3))
    >>> round(pitch * 1e6, 3), bool(abs(focus[1, 2]) < 1e-9 * abs(focus[1, 1]))
    (266.0, True)
    """
    _validate.number("focal_length", focal_length, positive=True)
    if distance is None:
        distance = focal_length
    _validate.number("distance", distance)
    matrix = [[0.0, focal_length], [-1 / focal_length, 1 - distance / focal_length]]
    return propagate_abcd(field, matrix, dx, wavelength, output_dx, output_shape, distance + focal_length)


@_validate.takes_units("focal_length", "dx", "wavelength")
def filter_in_focal_plane(
    field: Array,
    mask: Callable[..., Any],
    focal_length: float,
    dx: float | Sequence[float],
    wavelength: float,
    scales: int = 4,
) -> Array:
    """Return a field after a lens, a mask in its focal plane and a second lens of the same focal length.

    Use it for masks with detail much finer than a diffraction pattern, such as the vortex or the small stop of a
    coronagraph: about the axis they are sampled on several scales, each 8 times finer than the one before.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]`` in the front focal plane of the first lens.
    mask : callable
        ``mask(y, x)`` returns the amplitude transmission at places in metres from the axis, for arrays that broadcast.
    focal_length : float
        Focal length of both lenses in metres.
    dx : float or sequence of float
        Pixel pitch of the field in metres, one number or a pair (rows, columns).
    wavelength : float
        Wavelength in metres.
    scales : int
        Number of samplings of the focal plane. With 1 the whole plane has two samples for each λ·focal_length/(N·dx).

    Returns
    -------
    array
        Complex field ``[..., rows, columns]`` in the back focal plane of the second lens, of the same pitch: the field
        given, turned by 180° and filtered. Differentiable in the field.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    The mask is taken apart by smooth windows about the axis, which add up to one, and each part is a Fourier transform
    to its own window and back (Soummer, Pueyo, Sivaramakrishnan and Vanderbei, Opt. Express 15, 15935 (2007)). Of the
    light of a disc behind a vortex of charge 2, all of which should leave the disc (Mawet, Riaud, Absil and Surdej,
    Astrophys. J. 633, 1191 (2005)), 4e-5 remain with one scale and less than 2e-9 with more, for a disc of 205 pixels
    across; of charges 4, 6 and 8 less than 2e-8 with four scales. The light of a sharp edge does not end at
    λ·focal_length/(2·dx), where samples begin to repeat it: between two and four thirds of this place it falls smoothly
    to nothing, and `mask` is called for places up to twice as far as it. A mask of ones is met to 1e-5.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import circular_aperture, filter_in_focal_plane
    >>> def vortex(y, x):
    ...     turn = x + 1j * y
    ...     return (turn / np.maximum(abs(turn), 1e-30)) ** 2
    >>> star = circular_aperture((128, 128), 1e-4, 5.1e-3) + 0j
    >>> left = filter_in_focal_plane(star, vortex, 1.0, 1e-4, 1e-6)
    >>> inside = circular_aperture((128, 128), 1e-4, 4.6e-3) > 0
    >>> bool((abs(left[inside]) ** 2).sum() < 2e-5 * (abs(star) ** 2).sum())
    True
    """
    field = _array.to_complex(_validate.image("field", field))
    _validate.function("mask", mask)
    focal_length = _validate.constant("focal_length", focal_length, positive=True)
    wavelength = _validate.constant("wavelength", wavelength, positive=True)
    steps = [_validate.constant("dx", step, positive=True) for step in pitches(dx)]
    scales = _validate.integer("scales", scales, minimum=1)
    xp, shape = _array.namespace(field), tuple(field.shape[-2:])
    like = xp.zeros((), dtype=xp.float64, device=_array.device_of(field))
    finest = [wavelength * focal_length / (2 * n * step) for n, step in zip(shape, steps, strict=True)]
    radius = _WINDOW_RADIUS * max(finest)
    radii = [radius / _FINER**i for i in range(scales - 1)]
    grids = [(finest, tuple(2 * n for n in shape))]
    grids += [([2 * r / _WINDOW_SAMPLES] * 2, (_WINDOW_SAMPLES, _WINDOW_SAMPLES)) for r in radii]
    # The finest grids have pitches that a caller would not mean, which takes_units refuses.
    transform, matrix = inspect.unwrap(propagate_abcd), [[0.0, focal_length], [-1 / focal_length, 0.0]]
    result: Any = 0.0
    for i, (there, counts) in enumerate(grids):
        y, x = (centred(like, n, axis) * step for n, step, axis in zip(counts, there, (-2, -1), strict=True))
        seen, _ = transform(field, matrix, steps, wavelength, there, counts, 2 * focal_length)
        if i == 0:
            # Light of samples repeats itself: each place shares it with its likes one period of the samples aside.
            periods = [wavelength * focal_length / step for step in steps]
            parts = list(itertools.product(*(_shared(p, period) for p, period in zip((y, x), periods, strict=True))))
        else:
            parts = [((y, 1.0), (x, _inside(y, x, radii[i - 1])))]
        passed: Any = 0.0
        for (v, down), (u, across) in parts:
            share = down * across - (_inside(v, u, radii[i]) if i < len(radii) else 0.0)
            passed = passed + _array.cast(mask(v, u), seen) * share
        seen = seen * xp.astype(passed, field.dtype)
        back, _ = transform(seen, matrix, there, wavelength, steps, shape, 2 * focal_length)
        result = result + back
    return result


# Of the finer samplings of a focal plane: samples along a side, radius of the first in samples of the whole plane, and
# how much finer each is than the one before.
_WINDOW_SAMPLES, _WINDOW_RADIUS, _FINER = 256, 32, 8


def _inside(y, x, radius: float):
    """Return a window that is 1 within half a radius and 0 outside it, smooth in all derivatives."""
    xp = _array.namespace(y)
    share = xp.clip(2 * xp.sqrt(y**2 + x**2) / radius - 1, 1e-9, 1 - 1e-9)
    falling, rising = xp.exp(-1 / (1 - share)), xp.exp(-1 / share)
    return falling / (falling + rising)


def _shared(places, period: float):
    """Return places along an axis and one period aside, each with its share, which falls smoothly and adds up to 1."""
    beyond = _array.namespace(places).where(places < 0, places + period, places - period)
    return [(v, _inside(v, 0 * v, 2 / 3 * period)) for v in (places, beyond)]


def _is_pair(matrix) -> bool:
    """Return whether a ray matrix is a pair of them, for rows and columns."""
    return isinstance(matrix, tuple) and len(matrix) == 2 and _is_matrix(matrix[0])


def _is_matrix(value) -> bool:
    return getattr(value, "ndim", 0) == 2 or (isinstance(value, (list, tuple)) and isinstance(value[0], (list, tuple)))


def _entries(matrix, like):
    """Return A, B, C and D as float64 scalars in the library of `like`, after checking that A·D − B·C = 1."""
    try:
        rows = [[matrix[i][j] for j in range(2)] for i in range(2)]
        fits = len(matrix) == 2 and all(len(row) == 2 for row in matrix)
    except (TypeError, IndexError):
        fits = False
    if not fits:
        raise ValueError(f"matrix must be [[A, B], [C, D]], or a tuple of two of them, got {matrix!r:.100}")
    (a, b), (c, d) = [[_array.cast(_validate.real("matrix", value), like) for value in row] for row in rows]
    if all(_array.is_readable(value) for value in (a, b, c, d)):
        determinant, scale = (_validate.numbers(value)[0] for value in (a * d - b * c, a * d))
        if abs(determinant - 1) > 1e-6 * max(1.0, abs(scale)):
            raise ValueError(f"matrix must have the determinant A·D − B·C = 1, got {determinant:.9g}")
    return (a, b), (c, d)


def _along_axis(field, system, pitch, wanted, count: int, wavelength, axis: int, place):
    """Return the field after the system along one axis, about a place there, and its pitch."""
    xp, ((a, b), (c, d)) = _array.namespace(field), system
    moved = _array.is_array(place) or place != 0
    place = _array.cast(place, wavelength) if moved else 0.0
    n = field.shape[axis]
    numbers = [min(_validate.numbers(value)) for value in (a, b, pitch, wavelength)]
    # On twice the grid the longer wavelengths are exact too, up to twice the shortest.
    imaged = abs(numbers[1]) * numbers[3] < abs(numbers[0]) * n * numbers[2] ** 2
    if wanted is not None:
        _validate.real("output_dx", wanted, positive=True)
        out = _array.cast(wanted, wavelength)
    elif not imaged and wavelength.ndim:
        raise ValueError("output_dx must be given for several wavelengths, whose own pitches λ·|B|/(N·dx) differ")
    else:
        out = xp.abs(a) * pitch if imaged else wavelength * xp.abs(b) / (n * pitch)
    positions = centred(wavelength, count, axis) * out + place
    # Half the window, and where light of the highest frequency of the field's middle, and of its edge, arrives.
    half, step = count // 2 * min(_validate.numbers(out)) + abs(_validate.numbers(place)[0]), numbers[2]
    middle, edge = numbers[3] * abs(numbers[1]) / (2 * step), abs(numbers[0]) * n * step / 2
    backwards = numbers[1] < 0
    if imaged:
        # Fresnel propagation over B/A, magnification by A, and a lens of power −C/A.
        frequencies = centred(wavelength, 2 * n, axis) / (2 * n * pitch)
        spectrum = fourier_sum(field, xp.ones_like(wavelength) / (2 * n), 2 * n, -1, axis)
        cycles = -wavelength * b / a * frequencies**2 / 2
        cycles = cycles + frequencies * place / a if moved else cycles
        spectrum = spectrum * phasor_of_cycles(cycles, field.dtype)
        result = fourier_sum(spectrum, out / (a * pitch * 2 * n), count, +1, axis) / (2 * n)
        quarter = (0.25 if backwards else -0.25) if numbers[0] < 0 else 0.0
        cycles = c * positions**2 / (2 * a * wavelength) + quarter
        amplitude, reach = 1 / xp.sqrt(xp.abs(a)), xp.abs(a) * n * pitch
    else:
        if half > (middle - edge) * (1 + 1e-9):
            # The sum repeats itself at λ|B| over the pitch of the samples, which light at the edges would reach.
            field, pitch = between_samples(field, wavelength, axis), pitch / 2
        source = centred(wavelength, field.shape[axis], axis) * pitch
        cycles = a * source**2 / (2 * b * wavelength)
        cycles = cycles - source * place / (b * wavelength) if moved else cycles
        field = field * phasor_of_cycles(cycles, field.dtype)
        result = fourier_sum(field, pitch * out / (wavelength * b), count, -1, axis)
        cycles = d * positions**2 / (2 * b * wavelength) + (0.125 if backwards else -0.125)
        amplitude = pitch / xp.sqrt(wavelength * xp.abs(b))
        reach = wavelength * xp.abs(b) / (2 * step) + edge
    if half > middle + edge:
        result = result * xp.astype(xp.abs(positions) <= reach, field.dtype)
    result = result * phasor_of_cycles(cycles, field.dtype) * xp.astype(amplitude, field.dtype)
    return xp.astype(result, field.dtype, copy=False), xp.reshape(out, ())


def between_samples(field: Array, like: Any, axis: int) -> Any:
    """Return the band-limited interpolation of a field at half its pitch, over twice its width."""
    n = field.shape[axis]
    step = _array.namespace(like).ones_like(like) / (4 * n)
    return fourier_sum(fourier_sum(field, 2 * step, 2 * n, -1, axis), step, 4 * n, +1, axis) / (2 * n)


@_validate.takes_units("distance", "window_dx", "offset")
@dataclass(frozen=True)
class FreeSpace:
    """Free space, or a homogeneous medium, of a bench.

    Attributes
    ----------
    distance : float or tensor
        Length in metres.
    propagation_type : str
        Propagation type, see :func:`odak.wave.propagate_beam`; fields are padded to twice their size. Not used where
        the window differs from the field.
    window_shape : tuple of int, optional
        Rows and columns of the result, where it is to differ from the field: see :func:`odak.wave.propagate_to_window`.
    window_dx : float or pair, optional
        Pixel pitch of the result in metres.
    offset : tuple
        Place (y, x) of the window's centre in metres; elements behind are placed relative to it.
    index : float or tensor
        Refractive index of the medium.

    Examples
    --------
    >>> from odak.wave import FreeSpace
    >>> FreeSpace(0.3, index=1.5).matrix()
    [[1.0, 0.19999999999999998], [0.0, 1.0]]
    """

    distance: float | Array
    propagation_type: str = "auto"
    window_shape: Sequence[int] | None = None
    window_dx: Pitch | None = None
    offset: Numbers = (0.0, 0.0)
    index: float | Array = 1.0

    def __post_init__(self) -> None:
        _validate.real("index", self.index, positive=True)

    def apply(self, field: Array, pitch: Pitch, wavelength: float | Array) -> tuple[Array, Pitch]:
        """Return the field behind the element and its pixel pitch.

        Parameters
        ----------
        field : array
            Complex field ``[..., rows, columns]`` in front of the element.
        pitch : float or array
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float or array
            Wavelength in vacuum in metres.
        """
        wavelength = wavelength / self.index
        # A tensor may require the derivative at zero.
        on_axis = all(not _array.is_array(place) and place == 0 for place in self.offset)
        if self.window_shape is None and self.window_dx is None and on_axis:
            _check_keeps_pitch(self.propagation_type)
            name = self.propagation_type
            result = propagate_beam(field, None, self.distance, pitch, wavelength, name, zero_padding=_PADDED)
            _warn_of_lost(self.distance, field, result)
            return result, pitch
        window = propagate_to_window(
            field, wavelength, self.distance, pitch, self.window_shape, self.window_dx, self.offset
        )
        return window, pitch if self.window_dx is None else self.window_dx

    def matrix(self) -> list[list[float | Array]]:
        """Return the ray matrix."""
        return [[1.0, self.distance / self.index], [0.0, 1.0]]


def _warn_of_lost(distance, field, result) -> None:
    """Warn where a space keeps less than 99 % of the power on the grid of the field.

    Not of tensors that require a gradient, which are optimised, nor of those on a GPU, which are not read.
    """
    if _array.is_traced(field) or _array.is_traced(result) or _array.is_chunked(field):
        return
    before, after = float(power_of(field)), float(power_of(result))
    if after < 0.99 * before:
        length = f"{_validate.numbers(distance)[0]:.4g} m" if _array.is_readable(distance) else ""
        warn(
            f"FreeSpace keeps {after / before:.2g} of the power on the grid of the field over {length}; a larger field "
            "or a window (window_shape, window_dx) would hold more, and power_budget says where the rest went",
            SamplingWarning,
        )


@_validate.takes_units("focal", "offset")
@dataclass(frozen=True)
class ThinLens:
    """Thin lens of a bench.

    Attributes
    ----------
    focal : float or tensor
        Focal length in metres; positive converges.
    offset : tuple
        Position (y, x) of its axis in metres.

    Examples
    --------
    >>> from odak.wave import ThinLens
    >>> ThinLens(0.5).matrix()
    [[1.0, 0.0], [-2.0, 1.0]]
    """

    focal: float | Array
    offset: Numbers = (0.0, 0.0)

    def __post_init__(self) -> None:
        # Infinity is a lens without power.
        if not (isinstance(self.focal, float) and math.isinf(self.focal)):
            _validate.real("focal", self.focal, nonzero=True)

    def apply(self, field: Array, pitch: Pitch, wavelength: float | Array) -> tuple[Array, Pitch]:
        """Return the field behind the element and its pixel pitch.

        Parameters
        ----------
        field : array
            Complex field ``[..., rows, columns]`` in front of the element.
        pitch : float or array
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float or array
            Wavelength in vacuum in metres.
        """
        _warn_of_lens(self, field.shape[-2:], pitch, wavelength)
        return self.times(field, pitch, wavelength), pitch

    def times(self, field: Array, pitch: float | Sequence[float] | Array, wavelength: float | Array) -> Array:
        """Return a field times the transmission of the lens at its samples.

        Parameters
        ----------
        field : array
            Complex field ``[..., rows, columns]``.
        pitch : float or array
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float or array
            Wavelength in metres.
        """
        y, x = _positions(field, pitch, self.offset)
        focal, wave = (_per_field(value, y) for value in (self.focal, wavelength))
        return field * phasor_of_cycles(-(y**2 + x**2) / (2 * focal * wave), field.dtype)

    def matrix(self) -> list[list[float | Array]]:
        """Return the ray matrix."""
        return [[1.0, 0.0], [-1 / self.focal, 1.0]]


def _through(name: str, field, transmission):
    """Return a field behind a transmission."""
    result = field * transmission
    note_loss(name, field, result, "aperture")
    return result


def _warn_of_lens(lens, shape, pitch, wavelength, name="ThinLens") -> None:
    """Warn of a lens that is undersampled on a grid."""
    numbers = plain_numbers(*pitches(pitch), *lens.offset, lens.focal, wavelength)
    if numbers is not None:
        axes = sampled_axes(tuple(shape), numbers[:2], numbers[2:4])
        warn_beyond_nyquist(name, thin_lens, axes, numbers[4:], Weaker(0, 1, FOCAL))


@_validate.takes_units("radius", "offset")
@dataclass(frozen=True)
class CircularAperture:
    """Round aperture of a bench; samples of its rim transmit the part that is open, so that it is differentiable.

    Attributes
    ----------
    radius : float or tensor
        Radius in metres.
    offset : tuple
        Position (y, x) of its centre in metres.

    Examples
    --------
    The open area of a field of ones is the area of the disc:

    >>> import numpy as np
    >>> from odak.wave import CircularAperture
    >>> field, pitch = CircularAperture(1e-4).apply(np.ones((64, 64), complex), 8e-6, 532e-9)
    >>> round(float(field.real.sum()) * pitch**2 / (np.pi * 1e-4**2), 6)
    1.0
    """

    radius: float | Array
    offset: Numbers = (0.0, 0.0)

    def __post_init__(self) -> None:
        _validate.real("radius", self.radius, positive=True)

    def apply(self, field: Array, pitch: Pitch, wavelength: float | Array) -> tuple[Array, Pitch]:
        """Return the field behind the element and its pixel pitch.

        Parameters
        ----------
        field : array
            Complex field ``[..., rows, columns]`` in front of the element.
        pitch : float or array
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float or array
            Wavelength in vacuum in metres.
        """
        xp = _array.namespace(field)
        y, x = _positions(field, pitch, self.offset)
        radius, (dy, dx) = _per_field(self.radius, y), (_array.cast(value, y) for value in pitches(pitch))
        share = share_in_disc(y, x, (dy, dx), radius)
        return _through("CircularAperture", field, xp.astype(share, field.dtype)), pitch

    def extent(self) -> tuple[Any, Any]:
        """Return height and width in metres."""
        return 2 * self.radius, 2 * self.radius


@_validate.takes_units("height", "width", "offset")
@dataclass(frozen=True)
class RectangularAperture:
    """Rectangular aperture of a bench; samples of its edges transmit the part that is open.

    Attributes
    ----------
    height : float or tensor
        Height along rows in metres.
    width : float or tensor
        Width along columns in metres.
    offset : tuple
        Position (y, x) of its centre in metres.

    Examples
    --------
    The open area of a field of ones is the area of the rectangle:

    >>> import numpy as np
    >>> from odak.wave import RectangularAperture
    >>> field, pitch = RectangularAperture(1e-4, 2e-4).apply(np.ones((64, 64), complex), 8e-6, 532e-9)
    >>> round(float(field.real.sum()) * pitch**2 / 2e-8, 6)
    1.0
    """

    height: float | Array
    width: float | Array
    offset: Numbers = (0.0, 0.0)

    def __post_init__(self) -> None:
        _validate.real("height", self.height, positive=True)
        _validate.real("width", self.width, positive=True)

    def apply(self, field: Array, pitch: Pitch, wavelength: float | Array) -> tuple[Array, Pitch]:
        """Return the field behind the element and its pixel pitch.

        Parameters
        ----------
        field : array
            Complex field ``[..., rows, columns]`` in front of the element.
        pitch : float or array
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float or array
            Wavelength in vacuum in metres.
        """
        xp = _array.namespace(field)
        result = field
        for place, size, step in zip(
            _positions(field, pitch, self.offset), (self.height, self.width), pitches(pitch), strict=True
        ):
            size, step = _per_field(size, place), _array.cast(step, place)
            result = result * xp.astype(share_in_strip(place, step, size), field.dtype)
        note_loss("RectangularAperture", field, result, "aperture")
        return result, pitch

    def extent(self) -> tuple[Any, Any]:
        """Return height and width in metres."""
        return self.height, self.width


@dataclass(frozen=True)
class Mask:
    """Transmission of a bench: a mask, a hologram on a modulator, a phase plate.

    Attributes
    ----------
    transmission : array or callable
        Complex or real, it multiplies the field; or a function without arguments that returns it, such as a modulator's
        model with its present phase.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import Mask
    >>> field, pitch = Mask(np.full((2, 2), 0.5)).apply(np.ones((2, 2), complex), 8e-6, 532e-9)
    >>> field.real.tolist()
    [[0.5, 0.5], [0.5, 0.5]]
    """

    transmission: Array | Callable[[], Array]

    def apply(self, field: Array, pitch: Pitch, wavelength: float | Array) -> tuple[Array, Pitch]:
        """Return the field behind the element and its pixel pitch.

        Parameters
        ----------
        field : array
            Complex field ``[..., rows, columns]`` in front of the element.
        pitch : float or array
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float or array
            Wavelength in vacuum in metres.
        """
        value = self.transmission() if callable(self.transmission) else self.transmission
        value = _array.cast(_validate.image("transmission", value), field)
        _validate.fitting(field=field, transmission=value)
        return _through("Mask", field, value), pitch


@dataclass(frozen=True)
class PhaseModulator:
    """Phase-only modulator of a bench; light polarised otherwise than its axis passes unchanged.

    Attributes
    ----------
    phase : array or callable
        Phase of the pixels in radians, ``[..., rows, columns]``, or a function without arguments that returns it.
    samples : int
        Samples of the field along each side of a pixel.
    angle : float or tensor, optional
        Direction in degrees, from x towards y, in which it acts on fields ``[..., 2, rows, columns]``; without it, it
        acts on scalar fields, and on both components alike.

    Examples
    --------
    Pixels of two samples each; a phase of π turns the sign:

    >>> import numpy as np
    >>> from odak.wave import PhaseModulator
    >>> pattern = np.array([[0.0, np.pi]])
    >>> field, pitch = PhaseModulator(pattern, samples=2).apply(np.ones((2, 4), complex), 4e-6, 532e-9)
    >>> field.real[0].round(6).tolist()
    [1.0, 1.0, -1.0, -1.0]
    """

    phase: Array | Callable[[], Array]
    samples: int = 1
    angle: float | Array | None = None

    def apply(self, field: Array, pitch: Pitch, wavelength: float | Array) -> tuple[Array, Pitch]:
        """Return the field behind the element and its pixel pitch.

        Parameters
        ----------
        field : array
            Complex field ``[..., rows, columns]`` in front of the element.
        pitch : float or array
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float or array
            Wavelength in vacuum in metres.
        """
        value = self.phase() if callable(self.phase) else self.phase
        xp, value = _array.namespace(field), _array.cast(_validate.image("phase", value), field, _float64(field))
        count = _validate.integer("samples", self.samples, minimum=1)
        if count > 1:
            value = xp.repeat(xp.repeat(value, count, axis=-2), count, axis=-1)
        if self.angle is not None:
            return apply_jones(phase_modulator(value, self.angle), field), pitch
        _validate.fitting(field=field, phase=value)
        return field * phasor_of_cycles(value / (2 * math.pi), field.dtype), pitch


@dataclass(frozen=True)
class Polarizer:
    """Ideal linear polariser of a bench, for fields ``[..., 2, rows, columns]``.

    Attributes
    ----------
    angle : float or tensor
        Angle of its transmission axis in degrees, from x towards y.

    Examples
    --------
    Malus's law at 60°:

    >>> import numpy as np
    >>> from odak.wave import Polarizer
    >>> along_x = np.stack([np.ones((2, 2), complex), np.zeros((2, 2), complex)])
    >>> field, pitch = Polarizer(60.0).apply(along_x, 8e-6, 532e-9)
    >>> round(float((abs(field[:, 0, 0]) ** 2).sum()), 6)
    0.25
    """

    angle: float | Array = 0.0

    def apply(self, field: Array, pitch: Pitch, wavelength: float | Array) -> tuple[Array, Pitch]:
        """Return the field behind the element and its pixel pitch.

        Parameters
        ----------
        field : array
            Complex field ``[..., 2, rows, columns]`` in front of the element.
        pitch : float or array
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float or array
            Wavelength in vacuum in metres.
        """
        matrix = polarizer(_array.cast(self.angle, field, _float64(field)))
        result = apply_jones(matrix, field)
        note_loss("Polarizer", field, result, "aperture")
        return result, pitch


@dataclass(frozen=True)
class WavePlate:
    """Wave plate of a bench, for fields ``[..., 2, rows, columns]``.

    Attributes
    ----------
    retardance : float or tensor
        Phase in degrees by which the slow axis lags behind the fast one: 90 for a quarter-wave plate, 180 for a half.
    angle : float or tensor
        Angle of the fast axis in degrees, from x towards y.

    Examples
    --------
    A half-wave plate at 45° turns light along x to light along y:

    >>> import numpy as np
    >>> from odak.wave import WavePlate
    >>> along_x = np.stack([np.ones((2, 2), complex), np.zeros((2, 2), complex)])
    >>> field, pitch = WavePlate(180.0, 45.0).apply(along_x, 8e-6, 532e-9)
    >>> (abs(field[:, 0, 0]) ** 2).round(6).tolist()
    [0.0, 1.0]
    """

    retardance: float | Array
    angle: float | Array = 0.0

    def apply(self, field: Array, pitch: Pitch, wavelength: float | Array) -> tuple[Array, Pitch]:
        """Return the field behind the element and its pixel pitch.

        Parameters
        ----------
        field : array
            Complex field ``[..., 2, rows, columns]`` in front of the element.
        pitch : float or array
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float or array
            Wavelength in vacuum in metres.
        """
        angles = (_array.cast(value, field, _float64(field)) for value in (self.retardance, self.angle))
        return apply_jones(retarder(*angles), field), pitch


def _float64(field):
    return _array.namespace(field).float64


@_validate.takes_units("path_length")
@dataclass(frozen=True)
class FirstOrderSystem:
    """First-order system of a bench, given by its ray matrix, see :func:`propagate_abcd`.

    Attributes
    ----------
    abcd : array or sequence
        Ray matrix ``[[A, B], [C, D]]``.
    path_length : float or tensor
        Optical path along the axis in metres.
    output_dx : float or pair, optional
        Pixel pitch behind the system.
    output_shape : tuple of int, optional
        Rows and columns behind the system.

    Examples
    --------
    A telescope that images at a magnification of −0.1 reduces the pitch tenfold:

    >>> import numpy as np
    >>> from odak.wave import FirstOrderSystem
    >>> telescope = FirstOrderSystem([[-0.1, 0.0], [0.0, -10.0]])
    >>> field, pitch = telescope.apply(np.ones((64, 64), complex), 40e-6, 532e-9)
    >>> round(pitch * 1e6, 6)
    4.0
    """

    abcd: RayMatrices
    path_length: float | Array = 0.0
    output_dx: Pitch | None = None
    output_shape: Sequence[int] | None = None

    def apply(self, field: Array, pitch: Pitch, wavelength: float | Array) -> tuple[Array, Pitch]:
        """Return the field behind the element and its pixel pitch.

        Parameters
        ----------
        field : array
            Complex field ``[..., rows, columns]`` in front of the element.
        pitch : float or array
            Pixel pitch in metres, or a pair (rows, columns).
        wavelength : float or array
            Wavelength in vacuum in metres.
        """
        return propagate_abcd(field, self.abcd, pitch, wavelength, self.output_dx, self.output_shape, self.path_length)

    def matrix(self) -> RayMatrices:
        """Return the ray matrix."""
        return self.abcd


@_show.shown
class BenchPlane(NamedTuple):
    """Field behind an element of a bench.

    Attributes
    ----------
    position : float or tensor
        Position along the axis in metres.
    field : array
        Complex field ``[..., rows, columns]``.
    pitch : float, tuple or tensor
        Pixel pitch of the field in metres.
    element : object or None
        Element that the field leaves; None in front of the first one.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import FreeSpace, ThinLens, optical_bench
    >>> bench = optical_bench([ThinLens(0.1), FreeSpace(0.05)], 532e-9)
    >>> [plane.position for plane in bench.planes(np.ones((32, 32), complex), 8e-6)]
    [0.0, 0.0, 0.05]
    """

    position: float | Array
    field: Array
    pitch: Pitch
    element: object


class optical_bench(_show.Shown):
    """Sequence of optical elements as one object, differentiable in each of its numbers.

    A lens that is steeper than the samples of the field can follow goes into the ray matrix of the space behind it
    (:func:`propagate_abcd`, paraxial), with the same result as on a finer grid. Where a lens is sampled, the space
    propagates by its own method.

    Parameters
    ----------
    elements : sequence
        In the order in which light meets them: :class:`FreeSpace`, :class:`ThinLens`, :class:`CircularAperture`,
        :class:`RectangularAperture`, :class:`Mask`, :class:`PhaseModulator`, :class:`Polarizer`, :class:`WavePlate`,
        :class:`FirstOrderSystem`, or any object with a method ``apply(field, pitch, wavelength)`` that returns a field
        and its pitch.
    wavelength : float or array
        Wavelength in metres; an array broadcasts against the leading axes of the field.

    Raises
    ------
    ValueError, TypeError
        If an element has no such method, or the wavelength is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import CircularAperture, FreeSpace, ThinLens, optical_bench
    >>> bench = optical_bench([CircularAperture(4e-4), ThinLens(0.1), FreeSpace(0.1, window_dx=2e-6)], 532e-9)
    >>> focus, pitch = bench.propagate(np.ones((128, 128), complex), 8e-6)
    >>> focus.shape, pitch
    ((128, 128), 2e-06)
    """

    @_validate.takes_units("wavelength")
    def __init__(self, elements: Iterable[Any], wavelength: float | Array):
        _validate.listed("elements", elements, "a sequence of elements")
        self.elements: list[Any] = list(elements)
        for element in self.elements:
            if not callable(getattr(element, "apply", None)):
                raise TypeError(f"elements must have a method apply(field, pitch, wavelength), got {element!r:.80}")
        wavelength = _validate.real("wavelength", wavelength, positive=True)
        self.wavelength: float | Array = np.asarray(wavelength) if isinstance(wavelength, (list, tuple)) else wavelength

    def _repr_html_(self) -> str:
        return _show.page(self, optical_bench._view)

    def _view(self) -> _show.View:
        """Return what notebooks show of it: a drawing with rays, the elements and the ray matrix."""
        pictures, failed, place = [], [], 0.0
        try:
            pictures = [("section with paraxial rays", _show.png(np.asarray(self.draw(self._drawn_height())) / 255))]
        except (TypeError, ValueError, RuntimeError) as error:
            failed = [f"the bench cannot be drawn: {error}"]
        wave = ", ".join(f"{1e9 * w:.4g}" for w in (_known_all(self.wavelength) or []))
        table: list[Any] = [("place", "element")]
        for element in self.elements:
            known = _known_all(_length(element))
            table.append((f"{1e3 * place:.6g} mm", _show.one_line(element)))
            place += math.nan if known is None else abs(known[0])
        matrices: Any = self.matrix()
        for axis, matrix in zip(("rows", "columns"), matrices if _is_pair(matrices) else [matrices], strict=False):
            entries = _known(*(value for row in matrix for value in row))
            name = f"ray matrix, {axis}" if _is_pair(matrices) else "ray matrix"
            if entries is not None:
                a, b, c, d = entries
                table.append((name, f"A = {a:.6g}, B = {b:.6g} m, C = {c:.6g} 1/m, D = {d:.6g}"))
                table.append(("focal length", "∞" if abs(c) < 1e-12 else f"{-1e3 / c:.6g} mm"))
        return _show.View(
            f"Bench of {len(self.elements)} elements, {1e3 * place:.6g} mm, {wave} nm", pictures, table, failed
        )

    def _drawn_height(self) -> float:
        """Return half the height of the smallest aperture, 1 mm without one."""
        sizes = [
            float(element.extent()[0]) / 2
            for element in self.elements
            if isinstance(element, (CircularAperture, RectangularAperture))
        ]
        return min(sizes, default=1e-3)

    @_validate.takes_units("dx")
    def propagate(self, field: Array, dx: float | Sequence[float]) -> tuple[Any, ...]:
        """Return the field behind the last element, and its pixel pitch.

        Parameters
        ----------
        field : array
            Complex field ``[..., rows, columns]`` in front of the first element.
        dx : float or sequence of float
            Its pixel pitch in metres, one number or a pair (rows, columns).
        """
        *_, (_, light, _) = self._light(field, dx)
        for lens in light.lenses:
            _warn_of_lens(lens, light.field.shape[-2:], light.pitch, self.wavelength, "the field behind the bench")
        return light.sampled(self.wavelength), light.pitch

    @_validate.takes_units("dx")
    def planes(self, field: Array, dx: float | Sequence[float]) -> list[BenchPlane]:
        """Return the field in front of the first element and behind each element.

        Parameters
        ----------
        field : array
            Complex field ``[..., rows, columns]`` in front of the first element.
        dx : float or sequence of float
            Its pixel pitch in metres.
        """
        return [
            BenchPlane(position, light.sampled(self.wavelength), light.pitch, element)
            for position, light, element in self._light(field, dx)
        ]

    def _light(self, field, dx):
        """Yield position, light and element in front of the first element and behind each."""
        field, position = _array.to_complex(_validate.image("field", field)), 0.0
        _validate.lengths_together(self.wavelength, dx)
        check_geometry(None, 0.0, dx, self.wavelength, tuple(field.shape[:-2]))
        light = Light(field, dx)
        yield position, light, None
        for element in self.elements:
            light = light.through(element, self.wavelength)
            position = position + _length(element)
            yield position, light, element

    def matrix(self) -> RayMatrices:
        """Return the ray matrix ``[[A, B], [C, D]]`` of the whole bench, as nested lists of its numbers.

        A tuple of two (rows, columns) if an element has a matrix for each axis.
        """
        totals = []
        for axis in range(2):
            total: list[Any] = [[1.0, 0.0], [0.0, 1.0]]
            for element in self.elements:
                m = _matrix_along(element, axis)
                total = [[sum(m[i][k] * total[k][j] for k in range(2)) for j in range(2)] for i in range(2)]
            totals.append(total)
        both = any(_is_pair(element.matrix()) for element in self.elements if hasattr(element, "matrix"))
        return tuple(totals) if both else totals[0]

    def draw(self, height: float, width: int = 900) -> "PIL.Image.Image":
        """Return a drawing of the bench: its elements to scale along the axis, and paraxial rays through it.

        Parameters
        ----------
        height : float
            Half height of the field in metres; rays start there, on the axis and between, parallel to the axis.
        width : int
            Width of the drawing in pixels.

        Returns
        -------
        PIL.Image.Image
            The drawing.
        """
        from PIL import Image, ImageDraw

        height = _validate.constant("height", height, positive=True)
        starts = height * np.linspace(-1, 1, 5)
        rays = [np.stack([starts, np.zeros(5)])]
        places = [0.0]
        for element in self.elements:
            matrix = _matrix_along(element, 0)
            m = np.array([[float(matrix[i][j]) for j in range(2)] for i in range(2)])
            offset = float(getattr(element, "offset", (0.0,))[0]) if isinstance(element, ThinLens) else 0.0
            shift = np.array([[offset], [0.0]])
            rays.append(m @ (rays[-1] - shift) + shift)
            places.append(places[-1] + abs(float(_length(element))))
        tall = 1.15 * max(height, *(float(np.abs(ray[0]).max()) for ray in rays))
        size, margin = (_validate.integer("width", width, minimum=100), max(80, width // 3)), width // 20
        length = places[-1] or 1.0

        def at(place, y):
            return (
                margin + (size[0] - 2 * margin) * place / length,
                size[1] / 2 - (size[1] / 2 - margin / 2) * y / tall,
            )

        image = Image.new("RGB", size, "white")
        pen = ImageDraw.Draw(image)
        pen.line([at(0, 0), at(length, 0)], fill="#b0b0b0")
        for index in range(len(starts)):
            pen.line([at(p, ray[0][index]) for p, ray in zip(places, rays, strict=True)], fill="#2f7d32", width=2)
        for place, element in zip(places[1:], self.elements, strict=True):
            _draw_element(pen, element, lambda y, place=place: at(place, y), tall, margin / 4)
        return image


@dataclass(frozen=True)
class Light:
    """Light on its way: a field, and the lenses of its plane that are too steep for its samples.

    Lenses and what else multiplies a field may change places. A lens that is undersampled is kept until the next space,
    and goes into the ray matrix of it: Collins' integral has the phase of a matrix in its kernel.

    Attributes
    ----------
    field : array
        Complex ``[..., rows, columns]``.
    pitch : float or pair
        Pixel pitch.
    lenses : tuple of ThinLens
        Lenses by which the field is still to be multiplied.
    openings : tuple
        Apertures of this plane: where they are closed, no lens has to be sampled.
    coarse : float
        How many times the light is beyond Nyquist on this pitch: the samples are right, but not enough to go on.
    """

    field: Any
    pitch: Pitch
    lenses: tuple["ThinLens", ...] = ()
    openings: tuple["CircularAperture | RectangularAperture", ...] = ()
    coarse: float = 0.0

    def sampled(self, wavelength: float | Array) -> Any:
        """Return the field with its lenses, at the samples."""
        field = self.field
        for lens in self.lenses:
            field = lens.times(field, self.pitch, wavelength)
        return field

    def through(self, element: Any, wavelength: float | Array) -> "Light":
        """Return the light behind an element."""
        if isinstance(element, ThinLens) and self._is_steep(element, wavelength):
            return replace(self, lenses=(*self.lenses, element))
        if isinstance(element, _MULTIPLIES):
            field, _ = element.apply(self.field, self.pitch, wavelength)
            opening = (element,) if isinstance(element, (CircularAperture, RectangularAperture)) else ()
            return replace(self, field=field, openings=(*self.openings, *opening))
        if self.coarse > 1:
            finer = 0.995 * min(_validate.numbers(list(pitches(self.pitch)))) / self.coarse
            warn_of_factor("the light behind the lens", self.coarse, (f"a window_dx of at most {finer:.3g} m",))
        if any(self._is_steep(lens, wavelength, self.openings) for lens in self.lenses):
            if isinstance(element, (FreeSpace, FirstOrderSystem)):
                return self._folded(element, wavelength)
            for lens in self.lenses:
                _warn_of_lens(lens, self.field.shape[-2:], self.pitch, wavelength)
        return Light(*element.apply(self.sampled(wavelength), self.pitch, wavelength))

    def _is_steep(self, lens, wavelength, openings=()) -> bool:
        """Return whether a lens is undersampled where the apertures are open; False where that cannot be known."""
        numbers = _known(*pitches(self.pitch), *lens.offset, lens.focal)
        waves = _known_all(wavelength)
        if numbers is None or waves is None:
            return False
        axes = list(sampled_axes(tuple(self.field.shape[-2:]), numbers[:2], numbers[2:4]))
        for opening in openings:
            known = _known(*opening.offset, *opening.extent())
            if known is not None:
                places = zip(axes, known[:2], known[2:], numbers[2:4], strict=True)
                axes = [
                    (max(low, place - shift - size / 2), min(high, place - shift + size / 2), step)
                    for (low, high, step), place, size, shift in places
                ]
        if any(low > high for low, high, _ in axes):
            return False
        return undersampling(thin_lens, tuple(axes), (numbers[4], min(waves))) > 1 + 1e-9

    def _folded(self, element, wavelength) -> "Light":
        """Return the light behind a space or a system, with the lenses in its ray matrix.

        Lenses of the powers Pᵢ with their axes at cᵢ are one lens and a prism of the slope Σ Pᵢcᵢ. Light goes straight
        on to B times the slope, where it has D times the slope.
        """
        matrix: Any
        power = sum(1 / lens.focal for lens in self.lenses)
        slopes = [sum(lens.offset[axis] / lens.focal for lens in self.lenses) for axis in (0, 1)]
        if isinstance(element, FreeSpace):
            matrix, length, offset = element.matrix(), element.distance * element.index, element.offset
            out, shape = self.pitch if element.window_dx is None else element.window_dx, element.window_shape
        else:
            matrix, length, offset = element.abcd, element.path_length, (0.0, 0.0)
            out, shape = element.output_dx, element.output_shape
        matrices = matrix if _is_pair(matrix) else (matrix, matrix)
        total: Any = tuple([[row[0] - row[1] * power, row[1]] for row in m] for m in matrices)
        places = tuple(
            place - m[0][1] * slope if _array.is_array(slope) or slope else place
            for place, m, slope in zip(offset, matrices, slopes, strict=True)
        )
        field, out = propagate_abcd(
            self.field, total if _is_pair(matrix) else total[0], self.pitch, wavelength, out, shape, length, places
        )
        if any(_array.is_array(value) or value != 0 for lens in self.lenses for value in lens.offset):
            middles = _positions(field, out, [-place for place in offset])
            wave = _per_field(wavelength, middles[0])
            cycles = -sum((lens.offset[0] ** 2 + lens.offset[1] ** 2) / (2 * lens.focal) for lens in self.lenses)
            for m, slope, x in zip(matrices, slopes, middles, strict=True):
                cycles = cycles + m[1][1] * slope * (2 * x - m[0][1] * slope) / 2
            field = field * phasor_of_cycles(cycles / wave, field.dtype)
        return self._less_its_sphere(Light(field, out), total, slopes, offset, wavelength)

    def _less_its_sphere(self, light, total, slopes, offset, wavelength) -> "Light":
        """Return light behind lenses without the spherical wave that they made of it, if that is too steep as well."""
        ((a, b), (c, _)), _ = total
        known = [_known(*(value for row in m for value in row)) for m in total]
        steps, out, waves = _known(*pitches(self.pitch)), _known(*pitches(light.pitch)), _known_all(wavelength)
        if steps is None or out is None or waves is None or known[0] is None or known[0] != known[1]:
            return light
        scale, power = abs(known[0][0]), abs(known[0][2])
        lit = [n * step for n, step in zip(self.field.shape[-2:], steps, strict=True)]
        for opening in self.openings:
            sizes = _known(*opening.extent())
            lit = lit if sizes is None else [min(both) for both in zip(lit, sizes, strict=True)]
        # Several Fresnel zones, and enough samples for the fringes at the rim.
        spherical = all(
            abs(known[0][1]) * max(waves) < scale * width**2 / 8 and scale * width > 32 * step
            for width, step in zip(lit, out, strict=True)
        )
        if not power or not spherical:
            # Close to a focus or an image there is no such wave; light from the rims has the largest frequency.
            factor = max(step * width * power / min(waves) for step, width in zip(out, lit, strict=True))
            return replace(light, coarse=factor)
        middle = tuple(-slope / c - place for slope, place in zip(slopes, offset, strict=True))
        arrived = tuple(b * slope - place for slope, place in zip(slopes, offset, strict=True))
        lens, opening = ThinLens(-a / c, middle), RectangularAperture(scale * lit[0], scale * lit[1], arrived)
        if not light._is_steep(lens, wavelength, (opening,)):
            return light
        field = ThinLens(a / c, middle).times(light.field, light.pitch, wavelength)
        return replace(light, field=field, lenses=(lens,), openings=(opening,))


_MULTIPLIES = (ThinLens, CircularAperture, RectangularAperture, Mask, PhaseModulator, Polarizer, WavePlate)


def _known(*values) -> tuple[float, ...] | None:
    """Return single numbers as floats without their derivatives, None where one cannot be read."""
    found = [_known_all(value) for value in values]
    return None if None in found else tuple(one[0] for one in found if one)


def _known_all(value) -> list[float] | None:
    return _validate.numbers(value) if _array.is_readable(value) else None


def _draw_element(pen, element: Any, at: Callable[..., Any], tall: float, wing: float) -> None:
    """Draw a lens as an arrow, an aperture as two bars, and a mask as a dashed line."""
    top = 0.95 * tall
    (x, high), (_, low) = at(top), at(-top)
    if isinstance(element, ThinLens):
        bend = wing if _validate.numbers(element.focal)[0] > 0 else -wing
        pen.line([(x, high), (x, low)], fill="#1f4e9c", width=2)
        for y, sign in ((high, 1), (low, -1)):
            pen.line([(x - wing, y + sign * bend), (x, y), (x + wing, y + sign * bend)], fill="#1f4e9c", width=2)
    elif isinstance(element, (CircularAperture, RectangularAperture)):
        half = float(element.extent()[0]) / 2
        centre = _validate.numbers(element.offset[0])[0]
        for sign in (1, -1):
            edge = min(max(centre + sign * half, -top), top)
            pen.line([at(sign * top), at(edge)], fill="black", width=5)
    elif isinstance(element, (Mask, PhaseModulator, Polarizer, WavePlate)):
        for part in np.arange(-1.0, 1.0, 0.2):
            pen.line([at(top * part), at(top * (part + 0.1))], fill="#c25700", width=4)
    elif isinstance(element, FirstOrderSystem):
        pen.rectangle([x - 2 * wing, high, x, low], outline="#1f4e9c", width=2)


def _matrix_along(element, axis: int):
    """Return the ray matrix of an element along rows (0) or columns (1); the identity if it has none."""
    matrix = getattr(element, "matrix", lambda: [[1.0, 0.0], [0.0, 1.0]])()
    return matrix[axis] if _is_pair(matrix) else matrix


def _length(element):
    return getattr(element, "distance", getattr(element, "path_length", 0.0))


def _check_keeps_pitch(propagation_type: str) -> None:
    """Raise ValueError for a method whose result is no field of the same pitch."""
    check_has_kernel(propagation_type)
    method = find_method(propagation_type)
    if method is not None and (method.sets_own_pitch or method.of_intensities):
        raise ValueError(
            f"propagation_type must give a field of the same pitch, which {method.name!r} does not; window_dx gives "
            "another pitch, and so does FirstOrderSystem"
        )


def _per_field(value, like):
    """Return one number without axes, and one for each field of the leading axes as ``[..., 1, 1]``, float64."""
    value = _array.cast(value, like)
    shape = () if math.prod(value.shape) == 1 else (*value.shape, 1, 1)
    return _array.namespace(like).reshape(value, shape)


def _positions(field, pitch, offset):
    """Return the coordinates y and x of the samples of a field from a point, float64."""
    xp = _array.namespace(field)
    like = xp.zeros((1, 1), dtype=xp.float64, device=_array.device_of(field))
    return [
        centred(like, field.shape[axis], axis) * _array.cast(step, like) - _array.cast(shift, like)
        for axis, step, shift in zip((-2, -1), pitches(pitch), offset, strict=True)
    ]
