"""Systems as JSON: the sample lenses that ship with odak, and files of one's own."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from odak import _validate
from odak.learn.raytracing.system.lens import checked_system, optical_system
from odak.learn.raytracing.system.surfaces import surface
from odak.tools._paths import _text

FOLDER = Path(__file__).resolve().parents[3] / "catalog" / "data"
MAXIMUM_BYTES = 4 << 20
_SURFACE = {"radius", "conic", "coefficients", "thickness", "material", "semi_diameter", "stop", "shift", "tilt"}
_IMAGE = _SURFACE - {"thickness", "material", "stop"}
_SYSTEM = {
    "aperture",
    "aperture_type",
    "wavelengths",
    "reference",
    "fields",
    "object_distance",
    "image",
    "unit",
    "name",
    "source",
}


def sample_systems() -> tuple[str, ...]:
    """Return the names of the sample systems, for :func:`load_system`."""
    return tuple(sorted(path.stem.removeprefix("system_") for path in FOLDER.glob("system_*.json")))


def load_system(path: Any) -> optical_system:
    """Return a sample system by its name, or one from a JSON file.

    Parameters
    ----------
    path : str or pathlib.Path
        A name of :func:`sample_systems`, or a file written by :func:`save_system`.

    Raises
    ------
    ValueError
        If there is neither, or the file is malformed.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system
    >>> load_system("double_gauss").name
    'Double Gauss f/2'
    """
    if isinstance(path, str) and path in sample_systems():
        path = FOLDER / f"system_{path}.json"
    path = Path(_text("path", path))
    if not path.is_file():
        raise ValueError(f"path must be a file or one of {', '.join(sample_systems())}; got {str(path)!r}")
    if path.stat().st_size > MAXIMUM_BYTES:
        raise ValueError(f"{path}: larger than {MAXIMUM_BYTES} bytes")
    try:
        return system_from_dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from error


def save_system(system: optical_system, path: Any) -> None:
    """Write a system as JSON, every digit of its numbers.

    Parameters
    ----------
    system : optical_system
        The system.
    path : str or pathlib.Path
        File to write.
    """
    from odak.tools._atomic import replacing

    path = _text("path", path)
    text = json.dumps(system_to_dict(system), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path) as stream:
        stream.write(text.encode("utf-8"))


def system_to_dict(system: optical_system) -> dict:
    """Return a system as a dictionary of plain numbers and strings; infinities are null."""
    checked_system(system)
    surfaces = [
        _shape(item) | _medium(item) | ({"stop": True} if i == system.stop else {})
        for i, item in enumerate(system.surfaces)
    ]
    finite = None if system.at_infinity else system.object_distance
    return {
        "name": system.name,
        "source": system.source,
        "unit": system.unit,
        "aperture": system.aperture,
        "aperture_type": system.aperture_type,
        "wavelengths": list(system.wavelengths),
        "reference": system.reference,
        "fields": [list(field) for field in system.fields],
        "object_distance": finite,
        **({} if system.image is None else {"image": _shape(system.image)}),
        "surfaces": surfaces,
    }


def _shape(item: Any) -> dict:
    """Return what shapes a surface, without what it does not have."""
    radius = float(item.radius.detach())
    entry: dict[str, Any] = {"radius": None if math.isinf(radius) else radius, "conic": float(item.conic.detach())}
    entry |= {"coefficients": item.coefficients.tolist(), "semi_diameter": item.semi_diameter}
    entry |= {"shift": item.shift.tolist(), "tilt": item.tilt.tolist()}
    return {key: value for key, value in entry.items() if value not in (None, [], [0.0, 0.0])}


def _medium(item: Any) -> dict:
    medium = float(item.index.detach()) if item.material is None else getattr(item.material, "name", item.material)
    return {"thickness": float(item.thickness.detach()), "material": medium}


def system_from_dict(entry: dict) -> optical_system:
    """Return the system that :func:`system_to_dict` describes.

    Parameters
    ----------
    entry : dict
        As from :func:`system_to_dict`; what is left out has its default.

    Raises
    ------
    ValueError, TypeError
        If a key is unknown or a value out of range, naming it.
    """
    if not isinstance(entry, Mapping):
        raise TypeError(f"entry must be a dictionary, got {type(entry).__name__}")
    entry = dict(entry)
    surfaces = entry.pop("surfaces", None)
    if not isinstance(surfaces, list) or not surfaces:
        raise ValueError("surfaces must be a list of at least one")
    _known("system", entry, _SYSTEM | {"notes"})
    entry.pop("notes", None)
    if entry.get("object_distance", 0) is None:
        del entry["object_distance"]
    built = [_built(f"surfaces[{number}]", item, _SURFACE) for number, item in enumerate(surfaces)]
    if entry.get("image") is not None:
        entry["image"] = _built("image", entry["image"], _IMAGE)
    return optical_system(built, **entry)


def _built(where: str, entry, keys) -> surface:
    _known(where, entry, keys)
    entry = {"radius": math.inf, **entry}
    radius = entry.pop("radius")
    return surface(math.inf if radius is None else radius, **entry)


def _known(where: str, entry, keys) -> None:
    if not isinstance(entry, dict):
        raise ValueError(f"{where} must be an object, got {type(entry).__name__}")
    for key in entry:
        _validate.one_of(f"key in {where}", key, sorted(keys))
