"""Compare odak with other libraries: ``python benchmarks/peers [--install] [--folder DIR] [LIBRARY …]``.

With ``--install`` each library is installed from the package index into an environment of its own below DIR; without,
only those already there are measured. All run the same tasks (tasks.py) in processes of their own, one after another,
on two threads. A Markdown table comes out.
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import beams
import numpy

FOLDER = pathlib.Path(__file__).parent
TORCH = "torch==2.13.0"
LIBRARIES = {
    "torchoptics": ("torchoptics==1.0.2", TORCH),
    "diffractio": ("diffractio==1.0.0",),
    "prysm": ("prysm==0.21.1",),
    "LightPipes": ("LightPipes==2.1.5",),
    "optiland": ("optiland[torch]==0.6.3", TORCH),
}


def main() -> None:
    """Run the requested measurements and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("libraries", nargs="*", metavar="LIBRARY", default=list(LIBRARIES), help=", ".join(LIBRARIES))
    parser.add_argument("--install", action="store_true", help="install them from the package index (about 6 GB)")
    parser.add_argument("--folder", type=pathlib.Path, default=pathlib.Path("output/peers"))
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.libraries) - set(LIBRARIES)):
        parser.error(f"LIBRARY must be of {', '.join(LIBRARIES)}; got {', '.join(unknown)}")
    with tempfile.TemporaryDirectory() as scratch:
        truth = pathlib.Path(scratch) / "truth.npy"
        numpy.save(truth, beams.truth(beams.TIGHT))
        found = {"odak": measured("odak", sys.executable, truth)}
        for library in arguments.libraries:
            python = arguments.folder / library / "bin" / "python"
            if arguments.install and not python.exists():
                install(library, python)
            if python.exists():
                found[library] = measured(library, str(python), truth)
    spots = [rays["rms"] for one in found.values() for rays in one.get("rays", {}).values()]
    if not numpy.allclose(spots, spots[0], rtol=1e-6):
        raise SystemExit(f"the libraries did not trace the same lens: spots of {spots} mm")
    print(table(found))


def install(library: str, python: pathlib.Path) -> None:
    """Make an environment with one library in it."""
    subprocess.run([sys.executable, "-m", "venv", str(python.parents[1])], check=True)
    subprocess.run([str(python), "-m", "pip", "install", "-q", *LIBRARIES[library]], check=True)


def measured(library: str, python: str, truth: pathlib.Path) -> dict:
    """Run the tasks of one library in its environment."""
    environment = {**os.environ, "OMP_NUM_THREADS": "2", "PYTHONPATH": str(FOLDER.parents[1])}
    if library != "odak":
        environment.pop("PYTHONPATH")
    run = [python, str(FOLDER / "tasks.py"), library, str(truth)]
    done = subprocess.run(run, stdout=subprocess.PIPE, text=True, env=environment, check=True)
    return json.loads(done.stdout.splitlines()[-1]) | {"import": import_time(library, python, environment)}


def import_time(library: str, python: str, environment: dict) -> float:
    """Return the best of three times to start Python and import a library, of odak the part that the tasks use."""
    used = "odak.learn.wave.propagation" if library == "odak" else library
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        subprocess.run([python, "-c", f"import {used}"], check=True, env=environment, capture_output=True)
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def table(found: dict) -> str:
    """Return what was measured as Markdown."""
    lines = [
        "| library, call | import | propagation | its memory | its error | gradient by distance | rays |",
        "|---|---|---|---|---|---|---|",
    ]
    for library, one in found.items():
        name = "odak" if library == "odak" else LIBRARIES[library][0].replace("==", " ").replace("[torch]", "")
        slope = f"error {one['slope']:.0e}" if "slope" in one else "no autograd"
        for i, (call, wave) in enumerate(one.get("waves", {}).items()):
            start = f"{one['import']:.1f} s" if not i else ""
            rays = _rate(one["rays"]["torch"]) if "rays" in one and not i else "—" if not i else ""
            memory = "" if i else f"{wave['bytes'] / 2**20:.0f} MiB"
            cells = [f"{wave['seconds'] * 1e3:.0f} ms", memory, f"{wave['error']:.0e}"]
            lines.append(_row(f"{name}, {call}", start, *cells, "" if i else slope, rays))
        if "waves" not in one:
            for i, (backend, rays) in enumerate(one["rays"].items()):
                start = f"{one['import']:.1f} s" if not i else ""
                lines.append(_row(f"{name}, {backend}", start, "—", "—", "—", "—", _rate(rays)))
    return "\n".join(lines)


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _rate(rays: dict) -> str:
    return f"{1 / rays['seconds']:.1f} M/s"


if __name__ == "__main__":
    main()
