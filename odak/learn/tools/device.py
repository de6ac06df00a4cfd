"""Where tensors live."""

import difflib
from functools import lru_cache

import torch

from odak.log import logger


def get_device(device: torch.device | str | None = "auto") -> torch.device:
    """Return a device to compute on.

    Parameters
    ----------
    device : torch.device or str, optional
        ``"auto"`` or None takes the GPU when CUDA finds one and the CPU otherwise. CUDA asked for by name on a machine
        without it gives the CPU, with one warning in the log per process.

    Returns
    -------
    torch.device
        The device.

    Raises
    ------
    TypeError
        If `device` is neither a device nor a string.
    ValueError
        If torch knows no device of that name.
    """
    if device is None or (isinstance(device, str) and device.strip().lower() == "auto"):
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if not isinstance(device, (torch.device, str)):
        raise TypeError(f"device must be a torch.device or a string, got {type(device).__name__}")
    chosen = _parse(device)
    if chosen.type == "cuda" and not torch.cuda.is_available():
        _warn_once()
        return torch.device("cpu")
    return chosen


def _parse(device):
    try:
        return torch.device(device)
    except RuntimeError:
        near = difflib.get_close_matches(device.lower(), ("auto", "cpu", "cuda", "mps"), n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ValueError(
            f"device must be 'auto', 'cpu', 'cuda', 'cuda:0' or another that torch knows; got {device!r}.{hint}"
        ) from None


@lru_cache(maxsize=1)
def _warn_once():
    logger.warning("CUDA was asked for and there is none on this machine: the CPU is used instead")
