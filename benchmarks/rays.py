"""Ray benchmarks: each closed form against one bare pass of the same arithmetic over the same arrays.

The bare pass reads the same rays and writes results of the same sizes, component by component and in pieces that fit
the cache, but asks nothing: no misses, no parallel rays, no rounding, no status, no choice between two points.
"""

from collections.abc import Callable, Iterator
from functools import partial

import torch
from measure import interleave
from wave_optics import row

from odak.learn import raytracing as rt
from odak.raytracing import batches, boundary, intersections
from odak.raytracing.components import along, dot, minus, scaled, split, without

COUNT, BOUND = 10**6, 4.0
DTYPES = (torch.float32, torch.float64)


def flat(device: str) -> Iterator[dict]:
    """Yield plane, triangle and disc."""
    for dtype in DTYPES:
        corners = torch.tensor([[-9.0, -9, 10], [9, -9, 10], [0, 9, 10]], dtype=dtype, device=device)
        centre, normal, radius = corners.mean(0), rt.get_triangle_normal(corners)[1], corners.new_tensor(9.0)
        ray = _rays_towards(10.0, corners)
        rays = ray[:, 0], ray[:, 1]
        plane = {"c": centre.unbind(), "n": normal.unbind()}
        yield from _rows(
            dtype,
            device,
            plane=(partial(rt.intersect_w_surface, ray, corners), _bare(partial(_plane, **plane), (1, 6), *rays)),
            triangle=(
                partial(boundary.plane_hits, ray, corners, intersections.on_triangle, (corners,), (2,)),
                _bare(partial(_triangle, corners=corners, **plane), (1, 6, 1), *rays),
            ),
            disc=(
                partial(boundary.plane_hits, ray, corners, _within, (centre, radius), (1, 0)),
                _bare(partial(_disc, radius=radius, **plane), (1, 6, 1), *rays),
            ),
        )


def curved(device: str) -> Iterator[dict]:
    """Yield sphere, cylinder and conic."""
    for dtype in DTYPES:
        centre, axis = torch.tensor([[0.0, 0, 10], [1, 0, 0]], dtype=dtype, device=device)
        radius, curvature, constant = torch.tensor([3.0, 0.1, -0.5], dtype=dtype, device=device)
        ray, ball = _rays_towards(10.0, centre), torch.cat((centre, radius[None]))
        rays, low = (ray[:, 0], ray[:, 1]), ray[:, 0] - centre
        middle = {"c": centre.unbind(), "radius": radius}
        yield from _rows(
            dtype,
            device,
            sphere=(partial(rt.intersect_w_sphere, ray, ball), _bare(partial(_sphere, **middle), (6, 6, 1), *rays)),
            cylinder=(
                partial(_hits, intersections.cylinder, (1, 1, 1, 0, 1), *rays, centre, radius, axis),
                _bare(partial(_cylinder, a=axis.unbind(), **middle), (1, 3, 3), *rays),
            ),
            conic=(
                partial(_hits, _on_conic, (1, 1, 0, 0), low, rays[1], curvature, constant),
                _bare(partial(_conic, curvature=curvature, k=1 + constant), (1, 3, 3), low, rays[1]),
            ),
        )


def _hits(form: Callable, ranks: tuple[int, ...], *arrays):
    return batches.in_pieces(lambda *pieces: intersections.as_hit(form(*pieces)), ranks, *arrays)


def _on_conic(*arrays):
    return intersections.conic(*arrays)[0]


def _within(found: intersections.Intersection, centre: torch.Tensor, radius: torch.Tensor) -> torch.Tensor:
    arm = minus(found.point, split(centre))
    return found.hit & (dot(arm, arm) <= radius * radius)


def interfaces(device: str) -> Iterator[dict]:
    """Yield reflection and refraction."""
    for dtype in DTYPES:
        like = torch.zeros(1, dtype=dtype, device=device)
        ray, normal = _rays_towards(10.0, like), _rays_towards(3.0, like, 1)
        vectors = ray[:, 1], normal[:, 0], normal[:, 1]
        yield from _rows(
            dtype,
            device,
            reflect=(partial(rt.reflect, ray, normal), _bare(_reflect, (6,), *vectors)),
            refract=(partial(rt.refract, ray, normal, 1.0, 1.5), _bare(_refract, (6,), *vectors)),
        )


def gradients(device: str) -> Iterator[dict]:
    """Yield a pass there and back against the same without gradients; no bound."""
    for dtype in DTYPES:
        like = torch.zeros(1, dtype=dtype, device=device)
        ray, normal = _rays_towards(10.0, like).requires_grad_(), _rays_towards(3.0, like, 1)
        ball = torch.tensor([0.0, 0, 10, 3], dtype=dtype, device=device)
        for name, task in {
            "sphere": partial(rt.intersect_w_sphere, ray, ball),
            "refract": partial(rt.refract, ray, normal, 1.0, 1.5),
        }.items():
            ways = {"forward": partial(_without_graph, task), "both": partial(_there_and_back, task, ray)}
            timings = interleave(ways, 3, device)
            label = f"{name} with gradients, 10⁶ rays, {_name(dtype)}"
            yield row(label, timings["both"].best, timings["forward"].best, "no gradients", None)


def _rows(dtype: torch.dtype, device: str, **tasks: tuple[Callable, Callable]) -> Iterator[dict]:
    """Yield a row for each pair of a task and the bare pass, run alternately."""
    for name, (ours, floor) in tasks.items():
        timings = interleave({"ours": ours, "bare": floor}, 7, device)
        label = f"{name}, 10⁶ rays, {_name(dtype)}"
        yield row(label, timings["ours"].best, timings["bare"].best, "bare pass", BOUND)


def _rays_towards(depth: float, like: torch.Tensor, seed: int = 0) -> torch.Tensor:
    """Return 10⁶ rays from about the origin to about (0, 0, depth)."""
    random = torch.Generator(device=like.device).manual_seed(seed)
    ends = torch.rand(2, COUNT, 3, dtype=like.dtype, device=like.device, generator=random) - 0.5
    ends[1, :, 2] += depth
    return rt.create_ray_from_two_points(ends[0], ends[1])


def _bare(formula: Callable, widths: tuple[int, ...], *vectors: torch.Tensor) -> Callable:
    """Return a task that runs `formula` once over all rays: components of vectors ``[n, 3]`` in, components out.

    `widths` holds the number of components of each result.
    """
    step = batches.piece_size(vectors) if vectors[0].device.type == "cpu" else COUNT

    def task():
        whole = [vectors[0].new_empty(COUNT, width) for width in widths]
        for start in range(0, COUNT, step):
            place = slice(start, start + step)
            results = formula(*(tuple(c.contiguous() for c in vector[place].unbind(-1)) for vector in vectors))
            columns = [column for array in whole for column in array[place].unbind(-1)]
            for column, result in zip(columns, results, strict=True):
                column.copy_(result)

    return task


def _plane(o, d, c, n):
    t = dot(n, minus(c, o)) / dot(n, d)
    return t, *along(o, t, d), *n


def _triangle(o, d, corners, c, n):
    p0, edge1, edge2 = (v.unbind() for v in (corners[0], corners[1] - corners[0], corners[2] - corners[0]))
    d11, d12, d22 = dot(edge1, edge1), dot(edge1, edge2), dot(edge2, edge2)
    met = _plane(o, d, c, n)
    arm = minus(met[1:4], p0)
    a1, a2, area = dot(arm, edge1), dot(arm, edge2), d11 * d22 - d12 * d12
    u, v = (d11 * a2 - d12 * a1) / area, (d22 * a1 - d12 * a2) / area
    return *met, (u >= 0) & (v >= 0) & (u + v < 1)


def _disc(o, d, c, n, radius):
    met = _plane(o, d, c, n)
    arm = minus(met[1:4], c)
    return *met, dot(arm, arm) <= radius * radius


def _sphere(o, d, c, radius):
    t = _nearer(minus(o, c), d, radius)
    place = along(o, t, d)
    return *place, *d, *c, *_unit(minus(place, c)), t


def _cylinder(o, d, c, radius, a):
    t = _nearer(without(minus(o, c), a), without(d, a), radius)
    place = along(o, t, d)
    return t, *place, *_unit(without(minus(place, c), a))


def _nearer(arm, direction, radius):
    squared, half = dot(direction, direction), dot(arm, direction)
    foot = along(arm, -half / squared, direction)
    root = (squared * (radius * radius - dot(foot, foot))).sqrt()
    q = -(half + torch.copysign(root, half))
    return torch.minimum(q / squared, (dot(arm, arm) - radius * radius) / q)


def _conic(o, d, curvature, k):
    offset = -dot(o, d) / dot(d, d)
    (x, y, z), (dx, dy, dz) = along(o, offset, d), d
    p = curvature * (dx * dx + dy * dy + k * (dz * dz))
    q = curvature * (x * dx + y * dy + k * (z * dz)) - dz
    r = curvature * (x * x + y * y + k * (z * z)) - 2 * z
    t = r / -(q + torch.copysign((q * q - p * r).sqrt(), q)) + offset
    x, y, z = place = along(o, t, d)
    return t, *place, *_unit((-curvature * x, -curvature * y, 1 - curvature * k * z))


def _reflect(d, p, n):
    return *p, *along(d, -2 * dot(d, n) / dot(n, n), n)


def _refract(d, p, n):
    n, ratio = _unit(n), 1 / 1.5
    cosine = dot(d, n)
    across = along(d, -cosine, n)
    root = (dot(d, d) - ratio * ratio * dot(across, across)).sqrt()
    return *p, *along(scaled(across, ratio), torch.copysign(root, cosine), n)


def _unit(vector):
    length = dot(vector, vector).sqrt()
    return vector[0] / length, vector[1] / length, vector[2] / length


def _without_graph(task: Callable) -> None:
    with torch.no_grad():
        task()


def _there_and_back(task: Callable, ray: torch.Tensor) -> None:
    ray.grad = None
    result = task()
    result = result[2] if isinstance(result, tuple) else result
    result.backward(torch.ones_like(result))


def _name(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")


ALL = (flat, curved, interfaces, gradients)
