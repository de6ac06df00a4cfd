"""Differentiable optics: wave optics, holography, ray tracing, polarisation and perception.

``odak`` holds the NumPy core; ``odak.learn`` is its PyTorch face. Subpackages load on first use, so that
``import odak`` itself costs next to nothing.
"""

import importlib
import math

pi = math.pi
version_info = (0, 3, 0)
__version__ = ".".join(str(part) for part in version_info)

_SUBPACKAGES = (
    "catalog",
    "cli",
    "fit",
    "jones",
    "learn",
    "log",
    "manager",
    "measurement",
    "raytracing",
    "tools",
    "visualize",
    "wave",
)

__all__ = ["__version__", "pi", "version_info", *_SUBPACKAGES]


def __getattr__(name: str):
    """Load a subpackage, or NumPy as `np`, on first use (PEP 562)."""
    if name in _SUBPACKAGES:
        return importlib.import_module(f"{__name__}.{name}")
    if name == "np":
        return importlib.import_module("numpy")
    raise AttributeError(
        f"module {__name__!r} has no attribute {name!r}; its subpackages are {', '.join(_SUBPACKAGES)}"
    )


def __dir__() -> list[str]:
    return sorted(__all__)
