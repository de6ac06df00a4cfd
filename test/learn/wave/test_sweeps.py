"""Sweeps over the levels of pixels: what they add up against what displays show, minima, where they are affordable."""

import copy
import itertools
from dataclasses import replace

import pytest
import torch
from emulated_device import NAME, EmulatedDevice

from odak.instruments import Lens
from odak.learn.wave import (
    Display,
    Free,
    Modulator,
    Observer,
    Problem,
    Run,
    Source,
    optimise,
    spatial_light_modulator,
)
from odak.learn.wave.holograms.solvers import levels, sweeps
from odak.learn.wave.holograms.solvers.sweeps import Sweeps, affordable

pytestmark = pytest.mark.usefixtures("small_judge")

REGISTERED, ANYWHERE = Observer.camera(registered=True), Observer.camera()
SIZES = (6, 8)
TABLE = torch.tensor([0.0, 0.9, 2.5, 4.6])


def drawn(*shape, seed=0):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def several(free=True, observer=ANYWHERE):
    """Return a problem of two planes and colours that scale phases, and frames that some sources light unevenly."""
    powers = drawn(3, 2, seed=1) + 0.2
    powers[1, 0] = 0
    panel = Modulator(SIZES, 8e-6, 2, phase_scale=(0.8, 1.0))
    display = Display(panel, [639e-9, 515e-9], [2e-4, 3e-4], 3, powers, 0.2 + drawn(*SIZES, seed=2))
    target = 0.1 * drawn(*display.shape, seed=3)
    start = torch.zeros(3, *SIZES)
    return Problem(display, target, torch.nn.functional.mse_loss, start, Run(), free, observer)


def tabled(frames=2, sizes=SIZES):
    """Return a display of two bits whose levels have uneven phases, which another table gives for each frame."""
    responses = [spatial_light_modulator(bits=2, lut=TABLE + 0.3 * frame) for frame in range(frames)]
    return Display(Modulator(sizes, 8e-6, 2, response=responses), 532e-9, 2e-4, frames=frames)


@torch.no_grad()
def loss_of(problem, shown):
    return float(problem.loss_of(problem.display.modulator.phases_of(shown)))


@torch.no_grad()
def swept(problem, shown, times=1, seed=0):
    search = Sweeps(problem)
    for _ in range(times):
        order = torch.randperm(shown.numel(), generator=torch.Generator().manual_seed(seed))
        shown = search.sweep(shown, order)
    return search, shown


@torch.no_grad()
def least_by_one_change(display, target, shown):
    """Return the loss of levels, and the least of all that differ in one pixel of one frame, on one plane."""
    tried = shown.repeat(1 + 4 * shown.numel(), 1, 1, 1)
    places = itertools.product(itertools.product(*map(range, shown.shape)), range(4))
    for one, (place, level) in zip(tried[1:], places, strict=True):
        one[place] = level
    images = display.recorded_by(REGISTERED, display.modulator.phases_of(tried))[0, :, 0, 0].double()
    scale = (images * target).sum((1, 2), True) / images.square().sum((1, 2), True)
    losses = (scale * images - target).square().mean((1, 2))
    return float(losses[0]), float(losses[1:].min())


@pytest.mark.parametrize("free", [True, False])
@pytest.mark.parametrize("observer", [REGISTERED, ANYWHERE, Observer.camera(12e-6, 0.8)])
def test_what_changes_add_up_to_is_the_loss(observer, free, monkeypatch):
    """After each of all pixels was visited: fields, what is recorded of them, and its error, as if computed anew."""
    monkeypatch.setattr(sweeps, "_BEYOND", 0.0)
    problem = several(free, observer)
    before = torch.randint(4, (3, *SIZES), generator=torch.Generator().manual_seed(4))
    search, after = swept(problem, before)
    squares = (search.errors**2).sum((0, 2, 3)) - (search.products**2 / search.squares if free else 0)
    assert squares.sum() / problem.wanted.numel() == pytest.approx(loss_of(problem, after), rel=1e-4)
    assert loss_of(problem, after) < 0.9 * loss_of(problem, before)
    assert float((before != after).float().mean()) > 0.2


def test_each_pixel_of_each_frame_ends_at_its_best_level(monkeypatch):
    """Of all levels that differ in one pixel, none has a lower loss; after a single sweep some do."""
    monkeypatch.setattr(sweeps, "_BEYOND", 0.0)
    display, target = tabled(2, (4, 6)), drawn(4, 6, seed=5)
    problem = Problem(display, target[None, None], torch.nn.functional.mse_loss, torch.zeros(2, 4, 6), Run(), True)
    problem = replace(problem, observer=REGISTERED)
    before, ratios = torch.zeros(2, 4, 6, dtype=torch.long), []
    for times in (1, 12):
        found, least = least_by_one_change(display, target, swept(problem, before, times)[1])
        ratios.append(least / found)
    assert ratios[0] < 1 - 1e-3 and ratios[1] > 1 - 1e-5


@pytest.mark.slow
def test_a_search_ends_when_each_pixel_has_its_best_level(monkeypatch):
    """Which it finds by visits of the most promising pixels, and last of all; without sweeps it does not."""
    for module, name, value in ((sweeps, "_BEYOND", 0.0), (levels, "_SWEPT", 0.5)):
        monkeypatch.setattr(module, name, value)
    display, target, ratios = tabled(), drawn(*SIZES, seed=5), []
    for possible in (True, False):
        monkeypatch.setattr(levels, "affordable", lambda problem, possible=possible: possible)
        hologram = optimise(display, target, run=Run(150, progress=False), observer=REGISTERED)
        found, least = least_by_one_change(display, target, hologram.levels().long())
        ratios.append(least / found)
    assert ratios[0] > 1 - 1e-5 and ratios[1] < 1 - 1e-3


def test_light_that_is_left_out_costs_little():
    """Windows leave out a hundredth of a pixel's light: sweeps lower the loss all the same, by what they expect."""
    display, target = Display(Modulator((16, 16), 8e-6, 2), 532e-9, 5e-4), drawn(1, 1, 16, 16, seed=6)
    problem = Problem(display, target, torch.nn.functional.mse_loss, torch.zeros(1, 16, 16), Run(), True, ANYWHERE)
    before = torch.randint(4, (1, 16, 16), generator=torch.Generator().manual_seed(7))
    search, after = swept(problem, before)
    assert max(max(kernel.shape) for kernel in search.kernels.values()) < 2 * (16 + 8)
    squares = (search.errors**2).sum((0, 2, 3)) - search.products**2 / search.squares
    assert squares.sum() / problem.wanted.numel() == pytest.approx(loss_of(problem, after), rel=0.1)
    assert loss_of(problem, after) < 0.5 * loss_of(problem, before)


def test_levels_of_other_devices_are_swept_alike():
    display, start = tabled(1, (4, 6)), torch.zeros(1, 4, 6)
    problem = Problem(display, drawn(1, 1, 4, 6), torch.nn.functional.mse_loss, start, Run())
    before = torch.zeros(1, 4, 6, dtype=torch.long)
    _, here = swept(problem, before)
    with EmulatedDevice(), torch.no_grad():
        given = {"target": problem.target.to(NAME), "start": start.to(NAME)}
        moved = replace(problem, display=copy.deepcopy(display).to(NAME), **given)
        assert affordable(moved)
        there = Sweeps(moved).sweep(before.to(NAME), torch.randperm(24, generator=torch.Generator().manual_seed(0)))
        assert there.device.type == NAME
        there = there.to("cpu")
    assert loss_of(problem, there) == pytest.approx(loss_of(problem, here), rel=1e-3)
    assert loss_of(problem, here) < 0.9 * loss_of(problem, before)


def test_sweeps_are_affordable_for_small_diffraction_patterns_of_separate_pixels():
    def problem(
        panel=None, waves=532e-9, space=1e-3, observer=ANYWHERE, loss=torch.nn.functional.mse_loss, source=None
    ):
        display = Display(panel or Modulator((12, 16), 8e-6, 2), waves, space, profile=source)
        return Problem(display, torch.ones(display.shape), loss, torch.zeros(1, 12, 16), Run(), True, observer)

    crossing = spatial_light_modulator(bits=2, crosstalk=0.5)
    assert affordable(problem()) and affordable(
        problem(Modulator((12, 16), 8e-6, 2, response=tabled(1).modulator.response))
    )
    for other in (
        problem(Modulator((12, 16), 8e-6, 2, response=crossing)),
        problem(space=Lens(0.1)),
        problem(space=Free(1e-3, jitter=1e-5)),
        problem(observer=Observer.eye()),
        problem(loss=torch.nn.functional.l1_loss),
        problem(source=Source([(0.0, 0.0), (0.0, 1e-3)])),
    ):
        assert not affordable(other)
    near, far = (Display(Modulator((256, 256), 8e-6, 2), 532e-9, z) for z in (2e-3, 20e-3))
    starts = torch.zeros(1, 256, 256)
    assert [
        affordable(Problem(one, torch.ones(one.shape), torch.nn.functional.mse_loss, starts, Run()))
        for one in (near, far)
    ] == [True, False]
