"""Reading materials from JSON, with every entry checked."""

import json
import math
import os
import sys
from numbers import Real
from pathlib import Path
from typing import Any

from odak import _validate
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
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not a JSON file of materials: {error}") from error
    entries = content.get("materials") if isinstance(content, dict) else None
    if not isinstance(entries, dict) or not entries:
        raise ValueError(f'{path} must hold an object {{"materials": {{name: entry, …}}}}, with at least one entry')
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
        raise ValueError(f'{where} needs a "source": say where its coefficients come from')
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
        raise ValueError(f"{where}: {' and '.join(kind.lists)} must be of one length")
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
