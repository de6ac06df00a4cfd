"""Scenes as targets, and maps of an eyebox: against geometry, diffraction, areas of segments, and direct sums."""

import math
import xml.etree.ElementTree as Xml
from unittest import mock

import numpy as np
import pytest
import torch
from scipy import special

from odak import AccuracyWarning
from odak.instruments import Lens
from odak.learn.tools import save_image
from odak.learn.wave import (
    DepthScene,
    Display,
    Eyes,
    Iris,
    LightField,
    Modulator,
    Run,
    eyebox_map,
    optimise,
)
from odak.learn.wave.displays import judge

pytestmark = pytest.mark.usefixtures("small_judge")

WAVELENGTH, PITCH, DISTANCE = 532e-9, 8e-6, 0.1
OFF = [(0.0, 0.0), (0.4e-3, -0.9e-3), (-0.7e-3, 0.5e-3)]


def seen_by(eyes, size=(64, 80), wavelengths=WAVELENGTH, pitch=PITCH, **options):
    return Display(Modulator(size, pitch, None), wavelengths, eyes, **options).double()


def centroid(light):
    y, x = (torch.arange(n, dtype=torch.float64) for n in light.shape)
    return float((light.sum(1) * y).sum() / light.sum()), float((light.sum(0) * x).sum() / light.sum())


def dot(size, row, column):
    picture = torch.zeros(size, dtype=torch.float64)
    picture[row - 1 : row + 2, column - 1 : column + 2] = 1.0
    return picture


@pytest.mark.parametrize("depth", [0.09, 0.125, math.inf])
def test_parallax_is_that_of_similar_triangles(depth):
    # A point at X·depth/distance beside the axis is seen through x = X + p·(1 − distance/depth) on the panel.
    scene = DepthScene(dot((64, 80), 30, 41), torch.full((64, 80), depth))
    images = scene.images(seen_by(Eyes(DISTANCE, OFF, 3e-3, depth)))
    for image, place in zip(images[:, 0], OFF, strict=True):
        # A far point is shifted out of the panel here and there.
        expected = [at + p * (1 - DISTANCE / depth) / PITCH for at, p in zip((30, 41), place, strict=True)]
        if all(4 < at < n - 4 for at, n in zip(expected, (64, 80), strict=True)):
            bright = image * (image > 0.1 * image.max())
            assert centroid(bright) == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize("ends", [DISTANCE, Lens(0.04, before=0.024, after=0.025)])
def test_parallax_is_that_of_spherical_waves(ends):
    # The panel shows the wave of a point 12 mm behind it, which pupils see where a scene of its distance is seen.
    size, behind = (96, 96), 12e-3
    display = seen_by(Eyes(ends, OFF, 2e-3), size)
    a, b, d = display.path.sight(0, 0).ray_matrix()
    c = (a * d - 1) / b
    depth = (a * behind + b) / (c * behind + d)
    eyes = Eyes(ends, OFF, 2e-3, abs(depth))
    x = (torch.arange(96, dtype=torch.float64) - 48) * PITCH
    wave = math.pi / (WAVELENGTH * behind) * (x[:, None] ** 2 + x**2)
    waves = seen_by(eyes, size)(wave[None])[:, 0]
    scene = DepthScene(dot(size, 48, 48), torch.full(size, depth)).images(seen_by(eyes, size))[:, 0]
    moved = [0.0, 0.0]
    for k, (light, wanted) in enumerate(zip(waves, scene, strict=True)):
        found, expected = (centroid(part * (part > 0.3 * part.max())) for part in (light, wanted))
        assert found == pytest.approx(expected, abs=0.4)
        moved[0] = max(moved[0], abs(expected[0] - 48), abs(expected[1] - 48)) if k else 0.0
    assert moved[0] > 3


@pytest.mark.parametrize("focus", [0.1, 0.104, 0.108, 0.114])
def test_contrast_over_focus_is_that_of_a_disc_and_of_diffraction(focus):
    diameter, period = 2e-3, 16
    stripes = 0.5 + 0.5 * torch.cos(2 * math.pi * torch.arange(160, dtype=torch.float64) / period).expand(96, 160)
    scene = DepthScene(stripes, torch.full((96, 160), 0.1))
    image = scene.images(seen_by(Eyes(DISTANCE, [(0.0, 0.0)], diameter, focus), (96, 160)))[0, 0, 40:56, 40:120]
    wave = torch.exp(2j * math.pi * torch.arange(40, 120, dtype=torch.float64) / period)
    contrast = float(2 * (image * wave).mean().abs() / image.mean())
    # The width of the blur in pixels, and the frequency as a share of the highest that the pupil passes.
    width = diameter * abs(1 - DISTANCE / focus) / PITCH
    turn = math.pi * width / period
    rho = WAVELENGTH * DISTANCE / (diameter * PITCH * period)
    passed = 2 / math.pi * (math.acos(rho) - rho * math.sqrt(1 - rho**2))
    disc = 2 * special.j1(turn) / turn if turn else 1.0
    # Straight lines between the pixels of the stripes dim them a little where they are moved by half a pixel.
    assert contrast == pytest.approx(abs(disc) * passed, abs=0.02)


def test_image_of_a_point_is_as_wide_as_diffraction_makes_it():
    diameter = 0.8e-3
    scene = DepthScene(dot((96, 96), 48, 48), torch.full((96, 96), DISTANCE))
    row = scene.images(seen_by(Eyes(DISTANCE, [(0.0, 0.0)], diameter), (96, 96)))[0, 0, 48]
    x = np.arange(-40, 40, 0.05)
    # Airy's disc under the three pixels of the point, and the mean over three pixels along the other side.
    r = np.pi * diameter * PITCH / (WAVELENGTH * DISTANCE) * np.hypot(x[:, None], x[None])
    disc = (2 * special.j1(r) / np.where(r == 0, 1, r)) ** 2 + (r == 0)
    inside = abs(x) <= 1.5
    profile = np.convolve(disc[inside].sum(0), np.ones(60), "same")
    wide = np.ptp(x[profile > profile.max() / 2])
    fine = np.interp(x + 48, np.arange(96), row)
    assert np.ptp(x[fine > fine.max() / 2]) == pytest.approx(wide, rel=0.03)


def test_what_is_near_covers_the_share_of_the_pupil_that_it_hides():
    # Bright and near on the left; an eye focused far sees the edge through a disc, cut along a chord.
    size, diameter, near = (48, 128), 4e-3, 0.096
    picture, depth = torch.full(size, 0.2, dtype=torch.float64), torch.full(size, DISTANCE)
    picture[:, :64], depth[:, :64] = 1.0, near
    image = DepthScene(picture, depth).images(seen_by(Eyes(DISTANCE, [(0.0, 0.0)], diameter, DISTANCE), size))[0, 0, 24]
    radius = diameter / 2 * (DISTANCE / near - 1) / PITCH
    assert radius > 10
    # From the edge at 63.5, in radii.
    u = np.clip((np.arange(128) - 63.5) / radius, -1, 1)
    cover = (np.arccos(u) - u * np.sqrt(1 - u**2)) / np.pi
    np.testing.assert_allclose(image[20:-20], (0.2 + 0.8 * cover)[20:-20], atol=0.02)


def test_a_pupil_to_the_side_sees_behind_what_is_near():
    # The strip that appears has the colours beside it in the picture, not those that hid it.
    size = (24, 96)
    picture, depth = torch.full(size, 0.25, dtype=torch.float64), torch.full(size, 0.125)
    picture[:, 36:60], depth[:, 36:60] = 1.0, DISTANCE
    eyes = Eyes(DISTANCE, [(0.0, 0.0), (0.0, 0.8e-3)], 2e-3, 0.125)
    straight, aside = DepthScene(picture, depth).images(seen_by(eyes, size, iris=None))[:, 0, 12]
    # The far plane moves by 20 pixels behind the near one, which is even: nothing but the blur of the edge is seen.
    np.testing.assert_allclose(aside, straight, atol=0.02)


def test_light_field_of_a_plane_is_sharp_and_blurred_as_its_scene_is():
    size, plane = (64, 96), 0.11
    generator = torch.Generator().manual_seed(0)
    coarse = torch.rand(1, 1, 8, 12, dtype=torch.float64, generator=generator)
    picture = torch.nn.functional.interpolate(coarse, size, mode="bicubic").clamp(0, 1)[0, 0]
    side = torch.linspace(-2.4e-3, 2.4e-3, 25, dtype=torch.float64)
    rays = torch.cartesian_prod(side, side)
    for focus, apart in ((plane, 0.01), (0.103, 0.02)):
        display = seen_by(Eyes(DISTANCE, OFF[1:], 1.8e-3, focus), size)
        scene = DepthScene(picture, torch.full(size, plane)).images(display)
        # Without parallax on its own plane, all views are alike.
        field = LightField(picture.expand(len(rays), *size), rays, plane).images(display)
        shown = LightField(torch.zeros(len(rays), *size) + 0.5, rays).images(display)
        assert float((field - scene)[..., 8:-8, 8:-8].abs().max()) < apart
        torch.testing.assert_close(shown, torch.full_like(shown, 0.5), rtol=1e-4, atol=0)
    wrong = LightField(picture.expand(len(rays), *size), rays).images(display)
    assert float((wrong - scene)[..., 8:-8, 8:-8].abs().max()) > 0.1


def test_planes_show_a_focal_stack_as_wide_as_their_cone():
    iris, size, planes = Iris(1.5e-3, 0.05), (64, 64), (3e-3, 5e-3)
    scene = DepthScene(dot(size, 32, 32), torch.full(size, 5e-3))
    display = Display(Modulator(size, PITCH, None), WAVELENGTH, planes, iris=iris).double()
    far, sharp = scene.images(display)[:, 0]
    # A disc of so many pixels: the light of nine of them, spread evenly.
    radius = 0.03 * 2e-3 / PITCH
    assert float(far[32, 32]) == pytest.approx(9 / (math.pi * radius**2), rel=0.06)
    assert float(sharp[32, 32]) > 4 * float(far[32, 32])
    assert float(far.sum()) == pytest.approx(9, rel=0.02)
    square = Display(Modulator(size, PITCH, None), WAVELENGTH, planes).double()
    side = WAVELENGTH / PITCH * 2e-3 / PITCH
    assert float(scene.images(square)[0, 0, 32, 32]) == pytest.approx(9 / side**2, rel=0.1)


def test_pupils_fill_their_box_evenly_and_are_drawn_by_a_seed():
    eyes = Eyes.within(DISTANCE, (2e-3, 4e-3), 64, (2e-3, 6e-3), (0.25, math.inf), seed=3)
    assert eyes == Eyes.within(DISTANCE, (2e-3, 4e-3), 64, (2e-3, 6e-3), (0.25, math.inf), seed=3)
    assert eyes != Eyes.within(DISTANCE, (2e-3, 4e-3), 64, (2e-3, 6e-3), (0.25, math.inf), seed=4)
    places = np.array(eyes.positions) / [2e-3, 4e-3] + 0.5
    counts = np.histogram2d(*places.T, bins=4, range=[(0, 1), (0, 1)])[0]
    assert counts.sum() == 64 and counts.min() >= 2 and counts.max() <= 6
    for values, least, most in ((eyes.diameter, 2e-3, 6e-3), (1 / np.array(eyes.focus), 0.0, 4.0)):
        ranks = np.floor((np.array(values) - least) / (most - least) * 64)
        assert sorted(ranks) == list(range(64))


def direct(field, place, diameter, fill=0.9, across=120):
    """Return an intensity on a retina, and the light in the pupil, by sums over areas of pixels and of the pupil."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    fine = (np.arange(across) - (across - 1) / 2) / across * diameter
    parts = []
    for n, p in zip(field.shape, place, strict=True):
        x = (np.arange(n) - n // 2) * PITCH
        sides = math.sqrt(fill) * PITCH / 2 * nodes
        spread = [np.exp(1j * np.pi / (WAVELENGTH * DISTANCE) * (p + fine[:, None] - x - s) ** 2) for s in sides]
        parts.append((sum(w / 2 * one for w, one in zip(weights, spread, strict=True)), p + fine, x))
    there = parts[0][0] @ field @ parts[1][0].T * (fine[:, None] ** 2 + fine**2 <= (diameter / 2) ** 2)
    back = [np.exp(-1j * np.pi / (WAVELENGTH * DISTANCE) * (u[None] - x[:, None]) ** 2) for _, u, x in parts]
    step = diameter / across / (WAVELENGTH * DISTANCE / PITCH)
    return abs(back[0] @ there @ back[1].T * step**2) ** 2, float((abs(there) ** 2).sum() * step**2)


@pytest.fixture(scope="module")
def found():
    """A scene of two depths, its hologram for pupils in a box, and that of its picture alone on the panel's plane."""
    size = (32, 40)
    picture = torch.rand(4, 5, generator=torch.Generator().manual_seed(1)).kron(torch.ones(8, 8))
    depth = torch.full(size, 0.103)
    depth[8:24, 12:28] = 0.098
    scene, run = DepthScene(0.1 + 0.9 * picture, depth), Run(16, progress=False, seed=0)
    panel = Modulator(size, PITCH, None)
    eyes = Eyes.within(DISTANCE, 2e-3, 9, 2e-3)
    # What the judge states of them is not looked at.
    with mock.patch.object(judge, "_LEAST", 128), mock.patch.object(judge, "_AIRY", 16):
        field = optimise(Display(panel, WAVELENGTH, eyes, frames=4, iris=None), scene, run=run)
        flat = optimise(Display(panel, WAVELENGTH, 1e-3, frames=4, iris=None), 0.1 + 0.9 * picture, run=run)
    return scene, field, flat


def test_map_of_an_eyebox_equals_direct_sums_at_pupils_that_were_not_optimised(found):
    scene, field, _ = found
    seen = eyebox_map(field, scene, (1.6e-3, 1.2e-3), (3, 2), 2e-3)
    assert seen.psnr.shape == seen.brightness.shape == (3, 2)
    phases, light = field.phases.double().numpy(), []
    for r, q in ((0, 1), (2, 0)):
        place = float(seen.rows[r]), float(seen.columns[q])
        sums = [direct(np.exp(1j * phase), place, 2e-3) for phase in phases]
        # Means over pixels, of points at their middles here: the picture is what is compared.
        points = np.mean([one for one, _ in sums], 0)
        own = seen.display.judge(field.phases)[1][r * 2 + q, 0].numpy()
        assert np.linalg.norm(own - points) < 0.02 * np.linalg.norm(points)
        light.append((np.mean([power for _, power in sums]), float(seen.images[r, q].sum())))
    # What passes a pupil lands on the retina, and a little of it beyond the image.
    (one, shown), (other, alike) = light
    assert shown / alike == pytest.approx(one / other, rel=0.08)


def test_light_that_is_optimised_for_pupils_is_good_at_others_too(found):
    scene, field, flat = found
    seen = eyebox_map(field, scene, 1.4e-3, 3, 2e-3, foci=[0.08, 0.1, math.inf])
    alone = eyebox_map(flat, scene, 1.4e-3, 3, 2e-3, distance=DISTANCE)
    assert float(seen.psnr.min()) > float(alone.psnr.min()) + 2
    assert float(seen.psnr.mean()) > float(alone.psnr.mean()) + 3
    assert float(seen.brightness.mean()) > 1.5 * float(alone.brightness.mean())
    assert seen.psnr_of_focus.argmax() == 1 and len(alone.foci) == 0
    # The middle of the map is the focus of the panel.
    torch.testing.assert_close(seen.psnr_of_focus[1], seen.psnr[1, 1], rtol=0.05, atol=0)


def test_map_shows_itself(found):
    scene, field, _ = found
    seen = eyebox_map(field, scene, 1e-3, (1, 2), 2e-3, foci=[0.09, 0.1])
    assert "pupils of 2 mm in 0 × 1 mm" in repr(seen)
    drawing = Xml.fromstring(seen.drawing())
    numbers = [text.text for text in drawing.iter("{http://www.w3.org/2000/svg}text")]
    assert f"{float(seen.psnr[0, 1]):.0f}" in numbers and f"{float(seen.brightness[0, 0]):.2f}" in numbers
    page = seen._repr_html_()
    assert page.count("<img") == 3 and "0.09 m" in page
    assert "32 × 40" in repr(scene) and "<img" in scene._repr_html_()


def test_views_are_loaded_from_a_folder(tmp_path):
    for k in range(3):
        save_image(str(tmp_path / f"{2 - k}.png"), np.full((8, 8, 3), k / 2), cmin=0, cmax=1)
    rays = [(0.0, -1e-3), (0.0, 0.0), (0.0, 1e-3)]
    field = LightField.load(tmp_path, rays)
    assert field.views.shape == (3, 3, 8, 8)
    np.testing.assert_allclose(field.views[:, 0, 0, 0], [1, 0.5, 0], atol=0.01)
    assert repr(field) == "LightField: 3 views of 8 × 8 pixels" and "<img" in field._repr_html_()
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="folder must hold pictures"):
        LightField.load(tmp_path / "empty", rays)


@pytest.mark.parametrize("colours", [1, 3])
def test_views_are_kept_in_a_folder(tmp_path, colours):
    views, rays = torch.rand(11, colours, 6, 8), torch.randn(11, 2, dtype=torch.float64) * 1e-3
    LightField(views, rays).save(tmp_path / "field")
    again = LightField.load(tmp_path / "field", plane=0.2)
    assert torch.equal(again.rays, rays) and float(again.plane) == 0.2
    np.testing.assert_allclose(again.views, views, atol=1 / 65535)
    table = tmp_path / "some.csv"
    table.write_text("file,y,x\nfield/view_03.png,1e-3,0\n")
    assert LightField.load(table).rays.tolist() == [[1e-3, 0.0]]
    for text, words in (("file,y\na.png,1\n", "must have a line file,y,x"), ("file,y,x\n", "a view at least")):
        table.write_text(text)
        with pytest.raises(ValueError, match=words):
            LightField.load(table)
    with pytest.raises(ValueError, match="must be a table of views"):
        LightField.load(tmp_path)


def test_what_does_not_fit_is_refused(found):
    scene, field, flat = found
    picture, depth = torch.ones(8, 8), torch.full((8, 8), 0.1)
    for wrong, words in (
        (lambda: DepthScene(picture, depth[:4]), r"depth must be \[rows, columns\]"),
        (lambda: DepthScene(picture, depth * math.nan), "NaN"),
        (lambda: DepthScene(-picture, depth), "picture must be finite"),
        (lambda: DepthScene(picture, depth, 0), "layers"),
        (lambda: DepthScene(picture, depth).images(field.display), "picture must be of"),
        (lambda: DepthScene(scene.picture, -scene.depth).images(field.display), "depth must be positive"),
        (lambda: DepthScene(scene.picture, scene.depth * math.inf).images(flat.display), "depth must be finite"),
        (lambda: LightField(torch.ones(2, 8, 8), [(0.0, 0.0)]), r"rays must be \[V, 2\]"),
        (lambda: eyebox_map(flat, scene, 1e-3), "distance must be given"),
        (lambda: Eyes.within(0.1, 1e-3, 4, focus=(0.0, 1.0)), "focus must be positive"),
        (lambda: scene.images(Display(Modulator((32, 40), PITCH), WAVELENGTH, Lens(0.1))), "behind a lens"),
    ):
        with pytest.raises(ValueError, match=words):
            wrong()
    with pytest.raises(TypeError, match="hologram must be"):
        eyebox_map(field.phases, scene, 1e-3)
    few = LightField(torch.ones(2, 32, 40), [(0.0, 0.0), (0.0, 0.2e-3)])
    with pytest.warns(AccuracyWarning, match="further from all views"):
        few.images(field.display)
