"""Points on grids, discs, spheres and in boxes, and rays between points.

Sizes, radii, centres and angles may be arrays of any library: the points are then of that library, and differentiable.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from odak import _array, _validate
from odak._array import Array
from odak.tools._placing import all_of, numbers, on_disc, on_sphere, placed

__all__ = [
    "batch_of_rays",
    "box_volume_sample",
    "circular_sample",
    "circular_uniform_random_sample",
    "circular_uniform_sample",
    "grid_sample",
    "random_sample_point_cloud",
    "sphere_sample",
    "sphere_sample_uniform",
]

_ORIGIN = (0.0, 0.0, 0.0)


def random_sample_point_cloud(
    point_cloud: Array, no: int, p: Sequence[float] | None = None, *, seed: int | np.random.Generator | None = None
) -> Array:
    """Draw points from a cloud, with replacement.

    Parameters
    ----------
    point_cloud : array
        ``[n, ...]``.
    no : int
        Number of points to draw.
    p : sequence of float, optional
        Probability of each point, of sum 1; all alike by default.
    seed : int or numpy.random.Generator, optional
        Where the random numbers come from.

    Returns
    -------
    array
        ``[no, ...]`` of the same library and dtype.

    Raises
    ------
    TypeError
        If `point_cloud` is not an array or `no` not an integer.
    ValueError
        If the probabilities do not fit the cloud.
    """
    point_cloud = _validate.array("point_cloud", point_cloud)
    if point_cloud.ndim == 0 or point_cloud.shape[0] == 0:
        raise ValueError(f"point_cloud must be [n, ...] with at least one point, got {tuple(point_cloud.shape)}")
    count = point_cloud.shape[0]
    if p is not None:
        p = _validate.numbers(_validate.real("p", p))
        if len(p) != count or min(p, default=0) < 0 or abs(sum(p) - 1) > 1e-6:
            raise ValueError(
                f"p must be {count} probabilities of sum 1, got {len(p)} of sum {sum(p):.6g} "
                f"for a point_cloud of {count}"
            )
        p = np.asarray(p) / sum(p)
    if _validate.whole("no", no) > _validate.LONGEST_SIDE:
        raise ValueError(f"no must be at most {_validate.LONGEST_SIDE} points, got {no}")
    index = _generator(seed).choice(count, int(no), p=p)
    xp, device = _array.namespace(point_cloud), _array.device_of(point_cloud)
    return xp.take(point_cloud, xp.asarray(index, device=device), axis=0)


def sphere_sample(
    no: Sequence[int] = (10, 10),
    radius: float | Array = 1.0,
    center: Sequence[float] | Array = _ORIGIN,
    k: Sequence[float] | Array = (1, 2),
) -> Array:
    """Return points of a sphere on a grid of polar and azimuthal angles.

    Parameters
    ----------
    no : sequence of int
        Number of polar and of azimuthal angles.
    radius : float
        Radius of the sphere.
    center : sequence of float
        Its centre.
    k : sequence of float
        Spans of the two angles in units of π; the end of a span is left out.

    Returns
    -------
    array
        ``[no[0]·no[1], 3]``, center + radius·(sin ψ cos θ, sin ψ sin θ, cos ψ), ψ outer: the pole comes no[1] times.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.
    """
    rows, columns = _validate.size("no", no)
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    return on_sphere(i, j, (rows, columns), k, radius, center)


def sphere_sample_uniform(
    no: Sequence[int] = (10, 10),
    radius: float | Array = 1.0,
    center: Sequence[float] | Array = _ORIGIN,
    k: Sequence[float] | Array = (1, 2),
) -> Array:
    """Return the points of :func:`sphere_sample` in a sheared order of the two angles. They are not uniform in area.

    Parameters
    ----------
    no : sequence of int
        Number of polar and of azimuthal angles, which must be equal.
    radius, center, k
        As in :func:`sphere_sample`.

    Returns
    -------
    array
        ``[no[0]·no[1], 3]``; point (i, j) has the polar angle of index (j − i) mod n and the azimuth (j + i) mod n.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.
    """
    rows, columns = _validate.size("no", no)
    if rows != columns:
        raise ValueError(f"no must be two equal integers, got {no!r}")
    i, j = np.meshgrid(np.arange(rows), np.arange(rows), indexing="ij")
    return on_sphere((j - i) % rows, (j + i) % rows, (rows, rows), k, radius, center)


def box_volume_sample(
    no: Sequence[int] = (10, 10, 10),
    size: Sequence[float] | Array = (100.0, 100.0, 100.0),
    center: Sequence[float] | Array = _ORIGIN,
    angles: Sequence[float] | Array = _ORIGIN,
) -> Array:
    """Return the centres of the cells that a box is cut into.

    Parameters
    ----------
    no : sequence of int
        Number of cells along x, y and z.
    size : sequence of float
        Size of the box along x, y and z.
    center : sequence of float
        Its centre.
    angles : sequence of float
        Degrees by which it is turned about x, y and z, in this order, about its centre.

    Returns
    -------
    array
        ``[no[0]·no[1]·no[2], 3]``, x outer and z inner.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Examples
    --------
    >>> from odak.tools import box_volume_sample
    >>> box_volume_sample([2, 1, 1], [4.0, 1.0, 1.0])
    array([[-1.,  0.,  0.],
           [ 1.,  0.,  0.]])
    """
    if isinstance(no, str) or not isinstance(no, Iterable) or len(counts := tuple(no)) != 3:
        raise ValueError(f"no must be three integers, got {no!r}")
    counts = [_validate.side(f"no[{i}]", n) for i, n in enumerate(counts)]
    lines = [(np.arange(n) + 0.5) / n - 0.5 for n in counts]
    return placed(all_of(*lines), numbers("size", size, 3), center, angles)


def circular_sample(
    no: Sequence[int] = (10, 10),
    radius: float | Array = 10.0,
    center: Sequence[float] | Array = _ORIGIN,
    angles: Sequence[float] | Array = _ORIGIN,
) -> Array:
    """Return points of a disc on a polar grid, equally far apart in radius and angle, without the centre.

    Parameters
    ----------
    no : sequence of int
        Number of angles and of radii; the last radius is the rim.
    radius : float
        Radius of the disc.
    center : sequence of float
        Its centre.
    angles : sequence of float
        Degrees by which it is turned out of the plane z = 0 about x, y and z, in this order.

    Returns
    -------
    array
        ``[no[0]·no[1], 3]``, angles outer.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.
    """
    turns, steps = _validate.size("no", no)
    turn, distance = np.meshgrid(np.arange(1, turns + 1) / turns, np.arange(1, steps + 1) / steps, indexing="ij")
    return placed(on_disc(distance, turn), radius, center, angles, "radius")


def circular_uniform_random_sample(
    no: Sequence[int] = (10, 50),
    radius: float | Array = 10.0,
    center: Sequence[float] | Array = _ORIGIN,
    angles: Sequence[float] | Array = _ORIGIN,
    *,
    seed: int | np.random.Generator | None = None,
) -> Array:
    """Return random points of a disc, of equal density everywhere and independent of each other.

    Parameters
    ----------
    no : sequence of int
        Two integers; their product is the number of points.
    radius, center, angles
        As in :func:`circular_sample`.
    seed : int or numpy.random.Generator, optional
        Where the random numbers come from.

    Returns
    -------
    array
        ``[no[0]·no[1], 3]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.
    """
    rows, columns = _validate.size("no", no)
    share, turn = _generator(seed).random((2, rows * columns))
    return placed(on_disc(np.sqrt(share), turn), radius, center, angles, "radius")


def circular_uniform_sample(
    no: Sequence[int] = (10, 50),
    radius: float | Array = 10.0,
    center: Sequence[float] | Array = _ORIGIN,
    angles: Sequence[float] | Array = _ORIGIN,
) -> Array:
    """Return points of a disc on rings whose number of points grows with their radius.

    Parameters
    ----------
    no : sequence of int
        Number of rings, and number of points that the rim would hold.
    radius, center, angles
        As in :func:`circular_sample`.

    Returns
    -------
    array
        ``[n, 3]``. Ring i has the radius radius·i/no[0] and ⌊no[1]·i/no[0]⌋ points, the angle 2π·no[0]/(no[1]·i)
        apart; neither the centre nor the rim is among them.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.
    """
    rings, rim = _validate.size("no", no)
    counts = rim * np.arange(rings) // rings
    ring = np.repeat(np.arange(rings), counts)
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return placed(on_disc(ring / rings, step * rings / (rim * ring)), radius, center, angles, "radius")


def grid_sample(
    no: Sequence[int] = (10, 10),
    size: Sequence[float] | Array = (100.0, 100.0),
    center: Sequence[float] | Array = _ORIGIN,
    angles: Sequence[float] | Array = _ORIGIN,
) -> Array:
    """Return points of a rectangle on a regular grid, its edges included.

    Parameters
    ----------
    no : sequence of int
        Number of points along x and y; a single one sits in the middle.
    size : sequence of float
        Size along x and y.
    center : sequence of float
        Centre of the rectangle.
    angles : sequence of float
        Degrees by which it is turned out of the plane z = 0 about x, y and z, in this order.

    Returns
    -------
    array
        ``[no[0]·no[1], 3]``, x outer.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    See Also
    --------
    odak.learn.tools.grid_sample : Returns the three matrices as well.

    Examples
    --------
    >>> from odak.tools import grid_sample
    >>> grid_sample([2, 1], [2.0, 4.0])
    array([[-1.,  0.,  0.],
           [ 1.,  0.,  0.]])
    """
    lines = [np.linspace(-0.5, 0.5, n) if n > 1 else np.zeros(1) for n in _validate.size("no", no)]
    size = numbers("size", size, 2)
    xp = _array.namespace(size)
    size = xp.concat([size, xp.ones_like(size[:1])])
    return placed(all_of(*lines, np.zeros(1)), size, center, angles)


def batch_of_rays(entry: Array, exit: Array) -> Array:
    """Return the rays from points to points.

    Parameters
    ----------
    entry, exit : array
        ``[n, 3]`` each, or ``[3]`` or ``[1, 3]`` for one point that belongs to all.

    Returns
    -------
    array
        ``[n, 2, 3]``: starts and unit directions. Differentiable.

    Raises
    ------
    ValueError
        If a shape is wrong, the counts differ, or a ray has no length.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.tools import batch_of_rays
    >>> batch_of_rays(np.zeros(3), np.asarray([[3.0, 4.0, 0.0]]))
    array([[[0. , 0. , 0. ],
            [0.6, 0.8, 0. ]]])
    """
    for name, value in (("entry", entry), ("exit", exit)):
        _validate.array(name, value)
    xp = _array.namespace(entry, exit)
    like = entry if _array.is_array(entry) else exit if _array.is_array(exit) else np.zeros(1)
    like = like if xp.isdtype(like.dtype, "real floating") else xp.astype(like, xp.float64)
    ends = [_array.cast(value, like) for value in (entry, exit)]
    for name, end in zip(("entry", "exit"), ends, strict=True):
        if end.ndim not in (1, 2) or end.shape[-1] != 3:
            raise ValueError(f"{name} must be [n, 3] or [3], got {tuple(end.shape)}")
    starts, stops = (xp.reshape(end, (-1, 3)) for end in ends)
    if starts.shape[0] != stops.shape[0] and 1 not in (starts.shape[0], stops.shape[0]):
        raise ValueError(
            f"entry and exit must be as many, or one of them one; got {starts.shape[0]} and {stops.shape[0]}"
        )
    way = stops - starts
    length = xp.linalg.vector_norm(way, axis=-1, keepdims=True)
    if _array.is_readable(length) and bool(xp.any(length == 0)):
        raise ValueError("exit must differ from entry for every ray")
    return xp.stack([xp.broadcast_to(starts, way.shape), way / length], axis=1)


def _generator(seed):
    return np.random.default_rng(_validate.seed("seed", seed))
