"""Tasks that failed, and how that is said."""

import reprlib
from dataclasses import dataclass, field
from typing import Any

_SHOWN = 3


@dataclass
class Failure:
    """A task that failed in every attempt.

    Attributes
    ----------
    index : int
        Its number, from 0 in the order of submission.
    arguments : tuple
        What it was called with.
    keywords : dict
        Its keyword arguments.
    error : BaseException
        What the last attempt raised; `concurrent.futures.CancelledError` if it was cancelled.
    trace : str
        Traceback of the last attempt, as text from the worker.
    attempts : int
        How often it was tried.
    worker : str
        Where the last attempt ran.
    """

    index: int
    arguments: tuple
    keywords: dict
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
    """Some tasks failed after all their attempts, and all others are done.

    Attributes
    ----------
    failures : list of Failure
        What failed, in the order of submission.
    results : list
        Results in the order of submission, a :class:`Failure` in the place of each that failed.
    """

    def __init__(self, failures: list[Failure], results: list[Any]) -> None:
        self.failures, self.results = failures, results
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
    """Return a value in few words: arrays by type, shape and precision, long texts and lists cut short."""
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and dtype is not None:
        return f"{type(value).__name__}{list(shape)} of {dtype}"
    return reprlib.repr(value)
