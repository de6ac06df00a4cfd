"""Images are drawn right by the browser, and a page opens in it without an error."""

import io
import os
import stat
import subprocess
import sys

import numpy as np
import plotly.colors
import pytest
from PIL import Image

from odak.learn.raytracing.system import load_system
from odak.visualize.plotly import (
    BrowserNotFoundError,
    close_browser,
    detectorshow,
    field_show,
    find_browser,
    plot2dshow,
    plotshow,
    rayshow,
    system_show,
)

WHITE = (255, 255, 255)


def pixels(picture, tmp_path, **options):
    name = tmp_path / "picture.png"
    picture.save_image(name, **options)
    with Image.open(name) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def is_near(image, colour, tolerance=40):
    return np.abs(image - np.array(colour)).sum(-1) < tolerance


def centre(mask):
    """Return the mean row and column of what is true."""
    assert mask.sum() > 20
    return np.argwhere(mask).mean(0)


def hexadecimal(colour):
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


def frame(picture, number=1):
    """Return left, right, top and bottom pixels of a square image, from the layout."""
    layout = picture.fig.layout
    suffix = "" if number == 1 else number
    width = layout.width - layout.margin.l - layout.margin.r
    height = layout.height - layout.margin.t - layout.margin.b
    (left, right), (low, high) = layout[f"xaxis{suffix}"].domain, layout[f"yaxis{suffix}"].domain
    side = min((right - left) * width, (high - low) * height)
    middle = layout.margin.l + (left + right) / 2 * width
    top = layout.margin.t + (1 - high) * height
    return middle - side / 2, middle + side / 2, top, top + side


@pytest.mark.browser
@pytest.mark.slow
def test_colours_of_an_image_are_in_their_places(tmp_path):
    # Quarters: 0 and 1 above, 2 and 3 below.
    values = np.kron(np.array([[0.0, 1.0], [2.0, 3.0]]), np.ones((8, 8)))
    picture = field_show(values * np.exp(1j * np.pi * values / 2), dx=8e-6, wavelength=532e-9, show=False)
    image = pixels(picture, tmp_path)
    assert image.shape == (picture.fig.layout.height, picture.fig.layout.width, 3)
    scales = [plotly.colors.sequential.Inferno, [c for _, c in picture.fig.data[1].colorscale]]
    for number, wanted in ((1, {(0, 0): scales[0][0], (1, 1): scales[0][-1], (0, 1): scales[0][3]}), (2, {})):
        left, right, top, bottom = frame(picture, number)
        spots = {
            (i, j): image[
                round(top + (0.25 + 0.5 * i) * (bottom - top)), round(left + (0.25 + 0.5 * j) * (right - left))
            ]
            for i in (0, 1)
            for j in (0, 1)
        }
        for place, colour in wanted.items():
            assert np.abs(spots[place] - hexadecimal(colour)).max() <= 3
    # Phases 0, 90, 180 and 270 = −90 degrees: 180 has the colour of both ends of the scale.
    assert np.abs(spots[1, 0] - hexadecimal(scales[1][0])).max() <= 3
    assert (np.abs(spots[0, 1] - spots[1, 1]).max()) > 60
    # The bar stands between the two images, dark below and bright above.
    bar = image[:, round(frame(picture, 1)[1] + 15)]
    top, bottom = frame(picture, 1)[2:]
    assert np.abs(bar[round(top) + 3] - hexadecimal(scales[0][-1])).max() < 12
    assert np.abs(bar[round(bottom) - 3] - hexadecimal(scales[0][0])).max() < 12


@pytest.mark.browser
@pytest.mark.slow
def test_points_and_rays_are_in_their_places(tmp_path):
    picture = rayshow(shape=[600, 500], marker_size=8.0, line_width=6.0, opacity=1.0)
    picture.add_point([-1.0, 0.0, 0.0], color="red")
    picture.add_point([1.0, 0.0, 0.0], color="blue")
    ends = np.array([[-0.5, 0.8, 0.0], [0.0, 0.8, 0.0], [0.5, 0.8, 0.0]])
    picture.add_line(ends, ends + np.array([0.0, 0.0, 0.5]), color="rgb(0, 160, 0)")
    picture.add_line([[-0.8, -0.5, 0.0]], [[0.8, -0.5, 0.0]], color="orange", dash="dash")
    picture.set_camera(x=0.0, y=-0.6, z=2.2, up="y")
    picture.set_axis_limits(z_limits=[-1.0, 1.0])
    image = pixels(picture, tmp_path)
    assert image.shape == (500, 600, 3)
    red, blue, green = (centre(is_near(image, c, 90)) for c in ((255, 0, 0), (0, 0, 255), (0, 160, 0)))
    assert red[1] < green[1] - 50 < blue[1] - 100
    assert green[0] < red[0] - 30 and abs(red[0] - blue[0]) < 15
    # Three rays with white between them: gaps separate the lines of one trace.
    row = round(green[0])
    across = is_near(image, (0, 160, 0), 120)[row - 5 : row + 5].any(0).astype(int)
    assert (np.diff(across) == 1).sum() == 3
    # A dashed line is broken.
    dashes = is_near(image, (255, 165, 0), 120).any(0).astype(int)
    assert (np.diff(dashes) == 1).sum() > 3


@pytest.mark.browser
@pytest.mark.slow
def test_a_transparent_scene_does_not_mask_the_next(tmp_path):
    def draw(with_ball):
        picture = rayshow(columns=2, shape=[800, 400], marker_size=6.0, subplot_titles=[])
        picture.add_point(np.random.default_rng(0).normal(size=(50, 3)), color="blue")
        if with_ball:
            picture.add_sphere([0.0, 0.0, 0.0, 1.0])
        picture.add_triangle(np.eye(3), column=2, color="purple")
        return pixels(picture, tmp_path)[:, 400:]

    alone, beside = draw(False), draw(True)
    assert (alone != WHITE).any(-1).mean() > 0.1
    assert (np.abs(alone - beside).sum(-1) > 60).mean() < 0.002


@pytest.mark.browser
@pytest.mark.slow
def test_a_lens_system_is_seen_from_the_side(tmp_path):
    picture = system_show(load_system("cooke_triplet"), show=False)
    image = pixels(picture, tmp_path)
    assert image.shape == (600, 1100, 3)
    codes = [trace.line.color.removeprefix("#") for trace in picture.fig.data if trace.showlegend]
    colours = [tuple(int(code[i : i + 2], 16) for i in (0, 2, 4)) for code in codes]
    # Where the fields' rays end, at the right: the field of 20 degrees highest.
    image[:, 960:] = 255  # the legend
    places = [np.argwhere(is_near(image, colour, 60)) for colour in colours]
    tops = [place[place[:, 1] > place[:, 1].max() - 10].mean(0)[0] for place in places]
    assert tops[0] > tops[1] > tops[2]
    assert all(np.ptp(place[:, 1]) > 400 for place in places)


@pytest.mark.browser
@pytest.mark.slow
def test_every_picture_and_format_is_drawn(tmp_path):
    plot, image = plotshow(shape=[400, 300]), plot2dshow(shape=[400, 300], font_settings={"size": 12})
    plot.add_plot([0.0, 1.0, 4.0])
    plot.fig.update_traces(line_color="red")
    image.add_field(np.eye(4))
    heads = {"png": b"\x89PNG", "jpg": b"\xff\xd8", "webp": b"RIFF", "svg": b"<svg", "pdf": b"%PDF"}
    for kind, head in heads.items():
        plot.save(tmp_path / f"plot.{kind}")
        assert (tmp_path / f"plot.{kind}").read_bytes().startswith(head)
    assert is_near(pixels(plot, tmp_path), (255, 0, 0)).sum() > 100
    drawn = pixels(image, tmp_path, scale=2.0)
    assert drawn.shape == (600, 800, 3)
    assert (drawn != WHITE).any(-1).mean() > 0.1


@pytest.mark.browser
@pytest.mark.slow
def test_figures_share_a_server_of_kaleido(tmp_path):
    import kaleido

    picture = detectorshow(shape=[300, 300])
    picture.add_field(np.ones((4, 4), complex))
    alone = pixels(picture, tmp_path)
    kaleido.start_sync_server(path=find_browser())
    try:
        for _ in range(2):
            assert (pixels(picture, tmp_path) == alone).all()
    finally:
        close_browser()
    assert (pixels(picture, tmp_path) == alone).all()
    close_browser()


@pytest.mark.browser
@pytest.mark.slow
def test_python_ends_without_a_word(tmp_path):
    code = (
        "from odak.visualize.plotly import plotshow\n"
        "picture = plotshow(); picture.add_plot([1., 2.]); picture.save_image('a.png')\n"
    )
    found = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert found.stderr == found.stdout == "" and (tmp_path / "a.png").exists()


def test_browser_path_overrides_and_is_checked(monkeypatch, tmp_path):
    program = tmp_path / "my-browser"
    program.write_text("#!/bin/sh\nexit 3\n")
    monkeypatch.setenv("BROWSER_PATH", str(program))
    with pytest.raises(BrowserNotFoundError, match=r"my-browser' is not a program\.\nImages are drawn by Chrome"):
        find_browser()
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    assert find_browser() == str(program)


def test_without_a_browser_the_error_says_what_to_install(monkeypatch, tmp_path):
    pytest.importorskip("kaleido", reason="kaleido is not installed")
    monkeypatch.delenv("BROWSER_PATH", raising=False)
    monkeypatch.setattr("choreographer.browsers.chromium.Chromium.find_browser", lambda **options: None)
    picture = plotshow()
    picture.add_plot([1.0, 2.0])
    with pytest.raises(BrowserNotFoundError, match=r"(?s)apt-get install chromium.*plotly_get_chrome.*BROWSER_PATH"):
        picture.save_image(tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_program_that_is_no_browser_is_named(monkeypatch, tmp_path):
    pytest.importorskip("kaleido", reason="kaleido is not installed")
    program = tmp_path / "no-browser"
    program.write_text("#!/bin/sh\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setenv("BROWSER_PATH", str(program))
    picture = plotshow()
    picture.add_plot([1.0, 2.0])
    with pytest.raises(BrowserNotFoundError, match=r"no-browser does not start(?s:.*)apt-get install chromium"):
        picture.save_image(tmp_path / "a.png")
    assert os.listdir(tmp_path) == ["no-browser"]


# Errors of scripts as lines of the console, which the browser writes to its standard error.
_TELL = """<script>
window.addEventListener('error', event => console.log('PAGE-ERROR ' + event.message));
const told = console.error;
console.error = (...words) => { console.log('PAGE-ERROR ' + words.join(' ')); told(...words); };
</script>"""


def look_at(page, tmp_path):
    """Open a page and return what is seen, and the console."""
    watched = tmp_path / "watched.html"
    watched.write_text(page.replace("<head>", "<head>" + _TELL, 1), encoding="utf-8")
    command = [
        find_browser(),
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--enable-unsafe-swiftshader",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        f"--user-data-dir={tmp_path / 'profile'}",
        "--enable-logging=stderr",
        "--window-size=900,700",
        "--virtual-time-budget=4000",
        f"--screenshot={tmp_path / 'seen.png'}",
        watched.as_uri(),
    ]
    found = subprocess.run(command, capture_output=True, timeout=120)
    with Image.open(io.BytesIO((tmp_path / "seen.png").read_bytes())) as image:
        return np.asarray(image.convert("RGB")).astype(int), found.stderr.decode(errors="replace")


@pytest.mark.browser
@pytest.mark.slow
def test_a_page_opens_without_errors_and_shows_the_rays(tmp_path):
    picture = rayshow(line_width=4.0, opacity=1.0, shape=[800, 600])
    random = np.random.default_rng(0)
    directions = random.normal(size=(2000, 3))
    rays = np.stack([np.zeros_like(directions), directions / np.linalg.norm(directions, axis=-1, keepdims=True)], 1)
    picture.add_rays(rays, 1.0, color="red")
    picture.add_sphere([0.0, 0.0, 0.0, 0.3], color="blue")
    picture.save_html(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    seen, console = look_at(page, tmp_path)
    assert "PAGE-ERROR" not in console and "Uncaught" not in console, console
    assert is_near(seen, (255, 0, 0), 60).sum() > 2000


@pytest.mark.browser
@pytest.mark.slow
def test_an_error_in_a_page_would_be_seen(tmp_path):
    _, console = look_at("<html><head></head><body><script>nonsense();</script></body></html>", tmp_path)
    assert "PAGE-ERROR Uncaught ReferenceError" in console
