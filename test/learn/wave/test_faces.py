"""The two faces agree: NumPy, PyTorch and the strict array API compute the same."""

import array_api_strict
import numpy as np
import pytest
import torch

import odak
from odak.wave.methods import METHODS

NAMES = [method.name for method in METHODS if method.name != "custom"]
GEOMETRY = (None, 2e-3, 8e-6, 532e-9)


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("padding", [(False,) * 3, (True, False, True), (True, False, False), (True, True, True)])
@pytest.mark.parametrize("shape", [(10, 13), (2, 9, 8)])
def test_methods_agree(method, padding, shape, random):
    field = random.normal(size=shape) + 1j * random.normal(size=shape)
    samples = (4, 3, 2, 1)
    expected = odak.wave.propagate_beam(field, *GEOMETRY, method, zero_padding=padding, samples=samples)
    for convert in (torch.from_numpy, array_api_strict.asarray):
        result = odak.wave.propagate_beam(convert(field), *GEOMETRY, method, zero_padding=padding, samples=samples)
        assert tuple(result.shape) == expected.shape
        np.testing.assert_allclose(np.asarray(result), expected, rtol=1e-10, atol=1e-10)
    learned = odak.learn.wave.propagate_beam(
        torch.from_numpy(field), *GEOMETRY, method, zero_padding=padding, samples=samples
    )
    np.testing.assert_allclose(learned.numpy(), expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("method", [method.name for method in METHODS if method.kernel])
@pytest.mark.parametrize("shape", [(10, 13), (9, 8)])
def test_kernels_agree(method, shape):
    arguments = {
        "dx": 8e-6,
        "wavelength": 515e-9,
        "distance": 0.003,
        "propagation_type": method,
        "samples": (3, 2, 2, 1),
    }
    expected = odak.wave.get_propagation_kernel(*shape, dtype=np.complex128, **arguments)
    result = odak.learn.wave.get_propagation_kernel(*shape, dtype=torch.complex128, **arguments)
    np.testing.assert_allclose(result.numpy(), expected, atol=1e-10)
    assert odak.learn.wave.get_propagation_kernel(*shape, **arguments).dtype == torch.complex64


def test_point_sums_lenses_and_patterns_agree(random):
    sources, targets = random.normal(size=(4, 3)), random.normal(size=(5, 3)) + 3
    field = random.normal(size=4) + 1j * random.normal(size=4)
    expected = odak.wave.propagate_field(sources, targets, field, 11.0)
    result = odak.wave.propagate_field(*map(torch.from_numpy, (sources, targets, field)), 11.0)
    np.testing.assert_allclose(result.numpy(), expected, rtol=1e-10)
    np.testing.assert_allclose(
        odak.learn.wave.lens_phase((5, 6), 0.1, 8e-6, 532e-9).numpy(), odak.wave.lens_phase((5, 6), 0.1, 8e-6, 532e-9)
    )
    hologram = random.normal(size=(4, 5)) + 1j * random.normal(size=(4, 5))
    for one, two in zip(
        odak.wave.produce_phase_only_slm_pattern(hologram, 6.28),
        odak.learn.wave.produce_phase_only_slm_pattern(torch.from_numpy(hologram), 6.28),
        strict=True,
    ):
        np.testing.assert_allclose(two.numpy(), one, atol=1e-10)


@pytest.mark.parametrize("method", ["AS", "IR Fresnel"])
def test_gerchberg_saxton_agrees(method, random):
    target = random.random((16, 18))
    start = random.random((16, 18))
    one = odak.wave.gerchberg_saxton(target, 3, 0.01, 8e-6, 532e-9, propagation_type=method, initial_phase=start)
    two = odak.learn.wave.gerchberg_saxton(
        torch.from_numpy(target),
        3,
        0.01,
        8e-6,
        532e-9,
        propagation_type=method,
        initial_phase=torch.from_numpy(start),
    )
    for a, b in zip(one, two, strict=True):
        np.testing.assert_allclose(b.numpy(), a, atol=1e-8)


def test_field_functions_agree(random):
    field = random.normal(size=(3, 4)) + 1j * random.normal(size=(3, 4))
    tensor = torch.from_numpy(field)
    for name in ("calculate_phase", "calculate_amplitude", "calculate_intensity"):
        np.testing.assert_allclose(
            getattr(odak.learn.wave, name)(tensor).numpy(), getattr(odak.wave, name)(field), rtol=1e-10
        )
    phase = random.normal(size=(3, 4))
    np.testing.assert_allclose(
        odak.learn.wave.generate_complex_field(2.0, torch.from_numpy(phase)).numpy(),
        odak.wave.generate_complex_field(2.0, phase),
        rtol=1e-10,
    )
    np.testing.assert_allclose(
        odak.learn.wave.set_amplitude(tensor, 2.0).numpy(), odak.wave.set_amplitude(field, 2.0), rtol=1e-10
    )
    assert odak.learn.wave.generate_complex_field(1.0, 0.5).dtype == torch.complex64


def test_kernels_of_one_method_are_those_of_the_general_function():
    geometry = (10, 13, 8e-6, 515e-9, 0.003)
    for name, method in (
        ("get_angular_spectrum_kernel", "Angular Spectrum"),
        ("get_band_limited_angular_spectrum_kernel", "Bandlimited Angular Spectrum"),
        ("get_incoherent_angular_spectrum_kernel", "Incoherent Angular Spectrum"),
        ("get_transfer_function_fresnel_kernel", "Transfer Function Fresnel"),
    ):
        found = getattr(odak.learn.wave, name)(*geometry, dtype=torch.complex128)
        expected = odak.learn.wave.get_propagation_kernel(*geometry, propagation_type=method, dtype=torch.complex128)
        assert torch.equal(found, expected) and found.dtype == torch.complex128
    found = odak.learn.wave.get_impulse_response_fresnel_kernel(*geometry, scale=2, aperture_samples=(3, 2, 2, 1))
    expected = odak.learn.wave.get_propagation_kernel(
        *geometry, propagation_type="Impulse Response Fresnel", scale=2, samples=(3, 2, 2, 1)
    )
    assert torch.equal(found, expected) and found.shape == (20, 26)
    with pytest.raises(ValueError, match="distance must be finite and not zero"):
        odak.learn.wave.get_seperable_impulse_response_fresnel_kernel(8, 8, distance=0)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [("double_convergence", (6, 4, 1e5, 0.3, 8e-6)), ("prism_phase_function", (6, 4, 1e5, 0.3, 8e-6, "y"))],
)
def test_older_phase_elements_agree(name, arguments):
    ours, theirs = (getattr(face, name)(*arguments) for face in (odak.learn.wave, odak.wave))
    assert ours.dtype == torch.complex64 and ours.shape == theirs.shape == (6, 4)
    np.testing.assert_allclose(ours.numpy(), theirs, atol=1e-6)


def test_what_both_faces_share(random):
    fields, options = random.random((2, 9, 8)), {"n_iterations": 2, "distances": [1e-3, 2e-3], "dx": 8e-6, "seed": 1}
    one = odak.wave.gerchberg_saxton_3d(fields, wavelength=532e-9, **options)
    two = odak.learn.wave.gerchberg_saxton_3d(torch.from_numpy(fields), wavelength=532e-9, **options)
    np.testing.assert_allclose(two.numpy(), one, atol=1e-10)
    places = random.random((3, 3)), random.random((2, 3)) + 2
    one = odak.wave.propagate_field(*places, np.ones(3), 3.0)
    two = odak.learn.wave.propagate_field(*map(torch.from_numpy, places), torch.ones(3, dtype=torch.complex128), 3.0)
    np.testing.assert_allclose(two.numpy(), one, atol=1e-12)
