"""Propagation with the PyTorch face's defaults: padded, band-limited, pixels averaged."""

from collections.abc import Sequence

import torch

from odak.learn.wave import spectral
from odak.wave import classical

__all__ = ["impulse_response_fresnel", "propagate_beam", "seperable_impulse_response_fresnel", "spectral"]

APERTURE_SAMPLES = (20, 20, 5, 5)


def propagate_beam(
    field: torch.Tensor,
    k: float | torch.Tensor | None,
    distance: float | Sequence[float] | torch.Tensor,
    dx: float | torch.Tensor,
    wavelength: float | Sequence[float] | torch.Tensor,
    propagation_type: str = "Bandlimited Angular Spectrum",
    kernel: torch.Tensor | None = None,
    zero_padding: Sequence[bool] = (True, False, True),
    aperture: complex | torch.Tensor = 1.0,
    scale: int = 1,
    samples: Sequence[int] = APERTURE_SAMPLES,
) -> torch.Tensor:
    """Propagate a field by the method named, differentiable in the field and in every length given as a tensor.

    Parameters
    ----------
    field : torch.Tensor
        Complex field ``[..., rows, columns]``.
    k, distance, dx, wavelength, propagation_type, kernel, aperture, scale, samples
        As in :func:`odak.wave.propagate_beam`.
    zero_padding : sequence of bool
        Pad the field to twice its size; pad the spectrum to twice its size; crop the centre half at the end.

    Returns
    -------
    torch.Tensor
        Propagated field, on the field's device and in its precision.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import propagate_beam
    >>> distance = torch.tensor(1e-3, dtype=torch.float64, requires_grad=True)
    >>> field = propagate_beam(torch.ones(8, 8, dtype=torch.complex128), None, distance, 8e-6, 532e-9)
    >>> field.abs().sum().backward()
    >>> bool(distance.grad.isfinite())
    True
    """
    return classical.propagate_beam(
        field, k, distance, dx, wavelength, propagation_type, kernel, zero_padding, aperture, scale, samples
    )


def impulse_response_fresnel(
    field: torch.Tensor,
    k: float | torch.Tensor | None,
    distance: float | Sequence[float] | torch.Tensor,
    dx: float | torch.Tensor,
    wavelength: float | Sequence[float] | torch.Tensor,
    zero_padding: bool = False,
    aperture: complex | torch.Tensor = 1.0,
    scale: int = 1,
    samples: Sequence[int] = APERTURE_SAMPLES,
) -> torch.Tensor:
    """Propagate by the Fresnel impulse response, averaged over source pixels and target samples.

    Parameters and result are those of :func:`odak.wave.impulse_response_fresnel`.
    """
    return classical.impulse_response_fresnel(
        field, k, distance, dx, wavelength, zero_padding, aperture, scale, samples
    )


seperable_impulse_response_fresnel = impulse_response_fresnel
