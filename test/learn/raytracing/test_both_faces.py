"""Functions for NumPy and for PyTorch have the same names and give the same values."""

import numpy as np
import pytest
import torch

import odak.learn.raytracing as learn
import odak.raytracing as core
from odak.learn.raytracing import intersect_parametric, sphere_function

# What one face has alone, and why.
CORE_ALONE = {
    "get_sphere_normal": "get_sphere_normal_torch",
    "RayStatus": "an enumeration of numbers, the same for both",
    "intersection_kernel_for_parametric_surfaces": "a step of the search, which both share",
    "propagate_parametric_intersection_error": "a step of the search, which both share",
}
SCENES = [
    "Element",
    "GaussianScatter",
    "Interface",
    "LambertianScatter",
    "Light",
    "MeasuredScatter",
    "Received",
    "RayScene",
    "SceneLight",
    "light_source",
    "system_elements",
]
LEARN_ALONE = dict.fromkeys(SCENES, "scenes have gradients") | {
    "create_ray_from_grid_w_luminous_angle": "torch's random numbers",
    "create_ray_from_point_w_luminous_angle": "torch's random numbers",
    "define_plane_mesh": "meshes are learned",
    "detector": "a detector of gradients; odak.catalog.plane_detector",
    "get_sphere_normal_torch": "get_sphere_normal",
    "intersect_w_surface_batch": "rays by surfaces; the core's arrays broadcast",
    "intersect_w_triangle_batch": "rays by surfaces; the core's arrays broadcast",
    "is_it_on_triangle_batch": "rays by surfaces; the core's arrays broadcast",
    "MeshHit": "meshes are learned",
    "planar_mesh": "meshes are learned",
    "propagate_ray": "propagate_a_ray",
    "triangle_mesh": "meshes are learned",
}


def test_every_function_has_a_counterpart():
    ours, theirs = ({name for name in face.__all__ if callable(getattr(face, name))} for face in (learn, core))
    assert theirs - ours == set(CORE_ALONE)
    assert ours - theirs == set(LEARN_ALONE)


def cases(random):
    """Return arguments of each function of both faces, and what to take of its results."""
    rays = core.create_ray_from_two_points(random.normal(size=(7, 3)) * 4, random.normal(size=(7, 3)))
    other = core.create_ray_from_two_points(random.normal(size=(7, 3)) * 4, random.normal(size=(7, 3)))
    points, angles = random.normal(size=(7, 3)), random.uniform(-90, 90, size=3)
    triangle, sphere = random.normal(size=(3, 3)) * 3, np.asarray([0.1, -0.2, 0.3, 2.0])
    cylinder = core.define_cylinder([0.1, 0.2, -0.3], 1.5, angles)
    crossing = core.create_ray_from_two_points(points, rays[:, 0] + 2.0 * rays[:, 1])
    return {
        "bring_plane_to_origin": (points, None, [1, 1], points[0], angles),
        "calculate_intersection_of_two_rays": (rays, crossing),
        "center_of_triangle": (triangle,),
        "create_ray": (points, np.rad2deg(np.arccos(rays[:, 1]))),
        "create_ray_from_all_pairs": (points, points[:2] + 1),
        "create_ray_from_angles": (points, angles),
        "create_ray_from_two_points": (points, points[::-1] + 1),
        "cylinder_function": (points, cylinder),
        "define_cylinder": (points[0], 2.0, angles),
        "define_plane": (points[0], angles),
        "define_sphere": (points[0], 2.0),
        "find_nearest_points": (rays, other),
        "get_cylinder_normal": (points, cylinder),
        "get_points_along_a_ray_segment": (rays, np.linspace(0, 1, 4)),
        "get_triangle_normal": (triangle,),
        "intersect_w_circle": (rays, [triangle, triangle.mean(0), 2.0]),
        "propagate_a_ray": (rays, np.linspace(-1, 1, 7)),
        "reflect": (rays, other),
        "refract": (rays, other, 1.0, 1.4),
        "sphere_function": (points, sphere),
    }


def tensors(value):
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value.copy())
    return [tensors(item) for item in value] if isinstance(value, list) else value


@pytest.mark.parametrize("name", sorted(cases(np.random.default_rng(0))))
def test_counterparts_agree(name):
    arguments = cases(np.random.default_rng(1))[name]
    ours, theirs = getattr(learn, name)(*map(tensors, arguments)), getattr(core, name)(*arguments)
    results = (ours, theirs) if isinstance(ours, tuple) else ((ours,), (theirs,))
    for a, b in zip(*results, strict=True):
        b = np.asarray(b)
        assert a.dtype == torch.float64 and bool(a.isfinite().any())
        np.testing.assert_allclose(a.detach().numpy().reshape(b.shape), b, atol=1e-10, rtol=0)


def test_curved_surfaces_agree():
    """Where the learnt face returns hits alone, and the core a row for every ray."""
    random = np.random.default_rng(2)
    ends = random.normal(size=(2, 60, 3)) * np.asarray([5.0, 1.5])[:, None, None]
    rays = core.create_ray_from_two_points(*ends)
    cylinder, sphere = core.define_cylinder([0.1, 0.2, -0.3], 1.0, [20, 30, 40]), np.asarray([0.1, -0.2, 0.3, 1.2])
    for name, shape in (("intersect_w_cylinder", cylinder), ("intersect_w_sphere", sphere)):
        normals, distances = getattr(core, name)(rays, shape)
        met, outward, distance, check = getattr(learn, name)(tensors(rays), tensors(shape))
        assert 5 < int(check.sum()) < 60
        np.testing.assert_array_equal(check.numpy(), np.isfinite(distances))
        np.testing.assert_allclose(distance, distances, atol=1e-10)
        turn = -1 if name == "intersect_w_sphere" else 1
        np.testing.assert_allclose(turn * outward[:, 1], normals[check.numpy(), 1], atol=1e-10)
        np.testing.assert_allclose(
            met[:, 0], rays[check.numpy(), 0] + distances[check.numpy(), None] * met[:, 1].numpy()
        )


def test_gradients_of_the_new_counterparts():
    random = np.random.default_rng(3)
    ends = random.normal(size=(2, 12, 3)) * np.asarray([5.0, 1.0])[:, None, None]
    rays = tensors(core.create_ray_from_two_points(*ends)).requires_grad_()
    cylinder = tensors(core.define_cylinder([0.1, 0.2, -0.3], 1.5, [20, 30, 40])).requires_grad_()
    check = learn.intersect_w_cylinder(rays, cylinder)[3]
    assert bool(check.any()) and not bool(check.all())

    def hits(rays, cylinder):
        met, normal, distance, check = learn.intersect_w_cylinder(rays, cylinder)
        return met, normal, distance[check]

    assert torch.autograd.gradcheck(hits, (rays, cylinder), atol=1e-5, fast_mode=True)
    distance = learn.intersect_w_cylinder(rays, cylinder)[2]
    found = torch.autograd.grad(torch.where(check, distance, 0.0).sum(), (rays, cylinder))
    assert all(bool(value.isfinite().all()) for value in found) and not bool(found[0][~check].any())
    other = rays.detach().flip(0).requires_grad_()
    assert torch.autograd.gradcheck(learn.find_nearest_points, (rays, other), atol=1e-5, fast_mode=True)
    angles = torch.tensor([10.0, 20.0, 30.0], dtype=torch.float64, requires_grad=True)
    point = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(learn.create_ray_from_angles, (point, angles), fast_mode=True)
    assert torch.autograd.gradcheck(lambda p, a: learn.define_cylinder(p, 2.0, a), (point, angles), fast_mode=True)


def test_surfaces_of_the_users_own():
    """A torus as a function of its radii: hits on it, gradients in rays and radii to second order, misses apart."""

    def torus(point, radii):
        around = point[:, :2].square().sum(-1).sqrt() - radii[0]
        return around.square() + point[:, 2].square() - radii[1] ** 2

    rays = torch.tensor(
        [[[2.0, 0, -5], [0, 0, 1]], [[0, 0, -5], [0, 0, 1]], [[-5.0, 0.1, 0.2], [1, 0, 0]]], dtype=torch.float64
    ).requires_grad_()
    radii = torch.tensor([2.0, 0.5], dtype=torch.float64, requires_grad=True)
    distance, normal = intersect_parametric(rays, radii, torus)
    np.testing.assert_allclose(distance[0].item(), 4.5, atol=1e-9)
    assert bool(distance[1].isnan()) and bool(normal[1].isnan().all())
    np.testing.assert_allclose(normal[0].detach(), [[2, 0, -0.5], [0, 0, -1]], atol=1e-9)

    def values(rays, radii):
        distance, normal = intersect_parametric(rays, radii, torus)
        return distance[[0, 2]], normal[[0, 2]]

    assert torch.autograd.gradcheck(values, (rays, radii), fast_mode=True)
    assert torch.autograd.gradgradcheck(lambda *a: values(*a)[0], (rays, radii), fast_mode=True)
    found = torch.autograd.grad(torch.where(distance.isnan(), 0.0, distance).sum(), (rays, radii))
    assert all(bool(value.isfinite().all()) for value in found)
    sphere = torch.tensor([0.0, 0.0, 0.0, 1.0])
    single, _ = intersect_parametric(rays.detach().float()[1:2], sphere, sphere_function)
    assert single.dtype == torch.float32 and float(single[0]) == pytest.approx(4.0, abs=1e-6)
    missed, none = intersect_parametric(torch.tensor([[9.0, 9, 9], [0, 0, 1]]), sphere, sphere_function)
    assert bool(missed.isnan().all()) and none.shape == (1, 2, 3)


def test_descartes_oval_images_a_point_to_a_point():
    """n₁|PA| + n₂|PB| = const: every ray from A is refracted to B, to 1e-9 of their distance; La Géométrie (1637)."""
    n1, n2 = 1.0, 1.5
    a, b = torch.tensor([[0.0, 0.0, -60.0], [0.0, 0.0, 100.0]], dtype=torch.float64)

    def oval(point, constant):
        return n1 * (point - a).norm(dim=-1) + n2 * (point - b).norm(dim=-1) - constant

    directions = torch.tensor([[0.0, t, 1.0] for t in (-0.25, -0.1, 0.0, 0.2, 0.3)], dtype=torch.float64)
    rays = learn.create_ray_from_two_points(a, a + directions)
    constant = torch.tensor(n1 * 60 + n2 * 100, dtype=torch.float64)
    distance, normal = intersect_parametric(rays, constant, oval)
    assert 59 < float(distance.min()) < float(distance.max()) < 80
    bent = learn.refract(rays, normal, n1, n2)
    nearest, _ = learn.find_nearest_points(bent, torch.stack((b, torch.eye(3, dtype=torch.float64)[2])))
    assert float((nearest - b).norm(dim=-1)[[0, 1, 3, 4]].max()) < 160e-9
    other = learn.refract(rays, normal, n1, 1.49)
    nearest, _ = learn.find_nearest_points(other, torch.stack((b, torch.eye(3, dtype=torch.float64)[2])))
    assert float((nearest - b).norm(dim=-1).max()) > 1


def test_shapes_that_do_not_match_are_named():
    with pytest.raises(ValueError, match=r"cylinder must be one or one for each of the rays \[3\], got \[2\]"):
        learn.intersect_w_cylinder(torch.ones(3, 2, 3), torch.ones(2, 7))
    with pytest.raises(ValueError, match=r"center \[3\], radius \[2\], rotation \[1\]"):
        learn.define_cylinder(torch.ones(3, 3), torch.ones(2))
    with pytest.raises(ValueError, match=r"center must be \[3\] or \[m, 3\], got \[2\]"):
        learn.bring_plane_to_origin(torch.ones(3), center=torch.ones(2))


def test_batches_of_any_rank_are_each_of_their_rays():
    """Rays ``[4, 5, 2, 3]`` give what the same rays give as ``[20, 2, 3]``."""
    torch.manual_seed(0)
    flat = learn.create_ray_from_two_points(3 * torch.randn(20, 3), torch.randn(20, 3))
    normals = learn.create_ray_from_two_points(torch.randn(20, 3), torch.randn(20, 3))
    triangles, sphere = 3 * torch.randn(2, 3, 3), torch.tensor([0.0, 0.0, 0.0, 1.5])
    cylinder = learn.define_cylinder(torch.zeros(3), 1.2)[0]
    circle = [triangles[0], triangles[0].mean(0), torch.tensor(2.0)]
    calls = {
        "reflect": lambda r, n: learn.reflect(r, n),
        "refract": lambda r, n: learn.refract(r, n, 1.0, 1.5),
        "fresnel": lambda r, n: learn.fresnel_coefficients(r, n, 1.0, 1.5),
        "surface": lambda r, n: learn.intersect_w_surface(r, triangles[0]),
        "circle": lambda r, n: learn.intersect_w_circle(r, circle),
        "triangle": lambda r, n: learn.intersect_w_triangle(r, triangles[0]),
        "sphere": lambda r, n: learn.intersect_w_sphere(r, sphere),
        "cylinder": lambda r, n: learn.intersect_w_cylinder(r, cylinder),
        "moved": lambda r, n: learn.propagate_ray(r, torch.ones(r.shape[:-2]) * 2.0),
        "points": lambda r, n: learn.get_points_along_a_ray_segment(r, torch.arange(3.0)),
        "crossing": lambda r, n: learn.calculate_intersection_of_two_rays(r, n),
        "nearest": lambda r, n: learn.find_nearest_points(r, n),
        "parametric": lambda r, n: intersect_parametric(r, sphere, sphere_function),
        "planes": lambda r, n: learn.intersect_w_surface_batch(r, triangles),
        "core nearest": lambda r, n: core.find_nearest_points(r.numpy(), n.numpy()),
        "core points": lambda r, n: core.get_points_along_a_ray_segment(r.numpy(), np.arange(3.0)),
    }
    for name, call in calls.items():
        ours, expected = call(flat.reshape(4, 5, 2, 3), normals.reshape(4, 5, 2, 3)), call(flat, normals)
        pairs = zip(ours, expected, strict=True) if isinstance(ours, tuple) else [(ours, expected)]
        for a, b in pairs:
            a, b = torch.as_tensor(a), torch.as_tensor(b)
            lead = 1 if name in ("planes", "triangle") and b.ndim and b.shape[0] in (1, 2) else 0
            assert a.shape[lead : lead + 2] == (4, 5) or a.shape == b.shape, name
            torch.testing.assert_close(a.reshape(b.shape), b, equal_nan=True)
