"""Convolutional layers: single, double, residual, and the steps of a U-Net, with normalization and activation.

Convolutions are padded by ``kernel_size // 2``: odd kernels keep the size of the image, even ones grow it by one.
"""

from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn.models._inputs import channels, images, kernel, with_older_form

_RELU = nn.ReLU()


class convolution_layer(nn.Module):
    """Convolution, optional batch normalization, activation.

    Parameters
    ----------
    input_channels : int
        Channels of the input.
    output_channels : int
        Channels of the result.
    kernel_size : int
        Edge of the kernel in pixels.
    bias : bool
        Add a learned constant per channel.
    stride : int
        Step of the kernel in pixels. A module here, or None, is the activation of the older call form.
    normalization : bool
        Normalize over the batch (Ioffe and Szegedy 2015).
    activation : torch.nn.Module or None
        Used as given, not copied, so that layers built with one instance share its parameters; None for none.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import convolution_layer
    >>> tuple(convolution_layer(2, 4)(torch.rand(1, 2, 8, 8)).shape)
    (1, 4, 8, 8)
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
        """Return the layer's output ``[B, output_channels, H', W']`` for images ``[B, input_channels, H, W]``.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, input_channels, H, W]``.
        """
        first, *rest = self.model
        convolution: Any = first
        normalized = bool(rest) and isinstance(rest[0], nn.BatchNorm2d)
        axes = (4,) if normalized else (3, 4)
        return self.model(images("x", x, convolution.in_channels, convolution.weight, axes=axes))


class double_convolution(nn.Module):
    """Two convolution layers one after the other.

    Parameters
    ----------
    input_channels : int
        Channels of the input.
    output_channels : int
        Channels of the result.
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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import double_convolution
    >>> tuple(double_convolution(2, output_channels=4)(torch.rand(1, 2, 8, 8)).shape)
    (1, 4, 8, 8)
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
        """Return ``[B, output_channels, H', W']`` for images ``[B, input_channels, H, W]``.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, input_channels, H, W]``.
        """
        return self.model(x)


class residual_layer(nn.Module):
    """Residual block: an image plus its double convolution (He et al. 2016); no activation follows the sum.

    Parameters
    ----------
    input_channels : int
        Channels of the image, before and after.
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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import residual_layer
    >>> tuple(residual_layer(2)(torch.rand(1, 2, 8, 8)).shape)
    (1, 2, 8, 8)
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
        """Return x plus its convolutions, ``[B, input_channels, H, W]``.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, input_channels, H, W]``.
        """
        return x + self.convolution(x)


class normalization(nn.Module):
    """Normalization over the channels of every pixel, with a learned scale (Ba et al. 2016).

    Parameters
    ----------
    dim : int
        Number of channels.

    Examples
    --------
    The mean over the channels of each pixel becomes zero:

    >>> import torch
    >>> from odak.learn.models import normalization
    >>> image = normalization(4)(torch.rand(1, 4, 8, 8))
    >>> bool(image.mean(dim=1).abs().max() < 1e-5)
    True
    """

    def __init__(self, dim: int = 1):
        super().__init__()
        self.k = nn.Parameter(torch.ones(1, channels("dim", dim), 1, 1))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return images ``[B, dim, H, W]`` minus their mean over the channels, divided by their standard deviation.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, dim, H, W]``.
        """
        count = self.k.shape[1]
        # A single scale is broadcast over any number of channels.
        x = images("x", x, count if count > 1 else None)
        smallest = 1e-5 if x.dtype in (torch.float32, torch.float64) else 1e-3
        variance, mean = torch.var_mean(x, dim=1, unbiased=False, keepdim=True)
        return (x - mean) * torch.rsqrt(variance + smallest) * self.k


class downsample_layer(nn.Module):
    """Contracting step of a U-Net: max pooling over 2 × 2 pixels, then a double convolution.

    Parameters
    ----------
    input_channels : int
        Channels of the input.
    output_channels : int
        Channels of the result.
    kernel_size : int
        Edge of the kernels in pixels.
    bias : bool
        Add a learned constant per channel.
    normalization : bool
        Normalize over the batch. A module here is the activation of the older call form.
    activation : torch.nn.Module or None
        Follows each convolution.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import downsample_layer
    >>> tuple(downsample_layer(2, 4)(torch.rand(1, 2, 8, 8)).shape)
    (1, 4, 4, 4)
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
        """Return ``[B, output_channels, H // 2, W // 2]`` for images ``[B, input_channels, H, W]``.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, input_channels, H, W]`` of at least 2×2 pixels.
        """
        return self.maxpool_conv(images("x", x, axes=(3, 4), smallest=2))


class upsample_layer(nn.Module):
    """Expanding step of a U-Net: upsampling by two, concatenation with a skip connection, double convolution.

    Parameters
    ----------
    input_channels : int
        Channels of the small image.
    output_channels : int
        Channels of the result, and with `bilinear` of the large image; otherwise the large image has
        ``input_channels - input_channels // 2`` channels.
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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import upsample_layer
    >>> tuple(upsample_layer(4, 2)(torch.rand(1, 4, 4, 4), torch.rand(1, 2, 8, 8)).shape)
    (1, 2, 8, 8)
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
        """Return the convolved concatenation of a large image and an enlarged small one.

        Parameters
        ----------
        x1 : torch.Tensor
            Small images ``[B, input_channels, h, w]``.
        x2 : torch.Tensor
            Large images ``[B, C, H, W]``; the small ones, enlarged, are padded with zeros to H × W, or cropped.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H, W]``.
        """
        double: Any = self.conv.model[0]
        convolution = double.model[0]
        transposed = isinstance(self.up, nn.ConvTranspose2d)
        x1 = images("x1", x1, self.up.in_channels if transposed else None, convolution.weight)
        small = self.up.out_channels if transposed else x1.shape[1]
        x2 = images("x2", x2, convolution.in_channels - small, convolution.weight)
        if len(x1) != len(x2):
            raise ValueError(f"x1 and x2 must have the same number of images, got {len(x1)} and {len(x2)}")
        return self.conv(torch.cat([x2, _fit(self.up(x1), x2)], dim=1))


class upsample_convtranspose2d_layer(nn.Module):
    """Transposed convolution of a small image, added to an image of the larger size.

    Parameters
    ----------
    input_channels : int
        Channels of the input.
    output_channels : int
        Channels of the result.
    kernel_size : int
        Edge of the kernel in pixels.
    stride : int
        Factor of enlargement.
    bias : bool
        Add a learned constant per channel.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import upsample_convtranspose2d_layer
    >>> tuple(upsample_convtranspose2d_layer(4, 2)(torch.rand(1, 4, 4, 4), torch.rand(1, 2, 8, 8)).shape)
    (1, 2, 8, 8)
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
        """Return the sum of a small and a large image.

        Parameters
        ----------
        x1 : torch.Tensor
            Small images ``[B, input_channels, h, w]``.
        x2 : torch.Tensor
            Large images ``[B, output_channels, H, W]``; the small ones, enlarged, are padded with zeros to H × W, or
            cropped.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H, W]``.
        """
        x1 = images("x1", x1, self.up.in_channels, self.up.weight)
        x2 = images("x2", x2, self.up.out_channels)
        _validate.fitting(x1=x1[:, :1, :1, :1], x2=x2[:, :1, :1, :1])
        return _fit(self.up(x1), x2) + x2


def _fit(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Pad with zeros, or crop, to the size of another image; odd differences are larger at the right and the bottom."""
    dy, dx = (target.shape[axis] - image.shape[axis] for axis in (-2, -1))
    if dy == dx == 0:
        return image
    return nn.functional.pad(image, [dx // 2, dx - dx // 2, dy // 2, dy - dy // 2])


class global_transformations(nn.Module):
    """Scale and offset per channel, computed from the channel means of a second image (Huang et al. 2018).

    Parameters
    ----------
    input_channels : int
        Channels of the second image.
    output_channels : int
        Channels of the first one.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import global_transformations
    >>> tuple(global_transformations(4, 2)(torch.rand(1, 2, 8, 8), torch.rand(1, 4, 8, 8)).shape)
    (1, 2, 8, 8)
    """

    def __init__(self, input_channels: int, output_channels: int):
        super().__init__()
        inner = channels("input_channels", input_channels)
        outer = channels("output_channels", output_channels)
        self.global_feature_1 = nn.Sequential(nn.Linear(inner, outer), nn.LeakyReLU(0.2))
        self.global_feature_2 = nn.Sequential(nn.Linear(outer, outer), nn.LeakyReLU(0.2))

    def forward(self, x1: torch.Tensor, x2: torch.Tensor) -> torch.Tensor:
        """Return the transformed image.

        Parameters
        ----------
        x1 : torch.Tensor
            Images ``[B, output_channels, H, W]``.
        x2 : torch.Tensor
            Images ``[B, input_channels, H', W']`` from whose channel means scale and offset are computed.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H, W]``.
        """
        first: Any = self.global_feature_1[0]
        second: Any = self.global_feature_2[0]
        x1 = images("x1", x1, second.in_features, second.weight)
        x2 = images("x2", x2, first.in_features, first.weight)
        if x2.shape[0] not in (1, x1.shape[0]):
            raise ValueError(f"x2 must have as many images as x1, {x1.shape[0]}, or one; got {list(x2.shape)}")
        scale = self.global_feature_1(x2.mean(dim=(2, 3)))
        offset = self.global_feature_2(scale)
        return x1 * scale[:, :, None, None] + offset[:, :, None, None]


class global_feature_module(nn.Module):
    """Two double convolutions between two global transformations (Huang et al. 2018).

    Parameters
    ----------
    input_channels : int
        Channels of the image.
    output_channels : int
        Channels of the result, equal to `input_channels`.
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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import global_feature_module
    >>> tuple(global_feature_module(4, 8, 4, kernel_size=3)(torch.rand(1, 4, 8, 8), torch.rand(1, 4, 8, 8)).shape)
    (1, 4, 8, 8)
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
                f"output_channels must be input_channels ({input_channels}), the channels it is transformed with; "
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
        """Return the features of an image.

        Parameters
        ----------
        x1 : torch.Tensor
            Images ``[B, input_channels, H, W]``.
        x2 : torch.Tensor
            Images with the same number of channels, whose means determine the first transformation.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H, W]``.
        """
        first = self.global_features_1(self.transformations_1(x1, x2))
        return self.transformations_2(first, self.global_features_2(first))
