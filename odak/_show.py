"""Objects in notebooks and prompts: a page with pictures, numbers and warnings, and a description in one line.

A class takes part by ``_repr_html_``, which calls :func:`page` with a function of the object that returns a
:class:`View`, or with the name "module:function" of one, in a module which itself imports the class, as drawings
import lenses. Such a module is loaded when an object is first shown.
"""

import base64
import html
import importlib
import inspect
import io
import struct
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from odak._array import is_array, is_readable
from odak._warnings import OdakWarning

Kind = TypeVar("Kind", bound=type)
# Of the fields or the wavelengths of a figure.
COLOURS = ("#2166ac", "#1b7837", "#b2182b", "#762a83", "#b35806", "#016665")
# Longest description, and longest text within one.
LONGEST, WORDS = 600, 48
# Largest side of a picture in pixels, and the length of the longer side to which smaller ones are enlarged.
SIDE, SHORTEST = 640, 240
_BOX = "border-left:4px solid #b35806;background:#fff4e5;color:#202020;padding:.4em .8em;margin:.5em 0;max-width:60em"
_CELL = "padding:.15em .9em .15em 0;text-align:left;vertical-align:top;overflow-wrap:normal"


class View(NamedTuple):
    """Parts of the page of an object.

    Attributes
    ----------
    title : str
        Its first line.
    pictures : sequence of tuple
        Captions, and pictures: bytes of a PNG file or the text of an SVG file.
    table : sequence of sequence
        Rows of numbers and texts, the first of which is the head.
    warnings : sequence of str
        What endangers a result; warnings that are issued while the view is made are added.
    """

    title: str
    pictures: Sequence[tuple[str, bytes | str]] = ()
    table: Sequence[Sequence[Any]] = ()
    warnings: Sequence[str] = ()


def page(shown: Any, view: str | Callable[[Any], View]) -> str:
    """Return the page of an object as notebooks ask for it: HTML without scripts, all texts escaped.

    Parameters
    ----------
    shown : object
        The object.
    view : callable or str
        Function of it that returns a :class:`View`, or "module:function". Warnings of the package that are issued
        meanwhile are part of the page.
    """
    if isinstance(view, str):
        module, _, name = view.partition(":")
        view = getattr(importlib.import_module(module), name)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = view(shown)  # type: ignore[operator]
    issued = [str(warning.message) for warning in caught if issubclass(warning.category, OdakWarning)]
    return to_html(found._replace(warnings=list(dict.fromkeys([*found.warnings, *issued]))))


def to_html(view: View) -> str:
    """Return a view as HTML.

    Parameters
    ----------
    view : View
        The view.
    """
    parts = [f"<p><b>{html.escape(view.title)}</b></p>"]
    parts += [f'<p role="note" style="{_BOX}">Warning: {html.escape(text)}</p>' for text in view.warnings]
    parts += [
        f'<figure style="display:inline-block;margin:4px;vertical-align:top"><img style="{enlarged(picture)}" '
        f'alt="{html.escape(caption)}" src="{source(picture)}"><figcaption>{html.escape(caption)}</figcaption></figure>'
        for caption, picture in view.pictures
    ]
    return f"<div>{''.join(parts)}{table(view.table, _CELL) if view.table else ''}</div>"


def table(rows: Sequence[Sequence[Any]], style: str = "") -> str:
    """Return rows as HTML, which scrolls where it is wider than the page.

    Parameters
    ----------
    rows : sequence of sequence
        Numbers and texts, the first row of which is the head.
    style : str
        Style of the cells on pages that have no style sheet.
    """
    style = f' style="{style}"' if style else ""
    lines = [
        "<tr>" + "".join(f"<{tag}{style}>{html.escape(_cell(value))}</{tag}>" for value in row) + "</tr>"
        for tag, row in zip(["th", *["td"] * len(rows)], rows, strict=False)
    ]
    return f'<div style="overflow-x:auto"><table style="border-collapse:collapse">{"".join(lines)}</table></div>'


def source(picture: bytes | str) -> str:
    """Return a picture as the source of an image in a page.

    Parameters
    ----------
    picture : bytes or str
        Bytes of a PNG file or the text of an SVG file.
    """
    # As an image: what an SVG file contains cannot reach the page, nor do its names clash with another picture's.
    kind = "image/svg+xml" if isinstance(picture, str) else "image/png"
    content = picture.encode() if isinstance(picture, str) else picture
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def enlarged(picture: bytes | str, shortest: int = SHORTEST) -> str:
    """Return the style of a picture in a page: samples of small ones are enlarged and stay sharp.

    Parameters
    ----------
    picture : bytes or str
        Bytes of a PNG file or the text of an SVG file.
    shortest : int
        Pixels of the page that the longer side of the picture takes at least.
    """
    if isinstance(picture, bytes):
        columns, rows = struct.unpack(">II", picture[16:24])  # of the header of a PNG file
        if (longer := max(columns, rows)) < shortest:
            return f"width:{round(shortest * columns / longer)}px;image-rendering:pixelated;max-width:100%"
    return "max-width:100%"


def fields_html(shown: Any, title: str, warnings: Sequence[str] = ()) -> str:
    """Return a named tuple or a dataclass as HTML: a row for each of its fields that is not None.

    Parameters
    ----------
    shown : object
        The object.
    title : str
        First line of the page.
    warnings : sequence of str
        What endangers a result.
    """
    names = getattr(shown, "_fields", None) or type(shown).__dataclass_fields__
    values = ((name.replace("_", " "), getattr(shown, name)) for name in names)
    rows = [(name, short(value)) for name, value in values if value is not None]
    return to_html(View(title, (), [("", "value"), *rows], warnings))


def _cell(value: Any) -> str:
    return value if isinstance(value, str) else short(value)


def png(values: Any) -> bytes:
    """Return a picture as a PNG file, reduced to at most 640 pixels a side.

    Parameters
    ----------
    values : array
        ``[rows, columns]`` or ``[rows, columns, 3]``, 0 … 1.
    """
    from PIL import Image

    image = Image.fromarray(np.round(255 * np.clip(np.nan_to_num(np.asarray(values)), 0, 1)).astype(np.uint8))
    image.thumbnail((SIDE, SIDE))
    stream = io.BytesIO()
    image.save(stream, "PNG")
    return stream.getvalue()


def one_line(described: Any, **more: Any) -> str:
    """Return an object in one line: its kind and its numbers, arrays of more than four by their shapes.

    Named tuples and dataclasses have their fields, other objects the arguments of their constructor that they hold, and
    what they hold besides if they are no modules of torch.

    Parameters
    ----------
    described : object
        The object.
    **more
        What is said besides.
    """
    return f"{type(described).__name__}({numbers_of(described, **more)})"


class Shown:
    """Base class of what shows itself in one line."""

    def __repr__(self) -> str:
        return one_line(self)


def shown(kind: Kind) -> Kind:
    """Let a named tuple, which has no other base, show itself in one line."""
    kind.__repr__ = one_line  # type: ignore[assignment]
    return kind


def numbers_of(described: Any, **more: Any) -> str:
    """Return what :func:`one_line` has between its brackets.

    Parameters
    ----------
    described : object
        The object.
    **more
        What is said besides.
    """
    kind, given = type(described), object()
    names: Iterable[Any] = getattr(kind, "_fields", None) or getattr(kind, "__dataclass_fields__", None) or ()
    if not names:
        names = [name for name in inspect.signature(kind.__init__).parameters if name != "self"]
        if not hasattr(described, "_modules"):
            names = dict.fromkeys([*names, *(name for name in vars(described) if not name.startswith("_"))])
    found = ((name, getattr(described, name, given)) for name in names)
    known = [*more.items(), *((name, value) for name, value in found if value is not given and value is not None)]
    parts = [f"{name}={short(value)}" for name, value in known]
    whole = ", ".join(parts)
    return whole if len(whole) <= LONGEST else whole[: LONGEST - 1] + "…"


def short(value: Any) -> str:
    """Return a value in a few characters without a break.

    Parameters
    ----------
    value : object
        The value.
    """
    if isinstance(value, (bool, np.bool_)):
        return str(value)
    if isinstance(value, (float, complex, np.floating)):
        return f"{value + 0.0:.6g}"  # a zero has no sign
    if is_array(value) and getattr(value, "shape", None) is not None:
        kind = str(value.dtype).rpartition(".")[2]
        if value.ndim > 1 or max(value.shape, default=1) > 4 or not is_readable(value):
            return f"{kind}{list(value.shape)}"
        value = value.tolist()
        return short(value)
    if isinstance(value, (list, tuple)) and not hasattr(value, "_fields"):
        if len(value) > 4:
            return f"{len(value)} items"
        open_, close = "[]" if isinstance(value, list) else "()"
        return open_ + ", ".join(map(short, value)) + ("," if len(value) == 1 and open_ == "(" else "") + close
    if isinstance(value, dict):
        return f"{len(value)} entries"
    if isinstance(value, str):
        return repr(value) if len(value) <= WORDS else repr(value[: WORDS - 1] + "…")
    own = type(value).__repr__ is not object.__repr__ and not callable(value)
    text = " ".join(repr(value).split()) if own else ""
    return text if 0 < len(text) <= WORDS else getattr(value, "__name__", type(value).__name__)
