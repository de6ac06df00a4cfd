"""Jones matrices against Malus, textbook states, unitarity and the rotation of frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odak import jones

ANGLE = st.floats(-720, 720)
RIGHT, LEFT = np.asarray([[1], [-1j]]) / np.sqrt(2), np.asarray([[1], [1j]]) / np.sqrt(2)
TERMS = {
    "polarizer": lambda: jones.polarizer(20),
    "retarder": lambda: jones.retarder(77, 33),
    "diattenuator": lambda: jones.diattenuator(0.9, 0.2, -15),
    "rotator": lambda: jones.rotator(12),
    "mirror": lambda: jones.mirror(0.9 + 0.1j, 0.8),
    "circular": lambda: jones.circular_polarizer("left"),
}


def turn(angle):
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.asarray([[c, -s], [s, c]])


def power(field):
    return (np.abs(field) ** 2).sum(-2)


def test_numbers_of_the_specification():
    np.testing.assert_array_equal(jones.electricfield(0.5, 2j), [[0.5], [2j]])
    np.testing.assert_allclose(jones.linearpolarizer(jones.electricfield(1, 1), 30), [[1.18301], [0.68301]], atol=5e-6)
    np.testing.assert_allclose(jones.linearpolarizer([[1], [1j]], 45), [[0.5 + 0.5j]] * 2, atol=1e-15)


@given(ANGLE)
def test_malus(angle):
    passed = jones.linearpolarizer(jones.electricfield(1, 0), angle)
    np.testing.assert_allclose(power(passed), np.cos(np.radians(angle)) ** 2, atol=1e-12)
    # What passes is linear along the axis.
    np.testing.assert_allclose(turn(-angle) @ passed, [[np.cos(np.radians(angle))], [0]], atol=1e-12)


def test_quarter_wave_plate_makes_circular_light_of_hand_stated():
    # Along the fast axis at 45° the field leads; x → fast then slow: clockwise for who looks at the source.
    for angle, state in ((45, RIGHT), (-45, LEFT)):
        out = jones.apply_matrix(jones.quarter_wave_plate(angle), jones.electricfield(1, 0))
        assert abs(np.vdot(state, out)) == pytest.approx(1, abs=1e-12)
        time = np.asarray([0, 1e-3])  # ωt, a moment apart
        x, y = (np.real(out[i] * np.exp(-1j * time)) for i in (0, 1))
        counter_clockwise = x[0] * y[1] - x[1] * y[0] > 0
        assert counter_clockwise == (state is LEFT)


@given(ANGLE, ANGLE)
def test_half_wave_plate_mirrors_linear_light_about_its_axis(start, angle):
    linear = turn(start) @ [[1], [0]]
    out = jones.apply_matrix(jones.half_wave_plate(angle), linear)
    assert abs(np.vdot(turn(2 * angle - start) @ [[1], [0]], out)) == pytest.approx(1, abs=1e-10)


@given(ANGLE, ANGLE)
def test_lossless_elements_are_unitary(first, second):
    for matrix in (jones.retarder(first, second), jones.rotator(first), jones.mirror()):
        np.testing.assert_allclose(matrix.conj().T @ matrix, np.eye(2), atol=1e-12)
    assert np.linalg.det(jones.retarder(first, second)) == pytest.approx(1, abs=1e-12)


@given(ANGLE, ANGLE, ANGLE)
def test_elements_compose(first, second, angle):
    compose = jones.cascade(jones.retarder(first, angle), jones.retarder(second, angle))
    np.testing.assert_allclose(compose, jones.retarder(first + second, angle), atol=1e-11)
    np.testing.assert_allclose(
        jones.cascade(jones.rotator(first), jones.rotator(second)), jones.rotator(first + second), atol=1e-11
    )
    # Two half-wave plates rotate by twice the angle between them.
    pair = jones.cascade(jones.half_wave_plate(first), jones.half_wave_plate(second))
    np.testing.assert_allclose(-pair, jones.rotator(2 * (second - first)), atol=1e-11)


def test_order_of_a_cascade_is_that_of_the_light():
    light = jones.electricfield(1, 0)
    path = jones.cascade(jones.polarizer(45), jones.polarizer(90))
    assert power(jones.apply_matrix(path, light))[0] == pytest.approx(0.25)
    assert power(jones.apply_matrix(jones.cascade(jones.polarizer(90), jones.polarizer(45)), light))[0] < 1e-30


@given(ANGLE)
def test_elements_turn_with_their_axes(angle):
    there, back = turn(angle), turn(-angle)
    np.testing.assert_allclose(jones.retarder(70, angle), there @ jones.retarder(70) @ back, atol=1e-12)
    np.testing.assert_allclose(jones.diattenuator(0.9, 0.3j, angle), there @ np.diag([0.9, 0.3j]) @ back, atol=1e-12)


@pytest.mark.parametrize("name", sorted(TERMS))
def test_passive_elements_give_no_energy(name, random):
    light = random.normal(size=(2, 50)) + 1j * random.normal(size=(2, 50))
    assert np.all(power(jones.apply_matrix(TERMS[name](), light)) <= power(light) * (1 + 1e-12))


def test_circular_polarisers_pass_their_hand_alone():
    for name, own, other in (("right", RIGHT, LEFT), ("Left", LEFT, RIGHT)):
        matrix = jones.circular_polarizer(name)
        np.testing.assert_allclose(matrix @ own, own, atol=1e-15)
        np.testing.assert_allclose(matrix @ other, 0, atol=1e-15)


def test_mirror_swaps_hands_and_an_isolator_lets_nothing_back():
    np.testing.assert_allclose(jones.mirror() @ RIGHT, LEFT, atol=1e-15)
    there = (jones.polarizer(0), jones.quarter_wave_plate(45))
    back = tuple(jones.reverse(matrix) for matrix in reversed(there))
    out = jones.cascade(*there, jones.mirror(), *back)
    np.testing.assert_allclose(out, 0, atol=1e-15)


@given(ANGLE, ANGLE)
def test_reversed_elements_have_their_axis_on_the_other_side(retardance, angle):
    np.testing.assert_allclose(
        jones.reverse(jones.retarder(retardance, angle)), jones.retarder(retardance, -angle), atol=1e-12
    )
    # Optical activity: the sense is the observer's, whichever way the light goes, so that forth and back cancel.
    forth = jones.rotator(angle)
    around = jones.cascade(forth, jones.mirror(), jones.reverse(forth))
    np.testing.assert_allclose(around, jones.mirror(), atol=1e-11)


def test_batches_and_precision(as_array):
    angles = as_array(np.linspace(-90, 90, 6, dtype=np.float32).reshape(3, 2))
    matrices = jones.retarder(angles, 10.0)
    assert tuple(matrices.shape) == (3, 2, 2, 2) and "complex64" in str(matrices.dtype)
    field = as_array(np.ones((2, 2, 5), dtype=np.complex64))
    out = jones.apply_matrix(matrices, field)
    assert tuple(out.shape) == (3, 2, 2, 5) and "complex64" in str(out.dtype)
    single = jones.retarder(float(angles[1, 0]), 10.0) @ np.ones(2)
    np.testing.assert_allclose(np.asarray(out)[1, 0, :, 3], single, atol=1e-6)
    assert "complex128" in str(jones.polarizer(as_array(np.asarray([1.0, 2.0]))).dtype)
    assert tuple(jones.electricfield(angles, 1.0).shape) == (3, 2, 2)
