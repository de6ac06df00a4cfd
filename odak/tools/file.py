"""Folders, text files, dictionaries in files, images and external programs.

Images have 8 or 16 bits per channel: grey, colour and alpha.
"""

import io
import json
import math
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterable, Sequence
from numbers import Real
from pathlib import Path
from typing import Any, BinaryIO, Literal, TypeVar

import numpy as np
from PIL import Image, UnidentifiedImageError

from odak import _validate
from odak._validate import one_of
from odak._warnings import AccuracyWarning, ArgumentWarning, warn
from odak.log import logger
from odak.tools.paths import expanduser as expanduser
from odak.tools.paths import extension_of, regular_file, replacing, temporary_name, write_file
from odak.tools.paths import get_base_filename as get_base_filename
from odak.tools.paths import validate_cwd as validate_cwd
from odak.tools.paths import validate_path as validate_path

# What is written is returned.
Settings = TypeVar("Settings")

_UNITS = ("bytes", "KB", "MB", "GB", "TB", "PB", "EB")


def check_directory(directory: str | os.PathLike[str], validate: bool = True) -> bool:
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


def list_files(path: str | os.PathLike[str], key: str = "*.*", recursive: bool = True) -> list[str]:
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
    _validate.instance("key", key, str, "a string")
    if not key or ".." in Path(key).parts or Path(key).is_absolute():
        raise ValueError(f"key must be a pattern below the folder, such as '*.png'; got {key!r}")
    found = folder.rglob(key) if _validate.flag("recursive", recursive) else folder.glob(key)
    return sorted(str(entry) for entry in found if entry.is_file())


def list_directories(path: str | os.PathLike[str], recursive: bool = True) -> list[str]:
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


def size_of_a_file(file_path: str | os.PathLike[str]) -> tuple[float | None, str | None]:
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


def copy_file(source: str | os.PathLike[str], destination: str | os.PathLike[str], follow_symlinks: bool = True) -> str:
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


def save_dictionary(settings: Settings, filename: str | os.PathLike[str]) -> Settings:
    """Write settings as JSON, indented by four, with non-ASCII characters as they are.

    Parameters
    ----------
    settings : dict
        What to write. NumPy and PyTorch numbers are written as numbers, arrays and tensors as lists, paths as texts.
    filename : str or os.PathLike
        File of any name, whatever its extension; an older one stays as it was until the new one is complete.

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
    path = validate_path(filename)
    content = json.dumps(settings, ensure_ascii=False, indent=4, default=_plain).encode()
    write_file(path, content)
    return settings


def _plain(value):
    """Return the JSON representation of a number or array of NumPy or PyTorch, or of a path."""
    if hasattr(value, "tolist") and hasattr(value, "dtype"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"settings must be serialisable as JSON, got a {type(value).__name__}: {value!r:.80}")


def load_dictionary(filename: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a JSON file.

    Parameters
    ----------
    filename : str or os.PathLike
        File of any name that holds JSON, for example ``settings.json`` or ``settings.txt``.

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
    path = validate_path(filename)
    with open(regular_file(path), "rb") as stream:
        content = stream.read()
    with _validate.refusing(f"{path!r} is not a JSON file: ", ValueError, RecursionError):
        return json.loads(content)


def write_to_text_file(content: str | Iterable[Any], filename: str | os.PathLike[str], write_flag: str = "w") -> bool:
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
    _validate.instance("content", content, Iterable, "a string or an iterable of items")
    items = [content] if isinstance(content, str) else content
    text = "".join(f"{item}\n" for item in items).encode()
    if flag in ("w", "w+"):
        write_file(path, text)
        return True
    if not os.path.isdir(os.path.dirname(path)):
        raise ValueError(f"Folder {os.path.dirname(path)!r} does not exist")
    with open(path, flag.replace("+", "b+") if "+" in flag else f"{flag}b") as stream:
        stream.write(text)
    return True


def read_text_file(filename: str | os.PathLike[str]) -> list[str]:
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
    unreadable = _validate.refusing(f"{path!r} is not a UTF-8 text file: ", UnicodeDecodeError)
    with unreadable, open(regular_file(path), encoding="utf-8") as stream:
        return [line.rstrip() for line in stream]


# Bytes that the arrays of a small file may take. Reading them takes some of it again; 256 MB are documented.
MOST_BYTES = 160 << 20
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_npz(path: str | os.PathLike[str], most: int = MOST_BYTES) -> dict[str, np.ndarray]:
    """Read the arrays of a ``.npz`` file after checking what its headers promise.

    Parameters
    ----------
    path : str or os.PathLike
        File that :func:`numpy.savez` wrote.
    most : int
        Bytes of all its arrays, unless the file is as large.

    Returns
    -------
    dict
        Arrays of integers and floats by their names.

    Raises
    ------
    ValueError
        If it is not such a file, is truncated, or would take more memory.
    """
    # RuntimeError: encryption, or another compression.
    broken = (zipfile.BadZipFile, zlib.error, EOFError, struct.error, RuntimeError)
    unreadable = _validate.refusing("it is not an archive of arrays: ", *broken)
    with unreadable, zipfile.ZipFile(regular_file(os.fspath(path))) as archive:
        records = archive.infolist()
        promised, most = sum(record.file_size for record in records), max(most, os.path.getsize(path))
        if promised > most:
            raise ValueError(f"its records take {promised} bytes; at most {most} are read from a file of its size")
        return {record.filename.removesuffix(".npy"): _read_array(archive, record) for record in records}


def _read_array(archive: zipfile.ZipFile, record: zipfile.ZipInfo) -> np.ndarray:
    """Return an array of an archive, unless its header promises more than is there."""
    with archive.open(record) as stream:
        # Python's parser reads headers.
        broken = (ValueError, TypeError, SyntaxError, RecursionError, tokenize.TokenError)
        with _validate.refusing(f"{record.filename!r} is not an array: ", *broken):
            version = np.lib.format.read_magic(stream)
            if version not in _HEADERS:
                raise ValueError(f"its version is {version}")
            shape, _, dtype = _HEADERS[version](stream)
        if dtype.kind not in "iuf" or min(shape, default=0) < 0:
            raise ValueError(f"{record.filename!r} is not an array of numbers, but of {dtype}")
        if math.prod(shape) * dtype.itemsize > record.file_size:
            raise ValueError(f"{record.filename!r} is truncated: its header states {list(shape)}")
    with archive.open(record) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


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
    _validate.instance("cmd_list", cmd_list, list, "a list")
    if not cmd_list:
        raise ValueError("cmd_list cannot be empty: its first item is the program")
    for index, item in enumerate(cmd_list):
        _check_item(index, item)
    program = os.path.basename(cmd_list[0]).lower()
    if program not in ALLOWED_COMMANDS:
        logger.warning("Command %r is not one of the known ones: %s", cmd_list[0], ", ".join(sorted(ALLOWED_COMMANDS)))
    return list(cmd_list)


def shell_command(
    cmd: list[str], cwd: str | os.PathLike[str] = ".", timeout: float | None = None, check: bool = True
) -> tuple[subprocess.Popen[bytes], bytes | None, bytes | None]:
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
        # The process is the leader of a new session, so its number is also the number of its process group.
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        process.kill()


# Where Pillow begins to warn.
MOST_PIXELS = 89_478_485
# Number of pixels that the header of any file may declare, and further pixels for each byte of the file. Only blank
# pages and malicious files exceed this.
FREE_PIXELS, PIXELS_PER_BYTE = 16 << 20, 10_000

_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".bmp": "BMP", ".tiff": "TIFF", ".tif": "TIFF"}
_RADIANCE, _OPEN_EXR = ".hdr", ".exr"
_READABLE = (*_FORMATS, ".gif", ".webp", ".pbm", ".pgm", ".ppm", ".sr", ".ras", _RADIANCE, _OPEN_EXR)
# Size in the header of Radiance's format: rows from the top, columns from the left.
_SIZE_OF_RADIANCE = re.compile(rb"\n\n-Y (\d{1,9}) \+X (\d{1,9})\n")
# Formats are listed one by one, so that no file selects a decoder that runs programs (EPS) or reads other files.
_DECODERS = ("PNG", "JPEG", "BMP", "TIFF", "GIF", "WEBP", "PPM", "SUN")
# First bytes of a TIFF, of either order of bytes and either size of offsets.
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_ENCODER_OPTIONS = {"JPEG": {"quality": 95, "subsampling": 0}}


class _TooDeep(ValueError):
    """Pillow would read fewer bits of a picture than there are."""


def save_image(
    fn: str | os.PathLike[str], img: np.ndarray, cmin: float = 0, cmax: float | None = None, color_depth: int = 8
) -> bool:
    """Write an image to a file, `cmin` as black and `cmax` as white.

    Parameters
    ----------
    fn : str or os.PathLike
        A ``.png``, ``.jpg``, ``.jpeg``, ``.bmp``, ``.tiff`` or ``.tif`` file; an older one stays as it was until the
        new one is complete.
    img : numpy.ndarray
        ``[H, W]``, ``[H, W, 1]``, ``[H, W, 3]`` (red, green, blue) or ``[H, W, 4]`` (with alpha), row 0 at the top;
        ``[H]`` is a single column. Values outside the limits are clipped, the others rounded to the nearest level;
        not-a-number is black.
    cmin : float
        Value of black.
    cmax : float, optional
        Value of white, 255 by default. An :class:`~odak.ArgumentWarning` says where that leaves a picture of 0 … 1
        nearly black, or one of 16 bits nearly white.
    color_depth : {8, 16}
        Bits per channel; 16 in PNG, and for grey in TIFF.

    Returns
    -------
    bool
        True.

    Raises
    ------
    TypeError
        If the image does not hold real numbers.
    ValueError
        If the shape, the limits, the depth or the path is not acceptable, the format cannot hold such an image, the
        folder does not exist, or the encoder fails; the message names the file.
    PermissionError
        If the folder cannot be written to.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.tools import load_image, save_image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "grey.png")
    ...     saved = save_image(name, np.asarray([[0.0, 0.2, 1.0]]), cmin=0, cmax=1)
    ...     load_image(name).tolist()
    [[0.0, 51.0, 255.0]]
    """
    path, image = validate_path(fn, _FORMATS), _checked(img)
    if cmax is None:
        check_levels(image, 255)
    levels = _levels(image, cmin, 255 if cmax is None else cmax, color_depth)
    encode = _encoder(path, levels)
    failed = _validate.refusing(f"Failed to save image {path!r}: ", OSError, ValueError, struct.error)
    with replacing(path) as stream, failed:
        encode(stream)
        stream.flush()
    return True


def file_depth(bits: int) -> int:
    """Return the bit depth of the file for a pattern of so many bits: 8 or 16."""
    return 8 if bits <= 8 else 16


def save_levels(path: str | os.PathLike[str], levels: np.ndarray, bits: int) -> None:
    """Write levels ``[rows, columns]`` of 0 … 2^bits − 1 as a grey image, by whose upper bits they are read.

    Parameters
    ----------
    path : str or os.PathLike
        As of :func:`save_image`.
    levels : numpy.ndarray
        Whole numbers.
    bits : int
        Bits of a level, 1 to 16.
    """
    depth = file_depth(bits)
    save_image(path, levels * 2.0 ** (depth - bits), cmin=0, cmax=2**depth - 1, color_depth=depth)


def load_image(
    fn: str | os.PathLike[str],
    normalizeby: float = 0.0,
    torch_style: bool = False,
    *,
    color_managed: bool = False,
    pages: int | Sequence[int] | Literal["all"] | None = None,
) -> np.ndarray:
    """Read an image from a file.

    Parameters
    ----------
    fn : str or os.PathLike
        A ``.png``, ``.jpg``, ``.jpeg``, ``.bmp``, ``.tiff``, ``.tif``, ``.gif``, ``.webp``, ``.pbm``, ``.pgm``,
        ``.ppm``, ``.sr`` or ``.ras`` file; ``.hdr`` (Radiance), which needs the package opencv-python-headless, and
        ``.exr``, which needs OpenEXR (``pip install OpenEXR``).
    normalizeby : float
        Divide by this unless it is zero.
    torch_style : bool
        Put the channels first.
    color_managed : bool
        Convert colours by the ICC profile of the file to sRGB (relative colorimetric), which photographs of a phone
        in Display P3 need. By default the levels of the file are returned. A picture without a profile is taken for
        sRGB; of one with 16 bits per channel the profile is not applied, and a warning says so.
    pages : int, sequence of int or "all", optional
        Pages of a TIFF, or frames of a GIF, WebP or animated PNG, counted from 0. A number returns that page as one
        image; a sequence, or "all", returns them along a new first axis. By default the first page is read, and an
        :class:`~odak.ArgumentWarning` says if there are more.

    Returns
    -------
    numpy.ndarray
        float64, turned upright by its EXIF orientation: ``[H, W]`` for grey, ``[H, W, 3]`` or ``[H, W, 4]`` for colour
        (channels first on request), row 0 at the top, and a first axis for several `pages`; 0 … 255, or 0 … 65535 for
        16 bits; the numbers of ``.hdr``, ``.exr`` and TIFF in floating point as they are stored.

    Raises
    ------
    ValueError
        If the path is not acceptable, or the file is missing, broken, not an image, or has more than 89 megapixels, or
        more than 16 in less than a byte for each 10 000; if there is no such page, or the pages differ in shape or
        type; if a TIFF of floating-point colour or of 16-bit colour in planes meets no package tifffile. The message
        names the file.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.tools import load_image, save_image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "colour.png")
    ...     saved = save_image(name, np.full((2, 4, 3), 255))
    ...     image = load_image(name, normalizeby=255.0, torch_style=True)
    >>> image.shape, float(image.max())
    ((3, 2, 4), 1.0)
    """
    divisor = float(_validate.real("normalizeby", normalizeby))
    image = read_levels(fn, torch_style, color_managed, pages).astype(np.float64)
    if divisor != 0:
        image /= divisor
    return image


def read_levels(
    fn: str | os.PathLike[str],
    torch_style: bool = False,
    color_managed: bool = False,
    pages: int | Sequence[int] | Literal["all"] | None = None,
) -> np.ndarray:
    """Read the levels of an image as they are stored in the file.

    Parameters
    ----------
    fn : str or os.PathLike
        File of a format that :func:`load_image` reads.
    torch_style : bool
        Put the channels first.
    color_managed : bool
        Convert colours by the file's ICC profile to sRGB, as :func:`load_image` does.
    pages : int, sequence of int or "all", optional
        Pages or frames, as :func:`load_image` takes them.

    Returns
    -------
    numpy.ndarray
        uint8 or uint16; int32 or float32 for a TIFF that holds them, float32 for ``.hdr`` and ``.exr``. ``[H, W]``,
        ``[H, W, 3]`` or ``[H, W, 4]``, channels first on request; a first axis for several pages.

    Raises
    ------
    ValueError
        If the path is not acceptable, or the file is missing, broken, not an image or too large.
    """
    path, torch_style = validate_path(fn, _READABLE), _validate.flag("torch_style", torch_style)
    color_managed = _validate.flag("color_managed", color_managed)
    asked: Any = pages
    if isinstance(pages, str):
        asked = _validate.one_of("pages", pages, ("all",))
    elif isinstance(pages, Sequence):
        asked = [_validate.integer("pages", page) for page in pages]
    elif pages is not None:
        asked = _validate.integer("pages", pages)
    if not os.path.isfile(path):
        reason = "it is not a regular file" if os.path.exists(path) else "there is no such file"
        raise ValueError(f"Failed to load image {path!r}: {reason}")
    # On broken files Pillow's decoders raise errors of many types: OSError, SyntaxError, struct.error, KeyError, …
    large = _validate.refusing("more than 89 megapixels are refused: ", Image.DecompressionBombError)
    with _validate.refusing(f"Failed to load image {path!r}: ", Exception), large:
        found = _read(path, color_managed, asked)
    if len({(levels.shape, levels.dtype) for levels in found}) > 1:
        raise ValueError(f"pages of {path!r} differ in shape or type: read them one by one, such as with pages=0")
    if torch_style and found[0].ndim == 3:
        found = [np.moveaxis(levels, -1, 0) for levels in found]
    return np.ascontiguousarray(found[0] if asked is None or isinstance(asked, int) else np.stack(found))


def embedded_profile(fn: str | os.PathLike[str]) -> bytes | None:
    """Return the ICC profile in the file of an image that :func:`read_levels` has read.

    Parameters
    ----------
    fn : str or os.PathLike
        The file.

    Returns
    -------
    bytes or None
        The profile; None if there is none.
    """
    path = validate_path(fn, _READABLE)
    if holds_light(path):
        return None
    with _open(path) as image:
        return image.info.get("icc_profile") or None


def holds_light(fn: str | os.PathLike[str]) -> bool:
    """Return whether an image's format holds linear light by definition: OpenEXR and Radiance.

    Parameters
    ----------
    fn : str or os.PathLike
        The file.
    """
    return extension_of(os.fspath(fn)) in (_RADIANCE, _OPEN_EXR)


def white_level(levels: np.ndarray) -> float:
    """Return the value of white in an image as :func:`read_levels` gives it.

    Parameters
    ----------
    levels : numpy.ndarray
        Image.

    Returns
    -------
    float
        255 or 65535; 1 for floats.
    """
    return float(np.iinfo(levels.dtype).max) if levels.dtype.kind in "iu" else 1.0


def _read(path, color_managed, pages):
    """Return the images on the pages asked for, a list of arrays."""
    if (kind := extension_of(path)) in (_RADIANCE, _OPEN_EXR):
        _pages_of(path, pages, 1)
        return [_read_radiance(path) if kind == _RADIANCE else _read_exr(path)]
    try:
        with _open(path) as image:
            if image.format == "PNG":
                with _open(path) as checked:
                    # Loading alone does not compare the checksums of the pixels.
                    checked.verify()
            # The further frames of a JPEG are previews and maps of its gain.
            count = getattr(image, "n_frames", 1) if image.format in ("TIFF", "GIF", "WEBP", "PNG") else 1
            return [_read_page(path, image, page, color_managed) for page in _pages_of(path, pages, count)]
    except (UnidentifiedImageError, _TooDeep):
        with open(path, "rb") as stream:
            if stream.read(4) not in _TIFF:
                raise
        return _read_tiff(path, pages)


def _pages_of(path, pages, count):
    """Return the indices of the pages asked for, of so many; warn where the first is taken because nothing is asked."""
    if pages is None and count > 1:
        # The command line gives the same warning, of which Python shows one.
        warn(f"{path!r} has {count} frames or pages; the first one is used", ArgumentWarning)
    wanted = range(count) if pages == "all" else (pages or 0,) if pages is None or isinstance(pages, int) else pages
    if not count:
        raise ValueError("it has no pages: it is damaged or incomplete")
    if not wanted or max(wanted) >= count:
        raise ValueError(f"pages must be from 0 to {count - 1}, got {pages!r}")
    return wanted


def _read_page(path, image, page, color_managed):
    image.seek(page)
    _check_size(path, image.width, image.height)
    profile = image.info.get("icc_profile") if color_managed else None
    if _is_deep(image):
        if profile:
            warn(f"the colour profile of {path!r} is not applied: it has 16 bits per channel", AccuracyWarning)
        with _open(path) as again:
            again.seek(page)
            levels = _read_deep(image, again)
    else:
        levels = _shallow(_in_srgb(image, profile) if profile else image)
    # Read last: in PNG it may follow the pixels. Pillow turns TIFF while it decodes, and no other format.
    return levels if image.format == "TIFF" else _upright(levels, image.getexif().get(_ORIENTATION, 1))


def _read_tiff(path, pages):
    """Return pages of a TIFF that Pillow cannot represent: colour of floats, and of 16 bits in planes."""
    told = "a TIFF of floats, or of 16 bits in planes, needs tifffile: pip install tifffile"
    tifffile = _validate.optional("tifffile", told, ValueError)
    found = []
    with tifffile.TiffFile(path) as file:
        for number in _pages_of(path, pages, len(file.pages)):
            page = file.pages[number]
            _check_size(path, page.imagewidth, page.imagelength)
            samples = page.samplesperpixel
            if samples not in (1, 3, 4) or page.photometric.name not in ("RGB", "MINISBLACK"):
                raise ValueError(f"it has {samples} samples of {page.photometric.name}; grey, RGB and RGBA can be read")
            levels = page.asarray()
            if levels.dtype.kind == "f":
                levels = levels.astype(np.float32)
            elif levels.dtype.type not in (np.uint8, np.uint16):
                raise ValueError(f"its samples are {levels.dtype}; 8 and 16 bits and floating point can be read")
            levels = np.moveaxis(levels, 0, -1) if page.axes == "SYX" else levels
            found.append(_upright(levels, page.tags.valueof(_ORIENTATION, 1)))
    return found


def _upright(levels, orientation):
    """Return an image turned by its EXIF orientation, 1 to 8: the sides of its first row and first column."""
    if orientation in (5, 6, 7, 8):
        levels = levels.swapaxes(0, 1)
    rows, columns = orientation in (3, 4, 7, 8), orientation in (2, 3, 6, 7)
    return levels[:: -1 if rows else 1, :: -1 if columns else 1]


def _open(path):
    with warnings.catch_warnings():
        # Pillow warns from half of the size that is refused.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        image = Image.open(path, formats=_DECODERS)
    try:
        _check_size(path, image.width, image.height)
    except (ValueError, Image.DecompressionBombError):
        image.close()
        raise
    return image


def _check_size(path, width, height):
    """Raise an error for more pixels than such a file can contain, before memory is taken for them."""
    pixels = width * height
    if pixels > MOST_PIXELS:
        raise Image.DecompressionBombError(f"{width} x {height} pixels")
    if pixels > max(FREE_PIXELS, PIXELS_PER_BYTE * os.path.getsize(path)):
        raise ValueError(
            f"{width} x {height} pixels in {os.path.getsize(path)} bytes are more than such a file can contain"
        )


def _read_radiance(path):
    """Return the radiances ``[H, W, 3]`` of a file of Radiance's format, float32."""
    with open(path, "rb") as stream:
        start = stream.read(1 << 16)
    size = _SIZE_OF_RADIANCE.search(start)
    if not start.startswith(b"#?") or size is None:
        raise ValueError("it is not a picture of Radiance with rows from the top and columns from the left")
    _check_size(path, int(size[2]), int(size[1]))
    told = "pictures of Radiance need OpenCV: pip install opencv-python-headless"
    cv2 = _validate.optional("cv2", told, ValueError)
    with _validate.refusing("it cannot be decoded: ", cv2.error):
        picture = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise ValueError("it cannot be decoded")
    return picture[..., ::-1].astype(np.float32)


def _read_exr(path):
    """Return the grey, RGB or RGBA values of a picture of OpenEXR, float32."""
    told = "pictures of OpenEXR need the package OpenEXR: pip install OpenEXR"
    OpenEXR = _validate.optional("OpenEXR", told, ValueError)
    with OpenEXR.File(path, header_only=True) as file:
        (left, top), (right, bottom) = (map(int, corner) for corner in file.header()["dataWindow"])
    _check_size(path, right - left + 1, bottom - top + 1)
    with OpenEXR.File(path) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    for name in ("RGBA", "RGB", "Y"):
        if name in channels:
            return channels[name].astype(np.float32)
    raise ValueError(f"it has no channels RGB, RGBA or Y, but {', '.join(channels)}")


def _shallow(image):
    """Return the pixels of a picture that Pillow represents without loss."""
    if image.mode.startswith("I;16"):
        return np.asarray(image).astype(np.uint16)
    if image.mode == "I" and image.format in ("PNG", "PPM"):
        return np.asarray(image).astype(np.uint16)
    if image.format == "GIF":
        return np.array(image.convert("RGB"))
    if image.mode in ("L", "RGB", "RGBA", "I", "F"):
        return np.array(image)
    if image.mode == "1":
        return np.array(image.convert("L"))
    alpha = image.mode in ("LA", "La", "PA", "RGBa") or "transparency" in image.info
    return np.array(image.convert("RGBA" if alpha else "RGB"))


def _in_srgb(image, profile: bytes):
    """Return a picture of 8 bits, converted from its profile's colours to sRGB."""
    from PIL import ImageCms

    try:
        given, srgb = ImageCms.ImageCmsProfile(io.BytesIO(profile)), ImageCms.createProfile("sRGB")
        space = given.profile.xcolor_space.strip()
        if image.mode not in {"GRAY": ("L",), "CMYK": ("CMYK",)}.get(space, ("RGB", "RGBA")):
            alpha = image.mode in ("LA", "PA") or "transparency" in image.info
            image = image.convert("L" if space == "GRAY" else "RGBA" if alpha else "RGB")
        mode = "RGBA" if image.mode == "RGBA" else "RGB"
        return ImageCms.profileToProfile(image, given, srgb, ImageCms.Intent.RELATIVE_COLORIMETRIC, mode)
    except (ImageCms.PyCMSError, OSError) as error:
        raise ValueError(f"its colour profile cannot be used ({error}); color_managed=False ignores it") from error


def _checked(img):
    img = np.asarray(img)
    if img.dtype.kind not in "buif":
        raise TypeError(f"img must be real, got {img.dtype}")
    img = img[:, None] if img.ndim == 1 else img
    if img.ndim not in (2, 3) or 0 in img.shape or (img.ndim == 3 and img.shape[-1] not in (1, 3, 4)):
        raise ValueError(f"img must be [H], [H, W] or [H, W, 1 | 3 | 4], none empty; got {img.shape}")
    return img[..., 0] if img.ndim == 3 and img.shape[-1] == 1 else img


def check_levels(img: np.ndarray, white: float) -> None:
    """Warn where a picture of 0 … 1, or of 16 bits, is about to be saved with a white of 255."""
    brightest = float(np.max(img, initial=0, where=~np.isnan(img)))
    remedy = "the file is nearly black; give cmax=1.0 where 1 is white"
    if brightest > white:
        remedy = "all that is brighter becomes white; give cmax, such as 65535 for a picture of 16 bits"
    _validate.check_white("img", brightest, white, remedy)


def _levels(img, cmin, cmax, color_depth):
    if color_depth not in (8, 16):
        raise ValueError(f"color_depth must be 8 or 16, got {color_depth!r}")
    cmin, cmax = float(_validate.real("cmin", cmin)), float(_validate.real("cmax", cmax))
    if not cmin < cmax:
        raise ValueError(f"cmax must be larger than cmin, got cmin={cmin} and cmax={cmax}")
    white = 2**color_depth - 1
    levels = img.astype(np.float64)
    np.clip(levels, cmin, cmax, out=levels)
    levels -= cmin
    levels *= white / (cmax - cmin)
    np.rint(levels, out=levels)
    return np.nan_to_num(levels, copy=False).astype(np.uint8 if color_depth == 8 else np.uint16)


def _encoder(path, levels) -> Callable[..., Any]:
    """Return the function that writes the levels to a stream, or an error message if the format cannot store them."""
    form = _FORMATS[extension_of(path)]
    deep, colour, alpha = levels.dtype == np.uint16, levels.ndim == 3, levels.shape[2:] == (4,)
    if deep and (form in ("JPEG", "BMP") or (colour and form != "PNG")):
        held = "16-bit grey only" if form == "TIFF" else "8 bits only"
        raise ValueError(f"{path!r} cannot store this image: {form} stores {held}; PNG stores 16 bits")
    if alpha and form in ("JPEG", "BMP"):
        raise ValueError(f"{path!r} cannot store an alpha channel: PNG and TIFF can")
    if deep and colour:
        return lambda stream: _write_deep_png(stream, levels)
    options = _ENCODER_OPTIONS.get(form, {})
    return lambda stream: Image.fromarray(levels).save(stream, format=form, **options)


_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {3: 2, 4: 6}
_HALVES = {"RGB": ("RGB;16B", "RGB;16L"), "RGBA": ("RGBA;16B", "RGBA;16L")}
_BITS_PER_SAMPLE, _ORIENTATION = 258, 0x0112


def _is_deep(image: Any) -> bool:
    """Return whether a picture just opened has channels of more than 8 bits that Pillow would truncate.

    Parameters
    ----------
    image : PIL.Image.Image
        Opened, not yet loaded.

    Returns
    -------
    bool
        True for colour, or grey with alpha, of 16 bits.

    Raises
    ------
    ValueError
        If there are more than 8 bits in a layout that cannot be read without losing some.
    """
    if image.mode not in ("RGB", "RGBA", "LA", "CMYK") or not image.tile:
        return False
    raw = _raw_mode(image)
    if raw.split(";")[0] in ("RGB", "RGBA", "LA") and ";16" in raw:
        return True
    bits = image.tag_v2.get(_BITS_PER_SAMPLE, (8,)) if image.format == "TIFF" else (8,)
    ppm_white = image.tile[0][3][1] if image.format == "PPM" and isinstance(image.tile[0][3], tuple) else 255
    if max(bits) > 8 or (isinstance(ppm_white, int) and ppm_white > 255):
        raise _TooDeep(f"its colour has more than 8 bits in a layout that cannot be read whole ({raw}); use PNG")
    return False


def _read_deep(image: Image.Image, again: Image.Image) -> np.ndarray:
    """Return the samples of a 16-bit colour picture.

    Parameters
    ----------
    image : PIL.Image.Image
        A file for which :func:`_is_deep` holds, opened and not loaded.
    again : PIL.Image.Image
        The same file, opened a second time.

    Returns
    -------
    numpy.ndarray
        uint16 ``[H, W, 3]`` or ``[H, W, 4]``; grey with alpha has its grey repeated.
    """
    raw = _raw_mode(image)
    if raw.startswith("LA"):
        # Grey and alpha of two bytes each are as long as four channels of one byte.
        samples = _decode(image, "RGBA").astype(np.uint16)
        grey, alpha = samples[..., 0] << 8 | samples[..., 1], samples[..., 2] << 8 | samples[..., 3]
        return np.stack([grey, grey, grey, alpha], axis=-1)
    first, second = (
        _decode(half, mode).astype(np.uint16) for half, mode in zip((image, again), _HALVES[image.mode], strict=True)
    )
    little = raw.endswith("L") or (raw.endswith("N") and sys.byteorder == "little")
    return second << 8 | first if little else first << 8 | second


def _write_deep_png(stream: BinaryIO, levels: np.ndarray) -> None:
    """Write 16-bit colour as PNG.

    Parameters
    ----------
    stream : file object
        Binary, open for writing.
    levels : numpy.ndarray
        uint16 ``[H, W, 3]`` or ``[H, W, 4]``.
    """
    height, width, channels = levels.shape
    rows = np.zeros((height, 1 + 2 * channels * width), np.uint8)
    rows[:, 1:] = levels.astype(">u2").reshape(height, -1).view(np.uint8)
    header = struct.pack(">IIBBBBB", width, height, 16, _COLOUR_TYPES[channels], 0, 0, 0)
    stream.write(_SIGNATURE)
    for kind, content in ((b"IHDR", header), (b"IDAT", zlib.compress(rows.data)), (b"IEND", b"")):
        stream.write(struct.pack(">I", len(content)) + kind + content)
        stream.write(struct.pack(">I", zlib.crc32(kind + content)))


def _raw_mode(image):
    arguments = image.tile[0][3]
    raw = arguments[0] if isinstance(arguments, tuple) else arguments
    return raw if isinstance(raw, str) else ""


def _decode(image, raw):
    tiles = [(*tile[:3], (raw, *tile[3][1:]) if isinstance(tile[3], tuple) else raw) for tile in image.tile]
    # Named tuples in newer releases of Pillow, whose decoder of compressed TIFF takes nothing else.
    image.tile = [
        type(old)(*new) if hasattr(old, "_fields") else new for old, new in zip(image.tile, tiles, strict=True)
    ]
    # What cannot be decoded is an error here; NumPy would ask for another type.
    image.load()
    return np.asarray(image)


def resize_image(img: np.ndarray, target_size: tuple[int, int]) -> np.ndarray:
    """Resize an image; a smaller axis averages the pixels that each new one covers, a larger one interpolates.

    Parameters
    ----------
    img : numpy.ndarray
        ``[H, W]`` or ``[H, W, C]``.
    target_size : sequence of int
        Width and height, in that order.

    Returns
    -------
    numpy.ndarray
        ``[height, width]`` or ``[height, width, C]`` of the same dtype; integers are rounded.

    Raises
    ------
    TypeError
        If the image holds no numbers or the size no integers.
    ValueError
        If the image does not have two or three axes, or the size is not two positive integers.

    Examples
    --------
    A smaller image holds averages:

    >>> import numpy as np
    >>> from odak.tools import resize_image
    >>> resize_image(np.asarray([[0.0, 1.0, 2.0, 5.0]]), (2, 1)).tolist()
    [[0.5, 3.5]]
    """
    img = np.asarray(img)
    if img.dtype.kind not in "buifc":
        raise TypeError(f"img must be numeric, got {img.dtype}")
    _validate.shaped("img", img, "[H, W] or [H, W, C], none empty")
    if np.shape(target_size) != (2,):
        raise ValueError(f"target_size must be [width, height], got {target_size!r}")
    width, height = (
        _validate.side(name, _validate.integer(name, count, minimum=1))
        for name, count in zip(("target_size[0] (width)", "target_size[1] (height)"), target_size, strict=True)
    )
    result = img.astype(np.result_type(img, np.float64))
    for axis, size in sorted(((0, height), (1, width)), key=lambda pair: pair[1] / img.shape[pair[0]]):
        if size != img.shape[axis]:
            index, weight = _taps(img.shape[axis], size)
            along = [-1 if i == axis else 1 for i in range(img.ndim)]
            result = sum(result.take(i, axis) * w.reshape(along) for i, w in zip(index.T, weight.T, strict=True))
    return np.rint(result).astype(img.dtype) if img.dtype.kind in "bui" else result.astype(img.dtype)


def _taps(source, target):
    """Return the indices and weights of the samples that each new one is a mean of, both ``[target, taps]``."""
    step = source / target
    first = np.arange(target)[:, None]
    if step < 1:
        centre = (first + 0.5) * step - 0.5
        index = np.floor(centre) + np.arange(2)
        weight = 1 - np.abs(index - centre)
    else:
        start, end = first * step, (first + 1) * step
        index = np.floor(start) + np.arange(int(np.ceil(step)) + 1)
        weight = np.clip(np.minimum(index + 1, end) - np.maximum(index, start), 0, None) / step
    return np.clip(index, 0, source - 1).astype(np.intp), weight
