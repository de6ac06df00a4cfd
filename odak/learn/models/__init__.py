"""Networks and their layers in PyTorch: perceptrons, U-Nets, attention, spatially varying kernels, Gaussians."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "components": (
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
        ),
        "gaussians": ("gaussian_2d", "gaussian_3d_volume", "gaussians_2d"),
        "models": (
            "multi_layer_perceptron",
            "spatially_adaptive_unet",
            "spatially_varying_kernel_generation_model",
            "unet",
        ),
        "training": ("TrainingHistory", "train"),
        "weights": ("load_weights", "save_weights"),
    },
)
