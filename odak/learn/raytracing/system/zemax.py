"""Sequential Zemax files, read and written."""

import dataclasses
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from odak.catalog.materials import MICROMETRES, OpticalMaterial, glass_makers, material, model_glass, nearest_materials
from odak.learn.raytracing.system.operands import clear_heights
from odak.learn.raytracing.system.paraxial import first_order, matrix, signed_indices
from odak.learn.raytracing.system.pupils import trace_fields
from odak.learn.raytracing.system.specification import AIR, MIRROR, SETTINGS
from odak.learn.raytracing.system.surfaces import (
    coordinate_break,
    is_break,
    optical_system,
    surface,
    without_derivatives,
)
from odak.learn.raytracing.system.system_files import (
    FACTORS,
    FAR,
    Command,
    LensFile,
    ZmxReport,
    aperture_of_working,
    differing,
    image_of,
    lens_text,
    model_numbers,
    named_errors,
    own_surfaces,
    own_tilt,
    pairs,
    plain,
)
from odak.learn.raytracing.system.zooms import configurations
from odak.raytracing.apertures import Aperture, CircularAperture, EllipticAperture, RectangularAperture
from odak.raytracing.gradients import AxialGradient, Gradient, RadialGradient
from odak.raytracing.interfaces import IdealLens, LinearGrating, Phase, PolynomialPhase, RadialPhase
from odak.raytracing.surfaces import (
    Biconic,
    Conic,
    EvenAsphere,
    OddAsphere,
    PolynomialFreeform,
    QbfsAsphere,
    QconAsphere,
    Shape,
    Toroid,
    ZernikeFreeform,
)
from odak.tools.paths import _text, write_file
from odak.tools.zernike import fringe_to_nm, noll_to_nm, zernike_norm

MAXIMUM_SURFACES, MAXIMUM_TERMS = 1000, 500


class Line(Command):
    """A line: its number, its first word, and the rest as words; its numbers may be infinite."""

    @staticmethod
    def converted(word: str) -> float:
        """Return the number that a word stands for, NaN where there is none."""
        if word.upper() in ("INFINITY", "-INFINITY"):
            return float(word)
        try:
            # Programs of some countries write a decimal comma, Fortran an exponent D.
            # Blanks of other alphabets behind a number may stand as question marks.
            return float(re.sub(r"(?<=\d)[dD](?=[+-]?\d)", "e", word.rstrip("?").replace(",", ".", 1)))
        except ValueError:
            return math.nan

    @property
    def automatic(self) -> bool:
        """Whether it is a semi-diameter that its program has from the rays, and that states nothing."""
        return self.key == "DIAM" and list(self.words[1:2]) == ["0"]

    def whole(self, place: int = 0) -> int:
        """Return one of the words as an integer."""
        found = self.value(place)
        if found != int(found) if abs(found) < 1e9 else True:
            raise ValueError(f"line {self.number}: {self.key} must have a whole number, got {self.words[place]!r}")
        return int(found)

    def counts(self, number: int) -> bool:
        """Return whether the first of the words is this whole number."""
        try:
            return self.whole() == number
        except ValueError:
            return False


def read_lines(path) -> tuple[list[Line], list[list[Line]]]:
    """Return the lines that concern the whole system, and the lines of each surface.

    Parameters
    ----------
    path : str or pathlib.Path
        UTF-16 with its mark, UTF-8 with or without, or Latin-1.

    Raises
    ------
    ValueError
        If the file is too large, holds no surfaces, or its surfaces are not numbered 0, 1, 2, … (or from 1, without
        the object).
    """
    path = Path(path)
    general: list[Line] = []
    surfaces: list[list[Line]] = []
    for number, text in enumerate(lens_text(path).splitlines(), start=1):
        words = text.split()
        if not words:
            continue
        line = Line(number, words[0].upper(), words[1:])
        if line.key == "SURF":
            if not surfaces and line.counts(1):
                # Some programs leave out the object.
                surfaces.append([])
            if not line.counts(len(surfaces)) or len(surfaces) >= MAXIMUM_SURFACES:
                accepted = f"SURF must count 0, 1, 2, … below {MAXIMUM_SURFACES}"
                raise ValueError(f"{path.name}, line {number}: {accepted}, got {text.strip()[:80]!r}")
            surfaces.append([])
        # What belongs to a surface is indented, though not in all files.
        elif surfaces and (text[0] in " \t" or line.key in _SURFACE_KEYS | _INERT_KEYS):
            surfaces[-1].append(line)
        else:
            general.append(line)
    if len(surfaces) < 3:
        raise ValueError(
            f"{path.name}: must contain an object, at least one surface and an image, got {len(surfaces)} SURF"
        )
    return general, surfaces


LENGTHS = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "INCH": 25.4, "METER": 1000.0, "M": 1000.0}
# Keys that are understood, of the whole system and of surfaces.
_GENERAL = (
    "VERS MODE NAME NOTE UNIT GCAT WAVM WAVL WWGT PWAV FTYP XFLN YFLN XFLD YFLD ENPD FNUM OBNA FLOA AUTH IWDP STUD "
    "LANG FWGN FWGT"
)
_GENERAL_KEYS = frozenset(re.findall(r"\w+", _GENERAL)) | set(FACTORS)
_OF_SURFACES = (
    "COMM HIDE MIRR SLAB POPS SSID TYPE CURV CONI PARM XDAT DISZ GLAS STOP CLAP FLAP OBSC OBDC SQAP SQOB ELAP"
)
_SURFACE_KEYS = frozenset(re.findall(r"\w+", _OF_SURFACES)) | {"ELOB"}
# Operands of configurations, and among them the operands without effect on rays.
_IDLE_OPERANDS = frozenset(("MOFF", "LTTL", "NCOM", "MNUM"))
_OF_CONFIGURATIONS = "THIC CRVT CURV CONN SDIA APER GLSS XFIE YFIE WAVE PRAM TEMP PRES IGNR WLWT FLWT"
_OPERANDS = _IDLE_OPERANDS | frozenset(_OF_CONFIGURATIONS.split())
# Numbers of surfaces among them: the setting, the key of the surface's own number, and the power of the unit.
_NUMBERS = {
    "THIC": ("thickness", "DISZ", 1),
    "CRVT": ("curvature", "CURV", -1),
    "CURV": ("curvature", "CURV", -1),
    "CONN": ("conic", "CONI", 0),
}
# Temperature in degrees Celsius and pressure in atmospheres: values where there is none, and the unit of ours.
WEATHER = {"TEMP": (20.0, 1.0), "PRES": (1.0, 101325.0)}
# Keys of surfaces without effect on rays.
_INERT_KEYS = frozenset(
    ("DIAM", "MEMA", "OEMA", "FIMP", "COAT", "VDSZ", "VPAR", "PPAR", "UDAP", "UDOB", "UDAD", "SPID")
)
# Values in files for an index and an Abbe number that were not entered.
_PLACEHOLDER = (1.5, 40.0)
# Thickness in millimetres up to which a layer is one of cement.
THIN = 0.1


def read_zmx(
    path: str | os.PathLike[str], glasses: Mapping[Any, Any] | None = None
) -> tuple[optical_system, ZmxReport]:
    """Read a sequential Zemax file.

    Parameters
    ----------
    path : str or pathlib.Path
        Text file, UTF-16 or UTF-8, up to 4 MiB.
    glasses : mapping, optional
        Stand-ins for glasses by their names in the file: names of the catalogue, indices or Materials.

    Returns
    -------
    tuple
        The system in millimetres, and a :class:`ZmxReport` of all that was not used.

    Raises
    ------
    ValueError
        If the file is malformed, or holds what would change the paths of rays and is not understood: a surface type
        that is not among STANDARD, EVENASPH, ODDASPHE, XASPHERE, XOSPHERE, TOROIDAL, BICONICX, TILTSURF, XPOLYNOM,
        QED_TYPE, SZERNSAG, FZERNSAG, IRREGULA, COORDBRK, DGRATING, BINARY_1, BINARY_2, PARAXIAL and GRINSUR1 to
        GRINSUR3, a glass that neither the catalogue knows (the message names the nearest known ones) nor the file
        describes.

    Notes
    -----
    Semi-diameters (DIAM) limit rays only where the file says so, by a circular (CLAP) or floating (FLAP) aperture. A
    glass is looked up in the catalogues that the file names (GCAT) before all others. An unknown one is a model glass
    where the file states its index and Abbe number, or where its name is their six-digit code; a former glass, such as
    SK5, is replaced by its successor N-SK5. A model glass without an Abbe number has no dispersion, one of index −1 is
    a mirror. A file without an aperture gets the stop that the narrowest semi-diameter leaves to the axial bundle, or,
    without semi-diameters, an entrance pupil of a tenth of the focal length. Surfaces may be numbered from 1, without
    the object. The report names each of these. Image heights as fields become object angles or heights: paraxially, or
    by tracing chief rays through the centre of the stop (of the paraxial pupil where the file does not aim rays); a
    height that none of them reaches becomes the farthest field from which they arrive, which the report says.
    Temperatures and pressures of configurations (TEMP, PRES) change the indices of glasses; lengths are what the other
    operands say.
    Vignetting factors (VDX, VDY, VCX, VCY) and weights of fields and wavelengths are passed to
    :class:`optical_system`; factors of a field with an angle (VAN) are not used, and named.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.raytracing.system import first_order, load_system, read_zmx, write_zmx
    >>> lens = load_system("cooke_triplet")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "lens.zmx")
    ...     write_zmx(lens, name)
    ...     again, report = read_zmx(name)
    >>> round(float(first_order(again).focal_length - first_order(lens).focal_length), 6)
    0.0
    """
    file = LensFile.opened("read_zmx", path, glasses)
    general, surfaces = read_lines(file.path)
    with named_errors(file.path.name):
        found = _built(file, general, surfaces)
    return file.reported(found)


def _built(file: LensFile, general: list[Line], surfaces: list[list[Line]]) -> optical_system:
    """Return the system of a file that was read."""
    notes = file.notes
    for line in general:
        if line.key not in _GENERAL_KEYS | _OPERANDS and not (line.key == "VANN" and not any(line.values())):
            file.ignored.append(line.text)
    head = {line.key: line for line in reversed(general)}
    surfaces, focused = _completed(head, surfaces, notes)
    if "MODE" in head and list(head["MODE"].words[:1]) != ["SEQ"]:
        raise ValueError(f"MODE must be SEQ, got {' '.join(head['MODE'].words)!r}")
    file.take_unit("UNIT", head["UNIT"].word if "UNIT" in head and head["UNIT"].words else "MM", LENGTHS)
    words = [word.lower() for word in head["GCAT"].words] if "GCAT" in head else []
    file.makers = list(dict.fromkeys(maker for word in words for maker in glass_makers() if maker in word))
    file.waves, weights, reference = _wavelengths(general, head, notes)
    built = [_surface(number, surfaces, file) for number in range(1, len(surfaces) - 1)]
    image = _image(len(surfaces) - 1, surfaces, file)
    distance = _object_distance(head, surfaces[0], file)
    _check_object(surfaces[0], math.isinf(distance), file)
    _note_settings(head, surfaces, notes)
    medium = _glass(0, surfaces, file)
    if focused:
        plain_system = optical_system(list(built), 1.0, wavelengths=file.waves[reference])
        back = float(first_order(plain_system).back_focal_distance)
        built[-1].thickness.fill_(back if math.isfinite(back) else 0.0)
    afocal = bool(_count(head, 6))
    if afocal and image is not None:
        notes.append("the image space is afocal (FTYP): the shape and the aperture of the image are not used")
    system = file.maker_of_system(
        built,
        "STOP",
        name=" ".join(head["NAME"].words) if "NAME" in head else None,
        object_distance=distance,
        object_material=medium,
        reference=reference,
        wavelength_weights=weights,
        afocal=afocal,
        image=None if afocal else image,
    )
    size, form = _aperture(head, surfaces, file, system)
    telecentric = bool(_count(head, 1)) and not math.isinf(distance) and form in ("NA", "stop")
    if _count(head, 1) and not telecentric:
        notes.append("the telecentric flag of FTYP needs a near object and an aperture by OBNA or FLOA: not used")
    points = _field_points(head, system(size, form, telecentric=telecentric), file)
    return system(
        size,
        form,
        telecentric=telecentric,
        fields=points,
        vignetting_factors=_factors(head, len(points), notes),
        field_weights=differing(_numbers(head.get("FWGN", head.get("FWGT")))[: len(points)], len(points)),
        settings=_settings(general, head, surfaces, form, file),
    )


def _completed(head, surfaces, notes: list) -> tuple[list, bool]:
    """Return surfaces with the object and the image that a file leaves out, and whether the image is to be focused."""
    glass = [any(line.key == "GLAS" and line.words for line in lines) for lines in surfaces]
    if surfaces[0] and not (glass[0] and "FTYP" not in head and math.isfinite(_of(surfaces[0], "DISZ", math.inf))):
        return surfaces, False
    if surfaces[0]:
        surfaces, glass = [[], *surfaces], [False, *glass]
    notes.append("the file has no object: it is taken to be at infinity")
    if not glass[-2]:
        return surfaces, False
    distance = _of(surfaces[-1], "DISZ", 0.0)
    notes.append(
        f"the file has no image: a plane {f'at {distance:g}' if distance else 'in the paraxial focus'} is added"
    )
    return [*surfaces, []], not distance


def _object_distance(head, lines, file: LensFile) -> float:
    """Return the distance of the object; a very far one given by angles is at infinity."""
    distance = _of(lines, "DISZ", math.inf) * file.scale
    by_angles = "FTYP" not in head or head["FTYP"].value() in (0, 4)
    return file.object_distance(distance) if by_angles else distance


def _check_object(lines, far: bool, file: LensFile) -> None:
    """Raise ValueError for an object that is curved; note the rest."""
    for line in lines:
        curved = line.key in ("CURV", "CONI") and line.words and line.value()
        if curved and not far:
            raise ValueError(f"line {line.number}: the object must be flat, got {' '.join(line.words)!r}")
        if line.key not in _SURFACE_KEYS or curved:
            file.ignored.append(_named(line, 0))


def _note_settings(head, surfaces, notes: list) -> None:
    """Note settings of the whole file that its reader may miss."""
    held = [
        number
        for number, lines in enumerate(surfaces)
        for line in lines
        if line.key == "CURV" and len(line.words) > 1 and line.words[1].strip('"') not in ("", "0")
    ]
    if held:
        where = ", ".join(map(str, held))
        notes.append(f"curvatures of surfaces {where} are variables or solves in the file: read as they stand")


def _settings(general, head, surfaces, form: str, file: LensFile) -> list[tuple]:
    """Return the settings of the configurations, with a note of them and of the operands that are not used."""
    count = head["MNUM"].whole() if "MNUM" in head and head["MNUM"].words else 1
    if count < 2:
        return []
    file.notes.append(
        f"the file holds {count} configurations: the surfaces give the system's own numbers, "
        "its settings hold the numbers of all configurations (see configurations)"
    )
    unused = set()
    held: dict[tuple[str, int], dict[int, Line]] = {}
    for line in general:
        if line.key in _OPERANDS - _IDLE_OPERANDS and len(line.words) > 2 and 1 <= line.whole(1) <= count:
            held.setdefault((line.key, line.whole()), {})[line.whole(1)] = line
        elif line.key in _OPERANDS - _IDLE_OPERANDS:
            unused.add(line.key)
    kind = _count(head, 0)
    factor = file.scale if kind in (1, 2, 3) else 1.0
    points = _listed_points(head, factor)
    fields = [list(map(list, points)) for _ in range(count)]
    waves = [list(file.waves) for _ in range(count)]
    weather: dict[str, list[float]] = {}
    # Numbers one by one: where they go in each configuration, what stands there, and the unit.
    single: dict[tuple[str, int], tuple[list[list[float]], int, float, float]] = {}
    for i, wave in enumerate(file.waves):
        single["WAVE", i + 1] = waves, i, wave * 1e3, 1e-3
    for i, point in enumerate(points if kind != 4 else []):
        for axis, key in enumerate(("XFIE", "YFIE")):
            single[key, i + 1] = [row[i] for row in fields], axis, point[axis] / factor, factor
    found: list[tuple] = []
    for (key, place), lines in held.items():
        values = _Values(count, lines)
        if key in WEATHER:
            weather[key] = values(*WEATHER[key])
        elif (key, place) in single:
            rows, at, own, unit = single[key, place]
            for row, value in zip(rows, values(own, unit), strict=True):
                row[at] = value
        else:
            made = _setting(key, place, values, (surfaces, form, kind), file)
            found += made or []
            unused |= {f"{key} {place}"} if made is None else set()
    heights = {2: "image_heights", 3: "real_image_heights"}.get(kind)
    for name, rows in ((heights or "fields", fields), ("wavelengths", waves)):
        if name == heights or any(row != rows[0] for row in rows):
            found.append((name, None, rows))
    if unused:
        file.notes.append(f"operands of configurations that are not used: {', '.join(sorted(unused))}")
    return _in_weather(found, surfaces, weather, count, file) if weather else found


class _Values(NamedTuple):
    """Lines of an operand by the number of the configuration, and how many configurations there are."""

    count: int  # type: ignore[assignment]  # hides tuple.count
    lines: dict[int, Line]

    def __call__(self, own: float, scale: float = 1.0) -> list[float]:
        """Return the number of each configuration; of one without a line, the surface's own."""
        return [scale * (self.lines[i].value(2) if i in self.lines else own) for i in range(1, self.count + 1)]


def _setting(key: str, place: int, values: _Values, given: tuple, file: LensFile) -> list[tuple] | None:
    """Return the setting of an operand; none for one without effect on rays, None for one that is not used."""
    (surfaces, form, kind), scale = given, file.scale
    if key == "THIC" and place == 0 and kind not in (0, 4):
        distances = values(_of(surfaces[0], "DISZ", math.inf), scale)
        return [("object_distance", None, [value if value < FAR else math.inf for value in distances])]
    if key == "APER" and form != "stop" and len(values.lines) == values.count:
        return [("aperture", None, values(1.0, scale if form == "EPD" else 1.0))]
    lines = surfaces[place] if 1 <= place <= len(surfaces) - 2 else None
    if key == "SDIA":
        stops = [i for i, item in enumerate(surfaces) if any(line.key == "STOP" for line in item)]
        if place == (stops or [1])[0] and form == "stop":
            return [("aperture", None, values(_of(surfaces[place], "DIAM", 0.0), 2 * scale))]
        # Elsewhere it limits rays only where the aperture floats.
        floats = lines is not None and any(line.key == "FLAP" for line in lines)
        return [("semi_diameter", place - 1, values(_of(lines, "DIAM", 0.0), scale))] if floats else []
    if lines is None:
        return None
    if key == "GLSS":
        return [("material", place - 1, _glasses_of(place, surfaces, values.lines, values.count, file))]
    if key not in _NUMBERS:
        return None
    name, own, power = _NUMBERS[key]
    return [(name, place - 1, values(_of(lines, own, 0.0), scale**power))]


def _glasses_of(place: int, surfaces, lines: dict, count: int, file: LensFile) -> list:
    """Return the medium behind a surface in each configuration."""
    found = []
    for i in range(1, count + 1):
        rows = list(surfaces)
        if i in lines:
            name = lines[i].words[2].strip('"')
            kept = [line for line in surfaces[place] if line.key != "GLAS"]
            glass = [Line(lines[i].number, "GLAS", [name])] if name.upper() not in ("AIR", "") else []
            rows[place] = kept + glass
        found.append(_glass(place, rows, file))
    return found


def _in_weather(settings: list, surfaces, weather: dict, count: int, file: LensFile) -> list[tuple]:
    """Return settings with the glasses at the temperatures and in air of the pressures of the configurations.

    As in the program, lengths are what the other operands say: these two change indices only.
    """
    places = zip(*(weather.get(key, [scale * start] * count) for key, (start, scale) in WEATHER.items()), strict=True)
    weathers = list(places)
    given = {place: values for name, place, values in settings if name == "material"}
    found = [entry for entry in settings if entry[0] != "material"]
    for place in range(len(surfaces) - 2):
        media = given.get(place) or [_glass(place + 1, surfaces, file)] * count
        if any(isinstance(medium, OpticalMaterial) for medium in media) or place in given:
            at = [m.at(*w) if isinstance(m, OpticalMaterial) else m for m, w in zip(media, weathers, strict=True)]
            found.append(("material", place, at))
    return found


def _named(line: Line, surface_number: int) -> str:
    return line.text.replace(":", f", surface {surface_number}:", 1)


def _of(lines, key: str, default: float) -> float:
    return next((line.value() for line in lines if line.key == key and line.words), default)


def _parameters(lines, key: str, scale_of=None) -> dict[int, float]:
    """Return the numbered values of lines PARM or XDAT."""
    return {line.whole(): line.value(1) for line in lines if line.key == key and len(line.words) > 1}


def _surface(number: int, surfaces, file: LensFile) -> surface:
    """Return one surface; entries without effect go to the report."""
    lines, scale = surfaces[number], file.scale
    kind = next((line.words[0] for line in lines if line.key == "TYPE" and line.words), "STANDARD").upper()
    if kind not in KINDS:
        raise ValueError(f"surface {number}: TYPE must be one of {', '.join(KINDS)}, got {kind!r}")
    held = _parameters(lines, "XDAT")
    extended = 3 + int(held.get(2, 0.0)) if kind == "QED_TYPE" else 2 + int(held.get(1, 0.0))
    for line in lines:
        used = line.key in _SURFACE_KEYS
        if line.key in ("PARM", "XDAT") and len(line.words) > 1 and line.value(1):
            used = line.whole() in KINDS[kind].parameters if line.key == "PARM" else line.whole() <= extended
        if not (used or line.automatic):
            file.ignored.append(_named(line, number))
    thickness = _of(lines, "DISZ", 0.0) * scale
    p = _parameters(lines, "PARM")
    if kind == "COORDBRK":
        if any(line.key == "STOP" for line in lines):
            file.notes.append(f"surface {number}: a coordinate break cannot be the stop")
        order = "tilt" if p.get(6, 0.0) else "shift"
        shift = (p.get(1, 0.0) * scale, p.get(2, 0.0) * scale)
        return coordinate_break(shift, tuple(p.get(i, 0.0) for i in (3, 4, 5)), thickness, order=order)
    shape, phase = _form(number, kind, lines, scale)
    limit, apertures = _limits(number, lines, scale)
    gradient, medium = None, _glass(number, surfaces, file)
    if kind.startswith("GRINSUR"):
        gradient, medium = _graded(number, kind, p, scale)
    # Only irregular surfaces have a position of their own.
    own = p if kind == "IRREGULA" else {}
    with named_errors(f"surface {number}"):
        return surface(
            shape=shape,
            phase=phase,
            thickness=thickness,
            material=medium,
            gradient=gradient,
            semi_diameter=limit,
            aperture=apertures or None,
            shift=(own.get(1, 0.0) * scale, own.get(2, 0.0) * scale),
            tilt=own_tilt((own.get(3, 0.0), own.get(4, 0.0), 0.0)),
            stop=any(line.key == "STOP" for line in lines),
        )


class _Entries(NamedTuple):
    """Numbers of a surface from which its shape is made; lengths in millimetres but for `p`.

    `p` are its lines PARM, `extra` its terms of lines XDAT, and `norm` their radius of normalisation.
    """

    number: int
    kind: str
    lines: list[Line]
    scale: float
    curvature: float
    conic: float
    p: dict[int, float]
    extra: list[float]
    norm: float
    strong: bool

    def heights(self) -> list[float]:
        """Return the terms of lines XDAT as heights."""
        return [value * self.scale for value in self.extra]

    def powers(self, step: int = 2) -> list[float]:
        """Return the coefficients of r to the power of `step`, 2·`step`, … of lines PARM."""
        last = min(max((i for i, value in self.p.items() if value), default=0), 8)
        return [self.p.get(i, 0.0) * self.scale ** (1 - step * i) for i in range(1, last + 1)]


def _form(number: int, kind: str, lines, scale: float) -> tuple[Shape, Phase | None]:
    """Return the shape and the phase of a surface."""
    curvature, conic = _of(lines, "CURV", 0.0) / scale, _of(lines, "CONI", 0.0)
    p, x = _parameters(lines, "PARM"), _parameters(lines, "XDAT")
    strong = x.get(1, 0.0) == 1
    if kind == "QED_TYPE":
        # The kind of the polynomials, then as the others.
        x = {i - 1: value for i, value in x.items() if i > 1}
    terms, norm = int(x.get(1, 0.0)), x.get(2, 1.0) * scale or 1.0
    if not 0 <= terms <= MAXIMUM_TERMS:
        raise ValueError(f"surface {number}: XDAT must contain at most {MAXIMUM_TERMS} terms, got {terms}")
    extra = [x.get(i, 0.0) for i in range(3, 3 + terms)]
    last = max((i for i, value in p.items() if value), default=0)
    if kind in ("EVENASPH", "ODDASPHE") and last > 8:
        raise ValueError(f"surface {number}: PARM must be 1 to 8, got {last}")
    made = KINDS[kind].make(_Entries(number, kind, lines, scale, curvature, conic, p, extra, norm, strong))
    return made if isinstance(made, tuple) else (made, None)


def _conic(e: _Entries) -> Shape:
    return Conic(e.curvature, e.conic)


def _grating(e: _Entries) -> tuple[Shape, Phase]:
    return _conic(e), LinearGrating(0.0, e.p.get(1, 0.0) * 1e3, e.p.get(2, 0.0))


def _paraxial(e: _Entries) -> tuple[Shape, Phase]:
    return _conic(e), IdealLens(e.p.get(1, 100.0) * e.scale)


def _asphere(e: _Entries) -> Shape:
    if e.kind == "ODDASPHE":
        return OddAsphere(e.curvature, e.conic, e.powers(1) or [0.0])
    return EvenAsphere(e.curvature, e.conic, e.powers())


def _diffractive(e: _Entries) -> tuple[Shape, Phase | None]:
    phase = PolynomialPhase if e.kind == "BINARY_1" else RadialPhase
    return _asphere(e), phase(e.extra, e.norm, e.p.get(0, 1.0)) if e.extra else None


def _extended_asphere(e: _Entries) -> Shape:
    """Return an asphere in powers of r over the radius of normalisation."""
    made, step = (EvenAsphere, 2) if e.kind == "XASPHERE" else (OddAsphere, 1)
    given = [value * e.scale / e.norm ** (step * i) for i, value in enumerate(e.extra, start=1)]
    return made(e.curvature, e.conic, given or [0.0])


def _forbes(e: _Entries) -> Shape:
    if e.strong:
        return QconAsphere(e.curvature, e.conic, e.heights(), e.norm)
    return QbfsAsphere(e.curvature, e.heights(), e.norm)


def _tilted(e: _Entries) -> Shape:
    return PolynomialFreeform(0.0, 0.0, [e.p.get(1, 0.0), e.p.get(2, 0.0)], 1.0)


def _toroid(e: _Entries) -> Shape:
    if e.extra:
        raise ValueError(
            f"surface {e.number}: TOROIDAL with Zernike terms (XDAT) is not supported, got {len(e.extra)} terms"
        )
    rotation = e.p.get(1, 0.0) * e.scale
    last = max((i for i, value in e.p.items() if value), default=1)
    given = [e.p.get(i, 0.0) * e.scale ** (3 - 2 * i) for i in range(2, last + 1)]
    return Toroid(1 / rotation if rotation else 0.0, e.curvature, e.conic, given)


def _biconic(e: _Entries) -> Shape:
    radius = e.p.get(1, 0.0) * e.scale
    return Biconic(1 / radius if radius else 0.0, e.curvature, e.p.get(2, 0.0), e.conic)


def _polynomial(e: _Entries) -> Shape:
    return PolynomialFreeform(e.curvature, e.conic, e.heights() or [0.0], e.norm)


def _zernike(e: _Entries) -> Shape:
    if e.p.get(9, 0.0) or e.p.get(10, 0.0):
        shift = e.p.get(9, 0.0), e.p.get(10, 0.0)
        raise ValueError(
            f"surface {e.number}: {e.kind} with shifted Zernike terms (PARM 9 and 10) is not supported: {shift}"
        )
    heights = e.heights() or [0.0]
    modes = _fringe_modes(len(heights)) if e.kind == "FZERNSAG" else None
    return ZernikeFreeform(e.curvature, e.conic, _zernike_terms(heights, modes, e.powers(), e.norm), e.norm)


def _irregular(e: _Entries) -> Shape:
    """Return a conic plus Zs·ρ⁴ + Za·ρ_y² + Zc·ρ²·ρ_y, ρ being the distance from the axis over the semi-diameter.

    Ansys Zemax OpticStudio 2024 R2 help, "Irregular".
    """
    s, a, c = (e.p.get(i, 0.0) * e.scale for i in (5, 6, 7))
    if not (s or a or c):
        return _conic(e)
    reach = _of(e.lines, "DIAM", 0.0) * e.scale
    if not reach:
        raise ValueError(f"surface {e.number}: IRREGULA needs a semi-diameter (DIAM), at which its terms are given")
    if e.p.get(8, 0.0) and (a or c):
        raise ValueError(f"surface {e.number}: IRREGULA turned by an angle (PARM 8) is not supported: {e.p[8]:g}")
    terms = [0.0, 0.0, 0.0, 0.0, a, 0.0, c, 0.0, c, s, 0.0, 2 * s, 0.0, s]
    return PolynomialFreeform(e.curvature, e.conic, terms, reach)


class _Kind(NamedTuple):
    """What makes the shape and the phase of a surface type, and which of its entries PARM are used."""

    make: Callable[[_Entries], Shape | tuple[Shape, Phase | None]]
    parameters: Sequence[int] = ()


KINDS = {
    "STANDARD": _Kind(_conic),
    "EVENASPH": _Kind(_asphere, range(1, 9)),
    "ODDASPHE": _Kind(_asphere, range(1, 9)),
    "XASPHERE": _Kind(_extended_asphere),
    "XOSPHERE": _Kind(_extended_asphere),
    "TOROIDAL": _Kind(_toroid, range(1, 9)),
    "BICONICX": _Kind(_biconic, (1, 2)),
    "TILTSURF": _Kind(_tilted, (1, 2)),
    "XPOLYNOM": _Kind(_polynomial),
    "QED_TYPE": _Kind(_forbes),
    "SZERNSAG": _Kind(_zernike, range(9)),
    "FZERNSAG": _Kind(_zernike, range(9)),
    "IRREGULA": _Kind(_irregular, range(1, 9)),
    "COORDBRK": _Kind(_conic, range(1, 7)),
    "DGRATING": _Kind(_grating, (1, 2)),
    "BINARY_1": _Kind(_diffractive, range(9)),
    "BINARY_2": _Kind(_diffractive, range(9)),
    "PARAXIAL": _Kind(_paraxial, (1, 2)),
    "GRINSUR1": _Kind(_conic, (1, 2, 3)),
    "GRINSUR2": _Kind(_conic, range(1, 9)),
    "GRINSUR3": _Kind(_conic, range(1, 9)),
}


def _fringe_modes(count: int) -> list[tuple[int, int]]:
    """Return the orders (n, m) of the first fringe Zernike polynomials."""
    if count > 37:
        raise ValueError(f"XDAT must contain at most 37 fringe Zernike terms, got {count}")
    return [fringe_to_nm(j) for j in range(1, count + 1)]


def _zernike_terms(heights, modes, powers, radius: float) -> list[float]:
    """Return coefficients in Noll's order, of RMS 1, of a sum of Zernike polynomials and even powers of r.

    Parameters
    ----------
    heights : list of float
        Coefficients in Noll's order, of RMS 1; of `modes`, if given, with the norm of :func:`zernike_polynomial`.
    modes : list of tuple of int or None
        Orders (n, m).
    powers : list of float
        Coefficients of r², r⁴, …
    radius : float
        Radius of the disc.
    """
    parts = {noll_to_nm(j): height for j, height in enumerate(heights, start=1)}
    if modes is not None:
        parts = {mode: height / zernike_norm(*mode) for mode, height in zip(modes, heights, strict=True)}
    for i, power in enumerate(powers, start=1):
        # ρ^(2i) in Legendre polynomials of 2ρ² − 1, which are the Zernike polynomials of m = 0.
        share = np.polynomial.legendre.poly2leg(np.polynomial.polynomial.polypow([0.5, 0.5], i))
        for k, value in enumerate(share.tolist()):
            mode = (2 * k, 0)
            parts[mode] = parts.get(mode, 0.0) + power * radius ** (2 * i) * value / zernike_norm(*mode)
    highest = max(n for n, _ in parts)
    ordered = [parts.get(noll_to_nm(j), 0.0) for j in range(1, (highest + 1) * (highest + 2) // 2 + 1)]
    while len(ordered) > 1 and not ordered[-1]:
        ordered.pop()
    return ordered


def _graded(number: int, kind: str, p: dict, scale: float) -> tuple[Gradient, float]:
    """Return the gradient behind a surface and its index on the axis.

    GRINSUR1 has n = n0 + a·r², GRINSUR2 n² = n0 + a·r² + b·r⁴ + …, GRINSUR3 n = n0 + a·r² + b·r⁴ + c·r⁶ + d·z + e·z² +
    f·z³; PARM 1 is a step of the numerical trace, PARM 2 is n0 (Ansys Zemax OpticStudio 2024 R2 help, "Gradient 3").
    """
    base = p.get(2, 1.0)
    if not base > 0:
        raise ValueError(f"surface {number}: PARM 2, the index on the axis, must be positive, got {base:g}")
    values = [p.get(i, 0.0) for i in range(3, 9)]
    radial = [value / scale ** (2 * i) for i, value in enumerate(values, start=1)]
    if kind == "GRINSUR2":
        return RadialGradient([value / base for value in radial]), base**0.5
    radial = radial[: 1 if kind == "GRINSUR1" else 3]
    axial = [value / scale**i for i, value in enumerate(values[3:], start=1)] if kind == "GRINSUR3" else []
    if any(axial):
        if any(radial):
            raise ValueError(f"surface {number}: GRINSUR3 both radial and axial is not supported, got {values}")
        return AxialGradient(axial), base
    # The square of the index, over that on the axis.
    squared = np.polynomial.polynomial.polypow([1.0, *(value / base for value in radial)], 2)
    return RadialGradient(squared[1:].tolist()), base


def _limits(number: int, lines, scale: float) -> tuple[float | None, list[Aperture]]:
    """Return the semi-diameter that limits rays, and further apertures."""
    limit: float | None = None
    found: list[Aperture] = []
    center = next(((line.value(0) * scale, line.value(1) * scale) for line in lines if line.key == "OBDC"), (0.0, 0.0))
    for line in lines:
        if line.key == "FLAP":
            # The semi-diameter limits; older files repeat it here.
            limit = (_of(lines, "DIAM", 0.0) or (line.value(1) if len(line.words) > 1 else 0.0)) * scale or None
        if line.key not in ("CLAP", "OBSC", "SQAP", "SQOB", "ELAP", "ELOB"):
            continue
        a, b = line.value(0) * scale, line.value(1) * scale
        obscures = line.key in ("OBSC", "SQOB", "ELOB")
        if line.key in ("CLAP", "OBSC"):
            if line.key == "CLAP" and not a and center == (0.0, 0.0):
                limit = b or None
            elif b:
                found.append(CircularAperture(center, obscures, b, a))
        else:
            made: type[EllipticAperture] = RectangularAperture if line.key.startswith("SQ") else EllipticAperture
            found.append(made(center, obscures, a, b))
    return limit, found


class _Glass(NamedTuple):
    """A line GLAS: name, code of its kind, index and Abbe number at d, and deviation of the partial dispersion.

    `own` is true where the line itself defines the glass, `stated` where it gives index and Abbe number.
    """

    name: str
    code: str
    nd: float
    vd: float
    dpgf: float
    own: bool
    stated: bool

    @classmethod
    def of(cls, line: Line) -> "_Glass":
        """Return the entries of a line."""
        name, code = line.words[0], line.words[1] if len(line.words) > 1 else "0"
        own = name == "___BLANK" or code == "1"
        nd = line.value(3) if len(line.words) > 3 else 0.0
        unknown = len(line.words) <= 4 or (own and line.words[4].strip("?") == "")
        vd = 0.0 if unknown else line.value(4)
        stated = nd > 1 and vd > 0 and (own or (round(nd, 6), round(vd, 6)) != _PLACEHOLDER)
        return cls(name, code, nd, vd, line.value(5) if len(line.words) > 5 else 0.0, own, stated)


def _glass(number: int, surfaces, file: LensFile):
    """Return the medium behind a surface."""
    line = next((line for line in surfaces[number] if line.key == "GLAS" and line.words), None)
    if line is None:
        return "air"
    if line.words[0] in file.glasses:
        return file.glasses[line.words[0]]
    if line.words[0].upper() == "MIRROR":
        return MIRROR
    glass = _Glass.of(line)
    if glass.own and glass.nd == -1:
        file.notes.append(f"surface {number}: {glass.name} of index -1 is a mirror")
        return MIRROR
    if glass.own and glass.nd > 0 and not glass.vd:
        if glass.nd != 1:
            file.notes.append(f"surface {number}: {glass.name} of index {glass.nd:g} has no Abbe number: no dispersion")
        return glass.nd
    if glass.code == "2" and len(line.words) > 2 and not (glass.nd > 1 and glass.vd > 0):
        source = line.whole(2)
        if 0 < source < number:
            return _glass(source, surfaces, file)
    if glass.code == "4" and (glass.nd or glass.vd):
        file.notes.append(
            f"surface {number}: the offset of {glass.name}, {glass.nd:g} in nd and {glass.vd:g} in Vd, is not used"
        )
    if glass.own:
        return _modelled(number, glass, file)
    thin = abs(_of(surfaces[number], "DISZ", 0.0)) * file.scale <= THIN
    return _of_catalogue(number, glass, thin, file)


def _of_catalogue(number: int, glass: _Glass, thin: bool, file: LensFile):
    """Return a glass by its name, or a model of it where the line or a six-digit name states index and Abbe number."""
    found, problem = file.catalogued(number, glass.name, file.makers)
    if found is None and thin and re.fullmatch(r"NOA-?\d+\w*", glass.name.upper()) and not glass.stated:
        found = material("NOA61")
        file.notes.append(f"surface {number}: {glass.name}, a thin layer of an adhesive, is taken to be NOA61")
    if found is not None:
        return file.within(number, found)
    digits = re.fullmatch(r"(\d{3})\.?(\d{3})", glass.name)
    if digits and not glass.stated:
        nd, vd = 1 + int(digits[1]) / 1000, int(digits[2]) / 10
        glass = glass._replace(nd=nd, vd=vd, dpgf=0.0, stated=vd > 0)
    if not glass.stated:
        nearest = ", ".join(nearest_materials(glass.nd, glass.vd)) if glass.nd > 1 else ""
        near = f" Nearest to its nd = {glass.nd:g}, Vd = {glass.vd:g}: {nearest}." if nearest else ""
        raise ValueError(
            f"surface {number}: {problem}.{near} Or pass glasses={{{glass.name!r}: …}} to {file.reader}, or "
            "load a catalogue that holds it (load_materials; odak trace --glasses)"
        )
    return _modelled(number, glass, file)


def _modelled(number: int, glass: _Glass, file: LensFile):
    """Return a model glass of a stated index and Abbe number."""
    name, nd, vd = glass.name, glass.nd, glass.vd
    if not glass.stated:
        raise ValueError(f"surface {number}: {name} must state an index above 1 and an Abbe number, got {nd:g}, {vd:g}")
    near = ", ".join(nearest_materials(nd, vd, 2, file.makers or None))
    file.notes.append(f"surface {number}: {name} is a model glass of nd = {nd:g}, Vd = {vd:g}; nearest are {near}")
    return file.within(number, model_glass(nd, vd, glass.dpgf))


def _image(number: int, surfaces, file: LensFile) -> surface | None:
    """Return the image surface, None for a plane; a glass behind it has no effect."""
    lines = [line for line in surfaces[number] if line.key not in ("GLAS", "DISZ", "STOP")]
    file.ignored.extend([_named(line, number) for line in surfaces[number] if line.key == "GLAS"])
    found = _surface(0, [lines], dataclasses.replace(file, ignored=[]))
    file.ignored.extend([_named(line, number) for line in lines if not (line.key in _SURFACE_KEYS or line.automatic)])
    if is_break(found) or found.phase is not None:
        kind = "COORDBRK" if is_break(found) else type(found.phase).__name__
        raise ValueError(f"surface {number}, the image, must be a surface without diffraction, got {kind}")
    return image_of(found)


def _wavelengths(general, head, notes: list) -> tuple[list[float], list[float] | None, int]:
    """Return the wavelengths in millimetres, their weights where they differ, and the number of the primary one."""
    lines = [line for line in general if line.key == "WAVM"]
    waves = [line.value(1) for line in lines]
    waves = waves or [value for line in general if line.key == "WAVL" for value in _numbers(line)]
    number = _count(head, 3)
    if not number:
        # Unused wavelengths stand at 0.55 µm behind those in use.
        number = max([1, *(i + 1 for i, value in enumerate(waves) if value != 0.55)]) if waves else 0
        if waves:
            notes.append(f"FTYP does not say how many wavelengths: the first {number} are taken")
    weights = [line.value(2) if len(line.words) > 2 else 1.0 for line in lines[:number]]
    if not lines:
        weights = [value for line in general if line.key == "WWGT" for value in _numbers(line)][:number]
    weights = differing(weights, len(waves[:number]))
    waves = [value * 1e-3 for value in waves[:number]] or [587.5618e-6]
    reference = head["PWAV"].whole() - 1 if "PWAV" in head else len(waves) // 2
    return waves, weights, min(max(reference, 0), len(waves) - 1)


def _factors(head, count: int, notes: list) -> list[list[float]] | None:
    """Return the vignetting factors of each field, None where all are zero; those with an angle are noted."""
    columns = [(_numbers(head.get(key)) + [0.0] * count)[:count] for key in (*FACTORS, "VANN")]
    rows = [list(row) for row in zip(*columns, strict=True)]
    turned = [str(i) for i, row in enumerate(rows, start=1) if row[4] and any(row[:4])]
    if turned:
        notes.append(f"vignetting factors of fields {', '.join(turned)} have an angle (VANN): not used")
    rows = [[0.0] * 4 if row[4] else row[:4] for row in rows]
    return rows if any(map(any, rows)) else None


def _field_points(head, system, file: LensFile) -> list[tuple[float, float]]:
    """Return the field points: angles for an object at infinity, heights in millimetres for a near one."""
    kind, points = head["FTYP"].whole() if "FTYP" in head else 0, _listed_points(head, 1.0)
    if kind not in range(5) or (kind == 1 and system.at_infinity and any(map(any, points))):
        raise ValueError(
            f"FTYP must be 0 or 4 (angles), 1 (object heights, object near), 2 or 3 (image heights), got {kind}"
        )
    if kind == 4:
        # Azimuth and elevation, the latter from the x–z plane.
        points = [
            (a, math.degrees(math.atan(math.tan(math.radians(b)) / math.cos(math.radians(a))))) for a, b in points
        ]
        file.notes.append("fields are theodolite angles, turned into angles along x and y")
    aim = "real" if "RAIM" in head and len(head["RAIM"].words) > 1 and head["RAIM"].value(1) else "paraxial"
    return file.field_points(system, points, ("angle", "height", "paraxial", "real", "angle")[kind], aim)


def _listed_points(head, scale: float) -> list[tuple[float, float]]:
    """Return the field points as the file states them."""
    x, y = (_numbers(head.get(key, head.get(older))) for key, older in (("XFLN", "XFLD"), ("YFLN", "YFLD")))
    given = pairs(x, y)
    count = _count(head, 2) or max([1, *(i + 1 for i, pair in enumerate(given) if any(pair))])
    return [(a * scale, b * scale) for a, b in given[:count]] or [(0.0, 0.0)]


def _numbers(line) -> list[float]:
    return [] if line is None else line.values()


def _count(head, place: int) -> int:
    return head["FTYP"].whole(place) if "FTYP" in head and len(head["FTYP"].words) > place else 0


def _aperture(head, surfaces, file: LensFile, system) -> tuple[float, str]:
    """Return the size of the aperture and its kind; `system` builds the system from both."""
    given = next((key for key in ("ENPD", "FNUM", "OBNA", "FLOA") if key in head), None)
    if given in ("ENPD", "FNUM", "OBNA") and head[given].words and not head[given].value():
        file.notes.append(f"{given} is 0")
        given = None
    if given == "ENPD":
        return head["ENPD"].value() * file.scale, "EPD"
    if given == "FNUM":
        number, near = head["FNUM"].value(), not system(1.0, "EPD").at_infinity
        if near and len(head["FNUM"].words) > 1 and head["FNUM"].value(1):
            return aperture_of_working(system, number), "NA"
        return number, "F-number"
    if given == "OBNA":
        if math.isinf(_of(surfaces[0], "DISZ", math.inf)):
            raise ValueError(
                "OBNA, an aperture of the object's side, must belong to a near object, got one at infinity"
            )
        size = head["OBNA"].value()
        if len(head["OBNA"].words) > 1 and head["OBNA"].value(1):
            file.notes.append(f"OBNA is a cone of {size:g} degrees, turned into a numerical aperture")
            size = math.sin(math.radians(size))
        return size, "NA"
    sizes = [_of(lines, "DIAM", 0.0) * file.scale for lines in surfaces[1:-1]]
    size = sizes[next((i for i, lines in enumerate(surfaces[1:-1]) if any(v.key == "STOP" for v in lines)), 0)]
    if given == "FLOA" and size:
        return 2 * size, "stop"
    if any(sizes):
        size = _widest_stop(system(1.0, "stop"), sizes)
    what = "FLOA without a semi-diameter of the stop" if given else "no aperture (ENPD, FNUM, OBNA, FLOA)"
    if size:
        file.notes.append(
            f"{what}: {size:g} mm, so that the axial bundle fills the narrowest of the surfaces' semi-diameters, "
            "paraxially"
        )
        return 2 * size, "stop"
    if given:
        raise ValueError("FLOA takes the aperture from the stop, whose semi-diameter (DIAM) is not given")
    return file.usual_pupil(system(1.0, "stop"), what)


def _widest_stop(system, sizes) -> float:
    """Return the radius of the stop at which the axial bundle is within the semi-diameters, 0 where there is none."""
    p = system.prescription([system.wavelengths[system.reference]])
    index, heights = signed_indices(system, p), []
    for i in range(len(sizes)):
        found = matrix(p, index, 0, i, gap=True)
        heights.append(abs(float(found.a if system.at_infinity else found.a * system.object_distance + found.b)))
    shares = [size / height for size, height in zip(sizes, heights, strict=True) if size and height]
    return heights[system.stop] * min(shares, default=0.0)


_APERTURES = {"EPD": "ENPD {} ", "F-number": "FNUM {} 0", "NA": "OBNA {} 0", "stop": "FLOA"}


def write_zmx(system: optical_system, path: str | os.PathLike[str]) -> None:
    """Write a system as a Zemax text file, every digit of its numbers.

    Parameters
    ----------
    system : optical_system
        In any unit; written in millimetres.
    path : str or pathlib.Path
        File to write, UTF-8.

    Raises
    ------
    ValueError
        If the system holds what the format cannot say: shifts and tilts of single surfaces (use coordinate breaks), a
        return to an earlier frame, a shape without a counterpart, a medium without a name.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.raytracing.system import first_order, load_system, read_zmx, write_zmx
    >>> lens = load_system("cooke_triplet")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "lens.zmx")
    ...     write_zmx(lens, name)
    ...     again, report = read_zmx(name)
    >>> round(float(first_order(again).focal_length - first_order(lens).focal_length), 6)
    0.0
    """
    path, text = _text("path", path), _zmx_text(without_derivatives(system))
    write_file(path, text.encode("utf-8"))


def _zmx_text(system) -> str:
    """Return the lines of a file in millimetres; numbers by `repr`, which is exact."""
    scale = MICROMETRES[system.unit] / MICROMETRES["mm"]
    kind = 0 if system.at_infinity else 1
    if system.aperture_type == "NA" and system.at_infinity:
        raise ValueError("aperture_type NA with an object at infinity has no .zmx form; use the F-number")
    size = system.aperture if system.aperture_type in ("F-number", "NA") else system.aperture * scale
    factor = scale if kind else 1.0
    fields = system.fields
    heights = next((entry for entry in system.settings if entry[0].endswith("image_heights")), None)
    if heights is not None:
        kind, factor, fields = 3 if heights[0].startswith("real") else 2, scale, heights[2][0]
    makers = {str(getattr(item.material, "name", "")).partition(":") for item in system.surfaces}
    makers = sorted({maker.upper() for maker, colon, _ in makers if colon} | {"SCHOTT"})
    lines = ["VERS 140124 258 36214", "MODE SEQ", f"NAME {' '.join(system.name.split())}", "UNIT MM X W X CM MR CPMM"]
    lines += [f"GCAT {' '.join(makers)}", _APERTURES[system.aperture_type].format(repr(size)).strip()]
    lines += [f"FTYP {kind} {int(system.telecentric)} {len(fields)} {len(system.wavelengths)} 0 0 {int(system.afocal)}"]
    lines += [
        f"{key} " + " ".join(repr(field[axis] * factor) for field in fields)
        for axis, key in enumerate(("XFLN", "YFLN"))
    ]
    lines += ["RAIM 0 2 1 1"] if kind == 3 else []
    count = len(fields)
    lines += ["FWGN " + " ".join(map(repr, system.field_weights or [1.0] * count))]
    columns = zip(*(system.vignetting_factors or [(0.0,) * 4] * count), strict=True)
    lines += [f"{key} " + " ".join(map(repr, column)) for key, column in zip(FACTORS, columns, strict=True)]
    weights = system.wavelength_weights or [1] * len(system.wavelengths)
    lines += [
        f"WAVM {i} {value * MICROMETRES[system.unit]!r} {weight!r}"
        for i, (value, weight) in enumerate(zip(system.wavelengths, weights, strict=True), start=1)
    ]
    lines += [f"PWAV {system.reference + 1}", "SURF 0", "  TYPE STANDARD", "  CURV 0.0"]
    lines += [f"  DISZ {'INFINITY' if system.at_infinity else repr(system.object_distance * scale)}"]
    lines += _written_glass(system.object_material)
    rows, reaches = own_surfaces(system), _reaches(system)
    for number, item in enumerate(rows, start=1):
        written = _written(number, item, scale, number - 1 == system.stop, system)
        lines += written if is_break(item) else _with_diameter(written, reaches, number - 1, scale)
    image = system.image or surface()
    written = [f"SURF {len(rows) + 1}", *_written_form("image", image, scale), "  DISZ 0"]
    lines += _with_diameter(written + _written_limits("image", image, scale), reaches, -1, scale)
    return "\n".join([*lines, *_written_settings(system, scale, factor)]) + "\n"


def _reaches(system) -> list[float]:
    """Return the largest distance of a ray from the axis on each surface and in the image; none without a pupil."""
    numbers = system.prescription()
    with torch.no_grad():
        try:
            image = trace_fields(system, "rings", 1, vignetting=False)
            heights = clear_heights(system, numbers, 8)
        except ValueError:
            return []
    return [*heights.tolist(), float(torch.hypot(image.x, image.y).nan_to_num().amax())]


def _with_diameter(lines: list[str], reaches: list[float], place: int, scale: float) -> list[str]:
    """Return the lines of a surface with the semi-diameter that its rays need, where it has none of its own."""
    if not reaches or not reaches[place] or any(line.startswith("  DIAM") for line in lines):
        return lines
    return [*lines, f"  DIAM {reaches[place] * scale!r} 0 0 0 1"]


def _written_settings(system, scale: float, factor: float) -> list[str]:
    """Return the operands of the configurations; temperatures with all numbers that they change."""
    settings, weather = _resolved(system)
    lines = [f"MNUM {len(system.settings[0][2])} 1"] if system.settings else []

    def add(key: str, place: int, values) -> None:
        lines.extend(f"{key} {place} {i} {value} 0 0 0 1 1 1 0 0" for i, value in enumerate(values, start=1))

    for key, column in zip(WEATHER, zip(*weather, strict=True), strict=False):
        add(key, 0, (repr(float(value) / WEATHER[key][1]) for value in column))
    for name, place, values in settings:
        if name in ("thickness", "curvature", "conic"):
            key, unit = {"thickness": ("THIC", scale), "curvature": ("CRVT", 1 / scale), "conic": ("CONN", 1.0)}[name]
            add(key, place + 1, (repr(value * unit) for value in values))
        elif name == "object_distance":
            add("THIC", 0, (repr(value * scale) if math.isfinite(value) else "1.0E+10" for value in values))
        elif name == "aperture" and system.aperture_type == "stop":
            add("SDIA", system.stop + 1, (repr(value * scale / 2) for value in values))
        elif name == "aperture":
            add("APER", 0, (repr(value * (scale if system.aperture_type == "EPD" else 1.0)) for value in values))
        elif name == "material" and all(value == AIR or hasattr(value, "name") for value in values):
            add("GLSS", place + 1, (value if value == AIR else value.name.rpartition(":")[2] for value in values))
        elif name.endswith(("fields", "image_heights")) and len({len(points) for points in values}) == 1:
            columns = [
                (key, i + 1, [points[i][axis] * factor for points in values])
                for axis, key in enumerate(("XFIE", "YFIE"))
                for i in range(len(values[0]))
            ]
            for key, i, column in columns:
                if len(set(column)) > 1:
                    add(key, i, map(repr, column))
        elif name == "wavelengths" and all(len(row) == len(system.wavelengths) for row in values):
            for i in range(len(system.wavelengths)):
                add("WAVE", i + 1, (repr(row[i] * MICROMETRES[system.unit]) for row in values))
        else:
            raise ValueError(f"settings of {name} have no form in the format, or differ in number")
    return lines


def _resolved(system) -> tuple[list[tuple], list[tuple]]:
    """Return settings without temperatures but with the lengths they change, and the weather of each configuration."""
    settings = list(system.settings)
    if any(name in SETTINGS["environment"] for name, _, _ in settings):
        if system.object_material != AIR:
            raise ValueError("settings of temperatures are not written with an object in another medium than air")
        views = [configurations(system).view(i) for i in range(len(settings[0][2]))]
        taken = (*SETTINGS["environment"], "thickness", "curvature", "material")
        settings = [entry for entry in settings if entry[0] not in taken]
        for i in range(len(own_surfaces(system))):
            rows: list[Any] = [view.surfaces[i] for view in views]
            if len({tuple(item.coefficients.tolist()) for item in rows}) > 1:
                raise ValueError(f"settings of temperatures change the coefficients of surfaces[{i}]: not written")
            if isinstance(rows[0].material, OpticalMaterial):
                settings.append(("material", i, tuple(item.material for item in rows)))
            for name in ("thickness", "curvature") if not is_break(rows[0]) else ("thickness",):
                values = tuple(float(getattr(item, name).detach()) for item in rows)
                if set(values) != {float(getattr(system.surfaces[i], name).detach())}:
                    settings.append((name, i, values))
    media = [values for name, _, values in settings if name == "material"]
    weathers = [
        {m.environment and tuple(map(float, m.environment)) for m in row if isinstance(m, OpticalMaterial)} or {None}
        for row in zip(*media, strict=True)
    ]
    if any(len(row) > 1 for row in weathers):
        raise ValueError("settings of materials have several temperatures in one configuration: not written")
    found = [weather for (weather,) in weathers]
    return settings, [weather or (20.0, 101325.0) for weather in found] if any(found) else []


def _written_form(name: str, item, scale: float) -> list[str]:
    """Return the lines of a surface's type, shape and phase."""
    if item.own_gradient is not None:
        raise ValueError(f"{name} has a graded index behind it, which is not written")
    if item.own_coating is not None:
        raise ValueError(f"{name} has a coating, which is not written; remove it, or save the system as JSON")
    if bool(item.shift.any()) or bool(item.tilt.any()):
        raise ValueError(f"{name} is shifted or tilted, which is not written; use coordinate breaks")
    shape, phase = item.shape, item.phase
    kind = type(shape)
    value = {field.name: plain(getattr(shape, field.name)) for field in dataclasses.fields(shape)}
    lines = {"CURV": value.get("curvature", value.get("curvature_y", 0.0)) / scale, "CONI": value.get("conic", 0.0)}
    given, extra = value.get("coefficients", []), []
    parameters: dict[int, float] = {}
    if kind in (Conic, EvenAsphere, OddAsphere):
        step = 1 if kind is OddAsphere else 2
        word = ("ODDASPHE" if kind is OddAsphere else "EVENASPH") if given else "STANDARD"
        parameters = {i: a * scale ** (1 - step * i) for i, a in enumerate(given, start=1)}
        if len(given) > 8:
            # Terms beyond the eighth are lines XDAT of the extended types, with 1 as the radius of normalisation.
            word, extra = ("XOSPHERE", "XASPHERE")[step - 1], [len(given), 1.0, *parameters.values()]
            parameters = {}
    elif kind is Toroid:
        if len(given) > 7:
            raise ValueError(f"{name} is a Toroid of {len(given)} coefficients, of which the format has 7")
        word = "TOROIDAL"
        parameters = {1: scale / value["curvature_x"] if value["curvature_x"] else 0.0}
        parameters |= {i: a * scale ** (3 - 2 * i) for i, a in enumerate(given, start=2)}
    elif kind is Biconic:
        word, lines["CONI"] = "BICONICX", value["conic_y"]
        parameters = {1: scale / value["curvature_x"] if value["curvature_x"] else 0.0, 2: value["conic_x"]}
    elif kind in (ZernikeFreeform, PolynomialFreeform):
        word = "SZERNSAG" if kind is ZernikeFreeform else "XPOLYNOM"
        extra = [len(given), value["radius"] * scale, *(a * scale for a in given)]
    else:
        raise ValueError(f"{name} is a {kind.__name__}, which the format does not support")
    if phase is not None:
        held = {field.name: plain(getattr(phase, field.name)) for field in dataclasses.fields(phase)}
        if isinstance(phase, LinearGrating) and word == "STANDARD" and not held["frequency_x"]:
            word, parameters = "DGRATING", {1: held["frequency_y"] / scale / 1e3, 2: held["order"]}
        elif isinstance(phase, IdealLens) and word == "STANDARD":
            word, parameters = "PARAXIAL", {1: held["focal_length"] * scale, 2: 1.0}
        elif isinstance(phase, (RadialPhase, PolynomialPhase)) and word in ("STANDARD", "EVENASPH"):
            word = "BINARY_2" if isinstance(phase, RadialPhase) else "BINARY_1"
            parameters = {0: held["order"], **parameters}
            extra = [len(held["coefficients"]), held["radius"] * scale, *held["coefficients"]]
        else:
            raise ValueError(f"{name} has a {type(phase).__name__}, which the format does not support on this shape")
    text = [f"  TYPE {word}", f"  CURV {lines['CURV']!r}"]
    text += [f"  CONI {lines['CONI']!r}"] if lines["CONI"] else []
    text += [f"  PARM {i} {a!r}" for i, a in parameters.items()]
    return text + [f"  XDAT {i} {float(a)!r} 0 0 1.0 0.0 0" for i, a in enumerate(extra, start=1)]


def _written_limits(name: str, item, scale: float) -> list[str]:
    found = []
    if item.semi_diameter is not None:
        radius = item.semi_diameter * scale
        found += [f"  CLAP 0 {radius!r} 0", f"  DIAM {radius!r} 1 0 0 1"]
    centers = {part.center for part in item.apertures}
    if len(centers) > 1 or (centers and item.semi_diameter is not None and centers != {(0.0, 0.0)}):
        raise ValueError(f"{name} has apertures about different centres, which are not written, got {sorted(centers)}")
    for part in (part.scaled(scale) for part in item.apertures):
        if isinstance(part, CircularAperture):
            found += [f"  {'OBSC' if part.obscures else 'CLAP'} {part.inner!r} {part.radius!r} 0"]
        elif isinstance(part, EllipticAperture):
            word = "SQ" if isinstance(part, RectangularAperture) else "EL"
            found += [f"  {word}{'OB' if part.obscures else 'AP'} {part.half_width!r} {part.half_height!r} 0"]
        else:
            raise ValueError(f"{name} has a {type(part).__name__} as aperture, which is not written")
        if part.center != (0.0, 0.0):
            found += [f"  OBDC {part.center[0]!r} {part.center[1]!r}"]
    return found


def _written_glass(medium) -> list[str]:
    """Return the line of a medium, none for air."""
    if medium == AIR:
        return []
    if isinstance(medium, (int, float)):
        return [f"  GLAS ___BLANK 1 0 {float(medium)!r} 0 0 0 0 0 0 0"]
    name = "MIRROR" if medium == MIRROR else medium.name.rpartition(":")[2]
    if name.startswith("model "):
        words = model_numbers(medium)
        return [f"  GLAS ___BLANK 1 0 {' '.join(words)}{'' if len(words) > 2 else ' 0'} 0 0 0 0 0"]
    name = name.replace(" ", "_")
    return [f"  GLAS {name} 0 0 1.5 40 0 0 0 0 0 0" if name == "MIRROR" else f"  GLAS {name} 0 0"]


def _written(number: int, item, scale: float, stop: bool, system) -> list[str]:
    thickness = f"  DISZ {float(item.thickness.detach()) * scale!r}"
    if is_break(item):
        if isinstance(item.order, int):
            raise ValueError(f"surfaces[{number - 1}] returns to an earlier frame, which is not written")
        values = [*(item.shift * scale).tolist(), *item.tilt.tolist(), float(item.order == "tilt")]
        parameters = [f"  PARM {i} {value!r}" for i, value in enumerate(values, start=1)]
        return [f"SURF {number}", "  TYPE COORDBRK", "  CURV 0.0", *parameters, thickness]
    shape = _written_form(f"surfaces[{number - 1}]", item, scale)
    lines = [f"SURF {number}", *(["  STOP"] if stop else []), *shape, thickness]
    lines += _written_glass(float(item.index.detach()) if item.material is None else item.material)
    limits = _written_limits(f"surfaces[{number - 1}]", item, scale)
    if stop and system.aperture_type == "stop":
        # The aperture is twice the semi-diameter of the stop, even if other surfaces limit the rays.
        limits = [line for line in limits if not line.startswith("  DIAM")]
        limits += [f"  DIAM {system.aperture * scale / 2!r} 1 0 0 1"]
    return lines + limits
