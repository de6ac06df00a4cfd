import numpy as np
import pytest
import torch
from scipy import signal

from odak.learn.tools import blur_gaussian, crop_center, generate_2d_gaussian, quantize, zero_pad


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
    assert torch.autograd.gradcheck(lambda f: zero_pad(f, [6, 7]), field, fast_mode=True)
    assert torch.autograd.gradcheck(lambda f: crop_center(f, [2, 3]), field, fast_mode=True)
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


def test_gaussian_kernel():
    worked = torch.tensor([[0.016775, 0.05167, 0.016775], [0.05167, 0.159155, 0.05167], [0.016775, 0.05167, 0.016775]])
    torch.testing.assert_close(generate_2d_gaussian([3, 3], [1, 1]), worked, atol=1e-6, rtol=0)
    # Samples L/(L − 1) apart: the density's Riemann sum is one.
    kernel = generate_2d_gaussian([41, 61], [3, 4], mu=[2, -5], dtype=torch.float64)
    assert kernel.shape == (41, 61)
    assert kernel.sum().item() * (41 / 40) * (61 / 60) == pytest.approx(1, abs=1e-6)
    x, y = torch.linspace(-20.5, 20.5, 41, dtype=torch.float64), torch.linspace(-30.5, 30.5, 61, dtype=torch.float64)
    assert ((kernel.sum(1) * x).sum() / kernel.sum()).item() == pytest.approx(2, abs=1e-6)
    assert ((kernel.sum(0) * y).sum() / kernel.sum()).item() == pytest.approx(-5, abs=1e-6)
    assert generate_2d_gaussian([4, 4], [1, 1], normalize=True).max() == 1
    # σ = 0 is a single sample, or the four about the centre.
    assert generate_2d_gaussian([5, 5], [0, 0], normalize=True).sum() == 1
    assert generate_2d_gaussian([4, 4], [0, 0], normalize=True).sum() == 4
    assert generate_2d_gaussian([1, 1], [2, 2], normalize=True).item() == 1


@pytest.mark.parametrize("lengths", [(5, 3), (4, 6)])
def test_gaussian_blur_is_a_convolution(lengths):
    field = torch.rand(2, 3, 9, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    kernel = generate_2d_gaussian(lengths, [1, 2], dtype=torch.float64)
    full = np.stack([[signal.convolve2d(plane, kernel.numpy()) for plane in planes] for planes in field.numpy()])
    rows, columns = (length // 2 for length in lengths)
    same = full[..., rows : rows + 9, columns : columns + 8]
    blurred = blur_gaussian(field, lengths, [1, 2])
    np.testing.assert_allclose(blurred.numpy(), same, rtol=1e-12)
    valid = blur_gaussian(field, lengths, [1, 2], "valid")
    np.testing.assert_allclose(valid.numpy(), full[..., lengths[0] - 1 : 9, lengths[1] - 1 : 8], rtol=1e-12)
    padded = blur_gaussian(field, lengths, [1, 2], (lengths[0] - 1, lengths[1] - 1))
    np.testing.assert_allclose(padded.numpy(), full, rtol=1e-12)
    kept = blur_gaussian(field, lengths, [1, 2], keep_sum=True)
    np.testing.assert_allclose(kept.numpy(), same / kernel.sum().item(), rtol=1e-12)


def test_gaussian_blur_layouts_and_gradient():
    field = torch.rand(1, 1, 6, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(0), requires_grad=True)
    assert blur_gaussian(field, [3, 3]).shape == (6, 7)
    assert blur_gaussian(field[0], [3, 3]).shape == (1, 6, 7)
    assert blur_gaussian(field.float(), [3, 3]).dtype == torch.float32
    assert torch.autograd.gradcheck(lambda f: blur_gaussian(f, [3, 5], [1, 2]), field, fast_mode=True)
    # A kernel wider than the picture still fits, as there are zeros around.
    assert blur_gaussian(torch.ones(2, 2), [21, 21], keep_sum=True).shape == (2, 2)


def test_gaussians_refused():
    for wrong, message in (
        ({"kernel_length": [3]}, "kernel_length must be two"),
        ({"nsigma": [-1.0, 1.0]}, "nsigma must be two"),
        ({"mu": [0.0]}, "mu must be two"),
        ({"nsigma": [float("nan"), 1.0]}, "nsigma must be finite"),
    ):
        with pytest.raises(ValueError, match=message):
            generate_2d_gaussian(**wrong)
    for wrong, message in (
        ({"padding": "circular"}, "padding must be one of"),
        ({"padding": (1, 2, 3)}, "padding must be"),
        ({"padding": "valid"}, "at most the padded field's"),
    ):
        with pytest.raises(ValueError, match=message):
            blur_gaussian(torch.ones(4, 4), **wrong)
    with pytest.raises(TypeError, match="field must be a real floating tensor"):
        blur_gaussian(torch.ones(4, 4, dtype=torch.int32))


def test_what_is_cut_out_is_a_copy():
    field = torch.zeros(4, 4)
    cut = crop_center(field)
    cut += 1
    assert not field.any() and cut.is_contiguous()
