"""Benchmarks of scaling: tasks on 2, 4, … and all cores against their time on one core, shared evenly.

A ratio of 1 is perfect scaling; twice that of the bare transforms would mean that the threads wait for each other.
"""

import os
from collections.abc import Callable, Iterator
from itertools import takewhile

import torch
from measure import measure
from wave_optics import DISTANCE, PADDED, PITCH, SHAPE, WAVELENGTH, row

from odak.learn import wave

STEPS, RUNS, ROUNDS = 3, 3, 3


def cores(device: str) -> Iterator[dict]:
    """Yield bare transforms, a propagation and a step of gradient descent for each number of threads; on the CPU."""
    most, former = os.cpu_count() or 1, torch.get_num_threads()
    counts = sorted({*takewhile(lambda count: count < most, (2**power for power in range(12))), most})
    if device != "cpu" or counts == [1]:
        return
    field, padded = (torch.randn(shape, dtype=torch.complex64) for shape in (SHAPE, PADDED))
    target = torch.rand(SHAPE)
    tasks: dict[str, Callable] = {
        "2 bare fft2": lambda: torch.fft.ifft2(torch.fft.fft2(padded)),
        "propagation": lambda: wave.propagate_beam(field, None, DISTANCE, PITCH, WAVELENGTH),
        "gradient descent": lambda: wave.stochastic_gradient_descent(
            target, WAVELENGTH, DISTANCE, PITCH, n_iteration=STEPS, initial_phase=target, progress=False
        ),
    }
    seconds: dict[tuple[str, int], list[float]] = {}
    try:
        # Not task by task in turn: threads and their memory are made anew for each number of them.
        for _ in range(ROUNDS):
            for count in counts:
                torch.set_num_threads(count)
                for name, task in tasks.items():
                    seconds.setdefault((name, count), []).append(measure(task, RUNS).best)
    finally:
        torch.set_num_threads(former)
    for count in counts[1:]:
        for name in tasks:
            alone = min(seconds[name, 1])
            yield row(f"{name}, {count} cores", min(seconds[name, count]), alone / count, f"1 core / {count}", None)


ALL = (cores,)
