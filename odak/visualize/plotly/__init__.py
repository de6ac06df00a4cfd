"""Interactive pictures of fields, surfaces and rays with Plotly, saved as pages, Markdown or images."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
