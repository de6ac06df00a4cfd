"""Statistics of pairs of bands, metamers and textures made from them, and the width of pooling regions."""

import math

import numpy as np
import pytest
import torch

from odak._warnings import ConvergenceWarning
from odak.learn.perception import (
    FrequencySteerablePyramid,
    MetamericLoss,
    MetamericLossUniform,
    MetamerMSELoss,
    RadiallyVaryingBlur,
    SpatialSteerablePyramid,
    make_pooling_size_map_pixels,
    metameric,
    synthesize_texture,
    texture_statistics,
    uniform_blur,
)
from odak.learn.perception.foveation import MipSampler, _level
from odak.learn.perception.joint_statistics import NEIGHBOURS, descended, joint_maps

VIEW = {"alpha": 0.5, "real_image_width": 0.5, "real_viewing_distance": 0.5}


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def kernel_deviation(pool, side):
    """Return the standard deviation of a pooling kernel along the columns, from its first and second moment."""
    x = torch.arange(side, dtype=torch.float64).expand(1, 1, side, side)
    middle = slice(side // 4, 3 * side // 4)
    first, second = (pool(x**power)[0, 0, middle, middle] for power in (1, 2))
    return float((second - first**2).mean().sqrt())


@pytest.mark.parametrize("size", [1.0, 1.7, 2.0, 3.0, 5.7, 8.0, 13.0, 23.0])
def test_nominal_width_is_the_second_moment_of_a_square(size):
    square = math.sqrt((size**2 - 1) / 12)
    wide, nominal = (
        kernel_deviation(
            MipSampler(_level(torch.full((256, 256), size, dtype=torch.float64), kind), torch.float64), 256
        )
        for kind in (False, True)
    )
    assert nominal == pytest.approx(square, rel=1e-9, abs=1e-9)
    assert size < 3 or 1.7 < wide / square < 2.1


def test_nominal_width_of_squares_of_one_size():
    for size in (12.0, 30.0):
        square = math.sqrt((size**2 - 1) / 12)
        wide, nominal = (
            kernel_deviation(lambda one, kind=kind, size=size: uniform_blur(one, size, kind), 240)
            for kind in (False, True)
        )
        assert nominal == pytest.approx(square, rel=0.08)
        assert 1.7 < wide / square < 1.8


def test_nominal_width_of_a_map_that_grows():
    size, gaze = (128, 128), (0.0, 0.5)
    pixels = make_pooling_size_map_pixels(gaze, size, 0.25, 0.5, 0.5, "linear", dtype=torch.float64)
    x = torch.arange(128, dtype=torch.float64).expand(1, 1, *size)
    spread = {}
    for kind in (False, True):
        blur = RadiallyVaryingBlur(nominal_width=kind)
        first, second = (blur.blur(x**power, 0.25, 0.5, 0.5, gaze, "linear") for power in (1, 2))
        spread[kind] = (second - first**2)[0, 0, 48:80, 48:80].mean().sqrt()
    square = ((pixels[48:80, 48:80] ** 2 - 1) / 12).mean().sqrt()
    assert float(spread[True] / square) == pytest.approx(1, rel=0.05)
    assert 1.6 < float(spread[False] / square) < 2.1


def grating(side, cycles, angle, phase=0.0):
    line = torch.arange(side, dtype=torch.float64)
    along = line * math.cos(angle) - line[:, None] * math.sin(angle)
    return torch.cos(2 * math.pi * cycles / side * along + phase)[None, None]


@pytest.mark.parametrize("count", [2, 3, 4])
def test_complex_bands_have_the_phase_of_a_grating(count):
    picture = grating(64, 16, 0.0, phase=0.3)
    exact = FrequencySteerablePyramid(3, count)
    band = exact.construct_pyramid(picture, quadrature=True)[0]["b"][0][0, 0]
    assert float(band.abs().std() / band.abs().mean()) < 1e-12
    steps = torch.angle(band[10, 11:20] / band[10, 10:19])
    torch.testing.assert_close(steps, torch.full_like(steps, 2 * math.pi * 16 / 64))
    real = exact.construct_pyramid(picture)[0]["b"][0][0, 0]
    assert torch.equal(real, band.real)
    back = exact.reconstruct_from_pyramid(exact.construct_pyramid(picture, quadrature=True))
    torch.testing.assert_close(back, picture)


@pytest.mark.parametrize(("size", "kind"), [(5, "cropped"), (9, "full")])
def test_quadrature_filters_give_amplitudes_along_orientations(size, kind):
    maker = SpatialSteerablePyramid(False, 1, size, 4, kind)
    for k in range(4):
        picture = grating(64, 13.0, math.pi * k / 4)
        groups, low = maker.stacked_bands(picture, 2)
        band, other = groups[1][0, 0, k, 12:-12, 12:-12], maker.quadrature(low[0])[0, 0, k, 12:-12, 12:-12]
        amplitude = torch.hypot(band, other)
        assert float(amplitude.std() / amplitude.mean()) < 0.04
        phases = torch.angle(torch.complex(band, other))
        expected = torch.angle(torch.complex(picture, grating(64, 13.0, math.pi * k / 4, -math.pi / 2)))
        lead = torch.angle(torch.exp(1j * (phases - expected[0, 0, 12:-12, 12:-12])))
        assert float((lead - lead.mean()).abs().max()) < 0.1


def test_pairs_are_covariances_by_numpy():
    picture = noise(1, 3, 32, 32)
    maker = SpatialSteerablePyramid(False, 3, 5, 2, "cropped")
    groups, low = maker.stacked_bands(picture, 3)
    fine, coarse = joint_maps(groups[1:], low, [lambda x: x.mean((-2, -1), keepdim=True)] * 2, maker)
    channels, orientations, scales, phases, neighbours = (one[0, :, 0, 0].numpy() for one in fine)
    assert [len(one) for one in (channels, orientations, scales, phases, neighbours)] == [6, 1, 2, 4, 12]
    assert len(coarse) == 3
    bands = groups[1][0].numpy()

    def expected(one, two):
        matrix = np.cov(one.ravel(), two.ravel(), bias=True)
        return matrix[0, 1] / (matrix[0, 0] * matrix[1, 1]) ** 0.25

    np.testing.assert_allclose(channels[0], expected(bands[0, 0], bands[1, 0]), rtol=1e-9)
    np.testing.assert_allclose(channels[5], expected(bands[1, 1], bands[2, 1]), rtol=1e-9)
    moduli = [
        np.abs(g[0, 0].numpy() + 1j * maker.quadrature(level[:, :1])[0, 0].numpy())
        for g, level in zip(groups[1:], low, strict=False)
    ]
    np.testing.assert_allclose(orientations[0], expected(*moduli[0]), rtol=1e-3)
    down = np.vstack([moduli[0][0][1:], moduli[0][0][-1:]])
    upward = np.sqrt(np.mean((moduli[0][0] - np.vstack([moduli[0][0][:1], moduli[0][0][:-1]])) ** 2))
    assert NEIGHBOURS[1] == (1, 0)
    np.testing.assert_allclose(neighbours[3], upward, rtol=1e-3)
    np.testing.assert_allclose(upward, np.sqrt(np.mean((moduli[0][0] - down) ** 2)), rtol=1e-9)


def test_pair_statistics_tell_an_edge_from_noise_of_its_spectrum():
    picture = torch.zeros(1, 1, 64, 64, dtype=torch.float64)
    picture[..., 20:44, 12:50] = 1
    spectrum = torch.fft.fft2(picture)
    phases = torch.fft.fft2(noise(1, 1, 64, 64, seed=2))
    scrambled = torch.fft.ifft2(spectrum.abs() * phases / phases.abs()).real
    found, of_noise = (texture_statistics(one, 4, 4) for one in (picture, scrambled))
    assert float((found["bands"] - of_noise["bands"]).abs().max()) < 0.05
    marginal, pairs = (float((found[name] - of_noise[name]).abs().max()) for name in ("bands", "pairs"))
    assert pairs > 3 * marginal


@pytest.mark.parametrize("kind", ["foveated", "uniform"])
def test_the_loss_of_pairs_in_strips_is_that_of_whole_maps(kind):
    options = {"n_pyramid_levels": 3, "joint": True}
    loss = (
        MetamericLoss(**VIEW, **options, use_l2_foveal_loss=False)
        if kind == "foveated"
        else MetamericLossUniform(pooling_size=6, **options)
    )
    image, target = noise(1, 3, 32, 32), noise(1, 3, 32, 32, seed=1)
    assert float(loss(image, image)) == 0
    in_strips = loss(image, target)
    whole = loss(image, target, visualise_loss=True)
    torch.testing.assert_close(in_strips, whole)
    loss.joint = False
    assert float(loss(image, target)) != float(whole)


def test_pairs_in_strips_are_those_of_plain_operations():
    pictures = noise(2, 3, 24, 32)
    pictures[:, :, :10, :12] = 0.4  # without variance
    maker = SpatialSteerablePyramid(False, 3, 5, 3, "cropped")
    level = torch.linspace(0, 3, 24, dtype=torch.float64)[:, None].expand(24, 32)
    pools = [MipSampler(level[:: 2**step, :: 2**step] / (step + 1), torch.float64) for step in range(2)]
    found, gradients = [], []
    for chosen in (pools, [pool.plainly for pool in pools]):
        given = pictures.clone().requires_grad_()
        groups, low = maker.stacked_bands(given, 3)
        found.append([one for maps in joint_maps(groups[1:], low, chosen, maker) for one in maps])
        weights = [noise(*one.shape, seed=index) for index, one in enumerate(found[-1])]
        total = sum((one * weight).sum() for one, weight in zip(found[-1], weights, strict=True))
        gradients.append(torch.autograd.grad(total, given)[0])
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other)
    torch.testing.assert_close(*gradients, rtol=1e-6, atol=1e-8)


def test_the_descent_finds_the_least_squares_solution():
    # Steep along low frequencies, as the distances between pyramids are: four times as much at each octave down.
    target = noise(1, 1, 32, 48, seed=6)
    frequency = torch.hypot(torch.fft.fftfreq(32, dtype=torch.float64)[:, None], torch.fft.rfftfreq(48).double())
    steep = frequency.clamp_min(0.02) ** -2

    def distance(picture):
        return (torch.fft.rfft2(picture - target).abs().square() * steep).mean()

    made = descended(torch.zeros_like(target), lambda picture: picture, distance, 40, None)
    assert float(distance(made)) < 1e-6 * float(distance(torch.zeros_like(target)))
    assert float((made - target).abs().max()) < 0.02


def test_gradients_of_the_loss_of_pairs():
    loss = MetamericLoss(**VIEW, n_pyramid_levels=2, joint=True, use_l2_foveal_loss=False)
    image, target = noise(1, 1, 16, 16).requires_grad_(), noise(1, 1, 16, 16, seed=1)
    assert torch.autograd.gradcheck(lambda one: loss(one, target, [0.2, 0.4]), image, fast_mode=True)
    assert torch.autograd.gradgradcheck(lambda one: loss(one, target, [0.2, 0.4]), image, fast_mode=True)


def edge_picture():
    row, column = torch.meshgrid(torch.arange(64.0), torch.arange(64.0), indexing="ij")
    picture = 0.3 + 0.4 * (((row - 32) ** 2 + (column - 30) ** 2) < 18**2) + 0.02 * noise(64, 64, seed=4)
    return picture.float()[None, None]


def coherence(picture):
    """Return how much the gradients around each pixel point one way, by the structure tensor; over strong gradients."""
    down, right = (picture[0, 0].double().diff(dim=axis)[:63, :63] for axis in (0, 1))
    window = torch.nn.AvgPool2d(5, 1)
    xx, yy, xy = (window(one[None, None])[0, 0] for one in (right**2, down**2, right * down))
    trace = xx + yy
    aligned = torch.hypot(xx - yy, 2 * xy) / trace.clamp_min(1e-12)
    return float((aligned * trace).sum() / trace.sum())


def test_metamers_of_pairs_are_closer_with_single_bands_first(monkeypatch):
    picture = edge_picture()[..., 8:56, 8:56]
    options = {"n_pyramid_levels": 3, "n_orientations": 4, "joint": True}
    maker = MetamerMSELoss(**VIEW, **options)
    loss = MetamericLoss(**VIEW, **options, use_l2_foveal_loss=False)
    calls = []

    def distance():
        made = maker.gen_metamer(picture, (0.0, 0.5), iterations=8, progress=lambda: calls.append(1))
        return float(loss(made, picture, (0.0, 0.5)))

    in_stages = distance()
    assert len(calls) == sum(count for _, count in metameric.metamer_stages(8, True)) == 18
    monkeypatch.setattr(metameric, "metamer_stages", lambda iterations, joint: [(joint, iterations)])
    assert in_stages < distance()
    assert len(calls) == 18 + 8


@pytest.mark.slow
def test_metamers_keep_edges_that_short_displacements_fray():
    picture = edge_picture()
    view = {"alpha": 1.0, "real_image_width": 1.0, "real_viewing_distance": 0.7}

    def missing(joint, earlier):
        maker = MetamerMSELoss(**view, n_pyramid_levels=4, n_orientations=4, joint=joint)
        made = [
            maker._drawn(maker.metameric_loss, earlier, picture, (-0.3, 0.5), seed=seed, iterations=80)
            for seed in range(3)
        ]
        return coherence(picture) - sum(map(coherence, made)) / len(made)

    earlier = missing(False, True)
    assert 0 < missing(True, True) < 0.75 * earlier
    for joint in (False, True):
        assert 0 < missing(joint, False) < 0.75 * earlier


# Forty evaluations are enough for what is asked of it here, and fewer than it takes to converge.
@pytest.mark.filterwarnings("ignore::odak.ConvergenceWarning")
@pytest.mark.slow
def test_texture_has_moments_of_details_it_was_not_made_from():
    centres = 96 * noise(60, 2, seed=5)
    line = torch.arange(96.0)
    sample = torch.zeros(96, 96)
    for y, x in centres.float():
        sample = sample.maximum((((line[:, None] - y) ** 2 + (line - x) ** 2) < 16).float())
    sample = sample[None, None] * 0.8 + 0.1
    made = synthesize_texture(sample, (64, 64), n_pyramid_levels=3, n_orientations=2, iterations=40)
    start = synthesize_texture(sample, (64, 64), n_pyramid_levels=3, n_orientations=2, iterations=0)
    assert made.shape == (1, 1, 64, 64)
    assert 0.099 < float(made.min()) < float(made.max()) < 0.901

    def details(picture):
        # Differences of 4 x 4 means: kurtosis, and the correlation of their squares with those of 2 x 2 means.
        coarse = torch.nn.functional.avg_pool2d(picture, 4)[0, 0].diff(dim=1)
        return float((coarse**4).mean() / (coarse**2).mean() ** 2), float((picture > 0.7).float().mean())

    (kurtosis, bright), (k_made, b_made), (k_start, b_start) = (details(one) for one in (sample, made, start))
    assert abs(b_made - bright) < 0.05 < abs(b_start - bright)
    assert abs(k_made - kurtosis) < max(0.5 * abs(k_start - kurtosis), 0.6)


def test_grey_single_orientation_has_no_pairs_at_the_last_level():
    picture, other = noise(1, 1, 65, 65), noise(1, 1, 65, 65, seed=1)
    # High-pass residual and four bands, the mean and the deviation of each.
    assert texture_statistics(picture, n_orientations=1)["bands"].shape == (1, 10)
    loss = MetamericLoss(n_orientations=1, joint=True, real_image_width=0.6)
    assert loss(picture, picture).item() == 0 < loss(picture, other).item()


def test_wrong_arguments():
    with pytest.raises(ValueError, match="multiples of 32"):
        synthesize_texture(noise(1, 1, 64, 64), (40, 64))
    with pytest.warns(ConvergenceWarning, match="not converged after 3 evaluations: the statistics differ by .* %"):
        synthesize_texture(noise(1, 1, 64, 64), (32, 64), n_pyramid_levels=2, iterations=3)
    with pytest.raises(ValueError, match=r"size must have sides above 64 for 5 levels, got \(64, 96\)"):
        synthesize_texture(noise(1, 1, 96, 96), (64, 96))
    with pytest.raises(ValueError, match="sample must have sides above 64"):
        synthesize_texture(noise(1, 1, 64, 96), (96, 96))
    with pytest.raises(ValueError, match=r"picture must have sides above 64 for 5 levels, got \(96, 64\)"):
        texture_statistics(noise(1, 1, 96, 64))
    with pytest.raises(ValueError, match="1 or 3, H, W"):
        texture_statistics(noise(1, 2, 64, 64))
    with pytest.raises(TypeError, match="joint"):
        MetamericLoss(joint="yes")
