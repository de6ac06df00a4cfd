"""The course of a run: which tasks fly, which come back, which are tried again."""

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from typing import Any

from odak.manager.backends import Backend, Group, Job
from odak.manager.failures import Failure
from odak.manager.tasks import HERE, Outcome

_REFILL, _LOOK = 0.75, 5.0
_PER_SLOT, _AT_LEAST = 4, 128


class Rounds:
    """Hands tasks to a backend, a limited number at a time, and yields what comes of them.

    Parameters
    ----------
    backend : Backend
        Where tasks run.
    jobs : sequence
        Arguments and keywords of each task.
    retries : int
        How often a task that failed is tried again.
    records : list
        Where each attempt is noted.
    chunk : int
        Tasks that travel together. Those that are tried again travel alone.
    in_flight : int, optional
        Groups that the backend is given at a time; by default enough for all its workers, also those that join later.
    """

    def __init__(
        self,
        backend: Backend,
        jobs: Sequence[Job],
        retries: int,
        records: list[dict],
        chunk: int,
        in_flight: int | None,
    ) -> None:
        self._backend, self._jobs, self._records = backend, jobs, records
        self._tries, self._in_flight, self._looked = retries + 1, in_flight or 1, -math.inf
        self._given = in_flight
        self._waiting: deque[Sequence[int]] = deque(
            range(start, min(start + chunk, len(jobs))) for start in range(0, len(jobs), chunk)
        )
        self._attempts: Counter[int] = Counter()
        self._flying = 0
        self._cancelled = threading.Event()

    def cancel(self) -> None:
        """End the run, from any thread."""
        self._cancelled.set()
        self._backend.wake()

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        """Yield the number of each task and its result, or its Failure."""
        while (self._waiting or self._flying) and not self._cancelled.is_set():
            self._fill()
            for group, back in self._wait():
                self._flying -= 1
                if isinstance(back, BaseException):
                    yield from self._lost(group, back)
                    continue
                for index, outcome in zip(group, back, strict=True):
                    yield from self._landed(index, outcome)

    def _wait(self) -> list[tuple[Group, list[Outcome] | BaseException]]:
        try:
            return self._backend.wait()
        except OSError:
            if self._cancelled.is_set():  # closed by another thread, not lost
                return []
            raise

    def _fill(self) -> None:
        # In larger parts rather than one by one: the scheduler takes a thousand tasks at once in the time of a few.
        limit = self._limit()
        if not self._waiting or self._flying > _REFILL * limit:
            return
        groups = []
        while self._waiting and (not self._flying or self._flying < limit):
            groups.append(self._waiting.popleft())
            self._flying += 1
        if groups:
            self._backend.start([(group, [self._jobs[index] for index in group]) for group in groups])

    def _limit(self) -> int:
        if self._given is None and time.monotonic() > self._looked + _LOOK:
            self._looked, self._in_flight = time.monotonic(), max(_AT_LEAST, _PER_SLOT * self._backend.slots())
        return self._in_flight

    def _landed(self, index: int, outcome: Outcome) -> Iterator[tuple[int, Any]]:
        self._attempts[index] += 1
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
        elif self._attempts[index] < self._tries:
            self._waiting.append((index,))
        else:
            yield index, self._failure(index, outcome.value, outcome.trace, outcome.worker)

    def _lost(self, group: Sequence[int], error: BaseException) -> Iterator[tuple[int, Any]]:
        """Take back tasks that could not be sent, or that Dask gave up on as every worker that had them ended."""
        for index in group:
            # Which of a group it was is not known until each has gone alone.
            self._attempts[index] += len(group) == 1
            if self._attempts[index] < self._tries:
                self._waiting.append((index,))
            else:
                killed = type(error).__name__ == "KilledWorker"
                yield index, self._failure(index, error, "", "several workers" if killed else HERE)

    def _failure(self, index: int, error: BaseException, trace: str, worker: str) -> Failure:
        return Failure(index, *self._jobs[index], error, trace, self._attempts[index], worker)
