"""Holograms whose work several devices or processes share equal those of one device."""

import threading
from dataclasses import fields, replace

import pytest
import torch
from emulated_device import NAME, EmulatedDevice
from rank_tasks import check_shared_holograms, colour_display, pictures

from odak.learn.wave import Descent, Display, Modulator, Run, multiplane_loss, optimise
from odak.learn.wave.displays.parts import shared_among, streamed
from odak.learn.wave.displays.paths.free import FreePath

pytestmark = pytest.mark.usefixtures("small_judge")

BRIEF = Run(iterations=3, progress=False)


def same(one, other, rounding=0.0):
    """Check that two holograms are equal; phases of a panel without levels may be a turn apart."""
    turn = (one.phases - other.phases + torch.pi).remainder(2 * torch.pi) - torch.pi
    assert turn.abs().max() <= rounding
    torch.testing.assert_close(torch.tensor(one.losses), torch.tensor(other.losses), rtol=rounding, atol=0)
    for field in fields(one):
        left, right = getattr(one, field.name), getattr(other, field.name)
        if isinstance(left, torch.Tensor) and field.name != "phases":
            torch.testing.assert_close(left, right, rtol=rounding, atol=rounding)
    torch.testing.assert_close(one.display.powers, other.display.powers, rtol=rounding, atol=rounding)


@pytest.mark.parametrize("count", [3, pytest.param(9, marks=pytest.mark.slow)])
def test_planes_colours_and_frames_of_one_picture_are_shared(count):
    target, display = pictures(1)[0], colour_display()
    whole = optimise(display, target, run=BRIEF, solver=Descent(powers=True))
    shared = optimise(display, target, run=BRIEF, solver=Descent(powers=True), devices=["cpu"] * count)
    assert len(whole.losses) == 3
    same(whole, shared, 1e-9)


def test_each_device_computes_a_nearly_equal_part(monkeypatch):
    """Of 2 planes, 2 colours and 2 frames: 8 units; each plane's transfer functions are made once per device."""
    made, shown = [], []
    kernel, image = FreePath._of_plane, Display._images_of

    def makes(path, device, colour, plane, dtype):
        made.append((colour, plane))
        return kernel(path, device, colour, plane, dtype)

    def shows(own, part, *given):
        shown.append((id(own), part))
        return image(own, part, *given)

    monkeypatch.setattr(FreePath, "_of_plane", makes)
    monkeypatch.setattr(Display, "_images_of", shows)
    display = shared_among(colour_display(), [torch.device("cpu")] * 3)
    display(torch.zeros(2, 12, 16))
    units = {}
    for own, part in shown:
        units.setdefault(own, []).extend((part.colour, d, f) for d in part.planes for f in part.frames)
    assert sorted(map(len, units.values())) == [2, 3, 3]
    assert len({unit for share in units.values() for unit in share}) == 8
    assert sorted(made) == sorted(
        {(own, *unit[:2]): unit[:2] for own, share in units.items() for unit in share}.values()
    )


def test_the_second_device_gets_no_tensor_of_the_first():
    phases, display, found = torch.rand(2, 12, 16, dtype=torch.float64, requires_grad=True), colour_display(), []
    with EmulatedDevice():
        for shown in (display, shared_among(display, [torch.device("cpu"), torch.device(NAME)])):
            images = shown(phases)
            assert images.device.type == "cpu"
            found.append((images, *torch.autograd.grad(images.square().sum(), phases)))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("devices", [None, ["cpu", "cpu"]])
def test_pictures_of_a_list_are_computed_as_alone(devices):
    targets, display, threads = pictures(2), colour_display(), set()

    def watch(iteration, loss):
        threads.add(threading.get_ident())

    solver = Descent(powers=devices is not None)
    alone = [optimise(display, target, solver=solver, run=BRIEF) for target in targets]
    found = optimise(display, targets, solver=solver, run=replace(BRIEF, callback=watch), devices=devices)
    assert len(found) == 2 and len(threads) == len(devices or [None])
    for one, other in zip(alone, found, strict=True):
        same(one, other)
    assert all((hologram.display is display) == (devices is None) for hologram in found)


def test_a_list_of_pictures_with_depth():
    display = Display(Modulator((12, 16), 8e-6, bits=None), 532e-9, [2e-3, 4e-3])
    picture, depth = torch.rand(12, 16), (torch.arange(16) > 8).float().expand(12, -1)
    targets = [(picture, depth), multiplane_loss(picture, depth, blur_ratio=2.0, number_of_planes=2)]
    found = optimise(display, targets, run=BRIEF, devices=["cpu", "cpu"])
    for target, hologram in zip(targets, found, strict=True):
        same(optimise(display, target, run=BRIEF), hologram)
        assert hologram.psnr_in_focus is not None


def test_a_picture_that_fails_ends_the_list():
    targets = [torch.rand(12, 16), torch.full((12, 16), 200.0), torch.rand(12, 16)]
    with pytest.raises(ValueError, match="divide by 255"):
        optimise(Display(Modulator((12, 16), 8e-6), 532e-9, 2e-3), targets, run=BRIEF, devices=["cpu", "cpu"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"devices": "cuda"}, "devices must be a sequence of devices or 'distributed', got 'cuda'"),
        ({"devices": 3}, "devices must be a sequence of devices, got int"),
        ({"devices": []}, "devices must name at least one device"),
        ({"devices": ["cuda:99"]}, "devices must be on this machine, where torch finds .* got 'cuda:99'"),
        ({"devices": ["cpu", "gpu"]}, "devices must be a torch.device or its name"),
        ({"devices": "distributed"}, "init_process_group first"),
        ({"devices": ["cpu"], "solver": "gerchberg-saxton"}, "devices must be None for one picture by Alternating"),
        ({"target": []}, "target must hold at least one picture"),
        (
            {"target": [torch.rand(12, 16)], "run": replace(BRIEF, checkpoint="a.pt")},
            "run must be without a checkpoint",
        ),
    ],
)
def test_what_cannot_be_shared_is_named(arguments, message):
    display = Display(Modulator((12, 16), 8e-6), 532e-9, 2e-3)
    with pytest.raises((ValueError, TypeError), match=message):
        optimise(display, **{"target": torch.rand(12, 16), "run": BRIEF, **arguments})


@pytest.mark.slow
def test_holograms_of_processes_are_those_of_one(tmp_path):
    torch.multiprocessing.spawn(check_shared_holograms, (2, tmp_path / "meet"), nprocs=2)


@pytest.mark.cuda
def test_on_cuda_devices():
    targets, display = pictures(3), colour_display().cuda()
    devices = [0, 0, *range(torch.cuda.device_count())]
    alone = [optimise(display, target, run=BRIEF) for target in targets]
    for one, other in zip(alone, optimise(display, targets, run=BRIEF, devices=devices), strict=True):
        assert other.phases.is_cuda
        same(one, other, 1e-9)
    same(alone[0], optimise(display, targets[0], run=BRIEF, devices=devices), 1e-9)


@pytest.mark.parametrize(("budget", "at_once"), [(1, 1), (200_000, 2), (10**9, 4)])
def test_a_memory_budget_changes_no_hologram(budget, at_once):
    """Of 2 planes, 2 colours and 2 frames: parts of one field each, of two, or of all fields of a colour."""
    target, display = pictures(1)[0], colour_display()
    parts = streamed(display, budget).shares.parts
    counts = [len(part.planes) * len(part.frames) for part in parts]
    assert max(counts) == at_once and sum(counts) == 8
    whole = optimise(display, target, run=BRIEF, solver=Descent(powers=True))
    found = optimise(display, target, run=replace(BRIEF, memory_budget=budget), solver=Descent(powers=True))
    same(whole, found, 1e-9)


def test_a_memory_budget_keeps_neither_fields_nor_kernels_beyond_it():
    phases = torch.rand(2, 12, 16, dtype=torch.float64, requires_grad=True)
    sizes = []

    def keep(value):
        sizes[-1] += value.numel() * value.element_size()
        return value

    for display, kept in ((streamed(colour_display(), 1), 1), (streamed(colour_display(), 10**9), 2), (None, 0)):
        sizes.append(0)
        with torch.autograd.graph.saved_tensors_hooks(keep, lambda value: value):
            image = (display or colour_display())(phases)
        image.sum().backward()
        assert display is None or len(display.shares.display._kept.tensors) == kept
    assert max(sizes[:2]) < sizes[2] / 2
    with pytest.raises(ValueError, match="devices must be None for one picture with a memory_budget"):
        optimise(colour_display(), pictures(1)[0], run=replace(BRIEF, memory_budget=1), devices=["cpu"])
    with pytest.raises(ValueError, match="memory_budget"):
        Run(memory_budget=0)
