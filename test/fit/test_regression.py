"""Fits against closed forms, a plain loop and the numbers of the specification."""

import numpy as np
import pytest
import torch

import odak
from odak import fit


def quadratic(x, p):
    return p[0] * x**2 + p[1] * x + p[2]


def quadratic_gradient(x, y, function, p):
    error = function(x, p) - y
    return np.asarray([2 * x**2 * error, 2 * x * error, 2 * error])


def squared(truth, estimate):
    return ((truth - estimate) ** 2).sum()


def test_line_through_points_and_nearest_line(random):
    np.testing.assert_allclose(fit.least_square_1d(np.arange(5), 3 * np.arange(5) - 7), [3, -7], atol=1e-13)
    x, y = random.normal(size=(2, 50))
    np.testing.assert_allclose(fit.least_square_1d(x, y), np.polyfit(x, y, 1), rtol=1e-12)
    far = fit.least_square_1d(x + 1e7, 2 * x)
    assert far[0] == pytest.approx(2, rel=1e-7)


def test_line_in_torch_is_differentiable(random):
    x, y = (torch.from_numpy(values).requires_grad_() for values in random.normal(size=(2, 9)))
    expected = fit.least_square_1d(x.detach().numpy(), y.detach().numpy())
    np.testing.assert_allclose(fit.least_square_1d(x, y).detach().numpy(), expected, rtol=1e-13)
    assert torch.autograd.gradcheck(fit.least_square_1d, (x, y), fast_mode=True)


def test_line_errors():
    with pytest.raises(ValueError, match="two different"):
        fit.least_square_1d([1, 1], [0, 1])
    with pytest.raises(ValueError, match="as many points"):
        fit.least_square_1d([1, 2, 3], [0, 1])


@pytest.mark.parametrize("vectorized", [False, True])
def test_descent_reaches_the_parabola(vectorized):
    x = np.linspace(-1, 1, 20)
    start = (10, 10, 0)
    result = fit.gradient_descent_1d(
        input_data=x,
        ground_truth_data=quadratic(x, (1.5, -2.0, 0.25)),
        parameters=start,
        function=quadratic,
        gradient_function=quadratic_gradient,
        loss_function=squared,
        learning_rate=0.5,
        iteration_number=400,
        vectorized=vectorized,
    )
    np.testing.assert_allclose(result, (1.5, -2.0, 0.25), atol=1e-8)
    assert start == (10, 10, 0)


def test_descent_takes_the_steps_of_the_specification(capsys):
    x = np.linspace(0, 1, 5)
    gradient = lambda x, y, f, p: np.asarray([-2 * x * (y - f(x, p)), -2 * (y - f(x, p))])  # noqa: E731
    line = lambda x, p: p[0] * x + p[1]  # noqa: E731
    arguments = (x, 2 * x + 1, np.zeros(2), line, gradient, squared, 0.1, 10)
    np.testing.assert_allclose(fit.gradient_descent_1d(*arguments), (1.04557, 1.41857), atol=5e-6)
    assert capsys.readouterr().err == ""
    fit.gradient_descent_1d(*arguments, progress=True)
    assert "Loss" in capsys.readouterr().err


def test_descent_errors():
    with pytest.raises(ValueError, match="one value per point"):
        fit.gradient_descent_1d([1, 2], [1], [0], quadratic, quadratic_gradient, squared)
    wrong = lambda x, y, f, p: x  # noqa: E731
    with pytest.raises(ValueError, match=r"must return \[3, 2\]"):
        fit.gradient_descent_1d([1, 2], [1, 2], [0, 0, 0], quadratic, wrong, squared, vectorized=True)


def plain_perceptron(x, y, rate, passes):
    w = np.zeros(x.shape[1] + 1)
    for _ in range(passes):
        for point, label in zip(x, y.ravel(), strict=True):
            row = np.concatenate(([1.0], point))
            w = w + rate * (label - int(row @ w >= 0)) * row
    return w[:, None]


def test_perceptron_is_the_plain_loop(random):
    x = random.normal(size=(600, 2))
    y = (x[:, :1] - 0.5 * x[:, 1:] + 0.6 * random.normal(size=(600, 1)) > 0.2).astype(int)
    np.testing.assert_allclose(fit.perceptron(x, y, 0.1, 3), plain_perceptron(x, y, 0.1, 3), atol=1e-12)


def test_perceptron_parts_what_a_line_parts(random):
    x = np.concatenate((random.normal(size=(100, 2)) + 4, random.normal(size=(100, 2)) - 4))
    y = np.repeat([1, 0], 100)[:, None]
    w = fit.perceptron(x, y, learning_rate=0.1, iteration_number=100)
    assert w.shape == (3, 1)
    rows = np.column_stack((np.ones(200), x)).T
    np.testing.assert_array_equal(fit.threshold_linear_model(rows, w), y[:, 0])


def test_perceptron_numbers_of_the_specification():
    x = [[2, 1], [3, 2], [-1, -2], [-2, -1]]
    np.testing.assert_allclose(fit.perceptron(x, [[1], [1], [0], [0]], 0.1, 10), [[-0.1], [0.1], [0.2]], atol=1e-12)


def test_threshold_and_errors():
    assert fit.threshold_linear_model([1, 2], [[-2], [1]]) == 1
    assert fit.threshold_linear_model([[1], [2]], [[-2], [1]], threshold=0.1) == 0
    with pytest.raises(ValueError, match="as many entries"):
        fit.threshold_linear_model([1, 2], [1, 2, 3])
    with pytest.raises(ValueError, match="labels 0 and 1"):
        fit.perceptron([[1.0]], [2])
    with pytest.raises(ValueError, match="one label each"):
        fit.perceptron([[1.0]], [1, 0])


def test_tensors_with_gradients_are_taken_as_numbers(random):
    points, labels = random.normal(size=(20, 2)), np.repeat([0, 1], 10)
    points[:, 0] += 6 * labels
    tensor = torch.from_numpy(points).requires_grad_()
    with pytest.warns(odak.AccuracyWarning, match="x requires a gradient"):
        weights = fit.perceptron(tensor, labels)
    np.testing.assert_array_equal(weights, fit.perceptron(points, labels))
    with pytest.warns(odak.AccuracyWarning, match="w requires a gradient"):
        fit.threshold_linear_model([1.0, 0.0, 0.0], torch.from_numpy(weights).requires_grad_())
    x = np.linspace(-1, 1, 5)
    options = (quadratic, quadratic_gradient, squared, 0.5, 3)
    with pytest.warns(odak.AccuracyWarning, match="parameters requires a gradient"):
        found = fit.gradient_descent_1d(x, x, torch.zeros(3, dtype=torch.float64, requires_grad=True), *options)
    np.testing.assert_array_equal(found, fit.gradient_descent_1d(x, x, np.zeros(3), *options))


def test_a_line_far_from_zero_keeps_its_digits_in_single_precision():
    x = np.linspace(1e6, 1e6 + 5, 20, dtype=np.float32)
    y = (3 * (x - np.float32(1e6)) + np.sin(7 * x)).astype(np.float32)
    slope, start = fit.least_square_1d(x, y)
    expected = np.polyfit(x.astype(np.float64) - 1e6, y, 1)
    assert slope == pytest.approx(expected[0], rel=1e-5)
    assert start + slope * 1e6 == pytest.approx(expected[1], abs=1.0)
