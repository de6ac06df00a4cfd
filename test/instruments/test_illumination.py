"""Illumination and dust of simulated tables."""

import warnings

import numpy as np
import pytest
from laboratory import Laboratory, random_table
from tables import fresh_seed, instruments_of, rms

from odak import AccuracyWarning, instruments
from odak.instruments import illumination
from odak.instruments.illumination import illumination_with_uncertainty


def test_waves_of_cells_are_sums_over_their_pixels():
    """Of 7 x 9 pixels at frequencies where a cell that is not made of pixels differs by 2 %."""
    draw, pitch = np.random.default_rng(0), 8e-6
    y, x = np.meshgrid((np.arange(7) - 3) * pitch, (np.arange(9) - 4) * pitch, indexing="ij")
    away, middle = draw.uniform(-1e4, 1e4, (20, 4, 2)), np.array([[3e-4, -2e-4]])
    waves = illumination._tilts(away, middle, pitch * np.array([[9, 7]]), pitch)[..., 0]
    points = np.stack([x, y], axis=-1) + middle
    assert np.abs(waves - np.exp(-2j * np.pi * np.tensordot(away, points, axes=(-1, -1))).mean((-2, -1))).max() < 1e-12


def test_a_narrow_beam_varies_within_cells():
    """Cells with an even amplitude would make the error 1 %, the light of pixels beyond reach 0.3 %."""
    y, x = np.ogrid[-1:1:48j, -1:1:48j]
    beam = np.exp(-((x - 0.1) ** 2 + (y + 0.05) ** 2) / 0.3)
    table = Laboratory((48, 48), distance=6.8e-3, camera_shape=(142, 148), camera_pitch=4e-6, amplitude=beam)
    known = instruments.Registration(np.diag([4e-6, 4e-6, 1.0]), 0.0, table.camera.shape)
    there = instruments.OpticalTable(*instruments_of(table), 532e-9, 6.8e-3, table.phases, known)
    found, uncertainty = illumination_with_uncertainty(there, patterns=16)
    assert rms(found - beam / beam.max()) < 0.002 and 4e-4 < uncertainty < 1.2e-3


@pytest.mark.slow
def test_a_beam_behind_a_lens_is_found_to_a_thousandth():
    """With the light of a pixel as it is at the point, for all that the camera sees around it, the error is 0.17 %."""
    y, x = np.ogrid[-1:1:96j, -1:1:96j]
    beam = np.exp(-((x - 0.1) ** 2 + (y + 0.05) ** 2) / 1.5)
    options = {"focal_length": 20e-3, "camera_shape": (220, 240), "camera_pitch": 4e-6, "fill": 0.9}
    table = Laboratory((96, 96), amplitude=beam, **options)
    known = instruments.Registration(np.diag([4e-6, 4e-6, 1.0]), 0.0, table.camera.shape)
    there = instruments.OpticalTable(
        *instruments_of(table), 532e-9, instruments.Lens(20e-3), table.phases, known, np.zeros((96, 96))
    )
    found, uncertainty = illumination_with_uncertainty(there, patterns=16)
    assert rms(found - beam / beam.max()) < 1.3e-3 and 6e-4 < uncertainty < 1.8e-3


def illumination_found(seed, **faults):
    table = instruments.SimulatedTable(seed, **faults)
    truth = table.truth
    known = instruments.Registration(truth.homography, truth.distortion, table.camera.shape)
    there = (*instruments_of(table), table.wavelength, truth.distance, truth.phases, known)
    found = instruments.measure_illumination(*there, wavefront=truth.wavefront)
    return rms(found - truth.amplitude / truth.amplitude.max())


@pytest.mark.slow
@pytest.mark.parametrize(
    "faults", [{"fill_factor": 0.9, "samples_per_pixel": 2}, {"fringing": 0.3, "samples_per_pixel": 2}, {}]
)
def test_illumination_is_independent_of_gaps_fringes_wavelength(faults):
    """At 450 nm pixels at the edges do not reach the axis, and the uncertainty stated is up to 3 %."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the illumination is uncertain by 0.0[123]", AccuracyWarning)
        error = illumination_found(fresh_seed(13), **(faults or {"wavelength": 450e-9}))
    assert error < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("seed", [14, 15])
def test_dust_is_reported(seed):
    """The map is smooth; the pixels that the dust covers deviate."""
    with pytest.warns(AccuracyWarning, match="darker than the polynomial by up to"):
        error = illumination_found(fresh_seed(seed), dust=3)
    assert 0.02 < error < 0.05


@pytest.mark.filterwarnings("ignore:the illumination is uncertain:odak.AccuracyWarning")
@pytest.mark.parametrize("exposures", [2, pytest.param(1, marks=pytest.mark.slow)])
def test_illumination_by_cameras_of_8_bits(exposures, monkeypatch):
    """Two exposures of each pattern take the place of bits."""
    # A wider view averages over the steps of a single exposure; a narrow one needs more patterns.
    monkeypatch.setattr("odak.instruments.illumination.WIDEST", 2)
    if exposures == 1:
        monkeypatch.setattr("odak.instruments.illumination.FEW_BITS", 0)
    table, _ = random_table(9)
    table.camera.bits = 8
    mapping = np.diag([*(table.camera.pitch * np.array(table.signs)), 1.0])
    mapping[:2, 2] = table.offset
    known = instruments.Registration(mapping, 0.0, table.camera.shape)
    there = (*instruments_of(table), table.wavelength, table.distance, table.phases, known)
    found = instruments.measure_illumination(*there, wavefront=table.wavefront, patterns=150)
    true = np.abs(table.illumination)
    error = rms(found - true / true.max())
    assert error < 0.005 if exposures == 2 else error > 0.006


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.filterwarnings("ignore:the illumination is uncertain:odak.AccuracyWarning")
def test_two_of_three_errors_lie_within_one_sigma():
    """Of 40 errors 20 to 34 do so in 98 of 100 cases where it is 68 % of all; their root mean square is 0.3 %."""
    within, errors = 0, []
    for seed in range(500, 540):
        table, _ = random_table(seed)
        mapping = np.diag([*(table.camera.pitch * np.array(table.signs)), 1.0])
        mapping[:2, 2] = table.offset
        known = instruments.Registration(mapping, 0.0, table.camera.shape)
        there = (*instruments_of(table), table.wavelength, table.distance, table.phases, known, table.wavefront)
        found, sigma = illumination_with_uncertainty(instruments.OpticalTable(*there), patterns=16)
        true = np.abs(table.illumination)
        errors.append(rms(found - true / true.max()))
        within += errors[-1] < sigma
    assert 20 <= within <= 34 and rms(errors) < 0.004
