"""Files of calibrations, whose fields are checked before they are believed."""

import io
import itertools
import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from odak import _validate
from odak.instruments.array_files import SUFFIXES, checked_array, checked_number, read_hdf5, write_hdf5
from odak.instruments.calibration import UNITS, Calibration
from odak.instruments.captures import LARGEST_DISTANCE, PITCHES, WAVELENGTHS
from odak.instruments.mapping import Lens, Registration
from odak.tools.file import read_npz
from odak.tools.paths import validate_path, write_file

FORMAT, VERSION = "odak calibration", 1


def save_calibration(path: str | os.PathLike[str], calibration: Calibration) -> None:
    """Write a calibration to a file, which appears whole or not at all.

    The file holds the arrays phases, amplitude, wavefront and homography, and of the regions where they were measured,
    regional_phases; and the format ("odak calibration"), its version (1), the units of all quantities, and the numbers
    wavelength, pitch, distance, distortion, camera_shape, residual and unmodulated (its real and imaginary part), and
    uncertainty_phases and so on of what was measured. In ``.npz`` these are a JSON object, UTF-8 text in the array
    ``header``; in HDF5 they are attributes of the file.

    Parameters
    ----------
    path : str or os.PathLike
        ``.npz`` file, or ``.h5`` or ``.hdf5`` file, which needs h5py (``pip install h5py``).
    calibration : Calibration
        The results.

    Raises
    ------
    ValueError
        If a value is out of range or an array of another shape than the others require; the message names it.
    OSError
        If the disk is full; the error names the file, and one that was there before remains.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.instruments import Calibration, SimulatedTable, load_calibration, save_calibration
    >>> table = SimulatedTable(seed=1, shape=(32, 32), camera_shape=(40, 48))
    >>> assumed = Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "table.npz")
    ...     save_calibration(name, assumed)
    ...     load_calibration(name).distance
    0.02
    """
    _validate.instance("calibration", calibration, Calibration, "a Calibration")
    path = validate_path(path, [".npz", *SUFFIXES])
    header = {"format": FORMAT, "version": VERSION, **_values(_checked(_values(calibration)))}
    arrays = {name: header.pop(name) for name in (*_MAPS, "homography", "regional_phases") if name in header}
    if path.lower().endswith(SUFFIXES):
        write_hdf5(path, arrays, header, UNITS)
        return
    packed = io.BytesIO()
    text = json.dumps({**header, "units": UNITS})
    np.savez(packed, header=np.frombuffer(text.encode(), dtype=np.uint8), **arrays)
    write_file(path, packed.getbuffer())


def load_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration that :func:`save_calibration` wrote.

    Parameters
    ----------
    path : str or os.PathLike
        ``.npz``, ``.h5`` or ``.hdf5`` file.

    Returns
    -------
    Calibration
        The results.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a calibration, a value is out of range (such as a length that is not in metres) or an array of
        another shape than the others require, or its arrays take more than 160 MiB and more than 64 bytes for each
        byte of the file; the message names the file and the value.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.instruments import Calibration, SimulatedTable, load_calibration, save_calibration
    >>> table = SimulatedTable(seed=1, shape=(32, 32), camera_shape=(40, 48))
    >>> assumed = Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "table.npz")
    ...     save_calibration(name, assumed)
    ...     load_calibration(name).wavelength
    5.32e-07
    """
    path = validate_path(path, [".npz", *SUFFIXES])
    if not os.path.exists(path):
        raise FileNotFoundError(f"there is no file {path!r}")
    with _validate.refusing(f"{path!r} cannot be read as a calibration: ", KeyError, TypeError, ValueError, OSError):
        arrays, header = read_hdf5(path, FORMAT, VERSION) if path.lower().endswith(SUFFIXES) else _read_npz(path)
        return _checked({**header, **arrays})


def _read_npz(path: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the arrays and the header of a ``.npz`` file."""
    arrays = read_npz(path)
    with _validate.refusing("its header is not JSON: ", ValueError, RecursionError):
        header = json.loads(arrays.pop("header").tobytes().decode())
    if not isinstance(header, dict) or header.get("format") != FORMAT or header.get("version") != VERSION:
        told = header if isinstance(header, dict) else {}
        raise ValueError(f"its format is {told.get('format')!r}, version {told.get('version')!r}")
    return arrays, header


def _values(calibration: Calibration) -> dict[str, Any]:
    """Return the values of a calibration by the names that they have in files."""
    registration, path = calibration.registration, calibration.distance
    lens = [path.focal_length, path.before, path.after, path.block] if isinstance(path, Lens) else None
    return {
        **{name: getattr(calibration, name) for name in ("wavelength", "pitch", *_MAPS)},
        **({"distance": path} if lens is None else {"lens": np.array(lens)}),
        "homography": registration.homography,
        "distortion": registration.distortion,
        "camera_shape": registration.shape,
        "residual": registration.residual,
        "unmodulated": (calibration.unmodulated.real, calibration.unmodulated.imag),
        **({} if calibration.regional_phases is None else {"regional_phases": calibration.regional_phases}),
        **{f"{_UNCERTAIN}{name}": value for name, value in calibration.uncertainty.items()},
    }


_MAPS, _UNCERTAIN = ("phases", "amplitude", "wavefront"), "uncertainty_"
# Largest phase in radians; distortion at which the mapping of a camera folds; largest camera; least ratio of the
# magnifications of a camera along two directions.
_LARGEST_PHASE, _LARGEST_DISTORTION, _LARGEST_CAMERA, _LEAST_RATIO = 1e6, 1 / 3, 65536, 1e-3


def _checked(values: Mapping[str, Any]) -> Calibration:
    """Return a calibration after checking each value: what is out of range or of another shape is refused by name."""
    phases = checked_array("phases", values["phases"], ("levels",), -_LARGEST_PHASE, _LARGEST_PHASE)
    if len(phases) < 2:
        raise ValueError(f"phases must have at least 2 levels, got {len(phases)}")
    amplitude = checked_array("amplitude", values["amplitude"], ("rows", "columns"), 0, 1 + 1e-6)
    if not amplitude.any():
        raise ValueError("amplitude must be above 0 at some pixel, got 0 at all")
    regional = values.get("regional_phases")
    if regional is not None:
        shape = ("region rows", "region columns", len(phases))
        regional = checked_array("regional_phases", regional, shape, -_LARGEST_PHASE, _LARGEST_PHASE)
        if any(n > m for n, m in zip(regional.shape, amplitude.shape, strict=False)):
            raise ValueError(f"regional_phases must have at most {amplitude.shape} regions, got {regional.shape[:2]}")
    names = [name for name in values if name.startswith(_UNCERTAIN)]
    doubts = {name.removeprefix(_UNCERTAIN): float(checked_number(name, values[name], 0, 1e6)) for name in names}
    return Calibration(
        checked_number("wavelength", values["wavelength"], *WAVELENGTHS, "metres"),
        checked_number("pitch", values["pitch"], *PITCHES, "metres"),
        _checked_path(values),
        phases,
        amplitude,
        checked_array("wavefront", values["wavefront"], amplitude.shape, -_LARGEST_PHASE, _LARGEST_PHASE),
        _checked_registration(values, doubts.get("registration", 0.0)),
        regional,
        doubts,
        complex(*checked_array("unmodulated", values.get("unmodulated", (0.0, 0.0)), (2,), -1, 1)),
    )


def _checked_path(values: Mapping[str, Any]) -> float | Lens:
    """Return the distance of a file, or its lens."""
    if "lens" in values:
        return Lens(*(float(n) for n in checked_array("lens", values["lens"], (4,), 0, LARGEST_DISTANCE)))
    return checked_number("distance", values["distance"], 1e-9, LARGEST_DISTANCE, "metres")


def _checked_registration(values: Mapping[str, Any], doubt: float) -> Registration:
    """Return the registration of a file unless it maps the sensor through infinity or onto a line."""
    shape = np.asarray(values["camera_shape"])
    if shape.shape != (2,):
        raise ValueError(f"camera_shape must be two numbers [rows, columns], got {values['camera_shape']!r:.80}")
    rows, columns = (
        int(checked_number(f"camera_shape[{i}]", n, 1, _LARGEST_CAMERA, whole=True)) for i, n in enumerate(shape)
    )
    homography = checked_array("homography", values["homography"], (3, 3), -1e12, 1e12)
    corners = np.array(list(itertools.product((-columns, columns), (-rows, rows)))) / 2
    depths = np.array([homography[2, 2], *(corners @ homography[2, :2] + homography[2, 2])])
    if not (abs(depths) > 1e-9 * abs(homography[2]).max()).all() or len(set(np.sign(depths))) > 1:
        raise ValueError("homography must map the whole sensor to points at finite distances, and has a pole on it")
    # Its derivative in the middle of the sensor, in metres for each pixel.
    derivative = homography[:2, :2] - np.outer(homography[:2, 2], homography[2, :2]) / homography[2, 2]
    large, small = np.linalg.svd(derivative / homography[2, 2], compute_uv=False)
    if not (PITCHES[0] / 100 < large < 100 * PITCHES[1] and small > _LEAST_RATIO * large):
        raise ValueError(
            f"homography must map a pixel to an area, of {PITCHES[0] / 100:g} to {100 * PITCHES[1]:g} metres, got "
            f"{large:g} along one direction and {small:g} along the other"
        )
    return Registration(
        homography,
        checked_number("distortion", values["distortion"], -_LARGEST_DISTORTION, _LARGEST_DISTORTION),
        (rows, columns),
        checked_number("residual", values["residual"], 0, _LARGEST_CAMERA, "pixels"),
        doubt,
    )
