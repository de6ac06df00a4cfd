"""Calibrate a simulated table of 1080 x 1920 pixels: time, captures, patterns and errors for each bit depth.

Run it by ``PYTHONPATH=.:test/helpers python benchmarks/optical_table.py [BITS …]``; it takes some minutes for each. The
table is simulated without the package (``test/helpers/laboratory.py``), and most of the time is its own.
"""

import sys
import time
import warnings

from laboratory import full_panel

from odak import AccuracyWarning
from odak.instruments import calibrate_table


def main() -> None:
    """Print a line for each bit depth of the camera."""
    for bits in [int(text) for text in sys.argv[1:]] or [8, 10, 12]:
        table = full_panel(bits)
        begin = time.process_time()
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always", AccuracyWarning)
            found = calibrate_table(table.modulator, table.camera, table.wavelength, 1.015 * table.distance)
        errors = ", ".join(f"{name} {value:.2g}" for name, value in table.errors(found).items())
        print(
            f"{bits} bits: {time.process_time() - begin:.0f} s of CPU time, {table.camera.taken} captures of "
            f"{table.modulator.shown} patterns; errors: {errors}; {len(told)} warnings",
            flush=True,
        )


if __name__ == "__main__":
    main()
