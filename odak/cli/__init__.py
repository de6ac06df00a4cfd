"""The command line: ``odak hologram`` and ``odak info``, also as ``python -m odak``.

Importing this package costs no torch: commands load what they need when they run.
"""

from odak.cli.app import app, main

__all__ = ["app", "main"]
