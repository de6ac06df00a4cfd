"""Propagation to a tilted plane: the angular spectrum in the plane's own coordinates."""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array
from odak._warnings import AccuracyWarning, warn
from odak.wave.fourier import InterpolatedSpectrum, Line, spectrum_along, spectrum_at, to_line
from odak.wave.transfer_functions import (
    Grid,
    Request,
    check_geometry,
    kernels,
    outside_inference,
    plane_wave_transfer,
)
from odak.wave.windows import GUARD, Rays, Window, carry_to_offset, column, make_window, to_window

# Cosine of 88 degrees.
GRAZING = 0.035


def propagate_to_tilted_plane(
    field: Array,
    wavelength: float | Array,
    distance: float | Array,
    dx: float | Sequence[float] | Array,
    angles: Any = (0.0, 0.0, 0.0),
    window_shape: Sequence[int] | None = None,
    window_dx: Array | None = None,
    offset: Any = (0.0, 0.0),
    guard: float = GUARD,
    source_angles: Any = (0.0, 0.0, 0.0),
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
        Rows and columns of the window; by default those of the field.
    window_dx : float, pair of float or array, optional
        Pixel pitch along the rows and columns of the tilted plane; by default that of the field.
    offset : sequence of two floats or arrays
        Place (y, x) of the window's sample ``n // 2`` in the tilted plane, in metres from the rotation's centre.
    guard : float
        Margin for diffraction around the rays, see :func:`odak.wave.propagate_to_window`.
    source_angles : sequence of three floats or arrays, or array
        Rotation of the field's plane about the origin, in the same form as `angles`; `distance` and `angles` remain
        those of the optical axis, along z.

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
    frequencies rotate, and the spectrum is multiplied by the Jacobian f_z/f_z'. The field's spectrum is needed between
    the frequencies of its grid; a non-uniform Fourier transform finds it to about 1e-7 (complex64) or 1e-12
    (complex128), so that no interpolation error is seen; for a rotation about x or y alone it is needed along one axis
    only, which is quicker. Waves that decay are left out.

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
    path = kernels.get(key, functools.partial(build, kept=True)) if key else build()
    if path.least < GRAZING:
        warn(
            f"angles {angles!r} tilt the plane by more than 88 degrees: waves along it are cut off, and the field "
            "there may be wrong",
            AccuracyWarning,
        )
    return to_window(path.spectrum(field) * path.transfer, path.lines, path.window, path.grid)


@dataclass(frozen=True)
class _Path:
    """What leads from the spectrum of a field to its window on a tilted plane.

    Attributes
    ----------
    grid : Grid
        The grid of the field, in the coordinates of its plane.
    window : Window
        The window, in the same coordinates.
    lines : tuple of Line
        Frequencies along its rows and columns.
    spectrum : callable
        Returns the spectrum of a field at the frequencies that become those of the lines.
    transfer : array
        Factor of each of them.
    least : float
        Cosine of the angle between the planes.
    """

    grid: Grid
    window: Window
    lines: tuple[Line, Line]
    spectrum: Callable
    transfer: Any
    least: float

    @property
    def held_bytes(self) -> int:
        """Return the bytes that the path takes in the store of kernels."""
        return 16 * math.prod(self.transfer.shape) + getattr(self.spectrum, "held_bytes", 0)


def _key(field, request: Request, window: Window, angles, source_angles) -> tuple | None:
    """Return what names a path in the store of kernels, None if it is not known as numbers or the field is traced."""
    plain = all(isinstance(value, (tuple, list)) for value in (angles, source_angles)) and all(
        isinstance(value, (int, float)) for value in (*angles, *source_angles)
    )
    known = plain and request.is_plain() and window.is_plain() and not _array.is_wrapped(field)
    if not known:
        return None
    xp, device = _array.namespace(field), str(_array.device_of(field))
    geometry = (request.geometry, window, tuple(angles), tuple(source_angles))
    return ("tilted", tuple(field.shape[-2:]), geometry, xp.__name__, device, str(field.dtype))


def _tilted_path(field, request: Request, window: Window, angles, source_angles, kept: bool = False) -> _Path:
    """Return the path of a field to a tilted plane; one that is kept interpolates by a matrix where it can."""
    xp, shape = _array.namespace(field), tuple(field.shape[-2:])
    with outside_inference(xp):
        grid = request.grid(shape, xp, _array.device_of(field), field.dtype)
        straight = isinstance(source_angles, (tuple, list)) and all(map(_is_zero, source_angles))
        window = replace(window, axes=_rotated_axes("angles", angles, grid))
        if not straight:
            grid, window = _seen_from(_rotated_axes("source_angles", source_angles, grid), grid, window)
        rays = Rays.between(grid, window)
        least = float(rays.numbers().axes[2][2].min())
        if least < 1e-3:
            raise ValueError(
                "angles and source_angles must tilt the planes by less than 90 degrees, "
                f"got {angles!r}, {source_angles!r}"
            )
        lines = rays.lines()
        (fy, fx), transfer = _transfer(grid, window, rays, lines)
        dy, dx = grid.pitch
        axis = _axis_kept(angles) if straight else None
        spectrum = _spectrum_of_path(axis, lines, (fy * dy, fx * dx), field, transfer if kept else None)
    return _Path(grid, window, lines, spectrum, transfer, least)


def _spectrum_of_path(axis: int | None, lines, cycles, field, transfer) -> Callable:
    """Return the function that takes a field to its spectrum at frequencies (y, x); those along `axis` are a line's.

    Where `transfer` is given, the path is kept, and a sparse matrix interpolates the spectrum where that is not zero.
    """
    cycles_y, cycles_x = cycles
    line = None if axis is None else lines[0 if axis == -2 else 1]
    matrix = None
    if transfer is not None and transfer.ndim == 2 and _fits(transfer, field):
        size = np.abs(np.asarray(transfer))
        y, x = (None if axis == own else np.asarray(c) for own, c in ((-2, cycles_y), (-1, cycles_x)))
        shape = (size.shape[0] if axis == -2 else field.shape[-2], size.shape[1] if axis == -1 else field.shape[-1])
        matrix = InterpolatedSpectrum(y, x, shape, _array.is_double(field), size > 1e-13 * size.max())
    if line is None:
        return matrix or (lambda field: spectrum_at(field, cycles_y, cycles_x))
    if matrix is not None:
        return _Composed(line, matrix)
    one, other = (cycles_x, -1) if axis == -2 else (cycles_y, -2)
    return lambda field: spectrum_along(to_line(field, line), one, other)


def _fits(transfer, field) -> bool:
    """Return whether a matrix can be used for a field, and be kept with others in the store of kernels."""
    # Taps along both axes, an index and a weight or two each.
    largest = math.prod(transfer.shape) * (14 * 20 if _array.is_double(field) else 8 * 12)
    on_cpu = "cpu" in str(_array.device_of(field)).lower()
    return on_cpu and _array.has_sparse_matrices(field) and largest < kernels.maximum_bytes // 2


@dataclass(frozen=True)
class _Composed:
    """Transform along one axis and interpolation along the other."""

    line: Line
    matrix: InterpolatedSpectrum

    @property
    def held_bytes(self) -> int:
        """Return the bytes of the matrix."""
        return self.matrix.held_bytes

    def __call__(self, field):
        """Return the spectrum of a field."""
        return self.matrix(to_line(field, self.line))


def _is_zero(value) -> bool:
    """Return whether an angle is a plain zero; a tensor may require the derivative there."""
    return not _array.is_array(value) and value == 0


def _axis_kept(angles) -> int | None:
    """Return the axis (-2 or -1) whose frequencies a rotation about y or x alone leaves as they are, or None."""
    if _array.is_array(angles) or not _is_zero(angles[2]):
        return None
    return -2 if _is_zero(angles[0]) else -1 if _is_zero(angles[1]) else None


def _rotated_axes(name: str, angles, grid: Grid) -> tuple:
    """Return the plane's unit vectors (x, y, z) along its columns, its rows and its normal: the columns of Rz·Ry·Rx."""
    xp = grid.xp
    if _array.is_array(angles) and angles.ndim == 2:
        matrix = _array.cast(_validate.real(name, angles), grid.wavelength)
        if tuple(matrix.shape) != (3, 3):
            raise ValueError(f"{name} must be three angles or a rotation matrix [3, 3], got {tuple(matrix.shape)}")
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
    fx, fy, fz = (u * a + v * b + w * n for a, b, n in zip(*window.axes, strict=True))
    weight = rays.weight(window.guard, (v / w, u / w)) * safe * (fz / w)
    # Of the two edges of the band that a sampled field holds, one counts.
    cycles = [f * pitch for f, pitch in zip((fy, fx), grid.pitch, strict=True)]
    edges = [(f >= -0.5 - 1e-9) & (f < 0.5 - 1e-9) for f in cycles]
    held = (fz > 0) & edges[0] & edges[1]
    fy, fx = (xp.where(held, f, xp.zeros_like(f)) for f in (fy, fx))
    kernel = plane_wave_transfer(grid, fy, fx) * xp.astype(xp.where(held, weight, 0 * weight), grid.dtype)
    return (fy, fx), carry_to_offset(kernel, window, grid, v, u)
