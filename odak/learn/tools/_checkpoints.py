"""What every run that can be interrupted needs: a file with its state, and random numbers of its own."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import torch

from odak import _validate
from odak.learn.tools._torch_files import read_torch_file
from odak.tools._atomic import replacing


def write_checkpoint(path: str | os.PathLike, state: dict[str, Any]) -> None:
    """Write the state of a run, whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    state : dict
        Tensors, numbers, words, and lists and dictionaries of them; ``state["about"]`` says what run it is of.
    """
    with replacing(os.fspath(path)) as stream:
        torch.save(state, stream)


def read_checkpoint(
    path: str | os.PathLike, device: torch.device, parts: Iterable[str], about: dict[str, Any], kind: str
) -> dict[str, Any]:
    """Read the state of a run, without running code.

    Parameters
    ----------
    path : str or os.PathLike
        File of :func:`write_checkpoint`.
    device : torch.device
        Where its tensors go.
    parts : iterable of str
        Names that the state must hold, besides "about".
    about : dict
        Numbers and words that the state must agree with.
    kind : str
        What such a run is, with its article, for messages.

    Returns
    -------
    dict
        The state.

    Raises
    ------
    ValueError
        If the file is broken, would run code, or is not of such a run.
    """
    name = repr(os.fspath(path))
    try:
        state = read_torch_file(path, device)
    except Exception as error:
        raise ValueError(f"checkpoint {name} cannot be read: {first_line(error)}") from error
    if not isinstance(state, dict) or not {"about", *parts} <= set(state):
        raise ValueError(f"checkpoint {name} is not one of {kind}")
    before = state["about"]
    if not isinstance(before, dict):
        raise ValueError(f"checkpoint {name} is not one of {kind}: it does not say what run it is of")
    if before != about:
        differing = sorted(key for key in {*before, *about} if before.get(key) != about.get(key))
        raise ValueError(f"checkpoint {name} is of another run: its {', '.join(differing)} differ")
    return state


@contextmanager
def taking_up(path: str | os.PathLike) -> Iterator[None]:
    """Turn what goes wrong while a state is taken up into a ValueError that names its file.

    Parameters
    ----------
    path : str or os.PathLike
        File of :func:`write_checkpoint`, perhaps broken or from elsewhere.

    Raises
    ------
    ValueError
        In place of any other error.
    """
    try:
        yield
    except Exception as error:
        if os.fspath(path) in str(error):
            raise
        reason = f"{type(error).__name__}: {first_line(error)}"
        raise ValueError(f"checkpoint {os.fspath(path)!r} cannot be taken up ({reason})") from error


@contextmanager
def own_randomness(seed: int | None, device: torch.device) -> Iterator[None]:
    """Seed torch's generators for a while and give them back as they were.

    Parameters
    ----------
    seed : int, optional
        Seed; drawn from torch's generator by default.
    device : torch.device
        A GPU whose generator is taken too.
    """
    if seed is None:
        seed = int(torch.randint(2**31, ()))
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        torch.manual_seed(_validate.integer("seed", seed))
        yield


def randomness(device: torch.device) -> list[torch.Tensor]:
    """Return the states of torch's generators: the CPU's, and that of a GPU."""
    return [torch.get_rng_state(), *([torch.cuda.get_rng_state(device)] if device.type == "cuda" else [])]


def set_randomness(states: list[torch.Tensor], device: torch.device) -> None:
    """Take up states that :func:`randomness` returned."""
    torch.set_rng_state(states[0].cpu())
    if device.type == "cuda" and len(states) > 1:
        torch.cuda.set_rng_state(states[1].cpu(), device)


def first_line(error: Exception) -> str:
    """Return the first line of an error, or its kind: that of an empty file says nothing."""
    return (str(error) or type(error).__name__).splitlines()[0]
