"""Functions that the tests of the manager let workers call."""

import os
import resource
import signal
import sys
import time
from pathlib import Path

import torch
from processes import wait_for

from odak.learn.wave import stochastic_gradient_descent


def hologram(seed, side=64, iterations=10):
    """Return a hologram of a random picture, and the process that computed it."""
    generator = torch.Generator().manual_seed(seed)
    target, phase = torch.rand(2, side, side, generator=generator)
    field, _ = stochastic_gradient_descent(
        target, 532e-9, 1e-3, 8e-6, n_iteration=iterations, initial_phase=phase, progress=False
    )
    return field, os.getpid()


def nap(seconds, value):
    """Return a value after a while, and when it began."""
    start = time.time()
    time.sleep(seconds)
    return value, start


def await_mark(path):
    """Wait for a file to be there."""
    wait_for(Path(path).exists)
    return "marked"


def divide(a, b=1):
    """Divide, which fails for zero."""
    return a / b


def fail_at_first(path):
    """Fail on the first call, leaving a file."""
    path = Path(path)
    if not path.exists():
        path.touch()
        raise RuntimeError("the first time")
    return "the second time"


def exit_quietly(code):
    """Exit with a code, as sys.exit does."""
    sys.exit(code)


def crash(times, path):
    """Kill the process for the first few calls."""
    path = Path(path)
    calls = len(path.read_text()) if path.exists() else 0
    path.write_text("x" * (calls + 1))
    if calls < times:
        os.kill(os.getpid(), signal.SIGKILL)
    return calls


class SelfishError(Exception):
    """Cannot be unpickled: its constructor requires more arguments than are pickled."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


def raise_selfish():
    """Raise an exception that cannot be unpickled."""
    raise SelfishError("one", "two")


def page_faults(megabytes, times):
    """Return how many pages the system had to clear for arrays made and freed one after another."""
    torch.ones(megabytes * 2**18)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(times):
        torch.ones(megabytes * 2**18)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


class Unopenable:
    """Can be pickled and not opened."""

    def __reduce__(self):
        return int, ("not a number",)


def end_process(index, ends):
    """Return a number, or end the process."""
    if ends:
        os._exit(3)
    return index


def stop_at_first(path):
    """Stop the process on the first call, leaving a file."""
    if not Path(path).exists():
        Path(path).touch()
        os.kill(os.getpid(), signal.SIGSTOP)
    return "the second time"


def weighted_sum(weight, picture):
    """Return the sum of a picture times a number."""
    return float((weight * picture).sum())


def threads():
    """Return how many threads torch and OpenMP use here."""
    return torch.get_num_threads(), os.environ["OMP_NUM_THREADS"]


def search_path(_):
    """Return where this process looks for modules."""
    return sys.path
