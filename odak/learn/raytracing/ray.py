"""Rays as tensors ``[m, 2, 3]``: start and direction cosines."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from odak import _validate
from odak.learn._face import face_of, torch_face
from odak.learn._tensors import checked_generator, reals_of
from odak.learn.raytracing.primitives import batched, sheet_points
from odak.raytracing import arguments
from odak.raytracing import ray as core
from odak.tools.transformation import apply_matrix, rotation_matrix

if TYPE_CHECKING:
    from odak.learn._faces.raytracing_ray import *  # noqa: F403


if not TYPE_CHECKING:

    @face_of(core.calculate_intersection_of_two_rays, tensors=("ray0", "ray1"))
    def calculate_intersection_of_two_rays(function, **given):
        """Return the intersection of two lines, and its distance along each of the rays.

        Returns
        -------
        tuple of torch.Tensor
            Points ``[m, 3]`` and signed distances ``[m, 2]`` along both rays. Where the lines are skew or parallel:
            ray0's start and zeros without gradient. NaN where a ray is not finite.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import calculate_intersection_of_two_rays
        >>> ray0 = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        >>> ray1 = torch.tensor([[3.0, -7.0, 0.0], [0.0, 1.0, 0.0]])
        >>> calculate_intersection_of_two_rays(ray0, ray1)[1]
        tensor([[3., 7.]])
        """
        return batched(function(**given), 1)

    create_ray_from_all_pairs = torch_face(core.create_ray_from_all_pairs, tensors=("x0y0z0", "x1y1z1"))

    @face_of(core.create_ray_from_angles, tensors=("point", "angles"))
    def create_ray_from_angles(function, **given):
        """Return the ray from a point along the rotated z axis.

        Parameters
        ----------
        angles : torch.Tensor
            Degrees about X, Y and Z, ``[3]`` or ``[m, 3]``; zero angles point along +z.

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
        return batched(function(**given), 2)

    @face_of(core.create_ray_from_two_points, tensors=("x0y0z0", "x1y1z1"))
    def create_ray_from_two_points(function, **given):
        """Return rays from the first points towards the second ones.

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
        return batched(function(**given), 2)

    @face_of(core.find_nearest_points, tensors=("ray0", "ray1"))
    def find_nearest_points(function, **given):
        """Return, on each of two lines, the point nearest to the other line.

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
        return batched(function(**given), 1)

    get_points_along_a_ray_segment = torch_face(core.get_points_along_a_ray_segment, tensors=("ray", "distances"))

    @face_of(core.propagate_a_ray, tensors=("ray", "distance"))
    def propagate_ray(function, **given):
        """Return rays whose starts are moved along their directions; the directions are unchanged.

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
        return batched(function(**given), 2)

    propagate_a_ray = propagate_ray


def create_ray(xyz: torch.Tensor, abg: torch.Tensor, direction: bool = False) -> torch.Tensor:
    """Return rays from points with given angles to the three axes.

    Parameters
    ----------
    xyz : torch.Tensor
        Starts, ``[3]`` or ``[m, 3]``.
    abg : torch.Tensor
        Angles to the x, y and z axes in degrees, ``[3]`` or ``[m, 3]``; a single row is broadcast.
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
    xyz, abg = reals_of(xyz=xyz, abg=abg)
    xyz, abg = arguments.points("xyz", xyz), arguments.points("abg", abg)
    _validate.fitting(xyz=xyz, abg=abg)
    return arguments.as_rays(xyz, abg) if _validate.flag("direction", direction) else core.create_ray(xyz, abg)


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
    """Return random rays from a tilted grid of point sources, each within a cone about the grid's normal.

    Parameters
    ----------
    center : torch.Tensor
        Centre of the grid, ``[3]``.
    size : sequence of float
        Its extent along both axes; the outer sources are on its rim.
    no : sequence of int
        Number of sources along both axes.
    tilt : torch.Tensor
        Degrees about X, Y and Z, applied in this order.
    num_ray_per_light : int
        Number of rays of each source.
    angle_limit : float
        Half-angle of the cones in degrees, 0 … 180. Directions are uniform in solid angle.
    seed : int, optional
        Makes the result repeatable.
    generator : torch.Generator, optional
        The same, with the caller's generator.

    Returns
    -------
    torch.Tensor
        ``[no[0]·no[1]·num_ray_per_light, 2, 3]``: all sources, first axis slow, then all again. On center's device.

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
    center, size, tilt = reals_of(center=center, size=size, tilt=tilt)
    rows, columns = _validate.size("no", no)
    size = arguments.vector("size", size, 2)
    matrix = rotation_matrix(arguments.vector("tilt", tilt))
    sources = sheet_points(size, (rows, columns), matrix, arguments.vector("center", center))
    count = _validate.integer("num_ray_per_light", num_ray_per_light, minimum=0)
    return _cone(sources.repeat(count, 1), matrix, angle_limit, seed, generator)


def create_ray_from_point_w_luminous_angle(
    origin: torch.Tensor,
    num_ray: int,
    tilt: Sequence[float] | torch.Tensor,
    angle_limit: float | torch.Tensor,
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
    origin, tilt = reals_of(origin=origin, tilt=tilt)
    count = _validate.integer("num_ray", num_ray, minimum=0)
    matrix = rotation_matrix(arguments.vector("tilt", tilt))
    return _cone(arguments.vector("origin", origin).expand(count, 3), matrix, angle_limit, seed, generator)


def _cone(start: torch.Tensor, matrix: torch.Tensor, angle_limit, seed, generator) -> torch.Tensor:
    """Return rays of random directions about the rotated z axis, uniform in solid angle."""
    _validate.number("angle_limit", angle_limit)
    limit = torch.deg2rad(torch.as_tensor(angle_limit, dtype=start.dtype, device=start.device).reshape(()))
    if not start.is_cuda and not 0 <= float(angle_limit) <= 180:
        raise ValueError(f"angle_limit must lie within 0 … 180 degrees, got {float(angle_limit)!r}")
    seed = None if seed is None else _validate.integer("seed", seed)
    generator = checked_generator("generator", generator)
    if generator is None and seed is not None:
        generator = torch.Generator(device=start.device).manual_seed(seed)
    draw = torch.rand(2, len(start), dtype=start.dtype, device=start.device, generator=generator)
    # 1 − cos θ from the half angle, which is accurate for narrow cones where 1 − cos α would round to zero.
    rise = draw[0] * 2 * torch.sin(limit / 2) ** 2
    across, azimuth = (rise * (2 - rise)).clamp(min=0).sqrt(), 2 * torch.pi * draw[1]
    direction = torch.stack((across * torch.cos(azimuth), across * torch.sin(azimuth), 1 - rise), dim=-1)
    return arguments.as_rays(start, apply_matrix(matrix, direction))
