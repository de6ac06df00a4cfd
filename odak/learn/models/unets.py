"""U-Net: a picture down some scales and up again, joined at each scale with what went down."""

from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn.models.arguments import channels, kernel, pictures
from odak.learn.models.convolution_layers import double_convolution, downsample_layer, upsample_layer

_RELU = nn.ReLU(inplace=True)


class unet(nn.Module):
    """U-Net (Ronneberger, Fischer and Brox 2015), with padded convolutions, for pictures of any size.

    Parameters
    ----------
    depth : int
        Steps down.
    dimensions : int
        Channels at full size; each step down doubles them.
    input_channels, output_channels : int
        Numbers of channels.
    bilinear : bool
        Enlarge by interpolation instead of transposed convolutions.
    kernel_size : int
        Edge of the kernels in pixels.
    bias : bool
        Add a learned constant per channel of the convolutions.
    activation : torch.nn.Module or None
        Follows each convolution but the last.
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
            Pictures ``[B, input_channels, H, W]``, at least 2^depth pixels high and wide.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H, W]``.

        Raises
        ------
        ValueError
            If the pictures are too small for that many steps.
        """
        double: Any = self.inc.model[0]
        first = double.model[0]
        x = pictures("x", x, first.in_channels, first.weight)
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
