"""Holograms and circular gratings as surfaces of a lens: rays, waves and first-order optics agree."""

import math

import numpy as np
import pytest
import torch

from odak.learn.raytracing.system import (
    exit_field,
    first_order,
    optical_system,
    rms_spot,
    surface,
    system_from_dict,
    system_to_dict,
    trace,
    trace_fields,
    wavefront,
)
from odak.learn.wave import propagate_beam
from odak.raytracing import RayStatus
from odak.raytracing.interfaces import HologramPhase, PolynomialPhase, RadialGrating, RadialPhase

F64 = torch.float64
WAVELENGTH, FOCUS, PITCH, SIZE = 0.5e-3, 50.0, 0.008, 128


def grid(size=SIZE, pitch=PITCH):
    line = (torch.arange(size, dtype=F64) - size // 2) * pitch
    return torch.meshgrid(line, line, indexing="ij")


def lens_of(phase, aperture=0.9, **options):
    return optical_system([surface(phase=phase, thickness=FOCUS)], aperture, wavelengths=WAVELENGTH, **options)


def test_a_lens_phase_as_a_hologram_is_that_lens():
    """Wrapped samples of a parabola: cubic convolution is exact for it, so that rays are those of the formula."""
    y, x = grid()
    wrapped = torch.angle(torch.exp(-1j * math.pi / WAVELENGTH / FOCUS * (x * x + y * y)))
    held, formula = HologramPhase(wrapped, PITCH), RadialPhase([-math.pi / WAVELENGTH / FOCUS])
    lens, ideal = lens_of(held, fields=[0.0, 1.0]), lens_of(formula, fields=[0.0, 1.0])
    assert abs(float(first_order(lens).focal_length) - FOCUS) < 1e-8
    found, expected = trace_fields(lens, "rings", 4), trace_fields(ideal, "rings", 4)
    assert torch.allclose(found.x, expected.x, rtol=0, atol=1e-10)
    assert torch.allclose(found.y, expected.y, rtol=0, atol=1e-10)
    # Paths differ by whole wavelengths, those of the unwrapped hologram not at all.
    cycles = (found.path - expected.path) / WAVELENGTH
    assert float((cycles - cycles.round()).abs().max()) < 1e-6 < float(cycles.abs().max())
    smooth = lens_of(HologramPhase.unwrapped(wrapped, PITCH), fields=[0.0, 1.0])
    assert torch.allclose(wavefront(smooth).path, wavefront(ideal).path, rtol=0, atol=1e-6)


def test_a_blazed_hologram_obeys_the_grating_equation():
    """n·sin θ₂ = sin θ₁ + m·λ·f, in glass and for the second order; beyond the samples rays are vignetted."""
    y, _ = grid()
    frequency = 31.25 / 2
    wrapped = torch.angle(torch.exp(2j * math.pi * frequency * y))
    for order in (1.0, 2.0, -1.0):
        flat = surface(phase=HologramPhase(wrapped, PITCH, order), thickness=1.0, material=1.5)
        lens = optical_system([flat], 0.5, wavelengths=WAVELENGTH, fields=[3.0])
        angle = (math.sin(math.radians(3.0)) + order * WAVELENGTH * frequency) / 1.5
        assert torch.allclose(trace_fields(lens, "grid", 5).v, torch.tensor(angle, dtype=F64), rtol=0, atol=1e-12)
    wide = trace_fields(lens_of(HologramPhase(wrapped, PITCH), 1.2), "x", 13)
    place = torch.linspace(-0.6, 0.6, 13, dtype=F64) / PITCH + SIZE // 2
    inside = (place >= 1) & (place <= SIZE - 2)
    assert torch.equal(wide.status[0, 0] == RayStatus.HIT, inside)
    assert bool((wide.status[0, 0][~inside] == RayStatus.VIGNETTED).all())


def test_the_wave_behind_a_hologram_goes_where_its_rays_go():
    """The centroid of the light moves as the rays weighted with its power do (Ehrenfest's theorem)."""
    size, pitch, distance = 256, 0.008, 30.0
    y, x = grid(size, pitch)
    phase = -30.0 * ((x - 0.1) ** 2 + 0.5 * y * y) + 25.0 * torch.sin(3 * y + 1) * x + 40.0 * torch.cos(2.5 * x)
    amplitude = torch.exp(-((x + 0.05) ** 2 + y * y) / 0.25**2)
    image = propagate_beam(
        amplitude * torch.exp(1j * phase), None, distance, pitch, WAVELENGTH, "Bandlimited Angular Spectrum"
    )
    intensity = image.abs().square()
    wave = [float((value * intensity).sum() / intensity.sum()) for value in (x, y)]
    system = optical_system(
        [surface(phase=HologramPhase(torch.angle(torch.exp(1j * phase)), pitch), thickness=distance)],
        1.0,
        wavelengths=WAVELENGTH,
    )
    kept = (x.abs() < 0.9) & (y.abs() < 0.9)
    start = torch.stack([x[kept], y[kept], 0 * x[kept]], -1)
    ahead = torch.tensor([0.0, 0.0, 1.0], dtype=F64).expand_as(start)
    found, weight = trace(system, torch.stack([start, ahead], -2)), amplitude[kept].square()
    rays = [float((value[0, 0] * weight).sum() / weight.sum()) for value in (found.x, found.y)]
    assert abs(rays[0]) > 0.04
    assert np.allclose(rays, wave, rtol=0, atol=2e-4)


def test_the_field_behind_a_hologram_in_a_lens_focuses():
    """Rays through glass and hologram, on as a wave: the Strehl ratio is 1 where the hologram undoes the glass."""
    glass = [surface(10.0, thickness=2.0, material=1.5), surface(thickness=0.5)]
    bare = optical_system([*glass, surface(thickness=16.0)], 1.2, wavelengths=WAVELENGTH)
    bent = wavefront(bare, "grid", 33)
    height = float(trace_fields(bare, "y", 3, until=2).y[0, 0, 2])
    size, pitch = 65, 2.2 * height / 64
    y, x = grid(size, pitch)
    # A polynomial in r² through the path differences over the pupil, as the phase that compensates them.
    squared = bent.pupil.square().sum(-1)
    basis = torch.stack([squared**i for i in range(1, 5)], -1)
    terms = torch.linalg.lstsq(basis, bent.path[0, 0][:, None]).solution[:, 0]
    radial = (x * x + y * y) / height**2
    phase = -2 * math.pi * sum(term * radial**i for i, term in enumerate(terms, start=1))
    held = HologramPhase(phase, pitch)
    mended = optical_system([*glass, surface(thickness=16.0, phase=held)], 1.2, wavelengths=WAVELENGTH)
    assert float(wavefront(bare).rms) > 0.5
    assert float(wavefront(mended).rms) < 0.01
    wave = exit_field(mended, 192)
    image = propagate_beam(wave.field, None, wave.to_image, wave.pitch, wave.wavelength)
    line = (torch.arange(192, dtype=F64) - 96) * wave.pitch
    distance = wave.to_image
    peak = (wave.field.abs() * distance / (line[:, None] ** 2 + line**2 + distance**2)).sum()
    peak = peak * wave.pitch**2 / wave.wavelength
    assert 0.98 < float(image.abs().square().max() / peak**2) < 1.02


def test_gradients_reach_the_samples_of_a_hologram():
    """Slopes by the samples and the pitch, against finite differences; a file holds every sample."""
    generator = torch.Generator().manual_seed(1)
    samples = torch.randn(8, 8, generator=generator, dtype=F64)
    front = surface(phase=HologramPhase(samples, 0.5), thickness=20.0, material=1.5)
    lens = optical_system([front, surface(-30.0, thickness=40.0)], 1.5, wavelengths=WAVELENGTH)
    again = system_from_dict(system_to_dict(lens))
    assert torch.equal(rms_spot(again), rms_spot(lens))
    ray = torch.tensor([[[0.3, -0.2, 0.0], [0, 0, 1]], [[-0.6, 0.7, 0.0], [0, 0, 1.0]]], dtype=F64)
    parameters = [front.vary("phase"), front.vary("pitch")]

    def land(phase, pitch):
        from torch.func import functional_call

        class Both(torch.nn.Module):
            def __init__(self):
                super().__init__()
                self.lens = lens

            def forward(self):
                found = trace(self.lens, ray)
                return torch.cat([found.x.flatten(), found.y.flatten(), found.path.flatten()])

        names = {"lens.surfaces.0.own_phase.phase": phase, "lens.surfaces.0.own_phase.pitch": pitch}
        return functional_call(Both(), names, ())

    assert torch.autograd.gradcheck(land, parameters, fast_mode=True)


def test_unwrapped_holograms_differ_by_multiples_of_two_pi():
    """NumPy and PyTorch alike, and the gradient by the phase is that of the phase itself."""
    y, x = grid(24, 0.1)
    smooth = 5 * x * y + 12 * torch.sin(1.5 * x) - 4 * y * y
    wrapped = torch.angle(torch.exp(1j * smooth)).requires_grad_()
    found = HologramPhase.unwrapped(wrapped, 0.1)
    apart = found.phase - smooth
    assert torch.allclose(apart, apart[0, 0].expand_as(apart), rtol=0, atol=1e-12)
    assert torch.allclose(
        torch.as_tensor(HologramPhase.unwrapped(wrapped.detach().numpy(), 0.1).phase), found.phase, rtol=0, atol=1e-12
    )
    (slope,) = torch.autograd.grad(found.phase.sum(), wrapped)
    assert torch.equal(slope, torch.ones_like(slope))
    place = np.array([0.33, -0.71]), np.array([-0.52, 0.2])
    by_numpy = HologramPhase(wrapped.detach().numpy(), 0.1).cycles(*place)
    by_torch = HologramPhase(wrapped.detach(), 0.1).cycles(*map(torch.as_tensor, place))
    for a, b in zip(by_numpy, by_torch, strict=True):
        assert np.allclose(a, b.numpy(), rtol=0, atol=1e-12)


def test_quadratic_phases_are_exact_between_samples():
    """Keys' cubic convolution reproduces polynomials of second degree, the derivatives too."""
    y, x = grid(32, 0.05)
    coefficients = [3.0, -2.0, 4.0, 1.5, -3.0]
    wrapped = torch.angle(torch.exp(1j * (3 * x - 2 * y + 4 * x * x + 1.5 * x * y - 3 * y * y)))
    place = torch.rand(2, 50, generator=torch.Generator().manual_seed(2), dtype=F64) - 0.5
    found, expected = HologramPhase(wrapped, 0.05).cycles(*place), PolynomialPhase(coefficients).cycles(*place)
    apart = found[0] - expected[0]
    assert float((apart - apart.round()).abs().max()) < 1e-12
    for a, b in zip(found[1:], expected[1:], strict=True):
        assert torch.allclose(a, b, rtol=0, atol=1e-11)


@pytest.mark.parametrize("order", [1.0, -2.0])
def test_a_circular_grating_bends_all_rays_alike(order):
    """An axicon: n·sin θ₂ = m·λ·f along the radius, a cone of rays that meet the axis at r·cot θ."""
    frequency = -200.0
    flat = surface(phase=RadialGrating(frequency, order), thickness=10.0)
    found = trace_fields(optical_system([flat], 2.0, wavelengths=WAVELENGTH), "rings", 3)
    start = trace_fields(optical_system([flat], 2.0, wavelengths=WAVELENGTH), "rings", 3, until=0)
    radius = torch.hypot(start.x, start.y)
    slope = torch.where(radius > 0, (found.u * start.x + found.v * start.y) / torch.where(radius > 0, radius, 1.0), 0.0)
    off = radius > 0
    assert torch.allclose(slope[off], torch.tensor(order * WAVELENGTH * frequency, dtype=F64), rtol=0, atol=1e-13)
    assert float(found.w[0, 0, 0]) == 1.0
    x = torch.tensor([0.3, -0.4], dtype=F64, requires_grad=True)
    y = torch.tensor([0.1, 0.2], dtype=F64, requires_grad=True)
    value, along_x, along_y = RadialGrating(torch.tensor(3.0, dtype=F64), order).cycles(x, y)
    by_x, by_y = torch.autograd.grad(value.sum(), (x, y))
    assert torch.allclose(by_x, along_x) and torch.allclose(by_y, along_y)
