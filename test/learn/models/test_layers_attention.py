"""Attention layers against their formulas, written out."""

import math

import pytest
import torch
from torch.nn import functional as F

from odak.learn import models
from odak.learn.models import layers


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


def picture(*shape):
    return torch.randn(*shape, dtype=torch.float64)


def settled(module):
    module = module.double().eval()
    for layer in module.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            for tensor, low in (
                (layer.running_mean, -1),
                (layer.running_var, 0.5),
                (layer.weight, 0.5),
                (layer.bias, -1),
            ):
                tensor.data.uniform_(low, low + 1)
    return module


@pytest.mark.parametrize("output_channels", [1, 3])
def test_residual_attention_layer(output_channels):
    layer = settled(models.residual_attention_layer(3, output_channels, kernel_size=3, bias=True))
    x0, x1 = picture(2, 3, 5, 4), picture(2, 3, 5, 4)
    total = 0
    for x, (convolution, norm) in ((x0, layer.convolution0), (x1, layer.convolution1)):
        mean, variance, scale, offset = (
            t[None, :, None, None] for t in (norm.running_mean, norm.running_var, norm.weight, norm.bias)
        )
        y = F.conv2d(x, convolution.weight, convolution.bias, padding=1)
        total = total + (y - mean) / torch.sqrt(variance + 1e-5) * scale + offset
    weights = F.conv2d(total.clamp_min(0), layer.final_layer[1].weight, layer.final_layer[1].bias, padding=1)
    assert torch.allclose(layer(x0, x1), weights * x0)


def test_residual_attention_layer_without_activation():
    assert len(models.residual_attention_layer(activation=None).final_layer) == 1


@pytest.mark.parametrize("output_channels", [2, 4])
def test_weights_that_cannot_multiply_the_picture_are_refused(output_channels):
    with pytest.raises(ValueError, match=r"output_channels must be 1 or input_channels \(3\)"):
        models.residual_attention_layer(3, output_channels)


def non_local(layer, x):
    """Return the layer's output by sums over pairs of pixels."""
    batch, _, height, width = x.shape
    pixels = [(i, j) for i in range(height) for j in range(width)]
    g = layer.g(x)
    mean = torch.zeros_like(g)
    for b in range(batch):
        for i, j in pixels:
            scores = [float(x[b, :, i, j] @ x[b, :, k, m]) / len(pixels) for k, m in pixels]
            weights = [math.exp(score) for score in scores]
            for weight, (k, m) in zip(weights, pixels, strict=True):
                mean[b, :, i, j] += weight / sum(weights) * g[b, :, k, m]
    return layer.W_z(mean) + x


@pytest.mark.parametrize(("channels", "bottleneck"), [(3, 2), (2, 5), (4, 1)])
@pytest.mark.parametrize("rows", [None, 5])
def test_non_local_layer(channels, bottleneck, rows, monkeypatch):
    layer = settled(models.non_local_layer(channels, bottleneck))
    x = 2 * picture(2, channels, 4, 3)
    if rows:
        monkeypatch.setattr(layers, "_SCORE_BYTES", rows * 2 * 12 * 8)
    assert torch.allclose(layer(x), non_local(layer, x))


def test_non_local_layer_in_parts_has_the_same_gradients(monkeypatch):
    layer = settled(models.non_local_layer(3, 2))
    x = picture(2, 3, 2, 3).requires_grad_()
    inputs = [x, *layer.parameters()]
    whole = torch.autograd.grad(layer(x).square().sum(), inputs)
    monkeypatch.setattr(layers, "_SCORE_BYTES", 4 * 2 * 6 * 8)
    parts = torch.autograd.grad(layer(x).square().sum(), inputs)
    assert all(torch.allclose(*pair) for pair in zip(whole, parts, strict=True))
    assert torch.autograd.gradcheck(layer, (x,), fast_mode=True)


def test_an_untrained_non_local_layer_changes_nothing():
    x = torch.randn(2, 4, 6, 5)
    for training in (True, False):
        assert torch.equal(models.non_local_layer(4, 2).train(training)(x), x)


@pytest.mark.parametrize("pools", [["avg"], ["max"], ["avg", "max"], ("max", "avg")])
def test_channel_gate(pools):
    gate = models.channel_gate(4, reduction_ratio=2, pool_types=pools).double()
    x = picture(2, 4, 5, 3)
    first, second = gate.mlp[1], gate.mlp[3]
    scores = torch.zeros(2, 4, dtype=torch.float64)
    for pool in pools:
        pixels = [x[:, :, i, j] for i in range(5) for j in range(3)]
        pooled = sum(pixels) / 15 if pool == "avg" else torch.stack(pixels).max(0).values
        scores += (pooled @ first.weight.T + first.bias).clamp_min(0) @ second.weight.T + second.bias
    assert torch.allclose(gate(x), x / (1 + torch.exp(-scores))[:, :, None, None])


def test_spatial_gate():
    gate = models.spatial_gate().double()
    x = picture(2, 4, 9, 8)
    pooled = torch.stack([x.max(1).values, x.sum(1) / 4], 1)
    assert torch.allclose(gate.channel_pool(x), pooled)
    scores = F.conv2d(pooled, gate.spatial.model[0].weight, padding=3)
    assert torch.allclose(gate(x), x / (1 + torch.exp(-scores)))


def test_block_attention_is_channel_gate_and_then_spatial_one():
    x = picture(2, 4, 9, 8)
    both = models.convolutional_block_attention(4, 2).double()
    assert torch.allclose(both(x), both.spatial_gate(both.channel_gate(x)))
    one = models.convolutional_block_attention(4, 2, no_spatial=True).double()
    assert torch.equal(one(x), one.channel_gate(x))
    assert not hasattr(one, "spatial_gate")
    x = torch.rand(1, 32, 256, 256)
    assert models.convolutional_block_attention(32)(x).shape == x.shape


def test_flatten_is_public():
    assert models.convolutional_block_attention.Flatten()(torch.rand(2, 3, 4, 5)).shape == (2, 60)


def test_gradients():
    x = picture(1, 4, 3, 2).requires_grad_()
    assert torch.autograd.gradcheck(models.convolutional_block_attention(4, 2).double(), (x,), fast_mode=True)
    layer = settled(models.residual_attention_layer(4, 1, activation=torch.nn.Tanh()))
    assert torch.autograd.gradcheck(layer, (x, picture(1, 4, 3, 2).requires_grad_()), fast_mode=True)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: models.channel_gate(4, pool_types=["lse"]), "pool_types must be one of 'avg', 'max'; got 'lse'"),
        (lambda: models.channel_gate(4, pool_types=[]), "pool_types must name at least one"),
        (lambda: models.non_local_layer(2, 1, kernel_size=2), "kernel_size must be odd"),
        (lambda: models.residual_attention_layer(kernel_size=2), "kernel_size must be odd"),
    ],
)
def test_what_cannot_work_is_refused_at_construction(make, named):
    with pytest.raises(ValueError, match=named):
        make()


def test_pictures_of_a_batch_do_not_meet():
    x = picture(3, 4, 5, 6)
    for layer in (settled(models.non_local_layer(4, 2)), models.convolutional_block_attention(4).double()):
        assert torch.allclose(layer(x), torch.cat([layer(one) for one in x.split(1)]))
