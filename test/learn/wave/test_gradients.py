"""Gradients of every method, in the field and in each length, against central differences in float64."""

import pytest
import torch

from odak.learn.wave import intensity, propagate_beam, unit_phasor
from odak.wave.methods import METHODS

NAMES = [method.name for method in METHODS if method.name != "custom"]


def complex_field(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, dtype=torch.complex128, generator=generator)


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("padding", [(True, False, True), (False, True, False)])
def test_field(method, padding):
    field = complex_field(2, 2, 3).requires_grad_()

    def function(u):
        return propagate_beam(u, None, 1e-3, 8e-6, 532e-9, method, zero_padding=padding, samples=(2, 2, 1, 1))

    assert torch.autograd.gradcheck(function, (field,), fast_mode=True)


@pytest.mark.parametrize("method", NAMES)
def test_field_twice(method):
    field = complex_field(2, 3).requires_grad_()
    assert torch.autograd.gradgradcheck(
        lambda u: propagate_beam(u, None, 1e-3, 8e-6, 532e-9, method, samples=(1, 1, 1, 1)), (field,), fast_mode=True
    )


@pytest.mark.parametrize("method", NAMES)
def test_distance_pitch_and_wavelength(method):
    field = complex_field(3, 2)

    def function(distance, pitch, wavelength):
        result = propagate_beam(field, None, 1e-3 * distance, 8e-6 * pitch, 532e-9 * wavelength, method)
        return result.abs() ** 2

    one = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in (1.0, 1.0, 1.0)]
    assert torch.autograd.gradcheck(function, one, eps=1e-6, atol=1e-5, rtol=1e-4, fast_mode=True)


def test_phase_of_the_field_in_distance():
    distance = torch.tensor(0.2, dtype=torch.float64, requires_grad=True)
    result = propagate_beam(
        torch.ones(4, 4, dtype=torch.complex128), None, distance, 8e-6, 532e-9, "AS", zero_padding=[False] * 3
    )
    (gradient,) = torch.autograd.grad(torch.angle(result[0, 0]), distance)
    assert gradient.item() == pytest.approx(2 * torch.pi / 532e-9, rel=1e-12)


def test_phasor_and_intensity():
    phase = torch.randn(3, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(unit_phasor, (phase,), check_batched_grad=True)
    assert torch.autograd.gradgradcheck(unit_phasor, (phase,))
    field = complex_field(3, 4).requires_grad_()
    assert torch.autograd.gradcheck(intensity, (field,), check_batched_grad=True)
    assert torch.autograd.gradgradcheck(intensity, (field,))
    zero = torch.zeros(2, dtype=torch.complex128, requires_grad=True)
    intensity(zero).sum().backward()
    assert (zero.grad == 0).all()


def test_kernel_may_carry_the_gradient():
    field, kernel = complex_field(4, 5), complex_field(4, 5, seed=1).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda h: propagate_beam(field, None, 1.0, 1.0, 1.0, "custom", kernel=h, zero_padding=[False] * 3),
        (kernel,),
        fast_mode=True,
    )


def test_aperture_may_carry_the_gradient():
    field = complex_field(4, 5)
    aperture = torch.rand(8, 10, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda a: propagate_beam(field, None, 1e-3, 8e-6, 532e-9, aperture=a), (aperture,), fast_mode=True
    )
