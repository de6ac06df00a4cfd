import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
ASSETS = ROOT / "odak" / "assets"


def load(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def script():
    return load("draw_test_chart")


@pytest.fixture(scope="module")
def chart():
    with Image.open(ASSETS / "chart.png") as image:
        return np.asarray(image)


def test_the_chart_is_what_the_script_draws(script, chart):
    assert chart.dtype == np.uint8
    drawn = script.draw_chart()
    # The star's edges come from hypot and arctan2, whose last bit differs between C libraries.
    assert np.abs(drawn.astype(int) - chart).max() <= 1
    assert (ASSETS / "chart.png").stat().st_size < 150_000


def test_bars_shrink_by_the_sixth_root_of_two(script):
    assert script.bar_width(0, 1) / script.bar_width(0, 2) == pytest.approx(2 ** (1 / 6))
    assert script.bar_width(2, 3) == pytest.approx(script.bar_width(1, 3) / 2)


def test_bars_carry_their_exact_area(script, chart):
    top, left = script.GROUPS[1]
    width = script.bar_width(1, 1)
    element = chart[int(top) : int(top + 5 * width), int(left) : int(left + 5 * width)].astype(float) / 255
    assert element.sum() == pytest.approx(3 * width * 5 * width, rel=1e-3)


def test_the_wedge_has_sixteen_even_steps(script, chart):
    top, left = script.WEDGE_CORNER
    height, width = script.WEDGE_SIZE
    step = width / 16
    line = chart[int(top + height / 2), [int(left + (index + 0.5) * step) for index in range(16)]]
    assert line.tolist() == [17 * index for index in range(16)]


def test_marks_do_not_overlap(script):
    canvas = np.zeros(script.SHAPE)
    for group, (top, left) in enumerate(script.GROUPS):
        script._draw_group(canvas, group, top, left)
    assert canvas.max() <= 1 + 1e-9


def test_the_photograph_is_the_documented_one():
    import hashlib

    with Image.open(ASSETS / "photo.png") as picture:
        assert picture.size == (600, 400)
        assert picture.mode == "RGB"
    digest = hashlib.sha256((ASSETS / "photo.png").read_bytes()).hexdigest()
    assert digest in (ASSETS / "SOURCES.md").read_text(encoding="utf-8")


def test_the_scene_is_what_the_script_renders():
    rows = slice(500, 512)
    colours, depth = load("render_scene").render(rows=rows)
    with Image.open(ASSETS / "scene.png") as picture, Image.open(ASSETS / "scene_depth.png") as map_of_depth:
        shipped, shipped_depth = np.asarray(picture), np.asarray(map_of_depth)
    assert shipped.shape == (1080, 1920, 3)
    assert shipped.dtype == np.uint8
    assert shipped_depth.dtype == np.uint16
    # Where a ray grazes an edge, another C library may decide otherwise.
    assert (np.abs(colours.astype(float) - shipped[rows]) <= 1).mean() > 0.999
    assert (np.abs(depth.astype(float) - shipped_depth[rows]) <= 1).mean() > 0.999


def test_the_scene_lies_on_every_plane():
    with Image.open(ASSETS / "scene_depth.png") as picture:
        depth = np.asarray(picture) / 65535
    assert depth.min() == 0
    assert depth.max() == 1
    shares = np.bincount(np.round(3 * depth).astype(int).ravel()) / depth.size
    assert shares.min() > 0.1
    assert shares.max() < 0.5
