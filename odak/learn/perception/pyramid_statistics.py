"""What the metameric losses share: checks, pooled statistics of pyramids, pictures made to have them, and a cache."""

from collections.abc import Callable, Hashable, Sequence
from typing import Any

import torch
from torch.nn import functional

from odak import _array, _validate
from odak.learn.perception.color_conversion import rgb_2_ycrcb, ycrcb_2_rgb
from odak.learn.perception.mip_sampling import Sampler
from odak.learn.perception.pixel_blocks import is_plain
from odak.learn.perception.pooled_distance import as_maps, local_statistics, pooled, squared_distance
from odak.learn.perception.spatial_steerable_pyramid import SpatialSteerablePyramid
from odak.learn.perception.util import check_loss_inputs, check_values

RMS_FLOOR = 1e-6


def checked_pictures(name: str, image: torch.Tensor, target: torch.Tensor, n_levels: int) -> None:
    """Raise unless two pictures can be compared: one shape, finite, about 0 … 1, large enough for the pyramid.

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
            raise TypeError(f"{name} ERROR: {label} must be a tensor of real floats [B, C, H, W]")
    check_loss_inputs(name, image, target)
    step = 1 << n_levels
    smallest = 7 << max(0, n_levels - 2)
    if any(-(-side // step) * step < smallest for side in image.shape[-2:]) or min(image.shape[-2:]) < 2:
        raise ValueError(
            f"{name} ERROR: image and target are too small: sides must be at least 2 and fill {n_levels} pyramid "
            f"levels, got {tuple(image.shape)}"
        )
    pictures: dict[str, Any] = {f"{name} ERROR: image": image, f"{name} ERROR: target": target}
    check_values(**pictures)


def checked_maps(name: str, value: Sequence[torch.Tensor]) -> list[torch.Tensor]:
    """Return statistics as a list after checking that they are tensors ``[B, C, H, W]``."""
    maps: list[Any] = list(value) if isinstance(value, (list, tuple)) else [None]
    if not maps or any(not isinstance(one, torch.Tensor) or one.ndim != 4 for one in maps):
        raise TypeError(f"{name} must be a list of tensors [B, C, H, W] as calc_statsmaps returns it")
    return maps


def checked_statistics(**lists: Sequence[torch.Tensor]) -> list[list[torch.Tensor]]:
    """Return two lists of statistics after checking that they come from pictures of one size."""
    checked = [checked_maps(name, value) for name, value in lists.items()]
    if [one.shape[-2:] for one in checked[0]] != [two.shape[-2:] for two in checked[1]]:
        raise ValueError(f"{' and '.join(lists)} must be statistics of pictures of one size and as many levels")
    return checked


def converted(image: torch.Tensor, colourspace: str) -> torch.Tensor:
    """Return a picture in Y′CrCb: RGB is converted, one channel and anything not named "RGB" stay as they are."""
    if not isinstance(colourspace, str):
        raise TypeError(f"image_colorspace must be a string, got {type(colourspace).__name__}")
    return rgb_2_ycrcb(image) if image.shape[1] == 3 and colourspace.upper() == "RGB" else image


def is_blocked(picture: torch.Tensor) -> bool:
    """Say whether statistics may be computed in strips: plain floats on a CPU, which no transform holds."""
    return is_plain(picture) and picture.dtype in (torch.float32, torch.float64)


def pooled_statistics(groups: list[torch.Tensor], low: torch.Tensor, samplers: Sequence[Sampler]) -> list[torch.Tensor]:
    """Return mean and standard deviation of a pyramid's bands, each over a pixel's pooling region.

    Parameters
    ----------
    groups : list of torch.Tensor
        Bands ``[B, C, K, H, W]`` as :meth:`SpatialSteerablePyramid.stacked_bands` makes them.
    low : torch.Tensor
        The last low-pass.
    samplers : sequence of Sampler
        Those that make the local means of each group.

    Returns
    -------
    list of torch.Tensor
        Mean and deviation of the high-pass residual, of each band of each level, and the last low-pass:
        2(1 + (n − 1)K) + 1 tensors ``[B, C, H, W]``.
    """
    maps = []
    for bands, sampler in zip(groups, samplers, strict=True):
        if is_blocked(bands) and not (bands.requires_grad and torch.is_grad_enabled()):
            maps.extend(as_maps(local_statistics(bands, sampler), bands.shape))
            continue
        for mean, deviation in zip(*(value.unbind(2) for value in pooled(bands, sampler)), strict=True):
            maps.extend((mean, deviation))
    return [*maps, low]


def masked_statistics(
    groups: list[torch.Tensor], samplers: Sequence[Sampler], masks: Sequence[torch.Tensor | None]
) -> list[torch.Tensor]:
    """Return the statistics of a target in the form in which :func:`mean_distance_to` compares with them.

    Parameters
    ----------
    groups, samplers
        As for :func:`pooled_statistics`.
    masks : sequence of torch.Tensor or None
        How much each pixel counts ``[H, W]``, for each group.

    Returns
    -------
    list of torch.Tensor
        ``[H, 2, B·C·K, W]`` for each group.
    """
    statistics = [local_statistics(bands, sampler) for bands, sampler in zip(groups, samplers, strict=True)]
    for values, mask in zip(statistics, masks, strict=True):
        if mask is not None:
            values.mul_(mask[:, None, None])
    return statistics


def mean_distance_to(
    target: list[torch.Tensor],
    groups: list[torch.Tensor],
    samplers: Sequence[Sampler],
    masks: Sequence[torch.Tensor | None],
    rest: torch.Tensor,
) -> torch.Tensor:
    """Return :func:`mean_distance` of a picture's masked statistics from a target's, without holding the picture's.

    Parameters
    ----------
    target : list of torch.Tensor
        As :func:`masked_statistics` returns it.
    groups, samplers, masks
        Of the picture.
    rest : torch.Tensor
        Mean squared difference of the maps that are not pooled.
    """
    count = 2 * sum(bands.shape[2] for bands in groups) + 1
    for values, bands, sampler, mask in zip(target, groups, samplers, masks, strict=True):
        rest = rest + squared_distance(bands, sampler, mask, values) / bands[:, :, 0].numel()
    return rest / count


def matched_noise(
    image: torch.Tensor, statistics: list[torch.Tensor], maker: SpatialSteerablePyramid, n_levels: int, seed: int = 0
) -> torch.Tensor:
    """Return noise whose pyramid has the pooled statistics of a picture, and the picture's low-pass.

    Parameters
    ----------
    image : torch.Tensor
        ``[B, C, H, W]``, as padded for the pyramid.
    statistics : list of torch.Tensor
        As :func:`pooled_statistics` returns them for the picture.
    maker : SpatialSteerablePyramid
        The pyramid that they come from.
    n_levels : int
        Its levels.
    seed : int
        Of the noise, which is one and the same for every picture of a batch.

    Returns
    -------
    torch.Tensor
        ``[B, C, H, W]``.

    Notes
    -----
    Walton et al., ACM Trans. Graph. 40, 48 (2021), section 4.
    """
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    noise = torch.rand(1, *image.shape[1:], dtype=torch.float64, generator=generator).to(image)
    pyramid = maker.construct_pyramid(noise, n_levels)
    maps = iter(statistics)

    def match(band):
        band = band - band.mean((2, 3), keepdim=True)
        rms = (band**2).mean((2, 3), keepdim=True).sqrt().clamp_min(RMS_FLOOR)
        mean, deviation = next(maps), next(maps)
        return band / rms * deviation + mean

    matched = []
    for level, content in enumerate(pyramid[:-1]):
        matched.append({"h": match(content["h"])} if level == 0 else {})
        matched[-1]["b"] = [match(band) for band in content["b"]]
    matched.append({"l": maker.construct_pyramid(image, n_levels)[-1]["l"]})
    return maker.reconstruct_from_pyramid(matched)


def as_picture(image: torch.Tensor, shape: torch.Size) -> torch.Tensor:
    """Return a padded Y′CrCb (or grey) picture in RGB (or grey), cut to the shape it had."""
    image = image[..., : shape[-2], : shape[-1]]
    return ycrcb_2_rgb(image) if shape[1] == 3 else image


def mean_distance(one: list[torch.Tensor], two: list[torch.Tensor]) -> torch.Tensor:
    """Return the mean over pairs of maps of their mean squared differences."""
    return torch.stack([functional.mse_loss(a, b) for a, b in zip(one, two, strict=True)]).mean()


def difference_map(one: list[torch.Tensor], two: list[torch.Tensor]) -> torch.Tensor:
    """Return the sum of the first channels' absolute differences, enlarged to the first map's size ``[B, H, W]``."""
    size = one[0].shape[-2:]
    differences = [(a[:, :1] - b[:, :1]).abs() for a, b in zip(one, two, strict=True)]
    enlarged = [functional.interpolate(d, size, mode="bilinear", align_corners=False) for d in differences]
    return torch.stack(enlarged).sum(0)[:, 0]


class TargetCache:
    """What was last computed from a target, while the target and everything else that it depends on are the same.

    A target is the same if it is the same memory, laid out in the same way, and torch counted no change to it. It is
    held, so that its memory cannot become another's. Writing to it behind torch's back (`.data`, NumPy) goes unseen.
    """

    _target: torch.Tensor | None
    _key: Any
    _value: Any

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._target, self._key, self._value = None, None, None

    def get(self, target: torch.Tensor, parameters: Hashable, compute: Callable):
        """Return `compute()`, from memory if it was computed for this target and these parameters.

        Parameters
        ----------
        target : torch.Tensor
            Of these numbers the result is made. If it requires a gradient, nothing is kept.
        parameters : hashable
            Everything else that the result depends on.
        compute : callable
            Makes the result; without gradients if it is to be kept.
        """
        key = _identity(target)
        if key is None:
            return compute()
        key = (key, parameters)
        if key != self._key:
            # What is made in inference mode could not serve a gradient later.
            with torch.inference_mode(False), torch.no_grad():
                value = compute()
            self._target, self._key, self._value = target.detach(), key, value
        return self._value


def _identity(target):
    """Return what tells a tensor from others and from its own past, None if nothing does or a graph hangs on it."""
    if target.requires_grad or target.is_inference() or _array._is_transformed(target):
        return None
    layout = (tuple(target.shape), target.stride(), target.dtype, target.device)
    return target.data_ptr(), target._version, layout
