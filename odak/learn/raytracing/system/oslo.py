"""Lens files of OSLO (.len), read and written.

The commands follow the OSLO Program Reference (Lambda Research Corporation, 2011): lens data and surface data.
"""

import math
import os
import re
from collections.abc import Iterator, Mapping
from typing import Any

import torch

from odak.catalog.materials import MICROMETRES, tabulated
from odak.learn.raytracing.system.paraxial import first_order
from odak.learn.raytracing.system.specification import AIR, MIRROR
from odak.learn.raytracing.system.surfaces import is_break, optical_system, surface, without_derivatives
from odak.learn.raytracing.system.system_files import (
    Command,
    LensFile,
    ZmxReport,
    differing,
    image_of,
    lens_text,
    named_errors,
    own_surfaces,
)
from odak.raytracing.interfaces import IdealLens
from odak.raytracing.surfaces import Conic, EvenAsphere
from odak.tools.paths import _text, write_file

# Wavelengths in micrometres of files that state none, the primary one first.
WAVES = (0.58756, 0.48613, 0.65627)
_POWERS = ("AD", "AE", "AF", "AG")
# Commands without effect on rays.
_INERT = frozenset(("DES", "NOT", "SNO", "TCE", "APCK", "GSP", "PFM", "CBK", "CHK"))
# A comment of `write_len`: a field point in OSLO's coordinates FBY, FBX (parts of the tangent of ANG, or of OBH), the
# limits FY1, FY2, FX1, FX2 of its pupil, and its weight. OSLO keeps field points outside the description of the lens.
_POINT = "// field point"


def read_len(
    path: str | os.PathLike[str], glasses: Mapping[Any, Any] | None = None
) -> tuple[optical_system, ZmxReport]:
    """Read a lens file of OSLO.

    Parameters
    ----------
    path : str or pathlib.Path
        Text file (.len), up to 4 MiB.
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
    Understood are spheres and conics with terms AD to AG, mirrors, perfect lenses (PFL), glasses of catalogues and by
    their indices (GLA MOD), apertures that are checked (AP CHK), EBR, NAO and FNO, ANG and OBH, and a solve PY 0 behind
    the last surface. OSLO states one field, the largest: 0, 0.7 and 1 times its tangent are taken, or the field points
    that :func:`write_len` adds as comments. Decentred and special surfaces, pickups and other solves are refused by
    name.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.raytracing.system import first_order, load_system, read_len, write_len
    >>> lens = load_system("cooke_triplet")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "lens.len")
    ...     write_len(lens, name)
    ...     again, report = read_len(name)
    >>> round(float(first_order(again).focal_length - first_order(lens).focal_length), 6)
    0.0
    """
    file = LensFile.opened("read_len", path, glasses)
    with named_errors(file.path.name):
        head, surfaces = _commands(file)
        if len(surfaces) < 3:
            raise ValueError(f"a lens must have an object, a surface and an image, got {len(surfaces)} surfaces")
        found = _built(head, surfaces, file)
    return file.reported(found)


def _commands(file: LensFile) -> tuple[dict, list[dict]]:
    """Return the entries of the whole lens, and those of each surface."""
    head: dict[str, Any] = {}
    surfaces: list[dict[str, Any]] = [{}]
    lines = lens_text(file.path).splitlines()
    for number, line in enumerate(lines, start=1):
        if line.startswith(_POINT):
            point = Command(number, "a field point", line.removeprefix(_POINT).split())
            if len(point.words) != 7:
                raise ValueError(f"line {number}: a field point must have 7 numbers, got {len(point.words)}")
            head.setdefault("points", []).append(point.values())
    for command in _sentences(lines):
        if command.key == "END":
            return head, surfaces
        if command.key == "NXT":
            surfaces.append({})
        elif command.key in _INERT:
            file.ignored.append(command.text)
        elif not (_of_lens(head, command) or _of_surface(surfaces[-1], head, command)):
            raise command.unknown()
    raise ValueError("a lens must end with END")


def _sentences(lines: list[str]) -> Iterator[Command]:
    """Yield the commands; texts keep their quotation marks."""
    for number, line in enumerate(lines, start=1):
        for text in re.findall(r"(?:\"[^\"]*\"|[^;\"])+", line.split("//")[0]):
            if words := re.findall(r"\"[^\"]*\"|[^\s,]+", text):
                yield Command(number, words[0].upper(), words[1:])


def _of_lens(head: dict, command: Command) -> bool:
    """Enter a command about the whole lens; return whether it is one."""
    key = command.key
    if key == "LEN":
        head["name"] = next((word.strip('"') for word in command.words if word.startswith('"')), "")
    elif key in ("EBR", "NAO", "FNO", "ANG", "OBH", "UNI"):
        head[key] = command.value()
    elif key in ("WV", "WW"):
        head[key] = command.values()
    elif re.fullmatch(r"W[VW]\d+", key):
        values = head.setdefault(key[:2], list(WAVES) if key[1] == "V" else [1.0] * len(head.get("WV", WAVES)))
        place = int(key[2:])
        if not 1 <= place <= len(values) + 1:
            raise ValueError(f"line {command.number}: {key} must follow {key[:2]}{len(values)}")
        values[place - 1 : place] = [command.value()]
    else:
        return False
    return True


def _of_surface(entry: dict, head: dict, command: Command) -> bool:
    """Enter a command about a surface; return whether it is one."""
    key = command.key
    if key in ("AIR", "AIF", "RFL", "RFH", "AST"):
        entry[{"AIF": "AIR", "RFH": "RFL"}.get(key, key)] = True
    elif key in ("GLA", "GLF"):
        entry["GLA"] = [word.strip('"') for word in command.words], list(head.get("WV", WAVES))
    elif key in ("RD", "RDF", "CV", "CVF", "TH", "THF", "CC", "PFL", *_POWERS):
        entry[key[:2] if key != "PFL" else key] = command.value()
    elif key in ("AP", "APF"):
        entry["AP"] = command.value(-1), command.word == "CHK"
    elif key == "PY" and command.words and command.value() == 0:
        entry["PY"] = True
    else:
        return False
    return True


def _built(head: dict, entries: list[dict], file: LensFile) -> optical_system:
    """Return the system of a file that was read."""
    file.scale = scale = head.get("UNI", 1.0)
    if not scale > 0:
        raise ValueError(f"UNI, millimetres of a unit, must be positive, got {scale:g}")
    file.waves = [value * 1e-3 for value in head.get("WV", WAVES)]
    distance = file.object_distance(entries[0].get("TH", 1e20) * scale, 1e13)
    if math.isfinite(distance) and (entries[0].get("RD") or entries[0].get("CV")):
        raise ValueError("the object must be flat")
    items = [_surface(i, entry, file) for i, entry in enumerate(entries[1:-1], start=1)]
    image = _surface(len(entries) - 1, {key: value for key, value in entries[-1].items() if key != "TH"}, file)
    defocus = entries[-1].get("TH", 0.0) * scale
    system = file.maker_of_system(
        items,
        name=head.get("name") or None,
        reference=0,
        object_distance=distance,
        image=image_of(image),
        wavelength_weights=differing(head.get("WW", []), len(file.waves)),
    )
    solved = [i for i, entry in enumerate(entries[1:-1]) if entry.get("PY")]
    if any(i != len(items) - 1 for i in solved):
        raise ValueError(f"surface {solved[0] + 1}: PY, a solve, is understood behind the last surface only")
    size, form = _aperture(head, math.isfinite(distance))
    size = size * scale if form == "EPD" else size
    if not size:
        size, form = file.usual_pupil(system(1.0, "EPD"), "no aperture (EBR, NAO, FNO)")
    if form == "first":
        # The radius of the axial beam at the first surface.
        form, size = "NA", math.sin(math.atan(size * scale / 2 / distance))
    found = system(size, form)
    if solved:
        items[-1].thickness.fill_(float(first_order(found).image_distance))
    items[-1].thickness += defocus
    return system(size, form, **_fields(head, found, file))


def _aperture(head: dict, near: bool) -> tuple[float, str]:
    if "NAO" in head:
        return head["NAO"], "NA"
    if "EBR" in head:
        return 2 * head["EBR"], "first" if near else "EPD"
    if "FNO" in head and not near:
        return head["FNO"], "F-number"
    return 0.0, "EPD"


def _fields(head: dict, system, file: LensFile) -> dict[str, Any]:
    """Return the field points with weights and vignetting factors, or 0, 0.7 and 1 times the largest field."""
    points = head.get("points", [[share, 0.0, -1.0, 1.0, -1.0, 1.0, 1.0] for share in (0.0, 0.7, 1.0)])
    if system.at_infinity:
        largest = math.tan(math.radians(abs(head.get("ANG", 0.0))))
    elif "OBH" in head:
        largest = head["OBH"] * file.scale
    else:
        reach = system.object_distance + float(first_order(system).entrance_pupil_distance)
        largest = -reach * math.tan(math.radians(head.get("ANG", 0.0)))
    fields = [(x * largest, y * largest) for y, x, *_ in points]
    if system.at_infinity:
        fields = [(math.degrees(math.atan(x)), math.degrees(math.atan(y))) for x, y in fields]
    if "points" not in head:
        if not largest:
            return {"fields": [0.0]}
        file.notes.append("the file states the largest field: 0, 0.7 and 1 times its tangent or height are taken")
    found: dict[str, Any] = {"fields": fields}
    factors = [
        ((left + right) / 2, (low + high) / 2, 1 - (right - left) / 2, 1 - (high - low) / 2)
        for _, _, low, high, left, right, _ in points
    ]
    if any(map(any, factors)):
        found["vignetting_factors"] = factors
    if any(point[-1] != 1 for point in points):
        found["field_weights"] = [point[-1] for point in points]
    return found


def _surface(number: int, entry: dict, file: LensFile) -> surface:
    """Return one surface."""
    scale = file.scale
    radius = entry.get("RD", 0.0)
    bend = entry.get("CV", 1 / radius if radius else 0.0) / scale
    powers = [entry.get(key, 0.0) * scale ** (-3 - 2 * i) for i, key in enumerate(_POWERS)]
    shape = (
        EvenAsphere(bend, entry.get("CC", 0.0), [0.0, *powers]) if any(powers) else Conic(bend, entry.get("CC", 0.0))
    )
    medium: Any = AIR
    if entry.get("RFL"):
        medium = MIRROR
    elif "GLA" in entry:
        with named_errors(f"surface {number}"):
            words, waves = entry["GLA"]
            medium = _glass(number, words, waves, file)
    size, checked = entry.get("AP", (0.0, False))
    with named_errors(f"surface {number}"):
        return surface(
            shape=shape,
            thickness=entry.get("TH", 0.0) * scale,
            material=medium,
            semi_diameter=size * scale if checked and size else None,
            phase=IdealLens(entry["PFL"] * scale) if entry.get("PFL") else None,
            stop=bool(entry.get("AST")),
        )


def _glass(number: int, words: list[str], waves: list[float], file: LensFile):
    """Return a glass by its name, or by its indices at the wavelengths in force."""
    if not words:
        raise ValueError("GLA must name a glass or state its indices")
    name = words[0]
    if name.upper() == "MOD" and len(words) > 2:
        name, words = words[1], words[2:]
    if name in file.glasses:
        return file.glasses[name]
    numbers = [word for word in words if re.fullmatch(r"[\d.]+(?:[eE][+-]?\d+)?", word)]
    if len(numbers) == len(words):
        values = [float(word) for word in numbers]
        if len(values) == 1:
            return values[0]
        if len(values) > len(waves):
            raise ValueError(f"GLA must have an index at each of {len(waves)} wavelengths, got {len(values)}")
        return tabulated(name, waves[: len(values)], values, "indices of an OSLO file")
    return file.named_glass(number, name)


def write_len(system: optical_system, path: str | os.PathLike[str]) -> None:
    """Write a system as a lens file of OSLO, every digit of its numbers.

    Parameters
    ----------
    system : optical_system
        In any unit; written in millimetres.
    path : str or pathlib.Path
        File to write (.len).

    Raises
    ------
    ValueError
        If the system holds parts that cannot be written: surfaces that are decentred or of other shapes than conics
        with terms to r¹⁰, coordinate breaks, phases but ideal lenses, graded media, coatings, configurations,
        telecentric or afocal systems.

    Notes
    -----
    Of an aperture at the stop its entrance pupil is written. Glasses are written by their indices at the system's
    wavelengths, the primary one first. Of the fields OSLO takes the largest; all of them, their weights and their
    vignetting factors are comments, which :func:`read_len` understands.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.raytracing.system import load_system, read_len, write_len
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "lens.len")
    ...     write_len(load_system("double_gauss"), name)
    ...     again, report = read_len(name)
    >>> again.name
    'Double Gauss f/2'
    """
    path, text = _text("path", path), _len_text(without_derivatives(system))
    write_file(path, text.encode("utf-8"))


def _len_text(system) -> str:
    """Return the commands of a system in millimetres; numbers by `repr`, which is exact."""
    if system.telecentric or system.afocal:
        raise ValueError("telecentric and afocal systems are not written")
    if system.object_material != AIR:
        raise ValueError("a medium in front of the first surface is not written")
    if system.settings:
        raise ValueError(f"configurations are not written, got settings of {system.settings[0][0]}")
    scale, near = MICROMETRES[system.unit] / MICROMETRES["mm"], not system.at_infinity
    order = [system.reference, *(i for i in range(len(system.wavelengths)) if i != system.reference)]
    waves = " ".join(repr(system.wavelengths[i] * MICROMETRES[system.unit]) for i in order)
    with torch.no_grad():
        numbers, properties = system.prescription().index[order], first_order(system)
    size = 0.5 * float(properties.entrance_pupil_diameter) * scale
    lines = [
        "// OSLO 6.0",
        f'LEN NEW "{system.name}" {float(properties.focal_length) * scale!r} {len(system.surfaces) + 1}',
    ]
    if near:
        size = system.aperture if system.aperture_type == "NA" else math.nan
        if math.isnan(size):
            raise ValueError("the aperture of a near object must be given as NA")
    largest, points = _points(system)
    lines += [f"NAO {size!r}" if near else f"EBR {size!r}"]
    lines += [f"OBH {largest * scale!r}" if near else f"ANG {abs(largest)!r}", "UNI 1.0", *points, f"WV {waves}"]
    lines += ["WW " + " ".join(repr(float((system.wavelength_weights or [1.0] * len(order))[i])) for i in order)]
    lines += ["AIR", f"TH {system.object_distance * scale if near else 1e20!r}"]
    held = own_surfaces(system)
    for i, item in enumerate(held):
        lines += ["NXT", *_written(f"surfaces[{i}]", item, scale, numbers[:, i + 1], i, i == system.stop)]
    if system.image is not None:
        lines += ["NXT", *_written("image", system.image, scale, None, 0, False)]
    else:
        lines += ["NXT", "AIR"]
    return "\n".join([*lines, f"END {len(held) + 1}"]) + "\n"


def _points(system) -> tuple[float, list[str]]:
    """Return the largest field, and a comment for each field."""
    largest = max((value for field in system.fields for value in field), key=abs)
    if system.at_infinity and abs(largest) >= 90:
        raise ValueError(f"fields of 90 degrees and more are not written, got {largest:g} degrees")

    def size(value: float) -> float:
        return math.tan(math.radians(value)) if system.at_infinity else value

    unit = abs(size(largest)) if system.at_infinity else size(largest)
    factors = system.vignetting_factors or [(0.0,) * 4] * len(system.fields)
    weights = system.field_weights or [1.0] * len(system.fields)
    lines = []
    for (x, y), (dx, dy, cx, cy), weight in zip(system.fields, factors, weights, strict=True):
        parts = [size(y) / unit, size(x) / unit] if unit else [0.0, 0.0]
        parts += [dy - (1 - cy), dy + (1 - cy), dx - (1 - cx), dx + (1 - cx), weight]
        lines.append(" ".join([_POINT, *map(repr, parts)]))
    return largest, lines


def _written(name: str, item, scale: float, index, place: int, stop: bool) -> list[str]:
    if is_break(item) or item.is_off_axis or item.apertures:
        raise ValueError(
            f"{name} is a coordinate break, decentred, or has an aperture that is not a semi-diameter: not written"
        )
    if item.own_gradient is not None or item.own_coating is not None:
        raise ValueError(f"{name} has a graded index or a coating, which is not written")
    shape, phase = item.shape, item.phase
    if type(shape) not in (Conic, EvenAsphere):
        raise ValueError(f"{name} is a {type(shape).__name__}, which is not written")
    given = list(item.coefficients.tolist())
    if (given and given[0]) or len(given) > 5:
        raise ValueError(f"{name} has coefficients of r² or beyond r¹⁰, which are not written: {given}")
    lines = ["AIR"]
    if item.reflects:
        lines = ["RFL"]
    elif index is not None and item.material != AIR:
        lines = [f"GLA MOD G{place + 1} " + " ".join(map(repr, index.tolist()))]
    bend = float(item.curvature.detach()) / scale
    lines += [f"CV {bend!r}"] if bend else []
    lines += [f"CC {float(item.conic.detach())!r}"] if bool(item.conic) else []
    lines += [
        f"{key} {a * scale ** (-3 - 2 * i)!r}" for i, (key, a) in enumerate(zip(_POWERS, given[1:], strict=False))
    ]
    if phase is not None:
        if not isinstance(phase, IdealLens):
            raise ValueError(f"{name} has a {type(phase).__name__}, which is not written")
        lines += [f"PFL {float(torch.as_tensor(phase.focal_length).detach()) * scale!r}"]
    lines += [f"TH {float(item.thickness.detach()) * scale!r}"] if index is not None else []
    lines += [] if item.semi_diameter is None else [f"AP CHK {item.semi_diameter * scale!r}"]
    return lines + (["AST"] if stop else [])
