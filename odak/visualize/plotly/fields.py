"""Images of fields: amplitude, phase, intensity and angular spectrum, with physical axes and colour bars."""

import base64
import io
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._array import Array
from odak.tools._images import read_levels
from odak.tools._paths import validate_path
from odak.visualize._arrays import image
from odak.visualize.plotly import _checks, _layout
from odak.visualize.plotly._library import graph, make_subplots
from odak.visualize.plotly._panels import CYCLIC_SCALE, MAXIMUM_SIDE, QUANTITIES, Quantity, value_panel
from odak.visualize.plotly._picture import Picture

__all__ = ["detectorshow", "plot2dshow"]

ORIGINS = ("upper", "lower")
INSETS = (".png", ".jpg", ".jpeg", ".gif", ".bmp")
_PLAIN = Quantity(value_panel, "")
_AXIS = {
    "visible": True,
    "showticklabels": False,
    "showgrid": False,
    "zeroline": False,
    "showline": True,
    "linecolor": "black",
    "linewidth": 8,
    "mirror": True,
}


class _Images(Picture):
    """A grid of images."""

    def __init__(self, rows: int, cols: int, titles: list, settings: dict, **spacing):
        figure = make_subplots(rows=rows, cols=cols, **spacing)
        _layout.place_titles(figure, titles, settings["row titles"][:rows], cols)
        super().__init__(figure, settings)
        self._domains = _layout.domains(figure)
        self._cells = rows, cols

    def update_layout(self) -> None:
        """Bring the figure in line with its settings; showing and saving do this first."""
        super().update_layout()
        _layout.place_bars(self.fig, self._domains)

    def _add(self, field, quantity: Quantity, scale, row: int, column: int, showscale: bool, **options) -> None:
        """Add one image of a field."""
        origin = _validate.one_of("origin", options.pop("origin", "upper"), ORIGINS)
        bar = options.pop("bar", None) or quantity.bar
        panel = quantity.panel(field, limit=self.settings["maximum side"], **options)
        if panel.factor > 1:
            size = " × ".join(map(str, field.shape))
            self._say(f"{panel.factor} × {panel.factor} of {size} samples drawn as one ({quantity.reduced})")
        trace = graph.Heatmap(
            z=panel.values,
            **panel.axes,
            zmin=quantity.limits[0],
            zmax=_upper(quantity, panel.values),
            colorscale=scale,
            showscale=_validate.flag("showscale", showscale),
            colorbar={"title": {"text": bar}, **({"dtick": 90} if quantity.cyclic else {})},
            name=bar,
        )
        self.fig.add_trace(trace, row=row, col=column)
        _layout.square_pixels(self.fig, self.fig.data[-1], origin)
        _layout.name_axes(self.fig, self.fig.data[-1], panel.labels)


class plot2dshow(_Images):
    """Images of real values, in rows and columns.

    Parameters
    ----------
    row_titles, subplot_titles : sequence of str
        Titles beside the rows, and above the images, row by row.
    title : str
        Title of the picture.
    rows, cols : int
        How many.
    font_settings : dict
        Font of all texts, as Plotly has it.
    xaxis_settings, yaxis_settings : dict, optional
        Of all axes, as Plotly has them; a black frame without numbers by default.
    color_scale : str
        Name of a colour scale of Plotly; "Twilight" is cyclic, for phases.
    shape : sequence of int
        Width and height in pixels.
    margin : sequence of int
        Left, right, bottom, top, in pixels.
    horizontal_spacing, vertical_spacing : float
        Between images, over the size of the plot.
    """

    def __init__(
        self,
        row_titles: Sequence[str] = ("Sample 1",),
        subplot_titles: Sequence[str] = ("Sample 2",),
        title: str = "test",
        rows: int = 1,
        cols: int = 1,
        font_settings: dict | None = None,
        xaxis_settings: dict | None = None,
        yaxis_settings: dict | None = None,
        color_scale: str = "Inferno",
        shape: Sequence[int] = (1000, 1000),
        margin: Sequence[int] = (65, 50, 65, 90),
        horizontal_spacing: float = 0.05,
        vertical_spacing: float = 0.05,
    ):
        rows, cols = _counts(rows, cols)
        shape = _checks.numbers("shape", shape, 2, positive=True)
        titles = _checks.texts("subplot_titles", subplot_titles)
        settings = {
            "title": _checks.text("title", title),
            "subplot titles": titles,
            "row titles": _checks.texts("row_titles", row_titles),
            "color scale": _checks.scale("color_scale", color_scale),
            "column number": cols,
            "row number": rows,
            "font": _checks.mapping("font_settings", font_settings, {"size": 48}),
            "width": shape[0],
            "height": shape[1],
            "margin": _checks.numbers("margin", margin, 4, least=0),
            "xaxis": _checks.mapping("xaxis_settings", xaxis_settings, _AXIS),
            "yaxis": _checks.mapping("yaxis_settings", yaxis_settings, _AXIS),
            "horizontal spacing": _checks.share("horizontal_spacing", horizontal_spacing),
            "vertical spacing": _checks.share("vertical_spacing", vertical_spacing),
            "maximum side": MAXIMUM_SIDE,
        }
        spacing = {"horizontal_spacing": horizontal_spacing, "vertical_spacing": vertical_spacing}
        super().__init__(rows, cols, titles[: rows * cols], settings, **spacing)

    def add_field(
        self,
        field: Array,
        zoomed_inset: str | os.PathLike | None = None,
        zoomed_inset_settings: dict | None = None,
        row: int = 1,
        col: int = 1,
        showscale: bool = False,
        dx: float | None = None,
        label: str = "",
        origin: str = "upper",
    ) -> None:
        """Add an image.

        Parameters
        ----------
        field : array
            Real ``[rows, columns]``. Beyond ``settings["maximum side"]`` samples a side, 1024, blocks are averaged;
            the picture says so.
        zoomed_inset : str or os.PathLike, optional
            An image file (.png, .jpg, .gif, .bmp) to lay over it.
        zoomed_inset_settings : dict, optional
            Columns ``x`` … ``x + sizex`` and rows ``y − sizey`` … ``y`` that it covers (in the unit of the axes where
            `dx` is given), 0 … 150 by default, and whatever else Plotly knows of layout images.
        row, col : int
            Which image, from 1.
        showscale : bool
            Draw the colour bar.
        dx : float, optional
            Distance between samples in metres; the axes then tell places, from the sample at n // 2.
        label : str
            Title of the colour bar, with the unit.
        origin : {"upper", "lower"}
            Where row 0 is.

        Raises
        ------
        ValueError, TypeError
            If the field is not one real image, or the inset cannot be read.
        """
        place = _checks.cell(self._cells, row, col)
        row, col = place.values()
        label = _checks.text("label", label)
        inset = _checks.mapping("zoomed_inset_settings", zoomed_inset_settings, {})
        values = image("field", field)
        if values.dtype.kind == "c":
            raise TypeError("field must be real, got a complex one; draw its amplitude or phase, or use detectorshow")
        picture = None if zoomed_inset is None else _inset(zoomed_inset)
        self._add(values, _PLAIN, self.settings["color scale"], row, col, showscale, dx=dx, bar=label, origin=origin)
        if picture:
            inset = {"x": 0, "y": 150, "sizex": 150, "sizey": 150} | inset
            # The same rows are covered wherever row 0 is.
            inset = {"yanchor": "bottom" if origin == "upper" else "top", "sizing": "stretch", "layer": "above"} | inset
            self.fig.add_layout_image(source=picture, **place, **inset)

    def update_layout(self) -> None:
        """Bring the figure in line with its settings; showing and saving do this first."""
        for update, name in ((self.fig.update_xaxes, "xaxis"), (self.fig.update_yaxes, "yaxis")):
            update(self.settings[name])
            # Numbers where a unit stands.
            update({"showticklabels": True}, selector=lambda axis: bool(axis.title.text))
        frame = self.settings["yaxis"].get("linewidth", 0)
        self.fig.update_annotations(font=self.settings["font"])
        self.fig.update_annotations(yshift=frame, selector={"yanchor": "bottom", "textangle": None})
        self.fig.update_annotations(xshift=8 + frame, selector={"textangle": 90})
        super().update_layout()


class detectorshow(_Images):
    """Complex fields: amplitude, phase and intensity, side by side.

    Parameters
    ----------
    row_titles : sequence of str
        Titles beside the rows.
    subplot_titles : sequence of str
        Names of amplitude, phase and intensity (those drawn are shown); or titles of all images, row by row.
    title : str
        Title of the picture.
    rows, cols : int
        Fields, in rows and columns.
    show_intensity, show_amplitude, show_phase, show_spectrum : bool
        What is drawn of each.
    shape : sequence of int
        Width and height in pixels.
    margin : sequence of int
        Left, right, bottom, top, in pixels.

    Notes
    -----
    The phase has a cyclic colour scale, ``settings["phase color scale"]``, from −180° to 180°: equal phases have equal
    colours.
    """

    def __init__(
        self,
        row_titles: Sequence[str] = ("Field 1",),
        subplot_titles: Sequence[str] = ("Amplitude", "Phase", "Intensity"),
        title: str = "detector",
        rows: int = 1,
        cols: int = 1,
        show_intensity: bool = False,
        show_amplitude: bool = True,
        show_phase: bool = True,
        shape: Sequence[int] = (1000, 1000),
        margin: Sequence[int] = (65, 50, 65, 90),
        show_spectrum: bool = False,
    ):
        rows, cols = _counts(rows, cols)
        shape, margin = _checks.numbers("shape", shape, 2, positive=True), _checks.numbers("margin", margin, 4, least=0)
        shown = {
            "show_amplitude": show_amplitude,
            "show_phase": show_phase,
            "show_intensity": show_intensity,
            "show_spectrum": show_spectrum,
        }
        wanted = show_amplitude, show_phase, show_intensity, show_spectrum = tuple(
            _validate.flag(name, value) for name, value in shown.items()
        )
        self._quantities = [name for name, shown in zip(QUANTITIES, wanted, strict=True) if shown]
        if not self._quantities:
            raise ValueError("at least one of show_amplitude, show_phase, show_intensity, show_spectrum must be true")
        count = len(self._quantities)
        settings = {
            "title": _checks.text("title", title),
            "subplot titles": _checks.texts("subplot_titles", subplot_titles),
            "row titles": _checks.texts("row_titles", row_titles),
            "color scale": "Portland",
            "phase color scale": CYCLIC_SCALE,
            "sub column no": count,
            "column number": cols * count,
            "row number": rows,
            "show amplitude": show_amplitude,
            "show phase": show_phase,
            "show intensity": show_intensity,
            "show spectrum": show_spectrum,
            "width": shape[0],
            "height": shape[1],
            "margin": margin,
            "maximum side": MAXIMUM_SIDE,
        }
        titles = self._titles(settings["subplot titles"], wanted, rows, cols)
        spacing = _layout.spacing(rows, cols * count, shape, margin)
        super().__init__(rows, cols * count, titles, settings, **spacing)
        self._cells = rows, cols

    def add_field(
        self,
        field: Array,
        row: int = 1,
        col: int = 1,
        showscale: bool = False,
        dx: float | None = None,
        wavelength: float | None = None,
        origin: str = "upper",
    ) -> None:
        """Add a field: one image for each quantity that is drawn.

        Parameters
        ----------
        field : array
            Complex (or real) ``[rows, columns]``. Beyond ``settings["maximum side"]`` samples a side, 1024, blocks
            become one: intensities are averaged, phases picked; the picture says so.
        row, col : int
            Which field, from 1.
        showscale : bool
            Draw colour bars.
        dx : float, optional
            Distance between samples in metres; the axes then tell places, from the sample at n // 2.
        wavelength : float, optional
            In metres; for the angular spectrum.
        origin : {"upper", "lower"}
            Where row 0 is.
        """
        values, count = image("field", field), len(self._quantities)
        row, col = _checks.cell(self._cells, row, col).values()
        if wavelength is not None:
            _validate.real("wavelength", wavelength, positive=True)
        for i, name in enumerate(self._quantities):
            scale = self.settings["phase color scale" if QUANTITIES[name].cyclic else "color scale"]
            place = row, (col - 1) * count + 1 + i
            options: dict[str, Any] = {"dx": dx, "wavelength": wavelength, "origin": origin}
            self._add(values, QUANTITIES[name], scale, *place, showscale, **options)

    def _titles(self, given: list, wanted, rows: int, cols: int) -> list:
        """Return the titles of all images, row by row."""
        count = sum(map(bool, wanted))
        if len(given) == 3 != rows * cols * count or given == ["Amplitude", "Phase", "Intensity"]:
            named = [name for name, shown in zip([*given, "Angular spectrum"], wanted, strict=True) if shown]
            return named * (rows * cols)
        return given[: rows * cols * count]


def _counts(rows, cols) -> tuple[int, int]:
    return _validate.integer("rows", rows, minimum=1), _validate.integer("cols", cols, minimum=1)


def _upper(quantity: Quantity, values: np.ndarray):
    """Return the top of the colour scale: given, or the greatest value where the bottom is given."""
    if quantity.limits[1] is not None or quantity.limits[0] is None:
        return quantity.limits[1]
    greatest = float(np.nanmax(values, initial=0.0))
    return greatest if greatest > 0 else 1.0


def _inset(path) -> str:
    """Return an image file as the address of a PNG image."""
    from PIL import Image

    path = validate_path(path, INSETS, name="zoomed_inset")
    try:
        levels = read_levels(path)
    except ValueError as error:
        raise ValueError(f"zoomed_inset {path!r} cannot be read as an image: {error}") from error
    levels = (levels // 257).astype(np.uint8) if levels.dtype == np.uint16 else levels
    stream = io.BytesIO()
    Image.fromarray(levels).convert("RGBA").save(stream, "PNG")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
