"""Line spread, modulation transfer and regions against closed forms and the numbers of the specification."""

import numpy as np
import pytest
import torch

import odak
from odak import measurement

EDGE = np.asarray([0, 0, 0.2, 0.9, 1, 1, 1])


def test_numbers_of_the_specification():
    spread = measurement.line_spread_function(EDGE)
    np.testing.assert_allclose(spread, [0, 0.1, 0.45, 0.4, 0.05, 0, 0], atol=1e-15)
    spectrum = measurement.fourier_transform_1d(spread)
    np.testing.assert_allclose(spectrum, [1, -0.44322 - 0.66876j, -0.14712 + 0.37140j], atol=5e-6)
    mtf, frequency = measurement.modulation_transfer_function(EDGE, EDGE, [0.1, 0.2])
    np.testing.assert_allclose(mtf[0], np.abs(spectrum), atol=1e-15)
    np.testing.assert_allclose(frequency[0], [0, 1.42857, 2.85714], atol=5e-6)
    np.testing.assert_allclose(frequency[1], frequency[0] / 2, atol=1e-15)


def test_line_spread_is_numpys_gradient(random):
    line = random.normal(size=31)
    np.testing.assert_allclose(measurement.line_spread_function(line), np.gradient(line), atol=1e-15)


def test_mtf_of_a_gaussian_edge_is_a_gaussian():
    from scipy.special import ndtr

    pitch, sigma, n = 0.1, 0.6, 200
    x = (np.arange(n) - n // 2) * pitch
    mtf, frequency = measurement.modulation_transfer_function(ndtr(x / sigma), 1 - ndtr(x / sigma), [pitch, pitch])
    # Central differences transfer sin(2πfp)/(2πfp).
    expected = np.exp(-2 * (np.pi * sigma * frequency[0]) ** 2) * np.sinc(2 * frequency[0] * pitch)
    for found in mtf:
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_both_faces_agree_and_gradients_pass(random):
    lines = random.normal(size=(2, 16)).cumsum(axis=1)
    tensors = [torch.from_numpy(line).requires_grad_() for line in lines]
    ours, theirs = (measurement.modulation_transfer_function(*pair, [0.1, 0.3]) for pair in (lines, tensors))
    for one, other in zip(ours[0] + ours[1], theirs[0] + theirs[1], strict=True):
        np.testing.assert_allclose(one, other.detach().numpy(), atol=1e-10)
    assert torch.autograd.gradcheck(
        lambda x, y: tuple(measurement.modulation_transfer_function(x, y, [0.1, 0.3])[0]), tensors, fast_mode=True
    )


def test_flat_lines_give_zeros():
    mtf, _ = measurement.modulation_transfer_function(np.ones(8), EDGE, [1, 1])
    np.testing.assert_array_equal(mtf[0], 0)
    line_x, line_y, _ = measurement.roi(np.full((20, 20), 7), [2, 12, 3, 9])
    assert not line_x.any() and not line_y.any()


def test_region_and_its_lines(as_array):
    picture = np.add.outer(np.arange(12.0), 2 * np.arange(10.0)) + 5
    line_x, line_y, region = measurement.roi(as_array(picture), [2, 12, 4, 9], [0.25, 0.75, 0.3, 1])
    np.testing.assert_array_equal(np.asarray(region), picture[2:12, 4:9])
    ramp = np.arange(10) / 9
    np.testing.assert_allclose(np.asarray(line_x), np.where(ramp < 0.25, 0, np.where(ramp > 0.75, 1, ramp)), atol=1e-15)
    np.testing.assert_allclose(np.asarray(line_y), [0, 0, 0.5, 0.75, 1], atol=1e-15)


def test_colours_of_a_region_are_summed(random):
    picture = random.integers(0, 255, size=(20, 20, 3)).astype(np.uint8)
    region = measurement.roi(picture, [0, 9, 0, 9])[2]
    np.testing.assert_array_equal(region, picture[:9, :9].astype(float).sum(2))


def test_polynomial_fit_returns_the_polynomial():
    x = np.linspace(-1, 2, 9)
    fit = measurement.polynomial_fit(x, 2 * x**3 - x + 0.5)
    assert isinstance(fit, np.poly1d)
    np.testing.assert_allclose(fit.coeffs, [2, 0, -1, 0.5], atol=1e-12)


def test_polynomial_fit_names_what_it_cannot_fit():
    x = torch.linspace(-1, 1, 9, dtype=torch.float64)
    with pytest.raises(ValueError, match="line_y must be finite"):
        measurement.polynomial_fit(x, torch.where(x > 0.9, torch.nan, x))
    with pytest.warns(odak.AccuracyWarning, match="line_y requires a gradient"):
        fit = measurement.polynomial_fit(x, (2 * x**3 - x).requires_grad_())
    np.testing.assert_allclose(fit.coefficients, [2, 0, -1, 0], atol=1e-12)
