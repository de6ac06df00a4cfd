"""Convolution with a kernel that varies over the image: a fixed kernel times a map of factors.

The windows of the image times the map form a matrix of k² times the size of the image, which one product with the
weights maps to the result. It is formed for some rows at a time, few enough to fit in the cache, and again in the
backward pass; only the inputs are kept.

References
----------
Xu et al. 2020 (SqueezeSegV3, equation 3); Zheng, Zhan, Shi, Cakmakci and Akşit 2024 (SIGGRAPH Asia Technical
Communications).
"""

import itertools
import math
from collections.abc import Iterator

import torch
from torch import nn

from odak import _validate
from odak._torch_private import is_transformed
from odak.learn.models._inputs import activation_module, channels, images, kernel

# An eighth of this is faster on an idle machine, but every operation on a part synchronises all threads, which takes
# milliseconds on a busy one. On a GPU the limit serves memory alone.
_CPU_BYTES = 1 << 25
_GPU_BYTES = 1 << 28


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


_LEAKY_RELU = nn.LeakyReLU(0.2, inplace=True)


class _AdaptiveLayer(nn.Module):
    """Common base: a weight that appears twice in the state dict, and the check of the two inputs."""

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
        Number of channels, at least 2: the first is the sum, the others are those of the convolution.
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
