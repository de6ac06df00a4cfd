"""Vectors as three arrays (x, y, z): arithmetic without strides, and NaN kept out of it where a graph follows.

With ``followed``, a value under a mask runs on a dummy, so that no gradient turns NaN. Without, NaN runs through the
arithmetic and marks the rays that are lost at no cost.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from odak._array import is_torch, namespace
from odak.raytracing.batches import is_followed
from odak.raytracing.geometry import finite_rays, safe_divide, safe_sqrt

Vector = tuple


class Lines(NamedTuple):
    """Rays in components: namespace, start, direction, which rays are finite, and whether a graph follows."""

    xp: Any
    start: Vector
    direction: Vector
    kept: Any
    followed: bool


def lines(start, direction, *surface) -> Lines:
    """Return rays in components, ready to meet a surface."""
    followed, kept = is_followed(start, direction, *surface), True
    if followed:
        start, direction, kept = finite_rays(start, direction)
    return Lines(namespace(start, direction), split(start), split(direction), kept, followed)


def split(vector) -> Vector:
    """Return the components of ``[..., 3]``, each contiguous where the library lays out memory by strides."""
    if is_torch(vector):
        x, y, z = vector.unbind(-1)
        return x.contiguous(), y.contiguous(), z.contiguous()
    x, y, z = namespace(vector).unstack(vector, axis=-1)
    if isinstance(vector, np.ndarray) and x.ndim:
        return np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(z)
    return x, y, z


def join(*vectors: Vector):
    """Return one vector as ``[..., 3]``, several as ``[..., k, 3]``."""
    xp = namespace(*(c for vector in vectors for c in vector))
    parts = xp.broadcast_arrays(*(c for vector in vectors for c in vector))
    shape = tuple(parts[0].shape)
    if is_followed(*parts):
        out = xp.stack(parts, axis=-1)
    else:
        # Three strided copies are several times faster than a stack.
        out = xp.empty((*shape, len(parts)), dtype=parts[0].dtype, **_place(parts[0]))
        for i, part in enumerate(parts):
            out[..., i] = part
    return out if len(vectors) == 1 else xp.reshape(out, (*shape, len(vectors), 3))


def dot(a: Vector, b: Vector):
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def minus(a: Vector, b: Vector) -> Vector:
    """Return a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def along(a: Vector, t, b: Vector) -> Vector:
    """Return a + t·b."""
    return a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]


def scaled(a: Vector, factor) -> Vector:
    """Return factor·a."""
    return a[0] * factor, a[1] * factor, a[2] * factor


def without(vector: Vector, axis: Vector) -> Vector:
    """Return the part of a vector that is perpendicular to a unit axis."""
    return along(vector, -dot(vector, axis), axis)


def unit(vector: Vector, followed: bool) -> Vector:
    """Return vector/|vector|; NaN for no length, unless a graph follows: then the vector itself."""
    squared = dot(vector, vector)
    if followed:
        squared = namespace(squared).where(squared > 0, squared, 1.0)
    length = squared**0.5
    return vector[0] / length, vector[1] / length, vector[2] / length


def divided(numerator, denominator, where, followed: bool):
    """Return numerator/denominator; 0 instead of NaN and infinity where a graph follows."""
    return safe_divide(numerator, denominator, where) if followed else numerator / denominator


def rooted(value, followed: bool):
    """Return the square root; 0 instead of NaN for negative values where a graph follows."""
    return safe_sqrt(value) if followed else value**0.5


def shown(value, where, followed: bool):
    """Return `value` to go on with: NaN where `where` does not hold, or 0 where a graph follows."""
    return namespace(value).where(where, value, 0.0 if followed else math.nan)


def hidden(value, where, followed: bool):
    """Return results made from :func:`shown` with NaN where `where` does not hold."""
    if not followed:
        return value
    if isinstance(value, tuple):
        return tuple(hidden(v, where, True) for v in value)
    return namespace(value).where(where, value, math.nan)


def _place(like) -> dict:
    return {"device": like.device} if is_torch(like) else {}
