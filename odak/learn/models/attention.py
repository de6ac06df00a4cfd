"""Attention layers: non-local, channel, spatial, and gated by a second image."""

import functools
from collections.abc import Sequence
from typing import Any

import torch
from torch import nn
from torch.nn.functional import scaled_dot_product_attention
from torch.utils.checkpoint import checkpoint

from odak import _validate
from odak.learn.models._inputs import activation_module, channels, images, kernel
from odak.learn.models.convolutions import convolution_layer

_RELU = nn.ReLU()
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
        self.g = nn.Conv2d(outer, inner, **options)
        self.W_z = nn.Sequential(nn.Conv2d(inner, outer, **options), nn.BatchNorm2d(outer))
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
        self.pool_types = [_validate.one_of("pool_types", name, _POOLS) for name in named]
        if not self.pool_types:
            raise ValueError(f"pool_types must name at least one of {', '.join(_POOLS)}")
        self.mlp = nn.Sequential(
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
        self.spatial = convolution_layer(2, 1, kernel_size=7, bias=False, activation=nn.Identity())

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
        x = images("x", x, None, self.spatial.model[0].weight)
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
        self.channel_gate = channel_gate(gate_channels, reduction_ratio, pool_types)
        self.no_spatial = _validate.flag("no_spatial", no_spatial)
        if not no_spatial:
            self.spatial_gate = spatial_gate()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the gated images, ``[B, gate_channels, H, W]``.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, gate_channels, H, W]``.
        """
        gated = self.channel_gate(x)
        return gated if self.no_spatial else self.spatial_gate(gated)
