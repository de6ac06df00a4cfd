"""One style for all figures: template, colours, sizes, and the placement of images, titles, colour bars and cameras."""

import math
from typing import Any

import numpy as np

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


def margins(value) -> dict | None:
    """Return left, right, bottom and top margins under the names that Plotly gives them."""
    if value is None or isinstance(value, dict):
        return value
    sides = tuple(value)
    if len(sides) != 4:
        raise ValueError(f"margin must be four numbers (left, right, bottom, top), got {value!r}")
    return dict(zip(("l", "r", "b", "t"), sides, strict=True))


def apply(figure, settings: dict) -> None:
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
    figure.layout.template = _merged(figure.layout.template.to_plotly_json(), TEMPLATE)


def _merged(base: dict, changes: dict) -> dict:
    """Return a nested dictionary with the entries of another in place of its own."""
    both = {name: _merged(base[name], changes[name]) for name in base.keys() & changes if isinstance(base[name], dict)}
    return {**base, **changes, **both}


def axis_names(trace) -> tuple[str, str]:
    """Return the names that the layout gives the axes of a trace: ``"xaxis2"``, ``"yaxis2"``."""
    x, y = (f"{kind}axis{(getattr(trace, f'{kind}axis') or kind)[1:]}" for kind in "xy")
    return x, y


def name_axes(figure, trace, labels: tuple[str, str]) -> None:
    """Set the titles of the axes of a trace and show their numbers."""
    for name, label in zip(axis_names(trace), labels, strict=True):
        if label:
            figure.layout[name].update(title={"text": label}, showticklabels=True)


def square_pixels(figure, trace, origin: str) -> None:
    """Set equal scales of the axes of an image, a frame that fits it, and the position of row 0."""
    x, y = axis_names(trace)
    figure.layout[x].update(constrain="domain")
    figure.layout[y].update(
        scaleanchor=x.replace("axis", ""),
        constrain="domain",
        constraintoward="top",
        autorange="reversed" if origin == "upper" else True,
    )


def place_titles(figure, titles: list[str], row_titles: list[str], cols: int) -> None:
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


def spacing(rows: int, cols: int, shape, margin) -> dict:
    """Return the spacing between subplots that their texts need, as fractions of the plot."""
    side: Any = margins(margin)
    width, height = max(shape[0] - side["l"] - side["r"], 50), max(shape[1] - side["t"] - side["b"], 50)
    gaps = {"horizontal_spacing": (cols, COLUMN_GAP / width), "vertical_spacing": (rows, ROW_GAP / height)}
    return {name: min(gap, 0.4 / (count - 1)) for name, (count, gap) in gaps.items() if count > 1}


def domains(figure) -> dict[str, tuple[float, float]]:
    """Return the domains of all x axes, by their names in the layout."""
    found = {axis.plotly_name: axis.domain for axis in figure.select_xaxes()}
    return {name: (0.0, 1.0) if domain is None else tuple(domain) for name, domain in found.items()}


def place_images(figure, at_first: dict, share: float = 1.0, *, rows: int = 1, fit_height: bool = False) -> None:
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
        Set the height of the figure, and those of the rows, by the heights of the images.
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


def _narrow_columns(figure, at_first: dict, with_bars: set, width: float) -> None:
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


def place_scene_bars(figure) -> None:
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


def note(figure, text: str) -> None:
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


def camera_towards(points: np.ndarray, direction, up, size: tuple[float, float]) -> tuple[dict, list[list[float]]]:
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
