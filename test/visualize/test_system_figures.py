"""A lens system in space: its rays are those of the trace, its glass has the shape of the surfaces."""

import numpy as np
import pytest
import torch

from odak.learn.raytracing.system import launch, layout_figure, load_system, optical_system, surface, trace
from odak.visualize.plotly import system_show


def fields(picture):
    return [part for part in picture.fig.data if part.type == "scatter3d" and part.showlegend]


def lines(part, stations):
    places = np.stack([part.x, part.y, part.z], axis=-1)
    return np.concatenate([places, np.full((1, 3), np.nan)]).reshape(-1, stations + 1, 3)[:, :-1]


def test_rays_are_those_of_the_trace():
    system = load_system("cooke_triplet")
    picture = system_show(system, rings=2, show=False)
    rays = launch(system, "rings", 2)
    ends = trace(system, rays)
    length = sum(float(item.thickness) for item in system.surfaces)
    shown = fields(picture)
    assert len(shown) == len(system.fields)
    for i, part in enumerate(shown):
        paths = lines(part, len(system.surfaces) + 2)
        assert paths.shape[0] == 19
        wanted = torch.stack([ends.x, ends.y, ends.z + length], -1)[system.reference, i].detach()
        assert paths[:, -1] == pytest.approx(wanted.numpy(), nan_ok=True)
        # In front of the first surface they run as they were launched.
        along = torch.stack([rays.u, rays.v, rays.w], -1)[0, i].detach().numpy()
        steps = paths[:, 1] - paths[:, 0]
        assert steps / np.linalg.norm(steps, axis=-1, keepdims=True) == pytest.approx(along)
    assert [part.name for part in shown] == ["field 0°", "field 14°", "field 20°"]


def test_glass_has_the_shape_of_its_surfaces():
    tilt = (3.0, -5.0)
    front = surface(20.0, conic=-0.5, coefficients=[0.0, 1e-5], thickness=5.0, material="N-BK7", semi_diameter=6.0)
    back = surface(-30.0, thickness=40.0, semi_diameter=6.0, tilt=tilt, shift=(0.5, 0.0))
    picture = system_show(optical_system([front, back], aperture=8.0), show=False)
    glass = next(part for part in picture.fig.data if part.name == "element 1")
    places = np.stack([glass.x, glass.y, glass.z], axis=-1)
    first, second = places[: len(places) // 2], places[len(places) // 2 :]
    r2 = (first[:, :2] ** 2).sum(-1)
    assert first[:, 2] == pytest.approx(r2 / 20 / (1 + np.sqrt(1 - 0.5 * r2 / 400)) + 1e-5 * r2**2)
    assert np.sqrt(r2).max() == pytest.approx(6.0)
    # The back is a sphere, whose centre has been turned about the shifted vertex: about x, then about y.
    a, b = np.radians(tilt)
    axis = np.array([np.sin(b) * np.cos(a), -np.sin(a), np.cos(b) * np.cos(a)])
    centre = np.array([0.5, 0.0, 5.0]) - 30 * axis
    assert np.linalg.norm(second - centre, axis=-1) == pytest.approx(np.full(len(second), 30.0))
    # A closed body: each edge belongs to two triangles, but for those at the two vertices, which are single points.
    faces = np.stack([glass.i, glass.j, glass.k], axis=-1)
    assert faces.min() == 0 and faces.max() == len(places) - 1


def test_where_rays_meet_a_tilted_surface_glass_is():
    system = optical_system(
        [surface(25.0, thickness=4.0, material="N-BK7", tilt=(10.0, 0.0)), surface(thickness=30.0)], aperture=6.0
    )
    picture = system_show(system, rings=3, show=False)
    (part,) = fields(picture)
    met = lines(part, 4)[:, 1]
    a = np.radians(10.0)
    centre = 25.0 * np.array([0.0, -np.sin(a), np.cos(a)])
    assert np.linalg.norm(met - centre, axis=-1) == pytest.approx(np.full(len(met), 25.0))


def test_a_lost_ray_ends_where_it_was_last():
    system = optical_system(
        [surface(10.0, thickness=2.0, material="N-BK7", semi_diameter=2.0), surface(thickness=10.0)], aperture=8.0
    )
    (part,) = fields(system_show(system, rings=4, show=False))
    paths = lines(part, 4)
    lost = np.isnan(paths[:, -1]).any(-1)
    assert 0 < lost.sum() < len(paths)
    assert np.isfinite(paths[lost][:, 0]).all()


def test_mirrors_near_objects_and_pictures_of_parameters():
    mirror = surface(-50.0, material="mirror", thickness=-30.0)
    mirror.vary("curvature")
    system = optical_system([mirror], aperture=10.0, fields=[0.0, (1.0, 2.0)], object_distance=25.0, unit="mm")
    picture = system_show(system, show=False)
    assert [part.name for part in picture.fig.data if part.type == "mesh3d"] == ["mirror", "image plane"]
    assert [part.name for part in fields(picture)] == ["field 0 mm", "field (1, 2) mm"]
    starts = lines(fields(picture)[1], 3)[:, 0]
    assert starts == pytest.approx(np.tile([1.0, 2.0, -25.0], (len(starts), 1)))
    picture.update_layout()
    scene = picture.fig.layout.scene
    assert scene.aspectmode == "data" and scene.zaxis.title.text == "z (mm)"
    assert scene.camera.up.y == 1 and scene.camera.eye.x < 0


@pytest.mark.parametrize("name", ["cooke_triplet", "double_gauss"])
def test_everything_is_in_the_frame(name):
    picture = system_show(load_system(name), show=False)
    scene = picture.fig.layout.scene
    ranges = np.array([scene[f"{axis}axis"].range for axis in "xyz"])
    sides = np.diff(ranges)[:, 0]
    eye, up = (np.array([vector.x, vector.y, vector.z]) for vector in (scene.camera.eye, scene.camera.up))
    for part in picture.fig.data:
        points = np.stack([np.asarray(part[axis], float).ravel() for axis in "xyz"], axis=-1)
        points = (points[np.isfinite(points).all(-1)] - ranges.mean(1)) / np.prod(sides) ** (1 / 3)
        right = np.cross(up, eye)
        x, y = ((points @ v) / np.linalg.norm(v) for v in (right, np.cross(eye, right)))
        depth = np.linalg.norm(eye) - points @ eye / np.linalg.norm(eye)
        half = np.tan(np.pi / 8) * depth
        assert np.all(np.abs(y) < half) and np.all(np.abs(x) < half * 1080 / 520)


def test_only_systems_are_taken(tmp_path):
    with pytest.raises(TypeError, match="system must be an odak"):
        system_show("cooke_triplet")
    system_show(load_system("cooke_triplet"), title="Triplet", filename=tmp_path / "lens.html")
    assert "Triplet" in (tmp_path / "lens.html").read_text(encoding="utf-8")


def test_sections_and_scenes_show_the_same_rays():
    """Rays of a near object are drawn once, and those of a telescope end behind it, not 1 m away."""
    near = optical_system(
        [surface(20.0, thickness=4.0, material="N-BK7"), surface(-20.0, thickness=100.0)],
        aperture=6.0,
        object_distance=80.0,
    )
    telescope = optical_system(
        [surface(50.0, thickness=4.0, material="N-BK7"), surface(-50.0, thickness=10.0)], aperture=8.0, afocal=True
    )
    for system, start, end in ((near, -80.0, 104.0), (telescope, None, 14.0)):
        drawn = [line for line in layout_figure(system, count=3).axes[0].lines if len(line.get_xdata()) == 4]
        (part,) = fields(system_show(system, pattern="y", rings=3, show=False))
        for line, ray in zip(drawn, lines(part, 4), strict=False):
            z, y = line.get_data()
            assert (np.diff(z) > 0).all() and z[-1] == pytest.approx(end) == ray[-1, 2]
            assert start is None or z[0] == start == ray[0, 2]
            assert y[1:] == pytest.approx(ray[1:, 1])
        assert len(drawn) == 3
