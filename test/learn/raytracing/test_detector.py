"""The detector: which pixel a ray lights, distances, tilt, memory, gradients."""

import importlib

import pytest
import torch

from odak.learn import raytracing as rt
from odak.learn.raytracing import create_ray_from_two_points, detector

F64 = torch.float64
TILT = torch.tensor([20.0, -35.0, 50.0], dtype=F64)


def tilted(**options):
    settings = {"colors": 2, "center": torch.tensor([1.0, 2.0, 3.0], dtype=F64), "tilt": TILT}
    return detector(**{**settings, "size": [4.0, 6.0], "resolution": [5, 7], **options})


def rays_to(points, start=(0.3, -0.2, -9.0)):
    return create_ray_from_two_points(torch.tensor(start, dtype=points.dtype), points)


def test_numbers_of_the_specification():
    plate = detector(size=torch.tensor([4.0, 4.0]), resolution=torch.tensor([4, 4]), center=torch.tensor([0.0, 0, 1]))
    assert plate.pixel_size.tolist() == [1, 1]
    assert float(plate.pixel_diagonal_size) == pytest.approx(2**0.5)
    assert float(plate.pixel_diagonal_half_size) == pytest.approx(2**-0.5)
    expected = torch.tensor([[-2.0, -2, 1], [-2, -2 / 3, 1], [-2, 2 / 3, 1]])
    torch.testing.assert_close(plate.pixel_locations[:3], expected)
    assert plate.image.shape == (3, 4, 4) and plate.plane.shape == (3, 3)


def test_default_arguments():
    plate = detector()
    assert plate.image.shape == (3, 100, 100) and plate.pixel_locations.shape == (10_000, 3)


def test_class_and_module_of_one_name():
    module = importlib.import_module("odak.learn.raytracing.boundary")
    assert module.detector is rt.detector is detector
    assert rt.detector.detector is detector


def test_ray_through_a_pixel_lights_that_one_however_tilted():
    plate = tilted()
    chosen = torch.tensor([0, 6, 17, 28, 34, 17])
    points, image, distances = plate.intersect(rays_to(plate.pixel_locations[chosen]), color=1)
    torch.testing.assert_close(points, plate.pixel_locations[chosen])
    expected = torch.zeros(35, dtype=F64).index_add(0, chosen, torch.ones(6, dtype=F64))
    assert torch.equal(image, expected)
    assert torch.equal(plate.image[1].reshape(-1), expected) and not bool(plate.image[0].any())
    assert torch.equal(distances.argmin(dim=1), chosen)


def test_every_hit_within_half_a_pitch_lights_the_nearest_pixel():
    plate = tilted()
    x, y = plate.pixel_locations[7] - plate.pixel_locations[0], plate.pixel_locations[1] - plate.pixel_locations[0]
    generator = torch.Generator().manual_seed(0)
    place = torch.rand(500, 2, generator=generator, dtype=F64) * torch.tensor([6.0, 8.0], dtype=F64) - 1
    hits = plate.pixel_locations[0] + place[:, :1] * x + place[:, 1:] * y
    inside = ((place > -0.5) & (place < torch.tensor([4.5, 6.5], dtype=F64))).all(dim=1)
    _, image, distances = plate.intersect(rays_to(hits))
    nearest = torch.cdist(hits, plate.pixel_locations).argmin(dim=1)
    expected = torch.zeros(35, dtype=F64).index_add(0, nearest[inside], torch.ones(500, dtype=F64)[inside])
    assert 0 < int(inside.sum()) < 500 and torch.equal(image, expected)
    torch.testing.assert_close(distances, torch.cdist(hits, plate.pixel_locations) ** 2)


def test_parallel_rays_and_rays_that_move_away_light_nothing():
    plate = detector(colors=1, center=torch.zeros(3, dtype=F64), size=[2.0, 2.0], resolution=[3, 3])
    rays = torch.tensor([[[0, 0, -1.0], [1, 0, 0]], [[0, 0, -1.0], [0, 0, -1]], [[0, 0, 0.0], [0, 0, 1]]], dtype=F64)
    points, image, distances = plate.intersect(rays)
    assert bool(points[0].isnan().all() and distances[0].isnan().all())
    assert points[1].tolist() == [0, 0, 0] and bool(distances[1:].isfinite().all())
    assert image.sum() == 1 and image[4] == 1


def test_calls_add_up_and_clear_forgets():
    plate = tilted(colors=1)
    rays = rays_to(plate.pixel_locations[[3, 3, 9]])
    first = plate.intersect(rays)[1]
    plate.intersect(rays[:1])
    assert plate.image.sum() == 4 and plate.image[0, 0, 3] == 3 and first.sum() == 3
    assert plate.get_image().max() == 1 and plate.get_image().min() == 0
    assert plate.get_image()[0, 1, 2] == pytest.approx(1 / 3)
    plate.clear()
    assert not bool(plate.image.any()) and not bool(plate.get_image().any())


def test_gradients_in_rays_and_placement():
    def outputs(rays, center, tilt):
        points, _, distances = tilted(center=center, tilt=tilt, resolution=[2, 3]).intersect(rays)
        return points, distances

    rays = rays_to(tilted().pixel_locations[[1, 20]] + 0.1)
    inputs = [v.clone().requires_grad_() for v in (rays, torch.tensor([1.0, 2.0, 3.0], dtype=F64), TILT)]
    assert torch.autograd.gradcheck(outputs, inputs, fast_mode=True)


def test_a_lost_ray_leaves_the_gradient_of_the_placement_finite():
    center = torch.zeros(3, dtype=F64, requires_grad=True)
    plate = detector(colors=1, center=center, size=[2.0, 2.0], resolution=[2, 2])
    rays = torch.tensor([[[0, 0, -1.0], [1, 0, 0]], [[0.1, 0, -1.0], [0, 0, 1]]], dtype=F64)
    for _ in range(2):
        points, _, distances = plate.intersect(rays)
        (points[1].sum() + distances[1].sum()).backward()
    assert bool(center.grad.isfinite().all()) and bool((center.grad != 0).any())


def test_memory_is_that_of_the_result():
    """100 000 rays on a million pixels: without distances nothing of their product is held."""
    plate = detector(colors=1, size=[2.0, 2.0], resolution=[1000, 1000])
    targets = torch.rand(100_000, 3, generator=torch.Generator().manual_seed(1)) * 2 - 1
    targets[:, 2] = 0
    _, image, distances = plate.intersect(rays_to(targets, (0.0, 0.0, -5.0)), distances=False)
    assert distances is None and image.sum() == 100_000


def test_empty_batch_and_precision():
    plate = detector(colors=1, size=[2.0, 2.0], resolution=[3, 4])
    points, image, distances = plate.intersect(torch.zeros(0, 2, 3))
    assert points.shape == (0, 3) and image.shape == (12,) and distances.shape == (0, 12)
    points, _, distances = plate.intersect(rays_to(torch.zeros(1, 3, dtype=F64)))
    assert points.dtype == distances.dtype == F64 and plate.image.dtype == torch.float32


def test_call_of_the_reference():
    """The mesh and detector of the reference's test: heights get a gradient through the distance image."""
    plate = detector(
        colors=1,
        center=torch.tensor([0.0, 0.0, 0.0]),
        tilt=torch.tensor([0.0, 0.0, 0.0]),
        size=torch.tensor([0.1, 0.1]),
        resolution=torch.tensor([20, 20]),
        device=torch.device("cpu"),
    )
    mesh = rt.planar_mesh(
        size=torch.tensor([0.1, 0.1]), number_of_meshes=torch.tensor([8, 8]), offset=torch.tensor([0.0, 0.0, 0.1])
    )
    grid = torch.linspace(-0.04, 0.04, 10)
    x, y = (v.reshape(-1) for v in torch.meshgrid(grid, grid, indexing="ij"))
    start = torch.stack((x, y, 0 * x), dim=1)
    rays = create_ray_from_two_points(start, start + torch.tensor([0.0, 0.0, 1.0]))
    reflected, _ = mesh.mirror(rays)
    _, _, distances = plate.intersect(reflected)
    values, indices = torch.min(distances, dim=1)
    assert values.shape == indices.shape == (100,)
    distances.sum().backward()
    assert bool((mesh.heights.grad != 0).any()) and plate.get_image().max() == 1


def test_wrong_color_is_named():
    with pytest.raises(ValueError, match="color must be at least 0 and below 3, got 3"):
        detector(resolution=[2, 2]).intersect(torch.zeros(1, 2, 3), color=3)
