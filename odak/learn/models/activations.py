"""Activations of coordinate networks: Gaussian, swish, sine, modulated sine."""

import torch
from torch import nn

from odak import _validate
from odak.learn.models.arguments import channels, features


def gaussian(x: torch.Tensor, multiplier: float | torch.Tensor = 1.0) -> torch.Tensor:
    r"""Return :math:`e^{-(m x)^2}` element by element.

    Parameters
    ----------
    x : torch.Tensor
        Input.
    multiplier : float or torch.Tensor
        Inverse width :math:`m`; a tensor broadcasts against `x`.

    Returns
    -------
    torch.Tensor
        Values between 0 and 1.

    Examples
    --------
    >>> gaussian(torch.tensor([0.0, 1.0]), 2.0)
    tensor([1.0000, 0.0183])
    """
    x = features("x", x)
    if isinstance(multiplier, torch.Tensor):
        _validate.fitting(x=x, multiplier=multiplier)
    else:
        _validate.real("multiplier", multiplier)
    return torch.exp(-((multiplier * x) ** 2))


def swish(x: torch.Tensor) -> torch.Tensor:
    """Return x·sigmoid(x) element by element (Ramachandran et al. 2017).

    Parameters
    ----------
    x : torch.Tensor
        Input.

    Returns
    -------
    torch.Tensor
        The same shape and dtype.
    """
    return nn.functional.silu(features("x", x))


class gaussian_activation(nn.Module):
    """Gaussian with a learned inverse width per feature (Ramasinghe and Lucey 2022).

    Parameters
    ----------
    dim : int
        Number of features, the last axis of the input.
    """

    def __init__(self, dim: int):
        super().__init__()
        self.alpha = nn.Parameter(torch.randn(1, channels("dim", dim)))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return exp(−(alpha·x)²) for an input ``[..., dim]``."""
        return gaussian(features("x", x, self.alpha.shape[-1]), self.alpha)


class swish_activation(nn.Module):
    """Swish, x·sigmoid(x), as a module (Ramachandran et al. 2017)."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return x·sigmoid(x) for an input of any shape."""
        return swish(x)


class siren_activation(nn.Module):
    """Sine of a network of sines (Sitzmann et al. 2020, equation 9).

    Parameters
    ----------
    multiplier : float
        Angular frequency ω by which the input is multiplied.
    """

    def __init__(self, multiplier: float = 1.0):
        super().__init__()
        self.multiplier = _validate.real("multiplier", multiplier)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return sin(multiplier·x) for an input of any shape."""
        return torch.sin(self.multiplier * features("x", x))

    def extra_repr(self) -> str:
        """Return the multiplier for the printed form."""
        return f"multiplier={self.multiplier}"


class film_siren_activation(nn.Module):
    """Sine with a learned frequency and phase per feature (Chan et al. 2021, equation 2).

    Parameters
    ----------
    dim : int
        Number of features, the last axis of the input.
    """

    def __init__(self, dim: int):
        super().__init__()
        self.alpha = nn.Parameter(torch.randn(2, channels("dim", dim)))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return sin(alpha[0]·x + alpha[1]) for an input ``[..., dim]``."""
        return torch.sin(self.alpha[0] * features("x", x, self.alpha.shape[-1]) + self.alpha[1])
