"""Lines of a text file, each with a label that says what it is."""

import os
import sys
from collections.abc import Sequence
from numbers import Integral
from types import ModuleType

from odak.tools._documents import read_text_file


class LabelledText:
    """Lines of a text file without leading spaces, and a label for each.

    Attributes
    ----------
    filename : str
        The file.
    content : list of str
        Its lines.
    content_type : list of str
        Their labels.
    """

    def __init__(self, filename: str | os.PathLike):
        self.filename = filename
        self.content = [line.lstrip(" ") for line in read_text_file(filename)]
        self.content_type = self._labels()

    def _labels(self) -> list[str]:
        raise NotImplementedError

    def get_line_count(self) -> int:
        """Return the number of lines, which ``line_count`` holds from then on."""
        self.line_count = len(self.content)
        return self.line_count

    def get_line(self, line_id: int = 0) -> tuple[str, str]:
        """Return a line and its label.

        Parameters
        ----------
        line_id : int
            Number of the line, from 0.

        Returns
        -------
        tuple of str
            The line and its label.

        Raises
        ------
        IndexError
            If there is no such line.
        """
        if isinstance(line_id, bool) or not isinstance(line_id, Integral):
            raise TypeError(f"line_id must be an integer, got {type(line_id).__name__}")
        return self.content[line_id], self.content_type[line_id]


def holds(line: str, entries: Sequence[str]) -> bool:
    """Say whether a line holds one of the entries."""
    return any(entry in line for entry in entries)


class _CallableModule(ModuleType):
    def __call__(self, *arguments, **named):
        return getattr(self, self.__name__.rpartition(".")[2])(*arguments, **named)


def make_callable(module: str) -> None:
    """Let a module stand for the class of its name, which callers reach by both: `tools.latex` is either."""
    sys.modules[module].__class__ = _CallableModule
