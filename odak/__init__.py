"""Differentiable optics: wave optics, holography, ray tracing, polarisation and perception.

``odak`` holds the NumPy core; ``odak.learn`` is its PyTorch face. Subpackages load on first use, so that
``import odak`` itself takes almost no time.
"""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
