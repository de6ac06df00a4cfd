"""Things to buy: lenses, detectors and diffusers as ray-traced objects, and the refractive indices of materials."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
