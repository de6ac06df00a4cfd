import math

import numpy as np
import pytest
import torch

import odak
from odak.learn import wave as torch_wave

WAVELENGTH, DX = 532e-9, 8e-6
K = 2 * math.pi / WAVELENGTH


def test_lens_phase_is_the_quadratic_of_its_focal_length():
    phase = odak.wave.lens_phase((5, 6), 0.2, DX, WAVELENGTH, offset=(DX, 0.0))
    y, x = (np.arange(5) - 2) * DX - DX, (np.arange(6) - 3) * DX
    np.testing.assert_allclose(phase, -K * (y[:, None] ** 2 + x**2) / (2 * 0.2), rtol=1e-12)


def test_older_lens_keeps_its_grid_and_converges():
    lens = odak.wave.quadratic_phase_function(6, 4, K, 0.1, DX)
    x, y = np.linspace(-3 * DX, 3 * DX, 6), np.linspace(-2 * DX, 2 * DX, 4)
    np.testing.assert_allclose(lens, np.exp(-1j * K * (y[:, None] ** 2 + x**2) / (2 * 0.1)), atol=1e-9)
    turned = torch_wave.quadratic_phase_function(6, 4, K, 0.1, DX, offset=[1, 2])
    expected = np.exp(-1j * K * ((x[:, None] - 2 * DX) ** 2 + (y - DX) ** 2) / (2 * 0.1))
    np.testing.assert_allclose(turned.numpy(), expected, atol=1e-5)
    np.testing.assert_allclose(
        odak.wave.double_convergence(6, 4, K, 0.1, DX), np.exp(1j * K * (x[:, None] ** 2 + y**2) / 0.1), atol=1e-9
    )
    with pytest.raises(ValueError, match="focal must be finite and not zero"):
        odak.wave.quadratic_phase_function(6, 4, K, 0.0, DX)


@pytest.mark.parametrize("shape", [(64, 65), (65, 64)])
def test_lenses_focus_where_their_documentation_says(shape):
    """On the axis of the field, index n // 2; the older grid at (n - 1)/2, at the distance f·((n - 1)/n)²."""
    focal = 0.02
    y, x = ((np.arange(n) - n // 2) * DX for n in shape)
    beam = np.exp(-(y[:, None] ** 2 + x**2) / (10 * DX) ** 2)

    def focus(lens, distance):
        field = odak.wave.propagate_beam(
            beam * lens, K, distance, DX, WAVELENGTH, "Angular Spectrum", zero_padding=(True, False, True)
        )
        power = abs(field) ** 2 / (abs(field) ** 2).sum()
        return [float((power.sum(1 - axis) * np.arange(n)).sum()) for axis, n in enumerate(shape)]

    place = focus(np.exp(1j * odak.wave.lens_phase(shape, focal, DX, WAVELENGTH)), focal)
    np.testing.assert_allclose(place, [n // 2 for n in shape], atol=1e-6)
    older = odak.wave.quadratic_phase_function(shape[1], shape[0], K, focal, DX)
    np.testing.assert_allclose(odak.wave.double_convergence(*shape, K, -2 * focal, DX), older, atol=1e-9)
    nominal = np.ones(shape, complex)
    for axis, n in enumerate(shape):
        position = (np.arange(n) - (n - 1) / 2) * DX
        line = np.exp(-1j * K * position**2 / (2 * focal * ((n - 1) / n) ** 2))
        nominal *= line[:, None] if axis == 0 else line
    np.testing.assert_allclose(older, nominal, atol=1e-9)
    place = focus(older, focal * (63 / 64) ** 2)
    np.testing.assert_allclose(place, [(n - 1) / 2 for n in shape], atol=0.02)


@pytest.mark.parametrize(("axis", "index"), [("x", 1), ("y", 0)])
def test_prism_turns_a_plane_wave_by_its_angle(axis, index):
    angle = math.degrees(math.asin(10 * WAVELENGTH / (64 * DX)))
    prism = odak.wave.prism_phase_function(*((64, 5) if axis == "y" else (5, 64)), K, angle, DX, axis)
    ratio = np.diff(np.unwrap(np.angle(prism), axis=index), axis=index)
    np.testing.assert_allclose(ratio, -K * math.sin(math.radians(angle)) * DX * 64 / 63, rtol=1e-6)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_prism_grating_on_both_faces(axis):
    result = odak.wave.prism_grating(8, 5, K, 0.7, DX, axis, 30.0)
    line = np.arange(8)[:, None] if axis == "x" else np.arange(5)[None]
    expected = np.exp(-1j * (K * math.sin(math.radians(0.7)) * line * DX + math.radians(30.0))) * np.ones((8, 5))
    np.testing.assert_allclose(result, expected, atol=1e-12)
    np.testing.assert_allclose(torch_wave.prism_grating(8, 5, K, 0.7, DX, axis, 30.0).numpy(), expected, atol=1e-6)


def test_blazed_grating_falls_in_levels():
    result = odak.wave.blazed_grating(6, 2, 3, "x")
    np.testing.assert_allclose(result[:, 0], np.exp(2j * np.pi * (np.array([6, 5, 4, 3, 2, 1]) % 3) / 3), atol=1e-12)
    np.testing.assert_allclose(odak.wave.blazed_grating(2, 6, 3, "y")[0], result[:, 0])
    np.testing.assert_allclose(odak.wave.blazed_grating(6, 2, 1), odak.wave.blazed_grating(6, 2, 2))
    np.testing.assert_allclose(torch_wave.blazed_grating(6, 2, 3).numpy(), result, atol=1e-6)


def test_linear_grating():
    rows = odak.wave.linear_grating(6, 4, every=3, add=1.0)
    assert rows.dtype == np.complex64
    expected = np.zeros((6, 4), complex)
    expected[[0, 3]] = np.exp(1j)
    np.testing.assert_allclose(rows, expected, atol=1e-6)
    np.testing.assert_allclose(odak.wave.linear_grating(4, 6, 3, 1.0, "y"), expected.T, atol=1e-6)
    i, j = np.indices((4, 5))
    checkered = np.exp(1j * 3.14 * (((i + j) % 2 + 1) % 2))
    np.testing.assert_allclose(odak.wave.linear_grating(4, 5, axis="xy"), checkered, atol=1e-6)
    np.testing.assert_allclose(torch_wave.linear_grating(4, 5, axis="x")[0].numpy(), -1, atol=1e-6)
    for face in (odak.wave, torch_wave):
        with pytest.raises(ValueError, match="axis must be one of 'x', 'y', 'xy'; got 'z'"):
            face.linear_grating(4, 4, axis="z")


def test_gratings_take_the_library_itself():
    for make in (odak.wave.blazed_grating, odak.wave.linear_grating):
        tensor = make(4, 6, xp=torch)
        np.testing.assert_allclose(tensor.numpy(), make(4, 6, xp=np), atol=1e-15)
