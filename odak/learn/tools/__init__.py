"""Images, matrices and devices for PyTorch tensors."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
