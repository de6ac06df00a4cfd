"""Intersections of rays with surfaces z = sag(x, y) and with level sets of functions, differentiable in both."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from odak import _validate
from odak.learn._face import face_of
from odak.learn._tensors import reals_of
from odak.raytracing import arguments, boundary, surfaces
from odak.raytracing.geometry import dot, unit
from odak.raytracing.surfaces import Biconic as Biconic
from odak.raytracing.surfaces import ChebyshevFreeform as ChebyshevFreeform
from odak.raytracing.surfaces import Conic as Conic
from odak.raytracing.surfaces import EvenAsphere as EvenAsphere
from odak.raytracing.surfaces import OddAsphere as OddAsphere
from odak.raytracing.surfaces import Plane as Plane
from odak.raytracing.surfaces import PolynomialFreeform as PolynomialFreeform
from odak.raytracing.surfaces import QbfsAsphere as QbfsAsphere
from odak.raytracing.surfaces import QconAsphere as QconAsphere
from odak.raytracing.surfaces import Shape as Shape
from odak.raytracing.surfaces import SplineFreeform as SplineFreeform
from odak.raytracing.surfaces import Toroid as Toroid
from odak.raytracing.surfaces import ZernikeFreeform as ZernikeFreeform

if TYPE_CHECKING:
    from odak.learn._faces.raytracing_surfaces import *  # noqa: F403


if not TYPE_CHECKING:

    @face_of(surfaces.intersect_w_sag)
    def intersect_w_sag(core, ray, surface, center=None, angles=None, aperture=None, ahead=True):
        """Intersect rays with a surface z = sag(x, y), differentiable in rays, placement and parameters of the surface.

        Parameters
        ----------
        surface : Shape
            A Conic, EvenAsphere, Toroid or any other shape, its vertex at the origin and its axis along z. Parameters
            that are tensors broadcast against the rays' batch axes (coefficients with their last axis, heights as a
            whole, aside).
        center : torch.Tensor, optional
            Position of its vertex, ``[3]``.
        angles : torch.Tensor, optional
            Its rotation in degrees about X, Y and Z, applied in this order, ``[3]``.
        aperture : float or torch.Tensor, optional
            Semi-diameter of the surface.

        Notes
        -----
        Large batches are evaluated block by block, forward and backward, and store only their arguments.
        Derivatives follow from the implicit function theorem; see :func:`odak.raytracing.surfaces.intersection`.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import Conic, intersect_w_sag
        >>> curvature = torch.tensor(0.2, dtype=torch.float64, requires_grad=True)
        >>> ray = torch.tensor([[0.0, 3.0, -10.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
        >>> distance = intersect_w_sag(ray, Conic(curvature)).distance
        >>> distance.backward()
        >>> round(distance.item(), 9), round(curvature.grad.item(), 9)
        (11.0, 6.25)
        """
        return surfaces.placed_hits(reals_of, ray, surface, center, angles, aperture, ahead)


@torch.no_grad()
def _search(rays, surface, function: Callable[..., Any], target_error: float, limit: int) -> torch.Tensor:
    """Return the distances found, NaN for misses."""

    def plain(points, surface):
        return function(torch.from_numpy(np.ascontiguousarray(points)).to(rays.device), surface).double().cpu().numpy()

    def none(points, surface):
        return np.zeros((len(points), 2, 3))

    lines = rays.double().cpu().numpy()
    distance, _ = boundary.intersect_parametric(lines, surface, plain, none, target_error, limit)
    distance = np.full(len(lines), np.nan) if distance is False else distance
    return torch.from_numpy(distance).to(rays)


def _gradient(rays, distance, surface, function: Callable[..., Any]):
    """Return the function where the rays are, and its gradient by the place; with a graph if one is recorded."""
    point = rays[:, 0] + distance[:, None] * rays[:, 1]
    differentiable = point.requires_grad or (torch.is_grad_enabled() and function(point, surface).requires_grad)
    with torch.enable_grad():
        place = point if point.requires_grad else point.detach().requires_grad_()
        value = function(place, surface)
        (gradient,) = torch.autograd.grad(value.sum(), place, create_graph=differentiable)
    return (value if differentiable else value.detach()).to(rays.dtype), gradient


if not TYPE_CHECKING:

    @face_of(boundary.intersect_parametric, tensors=("ray",), defaults={"surface_normal_function": None})
    def intersect_parametric(
        _,
        ray,
        parametric_surface,
        surface_function,
        surface_normal_function=None,
        target_error=0.00000001,
        iter_no_limit=100000,
    ):
        """Intersect rays with a surface given as a function, at the nearest point ahead.

        Parameters
        ----------
        parametric_surface : object
            Passed to both functions, with the tensors with respect to which the surface is differentiated.
        surface_function : callable
            ``surface_function(points [m, 3], parametric_surface)`` returns ``[m]``: zero on the surface, with opposite
            signs on its sides, in torch operations.
        surface_normal_function : callable, optional
            Takes the same and returns normals as rays; by default along the function's gradient.

        Returns
        -------
        tuple of torch.Tensor
            Distances ``[m]`` and normals ``[m, 2, 3]``, in this order; NaN, without gradient, for rays that miss.

        Notes
        -----
        The search runs as in :func:`odak.raytracing.intersect_parametric`, on the CPU in float64, and keeps no graph.
        Two steps of Newton's method from where it ends carry first and second derivatives, according to the implicit
        function theorem.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.raytracing import intersect_parametric, sphere_function
        >>> radius = torch.tensor(1.0, requires_grad=True)
        >>> sphere = torch.cat((torch.zeros(3), radius[None]))
        >>> ray = torch.tensor([[0.0, 0.0, -5.0], [0.0, 0.0, 1.0]])
        >>> distance, _ = intersect_parametric(ray, sphere, sphere_function)
        >>> [round(value.item(), 5) for value in (distance.detach()[0], torch.autograd.grad(distance.sum(), radius)[0])]
        [4.0, -1.0]
        """
        target_error = _validate.constant("target_error", target_error, positive=True)
        _validate.function("surface_function", surface_function)
        _validate.function_or_none("surface_normal_function", surface_normal_function)
        batch = arguments.rays("ray", ray).shape[:-2]
        rays = ray.reshape(-1, 2, 3)
        found = _search(rays, parametric_surface, surface_function, target_error, iter_no_limit)
        hit = torch.isfinite(found)
        if not bool(hit.any()):
            return found.reshape(batch), torch.full_like(rays, torch.nan).reshape(*batch, 2, 3)
        # A ray that misses is replaced by one that hits: elsewhere the functions may not be differentiable.
        first = hit.nonzero()[0, 0]
        rays = torch.where(hit[:, None, None], rays, rays[first].detach())
        distance = torch.where(hit, found, found[first])
        for _ in range(2):
            value, gradient = _gradient(rays, distance, parametric_surface, surface_function)
            slope = dot(gradient, rays[:, 1])
            regular = hit & (slope != 0)
            distance = distance - torch.where(regular, value, 0.0) / torch.where(regular, slope, 1.0)
        point = rays[:, 0] + distance[:, None] * rays[:, 1]
        if surface_normal_function is None:
            _, gradient = _gradient(rays, distance, parametric_surface, surface_function)
            normal = arguments.as_rays(point, unit(gradient))
        else:
            normal = surface_normal_function(point, parametric_surface).reshape(-1, 2, 3)
        distance, normal = torch.where(hit, distance, torch.nan), torch.where(hit[:, None, None], normal, torch.nan)
        return distance.reshape(batch), normal.reshape(*batch, 2, 3)
