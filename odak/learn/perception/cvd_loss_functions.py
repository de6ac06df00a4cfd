"""Losses for colour-vision deficiencies: local contrast and colour that a simulation takes away.

Jiang, Liu, Li and Xu, ICCV (2023).
"""

import torch
from torch import nn

from odak import _validate
from odak.learn.perception.util import check_values
from odak.learn.tools.matrix import blur_gaussian

_SMALLEST = 4


def extract_local_patches(
    image: torch.Tensor, patch_size: int = 4, stride: int = 2
) -> tuple[torch.Tensor, list[tuple[int, int]]]:
    """Cut pictures into patches.

    Parameters
    ----------
    image : torch.Tensor
        ``[B, C, H, W]``.
    patch_size, stride : int
        Side p of a patch and the step from one to the next, in pixels.

    Returns
    -------
    tuple
        Patches ``[B, C·p·p, N]``, row by row, each channel after channel; and the N top left corners (x, y).

    Raises
    ------
    ValueError, TypeError
        If the image is not ``[B, C, H, W]`` of real floats, or the patch is larger than it.
    """
    image = _checked("image", image)
    patch_size = _validate.integer("patch_size", patch_size, minimum=1)
    stride = _validate.integer("stride", stride, minimum=1)
    rows, columns = image.shape[-2:]
    if patch_size > min(rows, columns):
        raise ValueError(f"patch_size must be at most the image's {rows} x {columns}, got {patch_size}")
    corners = [
        (x, y) for y in range(0, rows - patch_size + 1, stride) for x in range(0, columns - patch_size + 1, stride)
    ]
    return nn.functional.unfold(image, patch_size, stride=stride), corners


def compute_local_contrast_similarity(
    patch_x: torch.Tensor, patch_y: torch.Tensor, epsilon: float = 1e-8
) -> torch.Tensor:
    """Return how alike the contrasts of patches are: (2σₓσᵧ + ε)/(σₓ² + σᵧ² + ε), σ being deviations plus ε.

    Parameters
    ----------
    patch_x, patch_y : torch.Tensor
        Patches ``[D, N]`` of one shape.
    epsilon : float
        Keeps the ratio apart from 0/0.

    Returns
    -------
    torch.Tensor
        ``[N]``, 1 for equal contrast. Differentiable, with finite gradients for flat patches.

    Raises
    ------
    ValueError, TypeError
        If the patches are not ``[D, N]`` of real floats and one shape.
    """
    for name, patch in (("patch_x", patch_x), ("patch_y", patch_y)):
        if not isinstance(patch, torch.Tensor) or not patch.is_floating_point():
            kind = getattr(patch, "dtype", type(patch).__name__)
            raise TypeError(f"{name} must be a tensor of real floats, got {kind}")
    if patch_x.shape != patch_y.shape or patch_x.ndim != 2:
        raise ValueError(
            f"patch_x and patch_y must be [D, N] of one shape, got {tuple(patch_x.shape)} and {tuple(patch_y.shape)}"
        )
    _validate.one_device(patch_x=patch_x, patch_y=patch_y)
    _validate.number("epsilon", epsilon, positive=True)
    return _similarity(patch_x, patch_y, 0, epsilon)


def local_contrast_loss(
    image: torch.Tensor, simulated_image: torch.Tensor, patch_size: int = 4, stride: int = 2, epsilon: float = 1e-8
) -> torch.Tensor:
    """Return how much local contrast a simulation changes (equation 5): the mean of 1 − similarity over patches.

    Parameters
    ----------
    image, simulated_image : torch.Tensor
        ``[B, C, H, W]`` of one shape, sides at least 4.
    patch_size, stride : int
        As in :func:`extract_local_patches`.
    epsilon : float
        As in :func:`compute_local_contrast_similarity`.

    Returns
    -------
    torch.Tensor
        The loss, without axes; exactly 0 for equal pictures.

    Raises
    ------
    ValueError, TypeError
        If the pictures are not as said, or the patch is larger than they are.
    """
    image, simulated_image = _checked_pair(image, simulated_image)
    _validate.number("epsilon", epsilon, positive=True)
    return _contrast_lost(image, simulated_image, patch_size, stride, epsilon)


def color_information_loss(
    image: torch.Tensor, simulated_image: torch.Tensor, kernel_size: int = 5, sigma: float = 1.0
) -> torch.Tensor:
    """Return how much colour a simulation changes (equation 6): the mean absolute difference of blurred pictures.

    Parameters
    ----------
    image, simulated_image : torch.Tensor
        ``[B, C, H, W]`` of one shape, sides at least 4.
    kernel_size : int
        Side of the blur's kernel, in pixels.
    sigma : float
        Its width, as in :func:`odak.learn.tools.blur_gaussian`, which does not normalise: a kernel of 5 and σ = 1 sums
        to 0.639, so that an offset of 0.1 counts as 0.06.

    Returns
    -------
    torch.Tensor
        The loss, without axes; exactly 0 for equal pictures.

    Raises
    ------
    ValueError, TypeError
        If the pictures are not as said, or the kernel is not acceptable.
    """
    image, simulated_image = _checked_pair(image, simulated_image)
    kernel_size = _validate.integer("kernel_size", kernel_size, minimum=1)
    sigma = float(_validate.number("sigma", sigma, least=0))
    return _colour_lost(image, simulated_image, kernel_size, sigma)


def cvd_loss(
    image: torch.Tensor,
    simulated_image: torch.Tensor,
    alpha: float = 15.0,
    beta: float = 1.0,
    lc_patch_size: int = 4,
    lc_stride: int = 2,
    ci_kernel_size: int = 5,
    ci_sigma: float = 1.0,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return α·(local contrast) + β·(colour), and both (equation 3).

    Parameters
    ----------
    image, simulated_image : torch.Tensor
        ``[B, C, H, W]`` of one shape, sides at least 4.
    alpha, beta : float
        Weights.
    lc_patch_size, lc_stride : int
        Patches of :func:`local_contrast_loss`.
    ci_kernel_size, ci_sigma : int, float
        Kernel of :func:`color_information_loss`.

    Returns
    -------
    tuple of torch.Tensor
        Total, contrast and colour, without axes.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import cvd_loss
    >>> picture = torch.linspace(0, 1, 48).reshape(1, 3, 4, 4)
    >>> [term.item() for term in cvd_loss(picture, picture)]
    [0.0, 0.0, 0.0]
    """
    alpha, beta = _validate.number("alpha", alpha), _validate.number("beta", beta)
    lc_patch_size = _validate.integer("lc_patch_size", lc_patch_size, minimum=1)
    lc_stride = _validate.integer("lc_stride", lc_stride, minimum=1)
    ci_kernel_size = _validate.integer("ci_kernel_size", ci_kernel_size, minimum=1)
    ci_sigma = float(_validate.number("ci_sigma", ci_sigma, least=0))
    image, simulated_image = _checked_pair(image, simulated_image)
    contrast = _contrast_lost(image, simulated_image, lc_patch_size, lc_stride, 1e-8)
    colour = _colour_lost(image, simulated_image, ci_kernel_size, ci_sigma)
    return alpha * contrast + beta * colour, contrast, colour


def _contrast_lost(image, simulated_image, patch_size, stride, epsilon):
    patches = [extract_local_patches(picture, patch_size, stride)[0] for picture in (image, simulated_image)]
    return (1 - _similarity(*patches, 1, epsilon)).mean()


def _colour_lost(image, simulated_image, kernel_size, sigma):
    # The blur is linear: one of the difference does for two.
    return blur_gaussian(image - simulated_image, (kernel_size, kernel_size), (sigma, sigma)).abs().mean()


def _similarity(one, two, axis, epsilon):
    one, two = (_deviation(patches, axis) + epsilon for patches in (one, two))
    return (2 * one * two + epsilon) / (one**2 + two**2 + epsilon)


def _deviation(patches, axis):
    """Return population standard deviations, with a gradient of 0 where there is none."""
    variance = patches.var(axis, correction=0)
    # What is not a number stays so.
    none = variance <= 0
    return torch.where(none, 0.0, torch.where(none, 1.0, variance).sqrt())


def _checked(name, image):
    if not isinstance(image, torch.Tensor) or not image.is_floating_point():
        kind = getattr(image, "dtype", type(image).__name__)
        raise TypeError(f"{name} must be a tensor of real floats, got {kind}")
    if image.ndim != 4:
        raise ValueError(f"{name} must be [B, C, H, W], got {tuple(image.shape)}")
    return image


def _checked_pair(image, simulated_image):
    for name, picture in (("image", image), ("simulated_image", simulated_image)):
        check_values(**{name: _checked(name, picture)})
    if image.shape != simulated_image.shape or min(image.shape[-2:]) < _SMALLEST:
        raise ValueError(
            f"image and simulated_image must have one shape, sides at least {_SMALLEST}; "
            f"got {tuple(image.shape)} and {tuple(simulated_image.shape)}"
        )
    _validate.one_device(image=image, simulated_image=simulated_image)
    dtype = torch.promote_types(image.dtype, simulated_image.dtype)
    return image.to(dtype), simulated_image.to(dtype)
