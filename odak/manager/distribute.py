"""Computation of a function for many arguments by several processes, GPUs and machines."""

import functools
import math
import reprlib
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from odak import _validate
from odak._attributes import Prepared
from odak._bars import tqdm
from odak.manager.backends import Cluster, Group, Job, Lost, Serial, Terms, choose
from odak.manager.server import LOOPBACK
from odak.manager.tasks import HERE, Outcome
from odak.tools import validate_path

ON_FAILURE = ("raise", "return")
_SHOWN = 3
# A task fails once its process has ended so many times, or once it was lost with so many workers.
_MOST_ENDS, _MOST_LOSSES = {"by itself": 2, "from outside": 4}, 10
_REFILL, _LOOK = 0.75, 5.0
_PER_SLOT, _AT_LEAST = 4, 128


class agent(Prepared):
    """Calls a function with many arguments, spread over the workers of a Dask cluster.

    Parameters
    ----------
    compute : callable, optional
        The function; not needed for :meth:`map`. It and its arguments and results must be picklable; functions of
        scripts and notebooks are.
    cluster : str, bool or object, optional
        Where the tasks run:

        - "local" or True: worker processes on this machine, one per GPU, or one per core where there is none.
        - the address of a Dask scheduler, such as "tls://10.0.0.1:8786".
        - a Dask cluster, such as `SLURMCluster`, `KubeCluster` or `SSHCluster`, or a Dask client.
        - False: this process, one task after another, without Dask.

        By default "local", or False where Dask is not installed.
    depends : sequence
        Code that `compute` needs and workers cannot import: modules, or functions of modules, which are sent with the
        tasks, and paths of ``.py`` and ``.zip`` files, which are copied to the workers.
    server : bool
        Start workers or a scheduler that others share. With an address, workers of this machine also join that
        scheduler; with "local", the scheduler listens on port 8786 of `host`, so that other machines can join with
        ``odak worker``.
    workers : int, optional
        Worker processes on this machine; see :func:`odak.manager.start_server`.
    threads : int, optional
        Threads that the numerical libraries of each worker use; on this machine, the cores shared evenly.
    gpu : bool
        Run tasks on workers with a GPU alone. There is one worker per GPU.
    retries : int
        How often a task that failed is tried again.
    chunk : int
        Number of tasks that are sent together; more than one is faster for tasks of a few milliseconds.
    in_flight : int, optional
        Groups of `chunk` tasks whose arguments the scheduler holds at a time; by default four per worker, at least
        128.
    direct : bool, optional
        Fetch results from the workers themselves rather than through the scheduler; by default with "local" alone.
    host : str
        Address of this machine that the scheduler listens on with `server` and "local"; see
        :func:`odak.manager.start_server`. Anything beyond this machine needs `security`.
    security : distributed.Security, path or True, optional
        TLS certificates; a path names a folder from :func:`odak.manager.make_certificates`.
    trusted_network : bool
        Accept unencrypted TCP to other machines. Anybody who can connect to the scheduler or to a worker can then run
        code there and, by the results that are unpickled, here.
    timeout : float, optional
        Longest time in seconds to wait for the scheduler and for the first worker; None waits without limit.
    verbose : bool
        Show a progress bar.

    Attributes
    ----------
    jobs : list
        Submitted tasks: (arguments, keywords).
    results : list
        Results of the last run in the order of submission, None where there is none yet.
    records : list of dict
        One per attempt of the last run: "index", "worker", "start" (seconds since the epoch), "seconds", "failed".
    client : distributed.Client
        Connection to the scheduler, None before the first run.
    in_flight : int
        As above; a change takes effect with the next run.

    Examples
    --------
    >>> from odak.manager import agent
    >>> with agent(divmod, cluster=False, verbose=False) as work:
    ...     work.submit((7, 2))
    ...     work.submit((9, 4))
    ...     work.run()
    0
    1
    [(3, 1), (2, 1)]
    """

    _fixed = ("cluster", "depends", "server")

    def __init__(
        self,
        compute: Callable[..., Any] | None = None,
        cluster: Any = None,
        depends: Sequence[ModuleType | Callable[..., Any] | str | Path] = (),
        server: bool = False,
        *,
        workers: int | None = None,
        threads: int | None = None,
        gpu: bool = False,
        retries: int = 1,
        chunk: int = 1,
        in_flight: int | None = None,
        direct: bool | None = None,
        host: str = LOOPBACK,
        security: Any = None,
        trusted_network: bool = False,
        timeout: float | None = 60.0,
        verbose: bool = True,
    ) -> None:
        _validate.function_or_none("compute", compute)
        self.compute: Callable[..., Any] | None = compute
        self.cluster: Any = cluster
        self.server: bool = _validate.flag("server", server)
        self.verbose: bool = _validate.flag("verbose", verbose)
        self.depends: list[ModuleType | Callable[..., Any] | str] = _checked_depends(depends)
        self._retries = _validate.integer("retries", retries)
        self._chunk = _validate.integer("chunk", chunk, minimum=1)
        self.in_flight: int | None = None if in_flight is None else _validate.integer("in_flight", in_flight, minimum=1)
        terms = Terms(workers, threads, gpu, direct, host, security, trusted_network, timeout)
        self._backend = choose(cluster, self.depends, self.server, terms)
        self.jobs: list[Job] = []
        self.results: list[Any] = []
        self.records: list[dict[Any, Any]] = []
        self._running: _Run | None = None
        self._closed = False

    @property
    def client(self) -> Any:
        """Connection to the scheduler: a `distributed.Client`, None before the first run and without Dask."""
        return self._backend.client

    def slots(self) -> int:
        """Return how many tasks the cluster runs at once, after :meth:`connect`."""
        return self._backend.slots()

    def submit(self, args: Sequence[Any], keywords: Mapping[str, Any] | None = None) -> int:
        """Add a task.

        Parameters
        ----------
        args : list or tuple
            Positional arguments of the function.
        keywords : dict, optional
            Keyword arguments.

        Returns
        -------
        int
            Number of the task, from 0.

        Raises
        ------
        TypeError
            If the arguments are not a list or tuple.
        """
        if self.compute is None:
            raise ValueError("compute must be given to the agent before tasks are submitted; map() takes a function")
        _validate.instance("args", args, (list, tuple), "a list or tuple of positional arguments")
        _validate.instance("keywords", keywords, (Mapping, type(None)), "a dictionary")
        self.jobs.append((tuple(args), dict(keywords or {})))
        return len(self.jobs) - 1

    def clear(self) -> None:
        """Remove all tasks and results."""
        self.jobs, self.results, self.records = [], [], []

    def connect(self) -> None:
        """Start the cluster or connect to it now rather than with the first run.

        Raises
        ------
        OSError
            If the scheduler cannot be reached, or no suitable worker joins within `timeout`.
        """
        if self._closed:
            raise RuntimeError("the agent is closed")
        self._backend.connect()

    def as_completed(self) -> Iterator[tuple[int, Any]]:
        """Run all tasks and yield each as it completes.

        Yields
        ------
        tuple
            Number of the task and its result, or a :class:`odak.manager.Failure` once all its attempts failed.
            Iteration ends early after :meth:`cancel`; leaving it early cancels the rest.

        Raises
        ------
        OSError
            If the cluster cannot be reached, or the connection to it is lost; `results` holds the results so far.
        """
        compute: Any = self.compute
        yield from self._compute(compute, list(self.jobs))

    def _compute(self, compute: Callable[..., Any], jobs: list[Job]) -> Iterator[tuple[int, Any]]:
        if self._running is not None:
            raise RuntimeError("the agent is running already")
        self.connect()
        self._backend.load(compute)
        self.results, self.records = [None] * len(jobs), []
        self._running = _Run(self._backend, jobs, self._retries, self.records, self._chunk, self.in_flight)
        try:
            with tqdm(total=len(jobs), desc=_name(compute), unit="task", disable=not self.verbose) as bar:
                failed = 0
                for index, result in self._running:
                    self.results[index] = result
                    bar.update()
                    if isinstance(result, Failure):
                        failed += 1
                        bar.set_postfix(failed=failed)
                    yield index, result
        finally:
            self._running = None
            self._backend.drop()

    def run(self, on_failure: str = "raise") -> list[Any]:
        """Run all tasks and return their results in the order of submission.

        Tasks are kept: a second run repeats them, unless :meth:`clear` has removed them.

        Parameters
        ----------
        on_failure : str
            "raise", or "return" to have a :class:`odak.manager.Failure` in the place of each result that is missing.

        Returns
        -------
        list
            One result per task.

        Raises
        ------
        TaskError
            If tasks failed in all their attempts, or were cancelled. All other tasks are complete by then, and their
            results are in its attribute ``results``.
        OSError
            If the cluster cannot be reached, or the connection to it is lost; `results` holds the results so far.
        """
        compute: Any = self.compute
        return self._collect(compute, list(self.jobs), on_failure)

    def map(
        self,
        function: Callable[..., Any],
        items: Iterable[Any],
        *,
        shared: Mapping[str, Any] | None = None,
        on_failure: str = "raise",
    ) -> list[Any]:
        """Call a function with each of some items and return the results in their order.

        Submitted tasks stay as they are; `results` and `records` then belong to this call.

        Parameters
        ----------
        function : callable
            Called as ``function(item, **shared)``.
        items : iterable
            First argument of each call.
        shared : dict, optional
            Keyword arguments that all calls have in common. They are sent once to each worker rather than with every
            task, and are kept by the process that runs its tasks: tasks must not modify them.
        on_failure : str
            "raise" or "return", as in :meth:`run`.

        Returns
        -------
        list
            One result per item.

        Raises
        ------
        TaskError, OSError
            As :meth:`run` does.

        Examples
        --------
        >>> from odak.manager import agent
        >>> with agent(cluster=False, verbose=False) as work:
        ...     work.map(round, [1.234, 2.345], shared={"ndigits": 1})
        [1.2, 2.3]
        """
        _validate.function("function", function)
        _validate.instance("items", items, Iterable, "an iterable")
        _validate.instance("shared", shared, (Mapping, type(None)), "a dictionary")
        compute = functools.partial(function, **shared) if shared else function
        return self._collect(compute, [((item,), {}) for item in items], on_failure)

    def _collect(self, compute: Callable[..., Any], jobs: list[Job], on_failure: str) -> list[Any]:
        on_failure = _validate.one_of("on_failure", on_failure, ON_FAILURE)
        missing = set(range(len(jobs)))
        for index, _ in self._compute(compute, jobs):
            missing.discard(index)
        for index in missing:
            self.results[index] = Failure(index, *jobs[index], CancelledError("cancelled before it was done"))
        failures = [result for result in self.results if isinstance(result, Failure)]
        if failures and on_failure == "raise":
            raise TaskError(failures, self.results) from failures[0].error
        return self.results

    def cancel(self) -> None:
        """End the run, from another thread or from within :meth:`as_completed`.

        Waiting tasks are not started. A task that a worker is running is completed there, and its result is discarded.
        """
        if self._running is not None:
            self._running.cancel()

    def close(self) -> bool:
        """Cancel running tasks and disconnect from the cluster; a cluster that this agent started is shut down."""
        self.cancel()
        self._closed = True
        self._backend.close()
        return True

    def __enter__(self) -> "agent":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


class _Run:
    """Run of tasks on a backend, a limited number at a time, which yields their results.

    Parameters
    ----------
    backend : Serial or Cluster
        Where tasks run.
    jobs : sequence
        Arguments and keywords of each task.
    retries : int
        How often a task that failed is tried again.
    records : list
        Where each attempt is noted.
    chunk : int
        Number of tasks that are sent together. Tasks that are tried again are sent one by one.
    in_flight : int, optional
        Groups that the backend is given at a time; by default enough for all its workers, also those that join later.
    """

    def __init__(
        self,
        backend: Serial | Cluster,
        jobs: Sequence[Job],
        retries: int,
        records: list[dict[Any, Any]],
        chunk: int,
        in_flight: int | None,
    ) -> None:
        self._backend, self._jobs, self._records = backend, jobs, records
        self._retries, self._given = retries, in_flight
        self._limit, self._looked = in_flight or 1, -math.inf
        self._waiting: deque[Group] = deque(
            range(start, min(start + chunk, len(jobs))) for start in range(0, len(jobs), chunk)
        )
        self._errors: Counter[int] = Counter()
        self._ends: Counter[int] = Counter()
        self._losses: Counter[int] = Counter()
        self._started = 0
        self._cancelled = threading.Event()

    def cancel(self) -> None:
        """End the run, from any thread."""
        self._cancelled.set()
        self._backend.wake()

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        """Yield the number of each task and its result, or its Failure."""
        while (self._waiting or self._started) and not self._cancelled.is_set():
            self._start()
            for group, back in self._wait():
                self._started -= 1
                if isinstance(back, BaseException):
                    yield from self._without_outcome(group, back)
                else:
                    for index, outcome in zip(group, back, strict=True):
                        yield from self._done(index, outcome)

    def _wait(self) -> list[tuple[Group, list[Outcome] | BaseException]]:
        try:
            return self._backend.wait()
        except OSError:
            if self._cancelled.is_set():  # closed by another thread, not lost
                return []
            raise

    def _start(self) -> None:
        if self._given is None and time.monotonic() > self._looked + _LOOK:
            self._looked, self._limit = time.monotonic(), max(_AT_LEAST, _PER_SLOT * self._backend.slots())
        # In large groups: the scheduler accepts a thousand tasks at once in the time of a few single ones.
        if not self._waiting or self._started > _REFILL * self._limit:
            return
        groups = []
        while self._waiting and (not self._started or self._started < self._limit):
            groups.append(self._waiting.popleft())
            self._started += 1
        self._backend.start([(group, [self._jobs[index] for index in group]) for group in groups])

    def _done(self, index: int, outcome: Outcome) -> Iterator[tuple[int, Any]]:
        self._records.append(
            {
                "index": index,
                "worker": outcome.worker,
                "start": outcome.start,
                "seconds": outcome.seconds,
                "failed": outcome.failed,
            }
        )
        if not outcome.failed:
            yield index, outcome.value
            return
        counted, limit = self._errors, self._retries + 1
        if outcome.ended:
            counted, limit = self._ends, _MOST_ENDS[outcome.ended]
        counted[index] += 1
        if counted[index] >= limit:
            yield index, self._failure(index, outcome.value, outcome.trace, outcome.worker)
        elif outcome.ended:
            self._waiting.appendleft((index,))
        else:
            self._waiting.append((index,))

    def _without_outcome(self, group: Group, error: BaseException) -> Iterator[tuple[int, Any]]:
        """Queue again tasks that could not be sent, or whose worker was lost."""
        lost = isinstance(error, Lost)
        for index in group:
            # A loss is not an attempt; the task of a group that cannot be sent is found by sending each alone.
            self._losses[index] += lost
            self._errors[index] += len(group) == 1 and not lost
            if self._errors[index] <= self._retries and self._losses[index] < _MOST_LOSSES:
                self._waiting.append((index,))
            else:
                yield index, self._failure(index, error, "", "" if lost else HERE)

    def _failure(self, index: int, error: BaseException, trace: str, worker: str) -> "Failure":
        attempts = self._errors[index] + self._ends[index]
        return Failure(index, *self._jobs[index], error, trace, attempts, worker)


@dataclass
class Failure:
    """A task that failed in every attempt.

    Attributes
    ----------
    index : int
        Its number, from 0 in the order of submission.
    arguments : tuple
        Its positional arguments.
    keywords : dict
        Its keyword arguments.
    error : BaseException
        Exception of the last attempt; `concurrent.futures.CancelledError` if it was cancelled.
    trace : str
        Traceback of the last attempt, as text from the worker.
    attempts : int
        How often it was tried.
    worker : str
        Address of the worker of the last attempt.

    Examples
    --------
    >>> from odak.manager import TaskError, agent
    >>> with agent(divmod, cluster=False, retries=0, verbose=False) as work:
    ...     _ = work.submit((7, 0))
    ...     try:
    ...         work.run()
    ...     except TaskError as error:
    ...         failure = error.failures[0]
    >>> failure.index, failure.arguments, type(failure.error).__name__
    (0, (7, 0), 'ZeroDivisionError')
    """

    index: int
    arguments: tuple[Any, ...]
    keywords: dict[Any, Any]
    error: BaseException
    trace: str = field(default="", repr=False)
    attempts: int = 0
    worker: str = ""

    def __str__(self) -> str:
        """Return one line: what was called, what it raised and where."""
        call = ", ".join([*map(describe, self.arguments), *(f"{k}={describe(v)}" for k, v in self.keywords.items())])
        tried = f" ({self.attempts} attempts, the last on {self.worker})" if self.attempts else ""
        hint = (
            "; name it in depends= if workers cannot import it" if isinstance(self.error, ModuleNotFoundError) else ""
        )
        return f"task {self.index} with arguments ({call}): {type(self.error).__name__}: {self.error}{hint}{tried}"


class TaskError(RuntimeError):
    """Error of a run in which tasks failed in all their attempts; all other tasks are complete.

    Attributes
    ----------
    failures : list of Failure
        Tasks that failed, in the order of submission.
    results : list
        Results in the order of submission, a :class:`Failure` in the place of each that failed.

    Examples
    --------
    The results of all other tasks are kept:

    >>> from odak.manager import TaskError, agent
    >>> with agent(divmod, cluster=False, retries=0, verbose=False) as work:
    ...     _ = work.submit((7, 2)), work.submit((7, 0))
    ...     try:
    ...         work.run()
    ...     except TaskError as error:
    ...         print(error.results[0], len(error.failures))
    (3, 1) 1
    """

    def __init__(self, failures: list[Failure], results: list[Any]) -> None:
        self.failures: list[Failure] = failures
        self.results: list[Any] = results
        super().__init__(failures, results)

    def __str__(self) -> str:
        """Return the failures with their arguments, and the tracebacks of the first ones."""
        lines = [f"{len(self.failures)} of {len(self.results)} tasks failed; the results of the others are in .results"]
        for failure in self.failures[:_SHOWN]:
            lines += [str(failure), *("    " + line for line in failure.trace.rstrip().splitlines())]
        if len(self.failures) > _SHOWN:
            lines.append(f"and {len(self.failures) - _SHOWN} more, see .failures")
        return "\n".join(lines)


def describe(value: Any) -> str:
    """Return a short description of a value: arrays by type, shape and precision, long texts and lists truncated."""
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and dtype is not None:
        return f"{type(value).__name__}{list(shape)} of {dtype}"
    return reprlib.repr(value)


def _checked_depends(depends: Sequence[Any]) -> list[ModuleType | Callable[..., Any] | str]:
    if isinstance(depends, (str, Path, ModuleType)) or callable(depends):
        depends = [depends]
    _validate.instance("depends", depends, Iterable, "modules, functions or paths")
    checked: list[ModuleType | Callable[..., Any] | str] = []
    for item in depends:
        if isinstance(item, (str, Path)):
            path = validate_path(item, allowed_extensions=[".py", ".zip"], name="depends")
            if not Path(path).is_file():
                raise ValueError(f"depends must name existing files, got {path!r}")
            checked.append(path)
        elif isinstance(item, ModuleType) or callable(item):
            checked.append(item)
        else:
            raise TypeError(f"depends must be modules, functions or paths, got {type(item).__name__}")
    return checked


def _name(compute: Callable[..., Any]) -> str:
    function = compute.func if isinstance(compute, functools.partial) else compute
    return getattr(function, "__name__", type(function).__name__)
