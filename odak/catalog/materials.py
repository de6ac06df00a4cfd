"""Refractive indices of glasses, crystals, plastics, water and air: dispersion formulas, the catalogue, and files.

Dispersion formulas take wavelengths in micrometres. Files of materials are JSON, glass catalogues (AGF) and entries of
refractiveindex.info. The sources of the catalogue are in ``odak/catalog/data/materials.json``.
"""

import difflib
import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from odak import _array, _validate
from odak._array import Amount, Array
from odak._lengths import expansion_in, in_unit, likely_length
from odak._warnings import AccuracyWarning, ArgumentWarning, warn
from odak.tools.paths import naming, regular_file, validate_path

LINE_D, LINE_F, LINE_C, LINE_G = 0.5875618, 0.4861327, 0.6562725, 0.4358343
MEDIA = ("air", "vacuum")
HERZBERGER_POLE = 0.1673**2
# An index is an array where the wavelength is one.
Wavelength = TypeVar("Wavelength", bound=float | Array)


@dataclass(frozen=True)
class OpticalMaterial:
    """A material with its dispersion formula.

    Parameters
    ----------
    name : str
        Name in the catalogue.
    formula : str
        "sellmeier", "cauchy", "gas", "polynomial", "conrady", "handbook" or "herzberger"; see :data:`FORMULAS`.
    coefficients : mapping
        What the formula takes, for wavelengths in micrometres.
    range : tuple of float
        Shortest and longest wavelength of validity, in micrometres.
    relative_to : str
        "air" or "vacuum": in what the published index is counted.
    source : str
        Source of the coefficients.
    nd : float, optional
        Published index at the helium d line (587.6 nm).
    vd : float, optional
        Published Abbe number (n_d − 1)/(n_F − n_C).
    extinction : pair of tuple of float, optional
        Wavelengths in micrometres, and extinction coefficients κ at them.
    thermal : tuple of float, optional
        Schott's constants D₀, D₁, D₂, E₀, E₁ and λ_TK (micrometres) of dn/dT.
    expansion : float, optional
        Coefficient of linear expansion per kelvin.
    measured_at : float
        Temperature in degrees Celsius to which the coefficients of the index belong.
    environment : pair of float, optional
        Temperature in degrees Celsius and pressure of air in pascal at which the material is used; see :meth:`at`.

    Examples
    --------
    >>> from odak.catalog import OpticalMaterial
    >>> glass = OpticalMaterial("own", "cauchy", {"A": [1.5, 0.004]}, (0.4, 0.8), "air", "measured")
    >>> glass.range
    (0.4, 0.8)
    """

    name: str
    formula: str
    coefficients: Mapping[Any, Any]
    range: tuple[float, float]
    relative_to: str
    source: str
    nd: float | None = None
    vd: float | None = None
    extinction: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    thermal: tuple[float, ...] | None = None
    expansion: float | None = None
    measured_at: float = 20.0
    environment: tuple[Any, Any] | None = None

    def __post_init__(self) -> None:
        if self.expansion is not None:
            expansion_in(f"expansion of {self.name}", self.expansion)

    def at(self, temperature: float | Array, pressure: float | Array = 101325.0) -> "OpticalMaterial":
        """Return the material at a temperature in degrees Celsius, in air of a pressure in pascal.

        Parameters
        ----------
        temperature, pressure : float or array
            A number, or one of a graph.
        """
        return replace(self, environment=(temperature, pressure))

    def index(self, wavelength: Wavelength) -> Wavelength:
        """Return the index as published at `wavelength` micrometres (an array in double precision or a number)."""
        return FORMULAS[self.formula].compute(wavelength**2, self.coefficients)

    def abbe_number(self) -> float:
        """Return (n_d − 1)/(n_F − n_C) from the formula; infinite without dispersion."""
        spread = self.index(LINE_F) - self.index(LINE_C)
        return (self.index(LINE_D) - 1) / spread if spread else math.inf


@dataclass(frozen=True)
class Formula:
    """A dispersion formula: its function of the squared wavelength, and the lists of coefficients it takes."""

    compute: Callable[..., Any]
    lists: tuple[str, ...]
    numbers: tuple[str, ...] = ()


def sellmeier(squared: Array | float, coefficients: dict[str, Any]) -> Array | complex | float:
    """Return sqrt(A + Σ B·λ²/(λ² − C)), A = 1 unless given (W. Sellmeier, Ann. Phys. 219, 272 (1871))."""
    terms = zip(coefficients["B"], coefficients["C"], strict=True)
    total = coefficients.get("A", 1.0) + sum(b * squared / (squared - c) for b, c in terms)
    return _array.namespace(total).sqrt(total) if _array.is_array(total) else total**0.5


def cauchy(squared: Array | float, coefficients: dict[str, Any]) -> Array | float:
    """Return A₀ + A₁/λ² + A₂/λ⁴ + …, for all coefficients A."""
    return sum((a / squared**k for k, a in enumerate(coefficients["A"])), 0 * squared)


def gas(squared: Array | float, coefficients: dict[str, Any]) -> Array | float:
    """Return 1 + Σ B/(C − 1/λ²), the form of Edlén and Ciddor."""
    return 1 + sum(b / (c - 1 / squared) for b, c in zip(coefficients["B"], coefficients["C"], strict=True))


def polynomial(squared: float, coefficients: dict[str, Any]) -> float:
    """Return sqrt(Σ A·λ^P): the formula of Schott's older catalogues and its extensions."""
    total = conrady(squared, coefficients)
    return _array.namespace(total).sqrt(total) if _array.is_array(total) else total**0.5


def conrady(squared: float, coefficients: dict[str, Any]) -> float:
    """Return Σ A·λ^P, n itself, as in Conrady's n = A + B/λ + C/λ^3.5."""
    return sum(a * squared ** (p / 2) for a, p in zip(coefficients["A"], coefficients["P"], strict=True))


def handbook(squared: float, coefficients: dict[str, Any]) -> float:
    """Return sqrt(Σ A·λ^P + Σ B/(λ² − C)), the form of the Handbook of Optics."""
    poles = sum(b / (squared - c) for b, c in zip(coefficients["B"], coefficients["C"], strict=True))
    total = conrady(squared, coefficients) + poles
    return _array.namespace(total).sqrt(total) if _array.is_array(total) else total**0.5


def herzberger(squared: Any, coefficients: Any) -> Any:
    """Return Σ A·λ^P + B₀·L + B₁·L² and so on, L = 1/(λ² − 0.028): M. Herzberger, Opt. Acta 6, 197 (1959)."""
    pole = 1 / (squared - HERZBERGER_POLE)
    return conrady(squared, coefficients) + sum(b * pole ** (k + 1) for k, b in enumerate(coefficients["B"]))


def table(squared: Array | float, coefficients: dict[str, Any]) -> Array | float:
    """Return the index between tabulated values: cubic polynomials in 1/λ² through the four nearest of them."""
    places, values = coefficients["W"], coefficients["N"]
    count, found = min(4, len(places)), 0 * squared
    for first in range(len(places) - count + 1):
        # The pieces meet at the tabulated values, beyond the first and the last of which they are continued.
        rows = range(first, first + count)
        piece = sum(
            values[i]
            * math.prod((1 / squared - places[j] ** -2) / (places[i] ** -2 - places[j] ** -2) for j in rows if j != i)
            for i in rows
        )
        start = squared >= (0.0 if not first else places[first + 1] ** 2)
        if _array.is_array(squared):
            found = _array.namespace(squared).where(start, piece + 0 * squared, found)
        elif start:
            found = piece
    return found


def tabulated(name: str, wavelengths: Iterable[float], values: Iterable[float], source: str) -> OpticalMaterial:
    """Return a material by its indices at some wavelengths in micrometres, relative to air."""
    rows = sorted(zip(wavelengths, values, strict=True))
    if not rows or any(not (place > 0 and value > 0) for place, value in rows):
        raise ValueError(f"{name} must have positive wavelengths and indices, got {rows!r:.80}")
    if len({place for place, _ in rows}) < len(rows):
        raise ValueError(f"{name} must have different wavelengths, got {[place for place, _ in rows]!r:.80}")
    places, indices = (tuple(map(float, part)) for part in zip(*rows, strict=True))
    reach = (places[0], places[-1]) if len(places) > 1 else (0.2, 20.0)
    return OpticalMaterial(name, "table", {"W": places, "N": indices}, reach, "air", source)


def model_glass(
    nd: float, vd: float, dpgf: float = 0.0, *, like: str | OpticalMaterial | None = None
) -> OpticalMaterial:
    """Return a model glass of given index and dispersion, as patents and lens files state them.

    Parameters
    ----------
    nd : float
        Index at the d line, 587.6 nm.
    vd : float
        Abbe number (n_d − 1)/(n_F − n_C).
    dpgf : float
        Deviation of the relative partial dispersion (n_g − n_F)/(n_F − n_C) from the normal line
        0.6438 − 0.001682·vd of Schott's glasses.
    like : str or OpticalMaterial, optional
        Material whose expansion and constants of dn/dT it has, such as the nearest of :func:`nearest_materials`: an
        index and an Abbe number do not tell them. Without, both are unknown.

    Returns
    -------
    OpticalMaterial
        n = A + B/λ² + C/λ⁴ through the three statements, for 0.35 to 1.1 micrometres.

    Raises
    ------
    ValueError
        If nd is not above 1 or vd not positive, or `like` is not known or has no known expansion or dn/dT.

    Examples
    --------
    >>> from odak.catalog import model_glass, refractive_index
    >>> round(refractive_index(model_glass(1.5168, 64.17), 656.2725e-9), 4)
    1.5144
    """
    nd = _validate.constant("nd", nd, positive=True)
    vd, dpgf = _validate.constant("vd", vd, positive=True), _validate.constant("dpgf", dpgf)
    if nd <= 1:
        raise ValueError(f"nd must be above 1, got {nd}")
    coefficients = {"A": cauchy_through(nd, vd, dpgf)}
    name = f"model {nd:g} {vd:g}" + (f" {dpgf:g}" if dpgf else "")
    glass = OpticalMaterial(name, "cauchy", coefficients, (0.35, 1.1), "air", "index and Abbe number", nd, vd)
    if like is None:
        return glass
    try:
        other = material(like) if isinstance(like, str) else like
    except ValueError as error:
        raise ValueError(f"like: {error}") from None
    thermal, expansion, measured_at = thermal_of(_validate.instance("like", other, OpticalMaterial, "a material"))
    if thermal is None or expansion is None:
        raise ValueError(f"like must be a material whose expansion and dn/dT are known, got {other.name}")
    return replace(glass, thermal=thermal, expansion=expansion, measured_at=measured_at)


def cauchy_through(nd: Any, vd: Any, dpgf: Any = 0.0) -> tuple[Any, ...]:
    """Return A, B, C of n = A + B/λ² + C/λ⁴ with the stated index and dispersion, numbers or arrays."""
    spread = (nd - 1) / vd
    partial = (0.6438 - 0.001682 * vd + dpgf) * spread
    # Two differences of the series give B and C, the d line gives A.
    d, f, c, g = (1 / line**2 for line in (LINE_D, LINE_F, LINE_C, LINE_G))
    matrix = (f - c, f * f - c * c), (g - f, g * g - f * f)
    determinant = matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0]
    first = (spread * matrix[1][1] - partial * matrix[0][1]) / determinant
    second = (partial * matrix[0][0] - spread * matrix[1][0]) / determinant
    return nd - first * d - second * d * d, first, second


FORMULAS = {
    "sellmeier": Formula(sellmeier, ("B", "C"), ("A",)),
    "cauchy": Formula(cauchy, ("A",)),
    "gas": Formula(gas, ("B", "C")),
    "polynomial": Formula(polynomial, ("A", "P")),
    "conrady": Formula(conrady, ("A", "P")),
}
# Read from glass catalogues, not from JSON.
FORMULAS["handbook"] = Formula(handbook, ("A", "P", "B", "C"))
FORMULAS["table"] = Formula(table, ("W", "N"))
FORMULAS["herzberger"] = Formula(herzberger, ("A", "P", "B"))


_KNOWN = {"formula", "A", "B", "C", "P", "range", "relative_to", "nd", "vd", "source"}


def read_materials(path: Path | str) -> tuple[list[OpticalMaterial], dict[str, str]]:
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
    with naming(path):
        if path.suffix.lower() == ".agf":
            return read_agf(path), {}
        if path.suffix.lower() in (".yml", ".yaml"):
            return [read_entry(path)], {}
    with _validate.refusing(f"{path} is not a JSON file of materials: ", ValueError, RecursionError):
        content = json.loads(Path(regular_file(str(path))).read_text(encoding="utf-8"))
    entries = content.get("materials") if isinstance(content, dict) else None
    if not isinstance(entries, dict) or not entries:
        raise ValueError(f'{path} must contain an object {{"materials": {{name: entry, …}}}}, with at least one entry')
    aliases = content.get("aliases", {})
    if not isinstance(aliases, dict) or not all(isinstance(name, str) for name in aliases.values()):
        raise ValueError(f'{path}: "aliases" must map names to names')
    return [_material(f"{path}: {name!r}", name, entry) for name, entry in entries.items()], aliases


def _material(where: str, name: str, entry) -> OpticalMaterial:
    if not isinstance(entry, dict):
        raise ValueError(f"{where} must be an object, got {type(entry).__name__}")
    unknown = sorted(set(entry) - _KNOWN)
    if unknown:
        raise ValueError(f"{where} has unknown keys {', '.join(unknown)}; accepted: {', '.join(sorted(_KNOWN))}")
    if not isinstance(entry.get("source"), str) or not entry["source"].strip():
        raise ValueError(f'{where} needs a "source", the origin of its coefficients')
    formula = _validate.one_of(f"{where} formula", entry.get("formula", ""), FORMULAS)
    made = OpticalMaterial(
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


def _coefficients(where: str, formula: str, entry) -> dict[Any, Any]:
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
    # Lists belong together in pairs: factors with powers, factors with poles.
    if any(len({len(found[key]) for key in kind.lists[i : i + 2]}) > 1 for i in range(0, len(kind.lists), 2)):
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


def _check_against_published(where: str, made: OpticalMaterial) -> None:
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
    1: (0.0, 2.0, -2.0, -4.0, -6.0, -8.0),
    10: (0.0, 2.0, -2.0, -4.0, -6.0, -8.0, -10.0, -12.0),
    12: (0.0, 2.0, -2.0, -4.0, -6.0, -8.0, 4.0, 6.0),
    13: (0.0, 2.0, 4.0, -2.0, -4.0, -6.0, -8.0, -10.0, -12.0),
}
_AGF_TERMS = {2: 3, 6: 4, 11: 5}
# The formula of the other numbers and its coefficients.
_AGF: dict[int, tuple[str, Callable[[list[float]], dict[str, Any]]]] = {
    4: ("sellmeier", lambda c: _terms("sellmeier", c[:5], squared=True)),
    5: ("conrady", lambda c: {"A": tuple(c[:3]), "P": (0.0, -1.0, -3.5)}),
    7: ("handbook", lambda c: {"A": (c[0], -c[3]), "P": (0.0, 2.0), "B": (c[1],), "C": (c[2],)}),
    # B·λ²/(λ² − C) = B + B·C/(λ² − C).
    8: ("handbook", lambda c: {"A": (c[0] + c[1], -c[3]), "P": (0.0, 2.0), "B": (c[1] * c[2],), "C": (c[2],)}),
    9: ("sellmeier", lambda c: _terms("sellmeier", [c[0] - 1, *c[1:5]])),
}


def read_agf(path: Path) -> list[OpticalMaterial]:
    """Return the materials of a glass catalogue in the AGF format.

    Parameters
    ----------
    path : str or pathlib.Path
        Text file, UTF-8, UTF-16 or Latin-1, up to 16 MiB.

    Returns
    -------
    list of OpticalMaterial
        In the order of the file. Glasses whose formula is not known (numbers 3 and above 13) are left out with an
        ArgumentWarning that names them.

    Raises
    ------
    ValueError
        If a line of a glass is malformed, or the file holds no glass.
    """
    path = Path(os.path.expanduser(path))
    entries: list[dict[str, list[Any]]] = [{"NM": []}]
    for line, text in enumerate(_catalogue_text(path).splitlines(), start=1):
        kind, *words = text.split() or [""]
        if kind == "NM":
            entries.append({"NM": words})
        with _validate.refusing(f"{path.name}, line {line}: ", ValueError):
            if kind in ("CD", "LD"):
                entries[-1][kind] = [float(word) for word in words[: 2 if kind == "LD" else None]]
            elif kind in ("TD", "ED"):
                entries[-1][kind] = [0.0 if word in ("-", "_") else float(word) for word in words]
            elif kind == "IT" and len(words) > 2:
                entries[-1].setdefault("IT", []).append([float(word) for word in words[:3]])
    made = [(entry["NM"][0], _from_agf(path, entry)) for entry in entries if entry["NM"]]
    found = [glass for _, glass in made if glass is not None]
    if not found:
        raise ValueError(f"{path.name} contains no glass whose dispersion formula is known")
    if unknown := [name for name, glass in made if glass is None]:
        warn(f"{path.name}: skipped {', '.join(unknown[:8])}, whose dispersion formula is not known", ArgumentWarning)
    return found


def _heat_of(lines: dict[str, list[float]]) -> dict[str, Any]:
    """Return fields of a material from the lines TD (dn/dT, temperature) and ED (expansion in 10⁻⁶/K) of a glass."""
    constants, expansion = lines.get("TD", []), lines.get("ED", [])
    found: dict[str, Any] = {}
    if len(constants) >= 6 and any(constants[:5]):
        found["thermal"] = tuple(constants[:6])
        found["measured_at"] = constants[6] if len(constants) > 6 else 20.0
    if expansion and expansion[0]:
        found["expansion"] = expansion[0] * 1e-6
    return found


def _catalogue_text(path: Path) -> str:
    regular_file(str(path))
    if path.stat().st_size > 16 << 20:
        raise ValueError(f"{path.name}: must be of at most 16 MiB, got {path.stat().st_size / 2**20:.1f} MiB")
    data = path.read_bytes()
    for encoding in ("utf-16",) if data[:2] in (b"\xff\xfe", b"\xfe\xff") else ("utf-8-sig", "latin-1"):
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise ValueError(f"{path.name}: not a text file")


def _from_agf(path: Path, lines: dict[str, list[Any]]) -> OpticalMaterial | None:
    """Return a glass of an AGF file, None for an unknown formula.

    Its lines are by their names: NM of the glass, CD of coefficients, LD of the range, TD and ED of heat, and those of
    internal transmission, IT, in one list.
    """
    head, c, limits = (lines.get(name, []) for name in ("NM", "CD", "LD"))
    if len(head) < 5 or len(limits) < 2 or not 0 < limits[0] < limits[1] or not all(map(math.isfinite, c)):
        raise ValueError(f"{path.name}: glass {head[0] if head else ''!r} lacks numbers or its range of wavelengths")
    name, kind, nd, vd = head[0], int(float(head[1])), float(head[3]), float(head[4])
    c = c + [0.0] * 12
    made: dict[str, Any]
    if kind in _AGF_POWERS:
        powers = _AGF_POWERS[kind]
        formula, made = "polynomial", {"A": tuple(c[: len(powers)]), "P": powers}
    elif kind in _AGF_TERMS:
        formula, made = "sellmeier", _terms("sellmeier", [0.0, *c[: 2 * _AGF_TERMS[kind]]])
    elif kind in _AGF:
        formula, coefficients = _AGF[kind]
        made = coefficients(c)
    else:
        return None
    glass = OpticalMaterial(name, formula, made, (limits[0], limits[1]), "air", f"glass catalogue {path.name}")
    index = _value(glass.index, LINE_D)
    if nd > 1 and limits[0] <= LINE_D <= limits[1] and not abs(index - nd) < 2e-3:
        raise ValueError(f"{path.name}: {name} states nd = {nd} but its formula gives {index:.6g}")
    return replace(glass, nd=nd or None, vd=vd or None, extinction=_extinction(lines.get("IT", [])), **_heat_of(lines))


def _extinction(passed: list[Any]) -> tuple[Any, ...] | None:
    """Return wavelengths and κ = −λ·ln τ/(4πd) of internal transmittances τ through thicknesses d in millimetres."""
    rows = {w: (max(t, 1e-10), d) for w, t, d in passed if w > 0 and d > 0 and 0 <= t <= 1}
    if len(rows) < 2:
        return None
    places = tuple(sorted(rows))
    return places, tuple(-math.log(rows[w][0]) * w * 1e-3 / (4 * math.pi * rows[w][1]) for w in places)


def read_entry(path: Path) -> OpticalMaterial:
    """Return the material of an entry of refractiveindex.info.

    Parameters
    ----------
    path : str or pathlib.Path
        The entry's YAML file, as its page offers it for download.

    Returns
    -------
    OpticalMaterial
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
    formula = {"1": "sellmeier", "2": "sellmeier", "3": "polynomial", "5": "conrady"}[kind]
    made = _terms(formula, numbers, squared=kind == "1")
    medium = "air" if "catalog" in source.lower() else "vacuum"
    source = source or "refractiveindex.info"
    extinction = _tabulated(lines)
    return OpticalMaterial(path.stem, formula, made, (limits[0], limits[1]), medium, source, extinction=extinction)


def _terms(formula: str, numbers: list[float], squared: bool = False) -> dict[str, Any]:
    """Return the coefficients of a formula of a constant and pairs of numbers; `squared` for poles that are roots."""
    constant, first, second = numbers[0], tuple(numbers[1::2]), tuple(numbers[2::2])
    if formula == "sellmeier":
        return {"A": 1 + constant, "B": first, "C": tuple(c * c for c in second) if squared else second}
    return {"A": (constant, *first), "P": (0.0, *second)}


def _tabulated(lines: list[str]) -> tuple[Any, ...] | None:
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


MICROMETRES = {"m": 1e6, "mm": 1e3, "um": 1.0, "µm": 1.0, "nm": 1e-3}
_DATA = Path(__file__).parent / "data"
_found: dict[str, OpticalMaterial] = {}


def air_index(
    wavelength: float | Array,
    temperature: float | Array = 15.0,
    pressure: float | Array = 101325.0,
    humidity: float | Array = 0.0,
    carbon_dioxide: float = 450.0,
    unit: str = "m",
) -> float | Array:
    """Return the refractive index of air of any temperature, pressure and humidity.

    Parameters
    ----------
    wavelength : float or array
        Vacuum wavelength.
    temperature : float or array
        In degrees Celsius.
    pressure : float or array
        In pascal; 0 is vacuum.
    humidity : float or array
        Relative humidity, 0 to 1.
    carbon_dioxide : float
        Parts per million by volume.
    unit : str
        Of the wavelength: "m", "mm", "um" or "nm".

    Returns
    -------
    float or array
        Index, differentiable.

    Raises
    ------
    ValueError
        If a number is out of range.

    Notes
    -----
    P. E. Ciddor, Appl. Opt. 35, 1566 (1996), valid from 0.3 to 1.69 µm, −40 to 100 °C, 80 to 120 kPa, with the density
    of moist air by the equation of the BIPM (R. S. Davis, Metrologia 29, 67 (1992)).

    Examples
    --------
    Ciddor's table for dry air of 20 °C and 100 kPa at 633 nm, 10⁸(n − 1) = 26824.4:

    >>> from odak.catalog import air_index
    >>> round(1e8 * (air_index(633e-9, 20.0, 100e3) - 1), 1)
    26824.4
    """
    scale = MICROMETRES[_validate.one_of("unit", unit, MICROMETRES)]
    wavelength = _in_unit("wavelength", wavelength, unit)
    carbon_dioxide = _validate.constant("carbon_dioxide", carbon_dioxide, least=0)
    check_weather(temperature, pressure, humidity)
    temperature, pressure, humidity = map(_listed, (temperature, pressure, humidity))
    wide = _in_double(wavelength) * scale
    _validate.fitting(wavelength=wide, temperature=temperature, pressure=pressure, humidity=humidity)
    _check_range(material("air"), wide, True)
    found = _ciddor(wide, temperature, pressure, humidity, carbon_dioxide)
    return _array.cast(found, wavelength, _array.real_dtype(wavelength)) if _array.is_array(wavelength) else found


def _in_unit(name: str, value: Any, unit: str) -> Any:
    """Return a length, or an array of lengths for a list of them, in a unit."""
    return _listed(in_unit(name, value, unit))


def _listed(value: Any) -> Any:
    """Return a list of numbers that were checked as an array, and what else comes as it is."""
    return np.asarray(value) if isinstance(value, (list, tuple)) else value


def check_weather(
    temperature: Amount | None = None, pressure: Amount | None = None, humidity: Amount | None = None, where: str = ""
) -> None:
    """Refuse what is no temperature in degrees Celsius, pressure in pascal or relative humidity; None is left out.

    Values that another unit explains better, and temperatures far outside of what was measured, are warned of.
    `where` follows the name in messages.
    """
    given = {"temperature": temperature, "pressure": pressure, "humidity": humidity}
    for name, (low, high) in {"temperature": (-273, 1000), "pressure": (0, math.inf), "humidity": (0, 1)}.items():
        value: Any = given[name]
        if value is not None:
            _validate.real(name, value)
        if value is None or (found := _validate.ends(value)) is None:
            continue
        least, most = found
        if not low <= least <= most <= high:
            limits = f"between {low} and {high}" if high < math.inf else f"at least {low}"
            remedy = ": percent are divided by 100" if name == "humidity" and 1 < most <= 100 else ""
            raise ValueError(f"{name}{where} must be {limits}, got {most if most > high else least:g}{remedy}")
        if name == "temperature" and not -100 <= least <= most <= 150:
            remedy = f"; were kelvin meant ({most - 273.15:.4g} °C)?" if 200 < most < 450 else ""
            warn(
                f"temperature{where} is in degrees Celsius, and the indices of glass and air are known from -100 to "
                f"150, got {most if most > 150 else least:g}{remedy}",
                AccuracyWarning,
            )
        if name == "pressure" and (0 < most < 1e4 or most > 1e6):
            units = [(unit, size * most) for unit, size in (("hPa", 100), ("kPa", 1000), ("bar", 1e5))]
            remedy = "".join(f"; were {unit} meant ({p:g} Pa)?" for unit, p in units if 5e4 < p < 1.1e5)
            warn(f"pressure{where} is in pascal, 101325 at sea level, got {most:g}{remedy}", ArgumentWarning)


def _ciddor(wide, temperature, pressure, humidity=0.0, carbon_dioxide: float = 450.0):
    """Return the index of air at wavelengths in micrometres."""
    s = 1 / wide**2
    dry = 1e-8 * (5792105 / (238.0185 - s) + 167917 / (57.362 - s)) * (1 + 5.34e-7 * (carbon_dioxide - 450))
    moist = 1.022e-8 * (295.235 + 2.6422 * s - 0.032380 * s**2 + 0.004028 * s**3)
    kelvin = temperature + 273.15
    # Pressure of saturated vapour, and its share by the enhancement factor.
    exponent = 1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6.3431645e3 / kelvin
    saturated = _array.namespace(exponent).exp(exponent) if _array.is_array(exponent) else math.exp(exponent)
    vapour = humidity * (1.00062 + 3.14e-8 * pressure + 5.6e-7 * temperature**2) * saturated
    # A pressure of 0 is vacuum, without vapour either; the share in it is not divided for.
    share = vapour * (pressure > 0) / (pressure + (pressure == 0))
    mass = 0.0289635 + 1.2011e-8 * (carbon_dioxide - 400)
    air = pressure * mass * (1 - share) / (_compressibility(kelvin, pressure, share) * kelvin)
    water = pressure * 0.018015 * share / (_compressibility(kelvin, pressure, share) * kelvin)
    air_there = 101325 * mass / (_compressibility(288.15, 101325.0, 0.0) * 288.15)
    water_there = 1333 * 0.018015 / (_compressibility(293.15, 1333.0, 1.0) * 293.15)
    return 1 + air / air_there * dry + water / water_there * moist


def _compressibility(kelvin, pressure, share):
    t, ratio = kelvin - 273.15, pressure / kelvin
    first = 1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2 + (5.707e-6 - 2.051e-8 * t) * share
    return 1 - ratio * (first + (1.9898e-4 - 2.376e-6 * t) * share**2) + ratio**2 * (1.83e-11 - 0.765e-8 * share**2)


def refractive_index(
    name: str | OpticalMaterial,
    wavelength: float | Array,
    unit: str = "m",
    medium: str | None = None,
    extrapolate: bool = False,
    temperature: float | Array | None = None,
    pressure: float | Array | None = None,
) -> float | Array:
    """Return the refractive index of a material.

    Parameters
    ----------
    name : str or OpticalMaterial
        Name in the catalogue (:func:`material_names`), in any case, with or without hyphens and spaces.
    wavelength : float or array
        Wavelength, numbers or an array of any shape and library. Formulas of glasses are fitted to wavelengths in air,
        as their makers state them; a wavelength in vacuum, which is 1.0003 times as long, changes n by up to 8e-6.
    unit : str
        Unit of `wavelength`: "m", "mm", "um" or "nm".
    medium : str, optional
        "air" or "vacuum": in what the index is to be counted. By default as published: glasses and crystals in air,
        water and air itself in vacuum. "air" makes air exactly 1, which is what a lens in air needs.
    extrapolate : bool
        Take wavelengths outside the material's range of validity.
    temperature : float or array, optional
        In degrees Celsius; by default the temperature of the published index. "air" as `medium` is then air of this
        temperature.
    pressure : float or array, optional
        Of the air, in pascal; 101325 by default.

    Returns
    -------
    float or array
        Of the shape, library and precision of `wavelength` (computed in float64); differentiable in torch, in
        temperature and pressure too.

    Raises
    ------
    ValueError
        If the material is unknown (the message names the nearest known ones), or a wavelength is out of range.

    Notes
    -----
    At another temperature the index in vacuum changes by (n² − 1)/(2n)·[D₀ΔT + D₁ΔT² + D₂ΔT³ + (E₀ΔT + E₁ΔT²)/(λ² −
    λ_TK²)] (Schott, Technical Information 19); air follows :func:`air_index`. For crystals, liquids, infrared materials
    and plastics the constants reproduce a published formula, or D₀ alone a published dn/dT at one wavelength; their
    sources are in ``odak/catalog/data/thermal.json``. A material without these constants
    keeps its index in vacuum, and an :class:`~odak.AccuracyWarning` says so where a temperature is given.

    Examples
    --------
    >>> from odak.catalog import refractive_index
    >>> round(refractive_index("N-BK7", 587.5618e-9), 5)
    1.5168
    >>> round(refractive_index("sf11", 633, unit="nm"), 4)
    1.7786
    """
    found = name if isinstance(name, OpticalMaterial) else material(name)
    scale = MICROMETRES[_validate.one_of("unit", unit, MICROMETRES)]
    wavelength = _in_unit("wavelength", wavelength, unit)
    medium = None if medium is None else _validate.one_of("medium", medium, MEDIA)
    extrapolate = _validate.flag("extrapolate", extrapolate)
    wide = _in_double(wavelength) * scale
    _check_range(found, wide, extrapolate)
    index = found.index(wide)
    check_weather(temperature, pressure)
    temperature, pressure = map(_listed, (temperature, pressure))
    _validate.fitting(wavelength=wide, temperature=temperature, pressure=pressure)
    _tell_constant(found, temperature)
    if temperature is not None or pressure is not None or found.environment is not None:
        own = found.environment or (thermal_of(found)[2], 101325.0)
        here = own[0] if temperature is None else temperature, own[1] if pressure is None else pressure
        index = _in_environment(found, index, wide, medium or found.relative_to, *here)
    elif medium not in (None, found.relative_to):
        air = material("air").index(wide)
        index = index * air if medium == "vacuum" else index / air
    return _array.cast(index, wavelength, _array.real_dtype(wavelength)) if _array.is_array(wavelength) else index


def _tell_constant(found: OpticalMaterial, temperature) -> None:
    """Warn of a temperature that is given for a material whose dn/dT is not known."""
    if temperature is None or found.formula == "gas" or _key(found.name) == "vacuum":
        return
    constants, _, start = thermal_of(found)
    # Numbers alone are compared: a GPU is not waited for.
    if constants is not None or (isinstance(temperature, (int, float)) and temperature == start):
        return
    warn(
        f"dn/dT of {found.name} is not known and counts as 0: the index in vacuum is that at {start:g} °C; give a "
        "OpticalMaterial with `thermal`, or load a maker's catalogue (AGF)",
        AccuracyWarning,
    )


def _in_environment(found: OpticalMaterial, index, wide, medium: str, temperature, pressure):
    """Return an index at a temperature and a pressure, relative to air of both or to vacuum."""
    air = _ciddor(wide, temperature, pressure)
    if found.formula == "gas" and _key(found.name) == "air":
        return air if medium == "vacuum" else air / air
    constants, _, start = thermal_of(found)
    absolute = index * _ciddor(wide, start, 101325.0) if found.relative_to == "air" else index
    if constants is not None:
        d0, d1, d2, e0, e1, pole = constants
        change = temperature - start
        rate = change * (d0 + change * (d1 + change * d2)) + change * (e0 + change * e1) / (wide**2 - pole**2)
        absolute = absolute + (index**2 - 1) / (2 * index) * rate
    return absolute if medium == "vacuum" else absolute / air


def thermal_of(found: OpticalMaterial) -> tuple[tuple[float, ...] | None, float | None, float]:
    """Return Schott's constants of dn/dT and the expansion, None where unknown, and the temperature of the index."""
    if found.thermal is not None or found.expansion is not None:
        return found.thermal, found.expansion, found.measured_at
    built_in = "refractiveindex.info database" in found.source or "schott" in found.source.casefold()
    own = _catalogue().get(_key(found.name))
    if own is not None and own.source == found.source:
        if (formula := _stored("thermal")["formula"].get(found.name)) is not None:
            return tuple(formula[0]), formula[1], formula[2]
        if (constant := _stored("thermal")["constant"].get(found.name)) is not None:
            rate, wavelength, expansion, _ = constant
            n = found.index(wavelength)
            return (2 * n * rate / (n * n - 1), 0.0, 0.0, 0.0, 0.0, 0.0), expansion, found.measured_at
    entry = _entry_of(found, _stored("thermal")["makers"]) if built_in else None
    if entry is None:
        return None, None, found.measured_at
    return None if entry[0] is None else tuple(entry[0]), entry[1], entry[2]


@cache
def _stored(name: str) -> dict[str, Any]:
    """Return what a file of the catalogue holds."""
    return json.loads((_DATA / f"{name}.json").read_text(encoding="utf-8"))


def _entry_of(found: OpticalMaterial, makers: Mapping[str, Any]) -> Any:
    """Return what is stored of a glass by its maker, of the first maker of that name, None where nothing is."""
    maker, _, bare = found.name.rpartition(":")
    entries = (makers.get(one, {}).get(_key(bare)) for one in ([maker] if maker else makers))
    return next((entry for entry in entries if entry is not None), None)


def internal_transmittance(
    name: str | OpticalMaterial, wavelength: float | Array, thickness: float | Array, unit: str = "m"
) -> float | Array:
    """Return the internal transmittance of a thickness of glass, without the losses at its faces.

    Parameters
    ----------
    name : str or OpticalMaterial
        Name in the catalogue, see :func:`material_names`, or a material.
    wavelength : float or array
        Vacuum wavelength.
    thickness : float or array
        Length of the path through the material.
    unit : str
        Unit of both: "m", "mm", "um" or "nm".

    Returns
    -------
    float or array
        exp(−4πκd/λ), of the shape that both broadcast to, in the precision of the wavelength; differentiable in torch.

    Raises
    ------
    ValueError
        If the material is unknown or its absorption is not, or a wavelength is out of range.

    Notes
    -----
    κ is interpolated linearly between the makers' wavelengths, and constant beyond the first and the last of them.

    Examples
    --------
    >>> from odak.catalog import internal_transmittance
    >>> round(internal_transmittance("N-BK7", 400e-9, 0.025), 3)
    0.992
    """
    found = name if isinstance(name, OpticalMaterial) else material(name)
    if extinction_of(found) is None:
        raise ValueError(f"name {found.name!r} is a material whose absorption is not known")
    unit = _validate.one_of("unit", unit, MICROMETRES)
    wavelength, thickness = _in_unit("wavelength", wavelength, unit), in_unit("thickness", thickness, unit)
    _validate.real("thickness", thickness)
    _validate.fitting(wavelength=wavelength, thickness=thickness)
    coefficient = absorption_coefficient(found, wavelength, unit)
    if not _array.is_array(coefficient) and not _array.is_array(thickness):
        return math.exp(-coefficient * thickness)
    value = -coefficient * thickness
    return _array.namespace(value).exp(value)


def absorption_coefficient(found: OpticalMaterial, wavelength: float | Array, unit: str = "m") -> Any:
    """Return 4πκ/λ per unit of length, 0 for a material whose absorption is not known."""
    scale = MICROMETRES[_validate.one_of("unit", unit, MICROMETRES)]
    wide = _in_double(wavelength) * scale
    held = extinction_of(found)
    if held is None:
        return 0 * wide
    _check_range(found, wide, False)
    places, values = held
    if not _array.is_array(wide):
        return 4 * math.pi * scale / wide * float(np.interp(wide, places, values))
    xp = _array.namespace(wide)
    grid, known = (xp.asarray(list(part), dtype=xp.float64, device=_array.device_of(wide)) for part in (places, values))
    inside = xp.clip(wide, places[0], places[-1])
    after = xp.clip(xp.searchsorted(grid, xp.reshape(inside, (-1,))), 1, len(places) - 1)
    low, high = (xp.reshape(xp.take(grid, after - k), wide.shape) for k in (1, 0))
    below, above = (xp.reshape(xp.take(known, after - k), wide.shape) for k in (1, 0))
    kappa = below + (above - below) * (inside - low) / (high - low)
    found_value = 4 * math.pi * scale / wide * kappa
    return _array.cast(found_value, wavelength, _array.real_dtype(wavelength))


def extinction_of(found: OpticalMaterial) -> tuple[Any, ...] | None:
    """Return wavelengths in micrometres and imaginary parts of the index, None where they are not known."""
    if found.extinction is not None:
        return found.extinction
    built_in = _catalogue().get(_key(found.name)) is found or "refractiveindex.info database" in found.source
    held = _extinctions()
    entry = _entry_of(found, held["makers"]) if built_in else None
    return None if entry is None else (tuple(held["grids"][entry[0]]), tuple(value * 1e-9 for value in entry[1]))


@cache
def _extinctions() -> dict[Any, Any]:
    held = _stored("absorption")
    makers = {maker: {_key(name): entry for name, entry in found.items()} for maker, found in held["makers"].items()}
    return {"grids": held["grids"], "makers": makers}


def abbe_number(name: str | OpticalMaterial) -> float:
    """Return the Abbe number (n_d − 1)/(n_F − n_C) of a material, from its formula.

    Parameters
    ----------
    name : str
        Name of a material, see :func:`material_names`.

    Returns
    -------
    float
        Abbe number, from indices relative to air at the lines d, F and C, as published.

    Examples
    --------
    >>> from odak.catalog import abbe_number
    >>> round(abbe_number("N-BK7"), 1)
    64.2
    """
    return (name if isinstance(name, OpticalMaterial) else material(name)).abbe_number()


def material(name: str) -> OpticalMaterial:
    """Return the record of a material: formula, coefficients, range of validity, source.

    Parameters
    ----------
    name : str
        Name in the catalogue, in any case, with or without hyphens and spaces; a glass of a maker may be preceded by
        the maker, "ohara:S-BSL7".

    Raises
    ------
    ValueError
        If there is no such material (the message names the nearest known ones), or several makers have a glass of
        this name (it names them).

    Examples
    --------
    >>> from odak.catalog import material
    >>> material("N-BK7").name
    'N-BK7'
    """
    _validate.instance("name", name, str, "a string")
    known = _catalogue()
    if _key(name) in known:
        return known[_key(name)]
    maker, _, bare = name.rpartition(":")
    makers = _makers_of(_key(bare))
    if maker:
        maker = _validate.one_of(f"maker in {name!r}", maker, glass_makers())
        if maker in makers:
            return _glass(maker, _key(bare))
    elif len(makers) > 1:
        options = ", ".join(f"'{maker}:{bare}'" for maker in makers)
        raise ValueError(f"name {name!r} is a glass of several makers; name one of {options}")
    elif makers:
        return _glass(makers[0], _key(bare))
    pool = [*known, *(key for found in _glasses().values() for key in found)]
    near = difflib.get_close_matches(_key(bare), pool, n=6, cutoff=0.4)
    names = list(dict.fromkeys(known[key].name if key in known else _named(key) for key in near))[:3]
    hint = f"; the nearest known are {', '.join(names)}" if names else ""
    raise ValueError(f"name {name!r} is not a known material{hint}. Add it with odak.catalog.load_materials")


def material_names(maker: str | None = None) -> tuple[str, ...]:
    """Return the names of known materials, sorted, without their aliases.

    Parameters
    ----------
    maker : str, optional
        One of :func:`glass_makers`, for the glasses of its catalogue; by default the names of the general catalogue.

    Returns
    -------
    tuple of str
        Names for :func:`material`.

    Examples
    --------
    >>> from odak.catalog import material_names
    >>> "S-BSL7" in material_names("ohara")
    True
    """
    if maker is None:
        return tuple(sorted({found.name for found in _catalogue().values()}))
    maker = _validate.one_of("maker", maker, glass_makers())
    return tuple(sorted(_glass(maker, key).name for key in _glasses()[maker]))


def glass_makers() -> tuple[str, ...]:
    """Return the makers whose catalogues of optical glass are included, for "maker:name" and :func:`material_names`.

    Returns
    -------
    tuple of str
        Names of the makers.

    Examples
    --------
    >>> from odak.catalog import glass_makers
    >>> "schott" in glass_makers()
    True
    """
    return tuple(_stored("glasses")["makers"])


def nearest_materials(nd: float, vd: float, count: int = 3, makers: Iterable[str] | None = None) -> tuple[str, ...]:
    """Return the names of the materials nearest to a published index and Abbe number, the nearest first.

    Parameters
    ----------
    nd : float
        Index at the d line, as in patents.
    vd : float
        Abbe number.
    count : int
        How many names.
    makers : iterable of str, optional
        Search the catalogues of these makers (see :func:`glass_makers`) instead of the general one.

    Returns
    -------
    tuple of str
        Names for :func:`material`.

    Notes
    -----
    A difference of 0.01 in nd has the same weight as a difference of 1 in vd.

    Examples
    --------
    >>> from odak.catalog import nearest_materials
    >>> nearest_materials(1.5168, 64.2, count=1)
    ('N-BK7',)
    """
    _validate.number("nd", nd, positive=True)
    _validate.number("vd", vd, positive=True)
    if makers is None:
        pool = list(_catalogue().values())
    else:
        named = [_validate.one_of("makers", maker, glass_makers()) for maker in _validate.texts("makers", makers)]
        pool = [_glass(maker, key) for maker in named for key in _glasses()[maker]]
    apart = {
        found.name: math.hypot((found.nd - nd) / 0.01, found.vd - vd)
        for found in pool
        if found.nd is not None and found.vd is not None
    }
    return tuple(sorted(apart, key=lambda name: (apart[name], name))[: _validate.integer("count", count, minimum=1)])


def load_materials(path: str | os.PathLike[str], replace: bool = False) -> tuple[str, ...]:
    """Add the materials of a file to the catalogue of this process.

    Parameters
    ----------
    path : str or pathlib.Path
        File ``{"materials": {name: {"formula": "sellmeier", "B": […], "C": […], "range": [0.4, 1], "source": "…"}}}``,
        with coefficients and range for wavelengths in micrometres; "cauchy" takes "A": [A₀, A₁, …]. Optional keys of
        an entry: "nd" and "vd", which its formula must reproduce, and "relative_to". Optional "aliases" beside
        "materials" map further names to names. Or a makers' glass catalogue (.agf), or an entry of
        refractiveindex.info (.yml), whose material takes the name of the file.
    replace : bool
        Let a name that is taken be given to the new material.

    Returns
    -------
    tuple of str
        The names of the materials added.

    Raises
    ------
    ValueError
        If an entry is malformed or contradicts itself, an alias points nowhere, or a name is taken. Nothing is added
        then.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.catalog import load_materials
    >>> from odak.tools import save_dictionary
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "own.json")
    ...     entry = {"formula": "cauchy", "A": [1.5, 0.004], "range": [0.4, 0.8], "source": "measured"}
    ...     saved = save_dictionary({"materials": {"own glass": entry}}, name)
    ...     load_materials(name, replace=True)
    ('own glass',)
    """
    replace = _validate.flag("replace", replace)
    known = _catalogue()
    materials, aliases = read_materials(validate_path(path))
    added = _indexed(materials, aliases, path, known)
    taken = sorted(known[key].name for key in set(added) & set(known))
    if taken and not replace:
        raise ValueError(f"{path}: {', '.join(map(repr, taken))} is in the catalogue already; pass replace=True")
    known.update(added)
    return tuple(item.name for item in materials)


def _catalogue() -> dict[str, OpticalMaterial]:
    if not _found:
        path = _DATA / "materials.json"
        _found.update(_indexed(*read_materials(path), path, {}))
    return _found


@cache
def _glasses() -> dict[str, dict[str, str]]:
    """Return the names of the glasses of each maker by their keys."""
    makers = _stored("glasses")["makers"]
    return {maker: {_key(name): name for name in held["glasses"]} for maker, held in makers.items()}


def _makers_of(key: str) -> list[str]:
    return [maker for maker, found in _glasses().items() if key in found]


def _named(key: str) -> str:
    """Return the shortest name by which a maker's glass is found."""
    makers = _makers_of(key)
    name = _glasses()[makers[0]][key]
    return name if len(makers) == 1 and key not in _catalogue() else f"{makers[0]}:{name}"


@cache
def _glass(maker: str, key: str) -> OpticalMaterial:
    held, name = _stored("glasses")["makers"][maker], _glasses()[maker][key]
    kind, low, high, numbers, source = held["glasses"][name]
    formula = "sellmeier" if kind == "s" else "polynomial"
    alone = len(_makers_of(key)) == 1 and key not in _catalogue()
    full = name if alone else f"{maker}:{name}"
    text = f"{held['sources'][source]}, from the refractiveindex.info database (CC0)"
    made = OpticalMaterial(full, formula, _terms(formula, numbers), (low, high), "air", text)
    if low <= LINE_F and high >= LINE_C:
        made = replace(made, nd=float(made.index(LINE_D)), vd=float(made.abbe_number()))
    return made


def _indexed(materials, aliases, path, known) -> dict[str, OpticalMaterial]:
    found: dict[str, OpticalMaterial] = {}
    for item in materials:
        if _key(item.name) in found:
            raise ValueError(f"{path}: {item.name!r} occurs twice; case, hyphens and spaces are ignored")
        found[_key(item.name)] = item
    for alias, name in aliases.items():
        target = found.get(_key(name)) or known.get(_key(name))
        if target is None:
            raise ValueError(f"{path}: alias {alias!r} points to {name!r}, which is not a known material")
        found[_key(alias)] = target
    return found


def _key(name: str) -> str:
    return "".join(letter for letter in name.casefold() if letter not in " -_")


def _in_double(wavelength):
    if not _array.is_array(wavelength):
        return _validate.constant("wavelength", wavelength)
    if "complex" in str(_validate.array("wavelength", wavelength).dtype):
        raise TypeError(f"wavelength must be real, got an array of {wavelength.dtype}")
    return _array.namespace(wavelength).astype(wavelength, _array.namespace(wavelength).float64)


def _check_range(found: OpticalMaterial, wide, extrapolate: bool) -> None:
    found_ends = _validate.ends(wide)
    if found_ends is None:
        return
    low, high = found_ends
    if not 0 < low <= high < float("inf"):
        raise ValueError(f"wavelength must be positive and finite, got {low:g} … {high:g} µm")
    # A float32 wavelength at the very limit is not an error.
    if not extrapolate and (low < found.range[0] * (1 - 1e-6) or high > found.range[1] * (1 + 1e-6)):
        got = f"{low:g} µm" if low == high else f"{low:g} … {high:g} µm"
        if low > 1e4:
            meant = likely_length(low * 1e-6, 1e-7, 2e-5, "nm")
            got = f"{low * 1e-6:g} m: wavelengths are in metres; did you mean {meant}?"
        raise ValueError(
            f"wavelength must be within {found.range[0]:g} … {found.range[1]:g} µm for {found.name} "
            f"(odak.catalog.refractive_index takes extrapolate=True), got {got}"
        )
