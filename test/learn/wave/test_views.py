"""Views of meshes and of splats: against similar triangles, Lambert's law, and another projection of Gaussians."""

import math
from argparse import Namespace

import numpy as np
import pytest
import torch

from odak.instruments import Lens
from odak.learn.raytracing import triangle_mesh
from odak.learn.tools import PerspectiveCamera
from odak.learn.wave import (
    DepthScene,
    Display,
    Eyes,
    Modulator,
    Placement,
    Scene,
    Splats,
    complex_3d_gaussians,
    light_of,
    views_of_mesh,
    views_of_splats,
)
from odak.learn.wave.holograms import views as rendering

PITCH, DISTANCE, GREEN = 8e-6, 0.1, 532e-9
PLACES = [(0.0, 0.0), (0.5e-3, -1.1e-3), (-0.9e-3, 0.7e-3)]
FREE, LENS = Eyes(DISTANCE), Eyes(Lens(0.04, before=0.03, after=0.025))


def display_of(eyes=FREE, size=(48, 64), wavelengths=GREEN):
    return Display(Modulator(size, PITCH), wavelengths, eyes)


def middle_of(light):
    y, x = (torch.arange(n, dtype=torch.float64) for n in light.shape)
    return float((light.sum(1) * y).sum() / light.sum()), float((light.sum(0) * x).sum() / light.sum())


def quad(x, y, z, half_width, half_height):
    corners = [(x + i * half_width, y + j * half_height, z) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return torch.tensor(corners, dtype=torch.float64), torch.tensor([[0, 1, 2], [0, 2, 3]])


def splat(*means, scale=1e-4, opacity=0.8, colour=0.9):
    harmonics = torch.full((len(means), 1, 3), (colour - 0.5) * 2 * math.sqrt(math.pi))
    count = len(means)
    opacities = torch.full((count,), math.log(opacity / (1 - opacity)))
    return Splats(
        torch.tensor(means), torch.ones(count, 4), torch.full((count, 3), math.log(scale)), opacities, harmonics
    )


@pytest.mark.parametrize(("eyes", "depth"), [(FREE, 0.09), (FREE, 0.105), (LENS, 0.12), (LENS, 0.3)])
def test_parallax_is_that_of_rays_through_the_eyepiece(eyes, depth):
    # A ray from the panel's pixel x with slope u reaches the pupil at A·x + B·u with the slope C·x + D·u; it seems to
    # come from what is on it at a distance before the pupil.
    display = display_of(eyes)
    if eyes is FREE:
        a, b, c, d = 1.0, DISTANCE, 0.0, 1.0
    else:
        first, thin, last = [[1, 0.025], [0, 1]], [[1, 0], [-1 / 0.04, 1]], [[1, 0.03], [0, 1]]
        (a, b), (c, d) = np.array(first) @ thin @ last
    wide = depth / abs(b) * 3 * PITCH
    x, y = 4 * wide, -2 * wide
    mesh = triangle_mesh(*quad(x, y, depth, wide, wide))
    views = views_of_mesh(mesh, display, PLACES, Placement(), samples=16).views[:, 0]
    dots = views_of_splats(splat((x, y, depth), scale=wide / 2), display, PLACES, Placement()).views[:, 0]
    for view, other, place in zip(views, dots, PLACES, strict=True):
        # p = A·x + B·u and p − depth·(C·x + D·u) = X give the pixel.
        expected = [
            float(np.linalg.solve([[a, b], [-depth * c, -depth * d]], [p, s - p])[0]) / PITCH + n // 2
            for p, s, n in zip(place, (y, x), (48, 64), strict=True)
        ]
        assert middle_of(view) == pytest.approx(expected, abs=0.05)
        assert middle_of(other) == pytest.approx(expected, abs=0.05)


def test_a_sphere_is_lit_by_the_cosine_of_the_angle_to_the_lamp():
    # Of a sphere of radius R at a distance, seen and lit from the axis.
    turns = torch.linspace(0, 2 * math.pi, 97, dtype=torch.float64)
    heights = torch.linspace(0, math.pi, 49, dtype=torch.float64)
    polar, around = torch.meshgrid(heights, turns, indexing="ij")
    points = torch.stack([polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos()], -1)
    at = torch.arange(48 * 96).reshape(48, 96) + torch.arange(48)[:, None]
    faces = torch.cat([torch.stack([at, at + 97, at + 98], -1), torch.stack([at, at + 98, at + 1], -1)]).reshape(-1, 3)
    radius, far = 0.02, DISTANCE
    # So large that the eye sees its slope: a panel of 2 mm pixels, which no wave sees here.
    display = Display(Modulator((48, 64), 1e-3), GREEN, FREE)
    mesh = triangle_mesh(points.reshape(-1, 3), faces, normals="smooth")
    stands = Placement(radius, (0.0, 0.0, far))
    for lamp in ((0.0, 0.0), (0.03, 0.0)):
        (view,) = views_of_mesh(mesh, display, [(0.0, 0.0)], stands, 0.5, lamp, samples=1).views[:, 0]
        y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) - n // 2 for n in (48, 64)), indexing="ij")
        towards = torch.stack([x * 1e-3, y * 1e-3, torch.full_like(x, DISTANCE)], -1)
        towards = towards / towards.norm(dim=-1, keepdim=True)
        along = far * towards[..., 2]
        inside = (far**2 - along**2) < (0.98 * radius) ** 2
        point = towards * (along - (radius**2 - far**2 + along**2).clamp(min=0).sqrt())[..., None]
        normal = (point - torch.tensor([0.0, 0.0, far])) / radius
        to_lamp = torch.tensor([lamp[1], lamp[0], 0.0], dtype=torch.float64) - point
        expected = 0.5 * (normal * to_lamp).sum(-1).abs() / to_lamp.norm(dim=-1)
        assert int(inside.sum()) > 800
        np.testing.assert_allclose(view[inside], expected[inside], atol=0.01)
        assert not bool(view[far**2 - along**2 > (1.01 * radius) ** 2].any())


def test_reflectances_of_vertices_are_even_between_them_and_of_colours():
    display = display_of(wavelengths=[638e-9, 520e-9, 450e-9])
    vertices, faces = quad(0.0, 0.0, DISTANCE, 0.25e-3, 0.19e-3)
    mesh = triangle_mesh(vertices, faces)
    across = torch.tensor([0.0, 1.0, 1.0, 0.0])
    colours = torch.stack([across, 1 - across, torch.full((4,), 0.25)], -1)
    red, green, blue = views_of_mesh(mesh, display, [(0.0, 0.0)], Placement(), colours).views[0]
    expected = ((torch.arange(64) - 32) * PITCH / 0.5e-3 + 0.5).clamp(0, 1)
    np.testing.assert_allclose(red[24, 4:60], expected[4:60], atol=0.01)
    np.testing.assert_allclose((red + green)[24, 4:60], 1, atol=0.01)
    np.testing.assert_allclose(blue[8:40, 4:60], 0.25, atol=0.001)
    alone = views_of_mesh(mesh, display, [(0.0, 0.0)], Placement(), across).views
    np.testing.assert_allclose(alone[0, 0], red, atol=1e-6)


@pytest.mark.parametrize("normals", ["flat", "smooth"])
def test_triangles_are_those_that_rays_meet(normals, monkeypatch):
    # A heap of triangles through one another, and rays that another module traces; few points at a time.
    monkeypatch.setattr(rendering, "_POINTS", 700)
    generator = torch.Generator().manual_seed(4)
    vertices = torch.randn(60, 3, generator=generator, dtype=torch.float64) * torch.tensor([1e-4, 1e-4, 5e-3])
    vertices[:, 2] += DISTANCE
    faces = torch.stack([torch.randperm(60, generator=generator)[:3] for _ in range(40)])
    vertices[faces[0, 0], 2] = -0.01
    kept = faces[(faces != faces[0, 0]).all(1)]
    assert len(kept) < len(faces)
    shares = torch.rand(60, generator=generator, dtype=torch.float64)
    (y, x), display = PLACES[1], display_of()
    mesh = triangle_mesh(vertices, faces, normals)
    (view,) = views_of_mesh(mesh, display, [(y, x)], Placement(), shares, (1e-2, 0.0), samples=1).views[0]
    rows, columns = (torch.arange(n, dtype=torch.float64) - n // 2 for n in (48, 64))
    slopes = torch.stack(torch.meshgrid((rows * PITCH - y) / DISTANCE, (columns * PITCH - x) / DISTANCE, indexing="ij"))
    rays = torch.zeros(48, 64, 2, 3, dtype=torch.float64)
    rays[..., 0, 0], rays[..., 0, 1] = x, y
    rays[..., 1, :] = torch.stack([slopes[1], slopes[0], torch.ones_like(slopes[0])], -1)
    met = triangle_mesh(vertices, kept, mesh.vertex_normals() if normals == "smooth" else "flat").intersect(rays)
    towards = torch.tensor([0.0, 1e-2, 0.0]) - met.point
    share = (met.barycentric * shares[kept[met.face.clamp(min=0)]]).sum(-1)
    expected = share * (met.normal * towards).sum(-1).abs() / towards.norm(dim=-1)
    assert 500 < int(met.hit.sum()) < 3000
    np.testing.assert_allclose(view, torch.where(met.hit, expected, 0.0), atol=1e-6)


def test_a_mesh_looks_like_its_picture_with_depth():
    # Two flat surfaces, as DepthScene shows them from the side: the near one hides as much of the far one.
    near, far, size = 0.09, 0.11, (24, 64)
    (one, sides), (other, _) = quad(0.0, 0.0, near, 8.2 * PITCH * 0.9, 1e-2), quad(0.0, 0.0, far, 1e-2, 1e-2)
    mesh = triangle_mesh(torch.cat([one, other]), torch.cat([sides, sides + 4]))
    albedo = torch.tensor([1.0] * 4 + [0.3] * 4)
    display = Display(Modulator(size, PITCH), GREEN, Eyes(DISTANCE, [(0.0, 0.6e-3)], 1e-3, focus=near))
    side = torch.linspace(-0.5e-3, 0.5e-3, 7)
    places = torch.cartesian_prod(side, side + 0.6e-3)
    field = views_of_mesh(mesh, display, places, Placement(), albedo)
    picture, depth = torch.full(size, 0.3), torch.full(size, far)
    inside = slice(32 - 8, 32 + 9)
    picture[:, inside], depth[:, inside] = 1.0, near
    scene = DepthScene(picture, depth).images(display)
    np.testing.assert_allclose(field.images(display)[0, 0, 12, 8:-8], scene[0, 0, 12, 8:-8], atol=0.06)


@pytest.mark.parametrize("eyes", [FREE, LENS])
def test_splats_are_those_of_the_renderer_of_complex_ones(eyes):
    # Its camera turns both axes of the picture and needs distances of 1 to 1000: in millimetres here.
    generator = torch.Generator().manual_seed(2)
    size, count = (48, 64), 24
    display = display_of(eyes, size)
    _, b, d = display.path.sight(0, 0).ray_matrix()
    means = torch.rand(count, 3, generator=generator) - 0.5
    means = means * torch.tensor([0.5 / d, 0.4 / d, 8.0]) + torch.tensor([0.0, 0.0, 1e3 * b / d])
    quats, scales = torch.randn(count, 4, generator=generator), torch.rand(count, 3, generator=generator)
    opacities, harmonics = torch.randn(count, generator=generator), torch.randn(count, 4, 3, generator=generator)
    splats = Splats(means, quats, (0.05 / d * (0.3 + scales)).log(), opacities, 0.5 * harmonics)
    place = PLACES[1]
    field = views_of_splats(splats, display, [place], Placement(1e-3))
    settings = Namespace(num_planes=1, wavelengths=[6e-7] * 3, pixel_pitch=PITCH, distances=[0.0], pad_size=list(size))
    settings.aperture_size = -1
    known = complex_3d_gaussians("random", "cpu", num_points=count, args_prop=settings, seed=0)
    eye = torch.tensor([1e3 * place[1], 1e3 * place[0], 0.0])
    turned = torch.diag(torch.tensor([-1.0, -1.0, 1.0]))
    middle = [d * q / PITCH + n // 2 for q, n in zip(place[::-1], size[::-1], strict=True)]
    camera = PerspectiveCamera(turned, -(eye @ turned), [b / PITCH] * 2, middle)
    directions = torch.nn.functional.normalize(means - eye, dim=-1)
    c1 = math.sqrt(3 / (4 * math.pi))
    x, y, z = (0.5 * harmonics[:, k] * c1 for k in (3, 1, 2))
    colours = 0.25 * harmonics[:, 0] / math.sqrt(math.pi) + 0.5
    colours = colours - directions[:, 1:2] * y + directions[:, 2:] * z - directions[:, :1] * x
    activated = known.apply_activations(quats, splats.scales, torch.zeros(count, 3), opacities, torch.zeros(count, 1))
    units, sizes, phases, opaque, planes = activated
    shown = (means, means[:, 2], units, sizes, colours.clamp(min=0), phases, opaque, planes, torch.tensor([6e-7] * 3))
    _, fields = Scene(known, settings).splat(camera, *shown, size[::-1])
    expected = light_of(fields[0].real.clamp(0, 1), display).targets
    assert float(expected.max()) > 0.2
    np.testing.assert_allclose(field.views[0], expected, atol=2e-3)


def test_splats_of_antialiased_training_keep_the_sum_of_their_opacity():
    """A round one of variance v square pixels has v/(v + 0.3) of its opacity, and all of it where it is not said."""
    display, opacity, size = display_of(), 0.6, 3e-6
    _, b, _ = display.path.sight(0, 0).ray_matrix()
    variance = (size * b / DISTANCE / PITCH) ** 2
    at = (0.0, 0.0, DISTANCE)
    found = views_of_splats(splat(at, scale=size, opacity=opacity), display, PLACES, Placement(), antialiased=True)
    dimmer = splat(at, scale=size, opacity=opacity * variance / (variance + 0.3))
    expected = views_of_splats(dimmer, display, PLACES, Placement()).views
    torch.testing.assert_close(found.views, expected, rtol=1e-4, atol=0)
    plain = views_of_splats(splat(at, scale=size, opacity=opacity), display, PLACES, Placement()).views
    assert float(plain.max()) > 2 * float(found.views.max()) > 0


def test_near_splats_cover_far_ones():
    both = splat((0.0, 0.0, 0.11), (0.0, 0.0, 0.09), scale=2e-4, opacity=0.6)
    both.harmonics[1] = -math.sqrt(math.pi)
    picture = views_of_splats(both, display_of(), [(0.0, 0.0)], Placement()).views[0]
    expected = light_of(torch.full((3, 1, 1), 0.9 * 0.6 * 0.4), [GREEN], grey=True).targets
    assert float(picture[0, 24, 32]) == pytest.approx(float(expected), rel=1e-3)
    none = views_of_splats(splat((0.0, 0.0, -0.1)), display_of(), [(0.0, 0.0)], Placement()).views
    assert not bool(none.any())


@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (20.0, -35.0, 10.0)])
def test_a_scene_fills_the_picture_without_being_cut(turned):
    display = display_of(LENS)
    points = torch.randn(200, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    place = Placement.fitting(points, display, turned=turned)
    stands = place.of(points)
    _, b, d = display.path.sight(0, 0).ray_matrix()
    assert place.shift[2] == pytest.approx(b / d, rel=0.05)
    pixels = (stands[:, :2] * b / stands[:, 2:] / PITCH).abs().amax(0) / torch.tensor([32.0, 24.0])
    # A box around the points fills it; they themselves nearly.
    assert 0.6 < float(pixels.max()) <= 1
    corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0], dtype=torch.float64)] * 3)
    at = Placement.fitting(corners, display, 0.3).of(corners)
    widest = (at[:, :2] * b / at[:, 2:] / PITCH).abs().amax(0) / torch.tensor([32.0, 24.0])
    assert float(widest.max()) == pytest.approx(1) and float(at[:, 2].mean()) == pytest.approx(0.3)
    # Upwards is upwards, and what graphics have in front is near.
    up, front = Placement.fitting(corners, display).of(torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    assert float(up[1]) < 0 and float(front[2]) < b / d
    outlier = torch.cat([points, torch.full((1, 3), 1e3)])
    most = Placement.fitting(outlier, display, turned=turned, share=0.98).scale
    assert most == pytest.approx(place.scale, rel=0.4)


def test_what_does_not_fit_is_refused():
    display, mesh = display_of(), triangle_mesh(*quad(0.0, 0.0, DISTANCE, 1e-4, 1e-4))
    planes, at_infinity = Display(Modulator((32, 32), PITCH), GREEN, 0.1), display_of(Eyes(Lens(0.04, before=0.04)))
    for wrong, words in (
        (lambda: Placement(0.0), "scale must be positive"),
        (lambda: Placement(1.0, (0.0, 1.0)), "shift must be"),
        (lambda: Placement(rotation=torch.ones(3, 3)), "rotation must be a rotation matrix"),
        (lambda: Placement.fitting(mesh.vertices, display, share=2.0), "share must be above 0"),
        (lambda: Placement.fitting(mesh.vertices, at_infinity), "distance must be given"),
        (lambda: views_of_mesh(mesh, planes, PLACES), "display must be one for"),
        (lambda: views_of_mesh(mesh, display, [0.0, 1.0]), r"places must be \[V, 2\]"),
        (lambda: views_of_mesh(mesh, display, PLACES, reflectance=torch.ones(5)), r"reflectance must be one number or"),
        (lambda: views_of_mesh(mesh, display, PLACES, reflectance=2.0), "reflectance must be of 0"),
        (lambda: views_of_mesh(mesh, display, PLACES, samples=0), "samples"),
    ):
        with pytest.raises(ValueError, match=words):
            wrong()
    for wrong, words in (
        (lambda: views_of_mesh(mesh.vertices, display, PLACES), "mesh must be"),
        (lambda: views_of_splats(mesh, display, PLACES), "splats must be"),
        (lambda: views_of_mesh(mesh, display, PLACES, 1.0), "placement must be"),
    ):
        with pytest.raises(TypeError, match=words):
            wrong()
