"""What the powers of a display's light sources mean, and whether those given can be had."""

import torch

from odak import _validate
from odak.learn._tensors import floating

METHODS = ("conventional", "multi-color", "full complex conventional", "full complex multi-color")


def power_method(method: str) -> str:
    """Return the full name of what channel powers mean, given with spaces or underscores."""
    return _validate.one_of("method", _validate.text("method", method).replace("_", " "), METHODS)


def checked_powers(name: str, power: torch.Tensor, shape: tuple[int, int], amplitudes: bool) -> torch.Tensor:
    """Return channel powers after checking them.

    Parameters
    ----------
    name : str
        What they are called.
    power : torch.Tensor
        What came.
    shape : tuple of int
        Frames and wavelengths.
    amplitudes : bool
        They are amplitudes of sources, which are not negative.

    Returns
    -------
    torch.Tensor
        Real ``[frames, wavelengths]``.

    Raises
    ------
    ValueError, TypeError
        If they are not real, of another shape, not finite, or negative where they are amplitudes.
    """
    power = floating(name, power)
    check_shape(name, power, "[frames, wavelengths]", shape)
    if not bool(power.isfinite().all()):
        raise ValueError(f"{name} must be finite, got NaN or infinite values")
    if amplitudes and bool((power < 0).any()):
        raise ValueError(f"{name} must not be negative, got {power.min().item()}")
    return power


def check_shape(name: str, values: torch.Tensor, axes: str, shape: tuple[int, ...]) -> None:
    """Raise ValueError unless values have a shape, whose axes are named in the message."""
    if tuple(values.shape) != shape:
        raise ValueError(f"{name} must be {axes} = {shape}, got {tuple(values.shape)}")


def is_diagonal(power: torch.Tensor) -> bool:
    """Return whether frame f is lit by source f alone, powers being ``[frames, wavelengths]``."""
    return bool((power == torch.zeros_like(power).diagonal_scatter(power.diagonal())).all())
