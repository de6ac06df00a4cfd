"""The adjoints of transfer, intersection and refraction, written by hand: gradients of a block, back to front.

With p′ = p + Td on F(p′) = 0, N = ∂F/∂p and d′ = μd + ΓN, Γ = (±q − μ N·d)/N², q² = (1 − μ²)N² + μ²(N·d)². The
intersection is differentiated by the implicit function theorem, dT = −(N·(dp + T dd) + ∂F/∂θ dθ)/(N·d): how T was found
does not matter.
"""

from typing import Any, NamedTuple

import torch

from odak.learn.raytracing.system.elements import Element, Numbers


class Change(NamedTuple):
    """Gradients of one surface's numbers, ``[rows]`` each: as in Numbers, with those of the indices on both sides."""

    curvature: Any
    conic: Any
    distance: Any
    coefficients: list
    before: Any
    behind: Any


def back(sequence, passages, gradients) -> tuple[list[torch.Tensor], list[Change]]:
    """Return the gradients of a block's rays, and those of the numbers of each surface.

    Parameters
    ----------
    sequence : list of Element
        Surfaces.
    passages : list of Passage
        What the block left at each of them.
    gradients : list of torch.Tensor
        Of x, y, z, u, v, w and path behind the last surface.
    """
    *g, path = gradients
    changes = []
    for e, p in zip(reversed(sequence), reversed(passages), strict=True):
        g, shape, sides = _through(e, p, g, path)
        # The next vertex is further by h: the points are nearer to it.
        changes.append(Change(shape[0], shape[1], -_sum(g[2]), shape[2], *sides))
    return g, changes[::-1]


def add(totals: Numbers, rows: slice, i: int, change: Change) -> None:
    """Add the gradients of surface `i` to those of the systems `rows`."""
    totals.curvature[rows, i] += change.curvature
    totals.conic[rows, i] += change.conic
    totals.distance[rows, i] += change.distance
    totals.index[rows, i] += change.before
    totals.index[rows, i + 1] += change.behind
    for j, value in enumerate(change.coefficients):
        totals.coefficients[rows, i, j] += value


def _sum(value):
    return value.sum(-1, dtype=torch.float64)


def _through(e: Element, p, g, path):
    """Return the gradients before a surface, those of its shape, and those of the two indices."""
    x, y, z, *direction = g
    before, behind = 0.0, 0.0
    normal = None
    if e.action != "pass":
        direction, normal, before, behind = _refraction(e, p, direction)
    if normal is not None and e.kind != "plane":
        shape, (x, y, z) = _normal_back(e, p, normal, x, y, z)
    else:
        shape = [0.0, 0.0, [0.0] * len(e.a)]
    # Along the ray: T carries what moves the point along it, and the path.
    along = _dot((x, y, z), (p.u, p.v, p.w)).add_(path * e.n1)
    weight = along.div_(p.cosine).neg_()
    nx, ny, nz = p.normal
    if nx is not None:
        x, y = torch.addcmul(x, weight, nx), torch.addcmul(y, weight, ny)
        shape = _surface_back(e, p, weight, shape)
    z = z + weight if nz is None else torch.addcmul(z, weight, nz)
    direction = [torch.addcmul(d, p.distance, v) for d, v in zip(direction, (x, y, z), strict=True)]
    return [x, y, z, *direction], shape, (before + _sum(p.distance * path), behind)


def _dot(a, b):
    """Return Σ a·b over the components that are there; None in `b` stands for (0, 0, 1)'s parts."""
    if b[0] is None:
        return a[2].clone() if b[2] is None else a[2] * b[2]
    out = torch.addcmul(a[0] * b[0], a[1], b[1])
    return out.add_(a[2]) if b[2] is None else out.addcmul_(a[2], b[2])


def _refraction(e: Element, p, g):
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


def _normal_back(e: Element, p, normal, x, y, z):
    """Return the shape's gradients through the normal, and those of the point with them added."""
    a, b, c = normal
    if e.kind == "conic":
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


def _surface_back(e: Element, p, weight, shape):
    """Return the shape's gradients with w·∂F/∂θ added."""
    squared = p.x * p.x + p.y * p.y
    if e.kind == "conic":
        bowl, conic, root, powers = p.z * p.z * (1 + e.k) + squared, p.z * p.z * e.c, 2.0, []
    else:
        # For an asphere, z is that of its conic part alone.
        root = (1 - (1 + e.k) * e.c * e.c * squared).sqrt()
        z = e.c * squared / (1 + root)
        bowl, conic, root = squared + (1 + e.k) * z * z, e.c * z * z, 2 * root
        powers = [_sum(weight * squared ** (j + 1)) for j in range(len(e.a))]
    curvature, constant = shape[0] - _sum(weight * bowl / root), shape[1] - _sum(weight * conic / root)
    coefficients = [a - b for a, b in zip(shape[2], powers or [0.0] * len(shape[2]), strict=True)]
    return [curvature, constant, coefficients]
