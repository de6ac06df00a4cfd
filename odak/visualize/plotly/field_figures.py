"""Figures of fields, surfaces and curves: amplitude, phase, intensity, angular spectrum, with physical axes."""

import itertools
import math
import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from odak import _validate
from odak._array import Array
from odak.tools.file import read_levels
from odak.tools.paths import validate_path
from odak.visualize import _arrays
from odak.visualize._arrays import image as one_image
from odak.visualize._arrays import real_array, to_numpy
from odak.visualize.plotly import figures
from odak.visualize.plotly.figures import Figure, graph, make_subplots

MAXIMUM_SIDE = 1024
SPECTRUM_FLOOR = -60.0  # dB
_UNITS = (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9))


class Panel(NamedTuple):
    """One image as it is drawn.

    Attributes
    ----------
    values : numpy.ndarray
        ``[rows, columns]``.
    axes : dict
        Positions of columns and rows, as arguments of a heat map.
    labels : tuple of str
        Names of the axes with their unit, empty without a pitch.
    factor : int
        Number of samples of the field, along each axis, for one of the image.
    """

    values: np.ndarray
    axes: dict[Any, Any]
    labels: tuple[str, str]
    factor: int


class Quantity(NamedTuple):
    """Quantity of a field that can be drawn.

    Attributes
    ----------
    panel : callable
        Function of a field, its pitch, the wavelength and the longest side to draw that returns a :class:`Panel`.
    bar : str
        Title of the colour bar, with the unit.
    cyclic : bool
        True if the two ends of its range are equal.
    limits : tuple
        Values at the ends of the colour scale, None where they follow from the image.
    reduced : str
        How samples are combined that are drawn as one.
    """

    panel: Callable[..., Panel]
    bar: str
    cyclic: bool = False
    limits: tuple[Any, ...] = (None, None)
    reduced: str = "averaged"


def reduction(shape: tuple[int, ...], limit: int) -> int:
    """Return the factor by which to reduce an image so that no side is longer than `limit`."""
    return max(1, math.ceil(max(shape) / limit))


def averaged(values: np.ndarray, factor: int) -> np.ndarray:
    """Return the means of blocks of `factor` × `factor` samples, of smaller blocks at the far edges."""
    if factor == 1:
        return values
    values = values.astype(np.result_type(values, np.float32), copy=False)
    for axis in range(2):
        starts = np.arange(0, values.shape[axis], factor)
        counts = np.minimum(factor, values.shape[axis] - starts).astype(values.dtype)
        values = np.add.reduceat(values, starts, axis=axis) / (counts[:, None] if axis == 0 else counts)
    return values


def picked(values: np.ndarray, factor: int) -> np.ndarray:
    """Return the middle sample of each block of `factor` × `factor` samples."""
    rows, columns = (np.minimum(np.arange(0, n, factor) + factor // 2, n - 1) for n in values.shape)
    return values[np.ix_(rows, columns)]


Pitch: TypeAlias = float | Sequence[float] | None


def value_panel(
    values: np.ndarray, dx: Pitch = None, wavelength: float | None = None, limit: int = MAXIMUM_SIDE
) -> Panel:
    """Return a real image, reduced by averaging."""
    return _in_space(averaged, values, dx, limit)


def amplitude(field: np.ndarray, dx: Pitch = None, wavelength: float | None = None, limit: int = MAXIMUM_SIDE) -> Panel:
    """Return the amplitude; for a block of samples the root of its mean intensity."""
    return _in_space(lambda u, f: np.abs(u) if f == 1 else np.sqrt(averaged(_power(u), f)), field, dx, limit)


def phase(field: np.ndarray, dx: Pitch = None, wavelength: float | None = None, limit: int = MAXIMUM_SIDE) -> Panel:
    """Return the phase in degrees."""
    return _in_space(lambda u, f: np.rad2deg(np.angle(picked(u, f))), field, dx, limit)


def intensity(field: np.ndarray, dx: Pitch = None, wavelength: float | None = None, limit: int = MAXIMUM_SIDE) -> Panel:
    """Return the squared amplitude."""
    return _in_space(lambda u, f: averaged(_power(u), f), field, dx, limit)


def spectrum(field: np.ndarray, dx: Pitch = None, wavelength: float | None = None, limit: int = MAXIMUM_SIDE) -> Panel:
    """Return the power of the plane waves that make up the field in dB below the strongest, over their angles.

    The sines of the angles are the direction cosines λ·f along x and y; evanescent waves are left out.
    """
    if dx is None or wavelength is None:
        raise ValueError("the angular spectrum needs dx and wavelength, in metres")
    wavelength = _validate.constant("wavelength", wavelength, positive=True)
    power = _power(np.fft.fftshift(np.fft.fft2(field)))
    sines = [
        np.fft.fftshift(np.fft.fftfreq(n, step)) * wavelength for n, step in zip(field.shape, _pitches(dx), strict=True)
    ]
    inside = [np.flatnonzero(np.abs(sine) < 1) for sine in sines]
    power = power[np.ix_(*inside)]
    factor = reduction(power.shape, limit)
    starts = [np.arange(0, len(index), factor) for index in inside]
    y, x = (
        np.add.reduceat(sine[index], start) / np.minimum(factor, len(index) - start)
        for sine, index, start in zip(sines, inside, starts, strict=True)
    )
    power = averaged(power, factor)
    strongest = power.max()
    floor = 10 ** (SPECTRUM_FLOOR / 10)
    decibels = 10 * np.log10(np.maximum(power / strongest if strongest > 0 else power, floor))
    axes = {"x": np.rad2deg(np.arcsin(x)), "y": np.rad2deg(np.arcsin(y))}
    return Panel(decibels, axes, ("angle along x (°)", "angle along y (°)"), factor)


QUANTITIES = {
    "amplitude": Quantity(amplitude, "amplitude (a.u.)", limits=(0, None), reduced="root mean square"),
    "phase": Quantity(phase, "phase (°)", True, (-180, 180), "every k-th sample"),
    "intensity": Quantity(intensity, "intensity (a.u.)", limits=(0, None)),
    "spectrum": Quantity(spectrum, "power (dB)", limits=(SPECTRUM_FLOOR, 0)),
}


def unit_of(extent: float) -> tuple[str, float]:
    """Return the name and size in metres of the largest unit below a length."""
    return next(((name, size) for name, size in _UNITS if extent >= size), _UNITS[-1])


def length(value: float) -> str:
    """Return a length in metres as text, such as ``"532 nm"``."""
    name, size = unit_of(value)
    return f"{value / size:.6g} {name}"


def _in_space(compute, field, dx, limit) -> Panel:
    factor = reduction(field.shape, limit)
    unit, size = None, 1.0
    steps = (1.0, 1.0)
    if dx is not None:
        steps = _pitches(dx)
        unit, size = unit_of(max(n * step for n, step in zip(field.shape, steps, strict=True)))
    dy, dx = (step / size for step in steps)
    # The sample n // 2 lies on the optical axis; without a pitch samples are counted from 0.
    first = [(factor - 1) / 2 - (n // 2 if unit else 0) for n in field.shape]
    axes = {"y0": first[0] * dy, "dy": factor * dy, "x0": first[1] * dx, "dx": factor * dx}
    return Panel(compute(field, factor), axes, (f"x ({unit})", f"y ({unit})") if unit else ("", ""), factor)


def _power(field) -> np.ndarray:
    return field.real**2 + field.imag**2


def _pitches(dx) -> tuple[float, float]:
    """Return the distances between rows and between columns."""
    dy, dx = _validate.pair("dx", dx, positive=True)
    return _validate.constant("dx", dy), _validate.constant("dx", dx)


ORIGINS = ("upper", "lower")
# In pixels: images of a detector figure that would be narrower are wrapped to two beside each other.
NARROWEST = 230
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


class _Images(Figure):
    """A grid of images."""

    def __init__(self, rows: int, cols: int, titles: list, row_titles: list[Any], settings: dict[Any, Any], **spacing):
        figure = make_subplots(rows=rows, cols=cols, **spacing)
        figures.place_titles(figure, titles, row_titles, cols)
        super().__init__(figure, settings)
        self._domains = figures.domains(figure)
        self._rows, self._cells = rows, (rows, cols)

    def update_layout(self) -> None:
        """Apply the settings to the figure; done before it is shown or saved."""
        super().update_layout()
        share, fit = self.settings.get("colorbar length", 1.0), self.settings["height"] is None
        figures.place_images(self.fig, self._domains, share, rows=self._rows, fit_height=fit)

    def _add(self, field, quantity: Quantity, scale, row: int, column: int, showscale: bool, **options) -> None:
        """Add one image of a field."""
        origin = _validate.one_of("origin", options.pop("origin", "upper"), ORIGINS)
        unlabelled = options.pop("unlabelled", ("", ""))
        bar = options.pop("bar", None) or quantity.bar
        self._say_what_is_blank(field)
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
            colorbar={"title": {"text": bar}, **({"dtick": 90} if quantity.cyclic else {"nticks": 6})},
            name=bar,
        )
        self.fig.add_trace(trace, row=row, col=column)
        figures.square_pixels(self.fig, self.fig.data[-1], origin)
        figures.name_axes(self.fig, self.fig.data[-1], panel.labels if any(panel.labels) else unlabelled)


class plot2dshow(_Images):
    """Images of real values, in rows and columns.

    Parameters
    ----------
    row_titles : sequence of str
        Titles beside the rows.
    subplot_titles : sequence of str
        Titles above the images, row by row.
    title : str
        Title of the figure.
    rows : int
        Number of rows of images.
    cols : int
        Number of columns of images.
    font_settings : dict
        Font of all texts, as in Plotly's layout.
    xaxis_settings : dict, optional
        Settings of all x axes, as in Plotly's layout; a black frame without numbers by default.
    yaxis_settings : dict, optional
        Settings of all y axes, as in Plotly's layout; a black frame without numbers by default.
    color_scale : str
        Name of a colour scale of Plotly; "Twilight" is cyclic, for phases.
    shape : sequence of int
        Width and height in pixels.
    margin : sequence of int
        Left, right, bottom, top, in pixels.
    horizontal_spacing : float
        Spacing between columns, as a fraction of the width of the plot.
    vertical_spacing : float
        Spacing between rows, as a fraction of the height of the plot.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.visualize.plotly import plot2dshow
    >>> figure = plot2dshow()
    >>> figure.add_field(np.eye(8))
    >>> len(figure.fig.data)
    1
    """

    def __init__(
        self,
        row_titles: Sequence[str] = ("Sample 1",),
        subplot_titles: Sequence[str] = ("Sample 2",),
        title: str = "test",
        rows: int = 1,
        cols: int = 1,
        font_settings: dict[Any, Any] | None = None,
        xaxis_settings: dict[Any, Any] | None = None,
        yaxis_settings: dict[Any, Any] | None = None,
        color_scale: str = "Inferno",
        shape: Sequence[int] = (1000, 1000),
        margin: Sequence[int] = (65, 50, 65, 90),
        horizontal_spacing: float = 0.05,
        vertical_spacing: float = 0.05,
    ):
        rows, cols = _counts(rows, cols)
        titles = figures.texts("subplot_titles", subplot_titles)
        settings = {
            "title": figures.text("title", title),
            "subplot titles": titles,
            "row titles": figures.texts("row_titles", row_titles),
            "color scale": figures.scale("color_scale", color_scale),
            "column number": cols,
            "row number": rows,
            "font": figures.mapping("font_settings", font_settings, {"size": 48}),
            **figures.frame(shape, margin),
            "xaxis": figures.mapping("xaxis_settings", xaxis_settings, _AXIS),
            "yaxis": figures.mapping("yaxis_settings", yaxis_settings, _AXIS),
            "horizontal spacing": figures.share("horizontal_spacing", horizontal_spacing),
            "vertical spacing": figures.share("vertical_spacing", vertical_spacing),
            "maximum side": MAXIMUM_SIDE,
        }
        spacing = {"horizontal_spacing": horizontal_spacing, "vertical_spacing": vertical_spacing}
        super().__init__(rows, cols, titles[: rows * cols], settings["row titles"][:rows], settings, **spacing)

    def add_field(
        self,
        field: Array,
        zoomed_inset: str | os.PathLike[str] | None = None,
        zoomed_inset_settings: dict[Any, Any] | None = None,
        row: int = 1,
        col: int = 1,
        showscale: bool = False,
        dx: float | Sequence[float] | None = None,
        label: str = "",
        origin: str = "upper",
    ) -> None:
        """Add an image.

        Parameters
        ----------
        field : array
            Real ``[rows, columns]``. Beyond ``settings["maximum side"]`` samples a side, 1024, blocks of
            samples are averaged, with a note in the figure.
        zoomed_inset : str or os.PathLike, optional
            An image file (.png, .jpg, .gif, .bmp) to lay over it.
        zoomed_inset_settings : dict, optional
            Columns ``x`` … ``x + sizex`` and rows ``y − sizey`` … ``y`` that it covers (in the unit of the axes where
            `dx` is given), 0 … 150 by default, and whatever else Plotly knows of layout images.
        row : int
            Row of the image, from 1.
        col : int
            Column of the image, from 1.
        showscale : bool
            Draw the colour bar.
        dx : float or sequence of float, optional
            Distance between samples in metres, one number or (rows, columns); the axes then show positions, with the
            sample n // 2 at 0.
        label : str
            Title of the colour bar, with the unit.
        origin : {"upper", "lower"}
            Position of row 0.

        Raises
        ------
        ValueError, TypeError
            If the field is not one real image, or the inset cannot be read.
        """
        place = figures.cell(self._cells, row, col)
        row, col = place.values()
        label = figures.text("label", label)
        inset = figures.mapping("zoomed_inset_settings", zoomed_inset_settings, {})
        values = one_image("field", field)
        if values.dtype.kind == "c":
            raise TypeError("field must be real, got a complex one; draw its amplitude or phase, or use detectorshow")
        figure = None if zoomed_inset is None else _inset(zoomed_inset)
        self._add(values, _PLAIN, self.settings["color scale"], row, col, showscale, dx=dx, bar=label, origin=origin)
        if figure:
            inset = {"x": 0, "y": 150, "sizex": 150, "sizey": 150} | inset
            # The same rows are covered for both positions of row 0.
            inset = {"yanchor": "bottom" if origin == "upper" else "top", "sizing": "stretch", "layer": "above"} | inset
            self.fig.add_layout_image(source=figure, **place, **inset)

    def update_layout(self) -> None:
        """Apply the settings to the figure; done before it is shown or saved."""
        for update, name in ((self.fig.update_xaxes, "xaxis"), (self.fig.update_yaxes, "yaxis")):
            update(self.settings[name])
            # Tick labels on the axes whose title gives a unit.
            update({"showticklabels": True}, selector=lambda axis: bool(axis.title.text))
        frame = self.settings["yaxis"].get("linewidth", 0)
        self.fig.update_annotations(font=self.settings["font"])
        self.fig.update_annotations(yshift=frame, selector={"yanchor": "bottom", "textangle": None})
        self.fig.update_annotations(xshift=8 + frame, selector={"textangle": 90})
        super().update_layout()


class detectorshow(_Images):
    """Figure of complex fields: amplitude, phase, intensity and angular spectrum, side by side.

    Parameters
    ----------
    row_titles : sequence of str
        Titles beside the rows.
    subplot_titles : sequence of str
        Names of amplitude, phase and intensity (those drawn are shown); or titles of all images, row by row.
    title : str
        Title of the figure.
    rows : int
        Number of rows of fields.
    cols : int
        Number of columns of fields.
    show_intensity : bool
        Draw the squared amplitude.
    show_amplitude : bool
        Draw the amplitude.
    show_phase : bool
        Draw the phase in degrees.
    shape : sequence of int, optional
        Width and height in pixels; by default 1000 wide, and as high as the images need.
    margin : sequence of int
        Left, right, bottom, top, in pixels.
    show_spectrum : bool
        Draw the power of the plane waves over their angles; needs `dx` and `wavelength` of the field.
    wrap : int, optional
        Largest number of images of a field beside each other; by default 2 where more would be narrower than 230
        pixels.

    Notes
    -----
    Amplitude, intensity and spectrum have a perceptually uniform colour scale, ``settings["color scale"]``. The scale
    of the phase, ``settings["phase color scale"]``, is cyclic from −180° to 180°, so that equal phases have equal
    colours.

    Examples
    --------
    Amplitude and phase of one field:

    >>> import numpy as np
    >>> from odak.visualize.plotly import detectorshow
    >>> figure = detectorshow()
    >>> figure.add_field(np.ones((8, 8), dtype=complex))
    >>> len(figure.fig.data)
    2
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
        shape: Sequence[int] | None = None,
        margin: Sequence[int] = (75, 60, 75, 90),
        show_spectrum: bool = False,
        wrap: int | None = None,
    ):
        rows, cols = _counts(rows, cols)
        margin = figures.numbers("margin", margin, 4, least=0)
        width, height = (1000, None) if shape is None else figures.numbers("shape", shape, 2, positive=True)
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
        if wrap is None:
            each = (width - margin[0] - margin[1]) / (cols * count) - figures.BAR_SPACE
            wrap = 2 if count > 2 and each < NARROWEST else count
        self._across = min(_validate.whole("wrap", wrap, minimum=1), count)
        self._down = math.ceil(count / self._across)
        settings = {
            "title": figures.text("title", title),
            "subplot titles": figures.texts("subplot_titles", subplot_titles),
            "row titles": figures.texts("row_titles", row_titles),
            "color scale": figures.SEQUENTIAL_SCALE,
            "phase color scale": figures.CYCLIC_SCALE,
            "sub column no": count,
            "column number": cols * count,
            "row number": rows,
            "show amplitude": show_amplitude,
            "show phase": show_phase,
            "show intensity": show_intensity,
            "show spectrum": show_spectrum,
            "width": width,
            "height": height,
            "margin": margin,
            "maximum side": MAXIMUM_SIDE,
        }
        titles = self._titles(settings["subplot titles"], wanted, rows, cols)
        size = width, height or width
        spacing = figures.spacing(rows * self._down, cols * self._across, size, margin)
        row_titles = [text for title in settings["row titles"][:rows] for text in (title, *[""] * (self._down - 1))]
        super().__init__(rows * self._down, cols * self._across, titles, row_titles, settings, **spacing)
        self._cells = rows, cols
        for number in range(count, self._across * self._down):
            for row, col in itertools.product(range(rows), range(cols)):
                down, across = divmod(number, self._across)
                unused = self.fig.get_subplot(row * self._down + down + 1, col * self._across + across + 1)
                unused.xaxis.visible = unused.yaxis.visible = False

    def add_field(
        self,
        field: Array,
        row: int = 1,
        col: int = 1,
        showscale: bool = False,
        dx: float | Sequence[float] | None = None,
        wavelength: float | None = None,
        origin: str = "upper",
    ) -> None:
        """Add a field: one image for each quantity that is drawn.

        Parameters
        ----------
        field : array
            Complex or real ``[rows, columns]``. Beyond ``settings["maximum side"]`` samples a side, 1024, blocks of
            samples are drawn as one, with a note in the figure: intensities are averaged, phases picked.
        row : int
            Row of the field, from 1.
        col : int
            Column of the field, from 1.
        showscale : bool
            Draw colour bars.
        dx : float or sequence of float, optional
            Distance between samples in metres, one number or (rows, columns); the axes then show positions, with the
            sample n // 2 at 0; by default they count samples.
        wavelength : float, optional
            Wavelength in metres, for the angular spectrum.
        origin : {"upper", "lower"}
            Position of row 0.
        """
        values = one_image("field", field)
        row, col = figures.cell(self._cells, row, col).values()
        if wavelength is not None:
            _validate.real("wavelength", wavelength, positive=True)
        for i, name in enumerate(self._quantities):
            scale = self.settings["phase color scale" if QUANTITIES[name].cyclic else "color scale"]
            down, across = divmod(i, self._across)
            place = (row - 1) * self._down + down + 1, (col - 1) * self._across + across + 1
            options: dict[str, Any] = {"dx": dx, "wavelength": wavelength, "origin": origin}
            options["unlabelled"] = ("x (samples)", "y (samples)")
            self._add(values, QUANTITIES[name], scale, *place, showscale, **options)

    def _titles(self, given: list[Any], wanted, rows: int, cols: int) -> list[Any]:
        """Return the titles of all images, row by row."""
        count = sum(map(bool, wanted))
        if len(given) == 3 != rows * cols * count or given == ["Amplitude", "Phase", "Intensity"]:
            named = [name for name, shown in zip([*given, "Angular spectrum"], wanted, strict=True) if shown]
            given = named * (rows * cols)
        given = [*given, *[""] * (rows * cols * count)]
        # Titles come field by field; a field may take several rows of images.
        titles = [""] * (rows * self._down * cols * self._across)
        for number in range(rows * cols * count):
            field, i = divmod(number, count)
            (row, col), (down, across) = divmod(field, cols), divmod(i, self._across)
            titles[((row * self._down + down) * cols + col) * self._across + across] = given[number]
        return titles


def _counts(rows, cols) -> tuple[int, int]:
    return _validate.integer("rows", rows, minimum=1), _validate.integer("cols", cols, minimum=1)


def _upper(quantity: Quantity, values: np.ndarray):
    """Return the top of the colour scale: given, or the greatest value where the bottom is given."""
    if quantity.limits[1] is not None or quantity.limits[0] is None:
        return quantity.limits[1]
    greatest = float(np.nanmax(values, initial=0.0))
    return greatest if greatest > 0 else 1.0


def _inset(path):
    """Return the image of a file, as Plotly takes it."""
    from PIL import Image

    path = validate_path(path, INSETS, name="zoomed_inset")
    with _validate.refusing(f"zoomed_inset {path!r} cannot be read as an image: ", ValueError):
        levels = read_levels(path)
    levels = (levels // 257).astype(np.uint8) if levels.dtype == np.uint16 else levels
    return Image.fromarray(levels).convert("RGBA")


MARGIN = (85, 40, 80, 90)
LAYOUTS = ("auto", "rows", "slider")
# Fields in rows by default; more are shown one at a time.
MOST_ROWS = 4
SLIDER_SPACE = 90


@_validate.takes_units("dx", "wavelength")
def field_show(
    field: Array,
    dx: float | Sequence[float] | None = None,
    wavelength: float | None = None,
    *,
    quantities: Sequence[str] | None = None,
    title: str | None = None,
    labels: Sequence[str] = (),
    color_scale: str = figures.SEQUENTIAL_SCALE,
    size: int = 480,
    origin: str = "upper",
    filename: str | os.PathLike[str] | None = None,
    show: bool | None = None,
    layout: str = "auto",
) -> detectorshow:
    """Show fields in one line: amplitude and phase, with axes in mm or µm and colour bars.

    Parameters
    ----------
    field : array or torch.Tensor
        ``[..., rows, columns]``, complex or real; the leading axes are a stack of fields.
    dx : float or sequence of float, optional
        Distance between samples in metres, one number or (rows, columns); by default the axes count samples.
    wavelength : float, optional
        Wavelength in metres, for the title and the angular spectrum.
    quantities : sequence of str, optional
        Quantities to draw: "amplitude", "phase", "intensity", and, where `dx` and `wavelength` are given, "spectrum",
        the power of the plane waves over their angles. By default amplitude and phase of complex fields, the amplitude
        of real ones. Three or four are drawn in two columns.
    title : str, optional
        Title; by default number of samples, pitch and wavelength.
    labels : sequence of str
        Names of the fields.
    color_scale : str
        Colour scale of Plotly for all quantities except the phase, whose scale is cyclic.
    size : int
        Longest side of an image in pixels.
    origin : {"upper", "lower"}
        Position of row 0.
    filename : str or os.PathLike, optional
        File to save the figure to: a ``.html`` page, Markdown, or an image.
    show : bool, optional
        Show the figure; by default if it is not saved.
    layout : {"auto", "rows", "slider"}
        Arrangement of a stack: one row for each field, or one field at a time with a slider and one colour scale for
        the whole stack. "auto" takes the slider for more than 4 fields, unless the figure is saved as an image.

    Returns
    -------
    detectorshow
        The figure.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.visualize.plotly import field_show
    >>> figure = field_show(np.ones((4, 6), complex), dx=8e-6, wavelength=532e-9, show=False)
    >>> [trace.name for trace in figure.fig.data], figure.settings["title"]
    (['amplitude (a.u.)', 'phase (°)'], '4 × 6 samples of 8 µm, wavelength 532 nm')
    """
    values = to_numpy("field", field)
    _validate.shaped("field", values, "[..., rows, columns], not empty")
    if dx is not None:
        _pitches(dx)
    if wavelength is not None:
        _validate.real("wavelength", wavelength, positive=True)
    show = None if show is None else _validate.flag("show", show)
    size, labels = _validate.whole("size", size, minimum=1), figures.texts("labels", labels)
    if quantities is None:
        quantities = ("amplitude", "phase") if values.dtype.kind == "c" else ("amplitude",)
    names = _validate.texts("quantities", [quantities] if isinstance(quantities, str) else quantities)
    chosen = {_validate.one_of("quantities", name, QUANTITIES) for name in names}
    stack = values.reshape(-1, *values.shape[-2:])
    layout = _validate.one_of("layout", layout, LAYOUTS)
    _validate.instance("filename", filename, (str, os.PathLike, type(None)), "a path or None")
    if layout == "auto":
        still = filename is not None and os.path.splitext(os.fspath(filename))[1].lower() in figures.IMAGES
        layout = "slider" if len(stack) > MOST_ROWS and not still else "rows"
    if not labels:
        labels = [f"Field {i + 1}" for i in range(len(stack))] if len(stack) > 1 else [""]
    rows, columns = stack.shape[1:]
    across = len(chosen) if len(chosen) < 3 else 2
    wide = max(columns * size / max(rows, columns), 120) + figures.BAR_SPACE
    width = across * wide + (across - 1) * figures.COLUMN_GAP + MARGIN[0] + MARGIN[1]
    slides = layout == "slider" and len(stack) > 1
    figure = detectorshow(
        row_titles=[""] if slides else labels,
        title=_description(rows, columns, dx, wavelength) if title is None else title,
        rows=1 if slides else len(stack),
        margin=(*MARGIN[:2], MARGIN[2] + (SLIDER_SPACE if slides else 0), MARGIN[3]),
        wrap=across,
        show_amplitude="amplitude" in chosen,
        show_phase="phase" in chosen,
        show_intensity="intensity" in chosen,
        show_spectrum="spectrum" in chosen,
    )
    figure.settings |= {"width": round(width), "color scale": figures.scale("color_scale", color_scale)}
    for i, one in enumerate(stack):
        row = 1 if slides else i + 1
        figure.add_field(one, row=row, showscale=True, dx=dx, wavelength=wavelength, origin=origin)
    if slides:
        _add_slider(figure.fig, len(chosen), labels)
    figure._finish(filename, show)
    return figure


def _description(rows, columns, dx, wavelength) -> str:
    text = f"{rows} × {columns} samples"
    if dx is not None:
        sizes = dict.fromkeys(map(length, _pitches(dx)))
        text += f" of {' × '.join(sizes)}"
    return text + (f", wavelength {length(float(wavelength))}" if wavelength is not None else "")


def _add_slider(figure, count: int, labels) -> None:
    """Show one field of a stack at a time, `count` images each, with the colour scales of the whole stack."""
    fields = len(figure.data) // count
    for i in range(count):
        traces = figure.data[i::count]
        top = [trace.zmax for trace in traces if trace.zmax is not None]
        for number, trace in enumerate(traces):
            trace.update(zmax=max(top) if top else None, visible=number == 0)
    names = [str(label) for label in labels][:fields] + [str(i + 1) for i in range(len(labels), fields)]
    steps = [
        {"label": name, "method": "restyle", "args": [{"visible": [j // count == i for j in range(fields * count)]}]}
        for i, name in enumerate(names)
    ]
    place = {"x": 0.0, "len": 1.0, "y": 0.0, "yanchor": "top", "pad": {"t": 65, "b": 5}}
    figure.update_layout(sliders=[{"steps": steps, "active": 0, "currentvalue": {"prefix": ""}, **place}])


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
        tick_no = figures.numbers("tick_no", tick_no, 3)
        labels, types = figures.texts("labels", labels, 3), figures.texts("types", types, 3)
        settings = {
            "title": figures.text("title", title),
            "color scale": figures.HEIGHT_SCALE,
            "font size": _validate.whole("font_size", font_size, minimum=1),
            **figures.frame(shape, margin),
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
        bar = {"len": self.settings["colorbar length"], "title": {"text": self.settings["z label"]}}
        style = {"colorscale": self.settings["color scale"], "colorbar": bar}
        data = data_x, data_y, data_z
        self.fig.add_trace(surface_trace(self, data, label, opacity, contour, lambda factor: style))

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


class plotshow(_Images):
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
        settings = {
            "subplot titles": titles,
            "color scale": figures.SEQUENTIAL_SCALE,
            "font size": _validate.whole("font_size", font_size, minimum=1),
            "x label": labels[0],
            "y label": labels[1],
            **figures.frame(shape, margin),
            "colorbar length": _validate.real("colorbarlength", colorbarlength, positive=True),
            "maximum side": MAXIMUM_SIDE,
        }
        super().__init__(rows, cols, titles[: rows * cols], [], settings)

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
        self, image: Array, label: str = "", row: int = 1, col: int = 1, showscale: bool = False, origin: str = "upper"
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
        scale, label, values = self.settings["color scale"], figures.text("label", label), one_image("image", image)
        self._add(real_array("image", values), _PLAIN, scale, row, col, showscale, bar=label, origin=origin)

    def update_layout(self) -> None:
        """Apply the settings to the figure; done before it is shown or saved."""
        settings = self.settings
        self.fig.update_xaxes(title={"text": settings["x label"]})
        self.fig.update_yaxes(title={"text": settings["y label"]})
        super().update_layout()


def surface_trace(
    figure: Figure, data: Any, label: str, opacity: float, contour: bool, style: Callable[[int], dict[str, Any]]
) -> graph.Surface:
    """Return a surface for Plotly, every k-th sample of which is drawn; `style` is a function of k."""
    x, y, z = _arrays.heights(*data)
    factor = reduction(z.shape, MAXIMUM_SURFACE)
    if factor > 1:
        figure._say(f"every {factor}. point of {' × '.join(map(str, z.shape))} drawn")
    thin = slice(None, None, factor)
    return graph.Surface(
        **{axis: value[(thin,) * value.ndim] for axis, value in zip(_AXES, (x, y, z), strict=True)},
        **style(factor),
        name=figures.text("label", label),
        opacity=figures.share("opacity", opacity),
        contours={"z": {"show": _validate.flag("contour", contour)}},
    )
