"""The examples of functions that `torch_face` makes, which doctest does not find by itself, run."""

import doctest
import importlib
import inspect
import pkgutil

import odak.learn
from odak.learn import _face


def faces():
    """Return the functions made by torch_face, by module path and name."""
    found = {}
    for module in pkgutil.walk_packages(odak.learn.__path__, "odak.learn."):
        for name, value in vars(importlib.import_module(module.name)).items():
            if inspect.isfunction(value) and value.__globals__ is vars(_face) and value.__module__ != _face.__name__:
                found[f"{module.name}.{name}"] = value
    return found


def test_examples_of_faces_run():
    made = faces()
    runner, printed = doctest.DocTestRunner(), []
    for path, function in made.items():
        parsed = doctest.DocTestParser().get_doctest(function.__doc__, {}, path, None, 0)
        runner.run(parsed, out=printed.append)
    assert len(made) > 60
    assert runner.failures == 0, "".join(printed)
