"""Files of optical systems: JSON of the package's own, and what the readers of other formats share."""

import codecs
import dataclasses
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch

from odak import _validate
from odak._warnings import AccuracyWarning, warn
from odak.catalog.materials import (  # noqa: F401
    MICROMETRES,
    OpticalMaterial,
    glass_makers,
    load_materials,
    material,
    model_glass,
    nearest_materials,
)
from odak.learn.raytracing.system.films import PolarizingFilm
from odak.learn.raytracing.system.paraxial import entrance_pupil, first_order
from odak.learn.raytracing.system.pupils import _continuation, _solve, at_stop, through_places, trace_fields
from odak.learn.raytracing.system.specification import AIR, PARTS, SystemAperture, plain
from odak.learn.raytracing.system.surfaces import (
    Coating,
    checked_system,
    coordinate_break,
    is_break,
    optical_system,
    surface,
)
from odak.learn.raytracing.system.tracing import trace
from odak.raytracing.apertures import Aperture
from odak.raytracing.gradients import FunctionGradient, Gradient
from odak.raytracing.interfaces import Phase
from odak.raytracing.surfaces import (
    Shape,
)
from odak.tools.paths import _text, write_file
from odak.tools.transformation import rotation_matrix

FOLDER = Path(__file__).resolve().parents[3] / "catalog" / "data"
MAXIMUM_BYTES = 4 << 20
_IMAGE = {"radius", "conic", "coefficients", "shape", "semi_diameter", "aperture", "shift", "tilt"}
_SURFACE = _IMAGE | {"thickness", "material", "material_range", "stop", "phase", "gradient", "coating"}
_BREAK = {"break", "shift", "tilt", "thickness", "order", "return_to"}
_SYSTEM = {"image", "unit", *(field.name for part in PARTS for field in dataclasses.fields(part))}
FACTORS = ("VDXN", "VDYN", "VCXN", "VCYN")


def sample_systems() -> tuple[str, ...]:
    """Return the names of the sample systems, for :func:`load_system`.

    Examples
    --------
    >>> from odak.learn.raytracing.system import sample_systems
    >>> "cooke_triplet" in sample_systems()
    True
    """
    return tuple(sorted(path.stem.removeprefix("system_") for path in FOLDER.glob("system_*.json")))


def load_system(path: str | os.PathLike[str]) -> optical_system:
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
    reader = {".zmx": "read_zmx", ".seq": "read_seq", ".len": "read_len"}.get(path.suffix.lower())
    if reader is not None:
        raise ValueError(f"path must be a JSON file of save_system; {reader} reads {str(path)!r}")
    text = lens_text(path)
    try:
        found = system_from_dict(json.loads(text))
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from error
    return told_impossible(found)


def save_system(system: optical_system, path: str | os.PathLike[str]) -> None:
    """Write a system as JSON, every digit of its numbers.

    Parameters
    ----------
    system : optical_system
        The system.
    path : str or pathlib.Path
        File to write.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.raytracing.system import first_order, load_system, save_system
    >>> lens = load_system("cooke_triplet")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "lens.json")
    ...     save_system(lens, name)
    ...     again = load_system(name)
    >>> round(float(first_order(again).focal_length - first_order(lens).focal_length), 6)
    0.0
    """
    path = _text("path", path)
    text = json.dumps(system_to_dict(system), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_file(path, text.encode("utf-8"))


def system_to_dict(system: optical_system) -> dict[Any, Any]:
    """Return a system as a dictionary of plain numbers and strings; infinities are null.

    Parameters
    ----------
    system : optical_system
        The system.

    Returns
    -------
    dict
        Plain numbers and strings, which JSON can hold; infinities are null.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, system_from_dict, system_to_dict
    >>> entry = system_to_dict(load_system("cooke_triplet"))
    >>> system_from_dict(entry).name == load_system("cooke_triplet").name
    True
    """
    checked_system(system)
    surfaces = [_entry(item, i == system.stop) for i, item in enumerate(own_surfaces(system))]
    finite = None if system.at_infinity else plain(system.object_distance)
    return {
        "name": system.name,
        "source": system.source,
        "unit": system.unit,
        "aperture": plain(system.aperture),
        "aperture_type": system.aperture_type,
        "wavelengths": list(system.wavelengths),
        "reference": system.reference,
        "fields": plain(system.fields),
        "object_distance": finite,
        **({} if system.image is None else {"image": _shape(system.image)}),
        **({"telecentric": True} if system.telecentric else {}),
        **({"afocal": True} if system.afocal else {}),
        **{
            key: plain(getattr(system, key))
            for key in ("vignetting_factors", "field_weights", "wavelength_weights")
            if getattr(system, key) is not None
        },
        **({} if system.object_material == AIR else {"object_material": _named_medium(system.object_material)}),
        **({"settings": [_setting(*entry) for entry in system.settings]} if system.settings else {}),
        "surfaces": surfaces,
    }


def _named_medium(medium: Any) -> Any:
    """Return the name of a material, with where it is used if that is known, or an index."""
    if not isinstance(medium, OpticalMaterial):
        return medium
    name = " ".join(("model", *model_numbers(medium))) if medium.name.startswith("model ") else medium.name
    if medium.environment is None:
        return name
    temperature, pressure = map(float, medium.environment)
    return f"{name} at {temperature!r} °C, {pressure!r} Pa"


def _setting(name: str, place: int | None, values: tuple) -> list:
    """Return a setting of configurations in plain numbers and names; infinities are null."""
    kept = [
        _named_medium(value) if isinstance(value, OpticalMaterial) else None if value == math.inf else plain(value)
        for value in values
    ]
    return [name, place, kept]


def own_surfaces(system: optical_system) -> list[Any]:
    """Return the surfaces without the lens that an afocal system appends."""
    return list(system.surfaces)[: -1 if system.afocal else None]


def _entry(item: Any, stop: bool) -> dict:
    if not is_break(item):
        return _shape(item) | _medium(item) | ({"stop": True} if stop else {})
    entry: dict[str, Any] = {"break": True, "thickness": float(item.thickness.detach())}
    if isinstance(item.order, int):
        return entry | {"return_to": item.order}
    return entry | {"shift": item.shift.tolist(), "tilt": item.tilt.tolist(), "order": item.order}


def _shape(item: Any) -> dict:
    """Return the shape, aperture, phase and placement of a surface, without what it does not have."""
    radius = math.inf if item.own_shape is not None else float(item.radius.detach())
    entry: dict[str, Any] = {"radius": None if math.isinf(radius) else radius, "conic": float(item.conic.detach())}
    entry |= {"coefficients": item.coefficients.tolist(), "semi_diameter": item.semi_diameter}
    entry |= {"shift": item.shift.tolist(), "tilt": item.tilt.tolist()}
    if item.own_shape is not None:
        entry = {key: value for key, value in entry.items() if key != "conic"} | {"shape": _by_fields(item.shape)}
    if item.own_phase is not None:
        entry["phase"] = _by_fields(item.phase)
    if item.own_gradient is not None:
        entry["gradient"] = _by_fields(item.gradient)
    coating = item.coating
    if isinstance(coating, PolarizingFilm):
        entry["coating"] = _by_fields(coating)
    elif coating is not None:
        entry["coating"] = {"media": [_film(value) for value in coating.media]}
        entry["coating"] |= {"thicknesses": plain(coating.thicknesses)}
        entry["coating"] |= {} if coating.substrate is None else {"substrate": _film(coating.substrate)}
        entry["coating"] |= {} if coating.unit is None else {"unit": coating.unit}
    entry["aperture"] = [_by_fields(part) for part in item.apertures]
    return {key: value for key, value in entry.items() if value not in (None, [], [0.0, 0.0])}


def _film(medium):
    """Return the name of a material, its index, or the parts of a complex one."""
    if isinstance(medium, complex):
        return [medium.real, medium.imag]
    return getattr(medium, "name", medium)


def _by_fields(item: Any) -> dict:
    """Return a shape, a phase, a gradient or an aperture as the name of its class and its fields."""
    if isinstance(item, FunctionGradient):
        raise ValueError("a graded index given by a function cannot be written: derive a class from Gradient")
    values = {field.name: plain(getattr(item, field.name)) for field in dataclasses.fields(item)}
    return {"kind": type(item).__name__} | values


def _kinds(base: type) -> dict[str, type]:
    """Return the classes derived from one by their names, including classes of the user's program."""
    found: dict[str, type] = {}
    children: list[type] = base.__subclasses__()
    for child in children:
        found |= {child.__name__: child} | _kinds(child)
    return found


def _from_fields(where: str, base: type, entry):
    kinds = _kinds(base)
    if not isinstance(entry, dict) or "kind" not in entry:
        accepted = f'{where} must be an object with a "kind", one of {", ".join(sorted(kinds))}'
        raise ValueError(f"{accepted}; got {entry!r:.80}")
    entry = dict(entry)
    kind = kinds[_validate.one_of(f"kind in {where}", entry.pop("kind"), sorted(kinds))]
    _known(where, entry, [field.name for field in dataclasses.fields(kind)])
    if base is not Aperture:
        # Grids as arrays; a list of numbers stays one.
        entry = {
            k: np.asarray(v) if isinstance(v, list) and v and isinstance(v[0], list) else v for k, v in entry.items()
        }
    with named_errors(where):
        return kind(**entry)


def _medium(item: Any) -> dict:
    medium = float(item.index.detach()) if item.material is None else _named_medium(item.material)
    entry = {"thickness": float(item.thickness.detach()), "material": medium}
    if not isinstance(item.material, OpticalMaterial):
        return entry
    with suppress(ValueError):
        # A range that a file extended beyond the range of the glass.
        if tuple(item.material.range) != tuple(_material(str(entry["material"])).range):
            entry["material_range"] = list(item.material.range)
    return entry


def _is_described(name: Any) -> bool:
    """Return whether a name of a file is more than one of the catalogue."""
    return isinstance(name, str) and (name.startswith("model ") or " at " in name)


def _material(name: str) -> OpticalMaterial:
    """Return a glass of the catalogue, or the model glass that "model" and its two or three numbers describe.

    Behind " at " follow the temperature in degrees Celsius and the pressure in pascal at which it is used.
    """
    name, used, weather = name.partition(" at ")
    if used:
        numbers = re.fullmatch(r"(\S+) °C, (\S+) Pa", weather)
        if numbers is None:
            raise ValueError(f"material must have ' at … °C, … Pa' behind its name, got {name + used + weather!r:.80}")
        return _material(name).at(*map(float, numbers.groups()))
    if not name.startswith("model "):
        return material(name)
    words = name.split()[1:]
    if len(words) not in (2, 3):
        raise ValueError(f"material must be 'model' and two or three numbers, got {name!r:.80}")
    return model_glass(*map(float, words))


def model_numbers(glass: OpticalMaterial) -> list[str]:
    """Return every digit of a model glass's index and Abbe number, and its deviation of partial dispersion if any."""
    return [repr(glass.nd), repr(glass.vd), *glass.name.split()[3:]]


def system_from_dict(entry: dict[Any, Any]) -> optical_system:
    """Return the system that :func:`system_to_dict` describes.

    Parameters
    ----------
    entry : dict
        As from :func:`system_to_dict`; missing entries take their defaults.

    Raises
    ------
    ValueError, TypeError
        If a key is unknown or a value out of range, naming it.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, system_from_dict, system_to_dict
    >>> entry = system_to_dict(load_system("cooke_triplet"))
    >>> len(system_from_dict(entry).surfaces) == len(load_system("cooke_triplet").surfaces)
    True
    """
    _validate.instance("entry", entry, Mapping, "a dictionary")
    entry = dict(entry)
    surfaces = entry.pop("surfaces", None)
    if not isinstance(surfaces, list) or not surfaces:
        raise ValueError(f"surfaces must be a list of at least one surface, got {surfaces!r:.80}")
    _known("system", entry, _SYSTEM | {"notes"})
    entry.pop("notes", None)
    if entry.get("object_distance", 0) is None:
        del entry["object_distance"]
    if _is_described(entry.get("object_material")):
        entry["object_material"] = _material(entry["object_material"])
    if isinstance(entry.get("settings"), list):
        entry["settings"] = [_setting_of(item) for item in entry["settings"]]
    built = [_built(f"surfaces[{number}]", item, _SURFACE) for number, item in enumerate(surfaces)]
    if entry.get("image") is not None:
        entry["image"] = _built("image", entry["image"], _IMAGE)
    return optical_system(built, **entry)


def _setting_of(entry):
    """Return a setting of a file, with infinities in place of null."""
    if not isinstance(entry, list) or len(entry) != 3 or not isinstance(entry[2], list):
        return entry
    name, place, values = entry
    if name == "material":
        values = [_material(value) if _is_described(value) else value for value in values]
    return name, place, [math.inf if value is None else value for value in values]


def _built(where: str, entry, keys) -> surface:
    if keys is _SURFACE and isinstance(entry, dict) and entry.get("break"):
        _known(where, entry, _BREAK)
        with named_errors(where):
            return coordinate_break(**{key: value for key, value in entry.items() if key != "break"})
    _known(where, entry, keys)
    entry = {"radius": math.inf, **entry}
    for key, base in (("shape", Shape), ("phase", Phase), ("gradient", Gradient)):
        if key in entry:
            entry[key] = _from_fields(f"{key} of {where}", base, entry[key])
    if "aperture" in entry:
        parts = entry["aperture"] if isinstance(entry["aperture"], list) else [entry["aperture"]]
        entry["aperture"] = [_from_fields(f"aperture of {where}", Aperture, part) for part in parts]
    if isinstance(entry.get("coating"), dict) and "kind" in entry["coating"]:
        entry["coating"] = _from_fields(f"coating of {where}", PolarizingFilm, entry["coating"])
    elif "coating" in entry:
        _known(f"coating of {where}", entry["coating"], {"media", "thicknesses", "substrate", "unit"})
        with named_errors(f"coating of {where}"):
            entry["coating"] = Coating(**entry["coating"])
    radius = entry.pop("radius")
    with named_errors(where):
        glass, reach = entry.get("material"), entry.pop("material_range", None)
        if isinstance(glass, str) and _is_described(glass):
            entry["material"] = _material(glass)
        if reach is not None:
            low, high = map(float, _validate.several("material_range", reach, 2, positive=True))
            if not (isinstance(glass, str) and low < high):
                raise ValueError(f"material_range must be two rising numbers, of a glass, got {reach} of {glass!r:.60}")
            entry["material"] = dataclasses.replace(_material(glass), range=(low, high))
        return surface(math.inf if radius is None else radius, **entry)


@contextmanager
def named_errors(where: str) -> Iterator[None]:
    """Put in front of a message which surface of a file it is about."""
    try:
        yield
    except (TypeError, ValueError) as error:
        raise type(error)(f"{where}: {error}") from error
    except ArithmeticError as error:
        raise ValueError(f"{where}: a number is out of range: {error}") from error


def _known(where: str, entry, keys) -> None:
    if not isinstance(entry, dict):
        raise ValueError(f"{where} must be an object, got {type(entry).__name__}")
    for key in entry:
        _validate.one_of(f"key in {where}", key, sorted(keys))


# Distance in millimetres beyond which an object given by angles is treated as infinitely far.
FAR = 1e8
# How far beyond the range of a glass a file may use it.
MAXIMUM_STRETCH = 1.5
_MARKS = ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"), (codecs.BOM_UTF8, "utf-8-sig"))
# Files whose content is packed or hidden: their suffix, their first bytes, and what they are.
SEALED: tuple[tuple[str, tuple[bytes, ...], str], ...] = (
    (".zar", (b"\xea\x00", b"\xec\x03"), "a Zemax archive"),
    (".zbb", (), "a Zemax black box"),
    (".zip", (b"PK",), "a packed archive"),
)


# Materials of the catalogue "special" of CODE V.
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


class ZmxReport(NamedTuple):
    """Report of a lens file: the lines that were not used, and decisions that the file left open.

    Attributes
    ----------
    ignored : tuple of str
        Every line that had no effect, as "line 12, surface 3: KEY words".
    notes : tuple of str
        Decisions that the file left open, and settings that have no counterpart.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.raytracing.system import load_system, read_zmx, write_zmx
    >>> lens = load_system("cooke_triplet")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "lens.zmx")
    ...     write_zmx(lens, name)
    ...     again, report = read_zmx(name)
    >>> report.ignored
    ()
    """

    ignored: tuple[str, ...]
    notes: tuple[str, ...]


def told_impossible(system: optical_system, remedy: str = "", notes: list[str] | None = None) -> optical_system:
    """Return a system that was read, with a warning if it cannot be meant: without a focal length or without a ray.

    Parameters
    ----------
    system : optical_system
        The system.
    remedy : str
        What the file may have wrong.
    notes : list of str, optional
        Notes of the reader, which get the text too.
    """
    with torch.no_grad():
        try:
            focus = abs(float(first_order(system).focal_length))
            # The ray along the axis passes whatever is bent.
            half = torch.tensor([[0.0, 0.5], [0.0, -0.5]], dtype=torch.float64)
            lost = not bool(trace_fields(system, half, vignetting=False).arrived.any())
        except ValueError:
            # A system without pupils or an axis: what needs them says so.
            return system
    problems = [f"a focal length of {focus:.3g} {system.unit}"] if focus < max(system.wavelengths) else []
    problems += ["no ray that arrives"] if lost else []
    if problems:
        text = f"{system.name or 'the system'} has {' and '.join(problems)}, which cannot be meant{remedy}"
        warn(text, AccuracyWarning)
        if notes is not None:
            notes.append(text)
    return system


class Command(NamedTuple):
    """A line or a command of a lens file: the number of its line, its name, and the words behind it."""

    number: int
    key: str
    words: Sequence[str]

    @property
    def word(self) -> str:
        """The first word in capitals; "" where there is none."""
        return self.words[0].upper() if self.words else ""

    def value(self, place: int = 0) -> float:
        """Return one of the words as a number; ValueError, naming the line, for anything else."""
        try:
            word = self.words[place]
        except IndexError:
            wanted = "a number" if place < 1 else f"{place + 1} numbers"
            given = len(self.words) or "none"
            raise ValueError(f"line {self.number}: {self.key} must have {wanted}, got {given}") from None
        found = self.converted(word)
        if math.isnan(found):
            raise ValueError(f"line {self.number}: {self.key} must have a number, got {word!r:.60}")
        return found

    def values(self) -> list[float]:
        """Return all words as numbers."""
        return [self.value(place) for place in range(len(self.words))]

    @staticmethod
    def converted(word: str) -> float:
        """Return the number that a word stands for, NaN where there is none or an infinite one."""
        try:
            return float(word) if math.isfinite(float(word)) else math.nan
        except ValueError:
            return math.nan

    @property
    def text(self) -> str:
        """The line as a report names it."""
        return f"line {self.number}: {' '.join((self.key, *self.words))}"

    def unknown(self) -> ValueError:
        """Return the error of a command that is not understood."""
        given = " ".join((self.key, *self.words))
        return ValueError(f"line {self.number}: {self.key} is a command that is not understood, got {given!r:.80}")


Opened = TypeVar("Opened", bound="LensFile")


@dataclasses.dataclass
class LensFile:
    """A lens file of another program while it is read: what all its surfaces share, and what its report will say.

    Attributes
    ----------
    path : pathlib.Path
        The file.
    reader : str
        Name of the function that reads it, for messages.
    glasses : dict
        Stand-ins for glasses by their names in the file.
    scale : float
        Millimetres of its unit of length.
    makers : list of str
        Makers whose catalogues it names.
    waves : list of float
        Its wavelengths, in millimetres.
    ignored, notes : list of str
        Lines without effect, and decisions that it left open: the :class:`ZmxReport`.
    """

    path: Path
    reader: str
    glasses: dict[Any, Any]
    scale: float = 1.0
    makers: list[str] = dataclasses.field(default_factory=list)
    waves: list[float] = dataclasses.field(default_factory=list)
    ignored: list[str] = dataclasses.field(default_factory=list)
    notes: list[str] = dataclasses.field(default_factory=list)

    @classmethod
    def opened(
        cls: type[Opened], reader: str, path: str | os.PathLike[str], glasses: Mapping[Any, Any] | None
    ) -> Opened:
        """Return the file of a reader's arguments, which are checked."""
        _validate.instance("glasses", glasses, (Mapping, type(None)), "a dictionary")
        return cls(Path(_text("path", path)), reader, dict(glasses or {}))

    def take_unit(self, key: str, name: str, lengths: Mapping[str, float]) -> None:
        """Enter the unit of length, one of a table of millimetres."""
        if name.upper() not in lengths:
            raise ValueError(f"{key} must be one of {', '.join(lengths)}, got {name.upper()!r}")
        self.scale = lengths[name.upper()]

    def object_distance(self, distance: float, silent: float = math.inf) -> float:
        """Return a distance in millimetres; a very far object is at infinity, with a note below `silent`."""
        if distance < FAR:
            return distance
        if distance < silent:
            self.notes.append(f"the object, at a distance of {distance:g} mm, is taken to be at infinity")
        return math.inf

    def maker_of_system(self, items: Sequence[surface], stop: str = "", **names: Any) -> Callable[..., optical_system]:
        """Return the function that makes the system of these surfaces, of an aperture and of what is known by then.

        `stop` is the key that would have named the stop, for a note where none of the surfaces is it.
        """
        if stop and not any(item.stop for item in items):
            self.notes.append(f"no {stop}: the first surface is taken as the stop")
        own = {"unit": "mm", "source": self.path.name, "wavelengths": self.waves} | names
        own["name"] = self.path.stem if own.get("name") is None else own["name"]

        def system(size: float, form: str, **others: Any) -> optical_system:
            return optical_system(list(items), SystemAperture(size, form), **(own | others))

        return system

    def usual_pupil(self, system: optical_system, missing: str) -> tuple[float, str]:
        """Return the aperture where none is stated: an entrance pupil of a tenth of the focal length, in a note."""
        size = abs(float(first_order(system).focal_length)) / 10
        size = size if math.isfinite(size) and size else 1.0
        self.notes.append(f"{missing}: an entrance pupil of {size:g} mm, a tenth of the focal length, is taken")
        return size, "EPD"

    def field_points(self, system: optical_system, points: list[tuple[float, float]], kind: str, aim: str = "real"):
        """Return fields as angles where the object is at infinity, as its heights in millimetres where it is near.

        Parameters
        ----------
        system : optical_system
            The system, with any fields.
        points : list of tuple
            What the file states.
        kind : str
            "angle", "height" (in the object), "paraxial" or "real" (heights in the image).
        aim : str
            How real chief rays are aimed.
        """
        if kind == "angle":
            near = not system.at_infinity and any(map(any, points))
            return self._heights_of_angles(system, points) if near else points
        points = [(a * self.scale, b * self.scale) for a, b in points]
        if kind == "height":
            return points
        self.notes.append(f"fields are image heights ({kind}), turned into object fields")
        return list(fields_of_image_heights(system, points, kind == "real", aim, self.notes))

    def _heights_of_angles(self, system: optical_system, points: Iterable[tuple[float, float]]):
        """Return the object heights that are seen under angles from the entrance pupil, with a note."""
        reach = float(system.object_distance) + float(first_order(system).entrance_pupil_distance)
        if not math.isfinite(reach) or system.telecentric:
            raise ValueError("fields by angles, of a near object, must be seen from a pupil that is not at infinity")
        self.notes.append("fields are angles from the entrance pupil, turned into object heights")
        return [(-reach * math.tan(math.radians(a)), -reach * math.tan(math.radians(b))) for a, b in points]

    def named_glass(self, number: int, name: str) -> OpticalMaterial:
        """Return a glass NAME or NAME_MAKER of the catalogues.

        Parameters
        ----------
        number : int
            Of the surface, for messages.
        name : str
            Name in the file.
        """
        bare, _, maker = name.rpartition("_") if "_" in name else (name, "", "")
        if maker.casefold() == "special" and bare.upper() in SPECIAL:
            return self.within(number, material(SPECIAL[bare.upper()]))
        found, problem = self.catalogued(number, bare, [maker.casefold()] if maker else [])
        if found is None:
            remedy = f"with odak trace --glasses FILE (.agf), or pass glasses={{{name!r}: …}} to {self.reader}"
            raise ValueError(f"{problem} or {remedy}")
        return self.within(number, found)

    def catalogued(self, number: int, name: str, makers: Sequence[str]) -> tuple[OpticalMaterial | None, str]:
        """Return a glass by its name or its successor's, and otherwise None and what is wrong with the name."""
        makers, problem = list(makers), ""
        first = makers[: makers.index("schott")] if "schott" in makers else makers
        for maker in (*(f"{maker}:" for maker in first), "", *(f"{maker}:" for maker in makers)):
            try:
                return material(f"{maker}{name}"), ""
            except ValueError as error:
                problem = str(error) if not maker else problem
        several = [maker for maker in glass_makers() if f"'{maker}:{name}'" in problem]
        # Names of glasses with lead and arsenic, and the names of their successors.
        former = re.fullmatch(r"([A-Z]+?)N?(\d+\w*)", name.upper())
        for maker, prefix in (("schott", "N"), ("hoya", "E"), ("cdgm", "H"), ("hikari", "J")):
            if former and (maker in makers or (prefix == "N" and not makers and not several)):
                for successor in (f"{prefix}-{name.upper()}", f"{prefix}-{former[1]}{former[2]}"):
                    for full in (successor, f"{maker}:{successor}"):
                        try:
                            found = material(full)
                        except ValueError:
                            continue
                        self.notes.append(f"surface {number}: {name} is not known; its successor {found.name} is taken")
                        return found, ""
        if several:
            self.notes.append(
                f"surface {number}: {name} is a glass of several makers; the one by {several[0]} is taken"
            )
            return material(f"{several[0]}:{name}"), ""
        return None, problem

    def within(self, number: int, found: Any) -> Any:
        """Return a material whose range holds the wavelengths, which may reach somewhat beyond its own; noted."""
        low, high = min(self.waves) * 1e3, max(self.waves) * 1e3
        own = found.range
        if own[0] <= low and high <= own[1]:
            return found
        ends = [found.index(value) for value in (low, high)]
        stretched = low < own[0] / MAXIMUM_STRETCH or high > own[1] * MAXIMUM_STRETCH
        if stretched or any(isinstance(value, complex) or not value > 0 for value in ends):
            raise ValueError(
                f"surface {number}: {found.name} must be used from {own[0]:g} to {own[1]:g} µm, got wavelengths from "
                f"{low:g} to {high:g} µm"
            )
        kind = "the model glass" if found.name.startswith("model ") else found.name
        self.notes.append(f"surface {number}: {kind} is extrapolated to {low:g} … {high:g} µm")
        return dataclasses.replace(found, range=(min(low, own[0]), max(high, own[1])))

    def reported(self, system: optical_system, remedy: str = "") -> tuple[optical_system, ZmxReport]:
        """Return what a reader of lens files returns; a system that cannot be meant is warned of."""
        told_impossible(system, remedy, self.notes)
        return system, ZmxReport(tuple(self.ignored), tuple(self.notes))


def lens_text(path: Path) -> str:
    """Return the text of a file: UTF-16 with or without its mark, UTF-8 with or without, or Latin-1.

    Raises
    ------
    ValueError
        If there is no such file, it is too large, or an archive or a black box.
    """
    if not path.is_file():
        raise ValueError(f"path must be a file, got {str(path)!r}")
    with path.open("rb") as stream:
        start = stream.read(2)
    for suffix, marks, kind in SEALED:
        if path.suffix.lower() == suffix or start in marks:
            raise ValueError(f"{path.name} is {kind}, which is not read; save the lens as a text file (.zmx) instead")
    if path.stat().st_size > MAXIMUM_BYTES:
        raise ValueError(f"{path.name}: must be of at most {MAXIMUM_BYTES} bytes, got {path.stat().st_size}")
    return _decoded(path.read_bytes(), path.name)


def _decoded(data: bytes, name: str) -> str:
    encoding = next((encoding for mark, encoding in _MARKS if data.startswith(mark)), "utf-8")
    if encoding == "utf-8" and b"\x00" in data[:2]:
        encoding = "utf-16-le" if data[1:2] == b"\x00" else "utf-16-be"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError:
        if encoding != "utf-8":
            raise ValueError(f"{name}: not valid {encoding}") from None
        return data.decode("latin-1")


def differing(weights: list[float], count: int) -> list[float] | None:
    """Return weights of a file, None where they are all the same or not `count`."""
    return weights if len(weights) == count and len(set(weights)) > 1 else None


def image_of(found: surface) -> surface | None:
    """Return the image surface of a file, None where it is a plane across the axis that limits no rays."""
    flat = found.own_shape is None and not bool(found.curvature) and not bool(found.coefficients.any())
    return None if flat and found.limit is None and not found.is_off_axis else found


def pairs(x: list[float], y: list[float]) -> list[tuple[float, float]]:
    """Return pairs of two lists, the shorter one filled up with zeros."""
    count = max(len(x), len(y))
    return list(zip(*(value + [0.0] * (count - len(value)) for value in (x, y)), strict=True))


def own_tilt(tilt: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the tilt of a surface of its own that acts as rotations Rx·Ry·Rz of these degrees."""
    if not tilt[2] and not (tilt[0] and tilt[1]):
        return tilt
    m = rotation_matrix(np.asarray(tilt, dtype=float), "ZYX")
    found = math.asin(max(-1.0, min(1.0, -m[1, 2]))), math.atan2(m[0, 2], m[2, 2]), math.atan2(m[1, 0], m[1, 1])
    return tuple(map(math.degrees, found))  # type: ignore[return-value]


def aperture_of_working(system: optical_system, number: float) -> float:
    """Return the numerical aperture of a near object at which the working F-number is that stated.

    `system` builds the system from a size and a kind of the aperture. The slope of the marginal ray at the image is
    linear in that at the object.
    """
    slope = 0.01 * float(first_order(system(math.sin(math.atan(0.01)), "NA")).working_f_number) / number
    return math.sin(math.atan(abs(slope)))


def fields_of_image_heights(
    system: optical_system,
    points: Sequence[tuple[float, float]],
    real: bool,
    aim: str = "paraxial",
    notes: list[Any] | None = None,
) -> tuple[tuple[float, float], ...]:
    """Return the field points whose chief rays land at given heights at the primary wavelength.

    Parameters
    ----------
    system : optical_system
        The system.
    points : sequence of pairs
        Heights (x, y) in the image.
    real : bool
        Trace chief rays; else the heights are paraxial.
    aim : str
        Of :func:`launch`; where chief rays through the paraxial pupil do not arrive, "real" in any case.
    notes : list, optional
        To which heights out of reach are appended; the field of the farthest chief ray that arrives replaces theirs.
    """
    properties = first_order(system)
    scale = float(properties.focal_length if system.at_infinity else properties.magnification)
    wanted = torch.tensor(points, dtype=torch.float64)
    size = wanted.square().sum(-1).sqrt()
    if not math.isfinite(scale) or not scale:
        if bool((size > 0).any()):
            raise ValueError(f"fields by image height need a finite focal length or magnification, got {scale:g}")
        return tuple((0.0, 0.0) for _ in points)
    share, met = torch.full_like(size, math.copysign(1.0, scale))[:, None], (size == 0)[:, None] | (not real)
    one, step = torch.ones(()).to(share), torch.full((), 1e-6).to(share)
    with torch.no_grad():
        for by_stop in (False, True) if aim == "paraxial" else (True,):
            left = ~met[:, 0]
            if bool(left.any()):
                errors, start = _misses_of_heights(system, scale, by_stop), torch.zeros_like(share[left])
                goals, rows = _goals(1 + start), wanted[left, None]
                found, _, met[left], _ = _solve(errors, share[left], start, step, one, goals, rows)
                share[left] = torch.where(met[left], found, share[left])
        left = ~met[:, 0]
        if bool(left.any()):
            # From the axis outwards.
            start, rows = torch.zeros_like(share[left]), wanted[left, None]
            found, _, met[left], there = _continuation(errors, start, start, step, one, lambda s: (_goals(s), rows))
            share[left] = found
            far = _fields_at(system, scale, share, wanted[:, None])[0].square().sum(-1).sqrt()[left]
            for height, field, part, good in zip(size[left], far, there, met[left], strict=True):
                if notes is not None and not good:
                    where = f"{float(field):.4g} {'degrees' if system.at_infinity else 'mm'}"
                    notes.append(
                        f"a field by real image height, {float(height):g} mm, is out of reach: chief rays arrive up to "
                        f"{float(part * height):.4g} mm, from {where}, which is taken"
                    )
    fields = _fields_at(system, scale, share, wanted[:, None])[0][:, 0]
    return tuple((float(a) + 0.0, float(b) + 0.0) for a, b in fields)


def _goals(share: torch.Tensor) -> torch.Tensor:
    """Return where rays are to meet, as shares of the heights and of the radius of the pupil: at its centre."""
    return torch.stack([share, 0 * share], -1)


def _fields_at(system, scale: float, share: torch.Tensor, wanted: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return field points at shares of the paraxial fields of image heights, and whether they exist.

    The shares are those of angles, which stay finite, where the object is at infinity.
    """
    size = wanted.square().sum(-1)[..., None].sqrt()
    unit = wanted / torch.where(size > 0, size, 1.0)
    if not system.at_infinity:
        return share[..., None] * size / abs(scale) * unit, torch.ones_like(share, dtype=torch.bool)
    angle = share[..., None] * torch.atan(size / abs(scale))
    exists = angle.abs() < 1.56
    return torch.rad2deg(torch.atan(torch.tan(torch.where(exists, angle, 0.0)) * unit)), exists[..., 0]


def _misses_of_heights(system, scale: float, by_stop: bool) -> Callable[..., Any]:
    """Return the function that gives how far chief rays miss their goals, of shares of fields and of places.

    Field and place in the pupil are solved for together, so that the ray meets its height and the centre of the stop;
    without `by_stop` that of the paraxial pupil.
    """
    numbers = system.prescription().at(system.reference)
    pupil = entrance_pupil(system, prescription=numbers)

    def errors(share, place, goals, wanted):
        fields, exists = _fields_at(system, scale, share, wanted)
        size = wanted.square().sum(-1).sqrt()
        ways = (wanted / size[..., None]).reshape(-1, 2)
        across = (pupil.middle[i] + pupil.reach * place.reshape(-1, 1) * ways[:, i, None] for i in range(2))
        rays = through_places(system, fields.reshape(-1, 1, 2), pupil, *across)
        image = trace(system, rays, prescription=numbers, vignetting=False)
        height, held, off = _along(image, ways, share.shape), exists & image.arrived.reshape(share.shape), place
        if by_stop:
            *stop, kept = at_stop(system, numbers, rays)
            off, held = _along(stop, ways, share.shape) / pupil.stop_radius, held & kept.reshape(share.shape)
        return height / size - goals[..., 0], off - goals[..., 1], held

    return errors


def _along(points, ways: torch.Tensor, shape) -> torch.Tensor:
    """Return the coordinates of points along directions ``[N, 2]`` across the axis."""
    return (torch.stack([value.flatten() for value in points[:2]], -1) * ways).sum(-1).reshape(shape)
