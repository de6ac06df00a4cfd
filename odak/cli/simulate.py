"""Optical benches described in a file, for `odak simulate`: sources, apertures, lenses, modulators and propagations.

The file, in TOML or JSON, holds a table ``bench`` (wavelength, resolution, pixel pitch) and a list ``elements``, which
the field passes in order. Lengths are numbers of metres, or texts with a unit such as ``"15cm"``.
"""

import json
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from odak import _validate, wave
from odak.cli import files, report
from odak.cli.job import InputError, check_wavelength, did_you_mean, parse_length, warn_of_samples
from odak.wave.bench import Light
from odak.wave.elements import hyperbolic_lens
from odak.wave.methods import PROPAGATION_TYPES
from odak.wave.sampling import Weaker, sampled_axes, warn_beyond_nyquist, warn_of_tilt
from odak.wave.transfer_functions import pitches

BENCH, ELEMENTS, CONFIG = "bench", "elements", "config.json"
MOST_SAMPLES = 16384


class Parameter(NamedTuple):
    """A parameter of the bench or of an element: its type, its default, and its meaning."""

    kind: str  # length, positive length, pitch, number, name, file, method, pair of lengths, pair of counts, angle
    default: Any
    meaning: str


REQUIRED = object()
_OFFSET = Parameter("pair of lengths", (0.0, 0.0), "Position of the centre (rows, columns).")
BENCH_PARAMETERS = {
    "wavelength": Parameter("positive length", REQUIRED, "Wavelength of the light."),
    "resolution": Parameter("pair of counts", REQUIRED, "Rows and columns of the field."),
    "pixel_pitch": Parameter("pitch", REQUIRED, "Distance between samples of the field."),
}
KINDS: dict[str, dict[str, Parameter]] = {
    "plane_wave": {
        "amplitude": Parameter("number", 1.0, "Amplitude."),
        "tilt": Parameter("pair of angles", (0.0, 0.0), "Angles to the axis in degrees (rows, columns)."),
    },
    "gaussian_beam": {
        "waist": Parameter("positive length", REQUIRED, "Radius of the waist, where the amplitude is 1/e."),
        "distance": Parameter("length", 0.0, "Distance behind the waist."),
        "power": Parameter("number", 1.0, "Power of the beam."),
        "offset": _OFFSET,
    },
    "point_source": {
        "distance": Parameter("positive length", REQUIRED, "Distance from the point to the field."),
        "amplitude": Parameter("number", 1.0, "Amplitude on the axis."),
        "offset": _OFFSET,
    },
    "circular_aperture": {
        "diameter": Parameter("positive length", REQUIRED, "Diameter of the opening."),
        "offset": _OFFSET,
    },
    "rectangular_aperture": {
        "size": Parameter("pair of lengths", REQUIRED, "Height and width of the opening."),
        "offset": _OFFSET,
    },
    "lens": {
        "focal_length": Parameter("length", REQUIRED, "Focal length; positive converges."),
        "diameter": Parameter("positive length", None, "Diameter; without it, the lens is as large as the field."),
        "offset": _OFFSET,
    },
    "slm": {
        "pattern": Parameter("file", REQUIRED, "Grey picture of the phase, pixel by pixel: 0 is 0, white + 1 is 2 pi."),
    },
    "mask": {
        "picture": Parameter("file", REQUIRED, "Grey picture of the transmitted intensity, 0 to 1, pixel by pixel."),
    },
    "propagate": {
        "distance": Parameter("length", REQUIRED, "Distance; negative goes back."),
        "method": Parameter("method", "auto", "Propagation method."),
        "pixel_pitch": Parameter("pitch", None, "Distance between samples behind; without it, that in front."),
        "resolution": Parameter("pair of counts", None, "Rows and columns behind; without it, those in front."),
    },
    "record": {
        "name": Parameter("name", REQUIRED, "Name of the files that hold the field at this place."),
    },
}
SOURCES = ("plane_wave", "gaussian_beam", "point_source")
_TYPES: dict[str, dict] = {
    "length": {"type": ["number", "string"], "description": "metres, or a number with a unit"},
    "positive length": {"type": ["number", "string"], "description": "metres, or a number with a unit; positive"},
    "pitch": {
        "oneOf": [
            {"type": ["number", "string"]},
            {"type": "array", "items": {"type": ["number", "string"]}, "minItems": 2, "maxItems": 2},
        ],
        "description": "metres, or a number with a unit; positive; one, or a pair (rows, columns)",
    },
    "number": {"type": "number"},
    "name": {"type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9_-]*$"},
    "file": {"type": "string"},
    "method": {"enum": list(PROPAGATION_TYPES)},
    "pair of lengths": {"type": "array", "items": {"type": ["number", "string"]}, "minItems": 2, "maxItems": 2},
    "pair of counts": {
        "type": "array",
        "items": {"type": "integer", "minimum": 1, "maximum": MOST_SAMPLES},
        "minItems": 2,
        "maxItems": 2,
    },
    "pair of angles": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
}


@files.claiming
def run(config: Path, output: Path, notices: files.Notices = files.SILENT) -> dict:
    """Pass light through the bench of a file, and write the fields that it records.

    Parameters
    ----------
    config : Path
        TOML or JSON file.
    output : Path
        Folder to write to: for each record ``NAME.npy`` (complex64) and ``NAME.png``, and ``report.json``, which holds
        the configuration.
    notices : files.Notices
        What to do about results of earlier runs.

    Returns
    -------
    dict
        The report.

    Raises
    ------
    InputError
        If the file cannot be read or does not conform to the schema.
    """
    with report.collected_warnings() as texts:
        bench, elements = checked(read_config(config), Path(config).expanduser().resolve().parent)
        check_wavelength(f"{BENCH}: wavelength", bench["wavelength"])
        coarsest = max(pitches(bench["pixel_pitch"]))
        warn_of_samples(f"{BENCH}: wavelength", bench["wavelength"], f"{BENCH}: pixel_pitch", coarsest)
        folder = files.writable_folder(output)
        given = [Path(element[name]) for element in elements for name in ("pattern", "picture") if name in element]
        mark = files.fingerprint({"command": "simulate", BENCH: bench, ELEMENTS: elements}, given)
        if (kept := files.kept_report(folder, mark, notices)) is not None:
            return kept
        recorded = [element["name"] for element in elements if element["kind"] == "record"]
        names = [f"{name}{suffix}" for name in recorded for suffix in SUFFIXES]
        files.announce(folder, [*names, files.REPORT], notices)
        light = Light(np.zeros(bench["resolution"], complex), bench["pixel_pitch"])
        steps, power, before = [], 0.0, 0.0
        for element in elements:
            kind = element["kind"]
            if kind in SOURCES:
                light = replace(light, field=light.field + SOURCE[kind](bench, element))
            with wave.power_budget() as budget:
                for part in PASSAGE[kind](light, element) if kind in PASSAGE else ():
                    light = light.through(part, bench["wavelength"])
            area = math.prod(pitches(light.pitch))
            step = {"kind": kind, "power": float(np.sum(np.abs(light.field) ** 2) * area)}
            power = step["power"] if kind in SOURCES else power
            step["share_of_source"] = step["power"] / power if power > 0 else None
            if budget.steps and before > 0:
                step["lost"] = {name: round(getattr(budget, name), 9) for name in ("band", "aperture", "window")}
            before = step["power"]
            if kind == "record":
                step |= _write(folder, element["name"], light.sampled(bench["wavelength"]), light.pitch)
            steps.append(step)
    summary = {
        "bench": bench,
        "elements": elements,
        "steps": steps,
        "warnings": texts,
        "versions": report.versions(),
        "definitions": {
            "power": "Sum of the intensity over the samples times their area.",
            "share_of_source": "Power over that behind the last source.",
            "lost": "Shares of the power in front: beyond the band of the method, at apertures, beside the window.",
            "peak_position": "Metres from the centre of the field, sample n // 2, rows and columns.",
        },
    }
    return files.write_report(folder, summary, mark, names)


SUFFIXES = (".npy", ".png")


def schema() -> dict:
    """Return the JSON schema of the file."""

    def described(parameters: dict[str, Parameter], **more: dict) -> dict:
        properties = {
            name: {**_TYPES[parameter.kind], "title": parameter.meaning} for name, parameter in parameters.items()
        }
        required = [name for name, parameter in parameters.items() if parameter.default is REQUIRED]
        return {
            "type": "object",
            "properties": {**more, **properties},
            "required": [*more, *required],
            "additionalProperties": False,
        }

    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Optical bench of odak simulate",
        "type": "object",
        "properties": {
            BENCH: described(BENCH_PARAMETERS),
            ELEMENTS: {
                "type": "array",
                "minItems": 1,
                "items": {"oneOf": [described(parameters, kind={"const": kind}) for kind, parameters in KINDS.items()]},
            },
        },
        "required": [BENCH, ELEMENTS],
        "additionalProperties": False,
    }


def read_config(path: Path) -> dict:
    """Return the content of a TOML or JSON file; raise InputError where there is none."""
    path = Path(os.path.expanduser(path))
    if not path.exists():
        raise InputError(f"CONFIG not found: {str(path)!r}")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"CONFIG cannot be read: {str(path)!r} ({' '.join(str(error).split())})") from None
    if path.suffix.lower() == ".json":
        try:
            return json.loads(text)
        except (json.JSONDecodeError, RecursionError) as error:
            place = f"line {error.lineno}" if isinstance(error, json.JSONDecodeError) else "it is nested too deeply"
            raise InputError(f"CONFIG {str(path)!r} is not valid JSON: {place}") from None
    if path.suffix.lower() != ".toml":
        raise InputError(f"CONFIG must end in .toml or .json, got {str(path)!r}")
    try:
        import tomllib as toml
    except ModuleNotFoundError:  # Python 3.10
        import tomli as toml  # type: ignore[import-not-found,no-redef]
    try:
        return toml.loads(text)
    except (toml.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"CONFIG {str(path)!r} is not valid TOML: {error}") from None


def checked(config: Any, folder: Path) -> tuple[dict, list[dict]]:
    """Return bench and elements with their defaults and with lengths in metres.

    Parameters
    ----------
    config : dict
        Content of the file.
    folder : Path
        Folder that paths of pictures are relative to.

    Raises
    ------
    InputError
        If the content does not conform to the schema; the message names the element.
    """
    if not isinstance(config, dict):
        raise InputError(f"CONFIG must be a table with {BENCH!r} and {ELEMENTS!r}, got {type(config).__name__}")
    _check_names("CONFIG", config, (BENCH, ELEMENTS), (BENCH, ELEMENTS))
    if not isinstance(config[BENCH], dict):
        raise InputError(f"{BENCH} must be a table, got {type(config[BENCH]).__name__}")
    if not isinstance(config[ELEMENTS], list) or not config[ELEMENTS]:
        raise InputError(f"{ELEMENTS} must be a list of at least one element")
    bench = _filled(BENCH, config[BENCH], BENCH_PARAMETERS, folder)
    elements = []
    passed = False
    recorded: set[str] = set()
    for number, given in enumerate(config[ELEMENTS], 1):
        if not isinstance(given, dict) or "kind" not in given:
            raise InputError(f"element {number} must be a table with a 'kind': {', '.join(KINDS)}")
        kind = given["kind"]
        if kind not in KINDS:
            near = did_you_mean(str(kind), KINDS)
            raise InputError(f"element {number} must have a kind of {', '.join(KINDS)}; got {kind!r}.{near}")
        where = f"element {number} ({kind})"
        rest = {name: value for name, value in given.items() if name != "kind"}
        element = {"kind": kind, **_filled(where, rest, KINDS[kind], folder)}
        if kind in SOURCES and passed:
            raise InputError(f"{where}: sources come first; the fields of several add up")
        if number == 1 and kind not in SOURCES:
            raise InputError(f"{where}: the first element must be a source: {', '.join(SOURCES)}")
        passed = passed or kind not in SOURCES
        if kind == "record" and element["name"].casefold() in recorded | {"report"}:
            raise InputError(f"{where}: name {element['name']!r} is already used")
        recorded.add(str(element.get("name", "")).casefold())
        elements.append(element)
    if elements[-1]["kind"] != "record":
        raise InputError(
            f"the last element must be a record, otherwise no result is saved; got {elements[-1]['kind']!r}"
        )
    return bench, elements


def _check_names(where: str, given: dict, known, required) -> None:
    for name in given:
        if name not in known:
            raise InputError(
                f"{where} has no parameter {name!r}; accepted: {', '.join(known)}.{did_you_mean(str(name), known)}"
            )
    missing = [name for name in required if name not in given]
    if missing:
        raise InputError(f"{where} needs {', '.join(missing)}")


def _filled(where: str, given: dict, parameters: dict[str, Parameter], folder: Path) -> dict:
    _check_names(where, given, parameters, [name for name, one in parameters.items() if one.default is REQUIRED])
    values = {}
    for name, parameter in parameters.items():
        try:
            values[name] = _value(parameter.kind, given[name], folder) if name in given else parameter.default
        except (TypeError, ValueError) as error:
            raise InputError(f"{where}: {name} must be {_wanted(parameter.kind)}, got {given[name]!r:.80}") from error
    return values


def _wanted(kind: str) -> str:
    texts = {
        "length": "a length such as 0.15 (metres) or '15cm'",
        "positive length": "a positive length such as 8e-6 (metres) or '8um'",
        "pitch": "a positive length such as 8e-6 (metres) or '8um', or a pair [rows, columns] of them",
        "number": "a finite number",
        "name": "a name of letters, digits, '-' and '_'",
        "file": "the path of a picture that exists",
        "method": f"one of {', '.join(_TYPES['method']['enum'])}",
        "pair of lengths": "two lengths [rows, columns]",
        "pair of counts": f"two whole numbers [rows, columns] from 1 to {MOST_SAMPLES}",
        "pair of angles": "two angles in degrees [rows, columns], below 90",
    }
    return texts[kind]


def _value(kind: str, value: Any, folder: Path) -> Any:
    """Return a value of one of the types of the schema; raise ValueError or TypeError otherwise."""
    if kind in ("length", "positive length", "number"):
        if isinstance(value, bool) or not isinstance(value, (int, float) if kind == "number" else (int, float, str)):
            raise TypeError
        number = float(value if kind == "number" else parse_length(value))
        if not math.isfinite(number) or (kind == "positive length" and number <= 0):
            raise ValueError
        return number
    if kind == "pitch" and not isinstance(value, list):
        return _value("positive length", value, folder)
    if kind == "pitch" or kind.startswith("pair"):
        if not isinstance(value, list) or len(value) != 2:
            raise ValueError
        if kind == "pair of counts":
            if not all(type(count) is int and 1 <= count <= MOST_SAMPLES for count in value):
                raise ValueError
            return value
        single = {"pair of angles": "number", "pitch": "positive length"}.get(kind, "length")
        pair = [_value(single, part, folder) for part in value]
        if kind == "pair of angles" and max(map(abs, pair)) >= 90:
            raise ValueError
        return pair
    if not isinstance(value, str):
        raise TypeError
    if kind == "file":
        path = folder / os.path.expanduser(value)
        if not path.is_file():
            raise ValueError
        return str(path)
    if kind == "method":
        return _validate.one_of(kind, value, _TYPES["method"]["enum"])
    if not value or not value.isascii() or not value.replace("-", "").replace("_", "").isalnum() or value[0] in "-_":
        raise ValueError
    return value


# --- Sources, which return fields, and elements, which change them


def _grid(resolution: Sequence[int], pitch: Any, offset: Any = (0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of the samples in metres, ``[rows, 1]`` and ``[1, columns]``, relative to an offset."""
    rows, columns = (
        (np.arange(count) - count // 2) * step - shift
        for count, step, shift in zip(resolution, pitches(pitch), offset, strict=True)
    )
    return rows[:, None], columns[None, :]


def _plane_wave(bench: dict, element: dict) -> np.ndarray:
    rows, columns = _grid(bench["resolution"], bench["pixel_pitch"])
    k = wave.wavenumber(bench["wavelength"])
    for step, angle in zip(pitches(bench["pixel_pitch"]), element["tilt"], strict=True):
        warn_of_tilt("plane_wave", step, k, angle)
    tilt = [math.sin(math.radians(angle)) for angle in element["tilt"]]
    return np.asarray(wave.generate_complex_field(element["amplitude"], k * (tilt[0] * rows + tilt[1] * columns)))


def _gaussian_beam(bench: dict, element: dict) -> np.ndarray:
    result = wave.gaussian_beam(
        bench["resolution"],
        bench["pixel_pitch"],
        bench["wavelength"],
        element["waist"],
        element["distance"],
        power=element["power"],
        offset=element["offset"],
    )
    return np.asarray(result)


def _point_source(bench: dict, element: dict) -> np.ndarray:
    pitch, numbers = bench["pixel_pitch"], (element["distance"], bench["wavelength"])
    axes = sampled_axes(bench["resolution"], pitches(pitch), element["offset"])
    further = Weaker(0, 1, "a distance of at least {:.3g} m")
    warn_beyond_nyquist("point_source", hyperbolic_lens, axes, numbers, further)
    rows, columns = _grid(bench["resolution"], pitch, element["offset"])
    distance = np.sqrt(rows**2 + columns**2 + element["distance"] ** 2)
    phase = wave.wavenumber(bench["wavelength"]) * (distance - element["distance"])
    return np.asarray(wave.generate_complex_field(element["amplitude"] * element["distance"] / distance, phase))


def _circular_aperture(light: Light, element: dict) -> list:
    return [wave.CircularAperture(element["diameter"] / 2, element["offset"])]


def _rectangular_aperture(light: Light, element: dict) -> list:
    height, width = element["size"]
    return [wave.RectangularAperture(height, width, element["offset"])]


def _lens(light: Light, element: dict) -> list:
    lens = wave.ThinLens(element["focal_length"], element["offset"])
    return [lens] if element["diameter"] is None else [lens, *_circular_aperture(light, element)]


def _slm(light: Light, element: dict) -> list:
    phase = files.load_pattern(element["pattern"], files.stored_bits(element["pattern"]))
    return [wave.Mask(wave.generate_complex_field(1.0, _fitting(phase, light, element["pattern"])))]


def _mask(light: Light, element: dict) -> list:
    from odak.learn.tools import load_image

    picture = load_image(element["picture"], normalizeby=None)
    return [wave.Mask(np.sqrt(_fitting(picture, light, element["picture"])))]


def _fitting(picture: torch.Tensor, light: Light, path: str) -> np.ndarray:
    values, wanted = picture.double().numpy(), light.field.shape
    values = values[..., :3].mean(-1) if values.ndim == 3 else values
    if values.shape != wanted:
        raise InputError(
            f"{path!r} must have the resolution of the field, {wanted[0]} x {wanted[1]} pixels; "
            f"got {values.shape[0]} x {values.shape[1]}"
        )
    return values


def _propagate(light: Light, element: dict) -> list:
    return [wave.FreeSpace(element["distance"], element["method"], element["resolution"], element["pixel_pitch"])]


SOURCE: dict[str, Callable[[dict, dict], np.ndarray]] = {
    "plane_wave": _plane_wave,
    "gaussian_beam": _gaussian_beam,
    "point_source": _point_source,
}
PASSAGE: dict[str, Callable[[Light, dict], list]] = {
    "circular_aperture": _circular_aperture,
    "rectangular_aperture": _rectangular_aperture,
    "lens": _lens,
    "slm": _slm,
    "mask": _mask,
    "propagate": _propagate,
}


def _write(folder: Path, name: str, field: np.ndarray, pitch: Any) -> dict:
    """Write a field as data and as pictures, and return its numbers."""
    from odak.tools.paths import replacing

    with replacing(str(folder / f"{name}.npy")) as stream:
        np.save(stream, field.astype(np.complex64))
    intensity = np.abs(field) ** 2
    peak = np.unravel_index(int(intensity.argmax()), intensity.shape)
    total = intensity.sum()
    places = _grid(field.shape, pitch)
    position = [float(axis.ravel()[index]) for axis, index in zip(places, peak, strict=True)]
    centroid = [float((axis * intensity).sum() / total) if total else None for axis in places]
    largest = float(intensity.max())
    shade = torch.as_tensor(intensity / (largest or 1.0))[None]
    panels = [
        report.picture_panel(f"{name}: intensity, white is {largest:.4g}", shade),
        report.phase_panel(f"{name}: phase", torch.as_tensor(np.angle(field))),
    ]
    dy, dx = pitches(pitch)
    files.write_png(folder / f"{name}.png", report.sheet([panels], field.shape[1] * dx, dy / dx))
    return {
        "name": name,
        "pixel_pitch": pitch,
        "peak": largest,
        "peak_position": position,
        "centroid": centroid,
    }
