"""Computation in the precision of the input, without the casts of torch.autocast."""

import functools
from collections.abc import Callable
from contextlib import ExitStack
from typing import ParamSpec, TypeVar

import torch

P = ParamSpec("P")
R = TypeVar("R")


def in_own_precision(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function, run with torch.autocast off.

    Differences of nearly equal means, colours and coordinates need the digits that bfloat16 does not have; networks
    are what it is for.
    """

    @functools.wraps(function)
    def careful(*args: P.args, **options: P.kwargs) -> R:
        on = [kind for kind in ("cpu", "cuda") if torch.is_autocast_enabled(kind)]
        if not on:
            return function(*args, **options)
        with ExitStack() as stack:
            for kind in on:
                stack.enter_context(torch.autocast(kind, enabled=False))
            return function(*args, **options)

    return careful
