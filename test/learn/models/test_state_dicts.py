"""Names, shapes and order of the state dicts, which saved weights rely on; copies, moves and pickles of the modules."""

import copy
import inspect
import io
import itertools
import pickle
import re

import pytest
import torch

from odak.learn import models

UNET = """
inc.model.0.model.0.weight (64,2,3,3); inc.model.1.model.0.weight (64,64,3,3);
downsampling_layers.0.maxpool_conv.1.model.0.model.0.weight (128,64,3,3);
downsampling_layers.0.maxpool_conv.1.model.1.model.0.weight (128,128,3,3);
downsampling_layers.1.maxpool_conv.1.model.0.model.0.weight (256,128,3,3);
downsampling_layers.1.maxpool_conv.1.model.1.model.0.weight (256,256,3,3);
downsampling_layers.2.maxpool_conv.1.model.0.model.0.weight (512,256,3,3);
downsampling_layers.2.maxpool_conv.1.model.1.model.0.weight (512,512,3,3);
downsampling_layers.3.maxpool_conv.1.model.0.model.0.weight (1024,512,3,3);
downsampling_layers.3.maxpool_conv.1.model.1.model.0.weight (1024,1024,3,3);
upsampling_layers.0.up.{w,b} (1024,512,2,2); upsampling_layers.0.conv.model.0.model.0.weight (512,1024,3,3);
upsampling_layers.0.conv.model.1.model.0.weight (512,512,3,3);
upsampling_layers.1.up.{w,b} (512,256,2,2); upsampling_layers.1.conv.model.0.model.0.weight (256,512,3,3);
upsampling_layers.1.conv.model.1.model.0.weight (256,256,3,3);
upsampling_layers.2.up.{w,b} (256,128,2,2); upsampling_layers.2.conv.model.0.model.0.weight (128,256,3,3);
upsampling_layers.2.conv.model.1.model.0.weight (128,128,3,3);
upsampling_layers.3.up.{w,b} (128,64,2,2); upsampling_layers.3.conv.model.0.model.0.weight (64,128,3,3);
upsampling_layers.3.conv.model.1.model.0.weight (64,64,3,3); outc.weight (1,64,3,3)
"""

SMALL_UNET = """
inc.model.0.model.0.weight (4,2,3,3); inc.model.0.model.1 BN(4);
inc.model.1.model.0.weight (4,4,3,3); inc.model.1.model.1 BN(4);
downsampling_layers.0.maxpool_conv.1.model.0.model.0.weight (8,4,3,3);
downsampling_layers.0.maxpool_conv.1.model.0.model.1 BN(8);
downsampling_layers.0.maxpool_conv.1.model.1.model.0.weight (8,8,3,3);
downsampling_layers.0.maxpool_conv.1.model.1.model.1 BN(8);
upsampling_layers.0.up.{w,b} (8,4,2,2);
upsampling_layers.0.conv.model.0.model.0.weight (4,8,3,3); upsampling_layers.0.conv.model.0.model.1 BN(4);
upsampling_layers.0.conv.model.1.model.0.weight (4,4,3,3); upsampling_layers.0.conv.model.1.model.1 BN(4);
outc.weight (1,4,3,3)
"""

KERNELS = """
inc.model.0.{w,b} (8,7,3,3); encoder.1.model.0.model.0.{w,b} (8,8,3,3); encoder.1.model.1.model.0.{w,b} (8,8,3,3);
encoder.3.model.0.model.0.{w,b} (8,8,3,3); encoder.3.model.1.model.0.{w,b} (16,8,3,3);
encoder.5.model.0.model.0.{w,b} (16,16,3,3); encoder.5.model.1.model.0.{w,b} (32,16,3,3);
encoder.7.model.0.model.0.{w,b} (32,32,3,3); encoder.7.model.1.model.0.{w,b} (32,32,3,3);
spatially_varying_feature.0.4.0.{w,b} (32,65,3,3); spatially_varying_feature.0.4.2.{w,b} (32,32,3,3);
spatially_varying_feature.0.4.4.{w,b} (576,32,3,3); spatially_varying_feature.1.3.0.{w,b} (32,33,3,3);
spatially_varying_feature.1.3.2.{w,b} (32,32,3,3); spatially_varying_feature.1.3.4.{w,b} (288,32,3,3);
spatially_varying_feature.2.2.0.{w,b} (32,25,3,3); spatially_varying_feature.2.2.2.{w,b} (32,32,3,3);
spatially_varying_feature.2.2.4.{w,b} (144,32,3,3); spatially_varying_feature.3.1.0.{w,b} (32,9,3,3);
spatially_varying_feature.3.1.2.{w,b} (32,32,3,3); spatially_varying_feature.3.1.4.{w,b} (72,32,3,3);
decoder.0.transformations_1.global_feature_1.0.{w,b} (32,32);
decoder.0.transformations_1.global_feature_2.0.{w,b} (32,32);
decoder.0.global_features_1.model.0.model.0.{w,b} (32,32,3,3);
decoder.0.global_features_1.model.1.model.0.{w,b} (32,32,3,3);
decoder.0.global_features_2.model.0.model.0.{w,b} (32,32,3,3);
decoder.0.global_features_2.model.1.model.0.{w,b} (32,32,3,3);
decoder.0.transformations_2.global_feature_1.0.{w,b} (32,32);
decoder.0.transformations_2.global_feature_2.0.{w,b} (32,32);
decoder.1.0.up.{w,b} (32,32,2,2);
decoder.1.1.model.0.model.0.{w,b} (16,32,3,3); decoder.1.1.model.1.model.0.{w,b} (16,16,3,3);
decoder.2.0.up.{w,b} (16,16,2,2);
decoder.2.1.model.0.model.0.{w,b} (16,16,3,3); decoder.2.1.model.1.model.0.{w,b} (16,16,3,3);
decoder.3.0.up.{w,b} (16,8,2,2);
decoder.3.1.model.0.model.0.{w,b} (8,8,3,3); decoder.3.1.model.1.model.0.{w,b} (8,8,3,3)
"""

ADAPTIVE_UNET = """
inc.model.0.{w,b} (8,6,3,3);
encoder.0.1.model.0.model.0.{w,b} (8,8,3,3); encoder.0.1.model.1.model.0.{w,b} (8,8,3,3);
encoder.0.2.weight (15,8,3,3); encoder.0.2.standard_convolution.{w,b} (15,8,3,3);
encoder.1.1.model.0.model.0.{w,b} (16,16,3,3); encoder.1.1.model.1.model.0.{w,b} (16,16,3,3);
encoder.1.2.weight (31,16,3,3); encoder.1.2.standard_convolution.{w,b} (31,16,3,3);
encoder.2.1.model.0.model.0.{w,b} (32,32,3,3); encoder.2.1.model.1.model.0.{w,b} (32,32,3,3);
encoder.2.2.weight (63,32,3,3); encoder.2.2.standard_convolution.{w,b} (63,32,3,3);
encoder.3.1.model.0.model.0.{w,b} (64,64,3,3); encoder.3.1.model.1.model.0.{w,b} (64,64,3,3);
encoder.3.2.weight (127,64,3,3); encoder.3.2.standard_convolution.{w,b} (127,64,3,3);
global_feature_module.0.0.model.0.model.0.{w,b} (128,128,3,3);
global_feature_module.0.0.model.1.model.0.{w,b} (128,128,3,3);
global_feature_module.0.1.transformations_1.global_feature_1.0.{w,b} (128,128);
global_feature_module.0.1.transformations_1.global_feature_2.0.{w,b} (128,128);
global_feature_module.0.1.global_features_1.model.0.model.0.{w,b} (128,128,3,3);
global_feature_module.0.1.global_features_1.model.1.model.0.{w,b} (128,128,3,3);
global_feature_module.0.1.global_features_2.model.0.model.0.{w,b} (128,128,3,3);
global_feature_module.0.1.global_features_2.model.1.model.0.{w,b} (128,128,3,3);
global_feature_module.0.1.transformations_2.global_feature_1.0.{w,b} (128,128);
global_feature_module.0.1.transformations_2.global_feature_2.0.{w,b} (128,128);
decoder.0.0.up.{w,b} (128,64,2,2);
decoder.0.1.model.0.model.0.{w,b} (64,64,3,3); decoder.0.1.model.1.model.0.{w,b} (64,64,3,3);
decoder.1.0.up.{w,b} (64,32,2,2);
decoder.1.1.model.0.model.0.{w,b} (32,32,3,3); decoder.1.1.model.1.model.0.{w,b} (32,32,3,3);
decoder.2.0.up.{w,b} (32,16,2,2);
decoder.2.1.model.0.model.0.{w,b} (16,16,3,3); decoder.2.1.model.1.model.0.{w,b} (16,16,3,3);
decoder.3.0.up.{w,b} (16,8,2,2); decoder.3.1.0.model.0.{w,b} (8,8,3,3); decoder.3.1.1.model.0.{w,b} (6,8,1,1)
"""

PRELU = torch.nn.PReLU()

# Class, arguments, keys.
TABLE = [
    ("gaussian_activation", {"dim": 5}, "alpha (1,5)"),
    ("swish_activation", {}, ""),
    ("siren_activation", {}, ""),
    ("film_siren_activation", {"dim": 5}, "alpha (2,5)"),
    ("positional_encoder", {"L": 3}, ""),
    ("convolution_layer", {}, "model.0.weight (2,2,3,3)"),
    (
        "convolution_layer",
        {"output_channels": 4, "bias": True, "normalization": True},
        "model.0.{w,b} (4,2,3,3); model.1 BN(4)",
    ),
    ("convolution_layer", {"activation": PRELU}, "model.0.weight (2,2,3,3); model.1.weight (1)"),
    ("double_convolution", {}, "model.0.model.0.weight (2,2,3,3); model.1.model.0.weight (2,2,3,3)"),
    (
        "double_convolution",
        {"activation": PRELU},
        "activation.weight (1); model.0.model.0.weight (2,2,3,3); model.0.model.1.weight (1); "
        "model.1.model.0.weight (2,2,3,3); model.1.model.1.weight (1)",
    ),
    (
        "residual_layer",
        {},
        "convolution.model.0.model.0.weight (16,2,3,3); convolution.model.0.model.1 BN(16); "
        "convolution.model.1.model.0.weight (2,16,3,3); convolution.model.1.model.1 BN(2)",
    ),
    ("normalization", {"dim": 3}, "k (1,3,1,1)"),
    (
        "residual_attention_layer",
        {},
        "convolution0.0.weight (2,2,1,1); convolution0.1 BN(2); convolution1.0.weight (2,2,1,1); convolution1.1 BN(2); "
        "final_layer.1.weight (2,2,1,1)",
    ),
    ("non_local_layer", {}, "g.weight (512,1024,1,1); W_z.0.weight (1024,512,1,1); W_z.1 BN(1024)"),
    (
        "downsample_layer",
        {"input_channels": 2, "output_channels": 3},
        "maxpool_conv.1.model.0.model.0.weight (3,2,3,3); maxpool_conv.1.model.1.model.0.weight (3,3,3,3)",
    ),
    (
        "upsample_layer",
        {"input_channels": 8, "output_channels": 4},
        "conv.model.0.model.0.weight (4,12,3,3); conv.model.1.model.0.weight (4,4,3,3)",
    ),
    (
        "upsample_layer",
        {"input_channels": 8, "output_channels": 4, "bilinear": False},
        "up.{w,b} (8,4,2,2); conv.model.0.model.0.weight (4,8,3,3); conv.model.1.model.0.weight (4,4,3,3)",
    ),
    (
        "channel_gate",
        {"gate_channels": 32},
        "mlp.1.weight (2,32); mlp.1.bias (2); mlp.3.weight (32,2); mlp.3.bias (32)",
    ),
    ("channel_gate", {"gate_channels": 4}, "mlp.1.weight (1,4); mlp.1.bias (1); mlp.3.weight (4,1); mlp.3.bias (4)"),
    ("spatial_gate", {}, "spatial.model.0.weight (1,2,7,7)"),
    (
        "convolutional_block_attention",
        {"gate_channels": 32},
        "channel_gate.mlp.1.weight (2,32); channel_gate.mlp.1.bias (2); channel_gate.mlp.3.weight (32,2); "
        "channel_gate.mlp.3.bias (32); spatial_gate.spatial.model.0.weight (1,2,7,7)",
    ),
    ("upsample_convtranspose2d_layer", {"input_channels": 4, "output_channels": 2}, "up.weight (4,2,2,2)"),
    (
        "global_transformations",
        {"input_channels": 3, "output_channels": 2},
        "global_feature_1.0.weight (2,3); global_feature_1.0.bias (2); global_feature_2.0.weight (2,2); "
        "global_feature_2.0.bias (2)",
    ),
    (
        "global_feature_module",
        {"input_channels": 3, "mid_channels": 2, "output_channels": 3, "kernel_size": 3},
        "transformations_1.global_feature_1.0.{w,b} (3,3); transformations_1.global_feature_2.0.{w,b} (3,3); "
        "global_features_1.model.0.model.0.weight (2,3,3,3); global_features_1.model.1.model.0.weight (3,2,3,3); "
        "global_features_2.model.0.model.0.weight (2,3,3,3); global_features_2.model.1.model.0.weight (3,2,3,3); "
        "transformations_2.global_feature_1.0.{w,b} (3,3); transformations_2.global_feature_2.0.{w,b} (3,3)",
    ),
    ("spatially_adaptive_convolution", {}, "weight (2,2,3,3); standard_convolution.weight (2,2,3,3)"),
    (
        "spatially_adaptive_module",
        {"output_channels": 4, "bias": True},
        "weight (3,2,3,3); standard_convolution.{w,b} (3,2,3,3)",
    ),
    (
        "multi_layer_perceptron",
        {"dimensions": [2, 8, 8, 3], "bias": True, "input_multiplier": 2.0},
        "input_multiplier (1,2); model.0.{w,b} (8,2); model.2.{w,b} (8,8); model.4.{w,b} (3,8)",
    ),
    (
        "multi_layer_perceptron",
        {"dimensions": [2, 8, 8, 3], "model_type": "SIREN"},
        "model.0.weight (8,2); model.2.weight (8,8); model.4.weight (3,8)",
    ),
    (
        "multi_layer_perceptron",
        {"dimensions": [2, 8, 8, 3], "model_type": "FILM SIREN"},
        "model.0.weight (8,2); model.1.alpha (2,8); model.2.weight (8,8); model.3.alpha (2,8); model.4.weight (3,8)",
    ),
    (
        "multi_layer_perceptron",
        {"dimensions": [2, 8, 8, 3], "model_type": "Gaussian"},
        "model.0.weight (8,2); model.1.alpha (1,8); model.2.weight (8,8); model.3.alpha (1,8); model.4.weight (3,8)",
    ),
    (
        "multi_layer_perceptron",
        {"dimensions": [2, 8, 3], "activation": PRELU},
        "model.0.weight (8,2); model.1.weight (1); model.2.weight (3,8)",
    ),
    ("unet", {}, UNET),
    ("unet", {"depth": 1, "dimensions": 4, "normalization": True}, SMALL_UNET),
    (
        "unet",
        {"depth": 1, "dimensions": 4, "bilinear": True},
        re.sub(r"[^;]*(BN|\.up\.)[^;]*;", "", SMALL_UNET).replace("(4,8,3,3)", "(4,12,3,3)"),
    ),
    ("spatially_varying_kernel_generation_model", {}, KERNELS),
    ("spatially_adaptive_unet", {}, ADAPTIVE_UNET),
]


def expected(keys: str) -> list[tuple[str, tuple[int, ...]]]:
    """Return names and shapes; ``{w,b}`` stands for a weight and a bias, ``BN(c)`` for a batch norm of c channels."""
    found = []
    for entry in filter(None, (entry.strip() for entry in keys.split(";"))):
        name, _, form = entry.partition(" ")
        shape = tuple(int(n) for n in form.removeprefix("BN").strip("()").split(","))
        if form.startswith("BN"):
            found += [(f"{name}.{part}", shape) for part in ("weight", "bias", "running_mean", "running_var")]
            found.append((f"{name}.num_batches_tracked", ()))
        elif name.endswith("{w,b}"):
            stem = name.removesuffix("{w,b}")
            found += [(f"{stem}weight", shape), (f"{stem}bias", (shape[1 if stem.endswith("up.") else 0],))]
        else:
            found.append((name, shape))
    return found


@pytest.mark.parametrize(("name", "arguments", "keys"), TABLE)
def test_names_shapes_and_order(name, arguments, keys):
    state = getattr(models, name)(**copy.deepcopy(arguments)).state_dict()
    assert [(key, tuple(value.shape)) for key, value in state.items()] == expected(keys)
    assert all(
        value.dtype == (torch.int64 if key.endswith("num_batches_tracked") else torch.float32)
        for key, value in state.items()
    )


def test_parameters_of_the_default_unet():
    assert sum(parameter.numel() for parameter in models.unet().parameters()) == 31_025_792


def test_weights_of_the_two_networks_around_varying_kernels():
    networks = models.spatially_varying_kernel_generation_model(), models.spatially_adaptive_unet()
    assert sum(value.numel() for network in networks for value in network.state_dict().values()) == 1_861_138
    # Of those, the four weights of the adaptive modules stand twice.
    twice = sum(9 * n * (2 * n - 1) for n in (8, 16, 32, 64))
    assert sum(value.numel() for network in networks for value in network.parameters()) == 1_861_138 - twice


NORMALIZED = {
    name: arguments
    for name, arguments, _ in TABLE
    if "normalization" in inspect.signature(getattr(models, name)).parameters and arguments.get("activation") is None
}


@pytest.mark.parametrize("name", NORMALIZED)
def test_normalization_follows_each_convolution(name):
    arguments = {**NORMALIZED[name], "normalization": True}
    state = getattr(models, name)(**arguments).state_dict()
    statistics = [key for key in state if key.endswith("running_mean")]
    assert statistics and all(key.endswith("model.1.running_mean") for key in statistics)
    plain = getattr(models, name)(**{**arguments, "normalization": False}).state_dict()
    added = [key for key in state if key not in plain]
    assert added == [key for key in state if ".".join(key.split(".")[:-1]) + ".running_mean" in statistics]


SMALL = [entry for entry in TABLE if entry[0] not in ("unet", "non_local_layer")]


@pytest.mark.parametrize(("name", "arguments", "_keys"), SMALL)
def test_copies_pickles_and_files_keep_all_values(name, arguments, _keys):
    module = getattr(models, name)(**copy.deepcopy(arguments)).double()
    stream = io.BytesIO()
    torch.save(module.state_dict(), stream)
    stream.seek(0)
    fresh = getattr(models, name)(**copy.deepcopy(arguments)).double()
    fresh.load_state_dict(torch.load(stream, weights_only=True))
    for other in (copy.deepcopy(module), pickle.loads(pickle.dumps(module)), fresh):
        assert list(other.state_dict()) == list(module.state_dict())
        assert all(torch.equal(value, other.state_dict()[key]) for key, value in module.state_dict().items())
        mine, theirs = {id(p) for p in module.parameters()}, {id(p) for p in other.parameters()}
        assert len(mine) == len(theirs) and not mine & theirs
        assert all(value.dtype == torch.float64 for value in other.parameters())


def test_a_shared_activation_stays_one_parameter():
    activation = torch.nn.PReLU()
    layer = models.residual_layer(activation=activation)
    held = [key for key, value in layer.state_dict().items() if value.data_ptr() == activation.weight.data_ptr()]
    assert held == [
        "activation.weight",
        "convolution.activation.weight",
        "convolution.model.0.model.2.weight",
        "convolution.model.1.model.2.weight",
    ]
    gate = models.residual_attention_layer(activation=activation)
    assert [key for key in gate.state_dict() if gate.state_dict()[key].data_ptr() == activation.weight.data_ptr()] == [
        "activation.weight",
        "final_layer.0.weight",
    ]


def test_a_perceptron_copies_its_activation_for_each_layer():
    activation = torch.nn.PReLU()
    network = models.multi_layer_perceptron([2, 4, 4, 1], activation=activation)
    held = [network.model[1].weight, network.model[3].weight, activation.weight]
    assert all(one is not other for one, other in itertools.combinations(held, 2))
