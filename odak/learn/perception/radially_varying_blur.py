"""A blur that grows away from the gaze: trilinear sampling of a MIP pyramid."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn.perception.foveation import (
    MODES,
    _point,
    make_equi_pooling_size_map_lod,
    make_pooling_size_map_lod,
)
from odak.learn.perception.mip_sampling import MipSampler


class RadiallyVaryingBlur(nn.Module):
    """Blur of pictures over regions as wide as the eye's pooling regions.

    The map of levels is kept for the last picture size, gaze and viewing geometry.

    Attributes
    ----------
    lod_map, lod_fraction : torch.Tensor or None
        Level of the MIP pyramid of each pixel ``[H, W]``, and its fractional part; None before the first use.
    size, n_channels, alpha, real_image_width, real_viewing_distance, centre, mode, equi
        What the map was made for.
    """

    def __init__(self) -> None:
        super().__init__()
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
        """Return :meth:`blur`."""
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
        real_image_width, real_viewing_distance : float
            Width of the picture and distance of the eye from its centre, in one unit.
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
        """Return what blurs pictures of one size, precision and geometry; that of the last call if it will do.

        Parameters
        ----------
        image : torch.Tensor
            One of the pictures ``[B, C, …, H, W]``.
        alpha, real_image_width, real_viewing_distance, centre, mode, equi
            As for :meth:`blur`.

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
        key = (size, geometry, image.dtype, image.device)
        if key == self._key:
            return self._sampler
        # A map made in inference mode could not serve a gradient later.
        with torch.inference_mode(False), torch.no_grad():
            lod = level_map(size, *geometry, dtype=torch.float64, device=image.device)
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
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the MIP level of each pixel, of a flat or an equirectangular picture.

    Parameters
    ----------
    size : sequence of int
        Rows and columns.
    alpha, real_image_width, real_viewing_distance, centre, mode, equi
        As for :meth:`RadiallyVaryingBlur.blur`.
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
    options: dict[str, Any] = {"dtype": dtype, "device": device}
    if equi:
        return make_equi_pooling_size_map_lod(centre, size, alpha, mode, **options)
    return make_pooling_size_map_lod(centre, size, alpha, real_image_width, real_viewing_distance, mode, **options)
