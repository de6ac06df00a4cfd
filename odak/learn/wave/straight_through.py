"""Choices that gradients pass through: the largest of some numbers, as if it were a soft choice."""

from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn._tensors import floating, trainable


class STEFunction(torch.autograd.Function):
    """One-hot choice of the largest entry of each row; backward, the gradient times the softmax of the row.

    Straight-through estimator (Bengio, Léonard and Courville 2013). The softmax multiplies the gradient entry by entry,
    without its Jacobian.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import STEFunction
    >>> STEFunction.apply(torch.tensor([[0.1, 0.7, 0.2]]))
    tensor([[0., 1., 0.]])
    """

    @staticmethod
    def forward(ctx: Any, input: torch.Tensor, temperature: float = 0.001) -> torch.Tensor:
        """Return ones where rows of ``input [n, c]`` are largest (the first of equals), zeros elsewhere."""
        ctx.save_for_backward(input)
        ctx.temperature = temperature
        choice = torch.zeros_like(input).scatter_(1, input.argmax(dim=1, keepdim=True), 1.0)
        # What was no number to compare is none; −∞ masks a choice.
        return choice.masked_fill_(input.isnan() | input.isposinf(), torch.nan)

    @staticmethod
    def backward(ctx: Any, grad_output: torch.Tensor) -> tuple[torch.Tensor, None]:
        """Return the gradient times softmax(input/temperature)."""
        (values,) = ctx.saved_tensors
        return grad_output * torch.softmax(values / ctx.temperature, dim=1), None


class StraightThroughEstimator(nn.Module):
    """One-hot choice of the largest entry of each row, with the gradient of :class:`STEFunction`.

    Parameters
    ----------
    temperature : float
        Softness of the choice that the gradient sees.

    Raises
    ------
    ValueError
        If the temperature is not positive.
    """

    def __init__(self, temperature: float = 0.001):
        super().__init__()
        self.temperature = _validate.real("temperature", temperature, positive=True)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the choices of the rows of ``x [n, c]``, of its dtype."""
        x = floating("x", x)
        if x.ndim != 2 or not x.shape[1]:
            raise ValueError(f"x must be [n, c] with a choice at least, got {tuple(x.shape)}")
        return STEFunction.apply(trainable(x), self.temperature)
