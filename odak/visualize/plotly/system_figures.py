"""Figures of lens systems in space: glass, rays of each field, and image plane."""

import os
from typing import Any

import numpy as np

from odak import _validate
from odak.visualize._arrays import to_numpy
from odak.visualize.plotly import figure_style, figures
from odak.visualize.plotly.ray_figures import rayshow

__all__ = ["system_show"]

RADII, ANGLES = 12, 72
# Direction to the camera: beside the axis, slightly above and in front.
VIEW = (-1.0, 0.3, -0.25)
GLASS, MIRROR, SCREEN = "rgb(140, 195, 240)", "rgb(150, 150, 160)", "rgb(90, 90, 90)"


def system_show(
    system: Any,
    *,
    rings: int = 3,
    pattern: str = "rings",
    aim: str = "paraxial",
    title: str | None = None,
    filename: str | os.PathLike | None = None,
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

    if not isinstance(system, optical_system):
        raise TypeError(f"system must be an odak.learn.raytracing.system.optical_system, got {type(system).__name__}")
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
        labels=[f"{axis} ({system.unit.replace('um', 'µm')})" for axis in "xyz"],
    )
    figure.settings["aspect ratio"] = "data"
    figure.settings["margin"] = [10, 10, 30, 50]
    figure.fig.update_layout(legend={"x": 0.99, "xanchor": "right", "y": 0.99})
    with torch.no_grad():
        paths = _paths(system, launch(system, pattern, rings, aim=aim))
        frames = list(zip(*(to_numpy("frames", value) for value in system.frames()), strict=True))
    _draw_surfaces(figure, system, frames, paths)
    for i, (field, lines) in enumerate(zip(system.fields, paths, strict=True)):
        colour = figure_style.COLORS[i % len(figure_style.COLORS)]
        figure.add_path(lines, color=colour, show_legend=True, label=f"field {_field_name(field, system)}")
    _frame_from_the_side(figure)
    if filename is not None:
        figure.save(filename)
    if show or (show is None and filename is None):
        figure.show()
    return figure


def _paths(system, rays) -> np.ndarray:
    """Return the paths of rays, ``[fields, rays, stations, 3]``, from in front of the system to the image plane."""
    from odak.learn.raytracing.system import ray_paths

    paths = to_numpy("rays", ray_paths(system, rays))[system.reference].copy()
    along = np.stack([to_numpy("rays", part)[0] for part in rays[3:6]], axis=-1)
    ahead = 0.25 * np.ptp(to_numpy("frames", system.frames()[1]), axis=0).max() or 1.0
    if system.at_infinity or system.object_distance > 4 * ahead:
        start = paths[..., 0, :]
        paths[..., 0, :] = start + along * ((-ahead - start[..., 2:]) / along[..., 2:])
    return paths


def _draw_surfaces(figure, system, frames, paths) -> None:
    """Draw each piece of glass as one closed mesh, mirrors as sheets, and the image plane."""
    from odak.learn.raytracing.system.surfaces import drawn_radii, is_break

    reaches = [
        np.nanmax(np.linalg.norm(((paths[..., i + 1, :] - origin) @ matrix)[..., :2], axis=-1), initial=0.0)
        for i, (matrix, origin) in enumerate(frames[:-1])
    ]
    radii = drawn_radii(system.surfaces, reaches)
    sheets = [_points_of(*drawn) for drawn in zip(system.surfaces, frames[:-1], radii, strict=True)]
    for i, item in enumerate(system.surfaces):
        if is_break(item):
            continue
        if item.reflects:
            figure.add_mesh(*_mesh(sheets[i]), color=MIRROR, opacity=0.6, label="mirror")
        elif item.material != "air" and i + 1 < len(sheets):
            behind = next((j for j in range(i + 1, len(sheets)) if not is_break(system.surfaces[j])), i)
            figure.add_mesh(*_mesh(sheets[i], sheets[behind]), color=GLASS, opacity=0.35, label=f"element {i + 1}")
        if i == system.stop:
            rim = sheets[i][-1]
            ring = np.concatenate([rim, rim[:1]])[None]
            figure.add_path(ring, color="black", label="stop")
    matrix, origin = frames[-1]
    local = (paths[..., -1, :] - origin) @ matrix
    reached = np.nanmax(np.abs(local[..., :2]), axis=(0, 1), initial=0.0)
    x, y = np.maximum(1.1 * reached, max(radii))
    corners = np.array([(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)]) @ matrix.T + origin
    figure.add_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), color=SCREEN, opacity=0.25, label="image plane")


def _points_of(item, frame, rim: float) -> np.ndarray:
    """Return points on a surface in space ``[RADII + 1, ANGLES, 3]``, from the vertex to the rim, where it exists."""
    radius = np.linspace(0, rim, RADII + 1)[:, None]
    angle = np.linspace(0, 2 * np.pi, ANGLES, endpoint=False)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    parameters = [to_numpy("shape", value) for value in item.shape.parameters()]
    sag = type(item.shape)(*parameters).sag(x, y)
    while not np.all(sag.defined) and rim > 0:
        x, y, rim = 0.98 * x, 0.98 * y, 0.98 * rim
        sag = type(item.shape)(*parameters).sag(x, y)
    matrix, origin = frame
    return np.stack([x, y, sag.height], axis=-1) @ matrix.T + origin


def _mesh(front: np.ndarray, back: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of the points of a surface, or of the body between two, closed at the rims."""
    rings = front if back is None else np.concatenate([front, back[::-1]])
    number = np.arange(len(rings) * ANGLES).reshape(len(rings), ANGLES)
    here, beside = number, np.roll(number, -1, axis=1)
    first = np.stack([here[:-1], here[1:], beside[1:]], axis=-1).reshape(-1, 3)
    second = np.stack([here[:-1], beside[1:], beside[:-1]], axis=-1).reshape(-1, 3)
    return rings.reshape(-1, 3), np.concatenate([first, second])


def _frame_from_the_side(figure) -> None:
    """Place the camera beside the axis, with z to the right and y up, so that everything drawn is in the frame."""
    drawn = [np.stack([np.asarray(trace[axis], float).ravel() for axis in "xyz"], axis=-1) for trace in figure.fig.data]
    points = np.concatenate(drawn)
    points = points[np.isfinite(points).all(-1)]
    width, height = figure.image_size()
    left, right, bottom, top = figure.settings["margin"]
    size = width - left - right, height - bottom - top
    camera, ranges = figure_style.camera_towards(points, VIEW, (0.0, 1.0, 0.0), size)
    axes: dict[str, dict] = {f"{a}axis": {"range": span} for a, span in zip("xyz", ranges, strict=True)}
    # Seen from the side the x axis is foreshortened: its numbers would overlap.
    axes["xaxis"] |= {"nticks": 3}
    axes["yaxis"] |= {"nticks": 5}
    figure.fig.update_scenes(camera=camera, **axes)


def _field_name(field, system) -> str:
    unit = "°" if system.at_infinity else f" {system.unit}"
    values = field if field[0] else field[1:]
    return ", ".join(f"{value:g}{unit}" for value in values)
