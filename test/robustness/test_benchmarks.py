"""The history of the benchmarks: stored runs, and the comparison of times."""

import importlib
import json
import runpy
import sys
import types
from pathlib import Path

import documentation
import pytest
import torch
from emulated_device import NAME, EmulatedDevice

import odak

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "__main__.py"


@pytest.fixture(scope="module")
def script():
    return runpy.run_path(str(SCRIPT), run_name="benchmarks")


def run(**ratios):
    rows = [{"task": task, "ratio": ratio} for task, ratio in ratios.items()]
    return {"commit": "abc", "time": "2026-01-01", "device": "cpu", "rows": rows}


def test_groups_are_the_modules_with_benchmarks(script):
    for group in script["GROUPS"]:
        benchmarks = runpy.run_path(str(SCRIPT.parent / f"{group}.py"), run_name=group)["ALL"]
        assert benchmarks and all(map(callable, benchmarks))
    assert {"wave_optics", "rays"} <= set(script["GROUPS"]) and not {"measure", "networks"} & set(script["GROUPS"])


def test_what_is_more_than_a_fifth_slower_is_named(script):
    found = script["slower"](run(a=1.3, b=1.1, c=0.5, new=9.0), run(a=1.0, b=1.0, c=1.0, gone=1.0))
    assert found == ["compared with abc of 2026-01-01: 1 of 3 slower", "slower: a: 1.30, 1.00 before"]
    assert script["slower"](run(a=1.0), None) == []
    floors = [{"task": "a", "floor": floor, "ratio": ratio} for floor, ratio in (("one", 1.0), ("two", 9.0))]
    assert script["slower"]({"rows": floors[:1]}, {**run(), "rows": floors})[0].endswith(": 0 of 1 slower")


def test_the_last_run_of_the_same_kind_of_device(script, monkeypatch, tmp_path):
    for number, device in enumerate(["cpu", "cpu", "NVIDIA"]):
        (tmp_path / f"{number}.json").write_text(json.dumps({**run(), "device": device, "commit": str(number)}))
    monkeypatch.setitem(script["last_stored"].__globals__, "HISTORY", tmp_path)
    assert script["last_stored"]("cpu")["commit"] == "1"
    assert script["last_stored"]("cuda")["device"] == "NVIDIA"
    for number, ratios in ((0, {"a": 1.0, "b": 2.0}), (1, {"b": 3.0})):
        (tmp_path / f"{number}.json").write_text(json.dumps(run(**ratios)))
    assert [(row["task"], row["ratio"]) for row in script["last_stored"]("cpu")["rows"]] == [("b", 3.0), ("a", 1.0)]
    about = script["about"]("cpu", 2)
    assert {"time", "commit", "machine", "cores", "torch", "threads"} <= set(about)


def test_a_benchmark_that_fails_does_not_lose_the_others(script, monkeypatch, tmp_path, capsys):
    def fails(device):
        yield {**row, "task": "before it failed"}
        raise ValueError("no rays")

    row = {"ours_s": 1.0, "floor_s": 1.0, "floor": "itself", "bound": 2.0, "ratio": 1.0}
    module, kept = types.ModuleType("rays"), tmp_path / "rows.json"
    module.ALL = fails, lambda device: [{**row, "task": "another"}]
    monkeypatch.setitem(sys.modules, "rays", module)
    threads = str(torch.get_num_threads())
    monkeypatch.setattr(sys, "argv", ["benchmarks", "rays", "--threads", threads, "--json", str(kept)])
    assert script["main"]() == 1
    found = json.loads(kept.read_text())
    assert [row["task"] for row in found["rows"]] == ["before it failed", "another"]
    assert found["failed"] == {"rays.fails": "ValueError: no rays"}
    assert "failed: rays.fails: ValueError: no rays" in capsys.readouterr().out


def test_runs_are_stored_compared_and_drawn(script, monkeypatch, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    make_pictures = documentation.script("make_pictures")
    names, page = script["main"].__globals__, documentation.ROOT / "docs" / "notes" / "speed.md"
    ratios, times = iter([1.0, 1.5]), iter(["2026-01-01", "2026-01-02"])
    row = {"task": "a task", "ours_s": 1.0, "floor_s": 1.0, "floor": "itself", "bound": 2.0}
    module = types.ModuleType("rays")
    module.ALL = (lambda device: [{**row, "ratio": next(ratios)}],)
    monkeypatch.setitem(sys.modules, "rays", module)
    monkeypatch.setitem(names, "FOLDER", tmp_path / "benchmarks")
    monkeypatch.setitem(names, "HISTORY", tmp_path / "benchmarks" / "history")
    about = {"commit": "abc", "device": "cpu", "machine": "a machine", "threads": 1}
    monkeypatch.setitem(names, "about", lambda *_: {**about, "time": next(times)})
    monkeypatch.setattr(odak, "__file__", str(tmp_path / "odak" / "__init__.py"))
    (tmp_path / "benchmarks").mkdir()
    threads, lines = str(torch.get_num_threads()), []
    for _ in range(3):
        (_, printed), (_, nothing) = make_pictures.run_page(page, tmp_path)
        lines.append(printed.splitlines())
        assert nothing == "" and (tmp_path / "history.png").stat().st_size > 2000
        if len(lines) < 3:
            monkeypatch.setattr(sys, "argv", ["benchmarks", "rays", "--store", "--threads", threads])
            assert script["main"]() == 0
    assert list(map(len, lines)) == [1, 1, 2] and lines[0] == ["none yet"]
    assert lines[2][1] == "2026-01-02  abc  a machine, 1 threads, 1 tasks"
    said = capsys.readouterr().out
    assert "compared with abc of 2026-01-01: 1 of 1 slower\nslower: a task: 1.50, 1.00 before" in said


@pytest.mark.slow
def test_results_of_tests_are_part_of_the_run(script, tmp_path, monkeypatch, capsys):
    """One passes, one fails, one is skipped, one has an error: each is counted as what it is."""
    file = tmp_path / "test_four.py"
    file.write_text(
        "import pytest\n@pytest.fixture\ndef broken(): raise OSError('no')\n"
        "def test_a(): pass\ndef test_b(): assert 1 == 2\ndef test_c(): pytest.skip('x')\ndef test_d(broken): pass\n"
    )
    found = script["tested"](["--rootdir", str(tmp_path), str(file)])
    assert (found["passed"], found["skipped"]) == (1, 1)
    assert {name.rpartition("::")[2]: text for name, text in found["failed"].items()} == {
        "test_b": "assert 1 == 2", "test_d": "failed on setup with \"OSError: no\""
    }  # fmt: skip
    assert "unrecognized arguments: --none" in script["tested"](["--none"])["failed"]["pytest"]
    monkeypatch.setattr(sys, "argv", ["benchmarks", "rays", "--tests"])
    with pytest.raises(SystemExit):
        script["main"]()
    assert "--tests needs --device cuda" in capsys.readouterr().err


@pytest.mark.parametrize("results", [(3, {}, 0), (2, {"a": "wrong"}, 1), (0, {}, 1)])
def test_a_failed_test_or_none_that_ran_fails_the_run(script, tmp_path, monkeypatch, results):
    names, (passed, failed, code) = script["main"].__globals__, results
    row = {"task": "a", "ours_s": 1.0, "floor_s": 1.0, "floor": "itself", "ratio": 1.0, "bound": 2.0}
    module = types.ModuleType("rays")
    module.ALL = (lambda device: [row],)
    monkeypatch.setitem(sys.modules, "rays", module)
    monkeypatch.setitem(names, "tested", lambda given: {"passed": passed, "skipped": 0, "failed": failed})
    monkeypatch.setitem(names, "about", lambda *_: {"commit": "abc", "device": "NVIDIA", "time": "2026-01-01"})
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    file = tmp_path / "run.json"
    arguments = ["benchmarks", "rays", "--device", "cuda", "--tests", "--json", str(file)]
    monkeypatch.setattr(sys, "argv", [*arguments, "--threads", str(torch.get_num_threads())])
    assert script["main"]() == code
    assert json.loads(file.read_text())["tests"]["failed"] == failed


@pytest.mark.parametrize("file", sorted((SCRIPT.parent / "history").glob("*.json")), ids=lambda file: file.stem)
def test_stored_runs_can_be_read(file):
    stored = json.loads(file.read_text(encoding="utf-8"))
    assert stored["rows"] and all(row["ratio"] > 0 and row["task"] for row in stored["rows"])


# Sizes in which each benchmark takes little time, and what the emulation itself can do: not all gradients, since those
# that are not defined become zeros on the device. Memory and import are measured in processes of their own.
ON_A_DEVICE = {
    "wave_optics": (
        {"SHAPE": (40, 60), "PADDED": (80, 120), "SQUARES": (64,), "BATCHES": ((3, 32, 32),)},
        ("impulse_response", "propagation", "sizes", "point_sources", "hologram"),
    ),
    "perception": ({"SIDES": (64,), "PICTURE": (1, 3, 48, 64)}, ("blur", "colour")),
    "rays": ({"COUNT": 100}, ("flat", "curved", "interfaces")),
    "tools": ({"SHAPE": (32, 32), "SPLINES": [8, 8], "POINTS": 100}, ("bspline", "rotation", "sampling")),
    "gaussians": ({"NUMBER": 50, "SIDE": 32}, ("occlusion",)),
    "triangles": ({"RAYS": 200, "TRIANGLES": 200, "MANY": 300}, ("nearest_hits", "dense")),
    "adaptive_convolution": ({"STEPS": [(4, 7, 16, 20)]}, ("convolution",)),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::odak.SamplingWarning")
@pytest.mark.parametrize("group", ON_A_DEVICE)
def test_benchmarks_run_on_a_device(group, monkeypatch):
    """All tensors of a benchmark are made where they are measured: no GPU is needed to know that it runs on one."""
    sizes, names = ON_A_DEVICE[group]
    monkeypatch.syspath_prepend(SCRIPT.parent)
    # Modules that hold what is set below are removed again at the end.
    for name in ("measure", "wave_optics", group):
        monkeypatch.delitem(sys.modules, name, raising=False)
    measure = importlib.import_module("measure")

    def once(task, *_):
        task()
        return measure.Timing((1.0,))

    monkeypatch.setattr(measure, "measure", once)
    monkeypatch.setattr(measure, "interleave", lambda tasks, *_, **__: {name: once(tasks[name]) for name in tasks})
    module = importlib.import_module(group)
    for name, value in sizes.items():
        monkeypatch.setattr(module, name, value)
    for name in names:
        with EmulatedDevice():
            rows = list(getattr(module, name)(NAME))
        assert rows and all(row["ratio"] > 0 for row in rows)
