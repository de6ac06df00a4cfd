"""Tables of limits of a lens against closed forms."""

import math

import pytest
import torch

from odak.learn.raytracing.system import lens_limits, load_system, optical_system, standard_design, surface

INDEX = torch.tensor([1.52, 1.51, 1.505], dtype=torch.float64)


def planoconvex(**options):
    """Return a planoconvex lens of 50 mm radius, 4 mm thick and 20 mm wide, in collimated light along its axis."""
    rows = [
        surface(50.0, thickness=4.0, material=INDEX, semi_diameter=10.0),
        surface(thickness=90.0, semi_diameter=9.0),
    ]
    return optical_system(rows, 20.0, wavelengths=[450e-6, 550e-6, 650e-6], reference=1, **options)


def test_rows_are_those_of_closed_forms():
    """Sags of a sphere, focal lengths R/(n − 1) less t/n, and what is met within a percent."""
    limits = {"edge": 3.0, "edge_per_diameter": 0.14, "center_per_diameter": 0.2, "glass": (4.04, 3.9)}
    limits |= {"back": 91.0, "track": 94.5, "axial_color": 2.0}
    rows = {(row.name, row.kind): row for row in lens_limits(planoconvex(), limits)}
    edge = 4.0 - (50.0 - math.sqrt(50.0**2 - 10.0**2))
    distances = 50.0 / (INDEX - 1) - 4.0 / INDEX
    expected = {
        ("edge", "least"): (edge, True),
        ("edge_per_diameter", "least"): (edge / 20.0, True),
        ("center_per_diameter", "least"): (0.2, True),
        ("glass", "least"): (4.0, True),
        ("glass", "largest"): (4.0, False),
        ("back", "least"): (90.0, False),
        ("track", "largest"): (94.0, True),
        ("axial_color", "largest"): (float(distances.max() - distances.min()), False),
    }
    assert rows.keys() == expected.keys()
    for name, (value, met) in expected.items():
        assert rows[name].value == pytest.approx(value, rel=1e-12) and rows[name].met == met, name


def test_lateral_color_counts_from_the_reference_wavelength():
    """A prism-like chief ray: behind a thin lens at a distance from the stop, the height goes by the power."""
    rows = [surface(thickness=30.0, stop=True), surface(100.0, material=INDEX, thickness=1e-9), surface(thickness=50.0)]
    angle = 0.01
    lens = optical_system(rows, 1.0, fields=[0.0, angle], wavelengths=[450e-6, 550e-6, 650e-6], reference=1)
    (row,) = lens_limits(lens, {"lateral_color": 1.0})
    height = 30.0 * math.tan(math.radians(angle))
    assert row.value == pytest.approx(50.0 * height * float(INDEX[0] - INDEX[1]) / 100.0, rel=1e-5) and row.met


def test_lost_rays_and_unknown_limits():
    ball = [surface(thickness=50.0, stop=True), surface(10.0, thickness=20.0, material=INDEX), surface(-10.0)]
    lens = optical_system(ball, 1.0, fields=[0.0, 40.0], wavelengths=[450e-6, 550e-6, 650e-6], reference=1)
    (row,) = lens_limits(lens, {"distortion": 0.5})
    assert math.isnan(row.value) and not row.met
    with pytest.raises(ValueError, match="name of limits must be one of"):
        lens_limits(lens, {"length": 3.0})
    with pytest.raises(ValueError, match="glass of limits must have 2 numbers, got 1"):
        lens_limits(lens, {"glass": [3.0]})


def test_a_usual_design_brings_lateral_colour_within_its_bound():
    """Half of what the triplet has."""
    lens = load_system("cooke_triplet")
    bound = 0.5 * lens_limits(lens, {"lateral_color": 1.0})[0].value
    standard_design(lens, limits={"lateral_color": bound}).optimise(3)
    assert lens_limits(lens, {"lateral_color": bound})[0].met
