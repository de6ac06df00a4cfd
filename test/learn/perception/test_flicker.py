"""stelaCSF against its formula in plain numbers, flicker by gratings at threshold, and sums on a moving retina."""

import itertools
import math

import pytest
import torch

from odak.learn.perception import (
    FlickerLoss,
    MetamericLoss,
    Viewing,
    retinal_image,
    sequence_loss,
    stela_contrast_sensitivity,
)
from odak.learn.perception.foveation import RadiallyVaryingBlur


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def published(f, w, light, ecc, area):
    """The sensitivity by equations and parameters of the publication, in plain numbers and decimal powers."""
    peak = 68.9501 * (1 + 59.5023 / light) ** -0.164274 * (1 - (1 + 7.54866e-07 / light) ** -7.77268e09)
    place = 1.62144 * (1 + 36.6565 / light) ** -0.255823
    parabola = 10 ** (-((math.log10(f) - math.log10(place)) ** 2) / 2**0.000219263)
    slow = peak * (1 - 0.103686 if f < place and parabola < 1 - 0.103686 else parabola)
    parabola = 10 ** (-((math.log10(f) - math.log10(0.0267489)) ** 2) / 2**1.75147)
    fast = 57.3469 * light**0.500846 * parabola
    total = math.exp(-(w**1.3314) / 5.79336) * slow + math.exp(-(abs(w**0.1898 - 5**0.1898) ** 2) / 0.12314) * fast
    summed = 270 / (1 + (f / 0.65) ** 2)
    return total * math.sqrt(summed / (1 + summed / area)) * f * 10 ** (-(0.0296662 + f * 0.0190062) * ecc)


@pytest.mark.parametrize("light", [0.01, 1.0, 100.0, 5000.0])
def test_stela_csf_is_that_of_its_publication(light):
    for f, w, ecc, area in ((0.1, 0.0, 0, 7.07), (0.5, 3.0, 5, 1), (4, 0, 0, 7.07), (4, 8, 10, 0.2), (30, 20, 0, 100)):
        found = stela_contrast_sensitivity(float(f), float(w), light, float(ecc), float(area)).item()
        # A base near 1 loses digits in plain numbers, not here.
        assert found == pytest.approx(published(f, w, light, ecc, area), rel=3e-5)


def test_flicker_fuses_at_the_frequencies_that_are_known():
    """The frequency at which full contrast of a coarse field vanishes rises by some 10 Hz for ten times the light."""
    frequencies = torch.linspace(10, 120, 2201, dtype=torch.float64)
    fusion = [
        float(frequencies[stela_contrast_sensitivity(0.25, frequencies, light, area=30.0) > 1].max())
        for light in (1.0, 10.0, 100.0)
    ]
    assert 20 < fusion[0] < 60 and 50 < fusion[2] < 110
    steps = [b - a for a, b in itertools.pairwise(fusion)]
    assert all(5 < step < 25 for step in steps) and steps[0] == pytest.approx(steps[1], rel=0.3)


def test_gradients_of_the_sensitivity():
    arguments = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (3.0, 6.0, 50.0, 4.0, 2.0)]
    assert torch.autograd.gradcheck(stela_contrast_sensitivity, arguments, fast_mode=True)
    rest = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    stela_contrast_sensitivity(3.0, rest).sum().backward()
    assert rest.grad.isfinite().all()


VIEW = Viewing(0.2, 0.7, peak_luminance=100.0, black_luminance=0.001)


def drifting(count, amplitude, cycles, across):
    time, place = torch.arange(count, dtype=torch.float64), torch.arange(32, dtype=torch.float64)
    phase = 2 * math.pi * (cycles * time[:, None] / count + across * place / 32)
    return (0.5 * (1 + amplitude * torch.cos(phase)))[None, :, None, None].expand(1, count, 1, 32, 32)


@pytest.mark.parametrize(("cycles", "across"), [(1, 0), (3, 0), (2, 4), (1, 16)])
def test_a_grating_at_its_threshold_costs_one(cycles, across):
    rate, count = 80.0, 16
    loss = FlickerLoss(rate, encoding="linear", viewing=VIEW)
    density = 32 * 0.7 / 0.2 * math.pi / 180
    frequency, flicker = max(across * density / 32, 1 / 16, density / 32), cycles * rate / count
    mean = float(VIEW.luminance(torch.tensor(0.5, dtype=torch.float64)))
    gain = stela_contrast_sensitivity(frequency, flicker, mean, area=VIEW.area).item()
    # Lit for the whole time, a frame passes sinc of the share; copies of the spectrum at the rate flicker too.
    passed = math.sin(math.pi * cycles / count) / (math.pi * cycles / count)
    contrast = (100 - 0.001) * 0.5 / mean
    amplitude = 1 / (gain * passed * contrast)
    expected = 1.0
    for k in (count - cycles, count + cycles):
        copy = k * rate / count
        if copy <= 100:
            share = math.sin(math.pi * k / count) / (math.pi * k / count)
            other = stela_contrast_sensitivity(frequency, copy, mean, area=VIEW.area).item()
            expected += (amplitude * contrast * share * other) ** 2
    assert float(loss(drifting(count, amplitude, cycles, across))) == pytest.approx(expected, rel=1e-9)


def test_still_frames_cost_nothing_unless_they_are_dark_between():
    frames = noise(1, 1, 3, 16, 16).expand(1, 4, 3, 16, 16)
    assert float(FlickerLoss(60.0)(frames)) < 1e-20
    assert float(FlickerLoss(60.0, persistence=0.2)(frames)) > 1
    assert float(FlickerLoss(60.0, persistence=0.2)(frames)) > 10 * float(FlickerLoss(90.0, persistence=0.2)(frames))
    moving = noise(1, 3, 1, 4, 4).requires_grad_()
    # At a fixed adaptation: the mean luminance has no gradient, and these changes keep it.
    direction = noise(1, 3, 1, 4, 4, seed=2)
    direction = direction - direction.mean()
    loss = FlickerLoss(60.0, encoding="linear")
    (slope,) = torch.autograd.grad(loss(moving), moving)
    with torch.no_grad():
        change = (loss(moving + 1e-5 * direction) - loss(moving - 1e-5 * direction)) / 2e-5
    assert float((slope * direction).sum()) == pytest.approx(float(change), rel=1e-6)


def test_colours_break_up_by_the_movement_between_frames():
    """A white bar in three fields, eye moving two pixels a field: three bars two pixels apart."""
    frames = torch.zeros(3, 3, 4, 32, dtype=torch.float64)
    for field in range(3):
        frames[field, field, :, 20:24] = 3.0
    gaze = torch.tensor([[0.5 + 2 * k / 32, 0.5] for k in range(3)], dtype=torch.float64)
    found = retinal_image(frames, gaze)
    for field in range(3):
        expected = torch.zeros(32, dtype=torch.float64)
        expected[20 - 2 * field : 24 - 2 * field] = 1.0
        torch.testing.assert_close(found[0, field, 1], expected, rtol=0, atol=1e-9)
    still = retinal_image(frames, gaze[:1].expand(3, 2))
    torch.testing.assert_close(still[0], frames.mean(0))
    inputs = noise(2, 1, 4, 4).requires_grad_(), torch.tensor([[0.5, 0.5], [0.61, 0.43]]).double().requires_grad_()
    assert torch.autograd.gradcheck(retinal_image, inputs, fast_mode=True)


def test_a_sequence_makes_its_maps_once_for_each_gaze(monkeypatch):
    made = []
    before = RadiallyVaryingBlur.sampler

    def counted(self, *arguments, **options):
        made.append(1)
        return before(self, *arguments, **options)

    monkeypatch.setattr(RadiallyVaryingBlur, "sampler", counted)
    frames, targets = noise(6, 1, 64, 64).requires_grad_(), noise(6, 1, 64, 64, seed=3)
    gaze = [[0.2, 0.5], [0.8, 0.5], [0.2, 0.5], [0.8, 0.5], [0.2, 0.5], [0.2, 0.5]]
    loss = MetamericLoss(n_pyramid_levels=2)
    loss(targets[:1], targets[:1], gaze[0])
    once = len(made)
    made.clear()
    found = sequence_loss(MetamericLoss(n_pyramid_levels=2), frames, targets, gaze)
    assert len(made) == 2 * once
    each = [
        MetamericLoss(n_pyramid_levels=2)(f[None], t[None], g) for f, t, g in zip(frames, targets, gaze, strict=True)
    ]
    torch.testing.assert_close(found, torch.stack(each).mean())
    (slope,) = torch.autograd.grad(found, frames)
    number = sequence_loss(loss, frames, targets, gaze, backward=True)
    assert not number.requires_grad
    torch.testing.assert_close(frames.grad, slope)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: stela_contrast_sensitivity(0.0), "frequency"),
        (lambda: stela_contrast_sensitivity(1.0, -1.0), "temporal_frequency"),
        (lambda: FlickerLoss(0.0), "frames_per_second"),
        (lambda: FlickerLoss(60.0, persistence=1.5), "persistence"),
        (lambda: FlickerLoss(60.0)(torch.rand(1, 3, 8, 8)), r"frames must be \[B, F, C, H, W\]"),
        (lambda: retinal_image(torch.rand(2, 3, 8, 8), [[0.5, 0.5]]), r"gaze must be \[2, 2\]"),
        (lambda: sequence_loss(MetamericLoss(), *[torch.rand(2, 1, 8, 8)] * 2, [[0.5, 0.5]]), "gaze must have a row"),
    ],
)
def test_refused(call, named):
    with pytest.raises((ValueError, TypeError), match=named):
        call()


def test_whole_numbers_have_the_sensitivity_of_floats_and_other_shapes_are_named():
    whole = stela_contrast_sensitivity(torch.tensor([1, 2, 4]), torch.tensor(8), torch.tensor(50), area=torch.tensor(3))
    assert torch.equal(whole, stela_contrast_sensitivity(torch.tensor([1.0, 2.0, 4.0]), 8.0, 50.0, area=3.0))
    with pytest.raises(ValueError, match=r"temporal_frequency \[4\]"):
        stela_contrast_sensitivity(torch.ones(3), torch.ones(4))
