"""Visual perception in PyTorch: colour, foveation, metameric losses and measures of image quality."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
