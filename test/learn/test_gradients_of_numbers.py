"""Gradients in arguments that are plain numbers in most calls, against finite differences."""

import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck

from odak.learn import perception, tools, wave
from odak.learn.raytracing.system import airy_pattern

PICTURE = torch.rand(1, 3, 2, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
D65, D50 = (0.9505, 1.0, 1.0891), (0.9642, 1.0, 0.8251)
WAVES = torch.arange(390.0, 781.0, 10.0, dtype=torch.float64)


def spectra():
    return torch.stack([torch.exp(-(((WAVES - peak) / 20) ** 2) / 2) for peak in (638.0, 520.0, 450.0)])


CASES = {
    "airy_pattern": (airy_pattern, (0.3, 1.0, 2.5), 0.5, 0.2),
    "generate_2d_gaussian": (
        lambda sigma, mu: tools.generate_2d_gaussian((3, 4), sigma, mu, dtype=torch.float64),
        (1.0, 2.0),
        (0.1, 0.2),
    ),
    "blur_gaussian": (lambda sigma: tools.blur_gaussian(PICTURE[0, 0], (3, 3), sigma, padding=1), (1.0, 2.0)),
    "reference_wave": (lambda dx, wavelength: wave.reference_wave((3, 4), dx, wavelength, (3.0, 4.0)), 0.1, 0.3),
    "hlg_to_luminance": (lambda peak, black: perception.hlg_to_luminance(PICTURE, peak, black), 900.0, 0.1),
    "hlg_to_luminance, bright": (lambda peak: perception.hlg_to_luminance(PICTURE, peak), 3000.0),
    "luminance_to_hlg": (lambda peak, black: perception.luminance_to_hlg(100 * PICTURE, peak, black), 900.0, 0.1),
    "xyz_to_lab": (lambda white: perception.xyz_to_lab(PICTURE, white), D65),
    "lab_to_xyz": (lambda white: perception.lab_to_xyz(20 + 50 * PICTURE, white), D65),
    "xyz_to_luv": (lambda white: perception.xyz_to_luv(PICTURE, white), D65),
    "luv_to_xyz": (lambda white: perception.luv_to_xyz(20 + 50 * PICTURE, white), D65),
    "adapt_chromatically": (lambda one, two: perception.adapt_chromatically(PICTURE, one, two), D65, D50),
}


@pytest.mark.parametrize("name", CASES)
def test_gradient(name):
    function, *values = CASES[name]
    numbers = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in values]
    assert gradcheck(function, numbers, fast_mode=True)
    plain = [value if isinstance(value, float) else list(value) for value in values]
    if name != "airy_pattern":
        torch.testing.assert_close(function(*numbers), function(*plain), rtol=1e-6, atol=1e-6, check_dtype=False)


def test_second_derivatives_of_the_airy_pattern():
    radius = torch.tensor([0.3, 1.0, 2.5], dtype=torch.float64, requires_grad=True)
    assert gradgradcheck(lambda r: airy_pattern(r, 0.5, 0.2), (radius,), fast_mode=True)


def test_gradients_of_metameric_failure():
    observers = perception.sample_observers(2, wavelengths=WAVES).double()
    given = spectra().requires_grad_(), perception.illuminant_d65(WAVES).requires_grad_()

    def differences(primaries, reference):
        return perception.metameric_failure(primaries, reference, observers, WAVES).differences

    assert gradcheck(differences, given, fast_mode=True, atol=1e-4)


@pytest.mark.parametrize("name", ["quadratic_phase_function", "double_convergence", "prism_phase_function"])
def test_gradient_in_the_pitch_of_older_elements(name):
    """These return complex64: the angle between neighbours is a polynomial in the pitch and gives the derivative."""
    dx = torch.tensor(0.01, dtype=torch.float64, requires_grad=True)
    element = getattr(wave, name)(4, 4, 10.0, 0.4, dx)
    phase = (element[0, 0].conj() * element[1, 1]).angle()
    (slope,) = torch.autograd.grad(phase, dx)
    power = 1 if name == "prism_phase_function" else 2
    torch.testing.assert_close(slope.item(), power * phase.item() / 0.01, rtol=1e-4, atol=0.0)
