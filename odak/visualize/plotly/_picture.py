"""What all pictures can do: lay themselves out, be shown, and be saved as page, Markdown or image."""

import os

from odak import _validate
from odak.tools._atomic import replacing
from odak.tools._paths import extension_of, validate_path
from odak.visualize.plotly import _layout, _pages, browser

IMAGES = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".webp": "webp", ".svg": "svg", ".pdf": "pdf"}


class Picture:
    """A Plotly figure with its settings.

    Attributes
    ----------
    fig : plotly.graph_objects.Figure
        The figure; its traces are ``fig.data``.
    settings : dict
        What the layout is made of; read each time the picture is shown or saved.
    """

    def __init__(self, figure, settings: dict):
        self.fig = figure
        self.settings = settings
        self._notes: list[str] = []

    def update_layout(self) -> None:
        """Bring the figure in line with its settings; showing and saving do this first."""
        _layout.apply(self.fig, self.settings)
        _layout.note(self.fig, "; ".join(self._notes))

    def show(self) -> str | None:
        """Show the picture, in the notebook or in a browser; never wait for a window.

        Returns
        -------
        str or None
            Path of the page that was written, None in a notebook. Without a display the page is only written.
        """
        self.update_layout()
        return _pages.show(self.fig)

    def save_html(self, filename: str | os.PathLike = "plot.html", plotlyjs: bool | str = True) -> str:
        """Save the picture as a page, and open nothing.

        Parameters
        ----------
        filename : str or os.PathLike
            A ``.html`` file; it appears whole or not at all.
        plotlyjs : bool or str
            True writes plotly.js into the page (5 MB, works without a network); "cdn" lets the page fetch it.

        Returns
        -------
        str
            The picture as a ``<div>`` without plotly.js, for a page that has it.
        """
        self.update_layout()
        return _pages.write_html(self.fig, filename, plotlyjs)

    def save_markdown(self, filename: str | os.PathLike = "plot.md", plotlyjs: bool | str = False) -> str:
        """Save the picture as a ``<div>`` for a Markdown page.

        Parameters
        ----------
        filename : str or os.PathLike
            A ``.md`` file; it appears whole or not at all.
        plotlyjs : bool or str
            As in :meth:`save_html`; False by default, for a site that loads plotly.js itself.

        Returns
        -------
        str
            What was written.
        """
        self.update_layout()
        return _pages.write_markdown(self.fig, filename, plotlyjs)

    def save_image(self, filename: str | os.PathLike, scale: float = 1.0) -> None:
        """Save the picture as an image.

        Parameters
        ----------
        filename : str or os.PathLike
            A ``.png``, ``.jpg``, ``.webp``, ``.svg`` or ``.pdf`` file; it appears whole or not at all.
        scale : float
            Image pixels per pixel of the figure's width and height.

        Raises
        ------
        BrowserNotFoundError
            If there is no Chrome or Chromium to draw it; the message says what to install.
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
        return layout.width or _layout.DEFAULT_SIZE[0], layout.height or _layout.DEFAULT_SIZE[1]

    def save(self, filename: str | os.PathLike) -> None:
        """Save the picture as what the name ends in: ``.html``, ``.md``, or an image."""
        extension = extension_of(validate_path(filename, [*_pages.HTML, *_pages.MARKDOWN, *IMAGES]))
        if extension in _pages.HTML:
            self.save_html(filename)
        elif extension in _pages.MARKDOWN:
            self.save_markdown(filename)
        else:
            self.save_image(filename)

    def _say(self, text: str) -> None:
        """Add a note to the foot of the picture."""
        if text not in self._notes:
            self._notes.append(text)
