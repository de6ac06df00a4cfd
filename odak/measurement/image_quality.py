"""Line spread and modulation transfer functions of lines across an edge of an image."""

import math
from collections.abc import Sequence

import numpy as np

from odak import _array, _validate
from odak._array import Array, ArrayT


def line_spread_function(line: ArrayT) -> ArrayT:
    """Return the line spread function of an edge: its derivative per sample, by central differences.

    Parameters
    ----------
    line : array
        Values across the edge, ``[n]``, at least two.

    Returns
    -------
    array
        ``[n]``; one-sided differences at both ends. Differentiable in torch.

    Examples
    --------
    >>> from odak.measurement import line_spread_function
    >>> line_spread_function([0, 0, 0.2, 0.9, 1, 1, 1]).round(12) + 0
    array([0.  , 0.1 , 0.45, 0.4 , 0.05, 0.  , 0.  ])
    """
    line = _line("line", line)
    xp = _array.namespace(line)
    return xp.concat((line[1:2] - line[:1], (line[2:] - line[:-2]) / 2, line[-1:] - line[-2:-1]))


def fourier_transform_1d(line: ArrayT) -> ArrayT:
    """Return the spectrum of a line spread function, 1 at frequency zero.

    Parameters
    ----------
    line : array
        ``[n]``, real, with an area that is not zero.

    Returns
    -------
    array
        Complex ``[n // 2]``: the first half of the discrete Fourier transform over its zeroth element; its magnitude
        is the modulation transfer function. Zeros for a line without area.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.measurement import fourier_transform_1d
    >>> abs(fourier_transform_1d(np.asarray([0.0, 2.0, 0.0, 0.0]))).tolist()
    [1.0, 1.0]
    """
    line = _line("line", line)
    xp = _array.namespace(line)
    spectrum = xp.fft.fft(xp.astype(line, _array.complex_dtype(line)))
    flat = spectrum[:1] == 0
    spectrum = xp.where(flat, xp.zeros_like(spectrum), spectrum) / xp.where(
        flat, xp.ones_like(spectrum[:1]), spectrum[:1]
    )
    return spectrum[: line.shape[0] // 2]


def polynomial_fit(line_x: Array, line_y: Array, fit_degree: int = 3) -> np.poly1d:
    """Return the polynomial nearest to points in the sense of least squares.

    Parameters
    ----------
    line_x : array
        Abscissae, ``[n]``, n > fit_degree.
    line_y : array
        Ordinates, ``[n]``.
    fit_degree : int
        Degree.

    Returns
    -------
    numpy.poly1d
        Call it with x to evaluate it.

    Raises
    ------
    ValueError
        If there are too few points or not as many y as x.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.measurement import polynomial_fit
    >>> x = np.linspace(-1, 1, 9)
    >>> abs(polynomial_fit(x, 2 * x**2 + 1, fit_degree=2).coefficients).round(9).tolist()
    [2.0, 0.0, 1.0]
    """
    degree = _validate.integer("fit_degree", fit_degree)
    x, y = (np.asarray(_validate.array(n, v)) for n, v in (("line_x", line_x), ("line_y", line_y)))
    x = np.asarray(_validate.real("line_x", x), dtype=np.float64)
    if x.ndim != 1 or x.shape != y.shape or len(x) <= degree:
        raise ValueError(f"line_x and line_y must be [n] with n > {degree}, got {x.shape} and {y.shape}")
    return np.poly1d(np.polyfit(x, y.astype(np.result_type(y, np.float64)), degree))


def roi(
    image: Array, location: Sequence[int] = (0, 100, 0, 100), threshold: Sequence[float] = (0, 1, 0, 1)
) -> tuple[Array, Array, Array]:
    """Cut a region from a picture and return the two lines through its middle, scaled to 0 … 1.

    Parameters
    ----------
    image : array
        ``[rows, columns]`` or ``[rows, columns, colours]``; colours are summed.
    location : sequence of int
        First row, end row, first column, end column of the region.
    threshold : sequence of float
        Below the first, `line_x` is 0; above the second it is 1. The other two do the same for `line_y`.

    Returns
    -------
    line_x : array
        The middle column, running down the region.
    line_y : array
        The middle row.
    image : array
        The region, ``[rows, columns]``.

    Raises
    ------
    ValueError
        If the region is empty or not inside the picture.

    Notes
    -----
    A flat line comes back as zeros.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.measurement import roi
    >>> image = np.outer(np.ones(8), np.arange(8.0))
    >>> line_x, line_y, region = roi(image, [0, 8, 0, 8])
    >>> region.shape, float(line_y.min()), float(line_y.max())
    ((8, 8), 0.0, 1.0)
    """
    image = _validate.array("image", image)
    if image.ndim not in (2, 3):
        raise ValueError(f"image must be [rows, columns] or [rows, columns, colours], got {tuple(image.shape)}")
    edges = _validate.several("location", location, 4)
    top, bottom, left, right = (_validate.whole("location", edge, minimum=-math.inf) for edge in edges)
    if not (0 <= top < bottom <= image.shape[0] and 0 <= left < right <= image.shape[1]):
        raise ValueError(
            f"location must be a region inside {image.shape[0]} x {image.shape[1]} pixels of image, got {location!r}"
        )
    low_x, high_x, low_y, high_y = _validate.several("threshold", threshold, 4)
    xp = _array.namespace(image)
    region = xp.astype(image[top:bottom, left:right, ...], _array.real_dtype(image))
    if region.ndim == 3:
        region = xp.sum(region, axis=2)
    line_x = _scaled(region[:, region.shape[1] // 2], low_x, high_x)
    line_y = _scaled(region[region.shape[0] // 2, :], low_y, high_y)
    return line_x, line_y, region


def modulation_transfer_function(line_x: Array, line_y: Array, px_size: Sequence[float]) -> tuple[list, list]:
    """Return the modulation transfer functions of two lines across an edge.

    Parameters
    ----------
    line_x : array
        Values across an edge, ``[n]``, such as the first line of :func:`roi`.
    line_y : array
        Values across another edge, ``[n]``.
    px_size : sequence of float
        Size of a pixel along the two lines, e.g. in degrees.

    Returns
    -------
    mtf : list of array
        Magnitudes ``[n // 2]`` of the transforms of the two line spread functions, 1 at zero.
    frequencies : list of array
        k/(n·px_size), in cycles per unit of `px_size`.

    Notes
    -----
    P. D. Burns, Slanted-edge MTF for digital camera and scanner analysis, PICS 2000. Simple and without sub-pixel
    sampling; :func:`odak.measurement.slanted_edge_mtf` has both.

    Examples
    --------
    The difference of neighbours spreads a step over two samples, of which the modulation is cos(π·f·px_size):

    >>> import numpy as np
    >>> from odak.measurement import modulation_transfer_function
    >>> step = np.repeat([0.0, 1.0], 8)
    >>> mtf, frequencies = modulation_transfer_function(step, step, [0.1, 0.1])
    >>> bool(np.allclose(mtf[0], np.cos(np.pi * frequencies[0] * 0.1)))
    True
    """
    sizes = _validate.several("px_size", px_size, 2, positive=True)
    mtf, frequencies = [], []
    for name, line, size in zip(("line_x", "line_y"), (line_x, line_y), sizes, strict=True):
        line = _line(name, line)
        xp = _array.namespace(line)
        mtf.append(xp.abs(fourier_transform_1d(line_spread_function(line))))
        count = line.shape[0]
        steps = xp.arange(count // 2, dtype=line.dtype, device=_array.device_of(line))
        frequencies.append(steps / (count * _array.cast(size, line)))
    return mtf, frequencies


def _line(name: str, line):
    (line,) = _validate.reals(**{name: line})
    if _validate.shaped(name, line, "n").shape[0] < 2:
        raise ValueError(f"{name} must contain at least two values, got {line.shape[0]}")
    return line


def _scaled(line, low, high):
    xp = _array.namespace(line)
    line = line - xp.min(line)
    peak = xp.max(line)
    line = line / xp.where(peak > 0, peak, xp.ones_like(peak))
    line = xp.where(line < low, xp.zeros_like(line), line)
    return xp.where(line > high, xp.ones_like(line), line)
