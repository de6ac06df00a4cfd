"""`odak hologram` for many pictures: each a task that carries its picture there and its files back.

Workers need no folder in common with this machine. A picture's folder holds its report only once all else is there, so
that a run that was cut short goes on where it ended.
"""

import hashlib
import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from odak.cli.errors import InputError
from odak.cli.files import writable_folder, write_json
from odak.cli.job import SHIPPED_IMAGES, Job, depth_map_path, image_path
from odak.manager import Failure, agent
from odak.tools._atomic import replacing

REPORT, SUMMARY, FINGERPRINT = "report.json", "summary.json", "fingerprint"
SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
# Where a picture is computed, and how much is said about it, changes nothing about it.
_IRRELEVANT = ("image", "depth_map", "output", "device", "quiet")


@dataclass(frozen=True)
class Frame:
    """One of many pictures.

    Attributes
    ----------
    name : str
        Name of its folder.
    job : Job
        What to compute; its output is that folder.
    """

    name: str
    job: Job

    def fingerprint(self) -> str:
        """Return a digest of all that the result depends on: the parameters, the picture and its depth map."""
        digest = hashlib.sha256()
        values = {name: value for name, value in self.job.to_dict().items() if name not in _IRRELEVANT}
        digest.update(json.dumps(values, sort_keys=True).encode())
        for path in self.sources():
            digest.update(hashlib.sha256(path.read_bytes()).digest())
        return digest.hexdigest()

    def sources(self) -> list[Path]:
        """Return the file of the picture, and that of its depth map if there is one."""
        depth = self.job.depth_map
        return [image_path(self.job.image), *([] if depth is None else [depth_map_path(depth)])]

    def is_done(self) -> bool:
        """Return whether the folder holds the whole result of this very job."""
        try:
            report = json.loads((self.job.output / REPORT).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return False
        return report.get(FINGERPRINT) == self.fingerprint() and all(
            (self.job.output / name).is_file() for name in report["pattern"]["files"]
        )


def run(
    images: Sequence[str],
    values: dict[str, Any],
    cluster: str | None,
    workers: int | None = None,
    retries: int = 1,
    again: bool = False,
    timeout: float = 60.0,
) -> dict:
    """Compute the holograms of many pictures.

    Parameters
    ----------
    images : sequence of str
        Pictures, folders of pictures, or names of shipped ones.
    values : dict
        Parameters of :class:`odak.cli.job.Job` for all of them; ``depth_map`` may be a folder of files of the same
        names.
    cluster : str, optional
        "local" or the address of a scheduler; by default one picture after another in this process.
    workers : int, optional
        Worker processes on this machine.
    retries : int
        How often a picture that failed is tried again.
    again : bool
        Compute also what is done already.
    timeout : float
        Seconds that the scheduler and a first worker may take to be there.

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
    frames = find_frames(images, values)
    folder = writable_folder(Path(values["output"]))
    waiting = [frame for frame in frames if again or not frame.is_done()]
    failed: dict[str, str] = {}
    busy: set[str] = set()
    if waiting:
        busy = _compute(waiting, failed, values, cluster, workers=workers, retries=retries, timeout=timeout)
    computed = {frame.name for frame in waiting} - set(failed)
    summary = {
        "computed": [frame.name for frame in frames if frame.name in computed],
        "skipped": [frame.name for frame in frames if frame not in waiting],
        "failed": failed,
        "seconds": time.perf_counter() - start,
        "workers": len(busy),
    }
    write_json(folder / SUMMARY, summary)
    return summary


def _compute(frames, failed, values, cluster, **options) -> set[str]:
    """Compute frames, write what comes back, note what failed, and return which workers took part."""
    gpu = cluster is not None and str(values.get("device")).startswith("cuda")
    try:
        work = agent(hologram, cluster or False, gpu=gpu, verbose=not values.get("quiet"), **options)
    except ImportError as error:
        raise InputError(str(error)) from None
    except (TypeError, ValueError) as error:
        raise InputError(f"--{error}") from None
    with work:
        work.connect()
        for frame in frames:
            work.submit((parameters(frame.job), *map(Carried, frame.sources())))
        for index, result in work.as_completed():
            frame = frames[index]
            if isinstance(result, Failure):
                failed[frame.name] = " ".join(f"{type(result.error).__name__}: {result.error}".split())
            else:
                _write(frame, result)
        return {record["worker"] for record in work.records}


def find_frames(images: Sequence[str], values: dict[str, Any]) -> list[Frame]:
    """Return the pictures that paths, folders and names stand for, each with its job.

    Parameters
    ----------
    images : sequence of str
        As in :func:`run`.
    values : dict
        As in :func:`run`.

    Returns
    -------
    list of Frame
        In the order given, those of a folder sorted by name, numbers in it by their value.

    Raises
    ------
    InputError
        If there is no such picture, two have the same name, or a parameter will not do.
    """
    frames: dict[str, Frame] = {}
    for image in (found for entry in images for found in _expanded(entry)):
        name = image if image in SHIPPED_IMAGES else Path(image).stem
        if name in frames:
            raise InputError(f"IMAGE must have different names: {frames[name].job.image!r} and {image!r}")
        depth = _depth_map(values.get("depth_map"), name)
        output = Path(os.path.expanduser(values["output"])).resolve() / name
        frames[name] = Frame(name, Job(**{**values, "image": image, "depth_map": depth, "output": output}))
        frames[name].sources()
    return list(frames.values())


def _expanded(image: str) -> list[str]:
    path = Path(os.path.expanduser(image))
    if not path.is_dir():
        return [image]
    found = [entry for entry in path.iterdir() if entry.suffix.lower() in SUFFIXES and entry.is_file()]
    if not found:
        raise InputError(f"IMAGE is a directory without pictures ({', '.join(SUFFIXES)}): {image!r}")
    return [str(entry) for entry in sorted(found, key=lambda entry: _natural(entry.name))]


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Return a key by which frame2 comes before frame10."""
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
    """A file that is read when it is sent, so that a long list of pictures takes no memory here.

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

    def __reduce__(self) -> tuple:
        return Arrived, (self.name, self.path.read_bytes())

    def put(self, folder: Path) -> Path:
        """Return where the file lies."""
        return self.path


@dataclass(frozen=True)
class Arrived:
    """A file that was sent.

    Attributes
    ----------
    name : str
        Its name.
    content : bytes
        What is in it.
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
    """Return the parameters that travel; those that name files of this machine stay."""
    return {name: value for name, value in vars(job).items() if name not in ("image", "depth_map", "output", "quiet")}


def hologram(
    values: dict[str, Any], picture: Carried | Arrived, depth: Carried | Arrived | None = None
) -> tuple[dict, dict[str, bytes]]:
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
        If the picture will not do.
    """
    from odak.cli.run import run as compute

    with TemporaryDirectory(prefix="odak-hologram-") as name:
        folder = Path(name)
        image = str(picture.put(folder / "picture"))
        depth_map = None if depth is None else str(depth.put(folder / "depth"))
        job = Job(**values, image=image, depth_map=depth_map, output=folder / "output", quiet=True)
        try:
            report = compute(job)
        except InputError as error:
            raise InputError(str(error).replace(image, picture.name)) from None
        written = {path.name: path.read_bytes() for path in sorted(job.output.iterdir()) if path.name != REPORT}
    return report, written


def _write(frame: Frame, result: tuple[dict, dict[str, bytes]]) -> None:
    """Write a picture's files, the report last; it then speaks of the files of this machine."""
    report, written = result
    folder = writable_folder(frame.job.output)
    (folder / REPORT).unlink(missing_ok=True)
    for name, content in written.items():
        with replacing(str(folder / Path(name).name)) as stream:
            stream.write(content)
    report["parameters"] |= {name: frame.job.to_dict()[name] for name in ("image", "depth_map", "output", "quiet")}
    report["picture"]["file"] = str(image_path(frame.job.image))
    write_json(folder / REPORT, {**report, FINGERPRINT: frame.fingerprint()})
