"""Files of torch.save from elsewhere: read without running code, without reading beyond them, and within their size."""

import mmap
import os
import pickle
import re
import zipfile
from typing import Any

import torch

# Called with a number, as torch lets a file do, it makes as many bytes, whatever the size of the file.
_INFLATES = b"bytearray\n"


class UnsafeFileError(pickle.UnpicklingError, ValueError):
    """The file would run code, take far more memory than its size, or is not one of torch's."""


def read_torch_file(path: str | os.PathLike, device: torch.device | str | None = None) -> Any:
    """Return what a file of :func:`torch.save` holds, without running code.

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
            torch.load(name, map_location=_where_it_is, weights_only=True, mmap=True)
        # Indices beyond a sparse tensor's size would be followed into other memory when it is used.
        with torch.sparse.check_sparse_tensor_invariants():
            found = torch.load(name, map_location=device, weights_only=True)
        _refuse_odd_tensors(found)
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


def _refuse_odd_tensors(value) -> None:
    """Raise ValueError for a tensor that brings code to call with its gradient, or shapes that torch did not check."""
    if isinstance(value, torch.Tensor):
        if value._backward_hooks is not None and value._backward_hooks != {}:
            raise ValueError("it holds a tensor with hooks")
        if value.is_nested or value.is_quantized:
            raise ValueError("it holds a nested or a quantized tensor; store plain ones")
        if any(n < 0 for n in value.shape):
            raise ValueError(f"it holds a tensor of shape {list(value.shape)}")
    elif isinstance(value, (dict, list, tuple)):
        for inner in value.values() if isinstance(value, dict) else value:
            _refuse_odd_tensors(inner)


def _where_it_is(storage, location):
    return storage


def _check(name: str) -> bool:
    """Say whether a file is an archive, after refusing what would take far more memory than it has bytes."""
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
        raise ValueError("it holds a bytearray; store bytes as a tensor of torch.uint8")
