"""Paths of light from the pixels of a display to its images: one module for each kind."""

from odak._lazy import attach

__getattr__, __dir__, _ = attach(__name__, __file__)
