"""Valid ``.pt`` files to start from: tensors, weights and checkpoints; and those that call for programs."""

import functools
import io
import os
import pickle
import zipfile


@functools.cache
def net():
    """Return a small network, the same each time."""
    import torch

    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.BatchNorm1d(3), torch.nn.Linear(3, 1))


class Payload:
    """An object whose pickle is a call."""

    def __init__(self, call, *arguments):
        self.held = call, arguments

    def __reduce__(self):
        return self.held


def payloads():
    """Yield archives and pickles that would run something, or fill the memory."""
    import subprocess

    import torch

    for payload in (
        Payload(os.system, "touch pwned"),
        Payload(eval, "open('pwned','w')"),
        Payload(subprocess.call, ["touch", "pwned"]),
        Payload(bytearray, 10**9),
        Payload(torch.hub.load, "x/y", "z"),
        Payload(open, "pwned", "w"),
    ):
        yield ".pt", pickle.dumps({"weight": payload}, 2)
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w") as archive:
            archive.writestr("a/data.pkl", pickle.dumps({"weight": payload}, 2))
            archive.writestr("a/version", b"3\n")
        yield ".pt", stream.getvalue()


def saved(value, **options):
    """Return what torch.save writes."""
    import torch

    stream = io.BytesIO()
    torch.save(value, stream, **options)
    return stream.getvalue()


def tensor_seeds(folder):
    """Yield tensors and weights, and archives that call for programs."""
    import torch

    torch.manual_seed(0)
    yield ".pt", saved(torch.arange(6.0).reshape(2, 3))
    yield ".pt", saved({"a": torch.ones(3, dtype=torch.complex64), "b": [1, "x", None, (2.5, torch.tensor(3))]})
    yield ".pt", saved(net().state_dict())
    yield ".pt", saved(net().state_dict(), _use_new_zipfile_serialization=False)
    yield ".pt", saved(torch.arange(6, dtype=torch.uint8), _use_new_zipfile_serialization=False)
    yield (
        ".pt",
        saved(torch.sparse_coo_tensor(torch.tensor([[0, 2]]), torch.tensor([1.0, 2.0]), (3,), check_invariants=True)),
    )
    from odak.learn.wave.gaussians.sets import NAMES

    shapes = [(2, 4), *[(2, 3)] * 4, (2,), (2, 2)]
    yield ".pt", saved({name: torch.rand(shape) for name, shape in zip(NAMES, shapes, strict=True)})
    yield from payloads()


def descend(path, solver):
    """Take two steps down a bowl, with a checkpoint."""
    import torch

    from odak.learn.tools import iterations

    x = torch.ones(2, dtype=torch.float64, requires_grad=True)

    run = iterations.Run(2, progress=False, checkpoint=path, checkpoint_every=1)
    iterations.minimise({"x": x}, lambda _: (x - torch.rand(2)).square().sum(), 0.1, run, solver=solver)


def train(path):
    """Train a network for two epochs, with a checkpoint."""
    import torch

    from odak.learn.models import train

    torch.manual_seed(0)
    model = torch.nn.Linear(2, 1)
    batch = torch.ones(3, 2)
    schedule = functools.partial(torch.optim.lr_scheduler.StepLR, step_size=1)
    train(
        model,
        lambda m, b: m(b).square().mean(),
        [batch],
        2,
        checkpoint=path,
        progress=False,
        seed=1,
        scheduler=schedule,
    )


RUNS = {"adam": lambda path: descend(path, "adam"), "lbfgs": lambda path: descend(path, "lbfgs"), "train": train}


def checkpoint_seeds(folder):
    """Yield checkpoints of runs."""
    for name, run in RUNS.items():
        path = os.path.join(folder, f"seed-{name}.pt")
        run(path)
        yield ".pt", content(path)
        os.unlink(path)


def content(path):
    """Return the bytes of a file."""
    with open(path, "rb") as stream:
        return stream.read()
