"""Markdown files line by line: which line is text, which is markup or code."""

from collections.abc import Sequence

from odak._validate import texts
from odak.tools._labelled_text import LabelledText, holds, make_callable

__all__ = ["markdown"]


class markdown(LabelledText):
    """Lines of a Markdown file and what each is: "empty", "comment", "markdown" or "text".

    Lines between two fences are "markdown", the fences included; empty ones stay "empty". A comment begins with % or
    with an HTML comment mark.

    Parameters
    ----------
    filename : str or os.PathLike
        File to read.

    Attributes
    ----------
    content, content_type : list of str
        Lines without leading spaces, and their labels.
    markdown_dictionary, markdown_begin_dictionary, markdown_end_dictionary : list of str
        What marks a line, and what opens and closes a fence.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    """

    def __init__(self, filename):
        self.markdown_dictionary = ["#"]
        self.markdown_begin_dictionary = ["```bash", "```python", "```"]
        self.markdown_end_dictionary = ["```"]
        self.content_type: list[str] = []
        super().__init__(filename)

    def set_dictonaries(
        self, begin_dictionary: Sequence[str], end_dictionary: Sequence[str], syntax_dictionary: Sequence[str]
    ) -> None:
        """Replace the lists and label all lines anew.

        Parameters
        ----------
        begin_dictionary, end_dictionary : sequence of str
            What opens and what closes a fence.
        syntax_dictionary : sequence of str
            What marks a line.
        """
        begin, end = texts("begin_dictionary", begin_dictionary), texts("end_dictionary", end_dictionary)
        syntax = texts("syntax_dictionary", syntax_dictionary)
        self.markdown_begin_dictionary, self.markdown_end_dictionary, self.markdown_dictionary = begin, end, syntax
        self.content_type = self._labels()

    def _labels(self) -> list[str]:
        labels, inside = [], False
        for line in self.content:
            fence = holds(line, self.markdown_end_dictionary) if inside else self._opens(line)
            if not line:
                labels.append("empty")
            elif inside or fence or holds(line, self.markdown_dictionary):
                labels.append("comment" if not (inside or fence) and line.startswith("<!--") else "markdown")
            else:
                labels.append("comment" if line.startswith(("%", "<!--")) else "text")
            inside ^= fence
        return labels

    def _opens(self, line: str) -> bool:
        """Say whether a line opens a fence that it does not close again."""
        places = [line.index(entry) + len(entry) for entry in self.markdown_begin_dictionary if entry in line]
        return bool(places) and not holds(line[max(places) :], self.markdown_end_dictionary)


make_callable(__name__)
