"""Padding, cropping, quantising, filtering and blurring about the centre, for the arrays of any library."""

from collections.abc import Sequence
from typing import Any

from odak import _array, _validate
from odak._array import Array
from odak.tools._bands import create_empty_list, generate_bandlimits
from odak.tools._filters import convolve2d, correlation_2d, smooth_pad
from odak.tools._frame import frame, last_two
from odak.tools._nonuniform import nufft2, nuifft2

__all__ = [
    "blur_gaussian",
    "convolve2d",
    "correlation_2d",
    "create_empty_list",
    "crop_center",
    "generate_2d_gaussian",
    "generate_bandlimits",
    "nufft2",
    "nuifft2",
    "quantize",
    "smooth_pad",
    "zero_pad",
]


def zero_pad(field: Array, size: Sequence[int] | None = None, method: str = "center") -> Array:
    """Surround a field with zeros.

    Sample ``n // 2`` of each axis is its centre, before and after, so that :func:`crop_center` gives the field back
    for every parity.

    Parameters
    ----------
    field : array
        ``[..., H, W]``.
    size : sequence of int, optional
        Rows and columns of the result (the last two entries count); by default twice those of the field.
    method : {"center", "left", "left aligned"}
        Put the field in the centre, or in the corner where rows and columns begin.

    Returns
    -------
    array
        ``[..., size[0], size[1]]`` of the same library, dtype and device; differentiable.

    Raises
    ------
    TypeError
        If `field` is not an array.
    ValueError
        If the size is smaller than the field, or the method is not known.
    """
    height, width, top, left = frame(field, size, method)
    rows, columns = field.shape[-2:]
    bottom, right = height - rows - top, width - columns - left
    if _array.is_torch(field):
        import torch

        return torch.nn.functional.pad(field, (left, right, top, bottom))
    xp, device = _array.namespace(field), _array.device_of(field)

    def zeros(height, width):
        return xp.zeros((*field.shape[:-2], height, width), dtype=field.dtype, device=device)

    wide = xp.concat([zeros(rows, left), field, zeros(rows, right)], axis=-1)
    return xp.concat([zeros(top, width), wide, zeros(bottom, width)], axis=-2)


def crop_center(field: Array, size: Sequence[int] | None = None) -> Array:
    """Cut the centre out of a field: sample ``n // 2`` of each axis stays the centre.

    Parameters
    ----------
    field : array
        ``[..., H, W]``.
    size : sequence of int, optional
        Rows and columns of the result (the last two entries count); by default half of those of the field.

    Returns
    -------
    array
        ``[..., size[0], size[1]]``; a copy of an array, a view of a tensor.

    Raises
    ------
    TypeError
        If `field` is not an array.
    ValueError
        If the size is larger than the field.
    """
    rows, columns = _validate.image("field", field).shape[-2:]
    height, width = (max(1, rows // 2), max(1, columns // 2)) if size is None else last_two(size)
    if height > rows or width > columns:
        raise ValueError(f"size must be at most that of the field, {[rows, columns]}; got {[height, width]}")
    top, left = rows // 2 - height // 2, columns // 2 - width // 2
    window = field[..., top : top + height, left : left + width]
    return window if _array.is_torch(field) else _array.namespace(field).asarray(window, copy=True)


def quantize(image_field: Array, bits: int = 4) -> Array:
    """Return the 8-bit levels of an image as levels of fewer bits, the rest cut off.

    Parameters
    ----------
    image_field : array
        Values from 0 to 255; those outside take the nearest level, not-a-number takes 0.
    bits : int
        Bits to keep, 1 to 8.

    Returns
    -------
    array
        int64, 0 … 2^bits − 1.

    Raises
    ------
    TypeError
        If `image_field` is not a real array.
    ValueError
        If `bits` is not between 1 and 8.
    """
    _validate.integer("bits", bits, minimum=1)
    if bits > 8:
        raise ValueError(f"bits must be at most 8, got {bits}")
    if not _array.is_array(image_field) or "complex" in str(_validate.array("image_field", image_field).dtype):
        raise TypeError(f"image_field must be a real array, got {getattr(image_field, 'dtype', type(image_field))}")
    xp = _array.namespace(image_field)
    if not xp.isdtype(image_field.dtype, "real floating"):
        image_field = xp.astype(image_field, xp.float64)
    levels = xp.trunc(image_field / 2 ** (8 - bits))
    levels = xp.where(xp.isnan(levels), xp.zeros_like(levels), xp.clip(levels, 0, 2**bits - 1))
    return xp.astype(levels, xp.int64)


def generate_2d_gaussian(kernel_length: Sequence[int] = (21, 21), nsigma: Sequence[float] = (3.0, 3.0)) -> Any:
    """Return a Gaussian kernel that sums to one.

    Parameters
    ----------
    kernel_length : sequence of int
        Intervals along the columns and along the rows (in this order); an axis has one sample more than that.
    nsigma : sequence of float
        Standard deviations from the centre to the edge, along the columns and along the rows.

    Returns
    -------
    numpy.ndarray
        float64 ``[kernel_length[1] + 1, kernel_length[0] + 1]``.

    Raises
    ------
    ValueError, TypeError
        If `kernel_length` is not two positive integers or `nsigma` not two positive numbers.

    See Also
    --------
    odak.learn.tools.generate_2d_gaussian : Takes its size and its width in samples.

    Examples
    --------
    >>> from odak.tools import generate_2d_gaussian
    >>> generate_2d_gaussian([2, 3], [1, 1]).round(3)[0].tolist()
    [0.054, 0.088, 0.054]
    """
    return _gaussian(kernel_length, nsigma, _array.numpy_namespace, None)


def blur_gaussian(
    field: Array, kernel_length: Sequence[int] = (21, 21), nsigma: Sequence[float] = (3.0, 3.0), normalize: bool = True
) -> Array:
    """Blur pictures that continue periodically by :func:`generate_2d_gaussian`.

    Parameters
    ----------
    field : array
        Real ``[..., H, W]``.
    kernel_length, nsigma : sequence
        As in :func:`generate_2d_gaussian`; the kernel must not be larger than the picture.
    normalize : bool
        Divide each result by its largest value, as this function has always done. False keeps the picture's sum.

    Returns
    -------
    array
        ``[..., H, W]`` of the same library and precision (float64 from integers); differentiable.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    See Also
    --------
    odak.learn.tools.blur_gaussian : Surrounds the picture with zeros.
    """
    _validate.image("field", field)
    if "complex" in str(field.dtype):
        raise TypeError(f"field must be a real array, got {field.dtype}")
    xp = _array.namespace(field)
    if not xp.isdtype(field.dtype, "real floating"):
        field = xp.astype(field, xp.float64)
    kernel = _gaussian(kernel_length, nsigma, xp, _array.device_of(field))
    if any(small > large for small, large in zip(kernel.shape, field.shape[-2:], strict=True)):
        raise ValueError(
            f"kernel_length must give a kernel no larger than the field {tuple(field.shape[-2:])}, "
            f"got one of {tuple(kernel.shape)}"
        )
    blurred = convolve2d(field, xp.astype(kernel, field.dtype))
    if not _validate.flag("normalize", normalize):
        return blurred
    peak = xp.max(blurred, axis=(-2, -1), keepdims=True)
    return blurred / xp.where(peak > 0, peak, xp.ones_like(peak))


def _gaussian(kernel_length, nsigma, xp, device):
    columns, rows = _validate.size("kernel_length", kernel_length)
    widths = _validate.numbers(_validate.real("nsigma", nsigma, positive=True))
    if len(widths) != 2:
        raise ValueError(f"nsigma must be two positive numbers, got {nsigma!r}")
    x, y = (
        xp.exp(-0.5 * xp.linspace(-width, width, count + 1, dtype=xp.float64, device=device) ** 2)
        for count, width in zip((columns, rows), widths, strict=True)
    )
    return y[:, None] * x[None, :] / (xp.sum(y) * xp.sum(x))
