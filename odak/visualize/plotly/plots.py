"""Surfaces over a plane, and plots of values."""

from collections.abc import Sequence

import numpy as np

from odak.visualize._arrays import image, real_array
from odak.visualize.plotly import _layout
from odak.visualize.plotly._library import graph, make_subplots
from odak.visualize.plotly._panels import MAXIMUM_SIDE, averaged, reduction
from odak.visualize.plotly._picture import Picture

__all__ = ["plotshow", "surfaceshow"]

MAXIMUM_SURFACE = 512
_AXES = ("x", "y", "z")


class surfaceshow(Picture):
    """Surfaces in one three-dimensional scene, coloured by height.

    Parameters
    ----------
    title : str
        Title.
    shape : sequence of int
        Width and height in pixels.
    labels, types, tick_no : sequence
        Name, type ("linear", "log", …) and number of ticks of the x, y and z axes.
    font_size : int
        Size of all texts.
    margin : sequence of int
        Left, right, bottom, top, in pixels.
    camera : sequence of float
        Where the camera stands, in units of the scene.
    colorbarlength : float
        Length of the colour bar over the height of the plot.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.visualize.plotly import surfaceshow
    >>> y, x = np.mgrid[-1:1:50j, -1:1:50j]
    >>> picture = surfaceshow(title="Saddle", labels=["x (mm)", "y (mm)", "height (µm)"])
    >>> picture.add_surface(x, y, x**2 - y**2)
    >>> len(picture.fig.data)
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
        settings = {
            "title": title,
            "color scale": "Portland",
            "font size": font_size,
            "width": shape[0],
            "height": shape[1],
            "margin": list(margin),
            "camera": list(camera),
            "colorbar length": colorbarlength,
        }
        for i, axis in enumerate(_AXES):
            settings |= {
                f"{axis} label": labels[i],
                f"{axis} axis type": types[i],
                f"{axis} axis tick number": tick_no[i],
            }
        super().__init__(graph.Figure(), settings)

    def add_surface(self, data_x, data_y, data_z, label="", mode="lines+markers", opacity=1.0, contour=False) -> None:
        """Add a surface, coloured by its z.

        Parameters
        ----------
        data_x, data_y : array
            Places ``[m, n]``, or ``[n]`` of the columns and ``[m]`` of the rows.
        data_z : array
            Heights ``[m, n]``. Of more than 512 along a side every k-th is drawn; the picture says so.
        label : str
            Name.
        mode : str
            Of no effect; accepted for older calls.
        opacity : float
            From 0 to 1.
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
            name=label,
            colorscale=self.settings["color scale"],
            opacity=float(opacity),
            colorbar={"len": self.settings["colorbar length"], "title": {"text": self.settings["z label"]}},
            contours={"z": {"show": bool(contour)}},
        )
        self.fig.add_trace(trace)

    def update_layout(self) -> None:
        """Bring the figure in line with its settings; showing and saving do this first."""
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


class plotshow(Picture):
    """Plots of values, in rows and columns.

    Parameters
    ----------
    subplot_titles : sequence of str
        Titles, row by row.
    shape : sequence of int
        Width and height in pixels.
    font_size : int
        Size of all texts.
    labels : sequence of str
        Names of the x and y axes, of all plots.
    margin : sequence of int
        Left, right, bottom, top, in pixels.
    colorbarlength : float
        Length of the colour bars of images over the height of the image.
    rows, cols : int
        How many.

    Examples
    --------
    >>> from odak.visualize.plotly import plotshow
    >>> picture = plotshow(labels=["iteration", "loss"], shape=[600, 400])
    >>> picture.add_plot([0, 1, 2], [4.0, 2.0, 1.0], label="run 1")
    >>> picture.fig.data[0].y.tolist()
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
        figure = make_subplots(rows=rows, cols=cols)
        _layout.place_titles(figure, list(subplot_titles)[: rows * cols], [], cols)
        settings = {
            "subplot titles": list(subplot_titles),
            "color scale": "Portland",
            "font size": font_size,
            "x label": labels[0],
            "y label": labels[1],
            "margin": list(margin),
            "colorbar length": colorbarlength,
            "width": shape[0],
            "height": shape[1],
            "maximum side": MAXIMUM_SIDE,
        }
        super().__init__(figure, settings)
        self._domains = _layout.domains(figure)

    def add_plot(self, data_x, data_y=None, label="", mode="lines+markers", row=1, col=1) -> None:
        """Add a curve.

        Parameters
        ----------
        data_x, data_y : array
            Values ``[n]``. With `data_x` alone it is drawn along x, over 0 … n − 1 on y.
        label : str
            Name in the legend.
        mode : str
            "lines", "markers" or "lines+markers".
        row, col : int
            Which plot, from 1.

        Raises
        ------
        ValueError, TypeError
            If the lengths differ or the values are not real numbers.
        """
        x = real_array("data_x", data_x).reshape(-1)
        y = np.arange(len(x)) if data_y is None else real_array("data_y", data_y).reshape(-1)
        if len(x) != len(y):
            raise ValueError(f"data_x and data_y must be as long as each other, got {len(x)} and {len(y)}")
        self.fig.add_trace(graph.Scatter(x=x, y=y, mode=mode, name=label), row=row, col=col)

    def add_2d_plot(self, image, label="", row=1, col=1, showscale=False, origin="upper") -> None:
        """Add an image of values.

        Parameters
        ----------
        image : array
            Real ``[rows, columns]``. Beyond ``settings["maximum side"]`` samples a side, 1024, blocks are averaged;
            the picture says so.
        label : str
            Name, and title of the colour bar.
        row, col : int
            Which plot, from 1.
        showscale : bool
            Draw the colour bar.
        origin : {"upper", "lower"}
            Where row 0 is.
        """
        add_image(self, image, row, col, showscale, origin, label)

    def update_layout(self) -> None:
        """Bring the figure in line with its settings; showing and saving do this first."""
        settings = self.settings
        self.fig.update_xaxes(title={"text": settings["x label"]})
        self.fig.update_yaxes(title={"text": settings["y label"]})
        super().update_layout()
        _layout.place_bars(self.fig, self._domains, settings["colorbar length"])


def add_image(picture: Picture, values, row: int, col: int, showscale: bool, origin: str, label: str = ""):
    """Add an image of real values to a picture, reduced to what its settings allow, and return the trace."""
    values = real_array("image", image("image", values))
    factor = reduction(values.shape, picture.settings["maximum side"])
    if factor > 1:
        picture._say(f"means of {factor} × {factor} of the {' × '.join(map(str, values.shape))} samples")
    trace = graph.Heatmap(
        z=averaged(values, factor),
        x0=(factor - 1) / 2,
        dx=factor,
        y0=(factor - 1) / 2,
        dy=factor,
        name=label,
        colorscale=picture.settings["color scale"],
        showscale=bool(showscale),
        colorbar={"title": {"text": label}},
    )
    picture.fig.add_trace(trace, row=row, col=col)
    _layout.square_pixels(picture.fig, picture.fig.data[-1], origin)
    return picture.fig.data[-1]


def surface_grid(data_x, data_y, data_z) -> tuple[dict, int]:
    """Return the x, y and z of a surface, thinned to what a browser draws well, and by how much."""
    x, y, z = (real_array(f"data_{axis}", value) for axis, value in zip(_AXES, (data_x, data_y, data_z), strict=True))
    if z.ndim != 2 or 0 in z.shape:
        raise ValueError(f"data_z must be [m, n], not empty; got {list(z.shape)}")
    for name, value, n in (("data_x", x, z.shape[1]), ("data_y", y, z.shape[0])):
        if value.shape not in (z.shape, (n,)):
            raise ValueError(f"{name} must be {list(z.shape)} as data_z, or [{n}]; got {list(value.shape)}")
    factor = reduction(z.shape, MAXIMUM_SURFACE)
    thin = slice(None, None, factor)
    return {a: v[(thin,) * v.ndim] for a, v in zip(_AXES, (x, y, z), strict=True)}, factor
