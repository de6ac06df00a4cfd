"""The simulated camera: its statistics, its faults, and what a loop through it gains over the model alone."""

import math
from importlib.resources import files

import numpy as np
import physics
import pytest
import torch

from odak.learn import wave
from odak.learn.tools import load_image
from odak.learn.wave import simulated_camera, spatial_light_modulator, zernike_phase

WAVELENGTH, DISTANCE, PITCH = 532e-9, 0.01, 8e-6


def camera(**options):
    settings = {"wavelength": WAVELENGTH, "distance": DISTANCE, "pixel_pitch": PITCH, "seed": 0}
    return simulated_camera(**(settings | options))


@pytest.fixture
def phase():
    return 2 * math.pi * torch.rand(24, 32, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def intensity(field, pitch=PITCH):
    # The error of this sum falls with the square of the padding.
    coarse, fine = (
        physics.unwrapped_propagation(field.numpy(), DISTANCE, pitch, WAVELENGTH, padding=padding)
        for padding in (16, 32)
    )
    spread = (4 * fine - coarse) / 3
    return torch.from_numpy(abs(spread) ** 2)


def close(found, expected):
    # The tolerance of a propagation is 1e-4 of the norm.
    assert float((found - expected).norm() / expected.norm()) < 2e-4


def test_without_faults_it_is_the_model(phase):
    ideal = camera(full_well=None, exposure=0.01)
    expected = intensity(wave.unit_phasor(phase))
    close(ideal(phase), expected)
    close(ideal.light(phase), expected)
    assert ideal(phase.float()).dtype == torch.float32
    batch = torch.stack([phase, phase.flip(0)])[:, None]
    torch.testing.assert_close(ideal(batch)[1, 0], ideal(phase.flip(0)))


def test_faults_are_those_of_the_display(phase):
    aberration = zernike_phase(24, 32, {(2, 0): 0.5, (3, 1): -0.4})
    illumination = torch.linspace(0.5, 1.0, 32, dtype=torch.float64).expand(24, 32)
    slm = spatial_light_modulator(bits=3, fill_factor=0.9)
    faulty = camera(full_well=None, exposure=0.01, slm=slm, aberration=aberration, illumination=illumination)
    field = slm(phase) * illumination * torch.exp(1j * aberration)
    expected = intensity(field)
    close(faulty(phase), expected)
    # The same faults in the modulator itself.
    inside = spatial_light_modulator(bits=3, fill_factor=0.9, aberration=aberration, amplitude=illumination)
    close(camera(full_well=None, exposure=0.01, slm=inside)(phase), expected)


@pytest.mark.slow
def test_a_sensor_pixel_collects_the_samples_of_a_pixel(phase):
    slm = spatial_light_modulator(fill_factor=0.8, samples_per_pixel=3)
    tilt = zernike_phase(24, 32, {(1, 1): 0.3})
    captured = camera(full_well=None, exposure=0.01, slm=slm, aberration=tilt)(phase)
    fine = slm(phase) * torch.exp(1j * tilt).repeat_interleave(3, 0).repeat_interleave(3, 1)
    light = intensity(fine, PITCH / 3)
    assert captured.shape == phase.shape
    assert float(captured[5, 7]) == pytest.approx(float(light[15:18, 21:24].mean()), rel=3e-4)


@pytest.mark.parametrize("read_noise", [0.0, 12.0])
def test_mean_and_variance_are_those_of_counted_electrons(read_noise):
    light = torch.tensor([0.2, 1.0, 2.0], dtype=torch.float64)[:, None].expand(3, 100_000)
    sensor = camera(exposure=0.25, full_well=400.0, read_noise=read_noise)
    captured = sensor.captured(light)
    gain = 0.25 * 400
    variance = light[:, 0] / gain + (read_noise / gain) ** 2
    # Five standard errors; that of a variance is √(2/n) of it for normal noise, and a little more for Poisson's.
    assert ((captured.mean(1) - light[:, 0]).abs() < 5 * (variance / 1e5).sqrt() + 1e-3 * (read_noise > 0)).all()
    tolerance = 5 * math.sqrt(2.1 / 1e5)
    dim = 1 if read_noise else 0  # the dimmest is cut at zero by the read noise
    np.testing.assert_allclose(captured.var(1)[dim:], variance[dim:], rtol=tolerance)
    if not read_noise:
        counts = captured * gain
        torch.testing.assert_close(counts, counts.round())


def test_it_saturates_and_has_levels():
    light = torch.tensor([0.0, 1.0, 3.9, 4.1, 1e6], dtype=torch.float64)
    sensor = camera(full_well=None, bits=4, exposure=0.25)
    captured = sensor.captured(light)
    assert captured[3:].tolist() == [4.0, 4.0]
    torch.testing.assert_close(captured * 15 / 4, (captured * 15 / 4).round())
    assert (captured[:3] - light[:3]).abs().max() <= 0.5 * 4 / 15 + 1e-9
    noisy = camera(full_well=50.0, read_noise=40.0, exposure=0.25).captured(light.expand(1000, 5))
    assert noisy.min() == 0 and noisy.max() == 4


def test_seed_reproduces_and_leaves_the_callers_generator_alone(phase):
    before = torch.get_rng_state()
    one, two = camera(), camera()
    first = one(phase)
    assert torch.equal(first, two(phase))
    assert not torch.equal(first, one(phase))
    assert not torch.equal(first, camera(seed=1)(phase))
    assert torch.equal(before, torch.get_rng_state())
    assert not torch.equal(camera(seed=None)(phase), camera(seed=None)(phase))


def test_a_capture_has_no_graph_and_the_light_has_one():
    phase = torch.rand(4, 5, dtype=torch.float64, requires_grad=True)
    assert not camera()(phase).requires_grad
    faulty = camera(aberration=zernike_phase(4, 5, {(2, 2): 0.4}))
    assert torch.autograd.gradcheck(faulty.light, (phase,), fast_mode=True)


def test_display_errors_are_part_of_the_state():
    faulty = camera(aberration=torch.ones(4, 5), illumination=torch.ones(4, 5), slm=spatial_light_modulator(bits=2))
    assert {"aberration", "illumination"} <= set(faulty.state_dict())
    assert faulty.double().aberration.dtype == torch.float64


@pytest.mark.slow
def test_camera_in_the_loop_beats_the_model_alone():
    n = 128
    photo = load_image(str(files("odak") / "assets" / "photo.png")).mean(-1)
    target = torch.nn.functional.interpolate(photo[None, None], size=(n, n), mode="area")[0, 0]
    y = (torch.arange(n) - n // 2) / (n / 2)
    display = camera(
        distance=DISTANCE + 5e-5,
        slm=spatial_light_modulator(bits=8, crosstalk=0.2, fill_factor=0.93, dead_area_phase=0.5),
        aberration=zernike_phase(n, n, {(2, 0): 0.2, (2, 2): 0.2, (3, 1): 0.2}),
        illumination=torch.exp(-(y[:, None] ** 2 + y**2) / 2),
        read_noise=5.0,
        bits=12,
    )
    settings = {"n_iteration": 100, "initial_phase": torch.full((n, n), math.pi), "scale": True, "progress": False}
    geometry = (target, WAVELENGTH, DISTANCE, PITCH)
    blind, _ = wave.stochastic_gradient_descent(*geometry, **settings)
    looped, _ = wave.stochastic_gradient_descent(*geometry, camera=display, **settings)

    def decibels(hologram):
        shown = display(hologram.angle())
        shown = shown * (shown * target).sum() / shown.square().sum()
        return float(-10 * torch.log10((shown - target).square().mean()))

    # Measured: 14.3 dB without, 19.3 dB with.
    assert decibels(looped) > decibels(blind) + 3


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"read_noise": -1.0}, ValueError, "read_noise must be at least 0"),
        ({"read_noise": 1.0, "full_well": None}, ValueError, "read_noise must be at least 0, and 0 without full_well"),
        ({"bits": 20}, ValueError, "bits must be 1 to 16 or None, got 20"),
        ({"aberration": 0.3}, TypeError, "aberration must be a torch.Tensor"),
    ],
)
def test_bad_arguments_are_named(options, error, message):
    with pytest.raises(error, match=message):
        camera(**options)


def test_bad_phases_are_named():
    with pytest.raises(TypeError, match="phase must be a float32 or float64 tensor"):
        camera()(torch.zeros(4, 4, dtype=torch.complex64))
    with pytest.raises(ValueError, match="illumination must have the modulator's pixels"):
        camera(illumination=torch.ones(3, 4))(torch.zeros(4, 4))


def test_descent_through_a_camera_makes_up_for_what_the_display_does_not_know():
    """An aberration that the display lacks; what the camera would see without noise is compared."""
    target = torch.zeros(48, 64)
    target[12:36, 16:48] = 1
    y, x = (torch.arange(48) - 24) / 24, (torch.arange(64) - 32) / 32
    aside = simulated_camera(WAVELENGTH, 3e-3, PITCH, aberration=1.5 * (y[:, None] ** 2 + x**2), exposure=0.25, seed=0)
    display = wave.Display(wave.Modulator((48, 64), PITCH), WAVELENGTH, 3e-3)
    seen = []
    for given in (None, aside):
        solver = wave.Descent("adam", camera=given)
        found = wave.optimise(display, target, solver=solver, run=wave.Run(60, progress=False))
        light = aside.light(found.phases[0])
        light = light * (light * target).sum() / light.square().sum()
        seen.append(-10 * float((light - target).square().mean().log10()))
    assert seen[1] > seen[0] + 4
    with pytest.raises(ValueError, match="method must be 'adam' with a camera"):
        wave.Descent(camera=aside)
    frames = wave.Display(wave.Modulator((48, 64), PITCH), WAVELENGTH, 3e-3, frames=2)
    with pytest.raises(ValueError, match="camera must be None but for one frame, plane and colour"):
        wave.optimise(frames, target, solver=solver, run=wave.Run(1, progress=False))
