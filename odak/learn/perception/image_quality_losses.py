"""PSNR, SSIM and MS-SSIM: differentiable, per picture, and loud about pictures that cannot be compared."""

import torch
from torch import nn

from odak import _validate
from odak.learn._precision import in_own_precision
from odak.learn.perception.util import checked_pair
from odak.learn.tools.loss import psnr

WINDOW, SIGMA = 11, 1.5
K1, K2 = 0.01, 0.03
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)


class PSNR(nn.Module):
    """Peak signal-to-noise ratio in decibels: the larger, the closer."""

    def forward(self, predictions: torch.Tensor, targets: torch.Tensor, peak_value: float = 1.0) -> torch.Tensor:
        """Return 10·log₁₀(peak²/MSE) over all values.

        Parameters
        ----------
        predictions, targets : torch.Tensor
            Pictures of one shape.
        peak_value : float
            Largest value that a picture could have.

        Returns
        -------
        torch.Tensor
            Decibels, without axes; infinite for equal pictures.

        Raises
        ------
        ValueError
            If the shapes differ, the peak is not positive, or values are NaN or far outside 0 … peak.
        """
        _validate.number("peak_value", peak_value, positive=True)
        return psnr(*checked_pair(predictions, targets, peak_value), peak_value)


class SSIM(nn.Module):
    """Structural similarity: 1 for equal pictures."""

    def forward(self, predictions: torch.Tensor, targets: torch.Tensor, data_range: float = 1.0) -> torch.Tensor:
        """Return :func:`structural_similarity`."""
        return structural_similarity(predictions, targets, data_range)


class MSSSIM(nn.Module):
    """Structural similarity at five scales: 1 for equal pictures."""

    def forward(self, predictions: torch.Tensor, targets: torch.Tensor, data_range: float = 1.0) -> torch.Tensor:
        """Return :func:`multi_scale_structural_similarity`."""
        return multi_scale_structural_similarity(predictions, targets, data_range)


def structural_similarity(predictions: torch.Tensor, targets: torch.Tensor, data_range: float = 1.0) -> torch.Tensor:
    """Return the mean structural similarity of pictures.

    Parameters
    ----------
    predictions, targets : torch.Tensor
        ``[..., H, W]`` of one shape, each side at least 11.
    data_range : float
        Largest value that a picture could have, less the smallest.

    Returns
    -------
    torch.Tensor
        Mean over every place where the window fits and over the leading axes, without axes, in the input's precision;
        exactly 1 for equal pictures. Differentiable.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ, a picture is smaller than the window, or it does not hold real floats of about
        0 … `data_range`.

    Notes
    -----
    Wang, Bovik, Sheikh and Simoncelli, IEEE Trans. Image Process. 13, 600 (2004): Gaussian window of 11 × 11 with
    σ = 1.5, K₁ = 0.01, K₂ = 0.03.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import structural_similarity
    >>> picture = torch.linspace(0, 1, 400).reshape(1, 20, 20)
    >>> structural_similarity(picture, picture).item()
    1.0
    """
    predictions, targets = _checked(predictions, targets, WINDOW, data_range)
    luminance, structure = _similarities(_planes(predictions), _planes(targets), data_range)
    return (luminance * structure).mean()


def multi_scale_structural_similarity(
    predictions: torch.Tensor, targets: torch.Tensor, data_range: float = 1.0
) -> torch.Tensor:
    """Return the mean multi-scale structural similarity of pictures.

    Parameters
    ----------
    predictions, targets : torch.Tensor
        ``[H, W]``, ``[C, H, W]`` or ``[..., C, H, W]`` of one shape, each side at least 176.
    data_range : float
        Largest value that a picture could have, less the smallest.

    Returns
    -------
    torch.Tensor
        Mean over the pictures, without axes, in the input's precision. A picture of which a scale's structure is
        negative on average scores 0, with a gradient of zero. Differentiable.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ, a picture is smaller than 176, or it does not hold real floats of about
        0 … `data_range`.

    Notes
    -----
    Wang, Simoncelli and Bovik, Asilomar Conf. Signals Syst. Comput. 37, 1398 (2003), eq. 7 with the weights of its
    section 3.2; halved between scales by 2 × 2 means.
    """
    predictions, targets = _checked(predictions, targets, WINDOW << (len(SCALE_WEIGHTS) - 1), data_range)
    pictures = predictions.shape[:-3].numel()
    one, two = _planes(predictions), _planes(targets)
    result = torch.ones((), dtype=one.dtype, device=one.device)
    for scale, weight in enumerate(SCALE_WEIGHTS):
        luminance, structure = _similarities(one, two, data_range)
        last = scale == len(SCALE_WEIGHTS) - 1
        mean = (luminance * structure if last else structure).reshape(pictures, -1).mean(-1)
        result = result * _positive_power(mean, weight)
        if not last:
            one, two = (nn.functional.avg_pool2d(planes, 2) for planes in (one, two))
    return result.mean()


def _checked(predictions, targets, smallest, data_range):
    _validate.number("data_range", data_range, positive=True)
    pair = checked_pair(predictions, targets, data_range)
    if predictions.ndim < 2 or predictions.numel() == 0 or min(predictions.shape[-2:]) < smallest:
        raise ValueError(
            f"predictions and targets must be pictures [..., H, W] of at least {smallest} x {smallest}, "
            f"got {tuple(predictions.shape)}"
        )
    return pair


def _planes(pictures):
    return pictures.reshape(-1, 1, *pictures.shape[-2:])


def _similarities(one, two, data_range):
    """Return the luminance term and the contrast–structure term of SSIM, where the window fits.

    2ab/(a² + b²) = 1 − (a − b)²/(a² + b²), likewise with variances: four windowed means instead of five, and no
    digits lost where pictures are close.
    """
    # Products: a power of a large number would be an error, where infinity is right.
    c1, c2 = (k * data_range * k * data_range for k in (K1, K2))
    difference = one - two
    maps = torch.cat([one, difference, one**2 + two**2, difference**2])
    mean_one, mean_difference, power, power_difference = _windowed(maps).chunk(4)
    mean_two = mean_one - mean_difference
    level = mean_one**2 + mean_two**2
    luminance = 1 - mean_difference**2 / (level + c1)
    # Rounding must not make a variance negative.
    variances = (power - level).clamp_min(0)
    variance_of_difference = (power_difference - mean_difference**2).clamp_min(0)
    return luminance, 1 - variance_of_difference / (variances + c2)


@in_own_precision
def _windowed(planes):
    """Return Gaussian-weighted means, where the window fits."""
    axis = torch.arange(WINDOW, dtype=torch.float64, device=planes.device) - WINDOW // 2
    line = torch.exp(-(axis**2) / (2 * SIGMA**2))
    line = (line / line.sum()).to(planes.dtype)
    planes = nn.functional.conv2d(planes, line.reshape(1, 1, -1, 1))
    return nn.functional.conv2d(planes, line.reshape(1, 1, 1, -1))


def _positive_power(value, exponent):
    """Return value^exponent, 0 with a gradient of 0 where the value is not positive."""
    # What is not a number stays so.
    none = value <= 0
    return torch.where(none, 0.0, torch.where(none, 1.0, value) ** exponent)
