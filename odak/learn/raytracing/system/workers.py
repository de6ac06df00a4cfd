"""Blocks of rays on several threads of this process, each thread doing its own arithmetic alone.

A block is too small for torch to share out among its threads: starting them for each operation costs more than the
operation. So whole blocks are shared out instead.
"""

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

import torch

_lock = threading.Lock()
_pool: tuple[tuple[int, int], ThreadPoolExecutor] | None = None


def each(work: Callable, items: Iterable) -> Iterator:
    """Return what `work` returns for each item, in order, computed without a graph on as many threads as torch has.

    Parameters
    ----------
    work : callable
        Takes the values of one item.
    items : iterable of tuple
        The items.
    """
    items = list(items)
    count = torch.get_num_threads()

    def quiet(item):
        with torch.no_grad():
            return work(*item)

    if count == 1 or len(items) < 2:
        return map(quiet, items)
    return _threads(count).map(quiet, items)


def _threads(count: int) -> ThreadPoolExecutor:
    """Return the pool of this process; a forked child has none of its parent's threads and makes its own."""
    global _pool
    with _lock:
        if _pool is None or _pool[0] != (os.getpid(), count):
            ready = threading.Barrier(count + 1)
            pool = ThreadPoolExecutor(count, thread_name_prefix="odak-rays", initializer=_alone, initargs=(ready,))
            for _ in range(count):
                pool.submit(bool)
            ready.wait()
            # The workers' setting holds for them; what torch shows to everyone else is put back.
            torch.set_num_threads(count)
            _pool = ((os.getpid(), count), pool)
        return _pool[1]


def _alone(ready: threading.Barrier) -> None:
    torch.set_num_threads(1)
    ready.wait()
