"""Argument checks for the public doors: each names the argument, what came and what is accepted."""

import difflib
import math
from collections.abc import Iterable
from numbers import Integral, Real

from odak._array import is_array, is_readable, is_torch, namespace


def one_of(name: str, value: str, options: Iterable[str]) -> str:
    """Return the option that `value` names, whatever its case; raise ValueError with the nearest match otherwise."""
    options = tuple(options)
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, got {type(value).__name__}; accepted: {', '.join(options)}")
    for option in options:
        if option.casefold() == value.strip().casefold():
            return option
    near = difflib.get_close_matches(value.casefold(), [option.casefold() for option in options], n=1, cutoff=0.4)
    hint = next((f" Did you mean {option!r}?" for option in options if near and option.casefold() == near[0]), "")
    raise ValueError(f"{name} must be one of {', '.join(map(repr, options))}; got {value!r}.{hint}")


def real(name: str, value, *, positive: bool = False, nonzero: bool = False):
    """Return `value` (a number or an array) after checking that it is real, finite and of the sign asked for.

    Tensors on a GPU or inside a torch.func transform are checked for their type alone: reading them would sync or fail.
    """
    listed = isinstance(value, (list, tuple)) and all(isinstance(v, Real) for v in value)
    if isinstance(value, bool) or not (isinstance(value, Real) or listed or is_array(value)):
        raise TypeError(f"{name} must be a real number or an array of them, got {type(value).__name__}")
    if is_array(value):
        if "complex" in str(value.dtype):
            raise TypeError(f"{name} must be real, got an array of {value.dtype}")
        if not is_readable(value):
            return value
    wanted = "positive and finite" if positive else "finite and not zero" if nonzero else "finite"
    if is_array(value):
        xp = namespace(value)
        bad = ~xp.isfinite(value) | (value <= 0 if positive else value == 0 if nonzero else value != value)
        if not bool(xp.any(bad)):
            return value
    for v in numbers(value):
        if not math.isfinite(v) or (positive and v <= 0) or (nonzero and v == 0):
            raise ValueError(f"{name} must be {wanted}, got {v!r}")
    return value


def numbers(value) -> list[float]:
    """Return a number, a sequence or an array of numbers as a flat list of floats."""
    if is_array(value):
        value = value.detach() if is_torch(value) else value
        return [float(v) for v in namespace(value).reshape(value, (-1,))]
    if isinstance(value, Iterable):
        return [number for v in value for number in numbers(v)]
    return [float(value)]


def integer(name: str, value, *, minimum: int = 0) -> int:
    """Return `value` as an int after checking that it is a whole number of at least `minimum`."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"{name} must be an integer, got {type(value).__name__}")
    if value < minimum:
        raise ValueError(f"{name} must be at least {minimum}, got {value}")
    return int(value)


def image(name: str, value, *, axes: int = 2):
    """Return an array of at least `axes` axes whose last two are not empty."""
    if not is_array(value):
        raise TypeError(f"{name} must be an array or a tensor, got {type(value).__name__}")
    if value.ndim < axes or 0 in value.shape[-2:]:
        raise ValueError(
            f"{name} must have at least {axes} axes [..., rows, columns], none empty; got {tuple(value.shape)}"
        )
    return value


def size(name: str, value) -> tuple[int, int]:
    """Return a pair of positive integers (rows, columns)."""
    pair = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str) else (value,)
    if len(pair) != 2:
        raise ValueError(f"{name} must be two integers [rows, columns], got {value!r}")
    return integer(f"{name}[0]", int(pair[0]), minimum=1), integer(f"{name}[1]", int(pair[1]), minimum=1)
