"""Meshes of rays and surfaces, read back by other readers."""

import json
import os
import struct

import numpy as np
import plyfile
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.tools import read_PLY
from odak.visualize import PLY_object

trimesh = pytest.importorskip("trimesh")


def places(mesh):
    return np.stack([mesh.pnts[axis] for axis in "xyz"], axis=-1)


def test_a_ray_is_a_square_prism_in_the_plane_of_x_and_y():
    mesh = PLY_object()
    assert mesh.pnts is None and mesh.tris is None
    mesh.draw_a_ray([1.0, 2.0, 3.0], torch.tensor([4.0, 5.0, 9.0]).requires_grad_(), k=0.5, color=[np.int64(9), 8, 7])
    corners = np.array([[0, 0, 0], [0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0]])
    assert places(mesh) == pytest.approx(
        np.concatenate([corners + np.array([[1, 2, 3]]), corners + np.array([[4, 5, 9]])])
    )
    wanted = ["031", "132", "047", "073", "456", "467", "512", "526", "236", "376", "015", "054"]
    assert mesh.tris["vertex_indices"].tolist() == [[int(c) for c in face] for face in wanted]
    assert {tuple(face)[1:] for face in mesh.tris} == {(9, 8, 7)}
    assert [mesh.pnts.dtype[a] for a in "xyz"] == [np.dtype("f4")] * 3
    assert mesh.tris.dtype["vertex_indices"].subdtype == (np.dtype("i4"), (3,)) and mesh.tris.dtype["red"] == np.dtype(
        "u1"
    )


def test_indices_go_on_from_ray_to_ray():
    mesh = PLY_object()
    for end in ([0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [0.0, 1.0, 5.0]):
        mesh.draw_a_ray([0.0, 0.0, 0.0], end)
    indices = mesh.tris["vertex_indices"]
    assert indices.shape == (36, 3) and len(mesh.pnts) == 24
    assert np.array_equal(indices[12:24] - 8, indices[:12]) and np.array_equal(indices[24:] - 16, indices[:12])


@settings(max_examples=30)
@given(st.integers(0, 2**16))
def test_perpendicular_section_makes_closed_box_around_ray(seed):
    random = np.random.default_rng(seed)
    start, end = random.normal(size=(2, 3)) * 5
    mesh = PLY_object()
    mesh.draw_a_ray(start, end, k=0.3, perpendicular=True)
    found = trimesh.Trimesh(places(mesh).astype(float), mesh.tris["vertex_indices"], process=False)
    length = np.linalg.norm(end - start)
    assert found.is_watertight and found.is_winding_consistent
    assert found.volume == pytest.approx(0.09 * length, rel=1e-4)
    assert places(mesh)[:4].mean(0) == pytest.approx(start, abs=1e-5)
    assert (places(mesh)[:4] - start) @ (end - start) == pytest.approx(np.zeros(4), abs=1e-4)


def test_rays_along_x_are_flat_only_by_the_older_layout():
    flat, square = PLY_object(), PLY_object()
    for mesh, perpendicular in ((flat, False), (square, True)):
        mesh.draw_rays(np.array([[0.0, 0, 0], [1.0, 0, 0]]), 4.0, k=0.5, perpendicular=perpendicular)
    assert np.ptp(places(flat)[:, 2]) == 0
    assert np.ptp(places(square)[:, 1:], axis=0) == pytest.approx([0.5, 0.5])


def test_many_rays_are_drawn_as_one_by_one_without_lost_ones():
    random = np.random.default_rng(0)
    rays = random.normal(size=(50, 2, 3))
    rays[7, 1] = np.nan
    together, single = PLY_object(), PLY_object()
    together.draw_rays(torch.tensor(rays), torch.arange(1.0, 51.0), k=0.1, color=[255, 0, 0], perpendicular=False)
    for i, (start, along) in enumerate(rays):
        if i != 7:
            single.draw_a_ray(start, start + (i + 1) * along, k=0.1, color=[255, 0, 0])
    assert places(together) == pytest.approx(places(single), abs=1e-5)
    assert np.array_equal(together.tris, single.tris)


@pytest.mark.parametrize("text", [True, False])
def test_ply_is_read_back(tmp_path, text):
    mesh = PLY_object()
    mesh.draw_a_ray([0.0, 0.0, 0.0], [1.0, 2.0, 50.0], color=[255, 128, 0])
    mesh.draw_triangles(torch.eye(3), color=[0, 0, 255])
    name = tmp_path / "mesh.ply"
    mesh.save_PLY(savefn=str(name), text=text)
    head = name.read_bytes()[:400].decode(errors="ignore")
    assert ("format ascii" in head) == text and "comment Vertex data" in head and "comment Face data" in head
    data = plyfile.PlyData.read(name)
    assert np.array_equal(data["vertex"].data, mesh.pnts)
    assert np.array_equal(np.stack(data["face"]["vertex_indices"]), mesh.tris["vertex_indices"])
    assert [tuple(data["face"][c][i] for c in ("red", "green", "blue")) for i in (0, 12)] == [
        (255, 128, 0),
        (0, 0, 255),
    ]
    assert read_PLY(name) == pytest.approx(places(mesh)[mesh.tris["vertex_indices"]])
    other = trimesh.load_mesh(name, process=False)
    assert other.vertices == pytest.approx(places(mesh)) and len(other.faces) == 13
    assert os.listdir(tmp_path) == ["mesh.ply"]


def surface():
    y, x = np.mgrid[-1:1:21j, -1:1:31j]
    return x, y, 0.2 * (x**2 + y**2)


def test_a_surface_faces_up_and_has_its_area(tmp_path):
    x, y, z = surface()
    mesh = PLY_object()
    mesh.draw_surface(torch.tensor(x), y.tolist(), z, color=[10, 20, 30])
    found = trimesh.Trimesh(places(mesh).astype(float), mesh.tris["vertex_indices"], process=False)
    assert len(found.faces) == 2 * 20 * 30 and (found.face_normals[:, 2] > 0).all()
    # The integral of √(1 + 0.16·(x² + y²)) over the square, by a fine midpoint rule.
    middle = (np.arange(400) + 0.5) / 200 - 1
    exact = 4 * np.sqrt(1 + 0.16 * (middle[:, None] ** 2 + middle**2)).mean()
    assert found.area == pytest.approx(exact, rel=1e-3)
    rows = PLY_object()
    rows.draw_surface(x[0], y[:, 0], z)
    assert places(rows) == pytest.approx(places(mesh))


def test_holes_of_a_surface_stay_holes():
    x, y, z = surface()
    z[5, 6] = np.nan
    mesh = PLY_object()
    mesh.draw_surface(x, y, z)
    assert len(mesh.pnts) == 21 * 31 - 1 and np.isfinite(places(mesh)).all()
    # Six triangles met there.
    assert len(mesh.tris) == 2 * 20 * 30 - 6 and mesh.tris["vertex_indices"].max() == len(mesh.pnts) - 1


def test_obj_is_read_back_with_its_colours(tmp_path):
    mesh = PLY_object()
    mesh.draw_a_ray([0.0, 0.0, 0.0], [0.0, 3.0, 50.0], k=2.0, color=[255, 0, 51])
    mesh.draw_triangles(np.eye(3) * 7, color=[0, 102, 255])
    mesh.save_OBJ(tmp_path / "mesh.obj")
    found = trimesh.load(tmp_path / "mesh.obj", force="mesh", process=False)
    assert found.triangles == pytest.approx(places(mesh)[mesh.tris["vertex_indices"]], rel=1e-6)
    shades = np.asarray(found.visual.vertex_colors)[found.faces][:, 0, :3]
    assert shades[0].tolist() == [255, 0, 51] and shades[12].tolist() == [0, 102, 255]


def parts_of(path):
    """Return, for each primitive of a binary glTF file, material, triangles, normals and colours at their corners."""
    content = path.read_bytes()
    assert content[:4] == b"glTF" and struct.unpack_from("<I", content, 8) == (len(content),)
    (length,) = struct.unpack_from("<I", content, 12)
    tree, data = json.loads(content[20 : 20 + length]), content[28 + length :]

    def numbers(index):
        accessor = tree["accessors"][index]
        start = tree["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        kind = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[accessor["componentType"]]
        return np.frombuffer(data, kind, accessor["count"] * width, start).reshape(-1, width)

    for mesh in tree["meshes"]:
        for part in mesh["primitives"]:
            faces = numbers(part["indices"]).reshape(-1, 3)
            normals = numbers(part["attributes"]["NORMAL"])[faces]
            places, light = (numbers(part["attributes"][name])[faces] for name in ("POSITION", "COLOR_0"))
            yield tree["materials"][part["material"]], places, normals, light


def test_gltf_has_linear_colours_normals_and_two_sides(tmp_path):
    mesh = PLY_object()
    mesh.draw_a_ray([0.0, 0.0, 0.0], [0.0, 3.0, 50.0], k=2.0, color=[255, 0, 128])
    mesh.draw_triangles(np.eye(3) * 7, color=[3, 102, 255])
    x, y, z = surface()
    mesh.draw_surface(x, y, z, color=[255, 0, 128])
    mesh.save_glTF(tmp_path / "mesh.glb", unit="mm")
    found, corners = {}, []
    for material, triangles, normals, light in parts_of(tmp_path / "mesh.glb"):
        assert material["doubleSided"] is True
        surface_of = material["pbrMetallicRoughness"]
        assert surface_of["metallicFactor"] == 0.0 and surface_of["roughnessFactor"] == 1.0
        # What is drawn is the product of both.
        assert surface_of["baseColorFactor"] == [1, 1, 1, 1] and light.dtype == np.float32
        (color,) = np.unique(light.reshape(-1, 4), axis=0)
        found[len(triangles)] = color, triangles, normals
        corners.append(triangles)
    # IEC 61966-2-1: 128 is 0.2158605, 3 is 0.0009106, 102 is 0.1328683.
    assert found[12][0] == pytest.approx([1, 0, 0.2158605, 1], rel=1e-5)
    assert found[1][0] == pytest.approx([0.000910584, 0.1328683, 1, 1], rel=1e-5)
    both = np.concatenate(corners)
    wanted = 1e-3 * places(mesh)[mesh.tris["vertex_indices"]]
    order = [np.lexsort(np.round(values.reshape(len(values), -1), 7).T) for values in (both, wanted)]
    assert both[order[0]] == pytest.approx(wanted[order[1]], abs=1e-8)
    for count in (1, 12):
        _, triangles, normals = found[count]
        across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        assert normals == pytest.approx(np.repeat(across[:, None], 3, axis=1), abs=1e-5)
    _, triangles, normals = found[2 * 20 * 30]
    # The gradient of 0.2·(x² + y²), inside of the rim.
    exact = np.concatenate([-0.4 * 1e3 * triangles[..., :2], np.ones_like(triangles[..., :1])], axis=-1)
    exact /= np.linalg.norm(exact, axis=-1, keepdims=True)
    inside = np.abs(triangles[..., :2]).max(-1) < 0.9e-3
    assert np.abs(normals - exact)[inside].max() < 2e-3


def test_colours_of_gltf_are_read_back_by_trimesh(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    mesh, shades = PLY_object(), [[255, 0, 128], [3, 102, 255], [10, 10, 10]]
    mesh.draw_a_ray([0.0, 0.0, 0.0], [0.0, 3.0, 50.0], k=2.0, color=shades[0])
    mesh.draw_triangles(np.eye(3) * 7, color=shades[1])
    mesh.draw_surface(*surface(), color=shades[2])
    mesh.save_glTF(tmp_path / "mesh.glb")
    found = [
        np.unique(part.visual.vertex_attributes["color"], axis=0)
        for part in trimesh.load(tmp_path / "mesh.glb").geometry.values()
    ]
    # Coded again by the inverse of IEC 61966-2-1, they are the colours that were given.
    linear = np.concatenate(found)[:, :3]
    coded = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.array(sorted(coded.tolist())) == pytest.approx(np.array(sorted(shades)), abs=1e-3)


def test_what_cannot_be_saved_or_drawn(tmp_path, monkeypatch):
    mesh = PLY_object()
    for save, name in ((mesh.save_PLY, "a.ply"), (mesh.save_OBJ, "a.obj"), (mesh.save_glTF, "a.glb")):
        with pytest.raises(ValueError, match="the scene is empty"):
            save(tmp_path / name)
    for call, message in (
        (lambda: mesh.draw_a_ray([0, 0, 0], [0, 0]), r"point1 must be \[3\]"),
        (lambda: mesh.draw_a_ray([0, 0, 0], [0, 0, np.inf]), "must be finite"),
        (lambda: mesh.draw_a_ray([0, 0, 0], [0, 0, 1], k=-1.0), "k must be positive"),
        (lambda: mesh.draw_a_ray([0, 0, 0], [0, 0, 1], color=[0, 0, 256]), "three integers from 0 to 255"),
        (lambda: mesh.draw_a_ray([0, 0, 0], [0, 0, 1], color=[0.5, 0, 0]), "three integers from 0 to 255"),
        (lambda: mesh.draw_a_ray([0, 0, 0], [0, 0, 0], perpendicular=True), "must have a length"),
        (lambda: mesh.draw_a_ray(np.zeros((2, 3)), [0, 0, 1]), "use draw_rays"),
        (lambda: mesh.draw_surface([0.0], [0.0], [[0.0]]), "at least 2 by 2"),
        (lambda: mesh.draw_surface([0.0], [0.0, 1.0], np.zeros((2, 2))), r"data_x must be \[2, 2\]"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    assert mesh.pnts is None
    mesh.draw_a_ray([0, 0, 0], [0, 0, 1])
    with pytest.raises(ValueError, match="not allowed"):
        mesh.save_PLY(tmp_path / "a.obj")
    with pytest.raises(ValueError, match="unit must be one of"):
        mesh.save_glTF(tmp_path / "a.glb", unit="inch")
    monkeypatch.setitem(__import__("sys").modules, "trimesh", None)
    with pytest.raises(ImportError, match="pip install trimesh"):
        mesh.save_glTF(tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())
