"""Spots equalised by feedback of a camera on simulated tables, compared with the true power of the spots."""

import numpy as np
import pytest

from odak import instruments
from odak.wave import spot_hologram

from .test_calibration import instruments_of


def hidden_light(table, points, radius):
    """Return the power in discs about the spots nearest to points of the plane, without camera and noise."""
    light, pitch = table.intensity()
    y, x = ((np.arange(n) - n // 2) * pitch for n in light.shape)
    found = []
    for place in points:
        for _ in range(4):
            disc = light * ((y[:, None] - place[1]) ** 2 + (x - place[0]) ** 2 <= radius**2)
            place = np.array([(disc.sum(0) * x).sum(), (disc.sum(1) * y).sum()]) / disc.sum()
        found.append(disc.sum())
    return np.array(found, dtype=float)


def evenness(light):
    return 1 - (light.max() - light.min()) / (light.max() + light.min())


def grid(count, extent):
    x = np.linspace(-extent, extent, count)
    return np.stack(np.meshgrid(x, x), -1).reshape(-1, 2)


@pytest.mark.slow
def test_feedback_through_a_hidden_aberration():
    """Twenty-five spots behind 0.25 λ of aberration and an uneven beam, with a camera that was registered before."""
    phases, points = 2 * np.pi * np.arange(256) / 255, grid(5, 0.34e-3)
    flat = instruments.SimulatedTable(11, aberration=0.0, nonlinearity=False)
    registration = instruments.register_camera(*instruments_of(flat), 532e-9, 20e-3, phases)
    table = instruments.SimulatedTable(11, aberration=0.25, nonlinearity=False)
    modulator, camera = instruments_of(table)
    found = instruments.equalise_spots(
        modulator, camera, 532e-9, 20e-3, points, phases, registration, turns=6, captures=24
    )
    radius = 4 * 1.22 * 532e-9 * 20e-3 / (144 * 8e-6)
    after = evenness(hidden_light(table, points, radius))
    places = np.column_stack([points, np.full(25, 20e-3)])
    blind = spot_hologram(places, (144, 144), 532e-9, 8e-6, 30, seed=0)[0]
    modulator.show(instruments.phase_response.nearest_levels(np.angle(blind), phases))
    before = evenness(hidden_light(table, points, radius))
    assert before < 0.9
    assert after > 0.99
    assert found.uniformity > 0.985 and found.history[0] < 0.9
    assert found.levels.shape == (144, 144) and found.intensities.mean() == pytest.approx(1)


@pytest.mark.slow
def test_given_intensities_and_bad_arguments():
    table = instruments.SimulatedTable(
        2, shape=(80, 80), camera_shape=(160, 160), distance=10e-3, misalignment=False, nonlinearity=False
    )
    modulator, camera = instruments_of(table)
    phases, points = 2 * np.pi * np.arange(256) / 255, grid(2, 0.12e-3)
    registration = instruments.Registration(np.diag([4e-6, 4e-6, 1.0]), 0.0, (160, 160))
    wanted = np.array([1.0, 2.0, 3.0, 4.0])
    call = (modulator, camera, 532e-9, 10e-3, points, phases, registration)
    instruments.equalise_spots(*call, intensities=wanted, turns=5, captures=8)
    light = hidden_light(table, points, 4 * 1.22 * 532e-9 * 10e-3 / (80 * 8e-6)) / wanted
    assert evenness(light) > 0.98
    for change, message in (
        ({"intensities": wanted[:2]}, "intensities must be"),
        ({"turns": 0}, "turns must be at least 1"),
        ({"radius": -1.0}, "radius must be positive"),
        ({"radius": 1e-3}, "points must be such that their discs lie inside"),
    ):
        with pytest.raises(ValueError, match=message):
            instruments.equalise_spots(*call, **change)
    with pytest.raises(ValueError, match="points must be"):
        instruments.equalise_spots(modulator, camera, 532e-9, 10e-3, points[:1], phases, registration)


@pytest.mark.parametrize("points", [[[-6e-5, 0.0], [6e-5, 0.0]], [[-2e-5, -6e-5], [0.0, 6e-5]]])
def test_two_spots_are_made_even(points):
    table = instruments.SimulatedTable(
        2, shape=(48, 48), camera_shape=(80, 80), distance=5e-3, misalignment=False, nonlinearity=False
    )
    phases = 2 * np.pi * np.arange(256) / 255
    registration = instruments.Registration(np.diag([4e-6, 4e-6, 1.0]), 0.0, (80, 80))
    call = (*instruments_of(table), 532e-9, 5e-3, np.array(points), phases, registration)
    instruments.equalise_spots(*call, turns=3, captures=8)
    assert evenness(hidden_light(table, points, 4 * 1.22 * 532e-9 * 5e-3 / (48 * 8e-6))) > 0.97
