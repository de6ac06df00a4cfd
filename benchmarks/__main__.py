"""Run the benchmarks and print a table: ``python benchmarks [GROUP …] [--device cuda] [--json FILE]``.

A group is a module of this folder that has a tuple ``ALL``; all of them by default.

Each row is a task, our time, the floor it is held against, measured in the same run, and their ratio.
"""

import argparse
import importlib
import json
import pathlib
import platform
import sys

import torch

FOLDER = pathlib.Path(__file__).parent
GROUPS = sorted(path.stem for path in FOLDER.glob("[a-z]*.py") if path.stem != "measure")
sys.path.insert(0, str(FOLDER))


def main() -> int:
    """Run the benchmarks asked for; return 1 if a ratio is above its bound."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=", ".join(GROUPS))
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"])
    parser.add_argument("--json", type=pathlib.Path, help="file to write the rows to")
    parser.add_argument("--threads", type=int, default=2, help="CPU threads, for us and for the floor")
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.groups) - set(GROUPS)):
        parser.error(f"GROUP must be of {', '.join(GROUPS)}; got {', '.join(unknown)}")
    torch.set_num_threads(arguments.threads)
    rows = []
    print(f"{'task':52} {'ours':>10} {'floor':>18} {'ratio':>7} {'bound':>6}")
    for group in arguments.groups or GROUPS:
        for benchmark in importlib.import_module(group).ALL:
            for row in benchmark(arguments.device):
                rows.append(row)
                print(_line(row), flush=True)
    if arguments.json:
        about = {"device": arguments.device, "threads": arguments.threads, "torch": torch.__version__}
        arguments.json.write_text(json.dumps({**about, "machine": platform.processor(), "rows": rows}, indent=2) + "\n")
    return int(any(row["bound"] is not None and row["ratio"] > row["bound"] for row in rows))


def _line(row: dict) -> str:
    ours = f"{row['ours_s'] * 1e3:.1f} ms" if "ours_s" in row else f"{row['ours_arrays']:.2f}"
    floor = f"{row['floor_s'] * 1e3:.1f} ms {row['floor']}" if "floor_s" in row else row["floor"]
    bound = "" if row["bound"] is None else f"{row['bound']:.1f}"
    return f"{row['task']:52} {ours:>10} {floor:>18} {row['ratio']:7.2f} {bound:>6}"


if __name__ == "__main__":
    sys.exit(main())
