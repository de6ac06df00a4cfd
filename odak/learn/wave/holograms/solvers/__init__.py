"""Solvers of problems of holograms: one module for each kind."""

from odak._lazy import attach

# The names belong to odak.learn.wave, which lists them.
__getattr__, __dir__, _ = attach(__name__, __file__)
