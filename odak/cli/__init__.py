"""Command line of the package, ``odak`` or ``python -m odak``.

Importing this package costs no torch: commands load what they need when they run.
"""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
