"""Propagation to a window with a pitch, size and place of its own."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from odak import _array, _validate
from odak._array import Array
from odak.wave.frequency_box import GUARD, Window, carry_to_offset, make_window, to_line, to_window
from odak.wave.grid import Grid
from odak.wave.propagation import check_geometry
from odak.wave.rays import Rays
from odak.wave.request import Request
from odak.wave.transfer_functions import plane_wave_transfer

_log = logging.getLogger("odak")


def propagate_to_window(
    field: Array,
    wavelength: float | Array,
    distance: float | Array,
    dx: float | Array,
    window_shape: Sequence[int] | None = None,
    window_dx: float | Array | None = None,
    offset: Any = (0.0, 0.0),
    guard: float = GUARD,
) -> Array:
    """Propagate a field to a window with its own pitch, number of samples and place.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]`` (a real one is taken as a field of phase zero).
    wavelength : float or array
        Wavelength in metres; an array broadcasts against the field's leading axes.
    distance : float or array
        Distance in metres, negative to propagate back; an array broadcasts against the field's leading axes.
    dx : float or array
        Pixel pitch of the field in metres.
    window_shape : sequence of int, optional
        Rows and columns of the window; by default those of the field.
    window_dx : float or array, optional
        Pixel pitch of the window in metres; by default that of the field.
    offset : sequence of two floats or arrays
        Place (y, x) of the window's sample ``n // 2`` in metres from the optical axis: y along rows, x along columns.
    guard : float
        Room for diffraction around the rays, in units of sqrt(λ·path). 0 cuts the band where the rays end, as
        Matsushima does, at an error of some percent. Of the brightest light, 2 leaves an error of about 1e-4, 4 one of
        1e-7, 6 one of 1e-10.

    Returns
    -------
    array
        Field ``[..., window rows, window columns]`` in the field's library and precision, differentiable in the field
        and in every length that is a tensor.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it, or if the window takes more than 2**28 frequencies.

    Notes
    -----
    Distances and wavelengths of one batch share the frequencies at which the spectrum is taken. That is no matter for
    a field whose light fades towards the edge of the band, 1/(2·dx); noise up to the edge is not defined better than
    its wrapped tails, and depends on the batch it is in.

    Only rays that the field's pitch can hold are there, those of frequencies up to 1/(2·dx). A window beyond their
    reach is dark, and a warning is logged.

    The angular spectrum is taken at the frequencies of rays from the field (width S) to the window (width W), at a
    pitch of 1/(S + W + guard), and summed at the window's samples: no interpolation. Their number along an axis is at
    most (S + W + guard)/dx. Matsushima, Opt. Express 18, 18453 (2010), the shifted band; Muffoletto, Tyler and
    Tohline, Opt. Express 15, 5631 (2007), chirp-z transforms between two pitches.

    Examples
    --------
    >>> import numpy as np
    >>> import odak
    >>> field = np.ones((64, 64), dtype=np.complex128)
    >>> detail = odak.wave.propagate_to_window(field, 532e-9, 0.05, 8e-6, (100, 200), 1e-6, offset=(0.0, 3e-4))
    >>> detail.shape
    (100, 200)
    """
    field = _array.to_complex(_validate.image("field", field))
    check_geometry(None, distance, dx, wavelength)
    window = make_window(field, window_shape, window_dx, dx, offset, guard)
    request = Request(dx, wavelength, distance)
    shape, xp, device = tuple(field.shape[-2:]), _array.namespace(field), _array.device_of(field)
    grid = request.grid(shape, xp, device, field.dtype)
    down, across = Rays.between(grid, window).lines()
    lines = (down.held(), across.held())
    if 1 in (line.count for line in lines):
        _log.warning("the window lies beyond the light that a field of pitch %s m can send: it is dark", dx)
    spectrum = to_line(to_line(field, lines[1]), lines[0])
    build = _Transfer(window)
    kept = window.is_plain()
    kernel = request.transfer_function(build, shape, xp, device, field.dtype) if kept else build(grid)
    return to_window(spectrum * kernel, lines, window, grid)


@dataclass(frozen=True)
class _Transfer:
    """The band-limited transfer function of free space to a window; equal windows make equal keys of the store."""

    window: Window

    def __call__(self, grid: Grid):
        """Return the transfer function in the box of frequencies."""
        xp = grid.xp
        rays = Rays.between(grid, self.window)
        fy, fx = (line.held().cycles(grid.dx) / grid.dx for line in rays.lines())
        squared = 1 / grid.wavelength**2 - fy**2 - fx**2
        # A decaying wave goes nowhere sideways.
        axial = xp.sqrt(xp.where(squared > 0, squared, xp.ones_like(squared) * 1e300))
        weight = rays.weight(self.window.guard, (fy / axial, fx / axial))
        kernel = plane_wave_transfer(grid, fy, fx) * xp.astype(weight, grid.dtype)
        return carry_to_offset(kernel, self.window, grid, fy, fx)
