"""Image quality from pictures of edges: line spread, modulation transfer, ISO 12233 slanted edges."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
