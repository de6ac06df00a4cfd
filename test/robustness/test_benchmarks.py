"""The history of the benchmarks: what is stored, and what is called slower."""

import json
import runpy
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "__main__.py"


@pytest.fixture(scope="module")
def script():
    return runpy.run_path(str(SCRIPT), run_name="benchmarks")


def run(**ratios):
    rows = [{"task": task, "ratio": ratio} for task, ratio in ratios.items()]
    return {"commit": "abc", "time": "2026-01-01", "device": "cpu", "rows": rows}


def test_what_is_more_than_a_fifth_slower_is_named(script):
    found = script["slower"](run(a=1.3, b=1.1, c=0.5, new=9.0), run(a=1.0, b=1.0, c=1.0, gone=1.0))
    assert found == ["compared with abc of 2026-01-01: 1 of 3 slower", "slower: a: 1.30, 1.00 before"]
    assert script["slower"](run(a=1.0), None) == []


def test_the_last_run_of_the_same_kind_of_device(script, monkeypatch, tmp_path):
    for number, device in enumerate(["cpu", "cpu", "NVIDIA"]):
        (tmp_path / f"{number}.json").write_text(json.dumps({**run(), "device": device, "commit": str(number)}))
    monkeypatch.setitem(script["last_stored"].__globals__, "HISTORY", tmp_path)
    assert script["last_stored"]("cpu")["commit"] == "1"
    assert script["last_stored"]("cuda")["device"] == "NVIDIA"
    about = script["about"]("cpu", 2)
    assert {"time", "commit", "machine", "cores", "torch", "threads"} <= set(about)


@pytest.mark.parametrize("file", sorted((SCRIPT.parent / "history").glob("*.json")), ids=lambda file: file.stem)
def test_stored_runs_can_be_read(file):
    stored = json.loads(file.read_text(encoding="utf-8"))
    assert stored["rows"] and all(row["ratio"] > 0 and row["task"] for row in stored["rows"])
