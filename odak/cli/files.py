"""Files that are there whole or not at all."""

import json
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

from odak.cli.errors import InputError


def writable_folder(folder: Path) -> Path:
    """Make a folder if need be, and find out now rather than after the computation whether it can be written to.

    Parameters
    ----------
    folder : Path
        Folder to write to.

    Returns
    -------
    Path
        The same folder, absolute.

    Raises
    ------
    InputError
        If it cannot be made or written to.
    """
    from odak.tools import check_directory

    folder = folder.expanduser().resolve()
    try:
        check_directory(str(folder), validate=False)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError) as error:
        raise InputError(f"--output cannot be written to: {str(folder)!r} ({' '.join(str(error).split())})") from None
    return folder


def write_json(path: Path, value: dict) -> None:
    """Write a dictionary as JSON.

    Parameters
    ----------
    path : Path
        File to write; an older one stays as it was until the new one is complete.
    value : dict
        What to write.
    """
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    _write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def write_png(path: Path, image: Image.Image) -> None:
    """Write a picture as PNG.

    Parameters
    ----------
    path : Path
        File to write; an older one stays as it was until the new one is complete.
    image : PIL.Image.Image
        What to write.
    """
    _write(path, lambda temporary: image.save(temporary, format="PNG"))


def _write(path: Path, write: Callable[[Path], object]) -> None:
    with _temporary_beside(path) as temporary:
        write(temporary)
        os.replace(temporary, path)


@contextmanager
def _temporary_beside(path: Path) -> Iterator[Path]:
    """Yield a new name in the same folder, with the access rights that a new file would have."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
