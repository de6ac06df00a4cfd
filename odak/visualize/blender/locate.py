"""Where Blender is."""

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from typing import NamedTuple

from odak.log import logger

__all__ = ["Blender", "BlenderError", "BlenderNotFoundError", "find_blender"]

PYTHON_VARIABLE = "ODAK_BLENDER_PYTHON"
PROGRAM_VARIABLE = "ODAK_BLENDER"
INSTALL = f"""\
Give Blender an environment of its own (bpy asks for NumPy below 2; bpy 5.0 is for Python 3.11, 5.1 for 3.13):
    python3.11 -m venv ~/blender && ~/blender/bin/pip install bpy==5.0.1
    export {PYTHON_VARIABLE}=~/blender/bin/python
or install the program (https://www.blender.org/download, or apt install blender), which is found on the PATH or by
    export {PROGRAM_VARIABLE}=/path/to/blender"""
_PROBE = "import importlib.util as u, sys; sys.exit(0 if u.find_spec('bpy') else 3)"


class BlenderError(RuntimeError):
    """Blender did not do what it was asked for; the message ends with what it wrote."""


class BlenderNotFoundError(ImportError):
    """There is no Blender; the message says how to get one."""


class Blender(NamedTuple):
    """A Blender.

    Attributes
    ----------
    kind : str
        "python": an interpreter that has the package bpy. "program": Blender itself.
    path : str
        Its executable.
    """

    kind: str
    path: str

    def command(self, script: str, *arguments: str) -> list[str]:
        """Return the command that runs a script inside this Blender, without a window."""
        if self.kind == "python":
            return [self.path, script, *arguments]
        options = ["--background", "--factory-startup", "--python-exit-code", "1", "--python", script, "--"]
        return [self.path, *options, *arguments]

    def environment(self) -> dict[str, str]:
        """Return the environment to run it in: without this interpreter's search path, which may not fit the other."""
        kept = dict(os.environ)
        if self.path != sys.executable:
            for name in ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP", "__PYVENV_LAUNCHER__"):
                kept.pop(name, None)
        return kept


def find_blender(blender: str | os.PathLike | None = None, environ: Mapping[str, str] | None = None) -> Blender:
    """Return the Blender that renders, the first there is of these.

    1. `blender`: a Python interpreter that has the package bpy, the folder of an environment that has one, or a
       program.
    2. The interpreter, or folder of an environment, named by the environment variable ``ODAK_BLENDER_PYTHON``.
    3. The program named by the environment variable ``ODAK_BLENDER``.
    4. The package bpy of the running interpreter.
    5. A program `blender` on the PATH.

    Parameters
    ----------
    blender : str or os.PathLike, optional
        Which one to take.
    environ : mapping, optional
        Environment variables; by default the process'.

    Returns
    -------
    Blender
        Its kind and the path of its executable.

    Raises
    ------
    BlenderNotFoundError
        If there is none, or the one that was named does not exist or has no bpy. It is an ImportError.
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
    """Return the Blender that an argument or a variable names."""
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
        probe = subprocess.run([found, "-c", _PROBE], capture_output=True, timeout=60, env=candidate.environment())
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BlenderNotFoundError(f"{source} names {given!r}, which does not run: {error}.\n{INSTALL}") from error
    if probe.returncode == 3:
        raise BlenderNotFoundError(f"{source} names {given!r}, a Python without the package bpy.\n{INSTALL}")
    if probe.returncode:
        said = probe.stderr.decode(errors="replace").strip()[-500:]
        raise BlenderNotFoundError(f"{source} names {given!r}, which is not a Python that runs: {said}\n{INSTALL}")
    logger.debug("Blender: %s", candidate)
    return candidate
