"""Losses of holograms: smooth phase, low speckle, and images right on every plane."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn._precision import in_own_precision
from odak.learn._tensors import checked_device, tensor
from odak.learn.tools.device import get_device
from odak.learn.wave.focal_targets import FocalTargets
from odak.learn.wave.perceptual_loss import perceptual_multiplane_loss

__all__ = ["multiplane_loss", "perceptual_multiplane_loss", "phase_gradient", "speckle_contrast"]

_LAPLACIAN = ((-1.0, -1.0, -1.0), (-1.0, 8.0, -1.0), (-1.0, -1.0, -1.0))


class phase_gradient(nn.Module):
    """How much a phase differs from its surroundings: a loss of its Laplacian against zero.

    Parameters
    ----------
    kernel : torch.Tensor, optional
        Kernel ``[h, w]`` or ``[1, 1, h, w]`` to filter by; by default the Laplacian of eight neighbours, over 8.
    loss : callable
        ``loss(filtered, zeros)``.
    device : torch.device or str
        Where the kernel lives; it follows the phase when it is used.

    Raises
    ------
    ValueError, TypeError
        If the kernel has other axes or the loss cannot be called.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import phase_gradient
    >>> phase = torch.zeros(5, 5)
    >>> phase[2, 2] = 1
    >>> round(phase_gradient()(phase).item(), 6)
    0.045
    """

    kernel: torch.Tensor

    def __init__(
        self,
        kernel: torch.Tensor | None = None,
        loss: Callable = nn.MSELoss(),  # noqa: B008
        device: torch.device | str = "cpu",
    ):
        super().__init__()
        kernel = torch.tensor(_LAPLACIAN) / 8 if kernel is None else tensor("kernel", kernel)
        if kernel.ndim not in (2, 4) or (kernel.ndim == 4 and kernel.shape[:2] != (1, 1)) or kernel.numel() == 0:
            raise ValueError(f"kernel must be [h, w] or [1, 1, h, w], not empty; got {tuple(kernel.shape)}")
        self.register_buffer("kernel", kernel.reshape(1, 1, *kernel.shape[-2:]).to(get_device(device)), False)
        self.loss = _checked_loss(loss)

    def forward(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the loss of a phase ``[m, n]`` or ``[..., 1, m, n]`` in radians."""
        edges = self.functional_conv2d(phase)
        return self.loss(edges, torch.zeros_like(edges))

    @in_own_precision
    def functional_conv2d(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the filtered phase ``[B, 1, m, n]``, zeros around it."""
        planes = _planes("phase", phase)
        kernel = self.kernel.to(planes)
        return nn.functional.conv2d(planes, kernel, padding=tuple(side // 2 for side in kernel.shape[-2:]))


class speckle_contrast(nn.Module):
    """How grainy an intensity is: a loss of its local contrast, deviation over mean, against zero.

    Parameters
    ----------
    kernel_size : int
        Side of the square of samples that a contrast is taken from.
    step_size : int or sequence of int
        Rows and columns from one square to the next.
    loss : callable
        ``loss(contrast, zeros)``.
    device : torch.device or str
        Not used, as there is nothing to keep; the computation runs where the intensity is.

    Raises
    ------
    ValueError, TypeError
        If a size is not positive or the loss cannot be called.

    Notes
    -----
    Fully developed speckle has a contrast of 1 (Goodman, Speckle Phenomena in Optics, 2007, section 3.2). The deviation
    is that of the samples themselves, not an estimate from fewer degrees of freedom.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import speckle_contrast
    >>> stripes = torch.tensor([1.0, 3.0]).repeat(4, 2)
    >>> speckle_contrast(2)(stripes).item()
    0.25
    """

    def __init__(
        self,
        kernel_size: int = 11,
        step_size: int | Sequence[int] = (1, 1),
        loss: Callable = nn.MSELoss(),  # noqa: B008
        device: torch.device | str = "cpu",
    ):
        super().__init__()
        checked_device("device", device)
        self.kernel_size = _validate.integer("kernel_size", kernel_size, minimum=1)
        self.step_size = _validate.size("step_size", (step_size,) * 2 if isinstance(step_size, int) else step_size)
        self.loss = _checked_loss(loss)

    def forward(self, intensity: torch.Tensor) -> torch.Tensor:
        """Return the loss of an intensity ``[m, n]`` or ``[..., 1, m, n]``."""
        contrast = self.functional_conv2d(intensity)
        return self.loss(contrast, torch.zeros_like(contrast))

    @in_own_precision
    def functional_conv2d(self, intensity: torch.Tensor) -> torch.Tensor:
        """Return the contrast of each square ``[B, 1, m', n']``; 0 where the light is even, or there is none."""
        given = _planes("intensity", intensity)
        # In single precision the variance of what is dark beside bright light would be rounding alone.
        planes = given.double()
        if min(planes.shape[-2:]) < self.kernel_size:
            raise ValueError(
                f"intensity must be at least kernel_size = {self.kernel_size} wide and high, "
                f"got {tuple(intensity.shape)}"
            )
        # Deviations from a common level keep the digits that E[I²] − E[I]² of bright light would lose.
        level = planes.detach().mean((-2, -1), keepdim=True)
        mean, square = (
            nn.functional.avg_pool2d(values, self.kernel_size, self.step_size)
            for values in (planes - level, (planes - level) ** 2)
        )
        variance, mean = square - mean**2, mean + level
        # What is not a number is uneven, so that it is seen.
        uneven = ~((variance <= 0) | (mean == 0))
        # Both branches must be finite, else the gradient of the one not taken is not a number.
        contrast = torch.where(uneven, variance.where(uneven, 1.0).sqrt() / mean.where(uneven, 1.0), 0.0)
        return contrast.to(given.dtype)


class multiplane_loss(FocalTargets):
    """Squared differences of images on several planes, of which the parts in focus and the bright parts count more.

    With image I, target T and the mask M of the plane: w₀·MSE(I, T) + w₁·MSE(I·M, T·M) + w₂·MSE(I·T, T·T).

    Parameters
    ----------
    target_image : torch.Tensor
        Picture ``[C, m, n]`` or ``[m, n]``.
    target_depth : torch.Tensor
        Depth of each pixel ``[m, n]``, 0 … 1; a pixel belongs to plane round(depth·(P − 1)).
    blur_ratio : float
        Growth of the blur's σ from one plane to the next: a pixel j planes away is blurred by σ = int(j·blur_ratio).
    target_blur_size : int
        Side of the blur's kernel in pixels; an even one grows by one.
    number_of_planes : int
        Number of planes P.
    weights : sequence of float
        Weights of the three terms. A fourth, which the older form has, is not used.
    multiplier : float
        Factor of the targets' intensity.
    scheme : {"defocus", "naive"}
        Targets that show what is out of focus, or are dark beyond their plane.
    reduction : {"mean", "sum"}
        How pixels are put together.
    device : torch.device or str, optional
        Where the loss lives; by default where the picture is. It moves with :meth:`to`.
    generator : torch.Generator, optional
        Where noise is drawn from; torch's own by default.

    Attributes
    ----------
    targets, masks : torch.Tensor
        ``[P, C, m, n]``.
    focus_target : torch.Tensor
        The sharp picture ``[C, m, n]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Kavaklı, Itoh, Urey and Akşit, Realistic defocus blur for multiplane computer-generated holography, IEEE VR (2023).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import multiplane_loss
    >>> picture, depth = torch.rand(3, 8, 8), torch.rand(8, 8)
    >>> loss = multiplane_loss(picture, depth, number_of_planes=2)
    >>> targets, _, _ = loss.get_targets()
    >>> loss(targets[1], targets[1], plane_id=1).item()
    0.0
    """

    def __init__(
        self,
        target_image: torch.Tensor,
        target_depth: torch.Tensor,
        blur_ratio: float = 0.25,
        target_blur_size: int = 10,
        number_of_planes: int = 4,
        weights: Sequence[float] = (1.0, 2.1, 0.6),
        multiplier: float = 1.0,
        scheme: str = "defocus",
        reduction: str = "mean",
        device: torch.device | str | None = None,
        *,
        generator: torch.Generator | None = None,
    ):
        super().__init__(
            target_image, target_depth, blur_ratio, target_blur_size, number_of_planes, multiplier, scheme, reduction,
            device, generator,
        )  # fmt: skip
        weights = _validate.several("weights", weights)
        if len(weights) not in (3, 4):
            raise ValueError(f"weights must be three, or four of which the last is not used; got {weights!r}")
        self.weights = _validate.numbers(weights)

    def forward(
        self,
        image: torch.Tensor,
        target: torch.Tensor,
        plane_id: int | None = None,
        inject_noise: bool = False,
        noise_ratio: float = 1e-3,
    ) -> torch.Tensor:
        """Return the loss of an image.

        Parameters
        ----------
        image, target : torch.Tensor
            Intensities of one colour ``[m, n]``, of all ``[C, m, n]`` or, without `plane_id`, of all planes
            ``[P, C, m, n]``; leading axes of one are dropped.
        plane_id : int, optional
            Plane of the image. None holds the image against the masks of all planes.
        inject_noise : bool
            Add noise to the target of the second and third term.
        noise_ratio : float
            Standard deviation of the noise as a share of the target's range.

        Returns
        -------
        torch.Tensor
            The loss, without axes.

        Raises
        ------
        ValueError
            If the shapes do not fit or there is no such plane.
        """
        pairs = self.pairs(image, target, plane_id, inject_noise, noise_ratio)
        terms = (nn.functional.mse_loss(*pair, reduction=self.reduction) for pair in pairs)
        total: Any = sum(weight * term for weight, term in zip(self.weights, terms, strict=False))
        return total


def _checked_loss(loss):
    if not callable(loss):
        raise TypeError(f"loss must be callable, got {type(loss).__name__}")
    return loss


def _planes(name, value):
    """Return a real image as ``[B, 1, m, n]``."""
    if not isinstance(value, torch.Tensor) or not value.is_floating_point():
        raise TypeError(f"{name} must be a real floating tensor, got {getattr(value, 'dtype', type(value).__name__)}")
    _validate.image(name, value)
    if value.ndim > 2 and value.shape[-3] != 1:
        raise ValueError(f"{name} must be [m, n] or [..., 1, m, n], got {tuple(value.shape)}")
    return value.reshape(-1, 1, *value.shape[-2:])
