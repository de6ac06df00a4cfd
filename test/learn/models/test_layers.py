"""Convolution layers, steps down and up a scale and global features against compositions of torch's functions."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional as F

from odak.learn import models


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


def picture(*shape, dtype=torch.float64):
    return torch.randn(*shape, dtype=dtype)


def settled(module):
    """Return the module in float64 with batch norms that have seen something, in evaluation mode."""
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


def batch_norm(x, layer):
    """Return what batch normalization does in evaluation mode, by its formula."""
    mean, variance, scale, offset = (
        t[None, :, None, None] for t in (layer.running_mean, layer.running_var, layer.weight, layer.bias)
    )
    return (x - mean) / torch.sqrt(variance + 1e-5) * scale + offset


def test_convolution_layer():
    x = picture(2, 3, 7, 6)
    layer = settled(models.convolution_layer(3, 4, kernel_size=5, bias=True, stride=2, normalization=True))
    convolved = F.conv2d(x, layer.model[0].weight, layer.model[0].bias, stride=2, padding=2)
    assert torch.allclose(layer(x), batch_norm(convolved, layer.model[1]).clamp_min(0))
    assert layer(x).shape == (2, 4, 4, 3)


def test_an_even_kernel_grows_the_picture_by_one():
    assert models.convolution_layer(kernel_size=4)(torch.rand(1, 2, 8, 8)).shape == (1, 2, 9, 9)


def test_double_convolution_and_residual_layer():
    x = picture(2, 3, 7, 6)
    double = settled(models.double_convolution(3, 5, 4, bias=True, activation=torch.nn.Tanh()))
    first, second = (layer.model[0] for layer in double.model)
    middle = F.conv2d(x, first.weight, first.bias, padding=1).tanh()
    assert torch.allclose(double(x), F.conv2d(middle, second.weight, second.bias, padding=1).tanh())

    residual = settled(models.residual_layer(3, 5))
    first, second = (layer.model for layer in residual.convolution.model)
    middle = batch_norm(F.conv2d(x, first[0].weight, padding=1), first[1]).clamp_min(0)
    last = batch_norm(F.conv2d(middle, second[0].weight, padding=1), second[1]).clamp_min(0)
    assert torch.allclose(residual(x), x + last)


def test_the_middle_defaults_to_the_output_channels():
    assert models.double_convolution(3, output_channels=4).model[0].model[0].out_channels == 4


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_normalization_over_channels(dtype):
    layer = models.normalization(4).to(dtype)
    layer.k.data.uniform_(0.5, 2)
    x = picture(2, 4, 5, 3, dtype=dtype) * 0.01
    wanted = F.layer_norm(x.movedim(1, -1), (4,), eps=1e-5).movedim(-1, 1) * layer.k
    assert torch.allclose(layer(x), wanted, atol=1e-6 if dtype == torch.float32 else 1e-12)


def test_downsample_layer():
    x = picture(2, 3, 9, 6)
    layer = settled(models.downsample_layer(3, 4))
    first, second = (inner.model[0].weight for inner in layer.maxpool_conv[1].model)
    pooled = x[..., :8, :].unfold(2, 2, 2).unfold(3, 2, 2).amax((-2, -1))
    assert torch.allclose(layer(x), F.conv2d(F.conv2d(pooled, first, padding=1).relu(), second, padding=1).relu())


def placed(picture, height, width):
    """Return a picture in the middle of a larger one of zeros, or its middle: an odd pixel to the right and below."""
    result = picture.new_zeros(*picture.shape[:2], height, width)
    top, left = (height - picture.shape[2]) // 2, (width - picture.shape[3]) // 2
    for y in range(height):
        for x in range(width):
            if 0 <= y - top < picture.shape[2] and 0 <= x - left < picture.shape[3]:
                result[:, :, y, x] = picture[:, :, y - top, x - left]
    return result


def enlarged_with_aligned_corners(x):
    """Return a picture of twice the size, interpolated between samples of which the outermost coincide."""
    for axis in (2, 3):
        n = x.shape[axis]
        position = torch.arange(2 * n, dtype=x.dtype) * (n - 1) / (2 * n - 1)
        low = position.floor().long().clamp(max=max(n - 2, 0))
        weight = (position - low).reshape((-1, 1) if axis == 2 else (-1,))
        high = (low + 1).clamp(max=n - 1)
        x = x.index_select(axis, low) * (1 - weight) + x.index_select(axis, high) * weight
    return x


SIZES = [(8, 6), (9, 7), (11, 6), (7, 5), (5, 9)]


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_upsample_layer_with_interpolation(height, width):
    x1, x2 = picture(2, 4, 4, 3), picture(2, 3, height, width)
    layer = settled(models.upsample_layer(4, 3))
    first, second = (inner.model[0].weight for inner in layer.conv.model)
    joined = torch.cat([x2, placed(enlarged_with_aligned_corners(x1), height, width)], 1)
    wanted = F.conv2d(F.conv2d(joined, first, padding=1).relu(), second, padding=1).relu()
    assert first.shape == (2, 7, 3, 3) and torch.allclose(layer(x1, x2), wanted)


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_upsample_layer_with_a_transposed_convolution(height, width):
    x1, x2 = picture(2, 4, 4, 3), picture(2, 2, height, width)
    layer = settled(models.upsample_layer(4, 3, bilinear=False))
    first, second = (inner.model[0].weight for inner in layer.conv.model)
    joined = torch.cat([x2, placed(transposed(x1, layer.up, 2), height, width)], 1)
    wanted = F.conv2d(F.conv2d(joined, first, padding=1).relu(), second, padding=1).relu()
    assert torch.allclose(layer(x1, x2), wanted)


def transposed(x, layer, stride):
    """Return a transposed convolution without overlap: each pixel becomes a scaled copy of the kernel."""
    blocks = torch.einsum("bchw,cokl->bohkwl", x, layer.weight)
    result = blocks.reshape(len(x), layer.out_channels, x.shape[2] * stride, x.shape[3] * stride)
    return result if layer.bias is None else result + layer.bias[None, :, None, None]


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("bias", [False, True])
def test_upsample_convtranspose2d_layer(height, width, bias):
    x1, x2 = picture(2, 4, 4, 3), picture(2, 3, height, width)
    layer = settled(models.upsample_convtranspose2d_layer(4, 3, bias=bias))
    assert torch.allclose(layer(x1, x2), placed(transposed(x1, layer.up, 2), height, width) + x2)


@settings(max_examples=25)
@given(h=st.integers(1, 6), w=st.integers(1, 6), height=st.integers(2, 16), width=st.integers(2, 16))
def test_the_larger_picture_gives_the_size(h, w, height, width):
    small = torch.rand(1, 2, h, w)
    assert models.upsample_layer(2, 3)(small, torch.rand(1, 3, height, width)).shape == (1, 3, height, width)
    up = models.upsample_convtranspose2d_layer(2, 3, kernel_size=3, stride=3)
    assert up(small, torch.rand(1, 3, height, width)).shape == (1, 3, height, width)


def leaky(x):
    return torch.where(x > 0, x, 0.2 * x)


def globally_transformed(layer, x1, x2):
    mean = x2.sum((2, 3)) / (x2.shape[2] * x2.shape[3])
    first, second = layer.global_feature_1[0], layer.global_feature_2[0]
    scale = leaky(mean @ first.weight.T + first.bias)
    offset = leaky(scale @ second.weight.T + second.bias)
    return x1 * scale[:, :, None, None] + offset[:, :, None, None]


def test_global_transformations():
    layer = settled(models.global_transformations(3, 4))
    x1, x2 = picture(2, 4, 5, 6), picture(2, 3, 7, 2)
    assert torch.allclose(layer(x1, x2), globally_transformed(layer, x1, x2))


def test_global_feature_module():
    module = settled(models.global_feature_module(3, 2, 3, 3, bias=True))
    x1, x2 = picture(2, 3, 5, 6), picture(2, 3, 7, 4)
    first = module.global_features_1(globally_transformed(module.transformations_1, x1, x2))
    wanted = globally_transformed(module.transformations_2, first, module.global_features_2(first))
    assert torch.allclose(module(x1, x2), wanted)


def double(**options):
    return models.double_convolution(2, 3, 2, **options)


@pytest.mark.parametrize(
    ("module", "shapes"),
    [
        (lambda: models.residual_layer(2, 3, activation=torch.nn.Tanh()), [(1, 2, 4, 3)]),
        (lambda: models.normalization(2), [(1, 2, 4, 3)]),
        (lambda: models.upsample_layer(2, 2, activation=torch.nn.Tanh()), [(1, 2, 2, 2), (1, 2, 5, 3)]),
        (lambda: models.upsample_layer(2, 1, bilinear=False, activation=None), [(1, 2, 2, 2), (1, 1, 3, 5)]),
        (lambda: models.upsample_convtranspose2d_layer(2, 2), [(1, 2, 2, 2), (1, 2, 3, 5)]),
        (lambda: models.global_feature_module(2, 2, 2, 3, activation=torch.nn.Tanh()), [(1, 2, 3, 2), (1, 2, 2, 3)]),
    ],
)
def test_gradients(module, shapes):
    module = settled(module())
    inputs = [picture(*shape).requires_grad_() for shape in shapes]
    assert torch.autograd.gradcheck(module, inputs, fast_mode=True)


@pytest.mark.parametrize(
    ("older", "newer"),
    [
        (
            lambda a: models.convolution_layer(2, 3, 3, True, a),
            lambda a: models.convolution_layer(2, 3, 3, True, activation=a),
        ),
        (
            lambda a: models.double_convolution(2, 4, 3, 3, True, a),
            lambda a: models.double_convolution(2, 4, 3, 3, True, activation=a),
        ),
        (
            lambda a: models.residual_layer(2, 4, 3, True, a),
            lambda a: models.residual_layer(2, 4, 3, True, activation=a),
        ),
        (
            lambda a: models.downsample_layer(2, 4, 3, True, a),
            lambda a: models.downsample_layer(2, 4, 3, True, activation=a),
        ),
        (
            lambda a: models.upsample_layer(4, 2, 3, True, a, False),
            lambda a: models.upsample_layer(4, 2, 3, True, activation=a, bilinear=False),
        ),
        (
            lambda a: models.upsample_layer(4, 2, 3, True, a),
            lambda a: models.upsample_layer(4, 2, 3, True, activation=a),
        ),
    ],
)
def test_the_older_call_form_gives_the_activation_after_the_bias(older, newer):
    activation = torch.nn.Softplus()
    layers = older(activation), newer(activation)
    assert repr(layers[0]) == repr(layers[1])
    assert any(module is activation for module in layers[0].modules())


def test_the_older_call_form_without_activation():
    assert len(models.convolution_layer(2, 2, 3, False, None).model) == 1


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: models.residual_layer(kernel_size=2), "kernel_size must be odd"),
        (lambda: models.upsample_layer(1, 2), "input_channels must be at least 2"),
        (lambda: models.global_feature_module(3, 3, 4, 3), "output_channels must be input_channels"),
    ],
)
def test_what_cannot_work_is_refused_at_construction(make, named):
    with pytest.raises(ValueError, match=named):
        make()


def test_pictures_of_a_batch_do_not_meet():
    x = picture(3, 2, 8, 8)
    for layer in (models.residual_layer(normalization=False), models.downsample_layer(2, 3), models.normalization(2)):
        layer = settled(layer)
        assert torch.allclose(layer(x), torch.cat([layer(one) for one in x.split(1)]))


def test_the_defaults_take_a_small_picture():
    x = torch.rand(1, 2, 32, 32)
    for name in ("residual_layer", "convolution_layer", "double_convolution", "spatial_gate"):
        assert getattr(models, name)()(x).shape == x.shape
    assert models.residual_attention_layer()(x, x).shape == x.shape
    assert models.non_local_layer(2, 1)(x).shape == x.shape
    assert models.downsample_layer(2, 4)(x).shape == (1, 4, 16, 16)
    assert models.upsample_layer(2, 2)(x, torch.rand(1, 2, 64, 64)).shape == (1, 2, 64, 64)
