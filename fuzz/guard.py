"""One case under watch: what a reader may do with a file, and what counts as a breach of that."""

import os
import resource
import shlex
import signal
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable

SECONDS = 5.0
MEGABYTES = 256
REFUSALS = (ValueError, TypeError, OSError)
_PROGRAMS = {
    "subprocess.Popen",
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.spawn",
    "os.fork",
    "os.forkpty",
    "pty.spawn",
}
_NETWORK = {"socket.connect", "socket.bind", "socket.getaddrinfo", "urllib.Request"}
_REMOVALS = {"os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.chmod", "os.symlink", "os.link", "os.truncate"}

# It tries the folder of temporary files out by writing there, once.
tempfile.gettempdir()
_watched: dict = {"folder": None, "seen": [], "others": set()}


class OverTime(BaseException):
    """The case took too long; not an Exception, so that no reader's own handler takes it for an error of the file."""


def watch() -> None:
    """Start to see programs, connections and writing outside the folder of a case; once for each process."""
    if not _watched.get("on"):
        sys.addaudithook(_audit)
        _watched["on"] = True


def breach(call: Callable, folder: str, names: tuple[str, ...], megabytes: float = MEGABYTES, seconds: float = SECONDS):
    """Call a reader and return what it did that it must not do, in a line, or None.

    Parameters
    ----------
    call : callable
        The reader with its file, without arguments.
    folder : str
        Where it may write.
    names : tuple of str
        What a refusal must name, one of these; nothing if empty.
    megabytes, seconds : float
        Memory that may be added meanwhile, and processor time.

    Returns
    -------
    tuple
        The breach or None, and whether the file was read rather than refused.
    """
    watch()
    before, clock = _resident(), time.process_time()
    if _peak() - before > megabytes * 1024:
        # What used more than this case may was there before it.
        reset_peak()
    # Threads that ran before the call, such as those of a browser that draws images, are not the reader's.
    _watched["others"] = {int(number) for number in os.listdir("/proc/self/task")} - {threading.get_native_id()}
    _watched["folder"], _watched["seen"] = os.path.realpath(folder), []
    former = signal.signal(signal.SIGPROF, _over_time)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    # A module that is first imported meanwhile would be compiled, and kept beside its source.
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    found, read = None, False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call()
        read = True
    except REFUSALS as error:
        found = _nameless(error, names)
    except OverTime:
        found = f"took more than {seconds:g} s of processor time"
    except MemoryError:
        found = "asked for more memory than there is"
    except BaseException as error:
        found = f"raised {_described(error)}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, former)
        sys.dont_write_bytecode = kept
        _watched["folder"] = None
    if _watched["seen"]:
        found = _watched["seen"][0]
    grown = (_peak() - before) / 1024
    if grown > megabytes:
        # The peak of the process is that of this case only as long as no case before it went over.
        reset_peak()
        found = found or f"took {grown:.0f} MB of memory, more than {megabytes:g}"
    if found is None and time.process_time() - clock > seconds:
        found = f"took more than {seconds:g} s of processor time"
    return found, read


def limit_memory(megabytes: int) -> None:
    """Let this process reserve no more than so much above what it has."""
    with open("/proc/self/statm", encoding="ascii") as stream:
        held = int(stream.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + (megabytes << 20), resource.RLIM_INFINITY))


def _nameless(error, names):
    text = f"{error} {getattr(error, 'filename', '')}"
    if not names or any(name in text for name in names):
        return None
    return f"refused without naming the file: {_described(error)}"


def _described(error):
    import traceback

    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "odak" in frame.filename and "fuzz" not in frame.filename]
    place = f" at {os.path.basename(ours[-1].filename)}:{ours[-1].lineno}" if ours else ""
    return f"{type(error).__name__}{place}: {str(error)[:160]!r}"


def _over_time(number, frame):
    raise OverTime


def _audit(event, arguments):
    folder = _watched["folder"]
    if folder is None or threading.get_native_id() in _watched["others"]:
        return
    if event in _PROGRAMS:
        _watched["seen"].append(f"started a program: {shlex.quote(str(arguments)[:120])}")
    elif event in _NETWORK:
        _watched["seen"].append(f"reached for the network: {str(arguments)[:120]}")
    elif event in _REMOVALS:
        for target in arguments:
            _must_be_inside(target, folder, event)
    elif event == "open":
        path, mode, flags = arguments
        written = isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        if written or (isinstance(mode, str) and set(mode) & set("wax+")):
            _must_be_inside(path, folder, "open")


def _must_be_inside(path, folder, event):
    if isinstance(path, (str, bytes)):
        where = os.path.realpath(os.fsdecode(path))
        if (
            where != folder
            and not where.startswith(folder + os.sep)
            and not where.startswith(("/dev/null", "/proc/self"))
        ):
            _watched["seen"].append(f"{event} outside its folder: {where!r}")


def _resident():
    """Return the kilobytes in use."""
    with open("/proc/self/statm", encoding="ascii") as stream:
        return int(stream.read().split()[1]) * (resource.getpagesize() >> 10)


def _peak():
    """Return the most kilobytes that were in use since the peak was set back."""
    with open("/proc/self/status", encoding="ascii") as stream:
        return next(int(line.split()[1]) for line in stream if line.startswith("VmHWM"))


def reset_peak() -> None:
    """Forget the most memory that was in use."""
    with open("/proc/self/clear_refs", "w", encoding="ascii") as stream:
        stream.write("5")
