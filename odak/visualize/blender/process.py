"""Rendering by Blender in a process of its own: scene files, search for Blender, and the run of the driver."""

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
import struct
import subprocess
import sys
import tempfile
import threading
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from odak import _validate
from odak._python import other_python_command
from odak._warnings import AccuracyWarning, DeviceWarning, warn
from odak.log import logger
from odak.tools.file import _kill_with_children
from odak.tools.paths import replacing
from odak.visualize.blender.items import KINDS, Item, Material

__all__ = ["Blender", "BlenderError", "BlenderNotFoundError", "find_blender"]

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


def find_blender(blender: str | os.PathLike | None = None, environ: Mapping[str, str] | None = None) -> Blender:
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


def run_for_file(document: dict, path: str, blender, timeout, verbose: bool) -> str:
    """Write a file of a scene with Blender, atomically; return the path."""
    if not os.path.isdir(os.path.dirname(path)):
        raise ValueError(f"Folder {os.path.dirname(path)!r} does not exist")
    with tempfile.TemporaryDirectory(prefix="odak_blender_") as folder:
        made = _run(document, folder, os.path.splitext(path)[1].lower(), blender, timeout, verbose)
        with open(made, "rb") as source, replacing(path) as target:
            shutil.copyfileobj(source, target)
    return path


def run_for_array(document: dict, blender, timeout, verbose: bool) -> np.ndarray:
    """Render a scene; return linear RGB and opacity, float32 ``[rows, columns, 4]``, row 0 at the top."""
    with tempfile.TemporaryDirectory(prefix="odak_blender_") as folder:
        made = _run(document, folder, ".raw", blender, timeout, verbose)
        pixels = np.fromfile(made, dtype="<f4")
    rows, columns = document["render"]["resolution"]
    return pixels.reshape(rows, columns, 4)[::-1].astype(np.float32)


def _run(document: dict, folder: str, extension: str, blender, timeout, verbose: bool) -> str:
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


def _follow(process, timeout, verbose: bool, samples: int) -> tuple[list[collections.deque], list[str]]:
    """Wait for a process and show its progress; return the last lines of its output and errors, and its warnings."""
    said: list[str] = []
    tails: list[collections.deque] = [collections.deque(maxlen=TAIL) for _ in range(2)]
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


def _read(stream, tail: collections.deque, bar, said: list[str]) -> None:
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
# Errors that NumPy raises on broken archives and headers of arrays.
_BROKEN_ARRAYS = (
    zipfile.BadZipFile,
    zlib.error,
    tokenize.TokenError,
    SyntaxError,
    EOFError,
    struct.error,
    # Compression that is not known, and encryption.
    RuntimeError,
)
_KEYS = ("unit", "metres", "wavelength", "objects", "lights", "camera", "background", "start_from", "remove", "render")


def write_scene(path: str, document: dict) -> str:
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
    with replacing(store) as stream:
        stream.write(packed.getbuffer())
    # Identifies the pair of files, which cannot be replaced at one instant.
    digest = hashlib.sha256(packed.getbuffer()).hexdigest()
    text = {"format": FORMAT, "version": VERSION, "arrays": os.path.basename(store), "arrays_sha256": digest}
    text |= document | {"objects": entries}
    with replacing(path) as stream:
        stream.write(json.dumps(text, indent=1, allow_nan=False).encode())
    return path


def read_scene(path: str) -> dict:
    """Return what :func:`write_scene` was given, its objects with their arrays in place of names.

    Raises
    ------
    ValueError
        If a file is missing, not a scene, of a later version, or contradicts itself.
    """
    try:
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
        with np.load(name, allow_pickle=False) as store:
            document["objects"] = [_with_arrays(entry, store) for entry in document["objects"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, *_BROKEN_ARRAYS) as error:
        raise ValueError(f"{path!r} cannot be read as a scene: {error}") from error
    return document


def _check_digest(store: str, digest: str | None) -> None:
    if os.path.getsize(store) > MAXIMUM_BYTES:
        raise ValueError(f"{os.path.basename(store)!r} is larger than {MAXIMUM_BYTES} bytes")
    if digest is None:
        return
    with open(store, "rb") as stream:
        if hashlib.sha256(stream.read()).hexdigest() != digest:
            raise ValueError(f"{os.path.basename(store)!r} contains the arrays of another scene")


def item_from(entry: dict) -> Item:
    """Return the object of an entry of :func:`read_scene`."""
    material = Material(**entry["material"] | {"color": tuple(entry["material"]["color"])})
    return Item(**entry | {"material": material})


def _entry(number: int, item: Item, arrays: dict) -> dict:
    """Return an object as plain data, its arrays moved to `arrays` under names that take their place."""
    entry = {field.name: getattr(item, field.name) for field in dataclasses.fields(item)}
    entry["material"] = dataclasses.asdict(item.material)
    for key, dtype in ARRAYS.items():
        if entry[key] is not None:
            arrays[f"{number}.{key}"] = np.ascontiguousarray(entry[key], dtype="<" + dtype)
            entry[key] = f"{number}.{key}"
    return entry


def _array(store, name: str) -> np.ndarray:
    """Return an array of an archive, unless its header promises more than is there."""
    record = store.zip.getinfo(f"{name}.npy")
    if record.file_size > MAXIMUM_BYTES:
        raise ValueError(f"{name} is larger than {MAXIMUM_BYTES} bytes")
    with store.zip.open(record) as stream:
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        shape, _, dtype = read_header[np.lib.format.read_magic(stream)](stream)
        if math.prod(shape) * dtype.itemsize > record.file_size:
            raise ValueError(f"{name} is truncated: its header states {list(shape)}")
    return store[name]


def _with_arrays(entry: dict, store) -> dict:
    entry = dict(entry)
    for key, dtype in ARRAYS.items():
        if entry[key] is not None:
            entry[key] = _array(store, entry[key])
            if entry[key].dtype != np.dtype(dtype):
                raise ValueError(f"{key} of {entry['name']!r} must be {dtype}, got {entry[key].dtype}")
    count = len(entry["vertices"])
    if entry["faces"].size and not 0 <= entry["faces"].min() <= entry["faces"].max() < count:
        raise ValueError(f"a face of {entry['name']!r} has a vertex index beyond {count - 1}")
    if entry["material"]["kind"] not in KINDS:
        raise ValueError(f"material of {entry['name']!r} must be one of {', '.join(KINDS)}")
    return entry
