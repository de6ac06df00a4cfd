"""Images, matrices and devices for PyTorch tensors."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "device": ("get_device",),
        "file": ("load_image", "resize", "save_image", "save_torch_tensor", "torch_load"),
        "function": ("noll_to_nm", "osa_to_nm", "zernike_norm", "zernike_polynomial"),
        "loss": (
            "histogram_loss",
            "michelson_contrast",
            "multi_scale_total_variation_loss",
            "psnr",
            "radial_basis_function",
            "spatial_gradient",
            "total_variation_loss",
            "weber_contrast",
            "wrapped_mean_squared_error",
        ),
        "mask": ("circular_binary_mask",),
        "matrix": ("blur_gaussian", "crop_center", "generate_2d_gaussian", "quantize", "zero_pad"),
        "transformation": (
            "get_rotation_matrix",
            "point_cloud_to_voxel",
            "quaternion_to_rotation_matrix",
            "rotate_points",
            "rotmatx",
            "rotmaty",
            "rotmatz",
            "tilt_towards",
        ),
        "vector": ("cross_product", "distance_between_two_points", "same_side"),
    },
)
