import numpy as np
import pytest
import torch
from scipy.ndimage import correlate1d

from odak.cli import report as metrics
from odak.learn.wave.training import best_scale


def test_psnr_of_a_constant_error():
    target = torch.full((16, 16), 0.5)
    assert metrics.psnr(target + 0.1, target) == pytest.approx(20, abs=1e-5)
    assert metrics.psnr(target, target) is None


def test_ssim_of_constant_images_is_the_luminance_term():
    first, second = torch.full((12, 15), 0.2), torch.full((12, 15), 0.7)
    expected = (2 * 0.2 * 0.7 + 1e-4) / (0.2**2 + 0.7**2 + 1e-4)
    assert metrics.ssim(first, second) == pytest.approx(expected, rel=1e-6)


def test_ssim_against_another_implementation():
    rng = np.random.default_rng(1)
    x = rng.random((40, 31))
    y = np.clip(x + 0.2 * rng.standard_normal(x.shape), 0, 1)
    taps = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    taps /= taps.sum()

    def mean(a):
        return correlate1d(correlate1d(a, taps, axis=0), taps, axis=1)[5:-5, 5:-5]

    mx, my = mean(x), mean(y)
    vx, vy, cov = mean(x**2) - mx**2, mean(y**2) - my**2, mean(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    expected = np.mean((2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2)))
    assert metrics.ssim(torch.tensor(x), torch.tensor(y)) == pytest.approx(expected, rel=1e-12)


def test_ssim_of_an_image_with_itself_and_its_negative():
    image = torch.rand(3, 20, 20, generator=torch.Generator().manual_seed(0))
    assert metrics.ssim(image, image) == pytest.approx(1)
    assert metrics.ssim(image, 1 - image) < 0


def test_ssim_refuses_what_has_no_window():
    with pytest.raises(ValueError, match="11 x 11"):
        metrics.ssim(torch.rand(10, 20), torch.rand(10, 20))
    with pytest.raises(ValueError, match="shape"):
        metrics.ssim(torch.rand(20, 20), torch.rand(20, 21))


def test_best_scale_is_the_minimum_of_the_squared_error():
    generator = torch.Generator().manual_seed(2)
    image, target = (torch.rand(2, 9, 7, dtype=torch.float64, generator=generator) for _ in range(2))
    scale = best_scale(image, target)
    assert scale.shape == (2, 1, 1)
    errors = [((factor * scale * image - target) ** 2).sum((-2, -1)) for factor in (0.99, 1.0, 1.01)]
    assert torch.all(errors[1] < errors[0]) and torch.all(errors[1] < errors[2])
    assert torch.equal(best_scale(torch.zeros(4, 4), torch.ones(4, 4)), torch.zeros(1, 1))
