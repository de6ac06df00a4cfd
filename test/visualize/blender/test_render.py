"""Renders in Blender, held against closed forms and against odak's own rays."""

import math
import subprocess

import numpy as np
import pytest

from odak import DeviceWarning
from odak.raytracing.boundary import intersect_w_circle, intersect_w_sphere, intersect_w_surface, refract
from odak.raytracing.primitives import define_circle, define_plane, define_sphere
from odak.tools import load_image
from odak.visualize import blender
from odak.visualize.blender import commands, libblend

pytestmark = pytest.mark.blender


def scene_of(resolution=(64, 64), samples=16, **options):
    picture = blender.scene(unit="mm", resolution=resolution, samples=samples, device="cpu", **options)
    picture.set_background("black", 0.0)
    return picture


def shoot(picture, **options):
    return picture.render(verbose=False, **options)


def gradient(rows=256, columns=256):
    """Return a picture whose linear red is the share of its width, green that of its height from below; blue is 1."""
    share = np.stack(
        np.broadcast_arrays((np.arange(columns) + 0.5) / columns, ((np.arange(rows) + 0.5) / rows)[::-1, None], 1.0), -1
    )
    return np.where(share <= 0.0031308, share * 12.92, 1.055 * share ** (1 / 2.4) - 0.055)


def test_ball_covers_the_pixels_of_its_outline(tmp_path):
    picture = scene_of((200, 200))
    picture.add_sphere([1.0, 2.0, 30.0], 3.0, material=blender.emission("#3366cc"))
    picture.add_camera([0, 0, 0], [0, 0, 1], fov=60)
    path = picture.render(tmp_path / "ball.png", verbose=False)
    levels = load_image(path)
    assert levels.shape == (200, 200, 3)
    rays = picture.camera_rays().reshape(-1, 2, 3)
    _, distance = intersect_w_sphere(rays, define_sphere([1.0, 2.0, 30.0], 3.0))
    expected = ~np.isnan(distance.reshape(200, 200))
    inside = (levels == [0x33, 0x66, 0xCC]).all(-1)
    outside = (levels == 0).all(-1)
    # Pixels on the outline are mixtures, and a ball of flat faces is a little smaller.
    assert (inside | expected).sum() - (inside & expected).sum() < 0.12 * expected.sum()
    assert not (inside & ~expected).any() and not (outside & expected).sum() > 2
    share = np.array([blender.diffuse([0, 0, level / 255]).color[2] for level in range(256)])[
        levels[..., 2].astype(int)
    ]
    assert share.sum() / share.max() == pytest.approx(expected.sum(), rel=0.02)
    # It stands to the left: x grows to the left for a look along z with y up.
    rows, columns = np.nonzero(inside)
    assert np.allclose([columns.mean() + 0.5, rows.mean() + 0.5], picture.project([1.0, 2.0, 30.0]), atol=0.5)


def test_ball_in_parallel_projection():
    picture = scene_of((50, 100), samples=64)
    picture.add_sphere([4.0, 1.0, 30.0], 3.0, material=blender.emission("white"))
    picture.add_camera([0, 0, 0], [0, 0, 1], projection="orthographic", width=20.0)
    seen = shoot(picture)
    # 5 pixels to the millimetre.
    assert seen[..., 0].sum() == pytest.approx(math.pi * 15**2, rel=0.01)
    row, column = np.mgrid[:50, :100] + 0.5
    weight = seen[..., 0] / seen[..., 0].sum()
    assert (column * weight).sum() == pytest.approx(50 - 4 * 5, abs=0.1)
    assert (row * weight).sum() == pytest.approx(25 - 1 * 5, abs=0.1)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_depth_is_that_of_traced_rays(projection):
    picture = scene_of((48, 64))
    picture.add_sphere([2.0, -1.0, 40.0], 6.0, segments=256)
    plane = picture.add_plane([200, 200])
    plane.location, plane.rotation, plane.scale = [0.0, 0.0, 50.0], [20.0, 190.0, 30.0], [1.5, 1.0, 1.0]
    picture.add_camera([5.0, 3.0, -10.0], [0.0, 0.0, 40.0], projection=projection, width=40.0, up=[0.2, 1.0, 0.0])
    found = picture.render_depth(verbose=False)
    rays = picture.camera_rays().reshape(-1, 2, 3)
    forwards = -np.asarray(picture.camera.axes[2])
    _, to_ball = intersect_w_sphere(rays, define_sphere([2.0, -1.0, 40.0], 6.0))
    points = intersect_w_surface(rays, define_plane([0.0, 0.0, 50.0], [20.0, 190.0, 30.0]))[0][:, 0]
    places = [rays[:, 0] + to_ball[:, None] * rays[:, 1], points]
    depths = np.array([(place - picture.camera.location) @ forwards for place in places])
    expected = np.nanmin(depths, axis=0).reshape(48, 64)
    near_rim = np.isnan(to_ball) != np.isnan(np.roll(to_ball, 1))
    good = ~(near_rim | np.roll(near_rim, -1)).reshape(48, 64)
    assert np.isfinite(found).all() and good.mean() > 0.9
    assert np.abs(found - expected)[good].max() < 0.02
    assert (np.nanargmin(depths, axis=0) == 0).mean() > 0.05


def test_surface_and_its_rotation_are_where_odak_has_them():
    picture = scene_of((40, 40))
    item = picture.add_surface(
        lambda u, v: (u, v, 0.05 * u**2 - 0.1 * v), u=(-20, 20), v=(-20, 20), resolution=(9, 201)
    )
    item.rotation = [0.0, 0.0, 30.0]
    picture.add_camera([0, 0, -50], [0, 0, 0], projection="orthographic", width=20.0)
    found = picture.render_depth(verbose=False)
    rays = picture.camera_rays()
    x, y = rays[..., 0, 0], rays[..., 0, 1]
    turn = math.radians(30)
    u, v = x * math.cos(turn) + y * math.sin(turn), -x * math.sin(turn) + y * math.cos(turn)
    assert np.allclose(found, 50 + 0.05 * u**2 - 0.1 * v, atol=2e-3)


def test_nothing_is_infinitely_far_away_and_rods_are_round():
    picture = scene_of((8, 8))
    picture.add_plane([1, 1], location=[0, 0, 5], rotation=[180, 0, 0])
    picture.add_camera([0, 0, 0], [0, 0, 1], projection="orthographic", width=4.0)
    picture.add_lines([[-9, 1.5, 9], [9, 1.5, 9]], radius=0.5)
    expected = np.full((8, 8), np.inf)
    expected[3:5, 3:5] = 5
    # Half a radius beside its axis, and eight flat sides in older Blenders.
    expected[:2] = [[9 - math.sqrt(0.25 - 0.25**2)]] * 2
    assert np.allclose(picture.render_depth(verbose=False), expected, atol=0.05)


def test_rods_appear_where_rays_are_projected():
    colors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.5, 1.0]]
    rays = np.array([[[-8.0, -5, 20], [0.8, 0.6, 0]], [[-8.0, 5, 20], [0.8, -0.6, 0]], [[6, -6, 18], [0, 1, 1]]])
    picture = scene_of((120, 160))
    picture.add_rays(rays, distance=[15.0, 15.0, 10.0], radius=0.35, color=colors)
    picture.add_camera([0, 0, 0], [0, 0, 20], fov=60)
    seen = shoot(picture)
    for ray, color, length in zip(rays, colors, (15, 15, 10), strict=True):
        along = np.array([0.1, 0.25, 0.8, 0.95])[:, None] * length
        column, row = np.floor(picture.project(ray[0] + along * ray[1])).astype(int).T
        assert np.allclose(seen[row, column], [blender.diffuse(color).color] * 4, atol=0.02)
        column, row = np.floor(picture.project(ray[0] - 0.8 * ray[1])).astype(int)
        assert seen[row, column].max() == 0
    assert (seen.max(-1) == 0).mean() > 0.8
    # From one end to the other, and no wider than it is: at most its outline's share of the picture.
    lit = (seen[..., 0] > 0.5).sum()
    start, stop = picture.project(rays[0, 0]), picture.project(rays[0, 0] + 15 * rays[0, 1])
    pixels_per_mm = 80 / (20 * math.tan(math.radians(30)))
    assert lit == pytest.approx(math.dist(start, stop) * 0.7 * pixels_per_mm, rel=0.15)


def traced_through(rays, meet, index, screen):
    """Return where rays arrive on a screen after two refractions, NaN for those that miss."""
    inside = refract(rays, meet(rays, 0), 1.0, index)
    behind = refract(inside, meet(inside, 1), index, 1.0)
    return intersect_w_surface(behind, screen)[0][:, 0]


def shares(seen):
    """Return red and green over blue: places in the gradient, whatever share of the light glass reflects."""
    return seen[..., :2] / np.where(seen[..., 2:] > 0.3, seen[..., 2:], np.nan)


def test_glass_ball_inverts_its_background_as_odak_traces_it():
    index, size = 1.5168, 60.0
    picture = scene_of((64, 64), samples=64)
    picture.add_sphere([0.0, 0.0, 0.0], 5.0, material="N-BK7", segments=256)
    picture.add_image(gradient(), [size, size], location=[0, 0, 30.0], rotation=[0, 180, 0])
    picture.add_camera([0, 0, -40], [0, 0, 0], projection="orthographic", width=9.0)
    assert picture.find("sphere").material.index == pytest.approx(index, abs=1e-4)
    found = shares(shoot(picture))
    rays = picture.camera_rays().reshape(-1, 2, 3)

    def meet(rays, number):
        normals, distance = intersect_w_sphere(rays, define_sphere([0.0, 0.0, 0.0], 5.0))
        return np.where(np.isnan(distance)[:, None, None], np.nan, normals)

    arrived = traced_through(rays, meet, index, define_plane([0.0, 0.0, 30.0], [0.0, 0.0, 0.0]))
    # The picture is turned towards −z, so its width runs along −x.
    expected = np.stack((0.5 - arrived[:, 0] / size, 0.5 + arrived[:, 1] / size), -1).reshape(64, 64, 2)
    radius = np.hypot(*(picture.camera_rays()[..., 0, :2].transpose(2, 0, 1)))
    middle = radius < 3.0
    apart = np.abs(found - expected)[middle]
    # Light that was reflected twice inside adds noise to a few pixels.
    assert apart.mean() < 0.0015 and np.quantile(apart, 0.99) < 0.01
    # Upside down: up in the picture is down in the gradient.
    assert (np.diff(found[10:54:4, 32, 1]) > 0).all() and (np.diff(found[32, 10:54:4, 0]) < 0).all()
    bare = scene_of((64, 64))
    bare.objects[:], bare.camera = picture.objects[1:], picture.camera
    straight = shares(shoot(bare))
    assert (np.diff(straight[:, 32, 1]) < 0).all() and (np.diff(straight[32, :, 0]) > 0).all()


def test_lens_shows_what_odak_traces_through_it():
    index, size, radius, thickness, semi = 1.6, 40.0, 25.0, 5.0, 10.0
    picture = scene_of((64, 64), samples=64)
    picture.add_lens([radius, math.inf], thickness, 2 * semi, material=index)
    picture.add_image(gradient(), [size, size], location=[0, 0, 60.0], rotation=[0, 180, 0])
    picture.add_camera([1.0, 2.0, -50], [0, 0, 0], projection="orthographic", width=20.0)
    found = shares(shoot(picture))
    rays = picture.camera_rays().reshape(-1, 2, 3)

    def meet(rays, number):
        if number == 0:
            normals, distance = intersect_w_sphere(rays, define_sphere([0.0, 0.0, radius], radius))
            off = np.isnan(distance) | (np.hypot(normals[:, 0, 0], normals[:, 0, 1]) > 0.9 * semi)
        else:
            normals, distance = intersect_w_circle(rays, define_circle([0.0, 0.0, thickness], 0.9 * semi, [0, 0, 0]))
            off = distance == 0
        return np.where(off[:, None, None], np.nan, normals)

    arrived = traced_through(rays, meet, index, define_plane([0.0, 0.0, 60.0], [0.0, 0.0, 0.0]))
    expected = np.stack((0.5 - arrived[:, 0] / size, 0.5 + arrived[:, 1] / size), -1).reshape(64, 64, 2)
    inside = ~np.isnan(expected).any(-1)
    assert inside.mean() > 0.3
    apart = np.abs(found - expected)[inside]
    assert apart.mean() < 0.002 and np.quantile(apart, 0.99) < 0.01
    # The screen lies behind the focus, which is 41.7 mm behind the lens: upside down.
    assert (np.diff(found[20:44:4, 32, 1]) > 0).all()


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_white_matt_surface_under_watt_has_value_of_law(unit):
    picture = blender.scene(unit=unit, resolution=(9, 9), samples=256, device="cpu")
    picture.set_background("black", 0)
    picture.add_plane([2e4, 2e4], rotation=[180, 0, 0])
    picture.add_camera([0, 0, -50], [0, 0, 0], projection="orthographic", width=1.0)
    distance = 100 * picture.metres
    laws = {
        "point": (3 * distance**2, 3 / (4 * math.pi)),
        "area": (3 * distance**2, 3 / math.pi),
        "sun": (2.0, 2.0),
    }
    for kind, (power, irradiance) in list(laws.items())[: 1 if unit == "m" else 3]:
        picture.lights = []
        picture.add_light([0, 0, -100], kind=kind, power=power, size=1.0)
        assert shoot(picture).mean() == pytest.approx(irradiance / math.pi, rel=0.01), kind


def test_default_look_lights_what_faces_the_camera():
    picture = blender.scene(unit="mm", resolution=(48, 64), samples=32, device="cpu")
    picture.add_sphere(radius=3.0)
    seen = shoot(picture).mean(-1)
    # The backdrop grows brighter from the bottom to the top, and a white surface is neither dark nor overexposed.
    assert 0.15 < seen[-1, 0] < seen[24, 0] < seen[0, 0] < 0.9
    assert 0.6 < seen[24, 32] < 1.1
    assert seen[8:40, 24:40].max() < 1.3


def test_glass_is_seen_in_the_studio():
    picture = blender.scene(unit="mm", resolution=(48, 64), samples=32, device="cpu")
    ball = picture.add_sphere(radius=3.0, material="N-BK7")
    picture.add_camera([0, 0, -20], [0, 0, 0], fov=40)
    seen = shoot(picture).mean(-1)
    picture.remove(ball)
    picture.add_sphere([0, 0, 1e3], radius=1e-3)
    empty = shoot(picture).mean(-1)
    inside = np.hypot(*(np.indices((48, 64)) - np.array([23.5, 31.5])[:, None, None])) < 11
    assert np.abs(seen - empty)[inside].mean() > 0.1 > 5 * np.abs(seen - empty)[:, :8].mean()
    # A ball inverts what is behind it: bright below, dark above.
    assert seen[30:33, 30:34].mean() > seen[15:18, 30:34].mean() + 0.1


def test_edges_of_lenses_are_ground():
    levels = {}
    for ground in (True, False):
        picture = blender.scene(unit="mm", resolution=(40, 40), samples=64, device="cpu")
        picture.set_background("white", 0.5)
        lens = picture.add_lens([51.5, -51.5], 8.0, 25.0, ground=ground)
        assert lens.ground == (256 if ground else 0)
        picture.add_camera([40, 0, 4], [0, 0, 4], projection="orthographic", width=3.0)
        levels[ground] = shoot(picture)
    # Under light of 0.5 from all sides a matt surface shows half its reflectance, the same everywhere.
    assert np.allclose(levels[True].mean((0, 1)), 0.5 * np.array([0.55, 0.58, 0.6]), rtol=0.02)


def test_picture_hangs_upright_and_colours_stay_what_they_are(tmp_path):
    corners = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [90, 140, 200]]], dtype=np.uint8)
    picture = scene_of((20, 20), samples=1)
    picture.add_image(np.kron(corners, np.ones((8, 8, 1), np.uint8)), [2, 2])
    picture.add_camera([0, 0, 10], [0, 0, 0], projection="orthographic", width=2.0)
    levels = load_image(picture.render(tmp_path / "a.png", verbose=False))
    assert np.abs(levels[[3, 3, 16, 16], [3, 16, 3, 16]] - corners.reshape(4, 3)).max() <= 1


def test_vertex_colours_and_mirrors():
    picture = scene_of((16, 16))
    x, y = np.meshgrid(np.linspace(-4, 4, 5), np.linspace(-4, 4, 5))
    share = np.stack((x / 8 + 0.5, 0 * x, y / 8 + 0.5), -1).reshape(-1, 3)
    coded = np.where(share <= 0.0031308, share * 12.92, 1.055 * share ** (1 / 2.4) - 0.055)
    picture.add_surface(x, y, 0 * x + 10, color=coded, material=blender.emission())
    picture.add_plane([30, 30], location=[0, 0, -10], material="mirror")
    # Looks into the mirror: 10 there, 20 back.
    picture.add_camera([0, 0, 0], [0, 0, -1], projection="orthographic", width=4.0)
    seen = shoot(picture)
    middle = (np.arange(16) + 0.5) / 16 * 4 - 2
    assert np.allclose(seen[..., 0], middle / 8 + 0.5, atol=0.01)
    assert np.allclose(seen[..., 2], -middle[:, None] / 8 + 0.5, atol=0.01)


def test_seed_and_opacity():
    picture = blender.scene(unit="mm", resolution=(16, 16), samples=2, device="cpu")
    picture.add_sphere(radius=1.0)
    picture.add_light([3, 3, -3], kind="area", size=3.0)
    picture.add_camera([0, 0, -10], [0, 0, 0], projection="orthographic", width=4.0)
    first, again, other = (shoot(picture, transparent=True, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert first.shape == (16, 16, 4)
    assert first[0, 0].tolist() == [0, 0, 0, 0] and first[8, 8, 3] == 1


def test_blend_file_keeps_the_unit_and_may_be_continued(tmp_path):
    picture = scene_of((24, 24), samples=4)
    picture.add_sphere([0, 0, 5], 1.0, material=blender.emission("red"), name="first")
    picture.add_sphere([1, 0, 5], 0.5, material=blender.emission("blue"), name="second")
    picture.add_camera([0, 0, 0], [0, 0, 1], projection="orthographic", width=4.0)
    path = picture.save(tmp_path / "scene.blend", verbose=False)
    script = tmp_path / "look.py"
    script.write_text(
        "import bpy, sys\n"
        f"bpy.ops.wm.open_mainfile(filepath={path!r}, use_scripts=False)\n"
        "units, names = bpy.context.scene.unit_settings, sorted(bpy.data.objects.keys())\n"
        "print('FOUND', units.system, round(units.scale_length, 9), units.length_unit, names)\n"
    )
    found = blender.find_blender()
    command, environment = found.command(str(script)), found.environment()
    said = subprocess.run(command, capture_output=True, text=True, env=environment).stdout
    assert "FOUND METRIC 0.001 MILLIMETERS ['camera', 'first', 'second']" in said
    before = shoot(picture)
    later = blender.scene(unit="mm", resolution=(24, 24), samples=4, device="cpu")
    later.start_from = path
    assert np.array_equal(shoot(later), before)
    later.removed = ["second"]
    later.add_sphere([-1, 0, 5], 0.5, material=blender.emission("lime"))
    seen = shoot(later)
    assert before[..., 2].max() == 1 and seen[..., 2].max() == 0 and seen[..., 1].max() == 1


def test_exr_is_written_and_denoising_runs(tmp_path):
    picture = scene_of((16, 16), samples=4)
    picture.add_sphere(radius=1.0)
    path = picture.render(tmp_path / "a.exr", denoise=True, verbose=False)
    assert (tmp_path / "a.exr").read_bytes()[:4] == b"\x76\x2f\x31\x01"
    assert path == str(tmp_path / "a.exr")


def test_without_a_gpu_the_cpu_renders_with_one_warning():
    picture = scene_of((4, 4), samples=1)
    picture.add_sphere()
    with pytest.warns(DeviceWarning, match="no device for 'hip'; the CPU renders") as said:
        assert shoot(picture, device="hip", resolution=(4, 6), samples=2).shape == (4, 6, 3)
    assert len(said) == 1


def test_errors_inside_blender_are_reported(tmp_path):
    picture = scene_of()
    picture.add_sphere()
    (tmp_path / "broken.blend").write_bytes(b"not a blend file")
    picture.start_from = str(tmp_path / "broken.blend")
    with pytest.raises(blender.BlenderError, match=r"(?s)exit code 1.*driver\.py.*open_mainfile.*broken\.blend"):
        picture.render(tmp_path / "a.png", verbose=False)
    assert [entry.name for entry in tmp_path.iterdir()] == ["broken.blend"]


def test_older_commands_draw_and_render(tmp_path):
    commands.stop()
    blender.init(headless=True)
    scene = blender.prepare(resolution=[80, 60], device="CPU", intensity=1.0, world_color=[0.2, 0.2, 0.2])
    scene.samples = 8
    blender.delete_the_cube()
    rod = blender.cylinder_between([-2, 0, 0], [2, 0, 0], r=0.3, color=[0.0, 0.5, 0.0, 0.0])
    blender.render(str(tmp_path / "rgb.png"))
    levels = load_image(str(tmp_path / "rgb.png"))
    assert levels.shape == (60, 80, 3)
    # A matt surface of reflectance 0.5 in uniform light of 0.2 sends back 0.1.
    assert np.allclose(levels[30, 40], [0, 89, 0], atol=4)
    assert np.allclose(levels[5, 5], [124] * 3, atol=1)
    libblend.set_location(rod, [0, 0, 5])
    blender.import_ply(str(_square(tmp_path)), location=[0, 1, 10], scale=[3, 3, 3])
    libblend.set_render_type("depth")
    blender.render(str(tmp_path / "depth.png"), exit=True)
    grey = load_image(str(tmp_path / "depth.png"))
    assert grey[30, 40].max() < 10 and grey[0, 0].min() == 255
    assert commands.current().scene.objects == []
    commands.stop()


def _square(folder):
    from odak.tools import write_PLY

    square = np.array([[[-1, -1, 0], [1, -1, 0], [1, 1, 0]], [[-1, -1, 0], [1, 1, 0], [-1, 1, 0]]], dtype=float)
    write_PLY(square, str(folder / "square.ply"))
    return folder / "square.ply"
