"""Figures of Matplotlib that notebooks show, their files, and the colours that all of them have."""

import io
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from odak import _show

INK, FAINT = "#202020", "#9a9a9a"


class Drawing(Figure):
    """A figure that a notebook shows as the last line of a cell, whether or not pyplot is in use."""

    def __init__(self, *arguments: Any, **options: Any):
        super().__init__(*arguments, **options)
        FigureCanvasAgg(self)

    def _repr_html_(self) -> str:
        return f'<img style="max-width:100%" alt="figure" src="{_show.source(svg(self))}">'


def subplots(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Figure, np.ndarray]:
    """Return a figure of a size in inches, and its axes ``[rows, columns]``.

    Parameters
    ----------
    rows, columns : int
        Numbers of axes below and beside each other.
    size : tuple of float
        Width and height in inches.
    **options
        Of :meth:`matplotlib.figure.Figure.subplots`.
    """
    figure = Drawing(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def color_of(i: int) -> str:
    """Return the colour of a field or a wavelength by its number."""
    return _show.COLOURS[i % len(_show.COLOURS)]


def png(figure: Figure, dpi: float = 140) -> bytes:
    """Return a figure as a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return stream.getvalue()


def svg(figure: Figure) -> str:
    """Return a figure as the text of an SVG file that has its letters as letters."""
    stream = io.StringIO()
    # Equal figures give equal files.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "odak"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    return stream.getvalue()
