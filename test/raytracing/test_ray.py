"""Rays and primitives of the NumPy face against worked numbers and their definitions."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import odak.learn.raytracing as learned
import odak.raytracing as rt
from odak import AccuracyWarning, ConvergenceWarning
from odak.tools import rotate_points

numbers = st.floats(-10, 10, allow_nan=False)
vectors = st.tuples(numbers, numbers, numbers)


def test_rays_of_seven_digits_cross():
    ray0, ray1 = [[0, 0, 0], [0.2672612, 0.5345225, 0.8017837]], [[10, 20, 0], [0, 0, 1]]
    point, distances = rt.calculate_intersection_of_two_rays(ray0, ray1)
    np.testing.assert_allclose(point, [10, 20, 30], atol=1e-4)
    np.testing.assert_allclose(distances, [1400**0.5, 30], atol=1e-4)
    # A thousandth of the distance between the starts aside.
    point, distances = rt.calculate_intersection_of_two_rays(ray0, [[10.02, 20, 0], [0, 0, 1]])
    assert point.tolist() == [0, 0, 0] and distances.tolist() == [0, 0]


def test_rays_from_angles_and_points():
    np.testing.assert_allclose(rt.create_ray([1, 2, 3], [90, 60, 30])[1], [0, 0.5, 0.8660254], atol=1e-7)
    assert rt.create_ray([[0, 0, 0]] * 4, [90, 60, 30]).shape == (4, 2, 3)
    np.testing.assert_allclose(rt.create_ray_from_two_points([0, 0, 0], [1, 2, 2])[1], [1 / 3, 2 / 3, 2 / 3])
    assert rt.create_ray_from_two_points([0, 0, 0], np.ones((5, 3))).shape == (5, 2, 3)
    assert rt.create_ray_from_two_points(np.ones((5, 3)), [0, 0, 0]).shape == (5, 2, 3)
    assert rt.create_ray_from_two_points(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0, 2, 3)
    assert np.isnan(rt.create_ray_from_two_points([1, 2, 3], [1, 2, 3])[1]).all()
    np.testing.assert_allclose(rt.create_ray_from_angles((1, 2, 3), (0, 0, 0)), [[1, 2, 3], [0, 0, 1]])
    np.testing.assert_allclose(
        rt.create_ray_from_angles([[1, 2, 3]] * 3, (0, 90, 0))[:, 1], [[1, 0, 0]] * 3, atol=1e-15
    )


def test_precision_follows_and_arguments_stay():
    ray = np.asarray([[0, 0, 0], [0, 0.6, 0.8]], dtype=np.float32)
    before = ray.copy()
    assert rt.propagate_a_ray(ray, 2.0).dtype == np.float32
    np.testing.assert_array_equal(ray, before)
    moved = rt.propagate_a_ray(ray.astype(float), [1.0, 2.0, 5.0])
    np.testing.assert_allclose(moved[:, 0], np.outer([1, 2, 5], [0, 0.6, 0.8]), rtol=1e-6)
    np.testing.assert_allclose(moved[:, 1], np.tile(ray[1], (3, 1)))


def test_lines_that_meet():
    point, distances = rt.calculate_intersection_of_two_rays([[0, 0, 0], [1, 0, 0]], [[3, -7, 0], [0, 1, 0]])
    np.testing.assert_allclose(point, [3, 0, 0])
    np.testing.assert_allclose(distances, [3, 7])
    for other in ([[0, 0, 5], [0, 1, 0]], [[0, 1, 0], [1, 0, 0]]):
        point, distances = rt.calculate_intersection_of_two_rays([[1, 0, 0], [1, 0, 0]], other)
        np.testing.assert_allclose(np.r_[point, distances], [1, 0, 0, 0, 0])


def test_nearest_points():
    points = rt.find_nearest_points([[1, 2, 3], [0.6, 0.8, 0]], [[0, 0, -1], [0, 0.6, 0.8]])
    np.testing.assert_allclose(points, [[0.93139, 1.90852, 3], [0, 2.60707, 2.47609]], atol=1e-5)
    parallel = rt.find_nearest_points([[0, 0, 0], [0, 0, 1]], [[3, 0, 7], [0, 0, -1]])
    np.testing.assert_allclose(parallel, [[0, 0, 0], [3, 0, 0]])


@given(vectors, vectors, vectors, vectors)
def test_nearest_points_are_joined_by_the_common_normal(p0, e0, p1, e1):
    ray0, ray1 = rt.create_ray_from_two_points([p0, p1], [e0, e1])
    if not np.isfinite([ray0, ray1]).all() or np.linalg.norm(np.cross(ray0[1], ray1[1])) < 1e-3:
        return
    near0, near1 = rt.find_nearest_points(ray0, ray1)
    assert abs((near1 - near0) @ ray0[1]) < 1e-6
    assert abs((near1 - near0) @ ray1[1]) < 1e-6


def test_planes():
    plane = [[4.72828, 15.52410, 1.21156], [-3.40970, 10.82564, 4.63176], [1, 2, 3]]
    np.testing.assert_allclose(rt.define_plane((1, 2, 3), (10, 20, 30)), plane, atol=1e-5)
    arguments = {"center": [1, 1, 1], "angles": [10, 20, 30]}
    moved = rt.bring_plane_to_origin([[1, 2, 3], [4, 5, 6]], plane, **arguments)
    np.testing.assert_allclose(moved, [[-0.21420, 1.20892, 1.86887], [2.61068, 3.02323, 5.83476]], atol=1e-5)
    one = rt.bring_plane_to_origin((1, 2, 3), plane, [1, 1], mode="ZXY", **arguments)
    np.testing.assert_allclose(one, [0.06318, 1.47752, 1.67718], atol=1e-5)


@pytest.mark.parametrize("mode", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_bringing_back_undoes_the_placement(mode, random):
    points = random.normal(size=(3, 3))
    placed = rotate_points(points, [10, 20, 30], mode, offset=[4, 5, 6])
    back = rt.bring_plane_to_origin(placed, None, center=[4, 5, 6], angles=[10, 20, 30], mode=mode)
    np.testing.assert_allclose(back, points, atol=1e-14)


def test_triangles():
    corners = ([0, 0, 0], [4, 0, 0], [0, 4, 0])
    for point, inside in (
        ([1, 1, 0], True),
        ([2, 2, 0], True),
        ([0, 0, 0], True),
        ([3, 3, 9], False),
        ([1, 1, 9], True),
    ):
        assert rt.is_it_on_triangle(point, *corners) is inside
    np.testing.assert_allclose(rt.center_of_triangle(corners), [[4 / 3, 4 / 3, 0]])


def test_quadrics_are_zero_on_themselves():
    np.testing.assert_allclose(rt.sphere_function([[0, 0, 1], [2, 0, 1]], [0, 0, 1, 2]), [-4, 0])
    np.testing.assert_allclose(rt.cylinder_function((0, 3, 1), rt.define_cylinder([0, 0, 0], 2)), [5])
    tilted = rt.define_cylinder([1, 2, 3], 2, [0, 90, 0])
    np.testing.assert_allclose(tilted, [1, 2, 3, 2, 2, 2, 3], atol=1e-15)
    np.testing.assert_allclose(rt.cylinder_function([[9, 4, 3], [-5, 2, 6], [0, 2, 3]], tilted), [0, 5, -4], atol=1e-12)
    plane, center, radius = rt.define_circle([0, 0, 1], 2.0, [0, 0, 0])
    assert plane.shape == (3, 3) and center == [0, 0, 1] and radius == 2.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: rt.create_ray([1, 2], [90, 60, 30]), r"x0y0z0 must be \[\.\.\., 3\], got \[2\]"),
        (lambda: rt.propagate_a_ray([1, 2, 3], 1.0), r"ray must be \[2, 3\]"),
        (lambda: rt.define_sphere([0, 0, 0], -1.0), "radius must be at least 0, got -1.0"),
        (lambda: rt.create_ray_from_angles([0, 0, 0], [0, 0, 0], "XXZ"), "mode must be one of 'XYZ'"),
    ],
)
def test_errors_name_the_argument(call, message):
    with pytest.raises(ValueError, match=message):
        call()
    with pytest.raises(TypeError, match="x1y1z1 must be numeric"):
        rt.create_ray_from_two_points([0, 0, 0], ["a", "b", "c"])


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_lost_ray_does_not_seem_to_pass_another_by(number):
    ray, other = np.asarray([[0.0, 0, 0], [1, 0, 0]]), np.asarray([[3.0, -7, 0], [0, 1, 0]])
    for which, place in ((0, (0, 2)), (0, (1, 0)), (1, (0, 0)), (1, (1, 1))):
        rays = [ray.copy(), other.copy()]
        rays[which][place] = number
        with np.errstate(invalid="ignore"):
            point, distances = rt.calculate_intersection_of_two_rays(*rays)
        assert np.isnan(point).any() and np.isnan(distances).all()


@pytest.mark.parametrize("face", [rt, learned], ids=["numpy", "torch"])
def test_angles_that_make_no_direction_are_warned_about(face):
    make = np.asarray if face is rt else torch.tensor
    with pytest.warns(AccuracyWarning, match="length 1, got one of length 1.414"):
        face.create_ray(make([0.0, 0.0, 0.0]), make([[90.0, 90.0, 0.0], [0.0, 0.0, 90.0]]))
    face.create_ray(make([0.0, 0.0, 0.0]), make([90.0, 45.02, 45.0]))
    face.create_ray(make([0.0, 0.0, 0.0]), make([float("nan"), 0.0, 0.0]))


def test_a_surface_that_is_not_reached_is_warned_about():
    with pytest.warns(ConvergenceWarning, match="1 rays did not reach an error of 1e-08"):
        rt.intersect_parametric(
            [[0, 0, -5], [0, 0, 1]],
            None,
            lambda points, _: np.sign(points[:, 2]) + 0.5 * (points[:, 2] == 0),
            rt.get_sphere_normal,
        )
