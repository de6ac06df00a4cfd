"""Gaussians whose places, sizes and heights are learned: flat ones on a picture, and ones in space."""

import logging
import math
import os
from collections.abc import Mapping

import torch
from torch import nn

from odak import _validate
from odak.learn._tensors import trainable
from odak.learn.models.gaussian_sums import sum_of_soft_gaussians
from odak.learn.models.gaussian_volume import gaussian_3d_volume, whole_number
from odak.learn.models.weights import EXTENSIONS, load_weights, save_weights
from odak.log import logger as _log
from odak.tools._paths import validate_path

__all__ = ["gaussian_2d", "gaussian_3d_volume", "gaussians_2d"]

_RANGES = {"widths": (0.1, 0.5), "offsets": (-1.0, 1.0), "rotations": (0.0, 2 * math.pi), "alphas": (0.1, 0.2)}


class gaussian_2d(nn.Module):
    """Flat Gaussians, each with a softly limited height: tanh(α·exp(−(u/w₀)² − (v/w₁)²)).

    A point is first turned by ρ, then shifted: u = x·cos ρ − y·sin ρ + o₀ and v = x·sin ρ + y·cos ρ + o₁.

    Parameters
    ----------
    number_of_elements : int
        Number N of Gaussians.

    Attributes
    ----------
    widths, offsets : torch.nn.Parameter
        w and o, ``[2, 1, N]``.
    rotations, alphas : torch.nn.Parameter
        ρ in radians and α, ``[1, N]``.

    Raises
    ------
    ValueError
        If the number is not a positive integer.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import gaussian_2d
    >>> gaussian_2d(4)(torch.zeros(5, 1), torch.zeros(5, 1)).shape
    torch.Size([5, 4])
    """

    widths: nn.Parameter
    offsets: nn.Parameter
    rotations: nn.Parameter
    alphas: nn.Parameter

    def __init__(self, number_of_elements: int = 10):
        super().__init__()
        self.number_of_elements = whole_number("number_of_elements", number_of_elements)
        shapes = {"widths": (2, 1), "offsets": (2, 1), "rotations": (1,), "alphas": (1,)}
        for name, shape in shapes.items():
            self.register_parameter(name, nn.Parameter(torch.empty(*shape, self.number_of_elements)))
        self.initialize_parameters_uniformly()

    @torch.no_grad()
    def initialize_parameters_uniformly(self, ranges: Mapping[str, tuple[float, float]] | None = None) -> None:
        """Draw the parameters anew, from normal distributions whatever the name says.

        Parameters
        ----------
        ranges : dict, optional
            Range (a, b) of "widths", "offsets", "rotations" and "alphas", of mean (a + b)/2 and standard deviation
            (b − a)/4; those not given are (0.1, 0.5), (−1, 1), (0, 2π) and (0.1, 0.2).

        Raises
        ------
        ValueError
            If a name is unknown or a range does not ascend.
        """
        if not isinstance(ranges, (Mapping, type(None))):
            raise TypeError(f"ranges must be a dict, got {type(ranges).__name__}")
        ranges = {} if ranges is None else dict(ranges)
        if unknown := sorted(set(ranges) - set(_RANGES)):
            raise ValueError(f"ranges must be of {', '.join(_RANGES)}; got {', '.join(map(repr, unknown))}")
        for name, (low, high) in {**_RANGES, **ranges}.items():
            for end in (low, high):
                _validate.real(f"ranges[{name!r}]", end)
            if not low <= high:
                raise ValueError(f"ranges[{name!r}] must ascend, got {(low, high)}")
            getattr(self, name).normal_((low + high) / 2, (high - low) / 4)

    def forward(self, x: torch.Tensor, y: torch.Tensor, residual: float = 1e-6) -> torch.Tensor:
        """Return the value of each Gaussian at points.

        Parameters
        ----------
        x, y : torch.Tensor
            Coordinates ``[..., 1]``, or ``[...]`` with a last axis of another length, such as a grid ``[H, W]``.
        residual : float
            Without effect; kept for callers that pass it.

        Returns
        -------
        torch.Tensor
            ``[..., N]``.
        """
        x, y = _coordinates(x, y)
        cosine, sine = self.rotations.cos(), self.rotations.sin()
        u = (x * cosine - y * sine + self.offsets[0]) / self.widths[0]
        v = (x * sine + y * cosine + self.offsets[1]) / self.widths[1]
        return torch.tanh(self.alphas * torch.exp(-u.square() - v.square()))

    def total(self, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """Return the sum of :meth:`forward` over the Gaussians ``[..., 1]``, in memory that does not grow with N.

        Far Gaussians are left out where they are below rounding error. Differentiable once, in the coordinates too.
        """
        x, y = torch.broadcast_tensors(*_coordinates(x, y))
        cosine, sine = self.rotations[0].cos(), self.rotations[0].sin()
        (w0, w1), (o0, o1) = self.widths[:, 0], self.offsets[:, 0]
        rows = torch.stack([cosine / w0, -sine / w0, o0 / w0, sine / w1, cosine / w1, o1 / w1], dim=-1)
        points = torch.stack([x.flatten(), y.flatten()], dim=-1)
        return sum_of_soft_gaussians(points, rows, self.alphas[0]).view(x.shape)


class gaussians_2d(nn.Module):
    """A picture as a sum of flat Gaussians, see :class:`gaussian_2d`.

    Parameters
    ----------
    number_of_elements : int
        Number of Gaussians.
    logger : logging.Logger, optional
        Where to log; the package's own by default.

    Attributes
    ----------
    model : gaussian_2d
        The Gaussians.
    number_of_elements, total_params : int
        Number of Gaussians and of their parameters.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import gaussians_2d
    >>> y, x = torch.meshgrid(torch.linspace(-1, 1, 8), torch.linspace(-1, 1, 12), indexing="ij")
    >>> gaussians_2d(100)(x, y).shape
    torch.Size([8, 12, 1])
    """

    def __init__(self, number_of_elements: int = 10, logger: logging.Logger | None = None):
        super().__init__()
        self.model = gaussian_2d(number_of_elements)
        self.number_of_elements = self.model.number_of_elements
        self.total_params = sum(parameter.numel() for parameter in self.parameters())
        if not (logger is None or hasattr(logger, "debug")):
            raise TypeError(f"logger must be a logging.Logger, got {type(logger).__name__}")
        self.logger = _log if logger is None else logger
        self.logger.debug("%d Gaussians with %d parameters", self.number_of_elements, self.total_params)

    def forward(self, x: torch.Tensor, y: torch.Tensor, test: bool = False) -> torch.Tensor:
        """Return the sum of the Gaussians at points.

        Parameters
        ----------
        x, y : torch.Tensor
            Coordinates ``[..., 1]``, or ``[...]`` with a last axis of another length, such as a grid ``[H, W]``.
        test : bool
            Keep nothing for gradients.

        Returns
        -------
        torch.Tensor
            ``[..., 1]``.
        """
        with torch.set_grad_enabled(torch.is_grad_enabled() and not _validate.flag("test", test)):
            return self.model.total(x, y)

    def save_weights(self, weights_filename: str | os.PathLike) -> None:
        """Write the parameters to a ``.pt`` or ``.pth`` file, whole or not at all.

        Raises
        ------
        ValueError
            If the path is not acceptable or its folder does not exist.
        """
        validate_path(weights_filename, EXTENSIONS, name="weights_filename")
        save_weights(self, weights_filename)
        self.logger.info("Gaussians saved to %s", weights_filename)

    def load_weights(
        self,
        weights_filename: str | os.PathLike | None = None,
        device: torch.device | str | None = "cpu",
    ) -> None:
        """Read the parameters from a file of :meth:`save_weights`, and switch to evaluation.

        Parameters
        ----------
        weights_filename : str or os.PathLike, optional
            ``.pt`` or ``.pth`` file; None does nothing.
        device : torch.device or str
            Device to read the tensors to on their way; the parameters stay on theirs.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If the path is not acceptable, or the file is broken, would run code or holds other parameters.
        """
        if weights_filename is not None:
            validate_path(weights_filename, EXTENSIONS, name="weights_filename")
            load_weights(self, weights_filename, device=device)
            self.logger.info("Gaussians loaded from %s", weights_filename)


def _coordinates(x, y):
    for name, coordinate in (("x", x), ("y", y)):
        if not isinstance(coordinate, torch.Tensor) or coordinate.is_complex():
            raise TypeError(f"x and y must be tensors, real ones; got {type(coordinate).__name__} for {name}")
    x, y = (
        coordinate if coordinate.ndim and coordinate.shape[-1] == 1 else coordinate.unsqueeze(-1)
        for coordinate in (trainable(x), trainable(y))
    )
    _validate.fitting(x=x, y=y)
    return x, y
