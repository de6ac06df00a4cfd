"""Contrast of regions and of windows."""

import pytest
import torch

from odak.learn import perception


def halves(dark=0.2, bright=0.8, size=30):
    image = torch.full((size, size), dark)
    image[:, size // 2 :] = bright
    return image


def test_regions():
    image = torch.stack([halves(), 2 * halves()])
    left, right = [0, 30, 0, 15], (0, 30, 15, 30)
    torch.testing.assert_close(perception.weber_contrast(image, right, left), torch.tensor([3.0, 3.0]))
    torch.testing.assert_close(perception.michelson_contrast(image, right, left), torch.tensor([0.6, 0.6]))
    torch.testing.assert_close(perception.michelson_contrast(halves(), left, right), torch.tensor([-0.6]))
    assert perception.weber_contrast(image[None].expand(3, -1, -1, -1), right, left).shape == (3, 2)
    assert perception.weber_contrast((10 * halves()).int(), right, left).item() == pytest.approx(3)


def test_regions_that_will_not_do():
    dark = torch.zeros(8, 8)
    with pytest.raises(ValueError, match="roi_low must have a positive mean"):
        perception.weber_contrast(dark, [0, 4, 0, 4], [4, 8, 4, 8])
    with pytest.raises(ValueError, match="roi_high and roi_low must have a positive mean"):
        perception.michelson_contrast(dark, [0, 4, 0, 4], [4, 8, 4, 8])
    with pytest.raises(ValueError, match="roi_low must lie inside"):
        perception.weber_contrast(dark + 1, [0, 4, 0, 4], [4, 9, 4, 8])
    with pytest.raises(TypeError, match="image"):
        perception.weber_contrast([[1.0]], [0, 1, 0, 1], [0, 1, 0, 1])


def test_windows_are_split_between_dark_and_bright():
    result = perception.content_aware_contrast_ratio(halves(), window_size=5, step=1, pooling_percentile=50.0)
    centre = result["contrast_map"][15, 13:17]
    torch.testing.assert_close(centre, torch.full((4,), 0.75))
    torch.testing.assert_close(result["threshold_map"][15, 15], torch.tensor(0.5))
    torch.testing.assert_close(result["foreground_mean_map"][15, 15], torch.tensor(0.2))
    torch.testing.assert_close(result["background_mean_map"][15, 15], torch.tensor(0.8))
    assert result["contrast_map"][15, 5] < 0.01
    assert not result["contrast_map"][:2].any()
    assert result["max_contrast_ratio"] == pytest.approx(0.75)
    assert result["n_patches"] == 26 * 26


def test_pooling_is_the_harmonic_mean_of_the_highest():
    image = torch.rand(40, 40, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    result = perception.content_aware_contrast_ratio(image, window_size=9, step=4, pooling_percentile=60.0)
    contrast = result["contrast_map"][4:-4:4, 4:-4:4].flatten()
    assert len(contrast) == result["n_patches"] == 64
    kept = contrast[contrast >= torch.quantile(contrast, 0.6)]
    assert result["pooled_harmonic_mean"] == pytest.approx((len(kept) / (1 / kept).sum()).item())


def test_pictures_of_a_batch_do_not_influence_each_other():
    batch = torch.rand(3, 30, 30, generator=torch.Generator().manual_seed(1))
    together = perception.content_aware_contrast_ratio(batch)
    for picture, result in zip(batch, together, strict=True):
        alone = perception.content_aware_contrast_ratio(picture)
        assert alone["pooled_harmonic_mean"] == result["pooled_harmonic_mean"]
    colour = perception.content_aware_contrast_ratio(batch[None], lightness_channel=1)
    assert colour["max_contrast_ratio"] == together[1]["max_contrast_ratio"]
    assert perception.content_aware_contrast_ratio(torch.full((30, 30), 0.5))["pooled_harmonic_mean"] < 0.01


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"window_size": 4}, "window_size"),
        ({"window_size": 31}, "window_size"),
        ({"step": 0}, "step"),
        ({"image": torch.full((30, 30), torch.nan)}, "image must be finite, got nan"),
        ({"pooling_percentile": 0.0}, "pooling_percentile"),
        ({"image": torch.ones(101, 30, 30)}, "image"),
        ({"image": torch.ones(1, 3, 30, 30), "lightness_channel": 3}, "lightness_channel"),
    ],
)
def test_bad_options_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        perception.content_aware_contrast_ratio(**({"image": halves()} | change))


def test_content_aware_contrast_in_half_precision():
    picture = torch.rand(20, 20, generator=torch.Generator().manual_seed(0)).half()
    half, single = (perception.content_aware_contrast_ratio(image, 5) for image in (picture, picture.float()))
    assert half["pooled_harmonic_mean"] == single["pooled_harmonic_mean"]
