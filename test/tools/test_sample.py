import numpy as np
import pytest
import torch

import odak.learn.tools as learn
import odak.tools as tools

DISCS = ("circular_sample", "circular_uniform_sample", "circular_uniform_random_sample")


def test_sphere_points(random):
    points = tools.sphere_sample([4, 6], radius=2.0, center=[1.0, -2.0, 3.0])
    assert points.shape == (24, 3)
    assert np.allclose(np.linalg.norm(points - [1.0, -2.0, 3.0], axis=1), 2.0)
    arm = (points - [1.0, -2.0, 3.0]) / 2
    assert np.allclose(np.arccos(arm[:, 2]).reshape(4, 6), np.arange(4)[:, None] * np.pi / 4)
    azimuth = np.arctan2(arm[6:, 1], arm[6:, 0]).reshape(3, 6)
    assert np.allclose(np.exp(1j * azimuth), np.exp(2j * np.pi * np.arange(6) / 6))
    sheared = tools.sphere_sample_uniform([5, 5])
    assert {tuple(p) for p in sheared.round(9)} <= {tuple(p) for p in tools.sphere_sample([5, 5]).round(9)}
    assert np.allclose(tools.sphere_sample_uniform([2, 2]), [[0, 0, 1], [-1, 0, 0], [-1, 0, 0], [0, 0, 1]])


def test_box_cells_fill_the_box():
    points = tools.box_volume_sample([4, 3, 2], [8.0, 3.0, 1.0], center=[1.0, 2.0, 3.0])
    assert points.shape == (24, 3)
    assert np.allclose(points.mean(0), [1, 2, 3])
    # The second moment of n cells of a line of length L is L²(1 − 1/n²)/12.
    assert np.allclose(points.var(0), np.square([8, 3, 1]) * (1 - 1 / np.square([4, 3, 2])) / 12)
    assert (np.diff(points[:, 2])[0], points[2, 1] - points[0, 1]) == (0.5, 1.0)


@pytest.mark.parametrize("name", DISCS)
def test_disc_points_turn_and_move(name):
    seed = {"seed": 3} if "random" in name else {}
    flat = getattr(tools, name)([4, 12], 2.0, **seed)
    assert np.all(np.linalg.norm(flat, axis=1) <= 2 + 1e-12)
    assert np.all(flat[:, 2] == 0)
    turned = getattr(tools, name)([4, 12], 2.0, [1.0, 2.0, 3.0], [10.0, 20.0, 30.0], **seed)
    assert np.allclose(turned, tools.rotate_points(flat, [10.0, 20.0, 30.0], offset=[1.0, 2.0, 3.0]), atol=1e-12)
    tensors = getattr(learn, name)([4, 12], 2.0, [1.0, 2.0, 3.0], torch.tensor([10.0, 20, 30]).double(), **seed)
    assert tensors.dtype == torch.float64
    assert np.allclose(tensors.numpy(), turned, atol=1e-12)


def test_disc_grids():
    grid = tools.circular_sample([4, 3], 3.0).reshape(4, 3, 3)
    expected = np.exp(1j * np.pi / 2 * np.arange(1, 5))[:, None] * np.arange(1, 4)
    assert np.allclose(grid[..., 0] + 1j * grid[..., 1], expected)
    rings = tools.circular_uniform_sample([4, 10], 4.0)
    radii, counts = np.unique(np.linalg.norm(rings, axis=1).round(9), return_counts=True)
    assert radii.tolist() == [1, 2, 3]
    assert counts.tolist() == [2, 5, 7]
    first = rings[7:9, 0] + 1j * rings[7:9, 1]
    assert first[1] / first[0] == pytest.approx(np.exp(2j * np.pi / 7.5))


def test_random_disc_is_uniform_in_area():
    points = tools.circular_uniform_random_sample([100, 200], 2.0, seed=1)
    assert points.shape == (20000, 3)
    for radius in (0.5, 1.0, 1.5):
        share = np.mean(np.linalg.norm(points, axis=1) < radius)
        assert share == pytest.approx(radius**2 / 4, abs=0.015)
    assert len(np.unique(np.linalg.norm(points, axis=1))) == 20000
    assert np.array_equal(points, tools.circular_uniform_random_sample([100, 200], 2.0, seed=1))


@pytest.mark.parametrize("no", [[3, 4], [1, 2], torch.tensor([3, 4]), np.array([2, 1])])
def test_grids_of_both_faces(no):
    angles, center = [30.0, -20.0, 70.0], [1.0, 2.0, 3.0]
    points = tools.grid_sample(no, [10.0, 6.0], center, angles)
    counts = [int(n) for n in no]
    lines = [np.linspace(-s / 2, s / 2, n) if n > 1 else [0.0] for s, n in zip((10, 6), counts, strict=True)]
    flat = np.stack([*(g.ravel() for g in np.meshgrid(*lines, indexing="ij")), np.zeros(np.prod(counts))], -1)
    assert np.allclose(points, tools.rotate_points(flat, angles, offset=center), atol=1e-12)
    tensors, *turns = learn.grid_sample(no, [10.0, 6.0], center, angles)
    assert tensors.dtype == torch.float32
    assert np.allclose(tensors, points, atol=1e-5)
    for turn, matrix in zip(turns, (tools.rotmatx(30.0), tools.rotmaty(-20.0), tools.rotmatz(70.0)), strict=True):
        assert turn.shape == (1, 3, 3)
        assert np.allclose(turn[0], matrix, atol=1e-6)


def test_other_tensor_faces():
    for name, arguments in (
        ("sphere_sample", ([3, 4], 2.0, [1.0, 2.0, 3.0])),
        ("sphere_sample_uniform", ([3, 3], 2.0, [1.0, 2.0, 3.0])),
        ("box_volume_sample", ([2, 3, 4], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [5.0, 6.0, 7.0])),
    ):
        tensor = getattr(learn, name)(*arguments)
        assert tensor.dtype == torch.float32
        assert np.allclose(tensor, getattr(tools, name)(*arguments), atol=1e-5)


def test_gradients():
    size, center, angles = (
        torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in ([2.0, 3.0], [0.1, 0.2, 0.3], [10.0, 20, 30])
    )
    assert torch.autograd.gradcheck(
        lambda *given: learn.grid_sample([2, 3], *given), (size, center, angles), fast_mode=True
    )
    radius = torch.tensor(2.0, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda r, c: learn.sphere_sample([2, 3], r, c), (radius, center), fast_mode=True)
    starts = torch.rand(4, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(tools.batch_of_rays, (starts, center), fast_mode=True)


def test_rays(random, as_array):
    starts, stops = random.random((5, 3)), random.random((5, 3))
    for entry, exit in ((starts, stops), (starts[0], stops), (starts, stops[:1])):
        rays = np.asarray(tools.batch_of_rays(as_array(entry), as_array(exit)))
        assert rays.shape == (5, 2, 3)
        assert np.array_equal(rays[:, 0], np.broadcast_to(entry, (5, 3)))
        assert np.allclose(np.linalg.norm(rays[:, 1], axis=1), 1)
        assert np.allclose(np.cross(rays[:, 1], exit - rays[:, 0]), 0, atol=1e-12)
        assert np.all(np.sum(rays[:, 1] * (exit - rays[:, 0]), axis=1) > 0)
    assert tools.batch_of_rays([0, 0, 0], [0, 0, 2]).tolist() == [[[0, 0, 0], [0, 0, 1]]]


def test_draws_follow_their_probabilities(as_array):
    cloud = as_array(np.arange(12.0).reshape(4, 3))
    drawn = np.asarray(tools.random_sample_point_cloud(cloud, 4000, [0.5, 0.0, 0.2, 0.3], seed=7))
    assert drawn.shape == (4000, 3)
    shares = [np.mean(drawn[:, 0] == first) for first in (0, 3, 6, 9)]
    assert np.allclose(shares, [0.5, 0.0, 0.2, 0.3], atol=0.03)
    assert shares[1] == 0
    with pytest.raises(ValueError, match="p must be 4 probabilities of sum 1, got 2"):
        tools.random_sample_point_cloud(cloud, 3, [0.5, 0.5])


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: tools.sphere_sample_uniform([2, 3]), "no must be two equal integers"),
        (lambda: tools.box_volume_sample([2, 3]), "no must be three integers"),
        (lambda: tools.grid_sample([0, 3]), r"no\[0\] must be at least 1"),
        (lambda: tools.grid_sample(size=[1.0]), "size must be 2 numbers, got 1"),
        (lambda: tools.circular_sample(center=[0.0, 1.0]), "center must be 3 numbers, got 2"),
        (lambda: tools.sphere_sample(k=[1]), "k must be two numbers"),
        (
            lambda: tools.batch_of_rays(np.ones((2, 3)), np.zeros((3, 3))),
            "entry and exit must have the same",
        ),
        (lambda: tools.batch_of_rays(np.ones(3), np.ones((2, 3))), "exit must differ from entry"),
        (lambda: tools.batch_of_rays(np.ones(2), np.ones(3)), "entry must be"),
    ],
)
def test_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
