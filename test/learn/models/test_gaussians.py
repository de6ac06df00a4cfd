"""Flat Gaussians against their formula, their sum and its gradients, files, and the fit of a picture."""

import math
import os
import pickle
from importlib.resources import files

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import odak.tools
from odak.learn.models import gaussian_2d, gaussians, gaussians_2d


def grid(height, width, dtype=torch.float64):
    """Return x and y ``[height, width]`` from −1 to 1."""
    y, x = (torch.linspace(-1, 1, n, dtype=dtype) for n in (height, width))
    return torch.meshgrid(x, y, indexing="xy")


def formula(model, x, y):
    """Return the values ``[..., N]`` by the formula, one Gaussian after another."""
    results = []
    for n in range(model.number_of_elements):
        rho, alpha = model.rotations[0, n], model.alphas[0, n]
        u = x * torch.cos(rho) - y * torch.sin(rho) + model.offsets[0, 0, n]
        v = x * torch.sin(rho) + y * torch.cos(rho) + model.offsets[1, 0, n]
        exponent = (u / model.widths[0, 0, n]) ** 2 + (v / model.widths[1, 0, n]) ** 2
        results.append(torch.tanh(alpha * torch.exp(-exponent)))
    return torch.stack(results, dim=-1)


@pytest.mark.parametrize("number", [1, 4])
def test_values_are_the_formula(number):
    model = gaussian_2d(number).double()
    x, y = grid(5, 7)
    expected = formula(model, x, y)
    torch.testing.assert_close(model(x[..., None], y[..., None]), expected)
    torch.testing.assert_close(model(x, y), expected)
    torch.testing.assert_close(model(x.reshape(-1, 1), y.reshape(-1, 1)), expected.reshape(-1, number))
    torch.testing.assert_close(model(x[0], y[0], residual=1.0), expected[0])
    assert model.total(x, y).shape == (5, 7, 1)


def test_parameters_and_their_distributions():
    torch.manual_seed(0)
    model = gaussian_2d(20000)
    expected = {
        # Narrower by √(10/N).
        "widths": ((2, 1, 20000), 0.3 * math.sqrt(5e-4), 0.1 * math.sqrt(5e-4)),
        "offsets": ((2, 1, 20000), 0.0, 0.5),
        "rotations": ((1, 20000), math.pi, math.pi / 2),
        "alphas": ((1, 20000), 0.15, 0.025),
    }
    assert list(dict(model.named_parameters())) == list(expected)
    for name, (shape, mean, deviation) in expected.items():
        parameter = getattr(model, name).detach()
        assert parameter.shape == shape
        assert float(parameter.mean()) == pytest.approx(
            mean, abs=0.03 * (deviation if name == "widths" else max(1, deviation))
        )
        assert float(parameter.std()) == pytest.approx(deviation, rel=0.03)
    before = model.widths
    model.initialize_parameters_uniformly({"widths": (2.0, 2.0)})
    assert model.widths is before
    assert bool((model.widths == 2).all())
    with pytest.raises(ValueError, match=r"ranges must be of widths.*'width'"):
        model.initialize_parameters_uniformly({"width": (0, 1)})
    with pytest.raises(ValueError, match="must ascend"):
        model.initialize_parameters_uniformly({"alphas": (1, 0)})


def test_gradients():
    model = gaussian_2d(3).double()
    x, y = (value[..., None].clone().requires_grad_() for value in grid(3, 4))
    inputs = (x, y, *(parameter.detach().requires_grad_() for parameter in model.parameters()))
    names = [name for name, _ in model.named_parameters()]

    def call(x, y, *parameters):
        return torch.func.functional_call(model, dict(zip(names, parameters, strict=True)), (x, y))

    torch.autograd.gradcheck(call, inputs, fast_mode=True)
    # The sum of many is computed by another algorithm.
    points = torch.stack([x.detach().flatten(), y.detach().flatten()], dim=-1).requires_grad_()
    rows, alphas = torch.randn(5, 6, dtype=torch.float64), torch.randn(5, dtype=torch.float64) * 3
    inputs = (points, rows.requires_grad_(), alphas.requires_grad_())
    torch.autograd.gradcheck(gaussians.sum_of_soft_gaussians, inputs, fast_mode=True)
    torch.autograd.gradgradcheck(gaussians.sum_of_soft_gaussians, inputs, fast_mode=True)


def test_penalty_on_gradient_in_coordinates_is_differentiated():
    model = gaussians_2d(5).double()
    x, y = (value[..., None].clone().requires_grad_() for value in grid(3, 4))
    (slope,) = torch.autograd.grad(model(x, y).sum(), x, create_graph=True)
    assert slope.requires_grad
    step = 1e-6
    with torch.enable_grad():
        sides = [torch.autograd.grad(model(x + side * step, y).sum(), x)[0] for side in (1, -1)]
    (curvature,) = torch.autograd.grad(slope.sum(), x)
    torch.testing.assert_close(curvature, (sides[0] - sides[1]) / (2 * step), rtol=1e-5, atol=1e-7)


@settings(max_examples=20)
@given(st.integers(1, 120), st.integers(1, 40), st.integers(1, 40), st.floats(0.01, 3), st.integers(0, 999))
def test_the_sum_is_the_sum(number, height, width, size, seed):
    torch.manual_seed(seed)
    model = gaussians_2d(number).double()
    with torch.no_grad():
        model.model.widths.mul_(size)
        model.model.alphas.mul_(40)
    x, y = grid(height, width)
    estimate, expected = model(x[..., None], y[..., None]), formula(model.model, x, y).sum(-1, keepdim=True)
    torch.testing.assert_close(estimate, expected, rtol=1e-12, atol=1e-12)
    slope = torch.randn_like(estimate)
    ours = torch.autograd.grad(estimate, tuple(model.parameters()), slope)
    theirs = torch.autograd.grad(expected, tuple(model.parameters()), slope)
    for mine, plain in zip(ours, theirs, strict=True):
        torch.testing.assert_close(mine, plain, rtol=1e-9, atol=1e-9 * float(1 + plain.abs().max()))


def test_points_in_any_order_and_far_gaussians():
    torch.manual_seed(1)
    model = gaussians_2d(200).double()
    with torch.no_grad():
        model.model.widths.fill_(0.01)
        model.model.widths[0, 0, ::3] = -0.02
    points = torch.rand(5000, 2, dtype=torch.float64) * 2 - 1
    x, y = points[:, :1].clone().requires_grad_(), points[:, 1:].clone().requires_grad_()
    estimate, expected = model(x, y), formula(model.model, x[:, 0], y[:, 0]).sum(-1, keepdim=True)
    torch.testing.assert_close(estimate, expected, rtol=0, atol=1e-13)
    slope = torch.randn_like(estimate)
    ours = torch.autograd.grad(estimate, (x, y), slope)
    for mine, plain in zip(ours, torch.autograd.grad(expected, (x, y), slope), strict=True):
        torch.testing.assert_close(mine, plain, rtol=1e-9, atol=1e-9)
    # Most pairs of a point and a Gaussian are never computed.
    rows = torch.zeros(200, 6, dtype=torch.float64)
    rows[:, 0] = rows[:, 4] = 100.0
    rows[:, [2, 5]] = 200 * torch.rand(200, 2, dtype=torch.float64) - 100
    parts = gaussians._parts(points, rows, torch.ones(200, dtype=torch.float64), 1)
    assert sum(len(places) * len(near) for places, near, _ in parts) < 0.35 * 5000 * 200


def test_nan_is_seen():
    model = gaussians_2d(3)
    with torch.no_grad():
        model.model.offsets[0, 0, 1] = math.nan
    x, y = grid(30, 40, torch.float32)
    assert bool(model(x, y).isnan().all())


def test_float32_stays_and_single_points():
    model = gaussians_2d(30)
    x, y = grid(8, 9, torch.float32)
    assert model(x, y).dtype == torch.float32
    assert float((model(x, y) - formula(model.model, x, y).sum(-1, keepdim=True)).detach().abs().max()) < 1e-5
    assert model(torch.zeros(()), torch.zeros(())).shape == (1,)
    assert model(torch.zeros(0, 1), torch.zeros(0, 1)).shape == (0, 1)
    with pytest.raises(TypeError, match="x and y must be real tensors"):
        model(0.0, 0.0)


def test_without_gradients():
    model = gaussians_2d(4)
    x, y = grid(4, 4, torch.float32)
    assert model(x, y).requires_grad
    assert not model(x, y, test=True).requires_grad
    with torch.no_grad():
        assert not model(x, y).requires_grad


def test_memory_does_not_hold_all_pairs():
    model = gaussians_2d(3000)
    x, y = grid(64, 64, torch.float32)
    kept = []
    with torch.autograd.graph.saved_tensors_hooks(lambda t: kept.append(t.numel()) or t, lambda t: t):
        model(x, y)
    assert max(kept) <= 6 * 3000


def test_files(tmp_path, logged):
    model, other = gaussians_2d(6), gaussians_2d(6)
    assert model.total_params == 36
    assert list(model.state_dict()) == [f"model.{name}" for name in ("widths", "offsets", "rotations", "alphas")]
    path = tmp_path / "weights.pt"
    model.save_weights(path)
    other.load_weights(str(path))
    assert logged.text.count(str(path)) == 2
    assert not other.training
    for name, value in model.state_dict().items():
        assert torch.equal(other.state_dict()[name], value)
    other.load_weights()
    with pytest.raises(FileNotFoundError):
        other.load_weights(tmp_path / "nothing.pth")
    with pytest.raises(ValueError, match=r"\.bin"):
        model.save_weights(tmp_path / "weights.bin")
    with pytest.raises(ValueError, match="Path traversal"):
        model.save_weights("../weights.pt")
    with pytest.raises(ValueError, match="of another shape"):
        gaussians_2d(5).load_weights(path)


class _Command:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_broken_and_hostile_files_are_refused(tmp_path):
    model = gaussians_2d(6)
    path = tmp_path / "weights.pt"
    model.save_weights(path)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ValueError, match=r"weights\.pt"):
        model.load_weights(path)
    path.write_bytes(pickle.dumps(_Command(tmp_path / "done")))
    with pytest.raises(ValueError, match=r"weights\.pt"):
        model.load_weights(path)
    torch.save({"model.widths": _Command(tmp_path / "done")}, path)
    with pytest.raises(ValueError, match=r"weights\.pt"):
        model.load_weights(path)
    assert not (tmp_path / "done").exists()


def test_the_sum_does_not_grow_with_the_number():
    torch.manual_seed(0)
    x, y = grid(24, 36, torch.float32)
    means = [float(gaussians_2d(number)(x, y).detach().mean()) for number in (10, 200, 1000)]
    assert all(0.03 < mean < 0.3 for mean in means)


def photo_like(rows=24, columns=36):
    x, y = grid(rows, columns, torch.float32)
    return x, y, 0.4 + 0.3 * torch.sin(5 * x) * torch.cos(4 * y) + 0.2 * (x + y > 0.3)


def test_gaussians_that_start_from_an_image_approximate_it():
    x, y, image = photo_like()
    random, start = gaussians_2d(150), gaussians_2d(150)
    state = torch.get_rng_state()
    start.initialize_from_image(image, seed=3)
    assert torch.equal(torch.get_rng_state(), state)
    errors = [float((model(x, y)[..., 0] - image).square().mean().detach()) for model in (start, random)]
    assert errors[0] < 0.01 < 0.05 < errors[1]
    again = gaussians_2d(150)
    again.initialize_from_image(image, x, y, seed=3)
    assert all(torch.equal(a, b) for a, b in zip(start.parameters(), again.parameters(), strict=True))
    for wrong in (image[0], image[None]):
        with pytest.raises(ValueError, match=r"image must be \[2 or more, 2 or more\]"):
            start.initialize_from_image(wrong)
    with pytest.raises(ValueError, match="must have the same shape"):
        start.initialize_from_image(image, x[1:], y[1:])


def test_more_gaussians_than_pixels_start_too():
    model = gaussians_2d(40)
    model.initialize_from_image(torch.eye(4), seed=0)
    assert all(bool(torch.isfinite(parameter).all()) for parameter in model.parameters())
    gaussians_2d(1).initialize_from_image(torch.eye(4), seed=0)


def decibels(model, x, y, image):
    shown = formula(model.model, x, y).sum(-1).detach().numpy()
    return -10 * math.log10(np.mean((shown - image.numpy()) ** 2))


def test_gaussians_are_refined_at_their_number():
    x, y, image = photo_like()
    model = gaussians_2d(80)
    model.initialize_from_image(image, seed=3)
    # A quarter of them are of no use.
    model.model.offsets.data[..., ::4] = 5.0
    start, count = decibels(model, x, y, image), model.total_params
    state = [value.clone() for value in model.parameters()]
    model.refine(image, moved=0.0, steps=12)
    staying = decibels(model, x, y, image)
    for parameter, value in zip(model.parameters(), state, strict=True):
        parameter.data.copy_(value)
    model.refine(image, x, y, steps=12)
    assert start + 5 < staying < decibels(model, x, y, image) - 2
    assert sum(value.numel() for value in model.parameters()) == count
    for wrong in ({"steps": -1}, {"moved": 1.5}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            model.refine(image, **wrong)


def test_coordinates_of_any_scale_and_direction_start_alike():
    x, y, image = photo_like()
    x, y, image = x.double(), y.double(), image.double()
    turned, plain = gaussians_2d(60).double(), gaussians_2d(60).double()
    plain.initialize_from_image(image, x, y, seed=1)
    turned.initialize_from_image(image, 5 * y + 2, -3 * x, seed=1)
    torch.testing.assert_close(turned(5 * y + 2, -3 * x), plain(x, y), rtol=0, atol=1e-4)


def test_tangents_are_those_of_autograd():
    x, y, image = photo_like(6, 8)
    model, points = gaussian_2d(3).double(), torch.stack([x.flatten(), y.flatten()], dim=-1).double()
    with torch.no_grad():
        model.alphas.fill_(0.7)
        parts, _ = model._tangents(image.double(), points, slice(6))
    (places, near, found), names = parts[0], ("widths", "offsets", "rotations", "alphas")

    def values(*parameters):
        return torch.func.functional_call(
            model, dict(zip(names, parameters, strict=True)), tuple(points[:, :, None].unbind(1))
        )

    given = tuple(getattr(model, name).detach() for name in names)
    exact = torch.autograd.functional.jacobian(lambda *z: values(*z).sum(-1), given)
    scaled = [part.flatten(1, -2) * scale for part, scale in zip(exact, (given[0][:, 0],) * 2 + (1, 1), strict=True)]
    # Values below a thousandth of the height are left out.
    torch.testing.assert_close(
        found, torch.cat(scaled, dim=1)[places][:, :, near].permute(2, 1, 0), rtol=1e-9, atol=1e-2
    )


@pytest.mark.slow
def test_a_thousand_gaussians_of_a_photograph_above_34_db():
    photo = torch.as_tensor(odak.tools.load_image(files("odak") / "assets" / "photo.png")[..., :3] / 255).mean(-1)
    photo = torch.nn.functional.interpolate(photo[None, None].float(), (128, 192), mode="area")[0, 0]
    x, y = grid(128, 192, torch.float32)
    model = gaussians_2d(1000)
    model.initialize_from_image(photo, seed=0)
    assert decibels(model, x, y, photo) > 26.5
    model.refine(photo)
    assert decibels(model, x, y, photo) > 34


@pytest.mark.slow
def test_a_picture_is_fitted():
    torch.manual_seed(0)
    x, y = grid(32, 32, torch.float32)
    picture = 0.5 + 0.4 * torch.sin(4 * x) * torch.cos(3 * y + 1)
    x, y, target = (value.reshape(-1, 1) for value in (x, y, picture))
    model = gaussians_2d(60)
    optimizer = torch.optim.AdamW(model.parameters(), lr=2e-2, weight_decay=0)
    losses = []
    for _ in range(250):
        optimizer.zero_grad()
        loss = torch.nn.functional.mse_loss(model(x, y), target)
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 1e-3
    assert losses[-1] < 0.005 * losses[0]


@pytest.mark.cuda
def test_the_gpu_gives_the_same():
    torch.manual_seed(0)
    model = gaussians_2d(2000)
    x, y = grid(100, 120, torch.float32)
    expected = model(x, y)
    expected.square().sum().backward()
    slopes = [parameter.grad.clone() for parameter in model.parameters()]
    model.cuda().zero_grad()
    result = model(x.cuda(), y.cuda())
    result.square().sum().backward()
    torch.testing.assert_close(result.cpu(), expected, rtol=1e-4, atol=1e-3)
    for parameter, slope in zip(model.parameters(), slopes, strict=True):
        torch.testing.assert_close(parameter.grad.cpu(), slope, rtol=1e-2, atol=1e-3 * float(slope.abs().max()))
