"""Losses and contrasts of images, differentiable unless said otherwise."""

import operator
from collections.abc import Iterable, Sequence

import torch

from odak import _array, _validate
from odak.learn._tensors import floating, real_tensor


def total_variation_loss(frame: torch.Tensor) -> torch.Tensor:
    """Return (Σ dx² + Σ dy²)/(B·C·H·W), dx and dy being the differences between neighbours.

    Parameters
    ----------
    frame : torch.Tensor
        ``[H, W]``, ``[C, H, W]`` or ``[B, C, H, W]``.

    Returns
    -------
    torch.Tensor
        The loss, without axes.

    Raises
    ------
    ValueError, TypeError
        If the frame has other axes or is not real.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import total_variation_loss
    >>> total_variation_loss(torch.tensor([[0.0, 1.0], [2.0, 4.0]])).item()
    4.5
    """
    frame = _as_batch("frame", frame)
    return sum((difference**2).sum() for difference in _differences(frame)) / frame.numel()


def multi_scale_total_variation_loss(frame: torch.Tensor, levels: int = 3) -> torch.Tensor:
    """Return the sum of :func:`total_variation_loss` over a frame and its smaller copies.

    Parameters
    ----------
    frame : torch.Tensor
        ``[H, W]``, ``[C, H, W]`` or ``[B, C, H, W]``.
    levels : int
        Number of sizes; each takes every second sample of the one before.

    Returns
    -------
    torch.Tensor
        The loss, without axes.

    Raises
    ------
    ValueError, TypeError
        If the frame has other axes, is not real or is too small for so many levels.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import multi_scale_total_variation_loss
    >>> multi_scale_total_variation_loss(torch.ones(16, 16)).item()
    0.0
    """
    frame = _as_batch("frame", frame)
    levels = _validate.integer("levels", levels, minimum=1)
    if min(frame.shape[-2:]) >> (levels - 1) == 0:
        raise ValueError(f"levels must leave a sample of a frame of {tuple(frame.shape[-2:])}, got {levels}")
    loss = total_variation_loss(frame)
    for _ in range(levels - 1):
        rows, columns = (2 * (n // 2) for n in frame.shape[-2:])
        frame = frame[..., :rows:2, :columns:2]
        loss = loss + total_variation_loss(frame)
    return loss


def spatial_gradient(frame: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the differences between neighbours.

    Parameters
    ----------
    frame : torch.Tensor
        ``[H, W]``, ``[C, H, W]`` or ``[B, C, H, W]``.

    Returns
    -------
    tuple of torch.Tensor
        Right minus left ``[B, C, H, W − 1]`` and lower minus upper ``[B, C, H − 1, W]``.

    Raises
    ------
    ValueError, TypeError
        If the frame has other axes or is not real.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import spatial_gradient
    >>> along_x, along_y = spatial_gradient(torch.tensor([[0.0, 1.0], [2.0, 5.0]]))
    >>> along_x.flatten().tolist(), along_y.flatten().tolist()
    ([1.0, 3.0], [2.0, 4.0])
    """
    return _differences(_as_batch("frame", frame))


def radial_basis_function(value: torch.Tensor, epsilon: float = 0.5) -> torch.Tensor:
    """Return the Gaussian radial basis function exp(−(ε·x)²) of each value.

    Parameters
    ----------
    value : torch.Tensor
        Distances x, of any shape.
    epsilon : float
        Inverse width ε.

    Returns
    -------
    torch.Tensor
        1 at x = 0, of the shape of `value`.

    Examples
    --------
    exp(−1):

    >>> import torch
    >>> from odak.learn.tools import radial_basis_function
    >>> round(radial_basis_function(torch.tensor(2.0), epsilon=0.5).item(), 4)
    0.3679
    """
    if not isinstance(epsilon, torch.Tensor):
        _validate.real("epsilon", epsilon)
    return torch.exp(-((epsilon * floating("value", value)) ** 2))


def histogram_loss(
    frame: torch.Tensor,
    ground_truth: torch.Tensor,
    bins: int = 32,
    limits: Sequence[float] = (0.0, 1.0),
    *,
    soft: bool = False,
) -> torch.Tensor:
    """Return the mean squared difference of two histograms, in counts, over channels and bins.

    Parameters
    ----------
    frame : torch.Tensor
        Image, ``[H, W]``, ``[C, H, W]`` or ``[B, C, H, W]``; a batch is counted together.
    ground_truth : torch.Tensor
        Image to compare with, with as many channels.
    bins : int
        Number of bins.
    limits : sequence of float
        Lower and upper limit. Values outside do not count; the upper limit belongs to the last bin.
    soft : bool
        Share each value between the two bins whose centres enclose it, which makes the loss differentiable. Counts
        of whole values have no gradient.

    Returns
    -------
    torch.Tensor
        The loss, without axes.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    The positions of the values do not matter:

    >>> import torch
    >>> from odak.learn.tools import histogram_loss
    >>> image = torch.linspace(0, 1, 64).reshape(8, 8)
    >>> histogram_loss(image, image.flip(0)).item()
    0.0
    """
    bins = _validate.integer("bins", bins, minimum=1)
    low, high = _validate.few("limits", limits, 2, rising=True)
    soft = _validate.flag("soft", soft)
    frame, ground_truth = _as_batch("frame", frame), _as_batch("ground_truth", ground_truth)
    _validate.one_device(frame=frame, ground_truth=ground_truth)
    if frame.shape[1] != ground_truth.shape[1]:
        raise ValueError(
            f"frame and ground_truth must have as many channels, got {frame.shape[1]} and {ground_truth.shape[1]}"
        )
    one, two = (_histogram(values, bins, low, high, soft) for values in (frame, ground_truth))
    return ((one - two) ** 2).mean()


def weber_contrast(image: torch.Tensor, roi_high: Sequence[int], roi_low: Sequence[int]) -> torch.Tensor:
    """Return Weber's contrast (H − L)/L of the mean values H and L in two regions.

    Parameters
    ----------
    image : torch.Tensor
        ``[H, W]``, ``[C, H, W]`` or ``[B, C, H, W]``.
    roi_high : sequence of int
        Bright region ``[first row, last row + 1, first column, last column + 1]``.
    roi_low : sequence of int
        Dark region, likewise.

    Returns
    -------
    torch.Tensor
        ``[C]``, or ``[B, C]`` when there are several images; infinite or not a number where L = 0.

    Raises
    ------
    ValueError, TypeError
        If a region is empty or leaves the image, or the image has other axes.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import weber_contrast
    >>> weber_contrast(torch.tensor([[3.0, 1.0]]), [0, 1, 0, 1], [0, 1, 1, 2]).item()
    2.0
    """
    high, low = region_means(image, roi_high, roi_low)
    return (high - low) / low


def michelson_contrast(image: torch.Tensor, roi_high: Sequence[int], roi_low: Sequence[int]) -> torch.Tensor:
    """Return Michelson's contrast (H − L)/(H + L) of the mean values H and L in two regions.

    Parameters
    ----------
    image : torch.Tensor
        ``[H, W]``, ``[C, H, W]`` or ``[B, C, H, W]``.
    roi_high : sequence of int
        Bright region ``[first row, last row + 1, first column, last column + 1]``.
    roi_low : sequence of int
        Dark region, likewise.

    Returns
    -------
    torch.Tensor
        ``[C]``, or ``[B, C]`` when there are several images; not a number where H + L = 0.

    Raises
    ------
    ValueError, TypeError
        If a region is empty or leaves the image, or the image has other axes.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import michelson_contrast
    >>> michelson_contrast(torch.tensor([[3.0, 1.0]]), [0, 1, 0, 1], [0, 1, 1, 2]).item()
    0.5
    """
    high, low = region_means(image, roi_high, roi_low)
    return (high - low) / (high + low)


def wrapped_mean_squared_error(
    image: torch.Tensor, ground_truth: torch.Tensor, reduction: str = "mean"
) -> torch.Tensor:
    """Return the squared distance of angles on the unit circle, (sin a − sin b)² + (cos a − cos b)² = 2 − 2·cos(a − b).

    Parameters
    ----------
    image : torch.Tensor
        Angles in radians.
    ground_truth : torch.Tensor
        Angles to compare with, in radians, of the same shape.
    reduction : {"mean", "sum"}
        Reduction of the values to one.

    Returns
    -------
    torch.Tensor
        The loss, without axes; 0 where the angles differ by multiples of 2π.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ, the angles are not real tensors, or the reduction is not known.

    Examples
    --------
    Angles that differ by 2π are the same:

    >>> import torch
    >>> from odak.learn.tools import wrapped_mean_squared_error
    >>> angles = torch.tensor([0.0, 1.0])
    >>> round(wrapped_mean_squared_error(angles, angles + 2 * torch.pi).item(), 6)
    0.0
    """
    reduction = _validate.one_of("reduction", reduction, ("mean", "sum"))
    _same_shape("image", image, "ground_truth", ground_truth)
    image, ground_truth = floating("image", image), floating("ground_truth", ground_truth)
    # 2 − 2·cos δ = 4·sin²(δ/2), which keeps its digits at small δ.
    squared = 4 * torch.sin((image - ground_truth) / 2) ** 2
    return squared.mean() if reduction == "mean" else squared.sum()


def psnr(
    image: torch.Tensor, ground_truth: torch.Tensor, peak_value: float = 1.0, reduction: str = "pooled"
) -> torch.Tensor:
    """Return the peak signal-to-noise ratio 10·log₁₀(peak²/MSE) in decibels.

    Parameters
    ----------
    image : torch.Tensor
        Image.
    ground_truth : torch.Tensor
        Image to compare with, of the same shape.
    peak_value : float
        Largest value that the image could have.
    reduction : {"pooled", "mean", "none"}
        The ratio of the mean squared error of a whole batch; the mean of the ratios of its images; or one for each.
        The images of a batch ``[..., C, H, W]`` are its last three axes. Two images of 20 and 40 dB have 23.0 dB
        pooled, and 30 dB on average.

    Returns
    -------
    torch.Tensor
        Decibels, without axes, or ``[...]`` with "none"; infinite for equal images, with a gradient of 0.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ, the peak is not positive, or the reduction is not known.

    Examples
    --------
    An error of 0.1 everywhere is 20 dB below the peak:

    >>> import torch
    >>> from odak.learn.tools import psnr
    >>> target = torch.zeros(8, 8)
    >>> round(psnr(target + 0.1, target).item(), 3)
    20.0
    """
    _same_shape("image", image, "ground_truth", ground_truth)
    _validate.real("peak_value", peak_value, positive=True)
    reduction = _validate.one_of("reduction", reduction, ("pooled", "mean", "none"))
    image, ground_truth = (value if value.is_floating_point() else value.float() for value in (image, ground_truth))
    for name, picture in (("image", image), ("ground_truth", ground_truth)):
        if _array.is_readable(picture) and picture.numel():
            remedy = "divide by 255, or give peak_value=255" if peak_value == 1 else None
            _validate.check_values(name, picture, remedy, refuse=False)
    squared = (image - ground_truth).square()
    error = squared.mean() if reduction == "pooled" else squared.flatten(max(squared.ndim - 3, 0)).mean(-1)
    equal = error == 0
    ratio = torch.where(equal, torch.inf, 10 * torch.log10(peak_value**2 / torch.where(equal, 1.0, error)))
    return ratio.mean() if reduction == "mean" else ratio


def _differences(batch):
    return batch[..., 1:] - batch[..., :-1], batch[..., 1:, :] - batch[..., :-1, :]


def _as_batch(name, frame):
    """Return a real frame as ``[B, C, H, W]``, integers as float32."""
    real_tensor(name, frame)
    _validate.shaped(name, frame, "[H, W], [C, H, W] or [B, C, H, W], none empty")
    frame = frame if frame.is_floating_point() else frame.float()
    return frame.reshape((1,) * (4 - frame.ndim) + tuple(frame.shape))


def _same_shape(name, value, other_name, other):
    for key, tensor in ((name, value), (other_name, other)):
        real_tensor(key, tensor)
    _validate.alike(**{name: value, other_name: other})


def _histogram(batch, bins, low, high, soft):
    """Return counts ``[C, bins]``."""
    values = batch.movedim(1, 0).reshape(batch.shape[1], -1)
    inside = ((values >= low) & (values <= high)).to(values.dtype)
    # Values that do not count weigh nothing, but their index must exist.
    place = (values.nan_to_num().clamp(low, high) - low) / (high - low) * bins
    counts = values.new_zeros(batch.shape[1], bins)
    if not soft:
        return counts.scatter_add(1, place.detach().long().clamp(max=bins - 1), inside)
    place = place - 0.5
    lower = place.detach().floor()
    share = (place - lower) * inside
    lower = lower.long()
    counts = counts.scatter_add(1, (lower + 1).clamp(max=bins - 1), share)
    return counts.scatter_add(1, lower.clamp(min=0), inside - share)


def region_means(image: torch.Tensor, *regions: Sequence[int]) -> list[torch.Tensor]:
    """Return the mean of each of two regions, as :func:`weber_contrast` takes them: ``[C]`` or ``[B, C]`` each."""
    batch = _as_batch("image", image)
    means = []
    for name, region in zip(("roi_high", "roi_low"), regions, strict=True):
        top, bottom, left, right = _checked_region(name, region, batch.shape[-2:])
        mean = batch[..., top:bottom, left:right].mean((-2, -1))
        means.append(mean[0] if len(mean) == 1 else mean)
    return means


def _checked_region(name, region, size):
    if isinstance(region, str) or not isinstance(region, Iterable) or len(region := list(region)) != 4:
        raise ValueError(f"{name} must be [first row, last row + 1, first column, last column + 1], got {region!r:.80}")
    try:
        region = [operator.index(edge) for edge in region]
    except TypeError as error:
        raise ValueError(f"{name} must contain integers, got {region!r:.80}") from error
    top, bottom, left, right = region
    if not (0 <= top < bottom <= size[0] and 0 <= left < right <= size[1]):
        raise ValueError(f"{name} must lie inside the image of {tuple(size)} and not be empty, got {region}")
    return region
