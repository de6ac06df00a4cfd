"""Lens systems in one line: the glass, the rays of each field, the image plane, in space."""

import math
import os
from typing import Any, NamedTuple

import numpy as np

from odak import _validate
from odak.raytracing.sag import even_asphere_sag
from odak.tools.transformation import rotate_points
from odak.visualize._arrays import to_numpy
from odak.visualize.plotly import _checks
from odak.visualize.plotly.rays import rayshow

__all__ = ["system_show"]

RADII, ANGLES = 12, 72
GLASS, MIRROR, SCREEN = "rgb(140, 195, 240)", "rgb(150, 150, 160)", "rgb(90, 90, 90)"


class _Sheet(NamedTuple):
    """A surface as points ``[RADII + 1, ANGLES, 3]``, from the vertex to the rim."""

    points: np.ndarray

    @property
    def rim(self) -> np.ndarray:
        return self.points[-1]


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
    """Show a lens system in space with the rays of its fields, to one scale, in one line.

    Parameters
    ----------
    system : odak.learn.raytracing.system.optical_system
        The system.
    rings : int
        Rays of each field: rings in the pupil, or as `pattern` has it.
    pattern, aim : str
        As in :func:`odak.learn.raytracing.system.launch`. Rays are those of the reference wavelength.
    title : str, optional
        Title; the system's name by default.
    filename : str or os.PathLike, optional
        Save the picture: a ``.html`` page, Markdown, or an image.
    show : bool, optional
        Whether to show it; by default if it is not saved.

    Returns
    -------
    rayshow
        The picture: z runs to the right, y up. One trace holds all rays of a field; a ray that is lost ends where it
        was last. Shifts and tilts are drawn.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system
    >>> from odak.visualize.plotly import system_show
    >>> picture = system_show(load_system("cooke_triplet"), show=False)
    >>> [trace.name for trace in picture.fig.data if trace.showlegend]
    ['field 0°', 'field 14°', 'field 20°']
    """
    from odak.learn.raytracing.system import launch, optical_system
    from odak.learn.raytracing.system.drawing import COLOURS
    from odak.learn.raytracing.system.pupils import PATTERNS

    if not isinstance(system, optical_system):
        raise TypeError(f"system must be an odak.learn.raytracing.system.optical_system, got {type(system).__name__}")
    import torch

    if isinstance(pattern, str):
        pattern = _validate.one_of("pattern", pattern, PATTERNS)
    _validate.integer("rings", rings, minimum=1)
    title, show = _checks.text("title", title), None if show is None else _validate.flag("show", show)
    name = system.name or "Optical system"
    picture = rayshow(
        subplot_titles=[name if title is None else title],
        line_width=2.0,
        opacity=0.8,
        shape=(1100, 600),
        labels=[f"{axis} ({system.unit.replace('um', 'µm')})" for axis in "xyz"],
    )
    picture.settings["aspect ratio"] = "data"
    picture.settings["margin"] = [10, 10, 30, 50]
    picture.fig.update_layout(legend={"x": 0.99, "xanchor": "right", "y": 0.99})
    with torch.no_grad():
        vertices = [0.0, *np.cumsum([to_numpy("thickness", item.thickness) for item in system.surfaces])]
        paths = _paths(system, launch(system, pattern, rings, aim=aim), vertices)
    _draw_surfaces(picture, system, vertices, paths)
    for i, (field, lines) in enumerate(zip(system.fields, paths, strict=True)):
        colour = "rgb({}, {}, {})".format(*COLOURS[i % len(COLOURS)])
        picture.add_path(lines, color=colour, show_legend=True, label=f"field {_field_name(field, system)}")
    _look_from_the_side(picture, paths)
    if filename is not None:
        picture.save(filename)
    if show or (show is None and filename is None):
        picture.show()
    return picture


def _paths(system, rays, vertices) -> np.ndarray:
    """Return the ways of the rays, ``[fields, rays, stations, 3]``, from in front of the system to the image plane."""
    from odak.learn.raytracing.system import trace

    start = np.stack([to_numpy("rays", part)[0] for part in rays[:3]], axis=-1)
    along = np.stack([to_numpy("rays", part)[0] for part in rays[3:6]], axis=-1)
    ahead = 0.25 * max(map(abs, vertices)) or 1.0
    if system.at_infinity or system.object_distance > 4 * ahead:
        start = start + along * ((-ahead - start[..., 2:]) / along[..., 2:])
    stations = [start]
    for i in [*range(len(system.surfaces)), None]:
        traced = trace(system, rays, until=i)
        place = np.stack([to_numpy("rays", part)[system.reference] for part in traced[:3]], axis=-1)
        stations.append(place + np.array([0.0, 0.0, vertices[-1 if i is None else i]]))
    return np.stack(stations, axis=-2)


def _draw_surfaces(picture, system, vertices, paths) -> None:
    """Draw each piece of glass as one closed mesh, mirrors as sheets, and the image plane."""
    heights = _heights(system, paths)
    sheets = [_sheet(item, z, h) for item, z, h in zip(system.surfaces, vertices, heights, strict=False)]
    for i, item in enumerate(system.surfaces):
        if item.reflects:
            picture.add_mesh(*_mesh([sheets[i]]), color=MIRROR, opacity=0.6, label="mirror")
        elif item.material != "air" and i + 1 < len(sheets):
            picture.add_mesh(*_mesh(sheets[i : i + 2]), color=GLASS, opacity=0.35, label=f"element {i + 1}")
        if i == system.stop:
            ring = np.concatenate([sheets[i].rim, sheets[i].rim[:1]])[None]
            picture.add_path(ring, color="black", label="stop")
    reached = np.nanmax(np.abs(paths[..., -1, :2]), axis=(0, 1), initial=0.0)
    x, y = np.maximum(1.1 * reached, max(heights))
    corners = np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    corners = np.column_stack([corners, np.full(4, vertices[-1])])
    picture.add_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), color=SCREEN, opacity=0.25, label="image plane")


def _heights(system, paths) -> list[float]:
    """Return how far from the axis each surface is drawn: its semi-diameter, or what the rays need."""
    heights = []
    for i, item in enumerate(system.surfaces):
        shift = to_numpy("shift", item.shift)
        met = np.linalg.norm(paths[..., i + 1, :2] - shift, axis=-1)
        needed = 1.05 * float(np.nanmax(met, initial=0.0)) or 1.0
        heights.append(item.semi_diameter or needed)
    # The two faces of a lens share an edge.
    for i, item in enumerate(system.surfaces[:-1]):
        free = item.semi_diameter is None and system.surfaces[i + 1].semi_diameter is None
        if free and item.material != "air" and not item.reflects:
            heights[i] = heights[i + 1] = max(heights[i], heights[i + 1])
    return heights


def _sheet(item, vertex: float, height: float) -> _Sheet:
    """Return a surface in space, as far out as it exists."""
    names = ("curvature", "conic", "coefficients", "tilt", "shift")
    curvature, conic, coefficients, tilt, shift = (to_numpy(n, getattr(item, n)).astype(float) for n in names)
    limit = (1 + conic) * curvature**2
    if limit > 0:
        height = min(height, 0.999 / math.sqrt(limit))
    radius = np.linspace(0, height, RADII + 1)[:, None]
    angle = np.linspace(0, 2 * np.pi, ANGLES, endpoint=False)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    z = even_asphere_sag(x, y, curvature, conic, coefficients).height
    flat = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    turned = np.asarray(rotate_points(flat, [*tilt, 0.0], "XYZ")).reshape(*x.shape, 3)
    return _Sheet(turned + np.array([*shift, vertex]))


def _mesh(sheets: list[_Sheet]) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of a sheet, or of the body between two, closed at the rims."""
    rings = sheets[0].points if len(sheets) == 1 else np.concatenate([sheets[0].points, sheets[1].points[::-1]])
    number = np.arange(len(rings) * ANGLES).reshape(len(rings), ANGLES)
    here, beside = number, np.roll(number, -1, axis=1)
    first = np.stack([here[:-1], here[1:], beside[1:]], axis=-1).reshape(-1, 3)
    second = np.stack([here[:-1], beside[1:], beside[:-1]], axis=-1).reshape(-1, 3)
    return rings.reshape(-1, 3), np.concatenate([first, second])


def _look_from_the_side(picture, paths) -> None:
    """Stand beside the axis, so that z runs to the right and y up, near enough for the system to fill the scene."""
    spans = np.nanmax(paths, axis=(0, 1, 2)) - np.nanmin(paths, axis=(0, 1, 2))
    wide = spans[2] / max(float(np.prod(spans)) ** (1 / 3), 1e-12) if np.all(spans > 0) else 1.0
    reach = 0.6 + 0.5 * wide
    picture.set_camera(x=-reach, y=0.35 * reach, z=-0.3 * reach, up="y")


def _field_name(field, system) -> str:
    unit = "°" if system.at_infinity else f" {system.unit}"
    values = field if field[0] else field[1:]
    return ", ".join(f"{value:g}{unit}" for value in values)
