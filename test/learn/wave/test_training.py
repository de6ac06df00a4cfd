"""The loop that optimizers share: checkpoints, interruption, the best so far, schedules."""

import contextlib
import functools
import itertools
import math

import pytest
import torch

from odak import ArgumentWarning
from odak.learn import wave
from odak.learn.wave import training
from odak.learn.wave.training import LBFGS, Adam


def run(start, iterations=20, solver="adam", noise=0.0, loss_of=None, rate=0.1, seed=None, **options):
    """Return the parameter after descending a bowl whose centre shakes, and whether the run came to its end."""
    parameter = start.clone().requires_grad_()
    draw = training.generator_from(seed)

    def gradient(iteration):
        centre = torch.ones_like(start) + noise * torch.randn(start.shape, dtype=start.dtype, generator=draw)
        loss = (parameter - centre).square().sum() if loss_of is None else loss_of(iteration, parameter)
        loss.backward()
        return loss.detach()

    options = training.Run(**({"progress": False, "iterations": iterations} | options))
    ended = training.minimise(
        {"x": parameter},
        gradient,
        rate,
        options,
        solver=solver,
        about=lambda: {"rate": rate},
        generators=[draw],
    )
    return parameter.detach(), ended


@pytest.fixture
def start():
    return torch.randn(4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))


def interrupt_at(iteration):
    def callback(done, loss):
        if done == iteration:
            raise KeyboardInterrupt

    return callback


@pytest.mark.parametrize("solver", ["adam", "lbfgs"])
@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("every", [1, 7])
def test_a_resumed_run_ends_bit_for_bit_as_an_uninterrupted_one(start, solver, noise, every, tmp_path):
    path = tmp_path / "run.pt"
    whole, ended = run(start, solver=solver, noise=noise, seed=5)
    assert ended
    _, ended = run(
        start, solver=solver, noise=noise, seed=5, checkpoint=path, checkpoint_every=every, callback=interrupt_at(9)
    )
    assert not ended
    # What the caller draws in between does not matter.
    torch.rand(3)
    resumed, ended = run(start, solver=solver, noise=noise, seed=5, checkpoint=path, checkpoint_every=every)
    assert ended
    assert torch.equal(resumed, whole)


def test_a_run_killed_between_checkpoints_resumes_from_the_last(start, tmp_path):
    path = tmp_path / "run.pt"

    def die(done, loss):
        if done == 9:
            raise SystemExit

    whole, _ = run(start, noise=0.1, seed=2)
    with pytest.raises(SystemExit):
        run(start, noise=0.1, seed=2, checkpoint=path, checkpoint_every=4, callback=die)
    assert torch.load(path, weights_only=True)["done"] == 8
    resumed, _ = run(start, noise=0.1, seed=2, checkpoint=path)
    assert torch.equal(resumed, whole)


def test_a_finished_run_is_not_run_again(start, tmp_path):
    path = tmp_path / "run.pt"
    done, _ = run(start, checkpoint=path)
    calls = []
    again, ended = run(start, checkpoint=path, callback=lambda *seen: calls.append(seen))
    assert torch.equal(done, again)
    assert ended
    assert calls == []


def test_interruption_gives_the_best_so_far(start, caplog):
    # A loss that rises from the sixth step on: the best parameters are those that gave the sixth loss.
    seen = []

    def loss_of(iteration, parameter):
        seen.append(parameter.detach().clone())
        return parameter.sum() * (1 if iteration < 6 else 0) + (100.0 * iteration if iteration > 5 else 0)

    with caplog.at_level("WARNING", "odak"):
        best, ended = run(start, loss_of=loss_of, callback=interrupt_at(9))
    assert not ended
    assert torch.equal(best, seen[5])
    assert "interrupted after 10 of 20" in caplog.text


def test_interruption_within_an_iteration_leaves_whole_parameters(start, tmp_path):
    path = tmp_path / "run.pt"

    def loss_of(iteration, parameter):
        if iteration == 4:
            raise KeyboardInterrupt
        return (parameter - 1).square().sum()

    run(start, loss_of=loss_of, checkpoint=path, seed=0)
    assert torch.load(path, weights_only=True)["done"] == 4
    assert torch.equal(run(start, checkpoint=path, seed=0)[0], run(start, seed=0)[0])


def test_a_checkpoint_of_another_run_is_refused(start, tmp_path):
    path = tmp_path / "run.pt"
    run(start, checkpoint=path)
    with pytest.raises(ValueError, match="is of another run: its iterations, rate differ"):
        run(start, iterations=30, rate=0.2, checkpoint=path)
    with pytest.raises(ValueError, match=r"holds .*\(4, 3\).* but this run has .*\(5,\)"):
        run(torch.zeros(5, dtype=torch.float64), checkpoint=path)
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(ValueError, match="cannot be read"):
        run(start, checkpoint=path)
    torch.save({"phase": torch.ones(3)}, path)
    with pytest.raises(ValueError, match="not one of an optimization"):
        run(start, checkpoint=path)


def test_a_checkpoint_runs_no_code(start, tmp_path):
    path, proof = tmp_path / "run.pt", tmp_path / "proof"

    class Trap:
        def __reduce__(self):
            return (open, (str(proof), "w"))

    torch.save(Trap(), path)
    with pytest.raises(ValueError, match="cannot be read"):
        run(start, checkpoint=path)
    assert not proof.exists()


def test_a_loss_that_is_not_finite_is_an_error(start):
    with pytest.raises(FloatingPointError, match="lower the learning rate"):
        run(start, loss_of=lambda iteration, parameter: (parameter * torch.nan).sum())


def test_the_callers_randomness_is_left_alone(start):
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    run(start, noise=0.5, seed=1)
    assert torch.equal(torch.rand(4), expected)
    assert torch.equal(run(start, noise=0.5, seed=1)[0], run(start, noise=0.5, seed=1)[0])
    assert not torch.equal(run(start, noise=0.5)[0], run(start, noise=0.5)[0])


def test_a_callback_stops(start):
    losses = []

    def callback(iteration, loss):
        losses.append(loss)
        return iteration == 4

    _, ended = run(start, callback=callback)
    assert ended
    assert len(losses) == 5
    assert losses == sorted(losses, reverse=True)


def test_progress_is_shown_and_can_be_off(start, capsys):
    run(start, progress=True)
    assert "hologram:   0%|          | 0/20" in capsys.readouterr().err
    run(start)
    assert capsys.readouterr().err == ""


def test_schedules():
    rates = [training.cosine(0.4, 0.1, 8)(i) for i in range(9)]
    assert rates[0] == pytest.approx(0.4)
    assert rates[4] == pytest.approx(0.25)
    assert rates[8] == pytest.approx(0.1)
    assert rates[2] == pytest.approx(0.1 + 0.15 * (1 + math.cos(math.pi / 4)))
    assert [training.linear(0.4, 0.1, 3)(i) for i in range(4)] == pytest.approx([0.4, 0.3, 0.2, 0.1])


def test_solvers_on_several_parameters():
    target = torch.tensor([1.0, -2.0], dtype=torch.float64)
    for kind, steps, rate in ((Adam, 400, 0.05), (LBFGS, 20, 1.0)):
        one, two = (torch.zeros(2, dtype=torch.float64, requires_grad=True) for _ in range(2))
        solver = kind([one, two])

        def gradient(one=one, two=two):
            one.grad = two.grad = None
            with torch.enable_grad():
                loss = (one - target).square().sum() + (two + target * one).square().sum()
            loss.backward()
            return loss.detach()

        for _ in range(steps):
            loss = solver.step(gradient, rate)
        assert loss < 1e-6
        torch.testing.assert_close(one, target, atol=1e-3, rtol=0)
        torch.testing.assert_close(two, -target * target, atol=1e-2, rtol=0)


def test_line_search_shortens_steps_that_overshoot():
    # Rosenbrock's valley, along which the first trial of many steps climbs the other side.
    place = torch.tensor([-1.2, 1.0], dtype=torch.float64, requires_grad=True)
    solver = LBFGS([place])

    def gradient():
        place.grad = None
        with torch.enable_grad():
            loss = (1 - place[0]) ** 2 + 100 * (place[1] - place[0] ** 2) ** 2
        loss.backward()
        return loss.detach()

    losses = [float(solver.step(gradient, 1.0)) for _ in range(60)]
    assert all(after < before for before, after in itertools.pairwise(losses) if before > 1e-20)
    torch.testing.assert_close(place.detach(), torch.ones(2, dtype=torch.float64), atol=1e-6, rtol=0)


def test_a_checkpoint_of_another_problem_is_refused(tmp_path):
    path, target = tmp_path / "run.pt", torch.rand(12, 16, generator=torch.Generator().manual_seed(0))

    def run(target, wavelength=515e-9, distance=1e-3, pitch=8e-6, **others):
        return wave.stochastic_gradient_descent(
            target, wavelength, distance, pitch, n_iteration=2, seed=3, checkpoint=path, progress=False, **others
        )

    first = run(target)[0]
    torch.testing.assert_close(run(target)[0], first, rtol=0, atol=0)
    for other, told in (
        ({"target": 1 - target}, "its target differ"),
        ({"target": target, "wavelength": 633e-9}, "its wavelength differ"),
        ({"target": target, "distance": 2e-3, "pitch": 4e-6}, "its distance, pixel_pitch differ"),
        ({"target": target, "scale": True}, "its scale differ"),
        ({"target": target, "propagation_type": "AS"}, "its propagation_type differ"),
    ):
        with pytest.raises(ValueError, match=told):
            run(**other)


def test_checkpoints_of_displays_know_their_planes(tmp_path):
    targets = torch.rand(2, 12, 16, generator=torch.Generator().manual_seed(0))

    def run(targets, wavelength=515e-9, stop=None):
        def interrupt(step, loss):
            assert loss.isfinite()
            if step == stop:
                raise KeyboardInterrupt

        return wave.multiplane_hologram_optimizer(
            wavelength, 0.0, 1e-3, 8e-6, [12, 16], targets, number_of_planes=2, number_of_iterations=4,
            checkpoint=tmp_path / "run.pt", progress=False, seed=5, callback=interrupt,
        ).optimize()[0]  # fmt: skip

    run(targets, stop=6)
    resumed = run(targets)
    for other in ((1 - targets,), (targets, 633e-9)):
        with pytest.raises(ValueError, match=r"is of another run: its (targets|display)"):
            run(*other)
    (tmp_path / "run.pt").unlink()
    torch.testing.assert_close(resumed, run(targets), rtol=0, atol=0)


def test_a_callback_stops_at_the_first_plane():
    made = wave.multiplane_hologram_optimizer(
        515e-9, 0.0, 1e-3, 8e-6, [12, 16], torch.rand(3, 12, 16), number_of_planes=3, number_of_iterations=4,
        progress=False, callback=lambda step, loss: True,
    )  # fmt: skip
    assert made.optimize()[0].isfinite().all()


class TestBrightness:
    """Targets brighter than the light there is issue a warning; those that are just reachable do not."""

    @staticmethod
    def expected(warns, message):
        return pytest.warns(ArgumentWarning, match=message) if warns else contextlib.nullcontext()

    @pytest.mark.parametrize("brightness", [1.0, 1.1, 200.0])
    def test_of_gradient_descent(self, brightness):
        def descend(**options):
            target = torch.full((16, 16), brightness)
            wave.stochastic_gradient_descent(target, 532e-9, 1e-3, 8e-6, n_iteration=1, progress=False, **options)

        message = "target must have a mean intensity of at most 1, .* got .* or scale=True"
        with self.expected(brightness > 1, message):
            descend()
        with self.expected(brightness == 200, "target reaches 200 where 1 is white"):
            descend(scale=True)

    @pytest.mark.parametrize("method", ["conventional", "multi-color"])
    @pytest.mark.parametrize("excess", [0.99, 1.01])
    def test_of_colours(self, method, excess):
        colours, size = [600e-9, 500e-9], [16, 16]
        display = wave.propagator(size, colours, 8e-6, number_of_frames=2, number_of_depth_layers=1, method=method)
        # Each colour is shown in one frame, or in both.
        reachable = 1 if method == "conventional" else 2
        targets = torch.full((1, 2, *size), excess * reachable)
        with self.expected(excess > 1, f"targets must have a mean intensity of at most {reachable}"):
            wave.multi_color_hologram_optimizer(colours, size, targets, display, 2, method=method, progress=False)

    @pytest.mark.parametrize("brightness", [1.9, 2.1])
    def test_of_planes(self, brightness):
        targets = torch.full((1, 16, 16), brightness)
        half = (0, 0.5, 0, 1)
        with self.expected(brightness > 2, "targets must have a mean intensity of at most 1"):
            wave.multiplane_hologram_optimizer(
                532e-9, 1e-3, 1e-3, 8e-6, [16, 16], targets, number_of_planes=1, mask_limits=half, progress=False
            )


def noisy_loss(image, target, *plane, generator):
    return torch.nn.functional.mse_loss(image, target + 0.3 * torch.rand(target.shape, generator=generator))


def with_eyebox(loss, seed, **options):
    places = [[0.0, -1e-3], [0.0, 1e-3]]
    target = torch.rand(16, 16, generator=torch.Generator().manual_seed(0))
    return wave.eyebox_hologram(
        target, 532e-9, 0.1, 8e-6, places, n_iteration=4, loss_function=loss, seed=seed, progress=False, **options
    )[0]


def with_descent(loss, seed, **options):
    target = torch.rand(16, 16, generator=torch.Generator().manual_seed(0))
    return wave.stochastic_gradient_descent(
        target, 532e-9, 1e-3, 8e-6, n_iteration=4, loss_function=loss, seed=seed, progress=False, **options
    )[0]


def with_planes(loss, seed, **options):
    targets = torch.rand(2, 16, 16, generator=torch.Generator().manual_seed(0))
    optimizer = wave.multiplane_hologram_optimizer(
        532e-9, 0.0, 1e-3, 8e-6, [16, 16], targets, number_of_iterations=4, loss_function=loss, number_of_planes=2,
        mask_limits=[0, 1, 0, 1], seed=seed, progress=False, **options,
    )  # fmt: skip
    return optimizer.optimize()[0]


@pytest.mark.parametrize("optimized", [with_descent, with_eyebox, with_planes])
def test_a_seed_reaches_the_random_numbers_of_a_loss(optimized, tmp_path):
    torch.manual_seed(1)
    first, state = optimized(noisy_loss, 3), torch.get_rng_state()
    torch.manual_seed(2)
    assert torch.equal(optimized(noisy_loss, 3), first) and not torch.equal(optimized(noisy_loss, 4), first)
    torch.manual_seed(1)
    assert torch.equal(torch.get_rng_state(), state)
    # A run that is interrupted and taken up draws what it would have drawn.
    stop = {"callback": interrupt_at(1), "checkpoint": tmp_path / "run.pt"}
    optimized(noisy_loss, 3, **stop)
    assert torch.equal(optimized(noisy_loss, 3, checkpoint=tmp_path / "run.pt"), first)


def test_losses_that_bring_their_numbers_are_left_alone():
    own = torch.Generator().manual_seed(5)
    bound = functools.partial(noisy_loss, generator=own)
    cpu = torch.device("cpu")
    assert training.seeded_loss(bound, 3, cpu) == (bound, []) and training.seeded_loss(torch.dist, 3, cpu)[1] == []
    assert training.seeded_loss(None, 3, cpu) == (torch.nn.functional.mse_loss, [])
    target, before = torch.rand(1, 8, 8), own.get_state()
    module = wave.multiplane_loss(target, torch.zeros(8, 8), blur_ratio=3.0, number_of_planes=2, generator=own)
    loss, kept = training.seeded_loss(module, 3, cpu)
    assert kept == [loss.keywords["generator"], own] and torch.equal(own.get_state(), before)
