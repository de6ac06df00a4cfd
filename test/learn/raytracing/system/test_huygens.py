"""Huygens' sum against closed forms and the Fourier transform, and the illumination of the image."""

import math

import pytest
import torch

from odak.learn.raytracing.system import (
    first_order,
    huygens_point_spread_function,
    load_system,
    modulation_at,
    optical_system,
    point_spread_function,
    relative_illumination,
    surface,
)
from odak.raytracing.apertures import CircularAperture
from odak.raytracing.interfaces import IdealLens

F64 = torch.float64


def test_a_perfect_lens_has_the_modulation_of_a_circular_pupil():
    """(2/π)(acos ν − ν√(1 − ν²)), ν the frequency over 2·NA/λ (Goodman 2005, eq. 6-31)."""
    mirror = optical_system(
        [surface(-200.0, conic=-1.0, material="mirror", thickness=-100.0)], 10.0, wavelengths=500e-6
    )
    spread = huygens_point_spread_function(mirror, 64, 128)
    assert float(spread.strehl) == pytest.approx(1, abs=1e-6)
    cutoff = 2 * float(first_order(mirror).numerical_aperture) / 500e-6
    for share in (0.1, 0.35, 0.6, 0.85):
        expected = 2 / math.pi * (math.acos(share) - share * math.sqrt(1 - share**2))
        for axis in ("x", "y"):
            assert float(modulation_at(spread, share * cutoff, axis)) == pytest.approx(expected, abs=1e-3)


def test_an_obscured_pupil_without_aberration_has_a_peak_of_one():
    hole = CircularAperture(radius=3.0, obscures=True)
    items = [surface(-200.0, conic=-1.0, material="mirror", thickness=-100.0, aperture=hole)]
    mirror = optical_system(items, 10.0, wavelengths=500e-6)
    for spread in (huygens_point_spread_function(mirror, 64, 32), point_spread_function(mirror, 64, 128)):
        assert float(spread.strehl) == pytest.approx(1, abs=1e-6)
        # Of the light of a ring, in an image of any width, the peak is λ²/area of the direction cosines.
        area = math.pi * (first_order(mirror).numerical_aperture ** 2) * (1 - 0.6**2)
        assert float(spread.energy * spread.pitch.prod(-1)) == pytest.approx(500e-6**2 / float(area), rel=0.01)


def test_it_agrees_with_the_fourier_transform_where_both_hold():
    triplet = load_system("cooke_triplet")
    triplet.aperture, triplet.fields = 4.0, ((0.0, 0.0), (0.0, 8.0))
    ours, theirs = huygens_point_spread_function(triplet, 48, 96), point_spread_function(triplet, 48, 192)
    torch.testing.assert_close(ours.strehl, theirs.strehl, rtol=0.02, atol=0.0)
    for frequency in (40.0, 90.0):
        both = (modulation_at(spread, frequency) for spread in (ours, theirs))
        torch.testing.assert_close(*both, rtol=0.02, atol=5e-3)


def test_an_ideal_lens_lights_its_image_as_a_disc_does():
    """E ∝ 1 − (d² + h² − a²)/√((d² + h² + a²)² − 4a²h²) of a Lambertian disc at a distance (Walsh 1958)."""
    a, d = 8.0, 30.0
    lens = optical_system([surface(phase=IdealLens(d), thickness=d, stop=True)], 2 * a, fields=[0.0, 15.0, 35.0])
    found = relative_illumination(lens)[0]
    heights = [d * math.tan(math.radians(angle)) for angle in (0.0, 15.0, 35.0)]
    disc = [1 - (d * d + h * h - a * a) / math.sqrt((d * d + h * h + a * a) ** 2 - 4 * a * a * h * h) for h in heights]
    assert found.tolist() == pytest.approx([value / disc[0] for value in disc], rel=1e-9)


def test_vignetting_darkens_and_gradients_pass():
    triplet = load_system("cooke_triplet")
    whole = relative_illumination(triplet, 8, vignetting=False)[1]
    triplet.surfaces[0].semi_diameter = 6.5
    cut = relative_illumination(triplet, 8)[1]
    assert float(whole[0]) == pytest.approx(1, abs=1e-12)
    assert bool((cut[1:] < 0.9 * whole[1:]).all())
