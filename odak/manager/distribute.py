"""The agent: one function, many arguments, as many processes, GPUs and machines as there are."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from pathlib import Path
from types import ModuleType
from typing import Any

from tqdm import tqdm

from odak import _validate
from odak.manager.backends import Job, choose
from odak.manager.failures import Failure, TaskError
from odak.manager.rounds import Rounds
from odak.tools import validate_path

__all__ = ["agent"]

ON_FAILURE = ("raise", "return")


class agent:
    """Calls a function with many arguments, spread over the workers of a Dask cluster.

    Parameters
    ----------
    compute : callable
        The function. It and its arguments and results must be picklable; functions of scripts and notebooks are.
    cluster : str, bool or object, optional
        Where the work is done:

        - "local" or True: worker processes on this machine, one per GPU, or one per core where there is none.
        - the address of a Dask scheduler, such as "tcp://10.0.0.1:8786".
        - a Dask cluster, such as `SLURMCluster`, `KubeCluster` or `SSHCluster`, or a Dask client.
        - False: this process, one task after another, without Dask.

        By default "local", or False where Dask is not installed.
    depends : sequence
        What `compute` needs and workers cannot import: modules, or functions of them, which travel along, and paths of
        ``.py`` and ``.zip`` files, which are copied to the workers.
    server : bool
        Take part as a server. With an address, this machine's cores or GPUs work for that scheduler too; with "local",
        the scheduler listens on every network of this machine, so that others can join with ``odak worker``.
    workers : int, optional
        Worker processes on this machine; see :func:`odak.manager.start_server`.
    threads : int, optional
        Threads that the numerical libraries of each worker use; on this machine, the cores shared evenly.
    gpu : bool
        Run tasks on workers with a GPU alone. There is one worker per GPU.
    retries : int
        How often a task that failed is tried again.
    chunk : int
        Tasks that travel together; for tasks of a few milliseconds.
    in_flight : int, optional
        Parcels of `chunk` tasks whose arguments the scheduler holds at a time; by default four per worker, at least
        128.
    direct : bool, optional
        Fetch results from the workers themselves rather than through the scheduler; by default with "local" alone.
    security : distributed.Security, optional
        TLS certificates.
    timeout : float, optional
        Seconds that the scheduler and a first worker may take to be there; None waits for ever.
    verbose : bool
        Show a progress bar.

    Attributes
    ----------
    jobs : list
        What was submitted: (arguments, keywords).
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

    def __init__(
        self,
        compute: Callable,
        cluster: Any = None,
        depends: Sequence[ModuleType | Callable | str | Path] = (),
        server: bool = False,
        *,
        workers: int | None = None,
        threads: int | None = None,
        gpu: bool = False,
        retries: int = 1,
        chunk: int = 1,
        in_flight: int | None = None,
        direct: bool | None = None,
        security: Any = None,
        timeout: float | None = 60.0,
        verbose: bool = True,
    ) -> None:
        if not callable(compute):
            raise TypeError(f"compute must be callable, got {type(compute).__name__}")
        self.compute, self.cluster = compute, cluster
        self.server, self.verbose = _validate.flag("server", server), _validate.flag("verbose", verbose)
        if direct is not None:
            direct = _validate.flag("direct", direct)
        if not (security is None or isinstance(security, (bool, dict)) or hasattr(security, "get_connection_args")):
            raise TypeError(f"security must be a distributed.Security, got {type(security).__name__}")
        self.depends = _checked_depends(depends)
        self._retries = _validate.integer("retries", retries)
        for name, count in (("workers", workers), ("threads", threads)):
            if count is not None:
                _validate.integer(name, count, minimum=1)
        self._chunk = _validate.integer("chunk", chunk, minimum=1)
        self.in_flight = None if in_flight is None else _validate.integer("in_flight", in_flight, minimum=1)
        if timeout is not None:
            _validate.real("timeout", timeout, positive=True)
        self._backend = choose(
            compute,
            cluster,
            self.depends,
            self.server,
            workers=workers,
            threads=threads,
            gpu=_validate.flag("gpu", gpu),
            direct=direct,
            security=security,
            timeout=timeout,
        )
        self.jobs: list[Job] = []
        self.results: list[Any] = []
        self.records: list[dict] = []
        self._running: Rounds | None = None
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
        if not isinstance(args, (list, tuple)):
            raise TypeError(f"args must be a list or tuple of positional arguments, got {type(args).__name__}")
        if not isinstance(keywords, (Mapping, type(None))):
            raise TypeError(f"keywords must be a dictionary, got {type(keywords).__name__}")
        self.jobs.append((tuple(args), dict(keywords or {})))
        return len(self.jobs) - 1

    def clear(self) -> None:
        """Forget all tasks and results."""
        self.jobs, self.results, self.records = [], [], []

    def connect(self) -> None:
        """Start or reach the cluster now rather than with the first run.

        Raises
        ------
        OSError
            If the scheduler cannot be reached or no fitting worker is there in time.
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
            If the cluster is not there, or goes away; :attr:`results` holds what is done.
        """
        if self._running is not None:
            raise RuntimeError("the agent is running already")
        self.connect()
        jobs = list(self.jobs)
        self.results, self.records = [None] * len(jobs), []
        self._running = Rounds(self._backend, jobs, self._retries, self.records, self._chunk, self.in_flight)
        try:
            with tqdm(total=len(jobs), desc=_name(self.compute), unit="task", disable=not self.verbose) as bar:
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

        Tasks are kept: a second run repeats them, unless :meth:`clear` forgets them.

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
            If tasks failed in all their attempts, or were cancelled; all others are done by then, and their results in
            its attribute ``results``.
        OSError
            If the cluster is not there, or goes away; :attr:`results` holds what is done.
        """
        on_failure = _validate.one_of("on_failure", on_failure, ON_FAILURE)
        missing = set(range(len(self.jobs)))
        for index, _ in self.as_completed():
            missing.discard(index)
        for index in missing:
            self.results[index] = Failure(index, *self.jobs[index], CancelledError("cancelled before it was done"))
        failures = [result for result in self.results if isinstance(result, Failure)]
        if failures and on_failure == "raise":
            raise TaskError(failures, self.results) from failures[0].error
        return self.results

    def cancel(self) -> None:
        """End the run, from another thread or from within :meth:`as_completed`.

        What waits is not begun. What runs on a worker runs on to its end there, and its result is dropped.
        """
        if self._running is not None:
            self._running.cancel()

    def close(self) -> bool:
        """Cancel what runs, and leave the cluster; one that this agent started ends."""
        self.cancel()
        self._closed = True
        self._backend.close()
        return True

    def __enter__(self) -> "agent":
        return self

    def __exit__(self, *_) -> None:
        self.close()


def _checked_depends(depends: Sequence) -> list[ModuleType | Callable | str]:
    if isinstance(depends, (str, Path, ModuleType)) or callable(depends):
        depends = [depends]
    if not isinstance(depends, Iterable):
        raise TypeError(f"depends must be modules, functions or paths, got {type(depends).__name__}")
    checked = []
    for item in depends:
        if isinstance(item, (str, Path)):
            path = validate_path(item, allowed_extensions=[".py", ".zip"], name="depends")
            if not Path(path).is_file():
                raise ValueError(f"depends names a file that is not there: {path!r}")
            checked.append(path)
        elif isinstance(item, ModuleType) or callable(item):
            checked.append(item)
        else:
            raise TypeError(f"depends must be modules, functions or paths, got {type(item).__name__}")
    return checked


def _name(compute: Callable) -> str:
    return getattr(compute, "__name__", type(compute).__name__)
