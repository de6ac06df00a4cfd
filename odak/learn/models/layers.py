"""Convolutional layers, the steps of a U-Net, and attention: non-local, channel, spatial, and gated by an image.

Convolutions are padded by ``kernel_size // 2``: odd kernels keep the size of the image, even ones grow it by one.
"""

import functools
from collections.abc import Sequence
from typing import Any

import torch
from torch import nn
from torch.nn.functional import scaled_dot_product_attention
from torch.utils.checkpoint import checkpoint

from odak import _validate
from odak.learn._tensors import floating_tensor, trainable

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
        options = block_options(kernel(kernel_size), bias, normalization, activation)
        size, activation = options["kernel_size"], options["activation"]
        layers: list[nn.Module] = [
            nn.Conv2d(
                channels("input_channels", input_channels),
                channels("output_channels", output_channels),
                kernel_size=size,
                stride=_validate.integer("stride", stride, minimum=1),
                padding=size // 2,
                bias=options["bias"],
            )
        ]
        if options["normalization"]:
            layers.append(nn.BatchNorm2d(output_channels))
        if activation is not None:
            layers.append(activation)
        self.model: nn.Sequential = nn.Sequential(*layers)

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
        options = block_options(kernel_size, bias, normalization, activation)
        middle = channels("output_channels", output_channels)
        middle = middle if mid_channels is None else channels("mid_channels", mid_channels)
        self.activation = options["activation"]
        self.model: nn.Sequential = nn.Sequential(
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
        options = block_options(kernel(kernel_size, odd=True), bias, normalization, activation, default=True)
        self.activation = options["activation"]
        self.convolution: double_convolution = double_convolution(
            channels("input_channels", input_channels), mid_channels, input_channels, **options
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
        self.k: nn.Parameter = nn.Parameter(torch.ones(1, channels("dim", dim), 1, 1))

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
        options = block_options(kernel_size, bias, normalization, activation)
        self.maxpool_conv: nn.Sequential = nn.Sequential(
            nn.MaxPool2d(2), double_convolution(input_channels, None, output_channels, **options)
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
        options = block_options(kernel_size, bias, normalization, activation)
        half = _validate.integer("input_channels", input_channels, minimum=2) // 2
        channels("output_channels", output_channels)
        if _validate.flag("bilinear", bilinear):
            self.up: Any = nn.Upsample(scale_factor=2, mode="bilinear", align_corners=True)
        else:
            self.up = nn.ConvTranspose2d(input_channels, half, kernel_size=2, stride=2)
        self.conv: double_convolution = double_convolution(
            input_channels + output_channels if bilinear else input_channels,
            mid_channels=half if bilinear else output_channels,
            output_channels=output_channels,
            **options,
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
        self.up: nn.ConvTranspose2d = nn.ConvTranspose2d(
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
        self.global_feature_1: nn.Sequential = nn.Sequential(nn.Linear(inner, outer), nn.LeakyReLU(0.2))
        self.global_feature_2: nn.Sequential = nn.Sequential(nn.Linear(outer, outer), nn.LeakyReLU(0.2))

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

    global_features_1: double_convolution
    global_features_2: double_convolution

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
        options = block_options(kernel_size, bias, normalization, activation)
        if channels("input_channels", input_channels) != channels("output_channels", output_channels):
            raise ValueError(
                f"output_channels must be input_channels ({input_channels}), the channels it is transformed with; "
                f"got {output_channels}"
            )
        self.transformations_1: global_transformations = global_transformations(input_channels, output_channels)
        self.global_features_1 = double_convolution(input_channels, mid_channels, output_channels, **options)
        self.global_features_2 = double_convolution(input_channels, mid_channels, output_channels, **options)
        self.transformations_2: global_transformations = global_transformations(input_channels, output_channels)

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


_POOLS = ("avg", "max")
_SCORE_BYTES = 1 << 26


class residual_attention_layer(nn.Module):
    """Attention gate: an image weighted pixel by pixel by a function of itself and a second image (Oktay et al. 2018).

    Parameters
    ----------
    input_channels : int
        Channels of both images.
    output_channels : int
        Channels of the weights: 1, or `input_channels`.
    kernel_size : int
        Edge of the kernels in pixels, odd.
    bias : bool
        Add a learned constant per channel.
    activation : torch.nn.Module or None
        Follows the sum of the two convolutions.

    Raises
    ------
    ValueError
        If `output_channels` is neither 1 nor `input_channels`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import residual_attention_layer
    >>> tuple(residual_attention_layer(2, 1)(torch.rand(1, 2, 8, 8), torch.rand(1, 2, 8, 8)).shape)
    (1, 2, 8, 8)
    """

    convolution0: nn.Sequential
    convolution1: nn.Sequential
    final_layer: nn.Sequential

    def __init__(
        self,
        input_channels: int = 2,
        output_channels: int = 2,
        kernel_size: int = 1,
        bias: bool = False,
        activation: nn.Module | None = _RELU,
    ):
        super().__init__()
        if channels("output_channels", output_channels) not in (1, channels("input_channels", input_channels)):
            raise ValueError(f"output_channels must be 1 or input_channels ({input_channels}), got {output_channels}")
        size = kernel(kernel_size, odd=True)
        options: dict[str, Any] = {"kernel_size": size, "padding": size // 2, "bias": _validate.flag("bias", bias)}
        self.activation: nn.Module | None = activation_module(activation)
        self.convolution0, self.convolution1 = (
            nn.Sequential(nn.Conv2d(input_channels, output_channels, **options), nn.BatchNorm2d(output_channels))
            for _ in range(2)
        )
        final = nn.Conv2d(output_channels, output_channels, **options)
        self.final_layer = nn.Sequential(final) if activation is None else nn.Sequential(activation, final)

    def forward(self, x0: torch.Tensor, x1: torch.Tensor) -> torch.Tensor:
        """Return `x0` times its weights.

        Parameters
        ----------
        x0, x1 : torch.Tensor
            Images ``[B, input_channels, H, W]``.

        Returns
        -------
        torch.Tensor
            ``[B, input_channels, H, W]``.
        """
        convolution: Any = self.convolution0[0]
        x0, x1 = (images(name, x, convolution.in_channels, convolution.weight) for name, x in (("x0", x0), ("x1", x1)))
        _validate.fitting(x0=x0, x1=x1)
        return self.final_layer(self.convolution0(x0) + self.convolution1(x1)) * x0


class non_local_layer(nn.Module):
    """Non-local layer: an image plus a similarity-weighted mean over all its pixels (Wang et al. 2018, equation 1).

    The weights are exp(xᵢ·xⱼ / N), normalized over j, with the features xᵢ themselves and N = H·W. The batch
    normalization at the end starts from zero, so that an untrained layer is the identity. The N × N weights are not
    stored: memory grows linearly with N.

    Parameters
    ----------
    input_channels : int
        Channels of the image.
    bottleneck_channels : int
        Channels of the averaged features.
    kernel_size : int
        Edge of the two convolutions in pixels, odd.
    bias : bool
        Add a learned constant per channel.

    Examples
    --------
    An untrained layer is the identity:

    >>> import torch
    >>> from odak.learn.models import non_local_layer
    >>> layer, image = non_local_layer(4, 2), torch.rand(1, 4, 8, 8)
    >>> torch.equal(layer(image), image)
    True
    """

    def __init__(
        self, input_channels: int = 1024, bottleneck_channels: int = 512, kernel_size: int = 1, bias: bool = False
    ):
        super().__init__()
        size = kernel(kernel_size, odd=True)
        options: dict[str, Any] = {"kernel_size": size, "padding": size // 2, "bias": _validate.flag("bias", bias)}
        outer = channels("input_channels", input_channels)
        inner = channels("bottleneck_channels", bottleneck_channels)
        self.g: nn.Conv2d = nn.Conv2d(outer, inner, **options)
        self.W_z: nn.Sequential = nn.Sequential(nn.Conv2d(inner, outer, **options), nn.BatchNorm2d(outer))
        last: Any = self.W_z[1]
        nn.init.zeros_(last.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the image plus the weighted mean of its pixels, ``[B, input_channels, H, W]``.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, input_channels, H, W]``.
        """
        x = images("x", x, self.g.in_channels, self.g.weight)
        tokens, values = (image.flatten(2).mT for image in (x, self.g(x)))
        mean = _attend(tokens, values)
        return self.W_z(mean.mT.unflatten(2, x.shape[2:])) + x


def _attend(tokens, values):
    """Return softmax(tokens·tokensᵀ / N)·values for ``[B, N, C]``, in blocks of rows whose weights fit in memory.

    Fused kernels that never form the weights exist for some devices, dtypes and sizes only.
    """
    batch, count = tokens.shape[:2]
    rows = max(1, _SCORE_BYTES // (max(batch, 1) * count * tokens.element_size()))
    if rows >= count:
        return _rows(tokens, tokens, values)
    attend = _rows
    if torch.is_grad_enabled():
        attend = functools.partial(checkpoint, _rows, use_reentrant=False, preserve_rng_state=False)
    return torch.cat([attend(block, tokens, values) for block in tokens.split(rows, dim=1)], dim=1)


def _rows(queries, keys, values):
    # With an axis of heads: the fused kernels take four axes.
    heads = (tensor[:, None] for tensor in (queries, keys, values))
    return scaled_dot_product_attention(*heads, scale=1 / keys.shape[1])[:, 0]


class channel_gate(nn.Module):
    """Channel attention: channels weighted by a function of their global pools (Woo et al. 2018, equation 2).

    Parameters
    ----------
    gate_channels : int
        Number of channels C.
    reduction_ratio : int
        The hidden layer has max(1, C // reduction_ratio) features.
    pool_types : sequence of {"avg", "max"}
        Global pools; the scores computed from each are added.

    Raises
    ------
    ValueError
        If a pool is unknown, or there is none.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import channel_gate
    >>> tuple(channel_gate(4, reduction_ratio=2)(torch.rand(1, 4, 8, 8)).shape)
    (1, 4, 8, 8)
    """

    def __init__(self, gate_channels: int, reduction_ratio: int = 16, pool_types: Sequence[str] = _POOLS):
        super().__init__()
        hidden = channels("gate_channels", gate_channels) // channels("reduction_ratio", reduction_ratio)
        named = _validate.texts("pool_types", [pool_types] if isinstance(pool_types, str) else pool_types)
        self.pool_types: list[str] = [_validate.one_of("pool_types", name, _POOLS) for name in named]
        if not self.pool_types:
            raise ValueError(f"pool_types must name at least one of {', '.join(_POOLS)}")
        self.mlp: nn.Sequential = nn.Sequential(
            nn.Flatten(), nn.Linear(gate_channels, max(1, hidden)), nn.ReLU(), nn.Linear(max(1, hidden), gate_channels)
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the images ``[B, C, H, W]`` with each channel times its weight between 0 and 1.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, gate_channels, H, W]``.
        """
        first: Any = self.mlp[1]
        x = images("x", x, first.in_features, first.weight)
        pools: dict[str, Any] = {"avg": torch.mean, "max": torch.amax}
        scores: Any = sum(self.mlp(pools[name](x, dim=(2, 3))) for name in self.pool_types)
        return x * torch.sigmoid(scores)[:, :, None, None]


class spatial_gate(nn.Module):
    """Spatial attention: pixels weighted by a function of the maximum and mean over channels (Woo et al. 2018, eq. 3).

    The weights are the sigmoid of one 7 × 7 convolution.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import spatial_gate
    >>> tuple(spatial_gate()(torch.rand(1, 4, 8, 8)).shape)
    (1, 4, 8, 8)
    """

    def __init__(self):
        super().__init__()
        self.spatial: convolution_layer = convolution_layer(2, 1, kernel_size=7, bias=False, activation=nn.Identity())

    def channel_pool(self, x: torch.Tensor) -> torch.Tensor:
        """Return the maximum and the mean over the channels.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, C, H, W]``.

        Returns
        -------
        torch.Tensor
            ``[B, 2, H, W]``, the maximum first.
        """
        x = images("x", x)
        return torch.stack([x.amax(dim=1), x.mean(dim=1)], dim=1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the images ``[B, C, H, W]`` with each pixel times its weight between 0 and 1.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, C, H, W]``.
        """
        x = images("x", x, None, next(self.spatial.parameters()))
        return x * torch.sigmoid(self.spatial(self.channel_pool(x)))


class convolutional_block_attention(nn.Module):
    """Channel gate, then spatial gate (Woo et al. 2018).

    Parameters
    ----------
    gate_channels : int
        Number of channels.
    reduction_ratio : int
        Ratio of the channels to the features of the hidden layer of the channel gate.
    pool_types : sequence of {"avg", "max"}
        Global pools of the channel gate.
    no_spatial : bool
        Leave the spatial gate out.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import convolutional_block_attention
    >>> tuple(convolutional_block_attention(32)(torch.rand(1, 32, 8, 8)).shape)
    (1, 32, 8, 8)
    """

    Flatten = nn.Flatten

    def __init__(
        self,
        gate_channels: int,
        reduction_ratio: int = 16,
        pool_types: Sequence[str] = _POOLS,
        no_spatial: bool = False,
    ):
        super().__init__()
        self.channel_gate: channel_gate = channel_gate(gate_channels, reduction_ratio, pool_types)
        self.no_spatial: bool = _validate.flag("no_spatial", no_spatial)
        if not no_spatial:
            self.spatial_gate: spatial_gate = spatial_gate()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the gated images, ``[B, gate_channels, H, W]``.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, gate_channels, H, W]``.
        """
        gated = self.channel_gate(x)
        return gated if self.no_spatial else self.spatial_gate(gated)


def channels(name: str, value: int) -> int:
    """Return a number of channels or features after checking that it is a positive integer."""
    return _validate.integer(name, value, minimum=1)


def kernel(value: int, *, odd: bool = False) -> int:
    """Return a kernel size; `odd` where an even one, which grows the image by one, could not be added to it."""
    size = _validate.integer("kernel_size", value, minimum=1)
    if odd and size % 2 == 0:
        raise ValueError(f"kernel_size must be odd, so that the size of the image does not change; got {size}")
    return size


def activation_module(activation: nn.Module | None) -> nn.Module | None:
    """Return an activation after checking that it is a module, or None for no activation."""
    _validate.instance("activation", activation, (nn.Module, type(None)), "a torch.nn.Module or None")
    return activation


def block_options(
    kernel_size: int, bias: bool, normalization: bool | nn.Module, activation: nn.Module | None, default: bool = False
) -> dict[str, Any]:
    """Return the options that all blocks of convolutions share, of a call of either form.

    Parameters
    ----------
    kernel_size : int
        Size of the kernels.
    bias : bool
        Whether the convolutions have biases.
    normalization : bool or torch.nn.Module
        Value given for ``normalization``; a module is the activation of the older call form.
    activation : torch.nn.Module or None
        Value given for ``activation``.
    default : bool
        Normalization of the layer where the older call form is used.

    Returns
    -------
    dict
        "kernel_size", "bias", "normalization" and "activation".
    """
    if isinstance(normalization, nn.Module):
        activation, normalization = normalization, default
    _validate.instance("normalization", normalization, bool, "a bool")
    return {
        "kernel_size": kernel_size,
        "bias": _validate.flag("bias", bias),
        "normalization": normalization,
        "activation": activation_module(activation),
    }


def features(
    name: str, value: torch.Tensor, count: int | None = None, parameter: torch.Tensor | None = None
) -> torch.Tensor:
    """Return a real tensor after checking that a layer accepts it and autograd can save it.

    Parameters
    ----------
    name : str
        The argument's name.
    value : torch.Tensor
        Value given.
    count : int, optional
        Length of its last axis.
    parameter : torch.Tensor, optional
        Parameter of the layer whose dtype and device it must have; under autocast the dtype is free.
    """
    if isinstance(value, torch.fx.Proxy):
        return value
    floating_tensor(name, value, "a real floating tensor")
    wanted = getattr(parameter, "dtype", value.dtype)
    if value.dtype != wanted and not torch.is_autocast_enabled(value.device.type):
        raise TypeError(f"{name} must have the dtype of the layer, {wanted}; got {value.dtype}")
    place = getattr(parameter, "device", value.device)
    if value.device != place:
        raise ValueError(f"{name} must be on the layer's device, {place}; got {value.device}")
    if count is not None and (value.ndim == 0 or value.shape[-1] != count):
        raise ValueError(f"{name} must be [..., {count}], got {list(value.shape)}")
    return trainable(value)


def images(
    name: str,
    value: torch.Tensor,
    count: int | None = None,
    parameter: torch.Tensor | None = None,
    *,
    axes: Sequence[int] = (4,),
    smallest: int = 1,
) -> torch.Tensor:
    """Return images ``[B, C, H, W]`` after checking that a layer accepts them and autograd can save them.

    Parameters
    ----------
    name : str
        The argument's name.
    value : torch.Tensor
        Value given.
    count : int, optional
        Number C of channels.
    parameter : torch.Tensor, optional
        Parameter of the layer whose dtype and device they must have; under autocast the dtype is free.
    axes : sequence of int
        Accepted numbers of axes; three axes are one image without a batch.
    smallest : int
        Least height and width.
    """
    value = features(name, value, None, parameter)
    if isinstance(value, torch.fx.Proxy):
        return value
    shape = list(value.shape)
    fits = value.ndim in axes and min(shape[-2:]) >= smallest and 0 not in shape[1:]
    if not fits or (count is not None and shape[-3] != count):
        wanted = f"[B, {'C' if count is None else count}, H, W]"
        raise ValueError(f"{name} must be {wanted} with H and W of at least {smallest}, got {shape}")
    return value
