"""The filters of a spatial steerable pyramid as tensors: designed by the code, cropped, or derivative-like."""

from typing import Any

import numpy as np
import torch

from odak import _validate
from odak.learn._tensors import checked_device, checked_dtype
from odak.learn.perception import pyramid_filter_design

FILTER_TYPES = ("full", "cropped", "trained")
# Sizes of l, l0, h0 and the bands of the full bank.
FULL_SIZES = {1: (13, 7, 9, 9), 2: (17, 9, 9, 9), 6: (9, 5, 9, 7)}
OTHER_FULL_SIZES = (17, 9, 15, 9)
CROPPED_LOW, CROPPED_LOW0 = 13, 5
TRAINED_SIZE = 5
# Profiles across and along of a small derivative, and its largest tap.
TRAINED_ACROSS, TRAINED_ALONG, TRAINED_PEAK = (0.478, 1.0, 0.0, -1.0, -0.478), (0.155, 0.645, 1.0, 0.645, 0.155), 0.061


def get_steerable_pyramid_filters(
    size: int,
    n_orientations: int,
    filter_type: str,
    *,
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
    Designed by :func:`odak.learn.perception.pyramid_filter_design.design` on first use (under a second) and kept.
    Deviation of T = H₀² + L₀²(ΣBₖ² + L²/4) from 1 of the full banks: below 0.025 for K = 1, 2, 3, 4, 6.
    """
    count = _validate.integer("n_orientations", n_orientations, minimum=1)
    kind = _validate.one_of("filter_type", filter_type, FILTER_TYPES)
    sizes = FULL_SIZES.get(count, OTHER_FULL_SIZES)
    if kind != "full":
        sizes = _cropped_sizes(size, sizes)
    bank = pyramid_filter_design.design(count, sizes)
    bands = bank["b"]
    if kind == "trained":
        bands = _trained(size, count)
    options: dict[str, Any] = {"dtype": checked_dtype("dtype", dtype), "device": checked_device("device", device)}
    filters = {name: torch.tensor(bank[name], **options)[None, None] for name in ("l", "l0", "h0")}
    return {**filters, "b": [torch.tensor(band, **options)[None, None] for band in bands]}


def crop_steerable_pyramid_filters(filters: dict[str, Any], size: int) -> dict[str, Any]:
    """Return the middles of a bank's filters.

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
