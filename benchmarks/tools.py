"""Tool benchmarks: the B-spline fit against the dense basis, the rotation of points against one matrix product."""

from collections.abc import Iterator

import torch
from measure import interleave, measure
from wave_optics import row

from odak.learn import tools
from odak.tools import rotate_points, sphere_sample

SHAPE, SPLINES = (128, 128), [16, 16]
POINTS = 10**6


def bspline(device: str) -> Iterator[dict]:
    """Yield the fit of a picture against the dense normal equations, as one would write them down."""
    image = torch.rand(SHAPE, device=device)

    def dense():
        basis, _ = tools.generate_bspline_basis_2d(SPLINES, SHAPE, device)
        gram = basis @ basis.T + 1e-6 * torch.eye(len(basis), device=device)
        return torch.linalg.solve(gram, basis @ image.reshape(-1))

    def fit():
        return tools.decompose_bspline_2d(image, SPLINES)

    timings = interleave({"dense": dense, "fit": fit}, device=device)
    yield row("B-spline fit 128², 16² splines", timings["fit"].best, timings["dense"].best, "dense basis", 1 / 20)
    large = torch.rand(1080, 1920, device=device)
    time = measure(lambda: tools.decompose_bspline_2d(large, [64, 36]), 5, device).best
    yield {"task": "B-spline fit 1080p, 64 × 36 splines", "ours_s": time, "floor": "1 s", "ratio": time, "bound": None}


def rotation(device: str) -> Iterator[dict]:
    """Yield the rotation of 10⁶ points, matrices included, against one product of the points with a matrix."""
    points = torch.randn(POINTS, 3, device=device)
    angles, origin = torch.tensor([[10.0, 20.0, 30.0]], device=device), torch.ones(1, 3, device=device)
    matrix = tools.get_rotation_matrix([10.0, 20.0, 30.0]).to(device)
    tasks = {
        "bare": lambda: points @ matrix.T,
        "ours": lambda: tools.rotate_points(points, angles),
        "moved": lambda: tools.rotate_points(points, angles, origin=origin, offset=origin),
    }
    timings = interleave(tasks, 21, device=device)
    for name, task in (("ours", "rotation of 10⁶ points"), ("moved", "the same about an origin, with an offset")):
        yield row(task, timings[name].best, timings["bare"].best, "1 matrix product", 2.0)
    numbers, turn = points.double().cpu().numpy(), matrix.double().cpu().numpy()
    tasks = {"bare": lambda: numbers @ turn.T, "ours": lambda: rotate_points(numbers, [10.0, 20.0, 30.0])}
    timings = interleave(tasks, 21)
    yield row("the same in NumPy", timings["ours"].best, timings["bare"].best, "1 matrix product", 2.0)


def sampling(device: str) -> Iterator[dict]:
    """Yield 10⁶ points of a sphere against their sines and cosines alone."""
    angle = torch.linspace(0, 6, POINTS, dtype=torch.float64)
    timings = interleave({"bare": lambda: (angle.sin(), angle.cos()), "ours": lambda: sphere_sample([1000, 1000])})
    yield row("10⁶ points of a sphere", timings["ours"].best, timings["bare"].best, "sine and cosine", None)


ALL = (bspline, rotation, sampling)
