"""Helpers beside optics that earlier versions came with: commands for Blender, texts in LaTeX, language models."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
