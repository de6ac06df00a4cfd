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
        "matrix": ("crop_center", "quantize", "zero_pad"),
    },
)
