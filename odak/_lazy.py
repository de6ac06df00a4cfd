"""Lazy loading of the public names listed in stub files (PEP 562), and import of modules under their earlier paths."""

import ast
import functools
import importlib
import importlib.machinery
import opcode
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from odak._moved import MOVED_MODULES, MOVED_NAMES, other_words

_IMPORT_FROM = opcode.opmap["IMPORT_FROM"]


def attach(package: str, file: str) -> tuple[Callable[..., Any], Callable[..., Any], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` for a package whose public names are listed in its stub file.

    The stub ``__init__.pyi`` beside the package's ``__init__.py`` holds one line for each public name, which type
    checkers, editors and the reference read too: ``from .module import name as name``. The modules that it names are
    attributes of the package as well: `dir` lists those that are public. ``__all__`` holds functions, classes and
    constants alone, so that a star import never binds a module.

    Parameters
    ----------
    package : str
        The package's ``__name__``.
    file : str
        The package's ``__file__``.
    """
    home = _read_stub(package, Path(file).with_suffix(".pyi"))
    moved = MOVED_NAMES.get(package, {})
    modules = {module for module, name in home.values() if module.rpartition(".")[0] == package}
    modules |= {f"{package}.{name}" for name in home if home[name] == (f"{package}.{name}", None)}
    children = {module.rpartition(".")[2] for module in modules} - set(home)
    listed = {name for name, (module, _) in home.items() if module.startswith("odak.")}
    public = sorted({*listed, *(child for child in children if not child.startswith("_"))})
    starred = [name for name in public if home.get(name, ("", None))[1] is not None]
    homonyms = {n for n in home if home[n] == (f"{package}.{n}", n) or f"{package}.{n}" in MOVED_MODULES}
    if homonyms:
        sys.modules[package].__dict__["_homonyms"] = homonyms
        sys.modules[package].__class__ = _PackageOfHomonyms

    def load(name: str):
        if name in home:
            module, attribute = home[name]
            value = importlib.import_module(module)
            if attribute is not None:
                value = getattr(value, attribute)
            sys.modules[package].__dict__[name] = value
            return value
        if name in children or f"{package}.{name}" in MOVED_MODULES:
            return importlib.import_module(f"{package}.{name}")
        if name in moved:
            from odak._warnings import warn

            place, _, renamed = moved[name].partition(":")
            warn(f"{package}.{name} is deprecated: import it as {place}.{renamed or name}", DeprecationWarning)
            return getattr(importlib.import_module(place), renamed or name)
        hint = "" if name.startswith("_") else _import_of(name, package)
        if hint and f"{package}.{name}" not in sys.modules and _imports(sys._getframe(1)):
            # Python replaces the text of an AttributeError here; it tries submodules, with hasattr, before it asks.
            raise ImportError(f"cannot import name {name!r} from {package!r}{hint}", name=package, path=file)
        raise AttributeError(f"module {package!r} has no attribute {name!r}{hint}")

    return load, lambda: public, starred


def _read_stub(package: str, stub: Path) -> dict[str, tuple[str, str | None]]:
    """Return, for each name that a stub imports, its module and its name there; None for the module itself."""
    home: dict[str, tuple[str, str | None]] = {}
    for statement in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Import):
            home.update({alias.asname or alias.name: (alias.name, None) for alias in statement.names})
            continue
        if not isinstance(statement, ast.ImportFrom):
            raise SyntaxError(f"{stub}, line {statement.lineno}: a stub of names must contain imports only")
        base = package.rsplit(".", statement.level - 1)[0] if statement.level else ""
        module = ".".join(part for part in (base, statement.module) if part)
        for alias in statement.names:
            name = alias.asname or alias.name
            home[name] = (module, alias.name) if statement.module else (f"{module}.{alias.name}", None)
    return home


@functools.cache
def _homes() -> dict[str, list[str]]:
    """Return the packages that list each function, class and constant, those nearest to the top first."""
    root, found = Path(__file__).parent, dict[str, list[str]]()
    for stub in sorted(root.rglob("__init__.pyi"), key=lambda path: (len(path.parts), path)):
        package = ".".join(stub.parent.relative_to(root.parent).parts)
        for name, (module, attribute) in _read_stub(package, stub).items():
            if attribute is None or name.startswith("_") or not module.startswith("odak."):
                continue
            places = found.setdefault(name, [])
            # The packages of holograms and displays list names for the package above.
            if not any(package.startswith(f"{place}.") for place in places):
                places.append(package)
    return found


def _import_of(name: str, package: str) -> str:
    """Return the end of a message with the import of a name, or of the nearest one, that a package lacks; or ""."""
    import difflib

    homes = _homes()
    named = [key for key, words in other_words().items() if name.casefold() in words.split()]
    near = [name] if name in homes else named
    if near and "." in near[0]:
        return f". Did you mean: from {near[0]} import {name}?"
    near = near or [other for other in homes if other.casefold() == name.casefold()]
    for names in ([other for other in homes if package in homes[other]], homes):
        near = near or difflib.get_close_matches(name, names, n=1, cutoff=0.8)
    if not near:
        return ""
    places = homes[near[0]]
    places = [package] if package in places else places
    return ". Did you mean: " + ", or ".join(f"from {place} import {near[0]}" for place in places) + "?"


def _imports(frame) -> bool:
    """Return whether a frame is executing ``from … import name``."""
    return frame.f_code.co_code[frame.f_lasti] == _IMPORT_FROM


class _PackageOfHomonyms(ModuleType):
    """Package with a public name that is also the name of its module: importing the module does not replace it."""

    def __setattr__(self, name, value):
        if not (isinstance(value, ModuleType) and name in self.__dict__["_homonyms"]):
            super().__setattr__(name, value)


class _MovedModules:
    """Importer of the paths in `MOVED_MODULES`: each gives the module, or the modules, that hold its names now."""

    def find_spec(self, fullname, path=None, target=None):
        if fullname in MOVED_MODULES:
            # Paths below it may have moved too.
            return importlib.machinery.ModuleSpec(fullname, self, is_package=True)  # type: ignore[arg-type]
        return None

    def create_module(self, spec):
        return None

    def exec_module(self, module: ModuleType) -> None:
        targets = MOVED_MODULES[module.__name__]
        if len(targets) == 1:
            sys.modules[module.__name__] = importlib.import_module(*targets)
            return
        homes = tuple(importlib.import_module(target) for target in targets)

        def load(name: str):
            for home in homes:
                if not name.startswith("__") and hasattr(home, name):
                    return getattr(home, name)
            raise AttributeError(f"module {module.__name__!r} has no attribute {name!r}")

        module.__getattr__ = load  # type: ignore[method-assign]
        module.__dir__ = lambda: sorted({name for home in homes for name in dir(home)})  # type: ignore[method-assign]
        module.__doc__ = f"Earlier path of names that live in {' and '.join(targets)}."


if not any(type(finder).__name__ == "_MovedModules" for finder in sys.meta_path):
    sys.meta_path.append(_MovedModules())  # type: ignore[arg-type]
