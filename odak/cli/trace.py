"""`odak trace`: rays through a lens, its layout and spots as pictures, and a report."""

from pathlib import Path

import torch

from odak.cli.errors import InputError
from odak.cli.files import writable_folder, write_json, write_png
from odak.learn.raytracing.system import (
    distortion,
    draw_layout,
    draw_spots,
    first_order,
    load_system,
    point_spread_function,
    read_zmx,
    spot_diagram,
    system_to_dict,
    wavefront,
)
from odak.raytracing.status import RayStatus

MAXIMUM_RINGS = 100
DEFINITIONS = {
    "lengths": "In the system's unit; angles in degrees; wavefronts in wavelengths.",
    "rms_spot": "Root mean square distance of the rays from their centroid in the image plane, per field: all "
    "wavelengths together, equally weighted.",
    "largest_spot": "Largest distance from that centroid.",
    "distortion": "Chief ray's image height at the reference wavelength over the paraxial one, less 1.",
    "wavefront_rms": "Standard deviation of the path to the reference sphere, at the reference wavelength.",
    "strehl": "Peak of the diffraction image at the reference wavelength over that of a perfect lens.",
    "statuses": "How many rays ended how.",
}


def read_system(name: str):
    """Return a system and what was ignored in its file.

    Parameters
    ----------
    name : str
        A sample system, a .json file or a .zmx file.

    Raises
    ------
    InputError
        If there is no such thing, or it cannot be understood.
    """
    try:
        if name.lower().endswith(".zmx"):
            system, report = read_zmx(name)
            return system, [*report.ignored, *report.notes]
        return load_system(name), []
    except (ValueError, OSError) as error:
        raise InputError(f"SYSTEM {name!r}: {error}") from None


def run(name: str, output: Path, rings: int, aim: str) -> dict:
    """Trace a system and write layout.png, spots.png and report.json.

    Parameters
    ----------
    name : str
        As in :func:`read_system`.
    output : Path
        Folder to write to.
    rings : int
        Rings of rays in the pupil.
    aim : str
        "paraxial" or "real".

    Returns
    -------
    dict
        The report.

    Raises
    ------
    InputError
        If an argument will not do.
    """
    if not 1 <= rings <= MAXIMUM_RINGS:
        raise InputError(f"--rings must be 1 to {MAXIMUM_RINGS}, got {rings}")
    if aim not in ("paraxial", "real"):
        raise InputError(f"--aim must be paraxial or real, got {aim!r}")
    system, ignored = read_system(name)
    folder = writable_folder(Path(output))
    with torch.no_grad():
        report = describe(system, rings, aim) | {"ignored": ignored}
        spots = spot_diagram(system, "rings", rings, aim=aim)
        write_png(folder / "layout.png", draw_layout(system, aim))
        write_png(folder / "spots.png", draw_spots(system, spots))
    write_json(folder / "report.json", report)
    return report


def describe(system, rings: int, aim: str) -> dict:
    """Return what the report says of a system."""
    from odak.cli.report import versions

    spots = spot_diagram(system, "rings", rings, aim=aim)
    wave = wavefront(system, "rings", rings, aim=aim)
    spread = point_spread_function(system, 64, 1024, aim=aim)
    bent = distortion(system, aim=aim)
    place = system.reference
    fields = [
        {
            "field": list(field),
            "rms_spot": _number(spots.rms[i]),
            "largest_spot": _number(spots.largest[i]),
            "centroid": [_number(value) for value in spots.center[i]],
            "distortion": _number(bent[place, i]),
            "wavefront_rms": _number(wave.rms[place, i]),
            "strehl": _number(spread.strehl[place, i]),
            "statuses": {
                status.name.lower(): int((spots.status[:, i] == status).sum())
                for status in RayStatus
                if bool((spots.status[:, i] == status).any())
            },
        }
        for i, field in enumerate(system.fields)
    ]
    return {
        "system": system_to_dict(system),
        "first_order": {name: _number(value) for name, value in first_order(system)._asdict().items()},
        "rays": {"pattern": "rings", "count": rings, "aim": aim},
        "fields": fields,
        "versions": versions(),
        "definitions": DEFINITIONS,
    }


def _number(value) -> float | None:
    """Return a float, None for what JSON has no word for."""
    value = float(value)
    return value if abs(value) < float("inf") else None
