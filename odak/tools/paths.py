"""Checks of paths, and files that are written whole or not at all."""

import errno
import io
import os
import re
import secrets
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import BinaryIO

from odak import _validate
from odak._validate import texts

LONGEST_PATH = 260

_URL = re.compile(r"(https?|ftp|file)://", re.IGNORECASE)
_DEVICE_OR_NETWORK = re.compile(r"//\.|\\\\")


def validate_path(
    path: str | os.PathLike[str], allowed_extensions: Iterable[str] | None = None, *, name: str = "path"
) -> str:
    """Return the absolute path, ``~`` expanded, after rejecting paths that are not safe to open.

    Parameters
    ----------
    path : str or os.PathLike
        Path to examine; it need not exist. An empty one is the current folder.
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

    Examples
    --------
    >>> import os
    >>> from odak.tools import validate_path
    >>> os.path.basename(validate_path("picture.png", [".png", ".jpg"]))
    'picture.png'
    """
    _validate.instance("name", name, str, "a string")
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
        accepted = sorted(
            {"." + entry.lower().removeprefix(".") for entry in texts("allowed_extensions", allowed_extensions)}
        )
        if (found := extension_of(absolute)) not in accepted:
            raise ValueError(
                f"Extension {found!r} is not allowed for {name} {absolute!r}; accepted: {' '.join(accepted)}"
            )
    return absolute


def validate_cwd(cwd: str | os.PathLike[str]) -> str:
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

    Examples
    --------
    >>> import os
    >>> from odak.tools import validate_cwd
    >>> validate_cwd(".") == os.getcwd()
    True
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

    Examples
    --------
    >>> from odak.tools import get_base_filename
    >>> get_base_filename("data/archive.tar.gz")
    ('archive.tar', '.gz')
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

    Examples
    --------
    >>> import os
    >>> from odak.tools import expanduser
    >>> expanduser("~/data") == os.path.expanduser("~/data"), expanduser("data")
    (True, 'data')
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


def regular_file(path: str) -> str:
    """Return the path of a file that can be read without waiting for a writer.

    Parameters
    ----------
    path : str
        Path of the file.

    Returns
    -------
    str
        The same path.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is a folder, a device or a named pipe, which would be waited for without end; the message names it.
    """
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise ValueError(f"{path!r} is not a regular file")
    return path


@contextmanager
def naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Let errors that the content of a file causes name the file.

    Parameters
    ----------
    path : str or os.PathLike
        The file that is read in the block.

    Raises
    ------
    TypeError
        For a TypeError of the block, with the name of the file in front unless the message holds it.
    ValueError
        In the same way for any other error of a value, a key or a number.
    """
    try:
        yield
    except (ValueError, TypeError, LookupError, ArithmeticError, RecursionError) as error:
        base = os.path.basename(path)
        if base in str(error):
            raise
        kind = TypeError if isinstance(error, TypeError) else ValueError
        raise kind(f"{base}: {error or type(error).__name__}") from error


def _name(filename):
    _validate.instance("filename", filename, (str, bytes, os.PathLike), "a string or a path object")
    return filename


def _text(name, value):
    text = os.fspath(value) if isinstance(value, os.PathLike) else value
    if not isinstance(text, str):
        raise TypeError(f"{name} must be a string or a path object, got {type(value).__name__}")
    if "\0" in text:
        raise ValueError(f"Null bytes are not allowed in {name}, got {text!r}")
    return text


def write_file(path: str | os.PathLike[str], content: bytes | memoryview) -> None:
    """Write a file whole, as `replacing` does."""
    with replacing(path) as stream:
        stream.write(content)


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Yield a binary stream whose content takes the place of a file when the block ends without an error.

    Parameters
    ----------
    path : str
        File to write. If an error occurs, an existing file is not changed. Its access rights are kept, and a symbolic
        link is followed.

    Yields
    ------
    file object
        Open for reading and writing, seekable.

    Raises
    ------
    ValueError
        If the folder does not exist, or the path names something other than a file.
    PermissionError
        If the file or its folder cannot be written to; the error names the file.
    OSError
        If the disk is full; the error names the file.
    """
    path = os.fspath(path)
    with temporary_name(path) as temporary:
        try:
            # Created with the rights that any new file gets: tempfile would leave it readable by its owner alone.
            descriptor = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR | getattr(os, "O_BINARY", 0), 0o666)
        except OSError as error:
            raise type(error)(error.errno, error.strerror, path) from None
        with _filling(descriptor, path) as stream:
            yield stream
        if os.path.exists(path):
            os.chmod(temporary, stat.S_IMODE(os.stat(path).st_mode))


class _File(io.FileIO):
    """A file object that keeps the error of a failed write, which libraries that write to it may hide."""

    failure: OSError | None = None

    def write(self, data) -> int:
        try:
            return super().write(data)
        except OSError as error:
            self.failure = error
            raise


@contextmanager
def _filling(descriptor: int, path: str) -> Iterator[BinaryIO]:
    """Yield a stream on a descriptor; a full disk raises an OSError that names the file, with any writer."""
    raw = _File(descriptor, "r+")
    try:
        with io.BufferedRandom(raw) as stream:
            yield stream
    except Exception as error:
        raw.close()
        if _interrupted(error):
            raise KeyboardInterrupt from error
        if raw.failure is None or path in str(error):
            raise
        raise OSError(raw.failure.errno, raw.failure.strerror, path) from error


def _interrupted(error: BaseException | None) -> bool:
    """Return whether an error was caused by Ctrl-C, which torch's writer converts to a RuntimeError."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__context__
    return False


@contextmanager
def temporary_name(path: str) -> Iterator[str]:
    """Yield an unused name in the folder of a file, and move what was written there over the file.

    Parameters
    ----------
    path : str
        File to write.

    Yields
    ------
    str
        Name of a file that does not exist yet.

    Raises
    ------
    ValueError
        If the folder does not exist, or the path names something other than a file.
    """
    target = os.path.realpath(path)
    folder = os.path.dirname(target)
    if not os.path.isdir(folder):
        raise ValueError(f"Folder {folder!r} does not exist; {os.path.basename(target)!r} cannot be written there")
    if os.path.exists(target) and not os.path.isfile(target):
        raise ValueError(f"{path!r} is not a file and cannot be replaced by one")
    if os.path.exists(target) and not os.access(target, os.W_OK):
        # Renaming requires only the rights of the folder.
        raise PermissionError(errno.EACCES, "File is write-protected", path)
    temporary = os.path.join(folder, f".{secrets.token_hex(8)}.part")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        # Tested first: on a read-only disk the removal of a file that does not exist raises another error.
        if os.path.lexists(temporary):
            os.unlink(temporary)
