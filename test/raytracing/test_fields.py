"""Rays of fields: plane and spherical waves, their rims, both faces, what is no ray."""

import math

import array_api_strict
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from odak import learn, raytracing
from odak.raytracing import rays_from_field

WAVELENGTH = 500e-9
angles = st.floats(-13, 13)


def grid(count, dx):
    line = (np.arange(count) - count // 2) * dx
    return line[None, :] + 0 * line[:, None], line[:, None] + 0 * line[None, :]


def spherical(focus, dx=2e-6, count=64):
    """Return a wave that converges to a point."""
    x, y = grid(count, dx)
    distance = np.sqrt((x - focus[0]) ** 2 + (y - focus[1]) ** 2 + focus[2] ** 2)
    return np.exp(-2j * np.pi / WAVELENGTH * distance) / distance


@given(angles, angles, st.integers(1, 9), st.integers(1, 9))
def test_a_plane_wave_goes_where_it_was_sent(along_x, along_y, rows, columns):
    u, v = math.sin(math.radians(along_x)), math.sin(math.radians(along_y))
    x, y = (np.arange(columns) - columns // 2) * 1e-6, (np.arange(rows) - rows // 2) * 8e-7
    wave = 3 * np.exp(2j * np.pi / WAVELENGTH * (u * x[None, :] + v * y[:, None]))
    found = rays_from_field(wave, (8e-7, 1e-6), WAVELENGTH, z=2.0)
    assert found.ray.shape == (rows, columns, 2, 3)
    np.testing.assert_allclose(found.ray[..., 0, 0], np.broadcast_to(x, (rows, columns)))
    np.testing.assert_allclose(found.ray[..., 0, 1], np.broadcast_to(y[:, None], (rows, columns)))
    assert (found.ray[..., 0, 2] == 2.0).all()
    np.testing.assert_allclose(found.power, 9)
    if min(rows, columns) > 1:
        np.testing.assert_allclose(found.ray[..., 1, 0], u, atol=1e-9)
        np.testing.assert_allclose(found.ray[..., 1, 1], v, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(found.ray[..., 1, :], axis=-1), 1)
    else:
        # One sample has no neighbour from which its derivative could be computed.
        assert np.isnan(found.ray[..., 1, :]).all()
    away = found.path - u * x[None, :] - v * y[:, None]
    np.testing.assert_allclose(away / WAVELENGTH, np.round(away / WAVELENGTH), atol=1e-9)


@pytest.mark.parametrize("focus", [(0.0, 0.0, 5e-3), (1e-4, -2e-4, 5e-3)])
def test_rays_of_a_spherical_wave_meet_at_its_focus(focus):
    """Rim and dark places included; the differences' error is of second order in the pitch."""
    field = spherical(focus)
    x, y = grid(64, 2e-6)
    field = np.where(x**2 + y**2 < 60e-6**2, field, 0)
    missed = []
    for step in (2, 1):
        found = rays_from_field(field[::step, ::step], 2e-6 * step, WAVELENGTH)
        start, direction = found.ray[..., 0, :], found.ray[..., 1, :]
        kept = np.isfinite(direction).all(-1)
        lit = field[::step, ::step] != 0
        alone = lit & ((lit.sum(0) == 1) | (lit.sum(1) == 1)[:, None])
        assert (kept == (lit & ~alone)).all()
        landed = start + direction * (focus[2] / direction[..., 2:])
        missed.append(np.abs(landed[kept][:, :2] - focus[:2]).max())
    assert missed[1] < 2e-9 and missed[1] < missed[0] / 3
    diverging = rays_from_field(field.conj(), 2e-6, WAVELENGTH).ray
    back = diverging[..., 0, :] - diverging[..., 1, :] * (focus[2] / diverging[..., 1, 2:])
    np.testing.assert_allclose(back[kept][:, :2], np.tile(focus[:2], (kept.sum(), 1)), atol=2e-9)


def test_both_faces_and_the_strict_array_library_agree():
    field = np.stack([spherical((0.0, 0.0, 5e-3)), spherical((1e-4, 0.0, 3e-3))])
    field[0, :3] = 0
    expected = rays_from_field(field, 2e-6, WAVELENGTH)
    tensor = learn.raytracing.rays_from_field(torch.from_numpy(field), 2e-6, WAVELENGTH)
    strict = rays_from_field(array_api_strict.asarray(field), 2e-6, WAVELENGTH)
    for a, b, c in zip(expected, tensor, strict, strict=True):
        np.testing.assert_allclose(b.numpy(), a, rtol=1e-12, atol=1e-10)
        np.testing.assert_allclose(np.asarray(c), a, rtol=1e-12, atol=1e-10)
    narrow = learn.raytracing.rays_from_field(torch.from_numpy(field).to(torch.complex64), 2e-6, WAVELENGTH)
    assert all(value.dtype == torch.float32 for value in narrow)
    assert raytracing.rays_from_field is learn.raytracing.rays_from_field


def test_gradients_pass_dark_samples_without_nan():
    torch.manual_seed(0)
    phase = 0.4 * torch.rand(5, 6, dtype=torch.float64)
    amplitude = torch.ones(5, 6, dtype=torch.float64)
    amplitude[2, 2:4] = 0

    def values(phase):
        found = rays_from_field(amplitude * torch.exp(1j * phase), 2e-6, WAVELENGTH)
        return torch.where(found.ray.isnan(), 0.0, found.ray)[..., 1, :], found.path

    phase.requires_grad_()
    assert torch.autograd.gradcheck(values, phase, fast_mode=True)
    field = (amplitude * torch.exp(1j * phase)).detach().requires_grad_()
    found = rays_from_field(field, 2e-6, WAVELENGTH)
    kept = found.ray[..., 1, 2].isfinite()
    assert kept.sum() == (amplitude > 0).sum()
    found.ray[..., 1, :][kept].sum().backward()
    assert bool(torch.view_as_real(field.grad).isfinite().all())


def test_waves_that_decay_have_no_rays():
    """A phase that turns faster than light can: u² + v² > 1."""
    x, y = grid(8, 1e-7)
    found = rays_from_field(np.exp(2j * np.pi / WAVELENGTH * 0.9 * (x + y)), 1e-7, WAVELENGTH)
    assert np.isnan(found.ray[..., 1, :]).all() and np.isfinite(found.ray[..., 0, :]).all()
