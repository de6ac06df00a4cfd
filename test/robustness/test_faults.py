"""What is left after a full disk, a killed process, an interrupt, or a GPU without memory."""

import errno
import json
import os
import re
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import faults
import numpy as np
import pytest
import torch
from faults import STAGES, WRITERS
from PIL import Image

from odak import ConvergenceWarning, instruments, tools
from odak.cli import main
from odak.tools import paths

STRAY = re.compile(r"\.[0-9a-f]{16}\.part")
needs_kill = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked and killed by Unix means")


@pytest.fixture(autouse=True)
def one_thread():
    """Small work on several threads waits for them more than it computes."""
    count = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(count)


def in_a_process(*arguments):
    """Run faults.py, which forks, in a process without threads."""
    root = Path(__file__).resolve().parents[2]
    environment = os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, faults.__file__, *map(str, arguments)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def written(name, version, folder):
    """Return what a writer writes."""
    folder.mkdir(exist_ok=True)
    WRITERS[name](str(folder / name), version)
    return (folder / name).read_bytes()


class TestFullDisk:
    @pytest.fixture(params=[0, 100], ids=["at once", "after 100 bytes"])
    def full(self, request, monkeypatch):
        """Let files take so many bytes and no more."""
        whole, room = paths._File.write, request.param

        def write(file, data):
            view = memoryview(data).cast("B")
            free = room - file.tell()
            if view.nbytes > free:
                whole(file, view[: max(0, free)])
                file.failure = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                raise file.failure
            return whole(file, data)

        def fill():
            monkeypatch.setattr(paths._File, "write", write)

        return fill

    @pytest.mark.parametrize("name", [name for name in WRITERS if name not in ("deep.png", "image.jpg")])
    @pytest.mark.parametrize("older", [False, True])
    def test_simulated(self, name, older, full, tmp_path):
        before = written(name, 1, tmp_path) if older else None
        full()
        with pytest.raises((OSError, ValueError), match=re.escape(name)) as caught:
            WRITERS[name](str(tmp_path / name), 2)
        assert "No space left" in str(caught.value)
        assert os.listdir(tmp_path) == ([name] if older else [])
        assert before is None or (tmp_path / name).read_bytes() == before

    @pytest.fixture
    def small_disk(self, tmp_path):
        """A file system of 64 kB."""
        place = tmp_path / "disk"
        place.mkdir()
        made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(place)], capture_output=True)
        if made.returncode:
            pytest.skip("no right to mount a small file system")
        yield place
        subprocess.run(["umount", "-l", str(place)], check=True)

    @pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a small file system is mounted by Linux' means")
    def test_real(self, small_disk):
        large = torch.rand(300, 300)
        writers = {
            "a.pt": lambda path, tensor: faults.save_torch_tensor(path, tensor),
            "a.jpg": lambda path, tensor: tools.save_image(path, tensor.numpy(), 0, 1),
            "a.png": lambda path, tensor: tools.save_image(path, tensor.numpy(), 0, 1),
            "a.json": lambda path, tensor: tools.save_dictionary({"a": tensor}, path),
            "a.ply": lambda path, tensor: tools.write_PLY(tensor[:, :9].reshape(-1, 3, 3), path),
        }
        if "captures.h5" in WRITERS:
            # HDF5 itself ends the process where a disk is full.
            pattern, rest = np.zeros((1, 6, 8), int), (np.zeros(1), 532e-9, 8e-6, 4e-6, 16, 1e-3)
            writers["a.h5"] = lambda path, tensor: instruments.save_captures(
                path, instruments.Captures(pattern, (tensor * 65535).int().numpy()[None, None], *rest)
            )
        for name, write in writers.items():
            path = str(small_disk / name)
            write(path, large[:9, :9].clone())
            before = (small_disk / name).read_bytes()
            with pytest.raises((OSError, ValueError), match=rf"No space left.*{name}|{name}.*No space left"):
                write(path, large.repeat(2, 1))
            assert (small_disk / name).read_bytes() == before
        assert sorted(os.listdir(small_disk)) == sorted(writers)

    @pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a small file system is mounted by Linux' means")
    def test_a_read_only_disk(self, small_disk):
        before = {name: written(name, 1, small_disk) for name in ("settings.json", "image.png")}
        if subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], capture_output=True).returncode:
            pytest.skip("no right to mount a file system anew")
        for name, write in WRITERS.items():
            with pytest.raises(OSError, match=f"(Read-only file system|write-protected).*{name}"):
                write(str(small_disk / name), 2)
        assert {name: (small_disk / name).read_bytes() for name in os.listdir(small_disk)} == before

    @pytest.mark.parametrize("code", [errno.EACCES, errno.EROFS, errno.EDQUOT])
    def test_a_folder_that_cannot_be_written_to(self, code, tmp_path, monkeypatch):
        before = written("settings.json", 1, tmp_path)
        opened = os.open

        def refuse(path, flags, *arguments, **options):
            if flags & os.O_CREAT:
                raise OSError(code, os.strerror(code), path)
            return opened(path, flags, *arguments, **options)

        monkeypatch.setattr(os, "open", refuse)
        with pytest.raises(OSError, match=r"settings\.json") as caught:
            WRITERS["settings.json"](str(tmp_path / "settings.json"), 2)
        monkeypatch.undo()
        assert caught.value.errno == code and (tmp_path / "settings.json").read_bytes() == before
        assert os.listdir(tmp_path) == ["settings.json"]


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """Folders in which each writer was killed at each stage."""
    folder = tmp_path_factory.mktemp("killed")
    in_a_process("writers", folder)
    return folder


@needs_kill
@pytest.mark.xdist_group("killed")
class TestKilled:
    @pytest.mark.slow
    @pytest.mark.parametrize("name", WRITERS)
    def test_a_file_is_the_former_or_the_new_one(self, name, killed, tmp_path):
        former, new = (written(name, version, tmp_path / str(version)) for version in (1, 2))
        assert former != new
        # Pillow hands JPEG to the system itself: that writer is killed around the move alone.
        stages = list(enumerate(STAGES))[2 if name == "image.jpg" else 0 :]
        for number, stage in stages:
            for older in (False, True):
                place = killed / name / f"{number}{older:d}"
                held = {path.name: path for path in place.iterdir()}
                assert "survived" not in held, stage
                strays = [path for path in held if STRAY.fullmatch(path)]
                expected = new if stage == "after the move" else former if older else None
                assert (held[name].read_bytes() if name in held else None) == expected, stage
                assert len(strays) == (stage != "after the move") and set(held) <= {name, *strays}
                # What was being written is found under no name that a search for such files gives.
                found = tools.list_files(str(place), f"*{Path(name).suffix}")
                assert [os.path.basename(path) for path in found] == [name] * (name in held)

    @pytest.mark.slow
    def test_runs_killed_again_and_again_end_as_unbroken_ones(self, tmp_path):
        told = [line.split() for line in in_a_process("runs", tmp_path).splitlines()]
        assert [line[0] for line in told] == list(faults.RUNS)
        assert all(int(kills) >= 2 and same == "True" for _, kills, same in told), told


class TestInterrupted:
    @pytest.mark.parametrize("run", ["adam", "lbfgs", "network"])
    @pytest.mark.parametrize("number", [1, 4])
    def test_while_the_checkpoint_is_written(self, run, number, tmp_path, monkeypatch):
        path, whole, count = str(tmp_path / "run.pt"), paths._File.write, []
        unbroken = faults.RUNS[run]()

        def write(file, data):
            count.append(None)
            if len(count) == number:
                raise KeyboardInterrupt
            return whole(file, data)

        monkeypatch.setattr(paths._File, "write", write)
        with warnings.catch_warnings():
            # An interrupted training says so.
            warnings.simplefilter("ignore", ConvergenceWarning)
            faults.RUNS[run](path)
        monkeypatch.undo()
        assert len(count) >= number and os.listdir(tmp_path) == ["run.pt"]
        assert torch.load(path, weights_only=True)["done"] < 30
        resumed = faults.RUNS[run](path)
        assert all(torch.equal(one, other) for one, other in zip(unbroken, resumed, strict=True))

    @pytest.mark.usefixtures("small_judge")
    def test_the_command_says_so_and_writes_the_best_so_far(self, tmp_path, monkeypatch):
        from odak.cli.report import Clock

        picture = tmp_path / "picture.png"
        Image.fromarray(np.tile(np.arange(48, dtype=np.uint8), (32, 1)) * 5).save(picture)
        tick = Clock.tick

        def interrupted(clock, *arguments):
            tick(clock, *arguments)
            if clock.ticks == 2:
                raise KeyboardInterrupt

        monkeypatch.setattr(Clock, "tick", interrupted)
        options = ["--resolution", "32", "48", "--distance", "3e-3", "--iterations", "5", "--device", "cpu", "--quiet"]
        for method in ("sgd", "gs", "multi-color"):
            place = tmp_path / method
            assert main(["hologram", str(picture), *options, "--method", method, "--output", str(place)]) == 130
            report = json.loads((place / "report.json").read_text())
            assert report["interrupted"] and report["fingerprint"] == ""
            assert all((place / name).is_file() for name in report["pattern"]["files"])


class TestOutOfMemory:
    """torch's error, with what to do; the last checkpoint stays."""

    @pytest.mark.parametrize(
        ("run", "advice"), [(faults.descended, "memory_budget"), (faults.trained, "use smaller batches")]
    )
    def test_advice(self, run, advice, tmp_path, monkeypatch):
        path, unbroken, calls = str(tmp_path / "run.pt"), run(), []
        rand = torch.rand

        def fail(*arguments, **options):
            calls.append(None)
            if len(calls) == 10:
                raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.")
            return rand(*arguments, **options)

        monkeypatch.setattr(torch, "rand", fail)
        with pytest.raises(torch.OutOfMemoryError, match=f"{advice}.*Tried to allocate 2.00 GiB"):
            run(path)
        monkeypatch.undo()
        assert all(torch.equal(one, other) for one, other in zip(unbroken, run(path), strict=True))


@needs_kill
def test_the_signal_is_the_one_that_cannot_be_caught():
    assert faults.in_a_child(faults.die) and not faults.in_a_child(lambda: os.kill(os.getpid(), signal.SIGCONT))
