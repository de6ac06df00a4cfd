"""Tasks that test_faults.py runs in a separate process, with a forked child for each that is terminated."""

import contextlib
import importlib.util
import os
import random
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import torch
from torch import nn

from odak import instruments, tools
from odak.learn.models import save_weights, train
from odak.learn.raytracing.system import load_system, save_system, write_zmx
from odak.learn.tools import save_torch_tensor
from odak.learn.tools.iterations import Run, minimise, write_checkpoint
from odak.tools import asset, paths

STAGES = ("before the first byte", "half-way", "before the move", "after the move")


def _layer(version):
    layer = nn.Linear(50, 20)
    with torch.no_grad():
        layer.weight.fill_(version)
        layer.bias.fill_(version)
    return layer


def _lens(version):
    lens = load_system("singlet")
    lens.name = f"lens {version}"
    return lens


def _captures(version):
    shape = (6, 24, 24)
    frames = np.random.default_rng(version).integers(4096, size=(6, 2, 24, 24))
    return instruments.Captures(np.ones(shape, int), frames, np.zeros(6), 532e-9, 8e-6, 4e-6, 12, 1e-3)


def _calibration(version):
    registration = instruments.Registration(np.diag([4e-6, 4e-6, 1.0]), 0.0, (24, 24))
    wavefront = np.random.default_rng(version).random((24, 24))
    there = (532e-9, 8e-6, 0.01, np.arange(256.0), np.ones((24, 24)), wavefront, registration)
    return instruments.Calibration(*there)


WRITERS = {
    "image.png": lambda path, version: tools.save_image(path, np.full((64, 64), 60.0 * version)),
    "deep.png": lambda path, version: tools.save_image(path, np.full((9, 9, 3), 60.0 * version), color_depth=16),
    "image.tiff": lambda path, version: tools.save_image(path, np.full((64, 64), 60.0 * version)),
    "image.jpg": lambda path, version: tools.save_image(path, np.full((64, 64), 60.0 * version)),
    "mesh.ply": lambda path, version: asset.write_PLY(np.full((99, 3, 3), version), path),
    "settings.json": lambda path, version: tools.save_dictionary({"v": [version] * 999}, path),
    "text.txt": lambda path, version: tools.write_to_text_file([version] * 999, path),
    "tensor.pt": lambda path, version: save_torch_tensor(path, torch.full((999,), version)),
    "weights.pt": lambda path, version: save_weights(_layer(version), path),
    "run.pt": lambda path, version: write_checkpoint(path, {"about": {}, "x": torch.full((99,), version)}),
    "lens.json": lambda path, version: save_system(_lens(version), path),
    "lens.zmx": lambda path, version: write_zmx(_lens(version), path),
}
WRITERS["table.npz"] = lambda path, version: instruments.save_calibration(path, _calibration(version))
if importlib.util.find_spec("h5py"):
    WRITERS["table.h5"] = WRITERS["table.npz"]
    WRITERS["captures.h5"] = lambda path, version: instruments.save_captures(path, _captures(version))


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def die_at(stage):
    """Terminate this process when the next file is written."""
    written, moved = paths._File.write, os.replace

    def write(self, data):
        if stage == "before the first byte":
            die()
        if stage == "half-way":
            written(self, bytes(memoryview(data).cast("B")[: max(1, memoryview(data).nbytes // 2)]))
            die()
        return written(self, data)

    def replace(*names):
        if stage == "before the move":
            die()
        moved(*names)
        die()

    paths._File.write = write
    if "move" in stage:
        os.replace = replace


def in_a_child(work):
    """Call a function in a fork of this process; return whether it was terminated."""
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            work()
        os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGKILL, signal.SIGALRM)


def kill_writers(folder):
    """Terminate every writer at every stage, with and without an existing file, each in a separate folder."""
    for name, write in WRITERS.items():
        for number, stage in enumerate(STAGES):
            for older in (False, True):
                place = folder / name / f"{number}{older:d}"
                place.mkdir(parents=True)
                path = str(place / name)
                if older:
                    write(path, 1)

                def killed(path=path, write=write, stage=stage):
                    die_at(stage)
                    write(path, 2)

                if not in_a_child(killed):
                    (place / "survived").touch()


def network():
    with torch.random.fork_rng():
        torch.manual_seed(4)
        return nn.Sequential(nn.Linear(3, 8), nn.BatchNorm1d(8), nn.ReLU(), nn.Dropout(0.2), nn.Linear(8, 1))


def trained(checkpoint=None, pause=0.0, epochs=12, **options):
    """Train a network whose loss draws random numbers; return its weights."""
    model = network()
    batches = [torch.randn(6, 3, generator=torch.Generator().manual_seed(i)) for i in range(3)]

    def loss(model, batch):
        time.sleep(pause)
        return (model(batch) - torch.rand(6, 1)).square().mean()

    train(model, loss, batches, epochs, seed=3, checkpoint=checkpoint, progress=False, **options)
    return list(model.state_dict().values())


def descended(checkpoint=None, pause=0.0, solver="adam", iterations=30, **options):
    """Descend a bowl whose centre shakes; return the place."""
    place, draw = torch.linspace(-1, 1, 999, dtype=torch.float64).requires_grad_(), torch.Generator().manual_seed(5)

    def gradient(iteration):
        time.sleep(pause)
        loss = (place - torch.rand(999, dtype=torch.float64, generator=draw)).square().mean()
        loss.backward()
        return loss.detach()

    options = Run(progress=False, checkpoint=checkpoint, checkpoint_every=1, iterations=iterations, **options)
    minimise({"x": place}, gradient, 0.1, options, solver=solver, generators=[draw])
    return [place.detach()]


def hologram(checkpoint=None, pause=0.0):
    """Optimize a small hologram of two colours on two planes; return its phases."""
    from odak.learn.wave import multi_color_hologram_optimizer, propagator

    size = (24, 32)
    chance = torch.Generator().manual_seed(1)
    display = propagator(
        list(size), [515e-9, 639e-9], 8e-6, number_of_frames=2, number_of_depth_layers=2, volume_depth=2e-3,
        image_location_offset=5e-3, propagation_type="Bandlimited Angular Spectrum", propagator_type="forward",
        aperture="open",
    )  # fmt: skip
    optimizer = multi_color_hologram_optimizer(
        [515e-9, 639e-9], list(size), torch.rand(2, 2, *size, generator=chance), display, number_of_frames=2,
        number_of_depth_layers=2, learning_rate=0.05, progress=False, seed=2, checkpoint=checkpoint, checkpoint_every=1,
        callback=lambda *_: time.sleep(pause),
    )  # fmt: skip
    return [torch.as_tensor(optimizer.optimize(12)[1])]


RUNS = {"adam": descended, "lbfgs": lambda *a, **k: descended(*a, solver="lbfgs", **k), "network": trained}
RUNS["hologram"] = hologram


def kill_again_and_again(run, path, chance):
    """Run children that are terminated at random, increasingly late times until one completes; return their number."""

    def timed():
        # The first two come before any machine is through the pauses of a run, which take some 0.1 s or more; the
        # system's own timer keeps to that on a busy one too.
        signal.setitimer(signal.ITIMER_REAL, chance.uniform(0.01, 0.03) * (1 + kills))
        run(path, pause=0.008)

    kills = 0
    while in_a_child(timed):
        kills += 1
        chance.random()
    return kills


def kill_runs(folder):
    """Kill runs with checkpoints, and say of each how often and whether it ended as an unbroken one."""
    from tqdm import tqdm

    # Its own lock is shared with children: one that is killed while it holds it would stop all that follow.
    tqdm.set_lock(threading.RLock())
    for name, run in RUNS.items():
        whole = run()
        path = str(folder / f"{name}.pt")
        kills = kill_again_and_again(run, path, random.Random(1))
        resumed = run(path)
        same = all(torch.equal(one, other) for one, other in zip(whole, resumed, strict=True))
        sys.stdout.write(f"{name} {kills} {same}\n")


if __name__ == "__main__":
    torch.set_num_threads(1)
    {"writers": kill_writers, "runs": kill_runs}[sys.argv[1]](Path(sys.argv[2]))
