"""Metamers: displaced pictures, rescaled bands, local colours, and how near their statistics are."""

import math

import pytest
import torch

from odak._warnings import SamplingWarning
from odak.cli.job import image_path
from odak.learn.perception import (
    MetamericLoss,
    MetamericLossUniform,
    MetamerMSELoss,
    SpatialSteerablePyramid,
    make_pooling_size_map_lod,
    metamers,
    rgb_2_ycrcb,
)
from odak.learn.perception.foveation import UniformSampler
from odak.learn.perception.pooled_statistics import Pooling, statistics_maps
from odak.learn.tools import load_image

VIEW = {"alpha": 0.5, "real_image_width": 0.5, "real_viewing_distance": 0.5}


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(scope="module")
def photograph():
    picture = load_image(str(image_path("photo")), normalizeby=None).float().movedim(-1, 0)[None]
    return torch.nn.functional.interpolate(picture[..., :384, :512], (96, 128), mode="area")


def psnr(one, two):
    return -10 * math.log10(float(((one - two) ** 2).mean()))


def test_local_range_is_that_of_squares():
    picture, levels = noise(1, 2, 20, 24), torch.full((20, 24), 2.0, dtype=torch.float64)
    low, high = metamers.local_range(picture, levels)
    pooled = torch.nn.functional.max_pool2d(picture, 5, stride=1, padding=2)
    assert torch.equal(high, pooled)
    assert torch.equal(low, -torch.nn.functional.max_pool2d(-picture, 5, stride=1, padding=2))
    low, high = metamers.local_range(picture, levels / 2 - 0.5)
    nearest = torch.nn.functional.max_pool2d(picture, 3, stride=1, padding=1)
    torch.testing.assert_close(high, (picture + nearest) / 2)
    assert torch.equal(metamers.local_range(picture, 0 * levels)[0], picture)


@pytest.mark.slow
def test_metamers_beat_noise_and_keep_to_local_colours(photograph):
    """White noise of the same squared error is ten times as far by the statistics; no colour is outside its region."""
    view = {"alpha": 0.2, "real_image_width": 0.6, "real_viewing_distance": 0.7}
    maker, gaze = MetamerMSELoss(**view), [0.5, 0.5]
    raw = maker.gen_metamer(photograph, gaze)
    metamer = raw.clamp(0, 1)
    error = float(((metamer - photograph) ** 2).mean().sqrt())
    assert error > 0.01
    generator = torch.Generator().manual_seed(1)
    spoilt = photograph + error * torch.randn(photograph.shape, generator=generator)
    loss = MetamericLoss(**view, use_l2_foveal_loss=False)
    assert float(loss(metamer, photograph, gaze)) < 0.1 * float(loss(spoilt, photograph, gaze))
    levels = make_pooling_size_map_lod(gaze, photograph.shape[-2:], **view, dtype=torch.float64)
    shown, clipped = rgb_2_ycrcb(raw), ((raw < 1e-3) | (raw > 1 - 1e-3)).any(1, keepdim=True)
    low, high = metamers.local_range(rgb_2_ycrcb(photograph), levels)
    # The two matrices are inverse to each other to three digits; colours beyond RGB are clipped.
    assert ((shown > low - 1e-3) & (shown < high + 1e-3) | clipped).all()
    assert clipped.double().mean() < 0.2
    resolved = levels == 0
    assert resolved.any()
    torch.testing.assert_close(shown[..., resolved], rgb_2_ycrcb(photograph)[..., resolved], rtol=0, atol=1e-3)
    steps = []
    uniform = MetamericLossUniform(pooling_size=8, n_pyramid_levels=4)
    found = uniform.gen_metamer(photograph, iterations=20, progress=lambda: steps.append(1))
    assert 0 < len(steps) <= 25
    start = uniform.gen_metamer(photograph, iterations=0)
    assert float(uniform(found, photograph)) < 0.1 * float(uniform(start, photograph))


@pytest.mark.slow
def test_metamers_of_hard_edges_are_closer_than_noise():
    """Bars and sectors of black and white, nearly all of whose pixels are at the bounds of their region."""
    rows, columns = torch.meshgrid(torch.arange(96), torch.arange(160), indexing="ij")
    bars = ((columns + rows // 3) // 5 % 2 * (columns < 64) + rows // 7 % 2 * (columns >= 96)).float()[None, None]
    view = {"alpha": 0.2, "real_image_width": 0.6, "real_viewing_distance": 0.7}
    metamer = MetamerMSELoss(**view).gen_metamer(bars, [0.5, 0.5])
    error = (metamer - bars).square().mean().sqrt()
    assert error > 0.05
    spoilt = bars + error * torch.randn(bars.shape, generator=torch.Generator().manual_seed(1))
    loss = MetamericLoss(**view, use_l2_foveal_loss=False)
    assert float(loss(metamer, bars)) < 0.1 * float(loss(spoilt, bars))
    # With noise as the start these were two to four times closer than noise only.
    rows, columns = (torch.arange(160) - 79.5).expand(2, 160, 160)
    sectors = (torch.sin(16 * torch.atan2(rows.mT, columns)) > 0).float()[None, None]
    metamer = MetamerMSELoss(**view).gen_metamer(sectors, [0.0, 0.5])
    error = (metamer - sectors).square().mean().sqrt()
    assert error > 0.1
    spoilt = sectors + error * torch.randn(sectors.shape, generator=torch.Generator().manual_seed(1))
    assert float(loss(metamer, sectors, [0.0, 0.5])) < 0.07 * float(loss(spoilt, sectors, [0.0, 0.5]))


def test_displacements():
    """Pictures of the pixels' own coordinates show how far each was moved."""
    columns = torch.arange(384.0, dtype=torch.float64).expand(1, 1, 384, 384)
    coordinates, cell = torch.cat([columns, columns.mT], 1), 16
    for level, warp, deviation, steepest in (
        (0.0, metamers.WARP, 0.0, 0.0),
        (2.0, metamers.WARP, 0.16 * 3, 0.06),
        (6.0, metamers.WARP, 0.05 * 24, 0.15),
        (2.0, metamers.EARLIER_WARP, 0.16 * 3, 0.3),
        (6.0, metamers.EARLIER_WARP, 0.4 * 4, 1.0),
    ):
        levels = torch.full((384, 384), level, dtype=torch.float64)
        moved = metamers.displaced(coordinates, levels, cell, warp=warp) - coordinates
        inside = moved[..., cell:-cell, cell:-cell]
        torch.testing.assert_close(inside.std((-2, -1))[0], inside.new_full((2,), deviation), rtol=0.2, atol=1e-9)
        # Lines turn by a small angle only.
        assert inside.diff(dim=-1).std() <= steepest + 1e-9
        assert abs(torch.corrcoef(inside[0].flatten(1))[0, 1]) < 0.1 or level == 0
    again, other = (metamers.displaced(coordinates, levels, cell, seed, warp) for seed in (0, 1))
    assert torch.equal(again, moved + coordinates) or torch.allclose(again, moved + coordinates)
    assert not torch.allclose(again, other)


def test_metamers_keep_the_grain_of_oblique_lines():
    """Waves along 45° whose phase and strength vary: two orientations and short displacements curl them."""
    along, across = (noise(1, 1, 160, 160, seed=2) - 0.5, torch.fft.fftfreq(160, dtype=torch.float64))
    u, v = (across[:, None] + across) / math.sqrt(2), (across[:, None] - across) / math.sqrt(2)
    passed = torch.exp(-((u.abs() - 0.12) ** 2) / 0.004 - v**2 / 0.0004)
    grain = torch.fft.ifft2(torch.fft.fft2(along) * passed).real
    grain = (0.5 + 0.13 * grain / grain.std()).clamp(0, 1).float()
    made = MetamericLossUniform(pooling_size=10, n_pyramid_levels=4).gen_metamer(grain, iterations=10)
    assert float((made - grain).square().mean().sqrt()) > 0.04

    def coherence(picture):
        down, right = torch.gradient(picture[0, 0, 16:-16, 16:-16])
        trace = (down**2 + right**2).mean()
        return float(torch.hypot((down**2 - right**2).mean(), 2 * (down * right).mean()) / trace)

    assert coherence(grain) > 0.95
    assert coherence(made) > 0.95 * coherence(grain)


def test_flat_regions_of_metamers_stay_flat():
    """Steps of grey 24 pixels wide within pooling regions of 40 pixels."""
    steps = (0.2 + 0.1 * (torch.arange(96) // 24)).expand(1, 1, 64, 96)
    made = MetamericLossUniform(pooling_size=40, n_pyramid_levels=4).gen_metamer(steps, iterations=10)
    assert (made - steps).abs().max() > 0.05
    middle = (torch.arange(96) % 24 - 12).abs() < 5
    torch.testing.assert_close(made[..., 8:-8, middle], steps[..., 8:-8, middle], rtol=0, atol=1e-4)
    share = metamers.detail_share(steps)
    variance = torch.nn.functional.unfold(steps.double(), 9).var(1, correction=0).unflatten(-1, (56, 88))
    expected = (variance / (variance + 0.005**2)).float()
    torch.testing.assert_close(share[:, 0, 4:-4, 4:-4], expected, rtol=0, atol=2e-3)
    assert (share[..., middle] < 1e-3).all()


def test_a_picture_too_small_for_its_pooling_regions():
    picture = noise(1, 1, 32, 32)
    with pytest.warns(SamplingWarning, match=r"pooling regions are 2 pixels wide at most.*nearly the picture"):
        made = MetamericLossUniform(pooling_size=2, n_pyramid_levels=2).gen_metamer(picture, iterations=1)
    assert psnr(made, picture) > 20


def test_colours_stay_in_the_local_gamut():
    """Bright pixels are white and dark ones brown: neither bright brown nor dark white is within the gamut."""
    share = noise(1, 1, 24, 24)
    brown, white = (torch.tensor(one, dtype=torch.float64)[:, None, None] for one in ((0.5, 0.25, 0.1), (1, 1, 1)))
    picture = rgb_2_ycrcb(brown + share * (white - brown))
    gamut = metamers.LocalGamut(picture, torch.full((24, 24), 6.0, dtype=torch.float64), 0.0, 1.0)
    torch.testing.assert_close(gamut.clipped(picture), picture, rtol=0, atol=1e-3)
    line = (rgb_2_ycrcb(white[None]) - rgb_2_ycrcb(brown[None])).flatten()

    def distance(colours):
        """Of the farthest colour from the line between the two."""
        relative = (colours - rgb_2_ycrcb(brown[None])).movedim(1, -1)
        along = (relative @ line)[..., None] * line / (line @ line)
        return (relative - along).norm(dim=-1).max()

    # Within the range of each single channel, but not of the local colours.
    mixed = torch.cat([picture[:, :1], picture[:, 1:].flip(2, 3)], 1)
    found = mixed
    for _ in range(metamers.CLIPPINGS):
        found = gamut.clipped(found)
    assert distance(picture) < 1e-9
    assert distance(mixed) > 0.1
    assert distance(found) < 0.3 * distance(mixed)
    # The region is the whole picture, so that its extremes are the bounds.
    for one, two in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        for sign in (1, -1):
            scale = 4 if one == 0 else 1
            inside, own = (value[:, one] + sign * scale * value[:, two] for value in (found, picture))
            assert own.min() - 2e-3 < inside.min()
            assert inside.max() < own.max() + 2e-3


def test_rescaled_bands_have_the_statistics_asked_for(photograph):
    """Bands that are given back their own statistics make the picture; others have means and deviations as wanted."""
    maker = SpatialSteerablePyramid(False, 3, 5, 2, "cropped")
    groups, low = maker._levels(photograph, 4)
    place = (photograph.device, photograph.dtype)
    samplers = [UniformSampler(tuple(bands.shape[-2:]), (4, 4), *place) for bands in groups]
    own = statistics_maps(groups, Pooling(samplers, [None] * len(groups)), [low[-1]])
    back = metamers.rescaled(groups, own, own, maker)
    whole = maker.reconstruct_from_pyramid(maker.construct_pyramid(photograph, 4))
    torch.testing.assert_close(back, whole, rtol=0, atol=metamers.TOLERANCE)
    # The pyramid is linear, so that doubled bands and low-pass make twice the picture, unless the gain is limited.
    doubled = [2 * one for one in own]
    torch.testing.assert_close(
        metamers.rescaled(groups, own, doubled, maker), 2 * whole, rtol=0, atol=2 * metamers.TOLERANCE
    )
    limited = metamers.rescaled(groups, own, doubled, maker, largest_gain=1.5)
    assert float((limited - 2 * whole).abs().max()) > 3 * metamers.TOLERANCE


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_metamers_of_half_precision_are_those_of_single(dtype):
    loss, picture = MetamerMSELoss(**VIEW, n_pyramid_levels=2), noise(1, 3, 32, 32).to(dtype)
    made, wanted = (loss.gen_metamer(one, [0.2, 0.5], iterations=2) for one in (picture, picture.float()))
    assert made.dtype == dtype
    assert torch.equal(made, wanted.to(dtype))
