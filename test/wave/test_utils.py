import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import odak


def test_wave_numbers():
    assert odak.wave.wavenumber(0.5) == pytest.approx(4 * math.pi)
    np.testing.assert_allclose(odak.wave.wavenumber(np.array([1.0, 2.0])), [2 * math.pi, math.pi])
    assert odak.wave.rotationspeed(0.0005) == pytest.approx(2 * math.pi * 3e11 / 0.0005)
    assert odak.wave.rayleigh_resolution(2.0) == pytest.approx(1.22 * 0.0005 / 2)
    assert odak.wave.rayleigh_resolution(2.0, 50.0) == pytest.approx(1.22 * 0.0005 * 25)


@given(amplitude=st.floats(1e-3, 1e3), phase=st.floats(-3.1, 3.1))
def test_amplitude_and_phase_round_trip(amplitude, phase):
    field = odak.wave.generate_complex_field(np.full((2, 3), amplitude), np.full((2, 3), phase))
    np.testing.assert_allclose(odak.wave.calculate_amplitude(field), amplitude, rtol=1e-12)
    np.testing.assert_allclose(odak.wave.calculate_phase(field), phase, atol=1e-12)
    np.testing.assert_allclose(odak.wave.calculate_phase(field, deg=True), math.degrees(phase), atol=1e-9)
    np.testing.assert_allclose(odak.wave.calculate_intensity(field), amplitude**2, rtol=1e-12)


def test_generate_complex_field_broadcasts_and_keeps_precision():
    phase = np.linspace(0, 1, 6, dtype=np.float32).reshape(2, 3)
    assert odak.wave.generate_complex_field(1.0, phase).dtype == np.complex64
    assert odak.wave.generate_complex_field(np.ones(3), phase).dtype == np.complex128
    np.testing.assert_allclose(odak.wave.generate_complex_field(2, 0.5), 2 * np.exp(0.5j))
    np.testing.assert_allclose(odak.wave.generate_complex_field(np.ones(3), 0.5), np.exp(0.5j) * np.ones(3))


def test_phases_of_a_million_radians_keep_their_digits():
    phase = np.array([2 * np.pi * 376_000 + 0.25])
    assert np.angle(odak.wave.generate_complex_field(1.0, phase))[0] == pytest.approx(0.25, abs=1e-9)


def test_set_amplitude_and_add_phase():
    field = np.array([[1 + 1j, -2.0]])
    np.testing.assert_allclose(odak.wave.set_amplitude(field, -3.0), 3 * field / np.abs(field))
    np.testing.assert_allclose(odak.wave.set_amplitude(field, np.array([[3j, 4]])), [[3, 4]] * field / np.abs(field))
    np.testing.assert_allclose(odak.wave.add_phase(field, np.pi / 2), 1j * field, atol=1e-12)
    np.testing.assert_allclose(odak.wave.add_phase(field, np.array([[0.0, np.pi]])), [[1, -1]] * field, atol=1e-12)


def test_random_phase_is_uniform_over_half_turn_and_reproducible():
    field = np.ones((200, 200))
    once, again = (odak.wave.add_random_phase(field, seed=3) for _ in range(2))
    np.testing.assert_array_equal(once, again)
    phase = np.angle(once)
    assert phase.min() >= 0
    assert phase.max() <= np.pi
    assert phase.mean() == pytest.approx(np.pi / 2, abs=0.02)
    assert phase.std() == pytest.approx(np.pi / np.sqrt(12), abs=0.02)


def test_complex_phases_are_refused_rather_than_halved():
    with pytest.raises(TypeError, match="phase must be real"):
        odak.wave.generate_complex_field(1.0, np.asarray([1 + 1j]))
    with pytest.raises(TypeError, match="new_phase must be real"):
        odak.wave.add_phase(np.ones(2), 1j)


def test_metres_where_millimetres_are_the_default():
    with pytest.warns(odak.ArgumentWarning, match=r"by default, in mm, got a diameter of 0\.004"):
        odak.wave.rayleigh_resolution(4e-3)
    with pytest.warns(odak.ArgumentWarning, match=r"in mm with the default c, got 5\.32e-07: give c=299792458\.0"):
        odak.wave.rotationspeed("532 nm")
    assert odak.wave.rayleigh_resolution(4e-3, wavelength=532e-9) == pytest.approx(1.22 * 532e-9 / 4e-3)
    assert odak.wave.rotationspeed("532 nm", 299792458.0) == pytest.approx(2 * math.pi * 299792458.0 / 532e-9)


def test_amplitude_of_the_least_integer_is_positive(as_array):
    field = as_array(np.asarray([-128, 3], np.int8))
    assert np.asarray(odak.wave.calculate_amplitude(field)).tolist() == [128, 3]
    assert np.asarray(odak.wave.calculate_intensity(field)).tolist() == [16384, 9]
