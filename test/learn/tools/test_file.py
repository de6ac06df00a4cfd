import pickle

import numpy as np
import pytest
import torch

import odak.tools
from odak.learn.tools import load_image, resize, save_image, save_torch_tensor, torch_load


@pytest.fixture
def path(tmp_path):
    return str(tmp_path / "image.png")


def levels_in(path):
    return odak.tools.load_image(path)


@pytest.mark.parametrize(
    "shape, stored",
    [
        ((5, 6), (5, 6)),
        ((3, 5, 6), (5, 6, 3)),
        ((5, 6, 3), (5, 6, 3)),
        ((4, 5, 6), (5, 6, 4)),
        ((1, 5, 6), (5, 6)),
        ((1, 3, 5, 6), (5, 6, 3)),
        ((1, 5, 6, 3), (5, 6, 3)),
        ((1, 1, 5, 6), (5, 6)),
        ((3, 3, 3), (3, 3, 3)),
    ],
)
@pytest.mark.parametrize("depth", [8, 16])
def test_layouts_come_back(path, shape, stored, depth):
    white = 2**depth - 1
    counts = torch.randint(0, white + 1, shape, generator=torch.Generator().manual_seed(depth))
    image = (counts.double() / white).requires_grad_()
    assert save_image(path, image, color_depth=depth) is True
    loaded = load_image(path)
    assert loaded.dtype == torch.float32
    assert loaded.shape == stored
    expected = counts.reshape(shape[-3:]) if len(shape) == 4 else counts
    expected = expected.movedim(0, -1) if expected.shape != (*stored,) else expected
    assert torch.equal((loaded.double() * white).round().long(), expected.reshape(stored))
    first = load_image(path, normalizeby=0, torch_style=True)
    assert first.max() > 1
    assert first.shape == (stored if len(stored) == 2 else (stored[-1], *stored[:-1]))


@pytest.mark.parametrize(
    "image, depth, levels",
    [
        (torch.tensor([[0.0, 0.5, 1.0]]), 8, [0, 128, 255]),
        (torch.tensor([[0.0, 100.0, 255.0]]), 8, [0, 100, 255]),
        (torch.tensor([[0, 1, 255]], dtype=torch.uint8), 16, [0, 257, 65535]),
        (torch.tensor([[0.0, 300.0, 65535.0]]), 16, [0, 300, 65535]),
        (torch.tensor([[False, True]]), 8, [0, 255]),
        (torch.tensor([[0.0, 1.0]], dtype=torch.bfloat16), 8, [0, 255]),
        (np.array([[0.0, 1.0]])[:, ::-1], 8, [255, 0]),
    ],
)
def test_white_without_limits(path, image, depth, levels):
    save_image(path, image, color_depth=depth)
    assert levels_in(path).tolist() == [levels]


@pytest.mark.parametrize("mask", [torch.tensor([[0, 1, 1]]), torch.tensor([[0.0, 1.0, 1.2]])])
def test_picture_of_0_to_1_saved_nearly_black(path, mask):
    with pytest.warns(odak.ArgumentWarning, match=r"img reaches 1.* where 255 is white: .* give cmax=1\.0"):
        save_image(path, mask)
    assert levels_in(path).tolist() == [[0, 1, 1]]
    with pytest.warns(odak.ArgumentWarning, match="nearly black"):
        odak.tools.save_image(path, mask.numpy())


def test_picture_of_16_bits_saved_nearly_white(path):
    picture = np.asarray([[0, 255, 40000]], np.uint16)
    for save, depth in ((odak.tools.save_image, 8), (odak.tools.save_image, 16), (save_image, 8)):
        with pytest.warns(
            odak.ArgumentWarning, match=r"img reaches 40000 where 255 is white: .* give cmax, such as 65535"
        ):
            save(path, picture, color_depth=depth)
        white = 2**depth - 1
        assert levels_in(path).tolist() == [[0, white, white]]
    odak.tools.save_image(path, picture, cmax=65535, color_depth=16)
    assert levels_in(path).tolist() == picture.tolist()


def test_quantize_names_a_picture_of_the_other_range():
    with pytest.warns(odak.ArgumentWarning, match="image_field reaches 1 where 255 is white: multiply it by 255"):
        odak.tools.quantize(np.linspace(0, 1, 5))
    with pytest.warns(
        odak.ArgumentWarning, match="image_field reaches 65535 where 255 is white: .* scale it to 0 … 255"
    ):
        odak.tools.quantize(np.linspace(0, 65535, 5))
    with pytest.warns(odak.ArgumentWarning, match=r"image_field reaches 255 where 1 is white: .*limits=\(0, 255\)"):
        odak.learn.tools.quantize(torch.linspace(0, 255, 5))


def test_limits_may_be_tensors(path):
    image = torch.tensor([[-1.0, 0.0, 1.0, 3.0]])
    save_image(path, image, cmin=image.min(), cmax=image.max())
    assert levels_in(path).tolist() == [[0, 64, 128, 255]]
    assert image.tolist() == [[-1.0, 0.0, 1.0, 3.0]]


def test_what_cannot_be_saved(path):
    with pytest.raises(ValueError, match="a batch of 2"):
        save_image(path, torch.zeros(2, 3, 4, 4))
    with pytest.raises(TypeError, match="magnitude"):
        save_image(path, torch.zeros(4, 4, dtype=torch.complex64))
    with pytest.raises(ValueError, match="img must be"):
        save_image(path, torch.zeros(2, 5, 5))


def test_missing_image(path):
    with pytest.raises(ValueError, match=r"Failed to load image .*image\.png"):
        load_image(path)


@pytest.mark.parametrize(
    "shape, resized",
    [
        ((8, 12), (4, 6)),
        ((3, 8, 12), (3, 4, 6)),
        ((8, 12, 3), (4, 6, 3)),
        ((2, 3, 8, 12), (2, 3, 4, 6)),
        ((1, 3, 8, 12), (3, 4, 6)),
        ((2, 8, 12, 3), (2, 4, 6, 3)),
        ((7, 9, 4), (3, 4, 4)),
    ],
)
@pytest.mark.parametrize("mode", ["nearest", "bilinear", "bicubic", "area"])
def test_resizing(shape, resized, mode):
    image = torch.full(shape, 0.25, dtype=torch.float64)
    result = resize(image, 0.5, mode)
    assert result.shape == resized
    assert result.dtype == torch.float64
    assert torch.allclose(result, torch.tensor(0.25, dtype=torch.float64))


def test_resizing_integers_and_refusals():
    image = torch.tensor([[0, 255], [255, 255]], dtype=torch.uint8).repeat_interleave(2, 0).repeat_interleave(2, 1)
    assert resize(image, 0.5, "area").tolist() == [[0, 255], [255, 255]]
    assert resize(torch.ones(4, 4, dtype=torch.bool)).all()
    with pytest.raises(ValueError, match="mode must be one of"):
        resize(image, mode="linear")
    with pytest.raises(ValueError, match="multiplier must be positive"):
        resize(image, multiplier=-1)
    with pytest.raises(ValueError, match="leaves nothing"):
        resize(image, multiplier=0.1)
    with pytest.raises(ValueError, match=r"must be \[H, W\], \[C, H, W\] or \[B, C, H, W\]"):
        resize(torch.ones(4))
    with pytest.raises(TypeError, match="real tensor"):
        resize(torch.ones(4, 4, dtype=torch.complex64))


def test_tensors_come_back(tmp_path):
    value = {"a": torch.arange(6.0).reshape(2, 3), "b": [torch.ones(2, dtype=torch.complex64)]}
    for name in ("a.pt", "a.pth", "a.pkl"):
        assert save_torch_tensor(tmp_path / name, value) is None
        loaded = torch_load(tmp_path / name, map_location="cpu")
        assert torch.equal(loaded["a"], value["a"])
        assert torch.equal(loaded["b"][0], value["b"][0])


class _Harm:
    def __reduce__(self):
        return (print, ("code ran",))


def test_code_in_a_file_does_not_run(tmp_path, capsys):
    torch.save(_Harm(), tmp_path / "a.pt")
    with pytest.raises(pickle.UnpicklingError):
        torch_load(tmp_path / "a.pt")
    assert capsys.readouterr().out == ""


def test_broken_tensors_and_failures(tmp_path, monkeypatch):
    path = tmp_path / "a.pt"
    save_torch_tensor(path, torch.ones(100))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"Failed to load .*a\.pt"):
        torch_load(path)
    path.write_bytes(b"")
    with pytest.raises(ValueError, match=r"Failed to load .*a\.pt"):
        torch_load(path)
    with pytest.raises(FileNotFoundError):
        torch_load(tmp_path / "none.pt")
    with pytest.raises(ValueError, match="not allowed"):
        torch_load(tmp_path / "a.bin")
    path.write_bytes(whole)
    with pytest.raises((AttributeError, TypeError, pickle.PicklingError)):
        save_torch_tensor(path, lambda: 0)
    assert path.read_bytes() == whole
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.pt"]


def test_a_tensor_of_one_axis_is_saved_as_a_column(tmp_path):
    save_image(tmp_path / "b.png", torch.tensor([0.0, 1.0]))
    assert load_image(tmp_path / "b.png").tolist() == [[0], [1]]
