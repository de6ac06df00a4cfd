"""The loop that optimizers and trainings share: checkpoints, interruption, the best so far; its solvers."""

import itertools

import pytest
import torch

from odak.learn.tools.iterations import LBFGS, Adam, Run, minimise
from odak.learn.wave.training import generator_from


def run(start, iterations=20, solver="adam", noise=0.0, loss_of=None, rate=0.1, seed=None, **options):
    """Return the parameter after descending a bowl whose centre shakes, and whether the run came to its end."""
    parameter = start.clone().requires_grad_()
    draw = generator_from(seed)

    def gradient(iteration):
        centre = torch.ones_like(start) + noise * torch.randn(start.shape, dtype=start.dtype, generator=draw)
        loss = (parameter - centre).square().sum() if loss_of is None else loss_of(iteration, parameter)
        loss.backward()
        return loss.detach()

    options = Run(**({"progress": False, "iterations": iterations} | options))
    ended = minimise(
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


def test_interruption_gives_the_best_so_far(start, logged):
    # A loss that rises from the sixth step on: the best parameters are those that gave the sixth loss.
    seen = []

    def loss_of(iteration, parameter):
        seen.append(parameter.detach().clone())
        return parameter.sum() * (1 if iteration < 6 else 0) + (100.0 * iteration if iteration > 5 else 0)

    best, ended = run(start, loss_of=loss_of, callback=interrupt_at(9))
    assert not ended
    assert torch.equal(best, seen[5])
    assert "interrupted after 10 of 20" in logged.text


def test_interruption_within_iteration_leaves_whole_parameters(start, tmp_path):
    path = tmp_path / "run.pt"

    def loss_of(iteration, parameter):
        if iteration == 4:
            raise KeyboardInterrupt
        return (parameter - 1).square().sum()

    run(start, loss_of=loss_of, checkpoint=path, seed=0)
    assert torch.load(path, weights_only=True)["done"] == 4
    assert torch.equal(run(start, checkpoint=path, seed=0)[0], run(start, seed=0)[0])


@pytest.mark.parametrize("stop", [1, 2, 6])
def test_interruption_within_line_search_goes_back_to_its_start(start, stop, tmp_path):
    path, calls = tmp_path / "run.pt", itertools.count(1)

    def quartic(iteration, parameter, stop=None):
        if next(calls) == stop:
            raise KeyboardInterrupt
        return (parameter - 1).pow(4).sum()

    options = {"solver": "lbfgs", "seed": 0}
    whole, _ = run(start, loss_of=quartic, **options)
    calls = itertools.count(1)
    run(start, loss_of=lambda i, p: quartic(i, p, stop), checkpoint=path, **options)
    assert torch.load(path, weights_only=True)["done"] == max(0, stop - 2)
    assert torch.equal(run(start, loss_of=quartic, checkpoint=path, **options)[0], whole)


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
