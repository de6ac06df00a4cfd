"""PQ, HLG and PU21 against published values and their inverses."""

import math

import pytest
import torch

from odak.learn import perception as p

LIGHT = torch.cat([torch.zeros(1, dtype=torch.float64), torch.logspace(-5, 4, 901, dtype=torch.float64)])


def values(*numbers):
    return torch.tensor(numbers, dtype=torch.float64)


def test_pq_against_the_formula_as_published():
    # SMPTE ST 2084, with its constants as printed.
    m1, m2, c1, c2, c3 = 0.1593017578125, 78.84375, 0.8359375, 18.8515625, 18.6875
    power = (LIGHT / 10000) ** m1
    expected = ((c1 + c2 * power) / (1 + c3 * power)) ** m2
    assert torch.allclose(p.pq_encode(LIGHT), expected, rtol=1e-12, atol=0)
    # ITU-R BT.2408: 58 % for 203 cd/m².
    assert p.pq_encode(values(203.0)).item() == pytest.approx(0.58, abs=1e-3)
    assert p.pq_encode(values(-5.0, 0.0, 10000.0, 20000.0)).tolist() == pytest.approx([c1**m2, c1**m2, 1, 1])
    assert p.pq_decode(values(-0.1, 0.0, 1.0, 1.2)).tolist() == pytest.approx([0, 0, 10000, 10000])


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_pq_round_trip(dtype):
    light = LIGHT.to(dtype)
    back = p.pq_decode(p.pq_encode(light))
    assert back.dtype == dtype
    # The relative error of the root x of the signal grows by the condition of ((x − c1)/(c2 − c3·x))^(1/m1).
    root = p.pq_encode(LIGHT) ** (32 / 2523)
    condition = (root / (root - 3424 / 4096) + root * 2392 / (2413 - 2392 * root)) * 16384 / 2610
    relative = (back.double() / LIGHT - 1).abs() / condition
    assert relative[100:].max() < torch.finfo(dtype).eps
    assert (back[:100] - light[:100]).abs().max() < 1e-7


def test_hlg_signal():
    # ITU-R BT.2100: half the signal at a twelfth of the light, 75 % at 26.5 % (BT.2408), all of it at 1.
    assert p.hlg_encode(values(0.0, 1 / 12, 1.0)).tolist() == pytest.approx([0, 0.5, 1.0], abs=1e-8)
    assert p.hlg_decode(values(0.75)).item() == pytest.approx(0.265, abs=5e-4)
    assert p.hlg_encode(values(0.05, 0.3)).tolist() == pytest.approx(
        [0.3872983346207417, 0.7742520858199462], abs=1e-12
    )
    light = torch.linspace(0, 2, 1001, dtype=torch.float64)
    assert torch.allclose(p.hlg_decode(p.hlg_encode(light)), light, rtol=0, atol=1e-13)
    assert p.hlg_encode(values(-1.0)).item() == 0


def test_hlg_display():
    assert p.hlg_system_gamma(1000) == 1.2
    assert p.hlg_system_gamma(2000) == pytest.approx(1.2 + 0.42 * math.log10(2))
    assert p.hlg_system_gamma(4000) == pytest.approx(1.2 * 1.111**2)
    # colour-science 0.4.7, eotf_BT2100_HLG with a black of 0.05 and a white of 1000 cd/m².
    signal = values(0.3, 0.6, 0.9).reshape(3, 1, 1)
    expected = [22.81778468, 90.30518688, 395.89693715]
    assert p.hlg_to_luminance(signal, 1000, 0.05).flatten().tolist() == pytest.approx(expected, rel=1e-8)
    white, black = torch.ones(3, 1, 1, dtype=torch.float64), torch.zeros(3, 1, 1, dtype=torch.float64)
    assert p.hlg_to_luminance(white, 600, 0.1).flatten().tolist() == pytest.approx([600] * 3, rel=1e-7)
    assert p.hlg_to_luminance(black, 600, 0.1).flatten().tolist() == pytest.approx([0.1] * 3, rel=1e-7)
    signals = torch.rand(2, 3, 4, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    for peak, dark in ((1000, 0), (200, 0.1), (4000, 0.005)):
        emitted = p.hlg_to_luminance(signals, peak, dark)
        assert torch.allclose(p.luminance_to_hlg(emitted, peak, dark), signals, rtol=0, atol=1e-12)


@pytest.mark.parametrize("variant", ["banding", "banding_glare", "peaks", "peaks_glare"])
def test_pu21(variant):
    light = LIGHT[LIGHT >= 0.006]
    encoded = p.pu21_encode(light, variant)
    assert (encoded.diff() > 0).all()
    assert torch.allclose(p.pu21_decode(encoded, variant), light, rtol=1e-9)
    # By its making: about 0 at the darkest and 256 at 100 cd/m², as in 8-bit pictures.
    assert p.pu21_encode(values(0.005, 100.0), variant).tolist() == pytest.approx([0, 256], abs=6)
    assert p.pu21_encode(values(0.0, 1e5), variant).tolist() == p.pu21_encode(values(0.005, 1e4), variant).tolist()
    single = p.pu21_decode(p.pu21_encode(light.float(), variant), variant)
    assert single.dtype == torch.float32
    assert torch.allclose(single, light.float(), rtol=5e-6)


# pu21_encoder.m by way of pycvvdp 0.5.7, at 0.1, 1, 100 and 10 000 cd/m².
AUTHORS = {
    "banding": [36.005731693229016, 84.4045113132005, 261.7517279301995, 520.4673070183068],
    "banding_glare": [5.717073839669447, 36.5439111394192, 256.3838973127039, 595.393920020095],
    "peaks": [32.65682857177826, 85.54201498207478, 260.72498261186183, 380.98531612197723],
    "peaks_glare": [8.010354542060325, 47.00902940492243, 252.29848828348094, 407.50661970098133],
}


@pytest.mark.parametrize("variant", AUTHORS)
def test_pu21_against_the_authors_code(variant):
    encoded = p.pu21_encode(values(0.1, 1.0, 100.0, 10000.0), variant)
    assert encoded.tolist() == pytest.approx(AUTHORS[variant], rel=1e-12)


FUNCTIONS = [p.pq_encode, p.pq_decode, p.hlg_encode, p.hlg_decode, p.pu21_encode, p.pu21_decode]


@pytest.mark.filterwarnings("ignore:signal reaches 600")
@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_gradients_are_finite_and_right(function):
    for number in (-1.0, 0.0, 1e-12, 0.5, 1.0, 2.0, 1e4, 1e5):
        for dtype in (torch.float32, torch.float64):
            value = torch.tensor([min(number, 600.0) if "decode" in function.__name__ else number], dtype=dtype)
            value = value.clamp(max=2) if function is p.hlg_decode else value
            value.requires_grad_()
            result = function(value)
            result.sum().backward()
            assert torch.isfinite(result).all()
            assert torch.isfinite(value.grad).all()
    inside = values(0.11, 0.3, 0.72, 0.9).requires_grad_()
    assert torch.autograd.gradcheck(function, inside, fast_mode=True)
    assert torch.autograd.gradgradcheck(function, inside)


@pytest.mark.parametrize("function", [p.pq_encode, p.hlg_encode])
def test_values_below_the_bounded_slope_are_exact(function):
    dark = values(0.0, 1e-8, 1e-7).requires_grad_()
    slopes = torch.autograd.grad(function(dark).sum(), dark)[0]
    assert (slopes == slopes[0]).all()
    floor = values(1e-5 if function is p.pq_encode else 1e-6).requires_grad_()
    assert slopes[0].item() == pytest.approx(torch.autograd.grad(function(floor), floor)[0].item(), rel=1e-9)
    if function is p.hlg_encode:
        assert torch.allclose(function(dark), (3 * dark).sqrt(), rtol=1e-14)


def test_gradients_of_hlg_displays():
    for function in (p.hlg_to_luminance, p.luminance_to_hlg):
        black = torch.zeros(1, 3, 1, 1, requires_grad=True)
        function(black, 300).sum().backward()
        assert torch.isfinite(black.grad).all()
        signal = values(0.2, 0.5, 0.9).reshape(1, 3, 1, 1).requires_grad_()
        assert torch.autograd.gradcheck(function, signal, fast_mode=True)


def test_refused():
    with pytest.raises(ValueError, match="black_luminance must be at least 0 and less"):
        p.hlg_to_luminance(torch.zeros(3, 1, 1), 100, 100)
    with pytest.raises(ValueError, match=r"signal must be pictures \[..., 3, H, W\]"):
        p.hlg_to_luminance(torch.zeros(2, 1, 1))
