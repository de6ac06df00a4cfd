"""Computation of groups of tasks: in this process, or on a Dask cluster."""

import asyncio
import concurrent.futures
import contextlib
import gc
import inspect
import itertools
import queue
import re
import threading
import time
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from odak import _validate
from odak._warnings import MissingPackageWarning, warn
from odak.manager import tasks
from odak.manager.server import (
    GPU,
    Server,
    check_transport,
    has_dask,
    load_security,
    require_dask,
    start_server,
)

Job = tuple[tuple[Any, ...], dict[str, Any]]
Group = Sequence[int]
_LARGE_CODE = 100_000
_LOOK, _CHECK, _GATHERING, _EVER = 0.5, 5.0, 0.05, 1e8
# Least and largest time in seconds to wait for an answer of the scheduler, and the longest silence of one worker while
# others send heartbeats.
_PATIENCE, _SILENCE = (5.0, 30.0), 20.0
_WAKE = "wake"


class Lost(Exception):
    """A group of tasks whose results were lost with a worker; they are computed again."""


@dataclass(frozen=True)
class Terms:
    """How a cluster is reached, and what its workers have; as the parameters of :class:`odak.manager.agent`."""

    workers: int | None
    threads: int | None
    gpu: bool
    direct: bool | None
    host: str
    security: Any
    trusted_network: bool
    timeout: float | None

    def __post_init__(self) -> None:
        for name in ("gpu", "trusted_network", *(["direct"] if self.direct is not None else [])):
            object.__setattr__(self, name, _validate.flag(name, getattr(self, name)))
        known = isinstance(self.security, (bool, str, Path, type(None)))
        if not known and not hasattr(self.security, "get_connection_args"):
            given = type(self.security).__name__
            raise TypeError(f"security must be a distributed.Security, a folder or True, got {given}")
        _validate.text("host", self.host)
        for name in ("workers", "threads"):
            if getattr(self, name) is not None:
                _validate.integer(name, getattr(self, name), minimum=1)
        if self.timeout is not None:
            _validate.real("timeout", self.timeout, positive=True)


def choose(cluster: Any, depends: Sequence[Any], server: bool, terms: Terms) -> "Serial | Cluster":
    """Return the backend selected by `cluster`; parameters as in :class:`odak.manager.agent`."""
    here = cluster is None or cluster is True or cluster == "local"
    if terms.workers is not None and not here and not server:
        raise ValueError(
            "workers must be left out unless cluster='local' or server=True, as they are processes of this machine"
        )
    if cluster is None and not has_dask():
        warn("Dask is not installed: tasks run one after another in this process", MissingPackageWarning)
        cluster = False
    if cluster is False:
        return Serial()
    require_dask("A cluster")
    cluster = "local" if here else cluster
    if isinstance(cluster, str) and cluster != "local":
        if ":" not in cluster:
            raise ValueError(
                "cluster must be 'local', the address of a scheduler such as 'tls://10.0.0.1:8786', a Dask cluster or "
                f"client, or False; got {cluster!r}"
            )
        check_transport("cluster", cluster, terms.trusted_network)
    if not isinstance(cluster, str) and not hasattr(cluster, "scheduler_info"):
        raise TypeError(f"cluster must be a string, a Dask cluster or client, or False; got {type(cluster).__name__}")
    return Cluster(cluster, depends, server, terms)


class Serial:
    """One task after another in this process."""

    client = None

    def __init__(self) -> None:
        self._compute: Callable[..., Any] | None = None
        self._started: deque[tuple[Group, list[Job]]] = deque()

    def connect(self) -> None:
        """Do nothing: there is no cluster."""

    def slots(self) -> int:
        """Return 1."""
        return 1

    def load(self, compute: Callable[..., Any]) -> None:
        """Set the function that the tasks of the next run call."""
        self._compute = compute

    def start(self, groups: list[tuple[Group, list[Job]]]) -> None:
        """Submit groups of tasks."""
        self._started += groups

    def wait(self) -> list[tuple[Group, list[tasks.Outcome] | BaseException]]:
        """Compute the submitted groups, one for each call."""
        group, jobs = self._started.popleft()
        compute: Any = self._compute
        return [(group, [tasks.attempt(lambda job=job: compute(*job[0], **job[1])) for job in jobs])]

    def wake(self) -> None:
        """Do nothing: the call ends with its group."""

    def drop(self) -> None:
        """Drop the groups that were started."""
        self._started.clear()

    def close(self) -> None:
        """Do nothing."""


class Cluster:
    """A Dask cluster: one of its own on this machine, or one that exists already.

    Parameters are as in :class:`odak.manager.agent`.
    """

    def __init__(self, cluster: Any, depends: Sequence[Any], server: bool, terms: Terms) -> None:
        self._cluster, self._depends, self._serves = cluster, depends, server
        names = ("workers", "threads", "trusted_network")
        self._options: dict[str, Any] = {name: getattr(terms, name) for name in names}
        self._host, self._resources = terms.host, {GPU: 1} if terms.gpu else None
        self._direct = cluster == "local" if terms.direct is None else terms.direct
        self._security, self._timeout = load_security(terms.security), terms.timeout
        self.client: Any = None
        self._server: Server | None = None
        self._code: Any = None
        self._packed_code, self._names = b"", ""
        self._modules: list[ModuleType] = []
        self._groups: dict[str, tuple[Any, Group]] = {}
        self._events: queue.SimpleQueue = queue.SimpleQueue()
        self._checked = time.monotonic()
        self._numbers = itertools.count()

    def connect(self) -> None:
        """Start the cluster or connect to it, and wait for a suitable worker."""
        if self.client is not None:
            return
        try:
            self._reach()
            self._await_worker()
            for path in self._depends:
                if isinstance(path, str):
                    client: Any = self.client
                    client.upload_file(path)
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
            port = 8786 if self._serves else 0
            self._server = start_server(host=self._host, port=port, security=self._security, **self._options, **limit)
            target = self._server.cluster
        elif self._serves:
            address = target if isinstance(target, str) else target.scheduler.address
            self._server = start_server(address, security=self._security, **self._options, **limit)
        if isinstance(target, distributed.Client):
            self.client = target
            return
        security = {"security": self._security} if isinstance(self._security, distributed.Security) else {}
        # A client that was dropped with an exception takes Dask's lock while it is freed. That must not happen in the
        # thread that the next client starts, which holds this lock meanwhile.
        gc.collect()
        self.client = distributed.Client(
            target, set_as_default=False, direct_to_workers=self._direct, **security, **limit
        )

    def _await_worker(self) -> None:
        end = None if self._timeout is None else time.monotonic() + self._timeout
        while not any(self._fits(worker) for worker in self._workers().values()):
            if self._cluster == "local" or (end is not None and time.monotonic() > end):
                kind = "worker with a GPU" if self._resources else "worker"
                raise TimeoutError(
                    f"No {kind} has joined {self.client.scheduler.address}; start one with `odak worker ADDRESS`"
                )
            time.sleep(_LOOK / 5)

    def _workers(self) -> dict[str, dict[Any, Any]]:
        # scheduler_info() of the client hides that a scheduler does not answer.
        every = "n_workers" in inspect.signature(self.client.scheduler_info).parameters
        return self._ask("identity", **({"n_workers": -1} if every else {}))["workers"]

    def _ask(self, question: str, **arguments: Any) -> Any:
        """Return the answer of the scheduler; raise ConnectionError if there is none in time."""
        client = self.client
        limit = max(_PATIENCE[0], min(_PATIENCE[1], self._timeout or _PATIENCE[1]))
        try:
            return client.sync(getattr(client.scheduler, question), callback_timeout=limit, **arguments)
        except (Exception, asyncio.CancelledError) as error:
            raise ConnectionError(f"no answer within {limit:g} s: {type(error).__name__} {error}") from error

    def _fits(self, worker: dict[Any, Any]) -> bool:
        offered = worker.get("resources") or {}
        return all(offered.get(name, 0) >= count for name, count in (self._resources or {}).items())

    def load(self, compute: Callable[..., Any]) -> None:
        """Send the function that the tasks of the next run call."""
        # Dask learns how long tasks take by the first word of their keys.
        name = re.sub(r"\W+", "_", getattr(getattr(compute, "func", compute), "__name__", "task"))
        self._names = f"{name}-{uuid.uuid4().hex}"
        self._modules = tasks.modules_of(self._depends) + tasks.modules_of_current_folder()
        with tasks.packed_by_value(self._modules):
            self._code = self._packed_code = tasks.pack(compute)
        if len(self._packed_code) >= _LARGE_CODE:
            self._share_code()

    def _share_code(self) -> None:
        # As the result of a task, large code is sent to each worker once, and again if its holder is lost.
        self._code = self._map(bytes, [self._packed_code], [f"{self._names}-code-{next(self._numbers)}"])[0]
        # Tasks go where it is: copies on all workers keep the others from waiting. An optimisation, so that a failure,
        # such as a worker that does not answer, is left to the run.
        with suppress(Exception, asyncio.CancelledError):
            self.client.sync(self.client._replicate, [self._code], callback_timeout=_PATIENCE[0])

    def _map(self, function: Callable[..., Any], values: list[Any], keys: list[str], **options: Any) -> list[Any]:
        with warnings.catch_warnings():
            # The warning is about data sent with every task; here each argument is used once.
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            return self.client.map(function, values, key=keys, pure=False, **options)

    def start(self, groups: list[tuple[Group, list[Job]]]) -> None:
        """Send groups of tasks to the scheduler."""
        keys, packed, sent = [], [], []
        with tasks.packed_by_value(self._modules):
            for group, jobs in groups:
                try:
                    packed.append([tasks.pack(job) for job in jobs])
                except Exception as error:
                    self._events.put(_Unsent(group, error))
                    continue
                keys.append(f"{self._names}-{next(self._numbers)}")
                sent.append(group)
        if not keys:
            return
        options: dict[str, Any] = {"resources": self._resources} if self._resources else {}
        options["threads"] = self._options["threads"]
        if getattr(self._code, "status", None) in ("cancelled", "lost", "error"):
            self._share_code()
        futures = self._map(tasks.run_packed, packed, keys, code=self._code, **options)
        for future, group in zip(futures, sent, strict=True):
            self._groups[future.key] = future, group
            future.add_done_callback(self._events.put)

    def wait(self) -> list[tuple[Group, list[tasks.Outcome] | BaseException]]:
        """Return groups that are done; none after :meth:`wake`."""
        while True:
            arrived: list[Any] = []
            with contextlib.suppress(queue.Empty):
                arrived.append(self._events.get(timeout=_LOOK))
                # Results are fetched together: one by one, thousands of them would cost more than their scheduling.
                time.sleep(min(_GATHERING, len(self._groups) * 1e-4))
                while True:
                    arrived.append(self._events.get_nowait())
            client = self.client
            if _WAKE in arrived or client is None:  # closed by another thread
                return []
            back: list[Any] = []
            done = []
            for item in arrived:
                if isinstance(item, _Unsent):
                    back.append((item.group, item.error))
                elif isinstance(item, _Fetched):
                    back += [self._result(future, item.results) for future in item.futures if self._expects(future)]
                elif self._expects(item) and item.status == "finished":
                    done.append(item)
                elif self._expects(item):
                    back.append(self._result(item, {}))
            if done:
                # In a thread: a worker that does not answer must not delay the results of others.
                threading.Thread(target=_fetch, args=(client, done, self._events), daemon=True).start()
            if any(isinstance(result, Lost) for _, result in back) or time.monotonic() > self._checked + _CHECK:
                self._check()
            if back:
                return back

    def _expects(self, future: Any) -> bool:
        return self._groups.get(future.key, (None, None))[0] is future

    def _result(self, future: Any, results: dict[Any, Any]) -> tuple[Group, list[tasks.Outcome] | BaseException]:
        """Return a group and its outcomes, or the reason why there are none."""
        _, group = self._groups.pop(future.key)
        outcomes = results.get(future.key)
        if outcomes is not None:
            return group, [_opened(outcome) for outcome in outcomes]
        error = future.exception() if future.status == "error" else None
        if error is not None and type(error).__name__ != "KilledWorker":
            return group, error
        return group, Lost("its worker, or the connection to the scheduler, was lost")

    def _check(self) -> None:
        """Raise ConnectionError if the scheduler does not answer; have it remove workers that do not."""
        self._checked = time.monotonic()
        try:
            workers = self._workers()
        except OSError as error:
            if self.client is None:
                return
            raise ConnectionError(f"The scheduler does not answer: {error}") from error
        if not workers and self._server is not None and not self._server.alive():
            raise ConnectionError("The program that holds this machine's workers has ended")
        heard = {address: worker.get("last_seen", 0.0) for address, worker in workers.items()}
        for address, last in heard.items():
            # A number of missed heartbeats too: their interval grows with the number of workers.
            if last < max(heard.values()) - max(_SILENCE, len(workers) / 20):
                self._ask("unregister", address=address, stimulus_id=f"odak-silent-worker-{time.time()}")

    def wake(self) -> None:
        """End a call of :meth:`wait` in another thread."""
        self._events.put(_WAKE)

    def drop(self) -> None:
        """Cancel all tasks at the scheduler."""
        futures = [future for future, _ in self._groups.values()]
        self._groups, self._events = {}, queue.SimpleQueue()
        if futures and self.client is not None and self.client.status == "running":
            self.client.cancel(futures, force=True)

    def close(self) -> None:
        """Disconnect from the cluster, and end the processes that this backend started."""
        client, server = self.client, self._server
        self.client = self._server = self._code = None
        if client is not None and client is not self._cluster:
            client.close()
        if server is not None:
            server.close()


@dataclass
class _Unsent:
    """A group that could not be serialised."""

    group: Group
    error: BaseException


@dataclass
class _Fetched:
    """Futures that were done, and the results of those that could be fetched, by their keys."""

    futures: list[Any]
    results: dict[Any, Any]


def _fetch(client: Any, futures: list[Any], events: queue.SimpleQueue) -> None:
    results: dict[Any, Any] = {}
    # After any error, missing results are computed again if the scheduler still answers.
    with suppress(Exception, asyncio.CancelledError, concurrent.futures.CancelledError):
        results = client.gather({future.key: future for future in futures}, errors="skip")
    events.put(_Fetched(futures, results))


def _opened(outcome: tasks.Outcome) -> tasks.Outcome:
    """Return an outcome with its value unpacked, or as a failure where that cannot be done here."""
    try:
        outcome.value = tasks.unpack(outcome.value)
    except Exception as error:
        outcome.trace = outcome.trace or f"{type(error).__name__} on opening the result here: {error}\n"
        outcome.value = error
    return outcome
