"""Appearance and temperature of colours against colour-science 0.4.7, opponent colours against cvvdp 0.5.7."""

import math

import pytest
import torch

from odak.learn import perception as p
from odak.learn.perception.color import IEC_WHITE

ROOM = (IEC_WHITE, 64 / math.pi * 0.2, 20)
BRIGHT = (IEC_WHITE, 318.31, 30)
COLOUR, DARK = (0.20654008, 0.12197225, 0.05136952), (0.001, 0.002, 0.01)


def pixel(values):
    return torch.tensor(values, dtype=torch.float64).reshape(1, 3, 1, 1)


@pytest.mark.parametrize(
    ("colour", "viewing", "expected"),
    [
        (COLOUR, ROOM, (46.06586037046291, 31.02161198863903, 10.958542277550844)),
        ((0.45, 0.4, 0.05), ROOM, (72.98323422424667, 8.58476999369361, 28.035252173682974)),
        (IEC_WHITE, ROOM, (100, -1.8982508108669767, -1.0754370257312404)),
        (DARK, ROOM, (4.812450574903719, -12.287281815097277, -10.741398340699261)),
        (COLOUR, BRIGHT, (44.468458887214325, 39.51553942058433, 14.00333340528475)),
        (DARK, BRIGHT, (4.102247122259274, -16.010971144513732, -13.913581242802719)),
    ],
)
def test_cam16_ucs_is_that_of_colour_science(colour, viewing, expected):
    found = p.xyz_to_cam16_ucs(pixel(colour), *viewing)
    assert found.flatten().tolist() == pytest.approx(expected, rel=1e-10)
    torch.testing.assert_close(p.cam16_ucs_to_xyz(found, *viewing), pixel(colour), rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize(
    ("model", "surround", "colour", "expected"),
    [
        (
            "CAM02",
            "dim",
            COLOUR,
            (
                40.33324869514672,
                65.66067536598233,
                22.085867617948033,
                156.08490934528422,
                58.49701180085272,
                61.21902133558238,
                2.4457242847332408,
            ),
        ),
        (
            "CAM02",
            "average",
            (0.1, 0.2, 0.5),
            (
                38.18678758567364,
                81.80244320579914,
                210.6924825759616,
                129.91012714614223,
                72.87769214794501,
                74.89896246175132,
                267.49666209666253,
            ),
        ),
        (
            "CAM16",
            "average",
            (0.1, 0.2, 0.5),
            (
                39.330343910205315,
                76.62935953577225,
                210.890641453617,
                131.84786469069778,
                68.26899851502606,
                71.95735904382705,
                267.7521339635842,
            ),
        ),
        (
            "CAM16",
            "dark",
            (0.1, 0.2, 0.5),
            (
                49.17162851819122,
                70.95954423334864,
                211.05180269080375,
                193.6374676343095,
                63.2177673053885,
                57.137979593254165,
                267.9597267766403,
            ),
        ),
    ],
)
def test_correlates_of_appearance_are_those_of_colour_science(model, surround, colour, expected):
    found = p.color_appearance(pixel(colour), (0.9505, 1.0, 1.0888), 50.0, 18.0, surround, model)
    assert [float(value) for value in found] == pytest.approx(expected, rel=1e-9)


def test_white_and_greys_have_the_correlates_that_models_define():
    found = p.color_appearance(torch.cat([pixel(IEC_WHITE), 0.3 * pixel(IEC_WHITE)], -1), model="CAM02")
    assert found.lightness[..., 0].item() == pytest.approx(100, rel=1e-12)
    # Adaptation is incomplete, so that greys keep a little of the light's colour.
    assert found.saturation.max() < 15
    # Between unique blue (237.53°, weight 1.2) and unique red (20.14°, weight 0.8), by the table of CIE 159:2004.
    hue = p.color_appearance(pixel(COLOUR)).hue.item() + 360
    wanted = 300 + 100 / (1 + 1.2 / 0.8 * (380.14 - hue) / (hue - 237.53))
    assert p.color_appearance(pixel(COLOUR)).hue_quadrature.item() == pytest.approx(wanted, rel=1e-12)
    with pytest.raises(ValueError, match="surround"):
        p.color_appearance(pixel(COLOUR), surround="black")
    with pytest.raises(ValueError, match="model"):
        p.color_appearance(pixel(COLOUR), model="CAM97")


def test_gradients_of_appearance():
    generator = torch.Generator().manual_seed(0)
    colours = (0.1 + 0.8 * torch.rand(1, 3, 2, 2, dtype=torch.float64, generator=generator)).requires_grad_()
    correlates = lambda image: torch.stack(p.color_appearance(image))  # noqa: E731
    for function in (p.xyz_to_cam16_ucs, p.xyz_to_dkl, correlates):
        assert torch.autograd.gradcheck(function, colours, fast_mode=True)
    for function, there in ((p.cam16_ucs_to_xyz, p.xyz_to_cam16_ucs), (p.dkl_to_xyz, p.xyz_to_dkl)):
        assert torch.autograd.gradcheck(function, there(colours).detach().requires_grad_(), fast_mode=True)
    for function in (p.xyz_to_cam16_ucs, p.cam16_ucs_to_xyz):
        black = torch.zeros(1, 3, 1, 1, dtype=torch.float64, requires_grad=True)
        value = function(black)
        value.sum().backward()
        assert not value.any() and black.grad.isfinite().all()


# CIE 1960 u, v of black bodies by the integral of Planck's law.
BODIES = [
    (1500, 0.3579110945809164, 0.3603300015805263),
    (2856, 0.25595303638511946, 0.34952099301424),
    (6504, 0.2004285130550799, 0.3103334567397025),
    (40000, 0.18169230420986465, 0.2698012573051235),
]


@pytest.mark.parametrize(("kelvins", "u", "v"), BODIES)
def test_temperature_of_black_bodies(kelvins, u, v):
    total = 2 * u - 8 * v + 4
    body = p.xyy_to_xyz(pixel((3 * u / total, 2 * v / total, 0.4)))
    found = p.correlated_color_temperature(body).flatten().tolist()
    assert found == pytest.approx([kelvins, 0], rel=1e-10, abs=1e-11)


def test_temperatures_beside_the_locus():
    # Ohno's method, which colour-science has, interpolates to some hundredths of a kelvin.
    for chromaticity, kelvins, distance in (
        ((0.3127, 0.329), 6504.348, 3.2072025e-3),
        ((0.35, 0.42), 5032.537, 2.8915837e-2),
        ((0.3805, 0.3769), 3999.551, 5.4169e-5),
    ):
        found = p.correlated_color_temperature(p.xyy_to_xyz(pixel((*chromaticity, 1.0)))).flatten().tolist()
        assert found == pytest.approx([kelvins, distance], rel=2e-6, abs=1e-7)
    light = p.xyy_to_xyz(pixel((0.35, 0.42, 1.0))).requires_grad_()
    scale = torch.tensor([1e-3, 100.0]).reshape(1, 2, 1, 1)
    assert torch.autograd.gradcheck(lambda v: p.correlated_color_temperature(v) * scale, light, fast_mode=True)
    for none in ((0.0, 0.0, 0.0), (0.1, 0.1, 3.0)):
        assert p.correlated_color_temperature(pixel(none)).isnan().all()


def test_opponent_colours_are_those_of_colorvideovdp():
    # Its matrix from XYZ; its white is that of the spectrum of D65, 0.5 % away in L/M.
    cones = torch.tensor(
        [
            [0.187596268556126, 0.585168649077728, -0.026384263306304],
            [-0.133397430663221, 0.405505777260049, 0.034502127690364],
            [0.000244379021663, -0.000542995890619, 0.019406849066323],
        ],
        dtype=torch.float64,
    )
    opponents = torch.tensor([[1, 1, 0], [1, -2.311130179947035, 0], [-1, -1, 50.977571328718781]], dtype=torch.float64)
    expected = (opponents @ cones @ torch.tensor(COLOUR, dtype=torch.float64)).tolist()
    assert p.xyz_to_dkl(pixel(COLOUR)).flatten().tolist() == pytest.approx(expected, abs=1e-3)
    for white in (IEC_WHITE, (0.9643, 1.0, 0.8251)):
        grey = p.xyz_to_dkl(0.3 * pixel(white), white).flatten().tolist()
        assert grey[0] > 0.3 and grey[1:] == pytest.approx([0, 0], abs=1e-15)
        torch.testing.assert_close(p.dkl_to_xyz(p.xyz_to_dkl(pixel(COLOUR), white), white), pixel(COLOUR))


def test_observer_of_ten_degrees():
    found = p.color_matching_functions([555.0, 450.0], "CIE 1964").T.flatten().tolist()
    assert found == pytest.approx([0.616053, 0.99911, 0.001091, 0.370702, 0.089456, 1.9948], rel=1e-12)
    with pytest.raises(ValueError, match="observer must be one of"):
        p.color_matching_functions([555.0], "CIE 2015")
