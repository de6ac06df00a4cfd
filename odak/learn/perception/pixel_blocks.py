"""Functions of single pixels, evaluated block by block so that what is computed on the way never leaves the cache."""

from collections.abc import Callable

import torch

# Values for one thread: a few such blocks fit a core's cache, and calls cost little.
BLOCK = 1 << 17

Rows = torch.Tensor | tuple[torch.Tensor, ...]


Slopes = Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]


def by_pixels(
    function: Callable[[torch.Tensor], Rows], image: torch.Tensor, slopes: Slopes | None = None
) -> torch.Tensor:
    """Return a function of pixels, applied to pictures.

    Parameters
    ----------
    function : callable
        Takes ``[..., C, n]``, n pixels, and returns ``[..., C', n]``, or a tuple of C' rows ``[..., n]``. It must not
        depend on other tensors that require a gradient.
    image : torch.Tensor
        ``[..., C, H, W]``.
    slopes : callable, optional
        Takes pixels, the function's values for them and the gradient by these; returns the gradient by the pixels.
        Without it, autograd follows the function, block by block.

    Returns
    -------
    torch.Tensor
        ``[..., C', H, W]``; differentiable as often as the function is. On a CPU the gradient computes each block anew
        instead of keeping what was computed on the way.
    """
    size = image.shape[-2:]
    if not image.numel() or not is_plain(image):
        return _whole(function, image.flatten(-2)).unflatten(-1, size)
    flat = image.reshape(-1, image.shape[-3], size.numel())
    if torch.is_grad_enabled() and image.requires_grad:
        result = _Blocks.apply(flat, function, slopes)
    else:
        result = _forward(function, flat)
    return result.reshape(*image.shape[:-3], -1, *size)


def by_values(
    function: Callable[[torch.Tensor], torch.Tensor], values: torch.Tensor, slopes: Slopes | None = None
) -> torch.Tensor:
    """Return a function of single numbers, applied to a tensor of any shape; else as :func:`by_pixels`."""
    if not values.numel() or not is_plain(values):
        return function(values)
    return by_pixels(function, values.reshape(1, 1, -1), slopes).reshape(values.shape)


def by_matrix(matrix: torch.Tensor, image: torch.Tensor, offset: torch.Tensor | None = None) -> torch.Tensor:
    """Return a constant matrix ``[C', C]`` times each pixel of ``[..., C, H, W]``, plus an offset ``[C', 1]``."""
    size = image.shape[-2:]
    if not image.numel() or not is_plain(image):
        return _mixed(image.flatten(-2), matrix, offset).unflatten(-1, size)
    flat = image.reshape(-1, image.shape[-3], size.numel())
    return _Mixed.apply(flat, matrix, offset).reshape(*image.shape[:-3], -1, *size)


def is_plain(image: torch.Tensor) -> bool:
    """Say whether a tensor holds numbers on a CPU, not followed by torch.func, forward-mode gradients or a compiler."""
    if image.device.type != "cpu" or torch.compiler.is_compiling() or torch.autograd.forward_ad._current_level >= 0:
        return False
    # Not the image alone: what stands beside one that is vmapped goes through the same operations.
    return torch._C._functorch.peek_interpreter_stack() is None


class _Blocks(torch.autograd.Function):
    @staticmethod
    def forward(context, flat, function, slopes):
        context.function, context.slopes = function, slopes
        value = _forward(function, flat.detach())
        context.save_for_backward(flat, value if slopes else None)
        return value

    @staticmethod
    def backward(context, gradient):
        flat, value = context.saved_tensors
        if torch.is_grad_enabled():
            # Somebody wants derivatives of the gradient.
            value = _whole(context.function, flat)
            return torch.autograd.grad(value, flat, gradient, create_graph=True)[0], None, None
        result = torch.empty_like(flat)
        for index, place in _places(flat):
            block, outer = flat[index, :, place], gradient[index, :, place]
            if context.slopes:
                result[index, :, place] = context.slopes(block, value[index, :, place], outer)
            else:
                result[index, :, place] = _followed(context.function, block, outer)
        return result, None, None


class _Mixed(torch.autograd.Function):
    @staticmethod
    def forward(context, flat, matrix, offset):
        context.matrix = matrix
        flat = flat.detach()
        result = flat.new_empty(len(flat), len(matrix), flat.shape[-1])
        for index, place in _places(flat):
            mixed = torch.mm(matrix, flat[index, :, place], out=result[index, :, place])
            if offset is not None:
                mixed.add_(offset)
        return result

    @staticmethod
    def backward(context, gradient):
        return _Mixed.apply(gradient, context.matrix.T, None), None, None


def _mixed(pixels, matrix, offset):
    return matrix @ pixels if offset is None else (matrix @ pixels).add_(offset)


def _followed(function, block, gradient):
    """Return the gradient of a function by a block of pixels, which autograd finds."""
    block = block.detach().requires_grad_()
    with torch.enable_grad():
        value = _whole(function, block)
    return torch.autograd.grad(value, block, gradient)[0]


def _forward(function, flat):
    result = None
    for index, place in _places(flat):
        rows = function(flat[index, :, place])
        if result is None:
            result = flat.new_empty(len(flat), len(rows), flat.shape[-1], dtype=rows[0].dtype)
        target = result[index, :, place]
        if isinstance(rows, tuple):
            for one, row in zip(target, rows, strict=True):
                one.copy_(row)
        else:
            target.copy_(rows)
    return result


def _whole(function, flat):
    rows = function(flat)
    return torch.stack(rows, -2) if isinstance(rows, tuple) else rows


def _places(flat):
    count, step = flat.shape[-1], max(1, BLOCK * torch.get_num_threads() // flat.shape[1])
    return [(index, slice(start, start + step)) for index in range(len(flat)) for start in range(0, count, step)]
