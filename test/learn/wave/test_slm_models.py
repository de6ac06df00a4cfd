"""A modulator's levels, crosstalk, gaps and zero order, against closed forms and brute force."""

import math

import numpy as np
import physics
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn import wave
from odak.learn.wave import spatial_light_modulator, temporal_average
from odak.learn.wave.slm import even_levels, nearest_levels
from odak.wave.fields import within_range

TURN = 2 * math.pi


def sawtooth(periods, samples, dtype=torch.float64):
    """Return a row of a blazed grating, sampled at the middle of its samples so that none is halfway of two levels."""
    return (TURN * (torch.arange(periods * samples, dtype=dtype) + 0.5) / samples)[None]


def random_phase(*shape, seed=0, dtype=torch.float64, span=4 * TURN):
    generator = torch.Generator().manual_seed(seed)
    return span * (torch.rand(shape, generator=generator, dtype=dtype) - 0.5)


def share_of_order(field, order, periods):
    """Return the share of the light in an order of diffraction."""
    return float((torch.fft.fft2(field).abs()[0, order * periods] / field.numel()) ** 2)


@pytest.mark.parametrize("bits", [1, 2, 3, 4, 8])
def test_first_order_of_a_quantised_sawtooth(bits):
    # Goodman, Introduction to Fourier Optics (2005), eq. 8-45.
    periods, samples = 3, 2**13
    field = spatial_light_modulator(bits=bits)(sawtooth(periods, samples))
    assert share_of_order(field, 1, periods) == pytest.approx(np.sinc(1 / 2**bits) ** 2, rel=1e-6)


@pytest.mark.parametrize("s", [1, 2, 3, 5])
@pytest.mark.parametrize("fill", [0.5, 0.83, 0.96])
def test_zero_order_is_the_light_of_the_gaps(s, fill):
    slm = spatial_light_modulator(fill_factor=fill, dead_area_phase=0.7, samples_per_pixel=s)
    field = slm(sawtooth(4, 16).repeat(6, 1))
    assert field.shape == (6 * s, 64 * s)
    # exp(iφ) has no mean over whole periods, so what is left is (1 − F)·exp(i·0.7).
    assert complex(field.mean()) == pytest.approx((1 - fill) * np.exp(0.7j), abs=1e-12)
    dim = spatial_light_modulator(fill_factor=fill, dead_area_amplitude=0.2, zero_order=0.1j, samples_per_pixel=s)
    assert complex(dim(sawtooth(4, 16)).mean()) == pytest.approx(0.2 * (1 - fill) + 0.1j, abs=1e-12)


def test_pixels_are_squares_in_the_middle_of_their_share():
    slm = spatial_light_modulator(bits=None, fill_factor=0.64, dead_area_amplitude=0.0, samples_per_pixel=10)
    cell = slm(torch.zeros(1, 1)).real
    expected = torch.zeros(10, 10)
    expected[1:9, 1:9] = 1
    torch.testing.assert_close(cell, expected, atol=1e-6, rtol=0)
    # A side of 0.9·3 samples: the outer ones are covered to 85 %.
    edge = spatial_light_modulator(bits=None, fill_factor=0.81, dead_area_amplitude=0.0, samples_per_pixel=3)
    assert edge(torch.zeros(1, 1)).real[1].tolist() == pytest.approx([0.85, 1.0, 0.85])


@pytest.mark.parametrize("sigma", [0.05, 0.4, 1.3])
@pytest.mark.parametrize("s", [1, 4])
def test_crosstalk_of_a_step_is_an_error_function(sigma, s):
    slm = spatial_light_modulator(bits=None, crosstalk=sigma, samples_per_pixel=s)
    step = torch.zeros(3, 40, dtype=torch.float64)
    step[:, 20:] = 2.0
    middle = (torch.arange(40 * s, dtype=torch.float64) + 0.5) / s - 20
    # Between the middle of two samples on either side of the edge the phase passes from 0 to 2.
    expected = 1 + torch.erf(middle / (sigma * math.sqrt(2)))
    torch.testing.assert_close(slm.displayed_phase(step)[1], expected, atol=2e-6, rtol=0)
    torch.testing.assert_close(slm.displayed_phase(step.mT)[:, 1], expected, atol=2e-6, rtol=0)


def test_crosstalk_by_a_kernel_is_a_convolution():
    phase, kernel = random_phase(9, 12), torch.tensor([[0.0, 1.0, 4.0], [0.5, 6.0, 0.5], [1.0, 0.0, 0.0]]).double()
    shown = spatial_light_modulator(bits=None, crosstalk=kernel).displayed_phase(phase)
    padded = torch.nn.functional.pad(phase[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]
    expected = sum(
        kernel[i, j] / kernel.sum() * padded[2 - i : 11 - i, 2 - j : 14 - j] for i in range(3) for j in range(3)
    )
    torch.testing.assert_close(shown, expected)
    line = torch.tensor([1.0, 2.0, 5.0])
    one, two = (spatial_light_modulator(bits=None, crosstalk=k) for k in (line, line[:, None] * line))
    torch.testing.assert_close(one(phase), two(phase))


def test_flyback_is_smoothed_where_the_phase_is_wrapped():
    # From 2π − step to 0 the crystal turns back through all phases in between.
    phase = torch.linspace(0, 2 * TURN, 33, dtype=torch.float64)[None].repeat(3, 1)
    wrapped, free = (spatial_light_modulator(bits=b, crosstalk=0.5).displayed_phase(phase)[1] for b in (8, None))
    assert free.diff().min() > 0
    # Over the edge the Gaussian has a share 1 − Φ(½/σ) of the other side: 0 becomes about 0.16·2π.
    assert float(wrapped[16]) == pytest.approx(0.1587 * TURN, abs=0.1)


@given(bits=st.integers(1, 6), seed=st.integers(0, 10**6), turns=st.integers(-3, 3))
@settings(max_examples=40)
def test_levels_round_trip(bits, seed, turns):
    lut = torch.rand(2**bits, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) * TURN
    slm = spatial_light_modulator(bits=bits, lut=lut)
    everywhere = (lut + turns * TURN)[None]
    assert torch.equal(lut[slm.levels(everywhere).long()], lut[None])
    even = spatial_light_modulator(bits=bits)
    asked = torch.arange(2**bits, dtype=torch.float64)[None] * TURN / 2**bits
    assert torch.equal(even.levels(asked + turns * TURN), torch.arange(2**bits, dtype=torch.int32)[None])


@given(bits=st.integers(1, 5), seed=st.integers(0, 10**6), span=st.floats(0.3, TURN))
@settings(max_examples=40)
def test_level_shown_is_the_nearest_around_the_circle(bits, seed, span):
    lut = span * torch.rand(2**bits, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 1.0
    phase = random_phase(1, 200, seed=seed)
    shown = spatial_light_modulator(bits=bits, lut=lut).displayed_phase(phase)

    def apart(a, b):
        return (torch.remainder(a - b + math.pi, TURN) - math.pi).abs()

    nearest = apart(phase[..., None], lut).min(-1).values
    torch.testing.assert_close(apart(phase, shown), nearest, atol=1e-9, rtol=0)


def test_even_levels_are_those_of_the_search():
    phase = random_phase(1, 1000)
    for bits in (1, 3, 8):
        lut = torch.arange(2**bits, dtype=torch.float64) * TURN / 2**bits
        assert torch.equal(even_levels(phase, 2**bits).long(), nearest_levels(phase, lut))


def test_range_of_more_than_a_turn_is_used():
    slm = spatial_light_modulator(bits=10, phase_range=2.5 * TURN)
    inside = torch.linspace(0, 2.49 * TURN, 500, dtype=torch.float64)[None]
    assert (slm.displayed_phase(inside) - inside).abs().max() <= 2.5 * TURN / 2**11 + 1e-9
    outside = torch.tensor([[-0.1, 2.7 * TURN, 7.0 * TURN]], dtype=torch.float64)
    shown = slm.displayed_phase(outside)
    assert (shown >= 0).all() and (shown <= 2.5 * TURN).all()
    torch.testing.assert_close(torch.cos(shown), torch.cos(outside), atol=1e-2, rtol=0)


def test_range_of_less_than_a_turn_takes_the_nearer_end():
    phase = torch.tensor([0.0, 4.9, 5.0, 5.6, 5.7, -0.1], dtype=torch.float64)
    assert within_range(phase, 5.0).tolist() == pytest.approx([0.0, 4.9, 5.0, 5.0, 0.0, 0.0])
    slm = spatial_light_modulator(bits=None, phase_range=5.0)
    assert slm.displayed_phase(phase[None])[0].tolist() == within_range(phase, 5.0).tolist()
    assert within_range(torch.tensor([13.0, 14.9]), 4.5 * math.pi).tolist() == pytest.approx([13.0, 14.9 - TURN])


@pytest.mark.parametrize("options", [{"bits": 3}, {"bits": 2, "lut": torch.tensor([0.1, 1.0, 4.0, 5.0]).double()}])
def test_gradient_goes_straight_through_the_levels(options):
    weight = random_phase(6, 7, seed=3) + 1j * random_phase(6, 7, seed=4)
    phase = random_phase(6, 7).requires_grad_()
    field = spatial_light_modulator(**options)(phase)
    (field * weight).sum().abs().backward()
    quantised = field.detach().angle().requires_grad_()
    (wave.unit_phasor(quantised) * weight).sum().abs().backward()
    torch.testing.assert_close(phase.grad, quantised.grad)
    assert field.angle().round(decimals=9).unique().numel() == 2 ** options["bits"]


def test_gradients_of_everything_but_the_levels():
    phase, aberration, amplitude = (random_phase(3, 4, seed=i, span=2.0) for i in range(3))
    kernel, fill, dead, zero = (
        torch.tensor(value, dtype=torch.float64) for value in ([0.2, 1.0, 0.3], 0.8, [0.4], [0.1])
    )

    def light(phase, kernel, fill, dead, zero, aberration, amplitude, scale):
        slm = spatial_light_modulator(
            bits=None,
            crosstalk=kernel,
            fill_factor=fill,
            dead_area_phase=dead,
            zero_order=zero,
            aberration=aberration,
            amplitude=amplitude,
            samples_per_pixel=2,
        )
        return slm(phase, scale)

    inputs = (phase, kernel, fill, dead, zero, aberration, amplitude, torch.ones(1, 1, 1, dtype=torch.float64))
    assert torch.autograd.gradcheck(light, tuple(value.detach().requires_grad_() for value in inputs), fast_mode=True)


def test_colours_scale_the_phase_that_is_shown():
    phase, scale = random_phase(2, 1, 1, 5, 6), torch.tensor([1.0, 0.8, 1.2]).double()[:, None, None]
    aberration = random_phase(5, 6, seed=2)
    slm = spatial_light_modulator(bits=4, aberration=aberration)
    field = slm(phase, scale)
    assert field.shape == (2, 1, 3, 5, 6)
    shown = slm.displayed_phase(phase)
    torch.testing.assert_close(field, torch.exp(1j * scale * (shown + aberration)))
    torch.testing.assert_close(slm(phase, 0.8)[:, :, 0], field[:, :, 1])


def test_aberration_and_amplitude_on_pixels_or_samples():
    phase, tilt = random_phase(4, 5), random_phase(4, 5, seed=2)
    coarse = spatial_light_modulator(aberration=tilt, amplitude=tilt.abs(), samples_per_pixel=2)
    fine_map = tilt.repeat_interleave(2, 0).repeat_interleave(2, 1)
    fine = spatial_light_modulator(aberration=fine_map, amplitude=fine_map.abs(), samples_per_pixel=2)
    torch.testing.assert_close(coarse(phase), fine(phase))
    plain = spatial_light_modulator()(phase)
    lit = spatial_light_modulator(amplitude=torch.polar(tilt.abs(), tilt))(phase)
    torch.testing.assert_close(lit, plain * torch.polar(tilt.abs(), tilt))


def test_precision_follows_the_phase_and_parameters_are_learnt():
    learnt = torch.nn.Parameter(torch.tensor(0.9))
    slm = spatial_light_modulator(fill_factor=learnt, aberration=torch.zeros(4, 4, dtype=torch.float64))
    assert slm(random_phase(4, 4)).dtype == torch.complex128
    field = slm(random_phase(4, 4, dtype=torch.float32))
    assert field.dtype == torch.complex64
    field.abs().sum().backward()
    assert learnt.grad.isfinite() and learnt.grad != 0
    assert set(slm.state_dict()) == {"fill_factor", "aberration"}
    assert [name for name, _ in slm.named_parameters()] == ["fill_factor"]


def test_frames_are_averaged():
    frames = random_phase(2, 5, 3, 4)
    torch.testing.assert_close(temporal_average(frames), sum(frames[:, i] for i in range(5)) / 5)
    assert temporal_average(frames, dim=0).shape == (5, 3, 4)


@pytest.mark.parametrize("s", [1, 2])
def test_a_display_shows_what_its_modulator_sends(s):
    # With one sample per pixel the display adds the spectrum of finite pixels.
    slm = spatial_light_modulator(bits=3, crosstalk=0.3, fill_factor=0.9 if s > 1 else 1.0, samples_per_pixel=s)
    show = wave.propagator(
        [16, 24], [639e-9, 515e-9], 8e-6, 1, 2, distances=[2e-3], propagator_type="forward", slm=slm, aperture="open"
    )
    show.phase_scale = torch.tensor([0.8, 1.0])
    phases = random_phase(2, 16, 24, dtype=torch.float32)
    shown = show.reconstruct(phases)
    assert shown.shape == (2, 1, 2, 16 * s, 24 * s)
    for colour, scale in enumerate((0.8, 1.0)):
        field = slm(phases[colour], scale)
        expected = physics.unwrapped_propagation(field.numpy(), 2e-3, 8e-6 / s, show.wavelengths[colour], padding=16)
        assert physics.relative_error(shown[colour, 0, colour], abs(expected) ** 2) < 1e-3


def test_hologram_optimised_through_model_is_better_on_modulator():
    generator = torch.Generator().manual_seed(1)
    target = torch.rand(6, 8, generator=generator).repeat_interleave(8, 0).repeat_interleave(8, 1)
    slm = spatial_light_modulator(bits=8, fill_factor=0.8, dead_area_phase=1.0)
    settings = {
        "n_iteration": 60,
        "initial_phase": torch.full_like(target, math.pi),
        "scale": True,
        "progress": False,
    }
    iris = {"iris_radius": 3e-3, "iris_focal_length": 0.1}
    blind, _ = wave.stochastic_gradient_descent(target, 532e-9, 5e-3, 8e-6, **iris, **settings)
    aware, image = wave.stochastic_gradient_descent(target, 532e-9, 5e-3, 8e-6, slm=slm, **iris, **settings)
    show = wave.propagator(target.shape, [532e-9], 8e-6, distances=[5e-3], propagator_type="forward", slm=slm, **iris)
    on_modulator = show.reconstruct(blind.angle(), get_complex=True)[0, 0, 0]

    def error(field):
        light = wave.intensity(field)
        return float((light * (light * target).sum() / light.square().sum() - target).square().mean())

    # The hologram returned is the field that the modulator makes: a circle around the light of the gaps.
    torch.testing.assert_close((aware - 0.2 * np.exp(1j)).abs(), torch.full_like(target, 0.8))
    # Measured: 0.04 of it.
    assert error(image) < 0.1 * error(on_modulator)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"bits": 0}, ValueError, "bits must be 1 to 16 or None, got 0"),
        ({"bits": 17}, ValueError, "bits must be 1 to 16 or None, got 17"),
        ({"phase_range": 0.0}, ValueError, "phase_range must be positive"),
        ({"lut": torch.zeros(3)}, ValueError, "lut must be a tensor of 256 phases"),
        ({"lut": torch.zeros(256), "phase_range": 6.0}, ValueError, "lut needs bits"),
        ({"lut": torch.zeros(256), "bits": None}, ValueError, "lut needs bits"),
        ({"crosstalk": -1.0}, ValueError, "crosstalk must be at least 0"),
        ({"crosstalk": torch.ones(4)}, ValueError, "odd length"),
        ({"fill_factor": 1.1}, ValueError, "fill_factor must be between 0 and 1"),
        ({"samples_per_pixel": 0}, ValueError, "samples_per_pixel must be at least 1"),
        ({"aberration": np.zeros((4, 4))}, TypeError, "aberration must be a torch.Tensor"),
        ({"amplitude": torch.ones(4)}, ValueError, "amplitude must have at least 2 axes"),
    ],
)
def test_bad_arguments_are_named(options, error, message):
    with pytest.raises(error, match=message):
        spatial_light_modulator(**options)


def test_bad_phases_are_named():
    slm = spatial_light_modulator(aberration=torch.zeros(3, 4))
    with pytest.raises(TypeError, match="phase must be a float32 or float64 tensor"):
        slm(torch.zeros(4, 4, dtype=torch.int32))
    with pytest.raises(ValueError, match=r"aberration must have the modulator's pixels or samples \(4, 4\)"):
        slm(torch.zeros(4, 4))
    with pytest.raises(ValueError, match="bits must be given"):
        spatial_light_modulator(bits=None).levels(torch.zeros(4, 4))


@pytest.mark.parametrize("samples", [1, 3])
@pytest.mark.parametrize("fill", [0.0, 0.4, 1.0])
def test_slopes_of_the_fill_factor_at_its_ends(samples, fill):
    phase = torch.rand(4, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1))

    def loss(share):
        start = torch.nn.Parameter(torch.full_like(share, 0.5))
        model = spatial_light_modulator(bits=None, fill_factor=start, samples_per_pixel=samples)
        # As an optimizer moves it.
        start.data.copy_(share)
        return model, (model(phase) - 1j).abs().square().mean()

    share = torch.tensor(fill, dtype=torch.float64)
    model, value = loss(share)
    value.backward()
    found = model.fill_factor.grad
    assert found.isfinite()
    if samples == 1 or fill == 0.4:
        step = 1e-6 if fill < 1 else -1e-6
        assert found.item() == pytest.approx((loss(share + step)[1] - value).item() / step, rel=1e-4)
    assert loss(torch.tensor(-0.01))[1].isfinite() and loss(torch.tensor(1.01))[1].isfinite()
