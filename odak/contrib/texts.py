"""Lines of Markdown and LaTeX documents, each with a label of its kind."""

import os
from collections.abc import Sequence
from numbers import Integral

from odak._validate import texts
from odak.tools.file import read_text_file


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

    def __init__(self, filename: str | os.PathLike[str]):
        self.filename = filename
        self.content: list[str] = [line.lstrip(" ") for line in read_text_file(filename)]
        self.content_type: list[str] = self._labels()

    def _labels(self) -> list[str]:
        raise NotImplementedError(f"{type(self).__name__} must define _labels()")

    def get_line_count(self) -> int:
        """Return the number of lines, which is also stored in ``line_count``."""
        self.line_count: int = len(self.content)
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
        count = len(self.content)
        if not -count <= line_id < count:
            raise IndexError(f"line_id must be 0 to {count - 1}, got {line_id}: {self.filename!r} has {count} lines")
        return self.content[line_id], self.content_type[line_id]


def holds(line: str, entries: Sequence[str]) -> bool:
    """Return whether a line holds one of the entries."""
    return any(entry in line for entry in entries)


class markdown(LabelledText):
    """Lines of a Markdown file with a label for each: "empty", "comment", "markdown" or "text".

    Lines between two fences are "markdown", the fences included; empty ones stay "empty". A comment begins with % or
    with an HTML comment mark.

    Parameters
    ----------
    filename : str or os.PathLike
        File to read.

    Attributes
    ----------
    content : list of str
        Lines without leading spaces.
    content_type : list of str
        Labels of the lines.
    markdown_dictionary : list of str
        Entries that mark a line as Markdown.
    markdown_begin_dictionary : list of str
        Entries that open a fence.
    markdown_end_dictionary : list of str
        Entries that close a fence.

    Raises
    ------
    FileNotFoundError
        If there is no such file.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import markdown, write_to_text_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "a.md")
    ...     written = write_to_text_file(["Some words.", "", "```", "code", "```"], name)
    ...     markdown(name).content_type
    ['text', 'empty', 'markdown', 'markdown', 'markdown']
    """

    def __init__(self, filename: str | os.PathLike[str]):
        self.markdown_dictionary: list[str] = ["#"]
        self.markdown_begin_dictionary: list[str] = ["```bash", "```python", "```"]
        self.markdown_end_dictionary: list[str] = ["```"]
        self.content_type: list[str] = []
        super().__init__(filename)

    def set_dictonaries(
        self, begin_dictionary: Sequence[str], end_dictionary: Sequence[str], syntax_dictionary: Sequence[str]
    ) -> None:
        """Replace the lists and label all lines anew.

        Parameters
        ----------
        begin_dictionary : sequence of str
            Entries that open a fence.
        end_dictionary : sequence of str
            Entries that close a fence.
        syntax_dictionary : sequence of str
            Entries that mark a line.
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
        """Return whether a line opens a fence that it does not close again."""
        places = [line.index(entry) + len(entry) for entry in self.markdown_begin_dictionary if entry in line]
        return bool(places) and not holds(line[max(places) :], self.markdown_end_dictionary)


# Split below, so that the lists can be read.
_ENVIRONMENTS = "figure figure* equation CCSXML teaserfigure table* table gather align"
_COMMANDS = r"""
    \documentclass \if \pdf \else \fi \vgtc \teaser \abstract \CCS \usepackage \PassOptionsToPackage \definecolor
    \AtBeginDocument \providecommand \setcopyright \copyrightyear \acmYear \citestyle \newcommand \acmDOI
    \newabbreviation \global \begin{document} \author \affiliation \email \institution \streetaddress \city \country
    \postcode \ccsdesc \received \includegraphics \caption \centering \label \maketitle \toprule \multirow \multicolumn
    \cmidrule \addlinespace \midrule \cellcolor \bibliography \title \bottomrule \item \begin{abstract} \end{abstract}
    \endinput \\ } </ccs2012> <concept> <concept <ccs </concept
"""


class latex(LabelledText):
    r"""Lines of a LaTeX file with a label for each: "empty", "comment", "latex" or "text".

    A line is "latex" when it holds an entry of one of the lists, or lies between the begin and the end of an
    environment; empty lines and comments keep their type.

    Parameters
    ----------
    filename : str or os.PathLike
        File to read.

    Attributes
    ----------
    content : list of str
        Lines without leading spaces.
    content_type : list of str
        Labels of the lines.
    latex_dictionary : list of str
        Entries that mark a line as LaTeX.
    latex_begin_dictionary : list of str
        Entries that open an environment.
    latex_end_dictionary : list of str
        Entries that close an environment.

    Raises
    ------
    FileNotFoundError
        If there is no such file.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import latex, write_to_text_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "a.tex")
    ...     written = write_to_text_file(["Some words.", "% a remark", r"\section{Title}"], name)
    ...     latex(name).content_type
    ['text', 'comment', 'latex']
    """

    def __init__(self, filename: str | os.PathLike[str]):
        self.latex_dictionary: list[str] = _COMMANDS.split()
        self.latex_begin_dictionary: list[str] = [rf"\begin{{{name}}}" for name in _ENVIRONMENTS.split()]
        self.latex_end_dictionary: list[str] = [rf"\end{{{name}}}" for name in _ENVIRONMENTS.split()]
        self.content_type: list[str] = []
        super().__init__(filename)

    def set_latex_dictonaries(
        self, begin_dictionary: Sequence[str], end_dictionary: Sequence[str], syntax_dictionary: Sequence[str]
    ) -> None:
        """Replace the lists and label all lines anew.

        Parameters
        ----------
        begin_dictionary : sequence of str
            Entries that open an environment.
        end_dictionary : sequence of str
            Entries that close an environment.
        syntax_dictionary : sequence of str
            Entries that mark a line.
        """
        begin, end = texts("begin_dictionary", begin_dictionary), texts("end_dictionary", end_dictionary)
        syntax = texts("syntax_dictionary", syntax_dictionary)
        self.latex_begin_dictionary, self.latex_end_dictionary, self.latex_dictionary = begin, end, syntax
        self.content_type = self._labels()

    def _labels(self) -> list[str]:
        labels, depth = [], 0
        for line in self.content:
            if not line:
                labels.append("empty")
                continue
            if line.startswith("%"):
                labels.append("comment")
                continue
            opened = sum(line.count(entry) for entry in self.latex_begin_dictionary)
            closed = sum(line.count(entry) for entry in self.latex_end_dictionary)
            marked = depth > 0 or opened or closed or holds(line, self.latex_dictionary)
            labels.append("latex" if marked else "text")
            depth = max(depth + opened - closed, 0)
        return labels


# The class is reached as odak.tools.latex and, as in Odak 0.2, where that was a module, as odak.tools.latex.latex.
latex.latex = latex  # type: ignore[attr-defined]
markdown.markdown = markdown  # type: ignore[attr-defined]
