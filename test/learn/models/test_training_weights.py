"""Files of weights: whole or not at all, checked before they are taken, never code."""

import collections
import os
import pickle

import pytest
import torch

from odak.learn import models
from odak.learn.models import load_weights, save_weights


def network(seed=0):
    torch.manual_seed(seed)
    return models.unet(1, 4, normalization=True)


@pytest.mark.parametrize("name", ["weights.pt", "weights.PTH"])
def test_round_trip(tmp_path, name):
    first, second = network(0), network(1)
    first.train()(torch.rand(2, 2, 8, 8))
    save_weights(first, tmp_path / name)
    load_weights(second, tmp_path / name)
    assert all(torch.equal(value, second.state_dict()[key]) for key, value in first.state_dict().items())
    assert first.training and not any(module.training for module in second.modules())
    assert os.listdir(tmp_path) == [name]


def test_a_file_of_torch_itself(tmp_path):
    first, second = network(0), network(1)
    torch.save(first.state_dict(), tmp_path / "weights.pt")
    load_weights(second, str(tmp_path / "weights.pt"))
    assert torch.equal(first.outc.weight, second.outc.weight)


def test_the_module_keeps_its_dtype(tmp_path):
    save_weights(network(), tmp_path / "weights.pt")
    second = network(1).double()
    load_weights(second, tmp_path / "weights.pt", device="cpu")
    assert second.outc.weight.dtype == torch.float64


def test_file_that_does_not_fit_is_described_and_changes_nothing(tmp_path):
    state = network(0).state_dict()
    state["more.weight"] = torch.rand(3)
    del state["inc.model.0.model.0.weight"]
    state["outc.weight"] = torch.rand(2, 4, 3, 3)
    torch.save(state, tmp_path / "weights.pt")
    second = network(1)
    before = {key: value.clone() for key, value in second.state_dict().items()}
    with pytest.raises(ValueError) as caught:
        load_weights(second, tmp_path / "weights.pt")
    message = str(caught.value)
    assert "weights.pt' does not fit unet" in message
    assert "missing: inc.model.0.model.0.weight;" in message
    assert "unexpected: more.weight;" in message
    assert "of another shape: outc.weight (2, 4, 3, 3) instead of (1, 4, 3, 3)" in message
    assert all(torch.equal(value, before[key]) for key, value in second.state_dict().items()) and second.training


def test_weights_with_batch_norms_do_not_fit_a_network_without(tmp_path):
    save_weights(network(), tmp_path / "weights.pt")
    with pytest.raises(ValueError, match=r"unexpected: inc\.model\.0\.model\.1\.weight, .* and 10 more"):
        load_weights(models.unet(1, 4), tmp_path / "weights.pt")


def test_older_batch_norms_count_no_batches(tmp_path):
    state = {key: value for key, value in network(0).state_dict().items() if "num_batches" not in key}
    torch.save(state, tmp_path / "weights.pt")
    second = network(1)
    load_weights(second, tmp_path / "weights.pt")
    assert torch.equal(second.outc.weight, state["outc.weight"])


class Trap:
    def __reduce__(self):
        return os.mkdir, (os.path.join(os.environ["TRAP"], "sprung"),)


def test_a_file_that_would_run_code_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("TRAP", str(tmp_path))
    torch.save({"weight": Trap()}, tmp_path / "weights.pt")
    with pytest.raises(ValueError, match=r"weights\.pt' cannot be read as weights"):
        load_weights(network(), tmp_path / "weights.pt")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("content", [b"", b"weights", b"PK\x03\x04 broken", pickle.dumps({"a": 1})])
def test_a_broken_file_is_named(tmp_path, content):
    (tmp_path / "weights.pt").write_bytes(content)
    with pytest.raises(ValueError, match=r"weights\.pt' (cannot be read as weights|contains no state dict)"):
        load_weights(network(), tmp_path / "weights.pt")


def test_a_truncated_file_is_named(tmp_path):
    path = tmp_path / "weights.pt"
    save_weights(network(), path)
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(ValueError, match=r"weights\.pt' cannot be read as weights"):
        load_weights(network(), path)


@pytest.mark.parametrize("content", [[torch.rand(2)], {"a": 1}, torch.rand(2), collections.OrderedDict(a="b")])
def test_a_file_without_a_state_dict_is_named(tmp_path, content):
    torch.save(content, tmp_path / "weights.pt")
    with pytest.raises(ValueError, match=r"weights\.pt' contains no state dict"):
        load_weights(network(), tmp_path / "weights.pt")


def test_paths_are_validated(tmp_path):
    for path in (tmp_path / "weights.bin", tmp_path / ".." / "weights.pt", "https://odak.org/weights.pt"):
        with pytest.raises(ValueError):
            save_weights(network(), path)
        with pytest.raises(ValueError):
            load_weights(network(), path)
    with pytest.raises(ValueError, match="does not exist"):
        save_weights(network(), tmp_path / "nowhere" / "weights.pt")
    with pytest.raises(FileNotFoundError):
        load_weights(network(), tmp_path / "weights.pt")
    save_weights(network(), tmp_path / "weights.bin", extensions=(".bin",))
    load_weights(network(), tmp_path / "weights.bin", extensions=(".bin",))


def test_a_failure_leaves_the_older_file(tmp_path, monkeypatch):
    path = tmp_path / "weights.pt"
    save_weights(network(0), path)
    content = path.read_bytes()

    def fails(state, stream):
        stream.write(b"half of it")
        raise OSError("disk full")

    monkeypatch.setattr(torch, "save", fails)
    with pytest.raises(OSError, match="disk full"):
        save_weights(network(1), path)
    assert path.read_bytes() == content and os.listdir(tmp_path) == ["weights.pt"]
