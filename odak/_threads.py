"""Work on blocks of tensors, shared out among threads."""

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

import torch

_lock = threading.Lock()
_pool: tuple[tuple[int, int], ThreadPoolExecutor] | None = None


def each(work: Callable[..., Any], items: Iterable[Any], parallel: bool = True) -> Iterator[Any]:
    """Return ``work(*item)`` for each item, in order, computed without a graph on as many threads as torch has.

    Torch shares out single operations, each of which waits for all threads: where operations are short, that takes
    longer than they do, and many times longer on a busy machine. Here whole blocks are shared out, one thread each.

    Parameters
    ----------
    work : callable
        Takes the values of one item.
    items : iterable of tuple
        The items.
    parallel : bool
        Whether to share them out.
    """
    items = list(items)
    count, inference = torch.get_num_threads(), torch.is_inference_mode_enabled()

    def quiet(item):
        # Tensors made in inference mode can be written to in that mode only, which belongs to a thread.
        with torch.inference_mode(inference), torch.no_grad():
            return work(*item)

    if not parallel or count == 1 or len(items) < 2:
        return map(quiet, items)
    return _in_order([_threads(count).submit(quiet, item) for item in items])


def _in_order(futures: list[Future]) -> Iterator[Any]:
    """Yield the results; an interrupt leaves none at work, which could write where the next call does."""
    try:
        for future in futures:
            yield future.result()
    finally:
        for future in futures:
            future.cancel()
        wait(futures)


def _threads(count: int) -> ThreadPoolExecutor:
    """Return the pool of this process; a forked child has none of its parent's threads and makes its own."""
    global _pool
    with _lock:
        if _pool is None or _pool[0] != (os.getpid(), count):
            ready = threading.Barrier(count + 1)
            pool = ThreadPoolExecutor(count, thread_name_prefix="odak", initializer=_alone, initargs=(ready,))
            for _ in range(count):
                pool.submit(bool)
            ready.wait()
            # The setting holds for the workers; the setting of the process is restored.
            torch.set_num_threads(count)
            _pool = ((os.getpid(), count), pool)
        return _pool[1]


def _on_one_thread() -> None:
    torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):
    # A forked process has none of the threads of OpenMP, and its first operation on several would wait for them for
    # ever. PyTorch's DataLoader takes one thread in its workers for the same reason.
    os.register_at_fork(after_in_child=_on_one_thread)


def _alone(ready: threading.Barrier) -> None:
    torch.set_num_threads(1)
    ready.wait()
