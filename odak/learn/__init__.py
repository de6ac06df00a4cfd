"""The library for PyTorch: differentiable, on any device, with all that needs gradients."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
