import math
import pickle

import pytest
import torch

from odak.learn import models, tools
from odak.learn.tools import PerspectiveCamera, fitcurve, freeze, get_rotation_matrix, multi_layer_perceptron, unfreeze


@pytest.mark.parametrize("shape", [((3, 3), (3,)), ((1, 3, 3), (1, 3))])
def test_camera(shape):
    rotation = get_rotation_matrix([10.0, 20.0, 30.0]).T.reshape(shape[0])
    shift = torch.tensor([1.0, 2.0, 3.0]).reshape(shape[1])
    camera = PerspectiveCamera(rotation, shift, [100, 90], torch.tensor([1, 2]))
    assert camera.focal_length.dtype == torch.float32
    assert camera.principal_point.tolist() == [1, 2]
    centre = camera.get_camera_center()
    assert centre.shape == (1, 3)
    # The camera's place is the point that becomes its origin; lengths from there stay.
    assert torch.allclose(camera.transform_world_to_camera_space(centre), torch.zeros(1, 3), atol=1e-6)
    points = torch.randn(5, 3)
    seen = camera.transform_world_to_camera_space(points)
    assert torch.allclose(seen.norm(dim=1), (points - centre).norm(dim=1), atol=1e-5)
    with pytest.raises(ValueError, match="T must be"):
        PerspectiveCamera(rotation, torch.zeros(2), 1.0, 1.0)


def test_freezing():
    model = multi_layer_perceptron(n_hidden=3)
    freeze(model)
    assert not any(p.requires_grad for p in model.parameters())
    unfreeze(model)
    assert all(p.requires_grad for p in model.parameters())


def test_perceptron_is_its_layers(tmp_path):
    torch.manual_seed(0)
    model = fitcurve.multi_layer_perceptron(2, 5, 3, 2)
    names = ["layers.0", "layers.1.0", "layers.2.0", "layer_final"]
    assert list(model.state_dict()) == [f"{name}.{kind}" for name in names for kind in ("weight", "bias")]
    weights = model.state_dict()
    x = value = torch.randn(4, 2)
    for name in names:
        value = value @ weights[f"{name}.weight"].T + weights[f"{name}.bias"]
        if name in names[1:-1]:
            value = value.clamp(min=0)
    assert torch.allclose(model(x), value, atol=1e-6)
    assert not model.estimate(x).requires_grad
    model.save_weights(tmp_path / "w.pt")
    other = fitcurve.multi_layer_perceptron(2, 5, 3, 2)
    other.load_weights(tmp_path / "w.pt")
    assert torch.equal(other.estimate(x), model.estimate(x))


def test_fit_and_what_it_refuses(tmp_path):
    torch.manual_seed(0)
    model = multi_layer_perceptron(n_hidden=16, n_layers=2)
    x = torch.linspace(0, 1, 50)[:, None]
    y = torch.sin(2 * math.pi * x)
    assert model.fit(x, y, 0, progress=False) is True
    before = (model.estimate(x) - y).square().mean()
    assert model.fit(x, y, 200, 1e-2, progress=False) is True
    assert (model.estimate(x) - y).square().mean() < before / 20
    with pytest.raises(ValueError, match="y_values must be"):
        model.fit(x, y[:, 0], 1, progress=False)
    torch.save(test_freezing, tmp_path / "bad.pt")
    with pytest.raises(pickle.UnpicklingError):
        model.load_weights(tmp_path / "bad.pt")
    with pytest.raises(ValueError, match="not allowed"):
        model.save_weights(tmp_path / "w.txt")


def test_networks_take_what_was_made_in_inference_mode():
    """Autograd cannot save such tensors, and said so from its depths."""
    with torch.inference_mode():
        x = torch.rand(1, 2, 8, 8)
    layer = models.convolution_layer(2, 2, activation=None)
    layer(x).sum().backward()
    convolution = layer.model[0]
    wanted = torch.nn.functional.conv2d(x.clone(), convolution.weight, padding=1)
    assert torch.equal(layer(x), wanted)
    assert convolution.weight.grad.abs().sum() > 0
    with pytest.raises(TypeError, match=r"x must have the (precision|dtype) of the layer, torch\.float32"):
        layer(torch.rand(1, 2, 8, 8, dtype=torch.float64))


def test_camera_and_splines_take_the_wider_of_two_precisions():
    camera = PerspectiveCamera(torch.eye(3), torch.ones(3), [1.0, 1.0], [0.0, 0.0])
    moved = camera.transform_world_to_camera_space(torch.zeros(2, 3, dtype=torch.float64))
    assert moved.dtype == torch.float64 and torch.equal(moved, torch.ones(2, 3, dtype=torch.float64))
    image = torch.rand(8, 8)
    coefficients, basis, _ = tools.decompose_bspline_2d(image, [4, 4])
    wide = tools.compose_bspline_2d(coefficients.double(), basis, [8, 8])
    assert wide.dtype == torch.float64
    assert torch.allclose(wide.float(), tools.compose_bspline_2d(coefficients, basis, [8, 8]), atol=1e-6)


def test_voxels_of_points_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="points must be finite"):
        tools.point_cloud_to_voxel(torch.tensor([[0.0, 0.0, float("nan")], [1.0, 1.0, 1.0]]))
    with pytest.raises(ValueError, match="voxel_size must be three numbers or one, got 2"):
        tools.point_cloud_to_voxel(torch.rand(4, 3), [0.1, 0.1])
    with pytest.raises(ValueError, match=r"cells, got .* points and sizes are in one unit"):
        tools.point_cloud_to_voxel(1000 * torch.eye(3))
