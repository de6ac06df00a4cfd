"""Base class of figures: style, layout, display, and files as pages, Markdown and images; checks of their arguments.

Images are rendered by Kaleido, with a browser of its own for each.
"""

import math
import os
import re
import shutil
import sys
import tempfile
import warnings
import webbrowser
from collections.abc import Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from odak import _validate
from odak._warnings import ArgumentWarning, warn
from odak.log import logger
from odak.tools.paths import extension_of, replacing, validate_path, write_file

try:
    import plotly.graph_objects as graph
    import plotly.io as page
    from plotly.subplots import make_subplots as make_subplots
except ImportError as error:
    raise ImportError("odak.visualize.plotly needs the package plotly: pip install plotly kaleido") from error

RENDER_TIMEOUT = 120.0

_HOW_TO_INSTALL = (
    "Images are drawn by Chrome or Chromium. Install one:\n"
    "  Debian:          apt-get install chromium\n"
    "  Ubuntu:          Google's .deb (its package chromium-browser is a snap, which containers cannot start)\n"
    "  anywhere:        plotly_get_chrome   (comes with plotly; downloads one for this user)\n"
    "or let the environment variable BROWSER_PATH name the program. Pages (save_html) need no browser."
)


class BrowserNotFoundError(RuntimeError):
    """No browser was found, or it does not start; the message states what to install.

    Examples
    --------
    >>> import os
    >>> from unittest.mock import patch
    >>> from odak.visualize.plotly import BrowserNotFoundError, find_browser
    >>> with patch.dict(os.environ, BROWSER_PATH="/nowhere/chromium"):
    ...     try:
    ...         find_browser()
    ...     except BrowserNotFoundError as error:
    ...         print(str(error).splitlines()[0])
    BROWSER_PATH='/nowhere/chromium' is not a program.
    """


def find_browser() -> str | None:
    """Return the path of the Chrome or Chromium that images are drawn with.

    Returns
    -------
    str or None
        The program that the environment variable BROWSER_PATH names; else one fetched by ``plotly_get_chrome``; else
        the first of Chrome, Chromium, Edge, Brave and Vivaldi on the PATH or in its usual place. None where there is
        none.

    Raises
    ------
    BrowserNotFoundError
        If BROWSER_PATH names something that cannot be run.
    ImportError
        If kaleido is missing.

    Examples
    --------
    Draw an image where a browser is installed, and write a page where none is:

    >>> from odak.visualize.plotly import find_browser
    >>> ending = ".png" if find_browser() else ".html"
    >>> ending in (".png", ".html")
    True
    """
    chosen = os.environ.get("BROWSER_PATH")
    if chosen:
        found = shutil.which(os.path.expanduser(chosen))
        if found is None:
            raise BrowserNotFoundError(f"BROWSER_PATH={chosen!r} is not a program.\n{_HOW_TO_INSTALL}")
        return os.path.abspath(found)
    _kaleido()
    from choreographer.browsers.chromium import Chromium

    return Chromium.find_browser(skip_local=False)


def close_browser() -> None:
    """Stop the browser that Kaleido's server shares among images, if the server runs.

    It also stops when Python ends.

    Examples
    --------
    Share one browser among many images, and free its memory:

    >>> import kaleido
    >>> from odak.visualize.plotly import close_browser, find_browser
    >>> kaleido.start_sync_server(path=find_browser())  # doctest: +SKIP
    >>> close_browser()
    """
    _kaleido().stop_sync_server(silence_warnings=True)


def draw(figure: graph.Figure, kind: str, width: float, height: float, scale: float = 1.0) -> bytes:
    """Return a figure as the bytes of an image file.

    Parameters
    ----------
    figure : plotly.graph_objects.Figure
        Figure to draw.
    kind : str
        "png", "jpeg", "webp", "svg" or "pdf".
    width, height : float
        Size in CSS pixels.
    scale : float
        Image pixels per CSS pixel.

    Raises
    ------
    BrowserNotFoundError
        If there is no browser, or it does not start.
    """
    kaleido, path = _kaleido(), find_browser()
    if path is None:
        raise BrowserNotFoundError(f"No browser was found.\n{_HOW_TO_INSTALL}")
    from choreographer.errors import BrowserClosedError, BrowserFailedError

    # MathJax would be fetched from the network at every start.
    template = kaleido.PageGenerator(mathjax=False, others=[Path(__file__).with_name("clear_depth.js").as_uri()])
    browser = {"path": path, "page_generator": template, "timeout": RENDER_TIMEOUT}
    options = {"format": kind, "width": width, "height": height, "scale": scale}
    try:
        with warnings.catch_warnings():
            # A server of Kaleido that the caller has started has a browser.
            warnings.filterwarnings("ignore", "The kopts argument", UserWarning)
            return kaleido.calc_fig_sync(figure.to_dict(), options, kopts=browser)
    except (BrowserClosedError, BrowserFailedError) as error:
        raise BrowserNotFoundError(f"{path} does not start: {error.args[0]}\n{_HOW_TO_INSTALL}") from error


def _kaleido():
    return _validate.optional("kaleido", "Images need the package kaleido, 1.0 or newer: pip install kaleido")


# Perceptually uniform scale of amplitudes and intensities, and cyclic scale of phases, whose two ends are one colour.
SEQUENTIAL_SCALE, CYCLIC_SCALE, HEIGHT_SCALE = "Inferno", "Twilight", "Viridis"
# Colours that can be distinguished with colour-vision deficiencies (Okabe and Ito 2008), for curves and fields of view.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")

# In CSS pixels, at the font size below: a colour bar with numbers and title; the space left of an image, and between an
# image and the next below it, for names and numbers of axes and a title.
FONT_SIZE = 14.0
BAR_GAP, BAR_WIDTH, BAR_TEXT = 8.0, 14.0, 80.0
COLUMN_GAP, ROW_GAP = 84.0, 100.0
BAR_SPACE = BAR_GAP + BAR_WIDTH + BAR_TEXT
DEFAULT_SIZE = (700.0, 500.0)
DEFAULT_MARGIN = {"l": 80, "r": 80, "b": 80, "t": 100}
SMALLEST_IMAGE = 60.0

_INK, _LINE, _GRID, _WALL = "#1f2430", "#6b7280", "#e3e6eb", "#f6f7f9"
_AXIS: dict[str, Any] = {
    "automargin": True,
    "gridcolor": _GRID,
    "linecolor": _LINE,
    "mirror": True,
    "showline": True,
    "tickcolor": _LINE,
    "ticks": "outside",
    "zeroline": False,
}
_SCENE_AXIS: dict[str, Any] = {
    "backgroundcolor": _WALL,
    "gridcolor": "#d5dae1",
    "linecolor": _LINE,
    "nticks": 6,
    "showbackground": True,
    "ticks": "",
    "zeroline": False,
}
TEMPLATE: dict[str, Any] = {
    "layout": {
        "colorway": list(COLORS),
        "font": {"color": _INK, "family": "Open Sans, Helvetica, Arial, sans-serif", "size": FONT_SIZE},
        "legend": {"bgcolor": "rgba(255, 255, 255, 0.7)"},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "scene": {f"{axis}axis": _SCENE_AXIS for axis in "xyz"},
        "title": {"font": {"size": FONT_SIZE + 3}, "x": 0.02, "xanchor": "left"},
        "xaxis": _AXIS,
        "yaxis": _AXIS,
    }
}

# Vertical angle of the perspective of Plotly's scenes, and the fraction of a scene that the drawing may fill beside the
# names and numbers of the axes.
_SCENE_VIEW, _FILLED = math.pi / 4, 0.95


def margins(value: Any) -> dict[Any, Any] | None:
    """Return left, right, bottom and top margins under the names that Plotly gives them."""
    if value is None or isinstance(value, dict):
        return value
    sides = tuple(value)
    if len(sides) != 4:
        raise ValueError(f"margin must be four numbers (left, right, bottom, top), got {value!r}")
    return dict(zip(("l", "r", "b", "t"), sides, strict=True))


def apply(figure: graph.Figure, settings: dict[Any, Any]) -> None:
    """Apply the template and the size, margins, title and font of the settings; all else stays as it is."""
    values: dict[str, Any] = {
        "width": settings.get("width"),
        "height": settings.get("height"),
        "margin": margins(settings.get("margin")),
    }
    if settings.get("title"):
        values["title"] = {"text": settings["title"]}
    if settings.get("font"):
        values["font"] = settings["font"]
    if settings.get("font size"):
        values["font"] = {"size": settings["font size"]}
    figure.update_layout({name: value for name, value in values.items() if value is not None})
    # Merged as dictionaries and assigned as a whole: `update_layout` takes six times as long for a template.
    figure.layout.template = page.templates.merge_templates(figure.layout.template, graph.layout.Template(TEMPLATE))


def axis_names(trace: Any) -> tuple[str, str]:
    """Return the names that the layout gives the axes of a trace: ``"xaxis2"``, ``"yaxis2"``."""
    x, y = (f"{kind}axis{(getattr(trace, f'{kind}axis') or kind)[1:]}" for kind in "xy")
    return x, y


def name_axes(figure: graph.Figure, trace: Any, labels: tuple[str, str]) -> None:
    """Set the titles of the axes of a trace and show their numbers."""
    for name, label in zip(axis_names(trace), labels, strict=True):
        if label:
            figure.layout[name].update(title={"text": label}, showticklabels=True)


def square_pixels(figure: graph.Figure, trace: Any, origin: str) -> None:
    """Set equal scales of the axes of an image, a frame that fits it, and the position of row 0."""
    x, y = axis_names(trace)
    figure.layout[x].update(constrain="domain")
    figure.layout[y].update(
        scaleanchor=x.replace("axis", ""),
        constrain="domain",
        constraintoward="top",
        autorange="reversed" if origin == "upper" else True,
    )


def place_titles(figure: graph.Figure, titles: list[str], row_titles: list[str], cols: int) -> None:
    """Write titles above the subplots, row by row, and beside the rows; they follow the frames of the images."""
    style = {"font": {"size": FONT_SIZE + 1}, "showarrow": False}
    for i, title in enumerate(row_titles):
        if title:
            y = figure.get_subplot(i + 1, cols).yaxis.plotly_name.replace("axis", "")
            place = {"xref": "paper", "x": 1.0, "xanchor": "left", "xshift": 8, "yref": f"{y} domain", "y": 0.5}
            figure.add_annotation(text=title, textangle=90, **place, **style)
    for i, title in enumerate(titles):
        if title:
            subplot = figure.get_subplot(i // cols + 1, i % cols + 1)
            x, y = (axis.plotly_name.replace("axis", "") for axis in subplot)
            figure.add_annotation(
                text=title,
                xref=f"{x} domain",
                yref=f"{y} domain",
                x=0.5,
                y=1.0,
                yanchor="bottom",
                **style,
            )


def spacing(rows: int, cols: int, shape: Any, margin: Any) -> dict[Any, Any]:
    """Return the spacing between subplots that their texts need, as fractions of the plot."""
    side: Any = margins(margin)
    width, height = max(shape[0] - side["l"] - side["r"], 50), max(shape[1] - side["t"] - side["b"], 50)
    gaps = {"horizontal_spacing": (cols, COLUMN_GAP / width), "vertical_spacing": (rows, ROW_GAP / height)}
    return {name: min(gap, 0.4 / (count - 1)) for name, (count, gap) in gaps.items() if count > 1}


def domains(figure: graph.Figure) -> dict[str, tuple[float, float]]:
    """Return the domains of all x axes, by their names in the layout."""
    found = {axis.plotly_name: axis.domain for axis in figure.select_xaxes()}
    return {name: (0.0, 1.0) if domain is None else tuple(domain) for name, domain in found.items()}


def place_images(
    figure: graph.Figure,
    at_first: dict[str, tuple[float, float]],
    share: float = 1.0,
    *,
    rows: int = 1,
    fit_height: bool = False,
) -> None:
    """Place each colour bar beside its image, as high as the image, in space taken from its column.

    Parameters
    ----------
    figure : plotly.graph_objects.Figure
        Its images are heat maps.
    at_first : dict
        Result of :func:`domains` before the first call, so that further calls change nothing.
    share : float
        Length of the bars as a fraction of the height of their images.
    rows : int
        Number of rows of subplots.
    fit_height : bool
        Set the heights of the figure and its rows by the heights of the images.
    """
    width, height = _plot_size(figure)
    images = [trace for trace in figure.data if trace.type == "heatmap"]
    bars = [trace for trace in images if trace.showscale]
    _narrow_columns(figure, at_first, {at_first[axis_names(trace)[0]] for trace in bars}, width)
    if fit_height and images:
        height = _fit_rows(figure, images, rows, width)
    for trace in bars:
        x, y = (figure.layout[name] for name in axis_names(trace))
        frame = y.linewidth or 0.0
        (left, right), (_, high) = x.domain, y.domain or (0.0, 1.0)
        across, up = _size_of(figure, trace, width, height)
        trace.colorbar.update(
            x=(left + right) / 2 + (across / 2 + BAR_GAP + frame) / width,
            xanchor="left",
            xpad=0,
            y=high - up / 2 / height,
            yanchor="middle",
            ypad=0,
            len=(share or 1.0) * up / height,
            lenmode="fraction",
            thickness=BAR_WIDTH,
            outlinewidth=0,
            title={"side": "right"},
        )


def _size_of(figure, trace, width: float, height: float) -> tuple[float, float]:
    """Return the width and height at which an image is drawn, in CSS pixels."""
    x, y = (figure.layout[name] for name in axis_names(trace))
    (left, right), (low, high) = x.domain, y.domain or (0.0, 1.0)
    across, up = (right - left) * width, (high - low) * height
    if y.scaleanchor:
        wide, tall = _extent(trace)
        scale = min(across / wide, up / tall)
        across, up = wide * scale, tall * scale
    return across, up


def _fit_rows(figure, images, rows: int, width: float) -> float:
    """Give each row of subplots the height of its highest image, and return the height of the plot."""
    number_of = {name: number for number, name in enumerate(axis.plotly_name for axis in figure.select_yaxes())}
    heights = [SMALLEST_IMAGE] * rows
    for trace in images:
        across, along = axis_names(trace)
        left, right = figure.layout[across].domain
        wide, tall = _extent(trace)
        row = number_of[along] * rows // len(number_of)
        heights[row] = max(heights[row], (right - left) * width * tall / wide)
    height = sum(heights) + (rows - 1) * ROW_GAP
    ends = [sum(heights[: row + 1]) + row * ROW_GAP for row in range(rows)]
    for name, number in number_of.items():
        row = number * rows // len(number_of)
        figure.layout[name].domain = (max(1 - ends[row] / height, 0.0), 1 - (ends[row] - heights[row]) / height)
    margin = figure.layout.margin
    side = {name: margin[name] if margin[name] is not None else DEFAULT_MARGIN[name] for name in "bt"}
    figure.layout.height = round(height + side["b"] + side["t"])
    return height


def _narrow_columns(figure, at_first: dict[Any, Any], with_bars: set[Any], width: float) -> None:
    """Narrow the columns of images by their colour bars and, where these lack space, by the texts of their axes."""
    size = max((figure.layout.font.size or FONT_SIZE) / FONT_SIZE, 1.0)
    columns = sorted(set(at_first.values()))
    named = {at_first[axis.plotly_name] for axis in figure.select_xaxes() if axis.title.text}
    for name, domain in at_first.items():
        before = max([column[1] for column in columns if column[1] <= domain[0]], default=None)
        missing = 0.0 if before is None else COLUMN_GAP * size - (domain[0] - before) * width
        left = max(missing, 0.0) / width if domain in named else 0.0
        right = (BAR_GAP + BAR_WIDTH + BAR_TEXT * size) / width if domain in with_bars else 0.0
        least = 0.2 * (domain[1] - domain[0])
        start = min(domain[0] + left, domain[1] - least)
        figure.layout[name].domain = (start, max(domain[1] - right, start + least))


def place_scene_bars(figure: graph.Figure) -> None:
    """Place the colour bars of three-dimensional scenes beside their scenes, several of one scene side by side."""
    width, _ = _plot_size(figure)
    seen: dict[str, int] = {}
    for trace in figure.data:
        if trace.type in ("surface", "volume") and trace.showscale is not False:
            name = trace.scene or "scene"
            domain = figure.layout[name].domain
            (left, right), (low, high) = domain.x or (0.0, 1.0), domain.y or (0.0, 1.0)
            count = seen[name] = seen.get(name, 0) + 1
            trace.colorbar.update(
                x=max(right - count * BAR_SPACE / width, left),
                xanchor="left",
                y=(low + high) / 2,
                len=0.6 * (high - low),
                thickness=BAR_WIDTH,
                title={"side": "right"},
            )


def note(figure: graph.Figure, text: str) -> None:
    """Write a line at the foot of a figure, replacing an earlier one."""
    kept = [a for a in figure.layout.annotations if a.name != "note"]
    figure.layout.annotations = kept
    if text:
        bottom = (figure.layout.margin.b if figure.layout.margin.b is not None else DEFAULT_MARGIN["b"]) - 2
        place = {"xref": "paper", "yref": "paper", "x": 1.0, "y": 0.0, "xanchor": "right", "yanchor": "bottom"}
        figure.add_annotation(text=text, name="note", showarrow=False, yshift=-bottom, font={"size": 11}, **place)


def _plot_size(figure) -> tuple[float, float]:
    """Return width and height of the plot inside the margins, in CSS pixels."""
    layout = figure.layout
    side = {name: layout.margin[name] if layout.margin[name] is not None else DEFAULT_MARGIN[name] for name in "lrbt"}
    width, height = layout.width or DEFAULT_SIZE[0], layout.height or DEFAULT_SIZE[1]
    return max(width - side["l"] - side["r"], 50.0), max(height - side["b"] - side["t"], 50.0)


def _extent(trace) -> tuple[float, float]:
    """Return width and height of an image, in units of its axes."""
    extents = []
    for kind, count in (("x", trace.z.shape[1]), ("y", trace.z.shape[0])):
        places, step = getattr(trace, kind), getattr(trace, f"d{kind}")
        if places is not None and len(places) > 1:
            extents.append(float(abs(places[-1] - places[0])) * count / (count - 1))
        else:
            extents.append(count * (step or 1.0))
    return extents[0], extents[1]


def camera_towards(
    points: np.ndarray, direction: Sequence[float], up: Sequence[float], size: tuple[float, float]
) -> tuple[dict[str, Any], list[list[float]]]:
    """Return a camera, and ranges of the axes, with which a scene of equal scales shows all points.

    Parameters
    ----------
    points : numpy.ndarray
        ``[m, 3]``.
    direction : sequence of float
        Direction from the middle of the points to the camera.
    up : sequence of float
        Direction that points up in the figure.
    size : tuple of float
        Width and height of the scene in pixels.

    Returns
    -------
    tuple of (dict, list)
        Camera as Plotly takes it, and the ranges of x, y and z.
    """
    low, high = points.min(0), points.max(0)
    spans = np.maximum(high - low, 1e-3 * max(float((high - low).max()), 1e-12)) * 1.04
    middle = (low + high) / 2
    # With equal scales Plotly makes the product of the sides 1.
    unit = float(np.prod(spans)) ** (1 / 3)
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * spans / unit
    behind = np.asarray(direction, float) / np.linalg.norm(direction)
    right = np.cross(up, behind)
    right /= np.linalg.norm(right)
    above = np.cross(behind, right)
    x, y, depth = (corners @ axis for axis in (right, above, behind))
    half = math.tan(_SCENE_VIEW / 2) * _FILLED
    distance = float((depth + np.maximum(np.abs(x) * size[1] / size[0], np.abs(y)) / half).max())
    camera = {"eye": distance * behind, "up": up, "center": np.zeros(3)}
    ranges = [[float(m - s / 2), float(m + s / 2)] for m, s in zip(middle, spans, strict=True)]
    return {name: dict(zip("xyz", map(float, place), strict=True)) for name, place in camera.items()}, ranges


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

    def __init__(self, figure: graph.Figure, settings: dict[Any, Any]):
        self.fig: graph.Figure = figure
        self.settings = settings
        self._notes: list[str] = []

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(trace.type for trace in self.fig.data))
        return f"{type(self).__name__}({len(self.fig.data)} traces{': ' if kinds else ''}{kinds})"

    def update_layout(self) -> None:
        """Apply the settings to the figure; done before it is shown or saved."""
        apply(self.fig, self.settings)
        note(self.fig, "; ".join(self._notes))

    def show(self) -> str | None:
        """Show the figure in the notebook or in a browser, without waiting for a window.

        Returns
        -------
        str or None
            Path of the page that was written, None in a notebook. Without a display the page is only written.
        """
        self.update_layout()
        return show(self.fig)

    def save_html(self, filename: str | os.PathLike[str] = "plot.html", plotlyjs: bool | str = True) -> str:
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
        path, plotlyjs = validate_path(filename, HTML), _library_of(plotlyjs)
        text = page.to_html(self.fig, include_plotlyjs=plotlyjs, include_mathjax=False, full_html=True)
        write_file(path, text.encode())
        return division(self.fig)

    def save_markdown(self, filename: str | os.PathLike[str] = "plot.md", plotlyjs: bool | str = False) -> str:
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
        path = validate_path(filename, MARKDOWN)
        text = division(self.fig, _library_of(plotlyjs))
        write_file(path, text.encode() + b"\n")
        return text

    def save_image(self, filename: str | os.PathLike[str], scale: float = 1.0) -> None:
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
            stream.write(draw(self.fig, IMAGES[extension_of(path)], *self.image_size(), scale))

    def image_size(self) -> tuple[float, float]:
        """Return width and height of images in pixels."""
        layout = self.fig.layout
        return layout.width or DEFAULT_SIZE[0], layout.height or DEFAULT_SIZE[1]

    def save(self, filename: str | os.PathLike[str]) -> None:
        """Save the figure in the format of the extension: ``.html``, ``.md``, or an image."""
        extension = extension_of(validate_path(filename, [*HTML, *MARKDOWN, *IMAGES]))
        if extension in HTML:
            self.save_html(filename)
        elif extension in MARKDOWN:
            self.save_markdown(filename)
        else:
            self.save_image(filename)

    def _finish(self, filename, show: bool | None) -> None:
        """Save the figure where a file is named, and show it where that is asked for, by default if it is not saved."""
        if filename is not None:
            self.save(filename)
        if show or (show is None and filename is None):
            self.show()

    def _say(self, text: str) -> None:
        """Add a note at the foot of the figure."""
        if text not in self._notes:
            self._notes.append(text)

    def _say_what_is_blank(self, values: np.ndarray) -> None:
        """Add a note of how many samples of an image are not finite, and warn where no other is left."""
        blank = values.size - int(np.count_nonzero(np.isfinite(values)))
        note = f"{blank} of {values.size} samples are not finite and left blank"
        if values.size == blank and note not in self._notes:
            warn(f"no sample of the image is finite, all {blank} of them are left blank", ArgumentWarning)
        if blank:
            self._say(note)


def division(figure: graph.Figure, plotlyjs: Any = False) -> str:
    """Return a figure as a ``<div>`` without the blank lines at which Markdown would end it."""
    text = page.to_html(figure, include_plotlyjs=plotlyjs, include_mathjax=False, full_html=False)
    return re.sub(r"\n\s*\n", "\n", text.strip())


def _library_of(plotlyjs) -> bool | str:
    """Return where a page gets plotly.js from: itself, "cdn", "directory" or the address of a script."""
    if isinstance(plotlyjs, str):
        known = plotlyjs.lower() in ("cdn", "directory") or plotlyjs.lower().endswith(".js")
        return plotlyjs if known else _validate.one_of("plotlyjs", plotlyjs, ("cdn", "directory"))
    return _validate.flag("plotlyjs", plotlyjs)


def show(figure: dict[Any, Any]) -> str | None:
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
    page.write_html(figure, path, include_plotlyjs="directory", include_mathjax=False, auto_open=can_open())
    logger.info("Figure written to %s", path)
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


def text(name: str, value: str | None) -> Any:
    """Return a title or a label: a string or a number as it is, or None."""
    if value is None or isinstance(value, str) or (isinstance(value, Real) and not isinstance(value, bool)):
        return value
    raise TypeError(f"{name} must be a string, got {type(value).__name__}")


def texts(name: str, value: Any, least: int = 0) -> list[Any]:
    """Return titles or labels as a list of at least so many."""
    _validate.listed(name, value, "a sequence of strings")
    found = [text(f"{name}[{i}]", entry) for i, entry in enumerate(value)]
    if len(found) < least:
        raise ValueError(f"{name} must have {least} strings, got {len(found)}")
    return found


def numbers(name: str, value: Any, count: int, *, positive: bool = False, least: float | None = None) -> list[Any]:
    """Return `count` real numbers, such as pixels, as a list."""
    found = list(_validate.several(name, value, count, positive=positive))
    if least is not None and min(found) < least:
        raise ValueError(f"{name} must be at least {least}, got {value!r}")
    return found


def frame(shape: Any, margin: Any) -> dict[str, Any]:
    """Return the settings of the size of a figure and of its margins."""
    width, height = numbers("shape", shape, 2, positive=True)
    return {"width": width, "height": height, "margin": numbers("margin", margin, 4, least=0)}


def share(name: str, value: float) -> float:
    """Return a number from 0 to 1."""
    return float(_validate.number(name, value, least=0, most=1))


def mapping(name: str, value: Any, default: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return settings of Plotly as a new dictionary, the default for None."""
    _validate.instance(name, value, (Mapping, type(None)), "a dictionary")
    return dict(default if value is None else value)


def scale(name: str, value: str) -> str:
    """Return a colour scale that Plotly takes: a name, or a list of colours."""
    with _validate.refusing(lambda _: f"{name} must be a colour scale of Plotly, got {value!r:.80}", ValueError):
        graph.Heatmap(colorscale=value)
    return value


def colour(name: str, value: str) -> str:
    """Return the name or the code of one colour that Plotly takes."""
    with _validate.refusing(lambda _: f"{name} must be a colour that Plotly takes, got {value!r:.80}", ValueError):
        graph.Scatter(marker={"color": value})
    _validate.instance(name, value, str, "a colour's name or code")
    return value


def cell(counts: tuple[int, int], row: int, col: int) -> dict[str, int]:
    """Return the row and the column of a plot, from 1, after checking that there is one."""
    place = {}
    for name, value, count in zip(("row", "col"), (row, col), counts, strict=True):
        place[name] = _validate.integer(name, value, minimum=1, most=count)
    return place
