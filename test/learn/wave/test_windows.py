"""Windows, tilted planes and partial coherence in torch: gradients, transforms, and agreement with NumPy."""

import numpy as np
import pytest
import torch

import odak
from odak.learn import wave

WAVELENGTH, DX = 532e-9, 8e-6
FIELD = torch.randn(4, 5, dtype=torch.complex128, generator=torch.Generator().manual_seed(3))


def lengths(*values):
    return [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in values]


def to_window(field, wavelength, distance, dx, pitch, shift):
    return wave.propagate_to_window(field, wavelength, distance, dx, (3, 2), pitch, (shift, 1e-5))


def test_gradient_in_the_field():
    field = FIELD.clone().requires_grad_()

    def window(u):
        return to_window(u, WAVELENGTH, 2e-3, DX, 5e-6, 2e-5)

    def tilted(u):
        return wave.propagate_to_tilted_plane(u, WAVELENGTH, 2e-3, DX, (10.0, 20.0, 30.0), (3, 2), 5e-6)

    assert torch.autograd.gradcheck(window, (field,), fast_mode=True)
    assert torch.autograd.gradgradcheck(window, (field,), fast_mode=True)
    # The many taps of the non-uniform transform make the full check slow.
    assert torch.autograd.gradcheck(tilted, (field,), fast_mode=True)


def test_window_gradient_in_every_length():
    def function(wavelength, distance, dx, pitch, shift):
        result = to_window(FIELD, WAVELENGTH * wavelength, 2e-3 * distance, DX * dx, 5e-6 * pitch, 2e-5 * shift)
        return result.abs() ** 2

    assert torch.autograd.gradcheck(function, lengths(1, 1, 1, 1, 1), eps=1e-6, atol=1e-5, rtol=1e-4)


def test_tilted_gradient_in_lengths_and_angles():
    def function(wavelength, distance, dx, first, second, third):
        angles = (20 * first, -30 * second, 15 * third)
        result = wave.propagate_to_tilted_plane(
            FIELD, WAVELENGTH * wavelength, 2e-3 * distance, DX * dx, angles, (3, 2), 5e-6
        )
        return result.abs() ** 2

    assert torch.autograd.gradcheck(function, lengths(1, 1, 1, 1, 1, 1), eps=1e-6, atol=1e-5, rtol=1e-4, fast_mode=True)


def test_partial_coherence_gradients():
    wavelengths, weights = wave.gaussian_spectrum(550e-9, 30e-9, 2)
    directions, shares = wave.disk_source(5e-3, 1, 3)

    def function(u, spread, w, tilt, s, z):
        spectrum, source = (wavelengths * spread, weights * w), (directions * tilt, shares * s)
        return wave.propagate_partially_coherent(u, spectrum, source, 2e-3 * z, DX, (3, 2), 5e-6, memory=1)

    inputs = FIELD[:2, :2].clone().requires_grad_(), *lengths(1, 1, 1, 1, 1)
    assert torch.autograd.gradcheck(function, inputs, eps=1e-6, atol=1e-5, rtol=1e-4, fast_mode=True)


def test_a_distance_is_found_from_a_window():
    beam = torch.exp(-(torch.linspace(-3, 3, 48, dtype=torch.float64) ** 2))
    beam = (beam[:, None] * beam).to(torch.complex128)
    recorded = wave.propagate_to_window(beam, WAVELENGTH, 0.03, DX, (10, 10), 3e-5).abs() ** 2
    distance = torch.tensor(0.028, dtype=torch.float64, requires_grad=True)
    for _ in range(8):
        result = wave.propagate_to_window(beam, WAVELENGTH, distance, DX, (10, 10), 3e-5).abs() ** 2
        # Gauss–Newton in one unknown.
        (slope,) = torch.autograd.functional.jvp(
            lambda z: wave.propagate_to_window(beam, WAVELENGTH, z, DX, (10, 10), 3e-5).abs() ** 2,
            distance.detach(),
            torch.ones_like(distance),
        )[1:]
        with torch.no_grad():
            distance -= ((result - recorded) * slope).sum() / (slope**2).sum()
    assert distance.item() == pytest.approx(0.03, rel=1e-6)


def test_functional_transforms():
    def power(u):
        return (wave.propagate_to_window(u, WAVELENGTH, 2e-3, DX, (3, 2)).abs() ** 2).sum()

    fields = torch.stack([FIELD, 2 * FIELD])
    each = torch.func.vmap(power)(fields)
    torch.testing.assert_close(each, torch.stack([power(u) for u in fields]))
    gradient = torch.func.grad(lambda z: (wave.propagate_to_window(FIELD, WAVELENGTH, z, DX, (3, 2)).abs() ** 2).sum())
    z = torch.tensor(2e-3, dtype=torch.float64, requires_grad=True)
    (expected,) = torch.autograd.grad((wave.propagate_to_window(FIELD, WAVELENGTH, z, DX, (3, 2)).abs() ** 2).sum(), z)
    torch.testing.assert_close(gradient(z.detach()), expected)
    with pytest.raises(ValueError, match="vmapped"):
        torch.func.vmap(lambda z: wave.propagate_to_window(FIELD, WAVELENGTH, z, DX))(z.detach()[None])


@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
def test_both_faces_agree(dtype):
    field = FIELD.to(dtype)
    tolerance = 1e-10 if dtype == torch.complex128 else 1e-5
    arguments = WAVELENGTH, 2e-3, DX
    lamp = odak.wave.gaussian_spectrum(550e-9, 30e-9, 2), odak.wave.disk_source(5e-3, 2, 3)
    pairs = (
        (wave.propagate_to_window, odak.wave.propagate_to_window, (*arguments, (6, 7), 5e-6, (1e-5, 0.0))),
        (wave.propagate_to_tilted_plane, odak.wave.propagate_to_tilted_plane, (*arguments, (10.0, 20.0, 0.0))),
        (wave.propagate_partially_coherent, odak.wave.propagate_partially_coherent, (*lamp, 2e-3, DX)),
    )
    for torch_face, numpy_face, rest in pairs:
        result = torch_face(field, *rest)
        assert result.dtype in (dtype, dtype.to_real())
        np.testing.assert_allclose(result.numpy(), numpy_face(field.numpy(), *rest), atol=tolerance)
    for one, two in zip(lamp, (wave.gaussian_spectrum(550e-9, 30e-9, 2), wave.disk_source(5e-3, 2, 3)), strict=True):
        for a, b in zip(one, two, strict=True):
            np.testing.assert_array_equal(b.numpy(), a)


def test_backward_memory_is_bounded():
    """Many directions one at a time save what one direction saves, not what all do."""
    field = torch.ones(64, 64, dtype=torch.complex64, requires_grad=True)
    saved = []

    def pack(tensor):
        saved.append(tensor.numel() * tensor.element_size())
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
        wave.propagate_partially_coherent(field, WAVELENGTH, wave.disk_source(1e-3, 4, 8), 1e-3, DX, memory=1)
    # A single propagation alone would save a dozen arrays of the padded size for each of 32 directions.
    assert sum(saved) < 32 * 2 * field.numel() * 8
