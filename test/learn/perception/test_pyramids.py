"""The spatial pyramid and its designed filters: flat responses, tuning, reconstruction."""

import json
import math

import numpy as np
import pytest
import torch

from odak import AccuracyWarning
from odak.learn.perception import (
    SpatialSteerablePyramid,
    crop_steerable_pyramid_filters,
    get_steerable_pyramid_filters,
    pad_image_for_pyramid,
    pyramids,
)
from odak.learn.perception.pyramids import band_amplitude, ideal_gains, orientations, steering

COUNTS = [1, 2, 3, 4, 6]


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def response(taps, x, y):
    """Return what correlation with a filter makes of exp(i(x·column − y·row)), y upwards."""
    taps = taps[0, 0].numpy()
    offset = np.arange(len(taps)) - len(taps) // 2
    return np.einsum(
        "rc,...r,...c->...", taps, np.exp(-1j * np.multiply.outer(y, offset)), np.exp(1j * np.multiply.outer(x, offset))
    )


@pytest.mark.parametrize("bilinear", [True, False])
@pytest.mark.parametrize("count", COUNTS)
def test_the_bank_is_flat_does_not_alias_and_keeps_means(count, bilinear):
    filters = get_steerable_pyramid_filters(9, count, "full", bilinear=bilinear, dtype=torch.float64)
    x, y = np.meshgrid(*[np.linspace(-math.pi, math.pi, 41)] * 2)
    low, low0, high0 = (response(filters[name], x, y) for name in ("l", "l0", "h0"))
    bands = sum(abs(response(band, x, y)) ** 2 for band in filters["b"])
    passed = (np.cos(x / 2) * np.cos(y / 2)) ** 4 if bilinear else abs(low) ** 2 / 4
    total = abs(high0) ** 2 + abs(low0) ** 2 * (bands + passed)
    assert abs(total - 1).max() < (0.055 if bilinear else 0.025)
    assert math.sqrt(((total - 1) ** 2).mean()) < (0.012 if bilinear else 0.006)
    split = abs(high0) ** 2 + abs(low0) ** 2
    assert split.min() > 0.98 and split.max() < 1.05
    sums = [float(filters[name].sum()) for name in ("l", "l0", "h0")]
    assert sums == pytest.approx([2, 1, 0], abs=1e-5)
    assert max(abs(float(band.sum())) for band in filters["b"]) < 1e-5
    if bilinear:
        return
    for shift in ((math.pi, 0), (math.pi, math.pi)):
        assert abs(low * response(filters["l"], x + shift[0], y + shift[1]) / 4).max() < 0.015


@pytest.mark.parametrize("count", COUNTS[1:])
def test_bands_are_tuned_as_powers_of_the_cosine(count):
    filters = get_steerable_pyramid_filters(9, count, "full", dtype=torch.float64)
    angle = np.linspace(0, math.pi, 720, endpoint=False)
    x, y = math.pi / 2 * np.cos(angle), math.pi / 2 * np.sin(angle)
    for k, band in enumerate(filters["b"]):
        gain = response(band, x, y) * (1j if count % 2 == 0 else 1)
        assert abs(gain.imag).max() < 1e-12
        ideal = band_amplitude(count) * np.cos(angle - math.pi * k / count) ** (count - 1)
        # Odd bands are minus derivatives: −i times a positive gain along their own direction.
        assert gain.real @ ideal > 0
        assert np.corrcoef(abs(gain), abs(ideal))[0, 1] > 0.997
        assert abs(gain).max() == pytest.approx(band_amplitude(count), rel=0.06)
        off = (np.degrees(angle[abs(gain).argmax()]) - 180 * k / count + 90) % 180 - 90
        assert abs(off) < 3


@pytest.mark.parametrize("count", COUNTS)
def test_bands_are_exactly_steerable(count):
    """A band turned by 90° or mirrored is a mixture of the bands, as its cosine is."""
    bands = get_steerable_pyramid_filters(9, count, "full", dtype=torch.float64)["b"]
    stacked = torch.cat(bands)[:, 0].numpy()
    turn = steering(count, orientations(count) + math.pi / 2) @ np.linalg.inv(steering(count, orientations(count)))
    np.testing.assert_allclose(np.tensordot(turn, stacked, 1), np.rot90(stacked, axes=(1, 2)), atol=1e-12)


def test_ideal_gains_add_up():
    radius = np.linspace(0, 5, 200)
    high0, low0, high, low = ideal_gains(radius)
    np.testing.assert_allclose(high0**2 + low0**2, 1)
    np.testing.assert_allclose(high**2 + low**2 / 4, 1)
    assert ideal_gains(np.array([math.pi / 4, math.pi / 2]))[3].tolist() == pytest.approx([2, 0], abs=1e-12)
    assert ideal_gains(np.array(math.pi / 2 / math.sqrt(2)))[2] == pytest.approx(math.sqrt(0.5))


BANKS = [("full", 9, 1), ("full", 9, 4), ("cropped", 5, 2), ("cropped", 3, 6), ("trained", 5, 2)]


@pytest.mark.parametrize("bilinear", [True, False])
@pytest.mark.parametrize(("kind", "size", "count"), BANKS)
def test_noise_comes_back_from_its_pyramid(kind, size, count, bilinear):
    picture, maker = noise(1, 2, 28, 33), SpatialSteerablePyramid(bilinear, 2, size, count, kind)
    for dtype, bound in ((torch.float64, 1e-8), (torch.float32, 2e-6))[: 1 + bilinear]:
        pyramid = maker.construct_pyramid(picture.to(dtype), 3)
        before = [pyramid[0]["h"].clone(), pyramid[1]["b"][0].clone(), pyramid[2]["l"].clone()]
        back = maker.reconstruct_from_pyramid(pyramid)
        assert back.dtype == maker.filt_h0.dtype == dtype
        assert (back - picture).abs().max() < bound
        after = pyramid[0]["h"], pyramid[1]["b"][0], pyramid[2]["l"]
        assert all(torch.equal(*pair) for pair in zip(before, after, strict=True))


def test_a_channel_of_zeros_comes_back_beside_one_of_noise():
    picture, maker = noise(1, 2, 33, 33), SpatialSteerablePyramid(True, 2, 5, 2, "trained")
    picture[:, 0] = 0
    back = maker.reconstruct_from_pyramid(maker.construct_pyramid(picture, 5))
    assert torch.equal(back[:, 0], picture[:, 0])
    assert (back - picture).abs().max() < 1e-8


@pytest.mark.parametrize("bilinear", [True, False])
def test_the_nearest_pyramid_is_that_of_least_squares(bilinear):
    """Against a dense solution; a sample that 2 × 2 means have halved counts for the pixels that it stands for."""
    maker, (rows, columns) = SpatialSteerablePyramid(bilinear, 1, 5, 2, "cropped"), (18, 20)

    def flat(pyramid):
        parts = [pyramid[0]["h"], *(band for level in pyramid[:-1] for band in level["b"]), pyramid[-1]["l"]]
        weights = [1, 1, 1, 2, 2, 4] if bilinear else [1] * 6
        return torch.cat([weight * part.flatten(1) for weight, part in zip(weights, parts, strict=True)], 1)

    units = torch.eye(rows * columns, dtype=torch.float64).reshape(-1, 1, rows, columns)
    matrix = flat(maker.construct_pyramid(units, 3)).numpy().T
    pyramid = maker.construct_pyramid(noise(1, 1, rows, columns), 3)
    pyramid[0]["b"][1] *= 1.7
    pyramid[1]["b"][0] += noise(1, 1, rows // 2, columns // 2, seed=1)
    pyramid[0]["h"].fill_(0.2)
    wanted, (misfit,), _, _ = np.linalg.lstsq(matrix, flat(pyramid)[0].numpy()[:, None], rcond=None)
    assert misfit > 1
    found = maker.reconstruct_from_pyramid(pyramid).numpy().ravel()
    np.testing.assert_allclose(found, wanted[:, 0], rtol=0, atol=1e-7)


def test_a_picture_that_is_not_found_states_its_error(monkeypatch):
    monkeypatch.setattr(pyramids, "MOST_STEPS", 1)
    maker, picture = SpatialSteerablePyramid(True, 1, 5, 2, "trained"), noise(1, 1, 40, 40)
    pyramid = maker.construct_pyramid(picture, 4)
    with pytest.warns(AccuracyWarning, match=r"the last of 8 rounds of the inversion changed it by 0\.\d+ of its"):
        back = maker.reconstruct_from_pyramid(pyramid)
    assert 1e-3 < (back - picture).abs().max() < 0.5


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")
def test_transforms_of_the_inversion():
    maker = SpatialSteerablePyramid(False, 1, 5, 2, "cropped")
    low, band, weight = noise(3, 1, 12, 12), noise(1, 1, 24, 24, seed=1), noise(24, 24, seed=2)
    pyramid = maker.construct_pyramid(noise(1, 1, 24, 24, seed=3), 2)

    def picture(of_low):
        return maker.reconstruct_from_pyramid([{**pyramid[0], "b": [pyramid[0]["b"][0], band]}, {"l": of_low[None]}])[0]

    each = torch.stack([picture(one) for one in low])
    torch.testing.assert_close(torch.func.vmap(picture)(low), each, rtol=0, atol=1e-7)
    # The picture is linear in the low-pass, so that its derivatives are differences.
    change = picture(low[0] + low[1]) - picture(low[0])
    turned = torch.func.jvp(picture, (low[0],), (low[1],))[1]
    torch.testing.assert_close(turned, change, rtol=0, atol=1e-7)
    gradient = torch.func.grad(lambda of_low: (weight * picture(of_low)).sum())(low[0])
    assert float((gradient * low[1]).sum()) == pytest.approx(float((weight * change).sum()), abs=1e-6)


@pytest.mark.parametrize("bilinear", [True, False])
def test_shapes_levels_and_means(bilinear):
    maker = SpatialSteerablePyramid(bilinear, 3, n_orientations=2)
    pyramid = maker.construct_pyramid(torch.full((1, 3, 64, 96), 0.7), 4, multiple_highpass=True)
    assert [tuple(level["l"].shape[-2:]) for level in pyramid] == [(64, 96), (32, 48), (16, 24), (8, 12)]
    assert [len(level.get("b", [])) for level in pyramid] == [2, 2, 2, 0]
    assert ["h" in level for level in pyramid] == [True, True, True, False]
    factors = [1, 1, 1, 1] if bilinear else [1, 2, 4, 8]
    for level, factor in zip(pyramid, factors, strict=True):
        torch.testing.assert_close(level["l"], torch.full_like(level["l"], 0.7 * factor))
        assert all(band.abs().max() < 1e-5 for band in level.get("b", []))


@pytest.mark.parametrize("band", range(4))
def test_a_grating_lands_in_its_band(band):
    angle = math.pi * band / 4
    y, x = torch.meshgrid(*[torch.arange(64, dtype=torch.float64)] * 2, indexing="ij")
    grating = torch.cos(math.pi / 2 * (math.cos(angle) * x - math.sin(angle) * y))[None, None]
    bands = SpatialSteerablePyramid(False, 1, 9, 4).construct_pyramid(grating, 2)[0]["b"]
    energy = [float((value[..., 10:-10, 10:-10] ** 2).sum()) for value in bands]
    assert int(np.argmax(energy)) == band
    shares = [math.cos(math.pi * (k - band) / 4) ** 6 for k in range(4)]
    assert np.array(energy) / sum(energy) == pytest.approx(np.array(shares) / sum(shares), abs=0.03)


def test_signs_of_the_bands():
    maker = SpatialSteerablePyramid(False, 1, 9, 2)
    ramp = (torch.arange(32.0) / 32).expand(32, 32)[None, None]
    right, down = (maker.construct_pyramid(picture, 2)[0]["b"] for picture in (ramp, ramp.mT))
    assert (right[0][..., 8:-8, 8:-8] < -1e-4).all()
    assert right[1][..., 8:-8, 8:-8].abs().max() < 1e-6
    assert (down[1][..., 8:-8, 8:-8] > 1e-4).all()


def test_cropped_and_trained_banks():
    full, cropped, trained = (get_steerable_pyramid_filters(5, 2, kind) for kind in ("full", "cropped", "trained"))
    sizes = {name: cropped[name].shape[-1] for name in ("l", "l0", "h0")}
    assert sizes == {"l": 13, "l0": 5, "h0": 5}
    assert [full[name].shape[-1] for name in ("l", "l0", "h0")] == [17, 9, 9]
    assert all(band.shape == (1, 1, 5, 5) for band in cropped["b"] + trained["b"])
    assert torch.equal(trained["b"][1], trained["b"][0].mT)
    assert float(trained["b"][0].norm()) == pytest.approx(0.13, abs=0.002)
    assert trained["b"][0][0, 0, 2, 1] == pytest.approx(0.061)
    assert [get_steerable_pyramid_filters(5, 6, "cropped")[name].shape[-1] for name in ("l", "l0")] == [13, 5]


def test_cropping():
    filters = {"l": noise(1, 1, 17, 17), "l0": noise(1, 1, 9, 9), "h0": noise(1, 1, 9, 9), "b": [noise(1, 1, 9, 9)]}
    before = {name: filters[name].clone() for name in ("l", "l0", "h0")}
    cut = crop_steerable_pyramid_filters(filters, 5)
    assert cut["l"].shape[-1] == 13
    assert float(cut["l"].sum()) == pytest.approx(float(filters["l"].sum()))
    torch.testing.assert_close(
        cut["l0"] / cut["l0"].sum(), filters["l0"][..., 2:7, 2:7] / filters["l0"][..., 2:7, 2:7].sum()
    )
    middle = filters["h0"][..., 2:7, 2:7]
    torch.testing.assert_close(cut["h0"], middle - middle.mean())
    band = filters["b"][0][..., 2:7, 2:7]
    torch.testing.assert_close(cut["b"][0], band - band.mean())
    assert all(torch.equal(filters[name], value) for name, value in before.items())
    assert crop_steerable_pyramid_filters(filters, 11)["h0"].shape[-1] == 9


def test_padding():
    picture = noise(1, 2, 50, 64)
    padded = pad_image_for_pyramid(picture, 5)
    assert padded.shape == (1, 2, 64, 64)
    assert torch.equal(padded[..., :50, :], picture)
    assert torch.equal(padded[..., 50, :], picture[..., 48, :])
    assert pad_image_for_pyramid(padded, 5) is padded
    assert pad_image_for_pyramid(noise(1, 1, 3, 3), 5).shape[-2:] == (32, 32)


def test_precision_follows_the_picture():
    maker = SpatialSteerablePyramid(False, 1, 9, 2)
    one = maker.construct_pyramid(noise(1, 1, 32, 32), 2)[0]["b"][0]
    assert one.dtype == maker.filt_h0.dtype == torch.float64
    fresh = SpatialSteerablePyramid(False, 1, 9, 2).to(torch.float64)
    # Moved, taps keep all their digits.
    assert torch.equal(fresh.construct_pyramid(noise(1, 1, 32, 32), 2)[0]["b"][0], one)
    assert maker.construct_pyramid(noise(1, 1, 32, 32).float(), 2)[0]["h"].dtype == torch.float32
    assert len(maker.band_filters) == 2
    assert maker.band_filters[1].shape == (1, 1, 9, 9)


def test_gradient():
    maker, picture = SpatialSteerablePyramid(False, 1, 5, 3, "cropped"), noise(1, 1, 8, 8).requires_grad_()
    with torch.inference_mode():
        maker.construct_pyramid(picture, 2)

    def there_and_back(image):
        pyramid = maker.construct_pyramid(image, 2)
        return maker.reconstruct_from_pyramid(pyramid) + pyramid[0]["b"][1] ** 2

    assert torch.autograd.gradcheck(there_and_back, picture, fast_mode=True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((9, 2, "full-size"), "filter_type must be one of 'full', 'cropped', 'trained'"),
        ((9, 0, "full"), "n_orientations must be at least 1"),
        ((4, 2, "cropped"), "size must be odd"),
        ((11, 2, "cropped"), "size must be at most 9"),
        ((9, 2, "trained"), "'trained' needs size=5 and n_orientations=2"),
        ((5, 4, "trained"), "'trained' needs size=5 and n_orientations=2"),
    ],
)
def test_refused_filters(arguments, message):
    with pytest.raises(ValueError, match=message):
        get_steerable_pyramid_filters(*arguments)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("bilinear", [True, False])
def test_the_first_level_is_filtered_by_the_bank(bilinear, count):
    bank = get_steerable_pyramid_filters(9, count, "full", bilinear=bilinear, dtype=torch.float64)
    picture = noise(1, 1, 40, 48)
    level = SpatialSteerablePyramid(bilinear, 1, 9, count).construct_pyramid(picture, 2)[0]

    def filtered(image, taps):
        reach = taps.shape[-1] // 2
        return torch.nn.functional.conv2d(torch.nn.functional.pad(image, (reach,) * 4, mode="reflect"), taps)

    torch.testing.assert_close(level["h"], filtered(picture, bank["h0"]))
    torch.testing.assert_close(level["l"], filtered(picture, bank["l0"]))
    for found, band in zip(level["b"], bank["b"], strict=True):
        torch.testing.assert_close(found, filtered(filtered(picture, bank["l0"]), band))


def test_stripes_of_one_pixel_are_all_in_the_residual():
    stripes = torch.tensor([0.0, 1.0], dtype=torch.float64).repeat(32).expand(1, 1, 64, 64)
    for count in (1, 2, 4, 6):
        level = SpatialSteerablePyramid(False, 1, 9, count).construct_pyramid(stripes, 2)[0]
        assert level["h"].std() > 0.9 * stripes.std() > 3 * (level["l"] - 0.5).std()


def test_each_filter_needs_a_large_enough_level():
    picture = noise(1, 1, 48, 48)
    assert len(SpatialSteerablePyramid(True, 1, 9, 4).construct_pyramid(picture, 5)) == 5
    with pytest.raises(ValueError, match="sides of at least 72 for 5 levels"):
        SpatialSteerablePyramid(False, 1, 9, 4).construct_pyramid(picture, 5)


def test_refused_pictures():
    maker = SpatialSteerablePyramid(False, 1, 9, 2)
    with pytest.raises(ValueError, match="sides of at least 36 for 4 levels"):
        maker.construct_pyramid(noise(1, 1, 32, 64), 4)
    with pytest.raises(ValueError, match="of n_channels channels"):
        maker.construct_pyramid(noise(1, 3, 32, 32), 2)
    with pytest.raises(ValueError, match="n_levels must be at least 2"):
        maker.construct_pyramid(noise(1, 1, 32, 32), 1)


@pytest.mark.slow
def test_kept_banks_are_what_the_design_gives(tmp_path):
    """The file of taps is data made by this code: made anew, a bank is the same, and none can be much improved."""
    banks = [(1, (13, 5, 5, 5), False), (2, (13, 5, 5, 5), True)]
    pyramids.keep(banks, tmp_path / "taps.json")
    kept = pyramids._kept()
    for name, taps in json.loads((tmp_path / "taps.json").read_text()).items():
        assert np.allclose(taps, kept[name], rtol=0, atol=1e-6)
    assert len(kept) == 36
    for name, taps in kept.items():
        count, *sizes = map(int, name.removesuffix(" bilinear").split())
        problem = pyramids._Problem(count, tuple(sizes), name.endswith("bilinear"))
        taps = np.array(taps)
        assert taps.shape == (problem.length,)
        residual, jacobian = problem.residual(taps)
        slope = problem.normal @ taps - problem.pulled + jacobian.T @ residual
        steepest = np.abs(problem.normal @ problem.start() - problem.pulled).max()
        assert np.abs(slope).max() < 1e-2 * max(1.0, steepest)
