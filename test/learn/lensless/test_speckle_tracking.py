"""Rotation from speckle: the network's keys and arithmetic, its files, and that it learns a rotation."""

import pytest
import torch
from torch import nn
from torch.nn import functional

from odak.learn.lensless import spec_track

BATCH_NORM = ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")
SHAPES = {
    "conv1": (32, 5, 3, 3),
    "bn1": 32,
    "conv2": (64, 32, 5, 5),
    "bn2": 64,
    "conv3": (128, 64, 7, 7),
    "bn3": 128,
    "fc1": (2048, 6400),
    "fc_bn1": 2048,
    "fc2": (1024, 2048),
    "fc_bn2": 1024,
    "fc3": (512, 1024),
    "fc_bn3": 512,
    "fc4": (128, 512),
    "fc_bn4": 128,
    "fc5": (3, 128),
}


def expected_state():
    for name, shape in SHAPES.items():
        if isinstance(shape, tuple):
            yield from ((f"network.{name}.weight", shape), (f"network.{name}.bias", shape[:1]))
        else:
            parts = ((part, () if part == "num_batches_tracked" else (shape,)) for part in BATCH_NORM)
            yield from ((f"network.{name}.{part}", size) for part, size in parts)


@pytest.fixture(scope="module")
def tracker():
    torch.manual_seed(0)
    return spec_track()


class light_tracker(spec_track):
    """A tracker whose network is small enough for fast training."""

    def init_layers(self):
        layers = [nn.AvgPool2d(20), nn.Flatten(), nn.Linear(720, 4), nn.BatchNorm1d(4), nn.Linear(4, 3)]
        self.network = nn.Sequential(*layers)


def small(**options):
    torch.manual_seed(1)
    return light_tracker(**options)


def batches(*sizes, seed=0):
    generator = torch.Generator().manual_seed(seed)
    for size in sizes:
        angles = torch.rand(size, 3, generator=generator)
        yield functional.pad(angles[:, :, None, None].expand(-1, -1, 180, 320), (0, 0, 0, 0, 0, 2)), angles


def test_keys_shapes_and_size(tracker):
    state = tracker.state_dict()
    assert [(name, tuple(value.shape)) for name, value in state.items()] == list(expected_state())
    assert sum(parameter.numel() for parameter in tracker.parameters()) == 16_260_419


def test_the_network_is_the_one_described(tracker):
    tracker.eval()
    state, x = tracker.network.state_dict(), torch.rand(2, 5, 180, 320)

    def normalized(x, name):
        return functional.batch_norm(
            x, *(state[f"{name}.{part}"] for part in ("running_mean", "running_var", *BATCH_NORM[:2]))
        )

    with torch.no_grad():
        got = tracker(x)
        for i in (1, 2, 3):
            x = functional.conv2d(x, state[f"conv{i}.weight"], state[f"conv{i}.bias"], padding=1)
            x = functional.max_pool2d(normalized(x, f"bn{i}").relu(), 3)
        x = x.reshape(2, -1)
        for i in (1, 2, 3, 4):
            x = normalized(x @ state[f"fc{i}.weight"].T + state[f"fc{i}.bias"], f"fc_bn{i}").relu()
        x = x @ state["fc5.weight"].T + state["fc5.bias"]
    torch.testing.assert_close(got, x)


@pytest.mark.parametrize("shape", [(2, 5, 180, 321), (2, 3, 180, 320), (5, 180, 320), (1, 5, 1, 180, 320)])
def test_pictures_of_another_size_are_refused(tracker, shape):
    with pytest.raises(ValueError, match=r"x must be \[B, 5, 180, 320\], images of 180×320 pixels, got \["):
        tracker(torch.zeros(shape))


def test_errors_are_weighed():
    estimate, truth = torch.tensor([[1.0, 2.0, 3.0]]), torch.tensor([[0.0, 4.0, 3.0]])
    assert small().evaluate(estimate, truth).item() == 100 * 5 + 3
    assert small(reduction="mean").evaluate(estimate, truth, weights=[3.0, 6.0]).item() == pytest.approx(3 * 5 / 3 + 6)
    with pytest.raises(ValueError, match=r"and ground_truth must have the same shape, got \(3,\) and \(1, 3\)"):
        small().evaluate(estimate[0], truth)
    with pytest.raises(ValueError, match="weights must be two numbers"):
        small().evaluate(estimate, truth, weights=[1.0])
    with pytest.raises(ValueError, match="reduction must be one of 'sum', 'mean', 'none'"):
        spec_track(reduction="average")


def test_one_picture_is_trained_with_the_statistics_gathered(tracker):
    tracker.train()
    before = {name: value.clone() for name, value in tracker.named_buffers()}
    x = torch.rand(1, 5, 180, 320)
    trained = tracker(x)
    trained.sum().backward()
    assert trained.shape == (1, 3) and tracker.network.conv1.weight.grad.abs().sum() > 0
    assert all(module.training for module in tracker.network)
    for name, value in tracker.named_buffers():
        assert torch.equal(value, before[name]) == ("fc_bn" in name), name


def test_fit_writes_its_histories_and_best_weights(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = small(reduction="mean")
    history = model.fit(list(batches(8, 8, 1)), list(batches(6, seed=9)), 12, 0.1, 0.0, "out", seed=2, progress=False)
    assert history.finished and len(model.train_history) == len(model.validation_history) == 12
    assert min(model.validation_history) < 0.2 * model.validation_history[0]
    logs = [
        torch.load(tmp_path / "out" / "log" / f"{name}_log.pt", weights_only=True) for name in ("train", "validation")
    ]
    assert logs == [model.train_history, model.validation_history] == [history.training, history.validation]
    lowest, names = float("inf"), []
    for epoch, value in enumerate(model.validation_history, start=1):
        if value < lowest:
            lowest = value
            names.append(f"best_model_epoch_{epoch}.pt")
    assert sorted(path.name for path in (tmp_path / "out").glob("*.pt")) == sorted(names)
    best = torch.load(tmp_path / "out" / names[-1], weights_only=True)
    assert list(best) == list(model.network.state_dict())
    assert all(torch.equal(best[name], value) for name, value in model.network.state_dict().items())
    pictures, angles = next(batches(6, seed=9))
    assert model.evaluate(model(pictures), angles).item() == pytest.approx(lowest, rel=1e-5)
    model.fit(list(batches(4)), list(batches(4)), 1, 0.01, directory="out", progress=False)
    assert len(model.train_history) == 13


def test_fit_goes_on_from_a_checkpoint(tmp_path):
    def fit(model, epochs):
        data = {"directory": tmp_path, "seed": 2, "progress": False, "checkpoint": tmp_path / "state.pt"}
        model.fit(list(batches(4, 4)), list(batches(3)), epochs, 0.01, **data)
        return model

    fit(small(), 2)
    resumed = fit(small(), 5)
    (tmp_path / "state.pt").unlink()
    whole = fit(small(), 5)
    assert resumed.train_history == whole.train_history and len(whole.train_history) == 5
    assert all(torch.equal(a, b) for a, b in zip(resumed.parameters(), whole.parameters(), strict=True))


def test_a_broken_folder_is_reported_before_the_training(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match=r"cannot be made|not a directory"):
        small().fit([], [], directory=tmp_path / "file")
    with pytest.raises(ValueError, match="traversal"):
        small().fit([], [], directory="../out")


def test_weights_go_to_a_file_and_back(tracker, tmp_path):
    path = tmp_path / "weights.pt"
    tracker.save_weights(path)
    assert list(torch.load(path, weights_only=True)) == [name.removeprefix("network.") for name, _ in expected_state()]
    other = spec_track()
    other.load_weights(path)
    assert not other.training and not other.network.training
    for name, value in other.state_dict().items():
        assert torch.equal(value, tracker.state_dict()[name])
    with pytest.raises(ValueError, match=r"does not fit .*missing: 2\.weight.*unexpected: conv1\.weight"):
        small().load_weights(path)
    with pytest.raises(FileNotFoundError):
        tracker.load_weights(tmp_path / "none.pt")
    with pytest.raises(ValueError, match=r"Extension '\.txt' is not allowed"):
        tracker.save_weights(tmp_path / "weights.txt")


@pytest.mark.cuda
def test_weights_of_a_gpu_are_read_without_one(tmp_path):
    there = spec_track(device="cuda")
    there.save_weights(tmp_path / "weights.pt")
    model = spec_track()
    model.load_weights(tmp_path / "weights.pt")
    assert model.network.fc5.bias.device.type == "cpu"
    assert all(torch.equal(a, b.cpu()) for a, b in zip(model.parameters(), there.parameters(), strict=True))


def render(angles, speckle):
    """Return what a sensor sees of speckle: tilts shift it by up to 20 pixels, a spin turns it by up to 10°."""
    turn, ratio = torch.deg2rad(10 * angles[:, 2]), 180 / 320
    cos, sin = turn.cos() / 2, turn.sin() / 2
    across = torch.stack([cos, -sin * ratio, angles[:, 0] * 20 / 320], -1)
    down = torch.stack([sin / ratio, cos, angles[:, 1] * 20 / 180], -1)
    grid = functional.affine_grid(torch.stack([across, down], 1), [len(angles), 5, 180, 320], align_corners=False)
    return functional.grid_sample(speckle.expand(len(angles), -1, -1, -1), grid, align_corners=False)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_it_learns_a_rotation(tmp_path):
    generator = torch.Generator().manual_seed(0)
    # Five wavelengths: intensities of five Gaussian random fields with grains of about 20 pixels.
    fields = functional.interpolate(torch.randn(5, 2, 18, 32, generator=generator), size=(360, 640), mode="bicubic")
    speckle = fields.square().sum(1)[None] / 2
    train, test = (2 * torch.rand(count, 3, generator=generator) - 1 for count in (64, 32))
    dataset = torch.utils.data.TensorDataset(render(train, speckle), train)
    loader, unseen = torch.utils.data.DataLoader(dataset, 16, shuffle=True), render(test, speckle)
    torch.manual_seed(0)
    model = spec_track(reduction="mean")
    model.fit(loader, [(unseen, test)], 5, 1e-3, directory=tmp_path, seed=0, progress=False)
    with torch.no_grad():
        error = (model(unseen) - test).square().mean(0)
    assert (error < 0.25 * test.var(0)).all()
