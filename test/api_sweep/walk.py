"""Every public function, class and method of the package, found by introspection."""

import dataclasses
import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator

import torch

import odak


def public_modules() -> Iterator[object]:
    """Yield each module that a user may import."""
    for module in pkgutil.walk_packages(odak.__path__, "odak."):
        if not any(part.startswith("_") for part in module.name.split(".")):
            yield importlib.import_module(module.name)


def public_callables() -> dict[str, Callable]:
    """Return functions, classes that users make, and these classes' own methods, each under its shortest name."""
    names: dict[int, str] = {}
    objects: dict[int, object] = {}
    for module in public_modules():
        for name in getattr(module, "__all__", ()):
            found = getattr(module, name)
            if inspect.isfunction(found) or (inspect.isclass(found) and is_made_by_users(found)):
                path = f"{module.__name__}.{name}"
                objects[id(found)] = found
                names[id(found)] = min(names.get(id(found), path), path, key=lambda text: (text.count("."), text))
    callables = {}
    for key, found in objects.items():
        callables[names[key]] = found
        if inspect.isclass(found):
            callables.update({f"{names[key]}.{name}": method for name, method in methods(found)})
    return dict(sorted(callables.items()))


def is_made_by_users(found: type) -> bool:
    """Say whether a class is more than an exception or a record that a function returns."""
    return not (issubclass(found, (BaseException, tuple)) or dataclasses.is_dataclass(found))


def methods(found: type) -> Iterator[tuple[str, Callable]]:
    """Yield a class's public methods, without what torch's modules bring along."""
    for name, method in inspect.getmembers(found, inspect.isfunction):
        ours = method.__module__.startswith("odak") and not name.startswith("_")
        if ours and (name == "forward" or not hasattr(torch.nn.Module, name)):
            yield name, method
