import math
import pickle

import pytest
import torch

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
