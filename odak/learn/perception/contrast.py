"""Contrast of regions, and contrast that adapts to the picture's content."""

from collections.abc import Sequence

import torch

from odak import _validate
from odak.learn.tools import loss

_ALMOST_BLACK = 1e-12
_PIXELS_AT_ONCE = 1 << 22


def weber_contrast(image: torch.Tensor, roi_high: Sequence[int], roi_low: Sequence[int]) -> torch.Tensor:
    """Return Weber's contrast (H − L)/L of the mean values H and L in two regions.

    Parameters
    ----------
    image : torch.Tensor
        ``[H, W]``, ``[C, H, W]`` or ``[B, C, H, W]``.
    roi_high, roi_low : sequence of int
        Regions ``[first row, last row + 1, first column, last column + 1]``.

    Returns
    -------
    torch.Tensor
        ``[C]``, or ``[B, C]`` when there are several images; negative where the regions are swapped.

    Raises
    ------
    ValueError, TypeError
        If a region is empty or leaves the image, the image has other axes, or L is not positive.

    See Also
    --------
    odak.learn.tools.weber_contrast : The same without the check of L, for losses.
    """
    _require_positive("roi_low", loss.region_means(image, roi_high, roi_low)[1])
    return loss.weber_contrast(image, roi_high, roi_low)


def michelson_contrast(image: torch.Tensor, roi_high: Sequence[int], roi_low: Sequence[int]) -> torch.Tensor:
    """Return Michelson's contrast (H − L)/(H + L) of the mean values H and L in two regions.

    Parameters, result and errors are those of :func:`weber_contrast`, but it is H + L that must be positive.
    """
    _require_positive("roi_high and roi_low", sum(loss.region_means(image, roi_high, roi_low)))
    return loss.michelson_contrast(image, roi_high, roi_low)


def content_aware_contrast_ratio(
    image: torch.Tensor,
    window_size: int = 15,
    step: int = 3,
    pooling_percentile: float = 75.0,
    eps: float = 1e-6,
    max_iter: int = 100,
    lightness_channel: int = 0,
) -> dict | list[dict]:
    """Return the contrast between what is dark and what is bright in each window of a picture, and its pooled value.

    Parameters
    ----------
    image : torch.Tensor
        ``[H, W]``, ``[B, H, W]`` or ``[B, C, H, W]``; held to 0 … 1. Three axes whose first is above 100 are refused.
    window_size : int
        Side of a window, odd, at least 3.
    step : int
        Distance between windows.
    pooling_percentile : float
        The windows whose contrast is at least this percentile are pooled.
    eps, max_iter : float, int
        A window's threshold is found when it moves by no more than `eps`, or after so many iterations.
    lightness_channel : int
        Which channel of ``[B, C, H, W]`` is the lightness.

    Returns
    -------
    dict or list of dict
        One per picture (the dictionary itself for a single one): ``contrast_map``, ``threshold_map``,
        ``foreground_mean_map`` and ``background_mean_map`` ``[H, W]``, zero except at the windows' centres;
        ``pooled_harmonic_mean`` and ``max_contrast_ratio``; ``window_size``, ``step`` and ``n_patches``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Each window is split at the threshold that is the mean of the means on its two sides (ISODATA; Ridler and Calvard,
    IEEE Trans. Syst. Man Cybern. 8, 630 (1978)); its contrast is 1 − dark/bright. They are pooled by the
    harmonic mean.
    """
    pictures = _lightness(image, lightness_channel)
    _validate.number("eps", eps, least=0)
    side = _validate.integer("window_size", window_size, minimum=3)
    step = _validate.integer("step", step, minimum=1)
    if side % 2 == 0 or side > min(pictures.shape[-2:]):
        raise ValueError(f"window_size must be odd and fit the picture {tuple(pictures.shape[-2:])}, got {side}")
    if not 0 < _validate.number("pooling_percentile", pooling_percentile) <= 100:
        raise ValueError(f"pooling_percentile must be above 0 and at most 100, got {pooling_percentile!r}")
    results = []
    for picture in pictures:
        windows = picture.unfold(0, side, step).unfold(1, side, step)
        maps = _in_strips(windows, eps, _validate.integer("max_iter", max_iter, minimum=1))
        results.append(
            {name: _at_centres(values, picture, side, step) for name, values in maps.items()}
            | _pooled(maps["contrast_map"].flatten(), pooling_percentile)
            | {"window_size": side, "step": step, "n_patches": maps["contrast_map"].numel()}
        )
    return results[0] if len(results) == 1 else results


def _require_positive(names, value):
    if bool((value <= 0).any()):
        raise ValueError(f"{names} must have a positive mean, got {value.min().item():.6g}")


def _lightness(image, channel) -> torch.Tensor:
    """Return pictures ``[B, H, W]`` of 0 … 1."""
    channel = _validate.integer("lightness_channel", channel)
    if not isinstance(image, torch.Tensor) or image.is_complex():
        raise TypeError(f"image must be a real tensor, got {getattr(image, 'dtype', type(image).__name__)}")
    if image.ndim not in (2, 3, 4) or 0 in image.shape or (image.ndim == 3 and len(image) > 100):
        raise ValueError(
            f"image must be [H, W], [B, H, W] with B of at most 100, or [B, C, H, W]; got {tuple(image.shape)}"
        )
    if image.ndim == 4:
        if not 0 <= channel < image.shape[1]:
            raise ValueError(f"lightness_channel must be from 0 to {image.shape[1] - 1}, got {channel}")
        image = image[:, channel]
    # Half precision would lose the sums of windows.
    image = image if image.dtype in (torch.float32, torch.float64) else image.float()
    return image.reshape(-1, *image.shape[-2:]).clamp(0, 1)


def _in_strips(windows, eps, max_iter) -> dict[str, torch.Tensor]:
    """Return :func:`_split` of windows ``[rows, columns, side, side]``, so many at once as memory should hold."""
    rows = max(1, _PIXELS_AT_ONCE // windows[0].numel())
    parts = [_split(strip.flatten(-2), eps, max_iter) for strip in windows.split(rows)]
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}


def _split(windows, eps, max_iter) -> dict[str, torch.Tensor]:
    """Return contrast, threshold and the means on its two sides of windows ``[rows, columns, pixels]``."""
    ordered, threshold = windows.sort(-1).values, windows.mean(-1)
    sums = torch.nn.functional.pad(ordered.cumsum(-1, dtype=torch.float64), (1, 0))
    for _ in range(max_iter):
        dark, bright = _sides(ordered, sums, threshold)
        moved, threshold = threshold, (dark + bright) / 2
        if bool(((threshold - moved).abs() <= eps).all()):
            break
    dark, bright = _sides(ordered, sums, threshold)
    contrast = torch.where(bright > _ALMOST_BLACK, 1 - dark / bright.clamp_min(_ALMOST_BLACK), 0).clamp_min(0)
    return {
        "contrast_map": contrast,
        "threshold_map": threshold,
        "foreground_mean_map": dark,
        "background_mean_map": bright,
    }


def _sides(ordered, sums, threshold):
    """Return the means of the pixels below a threshold and of those from it on; the threshold where there are none.

    The pixels of a window come in ascending order, with the sums of the first 0, 1, … of them.
    """
    below = torch.searchsorted(ordered, threshold[..., None].detach())
    dark = sums.gather(-1, below)[..., 0]
    means = []
    for count, light in ((below[..., 0], dark), (ordered.shape[-1] - below[..., 0], sums[..., -1] - dark)):
        mean = (light / count.clamp_min(1)).to(ordered.dtype)
        means.append(torch.where(count > 0, mean, threshold))
    return means


def _at_centres(values, picture, side, step):
    result = torch.zeros_like(picture)
    rows, columns = ((count - 1) * step + 1 for count in values.shape)
    first = side // 2
    result[first : first + rows : step, first : first + columns : step] = values
    return result


def _pooled(contrast, percentile) -> dict[str, float]:
    # Of the sorted values, because torch.quantile refuses more than 16 million.
    ordered = contrast.sort().values
    place = percentile / 100 * (len(ordered) - 1)
    low = ordered[int(place)]
    bound = low + (ordered[min(int(place) + 1, len(ordered) - 1)] - low) * (place - int(place))
    kept = contrast[contrast >= bound]
    pooled = 0.0 if bool((kept <= 0).any()) else (len(kept) / (1 / kept).sum()).item()
    return {"pooled_harmonic_mean": pooled, "max_contrast_ratio": contrast.max().item()}
