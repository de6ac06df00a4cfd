"""Pictures of a system: a section with rays, and spot diagrams."""

import math
from typing import Any

import torch
from PIL import Image, ImageDraw, ImageFont

from odak.learn.raytracing.system.launching import launch
from odak.learn.raytracing.system.lens import checked_system
from odak.learn.raytracing.system.pupils import pupil_samples
from odak.learn.raytracing.system.spots import Spots
from odak.learn.raytracing.system.tracing import trace

INK, FAINT, GLASS, PAPER = (20, 20, 20), (170, 170, 170), (222, 236, 247), (255, 255, 255)
COLOURS = ((33, 102, 172), (27, 120, 55), (178, 24, 43), (118, 42, 131), (179, 88, 6), (1, 102, 94))
WIDTH, MARGIN, CELL = 1400, 60, 220
# Drawn at twice the size and reduced: smooth lines.
OVER = 2


@torch.no_grad()
def draw_layout(system: Any, aim: str = "paraxial", count: int = 5) -> Image.Image:
    """Return a section through a system in the y–z plane, with rays of each field at the reference wavelength.

    Parameters
    ----------
    system : optical_system
        The system.
    aim : str
        As in :func:`odak.learn.raytracing.system.launch`.
    count : int
        Rays per field.

    Returns
    -------
    PIL.Image.Image
        RGB; z runs to the right, y up. Rays that are lost end where they were last. Shifts and tilts are not drawn.
    """
    places = _vertices(checked_system(system))
    rays = launch(system, pupil_samples("y", count), aim=aim)
    path = _polylines(system, rays, places)
    heights = _heights(system, path)
    outlines = [_profile(item, places[i], heights[i]) for i, item in enumerate(system.surfaces)]
    screen = _profile(system.image, places[-1], _screen_height(system, path))
    points = [point for outline in [*outlines, screen] for point in outline]
    points += [point for line, _ in path for point in line if math.isfinite(point[1])]
    place, size = _frame(points)
    picture = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(picture)
    left = min(point[0] for point in points)
    draw.line([place((left, 0.0)), place((places[-1], 0.0))], fill=FAINT, width=OVER)
    for i, item in enumerate(system.surfaces[:-1]):
        if item.material != "air" and not item.reflects:
            shape = outlines[i] + outlines[i + 1][::-1]
            draw.polygon([place(point) for point in shape], fill=GLASS, outline=FAINT)
    for line, colour in path:
        _line(draw, [place(point) for point in line if math.isfinite(point[1])], COLOURS[colour % len(COLOURS)])
    for i, item in enumerate(system.surfaces):
        bare = item.stop and not item.reflects and _is_air(system, i)
        _line(draw, [place(point) for point in outlines[i]], FAINT if bare else INK)
        if i == system.stop:
            for side in (1, -1):
                edge = [place((places[i], side * heights[i] * share)) for share in (1.0, 1.3)]
                draw.line(edge, fill=INK, width=3 * OVER)
    draw.line([place(point) for point in screen], fill=INK, width=2 * OVER)
    _title(draw, system)
    return picture.resize((size[0] // OVER, size[1] // OVER), Image.Resampling.LANCZOS)


@torch.no_grad()
def draw_spots(system: Any, found: Spots) -> Image.Image:
    """Return spot diagrams, a column for each field and a colour for each wavelength, all to one scale.

    Parameters
    ----------
    system : optical_system
        The system.
    found : Spots
        From :func:`odak.learn.raytracing.system.spot_diagram`, of one system.

    Returns
    -------
    PIL.Image.Image
        RGB.
    """
    if not isinstance(found, Spots):
        raise TypeError(f"found must be Spots, got {type(found).__name__}")
    cell, count = CELL * OVER, len(checked_system(system).fields)
    picture = Image.new("RGB", (count * cell + MARGIN, cell + 2 * MARGIN), PAPER)
    draw = ImageDraw.Draw(picture)
    finite = [value for value in found.largest.tolist() if math.isfinite(value)]
    half = max(finite, default=1.0) * 1.05 or 1.0
    font = ImageFont.load_default(13 * OVER)
    for i, field in enumerate(system.fields):
        left, top = MARGIN // 2 + i * cell, MARGIN
        draw.rectangle((left, top, left + cell - 8, top + cell - 8), outline=FAINT, width=OVER)
        middle = (left + (cell - 8) / 2, top + (cell - 8) / 2)
        for j in range(found.x.shape[0]):
            colour = COLOURS[j % len(COLOURS)]
            for x, y in zip(found.x[j, i].tolist(), found.y[j, i].tolist(), strict=True):
                if math.isfinite(x):
                    px, py = middle[0] + x / half * (cell - 24) / 2, middle[1] - y / half * (cell - 24) / 2
                    draw.ellipse((px - OVER, py - OVER, px + OVER, py + OVER), fill=colour)
        name = ", ".join(f"{value:g}" for value in field) + (" deg" if system.at_infinity else f" {system.unit}")
        draw.text((left, top - 17 * OVER), f"field {name}", fill=INK, font=font)
        draw.text((left, top + cell - 4), f"RMS {float(found.rms[i]):.3g} {system.unit}", fill=INK, font=font)
    draw.text((MARGIN // 2, 2), f"{system.name}: boxes {2 * half:.3g} {system.unit} wide", fill=INK, font=font)
    return picture.resize((picture.width // OVER, picture.height // OVER), Image.Resampling.LANCZOS)


def _vertices(system) -> list[float]:
    """Return where the vertices and the image plane stand along z."""
    places = [0.0]
    for item in system.surfaces:
        places.append(places[-1] + float(item.thickness))
    return places


def _polylines(system, rays, places) -> list[tuple[list, int]]:
    """Return the way of each ray as points (z, y), and the number of its field."""
    ahead = 0.25 * max(abs(value) for value in places) or 1.0
    start = (rays.y - ahead * rays.v / rays.w, torch.full_like(rays.y, -ahead))
    if not system.at_infinity and system.object_distance < 4 * ahead:
        start = (rays.y, rays.z)
    stations = [start]
    place = slice(system.reference, system.reference + 1)
    for i in [*range(len(system.surfaces)), None]:
        traced = trace(system, rays, until=i)
        height, depth = traced.y[place], traced.z[place] + places[len(system.surfaces) if i is None else i]
        stations.append((height, depth))
    lines = []
    for f in range(rays.x.shape[-2]):
        for p in range(rays.x.shape[-1]):
            points = [(float(z[0, f, p]), float(y[0, f, p])) for y, z in stations]
            # A lost ray is drawn as far as it got.
            lines.append((points, f))
    return lines


def _heights(system, path) -> list[float]:
    """Return how far from the axis each surface is drawn."""
    heights = []
    for i, item in enumerate(system.surfaces):
        met = [abs(line[i + 1][1]) for line, _ in path if math.isfinite(line[i + 1][1])]
        heights.append(item.semi_diameter or 1.05 * max(met, default=1.0) or 1.0)
    # The two faces of a lens share an edge.
    for i, item in enumerate(system.surfaces[:-1]):
        free = item.semi_diameter is None and system.surfaces[i + 1].semi_diameter is None
        if free and item.material != "air" and not item.reflects:
            heights[i] = heights[i + 1] = max(heights[i], heights[i + 1])
    return heights


def _screen_height(system, path) -> float:
    """Return how far from the axis the image is drawn."""
    if system.image is not None and system.image.semi_diameter is not None:
        return system.image.semi_diameter
    return max([abs(line[-1][1]) for line, _ in path if math.isfinite(line[-1][1])], default=1.0) * 1.1


def _profile(item, place: float, height: float) -> list[tuple[float, float]]:
    """Return a surface's section as points (z, y), a plane's without a surface."""
    if item is None:
        return [(place, -height), (place, height)]
    points = []
    for step in range(-40, 41):
        y = height * step / 40
        inside = 1 - (1 + float(item.conic)) * float(item.curvature) ** 2 * y * y
        if inside <= 0:
            continue
        z = float(item.curvature) * y * y / (1 + math.sqrt(inside))
        z += sum(float(a) * y ** (2 * j) for j, a in enumerate(item.coefficients, start=1))
        points.append((place + z, y))
    return points


def _is_air(system, i: int) -> bool:
    return system.surfaces[i].material == "air" and (i == 0 or system.surfaces[i - 1].material == "air")


def _frame(points):
    """Return the map from (z, y) to pixels, and the picture's size."""
    low, high = (f(point[0] for point in points) for f in (min, max))
    top = max(abs(point[1]) for point in points) or 1.0
    scale = min((WIDTH - 2 * MARGIN) / (high - low or 1.0), 350 / top) * OVER
    size = (int((high - low) * scale) + 2 * MARGIN * OVER, int(2 * top * scale) + 2 * MARGIN * OVER)

    def place(point):
        return MARGIN * OVER + (point[0] - low) * scale, size[1] / 2 - point[1] * scale

    return place, size


def _line(draw, points, colour) -> None:
    if len(points) > 1:
        draw.line(points, fill=colour, width=OVER + 1, joint="curve")


def _title(draw, system) -> None:
    draw.text((MARGIN * OVER // 2, 10), system.name, fill=INK, font=ImageFont.load_default(16 * OVER))
