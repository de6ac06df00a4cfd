"""The loop that trains networks: against a loop written out, resumed bit for bit, the best weights, early stopping."""

import itertools
import math
from collections import namedtuple
from contextlib import nullcontext

import pytest
import torch
from torch import nn
from torch.utils.data import DataLoader, TensorDataset

from odak import ConvergenceWarning
from odak.learn.models import train


def network():
    with torch.random.fork_rng():
        torch.manual_seed(4)
        return nn.Sequential(nn.Linear(3, 8), nn.BatchNorm1d(8), nn.ReLU(), nn.Dropout(0.2), nn.Linear(8, 1))


def samples(count=20, seed=0):
    x = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed))
    return TensorDataset(x, (x**2).sum(1, keepdim=True))


def squared_error(model, batch):
    return nn.functional.mse_loss(model(batch[0]), batch[1])


def loader(own_generator=False):
    generator = torch.Generator().manual_seed(8) if own_generator else None
    return DataLoader(samples(), batch_size=6, shuffle=True, generator=generator)


def run(model=None, epochs=8, **options):
    model = network() if model is None else model
    options = {"learning_rate": 0.02, "progress": False, "seed": 3, "batches": loader()} | options
    history = train(model, options.pop("loss", squared_error), epochs=epochs, **options)
    return model, history


def same(first, second):
    return all(torch.equal(first[name], second[name]) for name in first)


def interrupt_after(epoch, error=KeyboardInterrupt):
    def callback(done, history):
        if done == epoch:
            raise error

    return callback


def test_the_loop_is_the_one_everybody_writes():
    written = network()
    optimizer = torch.optim.Adam(written.parameters(), lr=0.02)
    losses = []
    with torch.random.fork_rng():
        torch.manual_seed(3)
        batches = loader()
        for _ in range(8):
            written.train()
            epoch = []
            for batch in batches:
                optimizer.zero_grad()
                loss = squared_error(written, batch)
                loss.backward()
                optimizer.step()
                epoch.append(loss.item())
            losses.append(sum(epoch) / len(epoch))

    def ever_better(model, batch):
        return squared_error(model, batch) if model.training else torch.tensor(-float(next(epochs)))

    epochs = itertools.count()
    model, history = run(loss=ever_better, validation=[None])
    assert history.training == pytest.approx(losses, rel=1e-12)
    assert same(model.state_dict(), written.state_dict())
    assert history.best_epoch == 8 and history.finished and not model.training


def test_a_linear_network_finds_the_least_squares_solution():
    x = torch.randn(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    y = torch.randn(50, 1, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    line = nn.Linear(3, 1, bias=False, dtype=torch.float64)
    train(line, squared_error, [(x, y)], 400, learning_rate=0.05, progress=False)
    torch.testing.assert_close(line.weight.detach().T, torch.linalg.lstsq(x, y).solution, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("own_generator", [False, True])
@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
def test_resumed_training_ends_bit_for_bit_as_uninterrupted_one(own_generator, every, error, tmp_path):
    options = {
        "validation": DataLoader(samples(seed=5), batch_size=7),
        "scheduler": lambda optimizer: torch.optim.lr_scheduler.StepLR(optimizer, 3, 0.5),
        "checkpoint_every": every,
    }
    whole, expected = run(batches=loader(own_generator), **options)
    path = tmp_path / "training.pt"
    stopped = options | {"checkpoint": path, "callback": interrupt_after(5, error)}
    if error is SystemExit:
        with pytest.raises(SystemExit):
            run(batches=loader(own_generator), **stopped)
        assert torch.load(path, weights_only=True)["done"] == (4 if every == 1 else 3)
    else:
        with pytest.warns(ConvergenceWarning, match="interrupted after 5 of 8 epochs"):
            _, history = run(batches=loader(own_generator), **stopped)
        assert not history.finished and len(history.training) == torch.load(path, weights_only=True)["done"] == 5
    torch.rand(5)
    resumed, history = run(batches=loader(own_generator), checkpoint=path, **options)
    assert same(whole.state_dict(), resumed.state_dict())
    assert history == expected and history.finished
    calls = []
    again, _ = run(batches=loader(own_generator), checkpoint=path, callback=lambda *a: calls.append(a), **options)
    assert same(again.state_dict(), whole.state_dict()) and calls == []
    further, history = run(batches=loader(own_generator), epochs=10, checkpoint=path, **options)
    assert same(further.state_dict(), run(batches=loader(own_generator), epochs=10, **options)[0].state_dict())
    assert len(history.training) == 10


def test_an_interruption_within_an_epoch_goes_back_to_its_start(tmp_path):
    path, steps = tmp_path / "training.pt", []

    def interrupted(model, batch):
        steps.append(len(batch[0]))
        if len(steps) == 4 * 3 + 2:
            raise KeyboardInterrupt
        return squared_error(model, batch)

    with pytest.warns(ConvergenceWarning, match="interrupted after 3 of 8 epochs"):
        _, history = run(loss=interrupted, checkpoint=path)
    assert len(history.training) == 3 and not history.finished
    resumed, history = run(checkpoint=path)
    whole, expected = run()
    assert same(resumed.state_dict(), whole.state_dict()) and history == expected


def test_the_best_weights_are_kept():
    # The training goes ever further; the validation is best after the fourth step.
    class Walker(nn.Module):
        def __init__(self):
            super().__init__()
            self.place = nn.Parameter(torch.zeros(()))

    def loss(model, batch):
        return -model.place if model.training else (model.place - 4.2) ** 2

    def walk(**options):
        model = Walker()
        step = {"optimizer": lambda parameters: torch.optim.SGD(parameters, lr=1.0), "progress": False}
        return model.place, train(model, loss, [None], 10, validation=[None], **step, **options)

    place, history = walk()
    assert place.item() == 4 and (history.best_epoch, len(history.validation)) == (4, 10)
    assert history.best_loss == pytest.approx(0.04, rel=1e-5)
    assert history.training == [-float(step) for step in range(10)]
    place, history = walk(patience=3)
    assert place.item() == 4 and len(history.validation) == 7 and history.finished
    with pytest.warns(ConvergenceWarning, match="after 6 of 10 epochs: the model has the weights of epoch 4"):
        place, history = walk(callback=interrupt_after(6))
    assert place.item() == 4 and not history.finished
    place, history = walk(callback=lambda epoch, history: epoch == 2)
    assert place.item() == 2 and history.finished


@pytest.mark.parametrize(
    ("options", "ends_at"), [({}, 10), ({"patience": 3}, 4), ({"callback": interrupt_after(8)}, 4)]
)
def test_without_validation_last_weights_are_kept_but_for_stop(options, ends_at):
    # The loss before step n is lowest for n = 4.
    place = nn.Linear(1, 1, bias=False)
    nn.init.zeros_(place.weight)
    steps = itertools.count(1)

    def loss(model, batch):
        value = (next(steps) - 4.0) ** 2
        return value + model(batch).sum() - model(batch).detach().sum()

    optimizer = torch.optim.SGD(place.parameters(), lr=1.0)
    interrupted = pytest.warns(ConvergenceWarning) if ends_at == 4 and "callback" in options else nullcontext()
    with interrupted:
        train(place, loss, [-torch.ones(1, 1)], 10, optimizer=optimizer, progress=False, **options)
    assert place.weight.item() == ends_at


@pytest.mark.parametrize(("norm", "step"), [(None, 5.0), (2.0, 2.0), (10.0, 5.0)])
def test_long_gradients_are_shortened(norm, step):
    line = nn.Linear(2, 1, bias=False)
    nn.init.zeros_(line.weight)
    batches = [torch.tensor([[3.0, 4.0]])]
    optimizer = torch.optim.SGD(line.parameters(), lr=1.0)
    train(line, lambda model, x: -model(x).sum(), batches, 1, optimizer=optimizer, max_norm=norm, progress=False)
    torch.testing.assert_close(line.weight.detach(), step * torch.tensor([[0.6, 0.8]]))


def test_a_plateau_lowers_the_learning_rate():
    line = nn.Linear(2, 1)
    optimizer = torch.optim.SGD(line.parameters(), lr=1.0)

    def plateau(optimizer):
        return torch.optim.lr_scheduler.ReduceLROnPlateau(optimizer, factor=0.1, patience=0)

    train(line, lambda model, x: 0 * model(x).sum() + 1, [torch.ones(1, 2)], 3, optimizer=optimizer, scheduler=plateau)
    assert optimizer.param_groups[0]["lr"] == pytest.approx(0.01)


def test_randomness_is_the_trainings_own():
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    first, _ = run(seed=1)
    assert torch.equal(torch.rand(4), expected)
    assert same(first.state_dict(), run(seed=1)[0].state_dict())
    assert not same(first.state_dict(), run(seed=2)[0].state_dict())
    torch.manual_seed(3)
    drawn = run(seed=None)[0].state_dict()
    torch.manual_seed(3)
    assert same(drawn, run(seed=None)[0].state_dict())


def test_batches_of_every_build_are_moved():
    pair = namedtuple("pair", "x y")
    seen = []

    def loss(model, batch):
        seen.append(batch)
        return model(batch["pair"].x).sum()

    given = {"pair": pair(torch.ones(1, 2), ["name", torch.zeros(1)]), "number": 3}
    train(nn.Linear(2, 1), loss, [given], 1, device="cpu", progress=False)
    assert type(seen[0]["pair"]) is pair and seen[0]["pair"].y[0] == "name" and seen[0]["number"] == 3


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    path = tmp_path / "training.pt"
    run(checkpoint=path, epochs=1)
    with pytest.raises(ValueError, match="is of another run: its optimizer's settings differ"):
        run(checkpoint=path, learning_rate=0.1)
    with pytest.raises(ValueError, match="its weights differ"):
        run(nn.Linear(3, 1), checkpoint=path)
    with pytest.raises(ValueError, match="its scheduler differ"):
        run(checkpoint=path, scheduler=lambda optimizer: torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.9))
    for content in (b"nothing of the kind", b"", path.read_bytes()[:500]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"training\.pt' cannot be read"):
            run(checkpoint=path)
    torch.save({"weights": torch.ones(3)}, path)
    with pytest.raises(ValueError, match="is not one of a training"):
        run(checkpoint=path)


def test_checkpoint_runs_no_code_and_failed_write_keeps_older(tmp_path, monkeypatch):
    path, proof = tmp_path / "training.pt", tmp_path / "proof"

    class Trap:
        def __reduce__(self):
            return (open, (str(proof), "w"))

    torch.save(Trap(), path)
    with pytest.raises(ValueError, match="cannot be read"):
        run(checkpoint=path)
    assert not proof.exists()
    path.unlink()
    run(checkpoint=path, epochs=1)
    before = path.read_bytes()

    def broken(state, stream):
        stream.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(torch, "save", broken)
    with pytest.raises(OSError, match="disk full"):
        run(checkpoint=path, epochs=2)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_trained_is_an_error(tmp_path):
    with pytest.raises(TypeError, match=r"loss\(model, batch\) must be a tensor with one number, got \[6, 1\]"):
        run(loss=lambda model, batch: model(batch[0]))
    with pytest.raises(TypeError, match="got float"):
        run(loss=lambda model, batch: 0.0)
    with pytest.raises(ValueError, match="batches was empty in epoch 1"):
        run(batches=[])
    with pytest.raises(ValueError, match="batches was empty in epoch 2"):
        run(batches=iter(loader()))
    with pytest.raises(ValueError, match="validation was empty in epoch 1"):
        run(validation=[])
    with pytest.raises(ValueError, match="model must have parameters"):
        run(nn.Flatten())
    with pytest.raises(ValueError, match=r"the folder of checkpoint .* does not exist"):
        run(checkpoint=tmp_path / "no" / "training.pt")


def test_a_loss_that_is_not_finite_leaves_the_best_weights():
    calls = []

    def loss(model, batch):
        calls.append(0)
        return squared_error(model, batch) * (math.nan if len(calls) > 9 else 1)

    good, _ = run(epochs=2)
    model = network()
    with pytest.raises(FloatingPointError, match="the training loss of epoch 3 is nan: lower the learning rate"):
        run(model, loss=loss)
    assert same(model.state_dict(), good.state_dict())


def test_validation_that_is_not_finite_ends_the_training_at_once():
    model, batch = torch.nn.Linear(3, 1), (torch.ones(2, 3), torch.ones(2, 1))
    with pytest.raises(FloatingPointError, match=r"the validation loss of epoch 1 is nan: lower .* or look for values"):
        train(model, squared_error, [batch], 5, validation=[(batch[0], math.nan * batch[1])], progress=False)


def test_mixed_precision_changes_nothing_on_a_cpu():
    assert same(run(mixed_precision=True)[0].state_dict(), run()[0].state_dict())


@pytest.mark.cuda
def test_mixed_precision_and_resume_on_cuda(tmp_path):
    kinds = set()

    def loss(model, batch):
        kinds.add(model[0](batch[0]).dtype)
        return squared_error(model, batch)

    options = {"device": "cuda", "mixed_precision": True, "epochs": 60, "batches": loader()}
    _, history = run(loss=loss, **options)
    assert kinds == {torch.float16} and history.training[-1] < 0.5 * history.training[0]
    torch.use_deterministic_algorithms(False)
    path = tmp_path / "training.pt"
    with pytest.warns(ConvergenceWarning, match="interrupted after 20 of 60 epochs"):
        run(checkpoint=path, callback=interrupt_after(20), **options)
    resumed, _ = run(checkpoint=path, **options)
    whole, _ = run(**options)
    for name, value in whole.state_dict().items():
        torch.testing.assert_close(resumed.state_dict()[name], value, rtol=1e-3, atol=1e-3)
