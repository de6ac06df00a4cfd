"""Report of an optical system as one HTML file: prescription, first order, all figures and sums."""

import html
import io
import math
from contextlib import suppress
from typing import Any

import torch
from matplotlib.figure import Figure

from odak import _validate
from odak.catalog.materials import MICROMETRES
from odak.learn.raytracing.system.analysis import paraxial_points, spot_diagram, wavefront
from odak.learn.raytracing.system.drawing import (
    fans_figure,
    field_figure,
    field_label,
    footprint_figure,
    image_aperture,
    image_figure,
    image_unit,
    layout_figure,
    polarisation_figure,
    seidel_figure,
    spots_figure,
    through_focus_figure,
    transfer_figure,
    unit_of,
    wavefront_figure,
)
from odak.learn.raytracing.system.lens_files import system_to_dict
from odak.learn.raytracing.system.paraxial import first_order, seidel_sums
from odak.learn.raytracing.system.pupils import AIMS
from odak.learn.raytracing.system.surfaces import checked_system
from odak.tools.paths import _text, replacing


def report_figures(system: Any, aim: str = "paraxial") -> dict[str, Figure]:
    """Return the figures of :func:`lens_report` by their names; those that a system cannot have are left out.

    Parameters
    ----------
    system : optical_system
        The system.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, report_figures
    >>> list(report_figures(load_system("singlet")))[:6]
    ['layout', 'spots', 'fans', 'transfer', 'through_focus', 'wavefront']
    """
    checked_system(system)
    found = {
        "layout": layout_figure(system, aim),
        "spots": spots_figure(system, spot_diagram(system, "rings", 8, aim=aim)),
        "fans": fans_figure(system, aim=aim),
    }
    if image_aperture(system):
        found["transfer"] = transfer_figure(system, aim=aim)
        found["through_focus"] = through_focus_figure(system, aim=aim)
    found["wavefront"] = wavefront_figure(system, aim=aim)
    if any(any(field) for field in system.fields):
        found["field"] = field_figure(system)
        found["image"] = image_figure(system, aim=aim)
    found["footprint"] = footprint_figure(system, aim=aim)
    found["polarisation"] = polarisation_figure(system, aim=aim)
    with suppress(ValueError):
        # Only centred systems of rotationally symmetric surfaces have Seidel coefficients.
        found["seidel"] = seidel_figure(system)
    return found


def lens_report(system: Any, path: Any, aim: str = "paraxial", figures: dict[str, Figure] | None = None) -> None:
    """Write a report of a system as one self-contained HTML file: prescription, first order, all figures, sums.

    Parameters
    ----------
    system : optical_system
        The system.
    path : str or pathlib.Path
        File to write.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    figures : dict, optional
        From :func:`report_figures`, where available.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.raytracing.system import lens_report, load_system
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "singlet.html")
    ...     lens_report(load_system("singlet"), name, figures={})
    ...     os.path.getsize(name) > 1000
    True
    """
    checked_system(system)
    path, aim = _text("path", path), _validate.one_of("aim", aim, AIMS)
    headings = {
        "layout": "Layout",
        "spots": "Spots",
        "fans": "Ray fans and path differences",
        "transfer": "Modulation transfer and encircled energy",
        "through_focus": "Through focus",
        "wavefront": "Wavefront and diffraction image",
        "field": "Field curvature, distortion, lateral colour",
        "image": "Distortion grid, illumination, axial colour",
        "footprint": "Footprints",
        "polarisation": "Diattenuation and retardance",
        "seidel": "Seidel coefficients by surface",
    }
    parts = [f"<h1>{html.escape(system.name or 'Optical system')}</h1>", f"<p>{html.escape(system.source)}</p>"]
    if figures is not None and not isinstance(figures, dict):
        raise TypeError(f"figures must be those of report_figures, got {type(figures).__name__}")
    figures = report_figures(system, aim) if figures is None else figures
    for name in headings:
        if name in figures:
            parts += [f"<h2>{headings[name]}</h2>", _svg(figures[name])]
        if name == "layout":
            parts += _numbers_of(system, aim)
    page = _PAGE.format(title=html.escape(system.name or "Optical system"), body="\n".join(parts))
    with replacing(path) as stream:
        stream.write(page.encode("utf-8"))


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title>
<style>body{{font:15px/1.5 system-ui,sans-serif;max-width:1050px;margin:2em auto;padding:0 1em;color:#202020}}
table{{border-collapse:collapse;margin:1em 0}}td,th{{padding:.2em .9em;text-align:right;border-bottom:1px solid #ddd}}
th:first-child,td:first-child{{text-align:left}}svg{{max-width:100%;height:auto}}.table,.figure{{overflow-x:auto}}
@media (max-width:45em){{body{{margin:1em auto}}td,th{{padding:.2em .5em}}.figure svg{{max-width:none;width:660px}}}}
</style></head>
<body>
{body}
</body></html>
"""


def _svg(figure: Figure) -> str:
    stream = io.StringIO()
    figure.savefig(stream, format="svg")
    text = stream.getvalue()
    return f'<div class="figure">{text[text.index("<svg") :]}</div>'


def _table(head, rows) -> str:
    top = "".join(f"<th>{html.escape(str(cell))}</th>" for cell in head)
    body = ""
    for row in rows:
        cells = [float(value.detach()) if isinstance(value, torch.Tensor) else value for value in row]
        # A zero has no sign in a table.
        texts = [f"{value + 0.0:.6g}" if isinstance(value, float) else str(value) for value in cells]
        body += "<tr>" + "".join(f"<td>{html.escape(text)}</td>" for text in texts) + "</tr>"
    return f'<div class="table"><table><tr>{top}</tr>{body}</table></div>'


@torch.no_grad()
def _numbers_of(system, aim: str) -> list[str]:
    """Return the tables of a report."""
    unit, scale = unit_of(system), MICROMETRES[system.unit]
    properties = first_order(system)
    rows: list[Any] = [(name.replace("_", " "), value) for name, value in properties._asdict().items()]
    if system.afocal:
        # The slope of a chief ray behind the system over that in front, or over the height of a near object.
        chief = paraxial_points(system, fields=[(0.0, 1e-3)])[0, 1] / (1e6 / scale)
        magnification = chief / (math.tan(math.radians(1e-3)) if system.at_infinity else 1e-3)
        kept = ("entrance_pupil_distance", "entrance_pupil_diameter", "stop_diameter")
        rows = [(name.replace("_", " "), getattr(properties, name)) for name in kept]
        if system.at_infinity:
            rows += [("angular magnification", magnification)]
            rows += [("exit pupil diameter", properties.entrance_pupil_diameter / magnification.abs())]
        else:
            rows += [(f"slope per object height (1/{unit})", magnification)]
    parts = [f"<h2>First order ({unit})</h2>", _table(("property", "value"), rows)]
    rows = []
    for i, entry in enumerate(system_to_dict(system)["surfaces"]):
        kind = "break" if entry.get("break") else entry.get("shape", {}).get("kind", "")
        radius = entry.get("radius")
        mark = " (stop)" if i == system.stop else ""
        rows.append(
            (f"{i}{mark}", "∞" if radius is None else radius, entry["thickness"], str(entry.get("material", "")), kind)
        )
    parts += [f"<h2>Prescription ({unit})</h2>", _table(("surface", "radius", "thickness", "material", "shape"), rows)]
    spots, wave = spot_diagram(system, "rings", 8, aim=aim), wavefront(system, "rings", 12, aim=aim)
    lost = (~(spots.status == 0)).sum((0, 2))
    rows = [
        (
            field_label(system, i),
            spots.rms[i] * scale,
            spots.largest[i] * scale,
            wave.rms[system.reference, i],
            int(lost[i]),
        )
        for i in range(len(system.fields))
    ]
    small = image_unit(system)
    head = ("field", f"RMS spot ({small})", f"largest ({small})", "wavefront RMS (λ)", "rays lost")
    parts += ["<h2>Fields</h2>", _table(head, rows)]
    try:
        sums = seidel_sums(system)
    except ValueError:
        return parts
    waves = sums.seidel / system.wavelengths[system.reference]
    names = ("spherical", "coma", "astigmatism", "Petzval", "distortion")
    rows = [(str(i), *waves[:, i]) for i in range(waves.shape[-1])] + [("sum", *waves.sum(-1))]
    return [*parts, "<h2>Seidel coefficients by surface (wavelengths)</h2>", _table(("surface", *names), rows)]
