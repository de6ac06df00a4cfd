"""Placement of flat objects: checks of their sizes, grids over them, and hits ahead of rays."""

from collections.abc import Sequence

import numpy as np

from odak import _validate
from odak.raytracing import arguments
from odak.raytracing.primitives import bring_plane_to_origin
from odak.tools.transformation import apply_matrix, rotation_matrix

NO_SHIFT = (0.0, 0.0, 0.0)


def grid_over(count: Sequence[int], shape: Sequence[float], center, angles) -> np.ndarray:
    """Return ``[count0, count1, 3]`` points over a rectangle, its rim included."""
    x, y = (np.linspace(-size / 2, size / 2, n) for size, n in zip(shape, count, strict=True))
    flat = np.stack((*np.meshgrid(x, y, indexing="ij"), np.zeros(tuple(count))), axis=-1)
    return place(flat, center, angles)


def place(points: np.ndarray, location, angles) -> np.ndarray:
    """Return points of an object's own frame in space: R·p + location."""
    return apply_matrix(rotation_matrix(np.asarray(angles, dtype=np.float64)), points) + np.asarray(location)


def within_frame(points: np.ndarray, location, angles) -> np.ndarray:
    """Return points ``[m, 3]`` in an object's own frame."""
    moved = bring_plane_to_origin(points, None, center=location, angles=angles)
    return arguments.batch(moved, 1)


def is_ahead(rays: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Say which points, on the lines of rays ``[m, 2, 3]``, lie ahead of the start; not NaN, not the start itself."""
    return np.sum((points - rays[..., 0, :]) * rays[..., 1, :], axis=-1) > 0


def check_figure(figure) -> None:
    """Raise TypeError unless surfaces can be added to a figure."""
    if not callable(getattr(figure, "add_surface", None)):
        raise TypeError(f"figure must have a method add_surface, got {type(figure).__name__}")


def two_positive(name: str, value: Sequence[float]) -> list:
    """Return a pair of positive numbers as a list."""
    return list(_validate.several(name, value, 2, positive=True))


def three(name: str, value: Sequence[float]) -> list[float]:
    """Return three finite numbers as a list."""
    return [float(number) for number in _validate.several(name, value, 3)]
