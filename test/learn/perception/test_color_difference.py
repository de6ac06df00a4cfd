"""CIEDE2000 against its test data."""

import pytest
import torch

from odak.learn.perception import ciede2000, delta_e

# Sharma, Wu and Dalal, Color Res. Appl. 30, 21 (2005), table 1: L*a*b*, L*a*b*, difference.
PAIRS = (
    (50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425),
    (50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615),
    (50.0000, 2.8361, -74.0200, 50.0000, 0.0000, -82.7485, 3.4412),
    (50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000),
    (50.0000, -1.1848, -84.8006, 50.0000, 0.0000, -82.7485, 1.0000),
    (50.0000, -0.9009, -85.5211, 50.0000, 0.0000, -82.7485, 1.0000),
    (50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669),
    (50.0000, -1.0000, 2.0000, 50.0000, 0.0000, 0.0000, 2.3669),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0010, 7.1792),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0012, 7.2195),
    (50.0000, -0.0010, 2.4900, 50.0000, 0.0009, -2.4900, 4.8045),
    (50.0000, -0.0010, 2.4900, 50.0000, 0.0010, -2.4900, 4.8045),
    (50.0000, -0.0010, 2.4900, 50.0000, 0.0011, -2.4900, 4.7461),
    (50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065),
    (50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492),
    (50.0000, 2.5000, 0.0000, 61.0000, -5.0000, 29.0000, 22.8977),
    (50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030),
    (50.0000, 2.5000, 0.0000, 58.0000, 24.0000, 15.0000, 19.4535),
    (50.0000, 2.5000, 0.0000, 50.0000, 3.1736, 0.5854, 1.0000),
    (50.0000, 2.5000, 0.0000, 50.0000, 3.2972, 0.0000, 1.0000),
    (50.0000, 2.5000, 0.0000, 50.0000, 1.8634, 0.5757, 1.0000),
    (50.0000, 2.5000, 0.0000, 50.0000, 3.2592, 0.3350, 1.0000),
    (60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644),
    (63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630),
    (61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731),
    (35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645),
    (22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373),
    (36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146),
    (90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441),
    (90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381),
    (6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377),
    (2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082),
)


def colours(columns):
    return torch.tensor(PAIRS, dtype=torch.float64)[:, columns, None, None]


def test_ciede2000_of_the_34_published_pairs():
    first, second = colours(slice(0, 3)), colours(slice(3, 6))
    expected = torch.tensor(PAIRS, dtype=torch.float64)[:, 6]
    assert len(PAIRS) == 34
    # Four digits are published.
    assert (ciede2000(first, second).flatten() - expected).abs().max() <= 5.1e-5
    assert torch.allclose(ciede2000(first, second), ciede2000(second, first), atol=1e-12)


def test_equal_colours_have_zero_difference_and_zero_gradient():
    for function in (delta_e, ciede2000):
        for lab in ((0.0, 0.0, 0.0), (50.0, 10.0, -20.0)):
            first = torch.tensor(lab, dtype=torch.float64).reshape(3, 1, 1).requires_grad_()
            result = function(first, first.detach().clone())
            result.sum().backward()
            assert result.shape == (1, 1, 1, 1)
            assert result.item() == 0
            assert torch.equal(first.grad, torch.zeros_like(first))


def test_gradients():
    # Opposite hues and greys are left out: there the formula jumps. Red hues pass from 360 to 0 degrees.
    first = colours(slice(0, 3))[17:30].requires_grad_()
    second = colours(slice(3, 6))[17:30]
    second = (second + 0.25 * torch.arange(3, dtype=torch.float64)[:, None, None]).requires_grad_()
    assert torch.autograd.gradcheck(ciede2000, (first, second), fast_mode=True)
    assert torch.autograd.gradcheck(delta_e, (first, second), fast_mode=True)


def test_delta_e_is_the_distance():
    first = torch.zeros(2, 3, 1, 2)
    second = torch.tensor([3.0, 4.0, 12.0]).reshape(3, 1, 1).expand(3, 1, 2)
    assert delta_e(first, second).tolist() == [[[[13.0, 13.0]]]] * 2


def test_refused():
    with pytest.raises(ValueError, match=r"second must be pictures \[..., 3, H, W\]"):
        ciede2000(torch.zeros(3, 1, 1), torch.zeros(2, 1, 1))


@pytest.mark.parametrize("difference", [delta_e, ciede2000])
def test_what_is_no_colour_differs_by_no_number(difference):
    first = torch.full((1, 3, 1, 2), 40.0)
    first[0, 1, 0, 0] = torch.nan
    found = difference(first, torch.full((1, 3, 1, 2), 50.0))
    assert found.isnan().flatten().tolist() == [True, False]


@pytest.mark.parametrize("difference", [delta_e, ciede2000])
def test_pictures_of_two_sizes_are_named(difference):
    with pytest.raises(ValueError, match=r"first \[1, 3, 4, 5\], second \[1, 3, 4, 6\]"):
        difference(torch.ones(1, 3, 4, 5), torch.ones(1, 3, 4, 6))
