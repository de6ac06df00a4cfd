"""Materials in files: JSON, glass catalogues (AGF) and entries of refractiveindex.info, with their checks."""

import json
import math
import os
import sys
from numbers import Real
from pathlib import Path
from typing import Any

from odak import _validate
from odak._warnings import ArgumentWarning, warn
from odak.catalog.dispersion import FORMULAS, LINE_D, MEDIA, Material

_KNOWN = {"formula", "A", "B", "C", "range", "relative_to", "nd", "vd", "source"}


def read_materials(path) -> tuple[list[Material], dict[str, str]]:
    """Return the materials and aliases of a JSON file.

    Parameters
    ----------
    path : str or pathlib.Path
        File ``{"materials": {name: entry, …}, "aliases": {alias: name, …}}``; aliases may be left out. An entry holds
        "formula", its coefficients for micrometres, "range" in micrometres and "source", and may hold "relative_to"
        ("air" unless given), "nd" and "vd".

    Returns
    -------
    tuple
        Materials, and a dict from alias to name.

    Raises
    ------
    ValueError
        If the file is not such JSON, an entry is incomplete or malformed, its formula gives no index, or contradicts
        its nd (by more than 2e-5) or vd (by more than 0.1); the message names file, entry and key.
    FileNotFoundError
        If there is no such file.
    """
    path = Path(os.path.expanduser(path))
    if path.suffix.lower() == ".agf":
        return read_agf(path), {}
    if path.suffix.lower() in (".yml", ".yaml"):
        return [read_entry(path)], {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not a JSON file of materials: {error}") from error
    entries = content.get("materials") if isinstance(content, dict) else None
    if not isinstance(entries, dict) or not entries:
        raise ValueError(f'{path} must contain an object {{"materials": {{name: entry, …}}}}, with at least one entry')
    aliases = content.get("aliases", {})
    if not isinstance(aliases, dict) or not all(isinstance(name, str) for name in aliases.values()):
        raise ValueError(f'{path}: "aliases" must map names to names')
    return [_material(f"{path}: {name!r}", name, entry) for name, entry in entries.items()], aliases


def _material(where: str, name: str, entry) -> Material:
    if not isinstance(entry, dict):
        raise ValueError(f"{where} must be an object, got {type(entry).__name__}")
    unknown = sorted(set(entry) - _KNOWN)
    if unknown:
        raise ValueError(f"{where} has unknown keys {', '.join(unknown)}; accepted: {', '.join(sorted(_KNOWN))}")
    if not isinstance(entry.get("source"), str) or not entry["source"].strip():
        raise ValueError(f'{where} needs a "source", the origin of its coefficients')
    formula = _validate.one_of(f"{where} formula", entry.get("formula", ""), FORMULAS)
    made = Material(
        name,
        formula,
        _coefficients(where, formula, entry),
        _range(where, entry.get("range")),
        _validate.one_of(f"{where} relative_to", entry.get("relative_to", "air"), MEDIA),
        entry["source"],
        _optional(where, "nd", entry),
        _optional(where, "vd", entry),
    )
    _check_against_published(where, made)
    return made


def _coefficients(where: str, formula: str, entry) -> dict:
    kind = FORMULAS[formula]
    found: dict[str, Any] = {}
    for key in kind.lists:
        value = entry.get(key)
        if not isinstance(value, list) or not value or not all(map(_is_number, value)):
            raise ValueError(f"{where}: {key} must be a list of finite numbers for {formula}, got {value!r}")
        found[key] = tuple(map(float, value))
    for key in kind.numbers:
        if key in entry:
            found[key] = _optional(where, key, entry)
    if len({len(found[key]) for key in kind.lists}) > 1:
        raise ValueError(
            f"{where}: {' and '.join(kind.lists)} must have equal lengths, "
            f"got {[len(found[key]) for key in kind.lists]}"
        )
    return found


def _range(where: str, value) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2 or not all(map(_is_number, value)) or not 0 < value[0] < value[1]:
        raise ValueError(f"{where}: range must be [shortest, longest] wavelength in micrometres, got {value!r}")
    return float(value[0]), float(value[1])


def _optional(where: str, key: str, entry) -> float | None:
    value = entry.get(key)
    if value is not None and not _is_number(value):
        raise ValueError(f"{where}: {key} must be a finite number, got {value!r}")
    return None if value is None else float(value)


def _is_number(value) -> bool:
    # An integer beyond the range of floats is a number to JSON and to Python.
    largest: Any = sys.float_info.max
    return isinstance(value, Real) and not isinstance(value, bool) and abs(value) <= largest


def _check_against_published(where: str, made: Material) -> None:
    for wavelength in (made.range[0], sum(made.range) / 2, made.range[1]):
        index = _value(made.index, wavelength)
        if isinstance(index, complex) or not index > 0:
            raise ValueError(f"{where}: the formula gives an index of {index:.6g} at {wavelength:g} µm")
    for key, tolerance, value in (
        ("nd", 2e-5, _value(made.index, LINE_D)),
        ("vd", 0.1, _value(made.abbe_number)),
    ):
        stated = getattr(made, key)
        if stated is not None and (isinstance(value, complex) or not abs(value - stated) <= tolerance):
            raise ValueError(f"{where}: {key} is stated as {stated} but its formula gives {value:.6g}")


def _value(function, *arguments):
    try:
        return function(*arguments)
    except ArithmeticError:
        return math.nan


# The dispersion formulas of glass catalogues by their numbers: powers of λ in n², or None for those built apart.
_AGF_POWERS = {
    1: (0, 2, -2, -4, -6, -8),
    10: (0, 2, -2, -4, -6, -8, -10, -12),
    12: (0, 2, -2, -4, -6, -8, 4, 6),
    13: (0, 2, 4, -2, -4, -6, -8, -10, -12),
}


def read_agf(path) -> list[Material]:
    """Return the materials of a glass catalogue in the AGF format.

    Parameters
    ----------
    path : str or pathlib.Path
        Text file, UTF-8, UTF-16 or Latin-1, up to 16 MiB.

    Returns
    -------
    list of Material
        In the order of the file. Glasses whose formula is not known (numbers 3 and above 13) are left out with an
        ArgumentWarning that names them.

    Raises
    ------
    ValueError
        If a line of a glass is malformed, or the file holds no glass.
    """
    path = Path(os.path.expanduser(path))
    found: list[Material] = []
    unknown: list[str] = []
    head: list[str] = []
    numbers: list[float] = []
    limits: list[float] = []
    passed: list[list[float]] = []

    def finish() -> None:
        if not head:
            return
        made = _from_agf(path, head, numbers, limits, passed)
        found.append(made) if made is not None else unknown.append(head[0])

    for line, text in enumerate(_catalogue_text(path).splitlines(), start=1):
        words = text.split()
        if not words:
            continue
        if words[0] == "NM":
            finish()
            head, numbers, limits, passed = words[1:], [], [], []
        try:
            if words[0] == "CD":
                numbers = [float(word) for word in words[1:]]
            elif words[0] == "LD":
                limits = [float(word) for word in words[1:3]]
            elif words[0] == "IT" and len(words) > 3:
                passed.append([float(word) for word in words[1:4]])
        except ValueError as error:
            raise ValueError(f"{path.name}, line {line}: {error}") from None
    finish()
    if not found:
        raise ValueError(f"{path.name} contains no glass whose dispersion formula is known")
    if unknown:
        warn(f"{path.name}: skipped {', '.join(unknown[:8])}, whose dispersion formula is not known", ArgumentWarning)
    return found


def _catalogue_text(path: Path) -> str:
    if path.stat().st_size > 16 << 20:
        raise ValueError(f"{path.name}: must be of at most 16 MiB, got {path.stat().st_size / 2**20:.1f} MiB")
    data = path.read_bytes()
    for encoding in ("utf-16",) if data[:2] in (b"\xff\xfe", b"\xfe\xff") else ("utf-8-sig", "latin-1"):
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise ValueError(f"{path.name}: not a text file")


def _from_agf(path: Path, head: list[str], c: list[float], limits: list[float], passed: list) -> Material | None:
    """Return a glass of an AGF file, None for an unknown formula.

    `head` are the words of its line NM, then come coefficients, range, and the lines of internal transmission.
    """
    if len(head) < 5 or len(limits) < 2 or not 0 < limits[0] < limits[1] or not all(map(math.isfinite, c)):
        raise ValueError(f"{path.name}: glass {head[0] if head else ''!r} lacks numbers or its range of wavelengths")
    name, kind, nd, vd = head[0], int(float(head[1])), float(head[3]), float(head[4])
    c = c + [0.0] * 12
    made: dict[str, Any]
    if kind in _AGF_POWERS:
        powers = _AGF_POWERS[kind]
        formula, made = "polynomial", {"A": tuple(c[: len(powers)]), "P": tuple(map(float, powers))}
    elif kind in (2, 6, 11):
        count = {2: 3, 6: 4, 11: 5}[kind]
        formula, made = "sellmeier", {"B": tuple(c[: 2 * count : 2]), "C": tuple(c[1 : 2 * count : 2])}
    elif kind == 4:
        formula, made = "sellmeier", {"A": 1 + c[0], "B": (c[1], c[3]), "C": (c[2] ** 2, c[4] ** 2)}
    elif kind == 9:
        formula, made = "sellmeier", {"A": c[0], "B": (c[1], c[3]), "C": (c[2], c[4])}
    elif kind == 5:
        formula, made = "conrady", {"A": tuple(c[:3]), "P": (0.0, -1.0, -3.5)}
    elif kind == 7:
        formula, made = "handbook", {"A": (c[0], -c[3]), "P": (0.0, 2.0), "B": (c[1],), "C": (c[2],)}
    elif kind == 8:
        # B·λ²/(λ² − C) = B + B·C/(λ² − C).
        formula = "handbook"
        made = {"A": (c[0] + c[1], -c[3]), "P": (0.0, 2.0), "B": (c[1] * c[2],), "C": (c[2],)}
    else:
        return None
    glass = Material(name, formula, made, (limits[0], limits[1]), "air", f"glass catalogue {path.name}")
    index = _value(glass.index, LINE_D)
    if nd > 1 and limits[0] <= LINE_D <= limits[1] and not abs(index - nd) < 2e-3:
        raise ValueError(f"{path.name}: {name} states nd = {nd} but its formula gives {index:.6g}")
    extinction = _extinction(passed)
    return Material(name, formula, made, glass.range, "air", glass.source, nd or None, vd or None, extinction)


def _extinction(passed: list) -> tuple | None:
    """Return wavelengths and κ = −λ·ln τ/(4πd) of internal transmittances τ through thicknesses d in millimetres."""
    rows = {w: (max(t, 1e-10), d) for w, t, d in passed if w > 0 and d > 0 and 0 <= t <= 1}
    if len(rows) < 2:
        return None
    places = tuple(sorted(rows))
    return places, tuple(-math.log(rows[w][0]) * w * 1e-3 / (4 * math.pi * rows[w][1]) for w in places)


def read_entry(path) -> Material:
    """Return the material of an entry of refractiveindex.info.

    Parameters
    ----------
    path : str or pathlib.Path
        The entry's YAML file, as its page offers it for download.

    Returns
    -------
    Material
        Named after the file; its index is counted in vacuum unless it comes from a maker's catalogue.

    Raises
    ------
    ValueError
        If the entry has none of the formulas 1, 2, 3 and 5, or is malformed.
    """
    path = Path(os.path.expanduser(path))
    kind, source = "", ""
    limits: list[float] = []
    numbers: list[float] = []
    lines = _catalogue_text(path).splitlines()
    for i, text in enumerate(lines):
        key, _, value = text.strip().lstrip("- ").partition(":")
        if key == "type" and value.strip().startswith("formula ") and not kind:
            kind = value.strip().removeprefix("formula ")
        elif key == "wavelength_range" and kind and not limits:
            limits = [float(word) for word in value.split()]
        elif key == "coefficients" and kind and not numbers:
            numbers = [float(word) for word in value.split()]
        elif key == "REFERENCES":
            source = (
                value.strip() if value.strip() not in ("", "|") else lines[i + 1].strip() if i + 1 < len(lines) else ""
            )
    if kind not in ("1", "2", "3", "5") or len(limits) != 2 or len(numbers) < 3:
        raise ValueError(f"{path.name} must contain formula 1, 2, 3 or 5 with its range and coefficients, got {kind!r}")
    first, rest = numbers[0], numbers[1:]
    made: dict[str, Any]
    if kind in ("1", "2"):
        poles = tuple(c * c for c in rest[1::2]) if kind == "1" else tuple(rest[1::2])
        formula, made = "sellmeier", {"A": 1 + first, "B": tuple(rest[::2]), "C": poles}
    else:
        formula = "polynomial" if kind == "3" else "conrady"
        made = {"A": (first, *rest[::2]), "P": (0.0, *rest[1::2])}
    medium = "air" if "catalog" in source.lower() else "vacuum"
    source = source or "refractiveindex.info"
    extinction = _tabulated(lines)
    return Material(path.stem, formula, made, (limits[0], limits[1]), medium, source, extinction=extinction)


def _tabulated(lines: list[str]) -> tuple | None:
    """Return wavelengths and values of the table of κ in an entry."""
    rows, inside = [], False
    for text in lines:
        words = text.replace("- ", "").split()
        if words[:1] == ["type:"]:
            inside = words[1:] == ["tabulated", "k"]
        elif inside and len(words) == 2 and words[0][0].isdigit():
            rows.append((float(words[0]), float(words[1])))
    rows.sort()
    return (tuple(w for w, _ in rows), tuple(k for _, k in rows)) if len(rows) > 1 else None
