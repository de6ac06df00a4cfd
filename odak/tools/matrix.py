"""Padding, cropping, quantisation, convolution, blur and nonuniform transforms of arrays; conversion to torch."""

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from odak import _array, _validate
from odak._array import Array, ArrayT

if TYPE_CHECKING:
    import torch


def zero_pad(field: ArrayT, size: Sequence[int] | None = None, method: str = "center") -> ArrayT:
    """Pad a field with zeros.

    Sample ``n // 2`` of each axis is its centre, before and after, so that :func:`crop_center` gives the field back
    for every parity.

    Parameters
    ----------
    field : array
        ``[..., H, W]``.
    size : sequence of int, optional
        Rows and columns of the result (the last two entries count); by default twice the shape of the field.
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

    Examples
    --------
    >>> import numpy as np
    >>> from odak.tools import zero_pad
    >>> zero_pad(np.ones((1, 2))).tolist()
    [[0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 1.0, 0.0]]
    """
    height, width, top, left = frame(field, size, method)
    rows, columns = field.shape[-2:]
    bottom, right = height - rows - top, width - columns - left
    if _array.is_torch(field):
        import torch

        padded: Any = torch.nn.functional.pad(field, (left, right, top, bottom))
        return padded
    xp, device = _array.namespace(field), _array.device_of(field)

    def zeros(height, width):
        return xp.zeros((*field.shape[:-2], height, width), dtype=field.dtype, device=device)

    wide = xp.concat([zeros(rows, left), field, zeros(rows, right)], axis=-1)
    return xp.concat([zeros(top, width), wide, zeros(bottom, width)], axis=-2)


def crop_center(field: ArrayT, size: Sequence[int] | None = None) -> ArrayT:
    """Crop the centre of a field; sample ``n // 2`` of each axis stays the centre.

    Parameters
    ----------
    field : array
        ``[..., H, W]``.
    size : sequence of int, optional
        Rows and columns of the result (the last two entries count); by default half the shape of the field.

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

    Examples
    --------
    It undoes :func:`zero_pad`:

    >>> import numpy as np
    >>> from odak.tools import crop_center, zero_pad
    >>> field = np.ones((3, 5))
    >>> bool((crop_center(zero_pad(field), [3, 5]) == field).all())
    True
    """
    rows, columns = _validate.image("field", field).shape[-2:]
    height, width = (max(1, rows // 2), max(1, columns // 2)) if size is None else last_two(size)
    if height > rows or width > columns:
        raise ValueError(f"size must be at most the field's, {[rows, columns]}; got {[height, width]}")
    top, left = rows // 2 - height // 2, columns // 2 - width // 2
    window = field[..., top : top + height, left : left + width]
    return window if _array.is_torch(field) else _array.namespace(field).asarray(window, copy=True)


def quantize(image_field: ArrayT, bits: int = 4) -> ArrayT:
    """Reduce the 8-bit levels of an image to fewer bits by truncation.

    Parameters
    ----------
    image_field : array
        Values from 0 to 255; those outside take the nearest level, not-a-number takes 0. An
        :class:`~odak.ArgumentWarning` names a picture of 0 … 1, or of 16 bits.
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

    Examples
    --------
    >>> import numpy as np
    >>> from odak.tools import quantize
    >>> quantize(np.asarray([0, 64, 128, 255]), bits=2).tolist()
    [0, 1, 2, 3]
    """
    _validate.integer("bits", bits, minimum=1, most=8)
    if not _array.is_array(image_field) or "complex" in str(_validate.array("image_field", image_field).dtype):
        raise TypeError(
            f"image_field must be a real array, got {getattr(image_field, 'dtype', type(image_field).__name__)}"
        )
    xp = _array.namespace(image_field)
    if not xp.isdtype(image_field.dtype, "real floating"):
        image_field = xp.astype(image_field, xp.float64)
    known = xp.where(xp.isnan(image_field), xp.zeros_like(image_field), image_field)
    if _array.is_readable(known) and 0 not in known.shape:
        brightest = float(xp.max(known))
        remedy = "multiply it by 255, or use odak.learn.tools.quantize, which takes 0 … 1"
        remedy = remedy if brightest <= 255 else "all that is brighter takes the top level; scale it to 0 … 255"
        _validate.check_white("image_field", brightest, 255, remedy)
    levels = xp.clip(xp.trunc(known / 2 ** (8 - bits)), 0, 2**bits - 1)
    return xp.astype(levels, xp.int64)


def generate_2d_gaussian(kernel_length: Sequence[int] = (21, 21), nsigma: Sequence[float] = (3.0, 3.0)) -> np.ndarray:
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
    field: ArrayT, kernel_length: Sequence[int] = (21, 21), nsigma: Sequence[float] = (3.0, 3.0), normalize: bool = True
) -> ArrayT:
    """Blur images by :func:`generate_2d_gaussian`, with periodic boundaries.

    Parameters
    ----------
    field : array
        Real ``[..., H, W]``.
    kernel_length : sequence of int
        Intervals of the kernel along the columns and along the rows (in this order); an axis has one sample more than
        that, and no more than the picture.
    nsigma : sequence of float
        Standard deviations from the centre of the kernel to its edge, along the columns and along the rows.
    normalize : bool
        Divide each result by its largest value, as in earlier releases. False preserves the sum of the picture.

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

    Examples
    --------
    Without normalisation the sum is kept:

    >>> import numpy as np
    >>> from odak.tools import blur_gaussian
    >>> image = np.zeros((16, 16))
    >>> image[8, 8] = 3
    >>> round(float(blur_gaussian(image, (5, 5), (2, 2), normalize=False).sum()), 9)
    3.0
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
    widths = _validate.few("nsigma", nsigma, 2, positive=True)
    x, y = (
        xp.exp(-0.5 * xp.linspace(-width, width, count + 1, dtype=xp.float64, device=device) ** 2)
        for count, width in zip((columns, rows), widths, strict=True)
    )
    return y[:, None] * x[None, :] / (xp.sum(y) * xp.sum(x))


METHODS = ("center", "left", "left aligned")


def frame(field: Array, size: Sequence[int] | None, method: str) -> tuple[int, int, int, int]:
    """Return height and width of the larger field, and the row and column where the smaller one begins in it."""
    rows, columns = _validate.image("field", field).shape[-2:]
    height, width = (2 * rows, 2 * columns) if size is None else last_two(size)
    if height < rows or width < columns:
        raise ValueError(f"size must be at least the field's, {[rows, columns]}; got {[height, width]}")
    if _validate.one_of("method", method, METHODS) != "center":
        return height, width, 0, 0
    return height, width, height // 2 - rows // 2, width // 2 - columns // 2


def last_two(size: Sequence[int]) -> tuple[int, int]:
    """Return the last two entries of a size as rows and columns."""
    return _validate.size("size", tuple(size)[-2:] if isinstance(size, Iterable) else size)


def convolve2d(field: ArrayT, kernel: Array) -> ArrayT:
    """Convolve images with a kernel, periodically; the kernel is centred on sample ``n // 2`` of each axis.

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
        otherwise, in the widest precision given (float64 from integers, single from half). Differentiable in both.

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


def correlation_2d(first_tensor: ArrayT, second_tensor: Array) -> ArrayT:
    """Return the circular cross-correlation of two pictures, its zero shift at sample ``(n + 1) // 2`` of each axis.

    Parameters
    ----------
    first_tensor : array
        First picture, ``[..., H, W]``.
    second_tensor : array
        Second picture, ``[..., H, W]``; leading axes broadcast.

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
    rows, columns = first_tensor.shape[-2:]
    _validate.shaped("second_tensor", second_tensor, f"[..., {rows}, {columns}], with the sides of first_tensor")
    axes = (-2, -1)
    first, second = (xp.fft.fftn(_array.to_complex(value), axes=axes) for value in (first_tensor, second_tensor))
    return xp.fft.ifftshift(xp.fft.ifftn(first * xp.conj(second), axes=axes), axes=axes)


def smooth_pad(
    field: ArrayT,
    size: Sequence[int] | None = None,
    method: str = "center",
    smooth_factor: Sequence[float] | None = None,
) -> ArrayT:
    """Pad a field with its border samples, tapered to zero at the edge.

    Parameters
    ----------
    field : array
        Real or complex ``[..., H, W]``.
    size : sequence of int, optional
        Rows and columns of the result; by default twice the shape of the field.
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

    Examples
    --------
    The field itself is kept:

    >>> import numpy as np
    >>> from odak.tools import smooth_pad
    >>> padded = smooth_pad(np.ones((4, 4)), [8, 8])
    >>> float(padded[2:6, 2:6].min()), bool(padded[0, 0] < 0.3)
    (1.0, True)
    """
    height, width, top, left = frame(field, size, method)
    xp, device = _array.namespace(field), _array.device_of(field)
    if not xp.isdtype(field.dtype, ("real floating", "complex floating")):
        raise TypeError(f"field must have a floating-point dtype, got {field.dtype}")
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
    """Return the window along one axis: rising before the content, 1 over it, falling after it."""
    after = total - n - start
    if factor is None:
        rise = [(1 - math.cos(math.pi * t / max(start - 1, 1))) / 2 for t in range(start)]
        fall = [(1 + math.cos(math.pi * t / max(after - 1, 1))) / 2 for t in range(after)]
        return rise + [1.0] * n + fall
    power = 100.0 ** min(max(factor, 0.0), 150.0)  # beyond which the window is a step

    def steps(count):
        return [max(math.cos(math.pi / 2 * i / max(count - 1, 1)), 0.0) ** power for i in range(count)]

    return steps(start)[::-1] + [1.0] * n + steps(after)


def _factors(smooth_factor) -> tuple[float | None, float | None]:
    if smooth_factor is None:
        return None, None
    columns, rows = _validate.few("smooth_factor", smooth_factor, 2)
    return columns, rows


def _floating(value):
    xp = _array.namespace(value)
    if "float16" in str(value.dtype):
        # torch has no transforms of these on a CPU.
        return xp.astype(value, xp.float32)
    if xp.isdtype(value.dtype, ("real floating", "complex floating")):
        return value
    return xp.astype(value, xp.float64)


def create_empty_list(dimensions: Sequence[int] = (1, 1)) -> list[Any] | int:
    """Return nested lists of zeros; all lists are separate objects.

    Parameters
    ----------
    dimensions : sequence of int
        Lengths from the outermost list to the innermost; none gives the number 0.

    Returns
    -------
    list
        Nested lists.

    Examples
    --------
    >>> from odak.tools import create_empty_list
    >>> create_empty_list([2, 3])
    [[0, 0, 0], [0, 0, 0]]
    """
    _validate.listed("dimensions", dimensions, "a sequence of integers")
    lengths = [_validate.integer("dimensions", length) for length in dimensions]
    return _nested(lengths)


def generate_bandlimits(size: Sequence[int] = (512, 512), levels: int = 9) -> np.ndarray:
    """Return masks of octave rings of frequencies, the zero frequency at sample ``n // 2``.

    Parameters
    ----------
    size : sequence of int
        Rows and columns.
    levels : int
        Number of rings; the first one reaches the highest frequency.

    Returns
    -------
    numpy.ndarray
        float64 ``[levels, size[0], size[1]]``. Ring i is 1 in the box of the half-width n // 2^(i+1) about the centre,
        without the box of half that width.

    Raises
    ------
    ValueError, TypeError
        If `size` is not two positive integers or `levels` not a positive one.

    Examples
    --------
    Each ring has a quarter of the frequencies of the one outside it:

    >>> from odak.tools import generate_bandlimits
    >>> generate_bandlimits([32, 32], 3).sum((1, 2)).tolist()
    [768.0, 192.0, 48.0]
    """
    rows, columns = _validate.size("size", size)
    masks = np.zeros((_validate.integer("levels", levels, minimum=1), rows, columns))
    for i, mask in enumerate(masks):
        sides = [(n // 2, n // 2 ** (i + 1)) for n in (rows, columns)]
        mask[tuple(slice(centre - reach, centre + reach) for centre, reach in sides)] = 1
        mask[tuple(slice(int(centre - reach / 2), int(centre + reach / 2)) for centre, reach in sides)] = 0
    return masks


def _nested(lengths):
    return [_nested(lengths[1:]) for _ in range(lengths[0])] if lengths else 0


# Products of modes and points up to which the plain sum is taken without finufft: some seconds.
_LARGEST_SUM = 2**32
_BLOCK = 2**22


def nufft2(
    field: np.ndarray,
    fx: np.ndarray,
    fy: np.ndarray,
    size: Sequence[int] | None = None,
    sign: int = 1,
    eps: float = 1e-12,
) -> np.ndarray:
    """Return Σ field[k, l]·exp(±i(k·fx + l·fy)) at arbitrary positions (a transform of type 2).

    Mode numbers k, l run from −(n // 2) over n integers, so that sample ``n // 2`` is number 0.

    Parameters
    ----------
    field : numpy.ndarray
        ``[H, W]``, the coefficients of the modes.
    fx : numpy.ndarray
        Radians per mode along the index of the rows, of any shape.
    fy : numpy.ndarray
        Radians per mode along the index of the columns, of the size of `fx`.
    size : sequence of int, optional
        Shape of the result; by default the shape of the field.
    sign : {1, -1}
        Sign of the exponent.
    eps : float
        Relative accuracy asked of finufft. The plain sum has rounding alone.

    Returns
    -------
    numpy.ndarray
        complex128.

    Raises
    ------
    ImportError
        If the transform is large and finufft is not installed (``pip install finufft``).
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Notes
    -----
    Barnett, Magland and af Klinteberg, SIAM J. Sci. Comput. 41, C479 (2019), eq. 1.3.

    Examples
    --------
    The mode of number 1 at a phase of π/2 per mode:

    >>> import numpy as np
    >>> from odak.tools import nufft2
    >>> modes = np.zeros((1, 4))
    >>> modes[0, 3] = 2
    >>> complex(nufft2(modes, np.zeros((1, 1)), np.full((1, 1), np.pi / 2), [1, 1])[0, 0].round(9))
    2j
    """
    field, fx, fy = _checked(field, fx, fy, sign, eps)
    shape = field.shape if size is None else _counts("size", size)
    if math.prod(shape) != fx.size:
        raise ValueError(f"size must have as many samples as fx, {fx.size}; got {shape}")
    finufft = _finufft(field.size * fx.size)
    if finufft is not None:
        return finufft.nufft2d2(fx, fy, field, eps=eps, isign=sign).reshape(shape)
    result = np.empty(fx.size, dtype=np.complex128)
    for part, rows, columns in _waves(field.shape, fx, fy, sign):
        result[part] = np.einsum("jl,jl->j", rows @ field, columns)
    return result.reshape(shape)


def nuifft2(
    field: np.ndarray,
    fx: np.ndarray,
    fy: np.ndarray,
    size: Sequence[int] | None = None,
    sign: int = 1,
    eps: float = 1e-12,
) -> np.ndarray:
    """Return the modes Σ_j field_j·exp(±i(k·fx_j + l·fy_j)), the adjoint of :func:`nufft2` (a transform of type 1).

    Parameters
    ----------
    field : numpy.ndarray
        Values at the points, of the size of `fx`; two axes unless `size` is given.
    fx : numpy.ndarray
        Radians per mode along the index of the rows.
    fy : numpy.ndarray
        Radians per mode along the index of the columns.
    size : sequence of int, optional
        Rows and columns of modes; by default the field's.
    sign : {1, -1}
        Sign of the exponent. The adjoint of :func:`nufft2` with ``sign=1`` has ``sign=-1``.
    eps : float
        Relative accuracy asked of finufft. The plain sum has rounding alone.

    Returns
    -------
    numpy.ndarray
        complex128 ``[size[0], size[1]]``, number 0 at sample ``n // 2``.

    Raises
    ------
    ImportError
        If the transform is large and finufft is not installed (``pip install finufft``).
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Examples
    --------
    It is the adjoint of :func:`nufft2`, ⟨A·u, v⟩ = ⟨u, Aᴴ·v⟩:

    >>> import numpy as np
    >>> from odak.tools import nufft2, nuifft2
    >>> random = np.random.default_rng(0)
    >>> fx, fy = random.uniform(-3, 3, (2, 1, 5))
    >>> u, v = random.normal(size=(4, 6)), random.normal(size=(1, 5))
    >>> forward, back = nufft2(u, fx, fy, [1, 5]), nuifft2(v, fx, fy, [4, 6], sign=-1)
    >>> bool(np.allclose((forward * v).sum(), (u * back.conj()).sum()))
    True
    """
    field, fx, fy = _checked(field, fx, fy, sign, eps, modes=False)
    shape = _validate.size("size", field.shape if size is None else size)
    if field.size != fx.size:
        raise ValueError(f"field must have as many values as fx, {fx.size}; got {field.size}")
    finufft = _finufft(shape[0] * shape[1] * fx.size)
    if finufft is not None:
        return finufft.nufft2d1(fx, fy, field.ravel(), shape, eps=eps, isign=sign)
    result = np.zeros(shape, dtype=np.complex128)
    for part, rows, columns in _waves(shape, fx, fy, sign):
        result += (rows * field.ravel()[part, None]).T @ columns
    return result


def _counts(name, value):
    _validate.listed(name, value, "a sequence of integers")
    return tuple(_validate.whole(name, count) for count in value)


def _checked(field, fx, fy, sign, eps, modes: bool = True):
    _validate.real("eps", eps, positive=True)
    field = _validate.array("field", field)
    if sign not in (1, -1):
        raise ValueError(f"sign must be 1 or -1, got {sign!r}")
    field = np.ascontiguousarray(field, dtype=np.complex128)
    if modes:
        _validate.shaped("field", field, "[rows, columns], not empty")
    fx, fy = (
        np.ascontiguousarray(_validate.real(name, _validate.array(name, value)), dtype=np.float64).ravel()
        for name, value in (("fx", fx), ("fy", fy))
    )
    if fx.size != fy.size:
        raise ValueError(f"fx and fy must have the same size, got {fx.size} and {fy.size}")
    return field, fx, fy


def _finufft(terms: int):
    """Return the finufft package, None where it is missing and the sum is short enough to be written out."""
    try:
        import finufft
    except ImportError as error:
        if terms > _LARGEST_SUM:
            raise ImportError(
                f"A non-uniform transform of {terms:.1e} terms needs the optional package finufft: pip install finufft"
            ) from error
        return None
    return finufft


def _waves(shape, fx, fy, sign):
    """Yield blocks of points with exp(±ik·fx) ``[j, H]`` and exp(±il·fy) ``[j, W]``."""
    k, l = (np.arange(n) - n // 2 for n in shape)  # noqa: E741
    step = max(1, _BLOCK // max(shape))
    for start in range(0, fx.size, step):
        part = slice(start, start + step)
        yield part, np.exp(sign * 1j * fx[part, None] * k), np.exp(sign * 1j * fy[part, None] * l)


def convert_to_torch(a: np.ndarray, grad: bool = True) -> "torch.Tensor":
    """Copy an array into a tensor.

    Parameters
    ----------
    a : numpy.ndarray
        Array.
    grad : bool
        Whether autograd follows the tensor.

    Returns
    -------
    torch.Tensor
        Tensor of the same dtype that shares no memory with `a`.

    Raises
    ------
    TypeError
        If a gradient is asked for and the array holds integers.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.tools import convert_to_torch
    >>> convert_to_torch(np.asarray([1.0, 2.0])).requires_grad
    True
    """
    import torch

    grad = _validate.flag("grad", grad)
    tensor = a.detach().clone() if isinstance(a, torch.Tensor) else torch.from_numpy(np.array(_validate.array("a", a)))
    if grad and not (tensor.is_floating_point() or tensor.is_complex()):
        raise TypeError(f"a must have a floating-point dtype to have a gradient, got {tensor.dtype}; pass grad=False")
    return tensor.requires_grad_(grad)


def convert_to_numpy(a: "torch.Tensor") -> np.ndarray:
    """Return a tensor as an array on the CPU, detached.

    Parameters
    ----------
    a : torch.Tensor
        Tensor on any device.

    Returns
    -------
    numpy.ndarray
        Array of the same dtype, which shares its memory with a tensor on the CPU; float32 of bfloat16, which NumPy
        lacks.

    Examples
    --------
    >>> import torch
    >>> from odak.tools import convert_to_numpy
    >>> convert_to_numpy(torch.ones(2, requires_grad=True)).tolist()
    [1.0, 1.0]
    """
    if not _array.is_torch(a):
        raise TypeError(f"a must be a tensor, got {type(a).__name__}")
    return _array.on_host(a)
