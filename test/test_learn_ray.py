"""The course's example of rays: points, directions, propagation. Set `visualize` to see it."""

import pytest
import torch

from odak import AccuracyWarning
from odak.learn.raytracing import create_ray, create_ray_from_two_points, propagate_a_ray, propagate_ray  # (1)!
from odak.learn.tools import grid_sample

VISUALIZE = False  # (8)!


def test_rays(visualize=VISUALIZE):
    starting_point = torch.tensor([[5.0, 5.0, 0.0]])  # (2)!
    end_points, _, _, _ = grid_sample(  # (3)!
        no=[2, 2], size=[20.0, 20.0], angles=[0.0, 0.0, 0.0], center=[0.0, 0.0, 10.0]
    )
    rays_from_points = create_ray_from_two_points(starting_point, end_points)  # (4)!
    assert rays_from_points.shape == (4, 2, 3)
    distances = torch.linalg.vector_norm(end_points - starting_point, dim=-1)
    reached = propagate_ray(rays_from_points, distances)[:, 0]
    torch.testing.assert_close(reached, end_points)

    starting_points, _, _, _ = grid_sample(
        no=[3, 3], size=[100.0, 100.0], angles=[0.0, 0.0, 0.0], center=[0.0, 0.0, 0.0]
    )
    angles = torch.randn(starting_points.shape, generator=torch.Generator().manual_seed(0)) * 180.0  # (5)!
    with pytest.warns(AccuracyWarning, match="length 1"):  # random angles are no direction
        rays_from_angles = create_ray(starting_points, angles)  # (6)!
    torch.testing.assert_close(rays_from_angles[:, 1], torch.cos(angles * torch.pi / 180.0), atol=1e-5, rtol=1e-5)

    distances = torch.ones(len(rays_from_points)) * 12.5
    propagated_rays = propagate_a_ray(rays_from_points, distances)  # (7)!
    travelled = torch.linalg.vector_norm(propagated_rays[:, 0] - rays_from_points[:, 0], dim=-1)
    torch.testing.assert_close(travelled, distances)
    torch.testing.assert_close(propagated_rays[:, 1], rays_from_points[:, 1])

    if visualize:
        show(starting_point, end_points, rays_from_points, propagated_rays)


def show(starting_point, end_points, rays, propagated_rays):
    """Draw one ray from its start (red) to its end (blue), and the axes in black."""
    from odak.visualize.plotly import rayshow

    ray_visualizer = rayshow(line_width=3.0, marker_size=3.0)
    ray_visualizer.add_point(starting_point, color="red")
    ray_visualizer.add_point(end_points[0], color="blue")
    ray_visualizer.add_line(rays[0, 0], propagated_rays[0, 0], color="green")
    for axis in torch.eye(3) * 10.0:
        ray_visualizer.add_line(torch.zeros(3), axis, color="black", dash="dash")
    ray_visualizer.show()


if __name__ == "__main__":
    test_rays()
