"""Rays, primitives and boundaries of the torch face: shapes, numbers, agreement with NumPy, gradients."""

import numpy as np
import pytest
import torch

import odak.raytracing as core
from odak.learn import raytracing as rt
from odak.learn.tools import rotate_points

F64 = torch.float64


def random_rays(random, count=30, **options):
    ends = torch.from_numpy(random.normal(size=(2, count, 3)) * np.asarray([3.0, 1.0])[:, None, None])
    return rt.create_ray_from_two_points(ends[0], ends[1]).requires_grad_(**options)


def test_create_ray():
    assert rt.create_ray(torch.zeros(3), torch.tensor([[90.0, 90.0, 0.0]] * 5)).shape == (5, 2, 3)
    assert rt.create_ray(torch.zeros(5, 3), torch.zeros(3), direction=True).shape == (5, 2, 3)
    ray = rt.create_ray(torch.zeros(3, dtype=F64), [90, 60, 30])
    assert ray.shape == (1, 2, 3) and ray.dtype == F64
    np.testing.assert_allclose(ray[0, 1], [0, 0.5, 0.75**0.5], atol=1e-15)


def test_all_pairs_are_start_major():
    start, end = torch.eye(3), torch.tensor([[0.0, 0, 5], [1, 0, 0]])
    rays = rt.create_ray_from_all_pairs(start, end)
    np.testing.assert_allclose(rays[3], rt.create_ray_from_two_points(start[1], end[1])[0])
    assert rays[1, 1].isnan().all()


def test_propagation_keeps_directions():
    ray = rt.create_ray_from_two_points(torch.zeros(3), torch.tensor([[0.0, 3, 4], [0, 0, 1]]))
    for distance in (5, torch.tensor(5.0), torch.tensor([5.0]), torch.full((2, 1), 5.0), torch.full((1, 2), 5.0)):
        moved = rt.propagate_ray(ray, distance)
        np.testing.assert_allclose(moved[:, 0], [[0, 3, 4], [0, 0, 5]])
        np.testing.assert_allclose(moved[:, 1], ray[:, 1])
    assert rt.propagate_a_ray(ray[0], torch.arange(4.0)).shape == (4, 2, 3)
    points = rt.get_points_along_a_ray_segment(ray=ray[:1], distances=torch.arange(3.0))
    np.testing.assert_allclose(points[2], [0, 1.2, 1.6])
    assert rt.get_points_along_a_ray_segment(ray, torch.arange(3.0)).shape == (2, 3, 3)


@pytest.mark.parametrize("limit", [15.0, 90.0, 180.0, 1e-3])
def test_sources_fill_their_cone_evenly(limit):
    tilt = torch.tensor([30.0, 0.0, 0.0], dtype=F64)
    rays = rt.create_ray_from_point_w_luminous_angle(torch.zeros(3, dtype=F64), 4000, tilt, limit, seed=1)
    axis = rotate_points(torch.tensor([[0.0, 0, 1]], dtype=F64), tilt)[0][0]
    off_axis = torch.linalg.vector_norm(torch.linalg.cross(rays[:, 1], axis.expand(4000, 3)), dim=-1)
    angle = torch.atan2(off_axis, rays[:, 1] @ axis)
    assert torch.rad2deg(angle).max() <= limit * (1 + 1e-9)
    # Uniform in solid angle: (1 − cos θ)/(1 − cos α) is uniform in 0 … 1.
    share = torch.sin(angle / 2) ** 2 / np.sin(np.deg2rad(limit) / 2) ** 2
    np.testing.assert_allclose(share.sort().values, np.linspace(0, 1, 4000), atol=0.04)


def test_grid_source_repeats_its_lights():
    arguments = {"center": torch.tensor([0, 0, 1]), "size": [2, 4], "no": [2, 3], "tilt": torch.tensor([0, 0, 0])}
    rays = rt.create_ray_from_grid_w_luminous_angle(**arguments, num_ray_per_light=4, angle_limit=15, seed=3)
    assert rays.shape == (24, 2, 3)
    np.testing.assert_allclose(rays[:3, 0], [[-1, -2, 1], [-1, 0, 1], [-1, 2, 1]])
    np.testing.assert_allclose(rays[6:12, 0], rays[:6, 0])
    again = rt.create_ray_from_grid_w_luminous_angle(**arguments, num_ray_per_light=4, angle_limit=15, seed=3)
    assert torch.equal(rays, again)
    with pytest.raises(ValueError, match="angle_limit must lie within 0 … 180"):
        rt.create_ray_from_grid_w_luminous_angle(**arguments, num_ray_per_light=4, angle_limit=181)


def test_plane_mesh_tiles_its_rectangle():
    mesh = rt.define_plane_mesh([3, 4], [2.0, 1.0], torch.tensor([0.0, 0, 90]), torch.tensor([[0.0, 0, 5]]))
    assert mesh.shape == (24, 3, 3)
    areas = torch.linalg.cross(mesh[:, 1] - mesh[:, 0], mesh[:, 2] - mesh[:, 0]).norm(dim=-1) / 2
    np.testing.assert_allclose(areas, 2 / 24, rtol=1e-5)
    np.testing.assert_allclose(mesh.amin((0, 1)), [-0.5, -1, 5], atol=1e-6)
    np.testing.assert_allclose(mesh.amax((0, 1)), [0.5, 1, 5], atol=1e-6)
    assert rt.define_plane_mesh([1, 2], offset=torch.rand(4, 3)).shape == (4, 3, 3)


@pytest.mark.parametrize(
    ("center", "radius", "count"),
    [((3,), (1,), 1), ((1, 3), (1, 1), 1), ((4, 3), (4,), 4), ((4, 3), (1,), 4), ((3,), (4, 1), 4)],
)
def test_sphere_sizes(center, radius, count):
    assert rt.define_sphere(torch.zeros(center), torch.ones(radius)).shape == (count, 4)


def test_membership():
    corners = torch.tensor([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]], dtype=F64)
    middles = torch.stack([(corners[a] + corners[b]) / 2 for a, b in ((1, 2), (0, 1), (0, 2))])
    inside = rt.is_it_on_triangle(torch.cat((corners, middles)), corners)
    assert inside.tolist() == [[True, False, False, False, True, True]]
    points = torch.tensor([[1.0, 1, 7], [float("nan"), 0, 0], [9, 9, 0]], dtype=F64)
    many = rt.is_it_on_triangle(points, torch.stack((corners, corners + 8, 0 * corners)))
    assert many.tolist() == [[True, False, False], [False, False, True], [False, False, False]]
    batch = rt.is_it_on_triangle_batch(torch.stack((points, points)), torch.stack((corners, corners + 8)))
    assert batch.tolist() == many[:2].tolist()


def test_batches_of_triangles_drop_the_unhit():
    ray = rt.create_ray_from_two_points(torch.zeros(3), torch.tensor([[0.1, 0.1, 5.0], [3, 3, 5], [0.2, 0.1, 5]]))
    triangle = torch.tensor([[0.0, 0, 5], [1, 0, 5], [0, 1, 5]])
    triangles = torch.stack((triangle, triangle + 50, triangle * 2))
    normal, distance, rays, normals, check = rt.intersect_w_triangle_batch(ray, triangles)
    assert normal.shape == (3, 3, 2, 3) and check.shape == (3, 3)
    assert [len(d) for d in distance] == [2, 2] == [len(r) for r in rays] == [len(n) for n in normals]
    one = rt.intersect_w_triangle(ray, triangle)
    assert [v.shape for v in one] == [(3, 2, 3), (3, 1), (2, 2, 3), (2, 2, 3), (1, 3)]
    np.testing.assert_allclose(distance[0], one[1][one[4][0], 0])
    normal, distance = rt.intersect_w_surface_batch(ray, triangles)
    assert normal.shape == (3, 3, 2, 3) and distance.shape == (3, 3)
    behind = rt.intersect_w_surface(torch.tensor([[0.0, 0, 20], [0, 0.6, 0.8]]), triangle * 2)
    np.testing.assert_allclose(behind[1], [[-12.5]])


def test_sphere_keeps_order_and_reports_misses():
    rays = torch.tensor(
        [[[0.0, 0, 0], [0, 0, 1]], [[9, 0, 0], [0, 0, 1]], [[0, 0, 5], [1, 0, 0]], [[0, 0, 20], [0, 0, 1]]]
    )
    sphere = rt.define_sphere(torch.tensor([[0.0, 0, 5]]), torch.tensor([[3.0]]))
    hits, normals, distance, check = rt.intersect_w_sphere(rays, sphere, learning_rate=1, number_of_steps=1)
    assert check.tolist() == [True, False, True, False]
    np.testing.assert_allclose(distance, [2, np.nan, 3, np.nan])
    np.testing.assert_allclose(hits, [[[0, 0, 2], [0, 0, 1]], [[3, 0, 5], [1, 0, 0]]])
    np.testing.assert_allclose(normals, [[[0, 0, 5], [0, 0, -1]], [[0, 0, 5], [1, 0, 0]]])


def test_faces_agree(random):
    rays, other = random_rays(random).detach(), random_rays(random).detach()
    triangle = torch.from_numpy(random.normal(size=(3, 3)))
    sphere = np.asarray([0.1, 0.2, 0.3, 1.5])
    array = rays.numpy()
    pairs = [
        (rt.reflect(rays, other), core.reflect(array, other.numpy())),
        (rt.refract(rays, other, 1.0, 1.5), core.refract(array, other.numpy(), 1.0, 1.5)),
        (rt.refract(rays, other, 1.5, 1.0), core.refract(array, other.numpy(), 1.5, 1.0)),
        (rt.intersect_w_surface(rays, triangle)[0], core.intersect_w_surface(array, triangle.numpy())[0]),
        (rt.intersect_w_sphere(rays, sphere)[2], core.intersect_w_sphere(array, sphere)[1]),
        (rt.get_triangle_normal(triangle), core.get_triangle_normal(triangle.numpy())),
        (rt.define_plane([1, 2, 3], torch.tensor([10, 20, 30], dtype=F64)), core.define_plane([1, 2, 3], [10, 20, 30])),
        *zip(
            rt.fresnel_coefficients(rays, other, 1.0, 1.5),
            core.fresnel_coefficients(array, other.numpy(), 1.0, 1.5),
            strict=True,
        ),
    ]
    for tensor, expected in pairs:
        np.testing.assert_allclose(tensor.numpy(), expected, rtol=1e-10, atol=1e-10)


def test_everything_is_differentiable(random):
    rays, normals = random_rays(random, 4), random_rays(random, 4)
    n1, n2 = (torch.tensor(v, dtype=F64, requires_grad=True) for v in (1.0, 1.5))
    triangle = torch.from_numpy(random.normal(size=(3, 3))).requires_grad_()
    sphere = torch.tensor([[0.1, 0.2, 0.3, 1.5]], dtype=F64, requires_grad=True)
    angles = torch.tensor([10.0, 20, 30], dtype=F64, requires_grad=True)

    def sphere_values(r, s):
        return torch.cat([v.nan_to_num().flatten() for v in rt.intersect_w_sphere(r, s)[:3]])

    cases = [
        (rt.reflect, (rays, normals)),
        (rt.refract, (rays, normals, n1, n2)),
        (lambda r, t: rt.intersect_w_surface(r, t), (rays, triangle)),
        (sphere_values, (rays, sphere)),
        (lambda p, a: rt.define_plane(p, a), (torch.ones(3, dtype=F64, requires_grad=True), angles)),
        (lambda *a: rt.fresnel_coefficients(*a)[4:], (rays, normals, n1, n2)),
        (rt.create_ray_from_two_points, (torch.rand(3, 3, dtype=F64, requires_grad=True), triangle)),
    ]
    for function, arguments in cases:
        assert torch.autograd.gradcheck(function, arguments, fast_mode=True)


def test_lost_rays_leave_no_nan_in_gradients():
    n = torch.tensor(1.5, dtype=F64, requires_grad=True)
    sphere = torch.tensor([[0.0, 0, 5, 3]], dtype=F64, requires_grad=True)
    rays = [[[0, 0, 0], [0, 0.1, 1]], [[0, 50, 0], [0, 0, 1]], [[0, 2.9, 0], [0, 0, 1]], [[0, np.nan, 0], [0, 0, 1]]]
    rays = torch.tensor(rays, dtype=F64, requires_grad=True)
    hit = rt.intersect_w_sphere(rays, sphere)
    inside = rt.refract(hit[0], hit[1], 1.0, n)
    inside = rt.propagate_ray(inside, 0.5)
    out = rt.refract(inside, rt.create_ray(torch.zeros(3, dtype=F64), [0.0, 1.0, 0.2], direction=True), n, 1.0)
    (out.nan_to_num().sum() + hit[2].nansum()).backward()
    assert n.grad.isfinite() and sphere.grad.isfinite().all() and rays.grad.isfinite().all()
    assert (rays.grad[[1, 3]] == 0).all() and (rays.grad[0] != 0).any()


def test_precision_and_device_follow(random):
    single, double = torch.rand(4, 2, 3), torch.rand(4, 2, 3, dtype=F64)
    assert rt.reflect(single, double).dtype == F64
    assert rt.reflect(single, single).dtype == torch.float32
    assert rt.intersect_w_surface(single, np.eye(3).tolist())[1].dtype == torch.float32
    ray = double.to("meta")
    assert rt.intersect_w_surface(ray, torch.eye(3))[0].device.type == "meta"
    assert rt.define_plane(torch.zeros(3, device="meta")).device.type == "meta"
    with pytest.raises(TypeError, match="sphere must be real numbers"):
        rt.intersect_w_sphere(single, torch.ones(4, dtype=torch.complex64))
    with pytest.raises(ValueError, match=r"ray must be \[2, 3\]"):
        rt.propagate_ray(torch.zeros(3), 1.0)
    with pytest.raises(ValueError, match=r"sphere must be one or one for each of the rays \[4\], got"):
        rt.intersect_w_sphere(single, torch.ones(3, 4))


def test_empty_batches():
    empty, normal = torch.zeros(0, 2, 3), torch.ones(1, 2, 3)
    assert rt.reflect(empty, normal).shape == (0, 2, 3)
    assert rt.refract(empty, normal, 1.0, 1.5).shape == (0, 2, 3)
    assert rt.intersect_w_sphere(empty, torch.ones(4))[0].shape == (0, 2, 3)
    assert rt.intersect_w_triangle(empty, torch.eye(3))[1].shape == (0, 1)


def test_a_mirror_learns_its_tilt():
    triangle = torch.tensor([[-5.0, -5, 10], [5, -5, 10], [0, 5, 10]])
    angles = torch.zeros(1, 3, requires_grad=True)
    rays = rt.create_ray_from_two_points(torch.zeros(3), rt.center_of_triangle(triangle))
    screen, target = rt.define_plane(torch.zeros(3))[None], torch.tensor([[1.0, -2.0, 0.0]])
    optimizer = torch.optim.Adam([angles], lr=0.2)
    for _ in range(120):
        optimizer.zero_grad()
        turned = rotate_points(triangle, angles=angles, origin=rt.center_of_triangle(triangle))[0]
        _, _, hits, normals, check = rt.intersect_w_triangle(rays, turned)
        assert check.shape == (1, 1)
        landed = rt.intersect_w_surface(rt.reflect(hits, normals), screen)[0][:, 0]
        loss = (landed - target).square().mean()
        loss.backward()
        optimizer.step()
    assert loss < 1e-2


def test_lines_that_hold_no_number_do_not_cross_at_one():
    ray0 = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    ray1 = torch.tensor([[[3.0, -7.0, 0.0], [0.0, 1.0, 0.0]]] * 2)
    ray1[0, 0, 1] = torch.nan
    for face in (rt, core):
        given = (ray0, ray1) if face is rt else (ray0.numpy(), ray1.numpy())
        points, distances = (torch.as_tensor(value) for value in face.calculate_intersection_of_two_rays(*given))
        assert points[0].isnan().any()
        assert distances[0].isnan().all()
        assert distances[1].tolist() == [3.0, 7.0]


def test_spheres_and_points_that_are_not_as_many_are_named():
    with pytest.raises(ValueError, match=r"point \[3, 3\], sphere \[2, 3\]"):
        rt.get_sphere_normal_torch(torch.ones(3, 3), torch.ones(2, 4))
