"""U-Nets: the flow through their parts written out, sizes, gradients."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional as F

from odak.learn import models


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


def lively(network):
    """Return the network in float64 with weights that keep signals as large as they are, through all its layers."""
    for parameter in network.double().parameters():
        if parameter.ndim > 1:
            torch.nn.init.kaiming_normal_(parameter, nonlinearity="relu")
    return network


def convolved(x, layer):
    return F.conv2d(x, layer.weight, layer.bias, padding=layer.weight.shape[-1] // 2)


def twice(x, double, activation=F.relu):
    for layer in double.model:
        x = activation(convolved(x, layer.model[0]))
    return x


def test_unet_is_its_steps_down_and_up():
    network = lively(models.unet(depth=2, dimensions=3, input_channels=2, output_channels=4, bias=True))
    x = torch.randn(2, 2, 11, 14, dtype=torch.float64)
    full = twice(x, network.inc)
    half = twice(F.max_pool2d(full, 2), network.downsampling_layers[0].maxpool_conv[1])
    quarter = twice(F.max_pool2d(half, 2), network.downsampling_layers[1].maxpool_conv[1])

    def up(small, large, layer):
        enlarged = F.conv_transpose2d(small, layer.up.weight, layer.up.bias, stride=2)
        dy, dx = large.shape[2] - enlarged.shape[2], large.shape[3] - enlarged.shape[3]
        return twice(torch.cat([large, F.pad(enlarged, (0, dx, 0, dy))], 1), layer.conv)

    result = up(up(quarter, half, network.upsampling_layers[0]), full, network.upsampling_layers[1])
    assert torch.allclose(network(x), convolved(result, network.outc))


@settings(max_examples=15)
@given(depth=st.integers(1, 3), height=st.integers(8, 25), width=st.integers(8, 25), bilinear=st.booleans())
def test_any_size_from_two_to_the_depth_on(depth, height, width, bilinear):
    network = models.unet(depth, 2, 1, 3, bilinear=bilinear)
    assert network(torch.rand(1, 1, height, width)).shape == (1, 3, height, width)


@pytest.mark.parametrize("shape", [(7, 16), (16, 7), (1, 1)])
def test_a_picture_too_small_is_refused(shape):
    with pytest.raises(ValueError, match="x must be at least 8 pixels high and wide for a depth of 3"):
        models.unet(3, 2)(torch.rand(1, 2, *shape))
    assert models.unet(3, 2)(torch.rand(1, 2, 8, 8)).shape == (1, 1, 8, 8)


@pytest.mark.parametrize("options", [{}, {"bilinear": True}, {"normalization": True, "activation": torch.nn.Tanh()}])
def test_pictures_of_a_batch_do_not_meet_and_all_weights_learn(options):
    network = models.unet(2, 4, **options).double().eval()
    x = torch.randn(3, 2, 9, 10, dtype=torch.float64)
    result = network(x)
    assert torch.allclose(result, torch.cat([network(one) for one in x.split(1)]))
    result.square().sum().backward()
    assert all(parameter.grad.abs().max() > 0 for parameter in network.parameters())


def test_the_last_layer_has_no_activation():
    assert models.unet(1, 4)(torch.randn(1, 2, 8, 8)).min() < 0


def kernels_written_out(network, focal, field):
    """Return the factors of the network of depth 3, step by step."""

    def leaky(x):
        return F.leaky_relu(x, 0.2)

    def pool(x, size):
        return F.avg_pool2d(x, size)

    def block(level, parts):
        layers = network.spatially_varying_feature[level][-1]
        x = leaky(convolved(torch.cat(parts, 1), layers[0]))
        return convolved(leaky(convolved(x, layers[2])), layers[4])

    def rise(level, small, large):
        up, double = network.decoder[level]
        enlarged = F.conv_transpose2d(small, up.up.weight, up.up.bias, stride=2)
        dy, dx = large.shape[2] - enlarged.shape[2], large.shape[3] - enlarged.shape[3]
        return twice(F.pad(enlarged, (0, dx, 0, dy)) + large, double, leaky)

    focals = [focal]
    for _ in range(4):
        focals.append(pool(focals[-1], 2))
    o1 = leaky(convolved(torch.cat([focal, field], 1), network.inc.model[0]))
    o2 = pool(o1, 2)
    o3 = twice(o2, network.encoder[1], leaky)
    o4 = pool(o3, 2)
    o5 = twice(o4, network.encoder[3], leaky)
    o6 = pool(o5, 2)
    o7 = twice(o6, network.encoder[5], leaky)
    o8 = pool(o7, 2)
    o9 = network.decoder[0](o8, twice(o8, network.encoder[7], leaky))
    first = block(0, [o9, focals[4], pool(o6, 2), pool(o2, 8), pool(o4, 4)])
    u = rise(1, o9, o7)
    second = block(1, [u, focals[3], pool(o4, 2), pool(o2, 4)])
    u = rise(2, u, o5)
    third = block(2, [u, focals[2], pool(o2, 2)])
    return [first, second, third, block(3, [rise(3, u, o3), focals[1]])]


@pytest.mark.parametrize(("height", "width"), [(32, 16), (37, 41)])
def test_kernel_generation_is_its_steps(height, width):
    network = lively(models.spatially_varying_kernel_generation_model())
    focal = torch.rand(2, 1, height, width, dtype=torch.float64)
    field = torch.randn(2, 6, height, width, dtype=torch.float64)
    kernels = network(focal, field)
    assert [kernel.shape[1] for kernel in kernels] == [576, 288, 144, 72]
    for i, kernel in enumerate(kernels):
        assert kernel.shape == (2, 72 * 2 ** (3 - i), height >> (4 - i), width >> (4 - i))
    for ours, wanted in zip(kernels, kernels_written_out(network, focal, field), strict=True):
        assert torch.allclose(ours, wanted)


def test_adaptive_unet_is_its_steps():
    network = lively(models.spatially_adaptive_unet())
    field = torch.randn(2, 6, 35, 18, dtype=torch.float64)
    sizes = [(17, 9), (8, 4), (4, 2), (2, 1)]
    factors = [torch.randn(2, 72 * 2**i, *sizes[i], dtype=torch.float64) for i in reversed(range(4))]

    def leaky(x):
        return F.leaky_relu(x, 0.2)

    x = leaky(convolved(field, network.inc.model[0]))
    larger = []
    for i in range(4):
        pooled = F.avg_pool2d(x, 2)
        larger.append(x)
        _, double, adaptive = network.encoder[i]
        total = pooled + twice(pooled, double, leaky)
        columns = F.unfold(total, 3, padding=1) * factors[3 - i].flatten(2)
        parts = [columns.sum(1, keepdim=True), adaptive.weight.flatten(1) @ columns]
        x = leaky(torch.cat(parts, 1).unflatten(2, sizes[i]))
    double, module = network.global_feature_module[0]
    x = module(x, twice(x, double, leaky))
    for n in range(4):
        up, join = network.decoder[n]
        large = larger.pop()
        enlarged = F.conv_transpose2d(x, up.up.weight, up.up.bias, stride=2)
        dy, dx = large.shape[2] - enlarged.shape[2], large.shape[3] - enlarged.shape[3]
        x = F.pad(enlarged, (0, dx, 0, dy)) + large
        x = twice(x, join, leaky) if n < 3 else convolved(leaky(convolved(x, join[0].model[0])), join[1].model[0])
    assert torch.allclose(network(factors, field), x)


@pytest.mark.parametrize(("depth", "dimensions"), [(3, 8), (3, 4), (2, 4), (1, 3), (4, 2)])
def test_both_networks_work_together_at_any_depth(depth, dimensions):
    makes = models.spatially_varying_kernel_generation_model(depth, dimensions).double()
    applies = models.spatially_adaptive_unet(depth, dimensions).double()
    focal = torch.rand(2, 1, 37, 41, dtype=torch.float64)
    field = torch.randn(2, 6, 37, 41, dtype=torch.float64)
    result = applies(makes(focal, field), field)
    assert result.shape == field.shape
    alone = [applies(makes(*pair), pair[1]) for pair in zip(focal.split(1), field.split(1), strict=True)]
    assert torch.allclose(result, torch.cat(alone))
    result.square().sum().backward()
    learning = [p for p in makes.parameters() if p.grad is not None]
    assert len(learning) == len(list(makes.parameters()))
    idle = {name for name, parameter in applies.named_parameters() if parameter.grad is None}
    assert idle == {f"encoder.{i}.2.standard_convolution.bias" for i in range(depth + 1)}


def test_one_focal_surface_serves_a_batch():
    network = models.spatially_varying_kernel_generation_model(2, 4)
    focal, field = torch.rand(1, 1, 16, 16), torch.randn(3, 6, 16, 16)
    for one, each in zip(network(focal, field), network(focal.expand(3, -1, -1, -1), field), strict=True):
        assert torch.equal(one, each)


@pytest.mark.parametrize(
    ("focal", "field", "named"),
    [
        ((1, 1, 16, 16), (1, 5, 16, 16), r"field must be \[B, 6, H, W\]"),
        ((1, 1, 15, 16), (1, 6, 15, 16), "H and W of at least 16"),
        ((1, 1, 16, 17), (1, 6, 16, 16), r"focal_surface must be \[1 or 1, 1, 16, 16\]"),
        ((2, 1, 16, 16), (3, 6, 16, 16), r"focal_surface must be \[3 or 1, 1, 16, 16\]"),
    ],
)
def test_shapes_that_do_not_meet_are_named(focal, field, named):
    with pytest.raises(ValueError, match=named):
        models.spatially_varying_kernel_generation_model()(torch.rand(focal), torch.rand(field))


def test_the_number_of_kernels_is_checked():
    with pytest.raises(ValueError, match="sv_kernel must contain 4 tensors, got 3"):
        models.spatially_adaptive_unet()([torch.rand(1, 72, 8, 8)] * 3, torch.rand(1, 6, 16, 16))


@pytest.mark.parametrize("name", ["spatially_varying_kernel_generation_model", "spatially_adaptive_unet"])
def test_networks_around_varying_kernels_refuse_what_cannot_work(name):
    with pytest.raises(ValueError, match="kernel_size must be odd"):
        getattr(models, name)(kernel_size=2)
