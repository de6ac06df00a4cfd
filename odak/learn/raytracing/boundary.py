"""Rays at surfaces: differentiable intersections, normals, reflection, refraction and Fresnel coefficients."""

from collections.abc import Sequence
from typing import Any

import torch

from odak import _validate
from odak._array import is_readable
from odak.learn._face import torch_face
from odak.learn._tensors import reals_of
from odak.learn.raytracing.primitives import batched
from odak.learn.raytracing.recompute import in_pieces
from odak.raytracing import arguments, closed_forms, geometry, interfaces
from odak.raytracing import boundary as core
from odak.raytracing import components as vec
from odak.raytracing.primitives import split_cylinder

__all__ = [
    "fresnel_coefficients",
    "get_cylinder_normal",
    "get_sphere_normal_torch",
    "get_triangle_normal",
    "intersect_w_circle",
    "intersect_w_cylinder",
    "intersect_w_sphere",
    "intersect_w_surface",
    "intersect_w_surface_batch",
    "intersect_w_triangle",
    "intersect_w_triangle_batch",
    "reflect",
    "refract",
]


def _reflect(core, input_ray, normal):
    ray, normal = _validate.reals(input_ray=input_ray, normal=normal)
    ray, normal = arguments.rays("input_ray", ray), arguments.rays("normal", normal)
    _validate.fitting(input_ray=ray, normal=normal)

    def reflected(ray, normal):
        return vec.join(vec.split(normal[..., 0, :]), interfaces.reflected(ray[..., 1, :], normal[..., 1, :]))

    return in_pieces(reflected, (2, 2), ray, normal)


def _refract(core, vector, normvector, n1, n2, error=0.01):
    ray, normal, n1, n2 = _validate.reals(vector=vector, normvector=normvector, n1=n1, n2=n2)
    ray, normal = arguments.rays("vector", ray), arguments.rays("normvector", normal)
    n1, n2 = n1.reshape(-1), n2.reshape(-1)
    _validate.fitting(vector=ray.shape[:-2], normvector=normal.shape[:-2], n1=n1, n2=n2)

    def refracted(ray, normal, n1, n2):
        direction, _, _ = interfaces.refracted(ray[..., 1, :], normal[..., 1, :], n1, n2)
        return vec.join(vec.split(normal[..., 0, :]), direction)

    return in_pieces(refracted, (2, 2, 0, 0), ray, normal, n1, n2)


fresnel_coefficients = torch_face(
    core.fresnel_coefficients,
    tensors=("ray", "normal"),
    describe="""
    Examples
    --------
    At normal incidence glass reflects ((n − 1)/(n + 1))²:

    >>> import torch
    >>> from odak.learn.raytracing import fresnel_coefficients
    >>> ray = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> round(fresnel_coefficients(ray, ray, 1.0, 1.5).reflectance_s.item(), 4)
    0.04
    """,
)
get_cylinder_normal = torch_face(
    core.get_cylinder_normal,
    tensors=("point", "cylinder"),
    through=batched(2),
    describe="""
    Returns
    -------
    torch.Tensor
        ``[m, 2, 3]``. Each starts at its point's foot on the axis.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import define_cylinder, get_cylinder_normal
    >>> get_cylinder_normal(torch.tensor([0.0, 2, 3]), define_cylinder(torch.zeros(3), 2.0)).tolist()
    [[[0.0, 0.0, 3.0], [0.0, 1.0, 0.0]]]
    """,
)
get_sphere_normal_torch = torch_face(
    core.get_sphere_normal,
    name="get_sphere_normal_torch",
    tensors=("point", "sphere"),
    through=batched(2),
    describe="""
    Returns
    -------
    torch.Tensor
        ``[m, 2, 3]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import get_sphere_normal_torch
    >>> get_sphere_normal_torch(torch.tensor([0.0, 0, 3]), torch.tensor([0.0, 0, 1, 2]))[0, 1].tolist()
    [0.0, 0.0, -1.0]
    """,
)
get_triangle_normal = torch_face(
    core.get_triangle_normal,
    tensors=("triangle", "triangle_center"),
    describe="""
    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import get_triangle_normal
    >>> get_triangle_normal(torch.tensor([[0.0, 0, 0], [3, 0, 0], [0, 3, 0]])).tolist()
    [[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """,
)
reflect = torch_face(
    core.reflect,
    tensors=("input_ray", "normal"),
    through=_reflect,
    describe="""
    Returns
    -------
    torch.Tensor
        ``[m, 2, 3]``: rays that start at the normals' points; NaN where a normal is zero.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import reflect
    >>> normal = torch.tensor([[1.0, 1.0, 1.0], [0.0, 0.0, 2.0]])
    >>> reflect(torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.6, 0.8]]), normal)[0, 1]
    tensor([ 0.0000,  0.6000, -0.8000])
    """,
)
refract = torch_face(
    core.refract,
    tensors=("vector", "normvector", "n1", "n2"),
    through=_refract,
    describe="""
    Returns
    -------
    torch.Tensor
        ``[m, 2, 3]``: rays that start at the normals' points. A totally reflected ray has a NaN direction and no
        gradient. Differentiable in rays, normals and indices.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import refract
    >>> normal = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> refract(torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.6, 0.8]]), normal, 1.0, 1.5)[0, 1]
    tensor([0.0000, 0.4000, 0.9165])
    """,
)


def intersect_w_sphere(
    ray: torch.Tensor,
    sphere: torch.Tensor,
    learning_rate: float = 2e-1,
    number_of_steps: int = 5000,
    error_threshold: float = 1e-2,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Intersect rays with a sphere in closed form, at the nearest point ahead, or the exit when the ray starts inside.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[m, 2, 3]``.
    sphere : torch.Tensor
        ``[4]`` or ``[1, 4]``, or ``[m, 4]``: one for each ray.
    learning_rate : float, default: 0.2
        Not used; kept for older calls, which iterated.
    number_of_steps : int, default: 5000
        Not used; kept for older calls.
    error_threshold : float, default: 0.01
        Not used; kept for older calls.

    Returns
    -------
    tuple of torch.Tensor
        - rays ``[k, 2, 3]`` from the points hit, in the rays' directions, for the k rays that hit;
        - normals ``[k, 2, 3]``: the sphere's centre and the outward unit normal;
        - distances ``[m]`` of all rays, NaN for those that miss, which have no gradient;
        - bool ``[m]``: which rays hit.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import define_sphere, intersect_w_sphere
    >>> ray = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> intersect_w_sphere(ray, define_sphere(torch.tensor([0.0, 0.0, 5.0]), torch.tensor([3.0])))[2]
    tensor([2.])
    """
    ray, sphere = reals_of(ray=ray, sphere=sphere)
    ray, sphere = arguments.rays("ray", ray), arguments.shaped("sphere", sphere, (4,), "[4] or [m, 4]")
    if ray.ndim == 3 and len(sphere) not in (1, len(ray)) and len(ray) != 1:
        raise ValueError(f"sphere must hold one sphere or one for each of {len(ray)} rays, got {len(sphere)}")
    rays, normals, distance, check = in_pieces(_sphere_hits, (2, 1), ray, sphere)
    # Rays that all hit need not be picked; a GPU would have to be asked first.
    if not (is_readable(check) and bool(check.all())):
        rays, normals = rays[check], normals[check]
    return rays, normals, distance, check


def intersect_w_triangle(ray: torch.Tensor, triangle: torch.Tensor) -> tuple:
    """Intersect rays with one triangle, ahead of the starts or behind them.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[m, 2, 3]``.
    triangle : torch.Tensor
        ``[3, 3]`` or ``[1, 3, 3]``.

    Returns
    -------
    tuple
        - normals ``[m, 2, 3]``: where each ray meets the triangle's plane, and the unit normal;
        - distances ``[m, 1]`` to the plane, negative behind the start, NaN for rays along it;
        - the k rays that hit the triangle, ``[k, 2, 3]``;
        - their normals ``[k, 2, 3]``;
        - bool ``[1, m]``: which rays hit, by the rule of :func:`odak.learn.raytracing.is_it_on_triangle`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import intersect_w_triangle
    >>> triangle = torch.tensor([[0.0, 0, 5], [4, 0, 5], [0, 4, 5]])
    >>> rays = torch.tensor([[[1.0, 1, 0], [0, 0, 1]], [[4, 4, 0], [0, 0, 1]]])
    >>> _, distances, _, _, hits = intersect_w_triangle(rays, triangle)
    >>> distances.flatten().tolist(), hits.tolist()
    ([5.0, 5.0], [[True, False]])
    """
    ray, triangle = reals_of(ray=ray, triangle=triangle)
    ray, triangle = arguments.rays("ray", ray), arguments.triangles("triangle", triangle)
    if len(triangle) != 1:
        raise ValueError(f"triangle must be one triangle [3, 3] or [1, 3, 3], got {tuple(triangle.shape)}")
    normal, distance, check = _meet_triangles(ray, triangle)
    return normal[0], distance[0][..., None], ray[check[0]], normal[0][check[0]], check


def intersect_w_triangle_batch(ray: torch.Tensor, triangle: torch.Tensor) -> tuple:
    """Intersect many rays with many triangles.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[n, 2, 3]``.
    triangle : torch.Tensor
        ``[3, 3]`` or ``[m, 3, 3]``.

    Returns
    -------
    tuple
        - normals ``[m, n, 2, 3]``: where each ray meets each plane, and the unit normals;
        - lists with one entry for each triangle that is hit, in order: distances ``[k]``, rays ``[k, 2, 3]`` and
          normals ``[k, 2, 3]`` of the rays that hit it;
        - bool ``[m, n]``: which ray hits which triangle.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import intersect_w_triangle_batch
    >>> triangle = torch.tensor([[0.0, 0, 5], [4, 0, 5], [0, 4, 5]])
    >>> triangles = torch.stack([triangle, triangle + 10])
    >>> hits = intersect_w_triangle_batch(torch.tensor([[1.0, 1, 0], [0, 0, 1]]), triangles)[-1]
    >>> hits.tolist()
    [[True], [False]]
    """
    ray, triangle = reals_of(ray=ray, triangle=triangle)
    ray, triangle = arguments.rays("ray", ray), arguments.triangles("triangle", triangle)
    normal, distance, check = _meet_triangles(ray, triangle)
    struck = check.flatten(1).any(dim=1).nonzero().flatten().tolist()
    distances = [distance[i][check[i]] for i in struck]
    return normal, distances, [ray[check[i]] for i in struck], [normal[i][check[i]] for i in struck], check


def intersect_w_surface(ray: torch.Tensor, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Intersect rays with the plane through three points.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[m, 2, 3]``.
    points : torch.Tensor
        Three points, ``[3, 3]`` or ``[1, 3, 3]``; ``[m, 3, 3]`` gives each ray its own plane.

    Returns
    -------
    tuple of torch.Tensor
        Normals ``[m, 2, 3]`` (where the plane is met, unit normal) and distances ``[m, 1]``, negative behind the
        start. Point and distance are NaN for rays along the plane.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import define_plane, intersect_w_surface
    >>> ray = torch.tensor([[0.0, 0.0, 20.0], [0.0, 0.6, 0.8]])
    >>> intersect_w_surface(ray, define_plane(torch.tensor([0.0, 0.0, 10.0])))[1]
    tensor([[-12.5000]])
    """
    ray, points = reals_of(ray=ray, points=points)
    ray, points = arguments.rays("ray", ray), arguments.triangles("points", points)
    normal, distance = in_pieces(_plane_hits, (2, 1, 1), ray, *_planes(points))
    return normal, distance[..., None]


def intersect_w_surface_batch(ray: Any, triangle: Any) -> tuple[torch.Tensor, torch.Tensor]:
    """Intersect n rays with the planes of m triangles.

    Parameters
    ----------
    ray : torch.Tensor
        Rays, ``[2, 3]`` or ``[n, 2, 3]``.
    triangle : torch.Tensor
        Triangles, ``[3, 3]`` or ``[m, 3, 3]``.

    Returns
    -------
    tuple of torch.Tensor
        Normals ``[m, n, 2, 3]`` and signed distances ``[m, n]``, each as of :func:`intersect_w_surface`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import intersect_w_surface_batch
    >>> plane = torch.tensor([[0.0, 0, 5], [4, 0, 5], [0, 4, 5]])
    >>> shifted = plane + torch.tensor([0.0, 0.0, 2.0])
    >>> ray = torch.tensor([[0.0, 0, 0], [0, 0, 1]])
    >>> intersect_w_surface_batch(ray, torch.stack([plane, shifted]))[1].flatten().tolist()
    [5.0, 7.0]
    """
    ray, triangle = reals_of(ray=ray, triangle=triangle)
    ray, triangle = arguments.rays("ray", ray), arguments.triangles("triangle", triangle)
    return in_pieces(_plane_hits, (2, 1, 1), ray, *_planes(_before(triangle, ray)))


def intersect_w_circle(ray: torch.Tensor, circle: Sequence) -> tuple[torch.Tensor, torch.Tensor]:
    """Intersect rays with the plane of a circle; the distance is 0 where the intersection lies outside the circle.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[m, 2, 3]``.
    circle : list
        [plane, centre, radius] of :func:`odak.learn.raytracing.define_circle`.

    Returns
    -------
    tuple of torch.Tensor
        Normals as in :func:`intersect_w_surface` (``[2, 3]`` for a ray ``[2, 3]``) and distances ``[m, 1]``.

    Examples
    --------
    The first ray meets the disc of radius 2 at z = 5, the second one passes by:

    >>> import torch
    >>> from odak.learn.raytracing import define_circle, intersect_w_circle
    >>> circle = define_circle(torch.tensor([0.0, 0.0, 5.0]), torch.tensor([2.0]), torch.zeros(3))
    >>> rays = torch.tensor([[[1.0, 0, 0], [0, 0, 1]], [[3, 0, 0], [0, 0, 1]]])
    >>> intersect_w_circle(rays, circle)[1].flatten().tolist()
    [5.0, 0.0]
    """
    if not isinstance(circle, (list, tuple)) or len(circle) != 3:
        raise TypeError(f"circle must be [plane, centre, radius] of define_circle, got {type(circle).__name__}")
    ray, plane, center, radius = reals_of(ray=ray, plane=circle[0], center=circle[1], radius=circle[2])
    rays, plane = arguments.rays("ray", ray), arguments.triangles("circle[0]", plane)
    normal, distance = in_pieces(_circle_hits, (2, 1, 1, 1, 0), rays, *_planes(plane), center, radius.reshape(-1))
    return normal if ray.ndim > 2 else normal[0], distance[..., None]


def _meet_triangles(ray, triangle) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return normals ``[k, m, 2, 3]``, signed distances and membership ``[k, m]`` of m rays and k triangles."""
    triangle = _before(triangle, ray)
    return in_pieces(_triangle_hits, (2, 1, 1, 2), ray, *_planes(triangle), triangle)


def _before(triangle: torch.Tensor, ray: torch.Tensor) -> torch.Tensor:
    """Return triangles ``[k, 3, 3]`` with their axis in front of all axes of the rays' batch."""
    return triangle.reshape(-1, *(1,) * (ray.ndim - 2), 3, 3)


def _planes(triangle):
    """Return the centres of triangles, which are least affected by rounding, and their normals."""
    return triangle.mean(dim=-2), geometry.triangle_normal(triangle)


def _plane_hits(ray, centre, normal):
    hit = closed_forms.plane(ray[..., 0, :], ray[..., 1, :], centre, normal)
    return vec.join(hit.point, hit.normal), hit.distance


def _circle_hits(ray, centre, normal, middle, radius):
    hit = closed_forms.plane(ray[..., 0, :], ray[..., 1, :], centre, normal)
    arm = vec.minus(hit.point, vec.split(middle))
    distance = torch.where(vec.dot(arm, arm) > radius * radius, 0.0, hit.distance)
    return vec.join(hit.point, hit.normal), distance


def _triangle_hits(ray, centre, normal, triangle):
    hit = closed_forms.plane(ray[..., 0, :], ray[..., 1, :], centre, normal)
    return vec.join(hit.point, hit.normal), hit.distance, closed_forms.on_triangle(hit, triangle)


def _sphere_hits(ray, sphere):
    hit = closed_forms.sphere(ray[..., 0, :], ray[..., 1, :], sphere[..., :3], sphere[..., 3])
    rays = vec.join(hit.point, vec.split(ray[..., 1, :]))
    return rays, vec.join(vec.split(sphere[..., :3]), hit.normal), hit.distance, hit.hit


def intersect_w_cylinder(
    ray: torch.Tensor, cylinder: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Intersect rays with an infinite cylinder in closed form, at the nearest point ahead, or the exit from inside.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[m, 2, 3]``.
    cylinder : torch.Tensor
        ``[7]`` of :func:`define_cylinder`, or ``[m, 7]``: one for each ray.

    Returns
    -------
    tuple of torch.Tensor
        As :func:`odak.learn.raytracing.intersect_w_sphere`: rays ``[k, 2, 3]`` from the points hit, normals
        ``[k, 2, 3]`` from the axis outwards, distances ``[m]`` (NaN, without gradient, for misses and for rays along
        the axis), and which rays hit, ``[m]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import define_cylinder, intersect_w_cylinder
    >>> ray = torch.tensor([[-20.0, 0.0, 4.0], [1.0, 0.0, 0.0]])
    >>> intersect_w_cylinder(ray, define_cylinder(torch.zeros(3), 2.0))[2]
    tensor([18.])
    """
    ray, cylinder = reals_of(ray=ray, cylinder=cylinder)
    ray = arguments.rays("ray", ray)
    center, radius, axis = split_cylinder(cylinder)
    if ray.ndim == 3 and len(center) not in (1, len(ray)) and len(ray) != 1:
        raise ValueError(f"cylinder must hold one cylinder or one for each of {len(ray)} rays, got {len(center)}")
    rays, normals, distance, check = in_pieces(_cylinder_hits, (2, 1, 0, 1), ray, center, radius, axis)
    # Rays that all hit need not be picked; a GPU would have to be asked first.
    if not (is_readable(check) and bool(check.all())):
        rays, normals = rays[check], normals[check]
    return rays, normals, distance, check


def _cylinder_hits(ray, center, radius, axis):
    hit = closed_forms.cylinder(ray[..., 0, :], ray[..., 1, :], center, radius, axis)
    # NaN of rays that miss must not reach the gradient of the radius.
    outward = tuple(torch.where(hit.hit, value, 0.0) for value in hit.normal)
    foot = vec.along(hit.point, -radius, outward)
    return vec.join(hit.point, vec.split(ray[..., 1, :])), vec.join(foot, hit.normal), hit.distance, hit.hit
