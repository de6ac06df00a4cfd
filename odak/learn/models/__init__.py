"""Networks and their layers in PyTorch: perceptrons, U-Nets, attention, spatially varying kernels, Gaussians."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
