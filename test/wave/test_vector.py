import numpy as np
import pytest

import odak
from odak.wave import vector


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
    monkeypatch.setattr(vector, "_CHUNK_BYTES", 16 * 7 * 2)
    np.testing.assert_allclose(odak.wave.propagate_field(sources, targets, field, k, direction=-1), expected)


def test_coinciding_points_and_shapes_are_refused(random):
    points = random.normal(size=(3, 3))
    with pytest.raises(ValueError, match="coincide"):
        odak.wave.propagate_field(points, points, np.ones(3, complex), 1.0)
    with pytest.raises(ValueError, match="points0 must be an array"):
        odak.wave.propagate_field(points[:, :2], points, np.ones(3, complex), 1.0)
    with pytest.raises(ValueError, match="field0 must have one value"):
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
