"""Figures of analyses: through focus, wavefronts, distortion, illumination, footprints, polarisation, tolerances."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from odak import _validate
from odak.catalog.materials import MICROMETRES
from odak.learn.raytracing.system.analysis import (
    axial_color,
    distortion_grid,
    footprint,
    spot_diagram,
    through_focus,
    wavefront,
)
from odak.learn.raytracing.system.drawing import (
    FAINT,
    INK,
    color_of,
    field_label,
    focus_unit,
    image_aperture,
    image_unit,
    unit_of,
)
from odak.learn.raytracing.system.huygens import relative_illumination, through_focus_modulation
from odak.learn.raytracing.system.optimise import Sensitivity, ToleranceResult
from odak.learn.raytracing.system.paraxial import seidel_sums
from odak.learn.raytracing.system.polarisation import polarized_trace
from odak.learn.raytracing.system.pupils import AIMS, launch, trace_fields
from odak.learn.raytracing.system.surfaces import checked_system, is_break
from odak.learn.raytracing.system.waves import point_spread_function

# Wavefronts with a larger root mean square than this many waves have no diffraction image that is worth drawing.
LARGE = 2.0


def _panels(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


@torch.no_grad()
def through_focus_figure(
    system: Any, shifts: Any = None, frequency: float | None = None, aim: str = "paraxial"
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
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
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
    for axis, style in (("y", "-"), ("x", "--")):
        transfer = (
            through_focus_modulation(system, shifts, frequency, axis, 24, aim=aim)[system.reference].cpu().numpy()
        )
        for i in range(fields):
            lower.plot(place, transfer[i], style, color=color_of(i), lw=1.2)
    lower.set(ylim=(0, 1), xlabel=f"focus ({unit})", ylabel=f"modulation\nat {frequency * 1e3 / scale:.3g} cycles/mm")
    return figure


@torch.no_grad()
def wavefront_figure(system: Any, samples: int = 64, aim: str = "paraxial") -> Figure:
    """Return maps of the wavefront over the pupil, and the diffraction images, at the reference wavelength.

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
        A column for each field: path differences in wavelengths, and below the amplitude (square root of the
        intensity) of the image. Images are left out if a wavefront has more than two waves RMS.

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
    line = torch.linspace(-1, 1, samples + 1, dtype=torch.float64)
    y, x = torch.meshgrid(line, line, indexing="ij")
    inside = x * x + y * y <= 1 + 1e-9
    points = torch.stack([x[inside], y[inside]], -1)
    found = wavefront(system, points, prescription=numbers, aim=aim)
    small = float(found.rms.nan_to_num(nan=9.0).max()) <= LARGE
    figure, panels = _panels(1 + small, fields, (2.9 * fields + 0.6, 2.9 * (1 + small) + 0.2))
    for i, axes in enumerate(panels[0]):
        grid = torch.full_like(x, torch.nan)
        grid[inside] = found.path[0, i].cpu()
        span = float(grid.abs().nan_to_num().max()) or 1.0
        shown = axes.imshow(grid.numpy(), origin="lower", extent=(-1, 1, -1, 1), cmap="RdBu_r", vmin=-span, vmax=span)
        axes.set_title(f"field {field_label(system, i)}\nRMS {float(found.rms[0, i]):.3g} λ", fontsize=9)
        axes.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1])
        figure.colorbar(shown, ax=axes, shrink=0.8, label="path (λ)" if i == fields - 1 else None)
    panels[0, 0].set_ylabel("pupil y", fontsize=9)
    if not small:
        return figure
    spread = point_spread_function(system, samples, 8 * samples, prescription=numbers, aim=aim)
    half = 2 * samples
    for i, axes in enumerate(panels[1]):
        middle = spread.intensity[0, i, half:-half, half:-half]
        rows, columns = (float(v) * MICROMETRES[system.unit] * half for v in spread.pitch[0, i])
        extent = (-columns, columns, -rows, rows)
        shown = axes.imshow(middle.sqrt().cpu().numpy(), origin="lower", extent=extent, cmap="magma", vmin=0)
        axes.set_title(f"Strehl ratio {float(spread.strehl[0, i]):.2f}", fontsize=9)
        axes.set_xlabel(f"x ({image_unit(system)})", fontsize=9)
        figure.colorbar(shown, ax=axes, shrink=0.8, label="amplitude" if i == fields - 1 else None)
    panels[1, 0].set_ylabel(f"y ({image_unit(system)})", fontsize=9)
    return figure


@torch.no_grad()
def image_figure(system: Any, points: int = 11, aim: str = "paraxial") -> Figure:
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
        The ideal grid is grey, the real one blue. The illuminance is that of a uniform Lambertian object relative to
        the axis; dashed, the share of the rays through the pupil that apertures let pass. The last panel is left out
        with a single wavelength.

    Examples
    --------
    >>> from odak.learn.raytracing.system import image_figure, load_system
    >>> len(image_figure(load_system("cooke_triplet"), 5).axes)
    3
    """
    checked_system(system)
    points, aim = _validate.integer("points", points, minimum=2), _validate.one_of("aim", aim, AIMS)
    ideal, real = (value.cpu().numpy() for value in distortion_grid(system, points, aim=aim))
    low, high = min(system.wavelengths), max(system.wavelengths)
    figure, panels = _panels(1, 3 if low < high else 2, (10 if low < high else 6.8, 3.4))
    first, second = panels[0, :2]
    for grid, color in ((ideal, FAINT), (real, color_of(0))):
        for lines in (grid, grid.swapaxes(0, 1)):
            first.plot(lines[..., 0].T, lines[..., 1].T, color=color, lw=0.8)
    name = "milliradian" if system.afocal else unit_of(system)
    scale = 1e3 / (1e6 / MICROMETRES[system.unit]) if system.afocal else 1.0
    first.set(aspect="equal", xlabel=f"x ({name})", ylabel=f"y ({name})")
    first.xaxis.set_major_formatter(lambda value, _: f"{value * scale:g}")
    first.yaxis.set_major_formatter(lambda value, _: f"{value * scale:g}")
    first.set_title("distortion", fontsize=9)
    largest = max(math.hypot(*field) for field in system.fields)
    heights = torch.linspace(0, largest, points, dtype=torch.float64)
    fields = torch.stack([0 * heights, heights], -1)
    numbers = system.prescription().at(system.reference)
    light = relative_illumination(system, 8, prescription=numbers, fields=fields, aim=aim)[0]
    passed = trace_fields(system, "rings", 16, prescription=numbers, fields=fields, aim=aim).arrived[0]
    second.plot(heights.numpy(), light.cpu().numpy(), color=INK, label="illuminance")
    second.plot(
        heights.numpy(), passed.double().mean(-1).cpu().numpy(), color=color_of(2), ls="--", label="rays passed"
    )
    field = "field (°)" if system.at_infinity else f"object height ({unit_of(system)})"
    second.set(ylim=(0, 1.05), xlabel=field)
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


@torch.no_grad()
def footprint_figure(system: Any, places: Any = None, aim: str = "paraxial") -> Figure:
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
    figure, panels = _panels(1, max(len(places), 1), (3.0 * max(len(places), 1) + 1.0, 3.2))
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
def polarisation_figure(system: Any, samples: int = 24, aim: str = "paraxial") -> Figure:
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
    line = torch.linspace(-1, 1, samples + 1, dtype=torch.float64)
    y, x = torch.meshgrid(line, line, indexing="ij")
    inside = x * x + y * y <= 1 + 1e-9
    points = torch.stack([x[inside], y[inside]], -1)
    numbers, fields = system.prescription().at(system.reference), len(system.fields)
    found = polarized_trace(system, launch(system, points, prescription=numbers, aim=aim), prescription=numbers)
    figure, panels = _panels(2, fields, (2.9 * fields + 0.6, 5.6))
    maps = (found.diattenuation, "diattenuation"), (found.retardance, "retardance (rad)")
    for row, (values, name) in enumerate(maps):
        top = float(values.nan_to_num().max()) or 1.0
        for i in range(fields):
            axes, grid = panels[row, i], torch.full_like(x, torch.nan)
            grid[inside] = values[0, i].cpu()
            shown = axes.imshow(grid.numpy(), origin="lower", extent=(-1, 1, -1, 1), cmap="viridis", vmin=0, vmax=top)
            axes.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1])
            figure.colorbar(shown, ax=axes, shrink=0.8, label=name if i == fields - 1 else None)
        panels[row, 0].set_ylabel("pupil y", fontsize=9)
    for i in range(fields):
        kept = found.traced.arrived[0, i]
        mean = float(found.transmittance[0, i][kept].mean()) if bool(kept.any()) else 0.0
        panels[0, i].set_title(f"field {field_label(system, i)}\ntransmittance {mean:.3f}", fontsize=9)
    return figure


@torch.no_grad()
def seidel_figure(system: Any) -> Figure:
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
    figure, panels = _panels(1, 1, (min(3 + 0.7 * count, 14), 3.2))
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
def tolerance_figure(system: Any, found: Any, limit: float | None = None) -> Figure:
    """Return the yield of a tolerance analysis, or the changes by each deviation alone.

    Parameters
    ----------
    system : optical_system
        The system.
    found : ToleranceResult or Sensitivity
        From :func:`tolerance`: the share of the systems whose merits are below a value, for each field and for all
        of them. From :func:`sensitivity`: bars of the root mean square of the merits over that as drawn. Merits are
        taken to be lengths, as those of :func:`rms_spot`.
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
        figure, panels = _panels(1, 1, (7.5, 1.2 + 0.22 * len(found.names)))
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
    if not isinstance(found, ToleranceResult):
        raise TypeError(f"found must be a ToleranceResult or a Sensitivity, got {type(found).__name__}")
    merit = (found.merit * scale).reshape(len(found.merit), -1).cpu()
    figure, panels = _panels(1, 1, (5.2, 3.4))
    axes, share = panels[0, 0], np.arange(1, len(merit) + 1) / len(merit)
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
