"""Files that are there whole or not at all: written beside their place under another name, then moved there."""

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import BinaryIO


@contextmanager
def replacing(path: str) -> Iterator[BinaryIO]:
    """Yield a binary stream whose content takes the place of a file when the block ends without an error.

    Parameters
    ----------
    path : str
        File to write. Whatever goes wrong, an older one stays as it was. Its access rights are kept, and a symbolic
        link is followed.

    Yields
    ------
    file object
        Open for reading and writing, seekable.

    Raises
    ------
    ValueError
        If the folder does not exist, or the path is that of something other than a file.
    PermissionError
        If the file or its folder cannot be written to; the error names the file.
    """
    with temporary_name(path) as temporary:
        try:
            # Created with the rights that any new file gets: tempfile would leave it readable by its owner alone.
            descriptor = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR | getattr(os, "O_BINARY", 0), 0o666)
        except OSError as error:
            raise type(error)(error.errno, error.strerror, path) from None
        with os.fdopen(descriptor, "w+b") as stream:
            yield stream
        if os.path.exists(path):
            os.chmod(temporary, stat.S_IMODE(os.stat(path).st_mode))


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
        If the folder does not exist, or the path is that of something other than a file.
    """
    target = os.path.realpath(path)
    folder = os.path.dirname(target)
    if not os.path.isdir(folder):
        raise ValueError(f"Folder {folder!r} does not exist; {os.path.basename(target)!r} cannot be written there")
    if os.path.exists(target) and not os.path.isfile(target):
        raise ValueError(f"{path!r} is not a file and cannot be replaced by one")
    if os.path.exists(target) and not os.access(target, os.W_OK):
        # Renaming asks for the rights of the folder alone.
        raise PermissionError(errno.EACCES, "File is write-protected", path)
    temporary = os.path.join(folder, f".{secrets.token_hex(8)}.part")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        with suppress(FileNotFoundError):
            os.unlink(temporary)
