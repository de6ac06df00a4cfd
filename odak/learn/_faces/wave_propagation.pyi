"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch


def disk_source(
    radius: float,
    rings: int = 4,
    spokes: int = 12,
    center: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return directions and weights of a quadrature over a uniformly bright disk."""
    ...

def gaussian_spectrum(
    wavelength: float,
    width: float,
    count: int = 9,
    *,
    device: torch.device | str | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return wavelengths and weights of a quadrature over a Gaussian spectral line."""
    ...

def impulse_response_fresnel(
    field: torch.Tensor,
    k: float | torch.Tensor | None,
    distance: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float] | torch.Tensor,
    wavelength: float | torch.Tensor,
    zero_padding: bool = False,
    aperture: float | torch.Tensor = 1.0,
    scale: int = 1,
    samples: collections.abc.Sequence[int] = (20, 20, 5, 5),
) -> torch.Tensor:
    """Propagate by the sampled Fresnel impulse response (Voelz 2011, eq. 4.21)."""
    ...

def propagate_beam(
    field: torch.Tensor,
    k: float | torch.Tensor | None = None,
    distance: float | torch.Tensor = ...,
    dx: float | collections.abc.Sequence[float] | torch.Tensor = ...,
    wavelength: float | torch.Tensor = ...,
    propagation_type: str = 'auto',
    kernel: torch.Tensor | None = None,
    zero_padding: bool | collections.abc.Sequence[bool] = (True, False, True),
    aperture: float | torch.Tensor = 1.0,
    scale: int = 1,
    samples: collections.abc.Sequence[int] = (20, 20, 5, 5),
    tolerance: float = 0.0001,
    axes: int | collections.abc.Sequence[int] = (-2, -1),
) -> torch.Tensor:
    """Propagate a field, by the method named or by the one whose error is at most 1e-4."""
    ...

def propagate_partially_coherent(
    field: torch.Tensor | collections.abc.Callable[..., typing.Any],
    spectrum: float | torch.Tensor | tuple[collections.abc.Sequence[float | torch.Tensor] | torch.Tensor, collections.abc.Sequence[float | torch.Tensor] | torch.Tensor],
    source: tuple[torch.Tensor, torch.Tensor] | None,
    distance: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float] | torch.Tensor,
    window_shape: collections.abc.Sequence[int] | None = None,
    window_dx: float | collections.abc.Sequence[float] | None = None,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    guard: float = 4.0,
    memory: int = 67108864,
) -> torch.Tensor:
    """Return the intensity on a window under partially coherent light: several wavelengths and directions."""
    ...

def seperable_impulse_response_fresnel(
    field: torch.Tensor,
    k: float | torch.Tensor | None,
    distance: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float] | torch.Tensor,
    wavelength: float | torch.Tensor,
    zero_padding: bool = False,
    aperture: float | torch.Tensor = 1.0,
    scale: int = 1,
    samples: collections.abc.Sequence[int] = (20, 20, 5, 5),
) -> torch.Tensor:
    """Propagate by the sampled Fresnel impulse response (Voelz 2011, eq. 4.21)."""
    ...
