"""Colour spaces of XYZ against values of colour-science 0.4.7; gamut and tone mapping by their properties."""

import itertools
import math

import numpy as np
import pytest
import torch

from odak.learn import perception as p
from odak.learn.perception.color_spaces import SPACES

D65, D50 = (0.950455927052, 1.0, 1.08905775076), (0.96429567643, 1.0, 0.82510460251)
COLOUR = (0.20654008, 0.12197225, 0.05136952)


# Of linear BT.709 (0.6, 0.2, 0.1), with matrices derived from the chromaticities.
ADOBE = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06))
WIDE = [
    ("DCI-P3", "Bradford", (0.547181783704151, 0.21345134376335156, 0.11548971429941372)),
    ("DCI-P3", "CAT16", (0.5492811537531507, 0.21394243718537004, 0.11395818576464593)),
    ("Adobe RGB", "Bradford", (0.4860502427422499, 0.2, 0.10411619484501186)),
    (ADOBE, "Bradford", (0.4860502427422499, 0.2, 0.10411619484501186)),
    ("ACEScg", "Bradford", (0.4405010158190043, 0.2267322491405252, 0.12126477373492697)),
    ("ACEScg", "CAT16", (0.43856614223224344, 0.22550580189280292, 0.1206245076037538)),
    (
        ((0.713, 0.293), (0.165, 0.83), (0.128, 0.044), (0.32168, 0.33767)),
        "Bradford",
        (0.4405010158190043, 0.2267322491405252, 0.12126477373492697),
    ),
]


def pixel(values):
    return torch.tensor(values, dtype=torch.float64).reshape(1, 3, 1, 1)


def noise(*shape, low=0.02, high=1.0):
    return low + (high - low) * torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    ("function", "colour", "expected"),
    [
        (lambda v: p.xyz_to_lab(v, D50), COLOUR, (41.527875294398, 51.193541738327, 19.918430978332)),
        (lambda v: p.xyz_to_luv(v, D50), COLOUR, (41.527875294398, 90.709259615186, 7.084552733731)),
        (lambda v: p.adapt_chromatically(v, D65, D50), COLOUR, (0.216660031997, 0.12604777264, 0.038550678163)),
        (
            lambda v: p.adapt_chromatically(v, D65, D50, "CAT16"),
            COLOUR,
            (0.211993263949, 0.122369931058, 0.038100084979),
        ),
        (p.xyz_to_oklab, COLOUR, (0.516340191406, 0.154694999017, 0.062895787289)),
        (p.rgb_to_ictcp, (456.20519, 30.81071, 40.91952), (0.546773236905, -0.004498820391, 0.323127158414)),
        (p.xyz_to_xyy, COLOUR, (0.5436955727155692, 0.321079435619259, 0.12197225)),
        *(
            (lambda v, to=to, how=how: p.change_primaries(v, "BT.709", to, how), (0.6, 0.2, 0.1), values)
            for to, how, values in WIDE
        ),
    ],
)
def test_values_of_colour_science(function, colour, expected):
    found = function(pixel(colour)).flatten().tolist()
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-10)


PAIRS = [
    (lambda v: p.xyz_to_lab(v, D50), lambda v: p.lab_to_xyz(v, D50)),
    (lambda v: p.xyz_to_luv(v, D50), lambda v: p.luv_to_xyz(v, D50)),
    (p.xyz_to_lms, p.lms_to_xyz),
    (lambda v: p.xyz_to_lms(v, "CAT16"), lambda v: p.lms_to_xyz(v, "CAT16")),
    (p.xyz_to_oklab, p.oklab_to_xyz),
    (p.xyz_to_xyy, p.xyy_to_xyz),
    (lambda v: p.oklab_to_oklch(v - 0.5), lambda v: p.oklch_to_oklab(v) + 0.5),
    (lambda v: p.rgb_to_ictcp(1000 * v), lambda v: p.ictcp_to_rgb(v) / 1000),
]


@pytest.mark.parametrize(("there", "back"), PAIRS)
def test_round_trips_and_gradients(there, back):
    # Dark enough for the straight lines of L*.
    colours = torch.cat([noise(1, 3, 4, 5), 0.003 * noise(1, 3, 4, 5)], -1)
    torch.testing.assert_close(back(there(colours)), colours, rtol=1e-9, atol=1e-11)
    assert there(colours[0]).shape == colours.shape
    assert there(colours.float()).dtype == torch.float32
    bright = noise(1, 3, 2, 2, low=0.2).requires_grad_()
    assert torch.autograd.gradcheck(there, bright, fast_mode=True)
    assert torch.autograd.gradcheck(lambda v: back(there(v)), bright, fast_mode=True)


def test_whites_and_black():
    for white in (D65, D50):
        torch.testing.assert_close(p.xyz_to_lab(pixel(white), white), pixel((100, 0, 0)), atol=1e-9, rtol=0)
        torch.testing.assert_close(p.xyz_to_luv(pixel(white), white), pixel((100, 0, 0)), atol=1e-9, rtol=0)
    for cones in ("Bradford", "CAT16", "Hunt-Pointer-Estevez"):
        torch.testing.assert_close(p.adapt_chromatically(pixel(D65), D65, D50, cones), pixel(D50))
    for function in (p.xyz_to_lab, p.xyz_to_luv, p.xyz_to_oklab, p.oklab_to_oklch, p.luv_to_xyz):
        black = torch.zeros(1, 3, 1, 1, dtype=torch.float64, requires_grad=True)
        value = function(black)
        assert value.abs().max() < 1e-12
        value.sum().backward()
        assert black.grad.isfinite().all()
    # In steps of 8-bit greys the gradient of Oklab is bounded, and the values are those of the definition.
    dark = torch.tensor([0, 1e-9, 1e-5, 4e-4], dtype=torch.float64).expand(1, 3, 1, 4).clone().requires_grad_()
    value = p.xyz_to_oklab(dark)
    torch.testing.assert_close(value[0, 0, 0, 1:3] ** 3, dark[0, 0, 0, 1:3] * value[0, 0, 0, 3] ** 3 / 4e-4)
    value[:, 0].sum().backward()
    slopes = dark.grad.sum(1).flatten()
    assert slopes[:3].tolist() == pytest.approx([slopes[0].item()] * 3) and 70 < slopes[0] < 80
    # BT.2100: I is PQ's 0.508 for grey of 100 cd/m², which has no chroma.
    assert p.rgb_to_ictcp(pixel((100, 100, 100))).flatten().tolist() == pytest.approx([0.508078, 0, 0], abs=1e-6)


def test_gamut_mapping_keeps_lightness_and_hue():
    image = noise(1, 3, 20, 20, low=-0.4, high=1.4)
    mapped = p.map_to_gamut(image)
    assert mapped.min() >= 0 and mapped.max() <= 1
    inside = ((image >= 0) & (image <= 1)).all(1, keepdim=True)
    assert torch.equal(torch.where(inside, image, 0.0), torch.where(inside, mapped, 0.0))
    assert 0 < inside.double().mean() < 0.5

    def oklch(rgb):
        return p.oklab_to_oklch(p.xyz_to_oklab(p.linear_rgb_to_xyz(rgb, white=IEC_WHITE)))[0].flatten(1)

    before, after = oklch(image), oklch(mapped)
    clear = (before[0] > 0.05) & (before[0] < 0.95) & (after[1] > 0.02)
    torch.testing.assert_close(after[0, clear], before[0, clear], rtol=0, atol=1e-6)
    turn = torch.remainder(after[2, clear] - before[2, clear] + math.pi, 2 * math.pi) - math.pi
    assert turn.abs().max() < 1e-4
    assert (after[1, clear] <= before[1, clear] + 1e-9).all()
    # The mapped colours lie on the surface: a little more chroma leaves the gamut.
    outside = ~inside.flatten() & clear
    level, chroma, hue = after[:, outside]
    more = p.oklch_to_oklab(torch.stack([level, 1.01 * chroma, hue])[None, :, None])
    rgb = p.xyz_to_linear_rgb(p.oklab_to_xyz(more), white=IEC_WHITE)
    assert ((rgb < 0) | (rgb > 1)).any(1).all()


IEC_WHITE = (0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290)


@pytest.mark.parametrize("method", ["Reinhard", "Hable"])
def test_tone_mapping(method):
    ramp = torch.linspace(0, 4, 50, dtype=torch.float64).expand(1, 3, 1, 50)
    mapped = p.tone_map(ramp, method, white=4.0)
    assert mapped[0, 0, 0, 0].item() == pytest.approx(0, abs=1e-12)
    assert mapped[0, :, 0, -1].tolist() == pytest.approx([1, 1, 1])
    assert (mapped.diff(dim=-1) > 0).all()
    if method == "Reinhard":
        assert mapped[0, 0, 0].tolist() == pytest.approx([v * (1 + v / 16) / (1 + v) for v in ramp[0, 0, 0].tolist()])
        colours = noise(1, 3, 3, 3)
        ratio = p.tone_map(colours) / colours
        torch.testing.assert_close(ratio, ratio[:, :1].expand_as(ratio))
    assert torch.autograd.gradcheck(lambda v: p.tone_map(v, method), noise(1, 3, 2, 2).requires_grad_(), fast_mode=True)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda v: p.xyz_to_lab(v, (1, 1)), "white must be three numbers"),
        (lambda v: p.change_primaries(v, ADOBE[:2]), r"source must be a name, or three or four pairs \(x, y\)"),
        (lambda v: p.change_primaries(v, target="P4"), "target must be one of"),
        (lambda v: p.map_to_gamut(v[:, :2]), r"image must be pictures \[..., 3, H, W\]"),
        (lambda v: p.adapt_chromatically(v, D65, (0, 1, 1)), "target_white must be positive"),
    ],
)
def test_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call(noise(1, 3, 2, 2))


def test_difference_of_colours_in_ictcp():
    pair = (0.4885468072, -0.04739350675, 0.07475401302), (0.4899203231, -0.04567508203, 0.07361341775)
    first, second = (pixel(values).requires_grad_() for values in pair)
    assert p.delta_e_itp(first, second).item() == pytest.approx(1.4265722824575673, rel=1e-11)
    assert torch.autograd.gradcheck(p.delta_e_itp, (first, second), fast_mode=True)
    (gradient,) = torch.autograd.grad(p.delta_e_itp(first, first.detach()), first)
    assert not gradient.any()


def test_black_has_the_chromaticity_of_the_white():
    black = torch.zeros(1, 3, 1, 1, dtype=torch.float64, requires_grad=True)
    found = p.xyz_to_xyy(black)
    assert found.flatten().tolist() == pytest.approx([0.3127, 0.3290, 0])
    found.sum().backward()
    assert black.grad.isfinite().all()
    assert not p.xyy_to_xyz(pixel((0.3, 0.0, 0.5))).any()


@pytest.mark.parametrize(
    ("there", "back"),
    [
        (p.xyz_to_lab, p.lab_to_xyz),
        (p.xyz_to_luv, p.luv_to_xyz),
        (p.xyz_to_lms, p.lms_to_xyz),
        (p.xyz_to_oklab, p.oklab_to_xyz),
        (p.xyz_to_xyy, p.xyy_to_xyz),
        (p.rgb_to_ictcp, p.ictcp_to_rgb),
        (p.srgb_to_lab, p.lab_to_srgb),
    ],
)
def test_half_precision_rounds_once(there, back):
    colours = noise(1, 3, 16, 16).bfloat16()
    for function, values in ((there, colours), (back, there(colours))):
        assert torch.equal(function(values), function(values.float()).bfloat16())


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_keeps_digits_and_gradients_at_black(dtype):
    light = torch.logspace(-3, 4, 40, dtype=torch.float64).to(dtype)
    signal = p.pq_encode(light)
    assert signal.dtype == dtype
    step = torch.finfo(dtype).eps
    torch.testing.assert_close(signal.double(), p.pq_encode(light.double()), rtol=step, atol=0)
    torch.testing.assert_close(p.pq_decode(signal).double(), p.pq_decode(signal.double()), rtol=step, atol=1e-6)
    for function in (p.xyz_to_oklab, p.rgb_to_ictcp, p.xyz_to_lab):
        black = torch.zeros(1, 3, 1, 1, dtype=dtype, requires_grad=True)
        function(black).sum().backward()
        assert black.grad.isfinite().all()


def test_a_cube_file_of_a_matrix_is_the_matrix(tmp_path):
    matrix = torch.tensor([[0.7, 0.2, 0.1], [0.1, 0.8, 0.1], [0.0, 0.1, 0.9]], dtype=torch.float64)
    lines = ['TITLE "a matrix"', "# comment", "LUT_3D_SIZE 5", "DOMAIN_MIN -1 -1 -1", "DOMAIN_MAX 1 1 1"]
    steps = torch.linspace(-1, 1, 5, dtype=torch.float64)
    for blue, green, red in itertools.product(steps, repeat=3):
        lines.append(" ".join(f"{value:.17g}" for value in (matrix @ torch.stack([red, green, blue])).tolist()))
    (tmp_path / "matrix.cube").write_text("\n".join(lines))
    table = p.ColorTable.read(tmp_path / "matrix.cube")
    image = 2 * torch.rand(2, 3, 4, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 1
    # What is linear is exact between the entries, and what lies beyond is that of the nearest place within.
    torch.testing.assert_close(table(image), torch.einsum("cd,bdhw->bchw", matrix, image), rtol=0, atol=1e-14)
    torch.testing.assert_close(table(3 * image), table((3 * image).clamp(-1, 1)))
    assert torch.autograd.gradcheck(lambda x: table(x), (0.9 * image[:, :, :2, :2]).requires_grad_(), fast_mode=True)
    assert table(image.half()).dtype == torch.float16


def test_curves_of_a_cube_file_act_on_each_channel(tmp_path):
    x = np.linspace(0, 1, 17)
    curves = np.stack([x**2, np.sqrt(x), 1 - x], -1)
    text = "LUT_1D_SIZE 17\n" + "\n".join(" ".join(f"{v:.9f}" for v in line) for line in curves)
    (tmp_path / "curves.cube").write_text(text)
    image = np.random.default_rng(0).uniform(-0.2, 1.2, (3, 6, 7))
    expected = np.stack([np.interp(image[c], x, curves[:, c]) for c in range(3)])
    found = p.ColorTable.read(tmp_path / "curves.cube")(torch.from_numpy(image))
    np.testing.assert_allclose(found[0].numpy(), expected, atol=1e-8)


@pytest.mark.parametrize(
    "text, message",
    [
        ("LUT_3D_SIZE 300\n", "LUT_3D_SIZE must be 2 to 256, got 300"),
        ("LUT_3D_SIZE 2\n0 0 0\n", "must have 8 lines of three numbers"),
        ("LUT_1D_SIZE 2\n0 0 0\n1 1 x\n", "is not a .cube file"),
        ("nothing\n", "it states no size of a table"),
        ("LUT_1D_SIZE 2\nDOMAIN_MAX 0 1 1\n0 0 0\n1 1 1\n", "highest must be above lowest"),
        ("LUT_1D_SIZE 2\n0 0 0\n1 1 nan\n", "values must be finite"),
    ],
)
def test_cube_files_that_cannot_be_read_are_named(tmp_path, text, message):
    (tmp_path / "bad.cube").write_text(text)
    with pytest.raises(ValueError, match=message):
        p.ColorTable.read(tmp_path / "bad.cube")


# Of colour-science 0.4.7: XYZ of COLOUR and of a blue in the new spaces, D65 of 100 cd/m², an average surround.
BLUE = (0.05, 0.2, 0.5)
BY_NAME = [
    ("Jzazbz", COLOUR, (0.07467469714842555, 0.07074008408803434, 0.04720525465535039)),
    ("Jzazbz", BLUE, (0.07030077201765945, -0.15542964233371576, -0.07495076245687236)),
    ("CAM02-UCS", COLOUR, (46.61386153972116, 29.883100132084866, 12.12351683344614)),
    ("CAM02-UCS", BLUE, (48.78611137199782, -40.18780727502057, -17.144454893087854)),
    ("CAM16-UCS", COLOUR, (46.06586037046291, 31.021611988639023, 10.95854227755084)),
    ("CAM16-UCS", BLUE, (50.17094876948537, -39.164609358635374, -16.33553074935836)),
]


@pytest.mark.parametrize(("space", "colour", "expected"), BY_NAME)
def test_spaces_by_name_are_those_of_colour_science(space, colour, expected):
    found = p.convert_color(pixel(colour), "XYZ", space).flatten()
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("space", SPACES)
def test_every_space_has_its_inverse_and_gradient(space):
    picture = noise(1, 3, 3, 4, low=0.05, high=0.95)
    there = p.convert_color(picture, "sRGB", space)
    torch.testing.assert_close(p.convert_color(there, space, "sRGB"), picture, rtol=0, atol=1e-12)
    assert torch.autograd.gradcheck(
        lambda v: p.convert_color(v, "sRGB", space), picture.requires_grad_(), fast_mode=True
    )
    assert torch.autograd.gradcheck(
        lambda v: p.convert_color(v, space, "XYZ"), there.detach().requires_grad_(), fast_mode=True
    )


@pytest.mark.parametrize("space", SPACES)
def test_black_and_grey_have_finite_gradients(space):
    picture = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64).expand(1, 3, 1, 3).clone().requires_grad_()
    value = p.convert_color(picture, "sRGB", space)
    (slope,) = torch.autograd.grad(value.sum(), picture)
    assert value.isfinite().all()
    assert slope.isfinite().all()


# Black, white, grey and the saturated corners of sRGB.
CORNERS = [(0.5, 0.5, 0.5), *itertools.product((0.0, 1.0), repeat=3)]


@pytest.mark.parametrize("corner", CORNERS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_colour_is_where_a_descent_cannot_leave(corner, dtype):
    colour = torch.tensor(corner, dtype=dtype).reshape(1, 3, 1, 1)
    weights = torch.tensor((1.0, 0.37, -0.61), dtype=dtype).reshape(1, 3, 1, 1)
    conversions = [(p.convert_color(colour, "sRGB", space), space, "XYZ") for space in SPACES]
    conversions += [(p.convert_color(colour, "sRGB", "XYZ"), "XYZ", space) for space in SPACES]
    functions = [
        (lambda v, one=one, other=other: p.convert_color(v, one, other), value) for value, one, other in conversions
    ]
    functions += [(convert, colour) for convert in (p.rgb_to_hsv, p.pq_decode, p.hlg_decode, p.hlg_to_luminance)]
    functions += [(lambda v: p.pu21_encode(100 * v), colour), (lambda v: p.pq_encode(100 * v), colour)]
    for function, value in functions:
        value = value.detach().requires_grad_()
        (slope,) = torch.autograd.grad((function(value) * weights).sum(), value)
        assert slope.isfinite().all() and slope.any()


@pytest.mark.parametrize("model", ["CAM02-UCS", "CAM16-UCS"])
def test_dark_greys_of_models_of_appearance_share_a_slope(model):
    # Of J' along the greys: that of a grey of 1/255, of its neighbours by differences, down to black.
    def lightness(grey):
        return p.convert_color(grey.reshape(1, 1, 1, -1).expand(1, 3, 1, -1), "RGB", model)[0, 0, 0]

    edge = 1 / (255 * 12.92)
    greys = torch.tensor([0.0, edge / 100, edge / 2, edge, 1.5 * edge], dtype=torch.float64).requires_grad_()
    (slope,) = torch.autograd.grad(lightness(greys).sum(), greys)
    near = greys.detach()[3:, None] + torch.tensor([-1e-8, 1e-8], dtype=torch.float64)
    true = (lightness(near.flatten()).reshape(2, 2).diff() / near.diff()).flatten()
    assert slope[-1].item() == pytest.approx(true[1].item(), rel=1e-5)
    assert slope[:4].tolist() == pytest.approx([true[0].item()] * 4, rel=0.03)
    below = torch.full((1, 3, 1, 1), -0.01, dtype=torch.float64, requires_grad=True)
    value = p.convert_color(below, "RGB", model)
    assert value.abs().max() < 1e-9 and torch.autograd.grad(value[0, 0].sum(), below)[0].sum() > 0


def test_jzazbz_depends_on_the_luminance_of_white():
    # Of colour-science 0.4.7.
    for level, expected in ((100, 0.167173427699), (9000, 0.947629077583)):
        lightness = p.convert_color(pixel(D65), "XYZ", "Jzazbz", luminance=level)[0, 0]
        assert float(lightness) == pytest.approx(expected, rel=1e-10)
    with pytest.raises(ValueError, match="source must be one of 'XYZ'"):
        p.convert_color(pixel(COLOUR), "HSV", "Lab")


# Of colour-science 0.4.7.
PAIRS = (
    ((48.99183622, -0.10561667, 400.65619925), (50.65907324, -0.1167191, 402.82235718)),
    ((50, 20, -30), (55, 25, -20)),
    ((10, 5, 5), (14, -3, 8)),
)
DIFFERENCES = {
    "CIE 1994": (1.6711191305411999, 8.552709717211656, 8.668667991714447),
    "CIE 1994 textiles": (0.8404677623912705, 7.512288903200256, 7.990869939135803),
    "CMC 2:1": (0.8996999756834185, 8.02928097130432, 14.653676962306088),
    "CMC 1:1": (1.6150216342890757, 8.96101582831241, 16.14577204329279),
}


@pytest.mark.parametrize("formula", DIFFERENCES)
def test_differences_of_1994_and_of_the_cmc(formula):
    first, second = torch.tensor(PAIRS, dtype=torch.float64).permute(1, 2, 0)[:, None, :, :, None]
    found = p.color_difference(first, second, formula)
    expected = torch.tensor(DIFFERENCES[formula], dtype=torch.float64)
    torch.testing.assert_close(found.flatten(), expected, rtol=1e-10, atol=1e-10)
    assert torch.autograd.gradcheck(
        lambda v: p.color_difference(v, second, formula), first.clone().requires_grad_(), fast_mode=True
    )
    same = first.clone().requires_grad_()
    (slope,) = torch.autograd.grad(p.color_difference(same, first, formula).sum(), same)
    assert slope.abs().max() == 0


def test_differences_by_name_are_those_of_their_functions():
    first, second = torch.tensor(PAIRS, dtype=torch.float64).permute(1, 2, 0)[:, None, :, :, None]
    assert torch.equal(p.color_difference(first, second), p.ciede2000(first, second))
    assert torch.equal(p.color_difference(first, second, "CIE 1976"), p.delta_e(first, second))
