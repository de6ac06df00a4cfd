"""Views of displays for notebooks: a section as SVG, and the numbers. Touches what a display and its path state."""

import math
from typing import Any

from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from odak import _show
from odak._drawn import FAINT, INK, subplots, svg


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
    for wavelength, angle in _angles(display):
        table.append((f"largest angle at {1e9 * wavelength:.4g} nm", f"{math.degrees(angle):.4g}°"))
    for row in display.extents():
        at = f"{1e9 * row['wavelength']:.4g} nm"
        table.append((f"étendue at {at}", f"{row['etendue']:.4g} m²·sr"))
        if "eyebox" in row:
            table.append((f"eyebox at {at}", " × ".join(f"{1e3 * side:.4g}" for side in row["eyebox"]) + " mm"))
            table.append(("field of view", " × ".join(f"{angle:.4g}°" for angle in row["field_of_view"])))
    for image in range(display.shape[0]):
        kind, place = display.path.place_in_words(image)
        table.append((f"{kind} {image}", place))
    drawing = svg(section(display))
    return _show.View(repr(display), [("section: panel, planes, and the light of a pixel", drawing)], table)


def _angles(display: Any) -> list[tuple[float, float]]:
    """Return each wavelength and the largest angle at which the pixels deflect it, in radians."""
    sines = [wave / (2 * max(display.path.pitches) * display.medium) for wave in display.wavelengths]
    return [(wave, math.asin(min(1.0, sine))) for wave, sine in zip(display.wavelengths, sines, strict=True)]


def section(display: Any) -> Figure:
    """Return a drawing of a panel, planes and cones of light, lengths along the axis and across it to scales apart."""
    height, distances = display.modulator.resolution[0] * display.path.pitches[0], display.distances
    near, far = min(0.0, *distances), max(0.0, *distances)
    figure, ((axes,),) = subplots(1, 1, (6.4, 2.4))
    for wavelength, angle in _angles(display):
        # Visible light from violet to red.
        hue = max(0.0, min(270.0, 270 * (700e-9 - wavelength) / 300e-9)) / 360
        for end in (near, far):
            reach = min(math.tan(angle) * abs(end) if angle < 1.5 else height, 1.3 * height)
            stop = end if reach < 1.3 * height else math.copysign(reach / math.tan(angle) if angle < 1.5 else 0.0, end)
            axes.fill([0, stop, stop], [0, reach, -reach], color=hsv_to_rgb((hue, 0.95, 0.95)), alpha=0.2, lw=0)
    for place, colour, width in (*((distance, FAINT, 2) for distance in distances), (0.0, INK, 4)):
        axes.plot([place, place], [-height / 2, height / 2], color=colour, lw=width)
    for axis, name in ((axes.xaxis, "distance"), (axes.yaxis, "height")):
        axis.set_major_formatter(EngFormatter("m"))
        axis.set_label_text(name)
    return figure
