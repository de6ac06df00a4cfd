"""Checks of the shapes of rays, points and solids, for every array library; batches get an axis in front."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._array import Array, is_traced, namespace


def shaped(name: str, value: Any, last: tuple[int, ...], accepted: str) -> Any:
    """Return `value` with a batch axis in front of its last axes, after checking these."""
    if tuple(value.shape[max(value.ndim - len(last), 0) :]) != last:
        raise ValueError(f"{name} must be {accepted}, got {list(value.shape)}")
    return batch(value, len(last))


def listed(name: str, value: Any, last: tuple[int, ...], accepted: str) -> Any:
    """Return `value` with one batch axis in front of its last axes, after checking that it has no more."""
    return batch(_validate.shaped(name, value, accepted), len(last))


def vector(name: str, value: Any, count: int = 3) -> Any:
    """Return `count` numbers as ``[count]``."""
    if math.prod(value.shape) != count:
        raise ValueError(f"{name} must be {count} numbers, got {tuple(value.shape)}")
    return namespace(value).reshape(value, (count,))


def points(name: str, value: Any) -> Any:
    """Return points ``[m, 3]``."""
    return shaped(name, value, (3,), "[3] or [m, 3]")


def rays(name: str, value: Any) -> Any:
    """Return rays ``[m, 2, 3]``."""
    return shaped(name, value, (2, 3), "[2, 3] or [m, 2, 3]")


def triangles(name: str, value: Any) -> Any:
    """Return triangles ``[m, 3, 3]``."""
    return shaped(name, value, (3, 3), "[3, 3] or [m, 3, 3]")


def rays_and_triangles(**given: Any) -> tuple[Any, ...]:
    """Return rays ``[m, 2, 3]`` and triangles ``[m, 3, 3]`` or ``[1, 3, 3]``, the two arguments given by name."""
    (ray, triangle), (name, other) = _validate.reals(**given), given
    ray, triangle = rays(name, ray), triangles(other, triangle)
    one_or_each(other, triangle.shape[:-2], ray)
    return ray, triangle


def one_or_each(name: str, batch: tuple[int, ...], ray: Any) -> None:
    """Raise ValueError unless surfaces are one or as many as the rays ``[..., 2, 3]``, or there is one ray."""
    if tuple(batch) == (1,):
        return
    try:
        _validate.fitting(ray=tuple(ray.shape[:-2]), surface=tuple(batch))
    except ValueError:
        raise ValueError(
            f"{name} must be one or one for each of the rays {list(ray.shape[:-2])}, got {list(batch)}"
        ) from None


def flat_rays(name: str, value: Any) -> np.ndarray:
    """Return one ray ``[2, 3]`` or many ``[m, 2, 3]`` as ``[m, 2, 3]``, for functions that use NumPy only."""
    if is_traced(value):
        raise TypeError(
            f"{name} must be numbers or an array that NumPy can read, got a tensor with a gradient or on a GPU: "
            "use odak.learn.raytracing for such tensors"
        )
    return listed(name, np.asarray(*_validate.reals(**{name: value})), (2, 3), "[2, 3] or [m, 2, 3]")


def index(name: str, value: Array | Sequence[float] | float, like: Array) -> Array:
    """Return a refractive index as an array like the array `like`; a single index must be finite."""
    return _validate.reals(like=like, **{name: value if getattr(value, "ndim", 0) else _validate.real(name, value)})[1]


def radius(value: Array | float, like: Array) -> Array | None:
    """Return a radius as an array like the array `like`; it must be at least 0, which is not checked for tensors."""
    _, made = _validate.reals(like=like, radius=_validate.real("radius", value))
    if not is_traced(made) and bool(namespace(made).any(made < 0)):
        raise ValueError(f"radius must be at least 0, got {value!r:.80}")
    return made


def batch(value: Array, axes: int) -> Any:
    """Return `value` with one batch axis at least in front of its last `axes` axes."""
    return value if value.ndim > axes else value[None, ...]


def single(value: Any) -> Any:
    """Return a batch of one without its batch axis: one ray ``[1, 2, 3]`` is ``[2, 3]``."""
    return value[0, ...] if value.shape[0] == 1 else value


def as_rays(start: Any, direction: Any) -> Any:
    """Return rays ``[..., 2, 3]`` of starts and directions, broadcast against each other."""
    xp = namespace(start, direction)
    return xp.stack(xp.broadcast_arrays(start, direction), axis=-2)
