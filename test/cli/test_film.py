"""Films by `odak hologram`: warm starts, what is kept and resumed, flicker, and what is refused."""

import json
import sys

import numpy as np
import pytest
import torch

from odak.cli import main
from odak.cli.film import _flicker
from odak.cli.job import Job
from odak.learn.wave import Display, Modulator, Run, optimise
from odak.tools import save_image

cv2 = pytest.importorskip("cv2")
SIZE = ["--resolution", "32", "48", "--grey", "--distance", "2mm", "--quiet"]


def drawn(number):
    """Return a still picture in front of which a small square moves by a pixel from frame to frame."""
    picture = np.full((32, 48), 30, np.uint8)
    picture[8:24, 10:30] = 200
    picture[12:16, 14:20] = 60
    picture[4:8, 32 + number : 36 + number] = 255
    return picture


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "square.avi"
    stream = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, (48, 32))
    for number in range(3):
        stream.write(cv2.cvtColor(drawn(number), cv2.COLOR_GRAY2BGR))
    stream.release()
    return path


def test_warm_starts_need_fewer_iterations():
    display = Display(Modulator((32, 48), 8e-6), 532e-9, 2e-3)
    first, second = (torch.from_numpy(drawn(n)).float() / 255 for n in (0, 1))
    before = optimise(display, first, run=Run(30, progress=False))
    cold = optimise(display, second, run=Run(9, progress=False))
    warm = optimise(display, second, start=before.phases, run=Run(6, progress=False))
    assert warm.losses[-1] < cold.losses[-1]


def test_frames_are_kept_and_resumed(film, tmp_path, capsys):
    arguments = ["hologram", str(film), *SIZE, "--iterations", "1", "--output", str(tmp_path)]
    assert main(arguments) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["frames"] == 3 and summary["frames_per_second"] == 25 and not summary["interrupted"]
    reports = [tmp_path / f"frame_{number:05d}" / "report.json" for number in (1, 2, 3)]
    starts = [json.loads(path.read_text())["parameters"]["start"] for path in reports]
    assert starts == [None, *(str(path.parent) for path in reports[:2])]
    written = [path.read_bytes() for path in reports]
    # A run that was cut short in the last frame leaves no report of it.
    reports[2].unlink()
    assert main(arguments) == 0
    assert [path.read_bytes() for path in reports[:2]] == written[:2]
    assert json.loads(reports[2].read_text())["psnr_db"] == pytest.approx(summary["psnr_db"][2], abs=1e-6)


@pytest.mark.slow
def test_frames_that_begin_with_the_one_before_are_better_and_flicker_less(film, tmp_path, capsys):
    arguments = [*SIZE, "--iterations", "10"]
    assert main(["hologram", str(film), *arguments, "--output", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    cold, jobs = [], []
    for number in (1, 2, 3):
        picture, folder = str(tmp_path / f"frame_{number:05d}" / "picture.png"), tmp_path / f"alone_{number}"
        assert main(["hologram", picture, *arguments, "--output", str(folder)]) == 0
        cold.append(json.loads((folder / "report.json").read_text())["psnr_db"])
        jobs.append(Job(image=picture, resolution=(32, 48), grey=True, distance=2e-3, output=folder))
    # 0.8 dB and two thirds of the flicker.
    assert summary["psnr_db"][2] > cold[2] + 0.3
    assert summary["flicker"] < 0.9 * _flicker(jobs, 25.0)


def test_flicker_is_that_of_the_error(film, tmp_path):
    # Of holograms that show their pictures, or all the same amount too much, nothing flickers beside the film.
    found = {}
    for name, more in (("exact", (0, 0)), ("brighter", (40, 40)), ("one brighter", (0, 40))):
        jobs = []
        for number, added in enumerate(more):
            folder = tmp_path / f"{name}_{number}"
            folder.mkdir()
            save_image(str(folder / "picture.png"), drawn(number) // 2)
            save_image(str(folder / "reconstruction.png"), drawn(number) // 2 + np.uint8(added))
            values = {"resolution": (32, 48), "linear": True, "wavelengths": (532e-9,), "distance": 2e-3}
            jobs.append(Job(**values, image=str(folder / "picture.png"), output=folder))
        found[name] = _flicker(jobs, 25.0)
    assert found["exact"] < 1e-6 and found["brighter"] < 1e-6 < 1 < found["one brighter"]


def test_what_is_refused(film, tmp_path, capsys, monkeypatch):
    for words, arguments in (
        ("--start has no effect with --initial-phase", ["photo", "--start", str(tmp_path), "--initial-phase", "flat"]),
        ("--start has no effect with --method gs", ["photo", "--start", str(tmp_path), "--method", "gs"]),
        ("--start must be a folder with results", ["photo", "--start", str(tmp_path)]),
        ("IMAGE must be an existing file", [str(tmp_path / "none.mp4")]),
    ):
        assert main(["hologram", *arguments, *SIZE, "--output", str(tmp_path / "out")]) == 2
        assert words in capsys.readouterr().err
    (tmp_path / "text.mp4").write_text("no film")
    assert main(["hologram", str(tmp_path / "text.mp4"), *SIZE, "--output", str(tmp_path / "out")]) == 2
    assert "no film that OpenCV can read" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert main(["hologram", str(film), *SIZE, "--output", str(tmp_path / "out")]) == 2
    assert "pip install opencv-python-headless" in capsys.readouterr().err
