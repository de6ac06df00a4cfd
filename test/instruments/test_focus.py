"""Distance and astigmatism from the sharpest focus."""

import numpy as np
import pytest
from laboratory import Laboratory
from tables import fresh_seed, instruments_of, low_modes, rms

from odak import AccuracyWarning, instruments
from odak.instruments import focus, spots


@pytest.mark.slow
def test_sharpest_focus_has_the_astigmatism_of_the_table():
    """Its error is below λ/400, with a wrong registration and where the estimate is wrong by λ/10."""
    table = instruments.SimulatedTable(fresh_seed(22), shape=(96, 96), distance=12e-3, camera_shape=(140, 140))
    truth, modes = table.truth, spots.aberration_modes(table.modulator, 2)
    low = low_modes(table.modulator)
    astigmatism = spots.without(modes[2] - 0.5 * modes[4], low)
    wrong = truth.wavefront + astigmatism * (0.2 * np.pi / astigmatism.std())
    sheared = truth.homography @ np.array([[1.0, 0.02, 0.0], [0.02, 1.0, 0.0], [0.0, 0.0, 1.0]])
    known = instruments.Registration(sheared, truth.distortion, table.camera.shape)
    there = (*instruments_of(table), 532e-9, truth.distance, truth.phases, known)
    # Parabolas through sharpness of a tenth of a wavelength beside the peak, and then nearer to it.
    for _ in range(3):
        wrong = focus.astigmatism_by_focus(instruments.OpticalTable(*there, wrong))
    assert rms(spots.without(wrong - truth.wavefront, low)) < 2 * np.pi / 400


@pytest.mark.slow
def test_focus_outside_of_the_range_warns():
    table = instruments.SimulatedTable(
        4, shape=(96, 96), camera_shape=(120, 120), distance=12e-3, aberration=0.0, distance_error=0.0
    )
    mapping = instruments.Registration(table.truth.homography, table.truth.distortion, table.camera.shape)
    there = (*instruments_of(table), 532e-9, 13.2e-3, table.truth.phases, mapping)
    with pytest.warns(AccuracyWarning, match="end of the range"):
        found = instruments.measure_distance(*there, span=0.05, captures=1)
    assert found == pytest.approx(table.truth.distance, rel=3e-3)


@pytest.mark.slow
def test_distance_of_a_simulated_table():
    """Its pixels are squares, whose envelope shifts the sharpest focus by some hundredths of the depth of focus."""
    table = instruments.SimulatedTable(
        4, shape=(96, 96), camera_shape=(120, 120), distance=12e-3, aberration=0.0, reflection=0.0
    )
    mapping = instruments.Registration(table.truth.homography, table.truth.distortion, table.camera.shape)
    there = (*instruments_of(table), 532e-9, 12e-3, table.truth.phases, mapping)
    found = instruments.measure_distance(*there, samples=9, captures=32)
    assert found == pytest.approx(table.truth.distance, rel=1e-4)


def aligned(laboratory):
    pitch = laboratory.camera.pitch
    return instruments.Registration(np.diag([pitch, pitch, 1.0]), 0.0, laboratory.camera.shape)


def distance_found(wrong, shape, bits=8, distance=0.1, **options):
    table = Laboratory(shape, distance=distance, bits=bits)
    there = (*instruments_of(table), table.wavelength, distance * (1 + wrong), table.phases, aligned(table))
    return instruments.measure_distance(instruments.OpticalTable(*there), **options) / distance


def test_distance_of_a_panel_whose_depth_of_focus_is_narrow():
    """The focus of all pixels is 0.4 % deep; a sweep in steps of 4 % finds that of a small part of them first."""
    assert distance_found(-0.12, (240, 320), distance=0.025, samples=9, captures=1) == pytest.approx(1, abs=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "bits", "distance"), [(0.02, 8, 0.1), (-0.12, 10, 0.2)])
def test_distance_of_a_full_panel(wrong, bits, distance):
    """1080 x 1920 pixels, depth of focus 0.1 %."""
    assert distance_found(wrong, (1080, 1920), bits, distance, captures=1) == pytest.approx(1, abs=1e-4)


def test_distance_and_astigmatism_of_the_sharpest_focus_together():
    """Half a step from the summit along three axes; the captures are those of one design, twice at most."""
    y, x = ((np.arange(64) - 32) / 32 for _ in range(2))
    surface = 0.4 * x * y[:, None] + 0.2 * (x**2 - y[:, None] ** 2)
    table = Laboratory((64, 64), distance=9e-3, camera_shape=(190, 196), camera_pitch=4e-6, wavefront=surface)
    there = (*instruments_of(table), 532e-9, 9.03e-3, table.phases, aligned(table), np.zeros((64, 64)))
    found, doubt = focus.focused(instruments.OpticalTable(*there))
    low = low_modes(table.modulator)
    assert rms(spots.without(found.wavefront - surface, low)) < 0.1 * rms(spots.without(surface, low))
    assert abs(found.distance - 9e-3) < min(3 * doubt, 1e-3 * 9e-3)
    assert table.camera.taken <= 34
    flat = np.zeros(256)
    with pytest.raises(RuntimeError, match="no sharpest focus was found: the area of the spot"):
        table.phases = flat
        focus.focused(instruments.OpticalTable(*there))


def test_distance_without_light_is_error_that_says_what_was_seen():
    table = Laboratory((48, 64), distance=0.01, camera_shape=(120, 120))
    table.power = 0.0
    there = (*instruments_of(table), table.wavelength, 0.01, table.phases, aligned(table))
    with pytest.raises(RuntimeError, match=r"sees no light: .* of 4095 counts"):
        instruments.measure_distance(*there)
    still = Laboratory((48, 64), distance=0.01, camera_shape=(120, 120), phases=np.zeros(256))
    with pytest.raises(
        RuntimeError, match=r"no focus was found among focal lengths from .* of 4095 counts, .* registra"
    ):
        instruments.measure_distance(*instruments_of(still), *there[2:])
    with pytest.raises(ValueError, match="span must be below 1, got 1"):
        instruments.measure_distance(*there, span=1.0)
