import numpy as np
import pytest

import odak
from odak.wave import fields


def test_points_are_summed_over_their_paths(random, monkeypatch):
    sources, targets = random.normal(size=(7, 3)), random.normal(loc=[0, 0, 10], size=(5, 3))
    field = random.normal(size=7) + 1j * random.normal(size=7)
    k = 2 * np.pi / 0.37
    expected = np.zeros(5, complex)
    for q in range(5):
        for p in range(7):
            d = np.linalg.norm(targets[q] - sources[p])
            expected[q] += abs(field[p]) * np.exp(1j * (-k * d + np.angle(field[p]))) / d**2
    np.testing.assert_allclose(odak.wave.propagate_field(sources, targets, field, k, direction=-1), expected)
    monkeypatch.setattr(fields, "_CHUNK_BYTES", 16 * 7 * 2)
    np.testing.assert_allclose(odak.wave.propagate_field(sources, targets, field, k, direction=-1), expected)


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_points_of_every_library_agree(as_array, random, precision):
    sources, targets = random.normal(size=(4, 3)), random.normal(loc=[0, 0, 5], size=(3, 3))
    sources, targets, field = (values.astype(precision) for values in (sources, targets, random.normal(size=4)))
    expected = odak.wave.propagate_field(sources, targets, field, 30.0)
    result = odak.wave.propagate_field(*map(as_array, (sources, targets, field)), 30.0)
    np.testing.assert_allclose(np.asarray(result), expected, rtol=0, atol=20 * np.finfo(precision).eps)


def test_coinciding_points_and_shapes_are_refused(random):
    points = random.normal(size=(3, 3))
    with pytest.raises(ValueError, match="coincide"):
        odak.wave.propagate_field(points, points, np.ones(3, complex), 1.0)
    with pytest.raises(ValueError, match="points0 must be an array"):
        odak.wave.propagate_field(points[:, :2], points, np.ones(3, complex), 1.0)
    with pytest.raises(ValueError, match=r"field0 must be .* a value for each"):
        odak.wave.propagate_field(points, points + 1, np.ones(2, complex), 1.0)


def test_plane_waves():
    expected = 2 * np.exp(1j * (-3 * 0.5 + 7 * 1.5 + 0.2)) / 1.5**2
    assert odak.wave.electric_field_per_plane_wave(2, 1.5, 7, 0.2, 3, 0.5) == pytest.approx(expected)
    opd = np.array([1.5, 2.5])
    np.testing.assert_allclose(
        odak.wave.propagate_plane_waves(np.array([1j, 2]), opd, 7, 3, 0.5),
        np.array([1j, 2]) * np.exp(1j * (-1.5 + 7 * opd)) / opd**2,
    )
    with pytest.raises(ValueError, match="opd"):
        odak.wave.electric_field_per_plane_wave(1, 0.0, 7)
    with pytest.raises(ValueError, match="opd"):
        odak.wave.propagate_plane_waves(np.ones(2), np.array([1.0, 0.0]), 7)


def test_phases_of_many_turns_keep_digits_in_single_precision(random):
    k = 2 * np.pi / 532e-9
    opd = random.uniform(0.1, 0.9, (8, 8)).astype(np.float32)
    expected = np.exp(1j * k * opd.astype(np.float64)) / opd.astype(np.float64) ** 2
    for result in (odak.wave.electric_field_per_plane_wave(1.0, opd, k), odak.wave.propagate_plane_waves(1.0, opd, k)):
        assert np.abs(result - expected).max() < 1e-5 * np.abs(expected).max()
    assert odak.wave.electric_field_per_plane_wave(1.0, opd, k).dtype == np.complex64
    half = odak.wave.electric_field_per_plane_wave(1.0, opd.astype(np.float16), k)
    assert np.isfinite(half).all()


def test_points_of_single_precision_are_subtracted_in_double(random):
    sources, targets = random.normal(size=(4, 3)), random.normal(loc=[0, 0, 5], size=(3, 3))
    sources, targets = sources.astype(np.float32), targets.astype(np.float32)
    field = np.ones(4, np.complex64)
    expected = odak.wave.propagate_field(sources.astype(np.float64), targets.astype(np.float64), field, 1e5)
    result = odak.wave.propagate_field(sources, targets, field, 1e5)
    assert np.abs(result - expected).max() < 1e-5 * np.abs(expected).max()
