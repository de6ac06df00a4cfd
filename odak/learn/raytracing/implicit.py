"""Rays and surfaces given by their height, differentiable by the implicit function theorem."""

from dataclasses import fields, is_dataclass

import torch

from odak import _validate
from odak.learn.raytracing import arguments
from odak.learn.raytracing.recompute import in_pieces
from odak.raytracing import surfaces
from odak.raytracing.batches import is_followed
from odak.raytracing.geometry import dot
from odak.raytracing.intersections import Hit
from odak.raytracing.surfaces import Conic, EvenAsphere, SplineFreeform, Surface, Toroid, ZernikeFreeform
from odak.tools.transformation import rotation_matrix

__all__ = ["Conic", "EvenAsphere", "SplineFreeform", "Toroid", "ZernikeFreeform", "intersect_w_sag"]


def intersect_w_sag(
    ray: torch.Tensor,
    surface: Surface,
    center: torch.Tensor | None = None,
    angles: torch.Tensor | None = None,
    aperture: float | torch.Tensor | None = None,
    ahead: bool = True,
) -> Hit:
    """Meet a surface given by its height, differentiable in rays, placement and all parameters of the surface.

    Parameters
    ----------
    ray : torch.Tensor
        ``[2, 3]`` or ``[..., 2, 3]``. Directions need not be unit vectors.
    surface : Conic, EvenAsphere, Toroid, ZernikeFreeform or SplineFreeform
        The surface, its vertex at the origin and its axis along z. Parameters that are tensors broadcast against the
        rays' batch axes (coefficients with their last axis, heights as a whole, aside).
    center : torch.Tensor, optional
        Where its vertex is, ``[3]``.
    angles : torch.Tensor, optional
        Its rotation in degrees about X, Y and Z, applied in this order, ``[3]``.
    aperture : float or torch.Tensor, optional
        Distance from the axis at which it ends.
    ahead : bool
        Take only points ahead of the start; else also those behind it, at negative distances.

    Returns
    -------
    Hit
        Distance ``[...]`` in lengths of the direction, point and unit normal ``[..., 3]`` (towards the surface's +z),
        status ``[...]``. NaN, without gradient, where the status is not HIT.

    Notes
    -----
    The distance t is found without a graph; what is kept of it is t alone. From F(o + td, θ) = 0, with w = −g/(n·d) and
    n = ∂F/∂p, the gradients are wn, wtn and w·∂F/∂θ, computed again in the backward pass from differentiable
    operations, so that second derivatives follow.

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
    if not is_dataclass(surface):
        raise TypeError(f"surface must be a surface of odak.raytracing, got {type(surface).__name__}")
    names = [field.name for field in fields(surface)]
    extra = {"center": center, "angles": angles, "aperture": aperture}
    extra = {name: value for name, value in extra.items() if value is not None}
    given = {name: getattr(surface, name) for name in names}
    # Surfaces without coefficients are right as they are.
    empty = [name for name, value in given.items() if isinstance(value, (list, tuple)) and not len(value)]
    values = arguments.tensors(ray=ray, **given | {name: torch.zeros(0) for name in empty}, **extra)
    ray, parameters = values[0], values[1 : 1 + len(names)]
    extra = dict(zip(extra, values[1 + len(names) :], strict=True))
    if ray.shape[-2:] != (2, 3):
        raise ValueError(f"ray must be [..., 2, 3], got {tuple(ray.shape)}")
    ahead = _validate.flag("ahead", ahead)
    if "aperture" in extra:
        _validate.fitting(ray=ray.shape[:-2], aperture=extra["aperture"])
    matrix = rotation_matrix(arguments.vector("angles", extra["angles"])) if "angles" in extra else None
    center = extra.get("center")
    if center is not None:
        center = (
            arguments.shaped("center", center, (3,), "[3]") if center.ndim > 1 else arguments.vector("center", center)
        )
        _validate.fitting(ray=ray[..., 0, :], center=center)
    start, direction = surfaces.to_local(ray[..., 0, :], ray[..., 1, :], center, matrix)
    return surfaces.to_global(
        _meet(start, direction, surface, parameters, extra.get("aperture"), ahead), center, matrix
    )


def _meet(start, direction, surface: Surface, parameters, aperture, ahead: bool) -> Hit:
    kind = type(surface)
    if not is_followed(start, direction, *parameters):
        return surfaces.meet_sag(start, direction, kind(*parameters), aperture, ahead)
    distance, status = _Distance.apply(start, direction, kind, aperture, ahead, *parameters)

    def hit(start, direction, distance, status, *parameters):
        return surfaces.hit_on_sag(start, direction, distance, status, kind(*parameters))

    return in_pieces(hit, (1, 1, 0, 0, *surfaces.ranks(kind)), start, direction, distance, status, *parameters)


def _level(kind: type, point, *parameters):
    """Return F = z − height(x, y), zero on the surface."""
    return point[..., 2] - kind(*parameters).sag(point[..., 0], point[..., 1]).height


class _Distance(torch.autograd.Function):
    """Distance along rays to a surface: saves the distance and computes the rest again."""

    @staticmethod
    def forward(start, direction, kind, aperture, ahead, *parameters):
        return surfaces.solve_sag(start, direction, kind(*parameters), aperture, ahead)

    @staticmethod
    def setup_context(ctx, inputs, output):
        start, direction, kind, _, _, *parameters = inputs
        distance, status = output
        ctx.kind = kind
        ctx.mark_non_differentiable(status)
        ctx.save_for_backward(start, direction, distance, *parameters)
        ctx.save_for_forward(start, direction, distance, *parameters)

    @staticmethod
    def backward(ctx, gradient, _):
        """Return w·n, w·t·n and w·∂F/∂θ."""
        start, direction, distance, *parameters = ctx.saved_tensors
        point, direction, t, hit = _dummies(start, direction, distance)
        # torch.func's vjp holds the other arguments fixed: the distance's own dependence is not counted twice.
        value, pull = torch.func.vjp(lambda p: _level(ctx.kind, p, *parameters), point)
        (normal,) = pull(torch.ones_like(value))
        # A ray that only touches the surface has no slope: the distance ends there.
        steep = dot(normal, direction)
        met = hit & (steep != 0)
        weight = torch.where(met, -gradient, 0.0) / torch.where(met, steep, 1.0)
        along = weight[..., None] * normal
        shape = (None,) * len(parameters)
        if any(ctx.needs_input_grad[5:]):
            _, pull = torch.func.vjp(lambda *theta: _level(ctx.kind, point, *theta), *parameters)
            shape = pull(weight)
        return along, along * t[..., None], None, None, None, *shape

    @staticmethod
    def jvp(ctx, d_start, d_direction, _kind, _aperture, _ahead, *d_parameters):
        """Return −(n·(ȯ + tḋ) + ∂F/∂θ·θ̇)/(n·d)."""
        start, direction, distance, *parameters = ctx.saved_tensors
        point, direction, t, hit = _dummies(start, direction, distance)
        moved = torch.zeros_like(point)
        moved = moved if d_start is None else moved + d_start
        moved = moved if d_direction is None else moved + t[..., None] * d_direction
        changes = [torch.zeros_like(p) if d is None else d for p, d in zip(parameters, d_parameters, strict=True)]
        # Forward mode does not nest: the pull-back is linear, and its own pull-back pushes forward.
        value, pull = torch.func.vjp(lambda *a: _level(ctx.kind, *a), point, *parameters)
        _, push = torch.func.vjp(pull, torch.ones_like(value))
        (change,) = push((moved, *changes))
        (slope,) = push((direction, *map(torch.zeros_like, parameters)))
        met = hit & (slope != 0)
        return torch.where(met, -change / torch.where(met, slope, 1.0), 0.0), None


def _dummies(start, direction, distance):
    """Return points, directions, distances and which rays hit; the others run along the axis, where nothing is NaN."""
    hit = distance.isfinite()
    t = torch.where(hit, distance, 0.0)
    axis = torch.tensor([0.0, 0.0, 1.0], dtype=direction.dtype, device=direction.device)
    direction = torch.where(hit[..., None], direction, axis)
    return torch.where(hit[..., None], start, 0.0) + t[..., None] * direction, direction, t, hit
