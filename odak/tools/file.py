"""Folders, text files, dictionaries in files, images and external programs."""

import json
import math
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterable
from numbers import Real
from pathlib import Path
from typing import Any

from odak import _validate
from odak._validate import one_of
from odak.log import logger
from odak.tools.images import load_image, resize_image, save_image
from odak.tools.paths import expanduser, get_base_filename, replacing, temporary_name, validate_cwd, validate_path

__all__ = [
    "ALLOWED_COMMANDS",
    "DANGEROUS_PATTERNS",
    "check_directory",
    "convert_bytes",
    "copy_file",
    "expanduser",
    "get_base_filename",
    "list_directories",
    "list_files",
    "load_dictionary",
    "load_image",
    "read_text_file",
    "resize_image",
    "save_dictionary",
    "save_image",
    "shell_command",
    "size_of_a_file",
    "validate_cwd",
    "validate_path",
    "validate_shell_command",
    "write_to_text_file",
]


_UNITS = ("bytes", "KB", "MB", "GB", "TB", "PB", "EB")


def check_directory(directory: str | os.PathLike, validate: bool = True) -> bool:
    """Make a folder, and those above it, unless it exists.

    Parameters
    ----------
    directory : str or os.PathLike
        Folder.
    validate : bool
        Apply the path rules; False only expands ``~`` and makes the path absolute, so that ``../x`` works.

    Returns
    -------
    bool
        True if it existed, False if it was made.

    Raises
    ------
    TypeError
        If it is neither a string nor a path object.
    ValueError
        If there is a file of that name, or the folder cannot be made.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import check_directory
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [check_directory(os.path.join(folder, "new")) for _ in range(2)]
    [False, True]
    """
    path = validate_path(directory) if _validate.flag("validate", validate) else validate_cwd(directory)
    if os.path.isdir(path):
        return True
    if os.path.lexists(path):
        raise ValueError(f"{path!r} exists and is not a directory")
    try:
        # Another process may make it at the same moment.
        os.makedirs(path, exist_ok=True)
    except OSError as error:
        raise ValueError(f"Directory {path!r} cannot be made: {error.strerror or error}") from error
    return False


def list_files(path: str | os.PathLike, key: str = "*.*", recursive: bool = True) -> list[str]:
    """List the files of a folder whose names match a pattern.

    Parameters
    ----------
    path : str or os.PathLike
        Folder.
    key : str
        Pattern as in :meth:`pathlib.Path.glob`.
    recursive : bool
        Look into the folders below as well.

    Returns
    -------
    list of str
        Absolute paths, sorted; empty when there is no such folder.

    Raises
    ------
    ValueError
        If the path is not acceptable, or the pattern is empty, absolute or leaves the folder.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import list_files, write_to_text_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("a.txt", "b.txt", "c.csv"):
    ...         written = write_to_text_file("text", os.path.join(folder, name))
    ...     [os.path.basename(path) for path in list_files(folder, key="*.txt")]
    ['a.txt', 'b.txt']
    """
    folder = Path(validate_path(path))
    if not isinstance(key, str):
        raise TypeError(f"key must be a string, got {type(key).__name__}")
    if not key or ".." in Path(key).parts or Path(key).is_absolute():
        raise ValueError(f"key must be a pattern below the folder, such as '*.png'; got {key!r}")
    found = folder.rglob(key) if _validate.flag("recursive", recursive) else folder.glob(key)
    return sorted(str(entry) for entry in found if entry.is_file())


def list_directories(path: str | os.PathLike, recursive: bool = True) -> list[str]:
    """List the names of the folders in a folder.

    Parameters
    ----------
    path : str or os.PathLike
        Folder.
    recursive : bool
        Include the folders of all levels below; links are listed and not entered.

    Returns
    -------
    list of str
        Names (not paths) of all levels, sorted together.

    Raises
    ------
    FileNotFoundError
        If there is no such folder.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import list_directories
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     os.makedirs(os.path.join(folder, "red", "green"))
    ...     list_directories(folder), list_directories(folder, recursive=False)
    (['green', 'red'], ['red'])
    """
    folder, recursive = validate_path(path), _validate.flag("recursive", recursive)
    if not os.path.isdir(folder):
        raise FileNotFoundError(f"There is no folder {folder!r}")
    names = []
    for _, below, _ in os.walk(folder):
        names += below
        if not recursive:
            break
    return sorted(names)


def convert_bytes(num: float) -> tuple[float, str]:
    """Express a number of bytes in the unit that leaves it below 1024.

    Parameters
    ----------
    num : float
        Number of bytes.

    Returns
    -------
    tuple
        Value, and one of bytes, KB, MB, GB, TB, PB, EB in steps of 1024.

    Examples
    --------
    >>> from odak.tools import convert_bytes
    >>> convert_bytes(1536)
    (1.5, 'KB')
    """
    if isinstance(num, bool) or not isinstance(num, Real) or math.isnan(num):
        raise TypeError(f"num must be a number of bytes, got {num!r:.80}")
    for unit in _UNITS[:-1]:
        if num < 1024:
            return num, unit
        num = num / 1024
    return num, _UNITS[-1]


def size_of_a_file(file_path: str | os.PathLike) -> tuple[float | None, str | None]:
    """Return the size of a file as :func:`convert_bytes` expresses it.

    Parameters
    ----------
    file_path : str or os.PathLike
        File.

    Returns
    -------
    tuple
        Value and unit; ``(None, None)`` when there is no such file.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import size_of_a_file, write_to_text_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "a.txt")
    ...     written = write_to_text_file("x" * 2047, name)
    ...     size_of_a_file(name)
    (2.0, 'KB')
    """
    path = validate_path(file_path, name="file_path")
    return convert_bytes(os.stat(path).st_size) if os.path.isfile(path) else (None, None)


def copy_file(source: str | os.PathLike, destination: str | os.PathLike, follow_symlinks: bool = True) -> str:
    """Copy a file with its times and permissions, replacing an existing one.

    Parameters
    ----------
    source : str or os.PathLike
        File to copy.
    destination : str or os.PathLike
        File to write; an older one stays as it was until the copy is complete.
    follow_symlinks : bool
        False copies a symbolic link as a link.

    Returns
    -------
    str
        Absolute path of the copy.

    Raises
    ------
    ValueError
        If the source is not an existing file, the destination is a folder or the source itself, or copying fails.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import copy_file, read_text_file, write_to_text_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     names = [os.path.join(folder, name) for name in ("a.txt", "b.txt")]
    ...     written = write_to_text_file("text", names[0])
    ...     read_text_file(copy_file(*names))
    ['text']
    """
    source, destination = validate_path(source, name="source"), validate_path(destination, name="destination")
    follow_symlinks = _validate.flag("follow_symlinks", follow_symlinks)
    if not os.path.exists(source):
        raise ValueError(f"Source file does not exist: {source!r}")
    if not os.path.isfile(source):
        raise ValueError(f"Source is not a file: {source!r}")
    if os.path.isdir(destination):
        raise ValueError(f"Destination is a directory: {destination!r}")
    if os.path.exists(destination) and os.path.samefile(source, destination):
        raise ValueError(f"Source and destination are the same file: {source!r}, {destination!r}")
    try:
        with temporary_name(destination) as temporary:
            shutil.copy2(source, temporary, follow_symlinks=follow_symlinks)
    except OSError as error:
        raise ValueError(f"Copying {source!r} to {destination!r} failed: {error.strerror or error}") from error
    return destination


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

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.tools import load_dictionary, save_dictionary
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "settings.json")
    ...     saved = save_dictionary({"pitch": 8e-6, "shape": np.asarray([2, 3])}, name)
    ...     load_dictionary(name)
    {'pitch': 8e-06, 'shape': [2, 3]}
    """
    path = validate_path(filename, [".json"])
    content = json.dumps(settings, ensure_ascii=False, indent=4, default=_plain).encode()
    with replacing(path) as stream:
        stream.write(content)
    return settings


def _plain(value):
    """Return the JSON representation of a number or array of NumPy or PyTorch, or of a path."""
    if hasattr(value, "tolist") and hasattr(value, "dtype"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"settings must be serialisable as JSON, got a {type(value).__name__}: {value!r:.80}")


def load_dictionary(filename: str | os.PathLike) -> Any:
    """Read a JSON file.

    Parameters
    ----------
    filename : str or os.PathLike
        A ``.json`` file.

    Returns
    -------
    dict
        Content of the file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the path is not acceptable or the file is not JSON; the message names the file.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import load_dictionary, save_dictionary
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "settings.json")
    ...     saved = save_dictionary({"wavelength": 5.32e-07}, name)
    ...     load_dictionary(name)["wavelength"]
    5.32e-07
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
        Mode of :func:`open`. With ``w`` an older file stays as it was until the new one is complete; ``r+`` writes over
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

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import read_text_file, write_to_text_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "a.txt")
    ...     done = [write_to_text_file([1, "two"], name), write_to_text_file("three", name, "a")]
    ...     read_text_file(name)
    ['1', 'two', 'three']
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

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import read_text_file, write_to_text_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "a.txt")
    ...     written = write_to_text_file(["first", "second"], name)
    ...     read_text_file(name)
    ['first', 'second']
    """
    path = validate_path(filename)
    try:
        with open(path, encoding="utf-8") as stream:
            return [line.rstrip() for line in stream]
    except UnicodeDecodeError as error:
        raise ValueError(f"{path!r} is not a UTF-8 text file: {error}") from error


ALLOWED_COMMANDS = {"blender", "dispynode.py", "ffmpeg", "python", "python3", "git"}
DANGEROUS_PATTERNS = [r"[;&|`$]", r"\$[{(]", r"[<>]", r"['\"]"]

_DANGEROUS = re.compile("|".join(DANGEROUS_PATTERNS))
_CONTROL = re.compile(r"[\x01-\x1f\x7f]")


def validate_shell_command(cmd_list: list[str]) -> list[str]:
    """Return a copy of a command after rejecting characters with a special meaning in shells.

    A program that odak does not know is logged as a warning and passes: no shell is involved.

    Parameters
    ----------
    cmd_list : list of str
        Program and arguments.

    Returns
    -------
    list of str
        A new list, equal to the one given.

    Raises
    ------
    TypeError
        If it is not a list of strings.
    ValueError
        If it is empty, or an item holds a null byte, a control character or one of ``; & | ` $ < > ' "``.

    Examples
    --------
    >>> from odak.tools import validate_shell_command
    >>> validate_shell_command(["python", "--version"])
    ['python', '--version']
    """
    if not isinstance(cmd_list, list):
        raise TypeError(f"cmd_list must be a list, got {type(cmd_list).__name__}")
    if not cmd_list:
        raise ValueError("cmd_list cannot be empty: its first item is the program")
    for index, item in enumerate(cmd_list):
        _check_item(index, item)
    program = os.path.basename(cmd_list[0]).lower()
    if program not in ALLOWED_COMMANDS:
        logger.warning("Command %r is not one of the known ones: %s", cmd_list[0], ", ".join(sorted(ALLOWED_COMMANDS)))
    return list(cmd_list)


def shell_command(
    cmd: list[str], cwd: str | os.PathLike = ".", timeout: float | None = None, check: bool = True
) -> tuple[subprocess.Popen, bytes | None, bytes | None]:
    """Run a program and, unless told otherwise, wait for it.

    Parameters
    ----------
    cmd : list of str
        Program and arguments; see :func:`validate_shell_command`.
    cwd : str or os.PathLike
        Folder to run it in.
    timeout : float, optional
        Seconds to wait. After them the program and all processes that it started are killed (return code −9) and what
        it had written until then is returned; there is no exception.
    check : bool
        False returns at once; what the program writes is then dropped, so that it cannot block on a full pipe.

    Returns
    -------
    tuple
        The process, and what it wrote to its standard output and to its standard error as bytes (None, None when
        `check` is False).

    Raises
    ------
    TypeError, ValueError
        If the command or the folder is not acceptable.
    FileNotFoundError
        If the program or the folder does not exist.

    Examples
    --------
    >>> import sys
    >>> from odak.tools import shell_command
    >>> process, output, errors = shell_command([sys.executable, "--version"])
    >>> process.returncode, output.split()[0]
    (0, b'Python')
    """
    command, folder, check = validate_shell_command(cmd), validate_cwd(cwd), _validate.flag("check", check)
    if timeout is not None:
        _validate.real("timeout", timeout)
    pipe = subprocess.PIPE if check else subprocess.DEVNULL
    process = subprocess.Popen(command, cwd=folder, stdout=pipe, stderr=pipe, start_new_session=True)
    if not check:
        return process, None, None
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        _kill_with_children(process)
        out, err = process.communicate()
    except BaseException:
        _kill_with_children(process)
        process.communicate()
        raise
    return process, out, err


def _check_item(index, item):
    if not isinstance(item, str):
        raise TypeError(f"cmd_list[{index}] must be a string, got {type(item).__name__}")
    if "\0" in item:
        raise ValueError(f"Null bytes are not allowed in cmd_list[{index}], got {item!r}")
    if found := _DANGEROUS.search(item):
        raise ValueError(f"Dangerous character {found.group()!r} in cmd_list[{index}], got {item!r}")
    if found := _CONTROL.search(item):
        raise ValueError(f"Control character {found.group()!r} in cmd_list[{index}], got {item!r}")


def _kill_with_children(process):
    if not hasattr(os, "killpg"):
        process.kill()
        return
    try:
        # The process is the leader of a new session, so its number is also that of its process group.
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        process.kill()
