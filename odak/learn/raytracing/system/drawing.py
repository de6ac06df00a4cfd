"""Figures of optical systems (sections, spots, fans, field curves, transfer functions), and a report of them all."""

import html
import io
import math
from typing import Any

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image

from odak import _validate
from odak.catalog.materials import MICROMETRES
from odak.learn.raytracing.system.analysis import (
    Spots,
    distortion,
    encircled_energy,
    field_curvature,
    lateral_color,
    path_fan,
    ray_fan,
    spot_diagram,
    wavefront,
)
from odak.learn.raytracing.system.lens_files import system_to_dict
from odak.learn.raytracing.system.paraxial import first_order, seidel_sums
from odak.learn.raytracing.system.pupils import AIMS, launch, pupil_samples
from odak.learn.raytracing.system.surfaces import checked_system, drawn_radii, is_break, is_glass
from odak.learn.raytracing.system.tracing import curved_paths, ray_paths
from odak.learn.raytracing.system.waves import modulation_transfer_function, point_spread_function
from odak.tools.paths import _text, replacing

COLOURS = ((33, 102, 172), (27, 120, 55), (178, 24, 43), (118, 42, 131), (179, 88, 6), (1, 102, 94))
INK, FAINT, GLASS = "#202020", "#9a9a9a", "#d9e9f6"
POINTS = 81


def layout_figure(system: Any, aim: str = "paraxial", count: int = 5) -> Figure:
    """Return a section through a system in the y–z plane, with rays of each field at the reference wavelength.

    Parameters
    ----------
    system : optical_system
        The system, in global coordinates: z to the right, y up. Shifts, tilts and coordinate breaks are drawn, numbers
        are those of the surfaces.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    count : int
        Rays per field.

    Returns
    -------
    matplotlib.figure.Figure
        With ``savefig`` for PNG, SVG and PDF. Rays that are lost end where they were last.

    Examples
    --------
    >>> from odak.learn.raytracing.system import layout_figure, load_system
    >>> figure = layout_figure(load_system("cooke_triplet"))
    >>> [text.get_text() for text in figure.legends[0].get_texts()]
    ['0°', '14°', '20°']
    """
    checked_system(system)
    aim = _validate.one_of("aim", aim, AIMS)
    with torch.no_grad():
        rays = launch(system, pupil_samples("y", count), aim=aim)
        paths = ray_paths(system, rays)[system.reference].cpu()
        frames = [tuple(part.cpu().numpy() for part in pair) for pair in zip(*system.frames(), strict=True)]
        curves = _curves(system, rays)
    start = paths[..., 0, :]
    direction = torch.stack([value[0].cpu() for value in rays[3:]], -1)
    extent = float(
        (paths[..., 1:, :].nan_to_num().amax((0, 1, 2)) - paths[..., 1:, :].nan_to_num().amin((0, 1, 2))).max()
    )
    if system.at_infinity or system.object_distance > 0.5 * extent:
        ahead = start - direction * ((start[..., 2:] + 0.15 * extent) / direction[..., 2:])
        paths = torch.cat([ahead[..., None, :], paths], -2)
    paths = paths.numpy()
    radii = _radii(system, frames, paths[..., -len(frames) :, :])
    items = [*system.surfaces, system.image]
    profiles = [_profile(*pair) for pair in zip(items, frames, radii, strict=True)]
    figure = Figure(figsize=(10, 5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_aspect("equal", adjustable="datalim")
    axes.axis("off")
    for i in range(len(system.surfaces)):
        behind = next((j for j in range(i + 1, len(items)) if items[j] is None or not is_break(items[j])), None)
        if behind is not None and behind < len(items) - 1 and is_glass(system.surfaces, i):
            axes.fill(*np.concatenate([profiles[i], profiles[behind][::-1]]).T, color=GLASS, ec=FAINT, lw=0.6)
    for f in range(paths.shape[0]):
        color = _color(f)
        for p in range(paths.shape[1]):
            label = _field_label(system, f) if p == 0 else None
            line = _with_curves(paths[f, p], {place: curve[f, p] for place, curve in curves.items()}, len(frames))
            axes.plot(line[:, 2], line[:, 1], color=color, lw=0.7, label=label, zorder=2)
    # Of two numbers without room between them the second is raised. The drawing is about 600 points of print wide.
    point = (np.nanmax(paths[..., 2]) - np.nanmin(paths[..., 2])) / 600
    last, raised = np.full(2, np.inf), False
    for i, item in enumerate(system.surfaces):
        if is_break(item):
            continue
        bare = not item.reflects and not is_glass(system.surfaces, i) and not is_glass(system.surfaces, i - 1)
        width = 2.2 if item.reflects else 0.6 if bare else 1.1
        axes.plot(*profiles[i].T, color=FAINT if bare and not item.stop else INK, lw=width, zorder=3)
        if i == system.stop:
            upwards = frames[i][0][:, 1][[2, 1]]
            for end, side in ((profiles[i][-1], 1), (profiles[i][0], -1)):
                axes.plot(*np.stack([end, end + 0.25 * side * radii[i] * upwards]).T, color=INK, lw=3, zorder=3)
        # Above the blade of a stop, which stands on the edge of its surface.
        label = profiles[i][-1] + (0.25 * radii[i] * frames[i][0][:, 1][[2, 1]] if i == system.stop else 0)
        room = point * np.array([4.0 * len(str(i)) + 2.0, 9.0])
        raised = not raised and bool((np.abs(label - last) < room).all())
        last = label
        place = (0, 13 if raised else 5)
        axes.annotate(str(i), label, xytext=place, textcoords="offset points", ha="center", fontsize=7)
    axes.plot(*profiles[-1].T, color=INK, lw=2, zorder=3)
    figure.legend(fontsize=8, frameon=False, loc="outside right upper", title="field", title_fontsize=8)
    _scale_bar(axes, system.unit)
    axes.set_title(system.name, fontsize=11)
    return figure


def _curves(system, rays) -> dict[int, np.ndarray]:
    """Return points of the rays within each graded-index medium, by the number of the surface in front of it."""
    graded = [i for i, item in enumerate(system.surfaces) if item.gradient is not None]
    if not graded:
        return {}
    paths = ray_paths(system, rays)
    breaks = {i for i, item in enumerate(system.surfaces) if is_break(item)}
    ends = {i: next(j for j in range(i + 1, len(system.surfaces) + 1) if j not in breaks) for i in graded}
    return {
        i: curved_paths(system, rays, i, paths[..., j + 1, :])[system.reference].cpu().numpy() for i, j in ends.items()
    }


def _with_curves(path: np.ndarray, curves: dict[int, np.ndarray], stations: int) -> np.ndarray:
    """Return the points of a ray at its stations, the last of which are surfaces, with those of its curves between."""
    first = len(path) - stations
    parts = [path[:first]]
    for i in range(stations):
        parts += [path[first + i : first + i + 1], *([curves[i][1:-1]] if i in curves else [])]
    return np.concatenate(parts)


def _color(i: int) -> tuple[float, ...]:
    return tuple(value / 255 for value in COLOURS[i % len(COLOURS)])


def _field_label(system, i: int) -> str:
    x, y = system.fields[i]
    unit = "°" if system.at_infinity else f" {_unit(system)}"
    return f"{y:g}{unit}" if not x else f"({x:g}, {y:g}){unit}"


def _unit(system) -> str:
    return system.unit.replace("um", "µm")


def _radii(system, frames, paths) -> list[float]:
    """Return how far from its vertex each surface, the image last, is drawn."""
    items, reaches = list(system.surfaces), []
    for i, (matrix, origin) in enumerate(frames):
        local = (paths[..., i, :] - origin) @ matrix
        reaches.append(float(np.nanmax(np.hypot(local[..., 0], local[..., 1]), initial=0.0)))
    return drawn_radii(items, reaches[:-1]) + drawn_radii([system.image], reaches[-1:])


def _profile(item, frame, radius: float) -> np.ndarray:
    """Return a section of a surface in the plane x = 0 as points (z, y) in global coordinates."""
    matrix, origin = frame
    y = np.linspace(-radius, radius, POINTS)
    z = np.zeros_like(y)
    if item is not None and not is_break(item):
        with torch.no_grad():
            place = torch.from_numpy(y).to(item.curvature.device)
            sag = item.shape.sag(torch.zeros_like(place), place)
        kept = sag.defined.cpu().numpy()
        y, z = y[kept], sag.height.cpu().numpy()[kept]
    points = np.stack([np.zeros_like(y), y, z], -1) @ matrix.T + origin
    return points[:, [2, 1]]


def _scale_bar(axes, unit: str) -> None:
    """Draw a bar of 1, 2 or 5 times a power of ten below the drawing."""
    low, high = axes.dataLim.x0, axes.dataLim.x1
    wanted = (high - low) / 6 or 1.0
    power = 10 ** math.floor(math.log10(wanted))
    length = max(step * power for step in (1, 2, 5) if step * power <= wanted)
    y = axes.dataLim.y0 - 0.06 * (axes.dataLim.y1 - axes.dataLim.y0 or 1.0)
    axes.plot([low, low + length], [y, y], color=INK, lw=2, solid_capstyle="butt")
    label = f"{length:g} {unit.replace('um', 'µm')}"
    axes.annotate(label, (low + length / 2, y), xytext=(0, -11), textcoords="offset points", ha="center", fontsize=8)


def spots_figure(system: Any, found: Spots | None = None) -> Figure:
    """Return spot diagrams in micrometres, a panel for each field and a colour for each wavelength, all to one scale.

    Parameters
    ----------
    system : optical_system
        The system.
    found : Spots, optional
        From :func:`spot_diagram`, of one system; of its own fields by default.

    Returns
    -------
    matplotlib.figure.Figure
        The circle is Airy's first dark ring at the reference wavelength; afocal systems have none.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, spots_figure
    >>> lens = load_system("cooke_triplet")
    >>> len(spots_figure(lens).axes) >= len(lens.fields)
    True
    """
    checked_system(system)
    found = spot_diagram(system, "rings", 8) if found is None else found
    if not isinstance(found, Spots):
        raise TypeError(f"found must be Spots, got {type(found).__name__}")
    scale = MICROMETRES[system.unit]
    aperture = _image_aperture(system)
    airy = 0.61 * system.wavelengths[system.reference] / aperture * scale if aperture else 0.0
    finite = [value * scale for value in found.largest.detach().flatten().tolist() if math.isfinite(value)]
    half = 1.1 * max([*finite, airy], default=1.0)
    count = found.x.shape[-2]
    figure = Figure(figsize=(2.6 * count + 1.2, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, count, squeeze=False, sharex=True, sharey=True)[0]
    circle = np.linspace(0, 2 * np.pi, 100)
    for i, axes in enumerate(panels):
        for j in range(found.x.shape[-3]):
            x, y = (value[j, i].detach().cpu().numpy() * scale for value in (found.x, found.y))
            label = f"{system.wavelengths[j] * scale * 1e3:.0f} nm" if i == 0 else None
            axes.plot(x, y, ".", ms=2.5, color=_color(j), label=label)
        if airy:
            axes.plot(airy * np.cos(circle), airy * np.sin(circle), color=INK, lw=0.8)
        axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xlabel="x (µm)")
        name = _field_label(system, i) if i < len(system.fields) and count == len(system.fields) else str(i)
        axes.set_title(f"field {name}\nRMS {float(found.rms[i].detach()) * scale:.3g} µm", fontsize=9)
    panels[0].set_ylabel("y (µm)")
    figure.legend(fontsize=8, frameon=False, loc="outside right upper")
    return figure


def _image_aperture(system) -> float:
    """Return the numerical aperture at the image, 0 for an afocal system."""
    return float(first_order(system).numerical_aperture.detach())


def fans_figure(system: Any, count: int = 41, aim: str = "paraxial") -> Figure:
    """Return ray fans in micrometres and path differences in wavelengths, of each field and both sections.

    Parameters
    ----------
    system : optical_system
        The system.
    count : int
        Rays of a fan; odd.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each field; a colour for each wavelength.

    Examples
    --------
    >>> from odak.learn.raytracing.system import fans_figure, load_system
    >>> lens = load_system("cooke_triplet")
    >>> len(fans_figure(lens).axes) >= len(lens.fields)
    True
    """
    checked_system(system)
    scale, fields = MICROMETRES[system.unit], len(system.fields)
    figure = Figure(figsize=(11, 2.0 * fields + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(fields, 4, squeeze=False, sharex=True, sharey="col")
    for column, (kind, axis) in enumerate((("ray", "y"), ("ray", "x"), ("path", "y"), ("path", "x"))):
        with torch.no_grad():
            place, values = (ray_fan if kind == "ray" else path_fan)(system, axis, count, aim=aim)
        values = values.cpu().numpy() * (scale if kind == "ray" else 1.0)
        for i in range(fields):
            for j in range(values.shape[-3]):
                label = f"{system.wavelengths[j] * scale * 1e3:.0f} nm" if i == column == 0 else None
                panels[i, column].plot(place.cpu(), values[j, i], color=_color(j), lw=1.2, label=label)
            panels[i, column].axhline(0, color=FAINT, lw=0.6)
        unit = f"{axis} error (µm)" if kind == "ray" else f"path along {axis} (λ)"
        panels[0, column].set_title(unit, fontsize=9)
        panels[-1, column].set_xlabel("pupil", fontsize=9)
    for i in range(fields):
        panels[i, 0].set_ylabel(f"field {_field_label(system, i)}", fontsize=9)
    figure.legend(fontsize=8, frameon=False, loc="outside right upper")
    return figure


def field_figure(system: Any, points: int = 21) -> Figure:
    """Return field curvature, distortion and lateral colour over the field along y.

    Parameters
    ----------
    system : optical_system
        The system, with a field off the axis.
    points : int
        Number of field points.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels; the field runs upwards.

    Examples
    --------
    >>> from odak.learn.raytracing.system import field_figure, load_system
    >>> lens = load_system("cooke_triplet")
    >>> len(field_figure(lens, points=5).axes)
    3
    """
    checked_system(system)
    points = _validate.integer("points", points, minimum=2)
    largest = max(math.hypot(*field) for field in system.fields)
    if not largest:
        raise ValueError("system must have a field off the axis")
    heights = torch.linspace(0, largest, points, dtype=torch.float64)
    fields = torch.stack([0 * heights, heights], -1)
    with torch.no_grad():
        bent = 100 * distortion(system, fields=fields)[system.reference]
        colour = lateral_color(system, fields=fields) * MICROMETRES[system.unit]
    numbers = system.prescription().at(system.reference)
    curves = field_curvature(system, prescription=numbers, fields=fields)
    tangential, sagittal = (value.detach()[0] for value in curves)
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    first, second, third = figure.subplots(1, 3, sharey=True)
    first.plot(tangential, heights, color=_color(0), label="tangential")
    first.plot(sagittal, heights, color=_color(2), ls="--", label="sagittal")
    first.legend(fontsize=8, frameon=False)
    second.plot(bent, heights, color=INK)
    for j in range(len(system.wavelengths)):
        label = f"{system.wavelengths[j] * MICROMETRES[system.unit] * 1e3:.0f} nm"
        third.plot(colour[j], heights, color=_color(j), label=label)
    third.legend(fontsize=8, frameon=False)
    for axes, name in zip(
        (first, second, third),
        (f"field curvature ({_unit(system)})", "distortion (%)", "lateral colour (µm)"),
        strict=True,
    ):
        axes.axvline(0, color=FAINT, lw=0.6)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.ticklabel_format(axis="x", scilimits=(-3, 4))
        axes.set_xlabel(name, fontsize=9)
    first.set_ylabel("field (°)" if system.at_infinity else f"object height ({_unit(system)})", fontsize=9)
    return figure


def transfer_figure(system: Any, samples: int = 64, aim: str = "paraxial") -> Figure:
    """Return modulation transfer functions and encircled energy of each field at the reference wavelength.

    Parameters
    ----------
    system : optical_system
        The system.
    samples : int
        Samples across the pupil.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels: modulation over frequency (full lines tangential, dashed ones sagittal, black the limit of
        diffraction), and the share of the energy within a radius. Of systems with more than a wavelength of aberration
        both are those of the rays, as the titles say.

    Raises
    ------
    ValueError
        If the system is afocal.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, transfer_figure
    >>> lens = load_system("cooke_triplet")
    >>> len(transfer_figure(lens, samples=32).axes)
    2
    """
    checked_system(system)
    samples = _validate.integer("samples", samples, minimum=8)
    scale, place = MICROMETRES[system.unit], system.reference
    cutoff = 2 * _image_aperture(system) / system.wavelengths[place]
    if not cutoff:
        raise ValueError("system must have a focus, got an afocal one: there is no modulation transfer at an image")
    numbers = system.prescription().at(place)
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    with torch.no_grad():
        # More than a wave of aberration: geometric, for the samples would not resolve the diffraction.
        large = wavefront(system, "rings", 8, aim=aim).rms.nan_to_num().max() > 1
        if large:
            spots = spot_diagram(system, "grid", 2 * samples, aim=aim, prescription=numbers)
            radii, energy = encircled_energy(spots)
            size = max(float(spots.largest.nan_to_num().max()), 1e-12)
            frequency = torch.linspace(0, min(cutoff, 2 / size), 100, dtype=torch.float64, device=spots.x.device)
            curves = [
                [(frequency, _geometric_transfer(value[0, i], frequency)) for value in (spots.y, spots.x)]
                for i in range(len(system.fields))
            ]
        else:
            spread = point_spread_function(system, samples, 8 * samples, aim=aim, prescription=numbers)
            radii, energy = (value[0] for value in encircled_energy(spread))
            both = [modulation_transfer_function(spread, axis) for axis in ("y", "x")]
            curves = [[(f[0, i], m[0, i]) for f, m in both] for i in range(len(system.fields))]
    curves = [[(frequency.cpu(), transfer.cpu()) for frequency, transfer in pair] for pair in curves]
    radii, energy = radii.cpu(), energy.cpu()
    for i, pair in enumerate(curves):
        for (frequency, transfer), style in zip(pair, ("-", "--"), strict=True):
            label = _field_label(system, i) if style == "-" else None
            left.plot(frequency * 1e3 / scale, transfer, style, color=_color(i), lw=1.2, label=label)
        right.plot(radii[i] * scale, energy[i], color=_color(i), lw=1.2)
    highest = float(curves[0][0][0][-1]) if large else cutoff
    ratio = np.linspace(0, 1, 100)
    ideal = 2 / np.pi * (np.arccos(ratio) - ratio * np.sqrt(1 - ratio**2))
    left.plot(ratio * cutoff * 1e3 / scale, ideal, color=INK, lw=0.8, label="limit")
    left.set_title("geometric" if large else "with diffraction", fontsize=9)
    left.set(xlim=(0, highest * 1e3 / scale), ylim=(0, 1), xlabel="cycles per millimetre", ylabel="modulation")
    right.set(xlabel="radius (µm)", ylabel="encircled energy", ylim=(0, 1), xlim=(0, None))
    left.legend(fontsize=8, frameon=False)
    return figure


def _geometric_transfer(place: torch.Tensor, frequency: torch.Tensor) -> torch.Tensor:
    """Return |mean exp(2πi·f·y)| over the rays of a spot."""
    place = place[torch.isfinite(place)]
    phase = 2 * math.pi * frequency[:, None] * place
    return (phase.cos().mean(-1).square() + phase.sin().mean(-1).square()).sqrt()


def draw_layout(system: Any, aim: str = "paraxial", count: int = 5) -> Image.Image:
    """Return :func:`layout_figure` as a picture.

    Parameters
    ----------
    system : optical_system
        The system.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    count : int
        Rays per field.

    Returns
    -------
    PIL.Image.Image
        RGB.

    Examples
    --------
    >>> from odak.learn.raytracing.system import draw_layout, load_system
    >>> lens = load_system("cooke_triplet")
    >>> draw_layout(lens).mode
    'RGB'
    """
    return _picture(layout_figure(system, aim, count))


def draw_spots(system: Any, found: Spots) -> Image.Image:
    """Return :func:`spots_figure` as a picture.

    Parameters
    ----------
    system : optical_system
        The system.
    found : Spots
        From :func:`spot_diagram`, of one system.

    Returns
    -------
    PIL.Image.Image
        RGB.

    Examples
    --------
    >>> from odak.learn.raytracing.system import draw_spots, load_system, spot_diagram
    >>> lens = load_system("cooke_triplet")
    >>> draw_spots(lens, spot_diagram(lens)).mode
    'RGB'
    """
    return _picture(spots_figure(system, found))


def _picture(figure: Figure) -> Image.Image:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=140)
    return Image.open(stream).convert("RGB")


def report_figures(system: Any, aim: str = "paraxial") -> dict[str, Figure]:
    """Return the figures of :func:`lens_report` by their names; those that an afocal system does not have are left out.

    Parameters
    ----------
    system : optical_system
        The system.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, report_figures
    >>> list(report_figures(load_system("singlet")))
    ['layout', 'spots', 'fans', 'transfer', 'field']
    """
    checked_system(system)
    found = {
        "layout": layout_figure(system, aim),
        "spots": spots_figure(system, spot_diagram(system, "rings", 8, aim=aim)),
        "fans": fans_figure(system, aim=aim),
    }
    if _image_aperture(system):
        found["transfer"] = transfer_figure(system, aim=aim)
    if any(any(field) for field in system.fields):
        found["field"] = field_figure(system)
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
        "field": "Field curvature, distortion, lateral colour",
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
    unit, scale = _unit(system), MICROMETRES[system.unit]
    properties = first_order(system)
    rows: list[Any] = [(name.replace("_", " "), value) for name, value in properties._asdict().items()]
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
            _field_label(system, i),
            spots.rms[i] * scale,
            spots.largest[i] * scale,
            wave.rms[system.reference, i],
            int(lost[i]),
        )
        for i in range(len(system.fields))
    ]
    head = ("field", "RMS spot (µm)", "largest (µm)", "wavefront RMS (λ)", "rays lost")
    parts += ["<h2>Fields</h2>", _table(head, rows)]
    try:
        sums = seidel_sums(system)
    except ValueError:
        return parts
    waves = sums.seidel / system.wavelengths[system.reference]
    names = ("spherical", "coma", "astigmatism", "Petzval", "distortion")
    rows = [(str(i), *waves[:, i]) for i in range(waves.shape[-1])] + [("sum", *waves.sum(-1))]
    return [*parts, "<h2>Seidel coefficients by surface (wavelengths)</h2>", _table(("surface", *names), rows)]
