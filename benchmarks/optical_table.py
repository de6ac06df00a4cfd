"""Calibrate a simulated table of 1080 x 1920 pixels: time, captures, patterns and errors for each bit depth.

Run it by ``PYTHONPATH=.:test/helpers python benchmarks/optical_table.py [--lens | --geometries] [BITS …]``; it takes
some minutes for each, and up to half an hour for the widest panels. The table is simulated without the package
(``test/helpers/laboratory.py``), and most of the time is its own, but behind a lens of 150 mm (``--lens``), where
distance and registration have no error here. With ``--geometries`` pitches are 3.74, 6.4 and 8 µm, and distances 50,
100 and 200 mm.
"""

import itertools
import sys
import time
import warnings
from dataclasses import replace

from laboratory import full_panel, table_of

from odak import AccuracyWarning
from odak.instruments import Lens, OpticalTable, calibrate_table

SKIPPED = ("distance", "registration")


def main() -> None:
    """Print a line for each bit depth of the camera, and each pitch and distance."""
    behind_lens = "--lens" in sys.argv
    every = [int(text) for text in sys.argv[1:] if not text.startswith("--")] or [8, 10, 12]
    geometries: list = [None]
    if "--geometries" in sys.argv:
        geometries = list(itertools.product((3.74e-6, 6.4e-6, 8e-6), (0.05, 0.1, 0.2)))
    for geometry, bits in itertools.product(geometries, every):
        table = table_of((1080, 1920), *geometry, bits) if geometry else full_panel(bits, 0.15 if behind_lens else None)
        path = Lens(0.15) if behind_lens else 1.015 * table.distance
        begin = time.process_time()
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always", AccuracyWarning)
            found = calibrate_table(OpticalTable(table.modulator, table.camera, table.wavelength, path))
        found = replace(found, distance=table.distance) if behind_lens else found
        named = table.errors(found).items()
        errors = ", ".join(f"{name} {error:.2g}" for name, error in named if name not in SKIPPED * behind_lens)
        where = f"{1e6 * table.modulator.pitch:g} µm, {1e3 * table.distance:g} mm, "
        print(
            f"{where}{bits} bits: {time.process_time() - begin:.0f} s of CPU time, {table.camera.taken} captures of "
            f"{table.modulator.shown} patterns; errors: {errors}; {len(told)} warnings",
            flush=True,
        )


if __name__ == "__main__":
    main()
