"""JSON and plain text, always UTF-8."""

import json
import os
from collections.abc import Iterable
from typing import Any

from odak._validate import one_of
from odak.tools._atomic import replacing
from odak.tools._paths import validate_path

_FLAGS = ("w", "a", "x", "r+", "w+", "a+")


def save_dictionary(settings: Any, filename: str | os.PathLike) -> Any:
    """Write settings as JSON, indented by four, with non-ASCII characters as they are.

    Parameters
    ----------
    settings : dict
        What to write. NumPy and PyTorch numbers are written as numbers, arrays and tensors as lists, paths as texts.
    filename : str or os.PathLike
        A ``.json`` file; an older one stays as it was until the new one is complete.

    Returns
    -------
    dict
        `settings`.

    Raises
    ------
    TypeError
        For values that JSON lacks, before the file is touched.
    ValueError
        If the path is not acceptable or its folder does not exist.
    """
    path = validate_path(filename, [".json"])
    content = json.dumps(settings, ensure_ascii=False, indent=4, default=_plain).encode()
    with replacing(path) as stream:
        stream.write(content)
    return settings


def _plain(value):
    """Return what JSON can hold in place of a number or array of NumPy or PyTorch, or of a path."""
    if hasattr(value, "tolist") and hasattr(value, "dtype"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"settings must hold what JSON can, got a {type(value).__name__}: {value!r:.80}")


def load_dictionary(filename: str | os.PathLike) -> Any:
    """Read a JSON file.

    Parameters
    ----------
    filename : str or os.PathLike
        A ``.json`` file.

    Returns
    -------
    dict
        What the file holds.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the path is not acceptable or the file is not JSON; the message names the file.
    """
    path = validate_path(filename, [".json"])
    with open(path, "rb") as stream:
        content = stream.read()
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path!r} is not a JSON file: {error}") from error


def write_to_text_file(content: str | Iterable[Any], filename: str | os.PathLike, write_flag: str = "w") -> bool:
    r"""Write items to a text file, one per line.

    Parameters
    ----------
    content : iterable or str
        Items; ``str()`` of each and a line feed are written. A string is one item.
    filename : str or os.PathLike
        File to write.
    write_flag : {"w", "a", "x", "r+", "w+", "a+"}
        As in :func:`open`. With ``w`` an older file stays as it was until the new one is complete; ``r+`` writes over
        the beginning of one that exists.

    Returns
    -------
    bool
        True.

    Raises
    ------
    ValueError
        If the flag or the path is not acceptable, or the folder does not exist.
    FileExistsError, FileNotFoundError
        If the file exists with ``x``, or does not with ``r+``.
    """
    path = validate_path(filename)
    flag = one_of("write_flag", write_flag, _FLAGS)
    if not isinstance(content, Iterable):
        raise TypeError(f"content must be a string or an iterable of items, got {type(content).__name__}")
    items = [content] if isinstance(content, str) else content
    text = "".join(f"{item}\n" for item in items).encode()
    if flag in ("w", "w+"):
        with replacing(path) as stream:
            stream.write(text)
        return True
    if not os.path.isdir(os.path.dirname(path)):
        raise ValueError(f"Folder {os.path.dirname(path)!r} does not exist")
    with open(path, flag.replace("+", "b+") if "+" in flag else f"{flag}b") as stream:
        stream.write(text)
    return True


def read_text_file(filename: str | os.PathLike) -> list[str]:
    """Read a text file line by line.

    Parameters
    ----------
    filename : str or os.PathLike
        File to read.

    Returns
    -------
    list of str
        Lines without their trailing white space.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the path is not acceptable or the file is not UTF-8 text; the message names the file.
    """
    path = validate_path(filename)
    try:
        with open(path, encoding="utf-8") as stream:
            return [line.rstrip() for line in stream]
    except UnicodeDecodeError as error:
        raise ValueError(f"{path!r} is not a UTF-8 text file: {error}") from error
