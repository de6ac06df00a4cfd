"""Rays through a whole sequence of surfaces, a cache-sized block at a time, forward and back.

Forward, a block passes all surfaces before the next one starts, so that what lies between two surfaces never leaves the
cache. What is kept for the backward pass is the rays that came in and their statuses; a block is then traced once more
and its gradients run back through the surfaces by hand-written adjoints.
"""

from typing import NamedTuple

import torch

from odak.learn.raytracing.system import adjoint
from odak.learn.raytracing.system.elements import Element, Layout, Numbers, as_lists, elements, plain_elements
from odak.learn.raytracing.system.step import STEPS, State, advance, sag
from odak.learn.raytracing.system.workers import each
from odak.raytracing.status import RayStatus

# Bytes of one component of a block: a dozen of them fit into a core's cache.
BLOCK_BYTES = 1 << 17
# From here on a system's rays fill blocks by themselves; below, blocks hold several systems.
MANY = 4096


class Passage(NamedTuple):
    """What the adjoint of one surface needs of a block: direction before, point, distance, cosine, Γ, root, normal."""

    u: torch.Tensor
    v: torch.Tensor
    w: torch.Tensor
    x: torch.Tensor
    y: torch.Tensor
    z: torch.Tensor
    distance: torch.Tensor
    cosine: torch.Tensor
    gamma: torch.Tensor | None
    root: torch.Tensor | None
    normal: tuple
    squared: torch.Tensor | None


def plain_trace(layout: Layout, numbers: Numbers, rays: tuple) -> State:
    """Return the rays ``[B, R]`` behind the last surface, in plain torch operations; failed rays lie on the axis."""
    status = torch.where(torch.isfinite(sum(rays)), RayStatus.HIT.value, RayStatus.MISS.value).to(torch.int8)
    rays = [torch.where(status == RayStatus.HIT, value, 0.0) for value in rays]
    rays[5] = torch.where(status == RayStatus.HIT, rays[5], 1.0)
    state = State(*(*rays, torch.zeros_like(rays[0]), status))
    for element in elements(layout, numbers, rays[0].dtype):
        state = advance(state, element)
    return state


class Trace(torch.autograd.Function):
    """All surfaces in one node of the graph; see the module."""

    @staticmethod
    def forward(layout, x, y, z, u, v, w, *numbers):
        """Return x, y, z, u, v, w, path and status ``[B, R]``; NaN where a ray failed."""
        numbers, rays = Numbers(*numbers), (x, y, z, u, v, w)
        if x.device.type != "cpu":
            state = plain_trace(layout, numbers, rays)
            lost = state.status != RayStatus.HIT
            return (*(value.masked_fill(lost, torch.nan) for value in state[:7]), state.status)
        out = [torch.empty(x.shape, dtype=x.dtype) for _ in range(7)]
        status = torch.empty(x.shape, dtype=torch.int8)

        def work(rows, columns, sequence):
            block = tuple(value[rows, columns] for value in rays)
            held, marks = _run(block, sequence) or (None, None)
            if held is None:
                few = Numbers(*(value[rows] for value in numbers))
                *held, marks = plain_trace(layout, few, block)
                lost = marks != RayStatus.HIT
                held = [value.masked_fill_(lost, torch.nan) for value in held]
            for target, value in zip(out, held, strict=True):
                target[rows, columns] = value
            status[rows, columns] = marks

        list(each(work, blocks(layout, numbers, x.shape, x.dtype)))
        return (*out, status)

    @staticmethod
    def setup_context(ctx, inputs, output):
        """Keep the rays that came in, the numbers and the statuses."""
        layout, *tensors = inputs
        ctx.layout = layout
        ctx.save_for_backward(*tensors, output[7])
        ctx.mark_non_differentiable(output[7])

    @staticmethod
    def backward(ctx, *gradients):
        """Return the gradients of rays and numbers."""
        *tensors, status = ctx.saved_tensors
        if torch.is_grad_enabled():
            return (None, *_again(ctx.layout, tensors, gradients[:7], ctx.needs_input_grad[1:]))
        return (None, *_pull(ctx.layout, tensors, status, gradients[:7]))


def blocks(layout: Layout, numbers: Numbers, shape, dtype):
    """Yield rows, columns and elements of the blocks that rays ``[B, R]`` are traced in."""
    count, rays = shape
    block = BLOCK_BYTES // dtype.itemsize
    if not count * rays:
        return
    if count == 1 or rays >= MANY:
        lists = as_lists(numbers)
        for row in range(count):
            sequence = plain_elements(layout, lists, row)
            for start in range(0, rays, block):
                yield slice(row, row + 1), slice(start, start + block), sequence
        return
    step = max(1, block // max(rays, 1))
    for start in range(0, count, step):
        rows = slice(start, start + step)
        yield rows, slice(None), elements(layout, Numbers(*(value[rows] for value in numbers)), dtype)


def _again(layout, tensors, gradients, needed):
    """Return the gradients as differentiable tensors: by autograd through the plain operations."""
    # Views, so that the same tensors may be asked for at once as inputs and as part of an outer graph.
    tensors = [value.view_as(value) if need else value for value, need in zip(tensors, needed, strict=True)]
    wanted = [value for value, need in zip(tensors, needed, strict=True) if need]
    state = plain_trace(layout, Numbers(*tensors[6:]), tuple(tensors[:6]))
    lost = state.status != RayStatus.HIT
    gradients = [torch.where(lost, 0.0, value) for value in gradients]
    found = iter(torch.autograd.grad(state[:7], wanted, gradients, create_graph=True, allow_unused=True))
    return [next(found) if need else None for need in needed]


def _pull(layout, tensors, status, gradients):
    """Return the gradients, block by block."""
    rays, numbers = tuple(tensors[:6]), Numbers(*tensors[6:])
    shape, dtype = status.shape, rays[0].dtype
    if status.device.type != "cpu":
        whole = [(slice(None), slice(None), elements(layout, numbers, dtype))]
    else:
        whole = blocks(layout, numbers, shape, dtype)
    out = [torch.empty(shape, dtype=dtype, device=status.device) for _ in range(6)]
    totals = Numbers(*(torch.zeros_like(value) for value in numbers))

    def work(rows, columns, sequence):
        lost = status[rows, columns] != RayStatus.HIT
        block = [value[rows, columns] for value in rays]
        g = [value[rows, columns] for value in gradients]
        if status.device.type != "cpu" or bool(lost.any()):
            block = [value.masked_fill(lost, float(i == 5)) for i, value in enumerate(block)]
            g = [value.masked_fill(lost, 0.0) for value in g]
        passages = []
        _run(tuple(block), sequence, passages)
        held, changes = adjoint.back(sequence, passages, g)
        for target, value in zip(out, held, strict=True):
            target[rows, columns] = value
        return rows, changes

    # Summed in order, whichever thread was first: the same call gives the same digits.
    for rows, changes in each(work, whole):
        for i, change in enumerate(changes):
            adjoint.add(totals, rows, i, change)
    return (*out, *totals)


def _run(block, sequence, keep: list | None = None):
    """Return the block behind the last surface and its statuses, or None if a ray misses or is totally reflected."""
    x, y, z, u, v, w = block
    path = torch.zeros_like(x)
    beyond = None
    for e in sequence:
        if keep is None and not bool((w.amin() if e.sign > 0 else -w.amax()) > 0):
            return None
        first = (e.h - z).div_(w)
        x, y = torch.addcmul(x, first, u), torch.addcmul(y, first, v)
        met = _meet(x, y, u, v, w, e, keep is None)
        if met is None:
            return None
        z, distance, cosine = met[0], first.add_(met[1]) if met[1] is not None else first, met[2]
        _add(path, distance, e.n1)
        if e.limit is not None and keep is None:
            outside = torch.addcmul(x * x, y, y) > e.limit**2
            beyond = outside if beyond is None else beyond.logical_or_(outside)
        old = (u, v, w)
        normal, squared = _normal(x, y, z, e)
        gamma = root = None
        if e.action != "pass":
            gamma, root = _gamma(cosine, squared, e)
            u, v, w = _turn(old, normal, gamma, e)
        if keep is not None:
            keep.append(Passage(*old, x, y, z, distance, cosine, gamma, root, normal, squared))
    if keep is not None:
        return None
    if not bool(torch.isfinite(u.sum() + v.sum() + x.sum() + y.sum())):
        return None
    if beyond is None:
        return (x, y, z, u, v, w, path), torch.zeros(x.shape, dtype=torch.int8)
    held = [value.masked_fill(beyond, torch.nan) for value in (x, y, z, u, v, w, path)]
    return held, beyond.to(torch.int8).mul_(RayStatus.VIGNETTED.value)


def _meet(x, y, u, v, w, e: Element, check: bool):
    """Move points from the vertex plane to the surface in place; return z, distance and n·d, or None for a miss."""
    if e.kind == "plane":
        return torch.zeros_like(x), None, w
    f = torch.addcmul(x * x, y, y).mul_(e.c)
    g = torch.addcmul(x * u, y, v).mul_(e.c)
    g = torch.sub(w, g, out=g)
    inside = g * g
    if isinstance(e.k, float) and e.k == 0:
        _add(inside, f, -e.c)
    else:
        inside.addcmul_(f, (w * w).mul_(e.k).add_(1).mul_(e.c), value=-1)
    root = inside.sqrt_()
    cosine = root if e.sign > 0 else root.neg_()
    t = f.div_(g.add_(cosine))
    if e.kind == "asphere":
        t = _solve(x, y, u, v, w, t, e)
        if t is None:
            return None
    x.addcmul_(t, u)
    y.addcmul_(t, v)
    z = t * w
    if e.kind == "asphere":
        _, slope, defined = sag(torch.addcmul(x * x, y, y), e)
        cosine = torch.addcmul(w, torch.addcmul(x * u, y, v), slope, value=-2)
        return None if check and not bool(defined.all()) else (z, t, cosine)
    return None if check and not _on_sheet(z, e) else (z, t, cosine)


def _on_sheet(z, e: Element) -> bool:
    """Say whether c(1 + k)z < 1 for all rays, by their extremes alone: not on the other sheet of the quadric."""
    factor = e.c * (1 + e.k)
    if isinstance(factor, float):
        return bool((z.amax() if factor > 0 else z.amin()) * factor < 1)
    # Where systems differ, doubts are for the plain way to decide.
    return bool(z.abs().amax() * factor.abs().amax() < 1)


def _solve(x, y, u, v, w, t, e: Element):
    """Return the distance to an asphere by Newton's method, or None if a ray does not converge."""
    scale = 64 * torch.finfo(x.dtype).eps
    for _ in range(STEPS):
        px, py = torch.addcmul(x, t, u), torch.addcmul(y, t, v)
        squared = torch.addcmul(px * px, py, py)
        height, slope, _ = sag(squared, e)
        along = torch.addcmul(w, px.mul_(u).addcmul_(py, v), slope, value=-2)
        step = torch.addcmul(height, t, w, value=-1).neg_().div_(along)
        t = t - step
        size = float(step.abs().amax())
        if size <= scale * (1 + float(squared.amax()) ** 0.5):
            return t if bool((along * e.sign).amin() > 0) else None
    return None


def _normal(x, y, z, e: Element):
    """Return the gradient of F, its parts that are not plain zeros and ones, and its square (None for 1)."""
    if e.kind == "plane":
        return (None, None, None), None
    if e.kind == "asphere":
        _, slope, _ = sag(torch.addcmul(x * x, y, y), e)
        nx, ny = (slope * x).mul_(-2), (slope * y).mul_(-2)
        return (nx, ny, None), torch.addcmul(nx * nx, ny, ny).add_(1)
    nx, ny, nz = x * -e.c, y * -e.c, (z * (-e.c * (1 + e.k))).add_(1)
    if isinstance(e.k, float) and e.k == 0:
        return (nx, ny, nz), None
    return (nx, ny, nz), torch.addcmul(nx * nx, ny, ny).addcmul_(nz, nz)


def _gamma(cosine, squared, e: Element):
    """Return Γ of d′ = μd + ΓN, and the root in it."""
    if e.action == "reflect":
        gamma = cosine * -2
        return (gamma if squared is None else gamma.div_(squared)), None
    mu = e.n1 / e.n2
    root = cosine * cosine
    root.mul_(mu * mu)
    root = root.add_(1 - mu * mu) if squared is None else _add(root, squared, 1 - mu * mu)
    root.sqrt_()
    gamma = root.clone() if e.sign > 0 else root.neg()
    gamma = _add(gamma, cosine, -mu)
    return (gamma if squared is None else gamma.div_(squared)), root


def _turn(old, normal, gamma, e: Element):
    """Return μd + ΓN."""
    mu = 1.0 if e.action == "reflect" else e.n1 / e.n2
    parts = [value * mu for value in old]
    for axis, part in enumerate(parts):
        if normal[axis] is not None:
            part.addcmul_(gamma, normal[axis])
        elif axis == 2:
            part.add_(gamma)
    return parts


def _add(out, value, factor):
    """Add factor·value to `out`, whatever the factor is."""
    return out.add_(value, alpha=factor) if isinstance(factor, float) else out.addcmul_(value, factor)
