"""Functions of position as tensors: Gaussians in space, Zernike polynomials, B-splines."""

import torch

from odak.learn.tools._bspline import (
    SeparableBasis,
    compose_bspline_2d,
    decompose_bspline_2d,
    decompose_wavelet_like,
    generate_bspline_basis_2d,
    reconstruct_wavelet_like,
)
from odak.tools._splines import gaussians
from odak.tools.zernike import noll_to_nm, osa_to_nm, zernike_norm, zernike_polynomial

__all__ = [
    "SeparableBasis",
    "compose_bspline_2d",
    "decompose_bspline_2d",
    "decompose_wavelet_like",
    "evaluate_3d_gaussians",
    "generate_bspline_basis_2d",
    "noll_to_nm",
    "osa_to_nm",
    "reconstruct_wavelet_like",
    "zernike_norm",
    "zernike_polynomial",
]

_ZERO, _ONE, _OPAQUE = torch.zeros(1, 3), torch.ones(1, 3), torch.ones(1, 1)


def evaluate_3d_gaussians(
    points: torch.Tensor,
    centers: torch.Tensor = _ZERO,
    scales: torch.Tensor = _ONE,
    angles: torch.Tensor = _ZERO,
    opacity: torch.Tensor = _OPAQUE,
) -> torch.Tensor:
    """Return the values of Gaussians at points: opacity·exp(−q²/2)/((2π)^(3/2)·s_x·s_y·s_z).

    For each Gaussian a point is turned about its centre by its angles; q is the arm from the centre, each coordinate
    divided by the standard deviation along that axis.

    Parameters
    ----------
    points : torch.Tensor
        ``[n, 3]``.
    centers : torch.Tensor
        ``[m, 3]``.
    scales : torch.Tensor
        Standard deviations ``[m, 3]``.
    angles : torch.Tensor
        Degrees about X, Y and Z, in this order, ``[m, 3]``.
    opacity : torch.Tensor
        ``[m, 1]`` or ``[m]``.

    Returns
    -------
    torch.Tensor
        ``[n, m]``, in the precision and on the device of `points`, differentiable in all. A single row of centres,
        scales, angles or opacities belongs to all Gaussians.

    Raises
    ------
    ValueError
        If a shape is wrong.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import evaluate_3d_gaussians
    >>> evaluate_3d_gaussians(torch.zeros(1, 3), torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])).round(decimals=4)
    tensor([[0.0385, 0.0635]])
    """
    given = {"points": points, "centers": centers, "scales": scales, "angles": angles}
    for name, value in given.items():
        if not isinstance(value, torch.Tensor) or value.ndim != 2 or value.shape[-1] != 3:
            raise ValueError(f"{name} must be a tensor [n, 3], got {tuple(getattr(value, 'shape', ()))}")
    if not isinstance(opacity, torch.Tensor):
        raise TypeError(f"opacity must be a tensor [n, 1] or [n], got {type(opacity).__name__}")
    opacity = opacity.reshape(-1)
    counts = {len(centers), len(scales), len(angles), len(opacity)} - {1}
    if len(counts) > 1:
        raise ValueError(f"centers, scales, angles and opacity must have as many rows, or one; got {sorted(counts)}")
    rest = (value.to(points) for value in (centers, scales, angles, opacity))
    return gaussians(points, *rest)
