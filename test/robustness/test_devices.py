"""Everything public of odak.learn on an emulated device: no tensor of the CPU gets in, and few numbers are read."""

import copy
import inspect
import tempfile
from fnmatch import fnmatchcase
from pathlib import Path

import emulated_device
import pytest
import torch
from api_sweep import contract, samples, walk
from emulated_device import DEVICE, Emulated, EmulatedDevice, on_device
from host_reads import is_permitted
from torch.utils._pytree import tree_leaves

import odak.learn.wave
import odak.tools
from odak.learn.wave import Descent, Display, Modulator, Run, optimise

CALLABLES = {path: call for path, call in walk.public_callables().items() if path.startswith("odak.learn.")}
# What the emulation itself cannot do.
NOT_EMULATED = (
    "*.load_weights",  # torch.load puts what it reads on real devices
    "*.load_gaussians",
    "*.torch_load",
    "*.train",  # gradients that are not defined become zeros on the device, which only a real one has
    "*.fit",
    "*.optimize",
    "*.field_curvature",
    "*.field_figure",
    "*.report_figures",
    "odak.learn.raytracing.system.lens_design.*",  # the transforms of torch.func around a copy to the device
    "odak.learn.raytracing.system.zoom_design.*",  # the same
    "odak.learn.raytracing.system.standard_design",  # the same
    "*.levenberg_marquardt",
    "*.relative_illumination",
    "*.image_figure",
    "odak.learn.wave.Scene.*",  # cameras are objects of their own, with a `to`
)
# Nor with the device as the default one.
NOT_BY_DEFAULT = (
    "*.accommodation_response",  # a spectrum that is a conjugated view
    "*.automatic_design",  # the classes of one_hot
    "*.eye_transfer_function",
    "*.retinal_image",
    "odak.learn.wave.display_model",  # places chosen by a list of truths
)
# What is not ready for a device yet: numbers of the CPU are mixed in, or read back in every iteration.
NOT_READY = ()
# How often one call may read numbers back at one place: checks of arguments, figures and files; nothing in a loop over
# pixels, rays or iterations.
MOST_READS = 50


@pytest.fixture(autouse=True)
def one_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def arguments(path, declared, folder):
    """Return the valid arguments of a call, on the device."""
    found = {name: on_device(value) for name, value in samples.arguments(path, declared, lambda: folder).items()}
    for name, value in found.items():
        if isinstance(value, torch.nn.Module):
            # A copy: the object of an example serves other tests, on the CPU.
            found[name] = copy.deepcopy(value).to(DEVICE)
    return found | ({"device": DEVICE} if "device" in found else {})


def bound(path, declared, folder):
    """Return the function of a call, for a method that of an object on the device."""
    owner_path = path.rpartition(".")[0]
    owner = CALLABLES.get(owner_path)
    if not inspect.isclass(owner):
        return declared
    made = contract.call(owner, arguments(owner_path, owner, folder))
    if isinstance(made, torch.nn.Module):
        made = made.to(DEVICE)
    return getattr(made, declared.__name__)


def is_emulated(path, left_out=()):
    patterns = (*NOT_EMULATED, *NOT_READY, *left_out)
    return samples.is_called(path) and not any(fnmatchcase(path, pattern) for pattern in patterns)


@pytest.mark.slow
@pytest.mark.parametrize("path", [path for path in CALLABLES if is_emulated(path)])
def test_on_a_device(path):
    declared = CALLABLES[path]
    folder = Path(tempfile.mkdtemp(dir="."))
    emulated_device.reads.clear()
    with EmulatedDevice():
        function = bound(path, declared, folder)
        given = arguments(path, declared, folder)
        result = contract.call(function, given)
    check_results_are_there(function, given, result)
    unexplained = [
        line
        for line in emulated_device.reads
        if line.startswith("learn/") and not is_permitted(line.removeprefix("learn/").split(": ")[0])
    ]
    assert not unexplained
    often = {line: count for line, count in emulated_device.reads.items() if count > MOST_READS}
    assert not often


@pytest.mark.slow
@pytest.mark.parametrize("path", [path for path in CALLABLES if is_emulated(path, NOT_BY_DEFAULT)])
def test_on_a_default_device(path):
    """A script may have called torch.set_default_device: constants that are of the CPU must say so."""
    folder = Path(tempfile.mkdtemp(dir="."))
    with EmulatedDevice():
        function, given = bound(path, CALLABLES[path], folder), arguments(path, CALLABLES[path], folder)
        with torch.device(DEVICE):
            result = contract.call(function, given)
    check_results_are_there(function, given, result)


def check_results_are_there(function, given, result):
    """Check that a call whose tensors are on the device returns tensors on it."""
    there = [leaf for leaf in tree_leaves(given) if isinstance(leaf, Emulated) and leaf.ndim]
    if (there or "device" in given) and not hasattr(function, "__self__"):
        results = [leaf for leaf in tree_leaves(result) if isinstance(leaf, torch.Tensor) and leaf.ndim]
        assert all(isinstance(leaf, Emulated) for leaf in results)


def test_the_emulation_finds_what_a_gpu_would():
    with EmulatedDevice():
        there = torch.rand(4, 4, device=DEVICE)
        with pytest.raises(emulated_device.DeviceMismatch, match="tensors of the CPU"):
            there + torch.rand(4, 4)
        assert isinstance(there.to(torch.complex64) * 2, Emulated) and isinstance(torch.ones(3).to(there), Emulated)
        assert not isinstance(there.cpu(), Emulated)
        emulated_device.reads.clear()
        emulated_device.copies.clear()
        float(there.sum())
        assert sum(emulated_device.reads.values()) == 1
        for copied in (
            lambda: torch.tensor([1.0, 2.0], device=DEVICE),
            lambda: torch.asarray(1.0, device=DEVICE),
            lambda: torch.ones(3).to(there),
            lambda: there.new_tensor([1.0]),
            lambda: there[torch.tensor([0, 1])],
            lambda: there[0].copy_(torch.ones(4)),
        ):
            emulated_device.copies.clear()
            assert isinstance(copied(), Emulated)
            assert sum(emulated_device.copies.values()) == 1
        # What the device fills by itself.
        emulated_device.copies.clear()
        torch.full((2,), 3.0, device=DEVICE), torch.arange(4, device=DEVICE), there.new_zeros(2), 2 * there
        assert not emulated_device.copies


@pytest.mark.parametrize("method", ["Angular Spectrum", "Fraunhofer", "Bandextended Angular Spectrum"])
@pytest.mark.filterwarnings("ignore::odak.SamplingWarning")
def test_a_propagation_on_a_device(method):
    field = torch.randn(16, 12, dtype=torch.complex64)
    geometry = (None, 1e-3, 8e-6, 532e-9, method, None, [True, False, True])
    expected = odak.learn.wave.propagate_beam(field, *geometry)
    emulated_device.reads.clear()
    emulated_device.copies.clear()
    with EmulatedDevice():
        there = on_device(field).requires_grad_()
        result = odak.learn.wave.propagate_beam(there, *geometry)
        result.abs().sum().backward()
    assert isinstance(result, Emulated) and isinstance(there.grad, Emulated)
    torch.testing.assert_close(result.held, expected)
    assert not emulated_device.reads and not emulated_device.copies


def test_gradient_descent_reads_a_number_at_the_end_only():
    with EmulatedDevice():
        target = torch.rand(16, 16, device=DEVICE)
        # The first call makes the transfer function, for which it reads the lengths.
        for _ in range(2):
            emulated_device.reads.clear()
            emulated_device.copies.clear()
            phase, _ = odak.learn.wave.stochastic_gradient_descent(
                target, 532e-9, 1e-3, 8e-6, n_iteration=10, progress=False
            )
    assert isinstance(phase, Emulated)
    assert max(emulated_device.reads.values()) <= 2 and max(emulated_device.copies.values()) <= 1


@pytest.mark.parametrize("solver", [Descent("adam"), Descent("lbfgs")])
def test_an_iteration_of_a_display_waits_for_a_gpu_once_at_most(solver):
    waited = {}
    with EmulatedDevice():
        display = Display(Modulator((16, 24), pitch=8e-6), wavelengths=532e-9, distances=2e-3).to(DEVICE)
        target = torch.rand(16, 24, device=DEVICE)
        # The first run makes what is kept.
        for count in (1, 2, 4):
            emulated_device.reads.clear()
            emulated_device.copies.clear()
            optimise(display, target, solver=solver, run=Run(iterations=count, progress=False))
            waited[count] = emulated_device.reads + emulated_device.copies
    more = waited[4] - waited[2]
    # L-BFGS reads what a trial of its line search found.
    assert sum(more.values()) == (0 if solver.method == "adam" else 2), more
