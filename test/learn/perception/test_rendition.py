"""Rendition of colours, against the indices published for lamps, colour-science and the definitions."""

import numpy as np
import pytest
import torch

from odak.learn import perception as p

AXIS = torch.arange(380.0, 781.0, 5.0, dtype=torch.float64)
# Fluorescent lamps FL2 and FL11 of CIE 015:2018, table 11, from 380 nm in steps of 5 nm.
LAMPS = {
    "FL2": """
1.18 1.48 1.84 2.15 3.44 15.69 3.85 3.74 4.19 4.62 5.06 34.98 11.81 6.27 6.63 6.93 7.19 7.4 7.54 7.62 7.65 7.62
7.62 7.45 7.28 7.15 7.05 7.04 7.16 7.47 8.04 8.88 10.01 24.88 16.64 14.59 16.16 17.56 18.62 21.47 22.79 19.29
18.66 17.73 16.54 15.21 13.8 12.36 10.95 9.65 8.4 7.32 6.31 5.43 4.68 4.02 3.45 2.96 2.55 2.19 1.89 1.64 1.53
1.27 1.1 0.99 0.88 0.76 0.68 0.61 0.56 0.54 0.51 0.47 0.47 0.43 0.46 0.47 0.4 0.33 0.27
""",
    "FL11": """
0.91 0.63 0.46 0.37 1.29 12.68 1.59 1.79 2.46 3.33 4.49 33.94 12.13 6.95 7.19 7.12 6.72 6.13 5.46 4.79 5.66
14.29 14.96 8.97 4.72 2.33 1.47 1.1 0.89 0.83 1.18 4.9 39.59 72.84 32.61 7.52 2.83 1.96 1.67 4.43 11.28 14.76
12.73 9.74 7.33 9.72 55.27 42.58 13.18 13.16 12.26 5.11 2.07 2.34 3.58 3.01 2.48 2.14 1.54 1.33 1.46 1.94 2 1.2
1.35 4.1 5.58 2.51 0.57 0.27 0.23 0.21 0.24 0.24 0.2 0.24 0.32 0.26 0.16 0.12 0.09
""",
}


def lamp(name):
    return torch.tensor([float(word) for word in LAMPS[name].split()], dtype=torch.float64)


def lines(*places, width=10):
    return torch.exp(-(((AXIS[:, None] - torch.tensor(places)) / width) ** 2)).sum(1)


def white_led(blue):
    return blue * torch.exp(-(((AXIS - 455) / 12) ** 2)) + torch.exp(-(((AXIS - 580) / 55) ** 2))


def black_body(kelvins):
    metres = AXIS * 1e-9
    return metres**-5 / torch.expm1(1.4388e-2 / (metres * kelvins))


# R_a as CIE 015:2018 states it, in whole numbers; R_a, R_f and R_g by colour-science 0.4.7 (TM-30-18).
CASES = [
    ("FL2", 64, (64.1515, 70.1208, 86.4163)),
    ("FL11", 83, (82.8261, 80.0404, 101.0567)),
    (lines(450.0, 540.0, 610.0), None, (68.8045, 64.3492, 116.1070)),
    (white_led(1.0), None, (57.0225, 60.9994, 82.8516)),
    (white_led(0.3), None, (52.4926, 63.5002, 76.5884)),
]


@pytest.mark.parametrize(("light", "published", "computed"), CASES)
def test_indices_are_those_published(light, published, computed):
    light = lamp(light) if isinstance(light, str) else light
    rendering, fidelity = p.color_rendering_index(light, AXIS), p.color_fidelity(light, AXIS)
    if published is not None:
        assert round(rendering.general.item()) == published
    # Temperatures there are known to 0.03 K only, and the spectra of the samples are interpolated in another way.
    assert rendering.general.item() == pytest.approx(computed[0], abs=0.02)
    assert fidelity.fidelity.item() == pytest.approx(computed[1], abs=0.01)
    assert fidelity.gamut.item() == pytest.approx(computed[2], abs=0.01)
    assert rendering.special.shape == (14,) and fidelity.samples.shape == (99,)
    assert rendering.general == rendering.special[:8].mean() and rendering.temperature == fidelity.temperature


def test_special_indices_of_three_lines():
    # By colour-science 0.4.7.
    wanted = [64.1037, 92.2664, 13.585, 53.7485, 86.6711, 78.6791, 75.4633, 85.9192, 63.2799, 39.0526, 61.8823, 29.3091]
    found = p.color_rendering_index(lines(450.0, 540.0, 610.0), AXIS).special
    np.testing.assert_allclose(found[:12].numpy(), wanted, atol=0.06)


@pytest.mark.parametrize("kelvins", [2000.0, 2856.0, 3900.0])
def test_a_black_body_renders_as_itself(kelvins):
    rendering, fidelity = (f(black_body(kelvins), AXIS) for f in (p.color_rendering_index, p.color_fidelity))
    # Of the whole spectrum; the part from 380 to 780 nm is a little off.
    assert rendering.temperature.item() == pytest.approx(kelvins, rel=1e-3)
    assert rendering.special.min() > 99.7 and fidelity.samples.min() > 99 and abs(fidelity.gamut - 100) < 0.1


def test_daylight_renders_as_itself():
    light = p.illuminant_d65(AXIS)
    assert p.color_rendering_index(light, AXIS).special.min() > 99.7
    assert p.color_fidelity(light, AXIS).samples.min() > 99


def test_batches_units_and_gradients():
    light = torch.stack([lines(450.0, 540.0, 610.0), white_led(1.0)])
    for function in (p.color_rendering_index, p.color_fidelity):
        whole = function(light, AXIS)
        for k, one in enumerate(light):
            for there, alone in zip(whole, function(1e-3 * one, AXIS), strict=True):
                torch.testing.assert_close(there[k], alone)
        given = white_led(0.6).requires_grad_()
        assert torch.autograd.gradcheck(lambda v, f=function: f(v, AXIS)[:2], given, fast_mode=True)


def test_light_without_a_colour_temperature_has_no_index():
    light = torch.stack([lines(450.0, 540.0, 610.0), lines(450.0)])
    for function in (p.color_rendering_index, p.color_fidelity):
        for value in function(light, AXIS):
            assert value[0].isfinite().all() and value[1].isnan().all()


def test_wrong_spectra_are_named():
    with pytest.raises(ValueError, match="wavelengths must rise, one for each sample"):
        p.color_rendering_index(torch.ones(5), AXIS)
    with pytest.raises(TypeError, match="spectrum must be a tensor of real floats"):
        p.color_fidelity([1.0] * 81, AXIS)


def test_the_matrix_of_spectra_is_that_of_their_chromaticities():
    axis = torch.arange(400.0, 701.0, dtype=torch.float64)
    spectra = torch.exp(-(((axis - torch.tensor([[620.0], [530.0], [460.0]])) / 15) ** 2)) * torch.tensor(
        [[1.0], [0.8], [1.2]]
    )
    matrix = p.spectra_to_xyz_matrix(spectra, axis)
    places = [(float(x / (x + y + z)), float(y / (x + y + z))) for x, y, z in matrix.T]
    torch.testing.assert_close(p.rgb_to_xyz_matrix(places, matrix.sum(1).tolist()), matrix, rtol=1e-10, atol=1e-12)
    assert matrix[1].sum().item() == pytest.approx(1)
    wide = p.spectra_to_xyz_matrix(spectra, axis, "CIE 1964")
    sums = torch.trapezoid(spectra[:, None] * p.color_matching_functions(axis, "CIE 1964"), axis)
    torch.testing.assert_close(wide, sums.T / sums[:, 1].sum())
    with pytest.raises(ValueError, match=r"spectra must be \[\.\.\., primaries, 301\]"):
        p.spectra_to_xyz_matrix(spectra[0], axis)
