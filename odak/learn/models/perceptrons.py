"""Fully connected networks of coordinates or features, their activations, and encodings of coordinates."""

import copy
import itertools
import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn._tensors import floating
from odak.learn.models.layers import activation_module, channels, features


def gaussian(x: torch.Tensor, multiplier: float | torch.Tensor = 1.0) -> torch.Tensor:
    r"""Return :math:`e^{-(m x)^2}` element by element.

    Parameters
    ----------
    x : torch.Tensor
        Input.
    multiplier : float or torch.Tensor
        Inverse width :math:`m`; a tensor is broadcast against `x`.

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

    Examples
    --------
    x·sigmoid(x) at 1:

    >>> import torch
    >>> from odak.learn.models import swish
    >>> round(swish(torch.tensor(1.0)).item(), 4)
    0.7311
    """
    return nn.functional.silu(features("x", x))


class gaussian_activation(nn.Module):
    """Gaussian with a learned inverse width per feature (Ramasinghe and Lucey 2022).

    Parameters
    ----------
    dim : int
        Number of features, the last axis of the input.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import gaussian_activation
    >>> tuple(gaussian_activation(4)(torch.rand(8, 4)).shape)
    (8, 4)
    """

    def __init__(self, dim: int):
        super().__init__()
        self.alpha: nn.Parameter = nn.Parameter(torch.randn(1, channels("dim", dim)))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return exp(−(alpha·x)²) for an input ``[..., dim]``.

        Parameters
        ----------
        x : torch.Tensor
            Real floats ``[..., dim]``.

        Returns
        -------
        torch.Tensor
            In the shape of `x`.
        """
        return gaussian(features("x", x, self.alpha.shape[-1]), self.alpha)


class swish_activation(nn.Module):
    """Swish, x·sigmoid(x), as a module (Ramachandran et al. 2017).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import swish_activation
    >>> round(swish_activation()(torch.tensor(1.0)).item(), 4)
    0.7311
    """

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return x·sigmoid(x) for an input of any shape.

        Parameters
        ----------
        x : torch.Tensor
            Real floats of any shape.

        Returns
        -------
        torch.Tensor
            In the shape of `x`.
        """
        return swish(x)


class siren_activation(nn.Module):
    """Sine activation of SIREN networks, sin(ωx) (Sitzmann et al. 2020, equation 9).

    Parameters
    ----------
    multiplier : float
        Angular frequency ω by which the input is multiplied.

    Examples
    --------
    sin(30·0.05):

    >>> import torch
    >>> from odak.learn.models import siren_activation
    >>> round(siren_activation(30.0)(torch.tensor(0.05)).item(), 4)
    0.9975
    """

    def __init__(self, multiplier: float = 1.0):
        super().__init__()
        self.multiplier: float = _validate.real("multiplier", multiplier)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return sin(multiplier·x) for an input of any shape.

        Parameters
        ----------
        x : torch.Tensor
            Real floats of any shape.

        Returns
        -------
        torch.Tensor
            In the shape of `x`.
        """
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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import film_siren_activation
    >>> tuple(film_siren_activation(4)(torch.rand(8, 4)).shape)
    (8, 4)
    """

    def __init__(self, dim: int):
        super().__init__()
        self.alpha: nn.Parameter = nn.Parameter(torch.randn(2, channels("dim", dim)))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return sin(alpha[0]·x + alpha[1]) for an input ``[..., dim]``.

        Parameters
        ----------
        x : torch.Tensor
            Real floats ``[..., dim]``.

        Returns
        -------
        torch.Tensor
            In the shape of `x`.
        """
        return torch.sin(self.alpha[0] * features("x", x, self.alpha.shape[-1]) + self.alpha[1])


_MAXIMUM_OCTAVES = 1000
# Up to here the largest frequency, 2^63, times a coordinate is far below the largest float32 (2^128).
_FLOAT32_OCTAVES = 64


class positional_encoder(nn.Module):
    """Cosines and sines of the octaves of coordinates (Mildenhall et al. 2020; Martin-Brualla et al. 2021).

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
        self.L = _validate.integer("L", L, minimum=1, most=_MAXIMUM_OCTAVES, unit="(2^L within the range of float64)")

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
            coordinate, then of the second.
        """
        x = floating("x", x)
        if x.ndim == 0:
            raise ValueError("x must be coordinates [..., n], got a tensor without axes")
        dtype = torch.float64 if self.L > _FLOAT32_OCTAVES or x.dtype == torch.float64 else torch.float32
        # Products with powers of two are exact, so that only the range of the dtype matters.
        octaves = torch.exp2(torch.arange(self.L, dtype=torch.float64)).to(x.device, dtype)
        phases = (x[..., None].to(dtype) * octaves).flatten(-2)
        return torch.cat([x, phases.cos().to(x.dtype), phases.sin().to(x.dtype)], dim=-1)

    def extra_repr(self) -> str:
        """Return the number of octaves for the printed form."""
        return f"L={self.L}"


# Primes of the spatial hash; the first is 1, so that neighbours along the first axis are adjacent in memory.
_PRIMES = (1, 2654435761, 805459861, 3674653429, 2097192037, 1434869437, 2165219737)


class hash_grid_encoder(nn.Module):
    """Multiresolution hash encoding: learned features interpolated from grids of several resolutions.

    A level whose grid has more corners than the table has entries shares entries by a spatial hash (Müller, Evans,
    Schied and Keller, ACM Trans. Graph. 41, 102, 2022). A small perceptron of these features learns fine detail in far
    fewer steps than one of coordinates.

    Parameters
    ----------
    dimensions : int
        Number of coordinates, from 1 to 7.
    levels : int
        Number of grids.
    features : int
        Number of learned features at each corner.
    table_size : int
        Largest number of entries of a level.
    coarsest : int
        Cells along each axis of the coarsest grid.
    finest : int
        Cells along each axis of the finest grid; those between grow geometrically.
    low : float
        Lowest coordinate, where the grids begin; coordinates outside are clamped.
    high : float
        Highest coordinate, where the grids end.

    Attributes
    ----------
    table : torch.nn.Parameter
        The features ``[entries of all levels, features]``, drawn from U(±1e-4).
    output_features : int
        Number of features returned for each point, levels·features.

    Raises
    ------
    ValueError
        If a number is outside its range.

    Examples
    --------
    >>> import torch
    >>> encoder = hash_grid_encoder(dimensions=2, levels=4, features=2, finest=64)
    >>> network = torch.nn.Sequential(encoder, multi_layer_perceptron([encoder.output_features, 32, 1], bias=True))
    >>> network(torch.rand(5, 2)).shape
    torch.Size([5, 1])
    """

    resolutions: torch.Tensor
    strides: torch.Tensor
    sizes: torch.Tensor
    starts: torch.Tensor
    corners: torch.Tensor
    low: float
    high: float

    def __init__(
        self,
        dimensions: int = 2,
        levels: int = 16,
        features: int = 2,
        table_size: int = 1 << 14,
        coarsest: int = 16,
        finest: int = 512,
        low: float = -1.0,
        high: float = 1.0,
    ):
        super().__init__()
        self.dimensions: int = _validate.within("dimensions", channels("dimensions", dimensions), most=len(_PRIMES))
        levels, count = channels("levels", levels), channels("features", features)
        table_size, coarsest = channels("table_size", table_size), channels("coarsest", coarsest)
        _validate.integer("finest", finest, minimum=coarsest)
        self.low, self.high = _validate.few("low and high", (low, high), 2, rising=True)
        growth = (finest / coarsest) ** (1 / max(levels - 1, 1))
        cells = [int(coarsest * growth**level + 1e-9) for level in range(levels)]
        sizes = [min((n + 1) ** self.dimensions, table_size) for n in cells]
        strides = [[(n + 1) ** axis for axis in range(self.dimensions)] for n in cells]
        tables = {
            "resolutions": torch.tensor(cells),
            "sizes": torch.tensor(sizes),
            "starts": torch.tensor([0, *itertools.accumulate(sizes[:-1])]),
            "strides": torch.tensor(
                [
                    steps if (n + 1) ** self.dimensions <= table_size else [0] * self.dimensions
                    for n, steps in zip(cells, strides, strict=True)
                ]
            ),
            "corners": torch.cartesian_prod(*[torch.tensor([0, 1])] * self.dimensions).reshape(-1, self.dimensions),
        }
        for name, value in tables.items():
            self.register_buffer(name, value, persistent=False)
        self.output_features: int = levels * count
        self.table: nn.Parameter = nn.Parameter(torch.empty(sum(sizes), count).uniform_(-1e-4, 1e-4))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the features of points.

        Parameters
        ----------
        x : torch.Tensor
            Coordinates ``[..., dimensions]``.

        Returns
        -------
        torch.Tensor
            ``[..., levels·features]``, the coarsest level first.
        """
        x = features("x", x, self.dimensions, self.table)
        share = ((x - self.low) / (self.high - self.low)).clamp(0, 1)
        place = share[..., None, :] * self.resolutions[:, None]
        # The last corner belongs to the last cell.
        cell = place.detach().nan_to_num(0.0).floor().minimum(self.resolutions[:, None] - 1)
        inside = (place - cell)[..., None, :]
        corner = cell.long()[..., None, :] + self.corners
        weight = torch.where(self.corners.bool(), inside, 1 - inside).prod(-1)
        dense = (corner * self.strides[:, None]).sum(-1)
        hashed = corner[..., 0]
        for axis in range(1, self.dimensions):
            hashed = hashed ^ (corner[..., axis] * _PRIMES[axis])
        entry = torch.where(self.strides[:, :1] > 0, dense, hashed.remainder(self.sizes[:, None]))
        found = self.table[entry + self.starts[:, None]]
        return (weight[..., None] * found).sum(-2).flatten(-2)

    def extra_repr(self) -> str:
        """Return the resolutions for the printed form."""
        return f"dimensions={self.dimensions}, resolutions={self.resolutions.tolist()}"


_RELU = nn.ReLU(inplace=True)
_TYPES = ("conventional", "swish", "SIREN", "FILM SIREN", "Gaussian")


class multi_layer_perceptron(nn.Module):
    """Linear layers with an activation after each but the last.

    Parameters
    ----------
    dimensions : list of int
        Features of the input, of each hidden layer and of the output.
    activation : torch.nn.Module or None
        For ``"conventional"``: each layer gets a copy of it.
    bias : bool
        Add a learned constant to each feature.
    model_type : {"conventional", "swish", "SIREN", "FILM SIREN", "Gaussian"}
        Activations: `activation`; x·sigmoid(x) (Ramachandran et al. 2017); sin(ωx) (Sitzmann et al. 2020); a sine with
        a learned frequency and phase per feature (Chan et al. 2021); a Gaussian with a learned width per feature
        (Ramasinghe and Lucey 2022).
    siren_multiplier : float
        ω of ``"SIREN"``.
    input_multiplier : float, optional
        Start of a learned factor of each input feature; no such factor when omitted.
    uniform_flag : bool
        Initialize the two types of sines as published, so that activations are spread alike in all layers (Sitzmann et
        al. 2020, section 3.2): first weights U(±1/n), the others U(±√(6/n)/ω), n inputs to a layer, and biases
        U(±1/√n) as in the published implementation. In ``"FILM SIREN"`` the learned frequencies take the place of ω,
        hence ω = 1 there.

    Raises
    ------
    ValueError
        If there are fewer than two dimensions, one is not a positive integer, or the type is unknown.

    Examples
    --------
    >>> network = multi_layer_perceptron([2, 64, 64, 3], model_type="SIREN", bias=True)
    >>> network(torch.rand(5, 2)).shape
    torch.Size([5, 3])
    """

    bias: bool
    uniform_flag: bool

    def __init__(
        self,
        dimensions: Sequence[int],
        activation: nn.Module | None = _RELU,
        bias: bool = False,
        model_type: str = "conventional",
        siren_multiplier: float = 30.0,
        input_multiplier: float | None = None,
        uniform_flag: bool = True,
    ):
        super().__init__()
        whole = isinstance(dimensions, (list, tuple)) and all(type(n) is int and n > 0 for n in dimensions)
        if not whole or len(dimensions) < 2:
            raise ValueError(f"dimensions must be a list of at least two positive integers, got {dimensions!r}")
        self.dimensions: list[int] = list(dimensions)
        self.model_type: str = _validate.one_of("model_type", model_type, _TYPES)
        self.siren_multiplier: float = _validate.real("siren_multiplier", siren_multiplier, positive=True)
        self.bias = bias = _validate.flag("bias", bias)
        self.uniform_flag = uniform_flag = _validate.flag("uniform_flag", uniform_flag)
        self.input_multiplier: nn.Parameter | None = None
        if input_multiplier is not None:
            factor = _validate.constant("input_multiplier", input_multiplier)
            self.input_multiplier = nn.Parameter(torch.full((1, self.dimensions[0]), factor))
        layers = []
        activation_module(activation)
        for inputs, results in itertools.pairwise(self.dimensions):
            layers += [nn.Linear(inputs, results, bias=bias), self._activation(results, activation)]
        self.model: nn.Sequential = nn.Sequential(*(layer for layer in layers[:-1] if layer is not None))
        if uniform_flag and "SIREN" in self.model_type:
            self._spread()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the output of the network.

        Parameters
        ----------
        x : torch.Tensor
            ``[..., dimensions[0]]``.

        Returns
        -------
        torch.Tensor
            ``[..., dimensions[-1]]``.
        """
        first: Any = self.model[0]
        x = features("x", x, self.dimensions[0], first.weight)
        return self.model(x if self.input_multiplier is None else self.input_multiplier * x)

    def _activation(self, features, activation):
        match self.model_type:
            case "swish":
                return swish_activation()
            case "SIREN":
                return siren_activation(self.siren_multiplier)
            case "FILM SIREN":
                return film_siren_activation(features)
            case "Gaussian":
                return gaussian_activation(features)
        return copy.deepcopy(activation)

    @torch.no_grad()
    def _spread(self):
        frequency = self.siren_multiplier if self.model_type == "SIREN" else 1.0
        linear = [layer for layer in self.model if isinstance(layer, nn.Linear)]
        for position, layer in enumerate(linear):
            inputs = layer.in_features
            limit = 1 / inputs if position == 0 else math.sqrt(6 / inputs) / frequency
            layer.weight.uniform_(-limit, limit)
            if layer.bias is not None:
                layer.bias.uniform_(-1 / math.sqrt(inputs), 1 / math.sqrt(inputs))
