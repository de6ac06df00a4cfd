"""Differences of call forms from earlier releases, from a table of their names, parameters and defaults."""

import ast
import importlib
import inspect
import warnings
from typing import Any

import numpy
import torch

CONSTANTS = {"torch": torch, "numpy": numpy, "np": numpy, "nn": torch.nn, "logging": importlib.import_module("logging")}


def found(path: str) -> Any:
    """Return what a dotted path names here."""
    module, _, rest = path, "", []
    while True:
        try:
            value = importlib.import_module(module)
            break
        except ImportError:
            module, _, name = module.rpartition(".")
            rest.insert(0, name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        for name in rest:
            value = getattr(value, name)
    return value


def parameters(signature: str) -> dict[str, str | None]:
    """Return the parameters of a signature that is a text, in order, and the text of each default; None without one."""
    arguments = ast.parse(f"def call{signature.replace('…', '...')}: pass").body[0].args
    names = [argument.arg for argument in arguments.posonlyargs + arguments.args]
    defaults = [ast.unparse(value) for value in arguments.defaults]
    return dict.fromkeys(names) | dict(zip(names[len(names) - len(defaults) :], defaults, strict=True))


def plain(value: Any) -> Any:
    """Return a default in a form that compares: arrays and tuples as lists, modules and devices as texts."""
    if isinstance(value, torch.Tensor):
        value = value.squeeze().tolist()
    if isinstance(value, (tuple, list)):
        return [plain(one) for one in value]
    return str(value) if isinstance(value, (torch.nn.Module, torch.device)) else value


def differences(path: str, signature: str) -> dict[str, tuple[str, str]]:
    """Return each parameter of an earlier release that differs here: (its default or place there, that here)."""
    here = found(path)
    if path.endswith(".__call__") and issubclass(found(path.removesuffix(".__call__")), torch.nn.Module):
        here = found(path.removesuffix("__call__") + "forward")
    own = {name: one for name, one in inspect.signature(here).parameters.items() if name != "self"}
    if any(one.kind is one.VAR_POSITIONAL for one in own.values()):
        return {}
    places, result = list(own), {}
    for place, (name, default) in enumerate(parameters(signature).items()):
        if name not in own:
            result[name] = "accepted", "not accepted"
            continue
        one = own[name]
        known = default not in (None, "...") and name != "device"
        if known and plain(eval(default, CONSTANTS)) != plain(one.default):
            result[name] = default, repr(one.default)
        elif one.kind is one.KEYWORD_ONLY:
            result[name] = f"argument {place + 1}", "by name"
        elif places.index(name) != place:
            result[name] = f"argument {place + 1}", f"argument {places.index(name) + 1}"
    return result


def all_differences(releases: dict[str, dict[str, str]]) -> dict[tuple[str, str, str, str], list[str]]:
    """Return (path, parameter, there, here) of each difference and the releases that have it."""
    result: dict[tuple[str, str, str, str], list[str]] = {}
    for release, names in releases.items():
        for path, signature in names.items():
            for name, (there, here) in differences(path, signature).items():
                result.setdefault((path, name, there, here), []).append(release)
    return result
