"""Folders, and files as wholes."""

import math
import os
import shutil
from numbers import Real
from pathlib import Path

from odak import _validate
from odak.tools._atomic import temporary_name
from odak.tools._paths import validate_cwd, validate_path

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
    """
    path = validate_path(file_path, name="file_path")
    return convert_bytes(os.stat(path).st_size) if os.path.isfile(path) else (None, None)


def copy_file(source: str | os.PathLike, destination: str | os.PathLike, follow_symlinks: bool = True) -> str:
    """Copy a file with its times and rights, over an older one if there is one.

    Parameters
    ----------
    source, destination : str or os.PathLike
        Files. The destination stays as it was until the copy is complete.
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
