"""The folder of a run, and files in it that are there whole or not at all."""

import json
import os
import tempfile
from pathlib import Path

from PIL import Image

from odak.cli.errors import InputError
from odak.tools import check_directory
from odak.tools._atomic import replacing


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
    folder = Path(os.path.expanduser(folder)).resolve()
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
    with replacing(str(path)) as stream:
        stream.write(text.encode("utf-8"))


def write_png(path: Path, image: Image.Image) -> None:
    """Write a picture as PNG.

    Parameters
    ----------
    path : Path
        File to write; an older one stays as it was until the new one is complete.
    image : PIL.Image.Image
        What to write.
    """
    with replacing(str(path)) as stream:
        image.save(stream, format="PNG")
