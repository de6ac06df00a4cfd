"""Registrations of cameras find the mapping of simulated and independent tables."""

import numpy as np
import pytest
from laboratory import Laboratory, without_defocus
from tables import SMALLER, distance_in_pixels, instruments_of

from odak import instruments
from odak.instruments import registration


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 7])
def test_registration_of_an_unaberrated_table(seed):
    table = instruments.SimulatedTable(seed, aberration=0.0, distance_error=0.0)
    found = instruments.register_camera(*instruments_of(table), 532e-9, 20e-3, table.truth.phases)
    assert distance_in_pixels(found, table).max() < 0.1 and found.residual < 0.1
    pixels = np.random.default_rng(1).uniform(20, 300, (40, 2))
    assert np.abs(found.camera_pixels(found.plane_points(pixels)) - pixels).max() < 1e-6


@pytest.mark.parametrize("seed", [0, 3, 5])
@pytest.mark.slow
def test_first_registration_with_an_aberration_of_a_wavelength(seed):
    """Up to the shift by the tilt of the aberration in the middle, and the scale of the unknown distance."""
    table = instruments.SimulatedTable(seed, **SMALLER, aberration=1.0, regional=0.05, fill_factor=0.9)
    found = instruments.register_camera(
        *instruments_of(table), 532e-9, SMALLER["distance"], table.truth.phases, middle=True
    )
    points = np.random.default_rng(0).uniform(-0.35, 0.35, (100, 2)) * 108 * 8e-6
    seen = table.truth.plane_points(found.camera_pixels(points), table.camera.shape)
    (*linear, _), *_ = np.linalg.lstsq(np.column_stack([points, np.ones(100)]), seen, rcond=None)
    assert np.abs(linear - np.eye(2) * table.truth.distance / SMALLER["distance"]).max() < 2e-3
    assert found.residual < 0.2


def test_first_registration_of_a_table_with_orders_in_view():
    """Mirrored, with gaps between pixels and an aberration of a wavelength; the distance is wrong by 1.3 %."""
    y, x = ((np.arange(n) - n // 2) / 54 for n in (108, 108))
    y = y[:, None]
    surface = without_defocus(0.3 * x * y - 0.6 * (x**2 - y**2) + x**3 - 2 * x * y**2 - 0.4 * y * (x**2 + y**2))
    options = {"camera_shape": (240, 240), "camera_pitch": 4e-6, "fill": 0.9, "offset": (3e-5, -2e-5), "signs": (-1, 1)}
    surface *= 2 * np.pi / surface.std()
    table = Laboratory((108, 108), distance=15.2e-3, wavefront=surface, **options)
    found = instruments.register_camera(*instruments_of(table), 532e-9, 15e-3, table.phases, middle=True)
    points = np.random.default_rng(0).uniform(-0.35, 0.35, (100, 2)) * 108 * 8e-6
    pixels = found.camera_pixels(points)
    seen = np.stack([table.points(pixels[:, 0], 1), table.points(pixels[:, 1], 0)], axis=-1)
    (*linear, _), *_ = np.linalg.lstsq(np.column_stack([points, np.ones(100)]), seen, rcond=None)
    assert np.abs(linear - np.eye(2) * 15.2 / 15).max() < 2e-3
    assert found.residual < 0.2


@pytest.mark.slow
def test_a_camera_that_sees_few_spots_is_reported():
    table = instruments.SimulatedTable(2, aberration=0.0, camera_shape=(90, 90), misalignment=False)
    # As if the three single spots had been far apart.
    with (
        pytest.raises(RuntimeError, match=r"\d+ of 36 spots lie inside the image"),
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr(registration, "centroid", lambda frame, place, reach: np.asarray(place, float) * 2.8)
        instruments.register_camera(*instruments_of(table), 532e-9, 20e-3, table.truth.phases)


@pytest.mark.slow
def test_first_registration_of_oblong_panel_all_of_which_is_lit():
    """The second moments of its pixels differ along rows and columns: the curvature was 4 times too large."""
    y, x = ((np.arange(n) - n // 2) / 240 for n in (270, 480))
    y = y[:, None]
    wavefront = without_defocus(np.pi * (x**3 - 0.5 * x * y**2 + 0.8 * x * y + 0.5 * (x**2 - y**2)))
    table = Laboratory(
        (270, 480), 3.74e-6, 0.0375, camera_shape=(200, 300), camera_pitch=6.5e-6, wavefront=wavefront, signs=(-1, 1)
    )
    there = (*instruments_of(table), 532e-9, 1.015 * 0.0375, table.phases)
    assert instruments.register_camera(*there, middle=True, captures=2).residual < 0.1


def test_spots_that_do_not_move_with_the_pattern_are_reported():
    still = Laboratory((96, 128), distance=0.01, camera_shape=(200, 240), phases=np.zeros(256))
    with pytest.raises(RuntimeError, match=r"no spot was found on the axis .* does not move as the pattern does"):
        instruments.register_camera(*instruments_of(still), 532e-9, 0.01, 2 * np.pi * np.arange(256) / 256)
