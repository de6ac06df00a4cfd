"""Steerable pyramids: design of filters, a pyramid by small convolutions and an exact one by Fourier masks.

Filters are designed by least squares on the response. Every band of K orientations is a mixture of the same K filters,
one per product cosⁱθ·sin^(K−1−i)θ. They are even or odd along each axis and one another's transposes, so that few
numbers are unknown and the bank is exactly steerable.
"""

import functools
import json
import math
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from odak import _torch_private, _validate
from odak._torch_private import in_own_precision, linear
from odak._warnings import AccuracyWarning, warn
from odak.learn._tensors import checked_device, checked_dtype, floating_tensor, in_float64, kind_of
from odak.learn.perception.foveation import is_blocked

FILTER_TYPES = ("full", "cropped", "trained")
# Sizes of l, l0, h0 and the bands of the full bank.
FULL_SIZES = {1: (13, 7, 9, 9), 2: (17, 9, 9, 9), 6: (17, 9, 9, 9)}
OTHER_FULL_SIZES = (17, 9, 15, 9)
CROPPED_LOW, CROPPED_LOW0 = 13, 5
TRAINED_SIZE = 5
# Size of the filters that are in quadrature with the bands.
QUADRATURE_SIZE = 9
# Profiles across and along of a small derivative, and its largest tap.
TRAINED_ACROSS, TRAINED_ALONG, TRAINED_PEAK = (0.478, 1.0, 0.0, -1.0, -0.478), (0.155, 0.645, 1.0, 0.645, 0.155), 0.061


def get_steerable_pyramid_filters(
    size: int,
    n_orientations: int,
    filter_type: str,
    *,
    bilinear: bool = False,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> dict[str, Any]:
    """Return the filters of a steerable pyramid.

    Parameters
    ----------
    size : int
        Odd size of the bands and of the high-pass residual of a "cropped" or "trained" bank; "full" has its own.
    n_orientations : int
        Number K ≥ 1 of orientations.
    filter_type : str
        "full": sizes at which the pyramid reconstructs best; "cropped": designed at the smaller sizes that cropping to
        `size` would give, and so an order of magnitude flatter than cut filters; "trained": the cropped bank of size 5
        with two small derivative kernels as bands (K = 2 only).
    bilinear : bool
        Filters for the bilinear mode of :class:`SpatialSteerablePyramid`, which does not use "l".
    dtype : torch.dtype
        Precision of the taps.
    device : torch.device, optional
        Where they are.

    Returns
    -------
    dict
        "l": low-pass between levels (sum 2), "l0": first low-pass (sum 1), "h0": high-pass residual (sum 0), each
        ``[1, 1, k, k]``; "b": list of K bands ``[1, 1, k, k]`` (sum 0). They are applied by correlation (conv2d).
        Band k is tuned to a frequency at 180°·k/K, counter-clockwise with y upwards; of an even K it is odd, and band
        0 falls where brightness rises to the right.

    Raises
    ------
    ValueError, TypeError
        If the type is unknown, or the size or the number of orientations is not one that the type has.

    Notes
    -----
    Designed by :func:`odak.learn.perception.pyramids.design` on first use (under a second) and kept.
    Deviation of T = H₀² + L₀²(ΣBₖ² + L²/4) from 1 of the full banks: below 0.02 for K = 1, 2, 3, 4, 6. In the bilinear
    mode cos⁴(ωₓ/2)·cos⁴(ω_y/2) is in place of L²/4, and the deviation is below 0.05.

    Examples
    --------
    The bands have no response to a constant:

    >>> from odak.learn.perception import get_steerable_pyramid_filters
    >>> filters = get_steerable_pyramid_filters(9, 4, "full")
    >>> len(filters["b"]), all(abs(band.sum().item()) < 1e-5 for band in filters["b"])
    (4, True)
    """
    count = _validate.integer("n_orientations", n_orientations, minimum=1)
    kind = _validate.one_of("filter_type", filter_type, FILTER_TYPES)
    sizes = FULL_SIZES.get(count, OTHER_FULL_SIZES)
    if kind != "full":
        sizes = _cropped_sizes(size, sizes)
    bank = design(count, sizes, _validate.flag("bilinear", bilinear))
    bands = bank["b"]
    if kind == "trained":
        bands = _trained(size, count)
    options: dict[str, Any] = {"dtype": checked_dtype("dtype", dtype), "device": checked_device("device", device)}
    filters = {name: torch.tensor(bank[name], **options)[None, None] for name in ("l", "l0", "h0")}
    return {**filters, "b": [torch.tensor(band, **options)[None, None] for band in bands]}


def crop_steerable_pyramid_filters(filters: dict[str, Any], size: int) -> dict[str, Any]:
    """Return the central parts of the filters of a bank.

    Parameters
    ----------
    filters : dict
        "l", "l0", "h0" ``[..., k, k]`` and "b", a list of the same.
    size : int
        Odd, at least 3: size of the bands and of the high-pass residual. The low-passes become 13 and 5 wide. Smaller
        filters stay as they are.

    Returns
    -------
    dict
        New tensors. The low-passes keep their sums; the bands and "h0" have a mean of zero.

    Raises
    ------
    ValueError, TypeError
        If the size is even or below 3.

    Notes
    -----
    A bank that is cut reconstructs worse than one designed at its size, which is what
    :func:`get_steerable_pyramid_filters` gives for "cropped".

    Examples
    --------
    >>> from odak.learn.perception import crop_steerable_pyramid_filters, get_steerable_pyramid_filters
    >>> cropped = crop_steerable_pyramid_filters(get_steerable_pyramid_filters(9, 4, "full"), 5)
    >>> tuple(cropped["b"][0].shape)
    (1, 1, 5, 5)
    """
    size = _odd(size)
    if not isinstance(filters, dict) or not {"l", "l0", "h0", "b"} <= set(filters):
        raise TypeError(f"filters must be a dictionary with 'l', 'l0', 'h0' and 'b', got {type(filters).__name__}")
    low = {name: _middle(filters[name], wide) for name, wide in (("l", CROPPED_LOW), ("l0", CROPPED_LOW0))}
    high = [_middle(taps, size) for taps in (filters["h0"], *filters["b"])]
    residual, *bands = [taps - taps.mean() for taps in high]
    return {
        **{name: value * (filters[name].sum() / value.sum()) for name, value in low.items()},
        "h0": residual,
        "b": bands,
    }


def _odd(size):
    size = _validate.integer("size", size, minimum=3)
    if size % 2 == 0:
        raise ValueError(f"size must be odd, got {size}")
    return size


def _middle(taps, size):
    cut = max(0, (taps.shape[-1] - size) // 2)
    return taps[..., cut : taps.shape[-2] - cut, cut : taps.shape[-1] - cut]


def _cropped_sizes(size, full):
    """Return the sizes of l, l0, h0 and the bands after cropping."""
    size = _odd(size)
    if size > max(full[2:]):
        raise ValueError(f"size must be at most {max(full[2:])} with these orientations, got {size}")
    low, low0, high0, band = full
    return min(low, CROPPED_LOW), min(low0, CROPPED_LOW0), min(high0, size), min(band, size)


def _trained(size, count):
    if size != TRAINED_SIZE or count != 2:
        raise ValueError(
            f"filter_type 'trained' needs size={TRAINED_SIZE} and n_orientations=2, got {size} and {count}"
        )
    band = TRAINED_PEAK * np.outer(TRAINED_ALONG, TRAINED_ACROSS)
    return band, band.T


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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import pad_image_for_pyramid
    >>> tuple(pad_image_for_pyramid(torch.zeros(1, 1, 30, 33), 3).shape)
    (1, 1, 32, 40)
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
        Halve by 2 × 2 means, which is fast and lets fine detail of one level alias into the next. Otherwise filter and
        take every second pixel, and each level's mean is twice the last one's. Each mode has filters of its own.
    n_channels : int
        Channels of the pictures.
    filter_size : int
        Odd size of the bands and of the high-pass residual of a "cropped" or "trained" bank.
    n_orientations : int
        Number K ≥ 1 of orientations.
    filter_type : str
        "full", "cropped" or "trained", see :func:`odak.learn.perception.get_steerable_pyramid_filters`.
    device : torch.device
        Where the filters are first; they follow the pictures.

    Attributes
    ----------
    filt_h0 : torch.Tensor
        High-pass filter ``[C, 1, k, k]``.
    filt_l0 : torch.Tensor
        First low-pass filter ``[C, 1, k, k]``.
    filt_l : torch.Tensor
        Low-pass filter between levels ``[C, 1, k, k]``; only without `use_bilinear_downup`.
    band_filters : list of torch.Tensor
        K filters ``[C, 1, k, k]``.

    Notes
    -----
    Simoncelli and Freeman, IEEE ICIP 3, 444 (1995).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import SpatialSteerablePyramid
    >>> maker = SpatialSteerablePyramid(use_bilinear_downup=False, n_orientations=4)
    >>> picture = torch.linspace(0, 3, 64).sin().expand(1, 1, 64, 64)
    >>> pyramid = maker.construct_pyramid(picture, 3)
    >>> bool((maker.reconstruct_from_pyramid(pyramid) - picture).abs().max() < 1e-5)
    True
    """

    filt_h0: torch.Tensor
    filt_l0: torch.Tensor
    filt_l: torch.Tensor
    _bands: torch.Tensor

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
        self.use_bilinear_downup: bool = _validate.flag("use_bilinear_downup", use_bilinear_downup)
        self.n_channels: int = _validate.side("n_channels", n_channels)
        self.filter_size: int = _validate.integer("filter_size", filter_size, minimum=1)
        self.n_orientations: int = n_orientations
        self.filter_type: str = filter_type
        self._build(torch.float32, checked_device("device", device) or torch.device("cpu"))

    @property
    def device(self) -> torch.device:
        """Device of the filters."""
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
            At least 2: the last level holds only the low-pass residual.
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
        pyramid: Pyramid = [{"h": groups[0][:, :, 0], "l": low[0], "b": list(groups[1].unbind(2))}]
        for bands, level in zip(groups[2:], low[1:], strict=False):
            pyramid.append({"l": level, "b": list(bands.unbind(2))})
            if multiple_highpass:
                pyramid[-1]["h"] = self._filters[0](level)[:, :, 0]
        return [*pyramid, {"l": low[-1]}]

    def stacked_bands(self, image: torch.Tensor, n_levels: int) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        """Return the pyramid of :meth:`construct_pyramid` with the bands of each level in one tensor.

        Parameters
        ----------
        image : torch.Tensor
            Real floats ``[B, C, H, W]``.
        n_levels : int
            At least 2.

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
        groups, low = self._levels(image, n_levels)
        return [groups[0][:, :, :1], groups[0][:, :, 1:], *groups[1:]], low

    @in_own_precision
    def _levels(self, image: torch.Tensor, n_levels: int) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        """Return what :meth:`stacked_bands` does, the residual in front of the first level's bands, without checks.

        Parameters
        ----------
        image : torch.Tensor
            Real floats ``[B, C, H, W]``, large enough for the levels.
        n_levels : int
            At least 2.
        """
        levels = self._map(image, n_levels)
        found = linear(levels, False, image) if is_blocked(image) else levels.forward(image, _plainly)
        return list(found[: n_levels - 1]), list(found[n_levels - 1 :])

    def _map(self, like, n_levels, weight=1):
        """Return the linear map from pictures like one to their pyramid."""
        self._follow(like)
        return _Levels(*self._filters, n_levels, like.shape[-2:], weight)

    def quadrature(self, low: torch.Tensor) -> torch.Tensor:
        """Return bands a quarter of a cycle behind the bands of a level: the imaginary parts of complex bands.

        Parameters
        ----------
        low : torch.Tensor
            Low-pass ``[B, C, H, W]`` of a level, any number of channels.

        Returns
        -------
        torch.Tensor
            ``[B, C, K, H, W]``. For a grating along the orientation of band k the band is A·cos φ and this A·sin φ; the
            root of the sum of their squares is the local amplitude A, whatever the phase.

        Notes
        -----
        See :func:`odak.learn.perception.pyramids.quadrature`. Filters of 9 × 9 taps come within a few per
        cent of the exact relation in the octave of the bands; :class:`FrequencySteerablePyramid` is exact.

        Examples
        --------
        The local amplitude of a grating is the same everywhere:

        >>> import torch
        >>> from odak.learn.perception import SpatialSteerablePyramid
        >>> maker = SpatialSteerablePyramid(use_bilinear_downup=False, n_orientations=4)
        >>> grating = torch.cos(2 * torch.pi * torch.arange(64) * 13 / 64).expand(1, 1, 64, 64)
        >>> groups, low = maker.stacked_bands(grating, 2)
        >>> amplitude = torch.hypot(groups[1], maker.quadrature(low[0]))[0, 0, 0, :, 12:-12]
        >>> bool(amplitude.std() / amplitude.mean() < 0.04)
        True
        """
        floating_tensor("low", low, "a tensor of real floats [B, C, H, W]")
        if low.ndim != 4 or min(low.shape[-2:]) <= QUADRATURE_SIZE // 2:
            smallest = QUADRATURE_SIZE // 2 + 1
            raise ValueError(f"low must be [B, C, H, W] with sides of {smallest} or more, got {tuple(low.shape)}")
        self._follow(low)
        return _quadrature_filters(*self._bank(), low.dtype, low.device)(low)

    def reconstruct_from_pyramid(self, pyramid: Pyramid) -> torch.Tensor:
        """Return the picture whose pyramid is nearest to a given one, which is not modified; differentiable.

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

        Warns
        -----
        odak.AccuracyWarning
            If the pyramid hardly determines the picture; the message states the error.

        Notes
        -----
        Least squares over high-pass residual, bands and last low-pass, by conjugate gradients (Hestenes and Stiefel,
        J. Res. Natl. Bur. Stand. 49, 409 (1952)) that are refined in float64. With 2 × 2 means a sample counts for the
        pixels that it is the mean of. A picture comes back from its own pyramid to about 1e-6 of its largest value from
        float32, as far as its rounding determines it, and to 1e-8 from float64, with every bank and in both modes.
        """
        checked_pyramid(pyramid, self.n_orientations)
        last = in_float64(pyramid[-1]["l"])
        first, *others = [tuple(level["b"]) for level in pyramid[:-1]]
        groups = [torch.stack(bands, 2) for bands in ((pyramid[0]["h"], *first), *others)]
        # Convolutions in single precision take a tenth of the time; double precision tells what is left of the error.
        fast, exact = (
            SpatialSteerablePyramid(self.use_bilinear_downup, self.n_channels, *self._bank()[:3]) for _ in "ab"
        )
        exact._follow(last)
        accuracy = max(1e-9, torch.finfo(last.dtype).eps, torch.finfo(pyramid[-1]["l"].dtype).eps / 4)

        def inverted(right):
            image, error = torch.zeros_like(right), math.inf
            for _ in range(MOST_ROUNDS):
                rest = right - exact._normal(image, len(pyramid)) if math.isfinite(error) else right
                step = fast._descended(rest.float(), len(pyramid), ROUND).to(right)
                image = image + step
                error = _largest_share(step, image)
                # NaN is not worked on.
                if not error * ROUND > accuracy:
                    return image
            warn(
                f"the pyramid hardly determines its picture: the last of {MOST_ROUNDS} rounds of the inversion changed "
                f"it by {error:.1g} of its largest value",
                AccuracyWarning,
            )
            return image

        return _solved(exact._gathered([in_float64(bands) for bands in groups], last), inverted).to(pyramid[-1]["l"])

    def _normal(self, image, n_levels):
        """Return the adjoint of the pyramid of a picture."""
        groups, low = self._levels(image, n_levels)
        return self._gathered(groups, low[-1])

    @in_own_precision
    def _descended(self, right, n_levels, tolerance):
        """Return the picture whose pyramid has an adjoint that is given, by conjugate gradients."""
        image, residual, direction, power = torch.zeros_like(right), right, right, _power(right)
        for _ in range(MOST_STEPS):
            turned = self._normal(direction, n_levels)
            step = _ratio(power, (direction * turned).sum((-2, -1), keepdim=True))
            image, residual = image + step * direction, residual - step * turned
            if not _largest_share(step * direction, image) > tolerance:
                break
            before, power = power, _power(residual)
            direction = residual + _ratio(power, before) * direction
        return image

    @in_own_precision
    def _gathered(self, groups, last):
        """Return the adjoint of the pyramid, each sample weighed by the energy of the picture that it stands for.

        The samples of a level that 2 × 2 means have halved stand for four pixels of the level above each.
        """
        levels = self._map(groups[0], len(groups) + 1, weight=4)
        values = (*groups, *[None] * len(groups), last)
        return (
            linear(levels, True, *values) if is_blocked(last) else levels.adjoint(*values, spread=Filters.plain_adjoint)
        )

    def _build(self, dtype, device) -> None:
        options: dict[str, Any] = {"dtype": dtype, "device": device}
        arguments = self._bank()[:3]
        filters = get_steerable_pyramid_filters(*arguments, bilinear=self.use_bilinear_downup, **options)
        # Outside inference mode, so that the filters can be used with autograd later.
        with _torch_private.keeping():
            for name in ("h0", "l0") if self.use_bilinear_downup else ("h0", "l0", "l"):
                self._set(f"filt_{name}", filters[name].repeat(self.n_channels, 1, 1, 1))
            bands = torch.cat(filters["b"])
            self._set("_bands", bands.repeat(self.n_channels, 1, 1, 1))
        low = None if self.use_bilinear_downup else Filters(filters["l"][0], 2)
        self._filters = (Filters(filters["h0"][0]), Filters(filters["l0"][0]), Filters(bands[:, 0]), low)

    def _bank(self):
        return self.filter_size, self.n_orientations, self.filter_type, self.use_bilinear_downup

    def _set(self, name, value) -> None:
        self.register_buffer(name, value, persistent=False)

    def _apply(self, function, recurse=True):
        super()._apply(function, recurse)
        # The taps are designed again, so that they have the full precision of the new dtype.
        self._build(self.filt_h0.dtype, self.filt_h0.device)
        return self

    def _follow(self, image) -> None:
        taps = self._filters[0].taps
        if (image.dtype, image.device) != (taps.dtype, taps.device):
            self._build(image.dtype, image.device)

    def _check(self, image, n_levels) -> None:
        floating_tensor("image", image, "a tensor of real floats [B, C, H, W]")
        _validate.shaped("image", image, f"[B, {self.n_channels}, H, W], of n_channels channels")
        smallest = self._smallest_side(n_levels)
        if min(image.shape[-2:]) < smallest:
            raise ValueError(
                f"image must have sides of at least {smallest} for {n_levels} levels, got {tuple(image.shape[-2:])}"
            )

    def _smallest_side(self, n_levels) -> int:
        """Return the smallest side of a picture for a number of levels.

        It is longer than a filter reaches, where the filter is used: the first ones at full size, the others down to
        the last level that has bands.
        """
        first, others = [self.filt_h0, self.filt_l0], [self._bands]
        others += [] if self.use_bilinear_downup else [self.filt_l]
        needed = [max(taps.shape[-1] // 2 + 1 for taps in some) for some in (first, others)]
        return max(needed[0], needed[1] << (n_levels - 2))


# Iterations of the inversion of a pyramid at most, and rounds of them, each to this accuracy; usual are 5 to 20 and 3.
MOST_STEPS, MOST_ROUNDS, ROUND = 100, 8, 1e-4


def _power(planes):
    return (planes**2).sum((-2, -1), keepdim=True)


def _ratio(one, other):
    return torch.where(other > 0, one / other, 0)


def _largest_share(step, image) -> float:
    """Return the largest change of a channel, as a share of its largest value."""
    shares = _ratio(*(planes.abs().amax((-2, -1)) for planes in (step, image)))
    return float(shares.max()) if shares.numel() else 0.0


def _solved(right, inverted):
    """Return what the inverse of a symmetric operator makes of the right-hand side; it is its own adjoint."""
    return linear(SimpleNamespace(forward=inverted, adjoint=inverted), False, right)


def nearest_picture(
    maker: SpatialSteerablePyramid, groups: list[torch.Tensor], last: torch.Tensor, tolerance: float
) -> torch.Tensor:
    """Return the picture whose pyramid is nearest to a given one, in its precision and to a given accuracy.

    Parameters
    ----------
    maker : SpatialSteerablePyramid
        The pyramid.
    groups : list of torch.Tensor
        Bands ``[B, C, K, H, W]`` of each level, the high-pass residual in front of the first ones.
    last : torch.Tensor
        Last low-pass ``[B, C, H, W]``.
    tolerance : float
        Largest change of the picture in a step, as a share of its largest value, at which the iteration ends.

    Returns
    -------
    torch.Tensor
        ``[B, C, H, W]``.
    """
    maker._follow(last)
    inverted = functools.partial(maker._descended, n_levels=len(groups) + 1, tolerance=tolerance)
    return _solved(maker._gathered(groups, last), inverted)


@functools.lru_cache(maxsize=16)
def _quadrature_filters(size, count, kind, bilinear, dtype, device):
    bands = get_steerable_pyramid_filters(size, count, kind, bilinear=bilinear, dtype=torch.float64)["b"]
    taps = quadrature(torch.cat(bands)[:, 0].cpu().numpy(), QUADRATURE_SIZE)
    with _torch_private.keeping():
        return Filters(torch.tensor(taps, dtype=dtype, device=device))


class FrequencySteerablePyramid(nn.Module):
    """Steerable pyramid whose masks add up to one: its adjoint is its inverse, to rounding.

    Parameters
    ----------
    n_levels : int
        At least 2: the last level holds only the low-pass residual.
    n_orientations : int
        Number K ≥ 1 of orientations.

    Notes
    -----
    Portilla and Simoncelli, Int. J. Comput. Vis. 40, 49 (2000), eqs. 1 to 4, with the masks as formulas of the
    frequency rather than tables. Transforms are orthonormal, so that the energies of high-pass residual, bands and
    last low-pass add up to the picture's, and each level's mean is about twice the last one's. Pictures are taken
    as periodic. Masks are kept for the last picture size, precision and device.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import FrequencySteerablePyramid
    >>> maker = FrequencySteerablePyramid(n_levels=4, n_orientations=6)
    >>> picture = torch.rand(1, 3, 45, 70, dtype=torch.float64)
    >>> pyramid = maker.construct_pyramid(picture)
    >>> bool((maker.reconstruct_from_pyramid(pyramid) - picture).abs().max() < 1e-12)
    True
    """

    def __init__(self, n_levels: int = 5, n_orientations: int = 6) -> None:
        super().__init__()
        self.n_levels: int = _validate.integer("n_levels", n_levels, minimum=2)
        self.n_orientations: int = _validate.integer("n_orientations", n_orientations, minimum=1)
        self._masks: tuple | None = None

    def forward(self, image: torch.Tensor) -> Pyramid:
        """Return the pyramid; the same as :meth:`construct_pyramid`.

        Parameters
        ----------
        image : torch.Tensor
            Image, see :meth:`construct_pyramid`.
        """
        return self.construct_pyramid(image)

    def construct_pyramid(self, image: torch.Tensor, quadrature: bool = False) -> Pyramid:
        """Return the pyramid of a picture, fine to coarse; differentiable.

        Parameters
        ----------
        image : torch.Tensor
            Real floats ``[..., H, W]``, each side at least 2ⁿ for n + 1 levels.
        quadrature : bool
            Return complex bands: the real part is the band, the imaginary part the band a quarter of a cycle behind, so
            that the modulus is the local amplitude and the argument the local phase.

        Returns
        -------
        list of dict
            Level 0: "h" high-pass residual and "b", list of K bands; then "b" at half the size each, rounded up; last
            "l", the low-pass that is left. Band k is tuned to a frequency at 180°·k/K, counter-clockwise with y
            upwards; of an even K it is odd, and band 0 falls where brightness rises to the right.

        Raises
        ------
        ValueError, TypeError
            If the picture is not of real floats or too small for the levels.
        """
        quadrature, size = _validate.flag("quadrature", quadrature), self._size(image)
        high, levels = self._prepare(size, image.dtype, image.device)
        spectrum = torch.fft.rfft2(image, norm="ortho")
        pyramid = [{"h": _picture(spectrum * high, size)}]
        for level, (size_here, bands, low) in enumerate(levels):
            if level:
                spectrum = _cropped(spectrum, size_here)
                pyramid.append({})
            masked = spectrum[..., None, :, :] * bands
            found = _picture(masked, size_here)
            if quadrature:
                signs = _directions(size_here, size, self.n_orientations).to(image)
                behind = masked * torch.complex(torch.zeros_like(signs), -signs)
                found = torch.complex(found, _picture(behind, size_here))
            pyramid[-1]["b"] = list(found.unbind(-3))
            spectrum = spectrum * low
        smallest = _halved(levels[-1][0])
        pyramid.append({"l": _picture(_cropped(spectrum, smallest), smallest)})
        return pyramid

    def reconstruct_from_pyramid(self, pyramid: Pyramid) -> torch.Tensor:
        """Return the picture of a pyramid, which is not modified; differentiable.

        Parameters
        ----------
        pyramid : list of dict
            As :meth:`construct_pyramid` makes it. Of complex bands the real parts are used.

        Returns
        -------
        torch.Tensor
            ``[..., H, W]``.

        Raises
        ------
        ValueError, TypeError
            If the pyramid has not `n_levels` levels of `n_orientations` bands.
        """
        checked_pyramid(pyramid, self.n_orientations)
        if len(pyramid) != self.n_levels:
            raise ValueError(f"pyramid must have n_levels = {self.n_levels} levels, got {len(pyramid)}")
        residual = pyramid[0]["h"]
        size = self._size(residual)
        high, levels = self._prepare(size, residual.dtype, residual.device)
        spectrum = torch.fft.rfft2(pyramid[-1]["l"], norm="ortho")
        for (size_here, bands, low), level in zip(reversed(levels), reversed(pyramid[:-1]), strict=True):
            spectrum = _spread(spectrum, size_here) * low
            stacked = torch.stack(tuple(level["b"]), -3)
            transformed = torch.fft.rfft2(stacked.real if stacked.is_complex() else stacked, norm="ortho")
            spectrum = spectrum + (transformed * bands.conj()).sum(-3)
        return _picture(spectrum + torch.fft.rfft2(residual, norm="ortho") * high, size)

    def _size(self, image) -> tuple[int, int]:
        if not isinstance(image, torch.Tensor) or image.dtype not in (torch.float32, torch.float64):
            kind = kind_of(image)
            raise TypeError(f"image must be a tensor of real floats [..., H, W], float32 or float64, got {kind}")
        smallest = 1 << (self.n_levels - 1)
        accepted = f"[..., {smallest} or more, {smallest} or more], not empty, with {self.n_levels} levels"
        _validate.shaped("image", image, accepted)
        rows, columns = image.shape[-2:]
        return rows, columns

    def _prepare(self, size, dtype, device):
        """Return the high-pass mask and, of each level with bands, its size, band masks ``[K, H, W]`` and low-pass."""
        key = (size, dtype, device)
        if self._masks is None or self._masks[0] != key:
            with _torch_private.keeping():
                self._masks = (key, *_masks(size, self.n_levels, self.n_orientations, dtype, device))
        return self._masks[1:]


def _masks(size, n_levels, count, dtype, device):
    def real(mask):
        return torch.from_numpy(mask).to(device, dtype)

    high = ideal_gains(_polar(size, size)[0])[0]
    levels, here = [], size
    for level in range(n_levels - 1):
        radius, angle = _polar(here, size)
        _, _, band, low = ideal_gains(radius * 2**level)
        # The low-pass of a finer level has been applied already; the first one is applied here.
        before = ideal_gains(radius)[1] if level == 0 else 1.0
        toward = np.cos(angle - orientations(count)[:, None, None]) ** (count - 1)
        bands = real(before * band * band_amplitude(count) * toward)
        levels.append(
            (here, bands if count % 2 else torch.complex(torch.zeros_like(bands), -bands), real(before * low / 2))
        )
        here = _halved(here)
    return real(high), levels


def _directions(here, size, count):
    """Return on which side of each orientation's axis the frequencies of a level lie, as −1, 0 or 1 ``[K, H, W]``."""
    angle = _polar(here, size)[1]
    along = np.cos(angle - orientations(count)[:, None, None])
    return torch.from_numpy(np.where(np.abs(along) < 1e-9, 0.0, np.sign(along)))


def _polar(here, size):
    """Return length and angle (y upwards) of the frequencies of a level's half spectrum, in radians per fine pixel."""
    rows = np.fft.fftfreq(here[0], 1 / here[0]) / size[0]
    columns = np.arange(here[1] // 2 + 1) / size[1]
    y, x = -2 * math.pi * rows[:, None], 2 * math.pi * columns[None, :]
    return np.hypot(x, y), np.arctan2(y, x)


def _halved(size):
    return tuple(-(-side // 2) for side in size)


def _picture(spectrum, size):
    return torch.fft.irfft2(spectrum, size, norm="ortho")


def _rows_kept(rows):
    """Return how many rows of least frequency a spectrum has from zero upwards, and below zero."""
    return (rows + 1) // 2, rows // 2


def _cropped(spectrum, size):
    """Return the part of a half spectrum that a smaller picture has."""
    up, down = _rows_kept(size[0])
    columns = spectrum[..., : size[1] // 2 + 1]
    return torch.cat([columns[..., :up, :], columns[..., columns.shape[-2] - down :, :]], -2)


def _spread(spectrum, size):
    """Return a half spectrum padded by zeros to the half spectrum of a larger picture."""
    up, down = _rows_kept(spectrum.shape[-2])
    middle = spectrum.new_zeros(*spectrum.shape[:-2], size[0] - up - down, spectrum.shape[-1])
    rows = torch.cat([spectrum[..., :up, :], middle, spectrum[..., up:, :]], -2)
    return nn.functional.pad(rows, (0, size[1] // 2 + 1 - spectrum.shape[-1]))


# Number of output channels, whose results fill one vector register.
LANES = 16
# Values of the results of several filters that are computed together at most: those of more do not stay in a cache.
TOGETHER = 1 << 20


class Filters:
    """Filters that are applied to planes mirrored at their borders, and the forms in which a processor takes them.

    Convolutions compute output channels side by side, and a plane has one. Sixteen copies of a filter, each shifted by
    one column more, are sixteen channels of a convolution that takes sixteen columns at a step: more products, and
    several times less time.

    Parameters
    ----------
    taps : torch.Tensor
        ``[K, k, k]`` of odd k.
    stride : int
        Every so many rows and columns, from the first on.
    """

    def __init__(self, taps: torch.Tensor, stride: int = 1) -> None:
        self.taps: torch.Tensor = taps
        self.stride: int = stride
        self.count, self.side = taps.shape[0], taps.shape[-1]

    @functools.cached_property
    def _shifted(self) -> torch.Tensor:
        return self._kept([_shifted(filt[None], LANES, self.stride) for filt in self.taps])

    @functools.cached_property
    def _reversed(self) -> torch.Tensor:
        """Each filter's parts for each of the stride² phases into which pixels fall."""
        return self._kept([_shifted(_phases(filt, self.stride), self._lanes, 1) for filt in self.taps])

    @property
    def _lanes(self) -> int:
        return LANES // self.stride**2

    def _kept(self, filters: list[torch.Tensor]) -> torch.Tensor:
        with _torch_private.keeping(), torch.no_grad():
            return torch.cat(filters).contiguous(memory_format=torch.channels_last)

    @in_own_precision
    def __call__(self, image: torch.Tensor) -> torch.Tensor:
        """Return the correlations of pictures; see :func:`correlate`."""
        if is_blocked(image) and not self.taps.requires_grad:
            adjoint = functools.partial(self.spread, size=image.shape[-2:])
            return linear(SimpleNamespace(forward=self.forward, adjoint=adjoint), False, image)
        return self.plainly(image)

    def size(self, size: Sequence[int]) -> tuple[int, int]:
        """Return rows and columns of the results of pictures of a size."""
        return -(-size[0] // self.stride), -(-size[1] // self.stride)

    def plainly(self, image: torch.Tensor) -> torch.Tensor:
        """Return the correlations ``[B, C, K, h, w]`` of pictures by differentiable operations of torch."""
        padded = functional.pad(image, (self.side // 2,) * 4, mode="reflect")
        planes = functional.conv2d(padded.flatten(0, 1)[:, None], self.taps[:, None], stride=self.stride)
        return planes.unflatten(0, image.shape[:2])

    def plain_adjoint(self, values: torch.Tensor, size: Sequence[int]) -> torch.Tensor:
        """Return the adjoint of :meth:`plainly` for pictures of a size, ``[B, C, *size]``."""
        reach = self.side // 2
        planes = functional.conv_transpose2d(values.flatten(0, 1), self.taps[:, None], stride=self.stride)
        beyond = [length + 2 * reach - found for length, found in zip(size, planes.shape[-2:], strict=True)]
        planes = functional.pad(planes, (0, beyond[1], 0, beyond[0]))
        above = planes[..., reach : reach + size[0], reach : reach + size[1]]
        folded = torch.ops.aten.reflection_pad2d_backward(planes, above, (reach,) * 4)
        return folded[:, 0].unflatten(0, values.shape[:2])

    def write(self, image: torch.Tensor, result: torch.Tensor) -> None:
        """Write the correlations of pictures ``[B, C, H, W]`` to `result` ``[h, B, C, K, w]``, on a CPU."""
        reach, (rows, batch, channels, _, columns) = self.side // 2, result.shape
        planes = functional.pad(image, (reach,) * 4, mode="reflect").flatten(0, 1)
        # Whole steps of the lanes; results from the zeros added are dropped.
        beyond = (-(-columns // LANES) * LANES - 1) * self.stride + self.side - planes.shape[-1]
        planes = _as_channels_last(torch.constant_pad_nd(planes, (0, beyond)) if beyond > 0 else planes)
        step = TOGETHER // (rows * batch * channels * columns) or 1
        for first in range(0, self.count, step):
            taps = self._shifted[first * LANES : (first + step) * LANES]
            lanes = functional.conv2d(planes, taps, stride=(self.stride, self.stride * LANES))
            lanes = lanes.view(batch, channels, -1, LANES, *lanes.shape[-2:]).permute(4, 0, 1, 2, 5, 3)
            result[:, :, :, first : first + step] = lanes.flatten(4)[..., :columns]

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Return the correlations of pictures on a CPU; see :meth:`plainly`."""
        return _written((self, image))

    def spread(self, values: torch.Tensor, size: Sequence[int]) -> torch.Tensor:
        """Return the adjoint of :meth:`forward` for pictures of a size, ``[B, C, *size]``."""
        stride, lanes = self.stride, self._lanes
        padded = [length + self.side - 1 for length in size]
        cells = -(-padded[0] // stride), -(-padded[1] // (stride * lanes)) * lanes
        before = -(-self.side // stride) - 1
        after = [cell - length for cell, length in zip(cells, values.shape[-2:], strict=True)]
        room = before, after[1], before, after[0]
        padded_parts = (torch.constant_pad_nd(part, room) for part in values.flatten(0, 1).unbind(1))
        spreads = (
            functional.conv2d(_as_channels_last(part), taps, stride=(1, lanes))
            for part, taps in zip(padded_parts, self._reversed.chunk(self.count), strict=True)
        )
        total = next(spreads)
        for one in spreads:
            total += one
        # [N, cell, cells of lanes, row in the cell, column in the cell, lane] to rows and columns.
        phases = total.view(total.shape[0], stride, stride, lanes, *total.shape[-2:]).permute(0, 4, 1, 5, 3, 2)
        pixels = phases.flatten(3).flatten(1, 2)[..., : padded[0], : padded[1]]
        folded = _folded(_folded(pixels, 1, self.side // 2), 2, self.side // 2)
        return folded.unflatten(0, values.shape[:2])


def _written(*pairs):
    """Return the correlations of filters with a picture each, one after the other, on a CPU."""
    filters, image = pairs[0]
    batch, channels, *size = image.shape
    rows, columns = filters.size(size)
    count = filters.count if len(pairs) == 1 else sum(filters.count for filters, _ in pairs)
    result, place = image.new_empty(rows, batch, channels, count, columns), 0
    for filters, image in pairs:
        filters.write(image, result[:, :, :, place : place + filters.count])
        place += filters.count
    return result.permute(1, 2, 3, 0, 4)


def _plainly(*pairs):
    """Return what :func:`_written` does, by differentiable operations of torch."""
    found = [filters.plainly(image) for filters, image in pairs]
    return torch.cat(found, 2) if len(found) > 1 else found[0]


class _Levels(NamedTuple):
    """The linear map from pictures of a size to their pyramid.

    It gives the bands ``[B, C, K, H, W]`` of each level, after the high-pass residual in the first one, and then each
    level's low-pass ``[B, C, H, W]``. 2 × 2 means count `weight` times.
    """

    high: Filters
    first: Filters
    bands: Filters
    low: Filters | None
    n_levels: int
    size: Sequence[int]
    weight: int = 1

    def forward(self, image, found=_written):
        """Return the levels by :func:`_written`, or by another function of filters and pictures."""
        groups, passed = [], [found((self.first, image))[:, :, 0]]
        for level in range(self.n_levels - 1):
            low = passed[-1]
            more = [] if level else [(self.high, image)]
            groups.append(found(*more, (self.bands, low)))
            passed.append(self._halved(low) if self.low is None else found((self.low, low))[:, :, 0])
        return (*groups, *passed)

    def _halved(self, low):
        return self.weight * functional.adaptive_avg_pool2d(low, _halved_size(low.shape[-2:]))

    def adjoint(self, *values, spread=Filters.spread):
        """Return the adjoint for values of which some are None."""
        sizes = [tuple(self.size)]
        for _ in range(self.n_levels - 1):
            sizes.append(_halved_size(sizes[-1]) if self.low is None else self.low.size(sizes[-1]))
        total = values[-1]
        for level in range(self.n_levels - 2, -1, -1):
            bands, size = values[level], sizes[level]
            if total is not None and self.low is None:
                total = self.weight * _torch_private.spread_means(total, size)
            elif total is not None:
                total = spread(self.low, total[:, :, None], size)
            rest = None if bands is None else spread(self.bands, bands if level else bands[:, :, 1:], size)
            total = _sum(total, rest, values[self.n_levels - 1 + level])
        total = None if total is None else spread(self.first, total[:, :, None], self.size)
        return _sum(total, None if values[0] is None else spread(self.high, values[0][:, :, :1], self.size))


def _sum(*parts):
    parts = [part for part in parts if part is not None]
    # In place: all but the last are made here, and a picture more takes time to allocate.
    return functools.reduce(torch.Tensor.add_, parts) if parts else None


def _halved_size(size):
    return tuple(max(1, side // 2) for side in size)


def correlate(image: torch.Tensor, taps: torch.Tensor, stride: int = 1) -> torch.Tensor:
    """Return the correlations of every plane, mirrored at its borders, with every filter.

    Parameters
    ----------
    image : torch.Tensor
        Real floats ``[B, C, H, W]``, sides longer than half a filter.
    taps : torch.Tensor
        Filters ``[K, k, k]`` of odd k, the same for all channels, in the image's precision.
    stride : int
        Every so many rows and columns, from the first on.

    Returns
    -------
    torch.Tensor
        ``[B, C, K, H / stride, W / stride]``, rounded up; differentiable any number of times in the image. On a CPU its
        memory is laid out as ``[H, B, C, K, W]``, which is what samplers of :mod:`odak.learn.perception.foveation`
        read fastest.
    """
    return Filters(taps, stride)(image)


def _as_channels_last(planes):
    """Return contiguous planes ``[N, H, W]`` as ``[N, 1, H, W]``, laid out so that output channels are vectorised."""
    return planes[..., None].permute(0, 3, 1, 2)


def _shifted(filters, lanes, step):
    """Return filters ``[F, h, w]`` at `lanes` places along the row, `step` columns apart, ``[F·lanes, 1, h, …]``."""
    room = (lanes - 1) * step
    wide = functional.pad(filters, (room, room))
    places = wide.unfold(-1, filters.shape[-1] + room, step).flip(-2)
    return places.transpose(1, 2).flatten(0, 1)[:, None].contiguous(memory_format=torch.channels_last)


def _phases(filt, stride):
    """Return the parts of a filter for each phase of the pixels, reversed along both axes."""
    room = -filt.shape[-1] % stride
    parts = functional.pad(filt, (0, room, 0, room)).unflatten(1, (-1, stride)).unflatten(0, (-1, stride))
    return parts.permute(1, 3, 0, 2).flatten(0, 1).flip(-2, -1)


def _folded(planes, axis, reach):
    """Return the adjoint of mirroring an axis at both ends: mirrored samples are added to their sources."""
    length = planes.shape[axis] - 2 * reach
    middle = planes.narrow(axis, reach, length)
    if reach:
        middle.narrow(axis, 1, reach).add_(planes.narrow(axis, 0, reach).flip(axis))
        middle.narrow(axis, length - 1 - reach, reach).add_(planes.narrow(axis, reach + length, reach).flip(axis))
    return middle


# Taps of the usual banks, designed once.
KEPT = ("data", "steerable_pyramid_taps.json")
# Points per axis of the grid of frequencies on which the responses are prescribed.
GRID = 24
FOOT = 0.55
# Weight of the distance from the ideal response relative to flatness; see the notes.
PULL, BAND_PULL = 0.05, 0.15
ALIASING, SUMS, FLOOR, SPLIT = 3.0, 100.0, 0.01, 1.0
STEPS, TOLERANCE, DAMPING = 100, 1e-6, 1e-9


def ideal_gains(radius: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the ideal gains of the high-pass residual, the first low-pass, the bands together and the low-pass.

    Parameters
    ----------
    radius : numpy.ndarray
        Length of the frequency vector in radians per pixel.

    Returns
    -------
    tuple of numpy.ndarray
        H₀(r) = H(r/2), L₀(r) = L(r/2)/2, H(r), L(r), for which H₀² + L₀² = 1 and H² + L²/4 = 1.

    Notes
    -----
    Portilla and Simoncelli, Int. J. Comput. Vis. 40, 49 (2000), eqs. 1 to 4: a raised cosine over
    log₂ r, one octave wide.
    """
    high = [np.sin(_octave_angle(radius / scale)) for scale in (2, 1)]
    low = [np.cos(_octave_angle(radius / scale)) for scale in (2, 1)]
    return high[0], low[0], high[1], 2 * low[1]


def band_amplitude(n_orientations: int) -> float:
    """Return a = 2ᴷ⁻¹(K−1)!/√(K(2K−2)!), for which Σₖ a²·cos²⁽ᴷ⁻¹⁾(θ − πk/K) = 1."""
    order = n_orientations - 1
    return 2**order * math.factorial(order) / math.sqrt(n_orientations * math.factorial(2 * order))


def steering(n_orientations: int, angles: np.ndarray) -> np.ndarray:
    """Return the coefficients of the K products cosⁱθ·sin^(K−1−i)θ in a·cosᴷ⁻¹(θ − angle).

    Parameters
    ----------
    n_orientations : int
        K.
    angles : numpy.ndarray
        ``[A]``, in radians.

    Returns
    -------
    numpy.ndarray
        ``[A, K]``.
    """
    order = n_orientations - 1
    index = np.arange(n_orientations)
    binomial = np.array([math.comb(order, i) for i in index], dtype=float)
    # 0⁰ is 1 here, as it is in NumPy.
    powers = np.cos(angles)[:, None] ** index * np.sin(angles)[:, None] ** (order - index)
    return band_amplitude(n_orientations) * binomial * powers


@functools.lru_cache(maxsize=64)
def design(n_orientations: int, sizes: tuple[int, int, int, int], bilinear: bool = False) -> dict[str, np.ndarray]:
    """Return filters whose pyramid reconstructs a picture nearly perfectly.

    Parameters
    ----------
    n_orientations : int
        Number K ≥ 1 of orientations.
    sizes : tuple of int
        Odd sizes of the low-pass "l", the first low-pass "l0", the high-pass residual "h0" and the bands.
    bilinear : bool
        For a pyramid whose levels are halved by 2 × 2 means and enlarged bilinearly, rather than by "l".

    Returns
    -------
    dict
        "l", "l0", "h0": ``[k, k]``; "b": ``[K, k, k]``, to be applied by correlation; "steerable": the filters
        ``[K, k, k]`` that bands are mixtures of; all float64, read-only.

    Notes
    -----
    Starts from the linear least-squares fit to the ideal responses of Portilla and Simoncelli (2000). Minimised
    together: the deviation from 1 of T = H₀² + L₀²(Σₖ|Bₖ|² + L²/4) and of H₀² + L₀², the deviation of the inner sum as
    the next level is computed from it, the aliasing L(ω)L(ω + π)/4 along one axis and both, the filters' sums, and the
    distance from the ideal responses. A bilinear pyramid has cos⁴(ωₓ/2)·cos⁴(ω_y/2) in place of L²/4, from halving and
    enlarging alone, and its ideal bands are what this leaves; "l" is not used then.
    """
    problem = _Problem(n_orientations, sizes, bilinear)
    kept = _kept().get(_key(n_orientations, sizes, bilinear))
    filters = problem.filters(_descend(problem) if kept is None else np.array(kept))
    for value in filters.values():
        value.setflags(write=False)
    return filters


def keep(banks: list[tuple[int, tuple[int, int, int, int], bool]], path: Path) -> None:
    """Write the taps of designs to a file, from which :func:`design` takes them without designing them again.

    Parameters
    ----------
    banks : list of tuple
        Arguments of :func:`design`.
    path : Path
        The file; the library's own is `KEPT` beside this module.
    """
    taps = {_key(*bank): _descend(_Problem(*bank)).tolist() for bank in banks}
    path.write_text("{\n" + ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in taps.items()) + "\n}\n")


@functools.cache
def _kept():
    return json.loads(resources.files("odak.learn.perception").joinpath(*KEPT).read_text(encoding="utf-8"))


def _key(n_orientations, sizes, bilinear):
    return f"{n_orientations} {' '.join(map(str, sizes))}" + (" bilinear" if bilinear else "")


def _descend(problem) -> np.ndarray:
    """Return the taps of least cost, by Levenberg and Marquardt's damped Gauss–Newton steps."""
    taps, damping = problem.start(), 1e-4
    residual, jacobian = problem.residual(taps)
    cost = residual @ residual + problem.quadratic_cost(taps)
    for _ in range(STEPS):
        normal = problem.normal + jacobian.T @ jacobian
        gradient = problem.normal @ taps - problem.pulled + jacobian.T @ residual
        normal[np.diag_indices_from(normal)] += damping
        trial = taps - np.linalg.solve(normal, gradient)
        residual_there, jacobian_there = problem.residual(trial)
        cost_there = residual_there @ residual_there + problem.quadratic_cost(trial)
        if cost_there >= cost:
            damping *= 4
            continue
        gain = (cost - cost_there) / cost
        taps, residual, jacobian, cost, damping = trial, residual_there, jacobian_there, cost_there, damping / 4
        if gain < TOLERANCE:
            break
    return taps


def orientations(n_orientations: int) -> np.ndarray:
    """Return the K angles πk/K in radians, counter-clockwise with y upwards."""
    return np.arange(n_orientations) * math.pi / n_orientations


def quadrature(bands: np.ndarray, size: int) -> np.ndarray:
    """Return the filters that are a quarter of a cycle behind the bands of a bank.

    Parameters
    ----------
    bands : numpy.ndarray
        ``[K, k, k]`` as :func:`design` returns them, to be applied by correlation.
    size : int
        Odd size of the filters.

    Returns
    -------
    numpy.ndarray
        ``[K, size, size]``, each of sum 0: where a band gives cos φ for a grating that runs along its orientation, its
        filter gives sin φ.

    Notes
    -----
    Least squares on Q(ω) = −i·sign(ω·u)·B(ω) over a grid of the whole plane, each frequency weighted by the amplitude
    1/|ω| that pictures have, with the response at zero held by a large weight.
    """
    frequencies = 2 * math.pi * (np.arange(2 * GRID) + 0.5) / (2 * GRID) - math.pi
    x, down = np.meshgrid(frequencies, frequencies)
    x, down = np.append(x.ravel(), 0.0), np.append(down.ravel(), 0.0)

    def waves(side):
        offset = np.arange(side) - side // 2
        return np.exp(1j * (down[:, None] * np.repeat(offset, side) + x[:, None] * np.tile(offset, side)))

    weight = 1 / np.maximum(np.hypot(x, down), FOOT)
    weight[-1] = SUMS
    equations = waves(size) * weight[:, None]
    toward = np.cos(orientations(len(bands)))[:, None] * x - np.sin(orientations(len(bands)))[:, None] * down
    wanted = -1j * np.sign(toward) * (waves(bands.shape[-1]) @ bands.reshape(len(bands), -1).T).T * weight
    stacked = np.concatenate([equations.real, equations.imag])
    taps = np.linalg.lstsq(stacked, np.concatenate([wanted.real, wanted.imag], 1).T, rcond=1e-10)[0]
    taps -= taps.mean(0)
    return taps.T.reshape(len(bands), size, size)


class _Problem:
    """Unknown taps of a bank, the responses they give and the residuals of its flatness.

    The taps of l, l0, h0 and of half of the products Mᵢ stand in one vector of `length`. Each of these filters is a
    tensor ``[length, k, k]`` of what each tap adds to it, and its gains at the grid's frequencies are a matrix
    ``[points, length]`` times the taps.
    """

    def __init__(self, n_orientations: int, sizes: tuple[int, int, int, int], bilinear: bool) -> None:
        self.count, self.bilinear = n_orientations, bilinear
        axis = np.linspace(0, math.pi, GRID)
        self.x, self.y = np.meshgrid(axis, axis, indexing="xy")
        order = n_orientations - 1
        half = range((order + 2) // 2)
        parities = [(0, 0)] * 3 + [(i % 2, (order - i) % 2) for i in half]
        sides = [*sizes[:3], *[sizes[3]] * len(half)]
        symmetric = [True] * 3 + [2 * i == order for i in half]
        bases = [_symmetric_taps(*one) for one in zip(sides, parities, symmetric, strict=True)]
        ends = np.cumsum([len(basis) for basis in bases])
        self.length = int(ends[-1])
        self.slices = [slice(end - len(basis), end) for basis, end in zip(bases, ends, strict=True)]
        self.bases = [self._placed(0, *one) for one in zip(self.slices, bases, strict=True)]
        gains = [self._response(*one) for one in zip(bases, parities, strict=True)]
        self.responses = [self._placed(1, *one) for one in zip(self.slices, gains, strict=True)]
        self.halved = self._placed(1, self.slices[0], self._response(bases[0], (0, 0), 0.5))
        self.products = [self._product(i) for i in range(n_orientations)]
        self.ideals = self._ideals(half)
        # C with Σₖ|Bₖ|² = Σᵢⱼ Cᵢⱼ·Mᵢ·Mⱼ for the products Mᵢ.
        shares = steering(n_orientations, orientations(n_orientations))
        self.power = shares.T @ shares
        self.normal, self.pulled, self.constant = self._quadratic()

    def _placed(self, axis, where, values):
        """Return the entries of some taps along an axis of all taps."""
        placed = np.zeros((*values.shape[:axis], self.length, *values.shape[axis + 1 :]))
        placed[(slice(None),) * axis + (where,)] = values
        return placed

    def _ideals(self, half):
        """Return the ideal gains of l, l0, h0 and half of the products."""
        radius, angle = np.hypot(self.x, self.y), np.arctan2(self.y, self.x)
        high0, low0, band, _ = ideal_gains(radius)
        # A tail below the octave, so that small filters keep their sign down to low frequencies.
        band = np.maximum(band, np.minimum(FOOT * radius * 4 / math.pi, FOOT))
        if self.bilinear:
            band = np.sqrt(1 - self._bilinear_gain(1.0))
        products = [band * np.cos(angle) ** i * np.sin(angle) ** (self.count - 1 - i) for i in half]
        return [gains.ravel() for gains in (2 * np.sqrt(1 - band**2), low0, high0, *products)]

    def _response(self, basis, parity, scale=1.0):
        """Return the gains of a filter at the grid's frequencies times a scale."""
        size = basis.shape[-1]
        offset = np.arange(size) - size // 2
        # Rows grow downwards and y upwards; odd products stand for −j times a real gain.
        along_x = [np.cos, np.sin][parity[0]](scale * self.x.ravel()[:, None] * offset)
        along_y = [np.cos, np.sin][parity[1]](scale * self.y.ravel()[:, None] * -offset)
        sign = -1.0 if any(parity) else 1.0
        outer = along_y[:, :, None] * along_x[:, None, :]
        return sign * outer.reshape(-1, size * size) @ basis.reshape(len(basis), -1).T

    def _product(self, i):
        """Return the filter and the gains of the product cosⁱθ·sin^(K−1−i)θ, whose other half mirrors the first."""
        if 2 * i <= self.count - 1:
            return self.bases[3 + i], self.responses[3 + i]
        # x and y are exchanged; both axes of the filter are flipped because rows grow downwards.
        mirrored, gains = self.bases[2 + self.count - i], self.responses[2 + self.count - i]
        gains = gains.reshape(GRID, GRID, -1).transpose(1, 0, 2).reshape(GRID * GRID, -1)
        return mirrored.transpose(0, 2, 1)[:, ::-1, ::-1], gains

    def _relevance(self, part):
        """Return weights of the frequencies: the bands and the low-pass follow the first low-pass."""
        ideal_low0 = self.ideals[1]
        return np.ones_like(ideal_low0) if part in (1, 2) else np.maximum(ideal_low0**2, FLOOR)

    def start(self):
        taps = np.zeros(self.length)
        for part, (where, ideal) in enumerate(zip(self.slices, self.ideals, strict=True)):
            weight, response = np.sqrt(self._relevance(part)), self.responses[part][:, where]
            taps[where] = np.linalg.lstsq(response * weight[:, None], ideal * weight, rcond=1e-10)[0]
        return taps

    def residual(self, taps):
        """Return every residual ``[m]`` that is not quadratic, and its Jacobian ``[m, n]``."""
        (low0, by_low0), (high0, by_high0) = ((gains @ taps, gains) for gains in self.responses[1:3])
        inner, by_inner = self._inner(taps)
        # A coarser level gets what the low-pass transmits at half the frequency.
        passed, by_passed = self._passed(taps, self.halved, 0.5)
        first, residual = (2 * low0)[:, None] * by_low0, (2 * high0)[:, None] * by_high0
        flat = high0**2 + low0**2 * inner - 1, (low0**2)[:, None] * by_inner + inner[:, None] * first + residual
        deep = passed * (inner - 1), passed[:, None] * by_inner + (inner - 1)[:, None] * by_passed
        # Small bands do not respond to one-pixel stripes: there the first low-pass would be undetermined.
        split = SPLIT * (high0**2 + low0**2 - 1), SPLIT * (first + residual)
        rows = [flat, deep, split] if self.bilinear else [flat, deep, split, *self._aliases(taps)]
        return tuple(np.concatenate(part) / GRID for part in zip(*rows, strict=True))

    def _inner(self, taps):
        """Return Σₖ|Bₖ|² + L²/4 and its Jacobian: the power of the bands and the low-pass of one level together."""
        products = np.array([gains @ taps for _, gains in self.products])
        mixed = self.power @ products
        passed, by_passed = self._passed(taps, self.responses[0], 1.0)
        by_products = (2 * row[:, None] * gains for row, (_, gains) in zip(mixed, self.products, strict=True))
        return (products * mixed).sum(0) + passed, sum(by_products, by_passed)

    def _passed(self, taps, response, scale):
        """Return the gain of halving and enlarging at scaled frequencies, and its Jacobian."""
        if self.bilinear:
            return self._bilinear_gain(scale).ravel(), np.zeros_like(response)
        low = response @ taps
        return low**2 / 4, (low / 2)[:, None] * response

    def _bilinear_gain(self, scale):
        # The mean of two pixels has the gain cos(ω/2), taking every second pixel 1/2, bilinear enlargement 2·cos³(ω/2).
        return np.cos(scale * self.x / 2) ** 4 * np.cos(scale * self.y / 2) ** 4

    def _aliases(self, taps):
        """Return the aliases of a frequency from half the sampling rate away, along one axis and along both."""
        grid = self.responses[0].reshape(GRID, GRID, -1)
        # π − ω is on the grid too, and L is even.
        for folded in (grid[:, ::-1].reshape(GRID**2, -1), grid[::-1, ::-1].reshape(GRID**2, -1)):
            one, two = self.responses[0] @ taps, folded @ taps
            by_both = one[:, None] * folded + two[:, None] * self.responses[0]
            yield ALIASING / 4 * one * two, ALIASING / 4 * by_both

    def quadratic_cost(self, taps):
        """Return the cost of the filters' sums and of the distance from the ideal responses, up to a constant."""
        return taps @ self.normal @ taps - 2 * taps @ self.pulled + self.constant

    def _quadratic(self):
        normal, pulled, constant = DAMPING * np.eye(self.length), np.zeros(self.length), 0.0
        for part, (where, ideal) in enumerate(zip(self.slices, self.ideals, strict=True)):
            wanted, pull = {0: 2.0, 1: 1.0}.get(part, 0.0), PULL if part < 3 else BAND_PULL
            weight, response = (pull / GRID) ** 2 * self._relevance(part), self.responses[part][:, where]
            row = SUMS * self.bases[part][where].sum((1, 2))
            normal[where, where] += response.T @ (weight[:, None] * response) + np.outer(row, row)
            pulled[where] += response.T @ (weight * ideal) + SUMS * wanted * row
            constant += weight @ ideal**2 + (SUMS * wanted) ** 2
        return normal, pulled, constant

    def filters(self, taps):
        low, low0, high0 = (np.tensordot(taps, basis, 1) for basis in self.bases[:3])
        products = np.array([np.tensordot(taps, basis, 1) for basis, _ in self.products])
        bands = np.tensordot(steering(self.count, orientations(self.count)), products, 1)
        return {"l": low, "l0": low0, "h0": high0, "b": bands, "steerable": products}


def _octave_angle(radius):
    """Return an angle that rises from 0 at π/4 to π/2 at π/2 over one octave of the radius."""
    position = np.log2(np.maximum(radius, 1e-12) * 4 / math.pi)
    return np.clip(position, 0, 1) * math.pi / 2


def _symmetric_taps(size, parity, symmetric):
    """Return an orthogonal basis ``[n, k, k]`` of the filters that are even (0) or odd (1) along x and y."""
    columns, rows = ([_line(size, offset, odd) for offset in range(odd, size // 2 + 1)] for odd in parity)
    basis = [np.outer(row, column) for row in rows for column in columns]
    if symmetric:
        basis = [
            np.outer(rows[i], columns[j]) + (np.outer(rows[j], columns[i]) if i != j else 0)
            for i in range(len(rows))
            for j in range(i + 1)
        ]
    return np.array(basis)


def _line(size, offset, odd):
    line = np.zeros(size)
    line[size // 2 + offset] = 1.0
    line[size // 2 - offset] = -1.0 if odd else 1.0
    return line
