"""A steerable pyramid by small convolutions: bands by scale and orientation, and the picture back from them."""

import functools
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from odak import _validate
from odak.learn._precision import in_own_precision
from odak.learn._tensors import checked_device
from odak.learn.perception.pyramid_filter_design import orientations, steering
from odak.learn.perception.small_filters import correlate
from odak.learn.perception.steerable_pyramid_filters import get_steerable_pyramid_filters

# Tensors, and under "b" lists of them.
Pyramid = list[dict[str, Any]]


def pad_image_for_pyramid(image: torch.Tensor, n_pyramid_levels: int) -> torch.Tensor:
    """Return a picture whose sides are multiples of 2ⁿ, padded at its right and bottom by reflection.

    Parameters
    ----------
    image : torch.Tensor
        ``[B, C, H, W]``.
    n_pyramid_levels : int
        n ≥ 0.

    Returns
    -------
    torch.Tensor
        The picture itself where it fits; otherwise its top-left part is the picture. Sides too short to be reflected
        repeat their last pixel.
    """
    step = 2 ** _validate.integer("n_pyramid_levels", n_pyramid_levels)
    rows, columns = _validate.image("image", image, axes=4).shape[-2:]
    down, right = -rows % step, -columns % step
    if not (down or right):
        return image
    mode = "reflect" if down < rows and right < columns else "replicate"
    return functional.pad(image, (0, right, 0, down), mode=mode)


def checked_pyramid(pyramid: Pyramid, n_orientations: int) -> Pyramid:
    """Return a pyramid after checking that it has levels with K bands, a high-pass residual and a last low-pass."""
    if not isinstance(pyramid, (list, tuple)) or not all(isinstance(level, dict) for level in pyramid):
        raise TypeError(f"pyramid must be a list of dictionaries, got {type(pyramid).__name__}")
    if len(pyramid) < 2 or "h" not in pyramid[0] or "l" not in pyramid[-1]:
        raise ValueError("pyramid must have two levels or more, 'h' in the first one and 'l' in the last one")
    counts = [len(level.get("b", ())) for level in pyramid[:-1]]
    if any(count != n_orientations for count in counts):
        raise ValueError(f"pyramid must have n_orientations = {n_orientations} bands 'b' in each level, got {counts}")
    return pyramid


class SpatialSteerablePyramid(nn.Module):
    """Steerable pyramid by convolution with small filters, mirrored at the borders.

    Parameters
    ----------
    use_bilinear_downup : bool
        Halve by 2 × 2 means and enlarge bilinearly: fast, good for smooth pictures; fine detail comes back with
        aliasing. Otherwise filter and take every second pixel: nearly perfect reconstruction,
        and each level's mean is twice the last one's.
    n_channels : int
        Channels of the pictures.
    filter_size, n_orientations, filter_type
        As for :func:`odak.learn.perception.get_steerable_pyramid_filters`.
    device : torch.device
        Where the filters are first; they follow the pictures.

    Attributes
    ----------
    filt_h0, filt_l0, filt_l : torch.Tensor
        Filters ``[C, 1, k, k]``; `filt_l` only without `use_bilinear_downup`.
    band_filters : list of torch.Tensor
        K filters ``[C, 1, k, k]``.

    Notes
    -----
    Simoncelli and Freeman, IEEE ICIP 3, 444 (1995). A mirrored picture has bands that are mirrored with a change of
    sign where their filter is odd. Reconstruction steers the bands to filters that are even or odd along each axis and
    mirrors each with its sign, so that it is as good at the borders as inside.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import SpatialSteerablePyramid
    >>> maker = SpatialSteerablePyramid(use_bilinear_downup=False, n_orientations=4)
    >>> picture = torch.linspace(0, 3, 64).sin().expand(1, 1, 64, 64)
    >>> pyramid = maker.construct_pyramid(picture, 3)
    >>> bool((maker.reconstruct_from_pyramid(pyramid) - picture).abs().max() < 0.01)
    True
    """

    filt_h0: torch.Tensor
    filt_l0: torch.Tensor
    filt_l: torch.Tensor
    _bands: torch.Tensor
    _mixing: torch.Tensor
    _parts: torch.Tensor

    def __init__(
        self,
        use_bilinear_downup: bool = True,
        n_channels: int = 1,
        filter_size: int = 9,
        n_orientations: int = 6,
        filter_type: str = "full",
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__()
        self.use_bilinear_downup = _validate.flag("use_bilinear_downup", use_bilinear_downup)
        self.n_channels = _validate.side("n_channels", n_channels)
        self.filter_size = _validate.integer("filter_size", filter_size, minimum=1)
        self.n_orientations, self.filter_type = n_orientations, filter_type
        self._build(torch.float32, checked_device("device", device) or torch.device("cpu"))

    @property
    def device(self) -> torch.device:
        """Where the filters are."""
        return self.filt_h0.device

    @property
    def band_filters(self) -> list[torch.Tensor]:
        """Return the K band filters."""
        return list(self._bands.reshape(self.n_channels, self.n_orientations, 1, *self._bands.shape[-2:]).unbind(1))

    def construct_pyramid(self, image: torch.Tensor, n_levels: int, multiple_highpass: bool = False) -> Pyramid:
        """Return the pyramid of a picture, fine to coarse.

        Parameters
        ----------
        image : torch.Tensor
            Real floats ``[B, C, H, W]``.
        n_levels : int
            At least 2: the last level holds only what is left.
        multiple_highpass : bool
            Put a high-pass residual into every level but the last; reconstruction uses the first alone.

        Returns
        -------
        list of dict
            Level 0: "h" high-pass residual, "l" low-pass, "b" list of K bands; then "l" and "b" at half the size each;
            last "l" alone.

        Raises
        ------
        ValueError, TypeError
            If the picture does not fit the pyramid, or is too small for so many levels.
        """
        multiple_highpass = _validate.flag("multiple_highpass", multiple_highpass)
        groups, low = self.stacked_bands(image, n_levels)
        pyramid: Pyramid = [{"h": groups[0].flatten(1, 2), "l": low[0], "b": list(groups[1].unbind(2))}]
        for bands, level in zip(groups[2:], low[1:], strict=False):
            pyramid.append({"l": level, "b": list(bands.unbind(2))})
            if multiple_highpass:
                pyramid[-1]["h"] = self._filter(level, self.filt_h0)
        return [*pyramid, {"l": low[-1]}]

    def stacked_bands(self, image: torch.Tensor, n_levels: int) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        """Return what :meth:`construct_pyramid` does, with the bands of each level in one tensor.

        Parameters
        ----------
        image, n_levels
            As for :meth:`construct_pyramid`.

        Returns
        -------
        tuple of lists
            The high-pass residual ``[B, C, 1, H, W]`` and each level's bands ``[B, C, K, H, W]``: n tensors; and the
            n low-passes ``[B, C, H, W]``.

        Raises
        ------
        ValueError, TypeError
            As :meth:`construct_pyramid` does.
        """
        _validate.integer("n_levels", n_levels, minimum=2)
        self._check(image, n_levels)
        self._follow(image)
        low = [self._filter(image, self.filt_l0)]
        groups = [correlate(image, self.filt_h0[:1, 0]), self._split(low[0])]
        for level in range(1, n_levels):
            low.append(self._halve(low[-1]))
            if level < n_levels - 1:
                groups.append(self._split(low[-1]))
        return groups, low

    def reconstruct_from_pyramid(self, pyramid: Pyramid) -> torch.Tensor:
        """Return the picture of a pyramid, which stays as it is.

        Parameters
        ----------
        pyramid : list of dict
            As :meth:`construct_pyramid` makes it. Used are the "h" of level 0, every "b" and the last "l".

        Returns
        -------
        torch.Tensor
            ``[B, C, H, W]``.

        Raises
        ------
        ValueError, TypeError
            If the pyramid is not one that :meth:`construct_pyramid` makes.
        """
        checked_pyramid(pyramid, self.n_orientations)
        image = pyramid[-1]["l"]
        self._follow(image)
        for level in reversed(pyramid[:-1]):
            image = self._enlarge(image, level["b"][0].shape[-2:]) + self._join(level["b"])
        return self._filter(image, self.filt_l0) + self._filter(pyramid[0]["h"], self.filt_h0)

    def _build(self, dtype, device) -> None:
        options: dict[str, Any] = {"dtype": dtype, "device": device}
        arguments = (self.filter_size, self.n_orientations, self.filter_type)
        filters = get_steerable_pyramid_filters(*arguments, **options)
        # Whatever mode the caller is in, the filters must serve gradients later.
        with torch.inference_mode(False):
            for name in ("h0", "l0") if self.use_bilinear_downup else ("h0", "l0", "l"):
                self._set(f"filt_{name}", filters[name].repeat(self.n_channels, 1, 1, 1))
            bands = torch.cat(filters["b"])
            self._set("_bands", bands.repeat(self.n_channels, 1, 1, 1))
            mixing, parts = _unsteered(*arguments)
            self._set("_mixing", torch.tensor(mixing, **options))
            self._set("_parts", torch.tensor(parts, **options)[None].repeat(self.n_channels, 1, 1, 1).flip(2, 3))

    def _set(self, name, value) -> None:
        self.register_buffer(name, value, persistent=False)

    def _apply(self, function, recurse=True):
        super()._apply(function, recurse)
        # Designed anew, taps have the full precision that they were moved to.
        self._build(self.filt_h0.dtype, self.filt_h0.device)
        return self

    def _follow(self, image) -> None:
        if (image.dtype, image.device) != (self.filt_h0.dtype, self.filt_h0.device):
            self._build(image.dtype, image.device)

    def _check(self, image, n_levels) -> None:
        if not isinstance(image, torch.Tensor) or not image.is_floating_point():
            raise TypeError("image must be a tensor of real floats [B, C, H, W]")
        if image.ndim != 4 or image.shape[1] != self.n_channels:
            raise ValueError(
                f"image must be [B, C, H, W] with C = n_channels = {self.n_channels}, got {tuple(image.shape)}"
            )
        # A side has to be longer than a filter reaches, where the filter is used: the first ones at full size, the
        # others down to the last level that has bands.
        first, others = [self.filt_h0, self.filt_l0], [self._bands]
        others += [] if self.use_bilinear_downup else [self.filt_l]
        needed = [max(taps.shape[-1] // 2 + 1 for taps in some) for some in (first, others)]
        smallest = max(needed[0], needed[1] << (n_levels - 2))
        if min(image.shape[-2:]) < smallest:
            raise ValueError(
                f"image must have sides of at least {smallest} for {n_levels} levels, got {tuple(image.shape[-2:])}"
            )

    def _filter(self, image, taps, stride=1):
        return correlate(image, taps[:1, 0], stride).flatten(1, 2)

    def _split(self, low):
        return correlate(low, self._bands[: self.n_orientations, 0])

    @in_own_precision
    def _join(self, bands):
        """Apply the adjoints of the band filters and sum, each mirrored at the borders as its filter asks."""
        stacked = torch.einsum("ik,kbchw->bcihw", self._mixing, torch.stack(tuple(bands))).flatten(1, 2)
        reach = self._parts.shape[-1] // 2
        padded = functional.pad(stacked, (reach,) * 4, mode="reflect")
        if self._parts.shape[1] > 1:
            signs = self._signs(padded, reach)
            padded = (padded.unflatten(1, (self.n_channels, -1)) * signs).flatten(1, 2)
        return functional.conv2d(padded, self._parts, groups=self.n_channels)

    def _signs(self, padded, reach):
        """Return −1 for the mirrored pixels of parts that are odd along an axis ``[K, H, W]``, 1 elsewhere."""
        order = self.n_orientations - 1
        across = torch.arange(self.n_orientations, device=padded.device)
        signs = []
        for odd, length in (((order - across) % 2, padded.shape[-2]), (across % 2, padded.shape[-1])):
            mirrored = torch.ones(length, dtype=torch.bool, device=padded.device)
            mirrored[reach : length - reach] = False
            signs.append(1 - 2 * (odd[:, None] * mirrored).to(padded.dtype))
        return signs[0][:, :, None] * signs[1][:, None, :]

    def _halve(self, low):
        if self.use_bilinear_downup:
            return functional.adaptive_avg_pool2d(low, [max(1, side // 2) for side in low.shape[-2:]])
        return self._filter(low, self.filt_l, stride=2)

    def _enlarge(self, low, size):
        if self.use_bilinear_downup:
            return functional.interpolate(low, size, mode="bilinear", align_corners=False)
        spread = low.new_zeros(*low.shape[:2], *size)
        spread[..., ::2, ::2] = low
        return self._filter(spread, self.filt_l)


@functools.lru_cache(maxsize=64)
def _unsteered(size, count, kind):
    """Return the matrix ``[K, K]`` and the filters ``[K, k, k]`` that turn bands into parts of one symmetry and back.

    With filters b = S·m of parts m, Σₖ b̃ₖ∗yₖ = Σᵢ m̃ᵢ∗(Sᵀ·y)ᵢ for any bands y and transposed filters b̃, m̃: the
    matrix is Sᵀ.
    """
    bands = get_steerable_pyramid_filters(size, count, kind, dtype=torch.float64)["b"]
    shares = steering(count, orientations(count))
    parts = np.linalg.solve(shares, torch.cat(bands)[:, 0].numpy().reshape(count, -1))
    return shares.T, parts.reshape(count, *bands[0].shape[-2:])
