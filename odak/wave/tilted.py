"""Propagation to a tilted plane: the angular spectrum in the plane's own coordinates."""

import logging
from collections.abc import Sequence
from typing import Any

from odak import _array, _validate
from odak._array import Array
from odak.wave.frequency_box import GUARD, Window, carry_to_offset, column, make_window, to_window
from odak.wave.grid import Grid
from odak.wave.nonuniform import spectrum_at
from odak.wave.propagation import check_geometry
from odak.wave.rays import Rays
from odak.wave.request import Request
from odak.wave.transfer_functions import plane_wave_transfer

_log = logging.getLogger("odak")
# Cosine of 88 degrees.
GRAZING = 0.035


def propagate_to_tilted_plane(
    field: Array,
    wavelength: float | Array,
    distance: float | Array,
    dx: float | Array,
    angles: Any = (0.0, 0.0, 0.0),
    window_shape: Sequence[int] | None = None,
    window_dx: Array = None,
    offset: Any = (0.0, 0.0),
    guard: float = GUARD,
) -> Array:
    """Propagate a field to a plane that is rotated about the point where the optical axis meets it.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``.
    wavelength, distance, dx : float or array
        As in :func:`odak.wave.propagate_to_window`, in metres. The distance is that of the rotation's centre.
    angles : sequence of three floats or arrays
        Rotation in degrees about the x axis (columns), then y (rows), then z (light), right-handed, the axes fixed.
        (θ, 0, 0) takes the rows of larger y further away; (0, θ, 0) brings the columns of larger x nearer.
    window_shape, window_dx, offset, guard
        As in :func:`odak.wave.propagate_to_window`, along the rows and columns of the tilted plane.

    Returns
    -------
    array
        Field ``[..., window rows, window columns]`` at the points (0, 0, z) + R·(x, y, 0), in the field's library and
        precision; differentiable in the field, the lengths and the angles.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it; if the plane is turned by 90° or more from the light.

    Notes
    -----
    Matsushima, Schimmel and Wyrowski, J. Opt. Soc. Am. A 20, 1755 (2003): a plane wave stays one on any plane. Its
    frequencies rotate, and the spectrum is multiplied by the Jacobian f_z/f_z'. The field's spectrum is needed between
    the frequencies of its grid; a non-uniform Fourier transform finds it to about 1e-7 (complex64) or 1e-12
    (complex128), so that no interpolation error is seen. Waves that decay are left out.

    The field turns fast along a tilted plane, sin θ/λ cycles per metre. The samples are right whatever their pitch;
    to show that phase, or to propagate further, `window_dx` must be below λ/(2·sin θ).

    Beyond 88° light travels along the plane without end and is cut: the field there may be wrong, and that is logged.

    Examples
    --------
    >>> import numpy as np
    >>> import odak
    >>> field = np.ones((32, 32), dtype=np.complex128)
    >>> odak.wave.propagate_to_tilted_plane(field, 532e-9, 0.01, 8e-6, angles=(0.0, 30.0, 0.0)).shape
    (32, 32)
    """
    field = _array.to_complex(_validate.image("field", field))
    check_geometry(None, distance, dx, wavelength)
    xp = _array.namespace(field)
    request = Request(dx, wavelength, distance)
    grid = request.grid(tuple(field.shape[-2:]), xp, _array.device_of(field), field.dtype)
    window = make_window(field, window_shape, window_dx, dx, offset, guard, _rotated_axes(angles, grid))
    rays = Rays.between(grid, window)
    if rays.numbers().axes[2][2].min() < 1e-3:
        raise ValueError(f"angles must turn the plane's normal by less than 90 degrees from the axis, got {angles!r}")
    if rays.numbers().axes[2][2].min() < GRAZING:
        _log.warning("angles %r graze the plane: light along it is cut, and the field there may be wrong", angles)
    lines = rays.lines()
    (fy, fx), transfer = _transfer(grid, window, rays, lines)
    return to_window(spectrum_at(field, fy * grid.dx, fx * grid.dx) * transfer, lines, window, grid)


def _rotated_axes(angles, grid: Grid) -> tuple:
    """Return the plane's unit vectors (x, y, z) along its columns, its rows and its normal: the columns of Rz·Ry·Rx."""
    xp = grid.xp
    turns = [column(angle, grid) * (xp.pi / 180) for angle in _validate.several("angles", angles, 3)]
    (cx, cy, cz), (sx, sy, sz) = ([function(turn) for turn in turns] for function in (xp.cos, xp.sin))
    return (
        (cz * cy, sz * cy, -sy),
        (cz * sy * sx - sz * cx, sz * sy * sx + cz * cx, cy * sx),
        (cz * sy * cx + sz * sx, sz * sy * cx - cz * sx, cy * cx),
    )


def _transfer(grid: Grid, window: Window, rays: Rays, lines):
    """Return the field's frequencies (y, x) of the plane waves in the box, and what each is multiplied by."""
    xp = grid.xp
    v, u = (line.cycles(grid.dx) / grid.dx for line in lines)
    squared = 1 / grid.wavelength**2 - v**2 - u**2
    meets = squared > (1e-3 / grid.wavelength) ** 2
    # Any frequency will do for what is left out.
    safe = xp.astype(meets, xp.float64)
    v, u = v * safe, u * safe
    w = xp.sqrt(1 / grid.wavelength**2 - v**2 - u**2)
    fx, fy, fz = (u * a + v * b + w * n for a, b, n in zip(*window.axes, strict=True))
    weight = rays.weight(window.guard, (v / w, u / w)) * safe * (fz / w)
    # Of the two edges of the band that a sampled field holds, one counts.
    edges = [(f * grid.dx >= -0.5 - 1e-9) & (f * grid.dx < 0.5 - 1e-9) for f in (fy, fx)]
    held = (fz > 0) & edges[0] & edges[1]
    fy, fx = (xp.where(held, f, xp.zeros_like(f)) for f in (fy, fx))
    kernel = plane_wave_transfer(grid, fy, fx) * xp.astype(xp.where(held, weight, 0 * weight), grid.dtype)
    return (fy, fx), carry_to_offset(kernel, window, grid, v, u)
