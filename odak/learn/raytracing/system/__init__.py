"""Sequential optical systems: lenses and mirrors in a row, traced, analysed, optimised and toleranced as tensors."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
