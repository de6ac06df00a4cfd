"""`odak hologram` for many pictures, in this process and on a real cluster."""

import json
import logging
import os
import time
import types

import numpy as np
import pytest
import torch
from command import COLUMNS, ROWS, SMALL, read_report, run
from PIL import Image
from running_cluster import cluster, start_scheduler, start_workers, stop, tls_options

from odak.cli import cluster as many
from odak.cli import main
from odak.manager import tasks
from odak.manager.server import tls_security


@pytest.fixture
def folder(tmp_path):
    """A folder with three small pictures and a file that is none."""
    there = tmp_path / "frames"
    there.mkdir()
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    for number in (1, 2, 10):
        picture = np.round(255 * (0.5 + 0.4 * np.sin(x / (3 + number)) * np.cos(y / 7))).astype(np.uint8)
        Image.fromarray(picture).save(there / f"frame{number}.png")
    (there / "notes.txt").write_text("no picture")
    return there


def summary_of(output):
    return json.loads((output / "summary.json").read_text(encoding="utf-8"))


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix == ".png"}


def test_a_folder_gives_what_each_picture_gives(folder, tmp_path):
    result = run(folder, "--output", tmp_path / "all", *SMALL)
    assert "3 computed, 0 skipped, 0 failed in" in result.stdout and "by 1 worker;" in result.stdout
    assert summary_of(tmp_path / "all")["computed"] == ["frame1", "frame2", "frame10"]
    for name in ("frame1", "frame10"):
        run(folder / f"{name}.png", "--output", tmp_path / name, *SMALL, "--quiet")
        alone, together = read_report(tmp_path / name), read_report(tmp_path / "all" / name)
        assert contents(tmp_path / name) == contents(tmp_path / "all" / name) != {}
        assert together["picture"] == alone["picture"]
        output = {"output": str(tmp_path / "all" / name), "quiet": False}
        assert together["parameters"] == {**alone["parameters"], **output}
        assert together["psnr_db"] == alone["psnr_db"]


@pytest.mark.slow
@pytest.mark.usefixtures("sheets")
@pytest.mark.xdist_group("cluster")
def test_on_a_cluster_the_patterns_are_the_same(folder, tmp_path):
    count = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        run(folder, "--output", tmp_path / "serial", *SMALL, "--quiet")
    finally:
        torch.set_num_threads(count)
    result = run(folder, "--output", tmp_path / "spread", *SMALL, "--cluster", cluster())
    assert "3 computed, 0 skipped, 0 failed" in result.stdout
    for name in ("frame1", "frame2", "frame10"):
        assert contents(tmp_path / "serial" / name) == contents(tmp_path / "spread" / name) != {}
        report = read_report(tmp_path / "spread" / name)
        assert report["parameters"]["image"] == report["picture"]["file"] == str(folder / f"{name}.png")
    result = run(folder, "--output", tmp_path / "spread", *SMALL, "--cluster", cluster())
    assert "0 computed, 3 skipped, 0 failed" in result.stdout


@pytest.mark.slow
def test_workers_are_sent_every_setting(folder):
    from odak.cli.job import Job

    image = str(next(folder.iterdir()))
    for given in ({"fill_factor": 0.0}, {"bits": 2}, {"method": "gs"}, {"propagation_type": "Angular Spectrum"}):
        job = Job(image=image, **given)
        assert Job(image=image, **many.parameters(job)).values() == job.values()


def over_tls(folder, address, files):
    result = run(folder, "--output", folder / "out", *SMALL, "--cluster", address, *files)
    assert "3 computed, 0 skipped, 0 failed" in result.stdout
    options = ["--cluster", address, "--timeout", "0.5"]
    run(folder, "--output", folder / "refused", *SMALL, *options, expect=1)


class Here:
    """Computes the tasks of a worker in its own thread, which takes no new program."""

    def __init__(self, limit):
        self.alive = lambda: True

    def compute(self, job, code, threads):
        return tasks.attempt(lambda: tasks.pack(tasks._compute(code, job)))


def test_over_tls(folder, tmp_path, monkeypatch):
    """The scheduler and its worker are threads here, and programs of their own in the slow test."""
    monkeypatch.setattr(tasks, "_Process", Here)
    pytest.importorskip("cryptography")
    distributed = pytest.importorskip("distributed")
    assert main(["certificates", str(tmp_path / "tls")]) == 0
    files = tls_options(tmp_path / "tls")
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        protocol="tls://",
        security=tls_security(*files[1::2]),
        dashboard_address=None,
        silence_logs=logging.ERROR,
    ) as local:
        over_tls(folder, local.scheduler_address, files)
    assert main(["certificates", str(tmp_path / "tls")]) == 2


@pytest.mark.slow
def test_over_tls_to_programs(folder, tmp_path):
    pytest.importorskip("cryptography")
    assert main(["certificates", str(tmp_path / "tls")]) == 0
    files = tls_options(tmp_path / "tls")
    scheduler, address = start_scheduler("--protocol", "tls", *files)
    workers = []
    try:
        workers += start_workers(address, 1, *files)
        over_tls(folder, address, files)
    finally:
        stop(scheduler, *workers)


@pytest.mark.slow
def test_what_is_done_is_skipped_and_nothing_else(folder, tmp_path):
    def again(*options):
        run(folder, "--output", tmp_path / "out", *SMALL, "--quiet", *options)
        summary = summary_of(tmp_path / "out")
        assert sorted(summary["computed"] + summary["skipped"]) == ["frame1", "frame10", "frame2"]
        return summary["computed"]

    everything = ["frame1", "frame2", "frame10"]
    assert again() == everything
    assert again() == []
    (tmp_path / "out" / "frame2" / "hologram_532nm.png").unlink()
    assert again() == ["frame2"]
    (tmp_path / "out" / "frame1" / "report.json").write_text("{")
    (tmp_path / "out" / "frame10" / "report.json").unlink()
    assert again() == ["frame1", "frame10"]
    picture = Image.open(folder / "frame2.png")
    picture.putpixel((0, 0), 255 - picture.getpixel((0, 0)))
    picture.save(folder / "frame2.png")
    assert again() == ["frame2"]
    seeded = ("--initial-phase", "normal", "--seed", "1")
    assert again(*seeded) == everything
    assert again(*seeded) == []
    assert again(*seeded, "--again") == everything


@pytest.mark.slow
def test_a_picture_that_fails_is_named_and_the_rest_is_done(folder, tmp_path, capsys):
    (folder / "frame3.png").write_bytes(b"no picture at all")
    code = main(["hologram", str(folder), "--output", str(tmp_path / "out"), *SMALL])
    said = capsys.readouterr()
    assert code == 1
    assert "3 computed, 0 skipped, 1 failed" in said.out
    (line,) = [line for line in said.err.splitlines() if line.startswith("odak: ")]
    assert line.startswith("odak: frame3: ") and "frame3.png" in line and "odak-hologram-" not in line
    assert list(summary_of(tmp_path / "out")["failed"]) == ["frame3"]
    assert not (tmp_path / "out" / "frame3").exists()
    Image.fromarray(np.full((ROWS, COLUMNS), 128, np.uint8)).save(folder / "frame3.png")
    run(folder, "--output", tmp_path / "out", *SMALL, "--quiet")
    assert summary_of(tmp_path / "out")["computed"] == ["frame3"]


@pytest.mark.slow
def test_depth_maps_are_found_by_name(folder, tmp_path):
    depths = tmp_path / "depths"
    depths.mkdir()
    for number in (1, 2, 10):
        levels = np.tile(np.linspace(0, 255, COLUMNS).astype(np.uint8), (ROWS, 1))
        Image.fromarray(levels if number == 1 else levels[:, ::-1].copy()).save(depths / f"frame{number}.png")
    options = [*SMALL, "--planes", "2", "--volume-depth", "1e-3", "--quiet"]
    run(folder, "--output", tmp_path / "out", *options, "--depth-map", depths)
    report = read_report(tmp_path / "out" / "frame1")
    assert report["parameters"]["depth_map"] == str(depths / "frame1.png")
    run(folder / "frame1.png", "--output", tmp_path / "one", *options, "--depth-map", depths / "frame1.png")
    assert contents(tmp_path / "one") == contents(tmp_path / "out" / "frame1")
    (depths / "frame2.png").unlink()
    result = run(folder, "--output", tmp_path / "out", *options, "--depth-map", depths, expect=2)
    assert "--depth-map has no picture named 'frame2'" in result.stderr


def test_folders_are_watched_for_new_and_changed_pictures(folder, tmp_path, monkeypatch):
    looks = []

    def sleep(_):
        looks.append(sorted(path.name for path in (tmp_path / "out").glob("frame*")))
        if len(looks) == 3:
            Image.fromarray(np.full((ROWS, COLUMNS), 90, np.uint8)).save(folder / "frame11.png")
        if len(looks) == 6:
            Image.fromarray(np.full((ROWS, COLUMNS), 120, np.uint8)).save(folder / "frame2.png")
        if len(looks) == 9:
            raise KeyboardInterrupt

    monkeypatch.setattr(many, "time", types.SimpleNamespace(sleep=sleep, perf_counter=time.perf_counter))
    said = run(folder, "-o", tmp_path / "out", *SMALL, "--watch")
    counts = [line.partition(" in ")[0] for line in said.stdout.splitlines() if "computed" in line]
    assert counts == ["3 computed, 0 skipped, 0 failed", *["1 computed, 0 skipped, 0 failed"] * 2]
    # A picture is taken once it has not changed between two looks.
    assert looks[0] == [] and len(looks[1]) == 3 and len(looks[4]) == 4
    result = run(folder / "frame1.png", "-o", tmp_path, *SMALL, "--watch", expect=2)
    assert "--watch needs folders" in result.stderr


def test_shipped_pictures_by_name(tmp_path):
    run("photo", "chart", "--output", tmp_path, *SMALL, "--grey", "--quiet")
    assert summary_of(tmp_path)["computed"] == ["photo", "chart"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--cluster", "slurm"], "--cluster must be 'local', the address of a scheduler"),
        (["--workers", "0"], "--workers must be at least 1"),
        (["--workers", "2"], "--workers must be left out unless cluster='local'"),
        (["--retries", "-1"], "--retries must be at least 0"),
        (["--iterations", "0"], "--iterations must be at least 1"),
        (["missing.png"], "IMAGE not found"),
        (["."], "different names"),
        (["--cluster", "tcp://10.1.2.3:8786"], "or set --trusted-network if"),
        (["--cluster", "tls://10.1.2.3:8786", "--tls-cert", "a.pem"], "--tls-key must be given together"),
        (["summary.json.png"], "'the file summary.json of this command' and "),
        (["FRAME1.png"], "different names"),
        (["empty"], "IMAGE is a directory without pictures"),
    ],
)
def test_bad_input_is_code_2(arguments, message, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    os.mkdir("empty")
    if arguments[0].endswith(".png") and arguments[0] != "missing.png":
        arguments = [str(tmp_path / arguments[0])]
        Image.new("L", (COLUMNS, ROWS), 9).save(arguments[0])
    result = run(folder, *arguments, "--output", tmp_path / "out", expect=2)
    assert message in result.stderr


def test_a_cluster_that_is_not_there_is_code_1(folder, tmp_path):
    options = ["--cluster", "tcp://127.0.0.1:1", "--timeout", "0.3", "--quiet"]
    result = run(folder, "--output", tmp_path, *SMALL, *options, expect=1)
    assert "127.0.0.1:1" in result.stderr and not list(tmp_path.glob("frame1"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["somewhere"], "ADDRESS must be the address of a scheduler, such as tls://10.0.0.1:8786; got 'somewhere'"),
        (["tcp://127.0.0.1:1", "--workers", "0"], "--workers must be at least 1"),
        (["tcp://127.0.0.1:1", "--memory-limit", "-1"], "--memory-limit must be positive"),
        (["tcp://10.1.2.3:8786"], "ADDRESS 'tcp://10.1.2.3:8786' is not an address of this machine only"),
        (
            ["tcp://127.0.0.1:1", "--tls-cert", "a.pem"],
            "--tls-ca-file, --tls-cert and --tls-key must be given together",
        ),
    ],
)
def test_bad_workers_are_code_2(arguments, message, capsys):
    assert main(["worker", *arguments]) == 2
    assert message in capsys.readouterr().err
