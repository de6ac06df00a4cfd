"""Fused trace of untilted planes, conics and even aspheres, a cache-sized block of rays at a time, with its adjoint.

An optional acceleration of :func:`odak.learn.raytracing.system.sequence.plain_trace` on a processor. Forward, a block
passes all surfaces before the next one starts, so that intermediate results never leave the cache. For the backward
pass the rays that came in and their statuses are kept; a block is then traced once more and its gradients are
propagated back through the surfaces by hand-written vector–Jacobian products.

With p′ = p + Td on F(p′) = 0, N = ∂F/∂p and d′ = μd + ΓN, Γ = (±q − μ N·d)/N², q² = (1 − μ²)N² + μ²(N·d)². The
intersection is differentiated by the implicit function theorem, dT = −(N·(dp + T dd) + ∂F/∂θ dθ)/(N·d): the method that
found T does not matter.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch

from odak._threads import each
from odak._torch_private import as_constant, outside_functional_transforms
from odak.learn.raytracing.system.sequence import (
    HIT,
    Layout,
    Numbers,
    State,
    flat_arguments,
    plain_trace,
)
from odak.raytracing.intersections import RayStatus
from odak.raytracing.surfaces import Conic, EvenAsphere, Plane, radial_sag

# Bytes of one component of a block: a dozen of them fit into a core's cache.
BLOCK_BYTES = 1 << 17
# From this number on the rays of one system fill a block; below it, a block contains several systems.
MANY = 4096
STEPS = 20


class Element(NamedTuple):
    """One surface for a block of rays: numbers are floats, or tensors ``[rows, 1]`` that broadcast against the block.

    Attributes
    ----------
    kind, action, sign, limit
        From :class:`Layout`.
    c, k, h, a, n1, n2
        Curvature, conic constant, distance from the vertex before, tuple of coefficients, indices on both sides.
    """

    kind: type[Any]
    action: str
    sign: int
    limit: float | None
    c: Any
    k: Any
    h: Any
    a: tuple[Any, ...]
    n1: Any
    n2: Any


class SurfaceRecord(NamedTuple):
    """Values of a block at one surface that its vector–Jacobian product needs."""

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
    normal: tuple[Any, ...]
    squared: torch.Tensor | None


class SurfaceGradients(NamedTuple):
    """Gradients of one surface's numbers, ``[rows]`` each: as in Numbers, and of the indices on both sides."""

    curvature: Any
    conic: Any
    distance: Any
    coefficients: list[Any]
    before: Any
    behind: Any


def plain(layout: Layout, numbers: Numbers, rays: tuple[Any, ...]) -> State:
    """Return the trace of rays ``[B, R]`` in plain operations; failed rays lie on the axis."""
    return plain_trace(layout, *rays, *flat_arguments(layout, numbers)[0])


class Contraction(torch.autograd.Function):
    """Derivatives ``[7, B, R, K]`` by the numbers of B systems times tangents ``[B, K]``.

    Under torch.func.vmap, which would copy the derivatives for each direction, all directions are one matrix product.
    """

    @staticmethod
    def forward(derivative: Any, tangent: Any) -> tuple[torch.Tensor, ...]:
        """Return the products ``[7, B, R]``."""
        return (derivative @ tangent[..., None])[..., 0]

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        """Keep nothing: no further derivatives are taken."""

    @staticmethod
    def vmap(info: Any, in_dims: Any, derivative: torch.Tensor, tangent: torch.Tensor) -> Any:
        """Return the products of all directions, as the last axis."""
        if in_dims[0] is not None or in_dims[1] is None:
            derivative, tangent = (
                value[None] if axis is None else value.movedim(axis, 0)
                for value, axis in zip((derivative, tangent), in_dims, strict=True)
            )
            return (derivative @ tangent[:, None, :, :, None])[..., 0], 0
        return derivative @ tangent.movedim(in_dims[1], -1), -1


class Trace(torch.autograd.Function):
    """Trace through all surfaces as one node of the graph."""

    @staticmethod
    def forward(layout: Layout, *tensors: Any) -> tuple[torch.Tensor, ...]:
        """Return x, y, z, u, v, w, path and status ``[B, R]``; NaN where a ray failed."""
        x, rays, numbers = tensors[0], tensors[:6], Numbers(*tensors[6:])
        if x.device.type != "cpu":
            state = plain(layout, numbers, rays)
            lost = state.status != HIT
            return (*(value.masked_fill(lost, torch.nan) for value in state[:7]), state.status)
        out = [torch.empty(x.shape, dtype=x.dtype) for _ in range(7)]
        status = torch.empty(x.shape, dtype=torch.int8)

        def work(rows, columns, sequence):
            block = tuple(value[rows, columns] for value in rays)
            held, marks = _run(block, sequence) or (None, None)
            if held is None:
                few = Numbers(*(value[rows] for value in numbers[:5]))
                *held, marks = plain(layout, few, block)
                lost = marks != HIT
                held = [value.masked_fill_(lost, torch.nan) for value in held]
            for target, value in zip(out, held, strict=True):
                target[rows, columns] = value
            status[rows, columns] = marks

        list(each(work, blocks(layout, numbers, x.shape, x.dtype)))
        return (*out, status)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        """Keep the rays that came in, the numbers and the statuses."""
        layout, *tensors = inputs
        ctx.layout = layout
        ctx.save_for_backward(*tensors, output[7])
        ctx.save_for_forward(*tensors, output[7])
        ctx.mark_non_differentiable(output[7])

    @staticmethod
    def jvp(ctx: Any, _: Any, *tangents: Any) -> tuple[torch.Tensor, ...]:
        """Return the tangents of x, y, z, u, v, w and path, 0 where a ray failed."""
        *tensors, status = (as_constant(value) for value in ctx.saved_tensors)
        with outside_functional_transforms(*tensors, status):
            by_rays, by_numbers = ray_derivatives(ctx.layout, tensors, status)
        total: Any = torch.zeros(())
        for derivative, tangent in zip(by_rays, tangents[:6], strict=True):
            total = total if tangent is None else total + derivative * tangent
        chosen = [i for i, tangent in enumerate(tangents[6:]) if tangent is not None and tangent.numel()]
        if chosen:
            derivative = torch.cat([by_numbers[i].flatten(3) for i in chosen], -1)
            total = total + Contraction.apply(derivative, torch.cat([tangents[6 + i].flatten(1) for i in chosen], -1))
        return (*total.unbind(0), None)

    @staticmethod
    def vmap(info: Any, in_dims: Any, layout: Layout, *tensors: Any) -> Any:
        """Trace what torch.func.vmap maps over as more systems."""
        placed = [
            (value if axis is None else value.movedim(axis, 0)).expand(
                info.batch_size, *(value.shape if axis is None else value.movedim(axis, 0).shape[1:])
            )
            for value, axis in zip(tensors, in_dims[1:], strict=True)
        ]
        found = Trace.apply(layout, *(value.flatten(0, 1) for value in placed))
        return tuple(value.unflatten(0, (info.batch_size, -1)) for value in found), (0,) * 8

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> tuple[torch.Tensor | None, ...]:
        """Return the gradients of rays and numbers."""
        *tensors, status = ctx.saved_tensors
        if torch.is_grad_enabled():
            return (None, *_differentiable_gradients(ctx.layout, tensors, gradients[:7], ctx.needs_input_grad[1:]))
        return (None, *_gradients(ctx.layout, tensors, status, gradients[:7]))


def blocks(layout: Layout, numbers: Numbers, shape: tuple[int, ...], dtype: torch.dtype) -> Any:
    """Yield rows, columns and elements of the blocks that rays ``[B, R]`` are traced in."""
    count, rays = shape
    block = BLOCK_BYTES // dtype.itemsize
    if not count * rays:
        return
    if count == 1 or rays >= MANY:
        # As nested lists: arithmetic with Python floats needs no broadcasting.
        lists = [value.detach().tolist() for value in numbers[:5]]
        for row in range(count):
            sequence = _build(layout, *(value[row] for value in lists))
            for start in range(0, rays, block):
                yield slice(row, row + 1), slice(start, start + block), sequence
        return
    step = max(1, block // max(rays, 1))
    for start in range(0, count, step):
        rows = slice(start, start + step)
        few: Any = [value[rows] for value in numbers[:5]]
        yield rows, slice(None), _elements(layout, Numbers(*few), dtype)


def _differentiable_gradients(layout, tensors, gradients, needed):
    """Return the gradients as differentiable tensors: by autograd through the plain operations."""
    # Views, so that the same tensors can be inputs and part of an outer graph at once.
    tensors = [value.view_as(value) if need else value for value, need in zip(tensors, needed, strict=True)]
    wanted = [value for value, need in zip(tensors, needed, strict=True) if need]
    state = plain(layout, Numbers(*tensors[6:]), tuple(tensors[:6]))
    lost = state.status != HIT
    gradients = [torch.where(lost, 0.0, value) for value in gradients]
    # Directions behind planes alone do not depend on where a ray starts.
    outputs, given = zip(
        *(pair for pair in zip(state[:7], gradients, strict=True) if pair[0].requires_grad), strict=True
    )
    found = iter(torch.autograd.grad(outputs, wanted, given, create_graph=True, allow_unused=True))
    return [next(found) if need else None for need in needed]


def _gradients(layout, tensors, status, gradients):
    """Return the gradients, block by block."""
    rays, numbers = tuple(tensors[:6]), Numbers(*tensors[6:])
    shape, dtype = status.shape, rays[0].dtype
    if status.device.type != "cpu":
        whole = [(slice(None), slice(None), _elements(layout, numbers, dtype))]
    else:
        whole = blocks(layout, numbers, shape, dtype)
    out = [torch.empty(shape, dtype=dtype, device=status.device) for _ in range(6)]
    totals = Numbers(*(torch.zeros_like(value) for value in numbers[:5]))

    def work(rows, columns, sequence):
        lost = status[rows, columns] != HIT
        block = [value[rows, columns] for value in rays]
        g = [value[rows, columns] for value in gradients]
        if status.device.type != "cpu" or bool(lost.any()):
            block = [value.masked_fill(lost, float(i == 5)) for i, value in enumerate(block)]
            g = [value.masked_fill(lost, 0.0) for value in g]
        records = []
        _run(tuple(block), sequence, records)
        held, changes = _vector_jacobian_product(sequence, records, g)
        for target, value in zip(out, held, strict=True):
            target[rows, columns] = value
        return rows, changes

    # Summed in a fixed order, so that the same call gives the same digits.
    for rows, changes in each(work, whole):
        for i, change in enumerate(changes):
            _accumulate(totals, (rows,), i, change)
    return (*out, *totals[:5])


def ray_derivatives(
    layout: Layout, tensors: Sequence[torch.Tensor], status: torch.Tensor
) -> tuple[tuple[torch.Tensor, ...], tuple[torch.Tensor, ...]]:
    """Return the derivatives of what each ray is behind the last surface, however many numbers there are.

    Parameters
    ----------
    layout : Layout
        The sequence.
    tensors : sequence of torch.Tensor
        The six components of the rays ``[B, R]`` and the five numbers of the systems ``[B, …]``.
    status : torch.Tensor
        Of the traced rays, ``[B, R]``.

    Returns
    -------
    tuple
        Six derivatives ``[7, B, R]`` by the rays' components, and five ``[7, B, R, …]`` by the numbers; the first axis
        is x, y, z, u, v, w and path. Zero for rays that failed.

    Notes
    -----
    A ray depends on no other ray: with every ray as a system of its own, one vector–Jacobian product for each component
    gives all derivatives. All seven are taken in one pass over the surfaces.
    """
    shape, dtype = status.shape, tensors[0].dtype
    count = status.numel()
    lost = (status != HIT).reshape(-1, 1)
    rays = [value.reshape(-1, 1).masked_fill(lost, float(i == 5)) for i, value in enumerate(tensors[:6])]
    own = [value[:, None].expand(*shape, *value.shape[1:]).flatten(0, 1) for value in tensors[6:]]
    unit = torch.eye(7, dtype=dtype, device=status.device)
    by_rays = torch.empty(6, 7, count, dtype=dtype, device=status.device)
    by_numbers = [torch.zeros(7, *value.shape, dtype=torch.float64, device=status.device) for value in own]
    size = max(1, BLOCK_BYTES // dtype.itemsize // 7) if status.device.type == "cpu" else max(count, 1)

    def work(start):
        rows = slice(start, start + size)
        sequence = _elements(layout, Numbers(*(value[rows] for value in own)), dtype)
        records: list[Any] = []
        _run(tuple(value[rows] for value in rays), sequence, records)
        seeds = [column[:, None, None].expand(7, len(lost[rows]), 1) for column in unit]
        seeds = [value.masked_fill(lost[rows], 0.0) for value in seeds]
        if len(records) < len(sequence):
            # A ray that only the plain operations, with their safeguards, took through.
            few = Numbers(*(value[rows] for value in own))
            _plain_derivatives(layout, few, [value[rows] for value in rays], seeds, rows, by_rays, by_numbers)
            return
        held, changes = _vector_jacobian_product(sequence, records, seeds)
        for target, value in zip(by_rays, held, strict=True):
            target[:, rows] = value[..., 0]
        for i, change in enumerate(changes):
            part = Numbers(*(value[:, rows] for value in by_numbers))
            _accumulate(part, (slice(None), slice(None)), i, change)

    list(each(work, [(start,) for start in range(0, count, size)]))
    whole = tuple(value.reshape(7, *shape) for value in by_rays)
    return whole, tuple(value.reshape(7, *shape, *value.shape[2:]).to(dtype) for value in by_numbers)


def _plain_derivatives(layout, numbers, rays, seeds, rows, by_rays, by_numbers) -> None:
    """Write the derivatives of rays treated as separate systems, by autograd through the plain operations."""
    with torch.enable_grad():
        inputs = [value.detach().clone().requires_grad_() for value in (*rays, *numbers[:5])]
        state = plain(layout, Numbers(*inputs[6:]), tuple(inputs[:6]))
        for k in range(7):
            seed = torch.stack([value[k] for value in seeds])
            found = torch.autograd.grad(
                state[:7], inputs, list(seed), retain_graph=True, allow_unused=True, materialize_grads=True
            )
            for target, value in zip(by_rays, found[:6], strict=True):
                target[k, rows] = value[..., 0]
            for target, value in zip(by_numbers, found[6:], strict=True):
                target[k, rows] = value


def _run(block, sequence, keep: list[Any] | None = None):
    """Return the block behind the last surface and its statuses, or None if a ray misses or is totally reflected."""
    x, y, z, u, v, w = block
    path = torch.zeros_like(x)
    beyond = None
    for i, e in enumerate(sequence):
        onward = _is_onward(w, e, keep is None or i == 0)
        if i == 0 and not onward and e.sign > 0 and e.kind is Conic:
            x, y, z, distance, cosine = _from_front(x, y, z, u, v, w, e)
            if keep is None and not _on_sheet(z, e):
                return None
        else:
            if keep is None and not onward:
                return None
            first = (e.h - z).div_(w)
            x, y = torch.addcmul(x, first, u), torch.addcmul(y, first, v)
            found = _intersect(x, y, u, v, w, e, keep is None)
            if found is None:
                return None
            z, distance, cosine = found[0], first.add_(found[1]) if found[1] is not None else first, found[2]
        _add(path, distance, e.n1)
        if e.limit is not None and keep is None:
            outside = torch.addcmul(x * x, y, y) > e.limit**2
            beyond = outside if beyond is None else beyond.logical_or_(outside)
        old = (u, v, w)
        normal, squared = _normal(x, y, z, e)
        gamma = root = None
        if e.action != "pass":
            (u, v, w), gamma, root = _deflected(old, cosine, normal, squared, e)
        if keep is not None:
            keep.append(SurfaceRecord(*old, x, y, z, distance, cosine, gamma, root, normal, squared))
    if keep is not None:
        return None
    if not bool(torch.isfinite(u.sum() + v.sum() + x.sum() + y.sum())):
        return None
    if beyond is None:
        return (x, y, z, u, v, w, path), torch.zeros(x.shape, dtype=torch.int8)
    held = [value.masked_fill(beyond, torch.nan) for value in (x, y, z, u, v, w, path)]
    return held, beyond.to(torch.int8).mul_(RayStatus.VIGNETTED.value)


def _is_onward(w, e: Element, asked: bool) -> bool:
    """Return whether all rays run the way in which the surface is passed; on other devices that is not read."""
    return asked and w.device.type == "cpu" and bool((w.amin() if e.sign > 0 else -w.amax()) > 0)


def _from_front(x, y, z, u, v, w, e: Element):
    """Return points on a conic that rays of any direction pass from its front, their distances, and n·d.

    For fields at 90 degrees and beyond, whose rays do not meet the vertex plane in front of the surface. They start
    from the point nearest to the vertex.
    """
    z = z - e.h
    start = -(x * u + y * v + z * w)
    x, y, z = (torch.addcmul(p, start, d) for p, d in ((x, u), (y, v), (z, w)))
    f = (x * x + y * y + (1 + e.k) * (z * z)) * e.c - 2 * z
    g = w - (x * u + y * v + (1 + e.k) * (z * w)) * e.c
    a = (1 + e.k * (w * w)) * e.c
    cosine = (g * g - a * f).sqrt()
    t = torch.where(g >= 0, f / (g + cosine), (g - cosine) / a)
    return *(torch.addcmul(p, t, d) for p, d in ((x, u), (y, v), (z, w))), start + t, cosine


def _intersect(x, y, u, v, w, e: Element, check: bool):
    """Move points from the vertex plane to the surface in place; return z, distance and n·d, or None for a miss."""
    if e.kind is Plane:
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
    if e.kind is EvenAsphere:
        # A ray may pass its conic by and meet the asphere: it begins in the vertex plane.
        t = _newton(x, y, u, v, w, t.nan_to_num_(0.0, 0.0, 0.0), e)
        if t is None:
            return None
    x.addcmul_(t, u)
    y.addcmul_(t, v)
    z = t * w
    if e.kind is EvenAsphere:
        _, slope, defined = radial_sag(torch.addcmul(x * x, y, y), e.c, e.k, e.a)
        cosine = torch.addcmul(w, torch.addcmul(x * u, y, v), slope, value=-2)
        return None if check and not bool(defined.all()) else (z, t, cosine)
    return None if check and not _on_sheet(z, e) else (z, t, cosine)


def _on_sheet(z, e: Element) -> bool:
    """Return whether c(1 + k)z < 1 for all rays, by their extremes alone: not on the other sheet of the quadric."""
    factor = e.c * (1 + e.k)
    if isinstance(factor, float):
        return bool((z.amax() if factor > 0 else z.amin()) * factor < 1)
    # Where systems differ, rays that this bound does not decide go to the plain trace.
    return bool(z.abs().amax() * factor.abs().amax() < 1)


def _newton(x, y, u, v, w, t, e: Element):
    """Return the distance to an asphere by Newton's method, or None if a ray does not converge.

    Rays that do not converge from `t` begin once more in the vertex plane.
    """
    scale = 64 * torch.finfo(x.dtype).eps
    for _ in range(2):
        for _ in range(STEPS):
            px, py = torch.addcmul(x, t, u), torch.addcmul(y, t, v)
            squared = torch.addcmul(px * px, py, py)
            height, slope = radial_sag(squared, e.c, e.k, e.a)[:2]
            along = torch.addcmul(w, px.mul_(u).addcmul_(py, v), slope, value=-2)
            step = torch.addcmul(height, t, w, value=-1).neg_().div_(along)
            t = t - step
            if float(step.abs().amax()) <= scale * (1 + float(squared.amax()) ** 0.5):
                if bool((along * e.sign).amin() > 0):
                    return t
                break
        arrived = (step.abs() <= scale * (1 + squared.sqrt())) & (along * e.sign > 0)
        t = torch.where(arrived, t, 0.0)
    return None


def _normal(x, y, z, e: Element):
    """Return the gradient of F, its parts that are not plain zeros and ones, and its square (None for 1)."""
    if e.kind is Plane:
        return (None, None, None), None
    if e.kind is EvenAsphere:
        _, slope, _ = radial_sag(torch.addcmul(x * x, y, y), e.c, e.k, e.a)
        nx, ny = (slope * x).mul_(-2), (slope * y).mul_(-2)
        return (nx, ny, None), torch.addcmul(nx * nx, ny, ny).add_(1)
    nx, ny, nz = x * -e.c, y * -e.c, (z * (-e.c * (1 + e.k))).add_(1)
    if isinstance(e.k, float) and e.k == 0:
        return (nx, ny, nz), None
    return (nx, ny, nz), torch.addcmul(nx * nx, ny, ny).addcmul_(nz, nz)


def _deflected(old, cosine, normal, squared, e: Element):
    """Return d′ = μd + ΓN, Γ, and the root in it."""
    if e.action == "reflect":
        mu, root, gamma = 1.0, None, cosine * -2
    else:
        mu = e.n1 / e.n2
        root = cosine * cosine
        root.mul_(mu * mu)
        root = root.add_(1 - mu * mu) if squared is None else _add(root, squared, 1 - mu * mu)
        root.sqrt_()
        gamma = _add(root.clone() if e.sign > 0 else root.neg(), cosine, -mu)
    if squared is not None:
        gamma.div_(squared)
    parts = [value * mu for value in old]
    for axis, part in enumerate(parts):
        if normal[axis] is not None:
            part.addcmul_(gamma, normal[axis])
        elif axis == 2:
            part.add_(gamma)
    return parts, gamma, root


def _add(out, value, factor):
    """Add factor·value to `out`, the factor being a number or a tensor."""
    return out.add_(value, alpha=factor) if isinstance(factor, float) else out.addcmul_(value, factor)


def _elements(layout: Layout, numbers: Numbers, dtype: torch.dtype) -> list[Element]:
    """Return the elements of a batch as tensors ``[B, 1]`` of `dtype`, for broadcasting against rays ``[B, R]``."""
    narrow = [value.to(dtype) for value in numbers[:5]]
    return _build(layout, *[_columns(value) for value in narrow])


def _columns(value):
    """Return ``[B, S]`` as S tensors ``[B, 1]``, and ``[B, S, K]`` as S tuples of K of them."""
    if value.ndim == 3:
        return [tuple(v[:, i : i + 1] for i in range(v.shape[1])) for v in value.unbind(1)]
    return [value[:, i : i + 1] for i in range(value.shape[1])]


def _build(layout: Layout, curvature, conic, distance, coefficients, index) -> list[Element]:
    parts = zip(*layout[:4], strict=True)
    return [
        Element(*part, curvature[i], conic[i], distance[i], tuple(coefficients[i]), index[i], index[i + 1])
        for i, part in enumerate(parts)
    ]


def _vector_jacobian_product(sequence, records, gradients) -> tuple[list[torch.Tensor], list[SurfaceGradients]]:
    """Return the gradients of a block's rays and of the numbers of each surface, from those behind the last one."""
    *g, path = gradients
    found = []
    for e, p in zip(reversed(sequence), reversed(records), strict=True):
        g, shape, sides = _backward(e, p, g, path)
        # The next vertex is further by h: the points are nearer to it.
        found.append(SurfaceGradients(shape[0], shape[1], -_sum(g[2]), shape[2], *sides))
    return g, found[::-1]


def _accumulate(totals: Numbers, rows: tuple[Any, ...], i: int, change: SurfaceGradients) -> None:
    """Add the gradients of surface `i` to the totals of the systems `rows`."""
    own, behind = (*rows, i), (*rows, i + 1)
    totals.curvature[own] += change.curvature
    totals.conic[own] += change.conic
    totals.distance[own] += change.distance
    totals.index[own] += change.before
    totals.index[behind] += change.behind
    for j, value in enumerate(change.coefficients):
        term = (*own, j)
        totals.coefficients[term] += value


def _sum(value):
    return value.sum(-1, dtype=torch.float64)


def _backward(e: Element, p, g, path):
    """Return the gradients before a surface, of its shape, and of the two indices."""
    x, y, z, *direction = g
    before, behind = 0.0, 0.0
    normal = None
    if e.action != "pass":
        direction, normal, before, behind = _refraction_backward(e, p, direction)
    if normal is not None and e.kind is not Plane:
        shape, (x, y, z) = _normal_backward(e, p, normal, x, y, z)
    else:
        shape = [0.0, 0.0, [0.0] * len(e.a)]
    # T is the derivative by the distance along the ray, through the point and through the path.
    along = _dot((x, y, z), (p.u, p.v, p.w)).add_(path * e.n1)
    weight = along.div_(p.cosine).neg_()
    nx, ny, nz = p.normal
    if nx is not None:
        x, y = torch.addcmul(x, weight, nx), torch.addcmul(y, weight, ny)
        shape = _surface_backward(e, p, weight, shape)
    z = z + weight if nz is None else torch.addcmul(z, weight, nz)
    direction = [torch.addcmul(d, p.distance, v) for d, v in zip(direction, (x, y, z), strict=True)]
    return [x, y, z, *direction], shape, (before + _sum(p.distance * path), behind)


def _dot(a, b):
    """Return the scalar product; None in `b` means the components of (0, 0, 1)."""
    if b[0] is None:
        return a[2].clone() if b[2] is None else a[2] * b[2]
    out = torch.addcmul(a[0] * b[0], a[1], b[1])
    return out.add_(a[2]) if b[2] is None else out.addcmul_(a[2], b[2])


def _refraction_backward(e: Element, p, g):
    """Return the gradients of the direction before, of the normal, and of both indices."""
    gamma = _dot(g, p.normal)
    squared = 1.0 if p.squared is None else p.squared
    if e.action == "reflect":
        mu, slope = 1.0, gamma * -2 / squared
        along = slope
        size = -gamma * p.gamma / squared
        before = behind = 0.0
    else:
        mu = e.n1 / e.n2
        along = gamma * p.gamma / p.root * (-mu * e.sign)
        size = gamma * ((e.sign * (1 - mu * mu) / 2) / (p.root * squared) - p.gamma / squared)
        rise = (e.sign * mu * (p.cosine * p.cosine - squared) / p.root - p.cosine) / squared
        slope = _sum(_dot(g, (p.u, p.v, p.w)) + gamma * rise)
        n1, n2 = _flat(e.n1), _flat(e.n2)
        before, behind = slope / n2, -slope * n1 / n2**2
    normal = None
    if p.normal[0] is not None:
        old = (p.u, p.v, p.w)
        normal = [p.gamma * a + along * b for a, b in zip(g, old, strict=True)]
        for axis, value in enumerate(p.normal):
            normal[axis] = normal[axis] + 2 * size * (1.0 if value is None else value)
    g = [
        mu * a if n is None and axis < 2 else mu * a + along * (1.0 if n is None else n)
        for axis, (a, n) in enumerate(zip(g, p.normal, strict=True))
    ]
    return g, normal, before, behind


def _flat(value):
    return value if isinstance(value, float) else value[:, 0].to(torch.float64)


def _normal_backward(e: Element, p, normal, x, y, z):
    """Return the shape's gradients through the normal, and the point's gradients with theirs added."""
    a, b, c = normal
    if e.kind is Conic:
        factor = e.c * (1 + e.k)
        shape = [-_sum(a * p.x + b * p.y + c * p.z * (1 + e.k)), -_sum(e.c * c * p.z), [0.0] * len(e.a)]
        return shape, (x - e.c * a, y - e.c * b, z - factor * c)
    squared = p.x * p.x + p.y * p.y
    root, slope, bend = _derivatives(squared, e)
    on_slope = -2 * (p.x * a + p.y * b)
    through = 2 * on_slope * bend
    cube = root * root * root
    coefficients = [_sum(on_slope * (j + 1) * squared**j) for j in range(len(e.a))]
    shape = [_sum(on_slope / (2 * cube)), _sum(on_slope * e.c**3 * squared / (4 * cube)), coefficients]
    return shape, (x - 2 * slope * a + through * p.x, y - 2 * slope * b + through * p.y, z)


def _derivatives(squared, e: Element):
    """Return √(1 − (1 + k)c²r²) and the first and second derivatives of the height by r²."""
    root = (1 - (1 + e.k) * e.c * e.c * squared).sqrt()
    slope = e.c / (2 * root)
    bend = (1 + e.k) * e.c**3 / (4 * root * root * root)
    for j, coefficient in enumerate(e.a):
        slope = slope + (j + 1) * coefficient * squared**j
        if j:
            bend = bend + j * (j + 1) * coefficient * squared ** (j - 1)
    return root, slope, bend


def _surface_backward(e: Element, p, weight, shape):
    """Return the shape's gradients with w·∂F/∂θ added."""
    squared = p.x * p.x + p.y * p.y
    if e.kind is Conic:
        bowl, conic, root, powers = p.z * p.z * (1 + e.k) + squared, p.z * p.z * e.c, 2.0, []
    else:
        # For an asphere, z is the height of its conic part alone.
        root = (1 - (1 + e.k) * e.c * e.c * squared).sqrt()
        z = e.c * squared / (1 + root)
        bowl, conic, root = squared + (1 + e.k) * z * z, e.c * z * z, 2 * root
        powers = [_sum(weight * squared ** (j + 1)) for j in range(len(e.a))]
    curvature, constant = shape[0] - _sum(weight * bowl / root), shape[1] - _sum(weight * conic / root)
    coefficients = [a - b for a, b in zip(shape[2], powers or [0.0] * len(shape[2]), strict=True)]
    return [curvature, constant, coefficients]
