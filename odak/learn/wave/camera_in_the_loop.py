"""Captured images in place of a model's: the loss of what the display shows, with the slope that the model knows."""

from collections.abc import Callable

import torch


def captured_by(camera: Callable, phase: torch.Tensor, shape: tuple[int, ...]) -> torch.Tensor:
    """Return what a camera captures of a phase.

    Parameters
    ----------
    camera : callable
        ``camera(phase)`` shows a phase and returns the captured intensity.
    phase : torch.Tensor
        What to show.
    shape : tuple of int
        Shape that the captured intensity must have.

    Returns
    -------
    torch.Tensor
        Captured intensity, without a graph.

    Raises
    ------
    ValueError, TypeError
        If the camera does not return an intensity of that shape.
    """
    with torch.no_grad():
        captured = camera(phase.detach())
    if not isinstance(captured, torch.Tensor) or captured.is_complex():
        raise TypeError(f"camera must return a real tensor, got {getattr(captured, 'dtype', type(captured).__name__)}")
    if tuple(captured.shape) != tuple(shape):
        raise ValueError(f"camera must return an image of {tuple(shape)}, got {tuple(captured.shape)}")
    return captured.detach()


def seen(image: torch.Tensor, captured: torch.Tensor) -> torch.Tensor:
    """Return the captured intensity with the gradient of the model's intensity `image` (Peng et al. 2020, eq. 8)."""
    return image + (captured.to(image) - image).detach()
