"""Activations and the positional encoding against their formulas."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn import models


@pytest.fixture
def x():
    return torch.randn(7, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def element_by_element(function, x):
    values = [[function(float(value), column) for column, value in enumerate(row)] for row in x]
    return torch.tensor(values, dtype=torch.float64)


def test_gaussian(x):
    assert torch.allclose(models.gaussian(x, 1.7), element_by_element(lambda v, _: math.exp(-((1.7 * v) ** 2)), x))
    assert torch.equal(models.gaussian(x), models.gaussian(x, 1.0))


def test_gaussian_activation_has_a_width_per_feature(x):
    layer = models.gaussian_activation(3).double()
    layer.alpha.data = torch.tensor([[0.5, 1.0, -2.0]], dtype=torch.float64)
    widths = [0.5, 1.0, 2.0]
    assert torch.allclose(layer(x), element_by_element(lambda v, n: math.exp(-((widths[n] * v) ** 2)), x))
    assert torch.autograd.gradcheck(layer, (x.requires_grad_(),), fast_mode=True)


def test_swish(x):
    wanted = element_by_element(lambda v, _: v / (1 + math.exp(-v)), x)
    assert torch.allclose(models.swish(x), wanted)
    assert torch.allclose(models.swish_activation()(x), wanted)


def test_siren_activation(x):
    layer = models.siren_activation(2.5)
    assert layer.multiplier == 2.5
    assert torch.allclose(layer(x), element_by_element(lambda v, _: math.sin(2.5 * v), x))
    assert torch.equal(models.siren_activation()(x), x.sin())


def test_film_siren_has_a_frequency_and_a_phase_per_feature(x):
    layer = models.film_siren_activation(3).double()
    a, b = layer.alpha.detach().tolist()
    assert torch.allclose(layer(x), element_by_element(lambda v, n: math.sin(a[n] * v + b[n]), x))
    assert torch.autograd.gradcheck(layer, (x.requires_grad_(),), fast_mode=True)


@pytest.mark.parametrize("layer", [models.gaussian_activation, models.film_siren_activation])
def test_learned_activations_start_from_a_standard_normal(layer):
    torch.manual_seed(1)
    alpha = layer(4000).alpha.detach()
    assert abs(alpha.mean()) < 0.06 and abs(alpha.std() - 1) < 0.04


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_activations_keep_the_dtype(dtype):
    x = torch.rand(4, 3, dtype=dtype)
    for layer in (models.swish_activation(), models.siren_activation(30.0)):
        assert layer(x).dtype == dtype
    for layer in (models.gaussian_activation(3), models.film_siren_activation(3)):
        assert layer.to(dtype)(x).dtype == dtype


@settings(max_examples=20)
@given(rows=st.integers(1, 4), features=st.integers(1, 4), octaves=st.integers(1, 70))
def test_positional_encoding(rows, features, octaves):
    x = torch.rand(rows, features, dtype=torch.float64) - 0.5
    encoded = models.positional_encoder(octaves)(x)
    assert encoded.shape == (rows, features + 2 * features * octaves)
    for row, coordinates in zip(encoded.tolist(), x.tolist(), strict=True):
        phases = [coordinate * 2.0**octave for coordinate in coordinates for octave in range(octaves)]
        wanted = [*coordinates, *(math.cos(phase) for phase in phases), *(math.sin(phase) for phase in phases)]
        assert row == pytest.approx(wanted, abs=1e-14)


@pytest.mark.parametrize("octaves", [4, 50, 64, 65, 200])
def test_positional_encoding_of_float32_is_that_of_same_numbers(octaves):
    x = torch.rand(5, 2, generator=torch.Generator().manual_seed(0))
    encoded = models.positional_encoder(octaves)(x)
    assert encoded.dtype == torch.float32
    phases = (x.double()[..., None] * 2.0 ** torch.arange(octaves, dtype=torch.float64)).flatten(1)
    assert torch.allclose(encoded[:, 2:], torch.cat([phases.cos(), phases.sin()], 1).float(), atol=2e-7)


def test_positional_encoding_of_many_axes_and_of_integers():
    encoder = models.positional_encoder(3)
    x = torch.rand(2, 3, 4, 2)
    assert torch.equal(encoder(x), encoder(x.flatten(0, 2)).unflatten(0, (2, 3, 4)))
    assert torch.equal(encoder(torch.tensor([[1, 2]])), encoder(torch.tensor([[1.0, 2.0]])))


def test_positional_encoding_is_differentiable():
    x = torch.rand(3, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(models.positional_encoder(4), (x,), fast_mode=True)


def test_positional_encoder_names_the_largest_number_of_octaves():
    with pytest.raises(ValueError, match="L must be"):
        models.positional_encoder(1001)
