"""Instruments of an optical table: protocols of modulators and cameras, a simulated table, and calibrations."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
