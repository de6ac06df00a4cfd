"""What a public call owes its user: a correct result, or an error that names the argument."""

import copy
import dataclasses
import functools
import itertools
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy
import torch
from api_sweep import hostile
from PIL import Image

_COUNT = itertools.count()


def call(function: Callable, arguments: dict[str, Any]) -> Any:
    """Return what a function gives, from the same random state each time and without its warnings."""
    numpy.random.seed(7)  # noqa: NPY002 (what users' own code still draws from)
    torch.default_generator.manual_seed(7)  # torch.manual_seed formats the stack each time, for CUDA
    with warnings.catch_warnings(), numpy.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return function(**arguments)


def judge(function: Callable, arguments: dict, name: str, verdict: str) -> str | None:
    """Call a function with one wrong argument; return the violation, if there is one."""
    wrong = arguments[name]
    before = copied(wrong)
    try:
        result = call(function, arguments)
    except (ValueError, TypeError) as error:
        return None if names(error, name) else f"{type(error).__name__} that does not name {name}: {first_line(error)}"
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        return f"{type(error).__name__}: {first_line(error)}"
    if not same(before, wrong, 0.0):
        return "the caller's data was changed"
    if verdict == hostile.REFUSED:
        return f"accepted, result {short(result)}"
    if verdict == hostile.SPREADS and flat(result) and all(numpy.isfinite(array).all() for array in flat(result)):
        return f"vanishes in a finite result {short(result)}"
    return None


def compare(function: Callable, arguments: dict, name: str, expected: Any, tolerance: float):
    """Call a function with another form of a valid argument, and follow its gradients; return the complaint, if any."""
    form = arguments[name]
    before = copied(form)
    try:
        result = call(function, arguments)
    except (ValueError, TypeError) as error:
        return None if names(error, name) else f"{type(error).__name__} that does not name {name}: {first_line(error)}"
    except BaseException as error:
        return f"{type(error).__name__}: {first_line(error)}"
    if not same(before, form, 0.0):
        return "the caller's data was changed"
    if expected is not None and not same(expected, result, tolerance):
        return f"another result: {short(result)} instead of {short(expected)}"
    return slopes(result, form) if isinstance(form, torch.Tensor) and form.requires_grad else None


def slopes(result: Any, followed: torch.Tensor) -> str | None:
    """Differentiate a result by a tensor; return a violation if gradients of finite values are not finite."""
    found = [value for value in tensors(result) if value.requires_grad]
    parts = [torch.view_as_real(value.resolve_conj()) if value.is_complex() else value for value in found]
    total = sum(part.sum() for part in parts)
    if not parts or not torch.isfinite(total):
        return None
    (slope,) = torch.autograd.grad(total, followed, allow_unused=True)
    if slope is None or bool(torch.isfinite(torch.view_as_real(slope) if slope.is_complex() else slope).all()):
        return None
    return "slopes that are no numbers"


def tensors(value: Any) -> list[torch.Tensor]:
    """Return the tensors in a result."""
    if isinstance(value, torch.Tensor):
        return [value]
    if isinstance(value, dict):
        value = list(value.values())
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = [getattr(value, field.name) for field in dataclasses.fields(value)]
    return [found for item in value for found in tensors(item)] if isinstance(value, (list, tuple)) else []


def judge_elsewhere(function: Callable, build: Callable[[], dict], name: str) -> str | None:
    """Call a function with one tensor on another device than the others; return the violation, if there is one.

    The device "meta" stands for a GPU. It holds no numbers, so that reading them or moving them to the CPU, which a GPU
    allows, ends there: only what torch says of operands on two devices tells that nobody looked.
    """
    arguments = build()
    try:
        call(function, arguments | {name: arguments[name].to("meta")})
    except (ValueError, TypeError) as error:
        return None if names(error, name) else f"{type(error).__name__} that does not name {name}: {first_line(error)}"
    except (RuntimeError, NotImplementedError) as error:
        text = str(error)
        apart = "not on the expected device" in text or "on the same device" in text
        return f"{type(error).__name__}: {first_line(error)}" if apart else None
    return None


def names(error: Exception, name: str) -> bool:
    """Say whether an error's message names an argument; a file's name counts as a path."""
    return _pattern(name).search(str(error)) is not None


@functools.cache
def _pattern(name: str) -> re.Pattern:
    name = f"{name}|path" if name in ("fn", "filename", "savefn", "directory") else re.escape(name)
    return re.compile(rf"(?<![a-z0-9_])(?:{name})(?![a-z0-9])", re.IGNORECASE)


def first_line(error: BaseException) -> str:
    """Return the start of an error's message."""
    return (str(error).splitlines() or [""])[0][:160]


def short(value: Any) -> str:
    """Return a value in a few characters."""
    return re.sub(r"\s+", " ", repr(value))[:100]


def copied(value: Any) -> Any:
    """Return a copy of an argument, as far as it holds data."""
    if isinstance(value, torch.Tensor):
        return value.detach().clone()
    return copy.deepcopy(value) if isinstance(value, (numpy.ndarray, list, dict)) else value


def flat(value: Any) -> list[numpy.ndarray]:
    """Return the numbers in a result as a list of arrays."""
    if isinstance(value, torch.Tensor):
        value = value.detach().resolve_conj().resolve_neg()
        return [value.to(torch.float32 if value.dtype in (torch.bfloat16,) else value.dtype).cpu().numpy()]
    if isinstance(value, numpy.ndarray):
        return [value] if value.dtype.kind in "fciub" else []
    if isinstance(value, Image.Image):
        return [numpy.asarray(value)]
    if isinstance(value, (bool, int, float, complex, numpy.generic)) and not isinstance(value, numpy.str_):
        return [numpy.asarray(value)]
    if isinstance(value, dict):
        value = list(value.values())
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = [getattr(value, field.name) for field in dataclasses.fields(value)]
    if isinstance(value, (list, tuple)):
        return [array for item in value for array in flat(item)]
    return []


def same(first: Any, second: Any, tolerance: float) -> bool:
    """Say whether two results hold the same numbers."""
    ones, others = flat(first), flat(second)
    if len(ones) != len(others):
        return False
    for one, other in zip(ones, others, strict=True):
        if numpy.array_equal(one, other):
            continue
        if one.shape != other.shape:
            return False
        if one.dtype.kind in "fc":
            one, other = one.astype(numpy.complex128), other.astype(numpy.complex128)
            scale = numpy.abs(one[numpy.isfinite(one)]).max(initial=0.0)
            if not numpy.allclose(one, other, rtol=0, atol=tolerance * max(scale, 1e-300), equal_nan=True):
                return False
        elif tolerance < 1e-2 and not numpy.array_equal(one, other):
            return False
    return True


def fresh_folder(root: Path) -> Path:
    """Return a folder that no other call has written to."""
    folder = root / str(next(_COUNT))
    folder.mkdir()
    return folder
