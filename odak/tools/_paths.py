"""What a path may look like; every file function asks here first."""

import os
import re
from collections.abc import Iterable

from odak._validate import texts

LONGEST_PATH = 260

_URL = re.compile(r"(https?|ftp|file)://", re.IGNORECASE)
_DEVICE_OR_NETWORK = re.compile(r"//\.|\\\\")


def validate_path(
    path: str | os.PathLike, allowed_extensions: Iterable[str] | None = None, *, name: str = "path"
) -> str:
    """Return the absolute path, ``~`` expanded, after refusing what no file function should open.

    Parameters
    ----------
    path : str or os.PathLike
        Path to look at; it need not exist. An empty one is the current folder.
    allowed_extensions : iterable of str, optional
        Extensions accepted, with or without their dot, whatever the case; all when omitted.
    name : str
        What the path is called where it came in, for the messages.

    Returns
    -------
    str
        Absolute path without a trailing separator.

    Raises
    ------
    TypeError
        If it is neither a string nor a path object.
    ValueError
        For a null byte, a component ``..``, a URL, a device or network path, a path of more than 260 characters, or
        an extension that is not among those accepted.
    """
    if not isinstance(name, str):
        raise TypeError(f"name must be a string, got {type(name).__name__}")
    text = _text(name, path)
    if ".." in re.split(r"[/\\]", text):
        raise ValueError(f"Path traversal ('..') is not accepted in {name}, got {text!r}")
    if _URL.search(text):
        raise ValueError(f"URL protocols are not accepted where a path is expected, got {name} {text!r}")
    if _DEVICE_OR_NETWORK.match(text):
        raise ValueError(f"Device and network paths are not allowed in {name}, got {text!r}")
    absolute = os.path.abspath(os.path.expanduser(text))
    if len(absolute) > LONGEST_PATH:
        raise ValueError(f"{name} exceeds maximum length: {len(absolute)} characters, at most {LONGEST_PATH}")
    if allowed_extensions is not None:
        _check_extension(absolute, allowed_extensions, name)
    return absolute


def validate_cwd(cwd: str | os.PathLike) -> str:
    """Return a working folder as an absolute path, ``~`` expanded; it need not exist and may hold ``..``.

    Parameters
    ----------
    cwd : str or os.PathLike
        Folder.

    Returns
    -------
    str
        Absolute path.

    Raises
    ------
    TypeError
        If it is neither a string nor a path object.
    ValueError
        For a null byte.
    """
    return os.path.abspath(os.path.expanduser(_text("cwd", cwd)))


def get_base_filename(filename: str) -> tuple[str, str]:
    """Split the last component of a path into its base and its extension.

    Parameters
    ----------
    filename : str
        Path.

    Returns
    -------
    tuple of str
        Base name and extension with its dot: ``("b.tar", ".gz")``, ``("noext", "")``, ``(".hidden", "")``.
    """
    return os.path.splitext(os.path.basename(_name(filename)))


def expanduser(filename: str) -> str:
    """Replace a leading ``~`` by the user's home folder.

    Parameters
    ----------
    filename : str
        Path.

    Returns
    -------
    str
        Path, otherwise unchanged.
    """
    return os.path.expanduser(_name(filename))


def extension_of(path: str) -> str:
    """Return the extension in lower case, with its dot.

    Parameters
    ----------
    path : str
        Path.

    Returns
    -------
    str
        Such as ``".png"``; empty when there is none.
    """
    return os.path.splitext(path)[1].lower()


def _name(filename):
    if not isinstance(filename, (str, bytes, os.PathLike)):
        raise TypeError(f"filename must be a string or a path object, got {type(filename).__name__}")
    return filename


def _text(name, value):
    text = os.fspath(value) if isinstance(value, os.PathLike) else value
    if not isinstance(text, str):
        raise TypeError(f"{name} must be a string or a path object, got {type(value).__name__}")
    if "\0" in text:
        raise ValueError(f"Null bytes are not allowed in {name}, got {text!r}")
    return text


def _check_extension(path, allowed, name):
    accepted = sorted({"." + entry.lower().removeprefix(".") for entry in texts("allowed_extensions", allowed)})
    if extension_of(path) not in accepted:
        raise ValueError(
            f"Extension {extension_of(path)!r} is not allowed for {name} {path!r}; accepted: {' '.join(accepted)}"
        )
