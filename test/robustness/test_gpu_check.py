"""The check of a GPU, run on the processor and on the emulated device; what takes too long does not end it."""

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "gpu_check.py"


def checked(device, folder, *more):
    """Run the shell script; return its exit status and its report."""
    report = folder / "report.json"
    command = ["bash", str(SCRIPT.with_suffix(".sh")), "--device", device, "--output", str(report), *more]
    done = subprocess.run(command, env={**os.environ, "PYTHON": sys.executable}, capture_output=True, text=True)
    return done.returncode, json.loads(report.read_text(encoding="utf-8")), done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="a shell script")
@pytest.mark.parametrize("device", ["cpu", "emulated"])
def test_all_checks_pass_on_what_is_here(device, tmp_path):
    status, report, said = checked(device, tmp_path)
    assert status == 0 and report["ok"], said
    rows = {name: held["rows"] for name, held in report["checks"].items()}
    assert len(rows["propagation"]) >= 12 and len(rows["displays"]) == 6
    assert all(row["change"] > 0.01 for row in rows["displays"] if "losses" in row["what"])
    assert all(rows[name] for name in ("hologram", "perception", "lens", "scene", "compiled", "tests"))
    # The processor is no device whose numbers are read; a lens trace on a device reads whether a shape is flat.
    counted = [row["reads"] for row in rows["lens"]]
    assert counted == [None] if device == "cpu" else sum(counted[0].values()) >= 1
    assert not any(row["reads"] for row in rows["propagation"])


def test_a_check_that_hangs_or_fails_does_not_lose_the_others(tmp_path, monkeypatch, capsys):
    """A process that waits is ended and begun again with the next check; a difference and an error are told."""
    worker = tmp_path / "worker.py"
    worker.write_text(
        "import json, sys, time\n"
        "first = int(sys.argv[-1])\n"
        "row = {'what': 'a', 'ok': True, 'difference': 0.0, 'seconds': 0.0, 'reads': {}}\n"
        "print(json.dumps({'check': first, 'row': row}), flush=True)\n"
        "if first == 0:\n    time.sleep(600)\n"
        "print('noise')\n"
        "print(json.dumps({'check': first, 'seconds': 0.1}), flush=True)\n"
        "print(json.dumps({'check': first + 1, 'row': {**row, 'ok': False}}), flush=True)\n"
        "print(json.dumps({'check': first + 1, 'error': 'ValueError: no', 'seconds': 0.1}), flush=True)\n"
    )
    script = runpy.run_path(str(SCRIPT), run_name="gpu_check")
    names = script["supervise"].__globals__
    monkeypatch.setitem(names, "__file__", str(worker))
    monkeypatch.setitem(names, "about", lambda device: {"device": device})
    monkeypatch.setitem(names, "CHECKS", script["CHECKS"][:4])
    output = tmp_path / "report.json"
    # The process may take longer than the first limits to start.
    for limit in (0.5, 5.0, 60.0):
        report = script["supervise"]("cpu", 5.0, output, limits=[limit, 60.0, 60.0, 60.0])
        held = list(report["checks"].values())
        if held[0]["rows"]:
            break
    assert held[0]["error"] == "ended: it took too long" and len(held[0]["rows"]) == 1
    assert "error" not in held[1] and held[2]["error"] == "ValueError: no"
    # It gives no sign of the last one.
    assert held[3]["error"] == "the process ended"
    assert json.loads(output.read_text(encoding="utf-8"))["ok"] is False
    assert "FAILED" in capsys.readouterr().out
    late = script["supervise"]("cpu", 0.0, output, limits=[1.0] * 4)
    assert {item["error"] for item in late["checks"].values()} == {"not begun: the time was over"}
