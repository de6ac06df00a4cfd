"""Computation of many pictures on a cluster (`odak hologram --cluster`), and workers of one (`odak worker`).

Each picture is a task that carries the picture there and the files back: no folder in common is needed. The folder of a
picture holds its report only once all else is there, so that a run that was cut short goes on where it ended.
"""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from odak import _validate
from odak._warnings import OdakWarning, warn
from odak.cli import files
from odak.cli.job import SHIPPED_IMAGES, Job, image_path
from odak.cli.options import InputError, option_name, refusing
from odak.cli.settings import SpreadSettings, WorkerSettings
from odak.manager import Failure, agent
from odak.manager.server import Server, start_server
from odak.tools.paths import replacing

SUMMARY = "summary.json"
SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
_LOOK = 1.0


@dataclass(frozen=True)
class Frame:
    """One of many pictures.

    Attributes
    ----------
    name : str
        Name of its folder.
    job : Job
        Parameters of its computation; the output is that folder.
    """

    name: str
    job: Job


@files.claiming
def run(spread: SpreadSettings, values: dict[str, Any], notices: files.Notices = files.SILENT) -> dict[str, Any]:
    """Compute the holograms of many pictures.

    Parameters
    ----------
    spread : SpreadSettings
        The pictures, folders of pictures, or names of shipped ones, and where they are computed.
    values : dict
        Settings of :class:`odak.cli.job.Job` for all of them; ``depth_map`` may be a folder of files of the same names.
    notices : Notices
        What to do about results of other parameters, which are replaced.

    Returns
    -------
    dict
        "computed" and "skipped": names; "failed": name and reason; "seconds"; "workers". Also written to
        ``summary.json`` in the output folder.

    Raises
    ------
    InputError
        If a parameter or a picture's path will not do.
    OSError
        If the cluster is not there.
    """
    start = time.perf_counter()
    security = spread.security()
    frames = find_frames(spread.images, values)
    folder = files.writable_folder(Path(values["output"]))
    for frame in frames:
        if frame.job.output.exists() and not frame.job.output.is_dir():
            raise InputError(
                f"IMAGE {frame.name!r} needs a folder {str(frame.job.output)!r}, but a file of that name exists"
            )
    files.announce(folder, [SUMMARY], files.SILENT)
    waiting = [
        frame
        for frame in frames
        if values["again"] or not files.finished_report(frame.job.output, files.fingerprint_of(frame.job))
    ]
    replaced = [
        f"{frame.job.output.name}/{files.REPORT}" for frame in waiting if (frame.job.output / files.REPORT).exists()
    ]
    if replaced:
        notices.replaces(folder, replaced)
    failed: dict[str, str] = {}
    busy: set[str] = set()
    if waiting:
        busy = _compute(waiting, failed, values, spread, security)
    computed = {frame.name for frame in waiting} - set(failed)
    summary = {
        "computed": [frame.name for frame in frames if frame.name in computed],
        "skipped": [frame.name for frame in frames if frame not in waiting],
        "failed": failed,
        "seconds": time.perf_counter() - start,
        "workers": len(busy),
    }
    files.write_json(folder / SUMMARY, summary)
    return summary


def _compute(frames, failed, values, spread: SpreadSettings, security) -> set[str]:
    """Compute frames, write the results, collect the failures, and return the workers that took part."""
    gpu = spread.cluster is not None and str(values.get("device")).startswith("cuda")
    options = {name: getattr(spread, name) for name in ("workers", "retries", "timeout", "trusted_network")}
    with refusing(in_options, ImportError, TypeError, ValueError):
        work = agent(
            hologram, spread.cluster or False, gpu=gpu, verbose=not values["quiet"], security=security, **options
        )
    with work:
        work.connect()
        for frame in frames:
            work.submit((parameters(frame.job), *map(Carried, files.sources(frame.job))))
        for index, result in work.as_completed():
            frame = frames[index]
            if isinstance(result, Failure):
                kind = "" if isinstance(result.error, InputError) else f"{type(result.error).__name__}: "
                failed[frame.name] = " ".join(f"{kind}{result.error}".split())
            else:
                try:
                    _write(frame, result)
                except InputError as error:  # another run is writing to this folder
                    failed[frame.name] = str(error)
                    continue
                for text in result[0]["warnings"]:
                    warn(f"{frame.name}: {text}", OdakWarning)
        return {record["worker"] for record in work.records}


def watched(spread: SpreadSettings, values: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the summary of each round of new and changed pictures in folders, which may be empty, until Ctrl-C.

    Parameters
    ----------
    spread, values : SpreadSettings, dict
        As in :func:`run`.
    """
    folders = [Path(os.path.expanduser(image)) for image in spread.images]
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"--watch needs folders, but IMAGE {str(folder)!r} is not a folder")
    seen: dict[Path, tuple] = {}
    done: dict[Path, tuple] = {}
    try:
        while True:
            now = {path: (path.stat().st_size, path.stat().st_mtime_ns) for path in _pictures(folders)}
            # A file that still grows is taken when it has stopped.
            ready = [path for path, state in now.items() if seen.get(path) == state != done.get(path)]
            if ready:
                yield run(replace(spread, images=tuple(map(str, ready))), values)
                done |= {path: now[path] for path in ready}
            seen = now
            time.sleep(_LOOK)
    except KeyboardInterrupt:
        return


def _pictures(folders: Sequence[Path]) -> list[Path]:
    found = [path for folder in folders for path in folder.iterdir()]
    return sorted(
        (path for path in found if path.suffix.lower() in SUFFIXES and path.is_file()),
        key=lambda path: _natural(path.name),
    )


def find_frames(images: Sequence[str], values: dict[str, Any]) -> list[Frame]:
    """Return the pictures given by paths, folders and names, each with its job.

    Parameters
    ----------
    images : sequence of str
        As in :func:`run`.
    values : dict
        As in :func:`run`.

    Returns
    -------
    list of Frame
        In the order given, files of a folder sorted by name, numbers in it by their value.

    Raises
    ------
    InputError
        If there is no such picture, two have the same name, or a parameter will not do.
    """
    frames: dict[str, Frame] = {}
    taken = {SUMMARY: f"the file {SUMMARY} of this command"}
    for image in (found for entry in images for found in _expanded(entry)):
        name = image if image in SHIPPED_IMAGES else Path(image).stem
        # Some file systems take names that differ in case alone for the same.
        folded = name.casefold()
        if folded in taken:
            raise InputError(f"IMAGE must be pictures of different names, got {taken[folded]!r} and {image!r}")
        taken[folded] = image
        depth = _depth_map(values.get("depth_map"), name)
        output = Path(os.path.expanduser(values["output"])).resolve() / name
        frames[name] = Frame(name, Job(**{**values, "image": image, "depth_map": depth, "output": output}))
        files.sources(frames[name].job)
    return list(frames.values())


def _expanded(image: str) -> list[str]:
    path = Path(os.path.expanduser(image))
    if not path.is_dir():
        return [image]
    found = _pictures([path])
    if not found:
        raise InputError(f"IMAGE is a directory without pictures ({', '.join(SUFFIXES)}): {image!r}")
    return list(map(str, found))


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Return a key of natural sorting, by which frame2 precedes frame10."""
    import re

    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name) if part]


def _depth_map(given: str | None, name: str) -> str | None:
    folder = None if given is None else Path(os.path.expanduser(given))
    if folder is None or not folder.is_dir():
        return given
    for suffix in SUFFIXES:
        if (folder / f"{name}{suffix}").is_file():
            return str(folder / f"{name}{suffix}")
    raise InputError(f"--depth-map has no picture named {name!r} in {given!r}")


class Carried:
    """A file that is read when it is sent, so that many pictures take no memory.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __repr__(self) -> str:
        return str(self.path)

    @property
    def name(self) -> str:
        """Its name."""
        return self.path.name

    def __reduce__(self) -> tuple[Callable[[str, bytes], "Arrived"], tuple[str, bytes]]:
        return Arrived, (self.name, self.path.read_bytes())

    def put(self, folder: Path) -> Path:
        """Return the path of the file."""
        return self.path


@dataclass(frozen=True)
class Arrived:
    """A file that was sent.

    Attributes
    ----------
    name : str
        Its name.
    content : bytes
        Its bytes.
    """

    name: str
    content: bytes

    def put(self, folder: Path) -> Path:
        """Write the file to a folder and return its path."""
        folder.mkdir()
        path = folder / Path(self.name).name
        path.write_bytes(self.content)
        return path


def parameters(job: Job) -> dict[str, Any]:
    """Return the parameters that are sent, without those that name files of this machine."""
    return job.values("image", "depth_map")


def hologram(
    values: dict[str, Any], picture: Carried | Arrived, depth: Carried | Arrived | None = None
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Compute the holograms of one picture, on a worker.

    Parameters
    ----------
    values : dict
        From :func:`parameters`.
    picture, depth : Carried or Arrived
        The picture, and its depth map if there is one.

    Returns
    -------
    tuple
        The report, and the content of the other files by their names.

    Raises
    ------
    InputError
        If the picture cannot be used.
    """
    from odak.cli.hologram import run as compute
    from odak.cli.report import collected_warnings

    with TemporaryDirectory(prefix="odak-hologram-") as name:
        folder = Path(name)
        image = str(picture.put(folder / "picture"))
        depth_map = None if depth is None else str(depth.put(folder / "depth"))
        job = Job(**values, image=image, depth_map=depth_map, output=folder / "output", quiet=True)
        # The warnings are part of the report. They are shown from there, with the name of the picture.
        quiet = collected_warnings(lambda text: None)
        with refusing(lambda text: text.replace(image, picture.name), InputError), quiet:
            report = compute(job)
        if report["interrupted"]:
            raise KeyboardInterrupt
        written = {path.name: path.read_bytes() for path in sorted(job.output.iterdir()) if path.name != files.REPORT}
    return report, written


def _write(frame: Frame, result: tuple[dict[str, Any], dict[str, bytes]]) -> None:
    """Write a picture's files, the report last; it then speaks of the files of this machine."""
    report, written = result
    folder = files.writable_folder(frame.job.output)
    with files.locked(folder):
        (folder / files.REPORT).unlink(missing_ok=True)
        for name, content in written.items():
            with replacing(str(folder / Path(name).name)) as stream:
                stream.write(content)
        report["parameters"] |= {name: frame.job.to_dict()[name] for name in ("image", "depth_map", "output", "quiet")}
        report["picture"]["file"] = str(image_path(frame.job.image))
        files.write_json(folder / files.REPORT, {**report, files.FINGERPRINT: files.fingerprint_of(frame.job)})


# --- odak worker


def join(settings: WorkerSettings, say: Callable[[str], None]) -> None:
    """Work for a scheduler until it ends or a signal arrives.

    Parameters
    ----------
    settings : WorkerSettings
        The scheduler and the workers.
    say : callable
        Called with a line of text when the workers have joined and when they leave.

    Raises
    ------
    InputError
        If the address or an option will not do, or Dask is missing.
    OSError
        If the scheduler is not there.
    """
    address = settings.address
    if ":" not in address:
        raise InputError(f"ADDRESS must be the address of a scheduler, such as tls://10.0.0.1:8786; got {address!r}")
    options = {name: getattr(settings, name) for name in ("workers", "threads", "name", "trusted_network", "timeout")}
    options["security"] = settings.security()
    with refusing(in_options, TypeError, ValueError, ImportError):
        if settings.memory_limit is not None:
            limit = _validate.real("memory_limit", settings.memory_limit, positive=True)
            options["memory_limit"] = int(2**30 * limit)
        server = start_server(address, **options)
    with server:
        former = signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            # Within the block: a signal may follow the line at once.
            say(f"{_described(server)} joined {address}; Ctrl-C to leave")
            server.wait()
        except KeyboardInterrupt:
            say(f"left {address}")
        else:
            say(f"the scheduler at {address} has ended")
        finally:
            signal.signal(signal.SIGTERM, former)


def in_options(message: str) -> str:
    """Return a message of the library with the options of the command line in the place of its parameters."""
    for parameter, named in (
        ("(security=, and an address", "(--tls-ca-file, --tls-cert, --tls-key, and an address"),
        ("trusted_network=True", "--trusted-network"),
    ):
        message = message.replace(parameter, named)
    first, _, rest = message.partition(" ")
    if first in ("A", "start_server"):
        return message
    return f"ADDRESS {rest}" if first == "address" else f"{option_name(first)} {rest}"


def _described(server: Server) -> str:
    workers = f"{server.workers} worker{'s' * (server.workers > 1)}"
    threads = f"{server.threads} thread{'s' * (server.threads > 1)}"
    return f"{workers} of {threads}" + (f", {server.gpus} with a GPU," if server.gpus else "")
