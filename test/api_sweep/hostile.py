"""Wrong values for an argument, and other forms of a right one."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy
import torch

# A wrong value must raise an error that names the argument; or it may do so, or give a result; or the result is spoilt
# too, visibly.
REFUSED, MAY_PASS, SPREADS = "refused", "may pass", "spreads"


class Stranger:
    """Something that is no number, array, text or function."""

    def __repr__(self):
        return "<a stranger>"


def kind_of(value: Any) -> str:
    """Return the kind of thing that a valid argument is."""
    if isinstance(value, (numpy.ndarray, torch.Tensor)):
        return "array"
    if isinstance(value, (bool, numpy.bool_)):
        return "flag"
    if isinstance(value, (int, numpy.integer)):
        return "integer"
    if isinstance(value, (float, numpy.floating)):
        return "number"
    if isinstance(value, str):
        return "text"
    if isinstance(value, Path):
        return "path"
    if isinstance(value, (list, tuple)) and value and all(kind_of(v) in ("integer", "number") for v in value):
        return "numbers"
    return "other"


def wrong_values(valid: Any, *, positive: bool, free_text: bool, side: bool) -> Iterator[tuple[str, Any, str]]:
    """Yield (what it is, a wrong value for an argument, what may happen)."""
    kind = kind_of(valid)
    yield "a stranger", Stranger(), MAY_PASS if kind == "flag" else REFUSED
    if kind not in ("text", "path"):
        yield "a text", "nonsense", REFUSED
    if kind in ("number", "integer"):
        yield "NaN", float("nan"), REFUSED
        yield "a complex number", 1.5j, REFUSED
        yield "an empty list", [], REFUSED
        if positive:
            yield "zero", type(valid)(0), REFUSED
            yield "a negative number", type(valid)(-1), REFUSED
        else:
            yield "a negative number", type(valid)(-1), MAY_PASS
            yield "zero", type(valid)(0), MAY_PASS
        yield "infinity", float("inf"), MAY_PASS if kind == "number" else REFUSED
    if kind == "integer":
        yield "half a step", valid + 0.5, REFUSED
        if side:
            yield "a huge number", 2**40, REFUSED
    if kind == "numbers":
        yield "nothing", [], MAY_PASS
        yield "one too many", [*valid, valid[-1]], MAY_PASS
        yield "one too few", list(valid[:-1]), MAY_PASS
        yield "texts", ["nonsense"] * len(valid), REFUSED
        yield "NaN inside", [float("nan"), *valid[1:]], REFUSED
        if side:
            yield "a huge number", [2**40, *valid[1:]], REFUSED
    if kind == "text":
        yield "a number", 5, REFUSED
        if not free_text:
            yield "an unknown option", "nonsense", REFUSED
    if kind == "path":
        yield "a number", 5, REFUSED
        yield "a null byte", "nothing\0here", REFUSED
    if kind == "array":
        yield from _wrong_arrays(valid)


def _wrong_arrays(valid):
    torch_face = isinstance(valid, torch.Tensor)
    empty = torch.empty if torch_face else numpy.empty
    yield "a scalar array", valid.reshape(-1)[0], MAY_PASS
    yield "an empty array", empty((0, *valid.shape[1:]), dtype=valid.dtype), MAY_PASS
    yield "no columns", empty((*valid.shape[:-1], 0), dtype=valid.dtype), MAY_PASS
    yield "one axis more", valid[None], MAY_PASS
    yield "one axis less", valid[0] if valid.ndim else valid, MAY_PASS
    if valid.ndim:
        yield "a column less", valid[..., :-1], MAY_PASS
    yield "four axes more", valid[None, None, None, None], MAY_PASS
    if not torch_face:
        yield "an array of texts", numpy.full(valid.shape, "nonsense"), REFUSED
        yield "an array of objects", numpy.full(valid.shape, Stranger(), dtype=object), REFUSED
    if _floating(valid):
        for what, number in (("NaN inside", float("nan")), ("infinity inside", float("inf"))):
            spoilt = valid.clone() if torch_face else valid.copy()
            spoilt.reshape(-1)[0] = number
            yield what, spoilt, SPREADS


def other_forms(valid: Any) -> Iterator[tuple[str, Any, float]]:
    """Yield (what it is, the same values in another form, the relative tolerance of the result)."""
    if kind_of(valid) != "array":
        return
    if isinstance(valid, torch.Tensor):
        yield from _tensor_forms(valid)
    else:
        yield from _array_forms(valid)


def _tensor_forms(valid):
    # Not contiguous, and with signs that change when read: nothing may take the values as they are stored.
    if valid.is_complex():
        yield "a conjugate view", torch.conj(_strided(torch.conj(valid).resolve_conj())), 1e-5
    elif valid.is_floating_point():
        yield "a negated view", torch._neg_view(_strided(-valid)), 1e-5
    else:
        yield "not contiguous", _strided(valid), 1e-5
    if _floating(valid):
        yield "followed by autograd", valid.clone().requires_grad_(), 1e-5
        yield "in double precision", valid.to(torch.complex128 if valid.is_complex() else torch.float64), 1e-3
    if valid.is_floating_point():
        yield "in half precision", valid.half(), 5e-2
    with torch.inference_mode():
        inference = valid.clone()
    yield "made in inference mode", inference, 1e-5


def _strided(valid):
    return torch.stack((valid, valid), -1)[..., 0]


def _array_forms(valid):
    frozen = numpy.stack((valid, valid), -1)[..., 0]
    frozen.setflags(write=False)
    yield "read-only and not contiguous", frozen, 1e-5
    turned = numpy.asfortranarray(valid[::-1] if valid.ndim else valid)
    yield "in Fortran's order, with reversed strides", turned[::-1] if valid.ndim else turned, 1e-5
    yield "lists", valid.tolist(), 1e-3
    if _floating(valid):
        lower = numpy.complex64 if numpy.iscomplexobj(valid) else numpy.float32
        yield "in single precision", valid.astype(lower), 1e-3
        if not numpy.iscomplexobj(valid):
            yield "in half precision", valid.astype(numpy.float16), 5e-2


def _floating(value):
    if isinstance(value, torch.Tensor):
        return value.is_floating_point() or value.is_complex()
    return value.dtype.kind in "fc"
