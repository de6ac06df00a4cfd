"""Base class of figures: layout, display, and files as pages, Markdown and images; checks of their arguments."""

import os
import re
import sys
import tempfile
import webbrowser
from collections.abc import Iterable, Mapping
from numbers import Real
from pathlib import Path
from typing import Any

from odak import _validate
from odak.log import logger
from odak.tools.paths import extension_of, replacing, validate_path
from odak.visualize.plotly import browser, figure_style

try:
    import plotly.graph_objects as graph
    import plotly.io as page
    from plotly.subplots import make_subplots as make_subplots
except ImportError as error:
    raise ImportError("odak.visualize.plotly needs the package plotly: pip install plotly kaleido") from error

IMAGES = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".webp": "webp", ".svg": "svg", ".pdf": "pdf"}


HTML, MARKDOWN = (".html", ".htm"), (".md", ".markdown")
_BROWSER_RENDERERS = {"", "browser", "firefox", "chrome", "chromium"}
_folder: Path | None = None


class Figure:
    """A Plotly figure with its settings; base class of all figures.

    Attributes
    ----------
    fig : plotly.graph_objects.Figure
        The figure; its traces are ``fig.data``.
    settings : dict
        Settings of the layout, read each time the figure is shown or saved.
    """

    def __init__(self, figure, settings: dict):
        self.fig = figure
        self.settings = settings
        self._notes: list[str] = []

    def update_layout(self) -> None:
        """Apply the settings to the figure; done before it is shown or saved."""
        figure_style.apply(self.fig, self.settings)
        figure_style.note(self.fig, "; ".join(self._notes))

    def show(self) -> str | None:
        """Show the figure in the notebook or in a browser, without waiting for a window.

        Returns
        -------
        str or None
            Path of the page that was written, None in a notebook. Without a display the page is only written.
        """
        self.update_layout()
        return show(self.fig)

    def save_html(self, filename: str | os.PathLike = "plot.html", plotlyjs: bool | str = True) -> str:
        """Save the figure as a page, without opening it.

        Parameters
        ----------
        filename : str or os.PathLike
            A ``.html`` file, written atomically.
        plotlyjs : bool or str
            True writes plotly.js into the page (5 MB, works without a network); "cdn" lets the page fetch it.

        Returns
        -------
        str
            The figure as a ``<div>`` without plotly.js, for a page that has it.
        """
        self.update_layout()
        return write_html(self.fig, filename, plotlyjs)

    def save_markdown(self, filename: str | os.PathLike = "plot.md", plotlyjs: bool | str = False) -> str:
        """Save the figure as a ``<div>`` for a Markdown page.

        Parameters
        ----------
        filename : str or os.PathLike
            A ``.md`` file, written atomically.
        plotlyjs : bool or str
            False, for a page that loads plotly.js itself; True writes plotly.js into the text, "cdn" a link to it.

        Returns
        -------
        str
            The text written.
        """
        self.update_layout()
        return write_markdown(self.fig, filename, plotlyjs)

    def save_image(self, filename: str | os.PathLike, scale: float = 1.0) -> None:
        """Save the figure as an image.

        Parameters
        ----------
        filename : str or os.PathLike
            A ``.png``, ``.jpg``, ``.webp``, ``.svg`` or ``.pdf`` file, written
            atomically.
        scale : float
            Image pixels per pixel of the figure's width and height.

        Raises
        ------
        BrowserNotFoundError
            If there is no Chrome or Chromium to draw it; the message states what to install.
        ValueError
            If the path is not acceptable or its folder does not exist.
        """
        path = validate_path(filename, IMAGES)
        scale = float(_validate.real("scale", scale, positive=True))
        self.update_layout()
        with replacing(path) as stream:
            stream.write(browser.draw(self.fig, IMAGES[extension_of(path)], *self.image_size(), scale))

    def image_size(self) -> tuple[float, float]:
        """Return width and height of images in pixels."""
        layout = self.fig.layout
        return layout.width or figure_style.DEFAULT_SIZE[0], layout.height or figure_style.DEFAULT_SIZE[1]

    def save(self, filename: str | os.PathLike) -> None:
        """Save the figure in the format of the extension: ``.html``, ``.md``, or an image."""
        extension = extension_of(validate_path(filename, [*HTML, *MARKDOWN, *IMAGES]))
        if extension in HTML:
            self.save_html(filename)
        elif extension in MARKDOWN:
            self.save_markdown(filename)
        else:
            self.save_image(filename)

    def _say(self, text: str) -> None:
        """Add a note at the foot of the figure."""
        if text not in self._notes:
            self._notes.append(text)


def write_html(figure, filename: str | os.PathLike, plotlyjs=True) -> str:
    """Write a figure as a page and return its ``<div>``, for pages that load plotly.js.

    Parameters
    ----------
    figure : plotly.graph_objects.Figure
        The figure.
    filename : str or os.PathLike
        A ``.html`` file, written atomically.
    plotlyjs : bool or str
        As for :func:`plotly.io.to_html`: True writes plotly.js into the page (5 MB, works without a network), "cdn"
        lets the page fetch it.
    """
    path, plotlyjs = validate_path(filename, HTML), _library_of(plotlyjs)
    text = page.to_html(figure, include_plotlyjs=plotlyjs, include_mathjax=False, full_html=True)
    with replacing(path) as stream:
        stream.write(text.encode())
    return division(figure)


def write_markdown(figure, filename: str | os.PathLike, plotlyjs=False) -> str:
    """Write the ``<div>`` of a figure, for a Markdown page that is shown as HTML, and return it.

    Parameters
    ----------
    figure : plotly.graph_objects.Figure
        The figure.
    filename : str or os.PathLike
        A ``.md`` file, written atomically.
    plotlyjs : bool or str
        As for :func:`plotly.io.to_html`.
    """
    path = validate_path(filename, MARKDOWN)
    text = division(figure, _library_of(plotlyjs))
    with replacing(path) as stream:
        stream.write(text.encode() + b"\n")
    return text


def division(figure, plotlyjs=False) -> str:
    """Return a figure as a ``<div>`` without the blank lines at which Markdown would end it."""
    text = page.to_html(figure, include_plotlyjs=plotlyjs, include_mathjax=False, full_html=False)
    return re.sub(r"\n\s*\n", "\n", text.strip())


def _library_of(plotlyjs) -> bool | str:
    """Return where a page gets plotly.js from: itself, "cdn", "directory" or the address of a script."""
    if isinstance(plotlyjs, str):
        known = plotlyjs.lower() in ("cdn", "directory") or plotlyjs.lower().endswith(".js")
        return plotlyjs if known else _validate.one_of("plotlyjs", plotlyjs, ("cdn", "directory"))
    return _validate.flag("plotlyjs", plotlyjs)


def show(figure) -> str | None:
    """Show a figure in a notebook or a browser, without waiting for a window.

    Parameters
    ----------
    figure : plotly.graph_objects.Figure
        The figure.

    Returns
    -------
    str or None
        In a notebook, or with a renderer chosen for Plotly, None. Otherwise the path of the page that was written,
        which a browser opens if there is a display.
    """
    if page.renderers.default not in _BROWSER_RENDERERS and page.renderers.default is not None:
        page.show(figure)
        return None
    path = _next_page()
    # plotly.js (5 MB) is written once beside the pages of this process.
    write_html(figure, path, plotlyjs="directory")
    script = path.with_name("plotly.min.js")
    if not script.exists():
        from plotly.offline import get_plotlyjs

        with replacing(str(script)) as stream:
            stream.write(get_plotlyjs().encode())
    logger.info("Figure written to %s", path)
    if can_open():
        webbrowser.open(path.as_uri())
    return str(path)


def can_open() -> bool:
    """Return True if opening a page shows it and returns at once: there is a display and a graphical browser."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    try:
        chosen = webbrowser.get()
    except webbrowser.Error:
        return False
    return bool(os.environ.get("BROWSER")) or type(chosen) is not webbrowser.GenericBrowser


def _next_page() -> Path:
    global _folder
    if _folder is None or not _folder.is_dir():
        _folder = Path(tempfile.mkdtemp(prefix="odak_pictures_"))
    return _folder / f"picture_{len(list(_folder.glob('*.html'))) + 1}.html"


def text(name: str, value) -> Any:
    """Return a title or a label: a string or a number as it is, or None."""
    if value is None or isinstance(value, str) or (isinstance(value, Real) and not isinstance(value, bool)):
        return value
    raise TypeError(f"{name} must be a string, got {type(value).__name__}")


def texts(name: str, value, least: int = 0) -> list:
    """Return titles or labels as a list of at least so many."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise TypeError(f"{name} must be a sequence of strings, got {value!r:.80}")
    found = [text(f"{name}[{i}]", entry) for i, entry in enumerate(value)]
    if len(found) < least:
        raise ValueError(f"{name} must have {least} strings, got {len(found)}")
    return found


def numbers(name: str, value, count: int, *, positive: bool = False, least: float | None = None) -> list:
    """Return `count` real numbers, such as pixels, as a list."""
    found = list(_validate.several(name, value, count, positive=positive))
    if least is not None and min(found) < least:
        raise ValueError(f"{name} must be at least {least}, got {value!r}")
    return found


def share(name: str, value) -> float:
    """Return a number from 0 to 1."""
    if not 0 <= (number := float(_validate.real(name, value))) <= 1:
        raise ValueError(f"{name} must be from 0 to 1, got {value!r}")
    return number


def mapping(name: str, value, default: Mapping) -> dict:
    """Return settings of Plotly as a new dictionary, the default for None."""
    if value is not None and not isinstance(value, Mapping):
        raise TypeError(f"{name} must be a dictionary, got {type(value).__name__}")
    return dict(default if value is None else value)


def scale(name: str, value):
    """Return a colour scale that Plotly takes: a name, or a list of colours."""
    try:
        graph.Heatmap(colorscale=value)
    except ValueError as error:
        raise ValueError(f"{name} must be a colour scale of Plotly, got {value!r:.80}") from error
    return value


def colour(name: str, value) -> str:
    """Return the name or the code of one colour that Plotly takes."""
    try:
        graph.Scatter(marker={"color": value})
    except ValueError as error:
        raise ValueError(f"{name} must be a colour that Plotly takes, got {value!r:.80}") from error
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a colour's name or code, got {type(value).__name__}")
    return value


def cell(counts: tuple[int, int], row, col) -> dict[str, int]:
    """Return the row and the column of a plot, from 1, after checking that there is one."""
    place = {}
    for name, value, count in zip(("row", "col"), (row, col), counts, strict=True):
        place[name] = _validate.integer(name, value, minimum=1)
        if value > count:
            raise ValueError(f"{name} must be 1 to {count}, got {value}")
    return place
