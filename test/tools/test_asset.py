import numpy as np
import plyfile
import pytest
import torch

from odak.learn.tools import load_voxelized_PLY
from odak.tools import read_PLY, read_PLY_point_cloud, rotate_points, write_PLY, write_PLY_from_points


def test_triangles_are_written_and_read(tmp_path, random):
    triangles = random.random((7, 3, 3)).astype(np.float32)
    name = tmp_path / "a.ply"
    write_PLY(triangles, name)
    assert np.array_equal(read_PLY(name), triangles)
    data = plyfile.PlyData.read(name)
    assert data.text
    assert data["face"]["red"].tolist() == [255] * 7
    assert np.array_equal(read_PLY_point_cloud(name), triangles.reshape(-1, 3).astype(np.float64))
    assert read_PLY_point_cloud(name).dtype == np.float64


@pytest.mark.parametrize("mode", ["XYZ", "ZYX"])
def test_turned_and_shifted(tmp_path, random, mode):
    triangles = random.random((2, 3, 3)).astype(np.float32)
    write_PLY(triangles, tmp_path / "a.ply")
    angles, offset = [10.0, 20.0, 30.0], [1.0, 2.0, 3.0]
    moved = read_PLY(tmp_path / "a.ply", offset, angles, mode)
    expected = rotate_points(triangles.reshape(-1, 3), angles, mode, offset=offset).reshape(2, 3, 3)
    assert moved.dtype == np.float32
    assert np.allclose(moved, expected, atol=1e-6)


def test_grid_of_points_covers_its_area(tmp_path):
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0), indexing="ij")
    write_PLY_from_points(np.stack([x, y, 0 * x], -1), tmp_path / "grid.ply")
    triangles = read_PLY(tmp_path / "grid.ply")
    assert triangles.shape == (12, 3, 3)
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    # All cells are covered once, by triangles that face the same way.
    assert np.allclose(sides[:, 2], sides[0, 2])
    assert abs(sides[:, 2].sum()) / 2 == 3 * 2
    centres = triangles.mean(1)
    assert len(np.unique(centres.round(4), axis=0)) == 12
    assert np.array_equal(triangles[0], [[1, 0, 0], [0, 0, 0], [0, 1, 0]])


def test_files_of_others(tmp_path):
    name = tmp_path / "quad.ply"
    name.write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float nx\nproperty double x\nproperty double y\n"
        "property double z\nelement face 1\nproperty list uchar int vertex_index\nend_header\n"
        "9 0 0 0\n9 1 0 0\n9 1 1 0\n9 0 1 0\n4 0 1 2 3\n"
    )
    assert read_PLY(name)[:, :, :2].tolist() == [[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]]
    assert read_PLY_point_cloud(name)[2].tolist() == [1, 1, 0]


@pytest.mark.parametrize(
    ("kind", "face", "complaint"),
    [
        ("list uchar int", "3 2 1 0", None),
        ("list uchar float", "3 2.0 1 0", None),
        ("list uchar float", "3 1.5 1 0", "other than 0 to 2"),
        ("list uchar float", "3 nan 1 0", "other than 0 to 2"),
        ("list uchar int", "3 3 1 0", "other than 0 to 2"),
        ("list uchar int", "3 -1 1 0", "other than 0 to 2"),
        ("int", "2", "is not a list"),
    ],
)
def test_numbers_of_vertices(tmp_path, kind, face, complaint):
    coordinates = "".join(f"property float {axis}\n" for axis in "xyz")
    header = f"ply\nformat ascii 1.0\nelement vertex 3\n{coordinates}element face 1\nproperty {kind} vertex_indices\n"
    (tmp_path / "a.ply").write_text(f"{header}end_header\n0 0 0\n1 0 0\n0 1 0\n{face}\n")
    if complaint:
        with pytest.raises(ValueError, match=complaint):
            read_PLY(tmp_path / "a.ply")
    else:
        assert read_PLY(tmp_path / "a.ply").tolist() == [[[0, 1, 0], [1, 0, 0], [0, 0, 0]]]


def test_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_PLY(tmp_path / "none.ply")
    (tmp_path / "bad.ply").write_text("no mesh")
    for reader in (read_PLY, read_PLY_point_cloud):
        with pytest.raises(ValueError, match="cannot be read as a PLY file"):
            reader(tmp_path / "bad.ply")
        with pytest.raises(ValueError, match="not allowed"):
            reader(tmp_path / "mesh.obj")
    with pytest.raises(ValueError, match=r"triangles must be \[t, 3, 3\]"):
        write_PLY(np.ones((2, 3)), tmp_path / "a.ply")
    with pytest.raises(ValueError, match=r"points must be \[m, n, 3\]"):
        write_PLY_from_points(np.ones((1, 4, 3)), tmp_path / "a.ply")


def test_voxels_of_a_mesh(tmp_path):
    # Triangles shrunk to two points, (−1, −1, −1) and (1, 1, 1): mean 0, largest 1.
    ends = np.array([[-1.0] * 3, [1.0] * 3])
    write_PLY(np.repeat(3 * ends[:, None], 3, axis=1) + 5, tmp_path / "a.ply")
    points, marks = load_voxelized_PLY(str(tmp_path / "a.ply"), [0.5, 0.5, 1.0])
    assert points.shape == (4 * 4 * 2, 3)
    assert marks.shape == (32,)
    assert torch.equal(points[marks == 1], torch.tensor([[-0.75, -0.75, -0.5], [0.75, 0.75, 0.5]]))


@pytest.mark.parametrize(("write", "shape"), [(write_PLY, (2, 3, 3)), (write_PLY_from_points, (2, 2, 3))])
def test_tensors_with_gradients_are_written(write, shape, tmp_path):
    values = torch.rand(shape, requires_grad=True)
    write(values, tmp_path / "given.ply")
    write(values.detach().numpy(), tmp_path / "plain.ply")
    np.testing.assert_array_equal(read_PLY(tmp_path / "given.ply"), read_PLY(tmp_path / "plain.ply"))
