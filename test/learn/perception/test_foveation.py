"""Maps of eccentricity and pooling size against explicit trigonometry."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn import perception

EXACT = {"dtype": torch.float64}
unit = st.floats(-0.5, 1.5)


@settings(max_examples=25)
@given(unit, unit, st.floats(0.05, 2), st.floats(0.1, 2))
def test_eccentricity_is_the_angle_between_two_lines_of_sight(x, y, width, distance):
    rows, columns = 5, 8
    angle, far = perception.make_eccentricity_distance_maps([x, y], (rows, columns), width, distance, **EXACT)
    height = width * rows / columns
    places = [
        ((j / (columns - 1) - 0.5) * width, (i / (rows - 1) - 0.5) * height, distance)
        for i in range(rows)
        for j in range(columns)
    ]
    gaze = np.array([(x - 0.5) * width, (y - 0.5) * height, distance])
    for place, a, d in zip(np.array(places), angle.flatten().tolist(), far.flatten().tolist(), strict=True):
        assert d == pytest.approx(np.linalg.norm(place), rel=1e-12)
        chord = np.linalg.norm(place / np.linalg.norm(place) - gaze / np.linalg.norm(gaze))
        assert a == pytest.approx(2 * math.asin(chord / 2), abs=1e-12)


def test_locations_lie_on_the_screen():
    places = perception.make_3d_location_map([3, 5], 0.4, 0.7, **EXACT)
    assert places.shape == (3, 3, 5)
    assert places[:, 0, 0].tolist() == pytest.approx([-0.2, -0.12, 0.7])
    assert places[:, 2, 4].tolist() == pytest.approx([0.2, 0.12, 0.7])


@pytest.mark.parametrize("alpha", [0.1, 0.25])
def test_linear_pooling_grows_by_alpha_per_radian(alpha):
    # A small screen far away: tangents are angles, and a circle stays one.
    options = {"real_image_width": 0.02, "real_viewing_distance": 1.0}
    angle, _ = perception.make_eccentricity_distance_maps([0.5, 0.5], (65, 65), **options, **EXACT)
    pixels = perception.make_pooling_size_map_pixels([0.5, 0.5], (65, 65), alpha, mode="linear", **options, **EXACT)
    radians = pixels * 0.02 / 65 / math.sqrt(math.pi / 4)
    torch.testing.assert_close(radians, alpha * angle, rtol=2e-4, atol=1e-9)
    quadratic = perception.make_pooling_size_map_pixels([0.5, 0.5], (65, 65), alpha, **options, **EXACT)
    torch.testing.assert_close(quadratic * 0.02 / 65 / math.sqrt(math.pi / 4), alpha * angle**2, rtol=2e-4, atol=1e-9)


def test_pooling_on_a_wide_screen_is_the_ellipse_of_a_cone():
    alpha, width, distance = 0.4, 1.0, 0.5
    pixels = perception.make_pooling_size_map_pixels([0.5, 0.5], (1, 101), alpha, width, distance, "linear", **EXACT)
    x = np.linspace(-0.5, 0.5, 101)[90] * width
    # One row is the top row of the screen: half a pixel's height above the axis at most.
    y = -0.5 * width / 101
    eccentricity = math.atan2(math.hypot(x, y), distance)
    half = alpha * eccentricity / 2
    major = distance * (math.tan(eccentricity + half) - math.tan(eccentricity - half))
    minor = 2 * math.sqrt(x**2 + y**2 + distance**2) * math.tan(half)
    assert pixels[0, 90] == pytest.approx(math.sqrt(math.pi / 4 * major * minor) * 101, rel=1e-10)


def test_levels_are_logarithms_and_zero_at_the_gaze():
    arguments = ([0.3, 0.6], (40, 60), 0.5, 0.6, 0.4)
    pixels = perception.make_pooling_size_map_pixels(*arguments, **EXACT)
    levels = perception.make_pooling_size_map_lod(*arguments, **EXACT)
    torch.testing.assert_close(levels, torch.log2(pixels.clamp_min(1)), atol=2e-6, rtol=0)
    assert levels[24, 18] == 0
    assert levels.max() > 2
    row, column = divmod(int(pixels.argmin()), 60)
    assert (row, column) == (round(0.6 * 39), round(0.3 * 59))


@pytest.mark.filterwarnings("ignore:real_image_width 20")
def test_extreme_geometry_stays_within_the_picture():
    pixels = perception.make_pooling_size_map_pixels([-1, 2], (32, 32), 5.0, 20.0, 0.1)
    assert pixels.isfinite().all()
    assert pixels.max() <= math.hypot(32, 32) * (1 + 1e-6)


def test_radial_map_takes_x_first():
    radius = perception.make_radial_map([10, 20], [1.0, 0.0], **EXACT)
    assert radius[0, -1] == 0
    assert radius[-1, 0] == 1
    assert radius[0, 0] == pytest.approx(20 / math.hypot(10, 20))


def test_equirectangular_pooling():
    rows, columns, alpha = 17, 33, 0.3
    size = perception.make_equi_pooling_size_map_pixels([0, 0], (rows, columns), alpha, "linear", **EXACT)
    assert size[rows // 2, columns // 2] == 0
    # A quarter turn to the right: the angle is π/2, and a degree has as many pixels as a picture of 360 says.
    per_radian = math.sqrt(columns / (2 * math.pi) * rows / math.pi) * math.sqrt(math.pi / 4)
    assert size[rows // 2, columns // 2 + columns // 4] == pytest.approx(alpha * math.pi / 2 * per_radian, rel=1e-12)
    # The poles are a quarter turn away whatever the yaw, and the seam is half a turn away from both sides.
    torch.testing.assert_close(size[0], torch.full_like(size[0], alpha * math.pi / 2 * per_radian))
    assert size[rows // 2, 0] == pytest.approx(float(size[rows // 2, -1]))
    on_grid = perception.make_equi_pooling_size_map_pixels([math.pi / 16, math.pi / 16], (65, 129), alpha)
    assert on_grid.isfinite().all()
    lod = perception.make_equi_pooling_size_map_lod([0, 0], (rows, columns), alpha, "linear", **EXACT)
    torch.testing.assert_close(lod, torch.log2(size.clamp_min(1)), atol=2e-6, rtol=0)


def test_maps_are_float32_unless_asked_otherwise():
    assert perception.make_pooling_size_map_lod([0.5, 0.5], (4, 4)).dtype == torch.float32
    assert perception.make_radial_map([4, 4], [0.5, 0.5], dtype=torch.float64).dtype == torch.float64
