"""Binary masks."""

import torch

from odak import _validate
from odak.learn._tensors import checked_device


def circular_binary_mask(
    px: int,
    py: int,
    r: float,
    offset_x: float = 0.0,
    offset_y: float = 0.0,
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a disc of ones: samples nearer than `r` to its centre.

    The axis of n samples runs from −n/2 to n/2, so that samples are n/(n − 1) apart and symmetric about 0.

    Parameters
    ----------
    px, py : int
        Rows and columns.
    r : float
        Radius in units of the axes; nothing is inside a radius of 0.
    offset_x, offset_y : float
        Centre along rows and columns, in units of the axes.
    device : torch.device or str, optional
        Where the result lives; the CPU by default.

    Returns
    -------
    torch.Tensor
        float32 ``[1, 1, px, py]`` of 0 and 1.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> from odak.learn.tools import circular_binary_mask
    >>> circular_binary_mask(5, 5, 2.0).sum().item()
    9.0
    """
    for name, value in (("r", r), ("offset_x", offset_x), ("offset_y", offset_y)):
        _validate.real(name, value)
    device = checked_device("device", device)
    rows, columns = (_axis(name, n, device) for name, n in (("px", px), ("py", py)))
    squared = (rows[:, None] - offset_x) ** 2 + (columns - offset_y) ** 2
    return (torch.sqrt(squared) < r).to(torch.float32)[None, None]


def _axis(name, length, device):
    length = _validate.side(name, _validate.integer(name, length, minimum=1))
    edge = length / 2 if length > 1 else 0.0
    return torch.linspace(-edge, edge, length, dtype=torch.float64, device=device)
