"""Convolutions with their normalization and activation, one by one, in pairs, around a shortcut, down and up a scale.

Convolutions are padded by ``kernel_size // 2``: odd kernels keep the size of the picture, even ones grow it by one.
"""

from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn.models.arguments import channels, kernel, pictures, with_older_form

_RELU = nn.ReLU()


class convolution_layer(nn.Module):
    """Convolution, batch normalization where asked for, activation.

    Parameters
    ----------
    input_channels, output_channels : int
        Numbers of channels.
    kernel_size : int
        Edge of the kernel in pixels.
    bias : bool
        Add a learned constant per channel.
    stride : int
        Step of the kernel in pixels. A module here, or None, is the activation of the older call form.
    normalization : bool
        Normalize over the batch (Ioffe and Szegedy 2015).
    activation : torch.nn.Module or None
        Used as it is, shared with whatever else it was given to; None for none.
    """

    def __init__(
        self,
        input_channels: int = 2,
        output_channels: int = 2,
        kernel_size: int = 3,
        bias: bool = False,
        stride: int | nn.Module | None = 1,
        normalization: bool = False,
        activation: nn.Module | None = _RELU,
    ):
        super().__init__()
        if stride is None or isinstance(stride, nn.Module):
            activation, stride = stride, 1
        normalization, activation = with_older_form(normalization, activation)
        size = kernel(kernel_size)
        layers: list[nn.Module] = [
            nn.Conv2d(
                channels("input_channels", input_channels),
                channels("output_channels", output_channels),
                kernel_size=size,
                stride=_validate.integer("stride", stride, minimum=1),
                padding=size // 2,
                bias=_validate.flag("bias", bias),
            )
        ]
        if normalization:
            layers.append(nn.BatchNorm2d(output_channels))
        if activation is not None:
            layers.append(activation)
        self.model = nn.Sequential(*layers)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the layer's output ``[B, output_channels, H', W']`` for pictures ``[B, input_channels, H, W]``."""
        first, *rest = self.model
        convolution: Any = first
        normalized = bool(rest) and isinstance(rest[0], nn.BatchNorm2d)
        axes = (4,) if normalized else (3, 4)
        return self.model(pictures("x", x, convolution.in_channels, convolution.weight, axes=axes))


class double_convolution(nn.Module):
    """Two convolution layers one after the other.

    Parameters
    ----------
    input_channels, output_channels : int
        Numbers of channels.
    mid_channels : int, optional
        Channels between the two; `output_channels` when omitted.
    kernel_size : int
        Edge of the kernels in pixels.
    bias : bool
        Add a learned constant per channel.
    normalization : bool
        Normalize over the batch after each convolution. A module here is the activation of the older call form.
    activation : torch.nn.Module or None
        Follows each convolution, one instance for both.
    """

    def __init__(
        self,
        input_channels: int = 2,
        mid_channels: int | None = None,
        output_channels: int = 2,
        kernel_size: int = 3,
        bias: bool = False,
        normalization: bool = False,
        activation: nn.Module | None = _RELU,
    ):
        super().__init__()
        normalization, activation = with_older_form(normalization, activation)
        middle = channels("output_channels", output_channels)
        middle = middle if mid_channels is None else channels("mid_channels", mid_channels)
        options: dict[str, Any] = {
            "kernel_size": kernel_size,
            "bias": bias,
            "normalization": normalization,
            "activation": activation,
        }
        self.activation = activation
        self.model = nn.Sequential(
            convolution_layer(input_channels, middle, **options), convolution_layer(middle, output_channels, **options)
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return ``[B, output_channels, H', W']`` for pictures ``[B, input_channels, H, W]``."""
        return self.model(x)


class residual_layer(nn.Module):
    """A picture plus its double convolution (He et al. 2016); no activation follows the sum.

    Parameters
    ----------
    input_channels : int
        Channels of the picture, before and after.
    mid_channels : int
        Channels between the two convolutions.
    kernel_size : int
        Edge of the kernels in pixels, odd.
    bias : bool
        Add a learned constant per channel.
    normalization : bool
        Normalize over the batch. A module here is the activation of the older call form.
    activation : torch.nn.Module or None
        Follows each convolution, the second one too.
    """

    def __init__(
        self,
        input_channels: int = 2,
        mid_channels: int = 16,
        kernel_size: int = 3,
        bias: bool = False,
        normalization: bool = True,
        activation: nn.Module | None = _RELU,
    ):
        super().__init__()
        normalization, activation = with_older_form(normalization, activation, default=True)
        self.activation = activation
        self.convolution = double_convolution(
            channels("input_channels", input_channels),
            mid_channels=mid_channels,
            output_channels=input_channels,
            kernel_size=kernel(kernel_size, odd=True),
            bias=bias,
            normalization=normalization,
            activation=activation,
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return x plus its convolutions, ``[B, input_channels, H, W]``."""
        return x + self.convolution(x)


class normalization(nn.Module):
    """Normalization over the channels of every pixel, with a learned scale (Ba et al. 2016).

    Parameters
    ----------
    dim : int
        Number of channels.
    """

    def __init__(self, dim: int = 1):
        super().__init__()
        self.k = nn.Parameter(torch.ones(1, channels("dim", dim), 1, 1))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return pictures ``[B, dim, H, W]`` less their mean over the channels, over their standard deviation."""
        count = self.k.shape[1]
        # One scale serves any number of channels.
        x = pictures("x", x, count if count > 1 else None)
        smallest = 1e-5 if x.dtype in (torch.float32, torch.float64) else 1e-3
        variance, mean = torch.var_mean(x, dim=1, unbiased=False, keepdim=True)
        return (x - mean) * torch.rsqrt(variance + smallest) * self.k


class downsample_layer(nn.Module):
    """One step down a U-Net: the maximum of 2 × 2 pixels, then a double convolution.

    Parameters
    ----------
    input_channels, output_channels : int
        Numbers of channels.
    kernel_size : int
        Edge of the kernels in pixels.
    bias : bool
        Add a learned constant per channel.
    normalization : bool
        Normalize over the batch. A module here is the activation of the older call form.
    activation : torch.nn.Module or None
        Follows each convolution.
    """

    def __init__(
        self,
        input_channels: int,
        output_channels: int,
        kernel_size: int = 3,
        bias: bool = False,
        normalization: bool = False,
        activation: nn.Module | None = _RELU,
    ):
        super().__init__()
        normalization, activation = with_older_form(normalization, activation)
        self.maxpool_conv = nn.Sequential(
            nn.MaxPool2d(2),
            double_convolution(
                input_channels,
                mid_channels=channels("output_channels", output_channels),
                output_channels=output_channels,
                kernel_size=kernel_size,
                bias=bias,
                normalization=normalization,
                activation=activation,
            ),
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return ``[B, output_channels, H // 2, W // 2]`` for pictures ``[B, input_channels, H, W]``."""
        return self.maxpool_conv(pictures("x", x, axes=(3, 4), smallest=2))


class upsample_layer(nn.Module):
    """One step up a U-Net: twice the size, joined with the picture of that size, then a double convolution.

    Parameters
    ----------
    input_channels : int
        Channels of the small picture.
    output_channels : int
        Channels of the result. The large picture has as many with `bilinear`; otherwise it has those that
        ``input_channels // 2`` leave of `input_channels`.
    kernel_size : int
        Edge of the kernels in pixels.
    bias : bool
        Add a learned constant per channel of the convolutions.
    normalization : bool
        Normalize over the batch. A module here is the activation of the older call form, and a bool after it is
        `bilinear`.
    activation : torch.nn.Module or None
        Follows each convolution.
    bilinear : bool
        Interpolate with the corners aligned; otherwise a transposed convolution with a bias.
    """

    def __init__(
        self,
        input_channels: int,
        output_channels: int,
        kernel_size: int = 3,
        bias: bool = False,
        normalization: bool = False,
        activation: nn.Module | None = _RELU,
        bilinear: bool = True,
    ):
        super().__init__()
        if isinstance(normalization, nn.Module) and isinstance(activation, bool):
            bilinear = activation
        normalization, activation = with_older_form(normalization, activation)
        half = _validate.integer("input_channels", input_channels, minimum=2) // 2
        channels("output_channels", output_channels)
        if _validate.flag("bilinear", bilinear):
            self.up: Any = nn.Upsample(scale_factor=2, mode="bilinear", align_corners=True)
        else:
            self.up = nn.ConvTranspose2d(input_channels, half, kernel_size=2, stride=2)
        self.conv = double_convolution(
            input_channels + output_channels if bilinear else input_channels,
            mid_channels=half if bilinear else output_channels,
            output_channels=output_channels,
            kernel_size=kernel_size,
            bias=bias,
            normalization=normalization,
            activation=activation,
        )

    def forward(self, x1: torch.Tensor, x2: torch.Tensor) -> torch.Tensor:
        """Return the join of a small and a large picture.

        Parameters
        ----------
        x1 : torch.Tensor
            Small pictures ``[B, input_channels, h, w]``.
        x2 : torch.Tensor
            Large pictures ``[B, C, H, W]``; the small ones, enlarged, are padded with zeros to H × W, or cropped.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H, W]``.
        """
        double: Any = self.conv.model[0]
        convolution = double.model[0]
        transposed = isinstance(self.up, nn.ConvTranspose2d)
        x1 = pictures("x1", x1, self.up.in_channels if transposed else None, convolution.weight)
        small = self.up.out_channels if transposed else x1.shape[1]
        x2 = pictures("x2", x2, convolution.in_channels - small, convolution.weight)
        if len(x1) != len(x2):
            raise ValueError(f"x1 and x2 must be as many pictures, got {len(x1)} and {len(x2)}")
        return self.conv(torch.cat([x2, _fit(self.up(x1), x2)], dim=1))


class upsample_convtranspose2d_layer(nn.Module):
    """A transposed convolution of a small picture plus the picture of the larger size.

    Parameters
    ----------
    input_channels, output_channels : int
        Numbers of channels.
    kernel_size : int
        Edge of the kernel in pixels.
    stride : int
        Enlargement.
    bias : bool
        Add a learned constant per channel.
    """

    def __init__(
        self, input_channels: int, output_channels: int, kernel_size: int = 2, stride: int = 2, bias: bool = False
    ):
        super().__init__()
        self.up = nn.ConvTranspose2d(
            channels("input_channels", input_channels),
            channels("output_channels", output_channels),
            kernel_size=kernel(kernel_size),
            stride=_validate.integer("stride", stride, minimum=1),
            bias=_validate.flag("bias", bias),
        )

    def forward(self, x1: torch.Tensor, x2: torch.Tensor) -> torch.Tensor:
        """Return the sum of a small and a large picture.

        Parameters
        ----------
        x1 : torch.Tensor
            Small pictures ``[B, input_channels, h, w]``.
        x2 : torch.Tensor
            Large pictures ``[B, output_channels, H, W]``; the small ones, enlarged, are padded with zeros to H × W, or
            cropped.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H, W]``.
        """
        x1 = pictures("x1", x1, self.up.in_channels, self.up.weight)
        x2 = pictures("x2", x2, self.up.out_channels)
        _validate.fitting(x1=x1[:, :1, :1, :1], x2=x2[:, :1, :1, :1])
        return _fit(self.up(x1), x2) + x2


def _fit(picture: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Pad with zeros, or crop, to the size of another picture; an odd pixel goes to the right or the bottom."""
    dy, dx = (target.shape[axis] - picture.shape[axis] for axis in (-2, -1))
    if dy == dx == 0:
        return picture
    return nn.functional.pad(picture, [dx // 2, dx - dx // 2, dy // 2, dy - dy // 2])
