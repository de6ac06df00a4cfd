"""Attention over pixels, over channels and over space, and a gate between two pictures."""

import functools
from collections.abc import Sequence
from typing import Any

import torch
from torch import nn
from torch.nn.functional import scaled_dot_product_attention
from torch.utils.checkpoint import checkpoint

from odak import _validate
from odak.learn.models.arguments import activation_module, channels, kernel, pictures
from odak.learn.models.convolution_layers import convolution_layer

_RELU = nn.ReLU()
_POOLS = ("avg", "max")
_SCORE_BYTES = 1 << 26


class residual_attention_layer(nn.Module):
    """A picture weighted, pixel by pixel, by what it has in common with another one (Oktay et al. 2018).

    Parameters
    ----------
    input_channels : int
        Channels of both pictures.
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
        If the weights could not multiply the picture.
    """

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
        self.activation = activation_module(activation)
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
            Pictures ``[B, input_channels, H, W]``.

        Returns
        -------
        torch.Tensor
            ``[B, input_channels, H, W]``.
        """
        convolution: Any = self.convolution0[0]
        x0, x1 = (
            pictures(name, x, convolution.in_channels, convolution.weight) for name, x in (("x0", x0), ("x1", x1))
        )
        _validate.fitting(x0=x0, x1=x1)
        return self.final_layer(self.convolution0(x0) + self.convolution1(x1)) * x0


class non_local_layer(nn.Module):
    """A picture plus a mean over all its pixels, weighted by their likeness (Wang et al. 2018, equation 1).

    Weights are exp(xᵢ·xⱼ / N), normalized over j, of the features themselves, N = H·W; the batch normalization at the
    end starts from zero, so that an untrained layer changes nothing. The N × N weights are not kept: what a large
    picture needs grows with N.

    Parameters
    ----------
    input_channels : int
        Channels of the picture.
    bottleneck_channels : int
        Channels of what is averaged.
    kernel_size : int
        Edge of the two convolutions in pixels, odd.
    bias : bool
        Add a learned constant per channel.
    """

    def __init__(
        self, input_channels: int = 1024, bottleneck_channels: int = 512, kernel_size: int = 1, bias: bool = False
    ):
        super().__init__()
        size = kernel(kernel_size, odd=True)
        options: dict[str, Any] = {"kernel_size": size, "padding": size // 2, "bias": _validate.flag("bias", bias)}
        outer = channels("input_channels", input_channels)
        inner = channels("bottleneck_channels", bottleneck_channels)
        self.g = nn.Conv2d(outer, inner, **options)
        self.W_z = nn.Sequential(nn.Conv2d(inner, outer, **options), nn.BatchNorm2d(outer))
        last: Any = self.W_z[1]
        nn.init.zeros_(last.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the picture plus its weighted mean, ``[B, input_channels, H, W]``."""
        x = pictures("x", x, self.g.in_channels, self.g.weight)
        tokens, values = (picture.flatten(2).mT for picture in (x, self.g(x)))
        mean = _attend(tokens, values)
        return self.W_z(mean.mT.unflatten(2, x.shape[2:])) + x


def _attend(tokens, values):
    """Return softmax(tokens·tokensᵀ / N)·values for ``[B, N, C]``, by rows whose weights fit in memory.

    Kernels that never form the weights exist for some devices, dtypes and sizes only; rows serve them all.
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
    # With an axis of heads: the memory-saving kernels take four axes.
    heads = (tensor[:, None] for tensor in (queries, keys, values))
    return scaled_dot_product_attention(*heads, scale=1 / keys.shape[1])[:, 0]


class channel_gate(nn.Module):
    """A picture whose channels are weighted by what they hold on the whole (Woo et al. 2018, equation 2).

    Parameters
    ----------
    gate_channels : int
        Number of channels C.
    reduction_ratio : int
        The hidden layer has max(1, C // reduction_ratio) features.
    pool_types : sequence of {"avg", "max"}
        Global pools; what the hidden layer makes of each is added.

    Raises
    ------
    ValueError
        If a pool is unknown, or there is none.
    """

    def __init__(self, gate_channels: int, reduction_ratio: int = 16, pool_types: Sequence[str] = _POOLS):
        super().__init__()
        hidden = channels("gate_channels", gate_channels) // channels("reduction_ratio", reduction_ratio)
        named = _validate.texts("pool_types", [pool_types] if isinstance(pool_types, str) else pool_types)
        self.pool_types = [_validate.one_of("pool_types", name, _POOLS) for name in named]
        if not self.pool_types:
            raise ValueError(f"pool_types must name at least one of {', '.join(_POOLS)}")
        self.mlp = nn.Sequential(
            nn.Flatten(), nn.Linear(gate_channels, max(1, hidden)), nn.ReLU(), nn.Linear(max(1, hidden), gate_channels)
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the pictures ``[B, C, H, W]`` with each channel times its weight between 0 and 1."""
        first: Any = self.mlp[1]
        x = pictures("x", x, first.in_features, first.weight)
        pools: dict[str, Any] = {"avg": torch.mean, "max": torch.amax}
        scores: Any = sum(self.mlp(pools[name](x, dim=(2, 3))) for name in self.pool_types)
        return x * torch.sigmoid(scores)[:, :, None, None]


class spatial_gate(nn.Module):
    """A picture whose pixels are weighted by the largest and the mean of their channels (Woo et al. 2018, equation 3).

    The weights come of one 7 × 7 convolution and a sigmoid.
    """

    def __init__(self):
        super().__init__()
        self.spatial = convolution_layer(2, 1, kernel_size=7, bias=False, activation=nn.Identity())

    def channel_pool(self, x: torch.Tensor) -> torch.Tensor:
        """Return the maximum and the mean over the channels.

        Parameters
        ----------
        x : torch.Tensor
            Pictures ``[B, C, H, W]``.

        Returns
        -------
        torch.Tensor
            ``[B, 2, H, W]``, the maximum first.
        """
        x = pictures("x", x)
        return torch.stack([x.amax(dim=1), x.mean(dim=1)], dim=1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the pictures ``[B, C, H, W]`` with each pixel times its weight between 0 and 1."""
        x = pictures("x", x, None, self.spatial.model[0].weight)
        return x * torch.sigmoid(self.spatial(self.channel_pool(x)))


class convolutional_block_attention(nn.Module):
    """Channel gate, then spatial gate (Woo et al. 2018).

    Parameters
    ----------
    gate_channels : int
        Number of channels.
    reduction_ratio : int
        How many times fewer features the hidden layer of the channel gate has.
    pool_types : sequence of {"avg", "max"}
        Global pools of the channel gate.
    no_spatial : bool
        Leave the spatial gate out.
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
        self.channel_gate = channel_gate(gate_channels, reduction_ratio, pool_types)
        self.no_spatial = _validate.flag("no_spatial", no_spatial)
        if not no_spatial:
            self.spatial_gate = spatial_gate()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the gated pictures, ``[B, gate_channels, H, W]``."""
        gated = self.channel_gate(x)
        return gated if self.no_spatial else self.spatial_gate(gated)
