"""Files of arrays with units: HDF5, written and read; sizes are checked before reading, and each field afterwards."""

import json
import math
import os
import secrets
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak.tools.file import MOST_BYTES
from odak.tools.paths import regular_file, validate_path, write_file

SUFFIXES = (".h5", ".hdf5")
# Bytes of arrays for each byte of a file, above MOST_BYTES; what compresses better is stored as it is.
MOST_INFLATION = 64
# Data sets, attributes and bytes of an attribute at most; files have some ten of each.
MOST_ENTRIES, MOST_ATTRIBUTES, LONGEST_ATTRIBUTE = 64, 256, 1 << 16
# A chunk is decompressed whole, and found in a tree; h5py makes chunks of 8 kB to 1 MB.
LARGEST_CHUNK, SMALLEST_CHUNK, FEW_CHUNKS = 32 << 20, 4096, 4096
# Identifiers of filters of HDF5 that undo no more than one compression: deflate, shuffle, Fletcher's checksum.
DEFLATE, FILTERS = 1, {1, 2, 3}


def write_hdf5(
    path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray], header: Mapping[str, Any], units: Mapping[str, str]
) -> None:
    """Write arrays with units and a header to an HDF5 file, which appears whole or not at all.

    The file is made in memory: HDF5 itself ends the process when a disk is full.

    Parameters
    ----------
    path : str or os.PathLike
        ``.h5`` or ``.hdf5`` file.
    arrays : mapping
        Data sets by name.
    header : mapping
        Attributes of the file: "format", a text, and numbers or lists of numbers.
    units : mapping
        Unit of each quantity by its name.

    Raises
    ------
    OSError
        If the disk is full; the error names the file, and one that was there before remains.
    """
    h5py = _h5py()
    path = validate_path(path, SUFFIXES)
    promised = sum(np.asarray(value).nbytes for value in arrays.values())
    for packed in ({"compression": "gzip", "shuffle": True}, {}):
        # HDF5 opens a name once, even of files in memory: threads that save at the same time need names of their own.
        name = f"{secrets.token_hex(16)}.h5"
        with h5py.File(name, "w", driver="core", backing_store=False, block_size=1 << 20) as store:
            for key, value in arrays.items():
                made = store.create_dataset(key, data=value, **(packed if np.size(value) > 64 else {}))
                made.attrs["units"] = units.get(key, "1")
            store.attrs.update({**header, "units": json.dumps(units, ensure_ascii=False)})
            store.attrs["format"] = np.bytes_(header["format"])
            store.flush()
            image = store.id.get_file_image()
        if promised <= _most(len(image)):
            break
    write_file(path, image)


def read_hdf5(path: str | os.PathLike[str], kind: str, version: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the data sets and the attributes of an HDF5 file.

    Parameters
    ----------
    path : str or os.PathLike
        ``.h5`` or ``.hdf5`` file.
    kind, version : str and int
        Format and version that it must have.

    Returns
    -------
    tuple of dict
        Arrays and attributes by name.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is another file, or would take far more memory than its size; the message does not name the file.
    """
    h5py = _h5py()
    path = validate_path(path, SUFFIXES)
    if not os.path.exists(path):
        raise FileNotFoundError(f"there is no file {path!r}")
    try:
        with h5py.File(regular_file(path), "r") as store:
            header = _attributes(store)
            if header.get("format", kind) != kind or header.get("version") != version:
                raise ValueError(f"its format is {header.get('format')!r}, version {header.get('version')!r}")
            if len(store) > MOST_ENTRIES:
                raise ValueError(f"it has {len(store)} arrays; at most {MOST_ENTRIES} are read")
            for name in store:
                _check_promise(h5py, store, name)
            promised, most = sum(store[name].nbytes for name in store), _most(os.path.getsize(path))
            if promised > most:
                raise ValueError(f"its arrays take {promised} bytes; at most {most} are read from a file of its size")
            return {name: store[name][()] for name in store}, header
    # Broken files make h5py raise errors of many types.
    except (OSError, KeyError, RuntimeError, TypeError, ValueError, ArithmeticError, MemoryError) as error:
        raise ValueError(str(error) or type(error).__name__) from error


def _most(size: int) -> int:
    """Return the bytes that the arrays of a file of so many bytes may take."""
    return max(MOST_BYTES, MOST_INFLATION * size)


def _attributes(store: Any) -> dict[str, Any]:
    """Return the attributes of a file: numbers, and texts of fixed length.

    Texts of variable length are left out: HDF5 takes memory for the length that a broken one states, up to gigabytes,
    and loops for ever over a broken heap of them. In earlier files the format was such a text.
    """
    if len(store.attrs) > MOST_ATTRIBUTES:
        raise ValueError(f"it has {len(store.attrs)} attributes; at most {MOST_ATTRIBUTES} are read")
    found = {}
    for name in store.attrs:
        held = store.attrs.get_id(name)
        if math.prod(held.shape) * held.dtype.itemsize > LONGEST_ATTRIBUTE:
            raise ValueError(f"its attribute {name!r} is longer than {LONGEST_ATTRIBUTE} bytes")
        if held.dtype.kind in "iufS":
            value = store.attrs[name]
            found[name] = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return found


def _check_promise(h5py: Any, store: Any, name: str) -> None:
    """Raise ValueError unless an entry of a file is an array of numbers that is read without surprises."""
    # Data sets that lie in other files, or that are no numbers, are none of this format.
    kept = isinstance(store.get(name, getlink=True), h5py.HardLink) and isinstance(store[name], h5py.Dataset)
    if not kept or store[name].is_virtual or store[name].external or store[name].dtype.kind not in "iuf":
        raise ValueError(f"{name!r} is not an array of numbers within the file")
    held = store[name]
    if held.shape is None or held.chunks is None:
        return
    made = held.id.get_create_plist()
    filters = [made.get_filter(index)[0] for index in range(made.get_nfilters())]
    if not set(filters) <= FILTERS or filters.count(DEFLATE) > 1:
        raise ValueError(f"{name!r} is compressed more than once, or not by gzip")
    if math.prod(held.chunks) * held.dtype.itemsize > LARGEST_CHUNK:
        raise ValueError(f"{name!r} has chunks of more than {LARGEST_CHUNK} bytes")
    chunks = math.prod(-(-n // m) for n, m in zip(held.shape, held.chunks, strict=True))
    if chunks > FEW_CHUNKS + held.nbytes // SMALLEST_CHUNK:
        raise ValueError(f"{name!r} consists of {chunks} chunks, too many for its size")


def checked_number(name: str, value: Any, least: float, most: float, unit: str = "", *, whole: bool = False) -> Any:
    """Return a number of a file after checking that it is finite and within its range.

    Parameters
    ----------
    name : str
        Name of the field, for the message.
    value : number or array of one
        What the file holds.
    least, most : float
        The range.
    unit : str
        Unit in the message.
    whole : bool
        Whether it must be a whole number.
    """
    number = _validate.whole(name, value, minimum=-math.inf) if whole else float(_validate.number(name, value))
    return _validate.within(name, number, unit, least=least, most=most)


def checked_array(
    name: str, value: Any, shape: Sequence[int | str], least: float, most: float, *, whole: bool = False
) -> np.ndarray:
    """Return an array of a file after checking its shape and that all values are within their range.

    Parameters
    ----------
    name : str
        Name of the field, for the message.
    value : array
        What the file holds.
    shape : sequence of int or str
        Lengths of the axes; a text stands for any length from 1.
    least, most : float
        The range of its values.
    whole : bool
        Whether it must consist of integers; it is float64 otherwise.
    """
    array = np.asarray(_validate.array(name, value))
    if array.dtype.kind not in ("iu" if whole else "iuf"):
        raise TypeError(f"{name} must be {'integers' if whole else 'real'}, got {array.dtype}")
    _validate.shaped(name, array, f"[{', '.join(map(str, shape))}]")
    if not array.size:
        raise ValueError(f"{name} must not be empty, got {list(array.shape)}")
    low, high = array.min(), array.max()
    # Not-a-number, which spreads to both, is within no range.
    if not (least <= low and high <= most):
        wrong = low if not least <= low else high
        raise ValueError(f"{name} must be from {least:g} to {most:g}, got {wrong:g}")
    return array if whole else array.astype(np.float64, copy=False)


def _h5py() -> Any:
    return _validate.optional("h5py", "HDF5 files need h5py: pip install h5py")
