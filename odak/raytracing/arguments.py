"""Checks of rays, points and surfaces given to public functions, and their conversion to arrays of floats."""

import numpy as np

from odak import _array, _validate


def floats(name: str, value) -> np.ndarray:
    """Return `value` as float64, or float32 when it is; raise TypeError for anything but real numbers."""
    if _array.is_torch(value) and (value.requires_grad or not _array.is_readable(value)):
        raise TypeError(f"{name} is a tensor with a gradient or on a GPU: odak.learn.raytracing takes such")
    try:
        value = np.asarray(value)
    except ValueError as error:
        raise ValueError(f"{name} must be a regular array of numbers, got lists that differ in length") from error
    if value.dtype.kind not in "iuf":
        raise TypeError(f"{name} must be real numbers, got {value.dtype}")
    return value if value.dtype == np.float32 else value.astype(np.float64)


def points(name: str, value) -> np.ndarray:
    """Return points ``[..., 3]``."""
    return _shaped(name, floats(name, value), (3,), "[3] or [m, 3]")


def finite_points(name: str, value) -> np.ndarray:
    """Return points or angles ``[..., 3]``, each of them finite."""
    return _validate.real(name, points(name, value))


def index(name: str, value) -> np.ndarray:
    """Return a refractive index as floats; a single one must be finite."""
    value = floats(name, value)
    if not value.size:
        raise ValueError(f"{name} must hold at least one number, got {value.shape}")
    return value if value.ndim else _validate.real(name, value)


def rays(name: str, value) -> np.ndarray:
    """Return rays ``[..., 2, 3]``."""
    return _shaped(name, floats(name, value), (2, 3), "[2, 3] or [m, 2, 3]")


def flat_rays(name: str, value) -> np.ndarray:
    """Return one ray ``[2, 3]`` or many ``[m, 2, 3]`` as ``[m, 2, 3]``."""
    value = batch(rays(name, value), 2)
    if value.ndim > 3:
        raise ValueError(f"{name} must be [2, 3] or [m, 2, 3], got {value.shape}")
    return value


def triangles(name: str, value) -> np.ndarray:
    """Return triangles ``[..., 3, 3]``."""
    return _shaped(name, floats(name, value), (3, 3), "[3, 3] or [m, 3, 3]")


def numbers(name: str, value, count: int) -> np.ndarray:
    """Return an array whose last axis holds `count` numbers."""
    return _shaped(name, floats(name, value), (count,), f"[{count}] or [m, {count}]")


def batch(value: np.ndarray, axes: int) -> np.ndarray:
    """Return `value` with one batch axis at least in front of its last `axes` axes."""
    return value if value.ndim > axes else value[None]


def single(value: np.ndarray) -> np.ndarray:
    """Return a batch of one without its batch axis: one ray ``[1, 2, 3]`` is ``[2, 3]``."""
    return value[0] if value.shape[0] == 1 else value


def as_rays(start: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return rays ``[..., 2, 3]`` of starts and directions, broadcast against each other."""
    return np.stack(np.broadcast_arrays(start, direction), axis=-2)


def _shaped(name: str, value: np.ndarray, shape: tuple[int, ...], accepted: str) -> np.ndarray:
    if value.shape[-len(shape) :] != shape:
        raise ValueError(f"{name} must be {accepted}, got {value.shape}")
    return value
