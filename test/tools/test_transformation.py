"""Rotations on both faces: matrices written out, round trips, shapes, gradients; vectors and distances."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import odak
from odak.learn import tools as torch_tools
from odak.tools import transformation

MODES = ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"]


def matrices(angles):
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.deg2rad(angles)), np.sin(np.deg2rad(angles))
    return {
        "X": np.asarray([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]),
        "Y": np.asarray([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]),
        "Z": np.asarray([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]),
    }


@pytest.mark.parametrize("mode", MODES)
def test_all_orders_on_both_faces(mode, random):
    angles, points, origin, offset = random.uniform(-180, 180, 3), *random.normal(size=(3, 5, 3))
    turn = matrices(angles)
    expected = (points - origin) @ (turn[mode[2]] @ turn[mode[1]] @ turn[mode[0]]).T + origin + offset
    before = points.copy()
    np.testing.assert_allclose(odak.tools.rotate_points(points, angles, mode, origin, offset), expected, atol=1e-14)
    np.testing.assert_array_equal(points, before)
    point, *parts = odak.tools.rotate_point(points[0], angles, mode.lower(), origin[0], offset[0])
    np.testing.assert_allclose(point, expected[0], atol=1e-14)
    for axis, part in zip("XYZ", parts, strict=True):
        np.testing.assert_allclose(part, turn[axis], atol=1e-15)
    tensors = [torch.from_numpy(v) for v in (points, angles, origin[:1], offset)]
    turned, *parts = torch_tools.rotate_points(tensors[0], tensors[1], mode, tensors[2], tensors[3])
    one_origin = (points - origin[0]) @ (turn[mode[2]] @ turn[mode[1]] @ turn[mode[0]]).T + origin[0] + offset
    np.testing.assert_allclose(turned.numpy(), one_origin, atol=1e-14)
    assert [p.shape for p in parts] == [(1, 3, 3)] * 3 and turned.dtype == torch.float64
    matrix = torch_tools.get_rotation_matrix(list(tensors[1]), tilt_order=mode)
    np.testing.assert_allclose(matrix.numpy(), turn[mode[2]] @ turn[mode[1]] @ turn[mode[0]], atol=1e-15)


def test_several_sets_of_angles():
    points = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    angles = torch.tensor([[0.0, 0, -90], [-45, 0, 0]])
    turned, rotx, _, rotz = torch_tools.rotate_points(points, angles, origin=torch.zeros(2, 3))
    half = 0.5**0.5
    expected = [[[0, -1, 0], [1, 0, 0]], [[1, 0, 0], [0, half, -half]], [[0, 0, 1], [0, half, half]]]
    np.testing.assert_allclose(turned, expected, atol=1e-6)
    assert rotx.shape == rotz.shape == (1, 2, 3, 3)
    assert torch_tools.rotate_points(torch.ones(3))[0].shape == (1, 3)
    assert torch_tools.rotate_points(torch.ones(2, 3, dtype=torch.float64))[0].dtype == torch.float64
    shifted = torch_tools.rotate_points(points, offset=torch.eye(3))[0]
    np.testing.assert_allclose(shifted, points + torch.eye(3))


def test_rotations_are_differentiable():
    leaves = [torch.rand(2, 3, dtype=torch.float64, requires_grad=True) for _ in range(4)]
    assert torch.autograd.gradcheck(
        lambda p, a, o, s: torch_tools.rotate_points(p, a, "ZXY", o, s), leaves, fast_mode=True
    )
    quaternion = torch.rand(2, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(torch_tools.quaternion_to_rotation_matrix, quaternion, fast_mode=True)


def test_axis_rotations():
    assert odak.tools.rotmatx([0.0, 90.0]).shape == (2, 3, 3)
    for name in ("rotmatx", "rotmaty", "rotmatz"):
        single, double = getattr(torch_tools, name), torch.tensor([30.0], dtype=torch.float64)
        np.testing.assert_allclose(single(double), getattr(odak.tools, name)(30.0), atol=1e-15)
        assert single(30.0).shape == single(torch.tensor([30.0])).shape == (3, 3)
        assert single(torch.zeros(4)).shape == (4, 3, 3)


@given(st.lists(st.floats(-180, 180), min_size=3, max_size=3), st.sampled_from(MODES))
def test_rotations_are_orthogonal(angles, mode):
    matrix = transformation.rotation_matrix(np.asarray(angles), mode)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(matrix) == pytest.approx(1)


def test_tilt_towards():
    for face in (odak.tools, torch_tools):
        np.testing.assert_allclose(face.tilt_towards([0, 0, 0], [1, 2, 3]), [0, 143.30077479951, -116.565051177078])
        assert face.tilt_towards([0, 0, 0], [1, 0, 0]) == [0, 90.0, 180.0]
        assert face.tilt_towards([5, 6, 7], [5, 6, 8])[1] == 180.0
        with pytest.raises(ValueError, match="location and lookat must differ"):
            face.tilt_towards([1, 2, 3], [1, 2, 3])
    location, lookat = np.asarray([1.0, -2.0, 0.5]), np.asarray([0.3, 4.0, 2.0])
    _, theta, phi = odak.tools.tilt_towards(location, lookat)
    axis = odak.tools.rotate_point([0, 0, 1], [0, theta, phi])[0]
    np.testing.assert_allclose(axis, (location - lookat) / np.linalg.norm(location - lookat), atol=1e-14)
    assert torch_tools.tilt_towards(torch.zeros(3), torch.tensor([1.0, 1.0, 0.0])) == [0, 90.0, -135.0]


def test_quaternions():
    np.testing.assert_allclose(torch_tools.quaternion_to_rotation_matrix([2.0, 0, 0, 0]), np.eye(3))
    half = np.deg2rad(25)
    about_y = torch_tools.quaternion_to_rotation_matrix(torch.tensor([np.cos(half), 0, np.sin(half), 0]))
    np.testing.assert_allclose(about_y, odak.tools.rotmaty(50.0), atol=1e-15)
    some = torch.eye(4, 4)
    some[2] = 0
    some.requires_grad_()
    with pytest.warns(odak.AccuracyWarning, match="1 of 4 quaternions are zero"):
        rotations = torch_tools.quaternion_to_rotation_matrix(some)
    np.testing.assert_array_equal(rotations[2].detach(), np.eye(3))
    weights = torch.arange(9.0).reshape(3, 3)
    (rotations * weights).sum().backward()
    torch.testing.assert_close(some.grad[2], some.grad[0])
    assert some.grad[2].any()


def test_voxels():
    points = torch.tensor([[0.0, 0, 0], [1, 0.2, 0], [0.49, 0, 0]])
    locations, grid = torch_tools.point_cloud_to_voxel(points, [0.5, 0.1, 1.0])
    assert grid.shape == (2, 2, 1) and locations.shape == (2, 2, 1, 3)
    assert grid[..., 0].tolist() == [[1, 0], [0, 1]]
    np.testing.assert_allclose(locations[1, 0, 0], [0.75, 0.05, 0.5])
    with pytest.raises(ValueError, match="voxel_size must be positive"):
        torch_tools.point_cloud_to_voxel(points, [0.0, 1.0, 1.0])


def test_vectors():
    ray0, ray1 = [[1, 2, 3], [1, 0, 0]], [[0, 0, 0], [0, 1, 0]]
    product = odak.tools.cross_product(ray0, ray1)
    assert product.dtype == np.float32 and product.tolist() == [[1, 2, 3], [0, 0, 1]]
    assert torch_tools.cross_product(torch.tensor(ray0), torch.tensor(ray1)).tolist() == product.tolist()
    for face in (odak.tools, torch_tools):
        assert face.same_side([0, 1, 0], [5, 2, 0], [0, 0, 0], [1, 0, 0]) is True
        assert face.same_side([0, -1, 0], [5, 2, 0], [0, 0, 0], [1, 0, 0]) is False
        many = face.same_side([[0, 1, 0], [0, -1, 0], [7, 0, 0]], [5, 2, 0], [0, 0, 0], [1, 0, 0])
        assert many.tolist() == [True, False, True]
        assert float(face.distance_between_two_points([0, 0, 0], [3, 4, 12])) == 13
        assert face.distance_between_two_points([[0, 0, 0]] * 2, [3, 4, 12]).shape == (2,)


def test_distances(random):
    cloud0, cloud1 = random.normal(size=(4, 3)), random.normal(size=(5, 3))
    expected = np.linalg.norm(cloud0[:, None] - cloud1, axis=-1)
    np.testing.assert_allclose(odak.tools.distance_between_point_clouds(cloud0, cloud1), expected, rtol=1e-12)
    ray = np.asarray([[0, 0, 1], [0, 0, 4.0]])
    np.testing.assert_allclose(odak.tools.closest_point_to_a_ray([1, 2, 3], ray[None]), [0, 0, 3])
    np.testing.assert_allclose(odak.tools.point_to_ray_distance([0, 2, 9], ray[0], ray[0] + ray[1]), 2)
    with pytest.raises(ValueError, match=r"ray must be one ray \[2, 3\]"):
        odak.tools.closest_point_to_a_ray([1, 2, 3], [[0, 0, 0]])


@pytest.mark.parametrize(("angle_rows", "origin_rows", "offset_rows"), [(1, 1, 2), (1, 4, 1), (4, 1, 4), (4, 4, 4)])
def test_sets_of_angles_origins_and_offsets_against_the_formula(angle_rows, origin_rows, offset_rows, random):
    points = random.normal(size=(5, 3))
    angles = random.uniform(-180, 180, (angle_rows, 3))
    origin, offset = random.normal(size=(origin_rows, 3)), random.normal(size=(offset_rows, 3))
    given = [torch.from_numpy(v) for v in (points, angles, origin, offset)]
    turned = torch_tools.rotate_points(given[0], given[1], "YZX", given[2], given[3])[0]
    sets = max(angle_rows, origin_rows, offset_rows)
    assert turned.shape == (5, sets, 3)
    for i in range(sets):
        turn = matrices(angles[i % angle_rows])
        one, shift = origin[i % origin_rows], offset[i % offset_rows]
        expected = (points - one) @ (turn["X"] @ turn["Z"] @ turn["Y"]).T + one + shift
        np.testing.assert_allclose(turned[:, i], expected, atol=1e-14)


def test_unequal_sets_are_errors():
    with pytest.raises(ValueError, match="angles and origin must have as many rows"):
        torch_tools.rotate_points(torch.zeros(5, 3), torch.zeros(2, 3), origin=torch.zeros(3, 3))


def test_numpy_origin_and_offset_of_each_point(random):
    points, origin, offset = random.normal(size=(3, 5, 3))
    turn = matrices([20.0, 0, 0])["X"]
    turned = odak.tools.rotate_points(points, [20.0, 0, 0], origin=origin, offset=offset)
    np.testing.assert_allclose(turned, (points - origin) @ turn.T + origin + offset, atol=1e-14)
    one = odak.tools.rotate_points(points[0], [20.0, 0, 0], origin=origin, offset=offset[0])
    np.testing.assert_allclose(one, (points[0] - origin) @ turn.T + origin + offset[0], atol=1e-14)


def test_equal_points_have_no_line():
    assert np.isnan(transformation.point_to_ray_distance([0, 2, 0], [0, 0, 0], [0, 0, 0]))


def test_distances_of_zero_have_gradients_of_zero():
    cloud = torch.tensor([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0]], dtype=torch.float64, requires_grad=True)
    (found,) = torch.autograd.grad(odak.tools.distance_between_point_clouds(cloud, cloud.detach()).sum(), cloud)
    torch.testing.assert_close(found, torch.tensor([[-0.6, -0.8, 0.0], [0.6, 0.8, 0.0]], dtype=torch.float64))
    ends = torch.zeros(3, dtype=torch.float64), torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    (found,) = torch.autograd.grad(odak.tools.point_to_ray_distance(cloud, *ends).sum(), cloud)
    torch.testing.assert_close(found, torch.tensor([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], dtype=torch.float64))
