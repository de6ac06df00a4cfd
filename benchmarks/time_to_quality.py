"""Time and iterations of hologram optimizers to given qualities, in steps of plain Adam.

The photograph that ships with odak, 8 µm, 532 nm, 0.15 m (half of it for half the side of 512 pixels), brightness free.
The quality of each hologram at the end is judged by an angular spectrum in complex128 on a grid of four times its
width.
"""

import math
import os
import time
from collections.abc import Iterator
from importlib.resources import files

import numpy as np
import torch

from odak.learn.tools import load_image
from odak.learn.wave import gerchberg_saxton, intensity, propagate_beam, stochastic_gradient_descent

WAVELENGTH, PITCH = 532e-9, 8e-6
PANEL = (1080, 1920)
# Quality in dB and, for the recommended run on a panel, the time that it may take in steps of plain Adam.
QUALITIES = {30.0: None, 35.0: 60, 40.0: 120}
MOST = 200
RECOMMENDED = "L-BFGS, gs"
# Name, start, solver and further options; a step of the first is the unit of time.
RUNS = {
    "Adam, flat": {"initial_phase": "flat"},
    "Adam, quadratic": {"initial_phase": "quadratic"},
    "Adam, double phase": {"initial_phase": "double phase"},
    "Adam, gs": {"initial_phase": "gs"},
    "L-BFGS, flat": {"initial_phase": "flat", "optimizer": "lbfgs"},
    "L-BFGS, quadratic": {"initial_phase": "quadratic", "optimizer": "lbfgs"},
    "L-BFGS, double phase": {"initial_phase": "double phase", "optimizer": "lbfgs"},
    RECOMMENDED: {"initial_phase": "gs", "optimizer": "lbfgs"},
    "Adam, double phase, 4 frames": {"initial_phase": "double phase", "frames": 4},
    "L-BFGS, quadratic, 4 frames": {"initial_phase": "quadratic", "frames": 4, "optimizer": "lbfgs"},
}


def shape_of_run() -> tuple[int, int]:
    """Return the rows and columns that the environment asks for: "512" or "1080x1920"."""
    sides = [int(side) for side in os.environ.get("TIME_TO_QUALITY_SIDE", "256").split("x")]
    return sides[0], sides[-1]


def distance_of(shape) -> float:
    """Return the distance in metres."""
    return 0.15 * min(1, min(shape) / 512)


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
    transfer = np.exp(2j * np.pi * distance_of(target.shape) * np.sqrt(1 / WAVELENGTH**2 - fy**2 - fx**2))
    light = sum(
        abs(np.fft.ifft2(np.fft.fft2(field, shape) * transfer)[:rows, :columns]) ** 2
        for field in fields.reshape(-1, rows, columns)
    )
    light *= (light * target).sum() / (light**2).sum()
    return float(-10 * np.log10(((light - target) ** 2).mean()))


def psnr(light, target) -> float:
    """Return the PSNR in dB at the best brightness."""
    scale = (light * target).sum() / (light * light).sum()
    return float(-10 * torch.log10((scale * light - target).square().mean()))


def run(target, options, highest: float) -> tuple[list, float]:
    """Return (dB, seconds, iterations) at each iteration, and the exact quality at the end."""
    trace, clock = [], time.process_time if target.device.type == "cpu" else time.perf_counter

    def watch(iteration, loss):
        # The loss is that before the step.
        decibels = -10 * math.log10(float(loss))
        trace.append((decibels, clock() - start, iteration))
        return decibels >= highest

    start = clock()
    hologram, _ = stochastic_gradient_descent(
        target, WAVELENGTH, distance_of(target.shape), PITCH, n_iteration=MOST, learning_rate=0.2, scale=True, seed=0,
        progress=False, callback=watch, **options,
    )  # fmt: skip
    return trace, judged(hologram, target)


def projected(target, options, highest: float) -> tuple[list, float]:
    """Return the same of Gerchberg–Saxton from the quadratic phase; what its quality takes to measure is left out."""
    trace, clock = [], time.process_time if target.device.type == "cpu" else time.perf_counter
    lengths = {"distance": distance_of(target.shape), "dx": PITCH, "wavelength": WAVELENGTH}
    bends = [math.pi / (4 * n) * (torch.arange(n, device=target.device) - n // 2) ** 2 for n in target.shape]

    def watch(iteration, phase):
        nonlocal start
        now = clock()
        image = propagate_beam(torch.exp(1j * phase), None, **lengths)
        trace.append((psnr(intensity(image), target), now - start, iteration + 1))
        start += clock() - now
        return trace[-1][0] >= highest

    start = clock()
    hologram, _ = gerchberg_saxton(
        target.sqrt(), MOST, **lengths, slm_range=2 * math.pi, propagation_type="Bandlimited Angular Spectrum",
        initial_phase=bends[0][:, None] + bends[1], callback=watch, **options,
    )  # fmt: skip
    return trace, judged(hologram, target)


def times(device: str) -> Iterator[dict]:
    """Yield the processor time to each quality, in steps of plain Adam."""
    shape = shape_of_run()
    target, step = photograph(shape).to(device), None
    # What the first call loads and builds is no part of a step.
    run(target, RUNS["Adam, flat"], 0.0)
    runs = [(name, run, options) for name, options in RUNS.items()]
    runs += [(f"Gerchberg-Saxton{', accelerated' * on}", projected, {"accelerated": on}) for on in (False, True)]
    for name, function, options in runs:
        trace, quality = function(target, options, max(QUALITIES))
        if step is None:
            step = (trace[-1][1] - trace[0][1]) / (len(trace) - 1)
        for wanted, bound in QUALITIES.items():
            reached = next(((seconds, count) for decibels, seconds, count in trace if decibels >= wanted), None)
            seconds, count = reached or (math.nan, f"not in {MOST}")
            yield {
                "task": f"{shape[0]} × {shape[1]}, {name}: {wanted:.0f} dB, {count} iterations, "
                f"exact end {quality:.1f} dB",
                "ours_s": seconds,
                "floor_s": step,
                "floor": "step of Adam",
                "ratio": seconds / step,
                "bound": bound if name == RECOMMENDED and shape == PANEL else None,
            }


ALL = (times,)
