"""Rays, points and surfaces as the public doors accept them, turned into plain float arrays."""

import numpy as np


def floats(name: str, value) -> np.ndarray:
    """Return `value` as float64, or float32 when it is; raise TypeError for anything but real numbers."""
    value = np.asarray(value)
    if value.dtype.kind not in "iuf":
        raise TypeError(f"{name} must be real numbers, got {value.dtype}")
    return value if value.dtype == np.float32 else value.astype(np.float64)


def points(name: str, value) -> np.ndarray:
    """Return points ``[..., 3]``."""
    return _shaped(name, floats(name, value), (3,), "[3] or [m, 3]")


def rays(name: str, value) -> np.ndarray:
    """Return rays ``[..., 2, 3]``."""
    return _shaped(name, floats(name, value), (2, 3), "[2, 3] or [m, 2, 3]")


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
