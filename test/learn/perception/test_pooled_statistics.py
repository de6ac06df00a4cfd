"""The fused distance between pooled statistics against the same written down plainly; its memory and its graph."""

import pytest
import torch

from odak.learn.perception import MetamericLoss, MetamericLossUniform, rgb_2_ycrcb
from odak.learn.perception.foveation import MipSampler, UniformSampler
from odak.learn.perception.pooled_statistics import (
    Pooling,
    as_maps,
    local_statistics,
    pooled,
    squared_distance,
)

VIEW = {"alpha": 0.5, "real_image_width": 0.5, "real_viewing_distance": 0.5, "n_pyramid_levels": 3}

FULL_RESOLUTION = {"use_l2_foveal_loss": False, "use_fullres_l0": True}


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def sampler(kind, rows, columns):
    if kind == "flat":
        return MipSampler(torch.zeros(rows, columns, dtype=torch.float64), torch.float64)
    if kind == "mip":
        return MipSampler(4 * noise(rows, columns, seed=7), torch.float64)
    return UniformSampler((rows, columns), (3, 4), torch.device("cpu"), torch.float64)


def plainly(bands, pool, mask, target):
    """Return the distance from maps ``[B, C, K, H, W]`` of means and deviations."""
    mean = pool.plainly(bands.flatten(1, 2)).reshape(bands.shape)
    power = pool.plainly((bands**2).flatten(1, 2)).reshape(bands.shape)
    deviation = (power - mean**2).clamp_min(1e-7).sqrt()
    mask = 1 if mask is None else mask
    return sum(((mask * found - wanted) ** 2).sum() for found, wanted in zip((mean, deviation), target, strict=True))


def laid_out(mean, deviation):
    return torch.stack([maps.permute(3, 0, 1, 2, 4).flatten(1, 3) for maps in (mean, deviation)], 1)


@pytest.mark.parametrize("kind", ["mip", "uniform", "flat"])
@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.parametrize(("rows", "columns"), [(12, 10), (9, 7)])
def test_against_plain_statistics(kind, masked, rows, columns):
    pool, bands = sampler(kind, rows, columns), noise(2, 2, 3, rows, columns).requires_grad_()
    mask = noise(rows, columns, seed=3) if masked else None
    target = [noise(2, 2, 3, rows, columns, seed=seed) for seed in (4, 5)]
    pooling, count = Pooling([pool], [mask]), bands[:, :, 0].numel()
    fused = squared_distance([bands], pooling, [laid_out(*target)]) * count
    plain = plainly(bands, pool, mask, target)
    torch.testing.assert_close(fused, plain)
    torch.testing.assert_close(*[torch.autograd.grad(value, bands)[0] for value in (fused, plain)])
    with torch.no_grad():
        assert float(squared_distance([bands], pooling, [laid_out(*target)]) * count) == pytest.approx(float(plain))
    statistics = local_statistics(bands, pool)
    torch.testing.assert_close(statistics, laid_out(*pooled(bands.detach(), pool)))
    for found, wanted in zip(as_maps(statistics, bands.shape)[2:4], pooled(bands.detach(), pool), strict=True):
        torch.testing.assert_close(found, wanted[:, :, 1])


def test_nearly_flat_bands_have_no_derivative_of_their_deviation():
    pool, bands = sampler("mip", 8, 8), 0.3 + 1e-5 * noise(1, 1, 1, 8, 8).requires_grad_()
    mean, _ = pooled(bands.detach(), pool)
    target = laid_out(mean, torch.ones_like(mean))
    (gradient,) = torch.autograd.grad(squared_distance([bands], Pooling([pool], [None]), [target]), bands)
    torch.testing.assert_close(gradient, torch.zeros_like(bands), rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", ["mip", "uniform"])
def test_gradients_of_gradients(kind):
    pool, bands = sampler(kind, 6, 6), noise(1, 1, 2, 6, 6).requires_grad_()
    mask, target = noise(6, 6, seed=3), laid_out(*(noise(1, 1, 2, 6, 6, seed=seed) for seed in (4, 5)))

    def distance(values):
        return squared_distance([values, 2 * values], Pooling([pool] * 2, [mask, None]), [target] * 2)

    assert torch.autograd.gradcheck(distance, bands, fast_mode=True)
    assert torch.autograd.gradgradcheck(distance, bands, fast_mode=True)


@pytest.mark.parametrize("options", [{}, {"use_l2_foveal_loss": False}, FULL_RESOLUTION])
def test_losses_agree_with_their_statistics(options):
    """The loss never holds the maps that calc_statsmaps returns, and yet is their distance."""
    image, target = noise(2, 3, 32, 48).requires_grad_(), noise(2, 3, 32, 48, seed=1)
    loss, gaze = MetamericLoss(**VIEW, **options), (0.3, 0.6)
    fused = loss(image, target, gaze)
    geometry = (0.5, 0.5, 0.5, "quadratic")
    maps = [loss.calc_statsmaps(rgb_2_ycrcb(picture), gaze, *geometry) for picture in (image, target)]
    assert len(maps[0]) == len(loss.target_stats)
    for one, two in zip(maps[1], loss.target_stats, strict=True):
        torch.testing.assert_close(one, two)
    plain = loss.metameric_loss_stats(*maps, gaze)
    if loss.use_l2_foveal_loss:
        fovea = loss.fovea_mask * (rgb_2_ycrcb(image) - rgb_2_ycrcb(target))
        plain = plain + 20 * (fovea**2).mean()
    torch.testing.assert_close(fused, plain)
    torch.testing.assert_close(*[torch.autograd.grad(value, image)[0] for value in (fused, plain)])


def test_uniform_loss_agrees_with_its_statistics():
    image, target = noise(2, 3, 32, 48).requires_grad_(), noise(2, 3, 32, 48, seed=1)
    loss = MetamericLossUniform(pooling_size=6, n_pyramid_levels=3)
    fused = loss(image, target)
    plain = loss.metameric_loss_stats(*(loss.calc_statsmaps(rgb_2_ycrcb(picture), 6) for picture in (image, target)))
    torch.testing.assert_close(fused, plain)
    torch.testing.assert_close(*[torch.autograd.grad(value, image)[0] for value in (fused, plain)])


def test_transforms_and_second_derivatives_of_the_loss():
    image, target = noise(1, 1, 16, 16), noise(1, 1, 16, 16, seed=1)
    loss = MetamericLoss(**VIEW)
    picture = image.clone().requires_grad_()
    loss(picture, target).backward()
    torch.testing.assert_close(torch.func.grad(lambda values: loss(values, target))(image), picture.grad)
    assert torch.autograd.gradgradcheck(lambda values: loss(values, target), picture, fast_mode=True)
