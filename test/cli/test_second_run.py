"""Results of earlier runs: what a second run keeps, and what it says before it replaces files."""

import errno
import os
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from odak import ArgumentWarning
from odak.cli import files, lens_design, main, trace
from odak.cli.options import InputError
from odak.learn.raytracing.system import load_system

BENCH = """
[bench]
wavelength = "{wavelength}"
resolution = [32, 32]
pixel_pitch = "8um"
[[elements]]
kind = "plane_wave"
[[elements]]
kind = "record"
name = "a"
"""
TINY = ["--levels", "3", "--iterations", "0", "--device", "cpu"]
DARK = ["--resolution", "16", "16", "--iterations", "1", "--frames", "1", "--device", "cpu"]
ONE_STEP = ["--iterations", "1", "--starts", "1"]
COMMANDS = {
    "simulate": (["bench.toml"], ["other.toml"], ["a.npy", "a.png", "report.json"]),
    "eyebox": (
        ["noise.png", *DARK],
        ["noise.png", *DARK, "--seed", "1"],
        ["hologram_frame1.png", "views.png", "report.json"],
    ),
    "metamer": (
        ["noise.png", *TINY],
        ["noise.png", *TINY, "--seed", "1"],
        ["metamer.png", "pooling_map.png", "comparison.png", "report.json"],
    ),
    "trace": (["singlet", "--rings", "1"], ["singlet", "--rings", "2"], ["layout.png", "report.html", "report.json"]),
    "design": (["singlet", *ONE_STEP], ["singlet", *ONE_STEP, "--f-number", "6"], ["lens.json", "report.json"]),
}


@pytest.fixture
def cheap(monkeypatch):
    """Leave out what takes seconds: this is about files, not about lenses."""
    lens = load_system("singlet")
    monkeypatch.setattr(trace.lenses, "report_figures", lambda *_: {"layout": Figure(figsize=(1, 1))})
    monkeypatch.setattr(trace.lenses, "lens_report", lambda system, path, *_: path.write_text("report"))
    described = {"system": {"unit": "mm"}, "first_order": {"focal_length": None}, "fields": []}
    monkeypatch.setattr(trace, "describe", lambda *_: described)
    monkeypatch.setattr(lens_design, "_from_system", lambda *_: (lens, lens, [], [], {}))
    monkeypatch.setattr(lens_design, "_judged", lambda *_: [])
    monkeypatch.setattr(lens_design, "_drawing", lambda *_: Figure(figsize=(1, 1)))


@pytest.mark.usefixtures("cheap")
@pytest.mark.parametrize("command", COMMANDS)
def test_a_second_run_keeps_its_result_and_announces_others(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    Image.fromarray(noise).save("noise.png")
    for name, wavelength in (("bench.toml", "532nm"), ("other.toml", "633nm")):
        (tmp_path / name).write_text(BENCH.format(wavelength=wavelength))
    first, other, names = COMMANDS[command]

    def run(*arguments):
        code = main([command, *arguments, "-o", "out"])
        told = capsys.readouterr()
        return code, told.out, told.err

    def stamps():
        return {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out").iterdir()}

    code, out, err = run(*first)
    assert code == 0 and "already" not in out and "replaced" not in err
    written = stamps()
    assert set(names) <= set(written)
    code, out, err = run(*first)
    assert code == 0 and "already holds the result of this run; use --again" in out
    assert stamps() == written
    code, out, err = run(*other)
    assert code == 0 and "already" not in out
    assert "of another run, which will be replaced" in err and all(name in err for name in names)
    assert stamps()["report.json"] > written["report.json"]
    # A result that is no longer whole is computed again, and what is left of it is named.
    (tmp_path / "out" / names[0]).unlink()
    code, out, err = run(*other)
    assert code == 0 and "already" not in out and "report.json of another run" in err and names[0] not in err
    code, out, err = run(*other, "--again")
    assert code == 0 and "already" not in out and "replaced" not in err


@pytest.mark.usefixtures("cheap")
@pytest.mark.parametrize("command", [*COMMANDS, "hologram", "hologram --tiles", "hologram two.png", "calibrate"])
def test_a_folder_in_use_by_another_run_is_refused(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("noise.png", "two.png"):
        Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8)).save(name)
    (tmp_path / "bench.toml").write_text(BENCH.format(wavelength="532nm"))
    name, *more = command.split()
    arguments = COMMANDS[name][0] if name in COMMANDS else ["exposure"] if name == "calibrate" else ["noise.png", *more]
    (tmp_path / "out").mkdir()
    with files.locked(tmp_path / "out"):
        assert main([name, *arguments, "-o", "out"]) == 2
        told = capsys.readouterr().err
        assert f"is in use by another run (process {os.getpid()} on " in told.splitlines()[-1]
        assert [path.name for path in (tmp_path / "out").iterdir()] == [files.LOCK]
    assert not any((tmp_path / "out").iterdir())


HOLDER = """
import sys
from pathlib import Path
from odak.cli.files import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    sys.stdin.read()
"""


def test_the_lock_of_a_killed_run_ends_with_it(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(InputError, match=rf"in use by another run \(process {holder.pid} on"):
            files.locked(tmp_path).__enter__()
    finally:
        holder.kill()
        holder.communicate()
    assert (tmp_path / files.LOCK).exists()
    with files.locked(tmp_path):
        assert (tmp_path / files.LOCK).read_text().startswith(f"process {os.getpid()} on ")
    assert not any(tmp_path.iterdir())
    # A link in the place of the lock is not followed, and what was written there by others is not repeated.
    (tmp_path / "other").write_text("kept")
    (tmp_path / files.LOCK).symlink_to(tmp_path / "other")
    with pytest.raises(OSError, match="symbolic links"):
        files.locked(tmp_path).__enter__()
    assert (tmp_path / "other").read_text() == "kept"


def test_paths_too_long_for_patterns_are_refused_beforehand(tmp_path, capsys):
    folder = tmp_path / ("a" * 200) / ("b" * (260 - 201 - len(str(tmp_path)) - 5))
    assert main(["hologram", "photo", "--resolution", "32", "32", "--distance", "3e-3", "-o", str(folder)]) == 2
    told = capsys.readouterr().err
    assert "--output exceeds maximum length" in told and "it/s" not in told
    assert not any(folder.iterdir())


def test_a_full_disk_is_named(tmp_path, monkeypatch, capsys):
    """The limit of the system on the size of files stands for a disk that is full, at the lock and in Zarr's files."""
    resource = pytest.importorskip("resource")
    pytest.importorskip("zarr")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    arguments = ["hologram", "photo", "--resolution", "32", "32", "--distance", "3e-3", "--iterations", "1", "-q"]
    for room, named in ((0, files.LOCK), (300, str(tmp_path / "out"))):
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
            code = main([*arguments, "--tiles", "-o", str(tmp_path / "out")])
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        told = capsys.readouterr().err.splitlines()[-1]
        assert code == 1 and "File too large" in told and named in told
    assert not (tmp_path / "out" / "report.json").exists() and not (tmp_path / "out" / files.LOCK).exists()


def test_a_file_system_without_locks_is_named(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")

    def flock(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.warns(ArgumentWarning, match="has no locks"), files.locked(tmp_path):
        pass


def test_a_person_is_asked_and_may_refuse(tmp_path, monkeypatch, capsys):
    for name, wavelength in (("bench.toml", "532nm"), ("other.toml", "633nm")):
        (tmp_path / name).write_text(BENCH.format(wavelength=wavelength))
    assert main(["simulate", str(tmp_path / "bench.toml"), "-o", str(tmp_path / "out")]) == 0
    before = (tmp_path / "out" / "a.npy").read_bytes()
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    asked = []
    monkeypatch.setattr("typer.confirm", lambda text: asked.append(text))
    capsys.readouterr()
    assert main(["simulate", str(tmp_path / "other.toml"), "-o", str(tmp_path / "out")]) == 2
    assert "a.npy, a.png, report.json of another run. Replace?" in asked[0]
    assert "nothing was computed; --output names another folder" in capsys.readouterr().err
    assert (tmp_path / "out" / "a.npy").read_bytes() == before


@pytest.mark.slow
def test_a_repeated_step_of_a_calibration_is_announced(tmp_path, capsys):
    arguments = [
        "-o",
        str(tmp_path),
        "--option",
        "simulated.shape=[32,32]",
        "--option",
        "simulated.camera_shape=[40,40]",
    ]
    assert main(["calibrate", "exposure", *arguments]) == 0
    assert "replaced" not in capsys.readouterr().err
    assert main(["calibrate", "exposure", *arguments]) == 0
    assert "exposure.png of another run, which will be replaced" in capsys.readouterr().err
    assert main(["calibrate", "exposure", *arguments, "--again"]) == 0
    assert "replaced" not in capsys.readouterr().err


def test_an_interrupted_run_ends_with_one_line_and_its_own_code(tmp_path, monkeypatch, capsys):
    (tmp_path / "bench.toml").write_text(BENCH.format(wavelength="532nm"))

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("numpy.save", interrupt)
    assert main(["simulate", str(tmp_path / "bench.toml"), "-o", str(tmp_path / "out")]) == 130
    assert capsys.readouterr().err.strip() == "odak: interrupted"
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["hologram", "chart", "--resolution", "64"], "Give two values: --resolution ROWS COLUMNS"),
        (["hologram", "--resolution", "64"], "Give two values: --resolution ROWS COLUMNS"),
        (["metamer", "--gaze", "0.5,0.5", "photo"], ". Give two values: --gaze X Y"),
        (["simulate", "nothing.toml"], "CONFIG not found: 'nothing.toml'"),
        (["trace", "cooke"], "Did you mean 'cooke_triplet'?"),
        (["calibrate"], "Missing argument 'STEP'. `odak calibrate --help` explains it."),
        (["design", "singlet", "--chief-ray-angle", "120"], "--chief-ray-angle must be below 90 degrees, got 120"),
        (["simulate", "bench.toml"], "bench: wavelength 532 is 532 metres, which is not a wavelength of light"),
    ],
)
def test_what_was_meant_is_said(arguments, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bench.toml").write_text(BENCH.format(wavelength="532"))
    assert main([*arguments, "-o", "out"]) == 2
    told = capsys.readouterr().err
    assert named in told.splitlines()[-1]
    assert not (tmp_path / "out").exists()
