"""A loss that asks only for what the eye can tell apart: pooled statistics away from the gaze, the picture at it."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import nn
from torch.nn import functional

from odak import _validate
from odak.learn._tensors import checked_device
from odak.learn.perception import pyramid_statistics as statistics
from odak.learn.perception.foveation import _growth, _point, make_radial_map
from odak.learn.perception.pooled_distance import as_maps
from odak.learn.perception.radially_varying_blur import RadiallyVaryingBlur
from odak.learn.perception.spatial_steerable_pyramid import SpatialSteerablePyramid, pad_image_for_pyramid

RESOLVED = 1e-6
FOVEA_SHARPNESS = 10
RADIAL_OFFSET, RADIAL_POWER = 1.1, 4


class MetamericLoss(nn.Module):
    """Distance between two pictures as an eye with one gaze sees them.

    Away from the gaze only means and standard deviations of steerable bands count, over regions that grow with
    eccentricity. Around it pixels count.

    Parameters
    ----------
    device : torch.device
        Where the loss is first; results follow their inputs.
    alpha : float
        Growth of the pooling regions with eccentricity. Set it once; then describe each display by the next two.
    real_image_width, real_viewing_distance : float
        Width of the picture as shown and distance of the eye from its centre, in one unit.
    n_pyramid_levels : int
        Levels of the pyramid, at least 2.
    mode : str
        "quadratic" or "linear" growth.
    n_orientations : int
        Orientations of the bands.
    use_l2_foveal_loss : bool
        Add `fovea_weight` times the mean squared error in Y′CrCb around the gaze, where statistics then do not count.
    fovea_weight : float
        Weight of that error.
    use_radial_weight : bool
        Weight statistics by 1.1 − r⁴, r being the distance from the gaze, at most 1.
    use_fullres_l0 : bool
        Compare the blurred picture at full resolution instead of the last low-pass; not with `use_l2_foveal_loss`.
    equi : bool
        Pictures are equirectangular; the gaze is then (yaw, pitch) in radians.

    Attributes
    ----------
    target_stats, fovea_mask, periphery_mask, loss_map
        Of the last call.
    pyramid_maker, blurs
        The pyramid and, for each level, its blur; None before the first use.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range or two exclude one another.

    Notes
    -----
    Walton et al., ACM Trans. Graph. 40, 48 (2021), and IEEE VR (2022). Statistics of the target are kept as long as the
    same unchanged tensor comes with the same gaze and parameters.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import MetamericLoss
    >>> loss = MetamericLoss(real_image_width=0.6, real_viewing_distance=0.7)
    >>> target = torch.rand(1, 3, 64, 64)
    >>> float(loss(target, target, gaze=[0.7, 0.3]))
    0.0
    """

    _place: torch.Tensor

    def __init__(
        self,
        device: torch.device | str = "cpu",
        alpha: float = 0.2,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        n_pyramid_levels: int = 5,
        mode: str = "quadratic",
        n_orientations: int = 2,
        use_l2_foveal_loss: bool = True,
        fovea_weight: float = 20.0,
        use_radial_weight: bool = False,
        use_fullres_l0: bool = False,
        equi: bool = False,
    ) -> None:
        super().__init__()
        use_l2_foveal_loss = _validate.flag("use_l2_foveal_loss", use_l2_foveal_loss)
        use_fullres_l0 = _validate.flag("use_fullres_l0", use_fullres_l0)
        if use_l2_foveal_loss and use_fullres_l0:
            raise ValueError("use_l2_foveal_loss and use_fullres_l0 exclude one another, got both")
        self.register_buffer("_place", torch.empty(0, device=checked_device("device", device)), persistent=False)
        self.alpha, self.mode = _growth(alpha, mode)
        self.real_image_width = _validate.number("real_image_width", real_image_width, positive=True)
        self.real_viewing_distance = _validate.number("real_viewing_distance", real_viewing_distance, positive=True)
        self.n_pyramid_levels = _validate.integer("n_pyramid_levels", n_pyramid_levels, minimum=2)
        self.n_orientations = _validate.integer("n_orientations", n_orientations, minimum=1)
        self.use_l2_foveal_loss, self.use_fullres_l0 = use_l2_foveal_loss, use_fullres_l0
        self.fovea_weight = _validate.number("fovea_weight", fovea_weight)
        self.use_radial_weight = _validate.flag("use_radial_weight", use_radial_weight)
        self.equi = _validate.flag("equi", equi)
        self.pyramid_maker: SpatialSteerablePyramid | None = None
        self.blurs: nn.ModuleList | None = None
        self.target_stats: Any = None
        self.fovea_mask = self.periphery_mask = None
        self.loss_map: torch.Tensor | None = None
        self._kept = statistics.TargetCache()
        self._masks: tuple | None = None

    @property
    def device(self) -> torch.device:
        """Where the loss was last moved to."""
        return self._place.device

    def forward(
        self,
        image: torch.Tensor,
        target: torch.Tensor,
        gaze: Sequence[float] = (0.5, 0.5),
        image_colorspace: str = "RGB",
        visualise_loss: bool = False,
    ) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            ``[B, C, H, W]`` of one shape, one or three channels, about 0 … 1.
        gaze : sequence of float
            (x, y), 0 to 1 from the top-left corner; beside the picture is legal.
        image_colorspace : str
            "RGB", or anything else if both pictures are in Y′CrCb already.
        visualise_loss : bool
            Keep a map of the differences as `loss_map`.

        Returns
        -------
        torch.Tensor
            Without axes, differentiable; 0 for equal pictures.

        Raises
        ------
        ValueError, TypeError
            If the pictures cannot be compared or are too small for the pyramid.
        """
        statistics.checked_pictures("MetamericLoss", image, target, self.n_pyramid_levels)
        gaze, visualise_loss = _point("gaze", gaze), _validate.flag("visualise_loss", visualise_loss)
        key = (gaze, self._options(), image_colorspace, target.dtype)
        reference, self.target_stats, kept = self._kept.get(
            target, key, lambda: self._described(target, gaze, image_colorspace)
        )
        image = self._converted(image, image_colorspace)
        if kept is None or visualise_loss or self.use_radial_weight or not statistics.is_blocked(image):
            stats = self.calc_statsmaps(image, gaze, *self._geometry())
            if visualise_loss:
                self.visualise_loss_map(stats)
            loss = self.metameric_loss_stats(stats, self.target_stats, gaze)
        else:
            loss = self._distance_from(kept, image, gaze)
        if self.use_l2_foveal_loss:
            loss = loss + self.fovea_weight * ((self.fovea_mask * (image - reference)) ** 2).mean()
        return loss

    def calc_statsmaps(
        self,
        image: torch.Tensor,
        gaze: Sequence[float] | None = None,
        alpha: float = 0.01,
        real_image_width: float = 0.3,
        real_viewing_distance: float = 0.6,
        mode: str = "quadratic",
        equi: bool = False,
    ) -> list[torch.Tensor]:
        """Return the pooled statistics of a picture.

        Parameters
        ----------
        image : torch.Tensor
            ``[B, C, H, W]``, sides multiples of 2ⁿ⁻¹ for n levels, in the colour space to compare in.
        gaze : sequence of float, optional
            (x, y), the picture's centre by default.
        alpha, real_image_width, real_viewing_distance, mode, equi
            As for the class.

        Returns
        -------
        list of torch.Tensor
            Mean and deviation of the high-pass residual and of each band, fine to coarse, and the last low-pass.

        Raises
        ------
        ValueError, TypeError
            If the picture does not fit the pyramid, or an argument makes no map.
        """
        equi = _validate.flag("equi", equi) or self.equi
        _validate.image("image", image, axes=4)
        gaze = _point("gaze", ((0.0, 0.0) if equi else (0.5, 0.5)) if gaze is None else gaze)
        geometry = (alpha, real_image_width, real_viewing_distance, gaze, mode, equi)
        groups, low, samplers = self._analysed(image, geometry)
        stats = statistics.pooled_statistics(groups, low, samplers)
        if self.use_fullres_l0:
            stats[-1] = samplers[0](image)
        masks = self._level_masks(image, geometry)
        return stats if masks is None else self._masked(stats, masks)

    def metameric_loss_stats(
        self, statsmap_a: list[torch.Tensor], statsmap_b: list[torch.Tensor], gaze: Sequence[float]
    ) -> torch.Tensor:
        """Return the mean over two lists of statistics of their mean squared differences.

        Parameters
        ----------
        statsmap_a, statsmap_b : list of torch.Tensor
            As :meth:`calc_statsmaps` returns them.
        gaze : sequence of float
            (x, y); counts with `use_radial_weight` only.

        Raises
        ------
        ValueError, TypeError
            If the lists are not statistics of pictures of one size.
        """
        gaze = _point("gaze", gaze)
        statsmap_a, statsmap_b = statistics.checked_statistics(statsmap_a=statsmap_a, statsmap_b=statsmap_b)
        if self.use_radial_weight:
            weights = {}
            for value in statsmap_a:
                size = tuple(value.shape[-2:])
                if size not in weights:
                    radius = make_radial_map(size, gaze, dtype=value.dtype, device=value.device)
                    weights[size] = RADIAL_OFFSET - radius**RADIAL_POWER
            statsmap_a, statsmap_b = (
                [value * weights[tuple(value.shape[-2:])] for value in stats] for stats in (statsmap_a, statsmap_b)
            )
        return statistics.mean_distance(statsmap_a, statsmap_b)

    def visualise_loss_map(self, image_stats: list[torch.Tensor]) -> None:
        """Keep the sum of the absolute differences from the last target's statistics as `loss_map` ``[B, H, W]``."""
        if self.target_stats is None:
            raise ValueError("visualise_loss_map needs the statistics of a target: call the loss first")
        maps = statistics.checked_statistics(image_stats=image_stats, target_stats=self.target_stats)
        self.loss_map = statistics.difference_map(*maps)

    def _apply(self, function, recurse=True):
        self._kept.clear()
        self._masks = None
        return super()._apply(function, recurse)

    def _options(self):
        names = "alpha real_image_width real_viewing_distance n_pyramid_levels mode n_orientations use_l2_foveal_loss"
        return tuple(getattr(self, name) for name in [*names.split(), "use_fullres_l0", "equi"])

    def _geometry(self):
        return self.alpha, self.real_image_width, self.real_viewing_distance, self.mode, self.equi

    def _converted(self, picture, colourspace):
        return statistics.converted(pad_image_for_pyramid(picture, self.n_pyramid_levels), colourspace)

    def _described(self, picture, gaze, colourspace):
        """Return a target padded and converted, its statistics, and these as :meth:`_distance_from` reads them.

        The last is None where they are not made in strips; otherwise both share their memory.
        """
        picture = self._converted(picture, colourspace)
        if not statistics.is_blocked(picture) or picture.requires_grad:
            return picture, self.calc_statsmaps(picture, gaze, *self._geometry()), None
        groups, samplers, masks, rest = self._parts(picture, gaze)
        values = statistics.masked_statistics(groups, samplers, masks)
        maps = [one for value, bands in zip(values, groups, strict=True) for one in as_maps(value, bands.shape)]
        return picture, [*maps, rest], [*values, rest]

    def _distance_from(self, kept, picture, gaze):
        """Return :meth:`metameric_loss_stats` of a picture and a target, computed in strips."""
        groups, samplers, masks, rest = self._parts(picture, gaze)
        return statistics.mean_distance_to(
            kept[:-1], groups, samplers, masks, functional.mse_loss(rest, kept[-1].expand_as(rest))
        )

    def _parts(self, picture, gaze):
        """Return the bands of a picture, what pools each group, their masks, and the masked map that is not pooled."""
        geometry = (*self._geometry()[:3], gaze, *self._geometry()[3:])
        groups, low, samplers = self._analysed(picture, geometry)
        masks = self._level_masks(picture, geometry) or [None] * self.n_pyramid_levels
        rest = samplers[0](picture) if self.use_fullres_l0 else low
        return groups, samplers, [masks[0], *masks[:-1]], rest if masks[-1] is None else masks[-1] * rest

    def _analysed(self, image, geometry):
        """Return the bands of a picture, its last low-pass, and what pools each group of bands."""
        maker, blurs = self._tools(image.shape[1])
        groups, low = maker.stacked_bands(image, self.n_pyramid_levels)
        samplers = [blur.sampler(bands, *geometry) for blur, bands in zip(blurs, groups[1:], strict=False)]
        return groups, low[-1], [samplers[0], *samplers]

    def _tools(self, channels):
        """Return the pyramid and the blurs, made anew where channels, orientations or levels have changed."""
        maker = self.pyramid_maker
        if maker is None or (maker.n_channels, maker.n_orientations) != (channels, self.n_orientations):
            self.pyramid_maker = SpatialSteerablePyramid(
                False, channels, 5, self.n_orientations, "cropped", self.device
            )
        if self.blurs is None or len(self.blurs) != self.n_pyramid_levels:
            self.blurs = nn.ModuleList(RadiallyVaryingBlur() for _ in range(self.n_pyramid_levels))
        return self.pyramid_maker, self.blurs

    def _level_masks(self, image, geometry):
        """Return, for each level, the share of each pixel's statistics that counts; None if all of it does."""
        if not (self.use_l2_foveal_loss or self.use_fullres_l0):
            return None
        key = (tuple(image.shape), geometry, self._options(), image.dtype, image.device)
        if self._masks is None or self._masks[0] != key:
            with torch.inference_mode(False), torch.no_grad():
                self._masks = (key, self._make_masks(image))
        return self._masks[1]

    def _make_masks(self, image):
        lod = [blur.lod_map for blur in self.blurs[:-1]]
        if self.use_fullres_l0:
            coarse = torch.ones((), dtype=image.dtype, device=image.device)
            return [*[(level > RESOLVED).to(image.dtype) for level in lod], coarse]
        resolved = lod[0] < RESOLVED
        fovea = (1 - lod[0] / lod[0].max().clamp_min(RESOLVED)) ** FOVEA_SHARPNESS
        fovea = torch.where(resolved, 1.0, fovea)
        self.fovea_mask, self.periphery_mask = fovea.expand(image.shape), (1 - fovea).expand(image.shape)
        masks = [1 - fovea]
        for _ in range(self.n_pyramid_levels - 1):
            halved = [side // 2 for side in masks[-1].shape]
            masks.append(functional.adaptive_avg_pool2d(masks[-1][None], halved)[0])
        return masks

    def _masked(self, stats, masks):
        counts = [2 * (self.n_orientations + 1), *[2 * self.n_orientations] * (self.n_pyramid_levels - 2), 1]
        levels = [level for level, count in enumerate(counts) for _ in range(count)]
        return [_fitting(masks[level], value) * value for level, value in zip(levels, stats, strict=True)]


def _fitting(mask, value):
    """Return a mask in the size of a map, which differs by a pixel where a side was odd."""
    if mask.ndim == 0 or mask.shape == value.shape[-2:]:
        return mask
    return functional.interpolate(mask[None, None], value.shape[-2:], mode="bilinear", align_corners=False)[0, 0]
