"""Benchmarks beside busy processes: a step of gradient descent against as many bare transforms, the cores contended.

A transform that is shared out among threads waits for the slowest of them; beside other processes that is one whose
core is taken. How the cores are shared differs from run to run by a factor of two: ours and the bare transforms are run
alternately, and the ratio is that of the medians. The ratio of the best runs and the quartiles of the ratios of
neighbouring runs are printed and stored with it.
"""

import statistics
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from measure import interleave
from wave_optics import DISTANCE, PADDED, PITCH, SHAPE, WAVELENGTH, row

from odak.learn import wave

PROCESSES = (0, 1, 2, 4)
STEPS, ROUNDS = 4, 15


@contextmanager
def busy(count: int):
    """Keep so many processes busy."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def steps(device: str) -> Iterator[dict]:
    """Yield one iteration of gradient descent against four bare FFTs, beside none and several busy processes."""
    target = torch.rand(SHAPE, device=device)
    padded = torch.randn(PADDED, dtype=torch.complex64, device=device)

    def bare():
        for _ in range(4 * STEPS):
            torch.fft.fft2(padded)

    def ours():
        wave.stochastic_gradient_descent(
            target, WAVELENGTH, DISTANCE, PITCH, n_iteration=STEPS, initial_phase=torch.zeros_like(target),
            progress=False,
        )  # fmt: skip

    for count in PROCESSES:
        with busy(count):
            timings = interleave({"fft": bare, "ours": ours}, ROUNDS, device)
        floor, mine = timings["fft"], timings["ours"]
        ratios = [one / two for one, two in zip(mine.runs, floor.runs, strict=True)]
        low, _, high = statistics.quantiles(ratios, n=4)
        more = {"best_ratio": mine.best / floor.best, "quartiles": [low, high]}
        print(f"  {ROUNDS} rounds: best {more['best_ratio']:.2f}, quartiles {low:.2f} to {high:.2f}")
        name, bound = f"gradient descent, one iteration, beside {count} busy processes", 1.0 if count else 0.9
        yield row(name, mine.median / STEPS, floor.median / STEPS, "4 fft2", bound, **more)


ALL = (steps,)
