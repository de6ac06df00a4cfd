"""Rays as tensors ``[m, 2, 3]``: start and direction cosines."""

from collections.abc import Sequence
from typing import Any

import torch

from odak import _validate
from odak.learn.raytracing import arguments
from odak.raytracing.geometry import crossing_of_lines, nearest_on_lines, unit
from odak.raytracing.ray import warn_unless_unit
from odak.tools.transformation import apply_matrix, rotation_matrix

__all__ = [
    "calculate_intersection_of_two_rays",
    "create_ray",
    "create_ray_from_all_pairs",
    "create_ray_from_angles",
    "create_ray_from_grid_w_luminous_angle",
    "create_ray_from_point_w_luminous_angle",
    "create_ray_from_two_points",
    "find_nearest_points",
    "get_points_along_a_ray_segment",
    "propagate_a_ray",
    "propagate_ray",
]


def create_ray(xyz: torch.Tensor, abg: torch.Tensor, direction: bool = False) -> torch.Tensor:
    """Return rays from points with given angles to the three axes.

    Parameters
    ----------
    xyz : torch.Tensor
        Starts, ``[3]`` or ``[m, 3]``.
    abg : torch.Tensor
        Angles to the x, y and z axes in degrees, ``[3]`` or ``[m, 3]``; one row serves many starts, and the reverse.
    direction : bool
        Take `abg` as direction cosines.

    Returns
    -------
    torch.Tensor
        ``[m, 2, 3]``.

    Warns
    -----
    AccuracyWarning
        If the cosines of the angles do not make a direction of length 1 within 0.05 %; not looked at on a GPU.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import create_ray
    >>> create_ray(torch.tensor([1.0, 2.0, 3.0]), torch.tensor([90.0, 60.0, 30.0]))[0, 1].round(decimals=3).abs()
    tensor([0.0000, 0.5000, 0.8660])
    """
    xyz, abg = arguments.tensors(xyz=xyz, abg=abg)
    xyz, abg = arguments.points("xyz", xyz), arguments.points("abg", abg)
    _validate.fitting(xyz=xyz, abg=abg)
    if _validate.flag("direction", direction):
        return arguments.as_rays(xyz, abg)
    cosines = torch.cos(torch.deg2rad(abg))
    warn_unless_unit("abg", cosines)
    return arguments.as_rays(xyz, cosines)


def create_ray_from_two_points(x0y0z0: torch.Tensor, x1y1z1: torch.Tensor) -> torch.Tensor:
    """Return rays that start at the first points and head to the second ones.

    Parameters
    ----------
    x0y0z0 : torch.Tensor
        Starts, ``[3]`` or ``[m, 3]``; one start serves many ends.
    x1y1z1 : torch.Tensor
        Points that the rays head to, ``[3]`` or ``[m, 3]``; one end serves many starts.

    Returns
    -------
    torch.Tensor
        ``[m, 2, 3]``; NaN directions, with zero gradients, where start and end coincide.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import create_ray_from_two_points
    >>> create_ray_from_two_points(torch.zeros(3), torch.tensor([0.0, 3.0, 4.0]))
    tensor([[[0.0000, 0.0000, 0.0000],
             [0.0000, 0.6000, 0.8000]]])
    """
    start, end = arguments.tensors(x0y0z0=x0y0z0, x1y1z1=x1y1z1)
    start, end = arguments.points("x0y0z0", start), arguments.points("x1y1z1", end)
    _validate.fitting(x0y0z0=start, x1y1z1=end)
    return arguments.as_rays(start, unit(end - start))


def create_ray_from_all_pairs(x0y0z0: torch.Tensor, x1y1z1: torch.Tensor) -> torch.Tensor:
    """Return the rays from every start to every end.

    Parameters
    ----------
    x0y0z0 : torch.Tensor
        Starts, ``[m, 3]``.
    x1y1z1 : torch.Tensor
        Ends, ``[n, 3]``.

    Returns
    -------
    torch.Tensor
        ``[m·n, 2, 3]``; ray i·n + j goes from start i to end j. NaN where both coincide.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import create_ray_from_all_pairs
    >>> tuple(create_ray_from_all_pairs(torch.zeros(2, 3), torch.ones(3, 3)).shape)
    (6, 2, 3)
    """
    start, end = arguments.tensors(x0y0z0=x0y0z0, x1y1z1=x1y1z1)
    start, end = arguments.points("x0y0z0", start)[:, None], arguments.points("x1y1z1", end)
    return arguments.as_rays(start, unit(end - start)).reshape(-1, 2, 3)


def create_ray_from_angles(point: torch.Tensor, angles: torch.Tensor, mode: str = "XYZ") -> torch.Tensor:
    """Return rays from points along the rotated z axis.

    Parameters
    ----------
    point : torch.Tensor
        Starts, ``[3]`` or ``[m, 3]``.
    angles : torch.Tensor
        Degrees about X, Y and Z, ``[3]`` or ``[m, 3]``; zero angles point along +z.
    mode : str
        Order of the rotations, as in :func:`odak.learn.tools.rotate_points`.

    Returns
    -------
    torch.Tensor
        ``[m, 2, 3]``.

    Examples
    --------
    A rotation of 90° about y takes the z axis to the x axis:

    >>> import torch
    >>> from odak.learn.raytracing import create_ray_from_angles
    >>> ray = create_ray_from_angles(torch.zeros(3), torch.tensor([0.0, 90.0, 0.0]))
    >>> [round(abs(value), 6) for value in ray[0, 1].tolist()]
    [1.0, 0.0, 0.0]
    """
    point, angles = arguments.tensors(point=point, angles=angles)
    point, angles = arguments.points("point", point), arguments.points("angles", angles)
    _validate.fitting(point=point, angles=angles)
    return arguments.as_rays(point, rotation_matrix(angles, mode)[..., 2])


def create_ray_from_grid_w_luminous_angle(
    center: torch.Tensor,
    size: Sequence[float],
    no: Sequence[int],
    tilt: torch.Tensor,
    num_ray_per_light: int,
    angle_limit: float,
    seed: int | None = None,
    generator: torch.Generator | None = None,
) -> torch.Tensor:
    """Return random rays from a tilted grid of lights, each within a cone about the grid's normal.

    Parameters
    ----------
    center : torch.Tensor
        Centre of the grid, ``[3]``.
    size : sequence of float
        Its extent along both axes; the outer lights sit on its rim.
    no : sequence of int
        Number of lights along both axes.
    tilt : torch.Tensor
        Degrees about X, Y and Z, applied in this order.
    num_ray_per_light : int
        Rays of each light.
    angle_limit : float
        Half-angle of the cones in degrees, 0 … 180. Directions are uniform in solid angle.
    seed : int, optional
        Makes the result repeatable.
    generator : torch.Generator, optional
        The same, with the caller's generator.

    Returns
    -------
    torch.Tensor
        ``[no[0]·no[1]·num_ray_per_light, 2, 3]``: all lights, first axis slow, then all again. On center's device.

    Raises
    ------
    ValueError
        If an argument is outside its range.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import create_ray_from_grid_w_luminous_angle
    >>> create_ray_from_grid_w_luminous_angle(torch.zeros(3), [2, 2], [2, 3], torch.zeros(3), 5, 15.0, seed=1).shape
    torch.Size([30, 2, 3])
    """
    center, size, tilt = arguments.tensors(center=center, size=size, tilt=tilt)
    rows, columns = _validate.size("no", no)
    size = arguments.vector("size", size, 2)
    axes = [_spread(half, n) for half, n in zip(size / 2, (rows, columns), strict=True)]
    x, y = torch.meshgrid(*axes, indexing="ij")
    flat = torch.stack((x, y, torch.zeros_like(x)), dim=-1).reshape(-1, 3)
    matrix = rotation_matrix(arguments.vector("tilt", tilt))
    lights = apply_matrix(matrix, flat) + arguments.vector("center", center)
    count = _validate.integer("num_ray_per_light", num_ray_per_light, minimum=0)
    return _cone(lights.repeat(count, 1), matrix, angle_limit, seed, generator)


def create_ray_from_point_w_luminous_angle(
    origin: torch.Tensor,
    num_ray: int,
    tilt: Any,
    angle_limit: Any,
    seed: int | None = None,
    generator: torch.Generator | None = None,
) -> torch.Tensor:
    """Return random rays from one point within a cone.

    Parameters
    ----------
    origin : torch.Tensor
        Start of all rays, ``[3]``.
    num_ray : int
        Number of rays.
    tilt : torch.Tensor
        Degrees about X, Y and Z, applied in this order, by which the axis of the cone is rotated from +z.
    angle_limit : float
        Half angle of the cone in degrees, 0 … 180. Directions are uniform in solid angle.
    seed : int, optional
        Makes the result repeatable.
    generator : torch.Generator, optional
        The same, with the caller's generator.

    Returns
    -------
    torch.Tensor
        ``[num_ray, 2, 3]``, on origin's device.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import create_ray_from_point_w_luminous_angle
    >>> create_ray_from_point_w_luminous_angle(torch.zeros(3), 1, torch.zeros(3), 0.0)[0, 1]
    tensor([0., 0., 1.])
    """
    origin, tilt = arguments.tensors(origin=origin, tilt=tilt)
    count = _validate.integer("num_ray", num_ray, minimum=0)
    matrix = rotation_matrix(arguments.vector("tilt", tilt))
    return _cone(arguments.vector("origin", origin).expand(count, 3), matrix, angle_limit, seed, generator)


def propagate_ray(ray: torch.Tensor, distance: float | torch.Tensor) -> torch.Tensor:
    """Return rays whose starts have moved along their directions; the directions stay.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[m, 2, 3]``.
    distance : torch.Tensor or float
        A number, ``[1]``, ``[m]``, ``[m, 1]`` or ``[1, m]``, ``[...]`` for more axes; negative goes backwards.

    Returns
    -------
    torch.Tensor
        ``[m, 2, 3]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import propagate_ray
    >>> propagate_ray(torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.6, 0.8]]), 10.0)[0, 0]
    tensor([0., 6., 8.])
    """
    ray, distance = arguments.tensors(ray=ray, distance=distance)
    ray = arguments.rays("ray", ray)
    distance = distance.reshape(-1, 1) if ray.ndim == 3 else distance[..., None]
    _validate.fitting(ray=ray.shape[:-2], distance=distance.shape[:-1])
    return arguments.as_rays(ray[..., 0, :] + distance * ray[..., 1, :], ray[..., 1, :])


propagate_a_ray = propagate_ray


def get_points_along_a_ray_segment(ray: torch.Tensor, distances: torch.Tensor) -> torch.Tensor:
    """Return the points at given distances along rays.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]``, ``[1, 2, 3]`` or ``[m, 2, 3]``.
    distances : torch.Tensor
        ``[k]``.

    Returns
    -------
    torch.Tensor
        ``[k, 3]`` for one ray, ``[m, k, 3]`` for several.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import get_points_along_a_ray_segment
    >>> ray = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> get_points_along_a_ray_segment(ray, torch.tensor([1.0, 2.5]))[:, 2].tolist()
    [1.0, 2.5]
    """
    ray, distances = arguments.tensors(ray=ray, distances=distances)
    ray = arguments.rays("ray", ray)
    points = ray[..., None, 0, :] + distances.reshape(-1, 1) * ray[..., None, 1, :]
    return points[0] if ray.shape[:-2] == (1,) else points


def calculate_intersection_of_two_rays(ray0: torch.Tensor, ray1: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the common points of lines and how far along each of the rays they lie.

    Parameters
    ----------
    ray0 : torch.Tensor
        First ray, ``[2, 3]``, or a batch ``[m, 2, 3]``.
    ray1 : torch.Tensor
        Second ray, ``[2, 3]``, or a batch ``[m, 2, 3]``; one of either serves many of the other.

    Returns
    -------
    tuple of torch.Tensor
        Points ``[m, 3]`` and signed distances ``[m, 2]``. Where the lines are skew or parallel: ray0's start and zeros
        without gradient. See :func:`odak.raytracing.calculate_intersection_of_two_rays`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import calculate_intersection_of_two_rays
    >>> ray0 = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> ray1 = torch.tensor([[3.0, -7.0, 0.0], [0.0, 1.0, 0.0]])
    >>> calculate_intersection_of_two_rays(ray0, ray1)[1]
    tensor([[3., 7.]])
    """
    start0, direction0, start1, direction1 = _pair(ray0, ray1)
    t0, t1, meet = crossing_of_lines(start0, direction0, start1, direction1)
    distances = torch.where(meet[..., None], torch.stack((t0, t1), dim=-1), 0.0)
    return start0 + distances[..., :1] * direction0, distances


def find_nearest_points(ray0: torch.Tensor, ray1: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return, on each of two lines, the point nearest to the other line.

    Parameters
    ----------
    ray0 : torch.Tensor
        First ray, ``[2, 3]``, or a batch ``[m, 2, 3]``.
    ray1 : torch.Tensor
        Second ray, ``[2, 3]``, or a batch ``[m, 2, 3]``; one of either serves many of the other.

    Returns
    -------
    tuple of torch.Tensor
        Points ``[m, 3]`` on ray0 and ray1; for parallel lines ray0's start and its foot on ray1.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import find_nearest_points
    >>> ray0 = torch.tensor([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> ray1 = torch.tensor([[0.0, 0.0, 5.0], [0.0, 1.0, 0.0]])
    >>> [point.tolist() for point in find_nearest_points(ray0, ray1)]
    [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 5.0]]]
    """
    start0, direction0, start1, direction1 = _pair(ray0, ray1)
    t0, t1 = nearest_on_lines(start0, direction0, start1, direction1)
    return start0 + t0[..., None] * direction0, start1 + t1[..., None] * direction1


def _pair(ray0, ray1) -> tuple[torch.Tensor, ...]:
    ray0, ray1 = arguments.tensors(ray0=ray0, ray1=ray1)
    ray0, ray1 = arguments.rays("ray0", ray0), arguments.rays("ray1", ray1)
    _validate.fitting(ray0=ray0, ray1=ray1)
    ray0, ray1 = torch.broadcast_tensors(ray0, ray1)
    return ray0[..., 0, :], ray0[..., 1, :], ray1[..., 0, :], ray1[..., 1, :]


def _spread(half: torch.Tensor, count: int) -> torch.Tensor:
    """Return linspace(−half, half, count), differentiable in `half`."""
    return half * torch.linspace(-1, 1, count, dtype=half.dtype, device=half.device)


def _cone(start: torch.Tensor, matrix: torch.Tensor, angle_limit, seed, generator) -> torch.Tensor:
    """Return rays of random directions about the rotated z axis, uniform in solid angle."""
    limit = _half_angle(angle_limit, start)
    seed = None if seed is None else _validate.integer("seed", seed)
    if generator is not None and not isinstance(generator, torch.Generator):
        raise TypeError(f"generator must be a torch.Generator, got {type(generator).__name__}")
    if generator is None and seed is not None:
        generator = torch.Generator(device=start.device).manual_seed(seed)
    draw = torch.rand(2, len(start), dtype=start.dtype, device=start.device, generator=generator)
    # 1 − cos θ from the half angle, which keeps narrow cones exact where 1 − cos α would round to zero.
    rise = draw[0] * 2 * torch.sin(limit / 2) ** 2
    across, turn = (rise * (2 - rise)).clamp(min=0).sqrt(), 2 * torch.pi * draw[1]
    direction = torch.stack((across * torch.cos(turn), across * torch.sin(turn), 1 - rise), dim=-1)
    return arguments.as_rays(start, apply_matrix(matrix, direction))


def _half_angle(angle_limit, like: torch.Tensor) -> torch.Tensor:
    _validate.number("angle_limit", angle_limit)
    angle = torch.as_tensor(angle_limit, dtype=like.dtype, device=like.device).reshape(())
    if not like.is_cuda and not 0 <= float(angle.detach()) <= 180:
        raise ValueError(f"angle_limit must lie within 0 … 180 degrees, got {float(angle.detach())!r}")
    return torch.deg2rad(angle)
