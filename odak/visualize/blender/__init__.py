"""Rays, meshes, surfaces and lenses drawn and rendered in Blender, by commands from Python alone."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
