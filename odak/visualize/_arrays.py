"""Conversion of lists, arrays and tensors of any library, device and precision to the NumPy arrays that are drawn."""

import numpy as np

from odak import _validate
from odak._array import is_torch
from odak.tools.matrix import convert_to_numpy


def to_numpy(name: str, value) -> np.ndarray:
    """Return numbers of any array library as a NumPy array on the CPU.

    Parameters
    ----------
    name : str
        What the caller calls it.
    value : array, torch.Tensor, number or sequence of them
        Tensors may be on any device and require a gradient.

    Returns
    -------
    numpy.ndarray
        Of the same precision; bfloat16 becomes float32, bool uint8.

    Raises
    ------
    TypeError
        If it does not hold numbers.
    """
    if is_torch(value):
        value = convert_to_numpy(value)
    elif isinstance(value, (list, tuple)):
        value = [to_numpy(f"{name}[{i}]", v) if hasattr(v, "shape") else v for i, v in enumerate(value)]
    elif hasattr(value, "get") and hasattr(value, "__cuda_array_interface__"):
        value = value.get()
    with _validate.refusing(f"{name} must be an array or a tensor of numbers: ", ValueError, raised=TypeError):
        found = np.asarray(value)
    if found.dtype.kind == "b":
        return found.astype(np.uint8)
    if found.dtype.kind not in "iufc":
        raise TypeError(f"{name} must be an array or a tensor of numbers, got {type(value).__name__}")
    return found


def real_array(name: str, value) -> np.ndarray:
    """Return real numbers as an array, raise TypeError for complex ones."""
    found = to_numpy(name, value)
    if found.dtype.kind == "c":
        raise TypeError(f"{name} must be real, got {found.dtype}; draw its amplitude or its phase")
    return found


def _floats(name, value, accepted) -> np.ndarray:
    """Return real numbers of an accepted shape in float32 or wider."""
    found = _validate.shaped(name, real_array(name, value), accepted)
    return found.astype(np.result_type(found, np.float32), copy=False)


def points(name: str, value) -> np.ndarray:
    """Return points ``[3]`` or ``[m, 3]`` as ``[m, 3]``."""
    return _floats(name, value, "[3] or [m, 3]").reshape(-1, 3)


def pairs(names: tuple[str, str], first, second) -> tuple[np.ndarray, np.ndarray]:
    """Return two sets of points ``[m, 3]``, one point standing for all where the other set has more."""
    a, b = points(names[0], first), points(names[1], second)
    if len(a) != len(b) and 1 not in (len(a), len(b)):
        raise ValueError(
            f"{names[0]} and {names[1]} must have equal lengths, or one of them length 1; got {len(a)} and {len(b)}"
        )
    a, b = np.broadcast_arrays(a, b)
    return a, b


def triangles(name: str, value) -> np.ndarray:
    """Return triangles ``[3, 3]`` or ``[m, 3, 3]`` as ``[m, 3, 3]``."""
    return _floats(name, value, "[3, 3] or [m, 3, 3]").reshape(-1, 3, 3)


def faces(name: str, value, count: int, of: str = "vertices") -> np.ndarray:
    """Return the corners of triangles, numbers ``[t, 3]`` of `count` points of an argument."""
    found = real_array(name, value)
    if found.ndim != 2 or found.shape[1] != 3 or found.dtype.kind not in "iu":
        raise ValueError(f"{name} must be integers [t, 3], got {found.dtype} {list(found.shape)}")
    if found.size and not 0 <= found.min() <= found.max() < count:
        raise ValueError(
            f"{name} must be indices of vertices, 0 to {count - 1} of {of}, got {found.min()} to {found.max()}"
        )
    return found


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """Return two triangles for each cell of a grid of vertices, row by row: int32 ``[2·(rows−1)·(columns−1), 3]``."""
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    near, right, up, far = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    cells = np.stack((np.stack((near, right, far), -1), np.stack((near, far, up), -1)), axis=2)
    return cells.reshape(-1, 3)


def heights(data_x, data_y, data_z, least: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x and y, ``[m, n]`` or of the columns ``[n]`` and the rows ``[m]``, and heights ``[m, n]``."""
    x, y, z = (real_array(f"data_{axis}", value) for axis, value in zip("xyz", (data_x, data_y, data_z), strict=True))
    if z.ndim != 2 or min(z.shape) < least:
        wanted = "not empty" if least == 1 else f"at least {least} by {least}"
        raise ValueError(f"data_z must be [m, n], {wanted}; got {list(z.shape)}")
    for name, value, n in (("data_x", x, z.shape[1]), ("data_y", y, z.shape[0])):
        _validate.shaped(name, value, f"{list(z.shape)} as data_z, or [{n}]")
    return x, y, z


def sphere(name: str, value, samples: int) -> list[np.ndarray]:
    """Return x, y and z ``[samples, samples]`` on a sphere ``[4]`` or ``[1, 4]``, its centre and radius."""
    found = real_array(name, value).reshape(-1)
    if found.shape != (4,):
        raise ValueError(f"{name} must be [4] or [1, 4]: centre and radius; got {list(np.shape(value))}")
    theta, phi = np.linspace(0, 2 * np.pi, samples), np.linspace(0, np.pi, samples)
    axes = (np.outer(np.cos(theta), np.sin(phi)), np.outer(np.sin(theta), np.sin(phi)))
    axes = (*axes, np.outer(np.ones_like(theta), np.cos(phi)))
    return [centre + found[3] * axis for centre, axis in zip(found, axes, strict=False)]


def reach(rays, distance) -> tuple[np.ndarray, np.ndarray]:
    """Return where rays ``[2, 3]`` or ``[m, 2, 3]`` start and where they are after a distance, each ``[m, 3]``.

    Rays with a number that is not finite are left out.
    """
    found = _floats("rays", rays, "[2, 3] or [m, 2, 3]").reshape(-1, 2, 3)
    lengths = real_array("distance", distance).reshape(-1, 1).astype(found.dtype, copy=False)
    if len(lengths) == 1 and not np.isfinite(lengths).all():
        raise ValueError(f"distance must be finite, got {distance!r:.80}")
    if len(lengths) not in (1, len(found)):
        raise ValueError(f"distance must be one number or one for each of the {len(found)} rays, got {len(lengths)}")
    ends = found[:, 0] + lengths * found[:, 1]
    kept = np.isfinite(ends).all(-1) & np.isfinite(found[:, 0]).all(-1)
    return found[kept, 0], ends[kept]


def image(name: str, value) -> np.ndarray:
    """Return an array with two axes, axes of length one before or behind them dropped."""
    found = to_numpy(name, value)
    shape = list(found.shape)
    while found.ndim > 2 and 1 in (found.shape[0], found.shape[-1]):
        found = found[0] if found.shape[0] == 1 else found[..., 0]
    if found.ndim != 2 or 0 in found.shape:
        raise ValueError(f"{name} must be one image [rows, columns], not empty; got {shape}")
    return found


def linear_light(coded: np.ndarray) -> np.ndarray:
    """Return linear RGB of sRGB values from 0 to 1 (IEC 61966-2-1)."""
    return np.where(coded <= 0.04045, coded / 12.92, ((np.maximum(coded, 0.0) + 0.055) / 1.055) ** 2.4)


def coded_light(linear) -> list[float]:
    """Return the sRGB values of linear light, cut to 0 to 1."""
    linear = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    coded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return [float(value) for value in coded]
