"""Partially coherent light against van Cittert and Zernike, the coherence length and the coherent limit."""

import numpy as np
import pytest
from physics import relative_error
from scipy.special import j1

from odak.wave import disk_source, gaussian_spectrum, propagate_partially_coherent, propagate_to_window

WAVELENGTH, DX = 550e-9, 8e-6


def pinholes(separation, shape=(3, 160)):
    """Return two open pixels `separation` pixels apart, one on each side of the axis and one by one."""
    left, right = np.zeros(shape, complex), np.zeros(shape, complex)
    left[shape[0] // 2, shape[1] // 2 - separation // 2] = 1
    right[shape[0] // 2, shape[1] // 2 + separation // 2] = 1
    return left, right


def interference(separation, spectrum, source, distance=0.05):
    """Return the interference term over its coherent maximum, 2·sqrt(I1·I2), midway behind two pinholes."""
    window = (1, 1), DX
    left, right = pinholes(separation)
    both, one, other = (
        propagate_partially_coherent(field, spectrum, source, distance, DX, *window)[0, 0]
        for field in (left + right, left, right)
    )
    return (both - one - other) / (2 * np.sqrt(one * other))


@pytest.mark.parametrize("separation", [10, 30, 60, 100])
def test_van_cittert_zernike(separation):
    radius = 1e-3
    rho = 2 * np.pi * radius * separation * DX / WAVELENGTH
    measured = interference(separation, WAVELENGTH, disk_source(radius, 8, 32))
    assert measured == pytest.approx(2 * j1(rho) / rho, abs=1e-9)


def test_two_points_beat():
    angle, separation = 1e-3, 40
    source = np.array([[0.0, angle], [0.0, -angle]]), np.array([0.5, 0.5])
    expected = np.cos(2 * np.pi * angle * separation * DX / WAVELENGTH)
    assert interference(separation, WAVELENGTH, source) == pytest.approx(expected, abs=1e-9)
    # A source that is spread along the slits does not blur their fringes.
    assert interference(separation, WAVELENGTH, (source[0][:, ::-1], source[1])) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("path", [0.0, 10e-6, 25e-6, 40e-6])
def test_coherence_length(path):
    width, separation = 5e-9, 100
    spectrum = gaussian_spectrum(WAVELENGTH, width, 15)
    # A source aside makes a path difference between the pinholes; a quarter wave more gives the other quadrature.
    quadratures = [
        interference(separation, spectrum, (np.array([[0.0, length / (separation * DX)]]), np.ones(1)))
        for length in (path, path + WAVELENGTH / 4)
    ]
    expected = np.exp(-((np.pi * width / WAVELENGTH**2 * path) ** 2) / (4 * np.log(2)))
    # A pinhole is brighter in shorter waves, in proportion to 1/λ², and a quarter wave counts against the length.
    assert np.hypot(*quadratures) == pytest.approx(expected, abs=0.01)


def test_gaussian_spectrum_has_its_width():
    wavelengths, weights = gaussian_spectrum(WAVELENGTH, 10e-9, 12)
    wave_numbers = 1 / wavelengths
    assert weights.sum() == pytest.approx(1, abs=1e-14)
    mean = (weights * wave_numbers).sum()
    deviation = np.sqrt((weights * (wave_numbers - mean) ** 2).sum())
    assert mean == pytest.approx(1 / WAVELENGTH, rel=1e-12)
    assert deviation * np.sqrt(8 * np.log(2)) == pytest.approx(10e-9 / WAVELENGTH**2, rel=1e-12)
    for path in (0, 10e-6, 25e-6):
        expected = np.exp(-((np.pi * 10e-9 / WAVELENGTH**2 * path) ** 2) / (4 * np.log(2)))
        visibility = abs((weights * np.exp(2j * np.pi * path * (wave_numbers - mean))).sum())
        assert visibility == pytest.approx(expected, abs=1e-6)


def test_disk_source_integrates_over_a_disk():
    directions, weights = disk_source(2e-3, 3, 9, center=(1e-3, -5e-4))
    y, x = (directions - [1e-3, -5e-4]).T / 2e-3
    assert np.hypot(y, x).max() < 1
    # Averages over the unit disk of 1, r², r⁴, x²y².
    for values, mean in ((1 + 0 * x, 1), (x**2 + y**2, 1 / 2), ((x**2 + y**2) ** 2, 1 / 3), (x**2 * y**2, 1 / 24)):
        assert (weights * values).sum() == pytest.approx(mean, rel=1e-12)


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_one_wavelength_and_one_point_are_coherent(dtype, random):
    field = (random.normal(size=(2, 20, 30)) + 1j * random.normal(size=(2, 20, 30))).astype(dtype)
    distances = np.array([[1e-3], [3e-3], [7e-3]])
    window = (15, 17), 5e-6, (1e-5, 0.0)
    result = propagate_partially_coherent(field, WAVELENGTH, None, distances, DX, *window)
    expected = np.abs(propagate_to_window(field, WAVELENGTH, distances, DX, *window)) ** 2
    assert result.shape == (3, 2, 15, 17) and result.dtype == expected.dtype
    assert relative_error(result, expected) < (1e-6 if dtype == np.complex64 else 1e-14)


def test_a_tilted_wave_moves_the_picture():
    y = (np.arange(96) - 48)[:, None] * DX
    field = np.exp(-(y**2 + y.T**2) / 1e-4**2) + 0j
    source = np.array([[4e-3, -2e-3]]), np.array([2.0])
    result = propagate_partially_coherent(field, WAVELENGTH, source, 0.02, DX)
    still = propagate_partially_coherent(field, WAVELENGTH, None, 0.02, DX)
    # 4e-3·20 mm = 80 µm = 10 pixels; the geometry is paraxial to 1e-5.
    assert relative_error(result[30:80, 30:70], 2 * still[20:70, 35:75]) < 1e-3


def test_memory_changes_nothing_and_energy_is_kept(random):
    field = np.pad(random.random((16, 16)), 24).repeat(2, 0).repeat(2, 1) + 0j
    lamp = gaussian_spectrum(WAVELENGTH, 20e-9, 3), disk_source(5e-4, 2, 5)
    whole = propagate_partially_coherent(field, *lamp, 1e-3, DX)
    pieces = propagate_partially_coherent(field, *lamp, 1e-3, DX, memory=1)
    np.testing.assert_allclose(pieces, whole, rtol=1e-10, atol=1e-12)
    assert whole.sum() == pytest.approx((np.abs(field) ** 2).sum(), rel=1e-3)


def test_a_field_may_depend_on_the_wavelength():
    height = 1e-6 * (np.arange(24) % 2)[None] * np.ones((20, 1))

    def etched(wavelength):
        return np.exp(2j * np.pi * 0.5 * height / wavelength)

    wavelengths, weights = np.array([450e-9, 640e-9]), np.array([0.3, 0.7])
    result = propagate_partially_coherent(etched, (wavelengths, weights), None, 1e-3, DX)
    expected = sum(
        w * np.abs(propagate_to_window(etched(wavelength), wavelength, 1e-3, DX)) ** 2
        for wavelength, w in zip(wavelengths, weights, strict=True)
    )
    assert relative_error(result, expected) < 1e-12


def test_libraries_agree(as_array, random):
    field = random.normal(size=(12, 15)) + 1j * random.normal(size=(12, 15))
    lamp = gaussian_spectrum(WAVELENGTH, 20e-9, 3), disk_source(1e-3, 2, 5)
    expected = propagate_partially_coherent(field, *lamp, 1e-3, DX, (9, 8), 5e-6)
    result = propagate_partially_coherent(as_array(field), *lamp, 1e-3, DX, (9, 8), 5e-6)
    np.testing.assert_allclose(np.asarray(result), expected, atol=1e-10)


ONE = np.ones((4, 4), complex)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((ONE, -1.0, None, 1e-3, DX), "spectrum"),
        ((ONE, ([1e-6, 2e-6], [1.0]), None, 1e-3, DX), "spectrum"),
        ((ONE, ([1e-6],), None, 1e-3, DX), "spectrum"),
        ((ONE, WAVELENGTH, (np.zeros((2, 3)), np.ones(2)), 1e-3, DX), "source"),
        ((ONE, WAVELENGTH, (np.zeros((2, 2)), np.ones(3)), 1e-3, DX), "source"),
        ((ONE, WAVELENGTH, np.zeros((2, 2)), 1e-3, DX), "source"),
        ((ONE[0], WAVELENGTH, None, 1e-3, DX), "field"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        propagate_partially_coherent(*arguments)


def test_bad_lamps():
    with pytest.raises(ValueError, match="width"):
        gaussian_spectrum(WAVELENGTH, 400e-9, 9)
    with pytest.raises(ValueError, match="count"):
        gaussian_spectrum(WAVELENGTH, 4e-9, 0)
    with pytest.raises(ValueError, match="radius"):
        disk_source(1.5)
    with pytest.raises(ValueError, match="rings"):
        disk_source(1e-3, 0)


def test_rectangular_pixels(random):
    y, x = (np.arange(n) - n // 2 for n in (48, 48))
    field = np.exp(-((y[:, None] / 4) ** 2) - (x / 5) ** 2) * (1 + 0j)
    options = {"spectrum": 550e-9, "source": disk_source(2e-3, 2, 5), "distance": 2e-3}
    window = {"window_shape": (20, 20), "window_dx": 4e-6}
    expected = propagate_partially_coherent(field, **options, dx=4e-6, **window)
    found = propagate_partially_coherent(field[:, ::2], **options, dx=(4e-6, 8e-6), **window)
    np.testing.assert_allclose(found, expected, atol=1e-6 * expected.max())
