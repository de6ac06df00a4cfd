"""Line spread and modulation transfer from edges in an image: single lines, and slanted edges after ISO 12233."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array, ArrayT

_WINDOWS = ("hamming", "tukey")


@dataclass(frozen=True)
class SlantedEdge:
    """Spatial frequency response of a camera, measured at a slanted edge.

    Attributes
    ----------
    frequency : array
        Spatial frequencies along the edge's normal, cycles per unit of the pixel pitch, from 0 up to one per pitch.
    mtf : array
        Modulation transfer, 1 at zero; in the picture's library.
    angle : float
        Degrees between the edge and the columns (or the rows, whichever is nearer), with sign.
    position : array
        Distance from the edge of the samples below, in units of the pixel pitch.
    edge_spread : array
        Edge spread function, oversampled.
    line_spread : array
        Derivative of the edge spread function per bin, before the window.
    """

    frequency: object
    mtf: object
    angle: float
    position: object
    edge_spread: object
    line_spread: object

    def frequency_at(self, level: float = 0.5) -> float:
        """Return the lowest frequency at which the modulation has fallen to `level`, e.g. MTF50; NaN if it does not."""
        frequency, mtf = (_array.on_host(value) for value in (self.frequency, self.mtf))
        below = np.flatnonzero(mtf <= level)
        if not below.size or below[0] == 0:
            return float("nan")
        i = below[0]
        share = (mtf[i - 1] - level) / (mtf[i - 1] - mtf[i])
        return float(frequency[i - 1] + share * (frequency[i] - frequency[i - 1]))


def slanted_edge_mtf(
    image: Array,
    pixel_pitch: float = 1.0,
    oversampling: int = 4,
    window: str = "hamming",
    edge_degree: int = 1,
    correct_bins: bool = True,
) -> SlantedEdge:
    """Return the modulation transfer function measured on the picture of one straight, slanted edge.

    Parameters
    ----------
    image : array
        ``[rows, columns]``, linear in intensity, with one edge between a dark and a bright side that crosses all
        rows or all columns, at any angle, best at about 5° to them; noise is allowed.
    pixel_pitch : float
        Distance between pixels, which are square; frequencies are in cycles per its unit.
    oversampling : int
        Bins per pixel, fewer where the pixels do not lie as densely along the normal: 1.4 at 45°.
    window : str
        Window on the line spread function: "hamming" (ISO 12233:2014) or "tukey" (as in the edition of 2023).
    edge_degree : int
        Degree of the curve through the edge: 1, or more for a lens that distorts.
    correct_bins : bool
        Take out what the bins do, which the standard leaves in: divide by the sinc of their width (2.6 % at the
        Nyquist frequency), and allow for pixels that do not fall evenly into them (1.5 % at 5°).

    Returns
    -------
    SlantedEdge
        Frequencies, modulation, angle, edge and line spread. The modulation is differentiable in a torch picture, with
        the edge's place held.

    Raises
    ------
    ValueError
        If the picture is not two-dimensional, or no edge is found, or the edge is not slanted: it has to shift by a
        pixel at least over the picture to sample below the pixel.

    Notes
    -----
    ISO 12233:2017 annex D; P. D. Burns, PICS 2000. Centroids of the windowed derivative along each row, a second time
    around the first fit; a curve through them; pixels averaged by distance from the edge along its normal; the
    derivative, windowed; its Fourier transform, divided by the transfer of the difference filter. Rows that do not
    make up a whole number of pixel shifts are left out.

    Examples
    --------
    The transfer function of an edge sharper than a pixel is the sinc of the pixel, 0.64 at the Nyquist frequency:

    >>> import numpy as np
    >>> from odak.measurement import slanted_edge_mtf
    >>> y, x = np.mgrid[0:128, 0:128]
    >>> edge = np.clip((x - 60) * np.cos(0.1) - y * np.sin(0.1) + 0.5, 0, 1)
    >>> found = slanted_edge_mtf(edge)
    >>> nyquist = float(np.interp(0.5, found.frequency, found.mtf))
    >>> 0.6 < nyquist < 0.7
    True
    """
    image = _validate.image("image", image)
    if image.ndim != 2 or "complex" in str(image.dtype):
        raise ValueError(f"image must be real, [rows, columns]; got {image.dtype} {tuple(image.shape)}")
    _validate.number("pixel_pitch", pixel_pitch, positive=True)
    factor = _validate.integer("oversampling", oversampling, minimum=2)
    window = _validate.one_of("window", window, _WINDOWS)
    degree = _validate.integer("edge_degree", edge_degree, minimum=1)
    correct_bins = _validate.flag("correct_bins", correct_bins)
    xp = _array.namespace(image)
    image = xp.astype(image, _array.real_dtype(image), copy=False)
    still = _array.on_host(image).astype(np.float64)
    if not np.isfinite(still).all():
        raise ValueError("image must be finite everywhere")
    if _runs_along_rows(still):
        image, still = xp.matrix_transpose(image), still.T
    edge = _edge_curve(still, degree)
    rows = _whole_shifts(edge)
    distance, angle = _distances(still.shape[1], edge[:rows])
    edge_spread, position, step, width = _average(image[:rows, :], distance, angle, factor, correct_bins)
    bins = step, width if correct_bins else 0.0
    return _transform(edge_spread, _derivative(edge_spread), position, angle, pixel_pitch, bins, window)


def _runs_along_rows(still) -> bool:
    down, across = (np.abs(np.diff(still.mean(axis=axis))).max(initial=0) for axis in (1, 0))
    return down > across


def _edge_curve(still, degree: int):
    """Return the column of the edge in each row, by two rounds of windowed centroids and a polynomial fit."""
    gradients = np.diff(still, axis=1)
    total = gradients.sum()
    spread = np.abs(gradients).sum()
    if min(still.shape) < 8 or not abs(total) > 0.02 * spread:
        raise ValueError(f"image must show one edge from dark to bright in at least 8 x 8 pixels, got {still.shape}")
    gradients = gradients if total > 0 else -gradients
    columns = np.arange(gradients.shape[1]) + 0.5
    rows = np.arange(len(gradients))
    # The first round looks everywhere, the next ones within a window around the curve found before.
    centre, half = np.full(len(gradients), columns.mean()), gradients.shape[1] / 2
    for _ in range(4):
        away = (columns - centre[:, None]) / half
        weight = gradients * np.where(np.abs(away) <= 1, 0.54 + 0.46 * np.cos(np.pi * away), 0)
        area = weight.sum(axis=1)
        found = area > 0.1 * area.max()
        # A window that the picture's border cuts moves its centroid inwards.
        whole = found & (centre - half > -1) & (centre + half < gradients.shape[1] + 1)
        found = whole if whole.sum() >= max(8, 2 * (degree + 1)) else found
        if found.sum() <= degree + 1:
            raise ValueError("image must show an edge in every row; none was found in most rows")
        place = (weight[found] @ columns) / area[found]
        centre = np.polynomial.Polynomial.fit(rows[found], place, degree)(rows)
        half = max(min(half, _reach(gradients, columns, centre)), 4.0)
    return centre


def _reach(gradients, columns, centre) -> float:
    """Half width that holds the edge's own blur several times over, and less of the noise beyond it."""
    mean = np.zeros(len(columns))
    shift = np.round(centre - centre.mean()).astype(int)
    index = np.clip(np.arange(len(columns)) + shift[:, None], 0, len(columns) - 1)
    mean = np.take_along_axis(gradients, index, axis=1).mean(axis=0)
    wide = np.flatnonzero(mean > 0.1 * mean.max())
    return 3.0 * (wide[-1] - wide[0] + 1)


def _whole_shifts(edge) -> int:
    """Return how many rows make a whole number of one-pixel shifts of the edge."""
    shift = abs(edge[-1] - edge[0]) * len(edge) / (len(edge) - 1)
    if shift < 1 - 1e-6:
        raise ValueError(
            f"image must show an edge that shifts by a pixel or more over its length, got {shift:.3g} pixels: tilt it"
        )
    return max(2, round(len(edge) * np.floor(shift + 1e-6) / shift))


def _distances(columns: int, edge):
    """Return each pixel's distance from the edge along its normal, in pixels, and the edge's mean angle in degrees."""
    slope = np.gradient(edge)
    along = np.arange(columns) - edge[:, None]
    angle = np.degrees(np.arctan((edge[-1] - edge[0]) / (len(edge) - 1)))
    return along / np.sqrt(1 + slope[:, None] ** 2), float(angle)


def _average(image, distance, angle: float, factor: int, recentre: bool):
    """Return the mean of the pixels in bins around the edge, the bins' centres and the width of what they average.

    Bins are 1/factor pixel wide. Near a slope p/q of small numbers, as at 45°, pixels lie on lines along the edge,
    1/√(p² + q²) pixel apart: bins are then as wide as that, and centred on the lines.
    """
    xp, device = _array.namespace(image), _array.device_of(image)
    flat = distance.reshape(-1)
    order = np.argsort(flat, kind="stable")
    ordered = flat[order]
    reach, step, offset = _full_reach(ordered), 1 / factor, 0.0
    gaps = np.diff(ordered)
    # Lines far from the edge are short, and leave gaps first.
    even = min(reach, np.abs(ordered[:-1][gaps > step]).min(initial=reach))
    reach = even if even > max(reach / 2, 10) else reach
    gap = gaps[np.abs(ordered[:-1]) < reach].max()
    if gap > step:
        slope = abs(math.tan(math.radians(angle)))
        numbers = ((p, q) for q in range(1, factor + 1) for p in range(q + 1) if math.hypot(p, q) < factor)
        p, q = min(numbers, key=lambda pair: abs(slope - pair[0] / pair[1]))
        step = max(gap * (1 + 1e-9), 1 / math.hypot(p, q))
        offset = float(np.angle(np.exp(2j * np.pi * ordered / step).sum())) / (2 * np.pi) * step
    # An even number of bins with the edge at bin n // 2.
    half = int(np.floor((reach - abs(offset)) / step)) - 1
    if half * step < 4:
        raise ValueError(f"image must show at least 5 pixels on either side of the edge, got {reach:.1f}")
    limits = offset + (np.arange(-half, half + 1) - 0.5) * step
    edges = np.searchsorted(ordered, limits)
    count = np.maximum(np.diff(edges), 1)
    values = xp.take(xp.reshape(image, (-1,)), xp.asarray(order, device=device), axis=0)
    # Differences of a running sum in double precision: no loop over bins, and gradients pass.
    running = xp.cumulative_sum(xp.astype(values, xp.float64), include_initial=True)
    at = xp.take(running, xp.asarray(edges, device=device), axis=0)
    mean = (at[1:] - at[:-1]) / xp.asarray(count.astype(np.float64), device=device)
    position = (limits[:-1] + limits[1:]) / 2
    place, square = (np.diff(np.concatenate(([0.0], np.cumsum(ordered**power)))[edges]) / count for power in (1, 2))
    if recentre:
        # Pixels do not fall evenly into a bin: move each mean from where they lie to the bin's centre.
        mean = mean + _derivative(mean) * xp.asarray((position - place) / step, device=device)
    # The width of even bins of the same variance, at the edge.
    near = np.abs(position) <= 2
    return mean, position, step, float(np.sqrt(12 * np.maximum(square - place**2, 0)[near].mean()))


def _full_reach(ordered) -> float:
    """Return the distance up to which lines along the edge hold a third of the pixels that those at the edge hold."""
    far = int(np.abs(ordered).max()) + 2
    count = np.diff(np.searchsorted(ordered, np.arange(-far, far + 1)))
    enough = 3 * count >= count[far - 2 : far + 2].mean()
    return float(min(np.append(side, False).argmin() for side in (enough[far:], enough[:far][::-1])))


def _derivative(edge_spread):
    xp = _array.namespace(edge_spread)
    inner = (edge_spread[2:] - edge_spread[:-2]) / 2
    return xp.concat((inner[:1], inner, inner[-1:]))


def _transform(edge_spread, line_spread, position, angle, pitch, bins, window) -> SlantedEdge:
    xp, device = _array.namespace(line_spread), _array.device_of(line_spread)
    count = len(position)
    weight = _window(count, window)
    spectrum = xp.abs(xp.fft.rfft(line_spread * xp.asarray(weight, device=device)))
    # Cycles per pixel; beyond one per pixel there is nothing but noise.
    step, width = bins
    cycles = np.arange(count // 2 + 1) / (count * step)
    kept = cycles <= 1
    filters = np.sinc(2 * cycles[kept] * step) * np.sinc(cycles[kept] * width)
    # With 4 bins per pixel and more the filters stay above 0.5; the standard's limit of 10 applies to the coarser ones.
    gain = xp.asarray(np.minimum(1 / np.maximum(filters, 0.1), 10.0), device=device)
    mtf = spectrum[: int(kept.sum())] / spectrum[0] * gain
    frequency, place = (xp.asarray(values, device=device) for values in (cycles[kept] / pitch, position * pitch))
    return SlantedEdge(frequency, mtf, angle, place, edge_spread, line_spread)


def _window(count: int, window: str):
    """Return the window over a line spread of `count` bins with the edge at bin count // 2."""
    away = np.abs(np.arange(count) - count // 2) / (count / 2)
    if window == "hamming":
        return 0.54 + 0.46 * np.cos(np.pi * away)
    # Flat over the inner half, cosine tapers outside (J. W. Tukey 1967, with a taper of one half).
    return np.where(away <= 0.5, 1.0, 0.5 + 0.5 * np.cos(2 * np.pi * (away - 0.5)))


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
    line_x, line_y = _validate.constants(line_x=line_x, line_y=line_y)
    x, y = (_array.on_host(_validate.array(n, v)) for n, v in (("line_x", line_x), ("line_y", line_y)))
    x = np.asarray(_validate.real("line_x", x), dtype=np.float64)
    if x.ndim != 1 or x.shape != y.shape or len(x) <= degree:
        raise ValueError(f"line_x and line_y must be [n] with n > {degree}, got {x.shape} and {y.shape}")
    _validate.check_values("line_y", y)
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
    _validate.shaped("image", image, "[rows, columns] or [rows, columns, colours]")
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


def modulation_transfer_function(line_x: Array, line_y: Array, px_size: Sequence[float]) -> tuple[list[Any], list[Any]]:
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
    return _validate.shaped(name, line, "[2 or more]")


def _scaled(line, low, high):
    xp = _array.namespace(line)
    line = line - xp.min(line)
    peak = xp.max(line)
    line = line / xp.where(peak > 0, peak, xp.ones_like(peak))
    line = xp.where(line < low, xp.zeros_like(line), line)
    return xp.where(line > high, xp.ones_like(line), line)
