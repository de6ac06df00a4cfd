"""Long runs: memory stays as it was, caches keep their limit, and a process that forks after use does not hang."""

import ctypes
import gc
import os
import subprocess
import sys

import numpy as np
import pytest
import torch

import odak
from odak.learn.perception import MetamericLoss, srgb_to_lab
from odak.learn.raytracing.system import configurations, load_system, rms_spot
from odak.learn.wave import Display, Modulator, Run, optimise, propagate_beam, stochastic_gradient_descent
from odak.wave import filter_in_focal_plane, set_kernel_cache_size, simulate_bench, spot_hologram

pytestmark = pytest.mark.slow
FORK = """
import os, signal, numpy as np, torch
torch.set_num_threads(2)
import odak
from odak.learn.raytracing.system import load_system, rms_spot
from odak.learn.wave import propagate_beam
light, lens = torch.ones(1080, 1920, dtype=torch.complex64), load_system("singlet")
def use():
    out = propagate_beam(light, None, 0.1, 8e-6, 532e-9)
    field = odak.wave.propagate_beam(light.numpy(), None, 0.1, 8e-6, 532e-9)
    return float(out.abs().sum()), float(rms_spot(lens, "rings", 40).sum()), float(np.abs(field).sum())
first = use()
child = os.fork()
if child == 0:
    signal.alarm(100)
    os._exit(0 if np.allclose(use(), first, rtol=1e-5) else 3)
print(os.waitpid(child, 0)[1])
"""


def resident():
    """Return the memory of this process in MB, without pages of files and what the allocator keeps for later."""
    gc.collect()
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
        trim(0)
    with open("/proc/self/statm") as stream:
        held, files = map(int, stream.read().split()[1:3])
    return (held - files) * os.sysconf("SC_PAGE_SIZE") / 2**20


def calls():
    """Return functions of a number, of which each number is another question."""
    light = torch.ones(64, 64, dtype=torch.complex64)
    picture, other = torch.rand(2, 1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    lens, loss = load_system("singlet"), MetamericLoss(n_pyramid_levels=2)
    options = {"wavelength": 532e-9, "pixel_pitch": 8e-6, "n_iteration": 2, "progress": False}
    run, points = Run(iterations=2, progress=False), torch.tensor([[-2e-4, 0.0, 0.05], [1e-4, 2e-4, 0.06]])
    large, triplet = torch.ones(2, 128, 128, dtype=torch.complex64).numpy(), load_system("cooke_triplet")
    bench = {"wavelength": "532nm", "resolution": [128, 128], "pixel_pitch": "8um"}

    def at(i):
        return 0.01 + 1e-5 * i

    def positions(i):
        zoom = configurations(triplet, [("thickness", -1, [42.0, 42.3 + 1e-4 * i])])
        zoom.vary("thickness", -1)
        spots = zoom.each(rms_spot, "rings", 4)
        spots.sum().backward(retain_graph=True)
        return spots

    def elements(i):
        passage = {"kind": "propagate", "distance": f"{at(i)}m"}
        return [{"kind": "plane_wave"}, passage, {"kind": "record", "name": "here"}]

    return {
        "propagate_beam": (1000, lambda i: propagate_beam(light, None, at(i), 8e-6, 532e-9)),
        "odak.wave.propagate_beam": (
            2000,
            lambda i: odak.wave.propagate_beam(light.numpy(), None, at(i), 8e-6, 532e-9),
        ),
        "gradient descent": (200, lambda i: stochastic_gradient_descent(picture[0, 0], distance=at(i), **options)),
        "Display": (200, lambda i: Display(Modulator((32, 32), 8e-6), 532e-9, at(i))(torch.zeros(32, 32))),
        "metameric loss": (300, lambda i: loss(picture, other, [0.5, 0.3 + 1e-4 * i])),
        "srgb_to_lab": (2000, lambda i: srgb_to_lab(picture)),
        "rms_spot": (300, lambda i: rms_spot(lens, "rings", 4)),
        "windows": (300, lambda i: odak.wave.propagate_to_window(light.numpy(), 532e-9, at(i), 8e-6, (32, 32), 9e-6)),
        "optimise": (50, lambda i: optimise(Display(Modulator((64, 64), 8e-6), 532e-9, at(i)), picture[0, 0], run=run)),
        "spot_hologram": (500, lambda i: spot_hologram(points + 1e-6 * i, (128, 128), 532e-9, 8e-6, 5)),
        "filter_in_focal_plane": (100, lambda i: filter_in_focal_plane(large, np.hypot, at(i), 8e-6, 532e-9)),
        "simulate_bench": (150, lambda i: simulate_bench({"bench": bench, "elements": elements(i)})),
        "configurations": (200, positions),
    }


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="memory is read from /proc")
@pytest.mark.parametrize("name", list(calls()))
def test_memory_stays_as_it_was(name):
    count, call = calls()[name]
    try:
        set_kernel_cache_size(4 << 20)
        for i in range(count // 8):
            call(-i)
        before = resident()
        for i in range(count):
            call(i)
        assert resident() - before < 20
    finally:
        set_kernel_cache_size(None)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_process_that_forks_after_use_goes_on():
    environment = os.environ | {"OMP_NUM_THREADS": "2"}
    run = subprocess.run([sys.executable, "-c", FORK], env=environment, capture_output=True, text=True, timeout=200)
    assert run.stdout == "0\n", run.stderr
