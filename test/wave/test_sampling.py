import json
import math

import numpy as np
import pytest

import odak
from odak.wave.fourier import fourier_sum


def test_report_gives_the_criteria():
    report = odak.wave.sampling_report([1080, 1920], 8e-6, 532e-9, 0.15, zero_padding=True)
    assert report.shape == (2160, 3840)
    assert report.critical_distance == pytest.approx((2160 * 64e-12 / 532e-9, 3840 * 64e-12 / 532e-9))
    assert report.response_distance == pytest.approx(3840 * 64e-12 / 532e-9)
    assert report.nyquist == pytest.approx(62500)
    width = 3840 * 8e-6
    assert report.band_limit[1] == pytest.approx(1 / (532e-9 * math.sqrt((0.3 / width) ** 2 + 1)))
    assert report.kept_band == (1.0, 1.0)
    assert report.fresnel_number[0] == pytest.approx((540 * 8e-6) ** 2 / (532e-9 * 0.15))
    assert report.fraunhofer_distance == pytest.approx(2 * (1920 * 8e-6) ** 2 / 532e-9)
    assert report.recommended == "Angular Spectrum"
    json.dumps(report.to_dict())


def test_paraxial_error_is_the_phase_that_fresnel_loses():
    report = odak.wave.sampling_report([512, 512], 2e-6, 532e-9, 1e-3)
    sine = 532e-9 * math.sqrt(2) * min(report.nyquist, report.band_limit[0])
    assert report.paraxial_error == pytest.approx(
        1e-3 / 532e-9 * abs(math.sqrt(1 - sine**2) - 1 + sine**2 / 2), rel=1e-6
    )


@pytest.mark.parametrize(
    ("distance", "name"),
    [
        (0.0, "Angular Spectrum"),
        (-0.05, "Angular Spectrum"),
        (0.09, "Bandlimited Angular Spectrum"),
        (0.2, "Rayleigh-Sommerfeld"),
    ],
)
def test_recommendation_over_distance(distance, name):
    report = odak.wave.sampling_report([512, 512], 8e-6, 532e-9, distance)
    assert report.recommended == name
    assert f"{abs(distance):.4g} m" in report.reason


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0, 4], 1e-6, 5e-7, 1.0), r"shape\[0\] must be at least 1"),
        (([4], 1e-6, 5e-7, 1.0), "shape must be two integers"),
        (([4, 4], 0, 5e-7, 1.0), "dx must be positive"),
        (([4, 4], 1e-6, -5e-7, 1.0), "wavelength must be positive"),
        (([4, 4], 1e-6, 5e-7, math.inf), "distance must be finite"),
    ],
)
def test_bad_geometry_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        odak.wave.sampling_report(*arguments)


@pytest.mark.parametrize(("count_in", "count_out"), [(8, 8), (9, 14), (14, 9), (1, 5)])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [-1, -2])
def test_fourier_sum_is_the_sum(count_in, count_out, sign, axis, as_array, random):
    field = random.normal(size=(3, count_in)) + 1j * random.normal(size=(3, count_in))
    n, k = np.arange(count_in) - count_in // 2, np.arange(count_out) - count_out // 2
    expected = field @ np.exp(sign * 2j * np.pi * 0.031 * n[:, None] * k[None])
    if axis == -2:
        field, expected = field.T.copy(), expected.T
    result = fourier_sum(as_array(field), as_array(np.full((1, 1), 0.031)), count_out, sign, axis)
    np.testing.assert_allclose(np.asarray(result), expected, atol=1e-12)
