r"""LaTeX files line by line: which line is text, which is markup."""

from collections.abc import Sequence

from odak._validate import texts
from odak.tools._labelled_text import LabelledText, holds, make_callable

__all__ = ["latex"]

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
    r"""Lines of a LaTeX file and what each is: "empty", "comment", "latex" or "text".

    A line is "latex" when it holds an entry of one of the lists, or lies between the begin and the end of an
    environment; empty lines and comments stay what they are.

    Parameters
    ----------
    filename : str or os.PathLike
        File to read.

    Attributes
    ----------
    content, content_type : list of str
        Lines without leading spaces, and their labels.
    latex_dictionary, latex_begin_dictionary, latex_end_dictionary : list of str
        What marks a line, and what opens and closes an environment.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    """

    def __init__(self, filename):
        self.latex_dictionary = _COMMANDS.split()
        self.latex_begin_dictionary = [rf"\begin{{{name}}}" for name in _ENVIRONMENTS.split()]
        self.latex_end_dictionary = [rf"\end{{{name}}}" for name in _ENVIRONMENTS.split()]
        self.content_type: list[str] = []
        super().__init__(filename)

    def set_latex_dictonaries(
        self, begin_dictionary: Sequence[str], end_dictionary: Sequence[str], syntax_dictionary: Sequence[str]
    ) -> None:
        """Replace the lists and label all lines anew.

        Parameters
        ----------
        begin_dictionary, end_dictionary : sequence of str
            What opens and what closes an environment.
        syntax_dictionary : sequence of str
            What marks a line.
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


make_callable(__name__)
