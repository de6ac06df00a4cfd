"""A valid value for each argument: by the argument's name, and for single calls where the name is not enough."""

import copy
import inspect
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy
import torch
from api_sweep import examples
from api_sweep.build import Build

MISSING = object()


def parameters_of(function: Callable) -> list[inspect.Parameter]:
    """Return the parameters that a user names."""
    parameters = inspect.signature(function).parameters.values()
    return [p for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL) and p.name != "self"]


def arguments(path: str, function: Callable, folder: Path) -> dict[str, Any]:
    """Return valid arguments for the call `path`, made anew; LookupError where one is not known."""
    found = {}
    for parameter in parameters_of(function):
        value = sample(path, parameter, folder)
        if value is MISSING:
            raise LookupError(f"test/api_sweep/examples has no valid {parameter.name!r} for {path}")
        found[parameter.name] = value
    return found


def sample(path: str, parameter: inspect.Parameter, folder: Path) -> Any:
    """Return a valid value for one argument, or MISSING."""
    for table in (examples.BY_CALL.get(path, {}), *_by_prefix(examples.BY_NAME, path, {})):
        if parameter.name in table:
            return _made(table[parameter.name], folder)
    return MISSING if parameter.default is parameter.empty else copy.deepcopy(parameter.default)


def is_positive(path: str, name: str) -> bool:
    """Say whether an argument must be above zero."""
    return any(name in names for names in _by_prefix(examples.POSITIVE, path, ()))


def is_free_text(path: str, name: str) -> bool:
    """Say whether an argument may be any text."""
    return any(name in names for names in _by_prefix(examples.FREE_TEXT, path, ()))


def is_side(path: str, name: str) -> bool:
    """Say whether an argument is a number of samples along an axis, or a pair of them."""
    return any(name in names for names in _by_prefix(examples.SIDES, path, ()))


def is_called(path: str) -> bool:
    """Say whether a call is part of the sweep."""
    return not any(fnmatchcase(path, pattern) for pattern in examples.NOT_CALLED)


def is_allowed(path: str, name: str, what: str) -> bool:
    """Say whether a departure from the contract is on record, with its reason."""
    return any(
        fnmatchcase(path, where) and fnmatchcase(name, argument) and fnmatchcase(what, wrong)
        for where, argument, wrong in examples.ALLOWED
    )


def _by_prefix(table, path, nothing) -> Iterator:
    pieces = path.split(".")
    for count in range(len(pieces), 0, -1):
        yield table.get(".".join(pieces[:count]), nothing)


def _made(value, folder):
    if isinstance(value, Build):
        return value.function(folder)
    if isinstance(value, torch.Tensor):
        return value.clone()
    return copy.deepcopy(value) if isinstance(value, (numpy.ndarray, list, dict, tuple)) else value
