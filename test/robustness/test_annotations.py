"""The package says that it is typed (py.typed): every public signature is annotated completely."""

import importlib
import inspect

import pytest

PACKAGES = (  # noqa: SIM905
    "catalog fit jones learn.jones learn.lensless learn.models learn.perception learn.raytracing "
    "learn.raytracing.system learn.tools learn.wave log manager measurement raytracing tools visualize "
    "visualize.blender visualize.plotly wave"
).split()


def functions_of(module):
    """Yield the name and the function behind every public name of a package: functions, constructors and methods."""
    for name in module.__all__:
        value = getattr(module, name)
        if inspect.isfunction(value):
            yield name, value
        elif inspect.isclass(value) and value.__module__.startswith("odak"):
            for attribute, member in vars(value).items():
                function = inspect.unwrap(getattr(member, "__func__", member))
                if inspect.isfunction(function) and (attribute == "__init__" or not attribute.startswith("_")):
                    yield f"{name}.{attribute}", function


@pytest.mark.parametrize("package", PACKAGES)
def test_public_signatures_are_annotated(package):
    missing = []
    for name, function in functions_of(importlib.import_module(f"odak.{package}")):
        if not function.__module__.startswith("odak"):
            continue
        signature = inspect.signature(function)
        for place, parameter in enumerate(signature.parameters.values()):
            if parameter.annotation is parameter.empty and not (place == 0 and parameter.name in ("self", "cls")):
                missing.append(f"{name}({parameter.name})")
        if signature.return_annotation is signature.empty and not name.endswith("__init__"):
            missing.append(f"{name} -> …")
    assert missing == []
