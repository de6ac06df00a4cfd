"""Colour conversions against published values, each other and their inverses."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn import perception as p
from odak.learn.perception.color import BT709_PRIMARIES, IEC_WHITE, PRIMARIES, XYZ_WHITE, constant, mix

PAIRS = {
    "sRGB": (p.rgb_to_linear_rgb, p.linear_rgb_to_rgb, 1e-13),
    "XYZ": (p.linear_rgb_to_xyz, p.xyz_to_linear_rgb, 1e-13),
    "HSV": (p.rgb_to_hsv, p.hsv_to_rgb, 1e-7),
    "Lab": (p.srgb_to_lab, p.lab_to_srgb, 1e-12),
    # Three digits each way, kept for stored results.
    "YCrCb": (p.rgb_2_ycrcb, p.ycrcb_2_rgb, 1e-3),
}


def colour(*values, dtype=torch.float64):
    return torch.tensor(values, dtype=dtype).reshape(3, 1, 1)


def listed(result):
    return result.flatten().tolist()


@pytest.mark.parametrize("name", PAIRS)
@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), batch=st.sampled_from([(), (1,), (2,), (2, 2)]))
def test_round_trip(name, seed, batch):
    there, back, tolerance = PAIRS[name]
    generator = torch.Generator().manual_seed(seed)
    image = torch.rand(*batch, 3, 4, 5, dtype=torch.float64, generator=generator)
    result = back(there(image))
    assert result.dtype == torch.float64
    assert torch.allclose(result.reshape(image.shape), image, rtol=0, atol=tolerance)
    assert there(image.float()).dtype == torch.float32


@pytest.mark.parametrize(("name", "tolerance"), [("sRGB", 1e-6), ("XYZ", 1e-6), ("HSV", 5e-6), ("Lab", 1e-6)])
def test_round_trip_in_single_precision(name, tolerance):
    """A hue of up to 2π is a place on a way of six sextants, each as long as a colour's range: 6·6·eps = 4.3e-6."""
    there, back, _ = PAIRS[name]
    image = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0))
    assert (back(there(image)) - image).abs().max() < tolerance


def test_a_batch_is_its_pictures():
    images = torch.rand(2, 2, 3, 3, 4, generator=torch.Generator().manual_seed(1))
    for there, back, _ in PAIRS.values():
        for function in (there, back):
            whole = function(images)
            assert whole.shape == images.shape
            one = function(images[1, 0])
            assert one.shape in ((1, 3, 3, 4), (3, 3, 4))
            assert torch.allclose(whole[1, 0], one.reshape(3, 3, 4), atol=1e-6)


def test_srgb_against_the_standard():
    # IEC 61966-2-1: 8-bit codes and their light.
    codes = torch.tensor([0.0, 10.0, 11.0, 128.0, 255.0], dtype=torch.float64) / 255
    expected = [0.0, 10 / 255 / 12.92, ((11 / 255 + 0.055) / 1.055) ** 2.4, 0.2158605001138992, 1.0]
    light = p.rgb_to_linear_rgb(codes.expand(3, 1, 5))
    assert light[0, 2, 0].tolist() == pytest.approx(expected, abs=1e-12)
    assert p.linear_rgb_to_rgb(light)[0, 1, 0].tolist() == pytest.approx(codes.tolist(), abs=1e-7)
    # Beyond the gamut: the straight part below, the power above.
    assert listed(p.rgb_to_linear_rgb(colour(-0.1, -1.0, 2.0))) == pytest.approx(
        [-0.1 / 12.92, -1 / 12.92, (2.055 / 1.055) ** 2.4]
    )
    assert listed(p.linear_rgb_to_rgb(colour(0.004, 0.004, 0.006), 0.005)[:, 1:]) == pytest.approx(
        [12.92 * 0.004, 1.055 * 0.006 ** (1 / 2.4) - 0.055]
    )


def test_xyz_matrices():
    kept = [
        [0.412453, 0.357580, 0.180423],
        [0.212671, 0.715160, 0.072169],
        [0.019334, 0.119193, 0.950227],
    ]
    identity = torch.eye(3, dtype=torch.float64)[..., None, None]
    assert torch.allclose(
        p.linear_rgb_to_xyz(identity)[..., 0, 0].T, torch.tensor(kept, dtype=torch.float64), atol=1e-6
    )
    # IEC 61966-2-1, exact as fractions (CSS Color 4, section 18).
    exact = [
        [506752 / 1228815, 87881 / 245763, 12673 / 70218],
        [87098 / 409605, 175762 / 245763, 12673 / 175545],
        [7918 / 409605, 87881 / 737289, 1001167 / 1053270],
    ]
    result = p.linear_rgb_to_xyz(identity, white=IEC_WHITE)[..., 0, 0].T
    assert torch.allclose(result, torch.tensor(exact, dtype=torch.float64), rtol=0, atol=1e-15)
    assert torch.equal(result, p.rgb_to_xyz_matrix())
    for white in (XYZ_WHITE, IEC_WHITE):
        assert listed(p.linear_rgb_to_xyz(colour(1, 1, 1), white=white)) == pytest.approx(list(white), abs=1e-12)
        image = torch.randn(2, 3, 4, 4, dtype=torch.float64)
        back = p.xyz_to_linear_rgb(p.linear_rgb_to_xyz(image, white=white), white=white)
        assert torch.allclose(back, image, atol=1e-13)


def test_lab_of_known_colours():
    # colour-science 0.4.7 with the derived matrix and white (0.31271, 0.32902).
    for rgb, lab in (
        ((1, 0, 0), (53.236878530389575, 80.09347433860609, 67.20052009274278)),
        ((0.2, 0.5, 0.8), (52.25323872100624, 2.783642941673159, -46.28822953605307)),
        ((0.9, 0.1, 0.04), (48.86225776544906, 71.44327559300567, 59.63327836077974)),
        ((1, 1, 1), (100, 0, 0)),
        ((0, 0, 0), (0, 0, 0)),
    ):
        assert listed(p.srgb_to_lab(colour(*rgb))) == pytest.approx(lab, abs=1e-9)
    # Mid grey of 18 % light.
    grey = p.linear_rgb_to_rgb(colour(0.18, 0.18, 0.18))
    assert listed(p.srgb_to_lab(grey))[0] == pytest.approx(116 * 0.18 ** (1 / 3) - 16, abs=1e-9)


def test_lab_layouts():
    image = torch.rand(4, 5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    assert torch.equal(p.srgb_to_lab(image), p.srgb_to_lab(image.permute(2, 0, 1)))
    # The first axis decides.
    three = torch.rand(3, 4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    assert torch.allclose(p.srgb_to_lab(three)[None], p.srgb_to_lab(three[None]), rtol=0, atol=1e-12)
    assert p.srgb_to_lab(three).shape == (3, 4, 3)
    assert torch.allclose(p.lab_to_srgb(p.srgb_to_lab(three)), three)


def test_hsv_of_known_colours():
    third = 2 * math.pi / 3
    for rgb, hsv in (
        ((1, 0, 0), (0, 1, 1)),
        ((0, 1, 0), (third, 1, 1)),
        ((0, 0, 1), (2 * third, 1, 1)),
        ((1, 1, 0), (third / 2, 1, 1)),
        ((0.5, 0.25, 0.25), (0, 0.5, 0.5)),
        ((0.3, 0.3, 0.3), (0, 0, 0.3)),
        ((0, 0, 0), (0, 0, 0)),
        ((0.4, 0.1, 0.7), (math.radians(270), 6 / 7, 0.7)),
    ):
        assert listed(p.rgb_to_hsv(colour(*rgb))) == pytest.approx(hsv, abs=1e-7)
        assert listed(p.hsv_to_rgb(colour(*hsv))) == pytest.approx(rgb, abs=1e-12)
    nearly_red = p.rgb_to_hsv(colour(1.0, 0.0, 1e-7, dtype=torch.float32))
    assert 0 <= nearly_red[0, 0, 0, 0] < 2 * math.pi
    assert listed(p.hsv_to_rgb(colour(2 * math.pi + third, 1, 1))) == pytest.approx([0, 1, 0], abs=1e-12)


def test_offset_of_dark_saturations():
    for options, eps in (({}, 1e-8), ({"eps": 0.2}, 0.2)):
        assert listed(p.rgb_to_hsv(colour(eps, 0, 0), **options)) == pytest.approx([0, 0.5, eps], rel=1e-9)
    with pytest.raises(ValueError, match="eps must"):
        p.rgb_to_hsv(colour(1, 0, 0), eps=-1e-9)


def test_ycrcb_of_known_colours():
    assert listed(p.rgb_2_ycrcb(colour(0.4, 0.4, 0.4))) == pytest.approx([0.4, 0.5, 0.5])
    assert listed(p.rgb_2_ycrcb(colour(1, 0, 0))) == pytest.approx([0.299, 0.5 + 0.713 * 0.701, 0.5 - 0.564 * 0.299])
    assert listed(p.ycrcb_2_rgb(colour(0.5, 0.6, 0.3))) == pytest.approx(
        [0.5 + 0.1403, 0.5 - 0.0714 + 0.0688, 0.5 - 0.3546]
    )


@pytest.mark.parametrize(
    "function", [function for pair in PAIRS.values() for function in pair[:2]], ids=lambda f: f.__name__
)
def test_gradients_are_finite_everywhere_and_right(function):
    for value in (0.0, 1.0, -0.5, 0.04045, 0.0031308, 0.25, 2.0):
        image = torch.full((1, 3, 2, 2), value, dtype=torch.float64, requires_grad=True)
        function(image).sum().backward()
        assert torch.isfinite(image.grad).all()
    generator = torch.Generator().manual_seed(3)
    image = torch.rand(1, 3, 2, 3, dtype=torch.float64, generator=generator, requires_grad=True)
    assert torch.autograd.gradcheck(function, image, fast_mode=True)


def test_noise_far_outside_stays_finite():
    noise = (2 * torch.randn(1, 3, 32, 32, generator=torch.Generator().manual_seed(4))).clamp(-8, 8)
    for function in (function for pair in PAIRS.values() for function in pair[:2]):
        assert torch.isfinite(function(noise)).all()


def test_change_primaries():
    # ITU-R BT.2087-0, four digits.
    identity = torch.eye(3, dtype=torch.float64)[..., None, None]
    expected = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]]
    result = p.change_primaries(identity)[..., 0, 0].T
    assert torch.allclose(result, torch.tensor(expected, dtype=torch.float64), rtol=0, atol=5.1e-5)
    for source in PRIMARIES:
        there = p.change_primaries(identity, source, "BT.2020")
        assert torch.allclose(p.change_primaries(there, "BT.2020", source), identity, atol=1e-13)
        assert listed(p.change_primaries(colour(1, 1, 1), source, "BT.709")) == pytest.approx([1, 1, 1], abs=1e-13)


def test_matrices_of_wide_gamuts():
    # Exact fractions of the chromaticities, as CSS Color 4, section 18, has them.
    wide = {
        "Display P3": [
            [608311 / 1250200, 189793 / 714400, 198249 / 1000160],
            [35783 / 156275, 247089 / 357200, 198249 / 2500400],
            [0, 32229 / 714400, 5220557 / 5000800],
        ],
        "BT.2020": [
            [63426534 / 99577255, 20160776 / 139408157, 47086771 / 278816314],
            [26158966 / 99577255, 472592308 / 697040785, 8267143 / 139408157],
            [0, 19567812 / 697040785, 295819943 / 278816314],
        ],
    }
    for name, expected in wide.items():
        found = p.rgb_to_xyz_matrix(PRIMARIES[name])
        assert torch.allclose(found, torch.tensor(expected, dtype=torch.float64), rtol=0, atol=1e-14)


@pytest.mark.parametrize("batch", [(2,), (2, 3)])
def test_a_matrix_learns(batch):
    generator = torch.Generator().manual_seed(8)
    image = torch.rand(*batch, 3, 2, 5, dtype=torch.float64, generator=generator, requires_grad=True)
    matrix = torch.rand(4, 3, dtype=torch.float64, generator=generator, requires_grad=True)
    expected = torch.einsum("ij,...jkl->...ikl", matrix, image)
    assert torch.allclose(mix(matrix, image), expected, rtol=0, atol=1e-14)
    assert torch.allclose(mix(matrix.detach(), image), expected, rtol=0, atol=1e-14)
    assert torch.autograd.gradcheck(mix, (matrix, image), fast_mode=True)


def test_constants_are_made_once_and_fit_for_gradients():
    entries = ((0.25, 0.5), (0.75, 1.0))
    with torch.inference_mode():
        made = constant(entries, torch.float64, torch.device("cpu"))
    assert constant(entries, torch.float64, torch.device("cpu")) is made
    assert not made.is_inference()
    assert made.tolist() == [[0.25, 0.5], [0.75, 1.0]]


def test_color_map_gives_the_colours_of_the_target():
    generator = torch.Generator().manual_seed(5)
    source, target = (torch.rand(3, *size, dtype=torch.float64, generator=generator) for size in ((9, 7), (6, 11)))
    result = p.srgb_to_lab(p.color_map(source, target))
    wanted = p.srgb_to_lab(target)
    assert torch.allclose(result.mean((-2, -1)), wanted.mean((-2, -1)), atol=1e-9)
    assert torch.allclose(result.std((-2, -1)), wanted.std((-2, -1)), atol=1e-9)
    assert torch.allclose(p.color_map(source, source), source, atol=1e-12)
    flat = torch.full((3, 9, 7), 0.3, requires_grad=True)
    mapped = p.color_map(flat, target.float())
    assert torch.allclose(mapped, mapped.mean((-2, -1), keepdim=True).expand_as(mapped), atol=1e-5)
    mapped.sum().backward()
    assert torch.isfinite(flat.grad).all()
    with pytest.raises(ValueError, match="model must be one of 'Lab Stats'"):
        p.color_map(source, target, "Histogram")
    for few in (source[:, :2, :1], source[:, :1, :2]):
        assert torch.allclose(p.color_map(few, few), few, atol=1e-12)
    for pictures, name in (
        ((source[:, :1, :1], target), "input_image"),
        ((source, target[:, :1, :1]), "target_image"),
        ((source[None][:0], target), "input_image"),
    ):
        with pytest.raises(ValueError, match=f"{name} must have two pixels or more"):
            p.color_map(*pictures)


def test_color_map_raises_weak_contrast_but_not_rounding():
    generator = torch.Generator().manual_seed(7)
    target, noise = torch.rand(3, 6, 11, generator=generator), torch.randn(3, 9, 7, generator=generator)
    wanted = p.srgb_to_lab(target).std((-2, -1))
    weak = p.srgb_to_lab(p.color_map(0.3 + 1e-5 * noise, target)).std((-2, -1))
    assert torch.allclose(weak, wanted, rtol=1e-3)
    rounded = p.srgb_to_lab(p.color_map(0.3 + 3e-8 * noise, target)).std((-2, -1))
    assert rounded.max() < 1e-4


def test_rgb_to_gray():
    image = torch.rand(3, 4, 5, generator=torch.Generator().manual_seed(6))
    grey = p.rgb_to_gray(image)
    assert grey.shape == (1, 4, 5)
    assert torch.allclose(grey[0], 0.299 * image[0] + 0.587 * image[1] + 0.114 * image[2])
    assert torch.equal(p.rgb_to_gray(image.permute(1, 2, 0)), grey[0])
    batch = torch.stack([image, image.flip(0)])
    assert torch.equal(p.rgb_to_gray(batch), torch.stack([grey, p.rgb_to_gray(image.flip(0))]))
    for shape in ((1, 4, 4, 3), (4, 4), (4, 4, 4)):
        with pytest.raises(ValueError, match="image must be"):
            p.rgb_to_gray(torch.zeros(shape))
    for value in ([1.0], torch.zeros(3, 2, 2, dtype=torch.uint8)):
        with pytest.raises(TypeError, match="image must be a tensor of real floats"):
            p.rgb_to_gray(value)


def test_saturation_of_negative_colours():
    for rgb, saturation in (((-0.5, -0.25, -0.4), -1.0), ((0.5, -0.25, 0.0), 1.5)):
        hsv = p.rgb_to_hsv(colour(*rgb))
        assert listed(hsv)[1:] == pytest.approx([saturation, max(rgb)], rel=1e-7)
        assert listed(p.hsv_to_rgb(hsv)) == pytest.approx(rgb, rel=1e-7, abs=1e-7)


def test_spaces_refused():
    with pytest.raises(ValueError, match="primaries must be three pairs"):
        p.rgb_to_xyz_matrix(BT709_PRIMARIES[:2])
    with pytest.raises(ValueError, match="white must be three numbers"):
        p.rgb_to_xyz_matrix(white=(1, 1))
    for pair in ((0.3, 0.6, 0.1), (0.3, 0.0), (0.3, -0.1), (0.3,)):
        with pytest.raises(ValueError, match="primaries must be three pairs"):
            p.rgb_to_xyz_matrix((pair, *BT709_PRIMARIES[1:]))
    for primaries in (0.3, "RGB"):
        with pytest.raises(TypeError, match="primaries must be three pairs"):
            p.rgb_to_xyz_matrix(primaries)
    for white in ((0.95, 1.0, 0.0), (0.95, 1.0, -1.09)):
        with pytest.raises(ValueError, match="white must be positive"):
            p.rgb_to_xyz_matrix(white=white)
    with pytest.raises(ValueError, match="target must be one of"):
        p.change_primaries(torch.zeros(3, 1, 1), target="NTSC")


def test_gradients_after_inference_mode():
    image = torch.rand(1, 3, 2, 2, dtype=torch.float64, requires_grad=True)
    with torch.inference_mode():
        p.linear_rgb_to_xyz(image, white=(0.9, 1.0, 1.05))
    p.linear_rgb_to_xyz(image, white=(0.9, 1.0, 1.05)).sum().backward()
    assert torch.isfinite(image.grad).all()
