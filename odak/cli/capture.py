"""Captures of holograms for `odak capture`: patterns on the modulator, what the camera sees, and what was predicted."""

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch

from odak.cli import files
from odak.cli import report as sheets
from odak.cli.calibrate import Table, known_table, open_table, reach_of
from odak.cli.options import InputError, refusing
from odak.cli.settings import CaptureSettings
from odak.instruments import Calibration, Lens, record_captures, save_captures, set_exposure
from odak.instruments.calibration import predicted_capture
from odak.tools.file import read_levels

CAPTURES = "captures.h5"


@files.claiming
def run(job: CaptureSettings, notices: files.Notices = files.SILENT) -> dict[str, Any]:
    """Show patterns, capture each, and write the captures beside their predictions.

    Of a folder of `odak hologram` all patterns are shown. Written are ``capture_NAME.png`` for each pattern,
    ``captures.h5`` and ``report.json``. Wavelength and distance are those of the calibration where there is one.

    Parameters
    ----------
    job : CaptureSettings
        Settings of the run.
    notices : Notices
        What to do about files of earlier runs.

    Returns
    -------
    dict
        The report.

    Raises
    ------
    InputError
        If an instrument, a pattern or the calibration cannot be used.
    """
    table, calibration = open_table(job, "capture"), job.calibration
    folder = files.writable_folder(job.output)
    paths = pattern_files(job.pattern)
    levels = np.stack([read_pattern(path, table.modulator.shape, table.modulator.bits) for path in paths])
    if calibration is None:
        known = Calibration.nominal(table.modulator, table.camera, job.wavelength, reach_of(job))
    else:
        known = files.read_calibration(str(calibration))
        known = known_table(table, Path(calibration).expanduser(), known.wavelength, known.distance, "--calibration")
        if known.registration.shape != tuple(table.camera.shape):
            raise InputError(
                f"--calibration is of a camera of {list(known.registration.shape)} pixels, got "
                f"{list(table.camera.shape)}"
            )
    names = [f"capture_{path.stem}.png" for path in paths]
    files.claim(folder)
    files.announce(folder, [*names, CAPTURES], notices)
    with sheets.collected_warnings() as texts:
        table.modulator.show(levels[0])
        set_exposure(table.camera)
        found = record_captures(table.modulator, table.camera, levels, known.wavelength, captures=job.captures)
        save_captures(folder / CAPTURES, found)
        results = []
        for number, name in enumerate(names):
            predicted = predicted_capture(known, levels[number])
            numbers, picture = _compared(found.frames[number].astype(np.float64), predicted, table)
            files.write_png(folder / name, picture)
            results.append({"pattern": str(paths[number]), "figure": name, **numbers})
    report = {
        "patterns": results,
        "captures": CAPTURES,
        "exposure": found.exposure,
        "wavelength": known.wavelength,
        "distance": None if isinstance(known.distance, Lens) else known.distance,
        "lens": dataclasses.asdict(known.distance) if isinstance(known.distance, Lens) else None,
        "calibration": None if calibration is None else str(calibration),
        "warnings": texts,
        **sheets.about("capture"),
    }
    files.write_json(folder / files.REPORT, report)
    return report


def pattern_files(pattern: Path) -> list[Path]:
    """Return the files of the patterns in a folder of `odak hologram`, or the one file given.

    Raises
    ------
    InputError
        If there is no such file, or the folder has no report of a hologram.
    """
    path = Path(os.path.expanduser(pattern))
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InputError(f"PATTERN not found: {str(path)!r}")
    try:
        names = json.loads((path / files.REPORT).read_text(encoding="utf-8"))["pattern"]["files"]
        found = [path / os.path.basename(name) for name in names]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"PATTERN {str(path)!r} is a folder without a report of odak hologram") from None
    if not found or not all(file.is_file() for file in found):
        raise InputError(f"PATTERN {str(path)!r} lacks a pattern that its report names")
    return found


def read_pattern(path: Path, shape: tuple[int, int], bits: int) -> np.ndarray:
    """Return the levels of a pattern, integers ``[rows, columns]``.

    Parameters
    ----------
    path : Path
        Grey picture of 8 or 16 bits; of the levels of fewer bits the picture holds the multiples.
    shape : tuple of int
        Rows and columns of the modulator.
    bits : int
        Bits of the modulator.

    Raises
    ------
    InputError
        If it is another picture.
    """
    with refusing("", ValueError, TypeError):
        grey = read_levels(path)
    if grey.ndim != 2 or grey.dtype.kind != "u":
        raise InputError(f"PATTERN {str(path)!r} must be a grey picture of levels, got {list(grey.shape)} {grey.dtype}")
    if grey.shape != tuple(shape):
        raise InputError(
            f"PATTERN {str(path)!r} must have the {shape[0]} x {shape[1]} pixels of the modulator, got "
            f"{grey.shape[0]} x {grey.shape[1]}"
        )
    excess = 8 * grey.dtype.itemsize - bits
    if excess < 0 or (grey & ((1 << excess) - 1)).any():
        raise InputError(f"PATTERN {str(path)!r} of {8 * grey.dtype.itemsize} bits holds no levels of {bits} bits")
    return grey >> excess


def _compared(frames: np.ndarray, predicted: np.ndarray, table: Table):
    """Return numbers and a picture that compare captures ``[captures, rows, columns]`` with their prediction."""
    mean = frames.mean(0)
    system = np.stack([predicted.ravel(), np.ones(predicted.size)], axis=1)
    (factor, offset), *_ = np.linalg.lstsq(system, mean.ravel(), rcond=None)
    fitted = factor * predicted + offset
    energy = np.sqrt(np.mean((mean - offset) ** 2)) or 1.0
    error = float(np.sqrt(np.mean((mean - fitted) ** 2)) / energy)
    noise = None
    if len(frames) > 1:
        noise = float(np.sqrt(frames.var(0, ddof=1).mean() / len(frames)) / energy)
    spread = mean.std() * predicted.std()
    correlation = float(np.mean((mean - mean.mean()) * (predicted - predicted.mean())) / spread) if spread > 0 else 0.0
    seen, expected = (
        torch.from_numpy((light - offset) / (mean.max() - offset or 1.0))[None] for light in (mean, fitted)
    )
    panels = [
        sheets.picture_panel("Capture", seen),
        sheets.picture_panel(f"Prediction, correlation {correlation:.3f}", expected),
        sheets.difference_panel(f"Capture minus prediction, {error:.1%} of the capture", seen - expected),
    ]
    numbers = {
        "correlation": correlation,
        "relative_error": error,
        "noise_share": noise,
        "brightest_share": float(mean.max() / ((1 << table.camera.bits) - 1)),
    }
    return numbers, sheets.sheet([panels], table.camera.shape[1] * table.camera.pitch)
