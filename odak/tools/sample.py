"""Points on grids, discs, spheres and in boxes, and rays between points.

Sizes, radii, centres and angles may be arrays of any library: the points are then of that library, and differentiable.
"""

import math
from collections.abc import Iterable, Sequence
from types import ModuleType

import numpy as np

from odak import _array, _validate
from odak._array import Array, ArrayT, Device, DType
from odak.tools.transformation import apply_matrix, rotation_matrix

_ORIGIN = (0.0, 0.0, 0.0)


def random_sample_point_cloud(
    point_cloud: ArrayT, no: int, p: Sequence[float] | None = None, *, seed: int | np.random.Generator | None = None
) -> ArrayT:
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
        Generator of the random numbers.

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

    Examples
    --------
    >>> import numpy as np
    >>> from odak.tools import random_sample_point_cloud
    >>> cloud = np.asarray([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    >>> random_sample_point_cloud(cloud, 2, p=[0.0, 1.0], seed=0).tolist()
    [[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]
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
    _validate.whole("no", no, most=_validate.LONGEST_SIDE)
    index = _generator(seed).choice(count, int(no), p=p)
    xp, device = _array.namespace(point_cloud), _array.device_of(point_cloud)
    return xp.take(point_cloud, xp.asarray(index, device=device), axis=0)


def sphere_sample(
    no: Sequence[int] = (10, 10),
    radius: float | Array = 1.0,
    center: Sequence[float] | Array = _ORIGIN,
    k: Sequence[float] | Array = (1, 2),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
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
    xp : module, optional
        Array library of the points where no array is given; NumPy by default.
    device : optional
        Device of the points; by default the device of the first array given.
    dtype : optional
        Real dtype of the points; by default the widest of the floating arrays given, else the library's default.

    Returns
    -------
    array
        ``[no[0]·no[1], 3]``, center + radius·(sin ψ cos θ, sin ψ sin θ, cos ψ), ψ outer: the pole comes no[1] times.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Examples
    --------
    >>> from odak.tools import sphere_sample
    >>> points = sphere_sample([5, 8], radius=2.0)
    >>> tuple(points.shape), round(float(((points**2).sum(-1) ** 0.5).mean()), 4)
    ((40, 3), 2.0)
    """
    rows, columns = _validate.size("no", no)
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    return _on_sphere(i, j, (rows, columns), k, radius, center, xp=xp, device=device, dtype=dtype)


def sphere_sample_uniform(
    no: Sequence[int] = (10, 10),
    radius: float | Array = 1.0,
    center: Sequence[float] | Array = _ORIGIN,
    k: Sequence[float] | Array = (1, 2),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return the points of :func:`sphere_sample` in a sheared order of the two angles; they are not uniform in area.

    Parameters
    ----------
    no : sequence of int
        Number of polar and of azimuthal angles, which must be equal.
    radius : float
        Radius of the sphere.
    center : sequence of float
        Its centre.
    k : sequence of float
        Spans of the two angles in units of π; the end of a span is left out.
    xp : module, optional
        Array library of the points where no array is given; NumPy by default.
    device : optional
        Device of the points; by default the device of the first array given.
    dtype : optional
        Real dtype of the points; by default the widest of the floating arrays given, else the library's default.

    Returns
    -------
    array
        ``[no[0]·no[1], 3]``; point (i, j) has the polar angle of index (j − i) mod n and the azimuth (j + i) mod n.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Examples
    --------
    >>> from odak.tools import sphere_sample_uniform
    >>> points = sphere_sample_uniform([5, 5], radius=2.0)
    >>> tuple(points.shape), round(float(((points**2).sum(-1) ** 0.5).mean()), 4)
    ((25, 3), 2.0)
    """
    rows, columns = _validate.size("no", no)
    if rows != columns:
        raise ValueError(f"no must be two equal integers, got {no!r}")
    i, j = np.meshgrid(np.arange(rows), np.arange(rows), indexing="ij")
    return _on_sphere(
        (j - i) % rows, (j + i) % rows, (rows, rows), k, radius, center, xp=xp, device=device, dtype=dtype
    )


def box_volume_sample(
    no: Sequence[int] = (10, 10, 10),
    size: Sequence[float] | Array = (100.0, 100.0, 100.0),
    center: Sequence[float] | Array = _ORIGIN,
    angles: Sequence[float] | Array = _ORIGIN,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
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
        Degrees of its rotation about x, y and z, in this order, about its centre.
    xp : module, optional
        Array library of the points where no array is given; NumPy by default.
    device : optional
        Device of the points; by default the device of the first array given.
    dtype : optional
        Real dtype of the points; by default the widest of the floating arrays given, else the library's default.

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
    >>> box_volume_sample([2, 1, 1], [4.0, 1.0, 1.0]).tolist()
    [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    """
    if isinstance(no, str) or not isinstance(no, Iterable) or len(counts := tuple(no)) != 3:
        raise ValueError(f"no must be three integers, got {no!r}")
    counts = [_validate.side(f"no[{i}]", n) for i, n in enumerate(counts)]
    lines = [(np.arange(n) + 0.5) / n - 0.5 for n in counts]
    return _placed(_combinations(*lines), size, 3, center, angles, xp=xp, device=device, dtype=dtype)


def circular_sample(
    no: Sequence[int] = (10, 10),
    radius: float | Array = 10.0,
    center: Sequence[float] | Array = _ORIGIN,
    angles: Sequence[float] | Array = _ORIGIN,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return points of a disc on a polar grid, equally spaced in radius and angle, without the centre.

    Parameters
    ----------
    no : sequence of int
        Number of angles and of radii; the last radius is the rim.
    radius : float
        Radius of the disc.
    center : sequence of float
        Its centre.
    angles : sequence of float
        Degrees of its rotation out of the plane z = 0 about x, y and z, in this order.
    xp : module, optional
        Array library of the points where no array is given; NumPy by default.
    device : optional
        Device of the points; by default the device of the first array given.
    dtype : optional
        Real dtype of the points; by default the widest of the floating arrays given, else the library's default.

    Returns
    -------
    array
        ``[no[0]·no[1], 3]``, angles outer.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Examples
    --------
    The largest distance from the centre is the radius:

    >>> from odak.tools import circular_sample
    >>> points = circular_sample([6, 3], radius=2.0)
    >>> tuple(points.shape), round(float(((points**2).sum(-1) ** 0.5).max()), 4)
    ((18, 3), 2.0)
    """
    rows, columns = _validate.size("no", no)
    cycles, distance = np.meshgrid(np.arange(1, rows + 1) / rows, np.arange(1, columns + 1) / columns, indexing="ij")
    return _placed(_on_disc(distance, cycles), radius, 1, center, angles, xp=xp, device=device, dtype=dtype)


def circular_uniform_random_sample(
    no: Sequence[int] = (10, 50),
    radius: float | Array = 10.0,
    center: Sequence[float] | Array = _ORIGIN,
    angles: Sequence[float] | Array = _ORIGIN,
    *,
    seed: int | np.random.Generator | None = None,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return independent random points of uniform density on a disc.

    Parameters
    ----------
    no : sequence of int
        Two integers; their product is the number of points.
    radius : float
        Radius of the disc.
    center : sequence of float
        Its centre.
    angles : sequence of float
        Degrees of its rotation out of the plane z = 0 about x, y and z, in this order.
    seed : int or numpy.random.Generator, optional
        Generator of the random numbers.
    xp : module, optional
        Array library of the points where no array is given; NumPy by default.
    device : optional
        Device of the points; by default the device of the first array given.
    dtype : optional
        Real dtype of the points; by default the widest of the floating arrays given, else the library's default.

    Returns
    -------
    array
        ``[no[0]·no[1], 3]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Examples
    --------
    >>> from odak.tools import circular_uniform_random_sample
    >>> points = circular_uniform_random_sample([20, 50], radius=2.0, seed=0)
    >>> tuple(points.shape), bool(((points**2).sum(-1) <= 4.0001).all())
    ((1000, 3), True)
    """
    rows, columns = _validate.size("no", no)
    share, cycles = _generator(seed).random((2, rows * columns))
    return _placed(_on_disc(np.sqrt(share), cycles), radius, 1, center, angles, xp=xp, device=device, dtype=dtype)


def circular_uniform_sample(
    no: Sequence[int] = (10, 50),
    radius: float | Array = 10.0,
    center: Sequence[float] | Array = _ORIGIN,
    angles: Sequence[float] | Array = _ORIGIN,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return points of a disc on rings whose number of points grows with their radius.

    Parameters
    ----------
    no : sequence of int
        Number of rings, and number of points on the rim.
    radius : float
        Radius of the disc.
    center : sequence of float
        Its centre.
    angles : sequence of float
        Degrees of its rotation out of the plane z = 0 about x, y and z, in this order.
    xp : module, optional
        Array library of the points where no array is given; NumPy by default.
    device : optional
        Device of the points; by default the device of the first array given.
    dtype : optional
        Real dtype of the points; by default the widest of the floating arrays given, else the library's default.

    Returns
    -------
    array
        ``[n, 3]``. Ring i has the radius radius·i/no[0] and ⌊no[1]·i/no[0]⌋ points, the angle 2π·no[0]/(no[1]·i)
        apart; neither the centre nor the rim is among them.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Examples
    --------
    Four rings of up to 8 points hold ⌊8·i/4⌋ points each, for i = 1, 2, 3:

    >>> from odak.tools import circular_uniform_sample
    >>> tuple(circular_uniform_sample([4, 8], radius=2.0).shape)
    (12, 3)
    """
    rings, rim = _validate.size("no", no)
    counts = rim * np.arange(rings) // rings
    ring = np.repeat(np.arange(rings), counts)
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    points = _on_disc(ring / rings, step * rings / (rim * ring))
    return _placed(points, radius, 1, center, angles, xp=xp, device=device, dtype=dtype)


def grid_sample(
    no: Sequence[int] = (10, 10),
    size: Sequence[float] | Array = (100.0, 100.0),
    center: Sequence[float] | Array = _ORIGIN,
    angles: Sequence[float] | Array = _ORIGIN,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
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
        Degrees of its rotation out of the plane z = 0 about x, y and z, in this order.
    xp : module, optional
        Array library of the points where no array is given; NumPy by default.
    device : optional
        Device of the points; by default the device of the first array given.
    dtype : optional
        Real dtype of the points; by default the widest of the floating arrays given, else the library's default.

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
    points = _combinations(*lines, np.zeros(1))
    return _placed(points, size, 2, center, angles, xp=xp, device=device, dtype=dtype)


def batch_of_rays(entry: Array, exit: Array) -> Array:
    """Return the rays from entry points to exit points.

    Parameters
    ----------
    entry : array
        Starts of the rays, ``[n, 3]``, or ``[3]`` or ``[1, 3]`` for a start that all share.
    exit : array
        Points that the rays pass, ``[n, 3]``, or ``[3]`` or ``[1, 3]`` for a point that all share.

    Returns
    -------
    array
        ``[n, 2, 3]``: starts and unit directions. Differentiable.

    Raises
    ------
    ValueError
        If a shape is wrong, the counts differ, or the start and the end of a ray coincide.

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
        _validate.shaped(name, end, "[n, 3] or [3]")
    starts, stops = (xp.reshape(end, (-1, 3)) for end in ends)
    if starts.shape[0] != stops.shape[0] and 1 not in (starts.shape[0], stops.shape[0]):
        raise ValueError(
            "entry and exit must have the same number of points, or one of them a single one; "
            f"got {starts.shape[0]} and {stops.shape[0]}"
        )
    way = stops - starts
    length = xp.linalg.vector_norm(way, axis=-1, keepdims=True)
    if _array.is_readable(length) and bool(xp.any(length == 0)):
        raise ValueError("exit must differ from entry for every ray")
    return xp.stack([xp.broadcast_to(starts, way.shape), way / length], axis=1)


def _generator(seed):
    return np.random.default_rng(_validate.seed("seed", seed))


def _on_sphere(i, j, no, k, radius, center, **where):
    """Return the points of a sphere whose polar and azimuthal angles have the indices i and j."""
    spans = _validate.few("k", k, 2)
    polar, azimuth = (span * math.pi * index.ravel() / n for span, index, n in zip(spans, (i, j), no, strict=True))
    ring = np.sin(polar)
    points = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), np.cos(polar)], axis=-1)
    return _placed(points, radius, 1, center, None, **where)


def _on_disc(distance, cycles):
    """Return points of the unit disc in z = 0 from distances and angles in units of 2π."""
    angle = 2 * math.pi * cycles.ravel()
    distance = distance.ravel()
    return np.stack([distance * np.cos(angle), distance * np.sin(angle), np.zeros_like(angle)], axis=-1)


def _combinations(*lines):
    """Return all combinations of the coordinates of several axes, the first axis outer."""
    return np.stack([line.ravel() for line in np.meshgrid(*lines, indexing="ij")], axis=-1)


def _placed(points, scale, extents, center, angles, *, xp, device, dtype):
    """Return points scaled, rotated about the origin and moved, as an array of the library of the arguments."""
    xp, device, dtype = _array.placement(scale, center, angles, xp=xp, device=device, dtype=dtype)

    def numbers(name, value, count):
        value = xp.reshape(_array.converted(_validate.real(name, value), xp, device, dtype), (-1,))
        if value.shape[0] != count:
            raise ValueError(
                f"{name} must be {'one number' if count == 1 else f'{count} numbers'}, got {value.shape[0]}"
            )
        return value

    points = _array.converted(points, xp, device, dtype)
    scale = numbers("radius" if extents == 1 else "size", scale, extents)
    if extents == 2:
        scale = xp.concat([scale, xp.ones_like(scale[:1])])
    points = points * scale
    if angles is not None:
        points = apply_matrix(rotation_matrix(numbers("angles", angles, 3)), points)
    return points + numbers("center", center, 3)
