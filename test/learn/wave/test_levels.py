"""Search over levels of panels: against all patterns, rounding and direct search; tables, colours and checkpoints."""

import itertools

import numpy as np
import pytest
import torch

from odak import AccuracyWarning
from odak.learn.wave import (
    AmplitudePanel,
    Descent,
    Display,
    LevelSearch,
    Modulator,
    Observer,
    Problem,
    Run,
    optimise,
    spatial_light_modulator,
)
from odak.learn.wave.holograms.solvers import levels

pytestmark = pytest.mark.usefixtures("small_judge")

REGISTERED = Observer.camera(registered=True)


def picture(*shape, seed=0):
    """Return smooth random intensities 0.1 … 1."""
    draw = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 1, *(max(2, n // 4) for n in shape), generator=draw)
    return 0.1 + 0.9 * torch.nn.functional.interpolate(coarse, shape, mode="bilinear")[0, 0]


def quick(iterations, **options):
    return Run(iterations, progress=False, **options)


def loss_of(display, target, phases, observer=REGISTERED):
    problem = Problem(
        display, target.expand(display.shape), torch.nn.functional.mse_loss, phases, Run(), True, observer
    )
    with torch.no_grad():
        return float(problem.loss_of(phases))


def test_runs_come_near_the_best_of_all_patterns():
    """Of 3 × 4 pixels of one bit there are 4 096 patterns, which are all looked at; few pixels average nothing out."""
    display, target = Display(Modulator((3, 4), 8e-6, bits=1), 532e-9, 1e-4), picture(3, 4)
    patterns = torch.tensor(list(itertools.product((0.0, torch.pi), repeat=12))).reshape(-1, 1, 3, 4)
    with torch.no_grad():
        images = display(patterns)[:, 0, 0]
    scale = (images * target).sum((1, 2), True) / images.square().sum((1, 2), True)
    least = float((scale * images - target).square().mean((1, 2)).min())
    found = [
        loss_of(display, target, optimise(display, target, run=quick(100, seed=s), observer=REGISTERED).phases)
        for s in range(1, 5)
    ]
    assert least * (1 - 1e-4) <= min(found) <= 1.3 * least


@pytest.mark.parametrize(("bits", "frames", "gain"), [(1, 1, 3.0), (1, 3, 5.0), (2, 2, 3.0)])
def test_levels_are_better_than_rounded_phases(bits, frames, gain):
    display = Display(Modulator((24, 24), 8e-6, bits=bits), 532e-9, 2e-3, frames=frames)
    target = picture(24, 24)
    searched = optimise(display, target, run=quick(150), observer=REGISTERED)
    with pytest.warns(AccuracyWarning, match=rf"rounding to the {2**bits} levels of the panel costs \d+\.\d dB"):
        rounded = optimise(display, target, solver="lbfgs", run=quick(60), observer=REGISTERED)
    assert float(searched.psnr) > float(rounded.psnr) + gain
    assert set(searched.levels().unique().tolist()) <= set(range(2**bits))


def test_as_good_as_a_direct_search():
    """Each pixel in turn takes the level of the least loss, until none changes; its loss is computed anew each time."""
    display, target = Display(Modulator((12, 12), 8e-6, bits=2), 532e-9, 1e-3), picture(12, 12)
    with pytest.warns(AccuracyWarning, match="rounding"):
        start = optimise(display, target, solver="lbfgs", run=quick(40), observer=REGISTERED).levels()[0]
    best, changed, draw = np.inf, True, np.random.default_rng(0)
    while changed:
        changed = False
        for place in draw.permutation(144):
            row, column = divmod(int(place), 12)
            tried = start.repeat(4, 1, 1)
            tried[:, row, column] = torch.arange(4)
            with torch.no_grad():
                images = display(tried[:, None] * (torch.pi / 2))[:, 0, 0]
            scale = (images * target).sum((1, 2), True) / images.square().sum((1, 2), True)
            losses = (scale * images - target).square().mean((1, 2))
            if float(losses.min()) < best * (1 - 1e-4):
                best, changed, start = float(losses.min()), True, tried[int(losses.argmin())]
    found = [optimise(display, target, run=quick(120, seed=s), observer=REGISTERED).phases for s in range(4)]
    assert min(loss_of(display, target, phases) for phases in found) < 1.4 * best


@pytest.mark.parametrize("iterations", [1, 2, 5])
def test_never_worse_than_the_rounded_phases_it_starts_from(iterations):
    display, target = Display(Modulator((16, 16), 8e-6, bits=3), 532e-9, 1e-3), picture(16, 16)
    start = torch.rand(display.frames, 16, 16, generator=torch.Generator().manual_seed(3)) * 2 * torch.pi
    problem = Problem(
        display, target.expand(display.shape), torch.nn.functional.mse_loss, start, quick(iterations), True, REGISTERED
    )
    first = -(-iterations // 3)
    from_descent = Descent().solve(
        Problem(display, problem.target, problem.loss, start, quick(first), True, REGISTERED)
    )
    rounded = loss_of(display, target, display.modulator.shown(from_descent))
    assert loss_of(display, target, LevelSearch().solve(problem)) <= rounded * (1 + 1e-6)


def test_tables_colours_planes_and_phase_scales():
    """An uneven table with an aberration, colours that share frames, two planes: the slope is that of differences."""
    draw = torch.Generator().manual_seed(1)
    table = torch.tensor([0.0, 0.9, 2.5, 4.6])
    response = spatial_light_modulator(bits=2, lut=table, aberration=torch.rand(12, 16, generator=draw))
    powers = torch.ones(2, 2)
    tabled = Display(Modulator((12, 16), 8e-6, 2, response=response), [639e-9, 515e-9], [1e-3, 2e-3], 2, powers)
    scaled = Display(
        Modulator((12, 16), 8e-6, 2, phase_scale=(0.8, 1.0)), [639e-9, 515e-9], [1e-3, 2e-3], 2, powers, iris=None
    )
    for display in (tabled, scaled):
        target = torch.stack([torch.stack([picture(12, 16, seed=2 * d + c) for c in range(2)]) for d in range(2)])
        searched = optimise(display, target, run=quick(30))
        start = optimise(display, target, run=quick(2))
        assert float(searched.psnr.mean()) > float(start.psnr.mean()) + 0.5
        problem = Problem(display, target, torch.nn.functional.mse_loss, searched.phases, quick(9))
        search = levels._Search(problem, searched.phases, 0.5, 6)
        change = search._slope * (0.02 / search._slope.abs().max())
        with torch.no_grad():
            ends = [float(problem.loss_of_lights((search._light + sign * change,))) for sign in (1, -1)]
        predicted = float(levels._product(search._slope, change).sum())
        assert (ends[0] - ends[1]) / 2 == pytest.approx(predicted, rel=0.03)
    assert set(np.round(tabled.modulator.shown(searched.phases).unique().numpy(), 4)) <= set(np.round(table.numpy(), 4))


def test_a_stopped_search_goes_on_to_the_same_levels(tmp_path):
    display, target = Display(Modulator((16, 16), 8e-6, bits=1), 532e-9, 1e-3, frames=2), picture(16, 16)
    whole = optimise(display, target, run=quick(60))
    path, seen = tmp_path / "search.pt", []

    def stop(iteration, loss):
        seen.append(iteration)
        return iteration == 40

    optimise(display, target, run=quick(60, checkpoint=path, callback=stop))
    assert seen == list(range(41))
    resumed = optimise(display, target, run=quick(60, checkpoint=path))
    assert torch.equal(resumed.phases, whole.phases)
    with pytest.raises(ValueError, match=r"of another run: its .*target"):
        optimise(display, picture(16, 16, seed=5), run=quick(60, checkpoint=path))


def test_panels_that_cannot_be_searched_are_named():
    target = picture(16, 16)
    for panel, told in (
        (Modulator((16, 16), 8e-6, bits=8), "bits=8"),
        (Modulator((16, 16), 8e-6, bits=None), "bits=None"),
        (Modulator((16, 16), 8e-6, bits=2, lit_through=AmplitudePanel()), "a panel lit through another"),
    ):
        with pytest.raises(ValueError, match=f"a search over levels needs one panel of 1 to 6 bits, got {told}"):
            optimise(Display(panel, 532e-9, 1e-3), target, solver="levels", run=quick(3))
    with pytest.raises(ValueError, match="temperature"):
        LevelSearch(temperature=0.0)
