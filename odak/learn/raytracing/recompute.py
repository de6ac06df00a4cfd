"""Block-wise evaluation with gradients that keeps only arguments: the backward pass computes each block again."""

from collections.abc import Callable, Sequence
from typing import Any

import torch

from odak._torch_private import is_transformed
from odak.raytracing import batches


def in_pieces(function: Callable, ranks: Sequence[int], *tensors: torch.Tensor, size: int | None = None):
    """Return ``function(*tensors)`` with little memory, whether gradients are required or not.

    Small batches keep their graph, as do forward mode, torch.func and torch.compile. Of a large one only the arguments
    are saved, and the backward pass runs through `function` again.

    Parameters
    ----------
    function, ranks
        As in :func:`odak.raytracing.batches.in_pieces`.
    *tensors : torch.Tensor
        The arguments.
    size : int, optional
        Elements of a piece; by default as many as suit the cache.
    """
    if not batches.needs_gradient(*tensors):
        return batches.in_pieces(function, ranks, *tensors, size=size)
    if is_transformed(*tensors) or batches.pieces(tensors, ranks, size) is None:
        return function(*tensors)
    kinds: list[type] = []
    result = _Recomputed.apply(function, ranks, kinds, size, *tensors)
    (kind,) = kinds
    return result[0] if not issubclass(kind, tuple) else kind(*result) if hasattr(kind, "_fields") else result


class _Recomputed(torch.autograd.Function):
    """A function of a batch that saves nothing but its arguments."""

    @staticmethod
    def forward(ctx, function, ranks, kinds, size, *tensors):
        ctx.function, ctx.ranks, ctx.size = function, ranks, size
        # Unused results then cost nothing in the backward pass.
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*tensors)
        result = batches.in_pieces(function, ranks, *tensors, size=size)
        kinds.append(type(result))
        result = result if isinstance(result, tuple) else (result,)
        ctx.mark_non_differentiable(*(r for r in result if not r.is_floating_point()))
        return result

    @staticmethod
    def backward(ctx, *gradients):
        needed = ctx.needs_input_grad[4:]
        tensors = ctx.saved_tensors
        if torch.is_grad_enabled() or tensors[0].is_cuda:
            found = _gradients(ctx.function, tensors, needed, gradients, torch.is_grad_enabled())
        else:
            found = _gradients_in_pieces(ctx.function, ctx.ranks, ctx.size, tensors, needed, gradients)
        return None, None, None, None, *found


def _gradients(function, tensors, needed, gradients, create_graph: bool) -> list:
    """Return the gradients of the arguments needed, None for the others."""
    with torch.enable_grad():
        # Separate views, so that an argument computed from another does not pass its gradient on to it here.
        inputs = [t.view_as(t) if create_graph else t.detach() for t in tensors]
        inputs = [t if create_graph or not need else t.requires_grad_() for t, need in zip(inputs, needed, strict=True)]
        result = function(*inputs)
        result = result if isinstance(result, tuple) else (result,)
        pairs = [(r, g) for r, g in zip(result, gradients, strict=True) if r.requires_grad and g is not None]
        wanted = [t for t, need in zip(inputs, needed, strict=True) if need]
        if not pairs:
            return [None] * len(tensors)
        results, weights = zip(*pairs, strict=True)
        found = iter(torch.autograd.grad(results, wanted, weights, create_graph=create_graph, allow_unused=True))
    return [next(found) if need else None for need in needed]


def _gradients_in_pieces(function, ranks, size, tensors, needed, gradients) -> list:
    """Return the same piece by piece, without a graph."""
    plan: Any = batches.pieces(tensors, ranks, size)
    makers = [torch.empty_like if cut else torch.zeros_like for cut in plan.cut]
    total = [make(t) if need else None for make, t, need in zip(makers, tensors, needed, strict=True)]
    for place in plan.places():
        along = (slice(None),) * plan.axis + (place,)
        weights = [None if g is None else g[along] for g in gradients]
        part = _gradients(function, plan.take(tensors, place, ranks), needed, weights, False)
        for whole, found, cut in zip(plan.take(total, place, ranks), part, plan.cut, strict=True):
            if whole is None:
                continue
            if cut:
                whole.copy_(found) if found is not None else whole.zero_()
            elif found is not None:
                whole += found
    return total
