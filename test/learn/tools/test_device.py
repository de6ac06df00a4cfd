import pytest
import torch

from odak.learn.tools import device as device_module
from odak.learn.tools import get_device


@pytest.fixture
def no_cuda(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    device_module._warn_once.cache_clear()
    yield
    device_module._warn_once.cache_clear()


def test_automatic(monkeypatch, no_cuda, caplog):
    for name in ("auto", None, " AUTO "):
        assert get_device(name) == torch.device("cpu")
    assert get_device() == torch.device("cpu")
    assert not caplog.records
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert get_device() == torch.device("cuda")
    assert get_device("cuda:1") == torch.device("cuda:1")


def test_names_and_devices_pass():
    assert get_device("cpu") == torch.device("cpu")
    assert get_device(torch.device("cpu")) == torch.device("cpu")
    assert get_device("meta") == torch.device("meta")


def test_missing_cuda_falls_back_with_one_warning(no_cuda, caplog):
    for asked in ("cuda", "cuda:1", torch.device("cuda")):
        assert get_device(asked) == torch.device("cpu")
    assert [(record.name, record.levelname) for record in caplog.records] == [("odak", "WARNING")]


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
