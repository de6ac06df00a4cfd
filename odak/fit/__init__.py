"""Fits: lines by least squares, functions of one variable by gradient descent, classifications by a perceptron."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
