"""Prints how long the steps of `.ci/run` and the files of tests took, as tables for docs/notes/testing.md.

    python scripts/durations.py [folder]

Reads what `.ci/run` leaves in `.cache/ci`: the time at which each step began, and the durations of each kind of tests.
"""

import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

FOLDER = Path(__file__).resolve().parents[1] / ".cache" / "ci"


def steps(folder: Path) -> list[tuple[str, float]]:
    """Return the steps of a run with their durations in seconds."""
    begun = [line.split("\t", 1) for line in (folder / "steps.tsv").read_text(encoding="utf-8").splitlines()]
    times = [float(time) for time, _ in begun]
    return [(name, after - before) for (_, name), before, after in zip(begun[:-1], times[:-1], times[1:], strict=True)]


def files(report: Path) -> tuple[Counter, Counter]:
    """Return the seconds and the number of tests of each file in a report of pytest."""
    seconds, count = Counter(), Counter()
    for case in ElementTree.parse(report).iter("testcase"):
        parts = case.get("classname", "").split(".")
        name = "/".join(part for part in parts if not part[:1].isupper()) + ".py"
        seconds[name] += float(case.get("time", 0))
        count[name] += 1
    return seconds, count


def table(head: tuple[str, ...], rows: list[tuple]) -> str:
    """Return rows as a table of Markdown."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def main(folder: Path) -> None:
    """Print the tables."""
    if (folder / "steps.tsv").exists():
        print(table(("step", "seconds"), [(name.split(":")[0], f"{time:.0f}") for name, time in steps(folder)]))
    for report in sorted(folder.glob("*.xml")):
        seconds, count = files(report)
        print(f"\n{report.stem}: {sum(count.values())} tests, {sum(seconds.values()):.0f} s of one process\n")
        print(
            table(
                ("file", "tests", "seconds"),
                [(f"`{name}`", count[name], f"{time:.1f}") for name, time in seconds.most_common(20)],
            )
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
