"""Rays against triangles: our search against Embree, the obvious dense test, and a budget of memory."""

import json
import pathlib
import subprocess
import sys
from collections.abc import Iterator

import torch
from measure import interleave, measure
from wave_optics import row

from odak.learn.raytracing import triangle_mesh
from odak.learn.raytracing.mesh import embree_scene, has_embree

RAYS, TRIANGLES, MANY, GIGABYTE = 100_000, 10_000, 82_000, 2**30


def patch(device: str, dtype: torch.dtype = torch.float32, count: int = TRIANGLES) -> tuple[torch.Tensor, torch.Tensor]:
    """Return vertices and faces of a dome of triangles: a square grid drawn into a disc and laid on a sphere."""
    side = torch.linspace(-1, 1, round((count / 2) ** 0.5) + 1, dtype=torch.float64)
    x, y = torch.meshgrid(side, side, indexing="ij")
    polar, turn = 1.6 * torch.maximum(x.abs(), y.abs()), torch.atan2(y, x)
    vertices = torch.stack((polar.sin() * turn.cos(), polar.sin() * turn.sin(), polar.cos()), dim=-1).reshape(-1, 3)
    index = torch.arange(len(vertices)).reshape(len(side), len(side))
    near, right, up, far = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
    faces = [torch.stack(corners, dim=-1).reshape(-1, 3) for corners in ((near, right, far), (near, far, up))]
    return vertices.to(device, dtype), torch.cat(faces).to(device)


def incoherent_rays(count: int, device: str, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """Return rays from all around the dome towards places within it."""
    generator = torch.Generator().manual_seed(0)
    start = 3 * torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=1)
    direction = torch.rand(count, 3, generator=generator, dtype=torch.float64) * 1.6 - 0.8 - start
    rays = torch.stack((start, torch.nn.functional.normalize(direction, dim=1)), dim=1)
    return rays.to(device, dtype)


def nearest_hits(device: str) -> Iterator[dict]:
    """Yield 100 000 rays on 82 000 triangles against the bare call of Embree, where it is installed."""
    vertices, faces = patch(device, count=MANY)
    rays = incoherent_rays(RAYS, device)
    mesh = triangle_mesh(vertices, faces, backend="torch")
    double, double_rays = triangle_mesh(vertices.double(), faces, backend="torch"), rays.double()
    tasks = {"ours": lambda: mesh.intersect(rays), "double": lambda: double.intersect(double_rays)}
    if not has_embree():
        timing = measure(tasks["ours"], 5, device).best
        yield row("nearest hits, 100k rays, 82k triangles", timing, timing, "itself, no embreex", None)
        return
    scene = embree_scene(vertices, faces)
    start, direction = (rays[:, i].cpu().contiguous().numpy() for i in (0, 1))
    behind = triangle_mesh(vertices, faces, backend="embree")
    tasks["embree"] = lambda: scene.run(start, direction)
    tasks["behind"] = lambda: behind.intersect(rays)
    timings = {name: timing.best for name, timing in interleave(tasks, 5, device).items()}
    for task, name, bound in (
        ("nearest hits", "ours", 10.0),
        ("  float64", "double", 10.0),
        ("  embree", "behind", 1.5),
    ):
        yield row(f"{task}, 100k rays, 82k triangles", timings[name], timings["embree"], "embree", bound)


def dense(device: str) -> Iterator[dict]:
    """Yield our search against Möller–Trumbore of every pair, on as many rays as that can hold."""
    vertices, faces = patch(device)
    rays = incoherent_rays(1024, device)
    mesh, corners = triangle_mesh(vertices, faces, backend="torch"), vertices[faces]
    tasks = {"ours": lambda: mesh.intersect(rays), "dense": lambda: _moller_trumbore(rays, corners)}
    timings = interleave(tasks, 3, device)
    yield row("nearest hits, 1k rays, 10k triangles", timings["ours"].best, timings["dense"].best, "all pairs", 0.1)


def _moller_trumbore(rays: torch.Tensor, corners: torch.Tensor) -> torch.Tensor:
    """Return the nearest distances, as one would write them down: every ray with every triangle."""
    start, direction = rays[:, None, 0], rays[:, None, 1]
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = torch.linalg.cross(direction, edge2.expand(len(rays), -1, -1))
    inverse = 1 / (across * edge1).sum(dim=-1)
    arm = start - corners[:, 0]
    u = (across * arm).sum(dim=-1) * inverse
    turned = torch.linalg.cross(arm, edge1.expand(len(rays), -1, -1))
    v, t = (turned * direction).sum(dim=-1) * inverse, (turned * edge2).sum(dim=-1) * inverse
    return torch.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, torch.inf).amin(dim=1)


def building(device: str) -> Iterator[dict]:
    """Yield the building of the hierarchy and its refit to moved vertices, against one search of 100 000 rays."""
    vertices, faces = patch(device)
    rays, one = incoherent_rays(RAYS, device), incoherent_rays(1, device)
    mesh = triangle_mesh(vertices, faces, backend="torch")
    tasks = {
        "search": lambda: mesh.intersect(rays),
        "build": lambda: triangle_mesh(vertices, faces, backend="torch").intersect(one),
        "refit": lambda: mesh.moved(vertices).intersect(one),
    }
    timings = {name: timing.best for name, timing in interleave(tasks, 5, device).items()}
    yield row("build the hierarchy, 10k triangles", timings["build"], timings["search"], "search", None)
    yield row("refit the hierarchy, 10k triangles", timings["refit"], timings["search"], "search", None)


def own_peak(device: str) -> int:
    """Return the peak of memory in bytes of this process alone: getrusage counts that of the one that started it."""
    if device == "cuda":
        return torch.cuda.max_memory_allocated()
    lines = pathlib.Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


def memory(device: str) -> Iterator[dict]:
    """Yield the peak memory of 100 000 rays on 10 000 triangles, with gradients, in gigabytes."""
    code = (
        "import json, sys; sys.path.insert(0, 'benchmarks'); import torch, triangles; from triangles import own_peak; "
        "from odak.learn.raytracing import triangle_mesh; "
        f"vertices, faces = triangles.patch({device!r}); rays = triangles.incoherent_rays({RAYS}, {device!r}); "
        "mesh = triangle_mesh(vertices.requires_grad_(), faces, backend='torch'); mesh.intersect(rays[:1]); "
        f"before = own_peak({device!r}); hit = mesh.intersect(rays.requires_grad_()); "
        f"hit.distance[hit.hit].sum().backward(); print(json.dumps(own_peak({device!r}) - before))"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    gigabytes = json.loads(output) / GIGABYTE
    yield {
        "task": "nearest hits with gradients, peak memory",
        "ours_arrays": gigabytes,
        "floor": "GiB",
        "ratio": gigabytes,
        "bound": 1.0,
    }


ALL = [nearest_hits, dense, building, memory]
