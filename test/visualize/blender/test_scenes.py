"""Scenes for Blender as plain data; none of these tests needs Blender."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from odak.catalog import refractive_index
from odak.learn.perception.color import rgb_to_linear_rgb
from odak.learn.raytracing import planar_mesh, triangle_mesh
from odak.learn.raytracing.system import load_system, optical_system, surface
from odak.raytracing import OddAsphere
from odak.tools import save_image, write_PLY
from odak.visualize import _arrays, blender

ROD = 16  # vertices of a rod
LINE = [[[0.0, 0, 0], [0, 0, 1]], [[1.0, 0, 0], [0, 0.6, 0.8]]]


@pytest.fixture
def picture():
    return blender.scene(unit="mm", resolution=(60, 80))


def ends_of(item):
    """Return the two ends of each rod, ``[m, 2, 3]``."""
    return item.placed_vertices().reshape(-1, 2, ROD // 2, 3).mean(axis=2)


def test_every_public_name_resolves():
    for name in blender.__all__:
        assert getattr(blender, name) is not None
    assert set(blender.__all__) < set(dir(blender))


def test_import_needs_neither_torch_nor_blender():
    code = (
        "import sys; from odak.visualize import blender; s = blender.scene(); s.add_rays([[0, 0, 0], [0, 0, 1]], 3);"
        "s.add_lens([50, -50], 4, 20); print(sorted({'bpy', 'torch', 'plotly', 'dask'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


@pytest.mark.parametrize("kind", [np.asarray, torch.tensor, list, lambda v: torch.tensor(v, requires_grad=True)])
def test_rays_become_rods_of_their_length(picture, kind):
    item = picture.add_rays(kind(LINE), distance=[5.0, 10.0], radius=0.01)
    assert np.allclose(ends_of(item), [[[0, 0, 0], [0, 0, 5]], [[1, 0, 0], [1, 6, 8]]], atol=1e-5)
    assert item.material.kind == "emission" and item.material.color == (1.0, 0.0, 0.0)
    assert np.allclose(item.rods[..., :3], ends_of(item), atol=1e-5) and (item.rods[..., 3] == np.float32(0.01)).all()
    assert picture.add_rays(kind(LINE), material=blender.diffuse()).rods is None


def test_lost_rays_are_left_out_with_their_colours(picture):
    rays = np.array([LINE[0], np.full((2, 3), np.nan), LINE[1]])
    item = picture.add_rays(rays, distance=2.0, color=[[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert len(ends_of(item)) == 2
    assert np.allclose(item.colors.reshape(2, ROD, 3), [[[1, 0, 0]], [[0, 0, 1]]])
    item = picture.add_rays(LINE, distance=[np.inf, 2.0], color=[[1, 0, 0], [0, 1, 0]])
    assert np.allclose(item.colors, [[0, 1, 0]])
    with pytest.raises(ValueError, match="rays must be finite"):
        picture.add_rays(rays[1:2])


def test_paths_end_where_they_are_lost(picture):
    path = np.array([[0, 0, 0], [0, 0, 1], [0, 1, 2], [0, 5, 5.0]])
    lost = path.copy()
    lost[2] = np.nan
    item = picture.add_lines([path, lost], radius=0.01)
    assert np.allclose(ends_of(item), [path[[0, 1]], path[[1, 2]], path[[2, 3]], path[[0, 1]]], atol=1e-5)
    assert len(ends_of(picture.add_lines(path))) == 3


def test_points_become_balls(picture):
    places = np.array([[0, 0, 0], [0, 0, 7], [np.nan, 0, 0]])
    item = picture.add_points(places, radius=0.5, color=[[1, 1, 1], [0, 1, 0], [0, 0, 1]])
    balls = item.vertices.reshape(2, -1, 3)
    assert np.allclose(np.linalg.norm(balls - places[:2, None], axis=-1), 0.5, atol=1e-6)
    assert np.allclose(item.colors.reshape(2, -1, 3)[:, 0], [[1, 1, 1], [0, 1, 0]])


def test_meshes_of_all_kinds_are_one(picture, tmp_path):
    mesh = planar_mesh(size=[4.0, 2.0], number_of_meshes=[3, 3], offset=torch.tensor([0.0, 0.0, 5.0]))
    triangles = mesh.get_triangles()
    write_PLY(triangles.detach().numpy(), str(tmp_path / "Bunny.ply"))
    shared = mesh.get_mesh()
    items = [
        picture.add_mesh(mesh),
        picture.add_mesh(triangles),
        picture.add_mesh(str(tmp_path / "Bunny.ply")),
        picture.add_mesh(shared.vertices, shared.faces),
        picture.add_mesh(triangle_mesh(shared.vertices.detach(), shared.faces)),
    ]
    expected = triangles.detach().numpy()
    for item in items:
        assert np.allclose(item.vertices[item.faces], expected)
    assert [item.name for item in items] == ["mesh", "mesh.001", "Bunny", "mesh.002", "mesh.003"]


def test_place_of_an_object_is_scale_rotation_shift(picture):
    item = picture.add_mesh(np.eye(3), location=[5, 6, 7], rotation=[90, 0, 90], scale=[2, 3, 4])
    # X first: y goes to z; then Z: x goes to y.
    assert np.allclose(item.placed_vertices(), [[5, 8, 7], [5, 6, 10], [9, 6, 7]])


def test_parametric_surface_is_sampled_from_end_to_end(picture):
    torus = picture.add_surface(
        lambda u, v: ((3 + np.cos(v)) * np.cos(u), (3 + np.cos(v)) * np.sin(u), np.sin(v)),
        u=(0, 2 * math.pi),
        v=(0, 2 * math.pi),
        resolution=(65, 129),
    )
    x, y, z = torus.vertices.T
    assert np.allclose((np.hypot(x, y) - 3) ** 2 + z**2, 1, atol=1e-5)
    a, b, c = (torus.vertices[torus.faces[:, i]].astype(float) for i in range(3))
    volume = np.sum(np.cross(a, b) * c) / 6
    assert volume == pytest.approx(2 * math.pi**2 * 3, rel=5e-3)


def test_surface_takes_heights_and_points_alike(picture):
    x, y = np.meshgrid(np.linspace(-2, 2, 5), np.linspace(-1, 1, 4))
    height = x + 10 * y
    items = [
        picture.add_surface(height, size=[4, 2]),
        picture.add_surface(x, y, height),
        picture.add_surface(lambda u, v: (u, v, u + 10 * v), u=(-2, 2), v=(-1, 1), resolution=(4, 5)),
        picture.add_surface(
            lambda u, v: torch.stack([torch.tensor(part) for part in (u, v, u + 10 * v)], -1),
            u=(-2, 2),
            v=(-1, 1),
            resolution=(4, 5),
        ),
    ]
    for item in items:
        assert np.allclose(item.vertices, np.stack((x, y, height), -1).reshape(-1, 3))
        assert np.array_equal(item.faces, items[0].faces)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda s: s.add_rays([[0, 0], [0, 1]]), ValueError, "rays must be"),
        (lambda s: s.add_rays(LINE, distance=[1, 2, 3]), ValueError, "distance must be one number or one for each"),
        (lambda s: s.add_rays(LINE, color=[[1, 0, 0]] * 3), ValueError, "color must be"),
        (lambda s: s.add_rays(LINE, color="no such colour"), ValueError, "color must be a name"),
        (lambda s: s.add_rays(LINE, radius=-1), ValueError, "radius must be positive"),
        (lambda s: s.add_lines([[0, 0, 0]]), ValueError, "points must be"),
        (lambda s: s.add_points([np.nan, 0, 0]), ValueError, "points must have at least one finite point"),
        (lambda s: s.add_mesh([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]]), ValueError, "mesh must be finite"),
        (lambda s: s.add_mesh(np.zeros((3, 3)), [[0, 1, 3]]), ValueError, "faces must be indices of vertices, 0 to 2"),
        (lambda s: s.add_mesh(np.zeros((3, 3)), [[0.0, 1.0, 2.0]]), ValueError, "faces must be integers"),
        (lambda s: s.add_mesh("mesh.obj"), ValueError, r"'\.obj'"),
        (lambda s: s.add_surface(np.zeros((3, 4))), ValueError, "size must be"),
        (lambda s: s.add_surface(lambda u, v: (u, v)), ValueError, "surface must give x, y, z"),
        (lambda s: s.add_surface(lambda u, v: (u, v, u * np.nan)), ValueError, "surface must be finite"),
        (lambda s: s.add_sphere(radius=0), ValueError, "radius must be positive"),
        (lambda s: s.add_sphere(material="N-BK77"), ValueError, "N-BK7"),
        (lambda s: s.add_sphere(material=[1, 2]), TypeError, "material must be a Material"),
        (lambda s: s.add_cylinder([0, 0, 0], [0, 0, 0], 1), ValueError, "start and end must be different points"),
        (lambda s: s.add_image(np.full((2, 2), 2.0), [1, 1]), ValueError, "image of floats must be from 0 to 1"),
        (lambda s: s.add_image(np.zeros((2, 2, 2)), [1, 1]), ValueError, "image must be"),
        (lambda s: s.add_camera([0, 0, 0], [0, 0, 0]), ValueError, "location and target must be different points"),
        (lambda s: s.add_camera([0, 0, 1], up=[0, 0, 1]), ValueError, "up must not be parallel"),
        (lambda s: s.add_camera(fov=180), ValueError, "fov must be below 180"),
        (lambda s: s.add_camera(projection="ortographic"), ValueError, "Did you mean 'orthographic'"),
        (lambda s: s.add_camera(clip=[2, 1]), ValueError, "clip must be"),
        (lambda s: s.add_light([0, 0, 1], kind="spot"), ValueError, "kind must be one of"),
        (lambda s: s.add_light([0, 0, 1], power=-1), ValueError, "power must be positive"),
        (lambda s: s.set_background(strength=-1), ValueError, "strength must be at least 0"),
        (lambda s: s.render("picture.jpg"), ValueError, r"'\.jpg'"),
        (lambda s: s.render(resolution=(2, 9)), ValueError, "resolution must be at least 4 rows and columns"),
        (lambda s: s.render(samples=0), ValueError, "samples must be at least 1"),
        (lambda s: s.render(device="tpu"), ValueError, "device must be one of"),
        (lambda s: s.save("scene.obj"), ValueError, r"'\.obj'"),
        (lambda s: s.find("nothing"), ValueError, "name must be one of the objects"),
        (lambda _: blender.scene(unit="inch"), ValueError, "unit must be one of"),
        (lambda _: blender.diffuse([1, 2, 3]), ValueError, "color must be red, green, blue from 0 to 1"),
        (lambda _: blender.metal(roughness=2), ValueError, "roughness must be from 0 to 1"),
    ],
)
def test_what_is_wrong_is_named(picture, call, error, words):
    picture.add_sphere(name="ball")
    with pytest.raises(error, match=words):
        call(picture)
    assert [item.name for item in picture.objects] == ["ball"]


def test_glass_has_the_index_of_the_catalogue():
    picture = blender.scene(unit="mm", wavelength=633e-6)
    ball = picture.add_sphere(material="N-BK7")
    assert ball.material.index == refractive_index("N-BK7", 633e-9, medium="air")
    assert blender.glass("SF11").index == refractive_index("SF11", 587.5618e-9, medium="air")
    assert picture.add_sphere(material=1.7).material.index == 1.7
    assert picture.add_sphere(material="mirror", color="gold").material.kind == "metal"


@given(st.lists(st.floats(0, 1), min_size=3, max_size=3))
def test_colours_are_srgb(color):
    expected = rgb_to_linear_rgb(torch.tensor(color, dtype=torch.float64).reshape(1, 3, 1, 1)).flatten()
    assert np.allclose(blender.diffuse(color).color, expected, atol=1e-9)
    assert np.allclose(_arrays.coded_light(blender.diffuse(color).color), color, atol=1e-6)


def test_colour_names():
    assert blender.diffuse("#ff0080").color == blender.diffuse([1, 0, 128 / 255]).color
    assert blender.diffuse("rebeccapurple").color == blender.diffuse("#663399").color


def test_image_of_any_kind_is_the_same(picture, tmp_path):
    levels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3) * 10
    save_image(str(tmp_path / "a.png"), levels.astype(float), cmin=0, cmax=255)
    for image in (levels, levels / 255, torch.tensor(levels), str(tmp_path / "a.png")):
        assert np.array_equal(picture.add_image(image, [4, 2]).image, levels)
    grey = picture.add_image(levels[..., 0], [4, 2]).image
    assert np.array_equal(grey, np.repeat(levels[..., :1], 3, -1))


@given(
    st.lists(st.floats(-5, 5), min_size=3, max_size=3),
    st.sampled_from(["perspective", "orthographic"]),
    st.floats(5, 120),
    st.floats(0.1, 50),
)
def test_rays_of_camera_end_in_pixels_they_are_projected_to(location, projection, fov, along):
    picture = blender.scene(resolution=(3, 5))
    camera = picture.add_camera(location, [0.1, 0.2, 9.0], projection=projection, fov=fov, width=2.0)
    axes = np.asarray(camera.axes)
    assert np.allclose(axes @ axes.T, np.eye(3)) and np.linalg.det(axes) == pytest.approx(1)
    rays = picture.camera_rays()
    column, row = np.meshgrid(np.arange(5) + 0.5, np.arange(3) + 0.5)
    assert np.allclose(np.linalg.norm(rays[..., 1, :], axis=-1), 1)
    seen = picture.project(rays[..., 0, :] + along * rays[..., 1, :])
    assert np.allclose(seen, np.stack((column, row), -1), atol=1e-6)


def test_a_point_behind_a_camera_is_not_seen():
    picture = blender.scene()
    picture.add_camera([0, 0, -5], [0, 0, 0])
    assert np.isnan(picture.project([0.0, 0.0, -6.0])).all()


@pytest.mark.parametrize("location", [None, [0, 100, 0], [-3, 40, 90]])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_a_camera_by_default_sees_all_objects(random, location, projection):
    picture = blender.scene(resolution=(60, 200))
    picture.add_lines(random.normal(size=(4, 5, 3)) * [1, 1, 20], radius=0.1)
    picture.add_camera(location, projection=projection, fov=60)
    seen = picture.project(picture.objects[0].placed_vertices())
    if location is None or projection == "orthographic":
        assert (seen > 0).all() and (seen < [200, 60]).all()
    if location is None:
        span = np.ptp(seen, axis=0) / [200, 60]
        assert span.max() > 0.6


def test_lights_are_as_strong_as_the_law_says():
    for unit, length in (("m", 1.0), ("mm", 1e-3)):
        picture = blender.scene(unit=unit)
        d = 50 * length
        point = picture.add_light([0, 0, 50])
        area = picture.add_light([0, 0, 50], kind="area")
        sun = picture.add_light([0, 0, 50], kind="sun")
        assert point.power / (4 * math.pi * d**2) == pytest.approx(0.75 * math.pi)
        assert area.power / (math.pi * d**2) == pytest.approx(0.75 * math.pi)
        assert sun.power == pytest.approx(0.75 * math.pi)


def test_an_empty_scene_is_refused():
    picture = blender.scene()
    for draw in (picture.render, picture.render_depth):
        with pytest.raises(ValueError, match="the scene is empty"):
            draw()


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_scene_without_lights_and_background_is_lit_by_studio(unit):
    picture = blender.scene(unit=unit)
    picture.add_sphere([1, 2, 3], radius=2.0)
    camera = picture._view((480, 640))
    lights, background = picture._lighting(camera)
    up = np.asarray(camera.axes[1])
    assert np.allclose(background["gradient"]["up"], up)
    for light in lights:
        towards = np.subtract(light.location, [1, 2, 3])
        assert not light.visible and np.allclose(light.axes[2], towards / np.linalg.norm(towards))
        # Outside of the picture, and as bright on a white surface whatever the unit is.
        place = camera.project(np.asarray(light.location), (480, 640))
        assert np.isnan(place).any() or not ((place > 0) & (place < [640, 480])).all()
        value = light.power / (math.pi * np.linalg.norm(towards) * picture.metres) ** 2
        assert 0.2 < value < 0.7
    picture.add_light([0, 0, 50])
    assert picture._lighting(camera) == (picture.lights, {"color": [1.0, 1.0, 1.0], "strength": 0.25})


def test_system_is_drawn_in_the_units_of_the_scene():
    system = load_system("cooke_triplet")
    small, large = blender.scene(unit="mm"), blender.scene(unit="um")
    for picture in (small, large):
        picture.add_system(system, count=5)
    assert [item.name for item in small.objects][-1] == "system rays"
    assert sum(item.material.kind == "glass" for item in small.objects) == 3
    for a, b in zip(small.objects, large.objects, strict=True):
        if a.material.kind == "glass":
            assert np.allclose(a.placed_vertices() * 1000, b.placed_vertices(), rtol=1e-5, atol=1e-2)
    first, at = system.surfaces[0].material, system.wavelengths[system.reference]
    assert small.objects[0].material.index == pytest.approx(refractive_index(first, at, unit="mm", medium="air"))


def test_rays_of_a_system_bend_on_its_faces():
    lens = optical_system(
        [surface(51.5, thickness=4.0, material="N-BK7", semi_diameter=12.0), surface(thickness=97.0)], aperture=20.0
    )
    picture = blender.scene(unit="mm")
    glass, rays = picture.add_system(lens, count=3)
    legs = ends_of(rays).reshape(3, 3, 2, 3)
    assert np.allclose(legs[:, 0, 1], legs[:, 1, 0]) and np.allclose(legs[:, 1, 1], legs[:, 2, 0])
    height = legs[:, 0, 1, 1]
    assert np.allclose(height, [-10, 0, 10], atol=1e-5) or np.allclose(height, [10, 0, -10], atol=1e-5)
    assert np.allclose(legs[:, 0, 1, 2], 51.5 - np.sqrt(51.5**2 - height**2), atol=1e-5)
    assert np.allclose(legs[:, 1, 1, 2], 4.0, atol=1e-5)
    assert np.allclose(legs[:, 2, 1, 2], 101.0, atol=1e-4)
    assert np.abs(legs[:, 2, 1, 1]).max() < 0.5
    assert glass.material.index == pytest.approx(1.5168, abs=1e-4)
    assert np.hypot(*glass.vertices.T[:2]).max() == pytest.approx(12.0, rel=1e-5)


def test_cemented_lenses_do_not_touch_and_mirrors_are_metal():
    doublet = [
        surface(60.0, thickness=6.0, material="N-BK7", semi_diameter=10.0),
        surface(-45.0, thickness=2.5, material="SF2", semi_diameter=10.0),
        surface(-130.0, thickness=90.0, semi_diameter=10.0),
    ]
    picture = blender.scene(unit="mm")
    first, second = picture.add_system(optical_system(doublet, aperture=15.0), count=0)
    back = first.vertices[first.normals[:, 2] > 0.5][:, 2].max()
    front = second.vertices[second.normals[:, 2] < -0.5][:, 2].max()
    assert 0 < front - back < 1e-3
    mirror = surface(-200.0, thickness=-100.0, material="mirror", semi_diameter=20.0)
    (item,) = picture.add_system(optical_system([mirror], aperture=30.0), count=0)
    assert item.material.kind == "metal"
    x, y, z = item.placed_vertices().T
    assert np.allclose(np.hypot(np.hypot(x, y), z + 200), 200, atol=1e-4) and np.hypot(x, y).max() == pytest.approx(20)


def test_shifted_tilted_and_freeform_lenses_are_closed_bodies_where_the_rays_meet_them():
    """Radii and centres follow from the shift, and from the tilt about x, then about y; the normals from the centre."""
    a, b = np.radians([3.0, -5.0])
    front = surface(60.0, thickness=6.0, material="N-BK7", semi_diameter=10.0)
    back = surface(-80.0, thickness=90.0, semi_diameter=10.0, tilt=(3.0, -5.0), shift=(0.5, 0.0))
    lens, rays = blender.scene(unit="mm").add_system(optical_system([front, back], aperture=12.0), count=5)
    axis = np.array([np.sin(b) * np.cos(a), -np.sin(a), np.cos(b) * np.cos(a)])
    centre = np.array([0.5, 0.0, 6.0]) - 80 * axis
    away = (lens.vertices - centre) / 80
    met = (np.linalg.norm(away, axis=-1) - 1 < 1e-6) & (lens.normals @ axis > 0.9)
    assert met.sum() > 1000 and np.allclose(lens.normals[met], away[met], atol=1e-5)
    ends = ends_of(rays).reshape(5, 3, 2, 3)[:, 1, 1]
    assert np.allclose(np.linalg.norm(ends - centre, axis=-1), 80, atol=1e-4)
    # The volume of a closed body seen from outside: two caps and a disc between their rims, of which one is tilted.
    depths = {radius: radius - math.sqrt(radius**2 - 100) for radius in (60, 80)}
    caps = [math.pi * depth**2 * (radius - depth / 3) for radius, depth in depths.items()]
    wanted = sum(caps) + math.pi * 100 * (6 - sum(depths.values()))
    assert np.linalg.det(lens.vertices[lens.faces].astype(float)).sum() / 6 == pytest.approx(wanted, rel=1e-2)
    bent = surface(60.0, thickness=6.0, material="N-BK7", semi_diameter=10.0, shape=OddAsphere(1 / 60, 0.0, (2e-4,)))
    (drawn,) = blender.scene(unit="mm").add_system(optical_system([bent, back], aperture=12.0), count=0)
    rim = np.isclose(np.hypot(*lens.vertices.T[:2]), 10.0) & (lens.vertices[:, 2] < 2)
    assert rim.sum() > 100 and not np.allclose(drawn.vertices[rim], lens.vertices[rim], atol=1e-3)


def test_scene_is_written_and_read(picture, tmp_path):
    picture.add_sphere([1, 2, 3], 4, material="N-BK7")
    picture.add_rays(LINE, 3, color=[[1, 0, 0], [0, 1, 0.5]])
    picture.add_image(np.linspace(0, 1, 12).reshape(3, 4), [2, 1], rotation=[0, 45, 0], shines=False)
    picture.add_surface(lambda u, v: (u, v, u * v), color="teal").shadow = False
    picture.add_camera([9, 9, 9], clip=[1, 100])
    picture.add_light([0, 9, 0], kind="area", color="orange")
    picture.set_background("navy", 0.5)
    path = picture.save(tmp_path / "scene.json")
    again = type(picture).load(path)
    assert (again.unit, again.resolution, again.wavelength) == ("mm", (60, 80), picture.wavelength)
    assert again.camera == picture.camera and again.lights == picture.lights
    assert again.background == picture.background
    for a, b in zip(picture.objects, again.objects, strict=True):
        for name, value in vars(a).items():
            other = getattr(b, name)
            assert np.array_equal(value, other) if isinstance(value, np.ndarray) else value == other
    again.save(tmp_path / "again.json")
    first, second = (json.loads((tmp_path / name).read_text()) for name in ("scene.json", "again.json"))
    assert first | {"arrays": 0} == second | {"arrays": 0}
    assert first["metres"] == 0.001
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["again.json", "again.npz", "scene.json", "scene.npz"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.pop("camera"), "camera missing"),
        (lambda d: d.update(format="other"), "not a scene"),
        (lambda d: d.update(version=99), "version must be 1, got 99"),
        (lambda d: d.update(arrays="../secret.npz"), "arrays must be the name of a file beside it"),
        (lambda d: d.update(arrays="missing.npz"), "missing.npz"),
        (lambda d: d["objects"][0].update(faces="0.vertices"), "faces of 'sphere' must be i4"),
        (lambda d: d["objects"][0]["material"].update(kind="script"), "material of 'sphere' must be one of"),
    ],
)
def test_a_broken_file_is_refused_by_name(picture, tmp_path, change, words):
    picture.add_sphere()
    path = picture.save(tmp_path / "scene.json")
    document = json.loads((tmp_path / "scene.json").read_text())
    change(document)
    (tmp_path / "scene.json").write_text(json.dumps(document))
    with pytest.raises(ValueError, match=words) as caught:
        blender.scene.load(path)
    assert "scene.json" in str(caught.value)


class Trap:
    """Writes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (self.path, "w")


def test_pickled_arrays_are_refused_unread(picture, tmp_path):
    picture.add_sphere()
    path = picture.save(tmp_path / "scene.json")
    arrays = dict(np.load(tmp_path / "scene.npz"))
    sprung = tmp_path / "sprung"
    np.savez(tmp_path / "scene.npz", **arrays | {"0.faces": np.array([Trap(str(sprung))], dtype=object)})
    with pytest.raises(ValueError, match="cannot be read as a scene"):
        blender.scene.load(path)
    assert not sprung.exists()
