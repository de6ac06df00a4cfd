"""Propagation through media against exact series, waveguide modes and homogeneous propagation."""

import numpy as np
import pytest
import torch
from scipy.optimize import brentq
from scipy.special import eval_legendre, hankel1, jv, spherical_jn, spherical_yn

import odak
from odak.wave import propagate_beam, propagate_through_medium, scattered_field

K = 2 * np.pi  # The wavelength is 1 in this module.


def cylinder_field(x, y, radius, index, orders=26):
    """Return the total field around a cylinder in a plane wave exp(ikx), the electric field along its axis.

    H. C. van de Hulst, Light Scattering by Small Particles (1957), section 15.1.
    """
    r, azimuth = np.hypot(x, y), np.arctan2(y, x)
    outside = r > radius
    total = np.where(outside, np.exp(1j * K * x), 0)
    a, b = K * radius, index * K * radius
    for order in range(-orders, orders + 1):
        j, dj = jv(order, a), (jv(order - 1, a) - jv(order + 1, a)) / 2
        inner, d_inner = jv(order, b), (jv(order - 1, b) - jv(order + 1, b)) / 2
        h, dh = hankel1(order, a), (hankel1(order - 1, a) - hankel1(order + 1, a)) / 2
        scattered = -(index * d_inner * j - inner * dj) / (index * d_inner * h - inner * dh)
        wave = np.where(
            outside,
            scattered * hankel1(order, K * np.maximum(r, radius / 2)),
            (j + scattered * h) / inner * jv(order, index * K * r),
        )
        total = total + 1j**order * np.exp(1j * order * azimuth) * wave
    return total


def test_a_cylinder_scatters_as_the_exact_series():
    n, dx, radius, index = 96, 1 / 16, 1.0, 1.33
    x = (np.arange(n) - n // 2) * dx
    x, y = x[None, :], x[:, None]
    offsets = ((np.arange(8) + 0.5) / 8 - 0.5) * dx
    inside = np.mean([(y + a) ** 2 + (x + b) ** 2 <= radius**2 for a in offsets for b in offsets], axis=0)
    medium = np.sqrt(1 + (index**2 - 1) * inside)
    incident = np.exp(1j * K * x) * np.ones_like(y)
    found = scattered_field(incident, medium, dx, 1.0, absorber=2.0)
    expected = cylinder_field(x, y, radius, index)
    assert np.linalg.norm(found - expected) < 0.01 * np.linalg.norm(expected - incident)


@pytest.mark.slow
def test_a_ball_scatters_as_its_partial_waves():
    """Scalar waves, continuous with their derivative across the surface (an acoustic Mie series)."""
    n, dx, radius, index = 40, 1 / 8, 1.0, 1.2
    g = (np.arange(n) - n // 2) * dx
    z, y, x = g[:, None, None], g[None, :, None], g[None, None, :]
    offsets = ((np.arange(5) + 0.5) / 5 - 0.5) * dx
    inside = np.mean(
        [(x + a) ** 2 + (y + b) ** 2 + (z + c) ** 2 <= radius**2 for a in offsets for b in offsets for c in offsets],
        axis=0,
    )
    incident = np.exp(1j * K * z) * np.ones((n, n, n))
    found = scattered_field(incident, np.sqrt(1 + (index**2 - 1) * inside), dx, 1.0, absorber=1.5, tolerance=1e-4)
    r = np.sqrt(x**2 + y**2 + z**2)
    cosine = np.divide(z, r, where=r > 0, out=np.zeros_like(r))
    expected = np.where(r > radius, incident, 0)
    a, b = K * radius, index * K * radius

    def hankel(order, t, derivative=False):
        return spherical_jn(order, t, derivative) + 1j * spherical_yn(order, t, derivative)

    for order in range(20):
        j, dj = spherical_jn(order, a), spherical_jn(order, a, True)
        inner, d_inner = spherical_jn(order, b), spherical_jn(order, b, True)
        h, dh = hankel(order, a), hankel(order, a, True)
        scattered = -(index * d_inner * j - inner * dj) / (index * d_inner * h - inner * dh)
        wave = np.where(
            r > radius,
            scattered * hankel(order, K * np.maximum(r, radius / 2)),
            (j + scattered * h) / inner * spherical_jn(order, index * K * r),
        )
        expected = expected + (2 * order + 1) * 1j**order * eval_legendre(order, cosine) * wave
    assert np.linalg.norm(found - expected) < 0.01 * np.linalg.norm(expected)


@pytest.mark.parametrize(("method", "phase"), [("split-step", 8e-3), ("wave propagation", 4e-3)])
def test_a_waveguide_keeps_its_mode(method, phase):
    """The fundamental mode of a slab propagates with its propagation constant (u·tan u = √(V² − u²))."""
    core, cladding, half, length, dz = 1.46, 1.45, 2.0, 50.0, 0.5
    v = K * half * np.sqrt(core**2 - cladding**2)
    u = brentq(lambda t: t * np.tan(t) - np.sqrt(v**2 - t**2), 1e-6, np.pi / 2 - 1e-9)
    beta = np.sqrt((K * core) ** 2 - (u / half) ** 2)
    x = (np.arange(512) - 256) * 0.125
    decay = np.sqrt(v**2 - u**2) / half
    mode = np.where(np.abs(x) <= half, np.cos(u / half * x), np.cos(u) * np.exp(-decay * (np.abs(x) - half)))
    inside = np.clip((half - np.abs(x)) / 0.125 + 0.5, 0, 1)
    slices = [np.sqrt(cladding**2 + (core**2 - cladding**2) * inside)[None, :]] * int(length / dz)
    found = propagate_through_medium(mode[None, :].astype(complex), slices, 0.125, dz, 1.0, method)[0]
    overlap = np.vdot(mode, found) / np.vdot(mode, mode)
    assert abs(abs(overlap) - 1) < 1e-3
    assert abs(np.angle(overlap * np.exp(-1j * beta * length))) < phase


def test_forward_scattering_by_a_weak_cylinder():
    """Both slice methods against the exact series behind the cylinder; the wave propagation method is nearer."""
    radius, index, dz = 3.0, 1.1, 0.05
    x = (np.arange(512) - 256) * 0.1
    z = np.arange(-5, 5, dz) + dz / 2
    medium = np.where(z[:, None] ** 2 + x**2 <= radius**2, index, 1.0)[:, None, :]
    incident = np.exp(-1j * K * 5) * np.ones((1, 512), dtype=complex)
    centre = np.abs(x) < 10
    expected = cylinder_field(np.full(512, 5.0), x, radius, index, 60)[centre]
    error = {}
    for method in ("split-step", "wave propagation"):
        found = propagate_through_medium(incident, medium, 0.1, dz, 1.0, method)[0, centre]
        error[method] = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    assert error["wave propagation"] < error["split-step"] < 0.08


@pytest.mark.parametrize("method", ["split-step", "wave propagation"])
def test_uniform_slabs_are_exact_and_absorb(method):
    generator = np.random.default_rng(2)
    field = generator.normal(size=(2, 16, 12)) + 1j * generator.normal(size=(2, 16, 12))
    slabs = [1.0, 1.7, np.full((16, 12), 1.3 + 0.02j)]
    found = propagate_through_medium(field, slabs, (0.6, 0.8), 0.7, 1.0, method)
    expected = field
    for index in (1.0, 1.7, 1.3):
        fy, fx = np.fft.fftfreq(16, 0.6)[:, None], np.fft.fftfreq(12, 0.8)
        axial = np.emath.sqrt(index**2 - fy**2 - fx**2)
        expected = np.fft.ifft2(np.fft.fft2(expected) * np.exp(2j * np.pi * 0.7 * axial))
    np.testing.assert_allclose(found, expected * np.exp(-K * 0.02 * 0.7), atol=1e-12)


def test_methods_agree_with_free_space_and_borders_absorb():
    field = np.zeros((64, 64), dtype=complex)
    field[28:36, 28:36] = 1
    free = propagate_through_medium(field, np.ones((20, 64, 64)), 0.5, 1.0, 1.0)
    np.testing.assert_allclose(free, propagate_beam(field, None, 20.0, 0.5, 1.0, "Angular Spectrum"), atol=1e-12)
    wide = np.zeros((256, 256), dtype=complex)
    wide[124:132, 124:132] = 1
    expected = propagate_beam(wide, None, 60.0, 0.5, 1.0, "Angular Spectrum")[96:160, 96:160]
    errors = []
    for width in (0.0, 8.0):
        found = propagate_through_medium(field, np.ones((60, 64, 64)), 0.5, 1.0, 1.0, absorber=width)
        errors.append(np.linalg.norm((found - expected)[22:42, 22:42]) / np.linalg.norm(expected[22:42, 22:42]))
    assert errors[0] > 0.1 and errors[1] < 0.3 * errors[0]


def test_slices_may_come_from_a_generator():
    field = np.ones((8, 8), dtype=complex)
    field[2:5, 3:6] = 2j
    medium = 1.4 + 0.1 * np.random.default_rng(0).random((6, 8, 8))
    listed = propagate_through_medium(field, medium, 0.6, 0.3, 1.0)
    streamed = propagate_through_medium(field, (medium[k] for k in range(6)), 0.6, 0.3, 1.0)
    np.testing.assert_array_equal(listed, streamed)


@pytest.mark.parametrize("method", ["split-step", "wave propagation"])
def test_gradients_and_faces(method):
    generator = torch.Generator().manual_seed(0)
    field = torch.randn(2, 5, 6, dtype=torch.complex128, generator=generator).requires_grad_()
    medium = (1.3 + 0.1 * torch.rand(4, 5, 6, dtype=torch.float64, generator=generator)).requires_grad_()
    dz, wavelength = (torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.31, 0.9))

    def through(field, medium, dz, wavelength):
        return propagate_through_medium(field, medium, 0.4, dz, wavelength, method, levels=3, absorber=0.5)

    assert torch.autograd.gradcheck(through, (field, medium, dz, wavelength), fast_mode=True)
    tensors = through(field, medium, dz, wavelength).detach().numpy()
    arrays = propagate_through_medium(
        field.detach().numpy(), medium.detach().numpy(), 0.4, 0.31, 0.9, method, levels=3, absorber=0.5
    )
    np.testing.assert_allclose(tensors, arrays, atol=1e-12)
    single = through(field.detach().to(torch.complex64), medium.detach(), dz.detach(), wavelength.detach())
    assert single.dtype == torch.complex64
    np.testing.assert_allclose(single.numpy(), arrays, atol=1e-4)


@pytest.mark.slow
def test_gradients_of_the_born_series():
    generator = torch.Generator().manual_seed(0)
    incident = torch.exp(1.5j * torch.arange(4, dtype=torch.float64))[:, None].repeat(1, 5).requires_grad_()
    medium = (1 + 0.2 * torch.rand(4, 5, dtype=torch.float64, generator=generator)).requires_grad_()

    def scatter(incident, medium):
        return scattered_field(incident, medium, 0.2, 1.0, absorber=0.6, tolerance=1e-9, iterations=9000)

    assert torch.autograd.gradcheck(scatter, (incident, medium), atol=1e-5, fast_mode=True)
    arrays = scattered_field(
        incident.detach().numpy(), medium.detach().numpy(), 0.2, 1.0, absorber=0.6, tolerance=1e-9, iterations=9000
    )
    np.testing.assert_allclose(scatter(incident, medium).detach().numpy(), arrays, atol=1e-9)


@pytest.mark.slow
def test_gradients_of_the_born_series_in_its_lengths():
    incident = torch.exp(1.5j * torch.arange(4, dtype=torch.float64))[:, None].repeat(1, 5)
    medium = 1 + 0.2 * torch.rand(4, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    numbers = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.2, 1.0, 1.1)]

    def scatter(dx, wavelength, background):
        return scattered_field(incident, medium, dx, wavelength, background, 0.3, 1e-8, 9000)

    assert torch.autograd.gradcheck(scatter, numbers, atol=1e-5, fast_mode=True)


def test_coarse_slices_and_short_series_warn():
    field = np.ones((8, 8), dtype=complex)
    medium = 1.4 + 0.1 * np.random.default_rng(0).random((1, 8, 8))
    with pytest.warns(odak.SamplingWarning, match="make dz smaller"):
        propagate_through_medium(field, medium, 0.6, 30.0, 1.0)
    with pytest.warns(odak.ConvergenceWarning, match="did not reach"):
        scattered_field(field, medium[0], 0.2, 1.0, iterations=3)
    with pytest.raises(ValueError, match=r"index must be \[slices, 8, 8\]"):
        propagate_through_medium(field, medium[..., :4], 0.6, 0.1, 1.0)


@pytest.mark.parametrize("levels", [2, 8])
def test_plane_waves_of_few_indices_are_those_of_each(random, levels):
    """Each sample has the wave of its own index; a medium of one index that is learned has no NaN."""
    field = random.normal(size=(12, 16)) + 1j * random.normal(size=(12, 16))
    indices = np.array([1.0, 1.3, 1.5])[:levels]
    which = random.integers(len(indices), size=(12, 16))
    options = {"method": "wave propagation", "levels": levels}
    found = propagate_through_medium(field, indices[which][None], 1.0, 2.0, 0.6, **options)
    fy, fx = np.fft.fftfreq(12)[:, None], np.fft.fftfreq(16)
    for k, index in enumerate(indices):
        axial = np.emath.sqrt((index / 0.6) ** 2 - fy**2 - fx**2)
        wave = np.fft.ifft2(np.fft.fft2(field) * np.exp(2j * np.pi * 2.0 * axial))
        np.testing.assert_allclose(found[which == k], wave[which == k], atol=1e-12)
    learned = torch.full((1, 12, 16), 1.3, dtype=torch.float64, requires_grad=True)
    through = propagate_through_medium(torch.from_numpy(field), learned, 1.0, 2.0, 0.6, **options)
    axial = np.emath.sqrt((1.3 / 0.6) ** 2 - fy**2 - fx**2)
    wave = np.fft.ifft2(np.fft.fft2(field) * np.exp(2j * np.pi * 2.0 * axial))
    np.testing.assert_allclose(through.detach().numpy(), wave, atol=1e-12)
    (slope,) = torch.autograd.grad(through.abs().sum(), learned)
    assert bool(slope.isfinite().all())


def test_few_levels_of_index_cost_little_with_bounded_error():
    """Against the plane waves of each of the indices that are there; axial waves are exact with any levels."""
    place = (np.arange(32) - 16) * 0.5e-6
    beam = np.exp(-(place[:, None] ** 2 + place**2) / (1e-6) ** 2).astype(complex)
    steps = np.random.default_rng(0).integers(0, 12, (8, 32, 32))
    index, lengths = 1.33 + 0.26 * steps / 11, (0.5e-6, 0.2e-6, 532e-9, "wave propagation")
    exact = propagate_through_medium(beam, index, *lengths, levels=12)
    error = {
        levels: np.linalg.norm(propagate_through_medium(beam, index, *lengths, levels=levels) - exact)
        / np.linalg.norm(exact)
        for levels in (2, 4, 8)
    }
    split = propagate_through_medium(beam, index, *lengths[:3])
    # The largest phase between two neighbouring indices, of waves at the edge of the band, squared over eight.
    sine = 532e-9 * np.hypot(1e6, 1e6) / 1.33
    phase = K / 532e-9 * 0.2e-6 * 0.26 * (1 / np.sqrt(1 - sine**2) - 1)
    for levels, found in error.items():
        assert found < len(index) * (phase / (levels - 1)) ** 2 / 8
    assert error[8] < error[4] / 3 < error[2] / 15
    assert error[2] < 0.5 * np.linalg.norm(split - exact) / np.linalg.norm(exact)
    flat = np.ones((32, 32), dtype=complex)
    sides = np.broadcast_to(1.33 + 0.26 * (np.arange(12) / 11)[:, None, None], (12, 32, 32))
    carried = propagate_through_medium(flat, sides, *lengths, levels=2)
    assert np.allclose(carried, np.exp(1j * K * 0.2e-6 / 532e-9 * sides[:, 0, 0].sum()), atol=1e-10)


def test_an_index_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match=r"index must have positive real parts, got -1\.5"):
        odak.wave.propagate_through_medium(np.ones((8, 8), complex), np.full((2, 8, 8), -1.5), 1e-6, 1e-6, 532e-9)
