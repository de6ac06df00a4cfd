"""Pictures of fields, rays and surfaces: interactive pages, images, meshes for other programs, and renders."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
