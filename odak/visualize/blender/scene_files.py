"""Scenes as files: a JSON text, and beside it an NPZ file with the arrays that it names."""

import dataclasses
import hashlib
import io
import json
import math
import os
import struct
import tokenize
import zipfile
import zlib
from typing import Any

import numpy as np

from odak.tools._atomic import replacing
from odak.visualize.blender.items import Item
from odak.visualize.blender.materials import KINDS, Material

FORMAT = "odak scene"
VERSION = 1
MAXIMUM_BYTES = 256 << 20
ARRAYS = {"vertices": "f4", "faces": "i4", "normals": "f4", "colors": "f4", "uv": "f4", "image": "u1", "rods": "f4"}
# What NumPy lets through from the archive and from the header of an array.
_BROKEN_ARRAYS = (
    zipfile.BadZipFile,
    zlib.error,
    tokenize.TokenError,
    SyntaxError,
    EOFError,
    struct.error,
    # Compression that is not known, and encryption.
    RuntimeError,
)
_KEYS = ("unit", "metres", "wavelength", "objects", "lights", "camera", "background", "start_from", "remove", "render")


def write(path: str, document: dict) -> str:
    """Write a scene; each of the two files appears whole or not at all.

    Parameters
    ----------
    path : str
        Name that ends in ".json". The arrays go to the same name that ends in ".npz".
    document : dict
        What a scene is made of, its objects as :class:`Item`.

    Returns
    -------
    str
        The path.
    """
    arrays: dict[str, Any] = {}
    entries = [_entry(i, item, arrays) for i, item in enumerate(document["objects"])]
    store = os.path.splitext(path)[0] + ".npz"
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    with replacing(store) as stream:
        stream.write(packed.getbuffer())
    # Two files cannot be replaced at one instant: by this a text and the arrays of another are told apart.
    digest = hashlib.sha256(packed.getbuffer()).hexdigest()
    text = {"format": FORMAT, "version": VERSION, "arrays": os.path.basename(store), "arrays_sha256": digest}
    text |= document | {"objects": entries}
    with replacing(path) as stream:
        stream.write(json.dumps(text, indent=1, allow_nan=False).encode())
    return path


def read(path: str) -> dict:
    """Return what :func:`write` was given, its objects with their arrays in place of names.

    Raises
    ------
    ValueError
        If a file is missing, not a scene, of a later version, or contradicts itself.
    """
    try:
        if os.path.getsize(path) > MAXIMUM_BYTES:
            raise ValueError(f"larger than {MAXIMUM_BYTES} bytes")
        with open(path, encoding="utf-8") as stream:
            document = json.load(stream)
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise ValueError(f"not a scene: its format is not {FORMAT!r}")
        if document.get("version") != VERSION:
            raise ValueError(f"version must be {VERSION}, got {document.get('version')!r}")
        missing = [key for key in (*_KEYS, "arrays") if key not in document]
        if missing:
            raise ValueError(f"{', '.join(missing)} missing")
        name = document["arrays"]
        if not isinstance(name, str) or os.path.basename(name) != name:
            raise ValueError(f"arrays must be the name of a file beside it, got {name!r}")
        name = os.path.join(os.path.dirname(path), name)
        _check_digest(name, document.pop("arrays_sha256", None))
        with np.load(name, allow_pickle=False) as store:
            document["objects"] = [_with_arrays(entry, store) for entry in document["objects"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, *_BROKEN_ARRAYS) as error:
        raise ValueError(f"{path!r} cannot be read as a scene: {error}") from error
    return document


def _check_digest(store: str, digest: str | None) -> None:
    if os.path.getsize(store) > MAXIMUM_BYTES:
        raise ValueError(f"{os.path.basename(store)!r} is larger than {MAXIMUM_BYTES} bytes")
    if digest is None:
        return
    with open(store, "rb") as stream:
        if hashlib.sha256(stream.read()).hexdigest() != digest:
            raise ValueError(f"{os.path.basename(store)!r} holds the arrays of another scene")


def item_from(entry: dict) -> Item:
    """Return the object of an entry of :func:`read`."""
    material = Material(**entry["material"] | {"color": tuple(entry["material"]["color"])})
    return Item(**entry | {"material": material})


def _entry(number: int, item: Item, arrays: dict) -> dict:
    """Return an object as plain data, its arrays moved to `arrays` under names that take their place."""
    entry = {field.name: getattr(item, field.name) for field in dataclasses.fields(item)}
    entry["material"] = dataclasses.asdict(item.material)
    for key, dtype in ARRAYS.items():
        if entry[key] is not None:
            arrays[f"{number}.{key}"] = np.ascontiguousarray(entry[key], dtype="<" + dtype)
            entry[key] = f"{number}.{key}"
    return entry


def _array(store, name: str) -> np.ndarray:
    """Return an array of an archive, unless its header promises more than is there."""
    record = store.zip.getinfo(f"{name}.npy")
    if record.file_size > MAXIMUM_BYTES:
        raise ValueError(f"{name} is larger than {MAXIMUM_BYTES} bytes")
    with store.zip.open(record) as stream:
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        shape, _, dtype = read_header[np.lib.format.read_magic(stream)](stream)
        if math.prod(shape) * dtype.itemsize > record.file_size:
            raise ValueError(f"{name} is cut short: its header says {list(shape)}")
    return store[name]


def _with_arrays(entry: dict, store) -> dict:
    entry = dict(entry)
    for key, dtype in ARRAYS.items():
        if entry[key] is not None:
            entry[key] = _array(store, entry[key])
            if entry[key].dtype != np.dtype(dtype):
                raise ValueError(f"{key} of {entry['name']!r} must be {dtype}, got {entry[key].dtype}")
    count = len(entry["vertices"])
    if entry["faces"].size and not 0 <= entry["faces"].min() <= entry["faces"].max() < count:
        raise ValueError(f"a face of {entry['name']!r} names a vertex beyond its {count}")
    if entry["material"]["kind"] not in KINDS:
        raise ValueError(f"material of {entry['name']!r} must be one of {', '.join(KINDS)}")
    return entry
