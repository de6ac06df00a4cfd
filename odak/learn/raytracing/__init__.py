"""Differentiable geometric optics on tensors: rays, surfaces, intersections, reflection and refraction."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
