"""Lensless sensing: what a bare sensor tells about an object through the speckle that it casts."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, {"models": ("spec_track",)})
