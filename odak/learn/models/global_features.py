"""Scale and offset of whole channels, learned from what another picture holds on the whole (Huang et al. 2018)."""

from typing import Any

import torch
from torch import nn

from odak.learn.models.arguments import channels, pictures, same_batch, with_older_form
from odak.learn.models.convolution_layers import double_convolution

_RELU = nn.ReLU()


class global_transformations(nn.Module):
    """A picture times one number per channel plus another one, both made of the channel means of a second picture.

    Parameters
    ----------
    input_channels : int
        Channels of the second picture.
    output_channels : int
        Channels of the first one.
    """

    def __init__(self, input_channels: int, output_channels: int):
        super().__init__()
        inner = channels("input_channels", input_channels)
        outer = channels("output_channels", output_channels)
        self.global_feature_1 = nn.Sequential(nn.Linear(inner, outer), nn.LeakyReLU(0.2))
        self.global_feature_2 = nn.Sequential(nn.Linear(outer, outer), nn.LeakyReLU(0.2))

    def forward(self, x1: torch.Tensor, x2: torch.Tensor) -> torch.Tensor:
        """Return the transformed picture.

        Parameters
        ----------
        x1 : torch.Tensor
            Pictures ``[B, output_channels, H, W]``.
        x2 : torch.Tensor
            Pictures ``[B, input_channels, H', W']`` that the two numbers are made of.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H, W]``.
        """
        first: Any = self.global_feature_1[0]
        second: Any = self.global_feature_2[0]
        x1 = pictures("x1", x1, second.in_features, second.weight)
        x2 = pictures("x2", x2, first.in_features, first.weight)
        same_batch(x1=x1, x2=x2)
        scale = self.global_feature_1(x2.mean(dim=(2, 3)))
        offset = self.global_feature_2(scale)
        return x1 * scale[:, :, None, None] + offset[:, :, None, None]


class global_feature_module(nn.Module):
    """Two double convolutions between two global transformations.

    Parameters
    ----------
    input_channels, output_channels : int
        Channels of the pictures before and after; they are the same number.
    mid_channels : int
        Channels inside the double convolutions.
    kernel_size : int
        Edge of the kernels in pixels.
    bias : bool
        Add a learned constant per channel of the convolutions.
    normalization : bool
        Normalize over the batch. A module here is the activation.
    activation : torch.nn.Module or None
        Follows each convolution.

    Raises
    ------
    ValueError
        If the numbers of channels before and after differ.
    """

    def __init__(
        self,
        input_channels: int,
        mid_channels: int,
        output_channels: int,
        kernel_size: int,
        bias: bool = False,
        normalization: bool = False,
        activation: nn.Module | None = _RELU,
    ):
        super().__init__()
        normalization, activation = with_older_form(normalization, activation)
        if channels("input_channels", input_channels) != channels("output_channels", output_channels):
            raise ValueError(
                f"output_channels must be input_channels ({input_channels}), for one follows the other twice; "
                f"got {output_channels}"
            )
        options: dict[str, Any] = {
            "mid_channels": mid_channels,
            "kernel_size": kernel_size,
            "bias": bias,
            "normalization": normalization,
            "activation": activation,
        }
        self.transformations_1 = global_transformations(input_channels, output_channels)
        self.global_features_1 = double_convolution(input_channels, output_channels=output_channels, **options)
        self.global_features_2 = double_convolution(input_channels, output_channels=output_channels, **options)
        self.transformations_2 = global_transformations(input_channels, output_channels)

    def forward(self, x1: torch.Tensor, x2: torch.Tensor) -> torch.Tensor:
        """Return the features of a picture.

        Parameters
        ----------
        x1 : torch.Tensor
            Pictures ``[B, input_channels, H, W]``.
        x2 : torch.Tensor
            Pictures of as many channels whose means steer the first transformation.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H, W]``.
        """
        first = self.global_features_1(self.transformations_1(x1, x2))
        return self.transformations_2(first, self.global_features_2(first))
