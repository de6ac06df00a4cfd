"""Metamers, eigendistortions and maximum differentiation of models whose answers are known in closed form."""

import pytest
import torch

from odak._warnings import ConvergenceWarning
from odak.learn.perception import eigendistortions, maximum_differentiation, metamer

SHAPE = (1, 1, 4, 5)


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def linear(rows=8):
    """Return a matrix and the linear model of it, whose response has a real and a complex part."""
    matrix = noise(rows, 20, seed=1) - 0.5

    def model(picture):
        seen = matrix @ picture.flatten()
        return [seen[: rows // 2], torch.complex(seen[rows // 2 : -2], seen[rows // 2 + 2 :])]

    # Rows that are seen twice count twice.
    twice = torch.cat([matrix[: rows // 2], matrix[rows // 2 : -2], matrix[rows // 2 + 2 :]])
    return twice, model


def test_metamer_of_linear_model_is_projection_of_start():
    matrix, model = linear()
    picture, start = noise(*SHAPE), noise(*SHAPE, seed=2)
    steps = []
    found = metamer(model, picture, start, 60, None, progress=lambda: steps.append(1))
    inverse = torch.linalg.pinv(matrix)
    expected = start.flatten() + inverse @ (matrix @ (picture - start).flatten())
    torch.testing.assert_close(found.flatten(), expected, rtol=0, atol=1e-6)
    assert (found - picture).abs().max() > 0.1
    assert 0 < len(steps) <= 60


def test_a_metamer_keeps_to_its_bounds():
    def model(picture):
        return picture.mean((-2, -1))

    picture = 0.1 + 0.1 * noise(*SHAPE)
    found = metamer(model, picture, bounds=(0.05, 0.4), seed=3)
    assert 0.05 <= float(found.min()) < float(found.max()) <= 0.4
    torch.testing.assert_close(model(found), model(picture), rtol=0, atol=1e-4)
    assert torch.equal(found, metamer(model, picture, bounds=(0.05, 0.4), seed=3))
    with pytest.warns(ConvergenceWarning, match="not converged after 2 evaluations"):
        metamer(model, picture, iterations=2)
    assert not torch.equal(found, metamer(model, picture, bounds=(0.05, 0.4), seed=4))


@pytest.mark.parametrize("least", [False, True])
def test_distortions_of_a_linear_model_are_its_singular_vectors(least):
    matrix, model = linear(30)
    _, singular, vectors = torch.linalg.svd(matrix)
    order = [-1, -2, -3] if least else [0, 1, 2]
    values, found = eigendistortions(model, noise(*SHAPE), 3, least, 1e-10)
    assert found.shape == (3, *SHAPE)
    torch.testing.assert_close(values, torch.stack([singular[k] ** 2 for k in order]), rtol=1e-8, atol=1e-8)
    for one, k in zip(found.flatten(1), order, strict=True):
        assert float((one @ vectors[k]).abs()) == pytest.approx(1, abs=1e-6)


def test_distortions_depend_on_the_picture():
    """The square of each value: the most visible change is of the brightest pixel."""
    picture = noise(*SHAPE)
    values, found = eigendistortions(torch.square, picture, 2)
    largest = picture.flatten().topk(2)
    torch.testing.assert_close(values, (2 * largest.values) ** 2)
    assert found.flatten(1).abs().argmax(1).tolist() == largest.indices.tolist()


def test_few_steps_of_the_iteration_are_a_warning(monkeypatch):
    from odak.learn.perception import discrimination

    def stopped(operator, count, **options):
        raise discrimination.ArpackNoConvergence("", torch.ones(1).numpy(), torch.ones(20, 1).numpy())

    monkeypatch.setattr(discrimination, "eigsh", stopped)
    with pytest.warns(ConvergenceWarning, match="1 of 3 distortions converged"):
        values, found = eigendistortions(torch.square, noise(*SHAPE), 3)
    assert values.shape == (1,) and found.shape == (1, *SHAPE)


@pytest.mark.parametrize("largest", [True, False])
def test_maximum_differentiation_of_quadratic_forms(largest):
    """On a sphere the extremes of a quadratic form are its extreme eigenvalues."""
    basis, _ = torch.linalg.qr(noise(20, 20, seed=5) - 0.5)
    curvature = torch.linspace(1, 3, 20, dtype=torch.float64)
    form = basis * curvature @ basis.T
    picture, start = noise(*SHAPE), noise(*SHAPE, seed=6)

    def held(one, two):
        return (one - two).square().sum()

    def driven(one, two):
        change = (one - two).flatten()
        return change @ form @ change

    found = maximum_differentiation(held, driven, picture, start, largest, 300)
    level = float(held(start, picture))
    assert float(held(found, picture)) == pytest.approx(level, rel=2e-6)
    assert float(driven(found, picture)) / level == pytest.approx(3.0 if largest else 1.0, rel=1e-3)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: metamer(torch.square, torch.ones(4)), r"picture must be \[..., H, W\]"),
        (lambda: metamer(torch.square, [[1.0]]), "picture must be a tensor of real floats"),
        (lambda: metamer(torch.square, noise(4, 4), noise(4, 5)), "start must be of the picture's shape"),
        (lambda: metamer(torch.square, noise(4, 4), bounds=(1, 0)), "bounds must be two rising numbers"),
        (lambda: metamer(lambda one: 1.0, noise(4, 4)), "model must return a tensor"),
        (lambda: eigendistortions(torch.square, noise(2, 2), 4), "count must be less than the 4 values"),
        (lambda: eigendistortions(torch.square, noise(2, 2), tolerance=0), "tolerance"),
        (lambda: eigendistortions(torch.square, 0 * noise(2, 2)), "response of model must change with the picture"),
        (
            lambda: maximum_differentiation(torch.sub, torch.sub, noise(2, 2), noise(2, 2)),
            "held must return a tensor of one number",
        ),
    ],
)
def test_refused(call, named):
    with pytest.raises((ValueError, TypeError), match=named):
        call()
