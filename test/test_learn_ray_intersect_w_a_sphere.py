"""The course's example of rays that meet a sphere. Set `visualize` to see it."""

import torch

from odak.learn.raytracing import create_ray_from_two_points, define_sphere, intersect_w_sphere
from odak.learn.tools import grid_sample

VISUALIZE = False  # (2)!


def test_sphere_intersection(visualize=VISUALIZE):  # (1)!
    starting_points, _, _, _ = grid_sample(no=[5, 5], size=[3.0, 3.0], angles=[0.0, 0.0, 0.0], center=[0.0, 0.0, 0.0])
    end_points, _, _, _ = grid_sample(no=[5, 5], size=[0.1, 0.1], angles=[0.0, 0.0, 0.0], center=[0.0, 0.0, 5.0])
    rays = create_ray_from_two_points(starting_points, end_points)
    center, radius = torch.tensor([[0.0, 0.0, 5.0]]), torch.tensor([[3.0]])
    sphere = define_sphere(center=center, radius=radius)
    intersecting_rays, intersecting_normals, distances, check = intersect_w_sphere(rays, sphere)
    assert check.all() and intersecting_rays.shape == intersecting_normals.shape == (25, 2, 3)
    points = intersecting_rays[:, 0]
    torch.testing.assert_close(torch.linalg.vector_norm(points - center, dim=-1), torch.full((25,), 3.0))
    starts = rays[:, 0][check]
    torch.testing.assert_close(points, starts + distances[check, None] * rays[:, 1][check])
    # The near side: closer than the centre, which every ray passes by within the little grid's half diagonal.
    assert (distances < torch.linalg.vector_norm(starts - center, dim=-1)).all()
    torch.testing.assert_close(intersecting_normals[:, 1], (points - center) / 3.0)

    if visualize:
        show(rays, intersecting_rays, sphere)


def show(rays, intersecting_rays, sphere):
    """Draw the rays up to the sphere, where they start, and where they meet it."""
    from odak.visualize.plotly import rayshow

    ray_visualizer = rayshow(line_width=3.0, marker_size=3.0)
    ray_visualizer.add_point(rays[:, 0], color="blue")
    ray_visualizer.add_line(rays[:, 0], intersecting_rays[:, 0], color="green")
    ray_visualizer.add_point(intersecting_rays[:, 0], color="red")
    ray_visualizer.add_sphere(sphere, color="orange")
    ray_visualizer.show()


if __name__ == "__main__":
    test_sphere_intersection()
