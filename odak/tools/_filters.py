"""Circular convolutions and correlations, and padding with a soft border, for the arrays of any library."""

import math
from collections.abc import Sequence

from odak import _array, _validate
from odak._array import Array
from odak.tools._frame import frame


def convolve2d(field: Array, kernel: Array) -> Array:
    """Convolve pictures that continue periodically with a kernel whose sample ``n // 2`` of each axis is its centre.

    Parameters
    ----------
    field : array
        ``[..., H, W]``.
    kernel : array
        ``[..., h, w]``, no larger than the field; leading axes broadcast.

    Returns
    -------
    array
        ``[..., H, W]``: Σ_j field[n + c − j]·kernel[j] with c = (h // 2, w // 2). Real when both are real, complex
        otherwise, in the widest precision given (float64 from integers). Differentiable in both.

    Raises
    ------
    TypeError
        If one of them is not an array.
    ValueError
        If the kernel is larger than the field.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.tools import convolve2d
    >>> convolve2d(np.eye(3), np.asarray([[0.0, 0, 0], [0, 1, 2], [0, 0, 0]])).round(12)
    array([[1., 2., 0.],
           [0., 1., 2.],
           [2., 0., 1.]])
    """
    xp = _array.namespace(_validate.image("field", field), _validate.image("kernel", kernel))
    size, small = tuple(field.shape[-2:]), tuple(kernel.shape[-2:])
    if any(k > n for k, n in zip(small, size, strict=True)):
        raise ValueError(f"kernel must be no larger than the field {list(size)}, got {list(small)}")
    is_real = not any("complex" in str(value.dtype) for value in (field, kernel))
    field, kernel = (_floating(value) for value in (field, kernel))
    if not is_real:
        field, kernel = _array.to_complex(field), _array.to_complex(kernel)
    forward, back = (xp.fft.rfftn, xp.fft.irfftn) if is_real else (xp.fft.fftn, xp.fft.ifftn)
    axes = (-2, -1)
    result = back(forward(field, axes=axes) * forward(kernel, s=size, axes=axes), s=size, axes=axes)
    # The transform takes the kernel's first sample for its centre.
    return xp.roll(result, (-(small[0] // 2), -(small[1] // 2)), axis=axes)


def correlation_2d(first_tensor: Array, second_tensor: Array) -> Array:
    """Return the circular cross-correlation of two pictures, its zero shift at sample ``(n + 1) // 2`` of each axis.

    Parameters
    ----------
    first_tensor, second_tensor : array
        ``[..., H, W]``; leading axes broadcast.

    Returns
    -------
    array
        Complex ``[..., H, W]``: sample (n + 1) // 2 + s holds Σ_j first[j + s]·conj(second[j]). Differentiable.

    Raises
    ------
    TypeError
        If one of them is not an array.
    ValueError
        If their last two axes differ.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.tools import correlation_2d
    >>> correlation_2d(np.eye(2), np.asarray([[1.0, 2.0], [0.0, 0.0]])).real
    array([[1., 2.],
           [2., 1.]])
    """
    xp = _array.namespace(
        _validate.image("first_tensor", first_tensor), _validate.image("second_tensor", second_tensor)
    )
    if tuple(first_tensor.shape[-2:]) != tuple(second_tensor.shape[-2:]):
        raise ValueError(
            f"second_tensor must have the rows and columns of first_tensor, {list(first_tensor.shape[-2:])}; "
            f"got {list(second_tensor.shape[-2:])}"
        )
    axes = (-2, -1)
    first, second = (xp.fft.fftn(_array.to_complex(value), axes=axes) for value in (first_tensor, second_tensor))
    return xp.fft.ifftshift(xp.fft.ifftn(first * xp.conj(second), axes=axes), axes=axes)


def smooth_pad(
    field: Array,
    size: Sequence[int] | None = None,
    method: str = "center",
    smooth_factor: Sequence[float] | None = None,
) -> Array:
    """Surround a field with its own border samples, fading to zero at the rim.

    Parameters
    ----------
    field : array
        Real or complex ``[..., H, W]``.
    size : sequence of int, optional
        Rows and columns of the result; by default twice those of the field.
    method : {"center", "left", "left aligned"}
        Put the field in the centre (sample ``n // 2`` stays the centre), or in the corner where rows and columns begin.
    smooth_factor : sequence of float, optional
        How steeply columns and rows (in this order) fade: cos(πu/2) to the power of 100^f at the share u of the way
        to the rim. By default a raised cosine.

    Returns
    -------
    array
        ``[..., size[0], size[1]]`` of the same library, dtype and device; the content is exactly the field. Gradients
        pass through the content, not through its copies in the border.

    Raises
    ------
    TypeError
        If `field` is not a real or complex floating array.
    ValueError
        If the size is smaller than the field, or an argument is not known.
    """
    height, width, top, left = frame(field, size, method)
    xp, device = _array.namespace(field), _array.device_of(field)
    if not xp.isdtype(field.dtype, ("real floating", "complex floating")):
        raise TypeError(f"field must hold floating numbers, got {field.dtype}")
    columns, rows = _factors(smooth_factor)
    window, inside = 1.0, 1.0
    for axis, start, total, factor in ((-2, top, height, rows), (-1, left, width, columns)):
        n = field.shape[axis]
        place = xp.arange(total, device=device) - start
        field = xp.take(field, xp.clip(place, 0, n - 1), axis=axis)
        line = xp.asarray(_fade(n, start, total, factor), dtype=xp.float64, device=device)
        shape = (total, 1) if axis == -2 else (total,)
        window = window * xp.reshape(line, shape)
        inside = inside * xp.reshape(xp.astype((place >= 0) & (place < n), xp.float64), shape)
    copies = field.detach() if _array.is_torch(field) else field
    window = xp.astype(xp.astype(window, _array.real_dtype(field)), field.dtype)
    return xp.where(inside > 0, field, copies * window)


def _fade(n: int, start: int, total: int, factor: float | None) -> list[float]:
    """Return the window along one axis: up before the content, 1 over it, down after it."""
    after = total - n - start
    if factor is None:
        rise = [(1 - math.cos(math.pi * t / max(start - 1, 1))) / 2 for t in range(start)]
        fall = [(1 + math.cos(math.pi * t / max(after - 1, 1))) / 2 for t in range(after)]
        return rise + [1.0] * n + fall
    power = 100.0 ** max(factor, 0.0)

    def steps(count):
        return [max(math.cos(math.pi / 2 * i / max(count - 1, 1)), 0.0) ** power for i in range(count)]

    return steps(start)[::-1] + [1.0] * n + steps(after)


def _factors(smooth_factor) -> tuple[float | None, float | None]:
    if smooth_factor is None:
        return None, None
    factors = _validate.numbers(_validate.real("smooth_factor", smooth_factor))
    if len(factors) != 2:
        raise ValueError(f"smooth_factor must be two numbers, for columns and rows, got {smooth_factor!r}")
    return factors[0], factors[1]


def _floating(value):
    xp = _array.namespace(value)
    if xp.isdtype(value.dtype, ("real floating", "complex floating")):
        return value
    return xp.astype(value, xp.float64)
