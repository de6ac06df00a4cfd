"""Surfaces at the edges of what is defined: one and many of everything, rims, critical angles, rays that are none."""

import numpy as np
import pytest
import torch

import odak.learn.raytracing as learn
import odak.raytracing as rt
from odak.raytracing import interfaces
from odak.raytracing.intersections import RayStatus

X, Y, Z = np.eye(3)
HIT, MISS, REFLECTED = RayStatus.HIT, RayStatus.MISS, RayStatus.TOTAL_INTERNAL_REFLECTION


def random_directions(random, count=50):
    return random.normal(size=(count, 3)) * 10.0 ** random.uniform(-3, 3, size=(count, 1))


def angle_cosines(direction, normal):
    return abs((direction * normal).sum(-1)) / np.linalg.norm(direction, axis=-1) / np.linalg.norm(normal, axis=-1)


def test_amplitudes_and_powers_tell_the_same(random):
    direction, normal = random_directions(random), random_directions(random)
    n1, n2 = 1.3, 1.9
    f = interfaces.fresnel(direction, normal, n1, n2)
    cos1 = angle_cosines(direction, normal)
    cos2 = np.sqrt(1 - (n1 / n2) ** 2 * (1 - cos1**2))
    # The tangential field is continuous: E for s, H for p.
    np.testing.assert_allclose(1 + f.reflected_s, f.transmitted_s, rtol=1e-12)
    np.testing.assert_allclose(n1 * (1 + f.reflected_p), n2 * f.transmitted_p, rtol=1e-12)
    flow = n2 * cos2 / (n1 * cos1)
    np.testing.assert_allclose(f.transmittance_s, flow * abs(f.transmitted_s) ** 2, rtol=1e-10)
    np.testing.assert_allclose(f.transmittance_p, flow * abs(f.transmitted_p) ** 2, rtol=1e-10)
    np.testing.assert_allclose(f.reflectance_s + f.transmittance_s, 1, rtol=1e-12)
    np.testing.assert_allclose(f.reflectance_p + f.transmittance_p, 1, rtol=1e-12)


def test_amplitudes_at_normal_incidence():
    f = interfaces.fresnel(3 * Z, -0.2 * Z, 1.0, 1.5)
    np.testing.assert_allclose([f.reflected_s, f.reflected_p], [-0.2, 0.2], rtol=1e-12)
    np.testing.assert_allclose([f.transmitted_s, f.transmitted_p], [0.8, 0.8], rtol=1e-12)


@pytest.mark.parametrize("broken", [0 * Z, np.nan * Z, np.full(3, np.inf), [0, np.nan, 1.0]])
def test_rays_and_normals_that_are_none_give_nan(broken):
    good = np.array([0.6, 0.0, 0.8])
    assert np.isnan(interfaces.reflect_directions(good, np.asarray(broken))).all()
    if np.any(np.isnan(broken) | np.isinf(broken)):
        assert np.isnan(interfaces.reflect_directions(np.asarray(broken), good)).all()
    for direction, normal in ((broken, good), (good, broken)):
        direction, normal = np.stack([np.asarray(direction, float), good]), np.stack([np.asarray(normal, float), Z])
        out, status = interfaces.refract_directions(direction, normal, 1.0, 1.5)
        assert np.isnan(out[0]).all() and np.isfinite(out[1]).all()
        assert status.tolist() == [MISS, HIT]
        f = interfaces.fresnel(direction, normal, 1.0, 1.5)
        assert all(np.isnan(value[0]) and np.isfinite(value[1]) for value in f)


@pytest.mark.parametrize("length", [1e-6, 0.1, 7.0, 1e6])
def test_lengths_of_normals_do_not_matter(length):
    direction = np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(interfaces.reflect_directions(direction, length * Z), [0.6, 0, -0.8], rtol=1e-12)
    out, _ = interfaces.refract_directions(direction, length * Z, 1.0, 1.5)
    np.testing.assert_allclose(out, [0.4, 0, np.sqrt(0.84)], rtol=1e-12)
    out, _ = interfaces.refract_directions(length * direction, Z, 1.0, 1.5)
    np.testing.assert_allclose(out / length, [0.4, 0, np.sqrt(0.84)], rtol=1e-12)


@pytest.mark.parametrize("huge", [1e160, 1e200])
def test_normals_whose_square_overflows_are_none(huge):
    direction = np.array([0.6, 0.0, 0.8])
    assert np.isnan(interfaces.reflect_directions(direction, huge * Z)).all()
    out, status = interfaces.refract_directions(direction, huge * Z, 1.0, 1.5)
    assert np.isnan(out).all() and status == MISS
    out, status = interfaces.refract_directions(huge * direction, Z, 1.0, 1.5)
    assert np.isnan(out).all() and status == MISS


@pytest.mark.parametrize("sign", [1, -1])
def test_quotients_that_overflow_give_nan(sign):
    assert np.isnan(interfaces.reflect_directions(sign * 1e200 * Z, 1e-150 * Z)).all()


@pytest.mark.parametrize("sign", [1, -1])
def test_grazing_rays_stay_on_their_way(sign):
    out, _ = interfaces.refract_directions(np.array([1.0, 0, sign * 1e-4]), Z, 1.0, 2.0)
    np.testing.assert_allclose(out, [0.5, 0, sign * np.sqrt(0.75)], rtol=1e-7)


@pytest.mark.parametrize("library", [np.asarray, torch.from_numpy], ids=["numpy", "torch"])
def test_large_batches_broadcast_like_small_ones(library, random):
    count = 70_000
    directions, normals = (random.normal(size=(count, 3)) for _ in range(2))
    n1, n2 = (random.uniform(1.0, 1.2, size=count) for _ in range(2))
    last = slice(count - 50, None)
    for one in range(5):  # that all rays share
        arrays = [directions, normals, n1, n2]
        parts = [array[last] for array in arrays]
        if one < 4:
            arrays[one] = parts[one] = arrays[one][0]
        arrays, parts = ([library(np.asarray(array)) for array in group] for group in (arrays, parts))
        found, status = interfaces.refract_directions(*arrays)
        expected, expected_status = interfaces.refract_directions(*parts)
        assert tuple(found.shape) == (count, 3) and tuple(status.shape) == (count,)
        np.testing.assert_allclose(found[last], expected, rtol=1e-12)
        np.testing.assert_array_equal(status[last], expected_status)
        found, expected = interfaces.reflect_directions(*arrays[:2]), interfaces.reflect_directions(*parts[:2])
        np.testing.assert_allclose(found[last], expected, rtol=1e-12)


def test_critical_angle_itself_goes_through_along_surface():
    out, status = interfaces.refract_directions(np.array([4.0, 0, 3]), Z, 1.25, 1.0)
    assert status == HIT
    np.testing.assert_allclose(out, [5, 0, 0], atol=1e-12)
    out, status = interfaces.refract_directions(np.array([4.001, 0, 3]), Z, 1.25, 1.0)
    assert status == REFLECTED and np.isnan(out).all()


def test_normal_incidence_goes_through_into_either_medium():
    for n1, n2 in ((1.0, 1.5), (1.5, 1.0), (1.5, 1.5)):
        for sign in (1, -1):
            out, status = interfaces.refract_directions(Z, sign * Z, n1, n2)
            assert status == HIT
            np.testing.assert_allclose(out, Z, atol=1e-15)


def test_rays_in_the_surface():
    for ratio in (1.0, 1.2, 3.0):
        assert interfaces.refract_directions(X, Z, ratio, 1.0)[1] == REFLECTED
    out, status = interfaces.refract_directions(X, Z, 1.0, 2.0)
    assert status == HIT
    np.testing.assert_allclose(out, [0.5, 0, np.sqrt(0.75)])
    # All products are −0 here: still towards the normal.
    out, status = interfaces.refract_directions(X, np.array([-0.0, -1.0, -0.0]), 1.0, 2.0)
    np.testing.assert_allclose(out, [0.5, -np.sqrt(0.75), 0])


def test_lost_rays_leave_the_gradients_of_the_others_alone():
    direction = torch.tensor([[0.6, 0.0, 0.8], [0.8, 0.0, 0.6], [0.0, 0.0, 0.0], [torch.nan, 0, 1]]).double()
    direction.requires_grad_()
    normal = torch.tensor([0.0, 0.0, 1.0]).double().expand(4, 3)
    out, status = interfaces.refract_directions(direction, normal, 1.5, 1.0)
    assert status.tolist() == [HIT, REFLECTED, MISS, MISS]
    out[0].sum().backward()
    assert direction.grad.isfinite().all() and direction.grad[0].abs().max() > 0
    assert (direction.grad[1:] == 0).all()
    direction.grad = None
    interfaces.reflect_directions(direction, normal)[:2].sum().backward()
    np.testing.assert_allclose(direction.grad, [[1, 1, -1], [1, 1, -1], [0, 0, 0], [0, 0, 0]], atol=1e-15)


def test_normals_that_are_none_leave_gradients_of_others_alone():
    normal = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 0.0]]).double().requires_grad_()
    direction = torch.tensor([0.6, 0.0, 0.8]).double()
    out = interfaces.reflect_directions(direction, normal)
    assert out[1].isnan().all()
    out[0].sum().backward()
    assert normal.grad[0].abs().max() > 0 and (normal.grad[1] == 0).all()


FACES = pytest.mark.parametrize("face", [rt, learn], ids=["numpy", "torch"])


def of(face, values):
    return np.asarray(values, dtype=float) if face is rt else torch.as_tensor(np.asarray(values, dtype=float))


@FACES
def test_many_normals_of_triangles_are_those_of_each(face, random):
    triangles = of(face, random.normal(size=(5, 3, 3)))
    many = face.get_triangle_normal(triangles)
    assert many.shape == (5, 2, 3)
    for i in range(5):
        np.testing.assert_allclose(many[i], face.get_triangle_normal(triangles[i]).reshape(2, 3), rtol=1e-12)


def test_many_points_of_spheres_and_cylinders_are_each_their_own(random):
    points = random.normal(size=(4, 3))
    sphere, cylinder = np.array([0.1, 0.2, 0.3, 2.0]), rt.define_cylinder([0, 0, 0], 2)
    for function, surface in ((rt.get_sphere_normal, sphere), (rt.get_cylinder_normal, cylinder)):
        many = function(points, surface)
        assert many.shape == (4, 2, 3)
        for i in range(4):
            np.testing.assert_allclose(many[i], function(points[i], surface), rtol=1e-12)


@FACES
def test_many_rays_and_normals_are_each_their_own(face, random):
    rays, normals = of(face, random.normal(size=(4, 2, 3))), of(face, random.normal(size=(4, 2, 3)))
    reflected, refracted = face.reflect(rays, normals), face.refract(rays, normals, 1.0, 1.5)
    assert tuple(reflected.shape) == tuple(refracted.shape) == (4, 2, 3)
    for i in range(4):
        np.testing.assert_allclose(reflected[i], face.reflect(rays[i], normals[i]).reshape(2, 3), rtol=1e-12)
        np.testing.assert_allclose(refracted[i], face.refract(rays[i], normals[i], 1.0, 1.5).reshape(2, 3), rtol=1e-12)


@FACES
def test_the_rim_belongs_to_the_circle(face):
    circle = face.define_circle(of(face, [0, 0, 5]), 3.0, [0.0, 0.0, 0.0])
    starts = of(face, [[0, 3, 0], [0, 2.9, 0], [0, 3.1, 0], [0, 5.9, 0]])
    rays = of(face, [[s, [0, 0, 1]] for s in starts.tolist()])
    _, distance = face.intersect_w_circle(rays, circle)
    np.testing.assert_allclose(distance.reshape(-1), [5, 5, 0, 0], atol=1e-12)


@FACES
def test_one_ray_gives_one_normal_and_a_batch_of_one_a_batch(face):
    circle = face.define_circle(of(face, [0, 0, 5]), 2.0, [0.0, 0.0, 0.0])
    ray = of(face, [0 * Z, Z])
    one, _ = face.intersect_w_circle(ray, circle)
    assert one.shape == (2, 3)
    np.testing.assert_allclose(one, [[0, 0, 5], [0, 0, 1]], atol=1e-12)
    assert face.intersect_w_circle(ray[None], circle)[0].shape == (1, 2, 3)


def test_distances_to_triangles_have_no_sign():
    triangle = [[-9, -9, -4], [9, -9, -4], [0, 9, -4]]
    rays = rt.create_ray_from_two_points([[0, 0, 0], [0, 0, -9]], [[0, 0, 1], [0, 0, -8]])
    np.testing.assert_allclose(rt.intersect_w_triangle(rays, triangle)[1], [4, 5])


def test_rays_go_on_from_where_the_normal_stands(random):
    rays, normals = random.normal(size=(4, 2, 3)), random.normal(size=(4, 2, 3))
    np.testing.assert_array_equal(rt.reflect(rays, normals)[:, 0], normals[:, 0])
    np.testing.assert_array_equal(rt.refract(rays, normals, 1.0, 1.5)[:, 0], normals[:, 0])


@FACES
def test_normals_of_triangles_stand_at_their_centres(face, random):
    triangles = of(face, random.normal(size=(4, 3, 3)))
    np.testing.assert_allclose(face.get_triangle_normal(triangles)[:, 0], triangles.mean(axis=1), rtol=1e-12)
    np.testing.assert_array_equal(face.get_triangle_normal(triangles[0], of(face, [1, 2, 3]))[0], [1, 2, 3])


def test_normals_of_cylinders_stand_on_their_axes():
    cylinder = rt.define_cylinder([1, 2, 3], 2.0, [90, 0, 0])  # along y
    normal = rt.get_cylinder_normal([[3, 7, 3], [1, -4, 1]], cylinder)
    np.testing.assert_allclose(normal, [[[1, 7, 3], [1, 0, 0]], [[1, -4, 3], [0, 0, -1]]], atol=1e-12)


def test_metals_are_the_same_on_both_faces(random):
    rays, normals = random.normal(size=(2, 4, 2, 3))
    n1, n2 = np.linspace(1.0, 1.3, 4), 0.2 + 3.4j + np.arange(4)
    for first, second in ((1.0, 0.2 + 3.4j), (n1.tolist(), 1.5), (n1, n2)):
        expected = rt.fresnel_coefficients(rays, normals, first, second)
        tensors = (torch.as_tensor(value) if isinstance(value, np.ndarray) else value for value in (first, second))
        found = learn.fresnel_coefficients(of(learn, rays), of(learn, normals), *tensors)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)


def test_normals_of_spheres_point_to_their_centre():
    normal = learn.get_sphere_normal_torch(
        torch.tensor([[4.0, 2.0, 3.0], [1.0, 2.0, 0.0]]), torch.tensor([1.0, 2, 3, 3])
    )
    np.testing.assert_allclose(normal, [[[4, 2, 3], [-1, 0, 0]], [[1, 2, 0], [0, 0, 1]]])


def test_one_ray_meets_many_spheres():
    spheres = torch.tensor([[0.0, 0, 5, 1], [0, 0, 9, 2], [0, 4, 9, 1]])
    rays, normals, distance, check = learn.intersect_w_sphere(torch.tensor([[[0.0, 0, 0], [0, 0, 1]]]), spheres)
    np.testing.assert_allclose(distance, [4, 7, np.nan])
    assert check.tolist() == [True, True, False]
    np.testing.assert_allclose(rays[:, 0], [[0, 0, 4], [0, 0, 7]])
    np.testing.assert_allclose(normals[:, 0], [[0, 0, 5], [0, 0, 9]])


def test_batches_of_one_give_one_ray(random):
    rays, triangle, point = random.normal(size=(1, 2, 3)), random.normal(size=(1, 3, 3)), random.normal(size=(1, 3))
    cylinder = rt.define_cylinder([0, 0, 0], 2)
    for one, batch in (
        (rt.reflect(rays[0], rays[0]), rt.reflect(rays, rays)),
        (rt.refract(rays[0], rays[0], 1.0, 1.5), rt.refract(rays, rays, 1.0, 1.5)),
        (rt.get_triangle_normal(triangle[0]), rt.get_triangle_normal(triangle)),
        (rt.get_sphere_normal(point[0], [0, 0, 0, 2]), rt.get_sphere_normal(point, [0, 0, 0, 2])),
        (rt.get_cylinder_normal(point[0], cylinder), rt.get_cylinder_normal(point, cylinder)),
    ):
        assert batch.shape == (2, 3)
        np.testing.assert_array_equal(batch, one)


def test_triangles_are_met_alike_on_both_faces(random):
    starts, triangle = random.normal(size=(30, 3)), np.asarray([[-2.0, -1, 5], [2, -1, 6], [0, 2, 5]])
    rays = rt.create_ray_from_two_points(starts, random.normal([0, 0, 5], size=(30, 3)))
    plane, length = rt.intersect_w_surface(rays, triangle)
    inside = np.isfinite(rt.intersect_w_triangle(rays, triangle)[0][:, 1, 0])
    assert 5 < inside.sum() < 25
    normal, distance, hits, normals, check = learn.intersect_w_triangle(of(learn, rays), of(learn, triangle))
    np.testing.assert_allclose(normal, plane, atol=1e-12)
    np.testing.assert_allclose(abs(distance[:, 0]), length, atol=1e-12)
    np.testing.assert_array_equal(check[0], inside)
    np.testing.assert_array_equal(hits, rays[inside])
    np.testing.assert_allclose(normals, plane[inside], atol=1e-12)


def test_polynomial_phases_of_any_radius_and_length():
    """Against the polynomial written out; the power along an axis is −λ times the second derivative there."""
    radius, order, scale = 1.7, 2, 2 / (2 * np.pi)
    phase = interfaces.PolynomialPhase([0.3, -0.2, 0.7, 0.4, -0.5, 0.11], radius, order)
    x, y = np.array([0.4, -1.1]), np.array([0.9, 0.3])
    u, v = x / radius, y / radius
    expected = (
        scale * (0.3 * u - 0.2 * v + 0.7 * u**2 + 0.4 * u * v - 0.5 * v**2 + 0.11 * u**3),
        scale / radius * (0.3 + 1.4 * u + 0.4 * v + 0.33 * u**2),
        scale / radius * (-0.2 + 0.4 * u - 1.0 * v),
    )
    for found, exact in zip(phase.cycles(x, y), expected, strict=True):
        np.testing.assert_allclose(found, exact, rtol=1e-13)
    bend = scale / radius**2
    np.testing.assert_allclose(phase.powers(5e-4), [-5e-4 * 1.4 * bend, 5e-4 * bend], rtol=1e-13)
    short = interfaces.PolynomialPhase([0, 0, 0.7], radius, order)
    np.testing.assert_allclose(short.curvatures(), [1.4 * bend, 0], rtol=1e-13)


def test_curvatures_and_cover_of_sampled_phases():
    """The second difference at the vertex of a·x² + b·x³ is 2·a whatever b is, and elsewhere it is not."""
    pitch, places = 0.1, (np.arange(13) - 6) * 0.1
    phase = 0.8 * places**2 + 0.9 * places**3 - 0.3 * places[:, None] ** 2
    sampled = interfaces.HologramPhase(phase, pitch)
    np.testing.assert_allclose(sampled.curvatures(), np.array([1.6, -0.6]) / (2 * np.pi), rtol=1e-12)
    ends = np.array([-0.51, -0.5, 0.5, 0.51])
    for x, y in ((ends, 0 * ends), (0 * ends, ends)):
        assert sampled.covers(x, y).tolist() == [False, True, True, False]


def test_holograms_with_more_columns_than_rows(random):
    """A quadratic phase, wrapped: cubic convolution interpolates it exactly, rays beyond its samples are vignetted."""
    rows, columns, pitch = 12, 30, 0.3
    y, x = np.meshgrid(
        (np.arange(rows) - rows // 2) * pitch, (np.arange(columns) - columns // 2) * pitch, indexing="ij"
    )

    def cycles(x, y):
        return 0.05 * x**2 - 0.08 * x * y + 0.11 * y**2 + 0.3 * x - 0.2 * y

    held = interfaces.HologramPhase(2 * np.pi * (cycles(x, y) % 1), pitch, order=2.0)
    across, down = random.uniform(-3.9, 3.6, 50), random.uniform(-1.4, 1.2, 50)
    value, along_x, along_y = held.cycles(across, down)
    turns = value / 2 - cycles(across, down)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    np.testing.assert_allclose(along_x, 2 * (0.1 * across - 0.08 * down + 0.3), atol=1e-12)
    np.testing.assert_allclose(along_y, 2 * (0.22 * down - 0.08 * across - 0.2), atol=1e-12)
    np.testing.assert_allclose(held.curvatures(), [0.2, 0.44], atol=1e-12)
    places = np.asarray([-4.3, -4.1, 3.8, 4.0]), np.asarray([-1.6, -1.4, 1.1, 1.3])
    assert held.covers(places[0], np.zeros(4)).tolist() == [False, True, True, False]
    assert held.covers(np.zeros(4), places[1]).tolist() == [False, True, True, False]


@pytest.mark.parametrize(
    "phase",
    [
        interfaces.RadialPhase([3.0, -0.2], 4.0, 2.0),
        interfaces.PolynomialPhase([0.3, -0.2, 1.5, 0.4, -0.7], 4.0, 2.0),
        interfaces.ZernikePhase([0.0, 0.2, -0.1, 0.4, 0.3, 0.5], 4.0, 2.0),
    ],
)
def test_powers_of_phases_are_second_derivatives(phase):
    step, zero, wavelength = 1e-3, np.zeros(2), 0.5
    ends = np.asarray([-step, step])
    along = np.diff(phase.cycles(ends, zero)[1])[0], np.diff(phase.cycles(zero, ends)[2])[0]
    np.testing.assert_allclose(phase.powers(wavelength), [-wavelength * one / (2 * step) for one in along], rtol=1e-5)


def test_ideal_lenses_have_one_power():
    assert interfaces.IdealLens(50.0).powers(0.5) == (0.02, 0.02)
