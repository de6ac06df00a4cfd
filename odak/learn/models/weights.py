"""Reading and writing of the weights of modules: without execution of code, checked before they are loaded."""

import itertools
import os
from collections.abc import Iterable

import torch
from torch import nn

from odak._validate import texts
from odak.learn._tensors import checked_device
from odak.learn.tools.file import first_line, read_torch_file
from odak.tools.paths import replacing, validate_path

EXTENSIONS = (".pt", ".pth")

_LISTED = 20


def save_weights(module: nn.Module, filename: str | os.PathLike, *, extensions: Iterable[str] = EXTENSIONS) -> None:
    """Write the state dict of a module to a file, atomically.

    Parameters
    ----------
    module : torch.nn.Module
        Module whose parameters and buffers are written.
    filename : str or os.PathLike
        File to write; an existing one stays as it is until the new one is complete.
    extensions : iterable of str
        Accepted extensions.

    Raises
    ------
    ValueError
        If the path is not acceptable or its folder does not exist.

    Examples
    --------
    >>> import os, tempfile
    >>> import torch
    >>> from odak.learn.models import load_weights, save_weights
    >>> first, second = torch.nn.Linear(2, 1), torch.nn.Linear(2, 1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "weights.pt")
    ...     save_weights(first, name)
    ...     load_weights(second, name)
    >>> torch.equal(first.weight, second.weight)
    True
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

    If the file does not fit, the module stays unchanged.

    Parameters
    ----------
    module : torch.nn.Module
        Module to load the weights into; it keeps its device and dtype.
    filename : str or os.PathLike
        File of :func:`save_weights`, or of ``torch.save(module.state_dict(), …)``.
    device : torch.device or str, optional
        Device that the file is read to; by default that of the module, so that a file written on a GPU can be read
        without one.
    extensions : iterable of str
        Accepted extensions.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the path is not acceptable; if the file is broken, would run code, or holds no state dict; or if its keys or
        shapes are not those of the module: the message names those missing, unexpected and of another shape.

    Examples
    --------
    >>> import os, tempfile
    >>> import torch
    >>> from odak.learn.models import load_weights, save_weights
    >>> first, second = torch.nn.Linear(2, 1), torch.nn.Linear(2, 1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "weights.pt")
    ...     save_weights(first, name)
    ...     load_weights(second, name)
    >>> torch.equal(first.weight, second.weight)
    True
    """
    path = validate_path(filename, texts("extensions", extensions))
    module, device = _module(module), checked_device("device", device)
    set_state(module, read_state(path, _device_of(module) if device is None else device), path)


def set_state(module: nn.Module, state: dict, path: str) -> None:
    """Load a state dict read from a file into a module, and put the module in evaluation mode.

    Parameters
    ----------
    module : torch.nn.Module
        Module to load the state into; it stays unchanged if the state does not fit.
    state : dict
        Tensors by name.
    path : str
        Path of the file, for error messages.

    Raises
    ------
    ValueError
        If the keys or shapes are not those of the module.
    """
    if differences := _differences(module.state_dict(), state):
        raise ValueError(f"{path!r} does not fit {type(module).__name__}: {'; '.join(differences)}")
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
        raise ValueError(f"{path!r} contains no state dict (tensors by name)")
    return state


def _device_of(module) -> torch.device:
    first = next(itertools.chain(module.parameters(), module.buffers()), None)
    return torch.device("cpu") if first is None else first.device


def _differences(wanted: dict, found: dict) -> list[str]:
    """Describe the differences in keys and shapes between two state dicts."""
    # Older files of batch norms have no counter of batches; torch then starts it at zero.
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
