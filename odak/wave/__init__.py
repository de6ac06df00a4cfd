"""Scalar wave optics: propagation, lenses, gratings, phase retrieval and fields of point sources (NumPy face)."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
