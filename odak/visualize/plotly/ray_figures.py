"""Figures of rays, points, meshes, surfaces, volumes and lens systems in three-dimensional scenes."""

import os
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from odak import _validate
from odak._array import Array
from odak.visualize import _arrays
from odak.visualize.plotly import figures
from odak.visualize.plotly.field_figures import surface_trace
from odak.visualize.plotly.figures import Figure, graph, make_subplots

# In signatures: a colour, or colours or values of each.
Color: TypeAlias = str | Sequence[Any] | Array
SCENE_SIZE = (800, 700)
AXES = ("x", "y", "z")
# Samples of a surface of a lens along its radius and around its axis.
RADII, ANGLES = 12, 72
# Direction to the camera: beside the axis, slightly above and in front.
VIEW = (-1.0, 0.3, -0.25)
GLASS, MIRROR, SCREEN = "rgb(140, 195, 240)", "rgb(150, 150, 160)", "rgb(90, 90, 90)"


class SceneFigure(Figure):
    """Figure of scenes in space; the settings hold their ``rows``, ``columns``, ``labels`` and ``aspect ratio``."""

    def get_scene_number(self, row: int = 1, column: int = 1) -> int:
        """Return the number of a scene, counted row by row from 1.

        Raises
        ------
        ValueError
            If there is no such row or column.
        """
        for name, value, limit in (("row", row, self.settings["rows"]), ("column", column, self.settings["columns"])):
            _validate.integer(name, value, minimum=1, most=limit)
        return self.settings["columns"] * (row - 1) + column

    def set_axis_limits(
        self,
        row: int = 1,
        column: int = 1,
        x_limits: Any = (-1.0, 1.0),
        y_limits: Any = (-1.0, 1.0),
        z_limits: Any = (-1.0, 1.0),
    ) -> None:
        """Set the ranges of the axes of a scene.

        Parameters
        ----------
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        x_limits : sequence of float
            Lowest and highest x.
        y_limits : sequence of float
            Lowest and highest y.
        z_limits : sequence of float
            Lowest and highest z.
        """
        limits = zip(AXES, (x_limits, y_limits, z_limits), strict=True)
        ranges = {f"{a}axis": {"range": figures.numbers(f"{a}_limits", v, 2)} for a, v in limits}
        self._scene(row, column).update(ranges)

    def set_camera(
        self,
        row: int = 1,
        column: int = 1,
        x: float = 0.0,
        y: float = 0.0,
        z: float = 1.0,
        up: Array | None = None,
    ) -> None:
        """Set the position of the camera of a scene.

        Parameters
        ----------
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        x : float
            Position along x, in units of the scene: its sides have the geometric mean 1.
        y : float
            Position along y.
        z : float
            Position along z.
        up : {"x", "y", "z"} or sequence of float, optional
            Direction that points up in the figure.
        """
        camera = {"eye": {name: float(_validate.real(name, v)) for name, v in zip(AXES, (x, y, z), strict=True)}}
        if isinstance(up, str):
            up = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}[_validate.one_of("up", up, AXES)]
        if up is not None:
            camera["up"] = dict(zip(AXES, map(float, figures.numbers("up", up, 3)), strict=True))
        self._scene(row, column).camera.update(camera)

    def show(self, aspect_ratio: Sequence[float] | str | None = None) -> str | None:
        """Show the figure in the notebook or in a browser, without waiting for a window.

        Parameters
        ----------
        aspect_ratio : sequence of float or str, optional
            Lengths of the x, y and z axes in all scenes; "data" gives all three one scale. [1, 1, 1] by default.

        Returns
        -------
        str or None
            Path of the page that was written, None in a notebook.
        """
        if aspect_ratio is not None:
            self.settings["aspect ratio"] = aspect_ratio
        return super().show()

    def save_offline(self, filename: Any = "plot.html") -> str:
        """Save the figure as a page `filename`, and return its ``<div>`` without plotly.js; see :meth:`save_html`."""
        return self.save_html(filename)

    def update_layout(self) -> None:
        """Apply the settings to the figure; done before it is shown or saved."""
        settings, ratio = self.settings, self.settings["aspect ratio"]
        if isinstance(ratio, str):
            aspect = {"aspectmode": _validate.one_of("aspect_ratio", ratio, ("data", "cube", "auto"))}
        else:
            sides = _arrays.real_array("aspect_ratio", ratio).tolist()
            aspect = {"aspectmode": "manual", "aspectratio": dict(zip(AXES, sides, strict=True))}
        titles = {f"{a}axis": {"title": {"text": text}} for a, text in zip(AXES, settings["labels"], strict=True)}
        self.fig.update_scenes({**aspect, **titles})
        super().update_layout()
        figures.place_scene_bars(self.fig)

    def image_size(self) -> tuple[float, float]:
        """Return width and height of images, from the settings, or 800 × 700 for each scene."""
        settings = self.settings
        return (
            settings["width"] or SCENE_SIZE[0] * settings["columns"],
            settings["height"] or SCENE_SIZE[1] * settings["rows"],
        )

    def _scene(self, row: int, column: int):
        number = self.get_scene_number(row, column)
        return self.fig.layout["scene" if number == 1 else f"scene{number}"]

    def _add(self, trace, row: int, column: int) -> None:
        self.get_scene_number(row, column)
        self.fig.add_trace(trace, row=row, col=column)


SPHERE_SAMPLES = 100
_DASHES = ("solid", "dot", "dash", "longdash", "dashdot", "longdashdot")


class rayshow(SceneFigure):
    """Figure of rays, points, triangles, spheres, surfaces and volumes, in rows and columns of scenes.

    Parameters
    ----------
    rows : int
        Number of rows of scenes.
    columns : int
        Number of columns of scenes.
    subplot_titles : sequence of str
        Titles, row by row.
    opacity : float
        Opacity of lines, triangles and spheres, from 0 to 1.
    line_width : float
        Width of lines in pixels.
    marker_size : float
        Size of points in pixels.
    color_scale : str
        Colour scale of values.
    shape : sequence of int, optional
        Width and height in pixels; by default a page is filled and an image has 800 × 700 pixels for each scene.
    labels : sequence of str
        Names of the axes, with the unit of length.

    Notes
    -----
    All lines of one call are one trace, so that the time to draw hardly depends on their number. Browsers show about
    eight scenes on a page at most.

    Examples
    --------
    >>> import torch
    >>> from odak.visualize.plotly import rayshow
    >>> rays = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]])
    >>> figure = rayshow(line_width=2.0)
    >>> figure.add_rays(rays, 10.0, color="green")
    >>> len(figure.fig.data)
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
        subplot_titles = figures.texts("subplot_titles", subplot_titles)
        shape = None if shape is None else figures.numbers("shape", shape, 2, positive=True)
        titles = [*subplot_titles, *[""] * (rows * columns)][: rows * columns]
        scenes = [[{"type": "scene"}] * columns] * rows
        figure = make_subplots(rows=rows, cols=columns, subplot_titles=titles, specs=scenes)
        settings = {
            "rows": rows,
            "color scale": figures.scale("color_scale", color_scale),
            "columns": columns,
            "subplot titles": subplot_titles,
            "opacity": figures.share("opacity", opacity),
            "line width": figures.numbers("line_width", [line_width], 1, least=0)[0],
            "marker size": figures.numbers("marker_size", [marker_size], 1, least=0)[0],
            "width": shape[0] if shape else None,
            "height": shape[1] if shape else None,
            "labels": figures.texts("labels", labels, 3),
            "aspect ratio": [1.0, 1.0, 1.0],
            "margin": [20, 20, 30, 60],
        }
        super().__init__(figure, settings)
        # Slightly farther than Plotly's default, so that the near corner stays in the frame.
        self.fig.update_scenes(camera={"eye": dict.fromkeys(AXES, 1.45)})

    def add_point(
        self,
        point: Array,
        row: int = 1,
        column: int = 1,
        color: Color = "red",
        opacity: float = 1.0,
        show_legend: bool = False,
        label: str | None = None,
    ) -> None:
        """Add points.

        Parameters
        ----------
        point : array
            ``[3]`` or ``[m, 3]``.
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        color : str or sequence
            One colour, or m colours, or m values, which are drawn in the colour scale.
        opacity : float
            Opacity, from 0 to 1. A bool is taken as `show_legend`, as in an older call form.
        show_legend : bool
            Show an entry in the legend.
        label : str, optional
            Name in the legend.
        """
        if isinstance(opacity, bool):
            opacity, show_legend = self.settings["opacity"], opacity
        places = _arrays.points("point", point)
        marker = {"size": self.settings["marker size"], **colors(color, len(places), self.settings)}
        style = {"mode": "markers", "marker": marker, "opacity": figures.share("opacity", opacity)}
        self._draw(graph.Scatter3d, places, row, column, show_legend, label, **style)

    def add_line(
        self,
        point_start: Array,
        point_end: Array,
        row: int = 1,
        column: int = 1,
        dash: str | None = None,
        color: Color = "red",
        show_legend: bool = False,
        label: str | None = None,
    ) -> None:
        """Add line segments, all in one trace.

        Parameters
        ----------
        point_start : array
            Starts ``[3]`` or ``[m, 3]``; one start is used for all ends.
        point_end : array
            Ends ``[3]`` or ``[m, 3]``; one end is used for all starts.
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        dash : str, optional
            "dot", "dash", "longdash", "dashdot" or "longdashdot".
        color : str or sequence
            One colour, or m colours, or m values, which are drawn in the colour scale.
        show_legend : bool
            Show an entry in the legend.
        label : str, optional
            Name in the legend.

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
        dash: str | None = None,
        color: Color = "red",
        show_legend: bool = False,
        label: str | None = None,
    ) -> None:
        """Add lines through several points each, all in one trace.

        Parameters
        ----------
        points : array
            ``[m, n, 3]``: m lines through n points. A line is interrupted where a point is not finite.
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        dash : str, optional
            "dot", "dash", "longdash", "dashdot" or "longdashdot".
        color : str or sequence
            One colour, or m colours, or m values, which are drawn in the colour scale.
        show_legend : bool
            Show an entry in the legend.
        label : str, optional
            Name in the legend.
        """
        lines = _arrays.real_array("points", points)
        _validate.shaped("points", lines, "[m, 2 or more, 3]")
        # A row of NaN after each line separates it from the next.
        broken = np.full((len(lines), lines.shape[1] + 1, 3), np.nan, np.result_type(lines, np.float32))
        broken[:, :-1] = np.where(np.isfinite(lines).all(-1, keepdims=True), lines, np.nan)
        style = {"width": self.settings["line width"], **colors(color, len(lines), self.settings, lines.shape[1] + 1)}
        if dash is not None:
            style["dash"] = _validate.one_of("dash", dash, _DASHES)
        style = {"mode": "lines", "line": style, "opacity": float(self.settings["opacity"]), "connectgaps": False}
        self._draw(graph.Scatter3d, broken.reshape(-1, 3)[:-1], row, column, show_legend, label, **style)

    def add_rays(
        self,
        rays: Array,
        distance: float | Array = 1.0,
        row: int = 1,
        column: int = 1,
        dash: str | None = None,
        color: Color = "red",
        show_legend: bool = False,
        label: str | None = None,
    ) -> None:
        """Add rays, drawn from their starts over a distance, all in one trace; rays that are NaN are left out.

        Parameters
        ----------
        rays : array
            ``[2, 3]`` or ``[m, 2, 3]``: starts and directions.
        distance : float or array
            One for all, or one for each ray.
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        dash : str, optional
            "dot", "dash", "longdash", "dashdot" or "longdashdot".
        color : str
            Colour of all rays.
        show_legend : bool
            Show an entry in the legend.
        label : str, optional
            Name in the legend.
        """
        starts, ends = _arrays.reach(rays, distance)
        self.add_line(starts, ends, row, column, dash, color, show_legend, label)

    def add_triangle(
        self,
        triangle: Array,
        row: int = 1,
        column: int = 1,
        dash: str | None = None,
        color: Color = "red",
        show_legend: bool = False,
    ) -> None:
        """Add triangles, all in one mesh.

        Parameters
        ----------
        triangle : array
            Corners ``[3, 3]`` or ``[m, 3, 3]``.
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        dash : str, optional
            Without effect; accepted for compatibility.
        color : str or sequence
            One colour, or m colours, or m values, which are drawn in the colour scale.
        show_legend : bool
            Show an entry in the legend.
        """
        corners = _arrays.triangles("triangle", triangle)
        faces = np.arange(3 * len(corners)).reshape(-1, 3)
        self.add_mesh(corners.reshape(-1, 3), faces, row, column, color, show_legend=show_legend)

    def add_mesh(
        self,
        vertices: Array,
        faces: Array,
        row: int = 1,
        column: int = 1,
        color: Color = "red",
        opacity: float | None = None,
        show_legend: bool = False,
        label: str | None = None,
    ) -> None:
        """Add a mesh.

        Parameters
        ----------
        vertices : array
            Points ``[v, 3]``.
        faces : array
            Indices of the corners of triangles ``[t, 3]``.
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        color : str or sequence
            One colour, or t colours, or t values, which are drawn in the colour scale.
        opacity : float, optional
            Opacity, from 0 to 1; by default taken from the settings.
        show_legend : bool
            Show an entry in the legend.
        label : str, optional
            Name in the legend.
        """
        places = _arrays.points("vertices", vertices)
        corners = _arrays.faces("faces", faces, len(places))
        style = face_colors(color, len(corners), self.settings) | {"flatshading": True, "lighting": {"ambient": 0.75}}
        style |= dict(zip("ijk", corners.T, strict=True))
        style["opacity"] = self.settings["opacity"] if opacity is None else figures.share("opacity", opacity)
        self._draw(graph.Mesh3d, places, row, column, show_legend, label, **style)

    def add_sphere(
        self,
        sphere: Array,
        row: int = 1,
        column: int = 1,
        dash: str | None = None,
        color: str = "red",
        show_legend: bool = False,
    ) -> None:
        """Add a sphere.

        Parameters
        ----------
        sphere : array
            Centre and radius, ``[4]`` or ``[1, 4]``.
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        dash : str, optional
            Without effect; accepted for compatibility.
        color : str
            Colour of the sphere.
        show_legend : bool
            Show an entry in the legend.
        """
        grid = _arrays.sphere("sphere", sphere, SPHERE_SAMPLES)
        trace = graph.Surface(
            **dict(zip(AXES, grid, strict=True)),
            colorscale=[[0, figures.colour("color", color)], [1, color]],
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
        surface_color: Array | str,
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
        data_x : array
            Abscissae ``[m, n]``, or ``[n]`` of the columns.
        data_y : array
            Ordinates ``[m, n]``, or ``[m]`` of the rows.
        data_z : array
            Heights ``[m, n]``. Beyond 512 along a side every k-th is drawn, with a note in the figure.
        surface_color : array or str
            Values ``[m, n]``, or one colour.
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        label : str
            Name of the surface, and title of the colour bar.
        mode : str
            Without effect; accepted for compatibility.
        opacity : float
            Opacity, from 0 to 1.
        contour : bool
            Draw lines of equal z.
        """

        def style(factor: int) -> dict[Any, Any]:
            if isinstance(surface_color, str):
                figures.colour("surface_color", surface_color)
                return {"colorscale": [[0, surface_color], [1, surface_color]], "showscale": False}
            values = _arrays.real_array("surface_color", surface_color)
            if values.shape != np.shape(data_z):
                raise ValueError(f"surface_color must be {list(np.shape(data_z))}, got {list(values.shape)}")
            bar = {"title": {"text": figures.text("label", label)}}
            return {
                "surfacecolor": values[::factor, ::factor],
                "colorscale": self.settings["color scale"],
                "colorbar": bar,
            }

        data = data_x, data_y, data_z
        self._add(surface_trace(self, data, label, opacity, contour, style), row, column)

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
        points : array
            Points ``[n, 3]`` of a regular grid.
        values : array
            Values ``[n]`` at these points.
        limits : sequence of float
            Lowest and highest value that is drawn.
        row : int
            Row of the scene, from 1.
        column : int
            Column of the scene, from 1.
        opacity : float
            Opacity, from 0 to 1.
        surface_count : int
            Number of surfaces.
        """
        places, numbers = _arrays.points("points", points), _arrays.real_array("values", values).reshape(-1)
        if len(numbers) != len(places):
            raise ValueError(f"values must have one entry for each of {len(places)} points, got {len(numbers)}")
        low, high = figures.numbers("limits", limits, 2)
        trace = graph.Volume(
            **dict(zip(AXES, places.T, strict=True)),
            value=numbers,
            isomin=low,
            isomax=high,
            opacity=figures.share("opacity", opacity),
            surface_count=_validate.whole("surface_count", surface_count, minimum=1),
            colorscale=self.settings["color scale"],
        )
        self._add(trace, row, column)

    def _draw(
        self, kind: Any, places: np.ndarray, row: int, column: int, show_legend: bool, label: str | None, **style: Any
    ) -> None:
        """Add a trace of points ``[m, 3]``."""
        legend = {"showlegend": _validate.flag("show_legend", show_legend), "name": figures.text("label", label)}
        self._add(kind(**dict(zip(AXES, places.T, strict=True)), **legend, **style), row, column)


def colors(color: Any, count: int, settings: dict[str, Any], repeat: int = 1) -> dict[str, Any]:
    """Return the colours of markers or lines as arguments of Plotly: one, or one for each of `count`.

    Parameters
    ----------
    color : str or sequence
        One colour, `count` colours, or `count` values.
    count : int
        Number of markers or lines.
    settings : dict
        Settings that hold the colour scale of values.
    repeat : int
        Number of points of each, with the gap after it; the last one has no gap.
    """
    if isinstance(color, str):
        return {"color": color}
    if isinstance(color, (list, tuple)) and all(isinstance(item, str) for item in color):
        found, scale = np.asarray(color), {}
    else:
        found, scale = _arrays.real_array("color", color).reshape(-1), {"colorscale": settings["color scale"]}
    if len(found) != count:
        raise ValueError(f"color must be one colour or {count} of them or of values, got {len(found)}")
    found = np.repeat(found, repeat)[: None if repeat == 1 else -1]
    return {"color": found if scale else found.tolist(), **scale}


def face_colors(color: Color, count: int, settings: dict[Any, Any]) -> dict[Any, Any]:
    """Return the colours or values of the `count` triangles of a mesh as arguments of Plotly."""
    style = colors(color, count, settings)
    if isinstance(color, str):
        return style
    if "colorscale" in style:
        return {"intensity": style["color"], "intensitymode": "cell", "colorscale": style["colorscale"]}
    return {"facecolor": style["color"]}


def system_show(
    system: Any,
    *,
    rings: int = 3,
    pattern: str = "rings",
    aim: str = "paraxial",
    title: str | None = None,
    filename: str | os.PathLike[str] | None = None,
    show: bool | None = None,
) -> rayshow:
    """Show a lens system in space with the rays of its fields, all axes in one scale.

    Parameters
    ----------
    system : odak.learn.raytracing.system.optical_system
        The system.
    rings : int
        Number of rings of rays in the pupil, or the count that `pattern` takes.
    pattern : str
        Pattern of the rays of each field in the pupil, see :func:`odak.learn.raytracing.system.launch`. The rays have
        the reference wavelength.
    aim : str
        Method that directs the rays into the stop, see :func:`odak.learn.raytracing.system.launch`.
    title : str, optional
        Title; by default the name of the system.
    filename : str or os.PathLike, optional
        File to save the figure to: a ``.html`` page, Markdown, or an image.
    show : bool, optional
        Show the figure; by default if it is not saved.

    Returns
    -------
    rayshow
        The figure, with z to the right and y up. One trace holds all rays of a field; a ray that is lost ends at the
        last surface it reached. Shifts and tilts are drawn.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system
    >>> from odak.visualize.plotly import system_show
    >>> figure = system_show(load_system("cooke_triplet"), show=False)
    >>> [trace.name for trace in figure.fig.data if trace.showlegend]
    ['field 0°', 'field 14°', 'field 20°']
    """
    from odak.learn.raytracing.system import launch, optical_system
    from odak.learn.raytracing.system.pupils import PATTERNS
    from odak.learn.raytracing.system.sketches import field_label, system_scene, unit_of

    _validate.instance("system", system, optical_system, "an odak.learn.raytracing.system.optical_system")
    import torch

    if not isinstance(pattern, torch.Tensor):
        pattern = _validate.one_of("pattern", pattern, PATTERNS)
    _validate.integer("rings", rings, minimum=1)
    title, show = figures.text("title", title), None if show is None else _validate.flag("show", show)
    name = system.name or "Optical system"
    figure = rayshow(
        subplot_titles=[name if title is None else title],
        line_width=2.0,
        opacity=0.8,
        shape=(1100, 600),
        labels=[f"{axis} ({unit_of(system)})" for axis in "xyz"],
    )
    figure.settings["aspect ratio"] = "data"
    figure.settings["margin"] = [10, 10, 30, 50]
    figure.fig.update_layout(legend={"x": 0.99, "xanchor": "right", "y": 0.99})
    with torch.no_grad():
        scene = system_scene(system, launch(system, pattern, rings, aim=aim))
    _draw_surfaces(figure, scene, system.stop)
    for i, lines in enumerate(scene.paths):
        colour = figures.COLORS[i % len(figures.COLORS)]
        figure.add_path(lines, color=colour, show_legend=True, label=f"field {field_label(system, i)}")
    _frame_from_the_side(figure)
    figure._finish(filename, show)
    return figure


def _draw_surfaces(figure, scene, stop: int) -> None:
    """Draw each piece of glass as one closed mesh, mirrors as sheets, and the image plane."""
    from odak.learn.raytracing.system.surfaces import is_break

    sheets = [scene.sheet(i, RADII, ANGLES)[0] for i in range(len(scene.items) - 1)]
    behind = dict(scene.elements())
    for i, item in enumerate(scene.items[:-1]):
        if is_break(item):
            continue
        if item.reflects:
            figure.add_mesh(*_mesh(sheets[i]), color=MIRROR, opacity=0.6, label="mirror")
        elif i in behind:
            figure.add_mesh(*_mesh(sheets[i], sheets[behind[i]]), color=GLASS, opacity=0.35, label=f"element {i + 1}")
        if i == stop:
            figure.add_path(sheets[i][-1:], color="black", label="stop")
    matrix, origin = scene.frames[-1]
    local = (scene.paths[..., -1, :] - origin) @ matrix
    reached = np.nanmax(np.abs(local[..., :2]), axis=(0, 1), initial=0.0)
    x, y = np.maximum(1.1 * reached, max(scene.radii[:-1]))
    corners = np.array([(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)]) @ matrix.T + origin
    figure.add_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), color=SCREEN, opacity=0.25, label="image plane")


def _mesh(front: np.ndarray, back: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of the points of a surface, or of the body between two, closed at the rims."""
    rings = front if back is None else np.concatenate([front, back[::-1]])
    return rings.reshape(-1, 3), _arrays.grid_faces(*rings.shape[:2])


def _frame_from_the_side(figure) -> None:
    """Place the camera beside the axis, with z to the right and y up, so that everything drawn is in the frame."""
    drawn = [np.stack([np.asarray(trace[axis], float).ravel() for axis in "xyz"], axis=-1) for trace in figure.fig.data]
    points = np.concatenate(drawn)
    points = points[np.isfinite(points).all(-1)]
    width, height = figure.image_size()
    left, right, bottom, top = figure.settings["margin"]
    size = width - left - right, height - bottom - top
    camera, ranges = figures.camera_towards(points, VIEW, (0.0, 1.0, 0.0), size)
    axes: dict[str, dict[Any, Any]] = {f"{a}axis": {"range": span} for a, span in zip("xyz", ranges, strict=True)}
    # Seen from the side the x axis is foreshortened: its numbers would overlap.
    axes["xaxis"] |= {"nticks": 3}
    axes["yaxis"] |= {"nticks": 5}
    figure.fig.update_scenes(camera=camera, **axes)
