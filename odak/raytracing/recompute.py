"""Functions of large batches of tensors that store only their arguments and are recomputed in the backward pass."""

from collections.abc import Callable, Sequence
from typing import Any

import torch


def recomputed(function: Callable, ranks: Sequence[int], plan: Any, evaluate: Callable, arrays: Sequence[Any]) -> Any:
    """Return ``function(*arrays)``, differentiable, storing only the arguments for the backward pass.

    Parameters
    ----------
    function : callable
        Takes the arrays and returns a tensor or a (named) tuple of tensors.
    ranks : sequence of int
        Number of axes of each array that do not belong to its batch.
    plan : odak.raytracing.batches.Pieces
        How the batch is cut in the backward pass.
    evaluate : callable
        ``evaluate(function, ranks, arrays)`` returns the result without a graph.
    arrays : sequence
        Tensors, numbers and None.
    """
    places = [i for i, array in enumerate(arrays) if isinstance(array, torch.Tensor)]

    def of_tensors(*tensors):
        given = list(arrays)
        for place, tensor in zip(places, tensors, strict=True):
            given[place] = tensor
        return function(*given)

    kinds: list[type[Any]] = []
    plan = plan._replace(cut=tuple(plan.cut[i] for i in places))
    ranks = [ranks[i] for i in places]
    result = _Recomputed.apply(of_tensors, ranks, plan, evaluate, kinds, *(arrays[i] for i in places))
    (kind,) = kinds
    return result[0] if not issubclass(kind, tuple) else kind(*result) if hasattr(kind, "_fields") else result


class _Recomputed(torch.autograd.Function):
    """A function of a batch that saves nothing but its arguments."""

    @staticmethod
    def forward(ctx, function, ranks, plan, evaluate, kinds, *tensors):
        ctx.function, ctx.ranks, ctx.plan = function, ranks, plan
        # Unused results are then skipped in the backward pass.
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*tensors)
        result = evaluate(function, ranks, tensors)
        kinds.append(type(result))
        result = result if isinstance(result, tuple) else (result,)
        ctx.mark_non_differentiable(*(r for r in result if not r.is_floating_point()))
        return result

    @staticmethod
    def backward(ctx, *gradients):
        needed = ctx.needs_input_grad[5:]
        tensors = ctx.saved_tensors
        if torch.is_grad_enabled() or tensors[0].is_cuda:
            found = _gradients(ctx.function, tensors, needed, gradients, torch.is_grad_enabled())
            return None, None, None, None, None, *found
        # Without a graph of the gradients themselves, piece by piece.
        plan = ctx.plan
        makers = [torch.empty_like if cut else torch.zeros_like for cut in plan.cut]
        total = [make(t) if need else None for make, t, need in zip(makers, tensors, needed, strict=True)]
        for place in plan.places():
            along = (slice(None),) * plan.axis + (place,)
            weights = [None if g is None else g[along] for g in gradients]
            part = _gradients(ctx.function, plan.take(tensors, place, ctx.ranks), needed, weights, False)
            for whole, found, cut in zip(plan.take(total, place, ctx.ranks), part, plan.cut, strict=True):
                if whole is None:
                    continue
                if cut:
                    whole.copy_(found) if found is not None else whole.zero_()
                elif found is not None:
                    whole += found
        return None, None, None, None, None, *total


def _gradients(function, tensors, needed, gradients, create_graph: bool) -> list[Any]:
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
