"""Every free-space transfer function, each once, for NumPy, PyTorch and any other array-API library.

A kernel takes a :class:`~odak.wave.grid.Grid` and returns ``[..., rows, columns]`` in FFT order (zero frequency at
index 0). Phases are counted in cycles, in float64, and lose their whole cycles before any cast: 2πz/λ is about 10⁶
rad, which single precision would resolve to a tenth of a radian only.
"""

import functools

from odak._array import make_complex, phasor_of_cycles
from odak.wave.grid import Grid


def angular_spectrum(grid: Grid):
    """Return exp(i2πz·sqrt(1/λ² − f²)), evanescent waves decaying in both directions (Goodman 2005, eq. 3-70)."""
    return grid.evaluate(lambda fy, fx: plane_wave_transfer(grid, fy, fx))


def plane_wave_transfer(grid: Grid, fy, fx):
    """Return what free space does to the plane waves of frequencies (fy, fx), travelling or evanescent."""
    xp = grid.xp
    transverse = fx**2 + fy**2
    squared = 1 / grid.wavelength**2 - transverse
    if not grid.evanescent:
        return phasor_of_cycles(_cycles(grid, transverse, xp.sqrt(squared)), grid.dtype)
    travels = squared > 0
    one = xp.ones_like(squared)
    wave = phasor_of_cycles(_cycles(grid, transverse, xp.sqrt(xp.where(travels, squared, one))), grid.dtype)
    exponent = -2 * xp.pi * xp.abs(grid.distance) * xp.sqrt(xp.where(squared < 0, -squared, one))
    decay = xp.where(squared == 0, one, xp.exp(exponent))
    return xp.where(travels, wave, xp.astype(decay, grid.dtype))


def axial_cycles(grid: Grid):
    """Return z/λ less its whole cycles, so that what is added to it keeps its digits."""
    cycles = grid.distance / grid.wavelength
    return cycles - grid.xp.round(cycles)


def _cycles(grid: Grid, transverse, axial):
    # z·(axial − 1/λ) without the cancellation: 1/λ² − axial² is the transverse frequency squared.
    return axial_cycles(grid) - grid.distance * transverse / (axial + 1 / grid.wavelength)


def band_limits(grid: Grid, distance=None):
    """Return the frequency (rows, columns) above which a sampled angular-spectrum kernel aliases.

    Matsushima and Shimobaba, Opt. Express 17, 19662 (2009), eq. 13: 1/(λ·sqrt((2z/L)² + 1)), L the grid's width. The
    distance is the grid's own unless another is given.
    """
    distance = grid.distance if distance is None else distance
    return tuple(1 / (grid.wavelength * grid.xp.sqrt((2 * distance / (n * grid.dx)) ** 2 + 1)) for n in grid.shape)


def band_limited_angular_spectrum(grid: Grid, legs=None):
    """Return the angular-spectrum kernel inside its alias-free band, zero outside (Matsushima, Shimobaba 2009).

    `legs` are the distances of a way there and back whose sum is the grid's distance; the band is then that of the
    longest, while the phase is that of the sum.
    """
    distances = [grid.distance] if legs is None else legs
    limit_y, limit_x = band_limits(grid, functools.reduce(grid.xp.maximum, map(grid.xp.abs, distances)))

    def limited(fy, fx):
        kernel = plane_wave_transfer(grid, fy, fx)
        return grid.xp.where((fy < limit_y) & (fx < limit_x), kernel, grid.xp.zeros_like(kernel))

    return grid.evaluate(limited)


def transfer_function_fresnel(grid: Grid):
    """Return exp(ikz)·exp(−iπλz·f²) (Voelz 2011, eq. 4.20)."""
    axial = axial_cycles(grid)
    bend = grid.distance * grid.wavelength / 2
    return grid.evaluate(lambda fy, fx: phasor_of_cycles(axial - bend * (fx**2 + fy**2), grid.dtype))


def impulse_response_factors(grid: Grid):
    """Return the constant and the two one-dimensional factors of the sampled Fresnel impulse response.

    The impulse response exp(ikz)/(iλz)·exp(ik(x² + y²)/(2z)) (Voelz 2011, eq. 4.21), averaged over the source pixel
    and over the target sample, separates: h(x, y) = c·h_y(y)·h_x(x). The average runs over pairs of points
    (w in the source, p in the target), h_x = mean of exp(ik(x + p − w)²/(2z)).

    Returns
    -------
    tuple
        c ``[..., 1, 1]``, h_y ``[..., rows, 1]``, h_x ``[..., 1, columns]``, in FFT order, complex128.
    """
    xp = grid.xp
    double = xp.complex128
    constant = phasor_of_cycles(axial_cycles(grid) - 0.25, double) / xp.astype(grid.wavelength * grid.distance, double)
    factors = []
    for axis, position in zip((-2, -1), grid.positions(), strict=True):
        source, target = _points(grid, grid.samples[2 + axis]), _points(grid, grid.samples[4 + axis]) / grid.scale
        rank = max(position.ndim, grid.wavelength.ndim, grid.distance.ndim)
        offsets = xp.reshape(target[:, None] - source[None, :], (-1,) + (1,) * rank) * grid.dx
        cycles = (position + offsets) ** 2 / (2 * grid.wavelength * grid.distance)
        # Even by symmetry of the two apertures, so the non-negative half says it all.
        mean = xp.sum(phasor_of_cycles(cycles, double), axis=0) / offsets.shape[0]
        factors.append(grid.unfold_axis(mean, axis))
    return constant, *factors


def _points(grid: Grid, count: int):
    """Return `count` points across an aperture of width one, its centre alone when there is one."""
    if count == 1:
        return grid.xp.zeros(1, dtype=grid.xp.float64, device=grid.device)
    return grid.xp.linspace(-0.5, 0.5, count, dtype=grid.xp.float64, device=grid.device)


def impulse_response_fresnel(grid: Grid):
    """Return the discrete Fourier transform of the sampled Fresnel impulse response times the pixel's area."""
    xp = grid.xp
    constant, h_y, h_x = impulse_response_factors(grid)
    spectrum_y = xp.fft.fft(h_y, axis=-2) * xp.astype(constant * grid.dx**2, xp.complex128)
    spectrum_x = xp.fft.fft(h_x, axis=-1)
    return xp.astype(spectrum_y, grid.dtype) * xp.astype(spectrum_x, grid.dtype)


def rayleigh_sommerfeld(grid: Grid):
    """Return the transform of the sampled first Rayleigh–Sommerfeld kernel z·exp(ikr)/(iλr²), times the pixel's area.

    Shen and Wang, Appl. Opt. 45, 1102 (2006). For z < 0 the kernel is the conjugate of the one of |z|; at z = 0 every
    frequency passes.
    """
    xp = grid.xp
    y, x = grid.positions()
    here = grid.distance == 0
    r_squared = x**2 + y**2 + xp.where(here, grid.dx, grid.distance) ** 2
    cycles = xp.sign(grid.distance) * (xp.sqrt(r_squared) / grid.wavelength - 0.25)
    weight = xp.abs(grid.distance) * grid.dx**2 / (grid.wavelength * r_squared)
    kernel = phasor_of_cycles(cycles, xp.complex128) * xp.astype(weight, xp.complex128)
    transfer = xp.astype(xp.fft.fftn(grid.unfold(kernel), axes=(-2, -1)), grid.dtype)
    return xp.where(here, xp.ones_like(transfer), transfer)


def incoherent_angular_spectrum(grid: Grid):
    """Return the optical transfer function of free space: the autocorrelation of the coherent one, 1 at f = 0.

    The autocorrelation is the transform of |h|², the intensity impulse response (Goodman 2005, eq. 6-28).
    """
    xp = grid.xp
    response = xp.fft.ifftn(angular_spectrum(grid), axes=(-2, -1))
    intensity = xp.real(response) ** 2 + xp.imag(response) ** 2
    intensity = intensity / xp.sum(intensity, axis=(-2, -1), keepdims=True)
    return xp.fft.fftn(make_complex(intensity, xp.zeros_like(intensity)), axes=(-2, -1))
