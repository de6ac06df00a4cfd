"""What travels to a worker and back, and what a worker does with it.

A function, its arguments and its results travel as bytes that are opened where a task runs: whatever cannot be opened
fails that task alone, with a traceback, and not the worker.
"""

import ctypes
import functools
import importlib
import os
import pickle
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any

HERE = "this process"
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEPT, _KEPT_BEFORE = 256 * 2**20, 32 * 2**20


@dataclass
class Outcome:
    """What became of one task.

    Attributes
    ----------
    value : object
        The result, pickled if it comes from a worker; the exception if the task failed.
    trace : str
        Traceback of a failure, empty for a success.
    worker : str
        Where the task ran.
    start, seconds : float
        Time of day when it began in seconds since the epoch, and how long it took.
    """

    value: Any
    trace: str
    worker: str
    start: float
    seconds: float

    @property
    def failed(self) -> bool:
        """Whether the task raised an exception."""
        return bool(self.trace)


def attempt(work: Callable[..., Any]) -> Outcome:
    """Call a function without arguments and return what became of it.

    Parameters
    ----------
    work : callable
        What to do.

    Returns
    -------
    Outcome
        Result or exception. `SystemExit` counts as a failure: a task that calls `sys.exit` must not end its worker.
    """
    start, clock = time.time(), time.perf_counter()
    try:
        value, trace = work(), ""
    except (Exception, SystemExit) as error:
        value, trace = error, _trace(error)
    return Outcome(value, trace, where(), start, time.perf_counter() - clock)


def _trace(error: BaseException) -> str:
    """Return the traceback as text, from the first frame beyond this file where there is one."""
    frames = error.__traceback__
    while frames is not None and frames.tb_frame.f_code.co_filename == __file__:
        frames = frames.tb_next
    return "".join(traceback.format_exception(type(error), error, frames or error.__traceback__))


def run_packed(jobs: Sequence[bytes], code: bytes, threads: int | None = None) -> list[Outcome]:
    """Do some tasks on a worker, one after another.

    Parameters
    ----------
    jobs : sequence of bytes
        Packed arguments and keywords of each task, from :func:`pack`.
    code : bytes
        The function, from :func:`pack_code`.
    threads : int, optional
        Threads that NumPy and torch may use.

    Returns
    -------
    list of Outcome
        One per task; results and exceptions are packed.
    """
    keep_memory()
    if threads is not None:
        pin_threads(threads)
    outcomes = [attempt(lambda job=job: pack(_on_cpu(_call(code, job)))) for job in jobs]
    for outcome in outcomes:
        if outcome.failed:
            outcome.value = _pack_error(outcome.value)
    return outcomes


def pack(value: Any) -> bytes:
    """Return a value as bytes; functions and classes of scripts and notebooks travel with their code."""
    import cloudpickle

    return cloudpickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)


def unpack(data: bytes) -> Any:
    """Return the value that :func:`pack` made bytes of."""
    return pickle.loads(data)


def pack_code(compute: Callable, depends: Sequence[ModuleType | Callable] = ()) -> bytes:
    """Return a function as bytes.

    Parameters
    ----------
    compute : callable
        The function.
    depends : sequence
        Modules whose code travels along, because workers cannot import them; a function or class stands for its module.

    Returns
    -------
    bytes
        To be opened by :func:`run_packed`.
    """
    with _by_value(
        [item if isinstance(item, ModuleType) else importlib.import_module(item.__module__) for item in depends]
    ):
        return pack(compute)


@contextmanager
def _by_value(modules: Sequence[ModuleType]) -> Iterator[None]:
    import cloudpickle

    added = [module for module in modules if module.__name__ not in cloudpickle.list_registry_pickle_by_value()]
    for module in added:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in added:
            cloudpickle.unregister_pickle_by_value(module)


def pin_threads(count: int) -> None:
    """Let the numerical libraries of this process use so many threads, those included that load later."""
    os.environ.update(thread_variables(count))
    torch = sys.modules.get("torch")
    if torch is not None and torch.get_num_threads() != count:
        torch.set_num_threads(count)


@functools.cache
def keep_memory() -> None:
    """Let glibc keep the memory of freed arrays for the next ones.

    Dask has its workers hand back all but 64 KiB at once (MALLOC_TRIM_THRESHOLD_), and every new array is then cleared
    page by page: half the time of a hologram.
    """
    allocator = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if allocator is not None:
        allocator(_TRIM_THRESHOLD, _KEPT)
        # Releases before 2.35 accept less.
        if not allocator(_MMAP_THRESHOLD, _KEPT):
            allocator(_MMAP_THRESHOLD, _KEPT_BEFORE)


def thread_variables(count: int) -> dict[str, str]:
    """Return the environment variables that numerical libraries take their number of threads from."""
    return dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(count))


def where() -> str:
    """Return the address of the Dask worker that runs this, or "this process"."""
    distributed = sys.modules.get("distributed")
    if distributed is None:
        return HERE
    try:
        return distributed.get_worker().address
    except ValueError:
        return HERE


@functools.lru_cache(maxsize=4)
def _compute(code: bytes) -> Callable:
    # Opened once per worker and kept: a module of a network, say, is not sent through pickle for every task.
    return unpack(code)


def _call(code: bytes, job: bytes) -> Any:
    arguments, keywords = unpack(job)
    return _compute(code)(*arguments, **keywords)


def _on_cpu(value: Any) -> Any:
    """Return a result whose tensors lie on the CPU: the GPU of a worker means nothing on another machine."""
    torch = sys.modules.get("torch")
    if torch is None:
        return value
    if isinstance(value, torch.Tensor):
        return value.cpu()
    if type(value) in (list, tuple):
        return type(value)(_on_cpu(part) for part in value)
    if type(value) is dict:
        return {name: _on_cpu(part) for name, part in value.items()}
    return value


def _pack_error(error: BaseException) -> bytes:
    """Return an exception as bytes that can be opened again, its type and text if it cannot itself."""
    try:
        data = pack(error.with_traceback(None))
        unpack(data)
    except Exception:
        return pack(RuntimeError(f"{type(error).__name__}: {error}"))
    return data
