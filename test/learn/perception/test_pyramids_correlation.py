"""Correlation in lanes against conv2d on mirrored pictures; its adjoint by inner products and by autograd."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional

from odak.learn.perception.pyramids import correlate


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def plainly(image, taps, stride):
    padded = functional.pad(image, (taps.shape[-1] // 2,) * 4, mode="reflect")
    return functional.conv2d(padded.flatten(0, 1)[:, None], taps[:, None], stride=stride).unflatten(0, image.shape[:2])


@settings(max_examples=40)
@given(
    rows=st.integers(7, 40),
    columns=st.integers(7, 40),
    side=st.sampled_from([1, 3, 5, 13]),
    count=st.integers(1, 3),
    stride=st.sampled_from([1, 2]),
)
def test_against_conv2d(rows, columns, side, count, stride):
    image, taps = noise(2, 3, rows, columns).requires_grad_(), noise(count, side, side, seed=1) - 0.5
    result, expected = correlate(image, taps, stride), plainly(image, taps, stride)
    torch.testing.assert_close(result, expected)
    outer = noise(*result.shape, seed=2)
    gradients = [torch.autograd.grad(value, image, outer)[0] for value in (result, expected)]
    torch.testing.assert_close(*gradients)


def test_memory_is_laid_out_by_rows():
    result = correlate(noise(2, 3, 20, 30), noise(2, 5, 5))
    assert result.shape == (2, 3, 2, 20, 30)
    assert result.permute(3, 0, 1, 2, 4).is_contiguous()


@pytest.mark.parametrize("stride", [1, 2])
def test_derivatives_of_every_order(stride):
    image, taps = noise(1, 2, 9, 11).requires_grad_(), noise(2, 3, 3, seed=1) - 0.5
    assert torch.autograd.gradcheck(lambda picture: correlate(picture, taps, stride), image, fast_mode=True)
    assert torch.autograd.gradgradcheck(lambda picture: correlate(picture, taps, stride) ** 2, image, fast_mode=True)


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")
def test_single_precision_and_transforms():
    image, taps = noise(1, 3, 40, 50), noise(1, 5, 5, seed=1) - 0.5
    single = correlate(image.float(), taps.float())
    assert single.dtype == torch.float32
    torch.testing.assert_close(single.double(), correlate(image, taps), rtol=0, atol=1e-5)

    def energy(picture):
        return (correlate(picture, taps) ** 2).sum()

    slope = torch.func.grad(energy)(image)
    picture = image.clone().requires_grad_()
    energy(picture).backward()
    torch.testing.assert_close(slope, picture.grad)
    direction = noise(*image.shape, seed=3)
    _, along = torch.func.jvp(energy, (image,), (direction,))
    torch.testing.assert_close(along, (slope * direction).sum())
    learnt = taps.clone().requires_grad_()
    correlate(image, learnt).sum().backward()
    assert learnt.grad.abs().max() > 0
