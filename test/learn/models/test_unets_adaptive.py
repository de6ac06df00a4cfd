"""The convolution whose kernel varies over the picture: loops over pixels, gradients, tied weights, sizes."""

import copy
import pickle

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional as F

from odak.learn import models
from odak.learn.models import unets
from odak.learn.models.unets import modulated_convolution


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


def normal(*shape, dtype=torch.float64):
    return torch.randn(*shape, dtype=dtype)


def factors_of(x, size, stride, padding):
    rows, columns = ((n + 2 * padding - size) // stride + 1 for n in x.shape[-2:])
    return normal(len(x), x.shape[1] * size**2, rows, columns)


def pixel_by_pixel(x, factors, weight, stride, padding):
    """Return the convolution by a loop over the pixels of the result."""
    size = weight.shape[-1]
    padded = F.pad(x, [padding] * 4)
    result = x.new_zeros(len(x), len(weight), *factors.shape[-2:])
    for i in range(factors.shape[2]):
        for j in range(factors.shape[3]):
            top, left = i * stride, j * stride
            window = padded[:, :, top : top + size, left : left + size]
            kernel = weight[None] * factors[:, None, :, i, j].reshape(len(x), 1, *window.shape[1:])
            result[:, :, i, j] = (window[:, None] * kernel).sum((2, 3, 4))
    return result


def unfolded(x, factors, weight, stride, padding):
    """Return the same through an unfolded copy, all of which torch differentiates."""
    columns = F.unfold(x, weight.shape[-1], stride=stride, padding=padding) * factors.flatten(2)
    return (weight.flatten(1) @ columns).unflatten(2, factors.shape[-2:])


OPTIONS = [(3, 1, 1), (3, 2, 1), (2, 1, 0), (5, 3, 2), (1, 1, 0)]


@pytest.mark.parametrize("limit", [1 << 24, 1, 700, 4000])
@pytest.mark.parametrize(("size", "stride", "padding"), OPTIONS)
def test_the_convolution_and_its_gradients_in_parts_of_any_size(size, stride, padding, limit, monkeypatch):
    monkeypatch.setattr(unets, "_CPU_BYTES", limit)
    x, weight = normal(3, 2, 7, 6), normal(4, 2, size, size)
    tensors = [tensor.requires_grad_() for tensor in (x, factors_of(x, size, stride, padding), weight)]
    result = modulated_convolution(*tensors, stride, padding)
    assert torch.allclose(result, pixel_by_pixel(*tensors, stride, padding))
    incoming = torch.randn_like(result)
    wanted = torch.autograd.grad(unfolded(*tensors, stride, padding), tensors, incoming)
    for ours, theirs in zip(torch.autograd.grad(result, tensors, incoming), wanted, strict=True):
        assert torch.allclose(ours, theirs)


@settings(max_examples=30)
@given(
    batch=st.integers(1, 3),
    channels=st.integers(1, 3),
    outputs=st.integers(1, 3),
    height=st.integers(3, 9),
    width=st.integers(3, 9),
    size=st.integers(1, 3),
    stride=st.integers(1, 3),
    padding=st.integers(0, 2),
)
def test_any_shape(batch, channels, outputs, height, width, size, stride, padding):
    x, weight = normal(batch, channels, height, width), normal(outputs, channels, size, size)
    factors = factors_of(x, size, stride, padding)
    assert torch.allclose(
        modulated_convolution(x, factors, weight, stride, padding), unfolded(x, factors, weight, stride, padding)
    )


def test_factors_of_one_leave_a_convolution():
    x, weight = normal(2, 3, 8, 7), normal(4, 3, 3, 3)
    ones = torch.ones(2, 27, 8, 7, dtype=torch.float64)
    assert torch.allclose(modulated_convolution(x, ones, weight, 1, 1), F.conv2d(x, weight, padding=1))


@pytest.mark.parametrize(
    "wanted", [(True, False, False), (False, True, False), (False, False, True), (True, True, True)]
)
def test_gradients_of_those_asked_for(wanted):
    x, weight = normal(2, 2, 3, 3), normal(2, 2, 2, 2)
    tensors = [x, factors_of(x, 2, 1, 1), weight]
    for tensor, needed in zip(tensors, wanted, strict=True):
        tensor.requires_grad_(needed)
    assert torch.autograd.gradcheck(lambda *t: modulated_convolution(*t, 1, 1), tensors, fast_mode=True)


def test_second_gradients():
    x, weight = normal(1, 1, 2, 3), normal(2, 1, 2, 2)
    tensors = [tensor.requires_grad_() for tensor in (x, factors_of(x, 2, 1, 0), weight)]
    assert torch.autograd.gradgradcheck(lambda *t: modulated_convolution(*t, 1, 0), tensors)


def test_second_gradients_where_one_argument_is_made_of_another():
    x, weight = normal(1, 1, 2, 3).requires_grad_(), normal(2, 1, 1, 1).requires_grad_()

    def both(convolution):
        return torch.autograd.grad(convolution(x, x.sin(), weight, 1, 0).square().sum(), [x, weight], create_graph=True)

    ours, wanted = both(modulated_convolution), both(unfolded)
    assert all(torch.allclose(*pair) for pair in zip(ours, wanted, strict=True))
    sums = [sum(gradient.square().sum() for gradient in gradients) for gradients in (ours, wanted)]
    assert torch.allclose(*(torch.autograd.grad(total, x)[0] for total in sums))


def test_transforms_of_functions():
    x, weight = normal(4, 2, 5, 5), normal(3, 2, 3, 3)
    factors = factors_of(x, 3, 1, 1)
    mapped = torch.func.vmap(lambda one, map_: modulated_convolution(one[None], map_[None], weight, 1, 1)[0])
    assert torch.allclose(mapped(x, factors), unfolded(x, factors, weight, 1, 1))
    slope = torch.func.grad(lambda w: modulated_convolution(x, factors, w, 1, 1).square().sum())(weight)
    reference = weight.clone().requires_grad_()
    (wanted,) = torch.autograd.grad(unfolded(x, factors, reference, 1, 1).square().sum(), reference)
    assert torch.allclose(slope, wanted)


@pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning")
def test_forward_mode():
    x, weight = normal(1, 2, 4, 4), normal(3, 2, 3, 3)
    factors, direction = factors_of(x, 3, 1, 1), torch.randn_like(x)
    with torch.autograd.forward_ad.dual_level():
        dual = torch.autograd.forward_ad.make_dual(x, direction)
        slope = torch.autograd.forward_ad.unpack_dual(modulated_convolution(dual, factors, weight, 1, 1)).tangent
    # The convolution is linear in the picture.
    assert torch.allclose(slope, unfolded(direction, factors, weight, 1, 1))


@pytest.mark.slow
def test_compilation():
    layer = models.spatially_adaptive_module()
    x, factors = torch.randn(2, 2, 5, 4), torch.randn(2, 18, 5, 4)
    compiled = torch.compile(layer, backend="aot_eager", fullgraph=True)
    assert torch.allclose(compiled(x, factors), layer(x, factors), atol=1e-5)
    wanted = torch.autograd.grad(layer(x, factors).square().sum(), layer.weight)
    (found,) = torch.autograd.grad(compiled(x, factors).square().sum(), layer.weight)
    assert torch.allclose(found, *wanted, rtol=1e-4)


def test_devices_without_numbers_give_the_shape():
    layer = models.spatially_adaptive_module(2, 4).to("meta")
    assert layer(torch.rand(3, 2, 5, 4, device="meta"), torch.rand(3, 18, 5, 4, device="meta")).shape == (3, 4, 5, 4)


def test_lower_precision_where_autocast_asks_for_it():
    x, weight = normal(1, 2, 6, 6, dtype=torch.float32), normal(3, 2, 3, 3, dtype=torch.float32).requires_grad_()
    factors = factors_of(x, 3, 1, 1).float()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        result = modulated_convolution(x, factors, weight, 1, 1)
    assert result.dtype == torch.bfloat16
    assert torch.allclose(result.float(), unfolded(x, factors, weight, 1, 1), atol=0.3)
    result.float().sum().backward()
    assert weight.grad.dtype == torch.float32


def test_nothing_of_size_of_windows_is_kept_for_backward_pass():
    x, weight = normal(1, 4, 16, 16), normal(3, 4, 3, 3).requires_grad_()
    factors = factors_of(x, 3, 1, 1)
    kept = []
    with torch.autograd.graph.saved_tensors_hooks(lambda t: kept.append(t.data_ptr()) or t, lambda t: t):
        modulated_convolution(x, factors, weight, 1, 1)
    assert set(kept) == {x.data_ptr(), factors.data_ptr(), weight.data_ptr()}


@pytest.mark.parametrize("batch", [1, 3])
@pytest.mark.parametrize(("size", "stride", "padding"), OPTIONS)
def test_spatially_adaptive_convolution(batch, size, stride, padding):
    layer = models.spatially_adaptive_convolution(2, 3, size, stride, padding, bias=True).double()
    x = normal(batch, 2, 6, 6)
    factors = factors_of(x, size, stride, padding)
    # Neither activation nor bias.
    assert torch.allclose(layer(x, factors), pixel_by_pixel(x, factors, layer.weight, stride, padding))


@pytest.mark.parametrize("batch", [1, 3])
def test_spatially_adaptive_module(batch):
    layer = models.spatially_adaptive_module(2, 4, bias=True).double()
    x = normal(batch, 2, 5, 6)
    factors = factors_of(x, 3, 1, 1)
    plain = pixel_by_pixel(x, factors, torch.ones(1, 2, 3, 3, dtype=torch.float64), 1, 1)
    others = pixel_by_pixel(x, factors, layer.weight, 1, 1)
    result = torch.cat([plain, others], 1)
    assert torch.allclose(layer(x, factors), torch.where(result > 0, result, 0.2 * result))
    layer = models.spatially_adaptive_module(2, 4, activation=None).double()
    assert layer(x, factors).min() < 0


def test_module_learns_through_an_activation_in_place():
    layer = models.spatially_adaptive_module(2, 3).double()
    x, factors = normal(2, 2, 3, 3).requires_grad_(), normal(2, 18, 3, 3).requires_grad_()
    assert torch.autograd.gradcheck(layer, (x, factors), fast_mode=True)
    layer(x, factors).sum().backward()
    assert layer.weight.grad.abs().min() > 0


def test_one_map_of_factors_serves_a_batch():
    layer = models.spatially_adaptive_module(2, 3).double()
    x, factors = normal(3, 2, 5, 4), normal(1, 18, 5, 4).requires_grad_()
    result = layer(x, factors)
    assert torch.allclose(result, torch.cat([layer(one, factors) for one in x.split(1)]))
    result.sum().backward()
    assert factors.grad.shape == factors.shape


@pytest.mark.parametrize(("picture", "map_"), [((7, 7), (3, 3)), ((7, 6), (3, 3)), ((6, 3), (3, 1))])
def test_sizes_that_do_not_meet_are_padded_by_what_stride_leaves(picture, map_):
    layer = models.spatially_adaptive_convolution(2, 3, stride=2).double()
    x, factors = normal(2, 2, *picture), normal(2, 18, *map_)
    more = [n % 2 for n in picture]
    wanted = pixel_by_pixel(
        F.pad(x, (0, more[1], 0, more[0])), F.pad(factors, (0, more[1], 0, more[0])), layer.weight, 2, 1
    )
    assert torch.allclose(layer(x, factors), wanted)
    with pytest.raises(ValueError, match=r"a kernel for each of \[3, 3\] pixels, got \[2, 3\]"):
        layer(normal(1, 2, 5, 6), normal(1, 18, 2, 3))


LAYERS = [models.spatially_adaptive_convolution, models.spatially_adaptive_module]


def tied(layer):
    weight, twin = layer.weight, layer.standard_convolution.weight
    names = [name for name, _ in layer.named_parameters()]
    return weight is twin and names.count("weight") == 1 and "standard_convolution.weight" not in names


@pytest.mark.parametrize("make", LAYERS)
def test_weight_is_one_parameter_whatever_happens_to_layer(make):
    layer = make()
    state = {key: value + 1 for key, value in layer.state_dict().items()}
    assert list(state) == ["weight", "standard_convolution.weight"] and tied(layer)
    assert tied(layer.double()) and tied(layer.to(torch.float16)) and tied(layer.float())
    assert tied(copy.deepcopy(layer)) and tied(pickle.loads(pickle.dumps(layer)))
    assert tied(layer.to("meta")) and tied(layer.to_empty(device="cpu"))
    for assign in (False, True):
        layer.load_state_dict(state, assign=assign)
        assert tied(layer) and torch.equal(layer.weight, state["weight"])
    nested = torch.nn.Sequential(make())
    nested.load_state_dict({f"0.{key}": value for key, value in state.items()})
    assert tied(nested[0]) and torch.equal(nested[0].weight, state["weight"])
    assert tied(copy.deepcopy(nested.double())[0])


def test_a_deep_copy_is_tied_to_itself_when_weights_are_loaded():
    layer = models.spatially_adaptive_module()
    twin = copy.deepcopy(layer)
    state = {key: torch.zeros_like(value) for key, value in layer.state_dict().items()}
    twin.load_state_dict(state, assign=True)
    assert tied(twin) and tied(layer) and layer.weight.abs().min() > 0


@pytest.mark.parametrize("make", LAYERS)
def test_of_two_weights_in_a_file_the_trained_one_is_taken(make):
    layer = make(bias=True)
    state = layer.state_dict()
    state["standard_convolution.weight"] = state["weight"] + 1
    wanted = state["weight"].clone()
    layer.load_state_dict(state)
    assert torch.equal(layer.weight, wanted) and not torch.equal(state["standard_convolution.weight"], wanted)


@pytest.mark.parametrize("missing", ["weight", "standard_convolution.weight"])
def test_a_file_may_hold_the_weight_once(missing):
    layer = models.spatially_adaptive_module()
    state = {key: value + 1 for key, value in layer.state_dict().items() if key != missing}
    layer.load_state_dict(state)
    assert torch.equal(layer.weight, *state.values())
    with pytest.raises(RuntimeError, match=r"Missing key.*weight"):
        layer.load_state_dict({})


def test_one_step_moves_the_weight_once():
    layer = models.spatially_adaptive_convolution().double()
    optimizer = torch.optim.SGD(layer.parameters(), lr=1.0)
    x, factors, before = normal(1, 2, 4, 4), normal(1, 18, 4, 4), layer.weight.detach().clone()
    layer(x, factors).sum().backward()
    slope = layer.weight.grad.clone()
    optimizer.step()
    assert torch.allclose(layer.weight, before - slope)


@pytest.mark.parametrize(
    ("picture", "factors", "named"),
    [
        ((2, 3, 4, 4), (2, 18, 4, 4), r"x must be \[B, 2, H, W\]"),
        ((2, 4, 4), (2, 18, 4, 4), r"x must be \[B, 2, H, W\]"),
        ((2, 2, 4, 4), (2, 9, 4, 4), r"sv_kernel_feature must be \[2 or 1, 18, H', W'\]"),
        ((2, 2, 4, 4), (3, 18, 4, 4), r"sv_kernel_feature must be \[2 or 1, 18, H', W'\]"),
        ((2, 2, 4, 4), (2, 18, 4, 5), r"a kernel for each of \[4, 4\] pixels, got \[4, 5\]"),
    ],
)
@pytest.mark.parametrize("make", LAYERS)
def test_shapes_that_do_not_meet_are_named(make, picture, factors, named):
    with pytest.raises(ValueError, match=named):
        make()(torch.rand(picture), torch.rand(factors))


@pytest.mark.cuda
def test_the_weight_stays_one_parameter_on_a_gpu():
    layer = models.spatially_adaptive_module().cuda()
    x, factors = torch.rand(2, 2, 8, 8), torch.rand(2, 18, 8, 8)
    assert tied(layer)
    assert torch.allclose(layer(x.cuda(), factors.cuda()).cpu(), layer.cpu()(x, factors), atol=1e-5)
