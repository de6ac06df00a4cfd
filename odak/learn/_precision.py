"""Arithmetic in the precision of its input, whatever torch.autocast would make of it."""

import functools
from collections.abc import Callable
from contextlib import ExitStack

import torch


def in_own_precision(function: Callable) -> Callable:
    """Return the function, run with torch.autocast off.

    Differences of nearly equal means, colours and coordinates need the digits that bfloat16 does not have; networks
    are what it is for.
    """

    @functools.wraps(function)
    def careful(*args, **options):
        on = [kind for kind in ("cpu", "cuda") if torch.is_autocast_enabled(kind)]
        if not on:
            return function(*args, **options)
        with ExitStack() as stack:
            for kind in on:
                stack.enter_context(torch.autocast(kind, enabled=False))
            return function(*args, **options)

    return careful
