"""Scalar wave optics: propagation, lenses, gratings, phase retrieval and point sources, for arrays of any library."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
