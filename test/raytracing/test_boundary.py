"""Intersections, reflection and refraction of the NumPy face against worked numbers, geometry and conservation laws."""

import array_api_strict as strict
import hits
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import odak.raytracing as rt
from odak.raytracing import interfaces
from odak.raytracing.intersections import RayStatus
from odak.tools import rotate_points

Z_AXIS = [[0, 0, 0], [0, 0, 1]]


def random_rays(random, count=200, spread=3.0):
    return rt.create_ray_from_two_points(random.normal(size=(count, 3)) * spread, random.normal(size=(count, 3)))


def test_plane():
    normal, distance = rt.intersect_w_surface([[0, 0, 0], [0, 0.6, 0.8]], rt.define_plane([0, 0, 10], [0, 0, 0]))
    np.testing.assert_allclose(normal, [[0, 7.5, 10], [0, 0, 1]])
    np.testing.assert_allclose(distance, [12.5])
    behind = rt.intersect_w_surface([[0, 0, 20], [0, 0.6, 0.8]], rt.define_plane([0, 0, 10]))
    np.testing.assert_allclose(behind[0][0], [0, -7.5, 10])
    np.testing.assert_allclose(behind[1], [12.5])
    normal, distance = rt.intersect_w_surface([[0, 0, 0], [0, 1, 0]], rt.define_plane([0, 0, 10]))
    assert np.isnan(distance).all() and np.isnan(normal[0]).all()
    np.testing.assert_allclose(normal[1], [0, 0, 1])
    tilted = rt.get_triangle_normal(rt.define_plane([0, 0, 0], [0, 45, 0]))
    np.testing.assert_allclose(tilted[1], [0.5**0.5, 0, 0.5**0.5])


def test_triangle_normals_are_each_their_own():
    triangles = [
        [[0, 0, 0], [1, 0, 0], [0, 1, 1]],
        [[0, 0, 0], [0, 1, 0], [1, 0, 0]],
        [[0, 0, 0], [1, 1, 1], [3, 3, 3]],
    ]
    normal = rt.get_triangle_normal(triangles)[:, 1]
    np.testing.assert_allclose(normal[:2], [[0, -(0.5**0.5), 0.5**0.5], [0, 0, -1]])
    assert np.isnan(normal[2]).all()


def test_triangle_and_circle():
    triangle = [[50, 50, 1000], [-5, -5, 1000], [0, 50, 1000]]
    toward = rt.create_ray_from_two_points([0, 0, 0], [[10, 10, 1000], [0, 100, 1000], [0, 30, 1000]])
    assert rt.intersect_w_triangle(toward[1], triangle) == (0, 0)
    normal, distance = rt.intersect_w_triangle(toward[2], triangle)
    np.testing.assert_allclose(normal[0], [0, 30, 1000])
    normal, distance = rt.intersect_w_triangle(toward, triangle)
    assert distance[1] == 0 and np.isnan(normal[1]).all()
    np.testing.assert_allclose(distance[2], np.sqrt(30**2 + 1000**2))
    assert rt.intersect_w_triangle(Z_AXIS, [[0, 0, 5], [1, 1, 5], [2, 2, 5]]) == (0, 0)
    circle = rt.define_circle([0, 0, 5], 2.0, [0, 0, 0])
    normal, distance = rt.intersect_w_circle(rt.create_ray([[0, 1, 0], [0, 3, 0]], [90, 90, 0]), circle)
    np.testing.assert_allclose(distance, [5, 0])
    np.testing.assert_allclose(normal[:, 0], [[0, 1, 5], [0, 3, 5]], atol=1e-12)
    assert rt.intersect_w_circle([Z_AXIS], circle)[0].shape == (1, 2, 3)


def test_sphere_numbers():
    normal, distance = rt.intersect_w_sphere([[-20, 3, 4], [1, 0, 0]], rt.define_sphere([0, 0, 0], 10))
    np.testing.assert_allclose(normal, [[-8.66025, 3, 4], [0.86603, -0.3, -0.4]], atol=1e-5)
    np.testing.assert_allclose(distance, [11.33975], atol=1e-5)
    ray = rt.create_ray_from_two_points([0, 0, 0], [5, 0, 100])
    normal, distance = rt.intersect_w_sphere(ray, [0, 0, 100, 20])
    np.testing.assert_allclose(np.r_[normal[0], distance], [4.02041, 0, 80.40826, 80.50871], atol=1e-5)
    np.testing.assert_allclose(rt.intersect_w_sphere([[-2, 0, 0], [1, 0, 0]], [0, 0, 0, 10])[1], [12])
    assert rt.intersect_w_sphere([[20, 0, 0], [1, 0, 0]], [0, 0, 0, 10]) == (False, False)
    distance = rt.intersect_w_sphere([[[0, 9, -5], [0, 0, 1]], [[0, 0, -5], [0, 0, 1]]], [0, 0, 0, 1])[1]
    np.testing.assert_allclose(distance, [np.nan, 4])


def test_sphere_keeps_its_digits_far_away():
    offset, radius = 1e5 + 0.3, 1.0
    _, distance = rt.intersect_w_sphere([[-offset, 0.6, 0], [1, 0, 0]], [0, 0, 0, radius])
    assert distance[0] == pytest.approx(offset - 0.8, abs=3e-11)
    single = np.asarray([[-1e4, 0.6, 0], [1, 0, 0]], dtype=np.float32)
    normal, _ = rt.intersect_w_sphere(single, np.asarray([0, 0, 0, 1], dtype=np.float32))
    assert normal.dtype == np.float32
    assert normal[0, 0] == pytest.approx(-0.8, abs=1e-3)  # half a spacing of floats at 1e4


def test_a_ray_that_leaves_a_sphere_meets_its_other_side(random):
    rays = random_rays(random)
    center, radius = np.asarray([0.3, -0.2, 50.0]), 4.0
    aim = rt.create_ray_from_two_points(rays[:, 0], center + random.normal(size=(200, 3)))
    first = hits.sphere(aim[:, 0], aim[:, 1], center, radius)
    assert first.hit.all()
    second = hits.sphere(first.point, aim[:, 1], center, radius)
    half_chord = -np.sum((first.point - center) * aim[:, 1], axis=-1)
    np.testing.assert_allclose(second.distance, 2 * half_chord, rtol=1e-9)
    assert not hits.sphere(second.point, aim[:, 1], center, radius).hit.any()


def test_cylinder():
    cylinder = rt.define_cylinder([0, 0, 0], 2)
    normal, distance = rt.intersect_w_cylinder([[-20, 1, 4], [1, 0, 0]], cylinder)
    np.testing.assert_allclose(normal, [[0, 0, 4], [-0.86603, 0.5, 0]], atol=1e-5)
    np.testing.assert_allclose(distance, [18.26795], atol=1e-5)
    assert rt.intersect_w_cylinder([[1, 0, 0], [0, 0, 1]], cylinder) == (False, False)
    np.testing.assert_allclose(rt.intersect_w_cylinder([[1, 0, 0], [1, 0, 0]], cylinder)[1], [1])
    np.testing.assert_allclose(rt.get_cylinder_normal((0, 2, 3), cylinder), [[0, 0, 3], [0, 1, 0]])
    assert rt.get_cylinder_normal([[0, 2, 3], [1, 0, 0]], cylinder).shape == (2, 2, 3)
    np.testing.assert_allclose(rt.get_sphere_normal((0, 0, 3), [0, 0, 1, 2]), [[0, 0, 3], [0, 0, -1]])


def test_hits_lie_on_the_surfaces(random):
    rays = random_rays(random)
    sphere, cylinder = rt.define_sphere([0.1, 0.2, 0.3], 1.5), rt.define_cylinder([0.1, 0.2, 0.3], 1.5, [30, 40, 50])
    normal, distance = rt.intersect_w_sphere(rays, sphere)
    hit = np.isfinite(distance)
    assert 20 < hit.sum() < 200
    np.testing.assert_allclose(rt.sphere_function(normal[hit, 0], sphere), 0, atol=1e-12)
    _, distance = rt.intersect_w_cylinder(rays, cylinder)
    hit = np.isfinite(distance)
    points = rays[hit, 0] + distance[hit, None] * rays[hit, 1]
    np.testing.assert_allclose(rt.cylinder_function(points, cylinder), 0, atol=1e-11)
    # Nothing of the surface lies between start and hit: halfway, the sign is that of the start.
    half = rays[hit, 0] + distance[hit, None] / 2 * rays[hit, 1]
    at_start = rt.cylinder_function(rays[hit, 0], cylinder)
    assert (np.sign(rt.cylinder_function(half, cylinder)) == np.sign(at_start)).all()


def test_closed_forms_agree_with_the_search(random):
    rays, sphere = random_rays(random, 60), rt.define_sphere([0.1, 0.2, 0.3], 1.0)
    normal, distance = rt.intersect_w_sphere(rays, sphere)
    found, found_normal = rt.intersect_parametric(rays, sphere, rt.sphere_function, rt.get_sphere_normal, 1e-12)
    np.testing.assert_allclose(found, distance, rtol=1e-9)
    np.testing.assert_allclose(found_normal, normal, atol=1e-9)
    miss = [[5, 5, 5], [0, 0, 1]]
    assert rt.intersect_parametric(miss, sphere, rt.sphere_function, rt.get_sphere_normal) == (False, False)
    graze = [[0.1, 1.2 - 1e-9, -500], [0, 0, 1]]
    assert rt.intersect_parametric(graze, sphere, rt.sphere_function, rt.get_sphere_normal)[0] == pytest.approx(
        500.3, rel=1e-6
    )


def test_parametric_steps_leave_their_arguments():
    distance, error = [0, 1], [5, 3]
    assert rt.propagate_parametric_intersection_error(distance, error) == ([1, 2.5], [3, 3])
    assert (distance, error) == ([0, 1], [5, 3])


@given(st.integers(0, 2**31))
def test_rotating_and_moving_everything_changes_no_distance(seed):
    random = np.random.default_rng(seed)
    rays, triangle = random_rays(random, 20), random.normal(size=(3, 3))
    cylinder = rt.define_cylinder(random.normal(size=3), 1.2, random.uniform(-90, 90, 3))
    angles, shift = random.uniform(-180, 180, 3), random.normal(size=3)

    def turn(points):
        return rotate_points(np.reshape(points, (-1, 3)), angles, offset=shift).reshape(np.shape(points))

    turned = rays.copy()
    turned[:, 0], turned[:, 1] = turn(rays[:, 0]), rotate_points(rays[:, 1], angles)
    other = np.r_[turn(cylinder[:3]), 1.2, turn(cylinder[4:])]
    for function, surface, moved in (
        (rt.intersect_w_sphere, np.r_[cylinder[:4]], np.r_[other[:4]]),
        (rt.intersect_w_cylinder, cylinder, other),
        (rt.intersect_w_surface, triangle, turn(triangle)),
    ):
        expected, result = function(rays, surface)[1], function(turned, moved)[1]
        np.testing.assert_allclose(result, expected, rtol=1e-6, atol=1e-9)


def test_reflection():
    ray = [[0, 0, 0], [0, 0.6, 0.8]]
    np.testing.assert_allclose(rt.reflect(ray, [[1, 1, 1], [0, 0, 2]]), [[1, 1, 1], [0, 0.6, -0.8]])
    normals = [[[0, 0, i], [i, 0, -1]] for i in range(3)]
    many = rt.reflect(ray, normals)
    for i, normal in enumerate(normals):
        np.testing.assert_allclose(many[i], rt.reflect(ray, normal))
    assert rt.reflect([ray] * 3, normals[0]).shape == (3, 2, 3)
    assert np.isnan(rt.reflect(ray, [[0, 0, 0], [0, 0, 0]])[1]).all()


def test_refraction_numbers():
    ray = [[0, 0, 0], [0, 0.6, 0.8]]
    np.testing.assert_allclose(rt.refract(ray, Z_AXIS, 1, 1.5, error=0.1)[1], [0, 0.4, 0.916515], atol=1e-6)
    np.testing.assert_allclose(rt.refract(ray, [[0, 0, 0], [0, 0, -3]], 1.5, 1)[1], [0, 0.9, 0.435890], atol=1e-6)
    np.testing.assert_allclose(rt.refract(ray, Z_AXIS, 1.3, 1.3)[1], [0, 0.6, 0.8], atol=1e-15)
    assert np.isnan(rt.refract([[0, 0, 0], [0, 0.8, 0.6]], Z_AXIS, 1.5, 1)[1]).all()
    np.testing.assert_allclose(rt.refract([[0, 0, 0], [0, 1, 0]], Z_AXIS, 1, 2)[1], [0, 0.5, 0.75**0.5])
    assert np.isnan(rt.refract([[0, 0, 0], [0, 1, 0]], Z_AXIS, 2, 1)[1]).all()


def test_refraction_statuses():
    direction = np.asarray([[0, 0.8, 0.6], [0, 0.6, 0.8], [0, 0, 0], [np.nan, 0, 1]])
    out, status = interfaces.refract_directions(direction, np.asarray([0, 0, 1.0]), 1.5, 1.0)
    assert [RayStatus(s).name for s in status] == ["TOTAL_INTERNAL_REFLECTION", "HIT", "MISS", "MISS"]
    assert np.isfinite(out[1]).all() and np.isnan(out[[0, 2, 3]]).all()


indices = st.floats(1.0, 3.0)


@given(st.integers(0, 2**31), indices, indices)
def test_refraction_obeys_snell_and_is_reversible(seed, n1, n2):
    random = np.random.default_rng(seed)
    rays, normals = random_rays(random, 30), random_rays(random, 30)
    out = rt.refract(rays, normals, n1, n2)
    through = np.isfinite(out[:, 1]).all(axis=-1)
    d, n, e = rays[through, 1], normals[through, 1], out[through, 1]
    np.testing.assert_allclose(n1 * np.cross(d, n), n2 * np.cross(e, n), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(e, axis=-1), 1, rtol=1e-12)
    assert (np.sum(d * n, -1) * np.sum(e * n, -1) >= 0).all()
    away = np.abs(np.sum(e * n, -1)) > 1e-3
    back = rt.refract(np.stack((normals[through, 0], -e), 1)[away], normals[through][away], n2, n1)
    np.testing.assert_allclose(back.reshape(-1, 2, 3)[:, 1], -d[away], atol=1e-10)
    sine = np.linalg.norm(np.cross(rays[:, 1], normals[:, 1]), axis=-1)
    np.testing.assert_array_equal(
        ~through[np.abs(sine - n2 / n1) > 1e-9], (sine > n2 / n1)[np.abs(sine - n2 / n1) > 1e-9]
    )


@given(st.integers(0, 2**31), indices, indices)
def test_fresnel_conserves_energy(seed, n1, n2):
    random = np.random.default_rng(seed)
    f = rt.fresnel_coefficients(random_rays(random, 20), random_rays(random, 20), n1, n2)
    np.testing.assert_allclose(f.reflectance_s + f.transmittance_s, 1, atol=1e-12)
    np.testing.assert_allclose(f.reflectance_p + f.transmittance_p, 1, atol=1e-12)
    assert (f.transmittance_s >= -1e-15).all()


def test_fresnel_numbers():
    brewster = np.arctan(1.5)
    ray = [[0, 0, 0], [0, np.sin(brewster), np.cos(brewster)]]
    f = rt.fresnel_coefficients(ray, Z_AXIS, 1.0, 1.5)
    np.testing.assert_allclose(f.reflectance_p, [0], atol=1e-30)
    np.testing.assert_allclose(f.reflectance_s, [((1.5**2 - 1) / (1.5**2 + 1)) ** 2])
    total = rt.fresnel_coefficients([[0, 0, 0], [0, 0.8, 0.6]], Z_AXIS, 1.5, 1.0)
    np.testing.assert_allclose(np.r_[total.reflectance_s, total.transmittance_p], [1, 0], atol=1e-14)
    # Born and Wolf 1999, section 1.5.4, eq. 60: tan((δp − δs)/2) = cosθ·√(sin²θ − n²)/sin²θ, n = n2/n1.
    phase = np.angle(total.reflected_p / total.reflected_s) / 2
    np.testing.assert_allclose(np.abs(np.tan(phase)), 0.6 * np.sqrt(0.64 - 1 / 2.25) / 0.64, rtol=1e-12)
    metal = rt.fresnel_coefficients(Z_AXIS, Z_AXIS, 1.0, 0.2 + 3.4j)
    np.testing.assert_allclose(metal.reflectance_s, abs((0.8 - 3.4j) / (1.2 + 3.4j)) ** 2)
    np.testing.assert_allclose(metal.transmittance_p, 1 - metal.reflectance_p)
    slanted = rt.fresnel_coefficients([[0, 0, 0], [0, 0.8, 0.6]], Z_AXIS, 1.0, 0.2 + 3.4j)
    np.testing.assert_allclose(slanted.reflectance_p + slanted.transmittance_p, 1, rtol=1e-13)
    np.testing.assert_allclose(slanted.reflectance_s + slanted.transmittance_s, 1, rtol=1e-13)


def test_core_runs_on_the_strict_array_api(random):
    rays = random_rays(random, 30)
    center, axis = np.zeros(3), np.asarray([0.0, 0.6, 0.8])
    cases = [
        (hits.plane, (center, axis)),
        (hits.sphere, (center, np.asarray(1.0))),
        (hits.cylinder, (center, np.asarray(1.0), axis)),
        (hits.conic, (np.asarray(0.1), np.asarray(-0.5))),
    ]
    for function, surface in cases:
        expected = function(rays[:, 0], rays[:, 1], *surface)
        result = function(strict.asarray(rays[:, 0]), strict.asarray(rays[:, 1]), *map(strict.asarray, surface))
        for a, b in zip(result, expected, strict=True):
            np.testing.assert_allclose(np.asarray(a), b, rtol=1e-12, atol=1e-12)


def test_rays_and_surfaces_broadcast(random):
    rays, centers = random_rays(random, 7), random.normal(size=(5, 3))
    hit = hits.sphere(rays[:, None, 0], rays[:, None, 1], centers, np.ones(5))
    assert hit.distance.shape == (7, 5) and hit.point.shape == (7, 5, 3) and hit.status.dtype == np.int8
    one = hits.sphere(rays[:, 0], rays[:, 1], centers[2], 1.0)
    np.testing.assert_allclose(hit.distance[:, 2], one.distance)
    empty = np.zeros((0, 2, 3))
    assert rt.intersect_w_sphere(empty, [0, 0, 0, 1])[0].shape == (0, 2, 3)
    assert rt.intersect_w_triangle(empty, np.eye(3))[1].shape == (0,)


def test_directions_without_length_miss():
    ray = [[[0, 0, -5], [0, 0, 0]], [[0, 0, -5], [0, 0, 2]], [[0, 0, np.nan], [0, 0, 1]]]
    np.testing.assert_allclose(rt.intersect_w_sphere(ray, [0, 0, 0, 1])[1], [np.nan, 2, np.nan])
    np.testing.assert_allclose(rt.intersect_w_surface(ray, rt.define_plane([0, 0, 0]))[1], [np.nan, 2.5, np.nan])


RAYS = np.array([Z_AXIS] * 3, dtype=float)
TRIANGLES = np.array([[[-1, -1, 5], [1, -1, 5], [0, 1, 5]]] * 3, dtype=float)
SPHERES = np.array([[0, 0, 5, 1]] * 3, dtype=float)
CYLINDERS = np.stack([rt.define_cylinder([0, 0, 5], 1, [0, 90, 0])] * 3)
INDICES = np.full(3, 1.5)


@pytest.mark.parametrize(
    ("function", "names", "arguments"),
    [
        (rt.refract, ("vector", "n2"), (RAYS, Z_AXIS, 1.0, INDICES)),
        (rt.fresnel_coefficients, ("ray", "n2"), (RAYS, Z_AXIS, 1.0, INDICES)),
        (rt.intersect_w_surface, ("ray", "points"), (RAYS, TRIANGLES)),
        (rt.intersect_w_triangle, ("ray", "triangle"), (RAYS, TRIANGLES)),
        (rt.intersect_w_sphere, ("ray", "sphere"), (RAYS, SPHERES)),
        (rt.intersect_w_cylinder, ("ray", "cylinder"), (RAYS, CYLINDERS)),
    ],
)
def test_batches_of_one_length_meet_and_others_are_named(function, names, arguments):
    result = function(*arguments)
    assert len(result if isinstance(result, np.ndarray) else result[0]) == 3
    first, last = names
    together = rf"cannot be broadcast together: {first} \[2\].*{last} \[3\]"
    with pytest.raises(ValueError, match=rf"{together}|^{last} must be one .* each of the rays \[2\], got \[3\]"):
        function(arguments[0][:2], *arguments[1:])


def test_arrays_of_two_libraries_are_named():
    with pytest.raises(TypeError, match=r"arrays must be of one library, got arrays of numpy and torch: give the"):
        rt.reflect(np.ones((2, 3)), torch.ones(2, 3))
