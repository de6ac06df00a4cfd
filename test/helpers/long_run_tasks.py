"""Loops that the tests of long runs let a fresh process go through, and what these leave behind in its memory."""

import ctypes
import gc
import itertools
import tracemalloc

import psutil
import torch


class Watch:
    """What this process holds more than when the watch began: resident bytes, Python's own bytes, and objects."""

    def __init__(self, traced=False):
        if traced:
            tracemalloc.start()
        self.start = self._now()

    def growth(self):
        """Return the growth since the start as a dict."""
        return {name: value - self.start[name] for name, value in self._now().items()}

    @staticmethod
    def _now():
        gc.collect()
        # What the allocator keeps for the next request is not held by anyone, and how much that is varies by megabytes.
        if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
            trim(0)
        python = tracemalloc.get_traced_memory()[0] if tracemalloc.is_tracing() else 0
        return {"rss": psutil.Process().memory_info().rss, "python": python, "objects": len(gc.get_objects())}


def repeated(step, warm_up, count, traced=False):
    """Return the growth over `count` calls of `step` with the number of the call, after some to warm up."""
    torch.set_num_threads(1)
    for index in range(warm_up):
        step(index)
    watch = Watch(traced)
    for index in range(warm_up, warm_up + count):
        step(index)
    return watch.growth()


def one_long_optimisation(iterations, side=256, warm_up=200):
    """Return the growth over the iterations of one gradient descent."""
    from odak.learn.wave import stochastic_gradient_descent

    torch.set_num_threads(1)
    watches, growth = [], []

    def begin(iteration, loss):
        # Both looks fall between two iterations.
        if iteration == warm_up:
            watches.append(Watch())
        elif iteration == warm_up + iterations - 1:
            growth.append(watches[0].growth())

    target = torch.rand(side, side, generator=torch.Generator().manual_seed(1))
    stochastic_gradient_descent(
        target, 532e-9, 5e-3, 8e-6, n_iteration=warm_up + iterations, seed=2, progress=False, callback=begin
    )
    return growth[0]


def many_short_optimisations(count, side=64):
    """Return the growth over many runs of five iterations, of gradient descent and of Gerchberg and Saxton."""
    from odak.learn import wave

    target = torch.rand(side, side, generator=torch.Generator().manual_seed(1))

    def step(index):
        wave.stochastic_gradient_descent(target, 532e-9, 1e-3, 8e-6, n_iteration=5, seed=index, progress=False)
        wave.gerchberg_saxton(target, 3, 1e-3, 8e-6, 532e-9, progress=False)

    return repeated(step, 20, count)


def many_geometries(count, bound):
    """Return the most bytes that the store of kernels held over as many geometries, and the growth meanwhile."""
    import odak
    from odak.wave.transfer_functions import kernels

    odak.wave.set_kernel_cache_size(bound)
    most = 0
    methods = itertools.cycle(["Bandlimited Angular Spectrum", "Angular Spectrum", "TR Fresnel", "IR Fresnel"])

    def step(index):
        nonlocal most
        field = torch.ones(24 + index % 17, 32, dtype=torch.complex64)
        wavelength = (450 + index % 200) * 1e-9
        odak.learn.wave.propagate_beam(field, None, 1e-3 + index * 1e-6, 8e-6, wavelength, next(methods))
        most = max(most, kernels.bytes)

    return {"most": most, **repeated(step, 1100, count)} | {"most": most}


def many_targets(count):
    """Return the growth over as many targets and gazes of one metameric loss, each with its gradient."""
    from odak.learn.perception import MetamericLoss

    loss = MetamericLoss(n_pyramid_levels=3)
    generator = torch.Generator().manual_seed(3)

    def step(index):
        image, target = torch.rand(2, 1, 3, 64, 64, generator=generator)
        gaze = torch.rand(2, generator=generator).tolist()
        loss(image.requires_grad_(), target, gaze).backward()

    return repeated(step, 100, count)


def many_rays(count):
    """Return the growth over many traces of a lens with gradients, and of rays through a sphere."""
    from odak.learn import raytracing
    from odak.learn.raytracing import system

    triplet = system.load_system("cooke_triplet")
    curvature = triplet.prescription().curvature.clone().requires_grad_()
    ends = torch.rand(64, 3, generator=torch.Generator().manual_seed(4)) + torch.tensor([-0.5, -0.5, 5.0])
    rays = raytracing.create_ray_from_two_points(torch.zeros(1, 3), ends)

    def step(index):
        numbers = triplet.prescription()._replace(curvature=curvature * (1 + 1e-6 * index))
        system.rms_spot(triplet, "rings", 3, prescription=numbers).sum().backward()
        curvature.grad = None
        normals, *_ = raytracing.intersect_w_sphere(rays, torch.tensor([0.0, 0.0, 5.0, 2.0 + 1e-6 * index]))
        raytracing.refract(rays, normals, 1.0, 1.5)

    return repeated(step, 30, count)


def many_figures(count):
    """Return the growth over many plots that are made and dropped."""
    from odak.visualize.plotly import rayshow

    points = torch.rand(20, 3, generator=torch.Generator().manual_seed(5)).numpy()

    def step(index):
        plot = rayshow(rows=1, columns=1)
        plot.add_point(points + index)

    return repeated(step, 5, count)


def square(number):
    """Return the square of a number."""
    return number * number


def resident():
    """Return the resident bytes of this process."""
    gc.collect()
    return psutil.Process().memory_info().rss


def files_of_worker(dask_worker):
    """Return the files that a worker holds."""
    from pathlib import Path

    return sorted(str(path) for path in Path(dask_worker.local_directory).rglob("*") if path.is_file())
