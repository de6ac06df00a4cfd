"""Masks by their spectra, diffused errors pixel by pixel, the light that dither keeps and how visible it is."""

import itertools

import numpy as np
import pytest
import torch

from odak.learn.perception import CSFLoss, FlickerLoss, Viewing, VisibilityLoss, dither, pq_decode
from odak.learn.perception.dithering import METHODS, SIDE, blue_noise_ranks

KEEPING = METHODS[:2]


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def light_of(values):
    return torch.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def spectrum(pattern):
    """Return the power of each frequency over the mean, its radius in cycles per pixel, and its angle."""
    power = np.abs(np.fft.fft2(pattern - pattern.mean())) ** 2
    y, x = np.meshgrid(*[np.fft.fftfreq(SIDE)] * 2, indexing="ij")
    return power / power.mean(), np.hypot(x, y), np.arctan2(y, x)


def patterns(ranks):
    return [ranks, *(ranks < share * SIDE**2 for share in (0.05, 0.25, 0.5, 0.9))]


def test_a_mask_holds_each_rank_once():
    for seed in (0, 5):
        assert np.array_equal(np.sort(blue_noise_ranks(seed).ravel()), np.arange(SIDE**2))
    assert not np.array_equal(blue_noise_ranks(0), blue_noise_ranks(5))


def test_blue_noise_has_little_power_at_low_frequencies():
    ranks = blue_noise_ranks(0)
    white = np.random.default_rng(99).permutation(ranks.ravel()).reshape(SIDE, SIDE)
    for pattern, other in zip(patterns(ranks), patterns(white), strict=True):
        # A third of the frequency at which points of this share, or of the rest, are a mean distance apart.
        share = min(pattern.mean(), 1 - pattern.mean()) if pattern.dtype == bool else 0.5
        (power, radius, _), (flat, *_) = spectrum(pattern), spectrum(other)
        low = (radius > 0) & (radius < share**0.5 / 3)
        assert power[low].mean() < 0.12 < 0.6 < flat[low].mean()
    power, radius, _ = spectrum(ranks)
    means = [power[(radius > a) & (radius <= a + 0.125)].mean() for a in (0, 0.125, 0.25, 0.375)]
    assert means[0] < 0.002 < means[1] < 0.05 < means[2] < means[3]


def test_blue_noise_is_isotropic():
    power, radius, angle = spectrum(blue_noise_ranks(0))
    ring = (radius > 0.3) & (radius < 0.5)
    sectors = [power[ring & (np.floor(8 * angle / np.pi) % 8 == k)].mean() for k in range(8)]
    assert max(sectors) < 1.3 * min(sectors)


def test_each_prefix_of_the_ranks_leaves_no_clusters_and_no_gaps():
    ranks = blue_noise_ranks(0)
    for count in (64, 256):
        places = np.argwhere(ranks < count)
        away = np.abs(places[:, None] - places)
        distances = np.hypot(*np.moveaxis(np.minimum(away, SIDE - away), -1, 0))
        np.fill_diagonal(distances, np.inf)
        # White noise would have pairs of neighbours; a square grid has all points this far apart.
        assert distances.min() > 0.6 * SIDE / count**0.5


@pytest.mark.parametrize("encoding", ["sRGB", "linear"])
@pytest.mark.parametrize("bits", [1, 3])
@pytest.mark.parametrize("method", KEEPING)
def test_the_mean_light_of_a_grey_is_kept_to_a_step_over_the_pixels(method, bits, encoding):
    decode = light_of if encoding == "sRGB" else lambda stored: stored
    step = decode(torch.linspace(0, 1, 2**bits, dtype=torch.float64)).diff().max()
    for grey in (0.03, 0.73):
        picture = torch.full((1, 1, SIDE, SIDE), grey, dtype=torch.float64)
        for frames in (None, 3):
            shown = dither(picture, bits, method, frames=frames, encoding=encoding)
            assert abs(decode(shown).mean() - decode(picture).mean()) <= step / SIDE**2


def test_a_grey_is_halved_in_light_and_not_in_stored_values():
    half = torch.full((1, 1, SIDE, SIDE), 0.5)
    assert dither(half).mean().item() == pytest.approx(0.21404, abs=1e-3)
    assert dither(half, encoding="linear").mean().item() == 0.5
    # 10 000 cd/m² by the curve PQ: 0.5 stands for 92.
    assert dither(half, encoding=pq_decode).mean().item() == pytest.approx(0.0092, abs=1e-3)


@pytest.mark.parametrize("shape", [(9, 7), (1, 12), (12, 1), (2, 3), (1, 1)])
def test_diffused_errors_are_lost_nowhere(shape):
    """All of a picture's light but the error of its last pixel is shown, whatever its shape."""
    picture = noise(2, 1, *shape)
    for bits in (1, 2):
        lost = (dither(picture, bits, "error diffusion", encoding="linear") - picture).sum((1, 2, 3))
        assert lost.abs().max() <= 0.5 / (2**bits - 1) + 1e-9


def test_diffusion_is_that_of_floyd_and_steinberg():
    """Pixel by pixel in plain numbers; what would leave the picture goes to the pixel below, in the last row on."""
    picture = noise(1, 1, 9, 7)
    light, shown = light_of(picture)[0, 0].numpy(), np.empty((9, 7))
    levels = light_of(torch.linspace(0, 1, 4, dtype=torch.float64)).numpy()
    for y in range(9):
        for x in range(7):
            index = np.abs(levels - light[y, x]).argmin()
            shown[y, x], error = index / 3, light[y, x] - levels[index]
            if y == 8:
                if x < 6:
                    light[y, x + 1] += error
                continue
            for down, across, share in ((0, 1, 7), (1, -1, 3), (1, 0, 5), (1, 1, 1)):
                place = x + across if 0 <= x + across < 7 else None
                light[(y, x + 1) if not down and place is not None else (y + 1, x if place is None else place)] += (
                    share / 16 * error
                )
    assert torch.allclose(dither(picture, 2, "error diffusion")[0, 0], torch.from_numpy(shown), atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_levels_stay_as_they_are(method):
    picture = (noise(2, 3, 20, 30) * 7).round() / 7
    for dtype in (torch.float64, torch.float32):
        assert torch.equal(dither(picture.to(dtype), 3, method), picture.to(dtype))
    found = dither(noise(3, 20, 30), (5, 6, 5), method)
    for channel, bits in enumerate((5, 6, 5)):
        levels = found[:, channel] * (2**bits - 1)
        assert torch.allclose(levels, levels.round(), atol=1e-9) and found.min() >= 0 and found.max() <= 1
    assert found.shape == (1, 3, 20, 30) and torch.equal(dither(picture - 1, 3, method), 0 * picture)


@pytest.mark.parametrize("method", METHODS)
def test_a_mean_of_frames_has_finer_levels(method):
    ramp = torch.linspace(0, 1, 96, dtype=torch.float64).expand(1, 1, 64, 96)
    shown = dither(ramp, 1, method, frames=4, encoding="linear")
    assert shown.shape == (1, 4, 1, 64, 96) and set(shown.unique().tolist()) == {0.0, 1.0}
    mean, once = shown.mean(1), dither(ramp, 1, method, encoding="linear")
    if method == "none":
        assert torch.equal(mean, (4 * ramp).round() / 4)
    errors = [(one - ramp).square().mean() for one in (mean, shown[:, 0], once)]
    assert 3 * errors[0] < min(errors[1:])
    # Each frame has its share of the light.
    each = shown.mean((0, 2, 3, 4))
    assert (each - 0.5).abs().max() < 0.02
    assert torch.equal(dither(ramp, 1, method, frames=1)[:, 0], dither(ramp, 1, method))


def test_a_part_of_the_frames_is_spread_over_time():
    frames = dither(torch.full((1, 1, 8, 8), 0.5), frames=4, encoding="linear")[0, :, 0]
    assert bool((frames.diff(dim=0).abs() == 1).all())


def view(density):
    return Viewing.head_mounted((SIDE, SIDE), pixels_per_degree=density)


PHOTO = torch.nn.functional.interpolate(noise(1, 1, 5, 5, seed=3), (SIDE, SIDE), mode="bicubic").clamp(0, 1)


@pytest.mark.parametrize(("kind", "bits", "share"), [(CSFLoss, 1, 0.65), (CSFLoss, 2, 0.65), (VisibilityLoss, 2, 0.85)])
def test_blue_noise_is_seen_less_than_white_noise_and_rounding(kind, bits, share):
    loss = kind(viewing=view(60.0))
    blue, diffused, white, rounded = (float(loss(dither(PHOTO, bits, m), PHOTO).sqrt()) for m in METHODS)
    assert max(blue, diffused) < share * min(white, rounded)


def test_dither_is_seen_less_from_afar():
    for method in KEEPING:
        shown = dither(PHOTO, 2, method)
        seen = [float(CSFLoss(viewing=view(density))(shown, PHOTO).sqrt()) for density in (15.0, 30.0, 60.0, 120.0)]
        assert all(a > 1.5 * b for a, b in itertools.pairwise(seen))


def test_frames_by_a_mask_flicker_less_than_noise_and_than_in_step():
    flicker = FlickerLoss(60.0, viewing=view(30.0))
    blue, white = (float(flicker(dither(PHOTO, 1, m, frames=4)).sqrt()) for m in ("blue noise", "white noise"))
    assert 1.15 * blue < white
    lit = dither(PHOTO, 1, "none", frames=4)
    in_step = lit.mean(1, keepdim=True) > (torch.arange(4) / 4 + 0.01)[:, None, None, None]
    assert 3 * flicker(lit).sqrt() < flicker(in_step.double()).sqrt()


def test_channels_and_seeds_differ():
    grey = torch.full((1, 3, SIDE, SIDE), 0.6)
    red, green, blue = dither(grey)[0]
    assert all((one != other).float().mean() > 0.2 for one, other in ((red, green), (green, blue), (red, blue)))
    for method in ("blue noise", "white noise"):
        assert torch.equal(dither(grey, 1, method), dither(grey, 1, method))
        assert not torch.equal(dither(grey, 1, method), dither(grey, 1, method, seed=1))


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"bits": 0}, ValueError, "bits"),
        ({"bits": 17}, ValueError, "bits"),
        ({"bits": (1, 2)}, ValueError, "bits must be one number or one for each of 3 channels"),
        ({"method": "blue"}, ValueError, "method"),
        ({"frames": 0}, ValueError, "frames"),
        ({"encoding": "gamma"}, ValueError, "encoding"),
        ({"encoding": lambda stored: 1 - stored}, ValueError, "encoding must be a rising function"),
        ({"encoding": 2.2}, TypeError, "encoding"),
        ({"image": torch.full((1, 3, 4, 4), torch.nan)}, ValueError, "image"),
        ({"image": torch.zeros(1, 3, 0, 4)}, ValueError, "image"),
        ({"image": torch.zeros(4, 4)}, ValueError, "image"),
    ],
)
def test_bad_arguments_are_named(arguments, error, text):
    with pytest.raises(error, match=text):
        dither(**{"image": torch.zeros(1, 3, 4, 4), **arguments})


@pytest.mark.parametrize("returned", [3, None, np.linspace(0, 1, 4), torch.tensor(0.5)])
def test_an_encoding_that_returns_no_tensor_of_its_shape_is_named(returned):
    with pytest.raises(TypeError, match="encoding must return a tensor"):
        dither(torch.rand(1, 1, 4, 4), 2, encoding=lambda stored: returned)
