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
    with pytest.raises(ValueError, match=r"points must be \[2 or more, 2 or more, 3\]"):
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


def ply(points, faces, kind="double", element="face"):
    lines = [f"ply\nformat ascii 1.0\nelement vertex {len(points)}"]
    lines += [f"property {kind} {axis}" for axis in "xyz"]
    if element:
        lines += [f"element {element} {len(faces)}", "property list int int vertex_indices"]
    lines += ["end_header", *(" ".join(map(repr, map(float if kind != "int" else int, p))) for p in points)]
    return "\n".join([*lines, *(" ".join(map(str, (len(face), *face))) for face in faces)]) + "\n"


def areas(triangles):
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.linalg.norm(sides.astype(np.float64), axis=-1) / 2


def outline(name):
    if name == "L":
        return np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)
    if name == "comb":
        teeth = [[(2 * k, 0), (2 * k + 1, 0), (2 * k + 1, 3), (2 * k + 2, 3)] for k in range(5)]
        return np.array([*np.concatenate(teeth), (10, 4), (0, 4)], float)
    angle = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    radius = np.where(np.arange(14) % 2, 1.0, 0.4)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)


@pytest.mark.parametrize("name", ["L", "comb", "star"])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("first", [0, 1, 3])
def test_polygons_that_are_not_convex_keep_their_area(name, turned, first, tmp_path):
    """An outline in any plane: the areas of its triangles add to that of the shoelace formula, and all face one way."""
    flat = np.roll(outline(name), first, axis=0)
    x, y = flat.T
    area = (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    flat = flat[::-1] if turned else flat
    points = rotate_points(np.column_stack([flat, 0 * x]), [20.0, 70.0, 40.0], offset=[1.0, -2.0, 3.0])
    both = np.concatenate([points, points + np.array([9, 0, 0])])
    (tmp_path / "a.ply").write_text(ply(both, [range(len(x)), range(len(x), 2 * len(x))]))
    triangles = read_PLY(tmp_path / "a.ply")
    assert triangles.shape == (2 * (len(x) - 2), 3, 3)
    assert areas(triangles).sum() == pytest.approx(2 * area, rel=1e-5)
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    facing = rotate_points(np.array([[0, 0, -1.0 if turned else 1.0]]), [20.0, 70.0, 40.0])
    assert (sides @ facing.ravel() > 0).all()


def test_strips_of_triangles_and_points(tmp_path):
    grid = [[x, y, 0] for x in range(3) for y in range(2)]
    strips = [[0, 2, 1, 3, -1, 2, 4, 3, 5], [0, 2, 1]]
    (tmp_path / "a.ply").write_text(ply(grid, strips, element="tristrips"))
    triangles = read_PLY(tmp_path / "a.ply")
    assert len(triangles) == 5 and np.allclose(areas(triangles), 0.5)
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert (sides[:, 2] > 0).all()
    (tmp_path / "b.ply").write_text(ply(grid, [], element=None))
    with pytest.raises(ValueError, match=r"b\.ply.* has no faces, but vertex; odak\.tools\.read_PLY_point_cloud reads"):
        read_PLY(tmp_path / "b.ply")
    assert read_PLY_point_cloud(tmp_path / "b.ply").tolist() == grid


def test_far_coordinates_keep_their_digits(tmp_path):
    near = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    for kind, far in (("double", np.array([4.5e6 + 0.3, 5e6, 300.25])), ("int", np.array([2**24 + 1, 0, 0]))):
        (tmp_path / "a.ply").write_text(ply(near + far, [[0, 1, 2]], kind))
        triangles = read_PLY(tmp_path / "a.ply")
        assert triangles.dtype == np.float64 and np.array_equal(triangles[0], near + far)
        assert areas(triangles)[0] == pytest.approx(0.5, rel=1e-8)
    (tmp_path / "a.ply").write_text(ply(1e60 * near, [[0, 1, 2]]))
    assert read_PLY(tmp_path / "a.ply").max() == 1e60
    (tmp_path / "a.ply").write_text(ply(0.1 * near + 3, [[0, 1, 2]]))
    assert read_PLY(tmp_path / "a.ply").dtype == np.float32
