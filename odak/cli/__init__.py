"""Command line of the package, ``odak`` or ``python -m odak``.

Importing this package does not import torch: commands import what they need when they run.
"""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
