"""Lensless sensing: estimation of the pose of an object from the speckle that it casts on a bare sensor."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
