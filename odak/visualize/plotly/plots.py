"""Figures of surfaces over a plane, of curves, and of images of values."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._array import Array
from odak.visualize._arrays import image, real_array
from odak.visualize.plotly import figures
from odak.visualize.plotly.field_figures import MAXIMUM_SIDE, ORIGINS, averaged, reduction
from odak.visualize.plotly.figures import Figure, graph, make_subplots

__all__ = ["plotshow", "surfaceshow"]

MAXIMUM_SURFACE = 512
_AXES = ("x", "y", "z")
_MODES = {"lines", "markers", "text", "none"}


class surfaceshow(Figure):
    """Figure of surfaces in one three-dimensional scene, coloured by height.

    Parameters
    ----------
    title : str
        Title.
    shape : sequence of int
        Width and height in pixels.
    labels : sequence of str
        Names of the x, y and z axes, with their units.
    types : sequence of str
        Types of the x, y and z axes: "linear", "log", "date", "category".
    tick_no : sequence of int
        Largest numbers of ticks of the x, y and z axes.
    font_size : int
        Size of all texts.
    margin : sequence of int
        Left, right, bottom, top, in pixels.
    camera : sequence of float
        Position of the camera, in units of the scene.
    colorbarlength : float
        Length of the colour bar, as a fraction of the height of the plot.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.visualize.plotly import surfaceshow
    >>> y, x = np.mgrid[-1:1:50j, -1:1:50j]
    >>> figure = surfaceshow(title="Saddle", labels=["x (mm)", "y (mm)", "height (µm)"])
    >>> figure.add_surface(x, y, x**2 - y**2)
    >>> len(figure.fig.data)
    1
    """

    def __init__(
        self,
        title: str = "plot",
        shape: Sequence[int] = (1000, 1000),
        labels: Sequence[str] = ("x", "y", "z"),
        types: Sequence[str] = ("linear", "linear", "linear"),
        font_size: int = 12,
        tick_no: Sequence[int] = (10, 10, 10),
        margin: Sequence[int] = (65, 50, 65, 90),
        camera: Sequence[float] = (1.87, 0.88, -0.64),
        colorbarlength: float = 0.75,
    ):
        shape, tick_no = figures.numbers("shape", shape, 2, positive=True), figures.numbers("tick_no", tick_no, 3)
        labels, types = figures.texts("labels", labels, 3), figures.texts("types", types, 3)
        settings = {
            "title": figures.text("title", title),
            "color scale": figures.HEIGHT_SCALE,
            "font size": _validate.whole("font_size", font_size, minimum=1),
            "width": shape[0],
            "height": shape[1],
            "margin": figures.numbers("margin", margin, 4, least=0),
            "camera": figures.numbers("camera", camera, 3),
            "colorbar length": _validate.real("colorbarlength", colorbarlength, positive=True),
        }
        for i, axis in enumerate(_AXES):
            settings |= {
                f"{axis} label": labels[i],
                f"{axis} axis type": types[i],
                f"{axis} axis tick number": tick_no[i],
            }
        super().__init__(graph.Figure(), settings)

    def add_surface(
        self,
        data_x: Array,
        data_y: Array,
        data_z: Array,
        label: str = "",
        mode: str = "lines+markers",
        opacity: float = 1.0,
        contour: bool = False,
    ) -> None:
        """Add a surface, coloured by its z.

        Parameters
        ----------
        data_x : array
            Abscissae ``[m, n]``, or ``[n]`` of the columns.
        data_y : array
            Ordinates ``[m, n]``, or ``[m]`` of the rows.
        data_z : array
            Heights ``[m, n]``. Beyond 512 along a side every k-th is drawn, with a note in the figure.
        label : str
            Name of the surface.
        mode : str
            Without effect; accepted for compatibility.
        opacity : float
            Opacity, from 0 to 1.
        contour : bool
            Draw lines of equal z.

        Raises
        ------
        ValueError, TypeError
            If the shapes do not fit each other or the values are not real numbers.
        """
        grid, factor = surface_grid(data_x, data_y, data_z)
        if factor > 1:
            self._say(f"every {factor}. point of {' × '.join(map(str, np.shape(data_z)))} drawn")
        trace = graph.Surface(
            **grid,
            name=figures.text("label", label),
            colorscale=self.settings["color scale"],
            opacity=figures.share("opacity", opacity),
            colorbar={"len": self.settings["colorbar length"], "title": {"text": self.settings["z label"]}},
            contours={"z": {"show": _validate.flag("contour", contour)}},
        )
        self.fig.add_trace(trace)

    def update_layout(self) -> None:
        """Apply the settings to the figure; done before it is shown or saved."""
        settings, scene = self.settings, {"aspectmode": "manual", "aspectratio": dict.fromkeys(_AXES, 1.0)}
        for axis in _AXES:
            scene[f"{axis}axis"] = {
                "title": {"text": settings[f"{axis} label"]},
                "type": settings[f"{axis} axis type"],
                "nticks": settings[f"{axis} axis tick number"],
            }
        scene["camera"] = {"eye": dict(zip(_AXES, settings["camera"], strict=True))}
        self.fig.update_layout(scene=scene)
        super().update_layout()


class plotshow(Figure):
    """Figure of curves and images of values, in rows and columns.

    Parameters
    ----------
    subplot_titles : sequence of str
        Titles, row by row.
    shape : sequence of int
        Width and height in pixels.
    font_size : int
        Size of all texts.
    labels : sequence of str
        Names of the x and y axes of all plots, with their units.
    margin : sequence of int
        Left, right, bottom, top, in pixels.
    colorbarlength : float
        Length of the colour bars of images, as a fraction of the height of the image.
    rows : int
        Number of rows of plots.
    cols : int
        Number of columns of plots.

    Examples
    --------
    >>> from odak.visualize.plotly import plotshow
    >>> figure = plotshow(labels=["iteration", "loss"], shape=[600, 400])
    >>> figure.add_plot([0, 1, 2], [4.0, 2.0, 1.0], label="run 1")
    >>> figure.fig.data[0].y.tolist()
    [4.0, 2.0, 1.0]
    """

    def __init__(
        self,
        subplot_titles: Sequence[str] = ("plot",),
        shape: Sequence[int] = (1000, 1000),
        font_size: int = 16,
        labels: Sequence[str] = ("x", "y"),
        margin: Sequence[int] = (65, 50, 65, 90),
        colorbarlength: float = 0.75,
        rows: int = 1,
        cols: int = 1,
    ):
        rows, cols = (_validate.integer(name, n, minimum=1) for name, n in (("rows", rows), ("cols", cols)))
        titles, labels = figures.texts("subplot_titles", subplot_titles), figures.texts("labels", labels, 2)
        shape = figures.numbers("shape", shape, 2, positive=True)
        figure = make_subplots(rows=rows, cols=cols)
        figures.place_titles(figure, titles[: rows * cols], [], cols)
        settings = {
            "subplot titles": titles,
            "color scale": figures.SEQUENTIAL_SCALE,
            "font size": _validate.whole("font_size", font_size, minimum=1),
            "x label": labels[0],
            "y label": labels[1],
            "margin": figures.numbers("margin", margin, 4, least=0),
            "colorbar length": _validate.real("colorbarlength", colorbarlength, positive=True),
            "width": shape[0],
            "height": shape[1],
            "maximum side": MAXIMUM_SIDE,
        }
        super().__init__(figure, settings)
        self._domains = figures.domains(figure)
        self._cells = rows, cols

    def add_plot(
        self,
        data_x: Array,
        data_y: Array | None = None,
        label: str = "",
        mode: str = "lines+markers",
        row: int = 1,
        col: int = 1,
    ) -> None:
        """Add a curve.

        Parameters
        ----------
        data_x : array
            Abscissae ``[n]``.
        data_y : array, optional
            Ordinates ``[n]``; 0 … n − 1 by default.
        label : str
            Name in the legend.
        mode : str
            "lines", "markers" or "lines+markers".
        row : int
            Row of the plot, from 1.
        col : int
            Column of the plot, from 1.

        Raises
        ------
        ValueError, TypeError
            If the lengths differ or the values are not real numbers.
        """
        x = real_array("data_x", data_x).reshape(-1)
        y = np.arange(len(x)) if data_y is None else real_array("data_y", data_y).reshape(-1)
        if len(x) != len(y):
            raise ValueError(f"data_x and data_y must have the same length, got {len(x)} and {len(y)}")
        place, label = figures.cell(self._cells, row, col), figures.text("label", label)
        if not isinstance(mode, str) or not set(mode.split("+")) <= _MODES:
            raise ValueError(f"mode must be made of {', '.join(sorted(_MODES))} with + between; got {mode!r:.80}")
        self.fig.add_trace(graph.Scatter(x=x, y=y, mode=mode, name=label), **place)

    def add_2d_plot(
        self, image: Array, label: str = "", row: int = 1, col: int = 1, showscale: bool = False, origin: Any = "upper"
    ) -> None:
        """Add an image of values.

        Parameters
        ----------
        image : array
            Real ``[rows, columns]``. Beyond ``settings["maximum side"]`` samples a side, 1024, blocks of
            samples are averaged, with a note in the figure.
        label : str
            Name, and title of the colour bar.
        row : int
            Row of the plot, from 1.
        col : int
            Column of the plot, from 1.
        showscale : bool
            Draw the colour bar.
        origin : {"upper", "lower"}
            Position of row 0.
        """
        row, col = figures.cell(self._cells, row, col).values()
        add_image(self, image, row, col, showscale, origin, figures.text("label", label))

    def update_layout(self) -> None:
        """Apply the settings to the figure; done before it is shown or saved."""
        settings = self.settings
        self.fig.update_xaxes(title={"text": settings["x label"]})
        self.fig.update_yaxes(title={"text": settings["y label"]})
        super().update_layout()
        figures.place_images(self.fig, self._domains, settings["colorbar length"])


def add_image(figure: Figure, values, row: int, col: int, showscale: bool, origin: str, label: str = ""):
    """Add an image of real values, reduced to the largest size of the settings, and return the trace."""
    values = real_array("image", image("image", values))
    origin = _validate.one_of("origin", origin, ORIGINS)
    factor = reduction(values.shape, figure.settings["maximum side"])
    if factor > 1:
        figure._say(f"means of {factor} × {factor} of the {' × '.join(map(str, values.shape))} samples")
    trace = graph.Heatmap(
        z=averaged(values, factor),
        x0=(factor - 1) / 2,
        dx=factor,
        y0=(factor - 1) / 2,
        dy=factor,
        name=label,
        colorscale=figure.settings["color scale"],
        showscale=_validate.flag("showscale", showscale),
        colorbar={"title": {"text": label}},
    )
    figure.fig.add_trace(trace, row=row, col=col)
    figures.square_pixels(figure.fig, figure.fig.data[-1], origin)
    return figure.fig.data[-1]


def surface_grid(data_x, data_y, data_z) -> tuple[dict, int]:
    """Return x, y and z of a surface with every k-th sample, so that a browser can draw it, and k."""
    x, y, z = (real_array(f"data_{axis}", value) for axis, value in zip(_AXES, (data_x, data_y, data_z), strict=True))
    if z.ndim != 2 or 0 in z.shape:
        raise ValueError(f"data_z must be [m, n], not empty; got {list(z.shape)}")
    for name, value, n in (("data_x", x, z.shape[1]), ("data_y", y, z.shape[0])):
        if value.shape not in (z.shape, (n,)):
            raise ValueError(f"{name} must be {list(z.shape)} as data_z, or [{n}]; got {list(value.shape)}")
    factor = reduction(z.shape, MAXIMUM_SURFACE)
    thin = slice(None, None, factor)
    return {a: v[(thin,) * v.ndim] for a, v in zip(_AXES, (x, y, z), strict=True)}, factor
