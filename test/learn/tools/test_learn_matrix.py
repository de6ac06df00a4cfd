import pytest
import torch

from odak.learn.tools import crop_center, quantize, zero_pad


@pytest.mark.parametrize(
    "shape, padded",
    [
        ((4, 5), (8, 10)),
        ((2, 4, 5), (2, 8, 10)),
        ((4, 5, 3), (8, 10, 3)),
        ((2, 3, 4, 5), (2, 3, 8, 10)),
        ((1, 3, 4, 4), (3, 8, 8)),
        ((1, 4, 5, 3), (1, 8, 10, 3)),
        ((2, 4, 5, 3), (2, 8, 10, 3)),
        ((1, 1, 2, 4, 5), (1, 1, 2, 8, 10)),
    ],
)
def test_layouts(shape, padded):
    field = torch.rand(shape, generator=torch.Generator().manual_seed(0))
    result = zero_pad(field)
    assert result.shape == padded
    back = crop_center(result)
    assert torch.equal(back.reshape(shape), field)
    assert result.sum() == pytest.approx(field.sum().item(), rel=1e-5)


@pytest.mark.parametrize("dtype", [torch.float64, torch.complex128])
def test_gradients(dtype):
    field = torch.rand(3, 5, dtype=dtype, generator=torch.Generator().manual_seed(0), requires_grad=True)
    assert torch.autograd.gradcheck(lambda f: zero_pad(f, [6, 7]), field)
    assert torch.autograd.gradcheck(lambda f: crop_center(f, [2, 3]), field)
    batched = torch.func.vmap(zero_pad)(field.detach().expand(2, 3, 5))
    assert torch.equal(batched[1], zero_pad(field.detach()))


def test_worked_values():
    assert zero_pad(torch.ones(3, 3), [4, 6])[1:, 2:5].sum() == 9
    assert crop_center(torch.arange(25).reshape(5, 5)).tolist() == [[6, 7], [11, 12]]
    assert quantize(torch.tensor([0.0, 0.3, 0.999]), 2).tolist() == [0, 1, 3]
    assert torch.equal(zero_pad(torch.ones(2, 2), [4, 4], "left"), zero_pad(torch.ones(2, 2), [4, 4], "left aligned"))


def test_levels_stay_between_the_first_and_the_last():
    values = torch.tensor([-1.0, 0.0, 128.0, 255.9, 256.0, 400.0, float("nan"), float("inf")])
    levels = quantize(values, bits=4, limits=[0, 256])
    assert levels.dtype == torch.int32
    assert levels.tolist() == [0, 0, 8, 15, 15, 15, 0, 15]
    assert quantize(torch.tensor([0.0, 1.0]), 30).tolist() == [0, 2**30 - 1]
    assert quantize(torch.tensor([0, 1])).tolist() == [0, 255]


def test_refused():
    with pytest.raises(ValueError, match="method must be one of"):
        zero_pad(torch.ones(2, 2), method="middle")
    with pytest.raises(ValueError, match="size must be at least"):
        zero_pad(torch.ones(4, 4), [2, 2])
    with pytest.raises(ValueError, match="size must be at most"):
        crop_center(torch.ones(4, 4), [5, 2])
    with pytest.raises(TypeError, match="field must be a tensor"):
        zero_pad([[1.0]])
    with pytest.raises(TypeError, match="image_field must be a real tensor"):
        quantize(torch.ones(2, dtype=torch.complex64))
    for wrong in ({"bits": 31}, {"bits": 0}, {"limits": (1.0, 1.0)}):
        with pytest.raises(ValueError, match="must be"):
            quantize(torch.ones(2), **wrong)
