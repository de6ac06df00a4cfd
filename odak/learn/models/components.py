"""Activations, layers and blocks that networks are built of.

The state dict of each class is an interface: names, shapes and order stay, so that saved weights load.
"""

from odak.learn.models.activations import (
    film_siren_activation,
    gaussian,
    gaussian_activation,
    siren_activation,
    swish,
    swish_activation,
)
from odak.learn.models.adaptive_layers import spatially_adaptive_convolution, spatially_adaptive_module
from odak.learn.models.attention import (
    channel_gate,
    convolutional_block_attention,
    non_local_layer,
    residual_attention_layer,
    spatial_gate,
)
from odak.learn.models.convolution_layers import (
    convolution_layer,
    double_convolution,
    downsample_layer,
    normalization,
    residual_layer,
    upsample_convtranspose2d_layer,
    upsample_layer,
)
from odak.learn.models.encoding import positional_encoder
from odak.learn.models.global_features import global_feature_module, global_transformations

__all__ = [
    "channel_gate",
    "convolution_layer",
    "convolutional_block_attention",
    "double_convolution",
    "downsample_layer",
    "film_siren_activation",
    "gaussian",
    "gaussian_activation",
    "global_feature_module",
    "global_transformations",
    "non_local_layer",
    "normalization",
    "positional_encoder",
    "residual_attention_layer",
    "residual_layer",
    "siren_activation",
    "spatial_gate",
    "spatially_adaptive_convolution",
    "spatially_adaptive_module",
    "swish",
    "swish_activation",
    "upsample_convtranspose2d_layer",
    "upsample_layer",
]
