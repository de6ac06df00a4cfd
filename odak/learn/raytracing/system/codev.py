"""Lenses of CODE V: sequence files (.seq), read and written."""

import dataclasses
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from odak.catalog.materials import MICROMETRES, OpticalMaterial, model_glass, tabulated
from odak.learn.raytracing.system.paraxial import first_order
from odak.learn.raytracing.system.specification import AIR, MIRROR
from odak.learn.raytracing.system.surfaces import (
    coordinate_break,
    is_break,
    optical_system,
    surface,
    without_derivatives,
)
from odak.learn.raytracing.system.system_files import (
    FAR,
    SPECIAL,
    Command,
    LensFile,
    ZmxReport,
    aperture_of_working,
    differing,
    image_of,
    lens_text,
    named_errors,
    own_surfaces,
    own_tilt,
    pairs,
    plain,
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
# What is done with the frame behind a decentred surface.
_RETURNS = ("DAR", "BEN", "REV", "RET", "GLB")
# Patterns of the commands of surfaces that have a number, and of those about apertures.
_NUMBERS = "|".join(("THI|CUY|HOR|HWL|K|KX|KY|CUX|CUF|XOD|YOD|ZOD|[A-D][RP]", f"[{LETTERS}]", *_PLACES))
_LIMITS = "CIR|RE[XY]|EL[XY]|AD[XY]|ARO"
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
    """Entries of one surface: numbers and words by the names of their commands, and the commands of its apertures."""

    values: dict[str, float] = dataclasses.field(default_factory=dict)
    words: dict[str, str] = dataclasses.field(default_factory=dict)
    limits: list[Command] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class _Reader(LensFile):
    """A sequence file while it is read."""

    by_radius: bool = False
    ended: bool = False
    private: bool = False
    zooms: int = 1
    surfaces: list[_Surface] = dataclasses.field(default_factory=list)
    head: dict[str, Command] = dataclasses.field(default_factory=dict)
    settings: list[Command] = dataclasses.field(default_factory=list)
    private_waves: list[float] = dataclasses.field(default_factory=list)
    private_glasses: dict[str, OpticalMaterial] = dataclasses.field(default_factory=dict)

    def numbers(self, key: str) -> list[float]:
        """Return the numbers of a command about the whole lens, none where it is not given."""
        return self.head[key].values() if key in self.head else []

    def take(self, number: int, words: list[str]) -> None:
        """Read one command."""
        key = words[0].upper()
        if not self.private and key.isalpha():
            key = key[:3]
        command = Command(number, key, words[1:])
        if self.private:
            self._private(command)
        elif re.fullmatch(r"S(O|I|\d*)", key) and len(words) > 1:
            self._surface(command)
        elif key == "RDM":
            self.by_radius = len(words) < 2 or command.word.startswith("Y")
        elif key == "PRV":
            self.private = True
        elif key == "ZOO":
            if len(words) == 2:
                self.zooms = int(command.value())
            elif len(words) > 2:
                self.settings.append(Command(number, command.word[:3], words[2:]))
        elif key in ("TIT", "DIM", "EPD", "FNO", "NA", "NAO", "WL", "REF", "WTW", "WTF") or re.fullmatch(
            r"[XY](AN|OB|IM|RI)|V[UL][XY]", key
        ):
            self.head[key] = command
        elif key in _INERT or re.fullmatch(r"[A-J]C", key):
            if key not in ("LEN", "INI", "GO"):
                self.ignored.append(f"line {number}: {' '.join(word.lstrip(chr(39)) for word in words)}")
        else:
            self._of_surface(command)

    def _private(self, command: Command) -> None:
        name = command.key.lstrip("'")
        if name == "END":
            self.private = False
        elif name == "PWL":
            self.private_waves = [value / 1e3 for value in command.values()]
        elif command.word.startswith("LAU"):
            values = command._replace(words=command.words[1:]).values()
            self.private_glasses[name] = _laurent(command.number, name, values, self.private_waves)
        else:
            values = command.values()
            if not self.private_waves or len(values) != len(self.private_waves):
                raise ValueError(
                    f"line {command.number}: the private glass {name} must have an index at each of "
                    f"{len(self.private_waves)} wavelengths (PWL), got {len(values)}"
                )
            source = "private catalogue of a CODE V file"
            self.private_glasses[name] = tabulated(name, self.private_waves, values, source)

    def _surface(self, command: Command) -> None:
        key, words = command.key, command.words
        place = len(self.surfaces) if key in ("S", "SO", "SI") else int(key[1:])
        if place > len(self.surfaces) or (key == "SO" and self.surfaces) or self.ended:
            raise ValueError(f"line {command.number}: surfaces must follow one another from SO to SI, got {key}")
        if place == len(self.surfaces):
            self.surfaces.append(_Surface())
        self.ended = key == "SI"
        item = self.surfaces[place]
        item.values["CUY"] = _reciprocal(command.value()) if self.by_radius else command.value()
        far = key == "SO" and words[1:] and words[1].casefold() in ("inf", "infinity")
        item.values["THI"] = math.inf if far else command.value(1) if len(words) > 1 else 0.0
        for word in words[2:]:
            if word.upper().startswith("REFL"):
                item.words["RMD"] = "REFL"
            elif word.upper() not in ("REFR", "AIR"):
                item.words["GLA"] = word.lstrip("'")

    def _of_surface(self, command: Command) -> None:
        """Read a command about the surface named by a qualifier Sk, or about the last one."""
        place, key = len(self.surfaces) - 1, command.key
        if re.fullmatch(r"S(\d+|[OI])", command.word) and key not in ("RET", "GLB"):
            name = command.word[1:]
            place = 0 if name == "O" else place if name == "I" else int(name)
            command = command._replace(words=command.words[1:])
        if not 0 <= place < len(self.surfaces):
            raise ValueError(f"line {command.number}: {key} must follow a surface (SO, S, SI)")
        item = self.surfaces[place]
        if key in ("RDY", "RDX"):
            item.values[f"CU{key[-1]}"] = _reciprocal(command.value(0 if key == "RDY" else -1))
        elif re.fullmatch(_NUMBERS, key):
            item.values[key] = command.value(0 if key in ("THI", "CUY") else -1)
        elif key == "SCO" or (key == "HCO" and re.fullmatch(r"C\d+", command.word)):
            item.values[f"{key} {command.word}"] = command.value(1)
        elif re.fullmatch(_LIMITS, key):
            item.limits.append(command)
        elif key in ("GLA", "RMD", "DIF", "HCT"):
            if not command.words:
                raise ValueError(f"line {command.number}: {key} must have a name, got none")
            item.words[key] = command.words[0].lstrip("'") if key == "GLA" else command.word
        elif key in (*_FORMS, "STO", "SPS"):
            item.words["STO" if key == "STO" else "form"] = f"SPS {command.word}" if key == "SPS" else key
        elif key in _RETURNS:
            item.words["back"] = key
            if key in ("RET", "GLB"):
                item.values[key] = command._replace(words=[(command.word or "?").lstrip("S") or "0"]).value()
        else:
            raise command.unknown()


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
    reader = _Reader.opened("read_seq", path, glasses)
    with named_errors(reader.path.name):
        for number, words in _commands(reader.path):
            reader.take(number, words)
        if len(reader.surfaces) < 3 or not reader.ended:
            raise ValueError(
                f"a lens must have an object (SO), at least one surface (S) and an image (SI), got "
                f"{len(reader.surfaces)} surfaces{'' if reader.ended else ' without SI'}"
            )
        found = _built(reader)
    remedy = "" if reader.by_radius else ": without a command RDM the file states curvatures; are they radii?"
    return reader.reported(found, remedy)


def _built(reader: _Reader) -> optical_system:
    """Return the system of a file that was read."""
    head, numbers = reader.head, reader.numbers
    reader.take_unit("DIM", head["DIM"].word if "DIM" in head and head["DIM"].words else "M", LENGTHS)
    waves = reader.waves = [value * 1e-6 for value in numbers("WL")] or [587.5618e-6]
    reader.glasses = {**reader.private_glasses, **reader.glasses}
    items: list[surface] = []
    places: dict[int, int] = {}
    for number, entry in enumerate(reader.surfaces[1:-1], start=1):
        with named_errors(f"surface {number}"):
            _append(number, entry, items, places, reader)
    items[-1].thickness += reader.surfaces[-1].values["THI"] * reader.scale
    with named_errors("the image"):
        image = _image(reader.surfaces[-1], reader)
    first = reader.surfaces[0].values
    distance = first["THI"] * reader.scale
    if not any(key in head and head[key].words for key in ("XOB", "YOB")):
        distance = reader.object_distance(distance, 1e13)
    if first["CUY"] and math.isfinite(distance):
        raise ValueError("the object must be flat")
    system = reader.maker_of_system(
        items,
        "STO",
        name=" ".join(word.lstrip("'") for word in head["TIT"].words) or None if "TIT" in head else None,
        reference=int(numbers("REF")[0]) - 1 if numbers("REF") else len(waves) // 2,
        image=image,
        object_distance=distance,
        wavelength_weights=differing(numbers("WTW"), len(waves)),
    )
    size, form = _aperture(reader, system)
    points = _points(system(size, form), reader)
    return system(
        size,
        form,
        fields=points,
        vignetting_factors=_factors(numbers, len(points)),
        field_weights=differing(numbers("WTF"), len(points)),
        settings=_settings(reader, places, points, math.isinf(distance)),
    )


def _settings(reader: _Reader, places: dict, points, far: bool) -> list[tuple]:
    """Return the settings of the zoom positions."""
    count, scale = reader.zooms, reader.scale
    found: list[tuple] = []
    unused: list[str] = []
    rows = [list(map(list, points)) for _ in range(count)]
    for command in reader.settings if count > 1 else []:
        key, words = command.key, command.words
        where = command.word if re.fullmatch(r"[SFW]([0-9]+|[OI])", command.word) else ""
        command = command._replace(words=words[1:] if where else words)
        if key in _INERT or re.fullmatch(r"[A-J]C", key):
            continue
        with named_errors(f"line {command.number}"):
            if len(command.words) != count:
                raise ValueError(f"ZOO {key} must have {count} values, got {len(command.words)}")
            place = places.get(int(where[1:])) if re.fullmatch(r"S\d+", where) else None
            kind = "AN" if far else "OB"
            if key == "GLA" and place is not None:
                glasses = [_glass(place + 1, value.lstrip("'"), reader) for value in command.words]
                found.append(("material", place, glasses))
                continue
            given = command.values()
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
            elif key in ("EPD", "FNO", "NA", "NAO") and reader.numbers(key) and (key != "FNO" or far):
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
        reader.notes.append(
            f"the file has {count} zoom positions: the surfaces give the system's own numbers, "
            "its settings hold the numbers of all positions (see configurations)"
        )
    if unused:
        reader.notes.append(f"entries of zoom positions that are not used: {', '.join(unused)}")
    return found


def _append(number: int, entry: _Surface, items: list, places: dict, reader: LensFile) -> None:
    """Append a surface and the coordinate breaks around it."""
    shift, tilt, along = _placement(entry, reader.scale)
    thickness, back = entry.values["THI"] * reader.scale, entry.words.get("back", "")
    turned = any(shift) or any(tilt)
    if back in ("RET", "GLB"):
        frame = int(entry.values[back])
        if frame not in places:
            raise ValueError(f"{back} must name an earlier surface, got S{frame}")
        items.append(coordinate_break(return_to=places[frame]))
    if along and back != "REV":
        if items and back not in ("RET", "GLB"):
            items[-1].thickness += along
        else:
            items.append(coordinate_break(thickness=along))
    made = _made(number, entry, reader)
    own = back == "DAR" and not along and not bool(made.tilt.any())
    if own:
        made.shift.copy_(made.shift.new_tensor(shift))
        made.tilt = made.tilt.new_tensor(own_tilt(tilt))
    elif turned and back != "REV":
        items.append(coordinate_break(shift, tilt))
    places[number] = len(items)
    items.append(made)
    behind: coordinate_break | None = None
    if (not own and back == "DAR") or back == "REV":
        behind = coordinate_break(*_inverse(shift, tilt), order="tilt")
        thickness -= along
    elif back == "BEN":
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


def _made(number: int, entry: _Surface, reader: LensFile) -> surface:
    """Return the surface itself, in its place."""
    shape, turn = _shape(entry, reader.scale)
    limit, apertures = _limits(entry, reader.scale)
    medium: Any = (
        MIRROR if entry.words.get("RMD", "").startswith("REFL") else _glass(number, entry.words.get("GLA", ""), reader)
    )
    return surface(
        shape=shape,
        phase=_phase(entry, reader.scale),
        material=medium,
        semi_diameter=limit,
        aperture=apertures or None,
        stop="STO" in entry.words,
        tilt=(0.0, 0.0, turn),
    )


def _shape(entry: _Surface, scale: float) -> tuple[Shape, float]:
    """Return the shape, and the angle about the axis by which it is turned."""
    v, form = entry.values, entry.words.get("form", "SPH")
    c = v["CUY"] / scale
    cross, k = v.get("CUX", 0.0) / scale, v.get("K", v.get("KY", 0.0))
    powers = [v.get(letter, 0.0) * scale ** (-3 - 2 * i) for i, letter in enumerate(LETTERS)]
    while powers and not powers[-1]:
        powers.pop()
    if v.get("CUF"):
        raise ValueError(f"CUF, the base of a Fresnel surface, is not understood, got {v['CUF']:g}")
    if form in ("SPH", "CON", "ASP"):
        k = 0.0 if form == "SPH" else k
        return (EvenAsphere(c, k, [0.0, *powers]) if form == "ASP" and powers else Conic(c, k)), 0.0
    if form in ("CYL", "YTO"):
        return Toroid(cross, c, k, [0.0, *powers] if powers else []), 0.0
    if form == "XTO":
        return Toroid(c, cross, v.get("K", 0.0), [0.0, *powers] if powers else []), 90.0
    if form == "AAS":
        if any(value for key, value in v.items() if re.fullmatch(r"[A-D][RP]", key)):
            raise ValueError("AAS with terms AR to DP is not understood")
        return Biconic(cross, c, v.get("KX", 0.0), v.get("KY", 0.0)), 0.0
    if form == "SPS XYP":
        radius = v.get("SCO NRADIUS", 0.0) or 1.0
        places = {int(key[5:]): value for key, value in v.items() if re.fullmatch(r"SCO C\d+", key)}
        terms = [places.get(i, 0.0) * scale for i in range(2, max(places, default=1) + 1)] or [0.0]
        return PolynomialFreeform(c, v.get("SCO K", places.get(1, 0.0)), terms, radius * scale), 0.0
    raise ValueError(f"the form must be one of {', '.join(_FORMS)}, SPS XYP, got {form}")


def _phase(entry: _Surface, scale: float) -> RadialPhase | None:
    """Return the diffractive phase 2π/HWL·Σ C·r^(2i) of a surface."""
    v, kind = entry.values, (entry.words.get("DIF", ""), entry.words.get("HCT", "R"))
    if not any(key[:3] in ("DIF", "HCT", "HOR", "HWL", "HCO") for key in (*v, *entry.words)):
        return None
    if kind != ("DOE", "R"):
        raise ValueError(f"DIF must be DOE with HCT R, a radial phase, got {' '.join(kind).strip()}")
    terms = {int(key[5:]): value for key, value in v.items() if key.startswith("HCO ")}
    wave = v.get("HWL", 587.5618) * 1e-6
    given = [2 * math.pi / wave * terms.get(i, 0.0) * scale ** (1 - 2 * i) for i in range(1, max(terms, default=0) + 1)]
    return RadialPhase(given, 1.0, v.get("HOR", 1.0)) if given else None


def _limits(entry: _Surface, scale: float) -> tuple[float | None, list[Aperture]]:
    """Return the semi-diameter that limits rays, and further apertures."""
    groups: dict[tuple, dict[str, float]] = {}
    for command in entry.limits:
        key, value = command.key, command.value(-1)
        label = tuple(word.upper() for word in command.words[:-1] if word.upper() != "CLR")
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


def _glass(number: int, name: str, reader: LensFile):
    """Return the medium behind a surface."""
    if not name:
        return AIR
    if name in reader.glasses or name.upper() in reader.glasses:
        return reader.glasses.get(name, reader.glasses.get(name.upper()))
    code = re.fullmatch(r"(\d{3,})\.(\d{3,})", name) or re.fullmatch(r"(\d{3})(\d{3})", name)
    stated = re.fullmatch(r"(\d\.\d+):(\d+\.?\d*)", name)
    numbers = (
        (1 + _share(code[1]), 100 * _share(code[2])) if code else tuple(map(float, stated.groups() if stated else ()))
    )
    if numbers:
        glass = model_glass(*numbers)
        reader.notes.append(f"surface {number}: {name} is a model glass of nd = {glass.nd:g}, Vd = {glass.vd:g}")
        return reader.within(number, glass)
    return reader.named_glass(number, name)


def _share(digits: str) -> float:
    """Return digits as those behind the point."""
    return int(digits) / 10 ** len(digits)


def _image(entry: _Surface, reader: LensFile) -> surface | None:
    """Return the image surface, None for a plane on the axis."""
    shift, tilt, along = _placement(entry, reader.scale)
    shape, turn = _shape(entry, reader.scale)
    if along or "back" in entry.words or turn or _phase(entry, reader.scale):
        raise ValueError(f"ZDE, {entry.words.get('back', 'DIF')} or XTO of the image surface are not understood")
    limit, apertures = _limits(entry, reader.scale)
    return image_of(
        surface(shape=shape, semi_diameter=limit, aperture=apertures or None, shift=shift, tilt=own_tilt(tilt))
    )


def _aperture(reader: _Reader, system) -> tuple[float, str]:
    """Return the size of the aperture and its kind."""
    plain_system = system(1.0, "EPD")
    near = not plain_system.at_infinity
    for key, form in (("EPD", "EPD"), ("NAO", "NA"), ("FNO", "F-number"), ("NA", "NA")):
        for size in reader.numbers(key)[:1]:
            if near and key in ("FNO", "NA"):
                number = size if key == "FNO" else 0.5 / math.tan(math.asin(size))
                return aperture_of_working(system, number), "NA"
            return size * reader.scale if key == "EPD" else size, form
    return reader.usual_pupil(plain_system, "no aperture (EPD, FNO, NA, NAO)")


def _points(system, reader: _Reader) -> list[tuple[float, float]]:
    """Return the field points: angles for an object at infinity, heights in millimetres for a near one."""
    kinds = {"AN": "angle", "OB": "height", "IM": "paraxial", "RI": "real"}
    given = [kind for kind in kinds if reader.numbers(f"X{kind}") or reader.numbers(f"Y{kind}")]
    if not given:
        return [(0.0, 0.0)]
    if len(given) > 1:
        raise ValueError(f"fields must be of one kind, got {', '.join(f'Y{kind}' for kind in given)}")
    points = pairs(reader.numbers(f"X{given[0]}"), reader.numbers(f"Y{given[0]}"))
    if given[0] == "OB" and system.at_infinity and any(map(any, points)):
        raise ValueError("XOB and YOB, heights in the object, need a near object")
    return reader.field_points(system, points, kinds[given[0]])


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
