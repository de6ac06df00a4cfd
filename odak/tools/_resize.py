"""Resizing by areas: each new pixel is the mean of what it covers."""

import numpy as np

from odak import _validate


def resize_image(img: np.ndarray, target_size: tuple[int, int]) -> np.ndarray:
    """Resize an image; a smaller axis averages the pixels that each new one covers, a larger one interpolates.

    Parameters
    ----------
    img : numpy.ndarray
        ``[H, W]`` or ``[H, W, C]``.
    target_size : sequence of int
        Width and height, in that order.

    Returns
    -------
    numpy.ndarray
        ``[height, width]`` or ``[height, width, C]`` of the same dtype; integers are rounded.

    Raises
    ------
    TypeError
        If the image holds no numbers or the size no integers.
    ValueError
        If the image does not have two or three axes, or the size is not two positive integers.
    """
    img = np.asarray(img)
    if img.dtype.kind not in "buifc":
        raise TypeError(f"img must hold numbers, got {img.dtype}")
    if img.ndim not in (2, 3) or 0 in img.shape:
        raise ValueError(f"img must be [H, W] or [H, W, C], none empty; got {img.shape}")
    if np.shape(target_size) != (2,):
        raise ValueError(f"target_size must be [width, height], got {target_size!r}")
    width, height = (
        _validate.side(name, _validate.integer(name, count, minimum=1))
        for name, count in zip(("target_size[0] (width)", "target_size[1] (height)"), target_size, strict=True)
    )
    result = img.astype(np.result_type(img, np.float64))
    for axis, size in sorted(((0, height), (1, width)), key=lambda pair: pair[1] / img.shape[pair[0]]):
        if size != img.shape[axis]:
            result = _resample(result, axis, *_taps(img.shape[axis], size))
    return np.rint(result).astype(img.dtype) if img.dtype.kind in "bui" else result.astype(img.dtype)


def _taps(source, target):
    """Return which samples each new one is made of, and their weights, both ``[target, taps]``."""
    step = source / target
    first = np.arange(target)[:, None]
    if step < 1:
        centre = (first + 0.5) * step - 0.5
        index = np.floor(centre) + np.arange(2)
        weight = 1 - np.abs(index - centre)
    else:
        start, end = first * step, (first + 1) * step
        index = np.floor(start) + np.arange(int(np.ceil(step)) + 1)
        weight = np.clip(np.minimum(index + 1, end) - np.maximum(index, start), 0, None) / step
    return np.clip(index, 0, source - 1).astype(np.intp), weight


def _resample(image, axis, index, weight):
    along = [1] * image.ndim
    along[axis] = -1
    return sum(image.take(i, axis) * w.reshape(along) for i, w in zip(index.T, weight.T, strict=True))
