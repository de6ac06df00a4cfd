"""Fully connected networks of coordinates or features."""

import copy
import itertools
import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn.models.activations import (
    film_siren_activation,
    gaussian_activation,
    siren_activation,
    swish_activation,
)
from odak.learn.models.arguments import activation_module, features

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
        al. 2020, section 3.2): first weights U(±1/n), the others U(±√(6/n)/ω), n inputs to a layer, biases 0. Their
        learned frequencies stand for ω in ``"FILM SIREN"``, hence ω = 1 there.

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
        self.dimensions = _dimensions(dimensions)
        self.model_type = _validate.one_of("model_type", model_type, _TYPES)
        self.siren_multiplier = _validate.real("siren_multiplier", siren_multiplier, positive=True)
        self.bias = bias = _validate.flag("bias", bias)
        self.uniform_flag = uniform_flag = _validate.flag("uniform_flag", uniform_flag)
        self.input_multiplier = None
        if input_multiplier is not None:
            factor = float(_validate.real("input_multiplier", input_multiplier))
            self.input_multiplier = nn.Parameter(torch.full((1, self.dimensions[0]), factor))
        layers = []
        activation_module(activation)
        for inputs, results in itertools.pairwise(self.dimensions):
            layers += [nn.Linear(inputs, results, bias=bias), self._activation(results, activation)]
        self.model = nn.Sequential(*(layer for layer in layers[:-1] if layer is not None))
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
                layer.bias.zero_()


def _dimensions(dimensions) -> list[int]:
    whole = isinstance(dimensions, (list, tuple)) and all(type(n) is int and n > 0 for n in dimensions)
    if not whole or len(dimensions) < 2:
        raise ValueError(f"dimensions must be a list of at least two positive integers, got {dimensions!r}")
    return list(dimensions)
