"""One surface in plain torch operations: transfer, intersection, refraction. Differentiable to any order by autograd.

This is the reference that the fused kernel is held against, the way of rays through tilted surfaces, and what runs
under torch.func, in double backward and on a GPU.
"""

from typing import NamedTuple

import torch

from odak.learn.raytracing.system.elements import Element
from odak.raytracing.status import RayStatus

STEPS = 12


class State(NamedTuple):
    """Rays between two surfaces, each component a tensor of one shape.

    Attributes
    ----------
    x, y, z : torch.Tensor
        Points, from the vertex of the surface last passed.
    u, v, w : torch.Tensor
        Direction cosines.
    path : torch.Tensor
        Optical path so far.
    status : torch.Tensor
        int8, numbers of :class:`odak.raytracing.RayStatus`.
    """

    x: torch.Tensor
    y: torch.Tensor
    z: torch.Tensor
    u: torch.Tensor
    v: torch.Tensor
    w: torch.Tensor
    path: torch.Tensor
    status: torch.Tensor


def advance(state: State, e: Element) -> State:
    """Take rays to a surface and through it.

    Parameters
    ----------
    state : State
        Rays from the vertex before; those whose status is not HIT stay behind on the axis, with the status they have.
    e : Element
        The surface.

    Returns
    -------
    State
        Rays from this vertex. A ray that fails here goes on along the axis, so that no NaN enters any gradient.

    Notes
    -----
    Welford, Aberrations of Optical Systems (1986), section 4.3: the plane of the vertex first, then
    t = F/(G ± √(G² − cF(1 + kn²))) from there with F = c(x² + y²) and G = w − c(lx + my): the root next to the vertex,
    without cancellation. Aspheres by Newton's method from that point.
    """
    x, y, z, u, v, w, path, status = state
    failing = ~(w * e.sign > 0) & (status == RayStatus.HIT)
    status = torch.where(failing, RayStatus.MISS.value, status).to(torch.int8)
    x, y, u, v, w = _on_axis(status, e.sign, x, y, u, v, w)
    first = (e.h - z) / w
    x, y = x + first * u, y + first * v
    t, met = _distance(x, y, u, v, w, e)
    status = _marked(status, met)
    x, y, u, v, w, t = _on_axis(status, e.sign, x, y, u, v, w, t)
    x, y, z = x + t * u, y + t * v, t * w
    if e.limit is not None:
        inside = x * x + y * y <= e.limit * e.limit
        status = _marked(status, torch.where(inside, RayStatus.HIT.value, RayStatus.VIGNETTED.value))
    path = path + e.n1 * (first + t)
    if e.action != "pass":
        u, v, w, through = _bend(x, y, z, u, v, w, e)
        status = _marked(status, torch.where(through, RayStatus.HIT.value, RayStatus.TOTAL_INTERNAL_REFLECTION.value))
        x, y, z, u, v, w = _on_axis(status, -e.sign if e.action == "reflect" else e.sign, x, y, u, v, w, z=z)
    return State(x, y, z, u, v, w, path, status)


def _marked(status, event):
    """Return the statuses after an event: the first that befalls a ray stays."""
    return torch.where(status == RayStatus.HIT, event, status).to(torch.int8)


def _on_axis(status, sign: int, x, y, u, v, w, t=None, z=None):
    """Return rays of which those that failed run along the axis."""
    kept = status == RayStatus.HIT
    x, y, u, v = (torch.where(kept, value, 0.0) for value in (x, y, u, v))
    w = torch.where(kept, w, float(sign))
    if z is not None:
        return x, y, torch.where(kept, z, 0.0), u, v, w
    return (x, y, u, v, w) if t is None else (x, y, u, v, w, torch.where(kept, t, 0.0))


def _distance(x, y, u, v, w, e: Element):
    """Return the distance from the vertex plane to the surface, and what became of the rays."""
    if e.kind == "plane":
        return torch.zeros_like(x), torch.zeros_like(x, dtype=torch.int8)
    f, g = e.c * (x * x + y * y), w - e.c * (u * x + v * y)
    inside = g * g - e.c * f * (1 + e.k * w * w)
    met = inside > 0
    root = torch.where(met, inside, 1.0).sqrt()
    denominator = g + e.sign * root
    met = met & (denominator != 0)
    t = torch.where(met, f, 0.0) / torch.where(met, denominator, 1.0)
    # The other sheet of the quadric is no part of the surface.
    met = met & (1 - e.c * (1 + e.k) * (t * w) > 0)
    if e.kind == "conic":
        return torch.where(met, t, 0.0), torch.where(met, RayStatus.HIT.value, RayStatus.MISS.value)
    return _newton(x, y, u, v, w, torch.where(met, t, 0.0), e)


def _newton(x, y, u, v, w, t, e: Element):
    """Return the distance to an asphere: Newton's method without a graph, then two steps with one.

    Two, because the first carries first derivatives and the second the second ones.
    """
    with torch.no_grad():
        for _ in range(STEPS):
            step, _, _ = _newton_step(x, y, u, v, w, t, e)
            t = t - step
    step, defined, scale = _newton_step(x, y, u, v, w, t, e)
    converged = defined & (step.abs() <= 64 * torch.finfo(x.dtype).eps * scale)
    t = torch.where(converged, t, 0.0)
    for _ in range(2):
        step, _, _ = _newton_step(x, y, u, v, w, t, e)
        t = t - torch.where(converged, step, 0.0)
    missed = torch.where(defined, RayStatus.NOT_CONVERGED.value, RayStatus.MISS.value)
    return t, torch.where(converged, RayStatus.HIT.value, missed)


def _newton_step(x, y, u, v, w, t, e: Element):
    """Return F/F′ along the ray, whether the surface is defined there, and the size of the numbers at hand."""
    px, py, pz = x + t * u, y + t * v, t * w
    squared = px * px + py * py
    height, slope, defined = sag(squared, e)
    along = w - 2 * slope * (u * px + v * py)
    steep = along * e.sign <= 0
    defined = defined & ~steep
    step = torch.where(defined, pz - height, 0.0) / torch.where(steep, 1.0, along)
    return step, defined, 1 + squared.sqrt().detach() + pz.abs()


def sag(squared, e: Element):
    """Return an asphere's height at r², its derivative by r², and where it is defined."""
    inside = 1 - (1 + e.k) * e.c * e.c * squared
    defined = inside > 0
    root = torch.where(defined, inside, 1.0).sqrt()
    value = slope = torch.zeros_like(squared)
    for coefficient in reversed(e.a):
        slope = slope * squared + value + coefficient
        value = (value + coefficient) * squared
    return value + e.c * squared / (1 + root), slope + e.c / (2 * root), defined


def _bend(x, y, z, u, v, w, e: Element):
    """Return directions behind the surface and whether light gets there: d′ = μd + ΓN."""
    if e.kind == "asphere":
        _, slope, _ = sag(x * x + y * y, e)
        a, b, c = -2 * slope * x, -2 * slope * y, torch.ones_like(x)
    elif e.kind == "conic":
        a, b, c = -e.c * x, -e.c * y, 1 - e.c * (1 + e.k) * z
    else:
        a, b, c = torch.zeros_like(x), torch.zeros_like(x), torch.ones_like(x)
    cosine, squared = a * u + b * v + c * w, a * a + b * b + c * c
    if e.action == "reflect":
        mu, gamma, through = 1.0, -2 * cosine / squared, torch.ones_like(x, dtype=torch.bool)
    else:
        mu = e.n1 / e.n2
        inside = (1 - mu * mu) * squared + mu * mu * cosine * cosine
        through = inside > 0
        gamma = (e.sign * torch.where(through, inside, 1.0).sqrt() - mu * cosine) / squared
    return mu * u + gamma * a, mu * v + gamma * b, mu * w + gamma * c, through
