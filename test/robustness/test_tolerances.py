"""Measured rounding errors are within the bounds, and not far below them."""

import numpy as np
import pytest
from tolerances import epsilon, products_bound, sums_bound, transforms_bound


@pytest.mark.parametrize("n", [64, 4096, 262_144])
def test_bounds_hold_and_are_not_loose(n):
    values = np.random.default_rng(n).random(n).astype(np.float32)
    exact = values.astype(np.float64)
    one_by_one = np.cumsum(values)[-1]
    assert abs(one_by_one - exact.sum()) / exact.sum() <= sums_bound(np.float32, n)
    spectrum, expected = np.fft.fft(values), np.fft.fft(exact)
    error = np.linalg.norm(spectrum - expected) / np.linalg.norm(expected)
    assert transforms_bound(np.float32, n) / 1000 < error <= transforms_bound(np.float32, n)
    error = np.abs(np.sin(values) ** 2 / np.sin(exact) ** 2 - 1).max()
    assert products_bound(np.float32, 2) / 100 < error <= products_bound(np.float32, 2)


def test_epsilon_is_that_of_the_real_part():
    assert epsilon("torch.complex64") == epsilon(np.float32) == 2.0**-23
