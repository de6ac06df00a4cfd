"""Partially coherent light, differentiable within bounded memory."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch.utils.checkpoint import checkpoint

from odak.learn._tensors import checked_device, trainable
from odak.wave import partial_coherence
from odak.wave.frequency_box import GUARD

_CPU = torch.device("cpu")


def propagate_partially_coherent(
    field: Any,
    spectrum: Any,
    source: Any,
    distance: Any,
    dx: Any,
    window_shape: Sequence[int] | None = None,
    window_dx: Any = None,
    offset: Any = (0.0, 0.0),
    guard: float = GUARD,
    memory: int = partial_coherence.MEMORY,
) -> torch.Tensor:
    """Return the intensity on a window of partially coherent light.

    Parameters
    ----------
    field : torch.Tensor or callable
        Complex field ``[..., rows, columns]``, or a function of the wavelength that returns it.
    spectrum, source, distance, dx, window_shape, window_dx, offset, guard
        As in :func:`odak.wave.propagate_partially_coherent`.
    memory : int
        Bytes, roughly, that directions propagated at once may take. The backward pass computes each share anew, so
        that this bounds it too.

    Returns
    -------
    torch.Tensor
        Real intensity ``[..., window rows, window columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.
    """
    field = trainable(field) if isinstance(field, torch.Tensor) else field
    return partial_coherence.sum_intensities(
        _recomputed,
        field,
        spectrum,
        source,
        memory,
        distance=distance,
        dx=dx,
        window_shape=window_shape,
        window_dx=window_dx,
        offset=offset,
        guard=guard,
    )


def _recomputed(step: Callable, *values):
    if not torch.is_grad_enabled():
        return step(*values)
    return checkpoint(step, *values, use_reentrant=False, preserve_rng_state=False)


def gaussian_spectrum(
    wavelength: float, width: float, count: int = 9, device: torch.device = _CPU
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return wavelengths and weights, float64, of a Gaussian line; see :func:`odak.wave.gaussian_spectrum`."""
    device = checked_device("device", device)
    wavelengths, weights = partial_coherence.gaussian_spectrum(wavelength, width, count)
    return torch.from_numpy(wavelengths).to(device), torch.from_numpy(weights).to(device)


def disk_source(
    radius: float,
    rings: int = 4,
    spokes: int = 12,
    center: Sequence[float] = (0.0, 0.0),
    device: torch.device = _CPU,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return directions and weights, float64, of a bright disk; see :func:`odak.wave.disk_source`."""
    device = checked_device("device", device)
    directions, weights = partial_coherence.disk_source(radius, rings, spokes, center)
    return torch.from_numpy(directions).to(device), torch.from_numpy(weights).to(device)
