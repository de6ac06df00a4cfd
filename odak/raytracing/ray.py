"""Rays as ``[2, 3]`` arrays (start, direction cosines), batches of them ``[m, 2, 3]``, and the rays of fields."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from odak import _array, _show, _validate
from odak._array import Array, ArrayT, is_readable, namespace
from odak._warnings import AccuracyWarning, warn
from odak.raytracing import arguments, geometry
from odak.raytracing.geometry import safe_sqrt
from odak.tools.transformation import rotation_matrix


@_validate.takes_units(degrees=("abg",))
def create_ray(x0y0z0: ArrayT, abg: ArrayT) -> ArrayT:
    """Return the ray from a point with given angles to the three axes.

    Parameters
    ----------
    x0y0z0 : array
        Start, ``[3]`` or ``[m, 3]``.
    abg : array
        Angles to the x, y and z axes in degrees, ``[3]`` or ``[m, 3]``. Their cosines are not normalised; a
        warning is issued where the sum of their squares is not 1.

    Returns
    -------
    array
        ``[2, 3]``, or ``[m, 2, 3]``.

    Raises
    ------
    ValueError
        If an argument does not hold three numbers per row.

    Warns
    -----
    AccuracyWarning
        If a direction's length is not 1 within 0.05 %: distances along such a ray are in units of that length.

    Examples
    --------
    >>> from odak.raytracing import create_ray
    >>> create_ray([1, 2, 3], [90, 60, 30]).round(4)
    array([[1.   , 2.   , 3.   ],
           [0.   , 0.5  , 0.866]])
    """
    start, abg = _validate.reals(x0y0z0=x0y0z0, abg=abg)
    start, abg = _validate.shaped("x0y0z0", start, "[..., 3]"), _validate.shaped("abg", abg, "[..., 3]")
    _validate.fitting(x0y0z0=start, abg=abg)
    cosines = namespace(abg).cos(abg * (math.pi / 180))
    warn_unless_unit("abg", cosines)
    return arguments.as_rays(start, cosines)


def warn_unless_unit(name: str, cosines: Array) -> None:
    """Warn about direction cosines ``[..., 3]`` of angles whose length is not 1; NaN marks a lost ray."""
    if not is_readable(cosines):
        return
    xp = namespace(cosines)
    squared = geometry.dot(cosines, cosines)
    off = xp.abs(squared - 1) > 1e-3
    if bool(xp.any(off)):
        first = float(xp.reshape(squared[off], (-1,))[0]) ** 0.5
        warn(
            f"{name} must be angles whose cosines make a vector of length 1, got one of length {first:.4g}: "
            "a distance along the ray counts lengths of its direction",
            AccuracyWarning,
        )


def create_ray_from_two_points(x0y0z0: Array, x1y1z1: Array) -> Array:
    """Return rays from the first points towards the second ones.

    Parameters
    ----------
    x0y0z0 : array
        Starts, ``[3]`` or ``[m, 3]``; a single start is broadcast.
    x1y1z1 : array
        Points towards which the rays run, ``[3]`` or ``[m, 3]``; a single point is broadcast.

    Returns
    -------
    array
        ``[2, 3]`` for one ray, else ``[m, 2, 3]``. Unit direction cosines, NaN where start and end coincide.

    Examples
    --------
    >>> from odak.raytracing import create_ray_from_two_points
    >>> create_ray_from_two_points([0, 0, 0], [0, 3, 4])
    array([[0. , 0. , 0. ],
           [0. , 0.6, 0.8]])
    """
    start, end = _validate.reals(x0y0z0=x0y0z0, x1y1z1=x1y1z1)
    start, end = arguments.points("x0y0z0", start), arguments.points("x1y1z1", end)
    _validate.fitting(x0y0z0=start, x1y1z1=end)
    return arguments.single(arguments.as_rays(start, geometry.unit(end - start)))


def create_ray_from_angles(point: Array, angles: Sequence[float] | Array, mode: str = "XYZ") -> Array:
    """Return the ray from a point along the rotated z axis.

    Parameters
    ----------
    point : array
        Start, ``[3]`` or ``[m, 3]``.
    angles : sequence of float or array
        Degrees about X, Y and Z; zero angles point along +z.
    mode : str
        Order of the rotations, as in :func:`odak.tools.rotate_point`.

    Returns
    -------
    array
        ``[2, 3]`` or ``[m, 2, 3]``.

    Examples
    --------
    >>> from odak.raytracing import create_ray_from_angles
    >>> create_ray_from_angles([1, 2, 3], [0, 90, 0]).round(12)
    array([[1., 2., 3.],
           [1., 0., 0.]])
    """
    point, angles = _validate.reals(point=point, angles=angles)
    point, angles = arguments.points("point", point), arguments.points("angles", angles)
    _validate.fitting(point=point, angles=angles)
    return arguments.single(arguments.as_rays(point, rotation_matrix(angles, mode)[..., 2]))


def create_ray_from_all_pairs(x0y0z0: Array, x1y1z1: Array) -> Array:
    """Return a ray from each of the first points to each of the second ones.

    Parameters
    ----------
    x0y0z0 : array
        Starts, ``[m, 3]``.
    x1y1z1 : array
        Ends, ``[n, 3]``.

    Returns
    -------
    array
        ``[m·n, 2, 3]``; ray i·n + j goes from start i to end j. NaN cosines where the two coincide.

    Examples
    --------
    >>> from odak.raytracing import create_ray_from_all_pairs
    >>> tuple(create_ray_from_all_pairs([[0, 0, 0], [1, 0, 0]], [[0, 0, 1], [0, 0, 2], [0, 0, 3]]).shape)
    (6, 2, 3)
    """
    start, end = _validate.reals(x0y0z0=x0y0z0, x1y1z1=x1y1z1)
    start = arguments.listed("x0y0z0", start, (3,), "[3] or [m, 3]")[:, None, :]
    end = arguments.listed("x1y1z1", end, (3,), "[3] or [m, 3]")
    rays = arguments.as_rays(start, geometry.unit(end - start))
    return namespace(rays).reshape(rays, (-1, 2, 3))


def propagate_a_ray(ray: Array, distance: float | Array) -> Array:
    """Return rays whose starts are moved along their directions; the directions are unchanged.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    distance : float or array
        A number, ``[1]``, ``[m]``, ``[m, 1]`` or ``[1, m]``, ``[...]`` for more axes; negative goes backwards.

    Returns
    -------
    array
        A new array, ``[2, 3]`` for one ray, else ``[m, 2, 3]``.

    Examples
    --------
    >>> from odak.raytracing import propagate_a_ray
    >>> propagate_a_ray([[0, 0, 0], [0, 0.6, 0.8]], 10.0)
    array([[0. , 6. , 8. ],
           [0. , 0.6, 0.8]])
    """
    ray, distance = _validate.reals(ray=ray, distance=distance)
    ray = arguments.rays("ray", ray)
    distance = namespace(distance).reshape(distance, (-1,)) if ray.ndim == 3 else distance
    _validate.fitting(ray=ray.shape[:-2], distance=distance)
    moved = ray[..., 0, :] + distance[..., None] * ray[..., 1, :]
    return arguments.single(arguments.as_rays(moved, ray[..., 1, :]))


def get_points_along_a_ray_segment(ray: Array, distances: Array) -> Array:
    """Return the points of rays at given distances from their starts.

    Parameters
    ----------
    ray : array
        ``[2, 3]`` or ``[m, 2, 3]``.
    distances : array
        ``[k]``.

    Returns
    -------
    array
        ``[k, 3]`` for one ray, else ``[m, k, 3]``.

    Examples
    --------
    >>> from odak.raytracing import get_points_along_a_ray_segment
    >>> get_points_along_a_ray_segment([[0, 0, 0], [0, 0, 1]], [1.0, 2.0]).tolist()
    [[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]]
    """
    ray, distances = _validate.reals(ray=ray, distances=distances)
    ray, distances = arguments.rays("ray", ray), namespace(ray).reshape(distances, (-1, 1))
    return arguments.single(ray[..., None, 0, :] + distances * ray[..., None, 1, :])


def calculate_intersection_of_two_rays(ray0: Array, ray1: Array) -> tuple[Array, Array]:
    """Return the intersection of two lines, and its distance along each of the rays.

    Parameters
    ----------
    ray0 : array
        First ray, ``[2, 3]``, or a batch ``[m, 2, 3]``.
    ray1 : array
        Second ray, ``[2, 3]``, or a batch ``[m, 2, 3]``; a single ray is broadcast.

    Returns
    -------
    tuple of array
        Point ``[3]`` and distances ``[2]``, signed, of ray0 and ray1; ``[m, 3]`` and ``[m, 2]`` for batches. Where the
        lines are skew or parallel: ray0's start and two zeros. NaN where a ray is not finite.

    Notes
    -----
    Lines are taken as skew where they are farther apart than 1e-5 of the distance between their starts, plus 1e-8.

    Examples
    --------
    >>> from odak.raytracing import calculate_intersection_of_two_rays
    >>> calculate_intersection_of_two_rays([[0, 0, 0], [1, 0, 0]], [[3, -7, 0], [0, 1, 0]])
    (array([3., 0., 0.]), array([3., 7.]))
    """
    start0, direction0, start1, direction1 = _pair(ray0, ray1)
    t0, t1, meet = geometry.crossing_of_lines(start0, direction0, start1, direction1)
    xp = namespace(t0)
    # Lost rays are NaN here, unlike rays that do not intersect.
    none = 0.0 * xp.sum(start0 + direction0 + start1 + direction1, axis=-1, keepdims=True)
    distances = xp.where(meet[..., None], xp.stack((t0, t1), axis=-1), none)
    return arguments.single(start0 + distances[..., :1] * direction0), arguments.single(distances)


def find_nearest_points(ray0: Array, ray1: Array) -> tuple[Array, Array]:
    """Return, on each of two lines, the point nearest to the other line.

    Parameters
    ----------
    ray0 : array
        First ray, ``[2, 3]``, or a batch ``[m, 2, 3]``.
    ray1 : array
        Second ray, ``[2, 3]``, or a batch ``[m, 2, 3]``; a single ray is broadcast.

    Returns
    -------
    tuple of array
        Points ``[3]`` on ray0 and ray1, or ``[m, 3]``; both are the intersection of lines that intersect. For
        parallel lines: ray0's start and its projection onto ray1.

    Examples
    --------
    >>> from odak.raytracing import find_nearest_points
    >>> find_nearest_points([[1, 0, 0], [1, 0, 0]], [[0, 0, 5], [0, 1, 0]])
    (array([0., 0., 0.]), array([0., 0., 5.]))
    """
    start0, direction0, start1, direction1 = _pair(ray0, ray1)
    t0, t1 = geometry.nearest_on_lines(start0, direction0, start1, direction1)
    nearest0, nearest1 = start0 + t0[..., None] * direction0, start1 + t1[..., None] * direction1
    return arguments.single(nearest0), arguments.single(nearest1)


def _pair(ray0, ray1):
    """Return starts and directions ``[m, 3]`` of two sets of rays, of one shape."""
    ray0, ray1 = _validate.reals(ray0=ray0, ray1=ray1)
    ray0, ray1 = arguments.rays("ray0", ray0), arguments.rays("ray1", ray1)
    _validate.fitting(ray0=ray0, ray1=ray1)
    ray0, ray1 = namespace(ray0).broadcast_arrays(ray0, ray1)
    return ray0[..., 0, :], ray0[..., 1, :], ray1[..., 0, :], ray1[..., 1, :]


# Fraction of the largest power below which the phase of a sample is not used.
THRESHOLD = 1e-6


@_show.shown
class FieldRays(NamedTuple):
    """Rays of a field, one of each sample.

    Attributes
    ----------
    ray : array
        ``[..., rows, columns, 2, 3]``: the position of the sample, x along columns and y along rows, and the direction
        cosines. Directions of dark samples, of those without a bright neighbour along one of the axes, and of
        evanescent waves are NaN.
    power : array
        Squared amplitude, ``[..., rows, columns]``.
    path : array
        Optical path equivalent to the phase of the sample, within half a wavelength of 0, ``[..., rows, columns]``.

    Examples
    --------
    A converging lens of focal length 0.1 m bends a ray at x = 0.5 mm by −0.005 rad:

    >>> import numpy as np
    >>> from odak.raytracing import rays_from_field
    >>> from odak.wave import lens_phase
    >>> field = np.exp(1j * lens_phase((5, 201), 0.1, 1e-5, 500e-9))
    >>> rays = rays_from_field(field, 1e-5, 500e-9)
    >>> round(float(rays.ray[2, 150, 0, 0]), 6), round(float(rays.ray[2, 150, 1, 0]), 4)
    (0.0005, -0.005)
    """

    ray: Array
    power: Array
    path: Array


def rays_from_field(
    field: Array, dx: float | Sequence[float], wavelength: float, z: float = 0.0, threshold: float = THRESHOLD
) -> FieldRays:
    """Return the rays of a field: direction cosines (u, v) = λ/2π·∇φ.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``; sample ``n // 2`` of each axis is at x = y = 0.
    dx : float or sequence of float
        Pixel pitch, in the unit of the rays, one number or (rows, columns).
    wavelength : float
        Wavelength in the medium, in the unit of `dx`.
    z : float
        Position of the field's plane along the axis.
    threshold : float
        Samples whose power is below this fraction of the largest one are treated as dark.

    Returns
    -------
    FieldRays
        In the precision of the field; differentiable in it where it is a tensor.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    The gradient is interpreted as in geometric optics (Born and Wolf, Principles of Optics, 1999, section 3.1.1: the
    eikonal); it is the direction of propagation where there is one wave at each place, and the phase changes by less
    than π from one sample to the next. Differences of neighbours carry the gradient, to second order in `dx`, at the
    border of the illuminated samples as well.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.raytracing import rays_from_field
    >>> x = (np.arange(8) - 4) * 1e-6
    >>> wave = np.ones((8, 1)) * np.exp(2j * np.pi / 500e-9 * np.sin(np.radians(6)) * x)
    >>> rays = rays_from_field(wave, 1e-6, 500e-9).ray
    >>> rays.shape, np.degrees(np.arcsin(rays[0, 0, 1, 0])).round(6).item()
    ((8, 8, 2, 3), 6.0)
    """
    field = _array.to_complex(_validate.image("field", field))
    pitches = _validate.pair("dx", dx, positive=True)
    _validate.number("wavelength", wavelength, positive=True)
    _validate.number("z", z)
    _validate.number("threshold", threshold)
    xp = _array.namespace(field)
    real, imag = xp.real(field), xp.imag(field)
    power = real * real + imag * imag
    lit = power > threshold * xp.max(power, axis=(-2, -1), keepdims=True)
    (v, known_v), (u, known_u) = (_phase_difference(real, imag, lit, axis) for axis in (-2, -1))
    v, u = (wavelength / (2 * math.pi * pitch) * slope for pitch, slope in zip(pitches, (v, u), strict=True))
    rest = 1 - u * u - v * v
    exists = known_u & known_v & (rest > 0)
    direction = [xp.where(exists, value, math.nan) for value in (u, v, safe_sqrt(rest))]
    lines = [
        (xp.arange(n, dtype=real.dtype, device=_array.device_of(field)) - n // 2) * pitch
        for n, pitch in zip(field.shape[-2:], pitches, strict=True)
    ]
    zero = xp.zeros_like(real)
    point = [zero + lines[1][None, :], zero + lines[0][:, None], zero + z]
    ray = xp.stack([xp.stack(point, axis=-1), xp.stack(direction, axis=-1)], axis=-2)
    path = wavelength / (2 * math.pi) * _angle(real, imag, lit)
    return FieldRays(ray, power, path)


def _angle(real, imag, where):
    """Return the argument of complex numbers, 0 without a gradient elsewhere."""
    xp = _array.namespace(real)
    return xp.atan2(xp.where(where, imag, 0.0), xp.where(where, real, 1.0))


def _phase_difference(real, imag, lit, axis: int):
    """Return the increase of the phase between adjacent samples along an axis, and where it is defined."""
    xp = _array.namespace(real)
    count = real.shape[axis]

    def part(value, start, stop):
        return value[(..., slice(start, stop), slice(None))] if axis == -2 else value[..., start:stop]

    def joined(*values):
        return xp.concat(values, axis=axis)

    a, b, c, d = (part(value, start, start + count - 1) for start in (0, 1) for value in (real, imag))
    both = part(lit, 0, count - 1) & part(lit, 1, count)
    step = _angle(a * c + b * d, a * d - b * c, both)
    still, none = xp.zeros_like(part(real, 0, 1)), xp.zeros_like(part(lit, 0, 1))
    # Differences to the next and from the previous sample, and the differences beyond them on either side.
    ahead, has_ahead = joined(step, still), joined(both, none)
    past, has_past = joined(still, step), joined(none, both)
    if count < 2:
        return ahead, has_ahead
    ahead2, has_ahead2 = joined(part(step, 1, None), still, still), joined(part(both, 1, None), none, none)
    past2, has_past2 = joined(still, still, part(step, 0, -1)), joined(none, none, part(both, 0, -1))
    onward = xp.where(has_ahead2, (3 * ahead - ahead2) / 2, ahead)
    backward = xp.where(has_past2, (3 * past - past2) / 2, past)
    slope = xp.where(has_past & has_ahead, (past + ahead) / 2, xp.where(has_ahead, onward, backward))
    return slope, has_past | has_ahead
