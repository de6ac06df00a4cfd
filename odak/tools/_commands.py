"""Programs, run without a shell."""

import os
import re
import signal
import subprocess

from odak import _validate
from odak.log import logger
from odak.tools._paths import validate_cwd

ALLOWED_COMMANDS = {"blender", "dispynode.py", "ffmpeg", "python", "python3", "git"}
DANGEROUS_PATTERNS = [r"[;&|`$]", r"\$[{(]", r"[<>]", r"['\"]"]

_DANGEROUS = re.compile("|".join(DANGEROUS_PATTERNS))
_CONTROL = re.compile(r"[\x01-\x1f\x7f]")


def validate_shell_command(cmd_list: list[str]) -> list[str]:
    """Return a copy of a command after refusing characters that would mean something to a shell.

    A program that odak does not know is logged as a warning and passes: no shell is involved.

    Parameters
    ----------
    cmd_list : list of str
        Program and arguments.

    Returns
    -------
    list of str
        A new list, equal to the one given.

    Raises
    ------
    TypeError
        If it is not a list of strings.
    ValueError
        If it is empty, or an item holds a null byte, a control character or one of ``; & | ` $ < > ' "``.
    """
    if not isinstance(cmd_list, list):
        raise TypeError(f"cmd_list must be a list, got {type(cmd_list).__name__}")
    if not cmd_list:
        raise ValueError("cmd_list cannot be empty: its first item is the program")
    for index, item in enumerate(cmd_list):
        _check_item(index, item)
    program = os.path.basename(cmd_list[0]).lower()
    if program not in ALLOWED_COMMANDS:
        logger.warning("Command %r is not among those odak knows: %s", cmd_list[0], ", ".join(sorted(ALLOWED_COMMANDS)))
    return list(cmd_list)


def shell_command(
    cmd: list[str], cwd: str | os.PathLike = ".", timeout: float | None = None, check: bool = True
) -> tuple[subprocess.Popen, bytes | None, bytes | None]:
    """Run a program and, unless told otherwise, wait for it.

    Parameters
    ----------
    cmd : list of str
        Program and arguments; see :func:`validate_shell_command`.
    cwd : str or os.PathLike
        Folder to run it in.
    timeout : float, optional
        Seconds to wait. After them the program and all that it started are killed (return code −9) and what it had
        written until then is returned; there is no exception.
    check : bool
        False returns at once; what the program writes is then dropped, so that it cannot block on a full pipe.

    Returns
    -------
    tuple
        The process, and what it wrote to its standard output and to its standard error as bytes (None, None when
        `check` is False).

    Raises
    ------
    TypeError, ValueError
        If the command or the folder is not acceptable.
    FileNotFoundError
        If the program or the folder does not exist.
    """
    command, folder, check = validate_shell_command(cmd), validate_cwd(cwd), _validate.flag("check", check)
    if timeout is not None:
        _validate.real("timeout", timeout)
    pipe = subprocess.PIPE if check else subprocess.DEVNULL
    process = subprocess.Popen(command, cwd=folder, stdout=pipe, stderr=pipe, start_new_session=True)
    if not check:
        return process, None, None
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        _kill_with_children(process)
        out, err = process.communicate()
    except BaseException:
        _kill_with_children(process)
        process.communicate()
        raise
    return process, out, err


def _check_item(index, item):
    if not isinstance(item, str):
        raise TypeError(f"cmd_list[{index}] must be a string, got {type(item).__name__}")
    if "\0" in item:
        raise ValueError(f"Null bytes are not allowed in cmd_list[{index}], got {item!r}")
    if found := _DANGEROUS.search(item):
        raise ValueError(f"Dangerous character {found.group()!r} in cmd_list[{index}], got {item!r}")
    if found := _CONTROL.search(item):
        raise ValueError(f"Control character {found.group()!r} in cmd_list[{index}], got {item!r}")


def _kill_with_children(process):
    if not hasattr(os, "killpg"):
        process.kill()
        return
    try:
        # The process leads a session of its own, so its number is also that of the group.
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        process.kill()
