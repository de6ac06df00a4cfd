"""Wavefronts are those of simulated tables, and what lenslets cannot see is reported."""

import dataclasses

import numpy as np
import pytest
from laboratory import Laboratory
from tables import Counting, fresh_seed, instruments_of, low_modes, rms

from odak import AccuracyWarning, instruments
from odak.instruments import spots


@pytest.mark.slow
def test_large_wavefront_seen_by_a_turned_and_mirrored_camera():
    """Root mean square of half a wavelength, a panel that is not square; the response is known."""
    table = instruments.SimulatedTable(
        fresh_seed(11), shape=(84, 110), distance=15e-3, camera_shape=(290, 250), aberration=0.5
    )
    turn = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    table.truth = dataclasses.replace(table.truth, homography=table.truth.homography @ turn)
    modulator, camera = instruments_of(table)
    there = (modulator, Counting(camera), 532e-9, 15e-3, table.truth.phases)
    found, low = 0.0, low_modes(table.modulator)
    taken = 0
    for start, iterations, bound in ((False, 5, 3.0), (True, 3, 1.0)):
        known = instruments.register_camera(*there, wavefront=found, middle=not start)
        before = there[1].taken
        found = instruments.measure_wavefront(
            *there, known, iterations=iterations, captures=1 + start, start=found if start else None
        )
        taken += there[1].taken - before
        error = spots.without(found - table.truth.wavefront, low)
        assert rms(error) < bound * 2 * np.pi / 100
    # Two of them show the reference pattern.
    assert taken <= 32


def test_an_aberration_beyond_the_lenslets_is_reported():
    table = instruments.SimulatedTable(
        fresh_seed(12), shape=(64, 64), distance=5e-3, camera_shape=(140, 140), aberration=4.0, misalignment=False
    )
    known = instruments.Registration(table.truth.homography, 0.0, table.camera.shape)
    with pytest.warns(AccuracyWarning, match="the wavefront is uncertain"):
        instruments.measure_wavefront(
            *instruments_of(table), 532e-9, 5e-3, table.truth.phases, known, iterations=5, captures=1
        )


def test_the_illumination_of_pixels_that_do_not_reach_the_axis():
    """Pixels reach 0.17 mm, and the modulator is 0.51 mm wide."""
    options = {"shape": (64, 64), "distance": 5e-3, "camera_shape": (150, 150), "misalignment": False}
    table = instruments.SimulatedTable(2, **options, distance_error=0.0, reflection=0.0)
    truth = table.truth
    known = instruments.Registration(truth.homography, 0.0, table.camera.shape)
    there = (*instruments_of(table), 532e-9, 5e-3, truth.phases, known)
    found = instruments.measure_illumination(*there, wavefront=truth.wavefront)
    assert rms(found - truth.amplitude / truth.amplitude.max()) < 0.03


@pytest.mark.slow
def test_registration_and_wavefront_through_a_lens():
    """On an independent table at the focal planes of a lens, with gaps whose light is the zero order."""
    focal, panel = 20e-3, (96, 96)
    y, x = ((np.arange(n) - n // 2) / 48 for n in panel)
    y = y[:, None]
    surface = 0.8 * (x**2 + y**2) + x * y - 0.6 * (x**2 - y**2) + x**3 - 0.4 * y * (x**2 + y**2) + 0.3 * (x - y)
    options = {"camera_shape": (220, 240), "camera_pitch": 4e-6, "fill": 0.9, "offset": (3e-5, -2e-5), "signs": (-1, 1)}
    table = Laboratory(panel, wavefront=surface, focal_length=focal, **options)
    there = (*instruments_of(table), 532e-9, instruments.Lens(focal), table.phases)
    registration = instruments.register_camera(*there, middle=True)
    wavefront = instruments.measure_wavefront(*there, registration, iterations=4, captures=1)
    registration = instruments.register_camera(*there, wavefront=wavefront)
    wavefront = instruments.measure_wavefront(*there, registration, iterations=2, start=wavefront)
    # Tilts belong to the registration; the defocus, of a camera beside the focus, does not.
    tilts = spots.aberration_modes(table.modulator, 1)
    assert rms(spots.without(wavefront - surface, tilts)) < 2 * np.pi / 200
    left = spots.without(surface - wavefront, spots.aberration_modes(table.modulator, 4)[2:])
    by_tilt = [np.gradient(left, table.modulator.pitch)[axis].mean() * 532e-9 * focal / (2 * np.pi) for axis in (1, 0)]
    points = np.random.default_rng(0).uniform(-3e-4, 3e-4, (100, 2))
    pixels = registration.camera_pixels(points)
    seen = np.stack([table.points(pixels[:, 0], 1), table.points(pixels[:, 1], 0)], axis=-1)
    assert np.abs(seen - points - by_tilt).max() < 0.1 * table.camera.pitch
