"""Tasks on a worker: serialised as bytes, and computed in a process of their own, whose end affects no other task.

A function, its arguments and its results are sent as bytes that are unpickled where a task runs: an object that cannot
be unpickled makes that task alone fail, with a traceback. Each thread of a Dask worker keeps one process in which tasks
run. If a task ends its process, by a fault in compiled code, by ``os._exit`` or for lack of memory, this is noticed at
once, and the worker continues with the results that it holds.
"""

import ctypes
import functools
import importlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from odak._python import current_folder, python_command

HERE = "this process"
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEPT, _KEPT_BEFORE = 256 * 2**20, 32 * 2**20
_PIPE = 2**20
# Interval in seconds at which the process of a task is checked, the longest time that it may be stopped, and the share
# of its memory that it may use.
_LOOK, _STOPPED, _FULL = 0.2, 5.0, 0.95
# Signals that users, job schedulers and a system short of memory send; faults of a task come as others.
_FROM_OUTSIDE = (signal.SIGTERM, getattr(signal, "SIGKILL", signal.SIGTERM), signal.SIGINT)


@dataclass
class Outcome:
    """Result or failure of one task.

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
    ended : str
        "by itself" if the process of the task ended before the task did, "from outside" if it may have been killed by
        others, empty otherwise.
    """

    value: Any
    trace: str
    worker: str
    start: float
    seconds: float
    ended: str = ""

    @property
    def failed(self) -> bool:
        """Whether the task raised an exception."""
        return bool(self.trace)


def attempt(work: Callable[..., Any]) -> Outcome:
    """Call a function without arguments and return its outcome.

    `SystemExit` counts as a failure: a task that calls `sys.exit` must not end its worker.
    """
    start, clock = time.time(), time.perf_counter()
    try:
        value, trace = work(), ""
    except (Exception, SystemExit) as error:
        value, trace = error, _trace(error)
    return Outcome(value, trace, HERE, start, time.perf_counter() - clock)


def _trace(error: BaseException) -> str:
    """Return the traceback as text, from the first frame beyond this file where there is one."""
    frames = error.__traceback__
    while frames is not None and frames.tb_frame.f_code.co_filename == __file__:
        frames = frames.tb_next
    return "".join(traceback.format_exception(type(error), error, frames or error.__traceback__))


# --- On the worker


def run_packed(jobs: Sequence[bytes], code: bytes, threads: int | None = None) -> list[Outcome]:
    """Compute tasks on a worker, one after another.

    Parameters
    ----------
    jobs : sequence of bytes
        Packed arguments and keywords of each task, from :func:`pack`.
    code : bytes
        The function, from :func:`pack`.
    threads : int, optional
        Threads that NumPy and torch may use.

    Returns
    -------
    list of Outcome
        One per task; results and exceptions are packed.
    """
    from distributed import get_worker

    worker = get_worker()
    limit = getattr(worker.memory_manager, "memory_limit", None)
    outcomes = []
    for job in jobs:
        process = getattr(_local, "process", None)
        if process is None or not process.alive():
            process = _local.process = _Process(limit)
        outcome = process.compute(job, code, threads)
        outcome.worker = worker.address
        outcomes.append(outcome)
    return outcomes


_local = threading.local()


class _Process:
    """A process that computes the tasks of one thread of a worker.

    Parameters
    ----------
    limit : int, optional
        Largest memory in bytes.
    """

    def __init__(self, limit: int | None) -> None:
        self._process = subprocess.Popen(
            python_command("from odak.manager.tasks import _serve; _serve()"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        for pipe in (self._process.stdin, self._process.stdout):
            _enlarge(pipe)
        self._code, self._reason, self._outside = b"", "", False
        self._end = weakref.finalize(self, _end, self._process)
        threading.Thread(target=_watch, args=(weakref.ref(self), self._process, limit), daemon=True).start()

    def alive(self) -> bool:
        """Return whether the process is running."""
        return self._process.poll() is None

    def compute(self, job: bytes, code: bytes, threads: int | None) -> Outcome:
        """Compute one task."""
        start, clock = time.time(), time.perf_counter()
        stdin: Any = self._process.stdin
        try:
            # Large code is the same object for every task, so that this comparison takes no time.
            pickle.dump((None if code == self._code else code, job, threads), stdin)
            stdin.flush()
            self._code = code
            return pickle.load(self._process.stdout)  # type: ignore[arg-type]
        except (OSError, EOFError, pickle.UnpicklingError):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_STOPPED)
            self._end()
            code = self._process.returncode
            text = f"the process of the task ended: {self._reason or _described(code)}"
            outside = self._outside or (not self._reason and code is not None and -code in _FROM_OUTSIDE)
            ended = "from outside" if outside else "by itself"
            value, seconds = pack(ChildProcessError(text)), time.perf_counter() - clock
            return Outcome(value, f"ChildProcessError: {text}\n", "", start, seconds, ended)

    def kill(self, reason: str, outside: bool) -> None:
        """End the process and record the reason."""
        self._reason, self._outside = reason, outside
        self._process.kill()


def _enlarge(pipe: Any) -> None:
    """Let a pipe hold `_PIPE` bytes, where the system permits it.

    It holds 64 KiB by default, and a larger array then takes a change of process for each of these: on a busy machine,
    a millisecond each.
    """
    with suppress(ImportError, AttributeError, OSError):
        import fcntl

        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE)


def _described(code: int | None) -> str:
    if code is None or code >= 0:
        return f"exit code {code}"
    with suppress(ValueError):
        return f"signal {-code} ({signal.Signals(-code).name})"
    return f"signal {-code}"


def _end(process: subprocess.Popen) -> None:
    for pipe in (process.stdin, process.stdout):
        with suppress(OSError):
            pipe.close()  # type: ignore[union-attr]
    try:
        process.wait(_STOPPED)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _watch(owner: "weakref.ref[_Process]", process: subprocess.Popen, limit: int | None) -> None:
    """Kill a process that was stopped, or that exceeds its limit of memory."""
    import psutil

    stopped_since = None
    with suppress(psutil.Error):
        observed = psutil.Process(process.pid)
        while process.poll() is None and owner() is not None:
            reason = ""
            taken = observed.memory_info().rss
            if limit and taken > _FULL * limit:
                reason = f"it took {taken / 2**30:.3g} GiB of memory, and its worker has {limit / 2**30:.3g} GiB"
            if observed.status() == psutil.STATUS_STOPPED:
                stopped_since = stopped_since or time.monotonic()
                if time.monotonic() > stopped_since + _STOPPED:
                    reason = f"it had been stopped for {_STOPPED:g} s"
            else:
                stopped_since = None
            found = owner()
            if reason and found is not None:
                found.kill(reason, outside=stopped_since is not None)
            del found
            time.sleep(_LOOK)


# --- In the process of the tasks


def _serve() -> None:
    """Compute the tasks that arrive on the standard input until it closes."""
    jobs, results = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # the output of tasks must not be mixed with results
    waiting: queue.SimpleQueue = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(jobs, waiting), daemon=True).start()
    keep_memory()
    code = b""
    with suppress(BrokenPipeError):
        while (message := waiting.get()) is not None:
            sent, job, threads = message
            code = code if sent is None else sent
            if threads is not None:
                pin_threads(threads)
            function = functools.partial(_compute, code, job)
            outcome = attempt(lambda function=function: pack(_on_cpu(function())))
            if outcome.failed:
                outcome.value = _pack_error(outcome.value)
            pickle.dump(outcome, results)
            results.flush()


def _receive(jobs: Any, waiting: queue.SimpleQueue) -> None:
    """Queue incoming tasks; end the process shortly after its worker has ended, even during a task."""
    try:
        while True:
            waiting.put(pickle.load(jobs))
    except (EOFError, OSError, pickle.UnpicklingError):
        waiting.put(None)
        time.sleep(1.0)
        os._exit(1)


def _compute(code: bytes, job: bytes) -> Any:
    arguments, keywords = unpack(job)
    return _function(code)(*arguments, **keywords)


@functools.lru_cache(maxsize=1)
def _function(code: bytes) -> Callable[..., Any]:
    # Unpickled once and kept, so that the weights of a network, say, are not read again for every task.
    return unpack(code)


def _on_cpu(value: Any) -> Any:
    """Return a result with its tensors moved to the CPU, since other machines do not have the worker's GPU."""
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


def pin_threads(count: int) -> None:
    """Set the number of threads of the numerical libraries of this process, loaded now or later."""
    os.environ.update(thread_variables(count))
    torch = sys.modules.get("torch")
    if torch is not None and torch.get_num_threads() != count:
        torch.set_num_threads(count)


def thread_variables(count: int) -> dict[str, str]:
    """Return the environment variables that numerical libraries take their number of threads from."""
    return dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(count))


def keep_memory() -> None:
    """Let glibc retain the memory of freed arrays for later ones.

    Dask has its workers hand back all but 64 KiB at once (MALLOC_TRIM_THRESHOLD_), and every new array is then cleared
    page by page: half the time of a hologram.
    """
    allocator = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if allocator is not None:
        allocator(_TRIM_THRESHOLD, _KEPT)
        # Releases before 2.35 accept less.
        if not allocator(_MMAP_THRESHOLD, _KEPT):
            allocator(_MMAP_THRESHOLD, _KEPT_BEFORE)


# --- Packing


def pack(value: Any) -> bytes:
    """Serialise a value; functions and classes of scripts and notebooks are included with their code."""
    import cloudpickle

    return cloudpickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)


def unpack(data: bytes) -> Any:
    """Return the value that :func:`pack` serialised."""
    return pickle.loads(data)


def _pack_error(error: BaseException) -> bytes:
    """Return an exception as bytes that can be unpickled; if it cannot itself, its type and text."""
    try:
        data = pack(error.with_traceback(None))
        unpack(data)
    except Exception:
        return pack(RuntimeError(f"{type(error).__name__}: {error}"))
    return data


@contextmanager
def packed_by_value(modules: Iterable[ModuleType]) -> Iterator[None]:
    """Let :func:`pack` include the code of modules that workers cannot import."""
    import cloudpickle

    added = [module for module in modules if module.__name__ not in cloudpickle.list_registry_pickle_by_value()]
    for module in added:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in added:
            cloudpickle.unregister_pickle_by_value(module)


def modules_of(depends: Iterable[ModuleType | Callable[..., Any] | str]) -> list[ModuleType]:
    """Return the given modules, and the modules of given functions and classes; paths are skipped."""
    return [
        item if isinstance(item, ModuleType) else importlib.import_module(item.__module__)
        for item in depends
        if not isinstance(item, str)
    ]


def modules_of_current_folder() -> list[ModuleType]:
    """Return the modules that were imported from the current folder, which is not on the path of worker processes."""
    here = current_folder()
    if here is None or not any(os.path.realpath(entry or ".") == here for entry in sys.path):
        return []
    # Thousands of modules lie in some hundred folders, and each takes a question to the system for each level.
    real = functools.cache(os.path.realpath)
    found = []
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None)
        package = name.partition(".")[0]
        if file and package not in ("__main__", "odak"):
            levels = name.count(".") + (os.path.basename(file) == "__init__.py")
            folder = real(os.path.dirname(file))
            for _ in range(levels):
                folder = os.path.dirname(folder)
            if folder == here and getattr(module, "__name__", None) == name:
                found.append(module)
    return found
