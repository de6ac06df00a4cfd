"""Files that are there whole or not at all: written beside their place under another name, then moved there."""

import errno
import io
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
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
    OSError
        If the disk is full; the error names the file.
    """
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
    """A file that remembers why it could not be written: writers on top of it tend to hide that."""

    failure: OSError | None = None

    def write(self, data) -> int:
        try:
            return super().write(data)
        except OSError as error:
            self.failure = error
            raise


@contextmanager
def _filling(descriptor: int, path: str) -> Iterator[BinaryIO]:
    """Yield a stream on a descriptor; a full disk is an OSError that names the file, whatever a writer makes of it."""
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
    """Say whether an error came of a Ctrl-C: torch's writer makes a RuntimeError of it."""
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
        # Asked first: on a disk that is read-only, removing what is not there is another error.
        if os.path.lexists(temporary):
            os.unlink(temporary)
