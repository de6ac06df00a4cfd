"""Holograms of few bits and frames, rounded and searched for: ``python benchmarks/quantised_frames.py [SIZE [BITS]]``.

SIZE is a side in pixels, 128 unless given, or rows and columns as in ``1080x1920``, and BITS those of the panels,
``1,2,3,4`` unless given. The photograph that ships with odak, 8 µm, 532 nm. Panels of less than 1080 rows show one and
four frames at 5 mm, for a registered camera and for one at any place, after 150 iterations of each solver. Larger ones
show one frame at 10 mm for a camera at any place, after 60 iterations of the search, whose gain over the rounded phases
that it begins with is printed. The judge of the display states the quality for the camera that the patterns are found
for. The time is that of the processor during the search and its judge; the memory is the most that this process held.
"""

import resource
import sys
import time
import warnings

from time_to_quality import PITCH, WAVELENGTH, photograph

from odak import AccuracyWarning
from odak.learn.wave import Display, Modulator, Observer, Run, optimise

# Rows from which a panel is one of full size.
LARGE = 1080
OBSERVERS = {"any place": Observer.camera(), "registered": Observer.camera(registered=True)}


def shown(shape, bits: int, frames: int, observer: Observer) -> str:
    """Return the quality of searched patterns in words, beside rounded ones, and the processor time."""
    large = shape[0] >= LARGE
    display = Display(Modulator(shape, PITCH, bits), WAVELENGTH, 10e-3 if large else 5e-3, frames=frames)
    run, target, words = Run(60 if large else 150, progress=False), photograph(shape), ""
    if not large:
        with warnings.catch_warnings():
            # That rounding costs much is what is shown here.
            warnings.simplefilter("ignore", AccuracyWarning)
            words = f"{float(optimise(display, target, solver='lbfgs', run=run, observer=observer).psnr):.1f} -> "
    start = time.process_time()
    found = optimise(display, target, solver="levels", run=run, observer=observer)
    gain, seconds = float(found.gain_over_rounding), time.process_time() - start
    return f"{words}{float(found.psnr):.1f} dB, {gain:.1f} dB above its start, {seconds:.0f} s"


if __name__ == "__main__":
    sides = [int(side) for side in (sys.argv[1] if len(sys.argv) > 1 else "128").split("x")]
    shape = sides[0], sides[-1]
    for frames in (1,) if shape[0] >= LARGE else (1, 4):
        for bits in map(int, (sys.argv[2] if len(sys.argv) > 2 else "1,2,3,4").split(",")):
            names = list(OBSERVERS)[: 1 if shape[0] >= LARGE else 2]
            cells = [f"{name}: {shown(shape, bits, frames, OBSERVERS[name])}" for name in names]
            most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            print(f"bits {bits}, frames {frames}: {'; '.join(cells)}; {most:.1f} GiB", flush=True)
