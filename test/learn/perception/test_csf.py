"""Barten's contrast sensitivity against an independent implementation, and the loss against gratings."""

import math

import pytest
import torch

from odak.learn import perception as p


def test_against_colour_science():
    # colour-science 0.4.7, contrast_sensitivity_function_Barten1999 with its pupil and retinal illuminance.
    for luminance, size, frequency, expected in (
        (100, 60, 0.5, 334.78453885875086),
        (100, 60, 4, 656.9952239435877),
        (100, 60, 30, 30.308026930701214),
        (1, 10, 0.5, 206.06414763016508),
        (1, 10, 4, 199.59157866495826),
        (1, 10, 30, 2.5958966075264738),
        (500, 2, 0.5, 60.37908121118643),
        (500, 2, 4, 376.27354362910523),
        (500, 2, 30, 26.95619211056908),
    ):
        assert p.contrast_sensitivity(frequency, luminance, size).item() == pytest.approx(expected, rel=1e-12)
    assert p.pupil_diameter(1.0, 10.0).item() == pytest.approx(6.342687385490272)


def test_against_bartens_short_formula():
    # Barten, Proc. SPIE 5294, 231 (2004), its approximation for ordinary viewing.
    frequency = torch.tensor([0.3, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0], dtype=torch.float64)
    for luminance, size, tolerance in ((100.0, 60.0, 0.06), (100.0, 10.0, 0.14), (300.0, 30.0, 0.14)):
        short = 5200 * torch.exp(-0.0016 * frequency**2 * (1 + 100 / luminance) ** 0.08)
        noise = 63 / luminance**0.83 + 1 / (1 - torch.exp(-0.02 * frequency**2))
        short = short / ((1 + 144 / size**2 + 0.64 * frequency**2) * noise).sqrt()
        ratio = p.contrast_sensitivity(frequency, luminance, size) / short
        assert ((ratio - 1).abs() < tolerance).all()


def test_shape_of_the_curve():
    frequency = torch.logspace(-1, 1.7, 200, dtype=torch.float64)
    for luminance in (1.0, 100.0):
        curve = p.contrast_sensitivity(frequency, luminance, 10.0)
        peak = frequency[curve.argmax()]
        assert 1 < peak < 6
    brighter = p.contrast_sensitivity(frequency, 100.0, 10.0) / p.contrast_sensitivity(frequency, 1.0, 10.0)
    assert (brighter > 1).all()
    variables = tuple(torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (3.0, 50.0, 12.0))
    assert torch.autograd.gradcheck(p.contrast_sensitivity, variables, fast_mode=True)
    for bad in ((0.0,), (1.0, -1.0), (1.0, 1.0, math.nan)):
        with pytest.raises(ValueError, match="must be positive"):
            p.contrast_sensitivity(*bad)


def grating(cycles, contrast, size=64, mean=0.4):
    phase = 2 * math.pi * cycles * torch.arange(size, dtype=torch.float64) / size
    return (mean * (1 + contrast * torch.sin(phase + 0.3))).expand(1, 1, size, size)


@pytest.mark.parametrize("cycles", [1, 5, 20, 32])
@pytest.mark.parametrize("across", [True, False])
def test_a_grating_at_its_threshold_has_a_loss_of_one(cycles, across):
    width, distance, peak = 0.1, 0.6, 80.0
    loss = p.CSFLoss(width, distance, peak, 1e-9, "linear")
    flat = grating(cycles, 0.0)
    frequency = cycles / math.degrees(width / distance)
    side = 2 * math.degrees(math.atan(width / 2 / distance))
    sensitivity = p.contrast_sensitivity(frequency, 0.4 * peak, side).item()
    for multiple in (1.0, 3.0):
        picture = grating(cycles, multiple / sensitivity)
        picture = picture if across else picture.mT
        # At the highest frequency the samples see a share of the wave, sin²φ, twice as heavy.
        share = 2 * math.sin(0.3) ** 2 if cycles == 32 else 1
        assert loss(picture, flat).item() == pytest.approx(multiple**2 * share, rel=1e-6)
        assert loss(picture.expand(2, 3, 64, 64), flat.expand(2, 3, 64, 64)).item() == pytest.approx(
            multiple**2 * share, rel=1e-6
        )


def test_odd_sizes_and_batches():
    generator = torch.Generator().manual_seed(0)
    image, target = (torch.rand(3, 3, 15, 21, dtype=torch.float64, generator=generator) for _ in range(2))
    loss = p.CSFLoss()
    parts = [loss(image[i : i + 1], target[i : i + 1]) for i in range(3)]
    assert loss(image, target).item() == pytest.approx(torch.stack(parts).mean().item(), rel=1e-12)
    # The whole spectrum, as a second way.
    light = p.rgb_to_linear_rgb(torch.cat([image, target]))
    luminance = 0.1 + 99.9 * torch.einsum(
        "bchw,c->bhw", light, torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
    )
    shown, wanted = luminance.chunk(2)
    pitch = math.degrees(0.2 / 21 / 0.7)
    frequency = torch.hypot(
        torch.fft.fftfreq(15, pitch, dtype=torch.float64)[:, None], torch.fft.fftfreq(21, pitch, dtype=torch.float64)
    )
    frequency = frequency.clamp_min(1 / (21 * pitch))
    sides = [2 * math.degrees(math.atan(length / 2 / 0.7)) for length in (0.2, 0.2 * 15 / 21)]
    total = 0
    for a, b in zip(shown, wanted, strict=True):
        sensitivity = p.contrast_sensitivity(frequency, b.mean().item(), math.sqrt(math.prod(sides)))
        filtered = torch.fft.ifft2(torch.fft.fft2((a - b) / b.mean()) * sensitivity).real
        total += 2 * filtered.square().mean() / 3
    assert loss(image, target).item() == pytest.approx(total.item(), rel=1e-10)


def test_loss_as_a_module():
    loss = p.CSFLoss().to(torch.device("cpu"))
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(1, 3, 4, 6, dtype=torch.float64, generator=generator, requires_grad=True)
    target = torch.rand(1, 3, 4, 6, dtype=torch.float64, generator=generator)
    assert loss(target, target).item() == 0
    assert torch.autograd.gradcheck(lambda picture: loss(picture, target), image, fast_mode=True)
    first = loss.frequencies
    loss(image, target)
    assert loss.frequencies is first
    assert loss(image[..., :5], target[..., :5]).dtype == torch.float64
    assert loss.frequencies.shape == (4, 3)
    assert loss(image.float(), target.float()).dtype == torch.float32
    assert loss.state_dict() == {}
    black = torch.zeros(1, 1, 4, 4, requires_grad=True)
    loss(black, torch.zeros(1, 1, 4, 4)).backward()
    assert torch.isfinite(black.grad).all()


def test_fine_detail_counts_less_from_further_away():
    near, far = p.CSFLoss(0.2, 0.5), p.CSFLoss(0.2, 16.0)
    fine, coarse, flat = grating(30, 0.2), grating(2, 0.2), grating(2, 0.0)
    assert far(fine, flat) < 0.05 * near(fine, flat)
    assert far(coarse, flat) > near(coarse, flat)
    assert near(flat + 0.05, flat) > 1


def test_refused():
    loss = p.CSFLoss()
    good = torch.rand(1, 3, 8, 8)
    for image, message in (
        (good[0], "CSFLoss ERROR"),
        (good[:, :2], "one or three channels"),
        (255 * good, "image must be from -1 to 2"),
        (good * torch.nan, "image must be finite"),
        (good[..., :1, :1], "two pixels or more"),
    ):
        with pytest.raises(ValueError, match=message):
            loss(image, good.new_zeros(image.shape))
    with pytest.raises(ValueError, match="CSFLoss ERROR: image and target must have one size"):
        loss(good, good[..., :4])
    with pytest.raises(TypeError, match="image must be a tensor"):
        loss(good.numpy(), good)
    for arguments, message in (
        ({"real_image_width": 0.0}, "real_image_width must be positive"),
        ({"black_luminance": 200.0}, "black_luminance must be less"),
        ({"encoding": "gamma"}, "encoding must be one of"),
    ):
        with pytest.raises(ValueError, match=message):
            p.CSFLoss(**arguments)
