"""Quality of holograms of few bits shown in several frames: ``python benchmarks/quantised_frames.py [SIDE]``.

The photograph that ships with odak, 8 µm, 532 nm, 0.15 m for a side of 512 pixels, brightness free, 60 iterations of
Adam for patterns of the given bits. Above two bits the start is that of Gerchberg–Saxton, otherwise random. Each
hologram is judged by an angular spectrum in complex128 on a grid of four times its width.
"""

import sys

from time_to_quality import PITCH, WAVELENGTH, distance_of, judged, photograph

from odak.learn.wave import spatial_light_modulator, stochastic_gradient_descent

BITS, FRAMES = (None, 8, 4, 3, 2, 1), (1, 4, 8)


def quality(target, bits: int | None, frames: int) -> float:
    """Return the PSNR in dB of a hologram of so many bits and frames."""
    slm = None if bits is None else spatial_light_modulator(bits=bits)
    start = "random" if bits is not None and bits < 3 else "gs"
    hologram, _ = stochastic_gradient_descent(
        target, WAVELENGTH, distance_of(target.shape), PITCH, n_iteration=60, learning_rate=0.2, scale=True, seed=0,
        progress=False, initial_phase=start, frames=frames, slm=slm,
    )  # fmt: skip
    return judged(hologram, target)


if __name__ == "__main__":
    side = int(sys.argv[1]) if len(sys.argv) > 1 else 512
    print(f"{side} x {side}  " + "".join(f"{count:4} frames" for count in FRAMES))
    for bits in BITS:
        found = [quality(photograph((side, side)), bits, count) for count in FRAMES]
        print(f"{bits or 'no':>4} bits   " + "".join(f"{value:8.1f} dB" for value in found), flush=True)
