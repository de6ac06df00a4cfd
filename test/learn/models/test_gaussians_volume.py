"""The density of Gaussians in space: values, losses term by term, the fit, files."""

import gc
import math

import pytest
import torch

from odak import ArgumentWarning
from odak.learn.models import gaussian_3d_volume, gaussians
from odak.learn.tools import get_rotation_matrix


def volume(number=6, seed=0):
    torch.manual_seed(seed)
    return gaussian_3d_volume(number)


def density(model, points):
    """Return the mean of the Gaussians by the formula, one after another."""
    total = 0
    for n in range(model.number_of_elements):
        turn = get_rotation_matrix((180 * model.angles[n]).tolist()).to(points)
        arm = (points - model.centers[n]) @ turn.T / model.scales[n]
        height = model.alphas[n] / ((2 * math.pi) ** 1.5 * model.scales[n].prod())
        total = total + height * torch.exp(-arm.square().sum(-1) / 2)
    return total / model.number_of_elements


@pytest.mark.parametrize("number", [1, 2, 7])
def test_density_is_the_mean(number):
    model = volume(number).double()
    points = torch.randn(11, 3, dtype=torch.float64)
    result = model(points)
    assert result.shape == (11,)
    torch.testing.assert_close(result, density(model, points), rtol=1e-5, atol=1e-9)
    assert model(points[:1]).shape == (1,)
    assert result.requires_grad
    assert not model(points, test=True).requires_grad


def test_integral_is_the_mean_weight():
    model = gaussian_3d_volume(
        2,
        torch.tensor([[0.3, -0.2, 0.1], [-0.5, 0.4, 0.0]]),
        torch.randn(2, 3),
        torch.tensor([[0.3, 0.4, 0.5], [0.2, 0.3, 0.4]]),
        torch.tensor([0.6, 1.0]),
    )
    axis = torch.linspace(-4, 4, 81)
    points = torch.cartesian_prod(axis, axis, axis)
    assert float(model(points, test=True).sum()) * 0.1**3 == pytest.approx(0.8, rel=1e-4)


def test_many_points_part_by_part(monkeypatch):
    model = volume(5).double()
    points = torch.randn(50, 3, dtype=torch.float64, requires_grad=True)
    whole = model(points)
    expected = torch.autograd.grad(whole.square().sum(), (points, *model.parameters()))
    monkeypatch.setattr(gaussians, "_PAIRS", 60)
    parts = model(points)
    assert torch.equal(parts, whole)
    slopes = torch.autograd.grad(parts.square().sum(), (points, *model.parameters()))
    for mine, theirs in zip(slopes, expected, strict=True):
        torch.testing.assert_close(mine, theirs)


def test_parameters():
    model = volume(4)
    shapes = {"centers": (4, 3), "angles": (4, 3), "scales": (4, 3), "alphas": (4, 1)}
    assert {name: tuple(value.shape) for name, value in model.state_dict().items()} == shapes
    assert list(model.state_dict()) == list(shapes)
    model.initialize_parameters(centers=torch.ones(4, 3, dtype=torch.int64), alphas=[0.1, 0.2, 0.3, 0.4])
    assert model.centers.tolist() == [[1.0] * 3] * 4
    assert model.alphas.shape == (4, 1)
    assert all(parameter.requires_grad for parameter in model.parameters())
    for name, value in (("centers", torch.zeros(3, 3)), ("scales", torch.zeros(4)), ("alphas", torch.zeros(4, 3))):
        with pytest.raises(ValueError, match=f"{name} must be"):
            model.initialize_parameters(**{name: value})
    with pytest.raises(ValueError, match="number_of_elements"):
        gaussian_3d_volume(0)


def only(**weights):
    """Return weights of which all but those given are zero."""
    return {"content": {"l2": 0.0, "l1": 0.0}, **weights}


def test_each_term_of_the_loss():
    model = volume(9)
    with torch.no_grad():
        model.scales.sub_(0.3)
        model.centers.mul_(2)
        model.angles.mul_(2)
    estimate, truth = torch.rand(20), torch.rand(20)

    def loss(**weights):
        return model.evaluate(estimate, truth, 3, 10, only(**weights)).item()

    s, a, c, r = (getattr(model, name).detach() for name in ("scales", "alphas", "centers", "angles"))
    difference = estimate - truth
    assert loss(content={"l2": 2.0}) == pytest.approx(2 * float((difference**2).mean()))
    assert loss(content={"l2": 0.0, "l1": 3.0}) == pytest.approx(3 * float(difference.abs().mean()))
    assert loss(scale={"smaller": 2.0, "threshold": [0.1, 0.4]}) == pytest.approx(2 * float(s[s < 0.1].abs().sum()))
    assert loss(scale={"larger": 2.0, "threshold": [0.1, 0.4]}) == pytest.approx(2 * float(s[s > 0.4].sum()))
    assert loss(alpha={"smaller": 2.0, "threshold": [0.3, 0.6]}) == pytest.approx(2 * float(a[a < 0.3].abs().sum()))
    assert loss(alpha={"larger": 2.0, "threshold": [0.3, 0.6]}) == pytest.approx(2 * float(a[a > 0.6].sum()))
    assert loss(angle=2.0) == pytest.approx(2 * float(r[r > 1].sum() + r[r < -1].abs().sum()))
    assert loss(center=2.0) == pytest.approx(2 * float(c[c.abs() > 1].abs().sum()))
    columns = torch.cat([c, s, a], dim=1)
    spread = float(columns.std(0).sum())
    assert loss(utilization={"l2": 2.0}) == pytest.approx(0.3 * 2 * spread)
    low, high = (columns[a[:, 0].argsort(descending=down)[:4]] for down in (False, True))
    gap = float((low.std(0) - high.std(0)).abs().sum() + (low.mean(0) - high.mean(0)).abs().sum())
    assert loss(utilization={"l2": 2.0, "percentile": 45}) == pytest.approx(0.3 * 2 * (spread + gap))


@pytest.mark.parametrize(("number", "percentile"), [(1, 0), (1, 100), (2, 50), (9, 0), (9, 15), (9, 22), (9, 100)])
def test_few_gaussians_give_no_nan(number, percentile):
    model = volume(number)
    weights = only(utilization={"l2": 1.0, "percentile": percentile})
    loss = model.evaluate(torch.zeros(3), torch.zeros(3), 1, 2, weights)
    loss.backward()
    assert math.isfinite(loss.detach())
    assert all(bool(parameter.grad.isfinite().all()) for parameter in model.parameters() if parameter.grad is not None)


def test_loss_of_no_terms_and_unknown_ones():
    model = volume()
    truth = torch.zeros(3)
    loss = model.evaluate(truth, truth, weights=only())
    loss.backward()
    assert float(loss.detach()) == 0
    for weights, message in (
        ({"colour": 1.0}, "weights must be of content.*'colour'"),
        ({"scale": {"small": 1.0}}, r"weights\['scale'\] must be of.*'small'"),
        ({"scale": 1.0}, r"weights\['scale'\] must be a dict"),
        ({"utilization": {"l2": 1.0, "percentile": 101}}, "percentile"),
    ):
        with pytest.raises(ValueError, match=message):
            model.evaluate(truth, truth, weights=weights)
    with pytest.raises(ValueError, match="epoch_count"):
        model.evaluate(truth, truth, 0, 0, {"utilization": {"l2": 1.0}})


ALL_TERMS = {
    "content": {"l2": 1.0, "l1": 0.1},
    "alpha": {"smaller": 0.1, "larger": 0.1, "threshold": [0.0, 1.0]},
    "scale": {"smaller": 0.1, "larger": 0.1, "threshold": [0.05, 2.0]},
    "angle": 0.1,
    "center": 0.1,
    "utilization": {"l2": 1e-4, "percentile": 20},
}


def ball(count=9):
    axis = torch.linspace(-1, 1, count)
    points = torch.cartesian_prod(axis, axis, axis)
    return points, (points.norm(dim=1) < 0.7).float()


def test_fit(tmp_path):
    torch.manual_seed(0)
    model = gaussian_3d_volume(20, 0.4 * torch.randn(20, 3), None, torch.full((20, 3), 0.4), torch.ones(20, 1))
    points, truth = ball()
    with torch.no_grad():
        before = float(torch.nn.functional.mse_loss(model(points), truth))
    path = tmp_path / "volume.bin"
    weights = {**ALL_TERMS, "alpha": {}}
    arguments = {"learning_rate": 0.03, "number_of_epochs": 60, "save_at_every": 25, "max_norm": 5.0, "verbose": False}
    assert model.optimize(points, truth, weights, weights_filename=path, **arguments) is None
    with torch.no_grad():
        after = float(torch.nn.functional.mse_loss(model(points), truth))
    assert after < 0.3 * before
    # Written after epochs 25 and 50 of 60.
    other = volume(20)
    other.load_weights(path)
    assert not torch.equal(other.centers, model.centers)
    assert float((other.centers - model.centers).detach().abs().max()) < 0.1


def test_fit_without_a_file_or_without_epochs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = volume()
    points, truth = ball(4)
    state = {name: value.clone() for name, value in model.state_dict().items()}
    model.optimize(points, truth, ALL_TERMS, number_of_epochs=0)
    assert all(torch.equal(value, state[name]) for name, value in model.state_dict().items())
    model.optimize(points, truth, ALL_TERMS, number_of_epochs=2, verbose=False)
    assert not torch.equal(model.centers, state["centers"])
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="save_at_every"):
        model.optimize(points, truth, {}, save_at_every=0)
    with pytest.raises(ValueError, match="not allowed"):
        model.optimize(points, truth, {}, weights_filename="volume.txt")
    with pytest.raises(FloatingPointError, match="lower the learning rate"):
        model.optimize(points, truth * math.nan, {}, number_of_epochs=1, verbose=False)


@pytest.mark.slow
def test_no_graph_stays_behind():
    model = volume()
    points, truth = ball(4)

    def tensors():
        gc.collect()
        return sum(issubclass(type(thing), torch.Tensor) for thing in gc.get_objects())

    model.optimize(points, truth, ALL_TERMS, number_of_epochs=1, verbose=False)
    before = tensors()
    model.optimize(points, truth, ALL_TERMS, number_of_epochs=5, verbose=False)
    assert tensors() <= before
    assert all(parameter.grad is None or parameter.grad.grad_fn is None for parameter in model.parameters())


def test_files(tmp_path):
    model, other = volume(3), volume(3, seed=1)
    for extension in (".pt", ".pth", ".bin"):
        model.save_weights(tmp_path / f"w{extension}")
        other.initialize_parameters()
        other.train().load_weights(tmp_path / f"w{extension}")
        assert not other.training
        assert all(torch.equal(a, b) for a, b in zip(model.parameters(), other.parameters(), strict=True))
    with pytest.warns(ArgumentWarning, match=r"nothing\.pt"):
        other.load_weights(tmp_path / "nothing.pt")
    other.load_weights(None)
    (tmp_path / "w.pt").write_bytes(b"no weights")
    with pytest.raises(ValueError, match=r"w\.pt"):
        other.load_weights(tmp_path / "w.pt")
