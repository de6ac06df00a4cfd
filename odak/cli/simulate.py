"""Light through an optical bench that a file describes, for `odak simulate`; see :mod:`odak.wave.bench_files`."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import torch

from odak.cli import files, report
from odak.cli.job import check_wavelength, warn_of_samples
from odak.cli.options import refusing
from odak.cli.settings import SimulateSettings
from odak.wave import bench_schema
from odak.wave.bench_files import BENCH, ELEMENTS, load_bench, positions, steps_of
from odak.wave.transfer_functions import pitches

SUFFIXES = (".npy", ".png")


def schema() -> str:
    """Return the JSON schema of the file of a bench."""
    return json.dumps(bench_schema(), indent=2)


@files.claiming
def run(job: SimulateSettings, notices: files.Notices = files.SILENT) -> dict[str, Any]:
    """Pass light through the bench of a file, and write the fields that it records.

    Parameters
    ----------
    job : SimulateSettings
        Settings of the run. Written are for each record ``NAME.npy`` (complex64) and ``NAME.png``, and
        ``report.json``, which holds the configuration.
    notices : files.Notices
        What to do about results of earlier runs.

    Returns
    -------
    dict
        The report.

    Raises
    ------
    InputError
        If the file cannot be read or does not conform to the schema.
    """
    with report.collected_warnings() as texts:
        with refusing(lambda text: re.sub(r"(^|: )config\b", r"\1CONFIG", text, count=1), TypeError, ValueError):
            bench, elements = load_bench(Path(str(job.config)))
        check_wavelength(f"{BENCH}: wavelength", bench["wavelength"])
        coarsest = max(pitches(bench["pixel_pitch"]))
        warn_of_samples(f"{BENCH}: wavelength", bench["wavelength"], f"{BENCH}: pixel_pitch", coarsest)
        folder = files.writable_folder(job.output)
        given = [Path(element[name]) for element in elements for name in ("pattern", "picture") if name in element]
        mark = files.fingerprint({"command": "simulate", BENCH: bench, ELEMENTS: elements}, given)
        if (kept := files.kept_report(folder, mark, notices)) is not None:
            return kept
        recorded = [element["name"] for element in elements if element["kind"] == "record"]
        names = [f"{name}{suffix}" for name in recorded for suffix in SUFFIXES]
        files.announce(folder, [*names, files.REPORT], notices)
        steps = []
        with refusing("", ValueError):
            for one in steps_of(bench, elements):
                step = {"kind": one.kind, "power": one.power, "share_of_source": one.share_of_source}
                step |= {} if one.lost is None else {"lost": one.lost}
                record = {} if one.field is None else _write(folder, str(one.name), one.field, one.pitch)
                steps.append(step | record)
    summary = {
        "bench": bench,
        "elements": elements,
        "steps": steps,
        "warnings": texts,
        **report.about("simulate"),
    }
    return files.write_report(folder, summary, mark, names)


def _write(folder: Path, name: str, field: np.ndarray, pitch: Any) -> dict[str, Any]:
    """Write a field as data and as pictures, and return its numbers."""
    from odak.tools.paths import replacing

    with replacing(str(folder / f"{name}.npy")) as stream:
        np.save(stream, field.astype(np.complex64))
    intensity = np.abs(field) ** 2
    peak = np.unravel_index(int(intensity.argmax()), intensity.shape)
    total = intensity.sum()
    places = positions(field.shape, pitch)
    position = [float(axis.ravel()[index]) for axis, index in zip(places, peak, strict=True)]
    centroid = [float((axis * intensity).sum() / total) if total else None for axis in places]
    largest = float(intensity.max())
    shade = torch.as_tensor(intensity / (largest or 1.0))[None]
    panels = [
        report.picture_panel(f"{name}: intensity, white is {largest:.4g}", shade),
        report.phase_panel(f"{name}: phase", torch.as_tensor(np.angle(field))),
    ]
    dy, dx = pitches(pitch)
    files.write_png(folder / f"{name}.png", report.sheet([panels], field.shape[1] * dx, dy / dx))
    return {
        "name": name,
        "pixel_pitch": pitch,
        "peak": largest,
        "peak_position": position,
        "centroid": centroid,
    }
