"""Rays, points, meshes, surfaces and volumes in space."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._array import Array
from odak.visualize import _arrays
from odak.visualize.plotly import _checks
from odak.visualize.plotly._colors import colors, face_colors
from odak.visualize.plotly._library import graph, make_subplots
from odak.visualize.plotly._scenes import AXES, ScenePicture
from odak.visualize.plotly.plots import surface_grid

__all__ = ["rayshow"]

SPHERE_SAMPLES = 100
_DASHES = ("solid", "dot", "dash", "longdash", "dashdot", "longdashdot")


class rayshow(ScenePicture):
    """Rays, points, triangles, spheres, surfaces and volumes, in rows and columns of three-dimensional scenes.

    Parameters
    ----------
    rows, columns : int
        How many scenes.
    subplot_titles : sequence of str
        Titles, row by row.
    opacity : float
        Of lines, triangles and spheres, from 0 to 1.
    line_width, marker_size : float
        In pixels.
    color_scale : str
        Colour scale for values.
    shape : sequence of int, optional
        Width and height in pixels; a page is filled and an image has 800 × 700 for each scene by default.
    labels : sequence of str
        Names of the axes, with the unit of length.

    Notes
    -----
    All lines of one call are one trace, so that a hundred thousand rays are drawn as fast as ten. A page shows about
    eight scenes at most: browsers allow no more.

    Examples
    --------
    >>> import torch
    >>> from odak.visualize.plotly import rayshow
    >>> rays = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]])
    >>> picture = rayshow(line_width=2.0)
    >>> picture.add_rays(rays, 10.0, color="green")
    >>> len(picture.fig.data)
    1
    """

    def __init__(
        self,
        rows: int = 1,
        columns: int = 1,
        subplot_titles: Sequence[str] = ("Ray visualization",),
        opacity: float = 0.5,
        line_width: float = 1.0,
        marker_size: float = 1.0,
        color_scale: str = "Inferno",
        shape: Sequence[int] | None = None,
        labels: Sequence[str] = ("x", "y", "z"),
    ):
        rows, columns = (_validate.integer(n, v, minimum=1) for n, v in (("rows", rows), ("columns", columns)))
        subplot_titles = _checks.texts("subplot_titles", subplot_titles)
        shape = None if shape is None else _checks.numbers("shape", shape, 2, positive=True)
        titles = [*subplot_titles, *[""] * (rows * columns)][: rows * columns]
        scenes = [[{"type": "scene"}] * columns] * rows
        figure = make_subplots(rows=rows, cols=columns, subplot_titles=titles, specs=scenes)
        settings = {
            "rows": rows,
            "color scale": _checks.scale("color_scale", color_scale),
            "columns": columns,
            "subplot titles": subplot_titles,
            "opacity": _checks.share("opacity", opacity),
            "line width": _checks.numbers("line_width", [line_width], 1, least=0)[0],
            "marker size": _checks.numbers("marker_size", [marker_size], 1, least=0)[0],
            "width": shape[0] if shape else None,
            "height": shape[1] if shape else None,
            "labels": _checks.texts("labels", labels, 3),
            "aspect ratio": [1.0, 1.0, 1.0],
            "margin": [20, 20, 30, 60],
        }
        super().__init__(figure, settings)
        # A little farther than Plotly has it: the near corner stays in the frame.
        self.fig.update_scenes(camera={"eye": dict.fromkeys(AXES, 1.45)})

    def add_point(
        self,
        point: Array,
        row: int = 1,
        column: int = 1,
        color: Any = "red",
        opacity: float = 1.0,
        show_legend: bool = False,
        label: str | None = None,
    ) -> None:
        """Add points.

        Parameters
        ----------
        point : array
            ``[3]`` or ``[m, 3]``.
        row, column : int
            Which scene, from 1.
        color : str or sequence
            A colour, or m colours or values; values are drawn in the colour scale.
        opacity : float
            From 0 to 1. A bool in its place is `show_legend`, as in an older call form.
        show_legend : bool
            List the points in the legend.
        label : str, optional
            Name there.
        """
        if isinstance(opacity, bool):
            opacity, show_legend = self.settings["opacity"], opacity
        places = _arrays.points("point", point)
        marker = {"size": self.settings["marker size"], **colors(color, len(places), self.settings)}
        self._add(
            graph.Scatter3d(
                **dict(zip(AXES, places.T, strict=True)),
                mode="markers",
                marker=marker,
                opacity=_checks.share("opacity", opacity),
                showlegend=_validate.flag("show_legend", show_legend),
                name=_checks.text("label", label),
            ),
            row,
            column,
        )

    def add_line(
        self,
        point_start: Array,
        point_end: Array,
        row: int = 1,
        column: int = 1,
        dash: str | None = None,
        color: Any = "red",
        show_legend: bool = False,
        label: str | None = None,
    ) -> None:
        """Add line segments, all in one trace.

        Parameters
        ----------
        point_start, point_end : array
            ``[3]`` or ``[m, 3]``; one start serves many ends, and the reverse.
        row, column : int
            Which scene, from 1.
        dash : str, optional
            "dot", "dash", "longdash", "dashdot" or "longdashdot".
        color : str or sequence
            A colour, or m colours or values; values are drawn in the colour scale.
        show_legend : bool
            List the lines in the legend.
        label : str, optional
            Name there.

        Raises
        ------
        ValueError
            If the numbers of starts and ends differ.
        """
        starts, ends = _arrays.pairs(("point_start", "point_end"), point_start, point_end)
        self.add_path(np.stack([starts, ends], axis=1), row, column, dash, color, show_legend, label)

    def add_path(
        self,
        points: Array,
        row: int = 1,
        column: int = 1,
        dash: Array = None,
        color: Any = "red",
        show_legend: bool = False,
        label: Any = None,
    ) -> None:
        """Add lines through several points each, all in one trace.

        Parameters
        ----------
        points : array
            ``[m, n, 3]``: m lines through n points. A line breaks where a point is not finite.
        row, column, dash, color, show_legend, label
            As in :meth:`add_line`.
        """
        lines = _arrays.real_array("points", points)
        if lines.ndim != 3 or lines.shape[-1] != 3 or lines.shape[1] < 2:
            raise ValueError(f"points must be [m, n, 3] with n at least 2, got {list(lines.shape)}")
        # A row of NaN behind each line keeps it from being joined to the next.
        broken = np.full((len(lines), lines.shape[1] + 1, 3), np.nan, np.result_type(lines, np.float32))
        broken[:, :-1] = np.where(np.isfinite(lines).all(-1, keepdims=True), lines, np.nan)
        style = {"width": self.settings["line width"], **colors(color, len(lines), self.settings, lines.shape[1] + 1)}
        if dash is not None:
            style["dash"] = _validate.one_of("dash", dash, _DASHES)
        trace = graph.Scatter3d(
            **dict(zip(AXES, broken.reshape(-1, 3)[:-1].T, strict=True)),
            mode="lines",
            line=style,
            opacity=float(self.settings["opacity"]),
            showlegend=_validate.flag("show_legend", show_legend),
            name=_checks.text("label", label),
            connectgaps=False,
        )
        self._add(trace, row, column)

    def add_rays(
        self,
        rays: Array,
        distance: float | Array = 1.0,
        row: int = 1,
        column: int = 1,
        dash: Array = None,
        color: Any = "red",
        show_legend: bool = False,
        label: Any = None,
    ) -> None:
        """Add rays, drawn from their starts over a distance, all in one trace; rays that are NaN are left out.

        Parameters
        ----------
        rays : array
            ``[2, 3]`` or ``[m, 2, 3]``: starts and directions.
        distance : float or array
            One for all, or one for each ray.
        row, column, dash, color, show_legend, label
            As in :meth:`add_line`; colours of single rays are not taken here.
        """
        starts, ends = _arrays.reach(rays, distance)
        self.add_line(starts, ends, row, column, dash, color, show_legend, label)

    def add_triangle(
        self,
        triangle: Array,
        row: int = 1,
        column: int = 1,
        dash: Array = None,
        color: Any = "red",
        show_legend: bool = False,
    ) -> None:
        """Add triangles ``[3, 3]`` or ``[m, 3, 3]``, all in one mesh; `dash` has no effect."""
        corners = _arrays.triangles("triangle", triangle)
        faces = np.arange(3 * len(corners)).reshape(-1, 3)
        self.add_mesh(corners.reshape(-1, 3), faces, row, column, color, show_legend=show_legend)

    def add_mesh(
        self,
        vertices: Array,
        faces: Array,
        row: int = 1,
        column: int = 1,
        color: Any = "red",
        opacity: float | None = None,
        show_legend: bool = False,
        label: str | None = None,
    ) -> None:
        """Add a mesh.

        Parameters
        ----------
        vertices, faces : array
            Points ``[v, 3]``, and the numbers of the corners of triangles, ``[t, 3]``.
        row, column : int
            Which scene, from 1.
        color : str or sequence
            A colour, or t colours or values, one for each triangle.
        opacity : float, optional
            From 0 to 1; that of the settings by default.
        show_legend : bool
            List the mesh in the legend.
        label : str, optional
            Name there.
        """
        places = _arrays.points("vertices", vertices)
        corners = _arrays.faces("faces", faces, len(places))
        style = face_colors(color, len(corners), self.settings)
        trace = graph.Mesh3d(
            **dict(zip(AXES, places.T, strict=True)),
            **dict(zip("ijk", corners.T, strict=True)),
            **style,
            opacity=self.settings["opacity"] if opacity is None else _checks.share("opacity", opacity),
            flatshading=True,
            lighting={"ambient": 0.75},
            showlegend=_validate.flag("show_legend", show_legend),
            name=_checks.text("label", label),
        )
        self._add(trace, row, column)

    def add_sphere(
        self,
        sphere: Array,
        row: int = 1,
        column: int = 1,
        dash: Array = None,
        color: Any = "red",
        show_legend: bool = False,
    ) -> None:
        """Add a sphere, ``[4]`` or ``[1, 4]``: centre and radius; `dash` has no effect."""
        grid = _arrays.sphere("sphere", sphere, SPHERE_SAMPLES)
        trace = graph.Surface(
            **dict(zip(AXES, grid, strict=True)),
            colorscale=[[0, _checks.colour("color", color)], [1, color]],
            showscale=False,
            opacity=float(self.settings["opacity"]),
            showlegend=_validate.flag("show_legend", show_legend),
        )
        self._add(trace, row, column)

    def add_surface(
        self,
        data_x: Array,
        data_y: Array,
        data_z: Array,
        surface_color: Any,
        row: int = 1,
        column: int = 1,
        label: str = "",
        mode: str = "lines+markers",
        opacity: float = 1.0,
        contour: bool = False,
    ) -> None:
        """Add a surface, coloured by values on it.

        Parameters
        ----------
        data_x, data_y, data_z : array
            Points ``[m, n]``; x and y may be ``[n]`` and ``[m]``. Of more than 512 along a side every k-th is drawn;
            the picture says so.
        surface_color : array or str
            Values ``[m, n]``, or one colour.
        row, column : int
            Which scene, from 1.
        label : str
            Name, and title of the colour bar.
        mode : str
            Of no effect; accepted for older calls.
        opacity : float
            From 0 to 1.
        contour : bool
            Draw lines of equal z.
        """
        grid, factor = surface_grid(data_x, data_y, data_z)
        label, opacity = _checks.text("label", label), _checks.share("opacity", opacity)
        if factor > 1:
            self._say(f"every {factor}. point of {' × '.join(map(str, np.shape(data_z)))} drawn")
        if isinstance(surface_color, str):
            _checks.colour("surface_color", surface_color)
            style = {"colorscale": [[0, surface_color], [1, surface_color]], "showscale": False}
        else:
            values = _arrays.real_array("surface_color", surface_color)
            if values.shape != np.shape(data_z):
                raise ValueError(f"surface_color must be {list(np.shape(data_z))}, got {list(values.shape)}")
            style = {"surfacecolor": values[::factor, ::factor], "colorscale": self.settings["color scale"]}
            style["colorbar"] = {"title": {"text": label}}
        contours = {"z": {"show": _validate.flag("contour", contour)}}
        self._add(graph.Surface(**grid, **style, name=label, opacity=opacity, contours=contours), row, column)

    def add_volume(
        self,
        points: Array,
        values: Array,
        limits: Sequence[float] = (0.0, 1.0),
        row: int = 1,
        column: int = 1,
        opacity: float = 1.0,
        surface_count: int = 17,
    ) -> None:
        """Add surfaces of equal value in a volume.

        Parameters
        ----------
        points, values : array
            Points ``[n, 3]`` of a regular grid and values ``[n]`` there.
        limits : sequence of float
            Lowest and highest value drawn.
        row, column : int
            Which scene, from 1.
        opacity : float
            From 0 to 1.
        surface_count : int
            How many surfaces.
        """
        places, numbers = _arrays.points("points", points), _arrays.real_array("values", values).reshape(-1)
        if len(numbers) != len(places):
            raise ValueError(f"values must be as many as points, {len(places)}, got {len(numbers)}")
        low, high = _checks.numbers("limits", limits, 2)
        trace = graph.Volume(
            **dict(zip(AXES, places.T, strict=True)),
            value=numbers,
            isomin=low,
            isomax=high,
            opacity=_checks.share("opacity", opacity),
            surface_count=_validate.whole("surface_count", surface_count, minimum=1),
            colorscale=self.settings["color scale"],
        )
        self._add(trace, row, column)
