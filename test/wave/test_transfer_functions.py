"""Transfer functions value by value, against their formulas written down plainly in NumPy."""

import numpy as np
import pytest

from odak.wave import transfer_functions as tf
from odak.wave.transfer_functions import make_grid

WAVELENGTH = 500e-9


def grid_of(shape=(12, 15), dx=8e-6, distance=3e-3, **options):
    return make_grid(*shape, dx, WAVELENGTH, distance, dtype=np.complex128, **options)


def frequencies(shape, dx):
    return np.fft.fftfreq(shape[0], dx)[:, None], np.fft.fftfreq(shape[1], dx)[None, :]


@pytest.mark.parametrize("dx", [8e-6, 0.3e-6, 0.2e-6])
@pytest.mark.parametrize("distance", [2e-6, -2e-6])
def test_travelling_and_evanescent_waves(dx, distance):
    fy, fx = frequencies((12, 15), dx)
    axial = np.sqrt((1 / WAVELENGTH**2 - fx**2 - fy**2).astype(complex))
    travels = axial.imag == 0
    assert travels.any() and travels.all() == (dx > 0.5e-6)
    # Evanescent waves decay on both sides.
    expected = np.exp(2j * np.pi * axial * np.where(travels, distance, abs(distance)))
    found = tf.angular_spectrum(grid_of(dx=dx, distance=distance))
    np.testing.assert_allclose(found, expected, atol=1e-11)


def test_the_wave_along_the_plane_is_kept():
    # The highest frequency of eight samples at half a wavelength is 1/λ itself: neither does it turn nor decay.
    grid = make_grid(8, 8, 0.25, 0.5, 3.0, dtype=np.complex128)
    np.testing.assert_allclose(tf.angular_spectrum(grid)[0, 4], 1, atol=1e-12)
    assert abs(tf.angular_spectrum(grid)[1, 4]) < 1e-3


def test_band_limits():
    shape, dx, distance = (12, 15), 8e-6, 3e-3
    grid = grid_of(shape, dx, distance)
    for asked, z in ((None, distance), (7e-3, 7e-3)):
        expected = [1 / (WAVELENGTH * np.sqrt((2 * z / (n * dx)) ** 2 + 1)) for n in shape]
        np.testing.assert_allclose(np.ravel(tf.band_limits(grid, asked)), expected, rtol=1e-14)
    # Close to the plane, all that travels is inside; the 1 under the root says so.
    np.testing.assert_allclose(np.ravel(tf.band_limits(grid, 1e-15)), 1 / WAVELENGTH, rtol=1e-12)


def points(count, width):
    return ((np.arange(count) + 0.5) / count - 0.5) * width


@pytest.mark.parametrize(
    "samples", [(1, 1, 1, 1), (3, 1, 1, 1), (1, 4, 1, 1), (1, 1, 5, 1), (1, 1, 1, 2), (3, 4, 5, 2)]
)
@pytest.mark.parametrize("scale", [1, 2])
def test_impulse_response_averaged_over_apertures(samples, scale):
    nu, nv, dx, distance = 6, 5, 8e-6, 2e-4
    grid = make_grid(nu, nv, dx, WAVELENGTH, distance, scale, samples, dtype=np.complex128)
    constant, *factors = tf.impulse_response_factors(grid)
    k = 2 * np.pi / WAVELENGTH
    expected = np.exp(1j * k * distance) / (1j * WAVELENGTH * distance)
    np.testing.assert_allclose(constant.item(), expected, rtol=1e-9)
    for n, factor, source, target in zip((nu, nv), factors, samples[:2], samples[2:], strict=True):
        x = np.fft.fftfreq(n * scale, 1 / (n * scale)) * dx / scale
        offsets = points(target, dx / scale)[:, None] - points(source, dx)
        mean = np.exp(1j * k * (x[:, None, None] + offsets) ** 2 / (2 * distance)).mean((1, 2))
        np.testing.assert_allclose(np.ravel(factor), mean, atol=1e-10)


@pytest.mark.parametrize("distance", [3e-3, -3e-3])
def test_fresnel_and_rayleigh_sommerfeld(distance):
    shape, dx, k = (12, 15), 8e-6, 2 * np.pi / WAVELENGTH
    grid = grid_of(shape, dx, distance)
    fy, fx = frequencies(shape, dx)
    expected = np.exp(1j * k * distance - 1j * np.pi * WAVELENGTH * distance * (fx**2 + fy**2))
    np.testing.assert_allclose(tf.transfer_function_fresnel(grid), expected, atol=1e-9)
    y, x = (np.fft.fftfreq(n, 1 / n) * dx for n in shape)
    r = np.sqrt(x**2 + y[:, None] ** 2 + distance**2)
    response = abs(distance) / (2 * np.pi * r**2) * (1 / r - 1j * k) * np.exp(1j * k * r)
    expected = np.fft.fft2(response if distance > 0 else response.conj()) * dx**2
    np.testing.assert_allclose(tf.rayleigh_sommerfeld(grid), expected, atol=1e-9)


@pytest.mark.parametrize("dx", [8e-6, 0.2e-6])
def test_incoherent_transfer_function_is_largest_at_zero(dx):
    grid = grid_of((16, 12), dx, 2e-6)
    found = tf.incoherent_angular_spectrum(grid)
    np.testing.assert_allclose(found[0, 0], 1, rtol=1e-12)
    assert (abs(found) <= 1 + 1e-12).all()
    spectrum = tf.angular_spectrum(grid)
    correlation = np.fft.fftn(abs(np.fft.ifftn(spectrum)) ** 2) / (abs(spectrum) ** 2).mean()
    np.testing.assert_allclose(found, correlation, atol=1e-12)


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
@pytest.mark.parametrize(("batch", "kernels"), [((), ()), ((3,), ()), ((), (2,)), ((3, 1), (2,)), ((3, 2), (3, 1))])
def test_arrays_are_filtered_as_by_whole_transforms(dtype, batch, kernels):
    rng = np.random.default_rng(1)
    draw = lambda *shape: (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(dtype)  # noqa: E731
    field, kernel = draw(*batch, 12, 15), draw(*kernels, 24, 31)
    held = field.copy(), kernel.copy()
    found = tf.convolve(field, kernel)
    expected = np.fft.ifft2(np.fft.fft2(field, s=(24, 31)) * kernel)[..., :12, :15]
    assert found.dtype == dtype and found.flags.owndata and found.flags.c_contiguous
    np.testing.assert_allclose(found, expected, rtol=0, atol=100 * np.finfo(dtype).eps)
    assert (field == held[0]).all() and (kernel == held[1]).all()
