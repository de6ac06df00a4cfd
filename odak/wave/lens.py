"""Thin phase elements: lenses, prisms and gratings, as complex transmissions."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._array import Array, is_array, namespace, phasor, phasor_of_cycles


def lens_phase(
    shape: Sequence[int],
    focal: float,
    dx: float,
    wavelength: float,
    offset: Sequence[float] = (0.0, 0.0),
    *,
    xp: Any = None,
    device: Any = None,
) -> Array:
    """Return the phase of a thin lens, −π·r²/(λf), on the field's own grid (optical axis at index n // 2).

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    focal : float
        Focal length in metres; positive converges.
    dx : float
        Pixel pitch in metres.
    wavelength : float
        Wavelength in metres.
    offset : sequence of float
        Position of the lens's axis (rows, columns) in metres.
    xp, device : optional
        Array namespace (NumPy by default) and device.

    Returns
    -------
    array
        float64 phase in radians, not wrapped.
    """
    shape = _validate.size("shape", shape)
    _validate.real("focal", focal, nonzero=True)
    _validate.real("dx", dx, positive=True)
    _validate.real("wavelength", wavelength, positive=True)
    offset = _validate.several("offset", offset, 2)
    xp = _validate.library("xp", xp)
    y, x = (
        (xp.arange(n, dtype=xp.float64, device=device) - n // 2) * dx - shift
        for n, shift in zip(shape, offset, strict=True)
    )
    return -math.pi * (y[:, None] ** 2 + x[None, :] ** 2) / (wavelength * focal)


def squared_radius(nx, ny, dx, offset=(0, 0), xp=None, device=None):
    """Return r² on the grid of the older lens functions, ``[nx, ny]``: linspace(−n·dx/2, n·dx/2, n) along each axis.

    The step is n·dx/(n − 1), not dx; :func:`lens_phase` has the exact grid.
    """
    _validate.real("dx", dx, positive=True)
    offset = _validate.several("offset", offset, 2)
    xp = _validate.library("xp", xp)
    along_x, along_y = (
        xp.linspace(-n * dx / 2, n * dx / 2, n, dtype=xp.float64, device=device) - shift * dx
        for n, shift in ((nx, offset[1]), (ny, offset[0]))
    )
    return along_x[:, None] ** 2 + along_y[None, :] ** 2


def quadratic_phase_function(
    nx: int, ny: int, k: float, focal: float = 0.4, dx: float = 0.001, offset: Sequence[float] = (0, 0)
) -> np.ndarray:
    """Return the transmission of a thin lens, exp(−ik·r²/(2f)), converging for a positive focal length.

    Parameters
    ----------
    nx, ny : int
        Columns and rows.
    k : float
        Wave number in rad/m.
    focal : float
        Focal length in metres.
    dx : float
        Pixel pitch in metres. The grid is the older one of :func:`squared_radius`.
    offset : sequence of float
        Shift of the lens in pixels: `offset[1]` along x, `offset[0]` along y.

    Returns
    -------
    numpy.ndarray
        complex128 ``[ny, nx]``.

    Notes
    -----
    The older exp(i·k·½·sin(r²/f)) is the same lens with the other sign, and with a sine where small angles hide it.
    """
    nx, ny = _validate.size("nx, ny", (nx, ny))
    _validate.real("k", k)
    _validate.real("focal", focal, nonzero=True)
    return phasor(-k * squared_radius(nx, ny, dx, offset) / (2 * focal)).T


def double_convergence(nx: int, ny: int, k: float, r: float, dx: float, *, xp: Any = None) -> Array:
    """Return the phase factor exp(ik·r²/R) of a doubly converging beam (Engström et al., Opt. Express 15, 2007).

    Parameters
    ----------
    nx, ny : int
        Rows and columns.
    k : float
        Wave number in rad/m.
    r : float
        Distance R in metres.
    dx : float
        Pixel pitch in metres. The grid is the older one of :func:`squared_radius`.
    xp : optional
        Array namespace, NumPy by default.

    Returns
    -------
    array
        complex128 ``[nx, ny]``.
    """
    nx, ny = _validate.size("nx, ny", (nx, ny))
    _validate.real("k", k)
    _validate.real("r", r, nonzero=True)
    return phasor(k * squared_radius(nx, ny, dx, xp=xp) / r)


def prism_phase_function(
    nx: int, ny: int, k: float, angle: float, dx: float = 0.001, axis: str = "x", *, xp: Any = None
) -> Array:
    """Return the transmission of a thin prism, exp(−ik·sin(angle)·x).

    Parameters
    ----------
    nx, ny : int
        Rows and columns.
    k : float
        Wave number in rad/m.
    angle : float
        Tilt in degrees.
    dx : float
        Pixel pitch in metres. The grid is the older one of :func:`squared_radius`.
    axis : str
        "x" (the phase runs from column to column) or "y" (from row to row).
    xp : optional
        Array namespace, NumPy by default.

    Returns
    -------
    array
        complex128 ``[nx, ny]``.
    """
    nx, ny = _validate.size("nx, ny", (nx, ny))
    _validate.real("k", k)
    _validate.real("dx", dx, positive=True)
    axis = _validate.one_of("axis", axis, ("x", "y"))
    xp, count = _validate.library("xp", xp), ny if axis == "x" else nx
    line = xp.linspace(-count * dx / 2, count * dx / 2, count, dtype=xp.float64)
    position = xp.broadcast_to(line[None, :] if axis == "x" else line[:, None], (nx, ny))
    return phasor(-k * _of_degrees("angle", angle, math.sin) * position)


def prism_grating(
    nx: int,
    ny: int,
    k: float,
    angle: float,
    dx: float = 0.001,
    axis: str = "x",
    phase_offset: float = 0.0,
    *,
    xp: Any = None,
) -> Array:
    """Return a blazed prism exp(−i(k·sin(angle)·x + offset)), counted from the first sample.

    Parameters
    ----------
    nx, ny : int
        Rows and columns.
    k : float
        Wave number in rad/m.
    angle : float
        Deflection in degrees.
    dx : float
        Pixel pitch in metres.
    axis : str
        "x" (the phase runs along rows) or "y" (along columns).
    phase_offset : float
        Constant phase in degrees.
    xp : optional
        Array namespace, NumPy by default.

    Returns
    -------
    array
        complex128 ``[nx, ny]``.
    """
    line, shape = _line_along(nx, ny, axis, _validate.library("xp", xp))
    xp = namespace(line)
    _validate.real("k", k)
    _validate.real("dx", dx, positive=True)
    _validate.real("phase_offset", phase_offset)
    sine = _of_degrees("angle", angle, math.sin)
    phase = k * sine * line * dx + phase_offset * (math.pi / 180)
    return xp.broadcast_to(phasor(-phase), shape) + 0


def blazed_grating(nx: int, ny: int, levels: int = 2, axis: str = "x", *, xp: Any = None) -> Array:
    """Return a blazed grating of a period of `levels` samples, exp(i2π·(j mod levels)/levels), j falling from n to 1.

    Parameters
    ----------
    nx, ny : int
        Rows and columns.
    levels : int
        Samples of a period; below 2 is taken as 2.
    axis : str
        "x" (along rows) or "y" (along columns).
    xp : optional
        Array namespace, NumPy by default.

    Returns
    -------
    array
        complex128 ``[nx, ny]``.
    """
    xp = _validate.library("xp", xp)
    levels = max(2, _validate.whole("levels", levels, minimum=-_validate.LONGEST_SIDE))
    line, shape = _line_along(nx, ny, axis, xp)
    falling = max(line.shape) - line
    return xp.broadcast_to(phasor_of_cycles((falling % levels) / levels), shape) + 0


def linear_grating(
    nx: int, ny: int, every: int = 2, add: float | None = 3.14, axis: str = "x", *, xp: Any = None
) -> Array:
    """Return a binary grating.

    Parameters
    ----------
    nx, ny : int
        Rows and columns.
    every : int
        Period in samples.
    add : float or None
        Phase of the lines in radians; None stands for π.
    axis : str
        "x": rows 0, every, … hold exp(i·add) and the others 0; "y": the same for columns; "xy": a checkerboard of
        exp(i·add) and 1, without zeros.
    xp : optional
        Array namespace, NumPy by default.

    Returns
    -------
    array
        complex64 ``[nx, ny]``.

    Raises
    ------
    ValueError
        If `axis` is none of the three.
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
    angle = _validate.real(name, angle)
    if is_array(angle):
        return getattr(namespace(angle), function.__name__)(angle * (math.pi / 180))
    return function(math.radians(angle))


def _line_along(nx, ny, axis, xp):
    nx, ny = _validate.size("nx, ny", (nx, ny))
    if _validate.one_of("axis", axis, ("x", "y")) == "x":
        return xp.arange(nx, dtype=xp.float64)[:, None], (nx, ny)
    return xp.arange(ny, dtype=xp.float64)[None, :], (nx, ny)
