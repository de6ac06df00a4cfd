"""Zemax .zmx text files: what of them is understood becomes a system, the rest is reported or refused."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from odak.catalog.materials import material, nearest_materials
from odak.learn.raytracing.system.lens import checked_system, optical_system
from odak.learn.raytracing.system.surfaces import MIRROR, surface
from odak.learn.raytracing.system.zmx_text import Line, read_lines
from odak.tools._paths import _text

LENGTHS = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "INCH": 25.4, "METER": 1000.0, "M": 1000.0}
TYPES = ("STANDARD", "EVENASPH")
# Shapes of apertures that are not read.
BLOCKING = {"OBSC", "OBDC", "SQAP", "SQOB", "ELAP", "ELOB", "UDAP", "UDOB"}
# What changes nothing about the light that is traced here.
SILENT = {
    "VERS",
    "COMM",
    "HIDE",
    "MIRR",
    "SLAB",
    "POPS",
    "GCAT",
    "MODE",
    "NAME",
    "NOTE",
    "UNIT",
    "WAVM",
    "WAVL",
    "PWAV",
}
SILENT |= {
    "FTYP",
    "XFLN",
    "YFLN",
    "ENPD",
    "FNUM",
    "OBNA",
    "FLOA",
    "TYPE",
    "CURV",
    "CONI",
    "PARM",
    "DISZ",
    "GLAS",
    "STOP",
}


class ZmxReport(NamedTuple):
    """What was read and what was not.

    Attributes
    ----------
    ignored : tuple of str
        Every line that had no effect, as "line 12, surface 3: KEY words".
    notes : tuple of str
        Decisions that the file left open.
    """

    ignored: tuple[str, ...]
    notes: tuple[str, ...]


def read_zmx(path: Any, glasses: Mapping | None = None) -> tuple[optical_system, ZmxReport]:
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
        The system in millimetres, and a :class:`ZmxReport` of all that was ignored.

    Raises
    ------
    ValueError
        If the file is malformed, or holds what would change the light's way and is not understood: a surface type other
        than STANDARD and EVENASPH, fields by image height, a glass that is not in the catalogue (the message names the
        nearest known ones). No glass is ever guessed.

    Notes
    -----
    Semi-diameters (DIAM) limit rays only where the file says so, by a circular (CLAP) or floating (FLAP) aperture.
    """
    path = Path(_text("path", path))
    if glasses is not None and not isinstance(glasses, Mapping):
        raise TypeError(f"glasses must be a dictionary, got {type(glasses).__name__}")
    general, surfaces = read_lines(path)
    notes: list[str] = []
    ignored = [_named(line) for line in general if line.key not in SILENT]
    try:
        head = {line.key: line for line in reversed(general)}
        if "MODE" in head and head["MODE"].words[:1] != ("SEQ",):
            raise ValueError(f"MODE must be SEQ, got {' '.join(head['MODE'].words)!r}")
        unit = head["UNIT"].words[0].upper() if "UNIT" in head and head["UNIT"].words else "MM"
        if unit not in LENGTHS:
            raise ValueError(f"UNIT must be one of {', '.join(LENGTHS)}, got {unit!r}")
        scale = LENGTHS[unit]
        built = [
            _surface(number, lines, scale, dict(glasses or {}), ignored)
            for number, lines in enumerate(surfaces[1:-1], start=1)
        ]
        image = _image(len(surfaces) - 1, surfaces[-1], scale, ignored)
        _check_object(surfaces[0], ignored)
        distance = _of(surfaces[0], "DISZ", math.inf) * scale
        settings: dict[str, Any] = _general(general, head, surfaces, scale, math.isinf(distance), notes)
        name = " ".join(head["NAME"].words) if "NAME" in head else path.stem
        names: dict[str, Any] = {"unit": "mm", "name": name, "source": path.name}
        system = optical_system(built, object_distance=distance, image=image, **names, **settings)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
    if not any(item.stop for item in built):
        notes.append("no STOP: the first surface is taken as the stop")
    return system, ZmxReport(tuple(ignored), tuple(notes))


def _check_object(lines, ignored: list) -> None:
    """Raise ValueError for an object that is curved or not in air; note the rest."""
    for line in lines:
        if line.key == "GLAS" or (line.key in ("CURV", "CONI") and line.words and line.value()):
            raise ValueError(f"line {line.number}: the object must be flat and in air, got {' '.join(line.words)!r}")
        if line.key not in {*SILENT, "CURV", "CONI", "DISZ"}:
            ignored.append(_named(line, 0))


def _named(line: Line, surface_number: int | None = None) -> str:
    where = "" if surface_number is None else f", surface {surface_number}"
    return f"line {line.number}{where}: {' '.join((line.key, *line.words))}"


def _of(lines, key: str, default: float) -> float:
    return next((line.value() for line in lines if line.key == key), default)


def _surface(number: int, lines, scale: float, glasses: dict, ignored: list) -> surface:
    """Return one surface; what has no effect goes to `ignored`."""
    kind = next((line.words[0] for line in lines if line.key == "TYPE" and line.words), "STANDARD").upper()
    if kind not in TYPES:
        raise ValueError(f"surface {number}: TYPE must be one of {', '.join(TYPES)}, got {kind!r}")
    coefficients, limit, inner = {}, None, 0.0
    for line in lines:
        if line.key == "PARM" and kind == "EVENASPH":
            power = line.whole()
            if not 1 <= power <= 8:
                raise ValueError(f"line {line.number}: PARM must be 1 to 8, got {power}")
            coefficients[power] = line.value(1) * scale ** (1 - 2 * power)
        elif line.key == "CLAP":
            # Minimum and maximum radius; older files have a leading 0.
            inner, limit = line.value(0), line.value(1) * scale
            if inner:
                raise ValueError(f"line {line.number}: CLAP with a hole (minimum radius {inner:g}) is not supported")
        elif line.key in BLOCKING:
            raise ValueError(f"line {line.number}: {line.key} blocks light and is not supported")
        elif line.key == "FLAP":
            limit = _of(lines, "DIAM", 0.0) * scale
        elif line.key not in SILENT or (line.key == "PARM" and len(line.words) > 1 and line.value(1)):
            ignored.append(_named(line, number))
    return surface(
        curvature=_of(lines, "CURV", 0.0) / scale,
        conic=_of(lines, "CONI", 0.0),
        coefficients=[coefficients.get(power, 0.0) for power in range(1, max(coefficients, default=0) + 1)],
        thickness=_of(lines, "DISZ", 0.0) * scale,
        material=_glass(number, lines, glasses),
        semi_diameter=limit or None,
        stop=any(line.key == "STOP" for line in lines),
    )


def _glass(number: int, lines, glasses: dict):
    """Return the medium behind a surface."""
    line = next((line for line in lines if line.key == "GLAS" and line.words), None)
    if line is None:
        return "air"
    name = line.words[0]
    if name in glasses:
        return glasses[name]
    if name.upper() == "MIRROR":
        return MIRROR
    try:
        return material(name)
    except ValueError as error:
        near = ""
        # Files carry nd and Vd beside the name; model glasses have nothing else.
        if len(line.words) > 4 and line.value(3) > 1 and line.value(4) > 0:
            nd, vd = line.value(3), line.value(4)
            near = f" Nearest to its nd = {nd:g}, Vd = {vd:g}: {', '.join(nearest_materials(nd, vd))}."
        raise ValueError(f"surface {number}: {error}.{near} Or pass glasses={{{name!r}: …}} to read_zmx") from None


def _image(number: int, lines, scale: float, ignored: list) -> surface | None:
    """Return the image surface, None for a plane; a glass behind it has no effect."""
    ignored += [_named(line, number) for line in lines if line.key == "GLAS"]
    found = _surface(number, [line for line in lines if line.key not in ("GLAS", "DISZ", "STOP")], scale, {}, ignored)
    plain = found.curvature == 0 and not bool(found.coefficients.any()) and found.semi_diameter is None
    return None if plain else found


def _general(general, head, surfaces, scale: float, far: bool, notes: list) -> dict:
    """Return aperture, fields and wavelengths."""
    kind = head["FTYP"].whole() if "FTYP" in head else 0
    if kind not in (0, 1) or (kind == 0) != far:
        raise ValueError(f"FTYP must be 0 (angles, object at infinity) or 1 (object heights, object near), got {kind}")
    x, y = (_numbers(head.get(key)) for key in ("XFLN", "YFLN"))
    count = _count(head, 2) or max([1, *(i + 1 for i, pair in enumerate(_pairs(x, y)) if any(pair))])
    factor = 1.0 if kind == 0 else scale
    fields = [(a * factor, b * factor) for a, b in _pairs(x, y)[:count]] or [(0.0, 0.0)]
    waves = [line.value(1) for line in general if line.key == "WAVM"]
    waves = waves or [value for line in general if line.key == "WAVL" for value in _numbers(line)]
    number = _count(head, 3)
    if not number:
        # Unused wavelengths stand at 0.55 µm behind those in use.
        number = max([1, *(i + 1 for i, value in enumerate(waves) if value != 0.55)]) if waves else 0
        if waves:
            notes.append(f"FTYP does not say how many wavelengths: the first {number} are taken")
    waves = [value * 1e-3 for value in waves[:number]] or [587.5618e-6]
    reference = head["PWAV"].whole() - 1 if "PWAV" in head else len(waves) // 2
    size, form = _aperture(head, surfaces, scale, notes)
    return {
        "aperture": size,
        "aperture_type": form,
        "fields": fields,
        "wavelengths": waves,
        "reference": min(max(reference, 0), len(waves) - 1),
    }


def _numbers(line) -> list[float]:
    return [] if line is None else [line.value(i) for i in range(len(line.words))]


def _pairs(x, y) -> list[tuple[float, float]]:
    count = max(len(x), len(y))
    return list(zip(*(value + [0.0] * (count - len(value)) for value in (x, y)), strict=True))


def _count(head, place: int) -> int:
    return head["FTYP"].whole(place) if "FTYP" in head and len(head["FTYP"].words) > place else 0


def _aperture(head, surfaces, scale: float, notes: list) -> tuple[float, str]:
    if "ENPD" in head:
        return head["ENPD"].value() * scale, "EPD"
    if "FNUM" in head:
        if len(head["FNUM"].words) > 1 and head["FNUM"].value(1):
            notes.append("FNUM is a working F-number; taken as that of infinite conjugates")
        return head["FNUM"].value(), "F-number"
    if "OBNA" in head:
        return head["OBNA"].value(), "NA"
    if "FLOA" in head:
        stop = next((lines for lines in surfaces if any(line.key == "STOP" for line in lines)), surfaces[1])
        return 2 * _of(stop, "DIAM", 0.0) * scale, "stop"
    raise ValueError("no aperture: one of ENPD, FNUM, OBNA, FLOA must be given")


def write_zmx(system: optical_system, path: Any) -> None:
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
        If the system holds what the format's plain surfaces cannot say: shifts, tilts, or a medium without a name.
    """
    from odak.learn.raytracing.system.zmx_writer import text_of
    from odak.tools._atomic import replacing

    path, text = _text("path", path), text_of(checked_system(system))
    with replacing(path) as stream:
        stream.write(text.encode("utf-8"))
