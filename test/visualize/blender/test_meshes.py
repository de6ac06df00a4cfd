"""Shapes for Blender against their closed forms."""

import math

import numpy as np
import pytest

from odak.catalog import plano_convex_lens
from odak.visualize.blender import items, scene


def volume(vertices, faces):
    """Return what a closed surface encloses (divergence theorem); positive if its faces look outwards."""
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    return float(np.sum(np.cross(a, b) * c) / 6)


def cap(radius, height):
    return math.pi * height**2 * (3 * radius - height) / 3


def flat_normals(vertices, faces):
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def assert_normals_belong_to_faces(mesh, least=0.99):
    across = np.einsum("fi,fci->fc", flat_normals(mesh.vertices, mesh.faces), mesh.normals[mesh.faces])
    assert across.min() > least
    assert np.allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-6)


def test_sphere():
    errors = []
    for segments in (64, 128):
        ball = items.sphere_mesh(2.5, segments)
        assert np.allclose(np.linalg.norm(ball.vertices, axis=-1), 2.5)
        assert np.allclose(ball.normals * 2.5, ball.vertices)
        assert_normals_belong_to_faces(ball)
        # Every quad but those at the poles gives two triangles.
        assert len(ball.faces) == 2 * segments * (segments // 2 - 1)
        errors.append(1 - volume(ball.vertices, ball.faces) / (4 / 3 * math.pi * 2.5**3))
    assert 0 < errors[1] < 2e-3
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.02)


def test_tubes_have_the_volume_of_their_prisms_in_any_direction(random):
    starts, ends = random.normal(size=(2, 50, 3))
    starts[:3], ends[:3] = 0, np.eye(3)
    tubes = items.tube_mesh(starts, ends, 0.03, 8)
    bare = items.tube_mesh(starts, ends, 0.03, 8, shaded=False)
    assert bare.normals is None and len(bare.vertices) == 50 * 16
    assert np.allclose(bare.vertices[bare.faces], tubes.vertices[tubes.faces])
    section = 8 / 2 * 0.03**2 * math.sin(2 * math.pi / 8)
    each = [volume(tubes.vertices, part) for part in np.split(tubes.faces, 50)]
    assert np.allclose(each, section * np.linalg.norm(ends - starts, axis=-1))
    middles = tubes.vertices.reshape(50, 4, 8, 3).mean(axis=2)
    assert np.allclose(middles, np.stack((starts, ends, starts, ends), axis=1))
    assert_normals_belong_to_faces(tubes, least=math.cos(math.pi / 8) - 1e-6)


def test_disc_faces_up():
    disc = items.disc_mesh(3.0, 200)
    assert np.allclose(flat_normals(disc.vertices, disc.faces), [0, 0, 1])
    a, b, c = (disc.vertices[disc.faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2
    assert area == pytest.approx(math.pi * 9, rel=1e-3)


@pytest.mark.parametrize(
    ("radii", "conics", "expected"),
    [
        ([20.0, -30.0], [0.0, 0.0], lambda e, f, b: e * 25 * math.pi + cap(20, f) + cap(30, b)),
        ([20.0, 30.0], [0.0, 0.0], lambda e, f, b: e * 25 * math.pi + cap(20, f) - cap(30, b)),
        ([math.inf, -30.0], [0.0, -1.0], lambda e, f, b: e * 25 * math.pi + math.pi * 25 * b / 2),
    ],
)
def test_lens_encloses_what_its_faces_do(radii, conics, expected):
    thickness, semi = 6.0, 5.0

    def sag(radius, conic):
        if math.isinf(radius):
            return 0.0
        return semi**2 / (2 * abs(radius)) if conic else abs(radius) - math.sqrt(radius**2 - semi**2)

    front, back = (sag(r, k) for r, k in zip(radii, conics, strict=True))
    edge = thickness - front + (back if radii[1] > 0 else -back)
    item = scene().add_lens(radii, thickness, 2 * semi, conics=conics, segments=256)
    assert volume(item.vertices, item.faces) == pytest.approx(expected(edge, front, back), rel=1e-3)
    assert_normals_belong_to_faces(item, least=0.999)
    middle = item.vertices[np.hypot(item.vertices[:, 0], item.vertices[:, 1]) < 1e-6]
    assert {round(float(z), 6) for z in middle[:, 2]} == {0.0, thickness}


def test_aspheric_lens_follows_its_polynomial():
    item = scene().add_lens([30.0, math.inf], 5.0, 10.0, conics=[-2.0, 0.0], coefficients=[[0.0, 1e-4], []])
    x, y, z = item.vertices.astype(np.float64).T
    r2 = x**2 + y**2
    expected = r2 / 30 / (1 + np.sqrt(1 + r2 / 900)) + 1e-4 * r2**2
    front = item.normals[:, 2] < -0.5
    assert front.sum() > 1000
    assert np.allclose(z[front], expected[front], atol=1e-5)


def test_lens_of_the_catalogue_stands_where_it_is_traced():
    lens = plano_convex_lens("LA1024", location=[1.0, 2.0, 3.0], rotation=[10.0, 20.0, 30.0])
    item = scene(unit="mm").add_lens(lens)
    assert item.material.index == pytest.approx(lens.index())
    points = item.placed_vertices()
    convex, flat = item.normals[:, 2] < -0.5, item.normals[:, 2] > 0.99
    assert np.allclose(np.linalg.norm(points[convex] - lens.center, axis=-1), lens.radius, atol=1e-4)
    axis = (lens.convex_point - lens.plane_center) / lens.thickness
    assert np.allclose((points[flat] - lens.plane_center) @ axis, 0, atol=1e-5)
    reach = np.linalg.norm(points[flat] - lens.plane_center, axis=-1).max()
    assert reach == pytest.approx(lens.diameter / 2, rel=1e-5)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ([20.0, -20.0], 1.0, 20.0),
            "thickness must leave a positive thickness at the edge, got 1, which leaves -4.359",
        ),
        (([5.0, -20.0], 4.0, 20.0), "diameter must be smaller than the largest diameter of the front"),
        (([0.0, -20.0], 4.0, 20.0), "radii must not be 0"),
        (([20.0], 4.0, 20.0), "radii must be a pair, one for the front"),
        (([20.0, 20.0], -4.0, 20.0), "thickness must be positive"),
    ],
)
def test_impossible_lenses_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        scene().add_lens(*arguments)


def test_grid_front_is_columns_times_rows():
    x, y = np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-2, 2, 4))
    mesh = items.grid_mesh(np.stack((x, y, 0 * x), -1))
    assert np.allclose(flat_normals(mesh.vertices, mesh.faces), [0, 0, 1])
    assert np.allclose(mesh.uv, np.stack(((x + 1) / 2, (y + 2) / 4), -1).reshape(-1, 2))
