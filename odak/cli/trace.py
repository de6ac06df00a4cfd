"""Ray tracing and tolerances of a lens for `odak trace` and `odak tolerance`: figures, reports as HTML and JSON."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from odak._call_forms import did_you_mean
from odak._drawn import png
from odak.cli import files
from odak.cli.options import InputError, refusing
from odak.cli.report import about, finite
from odak.cli.settings import ToleranceSettings, TraceSettings
from odak.learn.raytracing import system as lenses
from odak.learn.raytracing.system.drawing import (
    MICROMETRES,
    image_aperture,
    modulation_frequencies,
    projection_of,
)
from odak.learn.raytracing.system.environment import replaced
from odak.learn.raytracing.system.sketches import field_label
from odak.learn.raytracing.system.system_files import SEALED, load_materials
from odak.raytracing.intersections import RayStatus
from odak.tools.paths import replacing, write_file


def read_glasses(paths: Sequence[Path]) -> None:
    """Add the materials of files to the catalogue: .agf, .json or .yml of refractiveindex.info."""
    for path in paths:
        with refusing(f"--glasses {str(path)!r}: ", ValueError, OSError):
            load_materials(path, replace=True)


def read_system(name: str, argument: str = "SYSTEM") -> tuple[lenses.optical_system, list[str]]:
    """Return a system and what was ignored in its file.

    Parameters
    ----------
    name : str
        A sample system, or a .json, .zmx, .seq or .len file.
    argument : str
        Its name in messages.

    Raises
    ------
    InputError
        If there is no such thing, or it cannot be understood.
    """
    suffix = Path(name).suffix.lower()
    if suffix and not Path(name).is_file():
        raise InputError(f"{argument} not found: {name!r}")
    readers = {".zmx": lenses.read_zmx, ".seq": lenses.read_seq, ".len": lenses.read_len}
    # What is packed is refused by the reader, which says how to unpack it.
    if suffix not in ("", ".json", *readers, *(packed for packed, *_ in SEALED)):
        raise InputError(
            f"{argument} must be a .json, .zmx, .seq or .len file, or the name of a sample lens; got {name!r}"
        )
    try:
        if suffix in readers:
            system, report = readers[suffix](name)
            return system, [*report.ignored, *report.notes]
        return lenses.load_system(name), []
    except json.JSONDecodeError as error:
        raise InputError(f"{argument} {name!r} is not a lens in JSON: line {error.lineno} cannot be read") from None
    except (ValueError, OSError) as error:
        known = lenses.sample_systems()
        if name not in known and not Path(name).suffix:
            raise InputError(
                f"{argument} must be one of {', '.join(known)}, or a file; got {name!r}.{did_you_mean(name, known)}"
            ) from None
        text = str(error).removeprefix(f"{name}: ")
        raise InputError(f"{argument} {name!r} cannot be read as a lens: {text}") from None


@files.claiming
def run(job: TraceSettings, notices: files.Notices = files.SILENT) -> dict[str, Any]:
    """Trace a system and write its figures, report.html and report.json.

    Parameters
    ----------
    job : TraceSettings
        Settings of the run.
    notices : files.Notices
        What to do about results of earlier runs.

    Returns
    -------
    dict
        The report.

    Raises
    ------
    InputError
        If the system or a file of glasses cannot be used.
    """
    name, aim, figures, focus = job.system, job.aim, job.figures, job.focus
    read_glasses(job.glasses)
    system, ignored = read_system(name)
    folder = files.writable_folder(job.output)
    values = {"command": "trace", **job.values("glasses"), "system": Path(name).name}
    mark = files.fingerprint(values, [path for path in (Path(name), *job.glasses) if path.is_file()])
    if (kept := files.kept_report(folder, mark, notices)) is not None:
        return kept
    if job.temperature is not None:
        with refusing(lambda text: text if "surfaces[" in text else f"--{text}", ValueError):
            system = lenses.in_environment(system, job.temperature, mount=job.mount)
    with torch.no_grad():
        shift = None if system.afocal else lenses.best_focus(system, aim=aim)
        if focus == "best":
            if shift is None or not bool(torch.isfinite(shift)):
                raise InputError("--focus best needs a lens that focuses rays")
            last = system.surfaces[-1]
            replaced(last, "thickness", last.thickness + shift)
    quality = lenses.field_quality(system, aim)
    drawn = lenses.report_figures(system, aim, quality)
    names = [*(f"{title}.{figures}" for title in drawn), "report.html"]
    solids = [] if job.solids == "none" else [f"lenses.{job.solids}"]
    files.announce(folder, [*names, *solids, files.REPORT], notices)
    for name in solids:
        with refusing(f"--solids {job.solids}: ", ValueError, ImportError):
            lenses.save_solids(system, folder / name)
    with torch.no_grad():
        report = describe(system, job.rings, aim, quality) | {"ignored": ignored, "focus": focus}
        report |= {"temperature": job.temperature, "mount": job.mount}
        report["best_focus"] = None if shift is None else finite(shift)
    for title, figure in drawn.items():
        # The layout serves both files of a figure; each saving would find it twice again.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        with replacing(folder / f"{title}.{figures}") as stream:
            figure.savefig(stream, format=figures, dpi=140)
    lenses.lens_report(system, folder / "report.html", aim, drawn, quality)
    return files.write_report(folder, report | {"figures": names[:-1], "solids": solids}, mark, [*names, *solids])


def describe(system: lenses.optical_system, rings: int, aim: str, quality: lenses.FieldQuality) -> dict[str, Any]:
    """Return the entries of the report on a system."""
    spots = lenses.spot_diagram(system, "rings", rings, aim=aim)
    bent = lenses.distortion(system, projection=projection_of(system), aim=aim)
    place, modulation, frequencies = system.reference, None, []
    if image_aperture(system) and not system.afocal:
        frequencies = modulation_frequencies(system)
        modulation = lenses.field_modulation(system, frequencies, aim=aim)
    fields = [
        {
            "field": list(field),
            "label": field_label(system, i),
            "rms_spot": finite(quality.rms_spot[i]),
            "largest_spot": finite(spots.largest[i]),
            "centroid": [finite(value) for value in spots.center[i]],
            "distortion": finite(bent[place, i]),
            "wavefront_rms": finite(quality.wavefront_rms[i]),
            "strehl": finite(quality.strehl[i]),
            "passed": finite(quality.passed[i]),
            "modulation": None
            if modulation is None
            else {
                name: [finite(value) for value in row]
                for name, row in zip(("tangential", "sagittal"), modulation[..., i], strict=True)
            },
            "statuses": {
                status.name.lower(): int((spots.status[:, i] == status).sum())
                for status in RayStatus
                if bool((spots.status[:, i] == status).any())
            },
        }
        for i, field in enumerate(system.fields)
    ]
    return {
        "system": lenses.system_to_dict(system),
        "first_order": {name: finite(value) for name, value in lenses.first_order(system)._asdict().items()},
        "rays": {"pattern": "rings", "count": rings, "aim": aim},
        "quadrature": {"rings": quality.count, "change": finite(quality.change)},
        "modulation_frequencies": frequencies,
        "fields": fields,
        **about("trace"),
    }


def summary(report: dict[str, Any]) -> list[str]:
    """Return what the command prints of a report: focal length, spots of the fields, and where they are least."""
    unit, found = report["system"]["unit"], report["first_order"]
    afocal = found["focal_length"] is None
    lines = ["afocal: no focal length"]
    if not afocal:
        lines = [f"focal length {found['focal_length']:.6g} {unit}, F/{found['f_number']:.3g}"]
    for field in report["fields"]:
        size = "no rays"
        if field["rms_spot"] is not None:
            size = f"RMS spot {field['rms_spot'] * MICROMETRES[unit]:.3g} {'µrad' if afocal else 'µm'}"
        lines.append(f"field {field['label']}: {size}")
    shift = report["best_focus"] or 0.0
    if report["focus"] == "best":
        lines.append(f"the image has moved by {shift:+.3g} {unit}, to the least spots")
    elif not afocal and abs(shift) > 5e-4 * abs(found["focal_length"]):
        where = "in front of" if shift < 0 else "behind"
        lines.append(f"the spots are least {abs(shift):.3g} {unit} {where} the image: --focus best moves it there")
    return lines


@files.claiming
def run_tolerance(job: ToleranceSettings, notices: files.Notices = files.SILENT) -> dict[str, Any]:
    """Tolerance a system by ISO 10110-11, or to a yield, and write figures, report.html and report.json.

    Parameters
    ----------
    job : ToleranceSettings
        Settings of the run.
    notices : files.Notices
        What to do about results of earlier runs.

    Returns
    -------
    dict
        The report.
    """
    name, samples, seed, limit, share = job.system, job.samples, job.seed, job.limit, job.share
    system, ignored = read_system(name)
    folder = files.writable_folder(job.output)
    values = {"command": "tolerance", **job.values(), "system": Path(name).name}
    mark = files.fingerprint(values, [path for path in (Path(name),) if path.is_file()])
    if (kept := files.kept_report(folder, mark, notices)) is not None:
        return kept
    names = ["tolerance.png", "sensitivity.png", "report.html"]
    files.announce(folder, [*names, files.REPORT], notices)
    compensators = [("thickness", -1)] if job.focus else []
    off = lenses.iso_10110_tolerances(system)
    if not off:
        raise InputError(f"SYSTEM {name!r} has no glass, for which ISO 10110 has tolerances")
    with torch.no_grad():
        limit = 2 * float(lenses.rms_spot(system).max()) if limit is None else limit
        with refusing(f"SYSTEM {name!r} cannot be toleranced: ", ValueError):
            if share is None:
                found = lenses.tolerance(system, off, samples, seed, compensators=compensators)
            else:
                off, found = lenses.tolerances_for_yield(
                    system, off, limit, share, samples=samples, seed=seed, compensators=compensators
                )
        alone = lenses.sensitivity(system, off, compensators=compensators)
        quality = lenses.field_quality(system)
        drawn = {
            "tolerance": lenses.tolerance_figure(system, found, limit),
            "sensitivity": lenses.tolerance_figure(system, alone),
        }
    for title, figure in drawn.items():
        write_file(folder / f"{title}.png", png(figure))
    lenses.lens_report(
        system, folder / "report.html", "paraxial", {"layout": lenses.layout_figure(system), **drawn}, quality
    )
    sizes = found.merit.square().mean(-1).sqrt()
    good = sizes[torch.isfinite(sizes)]
    report = {
        "system": lenses.system_to_dict(system),
        "perturbations": [item._asdict() for item in off],
        "compensators": [list(pair) for pair in compensators],
        "samples": samples,
        "seed": seed,
        "limit": limit,
        "yield": float(found.yield_within(limit)),
        "rms_as_drawn": finite(found.nominal.square().mean().sqrt()),
        "rms_quantiles": {f"{q:g}": finite(torch.quantile(good, q)) for q in (0.5, 0.8, 0.9, 0.98)}
        if len(good)
        else {},
        "sensitivity": {
            key: [finite(value.square().mean().sqrt()) for value in alone.merit[:, i]]
            for i, key in enumerate(alone.names)
        },
        "ignored": ignored,
        **about("tolerance"),
    }
    return files.write_report(folder, report | {"figures": names[:-1]}, mark, names)
