"""Instruments of an optical table: protocols of modulators and cameras, simulated twins, and their calibration."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
