"""The metameric loss without a gaze: statistics pooled over regions of one size, for pictures seen from anywhere."""

from typing import Any

import torch
from torch import nn
from torch.nn import functional

from odak import _validate
from odak.learn._tensors import checked_device
from odak.learn.perception import pyramid_statistics as statistics
from odak.learn.perception.color_matrices import as_pictures
from odak.learn.perception.mip_sampling import UniformSampler
from odak.learn.perception.pooled_distance import as_maps
from odak.learn.perception.spatial_steerable_pyramid import SpatialSteerablePyramid, pad_image_for_pyramid

# Pixels: smaller pooling regions would only take memory.
FINEST = 1 / 64


def uniform_blur(image: torch.Tensor, pooling_size: float) -> torch.Tensor:
    """Return means over squares, enlarged bilinearly to the picture's size.

    Parameters
    ----------
    image : torch.Tensor
        ``[B, C, H, W]``.
    pooling_size : float
        Side of the squares in pixels, at least 1/64; at least one square fits always.

    Returns
    -------
    torch.Tensor
        ``[B, C, H, W]``.

    Raises
    ------
    ValueError, TypeError
        If the picture has not four axes, or the size is below 1/64.
    """
    if as_pictures("image", image, None).ndim != 4 or 0 in _validate.image("image", image, axes=4).shape:
        raise ValueError(f"image must be [B, C, H, W], none empty, got {tuple(image.shape)}")
    return _sampler(image, float(_validate.number("pooling_size", pooling_size, positive=True, least=FINEST)))(image)


def _sampler(image, pooling_size):
    size = tuple(image.shape[-2:])
    squares = tuple(max(1, int(side / pooling_size)) for side in size)
    return UniformSampler(size, squares, image.device, image.dtype)


class MetamericLossUniform(nn.Module):
    """Distance between the pooled statistics of two pictures, the same everywhere.

    Parameters
    ----------
    device : torch.device
        Where the loss is first; results follow their inputs.
    pooling_size : float
        Side of the pooling regions in pixels of the finest level; half of it at each next level.
    n_pyramid_levels : int
        Levels of the pyramid, at least 2.
    n_orientations : int
        Orientations of the bands.

    Attributes
    ----------
    target, target_stats, loss_map, pyramid_maker
        Of the last call; None before.

    Notes
    -----
    See :class:`odak.learn.perception.MetamericLoss`; statistics of the target are kept in the same way.
    """

    _place: torch.Tensor

    def __init__(
        self,
        device: torch.device | str = "cpu",
        pooling_size: float = 32,
        n_pyramid_levels: int = 5,
        n_orientations: int = 2,
    ) -> None:
        super().__init__()
        self.register_buffer("_place", torch.empty(0, device=checked_device("device", device)), persistent=False)
        self.pooling_size = _validate.number("pooling_size", pooling_size, positive=True, least=FINEST)
        self.n_pyramid_levels = _validate.integer("n_pyramid_levels", n_pyramid_levels, minimum=2)
        self.n_orientations = _validate.integer("n_orientations", n_orientations, minimum=1)
        self.pyramid_maker: SpatialSteerablePyramid | None = None
        self.target_stats: Any = None
        self.target: torch.Tensor | None = None
        self.loss_map: torch.Tensor | None = None
        self._kept = statistics.TargetCache()

    @property
    def device(self) -> torch.device:
        """Where the loss was last moved to."""
        return self._place.device

    def forward(
        self,
        image: torch.Tensor,
        target: torch.Tensor,
        image_colorspace: str = "RGB",
        visualise_loss: bool = False,
    ) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            ``[B, C, H, W]`` of one shape, one or three channels, about 0 … 1.
        image_colorspace : str
            "RGB", or anything else if both pictures are in Y′CrCb already.
        visualise_loss : bool
            Keep a map of the differences of the first picture as `loss_map`.

        Returns
        -------
        torch.Tensor
            Without axes, differentiable; 0 for equal pictures.

        Raises
        ------
        ValueError, TypeError
            If the pictures cannot be compared or are too small for the pyramid.
        """
        statistics.checked_pictures("MetamericLossUniform", image, target, self.n_pyramid_levels)
        visualise_loss = _validate.flag("visualise_loss", visualise_loss)
        key = (self.pooling_size, self.n_pyramid_levels, self.n_orientations, image_colorspace, target.dtype)
        self.target, self.target_stats, kept = self._kept.get(
            target, key, lambda: self._described(target, image_colorspace)
        )
        image = self._converted(image, image_colorspace)
        if kept is not None and not visualise_loss and statistics.is_blocked(image):
            groups, low, samplers = self._analysed(image, self.pooling_size)
            rest = functional.mse_loss(low, kept[-1])
            return statistics.mean_distance_to(kept[:-1], groups, samplers, [None] * len(groups), rest)
        stats = self.calc_statsmaps(image, self.pooling_size)
        if visualise_loss:
            self.visualise_loss_map(stats)
        return self.metameric_loss_stats(stats, self.target_stats)

    def calc_statsmaps(self, image: torch.Tensor, pooling_size: float) -> list[torch.Tensor]:
        """Return the pooled statistics of a picture.

        Parameters
        ----------
        image : torch.Tensor
            ``[B, C, H, W]``, sides multiples of 2ⁿ⁻¹ for n levels, in the colour space to compare in.
        pooling_size : float
            Side of the pooling regions in pixels of the finest level.

        Returns
        -------
        list of torch.Tensor
            Mean and deviation of the high-pass residual and of each band, fine to coarse, and the last low-pass.

        Raises
        ------
        ValueError, TypeError
            If the picture does not fit the pyramid, or the size is below 1/64.
        """
        _validate.image("image", image, axes=4)
        _validate.number("pooling_size", pooling_size, positive=True, least=FINEST)
        return statistics.pooled_statistics(*self._analysed(image, pooling_size))

    def metameric_loss_stats(self, statsmap_a: list[torch.Tensor], statsmap_b: list[torch.Tensor]) -> torch.Tensor:
        """Return the mean over two lists of statistics of their mean squared differences."""
        return statistics.mean_distance(*statistics.checked_statistics(statsmap_a=statsmap_a, statsmap_b=statsmap_b))

    def visualise_loss_map(self, image_stats: list[torch.Tensor]) -> None:
        """Keep how far the first picture's statistics are from the target's as `loss_map` ``[H, W]``."""
        if self.target_stats is None:
            raise ValueError("visualise_loss_map needs the statistics of a target: call the loss first")
        maps = statistics.checked_statistics(image_stats=image_stats, target_stats=self.target_stats)
        self.loss_map = statistics.difference_map(*maps)[0]

    def gen_metamer(self, image: torch.Tensor, seed: int = 0) -> torch.Tensor:
        """Return noise with the pooled statistics of a picture.

        Parameters
        ----------
        image : torch.Tensor
            RGB or grey ``[B, C, H, W]``, about 0 … 1.
        seed : int
            Of the noise.

        Returns
        -------
        torch.Tensor
            ``[B, C, H, W]``, not clipped to 0 … 1.

        Raises
        ------
        ValueError, TypeError
            If the picture is too small for the pyramid, or no picture.
        """
        statistics.checked_pictures("MetamericLossUniform", image, image, self.n_pyramid_levels)
        padded, stats, _ = self._described(image, "RGB")
        maker = self._maker(image.shape[1])
        metamer = statistics.matched_noise(padded, stats, maker, self.n_pyramid_levels, seed)
        return statistics.as_picture(metamer, image.shape)

    def _apply(self, function, recurse=True):
        self._kept.clear()
        return super()._apply(function, recurse)

    def _converted(self, picture, colourspace):
        return statistics.converted(pad_image_for_pyramid(picture, self.n_pyramid_levels), colourspace)

    def _described(self, picture, colourspace):
        """Return a target padded and converted, its statistics, and these as `mean_distance_to` reads them."""
        picture = self._converted(picture, colourspace)
        if not statistics.is_blocked(picture) or picture.requires_grad:
            return picture, self.calc_statsmaps(picture, self.pooling_size), None
        groups, low, samplers = self._analysed(picture, self.pooling_size)
        values = statistics.masked_statistics(groups, samplers, [None] * len(groups))
        maps = [one for value, bands in zip(values, groups, strict=True) for one in as_maps(value, bands.shape)]
        return picture, [*maps, low], [*values, low]

    def _analysed(self, image, pooling_size):
        """Return the bands of a picture, its last low-pass, and what pools each group of bands."""
        groups, low = self._maker(image.shape[1]).stacked_bands(image, self.n_pyramid_levels)
        samplers = [_sampler(bands, pooling_size / 2**level) for level, bands in enumerate(groups[1:])]
        return groups, low[-1], [samplers[0], *samplers]

    def _maker(self, channels):
        maker = self.pyramid_maker
        if maker is None or (maker.n_channels, maker.n_orientations) != (channels, self.n_orientations):
            self.pyramid_maker = SpatialSteerablePyramid(
                False, channels, 5, self.n_orientations, "cropped", self.device
            )
        return self.pyramid_maker
