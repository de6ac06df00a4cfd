"""A valid value for each argument: by the argument's name, and for single calls where the name is not enough."""

import contextlib
import copy
import doctest
import functools
import inspect
import io
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy
import torch
from api_sweep import examples
from api_sweep.build import Build

MISSING = object()


class _Called(BaseException):
    """A call whose arguments are known, and which need not be made for that."""


@functools.cache
def parameters_of(function: Callable) -> list[inspect.Parameter]:
    """Return the parameters that a user names."""
    parameters = inspect.signature(function).parameters.values()
    return [p for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL) and p.name != "self"]


def arguments(path: str, function: Callable, folder: Callable[[], Path], without: str | None = None) -> dict[str, Any]:
    """Return valid arguments for the call `path`, all or all but one, made anew, files in what `folder` returns.

    LookupError where one is not known.
    """
    folder = functools.cache(folder)
    return {name: _made(value, folder) for name, value in _values(path, function).items() if name != without}


@functools.cache
def _values(path: str, function: Callable) -> dict[str, Any]:
    """Return the valid values from which the arguments of each call are made."""
    found = {parameter.name: _value(path, parameter, function) for parameter in parameters_of(function)}
    for name, value in found.items():
        if value is MISSING:
            raise LookupError(f"test/api_sweep/examples has no valid {name!r} for {path}")
    return found


@functools.cache
def example(function: Callable) -> dict[str, Any]:
    """Return the arguments that the example in the docstring of a function or class gives to it, at its first call."""
    inner = inspect.unwrap(function.__init__ if inspect.isclass(function) else function)
    parsed = doctest.DocTestParser().get_examples(inspect.getdoc(function) or "")
    found: dict[str, Any] = {}
    if not parsed or not hasattr(inner, "__code__"):
        return found
    defaults = {name: p.default for name, p in inspect.signature(function).parameters.items()}

    def note(frame, event, _):
        if event == "call" and frame.f_code is inner.__code__:
            given = {name: frame.f_locals[name] for name in defaults if name in frame.f_locals}
            found.update({name: value for name, value in given.items() if value is not defaults[name]})
            if found:
                raise _Called

    namespace = dict(vars(sys.modules[inner.__module__]))
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter("ignore")
        before = os.getcwd()
        os.chdir(folder)
        try:
            for statement in parsed:
                sys.setprofile(note)
                with contextlib.suppress(_Called, OSError):  # the latter of a file that is the reader's
                    exec(compile(statement.source, "<example>", "single"), namespace)
                sys.setprofile(None)
                if found:
                    break
        finally:
            sys.setprofile(None)
            os.chdir(before)
    return found


def _value(path: str, parameter: inspect.Parameter, function: Callable) -> Any:
    """Return a valid value for one argument, or MISSING: from the tables, its default, or what the example shows."""
    for table in (examples.BY_CALL.get(path, {}), *_by_prefix(examples.BY_NAME, path, {})):
        if parameter.name in table:
            return table[parameter.name]
    # Examples run under a profiler, which takes long: only where nothing else gives the value.
    required = parameter.default is parameter.empty
    return example(function).get(parameter.name, MISSING) if required else parameter.default


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
        return value.function(folder())
    if isinstance(value, torch.Tensor):
        return value.detach().clone().requires_grad_(value.requires_grad)
    if isinstance(value, torch.Generator):
        return value.clone_state()
    if isinstance(value, numpy.ndarray):
        return value.copy()
    return copy.deepcopy(value) if isinstance(value, (numpy.random.Generator, list, dict, tuple)) else value
