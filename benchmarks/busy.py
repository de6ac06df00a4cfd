"""Benchmarks beside busy processes: a step of gradient descent against as many bare transforms, the cores contended.

A transform that is shared out among threads waits for the slowest of them; beside other processes that is one whose
core is taken.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from measure import interleave
from wave_optics import DISTANCE, PADDED, PITCH, SHAPE, WAVELENGTH, row

from odak.learn import wave

PROCESSES = (0, 1, 2, 4)
STEPS = 4


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
            timings = interleave({"fft": bare, "ours": ours}, 3, device)
        # The median: how the cores are shared differs from run to run.
        seconds = {name: timing.median / STEPS for name, timing in timings.items()}
        name = f"gradient descent, one iteration, beside {count} busy processes"
        yield row(name, seconds["ours"], seconds["fft"], "4 fft2", 1.0 if count else 0.9)


ALL = (steps,)
