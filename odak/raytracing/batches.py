"""Evaluation of large batches in pieces that fit into a cache, with little memory for gradients."""

import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import array_api_compat
import numpy as np

from odak._array import device_of, is_array, is_torch, namespace

# Large enough for a small overhead of the calls, small enough for the cache: 32 768 rays of 10 to 20 numbers.
CHUNK = 1 << 15


def piece_size(arrays: Sequence[Any]) -> int:
    """Return the number of rays of a piece: that for one thread, times the number of threads of torch."""
    if not any(is_torch(array) for array in arrays):
        return CHUNK
    import torch

    return CHUNK * torch.get_num_threads()


def needs_gradient(*values: Any) -> bool:
    """Return whether derivatives or transforms of the arrays are recorded: NaN must not enter the arithmetic then."""
    if "jax" in sys.modules and any(array_api_compat.is_jax_array(value) for value in values):
        return True
    tensors = [value for value in values if is_torch(value)]
    if not tensors:
        return False
    import torch

    from odak import _torch_private

    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors):
        return True
    return _torch_private.is_transformed(*tensors)


class Pieces(NamedTuple):
    """How a batch is cut.

    Attributes
    ----------
    shape : tuple of int
        The batch.
    axis : int
        Its axis along which it is cut.
    step : int
        Length of a piece along it.
    cut : tuple of bool
        Which arrays have that axis.
    """

    shape: tuple[int, ...]
    axis: int
    step: int
    cut: tuple[bool, ...]

    def places(self) -> list[slice]:
        """Return the pieces' ranges along the axis."""
        length = self.shape[self.axis]
        return [slice(a, min(a + self.step, length)) for a in range(0, length, self.step)]

    def take(self, arrays: Sequence[Any], place: slice, ranks: Sequence[int]) -> list[Any]:
        """Return the part of each array that belongs to a piece."""
        behind = len(self.shape) - self.axis
        return [
            array[(slice(None),) * (array.ndim - rank - behind) + (place,)] if cut and array is not None else array
            for array, cut, rank in zip(arrays, self.cut, ranks, strict=True)
        ]


def pieces(arrays: Sequence[Any], ranks: Sequence[int], size: int | None = None) -> Pieces | None:
    """Return how to cut arrays whose last `ranks` axes are no batch axes; None when the batch is small.

    The batch is cut along its longest axis, into pieces of `size` elements, by default as many as :func:`piece_size`
    returns.
    """
    batches = [tuple(a.shape[: a.ndim - rank]) if is_array(a) else () for a, rank in zip(arrays, ranks, strict=True)]
    shape = np.broadcast_shapes(*batches)
    total, size = int(np.prod(shape)), piece_size(arrays) if size is None else size
    if total <= size:
        return None
    axis = int(np.argmax(shape))
    behind = len(shape) - axis
    step = max(1, size * shape[axis] // total)
    return Pieces(shape, axis, step, tuple(len(b) >= behind and b[len(b) - behind] > 1 for b in batches))


def in_pieces(function: Callable[..., Any], ranks: Sequence[int], *arrays: Any, size: int | None = None) -> Any:
    """Return ``function(*arrays)``, computed piece by piece where the batch is large.

    Where derivatives are recorded, small batches keep their graph, as do all under forward mode, torch.func,
    torch.compile and jax. Of a large batch of tensors only the arguments are kept, and the backward pass computes
    `function` again, piece by piece.

    Parameters
    ----------
    function : callable
        Takes the arrays and returns an array or a (named) tuple of arrays whose first axes are the batch's.
    ranks : sequence of int
        Number of axes of each array that do not belong to its batch.
    *arrays
        Arrays or numbers.
    size : int, optional
        Elements of a piece; by default as many as suit the cache.
    """
    if not needs_gradient(*arrays):
        # NaN marks lost rays, for which NumPy's warnings are not wanted.
        with np.errstate(all="ignore"):
            return _run(function, ranks, arrays, size)
    tensors = [array for array in arrays if is_torch(array)]
    if not tensors:
        return function(*arrays)
    from odak import _torch_private

    if _torch_private.is_transformed(*tensors) or (plan := pieces(arrays, ranks, size)) is None:
        return function(*arrays)
    from odak.raytracing.recompute import recomputed

    return recomputed(function, ranks, plan, lambda function, ranks, given: _run(function, ranks, given, size), arrays)


def _run(function, ranks, arrays, size):
    xp = namespace(*arrays)
    example = next((a for a in arrays if is_array(a)), None)
    on_host = str(getattr(device_of(example), "type", device_of(example))) == "cpu"
    plan = pieces(arrays, ranks, size) if on_host else None
    if plan is None:
        return function(*arrays)
    whole = None
    for place in plan.places():
        result = function(*plan.take(arrays, place, ranks))
        parts = result if isinstance(result, tuple) else (result,)
        if whole is None:
            kind = type(result)
            whole = [xp.empty(plan.shape + tuple(p.shape[len(plan.shape) :]), dtype=p.dtype) for p in parts]
        for out, part in zip(whole, parts, strict=True):
            out[(slice(None),) * plan.axis + (place,)] = part
    return whole[0] if not issubclass(kind, tuple) else kind(*whole) if hasattr(kind, "_fields") else tuple(whole)
