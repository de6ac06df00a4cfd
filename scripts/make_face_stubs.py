"""Write odak/learn/_faces: what editors and type checkers know of the torch functions that the core is made into.

    PYTHONPATH=. python scripts/make_face_stubs.py

A type checker cannot follow how :func:`odak.learn._face.torch_face` changes a signature: other defaults, tensors for
arrays, no `xp`. This writes the signatures that the functions have at run time, a stub for each module that makes such
functions, which it imports for type checkers. test/learn/test_face.py compares.
"""

import importlib
import inspect
import re
import types
import typing
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STUBS = ROOT / "odak" / "learn" / "_faces"
HEAD = '''"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch
'''


def faces() -> dict[str, dict[str, types.FunctionType]]:
    """Return the functions that torch_face made, by modules and by the names of their variables."""
    found = {}
    for path in sorted((ROOT / "odak" / "learn").rglob("*.py")):
        if "from odak.learn._face import" in path.read_text(encoding="utf-8"):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            found[name] = {
                variable: value
                for variable, value in sorted(vars(importlib.import_module(name)).items())
                if getattr(value, "__is_face__", False) and value.__module__ == name
            }
    return found


def stub_texts() -> dict[Path, str]:
    """Return the texts of the stubs by their files."""
    return {
        STUBS / f"{module.removeprefix('odak.learn.').replace('.', '_')}.pyi": _stub_text(functions)
        for module, functions in faces().items()
    }


def _stub_text(functions: dict[str, types.FunctionType]) -> str:
    """Return the text of the stub of a module."""
    written = [HEAD]
    for variable, face in functions.items():
        signature = inspect.signature(face)
        parameters, before = [], None
        for parameter in signature.parameters.values():
            if parameter.kind is parameter.KEYWORD_ONLY and before is not parameter.KEYWORD_ONLY:
                parameters.append("*")
            before = parameter.kind
            star = "*" if before is parameter.VAR_POSITIONAL else "**" if before is parameter.VAR_KEYWORD else ""
            text = f"{star}{parameter.name}: {_spelt(parameter.annotation)}"
            parameters.append(text if parameter.default is parameter.empty else f"{text} = {_default(parameter)}")
        summary = inspect.getdoc(face).split("\n\n")[0].replace("\n", " ").replace("\\", "\\\\")
        written.append(
            f"def {variable}(\n    "
            + ",\n    ".join(parameters)
            + f",\n) -> {_spelt(signature.return_annotation)}:\n"
            + f'    """{summary}"""\n    ...\n'
        )
    text = "\n".join(written[1:])
    modules = sorted(set(re.findall(r"\bodak(?:\.[a-z]\w*)+(?=\.[A-Z])", text)))
    return HEAD + "\n" + "".join(f"import {module}\n" for module in modules) + "\n" + text


def _spelt(annotation) -> str:
    """Return a type as it is written in the stub."""
    if annotation is None or annotation is type(None):
        return "None"
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        return " | ".join(_spelt(part) for part in inner)
    if origin is not None and origin is not typing.Literal:
        parts = [
            f"[{', '.join(map(_spelt, part))}]" if isinstance(part, list) else "..." if part is ... else _spelt(part)
            for part in inner
        ]
        return f"{_spelt(origin)}[{', '.join(parts)}]"
    if isinstance(annotation, type):
        home = "" if annotation.__module__ == "builtins" else f"{annotation.__module__}."
        return (home + annotation.__qualname__).replace("numpy.random._generator", "numpy.random")
    return repr(annotation)


def _default(parameter) -> str:
    plain = isinstance(parameter.default, (int, float, str, bool, tuple, type(None)))
    if parameter.default is None and not _spelt(parameter.annotation).endswith("None"):
        plain = False  # a mark of what is not given, which callers do not write
    return repr(parameter.default) if plain else "..."


if __name__ == "__main__":
    for file, text in stub_texts().items():
        file.write_text(text, encoding="utf-8")
