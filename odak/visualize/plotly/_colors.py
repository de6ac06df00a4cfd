"""Colours of single points, lines and triangles: by name, or as values in a colour scale."""

import numpy as np

from odak.visualize._arrays import real_array


def colors(color, count: int, settings: dict, repeat: int = 1) -> dict:
    """Return what a marker or a line takes: one colour, or one for each of `count`.

    Parameters
    ----------
    color : str or sequence
        A colour, `count` colours, or `count` values.
    count : int
        How many things are drawn.
    settings : dict
        Holds the colour scale of values.
    repeat : int
        How many points make one of them; behind the last there is no gap.
    """
    if isinstance(color, str):
        return {"color": color}
    if isinstance(color, (list, tuple)) and all(isinstance(item, str) for item in color):
        found, scale = np.asarray(color), {}
    else:
        found, scale = real_array("color", color).reshape(-1), {"colorscale": settings["color scale"]}
    if len(found) != count:
        raise ValueError(f"color must be one colour or {count} of them or of values, got {len(found)}")
    found = np.repeat(found, repeat)[: None if repeat == 1 else -1]
    return {"color": found if scale else found.tolist(), **scale}


def face_colors(color, count: int, settings: dict) -> dict:
    """Return what a mesh takes for colours or values of its `count` triangles."""
    style = colors(color, count, settings)
    if isinstance(color, str):
        return style
    if "colorscale" in style:
        return {"intensity": style["color"], "intensitymode": "cell", "colorscale": style["colorscale"]}
    return {"facecolor": style["color"]}
