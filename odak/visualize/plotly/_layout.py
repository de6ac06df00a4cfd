"""One hand for the layouts of all pictures: sizes, margins, titles, square pixels, colour bars beside their images."""

from typing import Any

# In CSS pixels, at the font size of 12: a colour bar with numbers and title; what stands left of an image, and between
# one and the next below it, for names and numbers of axes and a title.
BAR_GAP, BAR_WIDTH, BAR_TEXT = 8.0, 14.0, 70.0
COLUMN_GAP, ROW_GAP = 72.0, 86.0
BAR_SPACE = BAR_GAP + BAR_WIDTH + BAR_TEXT
FONT_SIZE = 12.0
DEFAULT_SIZE = (700.0, 500.0)
DEFAULT_MARGIN = {"l": 80, "r": 80, "b": 80, "t": 100}


def margins(value) -> dict | None:
    """Return left, right, bottom and top margins under the names that Plotly gives them."""
    if value is None or isinstance(value, dict):
        return value
    sides = tuple(value)
    if len(sides) != 4:
        raise ValueError(f"margin must be four numbers (left, right, bottom, top), got {value!r}")
    return dict(zip(("l", "r", "b", "t"), sides, strict=True))


def apply(figure, settings: dict) -> None:
    """Give a figure the size, margins, title and font that its settings hold, leaving all else as it is."""
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


def axis_names(trace) -> tuple[str, str]:
    """Return the names that the layout gives the axes of a trace: ``"xaxis2"``, ``"yaxis2"``."""
    x, y = (f"{kind}axis{(getattr(trace, f'{kind}axis') or kind)[1:]}" for kind in "xy")
    return x, y


def name_axes(figure, trace, labels: tuple[str, str]) -> None:
    """Write labels at the axes of a trace, with numbers."""
    for name, label in zip(axis_names(trace), labels, strict=True):
        if label:
            figure.layout[name].update(title={"text": label}, showticklabels=True)


def square_pixels(figure, trace, origin: str) -> None:
    """Give the axes of an image one scale, its frame no more room than the image, and row 0 its place."""
    x, y = axis_names(trace)
    figure.layout[x].update(constrain="domain")
    figure.layout[y].update(
        scaleanchor=x.replace("axis", ""),
        constrain="domain",
        constraintoward="top",
        autorange="reversed" if origin == "upper" else True,
    )


def place_titles(figure, titles: list[str], row_titles: list[str], cols: int) -> None:
    """Write titles above the subplots, row by row, and beside the rows; they stay with the frames when these move."""
    style = {"font": {"size": 14}, "showarrow": False}
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
    """Return the room between subplots, as parts of the plot, that the texts between them need."""
    side: Any = margins(margin)
    width, height = max(shape[0] - side["l"] - side["r"], 50), max(shape[1] - side["t"] - side["b"], 50)
    gaps = {"horizontal_spacing": (cols, COLUMN_GAP / width), "vertical_spacing": (rows, ROW_GAP / height)}
    return {name: min(gap, 0.4 / (count - 1)) for name, (count, gap) in gaps.items() if count > 1}


def domains(figure) -> dict[str, tuple[float, float]]:
    """Return the domains of all x axes, by their names in the layout."""
    found = {axis.plotly_name: axis.domain for axis in figure.select_xaxes()}
    return {name: (0.0, 1.0) if domain is None else tuple(domain) for name, domain in found.items()}


def place_bars(figure, at_first: dict, share: float = 1.0) -> None:
    """Put each colour bar beside its image, as high as the image, in room that its column gives up.

    Parameters
    ----------
    figure : plotly.graph_objects.Figure
        Its images are heat maps.
    at_first : dict
        What :func:`domains` returned at first: laying out twice is laying out once.
    share : float
        Length of the bars over the height of their images.
    """
    width, height = _plot_size(figure)
    bars = [trace for trace in figure.data if trace.type == "heatmap" and trace.showscale]
    _make_room(figure, at_first, {at_first[axis_names(trace)[0]] for trace in bars}, width)
    for trace in bars:
        x, y = (figure.layout[name] for name in axis_names(trace))
        frame = y.linewidth or 0.0
        (left, right), (low, high) = x.domain, y.domain or (0.0, 1.0)
        across, up = (right - left) * width, (high - low) * height
        if y.scaleanchor:
            wide, tall = _extent(trace)
            scale = min(across / wide, up / tall)
            across, up = wide * scale, tall * scale
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
            title={"side": "right"},
        )


def _make_room(figure, at_first: dict, with_bars: set, width: float) -> None:
    """Narrow the columns of images by their colour bars, and by the texts of their axes where these lack room."""
    size = (figure.layout.font.size or FONT_SIZE) / FONT_SIZE
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
    """Put the colour bars of three-dimensional scenes beside their scenes, several of one scene side by side."""
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
    """Write a line at the foot of a figure, in place of an older one."""
    kept = [a for a in figure.layout.annotations if a.name != "note"]
    figure.layout.annotations = kept
    if text:
        bottom = (figure.layout.margin.b if figure.layout.margin.b is not None else DEFAULT_MARGIN["b"]) - 2
        place = {"xref": "paper", "yref": "paper", "x": 1.0, "y": 0.0, "xanchor": "right", "yanchor": "bottom"}
        figure.add_annotation(text=text, name="note", showarrow=False, yshift=-bottom, font={"size": 11}, **place)


def _plot_size(figure) -> tuple[float, float]:
    """Return how large the room inside the margins is, in CSS pixels."""
    layout = figure.layout
    side = {name: layout.margin[name] if layout.margin[name] is not None else DEFAULT_MARGIN[name] for name in "lrbt"}
    width, height = layout.width or DEFAULT_SIZE[0], layout.height or DEFAULT_SIZE[1]
    return max(width - side["l"] - side["r"], 50.0), max(height - side["b"] - side["t"], 50.0)


def _extent(trace) -> tuple[float, float]:
    """Return how wide and tall an image is, in units of its axes."""
    extents = []
    for kind, count in (("x", trace.z.shape[1]), ("y", trace.z.shape[0])):
        places, step = getattr(trace, kind), getattr(trace, f"d{kind}")
        if places is not None and len(places) > 1:
            extents.append(float(abs(places[-1] - places[0])) * count / (count - 1))
        else:
            extents.append(count * (step or 1.0))
    return extents[0], extents[1]
