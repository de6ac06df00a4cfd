"""A window of its own pitch, size and place, against closed forms, the direct sum and ordinary propagation."""

import numpy as np
import pytest
from physics import coordinates, relative_error, wrapped_phasor

import odak
from odak.wave import propagate_beam, propagate_to_window
from odak.wave.windows import MAXIMUM_FREQUENCIES

WAVELENGTH, DX = 532e-9, 8e-6


def beam(shape, dx, offset, waist, distance, wavelength=WAVELENGTH):
    """Return the Gaussian beam of Siegman, Lasers (1986), eq. 16.7, on a window anywhere."""
    y, x = coordinates(shape, dx)
    squared = (y + offset[0]) ** 2 + (x + offset[1]) ** 2
    rayleigh = np.pi * waist**2 / wavelength
    q = distance - 1j * rayleigh
    return -1j * rayleigh / q * wrapped_phasor(distance, wavelength) * np.exp(1j * np.pi / wavelength * squared / q)


def direct_sum(field, wavelength, distance, dx, shape, window_dx, offset):
    """Return the first Rayleigh–Sommerfeld integral (Goodman 2005, eq. 3-41, near term kept) as a sum over samples."""
    y, x = coordinates(field.shape, dx)
    rows, columns = coordinates(shape, window_dx)
    up = (rows + offset[0])[..., None, None] - y
    along = (columns + offset[1])[..., None, None] - x
    r = np.sqrt(up**2 + along**2 + distance**2)
    kernel = distance / r**2 * (1 / (2 * np.pi * r) - 1j / wavelength) * wrapped_phasor(r, wavelength)
    return (field * kernel).sum((-1, -2)) * dx**2


def patch(shape=(48, 44), dx=2e-6):
    """Return a smooth small field with some detail in it."""
    y, x = coordinates(shape, dx)
    return np.exp(-(y**2 + x**2) / 1.5e-5**2) * (1 + 0.5 * np.cos(2 * np.pi * x / 1.5e-5 + 1)) * np.exp(2e5j * y)


@pytest.mark.parametrize("distance", [-0.05, 0.0, 5e-3, 0.1, 1.0])
@pytest.mark.parametrize("shape", [(256, 251), (251, 256)])
@pytest.mark.parametrize(
    ("window_shape", "pitch", "offset"),
    [((90, 101), 3e-6, (1e-4, -2e-4)), ((60, 51), 3e-5, (0.0, 2e-4)), ((7, 1), 1e-7, (0, 0))],
)
def test_gaussian_beam(distance, shape, window_shape, pitch, offset):
    waist = 2.2e-4
    start = beam(shape, DX, (0, 0), waist, 0.0)
    expected = beam(window_shape, pitch, offset, waist, distance)
    result = propagate_to_window(start, WAVELENGTH, distance, DX, window_shape, pitch, offset)
    # The paraxial error of the closed form and the beam's tail outside the field.
    assert relative_error(result, expected) < 1e-6
    single = propagate_to_window(start.astype(np.complex64), WAVELENGTH, distance, DX, window_shape, pitch, offset)
    assert single.dtype == np.complex64
    assert relative_error(single, expected) < 2e-6


@pytest.mark.parametrize(("guard", "error"), [(2, 2e-4), (4, 5e-7), (6, 1e-10)])
@pytest.mark.parametrize(("distance", "offset"), [(3e-3, (0, 0)), (3e-3, (2e-5, -7e-5))])
def test_direct_sum_and_the_guard(guard, error, distance, offset):
    window = (30, 33), 1.3e-6, offset
    result = propagate_to_window(patch(), WAVELENGTH, distance, 2e-6, *window, guard=guard)
    expected = direct_sum(patch(), WAVELENGTH, distance, 2e-6, *window)
    assert np.abs(result - expected).max() < error * np.abs(patch()).max()


@pytest.mark.parametrize(
    ("aperture", "far", "near"), [(0.5, 4e-6, 1e-4), (0.7, 2e-5, 2e-4), (0.87, 2e-4, 1e-3), (0.96, 3e-4, 5e-3)]
)
def test_the_guard_at_high_apertures(aperture, far, near):
    """An oblique beam in the middle of its path, 200 and 40 wavelengths away: the errors that are documented."""
    y, x = coordinates((96, 96), 1e-7)
    field = np.exp(-(y**2 + x**2) / 1.5e-6**2) * np.exp(2j * np.pi * aperture * x / 5e-7)
    for distance, error in ((1e-4, far), (2e-5, near)):
        window = (9, 9), 3e-7, (0.0, distance * aperture / np.sqrt(1 - aperture**2))
        result = propagate_to_window(field, 5e-7, distance, 1e-7, *window)
        expected = direct_sum(field, 5e-7, distance, 1e-7, *window)
        assert np.abs(result - expected).max() < error
        assert np.abs(expected).max() > 0.01


def test_noise_at_the_band_edge_is_as_uncertain_as_its_tails(random):
    field = np.exp(2j * np.pi * random.random((32, 32)))
    frequency = np.fft.fftfreq(1024, 8e-6)
    kernel = np.exp(2j * np.pi * 0.01 * np.sqrt(1 / WAVELENGTH**2 - frequency[:, None] ** 2 - frequency**2))
    wide = np.fft.ifft2(np.fft.fft2(field, (1024, 1024)) * kernel)[:32, :32]
    assert 0.01 < relative_error(propagate_to_window(field, WAVELENGTH, 0.01, 8e-6), wide) < 0.1


def test_the_guard_governs_hard_edges_too(random):
    field = random.normal(size=(64, 60)) + 1j * random.normal(size=(64, 60))
    arguments = field, WAVELENGTH, 0.1, DX, (50, 70), 1e-5, (3e-4, 0.0)
    best = propagate_to_window(*arguments, guard=9)
    errors = [relative_error(propagate_to_window(*arguments, guard=guard), best) for guard in (0, 2, 4, 6)]
    assert 0.1 < errors[0] < 0.5 and errors[1] < 2e-2 and errors[2] < 5e-5 and errors[3] < 1e-7


@pytest.mark.parametrize("distance", [1e-3, 0.01])
def test_the_fields_own_grid_is_band_limited_propagation(distance):
    start = beam((128, 129), DX, (1e-4, 0), 1e-4, 0.0) * np.exp(1e4j * coordinates((128, 129), DX)[1])
    expected = propagate_beam(start, None, distance, DX, WAVELENGTH, "BLAS", zero_padding=(True, False, True))
    assert relative_error(propagate_to_window(start, WAVELENGTH, distance, DX), expected) < 1e-9


def test_at_distance_zero_the_field_comes_back(random):
    field = random.normal(size=(31, 40)) + 1j * random.normal(size=(31, 40))
    assert relative_error(propagate_to_window(field, WAVELENGTH, 0.0, DX), field) < 1e-12
    moved = propagate_to_window(field, WAVELENGTH, 0.0, DX, (9, 8), DX, (3 * DX, -5 * DX))
    assert relative_error(moved, field[15 + 3 - 4 : 15 + 3 + 5, 20 - 5 - 4 : 20 - 5 + 4]) < 1e-12


def test_energy_and_the_way_back(random):
    start = patch()
    wide = propagate_to_window(start, WAVELENGTH, 1e-3, 2e-6, (150, 150), 2.5e-6)
    assert (np.abs(wide) ** 2).sum() * 2.5**2 == pytest.approx((np.abs(start) ** 2).sum() * 2**2, rel=1e-9)
    back = propagate_to_window(wide, WAVELENGTH, -1e-3, 2.5e-6, (48, 44), 2e-6)
    # The field is cut at 4e-5 of its maximum, and that step is finer than the window's pitch.
    assert relative_error(back, start) < 5e-5


def test_far_window_needs_few_frequencies():
    from odak.wave.transfer_functions import Request
    from odak.wave.windows import Rays, make_window

    field = np.zeros((256, 256), complex)
    grid = Request(DX, WAVELENGTH, 5.0).grid((256, 256), odak._array.namespace(field), None, np.complex128)
    window = make_window(field, (1000, 1000), 5e-5, DX, (0, 0), 4.0)
    lines = Rays.between(grid, window).lines()
    # (S + W + guard)·(S + W + 2·guard)/(λz), far below the (S + W)/dx = 6500 of a padded grid.
    assert max(line.count for line in lines) < 1600


def test_batches_broadcast_like_propagate_beam(random):
    start = patch((72, 66))
    fields = np.stack([start, start[::-1]])[:, None] * (1 + 1j * random.normal())
    wavelengths, distances = np.array([450e-9, 532e-9, 638e-9]), np.array([[1e-3], [4e-3]])
    offsets = np.array([1e-5, 0.0, -4e-5])
    result = propagate_to_window(fields, wavelengths, distances, DX, (11, 12), 3e-6, (0.0, offsets))
    assert result.shape == (2, 3, 11, 12)
    for i in range(2):
        for j in range(3):
            one = propagate_to_window(
                fields[i, 0], wavelengths[j], distances[i, 0], DX, (11, 12), 3e-6, (0.0, float(offsets[j]))
            )
            # What depends on the frequencies that a batch shares is the guard's error.
            assert np.abs(result[i, j] - one).max() < 1e-6 * np.abs(fields).max()


def test_libraries_agree(as_array, random):
    field = random.normal(size=(12, 15)) + 1j * random.normal(size=(12, 15))
    arguments = WAVELENGTH, 2e-3, DX, (10, 9), 5e-6, (1e-5, 2e-5)
    result = propagate_to_window(as_array(field), *arguments)
    np.testing.assert_allclose(np.asarray(result), propagate_to_window(field, *arguments), atol=1e-10)


def test_dark_window_warns():
    with pytest.warns(odak.SamplingWarning, match="out of reach"):
        result = propagate_to_window(patch((48, 44), DX), WAVELENGTH, 0.01, DX, (8, 8), DX, (0.0, 0.02))
    assert np.abs(result).max() < 1e-9


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"window_shape": (0, 4)}, ValueError, "window_shape"),
        ({"window_shape": 4}, ValueError, "window_shape"),
        ({"offset": (0.0,)}, ValueError, "offset"),
        ({"offset": (0.0, float("inf"))}, ValueError, "offset"),
        ({"guard": -1.0}, ValueError, "guard"),
        ({"field": [1.0]}, TypeError, "field"),
        ({"window_shape": (8, 8), "window_dx": 1.0, "distance": 1e-3}, ValueError, str(MAXIMUM_FREQUENCIES)),
    ],
)
def test_bad_arguments(change, error, message):
    arguments = {"field": patch(), "wavelength": WAVELENGTH, "distance": 1e-3, "dx": DX, **change}
    with pytest.raises(error, match=message):
        propagate_to_window(**arguments)
