"""Pooling regions that grow with eccentricity: maps of their size, local means over them, losses of blurred pictures.

A flat screen stands upright in front of the eye, its centre on the axis. Width and distance share one unit. The gaze is
(x, y) from the top-left corner, 0 to 1 across the picture; it may lie beside it. Angles are in radians.

On a CPU local means are computed of planes laid out as ``[H, P, W]``: resampling along the rows then multiplies a small
matrix by a wide one, and resampling along the columns a tall matrix by a small one. Strips of rows are summed over the
levels of a MIP chain while they are in the cache.
"""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import torch
from torch import nn
from torch.nn import functional

from odak import _array, _torch_private, _validate
from odak._torch_private import is_plain_on_cpu, linear
from odak.learn._tensors import as_pictures, check_loss_inputs, check_values, checked_device, checked_dtype
from odak.learn.perception.sight import (
    Gaze,
    Kept,
    Seen,
    Viewing,
    checked_view,
    each_of,
    gaze_at,
    gaze_of,
    geometry,
    parts_of,
    places_of,
    point,
    viewing_of,
)

MODES = ("quadratic", "linear")
# Largest angle of a cone, for cones that are tangent to the screen or point behind it.
STEEPEST = math.pi / 2 - 1e-3
# Columns of a block, values of one plane in a strip and of all planes for one thread: small enough for a cache, large
# enough that calls cost little.
COLUMNS, STRIP, CHUNK = 16, 1 << 12, 1 << 17


def make_3d_location_map(
    image_pixel_size: Sequence[int],
    real_image_width: float = 0.3,
    real_viewing_distance: float = 0.6,
    *,
    viewing: Viewing | None = None,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the position of each pixel relative to the eye.

    Parameters
    ----------
    image_pixel_size : sequence of int
        Rows and columns of the picture, whose pixels are square.
    real_image_width : float
        Width of the picture.
    real_viewing_distance : float
        Distance of the eye from the picture's centre, in the same unit.
    viewing : Viewing, optional
        Geometry, instead of the two lengths.
    dtype : torch.dtype
        Precision of the map.
    device : torch.device, optional
        Where the map is made.

    Returns
    -------
    torch.Tensor
        ``[3, H, W]``: x to the right, y downwards, z away from the eye. The outermost samples lie on the
        picture's edge.

    Raises
    ------
    ValueError, TypeError
        If a length is not positive, or the size not two positive integers.

    Examples
    --------
    >>> from odak.learn.perception import make_3d_location_map
    >>> [round(value, 6) for value in make_3d_location_map([3, 3], 0.2, 0.7)[:, 1, 2].tolist()]
    [0.1, 0.0, 0.7]
    """
    dtype, device = _options(dtype, device)
    rows, columns = _validate.size("image_pixel_size", image_pixel_size)
    width, distance = geometry(viewing, real_image_width, real_viewing_distance)
    height = width / columns * rows
    x = torch.linspace(-0.5, 0.5, columns, dtype=torch.float64, device=device) * width
    y = torch.linspace(-0.5, 0.5, rows, dtype=torch.float64, device=device) * height
    z = torch.ones((rows, columns), dtype=torch.float64, device=device) * distance
    return torch.stack([x.expand(rows, columns), y[:, None].expand(rows, columns), z]).to(dtype)


def make_eccentricity_distance_maps(
    gaze_location: Gaze | None,
    image_pixel_size: Sequence[int],
    real_image_width: float = 0.3,
    real_viewing_distance: float = 0.6,
    *,
    viewing: Viewing | None = None,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the angle of each pixel from the gaze, and its distance from the eye.

    Parameters
    ----------
    gaze_location : sequence of float
        (x, y), 0 to 1 from the top-left corner; or ``[B, 2]``, for each of which there is a map.
    image_pixel_size : sequence of int
        Rows and columns of the picture, whose pixels are square.
    real_image_width : float
        Width of the picture.
    real_viewing_distance : float
        Distance of the eye from the picture's centre, in the same unit.
    viewing : Viewing, optional
        Geometry and, where `gaze_location` is None, gaze, instead of the two lengths.
    dtype : torch.dtype
        Precision of the map.
    device : torch.device, optional
        Where the map is made.

    Returns
    -------
    tuple of torch.Tensor
        Eccentricity ``[H, W]`` in radians and distance ``[H, W]`` in the unit of the viewing distance.

    Notes
    -----
    The angle is atan2(|a × b|, a·b): good to rounding near the gaze, where an arc cosine keeps half the digits.

    Examples
    --------
    >>> from odak.learn.perception import make_eccentricity_distance_maps
    >>> angle, distance = make_eccentricity_distance_maps([0.5, 0.5], [3, 3], 0.2, 0.1)
    >>> round(float(angle[1, 0]), 4)  # 0.1 to the side at a distance of 0.1: 45 degrees
    0.7854
    """
    dtype, device = _options(dtype, device)
    width, distance = geometry(viewing, real_image_width, real_viewing_distance)
    place = make_3d_location_map(image_pixel_size, width, distance, dtype=torch.float64, device=device)
    rows, columns = place.shape[-2:]
    x, y = places_of("gaze_location", gaze_at(viewing, gaze_location), device)
    gaze = ((2 * x - 1) * width / 2, (2 * y - 1) * width / columns * rows / 2, distance)
    return _angle(place, gaze).to(dtype), _length(place).to(dtype)


def make_pooling_size_map_pixels(
    gaze_location: Gaze | None,
    image_pixel_size: Sequence[int],
    alpha: float = 0.3,
    real_image_width: float = 0.3,
    real_viewing_distance: float = 0.6,
    mode: str = "quadratic",
    *,
    viewing: Viewing | None = None,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the width in pixels of the pooling region around each pixel.

    Parameters
    ----------
    gaze_location : sequence of float
        (x, y), 0 to 1 from the top-left corner; or ``[B, 2]``, for each of which there is a map.
    image_pixel_size : sequence of int
        Rows and columns.
    alpha : float
        Pooling diameter over eccentricity ("linear") or over its square in radians ("quadratic").
    real_image_width : float
        Width of the picture.
    real_viewing_distance : float
        Distance of the eye from the picture's centre, in the same unit.
    mode : str
        "quadratic" or "linear".
    viewing : Viewing, optional
        Geometry and, where `gaze_location` is None, gaze, instead of the two lengths.
    dtype : torch.dtype
        Precision of the map.
    device : torch.device, optional
        Where the map is made.

    Returns
    -------
    torch.Tensor
        ``[H, W]``: side of the square whose area equals the area of the ellipse that the pooling cone cuts out of the
        screen; 0 at the gaze, never above the picture's diagonal.

    Raises
    ------
    ValueError, TypeError
        If the mode is unknown, `alpha` is negative, a length is not positive, or the gaze not two finite numbers.

    Notes
    -----
    Pooling diameters that grow with eccentricity: Freeman and Simoncelli, Nat. Neurosci. 14, 1195 (2011); the map:
    Walton et al., ACM Trans. Graph. 40, 48 (2021).

    Examples
    --------
    The pooling regions grow with the distance from the gaze:

    >>> from odak.learn.perception import make_pooling_size_map_pixels
    >>> width = make_pooling_size_map_pixels([0.5, 0.5], [65, 65])
    >>> bool(width[32, 32] < width[32, 48] < width[32, 64])
    True
    """
    dtype, device = _options(dtype, device)
    rows, columns = _validate.size("image_pixel_size", image_pixel_size)
    width, distance = geometry(viewing, real_image_width, real_viewing_distance)
    options: dict[str, Any] = {"dtype": torch.float64, "device": device}
    size = (rows, columns)
    gaze = gaze_at(viewing, gaze_location)
    angle, far = make_eccentricity_distance_maps(gaze, size, width, distance, **options)
    from_axis, _ = make_eccentricity_distance_maps((0.5, 0.5), size, width, distance, **options)
    half = _pooling_angle(angle, alpha, mode) / 2
    outer, inner = (from_axis + half).clamp(max=STEEPEST), (from_axis - half).clamp(min=-STEEPEST)
    major = (torch.tan(outer) - torch.tan(inner)) * distance
    minor = 2 * far * torch.tan(half.clamp(max=STEEPEST))
    side = torch.sqrt((math.pi / 4 * major * minor).abs()) / width * columns
    return side.clamp(max=math.hypot(rows, columns)).to(dtype)


def make_pooling_size_map_lod(
    gaze_location: Gaze | None,
    image_pixel_size: Sequence[int],
    alpha: float = 0.3,
    real_image_width: float = 0.3,
    real_viewing_distance: float = 0.6,
    mode: str = "quadratic",
    *,
    viewing: Viewing | None = None,
    nominal_width: bool = False,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the level of a MIP pyramid whose pixels are as wide as the pooling region: max(0, log₂ pixels).

    Parameters
    ----------
    gaze_location : sequence of float
        (x, y), 0 to 1 from the top-left corner; or ``[B, 2]``, for each of which there is a map.
    image_pixel_size : sequence of int
        Rows and columns of the picture, whose pixels are square.
    alpha : float
        Pooling diameter over eccentricity ("linear") or over its square in radians ("quadratic").
    real_image_width : float
        Width of the picture.
    real_viewing_distance : float
        Distance of the eye from the picture's centre, in the same unit.
    mode : str
        "quadratic" or "linear".
    viewing : Viewing, optional
        Geometry and, where `gaze_location` is None, gaze, instead of the two lengths.
    nominal_width : bool
        Choose levels whose sampling kernel, a square enlarged bilinearly, is as wide as the pooling region: equal
        standard deviations. False takes squares as wide as the region, whose kernel is 1.7 to 1.9 times as wide.
    dtype : torch.dtype
        Precision of the map.
    device : torch.device, optional
        Where the map is made.

    Returns
    -------
    torch.Tensor
        ``[H, W]``, 0 where single pixels are resolved.

    Examples
    --------
    >>> from odak.learn.perception import make_pooling_size_map_lod
    >>> level = make_pooling_size_map_lod([0.5, 0.5], [65, 65])
    >>> level[32, 32].item()
    0.0
    """
    dtype, device = _options(dtype, device)
    pixels = make_pooling_size_map_pixels(
        gaze_location,
        image_pixel_size,
        alpha,
        real_image_width,
        real_viewing_distance,
        mode,
        viewing=viewing,
        dtype=torch.float64,
        device=device,
    )
    return _level(pixels, nominal_width).to(dtype)


def make_radial_map(
    size: Sequence[int],
    gaze: Gaze,
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the distance of each pixel from the gaze, 1 at the farthest pixel.

    Parameters
    ----------
    size : sequence of int
        Rows and columns.
    gaze : sequence of float
        (x, y), 0 to 1 from the top-left corner.
    dtype : torch.dtype
        Precision of the map.
    device : torch.device, optional
        Where the map is made.

    Returns
    -------
    torch.Tensor
        ``[H, W]``, 0 … 1.

    Examples
    --------
    >>> from odak.learn.perception import make_radial_map
    >>> radius = make_radial_map([5, 5], [0.5, 0.5])
    >>> radius[0, 0].item(), radius[2, 2].item() < 0.2
    (1.0, True)
    """
    dtype, device = _options(dtype, device)
    rows, columns = _validate.size("size", size)
    x, y = places_of("gaze", gaze, device)
    across = torch.linspace(0, columns, columns, dtype=torch.float64, device=device) - x * columns
    down = torch.linspace(0, rows, rows, dtype=torch.float64, device=device)[:, None] - y * rows
    distance = torch.hypot(across, down)
    return (distance / distance.amax((-2, -1), True).clamp_min(torch.finfo(torch.float64).tiny)).to(dtype)


def make_equi_pooling_size_map_pixels(
    gaze_angles: Gaze,
    image_pixel_size: Sequence[int],
    alpha: float = 0.3,
    mode: str = "quadratic",
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the pooling width in pixels of an equirectangular picture of the whole sphere.

    Parameters
    ----------
    gaze_angles : sequence of float
        (yaw, pitch) in radians. Yaw runs from −π to π over the columns, pitch from −π/2 to π/2 down the rows.
    image_pixel_size : sequence of int
        Rows and columns.
    alpha : float
        Pooling angle over eccentricity ("linear") or over its square in radians ("quadratic").
    mode : str
        "quadratic" or "linear".
    dtype : torch.dtype
        Precision of the map.
    device : torch.device, optional
        Where the map is made.

    Returns
    -------
    torch.Tensor
        ``[H, W]``: geometric mean of the pooling angle counted in pixels of yaw and of pitch, times √π/2. Pixels are
        counted as on the equator; towards the poles, where they crowd, true sizes are larger.

    Raises
    ------
    ValueError, TypeError
        If the mode is unknown, `alpha` is negative, or the gaze not two finite numbers.

    Examples
    --------
    >>> from odak.learn.perception import make_equi_pooling_size_map_pixels
    >>> width = make_equi_pooling_size_map_pixels([0.0, 0.0], [33, 65])
    >>> bool(width[16, 32] < width[16, 48] < width[16, 60])
    True
    """
    dtype, device = _options(dtype, device)
    rows, columns = _validate.size("image_pixel_size", image_pixel_size)
    angles = places_of("gaze_angles", gaze_angles, device)
    yaw, pitch = (torch.as_tensor(angle, dtype=torch.float64, device=device) for angle in angles)
    yaws = torch.linspace(-math.pi, math.pi, columns, dtype=torch.float64, device=device)
    pitches = torch.linspace(-math.pi / 2, math.pi / 2, rows, dtype=torch.float64, device=device)[:, None]
    level = torch.cos(pitches)
    places = torch.stack([torch.sin(yaws) * level, torch.sin(pitches).expand(rows, columns), torch.cos(yaws) * level])
    gaze = (torch.sin(yaw) * torch.cos(pitch), torch.sin(pitch), torch.cos(yaw) * torch.cos(pitch))
    diameter = _pooling_angle(_angle(places, gaze), alpha, mode)
    pixels = diameter * math.sqrt(math.pi / 4 * columns / (2 * math.pi) * rows / math.pi)
    return pixels.clamp(max=math.hypot(rows, columns)).to(dtype)


def make_equi_pooling_size_map_lod(
    gaze_angles: Gaze,
    image_pixel_size: Sequence[int],
    alpha: float = 0.3,
    mode: str = "quadratic",
    *,
    nominal_width: bool = False,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the MIP level of an equirectangular picture whose pixels are as wide as the pooling region.

    Parameters
    ----------
    gaze_angles : sequence of float
        (yaw, pitch) in radians.
    image_pixel_size : sequence of int
        Rows and columns.
    alpha : float
        Pooling angle over eccentricity ("linear") or over its square in radians ("quadratic").
    mode : str
        "quadratic" or "linear".
    nominal_width : bool
        Choose levels whose sampling kernel, a square enlarged bilinearly, is as wide as the pooling region: equal
        standard deviations. False takes squares as wide as the region, whose kernel is 1.7 to 1.9 times as wide.
    dtype : torch.dtype
        Precision of the map.
    device : torch.device, optional
        Where the map is made.

    Returns
    -------
    torch.Tensor
        ``[H, W]``.

    Examples
    --------
    >>> from odak.learn.perception import make_equi_pooling_size_map_lod
    >>> level = make_equi_pooling_size_map_lod([0.0, 0.0], [33, 65])
    >>> level[16, 32].item()
    0.0
    """
    dtype, device = _options(dtype, device)
    pixels = make_equi_pooling_size_map_pixels(
        gaze_angles, image_pixel_size, alpha, mode, dtype=torch.float64, device=device
    )
    return _level(pixels, nominal_width).to(dtype)


def _growth(alpha: float, mode: str) -> tuple[float, str]:
    _validate.number("alpha", alpha, least=0)
    return alpha, _validate.one_of("mode", mode, MODES)


def _options(dtype, device):
    return checked_dtype("dtype", dtype), checked_device("device", device)


def _pooling_angle(eccentricity, alpha, mode):
    alpha, mode = _growth(alpha, mode)
    return alpha * (eccentricity if mode == "linear" else eccentricity**2)


def _angle(places, direction):
    """Return the angles between vectors ``[3, H, W]`` and one direction."""
    (x, y, z), (u, v, w) = places, direction
    across = _length((y * w - z * v, z * u - x * w, x * v - y * u))
    return torch.atan2(across, x * u + y * v + z * w)


def _length(vectors):
    # By components: a norm along the first axis has large strides in memory.
    x, y, z = vectors
    return (x * x + y * y).addcmul_(z, z).sqrt_()


def _level(pixels, nominal_width):
    if not _validate.flag("nominal_width", nominal_width):
        return torch.log2(1e-6 + pixels).clamp_min(0)
    # A square of n pixels has the variance (n² − 1)/12 along each axis. The kernel of level l ≥ 1, 2 × 2 means enlarged
    # bilinearly, has 4ˡ/4 on average over its positions, and level 0 none. Between levels variances mix linearly.
    variance = ((pixels**2 - 1) / 12).clamp_min(0)
    lower = torch.floor(torch.log2(4 * variance.clamp_min(1)) / 2)
    return torch.where(variance < 1, variance, lower + (4 * variance / 4**lower - 1) / 3)


class Block(NamedTuple):
    """The rows `rows` of a matrix, whose entries all lie in the columns `columns`."""

    rows: slice
    columns: slice
    entries: torch.Tensor


class Banded:
    """A matrix cut into blocks of rows, each dense where it has entries.

    A processor multiplies dense blocks many times faster than it follows the indices of a sparse matrix.

    Parameters
    ----------
    matrix : scipy.sparse.csr_matrix
        The matrix.
    step : int
        Rows of a block.
    dtype : torch.dtype
        Precision of the products.
    """

    def __init__(self, matrix: scipy.sparse.csr_matrix, step: int, dtype: torch.dtype) -> None:
        self.shape: tuple[int, int] = matrix.shape
        self.blocks: list[Block] = []
        for start in range(0, matrix.shape[0], step):
            rows = slice(start, min(start + step, matrix.shape[0]))
            part = matrix[rows].tocoo()
            columns = slice(int(part.col.min()), int(part.col.max()) + 1)
            entries = torch.from_numpy(matrix[rows, columns].toarray()).to(dtype)
            self.blocks.append(Block(rows, columns, entries))

    def on_rows(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the matrix times planes ``[n, …]``, ``[m, …]``."""
        flat = planes.flatten(1)
        result = flat.new_empty(self.shape[0], flat.shape[1])
        for rows, columns, entries in self.blocks:
            torch.mm(entries, flat[columns], out=result[rows])
        return result.unflatten(1, planes.shape[1:])

    def on_rows_adjoint(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the transpose times planes ``[m, …]``, ``[n, …]``."""
        flat = planes.flatten(1)
        result = flat.new_zeros(self.shape[1], flat.shape[1])
        for rows, columns, entries in self.blocks:
            result[columns].addmm_(entries.T, flat[rows])
        return result.unflatten(1, planes.shape[1:])

    def on_columns(self, planes: torch.Tensor) -> torch.Tensor:
        """Return planes ``[…, n]`` with the matrix applied to each row, ``[…, m]``."""
        flat = planes.flatten(0, -2)
        result = flat.new_empty(flat.shape[0], self.shape[0])
        for rows, columns, entries in self.blocks:
            torch.mm(flat[:, columns], entries.T, out=result[:, rows])
        return result.reshape(*planes.shape[:-1], -1)

    def on_columns_adjoint(self, planes: torch.Tensor) -> torch.Tensor:
        """Return planes ``[…, m]`` with the transpose applied to each row, ``[…, n]``."""
        flat = planes.flatten(0, -2)
        result = flat.new_zeros(flat.shape[0], self.shape[1])
        for rows, columns, entries in self.blocks:
            result[:, columns].addmm_(flat[:, rows], entries)
        return result.reshape(*planes.shape[:-1], -1)


def is_blocked(picture: torch.Tensor) -> bool:
    """Return whether statistics may be computed in strips: of floats on a CPU, without a transform, and not of none."""
    kind = picture.dtype in (torch.float32, torch.float64)
    return kind and picture.numel() > 0 and is_plain_on_cpu(picture)


class Sampler:
    """A linear map of planes: a weighted sum of the plane itself and of coarser levels, enlarged.

    Parameters
    ----------
    device : torch.device
        Where the planes are.
    dtype : torch.dtype
        Their precision.

    Attributes
    ----------
    is_blocked : bool
        Whether the map is held as levels and strips, which is what a processor does best.
    levels : tuple of Level
        The levels from 1 on.
    strips : list of Strip
        How rows are made of the levels.
    """

    levels: tuple["Level", ...] = ()
    strips: Sequence["Strip"] = ()

    def __init__(self, device: torch.device, dtype: torch.dtype) -> None:
        self.device: torch.device = device
        self.dtype: torch.dtype = dtype
        self.is_blocked: bool = device.type == "cpu" and dtype in (torch.float32, torch.float64)

    def __call__(self, image: torch.Tensor) -> torch.Tensor:
        """Return the sampled pictures ``[B, C, H, W]``; differentiable any number of times."""
        if not (self.levels and image.numel() and is_plain_on_cpu(image)):
            return self.plainly(image)
        return linear(self, False, image.flatten(0, 1).movedim(0, 1)).movedim(1, 0).reshape(image.shape)

    def forward(self, planes: torch.Tensor) -> torch.Tensor:
        """Return sampled planes ``[H, P, W]``, in strips."""
        result = torch.empty_like(planes)
        for chunk in plane_chunks(self, planes):
            part, target = planes[:, chunk], result[:, chunk]
            memory, coarse = strip_memory(self, part), self.coarse(self.levels[0].halve(part))
            for strip in self.strips:
                total = torch.mul(part[strip.rows], strip.fine, out=target[strip.rows])
                strip.add(total[:, None], coarse, memory[: len(total), None])
        return result

    def adjoint(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the adjoint of :meth:`forward`."""
        result = torch.empty_like(planes)
        for chunk in plane_chunks(self, planes):
            part, target = planes[:, chunk], result[:, chunk]
            memory = strip_memory(self, part)
            totals = [part.new_zeros(level.enlarged.shape[1], *part.shape[1:]) for level in self.levels]
            for strip in self.strips:
                rows = part[strip.rows]
                torch.mul(rows, strip.fine, out=target[strip.rows])
                strip.add_adjoint(rows[:, None], totals, memory[: len(rows), None])
            self.levels[0].halve_adjoint(self.coarse_adjoint(totals), target)
        return result

    def plainly(self, image: torch.Tensor) -> torch.Tensor:
        """Return the sampled pictures by differentiable operations of torch."""
        raise NotImplementedError

    def coarse(self, first: torch.Tensor) -> list[torch.Tensor]:
        """Return every level from 1, enlarged along its rows ``[H / 2ˡ, P, W]``, of level 1's rows `first`."""
        levels = []
        for index, level in enumerate(self.levels):
            first = level.halve(first) if index else first
            levels.append(level.columns.on_columns(first))
        return levels

    def coarse_adjoint(self, gradients: list[torch.Tensor]) -> torch.Tensor:
        """Return the adjoint of :meth:`coarse`."""
        pairs = list(zip(self.levels, gradients, strict=True))
        total = pairs[-1][0].columns.on_columns_adjoint(pairs[-1][1])
        for (level, gradient), (coarser, _) in zip(pairs[-2::-1], pairs[:0:-1], strict=True):
            here = level.columns.on_columns_adjoint(gradient)
            coarser.halve_adjoint(total, here)
            total = here
        return total


class MipSampler(Sampler):
    """Sampling of pictures of one size at one level of their MIP chain per pixel.

    Level l + 1 holds the 2 × 2 means of level l, down to one pixel; levels are enlarged bilinearly. Only the shares of
    the levels depend on the map.

    Parameters
    ----------
    lod : torch.Tensor
        Levels ``[H, W]`` in float64, 0 or more; levels beyond the last are treated as the last.
    dtype : torch.dtype
        Precision of the pictures.
    """

    def __init__(self, lod: torch.Tensor, dtype: torch.dtype) -> None:
        super().__init__(lod.device, dtype)
        weights = level_weights(lod)
        self.weights: torch.Tensor = weights.to(dtype)
        if self.is_blocked:
            size = tuple(lod.shape)
            self.levels: tuple[Level, ...] = _array.outside_graphs(_mip_levels, size, len(weights) - 1, dtype)
            self.strips: list[Strip] = _strips(self.weights, self.levels, _strip_rows(size[1]))

    def plainly(self, image: torch.Tensor) -> torch.Tensor:
        """Return the sampled pictures from whole levels, enlarged one by one."""
        size = image.shape[-2:]
        result = image * self.weights[0]
        for weight in self.weights[1:]:
            image = functional.adaptive_avg_pool2d(image, _halved(image.shape[-2:]))
            enlarged = functional.interpolate(image, size, mode="bilinear", align_corners=False)
            result = torch.addcmul(result, enlarged, weight)
        return result


class UniformSampler(Sampler):
    """Means over squares of one size, enlarged bilinearly: :func:`odak.learn.perception.uniform_blur`.

    Parameters
    ----------
    size, squares : tuple of int
        Rows and columns of the pictures, and of the squares.
    device : torch.device
        Where the pictures are.
    dtype : torch.dtype
        Their precision.
    """

    def __init__(
        self, size: tuple[int, int], squares: tuple[int, int], device: torch.device, dtype: torch.dtype
    ) -> None:
        super().__init__(device, dtype)
        self.squares = squares
        if self.is_blocked:
            self.levels: tuple[Level, ...] = _array.outside_graphs(_uniform_levels, size, squares, dtype)
            shares = torch.zeros(2, *size, dtype=dtype)
            shares[1] = 1
            self.strips: list[Strip] = _strips(shares, self.levels, _strip_rows(size[1]))

    def plainly(self, image: torch.Tensor) -> torch.Tensor:
        """Return the means from torch's pooling and enlargement."""
        means = functional.adaptive_avg_pool2d(image, self.squares)
        return functional.interpolate(means, image.shape[-2:], mode="bilinear", align_corners=False)


class Level(NamedTuple):
    """Operations that compute a level of the chain from the previous one, and enlarge it.

    Attributes
    ----------
    rows : Banded or None
        Means of the last level's rows; None where these are pairs.
    columns : Banded
        From a full row to what a row of this level is enlarged to.
    enlarged : Banded
        From this level's rows to all rows, a block for each strip.
    """

    rows: Banded | None
    columns: Banded
    enlarged: Banded

    def halve(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the means of rows."""
        if self.rows is not None:
            return self.rows.on_rows(planes)
        return (planes[::2] + planes[1::2]).mul_(0.5)

    def halve_adjoint(self, gradient: torch.Tensor, total: torch.Tensor) -> None:
        """Add the adjoint of :meth:`halve` to `total`, in place."""
        if self.rows is not None:
            total.add_(self.rows.on_rows_adjoint(gradient))
        else:
            total.unflatten(0, (-1, 2)).add_(gradient[:, None], alpha=0.5)


class Strip(NamedTuple):
    """A strip of rows of a picture, and the rows of the levels that contribute to it.

    Attributes
    ----------
    rows : slice
        The rows.
    fine : torch.Tensor
        Weight of level 0 ``[rows, 1, W]``.
    parts : tuple
        For each further level that counts here: its index among the coarse ones, its rows, the matrix that enlarges
        them, and its share ``[rows, 1, 1, W]``.
    """

    rows: slice
    fine: torch.Tensor
    parts: tuple[tuple[int, slice, torch.Tensor, torch.Tensor], ...]

    def add(self, total: torch.Tensor, coarse: Sequence[torch.Tensor], memory: torch.Tensor) -> None:
        """Add the contributions of coarse levels to `total` ``[rows, n, P, W]`` in place, with `memory` of its size."""
        for index, window, matrix, share in self.parts:
            torch.mm(matrix, coarse[index][window].flatten(1), out=memory.flatten(1))
            total.addcmul_(memory, share)

    def add_adjoint(self, gradient: torch.Tensor, totals: Sequence[torch.Tensor], memory: torch.Tensor) -> None:
        """Add the adjoint of :meth:`add` to the coarse levels' `totals`, in place."""
        for index, window, matrix, share in self.parts:
            torch.mul(gradient, share, out=memory)
            totals[index][window].flatten(1).addmm_(matrix.T, memory.flatten(1))


def level_weights(lod: torch.Tensor) -> torch.Tensor:
    """Return the weight of each level in each pixel ``[levels, H, W]``, no more levels than are needed."""
    lod = lod.clamp(max=max(lod.shape).bit_length() - 1)
    levels = torch.arange(int(torch.ceil(lod.max())) + 1, dtype=lod.dtype, device=lod.device)
    return (1 - (lod - levels[:, None, None]).abs()).clamp_min(0)


def strip_memory(sampler: Sampler, planes: torch.Tensor) -> torch.Tensor:
    """Return memory for one strip of planes ``[H, P, W]``."""
    return planes.new_empty(sampler.strips[0].fine.shape[0], *planes.shape[1:])


def plane_chunks(sampler: Sampler, planes: torch.Tensor) -> list[slice]:
    """Return which planes ``[H, P, W]`` to take at a time, so that a strip of them stays in each thread's cache."""
    rows, _, columns = sampler.strips[0].fine.shape
    planes_at_once, count = torch.get_num_threads() * CHUNK // (rows * columns) or 1, planes.shape[1]
    # Chunks of about one size: a last one of a single plane would take as many calls as the others.
    step = -(-count // -(-count // planes_at_once))
    return [slice(start, start + step) for start in range(0, count, step)]


def _halved(size):
    return tuple(max(1, side // 2) for side in size)


def _strip_rows(columns):
    return max(16, STRIP // columns)


@functools.lru_cache(maxsize=64)
def _mip_levels(size, count, dtype):
    levels, here, across = [], size, scipy.sparse.identity(size[1], format="csr")
    for _ in range(count):
        coarse = _halved(here)
        across = _means(here[1], coarse[1]) @ across
        levels.append(_new_level(size, here[0], coarse, across, dtype))
        here = coarse
    return tuple(levels)


@functools.lru_cache(maxsize=64)
def _uniform_levels(size, squares, dtype):
    return (_new_level(size, size[0], squares, _means(size[1], squares[1]), dtype),)


def _new_level(size, rows, coarse, across, dtype):
    """Return a level of `coarse` rows and columns, its rows made of `rows` rows, its columns of all by `across`."""
    with _torch_private.keeping():
        pairs = rows == 2 * coarse[0]
        return Level(
            None if pairs else Banded(_means(rows, coarse[0]), COLUMNS, dtype),
            Banded((_line(size[1], coarse[1]) @ across).tocsr(), COLUMNS, dtype),
            Banded(_line(size[0], coarse[0]), _strip_rows(size[1]), dtype),
        )


def _strips(weights, levels, step):
    # All numbers are read from the device at once.
    counts = torch.stack([part.flatten(1).any(1) for part in weights.split(step, 1)], 1).tolist()
    shares = weights[:, :, None]
    strips = []
    for index in range(len(counts[0])):
        rows = slice(index * step, min((index + 1) * step, weights.shape[1]))
        parts = []
        for number, level in enumerate(levels):
            if counts[number + 1][index]:
                block = level.enlarged.blocks[index]
                parts.append((number, block.columns, block.entries, shares[number + 1, rows, None]))
        strips.append(Strip(rows, shares[0, rows], tuple(parts)))
    return strips


def _means(fine, coarse):
    """Return the matrix of the means over the windows of adaptive pooling: pairs, overlapping where a side is odd."""
    index = np.arange(coarse)
    starts, ends = index * fine // coarse, -(-(index + 1) * fine // coarse)
    widths = ends - starts
    columns = np.concatenate([np.arange(*window) for window in zip(starts, ends, strict=True)])
    entries = np.repeat(1 / widths, widths), (np.repeat(index, widths), columns)
    return scipy.sparse.csr_matrix(entries, shape=(coarse, fine))


def _line(fine, coarse):
    """Return the matrix that enlarges a line bilinearly."""
    place = np.clip((np.arange(fine) + 0.5) * (coarse / fine) - 0.5, 0, coarse - 1)
    lower = np.floor(place).astype(int)
    share, index = place - lower, np.arange(fine)
    columns = np.concatenate([lower, np.minimum(lower + 1, coarse - 1)])
    entries = np.concatenate([1 - share, share]), (np.concatenate([index, index]), columns)
    return scipy.sparse.csr_matrix(entries, shape=(fine, coarse))


class RadiallyVaryingBlur(nn.Module):
    """Blur of pictures over regions as wide as the eye's pooling regions.

    The map of levels is kept for the last picture size and geometry, and for each of the last gazes.

    Parameters
    ----------
    nominal_width : bool
        Choose levels whose sampling kernel, a square enlarged bilinearly, is as wide as the pooling region: equal
        standard deviations. False takes squares as wide as the region, whose kernel is 1.7 to 1.9 times as wide.

    Attributes
    ----------
    lod_map : torch.Tensor or None
        Level of the MIP pyramid of each pixel ``[H, W]``; None before the first use.
    lod_fraction : torch.Tensor or None
        Its fractional part.
    size, n_channels, alpha, real_image_width, real_viewing_distance, centre, mode, equi
        What the map was made for.

    Examples
    --------
    A constant picture is not changed:

    >>> import torch
    >>> from odak.learn.perception import RadiallyVaryingBlur
    >>> blur = RadiallyVaryingBlur()
    >>> picture = torch.full((1, 3, 32, 32), 0.5)
    >>> round(blur.blur(picture).min().item(), 6)
    0.5
    """

    def __init__(self, nominal_width: bool = False) -> None:
        super().__init__()
        self.nominal_width: bool = _validate.flag("nominal_width", nominal_width)
        for name in ("lod_map", "lod_fraction"):
            self.register_buffer(name, None, persistent=False)
        self._kept = Kept()
        self.equi: bool | None = None

    def forward(
        self,
        image: torch.Tensor,
        alpha: float = 0.2,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        centre: Gaze | None = None,
        mode: str = "quadratic",
        equi: bool = False,
        *,
        viewing: Viewing | None = None,
    ) -> torch.Tensor:
        """Blur a picture; differentiable in it.

        Parameters
        ----------
        image : torch.Tensor
            Real floats ``[B, C, H, W]``.
        alpha : float
            Growth of the pooling regions with eccentricity, see
            :func:`odak.learn.perception.make_pooling_size_map_pixels`.
        real_image_width : float
            Width of the picture.
        real_viewing_distance : float
            Distance of the eye from the picture's centre, in the same unit.
        centre : sequence of float, optional
            Gaze: (x, y), 0 to 1 from the top-left corner, the picture's centre by default. With `equi` (yaw, pitch) in
            radians, (0, 0) by default. Or ``[B, 2]``, one for each picture.
        mode : str
            "quadratic" or "linear".
        equi : bool
            Take the picture for an equirectangular one; width and distance then mean nothing.
        viewing : Viewing, optional
            Geometry and, without `centre`, gaze, instead of the two lengths.

        Returns
        -------
        torch.Tensor
            ``[B, C, H, W]``, in the input's precision: between two levels of a chain of 2 × 2 means, each enlarged
            bilinearly. A constant stays what it is, and so does every pixel of level 0.

        Raises
        ------
        ValueError, TypeError
            If the picture has not four axes of real floats, or an argument makes no map.
        """
        if not isinstance(image, torch.Tensor) or image.ndim != 4 or not image.is_floating_point():
            kind = f"{tuple(image.shape)} of {image.dtype}" if isinstance(image, torch.Tensor) else type(image).__name__
            raise ValueError(f"image must be a tensor of real floats [B, C, H, W], got {kind}")
        equi, centre = _validate.flag("equi", equi), gaze_at(viewing, centre)
        centre = gaze_of("centre", ((0.0, 0.0) if equi else (0.5, 0.5)) if centre is None else centre, len(image))
        view, centres = geometry(viewing, real_image_width, real_viewing_distance), each_of(centre)
        self._kept.room = len(centres)
        blurred = [self.sampler(one, alpha, *view, place, mode, equi)(one) for one, place in parts_of(image, centres)]
        return torch.cat(blurred) if len(blurred) > 1 else blurred[0]

    blur = forward

    def sampler(
        self,
        image: torch.Tensor,
        alpha: float,
        real_image_width: float,
        real_viewing_distance: float,
        centre: Sequence[float],
        mode: str,
        equi: bool,
    ) -> MipSampler:
        """Return the sampler that blurs pictures of one size, precision and geometry, kept from the last call.

        Parameters
        ----------
        image : torch.Tensor
            One of the pictures ``[B, C, …, H, W]``.
        alpha : float
            Growth of the pooling regions with eccentricity.
        real_image_width : float
            Width of the picture.
        real_viewing_distance : float
            Distance of the eye from the picture's centre, in the same unit.
        centre : sequence of float
            Gaze: (x, y), or (yaw, pitch) with `equi`.
        mode : str
            "quadratic" or "linear".
        equi : bool
            Whether the pictures are equirectangular.

        Raises
        ------
        ValueError, TypeError
            If the picture has not four axes or more, or an argument makes no map.
        """
        if not isinstance(image, torch.Tensor) or _validate.image("image", image).ndim < 4:
            raise ValueError(f"image must be a tensor [B, C, ..., H, W], got {getattr(image, 'shape', image)!r:.80}")
        lengths = _validate.constants(real_image_width=real_image_width, real_viewing_distance=real_viewing_distance)
        view = map(float, checked_view(*lengths))
        place = point("centre", centre), mode, _validate.flag("equi", equi)
        where: tuple[Any, ...] = (_validate.constant("alpha", alpha), *view, *place)
        size = tuple(image.shape[-2:])

        def made():
            # A map made in inference mode could not be used with autograd later.
            with _torch_private.keeping(), torch.no_grad():
                options: dict[str, Any] = {"nominal_width": self.nominal_width, "device": image.device}
                lod = level_map(size, *where, dtype=torch.float64, **options)
                return MipSampler(lod, image.dtype), lod.to(image.dtype), (lod % 1).to(image.dtype)

        key = (size, where, self.nominal_width, image.dtype, image.device)
        sampler, self.lod_map, self.lod_fraction = self._kept.get(key, made)
        self.n_channels: int = image.shape[1]
        self.size: tuple[int, ...] = size
        self.alpha, self.real_image_width, self.real_viewing_distance, self.centre, self.mode, self.equi = where
        return sampler


def level_map(
    size: Sequence[int],
    alpha: float,
    real_image_width: float,
    real_viewing_distance: float,
    centre: Sequence[float],
    mode: str,
    equi: bool,
    *,
    nominal_width: bool = False,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the MIP level of each pixel, of a flat or an equirectangular picture.

    Parameters
    ----------
    size : sequence of int
        Rows and columns.
    alpha : float
        Growth of the pooling regions with eccentricity.
    real_image_width : float
        Width of the picture.
    real_viewing_distance : float
        Distance of the eye from the picture's centre, in the same unit.
    centre : sequence of float
        Gaze: (x, y), or (yaw, pitch) with `equi`.
    mode : str
        "quadratic" or "linear".
    equi : bool
        Whether the picture is equirectangular.
    nominal_width : bool
        Choose levels whose sampling kernel, a square enlarged bilinearly, is as wide as the pooling region: equal
        standard deviations. False takes squares as wide as the region, whose kernel is 1.7 to 1.9 times as wide.
    dtype : torch.dtype
        Precision of the map.
    device : torch.device, optional
        Where it is made.

    Returns
    -------
    torch.Tensor
        ``[H, W]``.
    """
    mode = _validate.one_of("mode", mode, MODES)
    options: dict[str, Any] = {"nominal_width": nominal_width, "dtype": dtype, "device": device}
    if equi:
        return make_equi_pooling_size_map_lod(centre, size, alpha, mode, **options)
    return make_pooling_size_map_lod(centre, size, alpha, real_image_width, real_viewing_distance, mode, **options)


class BlurLoss(Seen):
    """Mean squared difference of a picture from the target blurred for a gaze.

    Parameters
    ----------
    device : torch.device
        Where the loss is first; results follow their inputs.
    alpha : float
        Growth of the eye's pooling regions with eccentricity.
    real_image_width : float
        Width of the picture as shown.
    real_viewing_distance : float
        Distance of the eye from its centre, in the same unit.
    mode : str
        "quadratic" or "linear" growth.
    blur_source : bool
        Blur the image as well as the target.
    equi : bool
        Pictures are equirectangular; the gaze is then (yaw, pitch) in radians.
    nominal_width : bool
        Choose levels whose sampling kernel, a square enlarged bilinearly, is as wide as the pooling region: equal
        standard deviations. False takes squares as wide as the region, whose kernel is 1.7 to 1.9 times as wide.
    viewing : Viewing, optional
        Geometry and gaze, instead of the two lengths.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Attributes
    ----------
    viewing : Viewing
        How pictures are seen.
    target, blur, loss_func
        The last target, the blur and the mean squared error.

    Notes
    -----
    A baseline to :class:`odak.learn.perception.MetamericLoss`: smallest for blur where details are not resolved.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import BlurLoss
    >>> loss = BlurLoss(blur_source=True)
    >>> picture = torch.rand(1, 3, 32, 32)
    >>> loss(picture, picture).item()
    0.0
    """

    _place: torch.Tensor
    alpha: float
    mode: str

    def __init__(
        self,
        device: torch.device | str = "cpu",
        alpha: float = 0.2,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        mode: str = "quadratic",
        blur_source: bool = False,
        equi: bool = False,
        nominal_width: bool = False,
        *,
        viewing: Viewing | None = None,
    ) -> None:
        super().__init__()
        device = checked_device("device", device)
        self.register_buffer("_place", torch.empty(0, device=device), persistent=False)
        self.alpha, self.mode = _growth(alpha, mode)
        self.viewing: Viewing = viewing_of(viewing, real_image_width, real_viewing_distance)
        self.blur_source: bool = _validate.flag("blur_source", blur_source)
        self.equi: bool = _validate.flag("equi", equi)
        self.blur: RadiallyVaryingBlur = RadiallyVaryingBlur(nominal_width).to(device)
        self.target: torch.Tensor | None = None
        self.loss_func: torch.nn.MSELoss = nn.MSELoss()

    @property
    def device(self) -> torch.device:
        """Device of the loss."""
        return self._place.device

    def blur_image(self, image: torch.Tensor, gaze: Gaze | None) -> torch.Tensor:
        """Return an image averaged over the pooling region of each pixel, ``[B, C, H, W]``.

        Parameters
        ----------
        image : torch.Tensor
            Image ``[B, C, H, W]``.
        gaze : sequence of float
            Gaze position (x, y), each 0 to 1 from the top left corner, or ``[B, 2]``; None for that of the viewing.
        """
        gaze, view = self._gaze(gaze), self.viewing
        return self.blur.blur(image, self.alpha, centre=gaze, mode=self.mode, equi=self.equi, viewing=view)

    def forward(self, image: torch.Tensor, target: torch.Tensor, gaze: Gaze | None = None) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            ``[B, C, H, W]`` of one shape, one or three channels, about 0 … 1 in any colour space.
        gaze : sequence of float, optional
            (x, y), 0 to 1 from the top-left corner; it may lie outside the picture. Or ``[B, 2]``, one for each
            picture. By default that of the viewing.

        Returns
        -------
        torch.Tensor
            Without axes, differentiable in both; 0 for equal pictures with `blur_source` only.

        Raises
        ------
        ValueError, TypeError
            If the pictures cannot be compared or an argument makes no map.
        """
        check_loss_inputs("BlurLoss", image, target)
        as_pictures("image", image, None), as_pictures("target", target, None)
        pictures: dict[str, Any] = {"BlurLoss ERROR: image": image, "BlurLoss ERROR: target": target}
        check_values(**pictures)
        self.target, gaze = target.detach(), self._gaze(gaze, len(image))
        if self.blur_source:
            image = self.blur_image(image, gaze)
        return self.loss_func(image, self.blur_image(target, gaze))
