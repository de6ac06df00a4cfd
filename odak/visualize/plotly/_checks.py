"""Argument checks of pictures, where Plotly's own would name the trace and not the argument."""

from collections.abc import Iterable, Mapping
from numbers import Real
from typing import Any

from odak import _validate
from odak.visualize.plotly._library import graph


def text(name: str, value) -> Any:
    """Return a title or a label: a string or a number as it is, or None."""
    if value is None or isinstance(value, str) or (isinstance(value, Real) and not isinstance(value, bool)):
        return value
    raise TypeError(f"{name} must be a string, got {type(value).__name__}")


def texts(name: str, value, least: int = 0) -> list:
    """Return titles or labels as a list of at least so many."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise TypeError(f"{name} must be a sequence of strings, got {value!r:.80}")
    found = [text(f"{name}[{i}]", entry) for i, entry in enumerate(value)]
    if len(found) < least:
        raise ValueError(f"{name} must hold {least} strings, got {len(found)}")
    return found


def numbers(name: str, value, count: int, *, positive: bool = False, least: float | None = None) -> list:
    """Return `count` real numbers, such as pixels, as a list."""
    found = list(_validate.several(name, value, count, positive=positive))
    if least is not None and min(found) < least:
        raise ValueError(f"{name} must be at least {least}, got {value!r}")
    return found


def share(name: str, value) -> float:
    """Return a number from 0 to 1."""
    if not 0 <= (number := float(_validate.real(name, value))) <= 1:
        raise ValueError(f"{name} must be from 0 to 1, got {value!r}")
    return number


def mapping(name: str, value, default: Mapping) -> dict:
    """Return settings of Plotly as a new dictionary, the default for None."""
    if value is not None and not isinstance(value, Mapping):
        raise TypeError(f"{name} must be a dictionary, got {type(value).__name__}")
    return dict(default if value is None else value)


def scale(name: str, value):
    """Return a colour scale that Plotly takes: a name, or a list of colours."""
    try:
        graph.Heatmap(colorscale=value)
    except ValueError as error:
        raise ValueError(f"{name} must be a colour scale of Plotly, got {value!r:.80}") from error
    return value


def colour(name: str, value) -> str:
    """Return the name or the code of one colour that Plotly takes."""
    try:
        graph.Scatter(marker={"color": value})
    except ValueError as error:
        raise ValueError(f"{name} must be a colour that Plotly takes, got {value!r:.80}") from error
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a colour's name or code, got {type(value).__name__}")
    return value


def cell(counts: tuple[int, int], row, col) -> dict[str, int]:
    """Return the row and the column of a plot, from 1, after checking that there is one."""
    place = {}
    for name, value, count in zip(("row", "col"), (row, col), counts, strict=True):
        place[name] = _validate.integer(name, value, minimum=1)
        if value > count:
            raise ValueError(f"{name} must be 1 to {count}, got {value}")
    return place
