"""Files, images, matrices and conversions on NumPy arrays."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
