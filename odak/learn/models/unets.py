"""U-Nets with fixed kernels, and with spatially varying kernels that a second network computes.

A convolution with a kernel that varies over the image is one with a fixed kernel times a map of factors. The windows of
the image times the map form a matrix of k² times the size of the image, which one product with the weights maps to the
result. It is formed for some rows at a time, few enough to fit in the cache, and again in the backward pass; only the
inputs are kept.

References
----------
Ronneberger, Fischer and Brox 2015 (MICCAI); Xu et al. 2020 (SqueezeSegV3, equation 3); Zheng, Zhan, Shi, Cakmakci and
Akşit 2024 (SIGGRAPH Asia Technical Communications).
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak._torch_private import is_transformed
from odak.learn.models.layers import (
    activation_module,
    block_options,
    channels,
    convolution_layer,
    double_convolution,
    downsample_layer,
    global_feature_module,
    images,
    kernel,
    upsample_convtranspose2d_layer,
    upsample_layer,
)

# An eighth of this is faster on an idle machine, but every operation on a part synchronises all threads, which takes
# milliseconds on a busy one. On a GPU the limit serves memory alone.
_CPU_BYTES = 1 << 25
_GPU_BYTES = 1 << 28
_LEAKY_RELU = nn.LeakyReLU(0.2, inplace=True)
_RELU = nn.ReLU(inplace=True)


def modulated_convolution(
    x: torch.Tensor, factors: torch.Tensor, weight: torch.Tensor, stride: int = 1, padding: int = 0
) -> torch.Tensor:
    r"""Return the convolution of images with a kernel that is multiplied by other factors at every pixel.

    .. math:: y_{o}(p) = \sum_{c,t} w_{oct}\, f_{ct}(p)\, x_c(s\,p + t)

    Differentiable any number of times in all three.

    Parameters
    ----------
    x : torch.Tensor
        Images ``[B, C, H, W]``.
    factors : torch.Tensor
        ``[B, C·k², H', W']``, the channel first, then the row and the column inside the kernel.
    weight : torch.Tensor
        ``[out, C, k, k]``.
    stride : int
        Step of the kernel in pixels.
    padding : int
        Zeros around the image.

    Returns
    -------
    torch.Tensor
        ``[B, out, H', W']``, H' = (H + 2·padding − k) // stride + 1.
    """
    device, tensors = x.device.type, (x, factors, weight)
    if torch.amp.is_autocast_available(device) and torch.is_autocast_enabled(device) and x.dtype != torch.float64:
        x, factors, weight = tensors = [tensor.to(torch.get_autocast_dtype(device)) for tensor in tensors]
    if is_transformed(*tensors):
        return _plainly(x, factors, weight, stride, padding)
    return _ModulatedConvolution.apply(x, factors, weight, stride, padding)


def _plainly(x, factors, weight, stride, padding):
    """Return the convolution in one piece, by operations of torch that are differentiable."""
    windows = _windows(torch.nn.functional.pad(x, [padding] * 4), weight.shape[-1], stride)
    modulated = _columns(windows * factors.view(windows.shape))
    return (weight.flatten(1) @ modulated).unflatten(2, windows.shape[-2:])


def _windows(padded, size, stride):
    """Return ``[B, C, k, k, H', W']``, a view: the samples that meet each position of the kernel."""
    return padded.unfold(2, size, stride).unfold(3, size, stride).permute(0, 1, 4, 5, 2, 3)


def _parts(windows) -> Iterator[tuple[slice, slice, slice]]:
    """Yield ranges of the batch, of the rows of windows, and of the pixels in them; each part is of bounded size."""
    batch, rows, width = (windows.shape[axis] for axis in (0, 4, 5))
    limit = _CPU_BYTES if windows.device.type == "cpu" else _GPU_BYTES
    count = max(1, limit // (math.prod(windows.shape[1:4]) * width * windows.element_size()))
    images = max(1, count // rows)
    count = math.ceil(rows / math.ceil(rows / count))
    for b in range(0, batch, images):
        for r in range(0, rows, count):
            end = min(r + count, rows)
            yield slice(b, b + images), slice(r, end), slice(r * width, end * width)


class _ModulatedConvolution(torch.autograd.Function):
    """The trilinear product in parts; each gradient is a product of the other two factors and the incoming gradient."""

    @staticmethod
    def forward(x, factors, weight, stride, padding):
        windows = _windows(torch.nn.functional.pad(x, [padding] * 4), weight.shape[-1], stride)
        maps, matrix = factors.view(windows.shape), weight.flatten(1)
        result = x.new_empty(len(x), len(weight), *windows.shape[-2:])
        columns = result.flatten(2)
        scratch = _Scratch(x)
        for b, r, pixels in _parts(windows):
            window = windows[b, ..., r, :]
            modulated = torch.mul(window, maps[b, ..., r, :], out=scratch.like(window))
            torch.bmm(matrix.expand(len(window), -1, -1), _columns(modulated), out=columns[b, :, pixels])
        return result

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.save_for_backward(*inputs[:3])
        ctx.options = inputs[3:]

    @staticmethod
    def backward(ctx, gradient):
        tensors, wanted = ctx.saved_tensors, ctx.needs_input_grad[:3]
        if not torch.is_grad_enabled():
            return *_gradients(*tensors, *ctx.options, gradient, wanted), None, None
        # New views: the gradient of an argument computed from another must not be passed on to that one here.
        tensors = [tensor.view_as(tensor) for tensor in tensors]
        chosen = [tensor for tensor, needed in zip(tensors, wanted, strict=True) if needed]
        found = iter(torch.autograd.grad(_plainly(*tensors, *ctx.options), chosen, gradient, create_graph=True))
        return *(next(found) if needed else None for needed in wanted), None, None


class _Scratch:
    """Memory of one part, reused for the next: allocating and clearing it takes longer than the product."""

    def __init__(self, example: torch.Tensor):
        self._memory = example.new_empty(0)

    def like(self, window: torch.Tensor) -> torch.Tensor:
        if self._memory.numel() < window.numel():
            self._memory = self._memory.new_empty(window.numel())
        return self._memory[: window.numel()].view(window.shape)


def _columns(windows):
    """Return windows as ``[B, C·k², pixels]``."""
    return windows.flatten(1, 3).flatten(2)


def _gradients(x, factors, weight, stride, padding, gradient, wanted):
    """Return the gradients of image, factors and weight, None where not wanted."""
    size = weight.shape[-1]
    padded = torch.nn.functional.pad(x, [padding] * 4)
    windows, matrix = _windows(padded, size, stride), weight.flatten(1)
    maps, incoming = factors.view(windows.shape), gradient.flatten(2)
    to_x = torch.zeros_like(padded)
    to_windows = _windows(to_x, size, stride)
    to_maps = windows.new_empty(windows.shape) if wanted[1] else None
    to_matrix = torch.zeros_like(matrix)
    scratch = _Scratch(x)
    for b, r, pixels in _parts(windows):
        window, factor, arrived = windows[b, ..., r, :], maps[b, ..., r, :], incoming[b, :, pixels]
        buffer = scratch.like(window)
        if wanted[2]:
            torch.mul(window, factor, out=buffer)
            to_matrix += torch.bmm(arrived, _columns(buffer).mT).sum(0)
        if wanted[0] or wanted[1]:
            torch.bmm(matrix.T.expand(len(window), -1, -1), arrived, out=_columns(buffer))
        if wanted[1]:
            torch.mul(window, buffer, out=to_maps[b, ..., r, :])
        if wanted[0]:
            # One position of the kernel at a time: neighbouring windows add to the same pixels.
            for i, j in itertools.product(range(size), repeat=2):
                to_windows[b, :, i, j, r].addcmul_(buffer[:, :, i, j], factor[:, :, i, j])
    rows, columns = (slice(padding, padding + n) for n in x.shape[-2:])
    return (
        to_x[..., rows, columns] if wanted[0] else None,
        to_maps.view(factors.shape) if wanted[1] else None,
        to_matrix.view(weight.shape) if wanted[2] else None,
    )


class _AdaptiveLayer(nn.Module):
    """Common base: a weight that appears twice in the state dict, and the check of the two inputs."""

    _sums = 0  # channels of the result that are sums of windows, without a kernel of their own

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
        super().__init__()
        weights = _validate.integer("output_channels", output_channels, minimum=1 + self._sums) - self._sums
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
        # A file from a GPU may hold two tensors, of which `weight` is the trained one; files that store shared tensors
        # once hold one of the keys.
        keys = [f"{prefix}weight", f"{prefix}standard_convolution.weight"]
        held = [state_dict[key] for key in keys if key in state_dict]
        if held:
            state_dict.update(dict.fromkeys(keys, held[0]))
        super()._load_from_state_dict(state_dict, prefix, *args)

    def _apply(self, *args, **kwargs):
        # Moves that replace the parameter, such as to the device "meta", would create two separate parameters.
        moved = super()._apply(*args, **kwargs)
        _tie(self)
        return moved

    def _fitted(self, x: torch.Tensor, factors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return both inputs after a check of their shapes, padded where they fit only after padding."""
        x = images("x", x, self.input_channels, self.weight)
        count = self.input_channels * self.kernel_size**2
        factors = images("sv_kernel_feature", factors, None, self.weight)
        _validate.shaped("sv_kernel_feature", factors, f"[{x.shape[0]} or 1, {count}, H', W'] for x {tuple(x.shape)}")
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
        """Return x zero-padded along the chosen axes by its size modulo the stride."""
        dy, dx = (n % self.stride if wanted else 0 for n, wanted in zip(x.shape[-2:], axes, strict=True))
        return nn.functional.pad(x, [dx // 2, dx - dx // 2, dy // 2, dy - dy // 2]) if dx or dy else x


def _tie(layer, incompatible_keys=None) -> None:
    """Make the two entries of the weight one parameter."""
    layer.standard_convolution.weight = layer.weight


class spatially_adaptive_convolution(_AdaptiveLayer):
    """Convolution whose kernel is multiplied by other factors at every pixel.

    Neither the activation nor the bias is applied: weights are trained without them. The state dict holds the weight
    twice, as ``weight`` and as ``standard_convolution.weight``; it is one parameter, and where a file holds two
    different ones, ``weight`` is taken.

    Parameters
    ----------
    input_channels : int
        Channels of the input.
    output_channels : int
        Channels of the result.
    kernel_size : int
        Edge k of the kernel in pixels.
    stride : int
        Step of the kernel in pixels.
    padding : int
        Zeros around the image.
    bias : bool
        Keep a bias in the state dict.
    activation : torch.nn.Module or None
        Kept as an attribute.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import spatially_adaptive_convolution
    >>> layer = spatially_adaptive_convolution(2, 3)
    >>> tuple(layer(torch.rand(1, 2, 8, 8), torch.rand(1, 18, 8, 8)).shape)
    (1, 3, 8, 8)
    """

    def forward(self, x: torch.Tensor, sv_kernel_feature: torch.Tensor) -> torch.Tensor:
        """Return the convolution.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, C, H, W]``.
        sv_kernel_feature : torch.Tensor
            Factors ``[B or 1, C·k², H', W']``, H' = (H + 2·padding − k) // stride + 1. Along an axis
            where the sizes do not match, both are zero-padded by their size modulo the stride.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H', W']``.

        Raises
        ------
        ValueError
            If the shapes do not match.
        """
        x, factors = self._fitted(x, sv_kernel_feature)
        return modulated_convolution(x, factors, self.weight, self.stride, self.padding)


class spatially_adaptive_module(_AdaptiveLayer):
    """Spatially adaptive convolution concatenated with the sum of the modulated windows, followed by an activation.

    The bias is not applied: weights are trained without it. The state dict holds the weight twice, as for
    :class:`spatially_adaptive_convolution`.

    Parameters
    ----------
    input_channels : int
        Number of channels.
    output_channels : int
        Number of channels, at least 2: the first is the sum, the others come from the convolution.
    kernel_size : int
        Edge k of the kernel in pixels.
    stride : int
        Step of the kernel in pixels.
    padding : int
        Zeros around the image.
    bias : bool
        Keep a bias in the state dict.
    activation : torch.nn.Module or None
        Applied to the result.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import spatially_adaptive_module
    >>> layer = spatially_adaptive_module(2, 3)
    >>> tuple(layer(torch.rand(1, 2, 8, 8), torch.rand(1, 18, 8, 8)).shape)
    (1, 3, 8, 8)
    """

    _sums = 1

    def forward(self, x: torch.Tensor, sv_kernel_feature: torch.Tensor) -> torch.Tensor:
        """Return the sum and the convolutions of the modulated windows, activated.

        Parameters
        ----------
        x : torch.Tensor
            Images ``[B, C, H, W]``.
        sv_kernel_feature : torch.Tensor
            Factors ``[B or 1, C·k², H', W']``, H' = (H + 2·padding − k) // stride + 1; padded as
            for :class:`spatially_adaptive_convolution`.

        Returns
        -------
        torch.Tensor
            ``[B, output_channels, H', W']``.

        Raises
        ------
        ValueError
            If the shapes do not match.
        """
        x, factors = self._fitted(x, sv_kernel_feature)
        # The sum is a convolution with a kernel of ones.
        weight = torch.cat([torch.ones_like(self.weight[:1]), self.weight])
        result = modulated_convolution(x, factors, weight, self.stride, self.padding)
        return result if self.activation is None else self.activation(result)


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

    inc: double_convolution

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
        self.depth: int = _validate.integer("depth", depth, minimum=1)
        width = channels("dimensions", dimensions)
        size = kernel(kernel_size)
        options = block_options(size, bias, normalization, activation)
        self.inc = double_convolution(input_channels, mid_channels=width, output_channels=width, **options)
        self.downsampling_layers: nn.ModuleList = nn.ModuleList(
            downsample_layer(width * 2**i, width * 2 ** (i + 1), **options) for i in range(depth)
        )
        self.upsampling_layers: nn.ModuleList = nn.ModuleList(
            upsample_layer(width * 2 ** (i + 1), width * 2**i, bilinear=bilinear, **options)
            for i in reversed(range(depth))
        )
        self.outc: nn.Conv2d = nn.Conv2d(
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
        self.depth: int = _validate.integer("depth", depth, minimum=1)
        self.input_channels: int = _validate.integer("input_channels", input_channels, minimum=2)
        width, size = channels("dimensions", dimensions), kernel(kernel_size, odd=True)
        options = block_options(size, bias, normalization, activation)
        # Channels after each double convolution of the encoder, and after the pooling before it.
        coded = [width * 2**i for i in range(depth)] + [width * 2 ** (depth - 1)]
        pooled = [width, *coded[:-1]]
        risen = [coded[-1]] + [min(n, 2 * width) for n in reversed(coded[:-1])]
        self.inc: convolution_layer = convolution_layer(input_channels, width, **options)
        self.encoder: nn.ModuleList = nn.ModuleList()
        for before, after in zip(pooled, coded, strict=True):
            self.encoder += [nn.AvgPool2d(2), double_convolution(before, before, after, **options)]
        self.spatially_varying_feature: nn.ModuleList = nn.ModuleList()
        for i, features in zip(reversed(range(depth + 1)), risen, strict=True):
            pools = [nn.AvgPool2d(2**n) for n in range(i + 1, 0, -1)]
            block = _kernel_block(
                features + 1 + sum(pooled[:i]), 4 * width, width * 2**i * size**2, size, bias, activation
            )
            self.spatially_varying_feature.append(nn.ModuleList([*pools, block]))
        bottom: dict[str, Any] = {**options, "activation": nn.LeakyReLU(0.2)}
        self.decoder: nn.ModuleList = nn.ModuleList([global_feature_module(coded[-1], coded[-1], coded[-1], **bottom)])
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
        accepted = f"[{wanted[0]} or 1, 1, {wanted[2]}, {wanted[3]}] as field is"
        _validate.shaped("focal_surface", focal_surface, accepted)
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
        self.depth: int = _validate.integer("depth", depth, minimum=1)
        size = kernel(kernel_size, odd=True)
        widths = [channels("dimensions", dimensions) * 2**i for i in range(depth + 2)]
        options = block_options(size, bias, normalization, activation)
        adaptive: dict[str, Any] = {"kernel_size": size, "padding": size // 2, "bias": bias, "activation": activation}
        self.inc: convolution_layer = convolution_layer(input_channels, widths[0], **options)
        self.encoder: nn.ModuleList = nn.ModuleList(
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
        self.global_feature_module: nn.ModuleList = nn.ModuleList(
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
        self.decoder: nn.ModuleList = nn.ModuleList(
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
            If the number of tensors is wrong, or their shapes do not match the field.
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
