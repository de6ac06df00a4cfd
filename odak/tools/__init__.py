"""Files, images, matrices and conversions on NumPy arrays."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "conversions": ("convert_to_numpy", "convert_to_torch"),
        "file": (
            "check_directory",
            "convert_bytes",
            "copy_file",
            "expanduser",
            "get_base_filename",
            "list_directories",
            "list_files",
            "load_dictionary",
            "load_image",
            "read_text_file",
            "resize_image",
            "save_dictionary",
            "save_image",
            "shell_command",
            "size_of_a_file",
            "validate_cwd",
            "validate_path",
            "validate_shell_command",
            "write_to_text_file",
        ),
        "matrix": ("blur_gaussian", "crop_center", "generate_2d_gaussian", "quantize", "zero_pad"),
        "transformation": ("rotate_point", "rotate_points", "rotmatx", "rotmaty", "rotmatz", "tilt_towards"),
        "vector": (
            "closest_point_to_a_ray",
            "cross_product",
            "distance_between_point_clouds",
            "distance_between_two_points",
            "point_to_ray_distance",
            "same_side",
        ),
        "zernike": ("noll_to_nm", "osa_to_nm", "zernike_norm", "zernike_polynomial"),
    },
)
