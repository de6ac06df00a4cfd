"""Optical benches that a file describes: sources, apertures, lenses, modulators and propagations.

The description, in TOML or JSON, holds a table ``bench`` (wavelength, resolution, pixel pitch) and a list ``elements``,
which the field passes in order. Lengths are numbers of metres, or texts with a unit such as ``"15cm"``.
"""

import copy
import importlib
import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from odak import _validate
from odak._call_forms import did_you_mean
from odak._lengths import parse_length
from odak.tools.file import read_levels, white_level
from odak.tools.paths import naming, regular_file
from odak.wave.beams import gaussian_beam
from odak.wave.bench import CircularAperture, FreeSpace, Light, Mask, RectangularAperture, ThinLens
from odak.wave.elements import hyperbolic_lens
from odak.wave.fields import generate_complex_field, power_budget, wavenumber
from odak.wave.methods import PROPAGATION_TYPES
from odak.wave.sampling import Weaker, sampled_axes, warn_beyond_nyquist, warn_of_tilt
from odak.wave.transfer_functions import pitches

BENCH, ELEMENTS = "bench", "elements"
# The schema of the files says which parameters there are, of which kinds, and what they are where they are left out.
_SCHEMA: dict[str, Any] = json.loads(
    resources.files("odak").joinpath("assets/bench_schema.json").read_text(encoding="utf-8")
)
_SCHEMA["$defs"]["method"]["enum"] = list(PROPAGATION_TYPES)
KINDS: dict[str, dict[str, Any]] = {
    one["properties"]["kind"]["const"]: one for one in _SCHEMA["properties"][ELEMENTS]["items"]["oneOf"]
}
MOST_SAMPLES: int = _SCHEMA["$defs"]["pair_of_counts"]["items"]["maximum"]
SOURCES = ("plane_wave", "gaussian_beam", "point_source")


class BenchStep(NamedTuple):
    """One element of a bench that a file describes, and the light behind it.

    Attributes
    ----------
    kind : str
        Kind of the element.
    power : float
        Sum of the intensity behind it over the samples times their area.
    share_of_source : float or None
        The power over that behind the last source; None without light.
    lost : dict or None
        Shares of the power in front that are lost beyond the band of the method, at apertures and beside the window;
        None where nothing of the kind can be lost.
    name : str or None
        Name of a record, None of other elements.
    field : numpy.ndarray or None
        Field of a record, complex ``[rows, columns]``.
    pitch : float or sequence of float
        Distance between its samples in metres, one number or a pair (rows, columns).

    Examples
    --------
    >>> from odak.wave import simulate_bench
    >>> bench = {"wavelength": "532nm", "resolution": [32, 32], "pixel_pitch": "8um"}
    >>> elements = [{"kind": "plane_wave"}, {"kind": "record", "name": "here"}]
    >>> source, record = simulate_bench({"bench": bench, "elements": elements})
    >>> record.name, record.field.shape, source.field is None
    ('here', (32, 32), True)
    """

    kind: str
    power: float
    share_of_source: float | None
    lost: dict[str, float] | None
    name: str | None
    field: np.ndarray | None
    pitch: Any


def simulate_bench(config: dict[str, Any] | str | os.PathLike[str]) -> list[BenchStep]:
    """Return the steps of light through an optical bench that a file describes, with the fields that it records.

    Use it for a bench that is written down rather than programmed, and read by others; `odak simulate` runs the same
    files. For elements of your own, gradients or several wavelengths, use :class:`optical_bench`.

    Parameters
    ----------
    config : dict, str or os.PathLike
        TOML or JSON file, or its content: a table ``bench`` and a list ``elements``, whose schema :func:`bench_schema`
        returns. Sources come first, whose fields are added; the last element is a record. Paths of pictures are
        relative to the file, those in a dict to the working directory.

    Returns
    -------
    list of BenchStep
        One for each element.

    Raises
    ------
    ValueError, TypeError
        If the file cannot be read or does not conform to the schema; the message names the element.

    See Also
    --------
    optical_bench : Benches of objects.

    Examples
    --------
    The focus of a lens of 1.2 mm and 10 cm, whose peak is (area/(wavelength·focal length))² times the incident light:

    >>> import numpy as np
    >>> from odak.wave import simulate_bench
    >>> bench = {"wavelength": "532nm", "resolution": [256, 256], "pixel_pitch": "8um"}
    >>> elements = [
    ...     {"kind": "plane_wave"},
    ...     {"kind": "lens", "focal_length": "10cm", "diameter": "1.2mm"},
    ...     {"kind": "propagate", "distance": "10cm"},
    ...     {"kind": "record", "name": "focus"},
    ... ]
    >>> *_, focus = simulate_bench({"bench": bench, "elements": elements})
    >>> peak = (np.pi * 0.6e-3**2 / (532e-9 * 0.1)) ** 2
    >>> round(float(abs(focus.field[128, 128]) ** 2 / peak), 2)
    1.0
    """
    return list(steps_of(*load_bench(config)))


def load_bench(config: Any) -> tuple[dict[Any, Any], list[dict[Any, Any]]]:
    """Return bench and elements of a file or its content; see :func:`checked`."""
    if isinstance(config, dict):
        return checked(config, Path())
    _validate.instance("config", config, (str, os.PathLike), "a dict or the path of a file")
    path = Path(os.path.expanduser(config))
    with naming(path):
        return checked(read_config(path), path.resolve().parent)


def steps_of(bench: dict[Any, Any], elements: Sequence[dict[Any, Any]]) -> Iterator[BenchStep]:
    """Yield the steps of a bench that has been checked."""
    light = Light(np.zeros(bench["resolution"], complex), bench["pixel_pitch"])
    of_source, before = 0.0, 0.0
    for element in elements:
        kind = element["kind"]
        if kind in SOURCES:
            light = replace(light, field=light.field + SOURCE[kind](bench, element))
        with power_budget() as budget:
            for part in PASSAGE[kind](light, element) if kind in PASSAGE else ():
                light = light.through(part, bench["wavelength"])
        power = float(np.sum(np.abs(light.field) ** 2) * math.prod(pitches(light.pitch)))
        of_source = power if kind in SOURCES else of_source
        lost = None
        if budget.steps and before > 0:
            lost = {name: round(getattr(budget, name), 9) for name in ("band", "aperture", "window")}
        before = power
        field = light.sampled(bench["wavelength"]) if kind == "record" else None
        share = power / of_source if of_source > 0 else None
        yield BenchStep(kind, power, share, lost, element.get("name"), field, light.pitch)


def bench_schema() -> dict[str, Any]:
    """Return the JSON schema of the files that :func:`simulate_bench` and `odak simulate` read.

    Returns
    -------
    dict
        Schema of the draft 2020-12: kinds of elements, their parameters, and what they mean.

    Examples
    --------
    >>> from odak.wave import bench_schema
    >>> elements = bench_schema()["properties"]["elements"]["items"]["oneOf"]
    >>> [one["properties"]["kind"]["const"] for one in elements][:3]
    ['plane_wave', 'gaussian_beam', 'point_source']
    """
    return copy.deepcopy(_SCHEMA)


def read_config(path: Path) -> dict[Any, Any]:
    """Return the content of a TOML or JSON file; raise ValueError where there is none."""
    if not path.exists():
        raise ValueError(f"config not found: {str(path)!r}")
    told = f"config cannot be read: {str(path)!r}"
    with _validate.refusing(lambda text: f"{told} ({' '.join(text.split())})", OSError, ValueError):
        text = Path(regular_file(str(path))).read_text(encoding="utf-8")
    if path.suffix.lower() == ".json":
        try:
            return json.loads(text)
        except (json.JSONDecodeError, RecursionError) as error:
            place = f"line {error.lineno}" if isinstance(error, json.JSONDecodeError) else "it is nested too deeply"
            raise ValueError(f"config {str(path)!r} is not valid JSON: {place}") from None
    if path.suffix.lower() != ".toml":
        raise ValueError(f"config must end in .toml or .json, got {str(path)!r}")
    toml = importlib.import_module("tomllib" if sys.version_info >= (3, 11) else "tomli")
    with _validate.refusing(f"config {str(path)!r} is not valid TOML: ", toml.TOMLDecodeError, RecursionError):
        return toml.loads(text)


def checked(config: Any, folder: Path) -> tuple[dict[Any, Any], list[dict[Any, Any]]]:
    """Return bench and elements with their defaults and with lengths in metres.

    Parameters
    ----------
    config : dict
        Content of the file.
    folder : Path
        Folder that paths of pictures are relative to.

    Raises
    ------
    ValueError
        If the content does not conform to the schema; the message names the element.
    """
    _validate.instance("config", config, dict, f"a table with {BENCH} and {ELEMENTS}")
    _check_names("config", config, (BENCH, ELEMENTS), (BENCH, ELEMENTS))
    if not isinstance(config[BENCH], dict):
        raise ValueError(f"{BENCH} must be a table, got {type(config[BENCH]).__name__}")
    if not isinstance(config[ELEMENTS], list) or not config[ELEMENTS]:
        raise ValueError(f"{ELEMENTS} must be a list of at least one element")
    bench = _filled(BENCH, config[BENCH], _SCHEMA["properties"][BENCH], folder)
    elements = []
    passed = False
    recorded: set[str] = set()
    for number, given in enumerate(config[ELEMENTS], 1):
        if not isinstance(given, dict) or "kind" not in given:
            raise ValueError(f"element {number} must be a table with a 'kind': {', '.join(KINDS)}")
        kind = given["kind"]
        if kind not in KINDS:
            near = did_you_mean(str(kind), KINDS)
            raise ValueError(f"element {number} must have a kind of {', '.join(KINDS)}; got {kind!r}.{near}")
        where = f"element {number} ({kind})"
        rest = {name: value for name, value in given.items() if name != "kind"}
        element = {"kind": kind, **_filled(where, rest, KINDS[kind], folder)}
        if kind in SOURCES and passed:
            raise ValueError(f"{where}: sources come first; the fields of several add up")
        if number == 1 and kind not in SOURCES:
            raise ValueError(f"{where}: the first element must be a source: {', '.join(SOURCES)}")
        passed = passed or kind not in SOURCES
        if kind == "record" and element["name"].casefold() in recorded | {"report"}:
            raise ValueError(f"{where}: name {element['name']!r} is already used")
        recorded.add(str(element.get("name", "")).casefold())
        elements.append(element)
    if elements[-1]["kind"] != "record":
        raise ValueError(
            f"the last element must be a record, otherwise no result is saved; got {elements[-1]['kind']!r}"
        )
    return bench, elements


def _check_names(where: str, given: dict[Any, Any], known, required) -> None:
    for name in given:
        if name not in known:
            raise ValueError(
                f"{where} has no parameter {name!r}; accepted: {', '.join(known)}.{did_you_mean(str(name), known)}"
            )
    missing = [name for name in required if name not in given]
    if missing:
        raise ValueError(f"{where} needs {', '.join(missing)}")


def _filled(where: str, given: dict[Any, Any], schema: dict[str, Any], folder: Path) -> dict[Any, Any]:
    """Return the values of a table, checked and with the defaults of its schema."""
    parameters = {name: one for name, one in schema["properties"].items() if name != "kind"}
    _check_names(where, given, parameters, [name for name in schema["required"] if name != "kind"])
    values = {}
    for name, parameter in parameters.items():
        kind = parameter["$ref"].rpartition("/")[2].replace("_", " ")
        try:
            values[name] = _value(kind, given[name], folder) if name in given else parameter.get("default")
        except (TypeError, ValueError) as error:
            raise ValueError(f"{where}: {name} must be {_wanted(kind)}, got {given[name]!r:.80}") from error
    return values


def _wanted(kind: str) -> str:
    texts = {
        "length": "a length such as 0.15 (metres) or '15cm'",
        "positive length": "a positive length such as 8e-6 (metres) or '8um'",
        "pitch": "a positive length such as 8e-6 (metres) or '8um', or a pair [rows, columns] of them",
        "number": "a finite number",
        "name": "a name of letters, digits, '-' and '_'",
        "file": "the path of a picture that exists",
        "method": f"one of {', '.join(PROPAGATION_TYPES)}",
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
        return _validate.one_of(kind, value, PROPAGATION_TYPES)
    if not value or not value.isascii() or not value.replace("-", "").replace("_", "").isalnum() or value[0] in "-_":
        raise ValueError
    return value


# --- Sources, which return fields, and elements, which change them


def positions(resolution: Sequence[int], pitch: Any, offset: Any = (0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of the samples in metres, ``[rows, 1]`` and ``[1, columns]``, relative to an offset."""
    rows, columns = (
        (np.arange(count) - count // 2) * step - shift
        for count, step, shift in zip(resolution, pitches(pitch), offset, strict=True)
    )
    return rows[:, None], columns[None, :]


def _plane_wave(bench: dict[Any, Any], element: dict[Any, Any]) -> np.ndarray:
    rows, columns = positions(bench["resolution"], bench["pixel_pitch"])
    k = wavenumber(bench["wavelength"])
    for step, angle in zip(pitches(bench["pixel_pitch"]), element["tilt"], strict=True):
        warn_of_tilt("plane_wave", step, k, angle)
    tilt = [math.sin(math.radians(angle)) for angle in element["tilt"]]
    return np.asarray(generate_complex_field(element["amplitude"], k * (tilt[0] * rows + tilt[1] * columns)))


def _gaussian_beam(bench: dict[Any, Any], element: dict[Any, Any]) -> np.ndarray:
    result = gaussian_beam(
        bench["resolution"],
        bench["pixel_pitch"],
        bench["wavelength"],
        element["waist"],
        element["distance"],
        power=element["power"],
        offset=element["offset"],
    )
    return np.asarray(result)


def _point_source(bench: dict[Any, Any], element: dict[Any, Any]) -> np.ndarray:
    pitch, numbers = bench["pixel_pitch"], (element["distance"], bench["wavelength"])
    axes = sampled_axes(bench["resolution"], pitches(pitch), element["offset"])
    further = Weaker(0, 1, "a distance of at least {:.3g} m")
    warn_beyond_nyquist("point_source", hyperbolic_lens, axes, numbers, further)
    rows, columns = positions(bench["resolution"], pitch, element["offset"])
    distance = np.sqrt(rows**2 + columns**2 + element["distance"] ** 2)
    phase = wavenumber(bench["wavelength"]) * (distance - element["distance"])
    return np.asarray(generate_complex_field(element["amplitude"] * element["distance"] / distance, phase))


def _circular_aperture(light: Light, element: dict[Any, Any]) -> list[Any]:
    return [CircularAperture(element["diameter"] / 2, element["offset"])]


def _rectangular_aperture(light: Light, element: dict[Any, Any]) -> list[Any]:
    height, width = element["size"]
    return [RectangularAperture(height, width, element["offset"])]


def _lens(light: Light, element: dict[Any, Any]) -> list[Any]:
    lens = ThinLens(element["focal_length"], element["offset"])
    return [lens] if element["diameter"] is None else [lens, *_circular_aperture(light, element)]


def _slm(light: Light, element: dict[Any, Any]) -> list[Any]:
    levels = read_levels(element["pattern"])
    grey = _fitting(levels, light, element["pattern"])
    depth = 256 if levels.dtype == np.uint8 else 65536
    return [Mask(generate_complex_field(1.0, np.round(grey * (depth - 1)) * (2 * math.pi / depth)))]


def _mask(light: Light, element: dict[Any, Any]) -> list[Any]:
    return [Mask(np.sqrt(_fitting(read_levels(element["picture"]), light, element["picture"])))]


def _fitting(levels: np.ndarray, light: Light, path: str) -> np.ndarray:
    """Return a grey picture, 0 to 1, of the resolution of the field."""
    values, wanted = levels / white_level(levels), light.field.shape
    values = values[..., :3].mean(-1) if values.ndim == 3 else values
    if values.shape != wanted:
        raise ValueError(
            f"{path!r} must have the resolution of the field, {wanted[0]} x {wanted[1]} pixels; "
            f"got {values.shape[0]} x {values.shape[1]}"
        )
    return values


def _propagate(light: Light, element: dict[Any, Any]) -> list[Any]:
    return [FreeSpace(element["distance"], element["method"], element["resolution"], element["pixel_pitch"])]


SOURCE: dict[str, Callable[[dict[Any, Any], dict[Any, Any]], np.ndarray]] = {
    "plane_wave": _plane_wave,
    "gaussian_beam": _gaussian_beam,
    "point_source": _point_source,
}
PASSAGE: dict[str, Callable[[Light, dict[Any, Any]], list[Any]]] = {
    "circular_aperture": _circular_aperture,
    "rectangular_aperture": _rectangular_aperture,
    "lens": _lens,
    "slm": _slm,
    "mask": _mask,
    "propagate": _propagate,
}
