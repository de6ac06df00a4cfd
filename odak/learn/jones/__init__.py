"""Polarisation in PyTorch: differentiable Jones and Mueller calculus, by the formulas of :mod:`odak.jones`.

The conventions are the same. Angles, retardances and transmissions may be tensors that require a
gradient. Plain numbers give tensors on `device` in torch's default precision, or in `dtype`.
"""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
