"""How coarsely an eye pools what it sees, pixel by pixel: maps for flat screens and for equirectangular pictures.

A flat screen stands upright in front of the eye, its centre on the axis. Width and distance share one unit, whatever
it is. The gaze is (x, y) from the top-left corner, 0 to 1 across the picture; it may lie beside it. Angles are radians.
"""

import math
from collections.abc import Sequence
from typing import Any

import torch

from odak import _array, _validate
from odak.learn._tensors import checked_device, checked_dtype

MODES = ("quadratic", "linear")
# Cones that graze the screen, or look behind it, are cut short here.
STEEPEST = math.pi / 2 - 1e-3


def make_3d_location_map(
    image_pixel_size: Sequence[int],
    real_image_width: float = 0.3,
    real_viewing_distance: float = 0.6,
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return where each pixel is, seen from the eye.

    Parameters
    ----------
    image_pixel_size : sequence of int
        Rows and columns of the picture, whose pixels are square.
    real_image_width, real_viewing_distance : float
        Width of the picture and distance of the eye from its centre, in one unit.
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
    """
    dtype, device = _options(dtype, device)
    rows, columns = _validate.size("image_pixel_size", image_pixel_size)
    width, distance = _geometry(real_image_width, real_viewing_distance)
    height = width / columns * rows
    x = torch.linspace(-0.5, 0.5, columns, dtype=torch.float64, device=device) * width
    y = torch.linspace(-0.5, 0.5, rows, dtype=torch.float64, device=device) * height
    z = torch.full((rows, columns), distance, dtype=torch.float64, device=device)
    return torch.stack([x.expand(rows, columns), y[:, None].expand(rows, columns), z]).to(dtype)


def make_eccentricity_distance_maps(
    gaze_location: Sequence[float],
    image_pixel_size: Sequence[int],
    real_image_width: float = 0.3,
    real_viewing_distance: float = 0.6,
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the angle of each pixel from the gaze, and its distance from the eye.

    Parameters
    ----------
    gaze_location : sequence of float
        (x, y), 0 to 1 from the top-left corner.
    image_pixel_size, real_image_width, real_viewing_distance, dtype, device
        As for :func:`make_3d_location_map`.

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
    width, distance = _geometry(real_image_width, real_viewing_distance)
    place = make_3d_location_map(image_pixel_size, width, distance, dtype=torch.float64, device=device)
    rows, columns = place.shape[-2:]
    x, y = _point("gaze_location", gaze_location)
    gaze = ((2 * x - 1) * width / 2, (2 * y - 1) * width / columns * rows / 2, distance)
    return _angle(place, gaze).to(dtype), _length(place).to(dtype)


def make_pooling_size_map_pixels(
    gaze_location: Sequence[float],
    image_pixel_size: Sequence[int],
    alpha: float = 0.3,
    real_image_width: float = 0.3,
    real_viewing_distance: float = 0.6,
    mode: str = "quadratic",
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the width in pixels of the region that the eye pools around each pixel.

    Parameters
    ----------
    gaze_location : sequence of float
        (x, y), 0 to 1 from the top-left corner.
    image_pixel_size : sequence of int
        Rows and columns.
    alpha : float
        Pooling diameter over eccentricity ("linear") or over its square in radians ("quadratic").
    real_image_width, real_viewing_distance : float
        Width of the picture and distance of the eye from its centre, in one unit.
    mode : str
        "quadratic" or "linear".
    dtype, device
        As for :func:`make_3d_location_map`.

    Returns
    -------
    torch.Tensor
        ``[H, W]``: side of the square whose area is that of the ellipse which the pooling cone cuts out of the screen;
        0 at the gaze, never above the picture's diagonal.

    Raises
    ------
    ValueError, TypeError
        If the mode is unknown, `alpha` is negative, a length is not positive, or the gaze not two finite numbers.

    Notes
    -----
    Pooling diameters that grow with eccentricity: Freeman and Simoncelli, Nat. Neurosci. 14, 1195 (2011); the map:
    Walton et al., ACM Trans. Graph. 40, 48 (2021).
    """
    dtype, device = _options(dtype, device)
    rows, columns = _validate.size("image_pixel_size", image_pixel_size)
    width, distance = _geometry(real_image_width, real_viewing_distance)
    options: dict[str, Any] = {"dtype": torch.float64, "device": device}
    size = (rows, columns)
    angle, far = make_eccentricity_distance_maps(gaze_location, size, width, distance, **options)
    from_axis, _ = make_eccentricity_distance_maps((0.5, 0.5), size, width, distance, **options)
    half = _pooling_angle(angle, alpha, mode) / 2
    outer, inner = (from_axis + half).clamp(max=STEEPEST), (from_axis - half).clamp(min=-STEEPEST)
    major = (torch.tan(outer) - torch.tan(inner)) * distance
    minor = 2 * far * torch.tan(half.clamp(max=STEEPEST))
    side = torch.sqrt((math.pi / 4 * major * minor).abs()) / width * columns
    return side.clamp(max=math.hypot(rows, columns)).to(dtype)


def make_pooling_size_map_lod(
    gaze_location: Sequence[float],
    image_pixel_size: Sequence[int],
    alpha: float = 0.3,
    real_image_width: float = 0.3,
    real_viewing_distance: float = 0.6,
    mode: str = "quadratic",
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the level of a MIP pyramid whose pixels are as wide as the pooling region: max(0, log₂ pixels).

    Parameters
    ----------
    gaze_location, image_pixel_size, alpha, real_image_width, real_viewing_distance, mode, dtype, device
        As for :func:`make_pooling_size_map_pixels`.

    Returns
    -------
    torch.Tensor
        ``[H, W]``, 0 where the eye resolves single pixels.
    """
    dtype, device = _options(dtype, device)
    pixels = make_pooling_size_map_pixels(
        gaze_location,
        image_pixel_size,
        alpha,
        real_image_width,
        real_viewing_distance,
        mode,
        dtype=torch.float64,
        device=device,
    )
    return _level(pixels).to(dtype)


def make_radial_map(
    size: Sequence[int],
    gaze: Sequence[float],
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
    dtype, device
        As for :func:`make_3d_location_map`.

    Returns
    -------
    torch.Tensor
        ``[H, W]``, 0 … 1.
    """
    dtype, device = _options(dtype, device)
    rows, columns = _validate.size("size", size)
    x, y = _point("gaze", gaze)
    across = torch.linspace(0, columns, columns, dtype=torch.float64, device=device) - x * columns
    down = torch.linspace(0, rows, rows, dtype=torch.float64, device=device) - y * rows
    distance = torch.hypot(across.expand(rows, columns), down[:, None].expand(rows, columns))
    return (distance / distance.max().clamp_min(torch.finfo(torch.float64).tiny)).to(dtype)


def make_equi_pooling_size_map_pixels(
    gaze_angles: Sequence[float],
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
    alpha, mode, dtype, device
        As for :func:`make_pooling_size_map_pixels`.

    Returns
    -------
    torch.Tensor
        ``[H, W]``: geometric mean of the pooling angle counted in pixels of yaw and of pitch, times √π/2. Pixels are
        counted as on the equator; towards the poles, where they crowd, true sizes are larger.

    Raises
    ------
    ValueError, TypeError
        If the mode is unknown, `alpha` is negative, or the gaze not two finite numbers.
    """
    dtype, device = _options(dtype, device)
    rows, columns = _validate.size("image_pixel_size", image_pixel_size)
    yaw, pitch = _point("gaze_angles", gaze_angles)
    yaws = torch.linspace(-math.pi, math.pi, columns, dtype=torch.float64, device=device)
    pitches = torch.linspace(-math.pi / 2, math.pi / 2, rows, dtype=torch.float64, device=device)[:, None]
    level = torch.cos(pitches)
    places = torch.stack([torch.sin(yaws) * level, torch.sin(pitches).expand(rows, columns), torch.cos(yaws) * level])
    gaze = (math.sin(yaw) * math.cos(pitch), math.sin(pitch), math.cos(yaw) * math.cos(pitch))
    diameter = _pooling_angle(_angle(places, gaze), alpha, mode)
    pixels = diameter * math.sqrt(math.pi / 4 * columns / (2 * math.pi) * rows / math.pi)
    return pixels.clamp(max=math.hypot(rows, columns)).to(dtype)


def make_equi_pooling_size_map_lod(
    gaze_angles: Sequence[float],
    image_pixel_size: Sequence[int],
    alpha: float = 0.3,
    mode: str = "quadratic",
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the MIP level of an equirectangular picture whose pixels are as wide as the pooling region.

    Parameters
    ----------
    gaze_angles, image_pixel_size, alpha, mode, dtype, device
        As for :func:`make_equi_pooling_size_map_pixels`.

    Returns
    -------
    torch.Tensor
        ``[H, W]``.
    """
    dtype, device = _options(dtype, device)
    pixels = make_equi_pooling_size_map_pixels(
        gaze_angles, image_pixel_size, alpha, mode, dtype=torch.float64, device=device
    )
    return _level(pixels).to(dtype)


def _geometry(real_image_width, real_viewing_distance):
    _validate.number("real_image_width", real_image_width, positive=True)
    _validate.number("real_viewing_distance", real_viewing_distance, positive=True)
    return float(real_image_width), float(real_viewing_distance)


def _point(name, value) -> tuple[float, float]:
    """Return two finite floats; a copy, so that a list changed afterwards changes nothing here."""
    try:
        x, y = _validate.several(name, value.reshape(-1) if _array.is_array(value) else value, 2)
    except ValueError as error:
        raise ValueError(f"{name} must be two finite numbers, got {value!r}") from error
    return float(x), float(y)


def _growth(alpha, mode):
    if _validate.number("alpha", alpha) < 0:
        raise ValueError(f"alpha must not be negative, got {alpha!r}")
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
    # By components: a norm along the first axis walks through memory in large steps.
    x, y, z = vectors
    return (x * x + y * y).addcmul_(z, z).sqrt_()


def _level(pixels):
    return torch.log2(1e-6 + pixels).clamp_min(0)
