"""Public names that load with their module on first use (PEP 562)."""

import importlib
import sys
from collections.abc import Callable


def attach(package: str, modules: dict[str, tuple[str, ...]]) -> tuple[Callable, Callable, list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` for a package whose names live in its modules.

    Parameters
    ----------
    package : str
        The package's ``__name__``.
    modules : dict
        Maps each submodule to the public names that the package takes from it.
    """
    home = {name: module for module, names in modules.items() for name in names}
    public = sorted({*home, *modules})

    def load(name: str):
        if name in home:
            value = getattr(importlib.import_module(f"{package}.{home[name]}"), name)
            setattr(sys.modules[package], name, value)
            return value
        if name in modules:
            return importlib.import_module(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return load, lambda: public, public
