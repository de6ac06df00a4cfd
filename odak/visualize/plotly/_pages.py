"""Figures as pages: written whole, shown in a notebook or a browser, never waiting for one."""

import os
import re
import sys
import tempfile
import webbrowser
from pathlib import Path

from odak import _validate
from odak.log import logger
from odak.tools._atomic import replacing
from odak.tools._paths import validate_path
from odak.visualize.plotly._library import page

HTML, MARKDOWN = (".html", ".htm"), (".md", ".markdown")
_BROWSER_RENDERERS = {"", "browser", "firefox", "chrome", "chromium"}
_folder: Path | None = None


def write_html(figure, filename: str | os.PathLike, plotlyjs=True) -> str:
    """Write a figure as a page and return its ``<div>``, which needs plotly.js on the page that it is put into.

    Parameters
    ----------
    figure : plotly.graph_objects.Figure
        The figure.
    filename : str or os.PathLike
        A ``.html`` file; it appears whole or not at all.
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
    figure, filename, plotlyjs
        As in :func:`write_html`, with a ``.md`` file and without plotly.js by default.
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
    """Show a figure where it can be seen; never wait for a window.

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
    # Beside the page, once for all of this process: 5 MB.
    write_html(figure, path, plotlyjs="directory")
    _place_library(path.parent)
    logger.info("Picture written to %s", path)
    if can_open():
        webbrowser.open(path.as_uri())
    return str(path)


def can_open() -> bool:
    """Say whether opening a page shows it and returns at once: there is a display, and no text browser would answer."""
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


def _place_library(folder: Path) -> None:
    from plotly.offline import get_plotlyjs

    script = folder / "plotly.min.js"
    if not script.exists():
        with replacing(str(script)) as stream:
            stream.write(get_plotlyjs().encode())
