"""How close an intensity is to its target: best brightness, PSNR and SSIM."""

import math

import torch

WINDOW, SIGMA = 11, 1.5
K1, K2 = 0.01, 0.03


def best_scale(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the brightness s = ⟨I, T⟩/⟨I, I⟩ that brings an image closest to its target.

    Parameters
    ----------
    image, target : torch.Tensor
        Intensities ``[..., rows, columns]``.

    Returns
    -------
    torch.Tensor
        s, ``[..., 1, 1]``; 0 for an image of zeros.
    """
    axes = (-2, -1)
    energy = (image * image).sum(axes, keepdim=True)
    return (image * target).sum(axes, keepdim=True) / energy.clamp_min(torch.finfo(image.dtype).tiny)


def psnr(image: torch.Tensor, target: torch.Tensor, peak: float = 1.0) -> float:
    """Return the peak signal-to-noise ratio 10·log₁₀(peak²/MSE) in dB, over all elements.

    Parameters
    ----------
    image, target : torch.Tensor
        Of one shape.
    peak : float
        Largest value that the target could have.

    Returns
    -------
    float
        PSNR in dB, infinite for equal images.
    """
    error = float(((image.double() - target.double()) ** 2).mean())
    return 10 * math.log10(peak**2 / error) if error > 0 else math.inf


def ssim(image: torch.Tensor, target: torch.Tensor, peak: float = 1.0) -> float:
    """Return the mean structural similarity of two images.

    Parameters
    ----------
    image, target : torch.Tensor
        ``[..., rows, columns]`` of one shape, each side at least 11.
    peak : float
        Largest value that the target could have.

    Returns
    -------
    float
        Mean over every place where the window fits, and over the leading axes; 1 for equal images.

    Raises
    ------
    ValueError
        If the shapes differ or an image is smaller than the window.

    Notes
    -----
    Wang, Bovik, Sheikh and Simoncelli, IEEE Trans. Image Process. 13, 600 (2004): Gaussian window of 11 × 11 with
    σ = 1.5, K₁ = 0.01, K₂ = 0.03.
    """
    if image.shape != target.shape or min(image.shape[-2:]) < WINDOW:
        raise ValueError(
            f"image and target must have one shape of at least {WINDOW} x {WINDOW}, "
            f"got {tuple(image.shape)} and {tuple(target.shape)}"
        )
    x, y = (value.double().reshape(-1, 1, *value.shape[-2:]) for value in (image, target))
    mean_x, mean_y = _windowed(x), _windowed(y)
    variance_x = _windowed(x * x) - mean_x**2
    variance_y = _windowed(y * y) - mean_y**2
    covariance = _windowed(x * y) - mean_x * mean_y
    c1, c2 = (K1 * peak) ** 2, (K2 * peak) ** 2
    luminance = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    structure = (2 * covariance + c2) / (variance_x + variance_y + c2)
    return float((luminance * structure).mean())


def _windowed(image: torch.Tensor) -> torch.Tensor:
    """Return Gaussian-weighted means of an image, where the window fits."""
    line = torch.arange(WINDOW, dtype=image.dtype, device=image.device) - WINDOW // 2
    line = torch.exp(-(line**2) / (2 * SIGMA**2))
    line = line / line.sum()
    image = torch.nn.functional.conv2d(image, line.reshape(1, 1, -1, 1))
    return torch.nn.functional.conv2d(image, line.reshape(1, 1, 1, -1))
