"""Selection of the device of tensors, and advice where its memory is not sufficient."""

import difflib
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from odak._warnings import DeviceWarning, warn


def get_device(device: torch.device | str | None = "auto") -> torch.device:
    """Return a device to compute on.

    Parameters
    ----------
    device : torch.device or str, optional
        ``"auto"`` or None takes the GPU when CUDA finds one and the CPU otherwise. CUDA requested by name on a machine
        without it gives the CPU, with a warning.

    Returns
    -------
    torch.device
        The device.

    Warns
    -----
    DeviceWarning
        If CUDA is requested by name and is not available.

    Raises
    ------
    TypeError
        If `device` is neither a device nor a string.
    ValueError
        If there is no device of that name.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import get_device
    >>> get_device("cpu")
    device(type='cpu')
    """
    if device is None or (isinstance(device, str) and device.strip().lower() == "auto"):
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if not isinstance(device, (torch.device, str)):
        raise TypeError(f"device must be a torch.device or a string, got {type(device).__name__}")
    chosen = _parse(device)
    if chosen.type == "cuda" and not torch.cuda.is_available():
        warn(f"{chosen} was requested and there is no CUDA device: the CPU is used instead", DeviceWarning)
        return torch.device("cpu")
    return chosen


def _parse(device):
    try:
        return torch.device(device)
    except RuntimeError:
        near = difflib.get_close_matches(device.lower(), ("auto", "cpu", "cuda", "mps"), n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ValueError(
            f"device must be 'auto', 'cpu', 'cuda', 'cuda:0' or another device of torch; got {device!r}.{hint}"
        ) from None


@contextmanager
def advising_on_memory(advice: str) -> Iterator[None]:
    """Add a sentence of advice to the error that torch raises when a GPU has no memory left.

    Parameters
    ----------
    advice : str
        What takes less memory, such as "use fewer planes".

    Raises
    ------
    torch.OutOfMemoryError
        The same kind of error, torch's own text after the advice.
    """
    try:
        yield
    except torch.cuda.OutOfMemoryError as error:
        raise torch.cuda.OutOfMemoryError(
            f"The memory of the GPU is not sufficient; {advice}. Message of torch: {error}"
        ) from error
