"""Catalogue parts: lenses, detectors and diffusers for ray tracing, and the refractive indices of materials."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
