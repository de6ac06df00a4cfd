"""Where tasks run: in this process, or on a Dask cluster."""

import asyncio
import concurrent.futures
import inspect
import itertools
import queue
import re
import time
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from odak.log import logger
from odak.manager import tasks
from odak.manager.machine import GPU, has_dask, require_dask
from odak.manager.server import LOOPBACK, Server, start_server

Job = tuple[tuple, dict[str, Any]]
Group = Sequence[int]
_LARGE_CODE = 100_000
_LOOK, _GATHERING, _EVER = 0.5, 0.05, 1e8
_ANY_HOST = "0.0.0.0"
_WAKE = "wake"


class Backend(Protocol):
    """What a run needs: tasks are started in groups, and waited for."""

    client: Any

    def connect(self) -> None:
        """Reach the cluster, if that has not been done."""

    def slots(self) -> int:
        """Return how many tasks run at once."""

    def start(self, groups: list[tuple[Group, list[Job]]]) -> None:
        """Take groups of tasks: their numbers and their jobs."""

    def wait(self) -> list[tuple[Group, list[tasks.Outcome] | BaseException]]:
        """Return groups that are back; none after :meth:`wake`."""

    def wake(self) -> None:
        """End a call of :meth:`wait` in another thread."""

    def drop(self) -> None:
        """Let go of all groups."""

    def close(self) -> None:
        """Leave the cluster."""


def choose(compute: Callable, cluster: Any, depends: Sequence, server: bool, **settings: Any) -> Backend:
    """Return the backend that `cluster` names; parameters are those of :class:`odak.manager.agent`."""
    here = cluster is None or cluster is True or cluster == "local"
    if settings.get("workers") is not None and not here and not server:
        raise ValueError("workers are processes of this machine: they need cluster='local' or server=True")
    if cluster is None and not has_dask():
        logger.warning("Dask is not installed: tasks run one after another in this process")
        cluster = False
    if cluster is False:
        return Serial(compute)
    require_dask("A cluster")
    cluster = "local" if here else cluster
    if isinstance(cluster, str) and cluster != "local" and ":" not in cluster:
        raise ValueError(
            "cluster must be 'local', the address of a scheduler such as 'tcp://10.0.0.1:8786', a Dask cluster or "
            f"client, or False; got {cluster!r}"
        )
    if not isinstance(cluster, str) and not hasattr(cluster, "scheduler_info"):
        raise TypeError(f"cluster must be a string, a Dask cluster or client, or False; got {type(cluster).__name__}")
    return Cluster(compute, cluster, depends, server, **settings)


class Serial:
    """One task after another in this process."""

    client = None

    def __init__(self, compute: Callable) -> None:
        self._compute = compute
        self._started: deque[tuple[Group, list[Job]]] = deque()

    def connect(self) -> None:
        """Do nothing: there is no cluster."""

    def slots(self) -> int:
        """Return one."""
        return 1

    def start(self, groups: list[tuple[Group, list[Job]]]) -> None:
        """Take groups of tasks."""
        self._started += groups

    def wait(self) -> list[tuple[Group, list[tasks.Outcome] | BaseException]]:
        """Do what was started, one group a call."""
        group, jobs = self._started.popleft()
        return [(group, [tasks.attempt(lambda job=job: self._compute(*job[0], **job[1])) for job in jobs])]

    def wake(self) -> None:
        """Do nothing: the call ends with its group."""

    def drop(self) -> None:
        """Forget what was started."""
        self._started.clear()

    def close(self) -> None:
        """Do nothing."""


class Cluster:
    """A Dask cluster: one of its own on this machine, or one that is there already.

    Parameters are those of :class:`odak.manager.agent`.
    """

    def __init__(
        self,
        compute: Callable,
        cluster: Any,
        depends: Sequence,
        server: bool,
        *,
        workers: int | None,
        threads: int | None,
        gpu: bool,
        direct: bool | None,
        security: Any,
        timeout: float | None,
    ) -> None:
        self._compute, self._cluster, self._depends, self._serves = compute, cluster, depends, server
        self._share: dict[str, Any] = {"workers": workers, "threads": threads}
        self._resources = {GPU: 1} if gpu else None
        self._direct = cluster == "local" if direct is None else direct
        self._security, self._timeout = security, timeout
        self.client: Any = None
        self._server: Server | None = None
        self._code: Any = None
        self._groups: dict[str, tuple[Any, Group]] = {}
        self._back: queue.SimpleQueue = queue.SimpleQueue()
        # Dask learns how long tasks take by the first word of their keys.
        name = re.sub(r"\W+", "_", getattr(compute, "__name__", "task"))
        self._names, self._numbers = f"{name}-{uuid.uuid4().hex}", itertools.count()

    def connect(self) -> None:
        """Start or reach the cluster, and wait for a worker that fits."""
        if self.client is not None:
            return
        try:
            self._reach()
            self._await_worker()
            self._send_code()
        except BaseException:
            self.close()
            raise

    def slots(self) -> int:
        """Return how many tasks the workers run at once."""
        return sum(self.client.nthreads().values())

    def _reach(self) -> None:
        import distributed

        target = self._cluster
        limit: dict[str, Any] = {"timeout": _EVER if self._timeout is None else self._timeout}
        if self._cluster == "local":
            host, port = (_ANY_HOST, 8786) if self._serves else (LOOPBACK, 0)
            self._server = start_server(host=host, port=port, security=self._security, **self._share, **limit)
            target = self._server.cluster
            if self._serves:
                logger.warning(
                    "Whoever reaches %s can run code here; see odak.manager.start_server", self._server.address
                )
        elif self._serves:
            address = target if isinstance(target, str) else target.scheduler.address
            self._server = start_server(address, security=self._security, **self._share, **limit)
        if isinstance(target, distributed.Client):
            self.client = target
            return
        security = {"security": self._security} if isinstance(self._security, distributed.Security) else {}
        self.client = distributed.Client(
            target, set_as_default=False, direct_to_workers=self._direct, **security, **limit
        )

    def _await_worker(self) -> None:
        end = None if self._timeout is None else time.monotonic() + self._timeout
        while not any(self._fits(worker) for worker in self._workers()):
            if self._cluster == "local" or (end is not None and time.monotonic() > end):
                kind = "worker with a GPU" if self._resources else "worker"
                raise TimeoutError(
                    f"No {kind} is there at {self.client.scheduler.address}; `odak worker ADDRESS` lets a machine join"
                )
            time.sleep(_LOOK / 5)

    def _workers(self) -> list[dict]:
        # Newer releases tell of five workers alone unless asked for all.
        look = self.client.scheduler_info
        every = {"n_workers": -1} if "n_workers" in inspect.signature(look).parameters else {}
        return list(look(**every)["workers"].values())

    def _fits(self, worker: dict) -> bool:
        offered = worker.get("resources") or {}
        return all(offered.get(name, 0) >= count for name, count in (self._resources or {}).items())

    def _send_code(self) -> None:
        for path in self._depends:
            if isinstance(path, str):
                self.client.upload_file(path)
        code = tasks.pack_code(self._compute, [item for item in self._depends if not isinstance(item, str)])
        # As a task of its own, large code reaches each worker once, and is there again when its holder is lost.
        self._code = code if len(code) < _LARGE_CODE else self._map(bytes, [code], [f"{self._names}-code"])[0]

    def _map(self, function: Callable, values: list, keys: list[str], **options: Any) -> list:
        with warnings.catch_warnings():
            # The warning is about data sent with every task; here each argument is used once.
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            return self.client.map(function, values, key=keys, pure=False, **options)

    def start(self, groups: list[tuple[Group, list[Job]]]) -> None:
        """Send groups of tasks to the scheduler."""
        keys, packed, sent = [], [], []
        for group, jobs in groups:
            try:
                packed.append([tasks.pack(job) for job in jobs])
            except Exception as error:
                self._back.put((group, error))
                continue
            keys.append(f"{self._names}-{next(self._numbers)}")
            sent.append(group)
        if not keys:
            return
        options: dict[str, Any] = {"resources": self._resources} if self._resources else {}
        options["threads"] = self._share["threads"]
        futures = self._map(tasks.run_packed, packed, keys, code=self._code, **options)
        for future, group in zip(futures, sent, strict=True):
            self._groups[future.key] = future, group
            future.add_done_callback(self._back.put)

    def wait(self) -> list[tuple[Group, list[tasks.Outcome] | BaseException]]:
        """Return groups that are back; none after :meth:`wake`."""
        arrived: list = []
        while not arrived:
            try:
                arrived.append(self._back.get(timeout=_LOOK))
                # Results are fetched together: one by one, thousands of them would cost more than their scheduling.
                time.sleep(min(_GATHERING, len(self._groups) * 1e-4))
                while True:
                    arrived.append(self._back.get_nowait())
            except queue.Empty:
                self._check()
        if _WAKE in arrived:
            return []
        unsent = [item for item in arrived if isinstance(item, tuple)]
        futures = [item for item in arrived if not isinstance(item, tuple) and item.key in self._groups]
        return unsent + self._open(futures)

    def _check(self) -> None:
        if self._server is not None and not self._server.alive() and not self._workers():
            raise ConnectionError("The program that holds this machine's workers has ended")

    def _open(self, futures: list) -> list[tuple[Group, list[tasks.Outcome] | BaseException]]:
        client = self.client
        if client is None:  # closed by another thread
            return []
        try:
            _check_kept(futures)
            results = client.gather({future.key: future for future in futures}, errors="skip")
            _check_kept(futures)
        except (OSError, asyncio.CancelledError, concurrent.futures.CancelledError) as error:
            raise ConnectionError("The scheduler is gone, or was told by another client to drop these tasks") from error
        back: list = []
        for future in futures:
            _, group = self._groups.pop(future.key)
            outcomes = results.get(future.key)
            back.append((group, future.exception() if outcomes is None else [_opened(outcome) for outcome in outcomes]))
        return back

    def wake(self) -> None:
        """End a call of :meth:`wait` in another thread."""
        self._back.put(_WAKE)

    def drop(self) -> None:
        """Take all tasks back from the scheduler."""
        futures = [future for future, _ in self._groups.values()]
        self._groups, self._back = {}, queue.SimpleQueue()
        if futures and self.client is not None and self.client.status == "running":
            self.client.cancel(futures, force=True)

    def close(self) -> None:
        """Leave the cluster; end what this backend started."""
        client, server = self.client, self._server
        self.client = self._server = self._code = None
        if client is not None and client is not self._cluster:
            client.close()
        if server is not None:
            server.close()


def _check_kept(futures: list) -> None:
    if any(future.status in ("cancelled", "lost") for future in futures):
        raise concurrent.futures.CancelledError


def _opened(outcome: tasks.Outcome) -> tasks.Outcome:
    """Return an outcome with its value unpacked, or as a failure where that cannot be done here."""
    try:
        outcome.value = tasks.unpack(outcome.value)
    except Exception as error:
        outcome.trace = outcome.trace or f"{type(error).__name__} on opening the result here: {error}\n"
        outcome.value = error
    return outcome
