"""Valid arguments of the public calls, one module for each part of the package.

A module may hold, each optional:

``BY_NAME``      {prefix of a path: {argument: valid value}}; the longest prefix wins
``BY_CALL``      {path: {argument: valid value}}, before any ``BY_NAME``
``NOT_CALLED``   {pattern of paths: reason}
``ALLOWED``      {(pattern of paths, pattern of arguments, pattern of wrong values): reason}, patterns as of fnmatch
``POSITIVE``     {prefix of a path: {arguments that must be above zero}}
``SIDES``        {prefix of a path: {arguments that are numbers of samples along an axis}}
``FREE_TEXT``    {prefix of a path: {arguments that take any text}}
"""

import importlib
import pkgutil


def _gathered(name):
    return {
        key: value
        for module in pkgutil.iter_modules(__path__)
        for key, value in getattr(importlib.import_module(f"{__name__}.{module.name}"), name, {}).items()
    }


BY_NAME = _gathered("BY_NAME")
BY_CALL = _gathered("BY_CALL")
NOT_CALLED = _gathered("NOT_CALLED")
ALLOWED = _gathered("ALLOWED")
POSITIVE = _gathered("POSITIVE")
FREE_TEXT = _gathered("FREE_TEXT")
SIDES = _gathered("SIDES")
