"""Networks: perceptrons, U-Nets, and kernels that vary over the picture.

The state dict of each class is an interface: names, shapes and order stay, so that saved weights load.
"""

from odak.learn.models.adaptive_unets import spatially_adaptive_unet, spatially_varying_kernel_generation_model
from odak.learn.models.perceptron import multi_layer_perceptron
from odak.learn.models.unets import unet

__all__ = [
    "multi_layer_perceptron",
    "spatially_adaptive_unet",
    "spatially_varying_kernel_generation_model",
    "unet",
]
