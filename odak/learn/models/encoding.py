"""Features of coordinates."""

import torch
from torch import nn

from odak import _validate
from odak.learn._tensors import floating

_HIGHEST = 1000
# 2^63 times a coordinate is far from the largest float32 (2^128).
_SINGLE_SUFFICES = 64


class positional_encoder(nn.Module):
    """Coordinates with cosines and sines of their octaves (Mildenhall et al. 2020; Martin-Brualla et al. 2021).

    Parameters
    ----------
    L : int
        Number of octaves: frequencies 2⁰ … 2^(L−1), without a factor π. From 1 to 1000; above 64 the phases are formed
        in float64.

    Examples
    --------
    >>> positional_encoder(L=2)(torch.zeros(1, 1))
    tensor([[0., 1., 1., 0., 0.]])
    """

    def __init__(self, L: int):
        super().__init__()
        self.L = _validate.integer("L", L, minimum=1)
        if self.L > _HIGHEST:
            raise ValueError(f"L must be at most {_HIGHEST}, got {self.L}: 2^L would exceed what float64 holds")

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the coordinates, their cosines and their sines.

        Parameters
        ----------
        x : torch.Tensor
            Coordinates ``[..., n]``.

        Returns
        -------
        torch.Tensor
            ``[..., n + 2nL]``: x, then the cosines, then the sines; within a block all octaves of the first
            coordinate, then those of the second.
        """
        x = floating("x", x)
        if x.ndim == 0:
            raise ValueError("x must be coordinates [..., n], got a tensor without axes")
        dtype = torch.float64 if self.L > _SINGLE_SUFFICES or x.dtype == torch.float64 else torch.float32
        # Products with powers of two are exact, so that only the range of the dtype matters.
        octaves = torch.exp2(torch.arange(self.L, dtype=torch.float64)).to(x.device, dtype)
        phases = (x[..., None].to(dtype) * octaves).flatten(-2)
        return torch.cat([x, phases.cos().to(x.dtype), phases.sin().to(x.dtype)], dim=-1)

    def extra_repr(self) -> str:
        """Return the number of octaves for the printed form."""
        return f"L={self.L}"
