import importlib
import math
import os
import re
import subprocess
import sys

import matplotlib
import numpy as np
import pytest
import torch
from command import COLUMNS, ROWS, SMALL, angular_spectrum_intensity, pixels, read_report, run
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageOps

from odak.cli import main, report
from odak.cli.job import PRESETS, Job, parse_length

pytestmark = pytest.mark.usefixtures("small_judge")


def psnr_of(intensity, target):
    scale = np.sum(intensity * target) / np.sum(intensity**2)
    return 10 * math.log10(1 / np.mean((scale * intensity - target) ** 2))


@pytest.fixture(scope="module")
def picture():
    """A smooth grey picture that fills the frame, exact in 8 bits."""
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    return np.round(255 * (0.5 + 0.4 * np.sin(x / 9) * np.cos(y / 7))).astype(np.uint8)


@pytest.fixture(scope="module")
def grey_file(picture, tmp_path_factory):
    path = tmp_path_factory.mktemp("grey") / "grey.png"
    Image.fromarray(picture).save(path)
    return path


@pytest.fixture(scope="module")
def colour_file(tmp_path_factory):
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    channels = [np.round(255 * (0.5 + 0.4 * np.sin(x / a) * np.cos(y / b))) for a, b in ((5, 9), (11, 6), (8, 13))]
    path = tmp_path_factory.mktemp("colour") / "colour.png"
    Image.fromarray(np.stack(channels, axis=-1).astype(np.uint8)).save(path)
    return path


# Pixels as points, whose light the references below propagate.
POINTS = ("--fill-factor", 0)


def half_band(fy, fx):
    """Return the round stop around the inner half of the band along both axes."""
    return np.heaviside(np.sqrt(2) / 32e-6 - np.hypot(fy, fx), 0.5)


@pytest.mark.parametrize("method", ["sgd", "gs", "double-phase"])
def test_report_states_what_the_saved_pattern_shows(method, picture, grey_file, tmp_path):
    options = [*SMALL] if method != "double-phase" else [part for part in SMALL if part not in ("--iterations", "5")]
    options += POINTS
    run(grey_file, "--output", tmp_path, "--method", method, "--quiet", *options)
    report = read_report(tmp_path)
    names = {"hologram_532nm.png", "reconstruction.png", "comparison.png", "report.json"}
    assert {path.name for path in tmp_path.iterdir()} == names
    phase = pixels(tmp_path / "hologram_532nm.png") * (2 * np.pi / 256)
    edge = half_band if method == "double-phase" else None
    intensity = angular_spectrum_intensity(phase, 532e-9, 8e-6, 3e-3, edge)
    target = picture / 255
    lit = intensity[target >= 0.1 * target.max()]
    # The hard edge of a stop diffracts light so far that some of it wraps around on the grid of the report, which is
    # twice as large as the hologram: the reference has no such grid.
    decibels, relative, level = (0.02, 2e-3, 0.01) if edge else (1e-3, 1e-4, 1e-4)
    assert report["psnr_db"] == pytest.approx(psnr_of(intensity, target), abs=decibels)
    assert report["efficiency"] == pytest.approx(intensity.sum() / intensity.size, rel=relative)
    assert report["efficiency_lit"] == pytest.approx(lit.sum() / intensity.size, rel=relative)
    shown = pixels(tmp_path / "reconstruction.png") / 255
    scaled = np.clip(report["channels"][0]["scale"] * intensity, 0, 1)
    assert np.abs(shown - scaled).max() < 0.51 / 255 + level


def test_the_network_makes_the_pattern_in_one_pass(picture, grey_file, tmp_path):
    from odak.learn.models import hologram_network

    geometry = ["--resolution", ROWS, COLUMNS, "--distance", "3mm", "--device", "cpu", "--linear"]
    run(grey_file, "--output", tmp_path, "--method", "network", *geometry, *POINTS, "--quiet")
    report = read_report(tmp_path)
    assert report["parameters"]["initial_phase"] is None and report["seconds_per_iteration"] is None
    with torch.no_grad():
        wanted = hologram_network(pretrained=True)(torch.from_numpy(picture / 255).float(), 532e-9, 8e-6, 3e-3)
    phase = pixels(tmp_path / "hologram_532nm.png") * (2 * np.pi / 256)
    # A level of the file stands for the phases up to the next one; rounding in float32 reaches a little beyond.
    below = np.angle(np.exp(1j * (wanted.numpy() - phase)))
    assert below.min() > -1e-3 and below.max() < 2 * np.pi / 256 + 1e-3
    shown = psnr_of(angular_spectrum_intensity(phase, 532e-9, 8e-6, 3e-3), picture / 255)
    assert report["psnr_db"] == pytest.approx(shown, abs=1e-3) and shown > 15


def order(frequency, pitch):
    """Return a stop for one diffraction order, whose edge lies on a frequency of the grid and counts half."""
    return np.heaviside(np.round(1 - abs(frequency) * 2 * pitch, 9), 0.5)


@pytest.mark.parametrize("method", ["sgd", "gs", pytest.param("multi-color", marks=pytest.mark.slow)])
def test_pixels_are_squares_and_pictures_their_areas(method, picture, grey_file, tmp_path):
    """A panel drawn with eight by eight samples per pixel, six by six of them lit, behind a stop for one order."""
    run(grey_file, "--output", tmp_path, "--method", method, "--quiet", *SMALL[:-4], "--fill-factor", 9 / 16,
        "--iterations", 6, "--device", "cpu")  # fmt: skip
    report = read_report(tmp_path)
    assert report["verification"]["pixel"]["fill_factor"] == 9 / 16
    phase = pixels(tmp_path / report["pattern"]["files"][0]) * (2 * np.pi / 256)
    line = np.tile([0, 1, 1, 1, 1, 1, 1, 0], max(ROWS, COLUMNS))
    drawn = np.exp(1j * np.kron(phase, np.ones((8, 8)))) * line[: 8 * ROWS, None] * line[: 8 * COLUMNS]
    rows, columns = 20 * ROWS, 20 * COLUMNS
    fy, fx = np.fft.fftfreq(rows, 1e-6)[:, None], np.fft.fftfreq(columns, 1e-6)
    kernel = np.exp(2j * np.pi * 3e-3 * np.sqrt(1 / 532e-9**2 - fx**2 - fy**2))
    kernel = kernel * order(fy, 8e-6) * order(fx, 8e-6)
    light = np.abs(np.fft.ifft2(np.fft.fft2(drawn, (rows, columns)) * kernel)[: 8 * ROWS, : 8 * COLUMNS]) ** 2
    areas = light.reshape(ROWS, 8, COLUMNS, 8).mean((1, 3))
    # Eight samples of a pixel are wrong by half a percent at the edge of the band.
    (channel,) = report["channels"]
    assert channel["psnr_area_db"] == pytest.approx(psnr_of(areas, picture / 255), abs=0.2)
    if method == "multi-color":
        assert report["psnr_db"] == pytest.approx(channel["psnr_db"]) == pytest.approx(channel["psnr_area_db"])
        return
    # The report begins with the least over the places of a camera by quarters of a pixel, at one brightness.
    drawn_picture = np.kron(picture / 255, np.ones((8, 8)))
    pairs = []
    for down, across in np.ndindex(4, 4):
        inner = (
            slice(8 + 2 * down, 8 * (ROWS - 1 - (down > 0)) + 2 * down),
            slice(8 + 2 * across, 8 * (COLUMNS - 1 - (across > 0)) + 2 * across),
        )
        seen = [whole[inner] for whole in (light, drawn_picture)]
        pairs.append([part.reshape(len(part) // 8, 8, -1, 8).mean((1, 3)) for part in seen])
    scale = sum((a * b).mean() for a, b in pairs) / sum((a**2).mean() for a, _ in pairs)
    least = min(10 * math.log10(1 / np.mean((scale * a - b) ** 2)) for a, b in pairs)
    assert report["psnr_db"] == channel["psnr_db"] == pytest.approx(least, abs=0.2)
    assert channel["psnr_db"] < channel["psnr_area_db"] + 0.2


@pytest.mark.usefixtures("sheets")
@pytest.mark.parametrize(("method", "fill"), [("sgd", None), ("gs", None), ("multi-color", None), ("sgd", 0.64)])
def test_rows_and_columns_have_pitches_of_their_own(method, fill, tmp_path):
    """A square picture covers 64 rows of 8 µm and 80 columns of 6.4 µm, and is shown undistorted."""
    y, x = np.mgrid[0:80, 0:80]
    Image.fromarray(np.round(255 * (0.5 + 0.4 * np.sin(x / 9) * np.cos(y / 7))).astype(np.uint8)).save(
        tmp_path / "square.png"
    )
    geometry = ["--pixel-pitch", "8um,6.4um", *SMALL, "--fill-factor", fill or 0]
    run(tmp_path / "square.png", "-o", tmp_path / "out", "--method", method, *geometry, "--quiet")
    report = read_report(tmp_path / "out")
    assert report["parameters"]["pixel_pitch"] == [8e-6, 6.4e-6]
    phase = pixels(tmp_path / "out" / report["pattern"]["files"][0]) * (2 * np.pi / 256)
    image = pixels(tmp_path / "out" / "reconstruction.png")[:, 8:88] / 255
    wanted = Image.open(tmp_path / "square.png").resize((80, 64), Image.Resampling.BICUBIC)
    if fill is None:
        intensity = angular_spectrum_intensity(phase, 532e-9, (8e-6, 6.4e-6), 3e-3)
        assert report["efficiency"] == pytest.approx(intensity.mean(), rel=1e-4)
    else:
        # Ten by eight samples of 0.8 µm in a pixel, eight by 6.4 of them lit, behind a stop for one order.
        intensity = drawn_areas(phase, (10, 8), fill)
        assert report["efficiency"] == pytest.approx(intensity.mean(), rel=0.01)
    intensity = intensity[:, 8:88]
    assert report["channels"][0]["psnr_points_db" if fill is None else "psnr_area_db"] == pytest.approx(
        psnr_of(intensity, np.asarray(wanted) / 255), abs=0.05
    )
    scaled = np.clip(report["channels"][0]["scale"] * intensity, 0, 1)
    assert np.abs(image - scaled).max() < (0.01 if fill is None else 0.03)
    # The sheet of panels has samples of the pixels' shape.
    with Image.open(tmp_path / "out" / "comparison.png") as sheet:
        columns = np.flatnonzero((np.asarray(sheet.convert("RGB")) == 204).all(-1).sum(0) > 100)
        rows = np.flatnonzero((np.asarray(sheet.convert("RGB")) == 204).all(-1).sum(1) > 100)
    assert (rows[1] - rows[0]) / (columns[1] - columns[0]) == pytest.approx(64 * 8 / (96 * 6.4), abs=0.01)


def drawn_areas(phase, samples, fill):
    """Return the mean intensity over each pixel, drawn with so many samples of 0.8 µm, 3 mm behind a stop.

    The mean amplitude of a pixel is 1.
    """
    line = [
        np.tile(np.clip((np.sqrt(fill) * n + 1) / 2 - abs(np.arange(n) - (n - 1) / 2), 0, 1), count)
        for n, count in zip(samples, phase.shape, strict=True)
    ]
    drawn = np.kron(np.exp(1j * phase), np.ones(samples)) * line[0][:, None] * line[1]
    fy, fx = (np.fft.fftfreq(2 * n, 0.8e-6) for n in drawn.shape)
    kernel = np.exp(2j * np.pi * 3e-3 * np.sqrt(1 / 532e-9**2 - fx**2 - fy[:, None] ** 2))
    for frequency, count in ((fy[:, None], samples[0]), (fx, samples[1])):
        kernel = kernel * order(frequency, count * 0.8e-6)
    shown = np.fft.ifft2(np.fft.fft2(drawn, kernel.shape) * kernel)[: len(drawn), : len(drawn[0])]
    return (np.abs(shown / fill) ** 2).reshape(len(phase), samples[0], -1, samples[1]).mean((1, 3))


def test_areas_are_part_of_every_report(grey_file, tmp_path):
    run(grey_file, "--output", tmp_path / "points", *SMALL, *POINTS, "--iterations", 60, "--quiet")
    points = read_report(tmp_path / "points")
    assert points["verification"]["pixel"]["model"].startswith("points")
    # The envelope of the pixels and the mean over them blur what was computed for points.
    assert points["channels"][0]["psnr_area_db"] < points["psnr_db"] - 0.5
    run(grey_file, "--output", tmp_path / "areas", *SMALL, "--iterations", 60, "--quiet")
    areas = read_report(tmp_path / "areas")
    assert areas["verification"]["pixel"]["fill_factor"] == 0.9
    assert areas["psnr_db"] > points["channels"][0]["psnr_area_db"] + 3


def test_a_pattern_is_best_for_the_observer_asked_for(grey_file, tmp_path):
    found = {}
    for who in ("camera", "registered", "points"):
        run(grey_file, "--output", tmp_path / who, *SMALL, "--observer", who, "--iterations", 30, "--quiet")
        found[who] = read_report(tmp_path / who)["channels"][0]
    assert found["registered"]["psnr_db"] == pytest.approx(found["registered"]["psnr_area_db"], abs=0.01)
    assert found["points"]["psnr_db"] == pytest.approx(found["points"]["psnr_points_db"], abs=0.01)
    assert found["camera"]["psnr_db"] < found["camera"]["psnr_area_db"] + 0.3
    assert found["registered"]["psnr_area_db"] > found["camera"]["psnr_area_db"] + 1
    assert found["points"]["psnr_points_db"] > max(found[w]["psnr_points_db"] for w in ("camera", "registered")) + 3
    described = read_report(tmp_path / "points")["verification"]
    assert described["observer"] == "points in the middles of pixels" and described["pixel"]["fill_factor"] == 0.9


@pytest.mark.parametrize("method", ["gs", "double-phase", "network"])
def test_every_method_states_areas_and_points(method, grey_file, tmp_path):
    geometry = ["--resolution", ROWS, COLUMNS, "--distance", "3mm", "--device", "cpu", "--method", method, "--quiet"]
    geometry += ["--iterations", 12] if method == "gs" else []
    for folder, options in (("areas", ()), ("points", POINTS)):
        run(grey_file, "--output", tmp_path / folder, *geometry, *options)
    (areas,), (points,) = (read_report(tmp_path / folder)["channels"] for folder in ("areas", "points"))
    assert points["psnr_db"] == points["psnr_points_db"]
    # No camera is better than one whose pixels are those of the image, but for the rim that it does not see, where the
    # light of a double phase is missing.
    assert areas["psnr_db"] < areas["psnr_area_db"] + (6 if method == "double-phase" else 0.3)
    if method == "network":
        # The pattern is the same: the network was trained for points, and what it shows over areas is stated.
        assert areas["psnr_area_db"] < points["psnr_points_db"] - 1
    else:
        assert areas["psnr_area_db"] > points["psnr_area_db"] - 0.5


def test_frames_average(grey_file, picture, tmp_path):
    quality = []
    for frames in (1, 4):
        run(grey_file, "--output", tmp_path, *SMALL[:-4], "--iterations", 25, "--device", "cpu", "--frames", frames,
            "--initial-phase", "uniform", "--quiet", "--again", *POINTS)  # fmt: skip
        report = read_report(tmp_path)
        names = report["pattern"]["files"]
        assert names == (
            [f"hologram_532nm_frame{k}.png" for k in range(1, 5)] if frames > 1 else ["hologram_532nm.png"]
        )
        phases = [pixels(tmp_path / name) * (2 * np.pi / 256) for name in names]
        light = np.mean([angular_spectrum_intensity(phase, 532e-9, 8e-6, 3e-3) for phase in phases], axis=0)
        assert report["psnr_db"] == pytest.approx(psnr_of(light, picture / 255), abs=1e-3)
        quality.append(report["psnr_db"])
    assert quality[1] > quality[0] + 4


@pytest.mark.parametrize("start", ["flat", "double-phase", "gs"])
def test_starts_by_name(start, grey_file, tmp_path):
    run(grey_file, "--output", tmp_path, *SMALL, "--initial-phase", start, "--quiet")
    assert read_report(tmp_path)["parameters"]["initial_phase"] == start
    run(grey_file, "--output", tmp_path / "more", *SMALL, "--initial-phase", start, "--frames", 2, "--quiet")


def test_report_holds_every_parameter_and_version(grey_file, tmp_path):
    options = ["--learning-rate", "0.05", "--pixel-pitch", "6.4e-6", "--seed", "7", "--initial-phase", "normal"]
    run(grey_file, "--output", tmp_path, *SMALL, *options, "--quiet")
    report = read_report(tmp_path)
    assert report["parameters"] == {
        "image": str(grey_file),
        "output": str(tmp_path),
        "wavelengths": [532e-9],
        "grey": False,
        "linear": True,
        "pixel_pitch": 6.4e-6,
        "resolution": [ROWS, COLUMNS],
        "distance": 3e-3,
        "planes": 1,
        "depth_map": None,
        "volume_depth": 4e-3,
        "fill_factor": 0.9,
        "observer": "camera",
        "frames": None,
        "method": "sgd",
        "propagation_type": "Bandlimited Angular Spectrum",
        "quality": "good",
        "iterations": 5,
        "learning_rate": 0.05,
        "optimizer": "adam",
        "scale": True,
        "initial_phase": "normal",
        "start": None,
        "seed": 7,
        "grating": False,
        "bits": 8,
        "device": "cpu",
        "quiet": True,
        "preset": None,
        "tiles": False,
        "calibration": None,
        "lut": None,
        "slm_range": None,
    }
    assert report["versions"]["torch"] == torch.__version__
    assert {"odak", "numpy", "python"} <= set(report["versions"])
    assert report["device"] == "cpu"
    assert 0 < report["seconds_per_iteration"] < report["seconds_total"]
    assert {"psnr_db", "ssim", "efficiency", "efficiency_lit", "scale"} <= set(report["definitions"])


def test_lbfgs_is_the_default_and_better_than_adam(grey_file, tmp_path):
    quality = {}
    for name, options in {"usual": (), "adam": ("--optimizer", "adam"), "rate": ("--learning-rate", "0.2")}.items():
        run(grey_file, "--output", tmp_path / name, *SMALL, "--iterations", "15", *options, "--quiet")
        report = read_report(tmp_path / name)
        quality[name] = report["psnr_db"]
        solver = {"usual": ("lbfgs", None)}.get(name, ("adam", 0.2))
        assert (report["parameters"]["optimizer"], report["parameters"]["learning_rate"]) == solver
    assert quality["adam"] == quality["rate"] < quality["usual"] - 1


@pytest.mark.parametrize(
    ("options", "iterations", "reached"),
    [
        (["--quality", "best", "--iterations", 12], 12, "12 iterations"),
        (["--quality", "fast", "--initial-phase", "flat"], 400, "nothing was gained any more after "),
        (["--quality", "best"], 400, "nothing was gained any more after "),
    ],
)
def test_small_pictures_are_improved_until_nothing_is_gained(options, iterations, reached, tmp_path):
    size = ["--resolution", 32, 48, "--distance", "3mm", "--device", "cpu"]
    said = run("photo", "--grey", "--output", tmp_path, *size, *options)
    report = read_report(tmp_path)
    assert report["parameters"]["iterations"] == iterations and report["reached"].startswith(reached)
    # The bar shows the quality before the last step and before quantisation, by a model that on 32 x 48 pixels is
    # as far from the judge as 42 dB tell.
    (stated,) = {float(part) for part in re.findall(r"([\d.]+) dB, loss", said.stderr.rpartition("\r")[2])}
    assert stated == pytest.approx(report["channels"][0]["psnr_before_quantisation_db"], abs=2.0 if stated < 30 else 8)
    if "nothing" in reached:
        assert 11 <= int(report["reached"].split()[-2]) < 400


def test_a_quality_takes_as_many_iterations_as_the_pixels_leave_time_for():
    def iterations(rows, columns, **options):
        job = Job(image="photo", output="x", resolution=(rows, columns), **options)
        return job.iterations, job.settles

    assert [iterations(1080, 1920, quality=name) for name in ("fast", "good", "best")] == [
        (4, False),
        (30, False),
        (400, True),
    ]
    # Four times as many pixels, at least one iteration; fewer pixels, at most the end of the best.
    assert [iterations(2160, 3840, quality=name)[0] for name in ("fast", "good", "best")] == [1, 8, 400]
    assert [iterations(540, 960, quality=name) for name in ("fast", "good")] == [(16, True), (120, True)]
    assert iterations(270, 480) == (400, True)
    assert iterations(540, 960, optimizer="adam") == (800, True) and iterations(540, 960, bits=4) == (480, False)
    assert iterations(540, 960, iterations=5) == (5, False)
    assert iterations(8640, 15360, tiles=True) == iterations(540, 960, tiles=True) == (200, False)


def test_control_c_writes_the_best_so_far(grey_file, tmp_path, monkeypatch):
    whole, tick = [*SMALL, "--iterations", "9"], report.Clock.tick

    def interrupted(clock, *values):
        tick(clock, *values)
        if clock.ticks == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(report.Clock, "tick", interrupted)
    said = run(grey_file, "-o", tmp_path, *whole, *["-w", "638nm", "-w", "520nm", "-w", "450nm"], expect=130)
    assert f"interrupted after 3 of 9 iterations: the best patterns so far are in {tmp_path}" in said.stderr
    made = read_report(tmp_path)
    assert made["interrupted"] and made["reached"] == "interrupted after 3 of 9 iterations"
    assert len(made["channels"]) == 3 and made["channels"][0]["psnr_db"] > 15
    # The others begin with the phases of alternating projections, and one iteration.
    assert min(channel["psnr_db"] for channel in made["channels"]) > 10
    monkeypatch.setattr(report.Clock, "tick", tick)
    said = run(grey_file, "-o", tmp_path, *whole)
    assert "already holds" not in said.stdout and not read_report(tmp_path)["interrupted"]
    assert read_report(tmp_path)["psnr_db"] > made["channels"][0]["psnr_db"]


@pytest.mark.parametrize("where", ["odak.wave.phase_retrieval._correction", "odak.cli.report.to_image"])
def test_control_c_before_the_first_iteration_writes_the_start_so_far(where, grey_file, tmp_path, monkeypatch):
    """In the sixth projection of the start, and while its picture is written."""
    owner, _, name = where.rpartition(".")
    function, calls = getattr(importlib.import_module(owner), name), []

    def interrupted(*values):
        calls.append(values)
        if len(calls) == (6 if name == "_correction" else 1):
            raise KeyboardInterrupt
        return function(*values)

    monkeypatch.setattr(where, interrupted)
    said = run(grey_file, "-o", tmp_path, *SMALL, "--iterations", "9", expect=130)
    assert f"interrupted after 0 of 9 iterations: the best patterns so far are in {tmp_path}" in said.stderr
    made = read_report(tmp_path)
    assert made["interrupted"] and made["reached"] == "interrupted after 0 of 9 iterations"
    assert {"reconstruction.png", "comparison.png", "hologram_532nm.png"} <= {path.name for path in tmp_path.iterdir()}
    # A flat phase, from which nothing of the start is kept, shows 13.7 dB, five projections 15.1.
    assert made["psnr_db"] > 14.4


def test_a_first_picture_is_there_before_the_first_iteration(picture, grey_file, tmp_path, monkeypatch):
    """The pattern of the start and its image, whose quality the bar states; both are improved."""
    found, tick = [], report.Clock.tick

    def looks(clock, *values):
        if clock.ticks == 0:
            found.extend(pixels(tmp_path / name) for name in ("hologram_532nm.png", "reconstruction.png"))
        return tick(clock, *values)

    monkeypatch.setattr(report.Clock, "tick", looks)
    said = run(grey_file, "-o", tmp_path, *SMALL, *POINTS)
    intensity = angular_spectrum_intensity(found[0] * (2 * np.pi / 256), 532e-9, 8e-6, 3e-3)
    target = picture / 255
    scale = np.sum(intensity * target) / np.sum(intensity**2)
    assert np.abs(found[1] / 255 - np.clip(scale * intensity, 0, 1)).max() < 0.02
    first = float(re.search(r"([\d.]+) dB in reconstruction.png", said.stderr)[1])
    assert first == pytest.approx(psnr_of(intensity, target), abs=0.1)
    assert read_report(tmp_path)["psnr_db"] > first + 1
    assert not np.array_equal(pixels(tmp_path / "reconstruction.png"), found[1])


def test_more_iterations_show_the_picture_better(grey_file, tmp_path):
    quality = []
    for count in ("1", "25"):
        run(grey_file, "--output", tmp_path, *SMALL, "--iterations", count, "--quiet")
        quality.append(read_report(tmp_path)["psnr_db"])
    assert quality[1] > quality[0] + 5


def test_the_same_seed_gives_the_same_pattern(grey_file, tmp_path):
    patterns = []
    for seed in ("3", "3", "4"):
        run(grey_file, "--output", tmp_path, *SMALL, "--initial-phase", "uniform", "--seed", seed, "--quiet", "--again")
        patterns.append((tmp_path / "hologram_532nm.png").read_bytes())
    assert patterns[0] == patterns[1] != patterns[2]


@pytest.mark.slow
def test_colour_becomes_three_holograms(colour_file, tmp_path):
    run(colour_file, "--output", tmp_path, *SMALL, *POINTS, "--quiet")
    report = read_report(tmp_path)
    assert report["pattern"]["files"] == ["hologram_638nm.png", "hologram_520nm.png", "hologram_450nm.png"]
    picture = pixels(colour_file) / 255
    for channel, (part, wavelength) in enumerate(zip(report["channels"], (638e-9, 520e-9, 450e-9), strict=True)):
        phase = pixels(tmp_path / part["file"]) * (2 * np.pi / 256)
        intensity = angular_spectrum_intensity(phase, wavelength, 8e-6, 3e-3)
        assert part["psnr_db"] == pytest.approx(psnr_of(intensity, picture[..., channel]), abs=1e-3)
    error = np.mean([10 ** (-part["psnr_db"] / 10) for part in report["channels"]])
    assert report["psnr_db"] == pytest.approx(-10 * math.log10(error), abs=1e-3)
    assert pixels(tmp_path / "reconstruction.png").shape == (ROWS, COLUMNS, 3)


@pytest.mark.parametrize("options", [["--grey"], ["--wavelength", "600e-9"]])
def test_one_wavelength_shows_the_brightness_of_a_colour_picture(options, colour_file, tmp_path):
    run(colour_file, "--output", tmp_path, *SMALL, *POINTS, "--quiet", *options)
    (part,) = read_report(tmp_path)["channels"]
    assert part["wavelength"] == (532e-9 if options == ["--grey"] else 600e-9)
    phase = pixels(tmp_path / part["file"]) * (2 * np.pi / 256)
    intensity = angular_spectrum_intensity(phase, part["wavelength"], 8e-6, 3e-3)
    target = pixels(colour_file) / 255 @ [0.2126, 0.7152, 0.0722]
    assert part["psnr_db"] == pytest.approx(psnr_of(intensity, target), abs=1e-3)


def test_three_wavelengths_for_a_grey_picture(grey_file, tmp_path):
    waves = [option for value in ("6.328e-7", "5.2e-7", "4.5e-7") for option in ("--wavelength", value)]
    run(grey_file, "--output", tmp_path, *SMALL, *waves, "--quiet")
    assert (tmp_path / "hologram_632.8nm.png").is_file()
    assert [part["wavelength"] for part in read_report(tmp_path)["channels"]] == [632.8e-9, 520e-9, 450e-9]


@pytest.mark.parametrize(
    "bits", [1, 3, 8, 10, 16, *(pytest.param(bits, marks=pytest.mark.slow) for bits in (2, 4, 5, 6, 7))]
)
def test_a_pattern_uses_the_levels_of_its_bits(bits, grey_file, tmp_path):
    run(grey_file, "--output", tmp_path, *SMALL, *POINTS, "--bits", bits, "--quiet")
    report = read_report(tmp_path)
    depth = 8 if bits <= 8 else 16
    assert report["pattern"]["file_depth"] == depth
    pattern = pixels(tmp_path / "hologram_532nm.png").astype(int)
    assert pattern.max() < 2**depth
    assert np.all(pattern % 2 ** (depth - bits) == 0)
    if bits < 8:
        assert len(np.unique(pattern)) <= 2**bits
    intensity = angular_spectrum_intensity(pattern * (2 * np.pi / 2**depth), 532e-9, 8e-6, 3e-3)
    target = pixels(grey_file) / 255
    assert report["psnr_db"] == pytest.approx(psnr_of(intensity, target), abs=1e-3)


def test_few_levels_are_searched_for(picture, grey_file, tmp_path):
    """The saved patterns of one and two bits are better than rounded ones, by about what the report says."""
    for bits, least in ((1, 1.5), (2, 2.0)):
        size = ["--resolution", ROWS, COLUMNS, "--distance", "3mm", "--device", "cpu", "--linear", "--quiet"]
        options = [*size, "--bits", bits, "--iterations", 20, *POINTS]
        seen, gain = {}, None
        for name, more in (("levels", ()), ("lbfgs", ("--optimizer", "lbfgs"))):
            run(grey_file, "-o", tmp_path / f"{name}{bits}", *options, *more)
            made = read_report(tmp_path / f"{name}{bits}")
            assert made["parameters"]["optimizer"] == name
            gain = made["channels"][0].get("gain_over_rounding_db", gain)
            phase = pixels(tmp_path / f"{name}{bits}" / "hologram_532nm.png") * (2 * np.pi / 256)
            assert len(np.unique(phase)) == 2**bits
            seen[name] = psnr_of(angular_spectrum_intensity(phase, 532e-9, 8e-6, 3e-3), picture / 255)
        assert seen["levels"] - seen["lbfgs"] > least and gain == pytest.approx(seen["levels"] - seen["lbfgs"], abs=1.5)


@pytest.mark.parametrize("method", ["sgd", "gs"])
def test_other_propagation_types_are_judged_by_the_exact_one(method, picture, grey_file, tmp_path):
    """At 3 mm the paraxial approximation is good: its pattern shows the picture by the angular spectrum too."""
    for kind in ("Transfer Function Fresnel", "Impulse Response Fresnel", "Rayleigh-Sommerfeld"):
        options = ["--propagation-type", kind, "--initial-phase", "flat", "--quiet"]
        run(grey_file, "-o", tmp_path / kind, "--method", method, *SMALL, *options)
        made = read_report(tmp_path / kind)
        phase = pixels(tmp_path / kind / "hologram_532nm.png") * (2 * np.pi / 256)
        shown = psnr_of(angular_spectrum_intensity(phase, 532e-9, 8e-6, 3e-3), picture / 255)
        assert made["psnr_db"] == pytest.approx(shown, abs=1e-3) and shown > (14 if method == "sgd" else 12)
        assert made["verification"]["pixel"]["fill_factor"] == 0


def test_the_grating_is_in_the_file_and_out_of_the_report(grey_file, tmp_path):
    run(grey_file, "--output", tmp_path / "without", *SMALL, "--quiet")
    run(grey_file, "--output", tmp_path / "with", *SMALL, "--grating", "--quiet")
    plain, grated = (pixels(tmp_path / name / "hologram_532nm.png").astype(int) for name in ("without", "with"))
    difference = (grated - plain) % 256
    # A phase within rounding of a level's edge may fall to either side of it.
    assert np.mean(difference[:, 0::2] == 128) > 0.999
    assert np.mean(difference[:, 1::2] == 0) > 0.999
    reports = [read_report(tmp_path / name) for name in ("without", "with")]
    assert reports[0]["psnr_db"] == pytest.approx(reports[1]["psnr_db"], abs=0.05)
    assert "subtracted" in reports[1]["verification"]["grating"]
    assert reports[0]["verification"]["grating"] is None


def test_the_aspect_ratio_is_kept_with_black_around(tmp_path):
    path = tmp_path / "wide.png"
    Image.fromarray(np.full((20, 60), 200, np.uint8)).save(path)
    run(path, "--output", tmp_path / "out", *SMALL, "--quiet")
    picture = read_report(tmp_path / "out")["picture"]
    assert picture["rows"] == [16, 48]
    assert picture["columns"] == [0, 96]


def test_transparent_parts_are_black(tmp_path):
    pixels = np.full((ROWS, COLUMNS, 4), 255, np.uint8)
    pixels[: ROWS // 2, :, 3] = 0
    path = tmp_path / "alpha.png"
    Image.fromarray(pixels).save(path)
    from odak.cli.job import Job
    from odak.cli.target import load_target

    target = load_target(Job(image=str(path), resolution=(ROWS, COLUMNS), linear=True))
    expected = torch.ones(1, ROWS, COLUMNS)
    expected[:, : ROWS // 2] = 0
    assert torch.equal(target.intensity, expected)


def test_shipped_pictures_by_name_and_by_default(tmp_path):
    run("chart", "--output", tmp_path, *SMALL, "--iterations", "1", "--quiet")
    assert read_report(tmp_path)["picture"]["file"].endswith("chart.png")
    run("--output", tmp_path, *SMALL, "--iterations", "1", "--quiet")
    assert read_report(tmp_path)["picture"]["file"].endswith("photo.png")


def test_what_is_printed(grey_file, tmp_path):
    loud = run(grey_file, "--output", tmp_path, *SMALL)
    assert f"PSNR {read_report(tmp_path)['psnr_db']:.2f} dB" in loud.stdout
    assert "532 nm" in loud.stderr
    quiet = run(grey_file, "--output", tmp_path, *SMALL, "--quiet")
    assert quiet.stdout == quiet.stderr == ""


@pytest.mark.usefixtures("sheets")
def test_comparison_has_four_panels_with_scales(grey_file, tmp_path):
    run(grey_file, "--output", tmp_path, *SMALL, "--quiet")
    sheet = pixels(tmp_path / "comparison.png").astype(int)
    # Pictures of 96 columns are shown three times as large, each sample as a square.
    rows, columns = 3 * ROWS, 3 * COLUMNS
    target = np.kron(pixels(grey_file), np.ones((3, 3)))
    found = [
        (row, column)
        for row in range(sheet.shape[0] - rows)
        for column in (16, 16 + 316)
        if np.array_equal(sheet[row : row + rows, column : column + columns, 0], target)
    ]
    ((top, left),) = found
    assert left == 16
    # The phase below the reconstruction, in the colours of its bar, which begins and ends alike.
    phase = pixels(tmp_path / "hologram_532nm.png") * (2 * np.pi / 256)
    colours = np.kron(matplotlib.colormaps["twilight"](phase / (2 * np.pi), bytes=True)[..., :3], np.ones((3, 3, 1)))
    lower = next(
        row
        for row in range(top + rows, sheet.shape[0] - rows)
        if np.array_equal(sheet[row : row + rows, 332 : 332 + columns], colours)
    )
    bar = sheet[lower + rows + 8 + 6, 335 : 332 + 297]
    assert np.abs(bar[0] - bar[-1]).max() < 8 and np.ptp(bar[:, 2]) > 100


@pytest.mark.slow
@pytest.mark.usefixtures("sheets")
@given(st.lists(st.text("abc MW_.", min_size=1, max_size=90), min_size=4, max_size=4), st.integers(4, 700))
@settings(max_examples=30)
def test_captions_stay_within_their_panels(captions, width):
    panels = [report.picture_panel(caption, torch.zeros(1, 8, width)) for caption in captions]
    cell, margin = max(width * max(1, report.NARROWEST // width), report.NARROWEST), report.MARGIN
    sheet = np.array(report.sheet([panels[:2], panels[2:]]))
    assert sheet.shape[1] == 2 * (cell + margin) + margin
    # Whatever the captions say, the margins beside the panels stay white but for the pictures' outlines.
    for left in (0, cell + margin, 2 * (cell + margin)):
        assert (sheet[:, left + 3 : left + margin - 3] == 255).all()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_photographs_are_turned_upright(orientation, tmp_path):
    from odak.cli.target import read_picture

    image = Image.fromarray((np.arange(12).reshape(3, 4) * 20).astype(np.uint8))
    exif = image.getexif()
    exif[0x0112] = orientation
    image.save(tmp_path / "photo.png", exif=exif)
    with Image.open(tmp_path / "photo.png") as stored:
        upright = np.asarray(ImageOps.exif_transpose(stored))
    assert np.array_equal(np.round(read_picture(tmp_path / "photo.png")[0].numpy() * 255), upright)


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        *(("8e-6", 8e-6), ("8um", 8e-6), ("6.4µm", 6.4e-6), ("6.4 μm", 6.4e-6), ("532nm", 532e-9), ("15cm", 0.15)),
        *(("4mm", 4e-3), ("1m", 1.0), ("2e2nm", 2e-7), ("-3mm", -3e-3), (".5m", 0.5)),
    ],
)
def test_lengths_have_units(text, metres):
    assert parse_length(text) == pytest.approx(metres, rel=1e-15)


def test_units_and_short_options(grey_file, tmp_path):
    options = ["-o", tmp_path, "-w", "532nm", "-d", "3mm", "--pixel-pitch", "8um", "--iterations", "2", "--quiet"]
    run(grey_file, *options, "--resolution", ROWS, COLUMNS)
    parameters = read_report(tmp_path)["parameters"]
    lengths = [parameters["wavelengths"][0], parameters["distance"], parameters["pixel_pitch"]]
    assert lengths == pytest.approx([532e-9, 3e-3, 8e-6], rel=1e-12)


@pytest.mark.parametrize(
    ("options", "question"),
    [
        (
            ["--pixel-pitch", "0.002"],
            "--pixel-pitch 0.002 is 0.002 metres, larger than the pixels of any modulator; did you mean 2um?",
        ),
        (["--pixel-pitch", "8e-9"], "below half a wavelength; did you mean 8um?"),
        (["--distance", "150"], "resolves only 7.4e-06 points across the picture; did you mean 150mm?"),
        (["--wavelength", "532um"], "--wavelength 0.000532 is 0.000532 metres; did you mean 532nm?"),
        (["--distance", "10um"], "the light of neighbouring pixels overlaps only beyond 0.00012 metres"),
    ],
)
def test_improbable_lengths_are_warned_of(options, question, grey_file, tmp_path):
    said = run(grey_file, "-o", tmp_path, *SMALL, *options, "--quiet")
    assert question.replace("7.4e-06", "0.0074") in said.stderr
    # The display of the computation may have something to say of the same length after it.
    line, *_ = (line for line in said.stderr.splitlines() if "metres" in line and "warning" in line)
    assert line.startswith("odak: warning: --") and line[15:] in read_report(tmp_path)["warnings"]


def test_pixels_of_eight_metres_are_refused(grey_file, tmp_path):
    said = run(grey_file, "-o", tmp_path, *SMALL, "--pixel-pitch", "8", expect=2)
    assert "--pixel-pitch 8 is 8 metres, larger than the pixels of any modulator; did you mean 8um?" in said.stderr


def test_the_last_loss_stays_visible(grey_file, tmp_path):
    said = run(grey_file, "-o", tmp_path, *SMALL)
    loss = read_report(tmp_path)["channels"][0]["final_loss"]
    assert f"loss {loss:.4g}" in said.stderr and loss > 0


def test_a_second_run_is_skipped_and_other_results_are_named(grey_file, tmp_path, monkeypatch):
    run(grey_file, "-o", tmp_path, *SMALL)
    before = (tmp_path / "report.json").read_text()
    said = run(grey_file, "-o", tmp_path, *SMALL)
    assert "already holds the result of this run; use --again" in said.stdout
    assert (tmp_path / "report.json").read_text() == before
    run(grey_file, "-o", tmp_path, *SMALL, "--again")
    assert (tmp_path / "report.json").read_text() != before
    said = run(grey_file, "-o", tmp_path, *SMALL, "--iterations", "3")
    assert (
        "holds hologram_532nm.png, reconstruction.png, comparison.png, report.json of another run, which will be"
        in said.stderr
    )
    # A pattern that another run replaced is not taken for that of the report.
    (tmp_path / "hologram_532nm.png").write_bytes((tmp_path / "reconstruction.png").read_bytes())
    assert "PSNR" in run(grey_file, "-o", tmp_path, *SMALL, "--iterations", "3").stdout
    assert "already" not in run(grey_file, "-o", tmp_path, *SMALL, "--iterations", "4").stdout


def test_names_of_outputs_are_settled_before_computing(grey_file, tmp_path, capsys, monkeypatch):
    from odak.cli import hologram

    (tmp_path / "comparison.png").mkdir()
    monkeypatch.setattr(hologram, "_compute", lambda *_: pytest.fail("computed"))
    assert main(["hologram", str(grey_file), "-o", str(tmp_path), *SMALL]) == 2
    assert "must not contain a folder named comparison.png" in capsys.readouterr().err


def test_presets_of_modulators(grey_file, tmp_path):
    run(grey_file, "-o", tmp_path, "--preset", "HOLOEYE-LETO-3", *SMALL, "--quiet")
    parameters = read_report(tmp_path)["parameters"]
    assert (parameters["pixel_pitch"], parameters["resolution"], parameters["bits"]) == (6.4e-6, [ROWS, COLUMNS], 8)
    assert parameters["preset"] == "holoeye-leto-3"
    assert all(preset.source.startswith("https://") for preset in PRESETS.values())


BAD = {
    "missing file": (["nowhere.png"], "nowhere.png"),
    "directory": (["."], "directory"),
    "negative wavelength": (["--wavelength", "-1"], "--wavelength"),
    "wavelength not a number": (["--wavelength", "nan"], "--wavelength"),
    "wavelength in nanometres": (["--wavelength", "532"], "did you mean 532nm?"),
    "two wavelengths": (["--wavelength", "5e-7", "--wavelength", "6e-7"], "--wavelength"),
    "equal wavelengths": (["--wavelength", "5e-7"] * 3, "--wavelength"),
    "grey with three": (["--grey", *["--wavelength", "5e-7"] * 3], "--grey"),
    "method": (["--method", "magic"], "'sgd', 'gs', 'double-phase'"),
    "initial phase": (["--initial-phase", "round"], "'flat'"),
    "propagation type": (["--propagation-type", "magic"], "'Bandlimited Angular Spectrum'"),
    "far field": (["--propagation-type", "Fraunhofer"], "--propagation-type"),
    "pitch": (["--pixel-pitch", "0"], "--pixel-pitch"),
    "three pitches": (["--pixel-pitch", "8um,8um,8um"], "write it as 8um, or 8um,6.4um for rows and columns"),
    "one unit for two pitches": (["--pixel-pitch", "8,6.4um"], "'8,6.4um' is not a pixel pitch"),
    "second pitch": (["--pixel-pitch", "8um,-1um"], "--pixel-pitch must be positive"),
    "distance": (["--distance", "inf"], "--distance"),
    "learning rate": (["--learning-rate", "-0.1"], "--learning-rate"),
    "iterations": (["--iterations", "0"], "--iterations"),
    "seed": (["--seed", "-1"], "--seed"),
    "no bits": (["--bits", "0"], "--bits"),
    "many bits": (["--bits", "17"], "--bits"),
    "resolution": (["--resolution", "8", "8"], "--resolution"),
    "device": (["--device", "abacus"], "--device must be a device of this machine (auto, cpu"),
    "unit": (["--distance", "15 feet"], "'15 feet' is not a length; write it as 8e-6 (metres), 8um, 532nm or 15cm"),
    "wavelengths behind one option": (["600nm", "-w", "532nm"], "'600nm' is a length: give --wavelength before each"),
    "shipped picture": (["phto"], "Did you mean 'photo'?"),
    "preset": (["--preset", "holoeye-pluto"], "Did you mean 'holoeye-pluto-2.1'?"),
    "iterations of double phase": (
        ["--method", "double-phase", "--iterations", "9"],
        "--iterations has no effect with",
    ),
    "step size of gs": (["--method", "gs", "--learning-rate", "0.1"], "--learning-rate has no effect with --method gs"),
    "step size of a line search": (
        ["--optimizer", "lbfgs", "--learning-rate", "0.1"],
        "has no effect with --optimizer",
    ),
    "solver": (["--optimizer", "sgd"], "--optimizer must be"),
    "levels of many bits": (["--optimizer", "levels"], "--optimizer levels needs --bits of at most 6"),
    "step size of levels": (
        ["--bits", "2", "--optimizer", "levels", "--learning-rate", "0.1"],
        "--optimizer levels, which changes levels",
    ),
    "solver of gs": (["--method", "gs", "--optimizer", "adam"], "--optimizer needs --method sgd"),
    **{
        f"{name} of the network": (["--method", "network", *arguments], text)
        for name, arguments, text in (
            (
                "distance",
                [],
                "--distance must be from 1.42mm to 15mm, which the weights of --method network",
            ),
            ("pixels", ["--pixel-pitch", "8um,6um"], "--pixel-pitch must be one length with --method network"),
            ("pitch", ["--pixel-pitch", "30um"], "--pixel-pitch must be from 2.77um to 12.9um"),
            ("one wavelength", ["-w", "10um", "--pixel-pitch", "20um"], "--pixel-pitch must be from 43.5um to 286um"),
            ("size", ["--resolution", "64", "96", "-d", "9mm"], "--distance must be from 1.42mm to 7.7mm"),
            ("wavelengths", ["-w", "300nm", "-w", "2.5um", "-w", "1um"], "wavelengths as different as 300nm, 2500nm,"),
            ("iterations", ["--iterations", "9"], "--iterations has no effect with --method network"),
            ("propagation", ["--propagation-type", "auto"], "--propagation-type has no effect with --method network"),
            ("start", ["--initial-phase", "gs"], "--initial-phase has no effect with --method network"),
            ("seed", ["--seed", "1"], "--seed has no effect with --method network"),
            (
                "depth",
                ["scene", "--planes", "2", "-d", "3mm", "--volume-depth", "4mm"],
                "--volume-depth must be at most --distance, which the weights",
            ),
            (
                "far plane",
                ["scene", "--planes", "2", "--resolution", "64", "96", "-d", "6mm", "--volume-depth", "4mm"],
                "64 x 96 pixels and a volume depth of 4mm; got 6mm",
            ),
        )
    },
    "fill factor": (["--fill-factor", "1.2"], "--fill-factor must be from 0"),
    "observer of points": (["--fill-factor", "0", "--observer", "camera"], "--observer camera needs a --fill-factor"),
    "points of planes": (
        ["scene", "--planes", "2", "--observer", "points"],
        "--observer points cannot be used with --planes",
    ),
    "start of gs": (["--method", "gs", "--initial-phase", "gs"], "--initial-phase gs needs --method sgd"),
    "brightness of gs": (["--method", "gs", "--no-scale"], "--scale has no effect with --method gs"),
    "seed without noise": (["--seed", "3"], "--seed has no effect with --initial-phase gs"),
    "volume without planes": (["--volume-depth", "2mm"], "--volume-depth has no effect without --planes"),
    "timeout without cluster": (["--timeout", "3"], "--timeout has no effect without --cluster"),
    "not an integer": (["--bits", "few"], "--bits"),
    "unknown option": (["--wavelenth", "1"], "--wavelength"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_code_2(case, tmp_path, capsys):
    arguments, named = BAD[case]
    assert main(["hologram", *arguments, "--output", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("odak: ")
    assert captured.err.count("\n") == 1
    assert named in captured.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", [b"", b"not a picture", b"\x89PNG\r\n\x1a\n cut"])
def test_broken_pictures_are_named(content, tmp_path, capsys):
    path = tmp_path / "broken.png"
    path.write_bytes(content)
    assert main(["hologram", str(path), "--output", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert "broken.png" in captured.err
    assert captured.err.count("\n") == 1


def test_float_pictures_must_stay_in_range(tmp_path, capsys):
    path = tmp_path / "bright.tiff"
    Image.fromarray(np.full((20, 20), 7.0, np.float32)).save(path)
    assert main(["hologram", str(path), "--output", str(tmp_path / "out"), *SMALL]) == 2
    assert "0 to 1" in capsys.readouterr().err


def test_few_rows_are_refused_and_first_of_several_frames_used(tmp_path, capsys):
    Image.new("L", (1000, 3), 200).save(tmp_path / "wide.png")
    assert main(["hologram", str(tmp_path / "wide.png"), "--output", str(tmp_path / "out")]) == 2
    assert "becomes 6 x 1920 pixels" in capsys.readouterr().err and not (tmp_path / "out").exists()
    first, second = (Image.new("L", (COLUMNS, ROWS), level) for level in (255, 9))
    first.save(tmp_path / "two.gif", save_all=True, append_images=[second])
    said = run(tmp_path / "two.gif", "-o", tmp_path / "out", *SMALL, "--quiet")
    assert "two.gif' has 2 frames or pages; the first one is used" in said.stderr
    middle = pixels(tmp_path / "out" / "comparison.png")[30, 40]
    assert (middle == 255).all()


def test_a_black_picture_is_refused(tmp_path, capsys):
    path = tmp_path / "black.png"
    Image.fromarray(np.zeros((20, 20), np.uint8)).save(path)
    assert main(["hologram", str(path), "--output", str(tmp_path / "out"), *SMALL]) == 2
    assert "black" in capsys.readouterr().err


@pytest.mark.parametrize("below", [".", "folder"])
def test_an_output_that_cannot_be_written_is_code_2(below, grey_file, tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("in the way")
    assert main(["hologram", str(grey_file), *SMALL, "--output", str(file / below)]) == 2
    captured = capsys.readouterr()
    assert "--output" in captured.err
    assert captured.err.count("\n") == 1
    assert file.read_text() == "in the way"


def test_a_failed_write_is_code_1_and_leaves_the_old_report(grey_file, tmp_path, capsys, monkeypatch):
    (tmp_path / "report.json").write_text("old")

    def full(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", full)
    assert main(["hologram", str(grey_file), "--output", str(tmp_path), *SMALL, "--quiet"]) == 1
    assert "disk full" in capsys.readouterr().err
    assert (tmp_path / "report.json").read_text() == "old"
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


@pytest.mark.slow
def test_as_a_module_in_a_process_of_its_own(grey_file, tmp_path):
    command = [sys.executable, "-m", "odak", "hologram", str(grey_file), "--output", str(tmp_path), *SMALL]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    assert "PSNR" in result.stdout
    assert read_report(tmp_path)["psnr_db"] > 0


@pytest.mark.slow
def test_the_photograph_reaches_30_db_after_quantisation(tmp_path):
    options = ["--grey", "--resolution", "270", "480", "--distance", "0.0094", "--iterations", "200"]
    run("photo", "--output", tmp_path, *options, "--quiet")
    assert read_report(tmp_path)["psnr_db"] >= 30


def srgb(light):
    """Return stored values for light by IEC 61966-2-1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055)


def test_stored_values_are_decoded_to_light(grey_file, picture, colour_file, tmp_path):
    """The target of a grey picture is its light, and the reconstruction is stored as a screen shows it."""
    decoded = [word for word in SMALL if word != "--linear"]
    run(grey_file, "-o", tmp_path / "grey", *decoded, "--iterations", 40, "--quiet")
    made = read_report(tmp_path / "grey")
    assert made["picture"]["light"] == "grey.png (sRGB)" and made["parameters"]["linear"] is False
    shown = pixels(tmp_path / "grey" / "reconstruction.png") / 255
    stored = picture / 255
    error = np.mean((shown - stored)[1:-1, 1:-1] ** 2)
    assert made["psnr_encoded_db"] == pytest.approx(-10 * math.log10(np.mean((shown - stored) ** 2)), abs=0.1)
    assert -10 * math.log10(error) > 20
    # What is compared as light is the square of what is stored, nearly: the same image judged as stored values fails.
    light = np.interp(stored, srgb(np.linspace(0, 1, 4097)), np.linspace(0, 1, 4097))
    seen = np.interp(shown, srgb(np.linspace(0, 1, 4097)), np.linspace(0, 1, 4097))
    assert made["psnr_area_db"] == pytest.approx(-10 * math.log10(np.mean((seen - light) ** 2)), abs=0.3)
    run(colour_file, "-o", tmp_path / "colour", *decoded, "--iterations", 1, "--grey", "--quiet")
    from odak.cli.job import Job
    from odak.cli.target import load_target

    target = load_target(Job(image=str(colour_file), resolution=(ROWS, COLUMNS), grey=True))
    colours = pixels(colour_file) / 255
    luminance = np.interp(colours, srgb(np.linspace(0, 1, 4097)), np.linspace(0, 1, 4097)) @ [0.2126, 0.7152, 0.0722]
    assert np.abs(target.intensity[0].numpy() - luminance).max() < 1e-3


def test_light_that_is_not_seen_shows_the_channels(colour_file):
    from odak.cli.job import Job
    from odak.cli.target import load_target

    waves = (1.6e-6, 1.3e-6, 1.0e-6)
    job = Job(image=str(colour_file), resolution=(ROWS, COLUMNS), wavelengths=waves)
    assert load_target(job).intensity.shape == (3, ROWS, COLUMNS)
    assert load_target(Job(image=str(colour_file), resolution=(ROWS, COLUMNS), wavelengths=(1e-6,))).intensity.max() > 0
