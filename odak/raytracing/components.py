"""Arithmetic on vectors as tuples of three arrays (x, y, z), which need no strides.

Where derivatives are taken (`differentiable`), masked values are replaced by dummies before the arithmetic, so that no
gradient becomes NaN. Elsewhere NaN propagates through the arithmetic and marks lost rays.
"""

import math
from types import ModuleType
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from odak._array import Array, broadcast, is_array, is_torch, namespace
from odak.raytracing.batches import needs_gradient
from odak.raytracing.geometry import finite_rays, safe_divide, safe_sqrt

# Three components, arrays of the library of the arguments.
Vector: TypeAlias = tuple[Any, ...]
PI = math.pi


class Lines(NamedTuple):
    """Rays in components: namespace, start, direction, which rays are finite, and whether derivatives are taken."""

    xp: ModuleType
    start: Vector
    direction: Vector
    kept: Any
    differentiable: bool


def lines(start: Any, direction: Any, *surface: Any) -> Lines:
    """Return rays, ``[..., 3]`` or tuples of finite components, as components for an intersection with a surface."""
    if isinstance(start, tuple):
        differentiable = needs_gradient(*start, *direction, *surface)
        return Lines(namespace(*start, *direction), start, direction, True, differentiable)
    differentiable, kept = needs_gradient(start, direction, *surface), True
    if differentiable:
        start, direction, kept = finite_rays(start, direction)
    return Lines(namespace(start, direction), split(start), split(direction), kept, differentiable)


def split(vector: Any) -> Vector:
    """Return the components of ``[..., 3]``, each contiguous where the library lays out memory by strides."""
    if is_torch(vector):
        x, y, z = vector.unbind(-1)
        return x.contiguous(), y.contiguous(), z.contiguous()
    x, y, z = namespace(vector).unstack(vector, axis=-1)
    if isinstance(vector, np.ndarray) and x.ndim:
        return np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(z)
    return x, y, z


def join(*vectors: Vector) -> Any:
    """Return one vector as ``[..., 3]``, several as ``[..., k, 3]``."""
    parts = broadcast(*(c for vector in vectors for c in vector))
    xp = namespace(*parts)
    shape = tuple(parts[0].shape)
    if needs_gradient(*parts):
        out = xp.stack(parts, axis=-1)
    else:
        # Three strided copies are several times faster than a stack.
        out = xp.empty((*shape, len(parts)), dtype=parts[0].dtype, **_place(parts[0]))
        for i, part in enumerate(parts):
            out[..., i] = part
    return out if len(vectors) == 1 else xp.reshape(out, (*shape, len(vectors), 3))


def dot(a: Vector, b: Vector) -> Any:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def minus(a: Vector, b: Vector) -> Vector:
    """Return a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def along(a: Vector, t: Array | float, b: Vector) -> Vector:
    """Return a + t·b."""
    return a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]


def scaled(a: Vector, factor: Any) -> Vector:
    """Return factor·a."""
    return a[0] * factor, a[1] * factor, a[2] * factor


def without(vector: Vector, axis: Vector) -> Vector:
    """Return the part of a vector that is perpendicular to a unit axis."""
    return along(vector, -dot(vector, axis), axis)


def terms(coefficients: Any) -> tuple[Any, ...]:
    """Return the numbers or arrays along the last axis of coefficients, or of a sequence of them."""
    if is_array(coefficients):
        return tuple(namespace(coefficients).unstack(coefficients, axis=-1))
    return tuple(coefficients)


def unit(vector: Vector, differentiable: bool) -> Vector:
    """Return vector/|vector|; NaN for length 0, or the vector itself where derivatives are taken."""
    squared = dot(vector, vector)
    if differentiable:
        squared = namespace(squared).where(squared > 0, squared, 1.0)
    length = squared**0.5
    return vector[0] / length, vector[1] / length, vector[2] / length


def quotient(numerator: Any, denominator: Any, where: Any, differentiable: bool) -> Any:
    """Return numerator/denominator; 0 instead of NaN and infinity where derivatives are taken."""
    return safe_divide(numerator, denominator, where) if differentiable else numerator / denominator


def square_root(value: Any, differentiable: bool) -> Any:
    """Return the square root; 0 instead of NaN for negative values where derivatives are taken."""
    return safe_sqrt(value) if differentiable else value**0.5


def placeholder(value: Array, where: Array, differentiable: bool) -> Array:
    """Return `value`, and where `where` does not hold NaN, or 0 where derivatives are taken."""
    return namespace(value).where(where, value, 0.0 if differentiable else math.nan)


def nan_outside(value: Any, where: Any, differentiable: bool) -> Any:
    """Return results made from :func:`placeholder` with NaN where `where` does not hold."""
    if not differentiable:
        return value
    if isinstance(value, tuple):
        return tuple(nan_outside(v, where, True) for v in value)
    return namespace(value).where(where, value, math.nan)


def _place(like) -> dict[Any, Any]:
    return {"device": like.device} if is_torch(like) else {}
