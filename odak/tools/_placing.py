"""Unit patterns of points, and their place in space in the library of the arrays given."""

import math

import numpy as np

from odak import _array, _validate
from odak.tools.transformation import apply_matrix, rotation_matrix


def on_sphere(i, j, no, k, radius, center):
    """Return the points of a sphere whose polar and azimuthal angles have the indices i and j."""
    spans = _validate.numbers(_validate.real("k", k))
    if len(spans) != 2:
        raise ValueError(f"k must be two numbers, got {k!r}")
    polar, azimuth = (span * math.pi * index.ravel() / n for span, index, n in zip(spans, (i, j), no, strict=True))
    ring = np.sin(polar)
    points = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), np.cos(polar)], axis=-1)
    return placed(points, radius, center, None, "radius")


def on_disc(distance, turn):
    """Return points of the unit disc in z = 0 from distances and shares of a full turn."""
    angle = 2 * math.pi * turn.ravel()
    distance = distance.ravel()
    return np.stack([distance * np.cos(angle), distance * np.sin(angle), np.zeros_like(angle)], axis=-1)


def all_of(*lines):
    """Return all combinations of the coordinates of several axes, the first axis outer."""
    return np.stack([line.ravel() for line in np.meshgrid(*lines, indexing="ij")], axis=-1)


def placed(points, scale, center, angles, name: str = "size"):
    """Return points scaled, turned about the origin and moved, in the library of the first array among the rest."""
    like = next((value for value in (scale, center, angles) if _array.is_array(value)), np.zeros(1))
    xp = _array.namespace(like)
    like = like if xp.isdtype(like.dtype, "real floating") else xp.astype(like, xp.float64)
    scale = _array.cast(_validate.real(name, scale), like)
    if math.prod(scale.shape) not in (1, points.shape[-1]):
        raise ValueError(f"{name} must be one number, got {math.prod(scale.shape)}")
    points = _array.cast(points, like) * scale
    if angles is not None:
        points = apply_matrix(rotation_matrix(numbers("angles", angles, 3, like)), points)
    return points + numbers("center", center, 3, like)


def numbers(name: str, value, count: int, like=None):
    """Return `count` numbers as an array, of the library of `like` if given, else of their own."""
    _validate.real(name, value)
    if like is None:
        like = value if _array.is_array(value) else np.zeros(1)
        xp = _array.namespace(like)
        like = like if xp.isdtype(like.dtype, "real floating") else xp.astype(like, xp.float64)
    value = _array.namespace(like).reshape(_array.cast(value, like), (-1,))
    if value.shape[0] != count:
        raise ValueError(f"{name} must be {count} numbers, got {value.shape[0]}")
    return value
