"""Kernels with an orientation, as differentiable tensors."""

import math
from collections.abc import Sequence

import torch

from odak import _validate
from odak.learn._tensors import checked_device, checked_dtype


def generate_2d_dirac_delta(
    kernel_length: Sequence[int] = (21, 21),
    a: Sequence[float] = (3.0, 3.0),
    mu: Sequence[float] = (0.0, 0.0),
    theta: float = 0.0,
    normalize: bool = False,
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a turned, narrow peak exp(−(x'/a₀)² − (y'/a₁)²)/(π|a₀a₁|), which tends to Dirac's delta with a → 0.

    An axis of L samples runs from −L/2 to L/2, so that they are L/(L − 1) apart; a single one sits at 0. With x and y
    along rows and columns from `mu`, x' = x·cos θ − y·sin θ and y' = x·sin θ + y·cos θ.

    Parameters
    ----------
    kernel_length : sequence of int
        Rows and columns.
    a : sequence of float or torch.Tensor
        Widths along x' and y', in units of the axes, not zero.
    mu : sequence of float or torch.Tensor
        Centre along rows and columns, in units of the axes.
    theta : float or torch.Tensor
        Angle in radians.
    normalize : bool
        Scale the largest sample to 1.
    dtype : torch.dtype
        Precision of the result.
    device : torch.device or str, optional
        Where the result lives; the CPU by default.

    Returns
    -------
    torch.Tensor
        ``[kernel_length[0], kernel_length[1]]``, differentiable in `a`, `mu` and `theta`.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> from odak.learn.tools import generate_2d_dirac_delta
    >>> generate_2d_dirac_delta([3, 3], [1, 2], normalize=True)[1].round(decimals=3)
    tensor([0.5700, 1.0000, 0.5700])
    """
    lengths = _validate.size("kernel_length", kernel_length)
    normalize = _validate.flag("normalize", normalize)
    dtype, device = checked_dtype("dtype", dtype), checked_device("device", device)
    widths = _pair("a", _validate.real("a", a, nonzero=True), device)
    centre = _pair("mu", _validate.real("mu", mu), device)
    angle = torch.as_tensor(_validate.real("theta", theta), dtype=torch.float64, device=device)
    x, y = (
        torch.linspace(-n / 2, n / 2, n, dtype=torch.float64, device=device) if n > 1 else centre.new_zeros(1)
        for n in lengths
    )
    x, y = (x - centre[0])[:, None], (y - centre[1])[None, :]
    across, along = x * angle.cos() - y * angle.sin(), x * angle.sin() + y * angle.cos()
    exponent = -((across / widths[0]) ** 2) - (along / widths[1]) ** 2
    if normalize:
        # Relative to the largest, so that a narrow peak between two samples is not 0/0.
        return torch.exp(exponent - exponent.max()).to(dtype)
    return (torch.exp(exponent) / (math.pi * widths.prod().abs())).to(dtype)


def _pair(name, value, device):
    pair = torch.as_tensor(value, dtype=torch.float64, device=device).reshape(-1)
    if pair.numel() != 2:
        raise ValueError(f"{name} must be two numbers, got {value!r}")
    return pair
