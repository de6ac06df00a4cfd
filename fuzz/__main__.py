"""Break files, give them to the readers, and keep those that a reader neither reads nor refuses by name.

``python fuzz [reader …] --minutes 10 [--seed N]`` runs each reader for so long, one after the other. Finds go to a
folder for each reader; the exit code is 1 if there are any. A process of its own does the work, so that a crash or a
hang is a find like any other.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time

sys.path[0] = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))

from fuzz import guard, mutations  # noqa: E402 - the folder above comes first
from fuzz.readers import READERS  # noqa: E402

WALL = 120.0
RESERVED = 4096


def main() -> int:
    """Run the readers named on the command line, or all."""
    arguments = _arguments()
    if arguments.worker:
        return work(arguments.reader[0], arguments.minutes * 60, arguments.seed, arguments.worker)
    total = 0
    for name in arguments.reader or READERS:
        report = supervise(name, arguments.minutes * 60, arguments.seed, arguments.finds)
        total += len(report["finds"])
        _say(
            f"{name:<11} {report['cases']:>8} cases, {report['read']:>7} of them read, {report['seconds'] / 60:.1f} "
            f"minutes, {report['deaths']} deaths, {len(report['finds'])} kinds of finds"
        )
        for text, file in report["finds"].items():
            _say(f"    {text}\n        {file}")
    return 1 if total else 0


def _arguments():
    parser = argparse.ArgumentParser(prog="python fuzz", description=__doc__.split("\n")[0])
    parser.add_argument("reader", nargs="*", metavar="reader", help=f"of {', '.join(READERS)}; all by default")
    parser.add_argument("--minutes", type=float, default=10.0, help="for each reader")
    parser.add_argument("--seed", type=int, default=0, help="start of the random numbers")
    parser.add_argument("--finds", default="fuzz_finds", help="folder to keep finds in")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.reader) - set(READERS)):
        parser.error(f"no such reader: {', '.join(unknown)}; there are {', '.join(READERS)}")
    return arguments


def supervise(name: str, seconds: float, seed: int, finds: str) -> dict:
    """Run one reader in separate processes until the time is over; return counts and findings."""
    folder = os.path.abspath(os.path.join(finds, name))
    os.makedirs(folder, exist_ok=True)
    total = {"cases": 0, "read": 0, "deaths": 0, "seconds": 0.0, "finds": {}}
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        with tempfile.TemporaryDirectory() as place:
            died = _one_process(name, left, seed + total["deaths"], place)
            with (
                contextlib.suppress(FileNotFoundError),
                open(os.path.join(place, "report.json"), encoding="utf-8") as stream,
            ):
                report = json.load(stream)
                for key in ("cases", "read", "seconds"):
                    total[key] += report[key]
                for text, case in report["finds"].items():
                    total["finds"].setdefault(text, _kept(case, folder))
            if not died:
                break
            total["deaths"] += 1
            total["finds"].setdefault(died, "before the first file was read")
            for case in os.listdir(os.path.join(place, "case")) if os.path.isdir(os.path.join(place, "case")) else ():
                if case.startswith("case."):
                    total["finds"][died] = _kept(os.path.join(place, "case", case), folder)
            if total["deaths"] > 50 or not total["cases"]:
                break
    return total


def _one_process(name, seconds, seed, place):
    """Run a worker; return how it died, or an empty text if it ended well."""
    command = [sys.executable, __file__, name, f"--minutes={seconds / 60}", f"--seed={seed}", f"--worker={place}"]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "HOME": place}
    # Image libraries print what they think of a file.
    said = open(os.path.join(place, "said"), "wb")  # noqa: SIM115 - closed with the process
    with said, subprocess.Popen(command, env=environment, cwd=place, stdin=subprocess.DEVNULL, stderr=said) as process:
        mark = os.path.join(place, "alive")
        started = time.time()
        while process.poll() is None:
            time.sleep(0.2)
            last = os.stat(mark).st_mtime if os.path.exists(mark) else started + 60
            if time.time() - last > WALL:
                process.kill()
                process.wait()
                return f"hung for more than {WALL:g} s"
    if process.returncode == 0:
        return ""
    with open(os.path.join(place, "said"), encoding="utf-8", errors="replace") as stream:
        last = (stream.read().strip().splitlines() or [""])[-1]
    return f"ended the process with code {process.returncode}: {last[:150]}"


def work(name: str, seconds: float, seed: int, place: str) -> int:
    """Go through cases in this process; leave a report after each find and every second."""
    reader, chance = READERS[name], random.Random(seed)
    inside = os.path.join(place, "case")
    os.makedirs(inside)
    seeds = list(reader.seeds(inside))
    for case in seeds:
        # Whatever is imported or built at the first call is there before anybody watches.
        with contextlib.suppress(Exception):
            reader.call(_written(inside, case))
    contents = [content for _, content in seeds]
    # Nothing that a reader imports late may look like a file that it writes.
    sys.dont_write_bytecode = True
    guard.limit_memory(RESERVED)
    guard.reset_peak()
    report = {"cases": 0, "read": 0, "seconds": 0.0, "finds": {}}
    started = saved = time.monotonic()
    while time.monotonic() - started < seconds:
        extension, content = chance.choice(seeds)
        broken = mutations.mutate(content, chance, contents, reader.tokens, reader.structure)
        found, read = judge(reader, inside, (extension, broken))
        report["cases"] += 1
        report["read"] += read
        if found and _kind(found) not in map(_kind, report["finds"]):
            report["finds"][found] = _shrunk(reader, inside, extension, broken, found, place, len(report["finds"]))
        if found or time.monotonic() - saved > 1:
            saved = time.monotonic()
            report["seconds"] = saved - started
            _write(place, report)
            _empty(inside)
    report["seconds"] = time.monotonic() - started
    _write(place, report)
    return 0


def judge(reader, folder: str, case: tuple[str, bytes]) -> tuple[str | None, bool]:
    """Return the violation that a reader committed, or None, and whether it read the file."""
    path = _written(folder, case)
    with open(os.path.join(os.path.dirname(folder), "alive"), "w", encoding="ascii"):
        pass
    names = (os.path.basename(path), "case.") if reader.named else ()
    return guard.breach(lambda: reader.call(path), folder, names, reader.megabytes, reader.seconds)


def _kind(text: str) -> str:
    """Return what two finds share that are the same fault: their words up to the first value."""
    return text.split("'")[0].split('"')[0].rstrip("0123456789 ")[:90]


def _shrunk(reader, inside, extension, content, found, place, number):
    """Keep a find, as small as removing pieces makes it."""
    kept = os.path.join(place, f"find{number}{extension}")
    size, stop = max(1, len(content) // 2), time.monotonic() + 5
    while size and time.monotonic() < stop:
        start = 0
        while start < len(content) and time.monotonic() < stop:
            shorter = content[:start] + content[start + size :]
            text, _ = judge(reader, inside, (extension, shorter))
            if text and _kind(text) == _kind(found):
                content = shorter
            else:
                start += size
        size //= 2
    with open(kept, "wb") as stream:
        stream.write(content)
    return kept


def _written(folder, case):
    extension, content = case
    path = os.path.join(folder, f"case{extension}")
    with open(path, "wb") as stream:
        stream.write(content)
    return path


def _empty(folder):
    for name in os.listdir(folder):
        if not name.startswith("case."):
            path = os.path.join(folder, name)
            shutil.rmtree(path) if os.path.isdir(path) else os.unlink(path)


def _kept(path, folder):
    _, extension = os.path.splitext(os.path.basename(path))
    number = 0
    while os.path.exists(target := os.path.join(folder, f"{number:03}{extension}")):
        number += 1
    shutil.copy(path, target)
    return target


def _write(place, report):
    with open(os.path.join(place, "report.tmp"), "w", encoding="utf-8") as stream:
        json.dump(report, stream)
    os.replace(os.path.join(place, "report.tmp"), os.path.join(place, "report.json"))


def _say(words):
    sys.stdout.write(words + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
