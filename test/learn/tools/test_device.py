import pytest
import torch

from odak import DeviceWarning
from odak.learn._tensors import checked_device
from odak.learn.tools import get_device


@pytest.fixture
def no_cuda(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


def test_automatic(monkeypatch, no_cuda):
    for name in ("auto", None, " AUTO "):
        assert get_device(name) == torch.device("cpu")
    assert get_device() == torch.device("cpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert get_device() == torch.device("cuda")
    assert get_device("cuda:1") == torch.device("cuda:1")


def test_names_and_devices_pass():
    assert get_device("cpu") == torch.device("cpu")
    assert get_device(torch.device("cpu")) == torch.device("cpu")
    assert get_device("meta") == torch.device("meta")


def test_missing_cuda_falls_back_with_a_visible_warning(no_cuda):
    for asked in ("cuda", "cuda:1", torch.device("cuda")):
        with pytest.warns(DeviceWarning, match="there is no CUDA device: the CPU is used instead") as caught:
            assert get_device(asked) == torch.device("cpu")
        assert caught[0].filename == __file__


def test_refused():
    with pytest.raises(ValueError, match=r"device must be .*got 'cdua'.*Did you mean 'cuda'"):
        get_device("cdua")
    with pytest.raises(ValueError, match="device must be"):
        get_device("")
    for wrong in (3, True):
        with pytest.raises(TypeError, match="device must be"):
            get_device(wrong)


@pytest.mark.cuda
def test_the_gpu_is_taken():
    assert get_device().type == "cuda"


def test_a_device_that_is_not_there_is_refused_by_its_number(monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    assert checked_device("device", "cuda:0") == torch.device("cuda", 0)
    for given in ("cuda:7", torch.device("cuda", 2)):
        with pytest.raises(ValueError, match="device must be on this machine, where torch finds 1 of CUDA"):
            checked_device("device", given)
