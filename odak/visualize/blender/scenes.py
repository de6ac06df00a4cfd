"""Scenes as plain data: objects, camera, lights and background, and their renders by Blender in another process."""

import collections
import dataclasses
import hashlib
import importlib.util
import io
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from odak import _validate
from odak._bars import tqdm
from odak._python import other_python_command
from odak._warnings import AccuracyWarning, DeviceWarning, warn
from odak.catalog.materials import MICROMETRES
from odak.log import logger
from odak.tools.file import _kill_with_children, read_npz, validate_path
from odak.tools.paths import replacing, write_file
from odak.visualize.blender.items import (
    D_LINE,
    KINDS,
    LIGHTS,
    PROJECTIONS,
    Camera,
    Item,
    Light,
    Material,
    Mesh,
    aim,
    chosen,
    linear_color,
    positive,
    three,
)
from odak.visualize.blender.shapes import Lenses, Lines, Shapes

PYTHON_VARIABLE = "ODAK_BLENDER_PYTHON"
PROGRAM_VARIABLE = "ODAK_BLENDER"
INSTALL = f"""\
Give Blender an environment of its own (bpy asks for NumPy below 2; bpy 5.0 is for Python 3.11, 5.1 for 3.13):
    python3.11 -m venv ~/blender && ~/blender/bin/pip install bpy==5.0.1
    export {PYTHON_VARIABLE}=~/blender/bin/python
or install the program (https://www.blender.org/download, or apt install blender), which is found on the PATH or by
    export {PROGRAM_VARIABLE}=/path/to/blender"""
_RUN = "import runpy; del sys.argv[0]; runpy.run_path(sys.argv[0], run_name='__main__')"
_PROBE = "import importlib.util as u, sys; sys.exit(0 if u.find_spec('bpy') else 3)"


class BlenderError(RuntimeError):
    """Blender failed; the message ends with its last output.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> picture = blender.scene(unit="mm")
    >>> _ = picture.add_sphere([0, 0, 20], radius=5)
    >>> import shutil
    >>> try:  # a program that fails
    ...     picture.render("sphere.png", blender=shutil.which("false"))
    ... except blender.BlenderError as error:
    ...     print("no picture")
    no picture
    """


class BlenderNotFoundError(ImportError):
    """No Blender was found; the message states how to install one.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> try:
    ...     blender.find_blender("/nowhere/blender")
    ... except blender.BlenderNotFoundError as error:
    ...     print(str(error).splitlines()[0])
    blender names '/nowhere/blender', where there is no program.
    """


class Blender(NamedTuple):
    """A Blender executable.

    Attributes
    ----------
    kind : str
        "python": an interpreter that has the package bpy. "program": Blender itself.
    path : str
        Its executable.

    Examples
    --------
    >>> from odak.visualize.blender import Blender
    >>> Blender("program", "/usr/bin/blender").command("scene.py", "picture.png")[-4:]
    ['--python', 'scene.py', '--', 'picture.png']
    """

    kind: str
    path: str

    def command(self, script: str, *arguments: str) -> list[str]:
        """Return the command line that runs a script in this Blender without a window.

        Parameters
        ----------
        script : str
            Path of the Python script.
        *arguments : str
            Arguments of the script.
        """
        if self.kind == "python":
            return other_python_command(self.path, _RUN, script, *arguments)
        options = ["--background", "--factory-startup", "--python-exit-code", "1", "--python", script, "--"]
        return [self.path, *options, *arguments]

    def environment(self) -> dict[str, str]:
        """Return the environment variables for it, without the search path of this interpreter, which may not fit."""
        kept = dict(os.environ)
        if self.path != sys.executable:
            for name in ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP", "__PYVENV_LAUNCHER__"):
                kept.pop(name, None)
        return kept


def find_blender(blender: str | os.PathLike[str] | None = None, environ: Mapping[str, str] | None = None) -> Blender:
    """Return the Blender that renders: the first that is found in this order.

    1. `blender`: a Python interpreter that has the package bpy, the folder of an environment that has one, or a
       program.
    2. The interpreter, or folder of an environment, named by the environment variable ``ODAK_BLENDER_PYTHON``.
    3. The program named by the environment variable ``ODAK_BLENDER``.
    4. The package bpy of the running interpreter.
    5. A program `blender` on the PATH.

    Parameters
    ----------
    blender : str or os.PathLike, optional
        Executable or folder to use.
    environ : mapping, optional
        Environment variables; by default the process'.

    Returns
    -------
    Blender
        Its kind and the path of its executable.

    Raises
    ------
    BlenderNotFoundError
        If there is none, or the one that was named does not exist or has no bpy; a subclass of ImportError.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> try:
    ...     blender.find_blender(environ={"ODAK_BLENDER": "/nowhere/blender", "PATH": ""})
    ... except blender.BlenderNotFoundError as error:
    ...     print(str(error).splitlines()[0])
    ODAK_BLENDER names '/nowhere/blender', where there is no program.
    """
    environ = os.environ if environ is None else environ
    if blender is not None:
        return _named("blender", os.fspath(blender), environ)
    for variable in (PYTHON_VARIABLE, PROGRAM_VARIABLE):
        if environ.get(variable):
            return _named(variable, environ[variable], environ)
    if importlib.util.find_spec("bpy") is not None:
        return Blender("python", sys.executable)
    program = shutil.which("blender", path=environ.get("PATH"))
    if program is not None:
        return Blender("program", program)
    raise BlenderNotFoundError(
        f"There is no Blender: {sys.executable} has no package bpy, {PYTHON_VARIABLE} and {PROGRAM_VARIABLE} are not "
        f"set, and no program 'blender' is on the PATH.\n{INSTALL}"
    )


def _named(source: str, given: str, environ: Mapping[str, str]) -> Blender:
    """Return the Blender named by an argument or an environment variable."""
    path = os.path.expanduser(given)
    if os.path.isdir(path):
        places = [os.path.join(path, "bin", "python"), os.path.join(path, "Scripts", "python.exe")]
        path = next((place for place in places if os.path.isfile(place)), places[0])
    found = shutil.which(path, path=environ.get("PATH"))
    if found is None:
        raise BlenderNotFoundError(f"{source} names {given!r}, where there is no program.\n{INSTALL}")
    found = os.path.abspath(found)
    if source != PYTHON_VARIABLE and not os.path.basename(found).lower().startswith(("python", "pypy")):
        return Blender("program", found)
    candidate = Blender("python", found)
    try:
        probe = subprocess.run(
            other_python_command(found, _PROBE), capture_output=True, timeout=60, env=candidate.environment()
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BlenderNotFoundError(f"{source} names {given!r}, which does not run: {error}.\n{INSTALL}") from error
    if probe.returncode == 3:
        raise BlenderNotFoundError(f"{source} names {given!r}, a Python without the package bpy.\n{INSTALL}")
    if probe.returncode:
        said = probe.stderr.decode(errors="replace").strip()[-500:]
        raise BlenderNotFoundError(
            f"{source} names {given!r}, which is not a working Python interpreter: {said}\n{INSTALL}"
        )
    logger.debug("Blender: %s", candidate)
    return candidate


DRIVER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "driver.py")
TAIL = 25
_SAMPLE = re.compile(r"Sample (\d+)/(\d+)")
LIBRARIES = (
    "A library of the system is missing. On Debian and Ubuntu: apt-get install libx11-6 libxrender1 libxfixes3 libxi6 "
    "libxkbcommon0 libgl1 libsm6 libice6 libxext6 libegl1"
)


def run_for_file(
    document: dict[str, Any], path: str, blender: str | os.PathLike[str] | None, timeout: float | None, verbose: bool
) -> str:
    """Write a file of a scene with Blender, atomically; return the path."""
    if not os.path.isdir(os.path.dirname(path)):
        raise ValueError(f"Folder {os.path.dirname(path)!r} does not exist")
    with tempfile.TemporaryDirectory(prefix="odak_blender_") as folder:
        made = _run(document, folder, os.path.splitext(path)[1].lower(), blender, timeout, verbose)
        with open(made, "rb") as source, replacing(path) as target:
            shutil.copyfileobj(source, target)
    return path


def run_for_array(
    document: dict[str, Any], blender: str | os.PathLike[str] | None, timeout: float | None, verbose: bool
) -> np.ndarray:
    """Render a scene; return linear RGB and opacity, float32 ``[rows, columns, 4]``, row 0 at the top."""
    with tempfile.TemporaryDirectory(prefix="odak_blender_") as folder:
        made = _run(document, folder, ".raw", blender, timeout, verbose)
        pixels = np.fromfile(made, dtype="<f4")
    rows, columns = document["render"]["resolution"]
    return pixels.reshape(rows, columns, 4)[::-1].astype(np.float32)


def _run(document: dict[Any, Any], folder: str, extension: str, blender, timeout, verbose: bool) -> str:
    timeout = None if timeout is None else float(_validate.real("timeout", timeout, positive=True))
    found = find_blender(blender)
    written = write_scene(os.path.join(folder, "scene.json"), document)
    made = os.path.join(folder, f"out{extension}")
    command = found.command(DRIVER, written, made)
    logger.info("Blender: %s", " ".join(command))
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=found.environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="replace",
        start_new_session=True,
    )
    tails, said = _follow(process, timeout, verbose, document["render"]["samples"])
    for words in said:
        warn(f"Blender: {words}", DeviceWarning if "CPU" in words else AccuracyWarning)
    if process.returncode or not os.path.exists(made):
        raise BlenderError(_complaint(found, process.returncode, tails))
    return made


def _follow(process, timeout, verbose: bool, samples: int) -> tuple[list[collections.deque[Any]], list[str]]:
    """Wait for a process and show its progress; return the last lines of its output and errors, and its warnings."""
    said: list[str] = []
    tails: list[collections.deque[Any]] = [collections.deque(maxlen=TAIL) for _ in range(2)]
    with tqdm(total=samples, desc="Blender", unit="sample", disable=not verbose, leave=False) as bar:
        readers = [
            threading.Thread(target=_read, args=(stream, tail, bar, said), daemon=True)
            for stream, tail in zip((process.stdout, process.stderr), tails, strict=True)
        ]
        for reader in readers:
            reader.start()
        try:
            process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"Blender was stopped after {timeout:g} s; timeout=None sets no limit") from None
        finally:
            if process.poll() is None:
                _kill_with_children(process)
                process.wait()
            for reader in readers:
                reader.join()
            process.stdout.close()
            process.stderr.close()
    return tails, said


def _read(stream, tail: collections.deque[Any], bar, said: list[str]) -> None:
    for line in stream:
        line = line.rstrip()
        if not line:
            continue
        tail.append(line)
        if line.startswith("odak: "):
            said.append(line[6:])
            continue
        logger.debug("Blender: %s", line)
        if sample := _SAMPLE.search(line):
            bar.update(max(int(sample[1]) - bar.n, 0))


def _complaint(found, code: int, tails) -> str:
    output, errors = ("\n".join(tail) for tail in tails)
    said = errors or output or "(it wrote nothing)"
    hint = f"\n{LIBRARIES}" if "cannot open shared object file" in said else ""
    end = f"exit code {code}" if code else "without a result"
    return f"Blender ({found.path}) failed, {end}. It wrote last:\n{said}{hint}"


FORMAT = "odak scene"
VERSION = 1
MAXIMUM_BYTES = 256 << 20
ARRAYS = {"vertices": "f4", "faces": "i4", "normals": "f4", "colors": "f4", "uv": "f4", "image": "u1", "rods": "f4"}
_KEYS = ("unit", "metres", "wavelength", "objects", "lights", "camera", "background", "start_from", "remove", "render")


def write_scene(path: str, document: dict[Any, Any]) -> str:
    """Write a scene; each of the two files appears whole or not at all.

    Parameters
    ----------
    path : str
        Name that ends in ".json". The arrays go to the same name that ends in ".npz".
    document : dict
        What a scene is made of, its objects as :class:`Item`.

    Returns
    -------
    str
        The path.
    """
    arrays: dict[str, Any] = {}
    entries = [_entry(i, item, arrays) for i, item in enumerate(document["objects"])]
    store = os.path.splitext(path)[0] + ".npz"
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    write_file(store, packed.getbuffer())
    # Identifies the pair of files, which cannot be replaced at one instant.
    digest = hashlib.sha256(packed.getbuffer()).hexdigest()
    text = {"format": FORMAT, "version": VERSION, "arrays": os.path.basename(store), "arrays_sha256": digest}
    text |= document | {"objects": entries}
    write_file(path, json.dumps(text, indent=1, allow_nan=False).encode())
    return path


def read_scene(path: str) -> dict[Any, Any]:
    """Return what :func:`write_scene` was given, its objects with their arrays in place of names.

    Raises
    ------
    ValueError
        If a file is missing, not a scene, of a later version, or contradicts itself.
    """
    broken = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError)
    with _validate.refusing(f"{path!r} cannot be read as a scene: ", *broken):
        if os.path.getsize(path) > MAXIMUM_BYTES:
            raise ValueError(f"larger than {MAXIMUM_BYTES} bytes")
        with open(path, encoding="utf-8") as stream:
            document = json.load(stream)
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise ValueError(f"not a scene: its format is not {FORMAT!r}")
        if document.get("version") != VERSION:
            raise ValueError(f"version must be {VERSION}, got {document.get('version')!r}")
        missing = [key for key in (*_KEYS, "arrays") if key not in document]
        if missing:
            raise ValueError(f"{', '.join(missing)} missing")
        name = document["arrays"]
        if not isinstance(name, str) or os.path.basename(name) != name:
            raise ValueError(f"arrays must be the name of a file beside it, got {name!r}")
        name = os.path.join(os.path.dirname(path), name)
        _check_digest(name, document.pop("arrays_sha256", None))
        arrays = read_npz(name, MAXIMUM_BYTES)
        document["objects"] = [_with_arrays(entry, arrays) for entry in document["objects"]]
    return document


def _check_digest(store: str, digest: str | None) -> None:
    if os.path.getsize(store) > MAXIMUM_BYTES:
        raise ValueError(f"{os.path.basename(store)!r} is larger than {MAXIMUM_BYTES} bytes")
    if digest is None:
        return
    with open(store, "rb") as stream:
        if hashlib.sha256(stream.read()).hexdigest() != digest:
            raise ValueError(f"{os.path.basename(store)!r} contains the arrays of another scene")


def item_from(entry: dict[Any, Any]) -> Item:
    """Return the object of an entry of :func:`read_scene`."""
    material = Material(**entry["material"] | {"color": tuple(entry["material"]["color"])})
    return Item(**entry | {"material": material})


def _entry(number: int, item: Item, arrays: dict[Any, Any]) -> dict[Any, Any]:
    """Return an object as plain data, its arrays moved to `arrays` under names that take their place."""
    entry = {field.name: getattr(item, field.name) for field in dataclasses.fields(item)}
    entry["material"] = dataclasses.asdict(item.material)
    for key, dtype in ARRAYS.items():
        if entry[key] is not None:
            arrays[f"{number}.{key}"] = np.ascontiguousarray(entry[key], dtype="<" + dtype)
            entry[key] = f"{number}.{key}"
    return entry


def _with_arrays(entry: dict[Any, Any], arrays: dict[str, np.ndarray]) -> dict[Any, Any]:
    entry = dict(entry)
    for key, dtype in ARRAYS.items():
        if entry[key] is not None:
            entry[key] = arrays[entry[key]]
            if entry[key].dtype != np.dtype(dtype):
                raise ValueError(f"{key} of {entry['name']!r} must be {dtype}, got {entry[key].dtype}")
    count = len(entry["vertices"])
    if entry["faces"].size and not 0 <= entry["faces"].min() <= entry["faces"].max() < count:
        raise ValueError(f"a face of {entry['name']!r} has a vertex index beyond {count - 1}")
    if entry["material"]["kind"] not in KINDS:
        raise ValueError(f"material of {entry['name']!r} must be one of {', '.join(KINDS)}")
    return entry


# Default direction of the camera: in front, to the right and above, with the optical axis (z) in view.
DEFAULT_LOOK = (0.75, 0.4, -0.65)
# Pixel value that a light of default power adds to a white matt surface; the default background adds the rest.
LIT = 0.75
# Studio of scenes without lights and background: greys of the surroundings over the sine of the elevation, dark below
# and bright above, which glass inverts and mirrors show; and lights, each with its direction (right, up, backwards) and
# distance in radii of the scene, its edge in radii, and the pixel value that it adds to a white surface facing it.
STUDIO_GREYS = ((-1.0, 0.04), (-0.3, 0.16), (0.0, 0.42), (0.3, 0.8), (1.0, 0.95))
STUDIO_LIGHTS = (((-0.7, 0.8, 1.0), 5.0, 3.0, 0.55), ((1.0, 0.35, -0.9), 5.0, 2.0, 0.35))


class Views:
    """The part of a scene that adds cameras and lights."""

    # Attributes of the scene that this class is a part of.
    metres: float
    resolution: tuple[int, int]
    camera: Camera | None
    lights: list[Light]
    objects: list[Any]
    background: dict[Any, Any] | None

    def add_camera(
        self,
        location: Sequence[float] | None = None,
        target: Sequence[float] | None = None,
        *,
        up: Sequence[float] | None = None,
        fov: float = 40.0,
        projection: str = "perspective",
        width: float | None = None,
        clip: Sequence[float] | None = None,
    ) -> Camera:
        """Set the camera; a second call replaces it.

        Parameters
        ----------
        location : sequence of float, optional
            Position. By default obliquely in front of `target`, far enough away to see all objects.
        target : sequence of float, optional
            Point that it looks at; by default the middle of all objects.
        up : sequence of float, optional
            Which way is up in the picture; by default y, or z for a look along y.
        fov : float
            Of a perspective camera: full angle across the picture's width, in degrees.
        projection : str
            "perspective" or "orthographic".
        width : float, optional
            Of an orthographic camera: what the picture shows across its width; by default enough for all objects.
        clip : sequence of float, optional
            Nearest and farthest distance that it sees; by default wide enough for all objects.

        Returns
        -------
        Camera
            The camera, which says where points appear (:meth:`Camera.project`) and what it sees (:meth:`Camera.rays`).

        Raises
        ------
        ValueError
            If a number is out of range, or location and target are the same.
        """
        self.camera = self._camera(self.resolution, location, target, up, fov, projection, width, clip)
        return self.camera

    def add_light(
        self,
        location: Sequence[float],
        target: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        kind: str = "point",
        power: float | None = None,
        size: float | None = None,
        color: str = "white",
        visible: bool = True,
    ) -> Light:
        """Add a light.

        Parameters
        ----------
        location : sequence of float
            Position. The light of a sun comes from this direction, from infinity.
        target : sequence of float
            Point that it illuminates.
        kind : str
            "point", "area" (a square that shines forwards) or "sun".
        power : float, optional
            Watts, of a sun watts per square metre. By default as much as brings a white matt surface at the target that
            faces the light to 3/4 of white; the default background adds the rest.
        size : float, optional
            Diameter of a point, edge of an area; by default a twentieth of its distance from the target.
        color : str or sequence of float
            A name or "#rrggbb" as in web pages, or red, green, blue from 0 to 1.
        visible : bool
            Let the camera see it directly; reflections show it in any case.

        Returns
        -------
        Light
            The light.

        Raises
        ------
        ValueError
            If a number is out of range, or location and target are the same.

        Notes
        -----
        A white matt surface under an irradiance of E watts per square metre has the pixel value E/π. A point of power P
        gives E = P/(4πd²) at the distance d, a small area P/(πd²) straight ahead.
        """
        kind, visible = _validate.one_of("kind", kind, LIGHTS), _validate.flag("visible", visible)
        location, target = three("location", location), three("target", target)
        axes = aim(location, target)
        distance = math.dist(location, target)
        if power is None:
            irradiance, squared = LIT * math.pi, (distance * self.metres) ** 2
            power = irradiance * {"point": 4 * math.pi * squared, "area": math.pi * squared, "sun": 1.0}[kind]
        size = distance / 20 if size is None else float(_validate.number("size", size, least=0))
        self.lights.append(
            Light(kind, location, axes, positive("power", power), size, list(linear_color(color)), visible)
        )
        return self.lights[-1]

    def set_background(self, color: Any = "white", strength: float = 1.0) -> None:
        """Set the environment, which illuminates the scene from all directions.

        Parameters
        ----------
        color : str or sequence of float
            A name or "#rrggbb" as in web pages, or red, green, blue from 0 to 1.
        strength : float
            How bright; 0 is darkness.
        """
        strength = float(_validate.number("strength", strength, least=0))
        self.background = {"color": list(linear_color(color)), "strength": strength}

    def project(self, points: np.ndarray, resolution: Sequence[int] | None = None) -> np.ndarray:
        """Return where points appear in the picture, as :meth:`Camera.project` has it.

        Parameters
        ----------
        points : array
            ``[..., 3]``.
        resolution : sequence of int, optional
            Rows and columns of the picture; by default the scene's.
        """
        size = self._resolution(resolution)
        return self._view(size).project(points, size)

    def camera_rays(self, resolution: Sequence[int] | None = None) -> np.ndarray:
        """Return the rays that end in the pixels of the picture, for odak to trace: float64 ``[rows, columns, 2, 3]``.

        Parameters
        ----------
        resolution : sequence of int, optional
            Rows and columns of the picture; by default the scene's.
        """
        size = self._resolution(resolution)
        return self._view(size).rays(size)

    def _view(self, size) -> Camera:
        return self._camera(size) if self.camera is None else self.camera

    def _camera(
        self, size, location=None, target=None, up=None, fov=40.0, projection="perspective", width=None, clip=None
    ) -> Camera:
        projection = _validate.one_of("projection", projection, PROJECTIONS)
        fov = _validate.within("fov", positive("fov", fov), "degrees", below=180)
        points = self._extremes()
        middle = (points.min(0) + points.max(0)) / 2 if len(points) else np.zeros(3)
        target = middle.tolist() if target is None else three("target", target)
        aside = np.add(target, DEFAULT_LOOK).tolist() if location is None else three("location", location)
        axes = aim(aside, target, None if up is None else three("up", up))
        distance, fitting = _fit(points - target, axes, fov, size)
        location = np.add(target, np.multiply(distance, axes[2])).tolist() if location is None else aside
        width = fitting if width is None else positive("width", width)
        limits = None if clip is None else _validate.few("clip", clip, 2, positive=True, rising=True)
        return Camera(location, axes, projection, fov, width, limits)

    def _resolution(self, resolution) -> tuple[int, int]:
        return self.resolution if resolution is None else _validate.size("resolution", resolution)

    def _extremes(self) -> np.ndarray:
        """Return points between which all objects lie."""
        return np.concatenate([np.zeros((0, 3)), *(item.extremes() for item in self.objects)])

    def _reach(self, camera: Camera) -> list[float]:
        """Return the nearest and the farthest distance that a camera has to see."""
        if camera.clip is not None:
            return camera.clip
        reach = float(np.linalg.norm(self._extremes() - camera.location, axis=-1).max(initial=1e-3))
        return [1e-4 * reach, 2 * reach]

    def _lighting(self, camera: Camera) -> tuple[list[Light], dict[Any, Any]]:
        """Return lights and background of the scene, or of the studio if the scene has neither."""
        if self.lights or self.background is not None:
            grey = {"color": [1.0, 1.0, 1.0], "strength": 1 - LIT}
            return list(self.lights), grey if self.background is None else self.background
        points = self._extremes()
        middle = (points.min(0) + points.max(0)) / 2
        radius = float(np.linalg.norm(np.ptp(points, axis=0))) / 2 or 1.0
        frame, lights = np.asarray(camera.axes), []
        for direction, distance, edge, value in STUDIO_LIGHTS:
            towards = np.asarray(direction) @ frame
            location = middle + distance * radius * towards / np.linalg.norm(towards)
            power = value * (math.pi * distance * radius * self.metres) ** 2
            axes = aim(location.tolist(), middle.tolist())
            lights.append(Light("area", location.tolist(), axes, power, edge * radius, [1.0, 1.0, 1.0], visible=False))
        gradient = {"up": frame[1].tolist(), "stops": [list(stop) for stop in STUDIO_GREYS]}
        return lights, {"color": [1.0, 1.0, 1.0], "strength": 1.0, "gradient": gradient}


def _fit(points: np.ndarray, axes, fov: float, size) -> tuple[float, float]:
    """Return the distance at which a perspective camera sees all points, and the width of an orthographic one.

    Points are counted from what the camera looks at; both leave a margin of a twentieth.
    """
    rows, columns = size
    seen = points @ np.asarray(axes).T
    half = 1.05 * np.maximum(np.abs(seen[:, 0]), np.abs(seen[:, 1]) * columns / rows)
    distance = (seen[:, 2] + half / math.tan(math.radians(fov) / 2)).max(initial=1e-3 * np.abs(seen).max(initial=0.0))
    return float(distance) or 1.0, 2 * float(half.max(initial=0.0)) or 1.0


# Smallest picture that Blender renders.
SMALLEST = 4
DEVICES = ("auto", "cpu", "gpu", "cuda", "optix", "hip", "oneapi", "metal")


class scene(Lines, Shapes, Lenses, Views):
    """Rays, meshes, surfaces and lenses, to be rendered by Blender.

    Parameters
    ----------
    unit : str
        Unit of all lengths: "mm", "m", "um" or "nm". One unit of the scene is one unit of Blender, and Blender is told
        how long it is.
    wavelength : float, optional
        Vacuum wavelength in `unit` at which named glasses have their index; the d line, 587.5618 nm, by default.
    resolution : sequence of int
        Rows and columns of the picture.
    samples : int
        Light paths per pixel.
    device : str
        "auto": a GPU through CUDA (or what else there is) if there is one, else the CPU. "cpu". "gpu", "cuda", "optix",
        "hip", "oneapi", "metal": with a warning in the log and the CPU if there is none.

    Attributes
    ----------
    objects : list of Item
        What there is to see.
    camera : Camera or None
        Set by :meth:`add_camera`.
    lights : list of Light
        Set by :meth:`add_light`.
    background : dict or None
        Set by :meth:`set_background`; by default a uniform grey, a quarter of white. A scene with neither lights nor
        background is lit by a studio: surroundings that are dark below and bright above, in which glass and mirrors
        are seen, a large light over the camera's left shoulder, and one behind the scene.
    metres : float
        Length of one unit.
    start_from : str or None
        A ".blend" file that Blender is to open first, without running any script in it.
    removed : list of str
        Names of objects of that file to leave out.

    Raises
    ------
    ValueError
        If an argument is outside its range.

    Notes
    -----
    Nothing here needs Blender but :meth:`render`, :meth:`render_depth` and :meth:`save` with a ".blend" file; see
    :func:`odak.visualize.blender.find_blender`. Axes are as everywhere in odak: z the optical axis, y upwards.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> picture = blender.scene(unit="mm")
    >>> _ = picture.add_sphere([0, 0, 20], radius=5, material="N-BK7")
    >>> _ = picture.add_rays([[0, 1, 0], [0, 0, 1]], distance=40)
    >>> [item.name for item in picture.objects]
    ['sphere', 'rays']
    """

    def __init__(
        self,
        unit: str = "mm",
        *,
        wavelength: float | None = None,
        resolution: Sequence[int] = (480, 640),
        samples: int = 64,
        device: str = "auto",
    ):
        self.unit: str = _validate.one_of("unit", unit, ("mm", "m", "um", "nm"))
        self.metres: float = MICROMETRES[self.unit] * 1e-6
        wavelength = D_LINE / self.metres if wavelength is None else wavelength
        self.wavelength: float = float(_validate.real("wavelength", wavelength, positive=True))
        self.resolution: tuple[int, int] = _validate.size("resolution", resolution)
        self.samples: int = _validate.integer("samples", samples, minimum=1)
        self.device: str = _validate.one_of("device", device, DEVICES)
        self.objects: list[Item] = []
        self.lights: list[Light] = []
        self.camera: Camera | None = None
        self.start_from: str | None = None
        self.removed: list[str] = []
        self.background: dict[Any, Any] | None = None

    def find(self, name: str) -> Item:
        """Return the object with a name; raise ValueError that lists the names if there is none."""
        for item in self.objects:
            if item.name == name:
                return item
        names = ", ".join(repr(item.name) for item in self.objects) or "none"
        raise ValueError(f"name must be one of the objects of the scene ({names}), got {name!r}")

    def remove(self, item: Item | str) -> None:
        """Take an object out of the scene.

        Parameters
        ----------
        item : Item or str
            The object, or its name.
        """
        found = self.find(item) if isinstance(item, str) else item
        self.objects[:] = [other for other in self.objects if other is not found]

    def render(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        resolution: Sequence[int] | None = None,
        samples: int | None = None,
        device: str | None = None,
        denoise: bool | None = None,
        transparent: bool = False,
        seed: int = 0,
        blender: str | os.PathLike[str] | None = None,
        timeout: float | None = 3600.0,
        verbose: bool = True,
    ) -> Any:
        """Render the picture with Cycles, Blender's path tracer; no window opens.

        Parameters
        ----------
        path : str or os.PathLike, optional
            Where to write it: ".png" (sRGB, 8 bits) or ".exr" (linear light, 32-bit floats). Without one the picture is
            returned.
        resolution, samples, device
            In place of the scene's.
        denoise : bool, optional
            Remove noise with OpenImageDenoise, where this Blender has it; by default only in scenes lit by the studio.
        transparent : bool
            Leave the background out: the picture has a fourth channel, which says how opaque it is.
        seed : int
            Of the random light paths; the same one gives the same picture.
        blender : str or os.PathLike, optional
            Which Blender; see :func:`odak.visualize.blender.find_blender`.
        timeout : float, optional
            Seconds after which to give up; None to wait for ever.
        verbose : bool
            Show a progress bar.

        Returns
        -------
        str or numpy.ndarray
            The path, or linear light as float32 ``[rows, columns, 3]`` (4 with `transparent`, colours multiplied by
            it), row 0 at the top. Values above 1 are brighter than white.

        Raises
        ------
        BlenderNotFoundError
            If there is no Blender; the message states how to get one.
        BlenderError
            If Blender fails; the message ends with what it wrote.
        TimeoutError
            If it takes too long.

        Notes
        -----
        Without a camera, one is taken that sees all objects, as of :meth:`add_camera` without arguments. The file
        appears whole or not at all.
        """
        self._check_not_empty()
        job = self._job("picture", resolution, samples, device, seed)
        if denoise is None:
            denoise = not (self.lights or self.background is not None or self.start_from)
        job |= {
            "denoise": _validate.flag("denoise", denoise),
            "transparent": _validate.flag("transparent", transparent),
        }
        if path is None:
            pixels = run_for_array(self._document(job), blender, timeout, verbose)
            return pixels if transparent else pixels[..., :3]
        path = validate_path(path, (".png", ".exr"))
        return run_for_file(self._document(job), path, blender, timeout, verbose)

    def render_depth(
        self,
        *,
        resolution: Sequence[int] | None = None,
        device: str | None = None,
        blender: str | os.PathLike[str] | None = None,
        timeout: float | None = 3600.0,
        verbose: bool = True,
    ) -> np.ndarray:
        """Return the distance of the first surface from the camera's plane at the centre of each pixel.

        Parameters
        ----------
        resolution : sequence of int, optional
            Height and width in pixels, in place of the scene's.
        device : str, optional
            What Cycles computes on, in place of the scene's.
        blender : str or os.PathLike, optional
            Which Blender; see :func:`odak.visualize.blender.find_blender`.
        timeout : float, optional
            Seconds after which to give up; None to wait for ever.
        verbose : bool
            Show a progress bar.

        Returns
        -------
        numpy.ndarray
            float32 ``[rows, columns]`` in the scene's unit, along the camera's axis; infinite where nothing is.
            Glass is a surface like any other.
        """
        self._check_not_empty()
        job = self._job("depth", resolution, 1, device, 0)
        pixels = run_for_array(self._document(job), blender, timeout, verbose)
        return np.where(pixels[..., 3] > 0.5, pixels[..., 0], np.float32(np.inf))

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        blender: str | os.PathLike[str] | None = None,
        timeout: float | None = 3600.0,
        verbose: bool = True,
    ) -> str:
        """Write the scene to a file.

        Parameters
        ----------
        path : str or os.PathLike
            ".blend", to be opened in Blender; or ".json", beside which a ".npz" of the same name holds the arrays.
        blender : str or os.PathLike, optional
            Which Blender writes a ".blend" file; see :func:`odak.visualize.blender.find_blender`.
        timeout : float, optional
            Seconds after which to give up a ".blend" file; None to wait for ever.
        verbose : bool
            Show a progress bar while a ".blend" file is written.

        Returns
        -------
        str
            The path.
        """
        path = validate_path(path, (".blend", ".json"))
        job = self._job("blend", None, None, None, 0)
        if path.endswith(".json"):
            return write_scene(path, self._document(job))
        return run_for_file(self._document(job), path, blender, timeout, verbose)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "scene":
        """Return the scene stored in a ".json" file by :meth:`save`.

        Parameters
        ----------
        path : str or path-like
            Path of the file.

        Raises
        ------
        ValueError
            If the file is missing or malformed; the message names it.
        """
        path = validate_path(path, [".json"])
        document = read_scene(path)
        broken = (TypeError, ValueError, KeyError, AttributeError, OverflowError)
        with _validate.refusing(f"{path!r} cannot be read as a scene: ", *broken):
            return cls._from(document)

    @classmethod
    def _from(cls, document: dict[Any, Any]) -> "scene":
        job = document["render"]
        found = cls(
            document["unit"],
            wavelength=document["wavelength"],
            resolution=job["resolution"],
            samples=job["samples"],
            device=job["device"],
        )
        found.start_from, found.removed = document["start_from"], document["remove"]
        found.background = document["background"]
        found.objects = [item_from(entry) for entry in document["objects"]]
        found.lights = [Light(**entry) for entry in document["lights"]]
        found.camera = None if document["camera"] is None else Camera(**document["camera"])
        return found

    def _add(self, name: str, mesh: Mesh, material, color, default: Material | None, **options) -> Item:
        if not isinstance(name, str) or not name:
            raise TypeError(f"name must be a string that is not empty, got {name!r}")
        made_of = chosen(material, color, default, self.wavelength, self.unit)
        taken = {item.name for item in self.objects}
        free = name
        for number in range(1, len(taken) + 2):
            if free not in taken:
                break
            free = f"{name}.{number:03d}"
        self.objects.append(Item.of(free, mesh, made_of, **options))
        return self.objects[-1]

    def _check_not_empty(self) -> None:
        if not self.objects and not self.start_from:
            raise ValueError("the scene is empty: add rays, meshes, surfaces or lenses before rendering it")

    def _job(self, what: str, resolution, samples, device, seed) -> dict[Any, Any]:
        size = self._resolution(resolution)
        if min(size) < SMALLEST:
            raise ValueError(f"resolution must be at least {SMALLEST} rows and columns, got {list(size)}")
        return {
            "what": what,
            "resolution": list(size),
            "samples": self.samples if samples is None else _validate.integer("samples", samples, minimum=1),
            "device": self.device if device is None else _validate.one_of("device", device, DEVICES),
            "seed": _validate.integer("seed", seed),
            "denoise": False,
            "transparent": False,
        }

    def _document(self, job: dict[Any, Any]) -> dict[Any, Any]:
        """Return the scene as what :func:`odak.visualize.blender.scenes.write_scene` writes."""
        if self.start_from:
            camera, lights, background = self.camera, self.lights, self.background
        else:
            camera = self._view(job["resolution"])
            lights, background = self._lighting(camera)
        return {
            "unit": self.unit,
            "metres": self.metres,
            "wavelength": self.wavelength,
            "objects": self.objects,
            "lights": [dataclasses.asdict(light) for light in lights],
            "camera": None if camera is None else dataclasses.asdict(camera) | {"clip": self._reach(camera)},
            "background": background,
            "start_from": validate_path(self.start_from, [".blend"]) if self.start_from else None,
            "remove": self.removed,
            "render": job,
        }
