"""The scene that the functions of the older interface draw into, one for each process."""

from odak.visualize.blender.scenes import scene

__all__ = ["Session", "current", "start", "stop"]


class Session:
    """What :func:`odak.visualize.blender.init` returns: a handle as of a process that is running.

    Attributes
    ----------
    scene : scene
        What is drawn into, in metres: one unit of Blender as Blender has it.
    depth : bool
        Whether depth is rendered in place of colours.
    """

    def __init__(self, start_from: str | None = None):
        self.scene = scene(unit="m", resolution=(1080, 1920))
        self.scene.start_from = start_from
        self.depth = False

    def poll(self) -> int | None:
        """Return None while this is the scene that is drawn into, 0 afterwards."""
        return None if _open.get("session") is self else 0

    def kill(self) -> None:
        """Let the scene go."""
        if self.poll() is None:
            stop()

    terminate = kill


_open: dict[str, Session] = {}


def start(start_from: str | None = None) -> Session:
    """Begin an empty scene, or one that continues a ".blend" file, and return its handle."""
    _open["session"] = Session(start_from)
    return _open["session"]


def current() -> Session:
    """Return the handle of the scene that is drawn into; begin one if there is none."""
    return _open.get("session") or start()


def stop() -> None:
    """Let the scene go."""
    _open.pop("session", None)
