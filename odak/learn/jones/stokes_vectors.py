"""Stokes vectors, Mueller matrices and the polarisation ellipse of tensors; see :mod:`odak.jones.stokes_vectors`."""

import torch

from odak.jones import stokes_vectors as core
from odak.jones.stokes_vectors import (
    PolarizationEllipse,
    degree_of_polarization,
    field_from_stokes,
    mueller,
    polarization_ellipse,
    stokes,
    stokes_ellipse,
)
from odak.learn._tensors import checked_device

__all__ = [
    "PolarizationEllipse",
    "degree_of_polarization",
    "depolarizer",
    "field_from_stokes",
    "mueller",
    "polarization_ellipse",
    "stokes",
    "stokes_ellipse",
]


def depolarizer(
    kept: complex | torch.Tensor = 0.0, *, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> torch.Tensor:
    """Return the Mueller matrix of an ideal depolariser; see :func:`odak.jones.depolarizer`.

    Parameters
    ----------
    kept : number or torch.Tensor
        Share of the degree of polarisation that is left, 0 … 1.
    device, dtype : optional
        Device and real dtype of the result; by default those of the tensor given, else torch's defaults.

    Returns
    -------
    torch.Tensor
        Real ``[..., 4, 4]``.
    """
    if dtype not in (None, torch.float32, torch.float64):
        raise TypeError(f"dtype must be torch.float32 or torch.float64, got {dtype}")
    if not isinstance(kept, torch.Tensor):
        core.depolarizer(kept)
        kept = torch.as_tensor(kept, dtype=torch.get_default_dtype())
    return core.depolarizer(kept.to(device=checked_device("device", device), dtype=dtype))
