"""Draw the figures of the course that are not the result of a computation, as SVG.

    PYTHONPATH=. python docs/make_drawings.py

Each function below draws one figure of docs/course/drawings/; its title is the alternative text. The eye is to scale:
its surfaces and rays come from `navarro_eye`. test/docs/test_drawings.py checks that the files agree with this script
and that no two labels overlap.
"""

import math
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

FOLDER = Path(__file__).resolve().parent / "course" / "drawings"
INK, GREY, PALE = "#222222", "#777777", "#dfe7ec"
LIGHT, GLASS, SECOND, THIRD = "#c62828", "#cfe6f5", "#1565c0", "#2e7d32"
# Mean width of a letter over the size of its font, for the boxes of labels.
LETTER = 0.54


class Label(NamedTuple):
    """The box of a line of text: left, top, right, bottom, and the text."""

    left: float
    top: float
    right: float
    bottom: float
    text: str


class Drawing:
    """An SVG picture 640 units wide, with `labels`, the boxes of its lines of text."""

    def __init__(self, title: str, height: float, width: float = 640):
        self.title, self.width, self.height = title, width, height
        self.labels: list[Label] = []
        self._parts: list[str] = []

    def path(self, points, color=INK, width=1.6, fill="none", closed=False, dashed=False, arrow=False):
        """Draw straight lines through points."""
        data = "M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in points) + (" Z" if closed else "")
        self.curve(data, color, width, fill, dashed, arrow)

    def curve(self, data, color=INK, width=1.6, fill="none", dashed=False, arrow=False):
        """Draw a path given in the notation of SVG."""
        extra = ' stroke-dasharray="6 4"' * dashed + f' marker-end="url(#arrow-{color[1:]})"' * arrow
        self._parts.append(f'<path d="{data}" stroke="{color}" stroke-width="{width:g}" fill="{fill}"{extra}/>')

    def box(self, x, y, width, height, color=INK, fill="none", line=1.6):
        """Draw a rectangle with its corner at x, y."""
        self.path([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], color, line, fill, closed=True)

    def circle(self, x, y, radius, color=INK, fill="none", width=1.6):
        """Draw a circle."""
        self._parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" stroke="{color}" stroke-width="{width:g}" fill="{fill}"/>'
        )

    def lens(self, x, y, half, bulge=9.0):
        """Draw a thin lens, upright, about x, y."""
        data = f"M{x:.1f} {y - half:.1f} Q{x + 2 * bulge:.1f} {y:.1f} {x:.1f} {y + half:.1f} "
        self.curve(data + f"Q{x - 2 * bulge:.1f} {y:.1f} {x:.1f} {y - half:.1f} Z", SECOND, 1.4, GLASS)

    def text(self, x, y, words, anchor="middle", size=16.0, color=INK, bold=False):
        """Write lines of text; y is the base of the first."""
        for number, line in enumerate(words.split("\n")):
            base, width = y + 1.2 * size * number, LETTER * size * len(line)
            left = x - width * {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor]
            self.labels.append(Label(left, base - 0.75 * size, left + width, base + 0.2 * size, line))
            weight = ' font-weight="bold"' * bold
            self._parts.append(
                f'<text x="{x:.1f}" y="{base:.1f}" text-anchor="{anchor}" font-size="{size:g}" fill="{color}"{weight}>'
                f"{escape(line)}</text>"
            )

    def dimension(self, start, end, words, offset=(0.0, -7.0), anchor="middle"):
        """Draw a double arrow with its length's name."""
        middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
        self.path([middle, start], GREY, 1.2, arrow=True)
        self.path([middle, end], GREY, 1.2, arrow=True)
        self.text(middle[0] + offset[0], middle[1] + offset[1], words, anchor)

    def svg(self) -> str:
        """Return the picture as text."""
        arrows = "".join(
            f'<marker id="arrow-{color[1:]}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
            f'orient="auto-start-reverse"><path d="M0 1 L10 5 L0 9 Z" fill="{color}"/></marker>'
            for color in (INK, GREY, LIGHT, SECOND, THIRD)
        )
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:g} {self.height:g}" role="img" '
            f'width="{self.width:g}" height="{self.height:g}" font-family="Helvetica, Arial, sans-serif">\n'
            f"<title>{escape(self.title)}</title>\n<defs>{arrows}</defs>\n"
            f'<rect width="100%" height="100%" fill="#ffffff"/>\n' + "\n".join(self._parts) + "\n</svg>\n"
        )


def eye() -> Drawing:
    """The eye in a horizontal section, to scale, with rays traced to the fovea."""
    from odak.learn.raytracing.system import launch, navarro_eye, ray_paths

    drawing = Drawing(
        "Horizontal section of an eye, to scale: parallel rays pass the cornea, the pupil and the lens and meet on the "
        "fovea; the optic nerve leaves the retina beside it.",
        height=475,
    )
    scale, left, axis = 17.0, 95.0, 222.0

    def at(z, r):
        return left + scale * z, axis - scale * r

    def conic(vertex, radius, k, r):
        return vertex + r * r / (radius * (1 + math.sqrt(1 - (1 + k) * (r / radius) ** 2)))

    def profile(vertex, radius, k, half):
        heights = [half * (2 * i / 40 - 1) for i in range(41)]
        return [at(conic(vertex, radius, k, r), r) for r in heights]

    # The model has no sclera: it is drawn 0.6 mm outside of the retina, and joins the cornea where that ends.
    centre, radius, half = 11.92, 12.0, 5.8
    outer, limbus = radius + 0.6, conic(0, 7.72, -0.26, half)
    for sign in (1, -1):
        (ax, ay), (bx, by), (cx, cy), (dx, dy) = (
            at(centre, sign * outer),
            at(7.2, sign * outer),
            at(3.9, sign * 9.4),
            at(limbus, sign * half),
        )
        drawing.curve(f"M{ax:.1f} {ay:.1f} C{bx:.1f} {by:.1f} {cx:.1f} {cy:.1f} {dx:.1f} {dy:.1f}", INK, 3)
    back = [math.radians(a) for a in range(-90, 91, 3)]
    drawing.path([at(centre + outer * math.cos(a), outer * math.sin(a)) for a in back], INK, 3)
    front = [math.radians(a) for a in range(-108, 109, 3)]
    drawing.path([at(centre + radius * math.cos(a), radius * math.sin(a)) for a in front], "#ef8a62", 4)
    drawing.path(profile(0.0, 7.72, -0.26, half), SECOND, 2.4)
    drawing.path(profile(0.55, 6.5, 0.0, 5.4), SECOND, 1.2)
    anterior, posterior = profile(3.6, 10.2, -3.1316, 4.2), profile(7.6, -6.0, -1.0, 4.2)
    drawing.path([*anterior, *posterior[::-1]], SECOND, 1.6, GLASS, closed=True)
    for sign in (1, -1):
        drawing.path([at(3.45, sign * 2.0), at(3.0, sign * 5.6)], "#6d4c41", 5)
        drawing.path([at(5.2, sign * 4.3), at(4.9, sign * 7.6)], GREY, 1)
        drawing.path([at(5.7, sign * 4.3), at(5.6, sign * 7.9)], GREY, 1)
    # The optic disc lies 15° from the fovea, seen from the nodal point 17 mm before the retina.
    for sign in (-1, 1):
        angle = -math.asin((17 * math.tan(math.radians(15)) + 0.8 * sign) / radius)
        start = (centre + outer * math.cos(angle), outer * math.sin(angle))
        drawing.path([at(*start), at(start[0] + 2.8, start[1] - 1.0)], INK, 3)
    fovea = at(centre + radius, 0)
    system = navarro_eye(pupil_diameter=3.4)
    for ray in ray_paths(system, launch(system, "y", 5))[0, 0].tolist():
        # Points 1 … 5 are the surfaces, the last is the retina; coordinates are x, y, z.
        points = [at(point[2], point[1]) for point in ray[1:]]
        drawing.path([(15, points[0][1]), *points], LIGHT, 1.1)
    drawing.circle(*fovea, 5, LIGHT, LIGHT)
    for words, place, anchor, tip in (
        ("cornea", (18, 95), "start", at(1.35, 4.4)),
        ("aqueous humour", (8, 380), "start", at(2.4, -3.2)),
        ("iris", (70, 35), "middle", at(3.1, 4.9)),
        ("lens", (300, 95), "middle", at(6.2, 3.2)),
        ("zonular fibres", (300, 372), "middle", at(5.65, -6.6)),
        ("retina", (560, 80), "start", at(centre + 8.8, 8.3)),
        ("fovea", (560, 205), "start", (fovea[0] + 7, fovea[1])),
        ("optic nerve\nblind spot", (540, 355), "start", at(25.3, -6.1)),
    ):
        first = place[1] - 5
        edge = place[0] + {"start": -3, "middle": 0, "end": 3}[anchor]
        if anchor == "middle" or place[0] < 100:
            edge, first = place[0] + 25 * (anchor == "start"), place[1] + (6 if tip[1] > place[1] else -17)
        drawing.path([(edge, first), tip], GREY, 1)
        drawing.text(*place, words, anchor)
    drawing.text(*at(13.8, 2.6), "vitreous body", "middle")
    drawing.dimension(at(0.0, -13.0), at(5.0, -13.0), "5 mm", (0, 20))
    return drawing


def retina() -> Drawing:
    """The layers of the retina."""
    drawing = Drawing(
        "Layers of the retina. Light passes ganglion cells, amacrine, bipolar and horizontal cells before it reaches rods "
        "and cones, which stand on the pigment epithelium; signals go the other way and leave along the optic nerve.",
        height=470,
    )
    right = 430
    layers = (
        ("#fdf3e3", 60, 60, "fibres to the\noptic nerve"),
        ("#eaf3fb", 120, 62, "ganglion cells"),
        ("#ffffff", 182, 100, "amacrine, bipolar\nand horizontal cells"),
        ("#eef7ee", 282, 110, "photoreceptors:\nrods and cones"),
        ("#d7ccc8", 392, 40, "pigment epithelium"),
    )
    for fill, top, height, words in layers:
        drawing.box(20, top, right - 20, height, "none", fill)
        drawing.text(right + 15, top + height / 2 + (5 if "\n" not in words else -4), words, "start")
    columns = (70, 160, 250, 340)
    for x in columns[1::2]:
        drawing.path([(x, 140), (x, 92), (right - 5, 92)], SECOND, 2, arrow=True)
        drawing.path([(x, 160), (x, 195)], SECOND, 2)
        drawing.circle(x, 150, 13, SECOND, GLASS)
    for x in columns:
        drawing.path([(x, 205), (x, 284)], THIRD, 2)
        drawing.circle(x, 238, 11, THIRD, "#c8e6c9")
        ganglion = x if x in columns[1::2] else x + 90
        drawing.path([(x, 205), (ganglion, 195)], THIRD, 2)
    for x in (115, 295):
        drawing.path([(x - 40, 202), (x + 40, 202)], GREY, 1.4)
        drawing.circle(x, 212, 8, GREY, "#eeeeee")
        drawing.path([(x - 45, 278), (x + 45, 278)], GREY, 1.4)
        drawing.circle(x, 268, 8, GREY, "#eeeeee")
    kinds = (("#c62828", "L"), ("#9e9e9e", ""), ("#2e7d32", "M"), ("#9e9e9e", ""), ("#c62828", "L"), ("#9e9e9e", ""))
    kinds += (("#1565c0", "S"), ("#9e9e9e", ""))
    for number, (color, name) in enumerate(kinds):
        x = 70 + 270 / 7 * number
        bipolar = min(columns, key=lambda place: abs(place - x))
        drawing.path([(bipolar, 284), (x, 300), (x, 315)], color, 2)
        drawing.circle(x, 320, 8, color, "#ffffff")
        if name:
            drawing.path([(x - 8, 330), (x + 8, 330), (x + 2, 388), (x - 2, 388)], color, 1.6, color, closed=True)
        else:
            drawing.box(x - 4, 330, 8, 58, color, color)
    for x in range(30, right - 20, 40):
        drawing.circle(x + 14, 412, 7, "#4e342e", "#8d6e63")
    for x in (45, 205, 385):
        drawing.path([(x, 15), (x, 56)], LIGHT, 2, arrow=True)
    drawing.text(225, 35, "light", "start", color=LIGHT)
    drawing.path([(610, 405), (610, 65)], SECOND, 2, arrow=True)
    drawing.text(600, 40, "signals", "middle", color=SECOND)
    drawing.text(20, 457, "cones: L red, M green, S blue; rods grey. Not to scale.", "start", 15, GREY)
    return drawing


def slm_pixel() -> Drawing:
    """A cross-section of a phase modulator of liquid crystal on silicon."""
    drawing = Drawing(
        "Cross-section of a liquid crystal on silicon modulator: cover glass, transparent electrode, liquid crystal whose "
        "molecules rise with the voltage of each pixel mirror, and the silicon circuits beneath.",
        height=430,
    )
    left, width = 20, 430
    for fill, top, height, words in (
        ("#e3f2fd", 60, 50, "cover glass"),
        ("#b39ddb", 110, 14, "transparent electrode"),
        ("#fffde7", 124, 140, "liquid crystal,\na few µm thick"),
        ("#fffde7", 264, 20, "pixel mirrors"),
        ("#cfd8dc", 284, 60, "silicon with\nthe pixels' circuits"),
    ):
        drawing.box(left, top, width, height, GREY, fill, 0.8)
        place = top + height / 2 + (-4 if "\n" in words else 5)
        drawing.text(left + width + 10, place, words, "start", 15)
    pitch, gap = width / 3, 12
    for number, (tilt, voltage) in enumerate(((4, "0 V"), (42, "middle"), (82, "high"))):
        x = left + number * pitch
        drawing.box(x + gap / 2, 266, pitch - gap, 16, INK, "#90a4ae", 1)
        drawing.text(x + pitch / 2, 320, voltage)
        for row in range(4):
            for column in range(3):
                # Molecules next to the electrodes are held by the alignment layers.
                angle = math.radians(tilt * (0.35 if row in (0, 3) else 1.0) + 3)
                cx, cy = x + pitch * (column + 0.5) / 3, 143 + 34 * row
                dx, dy = 15 * math.cos(angle), 15 * math.sin(angle)
                drawing.path([(cx - dx, cy + dy), (cx + dx, cy - dy)], THIRD, 6)
        middle = x + pitch / 2
        drawing.path([(middle - 28, 12), (middle - 6, 56)], LIGHT, 2, arrow=True)
        drawing.path([(middle + 6, 56), (middle + 28, 12)], LIGHT, 2, arrow=True)
    drawing.text(left + width + 10, 38, "light in and out", "start", 15, LIGHT)
    drawing.dimension((left + gap / 2, 362), (left + pitch + gap / 2, 362), "pitch p", (0, 20))
    drawing.path([(left + 2 * pitch, 290), (left + 2 * pitch, 366)], GREY, 1)
    drawing.text(left + 2 * pitch, 383, "gap")
    drawing.text(left, 416, "A pixel's phase is 2π/λ · 2 ∫ n(z) dz. Not to scale.", "start", 15, GREY)
    return drawing


def etendue() -> Drawing:
    """Two eyepieces before one modulator."""
    drawing = Drawing(
        "One modulator with two eyepieces. A long focal length gives a wide eyebox and a narrow field of view, a short one a "
        "narrow eyebox and a wide field of view; their product is the same.",
        height=520,
    )
    half, slope = 36.0, 0.26
    for axis, focal, words in ((130, 200, "long focal length"), (390, 100, "short focal length")):
        x = 60.0
        lens, box = x + focal, x + 2 * focal
        reach = slope * focal
        drawing.box(x - 10, axis - half, 10, 2 * half, INK, "#90a4ae")
        for y, color in ((-half, LIGHT), (half, SECOND)):
            for sign in (-1, 1):
                edge = y + sign * reach
                # Behind the lens light of a point at y travels at the slope −y/f.
                end = box + 45
                drawing.path(
                    [(x, axis + y), (lens, axis + edge), (end, axis + edge - y / focal * (end - lens))], color, 1.3
                )
        drawing.lens(lens, axis, half + reach + 8)
        drawing.path([(box, axis - reach), (box, axis + reach)], INK, 4)
        drawing.path([(20, axis), (620, axis)], GREY, 0.8, dashed=True)
        drawing.text(x - 5, axis + half + 24, "modulator")
        drawing.text(lens, axis - half - reach - 16, f"eyepiece, {words}")
        drawing.text(box, axis + max(reach, half) + 30, "eyebox")
        drawing.dimension((x, axis + half + reach + 22), (lens, axis + half + reach + 22), "f", (0, 18))
        drawing.dimension((lens, axis + half + reach + 22), (box, axis + half + reach + 22), "f", (0, 18))
    drawing.text(360, 340, "half the focal length: half the\neyebox, twice the field of view", "start")
    drawing.text(360, 425, "eyebox = f λ/p\nfield of view ≈ Np/f\nproduct = Nλ", "start")
    return drawing


def holographic_displays() -> Drawing:
    """Three layouts of holographic displays."""
    drawing = Drawing(
        "Three layouts of holographic displays: on a bench, with a relay of two lenses and an iris in front of a camera; a "
        "projector, in which a lens forms the Fourier transform; and near the eye, with an eyepiece.",
        height=600,
    )
    for axis, words in (
        (115, "On a bench: relay with iris"),
        (315, "Projector: Fourier hologram"),
        (510, "Near the eye"),
    ):
        drawing.text(15, axis - 78, words, "start", 17, bold=True)
        drawing.path([(15, axis), (625, axis)], GREY, 0.8, dashed=True)

    def modulator(x, axis):
        drawing.box(x - 5, axis - 34, 10, 68, INK, "#90a4ae")
        drawing.text(x, axis + 56, "modulator")

    def beam(points, axis, color=LIGHT):
        for sign in (-1, 1):
            drawing.path([(x, axis + sign * y) for x, y in points], color, 1.3)

    axis = 115
    drawing.box(15, axis - 8, 40, 16, INK, "#ffcdd2")
    beam([(55, 1), (105, 25), (150, 25), (290, 25), (360, 1), (430, 25), (500, 25)], axis)
    drawing.lens(105, axis, 40)
    modulator(190, axis)
    for x in (290, 430):
        drawing.lens(x, axis, 40)
    for sign in (-1, 1):
        drawing.path([(360, axis + sign * 9), (360, axis + sign * 42)], INK, 4)
    drawing.path([(500, axis - 30), (500, axis + 30)], THIRD, 3)
    drawing.box(580, axis - 24, 42, 48, INK, "#eeeeee")
    drawing.lens(572, axis, 20, 5)
    for x, words in ((35, "laser"), (105, "collimator"), (360, "iris"), (500, "image"), (595, "camera")):
        drawing.text(x, axis + 58 if x != 35 else axis + 30, words)
    drawing.text(290, axis + 58, "lens", color=SECOND)
    drawing.text(430, axis + 58, "lens", color=SECOND)

    axis = 315
    drawing.box(15, axis - 8, 40, 16, INK, "#ffcdd2")
    beam([(55, 1), (105, 25), (250, 25)], axis)
    drawing.lens(105, axis, 40)
    modulator(190, axis)
    for shift, color in ((-40, THIRD), (40, SECOND)):
        for sign in (-1, 1):
            # A grating of the modulator sends a parallel beam to one point of the focal plane.
            drawing.path(
                [(195, axis + 25 * sign), (290, axis + 25 * sign + shift * 0.32), (570, axis + shift)], color, 1.3
            )
    drawing.lens(290, axis, 48)
    drawing.path([(570, axis - 52), (570, axis + 52)], INK, 4)
    drawing.circle(570, axis, 5, LIGHT, LIGHT)
    beam([(250, 25), (290, 25), (570, 0)], axis)
    drawing.text(35, axis + 30, "laser")
    drawing.text(105, axis + 58, "collimator")
    drawing.text(290, axis + 66, "lens", color=SECOND)
    drawing.text(620, axis + 72, "image in the focal plane", "end")
    drawing.path([(515, axis - 62), (563, axis - 6)], LIGHT, 1, arrow=True)
    drawing.text(510, axis - 66, "undiffracted light", color=LIGHT)

    axis = 510
    drawing.circle(35, axis, 4, LIGHT, LIGHT)
    beam([(35, 0), (105, 28), (190, 28), (300, 28), (488, 4), (601, -10)], axis)
    drawing.lens(105, axis, 40)
    modulator(190, axis)
    drawing.lens(300, axis, 44)
    drawing.path([(482, axis - 14), (482, axis + 14)], THIRD, 4)
    drawing.text(472, axis - 24, "eyebox", "end", color=THIRD)
    drawing.circle(545, axis, 58, INK)
    drawing.lens(502, axis, 22, 7)
    drawing.text(38, axis + 30, "source")
    drawing.text(105, axis + 58, "collimator")
    drawing.text(300, axis + 66, "eyepiece", color=SECOND)
    drawing.text(545, axis + 80, "eye")
    return drawing


def fourier_4f() -> Drawing:
    """A 4f system with a filter."""
    drawing = Drawing(
        "A 4f system: object, lens, filter, lens and image, each one focal length from the next. Light of one point is "
        "parallel between the lenses; light of one direction meets at one point of the filter.",
        height=330,
    )
    axis, start, focal = 140, 45, 137.5
    first, filter_plane, second, image = (start + focal * k for k in (1, 2, 3, 4))
    drawing.path([(20, axis), (620, axis)], GREY, 0.8, dashed=True)
    # Rays at heights y and slopes s of the object: y + s·f at the lens, s·f in the filter, −y in the image.
    height = 45
    for y, color in ((-height, LIGHT), (height, SECOND)):
        for slope in (-0.22, 0.0, 0.22):
            at_lens, at_filter = y + slope * focal, slope * focal
            points = ((start, y), (first, at_lens), (filter_plane, at_filter), (second, at_filter - y), (image, -y))
            drawing.path([(x, axis + h) for x, h in points], color, 1.2)
    for x in (first, second):
        drawing.lens(x, axis, 92)
    drawing.path([(start, axis - 60), (start, axis + 60)], INK, 3)
    drawing.path([(image, axis - 60), (image, axis + 60)], INK, 3)
    for sign in (-1, 1):
        drawing.path([(filter_plane, axis + sign * 40), (filter_plane, axis + sign * 80)], INK, 5)
    for x, words in ((start, "object\nu(x)"), (first, "lens"), (filter_plane, "filter\nU(ν)·H(ν)"), (second, "lens")):
        drawing.text(x, axis + 115, words)
    drawing.text(image, axis + 115, "image\n(u∗h)(−x)")
    for k in range(4):
        drawing.dimension((start + focal * k, 300), (start + focal * (k + 1), 300), "f", (0, 20))
    drawing.text(filter_plane, 24, "ν = x′/(λf)", size=15, color=GREY)
    return drawing


DRAWINGS = (eye, retina, slm_pixel, etendue, holographic_displays, fourier_4f)


def main() -> None:
    """Write all drawings."""
    FOLDER.mkdir(exist_ok=True)
    for draw in DRAWINGS:
        (FOLDER / f"{draw.__name__}.svg").write_text(draw().svg(), encoding="utf-8")


if __name__ == "__main__":
    main()
