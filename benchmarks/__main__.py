"""Run the benchmarks and print a table: ``python benchmarks [GROUP …] [--device cuda] [--tests] [--store]``.

A group is a module of this folder that has a tuple ``ALL``; all of them by default.

Each row is a task, our time, the floor it is held against, measured in the same run, and their ratio. ``--store`` keeps
the run in ``benchmarks/history``; each run is compared with the last one stored for the same kind of device there.
``--device cuda --tests`` runs the tests that need a GPU first, and writes their results into the same JSON.
"""

import argparse
import datetime
import importlib
import json
import os
import pathlib
import platform
import subprocess
import sys
import tempfile
import traceback
import xml.etree.ElementTree as ElementTree

import torch

FOLDER = pathlib.Path(__file__).parent
HISTORY = FOLDER / "history"
# A ratio of two times of one run; what differs by less is noise.
NOTEWORTHY = 1.2
# Standalone scripts, which print other tables, have no such tuple.
GROUPS = sorted(path.stem for path in FOLDER.glob("[a-z]*.py") if "\nALL = " in path.read_text(encoding="utf-8"))
sys.path.insert(0, str(FOLDER))


def main() -> int:
    """Run the requested benchmarks; return 1 if one fails or a ratio is above its bound."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=", ".join(GROUPS))
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"])
    parser.add_argument("--tests", action="store_true", help="run the tests marked cuda first; needs --device cuda")
    parser.add_argument("--json", type=pathlib.Path, help="file to write the rows to")
    parser.add_argument("--store", action="store_true", help=f"keep the run in {HISTORY.relative_to(FOLDER.parent)}")
    parser.add_argument("--threads", type=int, default=2, help="CPU threads, for us and for the floor")
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.groups) - set(GROUPS)):
        parser.error(f"GROUP must be of {', '.join(GROUPS)}; got {', '.join(unknown)}")
    if arguments.device == "cuda" and not torch.cuda.is_available():
        parser.error("--device cuda needs a CUDA device, and torch finds none on this machine")
    if arguments.tests and arguments.device != "cuda":
        parser.error("--tests needs --device cuda: without a GPU these tests are skipped")
    torch.set_num_threads(arguments.threads)
    # In a process of their own, whose memory on the GPU is free again before anything is measured.
    tests = tested([str(FOLDER.parent / "test"), "-m", "cuda"]) if arguments.tests else None
    if tests is not None:
        print(f"tests: {tests['passed']} passed, {len(tests['failed'])} failed, {tests['skipped']} skipped", flush=True)
        print("".join(f"failed: {name}: {message}\n" for name, message in tests["failed"].items()), end="", flush=True)
    rows, failed = [], {}
    print(f"{'task':52} {'ours':>10} {'floor':>18} {'ratio':>7} {'bound':>6}")
    for group in arguments.groups or GROUPS:
        for benchmark in importlib.import_module(group).ALL:
            try:
                for row in benchmark(arguments.device):
                    rows.append(row)
                    print(_line(row), flush=True)
            except Exception as error:
                # The rows of the others, which take half an hour, are not lost with it.
                traceback.print_exc()
                failed[f"{group}.{benchmark.__name__}"] = f"{type(error).__name__}: {error}"
    run = {**about(arguments.device, arguments.threads), "rows": rows, "failed": failed}
    print("".join(f"failed: {name}: {message}\n" for name, message in failed.items()), end="", flush=True)
    if tests is not None:
        run["tests"] = tests
    text = json.dumps(run, indent=1) + "\n"
    if arguments.json:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(text, encoding="utf-8")
    for line in slower(run, last_stored(arguments.device)):
        print(line)
    if arguments.store:
        HISTORY.mkdir(exist_ok=True)
        stored = HISTORY / f"{run['time'].replace(':', '')}-{run['commit']}.json"
        stored.write_text(text, encoding="utf-8")
        print(
            f"stored in {stored.relative_to(FOLDER.parent)}; now run: python docs/make_pictures.py docs/notes/speed.md"
        )
    slow = any(row["bound"] is not None and row["ratio"] > row["bound"] for row in rows)
    # Tests that did not run show nothing either.
    return int(slow or bool(failed) or (tests is not None and (bool(tests["failed"]) or not tests["passed"])))


def tested(arguments: list[str]) -> dict:
    """Run pytest and return how many tests passed and were skipped, and the failed ones with their messages."""
    with tempfile.TemporaryDirectory() as folder:
        report = pathlib.Path(folder) / "report.xml"
        # What an assertion compared belongs to the message, whatever PYTEST_ADDOPTS asks for.
        command = [sys.executable, "-m", "pytest", "-q", "--assert=rewrite", "-p", "no:cacheprovider"]
        command += [f"--junitxml={report}", *arguments]
        run = subprocess.run(command, cwd=FOLDER.parent, capture_output=True, text=True)
        if not report.exists():
            return {"passed": 0, "skipped": 0, "failed": {"pytest": (run.stdout + run.stderr)[-2000:]}}
        cases = list(ElementTree.parse(report).iter("testcase"))
    failed, skipped = {}, 0
    for case in cases:
        broken = [part for part in case if part.tag in ("failure", "error")]
        if broken:
            failed[f"{case.get('classname')}::{case.get('name')}"] = (broken[0].get("message") or "")[:400]
        skipped += any(part.tag == "skipped" for part in case)
    return {"passed": len(cases) - len(failed) - skipped, "skipped": skipped, "failed": failed}


def about(device: str, threads: int) -> dict:
    """Return when, on what and with what a run was made."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=FOLDER, capture_output=True, text=True)
    import numpy

    return {
        "time": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds").removesuffix("+00:00"),
        "commit": commit.stdout.strip() or "unknown",
        "device": torch.cuda.get_device_name() if device == "cuda" else device,
        "machine": _processor(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "threads": threads,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": numpy.__version__,
    }


def _processor() -> str:
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def last_stored(device: str) -> dict | None:
    """Return the last run stored for a kind of device, with rows of earlier ones that it lacks; None without any."""
    last = None
    for file in sorted(HISTORY.glob("*.json"), reverse=True):
        run = json.loads(file.read_text(encoding="utf-8"))
        if (run["device"] == "cpu") != (device == "cpu"):
            continue
        if last is None:
            last = run
        held = set(map(_name, last["rows"]))
        last["rows"] += [row for row in run["rows"] if _name(row) not in held]
    return last


def _name(row: dict) -> tuple[str, str | None]:
    """Return what a row is compared by: a task may have several floors."""
    return row["task"], row.get("floor")


def slower(run: dict, stored: dict | None) -> list[str]:
    """Return a line for each task whose ratio to its floor is more than a fifth above that of a stored run."""
    if stored is None:
        return []
    former = {_name(row): row["ratio"] for row in stored["rows"]}
    found = [(row["task"], row["ratio"], former[_name(row)]) for row in run["rows"] if _name(row) in former]
    lines = [f"slower: {task}: {now:.2f}, {then:.2f} before" for task, now, then in found if now > NOTEWORTHY * then]
    return [f"compared with {stored['commit']} of {stored['time']}: {len(lines)} of {len(found)} slower", *lines]


def _line(row: dict) -> str:
    ours = f"{row['ours_s'] * 1e3:.1f} ms" if "ours_s" in row else f"{row['ours_arrays']:.2f}"
    floor = f"{row['floor_s'] * 1e3:.1f} ms {row['floor']}" if "floor_s" in row else row["floor"]
    bound = "" if row["bound"] is None else f"{row['bound']:.1f}"
    return f"{row['task']:52} {ours:>10} {floor:>18} {row['ratio']:7.2f} {bound:>6}"


if __name__ == "__main__":
    sys.exit(main())
