"""Lenses of CODE V: sequence files (.seq), read and written."""

import dataclasses
import math
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from odak.catalog.materials import MICROMETRES, OpticalMaterial, material, model_glass, tabulated
from odak.learn.raytracing.system.paraxial import first_order
from odak.learn.raytracing.system.specification import AIR, MIRROR, SystemAperture
from odak.learn.raytracing.system.surfaces import (
    coordinate_break,
    is_break,
    optical_system,
    surface,
    without_derivatives,
)
from odak.learn.raytracing.system.system_files import (
    FAR,
    Context,
    ZmxReport,
    aperture_of_working,
    catalogued,
    differing,
    fields_of_image_heights,
    heights_of_angles,
    image_of,
    lens_text,
    named_errors,
    opened,
    own_surfaces,
    own_tilt,
    pairs,
    plain,
    reported,
    usual_pupil,
    within,
)
from odak.raytracing.apertures import Aperture, CircularAperture, EllipticAperture, RectangularAperture
from odak.raytracing.interfaces import RadialPhase
from odak.raytracing.surfaces import Biconic, Conic, EvenAsphere, PolynomialFreeform, Shape, Toroid
from odak.tools.paths import _text, write_file
from odak.tools.transformation import rotation_matrix

LENGTHS = {"M": 1.0, "MM": 1.0, "C": 10.0, "CM": 10.0, "I": 25.4, "IN": 25.4}
# Coefficients of r⁴, r⁶, … by their letters.
LETTERS = "ABCDEFGHJ"
_PLACES = ("XDE", "YDE", "ZDE", "ADE", "BDE", "CDE")
_FORMS = ("SPH", "CON", "ASP", "CYL", "XTO", "YTO", "AAS")
# Materials of the catalogue "special".
SPECIAL = {
    "SILICA": "fused silica",
    "CAF2": "CaF2",
    "BAF2": "BaF2",
    "LIF": "lithium fluoride",
    "GERMMN": "germanium",
    "SILICN": "silicon",
    "ZNSE": "zinc selenide",
    "ZNS": "zinc sulfide",
    "ACRYLIC": "PMMA",
    "POLYCARB": "polycarbonate",
    "POLYSTYR": "polystyrene",
    "WATER": "water",
}
# Commands without effect on rays: controls of the optimisation end in C.
_INERT_WORDS = (
    "LEN INI SLB TEM PRE CWL PIM CUM THM CCY THC GLC RDC KC CUC XDC YDC ZDC ADC BDC CDC HCC SCC CLS PIK DER GO WID CA "
    "POL IC CUS DRA MEC COM XTC NRC"
)
_INERT = frozenset(re.findall(r"\w+", _INERT_WORDS))


def _commands(path: Path) -> list[tuple[int, list[str]]]:
    """Return the commands of a file with the numbers of their lines, as words; texts keep a quotation mark in front."""
    found: list[tuple[int, list[str]]] = []
    held, start = "", 0
    for number, text in enumerate(lens_text(path).splitlines(), start=1):
        # What stands in quotation marks is no comment and no separator.
        parts = re.findall(r"'[^']*'|\"[^\"]*\"|[!;&]|[^'\"!;&]+|.", text)
        parts = parts[: parts.index("!")] if "!" in parts else parts
        continues = bool(parts) and [part for part in parts if part.strip()][-1:] == ["&"]
        start = start or number
        held += " " + "".join(part if part != ";" else "\n" for part in parts if part != "&")
        if continues:
            continue
        for command in held.split("\n"):
            words = [
                f"'{word[1:-1]}" if len(word) > 1 and word[0] in "'\"" else word
                for word in re.findall(r"[A-Za-z]?'[^']*'|\"[^\"]*\"|[^\s,'\"]+", command)
            ]
            if words:
                found.append((start, words))
        held, start = "", 0
    return found


@dataclasses.dataclass
class _Surface:
    """Entries of one surface."""

    bend: float = 0.0
    thickness: float = 0.0
    glass: str = ""
    form: str = "SPH"
    stop: bool = False
    mirror: bool = False
    back: str = ""
    frame: int | None = None
    values: dict[str, float] = dataclasses.field(default_factory=dict)
    limits: list[tuple[str, tuple[str, ...], float]] = dataclasses.field(default_factory=list)
    phase: dict[str, Any] = dataclasses.field(default_factory=dict)


class _Reader:
    """State of a file that is being read."""

    def __init__(self, notes: list[str], ignored: list[str]):
        self.notes, self.ignored = notes, ignored
        self.by_radius, self.ended, self.private = False, False, False
        self.waves: list[float] = []
        self.surfaces: list[_Surface] = []
        self.head: dict[str, list[str]] = {}
        self.zooms = 1
        self.settings: list[tuple[int, str, list[str]]] = []
        self.glasses: dict[str, OpticalMaterial] = {}

    def take(self, number: int, words: list[str]) -> None:
        """Read one command."""
        line = f"line {number}: {' '.join(word.lstrip(chr(39)) for word in words)}"
        key = words[0].upper()
        if not self.private and key.isalpha():
            key = key[:3]
        if self.private:
            self._private(number, key, words)
        elif re.fullmatch(r"S(O|I|\d*)", key) and len(words) > 1:
            self._surface(number, key, words[1:])
        elif key == "RDM":
            self.by_radius = len(words) < 2 or words[1].upper().startswith("Y")
        elif key == "PRV":
            self.private = True
        elif key == "ZOO":
            if len(words) == 2:
                self.zooms = int(_number(number, "ZOO", words[1]))
            elif len(words) > 2:
                self.settings.append((number, words[1].upper()[:3], words[2:]))
        elif key in ("TIT", "DIM", "EPD", "FNO", "NA", "NAO", "WL", "REF", "WTW", "WTF") or re.fullmatch(
            r"[XY](AN|OB|IM|RI)|V[UL][XY]", key
        ):
            self.head[key] = words[1:]
        elif key in _INERT or re.fullmatch(r"[A-J]C", key):
            if key not in ("LEN", "INI", "GO"):
                self.ignored.append(line)
        else:
            self._of_surface(number, key, words[1:], line)

    def _private(self, number: int, key: str, words: list[str]) -> None:
        if key == "END":
            self.private = False
        elif key == "PWL":
            self.waves = [_number(number, "PWL", word) / 1e3 for word in words[1:]]
        else:
            name = key.lstrip("'")
            laurent = len(words) > 1 and words[1].upper().startswith("LAU")
            values = [_number(number, name, word) for word in words[2 if laurent else 1 :]]
            if laurent:
                self.glasses[name] = _laurent(number, name, values, self.waves)
                return
            if not self.waves or len(values) != len(self.waves):
                raise ValueError(
                    f"line {number}: the private glass {name} must have an index at each of {len(self.waves)} "
                    f"wavelengths (PWL), got {len(values)}"
                )
            self.glasses[name] = tabulated(name, self.waves, values, "private catalogue of a CODE V file")

    def _surface(self, number: int, key: str, words: list[str]) -> None:
        place = len(self.surfaces) if key in ("S", "SO", "SI") else int(key[1:])
        if place > len(self.surfaces) or (key == "SO" and self.surfaces) or self.ended:
            raise ValueError(f"line {number}: surfaces must follow one another from SO to SI, got {key}")
        if place == len(self.surfaces):
            self.surfaces.append(_Surface())
        self.ended = key == "SI"
        item = self.surfaces[place]
        bend = _number(number, key, words[0])
        item.bend = _reciprocal(bend) if self.by_radius else bend
        far = key == "SO" and words[1:] and words[1].casefold() in ("inf", "infinity")
        item.thickness = math.inf if far else _number(number, key, words[1]) if len(words) > 1 else 0.0
        for word in words[2:]:
            if word.upper().startswith("REFL"):
                item.mirror = True
            elif word.upper() not in ("REFR", "AIR"):
                item.glass = word.lstrip("'")

    def _of_surface(self, number: int, key: str, words: list[str], line: str) -> None:
        """Read a command about the surface named by a qualifier Sk, or about the last one."""
        place = len(self.surfaces) - 1
        if words and re.fullmatch(r"[Ss](\d+|[OoIi])", words[0]) and key not in ("RET", "GLB"):
            name = words.pop(0)[1:].upper()
            place = 0 if name == "O" else len(self.surfaces) - 1 if name == "I" else int(name)
        if not 0 <= place < len(self.surfaces):
            raise ValueError(f"line {number}: {key} must follow a surface (SO, S, SI)")
        command = _Command(number, line, key, words)
        for pattern, enter in _ENTRIES.items():
            if re.fullmatch(pattern, key):
                enter(self.surfaces[place], command)
                return
        raise command.unknown()


class _Command(NamedTuple):
    """A command about a surface: number and text of its line, its name and its words."""

    number: int
    line: str
    key: str
    words: list[str]

    @property
    def word(self) -> str:
        """The first word in capitals; "" where there is none."""
        return self.words[0].upper() if self.words else ""

    def value(self, place: int = -1) -> float:
        """Return one of the words as a number, by default the last."""
        if len(self.words) <= max(place, 0):
            raise ValueError(f"line {self.number}: {self.key} must have a number, got none")
        return _number(self.number, self.key, self.words[place])

    def unknown(self) -> ValueError:
        """Return the error of a command that is not understood."""
        return ValueError(f"{self.line:.90}: {self.key} is a command that is not understood")


def _enter_number(item: _Surface, command: _Command) -> None:
    if command.key == "THI":
        item.thickness = command.value(0)
    elif command.key == "CUY":
        item.bend = command.value(0)
    elif command.key == "RDX":
        item.values["CUX"] = _reciprocal(command.value())
    else:
        item.bend = _reciprocal(command.value(0))


def _enter_medium(item: _Surface, command: _Command) -> None:
    if not command.words:
        raise ValueError(f"line {command.number}: {command.key} must have a name, got none")
    if command.key == "GLA":
        item.glass = command.words[0].lstrip("'")
    else:
        item.mirror = command.word.startswith("REFL")


def _enter_form(item: _Surface, command: _Command) -> None:
    if command.key == "STO":
        item.stop = True
    else:
        item.form = f"SPS {command.word}" if command.key == "SPS" else command.key


def _enter_frame(item: _Surface, command: _Command) -> None:
    item.back = command.key
    if command.key in ("RET", "GLB"):
        item.frame = int(_number(command.number, command.key, (command.word or "?").lstrip("S") or "0"))


def _enter_limit(item: _Surface, command: _Command) -> None:
    item.limits.append((command.key, tuple(word.upper() for word in command.words[:-1]), command.value()))


def _enter_phase(item: _Surface, command: _Command) -> None:
    key = command.key
    if key in ("HOR", "HWL"):
        item.phase[key] = command.value()
    elif key != "HCO":
        item.phase["kind" if key == "DIF" else key] = command.word
    elif re.fullmatch(r"C\d+", command.word):
        item.phase.setdefault(key, {})[int(command.word[1:])] = command.value(1)
    else:
        raise command.unknown()


def _enter_coefficient(item: _Surface, command: _Command) -> None:
    item.values[f"SCO {command.word}" if command.key == "SCO" else command.key] = command.value()


# Which function enters a command into its surface, by patterns of its name.
_ENTRIES: dict[str, Callable[[_Surface, _Command], None]] = {
    "THI|CUY|RDY|RDX": _enter_number,
    "GLA|RMD": _enter_medium,
    "|".join(("STO", "SPS", *_FORMS)): _enter_form,
    "DAR|BEN|REV|RET|GLB": _enter_frame,
    "CIR|RE[XY]|EL[XY]|AD[XY]|ARO": _enter_limit,
    "DIF|HOR|HWL|HCT|HCO": _enter_phase,
    "|".join(("SCO|K|KX|KY|CUX|CUF|XOD|YOD|ZOD|[A-D][RP]", f"[{LETTERS}]", *_PLACES)): _enter_coefficient,
}


def _laurent(number: int, name: str, values: list[float], waves: list[float]) -> OpticalMaterial:
    """Return a private glass by its coefficients of n² = A₀ + A₁λ² + A₂λ⁻² + A₃λ⁻⁴ + …, λ in micrometres."""
    powers = (0, 2, *range(-2, -2 * len(values), -2))[: len(values)]
    reach = (min(waves), max(waves)) if len(waves) > 1 else (0.35, 2.5)
    source = "private catalogue of a CODE V file"
    glass = OpticalMaterial(name, "polynomial", {"A": tuple(values), "P": powers}, reach, "air", source)
    index = glass.index(sum(reach) / 2) if values else math.nan
    if isinstance(index, complex) or not 1 <= index < 6:
        raise ValueError(f"line {number}: the private glass {name} must have an index, got {index:.4g} from {values}")
    return glass


def _reciprocal(value: float) -> float:
    return 1 / value if value else 0.0


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _number(line: int, key: str, word: str) -> float:
    if not _is_number(word):
        raise ValueError(f"line {line}: {key} must have a number, got {word!r:.60}")
    return float(word)


def read_seq(
    path: str | os.PathLike[str], glasses: Mapping[Any, Any] | None = None
) -> tuple[optical_system, ZmxReport]:
    """Read a lens of CODE V from its sequence file.

    Parameters
    ----------
    path : str or pathlib.Path
        Text file (.seq), up to 4 MiB.
    glasses : mapping, optional
        Stand-ins for glasses by their names in the file: names of the catalogue, indices or Materials.

    Returns
    -------
    tuple
        The system in millimetres, and a :class:`ZmxReport` of all that was not used.

    Raises
    ------
    ValueError
        If the file is malformed, or holds a command that would change the paths of rays and is not understood; the
        message names line and command.

    Notes
    -----
    Understood are spheres, conics (CON), aspheres (ASP), cylinders (CYL), toroids (YTO, XTO), biconics (AAS without
    further terms), polynomials (SPS XYP), radial diffractive phases (DIF DOE, HCT R), mirrors, decentres and tilts with
    their returns (DAR, BEN, REV, RET, GLB), circular, rectangular and elliptic apertures with obscurations and holes,
    private catalogues (PRV), glass codes, zoom positions (ZOO, the settings of :class:`configurations`), apertures EPD,
    FNO, NA and NAO, fields as angles and heights in the object or the image, vignetting factors and weights. Tilts ADE
    and BDE are left-handed, CDE is right-handed. Without a command
    RDM, surfaces state curvatures. The thickness of the image surface, a defocus, is added to the last one. Apertures
    of edges (EDG) limit no rays.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.raytracing.system import first_order, load_system, read_seq, write_seq
    >>> lens = load_system("cooke_triplet")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "lens.seq")
    ...     write_seq(lens, name)
    ...     again, report = read_seq(name)
    >>> round(float(first_order(again).focal_length - first_order(lens).focal_length), 6)
    0.0
    """
    path, stand_ins = opened(path, glasses)
    reader = _Reader([], [])
    with named_errors(path.name):
        for number, words in _commands(path):
            reader.take(number, words)
        if len(reader.surfaces) < 3 or not reader.ended:
            raise ValueError(
                f"a lens must have an object (SO), at least one surface (S) and an image (SI), got "
                f"{len(reader.surfaces)} surfaces{'' if reader.ended else ' without SI'}"
            )
        found = _built(reader, stand_ins, path)
    remedy = "" if reader.by_radius else ": without a command RDM the file states curvatures; are they radii?"
    return reported(found, reader.ignored, reader.notes, remedy)


def _built(reader: _Reader, glasses: dict, path: Path) -> optical_system:
    """Return the system of a file that was read."""
    head, notes = reader.head, reader.notes

    def numbers(key: str) -> list[float]:
        return [_number(0, key, word) for word in head.get(key, [])]

    unit = head["DIM"][0].upper() if head.get("DIM") else "M"
    if unit not in LENGTHS:
        raise ValueError(f"DIM must be one of {', '.join(LENGTHS)}, got {unit!r}")
    scale = LENGTHS[unit]
    waves = [value * 1e-6 for value in numbers("WL")] or [587.5618e-6]
    reference = int(numbers("REF")[0]) - 1 if head.get("REF") else len(waves) // 2
    context = Context(scale, {**reader.glasses, **glasses}, [], waves, reader.ignored, notes)
    items: list[surface] = []
    places: dict[int, int] = {}
    for number, entry in enumerate(reader.surfaces[1:-1], start=1):
        with named_errors(f"surface {number}"):
            _append(number, entry, items, places, context)
    defocus = reader.surfaces[-1].thickness * scale
    if defocus:
        items[-1].thickness += defocus
    with named_errors("the image"):
        image = _image(reader.surfaces[-1], context)
    first = reader.surfaces[0]
    distance = first.thickness * scale
    heights = any(head.get(f"{axis}OB") for axis in "XY")
    if distance >= FAR and not heights:
        if distance < 1e13:
            notes.append(f"the object, at a distance of {distance:g} mm, is taken to be at infinity")
        distance = math.inf
    if first.bend and math.isfinite(distance):
        raise ValueError("the object must be flat")
    if not any(item.stop for item in items):
        notes.append("no STO: the first surface is taken as the stop")
    names: dict[str, Any] = {"unit": "mm", "source": path.name, "wavelengths": waves, "reference": reference}
    names |= {"name": " ".join(word.lstrip("'") for word in head.get("TIT", [])) or path.stem, "image": image}
    names |= {"object_distance": distance, "wavelength_weights": differing(numbers("WTW"), len(waves))}

    def system(size, form, **others):
        return optical_system(list(items), SystemAperture(size, form), **names, **others)

    size, form = _aperture(head, numbers, scale, system, notes)
    found = system(size, form)
    points = _points(found, head, numbers, scale, notes)
    factors = _factors(numbers, len(points))
    field_weights = differing(numbers("WTF"), len(points))
    zooms = _settings(reader, places, points, math.isinf(distance), numbers, context)
    return system(size, form, fields=points, vignetting_factors=factors, field_weights=field_weights, settings=zooms)


def _settings(reader: _Reader, places: dict, points, far: bool, numbers, context: Context) -> list[tuple]:
    """Return the settings of zoom positions, of lines ZOO; entries that are not used are noted."""
    count, scale = reader.zooms, context.scale
    found: list[tuple] = []
    unused: list[str] = []
    rows = [list(map(list, points)) for _ in range(count)]
    for number, key, words in reader.settings if count > 1 else []:
        where = words[0].upper() if re.fullmatch(r"[SsFfWw]([0-9]+|[OoIi])", words[0]) else ""
        values = words[1:] if where else words
        if key in _INERT or re.fullmatch(r"[A-J]C", key):
            continue
        with named_errors(f"line {number}"):
            if len(values) != count:
                raise ValueError(f"ZOO {key} must have {count} values, got {len(values)}")
            place = places.get(int(where[1:])) if re.fullmatch(r"S\d+", where) else None
            kind = "AN" if far else "OB"
            if key == "GLA" and place is not None:
                glasses = [_glass(place + 1, value.lstrip("'"), context) for value in values]
                found.append(("material", place, glasses))
                continue
            given = [_number(number, key, value) for value in values]
            if key == "THI" and place is not None:
                found.append(("thickness", place, [value * scale for value in given]))
            elif key == "THI" and where in ("S0", "SO"):
                away = [value * scale if value * scale < FAR else math.inf for value in given]
                found.append(("object_distance", None, away))
            elif key in ("CUY", "RDY") and place is not None:
                bends = [value if key == "CUY" else _reciprocal(value) for value in given]
                found.append(("curvature", place, [value / scale for value in bends]))
            elif key == "K" and place is not None:
                found.append(("conic", place, given))
            elif key in ("EPD", "FNO", "NA", "NAO") and numbers(key) and (key != "FNO" or far):
                found.append(("aperture", None, [value * (scale if key == "EPD" else 1.0) for value in given]))
            elif key in (f"X{kind}", f"Y{kind}") and re.fullmatch(r"F\d+", where) and int(where[1:]) <= len(rows[0]):
                factor = 1.0 if kind == "AN" else scale
                for row, value in zip(rows, given, strict=True):
                    row[int(where[1:]) - 1]["XY".index(key[0])] = value * factor
            else:
                unused.append(f"{key} {where}".strip())
    if any(row != rows[0] for row in rows):
        found.append(("fields", None, rows))
    if count > 1:
        context.notes.append(
            f"the file has {count} zoom positions: the surfaces give the system's own numbers, "
            "its settings hold the numbers of all positions (see configurations)"
        )
    if unused:
        context.notes.append(f"entries of zoom positions that are not used: {', '.join(unused)}")
    return found


def _append(number: int, entry: _Surface, items: list, places: dict, context: Context) -> None:
    """Append a surface and the coordinate breaks around it."""
    shift, tilt, along = _placement(entry, context.scale)
    thickness = entry.thickness * context.scale
    turned = any(shift) or any(tilt)
    if entry.back in ("RET", "GLB"):
        if entry.frame not in places:
            raise ValueError(f"{entry.back} must name an earlier surface, got S{entry.frame}")
        items.append(coordinate_break(return_to=places[entry.frame]))
    if along and entry.back != "REV":
        if items and entry.back not in ("RET", "GLB"):
            items[-1].thickness += along
        else:
            items.append(coordinate_break(thickness=along))
    made = _made(number, entry, context)
    own = entry.back == "DAR" and not along and not bool(made.tilt.any())
    if own:
        made.shift.copy_(made.shift.new_tensor(shift))
        made.tilt = made.tilt.new_tensor(own_tilt(tilt))
    elif turned and entry.back != "REV":
        items.append(coordinate_break(shift, tilt))
    places[number] = len(items)
    items.append(made)
    behind: coordinate_break | None = None
    if (not own and entry.back == "DAR") or entry.back == "REV":
        behind = coordinate_break(*_inverse(shift, tilt), order="tilt")
        thickness -= along
    elif entry.back == "BEN":
        behind = coordinate_break(tilt=_bent(tilt))
    if behind is not None:
        behind.thickness.fill_(thickness)
        items.append(behind)
    else:
        made.thickness.fill_(thickness)


def _placement(entry: _Surface, scale: float) -> tuple:
    """Return shift, right-handed tilt and displacement along the axis."""
    if any(entry.values.get(key) for key in ("XOD", "YOD", "ZOD")):
        raise ValueError("XOD, YOD and ZOD, other points of rotation, are not understood")
    x, y, z, a, b, c = (entry.values.get(key, 0.0) for key in _PLACES)
    return (x * scale, y * scale), (-a, -b, c), z * scale


def _inverse(shift, tilt) -> tuple[tuple, tuple]:
    return tuple(-value for value in shift), tuple(-value for value in tilt)


def _rotation(tilt, mode: str = "ZYX") -> np.ndarray:
    """Return the matrix of rotations in degrees about x, y and z, the first letter of the mode first."""
    return rotation_matrix(np.asarray(tilt, dtype=float), mode)


def _angles(matrix: np.ndarray) -> tuple[float, float, float]:
    """Return rotations in degrees about x, the new y and the new z."""
    b = math.asin(max(-1.0, min(1.0, matrix[0, 2])))
    a, c = math.atan2(-matrix[1, 2], matrix[2, 2]), math.atan2(-matrix[0, 1], matrix[0, 0])
    return math.degrees(a), math.degrees(b), math.degrees(c)


def _from_own_tilt(tilt) -> tuple[float, float, float]:
    """Return rotations about x, the new y and the new z that equal the tilt of a :class:`surface`."""
    a, b, c = (*tilt, 0.0)[:3]
    return (a, b, c) if not c and not (a and b) else _angles(_rotation((a, b, c), "ZXY"))


def _bent(tilt) -> tuple[float, float, float]:
    """Return the second rotation of a bend, behind which the axis follows the reflected ray."""
    if not tilt[2] and not (tilt[0] and tilt[1]):
        return tilt
    first = _rotation(tilt)
    normal, axis = first[:, 2], np.asarray([0.0, 0.0, 1.0])
    turn = np.cross(axis, normal)
    size, share = np.linalg.norm(turn), normal[2]
    angle = 2 * math.atan2(size, share)
    u = turn / size
    cross = np.asarray([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
    whole = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return _angles(first.T @ whole @ _rotation((0.0, 0.0, tilt[2])))


def _made(number: int, entry: _Surface, context: Context) -> surface:
    """Return the surface itself, in its place."""
    shape, turn = _shape(entry, context.scale)
    limit, apertures = _limits(entry, context.scale)
    medium: Any = MIRROR if entry.mirror else _glass(number, entry.glass, context)
    return surface(
        shape=shape,
        phase=_phase(entry, context.scale),
        material=medium,
        semi_diameter=limit,
        aperture=apertures or None,
        stop=entry.stop,
        tilt=(0.0, 0.0, turn),
    )


def _shape(entry: _Surface, scale: float) -> tuple[Shape, float]:
    """Return the shape, and the angle about the axis by which it is turned."""
    v, c = entry.values, entry.bend / scale
    cross, k = v.get("CUX", 0.0) / scale, v.get("K", v.get("KY", 0.0))
    powers = [v.get(letter, 0.0) * scale ** (-3 - 2 * i) for i, letter in enumerate(LETTERS)]
    while powers and not powers[-1]:
        powers.pop()
    if v.get("CUF"):
        raise ValueError(f"CUF, the base of a Fresnel surface, is not understood, got {v['CUF']:g}")
    if entry.form in ("SPH", "CON", "ASP"):
        k = 0.0 if entry.form == "SPH" else k
        return (EvenAsphere(c, k, [0.0, *powers]) if entry.form == "ASP" and powers else Conic(c, k)), 0.0
    if entry.form in ("CYL", "YTO"):
        return Toroid(cross, c, k, [0.0, *powers] if powers else []), 0.0
    if entry.form == "XTO":
        return Toroid(c, cross, v.get("K", 0.0), [0.0, *powers] if powers else []), 90.0
    if entry.form == "AAS":
        if any(value for key, value in v.items() if re.fullmatch(r"[A-D][RP]", key)):
            raise ValueError("AAS with terms AR to DP is not understood")
        return Biconic(cross, c, v.get("KX", 0.0), v.get("KY", 0.0)), 0.0
    if entry.form == "SPS XYP":
        radius = v.get("SCO NRADIUS", 0.0) or 1.0
        places = {int(key[5:]): value for key, value in v.items() if re.fullmatch(r"SCO C\d+", key)}
        terms = [places.get(i, 0.0) * scale for i in range(2, max(places, default=1) + 1)] or [0.0]
        return PolynomialFreeform(c, v.get("SCO K", places.get(1, 0.0)), terms, radius * scale), 0.0
    raise ValueError(f"the form must be one of {', '.join(_FORMS)}, SPS XYP, got {entry.form}")


def _phase(entry: _Surface, scale: float) -> RadialPhase | None:
    """Return the diffractive phase 2π/HWL·Σ C·r^(2i) of a surface."""
    held = entry.phase
    if not held:
        return None
    if held.get("kind") != "DOE" or held.get("HCT", "R") != "R":
        kind = f"{held.get('kind', '')} {held.get('HCT', '')}".strip()
        raise ValueError(f"DIF must be DOE with HCT R, a radial phase, got {kind}")
    terms, wavelength = held.get("HCO", {}), held.get("HWL", 587.5618) * 1e-6
    given = [
        2 * math.pi / wavelength * terms.get(i, 0.0) * scale ** (1 - 2 * i) for i in range(1, max(terms, default=0) + 1)
    ]
    return RadialPhase(given, 1.0, held.get("HOR", 1.0)) if given else None


def _limits(entry: _Surface, scale: float) -> tuple[float | None, list[Aperture]]:
    """Return the semi-diameter that limits rays, and further apertures."""
    groups: dict[tuple, dict[str, float]] = {}
    for key, words, value in entry.limits:
        label = tuple(word for word in words if word not in ("CLR",))
        shape = "CIR" if key == "CIR" else key[:2]
        if key[:2] in ("AD", "AR"):
            # A centre or an angle belongs to the last aperture.
            last = next(reversed(groups), None)
            if last is None:
                raise ValueError(f"{key} must follow an aperture")
            groups[last][key] = value
        else:
            groups.setdefault((shape, label), {})[key] = value
    limit: float | None = None
    found: list[Aperture] = []
    for (shape, words), held in groups.items():
        if "EDG" in words:
            continue
        if held.get("ARO"):
            raise ValueError("ARO, an aperture turned about its axis, is not understood")
        center = held.get("ADX", 0.0) * scale, held.get("ADY", 0.0) * scale
        blocks = "OBS" in words or "HOL" in words
        if shape == "CIR":
            radius = held["CIR"] * scale
            if blocks or center != (0.0, 0.0) or limit is not None:
                found.append(CircularAperture(center, blocks, radius))
            else:
                limit = radius or None
        else:
            kind = RectangularAperture if shape == "RE" else EllipticAperture
            width, height = held.get(f"{shape}X"), held.get(f"{shape}Y")
            if not width or not height:
                raise ValueError(f"{shape}X and {shape}Y must both be given")
            found.append(kind(center, blocks, width * scale, height * scale))
    return limit, found


def _glass(number: int, name: str, context: Context):
    """Return the medium behind a surface."""
    if not name:
        return AIR
    if name in context.glasses or name.upper() in context.glasses:
        return context.glasses.get(name, context.glasses.get(name.upper()))
    code = re.fullmatch(r"(\d{3,})\.(\d{3,})", name) or re.fullmatch(r"(\d{3})(\d{3})", name)
    stated = re.fullmatch(r"(\d\.\d+):(\d+\.?\d*)", name)
    numbers = (
        (1 + _share(code[1]), 100 * _share(code[2])) if code else tuple(map(float, stated.groups() if stated else ()))
    )
    if numbers:
        glass = model_glass(*numbers)
        context.notes.append(f"surface {number}: {name} is a model glass of nd = {glass.nd:g}, Vd = {glass.vd:g}")
        return within(number, glass, context)
    return within(number, glass_by_name(number, name, context, "read_seq"), context)


def _share(digits: str) -> float:
    """Return digits as those behind the point."""
    return int(digits) / 10 ** len(digits)


def glass_by_name(number: int, name: str, context: Context, reader: str) -> OpticalMaterial:
    """Return a glass by its name, with or without its maker behind it ("NBK7_SCHOTT").

    Parameters
    ----------
    number : int
        Number of the surface.
    name : str
        The name.
    context : Context
        Makers to be searched first, and notes.
    reader : str
        Function whose argument `glasses` the error names.
    """
    bare, _, maker = name.rpartition("_") if "_" in name else (name, "", "")
    maker = maker.casefold()
    if maker == "special" and bare.upper() in SPECIAL:
        return material(SPECIAL[bare.upper()])
    found, problem = catalogued(number, bare, context._replace(makers=[maker] if maker else []))
    if found is None:
        raise ValueError(
            f"{problem} or with odak trace --glasses FILE (.agf), or pass glasses={{{name!r}: …}} to {reader}"
        )
    return found


def _image(entry: _Surface, context: Context) -> surface | None:
    """Return the image surface, None for a plane on the axis."""
    shift, tilt, along = _placement(entry, context.scale)
    shape, turn = _shape(entry, context.scale)
    if along or entry.back or turn or entry.phase:
        raise ValueError(f"ZDE, {entry.back or 'DIF'} or XTO of the image surface are not understood")
    limit, apertures = _limits(entry, context.scale)
    return image_of(
        surface(shape=shape, semi_diameter=limit, aperture=apertures or None, shift=shift, tilt=own_tilt(tilt))
    )


def _aperture(head, numbers, scale: float, system, notes: list) -> tuple[float, str]:
    """Return the size of the aperture and its kind."""
    if numbers("EPD"):
        return numbers("EPD")[0] * scale, "EPD"
    if numbers("NAO"):
        return numbers("NAO")[0], "NA"
    near = not system(1.0, "EPD").at_infinity
    if numbers("FNO"):
        number = numbers("FNO")[0]
        return (aperture_of_working(system, number), "NA") if near else (number, "F-number")
    if numbers("NA"):
        size = numbers("NA")[0]
        return (aperture_of_working(system, 0.5 / math.tan(math.asin(size))), "NA") if near else (size, "NA")
    return usual_pupil(system(1.0, "EPD"), "no aperture (EPD, FNO, NA, NAO)", notes)


def _points(system, head, numbers, scale: float, notes: list) -> list[tuple[float, float]]:
    """Return the field points: angles for an object at infinity, heights in millimetres for a near one."""
    kinds = [kind for kind in ("AN", "OB", "IM", "RI") if head.get(f"X{kind}") or head.get(f"Y{kind}")]
    if not kinds:
        return [(0.0, 0.0)]
    if len(kinds) > 1:
        raise ValueError(f"fields must be of one kind, got {', '.join(f'Y{kind}' for kind in kinds)}")
    kind = kinds[0]
    points = pairs(numbers(f"X{kind}"), numbers(f"Y{kind}"))
    if kind == "AN" and not system.at_infinity and any(map(any, points)):
        return heights_of_angles(system, points, notes)
    if kind == "OB" and system.at_infinity and any(map(any, points)):
        raise ValueError("XOB and YOB, heights in the object, need a near object")
    if kind in ("IM", "RI"):
        notes.append(f"fields are image heights ({'real' if kind == 'RI' else 'paraxial'}), turned into object fields")
        points = [(a * scale, b * scale) for a, b in points]
        return list(fields_of_image_heights(system, points, kind == "RI", "real", notes))
    return points if kind == "AN" else [(a * scale, b * scale) for a, b in points]


def _factors(numbers, count: int) -> list[list[float]] | None:
    """Return vignetting factors (VDX, VDY, VCX, VCY) of fields, None where all are zero."""
    ux, lx, uy, ly = ((numbers(key) + [0.0] * count)[:count] for key in ("VUX", "VLX", "VUY", "VLY"))
    rows = [[(b - a) / 2, (d - c) / 2, (a + b) / 2, (c + d) / 2] for a, b, c, d in zip(ux, lx, uy, ly, strict=True)]
    return rows if any(map(any, rows)) else None


def write_seq(system: optical_system, path: str | os.PathLike[str]) -> None:
    """Write a system as a sequence file of CODE V, every digit of its numbers.

    Parameters
    ----------
    system : optical_system
        In any unit; written in millimetres.
    path : str or pathlib.Path
        File to write (.seq).

    Raises
    ------
    ValueError
        If the system holds parts that cannot be written: graded media, coatings, phases that are not radial, shapes
        without a counterpart, a coefficient of r², telecentric or afocal systems.

    Notes
    -----
    Media that the catalogues of CODE V do not hold are written as private glasses, by their indices at the system's
    wavelengths, and model glasses by their codes. An aperture given at the stop is written as the entrance pupil.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.raytracing.system import first_order, load_system, read_seq, write_seq
    >>> lens = load_system("double_gauss")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "lens.seq")
    ...     write_seq(lens, name)
    ...     again, report = read_seq(name)
    >>> again.name
    'Double Gauss f/2'
    """
    path, text = _text("path", path), _seq_text(without_derivatives(system))
    write_file(path, text.encode("utf-8"))


def _listed(key: str, values) -> str:
    return f"{key} " + " ".join(repr(float(value)) for value in values)


def _seq_text(system) -> str:
    """Return the commands of a system in millimetres; numbers by `repr`, which is exact."""
    if system.telecentric or system.afocal:
        raise ValueError("telecentric and afocal systems are not written")
    if system.object_material != AIR:
        raise ValueError("a medium in front of the first surface is not written")
    scale = MICROMETRES[system.unit] / MICROMETRES["mm"]
    size, kind = system.aperture, system.aperture_type
    if kind == "stop":
        kind, size = "EPD", float(first_order(system).entrance_pupil_diameter)
    near = not system.at_infinity
    if kind == "F-number" and near:
        kind, size = "EPD", float(first_order(system).entrance_pupil_diameter)
    word = {"EPD": "EPD", "F-number": "FNO", "NA": "NAO" if near else "NA"}[kind]
    lines = ["RDM N;LEN", f"TITLE '{' '.join(system.name.split()).replace(chr(39), '')}'", "DIM M"]
    lines += [f"{word} {size * (scale if kind == 'EPD' else 1.0)!r}"]
    waves = [value * MICROMETRES[system.unit] * 1e3 for value in system.wavelengths]
    lines += [_listed("WL", waves), f"REF {system.reference + 1}"]
    lines += [_listed("WTW", system.wavelength_weights or [1.0] * len(waves))]
    axes = "OB" if near else "AN"
    for i, axis in enumerate("XY"):
        lines += [_listed(f"{axis}{axes}", (field[i] * (scale if near else 1.0) for field in system.fields))]
    lines += [_listed("WTF", system.field_weights or [1.0] * len(system.fields))]
    rows = system.vignetting_factors or [(0.0,) * 4] * len(system.fields)
    for key, of in (
        ("VUX", lambda row: row[2] - row[0]),
        ("VLX", lambda row: row[2] + row[0]),
        ("VUY", lambda row: row[3] - row[1]),
        ("VLY", lambda row: row[3] + row[1]),
    ):
        lines += [_listed(key, map(of, rows))]
    private: dict[str, list[float]] = {}
    body = [f"SO 0.0 {system.object_distance * scale if near else 1e13!r}"]
    held = own_surfaces(system)
    numbers: dict[int, int] = {}
    for i, item in enumerate(held):
        # A coordinate break is a dummy surface.
        numbers[i] = i + 1
        body += _written(f"surfaces[{i}]", item, scale, system, private, numbers, i == system.stop)
    image = system.image
    body += ["SI 0.0 0.0"] if image is None else _shape_lines("image", image, scale, "SI", 0.0, "")
    if image is not None:
        body += _place_lines(image.shift.tolist(), _from_own_tilt(image.tilt.tolist()), scale)
    body += _zoom_lines(system, scale)
    if private:
        block = ["PRV", f"  {_listed('PWL', waves)}"]
        block += [f"  '{name}' " + " ".join(map(repr, values)) for name, values in private.items()] + ["END"]
        lines += block
    return "\n".join([*lines, *body, "GO"]) + "\n"


def _written(name: str, item, scale: float, system, private: dict, numbers: dict, stop: bool) -> list[str]:
    thickness = float(item.thickness.detach()) * scale
    if is_break(item):
        if isinstance(item.order, int):
            return [f"S 0.0 {thickness!r}", f"  RET S{numbers[item.order]}"]
        shift, tilt = item.shift.tolist(), item.tilt.tolist()
        if item.order == "tilt":
            # A reversed decentre, behind the surface.
            return [f"S 0.0 {thickness!r}", *_place_lines(*_inverse(shift, tilt), scale), "  REV"]
        return [f"S 0.0 {thickness!r}", *_place_lines(shift, tilt, scale)]
    glass = "REFL" if item.reflects else _glass_name(item, system, private)
    lines = _shape_lines(name, item, scale, "S", thickness, glass) + (["  STO"] if stop else [])
    if item.is_off_axis:
        tilt = _from_own_tilt(item.tilt.tolist())
        lines += [*_place_lines(item.shift.tolist(), tilt, scale), "  DAR"]
    return lines


def _zoom_lines(system, scale: float) -> list[str]:
    """Return the lines of zoom positions; settings of glasses, wavelengths and image heights are not written."""
    if not system.settings:
        return []
    lines = [f"ZOO {len(system.settings[0][2])}"]
    words = {"thickness": ("THI", scale), "curvature": ("CUY", 1 / scale), "conic": ("K", 1.0)}
    for name, place, values in system.settings:
        if name in words:
            key, factor = words[name]
            lines += [_listed(f"ZOO {key} S{place + 1}", (value * factor for value in values))]
        elif name == "object_distance":
            lines += [_listed("ZOO THI SO", (value * scale if math.isfinite(value) else 1e13 for value in values))]
        elif name == "aperture" and system.aperture_type == "EPD":
            lines += [_listed("ZOO EPD", (value * scale for value in values))]
        elif name == "aperture" and system.aperture_type == "F-number" and system.at_infinity:
            lines += [_listed("ZOO FNO", values)]
        elif name == "fields" and len({len(points) for points in values}) == 1:
            near = not system.at_infinity
            for i in range(len(values[0])):
                for axis, letter in enumerate("XY"):
                    column = [points[i][axis] * (scale if near else 1.0) for points in values]
                    lines += [_listed(f"ZOO {letter}{'OB' if near else 'AN'} F{i + 1}", column)]
        else:
            raise ValueError(f"settings of {name} are not written")
    return lines


def _place_lines(shift, tilt, scale: float) -> list[str]:
    x, y = (value * scale for value in shift)
    a, b, c = tilt
    given = zip(("XDE", "YDE", "ADE", "BDE", "CDE"), (x, y, -a, -b, c), strict=True)
    return [f"  {key} {value!r}" for key, value in given if value]


def _shape_lines(name: str, item, scale: float, key: str, thickness: float, glass: str) -> list[str]:
    """Return the lines of a surface's form, phase and apertures."""
    if item.own_gradient is not None or item.own_coating is not None:
        what = "a graded index behind it" if item.own_gradient is not None else "a coating"
        raise ValueError(f"{name} has {what}, which is not written")
    shape, kind = item.shape, type(item.shape)
    value = {field.name: plain(getattr(shape, field.name)) for field in dataclasses.fields(shape)}
    bend = value.get("curvature", value.get("curvature_y", 0.0)) / scale
    lines, given = [f"{key} {bend!r} {thickness!r} {glass}".rstrip()], value.get("coefficients") or []
    if kind in (Conic, EvenAsphere, Toroid):
        cross = [f"  CUX {value['curvature_x'] / scale!r}"] if kind is Toroid else []
        if given and given[0]:
            raise ValueError(f"{name} has a coefficient of r², which CODE V does not have, got {given[0]:g}")
        if len(given) > len(LETTERS) + 1:
            raise ValueError(f"{name} must have at most {len(LETTERS) + 1} coefficients, got {len(given)}")
        word = "YTO" if kind is Toroid else "ASP" if given else "CON" if value["conic"] else ""
        lines += [f"  {word}", f"  K {value['conic']!r}"] if word else []
        lines += cross + [
            f"  {letter} {a * scale ** (-3 - 2 * i)!r}"
            for i, (letter, a) in enumerate(zip(LETTERS, given[1:], strict=False))
        ]
    elif kind is Biconic:
        lines += ["  AAS", f"  CUX {value['curvature_x'] / scale!r}"]
        lines += [f"  KX {value['conic_x']!r}", f"  KY {value['conic_y']!r}"]
    elif kind is PolynomialFreeform:
        lines += ["  SPS XYP", f"  SCO NRADIUS {value['radius'] * scale!r}", f"  SCO K {value['conic']!r}"]
        lines += [f"  SCO C{i} {a * scale!r}" for i, a in enumerate(given, start=2)]
    else:
        raise ValueError(f"{name} is a {kind.__name__}, which is not written")
    phase = item.phase
    if phase is not None:
        if not isinstance(phase, RadialPhase):
            raise ValueError(f"{name} has a {type(phase).__name__}, which is not written")
        held = {field.name: plain(getattr(phase, field.name)) for field in dataclasses.fields(phase)}
        terms = [a / (held["radius"] * scale) ** (2 * i) for i, a in enumerate(held["coefficients"], start=1)]
        lines += ["  DIF DOE", f"  HOR {held['order']!r}", "  HWL 587.5618", "  HCT R"]
        lines += [f"  HCO C{i} {a * 587.5618e-6 / (2 * math.pi)!r}" for i, a in enumerate(terms, start=1)]
    lines += [] if item.semi_diameter is None else [f"  CIR {item.semi_diameter * scale!r}"]
    for number, part in enumerate((part.scaled(scale) for part in item.apertures), start=1):
        label = f"{'OBS ' if part.obscures else ''}L'{number}' "
        if isinstance(part, CircularAperture) and not part.inner:
            lines += [f"  CIR {label}{part.radius!r}"]
        elif isinstance(part, EllipticAperture):
            letters = "RE" if isinstance(part, RectangularAperture) else "EL"
            lines += [f"  {letters}X {label}{part.half_width!r}", f"  {letters}Y {label}{part.half_height!r}"]
        else:
            raise ValueError(f"{name} has a {type(part).__name__} as aperture, which is not written")
        lines += [f"  AD{axis} {label}{value!r}" for axis, value in zip("XY", part.center, strict=True) if value]
    return lines


def _glass_name(item, system, private: dict) -> str:
    """Return the name of the medium behind a surface, a private glass if there is no other."""
    medium = item.material
    if medium == AIR:
        return ""
    names = {value: key for key, value in SPECIAL.items()}
    if isinstance(medium, OpticalMaterial):
        full = medium.name
        if full in names:
            return f"{names[full]}_SPECIAL"
        maker, _, bare = full.rpartition(":")
        if not maker and "schott" in medium.source.casefold():
            maker = "schott"
        nd, vd = medium.nd or 0.0, medium.vd or 0.0
        if full.startswith("model ") and len(full.split()) == 3 and 1 < nd < 2 and vd < 100:
            index, abbe = f"{nd:.9f}"[2:], f"{vd / 100:.9f}"[2:]
            if float(f"1.{index}") == nd and 100 * (int(abbe) / 10 ** len(abbe)) == vd:
                return f"{index}.{abbe}"
        if maker and " " not in bare:
            return f"{bare.replace('-', '').upper()}_{maker.upper()}"
    values = system.prescription().index[:, list(system.surfaces).index(item) + 1].tolist()
    name = next((key for key, held in private.items() if held == values), f"GLASS{len(private) + 1}")
    private[name] = values
    return f"'{name}'"
