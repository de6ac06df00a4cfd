"""Search over levels of panels: against all patterns, rounding and direct search; tables, colours and checkpoints."""

import itertools
import math
import warnings
from importlib.resources import files

import numpy as np
import pytest
import torch

from odak import AccuracyWarning
from odak.learn.tools import load_image
from odak.learn.wave import (
    AmplitudePanel,
    Descent,
    Display,
    LevelSearch,
    Modulator,
    Observer,
    Problem,
    Run,
    Source,
    light_of,
    optimise,
    spatial_light_modulator,
)
from odak.learn.wave.displays.parts import beside, with_frames
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


@pytest.fixture
def without_sweeps(monkeypatch):
    """Search as where sweeps are not affordable: of more than two frames, two at a time."""
    monkeypatch.setattr(levels, "affordable", lambda problem: False)


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
    hot = LevelSearch(temperature=4.0)
    for seed in range(12):
        run = quick(60, seed=seed)
        found = loss_of(display, target, optimise(display, target, None, hot, run=run, observer=REGISTERED).phases)
        assert found >= least * (1 - 1e-4)
        if found <= 1.3 * least:
            break
    assert found <= 1.3 * least


@pytest.mark.parametrize(("bits", "frames", "gain"), [(1, 1, 3.0), (1, 3, 5.0), (2, 2, 3.0)])
def test_levels_are_better_than_rounded_phases(bits, frames, gain):
    display = Display(Modulator((24, 24), 8e-6, bits=bits), 532e-9, 2e-3, frames=frames)
    target = picture(24, 24)
    searched = optimise(display, target, run=quick(50), observer=REGISTERED)
    with pytest.warns(AccuracyWarning, match=rf"rounding to the {2**bits} levels of the panel costs \d+\.\d dB"):
        rounded = optimise(display, target, solver="lbfgs", run=quick(40), observer=REGISTERED)
    assert float(searched.psnr) > float(rounded.psnr) + gain
    assert set(searched.levels().unique().tolist()) <= set(range(2**bits))


def test_as_good_as_a_direct_search():
    """Each pixel in turn takes the level of the least loss, until none changes; its loss is computed anew each time."""
    display, target = Display(Modulator((10, 10), 8e-6, bits=2), 532e-9, 1e-3), picture(10, 10)
    with pytest.warns(AccuracyWarning, match="rounding"):
        start = optimise(display, target, solver="lbfgs", run=quick(40), observer=REGISTERED).levels()[0]
    best, changed, draw = np.inf, True, np.random.default_rng(0)
    while changed:
        changed = False
        for place in draw.permutation(100):
            row, column = divmod(int(place), 10)
            tried = start.repeat(4, 1, 1)
            tried[:, row, column] = torch.arange(4)
            with torch.no_grad():
                images = display(tried[:, None] * (torch.pi / 2))[:, 0, 0]
            scale = (images * target).sum((1, 2), True) / images.square().sum((1, 2), True)
            losses = (scale * images - target).square().mean((1, 2))
            if float(losses.min()) < best * (1 - 1e-4):
                best, changed, start = float(losses.min()), True, tried[int(losses.argmin())]
    found = (optimise(display, target, run=quick(80, seed=s), observer=REGISTERED).phases for s in range(4))
    assert any(loss_of(display, target, phases) < 1.4 * best for phases in found)


@pytest.mark.parametrize("iterations", [1, 2, 5])
def test_never_worse_than_the_rounded_phases_it_starts_from(iterations):
    display, target = Display(Modulator((16, 16), 8e-6, bits=3), 532e-9, 1e-3), picture(16, 16)
    start = torch.rand(display.frames, 16, 16, generator=torch.Generator().manual_seed(3)) * 2 * torch.pi
    problem = Problem(
        display, target.expand(display.shape), torch.nn.functional.mse_loss, start, quick(iterations), True, REGISTERED
    )
    first = math.ceil(levels._DESCENT[3] * iterations)
    from_descent = Descent().solve(
        Problem(display, problem.target, problem.loss, start, quick(first), True, REGISTERED)
    )
    rounded = loss_of(display, target, display.modulator.shown(from_descent))
    phases, powers, amplitudes, gain = LevelSearch().solve(problem)
    found = loss_of(display, target, phases)
    assert found <= rounded * (1 + 1e-6) and powers is amplitudes is None
    assert float(gain) == pytest.approx(10 * np.log10(rounded / found), abs=1e-3)


@pytest.mark.parametrize("bits", [3, 4])
def test_not_worse_than_rounding_at_the_same_iterations(bits):
    """Where rounding costs little, most of the iterations find phases without levels; of fewer levels, see above."""
    display, target = Display(Modulator((24, 32), 8e-6, bits=bits), 532e-9, 3e-3), picture(24, 32)
    run = quick(60 if bits == 4 else 30)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)
        rounded = optimise(display, target, solver="lbfgs", run=run)
    searched = optimise(display, target, run=run)
    assert float(searched.psnr) > float(rounded.psnr)
    assert rounded.gain_over_rounding is None and float(searched.gain_over_rounding) > 0
    assert f"{float(searched.gain_over_rounding):.1f} dB above rounding" in repr(searched)


def test_gradients_before_and_after_a_step_tell_pixels_apart():
    """Of small changes: their mean, times the change of each pixel, adds up to the change of the loss."""
    display, target = Display(Modulator((16, 16), 8e-6, bits=1), 532e-9, 1e-3), picture(16, 16)
    draw = torch.Generator().manual_seed(4)
    phases = (torch.rand(1, 16, 16, generator=draw) < 0.5) * torch.pi
    problem = Problem(display, target.expand(display.shape), torch.nn.functional.mse_loss, phases, quick(3))
    search = levels._Search(problem, phases, 0.5, 3)
    changed = search.levels.clone()
    changed[0, 3, 4], changed[0, 12, 9] = 1 - changed[0, 3, 4], 1 - changed[0, 12, 9]
    loss, light, slope = search._evaluated(changed)
    parts = levels._product(search._slope + slope, light - search._light) / 2
    rise, alone = float(loss - search.loss), float(levels._product(search._slope, light - search._light).sum())
    assert abs(float(parts.sum()) - rise) < 0.35 * abs(alone - rise)
    assert float(parts.sum()) == pytest.approx(rise, rel=0.1)
    assert int((parts != 0).sum()) == 2


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
        searched = optimise(display, target, run=quick(12))
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
    begun = optimise(display, target, run=quick(60, callback=lambda iteration, loss: iteration == 3))
    assert len(begun.losses) == 4 and float(begun.gain_over_rounding) == 0
    # Among the sweeps at the end too.
    sweeping = quick(60, checkpoint=path, callback=lambda iteration, loss: iteration == 55)
    assert optimise(display, target, run=sweeping).losses[-1] <= min(whole.losses[20:50])
    resumed = optimise(display, target, run=quick(60, checkpoint=path))
    assert torch.equal(resumed.phases, whole.phases) and resumed.losses[-1] == whole.losses[-1]
    with pytest.raises(ValueError, match=r"of another run: its .*target"):
        optimise(display, picture(16, 16, seed=5), run=quick(60, checkpoint=path))


@pytest.mark.parametrize("iterations", [1, 6])
@pytest.mark.usefixtures("without_sweeps")
def test_frames_by_blocks_have_the_loss_of_all_together(monkeypatch, iterations):
    """Colours in sequence, of which each block shows all: the gain is that of the whole display over rounded phases."""
    seen, solve = [], levels._InBlocks._round

    def rounding(search, loop):
        seen.append([search.blocks, search.phases.clone()])
        return solve(search, loop)

    monkeypatch.setattr(levels._InBlocks, "_round", rounding)
    for frames, colours, blocks in ((5, [532e-9], 3), (6, [639e-9, 532e-9, 473e-9], 2)):
        display = Display(Modulator((12, 12), 8e-6, bits=1), colours, 1e-3, frames=frames)
        target, calls = torch.stack([picture(12, 12, seed=c) for c in range(len(colours))]), []
        run = quick(iterations, callback=lambda iteration, loss, calls=calls: calls.append(iteration))
        found = optimise(display, target, run=run, observer=REGISTERED)
        used, before = seen.pop()
        assert len(used) == blocks and sorted(itertools.chain(*used)) == list(range(frames))
        assert calls == list(range(iterations)) and len(found.losses) == iterations
        rounded, searched = (
            loss_of(display, target, phases) for phases in (display.modulator.shown(before), found.phases)
        )
        assert float(found.gain_over_rounding) == pytest.approx(10 * math.log10(rounded / searched), abs=2e-3)
        assert float(found.gain_over_rounding) >= 0


@pytest.mark.parametrize("kind", ["colours", "profile", "points in turn", "responses"])
def test_blocks_add_up_to_the_image_of_all_frames(kind):
    draw, panel, profile, powers, waves = torch.Generator().manual_seed(6), Modulator((12, 12), 8e-6, 2), None, None, 1
    if kind == "colours":
        powers, waves = torch.rand(5, 3, generator=draw), 3
    if kind == "profile":
        profile = torch.rand(12, 12, generator=draw)
    if kind == "points in turn":
        profile = Source([(0.0, 1e-3 * s) for s in range(5)], torch.eye(5))
    if kind == "responses":
        tables = [torch.rand(4, generator=draw).sort()[0] * 6 for _ in range(5)]
        panel = Modulator((12, 12), 8e-6, 2, response=[spatial_light_modulator(bits=2, lut=one) for one in tables])
    display = Display(panel, [639e-9, 532e-9, 473e-9][:waves], [1e-3, 2e-3], 5, powers, profile)
    problem = Problem(display, torch.ones(display.shape), torch.nn.functional.mse_loss, torch.rand(5, 12, 12), quick(2))
    search = levels._InBlocks(LevelSearch(), problem, [[0, 3], [1], [2, 4]])
    whole = display.recorded_by(problem.observer, problem.start)
    assert float((search.images - whole).abs().max()) < 1e-5 * float(whole.max())
    some, shares = with_frames(display, [2, 4])
    others = whole - search._part(some, shares, problem.start[[2, 4]])
    shown = beside(some, others, shares).recorded_by(problem.observer, problem.start[[2, 4]])
    assert float((shown - whole).abs().max()) < 1e-5 * float(whole.max())


@pytest.mark.usefixtures("without_sweeps")
def test_two_frames_at_a_time_are_better_than_all_at_once(monkeypatch):
    display, target = Display(Modulator((20, 20), 8e-6, bits=4), 532e-9, 2e-3, frames=4), picture(20, 20)
    few = optimise(display, target, run=quick(40))
    monkeypatch.setattr(levels, "_TOGETHER", 4)
    assert float(few.psnr) > float(optimise(display, target, run=quick(40)).psnr) + 1


@pytest.mark.usefixtures("without_sweeps")
def test_blocks_of_frames_go_on_from_a_checkpoint(tmp_path):
    """A block that was not complete is computed anew; each frame has a table of its own."""
    draw = torch.Generator().manual_seed(2)
    tables = [spatial_light_modulator(bits=2, lut=torch.rand(4, generator=draw).sort()[0] * 6) for _ in range(4)]
    display = Display(Modulator((16, 16), 8e-6, 2, response=tables), 532e-9, 1e-3, frames=4)
    target, path = picture(16, 16), tmp_path / "blocks.pt"
    whole = optimise(display, target, run=quick(12))
    for end in (3, 9):
        ended = quick(12, checkpoint=path, callback=lambda iteration, loss, end=end: iteration == end)
        assert float(optimise(display, target, run=ended).gain_over_rounding) >= 0
    assert torch.equal(optimise(display, target, run=quick(12, checkpoint=path)).phases, whole.phases)


@pytest.mark.usefixtures("without_sweeps")
def test_a_memory_budget_makes_blocks_small():
    display = Display(Modulator((16, 16), 8e-6, bits=1), 532e-9, 1e-3, frames=6)
    for budget, most in ((None, 2), (1, 1), (2 * levels._BYTES * 256, 2), (9 * levels._BYTES * 256, 2)):
        run = quick(3) if budget is None else quick(3, memory_budget=budget)
        problem = Problem(display, picture(16, 16)[None, None], torch.nn.functional.mse_loss, torch.zeros(1), run)
        assert max(map(len, levels._blocks(problem))) == most
    small, target = Display(Modulator((8, 8), 8e-6, bits=1), 532e-9, 1e-4, frames=3), picture(8, 8)
    kept, anew = (optimise(small, target, run=quick(3, memory_budget=budget)) for budget in (30_000, 6_000))
    assert torch.equal(kept.phases, anew.phases) and float(anew.gain_over_rounding) >= 0


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


def test_contrast_of_speckle_falls_as_the_root_of_the_frames():
    """Of random levels, shown within one exposure: 1/√F, as of sums of F independent speckles (Goodman 2007)."""
    for frames in (1, 4, 16):
        display = Display(Modulator((96, 96), 8e-6, bits=2), 532e-9, 2e-3, frames=frames)
        shown = torch.randint(4, (frames, 96, 96), generator=torch.Generator().manual_seed(frames))
        seen = display.recorded_by(Observer.points(), display.modulator.phases_of(shown))[..., 20:-20, 20:-20]
        assert float(seen.std() / seen.mean()) == pytest.approx(frames**-0.5, rel=0.1)


@pytest.mark.slow
def test_frames_that_are_found_together_are_beyond_the_limit_of_those_that_are_found_alone():
    """The limit is stated by Liu et al., doi:10.3390/app11167729; here it is that of an error A + B/frames."""
    photo = load_image(str(files("odak") / "assets" / "photo.png"), torch_style=True)
    target = light_of(photo, 532e-9).targets[:, :, 100:500]
    target = torch.nn.functional.adaptive_avg_pool2d(target, (48, 48))[0]

    def display(frames):
        return Display(Modulator((48, 48), 8e-6, bits=1), 532e-9, 2e-3, frames=frames)

    class Kept:
        def solve(self, problem):
            return problem.start

    one_by_one = [optimise(display(1), target, start="random", run=quick(100, seed=seed)).phases for seed in range(16)]
    alone, together, rounded = {}, {}, {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)
        for frames in (1, 4, 16):
            start = torch.cat(one_by_one[:frames])
            alone[frames] = float(optimise(display(frames), target, solver=Kept(), start=start, run=quick(1)).psnr)
            found = optimise(display(frames), target, start="random", run=quick(100, seed=1))
            together[frames] = float(found.psnr)
            thrown = optimise(display(frames), target, solver="gs", start="random", run=quick(1, seed=1))
            rounded[frames] = float(thrown.psnr)
    for quality in (alone, rounded):
        one, four = (10 ** (-quality[frames] / 10) for frames in (1, 4))
        limit = (4 * four - one) / 3
        assert abs(-10 * math.log10(limit + (one - limit) / 16) - quality[16]) < 0.6
    one, four = (10 ** (-alone[frames] / 10) for frames in (1, 4))
    assert together[16] > -10 * math.log10((4 * four - one) / 3) + 1.5
    assert together[4] > alone[4] + 1.5 and rounded[16] < rounded[1] + 2
