"""`odak hologram --tiles`: pictures are read in parts, runs go on, and reports hold for the files that were saved."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest
from command import COLUMNS, ROWS, angular_spectrum_intensity, pixels, read_report, run
from PIL import Image

from odak.cli import main, tiles
from odak.cli.job import Job
from odak.cli.options import InputError
from odak.cli.target import load_target
from odak.wave import propagate_beam

dask = pytest.importorskip("dask")
zarr = pytest.importorskip("zarr")
GEOMETRY = ["--distance", "3e-3", "--tiles", "--linear"]


@pytest.fixture(autouse=True)
def small_chunks():
    with dask.config.set({"array.chunk-size": "64 kiB", "scheduler": "synchronous"}):
        yield


@pytest.fixture(scope="module")
def colour():
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    channels = [0.5 + 0.4 * np.sin(x / a) * np.cos(y / b) for a, b in ((5, 9), (11, 6), (8, 13))]
    return np.round(255 * np.stack(channels, -1)).astype(np.uint8)


@pytest.fixture
def grey_file(colour, tmp_path):
    np.save(tmp_path / "grey.npy", colour[..., 0])
    return tmp_path / "grey.npy"


def written(kind, values, folder):
    """Write a picture in one of the forms that are read in parts, or whole."""
    path = folder / f"picture.{kind.partition(' ')[0]}"
    if kind == "npy":
        np.save(path, values)
    elif kind == "zarr":
        zarr.save_array(str(path), values)
    else:
        options = {
            "tif raw": {},
            "tif deflated": {"compression": "tiff_adobe_deflate"},
            "tif lzw": {"compression": "tiff_lzw"},
        }
        predictor = {"tiffinfo": {317: 2}} if "differences" in kind else {}
        Image.fromarray(values).save(path, **options.get(kind.replace(" differences", ""), {}), **predictor)
    return path


@pytest.mark.parametrize(
    ("kind", "in_parts"),
    [("npy", True), ("zarr", True), ("tif raw", True), ("tif deflated", True), ("tif deflated differences", True),
     ("tif lzw", False), ("png", False)],
)  # fmt: skip
@pytest.mark.parametrize("resolution", [(ROWS, COLUMNS), (75, 140), (40, 48)])
def test_pictures_in_parts_are_those_in_memory(kind, in_parts, resolution, colour, tmp_path):
    Image.fromarray(colour).save(tmp_path / "whole.png")
    path = written(kind, colour, tmp_path)
    assert isinstance(tiles.open_picture(path), np.ndarray) != in_parts
    for grey in (False, True):
        expected = load_target(Job(image=str(tmp_path / "whole.png"), resolution=resolution, grey=grey))
        with dask.config.set({"array.chunk-size": "8 kiB"}):
            found = tiles.load_target(Job(image=str(path), resolution=resolution, grey=grey, tiles=True))
        assert found.intensity.npartitions > 1
        assert (found.window, found.wavelengths) == (expected.window, expected.wavelengths)
        # The kernels of resizing are the same function, whose values two libraries round.
        np.testing.assert_allclose(found.intensity.compute(), expected.intensity, atol=1e-5)


@pytest.mark.parametrize("compressed", [False, True])
def test_strips_and_tiles_of_sixteen_bits(compressed, tmp_path):
    values = np.random.default_rng(0).integers(0, 2**16, (90, 70)).astype(np.uint16)
    options = {"compression": "tiff_adobe_deflate", "tiffinfo": {317: 2}} if compressed else {}
    Image.fromarray(values).save(tmp_path / "a.tif", **options)
    strips = tiles.open_picture(tmp_path / "a.tif")
    assert np.array_equal(strips[3:81, 10:33][..., 0], values[3:81, 10:33])
    import tifffile

    tifffile.imwrite(tmp_path / "tiled.tif", values, byteorder=">", tile=(32, 16))
    tiled = tiles.open_picture(tmp_path / "tiled.tif")
    assert np.array_equal(tiled[3:81, 10:33][..., 0], values[3:81, 10:33])
    data = (tmp_path / "tiled.tif").read_bytes()
    (tmp_path / "short.tif").write_bytes(data[:-200])
    with pytest.raises(InputError, match="strip or tile"):
        tiles.open_picture(tmp_path / "short.tif")[:, :]


@pytest.mark.parametrize(("method", "bits"), [("sgd", 8), pytest.param("gs", 10, marks=pytest.mark.slow)])
def test_the_report_holds_for_the_pattern_that_was_saved(method, bits, colour, grey_file, tmp_path):
    out = tmp_path / "out"
    said = run(grey_file, "-o", out, *GEOMETRY, "--method", method, "--bits", bits, "--iterations", 6)
    report = read_report(out)
    assert f"PSNR {report['psnr_db']:.2f} dB" in said.stdout and "loss" in said.stderr
    pattern = np.asarray(zarr.open_array(str(out / "hologram_532nm.zarr"))[:])
    assert pattern.shape == (ROWS, COLUMNS) and pattern.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert (
        np.array_equal(pattern, pixels(out / "hologram_532nm.png")) and not (pattern % (1 if bits == 8 else 64)).any()
    )
    intensity = angular_spectrum_intensity(pattern * (2 * np.pi / 2 ** (8 if bits == 8 else 16)), 532e-9, 8e-6, 3e-3)
    target = colour[..., 0] / 255
    scale = np.sum(intensity * target) / np.sum(intensity**2)
    psnr = 10 * math.log10(1 / np.mean((scale * intensity - target) ** 2))
    assert report["psnr_db"] == pytest.approx(psnr, abs=1e-3) and psnr > 12
    (part,) = report["channels"]
    assert part["scale"] == pytest.approx(scale, rel=1e-4)
    assert report["efficiency"] == pytest.approx(intensity.mean(), rel=1e-4)
    lit = intensity[target >= 0.1 * target.max()].sum() / intensity.size
    assert report["efficiency_lit"] == pytest.approx(lit, rel=1e-4)
    # The intensities stored are those of the method named in the report, computed in memory in double precision.
    light = np.asarray(zarr.open_array(str(out / "reconstruction_532nm.zarr"))[:])
    field = np.exp(2j * np.pi * pattern / 2.0 ** (8 if bits == 8 else 16))
    (judge,) = report["verification"]["propagation_type"]
    field = propagate_beam(field, None, 3e-3, 8e-6, 532e-9, judge, zero_padding=[True, False, True])
    np.testing.assert_allclose(light, np.abs(field) ** 2, atol=2e-5)
    assert np.abs(pixels(out / "reconstruction.png") / 255 - np.clip(part["scale"] * light, 0, 1)).max() < 0.501 / 255
    assert {path.name for path in out.iterdir()} == {
        "hologram_532nm.zarr", "hologram_532nm.png", "reconstruction_532nm.zarr", "reconstruction.png",
        "comparison.png", "report.json", "state_532nm",
    }  # fmt: skip


@pytest.mark.slow
def test_larger_ones_give_zarr_alone_and_the_same_numbers(colour, tmp_path, monkeypatch):
    np.save(tmp_path / "colour.npy", colour)
    arguments = [tmp_path / "colour.npy", *GEOMETRY, "--iterations", 1, "--quiet"]
    run(*arguments, "-o", tmp_path / "small")
    monkeypatch.setattr(tiles, "MOST_PIXELS_IN_PNG", 0)
    run(*arguments, "-o", tmp_path / "large")
    small, large = (read_report(tmp_path / name) for name in ("small", "large"))
    assert not list((tmp_path / "large").glob("*.png")) and large["ssim"] is None and small["ssim"] > 0
    assert large["psnr_db"] == small["psnr_db"] and large["channels"] == small["channels"]
    assert large["pattern"]["files"] == [f"hologram_{value}nm.zarr" for value in (638, 520, 450)]


@pytest.mark.slow
def test_a_run_is_continued_for_the_same_picture_only(grey_file, tmp_path):
    def pattern(folder):
        return np.asarray(zarr.open_array(str(tmp_path / folder / "hologram_532nm.zarr"))[:])

    options = [*GEOMETRY, "--quiet", "--iterations"]
    run(grey_file, "-o", tmp_path / "a", *options, 1)
    first = pattern("a")
    run(grey_file, "-o", tmp_path / "a", *options, 3)
    run(grey_file, "-o", tmp_path / "b", *options, 3)
    assert np.array_equal(pattern("a"), pattern("b")) and not np.array_equal(pattern("a"), first)
    about = json.loads(next((tmp_path / "a" / "state_532nm").glob("iteration_*/about.json")).read_text())
    assert about["done"] == 3
    assert "already" in run(grey_file, "-o", tmp_path / "b", *GEOMETRY, "--iterations", 3).stdout
    np.save(grey_file, np.load(grey_file)[::-1])
    said = run(grey_file, "-o", tmp_path / "a", *options, 4, expect=2)
    assert "contains the state of a run with another picture" in said.stderr and "--again" in said.stderr
    said = run(grey_file, "-o", tmp_path / "b", *options, 4, "--distance", "4e-3", "--again")
    assert read_report(tmp_path / "b")["parameters"]["distance"] == 4e-3


@pytest.mark.slow
def test_damage_between_two_runs_is_named_and_mended(grey_file, tmp_path):
    options = [*GEOMETRY, "--quiet", "--iterations"]
    for folder in ("a", "b"):
        run(grey_file, "-o", tmp_path / folder, *options, 1 if folder == "b" else 2)
    state = tmp_path / "b" / "state_532nm"
    chunk = next(path for path in (state / "iteration_000001" / "phase.zarr").rglob("0") if path.is_file())
    chunk.write_bytes(chunk.read_bytes()[:50])
    said = run(grey_file, "-o", tmp_path / "b", *options, 2)
    (warning,) = read_report(tmp_path / "b")["warnings"]
    assert "of phase.zarr; the iterations up to this one are computed again" in warning and warning in said.stderr
    assert read_report(tmp_path / "a")["channels"] == read_report(tmp_path / "b")["channels"]
    (state / "fingerprint.json").write_text("{")
    said = run(grey_file, "-o", tmp_path / "b", *options, 3, expect=2)
    assert "state of a run with another picture" in said.stderr and "--again" in said.stderr


# A run that ends without any warning, in the middle of writing the state of its third iteration.
KILLED = """
import os, sys
from odak.cli import main

replace = os.replace

def replace_or_die(source, target):
    if os.path.basename(target) == "iteration_000003":
        os._exit(9)
    replace(source, target)

os.replace = replace_or_die
main(sys.argv[1:])
"""


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_pattern(grey_file, tmp_path):
    options = [*GEOMETRY, "--iterations", "4"]
    arguments = ["hologram", str(grey_file), "-o", str(tmp_path / "a"), *options, "--quiet"]
    assert subprocess.run([sys.executable, "-c", KILLED, *arguments]).returncode == 9
    state = tmp_path / "a" / "state_532nm"
    assert (state / "iteration_000003.part").exists() and not (tmp_path / "a" / "report.json").exists()
    resumed = run(grey_file, "-o", tmp_path / "a", *options)
    # The progress bar starts where the run was killed.
    assert "| 2/4 [" in resumed.output and "| 1/4 [" not in resumed.output
    run(grey_file, "-o", tmp_path / "b", *options, "--quiet")
    assert np.array_equal(*(pixels(tmp_path / name / "hologram_532nm.png") for name in "ab"))
    assert read_report(tmp_path / "a")["channels"] == read_report(tmp_path / "b")["channels"]


@pytest.mark.slow
def test_worker_processes_give_the_same_pattern(grey_file, tmp_path):
    pytest.importorskip("distributed")
    for name, more in (("a", []), ("b", ["--cluster", "local", "--workers", "1"])):
        run(grey_file, "-o", tmp_path / name, *GEOMETRY, "--quiet", "--iterations", 2, *more)
    assert np.array_equal(*(pixels(tmp_path / name / "hologram_532nm.png") for name in "ab"))
    assert not (tmp_path / "b" / "spilled").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--method", "double-phase"], "--tiles needs --method sgd or gs"),
        (["--grating"], "--grating cannot be used with --tiles"),
        (["--no-scale"], "--no-scale cannot be used with --tiles"),
        (["--seed", "3"], "--seed has no effect with --initial-phase weak lens"),
        (["--watch"], "--tiles takes one IMAGE"),
        (["--cluster", "tcp://127.0.0.1:1"], "--cluster must be local"),
        (["--propagation-type", "Adaptive Sampling Angular Spectrum"], "--propagation-type must be one of"),
        (["--resolution", "8", "8"], "--resolution"),
        (["--optimizer", "lbfgs"], "--optimizer lbfgs cannot be used with --tiles"),
    ],
)
def test_what_tiles_cannot_do_is_said_in_a_line(arguments, message, grey_file, tmp_path, capsys):
    assert main(["hologram", str(grey_file), *GEOMETRY, *arguments, "-o", str(tmp_path / "out"), "-q"]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("bright.npy", np.full((20, 20), 7.0), "values from 0 to 1"),
        ("complex.npy", np.ones((20, 20), complex), "must be a real array"),
        ("deep.npy", np.ones((20, 20, 7)), "1 to 4 channels"),
        ("small.npy", np.ones((4, 20)), "at least 16 rows and columns"),
        ("objects.npy", np.array([print], object), "cannot be read"),
        ("black.npy", np.zeros((20, 20)), "IMAGE must be finite and not all zero"),
    ],
)
def test_pictures_that_cannot_be_used_are_named(name, content, message, tmp_path, capsys):
    np.save(tmp_path / name, content, allow_pickle=True)
    assert main(["hologram", str(tmp_path / name), *GEOMETRY, "-o", str(tmp_path / "out"), "-q"]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
