"""Distribution benchmarks: holograms on two workers, the cost of a task, empty tasks, shared arguments.

The scheduler runs in a process of its own, so that its own work can be told from that of client and workers.
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

import torch
from measure import measure
from wave_optics import row

from odak.learn.wave import stochastic_gradient_descent

HOLOGRAMS, SIDE, ITERATIONS, ROUNDS = 32, 512, 5, 3
EFFICIENCY = 0.85
EMPTY = 10_000
NAP, NAP_OF_MAP, TASKS_OF_MAP = 0.01, 0.03, 200


def hologram(seed: int) -> torch.Tensor:
    """Compute a hologram of 512 × 512."""
    generator = torch.Generator().manual_seed(seed)
    target, phase = torch.rand(2, SIDE, SIDE, generator=generator)
    field, _ = stochastic_gradient_descent(
        target, 532e-9, 0.05, 8e-6, n_iteration=ITERATIONS, initial_phase=phase, progress=False
    )
    return field


def one_thread() -> None:
    """Prepare a process for holograms with one thread, and warm it up."""
    torch.set_num_threads(1)
    hologram(0)


def nothing(*_) -> None:
    """Do nothing."""


@contextmanager
def cluster(workers: int = 2) -> Iterator[tuple[str, "subprocess.Popen"]]:
    """Yield the address of a scheduler with workers of one thread, and the scheduler's process."""
    from odak.manager import start_server

    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / "scheduler.json"
        options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
        command = [sys.executable, "-m", "dask", "scheduler", *options, "--scheduler-file", str(file)]
        scheduler = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            while not (file.exists() and file.read_text()):
                time.sleep(0.05)
            address = json.loads(file.read_text())["address"]
            with start_server(address, workers=workers, threads=1):
                yield address, scheduler
        finally:
            scheduler.terminate()
            scheduler.wait()


def efficiency(device: str) -> Iterator[dict]:
    """Yield 32 holograms on two workers against half the serial time, and against two processes without Dask.

    Also the processor time of all programs together against that of the serial run: a machine that is busy with other
    things distorts it less.
    """
    from odak.manager import agent

    if device != "cpu":
        return
    threads = torch.get_num_threads()
    pool = ProcessPoolExecutor(2, mp_context=get_context("spawn"), initializer=one_thread)
    with cluster() as (address, scheduler), agent(hologram, address, verbose=False) as work, pool:
        for seed in range(HOLOGRAMS):
            work.submit((seed,))
        one_thread()
        work.connect()
        tasks = {
            "serial": lambda: [hologram(seed) for seed in range(HOLOGRAMS)],
            "pool": lambda: list(pool.map(hologram, range(HOLOGRAMS))),
            "spread": work.run,
        }
        rounds = []
        for name in ("pool", "spread"):
            tasks[name]()
        for _ in range(ROUNDS):
            busy = {}
            for name, task in tasks.items():
                before, start = _busy(work.client, scheduler), time.perf_counter()
                task()
                busy[name] = time.perf_counter() - start, _busy(work.client, scheduler) - before
            rounds.append(busy)
    torch.set_num_threads(threads)
    best = {name: min(turn[name][0] for turn in rounds) for name in tasks}
    used = {name: min(turn[name][1] for turn in rounds) for name in tasks}
    name = "32 holograms 512², two workers"
    yield row(name, best["spread"], best["serial"] / 2, "serial / 2", 1 / EFFICIENCY)
    yield row(name, best["spread"], best["pool"], "bare processes", None)
    yield row(f"{name}, processor time", used["spread"], used["serial"], "serial", 1 / EFFICIENCY)


def _busy(client, scheduler) -> float:
    """Return the processor time that client, scheduler and workers have used so far."""
    import psutil

    workers = client.run(time.process_time).values()
    return time.process_time() + sum(psutil.Process(scheduler.pid).cpu_times()[:2]) + sum(workers)


def overhead(device: str) -> Iterator[dict]:
    """Yield the overhead of a task, many together and one alone, against the bound of 20 ms."""
    from odak.manager import agent

    with cluster() as (address, _):
        with agent(time.sleep, address, verbose=False) as work:
            for _ in range(400):
                work.submit((NAP,))
            together = measure(work.run, 3).best * 2 / 400 - NAP
        with agent(nothing, address, verbose=False) as work:
            work.submit(())
            alone = measure(work.run, 50).best
    yield row("a task among 400 of 10 ms, beyond its own time", together, 0.02, "20 ms", 1.0)
    yield row("a task alone, there and back", alone, 0.02, "20 ms", 1.0)


def empty(device: str) -> Iterator[dict]:
    """Yield ten thousand empty tasks, alone and a hundred together, against Dask's own map."""
    import distributed
    import psutil

    from odak.manager import agent

    with cluster() as (address, scheduler):
        process = psutil.Process(scheduler.pid)

        def timed(task) -> tuple[float, float]:
            before, start = sum(process.cpu_times()[:2]), time.perf_counter()
            task()
            return time.perf_counter() - start, sum(process.cpu_times()[:2]) - before

        with distributed.Client(address, set_as_default=False) as client:
            client.gather(client.map(str, range(10), pure=False))
            floor, _ = timed(lambda: client.gather(client.map(str, range(EMPTY), pure=False)))
        for chunk in (1, 100):
            with agent(nothing, address, chunk=chunk, verbose=False) as work:
                for index in range(EMPTY):
                    work.submit((index,))
                work.connect()
                seconds, busy = timed(work.run)
            name = f"{EMPTY} empty tasks" + (f", {chunk} together" if chunk > 1 else "")
            share = {"tasks_per_s": EMPTY / seconds, "scheduler_s_per_task": busy / EMPTY}
            print(f"  {name}: {EMPTY / seconds:.0f} tasks/s, scheduler busy {busy / EMPTY * 1e6:.0f} µs per task")
            yield row(name, seconds, floor, "bare Dask map", None, **share)


def shared(device: str) -> Iterator[dict]:
    """Yield 200 tasks with one tensor of 4 MB in common: by `map`, submitted one by one, and by Dask's own map.

    Dask's map gets the tensor scattered to all workers beforehand, which is the best that can be done with it by hand;
    sending it is part of the time in all three.
    """
    import distributed

    from odak.manager import agent

    # Defined here, it is sent as code, because Dask's scheduler cannot import this file.
    def nap_beside(_, picture: torch.Tensor) -> float:
        time.sleep(NAP_OF_MAP)
        return float(picture[0, 0])

    picture = torch.ones(1024, 1024)
    with cluster() as (address, _), distributed.Client(address, set_as_default=False) as client:

        def by_dask() -> None:
            there = client.scatter(picture, broadcast=True)
            client.gather(client.map(nap_beside, range(TASKS_OF_MAP), picture=there, pure=False))

        with agent(nap_beside, address, verbose=False) as work:
            for index in range(TASKS_OF_MAP):
                work.submit((index, picture))
            work.connect()
            tasks = {
                "map": lambda: work.map(nap_beside, range(TASKS_OF_MAP), shared={"picture": picture}),
                "dask": by_dask,
                "submitted": work.run,
            }
            for task in tasks.values():
                task()
            rounds = []
            for _ in range(ROUNDS):
                seconds = {}
                for name, task in tasks.items():
                    start = time.perf_counter()
                    task()
                    seconds[name] = time.perf_counter() - start
                rounds.append(seconds)
    best = {name: min(turn[name] for turn in rounds) for name in tasks}
    ideal = TASKS_OF_MAP * NAP_OF_MAP / 2
    print("  efficiency: " + ", ".join(f"{name} {ideal / value:.2f}" for name, value in best.items()))
    yield row("200 tasks of 30 ms with 4 MB in common", best["map"], best["dask"], "Dask's map", 1.1)
    yield row("200 tasks of 30 ms with 4 MB in common", best["map"], best["submitted"], "submitted one by one", None)


ALL = (efficiency, overhead, empty, shared)
