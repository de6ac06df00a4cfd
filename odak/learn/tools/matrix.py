"""Padding, cropping and quantising of tensors, the layouts of images included."""

from collections.abc import Sequence

import torch

from odak import _validate
from odak.tools import matrix

_MOST_BITS = 30


def zero_pad(field: torch.Tensor, size: Sequence[int] | None = None, method: str = "center") -> torch.Tensor:
    """Surround a field with zeros; sample ``n // 2`` of each axis stays the centre.

    Parameters
    ----------
    field : torch.Tensor
        ``[..., H, W]``. Three and four axes of which the last is exactly 3 long are read as colour, ``[..., H, W, 3]``.
    size : sequence of int, optional
        Rows and columns of the result (the last two entries count); by default twice those of the field.
    method : {"center", "left", "left aligned"}
        Put the field in the centre, or in the corner where rows and columns begin.

    Returns
    -------
    torch.Tensor
        The same layout, dtype and device; ``[1, C, H, W]`` loses its batch axis. Differentiable.

    Raises
    ------
    TypeError
        If `field` is not a tensor.
    ValueError
        If the size is smaller than the field, or the method is not known.
    """
    return _on_images(lambda planes: matrix.zero_pad(planes, size, method), field)


def crop_center(field: torch.Tensor, size: Sequence[int] | None = None) -> torch.Tensor:
    """Cut the centre out of a field; sample ``n // 2`` of each axis stays the centre.

    Parameters
    ----------
    field : torch.Tensor
        ``[..., H, W]``. Three and four axes of which the last is exactly 3 long are read as colour, ``[..., H, W, 3]``.
    size : sequence of int, optional
        Rows and columns of the result (the last two entries count); by default half of those of the field.

    Returns
    -------
    torch.Tensor
        A view in the same layout; ``[1, C, H, W]`` loses its batch axis.

    Raises
    ------
    TypeError
        If `field` is not a tensor.
    ValueError
        If the size is larger than the field.
    """
    return _on_images(lambda planes: matrix.crop_center(planes, size), field)


def quantize(image_field: torch.Tensor, bits: int = 8, limits: Sequence[float] = (0.0, 1.0)) -> torch.Tensor:
    """Return the levels of an image: the interval between the limits cut into 2^bits equal steps.

    Parameters
    ----------
    image_field : torch.Tensor
        Values; those outside the limits take the nearest level, not-a-number takes 0.
    bits : int
        Bits, 1 to 30.
    limits : sequence of float
        Values where the first level begins and the last one ends.

    Returns
    -------
    torch.Tensor
        int32, 0 … 2^bits − 1.

    Raises
    ------
    TypeError
        If `image_field` is not a real tensor.
    ValueError
        If `bits` or `limits` is not acceptable.
    """
    if not isinstance(image_field, torch.Tensor) or image_field.is_complex():
        kind = getattr(image_field, "dtype", type(image_field).__name__)
        raise TypeError(f"image_field must be a real tensor, got {kind}")
    if _validate.integer("bits", bits, minimum=1) > _MOST_BITS:
        raise ValueError(f"bits must be at most {_MOST_BITS}, got {bits}")
    low, high = (float(limit) for limit in limits)
    if not low < high:
        raise ValueError(f"limits must be two rising numbers, got {limits!r}")
    levels = (image_field - low) / (high - low) * 2**bits
    return levels.nan_to_num(nan=0.0).clamp(0, 2**bits).to(torch.int32).clamp(max=2**bits - 1)


def _on_images(change, field):
    """Apply a change of the last two axes to a field whose layout may be that of colour images."""
    if not isinstance(field, torch.Tensor):
        raise TypeError(f"field must be a tensor, got {type(field).__name__}")
    if field.ndim in (3, 4) and field.shape[-1] == 3:
        return change(field.movedim(-1, -3)).movedim(-3, -1)
    result = change(field)
    return result[0] if result.ndim == 4 and len(result) == 1 else result
