"""Panels of amplitudes: diffraction orders in closed form, levels, gradients, and images beside those of a profile."""

import math

import pytest
import torch

from odak import ConvergenceWarning
from odak.learn.wave import AmplitudeResponse, Display, Modulator, Run, optimise

PITCH, WAVELENGTH, DISTANCE = 8e-6, 532e-9, 2e-3


def orders(light):
    """Return the intensities of the orders 0, 1, 2 … of a grating along columns, of what arrives."""
    return (torch.fft.fft(light, dim=-1).abs() / light.shape[-1])[0].square()


@pytest.mark.parametrize("bits, expected", [(None, [1 / 4, 1 / 16, 0.0, 0.0]), (1, [1 / 4, 1 / math.pi**2, 0.0])])
def test_gratings_of_amplitude_have_the_orders_of_theory(bits, expected):
    phases = torch.arange(4096, dtype=torch.float64).add(0.5).mul(2 * math.pi / 4096)[None]
    panel = Modulator.amplitude_only((1, 4096), PITCH, bits)
    shown = orders(panel.light(panel.shown(phases)))[: len(expected)]
    torch.testing.assert_close(shown, torch.tensor(expected, dtype=torch.float64), rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize("bits", [1, 2, 8])
@pytest.mark.parametrize("contrast", [None, 100.0])
def test_levels_are_even_amplitudes_and_the_nearest(bits, contrast):
    panel, count = Modulator.amplitude_only((1, 400), PITCH, bits, contrast=contrast), 2**bits
    levels = torch.arange(count, dtype=torch.int32)[None]
    light = panel.light(panel.phases_of(levels, torch.float64))
    dark = 0.0 if contrast is None else 0.1
    even = dark + (1 - dark) * torch.linspace(0, 1, count, dtype=torch.float64)
    torch.testing.assert_close(light.real[0], even, rtol=0, atol=1e-12)
    assert not light.imag.any()
    assert torch.equal(panel.levels(panel.phases_of(levels)), levels)
    # Phases on both sides of a turn: no other level is nearer.
    phases = torch.linspace(-4, 10, 400, dtype=torch.float64)[None]
    asked, got = panel.light(phases).real, panel.light(panel.shown(phases)).real
    assert (asked - got).abs().max() <= (1 - dark) / (count - 1) / 2 + 1e-9


def test_gradients_are_those_of_differences():
    phases = torch.linspace(0.1, 6.2, 12, dtype=torch.float64).reshape(3, 4).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: AmplitudeResponse(None, 50.0)(p).real, phases)


def test_images_are_those_of_a_profile_of_amplitudes():
    amplitudes = torch.rand(24, 32, generator=torch.Generator().manual_seed(3)).round()
    mirrors = Modulator.amplitude_only((24, 32), PITCH)
    display = Display(mirrors, WAVELENGTH, DISTANCE)
    masked = Display(Modulator((24, 32), PITCH), WAVELENGTH, DISTANCE, profile=amplitudes)
    expected = masked(torch.zeros(24, 32))
    got = display(mirrors.phases_of(amplitudes.int()))
    torch.testing.assert_close(got, expected, rtol=1e-4, atol=1e-5 * float(expected.max()))
    # The judge, which shares nothing with the display, says how far its image is from the display's.
    judged = display.judge(mirrors.phases_of(amplitudes.int()))
    assert float(judged.error) < 2e-3


def test_binary_mirrors_are_searched_for_and_gain_over_rounding():
    waves = torch.linspace(0, 7, 24)
    target = (1 + torch.sin(waves)[:, None] * torch.cos(1.3 * waves + waves[:, None])) / 2
    display = Display(Modulator.amplitude_only((24, 24), PITCH, contrast=1000.0), WAVELENGTH, DISTANCE)
    found = optimise(display, target, run=Run(iterations=60, progress=False))
    assert found.levels().unique().tolist() == [0, 1]
    assert float(found.gain_over_rounding) > 0.3 and float(found.psnr) > 15
    light = display.modulator.light(found.phases)
    assert light.real.unique().numel() == 2 and not light.imag.any()


@pytest.mark.parametrize("given", [{"contrast": 0.5}, {"contrast": float("nan")}, {"bits": 0}])
def test_what_no_panel_has_is_refused(given):
    with pytest.raises(ValueError, match=next(iter(given))):
        AmplitudeResponse(**given)


def test_a_start_that_no_descent_leaves_is_named():
    display = Display(Modulator.amplitude_only((16, 16), PITCH, bits=8), WAVELENGTH, DISTANCE)
    target = torch.zeros(16, 16)
    target[4:9, 4:12] = 1.0
    with pytest.warns(ConvergenceWarning, match="its gradient is zero, and the loss stays"):
        optimise(display, target, start="flat", run=Run(iterations=2, progress=False))


@pytest.mark.parametrize("panel", [Modulator((1, 1), 8e-6, 3), Modulator.amplitude_only((1, 1), 8e-6, 3)])
def test_levels_that_a_panel_does_not_have_are_named(panel):
    for level in (8, -1):
        with pytest.raises(ValueError, match=f"levels must be 0 … 7, got {level}"):
            panel.phases_of(torch.tensor([[level]]))
    with pytest.raises(TypeError, match="levels must be a tensor of integers"):
        panel.phases_of(torch.tensor([[1.5]]))


def test_a_fill_in_per_cent_is_called_fill():
    with pytest.raises(ValueError, match=r"^fill must be"):
        Modulator((1, 1), 8e-6, fill=90)
