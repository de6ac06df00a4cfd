"""Zernike phases against the polynomials in polar form, the lens they are made of, and closed forms of the variance."""

import numpy as np
import pytest
import torch
from physics import coordinates

import odak
from odak.tools import noll_to_nm, zernike_norm, zernike_polynomial

DX, WAVELENGTH = 8e-6, 532e-9


@pytest.mark.parametrize("shape", [(31, 40), (24, 17)])
@pytest.mark.parametrize("j", [1, 2, 5, 8, 11, 20, 37])
def test_phase_is_the_polynomial_in_polar_form(shape, j):
    mode = noll_to_nm(j)
    y, x = coordinates(shape, 1.0)
    y, x = y - 1.5, x + 2.0
    expected = 0.3 * zernike_norm(*mode) * zernike_polynomial(*mode, np.hypot(x, y) / 11, np.arctan2(y, x))
    phase = odak.wave.zernike_phase(*shape, {mode: 0.3}, radius=11, offset=(1.5, -2.0))
    np.testing.assert_allclose(phase, expected, atol=1e-12)
    assert phase[0, 0] == 0


def test_defocus_is_a_lens():
    shape, focal, radius = (48, 64), 0.2, 1e-3
    # −π·r²/(λf) = −π·a²/(2λf)·((2ρ² − 1) + 1): defocus and a piston.
    depth = -np.pi * radius**2 / (2 * WAVELENGTH * focal)
    coefficients = {(2, 0): depth / np.sqrt(3), (0, 0): depth}
    phase = odak.wave.zernike_phase(*shape, coefficients, radius=radius, dx=DX)
    np.testing.assert_allclose(phase, odak.wave.lens_phase(shape, focal, DX, WAVELENGTH), atol=1e-10)


def test_tilt_moves_the_focus_along_its_axis():
    n, cycles = 64, 5
    # x·2π·cycles/n: the amplitude of c·2·ρ·cosθ is 2c/radius per pixel.
    for mode, axis in (((1, 1), 1), ((1, -1), 0)):
        phase = odak.wave.zernike_phase(n, n, {mode: np.pi * cycles}, radius=n)
        spectrum = np.abs(np.fft.fft2(np.exp(1j * phase)))
        assert np.unravel_index(spectrum.argmax(), spectrum.shape)[axis] == cycles


def test_variance_is_the_sum_of_squares():
    coefficients = {(2, 0): 0.4, (2, 2): -0.3, (3, 1): 0.2, (4, -4): 0.1, (0, 0): 2.0}
    phase = odak.wave.zernike_phase(601, 601, coefficients, radius=300)
    y, x = coordinates((601, 601), 1 / 300)
    inside = phase[x**2 + y**2 <= 1]
    assert inside.mean() == pytest.approx(2.0, abs=0.01)
    assert inside.var() == pytest.approx(0.4**2 + 0.3**2 + 0.2**2 + 0.1**2, rel=0.01)


def test_default_disc_holds_the_window_and_pitches_may_differ():
    shape = (20, 30)
    phase = odak.wave.zernike_phase(*shape, {(4, 0): 1.0})
    assert (phase != 0).all()
    y, x = coordinates(shape, 1.0)
    rho = np.hypot(2 * y, 3 * x) / 50
    expected = zernike_norm(4, 0) * zernike_polynomial(4, 0, rho, 0.0)
    np.testing.assert_allclose(
        odak.wave.zernike_phase(*shape, {(4, 0): 1.0}, radius=50, dx=(2.0, 3.0)), expected, atol=1e-12
    )


def test_basis_holds_the_terms_of_the_sum():
    modes, values = [(1, 1), (2, 0), (3, -3)], [0.1, -0.2, 0.4]
    basis = odak.learn.wave.zernike_basis(9, 12, modes, radius=5.0)
    assert basis.shape == (3, 9, 12)
    expected = odak.wave.zernike_phase(9, 12, dict(zip(modes, values, strict=True)), radius=5.0)
    np.testing.assert_allclose(np.tensordot(values, basis.numpy(), 1), expected, atol=1e-14)


def test_faces_agree_and_batches_broadcast(as_array):
    batch = np.asarray([0.1, -0.5])
    coefficients = {(2, 0): 0.3, (3, 1): batch}
    expected = np.stack([odak.wave.zernike_phase(7, 8, {(2, 0): 0.3, (3, 1): c}) for c in batch])
    result = odak.wave.zernike_phase(7, 8, {(2, 0): 0.3, (3, 1): as_array(batch)})
    np.testing.assert_allclose(np.asarray(result), expected, atol=1e-14)
    tensor = odak.learn.wave.zernike_phase(7, 8, {key: torch.as_tensor(value) for key, value in coefficients.items()})
    assert tensor.dtype == torch.float64
    np.testing.assert_allclose(tensor.numpy(), expected, atol=1e-7)


def test_gradient_in_the_coefficients_and_the_radius():
    values = torch.tensor([0.2, -0.1, 0.3, 4.5], dtype=torch.float64, requires_grad=True)

    def phase(c):
        modes = {(2, 0): c[0], (2, 2): c[1], (4, 0): c[2]}
        return odak.learn.wave.zernike_phase(5, 6, modes).sin(), odak.learn.wave.zernike_phase(5, 6, modes, radius=c[3])

    assert torch.autograd.gradcheck(phase, (values,), fast_mode=True)


@pytest.mark.parametrize(
    ("arguments", "options", "error", "message"),
    [
        ((4, 4, [0.1]), {}, TypeError, "coefficients must be a mapping"),
        ((4, 4, {(2, 1): 0.1}), {}, ValueError, "m must have"),
        ((4, 4, {(2, 0): np.nan}), {}, ValueError, "finite"),
        ((4, 4, {(2, 0): 1j}), {}, TypeError, "real number"),
        ((4, 0, {(2, 0): 0.1}), {}, ValueError, "at least 1"),
    ],
)
def test_bad_arguments_are_named(arguments, options, error, message):
    with pytest.raises(error, match=message):
        odak.wave.zernike_phase(*arguments, **options)


@pytest.mark.parametrize("size", [6, 512])
def test_the_whole_window_lies_in_its_disc(size):
    assert (odak.wave.zernike_basis(size, size, [(0, 0)], dx=8e-6) == 1).all()


def test_coefficients_of_numpy():
    for face in (odak.wave, odak.learn.wave):
        one, two = (face.zernike_phase(4, 4, {(2, 0): kind(0.1)}) for kind in (float, np.float64))
        np.testing.assert_array_equal(np.asarray(one), np.asarray(two))
