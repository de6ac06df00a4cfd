"""The pyramid of Fourier masks: exact reconstruction, energies that add up, orientations."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn.perception import FrequencySteerablePyramid


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def coefficients(pyramid):
    return [pyramid[0]["h"], *[band for level in pyramid[:-1] for band in level["b"]], pyramid[-1]["l"]]


@settings(max_examples=40)
@given(st.integers(8, 50), st.integers(8, 50), st.integers(2, 4), st.integers(1, 7), st.integers(0, 99))
def test_reconstructs_exactly_and_keeps_the_energy(rows, columns, levels, count, seed):
    picture = noise(2, 3, rows, columns, seed=seed)
    maker = FrequencySteerablePyramid(levels, count)
    pyramid = maker.construct_pyramid(picture)
    assert (maker.reconstruct_from_pyramid(pyramid) - picture).abs().max() < 1e-13
    energy = sum((part**2).sum() for part in coefficients(pyramid))
    assert float(energy) == pytest.approx(float((picture**2).sum()), rel=1e-12)


def test_reconstruction_is_the_adjoint():
    maker = FrequencySteerablePyramid(3, 4)
    pyramid = maker.construct_pyramid(noise(1, 1, 20, 27) - 0.5)
    other = maker.construct_pyramid(noise(1, 1, 20, 27, seed=1))
    # Any coefficients, not only those of a picture.
    other[1]["b"][2] = noise(*other[1]["b"][2].shape, seed=2)
    picture = maker.reconstruct_from_pyramid(pyramid)
    one = sum((a * b).sum() for a, b in zip(coefficients(pyramid), coefficients(other), strict=True))
    two = (picture * maker.reconstruct_from_pyramid(other)).sum()
    assert float(one) == pytest.approx(float(two), rel=1e-12)


@pytest.mark.parametrize("count", [2, 3, 4, 6])
@pytest.mark.parametrize("turns", [(8, 0), (6, -6), (3, 8), (0, 8)])
def test_a_grating_lands_in_its_bands_as_a_power_of_the_cosine(count, turns):
    # Cycles over 64 pixels along x and, upwards, along y; level 1 passes all of r = π/4.
    y, x = torch.meshgrid(torch.arange(64.0).double(), torch.arange(64.0).double(), indexing="ij")
    grating = torch.cos(2 * math.pi / 64 * (turns[0] * x - turns[1] * y))
    pyramid = FrequencySteerablePyramid(4, count).construct_pyramid(grating[None, None])
    energy = torch.stack([sum((level["b"][k] ** 2).sum() for level in pyramid[:-1]) for k in range(count)])
    angle = math.atan2(turns[1], turns[0])
    weights = torch.tensor([math.cos(angle - math.pi * k / count) ** (2 * count - 2) for k in range(count)])
    torch.testing.assert_close(energy / energy.sum(), (weights / weights.sum()).double(), atol=1e-6, rtol=0)
    total = energy.sum() / (grating**2).sum()
    assert float(total) == pytest.approx(1, abs=1e-12)


def test_signs():
    ramp = torch.sin(2 * math.pi * torch.arange(32, dtype=torch.float64) / 32 * 4).expand(32, 32)
    pyramid = FrequencySteerablePyramid(3, 2).construct_pyramid(ramp[None, None])
    slope = torch.cos(2 * math.pi * torch.arange(32, dtype=torch.float64) / 32 * 4)
    assert float((pyramid[0]["b"][0][0, 0, 0] * slope).sum()) <= 0
    down = FrequencySteerablePyramid(3, 2).construct_pyramid(ramp.T[None, None])
    coarse = slope[::2]
    assert float((pyramid[1]["b"][0][0, 0, 5] * coarse).sum()) < -1
    assert float((down[1]["b"][1][0, 0, :, 5] * coarse).sum()) > 1


def test_sizes_precision_and_means():
    maker = FrequencySteerablePyramid(4, 3)
    pyramid = maker(torch.full((2, 1, 21, 40), 0.5))
    assert [tuple(level["b"][0].shape) for level in pyramid[:-1]] == [(2, 1, 21, 40), (2, 1, 11, 20), (2, 1, 6, 10)]
    assert pyramid[-1]["l"].shape == (2, 1, 3, 5)
    assert pyramid[-1]["l"].dtype == torch.float32
    torch.testing.assert_close(pyramid[-1]["l"], torch.full((2, 1, 3, 5), 0.5 * math.sqrt(21 * 40 / 15)))
    assert maker(noise(16, 16))[-1]["l"].dtype == torch.float64


def test_gradient():
    maker, picture = FrequencySteerablePyramid(2, 3), noise(1, 1, 5, 6).requires_grad_()
    with torch.inference_mode():
        maker(picture)
    assert torch.autograd.gradcheck(lambda image: coefficients(maker(image)), picture, fast_mode=True)
    assert torch.autograd.gradgradcheck(lambda image: maker(image)[0]["b"][1] ** 2, picture)
    pyramid = [{"h": noise(5, 6), "b": list(noise(3, 5, 6, seed=2).unbind())}, {"l": noise(3, 3)}]
    low = pyramid[-1]["l"].requires_grad_()
    assert torch.autograd.gradcheck(lambda _: maker.reconstruct_from_pyramid(pyramid), low, fast_mode=True)


def test_refused():
    maker = FrequencySteerablePyramid(4, 2)
    with pytest.raises(ValueError, match=r"\[..., 8 or more, 8 or more\], not empty, with 4 levels, got \[0, 16, 16\]"):
        FrequencySteerablePyramid(4).construct_pyramid(torch.rand(0, 16, 16))
    with pytest.raises(ValueError, match=r"\[..., 8 or more, 8 or more\]"):
        maker(noise(1, 1, 7, 20))
    with pytest.raises(ValueError, match="must have n_levels = 4 levels"):
        maker.reconstruct_from_pyramid(FrequencySteerablePyramid(3, 2)(noise(8, 8)))
