"""Scalar wave optics in PyTorch: differentiable propagation and computer-generated holograms."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
