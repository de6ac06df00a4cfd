"""Rendering of figures as images by a browser that is started once and shared by all figures."""

import asyncio
import atexit
import logging
import os
import shutil
import threading
from contextlib import contextmanager
from pathlib import Path

from odak.log import logger

START_TIMEOUT = 60.0
RENDER_TIMEOUT = 120.0
CLOSE_TIMEOUT = 20.0

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
    """Stop the browser that images are drawn with, if it runs; the next image starts it again.

    It also stops when Python ends.

    Examples
    --------
    Free the memory of the browser in a program that has drawn its last image:

    >>> from odak.visualize.plotly import close_browser
    >>> close_browser()
    """
    _shared.close()


def draw(figure, kind: str, width: float, height: float, scale: float = 1.0) -> bytes:
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
    return _shared.draw(figure.to_dict(), {"format": kind, "width": width, "height": height, "scale": scale})


def _kaleido():
    try:
        import kaleido
    except ImportError as error:
        raise ImportError("Images need the package kaleido, 1.0 or newer: pip install kaleido") from error
    return kaleido


class _SharedBrowser:
    """One browser for all figures, driven from an event loop in a thread of its own.

    Kaleido's own server waits indefinitely if its browser does not start; here every wait has a limit, and errors are
    raised in the caller's thread.
    """

    def __init__(self):
        self._lock = threading.RLock()
        self._loop = self._thread = self._tool = self._owner = None

    def draw(self, figure: dict, options: dict) -> bytes:
        """Return an image of a figure; the browser is started again once if it fails."""
        with self._lock:
            fresh = not self._runs()
            self._start()
            try:
                return self._wait(self._tool.calc_fig(figure, opts=options), RENDER_TIMEOUT)
            except Exception as error:
                if fresh or isinstance(error, ValueError):
                    raise
                logger.info("The browser was lost (%s); starting another", error)
                self.close()
            self._start()
            return self._wait(self._tool.calc_fig(figure, opts=options), RENDER_TIMEOUT)

    def close(self) -> None:
        """Stop the browser and its event loop."""
        with self._lock:
            if not self._runs():
                return
            tool, loop, thread = self._tool, self._loop, self._thread
            self._loop = self._thread = self._tool = None
            with _exit_errors_suppressed():
                try:
                    asyncio.run_coroutine_threadsafe(tool.close(), loop).result(CLOSE_TIMEOUT)
                except Exception as error:
                    logger.info("The browser did not close: %s", error)
                _stop(loop, thread)

    def _runs(self) -> bool:
        # A forked child has the object, but neither the thread nor the browser.
        return self._tool is not None and self._owner == os.getpid()

    def _start(self) -> None:
        if self._runs():
            return
        path = find_browser()
        if path is None:
            raise BrowserNotFoundError(f"No browser was found.\n{_HOW_TO_INSTALL}")
        loop = asyncio.new_event_loop()
        thread = threading.Thread(target=loop.run_forever, name="odak browser", daemon=True)
        thread.start()
        self._loop, self._thread, self._owner = loop, thread, os.getpid()
        try:
            self._tool = self._wait(_open(_kaleido(), path), START_TIMEOUT)
        except Exception as error:
            self._loop = self._thread = None
            _stop(loop, thread)
            reason = (error.args and str(error.args[0])) or type(error).__name__
            raise BrowserNotFoundError(f"{path} does not start: {reason}\n{_HOW_TO_INSTALL}") from error
        # Registered after those of tempfile, so that it runs before them: the browser's folders are still there.
        atexit.unregister(self.close)
        atexit.register(self.close)

    def _wait(self, task, limit: float):
        return asyncio.run_coroutine_threadsafe(task, self._loop).result(limit)


async def _open(kaleido, path: str):
    # MathJax would be fetched from the network at every start.
    page = kaleido.PageGenerator(mathjax=False, others=[Path(__file__).with_name("clear_depth.js").as_uri()])
    tool = kaleido.Kaleido(path=path, page_generator=page, timeout=RENDER_TIMEOUT)
    await tool.open()
    return tool


@contextmanager
def _exit_errors_suppressed():
    """Suppress the error that choreographer reports when its browser ends."""
    reader = logging.getLogger("choreographer.channels.pipe")
    before, reader.disabled = reader.disabled, True
    try:
        yield
    finally:
        reader.disabled = before


def _stop(loop, thread) -> None:
    def cancel_and_stop():
        for task in asyncio.all_tasks(loop):
            task.cancel()
        # One more iteration of the event loop, in which the tasks end.
        loop.call_soon(loop.stop)

    loop.call_soon_threadsafe(cancel_and_stop)
    thread.join(CLOSE_TIMEOUT)
    if not thread.is_alive():
        loop.close()


_shared = _SharedBrowser()
