"""Lenses as solids: volumes against spherical caps, closed meshes, files of each format."""

import math
import struct
from collections import Counter

import numpy as np
import pytest

from odak.learn.raytracing.system import lens_solids, load_system, optical_system, save_solids, surface
from odak.tools.asset import read_mesh


def cap(radius, reach):
    """Return the volume and the height of a spherical cap, negative for a negative radius."""
    height = abs(radius) - math.sqrt(radius**2 - reach**2)
    return (
        math.copysign(math.pi * height**2 * (3 * abs(radius) - height) / 3, radius),
        math.copysign(height, radius),
    )


def stepped():
    """Return a biconvex lens whose back is clear to 9 of 12 mm, a plane annulus beyond, and its volume."""
    faces = [
        surface(50.0, thickness=8.0, material="N-BK7", semi_diameter=12.0),
        surface(-80.0, thickness=90.0, semi_diameter=9.0),
    ]
    (front, ahead), (back, behind) = cap(50.0, 12.0), cap(80.0, 9.0)
    return optical_system(faces, aperture=10.0), math.pi * 12**2 * (8 - ahead - behind) + front + back


def edges(faces):
    """Return how often each directed edge is there."""
    return Counter(edge for face in faces.tolist() for edge in zip(face, face[1:] + face[:1], strict=True))


def test_the_volume_converges_to_that_of_spherical_caps():
    lens, exact = stepped()
    coarse, fine = (lens_solids(lens, count)[0].volume for count in (48, 96))
    assert fine == pytest.approx(exact, rel=1e-3) and coarse < fine < exact
    # The error of a polygon falls with the square of its sides, so that two meshes give the limit.
    assert (4 * fine - coarse) / 3 == pytest.approx(exact, rel=2e-6)


def test_meshes_are_closed_and_turned_outwards():
    """Each edge is there once in either direction, also of glass in front of a mirror, where light runs back."""
    folded = [
        surface(-100.0, thickness=-5.0, material="mirror", semi_diameter=20.0),
        surface(-80.0, thickness=-4.0, material="N-BK7", semi_diameter=10.0),
        surface(-90.0, thickness=-30.0, semi_diameter=10.0),
    ]
    for system in (load_system("cooke_triplet"), stepped()[0], optical_system(folded, aperture=10.0)):
        for solid in lens_solids(system, 12):
            found = edges(solid.faces)
            assert set(found.values()) == {1} and all((b, a) in found for a, b in found)
            # Euler's number of a sphere.
            assert len(solid.vertices) - len(found) / 2 + len(solid.faces) == 2
            assert solid.volume > 0


def test_a_wedge_has_the_volume_under_its_tilted_plane():
    """A plane turned about its vertex takes from one side of a cylinder what it gives to the other."""
    faces = [
        surface(thickness=6.0, material="N-BK7", semi_diameter=8.0),
        surface(thickness=40.0, semi_diameter=8.0, tilt=(2.0, 0.0, 0.0)),
    ]
    (solid,) = lens_solids(optical_system(faces, aperture=8.0), 256)
    # The rim of the turned face is a circle in its own plane, smaller by 1 - cos 2° = 6e-4 along one axis.
    assert solid.volume == pytest.approx(math.pi * 64 * 6, rel=1e-3)
    assert solid.vertices[:, 2].max() - 6 == pytest.approx(8 * math.sin(math.radians(2)), rel=1e-9)


def test_files_hold_the_meshes(tmp_path):
    lens, _ = stepped()
    (solid,) = lens_solids(lens, 24)
    for name in ("lens.stl", "lens.ply"):
        save_solids(lens, tmp_path / name, 24)
    vertices, faces = read_mesh(str(tmp_path / "lens.ply"))
    assert np.array_equal(vertices, solid.vertices) and np.array_equal(faces, solid.faces)
    data = (tmp_path / "lens.stl").read_bytes()
    (count,) = struct.unpack("<I", data[80:84])
    assert count == len(solid.faces) and len(data) == 84 + 50 * count
    first = struct.unpack("<12f", data[84:132])
    assert first[3:] == pytest.approx(solid.vertices[solid.faces[0]].ravel().tolist(), abs=1e-6)
    # The first triangle is at the vertex in front, whose normal points to the light.
    assert first[2] < -0.99


@pytest.mark.slow
def test_gltf_has_each_lens_in_metres(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    triplet = load_system("cooke_triplet")
    save_solids(triplet, tmp_path / "triplet.glb", 24)
    found = trimesh.load(tmp_path / "triplet.glb").geometry
    for solid in lens_solids(triplet, 24):
        mesh = found[f"lens {solid.surfaces[0]}"]
        assert mesh.is_watertight and mesh.volume == pytest.approx(1e-9 * solid.volume, rel=1e-5)


def read_step(path):
    """Return the volumes of the solids of a file, by OpenCascade."""
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_SOLID
    from OCP.TopExp import TopExp_Explorer

    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    walk, found = TopExp_Explorer(reader.OneShape(), TopAbs_SOLID), []
    while walk.More():
        assert BRepCheck_Analyzer(walk.Current()).IsValid()
        properties = GProp_GProps()
        BRepGProp.VolumeProperties_s(walk.Current(), properties, 1e-9)
        found.append(properties.Mass())
        walk.Next()
    return found


def test_step_has_exact_spheres_and_close_aspheres(tmp_path):
    pytest.importorskip("OCP")
    lens, exact = stepped()
    save_solids(lens, tmp_path / "lens.step")
    assert read_step(tmp_path / "lens.step") == pytest.approx([exact], rel=1e-10)
    bowl = [
        surface(20.0, conic=-1.0, thickness=6.0, material="N-BK7", semi_diameter=8.0),
        surface(thickness=40.0, semi_diameter=8.0),
    ]
    save_solids(optical_system(bowl, aperture=8.0), tmp_path / "bowl.stp")
    # A paraboloid fills half of its cylinder.
    height = 8**2 / 40
    assert read_step(tmp_path / "bowl.stp") == pytest.approx([math.pi * 64 * (6 - height / 2)], rel=1e-6)


@pytest.mark.parametrize("name", ["lens.glb", "lens.step"])
def test_missing_packages_are_named(name, tmp_path, monkeypatch):
    for package in ("trimesh", "OCP", "OCP.BRepBuilderAPI"):
        monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(ImportError, match=r"pip install (trimesh|cadquery-ocp)"):
        save_solids(stepped()[0], tmp_path / name)


def test_what_is_no_solid_is_named(tmp_path):
    thin = [
        surface(20.0, thickness=1.0, material="N-BK7", semi_diameter=8.0),
        surface(thickness=40.0, semi_diameter=8.0),
    ]
    lens = optical_system(thin, aperture=4.0)
    with pytest.raises(ValueError, match=r"surfaces\[0\] and surfaces\[1\] must not cross, got a thickness of -0.67"):
        lens_solids(lens)
    assert lens_solids(lens, diameters=6.0)[0].diameter == 6.0
    with pytest.raises(ValueError, match="diameters must be of elements behind the surfaces 0, got 3"):
        lens_solids(lens, diameters={3: 2.0})
    with pytest.raises(ValueError, match="system must have a lens"):
        lens_solids(optical_system([surface(-80.0, thickness=-40.0, material="mirror")], aperture=4.0))
    with pytest.raises(ValueError, match="Extension"):
        save_solids(lens, tmp_path / "lens.obj")
