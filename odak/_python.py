"""Commands that start Python processes which never import a module from the current folder."""

import os
import sys

_START = """\
import os, sys
given, here, own = {given!r}, {here!r}, sys.path[:]
sys.path[:] = [entry for entry in given if entry in own or os.path.realpath(entry) != here]
sys.path += [entry for entry in own if entry not in given]
"""
# A copy of the package that is neither installed nor on the path of this process but through the current folder.
_PACKAGE = """\
import importlib.util
if importlib.util.find_spec("odak") is None:
    sys.path.append({home!r})
"""
# Option -I leaves the user's own packages out as well, which may be where bpy lies.
_OTHER = """\
import site, sys
sys.path += [folder for folder in [site.getusersitepackages()] if folder not in sys.path]
"""


def python_command(code: str, *arguments: str) -> list[str]:
    """Return the command that runs code in another process of this interpreter.

    The search path is the same as in this process, without the current folder: a file ``uuid.py`` that lies among the
    user's pictures would otherwise be imported, and run, in place of the module of that name. Processes that the new
    one starts with :mod:`multiprocessing` inherit this.

    Parameters
    ----------
    code : str
        Python statements.
    arguments : str
        Arguments, in ``sys.argv[1:]``.
    """
    home = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    # Option -P would do, but Python 3.10 does not have it; -I passes through multiprocessing as well.
    return [sys.executable, "-I", "-c", f"{_search_path()}{_PACKAGE.format(home=home)}{code}", *arguments]


def other_python_command(python: str, code: str, *arguments: str) -> list[str]:
    """Return the command that runs code in a given interpreter, as :func:`python_command` does in this one.

    Another interpreter keeps its own search path; this interpreter gets the search path of this process.
    """
    path = _search_path() if python == sys.executable else _OTHER
    return [python, "-I", "-c", f"{path}{code}", *arguments]


def current_folder() -> str | None:
    """Return the current folder without symbolic links, None if it was removed."""
    try:
        return os.path.realpath(os.getcwd())
    except FileNotFoundError:
        return None


def _search_path() -> str:
    given = [os.path.abspath(entry) if os.path.exists(entry) else entry for entry in sys.path if entry]
    return _START.format(given=given, here=current_folder())
