"""What a machine gives to its workers, and the workers themselves."""

import asyncio
import importlib.util
import logging
import os
import shutil
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, BinaryIO

from odak import _validate
from odak.manager.tasks import thread_variables

GPU = "GPU"
# Results leave as soon as they are there: a worker that held its breath at 80 % of its memory would wait for ever.
# And the profiler, which looks at every task a hundred times a second, takes up to a fifth of a core.
_LEFT_OUT = (
    "distributed.worker.memory.target",
    "distributed.worker.memory.spill",
    "distributed.worker.memory.pause",
    "distributed.worker.profile.enabled",
)


def require_dask(what: str) -> None:
    """Raise ImportError, with the line that installs Dask, where it is missing."""
    if not has_dask():
        raise ImportError(f"{what} needs Dask, which is not installed: pip install 'dask[distributed]'")


def has_dask() -> bool:
    """Return whether Dask's scheduler is installed."""
    return importlib.util.find_spec("distributed") is not None


@dataclass(frozen=True)
class Share:
    """How a machine is divided among its workers.

    Attributes
    ----------
    workers : int, optional
        Worker processes; one per GPU, or one per core where there is none.
    threads : int, optional
        Threads of each; the cores shared evenly.
    memory_limit : int, optional
        Bytes for each; the memory shared evenly.
    name : str, optional
        Name of the workers.
    """

    workers: int | None = None
    threads: int | None = None
    memory_limit: int | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        """Check what is given."""
        for name in ("workers", "threads", "memory_limit"):
            if getattr(self, name) is not None:
                _validate.integer(name, getattr(self, name), minimum=1)

    def parts(self) -> list[dict[str, Any]]:
        """Return what each worker gets on this machine, as arguments of a Dask nanny."""
        from distributed.system import MEMORY_LIMIT

        gpus = visible_gpus()
        count = self.workers or len(gpus) or cores()
        threads = self.threads or max(1, cores() // count)
        parts = []
        for index in range(count):
            gpu = gpus[index] if index < len(gpus) else None
            environment = thread_variables(threads)
            if gpus:
                environment["CUDA_VISIBLE_DEVICES"] = gpu or ""
            parts.append(
                {
                    "nthreads": 1,
                    "memory_limit": self.memory_limit or int(MEMORY_LIMIT / count),
                    "name": None if self.name is None else f"{self.name}-{index}",
                    "resources": {GPU: 1} if gpu else None,
                    "env": environment,
                    "silence_logs": logging.ERROR,
                    "dashboard": False,
                    "dashboard_address": "127.0.0.1:0",
                }
            )
        return parts


def cores() -> int:
    """Return the number of cores that this process may use."""
    from dask.system import CPU_COUNT

    return CPU_COUNT


def visible_gpus() -> list[str]:
    """Return the names by which CUDA_VISIBLE_DEVICES selects each CUDA device of this machine."""
    if not (shutil.which("nvidia-smi") or os.path.exists("/proc/driver/nvidia")):
        return []
    import torch

    count = torch.cuda.device_count()
    named = [name.strip() for name in os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",") if name.strip()]
    return named[:count] if named else [str(index) for index in range(count)]


def work(
    address: str,
    share: Share,
    security: Any = None,
    ready: str | None = None,
    *,
    until_closed: BinaryIO | None = None,
    joined: Callable[[list[dict]], None] | None = None,
    timeout: float = 60.0,
) -> bool:
    """Hold this machine's workers until the scheduler ends, a signal comes, or a pipe closes.

    Parameters
    ----------
    address : str
        Address of the scheduler.
    share : Share
        How the machine is divided.
    security : distributed.Security, optional
        TLS certificates.
    ready : str, optional
        File to make once all workers have joined.
    until_closed : file object, optional
        Pipe whose end means that the program is no longer needed.
    joined : callable, optional
        Called with the parts of the workers once all have joined.
    timeout : float
        Seconds that the workers may take to reach the scheduler.

    Returns
    -------
    bool
        True if this side ended it, False if the scheduler went away.

    Raises
    ------
    OSError
        If the scheduler is not reached in time.
    """
    import dask
    import distributed  # noqa: F401 - sets the level of its log, which is set again below

    logging.getLogger("distributed").setLevel(logging.ERROR)
    with dask.config.set({"distributed.comm.timeouts.connect": timeout, **dict.fromkeys(_LEFT_OUT, False)}):
        return asyncio.run(_work(address, share.parts(), security, ready, until_closed, joined))


async def _work(address, parts, security, ready, until_closed, joined) -> bool:
    from distributed import Nanny

    stop = asyncio.Event()
    _stop_on_signals(stop)
    if until_closed is not None:
        _stop_at_end(until_closed, stop)
    nannies = [Nanny(address, security=security, **part) for part in parts]
    started = asyncio.gather(*nannies)
    asked = asyncio.create_task(stop.wait())
    try:
        first: list[asyncio.Future] = [started, asked]
        await asyncio.wait(first, return_when=asyncio.FIRST_COMPLETED)
        if started.done():
            await _joined(started, address)
            if ready:
                with open(ready, "w", encoding="utf-8"):
                    pass
            if joined:
                joined(parts)
            gone = asyncio.gather(*(nanny.finished() for nanny in nannies))
            last: list[asyncio.Future] = [gone, asked]
            await asyncio.wait(last, return_when=asyncio.FIRST_COMPLETED)
        return stop.is_set()
    finally:
        await _close(nannies)


async def _joined(started, address) -> None:
    try:
        await started
    except Exception as error:
        reason: BaseException = error
        while reason.__cause__ is not None and not isinstance(reason, OSError):
            reason = reason.__cause__
        raise OSError(f"Workers cannot join {address}: {reason}") from error


async def _close(nannies) -> None:
    await asyncio.gather(*(nanny.close(timeout=2) for nanny in nannies), return_exceptions=True)


def _stop_on_signals(stop: asyncio.Event) -> None:
    loop = asyncio.get_running_loop()
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, lambda *_: loop.call_soon_threadsafe(stop.set))


def _stop_at_end(pipe: BinaryIO, stop: asyncio.Event) -> None:
    loop = asyncio.get_running_loop()

    def read() -> None:
        # Not pipe.read(): its lock, held at the end of the program, would be a fatal error.
        while os.read(pipe.fileno(), 1024):
            pass
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(stop.set)

    threading.Thread(target=read, daemon=True).start()
