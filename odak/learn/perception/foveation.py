"""Pooling regions that grow with eccentricity: maps of their size, blur over them, and a loss of blurred pictures.

A flat screen stands upright in front of the eye, its centre on the axis. Width and distance share one unit. The gaze is
(x, y) from the top-left corner, 0 to 1 across the picture; it may lie beside it. Angles are in radians.
"""

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from odak import _array, _validate
from odak.learn._tensors import checked_device, checked_dtype
from odak.learn.perception.color_matrices import as_pictures
from odak.learn.perception.pooling import MipSampler
from odak.learn.perception.util import check_loss_inputs, check_values

MODES = ("quadratic", "linear")
# Limit of the angle for cones that graze the screen or point behind it.
STEEPEST = math.pi / 2 - 1e-3


def make_3d_location_map(
    image_pixel_size: Sequence[int],
    real_image_width: float = 0.3,
    real_viewing_distance: float = 0.6,
    *,
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
    image_pixel_size : sequence of int
        Rows and columns of the picture, whose pixels are square.
    real_image_width : float
        Width of the picture.
    real_viewing_distance : float
        Distance of the eye from the picture's centre, in the same unit.
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
    real_image_width : float
        Width of the picture.
    real_viewing_distance : float
        Distance of the eye from the picture's centre, in the same unit.
    mode : str
        "quadratic" or "linear".
    dtype : torch.dtype
        Precision of the map.
    device : torch.device, optional
        Where the map is made.

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
    nominal_width: bool = False,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the level of a MIP pyramid whose pixels are as wide as the pooling region: max(0, log₂ pixels).

    Parameters
    ----------
    gaze_location : sequence of float
        (x, y), 0 to 1 from the top-left corner.
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
        ``[H, W]``, 0 where the eye resolves single pixels.

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
        dtype=torch.float64,
        device=device,
    )
    return _level(pixels, nominal_width).to(dtype)


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


class RadiallyVaryingBlur(nn.Module):
    """Blur of pictures over regions as wide as the eye's pooling regions.

    The map of levels is kept for the last picture size, gaze and viewing geometry.

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
        self.nominal_width = _validate.flag("nominal_width", nominal_width)
        for name in ("lod_map", "lod_fraction"):
            self.register_buffer(name, None, persistent=False)
        self._key: tuple | None = None
        self._sampler: Any = None
        self.equi: bool | None = None

    def forward(
        self,
        image: torch.Tensor,
        alpha: float = 0.2,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        centre: Sequence[float] | None = None,
        mode: str = "quadratic",
        equi: bool = False,
    ) -> torch.Tensor:
        """Return the blurred image; the same as :meth:`blur`.

        Parameters
        ----------
        image : torch.Tensor
            Image ``[B, C, H, W]``.
        alpha : float
            Growth of the pooling regions with eccentricity, see :meth:`blur`; default 0.2.
        real_image_width : float
            Width of the displayed image in metres, default 0.2.
        real_viewing_distance : float
            Distance of the eye from the image in metres, default 0.7.
        centre : sequence of float, optional
            Gaze position, see :meth:`blur`; by default the middle of the image.
        mode : {"quadratic", "linear"}
            Law of that growth, default "quadratic".
        equi : bool
            Whether the image is an equirectangular panorama, default False.
        """
        return self.blur(image, alpha, real_image_width, real_viewing_distance, centre, mode, equi)

    def blur(
        self,
        image: torch.Tensor,
        alpha: float = 0.2,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        centre: Sequence[float] | None = None,
        mode: str = "quadratic",
        equi: bool = False,
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
            radians, (0, 0) by default.
        mode : str
            "quadratic" or "linear".
        equi : bool
            Take the picture for an equirectangular one; width and distance then mean nothing.

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
            raise ValueError("image must be a tensor of real floats [B, C, H, W]")
        equi = _validate.flag("equi", equi)
        centre = _point("centre", ((0.0, 0.0) if equi else (0.5, 0.5)) if centre is None else centre)
        return self.sampler(image, alpha, real_image_width, real_viewing_distance, centre, mode, equi)(image)

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
        geometry = (alpha, real_image_width, real_viewing_distance, _point("centre", centre), mode)
        geometry = (*geometry, _validate.flag("equi", equi))
        size = tuple(image.shape[-2:])
        self.n_channels = image.shape[1]
        key = (size, geometry, self.nominal_width, image.dtype, image.device)
        if key == self._key:
            return self._sampler
        # A map made in inference mode could not be used with autograd later.
        with torch.inference_mode(False), torch.no_grad():
            options: dict[str, Any] = {"nominal_width": self.nominal_width, "device": image.device}
            lod = level_map(size, *geometry, dtype=torch.float64, **options)
            self._sampler = MipSampler(lod, image.dtype)
            self.lod_map, self.lod_fraction = lod.to(image.dtype), (lod % 1).to(image.dtype)
        self._key, self.size = key, size
        self.alpha, self.real_image_width, self.real_viewing_distance = geometry[:3]
        self.centre, self.mode, self.equi = geometry[3:]
        return self._sampler


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


class BlurLoss(nn.Module):
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

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Attributes
    ----------
    target, blur, loss_func
        The last target, the blur and the mean squared error.

    Notes
    -----
    A baseline to :class:`odak.learn.perception.MetamericLoss`: it asks for blur where the eye cannot resolve details.

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
    ) -> None:
        super().__init__()
        device = checked_device("device", device)
        self.register_buffer("_place", torch.empty(0, device=device), persistent=False)
        self.alpha, self.mode = _growth(alpha, mode)
        self.real_image_width = _validate.number("real_image_width", real_image_width, positive=True)
        self.real_viewing_distance = _validate.number("real_viewing_distance", real_viewing_distance, positive=True)
        self.blur_source, self.equi = _validate.flag("blur_source", blur_source), _validate.flag("equi", equi)
        self.blur = RadiallyVaryingBlur(nominal_width).to(device)
        self.target: torch.Tensor | None = None
        self.loss_func = nn.MSELoss()

    @property
    def device(self) -> torch.device:
        """Where the loss was last moved to."""
        return self._place.device

    def blur_image(self, image: torch.Tensor, gaze: Sequence[float]) -> torch.Tensor:
        """Return an image blurred as the periphery of the eye sees it, ``[B, C, H, W]``.

        Parameters
        ----------
        image : torch.Tensor
            Image ``[B, C, H, W]``.
        gaze : sequence of float
            Gaze position (x, y), each 0 to 1 from the top left corner.
        """
        gaze = _point("gaze", gaze)
        return self.blur.blur(
            image, self.alpha, self.real_image_width, self.real_viewing_distance, gaze, self.mode, self.equi
        )

    def forward(self, image: torch.Tensor, target: torch.Tensor, gaze: Sequence[float] = (0.5, 0.5)) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            ``[B, C, H, W]`` of one shape, one or three channels, about 0 … 1 in any colour space.
        gaze : sequence of float
            (x, y), 0 to 1 from the top-left corner; beside the picture is legal.

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
        self.target = target.detach()
        if self.blur_source:
            image = self.blur_image(image, gaze)
        return self.loss_func(image, self.blur_image(target, gaze))
