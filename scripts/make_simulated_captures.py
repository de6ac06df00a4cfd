"""Makes odak/assets/simulated_captures.h5: captures of a simulated table with all faults, seed 2026.

    python scripts/make_simulated_captures.py [FILE]

The hidden properties are those of ``table()`` below, so that whoever reads the file can compare.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

import odak
from odak.instruments import SimulatedTable, measure_dark, record_captures, save_captures, set_exposure

SHAPE, CAMERA, DISTANCE = (40, 40), (64, 64), 3.5e-3
FILE = Path(odak.__file__).parent / "assets" / "simulated_captures.h5"


def table() -> SimulatedTable:
    """Return the table of the captures."""
    faults = {"samples_per_pixel": 1, "fill_factor": 1.0, "iris": None, "fringing": 0.4, "aberration": 0.15, "dust": 2}
    return SimulatedTable.realistic(2026, shape=SHAPE, distance=DISTANCE, camera_shape=CAMERA, **faults)


def patterns(count: int) -> np.ndarray:
    """Return random patterns of levels, some of them smooth."""
    random = np.random.default_rng(0)
    surfaces = [gaussian_filter(random.normal(size=SHAPE), (0.8, 1.2, 2.0)[k % 3]) for k in range(count)]
    return np.array([np.mod(np.rint(128 + 80 * s / s.std()), 256) for s in surfaces]).astype(np.uint8)


def main(path: Path = FILE) -> None:
    """Write the file."""
    there, levels = table(), patterns(10)
    there.modulator.show(levels[2])
    set_exposure(there.camera)
    dark = float(measure_dark(there.camera, there.laser).mean())
    save_captures(path, record_captures(there.modulator, there.camera, levels, 532e-9, captures=2, dark=dark))
    sys.stdout.write(f"{path}: {path.stat().st_size / 1000:.0f} kB\n")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
