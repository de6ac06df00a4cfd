"""Spectra, cones and a display seen by them."""

import math

import numpy as np
import pytest
import torch

from odak.learn import perception as p
from odak.learn.perception.display_color import gaussian_lines

AXIS = torch.linspace(390, 830, 441, dtype=torch.float64)


def gaussian(axis, centre, width):
    return torch.exp(-((axis - centre) ** 2) / (2 * width**2))


def test_cone_fundamentals_are_those_of_cie_170():
    cones = p.cone_fundamentals(AXIS)
    # Stockman and Sharpe (2000): where each is largest, and that it is 1 there.
    assert AXIS[cones.argmax(-1)].tolist() == [570, 543, 442]
    assert torch.allclose(cones.amax(-1), torch.ones(3, dtype=torch.float64), atol=3e-5)
    # CIE 170-2:2015: XYZ of these cones; equal areas and a luminance of peak 1 hold only for the right table.
    to_xyz = [[1.94735469, -1.41445123, 0.36476327], [0.68990272, 0.34832189, 0], [0, 0, 1.93485343]]
    xyz = torch.tensor(to_xyz, dtype=torch.float64) @ cones
    areas = xyz.sum(-1)
    assert torch.allclose(areas / areas[1], torch.ones(3, dtype=torch.float64), rtol=0, atol=1e-6)
    assert xyz[1].max() == pytest.approx(1, abs=1e-5)


def test_observer_and_illuminant_are_those_of_the_cie():
    axis = torch.linspace(360, 830, 471, dtype=torch.float64)
    observer = p.color_matching_functions(axis)
    assert observer[:, 195].tolist() == pytest.approx([0.51205, 1.0, 0.00575], abs=1e-5)
    assert observer[0, 240].item() == pytest.approx(1.0622, abs=1e-4)
    areas = observer.sum(-1)
    assert areas.tolist() == pytest.approx([106.8655, 106.8569, 106.8922], abs=1e-3)
    # White point of D65, CIE 015: (0.31272, 0.32903).
    white = p.spectrum_to_xyz(p.illuminant_d65(axis), axis)
    assert (white[:2] / white.sum()).tolist() == pytest.approx([0.31272, 0.32903], abs=1e-5)
    assert p.illuminant_d65([560.0]).item() == 100
    assert p.color_matching_functions([300.0, 900.0]).abs().max() == 0
    for function in (p.color_matching_functions, p.illuminant_d65, p.cone_fundamentals):
        with pytest.raises(ValueError, match=r"wavelengths must be in nanometres, got .*5\.5e-07"):
            function([5.5e-7, 6e-7])
    with pytest.raises(ValueError, match="must be a list of numbers, got an array of shape"):
        p.color_matching_functions(550.0)


def test_a_laser_lies_on_the_spectral_locus():
    axis = torch.linspace(500, 540, 4001, dtype=torch.float64)
    spectrum = gaussian(axis, 520, 0.05).requires_grad_()
    xyz = p.spectrum_to_xyz(spectrum, axis)
    # CIE 1931 chromaticity of 520 nm: (0.0743, 0.8338).
    assert (xyz[:2] / xyz.sum()).tolist() == pytest.approx([0.0743, 0.8338], abs=1e-4)
    xyz.sum().backward()
    assert torch.isfinite(spectrum.grad).all()
    assert p.spectrum_to_xyz(spectrum.detach().expand(2, 1, -1), axis).shape == (2, 1, 3)


def test_gaussians_hold_the_half_twice():
    axis = torch.linspace(400, 700, 301, dtype=torch.float64)
    expected = [
        gaussian(axis, centre, width * math.sqrt(2)) for centre, width in ((567.5, 32.5), (545, 27.5), (447.5, 17))
    ]
    expected = torch.stack([line / line.max() for line in expected])
    assert torch.allclose(p.cone_fundamentals(axis, "gaussian"), expected)
    # A line much narrower than the samples is not lost.
    assert gaussian_lines(axis, [(500.5, 1e-3)]).max() == 1


def test_spectra_from_a_file(tmp_path):
    path = tmp_path / "display.csv"
    path.write_text("\ufeffnm;red;green\n# measured\n500; 1; 2\n400;0;0\n600\t3 4\n", encoding="utf-8")
    spectra = p.read_spectra(path, [350.0, 400.0, 450.0, 600.0, 610.0])
    assert spectra.tolist() == [[0, 0, 0.5, 3, 0], [0, 0, 1, 4, 0]]
    assert p.read_spectra(path).shape == (2, 301)
    display = p.display_color_hvs(primaries_spectrum=path)
    assert torch.equal(display.primaries_spectrum, p.read_spectra(path))
    for text in ("400,1\n", "400,1\n500\n", "400,1\n400,2\n", "400,1\n500,nan\n"):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match="must hold"):
            p.read_spectra(path)
    with pytest.raises(FileNotFoundError):
        p.read_spectra(tmp_path / "none.csv")


def box_spectra(dtype=torch.float32):
    spectra = torch.zeros(3, 301, dtype=dtype)
    for row, (first, last) in enumerate(((200, 250), (130, 145), (0, 50))):
        spectra[row, first:last] = 1
    return spectra


def test_display_matrices_are_sums_over_samples():
    display = p.display_color_hvs(primaries_spectrum=box_spectra(torch.float64))
    cones = (display.l_normalized, display.m_normalized, display.s_normalized)
    for primary, (first, last) in enumerate(((200, 250), (130, 145), (0, 50))):
        for cone, sensitivity in enumerate(cones):
            expected = sensitivity[first:last].sum()
            assert display.lms_tensor[primary, cone].item() == pytest.approx(expected.item())
            response = display.cone_response_to_spectrum(sensitivity, display.primaries_spectrum[primary])
            assert response.item() == pytest.approx(expected.item())
    assert torch.equal(display.primaries_tensor, display.lms_tensor.T)


@pytest.mark.parametrize("primaries", [2, 3, 5])
def test_primaries_and_cones(primaries):
    generator = torch.Generator().manual_seed(0)
    spectra = torch.rand(primaries, 301, dtype=torch.float64, generator=generator)
    display = p.display_color_hvs(primaries_spectrum=spectra)
    image = torch.rand(2, primaries, 4, 5, dtype=torch.float64, generator=generator)
    lms = display.primaries_to_lms(image)
    assert lms.shape == (2, 3, 4, 5)
    assert lms[1, 2, 3, 4].item() == pytest.approx((image[1, :, 3, 4] @ display.lms_tensor[:, 2]).item())
    assert torch.equal(display.rgb_to_lms(image), lms)
    back = display.lms_to_rgb(lms)
    assert back.dtype == torch.float64
    # The responses come back always, the intensities where they are unique.
    assert torch.allclose(display.primaries_to_lms(back), lms, rtol=1e-8)
    if primaries <= 3:
        assert torch.allclose(back, image, atol=1e-8)
    assert display.primaries_to_lms(image[0].float()).dtype == torch.float32


def test_opponent_channels():
    display = p.display_color_hvs()
    lms = torch.tensor([5.0, 3.0, 1.0]).reshape(1, 3, 1, 1)
    assert display.second_to_third_stage(lms).flatten().tolist() == [-1, 3, 9]


def test_display_loss():
    display = p.display_color_hvs(primaries_spectrum=box_spectra(torch.float64))
    generator = torch.Generator().manual_seed(1)
    one = torch.rand(1, 3, 2, 2, dtype=torch.float64, generator=generator, requires_grad=True)
    two = torch.rand(1, 3, 2, 2, dtype=torch.float64, generator=generator)
    assert display(one, one.detach()).item() == 0
    stages = [display.second_to_third_stage(display.primaries_to_lms(picture)) for picture in (one, two)]
    assert display(one, two, gaze=None).item() == pytest.approx(((stages[0] - stages[1]) ** 2).mean().item())
    assert torch.autograd.gradcheck(lambda picture: display(picture, two), one, fast_mode=True)
    assert f"{display(one, two):.10f}"
    assert display.to(torch.device("cpu")) is display
    assert display.to(torch.float64).lms_tensor.dtype == torch.float64
    assert display.state_dict() == {}


def test_both_spellings():
    display = p.display_color_hvs()
    for cone in "lms":
        assert getattr(display, f"{cone}_normalised") is getattr(display, f"{cone}_normalized")
    for one, two in zip(display.initialize_cones_normalised(), display.initialize_cones_normalized(), strict=True):
        assert torch.equal(one, two)
    # The default spectra are the same each time.
    assert torch.equal(display.primaries_spectrum, p.display_color_hvs().primaries_spectrum)
    assert torch.equal(display.primaries_spectrum, torch.stack(display.initialize_rgb_backlight_spectrum()))
    tabulated = p.display_color_hvs(cones="CIE 170")
    assert torch.allclose(tabulated.l_normalized.double(), p.cone_fundamentals(AXIS[10:311])[0], atol=1e-6)


def test_response_at_a_wavelength():
    values = torch.arange(301.0)
    display = p.display_color_hvs()
    for wavelength, expected in ((400, 0), (523.4, 123), (300, 0), (900, 300)):
        assert display.display_spectrum_response(wavelength, values) == expected
        assert p.display_color_hvs.display_spectrum_response(wavelength, values) == expected


@pytest.mark.parametrize(("centre", "width"), [(610, 15), (450, 5), (550, 60), (640, 3)])
def test_a_gaussian_line_comes_back(centre, width):
    axis = torch.linspace(380, 780, 401, dtype=torch.float64)
    data = torch.stack([axis, 7 * gaussian(axis, centre, width)])
    wanted = gaussian(torch.linspace(400, 700, 301), centre, width)
    display = p.display_color_hvs()
    for dataset in (data, data.T, data.T.numpy(), data.flip(1)):
        curve = display.initialize_random_spectrum_normalized(dataset)
        assert curve.shape == (301,)
        assert curve.dtype == torch.float32
        assert (curve - wanted).abs().max() < 1e-3


@pytest.mark.parametrize(("width", "step"), [(15, 5), (15, 10), (12, 10)])
def test_a_line_comes_back_from_few_samples(width, step):
    axis = np.arange(380, 781, step)
    curve = p.display_color_hvs().initialize_random_spectrum_normalized(
        np.stack([axis, np.exp(-((axis - 612) ** 2) / (2 * width**2))], 1)
    )
    expected = np.exp(-((np.arange(400, 701) - 612) ** 2) / (2 * width**2))
    assert np.abs(curve.numpy() - expected).max() < 0.02


def test_three_lines_come_back():
    axis = np.linspace(380, 780, 401)
    lines = ((450, 8, 1.0), (540, 20, 0.6), (620, 14, 0.8))
    values = sum(height * np.exp(-((axis - centre) ** 2) / (2 * width**2)) for centre, width, height in lines)
    curve = p.display_color_hvs().initialize_random_spectrum_normalised(np.stack([axis, values], 1))
    assert np.abs(curve.numpy() - values[20:321] / values[20:321].max()).max() < 2e-3


def test_refused():
    with pytest.raises(ValueError, match=r"primaries_spectrum must be \[1 or more, 2 or more\]"):
        p.display_color_hvs(primaries_spectrum=torch.ones(301))
    display = p.display_color_hvs()
    with pytest.raises(ValueError, match=r"primaries must be pictures \[..., 3, H, W\]"):
        display.primaries_to_lms(torch.zeros(1, 4, 2, 2))
    with pytest.raises(ValueError, match="must have the same shape"):
        display(torch.zeros(1, 3, 2, 2), torch.zeros(1, 3, 2, 3))
    with pytest.raises(ValueError, match=r"dataset must be \[N, 2\]"):
        display.initialize_random_spectrum_normalized(torch.ones(5, 3))
    with pytest.raises(ValueError, match="dataset must have positive values"):
        display.initialize_random_spectrum_normalized(torch.tensor([[800.0, 1.0], [900.0, 1.0]]))
    with pytest.raises(ValueError, match="wavelengths must rise"):
        p.spectrum_to_xyz(torch.ones(3), [1.0, 2.0])


def test_negated_views():
    """What ``.conj().imag`` gives; torch turns them into plain tensors late."""
    display, picture = p.display_color_hvs(), torch.rand(1, 3, 4, 4)
    view = torch._neg_view(-picture)
    torch.testing.assert_close(display.second_to_third_stage(view), display.second_to_third_stage(picture))
    table = torch.stack([torch.linspace(400, 700, 31), torch.linspace(0.1, 1, 31)], -1)
    fitted = display.initialize_random_spectrum_normalized(torch._neg_view(-table))
    torch.testing.assert_close(fitted, display.initialize_random_spectrum_normalized(table))


def test_responses_of_another_precision():
    display = p.display_color_hvs()
    cones = [getattr(display, f"{cone}_normalized") for cone in "lms"]
    torch.testing.assert_close(display.construct_matrix_lms(*(cone.double() for cone in cones)), display.lms_tensor)
    with pytest.raises(ValueError, match="m_response must hold 301 samples"):
        display.construct_matrix_lms(cones[0], cones[1][:-1], cones[2])


@pytest.mark.parametrize("table", [p.color_matching_functions, p.cone_fundamentals, p.illuminant_d65])
def test_tables_are_differentiable_in_the_wavelengths(table):
    waves = torch.tensor([451.3, 533.7, 610.2, 840.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(table, waves, fast_mode=True)


def test_luminance_changes_with_wavelength_as_in_the_table():
    wave = torch.tensor([600.25], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(p.color_matching_functions(wave)[1].sum(), wave)
    first, second = p.color_matching_functions([600.0, 601.0])[1]
    assert torch.isclose(slope, second - first, rtol=1e-9)


def test_wavelengths_in_angstrom_are_named():
    with pytest.raises(ValueError, match="wavelengths must be in nanometres"):
        p.color_matching_functions([4500.0, 5500.0, 6500.0])
