"""Refractive indices of glasses, crystals, plastics, water and air; sources in ``odak/catalog/data/materials.json``."""

import difflib
import json
import math
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array
from odak.catalog.dispersion import LINE_C, LINE_D, LINE_F, MEDIA, Material
from odak.catalog.material_files import read_materials
from odak.tools.paths import validate_path

MICROMETRES = {"m": 1e6, "mm": 1e3, "um": 1.0, "µm": 1.0, "nm": 1e-3}
_DATA = Path(__file__).parent / "data" / "materials.json"
_GLASSES = Path(__file__).parent / "data" / "glasses.json"
_ABSORPTION = Path(__file__).parent / "data" / "absorption.json"
_found: dict[str, Material] = {}


def refractive_index(
    name: Any, wavelength: float | Array, unit: str = "m", medium: str | None = None, extrapolate: bool = False
) -> float | Array:
    """Return the refractive index of a material.

    Parameters
    ----------
    name : str or Material
        Name in the catalogue (:func:`material_names`), in any case, with or without hyphens and spaces.
    wavelength : float or array
        Vacuum wavelength, numbers or an array of any shape and library.
    unit : str
        Unit of `wavelength`: "m", "mm", "um" or "nm".
    medium : str, optional
        "air" or "vacuum": in what the index is to be counted. By default as published: glasses and crystals in air,
        water and air itself in vacuum. "air" makes air exactly 1, which is what a lens in air needs.
    extrapolate : bool
        Take wavelengths outside the material's range of validity.

    Returns
    -------
    float or array
        Of the shape, library and precision of `wavelength` (computed in float64); differentiable in torch.

    Raises
    ------
    ValueError
        If the material is unknown (the message names the nearest known ones), or a wavelength is out of range.

    Examples
    --------
    >>> from odak.catalog import refractive_index
    >>> round(refractive_index("N-BK7", 587.5618e-9), 5)
    1.5168
    >>> round(refractive_index("sf11", 633, unit="nm"), 4)
    1.7786
    """
    found = name if isinstance(name, Material) else material(name)
    scale = MICROMETRES[_validate.one_of("unit", unit, MICROMETRES)]
    medium = None if medium is None else _validate.one_of("medium", medium, MEDIA)
    extrapolate = _validate.flag("extrapolate", extrapolate)
    if isinstance(wavelength, (list, tuple)):
        wavelength = _validate.array("wavelength", wavelength)
    wide = _in_double(wavelength) * scale
    _check_range(found, wide, extrapolate)
    index = found.index(wide)
    if medium not in (None, found.relative_to):
        air = material("air").index(wide)
        index = index * air if medium == "vacuum" else index / air
    return _array.cast(index, wavelength, _array.real_dtype(wavelength)) if _array.is_array(wavelength) else index


def internal_transmittance(
    name: Any, wavelength: float | Array, thickness: float | Array, unit: str = "m"
) -> float | Array:
    """Return the internal transmittance of a thickness of glass, without the losses at its faces.

    Parameters
    ----------
    name : str or Material
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
    found = name if isinstance(name, Material) else material(name)
    if extinction_of(found) is None:
        raise ValueError(f"name {found.name!r} is a material whose absorption is not known")
    if isinstance(wavelength, (list, tuple)):
        wavelength = _validate.array("wavelength", wavelength)
    _validate.real("thickness", thickness)
    coefficient = absorption_coefficient(found, wavelength, unit)
    if not _array.is_array(coefficient) and not _array.is_array(thickness):
        return math.exp(-coefficient * thickness)
    value = -coefficient * thickness
    return _array.namespace(value).exp(value)


def absorption_coefficient(found: Material, wavelength: float | Array, unit: str = "m") -> Any:
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


def extinction_of(found: Material) -> tuple | None:
    """Return wavelengths in micrometres and imaginary parts of the index, None where they are not known."""
    if found.extinction is not None:
        return found.extinction
    built_in = _catalogue().get(_key(found.name)) is found or "refractiveindex.info database" in found.source
    if not built_in:
        return None
    maker, _, bare = found.name.rpartition(":")
    held = _extinctions()
    for one in [maker] if maker else held["makers"]:
        entry = held["makers"].get(one, {}).get(_key(bare))
        if entry is not None:
            return tuple(held["grids"][entry[0]]), tuple(value * 1e-9 for value in entry[1])
    return None


@cache
def _extinctions() -> dict:
    held = json.loads(_ABSORPTION.read_text(encoding="utf-8"))
    makers = {maker: {_key(name): entry for name, entry in found.items()} for maker, found in held["makers"].items()}
    return {"grids": held["grids"], "makers": makers}


def abbe_number(name: Any) -> float:
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
    return (name if isinstance(name, Material) else material(name)).abbe_number()


def material(name: str) -> Material:
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
    if not isinstance(name, str):
        raise TypeError(f"name must be a string, got {type(name).__name__}")
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
    return tuple(_glass_data()["makers"])


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
    A difference of 0.01 in nd counts as much as one of 1 in vd.

    Examples
    --------
    >>> from odak.catalog import nearest_materials
    >>> nearest_materials(1.5168, 64.2, count=1)
    ('N-BK7',)
    """
    _validate.real("nd", nd, positive=True)
    _validate.real("vd", vd, positive=True)
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


def load_materials(path: Any, replace: bool = False) -> tuple[str, ...]:
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


def _catalogue() -> dict[str, Material]:
    if not _found:
        _found.update(_indexed(*read_materials(_DATA), _DATA, {}))
    return _found


@cache
def _glass_data() -> dict:
    return json.loads(_GLASSES.read_text(encoding="utf-8"))


@cache
def _glasses() -> dict[str, dict[str, str]]:
    """Return the names of the glasses of each maker by their keys."""
    makers = _glass_data()["makers"]
    return {maker: {_key(name): name for name in held["glasses"]} for maker, held in makers.items()}


def _makers_of(key: str) -> list[str]:
    return [maker for maker, found in _glasses().items() if key in found]


def _named(key: str) -> str:
    """Return the shortest name by which a maker's glass is found."""
    makers = _makers_of(key)
    name = _glasses()[makers[0]][key]
    return name if len(makers) == 1 and key not in _catalogue() else f"{makers[0]}:{name}"


@cache
def _glass(maker: str, key: str) -> Material:
    held, name = _glass_data()["makers"][maker], _glasses()[maker][key]
    kind, low, high, numbers, source = held["glasses"][name]
    if kind == "s":
        formula = "sellmeier"
        coefficients: dict[str, Any] = {"A": 1 + numbers[0], "B": tuple(numbers[1::2]), "C": tuple(numbers[2::2])}
    else:
        formula = "polynomial"
        coefficients = {"A": (numbers[0], *numbers[1::2]), "P": (0.0, *numbers[2::2])}
    alone = len(_makers_of(key)) == 1 and key not in _catalogue()
    full = name if alone else f"{maker}:{name}"
    text = f"{held['sources'][source]}, from the refractiveindex.info database (CC0)"
    made = Material(full, formula, coefficients, (low, high), "air", text)
    if low <= LINE_F and high >= LINE_C:
        made = replace(made, nd=float(made.index(LINE_D)), vd=float(made.abbe_number()))
    return made


def _indexed(materials, aliases, path, known) -> dict[str, Material]:
    found: dict[str, Material] = {}
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


def _check_range(found: Material, wide, extrapolate: bool) -> None:
    if not _array.is_readable(wide) or (_array.is_array(wide) and 0 in wide.shape):
        return
    xp = _array.namespace(wide)
    # Two numbers are read, not the whole array: a spectrum may have a million samples.
    ends = (xp.min(wide), xp.max(wide)) if _array.is_array(wide) else (wide, wide)
    low, high = (_validate.numbers(end)[0] for end in ends)
    if not 0 < low <= high < float("inf"):
        raise ValueError(f"wavelength must be positive and finite, got {low:g} … {high:g} µm")
    # A float32 wavelength at the very limit is not an error.
    if not extrapolate and (low < found.range[0] * (1 - 1e-6) or high > found.range[1] * (1 + 1e-6)):
        raise ValueError(
            f"wavelength must be within {found.range[0]:g} … {found.range[1]:g} µm for {found.name} "
            f"(or extrapolate=True), got {low:g} … {high:g} µm"
        )
