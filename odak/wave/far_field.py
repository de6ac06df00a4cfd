"""The far field: one Fourier transform, and its exact inverse."""

from odak import _array
from odak._array import phasor_of_cycles
from odak.wave.grid import Grid
from odak.wave.request import Request
from odak.wave.transfer_functions import axial_cycles

_AXES = (-2, -1)


def _factor(field, request: Request):
    """Return exp(ikz)/(iλz)·exp(ik(x² + y²)/(2z))·dx² on the output grid, whose pitch is λz/(N·dx), in FFT order."""
    xp = _array.namespace(field)
    grid = request.grid(tuple(field.shape[-2:]), xp, _array.device_of(field), field.dtype)
    return _quadratic(grid)


def _quadratic(grid: Grid):
    xp = grid.xp
    fy, fx = grid.frequencies()
    # With x = λz·f the quadratic phase is πλz·f².
    cycles = axial_cycles(grid) - 0.25 + grid.wavelength * grid.distance * (fx**2 + fy**2) / 2
    amplitude = xp.astype(grid.dx**2 / (grid.wavelength * grid.distance), grid.dtype)
    return grid.unfold(phasor_of_cycles(cycles, grid.dtype) * amplitude)


def fraunhofer_field(field, request: Request):
    """Return the Fraunhofer pattern of a centred field (Goodman 2005, eq. 4-25)."""
    xp = _array.namespace(field)
    spectrum = xp.fft.fftn(xp.fft.ifftshift(field, axes=_AXES), axes=_AXES) * _factor(field, request)
    return xp.astype(xp.fft.fftshift(spectrum, axes=_AXES), field.dtype, copy=False)


def fraunhofer_source(field, request: Request):
    """Return the field whose Fraunhofer pattern is given: the exact inverse, with the pitch of the source plane."""
    xp = _array.namespace(field)
    spectrum = xp.fft.ifftshift(field, axes=_AXES) / _factor(field, request)
    return xp.astype(xp.fft.fftshift(xp.fft.ifftn(spectrum, axes=_AXES), axes=_AXES), field.dtype, copy=False)
