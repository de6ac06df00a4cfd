"""Files of a run: its folder, results of earlier runs in it, reports, pictures, and phase patterns.

A level L of a pattern of 2^bits is stored as the grey value L·2^(depth − bits) of a PNG of depth 8 or 16. Whatever the
bits, the phase of a pixel is then grey·2π/2^depth, which is what a modulator calibrated to 2π over 2^depth grey values
displays.
"""

import errno
import functools
import hashlib
import json
import math
import os
import re
import socket
import sys
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, TypeVar

from odak._warnings import ArgumentWarning, warn
from odak.cli.job import Job, depth_map_path, find_preset, image_path
from odak.cli.options import InputError, option_name, refusing
from odak.tools import check_directory
from odak.tools.file import file_depth, save_levels
from odak.tools.paths import replacing, validate_path, write_file

if TYPE_CHECKING:
    import numpy
    import torch
    from PIL import Image

    from odak.instruments import Calibration, Lens

REPORT, FINGERPRINT, DIGESTS = "report.json", "fingerprint", "sha256"
LOCK = ".odak.lock"
# Parameters without effect on the result: the device and the printed output.
_IRRELEVANT = ("image", "depth_map", "device", "preset", "start")


def writable_folder(folder: Path, name: str = "--output") -> Path:
    """Make a folder if need be, and make sure before the computation that it can be written to.

    Parameters
    ----------
    folder : Path
        Folder to write to.
    name : str
        Its name in messages.

    Returns
    -------
    Path
        The same folder, absolute.

    Raises
    ------
    InputError
        If it cannot be made or written to.
    """
    folder = Path(os.path.expanduser(folder)).resolve()
    with refusing(lambda text: f"{name} cannot be written to: {str(folder)!r} ({text})", OSError, ValueError):
        check_directory(str(folder), validate=False)
        tempfile.TemporaryFile(dir=folder).close()
    return folder


# What the run at hand has to release, and the folders that it and the runs around it hold.
_claims: ContextVar[tuple[ExitStack, frozenset[Path]]] = ContextVar("claims")
_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


def claiming(run: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Return a function that keeps the folders that it claims until it ends.

    Parameters
    ----------
    run : callable
        It calls :func:`claim`, or :func:`announce`, which does.
    """

    @functools.wraps(run)
    def claimed(*arguments: _Parameters.args, **options: _Parameters.kwargs) -> _Result:
        with ExitStack() as stack:
            former = _claims.set((stack, _claims.get((stack, frozenset()))[1]))
            try:
                return run(*arguments, **options)
            finally:
                _claims.reset(former)

    return claimed


def claim(folder: Path, name: str = "--output") -> None:
    """Keep other runs from writing to a folder until this one ends, also if it is killed.

    Parameters
    ----------
    folder : Path
        Existing folder.
    name : str
        Its name in messages.

    Raises
    ------
    InputError
        If another run has claimed it.
    """
    stack, held = _claims.get()
    if folder not in held:
        stack.enter_context(locked(folder, name))
        _claims.set((stack, held | {folder}))


@contextmanager
def locked(folder: Path, name: str = "--output") -> Iterator[None]:
    """Hold the lock of a folder; parameters and errors are as in :func:`claim`.

    The lock is one of the operating system on a hidden file, which is removed at the end. It ends with the process.
    """
    path = folder / LOCK
    descriptor = _lock_file(path, name)
    try:
        try:
            os.ftruncate(descriptor, 0)
            os.lseek(descriptor, 0, os.SEEK_SET)
            os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
        except OSError as error:  # such as a full disk
            raise type(error)(error.errno, error.strerror, str(path)) from None
        yield
    finally:
        if sys.platform == "win32":
            # No open file is removed there. One that the next run has opened by now stays.
            os.close(descriptor)
            with suppress(OSError):
                path.unlink()
        else:
            # Removed before the lock ends: the next run looks whether the file that it locked is still there.
            path.unlink(missing_ok=True)
            os.close(descriptor)


def _lock_file(path: Path, name: str) -> int:
    """Return the descriptor of the locked file at a path, made if need be."""
    while True:
        try:
            descriptor = os.open(path, os.O_CREAT | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except PermissionError:
            raise InputError(
                f"{name} {str(path.parent)!r} is in use by a run of another user, or was when that was killed: remove "
                f"{LOCK} if it has ended, or name another folder"
            ) from None
        try:
            if not _lock(descriptor):
                # What stands in the file is shown only if it is what a run writes.
                os.lseek(descriptor, 0, os.SEEK_SET)
                holder = os.read(descriptor, 300).decode(errors="replace")
                holder = f" ({holder})" if re.fullmatch(r"process \d+ on [\w.-]+", holder) else ""
                raise InputError(
                    f"{name} {str(path.parent)!r} is in use by another run{holder}; wait for its end, or name another "
                    "folder"
                )
            if os.path.lexists(path) and os.path.samestat(os.fstat(descriptor), os.lstat(path)):
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _lock(descriptor: int) -> bool:
    """Lock an open file and return True, or False if another process has locked it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            # No other process can read a locked byte there: one behind the text is locked.
            os.lseek(descriptor, 4096, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
            return False
        warn(
            f"the file system of --output has no locks ({error.strerror}): run no other command that writes there",
            ArgumentWarning,
        )
    return True


def write_json(path: Path, value: dict[str, Any]) -> None:
    """Write a dictionary as JSON.

    Parameters
    ----------
    path : Path
        File to write; an older one stays as it was until the new one is complete.
    value : dict
        The dictionary.
    """
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    write_file(str(path), text.encode("utf-8"))


def write_png(path: Path, image: "Image.Image") -> None:
    """Write a picture as PNG.

    Parameters
    ----------
    path : Path
        File to write; an older one stays as it was until the new one is complete.
    image : PIL.Image.Image
        The picture.
    """
    with replacing(str(path)) as stream:
        image.save(stream, format="PNG")


class Notices(NamedTuple):
    """What a run does about results of earlier runs in its folder.

    Attributes
    ----------
    again : bool
        Compute anew what is complete already.
    kept : callable
        Called with the folder whose results are kept, as an equal run has written them.
    replaces : callable
        Called before the computation with the folder and the names of the files that will be replaced, if there are
        any. It may raise an exception to end the run.
    """

    again: bool = True
    kept: Callable[[Path], None] = lambda folder: None
    replaces: Callable[[Path, list[str]], None] = lambda folder, names: None


SILENT = Notices()


def fingerprint(values: Mapping[str, Any], paths: Iterable[Path] = ()) -> str:
    """Return a digest of the parameters and the files on which a result depends.

    Parameters
    ----------
    values : mapping
        The parameters; what is none of JSON is taken by its text.
    paths : iterable of Path
        Files or folders whose contents count.
    """
    digest = hashlib.sha256()
    digest.update(json.dumps(values, sort_keys=True, default=str).encode())
    for path in paths:
        digest.update(bytes.fromhex(digest_of(path)))
    return digest.hexdigest()


def fingerprint_of(job: Job) -> str:
    """Return the fingerprint of a run of `odak hologram`, with its picture and its depth map."""
    return fingerprint(job.values(*_IRRELEVANT), sources(job))


def digests(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Return the SHA-256 digest of each file."""
    return {name: digest_of(folder / name) for name in names}


def digest_of(path: Path) -> str:
    """Return the SHA-256 digest of a file, or of the names and contents of all files in a folder."""
    digest = hashlib.sha256()
    if path.is_dir():
        for file in sorted(file for file in path.rglob("*") if file.is_file()):
            digest.update(f"{file.relative_to(path).as_posix()} {digest_of(file)}\n".encode())
        return digest.hexdigest()
    with open(path, "rb") as stream:
        while part := stream.read(1 << 20):
            digest.update(part)
    return digest.hexdigest()


def sources(job: Job) -> list[Path]:
    """Return the files of the picture and, if there are any, of its depth map, the response and the start."""
    known = [Path(os.path.expanduser(name)) for name in (job.calibration, job.lut) if name is not None]
    return [
        *_pictures_of(job),
        *([] if job.depth_map is None else [depth_map_path(job.depth_map)]),
        *(path for path in known if path.is_file()),
        *([] if job.start is None else sorted(Path(os.path.expanduser(job.start)).glob("hologram*.png"))),
    ]


def _pictures_of(job: Job) -> list[Path]:
    """Return the files of the picture, or those of a scene that eyes look at."""
    if job.scene is None:
        return [image_path(job.image)]
    if job.scene != "views" or not job.scene_path.is_file():
        return [job.scene_path]
    from odak.learn.wave.holograms.scenery import listed_views

    with refusing("--views ", OSError, ValueError):
        pictures, _ = listed_views(job.scene_path)
    return [job.scene_path, *(picture for picture in pictures if picture.is_file())]


def read_report(path: Path) -> dict[str, Any]:
    """Return what a file ``report.json`` holds.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If it is no JSON object.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if not isinstance(found, dict):
        raise ValueError(f"it must be a JSON object, got {found!r:.80}")
    return found


def finished_report(folder: Path, mark: str) -> dict[str, Any] | None:
    """Return the report in a folder that holds the whole result of the run with this fingerprint, else None."""
    folder = Path(os.path.expanduser(folder))
    try:
        report = read_report(folder / REPORT)
        same = report[FINGERPRINT] == mark and report[DIGESTS] == digests(folder, report[DIGESTS])
    except (OSError, ValueError, KeyError, TypeError):  # no report, or none of this version: the job is computed
        return None
    return report if same else None


def kept_report(folder: Path, mark: str, notices: Notices) -> dict[str, Any] | None:
    """Return the report of an earlier run that computed the same, with notice, and None if there is none."""
    report = None if notices.again else finished_report(folder, mark)
    if report is not None:
        notices.kept(folder)
    return report


def announce(folder: Path, names: Iterable[str], notices: Notices) -> None:
    """Claim a folder and give notice of the files that a run will replace; InputError if one is a folder.

    Names of patterns, which begin with "hologram", must not be too long to be read back with their folder.
    """
    claim(folder)
    found = []
    for name in names:
        if name.startswith("hologram"):
            try:
                validate_path(folder / name, name="--output")
            except ValueError as error:
                raise InputError(f"{error}: {str(folder / name)!r}") from None
        if (folder / name).is_dir():
            raise InputError(
                f"--output {str(folder)!r} must not contain a folder named {name}, which is the name of a result file"
            )
        if (folder / name).exists():
            found.append(name)
    if found:
        notices.replaces(folder, found)


def write_report(folder: Path, report: dict[str, Any], mark: str, names: Iterable[str]) -> dict[str, Any]:
    """Write the report of a run, and return it with its fingerprint and the digests of its files.

    A second run knows by these that the folder holds its whole result.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    report : dict
        The report.
    mark : str
        Fingerprint of the run.
    names : iterable of str
        Files of the run, all written by now.
    """
    report = {**report, FINGERPRINT: mark, DIGESTS: digests(folder, names)}
    write_json(folder / REPORT, report)
    return report


class Response(NamedTuple):
    """What a modulator does to light at each level, where it is known.

    Attributes
    ----------
    phases : numpy.ndarray
        Phase of each level in radians ``[levels]``, or of the levels of regions ``[region rows, region columns,
        levels]``.
    wavefront : numpy.ndarray or float
        Aberration at each pixel in radians.
    amplitude : numpy.ndarray, optional
        Amplitude of the illumination at each pixel, its mean square being 1; None for even light.
    lens : odak.instruments.Lens, optional
        Lens of the table, behind which the picture is.
    """

    phases: "numpy.ndarray"
    wavefront: "numpy.ndarray | float" = 0.0
    amplitude: "numpy.ndarray | None" = None
    lens: "Lens | None" = None


@functools.lru_cache(maxsize=4)
def _response(calibration: str | None, lut: str | None, slm_range: float | None, bits: int) -> Response | None:
    import numpy as np

    if calibration is not None:
        found = read_calibration(calibration)
        amplitude = found.amplitude / math.sqrt(float(np.mean(found.amplitude**2)))
        lens = None if isinstance(found.distance, (int, float)) else found.distance
        return Response(found.response, found.wavefront, amplitude, lens)
    if slm_range is not None:
        return Response(np.arange(1 << bits) * (slm_range / (1 << bits)))
    return None if lut is None else Response(read_lut(lut, bits))


def response_of(job: Job) -> Response | None:
    """Return the response of the modulator of a job by --calibration, --lut or --slm-range; None for the ideal one."""
    return _response(job.calibration, job.lut, job.slm_range, job.bits)


def image_pitches(job: Job) -> tuple[float, float]:
    """Return the distances of neighbouring points of the picture along rows and columns in metres.

    They are the modulator's pitches or, behind a lens, λ·B/(rows·pitch) and λ·B/(columns·pitch), B being the
    focal length for a picture at the focus.
    """
    response = response_of(job)
    if response is None or response.lens is None:
        return job.pitches
    reach = job.wavelengths[0] * abs(response.lens.ray_matrix[1])
    (rows, columns), (dy, dx) = job.resolution, job.pitches
    return reach / (rows * dy), reach / (columns * dx)


def read_lut(path: str, bits: int) -> "numpy.ndarray":
    """Return the phases of all levels that a text file lists.

    Parameters
    ----------
    path : str
        Text: in each line the phase of a level in radians, in the order of the levels; or level and phase, as
        :func:`odak.instruments.load_look_up_table` reads them. Lines that begin with # are left out.
    bits : int
        Bits per pixel: there must be 2^bits levels.

    Raises
    ------
    InputError
        If the file cannot be read, or does not hold a finite phase for each level.
    """
    from odak.instruments.maker_files import values_of_levels

    with refusing("--lut: ", OSError, ValueError):
        phases = values_of_levels(os.path.expanduser(path))
    if len(phases) != 1 << bits:
        raise InputError(f"--lut {path!r} must have {1 << bits} levels for --bits {bits}, got {len(phases)}")
    return phases


def read_calibration(path: str) -> "Calibration":
    """Return the calibration in a file; InputError if it cannot be read."""
    from odak.instruments import load_calibration

    with refusing("--calibration: ", ImportError, OSError, ValueError):
        return load_calibration(Path(os.path.expanduser(path)))


def completed(values: dict[str, Any]) -> dict[str, Any]:
    """Return the settings of a job with those that its modulator determines: by --preset, --calibration or --lut."""
    given, values = values["given"], dict(values)
    if "preset" in values:
        modulator = find_preset(values["preset"])
        values["preset"] = values["preset"].casefold()
        values |= {name: getattr(modulator, name) for name in {"pixel_pitch", "resolution", "bits"} - given}
    if "calibration" in values:
        values |= calibrated(values["calibration"], values, given)
    if "lut" in values:
        values["lut"] = str(Path(values["lut"]).expanduser().absolute())
    return values


def calibrated(path: str, values: Mapping[str, Any], given: Collection[str]) -> dict[str, Any]:
    """Return the parameters of a job that a calibration determines.

    Parameters
    ----------
    path : str
        File of the calibration.
    values : mapping
        Parameters of the job by name.
    given : collection of str
        Those of the command line, which must agree with the calibration; the distance may differ.

    Raises
    ------
    InputError
        If the file cannot be read, or an option contradicts it.
    """
    found = read_calibration(path)
    lens = None if isinstance(found.distance, (int, float)) else found.distance
    if lens is not None and "distance" in given:
        raise InputError(f"--distance has no effect with --calibration {path!r}, which is of a table with a lens")
    bits = (found.phases.size - 1).bit_length()
    known = {
        "wavelengths": (found.wavelength,),
        "pixel_pitch": found.pitch,
        "resolution": found.amplitude.shape,
        "bits": bits,
        # Behind a lens, light at an angle a reaches the point B·a, as it does at the distance B without one.
        "distance": found.distance if lens is None else abs(lens.ray_matrix[1]),
    }
    if found.phases.size != 1 << bits:
        raise InputError(f"--calibration {path!r} has {found.phases.size} levels, which is no power of two")
    for name, value in known.items():
        found_value = values.get(name, getattr(Job, name))
        same = found_value == value or (name in ("wavelengths", "pixel_pitch") and _close(found_value, value))
        if name in given and name != "distance" and not same:
            raise InputError(
                f"{option_name(name).removesuffix('s')} must agree with --calibration, {value!r}, got {values[name]!r}"
            )
    if "preset" in given:
        raise InputError("--preset has no effect with --calibration, which states the modulator")
    kept = {"distance": values["distance"]} if "distance" in given else {}
    return {**known, **kept, "calibration": str(Path(os.path.expanduser(path)).absolute())}


def _close(one: Any, other: Any) -> bool:
    """Return whether two lengths, or tuples of lengths, are the same to a millionth."""
    pairs = [value if isinstance(value, tuple) else (value,) for value in (one, other)]
    return len(pairs[0]) == len(pairs[1]) and all(math.isclose(a, b, rel_tol=1e-6) for a, b in zip(*pairs, strict=True))


def stored_bits(path: Path | str) -> int:
    """Return the bit depth of a grey picture: 16 or 8."""
    from PIL import Image

    with Image.open(path) as image:
        return 16 if image.mode.startswith("I") else 8


def quantise(hologram: "torch.Tensor", bits: int, response: Response | None = None) -> "torch.Tensor":
    """Return the levels of a hologram's phase, each level covering 2π/2^bits radians upwards of it.

    Where the response of the modulator is known, they are those whose phases are nearest after the aberration.

    Parameters
    ----------
    hologram : torch.Tensor
        Complex ``[rows, columns]``.
    bits : int
        Bits per pixel.
    response : Response, optional
        That of the modulator; phases spread evenly over 2π by default.

    Returns
    -------
    torch.Tensor
        int32, 0 … 2^bits − 1.
    """
    if response is not None:
        import torch

        from odak.instruments.phase_response import nearest_levels

        phase = hologram.detach().cpu().to(torch.complex128).angle().numpy() - response.wavefront
        return torch.from_numpy(nearest_levels(phase, response.phases).astype("int32"))
    from odak.learn.wave import produce_phase_only_slm_pattern

    return produce_phase_only_slm_pattern(hologram, 2 * math.pi, bits=bits, default_range=2 * math.pi)[1]


def save_pattern(path: Path, levels: "torch.Tensor", bits: int) -> None:
    """Write levels as a grey PNG.

    Parameters
    ----------
    path : Path
        File to write.
    levels : torch.Tensor
        Integers ``[rows, columns]``, 0 … 2^bits − 1.
    bits : int
        Bits per pixel.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    try:
        save_levels(path, levels.cpu().numpy(), bits)
    except ValueError as error:
        # A full disk is reported as such, not as a wrong option.
        raise OSError(str(error)) from error


def load_pattern(path: Path, bits: int, response: Response | None = None) -> "torch.Tensor":
    """Return the phase of a saved pattern.

    Parameters
    ----------
    path : Path
        File written by :func:`save_pattern`.
    bits : int
        Bits per pixel that it was written with.
    response : Response, optional
        That of the modulator; phases spread evenly over 2π by default.

    Returns
    -------
    torch.Tensor
        float64 ``[rows, columns]`` in radians, 0 ≤ phase < 2π; with a response the phase that it gives, which includes
        the aberration.
    """
    import torch

    from odak.learn.tools import load_image

    white = 2 ** file_depth(bits) - 1
    grey = torch.round(load_image(str(path), normalizeby=None).double() * white)
    if response is None:
        return phase_of(grey, bits)
    from odak.instruments.phase_response import phases_of_levels

    levels = (grey.long() >> (file_depth(bits) - bits)).numpy()
    return torch.from_numpy(phases_of_levels(levels, response.phases) + response.wavefront)


def phase_of(grey: Any, bits: int) -> Any:
    """Return the phase in radians of grey values, an array of any library, in a file of so many bits."""
    return grey * (2 * math.pi / 2 ** file_depth(bits))
