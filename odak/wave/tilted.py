"""Propagation to a tilted plane: the angular spectrum in the plane's own coordinates."""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array, Numbers
from odak._warnings import AccuracyWarning, warn
from odak.wave.fourier import (
    InterpolatedSpectrum,
    Line,
    SpreadSpectrum,
    compensated,
    compensation,
    phase_of_first,
    spectrum_along,
    spectrum_at,
    spread_along,
    spreading_line,
    to_line_from_first,
)
from odak.wave.transfer_functions import (
    Grid,
    Request,
    check_geometry,
    kernels,
    outside_inference,
    pitches,
    plane_wave_transfer,
)
from odak.wave.windows import GUARD, Rays, Window, carry_to_offset, column, make_window, to_window

# Cosine of 88 degrees.
GRAZING = 0.035


@_validate.takes_units("wavelength", "distance", "dx", "offset", degrees=("angles",))
def propagate_to_tilted_plane(
    field: Array,
    wavelength: float | Array,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    angles: Numbers = (0.0, 0.0, 0.0),
    window_shape: Sequence[int] | None = None,
    window_dx: Array | None = None,
    offset: Numbers = (0.0, 0.0),
    guard: float = GUARD,
    source_angles: Numbers = (0.0, 0.0, 0.0),
) -> Array:
    """Propagate a field to a plane that is rotated about its intersection with the optical axis.

    The plane of the field may be tilted too: from a tilted modulator to a plane, from one side of a prism to another,
    or from a mirror off the axis.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``.
    wavelength : float or array
        Wavelength in metres; an array broadcasts against the field's leading axes.
    distance : float or array
        Distance of the rotation's centre in metres; an array broadcasts against the field's leading axes.
    dx : float, pair of float or array
        Pixel pitch of the field in metres, in the forms of :func:`odak.wave.propagate_to_window`.
    angles : sequence of three floats or arrays, or array
        Rotation in degrees about the x axis (columns), then y (rows), then z (direction of propagation),
        right-handed, the axes fixed. (θ, 0, 0) takes the rows of larger y further away; (0, θ, 0) brings the columns
        of larger x nearer. An array ``[3, 3]`` is a rotation matrix, whose columns are the plane's unit vectors along
        its columns, its rows and its normal.
    window_shape : sequence of int, optional
        Rows and columns of the window; by default the shape of the field.
    window_dx : float, pair of float or array, optional
        Pixel pitch along the rows and columns of the tilted plane; by default the pitch of the field.
    offset : sequence of two floats or arrays
        Place (y, x) of the window's sample ``n // 2`` in the tilted plane, in metres from the rotation's centre.
    guard : float
        Margin for diffraction around the rays, see :func:`odak.wave.propagate_to_window`.
    source_angles : sequence of three floats or arrays, or array
        Rotation of the field's plane about the origin, in the same form as `angles`; `distance` and `angles` still
        refer to the optical axis, along z.

    Returns
    -------
    array
        Field ``[..., window rows, window columns]`` at the points (0, 0, z) + R·(x, y, 0), in the field's library and
        precision; differentiable in the field, the lengths and the angles.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it; if the planes are tilted by 90° or more to each other.

    Notes
    -----
    Matsushima, Schimmel and Wyrowski, J. Opt. Soc. Am. A 20, 1755 (2003): a plane wave stays one on any plane. Its
    frequencies rotate, and the spectrum is multiplied by the Jacobian f_z/f_z'. The rotation of the frequencies is done
    in two steps along one axis each (Catmull and Smith, Comput. Graph. 14, 279 (1980), for images): the frequencies
    along the field's columns become those along the window's columns, then those along the rows. Each step is a
    non-uniform Fourier transform, to about 1e-6 (complex64) or 2e-11 (complex128) of the field's norm; a rotation about
    x or y alone needs one of them. Where a step has no inverse (waves along the plane, at high numerical apertures and
    large angles about both axes), the spectrum is interpolated along both axes at once. Waves that decay are left out.

    For lengths that are plain numbers and angles that need no gradients, the steps are sparse matrices on the CPU. The
    first call makes them, and they stay in the store of :func:`odak.wave.set_kernel_cache_size` if it has room for
    them: 112 bytes for each frequency (complex64) or 288 (complex128), about five times the samples of the field. With
    them the propagation takes three to five times as long as :func:`odak.wave.propagate_beam` with its default padding,
    and six times if the window is also turned by more than 20° about the axis. Without them it takes 50 to 80 times as
    long, and interpolation along both axes at once twice that.

    Along a tilted plane the phase changes by sin θ/λ cycles per metre. The samples are right whatever their pitch; to
    resolve that phase, or to propagate further, `window_dx` must be below λ/(2·sin θ).

    Beyond 88° waves that propagate along the plane are removed, the field there may be wrong, and an AccuracyWarning is
    issued.

    Examples
    --------
    >>> import numpy as np
    >>> import odak
    >>> field = np.ones((32, 32), dtype=np.complex128)
    >>> odak.wave.propagate_to_tilted_plane(field, 532e-9, 0.01, 8e-6, angles=(0.0, 30.0, 0.0)).shape
    (32, 32)
    """
    field = _array.to_complex(_validate.image("field", field))
    check_geometry(None, distance, dx, wavelength, tuple(field.shape[:-2]))
    request = Request(dx, wavelength, distance)
    window = make_window(field, window_shape, window_dx, dx, offset, guard)
    key = _key(field, request, window, angles, source_angles)
    build = functools.partial(_tilted_path, field, request, window, angles, source_angles)
    path = kernels.on(_array.device_of(field)).get(key, functools.partial(build, kept=True)) if key else build()
    if path.least < GRAZING:
        warn(
            f"angles {angles!r} tilt the plane by more than 88 degrees: waves along it are cut off, and the field "
            "there may be wrong",
            AccuracyWarning,
        )
    return path(field)


@dataclass(frozen=True)
class _Path:
    """What leads from a field to its window on a tilted plane.

    Attributes
    ----------
    grid : Grid
        The grid of the field, in the coordinates of its plane.
    window : Window
        The window, in the same coordinates.
    lines : tuple of Line
        Frequencies along the rows and columns of the spectrum; the window's frequencies if nothing is spread.
    spectrum : callable
        Returns the spectrum of a field.
    transfer : array
        Factor of each of its frequencies.
    spread : callable or None
        Returns the spectrum with frequencies of the window along its rows.
    factor : array or None
        Factor of the window's rows after it.
    turned : tuple of bool
        Whether rows and columns of the field, and of the window, are exchanged in all of this.
    least : float
        Cosine of the angle between the planes.
    """

    grid: Grid
    window: Window
    lines: tuple[Line, Line]
    spectrum: Callable[..., Any]
    transfer: Any
    spread: Callable[..., Any] | None
    factor: Any
    turned: tuple[bool, bool]
    least: float

    @property
    def held_bytes(self) -> int:
        """Return the bytes that the path takes in the store of kernels."""
        parts = [getattr(part, "held_bytes", 0) for part in (self.spectrum, self.spread)]
        return 16 * math.prod(self.transfer.shape) + sum(parts)

    def __call__(self, field):
        """Return the field on the window."""
        xp = _array.namespace(field)
        spectrum = self.spectrum(xp.matrix_transpose(field) if self.turned[0] else field) * self.transfer
        spectrum = spectrum if self.spread is None else self.spread(spectrum)
        result = to_window(spectrum, self.lines, self.window, self.grid)
        result = result if self.factor is None else result * self.factor
        return xp.matrix_transpose(result) if self.turned[1] else result


def _key(field, request: Request, window: Window, angles, source_angles) -> tuple[Any, ...] | None:
    """Return what names a path in the store of kernels, None if it is not known as numbers or the field is traced."""
    turns = [_numbers_of(value) for value in (angles, source_angles)]
    if None in turns or not (request.is_plain() and window.is_plain()) or _array.is_wrapped(field):
        return None
    xp, device = _array.namespace(field), str(_array.device_of(field))
    geometry = (request.geometry, window, *turns)
    return ("tilted", tuple(field.shape[-2:]), geometry, xp.__name__, device, str(field.dtype))


def _numbers_of(angles) -> tuple[Any, ...] | None:
    """Return angles or a rotation matrix as numbers, None if they must remain arrays."""
    if _array.is_array(angles):
        known = "float" in str(angles.dtype) and not _array.is_traced(angles)
        return (tuple(angles.shape), *_validate.numbers(angles)) if known else None
    plain = isinstance(angles, (tuple, list)) and all(isinstance(value, (int, float)) for value in angles)
    return tuple(angles) if plain else None


def _tilted_path(field, request: Request, window: Window, angles, source_angles, kept: bool = False) -> _Path:
    """Return the path of a field to a tilted plane; one that is kept interpolates by sparse matrices where it can."""
    xp, shape = _array.namespace(field), tuple(field.shape[-2:])
    with outside_inference(xp):
        grid = request.grid(shape, xp, _array.device_of(field), field.dtype)
        straight = isinstance(source_angles, (tuple, list)) and all(map(_is_zero, source_angles))
        window = replace(window, axes=_rotated_axes("angles", angles, grid))
        if not straight:
            grid, window = _seen_from(_rotated_axes("source_angles", source_angles, grid), grid, window)
        least = float(Rays.between(grid, window).numbers().axes[2][2].min())
        if least < 1e-3:
            raise ValueError(
                "angles and source_angles must tilt the planes by less than 90 degrees, "
                f"got {angles!r}, {source_angles!r}"
            )
        turned = _turns(Rays.between(grid, window).numbers())
        grid, window = _turned(grid, window, turned, request)
        rays = Rays.between(grid, window)
        along = straight and _is_about_one_axis(angles)
        stretch = 1.0 if along else _stretch(rays.numbers())
        if stretch is None or not _array.has_sparse_matrices(field):
            return _general_path(grid, window, turned, least)
        return _two_step_path(grid, window, turned, least, along, stretch, kept)


def _two_step_path(grid: Grid, window: Window, turned, least: float, along: bool, stretch: float, kept: bool) -> _Path:
    """Return the path that maps the frequencies along columns to the window's first, then the frequencies along rows.

    With `along` the rows' frequencies remain; otherwise their derivative, at one frequency of the window's columns,
    is at least 1/`stretch`.
    """
    rays = Rays.between(grid, window)
    down, across = rays.lines()
    rows = down if along else rays.source_line(stretch * down.period)
    (fx, v), transfer = _mixed_transfer(grid, window, rays, (rows, across), down)
    transfer = transfer * phase_of_first(transfer, rows, grid.shape[0])
    cycles, target = fx * grid.pitch[1], v * grid.pitch[0]
    matrices = kept and transfer.ndim == 2 and _fits(transfer, 1 if along else 2)
    if along:
        interpolate = (
            InterpolatedSpectrum(np.asarray(cycles), grid.shape[1], grid.dtype)
            if matrices
            else functools.partial(spectrum_along, cycles=cycles)
        )
        return _Path(grid, window, (down, across), _Composed(rows, interpolate), transfer, None, None, turned, least)
    # Where the window has the field's pitch, frequencies a period apart are the same.
    whole = window.dx is None
    ratio = window.pitch(grid)[0] / grid.pitch[0]
    extent = window.shape[0] * float(np.asarray(_validate.numbers(ratio)).max())
    ends = (down.first / down.period, (down.first + down.count - 1) / down.period)
    line = spreading_line(ends, extent, whole, grid.dtype)
    if whole:
        across = replace(across, count=min(across.count, across.period))
    factor = compensation(transfer, line, ratio, window.shape[0]) / rows.period
    if matrices:
        size = np.abs(np.asarray(transfer))
        needed = size > 1e-13 * size.max()
        interpolate = InterpolatedSpectrum(np.asarray(cycles), grid.shape[1], grid.dtype, needed)
        spread = SpreadSpectrum(np.asarray(target), line, across.count, grid.dtype, needed)
        transfer = transfer[needed if isinstance(transfer, np.ndarray) else grid.xp.asarray(needed)]
    else:
        interpolate = functools.partial(spectrum_along, cycles=cycles)
        spread = functools.partial(spread_along, cycles=target, line=line, width=across.count)
    spectrum = _Composed(rows, interpolate)
    return _Path(grid, window, (line, across), spectrum, transfer, spread, factor, turned, least)


def _general_path(grid: Grid, window: Window, turned, least: float) -> _Path:
    """Return the path that interpolates the spectrum along both axes, which any angles allow."""
    rays = Rays.between(grid, window)
    lines = rays.lines()
    (fy, fx), transfer = _transfer(grid, window, rays, lines)
    dy, dx = grid.pitch

    spectrum = functools.partial(spectrum_at, cycles_y=fy * dy, cycles_x=fx * dx)
    return _Path(grid, window, lines, spectrum, transfer, None, None, turned, least)


def _fits(transfer, steps: int) -> bool:
    """Return whether sparse matrices can be used for each of the steps, and be kept with others in the store."""
    double = _array.is_double(transfer)
    largest = math.prod(transfer.shape) * steps * (12 * 12 if double else 7 * 8)
    on_cpu = "cpu" in str(_array.device_of(transfer)).lower()
    return on_cpu and largest < 3 * kernels.on("cpu").maximum_bytes // 4


@dataclass(frozen=True)
class _Composed:
    """Transform along the rows' axis, less its phase, and interpolation along the columns'."""

    line: Line
    interpolate: Callable[..., Any]

    @property
    def held_bytes(self) -> int:
        """Return the bytes of the matrix, if there is one."""
        return getattr(self.interpolate, "held_bytes", 0)

    def __call__(self, field):
        """Return the spectrum of a field."""
        return self.interpolate(to_line_from_first(compensated(field), self.line))


def _is_zero(value) -> bool:
    """Return whether an angle is a plain zero; a tensor may require the derivative there."""
    return not _array.is_array(value) and value == 0


def _is_about_one_axis(angles) -> bool:
    """Return whether a rotation is one about x or y alone, known as a plain number."""
    return not _array.is_array(angles) and _is_zero(angles[2]) and (_is_zero(angles[0]) or _is_zero(angles[1]))


def _turns(rays: Rays) -> tuple[bool, bool]:
    """Return whether to exchange the axes of the field, and of the window, before the steps of a path.

    The first step is along the field's axis that is tilted more, and leads to the window's axis next to it. NumPy
    constants are needed.
    """
    tilt_x, tilt_y = (np.abs(rays.axes[2][k]).max() for k in (0, 1))
    field = bool(tilt_y > tilt_x)
    along_columns, along_rows = (np.abs(rays.axes[k][1 if field else 0]).min() for k in (0, 1))
    return field, bool(along_rows > along_columns)


def _turned(grid: Grid, window: Window, turned: tuple[bool, bool], request: Request) -> tuple[Grid, Window]:
    """Return grid and window, with the axes of either exchanged where `turned` is true."""
    field, target = turned
    if field:
        axes = tuple((unit[1], unit[0], unit[2]) for unit in window.axes)
        grid, window = replace(grid, shape=grid.shape[::-1], pitch=grid.pitch[::-1]), replace(window, axes=axes)
    pitch = pitches(request.dx) if window.dx is None else pitches(window.dx)
    if window.dx is not None or field != target:
        # Unless the field's pitch along the exchanged axes serves.
        same = window.dx is None and all(isinstance(value, (int, float)) for value in pitch) and pitch[0] == pitch[1]
        window = replace(window, dx=None if same else tuple(pitch)[:: -1 if target else 1])
    if target:
        columns, rows, normal = window.axes
        window = replace(window, shape=window.shape[::-1], offset=window.offset[::-1], axes=(rows, columns, normal))
    return grid, window


def _stretch(rays: Rays) -> float | None:
    """Return the largest derivative of the window's frequencies along rows by the field's, None if it has no bound.

    The frequency along the window's columns is held. NumPy constants are needed.
    """
    waves = rays.waves()
    (a_x, _, a_z), _, normal = rays.axes
    kept = a_x * waves[2] - a_z * waves[0]
    kept = kept * np.where(a_x < 0, -1.0, 1.0) * rays.wavelength
    if kept.min() < 0.1:
        return None
    forward = sum(f * n for f, n in zip(waves, normal, strict=True)) * rays.wavelength
    return float((forward / kept).max())


def _rotated_axes(name: str, angles, grid: Grid) -> tuple[Any, ...]:
    """Return the plane's unit vectors (x, y, z) along its columns, its rows and its normal: the columns of Rz·Ry·Rx."""
    xp = grid.xp
    if _array.is_array(angles) and angles.ndim == 2:
        matrix = _array.cast(_validate.real(name, angles), grid.wavelength)
        _validate.shaped(name, matrix, "three angles or a rotation matrix [3, 3]")
        if _array.is_readable(matrix):
            numbers = np.asarray(_validate.numbers(matrix)).reshape(3, 3)
            if np.abs(numbers @ numbers.T - np.eye(3)).max() > 1e-6 or np.linalg.det(numbers) < 0:
                raise ValueError(f"{name} must be a rotation matrix, orthogonal and of determinant 1")
        return tuple(tuple(xp.reshape(matrix[k, axis], (1, 1)) for k in range(3)) for axis in range(3))
    turns = [column(angle, grid) * (xp.pi / 180) for angle in _validate.several(name, angles, 3)]
    (cx, cy, cz), (sx, sy, sz) = ([function(turn) for turn in turns] for function in (xp.cos, xp.sin))
    return (
        (cz * cy, sz * cy, -sy),
        (cz * sy * sx - sz * cx, sz * sy * sx + cz * cx, cy * sx),
        (cz * sy * cx + sz * sx, sz * sy * cx - cz * sx, cy * cx),
    )


def _seen_from(source, grid: Grid, window: Window) -> tuple[Grid, Window]:
    """Return the grid and the window in the coordinates of a field's plane with the axes `source`.

    The centre of the target plane lies at `distance` on the optical axis. Along the normal of the source it is met by
    another point of the same plane, from which the centre is an offset within the plane.
    """

    def dot(a, b):
        return sum(p * q for p, q in zip(a, b, strict=True))

    axes = tuple(tuple(dot(target, own) for own in source) for target in window.axes)
    centre = [grid.distance * own[2] for own in source]
    distance = dot(centre, axes[2]) / axes[2][2]
    rest = (centre[0], centre[1], centre[2] - distance)
    moved = (dot(rest, axes[k])[..., 0, 0] for k in (1, 0))
    offset = tuple(_array.cast(given, grid.wavelength) + move for given, move in zip(window.offset, moved, strict=True))
    return replace(grid, distance=distance), replace(window, offset=offset, axes=axes)


def _transfer(grid: Grid, window: Window, rays: Rays, lines):
    """Return the field's frequencies (y, x) of the plane waves on the lines, and the factor of each."""
    xp = grid.xp
    v, u = (line.cycles(pitch) / pitch for line, pitch in zip(lines, grid.pitch, strict=True))
    squared = 1 / grid.wavelength**2 - v**2 - u**2
    meets = squared > (1e-3 / grid.wavelength) ** 2
    # The frequency of the waves that are left out is arbitrary.
    safe = xp.astype(meets, xp.float64)
    v, u = v * safe, u * safe
    w = xp.sqrt(1 / grid.wavelength**2 - v**2 - u**2)
    field = tuple(u * a + v * b + w * n for a, b, n in zip(*window.axes, strict=True))
    held, transfer = _factor(grid, window, rays, field, (u, v, w), meets, w)
    fy, fx = (xp.where(held, f, xp.zeros_like(f)) for f in (field[1], field[0]))
    return (fy, fx), transfer


def _mixed_transfer(grid: Grid, window: Window, rays: Rays, lines, down: Line):
    """Return the factor of the plane waves with frequencies of the field along rows, of the window along columns.

    Their frequencies along the field's columns and the window's rows, those within `down`, come with it.
    """
    xp = grid.xp
    fy, u = (line.cycles(pitch) / pitch for line, pitch in zip(lines, grid.pitch, strict=True))
    (a_x, a_y, a_z), rows, normal = window.axes
    length = a_x**2 + a_z**2

    def squared(fy, rest):
        return length * (1 / grid.wavelength**2 - fy**2) - rest**2

    rest = u - a_y * fy
    meets = squared(fy, rest) > (1e-3 / grid.wavelength) ** 2
    safe = xp.astype(meets, xp.float64)
    fy, rest = fy * safe, rest * safe
    root = xp.sqrt(squared(fy, rest)) * xp.where(a_x < 0, -xp.ones_like(rest), xp.ones_like(rest))
    field = ((a_x * rest - a_z * root) / length, fy, (a_z * rest + a_x * root) / length)
    v, w = (sum(f * n for f, n in zip(field, unit, strict=True)) for unit in (rows, normal))
    first, last = (index / down.period for index in (down.first, down.first + down.count - 1))
    cycles = v * grid.pitch[0]
    meets = meets & (w > 1e-3 / grid.wavelength) & (cycles > first - 1e-9) & (cycles < last + 1e-9)
    w = xp.where(meets, w, xp.ones_like(w))
    held, transfer = _factor(grid, window, rays, field, ((u + 0 * v), v, w), meets, xp.abs(root))
    middle = (first + last) / 2 / grid.pitch[0]
    return (xp.where(held, field[0], xp.zeros_like(v)), xp.where(held, v, middle + 0 * v)), transfer


def _factor(grid: Grid, window: Window, rays: Rays, field, target, meets, slope):
    """Return where plane waves count, and the factor of each: propagation, guard, area and the window's offset.

    `field` and `target` are their frequencies (x, y, z) in the two planes, `meets` says where these are known, and
    `slope` over the field's z is the area that a frequency takes.
    """
    xp = grid.xp
    (fx, fy, fz), (u, v, w) = field, target
    # Of the two edges of the band that a sampled field holds, one counts.
    edges = [
        (f * pitch >= -0.5 - 1e-9) & (f * pitch < 0.5 - 1e-9) for f, pitch in zip((fy, fx), grid.pitch, strict=True)
    ]
    held = meets & (fz > 0) & edges[0] & edges[1]
    weight = rays.weight(window.guard, (v / w, u / w)) * (fz / slope)
    fy, fx = (xp.where(held, f, xp.zeros_like(f)) for f in (fy + 0 * fx, fx))
    kernel = plane_wave_transfer(grid, fy, fx) * xp.astype(xp.where(held, weight, 0 * weight), grid.dtype)
    return held, carry_to_offset(kernel, window, grid, v, u)
