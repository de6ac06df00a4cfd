"""The older interface draws into one scene, without a Blender that has to run."""

import math
import os
import socket
import threading

import numpy as np
import pytest

from odak import ArgumentWarning
from odak.tools import save_image, write_PLY
from odak.visualize import blender
from odak.visualize.blender import commands, libblend, server, wrapper


@pytest.fixture(autouse=True)
def _fresh(monkeypatch):
    # Threads that earlier tests left behind, such as those of a browser that draws images, may open theirs.
    made, others = socket.socket.__init__, set(threading.enumerate()) - {threading.current_thread()}

    def refuse(self, *arguments, **options):
        assert threading.current_thread() in others, "a socket was opened"
        made(self, *arguments, **options)

    monkeypatch.setattr(socket.socket, "__init__", refuse)
    commands.stop()
    yield
    commands.stop()


@pytest.fixture
def mesh_file(tmp_path):
    write_PLY(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=float), str(tmp_path / "mesh.ply"))
    return str(tmp_path / "mesh.ply")


def test_names_are_at_all_their_places():
    for name in ("init", "check", "prepare", "import_ply", "cylinder_between", "render", "quit", "delete_the_cube"):
        assert getattr(blender, name) is getattr(wrapper, name)
    assert blender.send_msg is wrapper.send_msg
    assert wrapper.prepare is libblend.prepare


def test_walk_through(mesh_file):
    handle = blender.init(headless=True)
    assert handle.poll() is None
    scene = blender.prepare(
        resolution=[200, 100],
        camera_fov=60.0,
        camera_location=[0.0, 0.0, -15.0],
        camera_lookat=[0.0, 0.0, 0.0],
        clip=[0.1, 1000.0],
        device="CPU",
        intensity=2.0,
        world_color=[0.3, 0.2, 0.1],
    )
    blender.delete_the_cube()
    mesh = blender.import_ply(mesh_file, location=[1, 2, 3], angle=[0, 0, 90], scale=[2, 2, 2])
    rod = blender.cylinder_between([0, 0, 0], [0, 0, 5], r=0.5, objname="ray", color=[0.0, 0.5, 0.0, 0.0])
    assert scene is handle.scene and scene.unit == "m"
    assert scene.resolution == (100, 200) and scene.device == "cpu"
    assert scene.camera.fov == 60 and scene.camera.clip == [0.1, 1000.0]
    assert scene.camera.location == [0, 0, -15]
    assert scene.background["strength"] == 2.0 and np.allclose(scene.background["color"], [0.3, 0.2, 0.1])
    assert np.allclose(mesh.placed_vertices(), [[1, 2, 3], [1, 4, 3], [-1, 2, 3]], atol=1e-6)
    assert [item.name for item in scene.objects] == ["mesh", "ray"]
    assert np.allclose(rod.material.color, [0, 0.5, 0]) and rod.material.kind == "diffuse"
    assert np.hypot(*rod.vertices.T[:2]).max() == pytest.approx(0.5)
    assert rod.vertices[:, 2].max() == 5
    blender.quit()
    assert handle.poll() == 0
    assert commands.current().scene.objects == []


def test_upright_picture_keeps_the_angle_across_its_longer_side():
    scene = blender.prepare(resolution=[100, 200], camera_fov=60.0)
    top = scene.project([[0, 15 * math.tan(math.radians(30)), 0]])
    assert np.allclose(top, [[50, 0]], atol=1e-6)


def test_handle_lets_the_scene_go():
    handle = blender.init()
    blender.check(handle)
    assert handle.poll() == 0
    blender.check(handle)
    later = blender.init()
    handle.kill()
    assert later.poll() is None


def test_scene_may_continue_a_file(tmp_path):
    handle = blender.init(blend_fn=str(tmp_path / "start.blend"))
    blender.delete_the_cube()
    document = handle.scene._document(handle.scene._job("picture", None, None, None, 0))
    assert document["start_from"] == str(tmp_path / "start.blend")
    assert document["remove"] == ["Cube"]
    assert document["camera"] is None and document["background"] is None
    with pytest.raises(ValueError, match="is not allowed"):
        blender.init(blend_fn="start.py")
    # Blender runs in a folder of its own.
    handle.scene.start_from = "start.blend"
    document = handle.scene._document(handle.scene._job("picture", None, None, None, 0))
    assert document["start_from"] == os.path.abspath("start.blend")


def test_texts_are_taken_apart_and_carried_out(mesh_file):
    assert blender.send_msg(
        [
            "prepare(resolution=[64, 48], device='CPU')",
            f"import_ply({mesh_file!r}, [0, 0, 1])",
            "cylinder_between([0, 0, 0], [0, 1, 0], 0.1, 'a', [1.0, 0.0, 0.0, 0.0])",
            "delete_object('a')",
        ]
    )
    scene = commands.current().scene
    assert scene.resolution == (48, 64)
    assert [item.name for item in scene.objects] == ["mesh"]
    assert blender.send_msg(["quit()"])
    assert commands.current().scene.objects == []


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('touch /tmp/odak_was_here')",
        "prepare(resolution=__import__('os').getpid())",
        "prepare(**{'device': 'CPU'})",
        "prepare(*[[1, 1]])",
        "prepare.__globals__",
        "render('a.png'); quit()",
        "render('a.png') or quit()",
        "eval('1')",
        "quit",
        "(lambda: quit())()",
        "",
        "prepare(" + "[" * 3000 + "]" * 3000 + ")",
        "x" * 5000,
        "prepare(\0)",
    ],
)
def test_nothing_else_is_carried_out(text):
    before = commands.current().scene
    with pytest.raises(ValueError, match="cmds must be calls of import_ply, prepare"):
        blender.send_msg(["cylinder_between([0, 0, 0], [0, 1, 0])", text])
    with pytest.warns(ArgumentWarning, match="accepted are calls of"):
        assert not server.validate_and_queue_command(text)
    assert server.execute_queued_functions() == 0.1
    assert commands.current().scene is before and before.objects == []


def test_parser_returns_name_and_literals():
    parse = server.parse_function_call_safely
    assert parse("render('a.png', exit=True)", "render") == ("render", ["a.png"], {"exit": True})
    assert parse("prepare(clip=[-1e-3, 2])", "prepare") == ("prepare", [], {"clip": [-0.001, 2]})
    assert parse("render('a.png')", "prepare") == (None, [], {})
    assert parse(7, "prepare") == (None, [], {})


def test_queue_is_bounded_and_emptied_in_order():
    done = []
    for number in range(100):
        assert server.run_in_main_thread((done.append, [number], {}))
    with pytest.warns(ArgumentWarning, match="100 commands are waiting already"):
        assert not server.run_in_main_thread(lambda: done.append("late"))
    thread = server.whisper2blender(port=8082, host="127.0.0.1", path_max=4096)
    thread.start()
    thread.join()
    assert done == list(range(100))
    assert server.validate_and_queue_command("cylinder_between([0, 0, 0], [0, 0, 1])")
    assert commands.current().scene.objects == []
    server.main()
    assert len(commands.current().scene.objects) == 1


def test_objects_are_moved_coloured_and_met(tmp_path):
    plane = libblend.create_plane("plane", [0, 0, 5], size=[4.0, 2.0])
    circle = libblend.create_circle("circle", [0, 0, 9], radius=1.5)
    other = libblend.create_plane_from_meshes("quad", [0, 0, 7], size=[1.0, 1.0])
    assert np.ptp(plane.placed_vertices(), axis=0).tolist() == [4, 2, 0]
    assert np.hypot(*circle.vertices.T[:2]).max() == 1.5
    assert other.location == [0, 0, 7]
    assert libblend.intersect_a_ray([1, 0.5, 0], [1, 0.5, 1], plane)[0]
    hit, place, distance = libblend.intersect_a_ray([0, 0, 0], [1, 0, 5], plane)
    assert hit and np.allclose(place, [1, 0, 5]) and distance == pytest.approx(math.sqrt(26))
    assert libblend.intersect_a_ray([0, 0, 0], [0, 0, -1], plane) == (False, False, 0)
    libblend.set_rotation(plane, [90, 0, 0])
    libblend.set_location(plane, [0, 0, 6])
    assert np.ptp(plane.placed_vertices(), axis=0) == pytest.approx([4, 0, 2], abs=1e-6)
    assert libblend.intersect_a_ray([0, -3, 6.5], [0, 0, 6.5], plane)[2] == pytest.approx(3)
    libblend.assign_color("", plane, [0.1, 0.2, 0.3])
    assert plane.material.kind == "emission" and np.allclose(plane.material.color, [0.1, 0.2, 0.3])
    save_image(str(tmp_path / "a.png"), np.eye(4) * 255, cmin=0, cmax=255)
    libblend.assign_texture(str(tmp_path / "a.png"), circle, "label")
    assert circle.image.shape == (4, 4, 3) and circle.material.name == "label"
    libblend.clear_material(circle)
    assert circle.image is None and circle.material.color == (1.0, 1.0, 1.0)
    libblend.delete_object("circle")
    assert [item.name for item in commands.current().scene.objects] == ["plane", "quad"]


def test_texture_of_a_mesh_spans_its_two_longest_axes(mesh_file, tmp_path):
    save_image(str(tmp_path / "a.png"), np.eye(4) * 255, cmin=0, cmax=255)
    mesh = libblend.import_ply(mesh_file)
    libblend.assign_texture(str(tmp_path / "a.png"), mesh, "label")
    assert np.allclose(mesh.uv, [[0, 0], [1, 0], [0, 1]])


def test_rays():
    ray, length = libblend.create_ray_from_two_points([1, 2, 3], [1, 5, 7])
    assert ray.dtype == np.float32 and ray.shape == (2, 3)
    assert np.allclose(ray, [[1, 2, 3], [0, 0.6, 0.8]]) and length == 5
    p0, p1 = libblend.reflect_ray([[0, -1, -1], [0, 0.5, 0.5]], [0, 0, 2], [0, 0, 0])
    assert np.allclose(p0, 0) and np.allclose(p1, [0, 10 / math.sqrt(2), -10 / math.sqrt(2)])
