"""U-Nets with fixed kernels, and with spatially varying kernels that a second network computes.

References
----------
Ronneberger, Fischer and Brox 2015 (MICCAI); Zheng, Zhan, Shi, Cakmakci and Akşit 2024 (SIGGRAPH Asia Technical
Communications).
"""

import itertools
from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn.models._inputs import activation_module, channels, images, kernel
from odak.learn.models.adaptive import spatially_adaptive_module
from odak.learn.models.layers import (
    convolution_layer,
    double_convolution,
    downsample_layer,
    global_feature_module,
    upsample_convtranspose2d_layer,
    upsample_layer,
)

_LEAKY_RELU = nn.LeakyReLU(0.2, inplace=True)
_RELU = nn.ReLU(inplace=True)


class unet(nn.Module):
    """U-Net (Ronneberger, Fischer and Brox 2015), with padded convolutions, for images of any size.

    Parameters
    ----------
    depth : int
        Number of contracting steps.
    dimensions : int
        Channels at full size; each contracting step doubles them.
    input_channels : int
        Channels of the input.
    output_channels : int
        Channels of the result.
    bilinear : bool
        Enlarge by interpolation instead of transposed convolutions.
    kernel_size : int
        Edge of the kernels in pixels.
    bias : bool
        Add a learned constant per channel of the convolutions.
    activation : torch.nn.Module or None
        Follows each convolution except the last.
    normalization : bool
        Normalize over the batch after each of these convolutions; files with batch norms (keys ``….model.1.…``) load
        into such a network.

    Examples
    --------
    >>> network = unet(depth=2, dimensions=8, input_channels=3)
    >>> network(torch.rand(1, 3, 31, 45)).shape
    torch.Size([1, 1, 31, 45])
    """

    def __init__(
        self,
        depth: int = 4,
        dimensions: int = 64,
        input_channels: int = 2,
        output_channels: int = 1,
        bilinear: bool = False,
        kernel_size: int = 3,
        bias: bool = False,
        activation: nn.Module | None = _RELU,
        normalization: bool = False,
    ):
        super().__init__()
        self.depth = _validate.integer("depth", depth, minimum=1)
        width = channels("dimensions", dimensions)
        size = kernel(kernel_size)
        options: dict[str, Any] = {
            "kernel_size": size,
            "bias": bias,
            "normalization": normalization,
            "activation": activation,
        }
        self.inc = double_convolution(input_channels, mid_channels=width, output_channels=width, **options)
        self.downsampling_layers = nn.ModuleList(
            downsample_layer(width * 2**i, width * 2 ** (i + 1), **options) for i in range(depth)
        )
        self.upsampling_layers = nn.ModuleList(
            upsample_layer(width * 2 ** (i + 1), width * 2**i, bilinear=bilinear, **options)
            for i in reversed(range(depth))
        )
        self.outc = nn.Conv2d(
            width, channels("output_channels", output_channels), kernel_size=size, padding=size // 2, bias=bias
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the output of the network.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, input_channels, H, W]``, at least 2^depth pixels high and wide.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H, W]``.

        Raises
        ------
        ValueError
            If the images are smaller than 2^depth pixels.
        """
        double: Any = self.inc.model[0]
        first = double.model[0]
        x = images("x", x, first.in_channels, first.weight)
        if min(x.shape[-2:]) < 2**self.depth:
            raise ValueError(
                f"x must be at least {2**self.depth} pixels high and wide for a depth of {self.depth}, "
                f"got {tuple(x.shape)}"
            )
        x = self.inc(x)
        finer = []
        for layer in self.downsampling_layers:
            finer.append(x)
            x = layer(x)
        for layer in self.upsampling_layers:
            x = layer(x, finer.pop())
        return self.outc(x)


class spatially_varying_kernel_generation_model(nn.Module):
    """Network that computes the kernel factors of :class:`spatially_adaptive_unet` from a focal surface and a field.

    Parameters
    ----------
    depth : int
        There are depth + 1 scales, from half the size of the image down.
    dimensions : int
        Channels D at the finest scale.
    input_channels : int
        Channels of the field plus one for the focal surface.
    kernel_size : int
        Edge k in pixels, of the network's kernels and of those it computes.
    bias : bool
        Add a learned constant per channel.
    normalization : bool
        Normalize over the batch.
    activation : torch.nn.Module or None
        Follows each convolution.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import spatially_adaptive_unet, spatially_varying_kernel_generation_model
    >>> kernels = spatially_varying_kernel_generation_model(depth=2, dimensions=4, input_channels=3)
    >>> network = spatially_adaptive_unet(depth=2, dimensions=4, input_channels=2, out_channels=2)
    >>> field = torch.rand(1, 2, 32, 32)
    >>> tuple(network(kernels(torch.rand(1, 1, 32, 32), field), field).shape)
    (1, 2, 32, 32)
    """

    def __init__(
        self,
        depth: int = 3,
        dimensions: int = 8,
        input_channels: int = 7,
        kernel_size: int = 3,
        bias: bool = True,
        normalization: bool = False,
        activation: nn.Module | None = _LEAKY_RELU,
    ):
        super().__init__()
        self.depth = _validate.integer("depth", depth, minimum=1)
        self.input_channels = _validate.integer("input_channels", input_channels, minimum=2)
        width, size = channels("dimensions", dimensions), kernel(kernel_size, odd=True)
        options: dict[str, Any] = {
            "kernel_size": size,
            "bias": bias,
            "normalization": normalization,
            "activation": activation,
        }
        # Channels after each double convolution of the encoder, and after the pooling before it.
        coded = [width * 2**i for i in range(depth)] + [width * 2 ** (depth - 1)]
        pooled = [width, *coded[:-1]]
        risen = [coded[-1]] + [min(n, 2 * width) for n in reversed(coded[:-1])]
        self.inc = convolution_layer(input_channels, width, **options)
        self.encoder = nn.ModuleList()
        for before, after in zip(pooled, coded, strict=True):
            self.encoder += [nn.AvgPool2d(2), double_convolution(before, before, after, **options)]
        self.spatially_varying_feature = nn.ModuleList()
        for i, features in zip(reversed(range(depth + 1)), risen, strict=True):
            pools = [nn.AvgPool2d(2**n) for n in range(i + 1, 0, -1)]
            block = _kernel_block(
                features + 1 + sum(pooled[:i]), 4 * width, width * 2**i * size**2, size, bias, activation
            )
            self.spatially_varying_feature.append(nn.ModuleList([*pools, block]))
        bottom: dict[str, Any] = {**options, "activation": nn.LeakyReLU(0.2)}
        self.decoder = nn.ModuleList([global_feature_module(coded[-1], coded[-1], coded[-1], **bottom)])
        for before, joined, after in zip(risen, reversed(coded[:-1]), risen[1:], strict=False):
            rise = upsample_convtranspose2d_layer(before, joined, bias=bias)
            self.decoder.append(nn.ModuleList([rise, double_convolution(joined, after, after, **options)]))

    def forward(self, focal_surface: torch.Tensor, field: torch.Tensor) -> list[torch.Tensor]:
        """Return the factors at all scales.

        Parameters
        ----------
        focal_surface : torch.Tensor
            ``[B or 1, 1, H, W]``, at least 2^(depth + 1) pixels high and wide.
        field : torch.Tensor
            ``[B, input_channels − 1, H, W]``.

        Returns
        -------
        list of torch.Tensor
            depth + 1 tensors ``[B, D·2^i·k², H // 2^(i + 1), W // 2^(i + 1)]``, i = depth … 0: the coarsest first.

        Raises
        ------
        ValueError
            If the shapes do not match or the images are too small.
        """
        focal_surface, field = self._checked(focal_surface, field)
        focal_surface = focal_surface.expand(len(field), -1, -1, -1)
        pooled, coded = [], [self.inc(torch.cat([focal_surface, field], dim=1))]
        for pool, convolution in zip(self.encoder[::2], self.encoder[1::2], strict=True):
            pooled.append(pool(coded[-1]))
            coded.append(convolution(pooled[-1]))
        risen = self.decoder[0](pooled[-1], coded[-1])
        kernels = [self._kernels(0, risen, focal_surface, pooled)]
        for level in range(1, self.depth + 1):
            stage: Any = self.decoder[level]
            rise, convolution = stage
            risen = convolution(rise(risen, coded[-1 - level]))
            kernels.append(self._kernels(level, risen, focal_surface, pooled))
        return kernels

    def _kernels(self, level, risen, focal_surface, pooled):
        """Return the factors of one scale from the decoder's features there and the pooled finer scales."""
        *pools, block = self.spatially_varying_feature[level]
        steps = self.depth - level
        for _ in range(steps + 1):
            focal_surface = pools[-1](focal_surface)
        finer = [pools[j + 1](pooled[j]) for j in range(steps)]
        # The next finer scale comes first, then the others from the finest on: the order of published weights.
        return block(torch.cat([risen, focal_surface, *finer[-1:], *finer[:-1]], dim=1))

    def _checked(self, focal_surface, field):
        weight, smallest = self.inc.model[0].weight, 2 ** (self.depth + 1)
        field = images("field", field, self.input_channels - 1, weight, smallest=smallest)
        focal_surface = images("focal_surface", focal_surface, 1, weight)
        wanted = (len(field), 1, *field.shape[-2:])
        if tuple(focal_surface.shape) not in (wanted, (1, *wanted[1:])):
            raise ValueError(
                f"focal_surface must be {wanted}, or have a batch of 1, as field is; got {tuple(focal_surface.shape)}"
            )
        return focal_surface, field


def _kernel_block(inputs, hidden, outputs, size, bias, activation) -> nn.Sequential:
    widths = [inputs, hidden, hidden, outputs]
    layers = []
    for before, after in itertools.pairwise(widths):
        layers += [nn.Conv2d(before, after, kernel_size=size, padding=size // 2, bias=bias), activation]
    return nn.Sequential(*(layer for layer in layers[:-1] if layer is not None))


class spatially_adaptive_unet(nn.Module):
    """U-Net with spatially adaptive modules in its encoder.

    Parameters
    ----------
    depth : int
        The encoder has depth + 1 steps.
    dimensions : int
        Channels D at full size; each contracting step doubles them.
    input_channels : int
        Channels of the input.
    out_channels : int
        Channels of the result.
    kernel_size : int
        Edge k of the kernels in pixels.
    bias : bool
        Add a learned constant per channel.
    normalization : bool
        Normalize over the batch.
    activation : torch.nn.Module or None
        Follows each convolution except the last.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import spatially_adaptive_unet, spatially_varying_kernel_generation_model
    >>> kernels = spatially_varying_kernel_generation_model(depth=2, dimensions=4, input_channels=3)
    >>> network = spatially_adaptive_unet(depth=2, dimensions=4, input_channels=2, out_channels=2)
    >>> field = torch.rand(1, 2, 32, 32)
    >>> tuple(network(kernels(torch.rand(1, 1, 32, 32), field), field).shape)
    (1, 2, 32, 32)
    """

    def __init__(
        self,
        depth: int = 3,
        dimensions: int = 8,
        input_channels: int = 6,
        out_channels: int = 6,
        kernel_size: int = 3,
        bias: bool = True,
        normalization: bool = False,
        activation: nn.Module | None = _LEAKY_RELU,
    ):
        super().__init__()
        self.depth = _validate.integer("depth", depth, minimum=1)
        size = kernel(kernel_size, odd=True)
        widths = [channels("dimensions", dimensions) * 2**i for i in range(depth + 2)]
        activation_module(activation)
        options: dict[str, Any] = {
            "kernel_size": size,
            "bias": bias,
            "normalization": normalization,
            "activation": activation,
        }
        adaptive: dict[str, Any] = {"kernel_size": size, "padding": size // 2, "bias": bias, "activation": activation}
        self.inc = convolution_layer(input_channels, widths[0], **options)
        self.encoder = nn.ModuleList(
            nn.ModuleList(
                [
                    nn.AvgPool2d(2),
                    double_convolution(n, n, n, **options),
                    spatially_adaptive_module(n, 2 * n, **adaptive),
                ]
            )
            for n in widths[:-1]
        )
        bottom = widths[-1]
        self.global_feature_module = nn.ModuleList(
            [
                nn.ModuleList(
                    [
                        double_convolution(bottom, bottom, bottom, **options),
                        global_feature_module(bottom, bottom, bottom, **options),
                    ]
                )
            ]
        )
        last = nn.Sequential(
            convolution_layer(widths[0], widths[0], **options),
            convolution_layer(
                widths[0], channels("out_channels", out_channels), **{**options, "kernel_size": 1, "activation": None}
            ),
        )
        joins = [*(double_convolution(n, n, n, **options) for n in widths[-2:0:-1]), last]
        self.decoder = nn.ModuleList(
            nn.ModuleList([upsample_convtranspose2d_layer(2 * n, n, bias=bias), join])
            for n, join in zip(widths[-2::-1], joins, strict=True)
        )

    def forward(self, sv_kernel: Sequence[torch.Tensor], field: torch.Tensor) -> torch.Tensor:
        """Return the output of the network.

        Parameters
        ----------
        sv_kernel : sequence of torch.Tensor
            depth + 1 tensors of factors, the coarsest first, from
            :class:`spatially_varying_kernel_generation_model`.
        field : torch.Tensor
            ``[B, input_channels, H, W]``.

        Returns
        -------
        torch.Tensor
            ``[B, out_channels, H, W]``.

        Raises
        ------
        ValueError
            If the number of tensors is wrong, or their shapes do not match that of the field.
        """
        listed = isinstance(sv_kernel, Sequence) and all(isinstance(factors, torch.Tensor) for factors in sv_kernel)
        if not listed or isinstance(sv_kernel, str):
            raise TypeError(f"sv_kernel must be a sequence of tensors, got {type(sv_kernel).__name__}")
        if len(sv_kernel) != self.depth + 1:
            raise ValueError(f"sv_kernel must contain {self.depth + 1} tensors, got {len(sv_kernel)}")
        first: Any = self.inc.model[0]
        field = images("field", field, first.in_channels, first.weight, smallest=2 ** (self.depth + 1))
        for level, factors in zip(range(self.depth + 1, 0, -1), sv_kernel, strict=True):
            wanted = [n // 2**level for n in field.shape[-2:]]
            if list(factors.shape[-2:]) != wanted:
                raise ValueError(
                    f"sv_kernel must have {wanted} kernels where field is {list(field.shape)}, "
                    f"got {list(factors.shape)}"
                )
        x = self.inc(field)
        joined = []
        encoder: Any = self.encoder
        for (pool, convolution, adaptive), factors in zip(encoder, reversed(sv_kernel), strict=True):
            joined.append(x)
            pooled = pool(x)
            x = adaptive(pooled + convolution(pooled), factors)
        middle: Any = self.global_feature_module[0]
        convolution, transform = middle
        x = transform(x, convolution(x))
        decoder: Any = self.decoder
        for rise, join in decoder:
            x = join(rise(x, joined.pop()))
        return x
