"""Files that makers give with a modulator: corrections of its wavefront, and look-up tables of its levels."""

import os
from collections.abc import Sequence

import numpy as np

from odak import _validate
from odak.tools.file import read_levels
from odak.tools.paths import extension_of, regular_file, validate_path

IMAGES, TEXTS = (".bmp", ".png", ".tif", ".tiff"), (".csv", ".txt", ".lut")
# Bytes of a text at most: those of 8 million levels of four digits.
LARGEST = 40_000_000


def load_correction(
    path: str | os.PathLike[str], shape: Sequence[int] | None = None, cycle: float | None = None
) -> np.ndarray:
    """Read the correction of a modulator's wavefront from an image or a text of levels, as makers give it.

    Such files are added to each pattern: images in grey of Hamamatsu and Meadowlark, and tables of Santec with numbers
    of columns and rows along their edges. The aberration that a file corrects is its negative.

    Parameters
    ----------
    path : str or os.PathLike
        Image (``.bmp``, ``.png``, ``.tif``) or text (``.csv``, ``.txt``) of a row of levels in each line, parted by
        commas, semicolons, tabs or spaces. Where its first line does not begin with a number, it is a title of the
        columns, and the first column one of the rows.
    shape : sequence of int, optional
        Rows and columns that it must have, those of the modulator.
    cycle : float, optional
        Levels of a cycle of 2π: 256 for images of 8 bits and 65536 for those of 16 by default; texts need it.

    Returns
    -------
    numpy.ndarray
        Phase in radians ``[rows, columns]`` to add to patterns, not wrapped.

    Raises
    ------
    FileNotFoundError
        If there is no such text.
    ValueError
        If it cannot be read, is coloured, has another shape or values that are not finite; the message names it.

    Examples
    --------
    A modulator with the maker's correction, in place of a measured aberration:

    >>> import os, tempfile
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from odak.instruments import Calibration, SimulatedTable, load_correction
    >>> table = SimulatedTable(seed=1, shape=(2, 3), camera_shape=(8, 8))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "correction.csv")
    ...     with open(name, "w") as stream:
    ...         print("Y/X,0,1,2", "0,0,128,256", "1,512,64,0", sep=os.linesep, file=stream)
    ...     correction = load_correction(name, table.modulator.shape, cycle=1024)
    >>> (correction / np.pi).tolist()
    [[0.0, 0.25, 0.5], [1.0, 0.125, 0.0]]
    >>> assumed = Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
    >>> replace(assumed, wavefront=-correction).levels(np.zeros((2, 3))).tolist()
    [[0, 32, 64], [128, 16, 0]]
    """
    found = validate_path(path, (*IMAGES, *TEXTS))
    if cycle is not None:
        cycle = float(_validate.number("cycle", cycle, positive=True))
    if extension_of(found) in TEXTS:
        if cycle is None:
            raise ValueError(f"cycle must be given for {found!r}, a text, which does not tell the levels of 2π")
        levels = _table(found, titled=True)
    else:
        levels = read_levels(found)
        if levels.ndim == 3:
            if (levels[..., :3] != levels[..., :1]).any():
                raise ValueError(f"{found!r} must be an image in grey, got colours")
            levels = levels[..., 0]
        if cycle is None and levels.dtype.kind != "u":
            raise ValueError(f"cycle must be given for {found!r}, whose levels are of {levels.dtype}")
        cycle = cycle or float(np.iinfo(levels.dtype).max) + 1
    if not np.isfinite(levels).all():
        raise ValueError(f"{found!r} must hold finite levels")
    if shape is not None and levels.shape != _validate.size("shape", shape):
        raise ValueError(f"{found!r} must have the shape {list(shape)} of the modulator, got {list(levels.shape)}")
    return 2 * np.pi / cycle * levels


def load_look_up_table(path: str | os.PathLike[str]) -> np.ndarray:
    """Read the value of each level, such as a voltage, from the text of a look-up table.

    Parameters
    ----------
    path : str or os.PathLike
        Text (``.lut``, ``.csv``, ``.txt``) with a level and its value in each line, levels in any order, or the value
        alone, parted by commas, semicolons, tabs or spaces. A first line that does not begin with a number is a title.

    Returns
    -------
    numpy.ndarray
        Values ``[levels]``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it cannot be read, or its levels are not 0, 1, 2 … up to some, each once; the message names it.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.instruments import load_look_up_table
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "linear.lut")
    ...     with open(name, "w") as stream:
    ...         print("0 2047", "1 1983", "2 1920", sep=os.linesep, file=stream)
    ...     load_look_up_table(name).tolist()
    [2047.0, 1983.0, 1920.0]
    """
    return values_of_levels(validate_path(path, TEXTS))


def values_of_levels(path: str) -> np.ndarray:
    """Return the values in a text, whatever its name; errors are those of :func:`load_look_up_table`."""
    *first, values = _table(path, titled=False).T
    levels = first[0] if first else np.arange(len(values))
    if len(first) > 1 or not np.isfinite(values).all() or (np.sort(levels) != np.arange(len(values))).any():
        raise ValueError(f"{path!r} must hold lines of a level, 0, 1, 2 …, and a finite value, or of a value alone")
    return values[np.argsort(levels)]


def _table(path: str, titled: bool) -> np.ndarray:
    """Return the numbers of a text ``[lines, columns]``; if `titled`, a line of titles has a column of titles too."""
    if os.path.getsize(regular_file(path)) > LARGEST:
        raise ValueError(f"{path!r} has more than {LARGEST} bytes, the most that are read")
    with _validate.refusing(f"{path!r} cannot be read as lines of numbers: ", ValueError):
        with open(path, encoding="utf-8-sig") as stream:
            lines = [text for line in stream if (text := line.strip()) and not text.startswith("#")]
        if not lines:
            raise ValueError("it has no lines")
        between = next((sign for sign in ";," if sign in lines[0]), None)
        title = not _is_number(lines[0].replace(between or " ", " ").split()[:1])
        rows = (line.rstrip(f"{between or ''} ") for line in lines[title:])
        numbers = np.loadtxt(rows, delimiter=between, ndmin=2) if len(lines) > title else np.zeros((0, 0))
    numbers = numbers[:, 1:] if title and titled else numbers
    if not numbers.size:
        raise ValueError(f"{path!r} holds no numbers")
    return numbers


def _is_number(cells: list[str]) -> bool:
    """Return whether the first of the cells is a number."""
    try:
        return bool(cells) and np.isfinite(float(cells[0]))
    except ValueError:
        return False
