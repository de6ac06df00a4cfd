"""Fits: a line by least squares, any function of one variable by gradient descent, two classes by a perceptron."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "descent": ("gradient_descent_1d",),
        "line": ("least_square_1d",),
        "threshold": ("perceptron", "threshold_linear_model"),
    },
)
