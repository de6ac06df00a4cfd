import math

import pytest
import torch

from odak.learn.tools import generate_2d_dirac_delta, generate_2d_gaussian, smooth_pad, zero_pad


def test_the_delta_is_a_gaussian_of_half_the_variance():
    ours = generate_2d_dirac_delta([9, 12], [1.5, 2.0], mu=[0.5, -1.0], dtype=torch.float64)
    sigmas = [1.5 / math.sqrt(2), 2.0 / math.sqrt(2)]
    assert torch.allclose(ours, generate_2d_gaussian([9, 12], sigmas, [0.5, -1.0], dtype=torch.float64), atol=1e-14)


def test_a_quarter_turn_exchanges_the_widths():
    turned = generate_2d_dirac_delta([9, 9], [1.0, 3.0], theta=math.pi / 2)
    assert torch.allclose(turned, generate_2d_dirac_delta([9, 9], [3.0, 1.0]), atol=1e-7)
    leaning = generate_2d_dirac_delta([9, 9], [1.0, 3.0], theta=math.pi / 6)
    # y' = 0 along x·sin θ = −y·cos θ: the long axis leans to (sin θ, cos θ) in (x, y).
    assert leaning[4 + 1, 4 + 2] > leaning[4 - 1, 4 + 2]


def test_peak_and_gradient():
    delta = generate_2d_dirac_delta(a=[0.1, 0.1], normalize=True)
    assert delta[10, 10] == 1
    assert delta.sum() == 1
    assert generate_2d_dirac_delta([4, 4], [1e-3, 1e-3], normalize=True).max() == 1
    a, mu, theta = (torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in ([1.0, 2.0], [0.1, 0.2], 0.4))
    assert torch.autograd.gradcheck(
        lambda *given: generate_2d_dirac_delta([4, 3], *given, dtype=torch.float64), (a, mu, theta), fast_mode=True
    )
    with pytest.raises(ValueError, match="a must be finite and not zero"):
        generate_2d_dirac_delta(a=[0.0, 1.0])
    with pytest.raises(ValueError, match="mu must be two numbers"):
        generate_2d_dirac_delta(mu=[0.0])


@pytest.mark.parametrize(
    "shape, size, expected",
    [
        ((10, 10), None, (20, 20)),
        ((1, 3, 10, 10), None, (3, 20, 20)),
        ((1, 10, 10, 3), None, (1, 20, 20, 3)),
        ((10, 10), [30, 40], (30, 40)),
        ((2, 5, 7), [9, 12], (2, 9, 12)),
    ],
)
def test_soft_border_keeps_layout_and_content(shape, size, expected):
    field = torch.rand(shape, dtype=torch.float64)
    padded = smooth_pad(field, size)
    assert padded.shape == expected
    assert padded.dtype == torch.float64
    inside = zero_pad(torch.ones_like(field), size) == 1
    assert torch.equal(padded[inside], zero_pad(field, size)[inside])
    assert 0 < padded[~inside].max() <= field.max()
