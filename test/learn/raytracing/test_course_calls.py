"""Documented calls of ray tracing run as written."""

import importlib

import numpy as np
import pytest
import torch

from odak.learn.raytracing import (
    create_ray,
    create_ray_from_all_pairs,
    create_ray_from_grid_w_luminous_angle,
    create_ray_from_point_w_luminous_angle,
    create_ray_from_two_points,
    define_circle,
    define_plane,
    define_sphere,
    get_points_along_a_ray_segment,
    intersect_w_circle,
    intersect_w_sphere,
    intersect_w_surface,
    intersect_w_triangle,
    intersect_w_triangle_batch,
    propagate_ray,
    reflect,
    refract,
)


def grid(count, extent, depth):
    """Return points of a square grid about (0, 0, depth), ``[count², 3]``."""
    line = torch.linspace(-extent / 2, extent / 2, count)
    return torch.cartesian_prod(line, line, torch.tensor([depth]))


@pytest.mark.parametrize(
    "name",
    [
        *(f"odak.learn.raytracing.{module}" for module in ("boundary", "primitives", "ray")),
        *(f"odak.raytracing.{module}" for module in ("boundary", "primitives", "ray")),
    ],
)
def test_documented_modules_are_importable_and_documented(name):
    module = importlib.import_module(name)
    package = importlib.import_module(name.rpartition(".")[0])
    shared = [public for public in package.__all__ if hasattr(module, public)]
    assert module.__doc__ and shared
    assert all(getattr(package, public) is getattr(module, public) for public in shared)


def test_direction_cosines_follow_the_documents_formula():
    p0, p1 = torch.tensor([1.0, 2.0, 3.0]), torch.tensor([4.0, -2.0, 15.0])
    s = ((p1 - p0) ** 2).sum().sqrt()
    ray = create_ray_from_two_points(p0, p1)
    torch.testing.assert_close(ray[0, 1], (p1 - p0) / s)
    torch.testing.assert_close(propagate_ray(ray, s)[0, 0], p1)
    angles = torch.rad2deg(torch.arccos(ray[0, 1]))
    torch.testing.assert_close(create_ray(p0, angles)[0, 1], ray[0, 1])


def test_sphere_follows_the_documents_formula():
    x0, y0, z0, r = 1.0, 2.0, 30.0, 5.0
    sphere = define_sphere(torch.tensor([x0, y0, z0]), torch.tensor([r]))
    starts = grid(4, 4.0, 0.0)
    hits, _, distance, check = intersect_w_sphere(
        create_ray_from_two_points(starts, torch.tensor([[x0, y0, z0]])),
        sphere,
        learning_rate=2e-1,
        number_of_steps=5000,
        error_threshold=1e-2,
    )
    x, y, z = hits[:, 0].unbind(-1)
    torch.testing.assert_close(
        (x - x0) ** 2 + (y - y0) ** 2 + (z - z0) ** 2, torch.full((16,), r**2), rtol=1e-5, atol=0
    )
    assert check.shape == distance.shape == (16,)


def test_sources():
    grid = create_ray_from_grid_w_luminous_angle(
        center=torch.tensor([0, 0, 0]),
        size=[2, 2],
        no=[2, 2],
        tilt=torch.tensor([15, 0, 0]),
        num_ray_per_light=10,
        angle_limit=15,
    )
    point = create_ray_from_point_w_luminous_angle(
        origin=torch.tensor([0, 0, 0]), tilt=torch.tensor([15, 0, 0]), num_ray=30, angle_limit=15
    )
    axis = torch.tensor([0.0, -np.sin(np.deg2rad(15)), np.cos(np.deg2rad(15))], dtype=torch.float32)
    for rays, count in ((grid, 40), (point, 30)):
        assert rays.shape == (count, 2, 3)
        assert (rays[:, 1] @ axis >= np.cos(np.deg2rad(15)) - 1e-6).all()
    ends = torch.tensor([[0.0, 0, 5], [1, 0, 5], [0, 1, 5], [1, 1, 5]])
    pairs = propagate_ray(create_ray_from_all_pairs(torch.zeros(4, 3), ends), torch.ones(16) * 2.0)
    torch.testing.assert_close(torch.linalg.vector_norm(pairs[:, 0], dim=-1), torch.full((16,), 2.0))
    points = get_points_along_a_ray_segment(ray=pairs[:1], distances=torch.linspace(0, 10, 10))
    assert points.shape == (10, 3)


def test_triangles_mirrors_and_glass():
    starts = grid(5, 10.0, 0.0)
    ends = grid(5, 6.0, 10.0)
    rays = create_ray_from_two_points(starts, ends)
    triangle = torch.tensor([[[-5.0, -5.0, 10.0], [5.0, -5.0, 10.0], [0.0, 5.0, 10.0]]])
    normals, distance, intersecting_rays, intersecting_normals, check = intersect_w_triangle(rays, triangle)
    assert check.shape[1] == 25 and check[0, 0] and not check[0, 4]
    masked = normals[:, 0] * check.squeeze(0).unsqueeze(-1).repeat(1, 3)
    torch.testing.assert_close(masked[check[0]], intersecting_normals[:, 0])
    assert (distance[check[0]] > 0).all()
    glass = refract(intersecting_rays, intersecting_normals, 1.0, 1.51)
    torch.testing.assert_close(1.51 * glass[:, 1, :2], intersecting_rays[:, 1, :2])
    mirrored = propagate_ray(reflect(intersecting_rays, intersecting_normals), torch.ones(len(glass)) * 7.2)
    torch.testing.assert_close(mirrored[:, 1], intersecting_rays[:, 1] * torch.tensor([1.0, 1, -1]))
    both = intersect_w_triangle_batch(rays, torch.cat((triangle, triangle + torch.tensor([0.0, 0, 2]))))
    assert both[4].shape == (2, 25) and both[0][1, :, 0].shape == (25, 3)
    circle = define_circle(torch.tensor([0.0, 0, 10]), 2.0, torch.zeros(3))
    normal, distance = intersect_w_circle(rays, circle)
    radius = torch.linalg.vector_norm(normal[:, 0, :2], dim=-1)
    assert ((distance[:, 0] == 0) == (radius > 2.0)).all() and (distance > 0).any()
    landed, distance = intersect_w_surface(rays, define_plane(torch.tensor([0.0, 0, 20])))
    torch.testing.assert_close(landed[:, 0, 2], torch.full((25,), 20.0))
