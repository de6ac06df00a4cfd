"""Files of 3-D Gaussian splatting: properties in their published order, harmonics, and cameras of COLMAP."""

import math
import struct
from argparse import Namespace

import numpy as np
import plyfile
import pytest
import torch

from odak.learn.wave import Scene, complex_3d_gaussians
from odak.learn.wave.gaussians import Splats, load_colmap, load_splats, save_splats, spherical_harmonics, view_colours


def splats(count=5, degree=3, seed=0):
    draw = torch.Generator().manual_seed(seed)
    shapes = ((count, 3), (count, 4), (count, 3), (count,), (count, (degree + 1) ** 2, 3))
    return Splats(*(torch.randn(shape, generator=draw) for shape in shapes))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_files_are_read_back(degree, tmp_path):
    written = splats(degree=degree)
    save_splats(tmp_path / "a.ply", written)
    assert all(torch.equal(a, b) for a, b in zip(written, load_splats(tmp_path / "a.ply"), strict=True))
    vertices = plyfile.PlyData.read(tmp_path / "a.ply")["vertex"]
    names = [entry.name for entry in vertices.properties]
    # The order of the published program: positions, normals, harmonics, opacity, scales, rotations.
    rest = [f"f_rest_{i}" for i in range(3 * ((degree + 1) ** 2 - 1))]
    assert names == [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest, "opacity"),
        *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]
    if degree:
        # All coefficients of red come first.
        assert vertices["f_rest_0"][2] == written.harmonics[2, 1, 0]
        assert vertices["f_rest_1"][2] == written.harmonics[2, 2 if degree > 0 else 0, 0]
        assert vertices[f"f_rest_{len(rest) // 3}"][2] == written.harmonics[2, 1, 1]


def test_broken_files_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no file .*a\.ply"):
        load_splats(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    with pytest.raises(ValueError, match=r"a\.ply' cannot be read as Gaussians"):
        load_splats(tmp_path / "a.ply")
    vertices = np.zeros(2, dtype=[(name, "f4") for name in ("x", "y", "z", "f_rest_0")])
    plyfile.PlyData([plyfile.PlyElement.describe(vertices, "vertex")]).write(tmp_path / "b.ply")
    with pytest.raises(ValueError, match="fit no degree of spherical harmonics"):
        load_splats(tmp_path / "b.ply")
    with pytest.raises(ValueError, match="harmonics must be 1, 4, 9 or 16"):
        save_splats(tmp_path / "c.ply", splats()._replace(harmonics=torch.zeros(5, 5, 3)))


def test_harmonics_are_orthonormal_and_rotate_as_published():
    # Gauss-Legendre quadrature, exact for products of degree 6.
    height, weight = np.polynomial.legendre.leggauss(8)
    angle = np.arange(16) * 2 * np.pi / 16
    z, phi = (torch.from_numpy(a) for a in np.meshgrid(height, angle, indexing="ij"))
    ring = (1 - z**2).sqrt()
    directions = torch.stack([ring * phi.cos(), ring * phi.sin(), z], dim=-1)
    basis = spherical_harmonics(3, directions)
    products = torch.einsum("i,ijk,ijl->kl", torch.from_numpy(weight) * 2 * math.pi / 16, basis, basis)
    torch.testing.assert_close(products, torch.eye(16, dtype=torch.float64), rtol=0, atol=1e-12)
    # Constants of the published program (utils/sh_utils.py of 3-D Gaussian splatting).
    at = spherical_harmonics(3, torch.tensor([0.48, 0.6, 0.64], dtype=torch.float64))
    x, y, z = 0.48, 0.6, 0.64
    expected = [0.28209479177387814, -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    expected += [1.0925484305920792 * x * y, -1.0925484305920792 * y * z]
    expected += [0.31539156525252005 * (2 * z * z - x * x - y * y), -1.0925484305920792 * x * z]
    expected += [0.5462742152960396 * (x * x - y * y), -0.5900435899266435 * y * (3 * x * x - y * y)]
    expected += [2.890611442640554 * x * y * z, -0.4570457994644658 * y * (4 * z * z - x * x - y * y)]
    expected += [0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y)]
    expected += [-0.4570457994644658 * x * (4 * z * z - x * x - y * y), 1.445305721320277 * z * (x * x - y * y)]
    expected += [-0.5900435899266435 * x * (x * x - 3 * y * y)]
    assert at.tolist() == pytest.approx(expected, rel=1e-12)


def test_colours_of_a_direction():
    harmonics = torch.zeros(2, 4, 3, dtype=torch.float64)
    harmonics[0, 0] = torch.tensor([0.3, -5.0, 0.0])
    harmonics[1, 2, 1] = 0.2
    towards = torch.tensor([[0.0, 0, 1], [0, 0, 1]], dtype=torch.float64)
    seen = view_colours(harmonics, towards)
    assert seen[0].tolist() == pytest.approx([0.5 + 0.3 * 0.28209479177387814, 0.0, 0.5])
    assert seen[1].tolist() == pytest.approx([0.5, 0.5 + 0.2 * 0.4886025119029199, 0.5])


def colmap_files(folder, binary):
    """Write two images of known pose; return the poses (rotation of columns, shift) and intrinsics."""
    cameras = {3: ("PINHOLE", 64, 48, [70.0, 60.0, 33.0, 20.0]), 7: ("SIMPLE_PINHOLE", 30, 40, [50.0, 15.0, 21.0])}
    poses = {
        "b.png": ([0.9, 0.1, -0.3, 0.2], [0.4, -0.2, 5.0], 3),
        "a b.png": ([0.2, 0.8, 0.1, 0.3], [0.0, 0.3, 6.0], 7),
    }
    if binary:
        content = struct.pack("<Q", 2)
        for number, (model, width, height, values) in cameras.items():
            kind = {"PINHOLE": 1, "SIMPLE_PINHOLE": 0}[model]
            content += struct.pack(f"<iiQQ{len(values)}d", number, kind, width, height, *values)
        (folder / "cameras.bin").write_bytes(content)
        content = struct.pack("<Q", 2)
        for i, (name, (quaternion, shift, number)) in enumerate(poses.items()):
            content += struct.pack("<i7di", i, *quaternion, *shift, number) + name.encode() + b"\0"
            content += struct.pack("<Q", i) + i * struct.pack("<ddq", 1.0, 2.0, 3)
        (folder / "images.bin").write_bytes(content)
    else:
        lines = [" ".join(map(str, (n, model, w, h, *v))) for n, (model, w, h, v) in cameras.items()]
        (folder / "cameras.txt").write_text("# cameras\n" + "\n".join(lines) + "\n")
        lines = [" ".join(map(str, (i, *q, *t, n, name))) for i, (name, (q, t, n)) in enumerate(poses.items())]
        (folder / "images.txt").write_text("# images\n" + "\n\n".join(lines) + "\n1.0 2.0 3\n")
    return cameras, poses


@pytest.mark.parametrize("binary", [False, True])
def test_cameras_of_colmap_see_points_where_colmap_does(binary, tmp_path):
    from scipy.spatial.transform import Rotation

    cameras, poses = colmap_files(tmp_path, binary)
    views = load_colmap(tmp_path)
    assert [view.name for view in views] == sorted(poses)
    points = np.random.default_rng(0).normal(size=(20, 3))
    settings = Namespace(num_planes=1)
    model = complex_3d_gaussians("random", "cpu", num_points=1, args_prop=settings)
    for view in views:
        (w, *xyz), shift, number = poses[view.name]
        seen = Rotation.from_quat([*xyz, w]).apply(points) + shift
        _, width, height, values = cameras[number]
        fx, fy, cx, cy = values if len(values) == 4 else (values[0], values[0], *values[1:])
        expected = np.stack([fx * seen[:, 0] / seen[:, 2] + cx, fy * seen[:, 1] / seen[:, 2] + cy], axis=-1)
        # COLMAP counts from the corner of the first pixel, pictures of odak from its middle.
        expected -= 0.5
        inside = seen[:, 2] > 1.5
        assert inside.sum() > 5 and view.size == (width, height)
        at = view.camera.transform_world_to_camera_space(torch.from_numpy(points).float())
        found = model.compute_means_2D(at, *view.camera.focal_length, *view.camera.principal_point)
        assert found[inside].numpy() == pytest.approx(expected[inside], abs=1e-3)


def test_what_is_no_reconstruction(tmp_path):
    with pytest.raises(FileNotFoundError, match="neither cameras"):
        load_colmap(tmp_path)
    colmap_files(tmp_path, True)
    whole = (tmp_path / "images.bin").read_bytes()
    (tmp_path / "images.bin").write_bytes(whole[:70])
    with pytest.raises(ValueError, match=r"images\.bin' cannot be read"):
        load_colmap(tmp_path)
    (tmp_path / "images.bin").write_bytes(whole)
    radial = [(number, 2, 64, 48, 70.0, 33.0, 20.0) for number in (3, 7)]
    for coefficient in (-0.05, 0.0):
        cameras = [struct.pack("<iiQQ4d", *camera, coefficient) for camera in radial]
        (tmp_path / "cameras.bin").write_bytes(struct.pack("<Q", 2) + b"".join(cameras))
        if coefficient:
            with pytest.raises(ValueError, match=r"SIMPLE_RADIAL has distortion.*image_undistorter .* read OUT/sparse"):
                load_colmap(tmp_path)
    assert load_colmap(tmp_path)[0].camera.focal_length.tolist() == [70, 70]
    for file in tmp_path.iterdir():
        file.unlink()
    colmap_files(tmp_path, False)
    (tmp_path / "cameras.txt").write_text("3 PINHOLE 64 48 70 60 33 20\n")
    with pytest.raises(ValueError, match="names camera 7"):
        load_colmap(tmp_path)


def test_gaussians_of_a_splatting_file_become_complex_ones(tmp_path):
    given = splats(30)
    given = given._replace(means=given.means * 0.5, scales=given.scales * 0.1 - 2)
    save_splats(tmp_path / "a.ply", given)
    settings = Namespace(
        num_planes=2,
        wavelengths=[639e-9, 532e-9, 473e-9],
        pixel_pitch=8e-6,
        distances=[1e-3, 2e-3],
        pad_size=[24, 32],
        aperture_size=-1,
    )
    model = complex_3d_gaussians("gaussians", "cpu", load_path=tmp_path / "a.ply", args_prop=settings, seed=1)
    assert torch.equal(model.means, given.means) and torch.equal(model.pre_act_opacities, given.opacities)
    colours = (0.5 + 0.28209479177387814 * given.harmonics[:, 0]).clamp_min(0)
    torch.testing.assert_close(model.colours.detach(), colours)
    colmap_files(tmp_path, True)
    hologram, fields = Scene(model, settings).render(load_colmap(tmp_path)[1].camera, (32, 24))
    assert hologram.shape == (3, 24, 32) and bool(fields.abs().max() > 0.01)


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        ([], False),
        (["SplatRenderMode: mip"], True),
        (["Exported from Brush", "splatrendermode:  MIP"], True),
        (["SplatRenderMode: default"], False),
        (["antialiased 1"], True),
        (["antialiased 0"], False),
        (["antialiased 1", "SplatRenderMode: default"], False),
        (["not antialiased 1"], False),
    ],
)
def test_antialiased_training_is_found_in_the_comments_of_a_file(comments, expected, tmp_path):
    path = tmp_path / "scene.ply"
    save_splats(
        path, Splats(torch.zeros(2, 3), torch.ones(2, 4), torch.zeros(2, 3), torch.zeros(2), torch.zeros(2, 1, 3))
    )
    lines = "".join(f"comment {line}\n" for line in comments).encode()
    path.write_bytes(path.read_bytes().replace(b"element vertex", lines + b"element vertex", 1))
    options = {"load_path": path, "args_prop": Namespace(num_planes=1)}
    assert complex_3d_gaussians("gaussians", "cpu", **options).antialiased is expected
    assert complex_3d_gaussians("gaussians", "cpu", antialiased=not expected, **options).antialiased is not expected
