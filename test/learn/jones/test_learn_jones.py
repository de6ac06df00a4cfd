"""The torch face of Jones calculus: the numbers of NumPy, and gradients."""

import numpy as np
import pytest
import torch

import odak
from odak.learn import jones

CALLS = {
    "polarizer": (25.0,),
    "diattenuator": (0.9, 0.3 + 0.2j, -40.0),
    "retarder": (77.0, 12.0),
    "quarter_wave_plate": (12.0,),
    "half_wave_plate": (-33.0,),
    "rotator": (61.0,),
    "mirror": (0.9 + 0.1j, 0.7),
    "electricfield": (0.3, 0.2 - 1j),
}


def wide(value):
    return torch.tensor(value, dtype=torch.complex128 if isinstance(value, complex) else torch.float64)


@pytest.mark.parametrize("name", sorted(CALLS))
def test_both_faces_agree(name):
    expected = getattr(odak.jones, name)(*CALLS[name])
    tensors = getattr(jones, name)(*map(wide, CALLS[name]))
    assert tensors.dtype == torch.complex128
    np.testing.assert_allclose(tensors.numpy(), expected, atol=1e-14)
    numbers = getattr(jones, name)(*CALLS[name])
    assert isinstance(numbers, torch.Tensor) and numbers.dtype == torch.complex64
    np.testing.assert_allclose(numbers.numpy(), expected, atol=1e-6)
    assert getattr(jones, name)(*CALLS[name], dtype=torch.complex128).dtype == torch.complex128


@pytest.mark.parametrize("name", sorted(CALLS))
def test_gradients_of_elements(name):
    inputs = tuple(wide(value).requires_grad_() for value in CALLS[name])
    assert torch.autograd.gradcheck(getattr(jones, name), inputs, fast_mode=True)
    assert torch.autograd.gradgradcheck(getattr(jones, name), inputs)


def test_gradients_through_a_whole_path():
    torch.manual_seed(3)
    field = torch.randn(2, 3, dtype=torch.complex128, requires_grad=True)
    angle = torch.tensor([10.0, 50.0], dtype=torch.float64, requires_grad=True)

    def path(field, angle):
        out = jones.linearpolarizer(jones.apply_matrix(jones.retarder(70.0, angle), field), 20.0)
        turned = jones.mueller(jones.rotator(angle[0])) @ jones.stokes(out + field)
        ellipse = jones.stokes_ellipse(turned)
        share = jones.degree_of_polarization(turned.sum(-1, keepdim=True))
        return ellipse.azimuth, ellipse.ellipticity, ellipse.major, share, jones.field_from_stokes(turned)

    assert torch.autograd.gradcheck(path, (field, angle), fast_mode=True)


def test_gradients_stay_finite_where_the_ellipse_has_no_angle():
    vector = torch.tensor([[1.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
    vector.requires_grad_()
    ellipse = jones.stokes_ellipse(vector)
    total = sum(item.sum() for item in ellipse) + jones.degree_of_polarization(vector).sum()
    (total + jones.field_from_stokes(vector).abs().square().sum()).backward()
    assert torch.isfinite(vector.grad).all()


def test_plates_are_found_by_their_effect():
    parameters = torch.tensor([60.0, 20.0], dtype=torch.float64, requires_grad=True)
    light = jones.electricfield(1.0, 0.0, dtype=torch.complex128)
    wanted = torch.tensor([1.0, 0.0, 0.0, 1.0], dtype=torch.float64)
    optimizer = torch.optim.LBFGS([parameters], max_iter=100, line_search_fn="strong_wolfe", tolerance_grad=1e-12)

    def misfit():
        optimizer.zero_grad()
        out = jones.apply_matrix(jones.retarder(parameters[0], parameters[1]), light)
        loss = (jones.stokes(out)[:, 0] - wanted).square().sum()
        loss.backward()
        return loss

    for _ in range(5):
        optimizer.step(misfit)
    np.testing.assert_allclose(parameters.detach().numpy(), [90, 45], atol=0.05)


def test_numbers_follow_the_tensors_and_devices():
    assert jones.retarder(torch.tensor(90.0), 45.0).dtype == torch.complex64
    assert jones.retarder(torch.tensor(90.0, dtype=torch.float64), 45.0).dtype == torch.complex128
    assert jones.polarizer(3.0, device=torch.device("meta")).device.type == "meta"
    assert jones.depolarizer(0.5).dtype == torch.float32
    assert jones.circular_polarizer(dtype=torch.complex128).dtype == torch.complex128
    with pytest.raises(TypeError, match=r"dtype must be torch\.complex64"):
        jones.polarizer(3.0, dtype=torch.float32)


def test_numbers_keep_the_digits_of_double_precision():
    angle, retardance = 100 / 3, 200 / 3
    result = jones.retarder(retardance, angle, dtype=torch.complex128).numpy()
    np.testing.assert_allclose(result, odak.jones.retarder(retardance, angle), rtol=0, atol=1e-15)
