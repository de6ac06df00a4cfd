"""How the benchmarks measure: best and median of several runs, and the peak of resident memory.

PyTorch is imported for CUDA only, since the environments of other libraries need not have it.
"""

import pathlib
import re
import resource
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """Seconds of one task: those of its runs in their order, the best and the median."""

    runs: tuple[float, ...]

    @property
    def best(self) -> float:
        """Return the least of them."""
        return min(self.runs)

    @property
    def median(self) -> float:
        """Return the middle one."""
        return statistics.median(self.runs)


def measure(task: Callable, runs: int = 9, device: str = "cpu") -> Timing:
    """Return the timing of `task` after one run to warm up; CUDA work is waited for."""
    wait = _waiting_for(device)
    task()
    wait()
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        task()
        wait()
        seconds.append(time.perf_counter() - start)
    return Timing(tuple(seconds))


def interleave(tasks: dict[str, Callable], runs: int = 9, device: str = "cpu") -> dict[str, Timing]:
    """Return the timings of several tasks run alternately, so that the load of the machine affects all of them."""
    wait = _waiting_for(device)
    seconds = {name: [] for name in tasks}
    for turn in range(runs + 1):
        for name, task in tasks.items():
            wait()
            start = time.perf_counter()
            task()
            wait()
            if turn:
                seconds[name].append(time.perf_counter() - start)
    return {name: Timing(tuple(values)) for name, values in seconds.items()}


def _waiting_for(device: str) -> Callable:
    """Return a function that waits until the device has done its work."""
    if device != "cuda":
        return lambda: None
    import torch

    return torch.cuda.synchronize


def peak_memory(device: str = "cpu") -> int:
    """Return the peak of memory so far in bytes: resident memory on the CPU, allocated memory on CUDA."""
    if device == "cuda":
        import torch

        return torch.cuda.max_memory_allocated()
    # Linux counts into `ru_maxrss` what the process that started this one held.
    status = pathlib.Path("/proc/self/status")
    if status.exists():
        return 1024 * int(re.search(r"VmHWM:\s*(\d+)", status.read_text())[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
