"""Transfer functions as centred arrays, and what is refused."""

import numpy as np
import pytest

from odak.wave import get_propagation_kernel
from odak.wave.transfer_functions import make_grid, separable_impulse_response


def test_defaults_are_the_documented_ones():
    explicit = {"dx": 8e-6, "wavelength": 515e-9, "scale": 1, "samples": (1, 1, 1, 1)}
    np.testing.assert_array_equal(
        get_propagation_kernel(8, 6, distance=0.01),
        get_propagation_kernel(8, 6, distance=0.01, propagation_type="Bandlimited Angular Spectrum", **explicit),
    )
    name = "Impulse Response Fresnel"
    np.testing.assert_array_equal(
        get_propagation_kernel(8, 6, distance=0.01, propagation_type=name),
        get_propagation_kernel(8, 6, distance=0.01, propagation_type=name, **explicit),
    )
    np.testing.assert_array_equal(get_propagation_kernel(8, 6), np.ones((8, 6)))
    default, given = make_grid(8, 6, 8e-6, 5e-7, 0.1), make_grid(8, 6, 8e-6, 5e-7, 0.1, 1, (1, 1, 1, 1))
    assert (default.scale, default.samples) == (given.scale, given.samples) == (1, (1, 1, 1, 1))


def test_zero_frequency_is_in_the_middle():
    dx, wavelength, distance = 8e-6, 5e-7, 1e-3
    found = get_propagation_kernel(6, 9, dx, wavelength, distance, "Angular Spectrum", dtype=np.complex128)
    fy, fx = (np.fft.fftshift(np.fft.fftfreq(n, dx)) for n in (6, 9))
    axial = np.sqrt(1 / wavelength**2 - fx**2 - fy[:, None] ** 2)
    np.testing.assert_allclose(found, np.exp(2j * np.pi * distance * axial), atol=1e-9)
    assert get_propagation_kernel(6, 9, scale=2, distance=0.01, propagation_type="IR Fresnel").shape == (12, 18)


@pytest.mark.parametrize("name", ["Fraunhofer", "custom", "auto"])
def test_methods_without_a_transfer_function_are_refused(name):
    with pytest.raises(ValueError, match=r"must be a method with a transfer function \('.*Angular Spectrum"):
        get_propagation_kernel(8, 6, distance=0.01, propagation_type=name)


def test_distance_of_zero_is_refused_where_it_is_undefined():
    for name in ("Impulse Response Fresnel", "Seperable Impulse Response Fresnel"):
        with pytest.raises(ValueError, match="distance must not be zero"):
            get_propagation_kernel(8, 6, distance=0.0, propagation_type=name)
        assert np.isfinite(get_propagation_kernel(8, 6, distance=1.0, propagation_type=name)).all()
    np.testing.assert_array_equal(get_propagation_kernel(8, 6, propagation_type="Angular Spectrum"), np.ones((8, 6)))


def test_the_parts_of_the_separable_kernel():
    (nu, nv), dx, wavelength, distance = (6, 9), 8e-6, 5e-7, 2e-3
    kernel, response, h_x, h_y = separable_impulse_response(
        make_grid(nu, nv, dx, wavelength, distance, dtype=np.complex128)
    )
    k = 2 * np.pi / wavelength
    y, x = ((np.arange(n) - n // 2) * dx for n in (nu, nv))
    np.testing.assert_allclose(h_y, np.exp(1j * k * y**2 / (2 * distance)), atol=1e-10)
    np.testing.assert_allclose(h_x, np.exp(1j * k * x**2 / (2 * distance)), atol=1e-10)
    expected = np.exp(1j * k * distance) / (1j * wavelength * distance) * h_y[:, None] * h_x
    np.testing.assert_allclose(response, expected, rtol=1e-8)
    spectrum = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(response))) * dx**2
    np.testing.assert_allclose(kernel, spectrum, atol=1e-9 * abs(spectrum).max())


def test_several_distances_give_as_many_kernels():
    distances = np.array([[[1e-3]], [[2e-3]]])
    options = {"propagation_type": "Angular Spectrum", "dtype": np.complex128}
    several = get_propagation_kernel(6, 9, distance=distances, **options)
    each = [get_propagation_kernel(6, 9, distance=distance, **options) for distance in (1e-3, 2e-3)]
    np.testing.assert_allclose(np.reshape(several, (2, 6, 9)), each, atol=1e-12)
