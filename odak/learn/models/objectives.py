"""What networks are trained for: a weighed sum of squared and absolute errors."""

from collections.abc import Sequence

import torch

from odak import _validate

REDUCTIONS = ("sum", "mean", "none")


def errors(reduction: str) -> tuple[torch.nn.MSELoss, torch.nn.L1Loss]:
    """Return torch's squared and absolute error with a reduction: "sum", "mean" or "none"."""
    reduction = _validate.one_of("reduction", reduction, REDUCTIONS)
    return torch.nn.MSELoss(reduction=reduction), torch.nn.L1Loss(reduction=reduction)


def weighed_errors(
    l2: torch.nn.MSELoss,
    l1: torch.nn.L1Loss,
    input_data: torch.Tensor,
    ground_truth: torch.Tensor,
    weights: Sequence[float],
) -> torch.Tensor:
    """Return weights[0]·squared error + weights[1]·absolute error.

    Parameters
    ----------
    l2, l1 : torch.nn.Module
        The two errors, from :func:`errors`.
    input_data, ground_truth : torch.Tensor
        Of one shape.
    weights : sequence of float
        Two numbers.

    Raises
    ------
    ValueError
        If the shapes differ, or there are not two weights.
    """
    for name, value in (("input_data", input_data), ("ground_truth", ground_truth)):
        if not isinstance(value, torch.Tensor):
            raise TypeError(f"{name} must be a tensor, got {type(value).__name__}")
    _validate.alike(input_data=input_data, ground_truth=ground_truth)
    if not hasattr(weights, "__len__") or len(weights) != 2:
        raise ValueError(f"weights must be two numbers, squared error first; got {weights!r:.80}")
    weights = _validate.several("weights", weights, 2)
    return weights[0] * l2(input_data, ground_truth) + weights[1] * l1(input_data, ground_truth)
