"""Pictures with sliders: a drawing made ahead for each of some values, on a page that needs nothing else.

Touches a drawing by calling it alone.
"""

import html
import io
import itertools
import json
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from odak import _array, _show, _validate
from odak._bars import tqdm
from odak.tools.paths import validate_path, write_file

# Most pictures of one page, each of which is some tens of kilobytes.
MOST_FRAMES = 300
# Pixels of a page that a picture takes at least.
NARROWEST = 320
_SCRIPT = """
(root => {
  const frames = JSON.parse(root.querySelector('script[type="application/json"]').textContent);
  const sliders = [...root.querySelectorAll('input')], picture = root.querySelector('img');
  const turn = () => {
    let place = 0;
    for (const slider of sliders) {
      place = place * (Number(slider.max) + 1) + Number(slider.value);
      slider.nextElementSibling.textContent = JSON.parse(slider.dataset.labels)[slider.value];
    }
    picture.src = 'data:image/png;base64,' + frames[place];
  };
  for (const slider of sliders) slider.addEventListener('input', turn);
  turn();
})(document.currentScript.parentElement)
"""


class Exploration:
    """A picture with a slider for each of some parameters, as :func:`explore` makes it.

    It shows itself in a notebook, where the notebook is trusted, and in what a notebook is exported to.

    Parameters
    ----------
    values : dict
        Values of the parameters by their names.
    frames : list of bytes
        Pictures as PNG files, in the order of the products of the values, the last parameter fastest.

    Raises
    ------
    ValueError
        If there is not one picture for each place of the sliders.

    Examples
    --------
    >>> import torch
    >>> from odak.visualize import explore
    >>> views = explore(lambda grey: torch.full((4, 6), grey), grey=[0.2, 0.8])
    >>> views.values
    {'grey': (0.2, 0.8)}
    """

    def __init__(self, values: dict[str, tuple[Any, ...]], frames: list[bytes]):
        if not isinstance(values, dict):
            raise TypeError(f"values must be a dictionary of tuples, got {type(values).__name__}")
        if not (isinstance(frames, list) and all(isinstance(frame, bytes) for frame in frames)):
            raise TypeError(f"frames must be a list of bytes, got {type(frames).__name__}")
        if len(frames) != (count := math.prod(len(each) for each in values.values())):
            raise ValueError(f"frames must be {count} pictures, one for each place of the sliders, got {len(frames)}")
        self.values: dict[str, tuple[Any, ...]] = values
        self.frames: list[bytes] = frames

    def __repr__(self) -> str:
        counts = ", ".join(f"{name} of {len(given)}" for name, given in self.values.items())
        return f"Exploration({len(self.frames)} pictures: {counts})"

    def _repr_html_(self) -> str:
        rows = []
        for name, given in self.values.items():
            labels = html.escape(json.dumps([_label(value) for value in given]))
            rows.append(
                f'<label style="display:block"><span style="display:inline-block;min-width:8em">'
                f'{html.escape(name.replace("_", " "))}</span><input type="range" min="0" max="{len(given) - 1}" '
                f'value="{len(given) // 2}" data-labels="{labels}" style="vertical-align:middle"> '
                f"<output></output></label>"
            )
        pictures = json.dumps([_show.source(frame).partition(",")[2] for frame in self.frames])
        style = _show.enlarged(self.frames[0], NARROWEST)
        return (
            f'<div>{"".join(rows)}<img style="{style}" alt="drawing of the values above">'
            f'<script type="application/json">{pictures}</script><script>{_SCRIPT}</script></div>'
        )

    def save(self, filename: str | Path) -> Path:
        """Write a page with the sliders, which needs no network and nothing installed.

        Parameters
        ----------
        filename : str or Path
            File to write, whole or not at all.

        Returns
        -------
        Path
            The file.
        """
        page = f'<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>odak</title>{self._repr_html_()}</html>\n'
        path = Path(validate_path(filename, [".html"], name="filename"))
        write_file(path, page.encode())
        return path


def explore(draw: Callable[..., Any], **values: Iterable[Any]) -> Exploration:
    """Draw a picture for all of some values, and show it with a slider for each parameter.

    Use it to look through planes, pupils, foci, gazes or fields. Nothing has to be installed, and no kernel has to run
    when the sliders move: the pictures are made ahead.

    Parameters
    ----------
    draw : callable
        ``draw(name=value, ...)`` returns a figure or axes of matplotlib, or a picture, ``[rows, columns]``,
        ``[rows, columns, 3]`` or ``[3, rows, columns]``, of 0 … 1; as an array or a tensor on any device.
    **values : iterable
        Values of each parameter in the order of its slider: numbers, texts, or anything that has a short text.

    Returns
    -------
    Exploration
        It shows itself in a notebook; :meth:`Exploration.save` writes a page.

    Raises
    ------
    ValueError
        If a parameter has no values, or there are more than 300 pictures.
    TypeError
        If what is drawn is no figure and no picture.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Modulator
    >>> from odak.visualize import explore
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, [1e-3, 2e-3, 3e-3])
    >>> images = display(torch.rand(32, 48, generator=torch.Generator().manual_seed(0)))
    >>> explore(lambda plane: images[plane, 0] / images.max(), plane=range(3))
    Exploration(3 pictures: plane of 3)
    """
    _validate.function("draw", draw)
    given = {name: tuple(each) for name, each in values.items()}
    for name, each in given.items():
        if not each:
            raise ValueError(f"{name} must have at least one value, got none")
    count = math.prod(len(each) for each in given.values())
    if count > MOST_FRAMES:
        counts = " · ".join(f"{len(each)} of {name}" for name, each in given.items())
        raise ValueError(f"values must make at most {MOST_FRAMES} pictures, got {counts} = {count}")
    places = tqdm(itertools.product(*given.values()), desc="pictures", total=count, delay=1)
    return Exploration(given, [_picture(draw(**dict(zip(given, place, strict=True)))) for place in places])


def _label(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _picture(drawn: Any) -> bytes:
    """Return what was drawn as a PNG file."""
    figure = getattr(drawn, "figure", drawn)
    if hasattr(figure, "savefig"):
        stream = io.BytesIO()
        figure.savefig(stream, format="png")
        _closed(figure)
        return stream.getvalue()
    if not _array.is_array(drawn):
        raise TypeError(f"draw must return a figure, axes or a picture, got {type(drawn).__name__}")
    values = _array.on_host(drawn)
    if values.ndim == 3 and values.shape[0] in (1, 3) and values.shape[-1] != 3:
        values = np.moveaxis(values, 0, -1)
    values = values[..., 0] if values.ndim == 3 and values.shape[-1] == 1 else values
    if values.ndim not in (2, 3) or (values.ndim == 3 and values.shape[-1] != 3):
        accepted = "[rows, columns], [rows, columns, 3] or [3, rows, columns]"
        raise ValueError(f"draw must return a picture {accepted}, got {list(drawn.shape)}")
    return _show.png(values)


def _closed(figure: Any) -> None:
    """Let pyplot forget a figure that it made, so that it is neither shown again nor kept."""
    if (manager := getattr(figure, "number", None)) is not None:
        from matplotlib import pyplot

        pyplot.close(manager)
