"""Reading of untrusted files of torch.save, and the state of runs that can be interrupted."""

import mmap
import os
import pickle
import re
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import torch

from odak import _torch_private, _validate
from odak.tools.paths import replacing

# Called with a number, as a file can request, it allocates so many bytes, independently of the size of the file.
_INFLATES = b"bytearray\n"
# Entries of lists and dictionaries, shared ones counted each time, allowed in any file; more only one for each byte.
_LEAST_LIMIT = 1_000_000


class UnsafeFileError(pickle.UnpicklingError, ValueError):
    """The file would run code, takes far more memory than its size, or is not one of torch."""


def read_torch_file(path: str | os.PathLike, device: torch.device | str | None = None) -> Any:
    """Return the content of a file of :func:`torch.save`, without running code.

    The length of a tensor comes from the file's pickle and its bytes from another record, which not every release of
    torch compares. So the file is first mapped into memory, and its tensors laid over that.

    Parameters
    ----------
    path : str or os.PathLike
        The file.
    device : torch.device or str, optional
        Where tensors go; by default where they were.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    UnsafeFileError
        If the file would run code, is broken, or would take far more memory than its size; a ValueError too.
    """
    name = os.fspath(path)
    try:
        if _check(name):
            # Mapped memory cannot grow: a tensor that claims more than there is, is refused before anything is read.
            torch.load(name, map_location=lambda storage, _: storage, weights_only=True, mmap=True)
        # Indices beyond a sparse tensor's size would be followed into other memory when it is used.
        with torch.sparse.check_sparse_tensor_invariants():
            found = torch.load(name, map_location=device, weights_only=True)
        limit = max(_LEAST_LIMIT, os.path.getsize(name))
        _refuse_odd_content(found, limit, meta=device is not None and torch.device(device).type == "meta")
        return found
    except (FileNotFoundError, IsADirectoryError, PermissionError):
        raise
    except Exception as error:
        # The unpickler and the archive reader raise what they stumble on: IndexError, KeyError, struct.error …
        raise UnsafeFileError(f"Failed to load {name!r}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Return one line; torch's own begins with how to run the code in the file."""
    found = re.search(r"GLOBAL (\S+\.\S+)", str(error))
    if found:
        return f"it calls for {found[1]}, and no code of a file is run"
    if isinstance(error, pickle.UnpicklingError):
        return "it is not one of torch's, or its pickle is broken"
    return (str(error) or type(error).__name__).splitlines()[0]


def _refuse_odd_content(value, limit: int, meta: bool) -> None:
    """Raise ValueError for what no walk would finish and for tensors that are not plain ones, each looked at once.

    Parameters
    ----------
    value : object
        Content of the file.
    limit : int
        Largest number of entries that whoever walks the lists and dictionaries may meet: shared ones count each time.
    meta : bool
        Accept tensors without data, because the caller requested the device "meta".
    """
    entries: dict[int, int] = {}  # of each list met so far; 0 while its own entries are looked at
    waiting = [value]
    while waiting:
        value = waiting[-1]
        if isinstance(value, torch.Tensor):
            _refuse_odd_tensor(value, meta)
        inner = [*value.keys(), *value.values()] if isinstance(value, dict) else value
        if not isinstance(inner, (list, tuple, set, frozenset)):
            waiting.pop()
            continue
        lists = [item for item in inner if isinstance(item, (dict, list, tuple, set, frozenset))]
        if id(value) not in entries:
            entries[id(value)] = 0
            waiting += [item for item in inner if id(item) not in entries]
            if any(entries.get(id(item)) == 0 for item in lists):
                raise ValueError("it contains a list that contains itself")
            continue
        waiting.pop()
        if entries[id(value)] == 0:
            entries[id(value)] = 1 + len(inner) + sum(entries[id(item)] for item in lists)
            if entries[id(value)] > limit:
                raise ValueError("its lists share one another, so that walking through them would take for ever")


def _refuse_odd_tensor(tensor: torch.Tensor, meta: bool) -> None:
    """Raise ValueError for a tensor with code to call with its gradient, or more elements than it has memory."""
    if _torch_private.has_hooks(tensor):
        raise ValueError("it contains a tensor with hooks")
    if tensor.is_nested or tensor.is_quantized:
        raise ValueError("it contains a nested or a quantized tensor; store plain ones")
    if any(n < 0 for n in tensor.shape):
        raise ValueError(f"it contains a tensor of shape {list(tensor.shape)}")
    if tensor.is_meta and not meta:
        raise ValueError("it contains a tensor without data (of the device 'meta')")
    if tensor.layout == torch.sparse_coo:
        parts = _torch_private.entries_of_sparse(tensor)
    elif tensor.layout in (torch.sparse_csr, torch.sparse_bsr):
        parts = [tensor.crow_indices(), tensor.col_indices(), tensor.values()]
    elif tensor.layout in (torch.sparse_csc, torch.sparse_bsc):
        parts = [tensor.ccol_indices(), tensor.row_indices(), tensor.values()]
    else:
        parts = [tensor]
    for part in parts:
        if part.numel() * part.element_size() > part.untyped_storage().nbytes():
            raise ValueError(
                f"it contains a tensor of shape {list(part.shape)}, longer than its data; store a copy of it"
            )


def _check(name: str) -> bool:
    """Return whether a file is an archive; raise an error if loading it would take far more memory than its size."""
    with open(name, "rb") as stream:
        if stream.read(4) != b"PK\x03\x04":
            if os.path.getsize(name):
                with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
                    _refuse_inflation(content)
            return False
    with zipfile.ZipFile(name) as archive:
        records = archive.infolist()
        if any(record.compress_type != zipfile.ZIP_STORED for record in records):
            raise ValueError("its records are compressed, and torch writes none that are")
        if sum(record.file_size for record in records) > os.path.getsize(name):
            raise ValueError("its records claim more bytes than the file has")
        for record in records:
            if record.filename.endswith("data.pkl"):
                _refuse_inflation(archive.read(record))
    return True


def _refuse_inflation(content) -> None:
    if content.find(_INFLATES) >= 0:
        raise ValueError("it contains a bytearray; store bytes as a tensor of torch.uint8")


def write_checkpoint(path: str | os.PathLike, state: dict[str, Any]) -> None:
    """Write the state of a run, whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    state : dict
        Tensors, numbers, words, and lists and dictionaries of them; ``state["about"]`` identifies the run.
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
        Required keys of the state, besides "about".
    about : dict
        Values that the state must agree with.
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
        raise ValueError(f"checkpoint {name} is not one of {kind}: it does not state to which run it belongs")
    if before != about:
        differing = sorted(key for key in {*before, *about} if before.get(key) != about.get(key))
        raise ValueError(f"checkpoint {name} is of another run: its {', '.join(differing)} differ")
    return state


@contextmanager
def taking_up(path: str | os.PathLike) -> Iterator[None]:
    """Convert errors while a state is restored to a ValueError that names its file.

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
    """Seed torch's generators within a block and restore their states at its end.

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
    """Restore states that :func:`randomness` returned."""
    torch.set_rng_state(states[0].cpu())
    if device.type == "cuda" and len(states) > 1:
        torch.cuda.set_rng_state(states[1].cpu(), device)


def first_line(error: Exception) -> str:
    """Return the first line of an error, or its type if the message is empty."""
    return (str(error) or type(error).__name__).splitlines()[0]
