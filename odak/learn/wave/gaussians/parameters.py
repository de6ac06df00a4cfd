"""Files, phase range and settings shared by the sets of complex-valued Gaussians."""

import math
import os
from collections.abc import Iterable
from typing import Any

import torch

from odak import _validate
from odak.learn.tools.file import first_line, save_torch_tensor, torch_load
from odak.tools.paths import validate_path

EXTENSIONS = (".pth", ".pt")


def save(path: str | os.PathLike, contents: dict[str, Any], name: str = "path") -> None:
    """Write tensors by name to a ``.pth`` or ``.pt`` file, whole or not at all.

    Raises
    ------
    ValueError
        If the path is not acceptable or its folder does not exist.
    """
    save_torch_tensor(validate_path(path, EXTENSIONS, name=name), contents)


def load(path: str | os.PathLike, names: Iterable[str], device: torch.device, name: str = "path") -> dict[str, Any]:
    """Read what :func:`save` wrote.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the path is not acceptable, or the file is broken, would run code, or lacks one of the tensors.
    """
    path = validate_path(path, EXTENSIONS, name=name)
    try:
        contents = torch_load(path, map_location=device)
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{path!r} cannot be read as Gaussians: {first_line(error)}") from error
    if not isinstance(contents, dict):
        raise ValueError(f"{path!r} contains no Gaussians but a {type(contents).__name__}")
    if missing := [name for name in names if not isinstance(contents.get(name), torch.Tensor)]:
        raise ValueError(f"{path!r} contains no Gaussians: missing {', '.join(missing)}")
    return contents


def wrapped(phase: torch.Tensor) -> torch.Tensor:
    """Return a phase modulo 2π, from 0 up to but not 2π."""
    turned = torch.remainder(phase, 2 * math.pi)
    # A tiny negative phase is rounded up to 2π.
    return turned.where(turned < 2 * math.pi, turned - turned.detach())


def picture_size(name: str, size) -> tuple[int, int]:
    """Return the width and height of a picture as integers; raise ValueError for anything but two positive ones."""
    try:
        width, height = size
        return _validate.side(name, width), _validate.side(name, height)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be two positive integers (width, height), got {size!r}") from None


def lengths(values) -> torch.Tensor:
    """Return lengths in metres as a flat float64 tensor: phases of 10⁵ rad depend on them."""
    return torch.as_tensor(values, dtype=torch.float64).reshape(-1)


def settings(args_prop, names: Iterable[str]) -> list:
    """Return attributes of the settings in their order.

    Raises
    ------
    ValueError
        If there are no settings or an attribute is missing.
    """
    names = list(names)
    if missing := [name for name in names if not hasattr(args_prop, name)]:
        raise ValueError(f"args_prop must have {', '.join(names)}; missing {', '.join(missing)} in {args_prop!r}")
    return [getattr(args_prop, name) for name in names]
