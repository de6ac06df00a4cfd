"""Learned holograms and learned propagation: keys, interleaving, loss, training, files."""

import json

import pytest
import torch
from torch import nn

from odak.learn.models import spatially_adaptive_unet, spatially_varying_kernel_generation_model, unet
from odak.learn.wave import focal_surface_light_propagation, holobeam_multiholo


class Constant(nn.Module):
    """Return channel c as 10 c + the row's number."""

    def __init__(self, channels=2):
        super().__init__()
        self.channels = channels

    def forward(self, x):
        rows = torch.arange(x.shape[-2], dtype=x.dtype)[:, None].expand(x.shape[-2:])
        return torch.stack([10 * channel + rows for channel in range(self.channels)]).expand(len(x), -1, -1, -1)


class Light(holobeam_multiholo):
    """A model whose network is one convolution."""

    def __init__(self, **options):
        torch.manual_seed(0)
        super().__init__(n_hidden=1, **options)
        self.network = nn.Conv2d(1, 2, 3, padding=1)


def pairs(sizes=(4, 4, 2)):
    generator = torch.Generator().manual_seed(0)
    for size in sizes:
        images = torch.rand(size, 1, 8, 10, generator=generator)
        yield images, 3 * images - 1


@pytest.fixture(scope="module")
def propagation():
    torch.manual_seed(0)
    return focal_surface_light_propagation()


def test_hologram_keys_are_those_of_the_unet():
    model = holobeam_multiholo()
    inner = unet(dimensions=16, input_channels=1, output_channels=2).state_dict()
    assert list(model.state_dict()) == [f"network.{name}" for name in inner]
    assert [value.shape for value in model.state_dict().values()] == [value.shape for value in inner.values()]


def test_the_callers_seed_is_left_alone():
    first, second = [], []
    for drawn in (first, second):
        torch.manual_seed(5)
        drawn += [holobeam_multiholo(n_hidden=2).network.outc.weight, torch.rand(3)]
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize("channels", [2, 3])
def test_phases_alternate_like_a_chessboard(channels):
    model = holobeam_multiholo(n_hidden=1)
    model.network = Constant(channels)
    phase = model(torch.zeros(2, 1, 5, 4))
    assert phase.shape == (2, 1, 5, 4)
    for row in range(5):
        for column in range(4):
            assert (phase[:, 0, row, column] == row + 10 * ((row + column) % 2)).all()


def test_without_gradients_on_request():
    model, x = Light(), torch.rand(1, 1, 8, 8)
    assert model(x).requires_grad and not model(x, test=True).requires_grad
    with torch.no_grad():
        assert not model(x).requires_grad


def test_errors_are_weighed():
    estimate, truth = torch.tensor([1.0, 5.0]), torch.tensor([0.0, 2.0])
    assert Light().evaluate(estimate, truth).item() == pytest.approx(10 + 0.1 * 4)
    assert Light(reduction="mean").evaluate(estimate, truth, weights=[2.0, 3.0]).item() == pytest.approx(10 + 6)
    with pytest.raises(ValueError, match="input_data and ground_truth must have the same shape"):
        Light().evaluate(estimate, truth[:1])
    with pytest.raises(ValueError, match="n_output must be at least 2, got 1"):
        holobeam_multiholo(n_output=1)


def test_fit_learns_and_writes_its_weights(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = Light(reduction="mean")
    before = [value.clone() for value in model.parameters()]
    history = model.fit(list(pairs()), 61, 0.05, "out", 30, seed=1, progress=False)
    assert history.finished and history.training[-1] < 0.05 * history.training[0]
    names = ["weights.pt", "weights_0000.pt", "weights_0030.pt", "weights_0060.pt"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names
    final = torch.load(tmp_path / "out" / "weights.pt", weights_only=True)
    assert list(final) == ["weight", "bias"] and not torch.equal(final["weight"], before[0])
    other = Light()
    other.load_weights(tmp_path / "out" / "weights_0060.pt")
    assert not other.training
    assert all(torch.equal(a, b) for a, b in zip(other.parameters(), model.parameters(), strict=True))


def test_fit_reduces_the_loss_of_the_whole_network(tmp_path):
    torch.manual_seed(0)
    model = holobeam_multiholo(n_hidden=4)
    data = [(images.repeat(1, 1, 2, 2), holograms.repeat(1, 1, 2, 2)) for images, holograms in pairs()]
    history = model.fit(data, 20, 1e-2, tmp_path / "out", seed=0, progress=False)
    assert history.training[-1] < 0.6 * history.training[0]


def test_fit_goes_on_from_a_checkpoint(tmp_path):
    def fit(epochs, name):
        model = Light()
        model.fit(list(pairs()), epochs, 0.01, tmp_path, progress=False, checkpoint=tmp_path / name)
        return model

    fit(2, "state.pt")
    resumed, whole = fit(5, "state.pt"), fit(5, "other.pt")
    assert all(torch.equal(a, b) for a, b in zip(resumed.parameters(), whole.parameters(), strict=True))


def test_weights_go_to_a_file_and_back(tmp_path):
    model, path = holobeam_multiholo(n_hidden=2), tmp_path / "weights.pth"
    model.save_weights(path)
    assert list(torch.load(path, weights_only=True)) == list(model.network.state_dict())
    other = holobeam_multiholo(n_hidden=2)
    other.load_weights(path)
    for name, value in model.state_dict().items():
        assert torch.equal(other.state_dict()[name], value)
    with pytest.raises(ValueError, match="does not fit unet: of another shape: inc"):
        holobeam_multiholo(n_hidden=4).load_weights(path)


def test_propagation_keys_and_size(propagation):
    parts = {
        "sv_kernel_generation": spatially_varying_kernel_generation_model(),
        "light_propagation": spatially_adaptive_unet(),
    }
    expected = [(f"{part}.{k}", v.shape) for part, model in parts.items() for k, v in model.state_dict().items()]
    assert [(name, value.shape) for name, value in propagation.state_dict().items()] == expected
    assert sum(value.numel() for value in propagation.state_dict().values()) == 1_861_138
    # Adaptive layers keep their weights under two keys.
    twice = sum(value.numel() for name, value in propagation.state_dict().items() if "standard_convolution.w" in name)
    assert sum(parameter.numel() for parameter in propagation.parameters()) == 1_861_138 - twice


def test_the_field_of_a_hologram_has_real_parts_first(propagation):
    phase = torch.tensor([0.0, 0.25, 0.5]).reshape(1, 3, 1, 1).expand(2, 3, 4, 4)
    field = propagation.generate_input_field(phase)
    expected = torch.tensor([1.0, 0, -1, 0, 1, 0]).reshape(1, 6, 1, 1).expand(2, 6, 4, 4)
    torch.testing.assert_close(field, expected, atol=1e-6, rtol=0)


def test_propagation_is_the_composition_of_its_parts(propagation):
    surface, phase = torch.rand(1, 1, 64, 64), torch.rand(1, 3, 64, 64)
    with torch.no_grad():
        intensity = propagation(surface, phase)
        field = torch.cat([torch.cos(2 * torch.pi * phase), torch.sin(2 * torch.pi * phase)], 1)
        kernels = propagation.sv_kernel_generation(surface, field)
        out = propagation.light_propagation(kernels, field)
    torch.testing.assert_close(intensity, torch.complex(out[:, :3], out[:, 3:]).abs() ** 2, rtol=1e-4, atol=1e-7)
    assert intensity.shape == (1, 3, 64, 64) and (intensity >= 0).all()


def test_propagation_is_differentiable_in_the_hologram(propagation):
    phase = torch.rand(1, 3, 32, 32, requires_grad=True)
    propagation(torch.rand(1, 1, 32, 32), phase).mean().backward()
    assert phase.grad.isfinite().all() and phase.grad.abs().sum() > 0


def renamed(model, folder):
    """Write the weights of a model under other names, and the file that maps these to its own."""
    state, mapping = {}, {"sv_kernel_generation_key_mapping": {}, "light_prop_key_mapping": {}}
    parts = {"sv_kernel_generation": "sv_kernel_generation_key_mapping", "light_propagation": "light_prop_key_mapping"}
    for number, (name, value) in enumerate(model.state_dict().items()):
        part, _, inner = name.partition(".")
        state[f"old.{number}"] = value
        mapping[parts[part]][f"old.{number}"] = inner
    torch.save(state, folder / "weights.pt")
    return mapping


def written(mapping, folder):
    path = folder / "keys.json"
    path.write_text(json.dumps(mapping))
    return path


def test_weights_of_other_names_are_mapped(propagation, tmp_path):
    mapping = renamed(propagation, tmp_path)
    other = focal_surface_light_propagation()
    other.load_weights(tmp_path / "weights.pt", written(mapping, tmp_path))
    assert not other.training
    for name, value in propagation.state_dict().items():
        assert torch.equal(other.state_dict()[name], value)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda parts: [], "must map keys to keys under 'sv_kernel_generation_key_mapping'"),
        (lambda parts: {**parts, "light_prop_key_mapping": ["old.1"]}, "under 'light_prop_key_mapping'"),
        (lambda parts: {**parts, "light_prop_key_mapping": {"old.1": 3}}, "under 'light_prop_key_mapping'"),
        (lambda parts: parts["light_prop_key_mapping"].popitem() and parts, "missing: light_propagation.decoder"),
        (lambda parts: parts["light_prop_key_mapping"].update(none="x") or parts, "lacks keys .*: none"),
        (
            lambda parts: parts["light_prop_key_mapping"].update({"old.0": "inc.model.0.bias"}) or parts,
            r"names two keys for 'inc\.model\.0\.bias' under 'light_prop_key_mapping'",
        ),
        (
            lambda parts: parts["light_prop_key_mapping"].update({"old.0": "inc.model.0.b"}) or parts,
            r"unexpected: light_propagation\.inc\.model\.0\.b",
        ),
    ],
)
def test_a_mapping_that_does_not_fit_changes_nothing(propagation, tmp_path, spoil, message):
    mapping = spoil(renamed(propagation, tmp_path))
    other = focal_surface_light_propagation()
    before = {name: value.clone() for name, value in other.state_dict().items()}
    with pytest.raises(ValueError, match=message):
        other.load_weights(tmp_path / "weights.pt", written(mapping, tmp_path))
    assert all(torch.equal(value, before[name]) for name, value in other.state_dict().items())


def test_broken_files_are_named(propagation, tmp_path):
    mapping = written(renamed(propagation, tmp_path), tmp_path)
    with pytest.raises(FileNotFoundError):
        propagation.load_weights(tmp_path / "none.pt", mapping)
    with pytest.raises(FileNotFoundError):
        propagation.load_weights(tmp_path / "weights.pt", tmp_path / "none.json")
    (tmp_path / "weights.pt").write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"weights\.pt' cannot be read as weights"):
        propagation.load_weights(tmp_path / "weights.pt", mapping)
    mapping.write_text("{")
    with pytest.raises(ValueError, match=r"keys\.json' is not a JSON file"):
        propagation.load_weights(tmp_path / "weights.pt", mapping)


def test_channels_that_make_no_field_are_refused():
    with pytest.raises(ValueError, match="out_channels must be even"):
        focal_surface_light_propagation(out_channels=5)


@pytest.mark.cuda
def test_models_move_themselves_to_their_device():
    assert next(focal_surface_light_propagation(device="cuda").parameters()).is_cuda
    model, picture = holobeam_multiholo(n_hidden=2, device="cuda").eval(), torch.rand(1, 1, 32, 32)
    found = model(picture.cuda())
    assert found.is_cuda
    torch.testing.assert_close(found.cpu(), model.cpu()(picture), rtol=1e-3, atol=1e-4)
