"""Weights of modules in files: written whole or not at all, read without running code, checked before use."""

import itertools
import os
from collections.abc import Iterable

import torch
from torch import nn

from odak._validate import texts
from odak.learn._tensors import checked_device
from odak.learn.tools._checkpoints import first_line
from odak.learn.tools._torch_files import read_torch_file
from odak.tools._atomic import replacing
from odak.tools._paths import validate_path

EXTENSIONS = (".pt", ".pth")

_LISTED = 20


def save_weights(module: nn.Module, filename: str | os.PathLike, *, extensions: Iterable[str] = EXTENSIONS) -> None:
    """Write the state dict of a module to a file, which appears whole or not at all.

    Parameters
    ----------
    module : torch.nn.Module
        Module whose parameters and buffers are written.
    filename : str or os.PathLike
        File to write; an older one stays as it was until the new one is complete.
    extensions : iterable of str
        Extensions accepted.

    Raises
    ------
    ValueError
        If the path is not acceptable or its folder does not exist.
    """
    with replacing(validate_path(filename, texts("extensions", extensions))) as stream:
        torch.save(_module(module).state_dict(), stream)


def load_weights(
    module: nn.Module,
    filename: str | os.PathLike,
    *,
    device: torch.device | str | None = None,
    extensions: Iterable[str] = EXTENSIONS,
) -> None:
    """Read a state dict from a file into a module, and put the module in evaluation mode.

    A file that does not fit leaves the module as it was.

    Parameters
    ----------
    module : torch.nn.Module
        Module to fill; it stays on its device and keeps its dtype.
    filename : str or os.PathLike
        File of :func:`save_weights`, or of ``torch.save(module.state_dict(), …)``.
    device : torch.device or str, optional
        Device to read the tensors to on their way; by default the module's own, so that a file written on a GPU can
        be read without one.
    extensions : iterable of str
        Extensions accepted.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the path is not acceptable; if the file is broken, would run code, or holds no state dict; or if its keys or
        shapes are not those of the module: the message names those missing, unexpected and of another shape.
    """
    path = validate_path(filename, texts("extensions", extensions))
    module, device = _module(module), checked_device("device", device)
    take_state(module, read_state(path, _device_of(module) if device is None else device), path)


def take_state(module: nn.Module, state: dict, path: str) -> None:
    """Fill a module with a state dict that came from a file, and put it in evaluation mode.

    Parameters
    ----------
    module : torch.nn.Module
        Module to fill; one that the state does not fit stays as it was.
    state : dict
        Names with a tensor each.
    path : str
        The file, for the error.

    Raises
    ------
    ValueError
        If the keys or shapes are not those of the module.
    """
    if misfits := _misfits(module.state_dict(), state):
        raise ValueError(f"{path!r} does not fit {type(module).__name__}: {'; '.join(misfits)}")
    module.load_state_dict(state)
    module.eval()


def read_state(path: str, device: torch.device | str | None) -> dict:
    """Return the state dict in a file, its tensors on a device, without running code."""
    try:
        state = read_torch_file(path, device)
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{path!r} cannot be read as weights: {first_line(error)}") from error
    if not isinstance(state, dict) or not all(isinstance(value, torch.Tensor) for value in state.values()):
        raise ValueError(f"{path!r} holds no state dict: names with a tensor each")
    return state


def _device_of(module) -> torch.device:
    first = next(itertools.chain(module.parameters(), module.buffers()), None)
    return torch.device("cpu") if first is None else first.device


def _misfits(wanted: dict, found: dict) -> list[str]:
    """Describe what keeps one state dict from taking the place of another."""
    # Older files of batch norms count no batches; torch starts that count at zero.
    missing = [key for key in wanted if key not in found and not key.endswith("num_batches_tracked")]
    unexpected = [key for key in found if key not in wanted]
    reshaped = [
        f"{key} {tuple(found[key].shape)} instead of {tuple(wanted[key].shape)}"
        for key in wanted
        if key in found and found[key].shape != wanted[key].shape
    ]
    groups = {"missing": missing, "unexpected": unexpected, "of another shape": reshaped}
    return [f"{title}: {_listed(keys)}" for title, keys in groups.items() if keys]


def _listed(keys) -> str:
    rest = len(keys) - _LISTED
    return ", ".join(map(str, keys[:_LISTED])) + (f" and {rest} more" if rest > 0 else "")


def _module(module) -> nn.Module:
    if not isinstance(module, nn.Module):
        raise TypeError(f"module must be a torch.nn.Module, got {type(module).__name__}")
    return module
