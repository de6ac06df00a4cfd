"""Visible differences by eccentricity, colour and masking; samples for each ring."""

import math

import pytest
import torch

from odak.learn.perception import (
    FLIP,
    PSNR,
    SSIM,
    CSFLoss,
    MetamericLossUniform,
    VisibilityLoss,
    csf,
    foveated_budget,
    highest_frequency,
    srgb_to_lab,
)

NARROW = {"real_image_width": 0.01, "real_viewing_distance": 1.0}


def test_contrast_at_the_highest_frequency_is_one():
    for eccentricity in (0.0, 4.0, 30.0):
        frequency = float(highest_frequency(eccentricity))
        assert math.exp(0.106 * frequency * (eccentricity + 2.3) / 2.3) / 64 == pytest.approx(1)


def test_highest_frequency_needs_no_values_of_device_without_any():
    assert highest_frequency(torch.empty(3, 2, device="meta")).shape == (3, 2)
    with pytest.raises(ValueError, match="eccentricity"):
        highest_frequency(torch.tensor([1.0, -0.5]))


def test_pictures_of_integers_are_refused():
    picture = torch.zeros(1, 3, 32, 32, dtype=torch.uint8)
    with pytest.raises(TypeError, match=r"image must be .* real floats.*uint8"):
        VisibilityLoss()(picture, picture)


def test_budget_is_the_integral_of_the_density():
    # 2π·∫ e·(2f)² de from 0 to E, for angles small enough to be lengths.
    rings = foveated_budget((900, 900), real_image_width=0.1, real_viewing_distance=0.7, edges=(0.0, 1.0, 3.5))
    scale = (2 * 2.3 * math.log(64) / 0.106) ** 2

    def integral(e):
        return 2 * math.pi * scale * (math.log((e + 2.3) / 2.3) + 2.3 / (e + 2.3) - 1)

    assert rings[0].samples == pytest.approx(integral(1.0), rel=0.01)
    assert rings[1].samples == pytest.approx(integral(3.5) - integral(1.0), rel=0.01)
    assert all(ring.samples <= ring.pixels for ring in rings)
    coarse = foveated_budget((50, 50), real_image_width=0.1, real_viewing_distance=0.7, edges=(0.0, 1.0))
    assert coarse[0].samples == coarse[0].pixels


def grating(cycles, amplitude, size=64):
    line = torch.arange(size, dtype=torch.float64)
    return amplitude * torch.cos(2 * math.pi * cycles / size * line).expand(1, 1, size, size)


@pytest.mark.parametrize("cycles", [16, 8, 4])
def test_losses_of_gratings_follow_the_contrast_sensitivity(cycles, monkeypatch):
    target = torch.full((1, 1, 64, 64), 0.5, dtype=torch.float64)
    # An eye that sees as sharply everywhere as at the gaze.
    monkeypatch.setattr(csf, "HALVING", 1e9)
    view = {"real_image_width": 0.05, "real_viewing_distance": 1.0}
    found = VisibilityLoss(**view, masking=0.0)(target + grating(cycles, 1e-3), target)
    expected = CSFLoss(**view)(target + grating(cycles, 1e-3), target)
    assert float(found) == pytest.approx(float(expected), rel=0.1)


def test_detail_has_smaller_loss_away_from_gaze_and_on_mask():
    wide = VisibilityLoss(real_image_width=0.1, real_viewing_distance=0.7)
    flat = torch.full((1, 1, 64, 64), 0.5, dtype=torch.float64)
    error = torch.zeros_like(flat)
    error[..., 28:36, 28:36] = grating(16, 0.02)[..., 28:36, 28:36]
    at, beside, away = (float(wide(flat + error, flat, gaze)) for gaze in ((0.5, 0.5), (-0.2, 0.5), (-2.0, 0.5)))
    assert at > 2 * beside > 4 * away > 0
    masked = flat + grating(16, 0.2)
    with_mask, without = (
        float(VisibilityLoss(0.1, 0.7, masking=slope)(masked + error, masked)) for slope in (0.6, 0.0)
    )
    assert with_mask < 0.5 * without


def test_a_uniform_just_noticeable_colour_is_one_threshold():
    target = torch.full((1, 3, 32, 32), 0.5, dtype=torch.float64)
    image = target + torch.tensor([0.004, -0.0013, 0.0], dtype=torch.float64)[:, None, None]
    one, two = srgb_to_lab(image)[0, 1:, 0, 0], srgb_to_lab(target)[0, 1:, 0, 0]
    loss = VisibilityLoss(**NARROW, masking=0.0)
    grey = VisibilityLoss(**NARROW, masking=0.0, colour=0.0)
    colour = float(loss(image, target) - grey(image, target))
    assert colour == pytest.approx(2 * float(((one - two) / 2.3).square().sum()), rel=0.02)
    assert float(loss(target, target)) == 0


def test_gradients():
    target = torch.rand(1, 3, 16, 16, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 0.8 + 0.1
    image = (target + 0.05 * torch.rand_like(target)).requires_grad_()
    loss = VisibilityLoss(n_levels=3)
    assert torch.autograd.gradcheck(lambda one: loss(one, target, (0.2, 0.3)), image, fast_mode=True, rtol=1e-2)


@pytest.mark.parametrize("kind", [CSFLoss, VisibilityLoss])
@pytest.mark.parametrize("name", ["real_image_width", "real_viewing_distance"])
def test_a_viewer_who_moves_is_as_if_there_from_the_start(kind, name):
    image, target = torch.rand(2, 1, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    moved, there = kind(**NARROW), kind(**{**NARROW, name: 0.4})
    before = moved(image, target)
    setattr(moved, name, 0.4)
    assert moved(image, target) == there(image, target) != before


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_losses_of_half_precision_are_those_of_single(dtype):
    generator = torch.Generator().manual_seed(0)
    image, target = (torch.rand(1, 3, 33, 48, generator=generator).to(dtype) for _ in range(2))
    statistics = MetamericLossUniform(pooling_size=8, n_pyramid_levels=2)
    for loss in (CSFLoss(**NARROW), VisibilityLoss(**NARROW), SSIM(), FLIP(), PSNR(), statistics):
        given = image.clone().requires_grad_()
        found = loss(given, target)
        assert found.dtype == torch.float32
        assert torch.equal(found, loss(image.float(), target.float()))
        assert torch.autograd.grad(found, given)[0].isfinite().all()
