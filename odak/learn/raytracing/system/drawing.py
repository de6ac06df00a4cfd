"""Figures of optical systems: sections, spots, fans, field curves, transfer functions and other analyses.

The other analyses are through focus, wavefronts, distortion, illumination, footprints, polarisation and tolerances. A
report shows all of them, the prescription and first-order properties in one HTML file.
"""

import html
import io
import math
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from importlib import resources
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image

from odak import _show, _validate
from odak._drawn import FAINT, INK, Drawing, color_of, png, subplots, svg
from odak.catalog.materials import MICROMETRES
from odak.learn._tensors import takes_constants
from odak.learn.raytracing.system.analysis import (
    CENTRE,
    Spots,
    axial_color,
    distortion,
    distortion_grid,
    encircled_energy,
    field_curvature,
    footprint,
    incidence_angles,
    lateral_color,
    paraxial_points,
    path_fan,
    pupil_aberration,
    ray_fan,
    spot_diagram,
    through_focus,
    wavefront,
)
from odak.learn.raytracing.system.crystals import UniaxialMedium
from odak.learn.raytracing.system.optimise import Sensitivity, ToleranceResult
from odak.learn.raytracing.system.paraxial import first_order, paraxial_rays, seidel_sums
from odak.learn.raytracing.system.polarisation import polarized_trace
from odak.learn.raytracing.system.pupils import (
    AIMS,
    launch,
    pupil_quadrature,
    pupil_samples,
    trace_fields,
    vignetting_factors,
)
from odak.learn.raytracing.system.sketches import SystemScene, field_label, system_scene, unit_of
from odak.learn.raytracing.system.specification import Values, largest_of, plain
from odak.learn.raytracing.system.surfaces import checked_system, is_break, is_glass, optical_system
from odak.learn.raytracing.system.system_files import system_to_dict
from odak.learn.raytracing.system.tracing import curved_paths, ray_paths
from odak.learn.raytracing.system.waves import (
    LARGE,
    RAYS,
    FieldQuality,
    field_modulation,
    field_quality,
    modulation_in_planes,
    modulation_transfer_function,
    more_samples,
    pupil_image,
    relative_illumination,
)
from odak.tools.paths import _text, write_file

GLASS = "#d9e9f6"
POINTS = 81
# Configurations that are drawn in a notebook.
SHOWN = 4


def layout_figure(system: optical_system, aim: str = "paraxial", count: int = 5) -> Figure:
    """Return a section through a system in the y–z plane, with rays of each field at the reference wavelength.

    Parameters
    ----------
    system : optical_system
        The system, in global coordinates: z to the right, y up. Shifts, tilts and coordinate breaks are drawn, numbers
        count the surfaces.
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
        scene = system_scene(system, rays, lead=0.15)
        curves = _curves(system, rays)
    surfaces, frames, radii, paths = scene.items[:-1], scene.frames, scene.radii, scene.paths
    profiles = [_profile(scene, i) for i in range(len(scene.items))]
    drawn = np.concatenate([*profiles, paths[..., [2, 1]].reshape(-1, 2)])
    width, height = np.nanmax(drawn, 0) - np.nanmin(drawn, 0)
    figure = Drawing(figsize=(10, 5) if height < width else (6, 6.6), layout="constrained")
    axes = figure.add_subplot()
    axes.set_aspect("equal", adjustable="datalim")
    axes.axis("off")
    for i, behind in scene.elements():
        axes.fill(*_element(profiles, frames, radii, i, behind).T, color=GLASS, ec=FAINT, lw=0.6)
        style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 6, "color": INK, "parse_math": False}
        ends = np.concatenate([profiles[place][[0, -1]] for place in (i, behind)])
        if abs(frames[i][0][2, 2]) > 0.7:
            place = (ends[[0, 2], 0].mean(), ends[:, 1].min())
            style |= {"xytext": (0, -4), "rotation": 90, "ha": "center", "va": "top"}
        else:
            # Beside an element whose axis is turned up or down.
            place = (ends[:, 0].max(), ends[:, 1].mean())
            style |= {"xytext": (4, 0), "ha": "left", "va": "center"}
        axes.annotate(_glass_name(surfaces, i), place, **style)
    for f in range(paths.shape[0]):
        color = color_of(f)
        for p in range(paths.shape[1]):
            label = field_label(system, f) if p == 0 else None
            line = _with_curves(paths[f, p], {place: curve[f, p] for place, curve in curves.items()}, len(frames))
            axes.plot(line[:, 2], line[:, 1], color=color, lw=0.7, label=label, zorder=2)
    # A number without room beside earlier ones is raised. The drawing is about 600 points of print wide.
    point = (np.nanmax(paths[..., 2]) - np.nanmin(paths[..., 2])) / 600
    written: list[np.ndarray] = []
    for i, item in enumerate(surfaces):
        if is_break(item):
            continue
        bare = not item.reflects and not is_glass(surfaces, i) and not is_glass(surfaces, i - 1)
        width = 2.2 if item.reflects else 0.6 if bare else 1.1
        axes.plot(*profiles[i].T, color=FAINT if bare and not item.stop else INK, lw=width, zorder=3)
        if i == system.stop:
            upwards = frames[i][0][:, 1][[2, 1]]
            for end, side in ((profiles[i][-1], 1), (profiles[i][0], -1)):
                axes.plot(*np.stack([end, end + 0.25 * side * radii[i] * upwards]).T, color=INK, lw=3, zorder=3)
        # Above the blade of a stop, which stands on the edge of its surface.
        label = profiles[i][-1] + (0.25 * radii[i] * frames[i][0][:, 1][[2, 1]] if i == system.stop else 0)
        room = point * np.array([4.0 * len(str(i)) + 2.0, 9.0])
        level, height = label + 5 * point * np.array([0.0, 1.0]), 5.0
        while any((np.abs(level - other) < room).all() for other in written):
            level, height = level + 8 * point * np.array([0.0, 1.0]), height + 8.0
        written.append(level)
        axes.annotate(str(i), label, xytext=(0, height), textcoords="offset points", ha="center", fontsize=7)
    axes.plot(*profiles[-1].T, color=INK, lw=2, zorder=3)
    figure.legend(fontsize=8, frameon=False, loc="outside right upper", title="field", title_fontsize=8)
    _scale_bar(axes, system.unit)
    axes.set_title(system.name, fontsize=11, parse_math=False)
    return figure


def _element(profiles, frames, radii, front: int, behind: int) -> np.ndarray:
    """Return the section of an element, whose edge is a cylinder of the larger of its two surfaces."""
    outline = [profiles[front], profiles[behind][::-1]]
    small, large = (front, behind) if radii[front] < radii[behind] else (behind, front)
    upwards = (radii[large] - radii[small]) * frames[small][0][:, 1][[2, 1]]
    low, high = profiles[small][0] - upwards, profiles[small][-1] + upwards
    parts = (
        [low[None], outline[0], high[None], outline[1]]
        if small == front
        else [*outline[:1], high[None], outline[1], low[None]]
    )
    return np.concatenate(parts)


def _glass_name(surfaces, i: int) -> str:
    """Return the name of the glass behind a surface without its maker, or its index."""
    while is_break(surfaces[i]):
        i -= 1
    item = surfaces[i]
    return item.material.name.rpartition(":")[2] if item.material else f"n = {float(item.index.detach()):.4g}"


def _curves(system, rays) -> dict[int, np.ndarray]:
    """Return points of the rays within each graded-index medium, by the number of the surface in front of it."""
    kinds = {i: item.gradient for i, item in enumerate(system.surfaces)}
    graded = [i for i, kind in kinds.items() if kind is not None and not isinstance(kind, UniaxialMedium)]
    if not graded:
        return {}
    paths = ray_paths(system, rays)
    breaks = {i for i, item in enumerate(system.surfaces) if is_break(item)}
    ends = {i: next(j for j in range(i + 1, len(system.surfaces) + 1) if j not in breaks) for i in graded}
    return {
        i: curved_paths(system, rays, i, paths[..., j + 1, :])[system.reference].cpu().numpy() for i, j in ends.items()
    }


def _with_curves(path: np.ndarray, curves: dict[int, np.ndarray], stations: int) -> np.ndarray:
    """Return the points of a ray at its stations, the last of which are surfaces, and on its curves between them."""
    first = len(path) - stations
    parts = [path[:first]]
    for i in range(stations):
        parts += [path[first + i : first + i + 1], *([curves[i][1:-1]] if i in curves else [])]
    return np.concatenate(parts)


def image_unit(system: optical_system) -> str:
    """Return the unit of small lengths in the image; afocal systems have angles instead."""
    return "µrad" if system.afocal else "µm"


def _profile(scene: SystemScene, i: int) -> np.ndarray:
    """Return a section of a surface in the plane x = 0 as points (z, y) in global coordinates."""
    points, _ = scene.points(i, np.zeros(1), np.linspace(-scene.radii[i], scene.radii[i], POINTS))
    return points[np.isfinite(points).all(-1)][:, [2, 1]]


def focus_unit(system: optical_system) -> tuple[str, float]:
    """Return the unit of focal shifts and the factor to it; shifts of 1 m by the lens of 1 m are a dioptre."""
    return ("1/m", MICROMETRES[system.unit] * 1e-6) if system.afocal else (unit_of(system), 1.0)


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


def spots_figure(system: optical_system, found: Spots | None = None) -> Figure:
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
        The circle is Airy's first dark ring at the reference wavelength, its radius in the legend; afocal systems have
        none. More than three fields are in two rows.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, spots_figure
    >>> lens = load_system("cooke_triplet")
    >>> len(spots_figure(lens).axes) >= len(lens.fields)
    True
    """
    checked_system(system)
    found = spot_diagram(system, "rings", 8) if found is None else found
    _validate.instance("found", found, Spots, "Spots")
    scale = MICROMETRES[system.unit]
    aperture = image_aperture(system)
    airy = 0.61 * system.wavelengths[system.reference] / aperture * scale if aperture else 0.0
    finite = [value * scale for value in found.largest.detach().flatten().tolist() if math.isfinite(value)]
    half = 1.1 * max([*finite, airy], default=1.0)
    count = found.x.shape[-2]
    rows = 1 if count < 4 else 2
    columns = -(-count // rows)
    figure, cells = subplots(rows, columns, (2.6 * columns + 1.2, 3.4 * rows), sharex=True, sharey=True)
    for axes in cells.flat[count:]:
        axes.remove()
    panels = cells.flat[:count]
    circle = np.linspace(0, 2 * np.pi, 100)
    for i, axes in enumerate(panels):
        for j in range(found.x.shape[-3]):
            x, y = (value[j, i].detach().cpu().numpy() * scale for value in (found.x, found.y))
            label = _wavelength(system, j) if i == 0 else None
            axes.plot(x, y, ".", ms=2.5, color=color_of(j), label=label)
        if airy:
            label = f"Airy, radius\n{airy:.3g} {image_unit(system)}" if i == 0 else None
            axes.plot(airy * np.cos(circle), airy * np.sin(circle), color=INK, lw=0.8, label=label)
        axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xlabel=f"x ({image_unit(system)})")
        name = field_label(system, i) if i < len(system.fields) and count == len(system.fields) else str(i)
        axes.set_title(f"field {name}\nRMS {float(found.rms[i].detach()) * scale:.3g} {image_unit(system)}", fontsize=9)
    for axes in panels[::columns]:
        axes.set_ylabel(f"y ({image_unit(system)})")
    figure.legend(fontsize=8, frameon=False, loc="outside right upper")
    return figure


def image_aperture(system: optical_system) -> float:
    """Return the numerical aperture at the image, 0 for an afocal system."""
    return float(first_order(system).numerical_aperture.detach())


def fans_figure(system: optical_system, count: int = 41, aim: str = "paraxial") -> Figure:
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
    figure, panels = subplots(fields, 4, (11, 2.0 * fields + 0.8), sharex=True, sharey="col")
    for column, (kind, axis) in enumerate((("ray", "y"), ("ray", "x"), ("path", "y"), ("path", "x"))):
        with torch.no_grad():
            place, values = (ray_fan if kind == "ray" else path_fan)(system, axis, count, aim=aim)
        values = values.cpu().numpy() * (scale if kind == "ray" else 1.0)
        for i in range(fields):
            for j in range(values.shape[-3]):
                label = _wavelength(system, j) if i == column == 0 else None
                panels[i, column].plot(place.cpu(), values[j, i], color=color_of(j), lw=1.2, label=label)
            panels[i, column].axhline(0, color=FAINT, lw=0.6)
        unit = f"{axis} error ({image_unit(system)})" if kind == "ray" else f"path along {axis} (λ)"
        panels[0, column].set_title(unit, fontsize=9)
        panels[-1, column].set_xlabel("pupil", fontsize=9)
    for i in range(fields):
        panels[i, 0].set_ylabel(f"field {field_label(system, i)}", fontsize=9)
    figure.legend(fontsize=8, frameon=False, loc="outside right upper")
    return figure


def field_figure(system: optical_system, points: int = 21, aim: str = "paraxial") -> Figure:
    """Return field curvature, distortion and lateral colour over the field along y.

    Parameters
    ----------
    system : optical_system
        The system, with a field off the axis.
    points : int
        Number of field points.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels; the field runs upwards. Distortion of fields that reach 90 degrees is that from f·θ.

    Examples
    --------
    >>> from odak.learn.raytracing.system import field_figure, load_system
    >>> lens = load_system("cooke_triplet")
    >>> len(field_figure(lens, points=5).axes)
    3
    """
    checked_system(system)
    points, aim = _validate.integer("points", points, minimum=2), _validate.one_of("aim", aim, AIMS)
    heights, fields = _over_field(system, points)
    projection = projection_of(system)
    with torch.no_grad():
        bent = 100 * distortion(system, projection=projection, fields=fields, aim=aim)[system.reference]
        colour = lateral_color(system, fields=fields, aim=aim) * MICROMETRES[system.unit]
    numbers = system.prescription().at(system.reference)
    curves = field_curvature(system, prescription=numbers, fields=fields, aim=aim)
    tangential, sagittal = (value.detach()[0] * focus_unit(system)[1] for value in curves)
    figure, ((first, second, third),) = subplots(1, 3, (9, 3.6), sharey=True)
    first.plot(tangential, heights, color=color_of(0), label="tangential")
    first.plot(sagittal, heights, color=color_of(2), ls="--", label="sagittal")
    first.legend(fontsize=8, frameon=False)
    second.plot(bent, heights, color=INK)
    for j in range(len(system.wavelengths)):
        third.plot(colour[j], heights, color=color_of(j), label=_wavelength(system, j))
    third.legend(fontsize=8, frameon=False)
    for axes, name in zip(
        (first, second, third),
        (
            f"field curvature ({focus_unit(system)[0]})",
            "distortion (%)" if projection == "tangent" else "distortion from f·θ (%)",
            f"lateral colour ({image_unit(system)})",
        ),
        strict=True,
    ):
        axes.axvline(0, color=FAINT, lw=0.6)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.ticklabel_format(axis="x", scilimits=(-3, 4))
        axes.set_xlabel(name, fontsize=9)
    first.set_ylabel(_field_axis(system), fontsize=9)
    return figure


def projection_of(system: optical_system) -> str:
    """Return the projection from which distortion is stated: "angle" if a field has no tangent."""
    wide = system.at_infinity and any(max(map(abs, field)) >= 90 for field in system.fields)
    return "angle" if wide else "tangent"


def transfer_figure(system: optical_system, samples: int = 64, aim: str = "paraxial") -> Figure:
    """Return modulation transfer functions and encircled energy of each field at the reference wavelength.

    Parameters
    ----------
    system : optical_system
        The system.
    samples : int
        Samples across the pupil; up to 256 where the wavefront needs more.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels: modulation over frequency (full lines tangential, dashed ones sagittal, black the limit of
        diffraction), and the fraction of the energy within a radius. For systems with more than a wavelength of
        aberration both are computed from rays, as the titles say.

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
    cutoff = 2 * image_aperture(system) / system.wavelengths[place]
    if not cutoff:
        raise ValueError("system must have a focus, got an afocal one: there is no modulation transfer at an image")
    numbers = system.prescription().at(place)
    options: dict[str, Any] = {"prescription": numbers, "aim": aim}
    figure, ((left, right),) = subplots(1, 2, (10, 3.6))
    with torch.no_grad():
        # More than a wave of aberration: geometric, for the samples would not resolve the diffraction.
        large = wavefront(system, "rings", 8, aim=aim).rms.nan_to_num().max() > 1
        if large:
            spots = spot_diagram(system, "grid", 2 * samples, **options)
            radii, energy = encircled_energy(spots)
            size = max(float(spots.largest.nan_to_num().max()), 1e-12)
            frequency = torch.linspace(0, min(cutoff, 2 / size), 100, dtype=torch.float64, device=spots.x.device)
            curves = [
                [(frequency, _geometric_transfer(value[0, i], frequency)) for value in (spots.y, spots.x)]
                for i in range(len(system.fields))
            ]
        else:
            spread = pupil_image(system, more_samples(samples), None, options, fineness=8)
            radii, energy = (value[0] for value in encircled_energy(spread))
            both = [modulation_transfer_function(spread, axis) for axis in ("y", "x")]
            curves = [[(f[0, i], m[0, i]) for f, m in both] for i in range(len(system.fields))]
    curves = [[(frequency.cpu(), transfer.cpu()) for frequency, transfer in pair] for pair in curves]
    radii, energy = radii.cpu(), energy.cpu()
    for i, pair in enumerate(curves):
        for (frequency, transfer), style in zip(pair, ("-", "--"), strict=True):
            label = field_label(system, i) if style == "-" else None
            left.plot(frequency * 1e3 / scale, transfer, style, color=color_of(i), lw=1.2, label=label)
        right.plot(radii[i] * scale, energy[i], color=color_of(i), lw=1.2)
    highest = float(curves[0][0][0][-1]) if large else cutoff
    ratio = np.linspace(0, 1, 100)
    ideal = 2 / np.pi * (np.arccos(ratio) - ratio * np.sqrt(1 - ratio**2))
    left.plot(ratio * cutoff * 1e3 / scale, ideal, color=INK, lw=0.8, label="limit")
    angular = "milliradian" if system.afocal else "millimetre"
    left.set_title("geometric" if large else "with diffraction", fontsize=9)
    left.set(xlim=(0, highest * 1e3 / scale), ylim=(0, 1), xlabel=f"cycles per {angular}", ylabel="modulation")
    right.set(xlabel=f"radius ({image_unit(system)})", ylabel="encircled energy", ylim=(0, 1), xlim=(0, None))
    left.legend(fontsize=8, frameon=False)
    return figure


def _geometric_transfer(place: torch.Tensor, frequency: torch.Tensor) -> torch.Tensor:
    """Return |mean exp(2πi·f·y)| over the rays of a spot."""
    place = place[torch.isfinite(place)]
    phase = 2 * math.pi * frequency[:, None] * place
    return (phase.cos().mean(-1).square() + phase.sin().mean(-1).square()).sqrt()


def draw_layout(system: optical_system, aim: str = "paraxial", count: int = 5) -> Image.Image:
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


def draw_spots(system: optical_system, found: Spots) -> Image.Image:
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
    return Image.open(io.BytesIO(png(figure))).convert("RGB")


def _over_pupil(samples: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return which points of a square grid are within the pupil, and these points ``[n, 2]``."""
    line = torch.linspace(-1, 1, samples + 1, dtype=torch.float64)
    y, x = torch.meshgrid(line, line, indexing="ij")
    inside = x * x + y * y <= 1 + 1e-9
    return inside, torch.stack([x[inside], y[inside]], -1)


def _map_pupil(axes, inside: torch.Tensor, values: torch.Tensor, limits, scale: str, label: str | None) -> None:
    """Draw values at the points of :func:`_over_pupil`, with a bar of their colours."""
    grid = np.full(inside.shape, np.nan)
    grid[inside.cpu().numpy()] = values.cpu().numpy()
    low, high = limits
    shown = axes.imshow(grid, origin="lower", extent=(-1, 1, -1, 1), cmap=scale, vmin=low, vmax=high)
    axes.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1])
    axes.figure.colorbar(shown, ax=axes, shrink=0.8, label=label)


def _over_field(system, points: int, off_axis: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
    """Return numbers up to the largest field and the fields ``[points, 2]`` of these along y."""
    largest = plain(largest_of(system.fields))
    if off_axis and not largest:
        raise ValueError("system must have a field off the axis")
    heights = torch.linspace(0, largest, points, dtype=torch.float64, device="cpu")
    return heights, torch.stack([0 * heights, heights], -1)


def _field_axis(system) -> str:
    return "field (°)" if system.at_infinity else f"object height ({unit_of(system)})"


def _wavelength(system, j: int) -> str:
    return f"{system.wavelengths[j] * MICROMETRES[system.unit] * 1e3:.0f} nm"


@takes_constants("frequency", "shifts")
@torch.no_grad()
def through_focus_figure(
    system: optical_system, shifts: Values | None = None, frequency: float | None = None, aim: str = "paraxial"
) -> Figure:
    """Return spots in five planes about the image plane, their sizes, and the modulation at one frequency.

    Parameters
    ----------
    system : optical_system
        The system.
    shifts : sequence of float or torch.Tensor, optional
        Distances of the planes along z, odd in number; by default 21 planes to twice the depth of focus, or as far as
        the spots need to double.
    frequency : float, optional
        Cycles per unit of length; by default a quarter of the limit of diffraction, at most half of one over the
        median spot.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each field. Full lines are modulation of gratings along x (tangential), dashed ones of the other; that
        of afocal systems, and of such with more than two waves of aberration, is left out.

    Raises
    ------
    ValueError
        If the system has no focus.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, through_focus_figure
    >>> lens = load_system("cooke_triplet")
    >>> len(through_focus_figure(lens, [-0.1, 0.0, 0.1]).axes)
    11
    """
    checked_system(system)
    aim, aperture, scale = _validate.one_of("aim", aim, AIMS), image_aperture(system), MICROMETRES[system.unit]
    if not aperture:
        raise ValueError("system must have a focus, got an afocal one: make it an optical_system with afocal=True")
    found = spot_diagram(system, "rings", 5, aim=aim)
    if shifts is None:
        depth = system.wavelengths[system.reference] / aperture**2
        reach = max(depth, 2 * float(found.rms.nan_to_num().median()) / aperture)
        shifts = reach / 10 * torch.arange(-10, 11, dtype=torch.float64)
    shifts = torch.as_tensor(_validate.real("shifts", shifts), dtype=torch.float64)
    if shifts.ndim != 1 or len(shifts) % 2 == 0 or len(shifts) < 3:
        raise ValueError(f"shifts must be an odd number of distances, at least 3, got {tuple(shifts.shape)}")
    sizes = through_focus(system, shifts, "rings", 5, aim=aim) * scale
    rays = trace_fields(system, "rings", 5, aim=aim)
    shifts = shifts.to(rays.x.device)
    shown = sorted({round(i * (len(shifts) - 1) / 4) for i in range(5)})
    fields = len(system.fields)
    size = (2 + 1.5 * len(shown) + 3.4, 1.5 * fields + 1.2)
    figure = Drawing(figsize=size, layout="constrained")
    widths = [1.0] * len(shown) + [2.2]
    cells = figure.add_gridspec(max(fields, 2), len(shown) + 1, width_ratios=widths)
    unit, factor = focus_unit(system)
    spots = {}
    for number in shown:
        moved = [v + (shifts[number] - rays.z) * c / rays.w for v, c in ((rays.x, rays.u), (rays.y, rays.v))]
        spots[number] = [
            (v - v.nan_to_num().sum((-3, -1), keepdim=True) / rays.arrived.sum((-3, -1), keepdim=True)) * scale
            for v in moved
        ]
    half = 1.1 * max([float(v.abs().nan_to_num().max()) for pair in spots.values() for v in pair] + [1e-9])
    for i in range(fields):
        for column, number in enumerate(shown):
            axes = figure.add_subplot(cells[i, column])
            for j in range(rays.x.shape[-3]):
                x, y = (value[j, i].cpu().numpy() for value in spots[number])
                axes.plot(x, y, ".", ms=1.5, color=color_of(j))
            axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xticks=[], yticks=[])
            if i == 0:
                axes.set_title(f"{float(shifts[number]) * factor:+.3g} {unit}", fontsize=8)
            if column == 0:
                axes.set_ylabel(field_label(system, i), fontsize=8)
            if i == fields - 1 and column == len(shown) // 2:
                axes.set_xlabel(f"squares of {2 * half:.3g} {image_unit(system)}", fontsize=8)
    split = max(fields, 2) // 2 + max(fields, 2) % 2
    upper, lower = figure.add_subplot(cells[:split, -1]), figure.add_subplot(cells[split:, -1])
    place = (shifts * factor).cpu().numpy()
    for i in range(fields):
        upper.plot(place, sizes[i].cpu().numpy(), color=color_of(i), lw=1.2, label=field_label(system, i))
    upper.set(ylabel=f"RMS spot ({image_unit(system)})", ylim=(0, None))
    upper.legend(fontsize=7, frameon=False)
    if system.afocal or not float(wavefront(system, "rings", 6, aim=aim).rms.nan_to_num(nan=9).max()) < LARGE:
        lower.remove()
        upper.set_xlabel(f"focus ({unit})", fontsize=8)
        return figure
    cutoff = 2 * aperture / system.wavelengths[system.reference]
    coarse = 0.5 / max(float(found.rms.nan_to_num().median()), 1e-12)
    frequency = (
        min(0.25 * cutoff, coarse)
        if frequency is None
        else float(_validate.number("frequency", frequency, positive=True))
    )
    options = {"aim": aim, "prescription": system.prescription().at(system.reference)}
    both = modulation_in_planes(system, shifts, frequency, (24, 32, 48, *RAYS), ("y", "x"), **options)[:, 0]
    for transfer, style in zip(both.cpu().numpy(), ("-", "--"), strict=True):
        for i in range(fields):
            lower.plot(place, transfer[i], style, color=color_of(i), lw=1.2)
    lower.set(ylim=(0, 1), xlabel=f"focus ({unit})", ylabel=f"modulation\nat {frequency * 1e3 / scale:.3g} cycles/mm")
    return figure


@torch.no_grad()
def wavefront_figure(
    system: optical_system, samples: int = 64, aim: str = "paraxial", quality: FieldQuality | None = None
) -> Figure:
    """Return maps of the wavefront over the pupil, and the diffraction images, at the reference wavelength.

    Parameters
    ----------
    system : optical_system
        The system.
    samples : int
        Samples across the pupil; of the images up to 256 where the wavefront needs more.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    quality : FieldQuality, optional
        From :func:`field_quality`, where available.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each field: path differences in wavelengths with their root mean square, and below the amplitude
        (square root of the intensity) of the image with its Strehl ratio, both numbers as in `quality`. Images are
        left out if a wavefront has more than two waves RMS.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, wavefront_figure
    >>> figure = wavefront_figure(load_system("cooke_triplet"), samples=16)
    >>> figure.axes[0].get_title().startswith("field 0°")
    True
    """
    checked_system(system)
    samples, aim = _validate.integer("samples", samples, minimum=8), _validate.one_of("aim", aim, AIMS)
    fields, numbers = len(system.fields), system.prescription().at(system.reference)
    inside, points = _over_pupil(samples)
    found = wavefront(system, points, prescription=numbers, aim=aim)
    quality = _quality(system, aim, quality)
    small = float(found.rms.nan_to_num(nan=9.0).max()) <= LARGE
    figure, panels = subplots(1 + small, fields, (2.9 * fields + 0.6, 2.9 * (1 + small) + 0.2))
    for i, axes in enumerate(panels[0]):
        span = float(found.path[0, i].abs().nan_to_num().max()) or 1.0
        axes.set_title(f"field {field_label(system, i)}\nRMS {float(quality.wavefront_rms[i]):.3g} λ", fontsize=9)
        _map_pupil(axes, inside, found.path[0, i], (-span, span), "RdBu_r", "path (λ)" if i == fields - 1 else None)
    panels[0, 0].set_ylabel("pupil y", fontsize=9)
    if not small:
        return figure
    options: dict[str, Any] = {"prescription": numbers, "aim": aim}
    spread = pupil_image(system, more_samples(samples), None, options, fineness=8)
    half = spread.intensity.shape[-1] // 4
    for i, axes in enumerate(panels[1]):
        middle = spread.intensity[0, i, half:-half, half:-half]
        rows, columns = (float(v) * MICROMETRES[system.unit] * half for v in spread.pitch[0, i])
        extent = (-columns, columns, -rows, rows)
        shown = axes.imshow(middle.sqrt().cpu().numpy(), origin="lower", extent=extent, cmap="magma", vmin=0)
        axes.set_title(f"Strehl ratio {float(quality.strehl[i]):.2f}", fontsize=9)
        axes.set_xlabel(f"x ({image_unit(system)})", fontsize=9)
        figure.colorbar(shown, ax=axes, shrink=0.8, label="amplitude" if i == fields - 1 else None)
    panels[1, 0].set_ylabel(f"y ({image_unit(system)})", fontsize=9)
    return figure


@torch.no_grad()
def image_figure(system: optical_system, points: int = 11, aim: str = "paraxial") -> Figure:
    """Return a grid distorted by the lens, the illumination over the field, and the focus over the wavelength.

    Parameters
    ----------
    system : optical_system
        The system, with a field off the axis.
    points : int
        Points along each side of the grid, and field points of the illumination.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    matplotlib.figure.Figure
        The ideal grid is grey, the real one blue. The illuminance by a uniform Lambertian object is relative to
        the axis; dashed, the fraction of the rays through the pupil that apertures let pass. The last panel is left out
        with a single wavelength.

    Examples
    --------
    >>> from odak.learn.raytracing.system import image_figure, load_system
    >>> len(image_figure(load_system("cooke_triplet"), 5).axes)
    3
    """
    checked_system(system)
    points, aim = _validate.integer("points", points, minimum=2), _validate.one_of("aim", aim, AIMS)
    low, high = min(system.wavelengths), max(system.wavelengths)
    figure, panels = subplots(1, 3 if low < high else 2, (10 if low < high else 6.8, 3.4))
    first, second = panels[0, :2]
    name = "milliradian" if system.afocal else unit_of(system)
    scale = 1e3 / (1e6 / MICROMETRES[system.unit]) if system.afocal else 1.0
    heights, fields = _over_field(system, points, off_axis=False)
    numbers = system.prescription().at(system.reference)
    if projection_of(system) == "tangent":
        for grid, color in zip(distortion_grid(system, points, aim=aim), (FAINT, color_of(0)), strict=True):
            for lines in (grid, grid.swapaxes(0, 1)):
                first.plot(lines[..., 0].T.cpu().numpy(), lines[..., 1].T.cpu().numpy(), color=color, lw=0.8)
        first.set(aspect="equal", xlabel=f"x ({name})", ylabel=f"y ({name})")
        first.xaxis.set_major_formatter(lambda value, _: f"{value * scale:g}")
    else:
        # A grid of tangents does not reach 90 degrees: heights over angles, beside f·θ.
        chief = trace_fields(system, CENTRE, prescription=numbers, fields=fields, aim=aim, vignetting=False).y[0, :, 0]
        ideal = paraxial_points(system, numbers, fields, "angle")[:, 1]
        for values, color, label in ((ideal, FAINT, "f·θ"), (chief, color_of(0), "chief rays")):
            first.plot(heights.numpy(), values.cpu().numpy(), color=color, label=label)
        first.set(xlabel="field (°)", ylabel=f"y ({name})")
        first.legend(fontsize=8, frameon=False)
    first.yaxis.set_major_formatter(lambda value, _: f"{value * scale:g}")
    first.set_title("distortion", fontsize=9)
    light = relative_illumination(system, 8, prescription=numbers, fields=fields, aim=aim)[0]
    passed = trace_fields(system, "rings", 16, prescription=numbers, fields=fields, aim=aim).arrived[0]
    second.plot(heights.numpy(), light.cpu().numpy(), color=INK, label="illuminance")
    second.plot(
        heights.numpy(), passed.double().mean(-1).cpu().numpy(), color=color_of(2), ls="--", label="rays passed"
    )
    second.set(ylim=(0, 1.05), xlabel=_field_axis(system))
    second.set_title("illumination", fontsize=9)
    second.legend(fontsize=8, frameon=False)
    if low < high:
        third = panels[0, 2]
        unit, factor = focus_unit(system)
        waves = np.linspace(low, high, 41)
        shifts = axial_color(system, waves.tolist()).cpu().numpy() * factor
        third.plot(waves * MICROMETRES[system.unit] * 1e3, shifts, color=INK)
        third.axhline(0, color=FAINT, lw=0.6)
        third.set(xlabel="wavelength (nm)", ylabel=f"focal shift ({unit})")
        third.set_title("axial colour", fontsize=9)
    return figure


def modulation_frequencies(system: optical_system) -> list[float]:
    """Return an eighth and a quarter of the limit of diffraction in cycles per unit of length, of one digit each."""
    cutoff = 2 * image_aperture(system) / system.wavelengths[system.reference]
    return [float(f"{share * cutoff:.1g}") for share in (0.125, 0.25)]


@takes_constants("frequencies")
@torch.no_grad()
def performance_figure(
    system: optical_system, points: int = 11, frequencies: Values | None = None, aim: str = "paraxial"
) -> Figure:
    """Return spots, wavefronts, modulation and vignetting over the field along y.

    Parameters
    ----------
    system : optical_system
        The system, with a field off the axis.
    points : int
        Number of field points.
    frequencies : sequence of float, optional
        Of the modulation in cycles per unit of length; an eighth and a quarter of the limit of diffraction by default.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels: root mean square of the spot (full) and of the wavefront at the reference wavelength (dashed,
        right axis); modulation (full tangential, dashed sagittal), left out without a focus; vignetting factors VCX
        and VCY.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, performance_figure
    >>> [axes.get_ylabel() for axes in performance_figure(load_system("cooke_triplet"), 3).axes]
    ['RMS spot (µm)', 'modulation', 'vignetting factor', 'RMS wavefront (λ)']
    """
    checked_system(system)
    points, aim = _validate.integer("points", points, minimum=2), _validate.one_of("aim", aim, AIMS)
    heights, fields = _over_field(system, points)
    focus = bool(image_aperture(system)) and not system.afocal
    numbers = system.prescription().at(system.reference)
    samples = pupil_quadrature(system, 16, fields=fields, aim=aim)
    spots = spot_diagram(system, samples, fields=fields, aim=aim).rms
    waves = wavefront(system, samples, fields=fields, aim=aim, prescription=numbers).rms[0]
    figure, panels = subplots(1, 2 + focus, (3.6 * (2 + focus), 3.4))
    first, last = panels[0, 0], panels[0, -1]
    first.plot(heights, spots.cpu() * MICROMETRES[system.unit], color=color_of(0))
    first.set_ylabel(f"RMS spot ({image_unit(system)})", color=color_of(0))
    second = first.twinx()
    second.plot(heights, waves.cpu(), color=color_of(2), ls="--")
    second.set_ylabel("RMS wavefront (λ)", color=color_of(2))
    if focus:
        middle = panels[0, 1]
        frequencies = modulation_frequencies(system) if frequencies is None else frequencies
        found = field_modulation(system, frequencies, fields, aim=aim).cpu()
        for i, frequency in enumerate(torch.as_tensor(frequencies).tolist()):
            label = f"{frequency * 1e3 / MICROMETRES[system.unit]:.3g} cycles/mm"
            middle.plot(heights, found[0, i], color=color_of(i), label=label)
            middle.plot(heights, found[1, i], color=color_of(i), ls="--")
        middle.set(ylim=(0, 1), ylabel="modulation")
        middle.legend(fontsize=8, frameon=False)
    factors = vignetting_factors(system, fields, aim=aim).cpu()
    for column, name, style in ((3, "VCY", "-"), (2, "VCX", "--")):
        last.plot(heights, factors[:, column], style, color=INK, label=name)
    last.set(ylabel="vignetting factor", ylim=(min(0.0, float(factors[:, 2:].nan_to_num().min())), 1))
    last.legend(fontsize=8, frameon=False)
    for axes in (first, second):
        axes.set_ylim(0, None)
    for axes in panels[0]:
        axes.set_xlabel(_field_axis(system), fontsize=9)
    return figure


@torch.no_grad()
def pupil_figure(system: optical_system, place: int | None = None, aim: str = "paraxial") -> Figure:
    """Return the y–ȳ diagram, the aberration of the pupil and the angles of incidence at a surface.

    Parameters
    ----------
    system : optical_system
        The system, with a field off the axis.
    place : int, optional
        Number of the surface; by default the one with the largest angle of incidence.
    aim : str
        "paraxial" or "real", how :func:`launch` aims; "real" for fields at 90 degrees and beyond.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels: heights of the marginal ray over heights of the chief ray at the surfaces, the image an open
        point; deviations along y at the stop, with `aim` "real" in the entrance pupil, in percent of its radius
        (:func:`pupil_aberration`); angles of incidence over the height on the surface.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, pupil_figure
    >>> [axes.get_title() for axes in pupil_figure(load_system("cooke_triplet"), 4).axes]
    ['y–ȳ diagram', 'aberration of the pupil', 'incidence at surface 4']
    """
    checked_system(system)
    aim = _validate.one_of("aim", aim, AIMS)
    if not any(any(field) for field in system.fields):
        raise ValueError("system must have a field off the axis")
    figure, panels = subplots(1, 3, (10.8, 3.6))
    first, second, third = panels[0]
    rays = paraxial_rays(system)
    shown = [i for i, item in enumerate(system.surfaces) if not is_break(item)]
    chief, marginal = (value.cpu().numpy() for value in (rays.chief_height, rays.marginal_height))
    first.plot(chief, marginal, color=color_of(0), lw=1)
    first.plot(chief[shown], marginal[shown], ".", color=INK)
    first.plot(chief[-1:], marginal[-1:], "o", mfc="white", color=INK)
    for i in shown:
        first.annotate(str(i), (chief[i], marginal[i]), (4, 3), textcoords="offset points", fontsize=7)
    first.set(xlabel=f"chief ray ({unit_of(system)})", ylabel=f"marginal ray ({unit_of(system)})")
    first.set_title("y–ȳ diagram", fontsize=9)
    pupil, error = (value.cpu() for value in pupil_aberration(system, aim=aim))
    numbers = system.prescription().at(system.reference)
    found = incidence_angles(system, "y", 41, prescription=numbers, aim=aim)
    if place is None:
        own = [
            k for k, i in enumerate(found.places) if i < len(system.surfaces) and system.surfaces[i].own_phase is None
        ]
        column = max(own or [0], key=lambda k: float(found.angle[k].nan_to_num().max()))
    else:
        place = _validate.place_in("place", place, len(system.surfaces))
        if place not in found.places:
            raise ValueError(f"place must be a surface, got the coordinate break {place}")
        column = found.places.index(place)
    for i in range(len(system.fields)):
        second.plot(pupil, 100 * error[i], color=color_of(i), lw=1.2, label=field_label(system, i))
        height, angle = (value[column, 0, i].cpu() for value in (found.y, found.angle))
        third.plot(height, angle, color=color_of(i), lw=1.2)
    second.axhline(0, color=FAINT, lw=0.6)
    where = "at the stop" if aim == "paraxial" else "in the entrance pupil"
    second.set(xlabel="pupil y", ylabel=f"deviation {where} (%)")
    second.set_title("aberration of the pupil", fontsize=9)
    second.legend(fontsize=8, frameon=False, title="field", title_fontsize=8)
    third.set(xlabel=f"y on the surface ({unit_of(system)})", ylabel="angle of incidence (°)", ylim=(0, None))
    third.set_title(f"incidence at surface {found.places[column]}", fontsize=9)
    return figure


@torch.no_grad()
def footprint_figure(system: optical_system, places: Sequence[int] | None = None, aim: str = "paraxial") -> Figure:
    """Return where the rays of each field meet surfaces, at the reference wavelength, with the rims of the surfaces.

    Parameters
    ----------
    system : optical_system
        The system.
    places : sequence of int, optional
        Numbers of the surfaces; the first one, the stop and the last one by default.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each surface, a colour for each field.

    Examples
    --------
    >>> from odak.learn.raytracing.system import footprint_figure, load_system
    >>> [axes.get_title() for axes in footprint_figure(load_system("cooke_triplet")).axes]
    ['surface 0', 'surface 3 (stop)', 'surface 5']
    """
    checked_system(system)
    aim = _validate.one_of("aim", aim, AIMS)
    own = [i for i in range(len(system.surfaces) - system.afocal) if not is_break(system.surfaces[i])]
    if places is None:
        places = sorted({own[0], system.stop, own[-1]})
    elif not isinstance(places, Iterable) or isinstance(places, str):
        raise TypeError(f"places must be a sequence of numbers of surfaces, got {type(places).__name__}")
    places = [_validate.place_in("places", place, len(system.surfaces)) for place in places]
    numbers = system.prescription().at(system.reference)
    figure, panels = subplots(1, max(len(places), 1), (3.0 * max(len(places), 1) + 1.0, 3.2))
    circle = np.linspace(0, 2 * np.pi, 200)
    for axes, place in zip(panels[0], places, strict=False):
        found = footprint(system, place, "rings", 7, prescription=numbers, aim=aim)
        item: Any = system.surfaces[place]
        for i in range(len(system.fields)):
            label = field_label(system, i) if place == places[0] else None
            x, y = (value[0, i].cpu().numpy() for value in (found.x, found.y))
            axes.plot(x, y, ".", ms=2, color=color_of(i), label=label)
        if item.semi_diameter:
            axes.plot(item.semi_diameter * np.cos(circle), item.semi_diameter * np.sin(circle), color=INK, lw=0.8)
        axes.set(aspect="equal", xlabel=f"x ({unit_of(system)})")
        axes.set_title(f"surface {place}" + (" (stop)" if place == system.stop else ""), fontsize=9)
        axes.xaxis.set_major_locator(MaxNLocator(5))
    panels[0, 0].set_ylabel(f"y ({unit_of(system)})")
    figure.legend(fontsize=8, frameon=False, loc="outside right upper", title="field", title_fontsize=8)
    return figure


@torch.no_grad()
def polarisation_figure(system: optical_system, samples: int = 24, aim: str = "paraxial") -> Figure:
    """Return maps of diattenuation and retardance over the pupil of each field at the reference wavelength.

    Parameters
    ----------
    system : optical_system
        The system, with the coatings of its surfaces.
    samples : int
        Samples across the pupil.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each field: diattenuation above, retardance below, with the mean transmittance of unpolarised
        light.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, polarisation_figure
    >>> figure = polarisation_figure(load_system("singlet"), 8)
    >>> "transmittance" in figure.axes[0].get_title()
    True
    """
    checked_system(system)
    samples, aim = _validate.integer("samples", samples, minimum=4), _validate.one_of("aim", aim, AIMS)
    inside, points = _over_pupil(samples)
    numbers, fields = system.prescription().at(system.reference), len(system.fields)
    found = polarized_trace(system, launch(system, points, prescription=numbers, aim=aim), prescription=numbers)
    figure, panels = subplots(2, fields, (2.9 * fields + 0.6, 5.6))
    maps = (found.diattenuation, "diattenuation"), (found.retardance, "retardance (rad)")
    for row, (values, name) in enumerate(maps):
        top = float(values.nan_to_num().max()) or 1.0
        for i in range(fields):
            label = name if i == fields - 1 else None
            _map_pupil(panels[row, i], inside, values[0, i], (0, top), "viridis", label)
        panels[row, 0].set_ylabel("pupil y", fontsize=9)
    for i in range(fields):
        kept = found.traced.arrived[0, i]
        mean = float(found.transmittance[0, i][kept].mean()) if bool(kept.any()) else 0.0
        panels[0, i].set_title(f"field {field_label(system, i)}\ntransmittance {mean:.3f}", fontsize=9)
    return figure


@torch.no_grad()
def seidel_figure(system: optical_system) -> Figure:
    """Return the Seidel coefficients of each surface and their sums in wavelengths, as bars.

    Parameters
    ----------
    system : optical_system
        A system that :func:`seidel_sums` accepts.

    Returns
    -------
    matplotlib.figure.Figure
        Five bars for each surface, and for the sum.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, seidel_figure
    >>> [text.get_text() for text in seidel_figure(load_system("singlet")).axes[0].get_xticklabels()]
    ['0', '1', 'sum']
    """
    waves = seidel_sums(system).seidel / system.wavelengths[system.reference]
    values = torch.cat([waves, waves.sum(-1, keepdim=True)], -1).cpu().numpy()
    count = values.shape[-1]
    figure, panels = subplots(1, 1, (min(3 + 0.7 * count, 14), 3.2))
    axes = panels[0, 0]
    for k, name in enumerate(("spherical", "coma", "astigmatism", "Petzval", "distortion")):
        axes.bar(np.arange(count) + (k - 2) * 0.16, values[k], 0.16, color=color_of(k), label=name)
    axes.axhline(0, color=INK, lw=0.6)
    axes.axvline(count - 1.5, color=FAINT, lw=0.6)
    axes.set_xticks(range(count), [*map(str, range(count - 1)), "sum"])
    axes.set(xlabel="surface", ylabel="Seidel coefficient (λ)")
    figure.legend(fontsize=8, frameon=False, loc="outside right upper")
    return figure


@torch.no_grad()
def tolerance_figure(
    system: optical_system, found: ToleranceResult | Sensitivity, limit: float | None = None
) -> Figure:
    """Return the yield of a tolerance analysis, or the changes by each deviation alone.

    Parameters
    ----------
    system : optical_system
        The system.
    found : ToleranceResult or Sensitivity
        From :func:`tolerance`: the fraction of the systems whose merits are below a value, for each field and for all
        of them, and a histogram of their root mean square over the fields, with the value of the system as drawn. From
        :func:`sensitivity`: bars of the root mean square of the merits relative to the system as drawn. Merits are
        taken to be lengths, as from :func:`rms_spot`.
    limit : float, optional
        Largest merit that is accepted, marked with the yield.

    Returns
    -------
    matplotlib.figure.Figure
        In micrometres.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Perturbation, load_system, sensitivity, tolerance_figure
    >>> lens = load_system("cooke_triplet")
    >>> figure = tolerance_figure(lens, sensitivity(lens, [Perturbation("thickness", [1, 3], 0.02)]))
    >>> [text.get_text() for text in figure.axes[0].get_yticklabels()]
    ['thickness of surface 1', 'thickness of surface 3']
    """
    checked_system(system)
    scale, unit = MICROMETRES[system.unit], image_unit(system)
    limit = None if limit is None else float(_validate.number("limit", limit, positive=True))
    if isinstance(found, Sensitivity):
        merit = (found.merit * scale).reshape(2, len(found.names), -1).square().mean(-1).sqrt().cpu().numpy()
        nominal = float((found.nominal * scale).square().mean().sqrt())
        figure, panels = subplots(1, 1, (7.5, 1.2 + 0.22 * len(found.names)))
        axes, place = panels[0, 0], np.arange(len(found.names))
        for sign, values, shift in (("+", merit[0], -0.18), ("−", merit[1], 0.18)):
            axes.barh(place + shift, values - nominal, 0.34, color=color_of(0 if sign == "+" else 2), label=sign)
        axes.set_yticks(place, found.names)
        axes.tick_params(axis="y", labelsize=8)
        axes.invert_yaxis()
        axes.axvline(0, color=INK, lw=0.6)
        axes.set_xlabel(f"change of the RMS over the fields from {nominal:.3g} {unit} ({unit})")
        axes.legend(fontsize=8, frameon=False)
        return figure
    _validate.instance("found", found, ToleranceResult, "a ToleranceResult or a Sensitivity")
    merit = (found.merit.detach() * scale).reshape(len(found.merit), -1).cpu()
    figure, panels = subplots(1, 2, (9.0, 3.4))
    axes, share = panels[0, 0], np.arange(1, len(merit) + 1) / len(merit)
    overall = merit.square().mean(-1).sqrt()
    panels[0, 1].hist(overall[overall.isfinite()].numpy(), bins=max(8, round(len(merit) ** 0.5)), color=color_of(0))
    panels[0, 1].axvline(float((found.nominal * scale).square().mean().sqrt()), color=INK, lw=0.8, label="as drawn")
    panels[0, 1].set(xlabel=f"RMS over the fields ({unit})", ylabel="number of systems", xlim=(0, None))
    panels[0, 1].legend(fontsize=8, frameon=False)
    several = merit.shape[1] > 1
    for i in range(merit.shape[1]):
        label = f"field {field_label(system, i)}" if merit.shape[1] == len(system.fields) else str(i)
        axes.plot(
            merit[:, i].nan_to_num(nan=torch.inf).sort().values.numpy(), share, color=color_of(i), lw=1.0, label=label
        )
    if several:
        worst = merit.nan_to_num(nan=torch.inf).amax(-1).sort().values.numpy()
        axes.plot(worst, share, color=INK, lw=1.6, label="all fields")
    if limit is not None:
        axes.axvline(limit * scale, color=FAINT, lw=0.8)
        axes.set_title(
            f"yield {100 * float(found.yield_within(limit)):.0f} % within {limit * scale:.3g} {unit}", fontsize=9
        )
    axes.set(xlabel=f"RMS spot ({unit})", ylabel="share of the systems", ylim=(0, 1), xlim=(0, None))
    axes.legend(fontsize=8, frameon=False)
    return figure


def _quality(system, aim: str, given) -> FieldQuality:
    """Return the numbers of each field, those that are given where there are any."""
    _validate.instance("quality", given, (FieldQuality, type(None)), "a FieldQuality")
    return field_quality(system, aim) if given is None else given


def report_figures(
    system: optical_system, aim: str = "paraxial", quality: FieldQuality | None = None
) -> dict[str, Figure]:
    """Return the figures of :func:`lens_report` by their names; those that a system cannot have are left out.

    Parameters
    ----------
    system : optical_system
        The system.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    quality : FieldQuality, optional
        From :func:`field_quality`, where available: the numbers in the titles.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, report_figures
    >>> list(report_figures(load_system("singlet")))[:6]
    ['layout', 'spots', 'fans', 'transfer', 'through_focus', 'wavefront']
    """
    checked_system(system)
    quality = _quality(system, aim, quality)
    found = {
        "layout": layout_figure(system, aim),
        "spots": spots_figure(system, spot_diagram(system, "rings", 8, aim=aim)._replace(rms=quality.rms_spot)),
        "fans": fans_figure(system, aim=aim),
    }
    if image_aperture(system):
        found["transfer"] = transfer_figure(system, aim=aim)
        found["through_focus"] = through_focus_figure(system, aim=aim)
    found["wavefront"] = wavefront_figure(system, aim=aim, quality=quality)
    if any(any(field) for field in system.fields):
        found["field"] = field_figure(system, aim=aim)
        found["image"] = image_figure(system, aim=aim)
        found["performance"] = performance_figure(system, aim=aim)
        with suppress(ValueError):
            # Graded media between folds have no first order.
            found["pupil"] = pupil_figure(system, aim=aim)
    found["footprint"] = footprint_figure(system, aim=aim)
    found["polarisation"] = polarisation_figure(system, aim=aim)
    with suppress(ValueError):
        # Only centred systems of rotationally symmetric surfaces have Seidel coefficients.
        found["seidel"] = seidel_figure(system)
    return found


def lens_report(
    system: optical_system,
    path: str | os.PathLike[str],
    aim: str = "paraxial",
    figures: dict[str, Figure] | None = None,
    quality: FieldQuality | None = None,
) -> None:
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
        From :func:`report_figures`, where available; figures of :func:`tolerance_figure` as "tolerance" and
        "sensitivity".
    quality : FieldQuality, optional
        From :func:`field_quality`, where available.

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
        "performance": "Spot, wavefront, modulation and vignetting over the field",
        "pupil": "y–ȳ diagram, aberration of the pupil, angles of incidence",
        "footprint": "Footprints",
        "polarisation": "Diattenuation and retardance",
        "seidel": "Seidel coefficients by surface",
        "tolerance": "Spots of lenses with deviations",
        "sensitivity": "Change of the spots by each deviation alone",
    }
    parts = [f"<p>{html.escape(system.source)}</p>"]
    _validate.instance("figures", figures, (dict, type(None)), "a result of report_figures")
    quality = _quality(system, aim, quality)
    figures = report_figures(system, aim, quality) if figures is None else figures
    for name in headings:
        if name in figures:
            text = svg(figures[name])
            parts += [f"<h2>{headings[name]}</h2>", f"<figure>{text[text.index('<svg') :]}</figure>"]
        if name == "layout":
            parts += _numbers_of(system, aim, quality)
    template = resources.files("odak").joinpath("assets/page.html").read_text(encoding="utf-8")
    body = "\n".join(['<div class="report">', *parts, "</div>"])
    write_file(path, template.format(title=html.escape(system.name or "Optical system"), body=body).encode())


@torch.no_grad()
def _first_order_rows(system) -> list[tuple[str, Any]]:
    """Return names and values of first-order properties; afocal systems have no focal length among them."""
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
    return rows


_COLUMNS = ("radius", "thickness", "material", "shape")


def _surface_rows(system) -> list[tuple[Any, ...]]:
    """Return the number, radius, thickness, material and shape of each surface."""
    rows = []
    for i, entry in enumerate(system_to_dict(system)["surfaces"]):
        kind = "break" if entry.get("break") else entry.get("shape", {}).get("kind", "")
        radius = entry.get("radius")
        mark = " (stop)" if i == system.stop else ""
        rows.append(
            (f"{i}{mark}", "∞" if radius is None else radius, entry["thickness"], str(entry.get("material", "")), kind)
        )
    return rows


@torch.no_grad()
def _numbers_of(system, aim: str, quality: FieldQuality) -> list[str]:
    """Return the tables of a report."""
    unit, scale = unit_of(system), MICROMETRES[system.unit]
    parts = [f"<h2>First order ({unit})</h2>", _show.table([("property", "value"), *_first_order_rows(system)])]
    parts += [f"<h2>Prescription ({unit})</h2>", _show.table([("surface", *_COLUMNS), *_surface_rows(system)])]
    largest = spot_diagram(system, "rings", 8, aim=aim).largest
    rows = [
        (
            field_label(system, i),
            quality.rms_spot[i] * scale,
            largest[i] * scale,
            quality.wavefront_rms[i],
            quality.strehl[i],
            100 * (1 - quality.passed[i]).clamp_min(1e-9),
        )
        for i in range(len(system.fields))
    ]
    small = image_unit(system)
    head = (
        "field", f"RMS spot ({small})", f"largest ({small})", "wavefront RMS (λ)", "Strehl ratio", "vignetted (%)"
    )  # fmt: skip
    parts += ["<h2>Fields</h2>", _show.table([head, *rows])]
    stated = f"Means over the area of the pupil by Gaussian quadrature with {quality.count} rings"
    parts += [f"<p>{stated}; with half as many they differ by at most {quality.change:.1g}.</p>"]
    if image_aperture(system) and not system.afocal:
        frequencies = modulation_frequencies(system)
        found = field_modulation(system, frequencies, aim=aim)
        names = [f"{f * 1e3 / scale:.3g} cycles/mm {way}" for f in frequencies for way in ("T", "S")]
        rows = [(field_label(system, i), *found[:, :, i].T.flatten()) for i in range(len(system.fields))]
        parts += ["<h2>Modulation at the reference wavelength</h2>", _show.table([("field", *names), *rows])]
    try:
        sums = seidel_sums(system)
    except ValueError:
        return parts
    waves = sums.seidel / system.wavelengths[system.reference]
    names = ("spherical", "coma", "astigmatism", "Petzval", "distortion")
    rows = [(str(i), *waves[:, i]) for i in range(waves.shape[-1])] + [("sum", *waves.sum(-1))]
    return [*parts, "<h2>Seidel coefficients by surface (wavelengths)</h2>", _show.table([("surface", *names), *rows])]


# First-order properties that have no unit.
_RATIOS = ("magnification", "f number", "working f number", "numerical aperture", "angular magnification")


@torch.no_grad()
def _drawn(system) -> tuple[list[Any], list[Any], list[Any]]:
    """Return the layout of a system, rows of its first-order properties, and why either is missing."""
    pictures: list[Any] = []
    rows: list[Any] = []
    failed: list[Any] = []
    try:
        pictures = [("layout", svg(layout_figure(system)))]
    except (ValueError, RuntimeError, ArithmeticError, IndexError) as error:
        failed.append(f"the layout cannot be drawn: {error}")
    try:
        found = [(name, float(value)) for name, value in _first_order_rows(system)]
        unit = unit_of(system)
        rows = [(n, f"{v + 0.0:.6g}" + (f" {unit}" if n not in _RATIOS and "(" not in n else "")) for n, v in found]
    except (ValueError, RuntimeError) as error:
        failed.append(f"first-order properties cannot be stated: {error}")
    return pictures, rows, failed


def system_view(system: optical_system) -> _show.View:
    """Return what notebooks show of a system: its layout, first-order properties and surfaces.

    Parameters
    ----------
    system : optical_system
        The system.
    """
    pictures, rows, failed = _drawn(system)
    unit = unit_of(system)
    surfaces = [(f"surface {i}", *rest) for i, *rest in _surface_rows(system)]
    # Most lenses have no shapes but spheres and aspheres.
    columns = _COLUMNS[2:] if any(row[-1] for row in surfaces) else _COLUMNS[2:3]
    surfaces = [row[: 3 + len(columns)] for row in surfaces]
    head = [("property", "value"), *rows, ("", f"radius ({unit})", f"thickness ({unit})", *columns), *surfaces]
    return _show.View(_title(system), pictures, head, failed)


def _title(system) -> str:
    """Return name, aperture, fields and wavelengths of a system in a line."""
    scale = MICROMETRES[system.unit] * 1e3
    kind = {"EPD": "entrance pupil of", "stop": "stop of"}.get(system.aperture_type, system.aperture_type)
    size = f"{kind} {system.aperture:g}" + (f" {unit_of(system)}" if system.aperture_type in ("EPD", "stop") else "")
    fields = ", ".join(field_label(system, i) for i in range(len(system.fields)))
    waves = ", ".join(f"{wave * scale:.4g}" for wave in system.wavelengths)
    return f"{system.name or 'Optical system'}: {size}, fields {fields}, {waves} nm"


def configurations_view(zoom: Any) -> _show.View:
    """Return what notebooks show of configurations: layouts of the first four, and first-order properties of all.

    Parameters
    ----------
    zoom : configurations
        The configurations.
    """
    found = [_drawn(zoom.view(i)) for i in range(zoom.count)]
    pictures = [(f"configuration {i}", p[0][1]) for i, (p, _, _) in enumerate(found[:SHOWN]) if p]
    names = list(dict.fromkeys(name for _, rows, _ in found for name, _ in rows))
    head = ("property", *(f"configuration {i}" for i in range(zoom.count)))
    table = [head, *((name, *(dict(rows).get(name, "") for _, rows, _ in found)) for name in names)]
    failed = [f"configuration {i}: {text}" for i, (_, _, texts) in enumerate(found) for text in texts]
    return _show.View(f"{zoom.count} configurations of {_title(zoom.system)}", pictures, table, failed)


def spots_view(found: Spots) -> _show.View:
    """Return what notebooks show of a spot diagram; lengths are in the unit of its system, which it does not know.

    Parameters
    ----------
    found : Spots
        From :func:`spot_diagram`.
    """
    x, y, lost = (value.detach().cpu() for value in (found.x, found.y, found.status != 0))
    x, y, lost = (value.flatten(0, -4)[0] if value.ndim > 3 else value for value in (x, y, lost))
    count = x.shape[-2]
    rms, largest, center = (v.detach().cpu() for v in (found.rms, found.largest, found.center))
    rms, largest, center = rms.reshape(-1, count)[0], largest.reshape(-1, count)[0], center.reshape(-1, count, 2)[0]
    half = 1.1 * float(largest.nan_to_num(0.0, 0.0, 0.0).max()) or 1.0
    shown = min(count, 8)
    figure, panels = subplots(1, shown, (2.2 * shown + 0.4, 2.6), sharey=True)
    for i, axes in enumerate(panels[0]):
        for j in range(len(x)):
            axes.plot(x[j, i].numpy(), y[j, i].numpy(), ".", ms=2, color=color_of(j))
        axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
        axes.set_title(f"field {i}", fontsize=9)
    table: list[Any] = [("field", "centre x", "centre y", "RMS", "largest", "rays lost")]
    for i in range(count):
        missing = f"{int(lost[:, i].sum())} of {lost[:, i].numel()}"
        table.append((str(i), *map(float, (*center[i].round(decimals=9), rms[i], largest[i])), missing))
    batch = x.shape != found.x.shape
    title = "Spot diagram, in the unit of the lens" + (", of the first system of a batch" if batch else "")
    return _show.View(title, [("spots of each field, a colour for each wavelength", png(figure, 80))], table)
