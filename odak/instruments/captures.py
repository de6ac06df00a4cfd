"""Captures of patterns, and the HDF5 files that hold them."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from odak import _show, _validate
from odak.instruments.array_files import checked_array, checked_number, read_hdf5, write_hdf5
from odak.instruments.protocols import Camera, SLMDriver, Stage, check_square_pixels, checked_camera, checked_dark

CAPTURES, CAPTURES_VERSION = "odak captures", 1
CAPTURE_UNITS = {
    "levels": "level",
    "frames": "count",
    "positions": "m",
    "dark": "count",
    "wavelength": "m",
    "pitch": "m",
    "camera_pitch": "m",
    "exposure": "s",
}
# Ranges of what files hold: lengths and times in metres and seconds, levels and counts.
WAVELENGTHS, PITCHES, LARGEST_DISTANCE = (1e-9, 1e-3), (1e-8, 1e-2), 1e3
EXPOSURES, MOST_BITS = (1e-12, 1e6), 32


@dataclass(frozen=True, repr=False)
class Captures(_show.Shown):
    """Patterns that a modulator showed and what a camera captured of each.

    Attributes
    ----------
    levels : numpy.ndarray
        Patterns, integers ``[patterns, rows, columns]``.
    frames : numpy.ndarray
        Captures in counts, integers ``[patterns, captures, camera rows, camera columns]``.
    positions : numpy.ndarray
        Position of the stage in metres for each pattern ``[patterns]``.
    wavelength : float
        Vacuum wavelength in metres.
    pitch : float
        Distance between pixels of the modulator in metres.
    camera_pitch : float
        Distance between pixels of the camera in metres.
    camera_bits : int
        Bit depth of the camera.
    exposure : float
        Exposure time in seconds, the same for all.
    dark : numpy.ndarray or float
        Counts without light ``[camera rows, camera columns]``, or one number.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import SimulatedTable, record_captures
    >>> table = SimulatedTable(seed=1, shape=(24, 24), camera_shape=(32, 32))
    >>> levels = np.random.default_rng(0).integers(256, size=(3, 24, 24))
    >>> found = record_captures(table.modulator, table.camera, levels, 532e-9, captures=4)
    >>> len(found), found.frames.shape, found[:2].means().shape
    (3, (3, 4, 32, 32), (2, 32, 32))
    """

    levels: np.ndarray
    frames: np.ndarray
    positions: np.ndarray
    wavelength: float
    pitch: float
    camera_pitch: float
    camera_bits: int
    exposure: float
    dark: np.ndarray | float = 0.0

    def __len__(self) -> int:
        return len(self.levels)

    def __getitem__(self, part: slice) -> "Captures":
        """Return the captures of some of the patterns."""
        chosen = {name: getattr(self, name)[part] for name in ("levels", "frames", "positions")}
        return Captures(**{**self.__dict__, **chosen})

    def means(self) -> np.ndarray:
        """Return the mean of the captures of each pattern, less the dark counts ``[patterns, rows, columns]``."""
        return self.frames.mean(1, dtype=np.float64) - self.dark

    def noise(self) -> tuple[float, float]:
        """Return slope and offset of the variance of a capture as a function of its mean (photon transfer).

        At least two captures of each pattern are needed. The means of the squared differences, in groups of pixels of
        similar brightness, are fitted by a straight line, each weighted with its own uncertainty.

        Returns
        -------
        tuple of float
            Counts per electron, and the variance without light in counts².
        """
        count = self.frames.shape[1]
        if count < 2:
            raise ValueError(f"frames must contain at least 2 captures of each pattern to show noise, got {count}")
        top = 0.98 * ((1 << self.camera_bits) - 1)
        fine = self.frames.max(1) < top
        mean = self.means()[fine]
        variance = np.moveaxis(self.frames, 1, 0)[:, fine].var(0, ddof=1, dtype=np.float64)
        order = np.argsort(mean)
        groups = [group for group in np.array_split(order, 30) if len(group)]
        x, y = (np.array([values[group].mean() for group in groups]) for values in (mean, variance))
        fitted = np.polynomial.Polynomial.fit(x, y, 1, w=1 / np.maximum(y, 1e-6)).convert().coef
        slope, offset = (fitted[1], fitted[0]) if len(fitted) > 1 else (0.0, fitted[0])
        return max(float(slope), 0.0), max(float(offset), 1 / 12)


@_validate.takes_units("wavelength")
def record_captures(
    modulator: SLMDriver,
    camera: Camera,
    levels: np.ndarray,
    wavelength: float,
    *,
    captures: int = 2,
    positions: np.ndarray | None = None,
    stage: Stage | None = None,
    dark: np.ndarray | float = 0.0,
) -> Captures:
    """Show patterns and capture each.

    Parameters
    ----------
    modulator : SLMDriver
        The modulator.
    camera : Camera
        The camera; its exposure is taken as it is.
    levels : numpy.ndarray
        Patterns, integers ``[patterns, rows, columns]``.
    wavelength : float
        Vacuum wavelength in metres.
    captures : int
        Number of captures of each pattern.
    positions : numpy.ndarray, optional
        Position of the stage in metres for each pattern; 0 by default.
    stage : Stage, optional
        The stage, which moves to the positions.
    dark : numpy.ndarray or float
        Counts without light, see :func:`odak.instruments.measure_dark`.

    Returns
    -------
    Captures
        The captures.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import SimulatedTable, record_captures
    >>> table = SimulatedTable(seed=1, shape=(24, 24), camera_shape=(32, 32))
    >>> levels = np.random.default_rng(0).integers(256, size=(3, 24, 24))
    >>> record_captures(table.modulator, table.camera, levels, 532e-9).frames.shape
    (3, 2, 32, 32)
    """
    levels = np.asarray(_validate.array("levels", levels))
    _validate.shaped("levels", levels, f"[patterns, {modulator.shape[0]}, {modulator.shape[1]}]")
    places = np.zeros(len(levels)) if positions is None else np.asarray(positions, float)
    if places.shape != (len(levels),):
        raise ValueError(f"positions must contain one number for each of {len(levels)} patterns, got {places.shape}")
    check_square_pixels(modulator, camera)
    camera = checked_camera(camera)
    if stage is None and places.any():
        raise ValueError("stage must be given where positions differ from 0, got None")
    frames = []
    for pattern, place in zip(levels, places, strict=True):
        if stage is not None:
            stage.move(float(place))
        modulator.show(pattern)
        frames.append(camera.capture(_validate.integer("captures", captures, minimum=1)))
    dark = checked_dark(dark, frames[0]) if np.ndim(dark) else dark
    kind = np.uint8 if modulator.bits <= 8 else np.uint16
    return Captures(
        levels.astype(kind),
        np.stack(frames),
        places,
        float(_validate.number("wavelength", wavelength, positive=True)),
        *(modulator.pitch, camera.pitch, camera.bits, camera.exposure, dark),
    )


def save_captures(path: str | os.PathLike[str], captures: Captures) -> None:
    """Write captures to an HDF5 file, which appears whole or not at all.

    The file has the attributes ``format`` ("odak captures"), ``version`` (1), ``wavelength``, ``pitch``,
    ``camera_pitch``, ``camera_bits`` and ``exposure``, and the data sets ``levels``, ``frames``, ``positions`` and
    ``dark``; each data set has the attribute ``units``, and the attribute ``units`` of the file is a JSON object with
    the units of all quantities.

    Parameters
    ----------
    path : str or os.PathLike
        ``.h5`` or ``.hdf5`` file to write; needs the package h5py (``pip install h5py``).
    captures : Captures
        The captures.

    Raises
    ------
    ValueError
        If a value is out of range or an array of another shape than the others require; the message names it.
    OSError
        If the disk is full; the error names the file, and one that was there before remains.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.instruments import SimulatedTable, load_captures, record_captures, save_captures
    >>> table = SimulatedTable(seed=1, shape=(24, 24), camera_shape=(32, 32))
    >>> levels = np.random.default_rng(0).integers(256, size=(3, 24, 24))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "captures.h5")
    ...     save_captures(name, record_captures(table.modulator, table.camera, levels, 532e-9))
    ...     found = load_captures(name)
    >>> found.frames.shape, bool((found.levels == levels).all())
    ((3, 2, 32, 32), True)
    """
    _validate.instance("captures", captures, Captures, "Captures")
    values = _checked(captures.__dict__).__dict__.copy()
    arrays = {name: np.asarray(values.pop(name)) for name in ("levels", "frames", "positions", "dark")}
    write_hdf5(path, arrays, {"format": CAPTURES, "version": CAPTURES_VERSION, **values}, CAPTURE_UNITS)


def load_captures(path: str | os.PathLike[str]) -> Captures:
    """Read captures that :func:`save_captures` wrote.

    Parameters
    ----------
    path : str or os.PathLike
        ``.h5`` or ``.hdf5`` file.

    Returns
    -------
    Captures
        The captures.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it does not hold captures, a value is out of range or an array of another shape than the others require, or
        its arrays take more than 160 MiB and more than 64 bytes for each byte of the file; the message names the file
        and the value.

    Examples
    --------
    A file of something else is refused by name:

    >>> import os, tempfile
    >>> import h5py
    >>> from odak.instruments import load_captures
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "other.h5")
    ...     h5py.File(name, "w").close()
    ...     try:
    ...         load_captures(name)
    ...     except ValueError as error:
    ...         print("cannot be read as captures" in str(error))
    True
    """
    with _validate.refusing(f"{os.fspath(path)!r} cannot be read as captures: ", KeyError, TypeError, ValueError):
        arrays, header = read_hdf5(path, CAPTURES, CAPTURES_VERSION)
        return _checked({**header, "dark": 0.0, **arrays})


def _checked(values: Mapping[str, Any]) -> Captures:
    """Return captures after checking each value: what is out of range or of another shape is refused by its name."""
    bits = int(checked_number("camera_bits", values["camera_bits"], 1, MOST_BITS, whole=True))
    top = (1 << bits) - 1
    levels = checked_array("levels", values["levels"], ("patterns", "rows", "columns"), 0, 65535, whole=True)
    shape = (len(levels), "captures", "camera rows", "camera columns")
    frames = checked_array("frames", values["frames"], shape, 0, top, whole=True)
    dark = values["dark"]
    return Captures(
        levels,
        frames,
        checked_array("positions", values["positions"], (len(levels),), -LARGEST_DISTANCE, LARGEST_DISTANCE),
        checked_number("wavelength", values["wavelength"], *WAVELENGTHS, "metres"),
        checked_number("pitch", values["pitch"], *PITCHES, "metres"),
        checked_number("camera_pitch", values["camera_pitch"], *PITCHES, "metres"),
        bits,
        checked_number("exposure", values["exposure"], *EXPOSURES, "seconds"),
        checked_array("dark", dark, frames.shape[2:], 0, top)
        if np.ndim(dark)
        else checked_number("dark", dark, 0, top, "counts"),
    )
