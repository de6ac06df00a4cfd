"""Views of displays for notebooks: a section as SVG, and the numbers. Touches what a display and its path state."""

import math
from collections.abc import Sequence
from typing import Any

from odak import _show


def view_of(display: Any) -> _show.View:
    """Return what notebooks show of a display: a section with the light of a pixel in each colour, and its numbers."""
    panel = display.modulator
    pair, (rows, columns) = display.path.pitches, panel.resolution
    size = f"{1e3 * rows * pair[0]:.4g} mm × {1e3 * columns * pair[1]:.4g} mm"
    table: list = [
        ("property", "value"),
        ("pixels, rows × columns", f"{rows} × {columns}"),
        ("pitch", " × ".join(f"{1e6 * p:.4g}" for p in dict.fromkeys(pair)) + " µm"),
        ("size of panel and images", size),
        ("share of a pixel that emits", f"{panel.fill:g}"),
        ("levels", "any" if panel.bits is None else str(2**panel.bits)),
        ("frames", str(display.frames)),
        ("stop", "one diffraction order" if display.iris == "order" else repr(display.iris)),
        ("refractive index", f"{display.medium:g}"),
    ]
    angles = []
    for wavelength in display.wavelengths:
        sine = wavelength / (2 * max(pair) * display.medium)
        angles.append(math.asin(min(1.0, sine)))
        table.append((f"largest angle at {1e9 * wavelength:.4g} nm", f"{math.degrees(angles[-1]):.4g}°"))
    for row in display.extents():
        at = f"{1e9 * row['wavelength']:.4g} nm"
        table.append((f"étendue at {at}", f"{row['etendue']:.4g} m²·sr"))
        if "eyebox" in row:
            table.append((f"eyebox at {at}", " × ".join(f"{1e3 * side:.4g}" for side in row["eyebox"]) + " mm"))
            table.append(("field of view", " × ".join(f"{angle:.4g}°" for angle in row["field_of_view"])))
    for image in range(display.shape[0]):
        kind, place = display.path.place_in_words(image)
        table.append((f"{kind} {image}", place))
    drawing = section(rows * pair[0], display.distances, list(zip(display.wavelengths, angles, strict=True)))
    return _show.View(repr(display), [("section: panel, planes, and the light of a pixel", drawing)], table)


def section(height: float, distances: Sequence[float], colours: list[tuple[float, float]]) -> str:
    """Return a drawing of a panel, planes and cones of light, lengths along the axis and across it to scales apart."""
    near, far = min(0.0, *distances), max(0.0, *distances)
    length = far - near or 1.0

    def at(z: float, y: float) -> str:
        return f"{40 + 560 * (z - near) / length:.1f},{110 - 80 * y / height:.1f}"

    def line(z: float, colour: str, width: float) -> str:
        return f'<polyline points="{at(z, -height / 2)} {at(z, height / 2)}" stroke="{colour}" stroke-width="{width}"/>'

    parts = []
    for wavelength, angle in colours:
        # Visible light from violet to red.
        hue = max(0.0, min(270.0, 270 * (700e-9 - wavelength) / 300e-9))
        for end in (near, far):
            reach = min(math.tan(angle) * abs(end) if angle < 1.5 else height, 1.3 * height)
            stop = end if reach < 1.3 * height else math.copysign(reach / math.tan(angle) if angle < 1.5 else 0.0, end)
            points = f"{at(0, 0)} {at(stop, reach)} {at(stop, -reach)}"
            parts.append(f'<polygon points="{points}" fill="hsl({hue:.0f},90%,50%)" fill-opacity="0.2"/>')
    parts += [line(distance, "#9a9a9a", 2) for distance in distances] + [line(0.0, "#202020", 5)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 640 220" width="640" fill="none">{"".join(parts)}</svg>'
    )
