"""Viewers against published values of the pupil and of the transfer of eyes."""

import math

import pytest
import torch

import odak
from odak.learn.perception import (
    Viewer,
    Viewing,
    ocular_modulation_transfer,
    simulate_color_vision_deficiency,
    unified_pupil_diameter,
)


def test_the_pupil_of_two_young_eyes_is_that_of_stanley_and_davies():
    """D = 7.75 − 5.75·F/(F + 2) with F = (L·a/846)^0.41: a third of the span at 846 cd/m²·deg², and both ends."""
    assert float(unified_pupil_diameter(8.46, 100.0)) == pytest.approx(7.75 - 5.75 / 3, abs=1e-12)
    assert float(unified_pupil_diameter(1e-12, 100.0)) == pytest.approx(7.75, abs=1e-4)
    assert float(unified_pupil_diameter(1e15, 100.0)) == pytest.approx(2.0, abs=1e-4)
    # Where F is 2, the pupil is in the middle of the span.
    assert float(unified_pupil_diameter(846 * 2 ** (1 / 0.41), 1.0)) == pytest.approx(4.875, abs=1e-12)


def test_one_eye_gets_a_tenth_of_the_light():
    """Watson and Yellott (2012), equation 21: M(1) = 0.1, M(2) = 1."""
    for luminance in (0.1, 10.0, 1000.0):
        one = unified_pupil_diameter(10 * luminance, 50.0, eyes=1)
        assert float(one) == pytest.approx(float(unified_pupil_diameter(luminance, 50.0)), abs=1e-12)
        assert one > unified_pupil_diameter(10 * luminance, 50.0)


@pytest.mark.parametrize(("luminance", "per_year"), [(9.0, -0.043), (4400.0, -0.015)])
def test_pupils_narrow_with_age_as_measured(luminance, per_year):
    """Winn and others, Invest. Ophthalmol. Vis. Sci. 35, 1132 (1994): one eye, a field of 10° across."""
    field = math.pi * 5**2
    young, old = (unified_pupil_diameter(luminance, field, age, eyes=1) for age in (25.0, 75.0))
    assert float(old - young) / 50 == pytest.approx(per_year, abs=2e-3)
    # The mean age of the observers of Stanley and Davies changes nothing: 28.58 years.
    middle = unified_pupil_diameter(luminance, field, eyes=1)
    assert torch.equal(middle, unified_pupil_diameter(luminance, field, 28.58, eyes=1))
    slope = 0.02132 - 0.009562 * float(middle)
    assert float(old - young) / 50 == pytest.approx(slope, abs=1e-12)


def test_the_pupil_of_a_viewer():
    seen = Viewing(0.6, 0.7, (1080, 1920), peak_luminance=200, black_luminance=2, ambient_light=100 * math.pi)
    across, down = (2 * math.degrees(math.atan(length / 1.4)) for length in (0.6, 0.3375))
    assert seen.area == pytest.approx(across * down)
    # Half of the light between black and white, and 0.5 cd/m² that the display reflects.
    expected = unified_pupil_diameter(101.5, across * down, 40.0, 1)
    assert Viewer(40, eyes=1).pupil_diameter(seen) == pytest.approx(float(expected))
    assert Viewer(adaptation=1e-3).pupil_diameter(seen) > Viewer().pupil_diameter(seen)
    assert Viewer(pupil=3).pupil_diameter(seen) == 3
    assert repr(Viewer(40, 1, 3, 10, "tritan")) == (
        "Viewer: 40 years, 1 eye, a pupil of 3 mm, adapted to 10 cd/m², tritan"
    )


def test_the_transfer_of_eyes():
    """Watson (2013) at the frequency where its first factor is 2^−0.62, and at the limit of diffraction."""
    for pupil in (2.0, 3.0, 6.0):
        bend = 21.95 - 5.512 * pupil + 0.3922 * pupil**2
        cutoff = math.radians(1) * pupil * 1e6 / 555
        share = bend / cutoff
        diffraction = 2 / math.pi * (math.acos(share) - share * math.sqrt(1 - share**2))
        expected = 2**-0.62 * math.sqrt(diffraction)
        assert float(ocular_modulation_transfer(bend, pupil)) == pytest.approx(expected, rel=1e-12)
        assert float(ocular_modulation_transfer(0.0, pupil)) == pytest.approx(1, rel=1e-12)
        assert float(ocular_modulation_transfer(cutoff * 1.01, pupil)) == 0
    free = torch.tensor([0.0, 5.0, 40.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.grad(ocular_modulation_transfer(free).sum(), free)[0][1:].isfinite().all()
    with pytest.warns(odak.AccuracyWarning, match="pupils of 2 to 6 mm"):
        ocular_modulation_transfer(5.0, 8.0)


def test_colours_of_a_viewer():
    picture = torch.rand(1, 3, 4, 5, generator=torch.Generator().manual_seed(0))
    assert Viewer().seen(picture) is picture
    assert torch.equal(
        Viewer(deficiency="protan", severity=0.5).seen(picture),
        simulate_color_vision_deficiency(picture, "protan", 0.5),
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Viewer(age=5), "age must be from 20 to 83 years"),
        (lambda: Viewer(eyes=3), "eyes must be 1 or 2, got 3"),
        (lambda: Viewer(pupil=-1), "pupil must be positive"),
        (lambda: Viewer(deficiency="red"), "deficiency must be one of"),
        (lambda: Viewer(severity=2), "severity must be from 0 to 1"),
        (lambda: ocular_modulation_transfer(-1.0), "frequency must be at least 0, got -1"),
        (lambda: ocular_modulation_transfer(1.0, 0.0), "pupil_diameter must be positive"),
    ],
)
def test_what_no_viewer_can_be(make, message):
    with pytest.raises(ValueError, match=message):
        make()
