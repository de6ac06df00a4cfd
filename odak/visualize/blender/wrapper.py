"""The older interface's commands, carried out in this process: no Blender has to run, and no port is opened."""

from collections.abc import Iterable

from odak.tools.file import validate_path
from odak.visualize.blender import server, session
from odak.visualize.blender.libblend import cylinder_between, delete_object, import_ply, prepare, quit, render

__all__ = [
    "check",
    "cylinder_between",
    "delete_object",
    "delete_the_cube",
    "import_ply",
    "init",
    "prepare",
    "quit",
    "render",
    "send_msg",
]


def init(headless: bool = False, blend_fn: str = "") -> session.Session:
    """Begin a scene.

    Parameters
    ----------
    headless : bool
        Counts for nothing: no window opens.
    blend_fn : str
        A ".blend" file to continue; no script in it is run. Empty for an empty scene.

    Returns
    -------
    Session
        A handle with `poll` and `kill`, as a process has them; its `scene` is what is drawn into.
    """
    return session.start(validate_path(blend_fn, [".blend"]) if blend_fn else None)


def check(proc: session.Session) -> None:
    """Let the scene of a handle of :func:`init` go. Nothing runs that would have to be waited for."""
    proc.kill()


def delete_the_cube() -> None:
    """Remove the cube that a new ".blend" file holds."""
    delete_object("Cube")


def send_msg(cmds: Iterable[str]) -> bool:
    """Carry out commands given as texts.

    Parameters
    ----------
    cmds : iterable of str
        Calls such as ``"prepare(device='CPU')"``, with literals as arguments; see
        :func:`odak.visualize.blender.server.validate_and_queue_command`. A text is taken apart, never run.

    Returns
    -------
    bool
        True.

    Raises
    ------
    ValueError
        If one is refused. None of them is carried out then.
    """
    texts = [cmds] if isinstance(cmds, str) else list(cmds)
    for text in texts:
        if all(server.parse_function_call_safely(text, name)[0] is None for name in server.COMMANDS):
            known = ", ".join(server.COMMANDS)
            raise ValueError(f"cmds must be calls of {known} with literals as arguments, got {text!r:.100}")
    for text in texts:
        server.validate_and_queue_command(text)
        server.execute_queued_functions()
    return True
