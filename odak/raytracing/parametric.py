"""Rays and surfaces that the user gives as a function that is zero on them."""

import logging
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._array import Array
from odak.raytracing import arguments

_log = logging.getLogger("odak")

# Distances at which a surface is looked for: from 1e-6 to 1e7, each a tenth beyond the one before.
_FIRST, _LAST, _GROWTH = 1e-6, 1e7, 1.1
_GOLDEN = (np.sqrt(5) - 1) / 2


def intersection_kernel_for_parametric_surfaces(
    distance: Array, ray: Array, parametric_surface: Any, surface_function: Callable
) -> tuple[np.ndarray, np.ndarray]:
    """Return a surface's function at given distances along rays, and the points there.

    Parameters
    ----------
    distance : array
        ``[m]`` or a number.
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    parametric_surface : object
        Handed on to `surface_function`.
    surface_function : callable
        ``surface_function(points [m, 3], parametric_surface)`` returns ``[m]``, zero on the surface.

    Returns
    -------
    tuple of numpy.ndarray
        Errors ``[m]`` and points ``[m, 3]``.

    Examples
    --------
    >>> from odak.raytracing import intersection_kernel_for_parametric_surfaces, sphere_function
    >>> ray = [[0, 0, 0], [0, 0, 1]]
    >>> intersection_kernel_for_parametric_surfaces(2.0, ray, [0, 0, 0, 1], sphere_function)[0]
    array([3.])
    """
    _validate.function("surface_function", surface_function)
    ray = arguments.flat_rays("ray", ray)
    distance = np.atleast_1d(arguments.floats("distance", distance))
    if distance.ndim > 1:
        raise ValueError(f"distance must be a number or [m], got {distance.shape}")
    _validate.fitting(distance=distance, ray=ray[:, 0, 0])
    point = ray[:, 0] + distance[:, None] * ray[:, 1]
    return np.asarray(surface_function(point, parametric_surface)).reshape(len(point)), point


def propagate_parametric_intersection_error(distance: Sequence, error: Sequence) -> tuple[list, list]:
    """Take one secant step from two distances and their errors.

    Parameters
    ----------
    distance, error : sequence
        Two values each (numbers or arrays): the older and the newer.

    Returns
    -------
    tuple of list
        [x1, |x2|] with x2 = x1 − e1·(x1 − x0)/(e1 − e0), and [e1, e1]. The arguments are not changed.

    Examples
    --------
    >>> from odak.raytracing import propagate_parametric_intersection_error
    >>> propagate_parametric_intersection_error([0, 1], [5, 3])
    ([1, 2.5], [3, 3])
    """
    (x0, x1), (e0, e1) = _two("distance", distance), _two("error", error)
    _validate.fitting(distance=x0, newer_distance=x1, error=e0, newer_error=e1)
    return [x1, abs(x1 - e1 * (x1 - x0) / (e1 - e0))], [e1, e1]


def _two(name: str, values) -> tuple:
    """Return two values: finite numbers, or arrays, in which NaN stands for a ray that is lost."""
    values = tuple(values) if isinstance(values, Iterable) and not isinstance(values, str) else (values,)
    if len(values) != 2:
        raise ValueError(f"{name} must be two numbers or arrays, the older and the newer; got {len(values)}")
    return tuple(_validate.array(name, v) if np.ndim(v) else _validate.real(name, v) for v in values)


def intersect_parametric(
    ray: Array,
    parametric_surface: Any,
    surface_function: Callable,
    surface_normal_function: Callable,
    target_error: float = 0.00000001,
    iter_no_limit: int = 100000,
) -> tuple:
    """Meet a surface given as a function: the nearest point ahead of each ray.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    parametric_surface : object
        Handed on to both functions.
    surface_function : callable
        ``surface_function(points [m, 3], parametric_surface)`` returns ``[m]``: zero on the surface, with opposite
        signs on its sides.
    surface_normal_function : callable
        Takes the same and returns normals as rays.
    target_error : float
        Largest |surface_function| that counts as on the surface.
    iter_no_limit : int
        Largest number of refinements.

    Returns
    -------
    tuple
        Distances ``[m]`` and normals, in this order; NaN for rays without a hit, ``(False, False)`` when there is only
        one ray and it has none.

    Notes
    -----
    Distances from 1e-6 to 1e7, each a tenth beyond the one before, are searched for a change of sign or a smallest
    magnitude that hides two; a bracketed secant with bisection (regula falsi, Illinois) then closes in, ray by ray.

    Examples
    --------
    >>> from odak.raytracing import get_sphere_normal, intersect_parametric, sphere_function
    >>> intersect_parametric([[0, 0, -5], [0, 0, 1]], [0, 0, 0, 1], sphere_function, get_sphere_normal)[0].round(9)
    array([4.])
    """
    target_error = float(_validate.real("target_error", target_error, positive=True))
    limit = _validate.integer("iter_no_limit", iter_no_limit, minimum=1)
    rays = arguments.flat_rays("ray", ray)
    _validate.function("surface_function", surface_function)
    _validate.function("surface_normal_function", surface_normal_function)

    def error_at(distance, rows):
        return intersection_kernel_for_parametric_surfaces(distance, rays[rows], parametric_surface, surface_function)[
            0
        ]

    bracket = _first_bracket(error_at, len(rays), target_error)
    distance = _close_in(error_at, bracket, target_error, limit)
    hit = np.isfinite(distance)
    if not hit.any():
        missed = np.full((len(rays), 2, 3), np.nan)
        return (False, False) if len(rays) == 1 else (distance, missed)
    normal = np.full((len(rays), 2, 3), np.nan)
    point = rays[hit, 0] + distance[hit, None] * rays[hit, 1]
    normal[hit] = np.reshape(surface_normal_function(point, parametric_surface), (-1, 2, 3))
    return distance, arguments.single(normal)


def _first_bracket(error_at: Callable, count: int, target: float) -> np.ndarray:
    """Return distances between which the error first changes its sign, ``[2, m]``; NaN if it never does."""
    found = np.full((2, count), np.nan)
    rows = np.arange(count)
    before = now = np.zeros(count)
    error_before = error_now = error_at(now, rows) if count else now
    distance = _FIRST
    while distance < _LAST and len(rows):
        after = np.full(len(rows), distance)
        error_after = error_at(after, rows)
        # A start on the surface itself is not a hit: its sign is that of the first step.
        leaving = (np.abs(error_now) <= target) & (now == 0)
        change = (np.sign(error_after) != np.sign(error_now)) & ~leaving & np.isfinite(error_after)
        found[:, rows[change]] = now[change], after[change]
        dip = (np.abs(error_now) <= np.abs(error_before)) & (np.abs(error_now) < np.abs(error_after)) & ~change
        dip &= ~leaving & (now > 0)
        if dip.any():
            found[:, rows[dip]] = _bottom(error_at, before[dip], after[dip], now[dip], rows[dip])
        keep = np.isnan(found[0, rows])
        before, error_before = now[keep], error_now[keep]
        rows, now, error_now = rows[keep], after[keep], error_after[keep]
        distance *= _GROWTH
    return found


def _bottom(error_at: Callable, low, high, inside, rows) -> np.ndarray:
    """Look for a change of sign where the error is smallest between `low` and `high`; NaN where there is none."""
    low, high, start = low.copy(), high.copy(), low
    sign = np.sign(error_at(inside, rows))
    crossed = np.full(len(rows), np.nan)
    for _ in range(80):
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        error_left, error_right = sign * error_at(left, rows), sign * error_at(right, rows)
        for place, error in ((right, error_right), (left, error_left)):
            crossed = np.where(error <= 0, place, crossed)
        if not np.isnan(crossed).any():
            break
        nearer = error_left < error_right
        low, high = np.where(nearer, low, left), np.where(nearer, right, high)
    return np.where(np.isnan(crossed), np.nan, np.stack((start, crossed)))


def _close_in(error_at: Callable, bracket: np.ndarray, target: float, limit: int) -> np.ndarray:
    """Return the roots within brackets ``[2, m]`` to `target`, NaN where there is no bracket or no convergence."""
    result = np.full(bracket.shape[1], np.nan)
    rows = np.flatnonzero(np.isfinite(bracket[0]))
    low, high = bracket[:, rows]
    if not len(rows):
        return result
    error_low, error_high = error_at(low, rows), error_at(high, rows)
    for step in range(min(limit, 200)):
        flat = error_high == error_low
        secant = high - error_high * (high - low) / np.where(flat, 1.0, error_high - error_low)
        middle = (low + high) / 2
        # Every third step halves the bracket, so that no shape of the error can stall the secant.
        usable = ~flat & (secant > low) & (secant < high) & (step % 3 != 2)
        place = np.where(usable, secant, middle)
        error = error_at(place, rows)
        done = (np.abs(error) <= target) | ((place <= low) | (place >= high)) & (np.abs(error) <= 1e3 * target)
        result[rows[done]] = place[done]
        below = np.sign(error) == np.sign(error_low)
        low, error_low = np.where(below, place, low), np.where(below, error, error_low)
        high, error_high = np.where(below, high, place), np.where(below, error_high, error)
        rows, low, high, error_low, error_high = (v[~done] for v in (rows, low, high, error_low, error_high))
        if not len(rows):
            break
    if len(rows):
        _log.warning("intersect_parametric: %d rays did not reach an error of %g", len(rows), target)
    return result
