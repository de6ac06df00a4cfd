"""Checks of pictures, block-wise evaluation and depth slices shared by the perception modules."""

from collections.abc import Callable, Sequence

import torch

from odak import _array, _torch_private, _validate
from odak.learn._tensors import tensor
from odak.learn.tools.matrix import blur_gaussian

__all__ = ["blur_gaussian", "check_loss_inputs", "check_values", "checked_pair", "slice_rgbd_targets"]

# Values should lie in 0 … 1; optimizers and speckle may exceed it slightly, 8-bit values are an error.
FARTHEST = 100.0


def check_loss_inputs(loss_name: str, image: torch.Tensor, target: torch.Tensor) -> None:
    """Raise ValueError unless two images can be compared.

    Parameters
    ----------
    loss_name : str
        Name of the loss, with which the message begins.
    image : torch.Tensor
        ``[B, C, H, W]``, one or three channels.
    target : torch.Tensor
        Image of the same shape.

    Raises
    ------
    ValueError, TypeError
        If the sizes differ, there are not four axes, not one or three channels, or no pixels.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import check_loss_inputs
    >>> check_loss_inputs("loss", torch.zeros(1, 3, 8, 8), torch.zeros(1, 3, 8, 8))
    >>> try:
    ...     check_loss_inputs("loss", torch.zeros(1, 3, 8, 8), torch.zeros(1, 3, 8, 9))
    ... except ValueError:
    ...     print("of two sizes")
    of two sizes
    """
    if not isinstance(loss_name, str):
        raise TypeError(f"loss_name must be a string, got {type(loss_name).__name__}")
    for name, picture in (("image", image), ("target", target)):
        if not isinstance(picture, torch.Tensor):
            raise TypeError(f"{loss_name} ERROR: {name} must be a tensor, got {type(picture).__name__}")
    shapes = f"got {tuple(image.shape)} and {tuple(target.shape)}"
    if image.shape != target.shape:
        raise ValueError(f"{loss_name} ERROR: image and target must have one size, {shapes}")
    if image.ndim != 4:
        raise ValueError(f"{loss_name} ERROR: image and target must have four axes [B, C, H, W], {shapes}")
    if image.shape[1] not in (1, 3):
        raise ValueError(f"{loss_name} ERROR: image and target must have one or three channels, {shapes}")
    if not image.numel():
        raise ValueError(f"{loss_name} ERROR: image and target must not be empty, {shapes}")
    _validate.one_device(image=image, target=target)


def check_values(peak: float = 1.0, **pictures: torch.Tensor) -> None:
    """Raise ValueError if a picture holds NaN, infinities or values far outside 0 … peak.

    Parameters
    ----------
    peak : float
        Largest value that a picture should have.
    **pictures : torch.Tensor
        Pictures by the names that a message gives them. Values on a GPU, or held by a transform, are not read.

    Raises
    ------
    ValueError, TypeError
        If a value is not finite, or beyond ±100 times the peak; or the peak is not positive.
    """
    _validate.number("peak", peak, positive=True)
    for name, picture in pictures.items():
        if picture.is_complex():
            raise TypeError(f"{name} must be real, got {picture.dtype}")
        if not picture.numel() or not _array.is_readable(picture):
            continue
        low, high = (float(value) for value in torch.aminmax(picture.detach()))
        if not (low >= -FARTHEST * peak and high <= FARTHEST * peak):
            raise ValueError(f"{name} must hold finite values of about 0 to {peak:g}, got {low:.4g} to {high:.4g}")


def checked_pair(
    predictions: torch.Tensor, targets: torch.Tensor, peak: float = 1.0
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return two pictures in one precision after checking that they are real floats of one shape, about 0 … peak.

    Parameters
    ----------
    predictions, targets : torch.Tensor
        Pictures of any shape.
    peak : float
        Largest value that a picture should have.

    Returns
    -------
    tuple of torch.Tensor
        The pictures, both in the finer of the two precisions, float32 for half precision.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ or are empty, either is not a tensor of real floats, or holds NaN or values far outside
        the range.
    """
    for name, value in (("predictions", predictions), ("targets", targets)):
        if not isinstance(value, torch.Tensor) or not value.is_floating_point():
            kind = getattr(value, "dtype", type(value).__name__)
            raise TypeError(f"{name} must be a tensor of real floats, got {kind}")
    _validate.alike(predictions=predictions, targets=targets)
    if not predictions.numel():
        raise ValueError(f"predictions and targets must not be empty, got {tuple(predictions.shape)}")
    check_values(peak, predictions=predictions, targets=targets)
    dtype = torch.promote_types(predictions.dtype, targets.dtype)
    return in_float32(predictions.to(dtype)), in_float32(targets.to(dtype))


def as_pictures(name: str, image: torch.Tensor, channels: int | None = 3) -> torch.Tensor:
    """Return real pictures ``[..., C, H, W]`` with at least four axes after checking them."""
    if not isinstance(image, torch.Tensor) or not image.is_floating_point():
        kind = getattr(image, "dtype", type(image).__name__)
        raise TypeError(f"{name} must be a tensor of real floats, got {kind}")
    if image.ndim < 3 or (channels is not None and image.shape[-3] != channels):
        wanted = "C" if channels is None else channels
        raise ValueError(f"{name} must be pictures [..., {wanted}, H, W], got {tuple(image.shape)}")
    return image if image.ndim > 3 else image[None]


def in_float64(values: torch.Tensor) -> torch.Tensor:
    """Return values in float64 where the device has it."""
    return values if values.device.type == "mps" else values.double()


def in_float32(values: torch.Tensor) -> torch.Tensor:
    """Return values of half precision in float32, others as they are."""
    return values.to(torch.promote_types(values.dtype, torch.float32))


def slice_rgbd_targets(
    target: torch.Tensor, depth: torch.Tensor, depth_plane_positions: Sequence[float] | torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Cut a picture into slices of depth.

    Parameters
    ----------
    target : torch.Tensor
        Picture ``[C, H, W]``.
    depth : torch.Tensor
        Depth of each pixel ``[H, W]``.
    depth_plane_positions : sequence of float or torch.Tensor
        N + 1 rising boundaries. Slice i holds boundary[i] ≤ depth < boundary[i + 1]; the last one its upper boundary
        too. Pixels beyond the outermost boundaries, and those whose depth is not a number, are in no slice.

    Returns
    -------
    tuple of torch.Tensor
        Slices in the precision of `target` (float32 of integers), zero outside their depth, and masks of 0 and 1 in
        int32, each ``[N, C, H, W]``. The slices are differentiable in `target`.

    Raises
    ------
    ValueError, TypeError
        If the shapes do not fit or the boundaries do not rise.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import slice_rgbd_targets
    >>> slices, masks = slice_rgbd_targets(torch.ones(3, 1, 3), torch.tensor([[0.0, 0.5, 1.0]]), [0.0, 0.5, 1.0])
    >>> masks[:, 0, 0].tolist()
    [[1, 0, 0], [0, 1, 1]]
    """
    for name, value in (("target", target), ("depth", depth)):
        if not isinstance(value, torch.Tensor):
            raise TypeError(f"{name} must be a tensor, got {type(value).__name__}")
    if target.ndim != 3 or depth.shape != target.shape[-2:]:
        raise ValueError(
            f"target must be [C, H, W] and depth [H, W], got {tuple(target.shape)} and {tuple(depth.shape)}"
        )
    _validate.one_device(target=target, depth=depth)
    target, depth = (value if value.is_floating_point() else value.float() for value in (target, depth))
    edges = tensor("depth_plane_positions", depth_plane_positions, depth.dtype, depth.device)
    if edges.ndim != 1 or len(edges) < 2 or not (edges[1:] > edges[:-1]).all():
        raise ValueError(f"depth_plane_positions must be two or more rising numbers, got {depth_plane_positions!r}")
    edges = edges[:, None, None]
    inside = (depth >= edges[:-1]) & (depth < edges[1:])
    inside[-1] |= depth == edges[-1]
    masks = inside[:, None].expand(-1, target.shape[0], -1, -1)
    return target * masks, masks.to(torch.int32)


# Values that one thread takes at a time: a few such blocks fit a core's cache, and a call costs little beside them.
BLOCK = 1 << 17

Gradient = Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]


def by_pixels(
    function: Callable[[torch.Tensor], torch.Tensor], image: torch.Tensor, gradient: Gradient
) -> torch.Tensor:
    """Apply a function of single pixels to pictures, in blocks whose intermediate results stay in the cache of a CPU.

    Parameters
    ----------
    function : callable
        Maps pixels ``[..., C, n]`` to ``[..., C', n]``. It must not depend on other tensors that require a gradient.
    image : torch.Tensor
        ``[..., C, H, W]``.
    gradient : callable
        Maps pixels, the values of the function and the gradient with respect to these to the gradient with respect to
        the pixels.

    Returns
    -------
    torch.Tensor
        ``[..., C', H, W]``; differentiable as often as the function is.
    """
    size = image.shape[-2:]
    if not image.numel() or not is_plain(image):
        return function(image.flatten(-2)).unflatten(-1, size)
    result = _Blocks.apply(image.reshape(-1, image.shape[-3], size.numel()), function, gradient)
    return result.reshape(*image.shape[:-3], -1, *size)


def by_values(
    function: Callable[[torch.Tensor], torch.Tensor], values: torch.Tensor, gradient: Gradient
) -> torch.Tensor:
    """Apply a function of single numbers to a tensor of any shape; otherwise as :func:`by_pixels`."""
    if not values.numel() or not is_plain(values):
        return function(values)
    return by_pixels(function, values.reshape(1, 1, -1), gradient).reshape(values.shape)


def is_plain(image: torch.Tensor) -> bool:
    """Return whether a tensor is on a CPU, without a transform, forward-mode derivative or compiler."""
    if image.device.type != "cpu" or _torch_private.is_transformed():
        return False
    # Not the image alone: tensors beside one that is vmapped take part in the same operations.
    return not _torch_private.in_functional_transform()


class _Blocks(torch.autograd.Function):
    @staticmethod
    def forward(context, flat, function, gradient):
        context.function, context.gradient = function, gradient
        saved, flat, result = flat, flat.detach(), None
        for index, place in _places(flat):
            block = function(flat[index, :, place])
            if result is None:
                result = block.new_empty(len(flat), len(block), flat.shape[-1])
            result[index, :, place] = block
        context.save_for_backward(saved, result)
        return result

    @staticmethod
    def backward(context, outer):
        flat, value = context.saved_tensors
        if torch.is_grad_enabled():
            # Derivatives of the gradient are wanted.
            return torch.autograd.grad(context.function(flat), flat, outer, create_graph=True)[0], None, None
        result = torch.empty_like(flat)
        for index, place in _places(flat):
            block = context.gradient(flat[index, :, place], value[index, :, place], outer[index, :, place])
            result[index, :, place] = block
        return result, None, None


def _places(flat):
    """Return the index and the slice of pixels of each block."""
    count, step = flat.shape[-1], max(1, BLOCK * torch.get_num_threads() // flat.shape[1])
    return [(index, slice(start, start + step)) for index in range(len(flat)) for start in range(0, count, step)]
