"""Disturbed rounding: what moves, by how much, and what stays."""

import disturbed
import numpy as np
import pytest
import torch

EPS = {torch.float32: 2**-23, torch.float64: 2**-52}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_numbers_move_by_their_bits_and_the_seed(dtype):
    numbers = np.random.default_rng(0).normal(size=40_000).astype(dtype)
    first, again, other = (disturbed.steps_of(numbers, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again) and 0.2 < np.mean(first == other) < 0.3
    shares = [np.mean(first == step) for step in (-2, -1, 1, 2)]
    assert min(shares) > 0.24 and max(shares) < 0.26
    assert np.array_equal(first, disturbed.steps_of(-numbers, 1))
    changed = numbers.copy()
    disturbed.disturb(changed, 1)
    assert np.array_equal(np.sign(changed - numbers), np.sign(first * numbers))
    np.testing.assert_array_max_ulp(changed, numbers, 2)
    exact = np.array([0, -0.0, 1, -3, 0.5, 640, np.inf, -np.inf, np.nan], dtype)
    assert not disturbed.steps_of(exact, 1).any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_operations_of_torch(dtype):
    a, b = torch.randn(2, 40, 40, dtype=dtype.to_complex(), generator=torch.Generator().manual_seed(3))
    operations = {
        "sin": lambda: a.real.sin(),
        "transform": lambda: torch.fft.fft2(a),
        "product": lambda: a * b,
        "modulus": lambda: a.abs(),
        "matrices": lambda: a @ b.conj(),
        "sum": lambda: a.real.sum(0),
        "mean": lambda: a.real.mean(1),
        "solution": lambda: torch.linalg.solve(a + 40 * torch.eye(40), b),
    }
    whole = torch.arange(9.0, dtype=dtype).reshape(3, 3)
    for name, operation in operations.items():
        plain = operation()
        with disturbed.Disturbed(1):
            first, second = operation(), operation()
            assert torch.equal(whole @ whole, torch.matmul(whole, whole)) and float(whole.sum()) == 36
            assert torch.equal(torch.eye(40, dtype=a.dtype) @ a, a) and torch.equal(torch.zeros(3).cos(), torch.ones(3))
            assert torch.equal(a * 2, a + a) and torch.equal(a.real.sin()[3], a.real[3].sin())
        assert torch.equal(first, second), name
        difference = float((first - plain).abs().max() / plain.abs().max())
        assert 0 < difference < 60 * EPS[dtype], name


def test_gradients_are_of_the_disturbed_numbers():
    x = torch.tensor(0.7, dtype=torch.float64, requires_grad=True)
    with disturbed.Disturbed(1):
        assert torch.autograd.gradcheck(lambda x: (x.exp() * x.sin()).log(), x, fast_mode=True)


def test_calls_of_numpy():
    calls, x = disturbed._numpy_calls(1), np.random.default_rng(0).normal(size=100)
    y = np.random.default_rng(1).normal(size=(99, 20))
    assert 0 < abs(calls["results"](np.sin, [x], {}) / np.sin(x) - 1).max() < 1e-15
    assert np.array_equal(calls["results"](np.cos, [np.zeros(3)], {}), np.ones(3))
    assert 0 < abs(calls["both"](np.fft.fft, [x], {}) - np.fft.fft(x)).max() < 1e-13
    assert calls["sums"](np.sum, [np.arange(9.0)], {}) == 36
    assert calls["sums"](np.sum, [y], {"axis": 0}).tolist() != np.sum(y, 0).tolist()
    assert type(calls["results"](np.exp, [0.3], {})) is np.float64
