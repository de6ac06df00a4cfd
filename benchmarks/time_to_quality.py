"""Time and iterations of hologram optimizers to given qualities, against plain Adam from a flat phase.

The photograph that ships with odak, 8 µm, 532 nm, 0.15 m for a side of 512 pixels, brightness free. The quality of each
hologram at the end is judged by an angular spectrum in complex128 on a grid of four times its width.
"""

import math
import os
import time
from collections.abc import Iterator
from importlib.resources import files

import numpy as np
import torch

from odak.learn.tools import load_image
from odak.learn.wave import stochastic_gradient_descent

WAVELENGTH, PITCH = 532e-9, 8e-6
# Distance over the shorter side in pixels.
REACH = 0.15 / 512
QUALITIES = (30.0, 35.0)
MOST = 400
# Name, start, solver and further options; the first is what the others are held against.
RUNS = (
    ("Adam, flat", {"initial_phase": "flat"}),
    ("Adam, quadratic", {"initial_phase": "quadratic"}),
    ("Adam, double phase", {"initial_phase": "double phase"}),
    ("Adam, gs", {"initial_phase": "gs"}),
    ("L-BFGS, flat", {"initial_phase": "flat", "optimizer": "lbfgs"}),
    ("L-BFGS, quadratic", {"initial_phase": "quadratic", "optimizer": "lbfgs"}),
    ("L-BFGS, double phase", {"initial_phase": "double phase", "optimizer": "lbfgs"}),
    ("L-BFGS, gs", {"initial_phase": "gs", "optimizer": "lbfgs"}),
    ("Adam, double phase, 4 frames", {"initial_phase": "double phase", "frames": 4}),
    ("L-BFGS, quadratic, 4 frames", {"initial_phase": "quadratic", "frames": 4, "optimizer": "lbfgs"}),
)


def photograph(shape) -> torch.Tensor:
    """Return the photograph in a shape, as intensities."""
    photo = load_image(str(files("odak") / "assets" / "photo.png")).mean(-1).float()
    return torch.nn.functional.interpolate(photo[None, None], tuple(shape), mode="bicubic", antialias=True)[0, 0].clamp(
        0, 1
    )


def judged(hologram, target, padding: int = 4) -> float:
    """Return the PSNR in dB by an independent propagation in double precision."""
    fields, target = hologram.cpu().numpy().astype(np.complex128), target.cpu().numpy().astype(np.float64)
    rows, columns = target.shape
    shape = (padding * rows, padding * columns)
    fy, fx = np.fft.fftfreq(shape[0], PITCH)[:, None], np.fft.rfftfreq(shape[1], PITCH)
    fx = np.concatenate([fx, -fx[1:-1][::-1]])
    transfer = np.exp(2j * np.pi * REACH * min(target.shape) * np.sqrt(1 / WAVELENGTH**2 - fy**2 - fx**2))
    light = sum(
        abs(np.fft.ifft2(np.fft.fft2(field, shape) * transfer)[:rows, :columns]) ** 2
        for field in fields.reshape(-1, rows, columns)
    )
    light *= (light * target).sum() / (light**2).sum()
    return float(-10 * np.log10(((light - target) ** 2).mean()))


def run(target, options, most: int, highest: float) -> tuple[list, float]:
    """Return (dB, seconds, iterations) at each iteration, and the exact quality at the end."""
    trace, clock = [], time.process_time if target.device.type == "cpu" else time.perf_counter

    def watch(iteration, loss):
        decibels = -10 * math.log10(float(loss))
        trace.append((decibels, clock() - start, iteration))
        return decibels >= highest

    start = clock()
    hologram, _ = stochastic_gradient_descent(
        target, WAVELENGTH, REACH * min(target.shape), PITCH, n_iteration=most, learning_rate=0.2, scale=True, seed=0,
        progress=False, callback=watch, **options,
    )  # fmt: skip
    return trace, judged(hologram, target)


def times(device: str) -> Iterator[dict]:
    """Yield the seconds of processor time to each quality, beside those of Adam from a flat phase."""
    side = int(os.environ.get("TIME_TO_QUALITY_SIDE", "256"))
    target, reference = photograph((side, side)).to(device), {}
    for name, options in RUNS:
        trace, quality = run(target, options, MOST, QUALITIES[-1])
        for wanted in QUALITIES:
            # The loss is that before the step.
            reached = next(((seconds, count) for decibels, seconds, count in trace if decibels >= wanted), None)
            reference.setdefault(wanted, reached)
            seconds, count = reached or (math.nan, f"not in {MOST}")
            first = reference[wanted] or (math.nan, 0)
            yield {
                "task": f"{side}², {name}: {wanted:.0f} dB, {count} iterations, exact end {quality:.1f} dB",
                "ours_s": seconds,
                "floor_s": first[0],
                "floor": RUNS[0][0],
                "ratio": seconds / first[0],
                "bound": None,
            }


ALL = (times,)
