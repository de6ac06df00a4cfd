"""Waiting for events, and for processes to end."""

import time
from pathlib import Path

# A bound on hangs alone, within the limit of pytest for a test: what is waited for takes seconds at most.
LIMIT = 240


def wait_for(condition, running=None):
    """Return what `condition` returns once it is true; `running` is a program that must not end before."""
    end = time.monotonic() + LIMIT
    while not (found := condition()):
        assert time.monotonic() < end, "it took too long"
        assert running is None or running.poll() is None, "the program ended"
        time.sleep(0.02)
    return found


def is_running(process):
    """Return whether a process runs; one that has ended and that nobody has asked for its status does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
