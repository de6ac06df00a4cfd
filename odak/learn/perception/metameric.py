"""Metameric losses: pooled statistics of two pictures' steerable pyramids, compared, or matched by a metamer."""

import math
from collections.abc import Callable, Hashable, Sequence
from functools import partial
from typing import Any, TypeVar

import torch
from torch import nn
from torch.nn import functional

from odak import _array, _torch_private, _validate
from odak._warnings import SamplingWarning, warn
from odak.learn._tensors import as_pictures, check_loss_inputs, check_range, checked_device, in_float32, kind_of
from odak.learn.perception.color import DIVIDED, ycrcb_2_rgb, ycrcb_of
from odak.learn.perception.foveation import (
    RadiallyVaryingBlur,
    UniformSampler,
    _growth,
    is_blocked,
    level_map,
    make_radial_map,
)
from odak.learn.perception.joint_statistics import STEEPNESS, descended, joint_maps
from odak.learn.perception.metamers import (
    CLIPPINGS,
    EARLIER_WARP,
    FEW_PIXELS,
    LARGEST_GAIN,
    METAMER_ITERATIONS,
    METAMER_ORIENTATIONS,
    OUTSIDE_WEIGHT,
    RESCALINGS,
    WARP,
    LocalGamut,
    detail_share,
    displaced,
    matched_noise,
    metamer_stages,
    rescaled,
)
from odak.learn.perception.pooled_statistics import (
    Pooling,
    as_maps,
    checked_statistics,
    local_statistics,
    mean_distance,
    mean_square,
    squared_distance,
    statistics_maps,
)
from odak.learn.perception.pyramids import SpatialSteerablePyramid, pad_image_for_pyramid
from odak.learn.perception.sight import (
    Gaze,
    Kept,
    Point,
    Seen,
    Viewing,
    each_of,
    gaze_at,
    geometry,
    parts_of,
    point,
    viewing_of,
)

RESOLVED = 1e-6
FOVEA_SHARPNESS = 10
RADIAL_OFFSET, RADIAL_POWER = 1.1, 4
# Smallest pooling region in pixels; smaller ones would take memory without an effect.
FINEST = 1 / 64


class _StatisticsLoss(nn.Module):
    """Base of the losses that compare the pooled statistics of two pictures' steerable pyramids.

    A subclass defines in `_pooling_of(picture, sizes, where)` how bands are pooled; `where` holds its parameters.
    """

    _place: torch.Tensor

    use_radial_weight = use_fullres_l0 = False

    def __init__(self, device, n_pyramid_levels, n_orientations, trust_target, nominal_width, joint) -> None:
        super().__init__()
        self.nominal_width = _validate.flag("nominal_width", nominal_width)
        self.joint = _validate.flag("joint", joint)
        self.register_buffer("_place", torch.empty(0, device=checked_device("device", device)), persistent=False)
        self.n_pyramid_levels = _validate.integer("n_pyramid_levels", n_pyramid_levels, minimum=2)
        self.n_orientations = _validate.integer("n_orientations", n_orientations, minimum=1)
        self.pyramid_maker: SpatialSteerablePyramid | None = None
        self.target_stats: Any = None
        self.loss_map: torch.Tensor | None = None
        self._kept, self._poolings = TargetCache(trust_target), Kept()
        self._pooling: Pooling | None = None

    @property
    def device(self) -> torch.device:
        """Device of the loss."""
        return self._place.device

    def visualise_loss_map(self, image_stats: list[torch.Tensor]) -> None:
        """Keep the sum of the absolute differences from the last target's statistics as `loss_map` ``[B, H, W]``."""
        if self.target_stats is None:
            raise ValueError("visualise_loss_map needs the statistics of a target: call the loss first")
        one, two = checked_statistics(image_stats=image_stats, target_stats=self.target_stats)
        size = one[0].shape[-2:]
        differences = [(a[:, :1] - b[:, :1]).abs() for a, b in zip(one, two, strict=True)]
        enlarged = [functional.interpolate(d, size, mode="bilinear", align_corners=False) for d in differences]
        self.loss_map = torch.stack(enlarged).sum(0)[:, 0]

    def _parts(self, picture, where, pairs=True):
        """Return bands of each level, the high-pass residual first, their pooling, and maps compared without it.

        The first of these is the last low-pass; statistics of pairs follow if the loss has them and `pairs` is set.
        """
        groups, low = self._maker(picture.shape[1])._levels(picture, self.n_pyramid_levels)
        key = (picture.shape, where, self._options(), picture.dtype, picture.device)
        pooling = self._poolings.get(key, lambda: self._pooling_of(picture, [one.shape[-2:] for one in low], where))
        if pooling is not self._pooling:
            self._pooling = pooling
        rest = pooling.samplers[0](picture) if self.use_fullres_l0 else low[-1]
        others = [rest if pooling.last is None else pooling.last * rest]
        if self.joint and pairs:
            maps = joint_maps([groups[0][:, :, 1:], *groups[1:]], low, pooling.samplers, self._maker(low[0].shape[1]))
            for found, mask in zip(maps, pooling.masks, strict=True):
                others += found if mask is None else [mask * one for one in found]
        return groups, pooling, others

    def _pooling_of(self, picture, sizes, where):
        """Return the :class:`Pooling` of pictures like one, with levels of these sizes."""
        raise NotImplementedError(f"{type(self).__name__} must define _pooling_of(picture, sizes, where)")

    def _statistics(self, picture, where):
        """Return the statistics of a picture after checking that it fits the pyramid."""
        self._maker(_validate.image("image", picture, axes=4).shape[1])._check(picture, self.n_pyramid_levels)
        return statistics_maps(*self._parts(picture, where))

    def _apply(self, function, recurse=True):
        self._kept.clear()
        self._poolings.clear()
        return super()._apply(function, recurse)

    def _converted(self, picture, colourspace):
        """Return a picture padded for the pyramid and, if it is RGB, converted to Y′CrCb."""
        if any(side % (1 << self.n_pyramid_levels) for side in picture.shape[-2:]):
            picture = pad_image_for_pyramid(picture, self.n_pyramid_levels)
        # Half precision would lose the digits of deviations, which are differences of means.
        picture = in_float32(picture)
        return ycrcb_of(picture) if picture.shape[1] == 3 and colourspace.strip().casefold() == "rgb" else picture

    def _options(self):
        """Return all that the statistics of a picture depend on besides the place."""
        return self.n_pyramid_levels, self.n_orientations, self.nominal_width, self.joint

    def _against(self, image, target, where, colourspace, visualise, index=0, *gaze):
        """Return the loss of the part `index` of a batch, its picture as it was compared, and its target."""
        _validate.instance("image_colorspace", colourspace, str, "a string")
        parameters = where, self._options(), colourspace
        found = self._kept.get(target, parameters, lambda: self._target_statistics(target, colourspace, where), index)
        reference, statistics, kept = found
        if self.target_stats is not statistics:
            self.target_stats = statistics
        image = self._converted(image, colourspace)
        if kept is not None and not (visualise or self.use_radial_weight) and is_blocked(image):
            return self._distance(image, kept, where), image, reference
        stats = statistics_maps(*self._parts(image, where))
        if visualise:
            self.visualise_loss_map(stats)
        return self.metameric_loss_stats(stats, self.target_stats, *gaze), image, reference

    def _target_statistics(self, picture, colourspace, where):
        """Return a target padded and converted, its statistics, and these in the form that :meth:`_distance` takes.

        The last is None where they are not computed in strips; otherwise both share their memory.
        """
        check_range(f"{type(self).__name__} ERROR: target", picture, remedy=DIVIDED)
        picture = self._converted(picture, colourspace)
        groups, pooling, others = self._parts(picture, where)
        if not is_blocked(picture) or picture.requires_grad:
            return picture, statistics_maps(groups, pooling, others), None
        values = [local_statistics(bands, sampler) for bands, sampler in zip(groups, pooling.samplers, strict=True)]
        for value, mask in zip(values, pooling.masks, strict=True):
            if mask is not None:
                value.mul_(mask[:, None, None])
        maps = [one for value, bands in zip(values, groups, strict=True) for one in as_maps(value, bands.shape)]
        return picture, [*maps, *others], (values, others)

    def _distance(self, picture, kept, where, pairs=True):
        """Return the mean distance of a picture's statistics from a target's, computed in strips."""
        groups, pooling, others = self._parts(picture, where, pairs)
        values, wanted = kept
        total = squared_distance(groups, pooling, values)
        for one, two in zip(others, wanted, strict=False):
            total = total + mean_square(one - two)
        return total / (2 * sum(bands.shape[2] for bands in groups) + len(others))

    def _maker(self, channels):
        """Return the pyramid, constructed again where channels or orientations have changed."""
        maker = self.pyramid_maker
        if maker is None or (maker.n_channels, maker.n_orientations) != (channels, self.n_orientations):
            maker = SpatialSteerablePyramid(False, channels, 5, self.n_orientations, "cropped", self.device)
            self.pyramid_maker = maker
        return maker

    def _metamer(self, image, where, levels, seed, iterations, progress, earlier=False):
        """Return a picture with the pooled statistics of an RGB or grey one: displaced, rescaled, then descent.

        `levels` is the MIP level of the pooling region of each pixel; colours stay within the range that the picture
        has there.
        """
        iterations = _validate.integer("iterations", iterations)
        _validate.function_or_none("progress", progress)
        if not image.numel():
            raise ValueError(f"image must not be empty, got {tuple(image.shape)}")
        with _torch_private.keeping(), torch.no_grad():
            padded, statistics, kept = self._target_statistics(image.detach().clone(), "RGB", where)
            maker = self._maker(image.shape[1])
            if iterations:
                pooling = levels(padded.shape[-2:])
                if (largest := 2 ** float(pooling.max())) < FEW_PIXELS:
                    warn(
                        f"pooling regions are {largest:.2g} pixels wide at most, so that the metamer is nearly the "
                        "picture: use a picture of more pixels, or one that is shown larger",
                        SamplingWarning,
                    )
                gamut = LocalGamut(padded, pooling, min(0.0, float(image.min())), max(1.0, float(image.max())))

                def distance(picture, pairs):
                    if kept is not None and is_blocked(picture):
                        return self._distance(picture, kept, where, pairs)
                    found = statistics_maps(*self._parts(picture, where, pairs))
                    return mean_distance(found, statistics[: len(found)])

                warp = EARLIER_WARP if earlier else WARP
                start = metamer = displaced(padded, pooling, 1 << (self.n_pyramid_levels - 1), seed, warp)
                share = 1.0 if earlier else detail_share(start)

                def held(picture):
                    return gamut.clipped(picture if earlier else start + share * (picture - start))

                for _ in range(RESCALINGS):
                    metamer = held(metamer)
                    groups, *rest = self._parts(metamer, where, pairs=False)
                    metamer = rescaled(groups, statistics_maps(groups, *rest), statistics, maker, LARGEST_GAIN)
                for pairs, count in metamer_stages(iterations, self.joint):
                    compared = partial(distance, pairs=pairs)
                    # Without weights, the descent of pairs ends at two to three times the distance.
                    steepness = STEEPNESS if self.joint else 0.0
                    metamer = descended(metamer, held, compared, count, progress, steepness, OUTSIDE_WEIGHT)
                for _ in range(CLIPPINGS):
                    metamer = gamut.clipped(metamer)
            else:
                metamer = matched_noise(padded, statistics, maker, self.n_pyramid_levels, seed)
        metamer = metamer[..., : image.shape[-2], : image.shape[-1]]
        return (ycrcb_2_rgb(metamer) if image.shape[1] == 3 else metamer).to(image.dtype)


class MetamericLoss(_StatisticsLoss, Seen):
    """Difference of two pictures for a fixed gaze, by their pooled statistics.

    Away from the gaze only means and standard deviations of steerable bands count, over regions that grow with
    eccentricity. Around it pixels count.

    Parameters
    ----------
    device : torch.device
        Where the loss is first; results follow their inputs.
    alpha : float
        Growth of the pooling regions with eccentricity. Set it once; then describe each display by the next two.
    real_image_width : float
        Width of the picture as shown.
    real_viewing_distance : float
        Distance of the eye from the picture's centre, in the same unit.
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
    trust_target : bool
        Take a target at the same address for unchanged, unless torch counted a change to it, instead of comparing its
        values with the previous ones. On a GPU values are never compared, and the target's statistics are computed
        at every call unless this is set.
    nominal_width : bool
        Pool over regions with the standard deviation of a square of the pooling size. False keeps regions that are 1.7
        to 1.9 times as wide, because a square of the size is enlarged bilinearly.
    joint : bool
        Compare statistics of pairs of bands too, across channels, orientations, scales and neighbours, which keep edges
        and corners: :func:`odak.learn.perception.joint_statistics.joint_maps`. Takes several times as long; meant for
        four orientations.
    viewing : Viewing, optional
        Geometry and gaze, instead of the two lengths.

    Attributes
    ----------
    viewing : Viewing
        How pictures are seen.
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
    Walton et al., ACM Trans. Graph. 40, 48 (2021), and IEEE VR (2022). Statistics of the target are kept as long as a
    target of the same values comes with the same gaze and parameters.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import MetamericLoss
    >>> loss = MetamericLoss(real_image_width=0.6, real_viewing_distance=0.7)
    >>> target = torch.rand(1, 3, 64, 64)
    >>> float(loss(target, target, gaze=[0.7, 0.3]))
    0.0
    """

    alpha: float
    mode: str

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
        trust_target: bool = False,
        nominal_width: bool = False,
        joint: bool = False,
        *,
        viewing: Viewing | None = None,
    ) -> None:
        super().__init__(device, n_pyramid_levels, n_orientations, trust_target, nominal_width, joint)
        self.use_l2_foveal_loss: bool = _validate.flag("use_l2_foveal_loss", use_l2_foveal_loss)
        self.use_fullres_l0: bool = _validate.flag("use_fullres_l0", use_fullres_l0)
        if use_l2_foveal_loss and use_fullres_l0:
            raise ValueError("use_l2_foveal_loss and use_fullres_l0 exclude one another, got both")
        self.alpha, self.mode = _growth(alpha, mode)
        self.viewing: Viewing = viewing_of(viewing, real_image_width, real_viewing_distance)
        self.fovea_weight: float = _validate.number("fovea_weight", fovea_weight)
        self.use_radial_weight: bool = _validate.flag("use_radial_weight", use_radial_weight)
        self.equi: bool = _validate.flag("equi", equi)
        self.blurs: nn.ModuleList | None = None

    @property
    def fovea_mask(self) -> torch.Tensor | None:
        """Weight of each pixel near the gaze of the last call ``[B, C, H, W]``."""
        return None if self._pooling is None else self._pooling.fovea

    @property
    def periphery_mask(self) -> torch.Tensor | None:
        """Weight of each other pixel of the last call ``[B, C, H, W]``."""
        return None if self._pooling is None else self._pooling.periphery

    def forward(
        self,
        image: torch.Tensor,
        target: torch.Tensor,
        gaze: Gaze | None = None,
        image_colorspace: str = "RGB",
        visualise_loss: bool = False,
    ) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            ``[B, C, H, W]`` of one shape, one or three channels, about 0 … 1.
        gaze : sequence of float, optional
            (x, y), 0 to 1 from the top-left corner; it may lie outside the picture. Or ``[B, 2]``, one for each picture
            of the batch, such as frames of a video with the track of an eye; maps and statistics are then kept for each
            of them. By default that of the viewing.
        image_colorspace : str
            "RGB", or anything else if both pictures are in Y′CrCb already.
        visualise_loss : bool
            Keep a map of the differences as `loss_map`.

        Returns
        -------
        torch.Tensor
            Without axes, differentiable, float32 of half precision; 0 for equal pictures.

        Raises
        ------
        ValueError, TypeError
            If the pictures cannot be compared or are too small for the pyramid.
        """
        checked_pictures("MetamericLoss", image, target, self.n_pyramid_levels)
        visualise_loss = _validate.flag("visualise_loss", visualise_loss)
        gazes = each_of(self._gaze(gaze, len(image)))
        self._poolings.room = len(gazes)
        pairs = zip(parts_of(image, gazes), parts_of(target, gazes), strict=True)
        values = [
            self._compared(one, two, place, index, image_colorspace, visualise_loss)
            for index, ((one, place), (two, _)) in enumerate(pairs)
        ]
        if visualise_loss:
            self.loss_map = torch.cat([shown for _, shown in values])
        return values[0][0] if len(values) == 1 else torch.stack([value for value, _ in values]).mean()

    def _compared(self, image, target, gaze, index, image_colorspace, visualise_loss):
        """Return the loss of pictures with one gaze, the part `index` of a batch, and the map of the differences."""
        where = self._where(gaze)
        loss, image, reference = self._against(image, target, where, image_colorspace, visualise_loss, index, gaze)
        if self.use_l2_foveal_loss:
            loss = loss + self.fovea_weight * mean_square(self.fovea_mask * (image - reference))
        return loss, self.loss_map

    def calc_statsmaps(
        self,
        image: torch.Tensor,
        gaze: Sequence[float] | None = None,
        alpha: float = 0.01,
        real_image_width: float = 0.3,
        real_viewing_distance: float = 0.6,
        mode: str = "quadratic",
        equi: bool = False,
        *,
        viewing: Viewing | None = None,
    ) -> list[torch.Tensor]:
        """Return the pooled statistics of a picture.

        Parameters
        ----------
        image : torch.Tensor
            ``[B, C, H, W]``, sides multiples of 2ⁿ⁻¹ for n levels, in the colour space to compare in.
        gaze : sequence of float, optional
            (x, y), the picture's centre by default.
        alpha : float
            Growth of the pooling regions with eccentricity.
        real_image_width : float
            Width of the picture as shown.
        real_viewing_distance : float
            Distance of the eye from the picture's centre, in the same unit.
        mode : str
            "quadratic" or "linear" growth.
        equi : bool
            The picture is equirectangular.
        viewing : Viewing, optional
            Geometry and, without `gaze`, gaze, instead of the two lengths.

        Returns
        -------
        list of torch.Tensor
            Mean and deviation of the high-pass residual and of each band, fine to coarse, the last low-pass, and with
            `joint` the statistics of pairs.

        Raises
        ------
        ValueError, TypeError
            If the picture does not fit the pyramid, or an argument makes no map.
        """
        equi = _validate.flag("equi", equi) or self.equi
        gaze = gaze_at(viewing, gaze)
        gaze = point("gaze", ((0.0, 0.0) if equi else (0.5, 0.5)) if gaze is None else gaze)
        view = _validate.constants(real_image_width=real_image_width, real_viewing_distance=real_viewing_distance)
        view = map(float, geometry(viewing, *view))
        where = (_validate.constant("alpha", alpha), *view, gaze, mode, equi)
        return self._statistics(image, where)

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
        gaze = point("gaze", gaze)
        statsmap_a, statsmap_b = checked_statistics(statsmap_a=statsmap_a, statsmap_b=statsmap_b)
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
        return mean_distance(statsmap_a, statsmap_b)

    def _options(self):
        return *super()._options(), self.use_l2_foveal_loss, self.use_fullres_l0

    def _where(self, gaze: Point):
        alpha = self.alpha if type(self.alpha) is float else _validate.constant("alpha", self.alpha)
        return alpha, self.viewing.real_image_width, self.viewing.real_viewing_distance, gaze, self.mode, self.equi

    def _pooling_of(self, picture, sizes, where):
        kept = self.blurs
        if kept is None or len(kept) != self.n_pyramid_levels or kept[0].nominal_width != self.nominal_width:
            self.blurs = nn.ModuleList(RadiallyVaryingBlur(self.nominal_width) for _ in sizes)
        levels = zip(self.blurs, sizes[:-1], strict=False)
        samplers = [blur.sampler(picture[..., : size[0], : size[1]], *where) for blur, size in levels]
        if not (self.use_l2_foveal_loss or self.use_fullres_l0):
            return Pooling(samplers, [None] * len(samplers))
        with _torch_private.keeping(), torch.no_grad():
            maps = [blur.lod_map for blur in self.blurs[:-1]]
            if self.use_fullres_l0:
                return Pooling(samplers, [(level > RESOLVED).to(picture.dtype) for level in maps])
            fovea = (1 - maps[0] / maps[0].max().clamp_min(RESOLVED)) ** FOVEA_SHARPNESS
            fovea = torch.where(maps[0] < RESOLVED, 1.0, fovea)
            masks = [1 - fovea]
            for size in sizes[1:]:
                masks.append(functional.adaptive_avg_pool2d(masks[-1][None], size)[0])
            around = [mask.expand(picture.shape) for mask in (fovea, masks[0])]
            return Pooling(samplers, masks[:-1], masks[-1], *around)


class MetamericLossUniform(_StatisticsLoss):
    """Difference of the pooled statistics of two pictures, with pooling regions of one size everywhere.

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
    trust_target : bool
        Take a target at the same address for unchanged, unless torch counted a change to it, instead of comparing its
        values with the previous ones. On a GPU values are never compared, and the target's statistics are computed
        at every call unless this is set.
    nominal_width : bool
        Pool over regions with the standard deviation of a square of the pooling size. False keeps regions that are 1.7
        to 1.9 times as wide, because a square of the size is enlarged bilinearly.
    joint : bool
        Compare statistics of pairs of bands too, across channels, orientations, scales and neighbours, which keep edges
        and corners: :func:`odak.learn.perception.joint_statistics.joint_maps`. Takes several times as long; meant for
        four orientations.

    Attributes
    ----------
    target, target_stats, loss_map, pyramid_maker
        Of the last call; None before.

    Notes
    -----
    See :class:`odak.learn.perception.MetamericLoss`; statistics of the target are kept in the same way.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import MetamericLossUniform
    >>> loss = MetamericLossUniform(pooling_size=8, n_pyramid_levels=2)
    >>> picture = torch.rand(1, 3, 32, 32)
    >>> loss(picture, picture).item()
    0.0
    """

    def __init__(
        self,
        device: torch.device | str = "cpu",
        pooling_size: float = 32,
        n_pyramid_levels: int = 5,
        n_orientations: int = 2,
        trust_target: bool = False,
        nominal_width: bool = False,
        joint: bool = False,
    ) -> None:
        super().__init__(device, n_pyramid_levels, n_orientations, trust_target, nominal_width, joint)
        self.pooling_size: float = _validate.number("pooling_size", pooling_size, positive=True, least=FINEST)
        self.target: torch.Tensor | None = None

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
            Without axes, differentiable, float32 of half precision; 0 for equal pictures.

        Raises
        ------
        ValueError, TypeError
            If the pictures cannot be compared or are too small for the pyramid.
        """
        checked_pictures("MetamericLossUniform", image, target, self.n_pyramid_levels)
        visualise_loss, where = _validate.flag("visualise_loss", visualise_loss), self.pooling_size
        loss, _, self.target = self._against(image, target, where, image_colorspace, visualise_loss)
        return loss

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
            Mean and deviation of the high-pass residual and of each band, fine to coarse, the last low-pass, and with
            `joint` the statistics of pairs.

        Raises
        ------
        ValueError, TypeError
            If the picture does not fit the pyramid, or the size is below 1/64.
        """
        size = _validate.constant("pooling_size", pooling_size, positive=True, least=FINEST)
        return self._statistics(image, size)

    def metameric_loss_stats(self, statsmap_a: list[torch.Tensor], statsmap_b: list[torch.Tensor]) -> torch.Tensor:
        """Return the mean squared difference of two lists of statistics, averaged over the list.

        Parameters
        ----------
        statsmap_a : list of torch.Tensor
            Statistics of the first image.
        statsmap_b : list of torch.Tensor
            Statistics of the second image, of the same number and shapes.
        """
        return mean_distance(*checked_statistics(statsmap_a=statsmap_a, statsmap_b=statsmap_b))

    def visualise_loss_map(self, image_stats: list[torch.Tensor]) -> None:
        """Store the sum of absolute differences from the target's statistics as `loss_map` ``[H, W]``.

        Parameters
        ----------
        image_stats : list of torch.Tensor
            Statistics of the image.
        """
        super().visualise_loss_map(image_stats)
        self.loss_map = None if self.loss_map is None else self.loss_map[0]

    def gen_metamer(
        self,
        image: torch.Tensor,
        seed: int = 0,
        iterations: int = METAMER_ITERATIONS,
        progress: Callable[[], object] | None = None,
    ) -> torch.Tensor:
        """Return another picture with the pooled statistics of a picture, in at least four orientations.

        Parameters
        ----------
        image : torch.Tensor
            RGB or grey ``[B, C, H, W]``, about 0 … 1.
        seed : int
            Seed of the displacements that it starts from, or of the noise.
        iterations : int
            Evaluations of the distance between the statistics, which L-BFGS makes smaller; 0 for matched noise. With
            `joint` the statistics of single bands are matched first: :func:`metamer_stages`.
        progress : callable, optional
            Called without arguments at each evaluation.

        Returns
        -------
        torch.Tensor
            ``[B, C, H, W]``. With iterations its colours lie within the local gamut of the picture
            (:class:`LocalGamut`) and within RGB of 0 … 1; matched noise is not clipped.

        Raises
        ------
        ValueError, TypeError
            If the picture is too small for the pyramid, or no picture.

        Examples
        --------
        The statistics agree, the pixels do not:

        >>> import torch
        >>> from odak.learn.perception import MetamericLossUniform
        >>> loss = MetamericLossUniform(pooling_size=8, n_pyramid_levels=3)
        >>> picture = torch.rand(1, 1, 32, 32, generator=torch.Generator().manual_seed(0))
        >>> metamer = loss.gen_metamer(picture)
        >>> loss(metamer, picture).item() < 1e-3, (metamer - picture).abs().mean().item() > 0.05
        (True, True)
        """
        checked_pictures("MetamericLossUniform", image, image, self.n_pyramid_levels)
        level = max(0.0, math.log2(self.pooling_size))
        levels = partial(torch.full, fill_value=level, dtype=torch.float64, device=image.device)
        count, options = max(self.n_orientations, METAMER_ORIENTATIONS), (False, self.nominal_width, self.joint)
        maker = MetamericLossUniform(self.device, self.pooling_size, self.n_pyramid_levels, count, *options)
        return maker._metamer(image, self.pooling_size, levels, seed, iterations, progress)

    def _pooling_of(self, picture, sizes, where):
        samplers = [
            _uniform_sampler(picture[..., :rows, :columns], where / 2**level, self.nominal_width)
            for level, (rows, columns) in enumerate(sizes[:-1])
        ]
        return Pooling(samplers, [None] * len(samplers))


def uniform_blur(image: torch.Tensor, pooling_size: float, nominal_width: bool = False) -> torch.Tensor:
    """Return means over squares, enlarged bilinearly to the picture's size.

    Parameters
    ----------
    image : torch.Tensor
        ``[B, C, H, W]``.
    pooling_size : float
        Side of the squares in pixels, at least 1/64; at least one square fits always.
    nominal_width : bool
        Take smaller squares, so that the kernel, a square enlarged bilinearly, has the standard deviation of a square
        of the pooling size. False takes squares of that size, whose kernel is 1.7 times as wide.

    Returns
    -------
    torch.Tensor
        ``[B, C, H, W]``.

    Raises
    ------
    ValueError, TypeError
        If the picture has not four axes, or the size is below 1/64.

    Examples
    --------
    The mean is kept:

    >>> import torch
    >>> from odak.learn.perception import uniform_blur
    >>> picture = torch.zeros(1, 1, 16, 16)
    >>> picture[..., 8:] = 1
    >>> round(uniform_blur(picture, 4.0).mean().item(), 6)
    0.5
    """
    if as_pictures("image", image, None).ndim != 4 or 0 in _validate.image("image", image, axes=4).shape:
        raise ValueError(f"image must be [B, C, H, W], none empty, got {tuple(image.shape)}")
    size = _validate.constant("pooling_size", pooling_size, positive=True, least=FINEST)
    return _uniform_sampler(image, size, _validate.flag("nominal_width", nominal_width))(image)


def _uniform_sampler(image, pooling_size, nominal_width):
    size = tuple(image.shape[-2:])
    if nominal_width:
        # A square of n pixels has the variance (n² − 1)/12 along each axis; squares of m enlarged bilinearly, m²/4.
        pooling_size = max(1.0, math.sqrt(max(0.0, pooling_size**2 - 1) / 3))
    squares = tuple(max(1, int(side / pooling_size)) for side in size)
    return UniformSampler(size, squares, image.device, image.dtype)


def _of_the_metameric_loss(name: str) -> Any:
    """Return a property that is the attribute of the same name of the loss that makes the statistics."""
    return property(
        lambda self: getattr(self.metameric_loss, name), lambda self, value: setattr(self.metameric_loss, name, value)
    )


class MetamerMSELoss(Seen):
    """Mean squared difference of a picture from one metamer of the target.

    Parameters
    ----------
    device : torch.device
        Where the loss is first; results follow their inputs.
    alpha : float
        Growth of the pooling regions with eccentricity.
    real_image_width : float
        Width of the picture as shown.
    real_viewing_distance : float
        Distance of the eye from the picture's centre, in the same unit.
    mode : str
        "quadratic" or "linear" growth.
    n_pyramid_levels : int
        Levels of the pyramid, at least 2.
    n_orientations : int
        Orientations of the bands.
    equi : bool
        Pictures are equirectangular; the gaze is then (yaw, pitch) in radians.
    trust_target : bool
        Take a target at the same address for unchanged, unless torch counted a change to it, instead of comparing its
        values with the previous ones. On a GPU values are never compared, and the target's metamer is computed
        at every call unless this is set.
    iterations : int
        Evaluations of the metameric loss by which a metamer is made; 0 for matched noise.
    nominal_width : bool
        Pool over regions with the standard deviation of a square of the pooling size. False keeps regions that are 1.7
        to 1.9 times as wide, because a square of the size is enlarged bilinearly.
    joint : bool
        Compare statistics of pairs of bands too, across channels, orientations, scales and neighbours, which keep edges
        and corners: :func:`odak.learn.perception.joint_statistics.joint_maps`. Takes several times as long; meant for
        four orientations.
    viewing : Viewing, optional
        Geometry and gaze, instead of the two lengths.

    Attributes
    ----------
    viewing : Viewing
        How pictures are seen.
    alpha, real_image_width, real_viewing_distance, mode, n_pyramid_levels, n_orientations, equi, nominal_width, joint
        As given; a change counts from the next call on.
    target, target_metamer
        Of the last call; None before.
    metameric_loss : MetamericLoss
        Makes the statistics.
    loss_func : torch.nn.MSELoss
        The distance.

    Notes
    -----
    Equal pictures do not give 0: the target is one of its own metamers, but not the one that was drawn. So that values
    stay as in earlier versions, that metamer is made with the orientations of the loss and with displacements that
    vary faster, and keeps oblique lines less well than :meth:`gen_metamer` does. It is kept as long as a target of the
    same values comes with the same gaze and parameters.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import MetamerMSELoss
    >>> loss = MetamerMSELoss(n_pyramid_levels=2, iterations=0)
    >>> picture = torch.rand(1, 3, 64, 64)
    >>> loss(loss.gen_metamer(picture, [0.5, 0.5]), picture).item() >= 0
    True
    """

    alpha: float = _of_the_metameric_loss("alpha")
    mode: str = _of_the_metameric_loss("mode")
    equi: bool = _of_the_metameric_loss("equi")
    viewing: Viewing = _of_the_metameric_loss("viewing")
    n_pyramid_levels: int = _of_the_metameric_loss("n_pyramid_levels")
    n_orientations: int = _of_the_metameric_loss("n_orientations")
    nominal_width: bool = _of_the_metameric_loss("nominal_width")
    joint: bool = _of_the_metameric_loss("joint")

    def __init__(
        self,
        device: torch.device | str = "cpu",
        alpha: float = 0.2,
        real_image_width: float = 0.2,
        real_viewing_distance: float = 0.7,
        mode: str = "quadratic",
        n_pyramid_levels: int = 5,
        n_orientations: int = 2,
        equi: bool = False,
        trust_target: bool = False,
        iterations: int = METAMER_ITERATIONS,
        nominal_width: bool = False,
        joint: bool = False,
        *,
        viewing: Viewing | None = None,
    ) -> None:
        super().__init__()
        self.iterations: int = _validate.integer("iterations", iterations)
        self.metameric_loss: MetamericLoss = MetamericLoss(
            device=device,
            alpha=alpha,
            real_image_width=real_image_width,
            real_viewing_distance=real_viewing_distance,
            n_pyramid_levels=n_pyramid_levels,
            mode=mode,
            n_orientations=n_orientations,
            use_l2_foveal_loss=False,
            equi=equi,
            nominal_width=nominal_width,
            joint=joint,
            viewing=viewing,
        )
        self.loss_func: torch.nn.MSELoss = nn.MSELoss()
        self.target: Any = None
        self.target_metamer: Any = None
        self.noise: Any = None
        self._kept = TargetCache(trust_target)

    @property
    def device(self) -> torch.device:
        """Device of the loss."""
        return self.metameric_loss.device

    def gen_metamer(
        self,
        image: torch.Tensor,
        gaze: Gaze | None = None,
        seed: int = 0,
        iterations: int | None = None,
        progress: Callable[[], object] | None = None,
    ) -> torch.Tensor:
        """Return a metamer of a picture for a fixed gaze: a picture with the same pooled statistics.

        It is made by at least four orientations, also where the loss has fewer.

        Parameters
        ----------
        image : torch.Tensor
            RGB or grey ``[B, C, H, W]``, about 0 … 1.
        gaze : sequence of float, optional
            (x, y), 0 to 1 from the top-left corner; or ``[B, 2]``, one for each picture. By default that of the
            viewing.
        seed : int
            Seed of the noise that it starts from; equal input gives equal output.
        iterations : int, optional
            Evaluations of the distance between the statistics, which L-BFGS makes smaller; by default the
            number of the class, 0 for matched noise. With `joint` the statistics of single bands are matched first:
            :func:`metamer_stages`.
        progress : callable, optional
            Called without arguments at each evaluation.

        Returns
        -------
        torch.Tensor
            ``[B, C, H, W]``. Where single pixels are resolved it is the picture; elsewhere its colours lie within the
            local gamut of the picture (:class:`LocalGamut`) and within RGB of 0 … 1.

        Raises
        ------
        ValueError, TypeError
            If the picture is too small for the pyramid, or no picture.

        Notes
        -----
        It starts from the picture with its pixels displaced at random (:func:`displaced`), whose bands are then given
        local means and deviations. Bands overlap, so that the sum does not have them; L-BFGS then lowers the distance.
        Where the displaced picture is flat it stays as it is (:func:`detail_share`).
        From noise, as Walton et al. start, ACM Trans. Graph. 40, 48 (2021), section 4, pictures of hard edges end two
        to five times as far. Without iterations it is such noise.

        Examples
        --------
        Equal at the gaze, other pixels with equal statistics away from it:

        >>> import torch
        >>> from odak.learn.perception import MetamerMSELoss
        >>> maker = MetamerMSELoss(n_pyramid_levels=2, alpha=1.0, real_image_width=1.0)
        >>> picture = torch.rand(1, 1, 64, 64, generator=torch.Generator().manual_seed(0))
        >>> difference = (maker.gen_metamer(picture, [0.0, 0.5]) - picture).abs()
        >>> difference[..., 30:34, :4].max().item() < 1e-6, difference[..., 32:].mean().item() > 0.05
        (True, True)
        """
        kept = ("device", "alpha", "n_pyramid_levels", "mode", "equi", "nominal_width", "joint", "viewing")
        options = {name: getattr(self, name) for name in kept}
        options["n_orientations"] = max(self.n_orientations, METAMER_ORIENTATIONS)
        inner = MetamericLoss(**options, use_l2_foveal_loss=False)
        checked_pictures("MetamerMSELoss", image, image, inner.n_pyramid_levels)
        gazes = each_of(self._gaze(gaze, len(image)))
        drawn = [
            self._drawn(inner, False, one, place, seed, iterations, progress) for one, place in parts_of(image, gazes)
        ]
        return torch.cat(drawn)

    def _drawn(self, inner, earlier, image, gaze, seed=0, iterations=None, progress=None):
        """Return a metamer by the statistics of a loss."""
        check_range("MetamerMSELoss ERROR: target", image, remedy=DIVIDED)
        where = inner._where(gaze)
        kind = {"nominal_width": inner.nominal_width, "dtype": torch.float64, "device": image.device}

        def levels(size):
            return level_map(tuple(size), *where, **kind)

        iterations = self.iterations if iterations is None else iterations
        return inner._metamer(image, where, levels, seed, iterations, progress, earlier)

    def forward(self, image: torch.Tensor, target: torch.Tensor, gaze: Gaze | None = None) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image, target : torch.Tensor
            ``[B, C, H, W]`` of one shape, one or three channels, about 0 … 1.
        gaze : sequence of float, optional
            (x, y), 0 to 1 from the top-left corner; it may lie outside the picture. Or ``[B, 2]``, one for each picture
            of the batch, such as frames of a video with the track of an eye; maps and metamers are then kept for each
            of them. By default that of the viewing.

        Returns
        -------
        torch.Tensor
            Without axes, differentiable in the image. The metamer is treated as a constant.

        Raises
        ------
        ValueError, TypeError
            If the pictures cannot be compared or are too small for the pyramid.
        """
        inner = self.metameric_loss
        checked_pictures("MetamerMSELoss", image, target, inner.n_pyramid_levels)
        # Not compiled: gradient descent would amplify the rounding differences of a compiled graph.
        gazes = each_of(self._gaze(gaze, len(image)))
        self.target_metamer = _array.outside_graphs(self._metamers_of, target, gazes)
        return self.loss_func(image, self.target_metamer)

    def _metamers_of(self, target, gazes):
        inner = self.metameric_loss
        inner._poolings.room, made = len(gazes), []
        constant = _torch_private.as_constant(target)
        with _torch_private.outside_functional_transforms(constant):
            self.target = constant.detach()
            for index, (one, place) in enumerate(parts_of(self.target, gazes)):
                key = (inner._where(place), inner._options(), self.iterations)
                made.append(self._kept.get(one, key, partial(self._drawn, inner, True, one, place), index))
        return torch.cat(made) if len(made) > 1 else made[0]

    def _apply(self, function, recurse=True):
        self._kept.clear()
        return super()._apply(function, recurse)


def checked_pictures(name: str, image: torch.Tensor, target: torch.Tensor, n_levels: int) -> None:
    """Raise unless two pictures can be compared: one shape, the image finite and about 0 … 1, the pyramid not too high.

    Values of a target are checked where what is kept of it is computed.

    Parameters
    ----------
    name : str
        Name of the loss, with which a message begins.
    image, target : torch.Tensor
        ``[B, C, H, W]``. Values on a GPU are not read.
    n_levels : int
        Levels of the pyramid.

    Raises
    ------
    ValueError, TypeError
        If they cannot.
    """
    for label, picture in (("image", image), ("target", target)):
        if not isinstance(picture, torch.Tensor) or not picture.is_floating_point():
            kind = kind_of(picture)
            raise TypeError(f"{name} ERROR: {label} must be a tensor of real floats [B, C, H, W], got {kind}")
    check_loss_inputs(name, image, target)
    step = 1 << n_levels
    smallest = 7 << max(0, n_levels - 2)
    if any(-(-side // step) * step < smallest for side in image.shape[-2:]) or min(image.shape[-2:]) < 2:
        raise ValueError(
            f"{name} ERROR: image and target are too small: sides must be at least 2 and fill {n_levels} pyramid "
            f"levels, got {tuple(image.shape)}"
        )
    check_range(f"{name} ERROR: image", image, remedy=DIVIDED)


Result = TypeVar("Result")


class TargetCache:
    """Cache of what was last computed from each target, valid while the target and all parameters are the same.

    A copy of the target is kept and compared value by value, so that a buffer that was filled again is another target
    whoever wrote to it. Values on a GPU are not compared, because the host would have to wait for the answer: what
    depends on them is computed at every call.

    Parameters
    ----------
    trusting : bool
        Compare addresses and torch's count of changes instead of values, on every device. Changes that torch does not
        count (`.data`, memory shared with NumPy) go unseen.
    """

    def __init__(self, trusting: bool = False) -> None:
        self.trusting: bool = _validate.flag("trust_target", trusting)
        self.clear()

    def clear(self) -> None:
        """Drop the stored results."""
        self._stored: dict[int, tuple[Any, Any, Any]] = {}

    def get(self, target: torch.Tensor, parameters: Hashable, compute: Callable[[], Result], index: int = 0) -> Result:
        """Return `compute()`, or the stored result of this target and these parameters.

        Parameters
        ----------
        target : torch.Tensor
            Of these numbers the result is made. If it requires a gradient, nothing is kept.
        parameters : hashable
            Everything else that the result depends on.
        compute : callable
            Makes the result; without gradients if it is to be kept.
        index : int
            Which of the targets of a batch it is, each of which has a result of its own.
        """
        if target.requires_grad or target.is_inference() or _torch_private.is_transformed(target):
            return compute()
        key = (parameters, tuple(target.shape), target.dtype, target.device)
        if self.trusting:
            key = (*key, target.data_ptr(), target.stride(), _torch_private.count_of_writes(target))
        elif not _array.is_readable(target):
            with _torch_private.keeping(), torch.no_grad():
                return compute()
        stored, known, result = self._stored.get(index, (None, None, None))
        if key != known or not (self.trusting or torch.equal(target, stored)):
            # Tensors made in inference mode could not be used with autograd later.
            with _torch_private.keeping(), torch.no_grad():
                result = compute()
                # A trusted target is referenced, so that its memory cannot be reused.
                stored = target.detach() if self.trusting else target.detach().clone()
            self._stored[index] = stored, key, result
        return result
