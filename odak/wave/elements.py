"""Thin elements: lenses, prisms, axicons, gratings, zone plates, apertures and wavefront aberrations."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array, Device, is_array, namespace, phasor, phasor_of_cycles
from odak._warnings import SamplingWarning, warn
from odak.tools.zernike import check_mode, jacobi, zernike_norm
from odak.wave.sampling import FOCAL, Weaker, plain_numbers, sampled_axes, warn_beyond_nyquist, warn_of_tilt
from odak.wave.transfer_functions import pitches


@_validate.takes_units("focal", "dx", "wavelength", "offset")
def lens_phase(
    shape: Sequence[int],
    focal: float | Array,
    dx: float | Sequence[float],
    wavelength: float | Array,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the phase of a thin lens, −π·r²/(λf), on the field's own grid (optical axis at index n // 2).

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    focal : float or array
        Focal length in metres; positive converges.
    dx : float or sequence of float
        Pixel pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Wavelength in metres.
    offset : sequence of float
        Position of the lens's axis (rows, columns) in metres.
    xp : module, optional
        Array namespace of the result; by default the library of the focal length or the wavelength, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 phase in radians, not wrapped.

    Warns
    -----
    SamplingWarning
        If neighbouring samples of the phase differ by more than half a cycle.

    Examples
    --------
    The phase at a distance r from the axis is −π·r²/(λf):

    >>> from odak.wave import lens_phase
    >>> phase = lens_phase((1, 65), 0.1, 1e-5, 500e-9)
    >>> round(float(phase[0, 52]) / (-3.14159265 * 2e-4**2 / (500e-9 * 0.1)), 6)
    1.0
    """
    _validate.number("focal", _validate.real("focal", focal, nonzero=True))
    _validate.number("wavelength", wavelength, positive=True)
    numbers = {"focal": focal, "wavelength": wavelength}
    return _sampled("lens_phase", thin_lens, shape, dx, offset, _LONGER, numbers, xp, device)


def thin_lens(y: Any, x: Any, focal: float | Array, wavelength: float | Array) -> Any:
    """Return the phase of a thin lens at points."""
    return -math.pi * (y**2 + x**2) / (wavelength * focal)


_LONGER = Weaker(0, 1, FOCAL)


def _sampled(name, formula, shape, dx, offset, weaker, numbers, xp, device):
    """Return the phase of an element on a grid, by a formula of the positions and of its numbers, after its check."""
    xp, device, values = single_numbers(xp, device, **numbers)
    steps, (y, x) = grid_positions(shape, dx, offset, xp, device)
    plain = plain_numbers(*steps, *offset, *numbers.values())
    if plain is not None:
        axes = sampled_axes((y.shape[0], x.shape[1]), plain[:2], plain[2:4])
        warn_beyond_nyquist(name, formula, axes, plain[4:], weaker)
    return formula(y, x, *values)


def squared_radius(
    nx: int,
    ny: int,
    dx: float | Sequence[float],
    offset: Sequence[float] = (0, 0),
    xp: ModuleType | None = None,
) -> Array:
    """Return r² on the grid of the older lens functions, ``[nx, ny]``: linspace(−n·dx/2, n·dx/2, n) along each axis.

    Its step is n·dx/(n − 1) and its centre lies at the index (n − 1)/2. :func:`grid_positions` has the grid of a field.
    """
    offset = _validate.several("offset", offset, 2)
    xp = _validate.library("xp", xp)
    along_x, along_y = (
        _older_positions(n, step, xp) - shift * step
        for n, step, shift in zip((nx, ny), pitches(dx), reversed(offset), strict=True)
    )
    return along_x[:, None] ** 2 + along_y[None, :] ** 2


def _older_positions(count: int, pitch, xp):
    """Return linspace(−n·dx/2, n·dx/2, n) along one axis."""
    width = count * _validate.real("dx", pitch, positive=True)
    return xp.linspace(-0.5, 0.5, count, dtype=xp.float64) * width


@_validate.takes_units("focal", "dx")
def quadratic_phase_function(
    nx: int,
    ny: int,
    k: float,
    focal: float = 0.4,
    dx: float | Sequence[float] = 0.001,
    offset: Sequence[float] = (0, 0),
    *,
    xp: ModuleType | None = None,
) -> Array:
    """Return the transmission of a thin lens, exp(−ik·r²/(2f)), converging for a positive focal length.

    Parameters
    ----------
    nx : int
        Columns.
    ny : int
        Rows.
    k : float
        Wave number in rad/m.
    focal : float
        Focal length in metres.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns), on the grid described in the notes.
    offset : sequence of float
        Shift of the lens in pixels: `offset[1]` along x, `offset[0]` along y.
    xp : module, optional
        Array namespace of the result, NumPy by default.

    Returns
    -------
    array
        complex128 ``[ny, nx]``.

    Warns
    -----
    SamplingWarning
        If neighbouring samples of the phase differ by more than half a cycle.

    Notes
    -----
    Along each axis of n samples the positions are as in earlier releases, linspace(−n·dx/2, n·dx/2, n): the step is
    n·dx/(n − 1) and the axis of the lens lies at the index (n − 1)/2. Applied to a field of pitch `dx`, whose axis is
    at the index n // 2, the element is thus a lens of the focal length f·((n − 1)/n)², half a pixel before the axis
    where n is even. ``exp(1j * lens_phase(shape, focal, dx, wavelength))`` is the lens on the grid of a field, centred.

    Earlier releases returned exp(i·k·½·sin(r²/f)), the same lens with the opposite sign for small r²/f.

    Examples
    --------
    The phase is −k·r²/(2f), here at a corner at r² = 2·(2·1e-4)²:

    >>> import numpy as np
    >>> from odak.wave import quadratic_phase_function, wavenumber
    >>> lens = quadratic_phase_function(5, 5, wavenumber(1e-6), focal=1.0, dx=8e-5)
    >>> round(float(np.angle(lens[0, 0])), 6), round(float(-wavenumber(1e-6) * 8e-8 / 2), 6)
    (-0.251327, -0.251327)
    """
    nx, ny = _validate.size("nx, ny", (nx, ny))
    _validate.number("k", k)
    _validate.number("focal", _validate.real("focal", focal, nonzero=True))
    steps = pitches(dx)[::-1]
    squared = squared_radius(nx, ny, steps, offset, xp)
    _warn_of_bend("quadratic_phase_function", (nx, ny), steps, k / 2, focal, FOCAL, offset)
    return phasor(-k * squared / (2 * focal)).T


def _bend(y, x, k, focal):
    return k * (y**2 + x**2) / focal


def _warn_of_bend(name, shape, steps, half, distance, text, offset=(0, 0)):
    numbers = plain_numbers(*steps, *reversed(offset), half, distance)
    if numbers is not None:
        axes = []
        for n, step, shift in zip(shape, numbers[:2], numbers[2:4], strict=True):
            own = n * step / max(n - 1, 1)
            reach = (n * step - own) / 2
            axes.append((-reach - shift * step, reach - shift * step, own if n > 1 else 0.0))
        warn_beyond_nyquist(name, _bend, tuple(axes), numbers[4:], Weaker(1, 1, text))


@_validate.takes_units("dx")
def double_convergence(
    nx: int, ny: int, k: float, r: float, dx: float | Sequence[float], *, xp: ModuleType | None = None
) -> Array:
    """Return the phase factor exp(ik·r²/R) of a doubly converging beam (Engström et al., Opt. Express 15, 2007).

    Parameters
    ----------
    nx : int
        Rows.
    ny : int
        Columns.
    k : float
        Wave number in rad/m.
    r : float
        Distance R in metres.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns), on the grid described in the notes.
    xp : module, optional
        Array namespace of the result, NumPy by default.

    Returns
    -------
    array
        complex128 ``[nx, ny]``.

    Warns
    -----
    SamplingWarning
        If neighbouring samples of the phase differ by more than half a cycle.

    Notes
    -----
    Along each axis of n samples the positions are linspace(−n·dx/2, n·dx/2, n): the step is n·dx/(n − 1) and r = 0 lies
    at the index (n − 1)/2, half a pixel before the axis of a field where n is even. On the grid of a field the same
    factor is ``exp(-2j * lens_phase(shape, r, dx, wavelength))``.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import double_convergence, wavenumber
    >>> beam = double_convergence(5, 5, wavenumber(1e-6), 1.0, 8e-5)
    >>> round(float(np.angle(beam[0, 0])), 4), round(float(wavenumber(1e-6)) * 8e-8, 4)
    (0.5027, 0.5027)
    """
    nx, ny = _validate.size("nx, ny", (nx, ny))
    _validate.number("k", k)
    _validate.number("r", _validate.real("r", r, nonzero=True))
    squared = squared_radius(nx, ny, dx, xp=xp)
    _warn_of_bend("double_convergence", (nx, ny), pitches(dx), k, r, "a distance r of at least {:.3g} m")
    return phasor(k * squared / r)


@_validate.takes_units("dx", degrees=("angle",))
def prism_phase_function(
    nx: int,
    ny: int,
    k: float,
    angle: float,
    dx: float | Sequence[float] = 0.001,
    axis: str = "x",
    *,
    xp: ModuleType | None = None,
) -> Array:
    """Return the transmission of a thin prism, exp(−ik·sin(angle)·x).

    Parameters
    ----------
    nx : int
        Rows.
    ny : int
        Columns.
    k : float
        Wave number in rad/m.
    angle : float
        Tilt in degrees.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns), on the grid described in the notes.
    axis : str
        "x" (the phase runs from column to column) or "y" (from row to row).
    xp : module, optional
        Array namespace of the result, NumPy by default.

    Returns
    -------
    array
        complex128 ``[nx, ny]``.

    Warns
    -----
    SamplingWarning
        If neighbouring samples of the phase differ by more than half a cycle.

    Notes
    -----
    Along the axis, of n samples, the positions x are linspace(−n·dx/2, n·dx/2, n), in steps of n·dx/(n − 1): light that
    is sampled with the pitch `dx` leaves at the sine n/(n − 1)·sin(angle), and the phase vanishes at the index
    (n − 1)/2. :func:`prism_grating` has the exact steps, and counts from the first sample.

    Examples
    --------
    A tilt of 30° delays by half a cycle over one wavelength, which is the step of this grid:

    >>> import numpy as np
    >>> from odak.wave import prism_phase_function, wavenumber
    >>> prism = prism_phase_function(3, 3, wavenumber(1e-6), 30.0, dx=1e-6 * 2 / 3)
    >>> round(abs(float(np.angle(prism[0, 1] / prism[0, 0]))) / np.pi, 3)
    1.0
    """
    nx, ny = _validate.size("nx, ny", (nx, ny))
    _validate.number("k", k)
    axis, (rows, columns) = _validate.one_of("axis", axis, ("x", "y")), pitches(dx)
    xp = _validate.library("xp", xp)
    line = _older_positions(ny, columns, xp) if axis == "x" else _older_positions(nx, rows, xp)
    position = xp.broadcast_to(line[None, :] if axis == "x" else line[:, None], (nx, ny))
    sine, count, step = _of_degrees("angle", angle, math.sin), line.shape[0], columns if axis == "x" else rows
    warn_of_tilt("prism_phase_function", step * count / max(count - 1, 1), k, angle)
    return phasor(-k * sine * position)


@_validate.takes_units("dx", degrees=("angle",))
def prism_grating(
    nx: int,
    ny: int,
    k: float,
    angle: float,
    dx: float | Sequence[float] = 0.001,
    axis: str = "x",
    phase_offset: float = 0.0,
    *,
    xp: ModuleType | None = None,
) -> Array:
    """Return a blazed prism exp(−i(k·sin(angle)·x + offset)), counted from the first sample.

    Parameters
    ----------
    nx : int
        Rows.
    ny : int
        Columns.
    k : float
        Wave number in rad/m.
    angle : float
        Deflection in degrees.
    dx : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    axis : str
        "x" (the phase changes from row to row) or "y" (from column to column).
    phase_offset : float
        Constant phase in degrees.
    xp : module, optional
        Array namespace of the result, NumPy by default.

    Returns
    -------
    array
        complex128 ``[nx, ny]``.

    Warns
    -----
    SamplingWarning
        If neighbouring samples of the phase differ by more than half a cycle.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import prism_grating, wavenumber
    >>> prism = prism_grating(5, 1, wavenumber(1e-6), 30.0, dx=1e-6)
    >>> np.round(prism[:, 0].real, decimals=3).tolist()
    [1.0, -1.0, 1.0, -1.0, 1.0]
    """
    line, shape = _line_along(nx, ny, axis, _validate.library("xp", xp))
    xp = namespace(line)
    _validate.number("k", k)
    rows, columns = pitches(dx)
    pitch = _validate.real("dx", rows if line.shape[1] == 1 else columns, positive=True)
    _validate.number("phase_offset", phase_offset)
    sine = _of_degrees("angle", angle, math.sin)
    warn_of_tilt("prism_grating", pitch, k, angle)
    phase = k * sine * line * pitch + phase_offset * (math.pi / 180)
    return xp.broadcast_to(phasor(-phase), shape) + 0


def blazed_grating(nx: int, ny: int, levels: int = 2, axis: str = "x", *, xp: ModuleType | None = None) -> Array:
    """Return a blazed grating of a period of `levels` samples.

    Parameters
    ----------
    nx : int
        Rows.
    ny : int
        Columns.
    levels : int
        Samples of a period; below 2 is taken as 2.
    axis : str
        "x" (the phase changes from row to row) or "y" (from column to column).
    xp : module, optional
        Array namespace of the result, NumPy by default.

    Returns
    -------
    array
        complex128 ``[nx, ny]``: exp(i2π·(j mod levels)/levels), j falling from n to 1 along the axis.

    Examples
    --------
    All of the power goes to one order:

    >>> import numpy as np
    >>> from odak.wave import blazed_grating
    >>> orders = abs(np.fft.fft(blazed_grating(16, 1, levels=4)[:, 0])) / 16
    >>> np.round(orders, decimals=3).tolist().index(1.0)
    12
    """
    xp = _validate.library("xp", xp)
    levels = max(2, _validate.whole("levels", levels, minimum=-_validate.LONGEST_SIDE))
    line, shape = _line_along(nx, ny, axis, xp)
    falling = max(line.shape) - line
    return xp.broadcast_to(phasor_of_cycles((falling % levels) / levels), shape) + 0


def linear_grating(
    nx: int, ny: int, every: int = 2, add: float | None = 3.14, axis: str = "x", *, xp: ModuleType | None = None
) -> Array:
    """Return a binary grating, of lines or as a checkerboard.

    Parameters
    ----------
    nx : int
        Rows.
    ny : int
        Columns.
    every : int
        Period in samples.
    add : float or None
        Phase of the lines in radians; None means π.
    axis : str
        "x": rows 0, every, … hold exp(i·add) and the others 0; "y": the same for columns; "xy": a checkerboard of
        exp(i·add) and 1, without zeros.
    xp : module, optional
        Array namespace of the result, NumPy by default.

    Returns
    -------
    array
        complex64 ``[nx, ny]``.

    Raises
    ------
    ValueError
        If `axis` is none of the three.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import linear_grating
    >>> np.round(linear_grating(4, 1, every=2, add=np.pi)[:, 0].real, decimals=3).tolist()
    [-1.0, 0.0, -1.0, 0.0]
    """
    nx, ny = _validate.size("nx, ny", (nx, ny))
    every = _validate.integer("every", every, minimum=1)
    axis = _validate.one_of("axis", axis, ("x", "y", "xy"))
    xp = _validate.library("xp", xp)
    add = math.pi if add is None else _validate.real("add", add)
    rows, columns = xp.arange(nx)[:, None], xp.arange(ny)[None, :]
    if axis == "xy":
        turned = ((rows + columns) % every + 1) % 2
        return phasor(add * xp.astype(turned, xp.float64), xp.complex64)
    lit = xp.broadcast_to(rows if axis == "x" else columns, (nx, ny)) % every == 0
    phase = add * xp.ones((nx, ny), dtype=xp.float64)
    return xp.where(lit, phasor(phase, xp.complex64), xp.zeros((nx, ny), dtype=xp.complex64))


def _of_degrees(name, angle, function):
    """Return a trigonometric function of degrees, with the graph of a tensor."""
    angle = _validate.number(name, angle)
    if is_array(angle):
        return getattr(namespace(angle), function.__name__)(angle * (math.pi / 180))
    return function(math.radians(angle))


def _line_along(nx, ny, axis, xp):
    nx, ny = _validate.size("nx, ny", (nx, ny))
    if _validate.one_of("axis", axis, ("x", "y")) == "x":
        return xp.arange(nx, dtype=xp.float64)[:, None], (nx, ny)
    return xp.arange(ny, dtype=xp.float64)[None, :], (nx, ny)


@_validate.takes_units("dx", "radius", "offset", "inner_radius")
def circular_aperture(
    shape: Sequence[int],
    dx: float | Sequence[float],
    radius: float | Array,
    offset: Sequence[float] = (0.0, 0.0),
    inner_radius: float | Array = 0.0,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the transmission of a disc or a ring, with the pixels of its edges weighted by the area inside.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    radius : float or array
        Radius in metres; one number.
    offset : sequence of float
        Position of the centre (rows, columns) in metres.
    inner_radius : float or array
        Radius in metres of a central obscuration; 0 for none.
    xp : optional
        Array namespace; by default the library of the radius, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 ``[rows, columns]``: the part of each pixel's area that lies inside, exactly; differentiable in the
        radii.

    Examples
    --------
    >>> from odak.wave import circular_aperture
    >>> disc = circular_aperture((64, 64), 1.0, 20.0)
    >>> round(float(disc.sum()) / (3.14159265 * 20**2), 6)
    1.0
    """
    _validate.number("radius", radius, positive=True)
    _validate.number("inner_radius", inner_radius, least=0)
    plain = plain_numbers(radius, inner_radius)
    if plain is not None and plain[1] > plain[0]:
        raise ValueError(f"inner_radius must be at most the radius {plain[0]:g}, got {plain[1]:g}")
    xp, device, (radius, inner_radius) = single_numbers(xp, device, radius=radius, inner_radius=inner_radius)
    steps, (y, x) = grid_positions(shape, dx, offset, xp, device)
    ring = inner_radius > 0
    inner = share_in_disc(y, x, steps, xp.where(ring, inner_radius, xp.ones_like(inner_radius)))
    return share_in_disc(y, x, steps, radius) - inner * xp.astype(ring, xp.float64)


@_validate.takes_units("dx", "size", "offset")
def rectangular_aperture(
    shape: Sequence[int],
    dx: float | Sequence[float],
    size: Sequence[Any],
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the transmission of a rectangle, with the pixels of its edges weighted by the area inside.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    size : sequence of float or array
        Height and width in metres.
    offset : sequence of float
        Position of the centre (rows, columns) in metres.
    xp : optional
        Array namespace; by default the library of the size, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 ``[rows, columns]``: the part of each pixel's area that lies inside, exactly; differentiable in the
        size.

    Examples
    --------
    The sum of the transmission times the area of a pixel is the area of the rectangle:

    >>> from odak.wave import rectangular_aperture
    >>> slit = rectangular_aperture((32, 32), 8e-6, (100e-6, 33e-6))
    >>> round(float(slit.sum()) * 8e-6**2 / (100e-6 * 33e-6), 9)
    1.0
    """
    height, width = _validate.several("size", size, 2)
    xp, device, (height, width) = single_numbers(xp, device, **{"size[0]": height, "size[1]": width})
    steps, (y, x) = grid_positions(shape, dx, offset, xp, device)
    return share_in_strip(y, steps[0], height) * share_in_strip(x, steps[1], width)


def share_in_strip(position: Any, step: Any, width: Any) -> Any:
    """Return the part of each pixel, of the pitch `step` along one axis, that lies within a strip about zero."""
    xp = namespace(position)
    low = xp.maximum(position - step / 2, -width / 2)
    high = xp.minimum(position + step / 2, width / 2)
    return xp.clip((high - low) / step, 0.0, 1.0)


def share_in_disc(y: Any, x: Any, steps: Any, radius: float | Array) -> Any:
    """Return the part of the area of each pixel that lies within a disc about zero.

    Parameters
    ----------
    y, x : array
        Positions of the pixels, float64 ``[..., rows, 1]`` and ``[..., 1, columns]``.
    steps : sequence
        Their pitches (rows, columns).
    radius : array
        Radius, that broadcasts against the positions; positive.
    """
    xp = namespace(y, x)
    quarter = math.pi / 4 * radius**2

    def beside(place):
        """Return the area of the first quadrant of the disc up to a distance from one of its axes."""
        held = place < radius
        safe = xp.where(held, place, 0 * place)
        # One root for both terms: their slopes, infinite at the rim, cancel in the sum.
        root = xp.sqrt((radius - safe) * (radius + safe))
        area = (safe * root + radius**2 * xp.atan2(safe + 0 * root, root)) / 2
        return xp.where(held, area, quarter + 0 * place)

    edges, low, high = [], 0.0, 0.0
    for place, step, axis in zip((y, x), steps, (-2, -1), strict=True):
        last = place[..., -1:, :] if axis == -2 else place[..., -1:]
        edges.append(xp.concat([place - step / 2, last + step / 2], axis=axis))
        low = low + xp.clip(xp.abs(place) - step / 2, min=0.0) ** 2
        high = high + (xp.abs(place) + step / 2) ** 2
    down, across = (xp.abs(edge) for edge in edges)
    # The area between the axes and a point: of a rectangle, or of the quadrant less what is beyond the point.
    within = down**2 + across**2 <= radius**2
    area = xp.where(within, down * across, beside(down) + beside(across) - quarter)
    area = area * xp.sign(edges[0]) * xp.sign(edges[1])
    area = area[..., 1:, :] - area[..., :-1, :]
    share = (area[..., 1:] - area[..., :-1]) / (steps[0] * steps[1])
    # Whole pixels without the rounding errors of large areas.
    share = xp.where(high <= radius**2, xp.ones_like(share), xp.clip(share, 0.0, 1.0))
    return xp.where(low >= radius**2, xp.zeros_like(share), share)


@_validate.takes_units("dx", "wavelength", "offset", degrees=("angle",))
def axicon_phase(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float | Array,
    angle: float | Array,
    index: float | Array = 1.5,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the phase of a thin axicon, −k(n − 1)·tan(angle)·r.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Wavelength in metres; one number.
    angle : float or array
        Base angle of the cone in degrees; positive converges.
    index : float or array
        Refractive index of the axicon.
    offset : sequence of float
        Position of the axis (rows, columns) in metres.
    xp : optional
        Array namespace; by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 phase in radians, not wrapped. A plane wave behind it becomes a Bessel beam whose cone has the half
        angle asin((n − 1)·tan(angle)) (R. M. Herman and T. A. Wiggins, J. Opt. Soc. Am. A 8, 932 (1991)).

    Warns
    -----
    SamplingWarning
        If neighbouring samples of the phase differ by more than half a cycle.

    Examples
    --------
    The phase falls by k(n − 1)·tan(angle) per metre along the radius:

    >>> import math
    >>> from odak.wave import axicon_phase
    >>> phase = axicon_phase((3, 3), 1e-3, 500e-9, 1.0, 1.5)
    >>> expected = 2 * math.pi / 500e-9 * 0.5 * math.tan(math.radians(1.0)) * 1e-3
    >>> round(float(phase[1, 1] - phase[1, 2]) / expected, 6)
    1.0
    """
    _validate.number("wavelength", wavelength, positive=True)
    weaker = Weaker(1, -1, "a base angle of at most {:.3g} degrees")
    numbers = {"wavelength": wavelength, "angle": angle, "index": index}
    return _sampled("axicon_phase", _axicon, shape, dx, offset, weaker, numbers, xp, device)


def _axicon(y, x, wavelength, angle, index):
    xp = namespace(y)
    distance, _ = distance_from_axis(y, x)
    return -2 * math.pi / wavelength * (index - 1) * xp.tan(angle * (math.pi / 180)) * distance


@_validate.takes_units("dx")
def spiral_phase(
    shape: Sequence[int],
    charge: float | Array,
    dx: float | Sequence[float] = 1.0,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the phase of a spiral plate, charge times the azimuth.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    charge : float or array
        Topological charge: the number of cycles of 2π in a circle around the axis, from x (columns) towards y (rows).
    dx : float or sequence of float
        Pitch, one number or (rows, columns), in the unit of `offset`.
    offset : sequence of float
        Position of the axis (rows, columns).
    xp : optional
        Array namespace; by default the library of the charge, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 phase in radians, between −π·|charge| and π·|charge|.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import spiral_phase
    >>> phase = spiral_phase((3, 3), 2)
    >>> round(float(phase[1, 2]), 6), round(float(phase[2, 1]) / np.pi, 6)
    (0.0, 1.0)
    """
    xp, device, (charge,) = single_numbers(xp, device, charge=charge)
    _, (y, x) = grid_positions(shape, dx, offset, xp, device)
    return charge * xp.atan2(y + 0 * x, x + 0 * y)


@_validate.takes_units("focal", "dx", "wavelength", "offset", degrees=("angle",))
def cylindrical_lens_phase(
    shape: Sequence[int],
    focal: float | Array,
    dx: float | Sequence[float],
    wavelength: float | Array,
    angle: float | Array = 0.0,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the phase of a thin cylindrical lens, −π·s²/(λf), s being the distance from its axis line.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    focal : float or array
        Focal length in metres; positive converges.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Wavelength in metres; one number.
    angle : float or array
        Direction in degrees, from x (columns) towards y (rows), in which the lens has power: 0 focuses to a line along
        the rows' axis.
    offset : sequence of float
        Position (rows, columns) in metres of a point of the axis line.
    xp : optional
        Array namespace; by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 phase in radians, not wrapped.

    Warns
    -----
    SamplingWarning
        If neighbouring samples of the phase differ by more than half a cycle.

    Examples
    --------
    There is no power along the axis line:

    >>> from odak.wave import cylindrical_lens_phase
    >>> phase = cylindrical_lens_phase((3, 3), 0.1, 1e-4, 500e-9)
    >>> round(float(phase[0, 1]), 6), round(float(phase[1, 2]) / (-3.14159265 * 1e-8 / (500e-9 * 0.1)), 6)
    (-0.0, 1.0)
    """
    _validate.number("wavelength", wavelength, positive=True)
    _validate.real("focal", focal, nonzero=True)
    numbers = {"focal": focal, "wavelength": wavelength, "angle": angle}
    return _sampled("cylindrical_lens_phase", _cylinder, shape, dx, offset, _LONGER, numbers, xp, device)


def _cylinder(y, x, focal, wavelength, angle):
    xp, angle = namespace(y), angle * (math.pi / 180)
    return -math.pi * (x * xp.cos(angle) + y * xp.sin(angle)) ** 2 / (wavelength * focal)


@_validate.takes_units("dx", "wavelength", "radius", "offset")
def aspheric_lens_phase(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float | Array,
    radius: float | Array,
    index: float | Array = 1.5,
    conic: float | Array = 0.0,
    coefficients: Sequence[Any] = (),
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the phase of a thin plano-aspheric lens, −k(n − 1)·sag(r).

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Wavelength in metres; one number.
    radius : float or array
        Vertex radius of curvature in metres; positive converges.
    index : float or array
        Refractive index of the lens.
    conic : float or array
        Conic constant.
    coefficients : sequence of float or array
        Coefficients of r⁴, r⁶, … in metres to the fitting power.
    offset : sequence of float
        Position of the axis (rows, columns) in metres.
    xp : optional
        Array namespace; by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 phase in radians, not wrapped; NaN where the conic has no height. The sag is
        r²/(R(1 + √(1 − (1 + κ)r²/R²))) + Σ a_j·r^(2j + 4).

    Warns
    -----
    SamplingWarning
        If neighbouring samples of the phase differ by more than half a cycle.

    Examples
    --------
    Near the axis it is a lens of focal length radius/(index − 1):

    >>> from odak.wave import aspheric_lens_phase, lens_phase
    >>> thin = aspheric_lens_phase((3, 3), 1e-5, 500e-9, radius=0.05, index=1.5)
    >>> round(float(thin[1, 2] / lens_phase((3, 3), 0.1, 1e-5, 500e-9)[1, 2]), 6)
    1.0
    """
    _validate.number("wavelength", wavelength, positive=True)
    _validate.real("radius", radius, nonzero=True)
    given = {f"coefficients[{j}]": v for j, v in enumerate(_validate.several("coefficients", coefficients))}
    weaker = Weaker(1, 1, "a radius of curvature of at least {:.3g} m")
    numbers = {"wavelength": wavelength, "radius": radius, "index": index, "conic": conic, **given}
    return _sampled("aspheric_lens_phase", _asphere, shape, dx, offset, weaker, numbers, xp, device)


def _asphere(y, x, wavelength, radius, index, conic, *powers):
    xp = namespace(y)
    squared = y**2 + x**2
    root = 1 - (1 + conic) * squared / radius**2
    exists = root >= 0
    sag = squared / (radius * (1 + xp.sqrt(xp.where(root > 0, root, xp.ones_like(root)))))
    sag = xp.where(root > 0, sag, squared / radius)
    for j, value in enumerate(powers):
        sag = sag + value * squared ** (j + 2)
    phase = -2 * math.pi / wavelength * (index - 1) * sag
    return xp.where(exists, phase, xp.full_like(phase, math.nan))


@_validate.takes_units("focal", "dx", "wavelength", "offset")
def metalens_phase(
    shape: Sequence[int],
    focal: float | Array,
    dx: float | Sequence[float],
    wavelength: float | Array,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the phase that focuses a plane wave without spherical aberration, −k(√(r² + f²) − |f|), f > 0.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    focal : float or array
        Focal length in metres; positive converges, negative diverges.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Design wavelength in metres; one number.
    offset : sequence of float
        Position of the axis (rows, columns) in metres.
    xp : optional
        Array namespace; by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 phase in radians, not wrapped (F. Aieta et al., Nano Lett. 12, 4932 (2012)). :func:`lens_phase` is its
        paraxial form.

    Warns
    -----
    SamplingWarning
        If neighbouring samples of the phase differ by more than half a cycle.

    Examples
    --------
    The path from a point at the radius r to the focus is √(r² + f²):

    >>> from odak.wave import metalens_phase
    >>> phase = metalens_phase((3, 3), 4e-3, 3e-3, 500e-9)
    >>> round(float(phase[1, 2]) * 500e-9 / (2 * 3.14159265) * 1e3, 6)
    -1.0
    """
    _validate.number("wavelength", wavelength, positive=True)
    _validate.real("focal", focal, nonzero=True)
    numbers = {"focal": focal, "wavelength": wavelength}
    return _sampled("metalens_phase", hyperbolic_lens, shape, dx, offset, _LONGER, numbers, xp, device)


def hyperbolic_lens(y: Any, x: Any, focal: float | Array, wavelength: float | Array) -> Any:
    """Return the phase at points of a lens without spherical aberration."""
    xp, squared = namespace(y), y**2 + x**2
    # √(r² + f²) − |f| without the difference of nearly equal numbers.
    path = squared / (xp.sqrt(squared + focal**2) + xp.abs(focal))
    return -2 * math.pi / wavelength * xp.sign(focal) * path


@_validate.takes_units("focal", "dx", "wavelength", "offset")
def fresnel_zone_plate(
    shape: Sequence[int],
    focal: float | Array,
    dx: float | Sequence[float],
    wavelength: float | Array,
    kind: str = "amplitude",
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the transmission of a binary Fresnel zone plate.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    focal : float or array
        Focal length of the first order in metres, positive.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Wavelength in metres.
    kind : str
        "amplitude" (zones transmit 1 and 0; 10.1 % of the power goes to the focus) or "phase" (1 and −1; 40.5 %).
    offset : sequence of float
        Position of the axis (rows, columns) in metres.
    xp : optional
        Array namespace; by default the library of the focal length or the wavelength, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 ``[rows, columns]``; the zone m ends where √(r² + f²) − f = mλ/2, and the central one transmits 1.

    Warns
    -----
    SamplingWarning
        If a zone within the window is narrower than a pixel.

    Examples
    --------
    The first zone ends at the radius √(λf), near enough, here 0.316 mm:

    >>> from odak.wave import fresnel_zone_plate
    >>> row = fresnel_zone_plate((101, 101), 0.2, 1e-5, 500e-9)[50, 50:]
    >>> int(row[:50].tolist().index(0.0))
    32
    """
    kind = _validate.one_of("kind", kind, ("amplitude", "phase"))
    _validate.number("focal", focal, positive=True)
    _validate.number("wavelength", wavelength, positive=True)
    xp, device, values = single_numbers(xp, device, focal=focal, wavelength=wavelength)
    steps, (y, x) = grid_positions(shape, dx, offset, xp, device)
    phase = hyperbolic_lens(y, x, *values)
    edge = float(xp.max(xp.sqrt(y**2 + x**2)))
    length, wave = (float(value) for value in values)
    zone = wave / 2 * math.hypot(edge, length) / max(edge, 1e-300)
    if zone < max(steps):
        warn(f"the outermost zone is {zone:.3g} m wide, narrower than a pixel of {max(steps):.3g} m", SamplingWarning)
    odd = xp.floor(-phase / math.pi) % 2
    return xp.astype(1 - odd if kind == "amplitude" else 1 - 2 * odd, xp.float64)


# Positions within a period at which the phase steps between 0 and π, for equal powers of the central orders. Solved for
# the largest efficiency by sequential quadratic programming from forty random starts; the efficiencies agree with
# U. Krackhardt, J. N. Mait and N. Streibl, Appl. Opt. 31, 27 (1992).
_DAMMANN = {
    3: (0.0, 0.735258104634),
    5: (0.0, 0.264685380953, 0.613039164261, 0.651646277354),
    7: (0.0, 0.474288350318, 0.574798199768, 0.76808552074),
    9: (0.0, 0.409349954766, 0.476039272362, 0.538030414072, 0.694874756649, 0.865436953905),
    11: (
        *(0.0, 0.095564059449, 0.184007825801, 0.521874470073),
        *(0.652187897471, 0.725664785627, 0.866466233456, 0.9892262117),
    ),
    15: (
        *(0.0, 0.088212678283, 0.164976800309, 0.255961294394),
        *(0.602464373003, 0.726389574574, 0.87009030681, 0.950374435078),
    ),
}


@_validate.takes_units("period", "dx", "offset")
def dammann_grating(
    shape: Sequence[int],
    period: float | Sequence[float],
    dx: float | Sequence[float],
    orders: int | Sequence[int] = 5,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the binary phase of a Dammann grating, which splits a beam into equal ones.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    period : float or sequence of float
        Period in metres, one number or (rows, columns).
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    orders : int or sequence of int
        Number of equal central orders, one number or (rows, columns): 1 (no grating along this axis), 3, 5, 7, 9, 11
        or 15.
    offset : sequence of float
        Shift of the pattern (rows, columns) in metres.
    xp : optional
        Array namespace, NumPy by default.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 ``[rows, columns]`` phase, 0 or π; the product of a grating along each axis. Edges fall on pixels, so
        that the orders are equal to about the ratio of pitch and period. The efficiencies along one axis are 0.664,
        0.774, 0.786, 0.725, 0.740 and 0.816 (H. Dammann and K. Görtler, Opt. Commun. 3, 312 (1971)).

    Warns
    -----
    SamplingWarning
        If the narrowest part of a period is narrower than a pixel.

    Examples
    --------
    Three equal orders hold 66.4 % of the power:

    >>> import numpy as np
    >>> from odak.wave import dammann_grating
    >>> phase = dammann_grating((1, 1024), 1024.0, 1.0, orders=(1, 3))[0]
    >>> orders = abs(np.fft.fft(np.exp(1j * phase))) ** 2 / 1024**2
    >>> [round(float(orders[m]), 2) for m in (-1, 0, 1)], round(float(orders[0] + 2 * orders[1]), 2)
    ([0.22, 0.22, 0.22], 0.66)
    """
    period, dx, offset = _validate.constants(period=period, dx=dx, offset=offset)
    xp = _validate.library("xp", xp)
    periods = _validate.several("period", pitches(period, "period"), 2, positive=True)
    counts = [_validate.integer("orders", n, minimum=1) for n in pitches(orders, "orders")]
    steps, positions = grid_positions(shape, dx, offset, xp, device)
    sign = 1.0
    for n, length, step, position in zip(counts, periods, steps, positions, strict=True):
        if n == 1:
            continue
        if n not in _DAMMANN:
            raise ValueError(f"orders must be 1, {', '.join(map(str, _DAMMANN))}, got {n}")
        edges = _DAMMANN[n]
        narrowest = min(b - a for a, b in zip(edges, (*edges[1:], 1.0), strict=True)) * length
        if narrowest < step:
            warn(
                f"the narrowest part of a period is {narrowest:.3g} m wide, narrower than a pixel of {step:.3g} m",
                SamplingWarning,
            )
        # Towards the next edge by a rounding error, so that an edge on a sample is not left to chance.
        place = (position / length + 1e-9) % 1.0
        passed = sum(xp.astype(place >= edge, xp.float64) for edge in edges)
        sign = sign * (1 - 2 * ((passed - 1) % 2))
    ones = xp.ones(_validate.size("shape", shape), dtype=xp.float64, device=device)
    return (1 - sign * ones) * (math.pi / 2)


def single_numbers(xp: ModuleType | None, device: Device, **numbers: Any) -> Any:
    """Return the namespace, the device and single real numbers in double precision."""
    for name, value in numbers.items():
        _validate.number(name, value)
    xp, device, _ = _array.placement(*numbers.values(), xp=xp, device=device)
    values = [_array.converted(value, xp, device, xp.float64) for value in numbers.values()]
    return xp, device, [xp.reshape(value, ()) for value in values]


def grid_positions(shape: Any, dx: Any, offset: Any, xp: ModuleType, device: Device) -> Any:
    """Return the pitches (rows, columns) and the positions of the samples, ``[rows, 1]`` and ``[1, columns]``."""
    shape = _validate.size("shape", shape)
    steps = [_of_library(xp, "dx", _validate.number("dx", step, positive=True)) for step in pitches(dx)]
    offset = [_of_library(xp, "offset", shift) for shift in _validate.several("offset", offset, 2)]
    y, x = (
        (xp.arange(n, dtype=xp.float64, device=device) - n // 2) * step - shift
        for n, step, shift in zip(shape, steps, offset, strict=True)
    )
    return steps, (y[:, None], x[None, :])


def _of_library(xp: ModuleType, name: str, value: Any) -> Any:
    """Return a number as it is, and an array of another library as a number."""
    return _validate.constant(name, value) if _array.is_array(value) and namespace(value) is not xp else value


def distance_from_axis(y: Any, x: Any) -> tuple[Any, Any]:
    """Return the distance from the axis, with a derivative of 0 on it, and where the axis is."""
    xp, squared = namespace(y), y**2 + x**2
    centre = squared == 0
    return xp.where(centre, xp.zeros_like(squared), xp.sqrt(xp.where(centre, xp.ones_like(squared), squared))), centre


@_validate.takes_units("dx")
def zernike_phase(
    nx: int,
    ny: int,
    coefficients: Mapping[Any, Any],
    radius: float | Array | None = None,
    dx: float | Sequence[float] | Array = 1.0,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the aberration Σ c·Z as a phase, each Z a Zernike polynomial of root mean square 1 over the disc.

    Parameters
    ----------
    nx : int
        Rows.
    ny : int
        Columns.
    coefficients : mapping
        ``{(n, m): c}``, c in radians RMS over the disc (a wave is 2π). A number, or an array ``[...]`` for a batch;
        the phase is differentiable in arrays. Modes by another index: ``{noll_to_nm(4): 0.5}``.
    radius : float or array, optional
        Radius of the disc in the unit of `dx`; by default half the diagonal, so that the whole window lies inside.
        Beyond it the phase is 0.
    dx : float or sequence of float
        Pixel pitch, or two of them (rows, columns). The default 1 gives `radius` in pixels.
    offset : sequence of float
        Position of the disc's centre (rows, columns) from sample n // 2, in the unit of `dx`.
    xp : module, optional
        Array namespace; by default the library of the coefficients, else NumPy.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 phase in radians, ``[..., nx, ny]``, not wrapped.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    SamplingWarning
        If neighbouring samples of the phase differ by more than half a cycle.

    Notes
    -----
    Noll, J. Opt. Soc. Am. 66, 207 (1976). As the polynomials are orthonormal, the variance over the disc is the sum of
    the squares of the coefficients other than piston's. x runs along columns, y along rows: θ = atan2(y, x).

    Examples
    --------
    Tilt of 0.5 rad RMS is 2·0.5·x/radius:

    >>> from odak.wave import zernike_phase
    >>> zernike_phase(3, 3, {(1, 1): 0.5}, radius=1.0)[1].tolist()
    [-1.0, 0.0, 1.0]
    """
    _validate.instance("coefficients", coefficients, Mapping, "a mapping of (n, m) to radians")
    coefficients = {mode: float(v) if isinstance(v, np.number) else v for mode, v in coefficients.items()}
    xp, device, _ = _array.placement(*coefficients.values(), xp=xp, device=device)
    for mode, value in coefficients.items():
        _validate.real(f"coefficients[{mode}]", value)
    shape, pairs = _validate.size("nx, ny", (nx, ny)), _pairs("coefficients", coefficients)
    phase = xp.zeros(shape, dtype=xp.float64, device=device)
    modes = _modes(nx, ny, pairs, radius, dx, offset, xp, device)
    for value, polynomial in zip(coefficients.values(), modes, strict=True):
        phase = phase + (value[..., None, None] if _array.is_array(value) else float(value)) * polynomial
    steps = pitches(dx)
    size = math.hypot(*(n * step for n, step in zip(shape, steps, strict=True))) / 2 if radius is None else radius
    plain = plain_numbers(*steps, *offset, size, *coefficients.values())
    if plain is not None:
        axes = sampled_axes(shape, plain[:2], plain[2:4])
        weaker = Weaker(0, -1, "coefficients of at most {:.3g} times these")
        formula = _ZernikeSum(tuple(map(tuple, pairs)), plain[4], plain[5:])
        warn_beyond_nyquist("zernike_phase", formula, axes, (1.0,), weaker, plain[4])
    return phase


@_validate.takes_units("dx")
def zernike_basis(
    nx: int,
    ny: int,
    modes: Iterable[Any],
    radius: float | Array | None = None,
    dx: float | Array = 1.0,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return Zernike polynomials of root mean square 1, for sums that are taken again and again.

    Parameters
    ----------
    nx : int
        Rows.
    ny : int
        Columns.
    modes : sequence of pairs of int
        Pairs (n, m) of radial degree and azimuthal frequency.
    radius : float or array, optional
        Radius of the disc in the unit of `dx`; by default half the diagonal. The polynomials are 0 beyond it.
    dx : float or sequence of float, default: 1.0
        Pixel pitch, one number or (rows, columns). The default gives `radius` in pixels.
    offset : sequence of float, default: (0.0, 0.0)
        Position of the disc's centre (rows, columns) from sample n // 2, in the unit of `dx`.
    xp : module, optional
        Array namespace of the result, NumPy by default.
    device : optional
        Device of the result.

    Returns
    -------
    array
        float64 ``[modes, nx, ny]``; 0 outside the disc.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    The polynomials are orthonormal over the disc:

    >>> from odak.wave import zernike_basis
    >>> tilt, defocus = zernike_basis(128, 128, [(1, 1), (2, 0)], radius=63.0)
    >>> inside = float((tilt**2 + defocus**2 > 0).sum())
    >>> round(float((tilt * tilt).sum()) / inside, 2), round(abs(float((tilt * defocus).sum())) / inside, 2)
    (1.0, 0.0)
    """
    xp = _validate.library("xp", xp)
    modes = _pairs("modes", modes)
    if not modes:
        raise ValueError("modes must contain at least one pair (n, m), got none")
    return xp.stack(list(_modes(nx, ny, modes, radius, dx, offset, xp, device)))


@dataclass(frozen=True)
class _ZernikeSum:
    """Phase at points of a sum of Zernike polynomials, times a number."""

    modes: tuple[Any, ...]
    radius: float
    coefficients: tuple[Any, ...]

    def __call__(self, y, x, times):
        polynomials = zernike_modes(y / self.radius, x / self.radius, self.modes)
        return times * sum(c * z for c, z in zip(self.coefficients, polynomials, strict=True))


def _modes(nx, ny, modes, radius, dx, offset, xp, device) -> Iterator[Any]:
    """Yield the polynomials, formed from ρ²ᵏ and (x + iy)^m: no angle, no square root, smooth at the centre."""
    shape = _validate.size("nx, ny", (nx, ny))
    steps, (y, x) = grid_positions(shape, dx, offset, xp, device)
    if radius is None:
        radius = math.hypot(*(n * step for n, step in zip(shape, steps, strict=True))) / 2
    radius = _array.converted(_validate.number("radius", radius, positive=True), xp, device, xp.float64)
    y, x = y / radius, x / radius
    # The first corner of an even window is on the rim of its disc, but for rounding.
    inside = xp.astype(x**2 + y**2 <= 1 + 1e-12, xp.float64)
    for polynomial in zernike_modes(y, x, modes):
        yield polynomial * inside


def zernike_modes(y: Any, x: Any, modes: Iterable[Any]) -> Iterator[Any]:
    """Yield Zernike polynomials of root mean square 1 at points of the unit disc, and their continuation beyond it."""
    argument = 2 * (x**2 + y**2) - 1
    for n, m in modes:
        n, m = check_mode(n, m)
        yield zernike_norm(n, m) * jacobi((n - abs(m)) // 2, abs(m), argument) * spiral_parts(x, y, abs(m))[m < 0]


def _pairs(name, modes) -> list[tuple[Any, ...]]:
    listed = isinstance(modes, Iterable) and not isinstance(modes, str)
    pairs = [tuple(mode) if isinstance(mode, Iterable) else (mode,) for mode in modes] if listed else [()]
    if any(len(pair) != 2 for pair in pairs):
        raise ValueError(f"{name} must be pairs of integers (n, m), got {modes!r:.100}")
    for n, m in pairs:
        _validate.integer(f"n in {name}", n)
        _validate.integer(f"m in {name}", m, minimum=-n)
    return pairs


def spiral_parts(x: Any, y: Any, charge: int) -> Any:
    """Return the real and imaginary part of (x ± iy)^|charge|, with the sign of the charge."""
    real, imaginary = 1 + 0 * (x + y), 0 * (x + y)
    y = y if charge >= 0 else -y
    for _ in range(abs(charge)):
        real, imaginary = x * real - y * imaginary, x * imaginary + y * real
    return real, imaginary
