"""Stokes, Mueller and the ellipse against definitions, closed forms and the field's own path in time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odak import jones

NUMBER = st.floats(-3, 3)
FIELD = st.tuples(NUMBER, NUMBER, NUMBER, NUMBER).map(lambda v: np.asarray([[v[0] + 1j * v[1]], [v[2] + 1j * v[3]]]))
LIT = FIELD.filter(lambda u: (np.abs(u) ** 2).sum() > 1e-3)


def analysed(field):
    """Stokes vector by its definition: what six analysers let through."""
    through = {a: (np.abs(jones.linearpolarizer(field, a)) ** 2).sum(-2) for a in (0, 45, 90, -45)}
    hands = [(np.abs(jones.circular_polarizer(h) @ field) ** 2).sum(-2) for h in ("right", "left")]
    rows = (through[0] + through[90], through[0] - through[90], through[45] - through[-45], hands[0] - hands[1])
    return np.stack(rows, axis=-2)


def goldstein_retarder(delta, angle):
    """Mueller matrix of a retarder, Goldstein 2011, section 5.5, with S3's sign as in odak.jones."""
    c, s = np.cos(2 * np.radians(angle)), np.sin(2 * np.radians(angle))
    cd, sd = np.cos(np.radians(delta)), np.sin(np.radians(delta))
    return np.asarray(
        [
            [1, 0, 0, 0],
            [0, c**2 + s**2 * cd, c * s * (1 - cd), -s * sd],
            [0, c * s * (1 - cd), s**2 + c**2 * cd, c * sd],
            [0, s * sd, -c * sd, cd],
        ]
    )


@given(FIELD)
def test_stokes_vector_is_what_analysers_measure(field):
    np.testing.assert_allclose(jones.stokes(field), analysed(field), atol=1e-12)


@given(LIT)
def test_pure_states_are_fully_polarised_and_come_back(field):
    vector = jones.stokes(field)
    assert jones.degree_of_polarization(vector)[0] == pytest.approx(1, abs=1e-9)
    again = jones.field_from_stokes(vector)
    np.testing.assert_allclose(jones.stokes(again), vector, atol=1e-9)
    assert again[0, 0].real >= 0 and again[0, 0].imag == 0


def test_small_components_survive_the_inverse_conversion():
    field = np.asarray([[1.0], [1e-9j]])
    np.testing.assert_allclose(jones.field_from_stokes(jones.stokes(field)), field, rtol=1e-12, atol=1e-24)
    np.testing.assert_array_equal(jones.field_from_stokes(np.asarray([1.0, 0, 0, 0])), 0)


@given(LIT, st.floats(-360, 360), st.floats(-180, 180))
def test_mueller_matrices_do_to_stokes_what_jones_do_to_fields(field, retardance, angle):
    elements = (
        jones.retarder(retardance, angle),
        jones.diattenuator(0.9, 0.4j, angle),
        jones.rotator(angle),
        jones.mirror(),
        jones.circular_polarizer("left"),
    )
    for matrix in elements:
        out = jones.stokes(jones.apply_matrix(matrix, field))
        np.testing.assert_allclose(jones.mueller(matrix) @ jones.stokes(field), out, atol=1e-10)
    np.testing.assert_allclose(jones.mueller(elements[0]), goldstein_retarder(retardance, angle), atol=1e-12)


def test_mueller_matrix_of_a_polariser_and_of_a_product():
    c, s = np.cos(np.radians(50)), np.sin(np.radians(50))
    expected = 0.5 * np.asarray([[1, c, s, 0], [c, c**2, c * s, 0], [s, c * s, s**2, 0], [0, 0, 0, 0]])
    np.testing.assert_allclose(jones.mueller(jones.polarizer(25)), expected, atol=1e-15)
    parts = (jones.polarizer(25), jones.retarder(60, 10), jones.rotator(5))
    product = jones.cascade(*(jones.mueller(part) for part in parts))
    np.testing.assert_allclose(jones.mueller(jones.cascade(*parts)), product, atol=1e-15)


@given(LIT)
def test_ellipse_is_the_path_of_the_field(field):
    ellipse = jones.polarization_ellipse(field)
    time = np.linspace(0, 2 * np.pi, 2001)
    x, y = np.real(field * np.exp(-1j * time))
    radius = np.hypot(x, y)
    assert ellipse.major[0] == pytest.approx(radius.max(), rel=1e-4)
    # The minor axis comes from a difference, so it is good to the square root of the precision.
    assert ellipse.minor[0] == pytest.approx(radius.min(), abs=5e-3 * radius.max())
    angle = np.radians(ellipse.azimuth[0])
    along = x * np.cos(angle) + y * np.sin(angle)
    if ellipse.major[0] > 1.01 * ellipse.minor[0]:
        assert along.max() == pytest.approx(radius.max(), rel=1e-3)
    turning = float(x[0] * y[1] - x[1] * y[0])
    if abs(turning) > 1e-9:
        assert ellipse.handedness[0] == -np.sign(turning)
        assert np.sign(ellipse.ellipticity[0]) == ellipse.handedness[0]


def test_ellipse_of_known_states():
    field = np.asarray([[1, 1, 0, np.sqrt(3) / 2], [1, -1j, 1, 0.5]])
    ellipse = jones.polarization_ellipse(field)
    np.testing.assert_allclose(ellipse.azimuth[[0, 2, 3]], [45, 90, 30], atol=1e-12)
    np.testing.assert_allclose(ellipse.ellipticity, [0, 45, 0, 0], atol=1e-12)
    np.testing.assert_allclose(ellipse.major, [np.sqrt(2), 1, 1, 1], atol=1e-12)
    np.testing.assert_array_equal(ellipse.handedness, [0, 1, 0, 0])


def test_mixed_light():
    natural = jones.stokes(np.asarray([1.0, 0])) + jones.stokes(np.asarray([0, 1.0]))
    assert jones.degree_of_polarization(natural) == 0
    assert jones.degree_of_polarization(np.zeros(4)) == 0
    half = jones.depolarizer(0.5) @ jones.stokes(np.asarray([1.0, 1j]))
    assert jones.degree_of_polarization(half) == pytest.approx(0.5)
    np.testing.assert_allclose(jones.stokes(jones.field_from_stokes(half)), [1, 0, 0, -1], atol=1e-12)
    # A polariser makes pure light of natural light, at half of its power.
    out = jones.mueller(jones.polarizer(70)) @ natural
    assert jones.degree_of_polarization(out) == pytest.approx(1) and out[0] == pytest.approx(1)


def test_errors_and_precision(as_array):
    with pytest.raises(ValueError, match=r"vector must be real, \[4\]"):
        jones.degree_of_polarization(np.ones((3, 1)))
    with pytest.raises(ValueError, match="kept must be from 0 to 1"):
        jones.depolarizer(1.5)
    with pytest.raises(ValueError, match=r"kept must be from 0 to 1, got -0\.5"):
        jones.depolarizer(as_array(np.asarray([0.5, -0.5])))
    with pytest.raises(ValueError, match="S0 of at least 0, got -1"):
        jones.field_from_stokes(as_array(np.asarray([[2.0, -1.0], [1.0, 1.0], [0.0, 0.0], [0.0, 0.0]])))
    field = as_array((np.ones((3, 2, 4)) * (1 + 0.5j)).astype(np.complex64))
    vector = jones.stokes(field)
    assert tuple(vector.shape) == (3, 4, 4) and "float32" in str(vector.dtype)
    assert "complex64" in str(jones.field_from_stokes(vector).dtype)
    assert "float32" in str(jones.mueller(jones.polarizer(as_array(np.ones(2, np.float32)))).dtype)
    assert "float32" in str(jones.stokes_ellipse(vector).azimuth.dtype)


@pytest.mark.parametrize("place", [1, 2, 3])
def test_what_is_not_a_number_is_not_taken_for_darkness(place):
    vector = np.asarray([1.0, 0.2, 0.3, 0.4])
    vector[place] = np.nan
    assert np.isnan(jones.degree_of_polarization(vector))
    assert np.isnan(jones.field_from_stokes(vector)).any()
    assert np.isnan(jones.degree_of_polarization([np.nan, 0.2, 0.3, 0.4]))
