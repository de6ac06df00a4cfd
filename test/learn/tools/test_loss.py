"""Losses and contrasts of images against closed forms."""

import math

import numpy as np
import pytest
import torch

from odak.learn import tools

RAMP = torch.arange(4.0, dtype=torch.float64)[:, None] * 2 + torch.arange(6.0, dtype=torch.float64) * 3
LAYOUTS = [(4, 6), (3, 4, 6), (2, 3, 4, 6)]


def noise(*shape, seed=0):
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("shape", LAYOUTS)
def test_total_variation_of_a_ramp(shape):
    """4 rows × 5 steps of 3 along columns, 3 × 6 steps of 2 along rows, over 24 samples."""
    frame = RAMP.expand(shape)
    assert tools.total_variation_loss(frame).item() == pytest.approx((4 * 5 * 9 + 3 * 6 * 4) / 24, rel=1e-14)
    across, down = tools.spatial_gradient(frame)
    assert across.shape == (*(1,) * (4 - len(shape)), *shape[:-1], 5)
    assert down.shape == (*(1,) * (4 - len(shape)), *shape[:-2], 3, 6)
    assert (across == 3).all()
    assert (down == 2).all()


def test_total_variation_of_two_scales():
    """Every second sample of the ramp is a ramp of twice the slope: 2 × 2 steps of 6, 1 × 3 of 4, over 6 samples."""
    smaller = (2 * 2 * 36 + 3 * 16) / 6
    loss = tools.multi_scale_total_variation_loss(RAMP, 2) - tools.total_variation_loss(RAMP)
    assert loss.item() == pytest.approx(smaller, rel=1e-14)
    worked = torch.arange(16.0).reshape(4, 4)
    assert tools.multi_scale_total_variation_loss(worked, 2).item() == pytest.approx(46.75)
    # An odd side loses its last sample, as a halved image does.
    odd = noise(5, 7)
    halved = tools.total_variation_loss(odd) + tools.total_variation_loss(odd[:4:2, :6:2])
    torch.testing.assert_close(tools.multi_scale_total_variation_loss(odd, 2), halved)


def test_radial_basis_function():
    values = torch.tensor([0.0, 1.0, -2.0], dtype=torch.float64)
    expected = torch.tensor([1.0, math.exp(-0.25), math.exp(-1.0)], dtype=torch.float64)
    torch.testing.assert_close(tools.radial_basis_function(values), expected)


def test_histograms_are_numpys():
    frame, other = noise(2, 3, 8, 9) * 1.4 - 0.2, noise(2, 3, 8, 9, seed=1)
    frame[0, 0, 0, 0] = 1.0
    counts = [
        np.stack([np.histogram(image[:, c].numpy(), 7, (0.0, 1.0))[0] for c in range(3)]) for image in (frame, other)
    ]
    expected = ((counts[0] - counts[1]) ** 2).mean()
    assert tools.histogram_loss(frame, other, bins=7).item() == pytest.approx(expected, rel=1e-14)
    worked = torch.tensor([[0.0, 0.1], [0.6, 0.9]]), torch.tensor([[0.0, 0.6], [0.6, 0.9]])
    assert tools.histogram_loss(*worked, bins=2).item() == 1.0
    strange = torch.tensor([[0.5, math.nan, math.inf, -math.inf]])
    assert tools.histogram_loss(strange, torch.tensor([[0.5, 2.0, 2.0, 2.0]]), bins=3).item() == 0.0


def test_a_soft_histogram_shares_values_between_centres():
    """A value at 0.3 of the way from one bin's centre to the next counts 0.7 and 0.3."""
    frame = torch.tensor([[1.3]], dtype=torch.float64, requires_grad=True)
    nothing = torch.tensor([[-1.0]], dtype=torch.float64)
    # Bins of width 1 over 0 … 4 have centres 0.5, 1.5 …: 1.3 is 0.8 of the way from the first to the second.
    loss = tools.histogram_loss(frame, nothing, bins=4, limits=(0, 4), soft=True)
    assert loss.item() == pytest.approx((0.2**2 + 0.8**2) / 4, rel=1e-12)
    values = (noise(2, 3, 3) * 1.2 - 0.1).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda v: tools.histogram_loss(v, noise(2, 3, 3, seed=5), 5, soft=True), values, fast_mode=True
    )


@pytest.mark.parametrize("shape", LAYOUTS)
def test_contrasts(shape):
    image = torch.ones(shape, dtype=torch.float64)
    image[..., :2, 1:3], image[..., 3:, :] = 0.8, 0.2
    high, low = [0, 2, 1, 3], [3, 4, 0, 6]
    result = (2, 3) if len(shape) == 4 else shape[:-2] or (1,)
    for contrast, expected in ((tools.weber_contrast, 3.0), (tools.michelson_contrast, 0.6)):
        values = contrast(image, high, low)
        assert values.shape == result
        torch.testing.assert_close(values, torch.full(result, expected, dtype=torch.float64))
    assert tools.weber_contrast(torch.ones(2, 2) * torch.tensor([1.0, 0.0]), [0, 2, 0, 1], [0, 2, 1, 2]).isinf().all()


def test_angles_wrap():
    a, b = noise(5, 6) * 20 - 10, noise(5, 6, seed=1) * 20
    expected = (a.sin() - b.sin()) ** 2 + (a.cos() - b.cos()) ** 2
    torch.testing.assert_close(tools.wrapped_mean_squared_error(a, b), expected.mean())
    torch.testing.assert_close(tools.wrapped_mean_squared_error(a, b, "sum"), expected.sum())
    assert tools.wrapped_mean_squared_error(a, a + 4 * torch.pi).item() < 1e-28
    # Angles closer than the square root of the precision still differ.
    small = torch.tensor([1e-5], dtype=torch.float32)
    assert tools.wrapped_mean_squared_error(small, 0 * small).item() == pytest.approx(1e-10, rel=1e-5)


def test_psnr():
    image = noise(3, 4, 5)
    assert tools.psnr(image, image + 0.1).item() == pytest.approx(20.0, abs=1e-9)
    assert tools.psnr(image, image + 0.1, peak_value=10).item() == pytest.approx(40.0, abs=1e-9)
    assert tools.psnr(image, image).item() == math.inf
    levels = torch.tensor([0, 255], dtype=torch.uint8)
    assert tools.psnr(levels, levels.flip(0), 255).item() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    "loss",
    [
        tools.total_variation_loss,
        lambda v: tools.multi_scale_total_variation_loss(v, 2),
        tools.spatial_gradient,
        tools.radial_basis_function,
        lambda v: tools.weber_contrast(v, [0, 2, 0, 2], [2, 4, 1, 3]),
        lambda v: tools.michelson_contrast(v, [0, 2, 0, 2], [2, 4, 1, 3]),
        lambda v: tools.wrapped_mean_squared_error(v, noise(2, 4, 4, seed=3)),
        lambda v: tools.psnr(v, noise(2, 4, 4, seed=3)),
    ],
)
def test_gradients(loss):
    assert torch.autograd.gradcheck(loss, noise(2, 4, 4).requires_grad_(), fast_mode=True)


FRAME = torch.ones(4, 4)


@pytest.mark.parametrize(
    ("call", "kind", "message"),
    [
        (lambda: tools.total_variation_loss(torch.ones(3)), ValueError, r"frame must be \[H, W\]"),
        (lambda: tools.total_variation_loss(torch.ones(0, 3)), ValueError, "none empty"),
        (lambda: tools.spatial_gradient([[1.0]]), TypeError, "frame must be a real tensor, got list"),
        (lambda: tools.multi_scale_total_variation_loss(FRAME, 4), ValueError, "levels must leave a sample"),
        (lambda: tools.multi_scale_total_variation_loss(FRAME, 0), ValueError, "levels must be at least 1"),
        (lambda: tools.histogram_loss(FRAME, FRAME.expand(3, 4, 4)), ValueError, "as many channels, got 1 and 3"),
        (lambda: tools.histogram_loss(FRAME, FRAME, limits=(1.0, 0.0)), ValueError, "limits must be two rising"),
        (lambda: tools.histogram_loss(FRAME, FRAME, limits=(0.0, 1.0, 2.0)), ValueError, "limits must be two rising"),
        (lambda: tools.histogram_loss(FRAME, FRAME, bins=0), ValueError, "bins must be at least 1"),
        (lambda: tools.weber_contrast(FRAME, [0, 2, 0], [0, 1, 0, 1]), ValueError, "roi_high must be"),
        (lambda: tools.michelson_contrast(FRAME, [0, 1, 0, 1], [0, 5, 0, 1]), ValueError, "roi_low must lie inside"),
        (lambda: tools.michelson_contrast(FRAME, [0, 1, 0, 1], [2, 2, 0, 1]), ValueError, "not be empty"),
        (
            lambda: tools.wrapped_mean_squared_error(FRAME, FRAME[:2]),
            ValueError,
            "and ground_truth must have the same",
        ),
        (lambda: tools.psnr(FRAME, FRAME[:1]), ValueError, "same shape"),
        (lambda: tools.psnr(FRAME, FRAME, 0), ValueError, "peak_value must be positive"),
        (lambda: tools.circular_binary_mask(0, 4, 1), ValueError, "px must be at least 1"),
    ],
)
def test_refused(call, kind, message):
    with pytest.raises(kind, match=message):
        call()


def test_circular_mask():
    assert tools.circular_binary_mask(10, 10, 0).sum() == 0
    assert tools.circular_binary_mask(5, 5, 10).all()
    assert tools.circular_binary_mask(5, 5, np.asarray(2.0)).sum() == 9
    mask = tools.circular_binary_mask(5, 5, 2.0)
    assert mask.shape == (1, 1, 5, 5)
    assert mask.dtype == torch.float32
    expected = torch.zeros(5, 5)
    expected[1:4, 1:4] = 1
    assert torch.equal(mask[0, 0], expected)
    # Rows first, and an area of πr² in units of the axes' steps.
    large = tools.circular_binary_mask(200, 100, 20.0, offset_x=50.0)[0, 0]
    rows, columns = torch.nonzero(large, as_tuple=True)
    assert rows.double().mean().item() == pytest.approx((50 + 100) * 199 / 200, abs=0.1)
    assert columns.double().mean().item() == pytest.approx(49.5, abs=0.1)
    assert large.sum().item() == pytest.approx(math.pi * 400 * (199 / 200) * (99 / 100), rel=0.02)
    assert tools.circular_binary_mask(1, 1, 0.1).item() == 1


def test_wrapped_error_of_integers():
    angles, others = torch.tensor([3, 250, 7], dtype=torch.uint8), torch.tensor([5, 2, 7], dtype=torch.uint8)
    expected = tools.wrapped_mean_squared_error(angles.double(), others.double())
    torch.testing.assert_close(tools.wrapped_mean_squared_error(angles, others).double(), expected, rtol=1e-5, atol=0)
