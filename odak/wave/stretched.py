"""Angular spectra on a stretched frequency grid: band-extended and adaptive-sampling methods.

Beyond the critical distance N·dx²/λ the phase of the transfer function turns by more than π between two frequencies
of the DFT's grid. A grid of the same number of points over the band |f| ≤ f_c = ½·sqrt(K/(λ|z|)) samples it without
aliasing (Zhang, Zhang and Jin, Opt. Lett. 45, 1543 and 4416 (2020)). Both grids are uniform, so a chirp-z transform
goes from one to the other, exactly and without interpolation.
"""

from odak import _array
from odak.wave.chirp_z import chirp, spread_by_chirp
from odak.wave.grid import Grid
from odak.wave.request import Request
from odak.wave.transfer_functions import plane_wave_transfer


def band_extended(field, request: Request):
    """Return the propagated field with as many frequencies as samples, stretched to the alias-free band."""
    return _propagate(field, request, oversampling=1)


def adaptive_sampling(field, request: Request):
    """Return the propagated field with twice as many frequencies as samples, so that nothing wraps around."""
    return _propagate(field, request, oversampling=2)


def _propagate(field, request: Request, oversampling: int):
    xp = _array.namespace(field)
    rows, columns = field.shape[-2:]
    counts = (oversampling * rows, oversampling * columns)
    grid = request.grid(counts, xp, _array.device_of(field), field.dtype)
    steps = [step * grid.dx for step in _frequency_steps(grid)]
    into = chirp(field, -steps[0], rows, -2) * chirp(field, -steps[1], columns, -1)
    spectrum = spread_by_chirp(field * into, -steps[1], counts[1], axis=-1)
    spectrum = spread_by_chirp(spectrum, -steps[0], counts[0], axis=-2)
    # The chirps behind the transform to frequencies and before the one back are each other's inverse.
    spectrum = spectrum * request.kernel_for(field, _transfer, counts)
    result = spread_by_chirp(spectrum, steps[0], rows, axis=-2)
    result = spread_by_chirp(result, steps[1], columns, axis=-1)
    out = xp.conj(into) * xp.astype(steps[0] * steps[1], field.dtype)
    return xp.astype(result * out, field.dtype, copy=False)


def _frequency_steps(grid: Grid):
    return [_frequency_step(grid, count) for count in grid.shape]


def _frequency_step(grid: Grid, count: int):
    """Return 2·f_c/K, f_c no higher than the Nyquist frequency 1/(2·dx)."""
    xp = grid.xp
    reach = count * grid.dx**2 / grid.wavelength
    stretch = xp.where(
        xp.abs(grid.distance) > reach, xp.abs(grid.distance) / reach, xp.ones_like(grid.distance * reach)
    )
    return 1 / (count * grid.dx * xp.sqrt(stretch))


def _transfer(grid: Grid):
    """Return the angular-spectrum kernel, centred, at the stretched frequencies."""
    frequencies = []
    for axis, (count, step) in enumerate(zip(grid.shape, _frequency_steps(grid), strict=True)):
        indices = grid.xp.arange(count, dtype=grid.xp.float64, device=grid.device) - count // 2
        frequencies.append(grid.xp.reshape(indices, (-1, 1) if axis == 0 else (1, -1)) * step)
    return plane_wave_transfer(grid, *frequencies)
