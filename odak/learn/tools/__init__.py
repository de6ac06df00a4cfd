"""Images, matrices and devices for PyTorch tensors."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "device": ("get_device",),
        "file": ("load_image", "resize", "save_image", "save_torch_tensor", "torch_load"),
        "matrix": ("crop_center", "quantize", "zero_pad"),
    },
)
