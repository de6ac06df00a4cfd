"""Layers around the convolution whose kernel varies over the picture.

Xu et al. 2020 (SqueezeSegV3, equation 3); Zheng, Zhan, Shi, Cakmakci and Akşit 2024 (SIGGRAPH Asia Technical
Communications).
"""

import torch
from torch import nn

from odak import _validate
from odak.learn.models.adaptive_convolution import modulated_convolution
from odak.learn.models.arguments import activation_module, channels, kernel, pictures

_LEAKY_RELU = nn.LeakyReLU(0.2, inplace=True)


class _AdaptiveLayer(nn.Module):
    """Members of both layers: a weight that stands a second time in the state dict, and the fit of the two inputs."""

    def __init__(self, weights, input_channels, kernel_size, stride, padding, bias, activation):
        super().__init__()
        self.input_channels = channels("input_channels", input_channels)
        self.kernel_size = kernel(kernel_size)
        self.stride = _validate.integer("stride", stride, minimum=1)
        self.padding = _validate.integer("padding", padding)
        bias = _validate.flag("bias", bias)
        standard = nn.Conv2d(input_channels, weights, kernel_size, stride=stride, padding=padding, bias=bias)
        self.weight = standard.weight
        self.standard_convolution = standard
        self.activation = activation_module(activation)
        self.register_load_state_dict_post_hook(_tie)

    def _load_from_state_dict(self, state_dict, prefix, *args):
        # A file from a GPU may hold two tensors, of which `weight` is the trained one; one that keeps each tensor once
        # holds either key.
        keys = [f"{prefix}weight", f"{prefix}standard_convolution.weight"]
        held = [state_dict[key] for key in keys if key in state_dict]
        if held:
            state_dict.update(dict.fromkeys(keys, held[0]))
        super()._load_from_state_dict(state_dict, prefix, *args)

    def _apply(self, *args, **kwargs):
        # Moves that cannot keep a parameter, as to the device "meta", would make two of one.
        moved = super()._apply(*args, **kwargs)
        _tie(self)
        return moved

    def _fitted(self, x: torch.Tensor, factors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return both inputs after a check of their shapes, padded where only that makes them meet."""
        x = pictures("x", x, self.input_channels, self.weight)
        count = self.input_channels * self.kernel_size**2
        factors = pictures("sv_kernel_feature", factors, None, self.weight)
        if factors.ndim != 4 or factors.shape[1] != count or factors.shape[0] not in (1, x.shape[0]):
            raise ValueError(
                f"sv_kernel_feature must be [{x.shape[0]} or 1, {count}, H', W'] for x {tuple(x.shape)}, "
                f"got {tuple(factors.shape)}"
            )
        wanted, given = self._windows_of(x), list(factors.shape[-2:])
        apart = [had != needed for had, needed in zip(given, wanted, strict=True)]
        x, factors = self._filled(x, apart), self._filled(factors, apart)
        if self._windows_of(x) != list(factors.shape[-2:]):
            raise ValueError(
                f"sv_kernel_feature must have a kernel for each of {wanted} pixels, got {given} for x {tuple(x.shape)}"
            )
        return x, factors.expand(len(x), -1, -1, -1)

    def _windows_of(self, x) -> list[int]:
        return [(n + 2 * self.padding - self.kernel_size) // self.stride + 1 for n in x.shape[-2:]]

    def _filled(self, x, axes):
        """Return x with zeros along the axes that want them: as many as the stride leaves over of its size."""
        dy, dx = (n % self.stride if wanted else 0 for n, wanted in zip(x.shape[-2:], axes, strict=True))
        return nn.functional.pad(x, [dx // 2, dx - dx // 2, dy // 2, dy - dy // 2]) if dx or dy else x


def _tie(layer, incompatible_keys=None) -> None:
    """Make one parameter again of a weight that was assigned twice."""
    layer.standard_convolution.weight = layer.weight


class spatially_adaptive_convolution(_AdaptiveLayer):
    """Convolution whose kernel is multiplied by other factors at every pixel.

    Neither the activation nor the bias is applied: weights are trained without them. The state dict holds the weight
    twice, as ``weight`` and as ``standard_convolution.weight``; it is one parameter, and where a file holds two
    different ones, ``weight`` is taken.

    Parameters
    ----------
    input_channels, output_channels : int
        Numbers of channels.
    kernel_size : int
        Edge k of the kernel in pixels.
    stride : int
        Step of the kernel in pixels.
    padding : int
        Zeros around the picture.
    bias : bool
        Keep a bias in the state dict.
    activation : torch.nn.Module or None
        Kept as an attribute.
    """

    def __init__(
        self,
        input_channels: int = 2,
        output_channels: int = 2,
        kernel_size: int = 3,
        stride: int = 1,
        padding: int = 1,
        bias: bool = False,
        activation: nn.Module | None = _LEAKY_RELU,
    ):
        weights = channels("output_channels", output_channels)
        super().__init__(weights, input_channels, kernel_size, stride, padding, bias, activation)

    def forward(self, x: torch.Tensor, sv_kernel_feature: torch.Tensor) -> torch.Tensor:
        """Return the convolution.

        Parameters
        ----------
        x : torch.Tensor
            Pictures ``[B, C, H, W]``.
        sv_kernel_feature : torch.Tensor
            Factors ``[B or 1, C·k², H', W']``, H' = (H + 2·padding − k) // stride + 1. Along an axis where
            the sizes do not meet, both are padded with zeros by their size modulo the stride.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H', W']``.

        Raises
        ------
        ValueError
            If the shapes do not meet.
        """
        x, factors = self._fitted(x, sv_kernel_feature)
        return modulated_convolution(x, factors, self.weight, self.stride, self.padding)


class spatially_adaptive_module(_AdaptiveLayer):
    """A spatially adaptive convolution beside the plain sum of the modulated windows, then the activation.

    The bias is not applied: weights are trained without it. The state dict holds the weight twice, as for
    :class:`spatially_adaptive_convolution`.

    Parameters
    ----------
    input_channels : int
        Number of channels.
    output_channels : int
        Number of channels, at least 2: the first is the sum, the others are of the convolution.
    kernel_size : int
        Edge k of the kernel in pixels.
    stride : int
        Step of the kernel in pixels.
    padding : int
        Zeros around the picture.
    bias : bool
        Keep a bias in the state dict.
    activation : torch.nn.Module or None
        Applied to the result.
    """

    def __init__(
        self,
        input_channels: int = 2,
        output_channels: int = 2,
        kernel_size: int = 3,
        stride: int = 1,
        padding: int = 1,
        bias: bool = False,
        activation: nn.Module | None = _LEAKY_RELU,
    ):
        weights = _validate.integer("output_channels", output_channels, minimum=2) - 1
        super().__init__(weights, input_channels, kernel_size, stride, padding, bias, activation)

    def forward(self, x: torch.Tensor, sv_kernel_feature: torch.Tensor) -> torch.Tensor:
        """Return the sum and the convolutions of the modulated windows, activated.

        Parameters
        ----------
        x : torch.Tensor
            Pictures ``[B, C, H, W]``.
        sv_kernel_feature : torch.Tensor
            Factors ``[B or 1, C·k², H', W']``, as for :class:`spatially_adaptive_convolution`.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H', W']``.

        Raises
        ------
        ValueError
            If the shapes do not meet.
        """
        x, factors = self._fitted(x, sv_kernel_feature)
        # The sum is the convolution with ones.
        weight = torch.cat([torch.ones_like(self.weight[:1]), self.weight])
        result = modulated_convolution(x, factors, weight, self.stride, self.padding)
        return result if self.activation is None else self.activation(result)
