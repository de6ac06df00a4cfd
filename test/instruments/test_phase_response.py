"""Phase of the levels of simulated modulators, for the whole of them and by regions."""

import contextlib
import dataclasses
import warnings

import numpy as np
import pytest
from laboratory import WELL, Altered, Laboratory, random_table
from tables import fresh_seed, instruments_of

from odak import AccuracyWarning, instruments
from odak.instruments import phase_response


@pytest.mark.parametrize("span", [0.5, pytest.param(1.6, marks=pytest.mark.slow)])
def test_phase_response_of_small_and_large_ranges(span):
    table = instruments.SimulatedTable(4, shape=(64, 64), camera_shape=(100, 100), distance=6e-3)
    table.truth = dataclasses.replace(table.truth, phases=table.truth.phases * span)
    with pytest.warns(AccuracyWarning, match="leave out") if span < 1 else contextlib.nullcontext():
        found = instruments.measure_phase_response(*instruments_of(table), 532e-9, 6e-3, samples=9)
    assert np.abs(found - table.truth.phases).max() < 0.02


@pytest.mark.parametrize("seed", [3, 9])
def test_a_response_is_found_within_two_milliradians_from_forty_captures(seed):
    table, distance = random_table(seed)
    found = instruments.measure_phase_response(*instruments_of(table), table.wavelength, distance, samples=15)
    assert np.abs(found - table.phases).max() < 2e-3
    assert table.camera.taken <= 40


def test_noise_of_phases_is_that_of_repeated_captures():
    """Of photons, of which bright pixels have more: by the mean noise of the pixels the quotient is 2.3."""
    draw = np.random.default_rng(0)
    phase = 2 * np.pi * (np.arange(14) / 13) ** 1.2
    one, other = draw.exponential(size=(2, 900)) ** 0.5
    waves = other * np.exp(2j * np.pi * draw.random(900))
    light = 40 * np.abs(one * np.exp(1j * phase)[:, None] + waves) ** 2
    taken = [phase_response._phases_of_interference(draw.poisson(light).astype(float)) for _ in range(60)]
    found, deviations, noise = (np.array(part) for part in zip(*taken, strict=True))
    # Differences from level 0 have the noise of two, and the ellipse through 14 points has some: 1.65 in all.
    assert 1.4 < found[:, 1:].std(0).mean() / noise.mean() < 1.9
    # Noise deviates from no sum of three images; the third component less the fourth is 0.015 here.
    assert deviations.mean() < 0.01


def test_light_that_varies_changes_phases_by_half_as_much():
    """By 2 % from frame to frame: the error is 0.028 rad (root mean square of the largest) without correction."""
    draw, errors = np.random.default_rng(0), []
    phase = 2 * np.pi * (np.arange(26) / 25) ** 1.2
    for _ in range(20):
        one, other = draw.exponential(size=(2, 900)) ** 0.5
        light = np.abs(one * np.exp(1j * phase)[:, None] + other * np.exp(2j * np.pi * draw.random(900))) ** 2
        varying = (light - light.mean(1, keepdims=True)) * (1 + 0.02 * draw.normal(size=(26, 1)))
        found, deviation, _ = phase_response._phases_of_interference(varying)
        errors.append(np.abs(found - phase).max())
        # What the light does to the captures remains a sign of what deviates.
        assert 0.005 < deviation < 0.1
    assert np.sqrt(np.mean(np.square(errors))) < 0.02


def test_phases_that_scatter_are_rough_by_their_standard_deviation():
    levels = np.union1d(phase_response._measured_levels(255, 25), [1])
    smooth = 2 * np.pi * (levels / 255) ** 1.2
    scatter = np.random.default_rng(0).normal(scale=0.03, size=(100, len(levels)))
    assert phase_response._roughness(levels, smooth, 255) < 1e-3
    rough = [phase_response._roughness(levels, smooth + part, 255) for part in scatter]
    assert 0.027 < np.sqrt(np.mean(np.square(rough))) < 0.033


@pytest.mark.parametrize("power", [0.85, 1.2])
def test_powers_of_the_level_are_interpolated_within_half_a_milliradian(power):
    """A spline of the level itself misses the first one by 1.1 mrad, and one without level 1 by 3.5 mrad."""
    phases = 2 * np.pi * (np.arange(256) / 255) ** power
    levels = np.union1d(phase_response._measured_levels(255, 15), [1])
    assert np.abs(phase_response._of_all_levels(levels, phases[levels], 255) - phases).max() < 5e-4


def test_more_captures_are_averaged_where_there_is_little_light():
    """Noise of 3 electrons alone, and twice the light at most."""
    few = {}
    for well in (300.0, 20_000.0):
        table, distance = random_table(3)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("laboratory.WELL", well)
            instruments.measure_phase_response(*instruments_of(table), table.wavelength, distance, samples=15)
        few[well] = table.camera.taken
    assert few[20_000.0] < 65 and 150 < few[300.0] < 175


@pytest.mark.parametrize("wrong", [-0.1, 0.1])
def test_a_response_that_falls_with_the_level(wrong):
    table = Laboratory((96, 128), distance=0.01, camera_shape=(200, 240), phases=-2 * np.pi * np.arange(256) / 256)
    there = (*instruments_of(table), 532e-9, 0.01 * (1 + wrong))
    found = instruments.measure_phase_response(*there, samples=9, captures=1)
    assert np.abs(found - table.phases).max() < 0.01


@pytest.mark.parametrize(("fringing", "bound"), [pytest.param(0.2, 0.03, marks=pytest.mark.slow), (0.4, 0.1)])
def test_fringing_fields_spoil_the_phase_response_with_notice(fringing, bound):
    """The bounds are 0.5 % and 5 % of the largest phase; more than a tenth of a radian comes with a warning."""
    table = instruments.SimulatedTable(
        5, shape=(96, 96), camera_shape=(80, 80), distance=8e-3, fringing=fringing, samples_per_pixel=2
    )
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = instruments.measure_phase_response(*instruments_of(table), 532e-9, 8e-3, samples=9, captures=1)
    error = np.abs(found - table.truth.phases).max()
    assert error < bound
    assert error < 0.1 or any(issubclass(w.category, AccuracyWarning) for w in told)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [17, 18, 19])
def test_varying_response_is_reported_where_not_measured(seed):
    """The filter of the tests makes the warning an error, which ends the calibration."""
    table = instruments.SimulatedTable(
        fresh_seed(seed), shape=(96, 96), camera_shape=(80, 80), distance=8e-3, regional=0.05
    )
    with pytest.raises(AccuracyWarning, match=r"use regions=\(3, 3\)"):
        instruments.calibrate_table(*instruments_of(table), 532e-9, 8e-3, regions=(1, 1))


def test_a_modulator_that_does_not_modulate_is_reported():
    table = instruments.SimulatedTable(4, shape=(32, 32), camera_shape=(40, 40), distance=3e-3)
    table.truth = dataclasses.replace(table.truth, phases=np.zeros(256))
    with pytest.raises(RuntimeError, match="must observe how the interference"):
        instruments.measure_phase_response(*instruments_of(table), 532e-9, 3e-3, samples=9, captures=2)


def test_nearest_levels_are_nearest():
    phases = np.random.default_rng(0).uniform(-4, 9, 16)
    wanted = np.random.default_rng(1).uniform(-20, 20, (30, 20))
    found = phase_response.nearest_levels(wanted, phases)
    apart = np.abs(np.angle(np.exp(1j * (phases[None, None] - wanted[..., None]))))
    assert np.allclose(np.take_along_axis(apart, found[..., None], -1)[..., 0], apart.min(-1))


@pytest.mark.parametrize("ambient", [5.0, pytest.param(20.0, marks=pytest.mark.slow)])
def test_ambient_light_is_named_and_the_response_found(ambient):
    """So many times the unfocused light of the modulator, which saturated all pixels at long exposures."""
    table, _ = random_table(1)
    camera, top = table.camera, (1 << table.camera.bits) - 1

    def lit(frames, camera):
        return np.clip(frames + ambient * camera.exposure * 1e4 / WELL * top, 0, top).astype(np.uint16)

    lit_camera = Altered(camera, lit, shape=camera.shape, pitch=camera.pitch, bits=camera.bits)
    with pytest.warns(AccuracyWarning, match=r"ambient light is [5-9]\d% of the brightest pixel"):
        found = instruments.measure_phase_response(
            table.modulator, lit_camera, table.wavelength, table.distance, samples=13
        )
    assert np.abs(found - table.phases).max() < 0.01
